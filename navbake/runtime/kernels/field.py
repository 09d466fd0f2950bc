"""What the cheapest route to the nearest of several goals costs, from every cell: Dijkstra."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from navbake.runtime.kernels.buckets import DIAGONAL, OPEN, USED, make_queue, pop, push
from navbake.runtime.kernels.route import find_slot, level_of


@njit(cache=True, error_model="numpy")
def find_field(
    goals, moves, weight, same_weight, start, width, cell_size, link_cell, link_start,
    link_target, link_length, bucket, num_buckets, field, entry_cell, entry_next,
):  # fmt: skip
    """Find the cost of the cheapest route from every cell to the nearest goal.

    A step costs its length [m] times the weight of the cell that it leads to; from goals, routes
    are followed backwards.

    Args:
        goals: free cells.
        moves, weight, same_weight: as of `navbake.runtime.kernels.route.find_route`.
        start, width, cell_size, link_cell, link_start, link_target, link_length: likewise.
        bucket, num_buckets: see `navbake.runtime.kernels.buckets.bucket_width`.
        field: by cell, float64, inf. Receives the costs.
        entry_cell, entry_next: int32, of one length: room for open cells.

    Returns:
        Whether there was room enough for the open cells.
    """
    head, state = make_queue(num_buckets)
    row_step = np.array([0, -1, 0, 1, -1, -1, 1, 1])
    col_step = np.array([1, 0, -1, 0, 1, -1, -1, 1])
    per_bucket, slack, at = 1.0 / bucket, 1e-9 * bucket, np.int64(0)
    done = np.zeros(moves.shape[0], np.bool_)
    for goal in goals:
        if field[goal] > 0.0:
            if state[USED] == entry_cell.shape[0]:
                return False
            field[goal] = 0.0
            push(head, state, entry_cell, entry_next, at, goal)
    level = 0
    first, columns, size = start[0], width[0], cell_size[0]
    while state[OPEN] > 0:
        cell = pop(head, state, entry_cell, entry_next, at)
        if cell < 0:
            at += 1
            continue
        if done[cell]:
            continue
        done[cell] = True
        here, ways = field[cell], moves[cell]
        if cell < first or cell >= start[level + 1]:
            level = level_of(cell, start)
            first, columns, size = start[level], width[level], cell_size[level]
        slot = find_slot(link_cell, cell)
        num_links = 0 if slot < 0 else link_start[slot + 1] - link_start[slot]
        if state[USED] + 8 + num_links > entry_cell.shape[0]:
            return False
        price = same_weight if same_weight > 0.0 else weight[cell]
        for way in range(8 + num_links):
            if way < 8:
                if not (ways >> way) & 1:
                    continue
                target = cell + row_step[way] * columns + col_step[way]
                length = size if way < 4 else size * DIAGONAL
            else:
                target = link_target[link_start[slot] + way - 8]
                length = link_length[link_start[slot] + way - 8]
                if not math.isfinite(weight[target]):
                    continue
            there = here + length * price
            if there >= field[target] - slack:
                continue
            field[target] = there
            done[target] = False
            push(head, state, entry_cell, entry_next, max(np.int64(there * per_bucket), at), target)
    return True
