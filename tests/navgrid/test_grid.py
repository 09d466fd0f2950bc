"""Grids in memory: what is derived, and how two are told apart."""

from __future__ import annotations

import copy
import pickle
import re

import numpy as np
import pytest

import navbake
from differences import difference_map, first_difference
from navbake.episodes import make_episodes
from navbake.errors import FormatError
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from project_paths import GOLDEN

INF, NAN = np.inf, np.nan

MAP = """\
#####
#...#
#.# #
#####"""


def make_level(text: str = MAP, **fields) -> SceneGrid2D:
    """A level from a map: . free, # blocked, space no floor."""
    cells = np.array([list(row) for row in text.splitlines()])
    height, width = cells.shape
    floor = np.where(cells == " ", NAN, 0.5).astype(np.float32)
    defaults = {
        "cell_size": 0.25,
        "min_yup": (1.0, 0.5, -3.0),
        "weights": np.where(cells == ".", 1.0, INF),
        "attributes": {
            "floorHeight": floor,
            "roomIndex": (cells == ".").astype(np.uint16),
            "occupancy": (cells != ".").astype(np.uint8),
        },
    }
    return SceneGrid2D(width=width, height=height, **{**defaults, **fields})


def make_house(**fields) -> MultiLevelGrid:
    metadata = {"sceneId": "house", "navbake": {"links": [[0, 6, 1, 7]]}}
    defaults = {"grids": [make_level(), make_level()], "cell_size": 0.25, "metadata": metadata}
    return MultiLevelGrid(**{**defaults, **fields})


def test_lattice_and_ground_are_in_the_world():
    lattice = make_level().lattice
    assert (lattice.x_min, lattice.y_max, lattice.cell_size) == (1.0, 3.0, 0.25)
    assert lattice.shape == (4, 5)
    assert make_level().ground == 0.5


def test_lattice_and_ground_are_in_metres_whatever_the_unit():
    level = make_level(unit=0.01)
    lattice = level.lattice
    assert (lattice.x_min, lattice.y_max, lattice.cell_size) == (0.01, 0.03, 0.0025)
    assert level.ground == 0.005
    assert level.floor_height[0, 0] == np.float32(0.5)  # as in the file
    assert level.floor[0, 0] == 0.005
    assert level.floor.dtype == np.float64
    part, (rows, cols) = level.floor_of(slice(1, 3), slice(0, 2)), np.array([[1, 2], [0, 3]])
    np.testing.assert_array_equal(part, level.floor[1:3, :2])
    np.testing.assert_array_equal(level.floor_of(rows, cols), level.floor[rows, cols])


def test_named_layers_are_the_attributes_themselves():
    level = make_level()
    assert level.floor_height is level.attributes["floorHeight"]
    assert level.occupancy is level.attributes["occupancy"]
    assert level.room_index is level.attributes["roomIndex"]
    np.testing.assert_array_equal(level.free, level.weights == 1)
    assert level.levels == [level]
    assert level.step_array.shape == (0, 4)


def test_missing_layers_follow_from_the_weights():
    level = make_level(attributes={})
    np.testing.assert_array_equal(level.occupancy, np.isinf(level.weights))
    np.testing.assert_array_equal(level.floor_height, np.where(level.free, 0.5, NAN))
    assert not level.room_index.any()
    dtypes = (level.floor_height.dtype, level.occupancy.dtype, level.room_index.dtype)
    assert dtypes == (np.float32, np.uint8, np.uint16)
    with pytest.raises(ValueError, match="read-only"):
        level.room_index[0, 0] = 1


def test_layers_of_other_dtypes_are_converted():
    level = make_level(
        ".....",
        attributes={
            "floorHeight": np.array([[0, 1, 2, 3, 4]], dtype=np.int8),
            "roomIndex": np.array([[-1, 2, NAN, 70000, 3]]),
            "occupancy": np.array([[0, 0.5, NAN, 1, 2]]),
        },
    )
    assert level.floor_height.tolist() == [[0, 1, 2, 3, 4]]
    assert level.room_index.tolist() == [[0, 2, 0, 0, 3]]
    assert level.occupancy.tolist() == [[0, 1, 1, 1, 1]]


