"""Doors: the cells that they block, found by themselves, and other states without a new bake."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import navbake
from navbake.bake.pipeline import run_bake
from navbake.config import load_config, parse_config
from navbake.differences import first_difference
from navbake.errors import QueryError

CONFIGS = Path(__file__).parents[2] / "configs"

# Two rooms of 3 x 3 m with a gap of 0.9 m between them, and a leaf that hangs in it.
ROOMS = """
<mujoco><compiler angle="degree"/><worldbody>
<geom name="floor" type="box" pos="3 1.5 -0.1" size="3.1 1.6 0.1"/>
<geom name="wall_s" type="box" pos="3 -0.05 1.2" size="3.1 0.05 1.2"/>
<geom name="wall_n" type="box" pos="3 3.05 1.2" size="3.1 0.05 1.2"/>
<geom name="wall_w" type="box" pos="-0.05 1.5 1.2" size="0.05 1.5 1.2"/>
<geom name="wall_e" type="box" pos="6.05 1.5 1.2" size="0.05 1.5 1.2"/>
<geom name="wall_1" type="box" pos="3 0.525 1.2" size="0.05 0.525 1.2"/>
<geom name="wall_2" type="box" pos="3 2.475 1.2" size="0.05 0.525 1.2"/>
{extra}
</worldbody></mujoco>
"""
LEAF = """
<body name="leaf" pos="3 1.06 0"><joint name="leaf" axis="0 0 1" range="0 90" {joint}/>
<geom name="leaf" type="box" pos="0 0.44 1" size="0.02 0.43 1"/></body>
"""
CUPBOARD = """
<body name="cupboard" pos="5.6 2.6 0"><geom type="box" pos="0.2 0 1" size="0.2 0.4 1"/>
<body name="cupboard_door" pos="-0.02 -0.4 0"><joint axis="0 0 1" range="0 90"/>
<geom type="box" pos="0 0.4 1" size="0.02 0.4 0.95"/></body></body>
"""


@pytest.fixture
def bake(tmp_path: Path):
    def run(extra: str, **settings: object):
        path = tmp_path / "scene.xml"
        path.write_text(ROOMS.format(extra=extra))
        scene = {"path": str(path), **settings.pop("scene", {})}  # type: ignore[dict-item]
        return run_bake(parse_config({"scene": scene, **settings})).grid

    return run


def in_gap(grid) -> np.ndarray:
    y = np.arange(1.15, 1.9, 0.1)
    row, col = grid.lattice.rows_cols(np.stack([np.full_like(y, 3.0), y], axis=1))
    return grid.free[row, col]


def test_leaf_between_two_rooms_is_a_door(bake):
    grid = bake(LEAF.format(joint=""))
    (door,) = grid.doors
    assert (door["id"], door["joint"], door["state"]) == ("leaf", "leaf", "modelled")
    assert set(door["rooms"]) == {room["id"] for room in grid.rooms}
    assert not in_gap(grid).any()  # modelled at 0, which is closed
    assert {n["door"] for room in grid.rooms for n in room["neighbours"]} == {"leaf"}


@pytest.mark.parametrize("state", ["open", "removed"])
def test_with_doors_opens_the_gap(bake, state):
    grid = bake(LEAF.format(joint="")).with_doors({"leaf": state})
    assert in_gap(grid)[:6].all()
    assert grid.doors[0]["state"] == state


def test_open_leaf_blocks_where_it_stands(bake):
    grid = bake(LEAF.format(joint="")).with_doors({"leaf": "open"})
    row, col = grid.lattice.rows_cols([2.5, 1.06])
    assert grid.occupancy[row, col] == 1
    assert grid.blockers(2.5, 1.06) == ["leaf"]


def test_state_that_is_modelled_is_that_of_the_pose(bake):
    grid = bake(LEAF.format(joint=""), scene={"joints": {"leaf": 1.5707963}})
    assert in_gap(grid)[:6].all()
    assert not in_gap(grid.with_doors({"leaf": "closed"})).any()


def test_cells_in_a_door_carry_its_name(bake):
    grid = bake(LEAF.format(joint=""), doors={"state": "open"})
    closed = bake(LEAF.format(joint=""), doors={"state": "closed"})
    new = (closed.occupancy == 1) & (
        bake(LEAF.format(joint=""), doors={"state": "removed"}).occupancy == 0
    )
    for cell in np.flatnonzero(new):
        assert grid.user_data[int(cell)]["doors"] == ["leaf"]


def test_cupboard_door_is_none_but_blocks(bake):
    grid = bake(LEAF.format(joint="") + CUPBOARD)
    assert [door["id"] for door in grid.doors] == ["leaf"]
    assert "cupboard_door" in grid.blockers(5.58, 2.6)


def test_pattern_makes_a_door_of_anything(bake):
    grid = bake(LEAF.format(joint="") + CUPBOARD, doors={"patterns": ["cupboard_d*"]})
    assert {door["id"] for door in grid.doors} == {"leaf", "cupboard_door"}


def test_nothing_is_found_when_nobody_looks(bake):
    assert bake(LEAF.format(joint=""), doors={"find": False}).doors == []


def test_pattern_without_a_body_is_told(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(ROOMS.format(extra=""))
    config = parse_config({"scene": {"path": path}, "doors": {"patterns": ["gate*"]}})
    assert "`doors.patterns`: 'gate*' matches no body" in run_bake(config).warnings


def test_unknown_door_and_state_are_named(bake):
    grid = bake(LEAF.format(joint=""))
    with pytest.raises(QueryError, match=r"no door 'laef' .* did you mean 'leaf'"):
        grid.with_doors({"laef": "open"})
    with pytest.raises(QueryError, match="'ajar'"):
        grid.with_doors({"leaf": "ajar"})


def test_with_doors_leaves_the_grid_alone(bake):
    grid = bake(LEAF.format(joint=""))
    before = grid.occupancy.copy()
    grid.with_doors({"leaf": "open"})
    assert np.array_equal(grid.occupancy, before)
    assert grid.doors[0]["state"] == "modelled"


@pytest.mark.parametrize("name", ["apartment", "house", "warehouse", "terrain"])
def test_other_states_equal_a_bake_of_them(name, tmp_path):
    """Every state of all doors at once, from the file; layers and user data included."""
    config = load_config(CONFIGS / f"{name}.yaml", ["attributes=[island, clearance]"])
    run_bake(config).grid.save(tmp_path / "grid.json")
    grid = navbake.load(tmp_path / "grid.json")
    assert grid.doors
    for state in ("open", "closed", "removed", "modelled"):
        update = {"doors": config.doors.model_copy(update={"state": state})}
        baked = run_bake(config.model_copy(update=update)).grid
        same = grid.with_doors({door["id"]: state for door in grid.doors})
        same.navbake["settingsDigest"] = baked.navbake["settingsDigest"]
        assert first_difference(same, baked) is None, state


def test_each_door_of_the_apartment_alone_equals_its_pose(tmp_path):
    """One door at a time, against a bake with its joint moved."""
    config = load_config(CONFIGS / "apartment.yaml")
    grid = run_bake(config).grid
    for door in grid.doors:
        closed = grid.with_doors({door["id"]: "closed"})
        scene = config.scene.model_copy(update={"joints": {door["joint"]: 0.0}})
        posed = run_bake(config.model_copy(update={"scene": scene})).grid
        assert np.array_equal(closed.occupancy, posed.occupancy), door["id"]
        assert np.array_equal(closed.weights, posed.weights), door["id"]
