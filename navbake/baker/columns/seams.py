"""Seams and cracks: where the lines of cells run between two geoms, or two parts of a floor.

Vertical faces of two geoms that meet there are a seam; floors at one height with a gap between them
that is too narrow for any agent, a crack.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from navbake.baker.columns.columns import Columns, TiledShapes, cast_points, tile_of, tiles_of_rows
from navbake.baker.columns.crack_kernels import (
    AWAY,
    CELL,
    GEOM,
    HEIGHT,
    RADIUS,
    SAME_PIECE,
    SAME_WAY,
    WAY,
    list_sides,
)
from navbake.baker.columns.hit_kernels import RIM
from navbake.baker.core.arrays import ColumnHits
from navbake.baker.core.blocks import splice
from navbake.baker.core.components import expand_ranges
from navbake.baker.core.constants import BOX, OPEN_SURFACE
from navbake.baker.core.limits import agent_limits
from navbake.baker.core.tolerances import LIMIT_SLACK, SAME_HEIGHT
from navbake.baker.geometry.overlap_kernels import find_blocked_lines
from navbake.config.settings import AgentSettings
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Int, Int32

BESIDE = 1e-6  # lines are cast so far east and north of a seam, well beyond its rims [m]
HAIR = 1e-6  # rays are cast this far beyond an edge [m]
ALL = np.empty(0, dtype=np.bool_)


def resolve_seams(columns: Columns, tiled: TiledShapes, cells: Int | None = None) -> Columns:
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
    lattice = columns.lattice
    valid_rows = columns.valid_rows
    tiles = tiles_of_rows(lattice, valid_rows) if cells is None else tile_of(lattice, cells)
    tiles = np.unique(np.asarray(tiles, dtype=np.int64))
    solids = tiled.shapes.solids
    over = tiled.tile_index
    is_over = _are_over(over.solid_start, over.solid_item, tiles, len(solids.geom))
    chosen = np.flatnonzero(is_over & (solids.kind == BOX))
    mat = abs(solids.mat[chosen])
    boxes = solids.bounds[chosen[np.minimum(mat, abs(mat - 1.0)).max(axis=1) < RIM]]
    bounds = tiled.facets.bounds
    is_over = _are_over(over.triangle_start, over.triangle_item, tiles, len(bounds))

    def drop_thick(first: int, end: int) -> None:
        wide = bounds[first:end, 3 + 0] - bounds[first:end, 0]
        deep = bounds[first:end, 3 + 1] - bounds[first:end, 1]
        is_over[first:end] &= (wide <= RIM) | (deep <= RIM)

    run_in_chunks(drop_thick, len(bounds), least=4096)
    corners = tiled.facets.corners[is_over]
    # only in the window round the cells
    row = np.arange(*valid_rows)
    col = np.arange(lattice.width)
    known = np.ones((len(row), len(col)), dtype=np.bool_)
    if cells is not None:
        rows, cols = np.divmod(cells, lattice.width)
        row = np.arange(rows.min(), rows.max() + 1)
        col = np.arange(cols.min(), cols.max() + 1)
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
    start = columns.hits.start
    found = cast_points(tiled, asked, points)
    return splice_columns(columns, asked, start[asked], start[asked + 1], found)


def _are_over(start: Int, item: Int32, tiles: Int, num: int) -> Bool:
    """Mark the items that lie over some tiles, shape (num,); all, if these are all tiles."""
    mask = np.full(num, len(tiles) == len(start) - 1)
    if not mask.all():
        mask[item[expand_ranges(start[tiles], start[tiles + 1])[1]]] = True
    return mask


def _find_seams(centers: tuple[Float, Float], axis: int, boxes: Float, corners: Float) -> Bool:
    """The cells of a window whose lines run in faces of both directions along x or y.

    `centers` are x of its columns and y of its rows, ascending.
    """
    other = 1 - axis
    low = corners.min(axis=1)
    high = corners.max(axis=1)
    one = corners[:, 1] - corners[:, 0]
    two = corners[:, 2] - corners[:, 0]
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
    which, place = expand_ranges(first, last)
    marked[index[hit][which], place] = True
    return np.asarray((marked.T if axis == 0 else marked)[::-1])


def splice_columns(columns: Columns, cell: Int, first: Int, last: Int, new: ColumnHits) -> Columns:
    """Replace the hits ``first[i]`` to before ``last[i]`` of ``cell[i]`` by the i-th of
    `new`.

    The cells ascend and may repeat.
    """
    old = columns.hits
    begin, end = columns.valid_rows.cell_range(columns.lattice)
    more = np.zeros(end - begin + 1, dtype=np.int64)
    np.add.at(more, cell + 1 - begin, np.diff(new.start) - (last - first))
    start = np.zeros(len(old.start), dtype=np.int64)  # whose pages cost nothing until written
    np.add(old.start[begin : end + 1], np.cumsum(more, out=more), out=start[begin : end + 1])
    layers: Any = zip(old[1:], new[1:], strict=True)
    arrays = (splice(array, first, last, other, new.start) for array, other in layers)
    return replace(columns, hits=ColumnHits(start, *arrays))


# ---------------------------------------------------------------- cracks


def close_cracks(
    columns: Columns, tiled: TiledShapes, agent: AgentSettings, crack: float, asked: Bool = ALL
) -> Columns:
    """Add to columns the floors that bridge the cracks in which their lines run.

    Where surfaces that an agent could stand on are within a step of one height on opposite sides of
    a line, each nearer than `crack` [m], and none on it, the lower one is added to the line's
    column, as an open surface; of several within a step the lowest. Other cells do not matter.

    Args:
        tiled: what the columns were cast at, listed for lines up to `crack` away.
        asked: the cells whose cracks are closed, shape (cells,), all if it is empty.
    """
    if crack == 0:
        return columns
    shapes = tiled.shapes
    parts = dict[int, tuple[Float, int]]()
    limits = agent_limits(agent)
    tiles = tiles_of_rows(columns.lattice, columns.valid_rows)

    def find(first: int, end: int) -> None:
        geometry = shapes.solids, tiled.facets, tiled.tile_index
        lines = columns.lattice, columns.hits
        parts[first] = list_sides(*lines, *geometry, limits, crack, asked, first, end)

    run_in_chunks(find, len(tiles), begin=tiles.start)
    found = [parts[first] for first in sorted(parts)]
    if not any(count for _, count in found):
        return columns
    sides = np.concatenate([notes[:count] for notes, count in found])
    sides = sides[np.argsort(sides[:, CELL], kind="stable")]
    cell = sides[:, CELL].astype(np.int64)
    geom = sides[:, GEOM]
    way = sides[:, WAY : WAY + 2]

    # rays just beyond the edges find the exact surfaces there
    beyond = columns.lattice.positions(*np.divmod(cell, columns.lattice.width))
    beyond += way * (sides[:, AWAY, None] + HAIR)
    rays = cast_points(tiled, cell, beyond)
    line = np.repeat(np.arange(len(cell)), np.diff(rays.start))
    off = abs(rays.z - sides[line, HEIGHT])
    is_up = rays.normal[:, 2] >= limits.min_up
    is_piece = is_up & (rays.geom == geom[line]) & (off <= SAME_PIECE + sides[line, RADIUS])
    seen = np.flatnonzero(is_piece)
    seen = seen[np.lexsort((off[seen], line[seen]))]
    line, nearest = np.unique(line[seen], return_index=True)
    seen = seen[nearest]
    cell = cell[line]
    way = way[line]
    # a surface buried there, and not on the cell's line, only ends at the foot of something
    is_side = ~_are_buried(rays, line, rays.z[seen])
    is_side |= _are_buried(columns.hits, cell, rays.z[seen])
    seen = seen[is_side]
    cell = cell[is_side]
    way = way[is_side]

    # of each two opposite sides the lower one bridges the line
    z = rays.z[seen]
    bridge = np.zeros(len(seen), dtype=np.bool_)
    for apart in range(1, int(np.unique(cell, return_counts=True)[1].max(initial=1))):
        one = slice(None, -apart)
        other = slice(apart, None)
        are_sides = (cell[one] == cell[other]) & (
            abs(z[one] - z[other]) <= limits.step + LIMIT_SLACK
        )
        are_sides &= (way[one] * way[other]).sum(axis=1) <= -SAME_WAY
        bridge[one] |= are_sides & (z[one] <= z[other])
        bridge[other] |= are_sides & (z[other] <= z[one])
    seen = seen[bridge]
    cell = cell[bridge]
    z = z[bridge]
    order = np.lexsort((rays.geom[seen], z, cell))
    kept = list[int]()
    for n in order.tolist():  # of those of a cell within a step, the lowest
        if not kept or cell[kept[-1]] != cell[n] or z[n] - z[kept[-1]] > limits.step + LIMIT_SLACK:
            kept.append(n)
    return _add(columns, cell[kept], rays, seen[kept]) if kept else columns


def _are_buried(hits: ColumnHits, cells: Int, z: Float) -> Bool:
    """Whether lines run within something just above a height."""
    buried = np.empty(len(cells), dtype=np.bool_)
    find_blocked_lines(cells, z + SAME_HEIGHT, z + 2.0 * SAME_HEIGHT, hits, buried, 0, len(cells))
    return buried


def _add(columns: Columns, cell: Int, rays: ColumnHits, seen: Int) -> Columns:
    """Add surfaces to columns, by cell and then height."""
    old = columns.hits
    z = rays.z[seen]
    place = old.start[cell]
    last = old.start[cell + 1]
    while (below := (place < last) & (old.z[np.minimum(place, len(old.z) - 1)] < z)).any():
        place = place + below
    closed = np.full(len(z), OPEN_SURFACE, np.uint8)
    added = ColumnHits(np.arange(len(z) + 1), z, rays.normal[seen], rays.geom[seen], closed)
    return splice_columns(columns, cell, place, place, added)
