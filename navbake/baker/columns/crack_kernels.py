"""Which floors lie beside lines that have none at their height, seen from above.

What an agent can stand on is a set of convex pieces: triangles and faces of boxes that face up
within the slope, and of round solids the part that does, a point or a segment with a radius. The
direction from a line to the nearest point of a piece is perpendicular to the piece's edge: across a
slot of any direction, and not along the walls of an inner corner.
"""

import math

import numpy as np

from navbake.baker.core.constants import BOX, CAPSULE, CYLINDER
from navbake.baker.core.tiles import TILE, cell_center_at, tile_window, window_near_box
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.compiled import NO_REFCOUNT, kernel, subkernel

# A ray's surface is a piece's where it is this near to its height, and its radius more [m]
SAME_PIECE = 1e-3
SAME_WAY = 0.9  # least cosine of the angle between directions that are about the same
# The numbers of a note, a piece beside a line: the direction, distance and height of its nearest
# point, and its radius [m]; its geom, the cell, and the previous note of the cell or -1
WAY = 0
AWAY = 2
HEIGHT = 3
RADIUS = 4
GEOM = 5
CELL = 6
BEFORE = 7
NUM_NOTES = 8
MOST_HEIGHTS = 8  # at which all cells of a tile have a floor; more are not looked for


