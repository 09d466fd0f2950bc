"""Write navbake/kernels.json: which kernels Python calls, with which types, and what they cost.

Bakes a sample, and then some scenes that need all kernels; where these aren't compiled, that takes
some minutes. Run it when a test says that the list is out of date.
"""

from __future__ import annotations

import argparse
import json
import struct
import subprocess
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

import navbake
from navbake.compiled import KERNELS, LIST

ROOT = Path(__file__).parents[1]
BYTES_PER_SECOND = 120_000  # of code that numba makes on one core, of functions of this size
GROWTH = 1.7  # larger functions take more time a byte: a power of the size that fits the times

# Two storeys joined by stairs, with geoms of all kinds, a door, and a crack in the floor
SCENE = """<mujoco model="warm-up">
<asset>
  <mesh name="wedge" vertex="0 0 0 .4 0 0 0 .4 0 0 0 .6" face="0 2 1 0 1 3 1 2 3 0 3 2"/>
  <hfield name="hill" nrow="3" ncol="3" size=".5 .5 .2 .1" elevation="0 0 0 0 1 0 0 0 0"/>
</asset>
<worldbody>
  <geom type="plane" size="0 0 1" pos="0 0 -.4"/>
  <geom type="box" size="3.3225 3 .1" pos="-.6775 0 -.1"/>
  <geom type="box" size=".6725 3 .1" pos="3.3275 0 -.1"/>
  <geom type="box" size="1.5 3 .1" pos="-2.5 0 1.9"/>
  <replicate count="9" offset="-.3 0 .2">
    <geom type="box" size=".15 .6 .1" pos="1.5 0 .1"/>
  </replicate>
  <geom type="box" size=".05 1.2 1.2" pos="2.4 1.8 1.2"/>
  <geom type="box" size=".05 1.2 1.2" pos="2.4 -1.8 1.2"/>
  <geom type="sphere" size=".3" pos="1.5 2 .3"/>
  <geom type="capsule" size=".2 .3" pos="1.5 -2 .4" euler="80 10 0"/>
  <geom type="cylinder" size=".2 .3" pos=".5 2 .4" euler="10 10 0"/>
  <geom type="ellipsoid" size=".2 .3 .4" pos=".5 -2 .4"/>
  <geom type="mesh" mesh="wedge" pos="3 2 0"/>
  <geom type="mesh" mesh="wedge" pos="3 -2 0" contype="0" conaffinity="0"/>
  <geom type="hfield" hfield="hill" pos="3.3 0 0"/>
  <body name="door" pos="2.4 -.6 1">
    <joint name="hinge" type="hinge" axis="0 0 1" range="0 90"/>
    <geom type="box" size=".02 .55 1" pos="0 .6 0"/>
  </body>
</worldbody></mujoco>"""

