"""Write navbake/kernels.json: which kernels Python calls, with which types, and what they cost.

Bakes a sample, and then some scenes that need all kernels; where these aren't compiled, that takes
some minutes. Run it when a test says that the list is out of date.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numba import types

import navbake
from navbake.baker.rooms.walls import find_windows
from navbake.cli.main import main as run_command
from navbake.compiled import KERNEL_LIST, KERNELS
from navbake.files import scratch_folder

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "scripts"), str(ROOT / "tests")]

from sweep_moves import sweep  # noqa: E402

BYTES_PER_SECOND = 93_000  # of code that numba makes on one core, of functions of this size
SAMPLES: dict[str, dict[str, Any]] = {
    "house": {"attributes": ["island", "clearance"]},
    # fine enough for rings of many cells
    "apartment": {
        "agent": {"radius": 0.2},
        "grid": {"cell_size": 0.05},
        "rooms": {"sources": ["auto"]},
    },
    "terrain": {},
    "clutter": {"scene": {"meshes": "shell"}},
}
# Larger functions take more time a byte. This power of the size fits the times of the kernels of
# bakes, from 25 to 500 KB
GROWTH = 1.45
# A grid as other tools write it: with a hole in its floor that no geom is in
LAYER = {"type": "array", "length": 64}
FOREIGN = {
    "type": "SceneGrid2D",
    "metadata": {"sceneId": "foreign", "agentHeight": 1.14, "agentRadius": 0.05},
    "width": 8,
    "height": 8,
    "cellSize": 0.1,
    "min": [0, 0, 0],
    "tileAttributes": {
        "occupancy": {**LAYER, "datatype": "uint8", "data": [0] * 64},
        "floorHeight": {**LAYER, "datatype": "float32", "data": [None, *[0.0] * 63]},
    },
}


def main() -> None:
    """List the kernels that a bake calls, and all others."""
    parser = argparse.ArgumentParser(description="Write the list of kernels.")
    parser.add_argument("--use", choices=USES, help="print what is called, for the script itself")
    given = parser.parse_args()
    if given.use is not None:
        USES[given.use]()
        print(json.dumps(list_called()))
        return
    bake, every = called_by("bake"), called_by("all")
    known = [(name, types) for name, _, types in bake]
    others = [[name, cost, types] for name, cost, types in every if (name, types) not in known]
    lines = [",\n".join(map(json.dumps, entries)) for entries in (bake, others)]
    KERNEL_LIST.write_text(
        f'{{"bake": [\n{lines[0]}\n],\n"others": [\n{lines[1]}\n]}}\n', encoding="utf-8"
    )
    print(f"{len(bake)} kernels of bakes, {len(others)} others")


def called_by(use: str) -> list[Any]:
    """The entries of what a use calls; it is repeated until it has nothing to compile."""
    while True:
        done = subprocess.run(
            [sys.executable, "-W", "ignore", __file__, "--use", use],
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
        entries: list[Any] | None = json.loads(done.stdout.splitlines()[-1])
        if entries is not None:
            return entries


def list_called() -> list[Any] | None:
    """The entries of all kernels that this process called; None if it compiled any.

    A kernel's types are known here if it was called or compiled, as those are that a kernel calls.
    """
    if any(kernel.stats.cache_misses for kernel in KERNELS):
        return None
    entries = []
    for kernel in KERNELS:
        name = f"{kernel.__module__}.{kernel.__name__}".removeprefix("navbake.")
        files = list(Path(kernel.stats.cache_path).glob(f"*.{kernel.__name__}-*.nbc"))
        for signature in kernel.signatures:
            # the mean of all its files, whose names don't say for which types each is
            size = sum(path.stat().st_size for path in files) / len(files)
            seconds = round((size / BYTES_PER_SECOND) ** GROWTH, 2)
            entries.append([name, seconds, [encode_type(of) for of in signature]])
    return entries


def bake_sample() -> None:
    """Bake what most bakes are like, and print its table."""
    with scratch_folder() as folder, suppress(SystemExit):
        apartment = ROOT / "configs" / "apartment.yaml"
        run_command(["bake", str(apartment), "-o", str(folder / "apartment.grid.json")])


def encode_type(of: Any) -> Any:
    """Write one of numba's types as the list has it, see `navbake.compiled.KernelEntry`."""
    if isinstance(of, types.Array):
        access = "" if of.mutable else " readonly"
        return f"{of.dtype} {of.ndim} {of.layout}{access}"
    if isinstance(of, types.BaseNamedTuple):
        cls = of.instance_class
        name = f"{cls.__module__}.{cls.__qualname__}".removeprefix("navbake.")
        return {name: [encode_type(t) for t in of.types]}
    if isinstance(of, types.BaseTuple):
        return [encode_type(t) for t in of.types]
    assert isinstance(of, types.Boolean | types.Integer | types.Float), of
    return str(of)


