"""Cells whose line may have fallen into a crack between two floors.

A morphological closing in one dimension (Serra, Image Analysis and Mathematical Morphology, 1982),
from cell to cell in eight ways: a cell without floor between two cells with floors at one height
is a suspect. How wide the gap is, only lines beside the cell's own can tell.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from navbake.baker.kernels.arrays import Band, Crossings
from navbake.baker.kernels.constants import SAME, SLACK, TOUCH
from navbake.baker.kernels.hits import make_hits
from navbake.baker.kernels.overlap import ANY_GEOM, line_is_blocked
from navbake.baker.kernels.rays import cast_line, make_ray, most_hits
from navbake.baker.kernels.tiles import cell_center, tile_of
from navbake.types import Float, Int

# The eight ways to a neighbour, by row and column
ROW_STEP = np.array([0, 1, 0, -1, 1, 1, -1, -1])
COL_STEP = np.array([1, 0, -1, 0, 1, -1, -1, 1])
# One way of each two that are opposite; the other one's number differs in the bit of two
AXES = (0, 1, 4, 5)
# Lines that one thread probes in a row
CHUNK = 64


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
def _goes_on(crossings, one, other, limits):
    """Whether all that is not too steep to stand on in one cell goes on in another, within a step.

    Most cells have what their neighbours have, one by one.
    """
    z, normal = crossings.z, crossings.normal
    first, last = crossings.start[other], crossings.start[other + 1]
    shift = first - crossings.start[one]
    for i in range(crossings.start[one], crossings.start[one + 1]):
        if normal[i, 2] < limits.min_up:
            continue
        j = i + shift
        if j < last and abs(z[i] - z[j]) <= limits.step and normal[j, 2] >= limits.min_up:
            continue
        if not _continues(crossings, other, z[i] - limits.step, z[i] + limits.step, limits):
            return False
    return True


@njit(inline="always")
def _all_go_on(lattice, crossings, row, col, way, reach, limits):
    """Whether all floors that way, so many cells away at most, go on in a cell: then it has no gap.

    For a gap has two sides, and a floor on each that ends there.
    """
    cell = row * lattice.width + col
    for distance in range(1, reach + 1):
        beside = _cell_beside(lattice, row, col, way, distance)
        if beside >= 0 and not _goes_on(crossings, beside, cell, limits):
            return False
    return True


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
        one_side, other_side = axis, axis ^ 2
        if _all_go_on(lattice, crossings, row, col, one_side, reach, limits):
            continue
        if _all_go_on(lattice, crossings, row, col, other_side, reach, limits):
            continue
        for way in (one_side, other_side):
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


@njit(inline="always")
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


@njit(cache=True)
def _probe_chunk(chunk, gaps, geometry, limits, asked, found):
    """Find the floors on a chunk of lines, see `probe_lines`."""
    lattice, solids, facets, planes, tiles, heights = geometry
    ray, hits, start = make_ray(), make_hits(64), np.zeros(2, np.int64)
    for n in range(chunk * CHUNK, min((chunk + 1) * CHUNK, asked.gap.shape[0])):
        gap = asked.gap[n]
        x, y = cell_center(lattice, gaps.cell[gap])
        x, y = x + asked.offset[n, 0], y + asked.offset[n, 1]
        tile = tile_of(lattice, gaps.cell[gap])
        most = most_hits(tile, planes, tiles)
        if most > hits.z.shape[0]:
            hits = make_hits(2 * most)
        start[1] = cast_line(x, y, tile, solids, facets, planes, tiles, heights, ray, hits)
        column = Crossings(start, hits.z, hits.normal, hits.geom, hits.closed)
        _find_floor(column, gaps.low[gap], gaps.high[gap], limits, n, found)


@njit(cache=True, parallel=True)
def probe_lines(gaps, lattice, solids, facets, planes, tiles, heights, limits, asked, found):
    """Find the floors that continue the sides of gaps, on lines beside their cells' centres.

    Args:
        gaps: the cell of each, int64, and the heights of its sides, `low` and `high`.
        tiles: what lies near each tile of cells, as far as the lines go.
        heights: a `Band` below and above everything [m].
        asked: the lines.
        found: receives the floors.
    """
    for chunk in prange((asked.gap.shape[0] + CHUNK - 1) // CHUNK):
        geometry = (lattice, solids, facets, planes, tiles, heights)
        _probe_chunk(np.int64(chunk), gaps, geometry, limits, asked, found)
