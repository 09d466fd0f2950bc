"""The geometry of a model's counted geoms, gathered into shapes. Does not import mujoco."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.kernels import constants
from navbake.baker.scene.choice import Choice, MeshMode
from navbake.baker.scene.kernels.triangles import take_corners
from navbake.baker.scene.mesh_scene import MeshPart
from navbake.baker.scene.names import all_names, name_at
from navbake.baker.scene.parts import split_mesh
from navbake.baker.scene.shapes import (
    Planes,
    Shapes,
    Solids,
    Triangles,
    height_field_triangles,
    hull_faces,
    plane_triangles,
    solid_bounds,
)
from navbake.errors import SceneError
from navbake.threads import run_in_bands
from navbake.types import Float, Int, Int32

LARGEST = 1e100  # of places and sizes, whose squares have to be numbers, too [m]
SOLIDS = range(constants.SPHERE, constants.BOX + 1)  # and capsule, ellipsoid, cylinder between
TYPE_NAMES = dict(enumerate("plane hfield sphere capsule ellipsoid cylinder box mesh sdf".split()))  # noqa: SIM905


class GeomTriangles(NamedTuple):
    """The triangles of one geom: their vertices, parts and what these enclose, see `Triangles`.

    Attributes:
        vertices: shape (n, 3) [m].
        faces: indices into `vertices`, shape (m, 3).
        part, closed: shape (m,).
    """

    vertices: Float
    faces: Int32
    part: Int32
    closed: NDArray[np.uint8]

    @classmethod
    def all_alike(cls, vertices: Float, faces: Int32, closed: int) -> GeomTriangles:
        """Triangles of one part."""
        num = len(faces)
        return cls(vertices, faces, np.zeros(num, np.int32), np.full(num, closed, np.uint8))

    @classmethod
    def of_corners(cls, corners: Float, closed: int) -> GeomTriangles:
        """Triangles of one part by their corners, shape (m, 3, 3)."""
        faces = np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
        return cls.all_alike(corners.reshape(-1, 3), faces, closed)


class CountedMesh(NamedTuple):
    """The triangles that a mesh counts by, in its own frame, and its `GeomReport.shape`."""

    triangles: GeomTriangles
    kind: str


class MeshTriangles:
    """What the meshes of a model count by, each found once, however many geoms have it."""

    def __init__(self, model: Any) -> None:
        self._model = model
        self._found: dict[tuple[int, str], CountedMesh] = {}

    def count(self, mesh: int, mode: str) -> CountedMesh:
        """Count a mesh as a mode says; see `count_mesh`."""
        if (mesh, mode) not in self._found:
            vertices, faces, hull = _mesh_arrays(self._model, mesh)
            self._found[mesh, mode] = count_mesh(vertices, faces, mode, hull)
        return self._found[mesh, mode]


def count_mesh(
    vertices: Float, faces: Int | Int32, mode: str, hull: Int32 | None = None
) -> CountedMesh:
    """Count a mesh as its hull, as a shell, or as its triangles; a flat one has no hull.

    Args:
        hull: the faces of its hull, shape (m, 3), counter-clockwise from outside; found if None.
    """
    if mode == "hull":
        hull = hull_faces(vertices) if hull is None else hull
        if hull is not None:
            # vertices inside of the hull are no part of it
            used, index = np.unique(hull, return_inverse=True)
            faces = index.reshape(hull.shape).astype(np.int32)
            triangles = GeomTriangles.all_alike(vertices[used], faces, constants.CONVEX_SOLID)
            return CountedMesh(triangles, "hull")
    faces = faces.astype(np.int32, copy=False)
    if mode == "shell":
        triangles = GeomTriangles.all_alike(vertices, faces, constants.OPEN_SURFACE)
        return CountedMesh(triangles, "shell")
    split = split_mesh(vertices, faces)
    faces = np.asarray(split.faces, dtype=np.int32)
    return CountedMesh(GeomTriangles(vertices, faces, split.part, split.closed), split.kind)


class Collected(NamedTuple):
    """The shapes, world frame; each geom's `GeomReport.shape`; what the user should know."""

    shapes: Shapes
    kinds: list[str]
    notes: list[str]


