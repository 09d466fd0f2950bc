"""Find the edges of regions, the floors below these edges, and which regions are large.

A region is a set of connected surfaces on which an agent can stand. An edge is a side of a cell
beyond which the cell's region has no surface, as in Recast's region contours. A region is large if
enough of it is left after shrinking. This is an erosion by a disc, whose rows are intervals (Ji,
Piper and Tang, Erosion and Dilation of Binary Images by Arbitrary Structuring Elements Using
Interval Coding, 1989): a cell remains if all cells nearer than the disc's radius are marked.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.baker.core.bisection_kernels import find_first_at_or_above
from navbake.baker.core.tiles import block_window
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.core.union_find import find_root, unite
from navbake.baker.floors.surface_kernels import EAST, NORTH, SOUTH, WEST, Surfaces
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Bool, Float, Int, Int32

# Values in place of the id of a cell's highest surface below a given height
NO_SURFACE = np.int64(-1)  # there is no such surface
SAME_REGION = np.int64(-2)  # the cell is ruled out: the region at the edge has a surface in it


class LabelledSurfaces(NamedTuple):
    """All surfaces, labelled with the ids of some selected regions, as kernels take them.

    Attributes:
        surfaces: all surfaces.
        component_of_surface: the component of each surface, -1 for none, int32. A component is the
            part of a region in one block of cells, see `Components`.
        region_of_component: the region of each component, -1 if the region is not selected, int32.
        lowest_z: the lowest height of each region, selected or not, float64 [m].
        highest_z: the highest height of each region, selected or not, float64 [m].
    """

    surfaces: Surfaces
    component_of_surface: Int32
    region_of_component: Int32
    lowest_z: Float
    highest_z: Float


class RegionSurfaces(NamedTuple):
    """The surfaces of a region, or some of them, in the order of cell ids.

    Attributes:
        cell: ids of the cells, shape (n,), int64.
        z: heights, shape (n,), float64 [m].
        geom: MuJoCo's geom ids, shape (n,), int32.
        surface_id: indices into `Surfaces`, shape (n,), int64.
    """

    cell: Int
    z: Float
    geom: Int32
    surface_id: Int

    def select(self, selection: Bool | Int | slice) -> "RegionSurfaces":
        """Return some of the surfaces: by a mask of shape (n,), by their indices, or a range."""
        return RegionSurfaces._make(array[selection] for array in self)


class RegionEdges(NamedTuple):
    """Edges of regions, and the lower floors in up to k cells beyond each edge.

    Attributes:
        region: the region that ends at each edge, shape (edges,), int32.
        cell: the cell on the region's side of the edge, shape (edges,), int64.
        z: the region's height in that cell, shape (edges,), float64 [m].
        direction: the direction out of the region: EAST, SOUTH, WEST or NORTH, shape (edges,),
            int64.
        cells_beyond: the next k cells in that direction, the nearest first; -1 from where the
            lattice ends or the region begins again, shape (edges, k), int64.
        floors_below: in each of these cells, the height of the highest floor of another region that
            is more than a step lower, NaN for none, shape (edges, k), float64 [m].
        regions_below: the region of each of these floors, -1 for none, shape (edges, k), int32.
    """

    region: Int32
    cell: Int
    z: Float
    direction: Int
    cells_beyond: Int
    floors_below: Float
    regions_below: Int32

    def select(self, selection: Bool | Int) -> "RegionEdges":
        """Return some of the edges, by a mask of shape (edges,) or by their indices."""
        return RegionEdges._make(array[selection] for array in self)


@subkernel(**NO_REFCOUNT)
def shrink(mask, area_test, is_remaining):
    """Erode a mask by the disc of an area test.

    Args:
        mask: 1 at the cells to shrink and 0 elsewhere, with a margin of `area_test.radius` cells on
            each side, int32. It is overwritten: each marked cell gets the number of marked cells in
            a row that end with it, from the left. So one comparison tests a row of the disc.
        area_test: an `AreaTest`, whose disc is used.
        is_remaining: receives which cells remain, without the margin, bool.
    """
    # how many marked cells in a row end with each cell, from the left
    for row in range(mask.shape[0]):
        for col in range(1, mask.shape[1]):
            mask[row, col] *= mask[row, col - 1] + 1
    for window_row in range(is_remaining.shape[0]):
        for window_col in range(is_remaining.shape[1]):
            is_remaining[window_row, window_col] = True
            for disc_row in range(area_test.half_widths.shape[0]):
                half_width = area_test.half_widths[disc_row]
                # the marked cells that end at the interval's right end have to cover the interval
                if (
                    mask[window_row + disc_row, window_col + area_test.radius + half_width]
                    <= 2 * half_width
                ):
                    is_remaining[window_row, window_col] = False
                    break


@subkernel(inline="always")
def region_of_surface(labelled_surfaces, surface):
    """Return the id of a surface's region, or -1 if it belongs to no selected region.

    Args:
        labelled_surfaces: a `LabelledSurfaces` with the regions.
        surface: the id of the surface.
    """
    component = labelled_surfaces.component_of_surface[surface]
    return labelled_surfaces.region_of_component[component] if component >= 0 else np.int32(-1)


@subkernel(inline="always")
def surface_of_same_rank(surfaces, surface, cell, neighbor):
    """Return the surface of a neighbor with as many surfaces below it as a surface of a cell has.

    In a tower, the two are mostly on one floor, so that no other surface has to be looked at.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        surface: the id of a surface.
        cell: the id of its cell.
        neighbor: the id of a neighbor of the cell.

    Returns:
        The id of the surface, -1 for none.
    """
    likely_surface = np.int64(surface) - surfaces.first[cell] + surfaces.first[neighbor]
    return likely_surface if likely_surface < surfaces.end[neighbor] else np.int64(-1)


@subkernel(inline="always")
def _find_surface_below(labelled_surfaces, row, col, excluded_region, height_limit):
    """Return the id of the highest surface in a cell that lies below the height `height_limit` [m].

    Surfaces of the regions of `labelled_surfaces` count. Returns NO_SURFACE if there is none,
    SAME_REGION if `excluded_region` has a surface in the cell, at any height; a negative
    `excluded_region` excludes none.
    """
    surfaces = labelled_surfaces.surfaces
    cell = row * surfaces.lattice.width + col
    first_in_cell = np.int64(surfaces.first[cell])
    end_in_cell = np.int64(surfaces.end[cell])
    if excluded_region >= 0:
        lowest_z = labelled_surfaces.lowest_z[excluded_region]
        for j in range(
            find_first_at_or_above(surfaces.z, first_in_cell, end_in_cell, lowest_z), end_in_cell
        ):
            if surfaces.z[j] > labelled_surfaces.highest_z[excluded_region]:
                break
            if region_of_surface(labelled_surfaces, j) == excluded_region:
                return SAME_REGION
    surface = find_first_at_or_above(surfaces.z, first_in_cell, end_in_cell, height_limit) - 1
    while surface >= first_in_cell and region_of_surface(labelled_surfaces, surface) < 0:
        surface -= 1
    return surface if surface >= first_in_cell else NO_SURFACE


@subkernel(**NO_REFCOUNT)
def _mark_region(labelled_surfaces, region, window, margin, mask):
    """Write 1 into a mask at the cells of a region.

    Args:
        labelled_surfaces: a `LabelledSurfaces` with the region.
        region: the region's id.
        window: rows and columns of cells, see `block_window`.
        margin: how many cells around the window are marked, too.
        mask: receives the 1, shape (rows + 2 margin, cols + 2 margin); all 0 before.
    """
    row0, row1, col0, col1 = window
    lattice = labelled_surfaces.surfaces.lattice
    for row in range(max(row0 - margin, 0), min(row1 + margin, lattice.height)):
        for col in range(max(col0 - margin, 0), min(col1 + margin, lattice.width)):
            if _find_surface_below(labelled_surfaces, row, col, region, -math.inf) == SAME_REGION:
                mask[row - row0 + margin, col - col0 + margin] = 1


@kernel(nogil=True)
def mark_large_regions(
    labelled_surfaces, boxes, regions, first_block, blocks, area_test, is_large, begin, end
):
    """Mark the regions of ``regions[begin:end]`` that keep enough cells after shrinking.

    Args:
        labelled_surfaces: a `LabelledSurfaces` with the regions.
        boxes: the rows and columns of each region, see `Regions.box`, (n, 4).
        regions: ids of regions.
        first_block: indices into `blocks`: ``regions[n]`` lies in the blocks from entry
            ``first_block[n]`` up to, and not including, entry ``first_block[n + 1]``.
        blocks: ids of blocks of cells, region by region.
        area_test: an `AreaTest`: the disc to shrink by, and how many cells have to remain.
        is_large: receives, for each region, whether it is large enough.
        begin: index in `regions` of the first region to test.
        end: index past the last one.
    """
    radius = area_test.radius
    for index in range(begin, end):
        region = regions[index]
        num_remaining_cells = 0
        shorter_side = min(
            boxes[region, 2] - boxes[region, 0],
            boxes[region, 3] - boxes[region, 1],
        )
        for block_index in range(first_block[index], first_block[index + 1]):
            # enough cells remain, or none can
            if num_remaining_cells >= area_test.min_cells or shorter_side <= 2 * radius:
                break
            row0, row1, col0, col1 = block_window(
                labelled_surfaces.surfaces.lattice, blocks[block_index]
            )
            row0 = max(row0, boxes[region, 0])
            row1 = min(row1, boxes[region, 2])
            col0 = max(col0, boxes[region, 1])
            col1 = min(col1, boxes[region, 3])
            if row1 > row0 and col1 > col0:
                mask = np.zeros((row1 - row0 + 2 * radius, col1 - col0 + 2 * radius), np.int32)
                _mark_region(labelled_surfaces, region, (row0, row1, col0, col1), radius, mask)
                is_remaining = np.empty((row1 - row0, col1 - col0), np.bool_)
                shrink(mask, area_test, is_remaining)
                num_remaining_cells += int(is_remaining.sum())
        is_large[region] = num_remaining_cells >= area_test.min_cells


@subkernel(inline="always")
def _step_to(lattice, row, col, direction):
    """Return the row and the column of the next cell in a direction; row -1 if the lattice ends."""
    row += 1 if direction == SOUTH else (-1 if direction == NORTH else 0)
    col += 1 if direction == EAST else (-1 if direction == WEST else 0)
    if row >= lattice.height or col < 0 or col >= lattice.width:
        row = -1
    return row, col


@subkernel(**NO_REFCOUNT)
def _has_drop(labelled_surfaces, row, col, direction, region, height_limit, num_cells_beyond):
    """Return whether a lower surface of another region lies beyond an edge of a region.

    Args:
        labelled_surfaces: a `LabelledSurfaces` with the regions.
        row: row of the cell on the region's side of the edge.
        col: column of that cell.
        direction: EAST, SOUTH, WEST or NORTH, out of the region.
        region: the id of the region that ends at the edge.
        height_limit: the surface has to lie below this height [m].
        num_cells_beyond: how many cells are searched, the nearest first. The search ends at a cell
            in which the region begins again.
    """
    for _ in range(num_cells_beyond):
        row, col = _step_to(labelled_surfaces.surfaces.lattice, row, col, direction)
        surface_below = SAME_REGION
        if row >= 0:
            surface_below = _find_surface_below(labelled_surfaces, row, col, region, height_limit)
        if surface_below != NO_SURFACE:
            return surface_below >= 0
    return False


@kernel(nogil=True, **NO_REFCOUNT)
def list_edges(
    labelled_surfaces,
    lowest_z,
    max_step,
    num_cells_beyond,
    blocks,
    row_counts,
    row_arrays,
    begin,
    end,
):
    """List the edges of regions in ``blocks[begin:end]``.

    A kernel for `navbake.baker.core.blocks.list_rows`. It lists a row for each edge.

    Args:
        labelled_surfaces: a `LabelledSurfaces` with the regions.
        lowest_z: the height of the lowest surface of all these regions, or less [m].
        max_step: the highest step [m].
        num_cells_beyond: how many cells beyond an edge are searched for lower surfaces.
        blocks: ids of blocks of cells.
        row_counts: receives how many edges each block has.
        row_arrays: one array that receives the rows, (n, 5) int64: the component, the cell, the id
            of the surface, the direction out of the region, and 1 if another region has a surface
            more than a step lower in the cells beyond the edge, else 0.
        begin: index in `blocks` of the first block to list.
        end: index past the last one.

    Returns:
        The index in `blocks` of the first block whose rows had no room; `end` if all had room.
    """
    (rows,) = row_arrays
    num_rows = 0
    surfaces = labelled_surfaces.surfaces
    for block_index in range(begin, end):
        num_rows_before = num_rows
        row0, row1, col0, col1 = block_window(surfaces.lattice, blocks[block_index])
        for row in range(row0, row1):
            for col in range(col0, col1):
                cell = row * surfaces.lattice.width + col
                for j in range(surfaces.first[cell], surfaces.end[cell]):
                    region = region_of_surface(labelled_surfaces, j)
                    if region < 0:
                        continue
                    height_limit = surfaces.z[j] - max_step - LIMIT_SLACK
                    for direction in range(4):
                        neighbor_row, neighbor_col = _step_to(surfaces.lattice, row, col, direction)
                        if neighbor_row >= 0:
                            neighbor = neighbor_row * surfaces.lattice.width + neighbor_col
                            likely_surface = surface_of_same_rank(surfaces, j, cell, neighbor)
                            if (
                                likely_surface >= 0
                                and region_of_surface(labelled_surfaces, likely_surface) == region
                            ):
                                continue
                            surface_below = _find_surface_below(
                                labelled_surfaces, neighbor_row, neighbor_col, region, height_limit
                            )
                            if surface_below == SAME_REGION:
                                continue
                        if num_rows == rows.shape[0]:
                            return block_index
                        # no region has a surface below the lowest one
                        has_drop = height_limit > lowest_z and _has_drop(
                            labelled_surfaces,
                            row,
                            col,
                            direction,
                            region,
                            height_limit,
                            num_cells_beyond,
                        )
                        rows[num_rows, 0] = labelled_surfaces.component_of_surface[j]
                        rows[num_rows, 1] = cell
                        rows[num_rows, 2] = j
                        rows[num_rows, 3] = direction
                        rows[num_rows, 4] = 1 if has_drop else 0
                        num_rows += 1
        row_counts[block_index] = num_rows - num_rows_before
    return end


@kernel(nogil=True, **NO_REFCOUNT)
def find_surfaces_below(
    labelled_surfaces,
    cells,
    excluded_regions,
    height_limits,
    surfaces_below,
    regions_below,
    begin,
    end,
):
    """Find the highest surface below a given height, in each of the cells ``cells[begin:end]``.

    Args:
        labelled_surfaces: a `LabelledSurfaces` with the regions whose surfaces count.
        cells: ids of cells, (n,) int64.
        excluded_regions: for each cell, a region. If it has a surface in the cell, at any height,
            the answer for the cell is SAME_REGION, (n,) int32.
        height_limits: for each cell, the height below which the surface must lie, (n,) [m].
        surfaces_below: receives the surfaces' ids; NO_SURFACE if there is none, or SAME_REGION,
            (n,) int64.
        regions_below: receives the surfaces' regions, -1 for none, (n,) int32.
        begin: index in `cells` of the first cell.
        end: index past the last one.
    """
    width = labelled_surfaces.surfaces.lattice.width
    for index in range(begin, end):
        row = cells[index] // width
        col = cells[index] % width
        surface = _find_surface_below(
            labelled_surfaces, row, col, excluded_regions[index], height_limits[index]
        )
        surfaces_below[index] = surface
        regions_below[index] = (
            region_of_surface(labelled_surfaces, surface) if surface >= 0 else np.int32(-1)
        )


@kernel(nogil=True)
def mark_hole_edges(cells, directions, first_edge_of_region, lattice, is_in_hole):
    """Mark the edges at the rims of holes in regions, by union-find over the cells beyond them.

    Two cells just beyond a region's edges are connected if they share a side. They are also
    connected if they share a corner, unless both other cells at the corner belong to the region.
    Edges with connected cells beyond them are on the same rim. The rim with the first of the cells,
    row by row from the north-west, is the region's outer rim; all others are rims of holes.

    Args:
        cells: the cell of each edge, region by region, (edges,).
        directions: the direction out of the region at each edge, (edges,).
        first_edge_of_region: the n-th region has the edges from ``first_edge_of_region[n]`` up to,
            and not including, ``first_edge_of_region[n + 1]``.
        lattice: the `Lattice` of the cells.
        is_in_hole: receives, for each edge, whether it is at a hole's rim, (edges,) bool.
    """
    # ids of cells on a padded lattice: a margin around it, and an empty column between two rows
    width = lattice.width
    padded_width = lattice.width + 3
    id_step_of_direction = np.array(
        [1, padded_width, -1, -padded_width]
    )  # east, south, west and north
    # SAME_REGION in the region's cells at edges; beyond edges, the parents of union-find
    parent = np.full(padded_width * (lattice.height + 3), NO_SURFACE, np.int32)
    inner_cells, outer_cells = np.empty((2, cells.shape[0]), np.int64)
    for region_index in range(first_edge_of_region.shape[0] - 1):
        first_edge = first_edge_of_region[region_index]
        end_edge = first_edge_of_region[region_index + 1]
        first_outer_cell = np.int64(parent.shape[0])
        for edge in range(first_edge, end_edge):
            inner_cells[edge] = (cells[edge] // width + 1) * padded_width + cells[edge] % width + 1
            outer_cells[edge] = inner_cells[edge] + id_step_of_direction[directions[edge]]
            first_outer_cell = min(first_outer_cell, outer_cells[edge])
            parent[inner_cells[edge]] = SAME_REGION
            parent[outer_cells[edge]] = outer_cells[edge]
        for edge in range(first_edge, end_edge):
            cell = outer_cells[edge]
            # each pair of neighbors once: east, and the three in the south
            for neighbor in (
                cell + 1,
                cell + padded_width - 1,
                cell + padded_width,
                cell + padded_width + 1,
            ):
                if parent[neighbor] < 0:
                    continue
                if neighbor != cell + 1 and neighbor != cell + padded_width:
                    # they meet at a corner: the region may connect the two cells between them
                    is_above_region = parent[neighbor - padded_width] == SAME_REGION
                    if is_above_region and parent[cell + padded_width] == SAME_REGION:
                        continue
                unite(parent, cell, neighbor)
        for edge in range(first_edge, end_edge):
            is_in_hole[edge] = find_root(parent, outer_cells[edge]) != first_outer_cell
        for edge in range(first_edge, end_edge):
            parent[inner_cells[edge]] = NO_SURFACE
            parent[outer_cells[edge]] = NO_SURFACE
