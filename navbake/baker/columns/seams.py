"""Seams and cracks: lines that run exactly between two geoms, or between two parts of a floor.

Where vertical faces of two geoms meet there is a seam; where floors at one height leave a gap that
is too narrow for any agent, a crack.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from navbake.baker.columns.columns import Columns, TiledShapes, cast_points, tile_of, tiles_of_rows
from navbake.baker.columns.crack_kernels import (
    CELL,
    DIRECTION,
    DISTANCE,
    GEOM,
    HEIGHT,
    RADIUS,
    SAME_DIRECTION,
    SAME_PIECE,
    list_sides,
)
from navbake.baker.columns.hit_kernels import RIM_WIDTH
from navbake.baker.core.arrays import ColumnHits
from navbake.baker.core.blocks import splice
from navbake.baker.core.components import expand_ranges
from navbake.baker.core.constants import BOX, OPEN_SURFACE
from navbake.baker.core.limits import AgentLimits, agent_limits
from navbake.baker.core.tolerances import LIMIT_SLACK, SAME_HEIGHT
from navbake.baker.geometry.overlap_kernels import find_blocked_lines
from navbake.config.settings import AgentSettings
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Int, Int32

# Lines on a seam are moved this far east and north, well beyond the rims of its faces [m]
SEAM_SHIFT = 1e-6
# Rays that find a piece's exact surface are cast this far beyond its edge [m]
BEYOND_EDGE = 1e-6
ALL_CELLS = np.empty(0, dtype=np.bool_)
"""An empty mask that stands for all cells, see `list_sides`."""


# ---------------------------------------------------------------- seams


def resolve_seams(columns: Columns, tiled: TiledShapes, cells: Int | None = None) -> Columns:
    """Replace lines that run exactly in the faces of two geoms by lines beside the seam.

    On round coordinates, centres of cells often lie where one geom ends and the next one begins,
    and both are in the column. As by the top-left rule of rasterizers, such a line belongs to what
    lies east and north of the seam: it is cast again SEAM_SHIFT further on. Only faces of boxes and
    triangles along the axes count; centres of cells meet no two other faces by chance.

    Args:
        columns: the columns.
        tiled: the shapes that they were cast from.
        cells: ids of the cells whose columns are valid, ascending; those of `columns.valid_rows` if
            None.
    """
    if cells is not None and not len(cells):
        return columns
    lattice = columns.lattice
    valid_rows = columns.valid_rows
    tiles = tiles_of_rows(lattice, valid_rows) if cells is None else tile_of(lattice, cells)
    tiles = np.unique(np.asarray(tiles, dtype=np.int64))
    box_bounds = _aligned_boxes(tiled, tiles)
    corners = _upright_triangles(tiled, tiles)

    # only in the smallest window that holds the cells
    if cells is None:
        rows = np.arange(valid_rows.first, valid_rows.end)
        cols = np.arange(lattice.width)
        is_valid = np.ones((len(rows), len(cols)), dtype=np.bool_)
    else:
        cell_rows, cell_cols = np.divmod(cells, lattice.width)
        rows = np.arange(cell_rows.min(), cell_rows.max() + 1)
        cols = np.arange(cell_cols.min(), cell_cols.max() + 1)
        is_valid = np.zeros((len(rows), len(cols)), dtype=np.bool_)
        is_valid[cell_rows - rows[0], cell_cols - cols[0]] = True
    center_x = lattice.center_x()[cols]
    center_y = lattice.center_y()[rows][::-1]  # ascending
    on_seam_x = is_valid & _find_seams((center_x, center_y), 0, box_bounds, corners)
    on_seam_y = is_valid & _find_seams((center_x, center_y), 1, box_bounds, corners)
    seam_row, seam_col = np.nonzero(on_seam_x | on_seam_y)
    if not len(seam_row):
        return columns

    seam_cells = rows[seam_row] * lattice.width + cols[seam_col]
    points = lattice.positions(rows[seam_row], cols[seam_col])
    points[on_seam_x[seam_row, seam_col], 0] += SEAM_SHIFT
    points[on_seam_y[seam_row, seam_col], 1] += SEAM_SHIFT
    start = columns.hits.start
    new_hits = cast_points(tiled, seam_cells, points)
    return splice_columns(columns, seam_cells, start[seam_cells], start[seam_cells + 1], new_hits)


def _aligned_boxes(tiled: TiledShapes, tiles: Int) -> Float:
    """Return the bounds of the boxes along the world's axes over some tiles, shape (n, 6) [m]."""
    solids = tiled.shapes.solids
    index = tiled.tile_index
    is_over = _are_over(index.solid_start, index.solid_item, tiles, len(solids.geom))
    boxes = np.flatnonzero(is_over & (solids.kind == BOX))
    mat = abs(solids.mat[boxes])
    is_aligned = np.minimum(mat, abs(mat - 1.0)).max(axis=1) < RIM_WIDTH
    bounds: Float = solids.bounds[boxes[is_aligned]]
    return bounds


