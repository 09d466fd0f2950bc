"""What counts as wall: by its shape, by its name, by patterns; in the samples and beyond."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from box_worlds import stages_of_xml
from navbake.baker.bake.stages import Stages, bake_stages
from navbake.baker.core.constants import BUILDING, OBJECT, STRUCTURE, WALL
from navbake.baker.geometry.extents import measure_extents
from navbake.baker.occupants.movable import name_occupants
from navbake.config.settings import load_config
from project_paths import CONFIGS, SHARED_DATA

DATA = SHARED_DATA
KINDS = {OBJECT: "object", WALL: "wall", STRUCTURE: "structure", BUILDING: "building"}


def box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float, more: str = "") -> str:
    pos = f"{(x0 + x1) / 2} {(y0 + y1) / 2} {(z0 + z1) / 2}"
    size = f"{(x1 - x0) / 2} {(y1 - y0) / 2} {(z1 - z0) / 2}"
    return f'<geom type="box" pos="{pos}" size="{size}" {more}/>'


def kinds(stages: Stages) -> list[str]:
    """What each counted geom is, by geom id."""
    found = stages.standing_occupants.kinds
    return [KINDS[int(found[r.id])] for r in stages.scene.geoms if r.counted]


def stages_of(folder: Path, things: str, assets: str = "", **settings: Any) -> Stages:
    """The stages of some things on a floor of 8 x 8 m, which is geom 0."""
    floor = box(-4, 4, -4, 4, -0.1, 0)
    xml = f"<mujoco><asset>{assets}</asset><worldbody>{floor}{things}</worldbody></mujoco>"
    return stages_of_xml(folder, xml, **settings)


# ---------------------------------------------------------------- shapes


@pytest.mark.parametrize(
    ("thing", "expected"),
    [
        (box(-2, 2, -0.05, 0.05, 0, 2.5), "wall"),
        (box(-2, 2, -0.05, 0.05, 0, 2.5, 'euler="0 0 37"'), "wall"),
        (box(-2, 2, -0.05, 0.05, -1, 1.6), "wall"),
        (box(-2, 2, -0.05, 0.05, -1, 1.4), "object"),  # 1.4 m over its floor
        (box(-2, 2, -0.05, 0.05, 0.5, 2.5), "wall"),  # a window from its sill
        (box(-2, 2, -0.05, 0.05, 0.9, 2.5), "object"),  # hangs
        (box(-0.3, 0.3, -0.05, 0.05, 0, 2.5), "wall"),
        (box(-0.2, 0.2, -0.05, 0.05, 0, 2.5), "object"),  # a post
        (box(-0.6, 0.6, -0.3, 0.3, 0, 2), "object"),  # a wardrobe
        (box(-1, 1, -0.16, 0.16, 0, 2.1), "object"),  # a bookshelf
        (box(-2, 2, -0.2, 0.2, 0, 2.5), "wall"),  # an outer wall
        (box(-2, 2, -0.4, 0.4, 0, 2.5), "object"),
        ('<geom type="cylinder" pos="0 0 1.5" size="0.2 1.5"/>', "object"),
        ('<geom type="cylinder" pos="0 0 1" size="1 0.05" euler="90 0 0"/>', "wall"),
        # a beam that rises over 3 m is no wall
        (box(-2, 2, -0.05, 0.05, 1.4, 1.6, 'euler="0 -40 0"'), "object"),
        (box(-2, 2, -2, 2, 2.4, 2.6), "structure"),  # a ceiling
        (box(-2, 2, -2, 2, 2.4, 2.6, 'euler="20 0 0"'), "structure"),  # a roof
        (box(-2, 2, -0.3, 0.3, 2.4, 2.6), "object"),  # a beam under it
        (box(-1, 1, -1, 1, 0, 2), "object"),
    ],
)
def test_shapes(tmp_path, thing, expected):
    assert kinds(stages_of(tmp_path, thing)) == ["structure", expected]


@pytest.mark.parametrize(
    ("joint", "expected"),
    [
        ("", "wall"),
        ('<joint type="hinge"/>', "object"),
        ("<freejoint/>", "object"),
    ],
)
def test_what_can_move_is_no_wall(tmp_path, joint, expected):
    thing = f"<body>{joint}{box(-2, 2, -0.05, 0.05, 0, 2.5)}</body>"
    assert kinds(stages_of(tmp_path, thing)) == ["structure", expected]


def test_what_hangs_on_a_joint_further_up_is_no_wall(tmp_path):
    panel = f"<body>{box(-2, 2, -0.05, 0.05, 0, 2.5)}</body>"
    things = f"<body><joint type='slide'/>{box(3, 3.2, 3, 3.2, 0, 1)}{panel}</body>"
    things += f"<body mocap='true'>{box(-2, 2, 1, 1.1, 0, 2.5)}</body>"
    assert kinds(stages_of(tmp_path, things)) == ["structure", "object", "object", "object"]


def test_meshes_are_measured_as_they_lie(tmp_path):
    x, y, z = np.meshgrid([-1.5, 1.5], [-0.04, 0.04], [0, 2.2])
    turn = np.radians(31)
    corners = np.stack(
        [x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn), z]
    )
    vertices = " ".join(f"{v:.6f}" for v in corners.reshape(3, -1).T.ravel())
    for thing, expected in (('meshes="hull"', "wall"), ("", "wall")):
        stages = stages_of(
            tmp_path,
            '<geom type="mesh" mesh="m"/>',
            f'<mesh name="m" vertex="{vertices}"/>',
            scene={"meshes": "hull" if thing else "surface"},
        )
        extents = measure_extents(stages.scene.shapes, 2)
        assert extents.short_side[1] == pytest.approx(0.08, abs=1e-4)
        assert extents.long_side[1] == pytest.approx(3.0, abs=1e-4)
        assert (extents.bottom[1], extents.top[1]) == pytest.approx((0.0, 2.2), abs=1e-4)
        assert kinds(stages) == ["structure", expected]


def test_extents_follow_each_solids_own_axes(tmp_path):
    things = (
        box(-1, 1, -0.1, 0.1, 0, 1, 'euler="0 0 30"')
        + '<geom type="capsule" size="0.1 0.5" pos="0 0 2" euler="0 90 40"/>'
        + '<geom type="ellipsoid" size="0.3 0.2 0.1" pos="0 0 2" euler="0 0 70"/>'
        + '<geom type="sphere" size="0.3" pos="1 2 3"/>'
        + '<geom type="cylinder" size="0.2 0.7" pos="0 0 2" euler="90 0 0"/>'
    )
    extents = measure_extents(stages_of(tmp_path, things).scene.shapes, 6)
    np.testing.assert_allclose(extents.short_side[1:], [0.2, 0.2, 0.4, 0.6, 0.4], atol=1e-9)
    np.testing.assert_allclose(extents.long_side[1:], [2.0, 1.2, 0.6, 0.6, 1.4], atol=1e-9)
    across = np.radians(30 + 90)
    np.testing.assert_allclose(
        np.abs(extents.short_axis[1]), np.abs([np.cos(across), np.sin(across)]), atol=1e-9
    )
    np.testing.assert_allclose(extents.center[4], [1, 2])
    assert (extents.bottom[4], extents.top[4]) == pytest.approx((2.7, 3.3))


def test_a_panel_of_furniture_is_no_wall(tmp_path):
    """A wardrobe of panels, each of which is shaped as a wall."""
    panels = (
        box(0, 1.2, 0, 0.02, 0, 2)
        + box(0, 0.02, 0.02, 0.6, 0, 2)
        + box(1.18, 1.2, 0.02, 0.6, 0, 2)
        + box(0.02, 1.18, 0.02, 0.6, 1.98, 2)
    )
    for wardrobe in (f"<body>{panels}</body>", f"<body><body>{panels}</body></body>"):
        assert "wall" not in kinds(stages_of(tmp_path, wardrobe))
    rooms = box(-3, 3, 2, 2.1, 0, 2.5) + box(-3, -2.9, -3, 2, 0, 2.5)
    assert kinds(stages_of(tmp_path, f"<body>{rooms}</body>"))[1:] == ["wall", "wall"]


def test_thick_walls_are_told_by_their_corners(tmp_path):
    """Walls of 0.7 m with a door, whose lintel and stub go on in their line."""
    ring = (
        box(-4, 4, -4, -3.3, 0, 2.6)
        + box(-4, 4, 3.3, 4, 0, 2.6)
        + box(-4, -3.3, -3.3, 3.3, 0, 2.6)
        + box(3.3, 4, -3.3, 1, 0, 2.6)
        + box(3.3, 4, 1, 2, 2.1, 2.6)  # the lintel
        + box(3.3, 4, 2, 3.3, 0, 2.6)
    )
    others = (
        box(-3.3, 1, -0.4, 0.4, 0, 1.9)  # a rack with an end at the wall, lower than it
        + box(-2, 2, 1.5, 2.3, 0, 2.6)  # one as high as the walls, away from them
    )
    found = kinds(stages_of(tmp_path, ring + others))
    assert found == ["structure", *["wall"] * 6, "object", "object"]


def test_thick_things_that_are_no_walls(tmp_path):
    """At a corner of a thick wall: too short, too thick. Elsewhere: two that cross each other."""
    walls = box(-4, 4, -4, -3.3, 0, 2.6) + box(-4, -3.3, -3.3, 3.3, 0, 2.6)
    others = (
        box(2, 2.7, -3.3, -0.8, 0, 2.6)
        + box(-1.3, 0, -3.3, 0.8, 0, 2.6)
        + box(-1, 3.2, 2, 2.7, 0, 2.6)
        + box(0.7, 1.4, 0.3, 4, 0, 2.6)
    )
    found = kinds(stages_of(tmp_path, walls + others))
    assert found == ["structure", "wall", "wall", *["object"] * 4]


def test_what_is_thicker_than_walls_goes_on_in_no_walls_line(tmp_path):
    named = box(-3.5, 0, -1, 1, 0, 2.5, 'name="wall"')
    found = kinds(stages_of(tmp_path, named + box(0.02, 3, -1, 1, 0, 2.5)))
    assert found == ["structure", "wall", "object"]


# ---------------------------------------------------------------- in line


def test_parapets_lintels_and_stubs_go_on_in_a_walls_line(tmp_path):
    pieces = (
        box(-3, -1, 0, 0.1, 0, 2.5)  # a wall
        + box(-1, 0, 0, 0.1, 0, 0.9)  # the parapet of a window
        + box(-1, 0, 0, 0.1, 2.1, 2.5)  # its lintel
        + box(-1, 0, 0.04, 0.06, 0.9, 2.1)  # its pane
        + box(0, 0.3, 0, 0.1, 0, 2.5)  # a stub behind it
        + box(0.3, 1.2, 0, 0.1, 2, 2.5)  # the lintel of the door next to it
    )
    others = (
        box(-3, -1, 0.1, 0.14, 1, 1.6)  # a picture on the wall
        + box(-3, -1, 0.1, 0.5, 1.5, 2)  # a cupboard on it
        + box(-4, -3.2, 0, 0.1, 0, 0.9)  # in line, but apart from it
        + box(1.3, 2, 0, 0.1, 0, 0.9)
    )
    found = kinds(stages_of(tmp_path, pieces + others))
    assert found == ["structure", *["wall"] * 6, *["object"] * 4]


def test_a_doorsill_is_no_wall(tmp_path):
    things = box(-3, -1, 0, 0.1, 0, 2.5) + box(-1, 0, 0, 0.1, 0, 0.03) + box(0, 3, 0, 0.1, 0, 2.5)
    assert kinds(stages_of(tmp_path, things)) == ["structure", "wall", "object", "wall"]


# ---------------------------------------------------------------- names


@pytest.mark.parametrize(
    ("name", "thing", "expected"),
    [
        ("garden wall", (-2, 2, 0, 0.1, 0, 0.6), "wall"),
        ("Partition_3", (-0.2, 0.2, 0, 0.1, 0, 1.2), "wall"),
        ("maze_WALL", (-1, 1, -1, 1, 0, 1.2), "wall"),
        ("wall cabinet", (-1, 1, 0, 0.3, 1.4, 2.4), "object"),
        ("wall socket", (-0.04, 0.04, 0, 0.02, 0.3, 0.4), "object"),
        ("wallet", (-0.1, 0.1, 0, 0.05, 0, 0.3), "object"),
        ("wall painting", (-1, 1, 0, 0.04, 1, 2), "object"),
        ("fence", (-2, 2, 0, 0.1, 0, 0.6), "object"),
    ],
)
def test_names_help_but_do_not_decide_alone(tmp_path, name, thing, expected):
    assert kinds(stages_of(tmp_path, box(*thing, f'name="{name}"'))) == ["structure", expected]
    on_body = f'<body name="{name}">{box(*thing)}</body>'
    assert kinds(stages_of(tmp_path, on_body)) == ["structure", expected]


def test_patterns_override_the_rule(tmp_path):
    things = (
        box(-2, 2, -1, -0.9, 0, 2.5, 'name="wall"')
        + box(-2, 2, 1, 1.1, 0, 0.6, 'name="hedge_1"')
        + f'<body name="hedges"><body>{box(-1, 1, 2, 3, 0, 0.6)}</body></body>'
    )
    stages = stages_of(tmp_path, things, names={"walls": ["hedge*"]})
    assert kinds(stages) == ["structure", "object", "wall", "wall"]
    contents = stages.standing_occupants
    assert contents.warnings == []
    assert contents.mark_walls(0)[0].sum() == 40 + 40 + 200  # for rooms, walls by shape stay walls
    named = {name for d in user_data(stages).values() for name in d.get("walls", [])}
    assert named == {"hedge_1", "hedges"}


def test_a_pattern_that_matches_nothing_is_told_with_near_names(tmp_path):
    things = box(-2, 2, 1, 1.1, 0, 2.5, 'name="wall_north"')
    contents = stages_of(tmp_path, things, names={"walls": ["wal_north*"]}).standing_occupants
    (warning,) = contents.warnings
    assert re.search(r"`names.walls` pattern 'wal_north\*' matches nothing.*wall_north", warning)


def user_data(stages: Stages, level: int = 0) -> dict[int, Any]:
    height, width = stages.lattice.shape
    window = (slice(0, height), slice(0, width))
    return dict(name_occupants(stages.standing_occupants, stages.occupants, level, window))


# ---------------------------------------------------------------- meshes that hold a building


def shell(height: float) -> str:
    """A room of 4 x 4 m as one mesh, floor, four walls, and a bench along one of them."""
    parts = [
        (-2, 2, -2, 2, -0.1, 0.0),
        (-2, 2, -2, -1.9, 0, height),
        (-2, 2, 1.9, 2, 0, height),
        (-2, -1.9, -1.9, 1.9, 0, height),
        (1.9, 2, -1.9, 1.9, 0, height),
        (-1.9, -1.5, -1.9, 1.9, 0, 0.5),
    ]
    vertices, faces = [], []
    for x0, x1, y0, y1, z0, z1 in parts:
        first = len(vertices)
        vertices += [(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (z0, z1)]
        faces += [
            tuple(first + k for k in face)
            for face in (
                (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
                (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
            )
        ]  # fmt: skip
    return "\n".join(
        [*(f"v {x} {y} {z}" for x, y, z in vertices)]
        + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
    )


def test_a_building_in_one_mesh_is_wall_where_it_is_high(tmp_path):
    path = tmp_path / "room.obj"
    path.write_text(shell(2.5))
    stages = bake_stages({"scene": {"path": path, "meshes": "surface"}})
    contents = stages.standing_occupants
    assert kinds(stages) == ["building"]
    expected = np.ones((40, 40), dtype=bool)
    expected[1:-1, 1:-1] = False
    np.testing.assert_array_equal(contents.mark_walls(0)[0], expected)
    data = user_data(stages)
    bench = data[20 * 40 + 3]
    assert len({str(entry) for entry in data.values()}) == 2
    assert list(bench) == ["blockers"]
    assert data[0] == {"walls": bench["blockers"]}


def test_a_low_or_full_mesh_holds_no_building(tmp_path):
    path = tmp_path / "room.obj"
    path.write_text(shell(1.2))
    stages = bake_stages({"scene": {"path": path, "meshes": "surface"}})
    assert kinds(stages) == ["structure"]
    vertices = " ".join(f"{x} {y} {z}" for x in (-1, 1) for y in (-1, 1) for z in (0, 2))
    mesh = f'<mesh name="m" vertex="{vertices}"/>'
    block = '<geom type="mesh" mesh="m"/>'
    stages = stages_of(tmp_path, block, mesh, scene={"meshes": "surface"})
    assert kinds(stages) == ["structure", "object"]


# ---------------------------------------------------------------- the samples, and others' scenes


def wall_names(stages: Stages) -> set[str]:
    found = stages.standing_occupants.kinds
    return {r.name for r in stages.scene.geoms if r.counted and found[r.id] == WALL}


@pytest.mark.parametrize("name", ["apartment", "house", "warehouse", "terrain"])
def test_the_samples_walls_are_those_called_so_even_without_their_names(name, tmp_path):
    config = load_config(CONFIGS / f"{name}.yaml")
    stages = bake_stages(config)
    called = {r.name for r in stages.scene.geoms if r.name.startswith("wall_") and r.counted}
    called = {n for n in called if "cabinet" not in n}
    assert wall_names(stages) == called

    text = Path(config.scene.path).read_text()
    ids = {r.name: r.id for r in stages.scene.geoms}
    text = re.sub(r'name="wall_[^"]*"', lambda m: f'name="part_{ids.get(m[0][6:-1], 0)}"', text)
    for old, new in (("wall_cabinet", "cabinet"), ('file="', f'file="{config.scene.path.parent}/')):
        text = text.replace(old, new)
    path = tmp_path / "nameless.xml"
    path.write_text(text)
    scene = config.scene.model_copy(update={"path": path})
    nameless = bake_stages(config.model_copy(update={"scene": scene}))
    # these two parapets are flush with the dock: in the windows, its floor goes on
    called -= {"wall_east_parapet_1", "wall_east_parapet_2"}
    assert {r.id for r in nameless.scene.geoms if r.name in wall_names(nameless)} == {
        ids[n] for n in called
    }


@pytest.mark.skipif(not DATA.is_dir(), reason=f"no real scenes in {DATA}")
def test_walls_of_the_small_house():
    path = DATA / "aws_small_house" / "scene.xml"
    stages = bake_stages({"scene": {"path": path, "meshes": "surface"}})
    found = stages.standing_occupants.kinds
    prefix = "aws_robomaker_residential_"
    by_kind = {
        kind: {
            r.name.removeprefix(prefix).split("#")[0]
            for r in stages.scene.geoms
            if found[r.id] == kind
        }
        for kind in KINDS
    }
    assert by_kind[BUILDING] == {"HouseWallB_01"}
    assert "RoomWall_01" in by_kind[WALL]
    # the doors are static here, so only a pattern tells them from walls
    expected = {"RoomWall_01", "RoomWindow_01", "Door_01", "FoldingDoor_01", "FoldingDoor_02"}
    assert by_kind[WALL] - {"Handle_01", "Curtain_01"} == expected
    assert {"Wardrobe_01", "Bed_01", "Refrigerator_01", "TV_01"} <= by_kind[OBJECT]
    assert "FloorB_01" in by_kind[STRUCTURE]


@pytest.mark.skipif(not DATA.is_dir(), reason=f"no real scenes in {DATA}")
def test_a_pattern_makes_a_low_arena_a_wall():
    path = DATA / "turtlebot3_world" / "scene.xml"
    settings = {"scene": {"path": path, "meshes": "surface"}}
    assert not bake_stages(settings).standing_occupants.mark_walls(0)[0].any()
    named = {**settings, "names": {"walls": ["ros_symbol#15"]}}
    assert bake_stages(named).standing_occupants.mark_walls(0)[0].sum() > 200


@pytest.mark.parametrize("seed", [1, 2])
def test_walls_of_a_labmaze(seed, tmp_path):
    mujoco = pytest.importorskip("mujoco")
    labmaze = pytest.importorskip("labmaze")
    mazes = pytest.importorskip("dm_control.locomotion.arenas.mazes")
    maze = labmaze.RandomMaze(height=11, width=11, random_seed=seed)
    arena = mazes.MazeWithTargets(maze=maze, xy_scale=2.0, z_height=2.0)
    arena.regenerate()
    model = mujoco.MjModel.from_xml_string(
        arena.mjcf_model.to_xml_string(), arena.mjcf_model.get_assets()
    )
    path = tmp_path / "maze.mjb"
    mujoco.mj_saveModel(model, str(path), None)
    levels = [{"ground": 0.0, "top": 0.25}]
    stages = bake_stages({"scene": {"path": path}, "levels": levels})
    walls = np.array([list(row) for row in str(maze.entity_layer).split("\n") if row]) == "*"
    np.testing.assert_array_equal(
        stages.standing_occupants.mark_walls(0)[0], np.kron(walls, np.ones((20, 20), dtype=bool))
    )
