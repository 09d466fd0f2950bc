"""Find cracks: cells whose vertical line crosses no floor, between floors on opposite sides of it.

What an agent can stand on is divided into convex pieces. A piece is a triangle or a face of a box
that keeps the slope limit; or the part of a round solid's surface that keeps it, which is described
by a point or a segment, and a radius. Seen from above, the direction from a line to the nearest
point of a piece is perpendicular to the piece's edge. So the directions to the two sides of a crack
are opposite.

A side is a piece beside a line, stored as a row of numbers; the constants from DIRECTION to
PREVIOUS are the indices of its numbers.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.baker.core.arrays import Facets, ShapeIndex, Solids
from navbake.baker.core.constants import BOX, CAPSULE, CYLINDER
from navbake.baker.core.tiles import TILE, cell_center_at, tile_window, window_near_box
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Float, Int

# A surface that a ray hits belongs to a piece of floor if its height differs from the piece's by at
# most this plus the piece's radius [m]
SAME_PIECE = 1e-3
# Directions count as equal if the cosine of the angle between them is at least this (26 degrees),
# and as opposite if it is at most the negative of this
SAME_DIRECTION = 0.9
# Indices of the numbers of a side
DIRECTION = 0  # x, then y of the unit vector from the line to the nearest point of the piece
DISTANCE = 2  # distance from the line to that point, seen from above [m]
HEIGHT = 3  # z of that point [m]
RADIUS = 4  # radius of the piece, 0 for triangles and boxes [m]
GEOM = 5  # the piece's geom id
CELL = 6  # the id of the line's cell
PREVIOUS = 7  # index of the previous side of the same cell, or -1
NUM_COLUMNS = 8
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
        candidates: sides that may bound a crack, see the module's docstring, (n, NUM_COLUMNS)
            float64.
        corners: the corners of a piece of floor, (4, 3) float64 [m].
        box: the box around a piece: lower corner, upper corner, (1, 6) float64 [m].
        nearest: the point of a piece nearest to a line, (3,) float64 [m].
        heights: heights at which all cells of a tile have a floor, (MAX_COMMON_HEIGHTS,) float64
            [m].
        last_side: index in `candidates` of the last side of each cell of a tile, -1 for none,
            (TILE * TILE,) int64.
    """

    candidates: Float
    corners: Float
    box: Float
    nearest: Float
    heights: Float
    last_side: Int


@subkernel
def _make_scratch(num_candidates):
    """Allocate a `CrackScratch` with room for `num_candidates` sides."""
    return CrackScratch(
        np.empty((num_candidates, NUM_COLUMNS)),
        np.empty((4, 3)),
        np.empty((1, 6)),
        np.empty(3),
        np.empty(MAX_COMMON_HEIGHTS),
        np.empty(TILE * TILE, np.int64),
    )


@subkernel(**NO_REFCOUNT)
def _write_piece(solids, facets, item, face, min_up, corners):
    """Write the corners of a piece of floor: a triangle, a box's upper face, or a solid's top.

    Args:
        solids, facets: the shapes, as `Solids` and `Facets`.
        item: index into `facets` if `face` is -1, else into `solids`.
        face: -1 for a triangle; for a box, the number of its own axis across which the face lies,
            the upper one of two; 0 for the upper part of a round solid.
        min_up: least z of a unit normal within the slope limit.
        corners: receives the corners, (4, 3) float64 [m].

    Returns:
        The number of corners, 0 if the piece is too steep; and the radius around the corners that
        belongs to the piece, 0 for triangles and boxes [m].
    """
    if face < 0:
        c = facets.corners[item]
        ux = c[1, 0] - c[0, 0]
        uy = c[1, 1] - c[0, 1]
        uz = c[1, 2] - c[0, 2]
        vx = c[2, 0] - c[0, 0]
        vy = c[2, 1] - c[0, 1]
        vz = c[2, 2] - c[0, 2]
        x = uy * vz - uz * vy
        y = uz * vx - ux * vz
        z = ux * vy - uy * vx
        if not z > 0.0 or z * z < min_up * min_up * (x * x + y * y + z * z):
            return 0, 0.0
        for i in range(3):
            for k in range(3):
                corners[i, k] = c[i, k]
        return 3, 0.0
    pos = solids.pos[item]
    mat = solids.mat[item]
    size = solids.size[item]
    kind = solids.kind[item]
    if kind == BOX:
        up = 1.0 if mat[6 + face] > 0.0 else -1.0
        a = (face + 1) % 3
        b = (face + 2) % 3
        for i in range(4):
            along = size[a] if i in (1, 2) else -size[a]
            across = size[b] if i >= 2 else -size[b]
            for k in range(3):
                center = pos[k] + up * size[face] * mat[3 * k + face]
                corners[i, k] = center + along * mat[3 * k + a] + across * mat[3 * k + b]
        return 4 if up * mat[6 + face] >= min_up else 0, 0.0
    # the part of a sphere that faces up within the slope: its radius seen from above, and the
    # height of its rim over the centre
    radius = size[0] * math.sqrt(max(1.0 - min_up * min_up, 0.0))
    rise = size[0] * min_up
    half_length = 0.0
    num_corners = 1
    if kind == CYLINDER and abs(mat[8]) >= min_up:  # its upper end
        radius = size[0] * abs(mat[8])
        rise = 0.0
        half_length = size[1]
    elif kind in (CYLINDER, CAPSULE):
        half_length = size[1]
        num_corners = 2
    elif size[1] > 0.0:  # an ellipsoid, as if it stood upright, by its smaller horizontal radius
        radius = radius * min(1.0, size[1] / size[0])
        rise = size[2] * min_up
    for i in range(num_corners):
        offset = half_length if (mat[8] >= 0.0) == (i == 0) else -half_length
        for k in range(3):
            corners[i, k] = pos[k] + offset * mat[3 * k + 2] + (rise if k == 2 else 0.0)
    return num_corners, radius


