"""Vertical lines through all geometry: every crossing, both ways.

Solids and infinite planes are crossed by MuJoCo's own rays (`mju_rayGeom`), one up from below and
one down from above. Triangles are crossed in `raster`; `hits` makes columns of what was hit.

Geometry visits the cells that it lies over, as in rasterizers (Pineda, 1988). Each thread takes
bands of rows, so no two write to one column, and within a band the order is fixed: the result is
the same for any number of threads. All is done twice: to count, then to write.

Most crossings are of level faces: ends of upright boxes and cylinders, and level planes. MuJoCo's
ray gives the same heights there on all lines to the last bit, as x and y are multiplied by zero; so
one ray through the middle serves all lines well inside of the rim.
"""

import math
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np
from llvmlite import binding
from numba import types

from navbake.baker.kernels.arrays import Crossings
from navbake.baker.kernels.constants import BOX, CONVEX_SOLID, CYLINDER, OPEN_SURFACE, PLANE, SPHERE
from navbake.baker.kernels.hits import (
    INSIDE,
    OF_PLANE,
    OF_SOLID,
    RIM,
    copy_hit,
    hits_of,
    make_hits,
    settle,
)
from navbake.baker.kernels.raster import NEVER_FAR, hit_triangle, is_beside, raster_triangles
from navbake.baker.kernels.tiles import BAND, cell_center, centers_between
from navbake.compiled import UNCOUNTED, kernel, part
from navbake.types import Float

# An eighth of a turn [rad]
EIGHTH = 0.7853981633974483
# A plane's type; a plain int would be a type of its own, and compile what takes it once more
PLANE_KIND = np.int32(PLANE)
# Lines this far from the rim of an upright solid are inside or outside of it, whatever rounding
# does; and solids narrower than WIDE ask MuJoCo on all lines [m]
CLEAR, WIDE = 1e-5, 1e-3


def _load_mujoco() -> None:
    """Make MuJoCo's functions known to compiled code, whoever compiles or calls it first."""
    folder = Path(find_spec("mujoco").origin).parent  # type: ignore[union-attr,arg-type]
    for pattern in ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll"):
        for path in sorted(folder.glob(pattern)):
            binding.load_library_permanently(str(path))
            return
    raise ImportError(f"MuJoCo's shared library is not in {folder}: reinstall mujoco")


_load_mujoco()
_ray_geom = types.ExternalFunction(
    "mju_rayGeom",
    types.float64(
        types.uintp, types.uintp, types.uintp, types.uintp, types.uintp, types.intc, types.uintp
    ),
)


class Ray(NamedTuple):
    """A ray's point and direction, the normal where it hits, and room to nudge it; (3,) each."""

    point: Float
    direction: Float
    normal: Float
    nudged: Float
    grown: Float


@part(**UNCOUNTED)
def _cast(pos, mat, size, kind, point, ray):
    """The distance to a geom along a ray from a point, or -1; its normal there into the ray."""
    return _ray_geom(
        pos.ctypes.data,
        mat.ctypes.data,
        size.ctypes.data,
        point.ctypes.data,
        ray.direction.ctypes.data,
        kind,
        ray.normal.ctypes.data,
    )


@part(inline="always")
def _cast_at_rim(solids, s, ray):
    """Cast a ray at a solid; one that misses its rim by at most RIM is moved onto it."""
    pos, mat, size, kind = solids.pos[s], solids.mat[s], solids.size[s], solids.kind[s]
    distance = _cast(pos, mat, size, kind, ray.point, ray)
    if distance >= 0.0:
        return distance
    for i in range(3):
        ray.grown[i] = size[i] + 2.0 * RIM
    if _cast(pos, mat, ray.grown, kind, ray.point, ray) < 0.0:
        return -1.0
    ray.nudged[2] = ray.point[2]
    for way in range(8):  # the inward cone of a square corner holds one of eight ways
        ray.nudged[0] = ray.point[0] + RIM * math.cos(way * EIGHTH)
        ray.nudged[1] = ray.point[1] + RIM * math.sin(way * EIGHTH)
        distance = _cast(pos, mat, size, kind, ray.nudged, ray)
        if distance >= 0.0:
            return distance
    return -1.0