def _upright_triangles(tiled: TiledShapes, tiles: Int) -> Float:
    """Return the corners of the triangles across x or y over some tiles, shape (n, 3, 3) [m]."""
    bounds = tiled.facets.bounds
    index = tiled.tile_index
    is_candidate = _are_over(index.triangle_start, index.triangle_item, tiles, len(bounds))

    def drop_thick(first: int, end: int) -> None:
        size_x = bounds[first:end, 3 + 0] - bounds[first:end, 0]
        size_y = bounds[first:end, 3 + 1] - bounds[first:end, 1]
        is_candidate[first:end] &= (size_x <= RIM_WIDTH) | (size_y <= RIM_WIDTH)

    run_in_chunks(drop_thick, len(bounds), least=4096)
    return tiled.facets.corners[is_candidate]


def _are_over(start: Int, item: Int32, tiles: Int, num_items: int) -> Bool:
    """Mark the items that lie over some tiles, shape (num_items,); all, if these are all tiles."""
    mask = np.full(num_items, len(tiles) == len(start) - 1)
    if not mask.all():
        _, places = expand_ranges(start[tiles], start[tiles + 1])
        mask[item[places]] = True
    return mask


def _find_seams(centers: tuple[Float, Float], axis: int, box_bounds: Float, corners: Float) -> Bool:
    """Mark the cells of a window whose lines run in two opposite faces across an axis.

    Args:
        centers: x of the window's columns and y of its rows, ascending [m].
        axis: 0 for faces across x, 1 for those across y.
        box_bounds: boxes along the axes, shape (n, 6) [m].
        corners: triangles across x or y, shape (m, 3, 3) [m].

    Returns:
        shape (rows, cols) of the window.
    """
    other_axis = 1 - axis
    low = corners.min(axis=1)
    high = corners.max(axis=1)
    u = corners[:, 1] - corners[:, 0]
    v = corners[:, 2] - corners[:, 0]
    # the normal's coordinate along the axis, whose sign says which way the face looks
    normal = (u[:, other_axis] * v[:, 2] - u[:, 2] * v[:, other_axis]) * (1 - 2 * axis)
    is_across = high[:, axis] - low[:, axis] <= RIM_WIDTH
    marks = []
    for is_upper_face in (False, True):
        is_face = is_across & (normal > 0 if is_upper_face else normal < 0)
        box_face = box_bounds[:, axis + 3 * is_upper_face]
        face = np.concatenate([box_face, low[is_face, axis]])
        begin = np.concatenate([box_bounds[:, other_axis], low[is_face, other_axis]])
        end = np.concatenate([box_bounds[:, other_axis + 3], high[is_face, other_axis]])
        marks.append(_mark_lines(centers, axis, face, begin, end))
    return marks[0] & marks[1]


