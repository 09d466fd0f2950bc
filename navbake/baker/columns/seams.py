"""Mend columns whose line runs exactly between two geoms, or between two parts of a floor.

A seam is where vertical faces of two geoms meet. A crack is a gap between floors at one height that
is too narrow to matter to any agent.
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

# A line in a seam is moved this far east or north, which is well past the rims of the faces [m]
SEAM_SHIFT = 1e-6
# Rays that find the exact surface of a floor beside a crack are cast this far within its edge [m]
DISTANCE_INSIDE_EDGE = 1e-6
ALL_CELLS = np.empty(0, dtype=np.bool_)
"""An empty mask that stands for all cells, see `list_sides`."""


# ---------------------------------------------------------------- seams


def resolve_seams(columns: Columns, tiled: TiledShapes, cells: Int | None = None) -> Columns:
    """Cast lines again that run exactly between two geoms: a little to the east or north.

    In scenes with round coordinates, many cells' centres lie where one geom ends and the next one
    begins, and the columns have hits of both. Like rasterizers with their top-left rule, the bake
    gives such a line to the geom east or north of this seam. Only faces of boxes and triangles that
    are perpendicular to x or y are considered; no line runs in two other faces by chance.

    Args:
        columns: the columns.
        tiled: the shapes that they were cast from.
        cells: ids of the cells whose columns are valid, ascending; None for all cells of
            `columns.valid_rows`.

    Returns:
        The columns, with new hits for lines in seams.
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
    """Return the bounds of the axis-aligned boxes over some tiles, shape (n, 6) [m]."""
    solids = tiled.shapes.solids
    index = tiled.tile_index
    is_over = _are_over(index.solid_start, index.solid_item, tiles, len(solids.geom))
    boxes = np.flatnonzero(is_over & (solids.kind == BOX))
    mat = abs(solids.mat[boxes])
    is_aligned = np.minimum(mat, abs(mat - 1.0)).max(axis=1) < RIM_WIDTH
    bounds: Float = solids.bounds[boxes[is_aligned]]
    return bounds


def _upright_triangles(tiled: TiledShapes, tiles: Int) -> Float:
    """Return the vertical triangles over some tiles that are perpendicular to x or to y.

    Returns:
        Their corners, shape (n, 3, 3) [m].
    """
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
    """Mark the items that lie over some tiles.

    Args:
        start, item: the items over each tile, see `list_by_tile`.
        tiles: ids of tiles.
        num_items: how many items there are.

    Returns:
        A mask, shape (num_items,); all True if `tiles` are all tiles.
    """
    mask = np.full(num_items, len(tiles) == len(start) - 1)
    if not mask.all():
        _, places = expand_ranges(start[tiles], start[tiles + 1])
        mask[item[places]] = True
    return mask