@subkernel(**NO_REFCOUNT)
def _distance(corners, num_corners, radius, x, y, nearest):
    """Return the distance from a vertical line to a piece of floor, seen from above [m].

    It is 0 or negative where the line crosses the piece.

    Args:
        corners: the corners of the piece, (4, 3) float64 [m].
        num_corners: how many of them the piece has.
        radius: the radius around the corners that belongs to the piece [m].
        x, y: the line [m].
        nearest: receives the point nearest to the line of the polygon of corners, without the
            radius; x and y are relative to the line, (3,) [m].
    """
    least_square = math.inf
    is_left_of_any = False
    is_right_of_any = False
    for i in range(num_corners):
        j = i + 1 if i + 1 < num_corners else 0
        ax = corners[i, 0] - x
        ay = corners[i, 1] - y
        ex = corners[j, 0] - corners[i, 0]
        ey = corners[j, 1] - corners[i, 1]
        length = ex * ex + ey * ey
        t = 0.0
        if length > 0.0:
            t = min(max(-(ax * ex + ay * ey) / length, 0.0), 1.0)
        dx = ax + t * ex
        dy = ay + t * ey
        side = ex * ay - ey * ax
        is_left_of_any = is_left_of_any or side > 0.0
        is_right_of_any = is_right_of_any or side < 0.0
        if dx * dx + dy * dy < least_square:
            least_square = dx * dx + dy * dy
            nearest[0] = dx
            nearest[1] = dy
            nearest[2] = corners[i, 2] + t * (corners[j, 2] - corners[i, 2])
    is_inside = num_corners > 2 and is_left_of_any != is_right_of_any
    return 0.0 if is_inside else math.sqrt(least_square) - radius


@subkernel(**NO_REFCOUNT)
def _has_floor(column_hits, cell, z, step, min_up):
    """Return whether a cell's line crosses a floor at most `step` above or below height z [m].

    A floor is a surface whose unit normal has a z of at least `min_up`.
    """
    has_floor = False
    for i in range(column_hits.start[cell], column_hits.start[cell + 1]):
        is_near = abs(column_hits.z[i] - z) <= step
        has_floor = has_floor or (is_near and column_hits.normal[i, 2] >= min_up)
    return has_floor


@subkernel(**NO_REFCOUNT)
def _find_common_heights(lattice, column_hits, window, selected, limits, heights):
    """Find heights at which all selected cells of a window have a floor, to within half a step.

    Args:
        lattice: the cells, as `Lattice`.
        column_hits: their columns, as `ColumnHits`.
        window: rows and columns of cells, see `tile_window`.
        selected: mask of the cells that count, (cells,) bool; if empty, all cells.
        limits: what an agent can stand on, as `AgentLimits`.
        heights: receives the heights, (MAX_COMMON_HEIGHTS,) float64 [m].

    Returns:
        How many heights were written; -1 if no cell of the window is selected.
    """
    count = -1
    for row in range(window[0], window[1]):
        for col in range(window[2], window[3]):
            cell = row * lattice.width + col
            if selected.shape[0] > 0 and not selected[cell]:
                continue
            if count < 0:
                count = 0
                for i in range(column_hits.start[cell], column_hits.start[cell + 1]):
                    is_floor = column_hits.normal[i, 2] >= limits.min_up
                    if is_floor and count < MAX_COMMON_HEIGHTS:
                        heights[count] = column_hits.z[i]
                        count += 1
            num_common = 0
            for k in range(count):
                if _has_floor(column_hits, cell, heights[k], limits.step / 2.0, limits.min_up):
                    heights[num_common] = heights[k]
                    num_common += 1
            count = num_common
    return count


