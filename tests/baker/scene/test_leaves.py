"""Which bodies may be doors; how they are named and posed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from door_scenes import CUPBOARD, LEAF, ROOMS, bake_world, world
from navbake.baker.bake.pipeline import run_bake
from navbake.baker.doors.posed_leaves import pose_shapes
from navbake.baker.scene.collect import collect_shapes
from navbake.baker.scene.leaves import DoorCandidate, find_door_candidates
from navbake.baker.scene.names import find_subtree_ends, geoms_of_bodies
from navbake.baker.scene.scene import Scene
from navbake.config.settings import DoorSettings, SceneSettings, load_config, parse_config
from project_paths import CONFIGS
from scenes_alone import load_alone

HANDLE = '<body name="handle" pos="0 0.8 1"><geom type="sphere" size="0.03"/></body>'
LEAF_WITH_HANDLE = LEAF.replace("</body>", HANDLE + "</body>")


@pytest.fixture
def load(tmp_path: Path):
    def run(*parts: str) -> Scene:
        (tmp_path / "scene.xml").write_text(world(*parts), encoding="utf-8")
        return load_alone(SceneSettings(path=tmp_path / "scene.xml"))

    return run


def look_for(scene: Scene, **settings: Any) -> tuple[list[DoorCandidate], list[str]]:
    """The leaves that a scene has by settings of doors, and the patterns that match none."""
    return find_door_candidates(
        scene.model,
        scene.data,
        shapes=scene.shapes,
        is_counted=np.array([geom.counted for geom in scene.geoms]),
        is_movable_body=scene.is_movable_body,
        is_structure_body=scene.is_structure_body,
        named_leaves=scene.named_leaves,
        settings=DoorSettings(**settings),
    )


# ---------------------------------------------------------------- patterns


def test_pattern_makes_a_door_of_anything(tmp_path):
    settings = {"doors": {"patterns": ["cupboard_d*"]}}
    grid = bake_world(tmp_path, ROOMS, LEAF, CUPBOARD, **settings).grid
    assert [door.id for door in grid.doors] == ["leaf", "cupboard_door"]


def test_nothing_is_found_when_nobody_looks(tmp_path):
    assert bake_world(tmp_path, ROOMS, LEAF, doors={"find": False}).grid.doors == ()


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [
        ("laef*", "'laef*' matches no body; near names are leaf"),
        ("portcullis", "'portcullis' matches no body"),
        ("handle", "'handle' matches only parts of other doors: handle"),
        ("han*", "'han*' matches only parts of other doors: handle"),
        ("empty", "'empty' matches only bodies without geoms that count: empty"),
    ],
)
def test_a_pattern_that_makes_no_door_is_told(load, pattern, expected):
    scene = load(ROOMS, LEAF_WITH_HANDLE, '<body name="empty"/>')
    doors, (warning,) = look_for(scene, patterns=[pattern])
    assert warning == f"`doors.patterns` pattern {expected}"
    assert [door.id for door in doors] == ["leaf"]


def test_what_hangs_on_a_door_is_part_of_it(load):
    scene = load(ROOMS, LEAF_WITH_HANDLE)
    ((door,), warnings) = look_for(scene, patterns=["leaf", "*"])
    assert warnings == []
    assert door.geoms.tolist() == [7, 8]


@pytest.mark.parametrize(
    ("find", "instead"),
    [
        ("0.02 0.43 1", "0.11 0.43 1"),  # too thick
        ("0.02 0.43 1", "0.02 0.19 1"),  # too narrow
        ("0.02 0.43 1", "0.02 1.26 1"),  # too wide
        ("0.02 0.43 1", "0.02 0.43 0.74"),  # too low
        ('<joint name="{0}leaf" axis="0 0 1" range="0 90"/>', "<freejoint/>"),
        ('range="0 90"/>', 'range="0 90"/><joint axis="1 0 0"/>'),
    ],
)
def test_what_does_not_look_like_a_door(load, find, instead):
    assert find in LEAF
    assert look_for(load(ROOMS, LEAF.replace(find, instead))) == ([], [])


@pytest.mark.parametrize(
    ("size", "joint"),
    [("0.1 0.43 1", ""), ("0.02 0.2 0.75", ""), ("0.02 1.25 1", 'type="slide" axis="0 1 0"')],
)
def test_what_just_looks_like_a_door(load, size, joint):
    leaf = LEAF.replace("0.02 0.43 1", size)
    leaf = leaf.replace('axis="0 0 1" range="0 90"', joint) if joint else leaf
    doors, _ = look_for(load(ROOMS, leaf))
    assert len(doors) == 1


# ---------------------------------------------------------------- names that are not UTF-8

NAMED = """
<site name="\xe9cran" type="box" pos="1.5 1.5 1" size="1.4 1.4 1"/>
<body name="port\xe9" pos="3 1.06 0"><joint name="p\xe9" axis="0 0 1" range="0 90"/>
<geom type="box" pos="0 0.44 1" size="0.02 0.43 1"/></body>
<body name="port\xe8" pos="0.02 1.06 0"><joint name="p\xe8" axis="0 0 1" range="0 90"/>
<geom type="box" pos="0 0.44 1" size="0.02 0.43 1"/></body>
<body name="arm\xe9" pos="5 2 0.5"><geom name="b\xf6x" type="box" size="0.2 0.2 0.5"/></body>
"""


@pytest.mark.parametrize("suffix", [".xml", ".mjb"])
def test_names_that_are_not_utf_8(tmp_path, suffix):
    path = tmp_path / "latin.xml"
    field = '<asset><hfield name="\xfc" nrow="2" ncol="2" size="1 1 1 0.1"/></asset>'
    hill = '<geom type="hfield" hfield="\xfc" pos="20 20 -2"/>'
    text = world(ROOMS, NAMED, hill).replace("<worldbody>", field + "<worldbody>")
    path.write_bytes(('<?xml version="1.0" encoding="latin-1"?>' + text).encode("latin-1"))
    if suffix == ".mjb":
        model = mujoco.MjModel.from_xml_path(str(path))
        path = tmp_path / "latin.mjb"
        mujoco.mj_saveModel(model, str(path))
    settings = {
        "grid": {"bounds": [0, 0, 6, 3]},
        "rooms": {"sites": ["?cran", "nothing"], "geoms": ["fl?or"], "from": ["sites", "auto"]},
        "names": {"walls": ["wall*", "m\xfcr*"]},
        "doors": {"patterns": ["port?", "porte"]},
    }
    result = run_bake(parse_config({"scene": {"path": path}, **settings}))
    grid = result.grid
    assert [door.id for door in grid.doors] == [
        "port\ufffd (body 1)",
        "port\ufffd (body 2)",
    ]
    assert {door.joint for door in grid.doors} == {"p\ufffd"}
    assert "\ufffdcran" in {room.name for room in grid.rooms}
    assert grid.blockers((5.0, 2.0)) == ["arm\ufffd"]
    assert grid.blockers((3.0, 1.5)) == ["port\ufffd (body 1)"]
    assert grid.with_doors({"port\ufffd (body 1)": "open"}).blockers((3.0, 1.65)) == []
    assert [text for text in result.warnings if "porte" in text and "near" in text]


def test_a_broken_height_field_whose_name_is_not_utf_8(tmp_path):
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><asset><hfield name="hill" nrow="2" ncol="2" size="1 1 1 0.1"/></asset>'
        '<worldbody><geom type="hfield" hfield="hill"/></worldbody></mujoco>'
    )
    model.hfield_data[0] = np.nan
    mujoco.mj_saveModel(model, str(tmp_path / "a.mjb"))
    path = tmp_path / "b.mjb"
    path.write_bytes((tmp_path / "a.mjb").read_bytes().replace(b"hill\0", b"h\xefll\0"))
    with pytest.raises(Exception, match="hfield 'h\ufffdll' has heights or a size that"):
        load_alone(SceneSettings(path=path))


# ---------------------------------------------------------------- trees and shapes


def test_subtrees_against_a_walk_up_the_parents():
    rng = np.random.default_rng(3)
    for _ in range(20):
        spec = mujoco.MjSpec()
        bodies = [spec.worldbody]
        for _ in range(25):
            bodies.append(bodies[rng.integers(len(bodies))].add_body())
            for _ in range(rng.integers(3)):
                bodies[-1].add_geom(size=[0.1, 0, 0], type=mujoco.mjtGeom.mjGEOM_SPHERE)
        model = spec.compile()
        ends = find_subtree_ends(model)
        for body in range(model.nbody):
            expected = [geom for geom in range(model.ngeom) if _hangs_on(model, geom, body)]
            assert geoms_of_bodies(model, body, int(ends[body])).tolist() == expected


def _hangs_on(model, geom: int, body: int) -> bool:
    above = int(model.geom_bodyid[geom])
    while above > body:
        above = int(model.body_parentid[above])
    return above == body


def arrays(shapes):
    yield from (getattr(shapes.solids, name) for name in ("geom", "kind", "pos", "mat", "bounds"))
    yield from (shapes.planes.geom, shapes.planes.mat, shapes.triangles.geom)
    yield from (shapes.triangles.corners, shapes.triangles.closed, shapes.is_endless)


@pytest.mark.parametrize("name", ["apartment", "house", "warehouse", "terrain", "clutter"])
def test_leaves_and_what_stands_are_what_is_collected_of_them(name):
    scene = load_alone(load_config(CONFIGS / f"{name}.yaml").scene)
    leaves = scene.leaves
    of_leaves = np.concatenate([[], *(leaf.geoms for leaf in leaves)]).astype(int).tolist()
    welded = scene.model.body_weldid[scene.model.geom_bodyid] == 0
    standing = [geom for geom in np.flatnonzero(welded).tolist() if geom not in of_leaves]
    for found, geoms in (
        (scene.structure, standing),
        (pose_shapes(scene, leaves, "modelled"), sorted(of_leaves)),
    ):
        expected, *_ = collect_shapes(
            scene.model, scene.data, scene.selections, scene.exact_meshes, geoms
        )
        for one, other in zip(arrays(found), arrays(expected), strict=True):
            np.testing.assert_array_equal(one, other)


def test_each_door_is_posed_as_if_it_moved_alone(load):
    scene = load(ROOMS, LEAF, CUPBOARD)
    assert len(scene.leaves) == 2
    for state in ("open", "closed"):
        together = pose_shapes(scene, scene.leaves, state)
        for door in scene.leaves:
            mask = np.zeros(scene.model.ngeom, dtype=bool)
            mask[door.geoms] = True
            data = mujoco.MjData(scene.model)
            data.qpos[scene.model.jnt_qposadr[door.joint_id]] = door.positions[state]
            mujoco.mj_forward(scene.model, data)
            solids = together.only(mask).solids
            np.testing.assert_array_equal(solids.pos, data.geom_xpos[solids.geom])
            np.testing.assert_array_equal(solids.mat, data.geom_xmat[solids.geom])