@subkernel(**NO_REFCOUNT)
def _take(solids, facets, item, face, min_up, corners):
    """Write a piece's corners; returns how many there are, 0 for none, and its radius.

    `face` is -1 for a triangle, an axis for a box, 0 for the upper part of a round solid.
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
                of_face = pos[k] + up * size[face] * mat[3 * k + face]
                corners[i, k] = of_face + along * mat[3 * k + a] + across * mat[3 * k + b]
        return 4 if up * mat[6 + face] >= min_up else 0, 0.0
    # of a radius, the part that faces up within the slope reaches so far, and is so high at its rim
    reach = size[0] * math.sqrt(max(1.0 - min_up * min_up, 0.0))
    rise = size[0] * min_up
    half = 0.0
    num = 1
    if kind == CYLINDER and abs(mat[8]) >= min_up:  # its upper end
        reach = size[0] * abs(mat[8])
        rise = 0.0
        half = size[1]
    elif kind in (CYLINDER, CAPSULE):
        half = size[1]
        num = 2
    elif size[1] > 0.0:  # an ellipsoid, as if it stood upright, by its lesser radius across
        reach = reach * min(1.0, size[1] / size[0])
        rise = size[2] * min_up
    for i in range(num):
        end = half if (mat[8] >= 0.0) == (i == 0) else -half
        for k in range(3):
            corners[i, k] = pos[k] + end * mat[3 * k + 2] + (rise if k == 2 else 0.0)
    return num, reach


@subkernel(**NO_REFCOUNT)
def _distance(corners, num, radius, x, y, near):
    """How far a line is from a piece, <= 0 over it; `near` receives the piece's nearest point.

    Its x and y are relative to the line, without the radius.
    """
    best = math.inf
    left = False
    right = False
    for i in range(num):
        j = i + 1 if i + 1 < num else 0
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
        left = left or side > 0.0
        right = right or side < 0.0
        if dx * dx + dy * dy < best:
            best = dx * dx + dy * dy
            near[0] = dx
            near[1] = dy
            near[2] = corners[i, 2] + t * (corners[j, 2] - corners[i, 2])
    return 0.0 if num > 2 and left != right else math.sqrt(best) - radius


@subkernel(**NO_REFCOUNT)
def _has_floor(column_hits, cell, z, step, min_up):
    """Whether a line crosses what faces up within the slope, within a step of a height."""
    has_floor = False
    for i in range(column_hits.start[cell], column_hits.start[cell + 1]):
        is_near = abs(column_hits.z[i] - z) <= step
        has_floor = has_floor or (is_near and column_hits.normal[i, 2] >= min_up)
    return has_floor


@subkernel(**NO_REFCOUNT)
def _find_common(lattice, column_hits, window, asked, limits, heights):
    """Heights within half a step of which all asked cells have a floor; -1 if none is asked."""
    count = -1
    for row in range(window[0], window[1]):
        for col in range(window[2], window[3]):
            cell = row * lattice.width + col
            if asked.shape[0] > 0 and not asked[cell]:
                continue
            if count < 0:
                count = 0
                for i in range(column_hits.start[cell], column_hits.start[cell + 1]):
                    if column_hits.normal[i, 2] >= limits.min_up and count < MOST_HEIGHTS:
                        heights[count] = column_hits.z[i]
                        count += 1
            kept = 0
            for k in range(count):
                if _has_floor(column_hits, cell, heights[k], limits.step / 2.0, limits.min_up):
                    heights[kept] = heights[k]
                    kept += 1
            count = kept
    return count


@subkernel(inline="always")
def _is_common(heights, num, low, high, step):
    """Whether all cells of a tile have a floor within a step of all heights between two."""
    is_common = False
    for k in range(num):
        is_common = is_common or max(high - heights[k], heights[k] - low) <= step / 2.0
    return is_common


@subkernel(**NO_REFCOUNT)
def _is_side(seen, n, last, step):
    """Whether a note is the nearest of its direction and cell, and another is opposite to it."""
    m = last
    has_opposite = False
    while m >= 0:
        along = seen[n, WAY] * seen[m, WAY] + seen[n, WAY + 1] * seen[m, WAY + 1]
        spare = seen[n, RADIUS] + seen[m, RADIUS] + 2.0 * SAME_PIECE
        if abs(seen[n, HEIGHT] - seen[m, HEIGHT]) <= step + spare:
            if along >= SAME_WAY and seen[m, AWAY] < seen[n, AWAY] - SAME_PIECE:
                return False
            has_opposite = has_opposite or along <= -SAME_WAY
        m = np.int64(seen[m, BEFORE])
    return has_opposite


@subkernel(**NO_REFCOUNT)
def _list_in_tile(
    lattice, column_hits, geometry, tile, limits, crack, asked, scratch, found
):  # fmt: skip
    """List the sides of a tile's lines behind the known ones; returns their number, -1 for no room.

    Each piece visits the lines near it, and is noted where they have no floor near its height.
    """
    solids, facets, tiles = geometry
    seen, sides, num_sides = found
    corners, box, near, heights, latest = scratch
    first = tiles.solid_start[tile]
    last = tiles.solid_start[tile + 1]
    shift = tiles.triangle_start[tile] - last
    end = tiles.triangle_start[tile + 1] - shift
    window = tile_window(lattice, tile)
    num = -1
    count = 0
    step = limits.step + LIMIT_SLACK
    if end - first > 1:
        num = _find_common(lattice, column_hits, window, asked, limits, heights)
    latest[:] = -1
    for n in range(first, end if num >= 0 else first):
        item = np.int64(0)
        face = -1
        faces = 0
        if n >= last:
            item = np.int64(tiles.triangle_item[n + shift])
            if facets.facing[item] < max(100.0 * limits.min_up - 1.0, 1.0):  # rounded
                continue
        else:
            item = np.int64(tiles.solid_item[n])
            face = 0
            faces = 3 if solids.kind[item] == BOX else 1
        while face < faces:
            if num_sides + count + TILE * TILE > seen.shape[0]:
                return -1
            # most triangles have floor all around: their corners are taken where there is none
            corners_of = -1
            radius = 0.0
            if n >= last:
                for k in range(6):
                    box[0, k] = facets.bounds[item, k]
            else:
                corners_of, radius = _take(solids, facets, item, face, limits.min_up, corners)
                for k in range(3):
                    box[0, k] = math.inf
                    box[0, 3 + k] = -math.inf
                    for i in range(corners_of):
                        box[0, k] = min(box[0, k], corners[i, k])
                        box[0, 3 + k] = max(box[0, 3 + k], corners[i, k])
            # a line over the piece mostly has a floor near all of its heights: the piece itself
            middle = (box[0, 2] + box[0, 5]) / 2.0
            most = step - (box[0, 5] - box[0, 2]) / 2.0
            row0 = window[0]
            row1 = window[0]
            col0 = 0
            col1 = 0
            if corners_of != 0 and not _is_common(heights, num, box[0, 2], box[0, 5], limits.step):
                row0, row1, col0, col1 = window_near_box(lattice, window, box, 0, crack + radius)
            for row in range(row0, row1):
                for col in range(col0, col1):
                    cell = row * lattice.width + col
                    if not (asked.shape[0] == 0 or asked[cell]) or _has_floor(
                        column_hits, cell, middle, most, limits.min_up
                    ):
                        continue
                    if corners_of < 0:
                        corners_of, _ = _take(solids, facets, item, face, limits.min_up, corners)
                    if corners_of == 0:
                        continue
                    x, y = cell_center_at(lattice, row, col)
                    away = _distance(corners, corners_of, radius, x, y, near)
                    if not 0.0 < away < crack or _has_floor(
                        column_hits, cell, near[2], step, limits.min_up
                    ):
                        continue
                    here = (row - window[0]) * TILE + col - window[2]
                    note = seen[count]
                    note[WAY] = near[0] / (away + radius)
                    note[WAY + 1] = near[1] / (away + radius)
                    note[AWAY] = away
                    note[HEIGHT] = near[2]
                    note[RADIUS] = radius
                    note[CELL] = cell
                    note[BEFORE] = latest[here]
                    note[GEOM] = solids.geom[item] if n < last else facets.geom[item]
                    latest[here] = count
                    count += 1
            face += 1
    for here in range(TILE * TILE if count > 1 else 0):
        m = latest[here]
        while m >= 0:
            if _is_side(seen, m, latest[here], limits.step):
                for k in range(NUM_NOTES):
                    sides[num_sides, k] = seen[m, k]
                num_sides += 1
            m = np.int64(seen[m, BEFORE])
    return num_sides


@kernel(nogil=True)
def list_sides(
    lattice, column_hits, solids, facets, tiles, limits, crack, asked, first_tile, end
):  # fmt: skip
    """List the floors on opposite sides of lines without one, in tiles ``range(first_tile, end)``.

    Args:
        tiles: what lies over each tile, `crack` round it included.
        limits: what an agent can stand on.
        crack: how near floors on both sides are [m].
        asked: the cells, (cells,) bool; all if it is empty.

    Returns:
        A row of notes for each side, (n, NUM_NOTES) float64, and how many count.
    """
    scratch = (
        np.empty((4, 3)), np.empty((1, 6)), np.empty(3), np.empty(MOST_HEIGHTS),
        np.empty(TILE * TILE, np.int64),
    )  # fmt: skip
    seen = np.empty((256, NUM_NOTES))
    sides = np.empty((256, NUM_NOTES))
    num = np.int64(0)
    for tile in range(first_tile, end):
        while True:
            after = _list_in_tile(
                lattice, column_hits, (solids, facets, tiles), tile, limits, crack, asked, scratch,
                (seen, sides, num),
            )  # fmt: skip
            if after >= 0:
                break
            seen = np.empty((2 * seen.shape[0], NUM_NOTES))
            wider = np.empty((2 * sides.shape[0], NUM_NOTES))
            for n in range(num):
                for k in range(NUM_NOTES):
                    wider[n, k] = sides[n, k]
            sides = wider
        num = after
    return sides, num
