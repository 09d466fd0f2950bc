"""The geometry of a model's counted geoms, gathered into shapes. Knows models, but not mujoco."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.kernels.constants import (
    BOX,
    CAPSULE,
    CLOSED_SURFACE,
    CONVEX_SOLID,
    CYLINDER,
    ELLIPSOID,
    HFIELD,
    MESH,
    OPEN_SURFACE,
    PLANE,
    SDF,
    SOLID,
    SPHERE,
)
from navbake.baker.scene.choice import Choice
from navbake.baker.scene.meshes.part import MeshPart
from navbake.baker.scene.names import name_at, names_of
from navbake.baker.scene.shapes import (
    Planes,
    Shapes,
    Solids,
    Triangles,
    height_field_triangles,
    hull_triangles,
    is_closed_solid,
    plane_triangles,
    solid_bounds,
)
from navbake.errors import SceneError
from navbake.types import Float

SOLIDS = (SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX)
TYPE_NAMES = dict(
    enumerate("plane hfield sphere capsule ellipsoid cylinder box mesh sdf".split())  # noqa: SIM905
)
ENCLOSES = {"hull": CONVEX_SOLID, "closed surface": CLOSED_SURFACE, "surface": OPEN_SURFACE}


@dataclass(frozen=True)
class Collected:
    """The counted geoms' geometry.

    Attributes:
        shapes: all of it, world frame.
        kinds: as what each geom counts, by geom id, see `GeomReport.shape`; empty where it
            doesn't.
        notes: what the user should know, one line each.
    """

    shapes: Shapes
    kinds: list[str]
    notes: list[str]


def collect_shapes(
    model: Any,
    data: Any,
    choices: Sequence[Choice],
    parts: Mapping[int, MeshPart],
    only: Iterable[int] | None = None,
) -> Collected:
    """Gather the geometry of the geoms that count.

    Args:
        model: the compiled model.
        data: its pose.
        choices: what becomes of each geom, by its id.
        parts: meshes that are known better than the model has them (it rounds to float32, in a
            frame of its own), by geom id, world frame.
        only: ids of the geoms to look at, ascending; all if None.

    Raises:
        SceneError: a geom that counts stands at no finite place, or is broken.
    """
    collector = _Collector(model, data, parts)
    kinds = [""] * len(choices)
    for geom in range(len(choices)) if only is None else only:
        if choices[geom].counted:
            kinds[geom] = collector.add(geom, choices[geom].mesh)
    return Collected(collector.shapes(), kinds, collector.notes)


class _Collector:
    """Gathers geometry, kind by kind."""

    def __init__(self, model: Any, data: Any, parts: Mapping[int, MeshPart]) -> None:
        self._model, self._data, self._parts = model, data, parts
        self._solids: list[int] = []
        self._planes: list[int] = []
        self._corners: list[Float] = []
        self._corner_geoms: list[int] = []
        self._closed = np.zeros(model.ngeom, dtype=np.uint8)
        self._endless = np.zeros(model.ngeom, dtype=np.bool_)
        self._meshes: dict[tuple[int, str], tuple[Float, str]] = {}
        numbers = np.hstack([data.geom_xpos, data.geom_xmat, model.geom_size])
        self._is_finite = np.isfinite(numbers).all(axis=1)
        self.notes: list[str] = []

    def add(self, geom: int, mesh_mode: str) -> str:
        """Take one geom in; returns as what."""
        self._check_place(geom)
        kind = int(self._model.geom_type[geom])
        if kind in SOLIDS:
            self._solids.append(geom)
            self._closed[geom] = CONVEX_SOLID
            return "solid"
        if kind == PLANE:
            return self._add_plane(geom)
        if kind not in (HFIELD, MESH, SDF) or self._model.geom_dataid[geom] < 0:
            name = names_of(self._model, geom).geom
            raise SceneError(f"geom {name!r} is broken: it has no shape (type {kind})")
        if kind == HFIELD:
            corners = self._height_field(int(self._model.geom_dataid[geom]))
            self._add_triangles(geom, self._to_world(geom, corners), SOLID)
            return "solid"
        return self._add_mesh(geom, mesh_mode)

    def shapes(self) -> Shapes:
        """All that was taken in."""
        model, data = self._model, self._data
        index = np.array(self._solids, dtype=np.int32)
        kind = model.geom_type[index].astype(np.int32)
        pos = data.geom_xpos[index].astype(np.float64)
        mat = data.geom_xmat[index].astype(np.float64)
        size = model.geom_size[index].astype(np.float64)
        plane = np.array(self._planes, dtype=np.int32)
        counts = [len(c) for c in self._corners]
        corners = np.concatenate([np.zeros((0, 3, 3)), *self._corners])
        return Shapes(
            solids=Solids(index, kind, pos, mat, size, solid_bounds(kind, pos, mat, size)),
            planes=Planes(
                plane,
                data.geom_xpos[plane].astype(np.float64),
                data.geom_xmat[plane].astype(np.float64),
            ),
            triangles=Triangles(
                np.repeat(np.array(self._corner_geoms, dtype=np.int32), counts), corners
            ),
            closed=self._closed,
            endless=self._endless,
        )

    def _check_place(self, geom: int) -> None:
        if not self._is_finite[geom]:
            name = names_of(self._model, geom).geom
            raise SceneError(f"geom {name!r} has a pose or size that is no number")

    def _add_plane(self, geom: int) -> str:
        half = self._model.geom_size[geom, :2].astype(np.float64)
        if (half <= 0).all():
            self._planes.append(geom)
            return "half-space"
        self._endless[geom] = (half <= 0).any()
        self._add_triangles(geom, self._to_world(geom, plane_triangles(half)), OPEN_SURFACE)
        return "strip" if self._endless[geom] else "rectangle"

    def _add_mesh(self, geom: int, mode: str) -> str:
        part = self._parts.get(geom)
        if part is not None:
            corners, kind = self._mesh_triangles(
                geom, part.vertices, part.faces, part.vertices, mode
            )
        else:
            mesh = int(self._model.geom_dataid[geom])
            if (mesh, mode) not in self._meshes:
                arrays = _mesh_arrays(self._model, mesh)
                self._meshes[mesh, mode] = self._mesh_triangles(geom, *arrays, mode)
            corners, kind = self._meshes[mesh, mode]
            corners = self._to_world(geom, corners)
        self._add_triangles(geom, corners, ENCLOSES[kind])
        return kind

    def _mesh_triangles(
        self, geom: int, vertices: Float, faces: NDArray[Any], on_hull: Float, mode: str
    ) -> tuple[Float, str]:
        if mode == "hull":
            hull = hull_triangles(on_hull)
            if hull is not None:
                return hull, "hull"
            name = names_of(self._model, geom)
            self.notes.append(
                f"mesh {name.mesh!r} of geom {name.geom!r} is flat, so it has no convex hull: "
                f"it counts by its triangles"
            )
        kind = "closed surface" if is_closed_solid(vertices, faces) else "surface"
        return vertices[faces], kind

    def _add_triangles(self, geom: int, world: Float, closed: int) -> None:
        self._corners.append(world)
        self._corner_geoms.append(geom)
        self._closed[geom] = closed

    def _to_world(self, geom: int, corners: Float) -> Float:
        mat = self._data.geom_xmat[geom].reshape(3, 3)
        world: Float = corners @ mat.T + self._data.geom_xpos[geom]
        return world

    def _height_field(self, hfield: int) -> Float:
        model = self._model
        rows, cols = int(model.hfield_nrow[hfield]), int(model.hfield_ncol[hfield])
        first = int(model.hfield_adr[hfield])
        heights = model.hfield_data[first : first + rows * cols].reshape(rows, cols)
        size = model.hfield_size[hfield].astype(np.float64)
        if not np.isfinite(heights).all():
            name = name_at(model, model.name_hfieldadr[hfield])
            raise SceneError(f"hfield {name!r} has heights that are no numbers")
        return height_field_triangles(heights.astype(np.float64), size)


def _mesh_arrays(model: Any, mesh: int) -> tuple[Float, NDArray[np.int32], Float]:
    """A mesh's vertices, its faces, and the vertices of its hull, in its geom's frame."""
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = model.mesh_vert[first : first + count].astype(np.float64)
    first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    faces = model.mesh_face[first : first + count]
    on_hull = _hull_index(model, mesh)
    name = name_at(model, model.name_meshadr[mesh])
    for index in (faces, on_hull):
        if index.size and not 0 <= int(index.min()) <= int(index.max()) < len(vertices):
            raise SceneError(f"mesh {name!r} is broken: faces of missing vertices")
    if not np.isfinite(vertices).all():
        raise SceneError(f"mesh {name!r} has coordinates that are no numbers")
    return vertices, faces, vertices[on_hull]


def _hull_index(model: Any, mesh: int) -> NDArray[np.int32]:
    """The vertices that MuJoCo's hull of a mesh has: all, unless `maxhullvert` limits them."""
    address = int(model.mesh_graphadr[mesh])
    if address < 0:
        return np.arange(model.mesh_vertnum[mesh], dtype=np.int32)
    num_vertices = int(model.mesh_graph[address])  # then the faces' number, then two lists
    first = address + 2 + num_vertices
    index: NDArray[np.int32] = model.mesh_graph[first : first + num_vertices]
    return index
