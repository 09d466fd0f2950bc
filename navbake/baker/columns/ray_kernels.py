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
    HIT_OF_PLANE,
    HIT_OF_SOLID,
    INSIDE,
    RIM_WIDTH,
    allocate_hits,
    copy_hit,
    finish_line,
    view_hits,
)
from navbake.baker.columns.raster_kernels import (
    find_edge_limits,
    hit_triangle,
    is_beside,
    raster_triangles,
)
from navbake.baker.core.arrays import Facets, HeightRange, Planes, Solids
from navbake.baker.core.constants import BOX, CONVEX_SOLID, CYLINDER, OPEN_SURFACE, PLANE, SPHERE
from navbake.baker.core.tiles import TILE, cell_center, find_centers_between
from navbake.baker.geometry.triangle_kernels import allocate_triangle, unit_normal
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
# Lines through points that one call takes together. Those that have the same tiles are compared
# with triangles together, which is fast where they are near each other
LINES_PER_CALL = 64
# Axes; for plain ints, numba would compile functions once for each
X = np.int64(0)
Y = np.int64(1)
Z = np.int64(2)


class Lines(NamedTuple):
    """Lines through points, in a frame in which they are vertical.

    Attributes:
        points: x and y in the frame, (n, 2) float64 [m].
        tiles: for each line, the first and the last tile of a rectangle of tiles, (n, 2) int64. The
            line is only intersected with the shapes over these tiles.
        axes: the axes of the frame, one in each row, (3, 3) float64. Solids are in this frame
            already.
    """

    points: Float
    tiles: Int
    axes: Float


class Geometry(NamedTuple):
    """The shapes that lines are intersected with.

    Attributes:
        solids: primitives.
        facets: triangles.
        planes: infinite planes.
        height_range: a height below all shapes, from which rays are cast up at planes, and one
            above all shapes, from which they are cast down [m].
    """

    solids: Solids
    facets: Facets
    planes: Planes
    height_range: HeightRange


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
    """A ray, the normal of the surface that it hits, and scratch arrays; all of (3,), float64.

    Attributes:
        point: where the ray begins [m].
        direction: its direction, a unit vector.
        normal: receives the unit normal of the surface that it hits.
        nudged_point: scratch for a point beside `point`, see `_cast_at_rim` [m].
        enlarged_size: scratch for an enlarged size of a solid, see `_cast_at_rim` [m].
    """

    point: Float
    direction: Float
    normal: Float
    nudged_point: Float
    enlarged_size: Float


@subkernel(**NO_REFCOUNT)
def _cast_at_geom(pos, mat, size, kind, point, ray):
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
def _cast_at_rim(solids, solid, ray):
    """Cast a ray at a solid; a ray that misses it by at most RIM_WIDTH is moved onto its rim.

    Returns the distance to the solid, -1 if the ray misses it [m]. `ray.normal` receives the normal
    of the surface that is hit.
    """
    pos = solids.pos[solid]
    mat = solids.mat[solid]
    size = solids.size[solid]
    kind = solids.kind[solid]
    distance = _cast_at_geom(pos, mat, size, kind, ray.point, ray)
    if distance >= 0.0:
        return distance
    for i in range(3):
        ray.enlarged_size[i] = size[i] + 2.0 * RIM_WIDTH
    if _cast_at_geom(pos, mat, ray.enlarged_size, kind, ray.point, ray) < 0.0:
        return -1.0
    ray.nudged_point[2] = ray.point[2]
    for k in range(8):  # at a square corner, one of eight directions leads inside
        ray.nudged_point[0] = ray.point[0] + RIM_WIDTH * math.cos(k * EIGHTH_TURN)
        ray.nudged_point[1] = ray.point[1] + RIM_WIDTH * math.sin(k * EIGHTH_TURN)
        distance = _cast_at_geom(pos, mat, size, kind, ray.nudged_point, ray)
        if distance >= 0.0:
            return distance
    return -1.0