def collect_shapes(
    model: Any,
    data: Any,
    choices: Sequence[Choice],
    parts: Mapping[int, MeshPart],
    only: Iterable[int] | None = None,
    meshes: MeshTriangles | None = None,
) -> Collected:
    """Gather the geometry of the geoms that count.

    Args:
        choices: what becomes of each geom, by its id.
        parts: exact meshes by geom id, world frame (the model has none of these).
        only: ids of the geoms to look at, ascending; all if None.
        meshes: what is known of the model's meshes; nothing if None.

    Raises:
        SceneError: a geom that counts stands at no finite place, or is broken.
    """
    collector = _Collector(model, data, parts, meshes or MeshTriangles(model))
    kinds = [""] * len(choices)
    for geom in range(len(choices)) if only is None else only:
        if choices[geom].counted:
            kinds[geom] = collector.add(geom, choices[geom].mesh)
    return Collected(collector.shapes(), kinds, collector.notes)


def mesh_shapes(model: Any, data: Any, geom: int, mode: MeshMode, meshes: MeshTriangles) -> Shapes:
    """The triangles of one geom that is a mesh, counted as a mode says, world frame."""
    collector = _Collector(model, data, {}, meshes)
    collector.add(geom, mode)
    return collector.shapes()


class _Collector:
    """Gathers geometry, kind by kind."""

    def __init__(
        self, model: Any, data: Any, parts: Mapping[int, MeshPart], meshes: MeshTriangles
    ) -> None:
        self._model, self._data, self._parts = model, data, parts
        self._solids: list[int] = []
        self._planes: list[int] = []
        self._triangles: dict[int, GeomTriangles] = {}  # by geom, world frame
        self._endless = np.zeros(model.ngeom, dtype=np.bool_)
        self._meshes = meshes
        self._flat: set[str] = set()  # meshes that a note tells of
        # lists, which are read geom by geom in less time than the model's arrays
        self._names = all_names(model).geoms
        self._kinds, self._shapes = model.geom_type.tolist(), model.geom_dataid.tolist()
        numbers = np.hstack([data.geom_xpos, data.geom_xmat, model.geom_size])
        self._is_finite = np.isfinite(numbers).all(axis=1).tolist()
        self._is_near = (np.abs(numbers) <= LARGEST).all(axis=1).tolist()
        self.notes: list[str] = []

    def add(self, geom: int, mesh_mode: str) -> str:
        """Take one geom in; returns as what."""
        name, kind, shape = self._names[geom].geom, self._kinds[geom], self._shapes[geom]
        if not self._is_finite[geom]:
            raise SceneError(f"geom {name!r} has a pose or size that is infinite or no number")
        if not self._is_near[geom]:
            raise SceneError(f"geom {name!r} has a pose or size beyond {LARGEST:g} m")
        if kind in SOLIDS:
            self._solids.append(geom)
            return "solid"
        if kind == constants.PLANE:
            return self._add_plane(geom)
        if kind not in (constants.HFIELD, constants.MESH, constants.SDF) or shape < 0:
            raise SceneError(f"geom {name!r} is broken: it has no shape (type {kind})")
        if kind == constants.HFIELD:
            field = GeomTriangles.of_corners(_height_field(self._model, shape), constants.SOLID)
            self._triangles[geom] = self._to_world(geom, field)
            return "solid"
        return self._add_mesh(geom, shape, mesh_mode)

    def shapes(self) -> Shapes:
        """All that was taken in; it can be had once, because it would be large twice."""
        model, data = self._model, self._data
        index, plane = (np.array(ids, dtype=np.int32) for ids in (self._solids, self._planes))
        kind, size = model.geom_type[index], model.geom_size[index]
        pos, mat = data.geom_xpos[index], data.geom_xmat[index]
        return Shapes(
            solids=Solids(index, kind, pos, mat, size, solid_bounds(kind, pos, mat, size)),
            planes=Planes(plane, data.geom_xpos[plane], data.geom_xmat[plane]),
            triangles=_join_triangles(self._triangles),
            endless=self._endless,
        )

    def _add_plane(self, geom: int) -> str:
        half = self._model.geom_size[geom, :2]
        if (half <= 0).all():
            self._planes.append(geom)
            return "half-space"
        self._endless[geom] = (half <= 0).any()
        two = GeomTriangles.of_corners(plane_triangles(half), constants.OPEN_SURFACE)
        self._triangles[geom] = self._to_world(geom, two)
        return "strip" if self._endless[geom] else "rectangle"

    def _add_mesh(self, geom: int, mesh: int, mode: str) -> str:
        part = self._parts.get(geom)
        if part is not None:
            counted = count_mesh(part.vertices, part.faces, mode)
            self._triangles[geom] = counted.triangles
        else:
            counted = self._meshes.count(mesh, mode)
            self._triangles[geom] = self._to_world(geom, counted.triangles)
        name = self._names[geom]
        if mode == "hull" and counted.kind != "hull" and name.mesh not in self._flat:
            self._flat.add(name.mesh)
            self.notes.append(
                f"mesh {name.mesh!r} of geom {name.geom!r} is flat, so it has no convex hull: "
                f"it counts by its triangles"
            )
        return counted.kind

    def _to_world(self, geom: int, triangles: GeomTriangles) -> GeomTriangles:
        mat = self._data.geom_xmat[geom].reshape(3, 3)
        vertices = triangles.vertices @ mat.T
        vertices += self._data.geom_xpos[geom]
        return triangles._replace(vertices=vertices)


