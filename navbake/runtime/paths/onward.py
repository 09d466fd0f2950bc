"""The next cell on the cheapest path to a goal, from every cell at once."""

import math

import numpy as np

from navbake.runtime.paths.search import Search
from navbake.types import Float, Int

# Functions import kernels when they run: numba takes long to load.


def find_onward(search: Search, field: Float) -> Int:
    """Find where the cheapest path to a goal goes on from each cell.

    Of the steps that a cell has, to its neighbours and over links, the one that is the cheapest
    together with the rest of the way; of equal ones the first in the order of moves, then links.

    Args:
        search: the cells and the steps between them.
        field: what the cheapest path from each cell costs, by flat id, inf for no path; see
            `Search.field`, with weights.

    Returns:
        Flat ids, shape (n,), int64: the cell itself where the goal is, -1 where no path is.
    """
    from navbake.runtime.kernels.moves import COL_STEP, ROW_STEP

    flat, moves = search.flat, search.graph.moves
    onward = np.where(np.isfinite(field), np.arange(len(field)), -1)
    walks = np.flatnonzero(np.isfinite(field) & (field > 0))
    best = np.full(len(field), np.inf)
    level = flat.level_of(walks)
    width, size = flat.layout.width[level], flat.layout.cell_size[level]
    for way, (down, across) in enumerate(zip(ROW_STEP, COL_STEP, strict=True)):
        leads = (moves[walks] >> way) & 1 != 0
        cells = walks[leads]
        targets = cells + down * width[leads] + across
        length = size[leads] * (1.0 if way < 4 else math.sqrt(2.0))
        _take_cheaper(cells, targets, length * flat.weight[targets] + field[targets], best, onward)
    sources, targets = flat.link_ends()
    leads = np.isfinite(field[sources]) & (field[sources] > 0) & np.isfinite(field[targets])
    sources, targets, length = sources[leads], targets[leads], flat.links.length[leads]
    cost = length * flat.weight[targets] + field[targets]
    # of the links of one cell the cheapest, so that each cell is there once
    order = np.lexsort((cost, sources))
    first = np.diff(sources[order], prepend=-1) != 0
    chosen = order[first]
    _take_cheaper(sources[chosen], targets[chosen], cost[chosen], best, onward)
    return onward


def _take_cheaper(cells: Int, targets: Int, cost: Float, best: Float, onward: Int) -> None:
    """Write the targets of those cells, each there once, for which they are cheaper than so far."""
    cheaper = cost < best[cells]
    best[cells[cheaper]], onward[cells[cheaper]] = cost[cheaper], targets[cheaper]
