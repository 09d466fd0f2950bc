"""The stages of a bake: one can stop at each; each runs once, whatever is a door."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest

import navbake
from box_worlds import FLOOR, box, stages_of_xml, world
from door_scenes import CUPBOARD, LEAF, ROOMS, SHELL, bake_world
from door_scenes import world as door_world
from navbake.baker.bake.boxes import rounded_ground
from navbake.baker.bake.pipeline import run_bake
from navbake.baker.bake.stages import bake_stages
from navbake.baker.columns import column_sources
from navbake.baker.columns.columns import Columns
from navbake.baker.floors.levels import Floors
from navbake.baker.occupancy.occupancy import StructureOccupancy
from navbake.baker.occupants.movable import MovableOccupants
from navbake.baker.occupants.standing import StandingOccupants
from navbake.baker.rooms.rooms import Rooms
from navbake.baker.scene.scene import Scene
from navbake.config.settings import load_config
from navbake.errors import SceneError
from navbake.threads import num_threads
from project_paths import CONFIGS

TYPES = {
    "scene": Scene,
    "columns": Columns,
    "floors": Floors,
    "occupancy": StructureOccupancy,
    "standing_occupants": StandingOccupants,
    "rooms": Rooms,
    "doors": list,
    "occupants": MovableOccupants,
}
TIMED_AS = {"standing_occupants": "contents"}  # attribute of `Stages` -> its name in the timings
STAGES = [*(TIMED_AS.get(name, name) for name in TYPES), "grid"]
CUPBOARD_DOOR = CUPBOARD[CUPBOARD.index('<body name="cupboard_door"') : CUPBOARD.rindex("</body>")]


def has_run(stages) -> list[str]:
    return list(stages.clock.seconds)


@pytest.mark.parametrize("last", TYPES)
def test_one_can_stop_at_each_stage(tmp_path, last):
    stages = stages_of_xml(tmp_path, world(FLOOR + box("crate", 0, 0, 0, 0.5, 0.5, 0.5)))
    value = getattr(stages, last)
    assert type(value) is TYPES[last]
    assert has_run(stages) == STAGES[: list(TYPES).index(last) + 1]
    assert getattr(stages, last) is value  # it is kept


def test_the_stages_of_a_crate_on_a_floor(tmp_path):
    stages = stages_of_xml(tmp_path, world(FLOOR + box("crate", 0, 0, 0, 0.5, 0.5, 0.5)))
    (level,) = stages.floors.levels
    assert [geom.name for geom in stages.scene.geoms] == ["floor", "crate"]
    assert stages.lattice.shape == level.floor.shape == (40, 40)
    assert len(stages.columns.z) == 2 * 1600 + 2 * 25
    assert (level.floor[~np.isnan(level.floor)] == 0.0).all()
    assert stages.occupancy.levels[0].sum() == 25
    assert not stages.standing_occupants.mark_walls(0)[0].any()
    assert [room.id for room in stages.rooms.table] == ["0:1"]
    assert stages.doors == []
    assert stages.occupants.blocked[0].sum() == 25


def test_the_name_of_blocked_cells_before_0_4_stays(tmp_path):
    """With a warning that names the new one."""
    stages = stages_of_xml(tmp_path, world(FLOOR + box("crate", 0, 0, 0, 0.5, 0.5, 0.5)))
    with pytest.warns(DeprecationWarning, match=r"stages\.occupants\.blocked"):
        assert stages.occupants.occupied is stages.occupants.blocked


def test_columns_can_be_looked_at_where_there_is_no_floor(tmp_path):
    stages = stages_of_xml(tmp_path, world(box("ball", 0, 0, 0, 0.5, 0.5, 0.5)))
    assert len(stages.columns.z) == 2 * 25
    with pytest.raises(SceneError, match=r"scene\.xml: no floor.* the scene spans"):
        _ = stages.floors
    assert has_run(stages) == ["scene", "columns"]


def test_contents_are_found_only_where_something_needs_them(tmp_path):
    for settings, is_needed in (
        ({}, True),
        ({"names": False}, True),  # rooms need the walls
        ({"rooms": "none"}, True),
        ({"names": False, "rooms": "none"}, False),
    ):
        stages = stages_of_xml(tmp_path, world(FLOOR), **settings)
        assert (stages.standing_occupants is not None) == is_needed
        assert has_run(stages)[-1] == "contents"


@pytest.mark.parametrize("name", ["apartment", "house"])
def test_a_bake_is_its_stages(name):
    config = load_config(CONFIGS / f"{name}.yaml")
    result, stages = run_bake(config), bake_stages(CONFIGS / f"{name}.yaml")
    assert list(result.timings) == STAGES
    assert list(result.grid.timings) == ["createMillis", *(f"{stage}Millis" for stage in STAGES)]
    assert [level.ground for level in result.grid.levels] == [
        rounded_ground(level) for level in stages.floors.levels
    ]
    removed = result.grid.with_doors("removed")
    num_free = [int((~occupied).sum()) for occupied in stages.occupancy.levels]
    assert [int(level.free.sum()) for level in removed.levels] == num_free
    num_in_room = [int((index > 0).sum()) for index in stages.rooms.index]
    assert [int((level.room_index > 0).sum()) for level in removed.levels] == num_in_room


def test_geometry_is_given_back_before_the_grid_is_made(tmp_path, monkeypatch):
    opened = []
    open_stages = navbake.baker.bake.pipeline.open_stages
    build = navbake.baker.bake.pipeline.build_grid

    def open_and_watch(*given, **named):
        stages = open_stages(*given, **named)
        opened.extend([weakref.ref(stages), weakref.ref(stages.columns.z)])
        return stages

    def build_and_look(*given):
        gc.collect()
        assert [kept() for kept in opened] == [None, None]
        return build(*given)

    monkeypatch.setattr("navbake.baker.bake.pipeline.open_stages", open_and_watch)
    monkeypatch.setattr("navbake.baker.bake.pipeline.build_grid", build_and_look)
    bake_world(tmp_path, SHELL)
    assert opened


# ---------------------------------------------------------------- doors, and what is none


def stages_of(folder, *parts, **settings):
    return stages_of_xml(folder, door_world(*parts), **settings)


def test_what_stands_is_found_without_the_leaves(tmp_path):
    stages = stages_of(tmp_path, ROOMS, LEAF)
    leaf = next(geom.id for geom in stages.scene.geoms if geom.name == "leaf")
    assert leaf in stages.scene.shapes.solids.geom
    assert leaf not in stages.scene.structure.solids.geom
    assert leaf not in stages.columns.geom
    row, col = stages.lattice.rows_cols([3.0, 1.5])
    assert not stages.occupancy.levels[0][row, col]
    assert not stages.occupants.blocked[0][row, col]
    (door,) = stages.doors
    assert door.is_door
    assert row * stages.lattice.width + col in door.blocked["closed"][0]


@pytest.mark.parametrize("parts", [(ROOMS, LEAF), (ROOMS, CUPBOARD), (ROOMS, LEAF, CUPBOARD)])
def test_each_stage_begins_once_whatever_is_a_door(tmp_path, parts):
    begun = []

    def progress(stage: str, share: float) -> None:
        if share == 0.0:
            begun.append(stage)

    bake_world(tmp_path, *parts, progress=progress)
    for stage in ("scene", "columns", "floors", "occupancy", "contents", "occupants", "grid"):
        assert begun.count(stage) == 1


def test_a_leaf_that_is_no_door_is_in_the_way_alone(tmp_path):
    without = stages_of(tmp_path, ROOMS, LEAF, CUPBOARD.replace(CUPBOARD_DOOR, ""))
    stages = stages_of(tmp_path, ROOMS, LEAF, CUPBOARD)
    assert [placed.candidate.id for placed in stages.doors] == ["leaf", "cupboard_door"]
    assert [placed.is_door for placed in stages.doors] == [True, False]
    assert stages.lattice == without.lattice
    one, other = stages.floors.levels[0], without.floors.levels[0]
    np.testing.assert_array_equal(one.floor, other.floor)
    np.testing.assert_array_equal(stages.rooms.index[0], without.rooms.index[0])
    np.testing.assert_array_equal(stages.occupancy.levels[0], without.occupancy.levels[0])
    blocked = stages.occupants.blocked[0] & ~stages.occupancy.levels[0]
    row, col = np.nonzero(blocked)
    places = stages.lattice.positions(row, col)
    # the leaf stands 0.8 m wide before the cupboard
    assert len(places) > 5
    assert (np.abs(places - [5.58, 2.6]) <= [0.08, 0.46]).all()


# A leaf on the edge of the floor, and outside a stage that slides, whose backdrop looks like a
# leaf. It carries no floor, so that the leaf joins the room and the outside.
EDGE = """
<geom name="floor" type="box" pos="2 1.5 -0.1" size="2.1 1.6 0.1"/>
<geom name="wall_1" type="box" pos="4 0.525 1.2" size="0.05 0.525 1.2"/>
<geom name="wall_2" type="box" pos="4 2.475 1.2" size="0.05 0.525 1.2"/>
<body name="leaf" pos="4 1.06 0"><joint axis="0 0 1" range="0 90"/>
<geom type="box" pos="0 0.44 1" size="0.02 0.43 1"/></body>
"""
STAGE = """
<body name="stage" pos="4.1 1.5 0"><joint type="slide" axis="1 0 0" range="0 1"/>
<geom type="box" pos="0.45 0 -0.05" size="0.45 0.6 0.05"/>
<geom name="backdrop" type="box" pos="0.88 0 1.2" size="0.02 0.6 1.2"/></body>
"""


def test_what_is_no_door_leaves_other_leaves_as_they_are(tmp_path):
    settings = {"rooms": {"sources": ["auto"], "min_area": 2.0}}
    alone = bake_world(tmp_path, EDGE, **settings).grid
    assert [door.id for door in alone.doors] == ["leaf"]
    grid = bake_world(tmp_path, EDGE, STAGE, **settings).grid
    assert grid.doors == alone.doors
    assert grid.lattice == alone.lattice
    np.testing.assert_array_equal(grid.floor_height, alone.floor_height)
    np.testing.assert_array_equal(grid.room_index, alone.room_index)


def test_threads_are_given_back(tmp_path):
    before = num_threads()
    (tmp_path / "scene.xml").write_text(door_world(SHELL))
    navbake.bake(tmp_path / "scene.xml", threads=1)
    assert num_threads() == before


def test_columns_are_cast_once(tmp_path, monkeypatch):
    """What gives the geometry back must not be followed by a stage that asks for it again."""
    casts = []
    cast = column_sources.cast_columns
    monkeypatch.setattr(
        column_sources, "cast_columns", lambda *given: casts.append(0) or cast(*given)
    )
    (tmp_path / "scene.xml").write_text(world(FLOOR))
    navbake.bake({"scene": {"path": str(tmp_path / "scene.xml")}, "grid": {"bounds": [0, 0, 1, 1]}})
    assert len(casts) == 1
