"""What stands alone makes floors, walls, levels, rooms and the box; what moves is in the way."""

from __future__ import annotations

import os
import random
import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import navbake
from box_worlds import FLOOR, body, box, world
from door_scenes import CUPBOARD, LEAF, ROOMS
from door_scenes import world as door_world
from navbake.baker.bake.stages import bake_stages
from navbake.navgrid.grid import NavGrid
from random_scenes import make_scene

pytestmark = pytest.mark.filterwarnings("ignore::navbake.BakeWarning")

MORE = int(os.environ.get("NAVBAKE_EXAMPLES", "0"))
WALLS = (
    box("wall_s", -2, -2, 0, 2, -1.9, 5)
    + box("wall_n", -2, 1.9, 0, 2, 2, 5)
    + box("wall_w", -2, -1.9, 0, -1.9, 1.9, 5)
    + box("wall_e", 1.9, -1.9, 0, 2, 1.9, 5)
)


def bake(content: str, **settings: Any) -> NavGrid:
    return navbake.bake(mujoco.MjModel.from_xml_string(world(content)), **settings)


def free(name: str, content: str) -> str:
    """A body with a free joint."""
    return body(name, "<freejoint/>" + content)


def warnings_with(grid: NavGrid, text: str) -> list[str]:
    return [warning for warning in grid.warnings if text in warning]


def check_same_structure(grid: NavGrid, alone: NavGrid) -> None:
    """Both have the same lattices, boxes, grounds, floors and rooms; in one, more is occupied."""
    assert len(grid.levels) == len(alone.levels)
    assert grid.rooms == alone.rooms
    assert grid.navbake["levels"] == alone.navbake["levels"]
    for one, other in zip(grid.levels, alone.levels, strict=True):
        assert one.lattice == other.lattice
        assert one.bbox_yup == other.bbox_yup
        assert one.min_yup == other.min_yup
        np.testing.assert_array_equal(one.floor_height, other.floor_height)
        np.testing.assert_array_equal(one.room_index, other.room_index)
        assert (one.occupancy >= other.occupancy).all()


# ---------------------------------------------------------------- with and without what moves

THINGS = {
    "high": box("thing", 0, 0, 0, 0.5, 0.5, 6),
    "beyond the walls": box("thing", 1, 0, 1, 6, 1, 1.2),
    "below the floor": box("thing", 0, 0, -1, 1, 1, -0.05),
    "as large as a floor": box("thing", -1.9, -1.9, 0.2, 1.9, 1.9, 0.3),
    "a floor upstairs": box("thing", -1.9, -1.9, 2.3, 1.9, 1.9, 2.5),
    "a roof": box("thing", -3, -3, 5, 3, 3, 5.1),
    "a wall through the room": box("thing", -0.05, -1.9, 0, 0.05, 1.9, 5),
    "a step": box("thing", 0, 0, 0, 1.5, 1.5, 0.15),
    "a mat": box("thing", -1, -1, 0, 1, 1, 0.02),
}


@pytest.mark.parametrize("kind", THINGS)
@pytest.mark.parametrize("how", ["free", "mocap", "hinge"])
def test_a_thing_that_moves_changes_what_is_occupied_alone(kind, how):
    things = {
        "free": free("b", THINGS[kind]),
        "mocap": body("b", THINGS[kind], 'mocap="true"'),
        "hinge": body("b", '<joint axis="0 0 1"/>' + THINGS[kind]),
    }
    alone = bake(FLOOR + WALLS)
    assert len(alone.rooms) == 1
    check_same_structure(bake(FLOOR + WALLS + things[how]), alone)


@pytest.mark.parametrize(
    "kind", ["high", "beyond the walls", "a floor upstairs", "a wall through the room", "a step"]
)
def test_the_same_thing_changes_more_where_it_stands(kind):
    """The test above would notice a rule that is broken."""
    alone = bake(FLOOR + WALLS)
    with pytest.raises(AssertionError):
        check_same_structure(bake(FLOOR + WALLS + THINGS[kind]), alone)


