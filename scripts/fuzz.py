"""Feeds readers with broken files, and prints a table of what came out.

    python scripts/fuzz.py                             # each reader, 2000 inputs
    python scripts/fuzz.py navgrid octree -n 100000    # some, and more
    python scripts/fuzz.py navgrid --atheris 600       # by the code that inputs reach [s]

A reader may read an input, or refuse it by an error of navbake in one line. Anything else is a
finding: another error or a warning, more than two seconds, more memory than the limits, a process
that dies. The input of a finding is kept in `--folder`. Readers run in processes of their own with
limits; hypothesis, or Atheris where it is installed (``pip install atheris``), changes the seeds:
at random, and by what costs a careless reader most. That is a fragment of the format's language
many times (comments that are opened and never closed), and words of the language in place of others
(aliases of aliases, merge keys, huge counts, halves of surrogate pairs).
"""

from __future__ import annotations

import argparse
import copy
import gzip
import io
import json
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import hypothesis
import numpy as np
from hypothesis import strategies as st

import navbake
from navbake.arena import map_descriptor
from navbake.auditor.audit import audit
from navbake.auditor.routes import audit_routes
from navbake.baker.readers.mesh import read_named_meshes
from navbake.baker.scene.scene import load_scene
from navbake.batch.scenes import list_jobs
from navbake.compiled import ensure_compiled
from navbake.config.settings import BakeConfig, SceneSettings, load_config
from navbake.episodes import read_episodes, write_episodes
from navbake.errors import NavbakeError
from navbake.formats.format_table import ROUTE_FORMATS
from navbake.formats.grscenes import encode_grscenes
from navbake.formats.nav2 import encode_nav2
from navbake.formats.navgrid import dumps_navgrid
from navbake.formats.npz import encode_grid_npz, encode_npz, read_grid_npz, read_npy, read_npz
from navbake.formats.octomap import encode_octomap
from navbake.formats.omnigibson import encode_omnigibson
from navbake.formats.procthor import encode_procthor
from navbake.formats.route_files import encode_routes, read_routes
from navbake.formats.scene_files import find_inputs
from navbake.formats.shapes import read_room_outlines
from navbake.formats.voxels import encode_binvox, read_voxels
from navbake.navgrid.grid import NavGrid
from navbake.routes.graph import Lane, Node, RouteGraph
from navbake.scores import read_trajectories
from navbake.views.describe import describe
from navbake.views.report import read_verification
from navbake.voxels.grid import VoxelGrid

READ, REFUSED, FINDING, SLOWEST = "read", "refused", "finding", "slowest s"
SECONDS = 2  # of the processor, that an input may take
GIB = 4  # of address space that a process may take beyond what it has when it starts
PATIENCE = 60.0  # for each input of a process on top of its number times `SECONDS` / 4 [s]
LONGEST_MESSAGE = 1500
FEW_VOXELS = 4_000_000

# ---------------------------------------------------------------- seeds

GRID: dict[str, Any] = {
    "type": "SceneGrid2D", "width": 3, "height": 2, "cellSize": 0.5, "min": [0, 0, 0], "unit": 1,
    "weights": {"type": "array", "encoding": "rle", "length": 6, "data": [1, 4, None, 2]},
    "tileAttributes": {
        "occupancy": {"datatype": "uint8", "encoding": "rle", "data": [0, 4, 1, 2]},
        "floorHeight": {"datatype": "float32", "encoding": "rle", "data": [0, 5, None, 1]},
        "roomIndex": {"datatype": "uint16", "encoding": "raw", "data": [1, 1, 1, 1, 0, 0]},
    },
    "userData": {"1": {"doors": ["door"], "objects": ["cup"], "walls": []}, "4": {"note": [1]}},
    "metadata": {
        "sceneId": "sample", "agentHeight": 1.5, "agentRadius": 0.2,
        "inflation": [{"radius": 0.2, "clearance": 0, "mode": "exact"}],
        "navbake": {
            "rooms": [{"index": 1, "id": "hall", "name": "Hall", "level": 0, "area": 2.5,
                       "centroid": [1, -1, 0], "source": "geoms", "neighbours": []}],
            "doors": [{"id": "door", "joint": "hinge", "rooms": ["hall", None], "state": "closed",
                       "cells": {"closed": [[0, [1, 2]]], "open": [[0, [5, 1]]]}}],
        },
    },
}  # fmt: skip
LEVEL = {key: value for key, value in GRID.items() if key != "metadata"}
HOUSE = {
    "type": "MultiLevelGrid", "cellSize": 0.5, "unit": 1, "extra": [1], "timings": {},
    "metadata": {"navbake": {"links": [0, 0, 1, 0], "levels": [{"name": "ground"}]}},
    "grids": [LEVEL, {**LEVEL, "min": [0, 3, 0]}],
}  # fmt: skip
HALL = [[0, 0], [4, 0], [4, 3], [0, 3], [0, 0]]
ROUTES = RouteGraph((Node("a", (0.0, 0.0, 0.0)), Node("b", (1.0, 0.0, 3.0), 1)),
                    (Lane(0, 1, "a - b", 1.0, 1.0, kind="lift", link="L"),),
                    level_names=("level 0", "level 1"))  # fmt: skip
