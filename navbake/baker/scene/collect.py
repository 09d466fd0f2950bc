"""The geometry of a model's counted geoms, gathered into shapes. Does not import mujoco."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from navbake.baker.kernels import constants
from navbake.baker.scene.choice import Choice
from navbake.baker.scene.mesh_scene import MeshPart
from navbake.baker.scene.names import all_names, name_at
from navbake.baker.scene.parts import split_mesh
from navbake.baker.scene.shapes import (
    GeomTriangles,
    Planes,
    Shapes,
    Solids,
    gather_meshes,
    height_field_triangles,
    hull_faces,
    plane_triangles,
    solid_bounds,
)
from navbake.errors import SceneError
from navbake.types import Float, Int, Int32

LARGEST = 1e100  # of places and sizes, whose squares have to be numbers, too [m]
SOLIDS = range(constants.SPHERE, constants.BOX + 1)  # and capsule, ellipsoid, cylinder between
TYPE_NAMES = dict(enumerate("plane hfield sphere capsule ellipsoid cylinder box mesh sdf".split()))  # noqa: SIM905


def _one_part(vertices: Float, faces: Int32 | None, closed: int, kind: str) -> GeomTriangles:
    """Triangles that are all of one part, by corners of shape (m, 3, 3) if there are no faces."""
    if faces is None:
        vertices = vertices.reshape(-1, 3)
        faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    num = len(faces)
    part, codes = np.zeros(num, np.int32), np.full(num, closed, np.uint8)
    return GeomTriangles(vertices, faces, part, codes, kind)


class MeshTriangles:
    """The triangles of a model's meshes by mode, each found once."""

    def __init__(self, model: Any) -> None:
        self._model = model
        self._found: dict[tuple[int, str], GeomTriangles] = {}

    def count(self, mesh: int, mode: str) -> GeomTriangles:
        """Count a mesh as a mode says, in its own frame; see `count_mesh`."""
        if (mesh, mode) not in self._found:
            vertices, faces, hull = _mesh_arrays(self._model, mesh)
            self._found[mesh, mode] = count_mesh(vertices, faces, mode, hull)
        return self._found[mesh, mode]


def count_mesh(
    vertices: Float, faces: Int | Int32, mode: str, hull: Int32 | None = None
) -> GeomTriangles:
    """Count a mesh as its hull (found if None), as a shell, or as its triangles if it is flat."""
    if mode == "hull":
        hull = hull_faces(vertices) if hull is None else hull
        if hull is not None:
            # vertices inside of the hull are no part of it
            used, index = np.unique(hull, return_inverse=True)
            faces = index.reshape(hull.shape).astype(np.int32)
            return _one_part(vertices[used], faces, constants.CONVEX_SOLID, "hull")
    faces = faces.astype(np.int32, copy=False)
    if mode == "shell":
        return _one_part(vertices, faces, constants.OPEN_SURFACE, "shell")
    split = split_mesh(vertices, faces)
    return GeomTriangles(vertices, split.faces, split.part, split.closed, split.kind)


class Collected(NamedTuple):
    """The geometry of geoms, world frame; their `GeomReport.shape`; and notes for the user."""

    shapes: Shapes
    kinds: dict[int, str]
    notes: list[str]


