"""Correct columns whose line runs exactly between two geoms, or between two parts of a floor.

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
    MAX_PIECE_HEIGHT_ERROR,
    MIN_SAME_DIRECTION_COSINE,
    RADIUS,
    list_sides,
)
from navbake.baker.columns.hit_kernels import RIM_WIDTH
from navbake.baker.core.arrays import ColumnHits
from navbake.baker.core.blocks import replace_slices
from navbake.baker.core.components import expand_ranges
from navbake.baker.core.constants import BOX, OPEN_SURFACE
from navbake.baker.core.limits import AgentLimits, make_agent_limits
from navbake.baker.core.tolerances import LIMIT_SLACK, SAME_HEIGHT
from navbake.baker.geometry.overlap_kernels import find_blocked_lines
from navbake.baker.geometry.shapes import boxes_in_batches
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


def resolve_seams(columns: Columns, tiled_shapes: TiledShapes, cells: Int | None = None) -> Columns:
    """Cast again, a little to the east or north, the lines that run exactly along seams of geoms.

    In scenes with round coordinates, many cells' centres lie exactly where one geom ends and the
    next one begins: on a seam. The column there has hits of both geoms. The bake decides as
    rasterizers do by their top-left rule: the line belongs to the geom east or north of the seam.

    A seam lies between faces of boxes, or triangles, that are perpendicular to x or y. At other
    faces, a line meets two geoms at once only by chance, so these are not searched.

    Args:
        columns: the columns.
        tiled_shapes: the shapes that they were cast from.
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
    box_bounds = _aligned_boxes(tiled_shapes, tiles)
    corners = _upright_triangles(tiled_shapes, tiles)

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
    is_on_seam_x = is_valid & _find_seams((center_x, center_y), 0, box_bounds, corners)
    is_on_seam_y = is_valid & _find_seams((center_x, center_y), 1, box_bounds, corners)
    seam_row, seam_col = np.nonzero(is_on_seam_x | is_on_seam_y)
    if not len(seam_row):
        return columns

    seam_cells = rows[seam_row] * lattice.width + cols[seam_col]
    points = lattice.positions(rows[seam_row], cols[seam_col])
    points[is_on_seam_x[seam_row, seam_col], 0] += SEAM_SHIFT
    points[is_on_seam_y[seam_row, seam_col], 1] += SEAM_SHIFT
    first_hit = columns.hits.start
    new_hits = cast_points(tiled_shapes, seam_cells, points)
    return replace_column_hits(
        columns, seam_cells, first_hit[seam_cells], first_hit[seam_cells + 1], new_hits
    )


def _aligned_boxes(tiled_shapes: TiledShapes, tiles: Int) -> Float:
    """Return the bounds of the axis-aligned boxes over some tiles, shape (n, 6) [m]."""
    solids = tiled_shapes.shapes.solids
    tile_index = tiled_shapes.tile_index
    is_over_tiles = _mark_items_over_tiles(
        tile_index.solid_start, tile_index.solid_indices, tiles, len(solids.geom)
    )
    box_indices = np.flatnonzero(is_over_tiles & (solids.kind == BOX))
    absolute_mat = abs(solids.mat[box_indices])
    is_aligned = np.minimum(absolute_mat, abs(absolute_mat - 1.0)).max(axis=1) < RIM_WIDTH
    bounds: Float = solids.bounds[box_indices[is_aligned]]
    return bounds


