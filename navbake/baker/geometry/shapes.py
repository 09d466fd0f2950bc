"""The geometry of the geoms that count, as arrays in the world frame, for rays and overlaps.

Primitives are solids, infinite planes are half-spaces, and all other geoms are triangles.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.arrays import Facets, Planes, Solids
from navbake.baker.core.constants import BOX, CAPSULE, CYLINDER, ELLIPSOID, SOLID
from navbake.baker.geometry.triangle_kernels import measure_areas, measure_boxes
from navbake.lazy import lazy
from navbake.threads import num_threads, run_in_chunks
from navbake.types import Bool, Float, Int, Int32

spatial = lazy("scipy.spatial")

# Half-size that stands for the infinite side of a plane whose other side is finite; heights on a
# tilted one are off by about 1e-16 ENDLESS_HALF_SIZE^2 [m]
ENDLESS_HALF_SIZE = 1e4
# The points or triangles of a mesh are divided into chunks, ranges for one thread each, of at least
# this many; fewer are not worth a call on another thread
MIN_ITEMS_PER_CHUNK = 4096
# A mesh is divided into at most this many chunks, as each needs arrays of its own
MAX_CHUNKS = 8
# Meshes of at most this many vertices are measured together: a call for each takes longer
MAX_JOINED_POINTS = 1000
NUM_SIDES = 32  # of round solids that are made of triangles
# The box around many points is measured in rows of this many points
POINTS_PER_WIDE_ROW = 256
# Triangles of about this many are expanded at a time
TRIANGLES_PER_BATCH = 1 << 20
# The boxes around this many triangles are measured at a time, so that the CPU's cache holds them
TRIANGLES_PER_BOX_BATCH = 1 << 13
# Height fields are cut into pieces of about this many triangles, so that only those near some rows
# of cells need to be expanded
TRIANGLES_PER_PIECE = 1 << 16


class GeomTriangles(NamedTuple):
    """The triangles of a mesh, a hull or a finite plane, or of a piece of a height field.

    Attributes:
        vertices: (n, 3) float64 [m].
        faces: vertices of each triangle, counter-clockwise from the front, (m, 3) int32.
        part: the closed part of the mesh that each triangle belongs to, from 1, (m,) int32; 0 for
            those that enclose nothing, and for all geoms but meshes.
        closed: OPEN_SURFACE, which encloses nothing; or CLOSED_SURFACE, SOLID (height fields) or
            CONVEX_SOLID (hulls), whose inside counts as occupied; (m,) uint8.
        description: the kind of the triangles in words, for `GeomReport.shape`.
    """

    vertices: Float
    faces: Int32
    part: Int32
    closed: NDArray[np.uint8]
    description: str


class Mesh(NamedTuple):
    """A mesh of triangles.

    Attributes:
        vertices: (n, 3) float64 [m].
        faces: vertices of each triangle, counter-clockwise from outside, (m, 3) int32.
    """

    vertices: Float
    faces: Int32


@dataclass(frozen=True, eq=False)
class Meshes:
    """The geoms that are made of triangles.

    Each entry is a geom, or a piece of a height field; all pieces of a geom follow each other.
    Geoms of one mesh share all arrays but the vertices.

    Attributes:
        geom: MuJoCo's geom id of each entry, ascending, (n,) int32.
        triangles: the triangles of each entry, in the world frame.
        boxes: exact boxes around the entries, (n, 6) float64: lower corner, upper corner [m].
    """

    geom: Int32
    triangles: Sequence[GeomTriangles]
    boxes: Float

    @property
    def num_triangles(self) -> Int:
        """Return the number of triangles of each entry, shape (n,)."""
        return np.array([len(mesh.faces) for mesh in self.triangles], dtype=np.int64)

    @cached_property
    def expanded_facets(self) -> Facets:
        """Return all triangles; they are expanded once and kept."""
        return self.expand()

    def only(self, is_selected: Bool) -> Meshes:
        """Return the entries that a mask of shape (n,) marks."""
        if is_selected.all():
            return self
        triangles = [self.triangles[n] for n in np.flatnonzero(is_selected).tolist()]
        return Meshes(self.geom[is_selected], triangles, self.boxes[is_selected])

    def expand(self) -> Facets:
        """Return all triangles of all geoms, ordered by geom; one entry alone isn't copied."""
        num_triangles = self.num_triangles
        geom = np.repeat(self.geom, num_triangles)
        if len(self.triangles) == 1:
            mesh = self.triangles[0]
            return Facets(mesh.vertices, mesh.faces, geom, mesh.part, mesh.closed)
        first_vertices = np.cumsum([0, *(len(mesh.vertices) for mesh in self.triangles)]).tolist()
        first_triangles = np.cumsum([0, *num_triangles]).tolist()
        vertices = np.empty((first_vertices[-1], 3))
        faces = np.empty((first_triangles[-1], 3), dtype=np.int32)
        part = np.empty(first_triangles[-1], dtype=np.int32)
        closed = np.empty(first_triangles[-1], dtype=np.uint8)

        def copy_meshes(first_mesh: int, end_mesh: int) -> None:
            for number in range(first_mesh, end_mesh):
                mesh = self.triangles[number]
                vertices[first_vertices[number] : first_vertices[number + 1]] = mesh.vertices
                mesh_slice = slice(first_triangles[number], first_triangles[number + 1])
                np.add(mesh.faces, first_vertices[number], out=faces[mesh_slice])
                part[mesh_slice] = mesh.part
                closed[mesh_slice] = mesh.closed

        run_in_chunks(copy_meshes, len(self.triangles))
        return Facets(vertices, faces, geom, part, closed)


