"""What stands in some cells: found by the kernels that list it for all, compared, and kept."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.kernels.contents import count_candidates, list_geoms
from navbake.baker.kernels.flags import BLOCKS, PROBED, STANDS
from navbake.compiled import UNCOUNTED, kernel
from navbake.types import Int, Int32


@kernel(nogil=True)
def count_in_tiles(lattice, solids, planes, lists, footprint, cells, listed, begin, end):
    """`count_candidates` for the tiles ``listed[begin:end]``; `lists` are tiles and groups."""
    tiles, groups = lists
    for tile in listed[begin:end]:
        count_candidates(lattice, solids, planes, tiles, groups, footprint, cells, tile, tile + 1)


@kernel(nogil=True)
def list_in_tiles(lattice, crossings, shapes, lists, footprint, probe, cells, listed, begin, end):
    """`list_geoms` for the tiles ``listed[begin:end]``; `lists` are tiles and groups."""
    tiles, groups = lists
    for tile in listed[begin:end]:
        list_geoms(
            lattice, crossings, shapes, tiles, groups, footprint, probe, cells, tile, tile + 1
        )


class Entries(NamedTuple):
    """The geoms of some cells, ragged as in `LevelContents`.

    Attributes:
        start: shape (cells + 1,), int64.
        geom: MuJoCo's geom ids, ascending in a cell, shape (n,), int32.
        flags: STANDS, BLOCKS and PROBED, shape (n,), uint8.
    """

    start: Int
    geom: Int32
    flags: NDArray[np.uint8]


class EntryPool(NamedTuple):
    """The entries of all cells; cell i holds ``[first[i], first[i] + length[i])``.

    What a cell held before stays where it is: new entries are written behind all others.

    Attributes:
        first: (cells,) int64.
        length: (cells,) int32.
        geom, flags: as in `Entries`, with room at the end.
    """

    first: Int
    length: Int32
    geom: Int32
    flags: NDArray[np.uint8]


@kernel(nogil=True, **UNCOUNTED)
def compare_entries(pool, cells, new, changed, marked):
    """Tell which cells have other entries now.

    Args:
        cells: ascending, and
        new: `Entries` of them.
        changed: receives whether they differ, (cells,) bool.
        marked: by geom id, bool; receives True for all geoms whose entries differ.
    """
    start, geom, flags = new
    for n in range(cells.shape[0]):
        first, count = pool.first[cells[n]], start[n + 1] - start[n]
        changed[n] = pool.length[cells[n]] != count
        for k in range(count):
            if changed[n]:
                break
            i, j = start[n] + k, first + k
            changed[n] = geom[i] != pool.geom[j] or flags[i] != pool.flags[j]
        if not changed[n]:
            continue
        i, j, end = start[n], first, first + pool.length[cells[n]]
        while i < start[n + 1] or j < end:  # a merge
            if j == end or (i < start[n + 1] and geom[i] < pool.geom[j]):
                marked[geom[i]] = True
                i += 1
            elif i == start[n + 1] or pool.geom[j] < geom[i]:
                marked[pool.geom[j]] = True
                j += 1
            else:
                if flags[i] != pool.flags[j]:
                    marked[geom[i]] = True
                i, j = i + 1, j + 1


@kernel(nogil=True, **UNCOUNTED)
def put_entries(pool, cells, new, changed, used):
    """Write the entries of changed cells behind the `used` part; returns how much is used now."""
    start, geom, flags = new
    for n in range(cells.shape[0]):
        if not changed[n]:
            continue
        pool.first[cells[n]], pool.length[cells[n]] = used, start[n + 1] - start[n]
        for i in range(start[n], start[n + 1]):
            pool.geom[used], pool.flags[used] = geom[i], flags[i]
            used += 1
    return used


@kernel(nogil=True)
def take_entries(pool, cells):
    """The entries of some cells."""
    start = np.zeros(cells.shape[0] + 1, np.int64)
    for n in range(cells.shape[0]):
        start[n + 1] = start[n] + pool.length[cells[n]]
    geom, flags = np.empty(start[-1], np.int32), np.empty(start[-1], np.uint8)
    for n in range(cells.shape[0]):
        j = pool.first[cells[n]]
        for i in range(start[n], start[n + 1]):
            geom[i], flags[i] = pool.geom[j], pool.flags[j]
            j += 1
    return Entries(start, geom, flags)


@kernel(nogil=True, **UNCOUNTED)
def mark_geoms(pool, cells, marked):
    """Mark the geoms in some cells, by geom id."""
    for cell in cells:
        for i in range(pool.first[cell], pool.first[cell] + pool.length[cell]):
            marked[pool.geom[i]] = True


@kernel(nogil=True, **UNCOUNTED)
def count_taken(pool, cells, body_of, taken, by):
    """`count_taken_cells` for some cells."""
    for cell in cells:
        first, last = pool.first[cell], pool.first[cell] + pool.length[cell]
        is_free = True
        for i in range(first, last):
            is_free = is_free and (not pool.flags[i] & BLOCKS or body_of[pool.geom[i]] >= 0)
        if not is_free:
            continue
        for i in range(first, last):
            if not pool.flags[i] & BLOCKS:
                continue
            body, is_new = body_of[pool.geom[i]], True
            for j in range(first, i):
                is_known = pool.flags[j] & BLOCKS and body_of[pool.geom[j]] == body
                is_new = is_new and not is_known
            if is_new:
                taken[body] += by


@kernel(nogil=True, **UNCOUNTED)
def measure_entries(pool, cells, floor, low, high, asked, measured):
    """Add what some cells tell of geoms, see `measure_over_floors`.

    Args:
        floor: of all cells [m].
        low, high: of geoms [m].
        asked: the geoms that count, by id, bool.
        measured: base, rise, cells and cells in the walls' band, by geom id.
    """
    base, rise, area, upper_area = measured
    for cell in cells:
        height = floor[cell]
        for i in range(pool.first[cell], pool.first[cell] + pool.length[cell]):
            g = pool.geom[i]
            if not asked[g]:
                continue
            upper_area[g] += 1 if pool.flags[i] & PROBED else 0
            if not pool.flags[i] & STANDS:
                continue
            area[g] += 1
            if low[g] - height < base[g]:
                base[g] = low[g] - height
            if high[g] - max(low[g], height) > rise[g]:
                rise[g] = high[g] - max(low[g], height)
