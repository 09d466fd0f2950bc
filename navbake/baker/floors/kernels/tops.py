"""Tops of what stands on a floor: how a sheet ends at its edges, and what goes on under it.

Edges are looked over along straight lines of cells. The floor around goes on under the sheet as a
flood fill, breadth first with one queue (Moore, The shortest path through a maze, 1959), from cell
to cell as long as heights differ by at most a step.
"""

import math

import numpy as np
from numba import njit

from navbake.baker.floors.kernels.sheets import neighbour
from navbake.baker.kernels.constants import SLACK

# `at_cell` where a sheet is not; one looked over a cell from a surface where it is less
NOT_THERE = -1


@njit(cache=True)
def _floor_below(standable, cell, own, z):
    """The highest floor that counts, of another sheet than own, below a height, or NaN."""
    found = math.nan
    for t in range(standable.start[cell], standable.start[cell + 1]):
        sheet = standable.sheet[t]
        if standable.sheet_size[sheet] > 0 and sheet != own and standable.z[t] < z:
            found = standable.z[t]
    return found


@njit(inline="always")
def _rises(crossings, cell, height):
    """Whether something rises through a height in a column: the next crossing above is a top."""
    for i in range(crossings.start[cell], crossings.start[cell + 1]):
        if crossings.z[i] > height:
            return crossings.normal[i, 2] > 0.0
    return False


@njit(inline="always")
def _look_out(standable, node, way, crossings, step, reach, at_cell):
    """The cell where a floor below begins beyond an edge of a surface, or -1; where one looked.

    One looks past what is lower than the sheet, such as a bed's frame, but not past what rises
    through it.
    """
    lattice, z = standable.lattice, standable.z[node]
    own = standable.sheet[node]
    cell = neighbour(lattice, standable.cell[node], way)
    for _ in range(reach):
        if cell < 0 or at_cell[cell] >= 0 or _rises(crossings, cell, z + step):
            return -1
        if not math.isnan(_floor_below(standable, cell, own, z - step - SLACK)):
            return cell
        cell = neighbour(lattice, cell, way)
    return -1


@njit(cache=True)
def count_drops(standable, members, crossings, step, reach, at_cell):
    """Count how a sheet ends: at each edge one looks a little further, over a bed's frame.

    Args:
        standable: all standable surfaces; a sheet counts while it has members.
        members: the sheet's surfaces, (m,) int64.
        step: [m].
        reach: how many cells one looks out, >= 1.
        at_cell: (cells,) int64, all -1; receives the sheet's surface in each of its cells, and
            -2 - surface in the cells that one looked over.

    Returns:
        How many edges its cells have to others, how many of them drop by more than a step to a
        floor that counts, the cells where those floors begin, and the ones that one looked over.
    """
    for node in members:
        at_cell[standable.cell[node]] = node  # of several in a column, the highest
    edges, drops = 0, 0
    floors = np.empty(members.shape[0] * 4, np.int64)
    over = [np.int64(0) for _ in range(0)]  # an empty list whose type numba knows
    for node in members:
        for way in range(4):
            begin = neighbour(standable.lattice, standable.cell[node], way)
            if begin < 0 or at_cell[begin] >= 0:
                continue
            edges += 1
            end = _look_out(standable, node, way, crossings, step, reach, at_cell)
            if end < 0:
                continue
            floors[drops] = end
            drops += 1
            while begin != end:
                if at_cell[begin] == NOT_THERE:
                    at_cell[begin] = -2 - node
                    over.append(begin)
                begin = neighbour(standable.lattice, begin, way)
    return edges, drops, floors[:drops], np.array(over, dtype=np.int64)


@njit(inline="always")
def _has_room(standable, cell, node, z, step):
    """Whether one can stand in a cell at about a height, on another surface than node."""
    for t in range(standable.start[cell], standable.start[cell + 1]):
        if t != node and abs(standable.z[t] - z) <= step + SLACK:
            return True
    return False


@njit(inline="always")
def _floor_at(crossings, cell, floor_like, z, step, limit):
    """The lowest height below a limit where a floor may go on from another one, or NaN."""
    for i in range(crossings.start[cell], crossings.start[cell + 1]):
        if crossings.z[i] >= limit:
            break
        if floor_like[i] and abs(crossings.z[i] - z) <= step + SLACK:
            return crossings.z[i]
    return math.nan


@njit(cache=True)
def count_covered(standable, members, crossings, floor_like, step, floors, at_cell, under, queue):
    """Count the cells of a sheet under which the floor around it goes on, too low to stand on.

    The floor around floods in under the sheet from where it begins (`floors` of
    `count_drops`, which also leaves `at_cell`). `floor_like` tells the crossings where a floor may
    go on; `under`, (cells,) float64, is all NaN, and so again afterwards; `queue` is scratch.
    """
    own = standable.sheet[members[0]]
    top = standable.z[members[0]]
    for node in members:
        top = max(top, standable.z[node])
    end = 0
    for cell in floors:
        if math.isnan(under[cell]):
            under[cell] = _floor_below(standable, cell, own, top)
            queue[end] = cell
            end += 1
    covered = at = 0
    while at < end:
        cell = queue[at]
        at += 1
        for way in range(4):
            other = neighbour(standable.lattice, cell, way)
            if other < 0 or at_cell[other] == NOT_THERE or not math.isnan(under[other]):
                continue
            is_own = at_cell[other] >= 0
            node = at_cell[other] if is_own else -2 - at_cell[other]
            if _has_room(standable, other, node, under[cell], step):
                continue
            limit = standable.z[node] - step - SLACK
            z = _floor_at(crossings, other, floor_like, under[cell], step, limit)
            if not math.isnan(z):
                under[other] = z
                covered += 1 if is_own else 0
                queue[end] = other
                end += 1
    for at in range(end):
        under[queue[at]] = math.nan
    return covered