Primitives = TypeVar("Primitives", Solids, Planes)


@dataclass(frozen=True)
class Shapes:
    """The geometry of all geoms that count.

    Attributes:
        solids: the primitives.
        planes: the planes that are infinite along both sides.
        meshes: the geoms that are made of triangles.
        is_endless: marks the planes with one infinite side, shape (ngeom,), bool. They are made of
            triangles that extend ENDLESS_HALF_SIZE along that side, and don't count for `bounds`.
    """

    solids: Solids
    planes: Planes
    meshes: Meshes
    is_endless: Bool

    @cached_property
    def bounds(self) -> Float | None:
        """Return the box around all finite geoms, shape (2, 3) [m]; None if there are none."""
        finite_boxes = self.meshes.boxes[~self.is_endless[self.meshes.geom]]
        boxes = np.concatenate([self.solids.bounds, finite_boxes])
        lower_corners = boxes[:, :3]
        upper_corners = boxes[:, 3:]
        if not len(boxes):
            return None
        return np.stack([lower_corners.min(axis=0), upper_corners.max(axis=0)])

    @cached_property
    def boxes(self) -> Float:
        """Boxes around the geoms: lower, upper corner, shape (n, 6) [m]; infinite for planes.

        A large height field has several boxes, one around each of its pieces.
        """
        plane_boxes = np.full((len(self.planes.geom), 6), np.inf)
        plane_boxes[:, :3] = -np.inf
        return np.concatenate([self.solids.bounds, self.meshes.boxes, plane_boxes])

    @cached_property
    def geom_of_box(self) -> Int32:
        """Return the geom id of each box in `boxes`, shape (n,)."""
        return np.concatenate([self.solids.geom, self.meshes.geom, self.planes.geom])

    @cached_property
    def height_fields(self) -> Int32:
        """Return the ids of the geoms that are height fields, shape (n,)."""
        is_height_field = [bool((mesh.closed[:1] == SOLID).any()) for mesh in self.meshes.triangles]
        return np.unique(self.meshes.geom[np.array(is_height_field, dtype=np.bool_)])

    @property
    def triangles(self) -> Facets:
        """Return all triangles."""
        return self.meshes.expanded_facets

    def forget_triangles(self) -> None:
        """Free the memory of the expanded triangles; `triangles` expands them again."""
        self.meshes.__dict__.pop("expanded_facets", None)

    def facets_in_batches(self) -> Iterator[Facets]:
        """Yield all triangles in batches of about `TRIANGLES_PER_BATCH`, which saves memory.

        A mesh is never divided. If there are no more triangles than that, or if all are in memory
        already, they are yielded as one batch, and stay in memory.
        """
        if (
            "expanded_facets" in self.meshes.__dict__
            or self.meshes.num_triangles.sum() <= TRIANGLES_PER_BATCH
        ):
            yield self.triangles
            return
        batch_of_mesh = np.cumsum(self.meshes.num_triangles) // TRIANGLES_PER_BATCH
        for batch in np.unique(batch_of_mesh).tolist():
            yield self.meshes.only(batch_of_mesh == batch).expand()

    def only(self, is_selected: Bool) -> Shapes:
        """Return the geometry of the geoms that are marked.

        Args:
            is_selected: mask by geom id, shape (ngeom,).
        """
        if is_selected.all():
            return self

        def select_primitives(primitives: Primitives) -> Primitives:
            is_selected_primitive = is_selected[primitives.geom]
            if is_selected_primitive.all():
                return primitives
            return type(primitives)._make(array[is_selected_primitive] for array in primitives)

        meshes = self.meshes.only(is_selected[self.meshes.geom])
        return Shapes(
            select_primitives(self.solids),
            select_primitives(self.planes),
            meshes,
            self.is_endless & is_selected,
        )

    def with_replaced(self, new_shapes: Shapes, is_replaced: Bool) -> Shapes:
        """Return the shapes, with the geometry of the marked geoms replaced.

        Args:
            new_shapes: the new geometry of the marked geoms; a solid stays a solid, a plane a
                plane.
            is_replaced: mask by geom id, shape (ngeom,).
        """

        def replace_primitives(
            old_primitives: Primitives, new_primitives: Primitives
        ) -> Primitives:
            indices = np.flatnonzero(is_replaced[old_primitives.geom])
            if not len(indices):
                return old_primitives
            arrays: list[NDArray[Any]] = [array.copy() for array in old_primitives]
            for array, values in zip(arrays, new_primitives, strict=True):
                array[indices] = values
            return type(old_primitives)._make(arrays)

        meshes = self.meshes
        indices = np.flatnonzero(is_replaced[meshes.geom])
        if len(indices):
            triangles = list(meshes.triangles)
            for n, new_triangles in zip(indices.tolist(), new_shapes.meshes.triangles, strict=True):
                triangles[n] = new_triangles
            boxes = meshes.boxes.copy()
            boxes[indices] = new_shapes.meshes.boxes
            meshes = Meshes(meshes.geom, triangles, boxes)
        solids = replace_primitives(self.solids, new_shapes.solids)
        planes = replace_primitives(self.planes, new_shapes.planes)
        return Shapes(solids, planes, meshes, self.is_endless)

    def solids_in_frame(self, axes: Float) -> Shapes:
        """Return the solids (and neither planes nor meshes) in a rotated frame.

        Args:
            axes: axes of the frame, as its rows, shape (3, 3).
        """
        solids = self.solids
        pos = solids.pos @ axes.T
        mat = np.ascontiguousarray((axes @ solids.mat.reshape(-1, 3, 3)).reshape(-1, 9))
        rotated_solids = solids._replace(
            pos=pos, mat=mat, bounds=solid_bounds(solids.kind, pos, mat, solids.size)
        )
        empty_planes = Planes._make(array[:0] for array in self.planes)
        empty_meshes = self.meshes.only(np.zeros(len(self.meshes.geom), dtype=np.bool_))
        return Shapes(rotated_solids, empty_planes, empty_meshes, self.is_endless)