@subkernel(inline="always")
def _is_common(heights, count, low, high, step):
    """Return whether all cells of a tile surely have a floor within a step of a range of heights.

    False means that they may or may not have one.

    Args:
        heights: heights at which all cells have a floor, see `_find_common_heights` [m].
        count: how many heights there are.
        low, high: the range [m]; a floor has to be within a step of all of it.
        step: the highest step [m].
    """
    is_common = False
    for k in range(count):
        is_common = is_common or max(high - heights[k], heights[k] - low) <= step / 2.0
    return is_common


@subkernel(**NO_REFCOUNT)
def _bounds_crack(sides, n, last, step):
    """Return whether side n, a piece of floor beside a cell's line, bounds a crack.

    It does if the cell has another side in the opposite direction, and no nearer side in the same
    direction. Only sides within a step of its height count.

    Args:
        sides: sides, (m, NUM_COLUMNS) float64, see the module's docstring.
        n: index of a side.
        last: index of the last side of the same cell.
        step: the highest step [m].
    """
    m = last
    has_opposite = False
    while m >= 0:
        cosine = (
            sides[n, DIRECTION] * sides[m, DIRECTION]
            + sides[n, DIRECTION + 1] * sides[m, DIRECTION + 1]
        )
        slack = sides[n, RADIUS] + sides[m, RADIUS] + 2.0 * SAME_PIECE
        if abs(sides[n, HEIGHT] - sides[m, HEIGHT]) <= step + slack:
            is_nearer = sides[m, DISTANCE] < sides[n, DISTANCE] - SAME_PIECE
            if cosine >= SAME_DIRECTION and is_nearer:
                return False
            has_opposite = has_opposite or cosine <= -SAME_DIRECTION
        m = np.int64(sides[m, PREVIOUS])
    return has_opposite


