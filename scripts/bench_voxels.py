"""Measures voxel grids and octrees next to the tools that one would take instead.

Peers that aren't installed are passed over (`pip install open3d pyvista octomap-python`; trimesh
is there, and slow). The least of several runs is printed, as machines are noisy; kernels are warm.

    python scripts/bench_voxels.py [--repeats 5]
"""

from __future__ import annotations

import argparse
import math
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from navbake.baker.scene.scene import load_scene
from navbake.baker.voxelize.voxelizer import Voxelizer
from navbake.config.settings import parse_config
from navbake.formats.binvox import encode_binvox
from navbake.formats.octomap import encode_octomap
from navbake.voxels.grid import VoxelGrid
from navbake.voxels.placement import Placement

APARTMENT = Path(__file__).parent.parent / "configs" / "apartment.yaml"
RES = 0.05  # [m]
SHAPE = (385, 385, 116)
EXTENT = np.array(SHAPE) * RES
SMALL, LARGE = (16, 9), (32, 17)  # meridians and parallels: 256 and 1,024 triangles
GEOMS = 386

Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]


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
    path.write_text(to_obj(meshes))
    return meshes


def make_blob(
    net: tuple[int, int], half: NDArray[np.float64], power: float, bumps: float
) -> Arrays:
    """A closed surface between an ellipsoid (power 1) and a box (0), with or without bumps."""
    around, up = net
    u = np.arange(around) / around * 2 * np.pi
    v = (np.arange(1, up) / up - 0.5) * np.pi
    ring = np.stack(
        [
            np.outer(np.cos(v), np.cos(u)),
            np.outer(np.cos(v), np.sin(u)),
            np.outer(np.sin(v), np.ones(around)),
        ],
        axis=-1,
    ).reshape(-1, 3)
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


def to_obj(meshes: list[trimesh.Trimesh]) -> str:
    lines, first = [], 1
    for number, mesh in enumerate(meshes):
        lines.append(f"o blob_{number}")
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + first).tolist()]
        first += len(mesh.vertices)
    return "\n".join(lines) + "\n"


def least(repeats: int, call: Callable[[], object]) -> float:
    """Seconds of the fastest of several calls, after one that warms up; of one call if 0."""
    if repeats:
        call()
    times = []
    for _ in range(max(1, repeats)):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times)


def peak() -> float:
    """The most memory that this process has had [MiB]."""
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size / (2**20 if sys.platform == "darwin" else 2**10)


