"""The lists of what stands in cells: counted, measured, marked and copied; see `LevelContents`."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.kernels.constants import BUILDING, WALL
from navbake.baker.kernels.walk import BLOCKS, PROBED, STANDS
from navbake.compiled import UNCOUNTED, kernel
from navbake.types import Float, Int32


class LevelContents(NamedTuple):
    """The geoms of a storey's cells; cell i holds those from `first[i]` to the geom -1.

    A list that was written is never written over, so that these contents stay as they are.

    Attributes:
        lattice: the whole lattice.
        first: shape (cells,), int32.
        geom: MuJoCo's geom ids, ascending in a cell, int32.
        flags: of the same length, uint8: STANDS where the geom meets the cell's square between
            floor and ceiling; BLOCKS where it meets the volume that the occupancy is about; PROBED
            where it stands there and meets the square in `WALL_BAND`, be that above the ceiling or
            not, which is asked only of `wall_candidates`.
        carrier: the geom whose surface each cell's floor is, shape (cells,), int32, -1 for none.
        gap: how far the next geom's floor lies below it, shape (cells,), float64, inf for none [m];
            as it is in the newest contents.
    """

    lattice: Any
    first: Int32
    geom: Int32
    flags: NDArray[np.uint8]
    carrier: Int32
    gap: Float


@kernel(nogil=True)
def take_entries(listed):
    """All that stands in a storey's cells, by cell and then geom: cells, geoms and flags."""
    first, geom, flags = listed.first, listed.geom, listed.flags
    count = 0
    for cell in range(first.shape[0]):
        i = first[cell]
        while geom[i] >= 0:
            i += 1
        count += i - first[cell]
    entries = np.empty(count, np.int64), np.empty(count, np.int32), np.empty(count, np.uint8)
    count = 0
    for cell in range(first.shape[0]):
        i = first[cell]
        while geom[i] >= 0:
            entries[0][count], entries[1][count], entries[2][count] = cell, geom[i], flags[i]
            i, count = i + 1, count + 1
    return entries


@kernel(nogil=True, **UNCOUNTED)
def measure_over_floors(listed, floors, extents, over, cells, upper_cells):
    """Measure how a storey's geoms stand over its floors, into (geoms,) arrays.

    Args:
        over: the least height of a geom's lower end over a floor, and the largest of its upper end
            over its lower one or a floor; are lowered and raised [m].
        cells, upper_cells: receive in how many cells it stands, and does so in the walls' band.
    """
    base, rise = over
    cells[:], upper_cells[:] = 0, 0
    for cell in range(floors.shape[0]):
        i = listed.first[cell]
        while listed.geom[i] >= 0:
            g, flags = listed.geom[i], np.int64(listed.flags[i])
            i += 1
            if not flags & STANDS:
                continue
            cells[g] += 1
            upper_cells[g] += 1 if flags & PROBED else 0
            floor, low, high = floors[cell], extents.low[g], extents.high[g]
            if low - floor < base[g]:  # never of an endless plane, whose heights are NaN
                base[g] = low - floor
            if high - max(low, floor) > rise[g]:
                rise[g] = high - max(low, floor)


@kernel(nogil=True, **UNCOUNTED)
def count_supports(listed, standable, limit, covering, counts, stood_on):
    """Count the cells of one storey by the geom that carries their floor.

    Args:
        standable: (cells,) bool.
        limit: (geoms,) float64, gaps up to this mean that the geom lies on a floor [m].
        covering: gaps up to this mean that it only covers one [m].
        counts: by geom, (3, geoms) int64: of all such cells, of those where it lies on a floor, and
            of those where it covers one; are added to.
        stood_on: receives whether one can stand on a geom anywhere, (geoms,) bool.
    """
    for i in range(listed.carrier.shape[0]):
        geom = listed.carrier[i]
        if geom < 0:
            continue
        counts[0, geom] += 1
        counts[1, geom] += 1 if listed.gap[i] <= limit[geom] else 0
        counts[2, geom] += 1 if listed.gap[i] <= covering else 0
        stood_on[geom] |= standable[i]


@kernel(nogil=True, **UNCOUNTED)
def mark_walls(listed, kinds, cells, walls, lows):
    """Mark which of some cells a wall stands in and blocks, and which are blocked only low.

    The latter are those that a building's mesh stands in and blocks, but not in the walls' band.
    """
    for n in range(cells.shape[0]):
        i = listed.first[cells[n]]
        walls[n], lows[n], is_upper = False, False, False
        while listed.geom[i] >= 0:
            kind, flags = kinds[listed.geom[i]], np.int64(listed.flags[i])
            i += 1
            if not flags & STANDS:
                continue
            if kind == BUILDING and flags & PROBED:
                is_upper = True
            if flags & BLOCKS:
                walls[n] |= kind == WALL or (kind == BUILDING and flags & PROBED != 0)
                lows[n] |= kind == BUILDING
        lows[n] &= not is_upper


@kernel(nogil=True, **UNCOUNTED)
def count_taken(listed, cells, body_of, taken, by):
    """Add `by` to what each body has in `taken` for each of some cells that it takes.

    A body takes a cell that it blocks where all that blocks the cell is on bodies with a free
    joint, `body_of` each geom, -1 for none. So a cup on a table takes none.
    """
    geom, flags = listed.geom, listed.flags
    for cell in cells:
        i, is_free = listed.first[cell], True
        while geom[i] >= 0:
            is_free = is_free and (not flags[i] & BLOCKS or body_of[geom[i]] >= 0)
            i += 1
        for one in range(listed.first[cell], i if is_free else 0):
            is_new = flags[one] & BLOCKS != 0
            for j in range(listed.first[cell], one):
                is_known = flags[j] & BLOCKS and body_of[geom[j]] == body_of[geom[one]]
                is_new = is_new and not is_known
            if is_new:
                taken[body_of[geom[one]]] += by
