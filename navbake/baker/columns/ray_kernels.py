"""Intersect vertical lines with all shapes, and list every crossing.

Solids and infinite planes are intersected by MuJoCo's own rays (`mju_rayGeom`), one up from below
and one down from above; triangles by `raster_kernels`. `hit_kernels` turns the hits into columns.

For each shape, the cells under it are visited, as in rasterizers (Pineda, 1988). Each thread takes
rows of tiles, so no two threads write to one column; within a row of tiles the order is fixed. So
the result is the same for any number of threads. All lines are cast twice: first to count the hits,
then to write them.

Most hits are on horizontal faces: ends of upright boxes and cylinders, and horizontal planes. There
MuJoCo's rays give the same height on all lines, to the last bit, since x and y are multiplied by
zero. So one ray through the middle serves all lines that are well inside of the rim.
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
    RIM_WIDTH,
    copy_hit,
    finish_line,
    make_hits,
    view_hits,
)
from navbake.baker.columns.raster_kernels import (
    NO_LIMITS,
    hit_triangle,
    is_beside,
    raster_triangles,
)
from navbake.baker.core.arrays import Facets, HeightRange, Planes, Solids
from navbake.baker.core.constants import BOX, CONVEX_SOLID, CYLINDER, OPEN_SURFACE, PLANE, SPHERE
from navbake.baker.core.tiles import TILE, cell_center, centers_between
from navbake.baker.geometry.triangle_kernels import unit_normal
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Float, Int

# An eighth of a turn [rad]
EIGHTH_TURN = 0.7853981633974483
# A plane's type; for a plain int, numba would compile functions once more
PLANE_KIND = np.int32(PLANE)
# Whether a line crosses an upright solid is beyond doubt of rounding if it is farther than this
# from the solid's rim [m]
RIM_CLEARANCE = 1e-5
# In solids with a smaller half-size, no ray serves several lines [m]
MIN_HALF_SIZE = 1e-3
LINES_PER_CALL = 64  # lines through points that one call takes together
# Axes; for plain ints, numba would compile functions once for each
X = np.int64(0)
Y = np.int64(1)
Z = np.int64(2)


class Lines(NamedTuple):
    """Lines through points, in a frame in which they are vertical.

    Attributes:
        points: x and y in the frame, (n, 2) float64 [m].
        tiles: by line, the first and the last tile of a rectangle of tiles; the line is intersected
            with the shapes over these tiles; (n, 2) int64.
        axes: the axes of the frame, one in each row, (3, 3) float64. Solids are in this frame
            already.
    """

    points: Float
    tiles: Int
    axes: Float


class Geometry(NamedTuple):
    """The shapes that lines are crossed with.

    Attributes:
        solids: primitives.
        facets: triangles.
        planes: infinite planes.
        heights: a height below all shapes, from which rays are cast up at planes, and one above all
            shapes, from which they are cast down [m].
    """

    solids: Solids
    facets: Facets
    planes: Planes
    heights: HeightRange


def _load_mujoco() -> None:
    """Make MuJoCo's functions known to compiled code, before such code is compiled or called."""
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
    """A ray, its result, and room for casting it; arrays of shape (3,), float64.

    Attributes:
        point: where the ray begins [m].
        direction: its direction, a unit vector.
        normal: receives the unit normal of the surface that it hits.
        nudged: room for a point beside `point`, see `_cast_at_rim` [m].
        enlarged_size: room for an enlarged size of a solid, see `_cast_at_rim` [m].
    """

    point: Float
    direction: Float
    normal: Float
    nudged: Float
    enlarged_size: Float


@subkernel(**NO_REFCOUNT)
def _cast(pos, mat, size, kind, point, ray):
    """Return the distance from a point to a geom along a ray, -1 if the ray misses it [m].

    `ray.normal` receives the normal of the surface that is hit. The geom is given by MuJoCo's
    position, rotation matrix, size and type.
    """
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
    """Cast a ray at a solid; a ray that misses it by at most RIM_WIDTH is moved onto its rim.

    Returns the distance to the solid, -1 if the ray misses it [m]. `ray.normal` receives the normal
    of the surface that is hit.
    """
    pos = solids.pos[s]
    mat = solids.mat[s]
    size = solids.size[s]
    kind = solids.kind[s]
    distance = _cast(pos, mat, size, kind, ray.point, ray)
    if distance >= 0.0:
        return distance
    for i in range(3):
        ray.enlarged_size[i] = size[i] + 2.0 * RIM_WIDTH
    if _cast(pos, mat, ray.enlarged_size, kind, ray.point, ray) < 0.0:
        return -1.0
    ray.nudged[2] = ray.point[2]
    for k in range(8):  # at a square corner, one of eight directions leads inside
        ray.nudged[0] = ray.point[0] + RIM_WIDTH * math.cos(k * EIGHTH_TURN)
        ray.nudged[1] = ray.point[1] + RIM_WIDTH * math.sin(k * EIGHTH_TURN)
        distance = _cast(pos, mat, size, kind, ray.nudged, ray)
        if distance >= 0.0:
            return distance
    return -1.0


