"""The command `navbake warm-up`: compiles the kernels, so that no first bake or query waits.

It bakes small scenes and uses the grids: the command line is above the baker and the run time.
"""

from __future__ import annotations

import importlib
import json
import pkgutil
import struct
from collections.abc import Callable, Iterable
from pathlib import Path

from typer import Option

import navbake
from navbake.baker.scene.guard.scratch import scratch_folder
from navbake.cli.options import check_output
from navbake.cli.printing import VOLUME, print_warnings, say_unless_quiet
from navbake.errors import NavbakeError

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


def warm_up(
    archive: Path | None = Option(
        None, "--archive", metavar="FILE", help="Pack the compiled code, too, into a .tar.gz."
    ),
    unpack: Path | None = Option(
        None,
        "--unpack",
        metavar="FILE",
        help="Take what such a file has first; it holds programs: trust whoever made it.",
    ),
) -> None:
    """Compile all kernels for this machine, once.

    It takes some minutes. Without it, the first bake and the first query compile what they use.
    Other machines with the same processor, numba and navbake need not compile if they get the code
    by --archive and --unpack.

    Example: navbake warm-up --archive kernels.tar.gz
    """
    from navbake.cli.progress import stage_progress  # loads rich
    from navbake.compiler.archive import pack_kernels, unpack_kernels  # loads numba
    from navbake.dispatch import REMEDY, can_keep  # loads numba
    from navbake.formats.source import read_bytes, write_bytes  # loads numpy

    if archive is not None:
        own = [] if unpack is None else [unpack]
        check_output(archive, ".tar.gz", inputs=own, option="--archive")
    load_kernels()
    if not can_keep():
        lost = f"no folder for compiled code can be written, so nothing can be kept: {REMEDY}"
        if archive is not None:
            raise NavbakeError(lost)
        print_warnings([lost])
        return
    if unpack is not None:
        expected = "an archive of navbake warm-up"
        content, name = read_bytes(unpack, begins=b"\x1f\x8b", expected=expected)
        found = unpack_kernels(content, name)
        if found.why_not is not None:
            print_warnings([f"nothing of {unpack} is of use here: {found.why_not}"])
    with stage_progress(title="compiling", hidden=VOLUME.quiet) as progress:
        compile_all(progress)
    cold = cold_kernels()
    if cold:
        print_warnings([f"not compiled, or not kept: {', '.join(cold)}"])
    else:
        say_unless_quiet("compiled: bakes and queries start at once from now on")
    if archive is not None:
        write_bytes(pack_kernels(), archive)


def pack_code() -> bytes | None:
    """Pack the compiled code of this machine; None where none is kept."""
    from navbake.compiler.archive import pack_kernels  # loads numba
    from navbake.dispatch import can_keep  # loads numba

    load_kernels()
    return pack_kernels() if can_keep() else None


def take_code(code: bytes | None) -> str | None:
    """Take compiled code that another machine packed, or compile what all bakes need.

    Returns:
        What its owner should know, a line; None if the code did.
    """
    from navbake.compiler.archive import unpack_kernels  # loads numba

    load_kernels()
    if not bakes_compile():
        return None
    why_not = why_not_shared()
    if why_not is not None:
        return why_not
    found = None if code is None else unpack_kernels(code, "the batch's compiled code")
    if not bakes_compile():
        return None
    compile_all(lambda name, share: None)
    unused = "" if found is None or found.why_not is None else f"; of the batch's, {found.why_not}"
    return f"it has compiled code of its own, once{unused}"


def why_not_shared() -> str | None:
    """Why each worker has to compile its own code, a line; None if all find it on disk."""
    from navbake.dispatch import REMEDY, can_keep  # loads numba

    if can_keep():
        return None
    return f"no folder for compiled code can be written: each worker compiles its own: {REMEDY}"