OUTLINES = {"type": "FeatureCollection", "features": [
    {"type": "Feature", "properties": {"name": "hall", "level": 0},
     "geometry": {"type": "Polygon", "coordinates": [HALL, [[1, 1], [2, 1], [2, 2]]]}},
    {"type": "Feature", "properties": None, "geometry": {"type": "MultiPolygon",
     "coordinates": [[HALL], [[[5, 5, 0], [6, 5], [6, 6]]]]}}]}  # fmt: skip
VERIFICATION = {"ok": False, "checked": 100, "cells": 50, "findings": [
    {"kind": "free touches", "level": 0, "position": [0.5, 1, 0], "text": "a table"}]}  # fmt: skip
SETTINGS = (
    b"scene:\n  path: a.xml\n  keyframe: 0\n  meshes: {wall*: hull}\n  joints:\n    hinge: 0.5\n"
    b"agent: {height: 1.5, radius: 0.2}\ngrid: {cell_size: 0.1, bounds: [-2, -2, 2, 2]}\n"
    b"levels:\n  - {name: ground, ground: 0}\nrooms:\n  polygons:\n    - name: hall\n"
    b"      points: [[0, 0], [4, 0], [4, 3]]\n"
)
MJCF = (
    b'<mujoco><compiler meshdir="m"/><include file="part.xml"/><asset><mesh file="m.obj"/>'
    b'<texture file="t.png"/></asset><worldbody><body name="b"><geom type="box" size="1 1 1"/>'
    b"</body></worldbody></mujoco>"
)


SDF = (
    b'<sdf version="1.6"><world name="w"><model name="m"><pose>1 0 0 0 0 1</pose><link name="a">'
    b'<collision name="c"><geometry><box><size>1 2 3</size></box></geometry></collision></link>'
    b'<link name="b"><pose relative_to="f">0 0 1 0 0 0</pose><visual name="v"><geometry><plane>'
    b'<normal>0 0 1</normal><size>1 1</size></plane></geometry></visual></link><frame name="f" '
    b'attached_to="a"/><joint name="j" type="revolute"><parent>a</parent><child>b</child><axis>'
    b"<xyz>0 0 1</xyz><limit><lower>0</lower><upper>1</upper></limit></axis></joint></model>"
    b"</world></sdf>"
)
URDF = (
    b'<robot name="r"><link name="a"><collision><origin xyz="0 0 1" rpy="0 0 0"/><geometry>'
    b'<box size="1 2 3"/></geometry></collision></link><link name="b"><visual><geometry><cylinder '
    b'radius="1" length="2"/></geometry></visual></link><joint name="j" type="revolute"><parent '
    b'link="a"/><child link="b"/><axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1" '
    b'velocity="1"/></joint></robot>'
)
USDA = b"""#usda 1.0
(
    metersPerUnit = 0.01
    upAxis = "Y"
)
def Cylinder "A" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"])
{
    uniform token axis = "X"
    double height = 2
    double3 xformOp:translate = (1, 2, 3)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
def PhysicsRevoluteJoint "J"
{
    rel physics:body1 = </A>
    uniform token physics:axis = "Y"
    float physics:upperLimit = 90
}
def Mesh "M"
{
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
}
def PointInstancer "P"
{
    rel prototypes = </M>
    int[] protoIndices = [0, 0]
    point3f[] positions = [(0, 0, 1), (0, 0, 2)]
}
"""
BUILDING = {
    "coordinate_system": "cartesian_meters",
    "levels": {"L1": {
        "elevation": 0.0, "vertices": [[0, 0, 0, ""], [4, 0, 0, ""], [4, 3, 0, ""], [0, 3, 0, ""]],
        "floors": [{"vertices": [0, 1, 2, 3], "parameters": {}}], "walls": [[0, 1, {}]],
        "doors": [[1, 2, {"name": [1, "d"], "type": [1, "double_hinged"],
                          "motion_degrees": [3, 90], "right_left_ratio": [3, 1.0]}]]},
        "L2": {"elevation": 3.0, "vertices": []}},
    "lifts": {"A": {"x": 2, "y": 1, "yaw": 0, "width": 1, "depth": 1, "reference_floor_name": "L1",
                    "level_doors": {"L1": ["d"], "L2": ["d"]},
                    "doors": {"d": {"x": 0, "y": 0.5, "width": 0.8}}}},
}  # fmt: skip
EPISODES = (
    b'{"format":"navbake-episodes","version":1,"agent":{"radius":0.2,"height":1.2,"speed":null},'
    b'"grids":[{"scene":"a","digest":"00","file":null}],"sampler":{"task":{}},"seed":1,'
    b'"rejected":{"too near":2}}\n'
    b'{"id":"0","scene":"a","task":"point","start":[0,0,0],"heading":0.5,"goals":[{"position":'
    b'[1,2,0],"radius":0.2}],"distance":2.5,"straight":2.0,"levels":[0,0],"rooms":["0:1"]}\n'
)
HABITAT = {
    "episodes": [{"episode_id": "0", "scene_id": "b/a.glb", "start_position": [0, 0, 0],
                  "start_rotation": [0, 0, 0, 1], "goals": [], "object_category": "cup",
                  "info": {"geodesic_distance": 1.5, "navbake": {"levels": [0, 0]}},
                  "reference_path": [[0, 0, 0]], "instruction": {"instruction_text": "go"}}],
    "goals_by_category": {"a.glb_cup": [{"position": [1, 0, 0], "object_id": 3, "view_points": [
        {"agent_state": {"position": [1, 0, 1], "rotation": [0, 0, 0, 1]}, "iou": None}]}]},
    "category_to_task_category_id": {"cup": 0},
}  # fmt: skip
EPISODE_SPEC = {
    "house_index": 5, "scene_dataset": "b", "language": {"task_description": "find the cup"},
    "task": {"task_cls": "NavToObjTask", "robot_base_pose": [1, 2, 0, 1, 0, 0, 0],
             "pickup_obj_name": "cup", "pickup_obj_candidates": ["mug"],
             "pickup_obj_start_pose": [3, 4, 0.5, 1, 0, 0, 0], "succ_pos_threshold": 1.5},
}  # fmt: skip


