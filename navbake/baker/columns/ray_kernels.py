"""Vertical lines through all geometry: every crossing, both ways.

Solids and infinite planes are crossed by MuJoCo's own rays (`mju_rayGeom`), one up from below and
one down from above. Triangles are crossed in `raster`; `hits` makes columns of what was hit.

Geometry visits the cells that it lies over, as in rasterizers (Pineda, 1988). Each thread takes
bands of rows, so no two write to one column, and within a band the order is fixed: the result is
the same for any number of threads. All is done twice: to count, then to write.

Most column_hits are of level faces: ends of upright boxes and cylinders, and level planes. MuJoCo's
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

from navbake.baker.columns.hit_kernels import (
    INSIDE,
    OF_PLANE,
    OF_SOLID,
    RIM,
    copy_hit,
    hits_of,
    make_hits,
    settle,
)
from navbake.baker.columns.raster_kernels import (
    NEVER_FAR,
    hit_triangle,
    is_beside,
    raster_triangles,
)
from navbake.baker.core.constants import BOX, CONVEX_SOLID, CYLINDER, OPEN_SURFACE, PLANE, SPHERE
from navbake.baker.core.tiles import TILE, cell_center, centers_between
from navbake.baker.geometry.triangle_kernels import unit_normal
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Float, Int

# An eighth of a turn [rad]
EIGHTH = 0.7853981633974483
# A plane's type; a plain int would be a type of its own, and compile what takes it once more
PLANE_KIND = np.int32(PLANE)
# Lines this far from the rim of an upright solid are inside or outside of it, whatever rounding
# does; and solids narrower than WIDE ask MuJoCo on all lines [m]
CLEAR = 1e-5
WIDE = 1e-3
GROUP = 64  # lines at points that one call takes together
# Axes; plain integers would compile what takes them once for each
X = np.int64(0)
Y = np.int64(1)
Z = np.int64(2)


class Lines(NamedTuple):
    """Lines at points, in a frame in which they are upright.

    Attributes:
        points: x and y in the frame, (n, 2) float64 [m].
        tiles: of each, the first and the last one of a rectangle of tiles, for whose items it is
            looked at; (n, 2) int64.
        axes: of the frame, (3, 3) float64, its rows; solids are turned into it beforehand.
    """

    points: Float
    tiles: Int
    axes: Float


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


@subkernel(**NO_REFCOUNT)
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


@subkernel(inline="always")
def _cast_at_rim(solids, s, ray):
    """Cast a ray at a solid; one that misses its rim by at most RIM is moved onto it."""
    pos = solids.pos[s]
    mat = solids.mat[s]
    size = solids.size[s]
    kind = solids.kind[s]
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


@subkernel(inline="always")
def _aim(ray, way, low, high):
    """Point a ray up from a height (way 0) or down from another (way 1)."""
    ray.direction[2] = 1.0 if way == 0 else -1.0
    ray.point[2] = low if way == 0 else high


@subkernel(inline="always")
def _hit(hits, at, z, normal, up, geom):
    """Note a hit of a solid or a plane, but for `closed` and `facet`."""
    hits.z[at] = z
    hits.normal[at, 0] = normal[0]
    hits.normal[at, 1] = normal[1]
    hits.normal[at, 2] = up
    hits.geom[at] = geom
    hits.at_edge[at] = INSIDE


@subkernel(**NO_REFCOUNT)
def _hit_solid(solids, s, x, y, ray, hits, at):
    """Note where a line enters and leaves a solid, from a place of the hits; returns how often."""
    box = solids.bounds[s]
    count = np.int64(0)
    ray.point[0] = x
    ray.point[1] = y
    for way in range(2):
        _aim(ray, way, box[2] - 1.0, box[5] + 1.0)
        distance = _cast_at_rim(solids, s, ray)
        if distance >= 0.0:
            up = ray.normal[2]
            # a grazed side has no up or down of its own: the ray's way tells
            up = min(up, -1e-12) if way == 0 else max(up, 1e-12)
            z = ray.point[2] + ray.direction[2] * distance
            _hit(hits, at + count, z, ray.normal, up, solids.geom[s])
            hits.closed[at + count] = CONVEX_SOLID
            hits.facet[at + count] = OF_SOLID
            count += 1
    return count


@subkernel(inline="always")
def _is_upright(mat):
    """Whether a geom's z is the world's, or its opposite, to the last bit."""
    return mat[2] == 0.0 and mat[5] == 0.0 and mat[6] == 0.0 and mat[7] == 0.0


@subkernel(**NO_REFCOUNT)
def _hit_plane(planes, p, x, y, heights, ray, hits, at):
    """Note where a line crosses an infinite plane, from its front only; returns how often."""
    count = np.int64(0)
    pos = planes.pos[p]
    mat = planes.mat[p]
    ray.point[0] = x
    ray.point[1] = y
    ray.grown[:] = 0.0  # a plane of no size is infinite
    for way in range(2):
        _aim(ray, way, heights.low, heights.high)
        distance = _cast(pos, mat, ray.grown, PLANE_KIND, ray.point, ray)
        if distance >= 0.0:
            # to the last bit, wherever the ray begins
            across = (x - pos[0]) * mat[2] + (y - pos[1]) * mat[5]
            z = pos[2] - across / mat[8]
            _hit(hits, at + count, z, ray.normal, ray.normal[2], planes.geom[p])
            hits.closed[at + count] = OPEN_SURFACE
            hits.facet[at + count] = OF_PLANE
            count += 1
    return count


@subkernel(inline="always")
def _beyond_rim(solids, s, x, y):
    """How far a line is beyond an upright solid's rim, of a box along one axis, < 0 inside [m]."""
    mat = solids.mat[s]
    size = solids.size[s]
    kind = solids.kind[s]
    dx = x - solids.pos[s, 0]
    dy = y - solids.pos[s, 1]
    if kind == BOX:
        across = mat[0] * dx + mat[3] * dy
        along = mat[1] * dx + mat[4] * dy
        return max(abs(across) - size[0], abs(along) - size[1])
    return math.hypot(dx, dy) - size[0]


