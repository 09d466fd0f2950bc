"""What stands in each cell: every geom that meets its column, and which of them block it."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from navbake.kernels.overlap import (
    APART,
    BOX,
    CYLINDER,
    MEETS,
    OPEN,
    line_is_blocked,
    plane_meets_prism,
    solid_meets_prism,
    triangle_meets_prism,
)
from navbake.kernels.tiles import TILE

# What an entry says of its geom: it stands in the cell, it meets the occupancy's volume, it
# meets the square in the probed band, and the occupancy's volume without a proof either way
STANDS, BLOCKS, PROBED, UNPROVED = 1, 2, 4, 8


@njit(cache=True)
def _outside(box, x, y, reach, low, high):
    return (
        box[0] >= x + reach
        or box[3] <= x - reach
        or box[1] >= y + reach
        or box[4] <= y - reach
        or box[2] >= high
        or box[5] <= low
    )


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
    num_planes, counts,
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
                count = num_planes
                for s in solids:
                    if not _outside(solid_bounds[s], x, y, reach, low, high):
                        count += 1
                for g in range(group_box.shape[0]):
                    if not _outside(group_box[g], x, y, reach, low, high):
                        count += 1
                counts[cell] = count


@njit(cache=True)
def _line_meets(column, wanted, low, high):
    """Whether a column's line proves that one geom is between two heights."""
    z, normals, geom, closed, first, last = column
    inside = 0
    for i in range(last - 1, first - 1, -1):
        if z[i] <= low:
            break
        if geom[i] != wanted:
            continue
        if z[i] < high:
            return True
        if closed[wanted]:
            inside += 1 if normals[i, 2] > 0.0 else -1
    return inside > 0


@njit(cache=True)
def _line_flags(column, wanted, heights):
    """What a cell's line alone proves of a geom."""
    floor, ceiling, low, high, _, _, blocked = heights
    flags = 0
    if _line_meets(column, wanted, floor, ceiling):
        flags |= STANDS
    if blocked and _line_meets(column, wanted, low, high):
        flags |= BLOCKS
    return flags


@njit(cache=True)
def _plane_flags(pos, mat, x, y, widths, heights, flags):
    """Add what the half-space behind a plane meets."""
    half, square, radius = widths
    floor, ceiling, low, high, _, _, _ = heights
    middle, half_z = (floor + ceiling) / 2.0, (ceiling - floor) / 2.0
    if plane_meets_prism(pos, mat, x, y, middle, half, 0.0, half_z):
        flags |= STANDS
    middle, half_z = (low + high) / 2.0, (high - low) / 2.0
    if plane_meets_prism(pos, mat, x, y, middle, square, radius, half_z):
        flags |= BLOCKS
    return flags


@njit(cache=True)
def _triangle_flags(items, corners, bounds, x, y, widths, heights, flags, wanted, one, other):
    """Add what a geom's triangles meet, until all wanted flags are set."""
    half, square, radius = widths
    floor, ceiling, low, high, probe_low, probe_high, _ = heights
    reach = max(square, radius)
    for t in items:
        if flags & wanted == wanted:
            break
        box, tri = bounds[t], corners[t]
        if not flags & BLOCKS and not _outside(box, x, y, reach, low, high):
            if triangle_meets_prism(tri, x, y, low, high, square, radius, one, other):
                flags |= BLOCKS
        if not flags & STANDS and not _outside(box, x, y, half, floor, ceiling):
            if triangle_meets_prism(tri, x, y, floor, ceiling, half, 0.0, one, other):
                flags |= STANDS
        if wanted & ~flags & PROBED and not _outside(box, x, y, half, probe_low, probe_high):
            if triangle_meets_prism(tri, x, y, probe_low, probe_high, half, 0.0, one, other):
                flags |= PROBED
    return flags


@njit(cache=True)
def _solid_part(kind, pos, mat, size, x, y, low, high, half, is_round, scratch, keeps):
    """APART, MEETS or OPEN for a solid and a prism; APART for a prism of no width."""
    if half <= 0.0:
        return APART
    return solid_meets_prism(
        kind, pos, mat, size, x, y, (low + high) / 2.0, half, (high - low) / 2.0, is_round,
        scratch[:4], keeps[0], keeps[1], scratch[4], scratch[5],
    )  # fmt: skip


@njit(cache=True)
def _is_upright(kind, mat):
    """Whether a solid has the same section at each of its heights."""
    if kind == CYLINDER:
        return abs(mat[8]) == 1.0
    return kind == BOX and abs(mat[6]) + abs(mat[7]) + abs(mat[8]) == 1.0


@njit(cache=True)
def _solid_flags(kind, pos, mat, size, box, x, y, widths, heights, flags, scratch, keeps):
    """Add what a solid meets; its overlap with the band is asked as `check_cells` asks it."""
    half, square, radius = widths
    floor, ceiling, low, high, _, _, _ = heights
    if not flags & BLOCKS and not _outside(box, x, y, max(square, radius), low, high):
        part = _solid_part(kind, pos, mat, size, x, y, low, high, square, False, scratch, keeps)
        beside = square > 0.0 and part == APART
        if square > 0.0 and not beside:
            flags |= STANDS  # the cell's square is the footprint's
        if part != MEETS:
            disc = _solid_part(
                kind, pos, mat, size, x, y, low, high, radius, True, scratch, keeps
            )
            part = MEETS if disc == MEETS else max(part, disc)
        if part == MEETS:
            flags |= BLOCKS
        elif part == OPEN:
            flags |= UNPROVED
        if beside and _is_upright(kind, mat):
            return flags  # apart at one of its heights, apart at all
    if not flags & STANDS and not _outside(box, x, y, half, floor, ceiling):
        part = _solid_part(kind, pos, mat, size, x, y, floor, ceiling, half, False, scratch, keeps)
        if part != APART:
            flags |= STANDS
    return flags