@cache
def _grid() -> NavGrid:
    return navbake.load(json.dumps(GRID).encode())


@cache
def _voxels() -> VoxelGrid:
    rng = np.random.default_rng(0)
    return VoxelGrid(values=rng.integers(0, 4, (3, 4, 2)).astype(np.uint16), origin=(0, 0, 0),
                     res=0.25, names={1: "a", 2: "é", 3: "c"},
                     known=rng.random((3, 4, 2)) < 0.8)  # fmt: skip


def _bytes_of(files: Any, ending: str = "") -> bytes:
    """The content of the file with this ending."""
    content = next(data for path, data in files.items() if path.name.endswith(ending))
    return content if isinstance(content, bytes) else b"".join(content)


def _meshes(kind: str) -> list[bytes]:
    import trimesh

    scene = trimesh.Scene([trimesh.creation.box((1, 2, 1)), trimesh.creation.cone(1, 2)])
    whole = scene if kind in ("glb", "obj") else scene.to_geometry()
    data = whole.export(file_type=kind)
    return [data.encode() if isinstance(data, str) else bytes(data)]


def _packed_set(name: str) -> bytes:
    """A set as a file of this name."""
    with tempfile.TemporaryDirectory() as folder:
        lines, path = Path(folder, "a.jsonl"), Path(folder, f"b{name}")
        lines.write_bytes(EPISODES)
        write_episodes(read_episodes(lines), path)
        return path.read_bytes()


def _trajectories() -> bytes:
    file = io.BytesIO()
    start, positions = np.array([0, 2, 3]), np.zeros((3, 3))
    np.savez(file, episode=np.array(["0", "1"]), start=start, positions=positions)
    return file.getvalue()


def _array() -> bytes:
    with tempfile.TemporaryFile() as file:
        np.save(file, np.ones((4, 3), dtype=np.uint8))
        file.seek(0)
        return file.read()


# ---------------------------------------------------------------- readers


class Reader(NamedTuple):
    """What reads a kind of file.

    Attributes:
        read: reads the file, and does with it what users do.
        seeds: makes good files; JSON as trees, whose values are changed one by one.
        suffix: how the file's name ends.
        beside: makes a further file in the folder, by name.
    """

    read: Callable[[Path], object]
    seeds: Callable[[], list[Any]]
    suffix: str
    beside: Callable[[], dict[str, bytes]] = dict


