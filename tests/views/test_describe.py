"""What `navbake info` and `navbake why` print of a grid, from the file alone."""

import json

import numpy as np
import pytest

import navbake
from map_grids import small
from navbake.cli.main import main
from navbake.errors import QueryError
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.navgrid.islands import add_layers
from navbake.views.describe import describe, describe_column
from project_paths import GOLDEN

HOUSE_FILE, APARTMENT_FILE = GOLDEN / "house.grid.json.gz", GOLDEN / "apartment.grid.json.gz"


def make_level(free, floor, ground=0.0, rooms=None, metadata=None, unit=1.0, cell_size=0.5):
    free = np.array(free, dtype=bool)
    return SceneGrid2D(
        width=free.shape[1],
        height=free.shape[0],
        cell_size=cell_size,
        min_yup=(0.0, ground, 0.0),
        unit=unit,
        weights=np.where(free, 1.0, np.inf),
        attributes={
            "floorHeight": np.array(floor, dtype=np.float32),
            "roomIndex": np.array(rooms if rooms else np.zeros(free.shape), dtype=np.uint16),
        },
        metadata=metadata or {},
    )


HOUSE = {
    "sceneId": "house",
    "agentHeight": 1.5,
    "agentRadius": 0.2,
    "traversableFloorHeight": 0.25,
    "navbake": {
        "version": "0.1.0",
        "mujoco": "4.0.0",
        "sceneDigest": "ab",
        "settingsDigest": "cd",
        "maxSlope": 45.0,
        "levels": [{"name": "ground floor"}, {"name": None}],
        "links": [[0, 3, 1, 0]],
    },
}


@pytest.fixture
def house():
    nan = np.nan
    lower = make_level([[1, 1, 0, 1]], [[0, 0.2, 0.2, 0.2]], rooms=[[1, 1, 0, 7]])
    upper = make_level([[1, 1], [0, 0]], [[2.8, 2.9], [2.8, nan]], ground=2.8)
    return MultiLevelGrid(grids=[lower, upper], cell_size=0.5, metadata=HOUSE)


def test_describes_a_house(house):
    facts = describe(house)
    assert facts == {
        "type": "MultiLevelGrid",
        "scene_id": "house",
        "cell_size": 0.5,
        "agent": {
            "height": 1.5,
            "radius": 0.2,
            "traversable_floor_height": 0.25,
            "max_slope": 45.0,
        },
        "made_by": {
            "navbake": "0.1.0",
            "mujoco": "4.0.0",
            "scene_digest": "ab",
            "settings_digest": "cd",
        },
        "levels": [
            {
                "name": "ground floor",
                "width": 4,
                "height": 1,
                "ground": 0.0,
                "floor_min": 0.0,
                "floor_max": 0.2,
                "floor_area": 1.0,
                "free_area": 0.75,
                "num_islands": 2,
                "largest_island_area": 0.5,
                "num_rooms": 2,
            },
            {
                "name": "level 1",
                "width": 2,
                "height": 2,
                "ground": 2.8,
                "floor_min": 2.8,
                "floor_max": 2.9,
                "floor_area": 0.75,
                "free_area": 0.5,
                "num_islands": 1,
                "largest_island_area": 0.5,
                "num_rooms": 0,
            },
        ],
        "num_islands": 2,
        "num_steps": 1,
        "links": [],
        "areas": [],
        "agents": {},
        "doors": [],
        "inflated": [],
        "warnings": [],
    }
    assert json.loads(json.dumps(facts, allow_nan=False)) == facts


def test_tells_of_inflations(house):
    house.metadata = {**house.metadata, "inflation": "by hand"}
    assert describe(house)["inflated"] == []
    twice = house.inflate(0.1).inflate(0.2, clearance=0.3)
    assert describe(twice)["inflated"] == [
        {"radius": 0.1, "clearance": 0.0, "mode": "exact"},
        {"radius": 0.2, "clearance": 0.3, "mode": "exact"},
    ]