def use_all() -> None:
    """Use what bakes of the samples, updates, the run time, files and voxel grids need."""
    with scratch_folder() as folder:
        for name, more in SAMPLES.items():
            grid = navbake.bake(ROOT / "configs" / f"{name}.yaml", **more)
            file = folder / f"{name}.grid.json"
            grid.save(file)
            _use_run_time(navbake.load(file))
            grid.to_mesh()
            grid.to_geojson()
            grid.to_mjcf(folder / f"{name}.walls.xml", flat=True)
        foreign = folder / "foreign.json"
        foreign.write_text(json.dumps(FOREIGN), encoding="utf-8")
        navbake.load(foreign).inflate(0.3)
        table = trimesh.creation.box((2.0, 2.0, 1.0))
        navbake.bake(trimesh.Trimesh(table.vertices, table.faces[:-1]))  # it is not closed
        cavity = trimesh.creation.box((1.0, 1.0, 0.5))
        cavity.invert()
        navbake.bake(trimesh.util.concatenate([table, cavity]))  # as meshes that are drawn may be
        sill = np.zeros((40, 40), dtype=np.bool_)
        sill[20, 15:25] = True  # no sample has one
        wall = (np.arange(40) == 20)[:, None] & ~sill
        find_windows(sill, wall, 0.1)
        for scene in ("room", "bridge"):
            sweep(scene, moves=12)
        _use_voxels(navbake.Voxelizer(navbake.samples.path("apartment")), folder)


def _use_voxels(voxelizer: navbake.Voxelizer, folder: Path) -> None:
    """Make voxels of each type, and write and read them."""
    voxelizer.set_pose(joints={"door_bedroom": 0.5})
    place = (4.0, 3.0, 1.0), (20, 20, 20)
    for suffix in ("binvox", "npz", "bt", "ot"):
        voxelizer.create(*place, res=0.1, align=True).save(folder / f"voxels.{suffix}")
        navbake.load_voxels(folder / f"voxels.{suffix}")
    voxelizer.create(*place, res=0.1, segments="top").save(folder / "ids.binvox")
    navbake.load_voxels(folder / "ids.binvox")
    voxelizer.create(*place, res=0.1, segments={"*": 999})
    _use_flights(voxelizer.create(res=0.2))


def _use_flights(voxels: navbake.VoxelGrid) -> None:
    """Ask whatever of distances and flights has kernels."""
    field = voxels.distances(signed=True)
    finder = navbake.VoxelFinder(voxels, 0.2, cost_of_clearance=0.1)
    start, goal = finder.random_point(np.random.default_rng(0), 2, island=1)
    field.gradients_at(start)
    finder.find_path(start, goal)
    finder.distance_field(goal)
    finder.why_not(start, voxels.bounds[1])
    middle = voxels.bounds.mean(axis=0)
    nearest = np.argmin(np.linalg.norm(voxels.centers() - middle, axis=1))
    finder.why_not(start, voxels.centers()[nearest])  # where something is
    finder.snap(start, island=1)


def _use_run_time(grid: navbake.SceneGrid2D | navbake.MultiLevelGrid) -> None:
    """Call whatever of the run time has kernels."""
    rng = np.random.default_rng(0)
    grid.with_doors("open")
    grid.inflate(0.1, clearance=0.1)
    grid.inflate(0.1, costs="nav2")
    grid.inflate(0.1, clearance=0.1, mode="minos")
    grid.inflate_footprint([(0.2, 0.1), (-0.2, 0.1), (0.0, -0.2)], 4)
    top = len(grid.levels) - 1
    for agent in (grid, grid.inflate(0.3)):
        agent.routes()
        finder = navbake.PathFinder(agent)
        start, goal = finder.random_point(rng, level=0), finder.random_point(rng, level=top)
        finder.find_path(start, goal)
        finder.find_path(start + np.array([0.02, 0.02, 0.0]), goal)  # off a cell's centre
        for _ in range(8):  # some of them bend round corners
            finder.find_path(finder.random_point(rng), finder.random_point(rng))
        finder.why_not(start, (100.0, 0.0, 0.0))
        finder.distance_field(goal)
        finder.random_point_near(rng, start, 2.0)
        finder.random_pose(rng, start, 2.0)
        finder.is_navigable(np.stack([start, goal]))
        finder.is_navigable(start[:2], level=0)
        for offset in np.linspace(0.2, 2.0, 7):
            finder.snap(start + np.array([offset, 0.0, 0.0]), in_sight=True)
        finder.try_step(start, start + np.array([0.3, 0.2, 0.0]))
        both = np.stack([start, goal])
        finder.snap(both)
        finder.clearance(both)
        finder.try_step(both, both + np.array([0.3, 0.2, 0.0]))
        finder.line_of_sight(start, goal)
        finder.nearest_obstacle(start)
        finder.max_radius(start, goal)
        finder.reachable_positions(start, 0.3)
        path = finder.find_path(start, start + np.array([0.02, 0.02, 0.0]))
        if path is not None:
            finder.follow(path).command(start, 0.0)
        with agent.block(disc=(start, 0.3)):
            finder.find_path(start, goal)


USES = {"bake": bake_sample, "all": use_all}

if __name__ == "__main__":
    main()