@subkernel(inline="always")
def _aim_ray(ray, is_down, low_height, high_height):
    """Point a ray up from a low height (`is_down` 0), or down from a high one (1)."""
    ray.direction[2] = 1.0 if is_down == 0 else -1.0
    ray.point[2] = low_height if is_down == 0 else high_height


@subkernel(inline="always")
def _write_hit(hits, hit_index, z, normal, normal_z, geom):
    """Write a hit of a solid or a plane into `hits`, at index `hit_index`.

    `normal_z` is written as the normal's z; `hits.closed` and `hits.facet` are not written.
    """
    hits.z[hit_index] = z
    hits.normal[hit_index, 0] = normal[0]
    hits.normal[hit_index, 1] = normal[1]
    hits.normal[hit_index, 2] = normal_z
    hits.geom[hit_index] = geom
    hits.is_at_edge[hit_index] = INSIDE


@subkernel(**NO_REFCOUNT)
def hit_solid(solids, solid, x, y, ray, hits, first_hit):
    """Write where the vertical line at (x, y) enters and leaves a solid; return how many hits.

    They are written into `hits` from index `first_hit` on.
    """
    box = solids.bounds[solid]
    num_hits = np.int64(0)
    ray.point[0] = x
    ray.point[1] = y
    for is_down in range(2):
        _aim_ray(ray, is_down, box[2] - 1.0, box[5] + 1.0)
        distance = _cast_at_rim(solids, solid, ray)
        if distance >= 0.0:
            normal_z = ray.normal[2]
            # a vertical side that is grazed faces neither up nor down: the ray's direction decides
            normal_z = min(normal_z, -1e-12) if is_down == 0 else max(normal_z, 1e-12)
            z = ray.point[2] + ray.direction[2] * distance
            _write_hit(hits, first_hit + num_hits, z, ray.normal, normal_z, solids.geom[solid])
            hits.closed[first_hit + num_hits] = CONVEX_SOLID
            hits.facet[first_hit + num_hits] = HIT_OF_SOLID
            num_hits += 1
    return num_hits


@subkernel(inline="always")
def _has_vertical_z_axis(mat):
    """Return whether a geom's z axis is exactly vertical, up or down, given its rotation matrix."""
    return mat[2] == 0.0 and mat[5] == 0.0 and mat[6] == 0.0 and mat[7] == 0.0


@subkernel(**NO_REFCOUNT)
def hit_plane(planes, plane, x, y, height_range, ray, hits, first_hit):
    """Write where the vertical line at (x, y) crosses the front of a plane; return how many hits.

    They are written into `hits` from index `first_hit` on. `height_range` has a height
    below all shapes and one above all of them, from which rays are cast.
    """
    num_hits = np.int64(0)
    pos = planes.pos[plane]
    mat = planes.mat[plane]
    ray.point[0] = x
    ray.point[1] = y
    ray.enlarged_size[:] = 0.0  # MuJoCo's planes of size 0 are infinite
    for is_down in range(2):
        _aim_ray(ray, is_down, height_range.low, height_range.high)
        distance = _cast_at_geom(pos, mat, ray.enlarged_size, PLANE_KIND, ray.point, ray)
        if distance >= 0.0:
            # not from the distance: the height is the same to the last bit wherever the ray begins
            offset_along_normal = (x - pos[0]) * mat[2] + (y - pos[1]) * mat[5]
            z = pos[2] - offset_along_normal / mat[8]
            _write_hit(hits, first_hit + num_hits, z, ray.normal, ray.normal[2], planes.geom[plane])
            hits.closed[first_hit + num_hits] = OPEN_SURFACE
            hits.facet[first_hit + num_hits] = HIT_OF_PLANE
            num_hits += 1
    return num_hits


@subkernel(inline="always")
def _distance_to_rim(solids, solid, x, y):
    """Return the distance from the vertical line at (x, y) to an upright solid's rim [m].

    It is negative where the line runs through the solid. For a box it is the larger one of the
    distances along the box's x and y.
    """
    mat = solids.mat[solid]
    size = solids.size[solid]
    kind = solids.kind[solid]
    dx = x - solids.pos[solid, 0]
    dy = y - solids.pos[solid, 1]
    if kind == BOX:
        local_x = mat[0] * dx + mat[3] * dy
        local_y = mat[1] * dx + mat[4] * dy
        return max(abs(local_x) - size[0], abs(local_y) - size[1])
    return math.hypot(dx, dy) - size[0]


