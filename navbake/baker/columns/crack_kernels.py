"""Find cracks: cells whose vertical line crosses no floor, between floors on opposite sides of it.

The surfaces that an agent can stand on are divided into convex pieces. A piece is a triangle or a
face of a box within the slope limit; or the part of a round solid's surface within it, which is
described by a point or a segment, and a radius. Seen from above, the direction from a line to the
nearest point of a piece is perpendicular to the piece's edge. So the directions to the two sides of
a crack are opposite.

A side is a piece beside a line, stored as a row of numbers; the constants from DIRECTION to
PREVIOUS are the indices of its numbers.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.baker.core.arrays import Facets, ShapeIndex, Solids
from navbake.baker.core.bisection_kernels import find_first_at_or_above
from navbake.baker.core.constants import BOX, CAPSULE, CYLINDER
from navbake.baker.core.tiles import TILE, cell_center_at, tile_window, window_near_box
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.geometry.triangle_kernels import area_normal, faces_up
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Float, Int

# A surface that a ray hits belongs to a piece of floor if its height differs from the piece's by at
# most this plus the piece's radius [m]
MAX_PIECE_HEIGHT_ERROR = 1e-3
# Directions count as equal if the cosine of the angle between them is at least this (26 degrees),
# and as opposite if it is at most the negative of this
MIN_SAME_DIRECTION_COSINE = 0.9
# Indices of the numbers of a side
DIRECTION = 0  # x, then y of the unit vector from the line to the nearest point of the piece
DISTANCE = 2  # distance from the line to that point, seen from above [m]
HEIGHT = 3  # z of that point [m]
RADIUS = 4  # radius of the piece, 0 for triangles and boxes [m]
GEOM = 5  # the piece's geom id
CELL = 6  # the id of the line's cell
PREVIOUS = 7  # index of the previous side of the same cell, or -1
NUMBERS_PER_SIDE = 8
# At most this many heights are kept at which all cells of a tile have a floor; to forget others
# costs time alone
MAX_COMMON_HEIGHTS = 8


class TiledGeometry(NamedTuple):
    """Shapes, and which of them lie over each tile.

    Attributes:
        solids: primitives.
        facets: triangles.
        tile_index: which of them lie over each tile of cells, or at most a crack's width beside it.
    """

    solids: Solids
    facets: Facets
    tile_index: ShapeIndex


class CrackScratch(NamedTuple):
    """Arrays that `_list_in_tile` works in, allocated once for many tiles.

    Attributes:
        candidate_sides: sides that may bound a crack, see the module's docstring, (n,
            NUMBERS_PER_SIDE) float64.
        corners: the corners of a piece of floor, (4, 3) float64 [m].
        box: the box around a piece: lower corner, upper corner, (1, 6) float64 [m].
        nearest_point: the point of a piece nearest to a line, (3,) float64 [m].
        common_heights: heights at which all cells of a tile have a floor, (MAX_COMMON_HEIGHTS,)
            float64 [m].
        last_side_of_cell: index in `candidate_sides` of the last side of each cell of a tile, -1
            for none, (TILE * TILE,) int64.
    """

    candidate_sides: Float
    corners: Float
    box: Float
    nearest_point: Float
    common_heights: Float
    last_side_of_cell: Int


@subkernel
def _make_scratch(num_candidate_sides):
    """Allocate a `CrackScratch` with room for `num_candidate_sides` sides."""
    return CrackScratch(
        np.empty((num_candidate_sides, NUMBERS_PER_SIDE)),
        np.empty((4, 3)),
        np.empty((1, 6)),
        np.empty(3),
        np.empty(MAX_COMMON_HEIGHTS),
        np.empty(TILE * TILE, np.int64),
    )


@subkernel(**NO_REFCOUNT)
def _write_piece(solids, facets, shape_number, face_axis, min_normal_z, corners):
    """Write the corners of a piece of floor: a triangle, a box's upper face, or a solid's top.

    Args:
        solids, facets: the shapes, as `Solids` and `Facets`.
        shape_number: index into `facets` if `face_axis` is -1, else into `solids`.
        face_axis: -1 for a triangle; for a box, the number of its own axis across which the face
            lies, the upper one of two; 0 for the upper part of a round solid.
        min_normal_z: least z of a unit normal within the slope limit.
        corners: receives the corners, (4, 3) float64 [m].

    Returns:
        The number of corners, 0 if the piece is too steep; and the radius around the corners that
        belongs to the piece, 0 for triangles and boxes [m].
    """
    if face_axis < 0:
        if not faces_up(facets, shape_number):  # as most triangles
            return 0, 0.0
        a = facets.vertices[facets.faces[shape_number, 0]]
        b = facets.vertices[facets.faces[shape_number, 1]]
        c = facets.vertices[facets.faces[shape_number, 2]]
        normal_x, normal_y, normal_z = area_normal(a, b, c)
        if normal_z * normal_z < min_normal_z * min_normal_z * (
            normal_x * normal_x + normal_y * normal_y + normal_z * normal_z
        ):
            return 0, 0.0
        for k in range(3):
            corners[0, k] = a[k]
            corners[1, k] = b[k]
            corners[2, k] = c[k]
        return 3, 0.0
    pos = solids.pos[shape_number]
    mat = solids.mat[shape_number]
    size = solids.size[shape_number]
    kind = solids.kind[shape_number]
    if kind == BOX:
        face_sign = 1.0 if mat[6 + face_axis] > 0.0 else -1.0
        first_axis = (face_axis + 1) % 3
        second_axis = (face_axis + 2) % 3
        for i in range(4):
            offset_along = size[first_axis] if i in (1, 2) else -size[first_axis]
            offset_across = size[second_axis] if i >= 2 else -size[second_axis]
            for k in range(3):
                face_center = pos[k] + face_sign * size[face_axis] * mat[3 * k + face_axis]
                corners[i, k] = (
                    face_center
                    + offset_along * mat[3 * k + first_axis]
                    + offset_across * mat[3 * k + second_axis]
                )
        return 4 if face_sign * mat[6 + face_axis] >= min_normal_z else 0, 0.0
    # the part of a sphere that faces up within the slope: its radius seen from above, and the
    # height of its rim over the centre
    radius = size[0] * math.sqrt(max(1.0 - min_normal_z * min_normal_z, 0.0))
    rim_height = size[0] * min_normal_z
    half_length = 0.0
    num_corners = 1
    if kind == CYLINDER and abs(mat[8]) >= min_normal_z:  # its upper end
        radius = size[0] * abs(mat[8])
        rim_height = 0.0
        half_length = size[1]
    elif kind in (CYLINDER, CAPSULE):
        half_length = size[1]
        num_corners = 2
    elif size[1] > 0.0:  # an ellipsoid, as if it stood upright, by its smaller horizontal radius
        radius = radius * min(1.0, size[1] / size[0])
        rim_height = size[2] * min_normal_z
    for i in range(num_corners):
        offset_along_axis = half_length if (mat[8] >= 0.0) == (i == 0) else -half_length
        for k in range(3):
            corners[i, k] = (
                pos[k] + offset_along_axis * mat[3 * k + 2] + (rim_height if k == 2 else 0.0)
            )
    return num_corners, radius


@subkernel(**NO_REFCOUNT)
def _horizontal_distance(corners, num_corners, radius, x, y, nearest_point):
    """Return the distance from a vertical line to a piece of floor, seen from above [m].

    It is 0 or negative where the line crosses the piece.

    Args:
        corners: the corners of the piece, (4, 3) float64 [m].
        num_corners: how many of them the piece has.
        radius: the radius around the corners that belongs to the piece [m].
        x, y: the line [m].
        nearest_point: receives the point nearest to the line of the polygon of corners, without the
            radius; x and y are relative to the line, (3,) [m].
    """
    least_squared_distance = math.inf
    is_left_of_any = False
    is_right_of_any = False
    for i in range(num_corners):
        j = i + 1 if i + 1 < num_corners else 0
        corner_dx = corners[i, 0] - x
        corner_dy = corners[i, 1] - y
        edge_x = corners[j, 0] - corners[i, 0]
        edge_y = corners[j, 1] - corners[i, 1]
        squared_length = edge_x * edge_x + edge_y * edge_y
        edge_fraction = 0.0
        if squared_length > 0.0:
            edge_fraction = min(
                max(-(corner_dx * edge_x + corner_dy * edge_y) / squared_length, 0.0), 1.0
            )
        dx = corner_dx + edge_fraction * edge_x
        dy = corner_dy + edge_fraction * edge_y
        side_sign = edge_x * corner_dy - edge_y * corner_dx
        is_left_of_any = is_left_of_any or side_sign > 0.0
        is_right_of_any = is_right_of_any or side_sign < 0.0
        if dx * dx + dy * dy < least_squared_distance:
            least_squared_distance = dx * dx + dy * dy
            nearest_point[0] = dx
            nearest_point[1] = dy
            nearest_point[2] = corners[i, 2] + edge_fraction * (corners[j, 2] - corners[i, 2])
    is_inside = num_corners > 2 and is_left_of_any != is_right_of_any
    return 0.0 if is_inside else math.sqrt(least_squared_distance) - radius


@subkernel(**NO_REFCOUNT)
def _has_floor(column_hits, cell, z, max_step, min_normal_z):
    """Return whether a cell's line crosses a floor at most `max_step` above or below height z [m].

    A floor is a surface whose unit normal has a z of at least `min_normal_z`.
    """
    end_hit = column_hits.start[cell + 1]
    # from a little lower, as the difference is rounded
    lowest_z = z - max_step - LIMIT_SLACK
    first_hit = find_first_at_or_above(column_hits.z, column_hits.start[cell], end_hit, lowest_z)
    for i in range(first_hit, end_hit):
        if column_hits.z[i] - z > max_step:
            break
        if abs(column_hits.z[i] - z) <= max_step and column_hits.normal[i, 2] >= min_normal_z:
            return True
    return False


@subkernel(**NO_REFCOUNT)
def _find_common_heights(lattice, column_hits, window, is_selected, limits, common_heights):
    """Find heights at which all selected cells of a window have a floor, to within half a step.

    Args:
        lattice: the cells, as `Lattice`.
        column_hits: their columns, as `ColumnHits`.
        window: rows and columns of cells, see `tile_window`.
        is_selected: mask of the cells that count, (cells,) bool; if empty, all cells.
        limits: what an agent can stand on, as `AgentLimits`.
        common_heights: receives the heights, (MAX_COMMON_HEIGHTS,) float64 [m].

    Returns:
        How many heights were written; -1 if no cell of the window is selected.
    """
    num_heights = -1
    for row in range(window[0], window[1]):
        for col in range(window[2], window[3]):
            cell = row * lattice.width + col
            if is_selected.shape[0] > 0 and not is_selected[cell]:
                continue
            if num_heights < 0:
                num_heights = 0
                for i in range(column_hits.start[cell], column_hits.start[cell + 1]):
                    is_floor = column_hits.normal[i, 2] >= limits.min_normal_z
                    if is_floor and num_heights < MAX_COMMON_HEIGHTS:
                        common_heights[num_heights] = column_hits.z[i]
                        num_heights += 1
            num_common_heights = 0
            for k in range(num_heights):
                if _has_floor(
                    column_hits, cell, common_heights[k], limits.max_step / 2.0, limits.min_normal_z
                ):
                    common_heights[num_common_heights] = common_heights[k]
                    num_common_heights += 1
            num_heights = num_common_heights
    return num_heights


@subkernel(inline="always")
def _is_near_common_height(common_heights, num_heights, lowest_z, highest_z, max_step):
    """Return whether all cells of a tile surely have a floor within a step of a range of heights.

    False means that they may or may not have one.

    Args:
        common_heights: heights at which all cells have a floor, see `_find_common_heights` [m].
        num_heights: how many heights there are.
        lowest_z: the lower end of the range [m]; a floor has to be within a step of all of it.
        highest_z: the upper end of the range [m].
        max_step: the highest step [m].
    """
    is_near = False
    for k in range(num_heights):
        is_near = (
            is_near
            or max(highest_z - common_heights[k], common_heights[k] - lowest_z) <= max_step / 2.0
        )
    return is_near


@subkernel(**NO_REFCOUNT)
def _bounds_crack(sides, side, last_side, max_step):
    """Return whether a side, which is a piece of floor beside a cell's line, bounds a crack.

    It does if the cell has another side in the opposite direction, and no nearer side in the same
    direction. Only sides within a step of its height count.

    Args:
        sides: sides, (m, NUMBERS_PER_SIDE) float64, see the module's docstring.
        side: index of a side.
        last_side: index of the last side of the same cell.
        max_step: the highest step [m].
    """
    other_side = last_side
    has_opposite = False
    while other_side >= 0:
        cosine = (
            sides[side, DIRECTION] * sides[other_side, DIRECTION]
            + sides[side, DIRECTION + 1] * sides[other_side, DIRECTION + 1]
        )
        height_tolerance = (
            sides[side, RADIUS] + sides[other_side, RADIUS] + 2.0 * MAX_PIECE_HEIGHT_ERROR
        )
        if abs(sides[side, HEIGHT] - sides[other_side, HEIGHT]) <= max_step + height_tolerance:
            is_nearer = sides[other_side, DISTANCE] < sides[side, DISTANCE] - MAX_PIECE_HEIGHT_ERROR
            if cosine >= MIN_SAME_DIRECTION_COSINE and is_nearer:
                return False
            has_opposite = has_opposite or cosine <= -MIN_SAME_DIRECTION_COSINE
        other_side = np.int64(sides[other_side, PREVIOUS])
    return has_opposite


@subkernel(**NO_REFCOUNT)
def _list_in_tile(
    lattice,
    column_hits,
    geometry,
    tile,
    limits,
    max_crack_distance,
    is_selected,
    scratch,
    sides,
    num_sides,
):
    """List the sides of cracks in one tile of cells: append them to `sides`.

    For each piece of floor, the lines of cells near it are visited. The piece becomes a candidate
    side of those lines that cross no floor near its height. Candidates that bound a crack are
    listed.

    Args:
        lattice: the cells, as `Lattice`.
        column_hits: their columns.
        geometry: the shapes, as `TiledGeometry`.
        tile: the number of the tile.
        limits: what an agent can stand on.
        max_crack_distance: how far from the line the floors on both sides may be [m].
        is_selected: mask of the cells whose lines are tested, (cells,) bool; if empty, all cells.
        scratch: a `CrackScratch`.
        sides: receives the sides from row `num_sides` on, (m, NUMBERS_PER_SIDE) float64.
        num_sides: how many sides are listed already.

    Returns:
        The new number of sides; -1 if there is no room for them.
    """
    solids = geometry.solids
    facets = geometry.facets
    tile_index = geometry.tile_index
    candidate_sides = scratch.candidate_sides
    corners = scratch.corners
    box = scratch.box
    nearest_point = scratch.nearest_point
    common_heights = scratch.common_heights
    last_side_of_cell = scratch.last_side_of_cell
    first_entry = tile_index.solid_start[tile]
    end_of_solid_entries = tile_index.solid_start[tile + 1]
    triangle_entry_shift = tile_index.triangle_start[tile] - end_of_solid_entries
    end_entry = tile_index.triangle_start[tile + 1] - triangle_entry_shift
    window = tile_window(lattice, tile)
    num_common_heights = -1
    num_candidate_sides = 0
    max_step = limits.max_step + LIMIT_SLACK
    if end_entry - first_entry > 1:
        num_common_heights = _find_common_heights(
            lattice, column_hits, window, is_selected, limits, common_heights
        )
    last_side_of_cell[:] = -1
    # the solids over the tile, then the triangles
    for entry in range(first_entry, end_entry if num_common_heights >= 0 else first_entry):
        shape_number = np.int64(0)
        face_axis = -1
        num_faces = 0
        if entry >= end_of_solid_entries:
            shape_number = np.int64(tile_index.triangle_indices[entry + triangle_entry_shift])
        else:
            shape_number = np.int64(tile_index.solid_indices[entry])
            face_axis = 0
            num_faces = 3 if solids.kind[shape_number] == BOX else 1
        while face_axis < num_faces:
            if num_sides + num_candidate_sides + TILE * TILE > candidate_sides.shape[0]:
                return -1
            num_corners, radius = _write_piece(
                solids, facets, shape_number, face_axis, limits.min_normal_z, corners
            )
            if num_corners == 0:
                face_axis += 1
                continue
            for k in range(3):
                box[0, k] = math.inf
                box[0, 3 + k] = -math.inf
                for i in range(num_corners):
                    box[0, k] = min(box[0, k], corners[i, k])
                    box[0, 3 + k] = max(box[0, 3 + k], corners[i, k])
            # a line over the piece mostly has a floor near all of its heights: the piece itself
            middle_z = (box[0, 2] + box[0, 5]) / 2.0
            max_height_difference = max_step - (box[0, 5] - box[0, 2]) / 2.0
            row_first = window[0]
            row_end = window[0]
            col_first = 0
            col_end = 0
            if not _is_near_common_height(
                common_heights, num_common_heights, box[0, 2], box[0, 5], limits.max_step
            ):
                row_first, row_end, col_first, col_end = window_near_box(
                    lattice, window, box, 0, max_crack_distance + radius
                )
            for row in range(row_first, row_end):
                for col in range(col_first, col_end):
                    cell = row * lattice.width + col
                    if not (is_selected.shape[0] == 0 or is_selected[cell]) or _has_floor(
                        column_hits, cell, middle_z, max_height_difference, limits.min_normal_z
                    ):
                        continue
                    x, y = cell_center_at(lattice, row, col)
                    distance = _horizontal_distance(
                        corners, num_corners, radius, x, y, nearest_point
                    )
                    if not 0.0 < distance < max_crack_distance or _has_floor(
                        column_hits, cell, nearest_point[2], max_step, limits.min_normal_z
                    ):
                        continue
                    cell_in_tile = (row - window[0]) * TILE + col - window[2]
                    side = candidate_sides[num_candidate_sides]
                    side[DIRECTION] = nearest_point[0] / (distance + radius)
                    side[DIRECTION + 1] = nearest_point[1] / (distance + radius)
                    side[DISTANCE] = distance
                    side[HEIGHT] = nearest_point[2]
                    side[RADIUS] = radius
                    side[CELL] = cell
                    side[PREVIOUS] = last_side_of_cell[cell_in_tile]
                    side[GEOM] = (
                        solids.geom[shape_number]
                        if entry < end_of_solid_entries
                        else facets.geom[shape_number]
                    )
                    last_side_of_cell[cell_in_tile] = num_candidate_sides
                    num_candidate_sides += 1
            face_axis += 1
    for cell_in_tile in range(TILE * TILE if num_candidate_sides > 1 else 0):
        side_number = last_side_of_cell[cell_in_tile]
        while side_number >= 0:
            if _bounds_crack(
                candidate_sides, side_number, last_side_of_cell[cell_in_tile], limits.max_step
            ):
                for k in range(NUMBERS_PER_SIDE):
                    sides[num_sides, k] = candidate_sides[side_number, k]
                num_sides += 1
            side_number = np.int64(candidate_sides[side_number, PREVIOUS])
    return num_sides


@kernel(nogil=True)
def list_sides(
    lattice,
    column_hits,
    solids,
    facets,
    tile_index,
    limits,
    max_crack_distance,
    is_selected,
    first_tile,
    end_tile,
):
    """Find the cells whose vertical line runs in a crack, and list the floor on both sides of it.

    A line runs in a crack if it crosses no floor, and pieces of floor at that height lie on
    opposite sides of it.

    Args:
        lattice: the cells, as `Lattice`.
        column_hits: their columns, as `ColumnHits`.
        solids, facets: the shapes, as `Solids` and `Facets`.
        tile_index: the shapes over each tile, including those within `max_crack_distance` of it.
        limits: what an agent can stand on, as `AgentLimits`.
        max_crack_distance: how far from the line the floors on both sides may be [m].
        is_selected: mask of the cells whose lines are tested, (cells,) bool; if empty, all cells.
        first_tile: number of the first tile.
        end_tile: number past the last one.

    Returns:
        An array whose rows are sides, see the module's docstring, (m, NUMBERS_PER_SIDE) float64;
        and how many of its first rows are valid.
    """
    geometry = TiledGeometry(solids, facets, tile_index)
    scratch = _make_scratch(np.int64(256))
    sides = np.empty((256, NUMBERS_PER_SIDE))
    num_sides = np.int64(0)
    for tile in range(first_tile, end_tile):
        while True:
            new_num_sides = _list_in_tile(
                lattice,
                column_hits,
                geometry,
                tile,
                limits,
                max_crack_distance,
                is_selected,
                scratch,
                sides,
                num_sides,
            )
            if new_num_sides >= 0:
                break
            scratch = _make_scratch(2 * scratch.candidate_sides.shape[0])
            larger_sides = np.empty((2 * sides.shape[0], NUMBERS_PER_SIDE))
            for n in range(num_sides):
                for k in range(NUMBERS_PER_SIDE):
                    larger_sides[n, k] = sides[n, k]
            sides = larger_sides
        num_sides = new_num_sides
    return sides, num_sides