def _upright_triangles(tiled_shapes: TiledShapes, tiles: Int) -> Float:
    """Return the vertical triangles over some tiles that are perpendicular to x or to y.

    Returns:
        Their corners, shape (n, 3, 3) [m].
    """
    facets = tiled_shapes.facets
    tile_index = tiled_shapes.tile_index
    is_candidate = _mark_items_over_tiles(
        tile_index.triangle_start, tile_index.triangle_indices, tiles, len(facets.faces)
    )

    def drop_thick_triangles(first_triangle: int, end_triangle: int) -> None:
        for batch, boxes in boxes_in_batches(facets, first_triangle, end_triangle):
            size_x = boxes[:, 3] - boxes[:, 0]
            size_y = boxes[:, 4] - boxes[:, 1]
            is_candidate[batch] &= (size_x <= RIM_WIDTH) | (size_y <= RIM_WIDTH)

    run_in_chunks(drop_thick_triangles, len(facets.faces), min_chunk_size=4096)
    upright_corners: Float = facets.vertices[facets.faces[is_candidate]]
    return upright_corners


def _mark_items_over_tiles(
    tile_start: Int, items_by_tile: Int32, tiles: Int, num_items: int
) -> Bool:
    """Mark the items that lie over some tiles.

    Args:
        tile_start: index in `items_by_tile` of the first item over each tile, shape (tiles + 1,).
        items_by_tile: the items over the tiles, tile by tile, see `list_by_tile`.
        tiles: ids of tiles.
        num_items: how many items there are.

    Returns:
        A mask, shape (num_items,); all True if `tiles` are all tiles.
    """
    is_over_tiles = np.full(num_items, len(tiles) == len(tile_start) - 1)
    if not is_over_tiles.all():
        _, list_indices = expand_ranges(tile_start[tiles], tile_start[tiles + 1])
        is_over_tiles[items_by_tile[list_indices]] = True
    return is_over_tiles


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
    # of three arrays, which is faster than over an axis of three
    lowest_corner = np.minimum(np.minimum(corners[:, 0], corners[:, 1]), corners[:, 2])
    highest_corner = np.maximum(np.maximum(corners[:, 0], corners[:, 1]), corners[:, 2])
    first_edge = corners[:, 1] - corners[:, 0]
    second_edge = corners[:, 2] - corners[:, 0]
    # the normal's coordinate along the axis, whose sign says which way the face looks
    normal_along_axis = (
        first_edge[:, other_axis] * second_edge[:, 2]
        - first_edge[:, 2] * second_edge[:, other_axis]
    ) * (1 - 2 * axis)
    is_perpendicular_to_axis = highest_corner[:, axis] - lowest_corner[:, axis] <= RIM_WIDTH
    face_masks = []
    for is_upper_face in (False, True):
        is_face = is_perpendicular_to_axis & (
            normal_along_axis > 0 if is_upper_face else normal_along_axis < 0
        )
        box_face_coordinate = box_bounds[:, axis + 3 * is_upper_face]
        face_coordinate = np.concatenate([box_face_coordinate, lowest_corner[is_face, axis]])
        face_begin = np.concatenate([box_bounds[:, other_axis], lowest_corner[is_face, other_axis]])
        face_end = np.concatenate(
            [box_bounds[:, other_axis + 3], highest_corner[is_face, other_axis]]
        )
        face_masks.append(
            _mark_cells_in_faces(centers, axis, face_coordinate, face_begin, face_end)
        )
    return face_masks[0] & face_masks[1]