@subkernel(inline="always")
def _has_simple_rim(solids, solid):
    """Return whether `_distance_to_rim` is valid for a solid: a sphere, upright box or cylinder."""
    kind = solids.kind[solid]
    return kind == SPHERE or (kind in (BOX, CYLINDER) and _has_vertical_z_axis(solids.mat[solid]))


@subkernel(inline="always")
def _has_flat_ends(solids, solid):
    """Return whether the ends of an upright solid are flat: a cylinder or a box, but no sphere.

    All lines well inside of its rim then cross it at the same heights. Solids that are too small
    for any such line don't count.
    """
    size = solids.size[solid]
    kind = solids.kind[solid]
    is_wide = size[0] > MIN_HALF_SIZE and (kind == CYLINDER or size[1] > MIN_HALF_SIZE)
    return kind != SPHERE and is_wide


@subkernel(**NO_REFCOUNT)
def _cast_solid(solids, solid, lattice, rows, ray, middle_hits, hits, next_hit, is_writing):
    """Write where the vertical lines through cells' centres cross a solid.

    Args:
        solids: the solids, as `Solids`.
        solid: index of the solid.
        lattice: the cells, as `Lattice`.
        rows: the first row to cast lines in, and the row after the last one.
        ray: a `Ray` to cast.
        middle_hits: room for the hits of the line through the solid's middle, as `LineHits`.
        hits: `LineHits` of the rows' lines, which are written.
        next_hit: for each line of the rows, where its next hit goes in `hits`, int64; advanced by 1
            for each hit.
        is_writing: whether to write hits; else they are only counted.
    """
    box = solids.bounds[solid]
    cell_size = lattice.cell_size
    x_min = lattice.x_min
    y_max = lattice.y_max
    first_row, last_row = find_centers_between(
        y_max - box[4] - RIM_WIDTH, y_max - box[1] + RIM_WIDTH, cell_size, lattice.height
    )
    first_row = max(first_row, rows[0])
    last_row = min(last_row, rows[1] - 1)
    first_col, last_col = find_centers_between(
        box[0] - RIM_WIDTH - x_min, box[3] + RIM_WIDTH - x_min, cell_size, lattice.width
    )
    has_simple_rim = _has_simple_rim(solids, solid)
    reuses_middle_hits = False
    if has_simple_rim and _has_flat_ends(solids, solid):
        x = solids.pos[solid, 0]
        y = solids.pos[solid, 1]
        reuses_middle_hits = hit_solid(solids, solid, x, y, ray, middle_hits, np.int64(0)) == 2
    for row in range(first_row, last_row + 1):
        y = cell_center(lattice, row * lattice.width)[1]
        for col in range(first_col, last_col + 1):
            x = cell_center(lattice, col)[0]
            if is_beside(solids.bounds, solid, x, y):
                continue
            distance_to_rim = _distance_to_rim(solids, solid, x, y) if has_simple_rim else 0.0
            if distance_to_rim > RIM_CLEARANCE:
                continue
            line = (row - rows[0]) * lattice.width + col
            hit_index = next_hit[line] if is_writing else 0
            if reuses_middle_hits and distance_to_rim < -RIM_CLEARANCE:
                for i in range(2):
                    copy_hit(middle_hits, i, hits, hit_index + i)
                next_hit[line] += 2
            else:
                next_hit[line] += hit_solid(solids, solid, x, y, ray, hits, hit_index)