@part(inline="always")
def _aim(ray, way, low, high):
    """Point a ray up from a height (way 0) or down from another (way 1)."""
    ray.direction[2] = 1.0 if way == 0 else -1.0
    ray.point[2] = low if way == 0 else high


@part(inline="always")
def _hit(hits, at, z, normal, up, geom):
    """Note a hit of a solid or a plane, but for `closed` and `facet`."""
    hits.z[at] = z
    hits.normal[at, 0], hits.normal[at, 1], hits.normal[at, 2] = normal[0], normal[1], up
    hits.geom[at] = geom
    hits.at_edge[at] = INSIDE


@part(**UNCOUNTED)
def _hit_solid(solids, s, x, y, ray, hits, at):
    """Note where a line enters and leaves a solid, from a place of the hits; returns how often."""
    box, count = solids.bounds[s], np.int64(0)
    ray.point[0], ray.point[1] = x, y
    for way in range(2):
        _aim(ray, way, box[2] - 1.0, box[5] + 1.0)
        distance = _cast_at_rim(solids, s, ray)
        if distance >= 0.0:
            up = ray.normal[2]
            # a grazed side has no up or down of its own: the ray's way tells
            up = min(up, -1e-12) if way == 0 else max(up, 1e-12)
            z = ray.point[2] + ray.direction[2] * distance
            _hit(hits, at + count, z, ray.normal, up, solids.geom[s])
            hits.closed[at + count], hits.facet[at + count] = CONVEX_SOLID, OF_SOLID
            count += 1
    return count


@part(inline="always")
def _is_upright(mat):
    """Whether a geom's z is the world's, or its opposite, to the last bit."""
    return mat[2] == 0.0 and mat[5] == 0.0 and mat[6] == 0.0 and mat[7] == 0.0


@part(**UNCOUNTED)
def _hit_plane(planes, p, x, y, heights, ray, hits, at):
    """Note where a line crosses an infinite plane, from its front only; returns how often."""
    count, pos, mat = np.int64(0), planes.pos[p], planes.mat[p]
    ray.point[0], ray.point[1] = x, y
    ray.grown[:] = 0.0  # a plane of no size is infinite
    for way in range(2):
        _aim(ray, way, heights.low, heights.high)
        distance = _cast(pos, mat, ray.grown, PLANE_KIND, ray.point, ray)
        if distance >= 0.0:
            # to the last bit, wherever the ray begins
            across = (x - pos[0]) * mat[2] + (y - pos[1]) * mat[5]
            z = pos[2] - across / mat[8]
            _hit(hits, at + count, z, ray.normal, ray.normal[2], planes.geom[p])
            hits.closed[at + count], hits.facet[at + count] = OPEN_SURFACE, OF_PLANE
            count += 1
    return count


@part(inline="always")
def _beyond_rim(solids, s, x, y):
    """How far a line is beyond an upright solid's rim, of a box along one axis, < 0 inside [m]."""
    mat, size, kind = solids.mat[s], solids.size[s], solids.kind[s]
    dx, dy = x - solids.pos[s, 0], y - solids.pos[s, 1]
    if kind == BOX:
        across, along = mat[0] * dx + mat[3] * dy, mat[1] * dx + mat[4] * dy
        return max(abs(across) - size[0], abs(along) - size[1])
    return math.hypot(dx, dy) - size[0]


@part(inline="always")
def _has_known_rim(solids, s):
    """Whether `_beyond_rim` knows a solid's rim, as seen from above."""
    kind = solids.kind[s]
    return kind == SPHERE or (kind in (BOX, CYLINDER) and _is_upright(solids.mat[s]))


@part(inline="always")
def _has_level_ends(solids, s):
    """Whether all lines well inside of a solid's rim cross it at the same two heights."""
    size, kind = solids.size[s], solids.kind[s]
    is_wide = size[0] > WIDE and (kind == CYLINDER or size[1] > WIDE)
    return kind != SPHERE and is_wide


