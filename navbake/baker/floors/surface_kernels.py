"""Surfaces that floors may go on at, cell by cell, and which of them an agent can stand on.

A surface lies inside of a solid by the winding number of the vertical line above it: how many
solids the line leaves there less how many it enters.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.constants import CLOSED_SURFACE, OPEN_SURFACE
from navbake.baker.core.tiles import cell_center
from navbake.baker.core.tolerances import LIMIT_SLACK, SAME_HEIGHT
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Float, Int32

# Marks: a floor may go on at it, an agent can stand on it, nothing lies above it; an agent could
# stand on it if the closed mesh or plane around it were hollow
FLOOR_LIKE = 1
STANDS = 2
TOP = 4
HELD = 8
# Sides that are nearly upright face up by at most this, as those of steps in a building that leans
LEANING = 0.05


class Surfaces(NamedTuple):
    """The floor-like surfaces of all cells: cell i holds ``[first[i], end[i])``.

    The runs of a block of cells lie together, so their order is not that of the cells.

    Attributes:
        lattice: of the cells.
        first, end: (cells,) int32.
        z: heights, ascending in a cell, (n,) float64 [m].
        geom: MuJoCo's geom ids, (n,) int32; of HELD surfaces, that of the mesh or plane around.
        marks: FLOOR_LIKE, STANDS, TOP and HELD, (n,) uint8.
        normal: unit normals, (n, 3) float32; (n, 0) where no slope rises more than a step a cell.
    """

    lattice: Any
    first: Int32
    end: Int32
    z: Float
    geom: Int32
    marks: NDArray[np.uint8]
    normal: NDArray[np.float32]


@subkernel(**NO_REFCOUNT)
def planes_over(planes, lattice, cell, z):
    """How many infinite planes are over a height in a cell, and the geom of the last, or -1."""
    count = 0
    geom = np.int32(-1)
    for p in range(planes.geom.shape[0]):
        x, y = cell_center(lattice, cell)
        depth = (
            planes.mat[p, 2] * (x - planes.pos[p, 0])
            + planes.mat[p, 5] * (y - planes.pos[p, 1])
            + planes.mat[p, 8] * (z - planes.pos[p, 2])
        )
        if depth < -SAME_HEIGHT:
            count = count + 1
            geom = planes.geom[p]
    return count, geom


@subkernel(inline="always")
def _next_above(hits, i, last):
    """The next height above the i-th surface."""
    for j in range(i + 1, last):
        if hits.z[j] - hits.z[i] > SAME_HEIGHT:
            return hits.z[j]
    return math.inf


@subkernel(**NO_REFCOUNT)
def _count_around(hits, i, last):
    """How many closed surfaces hold the i-th surface, and how many other solids.

    A solid that begins at the surface's height (within SAME_HEIGHT) stands on it and holds it; one
    that ends there does not.
    """
    z = hits.z
    normal = hits.normal
    closed = hits.closed
    surfaces = 0
    others = 0
    for j in range(i + 1, last):
        if z[j] - z[i] <= SAME_HEIGHT:
            continue
        turn = 1 if normal[j, 2] > 0.0 else -1
        if closed[j] == CLOSED_SURFACE:
            surfaces += turn
        elif closed[j] != OPEN_SURFACE:
            others += turn
    return surfaces, others


@subkernel(inline="always")
def _find_holder(hits, i, last):
    """The geom of the closed surface around the i-th surface that ends lowest, or -1."""
    z = hits.z
    normal = hits.normal
    geom = hits.geom
    closed = hits.closed
    for j in range(i + 1, last):
        if closed[j] != CLOSED_SURFACE or normal[j, 2] <= 0.0 or z[j] - z[i] <= SAME_HEIGHT:
            continue
        inside = 0
        for k in range(i + 1, last):
            if geom[k] == geom[j] and closed[k] == CLOSED_SURFACE and z[k] - z[i] > SAME_HEIGHT:
                inside += 1 if normal[k, 2] > 0.0 else -1
        if inside > 0:
            return geom[j]
    return np.int32(-1)


@kernel(nogil=True, **NO_REFCOUNT)
def list_surfaces(lattice, hits, planes, limits, cells, counts, columns, begin, end):
    """List the surfaces that floors may go on at in the columns of ``cells[begin:end]``.

    FLOOR_LIKE faces up within the slope, or faces up more steeply at most a step above what does:
    a bump too low to be an obstacle. STANDS faces up within the slope, lies inside of no solid,
    and has the headroom below the next surface; HELD would, without the closed meshes around it or
    the infinite planes over it. Of several surfaces at one height the lowest counts. Where a line
    leaves a solid by a side that leans a little, at most a step above what faces up within the
    slope, the floor is that of the lower side, which STANDS.

    The rows, see `list_rows`: height [m], geom (of HELD surfaces, the one that
    holds them), marks and normal.
    """
    heights, geoms, marks, normals = columns
    num = 0
    for n in range(begin, end):
        first = hits.start[cells[n]]
        last = hits.start[cells[n] + 1]
        before = num
        if num + last - first > heights.shape[0]:
            return n
        previous = -math.inf
        held = -math.inf
        gentle = -math.inf
        at = num
        for i in range(first, last):
            z = hits.z[i]
            up = hits.normal[i, 2]
            is_gentle = up >= limits.min_up
            if not is_gentle and not (up > 0.0 and z - gentle <= limits.step + LIMIT_SLACK):
                continue
            if not is_gentle and up <= LEANING and gentle - previous > SAME_HEIGHT:
                surfaces, others = _count_around(hits, i, last)
                above = _next_above(hits, i, last)
                if surfaces + others <= 0 and above - gentle >= limits.headroom - LIMIT_SLACK:
                    previous = gentle
                    marks[at] |= STANDS if above < math.inf else STANDS | TOP
                    continue
            heights[num] = z
            geoms[num] = hits.geom[i]
            marks[num] = FLOOR_LIKE
            for axis in range(normals.shape[1]):
                normals[num, axis] = hits.normal[i, axis]
            if is_gentle:
                gentle = z
                at = num
                above = _next_above(hits, i, last)
                if z - previous > SAME_HEIGHT and above - z >= limits.headroom - LIMIT_SLACK:
                    surfaces, others = _count_around(hits, i, last)
                    behind, plane = planes_over(planes, lattice, cells[n], z)
                    if surfaces + others + behind <= 0:
                        marks[num] |= STANDS
                        previous = z
                        if hits.z[last - 1] - z <= LIMIT_SLACK:
                            marks[num] |= TOP
                    elif others <= 0 and (surfaces <= 0 or behind == 0) and z - held > SAME_HEIGHT:
                        marks[num] |= HELD
                        held = z
                        holder = _find_holder(hits, i, last)
                        geoms[num] = holder if holder >= 0 else plane
            num += 1
        counts[n] = num - before
    return end


@subkernel(**NO_REFCOUNT)
def slope_joins(surfaces, a, b, way, step):
    """Whether slopes join two surfaces of neighbouring cells that no step joins.

    `b` is east (0) or south (1) of `a`. The slope of each predicts a rise from `a` to `b`, the
    steeper more than a step. They join if the real rise lies between the two, as where a floor
    bends on the way at a ramp's foot, or at most a step from both.
    """
    dz = surfaces.z[b] - surfaces.z[a]
    if abs(dz) <= step + LIMIT_SLACK:
        return False
    normal = surfaces.normal
    cell_size = surfaces.lattice.cell_size
    # rows run south, against y
    axis, turn = (0, -cell_size) if way == 0 else (1, cell_size)
    one = turn * normal[a, axis] / normal[a, 2]
    other = turn * normal[b, axis] / normal[b, 2]
    if max(abs(one), abs(other)) <= step + LIMIT_SLACK:
        return False
    if min(one, other) - LIMIT_SLACK <= dz <= max(one, other) + LIMIT_SLACK:
        return True
    return abs(dz - one) <= step + LIMIT_SLACK and abs(dz - other) <= step + LIMIT_SLACK