def use_grid(grid: NavGrid) -> None:
    """Describe, save and load again, and look at doors and cells."""
    for level in grid.levels:
        _ = level.rooms, level.doors, level.free, level.floor_height, level.room_index
    if sum(level.width * level.height for level in grid.levels) > 1_000_000:
        return
    describe(grid)
    audit(grid)
    _attempt(lambda: grid.with_doors("open"))
    written = dumps_navgrid(grid)
    assert dumps_navgrid(navbake.load(written)) == written, "another grid after it was written"


def use_voxels(path: Path) -> None:
    """Ask for what voxels hold, write and read them."""
    grid = read_voxels(path, max_voxels=FEW_VOXELS)
    _ = grid.bounds, grid.ids()
    if grid.values.size < 1_000_000:
        _attempt(lambda: encode_binvox(grid))
        again = read_npz(encode_npz(grid))
        assert np.array_equal(grid.values, again.values), "other voxels after they were written"


def use_mesh(path: Path) -> None:
    """Parts have names of their own, finite corners, and triangles of these."""
    parts = read_named_meshes(path)
    assert len({part.name for part in parts}) == len(parts), "two parts have one name"
    for part in parts:
        faces: Any = part.faces
        assert np.isfinite(part.vertices).all(), "a corner is not finite"
        assert 0 <= faces.min() <= faces.max() < len(part.vertices), "a triangle has no corner"


def use_routes(path: Path, name: str) -> None:
    """Read a graph of routes, and look at it on a grid."""
    audit_routes(read_routes(path, name), _grid())


def use_scene(path: Path) -> None:
    """Load a scene of pieces."""
    load_scene(BakeConfig(scene=SceneSettings(path=path)))


def use_descriptor(path: Path) -> None:
    """Decode a descriptor, encode it again and draw it."""
    part1, _, part2 = path.read_text(encoding="utf-8", errors="replace").partition("/")
    found = map_descriptor.decode(part1, part2, (4, 3))
    assert np.array_equal(map_descriptor.decode(*map_descriptor.encode(*found), (4, 3)), found)
    map_descriptor.draw(*found)


def _attempt(action: Callable[[], object]) -> None:
    """A question may have no answer, if that is said."""
    try:
        action()
    except NavbakeError as error:
        check_message(error)


def check_message(error: NavbakeError) -> None:
    """Errors are one line that fits a terminal."""
    message = str(error)
    assert message.isprintable() and 0 < len(message) <= LONGEST_MESSAGE, "not one line"


def _map_image() -> dict[str, bytes]:
    return {"a.pgm": _bytes_of(encode_nav2(_grid(), Path("a.yaml")), "pgm")}


