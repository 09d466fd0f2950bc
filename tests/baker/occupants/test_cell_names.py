"""User data: under which names things stand in cells."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from box_worlds import FLOOR, body, box, stages_of_xml, world
from navbake.baker.bake.pipeline import run_bake
from navbake.baker.bake.stages import Stages
from navbake.baker.core.constants import OBJECT, WALL
from navbake.baker.occupants.cell_names import (
    BLOCKERS,
    OBJECTS,
    OBJECTS_OR_WALLS,
    WALLS,
    name_cells,
)
from navbake.baker.occupants.movable import name_occupants
from navbake.config.settings import parse_config
from navbake.navgrid.lattice import Lattice

SMALL = {"min_area": 0.1, "shrink": 0.1}


def user_data(stages: Stages, level: int = 0) -> dict[int, Any]:
    height, width = stages.lattice.shape
    window = (slice(0, height), slice(0, width))
    return dict(name_occupants(stages.standing_occupants, stages.occupants, level, window))


def at(stages: Stages, x: float, y: float, level: int = 0) -> Any:
    """The user data of the cell that holds a position."""
    row, col = stages.lattice.rows_cols([x, y])
    return user_data(stages, level).get(int(row) * stages.lattice.width + int(col))


def test_names_are_those_of_the_topmost_body(tmp_path):
    things = body(
        "table",
        box("top", 0, 0, 0.7, 1, 1, 0.75)
        + body(
            "leg",
            box("leg_geom", 0, 0, 0, 0.1, 0.1, 0.7) + body("", box("", 0, 0, 0.75, 0.1, 0.1, 1)),
        ),
    )
    stages = stages_of_xml(tmp_path, world(FLOOR + things))
    assert at(stages, 0.05, 0.05) == {"objects": ["table"]}
    assert at(stages, 0.55, 0.55) == {"objects": ["table"]}
    assert at(stages, -0.5, -0.5) is None


def test_on_the_world_a_geom_has_its_own_name_and_without_one_its_number(tmp_path):
    things = (
        box("crate", 0, 0, 0, 0.5, 0.5, 0.5)
        + box("", -1, -1, 0, -0.5, -0.5, 0.5)
        + body("", box("inner", 1, 1, 0, 1.5, 1.5, 0.5))
    )
    stages = stages_of_xml(tmp_path, world(FLOOR + things))
    assert at(stages, 0.25, 0.25) == {"objects": ["crate"]}
    assert at(stages, -0.75, -0.75) == {"objects": ["geom 2"]}
    assert at(stages, 1.25, 1.25) == {"objects": ["body 1"]}


def test_several_names_are_sorted_and_unique(tmp_path):
    things = (
        body("zebra", box("z", 0, 0, 0, 1, 1, 0.3))
        + body("ähre", box("a", 0, 0, 0.3, 1, 1, 0.4) + box("b", 0, 0, 0.4, 1, 1, 0.5))
        + body("ant", box("c", 0, 0, 0.5, 1, 1, 0.6))
    )
    stages = stages_of_xml(tmp_path, world(FLOOR + things))
    assert at(stages, 0.5, 0.5) == {"objects": ["ant", "zebra", "ähre"]}


def test_one_name_for_a_geom_and_a_body_is_there_once(tmp_path):
    things = box("box", 0, 0, 0, 1, 1, 0.3) + body("box", box("other", 0, 0, 0.3, 1, 1, 0.6))
    stages = stages_of_xml(tmp_path, world(FLOOR + things))
    assert at(stages, 0.5, 0.5) == {"objects": ["box"]}


def test_blockers_are_named_where_not_all_that_stands_there_blocks(tmp_path):
    things = (
        body("lamp", box("shade", 0, 0, 1.8, 1.5, 0.5, 2))
        + body("table", box("top", 0, 0, 0.6, 1, 1, 0.7))
        + body("mat", box("rubber", 0, 0, 0, 0.5, 1, 0.1))
    )
    stages = stages_of_xml(tmp_path, world(FLOOR + things))
    assert at(stages, 0.75, 0.75) == {"objects": ["table"]}
    assert at(stages, 0.75, 0.25) == {"objects": ["lamp", "table"], "blockers": ["table"]}
    assert at(stages, 1.25, 0.25) == {"objects": ["lamp"]}
    assert at(stages, 0.25, 0.75) == {"objects": ["mat", "table"], "blockers": ["table"]}


def test_a_wide_agent_is_blocked_by_what_stands_beside_the_cell(tmp_path):
    stages = stages_of_xml(
        tmp_path, world(FLOOR + box("crate", 0, 0, 0, 0.5, 0.5, 0.5)), agent={"radius": 0.2}
    )
    assert at(stages, 0.25, 0.25) == {"objects": ["crate"]}
    assert at(stages, -0.15, 0.25) == {"blockers": ["crate"]}
    assert at(stages, -0.35, 0.25) is None


def test_things_that_carry_a_floor_are_named_and_floors_and_stairs_are_not(tmp_path):
    rug = body("rug", box("weave", -1.9, -1.9, 0, -1, -1, 0.01))
    toy = body("toy", box("block", -1.9, 0, 0, -1.6, 0.3, 0.2))
    steps = "".join(
        box(f"step {k}", 0.3 * k, -1.5, 0, 0.3 * k + 0.3, -0.5, 0.2 * k + 0.2) for k in range(4)
    )
    landing = box("landing", 1.2, -1.9, 0, 4, 1.9, 1.0)
    stages = stages_of_xml(tmp_path, world(FLOOR + rug + toy + steps + landing))
    kinds = dict(
        zip((r.name for r in stages.scene.geoms), stages.standing_occupants.kinds, strict=True)
    )
    assert {name for name, kind in kinds.items() if kind == OBJECT} == {"weave", "block"}
    assert at(stages, -1.45, -1.45) == {"objects": ["rug"]}
    assert at(stages, -1.75, 0.15) == {"objects": ["toy"]}
    assert at(stages, 0.15, -1.05) is None
    assert at(stages, 0.5, 0.5) is None


def test_stairs_block_under_their_names_only(tmp_path):
    steps = body(
        "stair",
        "".join(box("", 0.3 * k, -1.5, 0, 0.3 * k + 0.3, -0.5, 0.2 * k + 0.2) for k in range(5)),
    )
    landing = box("landing", 1.5, -1.9, 0, 4, 1.9, 1.2)
    stages = stages_of_xml(tmp_path, world(FLOOR + steps + landing), agent={"radius": 0.4})
    assert at(stages, 0.25, -1.05) == {"blockers": ["stair"]}
    assert at(stages, 1.35, 0.0) == {"blockers": ["landing"]}
    assert {key for data in user_data(stages).values() for key in data} == {"blockers"}


def test_a_large_rug_and_floors_on_a_ground_plane_are_not_named(tmp_path):
    plane = '<geom name="ground" type="plane" size="0 0 1" pos="0 0 -0.05"/>'
    rug = body("rug", box("weave", -1.5, -1.5, 0, 1.5, 1.5, 0.01))
    tiles = "".join(
        box(f"tile {i}{j}", i, j, -0.1, i + 1, j + 1, 0) for i in range(-2, 2) for j in range(-2, 2)
    )
    for floor in (FLOOR, tiles):
        stages = stages_of_xml(tmp_path, world(plane + floor + rug))
        assert user_data(stages) == {}


def test_ceilings_and_roofs_are_not_named_but_what_hangs_from_them_is(tmp_path):
    roof = box("roof", -2, -2, 2.5, 2, 2, 2.7) + body("fan", box("blade", 0, 0, 2.2, 1, 0.2, 2.25))
    stages = stages_of_xml(tmp_path, world(FLOOR + roof))
    assert at(stages, 0.5, 0.1) == {"objects": ["fan"]}
    assert at(stages, -0.5, -0.5) is None


def test_each_level_names_its_own(tmp_path):
    upper = box("slab", -2, -2, 2.7, 2, 2, 3.0)
    things = body("low", box("a", 0, 0, 0, 1, 1, 1)) + body("high", box("b", 0, 0, 3, 1, 1, 4))
    stages = stages_of_xml(tmp_path, world(FLOOR + upper + things), floors={"roofs": True})
    assert len(stages.floors.levels) == 2
    assert at(stages, 0.5, 0.5) == {"objects": ["low"]}
    assert at(stages, 0.5, 0.5, level=1) == {"objects": ["high"]}


def test_a_window_counts_cells_from_its_own_corner(tmp_path):
    stages = stages_of_xml(tmp_path, world(FLOOR + box("crate", 0, 0, 0, 0.3, 0.2, 0.5)))
    whole = user_data(stages)
    window = (slice(18, 30), slice(21, 25))
    part = dict(name_occupants(stages.standing_occupants, stages.occupants, 0, window))
    expected = {
        (cell // 40 - 18) * 4 + cell % 40 - 21: data
        for cell, data in whole.items()
        if 18 <= cell // 40 < 30 and 21 <= cell % 40 < 25
    }
    assert part == expected
    assert len(part) == 4
    assert list(part) == sorted(part)


def test_an_empty_level_has_no_user_data(tmp_path):
    stages = stages_of_xml(tmp_path, world(FLOOR))
    assert user_data(stages) == {}
    assert not stages.standing_occupants.mark_walls(0)[0].any()


def test_the_map_of_a_room(tmp_path):
    walls = box("south wall", -1, -1, 0, 1, -0.8, 2.5) + box("west wall", -1, -0.8, 0, -0.8, 1, 2.5)
    things = body("bed", box("mattress", 0, 0, 0, 0.6, 0.6, 0.5)) + body(
        "lamp", box("shade", 0.4, 0.4, 1.8, 0.8, 0.8, 2)
    )
    floor = box("floor", -1, -1, -0.1, 1, 1, 0)
    stages = stages_of_xml(
        tmp_path, world(floor + walls + things), grid={"cell_size": 0.2}, floors=SMALL
    )
    contents = stages.standing_occupants
    data = user_data(stages)
    picture = "\n".join(
        "".join(
            "".join(sorted(name[0] for key in ("objects", "walls") for name in cell.get(key, [])))
            or "."
            for cell in (data.get(row * 10 + col, {}) for col in range(10))
        )
        for row in range(10)
    )
    assert picture.replace("bl", "2") == (
        "w.........\n"
        "w......ll.\n"
        "w....bb2l.\n"
        "w....bbb..\n"
        "w....bbb..\n"
        "w.........\n"
        "w.........\n"
        "w.........\n"
        "w.........\n"
        "ssssssssss"
    )
    expected = np.zeros((10, 10), dtype=bool)
    expected[:, 0] = expected[9] = True
    np.testing.assert_array_equal(contents.mark_walls(0)[0], expected)
    assert [contents.kinds[k] for k in (1, 2)] == [WALL, WALL]


def test_names_can_be_switched_off(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(world(FLOOR + box("crate", 0, 0, 0, 1, 1, 1)))
    for names, expected in ((True, 100), (False, 0), ({"enabled": False}, 0)):
        grid = run_bake(parse_config({"scene": {"path": path}, "names": names})).grid
        assert len(grid.levels[0].user_data) == expected


def test_boxes_hold_all_geoms_of_a_name_in_their_pose(tmp_path):
    path = tmp_path / "scene.xml"
    desk = (
        '<body name="desk" pos="1 0.5 0" euler="0 0 90">'
        '<geom type="box" pos="0 0 0.7" size="0.6 0.3 0.02"/>'
        '<body><geom type="sphere" pos="0 0 0.81" size="0.09"/></body></body>'
    )
    plane = '<geom name="ground" type="plane" size="0 0 1"/>'
    path.write_text(world(FLOOR + plane + desk + box("crate", -1, 0, 0, -0.5, 0.12345, 1)))
    grid = run_bake(parse_config({"scene": {"path": path}})).grid
    assert "ground" not in grid.name_boxes  # it has no end
    assert grid.name_boxes["desk"] == (0.7, -0.1, 0.68, 1.3, 1.1, 0.9)
    assert grid.name_boxes["crate"] == (-1.0, 0.0, 0.0, -0.5, 0.1235, 1.0)
    nameless = run_bake(parse_config({"scene": {"path": path}, "names": False})).grid
    assert nameless.name_boxes == {} and "boxes" not in nameless.navbake


@pytest.mark.parametrize("seed", range(20))
def test_entries_are_those_of_one_cell_after_another(seed):
    rng = np.random.default_rng(seed)
    names = rng.permutation([f"thing {k}" for k in range(12)]).tolist()
    names[7] = names[3]
    count = int(rng.integers(0, 60))
    cell = np.sort(rng.integers(0, 20, count))
    geom, bits = rng.integers(0, 12, count), rng.integers(0, 8, count)
    lattice = Lattice(x_min=0.0, y_max=4.0, cell_size=1.0, width=5, height=4)
    cells, number, entries = name_cells(
        cell, geom, bits, names, lattice, (slice(0, 4), slice(0, 5))
    )
    expected = {}
    for at in range(20):
        here: dict[str, int] = {}
        for k in np.flatnonzero((cell == at) & (bits > 0)).tolist():
            here[names[geom[k]]] = here.get(names[geom[k]], 0) | int(bits[k])
        listed = {
            key: sorted(name for name, b in here.items() if b & bit)
            for key, bit in (("objects", OBJECTS), ("walls", WALLS), ("blockers", BLOCKERS))
        }
        if listed["blockers"] == sorted(name for name, b in here.items() if b & OBJECTS_OR_WALLS):
            listed["blockers"] = []
        if here:
            expected[at] = [(key, found) for key, found in listed.items() if found]
    found = [list(entries[k].items()) for k in number.tolist()]
    assert dict(zip(cells.tolist(), found, strict=True)) == expected
