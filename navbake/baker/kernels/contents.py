"""What stands in each cell: every geom that meets its column, and which of them block it."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from navbake.baker.kernels.flags import (
    BLOCKS,
    PROBED,
    STANDS,
    line_flags,
    plane_flags,
    solid_flags,
    triangle_flags,
)
from navbake.baker.kernels.overlap import line_is_blocked, outside, plane_meets_prism
from navbake.baker.kernels.tiles import TILE


@njit(cache=True)
def _group_triangles(items, tri_geom, tri_bounds):
    """Group a tile's triangles, which are sorted by geom: where each begins, and its box."""
    num = 0
    for i in range(items.shape[0]):
        if i == 0 or tri_geom[items[i]] != tri_geom[items[i - 1]]:
            num += 1
    start = np.empty(num + 1, np.int64)
    box = np.empty((num, 6), np.float64)
    group = -1
    for i in range(items.shape[0]):
        bounds = tri_bounds[items[i]]
        if i == 0 or tri_geom[items[i]] != tri_geom[items[i - 1]]:
            group += 1
            start[group] = i
            box[group] = bounds
        for k in range(3):
            box[group, k] = min(box[group, k], bounds[k])
            box[group, k + 3] = max(box[group, k + 3], bounds[k + 3])
    start[num] = items.shape[0]
    return start, box


@njit(cache=True, parallel=True)
def count_candidates(
    x_min, y_max, cell_size, width, height, floors, ceilings, reach,
    solid_start, solid_item, solid_bounds,
    tri_start, tri_item, tri_geom, tri_bounds,
    plane_pos, plane_mat, counts,
):  # fmt: skip
    """Count for each cell the geoms whose boxes meet its column: an upper bound.

    Args:
        floors, ceilings: by cell, float64, NaN where there is no floor [m].
        reach: how far beyond its centre a cell looks [m].
        counts: (cells,) int64, receives the numbers.
    """
    tiles_x = (width + TILE - 1) // TILE
    tiles_y = (height + TILE - 1) // TILE
    for tile in prange(tiles_x * tiles_y):
        solids = solid_item[solid_start[tile] : solid_start[tile + 1]]
        triangles = tri_item[tri_start[tile] : tri_start[tile + 1]]
        _, group_box = _group_triangles(triangles, tri_geom, tri_bounds)
        row0, col0 = tile // tiles_x * TILE, tile % tiles_x * TILE
        for row in range(row0, min(row0 + TILE, height)):
            y = y_max - (row + 0.5) * cell_size
            for col in range(col0, min(col0 + TILE, width)):
                cell = row * width + col
                low, high = floors[cell], ceilings[cell]
                if math.isnan(low):
                    continue
                x = x_min + (col + 0.5) * cell_size
                middle, half_z, count = (low + high) / 2.0, (high - low) / 2.0, 0
                for p in range(plane_pos.shape[0]):
                    if plane_meets_prism(
                        plane_pos[p], plane_mat[p], x, y, middle, reach, reach, half_z
                    ):
                        count += 1
                for s in solids:
                    if not outside(solid_bounds, s, x, y, reach, low, high):
                        count += 1
                for g in range(group_box.shape[0]):
                    if not outside(group_box, g, x, y, reach, low, high):
                        count += 1
                counts[cell] = count


@njit(cache=True)
def _add(out_geom, out_flags, first, count, geom, flags):
    """Insert an entry into a cell's list, which is sorted by geom."""
    if not flags & STANDS:
        flags &= ~PROBED
    if not flags:
        return count
    i = first + count
    while i > first and out_geom[i - 1] > geom:
        out_geom[i], out_flags[i] = out_geom[i - 1], out_flags[i - 1]
        i -= 1
    out_geom[i], out_flags[i] = geom, flags
    return count + 1