GOOD = np.eye(4, 3, dtype=bool)
READERS = {
    "navgrid": Reader(lambda p: use_grid(navbake.load(p)), lambda: [GRID, HOUSE], ".json"),
    "navgrid-gz": Reader(lambda p: use_grid(navbake.load(p)),
                         lambda: [gzip.compress(json.dumps(GRID).encode())], ".json.gz"),
    "grid-npz": Reader(lambda p: use_grid(read_grid_npz(p)),
                       lambda: [_bytes_of(encode_grid_npz(_grid(), Path("a.npz")))], ".npz"),
    "nav2": Reader(lambda p: use_grid(navbake.from_nav2(p)),
                   lambda: [_bytes_of(encode_nav2(_grid(), Path("a.yaml")), "yaml")], ".yaml",
                   _map_image),
    "procthor": Reader(lambda p: use_grid(navbake.from_procthor(p)),
                       lambda: [_bytes_of(encode_procthor(_grid(), Path("a.png")))], ".png"),
    "omnigibson": Reader(lambda p: use_grid(navbake.from_omnigibson(p)),
                         lambda: [_bytes_of(encode_omnigibson(_grid(), Path("a.png")), "a_0.png")],
                         ".png"),
    "grscenes": Reader(lambda p: use_grid(navbake.from_grscenes(p)),
                       lambda: [_bytes_of(encode_grscenes(_grid(), Path("a.npy")))], ".npy"),
    "binvox": Reader(use_voxels, lambda: [encode_binvox(_voxels())], ".binvox"),
    "bt": Reader(use_voxels, lambda: [encode_octomap(_voxels(), "bt", free=True)], ".bt"),
    "ot": Reader(use_voxels, lambda: [encode_octomap(_voxels(), "ot", free=True)], ".ot"),
    "npz": Reader(use_voxels, lambda: [encode_npz(_voxels())], ".npz"),
    "names": Reader(lambda p: use_voxels(p.parent / "a.binvox"),
                    lambda: [{"ids": {"1": "a", "2": "b"}}], "a.binvox.names.json",
                    lambda: {"a.binvox": encode_binvox(_voxels())}),
    "npy": Reader(read_npy, lambda: [_array()], ".npy"),
    "descriptor": Reader(use_descriptor,
                         lambda: ["/".join(map_descriptor.encode(GOOD, GOOD)).encode()], ".txt"),
    **{kind: Reader(use_mesh, lambda kind=kind: _meshes(kind), f".{kind}")  # type: ignore[misc]
       for kind in ("ply", "stl", "obj", "glb", "dae")},
    "sdf": Reader(use_scene, lambda: [SDF], ".sdf"),
    "urdf": Reader(use_scene, lambda: [URDF], ".urdf"),
    "usda": Reader(use_scene, lambda: [USDA, USDA.replace(b"PhysicsCollisionAPI", b"A")],
                   ".usda"),
    "building": Reader(use_scene, lambda: [BUILDING], ".building.yaml"),
    "geojson": Reader(read_room_outlines, lambda: [OUTLINES], ".geojson"),
    **{form.name: Reader(lambda p, form=form: use_routes(p, form.name),  # type: ignore[misc]
                         lambda form=form: [encode_routes(ROUTES, "", form.name)],
                         form.endings[0]) for form in ROUTE_FORMATS},
    "settings": Reader(load_config, lambda: [SETTINGS], ".yaml"),
    "manifest": Reader(lambda p: list_jobs([str(p)]),
                       lambda: [{"scene": "a.xml", "id": "hall", "agent.radius": 0.2}], ".jsonl"),
    "list": Reader(lambda p: list_jobs([str(p)]), lambda: [b"a.xml\n# b\nc/d.xml\n"], ".txt"),
    "table": Reader(lambda p: list_jobs([str(p)]),
                    lambda: [b'scene,id,agent.radius\na.xml,hall,0.2\n"b.xml",,\n'], ".csv"),
    "verification": Reader(read_verification, lambda: [VERIFICATION], ".json"),
    "episodes": Reader(read_episodes, lambda: [EPISODES], ".jsonl"),
    "episodes-gz": Reader(read_episodes, lambda: [_packed_set("a.jsonl.gz")], ".jsonl.gz"),
    "parquet": Reader(read_episodes, lambda: [_packed_set("a.parquet")], ".parquet"),
    "habitat": Reader(read_episodes, lambda: [HABITAT], ".json"),
    "molmospaces": Reader(read_episodes, lambda: [[EPISODE_SPEC]], ".json"),
    "minos": Reader(read_episodes, lambda: [_packed_set("a.csv")], ".csv"),
    "minos-bz2": Reader(read_episodes, lambda: [_packed_set("a.csv.bz2")], ".csv.bz2"),
    "trajectories": Reader(read_trajectories,
                           lambda: [{"episode": "0", "positions": [[0, 0, 0]], "times": [0.5]}],
                           ".jsonl"),
    "trajectories-npz": Reader(read_trajectories, lambda: [_trajectories()], ".npz"),
    "inputs": Reader(find_inputs, lambda: [MJCF], ".xml"),
    "inputs-urdf": Reader(find_inputs, lambda: [URDF.replace(b"<box size", b"<mesh filename")],
                          ".urdf"),
    "inputs-sdf": Reader(find_inputs, lambda: [SDF.replace(b"<pose>", b"<uri>a.dae</uri><pose>")],
                         ".sdf"),
}  # fmt: skip

# ---------------------------------------------------------------- inputs

VALUES = st.sampled_from([
    *(None, True, [], {}, [[]], {"a": {}}, 0, -1, 1.5, 255, 65536, 2**31, 2**53 + 1, 2**64, 10**25),
    *(1e-308, 1e9, 1e39, 1e308, "", "x", "0", "nan", "../..", "/dev/zero", "\0", "\n", "a" * 300),
    *("rle", "raw", "uint32", "Feature", "MultiPolygon", "auto", "*"),
])  # fmt: skip
TOKENS = st.sampled_from([
    *(b"", b"0", b"-1", b"1e308", b"99999999999", b"nan", b"inf", b"null", b"true", b"[", b"{"),
    *(b"}", b'"', b",", b":", b" ", b"\n", b"\0", b"\xff", b"#", b"/", b"<", b"&", b"*", b"data"),
    *(b"\xff\xff\xff\xff", b"\0\0\0\0", b"\xff\xff\xff\x7f", b"[" * 2000, b"/dev/zero"),
])  # fmt: skip
EDITS = st.lists(st.tuples(st.floats(0, 1), st.integers(0, 8), TOKENS), min_size=1, max_size=4)
CHANGES = st.lists(st.tuples(st.lists(st.floats(0, 1), max_size=6), VALUES), max_size=3)


