"""Lines that run through a crack between two floors, and the floor that bridges it there.

What an agent can stand on is, seen from above, a set of convex pieces: the triangles and the faces
of boxes that face up within the slope, and of round solids the part that does, a point or a line
with a radius. From a line beside a piece, the direction to its nearest point is straight across
its edge. Where another piece at the same height lies in the very opposite direction, the line runs
between the two. How far that is along the direction is found by steps as long as the distance to
the piece, which never pass its edge (sphere tracing: Hart, The Visual Computer, 1996).

So one looks across slots of any direction, at edges of any shape, and not along the walls of an
inner corner. Rays at both edges say what there is, so that a floor has the very height that a line
beyond the edge finds.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.baker.kernels.arrays import Band, Crossings
from navbake.baker.kernels.constants import BOX, CAPSULE, CYLINDER, SAME, SLACK
from navbake.baker.kernels.hits import make_hits
from navbake.baker.kernels.overlap import ANY_GEOM, line_is_blocked
from navbake.baker.kernels.rays import cast_line, make_ray, most_hits
from navbake.baker.kernels.tiles import TILE, cells_near, center_of, tile_window
from navbake.compiled import UNCOUNTED, kernel, part
from navbake.types import Float, Int

# Rays are cast this far beyond an edge, and an edge is reached where it is nearer than that [m]
HAIR = 1e-6
# A ray's surface is a piece's where it is this near to its height, and its radius more [m]
SAME_PIECE = 1e-3
MOST_STEPS = 64  # to an edge
MOST_HEIGHTS = 8  # at which all cells of a tile have a floor, as many as are noticed
MOST_WAYS = 24  # from a line to the nearest pieces, at all heights
SAME_WAY = 0.7  # least cosine of the angle between directions that are about the same


class Notes(NamedTuple):
    """Pieces beside lines, or surfaces that lines get: so many as count, and room for more.

    Attributes:
        of: the item, its face (-1 for a triangle), and the note before it of the same cell, -1 for
            none; or the cell, the geom, and an item; (n, 3) int64.
        seen: the direction to the piece's nearest point, how far that is, and how high; or the
            normal of a surface, its height, and that of the other side; (n, 5) float64 [m].
    """

    of: Int
    seen: Float


class Scratch(NamedTuple):
    """Room to work in, for a tile.

    Attributes:
        corners: of a piece, (4, 3) float64 [m].
        box: round them, as `cells_near` takes boxes, (1, 6) float64 [m].
        near: where `_distance` finds the nearest point, (3,) float64 [m].
        floors: the least and the greatest height of each floor that all cells have,
            (MOST_HEIGHTS, 2) float64 [m].
        nearest: by cell, its notes that are the nearest of those in their direction, of which the
            last is the cell's last note, (TILE * TILE, MOST_WAYS + 1) int64, -1 for none.
        start: of the one column that a ray finds, (2,) int64.
    """

    corners: Float
    box: Float
    near: Float
    floors: Float
    nearest: Int
    start: Int


@part
def _make_room():
    floors, nearest = np.empty((MOST_HEIGHTS, 2)), np.empty((TILE * TILE, MOST_WAYS + 1), np.int64)
    start = np.zeros(2, np.int64)
    return Scratch(np.empty((4, 3)), np.empty((1, 6)), np.empty(3), floors, nearest, start)


@part
def _make_notes(count):
    return Notes(np.empty((count, 3), np.int64), np.empty((count, 5)))


@part(**UNCOUNTED)
def _take(solids, facets, item, face, min_up, corners):
    """The corners of a piece; returns how many there are, 0 for none, and its radius.

    Of a triangle (`face` -1), a face of a box across an axis, or the upper part of a round solid.
    """
    if face < 0:
        for i in range(3):
            for k in range(3):
                corners[i, k] = facets.corners[item, i, k]
        return 3, 0.0
    pos, mat, size, kind = solids.pos[item], solids.mat[item], solids.size[item], solids.kind[item]
    if kind == BOX:
        up = 1.0 if mat[6 + face] > 0.0 else -1.0
        if up * mat[6 + face] < min_up:
            return 0, 0.0
        a, b = (face + 1) % 3, (face + 2) % 3
        for i in range(4):
            along, across = size[a] if i in (1, 2) else -size[a], size[b] if i >= 2 else -size[b]
            for k in range(3):
                of_face = pos[k] + up * size[face] * mat[3 * k + face]
                corners[i, k] = of_face + along * mat[3 * k + a] + across * mat[3 * k + b]
        return 4, 0.0
    if face != 0:
        return 0, 0.0
    # of a radius, the part that faces up within the slope reaches so far, and is so high at its rim
    reach, rise = size[0] * math.sqrt(max(1.0 - min_up * min_up, 0.0)), size[0] * min_up
    half, num = 0.0, 1
    if kind == CYLINDER and abs(mat[8]) >= min_up:  # its upper end
        reach, rise, half = size[0] * abs(mat[8]), 0.0, size[1]
    elif kind in (CYLINDER, CAPSULE):
        half, num = size[1], 2
    elif size[1] > 0.0:  # an ellipsoid, as if it stood upright, by its lesser radius across
        reach, rise = reach * min(1.0, size[1] / size[0]), size[2] * min_up
    for i in range(num):
        end = half if (mat[8] >= 0.0) == (i == 0) else -half
        for k in range(3):
            corners[i, k] = pos[k] + end * mat[3 * k + 2] + (rise if k == 2 else 0.0)
    return num, reach


@part(**UNCOUNTED)
def _distance(corners, num, radius, x, y, near):
    """How far a line is from a piece, <= 0 over it.

    Where its nearest point is, less the radius, relative to the line, and how high, into `near`.
    """
    best, left, right = math.inf, False, False
    for i in range(num):
        j = i + 1 if i + 1 < num else 0
        ax, ay = corners[i, 0] - x, corners[i, 1] - y
        ex, ey = corners[j, 0] - corners[i, 0], corners[j, 1] - corners[i, 1]
        length, t = ex * ex + ey * ey, 0.0
        if length > 0.0:
            t = min(max(-(ax * ex + ay * ey) / length, 0.0), 1.0)
        dx, dy, side = ax + t * ex, ay + t * ey, ex * ay - ey * ax
        left, right = left or side > 0.0, right or side < 0.0
        if dx * dx + dy * dy < best:
            best, near[0], near[1] = dx * dx + dy * dy, dx, dy
            near[2] = corners[i, 2] + t * (corners[j, 2] - corners[i, 2])
    return 0.0 if num > 2 and left != right else math.sqrt(best) - radius


@part(inline="always")
def _has_floor(crossings, cell, low, high, limits):
    """Whether a line crosses what faces up within the slope, within a step of two heights."""
    reach, has_floor = limits.step + SLACK, False
    for i in range(crossings.start[cell], crossings.start[cell + 1]):
        is_near = low - reach <= crossings.z[i] <= high + reach
        has_floor = has_floor or (is_near and crossings.normal[i, 2] >= limits.min_up)
    return has_floor


@part(**UNCOUNTED)
def _find_common(lattice, crossings, window, asked, limits, floors):
    """Find floors that go on, within a step, in all cells that are asked about in a tile.

    Returns how many there are, -1 where no cell is asked about.
    """
    count, z, up = -1, crossings.z, crossings.normal
    for row in range(window[0], window[1]):
        for col in range(window[2], window[3]):
            cell = row * lattice.width + col
            if asked.shape[0] > 0 and not asked[cell]:
                continue
            if count < 0:
                count = 0
                for i in range(crossings.start[cell], crossings.start[cell + 1]):
                    if up[i, 2] >= limits.min_up and count < MOST_HEIGHTS:
                        floors[count, 0] = floors[count, 1] = z[i]
                        count += 1
                continue
            kept = 0
            for k in range(count):
                for i in range(crossings.start[cell], crossings.start[cell + 1]):
                    low, high = min(floors[k, 0], z[i]), max(floors[k, 1], z[i])
                    if high - low <= limits.step and up[i, 2] >= limits.min_up:
                        floors[kept, 0], floors[kept, 1] = low, high
                        kept += 1
                        break
            count = kept
            if count == 0:
                return count
    return count


@part(inline="always")
def _note(notes, count, of, seen):
    """Add a note, for which there is room."""
    for k in range(3):
        notes.of[count, k] = of[k]
    for k in range(5):
        notes.seen[count, k] = seen[k]


@part(inline="always")
def _is_common(floors, num, low, high, step):
    """Whether all cells of a tile have a floor within a step of all that is between two heights."""
    is_common = False
    for k in range(num):
        is_common = is_common or (high - floors[k, 0] <= step and floors[k, 1] - low <= step)
    return is_common


@kernel(nogil=True, **UNCOUNTED)
def mark_facing_up(corners, min_up, marks, first, end):
    """Mark the triangles ``range(first, end)`` that face up within the slope, into (n,) bool."""
    c = corners
    for t in range(first, end):
        ux, uy, uz = c[t, 1, 0] - c[t, 0, 0], c[t, 1, 1] - c[t, 0, 1], c[t, 1, 2] - c[t, 0, 2]
        vx, vy, vz = c[t, 2, 0] - c[t, 0, 0], c[t, 2, 1] - c[t, 0, 1], c[t, 2, 2] - c[t, 0, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        least = min_up * min_up * (nx * nx + ny * ny + nz * nz)
        marks[t] = nz > 0.0 and nz * nz >= least


@part(**UNCOUNTED)
def _keep_nearest(nearest, seen, n, step):
    """Note that a piece is the nearest to a line in its direction at about its height, if it is."""
    for k in range(MOST_WAYS):
        m = nearest[k]
        if m >= 0 and abs(seen[m, 3] - seen[n, 3]) > step:
            continue
        if m < 0 or seen[m, 0] * seen[n, 0] + seen[m, 1] * seen[n, 1] > SAME_WAY:
            if m < 0 or seen[n, 2] < seen[m, 2]:
                nearest[k] = n
            return


@part(inline="always")
def _note_beside(lattice, crossings, window, asked, limits, crack, shapes, piece, room, known):
    """Note the lines of a tile that are beside a piece, where they have no floor near its height.

    `piece` is the item and its face, `known` the notes, their number, and that of common floors.
    """
    (solids, facets), (item, face), (edges, count, num_floors) = shapes, piece, known
    corners, box, near = room.corners, room.box, room.near
    num, radius = _take(solids, facets, item, face, limits.min_up, corners)
    for k in range(3):
        box[0, k], box[0, 3 + k] = math.inf, -math.inf
        for i in range(num):
            box[0, k] = min(box[0, k], corners[i, k])
            box[0, 3 + k] = max(box[0, 3 + k], corners[i, k])
    low, high = box[0, 2], box[0, 5]
    row0, row1, col0, col1 = window[0], window[0], window[2], window[2]
    if num > 0 and not _is_common(room.floors, num_floors, low, high, limits.step):
        row0, row1, col0, col1 = cells_near(lattice, window, box, 0, crack + radius)
    for row in range(row0, row1):
        for col in range(col0, col1):
            cell = row * lattice.width + col
            # a line over the piece mostly has a floor near all of its heights: the piece itself
            if not (asked.shape[0] == 0 or asked[cell]) or _has_floor(
                crossings, cell, high, low, limits
            ):
                continue
            x, y = center_of(lattice, row, col)
            away = _distance(corners, num, radius, x, y, near)
            if 0.0 < away < crack and not _has_floor(crossings, cell, near[2], near[2], limits):
                nearest = room.nearest[(row - window[0]) * TILE + col - window[2]]
                length = away + radius
                seen = near[0] / length, near[1] / length, away, near[2], 0.0
                _note(edges, count, (item, face, nearest[MOST_WAYS]), seen)
                nearest[MOST_WAYS] = count
                _keep_nearest(nearest, edges.seen, count, limits.step)
                count += 1
    return count


@part(**UNCOUNTED)
def _reach_piece(corners, num, radius, x, y, way, most, near):
    """How far a piece is from a line in a direction, inf if not nearer than `most`."""
    t = 0.0
    for _ in range(MOST_STEPS):
        away = _distance(corners, num, radius, x + t * way[0], y + t * way[1], near)
        if away < HAIR:
            return t
        t += away
        if t >= most:
            break
    return math.inf


@part(inline="always")
def _is_buried(column, cell, z):
    """Whether a line runs within something just above a height."""
    return line_is_blocked(column, cell, Band(z + SAME, z + 2.0 * SAME), ANY_GEOM)


@part(**UNCOUNTED)
def _find_side(crossings, cell, column, geom, z, slack, min_up):
    """The surface of a geom that faces up in the one column, nearest to a height; or -1.

    Also -1 where it is buried and a cell's own line is not: it only ends at the foot of something.
    """
    found, best = -1, slack
    for i in range(column.start[1]):
        off = abs(column.z[i] - z)
        if column.geom[i] == geom and column.normal[i, 2] >= min_up and off <= best:
            found, best = i, off
    if found >= 0 and _is_buried(column, np.int64(0), column.z[found]):
        return found if _is_buried(crossings, cell, column.z[found]) else -1
    return found


@part(**UNCOUNTED)
def _look_across(crossings, geometry, tiles, tile, limits, crack, line, pair, room):
    """Look from the edge of a piece across a line to another piece.

    Args:
        line: the cell, and where its line is.
        pair: the notes, and which two of them.
        room: scratch, a ray and hits.

    Returns whether there is a crack, what is noted of its lower side, and that one's geom.
    """
    (solids, facets, planes, heights), (of, seen, n, m), (scratch, ray, hits) = geometry, pair, room
    (cell, x, y), way, start = line, (-seen[n, 0], -seen[n, 1]), scratch.start
    num, radius = _take(solids, facets, of[m, 0], of[m, 1], limits.min_up, scratch.corners)
    away = _reach_piece(scratch.corners, num, radius, x, y, way, crack, scratch.near)
    low, high, up, lower = math.inf, -math.inf, (0.0, 0.0, 0.0), np.int64(-1)
    for side in range(2):
        k, t, z = n, -seen[n, 2] - HAIR, seen[n, 3]
        if side == 1:
            k, t, z = m, away + HAIR, scratch.near[2]
        geom, found = facets.geom[of[k, 0]] if of[k, 1] < 0 else solids.geom[of[k, 0]], -1
        if away < crack:
            px, py = x + t * way[0], y + t * way[1]
            start[1] = cast_line(px, py, tile, solids, facets, planes, tiles, heights, ray, hits)
            column = Crossings(start, hits.z, hits.normal, hits.geom, hits.closed)
            slack = SAME_PIECE + radius
            found = _find_side(crossings, cell, column, geom, z, slack, limits.min_up)
        if found < 0:
            return False, (0.0, 0.0, 0.0, 0.0, 0.0), lower
        if hits.z[found] < low:
            normal = hits.normal[found]
            low, up, lower = hits.z[found], (normal[0], normal[1], normal[2]), np.int64(geom)
        high = max(high, hits.z[found])
    is_crack = high - low <= limits.step + SLACK
    is_crack = is_crack and not _has_floor(crossings, cell, low, high, limits)
    return is_crack, (up[0], up[1], up[2], low, high), lower


@part(**UNCOUNTED)
def _list_edges(
    lattice, crossings, shapes, tiles, tile, limits, crack, asked, scratch, edges
):  # fmt: skip
    """Note the pieces beside the lines of a tile; returns how many, -1 where room ends."""
    solids, facets, faces_up = shapes
    first, last = tiles.solid_start[tile], tiles.solid_start[tile + 1]
    first_triangle, last_triangle = tiles.triangle_start[tile], tiles.triangle_start[tile + 1]
    window, num_floors, count = tile_window(lattice, tile), -1, 0
    if last - first + last_triangle - first_triangle > 1:
        num_floors = _find_common(lattice, crossings, window, asked, limits, scratch.floors)
    if num_floors < 0:
        return 0
    scratch.nearest[:] = -1
    for k in range(first, last + last_triangle - first_triangle):
        if k < last:
            item = np.int64(tiles.solid_item[k])
            num_faces = 3 if solids.kind[item] == BOX else 1
        else:
            item, num_faces = np.int64(tiles.triangle_item[k - last + first_triangle]), 1
            if not faces_up[item]:
                continue
            low, high = facets.bounds[item, 2], facets.bounds[item, 5]
            if _is_common(scratch.floors, num_floors, low, high, limits.step):
                continue
        if count + num_faces * TILE * TILE > edges.of.shape[0]:
            return -1
        for face in range(num_faces):
            piece, known = (item, face if k < last else -1), (edges, count, num_floors)
            count = _note_beside(
                lattice, crossings, window, asked, limits, crack, (solids, facets), piece,
                scratch, known,
            )  # fmt: skip
    return count


@part(**UNCOUNTED)
def _look_in_tile(
    lattice, crossings, geometry, tiles, tile, limits, crack, edges, room, known
):  # fmt: skip
    """Look for cracks in the lines of a tile; returns how many are found, -1 where room ends."""
    (of, seen), window, scratch = edges, tile_window(lattice, tile), room[0]
    found, num_found = known
    for here in range(TILE * TILE):
        row, col = window[0] + here // TILE, window[2] + here % TILE
        x, y = center_of(lattice, row, col)
        line = row * lattice.width + col, x, y
        for k in range(MOST_WAYS):
            n, m = scratch.nearest[here, k], scratch.nearest[here, MOST_WAYS]
            if n < 0:
                break
            while m >= 0:
                # all of the other piece is beyond its nearest point, in that one's direction
                ahead = -crack * (seen[n, 0] * seen[m, 0] + seen[n, 1] * seen[m, 1])
                if ahead > seen[m, 2]:
                    is_crack, noted, geom = _look_across(
                        crossings, geometry, tiles, tile, limits, crack, line, (of, seen, n, m),
                        room,
                    )  # fmt: skip
                    if is_crack and num_found == found.of.shape[0]:
                        return -1
                    if is_crack:
                        _note(found, num_found, (line[0], geom, of[m, 0]), noted)
                        num_found += 1
                m = of[m, 2]
    return num_found


@kernel(nogil=True)
def find_bridges(
    lattice, crossings, geometry, faces_up, tiles, limits, crack, asked, first_tile, end
):  # fmt: skip
    """Find the floors of lines that run through cracks, in the tiles ``range(first_tile, end)``.

    Args:
        geometry: solids, facets, planes, and a `Band` below and above everything [m].
        faces_up: the triangles that do, see `mark_facing_up`.
        tiles: what lies over each tile, `crack` round it included.
        limits: what an agent can stand on.
        crack: how near floors on both sides are [m].
        asked: the cells, (cells,) bool; all if it is empty.

    Returns notes, and how many count.
    """
    solids, facets, planes, _ = geometry
    shapes, scratch, ray, hits = (solids, facets, faces_up), _make_room(), make_ray(), make_hits(64)
    edges, found, num_found = _make_notes(256), _make_notes(64), 0
    for tile in range(first_tile, end):
        while True:
            count = _list_edges(
                lattice, crossings, shapes, tiles, tile, limits, crack, asked, scratch, edges
            )
            if count >= 0:
                break
            edges = _make_notes(2 * edges.of.shape[0])
        most = most_hits(tile, planes, tiles)
        if count > 1 and most > hits.z.shape[0]:
            hits = make_hits(2 * most)
        while count > 1:
            room = scratch, ray, hits
            num = _look_in_tile(
                lattice, crossings, geometry, tiles, tile, limits, crack, edges, room,
                (found, num_found),
            )  # fmt: skip
            if num >= 0:
                num_found = num
                break
            wider = _make_notes(2 * found.of.shape[0])
            wider.of[:num_found], wider.seen[:num_found] = (
                found.of[:num_found],
                found.seen[:num_found],
            )
            found = wider
    return found, num_found