def test_describes_a_file_that_tells_little():
    facts = describe(make_level([[0, 0]], [[np.nan, np.nan]]))
    assert facts["scene_id"] is None
    assert facts["agent"] == facts["made_by"] == {}
    level = facts["levels"][0]
    assert (level["floor_min"], level["floor_max"], level["floor_area"]) == (None, None, 0.0)
    assert (level["num_islands"], level["largest_island_area"]) == (0, 0.0)
    json.dumps(facts, allow_nan=False)


def test_lengths_are_in_metres_whatever_the_unit():
    level = describe(make_level([[1, 1]], [[100.0, 110.0]], ground=100.0, unit=0.01))["levels"][0]
    assert (level["ground"], level["floor_min"], level["floor_max"]) == (1.0, 1.0, 1.1)
    assert level["free_area"] == pytest.approx(2 * 0.005**2)


def test_areas_have_the_size_of_each_levels_own_cells():
    stated = {"navbake": {"areas": [{"name": "lab", "cost": 2.0}]}}
    levels = [
        make_level([[1, 1]], [[0.0, 0.0]], metadata=stated, cell_size=size) for size in (0.5, 0.1)
    ]
    for level in levels:
        level.attributes["area"] = np.array([[1, 1]], dtype=np.uint8)
    house = MultiLevelGrid(grids=levels, cell_size=0.5, metadata=HOUSE | stated)
    (area,) = describe(house)["areas"]
    assert area["m2"] == pytest.approx(2 * 0.5**2 + 2 * 0.1**2)


@pytest.fixture(scope="module")
def grid():
    return navbake.load(APARTMENT_FILE)


def test_free_cell_has_room_and_island_and_no_blockers(grid):
    facts = grid.describe_cell((0.05, 0.55))
    assert facts["free"] and not facts["occupied"]
    assert facts["room"]["id"] == "hall"
    assert facts["island"] == 1
    assert facts["blockers"] == []


def test_wall_is_named(grid):
    facts = grid.describe_cell((-4.95, 0.0))
    assert facts["walls"] and facts["blockers"] == facts["walls"]
    assert facts["room"] is None and facts["island"] is None


def test_furniture_is_named_by_its_body_and_lamps_above_block_nothing(grid):
    level = grid.levels[0]
    blocked = [
        (cell, entry)
        for cell, entry in level.user_data.items()
        if "objects" in entry and "blockers" in entry
    ]
    assert blocked
    for cell, entry in blocked[:50]:
        x, y = level.lattice.positions(*divmod(cell, level.width))
        assert grid.blockers((x, y)) == entry["blockers"]


def test_things_in_a_free_cell_that_are_lower_than_a_step_are_named():
    """Not what carries the floor, hangs over it, or has no box in the file."""
    tops = {"rug": 0.0, "cable": 0.02, "crate": 0.25, "chest": 0.4, "lamp": 2.0}
    boxes = {name: [0.0, 0.0, -0.1, 1.0, 1.0, top] for name, top in tops.items()}
    level = make_level([[1, 0]], [[0.0, 0.0]], metadata=HOUSE | {"navbake": {"boxes": boxes}})
    names = {"objects": [*tops, "unknown"]}
    level.user_data = {0: names, 1: names}
    assert level.describe_cell((0.25, -0.25))["lower_than_step"] == ["cable", "crate"]
    assert level.describe_cell((0.75, -0.25))["lower_than_step"] == []  # it is blocked
    level.metadata["traversableFloorHeight"] = 0.1
    assert level.describe_cell((0.25, -0.25))["lower_than_step"] == ["cable"]