# Fragments of a language that are repeated, and words of it that replace others
ENDLESS_ALIAS = b"&a0 [1, 1]"
ENDLESS_MERGE = b"&m0 {k0: 1}"
for number in range(1, 20):
    ENDLESS_ALIAS = b"&a%d [%s, *a%d, *a%d]" % (number, ENDLESS_ALIAS, number - 1, number - 1)
    merged = b", ".join([ENDLESS_MERGE] + 9 * [b"*m%d" % (number - 1)])
    ENDLESS_MERGE = b"&m%d {<<: [%s], k%d: 1}" % (number, merged, number)
ENTITIES = b"<!DOCTYPE a [<!ENTITY e0 '0123456789'>%s]>" % b"".join(
    b"<!ENTITY e%d '%s'>" % (number, b"&e%d;" % (number - 1) * 10) for number in range(1, 10)
)
FRAGMENTS = {
    "xml": [b"<!--", b"<a>", b"<a ", b"<a b='", b"<![CDATA[", b"<?", b"&", b"<uri>", b"</a>", b"<",
            b"<model><link>", b" file='a'", b"<include file='input.xml'/>", b"<sdf>", b"'"],
    "yaml": [b"[", b"{", b"- ", b"&a ", b"? ", b"*a, ", b": ", b"'", b"{a: ", b"!a ", b"# \n",
             b"a: 1\n", b"- - ", b"&a [*a, "],
    "json": [b"[", b'{"a":', b'"', b"\\", b"[[],", b'"a":1,', b"{", b"\n"],
    "text": [b"v 0 0 0\n", b"f 1 2 3\n", b"solid ", b"(", b"[", b"element face 9\n", b"def ",
             b"node [ ", b'"', b"@", b"{", b"facet ", b"g a\n", b"\\\n", b"#"],
}  # fmt: skip
FRAGMENTS = {name: [*own, b" ", b"\n", b"1", b"_", b"\0"] for name, own in FRAGMENTS.items()}
WORDS = {
    "xml": [b"&#55296;", b"&#0;", b"&e9;", b"-->", b"]]>", b"a/" * 3000, ENTITIES],
    "yaml": [ENDLESS_ALIAS, ENDLESS_MERGE, b"&r [*r]", b"{<<: 1}", b'"\\ud800"', b"*none",
             b"!!binary x", b"!!set {a}", b'"\\0"', b".nan", b"-.inf"],
    "json": [b'"\\ud800"', b'"\\u0000"', b"1e400", b"NaN", b"-0.0", b'{"a": 1, "a": 2}',
             b'"%sx"' % (b"1" * 30000), b'"%sx"' % (b"_" * 30000), b'"\\ud83d\\ude00"'],
    "text": [b"\xed\xa0\x80", b"1e400", b"-nan", b"&#55296;", b"1" * 400, b"true"],
}  # fmt: skip
COUNTS = [b"9" * 5000, b"99999999999999999999", b"9223372036854775807", b"4294967296",
          b"2000000000", b"1e300", b"1e39", b"-1e30", b"70000.5", b"inf", b"-1"]  # fmt: skip
LANGUAGES = dict.fromkeys((".sdf", ".xml", ".urdf", ".dae", ".graphml"), "xml")
LANGUAGES |= dict.fromkeys((".yaml",), "yaml")
LANGUAGES |= dict.fromkeys((".json", ".geojson", ".jsonl"), "json")
WORD = re.compile(rb"[\w.+-]+")


def repeat_fragment(data: bytes, share: float, fragment: bytes, count: int) -> bytes:
    """Bytes with a fragment in them, so many times; the place is a share of all."""
    start = int(share * len(data))
    return data[:start] + fragment * count + data[start:]


def change_words(data: bytes, changes: list[tuple[float, bytes]]) -> bytes:
    """Text with other words in place of some; a place is a share of all words."""
    for share, word in changes:
        spans = [match.span() for match in WORD.finditer(data[:200_000])]
        if spans:
            start, end = spans[min(int(share * len(spans)), len(spans) - 1)]
            if data[start - 1 : start] == data[end : end + 1] == b'"' and share * 7 % 1 < 0.5:
                start, end = start - 1, end + 1  # a text with its quotes
            data = data[:start] + word + data[end:]
    return data