def test_arrays_of_another_shape_are_refused():
    with pytest.raises(FormatError, match=r"weights has shape \(2, 2\), expected .* \(4, 5\)"):
        make_level(weights=np.ones((2, 2)))
    with pytest.raises(FormatError, match="island has shape"):
        make_level(attributes={"island": np.ones(20)})
    with pytest.raises(FormatError, match="at least one level"):
        make_house(grids=[])


def test_metadata_answers_without_navbakes_part():
    level = make_level()
    assert (level.scene_id, level.navbake) == (None, {})
    level.metadata = {"sceneId": "a", "navbake": {"version": "1"}}
    assert (level.scene_id, level.navbake) == ("a", {"version": "1"})


@pytest.mark.parametrize("levels", [None, [], "x", [3], [{}], [{"name": 3}], [{"name": ""}]])
def test_levels_without_a_name_go_by_their_number(levels):
    assert make_level(metadata={"navbake": {"levels": levels}}).level_names == ["level 0"]


def test_levels_have_the_names_that_the_metadata_state():
    stated = {"navbake": {"levels": [{"name": None}, {"name": "attic"}, {"name": "too many"}]}}
    assert make_house(metadata=stated).level_names == ["level 0", "attic"]


def test_levels_take_over_the_metadata_of_the_whole():
    own = make_level(metadata={"sceneId": "attic"})
    house = make_house(grids=[make_level(), own])
    assert [level.scene_id for level in house.levels] == ["house", "attic"]
    assert house.scene_id == "house"


@pytest.mark.parametrize("links", [[0, 6, 1, 7, 1, 0, 0, 19], [[0, 6, 1, 7], [1, 0, 0, 19]]])
def test_links_are_read_flat_or_nested(links):
    found = make_house(metadata={"navbake": {"links": links}}).step_array
    assert found.dtype == np.int64
    assert found.tolist() == [[0, 6, 1, 7], [1, 0, 0, 19]]


def test_no_links_is_an_answer():
    assert make_house(metadata={}).step_array.shape == (0, 4)


@pytest.mark.parametrize(
    ("links", "culprit"),
    [
        ([[0, 6, 2, 7]], "an existing cell, got cell 7 of level 2 in link 0"),
        ([[0, 6, 1, 7], [-1, 6, 1, 7]], "an existing cell, got cell 6 of level -1 in link 1"),
        ([[0, 6, 1, 20]], "an existing cell, got cell 20 of level 1 in link 0"),
        ([[0, -1, 1, 2]], "an existing cell, got cell -1 of level 0"),
        ([[0, 10**30, 1, 2]], "`int`"),
        ([[0, 6, 1]], "got"),
        ([0, 6, 1], "length 4, got 3"),
        ([0, 6, 1, True], "expected `(int|array)`, got"),
        ([[0, 6, 1, 1.5]], "expected `(int|array)`, got"),
        ([[0, 6, 1, 1], 5], "got"),
        ("0 6 1 1", "expected `(int|array)`, got"),
    ],
)
def test_links_that_lead_nowhere_are_refused(links, culprit):
    house = make_house(metadata={"navbake": {"links": links}})
    with pytest.raises(FormatError, match=culprit) as caught:
        _ = house.steps
    assert "metadata.navbake.links" in str(caught.value)


def test_cell_attributes_complete_what_the_metadata_say():
    stated = [
        {"name": "occupancy", "type": "Uint8ClampedArray", "dataType": "binary", "note": "kept"},
        {"name": "roomIndex", "type": "Float64Array", "dataType": "categorical"},
        {"name": "gone", "type": "Int8Array"},
    ]
    assert make_level(metadata={"cellAttributes": stated}).cell_attributes == [
        {"name": "floorHeight", "type": "Float32Array", "dataType": "continuous"},
        {"name": "roomIndex", "type": "Uint16Array", "dataType": "categorical"},
        {"name": "occupancy", "type": "Uint8ClampedArray", "dataType": "binary", "note": "kept"},
    ]


def test_cell_attributes_of_several_levels_are_those_of_any():
    upper = make_level()
    upper.attributes["island"] = np.zeros(upper.shape, dtype=np.uint16)
    names = [entry["name"] for entry in make_house(grids=[make_level(), upper]).cell_attributes]
    assert names == ["floorHeight", "roomIndex", "occupancy", "island"]