def boxes_in_batches(
    facets: Facets, first_triangle: int, end_triangle: int
) -> Iterator[tuple[slice, Float]]:
    """Measure the boxes around triangles, batch by batch: they are needed often, but not for long.

    Args:
        facets: the triangles.
        first_triangle: index of the first triangle.
        end_triangle: index past the last one.

    Yields:
        The indices of a batch of triangles, in order; and the boxes around them: lower corner,
        upper corner, shape (k, 6) [m]. The next batch overwrites them.
    """
    boxes = np.empty((min(TRIANGLES_PER_BOX_BATCH, end_triangle - first_triangle), 6))
    for first_in_batch in range(first_triangle, end_triangle, TRIANGLES_PER_BOX_BATCH):
        end_of_batch = min(first_in_batch + TRIANGLES_PER_BOX_BATCH, end_triangle)
        batch = slice(first_in_batch, end_of_batch)
        measure_boxes(facets.vertices, facets.faces[batch], boxes)
        yield batch, boxes[: end_of_batch - first_in_batch]


def gather_meshes(triangles_of_geoms: Iterable[tuple[int, GeomTriangles]]) -> Meshes:
    """Gather the geoms that have triangles, and compute their boxes.

    Args:
        triangles_of_geoms: geom ids, ascending, each with the triangles of the geom, or of a piece
            of it.
    """
    non_empty_meshes = [(geom, mesh) for geom, mesh in triangles_of_geoms if len(mesh.faces)]
    geom_ids = [geom for geom, _ in non_empty_meshes]
    meshes = [mesh for _, mesh in non_empty_meshes]
    # by the id() of the faces, which geoms of one mesh share; None if all vertices are used
    used_mask_by_faces_id = dict[int, Bool | None]()
    boxes = np.empty((len(meshes), 6))
    small_mesh_numbers = list[int]()
    vertices_of_small_meshes = list[Float]()
    for number, mesh in enumerate(meshes):
        if id(mesh.faces) not in used_mask_by_faces_id:
            is_used = mark_used_vertices(len(mesh.vertices), mesh.faces)
            used_mask_by_faces_id[id(mesh.faces)] = None if is_used.all() else is_used
        used_mask = used_mask_by_faces_id[id(mesh.faces)]
        vertices = mesh.vertices if used_mask is None else mesh.vertices[used_mask]
        if len(vertices) > MAX_JOINED_POINTS:
            boxes[number] = bounding_box(vertices)
        else:
            small_mesh_numbers.append(number)
            vertices_of_small_meshes.append(vertices)
    if small_mesh_numbers:
        boxes[small_mesh_numbers] = _measure_small_boxes(vertices_of_small_meshes)
    return Meshes(np.array(geom_ids, dtype=np.int32), meshes, boxes)


