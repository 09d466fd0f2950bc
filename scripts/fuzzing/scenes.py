"""Scenes that MuJoCo's own compiler reads: MJCF, URDF and MJB, with what lies beside them."""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ElementTree
from contextlib import suppress
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import mujoco
import numpy as np
import trimesh

from fuzzing.images import bomb, grey_png, header, join_png, mutate_png
from fuzzing.kind import Input
from fuzzing.meshes import ENTITIES, make_obj, make_stl
from fuzzing.mutations import cut, mutate_bytes, mutate_text
from navbake.baker.scene.model import catch_warnings
from navbake.baker.scene.scene import Scene, load_scene
from navbake.config.scene import SceneSettings
from navbake.formats.scene_files import find_inputs

MJCF = (
    """<mujoco model="a"><compiler angle="degree" autolimits="true"/>
<option timestep="0.01"/><size nkey="1" memory="1M"/>
<asset><mesh name="m" file="m.obj" scale="1 1 1"/><hfield name="h" file="h.png" size="2 2 1 .1"/>
<hfield name="g" nrow="4" ncol="5" size="1 1 1 .1"/>
<texture name="t" type="2d" builtin="checker" width="32" height="32"/>
<texture name="u" type="2d" file="h.png"/><material name="w" texture="t" texrepeat="3 3"/></asset>
<worldbody><light pos="0 0 3"/><geom name="floor" type="plane" size="5 5 .1" material="w"/>
<geom type="hfield" hfield="h"/><geom type="hfield" hfield="g" pos="4 0 0"/>
<body name="b" pos="1 0 1" euler="0 0 45"><freejoint/><geom type="mesh" mesh="m" mass="1"/></body>
<body name="d" pos="0 1 1"><joint name="j" type="hinge" axis="0 0 1" range="0 90"/>
<geom type="box" size=".4 .02 1"/><site name="s" type="box" size="1 1 1"/></body>
<replicate count="4" offset="1 0 0"><geom type="sphere" size=".2"/></replicate></worldbody>
<keyframe><key name="k" qpos="0 0 1 1 0 0 0 0"/></keyframe></mujoco>""",
    """<mujoco><include file="part.xml"/><default><geom rgba="1 0 0 1"/><default class="c">
<geom type="capsule" size=".1 .5"/></default></default>
<worldbody><frame pos="1 0 0"><geom class="c" fromto="0 0 0 1 0 0"/></frame>
<geom type="cylinder" size=".3 1" zaxis="1 0 1"/><geom type="ellipsoid" size=".3 .2 .1"/>
<body><joint type="slide"/><geom type="box" size="1 1 1" density="500"/></body>
<flexcomp name="f" type="grid" count="3 3 1" spacing=".1 .1 .1" dim="2" rigid="true"/></worldbody>
<contact><exclude body1="world" body2="world"/></contact></mujoco>""",
)
PART = '<mujoco><worldbody><geom name="part" type="box" size="3 3 .1"/></worldbody></mujoco>'
URDF = """<robot name="r"><link name="a"><visual><origin xyz="0 0 1" rpy="0 0 1"/><geometry>
<box size="1 2 3"/></geometry></visual><collision><geometry><mesh filename="package://p/m.stl"
scale="1 1 1"/></geometry></collision><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"
ixy="0" ixz="0" iyz="0"/></inertial></link><link name="b"><collision><geometry>
<cylinder radius=".5" length="1"/></geometry></collision></link><joint name="j" type="revolute">
<parent link="a"/><child link="b"/><axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1"
velocity="1"/></joint></robot>"""
VALUES = (
    *("0.5", "-0.01", "2", "1e-7", "1e4", "3", "7", "-1.5", "1e6", "0.001"),
    *("", "0", "-1", "1e308", "-1e308", "nan", "inf", "1e-320", "0 0 0", "1 2 3 4 5 6 7 8 9", "x"),
    *("2147483647", "2147483648", "4294967296", "9223372036854775808", "100000", "mesh", "plane"),
    *("hfield", "sdf", "true", "h.png", "m.obj", "part.xml", "input.xml", "..", "/dev/zero", "no"),
    *("a" * 5000, "é\u202e", "m", "world", "d", "50000 50000", "1e10 1e10 1e10", "auto", "cable"),
)


def make_mjcf(rng: Random) -> Input:
    """MJCF with other attributes and elements, and files beside it that may be broken."""
    text = rng.choice(MJCF)
    beside = {"m.obj": _box("obj"), "h.png": grey_png(), "part.xml": PART.encode()}
    if rng.random() < 0.2:
        name = rng.choice(list(beside))
        if name == "m.obj":
            beside[name] = make_obj(rng).data
        elif name == "h.png":
            beside[name] = _field(rng)
        else:
            beside[name] = mutate_text(beside[name], rng, b' \n"<>/=')
    return Input(_mutate_xml(text, rng), ".xml", beside)


def _field(rng: Random) -> bytes:
    if rng.random() < 0.05:
        return bomb(*rng.choice(((3000, 2), (5500, 0))))
    if rng.random() < 0.3:
        return join_png([header(50_000, 50_000), (b"IDAT", b"x\x9c\x03\0\0\0\0\1"), (b"IEND", b"")])
    return mutate_png(grey_png(), rng)


