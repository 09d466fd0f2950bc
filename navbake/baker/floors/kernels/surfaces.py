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

# What a surface is: a floor may go on at it, an agent can stand on it, nothing lies above it
FLOOR_LIKE, STANDS, TOP = 1, 2, 4


class Surfaces(NamedTuple):
    """The floor-like surfaces of all cells: cell i holds ``[first[i], first[i] + length[i])``.

    Cells can be replaced one by one, so runs lie in any order, with gaps between them.

    Attributes:
        first: (cells,) int64.
        length: (cells,) int32.
        room: how long each run may become where it is, (cells,) int32.
        z: heights, ascending in a cell, (n,) float64 [m].
        geom: MuJoCo's geom ids, (n,) int32.
        marks: FLOOR_LIKE, STANDS and TOP, (n,) uint8.
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
def count_planes_over(planes, x, y, z):
    """How many infinite planes have a point behind them."""
    count = 0
    for p in range(planes.geom.shape[0]):
        depth = (
            planes.mat[p, 2] * (x - planes.pos[p, 0])
            + planes.mat[p, 5] * (y - planes.pos[p, 1])
            + planes.mat[p, 8] * (z - planes.pos[p, 2])
        )
        if depth < -SAME:
            count += 1
    return count


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
    """Mark which crossings are FLOOR_LIKE, STANDS and TOP, into (n,) uint8.

    Floor-like: faces up within the slope, or faces up more steeply at most a step above one that
    does: a bump too low to be an obstacle. Standable: faces up within the slope, lies inside of
    no solid, and the next surface above is at least the headroom higher. Of several surfaces at
    one height the lowest counts. Looks at the columns ``range(begin, end)``, which belong to
    ``cells``; `count`, int64, receives how many of each are floor-like.
    """
    for n in range(begin, end):
        first, last = crossings.start[n], crossings.start[n + 1]
        previous, gentle = -math.inf, -math.inf
        count[n] = 0
        for i in range(first, last):
            z, up = crossings.z[i], crossings.normal[i, 2]
            marks[i] = FLOOR_LIKE if up > 0.0 and z - gentle <= limits.step + SLACK else 0
            if up >= limits.min_up:
                marks[i] = FLOOR_LIKE
                gentle = z
                if z - previous > SAME:
                    surfaces, others, above = look_up(crossings, i, last)
                    if above - z >= limits.headroom - SLACK:
                        x, y = cell_center(lattice, cells[n])
                        if surfaces + others + count_planes_over(planes, x, y, z) <= 0:
                            marks[i] |= STANDS
                            previous = z
                            if crossings.z[last - 1] - z <= SLACK:
                                marks[i] |= TOP
            if marks[i]:
                count[n] += 1


@kernel(nogil=True, **UNCOUNTED)
def list_surfaces(crossings, marks, start, z, geom, kept, normal, begin, end):
    """Write the marked crossings of the columns ``range(begin, end)`` from ``start`` on."""
    for n in range(begin, end):
        at = start[n]
        for i in range(crossings.start[n], crossings.start[n + 1]):
            if marks[i]:
                z[at], geom[at], kept[at] = crossings.z[i], crossings.geom[i], marks[i]
                if normal.shape[0]:
                    for axis in range(3):
                        normal[at, axis] = crossings.normal[i, axis]
                at += 1


@kernel(nogil=True, **UNCOUNTED)
def put_surfaces(surfaces, cells, start, z, geom, marks, normal, used, changed):
    """Replace the surfaces of some cells; those that are too many go behind `used`.

    `changed`, (cells of the list,) bool, receives which of them are others now, to the last bit of
    their heights. Returns how much is used then; writes nothing where that is more than there is
    room for.
    """
    most = used
    for n in range(cells.shape[0]):
        count = start[n + 1] - start[n]
        most += count if count > surfaces.room[cells[n]] else 0
    if most > surfaces.z.shape[0]:
        return most
    for n in range(cells.shape[0]):
        cell, count = cells[n], start[n + 1] - start[n]
        changed[n] = count != surfaces.length[cell]
        if count > surfaces.room[cell]:
            surfaces.first[cell], surfaces.room[cell] = used, count
            used += count
        surfaces.length[cell] = count
        for k in range(count):
            i, j = start[n] + k, surfaces.first[cell] + k
            if not changed[n]:
                changed[n] = (
                    z[i] != surfaces.z[j]
                    or math.copysign(1.0, z[i]) != math.copysign(1.0, surfaces.z[j])
                    or geom[i] != surfaces.geom[j]
                    or marks[i] != surfaces.marks[j]
                )
            surfaces.z[j], surfaces.geom[j], surfaces.marks[j] = z[i], geom[i], marks[i]
            if normal.shape[0]:
                for axis in range(3):
                    if normal[i, axis] != surfaces.normal[j, axis]:
                        changed[n] = True
                    surfaces.normal[j, axis] = normal[i, axis]
    return used
