"""Cells whose line may have fallen into a crack between two floors.

A morphological closing in one dimension (Serra, Image Analysis and Mathematical Morphology, 1982),
from cell to cell in eight ways: a cell without floor between two cells with floors at one height
is a suspect. How wide the gap is, only lines beside the cell's own can tell.
"""

import math

import numpy as np
from numba import njit, prange

from navbake.baker.kernels.arrays import Band
from navbake.baker.kernels.constants import SAME, SLACK, TOUCH
from navbake.baker.kernels.overlap import ANY_GEOM, line_is_blocked

# The eight ways to a neighbour, by row and column
ROW_STEP = np.array([0, 1, 0, -1, 1, 1, -1, -1])
COL_STEP = np.array([1, 0, -1, 0, 1, -1, -1, 1])
# One way of each two that are opposite; the other one's number differs in the bit of two
AXES = (0, 1, 4, 5)


@njit(inline="always")
def _cell_beside(lattice, row, col, way, distance):
    """The cell so many cells away from a row and column, or -1 beyond the lattice."""
    row, col = row + ROW_STEP[way] * distance, col + COL_STEP[way] * distance
    if 0 <= row < lattice.height and 0 <= col < lattice.width:
        return row * lattice.width + col
    return np.int64(-1)


@njit(inline="always")
def _continues(crossings, cell, low, high, limits):
    """Whether a cell has a surface between two heights that is not too steep to stand on."""
    for i in range(crossings.start[cell], crossings.start[cell + 1]):
        is_between = low - SLACK <= crossings.z[i] <= high + SLACK
        if is_between and crossings.normal[i, 2] >= limits.min_up:
            return True
    return False


@njit(inline="always")
def _is_alike(crossings, one, other, limits):
    """Whether two cells have the same surfaces, one by one, within a step: there is no gap."""
    start, z, normal = crossings.start, crossings.z, crossings.normal
    first, beside = start[one], start[other]
    count = start[one + 1] - first
    if count != start[other + 1] - beside:
        return False
    for i in range(count):
        if abs(z[first + i] - z[beside + i]) > limits.step:
            return False
        is_gentle = normal[first + i, 2] >= limits.min_up
        if is_gentle != (normal[beside + i, 2] >= limits.min_up):
            return False
    return True


@njit(inline="always")
def _is_alike_beside(lattice, crossings, row, col, way, limits):
    """Whether a cell is alike the one that way, or the one opposite; or has none there."""
    cell = row * lattice.width + col
    for toward in (way, way ^ 2):
        beside = _cell_beside(lattice, row, col, toward, 1)
        if beside < 0 or _is_alike(crossings, cell, beside, limits):
            return True
    return False


@njit(inline="always")
def _has_room(crossings, cell, i, limits):
    """Whether a crossing of a cell faces up within the slope, with room for an agent."""
    if crossings.normal[i, 2] < limits.min_up:
        return False
    low, high = crossings.z[i] + SAME, crossings.z[i] + limits.headroom - SLACK
    return not line_is_blocked(crossings, cell, Band(low, high), ANY_GEOM)


@njit(inline="always")
def _slope(crossings, i):
    """How steep a crossed surface that faces up is: rise over run."""
    nx, ny, nz = crossings.normal[i, 0], crossings.normal[i, 1], crossings.normal[i, 2]
    return math.hypot(nx, ny) / nz


@njit(inline="always")
def _lower_side(crossings, cell, z, slope, distance, limits):
    """A floor in a cell at a height or below it, or NaN: by a step, and by what slopes make.

    `slope` is that of the floor at the height z, `distance` how far away that is [m].
    """
    for i in range(crossings.start[cell], crossings.start[cell + 1]):
        beside = crossings.z[i]
        if beside > z + SAME or not _has_room(crossings, cell, i, limits):
            continue
        rise = distance * max(slope, _slope(crossings, i))
        if beside >= z - limits.step - rise - SLACK:
            return beside
    return np.nan