@subkernel(inline="always")
def _aim(ray, is_down, low, high):
    """Point a ray up from a low height (`is_down` 0), or down from a high one (1)."""
    ray.direction[2] = 1.0 if is_down == 0 else -1.0
    ray.point[2] = low if is_down == 0 else high


@subkernel(inline="always")
def _write_hit(hits, place, z, normal, up, geom):
    """Write a hit of a solid or a plane into `hits`, at index `place`, except `closed` and `facet`.

    `up` is written as the normal's z.
    """
    hits.z[place] = z
    hits.normal[place, 0] = normal[0]
    hits.normal[place, 1] = normal[1]
    hits.normal[place, 2] = up
    hits.geom[place] = geom
    hits.at_edge[place] = INSIDE


@subkernel(**NO_REFCOUNT)
def _hit_solid(solids, s, x, y, ray, hits, place):
    """Write where the vertical line at (x, y) enters and leaves solid s; return how many hits.

    They are written into `hits` from index `place` on.
    """
    box = solids.bounds[s]
    count = np.int64(0)
    ray.point[0] = x
    ray.point[1] = y
    for is_down in range(2):
        _aim(ray, is_down, box[2] - 1.0, box[5] + 1.0)
        distance = _cast_at_rim(solids, s, ray)
        if distance >= 0.0:
            up = ray.normal[2]
            # a vertical side that is grazed faces neither up nor down: the ray's direction decides
            up = min(up, -1e-12) if is_down == 0 else max(up, 1e-12)
            z = ray.point[2] + ray.direction[2] * distance
            _write_hit(hits, place + count, z, ray.normal, up, solids.geom[s])
            hits.closed[place + count] = CONVEX_SOLID
            hits.facet[place + count] = OF_SOLID
            count += 1
    return count


@subkernel(inline="always")
def _is_upright(mat):
    """Return whether a geom's z axis is exactly vertical, up or down, given its rotation matrix."""
    return mat[2] == 0.0 and mat[5] == 0.0 and mat[6] == 0.0 and mat[7] == 0.0


@subkernel(**NO_REFCOUNT)
def _hit_plane(planes, p, x, y, heights, ray, hits, place):
    """Write where the vertical line at (x, y) crosses the front of plane p; return how many hits.

    They are written into `hits` from index `place` on. `heights` are a height below all shapes and
    one above all of them, from which rays are cast.
    """
    count = np.int64(0)
    pos = planes.pos[p]
    mat = planes.mat[p]
    ray.point[0] = x
    ray.point[1] = y
    ray.enlarged_size[:] = 0.0  # MuJoCo's planes of size 0 are infinite
    for is_down in range(2):
        _aim(ray, is_down, heights.low, heights.high)
        distance = _cast(pos, mat, ray.enlarged_size, PLANE_KIND, ray.point, ray)
        if distance >= 0.0:
            # not from the distance: the height is the same to the last bit wherever the ray begins
            across = (x - pos[0]) * mat[2] + (y - pos[1]) * mat[5]
            z = pos[2] - across / mat[8]
            _write_hit(hits, place + count, z, ray.normal, ray.normal[2], planes.geom[p])
            hits.closed[place + count] = OPEN_SURFACE
            hits.facet[place + count] = OF_PLANE
            count += 1
    return count


@subkernel(inline="always")
def _distance_to_rim(solids, s, x, y):
    """Return the distance from the vertical line at (x, y) to upright solid s's rim [m].

    It is negative where the line runs through the solid. For a box it is the larger one of the
    distances along the box's x and y.
    """
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
def _has_simple_rim(solids, s):
    """Return whether `_distance_to_rim` is valid for solid s: a sphere, upright box or cylinder."""
    kind = solids.kind[s]
    return kind == SPHERE or (kind in (BOX, CYLINDER) and _is_upright(solids.mat[s]))