def movables_of(model: Any) -> list[str]:
    """The bodies of a random scene that can move, without its door, a leaf."""
    movable = (model.body_weldid != 0) | (model.body_mocapid >= 0)
    names = [model.body(number).name for number in np.flatnonzero(movable).tolist()]
    return [name for name in names if name != "door"]


@pytest.mark.parametrize("seed", range(MORE or 40))
def test_random_scenes_have_the_structure_that_they_have_without_movables(seed):
    xml, settings = make_scene(random.Random(f"structure {seed}"))
    try:
        model = mujoco.MjModel.from_xml_string(xml)
        names = movables_of(model)
        grid = navbake.bake(model, **settings)
    except (ValueError, navbake.SceneError) as error:
        pytest.skip(f"no scene: {error}")
    assert names
    alone = navbake.bake(model, exclude={"bodies": names}, **settings)
    check_same_structure(grid, alone)
    assert [door.id for door in grid.doors] == [door.id for door in alone.doors]


# ---------------------------------------------------------------- what is in the way


@pytest.mark.parametrize(
    ("low", "high", "blocks"),
    [
        (0.0, 0.02, False),
        (0.0, 0.25, False),
        (0.0, 0.26, True),
        (0.2, 0.3, True),
        (1.0, 1.2, True),
        (1.14, 1.5, False),
        (-0.5, 0.2, False),
    ],
)
def test_what_moves_blocks_from_a_step_above_the_floor_to_the_agents_height(low, high, blocks):
    """The floor is what stands, also under a mat of 2 cm and a step of 25 cm."""
    agent = {"traversable_floor_height": 0.25, "height": 1.14, "radius": 0.05}
    grid = bake(FLOOR + free("b", box("thing", 0, 0, low, 1, 1, high)), agent=agent)
    assert (grid.floor_height == 0.0).all()
    assert np.count_nonzero(grid.occupancy) == (100 if blocks else 0)


def test_what_lies_on_the_floor_is_named_though_it_blocks_nothing():
    grid = bake(FLOOR + free("rug", box("weave", 0, 0, 0, 1, 1, 0.02)))
    assert np.count_nonzero(grid.occupancy) == 0
    row, col = grid.lattice.rows_cols([0.55, 0.55])
    assert grid.user_data[int(row) * grid.width + int(col)] == {"objects": ["rug"]}


def test_a_leaf_that_is_no_door_changes_what_is_occupied_alone():
    def bake_doors(*parts: str) -> NavGrid:
        return navbake.bake(mujoco.MjModel.from_xml_string(door_world(*parts)))

    start = CUPBOARD.index('<body name="cupboard_door"')
    case = CUPBOARD[:start] + "</body>"
    # a leaf that hangs in the middle of a room
    alone = LEAF.replace('"{0}leaf" pos="3 1.06 0"', '"lone" pos="1.5 1.06 0"')
    alone = alone.replace("{0}leaf", "lone")
    for parts, without in (
        ((ROOMS, LEAF, CUPBOARD), (ROOMS, LEAF, case)),
        ((ROOMS, LEAF, alone), (ROOMS, LEAF)),
        ((ROOMS, alone), (ROOMS,)),
    ):
        grid = bake_doors(*parts)
        other = bake_doors(*without)
        check_same_structure(grid, other)
        assert grid.doors == other.doors
        assert (grid.occupancy != other.occupancy).any()


# ---------------------------------------------------------------- floors that move

BANKS = box("west", -4, -2, -0.5, -1, 2, 0) + box("east", 1, -2, -0.5, 4, 2, 0)
BRIDGE = free("bridge", box("boards", -1, -0.8, -0.1, 1, 0.8, 0))


def crosses(grid: NavGrid) -> bool:
    return navbake.PathFinder(grid).find_path((-3, 0, 0), (3, 0, 0)) is not None