@subkernel(**NO_REFCOUNT)
def _cast_plane(
    planes, plane, lattice, rows, height_range, ray, middle_hits, hits, next_hit, is_writing
):
    """Write where the vertical lines through cells' centres cross the front of a plane.

    Args:
        planes: the infinite planes, as `Planes`.
        plane: index of the plane.
        lattice: the cells, as `Lattice`.
        rows: the first row to cast lines in, and the row after the last one.
        height_range: a height below all shapes and one above them, from which rays are cast [m].
        ray: a `Ray` to cast.
        middle_hits: room for the hits of one line, as `LineHits`.
        hits: `LineHits` of the rows' lines, which are written.
        next_hit: for each line of the rows, where its next hit goes in `hits`, int64; advanced by 1
            for each hit.
        is_writing: whether to write hits; else they are only counted.
    """
    is_horizontal = _has_vertical_z_axis(planes.mat[plane])
    num_hits = np.int64(0)
    first_middle_hit = np.int64(0)
    for line in range(next_hit.shape[0]):
        if not is_horizontal or line == 0:
            x, y = cell_center(lattice, rows[0] * lattice.width + line)
            num_hits = hit_plane(
                planes, plane, x, y, height_range, ray, middle_hits, first_middle_hit
            )
        hit_index = next_hit[line] if is_writing else 0
        for i in range(num_hits):
            copy_hit(middle_hits, i, hits, hit_index + i)
        next_hit[line] += num_hits


@subkernel(**NO_REFCOUNT)
def _finish_lines(
    hits, first_hit, end_hit, facets, scratch_hits, column_hits, next_place, num_dropped
):
    """Sort the hits of lines, drop superfluous ones, and leave no gaps between the others.

    Args:
        hits: the hits of all these lines, as `LineHits`; a view of a part of `column_hits`.
        first_hit: index of each line's first hit in `column_hits`.
        end_hit: index past each line's last hit in `hits`.
        facets: the triangles, as `Facets`.
        scratch_hits: room for one hit, as `LineHits`.
        column_hits: the hits of all columns; hits move up where others were dropped before them.
        next_place: index in `column_hits` for the first of these hits.
        num_dropped: receives how many hits of each line were dropped, int32.

    Returns:
        The index in `column_hits` after the last of these hits.
    """
    for line in range(end_hit.shape[0]):
        first_index = first_hit[line] - first_hit[0]
        remaining_end = finish_line(
            hits, first_index, end_hit[line], facets, scratch_hits, np.int64(0)
        )
        num_dropped[line] = end_hit[line] - remaining_end
        for hit in range(first_hit[line], first_hit[0] + remaining_end):
            if next_place != hit:
                column_hits.z[next_place] = column_hits.z[hit]
                for axis in range(3):
                    column_hits.normal[next_place, axis] = column_hits.normal[hit, axis]
                column_hits.geom[next_place] = column_hits.geom[hit]
                column_hits.closed[next_place] = column_hits.closed[hit]
            next_place += 1
    return next_place


@subkernel(inline="always")
def allocate_ray():
    """Allocate a ray; its point and direction are to be set before it is cast."""
    return Ray(np.empty(3), np.zeros(3), np.zeros(3), np.empty(3), np.empty(3))


@subkernel(inline="always")
def _cast_tile_row(
    lattice,
    geometry,
    shape_index,
    is_crossed,
    tile_row,
    ray,
    middle_hits,
    hits,
    next_hit,
    is_writing,
):
    """Write where the vertical lines through the cells of a row of tiles cross all shapes.

    Args:
        lattice: the cells, as `Lattice`.
        geometry: the shapes, as `Geometry`.
        shape_index: the shapes over each row of tiles.
        is_crossed: see `cast_lines`; written while counting, read while writing, bool.
        tile_row: number of the row of tiles.
        ray: a `Ray` to cast.
        middle_hits: room for the hits of one line, as `LineHits`.
        hits: `LineHits` of the lines, which are written.
        next_hit: for each line, where its next hit goes in `hits`, int64; advanced by 1 for each
            hit.
        is_writing: whether to write hits; else they are only counted.
    """
    solids = geometry.solids
    facets = geometry.facets
    planes = geometry.planes
    height_range = geometry.height_range
    rows = (tile_row * TILE, min((tile_row + 1) * TILE, lattice.height))
    for plane in range(planes.geom.shape[0]):
        _cast_plane(
            planes, plane, lattice, rows, height_range, ray, middle_hits, hits, next_hit, is_writing
        )
    for entry in range(shape_index.solid_start[tile_row], shape_index.solid_start[tile_row + 1]):
        solid = shape_index.solid_indices[entry]
        _cast_solid(solids, solid, lattice, rows, ray, middle_hits, hits, next_hit, is_writing)
    first_entry = shape_index.triangle_start[tile_row]
    end_entry = shape_index.triangle_start[tile_row + 1]
    triangles = shape_index.triangle_indices[first_entry:end_entry]
    raster_triangles(
        facets,
        triangles,
        is_crossed[first_entry:end_entry],
        lattice,
        rows,
        allocate_triangle(),
        hits,
        next_hit,
        is_writing,
    )