def test_equal_grids_have_no_difference():
    assert first_difference(make_level(), make_level()) is None
    assert first_difference(make_house(), make_house()) is None
    assert first_difference(make_level(timings={"createMillis": 1}), make_level()) is None
    # what a file can't tell apart
    assert (
        first_difference(make_level(metadata={"a": (1, 2)}), make_level(metadata={"a": [1, 2]}))
        is None
    )
    narrow = make_level()
    narrow.weights = narrow.weights.astype(np.float32)
    assert first_difference(narrow, make_level()) is None


def _set_cell(grid, layer, value):
    grid.levels[-1].attributes[layer][1, 2] = value


DIFFERENCES = [
    (
        lambda g: _set_cell(g, "occupancy", 7),
        "occupancy: 1 of 20 cells differ, the first at row 1, col 2: 0 and 7",
    ),
    (
        lambda g: _set_cell(g, "floorHeight", 0.05),
        "floorHeight: 1 of 20 cells differ, .*: 0.5 and 0.05$",
    ),
    (lambda g: _set_cell(g, "floorHeight", NAN), "floorHeight: .*: 0.5 and nan"),
    (
        lambda g: g.levels[-1].weights.fill(10),
        "weights: 20 of 20 cells differ, the first at row 0, col 0: inf and 10",
    ),
    (lambda g: g.levels[-1].attributes.pop("roomIndex"), "roomIndex: only in the first"),
    (lambda g: g.levels[-1].attributes.update(x=np.ones((4, 5))), "x: only in the second"),
    (
        lambda g: g.levels[-1].attributes.update(roomIndex=np.zeros((4, 5), dtype=np.int8)),
        "dtype of roomIndex: uint16 and int8",
    ),
    (
        lambda g: g.levels[-1].user_data.update({7: {"doors": ["a"]}}),
        r"user_data\[7\]: only in the second",
    ),
    (lambda g: setattr(g.levels[-1], "cell_size", 0.5), "cell_size: 0.25 and 0.5"),
    (lambda g: setattr(g.levels[-1], "min_yup", (1.0, 0.0, -3.0)), r"min_yup\[1\]: 0.5 and 0.0"),
    (lambda g: setattr(g.levels[-1], "bbox_yup", ((0.0,) * 3,) * 2), "bbox_yup: None and"),
    (lambda g: g.levels[-1].extra.update(note="n" * 99), "extra.note: only in the second"),
    (lambda g: g.metadata.update(agentHeight=2), "metadata.agentHeight: only in the second"),
    (
        lambda g: g.metadata.update(cellAttributes=[{"name": "occupancy", "dataType": "x"}]),
        "metadata.cellAttributes.occupancy.dataType: 'categorical' and 'x'",
    ),
]


@pytest.mark.parametrize(("change", "expected"), DIFFERENCES)
@pytest.mark.parametrize("make", [make_level, make_house])
def test_a_difference_is_named(make, change, expected):
    changed = make()
    change(changed)
    found = first_difference(make(), changed)
    assert found is not None
    assert "\n" not in found
    is_of_level = make is make_house and "metadata" not in expected
    start = "level 1: " if is_of_level else ""
    assert re.match(re.escape(start) + expected, found), found


def test_other_differences_are_named():
    assert first_difference(make_level(), make_house()) == "types: SceneGrid2D and MultiLevelGrid"
    assert "levels: 2 and 1" in str(
        first_difference(make_house(), make_house(grids=[make_level()]))
    )
    assert "shape" in str(first_difference(make_level(), make_level("..")))
    moved = make_house(extra={"a": [1, {"b": 2}]})
    assert (
        first_difference(make_house(extra={"a": [1, {"b": 3}]}), moved) == "extra.a[1].b: 3 and 2"
    )
    assert first_difference(make_house(extra={"a": [1]}), moved) == "length of extra.a: 1 and 2"


def test_cells_come_before_metadata():
    changed = make_house()
    changed.metadata["sceneId"] = "other"
    changed.grids[1].occupancy[0, 0] = 0
    assert str(first_difference(make_house(), changed)).startswith("level 1: occupancy")


def test_difference_map_draws_the_map_and_marks_cells():
    changed = make_level()
    changed.occupancy[1, 2] = 1
    changed.user_data[19] = {"walls": ["w"]}
    assert difference_map(make_level(), changed) == (
        "#####\n#.x.#\n#.# #\n####x\n. free, # blocked, space no floor, x differs (2 of 20 cells)"
    )