def _mark_cells_in_faces(
    centers: tuple[Float, Float],
    axis: int,
    face_coordinate: Float,
    face_begin: Float,
    face_end: Float,
) -> Bool:
    """Mark the cells of a window whose centres lie in faces, seen from above.

    Args:
        centers: x of the window's columns and y of its rows, ascending [m].
        axis: 0 for faces perpendicular to x, 1 for faces perpendicular to y.
        face_coordinate: the coordinate of each face along that axis, (n,) [m].
        face_begin: where each face begins along the other horizontal axis, (n,) [m].
        face_end: where each face ends along that axis, (n,) [m].

    Returns:
        A mask, shape (rows, cols) of the window; row 0 has the largest y.
    """
    centers_across_face = centers[axis]
    centers_along_face = centers[1 - axis]
    is_in_face = np.zeros((len(centers_across_face), len(centers_along_face)), dtype=np.bool_)
    first_center = np.searchsorted(centers_across_face, face_coordinate - 2 * RIM_WIDTH)
    holds_centers = first_center < len(centers_across_face)
    candidate_centers = first_center[holds_centers]
    holds_centers[holds_centers] = (
        centers_across_face[candidate_centers] <= face_coordinate[holds_centers] + 2 * RIM_WIDTH
    )
    if not holds_centers.any():
        return np.zeros((len(centers[1]), len(centers[0])), dtype=np.bool_)
    first_center_along = np.searchsorted(
        centers_along_face, face_begin[holds_centers] - 2 * RIM_WIDTH
    )
    end_center_along = np.searchsorted(
        centers_along_face, face_end[holds_centers] + 2 * RIM_WIDTH, side="right"
    )
    face_number, center_index_along = expand_ranges(first_center_along, end_center_along)
    is_in_face[first_center[holds_centers][face_number], center_index_along] = True
    return np.asarray((is_in_face.T if axis == 0 else is_in_face)[::-1])


def replace_column_hits(
    columns: Columns, cell_ids: Int, first_old_hit: Int, end_old_hit: Int, new_hits: ColumnHits
) -> Columns:
    """Replace hits of some columns.

    Args:
        columns: the columns.
        cell_ids: ids of cells, ascending, (n,); a cell is repeated if several ranges of its hits
            change.
        first_old_hit: index of the first hit to replace for each cell, in the arrays of
            `columns.hits` (not counted within the column), (n,).
        end_old_hit: index past the last hit to replace for each cell, (n,).
        new_hits: their replacements; its column i belongs to ``cell_ids[i]``.

    Returns:
        The new columns; `columns` are not changed.
    """
    old_hits = columns.hits
    first_cell, end_cell = columns.valid_rows.cell_range(columns.lattice)
    num_added = np.zeros(end_cell - first_cell + 1, dtype=np.int64)
    np.add.at(
        num_added,
        cell_ids + 1 - first_cell,
        np.diff(new_hits.start) - (end_old_hit - first_old_hit),
    )
    num_added_before = np.cumsum(num_added, out=num_added)
    start = np.zeros(len(old_hits.start), dtype=np.int64)  # whose pages cost nothing until written
    start_slice = slice(first_cell, end_cell + 1)
    np.add(old_hits.start[start_slice], num_added_before, out=start[start_slice])
    hit_arrays = list(old_hits.entries)

    def replace_in_arrays(first_array: int, end_array: int) -> None:
        for i in range(first_array, end_array):
            hit_arrays[i] = replace_slices(
                hit_arrays[i], first_old_hit, end_old_hit, new_hits.entries[i], new_hits.start
            )

    # numpy lets other threads run while it copies, so several arrays are copied at the same time
    run_in_chunks(replace_in_arrays, len(hit_arrays))
    return replace(columns, hits=ColumnHits(start, *hit_arrays))


# ---------------------------------------------------------------- cracks


