"""Rows of voxel grids and octrees, next to the tools that one would take instead."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.measure import Job, Row, beside, here
from benchmarks.scenes import APARTMENT, SAMPLES
from navbake.baker.scene.scene import load_scene
from navbake.baker.voxels.voxelize import Voxelizer
from navbake.config.settings import parse_config
from navbake.formats.octomap import encode_octomap
from navbake.formats.voxels import encode_binvox
from navbake.voxels.grid import Placement, VoxelGrid

RES = 0.05  # [m]
SHAPE = (385, 385, 116)
EXTENT = np.array(SHAPE) * RES
SMALL, LARGE = (16, 9), (32, 17)  # meridians and parallels: 256 and 1,024 triangles
GEOMS = 386
MILLION = 1_000_000

Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]


class Blobs(NamedTuple):
    """A scene of meshes, as a voxelizer and as one mesh."""

    voxelizer: Voxelizer
    mesh: trimesh.Trimesh


PLACE = Placement(np.zeros(3), RES, SHAPE)


def make_rows(folder: Path) -> dict[str, Callable[[], Row]]:
    """The rows by name, each made when it is asked for."""

    @cache
    def blobs() -> Blobs:
        path = folder / "blobs.obj"
        meshes = make_scene(path)
        scene = load_scene(parse_config({"scene": {"path": str(path), "meshes": "surface"}}))
        return Blobs(Voxelizer(scene), trimesh.util.concatenate(meshes))

    return {
        "voxels": lambda: fill_row(blobs()),
        "voxels-surface": lambda: surface_row(blobs()),
        "voxels-ids": lambda: ids_row(blobs()),
        "octree-scattered": lambda: octree_row(scattered_million(blobs()), "scattered", 0.35),
        "octree-solid": lambda: octree_row(solid_million(), "solid", 0.02),
        "octree-free": lambda: free_row(solid_million()),
        "binvox": lambda: Row(
            here("17.2 M voxels, .binvox", partial(encode_binvox, scattered_million(blobs())))
        ),
        "robot": robot_row,
    }


def fill_row(blobs: Blobs) -> Row:
    """17.2 million voxels, solid, next to pyvista, which asks for voxels' middles only."""

    def peer(pv: Any) -> Job:
        corners = np.insert(blobs.mesh.faces, 0, 3, axis=1).ravel()
        surface = pv.PolyData(blobs.mesh.vertices, corners)
        middles = pv.ImageData(dimensions=SHAPE, spacing=(RES,) * 3, origin=(RES / 2,) * 3)
        run = partial(surface.voxelize_binary_mask, reference_volume=middles)
        return here("pyvista, voxels' middles only", run)

    job = here("17.2 M voxels, solid", lambda: blobs.voxelizer.fill(PLACE))
    is_occupied = blobs.voxelizer.fill(PLACE).values != 0
    fill_holes = partial(ndimage.binary_fill_holes, is_occupied)
    row = beside(job, "pyvista", peer)
    peers = [here("scipy binary_fill_holes of the result", fill_holes), *row.peers]
    return replace(row, peers=peers, ratio=1.0)


def surface_row(blobs: Blobs) -> Row:
    """The same next to Open3D, which fills the surface only."""

    def peer(o3d: Any) -> Job:
        mesh = o3d.geometry.TriangleMesh(
            o3d.utility.Vector3dVector(blobs.mesh.vertices),
            o3d.utility.Vector3iVector(blobs.mesh.faces),
        )
        create = o3d.geometry.VoxelGrid.create_from_triangle_mesh_within_bounds
        return here("Open3D, surface", lambda: create(mesh, RES, np.zeros(3), EXTENT))

    job = here("17.2 M voxels, solid", lambda: blobs.voxelizer.fill(PLACE))
    return beside(job, "open3d", peer, ratio=1.0)


def ids_row(blobs: Blobs) -> Row:
    fill = blobs.voxelizer.fill
    job = here("17.2 M voxels, IDs of 386 geoms", lambda: fill(PLACE, segments="geom"))
    return Row(job, [here("without IDs", lambda: fill(PLACE))])


def octree_row(voxels: VoxelGrid, name: str, ratio: float) -> Row:
    job = here(f"a million voxels, {name}, .bt", lambda: encode_octomap(voxels, "bt"))

    def peer(octomap: Any) -> Job:
        centers = voxels.centers()

        def build() -> None:
            tree = octomap.OcTree(RES)
            tree.updateNodes(centers, True, lazy_eval=True)
            tree.updateInnerOccupancy()
            tree.writeBinary()

        return here("octomap-python, updateNodes", build)

    return beside(job, "octomap", peer, ratio=ratio)


def free_row(voxels: VoxelGrid) -> Row:
    def encode(kind: str) -> Callable[[], bytes]:
        return lambda: encode_octomap(voxels, kind, free=True)

    job = here("a million voxels, .ot with free space", encode("ot"))
    return Row(job, [here(".bt with free space", encode("bt"))])


def binvox_row(voxels: VoxelGrid) -> Row:
    return Row(here("17.2 M voxels, .binvox", lambda: encode_binvox(voxels)))


