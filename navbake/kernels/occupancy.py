"""Occupancy of cells over their floors: rays first, then geom by geom."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from navbake.kernels.overlap import (
    APART,
    MEETS,
    OPEN,
    line_is_blocked,
    plane_meets_prism,
    solid_meets_prism,
    tile_of,
    triangle_meets_prism,
)


@njit(cache=True)
def _solid_state(s, kind, pos, mat, size, x, y, z, square, radius, half_z, scratch, keeps):
    """APART, MEETS or OPEN for one solid and the footprint's square and disc."""
    state = APART
    for is_round in (False, True):
        half = radius if is_round else square
        if half <= 0.0:
            continue
        part = solid_meets_prism(
            kind[s], pos[s], mat[s], size[s], x, y, z, half, half_z, is_round,
            scratch[:4], keeps[0], keeps[1], scratch[4], scratch[5],
        )  # fmt: skip
        if part == MEETS:
            return MEETS
        if part == OPEN:
            state = OPEN
    return state


@njit(cache=True)
def _outside_box(box, x, y, reach, low, high):
    return (
        box[0] >= x + reach
        or box[3] <= x - reach
        or box[1] >= y + reach
        or box[4] <= y - reach
        or box[2] >= high
        or box[5] <= low
    )


@njit(cache=True, parallel=True)
def check_cells(
    x_min, y_max, cell_size, width,
    cells, floors, band_low, band_high, square, radius,
    start, z, normals, geom, closed,
    solid_start, solid_item, solid_kind, solid_pos, solid_mat, solid_size, solid_bounds,
    tri_start, tri_item, tri_corners, tri_bounds,
    plane_pos, plane_mat,
    state, by_line,
):  # fmt: skip
    """Tell for each cell and floor whether anything is in the band above it.

    Args:
        cells, floors: the questions: cell ids int64 and floor heights float64 [m], (n,).
        band_low, band_high: the band above the floor [m].
        square, radius: half the square's edge and the disc's radius, 0 for none [m].
        start, z, normals, geom: the columns.
        closed: by geom id, whether it encloses a volume.
        state: (n,) uint8, receives APART, MEETS or OPEN.
        by_line: (n,) bool, receives whether the cell's line alone proved it.
    """
    for n in prange(cells.shape[0]):
        cell = cells[n]
        row, col = cell // width, cell % width
        x = x_min + (col + 0.5) * cell_size
        y = y_max - (row + 0.5) * cell_size
        low, high = floors[n] + band_low, floors[n] + band_high
        if line_is_blocked(z, normals, geom, closed, start[cell], start[cell + 1], low, high):
            state[n] = MEETS
            by_line[n] = True
            continue
        middle, half_z = (low + high) / 2.0, (high - low) / 2.0
        reach = max(square, radius)
        answer = APART
        for p in range(plane_pos.shape[0]):
            if plane_meets_prism(plane_pos[p], plane_mat[p], x, y, middle, square, radius, half_z):
                answer = MEETS
        tile = tile_of(row, col, width)
        if answer == APART:
            first, last = tri_start[tile], tri_start[tile + 1]
            if last > first:
                one, other = np.empty((12, 3)), np.empty((12, 3))
                for i in range(first, last):
                    t = tri_item[i]
                    if _outside_box(tri_bounds[t], x, y, reach, low, high):
                        continue
                    if triangle_meets_prism(
                        tri_corners[t], x, y, low, high, square, radius, one, other
                    ):
                        answer = MEETS
                        break
        if answer == APART:
            first, last = solid_start[tile], solid_start[tile + 1]
            if last > first:
                scratch, keeps = np.empty((6, 3)), np.zeros((2, 4), np.bool_)
                for i in range(first, last):
                    s = solid_item[i]
                    if _outside_box(solid_bounds[s], x, y, reach, low, high):
                        continue
                    part = _solid_state(
                        s, solid_kind, solid_pos, solid_mat, solid_size, x, y, middle,
                        square, radius, half_z, scratch, keeps,
                    )  # fmt: skip
                    if part == MEETS:
                        answer = MEETS
                        break
                    if part == OPEN:
                        answer = OPEN
        state[n] = answer


@njit(cache=True, parallel=True)
def lines_blocked(cells, low, high, start, z, normals, geom, closed, out):
    """Whether each cell's line alone proves that something is between two heights.

    Args:
        cells: cell ids, (n,) int64.
        low, high: heights, (n,) float64 [m].
        start, z, normals, geom: the columns.
        closed: by geom id, whether it encloses a volume.
        out: (n,) bool, receives the answers.
    """
    for n in prange(cells.shape[0]):
        first, last = start[cells[n]], start[cells[n] + 1]
        out[n] = line_is_blocked(z, normals, geom, closed, first, last, low[n], high[n])
