"""Seams: vertical faces of two geoms that meet where the lines of cells run."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from navbake.baker.blocks import splice
from navbake.baker.columns import Columns, TiledShapes, cast_points, tile_of, tiles_of_rows
from navbake.baker.connect import ranges
from navbake.baker.kernels.arrays import Crossings
from navbake.baker.kernels.constants import BOX
from navbake.baker.kernels.hits import RIM
from navbake.baker.scene.kernels.triangles import drop_thick
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int, Int32

BESIDE = 1e-6  # lines are cast so far east and north of a seam, well beyond its rims [m]


def settle_seams(columns: Columns, tiled: TiledShapes, cells: Int | None = None) -> Columns:
    """Give the lines that run in two faces at once to the geoms on one side.

    On round coordinates the centres of cells often lie where one geom ends and the next one
    begins, and both are in the column. As by the top-left rule of rasterizers, such a line belongs
    to what lies east and north of the seam: it is cast again 1e-6 m further on. Only faces of boxes
    and triangles along the axes count; the centres of cells meet no two others by chance.

    Args:
        cells: those whose columns are known, ascending; those of the columns' rows if None.
    """
    if cells is not None and not len(cells):
        return columns
    lattice, known_rows = columns.lattice, columns.known_rows
    tiles = tiles_of_rows(lattice, known_rows) if cells is None else tile_of(lattice, cells)
    tiles = np.unique(np.asarray(tiles, dtype=np.int64))
    solids, over = tiled.shapes.solids, tiled.tiles
    is_over = _are_over(over.solid_start, over.solid_item, tiles, len(solids.geom))
    chosen = np.flatnonzero(is_over & (solids.kind == BOX))
    mat = abs(solids.mat[chosen])
    boxes = solids.bounds[chosen[np.minimum(mat, abs(mat - 1.0)).max(axis=1) < RIM]]
    bounds = tiled.facets.bounds
    is_over = _are_over(over.triangle_start, over.triangle_item, tiles, len(bounds))
    run_in_bands(drop_thick, len(bounds), bounds, RIM, is_over, least=4096)
    corners = tiled.facets.corners[is_over]
    # only in the window round the cells
    row, col = np.arange(*known_rows), np.arange(lattice.width)
    known = np.ones((len(row), len(col)), dtype=np.bool_)
    if cells is not None:
        rows, cols = np.divmod(cells, lattice.width)
        row, col = (np.arange(one.min(), one.max() + 1) for one in (rows, cols))
        known = np.zeros((len(row), len(col)), dtype=np.bool_)
        known[rows - row[0], cols - col[0]] = True
    centers = lattice.center_x()[col], lattice.center_y()[row][::-1]  # ascending
    seams = [known & _find_seams(centers, axis, boxes, corners) for axis in (0, 1)]
    at = np.nonzero(seams[0] | seams[1])
    if not len(at[0]):
        return columns
    asked = row[at[0]] * lattice.width + col[at[1]]
    points = lattice.positions(row[at[0]], col[at[1]])
    for axis, on_seam in enumerate(seams):
        points[on_seam[at], axis] += BESIDE
    start = columns.crossings.start
    found = cast_points(tiled, asked, points)
    return splice_columns(columns, asked, start[asked], start[asked + 1], found)


def _are_over(start: Int, item: Int32, tiles: Int, num: int) -> Bool:
    """Mark the items that lie over some tiles, shape (num,); all, if these are all tiles."""
    mask = np.full(num, len(tiles) == len(start) - 1)
    if not mask.all():
        mask[item[ranges(start[tiles], start[tiles + 1])[1]]] = True
    return mask


def _find_seams(centers: tuple[Float, Float], axis: int, boxes: Float, corners: Float) -> Bool:
    """The cells of a window whose lines run in faces of both directions along x or y.

    `centers` are x of its columns and y of its rows, ascending.
    """
    other = 1 - axis
    low, high = corners.min(axis=1), corners.max(axis=1)
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    # the normal along the axis, whose sign says where the face looks
    looks = (one[:, other] * two[:, 2] - one[:, 2] * two[:, other]) * (1 - 2 * axis)
    flat = high[:, axis] - low[:, axis] <= RIM
    marks = []
    for is_upper in (False, True):
        is_side = flat & (looks > 0 if is_upper else looks < 0)
        at = np.concatenate([boxes[:, axis + 3 * is_upper], low[is_side, axis]])
        begin = np.concatenate([boxes[:, other], low[is_side, other]])
        end = np.concatenate([boxes[:, other + 3], high[is_side, other]])
        marks.append(_mark_lines(centers, axis, at, begin, end))
    return marks[0] & marks[1]


def _mark_lines(
    centers: tuple[Float, Float], axis: int, at: Float, begin: Float, end: Float
) -> Bool:
    """Mark the cells of a window with centres on lines at an x (`axis` 0) or a y (1).

    Each reaches from `begin` to `end` along the other axis [m].
    """
    marked = np.zeros((len(centers[axis]), len(centers[1 - axis])), dtype=np.bool_)
    index = np.searchsorted(centers[axis], at - 2 * RIM)
    hit = index < len(centers[axis])
    hit[hit] = centers[axis][index[hit]] <= at[hit] + 2 * RIM
    if not hit.any():
        return np.zeros((len(centers[1]), len(centers[0])), dtype=np.bool_)
    first = np.searchsorted(centers[1 - axis], begin[hit] - 2 * RIM)
    last = np.searchsorted(centers[1 - axis], end[hit] + 2 * RIM, side="right")
    which, place = ranges(first, last)
    marked[index[hit][which], place] = True
    return np.asarray((marked.T if axis == 0 else marked)[::-1])


def splice_columns(columns: Columns, cell: Int, first: Int, last: Int, new: Crossings) -> Columns:
    """Replace the crossings ``first[i]`` to before ``last[i]`` of ``cell[i]`` by the i-th of `new`.

    The cells ascend and may repeat.
    """
    old, (begin, end) = columns.crossings, columns.known_rows.cells(columns.lattice)
    more = np.zeros(end - begin + 1, dtype=np.int64)
    np.add.at(more, cell + 1 - begin, np.diff(new.start) - (last - first))
    start = np.zeros(len(old.start), dtype=np.int64)  # whose pages cost nothing until written
    np.add(old.start[begin : end + 1], np.cumsum(more, out=more), out=start[begin : end + 1])
    layers: Any = zip(old[1:], new[1:], strict=True)
    arrays = (splice(array, first, last, other, new.start) for array, other in layers)
    return replace(columns, crossings=Crossings(start, *arrays))