@subkernel(**NO_REFCOUNT)
def _list_in_tile(
    lattice, column_hits, geometry, tile, limits, crack, selected, scratch, sides, num_sides
):
    """List the sides of cracks in one tile of cells: append them to `sides`.

    For each piece of floor, the lines of cells near it are visited. The piece becomes a candidate
    side of those lines that cross no floor near its height. Candidates that bound a crack are
    listed. Arguments that aren't described here are as in `list_sides`.

    Args:
        lattice: the cells, as `Lattice`.
        column_hits: their columns.
        geometry: the shapes, as `TiledGeometry`.
        tile: the number of the tile.
        limits: what an agent can stand on.
        crack: see `list_sides` [m].
        selected: see `list_sides`.
        scratch: a `CrackScratch`.
        sides: receives the sides from row `num_sides` on, (m, NUM_COLUMNS) float64.
        num_sides: how many sides are listed already.

    Returns:
        The new number of sides; -1 if there is no room for them.
    """
    solids = geometry.solids
    facets = geometry.facets
    tile_index = geometry.tile_index
    candidates = scratch.candidates
    corners = scratch.corners
    box = scratch.box
    nearest = scratch.nearest
    heights = scratch.heights
    last_side = scratch.last_side
    first = tile_index.solid_start[tile]
    end_solids = tile_index.solid_start[tile + 1]
    shift = tile_index.triangle_start[tile] - end_solids
    end = tile_index.triangle_start[tile + 1] - shift
    window = tile_window(lattice, tile)
    num_common = -1
    num_candidates = 0
    step = limits.step + LIMIT_SLACK
    if end - first > 1:
        num_common = _find_common_heights(lattice, column_hits, window, selected, limits, heights)
    last_side[:] = -1
    # the solids over the tile, then the triangles
    for n in range(first, end if num_common >= 0 else first):
        item = np.int64(0)
        face = -1
        num_faces = 0
        if n >= end_solids:
            item = np.int64(tile_index.triangle_item[n + shift])
            if facets.facing[item] < max(100.0 * limits.min_up - 1.0, 1.0):  # rounded
                continue
        else:
            item = np.int64(tile_index.solid_item[n])
            face = 0
            num_faces = 3 if solids.kind[item] == BOX else 1
        while face < num_faces:
            if num_sides + num_candidates + TILE * TILE > candidates.shape[0]:
                return -1
            # most triangles have floor all around: corners are written only where there is none
            num_corners = -1
            radius = 0.0
            if n >= end_solids:
                for k in range(6):
                    box[0, k] = facets.bounds[item, k]
            else:
                num_corners, radius = _write_piece(
                    solids, facets, item, face, limits.min_up, corners
                )
                for k in range(3):
                    box[0, k] = math.inf
                    box[0, 3 + k] = -math.inf
                    for i in range(num_corners):
                        box[0, k] = min(box[0, k], corners[i, k])
                        box[0, 3 + k] = max(box[0, 3 + k], corners[i, k])
            # a line over the piece mostly has a floor near all of its heights: the piece itself
            middle = (box[0, 2] + box[0, 5]) / 2.0
            max_offset = step - (box[0, 5] - box[0, 2]) / 2.0
            row_first = window[0]
            row_end = window[0]
            col_first = 0
            col_end = 0
            if num_corners != 0 and not _is_common(
                heights, num_common, box[0, 2], box[0, 5], limits.step
            ):
                row_first, row_end, col_first, col_end = window_near_box(
                    lattice, window, box, 0, crack + radius
                )
            for row in range(row_first, row_end):
                for col in range(col_first, col_end):
                    cell = row * lattice.width + col
                    if not (selected.shape[0] == 0 or selected[cell]) or _has_floor(
                        column_hits, cell, middle, max_offset, limits.min_up
                    ):
                        continue
                    if num_corners < 0:
                        num_corners, _ = _write_piece(
                            solids, facets, item, face, limits.min_up, corners
                        )
                    if num_corners == 0:
                        continue
                    x, y = cell_center_at(lattice, row, col)
                    distance = _distance(corners, num_corners, radius, x, y, nearest)
                    if not 0.0 < distance < crack or _has_floor(
                        column_hits, cell, nearest[2], step, limits.min_up
                    ):
                        continue
                    cell_in_tile = (row - window[0]) * TILE + col - window[2]
                    side = candidates[num_candidates]
                    side[DIRECTION] = nearest[0] / (distance + radius)
                    side[DIRECTION + 1] = nearest[1] / (distance + radius)
                    side[DISTANCE] = distance
                    side[HEIGHT] = nearest[2]
                    side[RADIUS] = radius
                    side[CELL] = cell
                    side[PREVIOUS] = last_side[cell_in_tile]
                    side[GEOM] = solids.geom[item] if n < end_solids else facets.geom[item]
                    last_side[cell_in_tile] = num_candidates
                    num_candidates += 1
            face += 1
    for cell_in_tile in range(TILE * TILE if num_candidates > 1 else 0):
        m = last_side[cell_in_tile]
        while m >= 0:
            if _bounds_crack(candidates, m, last_side[cell_in_tile], limits.step):
                for k in range(NUM_COLUMNS):
                    sides[num_sides, k] = candidates[m, k]
                num_sides += 1
            m = np.int64(candidates[m, PREVIOUS])
    return num_sides


@kernel(nogil=True)
def list_sides(
    lattice, column_hits, solids, facets, tile_index, limits, crack, selected, first_tile, end
):
    """List the pieces of floor on both sides of cracks in which cells' lines run.

    A line runs in a crack if it crosses no floor, and pieces of floor at that height lie on
    opposite sides of it.

    Args:
        lattice: the cells, as `Lattice`.
        column_hits: their columns, as `ColumnHits`.
        solids, facets: the shapes, as `Solids` and `Facets`.
        tile_index: the shapes over each tile, including those within `crack` of it.
        limits: what an agent can stand on, as `AgentLimits`.
        crack: how far from the line the floors on both sides may be [m].
        selected: mask of the cells whose lines are tested, (cells,) bool; if empty, all cells.
        first_tile, end: range of tiles.

    Returns:
        An array whose rows are sides, see the module's docstring, (m, NUM_COLUMNS) float64; and how
        many of its first rows are valid.
    """
    geometry = TiledGeometry(solids, facets, tile_index)
    scratch = _make_scratch(256)
    sides = np.empty((256, NUM_COLUMNS))
    num_sides = np.int64(0)
    for tile in range(first_tile, end):
        while True:
            new_num_sides = _list_in_tile(
                lattice,
                column_hits,
                geometry,
                tile,
                limits,
                crack,
                selected,
                scratch,
                sides,
                num_sides,
            )
            if new_num_sides >= 0:
                break
            scratch = _make_scratch(2 * scratch.candidates.shape[0])
            larger_sides = np.empty((2 * sides.shape[0], NUM_COLUMNS))
            for n in range(num_sides):
                for k in range(NUM_COLUMNS):
                    larger_sides[n, k] = sides[n, k]
            sides = larger_sides
        num_sides = new_num_sides
    return sides, num_sides