@njit(cache=True)
def _add(out_geom, out_flags, first, count, geom, flags):
    """Insert an entry into a cell's list, which is sorted by geom."""
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
    half, square, radius, band_low, band_high, probed,
    start, z, normals, geom, closed,
    solid_start, solid_item, solid_geom, solid_kind, solid_pos, solid_mat, solid_size,
    solid_bounds,
    tri_start, tri_item, tri_geom, tri_corners, tri_bounds,
    plane_geom, plane_pos, plane_mat,
    slot, out_geom, out_flags,
):  # fmt: skip
    """List for each cell with a floor the geoms that stand in it or block it.

    A geom stands in a cell when it meets the cell's square between `floor_gap` over the floor
    and the ceiling; it blocks the cell when `check_cells` would find it in the band; it is
    PROBED when it meets the square in the probed band. Where rounding leaves no proof that it
    blocks, it is UNPROVED.

    Args:
        floors, ceilings: by cell, float64, NaN where there is no floor [m]; a ceiling is at
            least as high as the band.
        floor_gap: what a geom has to exceed the floor by [m].
        probe_low, probe_high: the probed band above the floor [m].
        half: half the edge of the cell's square [m].
        square, radius, band_low, band_high: as for `check_cells`.
        probed: by geom id, bool, which geoms are looked for in the probed band; only those
            made of triangles.
        start, z, normals, geom: the columns.
        closed: by geom id, whether it encloses a volume.
        slot: (cells + 1,) int64: where each cell may write, see `count_candidates`.
        out_geom, out_flags: int32 and uint8 of length ``slot[-1]``, flags 0 at first; receive
            each cell's geoms, ascending.
    """
    tiles_x = (width + TILE - 1) // TILE
    tiles_y = (height + TILE - 1) // TILE
    widths = (half, square, radius)
    for tile in prange(tiles_x * tiles_y):
        solids = solid_item[solid_start[tile] : solid_start[tile + 1]]
        triangles = tri_item[tri_start[tile] : tri_start[tile + 1]]
        group_start, group_box = _group_triangles(triangles, tri_geom, tri_bounds)
        scratch, keeps = np.empty((6, 3)), np.zeros((2, 4), np.bool_)
        one, other = np.empty((12, 3)), np.empty((12, 3))
        reach = max(half, max(square, radius))
        row0, col0 = tile // tiles_x * TILE, tile % tiles_x * TILE
        for row in range(row0, min(row0 + TILE, height)):
            y = y_max - (row + 0.5) * cell_size
            for col in range(col0, min(col0 + TILE, width)):
                cell = row * width + col
                floor, top, here, count = floors[cell], ceilings[cell], slot[cell], 0
                if math.isnan(floor):
                    continue
                x = x_min + (col + 0.5) * cell_size
                low, high = floor + band_low, floor + band_high
                first, last = start[cell], start[cell + 1]
                column = (z, normals, geom, closed, first, last)
                blocked = line_is_blocked(z, normals, geom, closed, first, last, low, high)
                heights = (
                    floor + floor_gap, top, low, high, floor + probe_low, floor + probe_high,
                    blocked,
                )  # fmt: skip
                for p in range(plane_geom.shape[0]):
                    flags = _line_flags(column, plane_geom[p], heights)
                    flags = _plane_flags(plane_pos[p], plane_mat[p], x, y, widths, heights, flags)
                    count = _add(out_geom, out_flags, here, count, plane_geom[p], flags)
                for g in range(group_box.shape[0]):
                    if _outside(group_box[g], x, y, reach, floor, top):
                        continue
                    items = triangles[group_start[g] : group_start[g + 1]]
                    of = tri_geom[items[0]]
                    flags, wanted = _line_flags(column, of, heights), STANDS | BLOCKS
                    if probed[of]:
                        wanted |= PROBED
                        if _line_meets(column, of, heights[4], heights[5]):
                            flags |= PROBED
                    flags = _triangle_flags(
                        items, tri_corners, tri_bounds, x, y, widths, heights, flags, wanted,
                        one, other,
                    )  # fmt: skip
                    count = _add(out_geom, out_flags, here, count, of, flags)
                for s in solids:
                    if _outside(solid_bounds[s], x, y, reach, floor, top):
                        continue
                    flags = _solid_flags(
                        solid_kind[s], solid_pos[s], solid_mat[s], solid_size[s],
                        solid_bounds[s], x, y, widths, heights,
                        _line_flags(column, solid_geom[s], heights), scratch, keeps,
                    )  # fmt: skip
                    count = _add(out_geom, out_flags, here, count, solid_geom[s], flags)


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
