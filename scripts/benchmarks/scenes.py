"""The scenes that are measured: houses of many rooms, and the same as one soup of triangles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from make_house import ROOM, make_house

ROOT = Path(__file__).parents[2]
APARTMENT = ROOT / "configs" / "apartment.yaml"
SAMPLES = {
    name: ROOT / "configs" / "scenes" / f"{name}{suffix}"
    for name, suffix in (
        ("apartment", ".xml"),
        ("clutter", ".obj"),
        ("house", ".xml"),
        ("terrain", ".xml"),
        ("warehouse", ".xml"),
    )
}
SHARED_DATA = ROOT.parent / "shared" / "data"
DUNGEON = SHARED_DATA / "recast_meshes" / "dungeon.obj"
"""Recast's own test scene, where it lies beside the checkout."""

CELL = 0.05  # [m]
STEP, AGENT, RADIUS, MAX_SLOPE = 0.25, 1.14, 0.1, 45.0  # of the agent [m], [deg]
ROOMS = 100  # of the house that most rows are about
TRIANGLES = 4000  # of a piece with many
CHORD = 0.0015  # how far triangles may lie off a round shape [m]


def num_cells(rooms: int) -> int:
    """Cells of a house."""
    return round(rooms * (ROOM / CELL) ** 2)


@dataclass(frozen=True)
class Soup:
    """A scene as one mesh file, PLY or OBJ."""

    path: Path

    def read(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Vertices and corners of the triangles."""
        mesh = trimesh.load(self.path, process=False, force="mesh")
        return np.asarray(mesh.vertices), np.asarray(mesh.faces)


@dataclass(frozen=True)
class Scenes:
    """Makes each scene when it is first asked for."""

    folder: Path  # where the files go
    rooms: int = ROOMS  # of the main house

    def house(self, rooms: int, *, with_doors: bool = False, triangles: int = 0) -> Path:
        """An MJCF of a house."""
        name = f"house-{rooms}{'-doors' * with_doors}{f'-{triangles}' * bool(triangles)}.xml"
        path = self.folder / name
        if not path.exists():
            given = {"triangles": triangles} if triangles else {}
            path.write_text(make_house(rooms, with_doors=with_doors, **given), encoding="utf-8")
        return path

    def soup(self, rooms: int, *, triangles: int = 0) -> Soup:
        """The same house as a PLY of triangles."""
        return self.soup_of(self.house(rooms, triangles=triangles))

    def soup_of(self, scene: Path) -> Soup:
        """A scene as a PLY of triangles; a mesh file as it is."""
        if scene.suffix != ".xml":
            return Soup(scene)
        path = self.folder / f"{scene.stem}.ply"
        if not path.exists():
            tessellate(scene).export(path)
        return Soup(path)

    @cached_property
    def main(self) -> Path:
        """The main house."""
        return self.house(self.rooms)


def tessellate(scene: Path) -> trimesh.Trimesh:
    """Make one mesh of all geoms of an MJCF but endless planes."""
    model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    pieces = []
    for geom in range(model.ngeom):
        is_plane = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
        if not is_plane or model.geom_size[geom, :2].all():
            vertices, faces = _triangles(model, geom)
            turned = vertices @ data.geom_xmat[geom].reshape(3, 3).T
            pieces.append((turned + data.geom_xpos[geom], faces))
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    return trimesh.Trimesh(
        np.concatenate([vertices for vertices, _ in pieces]).astype(np.float32),
        np.concatenate([faces + start for (_, faces), start in zip(pieces, starts, strict=False)]),
        process=False,
    )


def _triangles(model: Any, geom: int) -> tuple[NDArray[Any], NDArray[Any]]:
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind in (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_SDF):
        return _hull(model, int(model.geom_dataid[geom]))
    if kind == mujoco.mjtGeom.mjGEOM_HFIELD:
        return _height_field(model, int(model.geom_dataid[geom]))
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) * [*size[:2], 0]
        return corners, np.array([(0, 1, 2), (0, 2, 3)])
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        mesh = trimesh.creation.box(2 * size)
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        n = sections(size[0])
        mesh = trimesh.creation.uv_sphere(size[0], count=(n // 2, n))
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        n = sections(size.max())
        mesh = trimesh.creation.uv_sphere(1.0, count=(n // 2, n))
        mesh.apply_scale(size)
    elif kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        n = sections(size[0])
        mesh = trimesh.creation.capsule(2 * size[1], size[0], count=(n, n // 2))
        mesh.apply_translation((0, 0, -mesh.bounds.mean(axis=0)[2]))
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        mesh = trimesh.creation.cylinder(size[0], 2 * size[1], sections=sections(size[0]))
    else:
        raise ValueError(f"geom {geom}: expected a shape that has triangles, got {kind.name}")
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def sections(radius: float) -> int:
    """How many parts a circle needs for chords that lie at most CHORD off it; an even number."""
    return 2 * math.ceil(math.pi / math.acos(1 - CHORD / radius) / 2)


def _hull(model: Any, mesh: int) -> tuple[NDArray[Any], NDArray[Any]]:
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    hull = trimesh.Trimesh(model.mesh_vert[start : start + count]).convex_hull
    return np.asarray(hull.vertices), np.asarray(hull.faces)


def _height_field(model: Any, field: int) -> tuple[NDArray[Any], NDArray[Any]]:
    rows, cols = model.hfield_nrow[field], model.hfield_ncol[field]
    half_x, half_y, top, _ = model.hfield_size[field]
    start = model.hfield_adr[field]
    heights = model.hfield_data[start : start + rows * cols].reshape(rows, cols) * top
    x, y = np.meshgrid(np.linspace(-half_x, half_x, cols), np.linspace(-half_y, half_y, rows))
    number = np.arange(rows * cols).reshape(rows, cols)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    return np.stack([x, y, heights], axis=-1).reshape(-1, 3), faces