def robot_row() -> Row:
    """Grids round a robot at twenty places, next to boxes round all geoms, drawn by numpy."""
    voxelizer = Voxelizer(str(APARTMENT))
    rng = np.random.default_rng(0)
    centers = rng.uniform([-4, -3, 0.5], [4, 3, 1.5], (20, 3))

    def go_round(posed: bool) -> None:
        for number, center in enumerate(centers):
            if posed:
                voxelizer.set_pose(keyframe=("doors_open", "doors_closed")[number % 2])
            voxelizer.create(center, (100, 100, 100), res=RES)

    model = mujoco.MjModel.from_xml_path(str(SAMPLES["apartment"]))
    data = mujoco.MjData(model)

    def draw_boxes() -> None:
        for number, center in enumerate(centers):
            mujoco.mj_resetDataKeyframe(model, data, number % model.nkey)
            mujoco.mj_forward(model, data)
            fill_boxes(model, data, center)

    job = here("20 grids of 100³ round a robot, posed", lambda: go_round(True))
    peers = [
        here("numpy, boxes round the geoms alone", draw_boxes),
        here("without another pose", lambda: go_round(False)),
    ]
    return Row(job, peers, ratio=20.0)


def fill_boxes(
    model: mujoco.MjModel, data: mujoco.MjData, center: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Mark the voxels in the boxes round all geoms, in a grid of 100³ voxels round a place."""
    is_filled = np.zeros((100, 100, 100), dtype=np.bool_)
    rotation = np.abs(data.geom_xmat.reshape(-1, 3, 3))
    middle = data.geom_xpos + np.einsum(
        "gij,gj->gi", data.geom_xmat.reshape(-1, 3, 3), model.geom_aabb[:, :3]
    )
    reach = np.einsum("gij,gj->gi", rotation, model.geom_aabb[:, 3:])
    origin = center - 50 * RES
    first = np.clip((middle - reach - origin) / RES, 0, 100).astype(int)
    last = np.clip(np.ceil((middle + reach - origin) / RES), 0, 100).astype(int)
    for (x0, y0, z0), (x1, y1, z1) in zip(first, last, strict=True):
        is_filled[x0:x1, y0:y1, z0:z1] = True
    return is_filled


def scattered_million(blobs: Blobs) -> VoxelGrid:
    """A million voxels of the scene, as evenly spread as it goes."""
    grid = blobs.voxelizer.fill(PLACE)
    occupied = np.flatnonzero(grid.values.ravel())
    values = np.zeros(grid.values.size, dtype=bool)
    values[occupied[:: max(1, len(occupied) // MILLION)][:MILLION]] = True
    return VoxelGrid(values=values.reshape(grid.shape), origin=(0, 0, 0), res=RES)


def solid_million() -> VoxelGrid:
    return VoxelGrid(values=np.ones((100, 100, 100), dtype=bool), origin=(0, 0, 0), res=RES)


def make_scene(path: Path) -> list[trimesh.Trimesh]:
    """Write 386 closed meshes of 100,352 triangles as an OBJ, and return them.

    Two are slabs, the rest bumpy balls, blocks and pillars, a third of them not convex.
    """
    rng = np.random.default_rng(0)
    meshes = []
    for number in range(GEOMS):
        if number < 2:
            half = np.array([EXTENT[0] / 2, EXTENT[1] / 2, 0.1])
            at = np.array([EXTENT[0] / 2, EXTENT[1] / 2, 0.1 if number == 0 else EXTENT[2] - 0.1])
            vertices, faces = make_blob(LARGE, half, power=0.05, bumps=0.0)
        else:
            half = rng.uniform(0.15, 0.8, 3)
            at = rng.uniform(half, EXTENT - half)
            bumps = 0.25 if number % 3 == 0 else 0.0
            vertices, faces = make_blob(SMALL, half, power=rng.choice([0.2, 1.0]), bumps=bumps)
            turn = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
            vertices = vertices @ turn.T
        meshes.append(trimesh.Trimesh(vertices + at, faces, process=False))
    path.write_text(trimesh.exchange.obj.export_obj(trimesh.Scene(meshes)))
    return meshes


def make_blob(
    net: tuple[int, int], half: NDArray[np.float64], power: float, bumps: float
) -> Arrays:
    """A closed surface between an ellipsoid (power 1) and a box (0), with or without bumps."""
    around, up = net
    u = np.arange(around) / around * 2 * np.pi
    v = (np.arange(1, up) / up - 0.5) * np.pi
    around_z = np.cos(u), np.sin(u), np.ones(around)
    heights = np.cos(v), np.cos(v), np.sin(v)
    ring = np.stack([np.outer(a, b).ravel() for a, b in zip(heights, around_z, strict=True)], 1)
    points = np.concatenate([[[0, 0, -1.0]], ring, [[0, 0, 1.0]]])
    points = np.sign(points) * np.abs(points) ** power
    points *= 1 - bumps * (1 + np.sin(9 * points[:, :1]) * np.cos(7 * points[:, 1:2])) / 2
    last = len(points) - 1
    faces = []
    for a in range(around):
        b = (a + 1) % around
        faces.append((0, 1 + b, 1 + a))
        faces.append((last, last - around + a, last - around + b))
        for row in range(up - 2):
            p, q = 1 + row * around + a, 1 + row * around + b
            faces += [(p, q, q + around), (p, q + around, p + around)]
    return points * half, np.array(faces)