@subkernel(inline="always")
def _project_triangle(axes, axis, facets, triangle):
    """Return the coordinates of a triangle's three corners along an axis of a frame [m]."""
    x = axes[axis, 0]
    y = axes[axis, 1]
    z = axes[axis, 2]
    vertices = facets.vertices
    a = facets.faces[triangle, 0]
    b = facets.faces[triangle, 1]
    c = facets.faces[triangle, 2]
    return (
        x * vertices[a, 0] + y * vertices[a, 1] + z * vertices[a, 2],
        x * vertices[b, 0] + y * vertices[b, 1] + z * vertices[b, 2],
        x * vertices[c, 0] + y * vertices[c, 1] + z * vertices[c, 2],
    )


@subkernel(inline="always")
def _box_of_points(points):
    """Return the box around points: least x, least y, greatest x, greatest y [m]."""
    x_low = points[0, 0]
    y_low = points[0, 1]
    x_high = x_low
    y_high = y_low
    for line in range(1, points.shape[0]):
        x_low = min(x_low, points[line, 0])
        y_low = min(y_low, points[line, 1])
        x_high = max(x_high, points[line, 0])
        y_high = max(y_high, points[line, 1])
    return x_low, y_low, x_high, y_high


@subkernel(inline="always")
def _project_near_box(facets, triangle, box, axes, local_corners):
    """Compute a triangle's corners in a frame, if vertical lines of a box there may cross it.

    Args:
        facets: the triangles, as `Facets`.
        triangle: index of the triangle.
        box: least x, least y, greatest x and greatest y of the lines in the frame [m].
        axes: the axes of the frame, one in each row, (3, 3).
        local_corners: receives the triangle's corners in the frame, (3, 3) [m].

    Returns:
        Whether any of the lines may cross the triangle; then the box of the points at most
        RIM_WIDTH from it: least x, least y, greatest x and greatest y [m].
    """
    x0, x1, x2 = _project_triangle(axes, X, facets, triangle)
    x_low = min(x0, x1, x2) - RIM_WIDTH
    x_high = max(x0, x1, x2) + RIM_WIDTH
    if box[2] < x_low or box[0] > x_high:  # true for most triangles
        return False, x_low, 0.0, x_high, 0.0
    y0, y1, y2 = _project_triangle(axes, Y, facets, triangle)
    y_low = min(y0, y1, y2) - RIM_WIDTH
    y_high = max(y0, y1, y2) + RIM_WIDTH
    if box[3] < y_low or box[1] > y_high:
        return False, x_low, y_low, x_high, y_high
    z0, z1, z2 = _project_triangle(axes, Z, facets, triangle)
    local_corners[0, X] = x0
    local_corners[1, X] = x1
    local_corners[2, X] = x2
    local_corners[0, Y] = y0
    local_corners[1, Y] = y1
    local_corners[2, Y] = y2
    local_corners[0, Z] = z0
    local_corners[1, Z] = z1
    local_corners[2, Z] = z2
    normal_z = unit_normal(local_corners[0], local_corners[1], local_corners[2])[2]
    return normal_z != 0.0, x_low, y_low, x_high, y_high