@subkernel(inline="always")
def _has_known_rim(solids, s):
    """Whether `_beyond_rim` knows a solid's rim, as seen from above."""
    kind = solids.kind[s]
    return kind == SPHERE or (kind in (BOX, CYLINDER) and _is_upright(solids.mat[s]))


@subkernel(inline="always")
def _has_level_ends(solids, s):
    """Whether all lines well inside of a solid's rim cross it at the same two heights."""
    size = solids.size[s]
    kind = solids.kind[s]
    is_wide = size[0] > WIDE and (kind == CYLINDER or size[1] > WIDE)
    return kind != SPHERE and is_wide


@subkernel(**NO_REFCOUNT)
def _cast_solid(solids, s, lattice, rows, ray, middle, hits, end, writing):
    """Note where the lines of some rows cross a solid, as `raster_triangles` does triangles.

    `middle` has room for the hits of the line through its middle.
    """
    box = solids.bounds[s]
    cell = lattice.cell_size
    x_min = lattice.x_min
    y_max = lattice.y_max
    first, last = centers_between(y_max - box[4] - RIM, y_max - box[1] + RIM, cell, lattice.height)
    first = max(first, rows[0])
    last = min(last, rows[1] - 1)
    left, right = centers_between(box[0] - RIM - x_min, box[3] + RIM - x_min, cell, lattice.width)
    has_rim = _has_known_rim(solids, s)
    has_level = False
    if has_rim and _has_level_ends(solids, s):
        x = solids.pos[s, 0]
        y = solids.pos[s, 1]
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


@subkernel(**NO_REFCOUNT)
def _cast_plane(planes, p, lattice, rows, heights, ray, middle, hits, end, writing):
    """Note where the lines of some rows cross an infinite plane, see `_cast_solid`."""
    is_level = _is_upright(planes.mat[p])
    count = np.int64(0)
    zero = np.int64(0)
    for line in range(end.shape[0]):
        if not is_level or line == 0:
            x, y = cell_center(lattice, rows[0] * lattice.width + line)
            count = _hit_plane(planes, p, x, y, heights, ray, middle, zero)
        place = end[line] if writing else 0
        for i in range(count):
            copy_hit(middle, i, hits, place + i)
        end[line] += count


@subkernel(**NO_REFCOUNT)
def _settle_lines(hits, start, end, facets, spare):
    """`settle` the hits of lines, from `start`, of whole columns, to `end`; returns the dropped."""
    dropped = 0
    for line in range(end.shape[0]):
        first = start[line] - start[0]
        dropped += settle(hits, first, end[line], facets, spare, np.int64(0))
    return dropped


@subkernel(inline="always")
def make_ray():
    """A ray; its point and direction are for who casts it."""
    return Ray(np.empty(3), np.zeros(3), np.zeros(3), np.empty(3), np.empty(3))


@subkernel(inline="always")
def _cast_band(lattice, geometry, items, crossed, band, ray, middle, hits, end, writing):
    """Note what the lines of a band's cells cross; `end` is as in `raster_triangles`."""
    solids, facets, planes, heights = geometry
    rows = band * TILE, min((band + 1) * TILE, lattice.height)
    for p in range(planes.geom.shape[0]):
        _cast_plane(planes, p, lattice, rows, heights, ray, middle, hits, end, writing)
    for i in range(items.solid_start[band], items.solid_start[band + 1]):
        s = items.solid_item[i]
        _cast_solid(solids, s, lattice, rows, ray, middle, hits, end, writing)
    here = slice(items.triangle_start[band], items.triangle_start[band + 1])
    listed = items.triangle_item[here]
    is_crossed = crossed[here]
    raster_triangles(facets, listed, is_crossed, lattice, rows, hits, end, writing)


@subkernel(inline="always")
def _along(axes, axis, corners, t):
    """A triangle's three corners along an axis of a frame."""
    x = axes[axis, 0]
    y = axes[axis, 1]
    z = axes[axis, 2]
    return (
        x * corners[t, 0, 0] + y * corners[t, 0, 1] + z * corners[t, 0, 2],
        x * corners[t, 1, 0] + y * corners[t, 1, 1] + z * corners[t, 1, 2],
        x * corners[t, 2, 0] + y * corners[t, 2, 1] + z * corners[t, 2, 2],
    )