def close_cracks(
    columns: Columns,
    tiled_shapes: TiledShapes,
    agent: AgentSettings,
    max_crack_distance: float,
    is_selected: Bool = ALL_CELLS,
) -> Columns:
    """Add floors to columns whose lines run in cracks of a floor.

    A line runs in a crack if floors lie on two opposite sides of it, each nearer than
    `max_crack_distance`, their heights differ by at most a step, and the line itself crosses no
    floor at that height. The lower of the two floors is added to the column, as a surface that
    encloses nothing. Of several such floors within a step of each other, only the lowest is added.
    The result for a cell does not depend on other cells.

    Args:
        columns: the columns.
        tiled_shapes: the shapes that they were cast from, listed for lines up to
            `max_crack_distance` away.
        agent: the agent, of which the slope and step are used.
        max_crack_distance: how far from the line the floors on both sides may be [m]; 0 adds
            nothing.
        is_selected: mask of the cells whose cracks are closed, shape (cells,); if empty, all cells.
    """
    if max_crack_distance == 0:
        return columns
    limits = make_agent_limits(agent)
    sides = _list_all_sides(columns, tiled_shapes, limits, max_crack_distance, is_selected)
    if not len(sides):
        return columns
    cell_ids = sides[:, CELL].astype(np.int64)
    direction = sides[:, DIRECTION : DIRECTION + 2]

    # rays just inside of the edges of the floors find their exact surfaces
    lattice = columns.lattice
    points = lattice.positions(*np.divmod(cell_ids, lattice.width))
    points += direction * (sides[:, DISTANCE, None] + DISTANCE_INSIDE_EDGE)
    ray_hits = cast_points(tiled_shapes, cell_ids, points)
    side_index = np.repeat(np.arange(len(cell_ids)), np.diff(ray_hits.start))  # of each hit
    height_difference = abs(ray_hits.z - sides[side_index, HEIGHT])
    is_floor = ray_hits.normal[:, 2] >= limits.min_normal_z
    is_on_piece = is_floor & (ray_hits.geom == sides[side_index, GEOM])
    is_on_piece &= height_difference <= MAX_PIECE_HEIGHT_ERROR + sides[side_index, RADIUS]
    hit_indices = np.flatnonzero(is_on_piece)
    hit_indices = hit_indices[np.lexsort((height_difference[hit_indices], side_index[hit_indices]))]
    side_index, first_hit_of_side = np.unique(side_index[hit_indices], return_index=True)
    hit_indices = hit_indices[first_hit_of_side]
    cell_ids = cell_ids[side_index]
    direction = direction[side_index]
    # a floor that is buried there, but not at the cell's line, ends at the foot of something
    is_beside_crack = ~_mark_buried_heights(ray_hits, side_index, ray_hits.z[hit_indices])
    is_beside_crack |= _mark_buried_heights(columns.hits, cell_ids, ray_hits.z[hit_indices])
    hit_indices = hit_indices[is_beside_crack]
    cell_ids = cell_ids[is_beside_crack]
    direction = direction[is_beside_crack]

    is_lower_side = _find_lower_sides(cell_ids, ray_hits.z[hit_indices], direction, limits.max_step)
    hit_indices = hit_indices[is_lower_side]
    cell_ids = cell_ids[is_lower_side]
    z = ray_hits.z[hit_indices]
    lowest_indices = list[int]()  # of the surfaces of a cell that are within a step of each other
    for candidate in np.lexsort((ray_hits.geom[hit_indices], z, cell_ids)).tolist():
        is_new_cell = not lowest_indices or cell_ids[lowest_indices[-1]] != cell_ids[candidate]
        if is_new_cell or z[candidate] - z[lowest_indices[-1]] > limits.max_step + LIMIT_SLACK:
            lowest_indices.append(candidate)
    return (
        _add_surfaces(columns, cell_ids[lowest_indices], ray_hits, hit_indices[lowest_indices])
        if lowest_indices
        else columns
    )


def _list_all_sides(
    columns: Columns,
    tiled_shapes: TiledShapes,
    limits: AgentLimits,
    max_crack_distance: float,
    is_selected: Bool,
) -> Float:
    """List the pieces of floor on both sides of cracks, see `list_sides`, ordered by cell.

    Returns:
        A row of numbers for each piece, see `crack_kernels`, shape (n, NUMBERS_PER_SIDE), float64.
    """
    tiles = tiles_of_rows(columns.lattice, columns.valid_rows)
    sides_of_chunk = dict[int, Float]()  # by the first tile of the chunk

    def list_chunk(first_tile: int, end_tile: int) -> None:
        sides, num_sides = list_sides(
            columns.lattice,
            columns.hits,
            tiled_shapes.shapes.solids,
            tiled_shapes.facets,
            tiled_shapes.tile_index,
            limits,
            max_crack_distance,
            is_selected,
            first_tile,
            end_tile,
        )
        sides_of_chunk[first_tile] = sides[:num_sides]

    run_in_chunks(list_chunk, len(tiles), begin=tiles.start)
    if not sides_of_chunk:
        return np.empty((0, CELL + 1))
    sides = np.concatenate([sides_of_chunk[first_tile] for first_tile in sorted(sides_of_chunk)])
    return sides[np.argsort(sides[:, CELL], kind="stable")]