@subkernel(**NO_REFCOUNT)
def _cast_at_triangles(
    facets,
    triangles,
    lines,
    local_corners,
    hits,
    next_hit,
    is_writing,
):
    """Write where lines cross triangles.

    Most triangles are near none of the lines, so each is compared with the box around all lines
    before it is compared with each line.

    Args:
        facets: the triangles, as `Facets`.
        triangles: indices into `facets` of those to cross.
        lines: the lines, as `Lines`.
        local_corners: room for a triangle's corners, (3, 3).
        hits: `LineHits` to write into.
        next_hit: for each line, where its next hit goes in `hits`, int64; advanced by 1 for each
            hit.
        is_writing: whether to write hits; else they are only counted.
    """
    points = lines.points
    is_rotated = lines.axes[0, 0] != 1.0 or lines.axes[2, 2] != 1.0
    box = _box_of_points(points)
    for entry in range(triangles.shape[0]):
        triangle = triangles[entry]
        is_near, x_low, y_low, x_high, y_high = _project_near_box(
            facets, triangle, box, lines.axes, local_corners
        )
        if not is_near:
            continue
        edge_limits = find_edge_limits(local_corners)
        for line in range(points.shape[0]):
            x = points[line, 0]
            y = points[line, 1]
            if x < x_low or x > x_high or y < y_low or y > y_high:
                continue
            hit_index = next_hit[line]
            num_hits = hit_triangle(
                local_corners, facets, triangle, x, y, edge_limits, hits, hit_index, is_writing
            )
            if num_hits > 0 and is_writing and is_rotated:
                # a triangle over two of the lines' tiles is hit twice, so such hits cannot say
                # what is inside
                hits.closed[hit_index] = OPEN_SURFACE
            next_hit[line] += num_hits