def bakes_compile() -> bool:
    """Whether some of the kernels that all bakes call have never been compiled."""
    from navbake.kernel_list import PREFIX, read_list  # loads a compiler's helpers

    known = read_list()
    common = {PREFIX + entry.name for entry in known.entries[: known.num_common]}
    return not common.isdisjoint(cold_kernels())


def load_kernels() -> None:
    """Import all modules of kernels, so that one line tells how long all of them take."""
    for module in pkgutil.walk_packages(navbake.__path__, "navbake."):
        if ".kernels." in module.name:
            importlib.import_module(module.name)


def cold_kernels() -> list[str]:
    """Name the kernels imported so far that are not on disk."""
    from navbake.dispatch import list_cold  # loads numba

    return list_cold()


def compile_all(progress: Callable[[str, float], None]) -> None:
    """Compile what a bake, the run time and voxel grids need, and keep it on disk.

    numba keeps it beside the package, or in ``NUMBA_CACHE_DIR``. It is compiled again for another
    version of navbake or numba, and for another processor. `progress` is called with the name of
    each part, and 0 and 1 as it begins and ends.
    """
    import numpy as np  # --help does without it

    from navbake.baker.pipeline import run_bake  # loads MuJoCo
    from navbake.baker.rooms.windows import find_windows  # loads numba
    from navbake.config.settings import as_config  # loads pydantic

    with scratch_folder() as folder:
        path, hollow = folder / "warm-up.xml", folder / "hollow.xml"
        path.write_text(SCENE, encoding="utf-8")
        hollow.write_text(_draw_hollow(), encoding="utf-8")
        progress("bake", 0.0)
        grids = [
            run_bake(as_config({"scene": {"path": path, "geoms": "all"}, **settings})).grid
            for settings in (
                {"attributes": ["island", "clearance"]},
                {"agent": {"radius": 0.2}, "rooms": {"from": ["auto"], "door_width": 1.0}},
            )
        ]
        coarse = {"cell_size": 0.3}
        config = as_config({"scene": {"path": hollow, "geoms": "all"}, "grid": coarse})
        grids.append(run_bake(config).grid)
        soup = folder / "soup.ply"
        soup.write_bytes(_draw_soup())
        grids.append(run_bake(as_config({"scene": {"path": soup}, "grid": coarse})).grid)
        progress("bake", 1.0)
        wall = np.zeros((40, 40), dtype=np.bool_)
        wall[20], wall[20, 15:25] = True, False
        find_windows(~wall & (np.arange(40) == 20)[:, None], wall, 0.1)  # no small scene has a sill
        progress("update", 0.0)
        moving = folder / "moving.xml"
        moving.write_text(MOVING, encoding="utf-8")
        _use_baker(navbake.Baker(moving, scene={"geoms": "all"}, grid={"cell_size": 0.1}))
        progress("update", 1.0)
        progress("run time", 0.0)
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
        progress("run time", 1.0)
        progress("voxels", 0.0)
        _use_voxels(navbake.Voxelizer(path), folder)
        progress("voxels", 1.0)


def _use_baker(baker: navbake.Baker) -> None:
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
    import numpy as np  # --help does without it

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
        finder.are_navigable(np.stack([start, goal]))
        finder.is_navigable(start[:2], level=0)
        for offset in np.linspace(0.2, 2.0, 7):
            finder.snap(start + np.array([offset, 0.0, 0.0]), in_sight=True)
        finder.try_step(start, start + np.array([0.3, 0.2, 0.0]))
        both = np.stack([start, goal])
        finder.many.snap(both)
        finder.many.clearance(both)
        finder.many.try_step(both, both + np.array([0.3, 0.2, 0.0]))
        finder.line_of_sight(start, goal)
        finder.nearest_obstacle(start)
        finder.max_radius(start, goal)
        finder.reachable_positions(start, 0.3)
        path = finder.find_path(start, start + np.array([0.02, 0.02, 0.0]))
        if path is not None:
            finder.follow(path).command(start, 0.0)
        with agent.block(disc=(start, 0.3)):
            finder.find_path(start, goal)