def _mark_lines(
    centers: tuple[Float, Float], axis: int, face: Float, begin: Float, end: Float
) -> Bool:
    """Mark the cells of a window whose centres lie in faces, seen from above.

    Args:
        centers: x of the window's columns and y of its rows, ascending [m].
        axis: 0 for faces across x, 1 for those across y.
        face: where each face is along the axis, (n,) [m].
        begin, end: from where to where each face reaches along the other axis, (n,) [m].

    Returns:
        shape (rows, cols) of the window.
    """
    along_axis = centers[axis]
    along_face = centers[1 - axis]
    marked = np.zeros((len(along_axis), len(along_face)), dtype=np.bool_)
    index = np.searchsorted(along_axis, face - 2 * RIM_WIDTH)
    holds_centers = index < len(along_axis)
    candidates = index[holds_centers]
    holds_centers[holds_centers] = along_axis[candidates] <= face[holds_centers] + 2 * RIM_WIDTH
    if not holds_centers.any():
        return np.zeros((len(centers[1]), len(centers[0])), dtype=np.bool_)
    first = np.searchsorted(along_face, begin[holds_centers] - 2 * RIM_WIDTH)
    last = np.searchsorted(along_face, end[holds_centers] + 2 * RIM_WIDTH, side="right")
    face_number, place = expand_ranges(first, last)
    marked[index[holds_centers][face_number], place] = True
    return np.asarray((marked.T if axis == 0 else marked)[::-1])


def splice_columns(
    columns: Columns, cell: Int, first: Int, last: Int, new_hits: ColumnHits
) -> Columns:
    """Replace hits of some columns.

    Args:
        columns: the columns.
        cell: ids of cells, ascending, with repeats where several runs of a column change, (n,).
        first, last: the hits ``first[i]`` to before ``last[i]`` of ``cell[i]`` are replaced, (n,).
        new_hits: their replacement; column i is for ``cell[i]``.
    """
    old_hits = columns.hits
    begin, end = columns.valid_rows.cell_range(columns.lattice)
    num_added = np.zeros(end - begin + 1, dtype=np.int64)
    np.add.at(num_added, cell + 1 - begin, np.diff(new_hits.start) - (last - first))
    num_added_before = np.cumsum(num_added, out=num_added)
    start = np.zeros(len(old_hits.start), dtype=np.int64)  # whose pages cost nothing until written
    np.add(old_hits.start[begin : end + 1], num_added_before, out=start[begin : end + 1])
    arrays = [
        splice(old, first, last, new, new_hits.start)
        for old, new in zip(old_hits.entries, new_hits.entries, strict=True)
    ]
    return replace(columns, hits=ColumnHits(start, *arrays))


# ---------------------------------------------------------------- cracks


def close_cracks(
    columns: Columns,
    tiled: TiledShapes,
    agent: AgentSettings,
    crack: float,
    selected: Bool = ALL_CELLS,
) -> Columns:
    """Add floors to columns whose lines run in cracks of a floor.

    Where surfaces that an agent could stand on lie on opposite sides of a line, within a step of
    each other, each nearer than `crack`, and the line crosses none, the lower one is added to the
    line's column as an open surface; of several within a step, the lowest. The result for a cell
    does not depend on other cells.

    Args:
        columns: the columns.
        tiled: the shapes that they were cast from, listed for lines up to `crack` away.
        agent: the agent: its slope and step.
        crack: how far from the line the floors on both sides may be [m]; 0 adds nothing.
        selected: mask of the cells whose cracks are closed, shape (cells,); all if it is empty.
    """
    if crack == 0:
        return columns
    limits = agent_limits(agent)
    sides = _list_all_sides(columns, tiled, limits, crack, selected)
    if not len(sides):
        return columns
    cell = sides[:, CELL].astype(np.int64)
    direction = sides[:, DIRECTION : DIRECTION + 2]

    # rays just beyond the edges find the exact surfaces there
    lattice = columns.lattice
    points = lattice.positions(*np.divmod(cell, lattice.width))
    points += direction * (sides[:, DISTANCE, None] + BEYOND_EDGE)
    rays = cast_points(tiled, cell, points)
    side = np.repeat(np.arange(len(cell)), np.diff(rays.start))  # of each hit
    offset = abs(rays.z - sides[side, HEIGHT])
    is_floor = rays.normal[:, 2] >= limits.min_up
    is_piece = is_floor & (rays.geom == sides[side, GEOM])
    is_piece &= offset <= SAME_PIECE + sides[side, RADIUS]
    hit = np.flatnonzero(is_piece)
    hit = hit[np.lexsort((offset[hit], side[hit]))]
    side, nearest = np.unique(side[hit], return_index=True)
    hit = hit[nearest]
    cell = cell[side]
    direction = direction[side]
    # a surface that is buried there, but not on the cell's line, only ends at the foot of something
    bounds_crack = ~_are_buried(rays, side, rays.z[hit])
    bounds_crack |= _are_buried(columns.hits, cell, rays.z[hit])
    hit = hit[bounds_crack]
    cell = cell[bounds_crack]
    direction = direction[bounds_crack]

    bridges = _find_lower_sides(cell, rays.z[hit], direction, limits.step)
    hit = hit[bridges]
    cell = cell[bridges]
    z = rays.z[hit]
    lowest = list[int]()  # of the surfaces of a cell that are within a step of each other
    for n in np.lexsort((rays.geom[hit], z, cell)).tolist():
        is_new_cell = not lowest or cell[lowest[-1]] != cell[n]
        if is_new_cell or z[n] - z[lowest[-1]] > limits.step + LIMIT_SLACK:
            lowest.append(n)
    return _add_surfaces(columns, cell[lowest], rays, hit[lowest]) if lowest else columns