def _measure_small_boxes(point_sets: list[Float]) -> Float:
    """Measure the boxes around several small sets of points, all sets at once.

    Args:
        point_sets: at least one set, each of at least one point, shape (n, 3) [m].

    Returns:
        Lower corner, upper corner of each box, shape (sets, 6) [m].
    """
    num_points = np.array([len(points) for points in point_sets])
    first_point_of_set = np.cumsum(num_points) - num_points
    points = np.concatenate(point_sets)
    lower_corners = np.minimum.reduceat(points, first_point_of_set)
    upper_corners = np.maximum.reduceat(points, first_point_of_set)
    return np.hstack([lower_corners, upper_corners])


def solid_bounds(kind: Int32, pos: Float, mat: Float, size: Float) -> Float:
    """Compute exact boxes around solids.

    Args:
        kind, pos, mat, size: fields of `Solids`.

    Returns:
        Lower corner, upper corner, shape (n, 6) [m].
    """
    axes = mat.reshape(-1, 3)  # x, y and z of the world in the frame of each solid
    half_sides = support_distances(kind.repeat(3), axes, size.repeat(3, axis=0)).reshape(-1, 3)
    return np.concatenate([pos - half_sides, pos + half_sides], axis=1)


def support_distances(kind: Int32, direction: Float, size: Float) -> Float:
    """Compute how far solids extend from their centres in a direction: their support functions.

    Args:
        kind: the kind of each solid, as in `Solids`, shape (n,).
        direction: a unit vector in the frame of each solid, shape (n, 3).
        size: the size of each solid, as in `Solids`, shape (n, 3).

    Returns:
        Distances, shape (n,) [m].
    """
    absolute_direction = np.abs(direction)
    distances = np.empty(len(kind))
    kinds = set(kind.tolist())
    for solid_kind in kinds:
        is_of_kind = kind == solid_kind if len(kinds) > 1 else slice(None)
        absolute_z = absolute_direction[is_of_kind, 2]
        sizes = size[is_of_kind]
        if solid_kind == BOX:
            distances[is_of_kind] = (absolute_direction[is_of_kind] * sizes).sum(axis=1)
        elif solid_kind == ELLIPSOID:
            distances[is_of_kind] = np.sqrt(
                np.square(absolute_direction[is_of_kind] * sizes).sum(axis=1)
            )
        elif solid_kind == CYLINDER:
            horizontal_length = np.sqrt(np.clip(1.0 - np.square(absolute_z), 0.0, None))
            distances[is_of_kind] = absolute_z * sizes[:, 1] + sizes[:, 0] * horizontal_length
        elif solid_kind == CAPSULE:
            distances[is_of_kind] = sizes[:, 0] + absolute_z * sizes[:, 1]
        else:
            distances[is_of_kind] = sizes[:, 0]
    return distances