@part(**UNCOUNTED)
def _cast_solid(solids, s, lattice, rows, ray, middle, hits, end, writing):
    """Note where the lines of some rows cross a solid, as `raster_triangles` does triangles.

    `middle` has room for the hits of the line through its middle.
    """
    box, cell = solids.bounds[s], lattice.cell_size
    x_min, y_max = lattice.x_min, lattice.y_max
    first, last = centers_between(y_max - box[4] - RIM, y_max - box[1] + RIM, cell, lattice.height)
    first, last = max(first, rows[0]), min(last, rows[1] - 1)
    left, right = centers_between(box[0] - RIM - x_min, box[3] + RIM - x_min, cell, lattice.width)
    has_rim, has_level = _has_known_rim(solids, s), False
    if has_rim and _has_level_ends(solids, s):
        x, y = solids.pos[s, 0], solids.pos[s, 1]
        has_level = _hit_solid(solids, s, x, y, ray, middle, np.int64(0)) == 2
    for row in range(first, last + 1):
        y = cell_center(lattice, row * lattice.width)[1]
        for col in range(left, right + 1):
            x = cell_center(lattice, col)[0]
            if is_beside(solids.bounds, s, x, y):
                continue
            beyond = _beyond_rim(solids, s, x, y) if has_rim else 0.0
            if beyond > CLEAR:
                continue
            line = (row - rows[0]) * lattice.width + col
            place = end[line] if writing else 0
            if has_level and beyond < -CLEAR:
                for way in range(2):
                    copy_hit(middle, way, hits, place + way)
                end[line] += 2
            else:
                end[line] += _hit_solid(solids, s, x, y, ray, hits, place)


@part(**UNCOUNTED)
def _cast_plane(planes, p, lattice, rows, heights, ray, middle, hits, end, writing):
    """Note where the lines of some rows cross an infinite plane, see `_cast_solid`."""
    is_level = _is_upright(planes.mat[p])
    count, zero = np.int64(0), np.int64(0)
    for line in range(end.shape[0]):
        if not is_level or line == 0:
            x, y = cell_center(lattice, rows[0] * lattice.width + line)
            count = _hit_plane(planes, p, x, y, heights, ray, middle, zero)
        place = end[line] if writing else 0
        for i in range(count):
            copy_hit(middle, i, hits, place + i)
        end[line] += count


@part(**UNCOUNTED)
def _settle_lines(hits, start, end, facets, spare):
    """`settle` the hits of lines, from `start`, of whole columns, to `end`; returns the dropped."""
    dropped = 0
    for line in range(end.shape[0]):
        first = start[line] - start[0]
        dropped += settle(hits, first, end[line], facets, spare, np.int64(0))
    return dropped


@part(inline="always")
def make_ray():
    """A ray; its point and direction are for who casts it."""
    return Ray(np.empty(3), np.zeros(3), np.zeros(3), np.empty(3), np.empty(3))


@kernel(nogil=True)
def cast_lines(
    lattice, solids, facets, planes, items, heights, crossings, dropped, first_band, end
):  # fmt: skip
    """Cross the lines of cells in bands ``range(first_band, end)``; twice: to count, then to write.

    Args:
        items: what lies over which band of rows.
        heights: a `Band` below and above everything [m].
        crossings: while counting all but `start` are empty, and ``start[cell + 1]`` receives the
            number of hits; while writing `start` has their running sums, and the others receive
            the crossings, and behind each column's last those that are DROPPED.
        dropped: by band, int64; receives the number of hits that are no crossings.
    """
    start, writing = crossings.start, crossings.z.shape[0] > 0
    ray, middle = make_ray(), make_hits(2)
    for band in range(first_band, end):
        rows = band * BAND, min((band + 1) * BAND, lattice.height)
        first, last = rows[0] * lattice.width, rows[1] * lattice.width
        place = np.zeros(last - first, np.int64)
        hits = middle
        if writing:
            hits = hits_of(crossings, start[first], start[last])
            for line in range(last - first):
                place[line] = start[first + line] - start[first]
        for p in range(planes.geom.shape[0]):
            _cast_plane(planes, p, lattice, rows, heights, ray, middle, hits, place, writing)
        for i in range(items.solid_start[band], items.solid_start[band + 1]):
            s = items.solid_item[i]
            _cast_solid(solids, s, lattice, rows, ray, middle, hits, place, writing)
        here = slice(items.triangle_start[band], items.triangle_start[band + 1])
        listed, is_crossed = items.triangle_item[here], items.is_crossed[here]
        raster_triangles(facets, listed, is_crossed, lattice, rows, hits, place, writing)
        if writing:
            dropped[band] = _settle_lines(hits, start[first:last], place, facets, middle)
            continue
        for line in range(last - first):
            start[first + line + 1] = place[line]


