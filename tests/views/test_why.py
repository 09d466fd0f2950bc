"""What a grid tells of one place, from the file alone."""

from __future__ import annotations

import json

import pytest

import navbake
from navbake.baker.pipeline import run_bake
from navbake.cli.main import main
from navbake.config.settings import load_config
from navbake.errors import QueryError
from navbake.navgrid.islands import add_layers
from navbake.views.why import describe_column
from project_paths import CONFIGS, GOLDEN

APARTMENT = CONFIGS / "apartment.yaml"
HOUSE = GOLDEN / "house.grid.json.gz"


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    file = tmp_path_factory.mktemp("why") / "apartment.grid.json"
    run_bake(load_config(APARTMENT)).grid.save(file)
    return file


@pytest.fixture(scope="module")
def grid(path):
    return navbake.load(path)


def test_free_cell_has_room_and_island_and_no_blockers(grid):
    facts = grid.describe_cell(0.05, 0.55)
    assert facts["free"] and not facts["occupied"]
    assert facts["room"]["id"] == "hall"
    assert facts["island"] == 1
    assert facts["blockers"] == []


def test_wall_is_named(grid):
    facts = grid.describe_cell(-4.95, 0.0)
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
        assert grid.blockers(x, y) == entry["blockers"]


def test_every_occupied_cell_with_a_floor_says_what_blocks_it(grid):
    level = grid.levels[0]
    for row, col in zip(*((level.occupancy == 1).nonzero()), strict=True):
        entry = level.user_data[int(row) * level.width + int(col)]
        assert any(entry.get(key) for key in ("blockers", "objects", "walls", "doors"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((99.0, 0.0), "99, 0 lies beside level 0: it spans x -5 to 5, y -4 to 4"),
        ((float("nan"), 0.0), "finite numbers, got nan"),
        ((0.0, 0.0, 3), "no level 3: expected 0 to 0"),
    ],
)
def test_wrong_questions_are_refused(grid, arguments, message):
    with pytest.raises(QueryError, match=message):
        grid.describe_cell(*arguments)


def test_command_tells_it(path, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["why", str(path), "--at", "-4.95,0"])
    assert not stop.value.code
    assert "blocked by" in capsys.readouterr().out


def ask_house(capsys, at, *options):
    with pytest.raises(SystemExit) as stop:
        main(["why", str(HOUSE), "--at", at, *options])
    assert not stop.value.code
    return capsys.readouterr().out


def test_command_tells_of_each_level_unless_one_is_given(capsys):
    places = json.loads(ask_house(capsys, "1,1", "--json"))
    assert [place["level"] for place in places] == [0, 1]
    assert places == [navbake.load(HOUSE).describe_cell(1, 1, level) for level in (0, 1)]
    assert json.loads(ask_house(capsys, "1,1,L1", "--json")) == [places[1]]
    assert ask_house(capsys, "1,1").count("verdict") == 2
    assert ask_house(capsys, "1,1,L1").count("verdict") == 1


def test_no_level_is_guessed_where_there_are_several():
    with pytest.raises(QueryError, match="or a level, got x, y: the grid has 2 levels, 0 to 1"):
        navbake.load(HOUSE).blockers(1, 1)


def test_a_level_that_does_not_span_the_place_is_left_out():
    house = navbake.load(HOUSE)
    house.levels[1].min_yup = (-90.0, 3.0, -90.0)
    assert [place["level"] for place in describe_column(house, 1, 1)] == [0]
    with pytest.raises(QueryError, match=r"lies beside level 0.*; .*lies beside level 1"):
        describe_column(house, 50, 50)
    with pytest.raises(QueryError, match=r"^expected a position of finite numbers, got nan, 0$"):
        describe_column(house, float("nan"), 0)


def test_islands_of_the_file_are_not_sought_again():
    grid = navbake.load(HOUSE)
    add_layers(grid, ["island"])
    level = grid.levels[1]
    row, col = (int(v[0]) for v in level.free.nonzero())
    level.attributes["island"][row, col] = 77  # so that an answer tells where it comes from
    x, y = level.lattice.positions(row, col)
    assert grid.describe_cell(x, y, 1)["island"] == 77


def test_command_refuses_a_place_that_is_none(path, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["why", str(path), "--at", "here"])
    assert stop.value.code == 2
    assert "expected X,Y" in capsys.readouterr().err