@njit(cache=True, parallel=True)
def list_geoms(
    x_min, y_max, cell_size, width, height, floors, ceilings, floor_gap, probe_low, probe_high,
    half, square, radius, band_low, band_high, occupied, probed,
    start, z, normals, geom, closed,
    solid_start, solid_item, solid_geom, solid_kind, solid_pos, solid_mat, solid_size,
    solid_bounds,
    tri_start, tri_item, tri_geom, tri_corners, tri_bounds,
    plane_geom, plane_pos, plane_mat,
    slot, out_geom, out_flags,
):  # fmt: skip
    """List for each cell with a floor the geoms that stand in it or block it.

    A geom stands in a cell when it meets the cell's square between `floor_gap` over the floor
    and the ceiling; it blocks the cell when `check_cells` would find it in the band, which it
    does in occupied cells only; it is PROBED when it stands there and meets the square in the
    probed band. Where rounding leaves no proof that it blocks, it is UNPROVED.

    Args:
        floors, ceilings: by cell, float64, NaN where there is no floor [m]; a ceiling is at
            least as high as the band.
        floor_gap: what a geom has to exceed the floor by [m].
        probe_low, probe_high: the probed band above the floor, ceiling or not [m].
        half: half the edge of the cell's square [m].
        square, radius, band_low, band_high: as for `check_cells`.
        occupied: by cell, bool, what came of `check_cells`.
        probed: by geom id, bool, which geoms are looked for in the probed band.
        start, z, normals, geom: the columns.
        closed: by geom id, whether it encloses a volume.
        slot: (cells + 1,) int64: where each cell may write, see `count_candidates`.
        out_geom, out_flags: int32 and uint8 of length ``slot[-1]``, flags 0 at first; receive
            each cell's geoms, ascending.
    """
    tiles_x = (width + TILE - 1) // TILE
    tiles_y = (height + TILE - 1) // TILE
    widths = (half, square, radius)
    solids = (solid_kind, solid_pos, solid_mat, solid_size, solid_bounds)
    for tile in prange(tiles_x * tiles_y):
        nearby = solid_item[solid_start[tile] : solid_start[tile + 1]]
        triangles = tri_item[tri_start[tile] : tri_start[tile + 1]]
        group_start, group_box = _group_triangles(triangles, tri_geom, tri_bounds)
        scratch = (
            np.empty((4, 3)), np.zeros(4, np.bool_), np.zeros(4, np.bool_), np.empty(3),
            np.empty(3),
        )  # fmt: skip
        one, other = np.empty((12, 3)), np.empty((12, 3))
        reach = max(half, max(square, radius))
        row0, col0 = tile // tiles_x * TILE, tile % tiles_x * TILE
        for row in range(row0, min(row0 + TILE, height)):
            y = y_max - (row + 0.5) * cell_size
            for col in range(col0, min(col0 + TILE, width)):
                cell = row * width + col
                floor, top, here, count = floors[cell], ceilings[cell], slot[cell], 0
                num = slot[cell + 1] - here
                if math.isnan(floor) or num == 0:
                    continue
                x = x_min + (col + 0.5) * cell_size
                low, high = floor + band_low, floor + band_high
                heights = (
                    floor + floor_gap, top, low, high, floor + probe_low, floor + probe_high
                )  # fmt: skip
                column = (z, normals, geom, closed, start[cell], start[cell + 1])
                taken = occupied[cell]
                known = 0
                if taken and num == 1:  # nothing else can be what blocks it
                    known = BLOCKS if radius > 0.0 else BLOCKS | STANDS
                by_line = taken and num > 1 and line_is_blocked(*column, low, high)
                for p in range(plane_geom.shape[0]):
                    if not plane_meets_prism(
                        plane_pos[p], plane_mat[p], x, y, (floor + top) / 2.0, reach, reach,
                        (top - floor) / 2.0,
                    ):  # fmt: skip
                        continue
                    flags = line_flags(column, plane_geom[p], heights, by_line, False)
                    flags = plane_flags(
                        plane_pos[p], plane_mat[p], x, y, widths, heights, taken, known | flags
                    )
                    count = _add(out_geom, out_flags, here, count, plane_geom[p], flags)
                for g in range(group_box.shape[0]):
                    if outside(group_box, g, x, y, reach, floor, top):
                        continue
                    items = triangles[group_start[g] : group_start[g + 1]]
                    of = tri_geom[items[0]]
                    wanted = STANDS | (BLOCKS if taken else 0) | (PROBED if probed[of] else 0)
                    flags = known
                    if flags & wanted != wanted:
                        flags |= line_flags(column, of, heights, by_line, probed[of])
                    flags = triangle_flags(
                        items, tri_corners, tri_bounds, x, y, widths, heights, flags, wanted,
                        one, other,
                    )  # fmt: skip
                    count = _add(out_geom, out_flags, here, count, of, flags)
                for s in nearby:
                    if outside(solid_bounds, s, x, y, reach, floor, top):
                        continue
                    of = solid_geom[s]
                    wanted = STANDS | (BLOCKS if taken else 0) | (PROBED if probed[of] else 0)
                    flags = known
                    if flags & wanted != wanted:
                        flags |= line_flags(column, of, heights, by_line, probed[of])
                    if flags & wanted != wanted:
                        flags = solid_flags(
                            s, solids, x, y, widths, heights, flags, wanted, scratch
                        )
                    count = _add(out_geom, out_flags, here, count, of, flags)