@part(inline="always")
def most_hits(tile, planes, tiles):
    """The room that the hits of a line over a tile need, scratch for sorting included."""
    solids = tiles.solid_start[tile + 1] - tiles.solid_start[tile]
    triangles = tiles.triangle_start[tile + 1] - tiles.triangle_start[tile]
    return 2 * (solids + planes.geom.shape[0]) + triangles + 1


@part(**UNCOUNTED)
def cast_line(x, y, tile, solids, facets, planes, tiles, heights, ray, hits):
    """Write the crossings of the line at (x, y) over a tile to the first hits; returns how many."""
    zero, count = np.int64(0), np.int64(0)
    for p in range(planes.geom.shape[0]):
        count += _hit_plane(planes, p, x, y, heights, ray, hits, count)
    for i in range(tiles.solid_start[tile], tiles.solid_start[tile + 1]):
        s = tiles.solid_item[i]
        if not is_beside(solids.bounds, s, x, y):
            count += _hit_solid(solids, s, x, y, ray, hits, count)
    for i in range(tiles.triangle_start[tile], tiles.triangle_start[tile + 1]):
        t = tiles.triangle_item[i]
        if facets.facing[t] != 0 and not is_beside(facets.bounds, t, x, y):
            count += hit_triangle(facets, t, x, y, NEVER_FAR, hits, count, True)
    return count - settle(hits, zero, count, facets, hits, count)


@part(inline="always")
def _with_room(crossings, used, count):
    """Crossings with room for some more behind the used ones."""
    if used + count <= crossings.z.shape[0]:
        return crossings
    room = max(used + count, 2 * used)
    z, normal, geom = np.empty(room), np.empty((room, 3), np.float32), np.empty(room, np.int32)
    closed = np.empty(room, np.uint8)
    for i in range(used):  # slices take a second to compile: their errors are text
        z[i], geom[i], closed[i] = crossings.z[i], crossings.geom[i], crossings.closed[i]
        for axis in range(3):
            normal[i, axis] = crossings.normal[i, axis]
    return Crossings(crossings.start, z, normal, geom, closed)


@kernel(nogil=True)
def cast_points_at(points, tile, solids, facets, planes, tiles, heights):
    """Cross vertical lines at points, (n, 2) [m], over tiles, (n,) int64: `Crossings` by line."""
    num = points.shape[0]
    most = np.int64(0)
    for n in range(num):
        most = max(most, most_hits(tile[n], planes, tiles))
    ray, hits = make_ray(), make_hits(most)
    room = 4 * num
    found = Crossings(
        np.zeros(num + 1, np.int64), np.empty(room), np.empty((room, 3), np.float32),
        np.empty(room, np.int32), np.empty(room, np.uint8),
    )  # fmt: skip
    used = np.int64(0)
    for n in range(num):
        x, y = points[n, 0], points[n, 1]
        count = cast_line(x, y, tile[n], solids, facets, planes, tiles, heights, ray, hits)
        found = _with_room(found, used, count)
        for i in range(count):
            found.z[used + i], found.geom[used + i] = hits.z[i], hits.geom[i]
            found.closed[used + i] = hits.closed[i]
            for axis in range(3):
                found.normal[used + i, axis] = hits.normal[i, axis]
        used += count
        found.start[n + 1] = used
    return Crossings(
        found.start, found.z[:used], found.normal[:used], found.geom[:used], found.closed[:used]
    )