# Rooms as sites, a ramp, a mesh with a cavity, and a closed one that holds a floor
HOLLOW = """<mujoco model="hollow">
<asset>
  <mesh name="hollow" inertia="shell" vertex="{vertices}" face="{faces}"/>
  <mesh name="hall" inertia="shell" vertex="{hall}" face="{hall_faces}"/>
</asset>
<worldbody>
  <geom type="box" size="4 3 .1" pos="0 0 -.1"/>
  <geom type="box" size="1 1 .1" pos="-2.5 1 .4" euler="0 20 0"/>
  <geom type="mesh" mesh="hollow" pos="2 0 .5" contype="0" conaffinity="0"/>
  <geom type="mesh" mesh="hall" pos="0 1.5 .9" contype="0" conaffinity="0"/>
  <site name="room_a" type="box" size="1 1 1" pos="-2 0 1"/>
</worldbody></mujoco>"""
CORNERS = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
FACES = [
    *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)),
    *((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
]
# A room with a crack in its floor, a door, a niche, and boxes that are moved: near the crack, onto
# each other, in front of the niche, out of the scene
MOVING = """<mujoco model="moving">
<asset>
  <mesh name="wedge" vertex="0 0 0 .4 0 0 0 .4 0 0 0 .6" face="0 2 1 0 1 3 1 2 3 0 3 2"/>
</asset>
<worldbody>
  <geom type="mesh" mesh="wedge" pos="-1.1 .15 0" contype="0" conaffinity="0"/>
  <geom type="box" size="1.5 1.5 .1" pos="-1.505 0 -.1"/>
  <geom type="box" size="1.5 1.5 .1" pos="1.505 0 -.1"/>
  <geom type="box" size=".05 1.1 1.2" pos="1.2 .4 1.2"/>
  <body name="door" pos="1.2 -1.4 1">
    <joint name="hinge" type="hinge" axis="0 0 1" range="0 90"/>
    <geom type="box" size=".02 .3 1" pos="0 .35 0"/>
  </body>
  <geom type="box" size=".05 .35 .6" pos="-2.3 1 .6"/>
  <geom type="box" size=".05 .35 .6" pos="-1.8 1 .6"/>
  <geom type="box" size=".3 .05 .6" pos="-2.05 1.3 .6"/>
  <body name="loose" pos="-.5 -1 .1"><freejoint/><geom type="box" size=".1 .1 .1"/></body>
  <body name="one" mocap="true" pos="-1 0 .2"><geom type="box" size=".2 .2 .2"/></body>
  <body name="two" mocap="true" pos="-2 -.8 .05"><geom type="box" size=".6 .6 .05"/></body>
</worldbody></mujoco>"""
# A grid as other tools write it: with a hole in its floor that no geom is in
FOREIGN = {
    "type": "SceneGrid2D",
    "metadata": {"sceneId": "foreign", "agentHeight": 1.14, "agentRadius": 0.05},
    "width": 8,
    "height": 8,
    "cellSize": 0.1,
    "min": [0, 0, 0],
    "tileAttributes": {
        "occupancy": {"type": "array", "datatype": "uint8", "length": 64, "data": [0] * 64},
        "floorHeight": {
            "type": "array",
            "datatype": "float32",
            "length": 64,
            "data": [None, *[0.0] * 63],
        },
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
    others = [entry for entry in every if entry not in bake]
    lines = [",\n".join(map(json.dumps, entries)) for entries in (bake, others)]
    LIST.write_text(
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
        size = sum(
            path.stat().st_size
            for path in Path(kernel.stats.cache_path).glob(f"*.{kernel.__name__}-*.nbc")
        )
        for signature in kernel.signatures:
            size_each = size / len(kernel.signatures)
            seconds = round((size_each / BYTES_PER_SECOND) ** GROWTH, 2)
            entries.append([name, seconds, [encode_type(of) for of in signature]])
    return entries


def bake_sample() -> None:
    """Bake what most bakes are like, and print its table."""
    from navbake.cli.main import main as run_command
    from navbake.files import scratch_folder

    with scratch_folder() as folder, suppress(SystemExit):
        apartment = ROOT / "configs" / "apartment.yaml"
        run_command(["bake", str(apartment), "-o", str(folder / "apartment.grid.json")])


def encode_type(of: Any) -> Any:
    """Write one of numba's types as the list has it, see `navbake.compiled.Entry`."""
    from numba import types

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
    """Use what a bake, updates, the run time and voxel grids need."""
    from navbake.baker.pipeline import run_bake
    from navbake.baker.rooms.walls import find_windows
    from navbake.config.settings import as_config
    from navbake.files import scratch_folder

    with scratch_folder() as folder:
        path, hollow = folder / "warm-up.xml", folder / "hollow.xml"
        path.write_text(SCENE, encoding="utf-8")
        hollow.write_text(_draw_hollow(), encoding="utf-8")
        grids = [
            run_bake(as_config({"scene": {"path": path, "geoms": "all"}, **settings})).grid
            for settings in (
                {"attributes": ["island", "clearance"]},
                {"agent": {"radius": 0.2}, "rooms": {"from": ["auto"]}},
            )
        ]
        coarse = {"cell_size": 0.3}
        config = as_config({"scene": {"path": hollow, "geoms": "all"}, "grid": coarse})
        grids.append(run_bake(config).grid)
        soup = folder / "soup.ply"
        soup.write_bytes(_draw_soup())
        grids.append(run_bake(as_config({"scene": {"path": soup}, "grid": coarse})).grid)
        wall = np.zeros((40, 40), dtype=np.bool_)
        wall[20], wall[20, 15:25] = True, False
        find_windows(~wall & (np.arange(40) == 20)[:, None], wall, 0.1)  # no small scene has a sill
        moving = folder / "moving.xml"
        moving.write_text(MOVING, encoding="utf-8")
        _use_baker(navbake.Baker(moving, scene={"geoms": "all"}, grid={"cell_size": 0.1}))
        for number, grid in enumerate(grids):
            file = folder / f"{number}.grid.json"
            grid.save(file)
            _use_run_time(navbake.load(file))
            grid.to_mesh()
            grid.to_geojson()
            grid.to_mjcf(folder / f"{number}.walls.xml", flat=True)
        foreign = folder / "foreign.json"
        foreign.write_text(json.dumps(FOREIGN), encoding="utf-8")
        navbake.load(foreign).inflate(0.3)
        _use_voxels(navbake.Voxelizer(path), folder)


def _use_baker(baker: Any) -> None:
    """Move things about."""
    baker.update(joints={"hinge": 0.8})
    for place in ((-0.1, 0.0, 0.2), (-2.0, -0.8, 0.3), (1.0, 0.5, 0.02), (9.0, 9.0, 0.2)):
        baker.update(bodies={"one": place})
    baker.update(bodies={"two": (0.1, 0.6, -0.06), "one": (0.0, -0.6, 0.2)})
    for place in ((-2.05, 0.7, 0.2), (-1.0, -0.5, 0.2)):  # the niche is closed, and opened
        baker.update(bodies={"one": place})


def _draw_hollow() -> str:
    """Write the scene with a mesh that has a cavity."""
    inner = [(0.9 * x, 0.9 * y, 0.9 * z) for x, y, z in CORNERS]
    faces = [*FACES, *((a + 8, c + 8, b + 8) for a, b, c in FACES)]
    return HOLLOW.format(
        vertices=_join([*CORNERS, *inner]),
        faces=_join(faces),
        hall=_join(CORNERS),
        hall_faces=_join(FACES),
    )


def _draw_soup() -> bytes:
    """Write a box that lacks a triangle, with a low block in it, as a binary PLY."""
    block = [(0.3 * x, 0.3 * y, 0.4 * z - 1.6) for x, y, z in CORNERS]
    # narrow, so that it is asked whether it lies on its side
    corners = [*((2.0 * x, 1.8 * y, 2.0 * z) for x, y, z in CORNERS), *block]
    faces = [*FACES[:-1], *((a + 8, b + 8, c + 8) for a, b, c in FACES)]
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(corners)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    vertices = (struct.pack("<3f", *corner) for corner in corners)
    return (
        header.encode() + b"".join(vertices) + b"".join(struct.pack("<B3i", 3, *f) for f in faces)
    )


def _join(rows: Iterable[tuple[float, ...]]) -> str:
    return " ".join(f"{value}" for row in rows for value in row)


def _use_voxels(voxelizer: navbake.Voxelizer, folder: Path) -> None:
    """Make voxels of each type, and write and read them."""
    voxelizer.set_pose(joints={"hinge": 0.5})
    place = (0.0, 0.0, 1.0), (20, 20, 20)
    for suffix in ("binvox", "npz", "bt", "ot"):
        voxelizer.create(*place, res=0.1, align=True).save(folder / f"voxels.{suffix}")
        navbake.load_voxels(folder / f"voxels.{suffix}")
    voxelizer.create(*place, res=0.1, segments="top").save(folder / "ids.binvox")
    navbake.load_voxels(folder / "ids.binvox")
    voxelizer.create(*place, res=0.1, segments={"*": 999})


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