@subkernel(inline="always")
def _has_flat_ends(solids, s):
    """Return whether the ends of an upright solid are flat: a cylinder or a box, but no sphere.

    All lines well inside of its rim then cross it at the same heights. Solids that are too small
    for any such line don't count.
    """
    size = solids.size[s]
    kind = solids.kind[s]
    is_wide = size[0] > MIN_HALF_SIZE and (kind == CYLINDER or size[1] > MIN_HALF_SIZE)
    return kind != SPHERE and is_wide


@subkernel(**NO_REFCOUNT)
def _cast_solid(solids, s, lattice, rows, ray, middle_hits, hits, end, writing):
    """Write where the vertical lines through cells' centres cross solid s.

    Args:
        solids: the solids, as `Solids`.
        s: index of the solid.
        lattice, rows, hits, end, writing: see `raster_triangles`.
        ray: a `Ray` to cast.
        middle_hits: room for the hits of the line through the solid's middle, as `LineHits`.
    """
    box = solids.bounds[s]
    cell_size = lattice.cell_size
    x_min = lattice.x_min
    y_max = lattice.y_max
    first_row, last_row = centers_between(
        y_max - box[4] - RIM_WIDTH, y_max - box[1] + RIM_WIDTH, cell_size, lattice.height
    )
    first_row = max(first_row, rows[0])
    last_row = min(last_row, rows[1] - 1)
    first_col, last_col = centers_between(
        box[0] - RIM_WIDTH - x_min, box[3] + RIM_WIDTH - x_min, cell_size, lattice.width
    )
    has_simple_rim = _has_simple_rim(solids, s)
    copies_middle = False
    if has_simple_rim and _has_flat_ends(solids, s):
        x = solids.pos[s, 0]
        y = solids.pos[s, 1]
        copies_middle = _hit_solid(solids, s, x, y, ray, middle_hits, np.int64(0)) == 2
    for row in range(first_row, last_row + 1):
        y = cell_center(lattice, row * lattice.width)[1]
        for col in range(first_col, last_col + 1):
            x = cell_center(lattice, col)[0]
            if is_beside(solids.bounds, s, x, y):
                continue
            outside = _distance_to_rim(solids, s, x, y) if has_simple_rim else 0.0
            if outside > RIM_CLEARANCE:
                continue
            line = (row - rows[0]) * lattice.width + col
            place = end[line] if writing else 0
            if copies_middle and outside < -RIM_CLEARANCE:
                for i in range(2):
                    copy_hit(middle_hits, i, hits, place + i)
                end[line] += 2
            else:
                end[line] += _hit_solid(solids, s, x, y, ray, hits, place)


@subkernel(**NO_REFCOUNT)
def _cast_plane(planes, p, lattice, rows, heights, ray, middle_hits, hits, end, writing):
    """Write where the vertical lines through cells' centres cross the front of plane p.

    Args:
        planes: the infinite planes, as `Planes`.
        p: index of the plane.
        lattice, rows, hits, end, writing: see `raster_triangles`.
        heights: heights below and above all shapes, from which rays are cast.
        ray: a `Ray` to cast.
        middle_hits: room for the hits of one line, as `LineHits`.
    """
    is_horizontal = _is_upright(planes.mat[p])
    count = np.int64(0)
    first_place = np.int64(0)
    for line in range(end.shape[0]):
        if not is_horizontal or line == 0:
            x, y = cell_center(lattice, rows[0] * lattice.width + line)
            count = _hit_plane(planes, p, x, y, heights, ray, middle_hits, first_place)
        place = end[line] if writing else 0
        for i in range(count):
            copy_hit(middle_hits, i, hits, place + i)
        end[line] += count


@subkernel(**NO_REFCOUNT)
def _finish_lines(hits, start, end, facets, spare):
    """Sort the hits of lines, and drop superfluous ones; return how many were dropped.

    Args:
        hits: the hits of all these lines, as `LineHits`.
        start: index of each line's first hit in the arrays of all columns.
        end: index past each line's last hit in `hits`.
        facets: the triangles, as `Facets`.
        spare: room for one hit, as `LineHits`.
    """
    num_dropped = 0
    for line in range(end.shape[0]):
        first = start[line] - start[0]
        num_dropped += finish_line(hits, first, end[line], facets, spare, np.int64(0))
    return num_dropped