def bench_scene(repeats: int, folder: Path) -> VoxelGrid:
    path = folder / "blobs.obj"
    meshes = make_scene(path)
    start = time.perf_counter()
    scene = load_scene(parse_config({"scene": {"path": str(path), "meshes": "surface"}}).scene)
    load = time.perf_counter() - start
    voxelizer = Voxelizer(scene)
    place = Placement(np.zeros(3), RES, SHAPE)
    grid = voxelizer.fill(Placement(np.zeros(3), RES, (8, 8, 8)))  # warm
    before = peak()
    grid = voxelizer.fill(place)
    grown = peak() - before
    count = sum(len(mesh.faces) for mesh in meshes)
    print(
        f"{len(meshes)} geoms, {count:,} triangles, {' × '.join(map(str, SHAPE))} voxels "
        f"({math.prod(SHAPE) / 1e6:.1f} M); asked for: solid in 1 s, faster than a peer"
    )
    whole = trimesh.util.concatenate(meshes)
    peers = {}
    try:
        import open3d as o3d

        mesh = o3d.geometry.TriangleMesh(
            o3d.utility.Vector3dVector(whole.vertices), o3d.utility.Vector3iVector(whole.faces)
        )
        create = o3d.geometry.VoxelGrid.create_from_triangle_mesh_within_bounds
        peers["Open3D, surface"] = lambda: create(mesh, RES, np.zeros(3), EXTENT)
    except ImportError:  # trimesh takes more than a minute, and is asked once
        print("  Open3D isn't installed")
        peers["trimesh, surface"] = lambda: whole.voxelized(RES, max_iter=20)
    try:
        import pyvista as pv

        corners = np.insert(whole.faces, 0, 3, axis=1).ravel()
        surface = pv.PolyData(whole.vertices, corners)
        middles = pv.ImageData(dimensions=SHAPE, spacing=(RES,) * 3, origin=(RES / 2,) * 3)
        peers["pyvista, voxels' middles only"] = lambda: surface.voxelize_binary_mask(
            reference_volume=middles
        )
    except ImportError:
        print("  pyvista isn't installed")
    runs = 0 if "trimesh, surface" in peers else max(1, repeats // 2)
    times = {name: least(runs, call) for name, call in peers.items()}
    for name, seconds in times.items():
        print(f"  {name:<32} {seconds:8.3f} s")
    own = least(repeats, lambda: voxelizer.fill(place))
    ids = least(repeats, lambda: voxelizer.fill(place, segments="geom"))
    print(f"  {'navbake, solid':<32} {own:8.3f} s", end="")
    print("".join(f", {name.split(',')[0]} / navbake = {t / own:.1f}" for name, t in times.items()))
    print(f"  {'navbake, solid, IDs of 386':<32} {ids:8.3f} s")
    print(f"  {'loading the scene':<32} {load:8.3f} s")
    filled = np.count_nonzero(grid.values)
    print(
        f"  {filled:,} voxels filled; memory grew by {grown / math.prod(SHAPE) * 2**20:.2f} B each"
    )
    return grid


def bench_octree(repeats: int, grid: VoxelGrid) -> None:
    occupied = np.flatnonzero(grid.values.ravel())
    values = np.zeros(math.prod(grid.shape), dtype=bool)
    values[occupied[:: max(1, len(occupied) // 1_000_000)][:1_000_000]] = True
    sparse = VoxelGrid(values=values.reshape(grid.shape), origin=(0, 0, 0), res=RES)
    for name, voxels in (("scattered", sparse), ("solid", dense_million())):
        centers = voxels.centers()
        print(f"\n{len(centers):,} voxels, {name}, to an octree; asked for: .bt in 0.8 s")
        try:
            import octomap

            def build(points: NDArray[np.float64] = centers) -> bytes:
                tree = octomap.OcTree(RES)
                tree.updateNodes(points, True, lazy_eval=True)
                tree.updateInnerOccupancy()
                return bytes(tree.writeBinary())

            peer = least(max(1, repeats // 2), build)
            print(f"  {'octomap-python, updateNodes':<32} {peer:8.3f} s")
        except ImportError:
            peer = math.nan
            print("  octomap-python isn't installed")
        own = least(repeats, lambda voxels=voxels: encode_octomap(voxels, "bt"))
        print(f"  {'navbake, .bt':<32} {own:8.3f} s, octomap-python / navbake = {peer / own:.1f}")
        for kind in ("bt", "ot"):
            seconds = least(
                repeats, lambda voxels=voxels, kind=kind: encode_octomap(voxels, kind, free=True)
            )
            print(f"  {f'navbake, .{kind}, free space too':<32} {seconds:8.3f} s")
        seconds = least(repeats, lambda voxels=voxels: encode_binvox(voxels))
        print(f"  {'navbake, .binvox':<32} {seconds:8.3f} s")


def dense_million() -> VoxelGrid:
    return VoxelGrid(values=np.ones((100, 100, 100), dtype=bool), origin=(0, 0, 0), res=RES)


def bench_robot(repeats: int) -> None:
    voxelizer = Voxelizer(str(APARTMENT))
    rng = np.random.default_rng(0)
    centers = rng.uniform([-4, -3, 0.5], [4, 3, 1.5], (20, 3))

    def go_round(posed: bool) -> None:
        for number, center in enumerate(centers):
            if posed:
                voxelizer.set_pose(keyframe=("doors_open", "doors_closed")[number % 2])
            voxelizer.create(center, (100, 100, 100), res=RES)

    print(f"\n100 × 100 × 100 voxels of {RES} m round a robot in the apartment; asked for 10/s")
    for name, posed in (("another place", False), ("another place and pose", True)):
        seconds = least(repeats, lambda posed=posed: go_round(posed)) / len(centers)
        print(f"  {name:<32} {1 / seconds:8.0f} a second")


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure voxel grids and octrees.")
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    with tempfile.TemporaryDirectory() as folder:
        grid = bench_scene(repeats, Path(folder))
    bench_octree(repeats, grid)
    bench_robot(repeats)


if __name__ == "__main__":
    main()
