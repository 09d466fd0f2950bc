"""What the cheapest route to the nearest of several goals costs, from every cell.

Dijkstra's algorithm (1959) from all goals at once, backwards, with a bucket queue, see
`navbake.runtime.kernels.buckets`. A cell that gets cheaper after it was expanded is expanded
again, so the costs are exact.
"""

import math

import numpy as np

from navbake.compiled import kernel
from navbake.runtime.kernels.arrays import find_slot, level_of
from navbake.runtime.kernels.buckets import DIAGONAL, OPEN, USED, make_queue, pop, push
from navbake.runtime.kernels.moves import COL_STEP, ROW_STEP


@kernel
def find_field(graph, goals, field, entries):
    """Write the cost from every cell to the nearest of some free goals into `field`, inf before.

    False if there are too few entries for the open cells.
    """
    start, width, cell_size = graph.layout.start, graph.layout.width, graph.layout.cell_size
    link_cell, link_start, link_target, link_length = graph.links
    moves, weight, same_weight = graph.moves, graph.weight, graph.same_weight
    entry_cell, entry_next = entries
    head, state = make_queue(graph.num_buckets)
    per_bucket, slack, at = 1.0 / graph.bucket, 1e-9 * graph.bucket, np.int64(0)
    done = np.zeros(moves.shape[0], np.bool_)
    for goal in goals:
        if field[goal] > 0.0:  # a goal may be given twice
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
            level = level_of(start, cell)
            first, columns, size = start[level], width[level], cell_size[level]
        slot = find_slot(link_cell, cell)
        num_links = 0 if slot < 0 else link_start[slot + 1] - link_start[slot]
        if state[USED] + 8 + num_links > entry_cell.shape[0]:
            return False
        # Backwards, the step that is added leads into this cell, so its weight is this cell's.
        # Steps lead both ways, so the moves out of a cell are those into it.
        price = same_weight if same_weight > 0.0 else weight[cell]
        for way in range(8 + num_links):
            if way < 8:
                if not (ways >> way) & 1:
                    continue
                target = cell + ROW_STEP[way] * columns + COL_STEP[way]
                length = size if way < 4 else size * DIAGONAL
            else:
                link = link_start[slot] + way - 8
                target, length = link_target[link], link_length[link]
                if not math.isfinite(weight[target]):
                    continue
            there = here + length * price
            if there >= field[target] - slack:
                continue
            field[target] = there
            done[target] = False
            push(head, state, entry_cell, entry_next, max(np.int64(there * per_bucket), at), target)
    return True
