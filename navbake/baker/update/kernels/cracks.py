"""Gaps in floors in a region: `find_gaps` for some cells alone."""

from navbake.baker.kernels.cracks import gaps_of_cell, is_even, mark_standable
from navbake.compiled import kernel


@kernel(nogil=True)
def mark_region_standable(crossings, limits, room, region, begin, end):
    """Fill `stands` and `only` of a `GapRoom` for the cells ``region[begin:end]``."""
    for cell in region[begin:end]:
        room.only[cell] = mark_standable(crossings, cell, limits, room.stands)


@kernel(nogil=True)
def count_gaps_in(lattice, crossings, limits, reach, room, asked, counts, begin, end):
    """Count the gaps of the cells ``asked[begin:end]``.

    Args:
        crossings: by cell id, of the cells and of all at most `reach` cells away from them.
        room: `GapRoom` with the marks of these; `only` is by cell id, NaN for all others. The
            others are empty.
        asked: the cells, ascending.
        counts: receives the numbers, (n,) int64.
    """
    only, width = room.only, lattice.width
    for n in range(begin, end):
        row, col = asked[n] // width, asked[n] % width
        is_inner = reach <= row < lattice.height - reach and reach <= col < width - reach
        counts[n] = 0
        if not (is_inner and is_even(only, asked[n], width, reach, limits.step)):
            place, low, high = (row, col), room.low, room.high
            counts[n] = gaps_of_cell(lattice, crossings, limits, reach, room, place, low, high)


@kernel(nogil=True)
def write_gaps_in(lattice, crossings, limits, reach, room, asked, begin, end):
    """Write the heights of the sides of each gap of the cells ``asked[begin:end]``.

    ``room.start`` tells where the gaps of each belong in `low` and `high`, as `asked` is numbered.
    """
    for n in range(begin, end):
        place, at = (asked[n] // lattice.width, asked[n] % lattice.width), room.start[n]
        low, high = room.low[at:], room.high[at:]
        gaps_of_cell(lattice, crossings, limits, reach, room, place, low, high)