@subkernel(inline="always")
def make_ray():
    """Allocate a ray; its point and direction are to be set before it is cast."""
    return Ray(np.empty(3), np.zeros(3), np.zeros(3), np.empty(3), np.empty(3))


@subkernel(inline="always")
def _cast_tile_row(
    lattice, geometry, shape_index, is_crossed, tile_row, ray, middle_hits, hits, end, writing
):
    """Write where the vertical lines through the cells of a row of tiles cross all shapes.

    Args:
        lattice, is_crossed, hits, end, writing: see `raster_triangles`.
        geometry: the shapes, as `Geometry`.
        shape_index: the shapes over each row of tiles.
        tile_row: number of the row of tiles.
        ray: a `Ray` to cast.
        middle_hits: room for the hits of one line, as `LineHits`.
    """
    solids = geometry.solids
    facets = geometry.facets
    planes = geometry.planes
    heights = geometry.heights
    rows = (tile_row * TILE, min((tile_row + 1) * TILE, lattice.height))
    for p in range(planes.geom.shape[0]):
        _cast_plane(planes, p, lattice, rows, heights, ray, middle_hits, hits, end, writing)
    for i in range(shape_index.solid_start[tile_row], shape_index.solid_start[tile_row + 1]):
        s = shape_index.solid_item[i]
        _cast_solid(solids, s, lattice, rows, ray, middle_hits, hits, end, writing)
    first = shape_index.triangle_start[tile_row]
    last = shape_index.triangle_start[tile_row + 1]
    triangles = shape_index.triangle_item[first:last]
    raster_triangles(facets, triangles, is_crossed[first:last], lattice, rows, hits, end, writing)


@subkernel(inline="always")
def _project(axes, axis, corners, t):
    """Return the coordinates of a triangle's three corners along an axis of a frame [m]."""
    x = axes[axis, 0]
    y = axes[axis, 1]
    z = axes[axis, 2]
    return (
        x * corners[t, 0, 0] + y * corners[t, 0, 1] + z * corners[t, 0, 2],
        x * corners[t, 1, 0] + y * corners[t, 1, 1] + z * corners[t, 1, 2],
        x * corners[t, 2, 0] + y * corners[t, 2, 1] + z * corners[t, 2, 2],
    )


@subkernel(inline="always")
def _may_cross(corners, t, x, y, axes, local_corners):
    """Return whether a line at (x, y) of a frame may cross triangle t.

    The line is vertical in the frame with the given axes. If it may cross the triangle,
    `local_corners`, (1, 3, 3), receives the triangle's corners in that frame.
    """
    x0, x1, x2 = _project(axes, X, corners, t)
    if (
        x < min(x0, x1, x2) - RIM_WIDTH or x > max(x0, x1, x2) + RIM_WIDTH
    ):  # true for most triangles
        return False
    y0, y1, y2 = _project(axes, Y, corners, t)
    if y < min(y0, y1, y2) - RIM_WIDTH or y > max(y0, y1, y2) + RIM_WIDTH:
        return False
    z0, z1, z2 = _project(axes, Z, corners, t)
    local_corners[0, 0, X] = x0
    local_corners[0, 1, X] = x1
    local_corners[0, 2, X] = x2
    local_corners[0, 0, Y] = y0
    local_corners[0, 1, Y] = y1
    local_corners[0, 2, Y] = y2
    local_corners[0, 0, Z] = z0
    local_corners[0, 1, Z] = z1
    local_corners[0, 2, Z] = z2
    return unit_normal(local_corners, 0)[2] != 0.0