def make_height_field_pieces(heights: Float, size: Float) -> Iterator[Mesh]:
    """Make a closed mesh of a height field, piece by piece.

    The first pieces are the top, some rows at a time; the last piece is the four sides and the
    bottom. Each cell of the top is split into two triangles, along the same diagonal as by MuJoCo's
    rays and collisions.

    Args:
        heights: 0 to 1, shape (rows, cols), row 0 at the smallest y.
        size: MuJoCo's size of the height field, shape (4,) [m].

    Yields:
        The pieces, in the geom's frame. Pieces of equally many rows share their faces.
    """
    rows, cols = heights.shape
    x = np.linspace(-size[0], size[0], cols)
    y = np.linspace(-size[1], size[1], rows)
    rows_per_piece = max(1, TRIANGLES_PER_PIECE // (2 * (cols - 1)))
    faces = grid_faces(min(rows_per_piece, rows - 1), cols)
    for first_row in range(0, rows - 1, rows_per_piece):
        end_row = min(first_row + rows_per_piece, rows - 1)
        num_faces = 2 * (end_row - first_row) * (cols - 1)
        yield Mesh(
            vertices=_surface_points(
                x, y[first_row : end_row + 1], heights[first_row : end_row + 1] * size[2]
            ),
            faces=faces if num_faces == len(faces) else faces[:num_faces],
        )
    yield _make_height_field_sides(x, y, heights, size)


def grid_faces(num_quad_rows: int, vertices_per_row: int) -> Int32:
    """Divide each quad of a grid of vertices into two triangles, counter-clockwise from above.

    Args:
        num_quad_rows: number of rows of quads.
        vertices_per_row: number of vertices in a row.

    Returns:
        Vertices of each triangle, shape (2 rows (columns - 1), 3), row by row.
    """
    lower_left = np.arange(num_quad_rows)[:, None] * vertices_per_row + np.arange(
        vertices_per_row - 1
    )
    lower_right = lower_left + 1
    upper_left = lower_left + vertices_per_row
    upper_right = upper_left + 1
    lower_triangles = np.stack([lower_left, lower_right, upper_right], axis=-1)
    upper_triangles = np.stack([lower_left, upper_right, upper_left], axis=-1)
    return np.stack([lower_triangles, upper_triangles], axis=2).reshape(-1, 3).astype(np.int32)


def _surface_points(x: Float, y: Float, z: Float) -> Float:
    """Return the points (x[j], y[i], z[i, j]), row by row, shape (rows * columns, 3)."""
    points = np.empty((*z.shape, 3))
    points[..., 0] = x
    points[..., 1] = y[:, None]
    points[..., 2] = z
    return points.reshape(-1, 3)


def _make_height_field_sides(x: Float, y: Float, heights: Float, size: Float) -> Mesh:
    """Make the four sides and the bottom of a height field.

    The bottom is a fan over the border's points, so that two triangles meet at every edge.

    Args:
        x: of the columns, shape (cols,) [m].
        y: of the rows, shape (rows,) [m].
        heights: 0 to 1, shape (rows, cols).
        size: MuJoCo's size of the height field, shape (4,) [m].
    """
    rows = np.arange(len(y))
    columns = np.arange(len(x))
    # the border's points, counter-clockwise from the corner of the smallest x and y: rows and
    # columns of the south, east, north and west side, each without its last point
    border = [
        (np.zeros_like(columns[:-1]), columns[:-1]),
        (rows[:-1], np.full_like(rows[:-1], columns[-1])),
        (np.full_like(columns[:-1], rows[-1]), columns[:0:-1]),
        (rows[:0:-1], np.zeros_like(rows[:-1])),
    ]
    border_rows = np.concatenate([side_rows for side_rows, _ in border])
    border_columns = np.concatenate([side_columns for _, side_columns in border])
    upper_points = np.stack(
        [x[border_columns], y[border_rows], heights[border_rows, border_columns] * size[2]], axis=1
    )
    lower_points = upper_points.copy()
    lower_points[:, 2] = -size[3]
    bottom_middle = np.array([(x[0] + x[-1]) / 2, (y[0] + y[-1]) / 2, -size[3]])
    num_points = len(upper_points)
    top_id = np.arange(num_points)
    next_top_id = np.roll(top_id, -1)
    bottom_id = top_id + num_points
    next_bottom_id = next_top_id + num_points
    middle_id = np.full(num_points, 2 * num_points)
    faces = [
        np.stack([bottom_id, next_bottom_id, next_top_id], axis=1),
        np.stack([bottom_id, next_top_id, top_id], axis=1),
        np.stack([middle_id, next_bottom_id, bottom_id], axis=1),
    ]
    vertices = np.concatenate([upper_points, lower_points, bottom_middle[None]])
    return Mesh(vertices, np.concatenate(faces).astype(np.int32))


def hull_faces(vertices: Float) -> Int32 | None:
    """Find the faces of the convex hull of points.

    Args:
        vertices: shape (n, 3) [m].

    Returns:
        Vertices of each triangle, counter-clockwise from outside, shape (m, 3); None if there are
        fewer than four points, or all lie in a plane.
    """
    try:
        hull = spatial.ConvexHull(vertices)
    except (spatial.QhullError, ValueError):  # flat, or fewer than four
        return None
    corners: Float = vertices[hull.simplices]
    cross_products = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Qhull's simplices turn either way round, but its equations point outward
    is_inward = np.einsum("ij,ij->i", cross_products, hull.equations[:, :3]) < 0
    faces: Int32 = hull.simplices.astype(np.int32)
    faces[is_inward] = faces[is_inward][:, ::-1]
    return faces


# ---------------------------------------------------------------- meshes as arrays


def choose_num_chunks(num_items: int) -> int:
    """Return into how many chunks points or triangles are divided, so that each thread gets one.

    Args:
        num_items: how many points or triangles there are.
    """
    return max(1, min(num_threads(), MAX_CHUNKS, num_items // MIN_ITEMS_PER_CHUNK))


def triangle_areas(vertices: Float, faces: Int32) -> Float:
    """Compute the areas of triangles.

    Args:
        vertices: shape (n, 3) [m].
        faces: vertices of each triangle, shape (m, 3).

    Returns:
        Areas, shape (m,) [m²].
    """
    area = np.empty(len(faces))
    run_in_chunks(
        measure_areas, len(faces), vertices, faces, area, min_chunk_size=MIN_ITEMS_PER_CHUNK
    )
    return area


def bounding_box(points: Float) -> Float:
    """Return the box around points; its coordinate is NaN where that coordinate of a point is.

    Args:
        points: shape (n, 3) [m].

    Returns:
        Lower corner, upper corner, shape (6,) [m].
    """
    # numpy takes several times as long along narrow rows as along wide ones
    num_in_wide_rows = len(points) // POINTS_PER_WIDE_ROW * POINTS_PER_WIDE_ROW
    wide_rows = np.ascontiguousarray(points[:num_in_wide_rows]).reshape(-1, 3 * POINTS_PER_WIDE_ROW)
    low_points = points[num_in_wide_rows:]
    high_points = low_points
    if len(wide_rows):
        low_points = np.concatenate([low_points, wide_rows.min(axis=0).reshape(-1, 3)])
        high_points = np.concatenate([high_points, wide_rows.max(axis=0).reshape(-1, 3)])
    return np.concatenate([low_points.min(axis=0), high_points.max(axis=0)])


def mark_used_vertices(num_vertices: int, faces: Int32) -> Bool:
    """Mark the vertices that faces use.

    Args:
        num_vertices: number of vertices.
        faces: vertices of each triangle, shape (m, 3).

    Returns:
        A mask, shape (num_vertices,), bool.
    """
    is_used_by_chunk = np.zeros((choose_num_chunks(len(faces)), num_vertices), dtype=np.bool_)

    def mark_chunks(first_chunk: int, end_chunk: int) -> None:
        for chunk in range(first_chunk, end_chunk):
            first_face = len(faces) * chunk // len(is_used_by_chunk)
            end_face = len(faces) * (chunk + 1) // len(is_used_by_chunk)
            is_used_by_chunk[chunk][faces[first_face:end_face]] = True

    run_in_chunks(mark_chunks, len(is_used_by_chunk))
    if len(is_used_by_chunk) == 1:
        return np.asarray(is_used_by_chunk[0])
    return np.asarray(is_used_by_chunk.any(axis=0))


def drop_unused_vertices(vertices: Float, faces: Int32) -> tuple[Float, Int32]:
    """Drop the vertices that no face uses.

    Args:
        vertices: shape (n, 3).
        faces: vertices of each triangle, shape (m, 3).

    Returns:
        The used vertices, and the faces as indices into these.
    """
    is_used = mark_used_vertices(len(vertices), faces)
    if is_used.all():
        return vertices, faces
    return vertices[is_used], (np.cumsum(is_used, dtype=np.int32) - 1)[faces]


# ---------------------------------------------------------------- triangles of solids and polygons


def tessellate(kind: str, size: Sequence[float]) -> Mesh:
    """Make a triangle mesh of a solid; round solids, and cones, have `NUM_SIDES` sides.

    Args:
        kind: "plane", "box", "sphere", "capsule", "ellipsoid", "cylinder" or "cone".
        size: MuJoCo's sizes [m]; a cone's are the radius of its base and half its height. Its tip
            points up.
    """
    if kind == "plane":
        corners = np.array([[x, y, 0.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
        triangles = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
        return Mesh(corners * (*size[:2], 1.0), triangles)
    if kind == "box":
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size
        hull = hull_faces(corners.astype(np.float64))
        assert hull is not None
        return Mesh(corners, hull)
    radius = size[0]
    half_height = size[1] if len(size) > 1 else 0.0
    lower_angles = np.linspace(-math.pi / 2, 0.0, NUM_SIDES // 4 + 1)
    if kind == "cylinder":
        profile = [
            (0.0, -half_height),
            (radius, -half_height),
            (radius, half_height),
            (0.0, half_height),
        ]
    elif kind == "cone":
        profile = [(0.0, -half_height), (radius, -half_height), (0.0, half_height)]
    else:
        cylinder_half_height = half_height if kind == "capsule" else 0.0
        lower_profile = [
            (radius * math.cos(lower_angle), radius * math.sin(lower_angle) - cylinder_half_height)
            for lower_angle in lower_angles.tolist()
        ]
        upper_profile = [(ring_radius, -z) for ring_radius, z in lower_profile[::-1]]
        # the two halves of a sphere share their ring in the middle
        profile = lower_profile + (
            upper_profile[1:] if cylinder_half_height == 0 else upper_profile
        )
    _, bottom_z = profile[0]
    _, top_z = profile[-1]
    ring_profile = profile[1:-1]
    angle = np.arange(NUM_SIDES) * (2 * math.pi / NUM_SIDES)
    circle_points = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = [
        np.column_stack([ring_radius * circle_points, np.full(NUM_SIDES, z)])
        for ring_radius, z in ring_profile
    ]
    vertices = np.concatenate([*rings, [[0.0, 0.0, bottom_z], [0.0, 0.0, top_z]]])
    side_index = np.arange(NUM_SIDES)
    next_side_index = (side_index + 1) % NUM_SIDES
    bottom_vertex = np.full(NUM_SIDES, len(vertices) - 2)
    top_vertex = np.full(NUM_SIDES, len(vertices) - 1)
    first_vertex_of_last_ring = (len(ring_profile) - 1) * NUM_SIDES
    faces = [np.column_stack([bottom_vertex, next_side_index, side_index])]
    for first_vertex in range(0, first_vertex_of_last_ring, NUM_SIDES):
        lower_vertex = first_vertex + side_index
        next_lower_vertex = first_vertex + next_side_index
        upper_vertex = lower_vertex + NUM_SIDES
        next_upper_vertex = next_lower_vertex + NUM_SIDES
        faces.append(np.column_stack([lower_vertex, next_lower_vertex, next_upper_vertex]))
        faces.append(np.column_stack([lower_vertex, next_upper_vertex, upper_vertex]))
    last_ring_vertex = first_vertex_of_last_ring + side_index
    next_last_ring_vertex = first_vertex_of_last_ring + next_side_index
    faces.append(np.column_stack([last_ring_vertex, next_last_ring_vertex, top_vertex]))
    if kind == "ellipsoid":
        vertices = vertices / radius * np.asarray(size)
    return Mesh(vertices, np.concatenate(faces).astype(np.int32))


def triangulate(
    vertices: Float, corner_counts: Int, corner_vertices: Int, excluded_polygons: Int
) -> Int32:
    """Divide polygons in space into triangles that face to the same side as the polygons.

    Convex polygons become fans; of others ears are cut off (Meisters, Polygons have ears, 1975).
    Polygons with fewer than three corners are left out.

    Args:
        vertices: shape (m, 3).
        corner_counts: number of corners of each polygon, (polygons,).
        corner_vertices: vertices of all corners, polygon by polygon, (sum of counts,).
        excluded_polygons: numbers of polygons that are left out; those out of range are ignored.

    Returns:
        Vertices of each triangle, shape (n, 3).
    """
    if not len(excluded_polygons) and (corner_counts == 3).all():
        return np.asarray(corner_vertices.reshape(-1, 3).astype(np.int32))
    start_of_polygon = np.cumsum(corner_counts) - corner_counts
    triangles = [np.empty((0, 3), dtype=np.int32)]
    is_polygon = corner_counts >= 3
    is_polygon[
        excluded_polygons[(excluded_polygons >= 0) & (excluded_polygons < len(corner_counts))]
    ] = False
    for num_corners in np.unique(corner_counts[is_polygon]).tolist():
        first_corner = start_of_polygon[is_polygon & (corner_counts == num_corners)]
        polygon_corners = corner_vertices[first_corner[:, None] + np.arange(num_corners)].astype(
            np.int32
        )
        if num_corners > 3:
            is_convex = _are_convex(vertices[polygon_corners])
            for polygon in polygon_corners[~is_convex]:
                triangles.append(_cut_ears(vertices[polygon], polygon))
            polygon_corners = polygon_corners[is_convex]
        for k in range(1, num_corners - 1):
            triangles.append(polygon_corners[:, [0, k, k + 1]])
    return np.concatenate(triangles)


def _are_convex(points: Float) -> Bool:
    """Mark the polygons that turn to one side at all corners; points have shape (n, k, 3)."""
    points = points - points[:, :1]
    edges = np.roll(points, -1, axis=1) - points
    turn_vectors = np.cross(edges, np.roll(edges, -1, axis=1))
    normals = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)  # Newell's
    turns_along_normal = np.einsum("nkc,nc->nk", turn_vectors, normals)
    return np.asarray(
        (turns_along_normal >= -1e-9 * np.abs(turns_along_normal).max(axis=1, keepdims=True)).all(
            axis=1
        )
    )


def _cut_ears(points: Float, corners: Int32) -> Int32:
    """Cut a simple polygon into triangles, ear by ear.

    Args:
        points: shape (k, 3).
        corners: ids of the points, (k,).

    Returns:
        Ids of the corners of each triangle, shape (k - 2, 3).
    """
    points = points - points[0]
    normal = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    # projected along the axis along which the polygon's area is largest
    dropped_axis = int(np.abs(normal).argmax())
    projected_points = np.delete(points, dropped_axis, axis=1)
    winding_sign = 1.0 if (normal[dropped_axis] > 0) == (dropped_axis != 1) else -1.0
    remaining_indices = list(range(len(points)))
    triangles = list[list[int]]()

    def double_area(a: Float, b: Float, c: Float) -> Float:
        """Compute twice the area of triangles, positive where they wind as the polygon does."""
        ab = b - a
        ac = c - a
        return np.asarray(winding_sign * (ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0]))

    def ear_at(k: int) -> list[int]:
        """Return the k-th remaining corner between its neighbors."""
        return [
            remaining_indices[k - 1],
            remaining_indices[k],
            remaining_indices[(k + 1) % len(remaining_indices)],
        ]

    while len(remaining_indices) > 3:
        for k in range(len(remaining_indices)):
            ear = ear_at(k)
            a, b, c = projected_points[ear]
            remaining_corners = projected_points[
                [index for index in remaining_indices if index not in ear]
            ]
            # a slit in the polygon has two corners at one place: those at the ear's don't count
            is_slit = (remaining_corners[:, None] == [a, b, c]).all(axis=2).any(axis=1)
            other_corners = remaining_corners[~is_slit]
            side_areas = [
                double_area(a, b, other_corners),
                double_area(b, c, other_corners),
                double_area(c, a, other_corners),
            ]
            holds_corner = (np.min(side_areas, axis=0) >= 0).any()
            if double_area(a, b, c) > 0 and not holds_corner:
                break
        else:  # corners on a line, or lines that cross: the flattest ear is cut off
            ears = [ear_at(k) for k in range(len(remaining_indices))]
            k = int(np.argmin([abs(double_area(*projected_points[ear])) for ear in ears]))
            ear = ears[k]
        triangles.append(ear)
        remaining_indices.pop(k)
    return np.asarray(corners[np.array([*triangles, remaining_indices])])
