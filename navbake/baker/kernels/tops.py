"""Tops of what stands on a floor: how a sheet ends at its edges, and what goes on under it."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from navbake.baker.kernels.sheets import SLACK, neighbour


@njit(cache=True)
def _floor_below(node_start, node_z, sheet, counts, cell, own, z):
    """The highest floor that counts, of another sheet than own, below a height, or NaN."""
    found = math.nan
    for t in range(node_start[cell], node_start[cell + 1]):
        if counts[sheet[t]] and sheet[t] != own and node_z[t] < z:
            found = node_z[t]
    return found


@njit(cache=True)
def _rises(start, z, normals, cell, height):
    """Whether something rises through a height in a column: the next crossing above is a top."""
    for i in range(start[cell], start[cell + 1]):
        if z[i] > height:
            return normals[i, 2] > 0.0
    return False


@njit(cache=True)
def count_drops(
    members, cells, node_start, node_z, sheet, counts, width, height, start, z, normals,
    step, reach, at_cell,
):  # fmt: skip
    """Count how a sheet ends: at each edge one looks a little further, over a bed's frame.

    Args:
        members: the sheet's surfaces, (m,) int64.
        cells: the cell of each standable surface, (n,) int64.
        node_start, node_z, sheet: all standable surfaces by column, and their sheets.
        counts: by sheet, whether it counts.
        width, height: of the lattice.
        start, z, normals: all crossings by column, ascending.
        step: [m].
        reach: how many cells one looks out, >= 1.
        at_cell: (cells,) int64, all -1; receives the sheet's surface in each of its cells, and
            -2 - surface in the cells that one looked over.

    Returns:
        The number of edges between its cells and others, how many of them drop by more than a
        step to a floor that counts, the cells where those floors begin, and the ones that one
        looked over.
    """
    own = sheet[members[0]]
    for node in members:
        at_cell[cells[node]] = node  # of several in a column, the highest
    edges, drops = 0, 0
    floors = np.empty(members.shape[0] * 4, np.int64)
    over = [np.int64(0) for _ in range(0)]
    for node in members:
        for way in range(4):
            other = neighbour(cells[node], way, width, height)
            if other < 0 or at_cell[other] >= 0:
                continue
            edges += 1
            limit = node_z[node] - step - SLACK
            begin = other
            found = False
            for _ in range(reach):
                if other < 0 or at_cell[other] >= 0:
                    break
                if _rises(start, z, normals, other, node_z[node] + step):
                    break
                below = _floor_below(node_start, node_z, sheet, counts, other, own, limit)
                if not math.isnan(below):
                    found = True
                    break
                other = neighbour(other, way, width, height)
            if found:
                floors[drops] = other
                drops += 1
                while begin != other:
                    if at_cell[begin] == -1:
                        at_cell[begin] = -2 - node
                        over.append(begin)
                    begin = neighbour(begin, way, width, height)
    return edges, drops, floors[:drops], np.array(over, dtype=np.int64)


@njit(cache=True)
def count_covered(
    members, cells, node_start, node_z, sheet, counts, width, height,
    start, z, floor_like, step, floors, at_cell, under, queue,
):  # fmt: skip
    """Count the cells of a sheet under which the floor around it goes on, too low to stand on.

    Args:
        members, cells, node_start, node_z, sheet, counts, width, height, start, z: as in
            `count_drops`.
        floor_like: (n,) bool, the crossings where a floor may go on.
        step: [m].
        floors: the cells where the floor around begins, as `count_drops` found them.
        at_cell: as `count_drops` left it.
        under: (cells,) float64, all NaN, and so again afterwards.
        queue: (cells,) int64, to work in.
    """
    own = sheet[members[0]]
    top = node_z[members[0]]
    for node in members:
        top = max(top, node_z[node])
    end = 0
    for cell in floors:
        if math.isnan(under[cell]):
            under[cell] = _floor_below(node_start, node_z, sheet, counts, cell, own, top)
            queue[end] = cell
            end += 1
    covered = 0
    at = 0
    while at < end:
        cell = queue[at]
        at += 1
        for way in range(4):
            other = neighbour(cell, way, width, height)
            if other < 0 or at_cell[other] == -1 or not math.isnan(under[other]):
                continue
            is_own = at_cell[other] >= 0
            node = at_cell[other] if is_own else -2 - at_cell[other]
            roomy = False  # whether one can stand below
            for t in range(node_start[other], node_start[other + 1]):
                if t != node and abs(node_z[t] - under[cell]) <= step + SLACK:
                    roomy = True
            if roomy:
                continue
            for i in range(start[other], start[other + 1]):
                if z[i] >= node_z[node] - step - SLACK:
                    break
                if floor_like[i] and abs(z[i] - under[cell]) <= step + SLACK:
                    under[other] = z[i]
                    covered += 1 if is_own else 0
                    queue[end] = other
                    end += 1
                    break
    for at in range(end):
        under[queue[at]] = math.nan
    return covered
