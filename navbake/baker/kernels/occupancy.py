"""Occupancy of cells over their floors: rays first, then geom by geom."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from navbake.baker.kernels.overlap import (
    APART,
    MEETS,
    OPEN,
    line_is_blocked,
    outside,
    plane_meets_prism,
    tile_of,
    triangle_meets_prism,
)
from navbake.baker.kernels.solids import solid_part


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
    solids = (solid_kind, solid_pos, solid_mat, solid_size, solid_bounds)
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
                    if outside(tri_bounds, t, x, y, reach, low, high):
                        continue
                    if triangle_meets_prism(
                        tri_corners[t], x, y, low, high, square, radius, one, other
                    ):
                        answer = MEETS
                        break
        if answer == APART:
            first, last = solid_start[tile], solid_start[tile + 1]
            if last > first:
                scratch = (
                    np.empty((4, 3)), np.zeros(4, np.bool_), np.zeros(4, np.bool_),
                    np.empty(3), np.empty(3),
                )  # fmt: skip
                for i in range(first, last):
                    s = solid_item[i]
                    if outside(solid_bounds, s, x, y, reach, low, high):
                        continue
                    part = solid_part(s, solids, x, y, low, high, square, False, scratch)
                    if part != MEETS:
                        disc = solid_part(s, solids, x, y, low, high, radius, True, scratch)
                        part = MEETS if disc == MEETS else max(part, disc)
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