def _find_seams(centers: tuple[Float, Float], axis: int, box_bounds: Float, corners: Float) -> Bool:
    """Mark the cells of a window whose lines run in two faces that look in opposite directions.

    Both faces are perpendicular to the same axis, x or y.

    Args:
        centers: x of the window's columns and y of its rows, ascending [m].
        axis: 0 for faces perpendicular to x, 1 for faces perpendicular to y.
        box_bounds: axis-aligned boxes, shape (n, 6) [m].
        corners: triangles perpendicular to x or y, shape (m, 3, 3) [m].

    Returns:
        A mask, shape (rows, cols) of the window; row 0 has the largest y.
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
        axis: 0 for faces perpendicular to x, 1 for faces perpendicular to y.
        face: the coordinate of each face along that axis, (n,) [m].
        begin, end: the ends of each face along the other horizontal axis, (n,) [m].

    Returns:
        A mask, shape (rows, cols) of the window; row 0 has the largest y.
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
    place_begin = np.searchsorted(along_face, begin[holds_centers] - 2 * RIM_WIDTH)
    place_end = np.searchsorted(along_face, end[holds_centers] + 2 * RIM_WIDTH, side="right")
    face_number, place = expand_ranges(place_begin, place_end)
    marked[index[holds_centers][face_number], place] = True
    return np.asarray((marked.T if axis == 0 else marked)[::-1])


def splice_columns(
    columns: Columns, cell: Int, begin: Int, end: Int, new_hits: ColumnHits
) -> Columns:
    """Replace hits of some columns.

    Args:
        columns: the columns.
        cell: ids of cells, ascending, (n,); a cell is repeated if several ranges of its hits
            change.
        begin, end: the hits to replace for ``cell[i]`` are ``begin[i]:end[i]`` of the arrays of
            `columns.hits` (not counted within the column), (n,).
        new_hits: their replacements; its column i belongs to ``cell[i]``.

    Returns:
        The new columns; `columns` are not changed.
    """
    old_hits = columns.hits
    first_cell, end_cell = columns.valid_rows.cell_range(columns.lattice)
    num_added = np.zeros(end_cell - first_cell + 1, dtype=np.int64)
    np.add.at(num_added, cell + 1 - first_cell, np.diff(new_hits.start) - (end - begin))
    num_added_before = np.cumsum(num_added, out=num_added)
    start = np.zeros(len(old_hits.start), dtype=np.int64)  # whose pages cost nothing until written
    changed = slice(first_cell, end_cell + 1)
    np.add(old_hits.start[changed], num_added_before, out=start[changed])
    arrays = [
        splice(old, begin, end, new, new_hits.start)
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

    A line runs in a crack if floors lie on two opposite sides of it, each nearer than `crack`,
    their heights differ by at most a step, and the line itself crosses no floor at that height. The
    lower of the two floors is added to the column as an open surface; of several such floors within
    a step of each other, only the lowest is added. The result for a cell does not depend on other
    cells.

    Args:
        columns: the columns.
        tiled: the shapes that they were cast from, listed for lines up to `crack` away.
        agent: the agent, of which the slope and step are used.
        crack: how far from the line the floors on both sides may be [m]; 0 adds nothing.
        selected: mask of the cells whose cracks are closed, shape (cells,); if empty, all cells.
    """
    if crack == 0:
        return columns
    limits = agent_limits(agent)
    sides = _list_all_sides(columns, tiled, limits, crack, selected)
    if not len(sides):
        return columns
    cell = sides[:, CELL].astype(np.int64)
    direction = sides[:, DIRECTION : DIRECTION + 2]

    # rays just inside of the edges of the floors find their exact surfaces
    lattice = columns.lattice
    points = lattice.positions(*np.divmod(cell, lattice.width))
    points += direction * (sides[:, DISTANCE, None] + DISTANCE_INSIDE_EDGE)
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
    # a floor that is buried there, but not at the cell's line, ends at the foot of something
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
    """List the pieces of floor on both sides of cracks, see `list_sides`, ordered by cell.

    Returns:
        A row of numbers for each piece, see `crack_kernels`, shape (n, NUM_COLUMNS), float64.
    """
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
    """Mark the lower floor of each pair that bounds a crack from opposite sides.

    The two floors of a pair belong to one cell, and their heights differ by at most a step.

    Args:
        cell: the cell of each floor, ascending, (n,).
        z: height of each floor, (n,) [m].
        direction: unit vector from the cell's centre to each floor, (n, 2).
        step: the largest step [m].

    Returns:
        A mask, shape (n,); of two floors at one height, both are marked.
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
    """Mark the heights just above which a column's line runs inside of something, or crosses it.

    Args:
        hits: the columns.
        cells: index of the column for each height, (n,).
        z: heights, (n,) [m].

    Returns:
        A mask, shape (n,), bool.
    """
    buried = np.empty(len(cells), dtype=np.bool_)
    low = z + SAME_HEIGHT
    high = z + 2.0 * SAME_HEIGHT
    find_blocked_lines(cells, low, high, hits, buried, 0, len(cells))
    return buried


def _add_surfaces(columns: Columns, cell: Int, rays: ColumnHits, hit: Int) -> Columns:
    """Add hits of rays to the columns of cells, as surfaces that enclose nothing.

    Args:
        columns: the columns.
        cell: the cell that each hit is added to, (n,).
        rays: the hits of the rays.
        hit: index of each hit in `rays`, ordered by cell and then height, (n,).
    """
    old_hits = columns.hits
    z = rays.z[hit]
    place = old_hits.start[cell]
    end = old_hits.start[cell + 1]
    while True:
        has_hit = np.flatnonzero(place < end)
        has_hit = has_hit[old_hits.z[place[has_hit]] < z[has_hit]]
        if not len(has_hit):
            break
        place[has_hit] += 1
    new_hits = ColumnHits(
        start=np.arange(len(z) + 1),
        z=z,
        normal=rays.normal[hit],
        geom=rays.geom[hit],
        closed=np.full(len(z), OPEN_SURFACE, np.uint8),
    )
    return splice_columns(columns, cell, place, place, new_hits)