def change_tree(tree: Any, changes: list[tuple[list[float], Any]]) -> Any:
    """A JSON value with others at some places; a place is a share of each list or object."""
    holder = [copy.deepcopy(tree)]
    for way, value in changes:
        parent: Any = holder
        key: Any = 0
        for share in way:
            child = parent[key]
            if not isinstance(child, dict | list) or not child:
                break
            keys = list(child) if isinstance(child, dict) else range(len(child))
            parent, key = child, keys[min(int(share * len(keys)), len(keys) - 1)]
        parent[key] = copy.deepcopy(value)
    return holder[0]


def change_bytes(data: bytes, edits: list[tuple[float, int, bytes]]) -> bytes:
    """Bytes with some replaced by tokens; a place is a share of all."""
    for share, length, token in edits:
        start = int(share * len(data))
        data = data[:start] + token + data[start + length :]
    return data


def inputs_of(reader: Reader) -> st.SearchStrategy[bytes]:
    """Files for a reader: seeds with changes."""
    seeds = reader.seeds()
    trees = [seed for seed in seeds if not isinstance(seed, bytes)]
    files = [seed if isinstance(seed, bytes) else json.dumps(seed).encode() for seed in seeds]
    broken = st.builds(change_bytes, st.sampled_from(files), EDITS)
    language = LANGUAGES.get(Path(f"a{reader.suffix}").suffix, "text")
    share = st.floats(0, 1)
    repeated = st.builds(repeat_fragment, st.sampled_from(files), share,
                         st.sampled_from(FRAGMENTS[language]),
                         st.sampled_from([10_000, 3000, 300]))  # fmt: skip
    word = st.sampled_from([*WORDS[language], *COUNTS])
    reworded = st.builds(change_words, st.sampled_from(files),
                         st.lists(st.tuples(share, word), min_size=1, max_size=3))  # fmt: skip
    hostile = repeated | reworded
    if not trees:
        return hostile | broken
    changed = st.builds(change_tree, st.sampled_from(trees), CHANGES)
    return hostile | changed.map(lambda tree: json.dumps(tree).encode()) | broken


def use(reader: Reader, data: bytes, folder: Path) -> str:
    """Read one input: what came out, ``read``, ``refused``, or what is wrong."""
    return measure(reader, data, folder)[0]


def measure(
    reader: Reader, data: bytes, folder: Path, patience: float | None = None
) -> tuple[str, float]:
    """Read one input: what came out, see `use`, and the time of the processor that it took [s].

    Args:
        patience: when to interrupt the reader [s]; None for four times `SECONDS`.
    """
    patience = 4 * SECONDS if patience is None else patience
    path = folder / (reader.suffix if reader.suffix[0] != "." else f"input{reader.suffix}")
    for name, content in reader.beside().items():
        (folder / name).write_bytes(content)
    path.write_bytes(data)
    begin, outcome = time.process_time(), READ
    signal.signal(signal.SIGALRM, _interrupt)
    signal.setitimer(signal.ITIMER_REAL, patience)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("error", module="navbake")
            warnings.filterwarnings("error", category=RuntimeWarning)  # numpy's, also in trimesh
            warnings.filterwarnings("error", module="networkx")
            reader.read(path)
    except NavbakeError as error:
        outcome = REFUSED
        try:
            check_message(error)
        except AssertionError as problem:
            outcome = f"{problem}: {str(error)[:300]!r}"
    except Exception:  # whatever it is, it is a finding
        outcome = traceback.format_exc()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    took = time.process_time() - begin
    if took > SECONDS and outcome in (READ, REFUSED):
        outcome = f"took {took:.1f} s"
    return outcome, took


def _interrupt(*_: object) -> None:
    raise TimeoutError("not done after much more than an input may take")


# ---------------------------------------------------------------- runs


class Keeper:
    """Counts what came out, and keeps one input for each place of the code that was a finding."""

    def __init__(self, name: str, folder: Path) -> None:
        self.counts: Counter[str] = Counter()
        self.slowest = 0.0  # [s]
        self._name, self._reader, self._folder = name, READERS[name], folder
        self._found: set[str] = set()
        self.place = folder / f"{name}.work"
        self.place.mkdir(parents=True, exist_ok=True)

    def use(self, data: bytes) -> None:
        """Read one input."""
        what, took = measure(self._reader, data, self.place)
        self.slowest = max(self.slowest, took)
        is_fine = what in (READ, REFUSED)
        self.counts[what if is_fine else FINDING] += 1
        told = {**self.counts, SLOWEST: self.slowest}
        (self.place / "counts").write_text(json.dumps(told), encoding="ascii")
        lines = [line for line in what.splitlines() if line.startswith("  File")] or [what[:12]]
        if not is_fine and lines[-1] not in self._found:
            self._found.add(lines[-1])
            self.keep(data, what)

    def keep(self, data: bytes, what: str) -> None:
        """Keep an input, and print what is wrong."""
        number = len(list(self._folder.glob(f"{self._name}-*")))
        kept = self._folder / f"{self._name}-{number}{self._reader.suffix}"
        kept.write_bytes(data)
        print(f"--- {kept}\n{what.rstrip()}", flush=True)


