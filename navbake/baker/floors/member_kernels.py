"""The surfaces of chosen regions: which they are, how they end, and what is left of a shrunk
region.

An edge is a side of a cell beyond which its region has no surface (as in Recast's region contours).
Shrinking is an erosion by a disc: a cell is left when all cells nearer than the limit belong to the
mask.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.baker.core.tiles import block_window
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.core.union_find import find_root, unite
from navbake.baker.floors.surface_kernels import Surfaces
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Bool, Float, Int, Int32

# In place of a surface beside an edge: there is none, or the region itself goes on
NOTHING = np.int64(-1)
ITSELF = np.int64(-2)


class Labelled(NamedTuple):
    """Surfaces and the chosen regions that they belong to.

    Attributes:
        surfaces: all of them.
        part: of each surface, the number of its part, see `Labels`, -1 for none, int32.
        region: of each part, -1 unless it is chosen, int32.
    """

    surfaces: Surfaces
    part: Int32
    region: Int32


class Members(NamedTuple):
    """Surfaces of regions, in the order of their cells; `place` is where each is in `Surfaces`."""

    cell: Int
    z: Float
    geom: Int32
    place: Int

    def only(self, kept: Bool) -> "Members":
        """Those that are kept, shape (n,)."""
        return Members._make(array[kept] for array in self)


class Edges(NamedTuple):
    """Edges of regions, arrays of shape (edges,).

    Attributes:
        region: the region that ends there, int32.
        cell: the cell on this side, int64.
        z: the region's height in it, float64 [m].
        way: the way out: east (0), south (1), west (2), north (3), int64.
        cells: the cells beyond, the nearest first, -1 from where the lattice ends or the region
            begins again, shape (edges, reach), int64.
        floors: in each of these cells the highest floor of another region that is more than a step
            lower, NaN for none, shape (edges, reach), float64 [m].
        landing: the regions of these floors, -1 for none, shape (edges, reach), int32.
    """

    region: Int32
    cell: Int
    z: Float
    way: Int
    cells: Int
    floors: Float
    landing: Int32

    def only(self, kept: Bool | Int) -> "Edges":
        """The edges that are kept: a mask, shape (edges,), or their indices."""
        return Edges._make(array[kept] for array in self)


@subkernel(**NO_REFCOUNT)
def shrink(mask, test, left):
    """Mark the cells that are left of a mask, which has a margin of `reach` around them.

    The mask is 1 at its cells and 0 elsewhere, int32. It receives how many cells of it end in a row
    at each cell, so that a row of the disc is one comparison.
    """
    for row in range(mask.shape[0]):
        for col in range(1, mask.shape[1]):
            mask[row, col] *= mask[row, col - 1] + 1
    for r in range(left.shape[0]):
        for c in range(left.shape[1]):
            left[r, c] = True
            for k in range(test.half_widths.shape[0]):
                half = test.half_widths[k]
                if mask[r + k, c + test.radius + half] <= 2 * half:
                    left[r, c] = False
                    break


@subkernel(inline="always")
def region_of(labelled, j):
    """The chosen region of a surface, or -1."""
    part = labelled.part[j]
    return labelled.region[part] if part >= 0 else np.int32(-1)


@subkernel(inline="always")
def _surface_below(labelled, row, col, region, limit):
    """The highest surface of another region below a limit in a cell, NOTHING or ITSELF."""
    surfaces = labelled.surfaces
    highest = NOTHING
    cell = row * surfaces.lattice.width + col
    for j in range(surfaces.first[cell], surfaces.end[cell]):
        other = region_of(labelled, j)
        if other == region:
            return ITSELF
        if other >= 0 and surfaces.z[j] < limit:
            highest = np.int64(j)
    return highest


@subkernel(**NO_REFCOUNT)
def _mark_region(labelled, region, window, reach, mask):
    """Mark a region's cells in a window and within reach of it, in a mask that is all 0."""
    row0, row1, col0, col1 = window
    lattice = labelled.surfaces.lattice
    for row in range(max(row0 - reach, 0), min(row1 + reach, lattice.height)):
        for col in range(max(col0 - reach, 0), min(col1 + reach, lattice.width)):
            if _surface_below(labelled, row, col, region, -math.inf) == ITSELF:
                mask[row - row0 + reach, col - col0 + reach] = 1


@kernel(nogil=True)
def find_large(labelled, boxes, regions, start, blocks, test, result, begin, end):
    """Set `result[region]` where the shrunk region keeps at least `test.min_cells` cells.

    Looks at ``regions[begin:end]``; ``blocks[start[n] : start[n + 1]]`` hold the n-th of `regions`.
    `boxes` are the rows and columns of every region.
    """
    reach = test.radius
    for n in range(begin, end):
        region = regions[n]
        found = 0
        size = min(boxes[region, 2] - boxes[region, 0], boxes[region, 3] - boxes[region, 1])
        for b in range(start[n], start[n + 1]):
            if found >= test.min_cells or size <= 2 * reach:
                break
            row0, row1, col0, col1 = block_window(labelled.surfaces.lattice, blocks[b])
            row0 = max(row0, boxes[region, 0])
            row1 = min(row1, boxes[region, 2])
            col0 = max(col0, boxes[region, 1])
            col1 = min(col1, boxes[region, 3])
            if row1 > row0 and col1 > col0:
                mask = np.zeros((row1 - row0 + 2 * reach, col1 - col0 + 2 * reach), np.int32)
                _mark_region(labelled, region, (row0, row1, col0, col1), reach, mask)
                left = np.empty((row1 - row0, col1 - col0), np.bool_)
                shrink(mask, test, left)
                found += int(left.sum())
        result[region] = found >= test.min_cells


