"""The geoms of a scene that count, as shapes of FCL and MuJoCo, to compare a grid with.

The shapes come from the compiled MuJoCo model and the selection of geoms alone. A second MuJoCo
model holds them as the bake counts them: rays hit the hull of a mesh that counts by its hull, and
they hit transparent geoms like any geom.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from contextlib import suppress
from typing import NamedTuple

import fcl
import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import QhullError

from navbake.baker.scene.scene import Scene
from navbake.errors import SceneError
from navbake.lazy import lazy
from navbake.types import Float, Int, Json
from navbake.verifier.mesh_parts import (
    CAVITY,
    OPEN_SURFACE,
    SOLID,
    ClassifiedPart,
    split_mesh_parts,
)

trimesh = lazy("trimesh")

GEOM = mujoco.mjtGeom

# Kinds of shapes that are whole geoms; parts of meshes have the kinds of `mesh_parts`
CONVEX = "convex"  # a solid or a hull
HALF_SPACE = "half-space"  # an infinite plane, solid below
HEIGHT_FIELD = "height field"
# a column inside of shapes of these kinds may not touch their surface
ENCLOSING_KINDS = (HEIGHT_FIELD, SOLID, CAVITY)

MIN_GROUND_NORMAL_Z = np.sqrt(0.5)  # the least z of the normal of a plane that is ground
INFINITE_HALF_SIZE = 1e4  # stands for the infinite side of a plane whose other side is finite [m]
MIN_NORMAL_Z = 1e-9  # least |z| of the unit normal of a face that a vertical line can cross
SAME_DIRECTION_COSINE = 1 - 1e-12  # least cosine between directions that count as the same


class SolidGeometry(NamedTuple):
    """FCL's shape and the extents of one type of MuJoCo's solid geoms.

    Attributes:
        make_shape: Makes FCL's shape from the geom's size, (3,) [m].
        measure_extent: Returns how far the solid reaches from its centre in a direction [m]. It
            takes the geom's size, (3,) [m], and a unit vector in the geom's frame, (3,).
    """

    make_shape: Callable[[Float], fcl.CollisionGeometry]
    measure_extent: Callable[[Float, Float], float | np.floating]


SOLID_GEOMETRIES: dict[int, SolidGeometry] = {
    GEOM.mjGEOM_SPHERE: SolidGeometry(
        make_shape=lambda size: fcl.Sphere(size[0]),
        measure_extent=lambda size, direction: size[0],
    ),
    GEOM.mjGEOM_CAPSULE: SolidGeometry(
        make_shape=lambda size: fcl.Capsule(size[0], 2 * size[1]),
        measure_extent=lambda size, direction: size[0] + size[1] * abs(direction[2]),
    ),
    GEOM.mjGEOM_ELLIPSOID: SolidGeometry(
        make_shape=lambda size: fcl.Ellipsoid(*size),
        measure_extent=lambda size, direction: np.linalg.norm(size * direction),
    ),
    GEOM.mjGEOM_CYLINDER: SolidGeometry(
        make_shape=lambda size: fcl.Cylinder(size[0], 2 * size[1]),
        measure_extent=lambda size, direction: (
            size[0] * np.hypot(direction[0], direction[1]) + size[1] * abs(direction[2])
        ),
    ),
    GEOM.mjGEOM_BOX: SolidGeometry(
        make_shape=lambda size: fcl.Box(*(2 * size)),
        measure_extent=lambda size, direction: (size * np.abs(direction)).sum(),
    ),
}
"""MuJoCo's geom type -> how the solid geom is represented."""


class PlacedShape(NamedTuple):
    """A convex solid, plane, height field or part of a mesh, posed in the world.

    Attributes:
        geom: The id of the geom in the scene's model.
        kind: The kind of shape, such as `CONVEX`.
        collision_object: FCL's object, at its pose.
        low_corner: The lower corner of the bounding box, (3,) [m]; may be infinite.
        high_corner: The upper corner of the bounding box, (3,) [m]; may be infinite.
        hull_points: The corners of a hull, (n, 3) [m]; None for shapes that are no hulls.
    """

    geom: int
    kind: str
    collision_object: fcl.CollisionObject
    low_corner: Float
    high_corner: Float
    hull_points: Float | None

    @property
    def is_same_in_mujoco(self) -> bool:
        """Whether MuJoCo collides the same shape.

        In place of a surface, it collides a hull, an endless plane, or nothing.
        """
        return self.kind in (CONVEX, HALF_SPACE)