def test_a_drawbridge_is_floor_where_a_setting_names_it():
    grid = bake(BANKS + BRIDGE)
    assert not crosses(grid)
    (warning,) = warnings_with(grid, "carries no floor")
    assert "'bridge' moves and carries no floor, though 3.2 m² of it lie over none" in warning
    assert "`floors.movable: [bridge]`" in warning
    named = bake(BANKS + BRIDGE, floors={"movable": ["bridge"]})
    assert crosses(named)
    assert warnings_with(named, "carries no floor") == []
    # as if it stood
    standing = bake(BANKS + BRIDGE.replace("<freejoint/>", ""))
    np.testing.assert_array_equal(named.floor_height, standing.floor_height)
    np.testing.assert_array_equal(named.occupancy, standing.occupancy)


def test_a_stage_is_floor_where_a_setting_names_it():
    stage = free("stage", box("boards", 0, 0, 0, 1.6, 1.6, 0.2))
    grid = bake(FLOOR + stage)
    assert (grid.floor_height == 0.0).all()
    named = bake(FLOOR + stage, floors={"movable": ["st*"]})
    assert np.count_nonzero(named.floor_height == np.float32(0.2)) == 256
    # it stands over a floor: that is there without it, and nothing is lost
    assert warnings_with(grid, "carries no floor") == []


@pytest.mark.parametrize(
    ("width", "is_told"),
    [(0.9, False), (1.0, True), (1.3, True)],
)
def test_a_lost_floor_is_told_from_1_m2_on(width, is_told):
    platform = free("platform", box("boards", 3, 0, -0.1, 4, width, 0))
    grid = bake(FLOOR + platform, grid={"bounds": [-2, -2, 5, 2]})
    assert bool(warnings_with(grid, "'platform' moves and carries no floor")) == is_told


def test_a_lost_floor_over_a_floor_further_down_is_none():
    """Below a loft, a gallery that moves, there is the ground floor."""
    loft = free("loft", box("boards", -1, -1, 2.4, 1, 1, 2.5))
    assert warnings_with(bake(FLOOR + WALLS + loft), "carries no floor") == []


def test_a_tilted_top_is_no_lost_floor():
    platform = free("slide", box("boards", 3, -1, -0.1, 5, 1, 0))
    platform = platform.replace('name="slide"', 'name="slide" euler="0 60 0"')
    grid = bake(FLOOR + platform, grid={"bounds": [-2, -4, 6, 4]})
    assert warnings_with(grid, "carries no floor") == []


CAR = (
    '<body name="car" pos="3 0 0"><joint name="car" type="slide" axis="0 0 1" range="0 3" '
    'limited="true"/>' + box("plate", -0.9, -0.9, -0.1, 0.9, 0.9, 0) + "</body>"
)


def test_a_lifts_car_is_floor_where_lifts_are_looked_for():
    bounds = {"grid": {"bounds": [-2, -2, 4, 2]}}
    with_lift = bake(FLOOR + CAR, links=[{"auto": "lift"}], **bounds)
    without = bake(FLOOR + CAR, **bounds)
    row, col = with_lift.lattice.rows_cols([3.0, 0.0])
    assert with_lift.floor_height[row, col] == 0.0
    assert np.isnan(without.floor_height[row, col])
    assert warnings_with(with_lift, "carries no floor") == []
    (warning,) = warnings_with(without, "carries no floor")
    assert "'car'" in warning


# ---------------------------------------------------------------- where little or nothing stands


def test_where_nothing_stands_all_is_baked_as_it_stands():
    crate = free("crate", box("wood", 0, 0, 0, 1, 1, 1))
    grid = bake(free("slab", FLOOR) + crate)
    standing = bake(body("slab", FLOOR) + body("crate", box("wood", 0, 0, 0, 1, 1, 1)))
    np.testing.assert_array_equal(grid.floor_height, standing.floor_height)
    np.testing.assert_array_equal(grid.occupancy, standing.occupancy)
    np.testing.assert_array_equal(grid.room_index, standing.room_index)
    assert len(warnings_with(grid, "nothing stands")) == 1
    assert warnings_with(standing, "nothing stands") == []


GROUND = '<geom name="ground" type="plane" size="0 0 1"/>'
TWO_CRATES = free("a", box("a", 0, 0, 0, 1, 1, 1)) + free("b", box("b", 3, 2, 0, 4, 4, 1))