@njit(cache=True, parallel=True)
def describe_floors(floors, start, z, normals, geom, min_up, carrier, gap):
    """Tell of each cell's floor which geom carries it, and how far below the next floor lies.

    Args:
        floors: by cell, float64, NaN where there is none [m].
        start, z, normals, geom: the columns.
        min_up: cosine of the largest slope.
        carrier: (cells,) int32, receives the geom ids, -1 where there is no floor.
        gap: (cells,) float64, receives the height over the nearest surface below that faces up
            and belongs to another geom, inf where there is none [m].
    """
    for cell in prange(floors.shape[0]):
        carrier[cell] = -1
        gap[cell] = math.inf
        floor = floors[cell]
        if math.isnan(floor):
            continue
        for i in range(start[cell], start[cell + 1]):
            if z[i] == floor and normals[i, 2] >= min_up:
                carrier[cell] = geom[i]
                break
        for i in range(start[cell], start[cell + 1]):
            if z[i] > floor:
                break
            if normals[i, 2] >= min_up and geom[i] != carrier[cell]:
                gap[cell] = floor - z[i]


@njit(cache=True)
def count_footings(carrier, gap, standable, limit, covering, cells, over, near, stood_on):
    """Count the cells of one storey by the geom that carries their floor.

    Args:
        carrier: (cells,) int32, -1 for none.
        gap: (cells,) float64, from the floor down to the next one [m].
        standable: (cells,) bool.
        limit: (geoms,) float64, gaps that tell of a floor below [m].
        covering: the same for what covers a floor [m].
        cells, over, near: (geoms,) int64, receive how many cells there are, how many with a gap
            up to the limit, and up to covering.
        stood_on: (geoms,) bool, receives where one can stand on a geom.
    """
    for i in range(carrier.shape[0]):
        geom = carrier[i]
        if geom < 0:
            continue
        cells[geom] += 1
        over[geom] += 1 if gap[i] <= limit[geom] else 0
        near[geom] += 1 if gap[i] <= covering else 0
        stood_on[geom] |= standable[i]


@njit(cache=True)
def measure_standing(start, geom, stands, upper, floors, low, high, base, rise, area, upper_area):
    """Measure how a storey's geoms stand over its floors.

    Args:
        start, geom, stands, upper: the geoms of each cell, ragged: (cells + 1,), (n,) each.
        floors: (cells,) float64 [m].
        low, high: (geoms,) float64, where each begins and ends [m].
        base, rise: (geoms,) float64: least height of its lower end over a floor, and largest of
            its upper end over its lower one or a floor; are lowered and raised [m].
        area, upper_area: (geoms,) int64, receive how many cells it stands in, and those where
            it does so in the wall's band.
    """
    for cell in range(floors.shape[0]):
        for i in range(start[cell], start[cell + 1]):
            g = geom[i]
            upper_area[g] += 1 if upper[i] else 0
            if not stands[i]:
                continue
            area[g] += 1
            floor = floors[cell]
            if low[g] - floor < base[g]:
                base[g] = low[g] - floor
            if high[g] - max(low[g], floor) > rise[g]:
                rise[g] = high[g] - max(low[g], floor)
