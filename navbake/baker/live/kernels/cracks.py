"""Gaps in floors in a region: `find_gaps` for some cells alone."""

import numpy as np
from numba import njit

from navbake.baker.kernels.cracks import gaps_of_cell, is_even, mark_standable


@njit(cache=True)
def list_gaps_in(lattice, crossings, limits, reach, room, region, asked):
    """List the gaps of some cells.

    Args:
        crossings: by cell id, of the region at least.
        room: `GapRoom`, of which `stands` is by crossing, and `only` by cell id, NaN everywhere,
            and so again afterwards; the others are empty.
        region: the asked cells and all that are at most `reach` cells away from them.
        asked: the cells, ascending.

    Returns:
        The cell of each gap, and the heights of its sides, as in `find_gaps`.
    """
    only, width, step = room.only, lattice.width, limits.step
    for cell in region:
        only[cell] = mark_standable(crossings, cell, limits, room.stands)
    nothing, count = np.empty(0), 0
    counts = np.zeros(asked.shape[0], np.int64)
    for n in range(asked.shape[0]):
        place = asked[n] // width, asked[n] % width
        is_inner = reach <= place[0] < lattice.height - reach and reach <= place[1] < width - reach
        if is_inner and is_even(only, asked[n], width, reach, step):
            continue
        counts[n] = gaps_of_cell(lattice, crossings, limits, reach, room, place, nothing, nothing)
        count += counts[n]
    cells, low, high, at = np.empty(count, np.int64), np.empty(count), np.empty(count), 0
    for n in range(asked.shape[0]):
        if counts[n] == 0:
            continue
        place = asked[n] // width, asked[n] % width
        gaps_of_cell(lattice, crossings, limits, reach, room, place, low[at:], high[at:])
        cells[at : at + counts[n]] = asked[n]
        at += counts[n]
    for cell in region:
        only[cell] = np.nan
    return cells, low, high