def _join_triangles(found: dict[int, GeomTriangles]) -> Triangles:
    """The triangles of all geoms in one."""
    triangles = list(found.values())
    counts = [len(one.faces) for one in triangles]
    num, geom = sum(counts), np.repeat(np.array(list(found), dtype=np.int32), counts)
    part, closed = np.empty(num, dtype=np.int32), np.empty(num, dtype=np.uint8)
    vertices, faces = np.empty((0, 3)), np.empty((num, 3), dtype=np.int32)
    if len(triangles) == 1:  # one large mesh is not copied
        vertices, faces, part, closed = triangles[0]
    elif triangles:
        vertices = np.concatenate([one.vertices for one in triangles])
        np.concatenate([one.part for one in triangles], out=part)
        np.concatenate([one.closed for one in triangles], out=closed)
        first = end = 0
        for one, count in zip(triangles, counts, strict=True):
            np.add(one.faces, np.int32(first), out=faces[end : end + count])
            first, end = first + len(one.vertices), end + count
    corners = np.empty((num, 3, 3))
    run_in_bands(take_corners, num, vertices, faces, corners, least=4096)
    return Triangles(geom, part, closed, corners)


def _height_field(model: Any, hfield: int) -> Float:
    shape = int(model.hfield_nrow[hfield]), int(model.hfield_ncol[hfield])
    first = int(model.hfield_adr[hfield])
    heights = model.hfield_data[first : first + shape[0] * shape[1]].reshape(shape)
    size = model.hfield_size[hfield]
    name = name_at(model, model.name_hfieldadr[hfield])
    if not np.isfinite(heights).all():
        raise SceneError(f"hfield {name!r} has heights that are no numbers")
    if not (np.abs(size) <= LARGEST).all():  # NaN is neither
        raise SceneError(f"hfield {name!r} has a size that is no number, or beyond {LARGEST:g} m")
    return height_field_triangles(heights.astype(np.float64), size)


def _mesh_arrays(model: Any, mesh: int) -> tuple[Float, Int | Int32, Int32 | None]:
    """A mesh's vertices, its faces, and its hull's faces if MuJoCo has one; its geom's frame."""
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = model.mesh_vert[first : first + count].astype(np.float64)
    first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    faces = model.mesh_face[first : first + count]
    name = name_at(model, model.name_meshadr[mesh])
    hull = _hull_faces(model, mesh, name)
    for index in (faces, hull):
        if index.size and not 0 <= int(index.min()) <= int(index.max()) < len(vertices):
            raise SceneError(f"mesh {name!r} is broken: faces of missing vertices")
    if not np.isfinite(vertices).all():
        raise SceneError(f"mesh {name!r} has coordinates that are no numbers")
    return vertices, faces, hull if len(hull) else None


def _hull_faces(model: Any, mesh: int, name: str) -> Int32:
    """The faces of the hull that MuJoCo collides with, shape (m, 3); none where it made no hull.

    It may have fewer vertices than the mesh's own hull, see `maxhullvert`. Finding it anew would
    cost loading scipy, which takes longer than all else that the bake of a small scene imports.

    Source: `mesh_graph` of MuJoCo's mjModel: the numbers v of vertices and m of faces, two lists
    of v, one of v + 3 m, and the faces' vertices, 3 m.
    """
    address = int(model.mesh_graphadr[mesh])
    if address < 0:
        return np.empty((0, 3), dtype=np.int32)
    num_vertices, num_faces = (int(number) for number in model.mesh_graph[address : address + 2])
    first = address + 2 + 3 * num_vertices + 3 * num_faces
    faces = np.asarray(model.mesh_graph[first : first + 3 * num_faces])
    if len(faces) != 3 * num_faces:
        raise SceneError(f"mesh {name!r} is broken: its hull's faces are missing")
    return faces.reshape(-1, 3)