def collect_shapes(
    model: Any,
    data: Any,
    choices: Sequence[Choice] | Mapping[int, Choice],
    parts: Mapping[int, MeshPart],
    only: Iterable[int] | None = None,
    meshes: MeshTriangles | None = None,
) -> Collected:
    """Gather the geometry of the geoms that count, of all or of some ids, ascending.

    `parts` are exact meshes by geom id, world frame, in place of the model's.
    """
    meshes = MeshTriangles(model) if meshes is None else meshes
    names, kinds, notes = all_names(model).geoms, dict[int, str](), dict[str, str]()
    solids, planes, triangles = list[int](), list[int](), dict[int, GeomTriangles]()
    endless = np.zeros(model.ngeom, dtype=np.bool_)
    every = range(len(choices)) if only is None else only
    ids = np.array([geom for geom in every if choices[geom].counted], dtype=np.int64)
    numbers = np.hstack([data.geom_xpos[ids], data.geom_xmat[ids], model.geom_size[ids]])
    # lists, which are read geom by geom in less time than arrays
    is_placed = (np.abs(numbers) <= LARGEST).all(axis=1)  # NaN isn't
    columns = ids, model.geom_type[ids], model.geom_dataid[ids], is_placed
    for geom, kind, shape, placed in zip(*(array.tolist() for array in columns), strict=True):
        (name, mesh, _), mode = names[geom], ""
        if not placed:
            what = f"a pose or size that is no number, or beyond {LARGEST:g} m"
            raise SceneError(f"geom {name!r} has {what}")
        if kind in SOLIDS:
            solids.append(geom)
            kinds[geom] = "solid"
            continue
        if kind == constants.PLANE:
            half = model.geom_size[geom, :2]
            if (half <= 0).all():
                planes.append(geom)
                kinds[geom] = "half-space"
                continue
            endless[geom] = (half <= 0).any()
            what = "strip" if endless[geom] else "rectangle"
            found = _one_part(plane_triangles(half), None, constants.OPEN_SURFACE, what)
        elif kind not in (constants.HFIELD, constants.MESH, constants.SDF) or shape < 0:
            raise SceneError(f"geom {name!r} is broken: it has no shape (type {kind})")
        elif kind == constants.HFIELD:
            found = _one_part(_height_field(model, shape), None, constants.SOLID, "solid")
        else:
            mode = choices[geom].mesh
            exact = parts.get(geom)
            counted = exact and count_mesh(exact.vertices, exact.faces, mode)
            found = counted or meshes.count(shape, mode)
            if mode == "hull" and found.kind != "hull":
                flat = f"mesh {mesh!r} of geom {name!r} is flat, so it has no convex hull"
                notes.setdefault(mesh, f"{flat}: it counts by its triangles")
        kinds[geom] = found.kind
        if geom not in parts:
            vertices = found.vertices @ data.geom_xmat[geom].reshape(3, 3).T
            vertices += data.geom_xpos[geom]
            found = found._replace(vertices=vertices)
        triangles[geom] = found
    index, plane = np.array(solids, dtype=np.int32), np.array(planes, dtype=np.int32)
    of_solids = model.geom_type[index], data.geom_xpos[index], data.geom_xmat[index]
    own = *of_solids, model.geom_size[index]
    gathered = Shapes(
        solids=Solids(index, *own, solid_bounds(*own)),
        planes=Planes(plane, data.geom_xpos[plane], data.geom_xmat[plane]),
        meshes=gather_meshes(triangles),
        endless=endless,
    )
    return Collected(gathered, kinds, list(notes.values()))


def _height_field(model: Any, hfield: int) -> Float:
    shape = int(model.hfield_nrow[hfield]), int(model.hfield_ncol[hfield])
    first, size = int(model.hfield_adr[hfield]), model.hfield_size[hfield]
    heights = model.hfield_data[first : first + shape[0] * shape[1]].reshape(shape)
    if not (np.isfinite(heights).all() and (np.abs(size) <= LARGEST).all()):
        name = name_at(model, model.name_hfieldadr[hfield])
        what = f"heights or a size that are no numbers, or beyond {LARGEST:g} m"
        raise SceneError(f"hfield {name!r} has {what}")
    return height_field_triangles(heights.astype(np.float64), size)


def _mesh_arrays(model: Any, mesh: int) -> tuple[Float, Int32, Int32 | None]:
    """A mesh's vertices, its faces, and its hull's faces if MuJoCo has one; its geom's frame."""
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = model.mesh_vert[first : first + count].astype(np.float64)
    first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    faces, hull = model.mesh_face[first : first + count], np.empty((0, 3), dtype=np.int32)
    name = name_at(model, model.name_meshadr[mesh])
    address = int(model.mesh_graphadr[mesh])
    if address >= 0:  # of MuJoCo's `mesh_graph`: v, m, two lists of v, v + 3 m numbers, the faces
        num_vertices, num_faces = (int(n) for n in model.mesh_graph[address : address + 2])
        first = address + 2 + 3 * (num_vertices + num_faces)
        corners = np.asarray(model.mesh_graph[first : first + 3 * num_faces])
        if len(corners) != 3 * num_faces:
            raise SceneError(f"mesh {name!r} is broken: its hull's faces are missing")
        hull = corners.reshape(-1, 3)
    for index in (faces, hull):
        if index.size and not 0 <= int(index.min()) <= int(index.max()) < len(vertices):
            raise SceneError(f"mesh {name!r} is broken: faces of missing vertices")
    if not np.isfinite(vertices).all():
        raise SceneError(f"mesh {name!r} has coordinates that are no numbers")
    return vertices, faces, hull if len(hull) else None