@subkernel(inline="always")
def _next(lattice, row, col, way):
    """The next cell on a way, see `Edges`; a row less than 0 for none."""
    row += 1 if way == 1 else (-1 if way == 3 else 0)
    col += 1 if way == 0 else (-1 if way == 2 else 0)
    if row >= lattice.height or col < 0 or col >= lattice.width:
        row = -1
    return row, col


@subkernel(**NO_REFCOUNT)
def _drop_at(labelled, row, col, way, region, limit, reach):
    """Whether another region's surface lies below the limit within reach of an edge."""
    for _ in range(reach):
        row, col = _next(labelled.surfaces.lattice, row, col, way)
        beside = _surface_below(labelled, row, col, region, limit) if row >= 0 else ITSELF
        if beside != NOTHING:
            return beside >= 0
    return False


@kernel(nogil=True, **NO_REFCOUNT)
def list_edges(labelled, lowest, step, reach, blocks, counts, columns, begin, end):
    """List the edges of regions in ``blocks[begin:end]``, see
    `navbake.baker.core.blocks.list_rows`.

    The rows: the part, the cell, the surface's place, the way out, and whether a floor
    of another region lies more than a step below within reach, 1 or 0. No region is lower than
    `lowest` [m].
    """
    (rows,) = columns
    num = 0
    surfaces = labelled.surfaces
    for k in range(begin, end):
        before = num
        row0, row1, col0, col1 = block_window(surfaces.lattice, blocks[k])
        for row in range(row0, row1):
            for col in range(col0, col1):
                cell = row * surfaces.lattice.width + col
                for j in range(surfaces.first[cell], surfaces.end[cell]):
                    region = region_of(labelled, j)
                    if region < 0:
                        continue
                    limit = surfaces.z[j] - step - LIMIT_SLACK
                    for way in range(4):
                        r, c = _next(surfaces.lattice, row, col, way)
                        if r >= 0 and _surface_below(labelled, r, c, region, limit) == ITSELF:
                            continue
                        if num == rows.shape[0]:
                            return k
                        rows[num, 0] = labelled.part[j]
                        rows[num, 1] = cell
                        rows[num, 2] = j
                        may_drop = limit > lowest
                        drops = may_drop and _drop_at(labelled, row, col, way, region, limit, reach)
                        rows[num, 3] = way
                        rows[num, 4] = 1 if drops else 0
                        num += 1
        counts[k] = num - before
    return end


@kernel(nogil=True, **NO_REFCOUNT)
def look_below(labelled, cells, regions, limits, places, below, begin, end):
    """Find the highest surfaces of other regions below limits, for ``cells[begin:end]``.

    Writes their places: NOTHING where there is none, ITSELF where the region has a surface in the
    cell; and their regions, -1 for none.
    """
    width = labelled.surfaces.lattice.width
    for n in range(begin, end):
        row = cells[n] // width
        col = cells[n] % width
        j = _surface_below(labelled, row, col, regions[n], limits[n])
        places[n] = j
        below[n] = region_of(labelled, j) if j >= 0 else np.int32(-1)


@kernel(nogil=True)
def mark_holes(cells, ways, start, lattice, in_hole):
    """Mark the edges at the rims of holes, of regions with the edges ``start[n]:start[n + 1]``.

    A rim's edges are connected by the cells beyond them, which meet at an edge or a corner. At a
    corner, either of the two cells between them is none of the region's. The outer rim has the
    first of these cells.
    """
    # a margin around the lattice, and an empty column between two rows
    width = lattice.width
    wide = lattice.width + 3
    out = np.array([1, wide, -1, -wide])  # the ways east, south, west and north
    # ITSELF on this side of an edge; beyond it, the parents of union-find, by place
    parent = np.full(wide * (lattice.height + 3), NOTHING, np.int32)
    inner, outer = np.empty((2, cells.shape[0]), np.int64)
    for s in range(start.shape[0] - 1):
        first = start[s]
        end = start[s + 1]
        least = np.int64(parent.shape[0])
        for n in range(first, end):
            inner[n] = (cells[n] // width + 1) * wide + cells[n] % width + 1
            outer[n] = inner[n] + out[ways[n]]
            least = min(least, outer[n])
            parent[inner[n]] = ITSELF
            parent[outer[n]] = outer[n]
        for n in range(first, end):
            place = outer[n]
            for beside in (place + 1, place + wide - 1, place + wide, place + wide + 1):
                if parent[beside] < 0:
                    continue
                at_corner = beside != place + 1 and beside != place + wide
                if at_corner and parent[beside - wide] == ITSELF and parent[place + wide] == ITSELF:
                    continue
                unite(parent, place, beside)
        for n in range(first, end):
            in_hole[n] = find_root(parent, outer[n]) != least
        for n in range(first, end):
            parent[inner[n]] = parent[outer[n]] = NOTHING