@subkernel(inline="always")
def _is_near(corners, t, x, y, axes, turned):
    """Whether a line may cross a triangle, whose corners in the line's frame `turned` receives."""
    a, b, c = _along(axes, X, corners, t)
    if x < min(a, b, c) - RIM or x > max(a, b, c) + RIM:  # most are
        return False
    d, e, f = _along(axes, Y, corners, t)
    if y < min(d, e, f) - RIM or y > max(d, e, f) + RIM:
        return False
    turned[0, 0, X] = a
    turned[0, 1, X] = b
    turned[0, 2, X] = c
    turned[0, 0, Y] = d
    turned[0, 1, Y] = e
    turned[0, 2, Y] = f
    turned[0, 0, Z], turned[0, 1, Z], turned[0, 2, Z] = _along(axes, Z, corners, t)
    return unit_normal(turned, 0)[2] != 0.0


@subkernel(**NO_REFCOUNT)
def _cast_at(lattice, geometry, items, lines, n, ray, turned, hits, at, writing):
    """Note what the n-th line crosses, from a place of the hits on; returns how often.

    `turned` has room for a triangle's corners, (1, 3, 3).
    """
    solids, facets, planes, heights = geometry
    x = lines.points[n, 0]
    y = lines.points[n, 1]
    count = 0
    tiles_x = -(-lattice.width // TILE)
    row0 = lines.tiles[n, 0] // tiles_x
    row1 = lines.tiles[n, 1] // tiles_x
    col0 = lines.tiles[n, 0] % tiles_x
    col1 = lines.tiles[n, 1] % tiles_x
    is_turned = lines.axes[0, 0] != 1.0 or lines.axes[2, 2] != 1.0
    for p in range(planes.geom.shape[0]):
        count += _hit_plane(planes, p, x, y, heights, ray, hits, at + count if writing else at)
    for row in range(min(row0, row1), max(row0, row1) + 1):
        for col in range(min(col0, col1), max(col0, col1) + 1):
            tile = row * tiles_x + col
            for i in range(items.solid_start[tile], items.solid_start[tile + 1]):
                s = items.solid_item[i]
                place = at + count if writing else at
                if not is_beside(solids.bounds, s, x, y):
                    count += _hit_solid(solids, s, x, y, ray, hits, place)
            for i in range(items.triangle_start[tile], items.triangle_start[tile + 1]):
                t = items.triangle_item[i]
                place = at + count
                if not is_turned and is_beside(facets.bounds, t, x, y):
                    continue
                if not _is_near(facets.corners, t, x, y, lines.axes, turned):
                    continue
                if hit_triangle(turned, 0, facets, t, x, y, NEVER_FAR, hits, place, writing) > 0:
                    count += 1
                    if writing and is_turned:
                        hits.closed[place] = OPEN_SURFACE  # it may be listed twice
    return count


@kernel(nogil=True)
def cast_lines(lattice, lines, geometry, items, crossed, column_hits, dropped, first_group, end):
    """Cross lines with all geometry, in groups of them; twice: to count, then to write.

    Args:
        lines: at points, in groups of GROUP; or none, for those of the lattice's cells, in bands.
        geometry: solids, facets, planes, and a `Band` below and above everything [m].
        items: what lies over which tile, for lines at points, or else over which band.
        crossed: by triangle of the bands, bool: whether any line of its band crosses it; receives
            that while counting.
        column_hits: while counting all but `start` are empty, and ``start[line + 1]`` receives the
            number of hits; while writing `start` has their running sums, and the others receive
            the column_hits, and behind each column's last those that are DROPPED.
        dropped: by group, int64; receives the number of hits that are no column_hits.
    """
    start = column_hits.start
    writing = column_hits.z.shape[0] > 0
    ray = make_ray()
    middle = make_hits(2)
    turned = np.empty((1, 3, 3))
    num = lines.points.shape[0]
    size = GROUP
    at_points = lines.points.shape[0] > 0
    if not at_points:
        num = lattice.height * lattice.width
        size = TILE * lattice.width
    for group in range(first_group, end):
        first = group * size
        last = min((group + 1) * size, num)
        place = np.zeros(last - first, np.int64)
        hits = middle
        if writing:
            hits = hits_of(column_hits, start[first], start[last])
            for line in range(last - first):
                place[line] = start[first + line] - start[first]
        if not at_points:
            _cast_band(lattice, geometry, items, crossed, group, ray, middle, hits, place, writing)
        for n in range(first, last if at_points else first):
            at = place[n - first]
            found = _cast_at(lattice, geometry, items, lines, n, ray, turned, hits, at, writing)
            place[n - first] += found
        if writing:
            dropped[group] = _settle_lines(hits, start[first:last], place, geometry[1], middle)
            continue
        for line in range(last - first):
            start[first + line + 1] = place[line]
