"""Lists of the geoms in each cell of a storey: count, measure, mark and copy them, in one pass."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.constants import BUILDING, WALL
from navbake.baker.core.tiles import block_window
from navbake.baker.core.tolerances import LIMIT_SLACK, SAME_HEIGHT
from navbake.baker.occupancy.occupancy_kernels import AT_WALL_HEIGHT, BLOCKING, OCCUPYING
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Float, Int32

# Flags of `flag_columns`: nothing in the column; no floor, and nothing at the height of an agent's
# body; no floor, and ground too steep to stand on under the sky; a floor under the sky; a floor on
# which something stands that reaches above heads
COLUMN_FLAGS = EMPTY, HOLE, BANK, SKY, TALL = 1, 2, 4, 8, 16


class LevelOccupants(NamedTuple):
    """The geoms of a storey's cells; cell i holds those from `first[i]` to the geom -1.

    A list that was written is never written over, so that these contents stay as they are.

    Attributes:
        lattice: the whole lattice.
        first: shape (cells,), int32.
        geom: MuJoCo's geom ids, ascending in a cell, int32.
        flags: of the same length, uint8: OCCUPYING where the geom meets the cell's square between
            floor and ceiling; BLOCKING where it meets the volume of the occupancy; AT_WALL_HEIGHT
            where it stands there and meets the square in `WALL_HEIGHTS`, of wall candidates alone.
        carrier: the geom whose surface each cell's floor is, shape (cells,), int32, -1 for none.
        gap: how far the next geom's floor lies below it, shape (cells,), float64, inf for none [m].
    """

    lattice: Any
    first: Int32
    geom: Int32
    flags: NDArray[np.uint8]
    carrier: Int32
    gap: Float


@subkernel(**NO_REFCOUNT)
def _open_row(columns, row_of, before, num, geom):
    """The row of a geom in the block whose rows begin at `before`, -1 for no room."""
    rows, over = columns
    at = row_of[geom]
    if at < before:
        if num == rows.shape[0]:
            return np.int64(-1)
        at = row_of[geom] = num
        rows[at, 0] = geom
        rows[at, 1:] = 0
        over[at, 0] = math.inf
        over[at, 1] = -math.inf
    return at


@kernel(nogil=True)
def measure_blocks(listed, layers, heights, limits, blocks, counts, columns, begin, end):
    """Measure how a storey's geoms stand over its floors, and carry them, by blocks and geoms.

    The rows, see `list_rows`: the geom, in how many cells it stands, stands in
    the walls' band, carries the floor, lies on a floor, and covers one, and whether one can stand
    on it anywhere, 1 or 0, int64; the least (low - floor), and the greatest (high - max(low,
    floor)), float64 [m].

    Args:
        layers: floors, float64, NaN for none [m], and where one can stand, bool; (cells,).
        heights: of the lower and the upper ends of all geoms [m].
        limits: up to which gaps a geom that carries a floor lies on another one, by geom id, and
            up to which it only covers it [m].
    """
    rows, over = columns
    floors, standable = layers
    lows, highs = heights
    on_floor, covering = limits
    num = np.int64(0)
    row_of = np.full(lows.shape[0], np.int64(-1))
    for k in range(begin, end):
        before = num
        row0, row1, col0, col1 = block_window(listed.lattice, blocks[k])
        for row in range(row0, row1):
            first = row * listed.lattice.width
            for cell in range(first + col0, first + col1):
                i = listed.first[cell]
                while listed.geom[i] >= 0:
                    g = listed.geom[i]
                    flags = np.int64(listed.flags[i])
                    i += 1
                    if not flags & OCCUPYING:
                        continue
                    at = _open_row(columns, row_of, before, num, g)
                    if at < 0:
                        return k
                    num = max(num, at + 1)
                    rows[at, 1] += 1
                    rows[at, 2] += 1 if flags & AT_WALL_HEIGHT else 0
                    floor = floors[cell]
                    low = lows[g]
                    high = highs[g]
                    if low - floor < over[at, 0]:  # never of an endless plane: heights are NaN
                        over[at, 0] = low - floor
                    if high - max(low, floor) > over[at, 1]:
                        over[at, 1] = high - max(low, floor)
                carrier = listed.carrier[cell]
                gap = listed.gap[cell]
                if carrier >= 0:
                    at = _open_row(columns, row_of, before, num, carrier)
                    if at < 0:
                        return k
                    num = max(num, at + 1)
                    rows[at, 3] += 1
                    rows[at, 4] += 1 if gap <= on_floor[carrier] else 0
                    rows[at, 5] += 1 if gap <= covering else 0
                    rows[at, 6] |= 1 if standable[cell] else 0
        counts[k] = num - before
    return end


@kernel(nogil=True, **NO_REFCOUNT)
def mark_walls(listed, kinds, cells, walls, lows, begin, end):
    """Mark which of ``cells[begin:end]`` a wall stands in and blocks; and those blocked only low.

    A building's mesh stands in the latter and blocks them, but not in the walls' band.
    """
    for n in range(begin, end):
        i = listed.first[cells[n]]
        walls[n] = False
        lows[n] = False
        is_upper = False
        while listed.geom[i] >= 0:
            kind = kinds[listed.geom[i]]
            flags = np.int64(listed.flags[i])
            i += 1
            if not flags & OCCUPYING:
                continue
            if kind == BUILDING and flags & AT_WALL_HEIGHT:
                is_upper = True
            if flags & BLOCKING:
                walls[n] |= kind == WALL or (kind == BUILDING and flags & AT_WALL_HEIGHT != 0)
                lows[n] |= kind == BUILDING
        lows[n] &= not is_upper


@kernel(nogil=True)
def flag_columns(hits, floor, ground, limits, above_heads, flags, begin, end):
    """Find the `COLUMN_FLAGS` of cells ``[begin, end)`` of a level.

    ColumnHits and `floor`, NaN for none [m], are numbered as the cells are. A cell without a floor
    is a hole if the next surface more than a step over the level's `ground` is higher than the
    agent, unless it is a top. What stands on a floor is tall from `above_heads` on [m].
    """
    start = hits.start
    z = hits.z
    normal = hits.normal
    min_up = np.float32(limits.min_up)
    for n in range(begin, end):
        entry = start[n]
        last = start[n + 1]
        has_floor = not np.isnan(floor[n])
        found = 0 if entry < last else EMPTY
        top = z[last - 1] if entry < last else np.inf
        up = normal[last - 1, 2] if entry < last else np.float32(0.0)
        least = floor[n] + SAME_HEIGHT if has_floor else ground + limits.step
        while entry < last and z[entry] <= least:
            entry += 1
        is_top = entry < last and normal[entry, 2] > 0.0
        if has_floor:
            if top <= floor[n] + limits.headroom + LIMIT_SLACK:
                found |= SKY
            if is_top and z[entry] > floor[n] + above_heads:
                found |= TALL
        else:
            if up > 0.0 and up < min_up:
                found |= BANK
            if not is_top and (entry == last or z[entry] > ground + limits.headroom):
                found |= HOLE
        flags[n] = found