def _find_lower_sides(cell_ids: Int, z: Float, direction: Float, max_step: float) -> Bool:
    """Mark the lower floor of each pair that bounds a crack from opposite sides.

    The two floors of a pair belong to one cell, and their heights differ by at most a step.

    Args:
        cell_ids: the cell of each floor, ascending, (n,).
        z: height of each floor, (n,) [m].
        direction: unit vector from the cell's centre to each floor, (n, 2).
        max_step: the largest step [m].

    Returns:
        A mask, shape (n,); of two floors at one height, both are marked.
    """
    is_lower = np.zeros(len(cell_ids), dtype=np.bool_)
    max_sides_per_cell = int(np.unique(cell_ids, return_counts=True)[1].max(initial=1))
    for index_distance in range(1, max_sides_per_cell):
        first_floor = slice(None, -index_distance)
        second_floor = slice(index_distance, None)
        is_crack = cell_ids[first_floor] == cell_ids[second_floor]
        is_crack &= abs(z[first_floor] - z[second_floor]) <= max_step + LIMIT_SLACK
        is_crack &= (direction[first_floor] * direction[second_floor]).sum(
            axis=1
        ) <= -MIN_SAME_DIRECTION_COSINE
        is_lower[first_floor] |= is_crack & (z[first_floor] <= z[second_floor])
        is_lower[second_floor] |= is_crack & (z[second_floor] <= z[first_floor])
    return is_lower


def _mark_buried_heights(hits: ColumnHits, cells: Int, z: Float) -> Bool:
    """Mark the heights just above which a column's line runs inside of something, or crosses it.

    Args:
        hits: the columns.
        cells: index of the column for each height, (n,).
        z: heights, (n,) [m].

    Returns:
        A mask, shape (n,), bool.
    """
    is_buried = np.empty(len(cells), dtype=np.bool_)
    low_z = z + SAME_HEIGHT
    high_z = z + 2.0 * SAME_HEIGHT
    find_blocked_lines(cells, low_z, high_z, hits, is_buried, 0, len(cells))
    return is_buried


def _add_surfaces(
    columns: Columns, cell_ids: Int, ray_hits: ColumnHits, hit_indices: Int
) -> Columns:
    """Add the hits of rays to the columns of cells, as surfaces that enclose nothing.

    Args:
        columns: the columns.
        cell_ids: the cell that each hit is added to, (n,).
        ray_hits: the hits of the rays.
        hit_indices: index of each hit in `ray_hits`, ordered by cell and then height, (n,).
    """
    old_hits = columns.hits
    z = ray_hits.z[hit_indices]
    insert_index = old_hits.start[cell_ids]
    end_hit = old_hits.start[cell_ids + 1]
    while True:
        indices_to_advance = np.flatnonzero(insert_index < end_hit)
        indices_to_advance = indices_to_advance[
            old_hits.z[insert_index[indices_to_advance]] < z[indices_to_advance]
        ]
        if not len(indices_to_advance):
            break
        insert_index[indices_to_advance] += 1
    new_hits = ColumnHits(
        start=np.arange(len(z) + 1),
        z=z,
        normal=ray_hits.normal[hit_indices],
        geom=ray_hits.geom[hit_indices],
        closed=np.full(len(z), OPEN_SURFACE, np.uint8),
    )
    return replace_column_hits(columns, cell_ids, insert_index, insert_index, new_hits)