def test_every_occupied_cell_with_a_floor_says_what_blocks_it(grid):
    level = grid.levels[0]
    for row, col in zip(*((level.occupancy == 1).nonzero()), strict=True):
        entry = level.user_data[int(row) * level.width + int(col)]
        assert any(entry.get(key) for key in ("blockers", "objects", "walls", "doors"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((99.0, 0.0),), "^99, 0 lies beside the grid, x -5 to 5, y -4 to 4$"),
        (((99.0, 0.0), 0), "^99, 0 lies beside level 0: it spans x -5 to 5, y -4 to 4$"),
        (((0.0, 0.0, -1.0),), "^0, 0, -1 lies below every floor, the lowest at z 0: positions"),
        (((float("nan"), 0.0),), "finite numbers, got nan"),
        (((0.0, 0.0), 3), "no level 3: expected 0 to 0"),
        (
            (0.0, 0.0),
            r"^expected a position in one argument, as in \(1\.5, -2\.0\), got 0\.0, 0\.0$",
        ),
    ],
)
def test_wrong_questions_are_refused(grid, arguments, message):
    with pytest.raises(QueryError, match=message):
        grid.describe_cell(*arguments)


def test_bounds_are_told_to_a_micrometre():
    level = small(y_max=0.3)
    assert level.lattice.bounds[1] != 0.0 == round(level.lattice.bounds[1], 6)
    expected_text = "99, 0 lies beside the grid, x -3.7 to -3.2, y 0 to 0.3"
    with pytest.raises(QueryError, match=f"^{expected_text}$"):
        level.blockers((99.0, 0.0))
    reason = navbake.PathFinder(level).why_not((-3.65, 0.25), (99.0, 0.0))
    assert "lies beside the grid, x -3.7 to -3.2, y 0 to 0.3" in reason


def ask_house(capsys, at, *options):
    with pytest.raises(SystemExit) as stop:
        main(["why", str(HOUSE_FILE), "--at", at, *options])
    assert not stop.value.code
    return capsys.readouterr().out


def test_command_tells_of_each_level_unless_one_is_given(capsys):
    places = json.loads(ask_house(capsys, "1,1", "--json"))["cells"]
    assert [place["level"] for place in places] == [0, 1]
    assert places == [navbake.load(HOUSE_FILE).describe_cell((1, 1), level) for level in (0, 1)]
    assert json.loads(ask_house(capsys, "1,1,L1", "--json"))["cells"] == [places[1]]
    assert ask_house(capsys, "1,1").count("verdict") == 2
    assert ask_house(capsys, "1,1,L1").count("verdict") == 1


def test_no_level_is_guessed_where_there_are_several():
    with pytest.raises(QueryError, match="or a level, got x, y: the grid has 2 levels, 0 to 1"):
        navbake.load(HOUSE_FILE).blockers((1, 1))


def test_a_position_on_several_levels_is_on_the_floor_below_it():
    house = navbake.load(HOUSE_FILE)
    for number, level in enumerate(house.levels):
        row, col = np.argwhere((level.occupancy == 1) & ~np.isnan(level.floor))[0].tolist()
        position = house.position_of((number, row, col))
        facts = house.describe_cell(position)
        assert (facts["level"], facts["row"], facts["col"]) == (number, row, col)
        assert facts == house.describe_cell(position, number)
        assert house.blockers(position) == facts["blockers"] != []


def test_a_level_that_does_not_span_the_place_is_left_out():
    house = navbake.load(HOUSE_FILE)
    house.levels[1].min_yup = (-90.0, 3.0, -90.0)
    assert [place["level"] for place in describe_column(house, 1, 1)] == [0]
    with pytest.raises(QueryError, match=r"lies beside level 0.*; .*lies beside level 1"):
        describe_column(house, 50, 50)
    with pytest.raises(QueryError, match=r"^expected a position of finite numbers, got nan, 0$"):
        describe_column(house, float("nan"), 0)


def test_islands_of_the_file_are_not_sought_again():
    grid = navbake.load(HOUSE_FILE)
    add_layers(grid, ["island"])
    level = grid.levels[1]
    row, col = (int(v[0]) for v in level.free.nonzero())
    level.attributes["island"][row, col] = 77  # so that an answer tells where it comes from
    x, y = level.lattice.positions(row, col)
    assert grid.describe_cell((x, y), 1)["island"] == 77