def test_difference_map_never_loses_a_cell():
    rng = np.random.default_rng(0)
    text = "\n".join("".join(row) for row in rng.choice(list(".# "), size=(37, 101)))
    for row, col in [(0, 0), (36, 100), (17, 50), (36, 0)]:
        changed = make_level(text)
        changed.floor_height[row, col] = 9.0
        *lines, legend = difference_map(make_level(text), changed, max_size=20).split("\n")
        assert (len(lines), {len(line) for line in lines}) == (7, {17})
        assert lines[row // 6][col // 6] == "x"
        assert "".join(lines).count("x") == 1
        assert "1 of 3737 cells" in legend
        assert "6 × 6 cells" in legend


def test_difference_map_of_other_shapes_is_a_sentence():
    assert difference_map(make_level(), make_level("..")) == (
        "no picture: the first grid has 5 × 4 cells (width × height), the second 2 × 1"
    )


def test_a_copy_is_the_same_grid():
    house = make_house()
    assert first_difference(house, copy.deepcopy(house)) is None
    assert "weights" not in repr(house)


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        ({}, (1.14, 0.0, 0.25)),
        (
            {"agentHeight": 180, "agentRadius": 30, "traversableFloorHeight": 10},
            (1.8, 0.3, 0.1),
        ),
        ({"agentHeight": 0, "agentRadius": -1, "traversableFloorHeight": 0}, (1.14, 0.0, 0.0)),
        (
            {"agentHeight": "tall", "agentRadius": None, "traversableFloorHeight": -1},
            (1.14, 0.0, 0.25),
        ),
    ],
)
def test_settings_of_the_agent_are_in_metres(stated, expected):
    level = make_level(unit=0.01, metadata=stated)
    assert (level.agent_height, level.agent_radius, level.max_step) == pytest.approx(expected)


def test_a_level_with_other_layers():
    level = make_level(metadata={"sceneId": "a"}, extra={"note": 1})
    heat = np.ones(level.shape)
    other = level.with_layers(attributes={"heat": heat}, metadata={"sceneId": "b"})
    assert list(other.attributes) == [*level.attributes, "heat"]
    assert "heat" not in level.attributes
    assert (level.scene_id, other.scene_id, other.extra) == ("a", "b", {"note": 1})
    assert other.weights is level.weights and other.user_data is level.user_data
    free = level.with_layers(weights=np.ones(level.shape), user_data={3: {}})
    assert (free.free.all(), free.user_data, level.user_data) == (True, {3: {}}, {})
    assert level.with_levels([other]) is other
    assert level.with_levels([other], {"sceneId": "c"}).scene_id == "c"


def test_a_grid_with_other_levels_keeps_the_rest():
    house = make_house(extra={"note": 1}, timings={"a": 2})
    opened = house.with_levels(
        [level.with_layers(weights=level.weights + 1) for level in house.levels]
    )
    assert (opened.extra, opened.timings, opened.steps) == (house.extra, house.timings, house.steps)
    assert opened.metadata is house.metadata
    assert opened.levels[0].weights[1, 1] == 2 and house.levels[0].weights[1, 1] == 1


def test_blocks_and_caches_stay_with_their_grid():
    level = make_level()
    with level.block(cells=(0, 1, 1)):
        twins = [copy.copy(level), copy.deepcopy(level), pickle.loads(pickle.dumps(level))]
        twins.append(level.with_layers())
        assert level.obstacle_state is not None and level.obstacle_state.is_blocked
        assert all(twin.obstacle_state is None and not twin.free[1, 1] for twin in twins)
        assert level.without_obstacles().free[1, 1]
    assert level.free[1, 1]
    assert level.without_obstacles() is level
    assert not twins[-1].free[1, 1]  # a derived grid keeps what was blocked when it was made


def test_grids_doors_and_sets_are_shown_in_one_short_line():
    house = navbake.load(GOLDEN / "house.grid.json.gz")
    assert re.fullmatch(
        r"MultiLevelGrid\('house', 2 levels, [\d.]+ m² free, \d+ rooms, "
        r"baked for a radius of 0\.2 m\)",
        repr(house),
    )
    assert repr(house.inflate(0.3)).endswith("inflated for a radius of 0.3 m)")
    assert "cells" not in repr(house.doors[0]) and house.doors[0].id in repr(house.doors[0])
    episodes = make_episodes(house, count=5)
    assert repr(episodes) == "EpisodeSet(5 episodes of 1 scene, point, radius 0.2 m)"