class GeomShape(NamedTuple):
    """A shape in the frame of its geom.

    Attributes:
        kind: The kind of shape, such as `CONVEX`.
        geometry: FCL's geometry.
        geom_attributes: The attributes of the MuJoCo geom that represents the shape.
        points: Corners, (n, 3) [m]; None for solids and half-spaces.
        triangles: The indices of each triangle's corners, (m, 3); None for shapes that are no mesh.
    """

    kind: str
    geometry: fcl.CollisionGeometry
    geom_attributes: Json
    points: Float | None = None
    triangles: Int | None = None


class MeshArrays(NamedTuple):
    """A mesh of a MuJoCo model, in the frame of its geom.

    Attributes:
        vertices: The positions of the vertices, (n, 3) [m].
        faces: The indices of each triangle's vertices, (m, 3).
        hull_vertices: The vertices of MuJoCo's convex hull, all vertices if it has none, (k, 3).
    """

    vertices: Float
    faces: Int
    hull_vertices: Float


class Obstacles:
    """The geoms of a scene that count, as shapes in one pose of the scene.

    Each obstacle is a geom of `model`, and has that geom's id. Each part of a mesh is an obstacle
    of its own. After the obstacles, the model has a box and a cylinder, which serve as probes, and
    then the geoms of `half_meshes`.

    Args:
        scene: The scene.
        data: The pose of the scene's model, with kinematics computed.
        excluded_geoms: The ids of geoms that count, but are left out.

    Attributes:
        shapes: The shape of each obstacle.
        geom_names: The name of each geom of the scene's model.
        half_meshes: Id of an obstacle that is a mesh -> ids of up to two geoms of `model`: its
            triangles that face up, and its triangles that face down. A ray meets only one of two
            triangles in the same place, so rays are cast at both geoms.
        model: The MuJoCo model of the obstacles.
        data: The pose of `model`.
        geom_sizes: A view of the sizes of the geoms of `model`.
        geom_positions: A view of the positions of the geoms of `model` [m].
        geom_rotations: A view of the rotations of the geoms of `model`, (n, 9).

    Raises:
        SceneError: MuJoCo cannot compile a model of the shapes.
    """

    def __init__(
        self, scene: Scene, data: mujoco.MjData, excluded_geoms: Collection[int] = ()
    ) -> None:
        self._scene = scene
        self._spec = mujoco.MjSpec()
        self.shapes: list[PlacedShape] = []
        self._field_heights: list[Float] = []
        self._shapes_of_mesh: dict[tuple[int, str], list[GeomShape]] = {}
        self._half_mesh_names: dict[tuple[int, bytes], list[str]] = {}
        self._half_mesh_attributes: dict[int, list[Json]] = {}
        for geom, geom_selection in enumerate(scene.selections):
            if not geom_selection.is_counted or geom in excluded_geoms:
                continue
            rotation = data.geom_xmat[geom].reshape(3, 3).copy()
            position = data.geom_xpos[geom]
            if geom in scene.exact_meshes:  # in the world's frame; MuJoCo holds float32
                rotation = np.eye(3)
                position = _find_middle(scene.exact_meshes[geom].vertices)
            for shape in self._shapes_of_geom(geom, geom_selection.mesh_mode):
                self._place_shape(geom, shape, rotation, position)
        self.geom_names = [geom_report.name for geom_report in scene.geoms]
        box_corners = np.array(
            [(shape.low_corner, shape.high_corner) for shape in self.shapes]
        ).reshape(-1, 2, 3)
        self._low, self._high = np.ascontiguousarray(box_corners.transpose(1, 2, 0))

        world_body = self._spec.worldbody
        world_body.add_geom(type=GEOM.mjGEOM_BOX, size=[0.1, 0.1, 0.1])
        world_body.add_geom(type=GEOM.mjGEOM_CYLINDER, size=[0.1, 0.1, 0.0])
        num_geoms = len(self.shapes) + 2
        self.half_meshes = dict[int, list[int]]()
        for obstacle, half_mesh_attributes in self._half_mesh_attributes.items():
            self.half_meshes[obstacle] = list(
                range(num_geoms, num_geoms + len(half_mesh_attributes))
            )
            num_geoms += len(half_mesh_attributes)
            for attributes in half_mesh_attributes:
                world_body.add_geom(**attributes)

        try:
            self.model = model = self._spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            error_text = " ".join(str(error).split())[:300]
            raise SceneError(f"MuJoCo can't hold the shapes that count: {error_text}") from error
        # the compiler scales heights to the range from 0 to 1
        for field_index, heights in enumerate(self._field_heights):
            first_height_index = int(model.hfield_adr[field_index])
            model.hfield_data[first_height_index : first_height_index + heights.size] = (
                heights.ravel()
            )
        self.data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, self.data)
        # each access to such an attribute makes a new view, which the probes would repeat
        self.geom_sizes = model.geom_size
        self.geom_positions = self.data.geom_xpos
        self.geom_rotations = self.data.geom_xmat

    def geom_name(self, obstacle: int) -> str:
        """Return the name of the geom that an obstacle belongs to."""
        return self.geom_names[self.shapes[obstacle].geom]

    def find_on_line(self, x: float, y: float) -> list[int]:
        """Return the ids of the obstacles whose bounding boxes a vertical line meets, ascending.

        Args:
            x: World x of the line [m].
            y: World y of the line [m].
        """
        is_met = (self._low[0] <= x) & (self._high[0] >= x)
        is_met &= self._low[1] <= y
        is_met &= self._high[1] >= y
        obstacles: list[int] = is_met.nonzero()[0].tolist()
        return obstacles

    def find_overlapping(self, low_corner: ArrayLike, high_corner: ArrayLike) -> list[int]:
        """Return the ids of the obstacles whose bounding boxes overlap a box, ascending.

        Args:
            low_corner: The lower corner of the box, (3,) [m]; may be infinite.
            high_corner: The upper corner of the box, (3,) [m]; may be infinite.
        """
        overlaps = (self._low <= np.reshape(high_corner, (3, 1))) & (
            self._high >= np.reshape(low_corner, (3, 1))
        )
        obstacles: list[int] = np.flatnonzero(overlaps.all(axis=0)).tolist()
        return obstacles

    def support(self, obstacle: int, direction: Float) -> float:
        """Return how far a convex obstacle or a half-space reaches in a direction.

        Args:
            obstacle: The obstacle's id.
            direction: A unit vector in the world's frame, (3,).

        Returns:
            The largest dot product of the direction with a point of the obstacle [m]; may be
            infinite.
        """
        shape = self.shapes[obstacle]
        if shape.hull_points is not None:
            return float((shape.hull_points @ direction).max())
        position = self.geom_positions[obstacle]
        rotation = self.geom_rotations[obstacle].reshape(3, 3)
        if shape.kind == HALF_SPACE:
            is_along_normal = direction @ rotation[:, 2] > SAME_DIRECTION_COSINE
            return float(position @ direction) if is_along_normal else np.inf
        solid_geometry = SOLID_GEOMETRIES[int(self.model.geom_type[obstacle])]
        return float(
            position @ direction
            + solid_geometry.measure_extent(self.geom_sizes[obstacle], rotation.T @ direction)
        )

    def _shapes_of_geom(self, geom: int, mesh_mode: str) -> list[GeomShape]:
        """Return the shapes of a geom of the scene; a mesh may have several parts."""
        model = self._scene.model
        exact_mesh = self._scene.exact_meshes.get(geom)
        geom_type = int(model.geom_type[geom])
        size = model.geom_size[geom].copy()
        if exact_mesh is not None:
            vertices = exact_mesh.vertices - _find_middle(exact_mesh.vertices)
            return self._mesh_shapes(
                MeshArrays(vertices, exact_mesh.faces.astype(np.int64), vertices), mesh_mode
            )
        if geom_type in (GEOM.mjGEOM_MESH, GEOM.mjGEOM_SDF):
            mesh_id = int(model.geom_dataid[geom])
            key = (mesh_id, mesh_mode)
            if key not in self._shapes_of_mesh:
                mesh_arrays = _read_mesh_arrays(model, mesh_id)
                self._shapes_of_mesh[key] = self._mesh_shapes(mesh_arrays, mesh_mode)
            return self._shapes_of_mesh[key]
        if geom_type == GEOM.mjGEOM_HFIELD:
            return [self._height_field(int(model.geom_dataid[geom]))]
        if geom_type != GEOM.mjGEOM_PLANE:
            solid = SOLID_GEOMETRIES[geom_type].make_shape(size)
            return [GeomShape(CONVEX, solid, {"type": geom_type, "size": size})]
        if self._is_ground(geom) or (size[:2] <= 0).all():
            half_space = fcl.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
            return [GeomShape(HALF_SPACE, half_space, {"type": geom_type, "size": [0, 0, 1]})]
        half_x, half_y = np.where(size[:2] > 0, size[:2], INFINITE_HALF_SIZE)
        corners = np.array(
            [
                [-half_x, -half_y, 0.0],
                [half_x, -half_y, 0.0],
                [half_x, half_y, 0.0],
                [-half_x, half_y, 0.0],
            ]
        )
        rectangle = _make_triangle_surface(corners, np.array([[0, 1, 2], [0, 2, 3]]))
        attributes: Json = {"type": geom_type, "size": [*size[:2], 1.0]}
        return [GeomShape(OPEN_SURFACE, rectangle, attributes, corners)]

    def _is_ground(self, geom: int) -> bool:
        """Return whether a plane is endless ground: it stands, can collide, and faces up.

        MuJoCo collides a plane as endless, whatever its size: the size is only drawn.
        """
        model = self._scene.model
        body = int(model.geom_bodyid[geom])
        is_standing = model.body_weldid[body] == 0 and model.body_mocapid[body] < 0
        can_collide = model.geom_contype[geom] or model.geom_conaffinity[geom]
        return bool(
            is_standing
            and can_collide
            and self._scene.data.geom_xmat[geom, 8] >= MIN_GROUND_NORMAL_Z
        )

    def _place_shape(self, geom: int, shape: GeomShape, rotation: Float, position: Float) -> None:
        """Place a shape in the world, and add the geom that represents it to MuJoCo's model."""
        collision_object = fcl.CollisionObject(shape.geometry, fcl.Transform(rotation, position))
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, rotation.ravel())
        pose = {"pos": position, "quat": quaternion}
        self._spec.worldbody.add_geom(**pose, **shape.geom_attributes)

        world_points = None if shape.points is None else shape.points @ rotation.T + position
        if world_points is not None:
            low_corner = world_points.min(axis=0)
            high_corner = world_points.max(axis=0)
        elif shape.kind == HALF_SPACE:
            low_corner = np.full(3, -np.inf)
            high_corner = np.full(3, np.inf)
            if rotation[2, 2] > SAME_DIRECTION_COSINE:  # below a horizontal plane
                high_corner[2] = position[2]
        else:
            solid_geometry = SOLID_GEOMETRIES[shape.geom_attributes["type"]]
            size = shape.geom_attributes["size"]
            half_sizes = np.array([solid_geometry.measure_extent(size, axis) for axis in rotation])
            low_corner = position - half_sizes
            high_corner = position + half_sizes

        if shape.triangles is not None and shape.points is not None:
            geom_attributes: Json = {"type": GEOM.mjGEOM_MESH, "contype": 0, "conaffinity": 0}
            self._half_mesh_attributes[len(self.shapes)] = [
                {**pose, **geom_attributes, "meshname": mesh_name}
                for mesh_name in self._add_half_meshes(
                    shape, shape.points, shape.triangles, rotation[2]
                )
            ]
        hull_points = world_points if shape.kind == CONVEX else None
        self.shapes.append(
            PlacedShape(geom, shape.kind, collision_object, low_corner, high_corner, hull_points)
        )

    def _add_half_meshes(
        self, shape: GeomShape, points: Float, triangles: Int, up_direction: Float
    ) -> list[str]:
        """Add meshes of the triangles that face up and that face down, and return their names.

        Copies of a mesh with the same tilt share these meshes.

        Args:
            shape: A shape made of triangles.
            points: Its corners, (n, 3) [m].
            triangles: The indices of each triangle's corners, (m, 3).
            up_direction: The world's vertical in the shape's frame, (3,).
        """
        key = (id(shape.geometry), up_direction.tobytes())
        if key not in self._half_mesh_names:
            first_corners = points[triangles[:, 0]]
            second_corners = points[triangles[:, 1]]
            third_corners = points[triangles[:, 2]]
            normals = np.cross(second_corners - first_corners, third_corners - first_corners)
            world_normal_z = normals @ up_direction
            min_world_normal_z = MIN_NORMAL_Z * np.linalg.norm(normals, axis=1)
            upward_triangles = triangles[world_normal_z > min_world_normal_z]
            downward_triangles = triangles[world_normal_z < -min_world_normal_z]
            self._half_mesh_names[key] = [
                self._add_mesh(*_drop_unused_vertices(points, half_triangles))
                for half_triangles in (upward_triangles, downward_triangles)
                if len(half_triangles)
            ]
        return self._half_mesh_names[key]

    def _mesh_shapes(self, mesh: MeshArrays, mesh_mode: str) -> list[GeomShape]:
        """Return the shapes of a mesh: its hull, its surface as a whole, or each of its parts."""
        if mesh_mode == "hull":
            with suppress(QhullError, ValueError):  # flat meshes have no hull
                return [self._hull(mesh.hull_vertices)]
        # rays are cast at the half meshes; this geom only keeps the numbering
        placeholder: Json = {"type": GEOM.mjGEOM_SPHERE, "size": [1e-3, 0, 0]}
        if mesh_mode == "shell":
            parts = [ClassifiedPart(OPEN_SURFACE, mesh.faces)]
        else:
            parts = split_mesh_parts(mesh.vertices, mesh.faces)
        shapes = []
        for part in parts:
            points, triangles = _drop_unused_vertices(mesh.vertices, part.faces)
            surface = _make_triangle_surface(points, triangles)
            shapes.append(GeomShape(part.kind, surface, placeholder, points, triangles))
        return shapes

    def _hull(self, vertices: Float) -> GeomShape:
        """Return the convex hull of vertices, and add it to MuJoCo's model."""
        with np.errstate(invalid="ignore"):  # trimesh casts coordinates to integers
            hull = trimesh.convex.convex_hull(vertices)
        points = np.array(hull.vertices)
        triangles = np.array(hull.faces, dtype=np.int64)
        # FCL takes polygons: the number of corners of each, then its corners
        polygon_list = np.insert(triangles, 0, 3, axis=1).ravel()
        mesh_name = self._add_mesh(points, triangles)
        attributes: Json = {"type": GEOM.mjGEOM_MESH, "meshname": mesh_name}
        return GeomShape(
            CONVEX, fcl.Convex(points, len(triangles), polygon_list), attributes, points
        )

    def _height_field(self, field_id: int) -> GeomShape:
        """Return a height field as a closed surface, and add it to MuJoCo's model."""
        model = self._scene.model
        num_rows = int(model.hfield_nrow[field_id])
        num_cols = int(model.hfield_ncol[field_id])
        first_height_index = int(model.hfield_adr[field_id])
        size = model.hfield_size[field_id]
        heights = (
            model.hfield_data[first_height_index : first_height_index + num_rows * num_cols]
            .reshape(num_rows, num_cols)
            .copy()
        )
        name = f"field {len(self._field_heights)}"
        self._field_heights.append(heights)
        self._spec.add_hfield(
            name=name, nrow=num_rows, ncol=num_cols, size=size, userdata=heights.ravel()
        )
        attributes: Json = {"type": GEOM.mjGEOM_HFIELD, "hfieldname": name}

        x = np.linspace(-size[0], size[0], num_cols)
        y = np.linspace(-size[1], size[1], num_rows)
        x, y = np.meshgrid(x, y)
        top_z = heights.astype(np.float64) * size[2]
        bottom_z = np.full_like(x, -size[3])
        points = np.concatenate([np.stack([x, y, z], axis=-1) for z in (top_z, bottom_z)])
        points = points.reshape(-1, 3)

        # squares of the top, in the order in which MuJoCo's documentation halves them
        point_index = np.arange(num_rows * num_cols).reshape(num_rows, num_cols)
        num_top_points = num_rows * num_cols
        top_squares = np.stack(
            [
                point_index[:-1, :-1],
                point_index[:-1, 1:],
                point_index[1:, 1:],
                point_index[1:, :-1],
            ],
            axis=-1,
        ).reshape(-1, 4)
        bottom_squares = top_squares[:, ::-1] + num_top_points
        outline_indices = np.concatenate(
            [point_index[0], point_index[1:, -1], point_index[-1, -2::-1], point_index[-2::-1, 0]]
        )
        begin_indices = outline_indices[:-1]
        end_indices = outline_indices[1:]
        side_squares = np.stack(
            [
                begin_indices + num_top_points,
                end_indices + num_top_points,
                end_indices,
                begin_indices,
            ],
            axis=-1,
        )
        all_squares = np.concatenate([top_squares, bottom_squares, side_squares])
        surface = _make_triangle_surface(points, trimesh.geometry.triangulate_quads(all_squares))
        return GeomShape(HEIGHT_FIELD, surface, attributes, points)

    def _add_mesh(self, points: Float, triangles: Int) -> str:
        """Add a mesh to MuJoCo's model, and return its name."""
        if len(points) < 4:  # MuJoCo takes no fewer
            points = np.concatenate([points, points.mean(axis=0, keepdims=True)])
        name = f"mesh {len(self._spec.meshes)}"
        self._spec.add_mesh(
            name=name,
            uservert=points.ravel(),
            userface=triangles.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        return name


def _make_triangle_surface(vertices: Float, faces: Int) -> fcl.BVHModel:
    """Return FCL's geometry of a surface of triangles."""
    bvh_model = fcl.BVHModel()
    bvh_model.beginModel(len(vertices), len(faces))
    bvh_model.addSubModel(np.ascontiguousarray(vertices, dtype=np.float64), faces)
    bvh_model.endModel()
    return bvh_model


def _find_middle(vertices: Float) -> Float:
    """Return the middle of the box around vertices, (3,) [m]."""
    middle: Float = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    return middle


def _drop_unused_vertices(vertices: Float, faces: Int) -> tuple[Float, Int]:
    """Return the vertices that faces use, and the faces with indices of these vertices."""
    used_vertices, corners = np.unique(faces, return_inverse=True)
    return vertices[used_vertices], corners.reshape(-1, 3)


def _read_mesh_arrays(model: mujoco.MjModel, mesh_id: int) -> MeshArrays:
    """Read a mesh, and the vertices of its convex hull, from a compiled model."""
    mesh = model.mesh(mesh_id)
    first_vertex_index = int(mesh.vertadr[0])
    first_face_index = int(mesh.faceadr[0])
    graph_address = int(mesh.graphadr[0])
    num_vertices = int(mesh.vertnum[0])
    num_faces = int(mesh.facenum[0])
    vertices = model.mesh_vert[first_vertex_index : first_vertex_index + num_vertices].astype(
        np.float64
    )
    faces = model.mesh_face[first_face_index : first_face_index + num_faces].astype(np.int64)
    if graph_address < 0:
        return MeshArrays(vertices, faces, vertices)
    # `mesh_graph` holds the numbers of the hull's vertices and faces, the addresses of the
    # vertices' edges, then the vertices' ids
    num_hull_vertices = int(model.mesh_graph[graph_address])
    first_hull_id_index = graph_address + 2 + num_hull_vertices
    hull_vertex_ids = model.mesh_graph[first_hull_id_index:][:num_hull_vertices]
    return MeshArrays(vertices, faces, vertices[hull_vertex_ids])