def _list_all_sides(
    columns: Columns, tiled: TiledShapes, limits: AgentLimits, crack: float, selected: Bool
) -> Float:
    """List the floors on opposite sides of lines, see `list_sides`, ordered by cell."""
    tiles = tiles_of_rows(columns.lattice, columns.valid_rows)
    sides_of_chunk = dict[int, Float]()  # by the first tile of the chunk

    def list_chunk(first: int, end: int) -> None:
        sides, num_sides = list_sides(
            columns.lattice,
            columns.hits,
            tiled.shapes.solids,
            tiled.facets,
            tiled.tile_index,
            limits,
            crack,
            selected,
            first,
            end,
        )
        sides_of_chunk[first] = sides[:num_sides]

    run_in_chunks(list_chunk, len(tiles), begin=tiles.start)
    if not sides_of_chunk:
        return np.empty((0, CELL + 1))
    sides = np.concatenate([sides_of_chunk[first] for first in sorted(sides_of_chunk)])
    return sides[np.argsort(sides[:, CELL], kind="stable")]


def _find_lower_sides(cell: Int, z: Float, direction: Float, step: float) -> Bool:
    """Mark the lower one of any two sides of a cell that lie opposite within a step of height.

    Args:
        cell: of each side, ascending, (n,).
        z: heights, (n,) [m].
        direction: unit vectors from the cell's centre to the sides, (n, 2).
        step: the largest step [m].
    """
    is_lower = np.zeros(len(cell), dtype=np.bool_)
    most_sides = int(np.unique(cell, return_counts=True)[1].max(initial=1))
    for distance in range(1, most_sides):
        first = slice(None, -distance)
        second = slice(distance, None)
        are_opposite = cell[first] == cell[second]
        are_opposite &= abs(z[first] - z[second]) <= step + LIMIT_SLACK
        are_opposite &= (direction[first] * direction[second]).sum(axis=1) <= -SAME_DIRECTION
        is_lower[first] |= are_opposite & (z[first] <= z[second])
        is_lower[second] |= are_opposite & (z[second] <= z[first])
    return is_lower


def _are_buried(hits: ColumnHits, cells: Int, z: Float) -> Bool:
    """Return whether the lines of columns run within something just above a height."""
    buried = np.empty(len(cells), dtype=np.bool_)
    low = z + SAME_HEIGHT
    high = z + 2.0 * SAME_HEIGHT
    find_blocked_lines(cells, low, high, hits, buried, 0, len(cells))
    return buried


def _add_surfaces(columns: Columns, cell: Int, rays: ColumnHits, hit: Int) -> Columns:
    """Add hits of rays to columns as open surfaces; they are ordered by cell and then height."""
    old_hits = columns.hits
    z = rays.z[hit]
    place = old_hits.start[cell]
    end = old_hits.start[cell + 1]
    while True:
        is_below = (place < end) & (old_hits.z[np.minimum(place, len(old_hits.z) - 1)] < z)
        if not is_below.any():
            break
        place = place + is_below
    new_hits = ColumnHits(
        start=np.arange(len(z) + 1),
        z=z,
        normal=rays.normal[hit],
        geom=rays.geom[hit],
        closed=np.full(len(z), OPEN_SURFACE, np.uint8),
    )
    return splice_columns(columns, cell, place, place, new_hits)
