"""What stands in the cells of some tiles, by the kernels that list it for all."""

import numpy as np
from numba import njit

from navbake.baker.kernels.contents import count_candidates, list_geoms
from navbake.baker.kernels.flags import BLOCKS, PROBED, STANDS
from navbake.compiled import UNCOUNTED


@njit(cache=True, nogil=True)
def count_in_tiles(lattice, solids, planes, lists, footprint, cells, listed, begin, end):
    """`count_candidates` for the tiles ``listed[begin:end]``; `lists` are tiles and groups."""
    tiles, groups = lists
    for tile in listed[begin:end]:
        count_candidates(lattice, solids, planes, tiles, groups, footprint, cells, tile, tile + 1)


@njit(cache=True, nogil=True)
def list_in_tiles(lattice, crossings, shapes, lists, footprint, probe, cells, listed, begin, end):
    """`list_geoms` for the tiles ``listed[begin:end]``; `lists` are tiles and groups."""
    tiles, groups = lists
    for tile in listed[begin:end]:
        list_geoms(
            lattice, crossings, shapes, tiles, groups, footprint, probe, cells, tile, tile + 1
        )


@njit(cache=True, nogil=True)
def replace_entries(old, cells, start, geom, flags, marked):
    """Replace the entries of some cells of a band.

    Args:
        old: the band: `start`, `geom` and `flags` of its cells, ragged.
        cells: cells of the band, counted from its first, ascending.
        start, geom, flags: the entries of these.
        marked: by geom id, bool; receives True where an entry has changed.

    Returns:
        The new band's three arrays, and which of the cells have changed.
    """
    changed, total = np.zeros(cells.shape[0], np.bool_), old.geom.shape[0]
    for n in range(cells.shape[0]):
        first, last = old.start[cells[n]], old.start[cells[n] + 1]
        count = start[n + 1] - start[n]
        changed[n] = last - first != count
        for k in range(count):
            if changed[n]:
                break
            i, j = start[n] + k, first + k
            changed[n] = geom[i] != old.geom[j] or flags[i] != old.flags[j]
        if changed[n]:
            total += count - (last - first)
            for i in range(start[n], start[n + 1]):
                marked[geom[i]] = True
            for j in range(first, last):
                marked[old.geom[j]] = True
    new_start, new_geom = np.empty_like(old.start), np.empty(total, np.int32)
    new_flags, n, at = np.empty(total, np.uint8), 0, 0
    new_start[0] = 0
    for cell in range(old.start.shape[0] - 1):
        while n < cells.shape[0] and cells[n] < cell:
            n += 1
        if n < cells.shape[0] and cells[n] == cell and changed[n]:
            for i in range(start[n], start[n + 1]):
                new_geom[at], new_flags[at] = geom[i], flags[i]
                at += 1
        else:
            for j in range(old.start[cell], old.start[cell + 1]):
                new_geom[at], new_flags[at] = old.geom[j], old.flags[j]
                at += 1
        new_start[cell + 1] = at
    return new_start, new_geom, new_flags, changed


@njit(cache=True, **UNCOUNTED)
def count_taken(band, cells, body_of, taken, by):
    """`count_taken_cells` for some cells of a band, counted from its first."""
    for cell in cells:
        first, last = band.start[cell], band.start[cell + 1]
        is_free = True
        for i in range(first, last):
            is_free = is_free and (not band.flags[i] & BLOCKS or body_of[band.geom[i]] >= 0)
        if not is_free:
            continue
        for i in range(first, last):
            if not band.flags[i] & BLOCKS:
                continue
            body, is_new = body_of[band.geom[i]], True
            for j in range(first, i):
                is_known = band.flags[j] & BLOCKS and body_of[band.geom[j]] == body
                is_new = is_new and not is_known
            if is_new:
                taken[body] += by


@njit(cache=True, **UNCOUNTED)
def measure_entries(band, first, cells, floor, low, high, asked, measured):
    """Add what some cells of a band tell of geoms, see `measure_over_floors`.

    Args:
        band: see above; `first` is its first cell.
        cells: cells of the band, counted from its first.
        floor: of all cells [m].
        low, high: of geoms [m].
        asked: the geoms that count, by id, bool.
        measured: base, rise, cells and cells in the walls' band, by geom id.
    """
    base, rise, area, upper_area = measured
    for cell in cells:
        height = floor[first + cell]
        for i in range(band.start[cell], band.start[cell + 1]):
            g = band.geom[i]
            if not asked[g]:
                continue
            upper_area[g] += 1 if band.flags[i] & PROBED else 0
            if not band.flags[i] & STANDS:
                continue
            area[g] += 1
            if low[g] - height < base[g]:
                base[g] = low[g] - height
            if high[g] - max(low[g], height) > rise[g]:
                rise[g] = high[g] - max(low[g], height)