def test_over_endless_ground_the_box_is_that_of_all_bodies():
    grid = bake(GROUND + TWO_CRATES)
    assert grid.lattice.bounds == (0.0, 0.0, 4.0, 4.0)
    assert (grid.floor_height == 0.0).all()
    assert np.count_nonzero(grid.occupancy) == 300


def test_over_ground_of_a_drawn_size_the_box_is_the_grounds():
    grid = bake(GROUND.replace("0 0 1", "3 2 1") + TWO_CRATES)
    assert grid.lattice.bounds == (-3.0, -2.0, 3.0, 2.0)


def test_over_endless_ground_what_stands_is_the_box():
    grid = bake(GROUND + TWO_CRATES + box("slab", 1, 1, 0, 3, 3, 0.1))
    assert grid.lattice.bounds == (1.0, 1.0, 3.0, 3.0)


# ---------------------------------------------------------------- robots


def test_a_body_with_actuators_is_told_apart_from_things(tmp_path: Path):
    robot = (
        '<body name="rover" pos="1 1 0.3"><joint name="x" type="slide" axis="1 0 0"/>'
        '<joint name="y" type="slide" axis="0 1 0"/><joint name="yaw" axis="0 0 1"/>'
        '<geom type="cylinder" size="0.3 0.3"/></body>'
    )
    actuators = "".join(f'<velocity joint="{joint}"/>' for joint in ("x", "y", "yaw"))
    crate = free("crate", box("wood", -1, -1, 0, -0.5, -0.5, 0.5))
    text = f"<mujoco><worldbody>{FLOOR}{robot}{crate}</worldbody>{{}}</mujoco>"

    def warned(xml: str) -> tuple[list[str], list[str]]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            grid = navbake.bake(mujoco.MjModel.from_xml_string(xml))
        return (
            warnings_with(grid, "bodies with actuators take floor"),
            warnings_with(grid, "bodies that can move take floor"),
        )

    robots, things = warned(text.format(f"<actuator>{actuators}</actuator>"))
    (one,) = robots
    (other,) = things
    assert "'rover'" in one
    assert "`robot=`" in one
    assert "`scene.exclude.bodies: [rover]`" in one
    assert "rover" not in other
    assert "'crate'" in other
    robots, things = warned(text.format(""))
    assert robots == []
    (other,) = things
    assert "'crate'" in other
    assert "'rover'" in other


def test_exclude_movable_leaves_a_planar_base_out_of_the_grid():
    path = Path(__file__).parents[4] / "shared/data/reports/planar_base/base.xml"
    if not path.exists():
        pytest.skip(f"{path} is not there")
    assert np.count_nonzero(navbake.bake(path).occupancy) > 20
    grid = navbake.bake(path, exclude={"movable": True})
    assert np.count_nonzero(grid.occupancy) == 0
    assert grid.warnings == ()


@pytest.mark.parametrize("exclude", [{}, {"movable": True}])
def test_a_board_between_posts_stands_though_it_looks_like_a_leaf(exclude):
    """It has no joint, and is no door, as both of its sides are outside."""
    posts = "".join(f'<geom type="box" pos="3 {y} 1.1" size="0.05 0.2 1.1"/>' for y in (2.35, 3.65))
    board = '<body name="board" pos="3 3 1"><geom type="box" size="0.02 0.44 1"/></body>'
    ground = '<geom type="box" pos="3 3 -0.1" size="3 3 0.1"/>'
    xml = f"<mujoco><worldbody>{ground}{posts}{board}</worldbody></mujoco>"
    model = mujoco.MjModel.from_xml_string(xml)
    stages = bake_stages(model, scene={"exclude": exclude})
    assert [leaf.id for leaf in stages.scene.leaves] == ["board"]
    grid = navbake.bake(model, exclude=exclude)
    assert grid.doors == ()
    assert grid.occupancy[grid.lattice.rows_cols(np.array([3.0, 3.0]))] == 1