@subkernel(**NO_REFCOUNT)
def _cast_line(lattice, geometry, tile_index, lines, n, ray, local_corners, hits, place, writing):
    """Write where line n crosses all shapes; return how many hits.

    Args:
        lattice: the cells, as `Lattice`.
        geometry: the shapes, as `Geometry`.
        tile_index: the shapes over each tile.
        lines: the lines, as `Lines`.
        n: index of the line.
        ray: a `Ray` to cast.
        local_corners: room for a triangle's corners, (1, 3, 3).
        hits: `LineHits` to write into.
        place: index in `hits` of the line's first hit.
        writing: whether there is room for all hits; else they are only counted.
    """
    solids = geometry.solids
    facets = geometry.facets
    planes = geometry.planes
    heights = geometry.heights
    x = lines.points[n, 0]
    y = lines.points[n, 1]
    count = 0
    tiles_x = -(-lattice.width // TILE)
    row_0 = lines.tiles[n, 0] // tiles_x
    row_1 = lines.tiles[n, 1] // tiles_x
    col_0 = lines.tiles[n, 0] % tiles_x
    col_1 = lines.tiles[n, 1] % tiles_x
    is_rotated = lines.axes[0, 0] != 1.0 or lines.axes[2, 2] != 1.0
    for p in range(planes.geom.shape[0]):
        next_place = place + count if writing else place
        count += _hit_plane(planes, p, x, y, heights, ray, hits, next_place)
    for row in range(min(row_0, row_1), max(row_0, row_1) + 1):
        for col in range(min(col_0, col_1), max(col_0, col_1) + 1):
            tile = row * tiles_x + col
            for i in range(tile_index.solid_start[tile], tile_index.solid_start[tile + 1]):
                s = tile_index.solid_item[i]
                next_place = place + count if writing else place
                if not is_beside(solids.bounds, s, x, y):
                    count += _hit_solid(solids, s, x, y, ray, hits, next_place)
            for i in range(tile_index.triangle_start[tile], tile_index.triangle_start[tile + 1]):
                t = tile_index.triangle_item[i]
                next_place = place + count
                if not is_rotated and is_beside(facets.bounds, t, x, y):
                    continue
                if not _may_cross(facets.corners, t, x, y, lines.axes, local_corners):
                    continue
                num_hits = hit_triangle(
                    local_corners, 0, facets, t, x, y, NO_LIMITS, hits, next_place, writing
                )
                if num_hits > 0:
                    count += 1
                    if writing and is_rotated:
                        # a triangle over two of the line's tiles is hit twice, so such hits
                        # cannot say what is inside
                        hits.closed[next_place] = OPEN_SURFACE
    return count


@kernel(nogil=True)
def cast_lines(
    lattice, lines, geometry, shape_index, is_crossed, column_hits, num_dropped, first_group, end
):
    """Intersect the lines of groups ``range(first_group, end)`` with all shapes.

    It is called twice: first with empty hits, to count, then with room for the hits.

    Args:
        lattice: the cells, as `Lattice`.
        lines: lines through points, in groups of LINES_PER_CALL; or none, for lines through the
            centres of the lattice's cells, in groups of a row of tiles each.
        geometry: the shapes, as `Geometry`.
        shape_index: the shapes by tile for lines through points, else by row of tiles.
        is_crossed: for each entry of `shape_index.triangle_item`, whether any line of its row of
            tiles crosses the triangle, bool; written while counting, read while writing. Unused for
            lines through points.
        column_hits: `ColumnHits`. While counting, all arrays but `start` are empty, and
            ``start[line + 1]`` receives the number of the line's hits. While writing, `start` has
            the running sums of these numbers, and the other arrays receive the hits; the last hits
            of a column may have the geom DROPPED.
        num_dropped: receives, for each group, the number of DROPPED hits, int64.
        first_group, end: range of groups.
    """
    start = column_hits.start
    writing = column_hits.z.shape[0] > 0
    ray = make_ray()
    middle_hits = make_hits(2)
    local_corners = np.empty((1, 3, 3))
    num_lines = lines.points.shape[0]
    group_size = LINES_PER_CALL
    at_points = lines.points.shape[0] > 0
    if not at_points:
        num_lines = lattice.height * lattice.width
        group_size = TILE * lattice.width
    for group in range(first_group, end):
        first_line = group * group_size
        end_line = min((group + 1) * group_size, num_lines)
        place = np.zeros(end_line - first_line, np.int64)  # of each line's next hit
        hits = middle_hits
        if writing:
            hits = view_hits(column_hits, start[first_line], start[end_line])
            for line in range(end_line - first_line):
                place[line] = start[first_line + line] - start[first_line]
        if at_points:
            for n in range(first_line, end_line):
                first_place = place[n - first_line]
                place[n - first_line] += _cast_line(
                    lattice,
                    geometry,
                    shape_index,
                    lines,
                    n,
                    ray,
                    local_corners,
                    hits,
                    first_place,
                    writing,
                )
        else:
            _cast_tile_row(
                lattice,
                geometry,
                shape_index,
                is_crossed,
                group,
                ray,
                middle_hits,
                hits,
                place,
                writing,
            )
        if writing:
            num_dropped[group] = _finish_lines(
                hits, start[first_line:end_line], place, geometry.facets, middle_hits
            )
            continue
        for line in range(end_line - first_line):
            start[first_line + line + 1] = place[line]