def run_child(name: str, count: int, seed: int, folder: Path) -> None:
    """Use inputs of a reader in this process, which has a limit on its memory."""
    keeper, reader = Keeper(name, folder), READERS[name]
    ensure_compiled()
    for data in reader.seeds():  # loads what is loaded lazily, and compiles what isn't listed
        seed_file = data if isinstance(data, bytes) else json.dumps(data).encode()
        measure(reader, seed_file, keeper.place, PATIENCE * 10)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * resource.getpagesize() + (GIB << 30)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    settings = hypothesis.settings(
        max_examples=count, database=None, deadline=None, phases=[hypothesis.Phase.generate],
        suppress_health_check=list(hypothesis.HealthCheck),
    )  # fmt: skip
    hypothesis.seed(seed)(settings(hypothesis.given(inputs_of(reader))(keeper.use)))()


def run(name: str, count: int, seed: int, folder: Path) -> Counter[str]:
    """Use inputs of a reader in a process of its own; what came out."""
    command = [sys.executable, __file__, name, "--child", "-n", str(count), "--seed", str(seed)]
    place = folder / f"{name}.work"
    why = ""
    try:
        done = subprocess.run(
            [*command, "--folder", str(folder)], timeout=PATIENCE + count * SECONDS / 4
        )
        why = f"the process ended with {done.returncode}" if done.returncode else ""
    except subprocess.TimeoutExpired:
        why = "the process was not done in time"
    told = place / "counts"
    counts = Counter(json.loads(told.read_text(encoding="ascii"))) if told.exists() else Counter()
    if why:
        last = max(place.glob("*"), key=lambda path: path.stat().st_mtime_ns, default=None)
        Keeper(name, folder).keep(b"" if last is None else last.read_bytes(), why)
        counts[FINDING] += 1
    return counts


def search(name: str, seconds: int, folder: Path) -> None:
    """Let Atheris search inputs of one reader by what they reach; libFuzzer ends the process."""
    import atheris

    keeper, corpus = Keeper(name, folder), folder / f"{name}.corpus"
    corpus.mkdir(exist_ok=True)
    for number, seed in enumerate(READERS[name].seeds()):
        data = seed if isinstance(seed, bytes) else json.dumps(seed).encode()
        (corpus / f"seed-{number}").write_bytes(data)
    atheris.instrument_all()
    options = [f"-max_total_time={seconds}", f"-artifact_prefix={folder}/", str(corpus)]
    atheris.Setup([sys.argv[0], *options], keeper.use)
    atheris.Fuzz()


def main() -> None:
    """Run what the command line asks for; exit status 1 with findings."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("readers", nargs="*", metavar="READER", help=", ".join(READERS))
    parser.add_argument("-n", "--count", type=int, default=2000, help="inputs of each")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, help="keeps the inputs of findings")
    parser.add_argument("--atheris", type=int, metavar="SECONDS", help="search one reader")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    names = given.readers or list(READERS)
    if unknown := sorted(set(names) - set(READERS)):
        parser.error(f"no reader {unknown[0]}; there are {', '.join(READERS)}")
    folder = given.folder or Path(tempfile.mkdtemp(prefix="fuzz-"))
    folder.mkdir(parents=True, exist_ok=True)
    if given.child:
        run_child(names[0], given.count, given.seed, folder)
        return
    if given.atheris is not None:
        search(names[0], given.atheris, folder)
        return
    print(f"{'reader':16}{READ:>9}{REFUSED:>9}{FINDING:>9}{SLOWEST:>11}", flush=True)
    findings = 0
    for name in names:
        counts = run(name, given.count, given.seed, folder)
        findings += counts[FINDING]
        line = "".join(f"{counts[what]:9,}" for what in (READ, REFUSED, FINDING))
        print(f"{name:16}{line}{counts[SLOWEST]:11.2f}", flush=True)
    if findings:
        sys.exit(f"{findings} findings, kept in {folder}")


if __name__ == "__main__":
    main()