def make_urdf(rng: Random) -> Input:
    """URDF with other attributes and elements, and a mesh that may be broken."""
    mesh = make_stl(rng).data if rng.random() < 0.2 else _box("stl")
    return Input(_mutate_xml(URDF, rng), ".urdf", {"m.stl": mesh})


@cache
def _box(kind: str) -> bytes:
    data: Any = trimesh.creation.box((1, 1, 1)).export(file_type=kind)
    return data.encode() if isinstance(data, str) else bytes(data)


@cache
def _compiled() -> bytes:
    text = MJCF[0].replace('file="m.obj"', 'vertex="0 0 0 1 0 0 0 1 0 0 0 1"')
    text = text.replace('<hfield name="h" file="h.png"', '<hfield name="h" nrow="3" ncol="3"')
    model = mujoco.MjModel.from_xml_string(text.replace('file="h.png"', 'builtin="flat" width="4"'
                                           ' height="4"'))  # fmt: skip
    size = mujoco.mj_sizeModel(model)
    buffer = np.zeros(size, dtype=np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


def make_mjb(rng: Random) -> Input:
    """A compiled model with other bytes, most of them in the numbers at its beginning."""
    data = bytearray(_compiled())
    if rng.random() < 0.5:
        return Input(cut(mutate_bytes(bytes(data), rng), rng), ".mjb")
    for _ in range(rng.choice((1, 1, 2))):
        at = 4 * rng.randrange(120)
        number = rng.choice((0, 1, 3, 2**31 - 1, 2**31, 2**32 - 1, 1000))
        data[at : at + 4] = number.to_bytes(4, "little")
    return Input(cut(bytes(data), rng), ".mjb")


def _mutate_xml(text: str, rng: Random) -> bytes:
    """XML with other attributes, elements removed, doubled, moved or wrapped; or other text."""
    chance = rng.random()
    if chance < 0.15:
        return cut(mutate_text(text.encode(), rng, b' \n"<>/='), rng)
    root = ElementTree.fromstring(text)
    for _ in range(rng.choice((1, 1, 2, 3))):
        parents = [element for element in root.iter() if len(element)]
        if not parents:
            break
        parent = rng.choice(parents)
        at = rng.randrange(len(parent))
        child, kind = parent[at], rng.randrange(12)
        if kind < 8 and child.attrib:
            _change_value(child, rng)
        elif kind == 8:
            parent.remove(child)
        elif kind == 9:
            parent.insert(at, copy.deepcopy(rng.choice(list(parent))))
        elif kind == 10:
            _wrap(parent, at, rng)
        else:
            child.tag = rng.choice([element.tag for element in root.iter()])
    data = ElementTree.tostring(root)
    if rng.random() < 0.01:
        deep = rng.choice((500, 20_000))
        data = data.replace(b"<worldbody>", b"<worldbody>" + b"<body>" * deep, 1)
        data = data.replace(b"</worldbody>", b"</body>" * deep + b"</worldbody>", 1)
    if chance < 0.18:
        data = rng.choice(ENTITIES) + data.replace(b'name="', b'name="&a9;', 1)
    return cut(data, rng)


def _change_value(element: ElementTree.Element, rng: Random) -> None:
    """Another value of an attribute, or of one word of it, so that the count stays right."""
    key = rng.choice(list(element.attrib))
    words = element.attrib[key].split() or [""]
    if rng.random() < 0.5:
        words = [""]
    words[rng.randrange(len(words))] = rng.choice(VALUES)
    element.set(key, " ".join(words))


def _wrap(parent: ElementTree.Element, at: int, rng: Random) -> None:
    """Put many elements round one."""
    child = parent[at]
    tag = rng.choice(("body", "frame", "replicate", "default", "x"))
    for _ in range(rng.choice((1, 3, 8))):
        outer = ElementTree.Element(tag, {"count": "9"} if tag == "replicate" else {})
        outer.append(child)
        child = outer
    parent[at] = child


def read_scene(path: Path) -> Scene:
    """Load a scene, and list the files that it is made of, as a batch does."""
    find_inputs(path)
    return load_scene(SceneSettings(path=path))


def compile_alone(path: Path) -> None:
    """Do what MuJoCo does for `read_scene`, without navbake: compile a file, and pose the model."""
    with suppress(Exception), catch_warnings():  # what it refuses, it refuses
        model = _load_alone(path)
        mujoco.mj_kinematics(model, mujoco.MjData(model))


def _load_alone(path: Path) -> Any:
    if path.suffix == ".mjb":
        return mujoco.MjModel.from_binary_path(str(path))
    spec = mujoco.MjSpec.from_file(str(path))
    for mesh in spec.meshes:
        if hasattr(mesh, "octree_maxdepth"):
            mesh.octree_maxdepth = 0  # as navbake has it
    return spec.compile()


def check_scene(scene: Scene) -> None:
    """Its report has a line for each geom, and its box is finite."""
    if len(scene.geoms) != scene.model.ngeom:
        raise AssertionError("a geom is not in the report")
    if scene.bounds is not None and scene.bounds.shape != (2, 3):
        raise AssertionError(f"a box of shape {scene.bounds.shape}")
