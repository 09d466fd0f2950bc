"""Cells whose line may have fallen into a crack between two floors.

A morphological closing in one dimension (Serra, Image Analysis and Mathematical Morphology, 1982),
from cell to cell in eight ways: a cell without floor between two cells with floors at one height
is a suspect. How wide the gap is, only lines beside the cell's own can tell.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.baker.kernels.arrays import Band, Crossings
from navbake.baker.kernels.constants import SAME, SLACK, TOUCH
from navbake.baker.kernels.hits import make_hits
from navbake.baker.kernels.overlap import ANY_GEOM, line_is_blocked
from navbake.baker.kernels.rays import cast_line, make_ray, most_hits
from navbake.baker.kernels.tiles import cell_center
from navbake.compiled import UNCOUNTED, kernel, part
from navbake.types import Bool, Float, Int

# The eight ways to a neighbour, by row and column
ROW_STEP = np.array([0, 1, 0, -1, 1, 1, -1, -1])
COL_STEP = np.array([1, 0, -1, 0, 1, -1, -1, 1])
# One way of each two that are opposite; the other one's number differs in the bit of two
AXES = (0, 1, 4, 5)


@part(inline="always")
def _cell_beside(lattice, place, way, distance):
    """The cell so many cells away from a place, its row and column, or -1 beyond the lattice."""
    row, col = place[0] + ROW_STEP[way] * distance, place[1] + COL_STEP[way] * distance
    if 0 <= row < lattice.height and 0 <= col < lattice.width:
        return row * lattice.width + col
    return np.int64(-1)


@part(**UNCOUNTED)
def _continues(crossings, cell, low, high, limits):
    """Whether a cell has a surface between two heights that is not too steep to stand on."""
    for i in range(crossings.start[cell], crossings.start[cell + 1]):
        is_between = low - SLACK <= crossings.z[i] <= high + SLACK
        if is_between and crossings.normal[i, 2] >= limits.min_up:
            return True
    return False


@part(inline="always")
def _has_room(crossings, cell, i, limits):
    """Whether a crossing of a cell faces up within the slope, with room for an agent."""
    if crossings.normal[i, 2] < limits.min_up:
        return False
    low, high = crossings.z[i] + SAME, crossings.z[i] + limits.headroom - SLACK
    return not line_is_blocked(crossings, cell, Band(low, high), ANY_GEOM)


@part(inline="always")
def mark_standable(crossings, cell, limits, stands):
    """Note for each crossing of a cell whether it has room, as `_has_room`; all from above.

    Returns the height of the one that has, NaN for none or several.
    """
    only, count = np.nan, 0
    first, last = crossings.start[cell], crossings.start[cell + 1]
    z, above, inside = crossings.z, last, 0
    for i in range(last - 1, first - 1, -1):
        while above - 1 > i and z[above - 1] > z[i] + SAME:
            above -= 1
            if crossings.closed[above]:
                inside += 1 if crossings.normal[above, 2] > 0.0 else -1
        is_low = above < last and z[above] < z[i] + limits.headroom - SLACK
        stands[i] = crossings.normal[i, 2] >= limits.min_up and inside <= 0 and not is_low
        if stands[i]:
            only, count = z[i], count + 1
    return only if count == 1 else np.nan


@part(inline="always")
def _slope(crossings, i):
    """How steep a crossed surface that faces up is: rise over run."""
    nx, ny, nz = crossings.normal[i, 0], crossings.normal[i, 1], crossings.normal[i, 2]
    return math.hypot(nx, ny) / nz


@part(inline="always")
def _go_on(crossings, stands, one, other, limits):
    """Whether all that an agent can stand on in one cell goes on in another, within a step.

    Mostly the other cell has the same crossings, one by one.
    """
    z, first, last = crossings.z, crossings.start[other], crossings.start[other + 1]
    shift = first - crossings.start[one]
    for i in range(crossings.start[one], crossings.start[one + 1]):
        if not stands[i]:
            continue
        j = i + shift
        if j < last and stands[j] and abs(z[i] - z[j]) <= limits.step:
            continue
        if not _continues(crossings, other, z[i] - limits.step, z[i] + limits.step, limits):
            return False
    return True


@part(inline="always")
def _floors_end(lattice, crossings, room, place, axis, reach, limits):
    """Whether floors end at a place on both sides of it, at most so many cells away.

    A gap has two sides, with a floor on each that ends there. In most cells none does on the first.
    """
    cell = place[0] * lattice.width + place[1]
    for way in (axis, axis ^ 2):
        ends = False
        for distance in range(1, reach + 1):
            beside = _cell_beside(lattice, place, way, distance)
            if not ends and beside >= 0:
                ends = not _go_on(crossings, room.stands, beside, cell, limits)
        if not ends:
            return False
    return True


@part(inline="always")
def _lower_side(crossings, stands, cell, z, slope, distance, limits):
    """A floor in a cell at a height or below it, or NaN: by a step, and by what slopes make.

    `slope` is that of the floor at the height z, `distance` how far away that is [m].
    """
    for i in range(crossings.start[cell], crossings.start[cell + 1]):
        beside = crossings.z[i]
        if beside > z + SAME or not stands[i]:
            continue
        rise = distance * max(slope, _slope(crossings, i))
        if beside >= z - limits.step - rise - SLACK:
            return beside
    return np.nan


@part(inline="always")
def _lower_side_of_gap(lattice, crossings, limits, reach, stands, place, way, distance, i):
    """The floor at the far side of a gap, below the i-th crossing on the near side, or NaN.

    NaN too where something fills the gap: a floor goes on, or the agent's way is barred.
    """
    cell, z, beside = place[0] * lattice.width + place[1], crossings.z[i], np.nan
    if _continues(crossings, cell, z - limits.step, z + limits.step, limits):
        return np.nan
    slope = _slope(crossings, i)
    for back in range(1, reach + 1):
        other = _cell_beside(lattice, place, way, -back)
        if other >= 0 and np.isnan(beside):
            away = (distance + back) * lattice.cell_size
            beside = _lower_side(crossings, stands, other, z, slope, away, limits)
    if np.isnan(beside):
        return np.nan
    # the lower side's floor goes on in the cell, as `probe_lines` would find it
    if _continues(crossings, cell, beside - limits.step, z + limits.step, limits):
        return np.nan
    band = Band(z + limits.step + TOUCH, beside + limits.headroom - TOUCH)
    return np.nan if line_is_blocked(crossings, cell, band, ANY_GEOM) else beside


@part(inline="always")
def is_even(only, cell, width, reach, step):
    """Whether on each axis one side of a cell is within a step of it, by the heights in `only`.

    A quick test for what `_floors_end` finds; the cell is not within `reach` of the lattice's edge.
    """
    here = only[cell]
    for offset in (np.int64(1), width, width + 1, width - 1):
        before, after = True, True
        for distance in range(offset, offset * reach + 1, offset):
            before = before and abs(only[cell - distance] - here) <= step
            after = after and abs(only[cell + distance] - here) <= step
        if not before and not after:
            return False
    return True


@part(**UNCOUNTED)
def gaps_of_cell(lattice, crossings, limits, reach, room, place, low, high):
    """Write the gaps of one cell, unless there is no room for them; returns their number."""
    count, last, stands = 0, np.inf, room.stands
    for axis in AXES:
        if not _floors_end(lattice, crossings, room, place, axis, reach, limits):
            continue
        for way in (axis, axis ^ 2):
            for distance in range(1, reach + 1):
                one = _cell_beside(lattice, place, way, distance)
                if one < 0:
                    break
                for i in range(crossings.start[one], crossings.start[one + 1]):
                    z = crossings.z[i]
                    if not stands[i] or abs(z - last) <= SAME:
                        continue
                    beside = _lower_side_of_gap(
                        lattice, crossings, limits, reach, stands, place, way, distance, i
                    )
                    if np.isnan(beside):
                        continue
                    if low.shape[0] > 0:
                        low[count], high[count] = beside, z
                    last = z
                    count += 1
    return count


class GapRoom(NamedTuple):
    """Room for what is found on the way to gaps.

    Attributes:
        stands: by crossing, whether an agent can stand on it, bool.
        only: by cell, the height of the one crossing that it can stand on, NaN for none or
            several, float64 [m].
        start: (cells + 1,) int64: cell i has the gaps ``[start[i], start[i + 1])``.
        low, high: heights of each gap's sides [m].
    """

    stands: Bool
    only: Float
    start: Int
    low: Float
    high: Float


# The rounds of `find_gaps`
MARK, COUNT, WRITE = range(3)


@kernel(nogil=True, **UNCOUNTED)
def find_gaps(lattice, crossings, limits, reach, room, task, first, end):
    """Find gaps in floors: cells that have none where cells on both sides have; in three rounds.

    On one side, at most `reach` cells away, an agent can stand at the height `high`; on the other
    at `low`, at most a step below, and what the slopes of both make; and in the cell, nothing
    that one could stand on is within a step of the two or between them (the ground round a rock
    has no gap), and nothing is in the agent's way. A face in the cell that is steeper, such as the
    end of a ramp, may be a crack's side. Looks at the rows of cells ``range(first, end)``.

    Args:
        limits: what an agent can stand on.
        room: MARK fills `stands` and `only`; COUNT, into ``start[cell + 1]``, the number of gaps;
            WRITE, where the running sums stand there, the heights.
        task: the round.
    """
    start, only, width, step = room.start, room.only, lattice.width, limits.step
    for row in range(first, end):
        is_inner = reach <= row < lattice.height - reach
        for col in range(width):
            cell, at = row * width + col, np.int64(0)
            if task == MARK:
                only[cell] = mark_standable(crossings, cell, limits, room.stands)
                continue
            if task == WRITE:
                if start[cell + 1] == start[cell]:
                    continue
                at = start[cell]
            elif (
                is_inner
                and reach <= col < width - reach
                and is_even(only, cell, width, reach, step)
            ):
                continue
            low, high = room.low[at:], room.high[at:]
            count = gaps_of_cell(lattice, crossings, limits, reach, room, (row, col), low, high)
            if task == COUNT:
                start[cell + 1] = count


@kernel
def count_gaps(lattice, crossings, limits, reach, room, cells, counts):
    """Count the gaps of some cells, (n,) int64, into `counts`, (n,) int64; see `find_gaps`.

    Only what is within `reach` of the cells is looked at, for which `room` receives its marks.
    """
    for n in range(cells.shape[0]):
        row, col = cells[n] // lattice.width, cells[n] % lattice.width
        for other_row in range(max(0, row - reach), min(lattice.height, row + reach + 1)):
            for other_col in range(max(0, col - reach), min(lattice.width, col + reach + 1)):
                other = other_row * lattice.width + other_col
                mark_standable(crossings, other, limits, room.stands)
        place = row, col
        counts[n] = gaps_of_cell(
            lattice, crossings, limits, reach, room, place, room.low, room.high
        )


@part(inline="always")
def _copy_crossings(source, first, last, into, place):
    """Copy crossings from the first to before the last to a place of others."""
    for i in range(last - first):  # array by array, as memory is copied fastest
        into.z[place + i] = source.z[first + i]
    for i in range(last - first):
        into.geom[place + i] = source.geom[first + i]
    for i in range(last - first):
        into.closed[place + i] = source.closed[first + i]
    for i in range(last - first):
        for axis in range(3):
            into.normal[place + i, axis] = source.normal[first + i, axis]


@kernel(nogil=True, **UNCOUNTED)
def splice_columns(old, new, cells, replaced, first, end):
    """Write columns of which some are replaced; of the cells ``range(first, end)``.

    Args:
        old: the columns of all cells, and
        new: one for each of some `cells`, (n,) int64 ascending; all are `Crossings`.
        replaced: has its `start`, and receives the others.
    """
    k, cell = np.int64(0), first
    while k < cells.shape[0] and cells[k] < first:
        k += 1
    while cell < end:
        stop = end
        if k < cells.shape[0] and cells[k] < end:
            stop = cells[k]
            place = replaced.start[stop]
            _copy_crossings(new, new.start[k], new.start[k + 1], replaced, place)
            k += 1
        _copy_crossings(old, old.start[cell], old.start[stop], replaced, replaced.start[cell])
        cell = stop + 1


class Asked(NamedTuple):
    """Lines beside the centres of cells with gaps.

    Attributes:
        gap: the gap that each is about, (n,) int64.
        offset: from the centre, (n, 2) float64 [m].
    """

    gap: Int
    offset: Float


class Found(NamedTuple):
    """The floors on such lines, NaN for none.

    Attributes:
        floor: the lowest surface between the heights of the gap's sides, (n,) float64 [m]. It may
            be a step lower or higher, and faces up within the slope.
        standable: the lowest such surface with room for an agent, (n,) float64 [m].
    """

    floor: Float
    standable: Float


@part(inline="always")
def _find_floor(crossings, low, high, limits, n, found):
    """Find the floors in the one column of the crossings, and write them as the n-th."""
    reach = limits.step + SLACK
    found.floor[n] = found.standable[n] = np.nan
    for i in range(crossings.start[1]):
        z = crossings.z[i]
        if not low - reach <= z <= high + reach or crossings.normal[i, 2] < limits.min_up:
            continue
        if np.isnan(found.floor[n]):
            found.floor[n] = z
        if _has_room(crossings, np.int64(0), np.int64(i), limits):
            found.standable[n] = z
            break


@part(inline="always")
def _probe_line(gaps, geometry, limits, gap, offset, room, n, found):
    """Find the floors on a line beside the centre of a gap's cell, and write them as the n-th.

    Returns the room that the next line may use: a ray, hits and the start of columns.
    """
    lattice, solids, facets, planes, near, heights = geometry
    ray, hits, start = room
    x, y = cell_center(lattice, gaps.cell[gap])
    most = most_hits(gap, planes, near)
    if most > hits.z.shape[0]:
        hits = make_hits(2 * most)
    x, y = x + offset[0], y + offset[1]
    start[1] = cast_line(x, y, gap, solids, facets, planes, near, heights, ray, hits)
    column = Crossings(start, hits.z, hits.normal, hits.geom, hits.closed)
    _find_floor(column, gaps.low[gap], gaps.high[gap], limits, n, found)
    return ray, hits, start


@kernel(nogil=True)
def probe_lines(gaps, geometry, limits, asked, found, first, end):
    """Find the floors that continue the sides of gaps, on lines beside their cells' centres.

    Args:
        gaps: the cell of each, int64, and the heights of its sides, `low` and `high`.
        geometry: lattice, solids, facets and planes; what lies near each gap's cell, as far as
            the lines go, as `Tiles` have it by tile; and a `Band` below and above everything [m].
        asked: the lines, of which it looks at ``range(first, end)``.
        found: receives the floors.
    """
    room = make_ray(), make_hits(64), np.zeros(2, np.int64)
    for n in range(first, end):
        gap, offset = asked.gap[n], asked.offset[n]
        room = _probe_line(gaps, geometry, limits, gap, offset, room, n, found)


@kernel(nogil=True)
def find_open(gaps, geometry, limits, offsets, run, is_open, first, end):
    """Tell which gaps are open to a side: a number of neighbouring ways round lead to no floor.

    Args:
        gaps, geometry, limits: see `probe_lines`.
        offsets: of a line on each way round from a gap's cell's centre, (ways, 2) [m].
        run: so many ways.
        is_open: (gaps,) bool; receives the answers of ``range(first, end)``.
    """
    room, num = (make_ray(), make_hits(64), np.zeros(2, np.int64)), offsets.shape[0]
    found = Found(np.empty(1), np.empty(1))
    for gap in range(first, end):
        # the misses so far in a row, and those before the first hit: the row may go on there
        count, at_first, way = 0, -1, 0
        while way < num and count < run:
            room = _probe_line(gaps, geometry, limits, gap, offsets[way], room, 0, found)
            if np.isnan(found.floor[0]):
                count += 1
            else:
                at_first = count if at_first < 0 else at_first
                count = 0
            way += 1
        is_open[gap] = count + max(at_first, 0) >= run