@subkernel(**NO_REFCOUNT)
def _cast_at_points(
    lattice,
    geometry,
    tile_index,
    lines,
    ray,
    local_corners,
    hits,
    next_hit,
    is_writing,
):
    """Write where lines through points cross all shapes. The lines have the same tiles.

    Args:
        lattice: the cells, as `Lattice`.
        geometry: the shapes, as `Geometry`.
        tile_index: the shapes over each tile.
        lines: the lines, as `Lines`.
        ray: a `Ray` to cast.
        local_corners: room for a triangle's corners, (3, 3).
        hits: `LineHits` to write into.
        next_hit: for each line, where its next hit goes in `hits`, int64; advanced by 1 for each
            hit.
        is_writing: whether to write hits; else they are only counted.
    """
    solids = geometry.solids
    planes = geometry.planes
    height_range = geometry.height_range
    points = lines.points
    tiles_per_row = -(-lattice.width // TILE)
    first_tile_row = lines.tiles[0, 0] // tiles_per_row
    second_tile_row = lines.tiles[0, 1] // tiles_per_row
    first_tile_col = lines.tiles[0, 0] % tiles_per_row
    second_tile_col = lines.tiles[0, 1] % tiles_per_row
    for plane in range(planes.geom.shape[0]):
        for line in range(points.shape[0]):
            x = points[line, 0]
            y = points[line, 1]
            hit_index = next_hit[line] if is_writing else 0
            next_hit[line] += hit_plane(planes, plane, x, y, height_range, ray, hits, hit_index)
    for row in range(
        min(first_tile_row, second_tile_row), max(first_tile_row, second_tile_row) + 1
    ):
        for col in range(
            min(first_tile_col, second_tile_col), max(first_tile_col, second_tile_col) + 1
        ):
            tile = row * tiles_per_row + col
            for entry in range(tile_index.solid_start[tile], tile_index.solid_start[tile + 1]):
                solid = tile_index.solid_indices[entry]
                for line in range(points.shape[0]):
                    x = points[line, 0]
                    y = points[line, 1]
                    if is_beside(solids.bounds, solid, x, y):
                        continue
                    hit_index = next_hit[line] if is_writing else 0
                    next_hit[line] += hit_solid(solids, solid, x, y, ray, hits, hit_index)
            first_entry = tile_index.triangle_start[tile]
            end_entry = tile_index.triangle_start[tile + 1]
            _cast_at_triangles(
                geometry.facets,
                tile_index.triangle_indices[first_entry:end_entry],
                lines,
                local_corners,
                hits,
                next_hit,
                is_writing,
            )


@subkernel(inline="always")
def _end_of_same_tiles(tiles, first_line, end_line):
    """Return the index past the last line of those that have the same tiles as the first one.

    `tiles` is as in `Lines`; these lines follow each other from `first_line` on, before `end_line`.
    """
    line = first_line + 1
    while (
        line < end_line
        and tiles[line, 0] == tiles[first_line, 0]
        and tiles[line, 1] == tiles[first_line, 1]
    ):
        line += 1
    return line


@kernel(nogil=True)
def cast_lines(
    lattice,
    lines,
    geometry,
    shape_index,
    is_crossed,
    column_hits,
    num_dropped,
    first_group,
    end_group,
):
    """Find where vertical lines cross all shapes, and write the hits, or count them.

    This is done for the groups of lines ``range(first_group, end_group)``. It is called twice:
    first with empty arrays for the hits, to count them, then with room for as many.

    A line through an edge that triangles share hits all of these triangles. Hits that would count
    the same crossing again are dropped, so that the hits of these groups end earlier than those of
    the next groups begin; the caller closes these gaps.

    Args:
        lattice: the cells, as `Lattice`.
        lines: lines through points, as `Lines`; LINES_PER_CALL of them are a group. If it has no
            lines, those through the centres of all cells of the lattice are cast; the lines of a
            row of tiles are a group.
        geometry: the shapes, as `Geometry`.
        shape_index: the shapes by tile for lines through points, else by row of tiles.
        is_crossed: for each entry of `shape_index.triangle_indices`, whether any line of its row of
            tiles crosses the triangle, bool; written while counting, read while writing. Unused for
            lines through points.
        column_hits: `ColumnHits`. While counting, all arrays but `start` are empty, and entry i + 1
            of `start` receives the number of hits of line i. While writing, `start` has the running
            sums of these numbers, and the other arrays receive the hits of the groups, line after
            line, from ``start[i]`` of their first line on.
        num_dropped: zeros, as long as `start`; while writing, entry i + 1 receives how many hits of
            line i were dropped, int32.
        first_group: number of the first group.
        end_group: number past the last one.

    Returns:
        While writing, the index after the last hit of these groups; else 0.
    """
    start = column_hits.start
    is_writing = column_hits.z.shape[0] > 0
    ray = allocate_ray()
    middle_hits = allocate_hits(2)
    local_corners = np.empty((3, 3))
    num_lines = lines.points.shape[0]
    lines_per_group = LINES_PER_CALL
    has_points = lines.points.shape[0] > 0
    if not has_points:
        num_lines = lattice.height * lattice.width
        lines_per_group = TILE * lattice.width
    next_place = start[first_group * lines_per_group] if is_writing else np.int64(0)
    for group in range(first_group, end_group):
        first_line = group * lines_per_group
        end_line = min((group + 1) * lines_per_group, num_lines)
        next_hit = np.zeros(end_line - first_line, np.int64)  # of each line's next hit
        hits = middle_hits
        if is_writing:
            hits = view_hits(column_hits, start[first_line], start[end_line])
            for line in range(end_line - first_line):
                next_hit[line] = start[first_line + line] - start[first_line]
        if has_points:
            line = first_line
            while line < end_line:
                end_same_tiles = _end_of_same_tiles(lines.tiles, line, end_line)
                lines_of_tiles = Lines(
                    lines.points[line:end_same_tiles], lines.tiles[line:end_same_tiles], lines.axes
                )
                _cast_at_points(
                    lattice,
                    geometry,
                    shape_index,
                    lines_of_tiles,
                    ray,
                    local_corners,
                    hits,
                    next_hit[line - first_line : end_same_tiles - first_line],
                    is_writing,
                )
                line = end_same_tiles
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
                next_hit,
                is_writing,
            )
        if is_writing:
            next_place = _finish_lines(
                hits,
                start[first_line:end_line],
                next_hit,
                geometry.facets,
                middle_hits,
                column_hits,
                next_place,
                num_dropped[first_line + 1 : end_line + 1],
            )
            continue
        for line in range(end_line - first_line):
            start[first_line + line + 1] = next_hit[line]
    return next_place