@njit(inline="always")
def _lower_side_of_gap(lattice, crossings, limits, reach, row, col, way, distance, i):
    """The floor at the far side of a gap, below the i-th crossing on the near side, or NaN.

    NaN too where something fills the gap: a floor goes on, or the agent's way is barred.
    """
    cell, z = row * lattice.width + col, crossings.z[i]
    if _continues(crossings, cell, z - limits.step, z + limits.step, limits):
        return np.nan
    if not _has_room(crossings, _cell_beside(lattice, row, col, way, distance), i, limits):
        return np.nan
    beside = np.nan
    for back in range(1, reach + 1):
        other = _cell_beside(lattice, row, col, way, -back)
        if other >= 0 and np.isnan(beside):
            away = (distance + back) * lattice.cell_size
            beside = _lower_side(crossings, other, z, _slope(crossings, i), away, limits)
    if np.isnan(beside):
        return np.nan
    # the lower side's floor goes on in the cell, as `floors_near` would find it
    if _continues(crossings, cell, beside - limits.step, z + limits.step, limits):
        return np.nan
    band = Band(z + limits.step + TOUCH, beside + limits.headroom - TOUCH)
    return np.nan if line_is_blocked(crossings, cell, band, ANY_GEOM) else beside


@njit(cache=True)
def _gaps_of_cell(lattice, crossings, limits, reach, row, col, low, high):
    """Write the gaps of one cell, unless there is no room for them; returns their number."""
    count, last = 0, np.inf
    for axis in AXES:
        # a gap has two sides: most cells are alike one of each two that face each other
        if reach == 1 and _is_alike_beside(lattice, crossings, row, col, axis, limits):
            continue
        for way in (axis, axis ^ 2):
            for distance in range(1, reach + 1):
                one = _cell_beside(lattice, row, col, way, distance)
                if one < 0:
                    break
                for i in range(crossings.start[one], crossings.start[one + 1]):
                    z = crossings.z[i]
                    if crossings.normal[i, 2] < limits.min_up or abs(z - last) <= SAME:
                        continue
                    beside = _lower_side_of_gap(
                        lattice, crossings, limits, reach, row, col, way, distance, i
                    )
                    if np.isnan(beside):
                        continue
                    if low.shape[0] > 0:
                        low[count], high[count] = beside, z
                    last = z
                    count += 1
    return count


@njit(cache=True, parallel=True)
def find_gaps(lattice, crossings, limits, reach, start, low, high):
    """Find gaps in floors: cells that have none where cells on both sides have; call it twice.

    On one side, at most `reach` cells away, an agent can stand at the height `high`; on the other
    at `low`, at most a step below, and what the slopes of both make; and in the cell, nothing
    that one could stand on is within a step of the two or between them (the ground round a rock
    has no gap), and nothing is in the agent's way. A face in the cell that is steeper, such as the
    end of a ramp, may be a crack's side.

    Args:
        limits: what an agent can stand on.
        start: (cells + 1,) int64; in the first call, ``start[cell + 1]`` receives the number of
            gaps; in the second, the running sums stand there.
        low, high: empty in the first call; receive the heights of each gap's sides [m].
    """
    for cell in prange(start.shape[0] - 1):
        row, col = np.int64(cell) // lattice.width, np.int64(cell) % lattice.width
        if low.shape[0] == 0:
            count = _gaps_of_cell(lattice, crossings, limits, reach, row, col, low, high)
            start[cell + 1] = count
        elif start[cell + 1] > start[cell]:
            part = low[start[cell] : start[cell + 1]], high[start[cell] : start[cell + 1]]
            _gaps_of_cell(lattice, crossings, limits, reach, row, col, *part)


@njit(cache=True)
def floors_near(crossings, low, high, limits, floor, standable):
    """Find in each column the lowest surface between two heights, NaN for none [m].

    It may be a step lower or higher, and faces up within the slope. `standable` receives the lowest
    one with room for an agent. All but the first and `limits` have one entry a column.
    """
    reach = limits.step + SLACK
    for n in range(floor.shape[0]):
        floor[n] = standable[n] = np.nan
        for i in range(crossings.start[n], crossings.start[n + 1]):
            z = crossings.z[i]
            if not low[n] - reach <= z <= high[n] + reach:
                continue
            if crossings.normal[i, 2] < limits.min_up:
                continue
            if np.isnan(floor[n]):
                floor[n] = z
            if _has_room(crossings, np.int64(n), i, limits):
                standable[n] = z
                break
