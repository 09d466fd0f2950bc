"""The nearest cell of a mask to a point, ring by ring; `place` as in `.crossing`."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from navbake.runtime.kernels.crossing import center, is_in_sight

TO_CENTER, IN_SPACE, TO_OBSTACLE = 0, 1, 2  # what is measured
FAR_OFF = 64.0  # cells beside a level from which on rings don't pay


@njit(cache=True)
def nearest_cell(place, level, mask, floor, point, farthest, measure, height):
    """Find the cell of a level that is the nearest to a point.

    Args:
        place: see the module.
        level: which level.
        mask: by flat id, the cells that count, bool.
        floor: by flat id [m], float64, NaN where there is none.
        point: x, y, z [m], float64; for TO_OBSTACLE, z is the floor's there.
        farthest: the largest distance that counts [m].
        measure: TO_CENTER on the map; IN_SPACE to the centre, on the floor; TO_OBSTACLE to the
            square on the map, but not of cells over or under which another level goes on at the
            point's height.
        height: for TO_OBSTACLE, floors less than this apart are at one height; for IN_SPACE,
            where cells without floor are taken to be [m].

    Returns:
        Its flat id, -1 for none, and the distance [m]; of equally near ones, the lowest id.
    """
    _, width, num_rows, x_min, y_max, cell_size = place
    rows, cols, size = num_rows[level], width[level], cell_size[level]
    v, u = np.floor((y_max[level] - point[1]) / size), np.floor((point[0] - x_min[level]) / size)
    best = (farthest * farthest, np.int64(-1))
    beside = max(0.0, -v, v - rows + 1, -u, u - cols + 1)
    if beside > FAR_OFF:
        for row in range(rows):
            span = (row, 0, cols - 1, 1)
            best = _look(place, level, mask, floor, point, measure, height, span, best)
        return best[1], math.sqrt(best[0])
    row0, col0, ring = int(v), int(u), int(beside)
    last = max(row0, rows - 1 - row0, col0, cols - 1 - col0)
    inside = 1.0 if measure == TO_OBSTACLE else 0.5
    while ring <= last and (max(0.0, ring - inside) * size) ** 2 <= best[0]:
        for row in range(max(0, row0 - ring), min(rows - 1, row0 + ring) + 1):
            left, right, stride = col0 - ring, col0 + ring, 2 * ring
            if abs(row - row0) == ring:
                left, stride = max(0, left), 1
            elif left < 0:
                left = right
            span = (row, left, min(cols - 1, right), stride)
            best = _look(place, level, mask, floor, point, measure, height, span, best)
        ring += 1
    return best[1], math.sqrt(best[0])


@njit(cache=True)
def _look(place, level, mask, floor, point, measure, height, span, best):
    """The better of the best so far and some cells of a row: squared distance, flat id."""
    row, first, last, stride = span
    d2_best, found = best
    start, width, _, x_min, y_max, cell_size = place
    size = cell_size[level]
    for col in range(first, last + 1, stride):
        cell = start[level] + row * width[level] + col
        if not mask[cell]:
            continue
        dx = abs(x_min[level] + (col + 0.5) * size - point[0])
        dy = abs(y_max[level] - (row + 0.5) * size - point[1])
        if measure == TO_OBSTACLE:
            dx, dy = max(0.0, dx - 0.5 * size), max(0.0, dy - 0.5 * size)
        d2 = dx * dx + dy * dy
        if measure == IN_SPACE:
            z = height if math.isnan(floor[cell]) else floor[cell]
            d2 += (z - point[2]) ** 2
        if d2 < d2_best or (d2 == d2_best and (found < 0 or cell < found)):
            if measure == TO_OBSTACLE and _is_elsewhere(
                place, mask, floor, level, cell, point[2], height
            ):
                continue
            d2_best, found = d2, cell
    return d2_best, found


@njit(cache=True)
def _is_elsewhere(place, mask, floor, level, cell, z, height):
    """Whether another level, and not this one, is clear and goes on at a height in a column."""
    if abs(floor[cell] - z) < height:  # False for NaN
        return False
    start, width, rows, x_min, y_max, size = place
    x, y = center(place, cell)
    for other in range(len(width)):
        row = np.floor((y_max[other] - y) / size[other])
        col = np.floor((x - x_min[other]) / size[other])
        if other != level and 0 <= row < rows[other] and 0 <= col < width[other]:
            there = start[other] + np.int64(row) * width[other] + np.int64(col)
            if not mask[there] and abs(floor[there] - z) < height:
                return True
    return False


@njit(cache=True)
def first_in_sight(place, links, clear, floor, room, cell, x, y, candidates):
    """The first of some cells whose centre is in sight of a point, -1 for none.

    Args:
        place, links: see the module.
        clear: by flat id, what one can see through, bool.
        floor, room: see `navbake.runtime.kernels.crossing.walk_line`.
        cell: flat id of the cell that holds x, y.
        x, y: the point [m].
        candidates: flat ids, int64.
    """
    for candidate in candidates:
        to_x, to_y = center(place, candidate)
        if is_in_sight(place, links, clear, floor, room, cell, x, y, candidate, to_x, to_y):
            return candidate
    return np.int64(-1)
