"""Doors: the cells that they block, found by themselves, and other states without a new bake."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import navbake
from differences import first_difference
from door_scenes import CUPBOARD, FIXED_LEAF, LEAF, ROOMS, SHELL, bake_world
from navbake.baker.bake import stages
from navbake.baker.bake.pipeline import run_bake
from navbake.baker.scene.scene import load_scene
from navbake.config.settings import load_config
from navbake.errors import QueryError
from project_paths import CONFIGS

STATES = ("modelled", "open", "closed", "removed")


@pytest.fixture
def bake(tmp_path: Path):
    return lambda *parts, **settings: bake_world(tmp_path, *parts, **settings).grid


@pytest.fixture
def warnings(tmp_path: Path):
    return lambda *parts, **settings: bake_world(tmp_path, *parts, **settings).warnings


def in_gap(grid) -> np.ndarray:
    y = np.arange(1.15, 1.9, 0.1)
    row, col = grid.lattice.rows_cols(np.stack([np.full_like(y, 3.0), y], axis=1))
    return grid.free[row, col]


def assert_same(grid, other, hint: object = "") -> None:
    """The same but for the settings that they were baked with."""
    digest = {"settingsDigest": other.navbake["settingsDigest"]}
    for part in (grid, *grid.levels):
        part.metadata = {**part.metadata, "navbake": {**part.navbake, **digest}}
    assert first_difference(grid, other) is None, hint


def test_leaf_between_two_rooms_is_a_door(bake):
    grid = bake(ROOMS, LEAF)
    (door,) = grid.doors
    assert (door.id, door.joint, door.state) == ("leaf", "leaf", "modelled")
    assert set(door.rooms) == {room.id for room in grid.rooms}
    assert not in_gap(grid).any()  # modelled at 0, which is closed
    assert {n.door for room in grid.rooms for n in room.neighbours} == {"leaf"}


def test_the_width_of_a_door_is_that_of_its_leaf_whatever_the_cells_are(bake):
    """The leaf is 0.86 m wide; its cells are 0.9 m, and where it is open they run another way."""
    for settings in ({}, {"doors": {"state": "open"}}, {"grid": {"cell_size": 0.05}}):
        (door,) = bake(ROOMS, LEAF, **settings).doors
        assert door.width == pytest.approx(0.86)
    handle = LEAF.replace(
        "</body>", '<geom type="box" pos="0.1 0.5 1" size="0.1 0.05 0.02"/></body>'
    )
    (door,) = bake(ROOMS, handle).doors
    assert door.width == pytest.approx(0.86)


@pytest.mark.parametrize("state", ["open", "removed"])
def test_with_doors_opens_the_gap(bake, state):
    grid = bake(ROOMS, LEAF).with_doors({"leaf": state})
    assert in_gap(grid)[:6].all()
    assert grid.doors[0].state == state


TILTS = """
<body name="leaf" pos="3 1.5 2.05"><joint axis="0 1 0" range="-90 0"/>
<geom type="box" pos="0 0 -1.03" size="0.02 0.43 1"/></body>
"""
GOES_UP = """
<body name="leaf" pos="3 1.5 0"><joint type="slide" axis="0 0 1" range="0 2"/>
<geom type="box" pos="0 0 1.02" size="0.02 0.43 1"/></body>
"""


@pytest.mark.parametrize("leaf", [TILTS, GOES_UP], ids=["tilts", "goes up"])
def test_leaves_that_tilt_or_slide_up_are_doors(bake, leaf):
    grid = bake(ROOMS, leaf)
    (door,) = grid.doors
    assert set(door.rooms) == {room.id for room in grid.rooms}
    assert not in_gap(grid).any()
    assert in_gap(grid.with_doors("open"))[1:-1].all()
    assert grid.warnings == ()


@pytest.mark.parametrize("cell_size", [0.05, 0.1, 0.2])
@pytest.mark.parametrize(("most", "is_stuck"), [("1.57", True), ("90", False), ("180", False)])
def test_a_door_that_opens_nothing_is_told(warnings, most, is_stuck, cell_size):
    leaf = LEAF.replace('range="0 90"', f'range="0 {most}"')
    found = warnings(ROOMS, leaf, grid={"cell_size": cell_size})
    told = [text for text in found if "door 'leaf' still closes its doorway" in text]
    assert len(told) == is_stuck
    assert all(f"by {most}° only" in text and "angle" in text for text in told)


def test_open_leaf_blocks_where_it_stands(bake):
    grid = bake(ROOMS, LEAF).with_doors({"leaf": "open"})
    row, col = grid.lattice.rows_cols([2.5, 1.06])
    assert grid.occupancy[row, col] == 1
    assert grid.blockers((2.5, 1.06)) == ["leaf"]


def test_state_that_is_modelled_is_that_of_the_pose(bake):
    grid = bake(ROOMS, LEAF, scene={"joints": {"leaf": 1.5707963}})
    assert in_gap(grid)[:6].all()
    assert not in_gap(grid.with_doors({"leaf": "closed"})).any()


def test_with_doors_leaves_the_grid_alone(bake):
    grid = bake(ROOMS, LEAF)
    before = grid.occupancy.copy()
    grid.with_doors({"leaf": "open"})
    assert np.array_equal(grid.occupancy, before)
    assert grid.doors[0].state == "modelled"


def test_a_leaf_that_cannot_move_is_a_wall_where_nobody_looks_for_doors(bake):
    for settings, is_wall in (({}, False), ({"doors": {"find": False}}, True)):
        grid = bake(ROOMS, FIXED_LEAF, **settings)
        facts = grid.describe_cell((3.01, 1.51))
        assert facts["walls"] == (["leaf"] if is_wall else [])
        assert (facts["room"] is None) == is_wall


AS_HIGH = FIXED_LEAF.replace('0.44 1"', '0.44 1.2"').replace("0.43 1", "0.43 1.2")


@pytest.mark.parametrize(
    ("what", "leaf"),
    [
        (
            "the same wall goes on",
            FIXED_LEAF.replace("0.43 1", "0.43 1.2").replace("44 1", "44 1.2"),
        ),
        ("a shelf in a room", FIXED_LEAF.replace('pos="3 1.06 0"', 'pos="1.5 1.06 0"')),
        ("a wing before a wall", FIXED_LEAF.replace('pos="3 1.06 0"', 'pos="3 0.2 0"')),
    ],
)
def test_what_stands_in_no_opening_is_no_door(bake, what, leaf):
    assert bake(ROOMS, leaf).doors == (), what


def test_unknown_door_and_state_are_named(bake):
    grid = bake(ROOMS, LEAF)
    with pytest.raises(QueryError, match=r"no door 'laef' .* did you mean 'leaf'"):
        grid.with_doors({"laef": "open"})
    with pytest.raises(QueryError, match="'ajar'"):
        grid.with_doors({"leaf": "ajar"})


# ---------------------------------------------------------------- names


def test_cells_in_a_door_carry_its_name(bake):
    grid = bake(ROOMS, LEAF, doors={"state": "open"})
    closed = bake(ROOMS, LEAF, doors={"state": "closed"})
    removed = bake(ROOMS, LEAF, doors={"state": "removed"})
    in_door = np.flatnonzero((closed.occupancy == 1) & (removed.occupancy == 0))
    assert len(in_door) >= 8
    for cell in in_door.tolist():
        assert grid.user_data[cell]["doors"] == ["leaf"]
        assert closed.user_data[cell] == {"doors": ["leaf"], "objects": ["leaf"]}
        assert removed.user_data[cell] == {"doors": ["leaf"]}
    stands = np.flatnonzero((grid.occupancy == 1) & (removed.occupancy == 0))
    assert len(stands) >= 8
    for cell in stands.tolist():
        assert grid.user_data[cell] == {"doors": ["leaf"], "objects": ["leaf"]}


def test_what_hangs_over_a_door_does_not_block(bake):
    lamp = '<body name="lamp" pos="3 1.5 2.2"><geom type="sphere" size="0.15"/></body>'
    for grid in (bake(ROOMS, LEAF, lamp), bake(ROOMS, LEAF, lamp).with_doors("open")):
        facts = grid.describe_cell((3.01, 1.51))
        assert facts["doors"] == ["leaf"]
        assert "lamp" in facts["objects"]
        is_closed = not facts["free"]
        assert facts["blockers"] == (["leaf"] if is_closed else [])
        assert ("leaf" in facts["objects"]) == is_closed


def test_without_names_no_state_has_any(bake):
    grid = bake(ROOMS, LEAF, names=False)
    assert grid.navbake["names"] is False
    for state in STATES:
        baked = bake(ROOMS, LEAF, names=False, doors={"state": state})
        assert_same(grid.with_doors(state), baked, state)
        assert baked.user_data == {}


# ---------------------------------------------------------------- what is no door


def test_cupboard_door_belongs_to_the_cupboard(bake):
    grid = bake(ROOMS, LEAF, CUPBOARD)
    assert [door.id for door in grid.doors] == ["leaf"]
    facts = grid.describe_cell((5.58, 2.6))
    assert facts["blockers"] == facts["objects"] == ["cupboard"]
    assert facts["doors"] == []
    assert facts["floor"] == 0.0


STAGE = """
<body name="stage" pos="1 1.5 0"><joint type="slide" axis="1 0 0" range="0 1"/>
<geom type="box" pos="0.55 0 0.1" size="0.55 0.8 0.1"/>
<geom name="backdrop" type="box" pos="-0.05 0 1.2" size="0.02 0.8 1.2"/></body>
"""


@pytest.mark.parametrize("things", [CUPBOARD, STAGE, CUPBOARD + STAGE])
def test_what_is_no_door_is_as_if_nobody_looked_for_doors(bake, things):
    grid = bake(SHELL, things)
    assert_same(grid, bake(SHELL, things, doors={"find": False}))
    assert grid.doors == ()


@pytest.mark.parametrize(("movable", "floor"), [([], 0.0), (["stage"], 0.2)])
def test_a_stage_that_looks_like_a_door_carries_a_floor_if_it_is_named(bake, movable, floor):
    grid = bake(SHELL, STAGE, floors={"movable": movable})
    facts = grid.describe_cell((1.5, 1.5))
    assert grid.doors == ()
    assert facts["floor"] == pytest.approx(floor)
    assert facts["free"]  # a step leads onto the stage
    assert facts["objects"] == ["stage"]
    assert grid.blockers((0.95, 1.5)) == ["stage"]  # its backdrop


@pytest.mark.parametrize("stage", ["find_rooms", "classify_leaves"])
@pytest.mark.parametrize(
    ("things", "settings"),
    [
        ((ROOMS, LEAF), {}),
        ((ROOMS, LEAF, CUPBOARD), {}),
        ((SHELL,), {}),
        ((ROOMS, LEAF), {"grid": {"bounds": [3.5, 0.0, 6.0, 3.0]}}),  # beside them
    ],
)
def test_rooms_and_doors_are_found_once_whatever_is_no_door(
    tmp_path, monkeypatch, stage, things, settings
):
    calls = []
    find = getattr(stages, stage)

    def find_and_count(*given, **named):
        calls.append(stage)
        return find(*given, **named)

    monkeypatch.setattr(stages, stage, find_and_count)
    bake_world(tmp_path, *things, **settings)
    assert calls == [stage]


def test_a_leaf_is_left_out_with_all_that_can_move_where_nobody_looks_for_doors(bake):
    scene = {"exclude": {"movable": True}}
    removed = bake(ROOMS, LEAF, scene=scene).with_doors("removed")
    grid = bake(ROOMS, LEAF, scene=scene, doors={"find": False})
    assert grid.doors == ()
    assert in_gap(grid).all()
    np.testing.assert_array_equal(grid.occupancy, removed.occupancy)


# ---------------------------------------------------------------- other places


def test_a_door_upstairs(bake):
    upper = '<body name="upper" pos="0 0 2.7">' + ROOMS.format("up_") + "</body>"
    leaf = '<body pos="0 0 2.7">' + LEAF.format("up_") + "</body>"
    settings = {"floors": {"roofs": True}}
    grid = bake(ROOMS, upper, LEAF, leaf, **settings)
    assert [level.ground for level in grid.levels] == pytest.approx([0.0, 2.7])
    assert [door.id for door in grid.doors] == ["leaf", "up_leaf"]
    assert [sorted(door.rooms) for door in grid.doors] == [["0:1", "0:2"], ["1:1", "1:2"]]
    for level, other in ((0, "leaf"), (1, "up_leaf")):
        opened = grid.with_doors({other: "open"}).levels
        assert in_gap(opened[level])[:6].all()
        assert not in_gap(opened[1 - level]).any()
    for state in STATES:
        baked = bake(ROOMS, upper, LEAF, leaf, doors={"state": state}, **settings)
        assert_same(grid.with_doors(state), baked, state)


@pytest.mark.parametrize(
    "bounds", [[0.0, 0.0, 6.0, 1.5], [2.93, 0.0, 6.0, 3.0], [0.0, 1.2, 6.0, 2.6]]
)
def test_a_door_cut_by_the_bounds(bake, bounds):
    settings = {"grid": {"bounds": bounds}, "doors": {"patterns": ["leaf"]}}
    grid = bake(ROOMS, LEAF, **settings)
    for state in STATES:
        settings["doors"]["state"] = state
        assert_same(grid.with_doors(state), bake(ROOMS, LEAF, **settings), state)
    closed = grid.with_doors("closed").occupancy != grid.with_doors("removed").occupancy
    assert closed.sum() > 0


def test_a_door_beside_the_bounds_is_none(bake):
    grid = bake(ROOMS, LEAF, grid={"bounds": [3.5, 0.0, 6.0, 3.0]})
    assert grid.doors == ()


# ---------------------------------------------------------------- states that it hasn't


@pytest.mark.parametrize("state", STATES)
def test_a_door_without_a_joint(bake, warnings, state):
    settings = {"doors": {"state": state}}
    grid = bake(ROOMS, FIXED_LEAF, **settings)
    (door,) = grid.doors
    assert door.joint is None and sorted(door.rooms) == ["0:1", "0:2"]
    assert door.state == state
    assert in_gap(grid).any() == (state in ("open", "removed"))
    set_later = bake(ROOMS, FIXED_LEAF).with_doors(state)
    np.testing.assert_array_equal(set_later.occupancy, grid.occupancy)
    told = [text for text in warnings(ROOMS, FIXED_LEAF, **settings) if "leaf" in text]
    assert len(told) == (state == "open")
    assert all("door 'leaf' is not moved by exactly one hinge or slide" in text for text in told)


def test_a_joint_beyond_its_range_is_told(warnings, bake):
    scene = {"joints": {"leaf": 2.0}}
    (told,) = warnings(ROOMS, LEAF, scene=scene)
    assert "joint 'leaf' ranges from 0 to 1.5708 rad, got 2 at `scene.joints.leaf`" in told
    assert warnings(ROOMS, LEAF, scene={"joints": {"leaf": 1.5708}}) == []
    assert in_gap(bake(ROOMS, LEAF, scene=scene))[:6].all()


# ---------------------------------------------------------------- doors that one could walk on

# a floor with a pit across it, over which a plate of 1 x 1 m lies, hinged at its western edge
PIT = """
<geom type="box" pos="-2 0 -0.1" size="2 2 0.1"/><geom type="box" pos="3 0 -0.1" size="2 2 0.1"/>
<body name="hatch" pos="0 0 -0.05"><joint name="hatch" axis="0 -1 0" range="0 90"/>
<geom type="box" pos="0.5 0 0" size="0.5 0.5 0.05"/></body>
"""
# a gate that rolls up under a high ceiling
ROLLING = """
<geom type="box" pos="0 0 -0.1" size="3 3 0.1"/>
<body name="gate" pos="0 0 2.2"><joint name="gate" axis="0 -1 0" range="0 90"/>
<geom type="box" pos="0 0 -1.1" size="0.03 1 1.1"/></body>
"""

BEAM = '<geom type="box" pos="0.5 0 0.9" size="0.7 0.6 0.05"/>'
MAT = '<body name="mat" pos="1.5 1.5 0.01"><geom type="box" size="1 1 0.01"/></body>'


@pytest.mark.parametrize("angle", [0.0, 90.0])
def test_a_door_that_carries_a_floor_is_told(warnings, angle):
    settings = {"doors": {"patterns": ["hatch"]}, "scene": {"joints": {"hatch": np.radians(angle)}}}
    told, unreached = warnings(PIT, **settings)[::-1]
    assert "no step leads to" in unreached  # what lies beyond the pit
    how = "when it is closed" if angle else "as it is modelled"
    assert f"door 'hatch' carries 1.0 m² of floor {how}" in told
    assert warnings(PIT, floors={"movable": ["hatch"]}) == []


def test_what_looks_like_no_door_and_carries_a_floor_is_told_as_what_can_move(warnings):
    unreached, told = warnings(PIT)
    assert "no step leads to" in unreached
    assert "'hatch' moves and carries no floor, though 1.0 m²" in told


@pytest.mark.parametrize(
    ("pattern", "things"),
    [("gate", (ROLLING,)), ("leaf", (ROOMS, LEAF)), ("hatch", (PIT, BEAM)), ("mat", (ROOMS, MAT))],
)
def test_a_door_that_one_cannot_walk_on_is_not_told(warnings, pattern, things):
    told = warnings(*things, doors={"patterns": [pattern]})
    assert not [text for text in told if "no step leads to" not in text]


# ---------------------------------------------------------------- against other bakes


@pytest.mark.parametrize("name", ["apartment", "house", "warehouse", "terrain"])
def test_other_states_equal_a_bake_of_them(name, tmp_path):
    """Every state of all doors at once, from the file; layers and user data included."""
    config = load_config(CONFIGS / f"{name}.yaml", ["attributes=[island, clearance]"])
    run_bake(config).grid.save(tmp_path / "grid.json")
    grid = navbake.load(tmp_path / "grid.json")
    assert grid.doors
    for state in STATES:
        update = {"doors": config.doors.model_copy(update={"state": state})}
        baked = run_bake(config.model_copy(update=update)).grid
        assert_same(grid.with_doors(state), baked, state)


@pytest.mark.parametrize("name", ["apartment", "house", "warehouse", "terrain"])
def test_other_states_equal_a_bake_that_knows_of_no_doors(name):
    """Doors are mere bodies there, posed by their joints."""
    # the cart of the warehouse is left out by its name: its door can move, too
    exclude = "scene.exclude={movable: false, bodies: [cart]}"
    config = load_config(CONFIGS / f"{name}.yaml", [exclude] if name == "warehouse" else [])
    scene = load_scene(config)
    bounds = config.grid.bounds or scene.bounds[:, :2].ravel().tolist()
    config = config.model_copy(update={"grid": config.grid.model_copy(update={"bounds": bounds})})
    grid = run_bake(config).grid
    ranges = {door.joint: scene.model.joint(door.joint).range for door in grid.doors}
    for state in ("open", "closed"):
        joints = {
            joint: float(max(ends, key=abs)) if state == "open" else 0.0
            for joint, ends in ranges.items()
        }
        posed = {
            "scene": config.scene.model_copy(update={"joints": joints}),
            "doors": config.doors.model_copy(update={"find": False}),
        }
        baked, same = run_bake(config.model_copy(update=posed)).grid, grid.with_doors(state)
        assert baked.doors == ()
        for level, other in zip(same.levels, baked.levels, strict=True):
            np.testing.assert_array_equal(level.occupancy, other.occupancy)
            np.testing.assert_array_equal(level.weights, other.weights)
