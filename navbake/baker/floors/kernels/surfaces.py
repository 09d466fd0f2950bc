"""Surfaces that floors may go on at, cell by cell, and which of them an agent can stand on.

A column's surfaces are judged from the winding of its line: of solids below a point, how many were
entered and not left.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.kernels.constants import CLOSED_SURFACE, OPEN_SURFACE, SAME, SLACK
from navbake.baker.kernels.tiles import cell_center
from navbake.compiled import UNCOUNTED, kernel, part
from navbake.types import Float, Int, Int32

# What a surface is: a floor may go on at it, an agent can stand on it, nothing lies above it; an
# agent could stand on it if closed meshes held nothing inside
FLOOR_LIKE, STANDS, TOP, HELD = 1, 2, 4, 8
# Sides that are nearly upright face up by at most this, as those of steps in a building that leans
LEANING = 0.05


class Surfaces(NamedTuple):
    """The floor-like surfaces of all cells: cell i holds ``[first[i], first[i] + length[i])``.

    Cells can be replaced one by one, so runs lie in any order, with gaps between them.

    Attributes:
        first: (cells,) int64.
        length: (cells,) int32.
        room: how long each run may become where it is, (cells,) int32.
        z: heights, ascending in a cell, (n,) float64 [m].
        geom: MuJoCo's geom ids, (n,) int32; of HELD surfaces, that of the mesh or plane that does.
        marks: FLOOR_LIKE, STANDS, TOP and HELD, (n,) uint8.
        normal: unit normals, (n, 3) float32; (0, 3) where no slope rises more than a step a cell.
    """

    first: Int
    length: Int32
    room: Int32
    z: Float
    geom: Int32
    marks: NDArray[np.uint8]
    normal: NDArray[np.float32]


@part(**UNCOUNTED)
def planes_over(planes, x, y, z):
    """How many infinite planes have a point behind them, and the geom of one, -1 for none."""
    count, geom = 0, np.int32(-1)
    for p in range(planes.geom.shape[0]):
        depth = (
            planes.mat[p, 2] * (x - planes.pos[p, 0])
            + planes.mat[p, 5] * (y - planes.pos[p, 1])
            + planes.mat[p, 8] * (z - planes.pos[p, 2])
        )
        if depth < -SAME:
            count, geom = count + 1, planes.geom[p]
    return count, geom


@part(**UNCOUNTED)
def look_up(crossings, i, last):
    """How many solids of a column hold the i-th surface, and the height of the next one above.

    A solid that begins at the surface's own height (within SAME) stands on it and covers it: its
    underside doesn't count as left. One that ends there doesn't cover it.

    Returns how many closed surfaces hold it, how many other solids, and the height.
    """
    z, normal, closed = crossings.z, crossings.normal, crossings.closed
    surfaces, others, above = 0, 0, math.inf
    for j in range(i + 1, last):
        if z[j] - z[i] <= SAME:
            continue
        if above == math.inf:
            above = z[j]
        turn = 1 if normal[j, 2] > 0.0 else -1
        if closed[j] == CLOSED_SURFACE:
            surfaces += turn
        elif closed[j] != OPEN_SURFACE:
            others += turn
    return surfaces, others, above


@kernel(nogil=True, **UNCOUNTED)
def mark_surfaces(lattice, cells, crossings, planes, limits, marks, count, begin, end):
    """Mark which crossings are FLOOR_LIKE, STANDS, TOP and HELD, into (n,) uint8.

    Floor-like: faces up within the slope, or faces up more steeply at most a step above one that
    does: a bump too low to be an obstacle. Standable: faces up within the slope, lies inside of
    no solid, and the next surface above is at least the headroom higher; held where it is so but
    for closed meshes around, or for infinite planes over it. Of several surfaces at one height the
    lowest counts. Where a line leaves a solid by a side that leans a little, at most a step above
    what faces up within the slope, it has the floor of the lower side: that is standable there.

    Looks at the columns ``range(begin, end)``, which belong to ``cells``; `count`, int64, receives
    how many of each are floor-like.
    """
    for n in range(begin, end):
        first, last = crossings.start[n], crossings.start[n + 1]
        x, y = cell_center(lattice, cells[n])
        previous, held, gentle, at = -math.inf, -math.inf, -math.inf, first
        count[n] = 0
        for i in range(first, last):
            z, up = crossings.z[i], crossings.normal[i, 2]
            marks[i] = FLOOR_LIKE if up > 0.0 and z - gentle <= limits.step + SLACK else 0
            if up >= limits.min_up:
                marks[i], gentle, at = FLOOR_LIKE, z, i
                surfaces, others, above = look_up(crossings, i, last)
                if z - previous > SAME and above - z >= limits.headroom - SLACK:
                    behind, _ = planes_over(planes, x, y, z)
                    if surfaces + others + behind <= 0:
                        marks[i] |= STANDS
                        previous = z
                        if crossings.z[last - 1] - z <= SLACK:
                            marks[i] |= TOP
                    elif others <= 0 and (surfaces <= 0 or behind == 0) and z - held > SAME:
                        marks[i] |= HELD
                        held = z
            elif marks[i] and up <= LEANING and gentle - previous > SAME:
                surfaces, others, above = look_up(crossings, i, last)
                if surfaces + others <= 0 and above - gentle >= limits.headroom - SLACK:
                    marks[i], previous = 0, gentle
                    marks[at] |= STANDS if above < math.inf else STANDS | TOP
            if marks[i]:
                count[n] += 1


@part(inline="always")
def _find_holder(crossings, i, last):
    """The geom of a closed surface that holds the i-th surface, the one that ends lowest."""
    z, normal, geom, closed = crossings.z, crossings.normal, crossings.geom, crossings.closed
    for j in range(i + 1, last):
        if closed[j] != CLOSED_SURFACE or normal[j, 2] <= 0.0 or z[j] - z[i] <= SAME:
            continue
        inside = 0
        for k in range(i + 1, last):
            if geom[k] == geom[j] and closed[k] == CLOSED_SURFACE and z[k] - z[i] > SAME:
                inside += 1 if normal[k, 2] > 0.0 else -1
        if inside > 0:
            return geom[j]
    return np.int32(-1)


@kernel(nogil=True, **UNCOUNTED)
def list_surfaces(lattice, cells, crossings, planes, marks, found, begin, end):
    """Write the marked crossings of the columns ``range(begin, end)`` into arrays.

    `found` are where each column's begin, and z, geom, marks and normal of all. Surfaces that are
    HELD receive the geom that holds them.
    """
    start, z, geom, kept, normal = found
    for n in range(begin, end):
        at, last = start[n], crossings.start[n + 1]
        for i in range(crossings.start[n], last):
            if marks[i]:
                z[at], geom[at], kept[at] = crossings.z[i], crossings.geom[i], marks[i]
                if marks[i] & HELD:
                    geom[at] = _find_holder(crossings, i, last)
                    if geom[at] < 0:
                        x, y = cell_center(lattice, cells[n])
                        _, geom[at] = planes_over(planes, x, y, z[at])
                if normal.shape[0]:
                    for axis in range(3):
                        normal[at, axis] = crossings.normal[i, axis]
                at += 1


@part(**UNCOUNTED)
def slope_joins(lattice, surfaces, a, b, way, step):
    """Whether slopes join two surfaces of neighbouring cells that no step joins.

    `b` is east (0) or south (1) of `a`. Each one's slope predicts a rise over a cell; the steeper
    is more than a step. Between the predictions lies whatever a floor with these two slopes may
    rise that bends somewhere on the way, as at a ramp's foot; or the rise is at most a step less
    or more than both.
    """
    dz = surfaces.z[b] - surfaces.z[a]
    if abs(dz) <= step + SLACK:
        return False
    normal = surfaces.normal
    # rows run south, against y
    axis, turn = (0, -lattice.cell_size) if way == 0 else (1, lattice.cell_size)
    one, other = turn * normal[a, axis] / normal[a, 2], turn * normal[b, axis] / normal[b, 2]
    if max(abs(one), abs(other)) <= step + SLACK:
        return False
    if min(one, other) - SLACK <= dz <= max(one, other) + SLACK:
        return True
    return abs(dz - one) <= step + SLACK and abs(dz - other) <= step + SLACK
