"""The tables of links, areas and agents: read, checked, written, cut to a level, and switched."""

import math
import re

import numpy as np
import orjson
import pytest

from navbake.errors import FormatError, QueryError
from navbake.formats.navgrid import dumps_navgrid, read_navgrid
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.navgrid.links import Agent, Area, Link, Step, Stop

LIFT = {
    "name": "A",
    "kind": "lift",
    "stops": [[0, 0], [1, 2]],
    "positions": [[0.5, 0.5, 0.0], [1.5, 0.5, 3.0]],
    "one_way": False,
    "seconds": 12.0,
    "agents": ["robot"],
    "state": "open",
}
JUMP = {**LIFT, "name": "gap", "kind": "jump", "stops": [[1, 0], [1, 3]], "auto": True}
AREAS = [{"name": "lab", "cost": "inf"}, {"name": "hall", "cost": 2, "speed": 0.5, "agents": ["a"]}]
AGENTS = {"robot": {"radius": 0.3, "speed": 0.8}, "person": {}}


def house(links, **tables):
    """Two levels of 1 x 4 cells, 3 m apart."""
    levels = [
        SceneGrid2D(
            cell_size=1.0, width=4, height=1, min_yup=(0.0, 3.0 * k, -1.0),
            weights=np.ones((1, 4)),
            attributes={
                "floorHeight": np.full((1, 4), 3.0 * k, np.float32),
                "area": np.array([[0, 1, 2, 3]], dtype=np.uint8),
            },
        )
        for k in range(2)
    ]  # fmt: skip
    metadata = {"sceneId": "house", "navbake": {"links": links, **tables}}
    return MultiLevelGrid(cell_size=1.0, grids=levels, metadata=metadata)


def test_tables_are_read_and_written_as_they_were(tmp_path):
    grid = house([[0, 3, 1, 3], LIFT, JUMP], areas=AREAS, agents=AGENTS)
    stops = (Stop(0, 0, (0.5, 0.5, 0.0)), Stop(1, 2, (1.5, 0.5, 3.0)))
    assert grid.steps == (Step(0, 3, 1, 3),)
    assert grid.links[0] == Link("A", "lift", stops, seconds=12.0, agents=("robot",))
    assert [link.to_json() for link in grid.links] == [LIFT, JUMP]
    assert grid.areas == (Area("lab", math.inf), Area("hall", 2.0, 0.5, ("a",)))
    assert [area.to_json() for area in grid.areas] == AREAS
    assert grid.agents == {"robot": Agent("robot", 0.3, speed=0.8), "person": Agent("person")}
    assert grid.agents["robot"].to_json() == AGENTS["robot"]
    again = read(dumps_navgrid(grid), tmp_path)
    assert (again.steps, again.links, again.areas) == (grid.steps, grid.links, grid.areas)
    assert again.agents == grid.agents
    assert again.levels[1].area_index.tolist() == [[0, 1, 2, 3]]
    # numbers that the table lacks are no area
    assert [again.at((x, 0.5), level=1).area for x in (0.5, 1.5, 3.5)] == [None, "lab", None]
    assert house([]).at((1.5, 0.5), level=1).area is None


def test_a_level_keeps_the_links_that_have_two_stops_on_it():
    lower, upper = house([[0, 3, 1, 3], LIFT, JUMP, [1, 0, 1, 1]], areas=AREAS, agents=AGENTS).grids
    assert (lower.steps, lower.links) == ((), ())
    assert upper.steps == (Step(0, 0, 0, 1),)
    assert [(link.name, link.stops[1].level, link.stops[1].cell) for link in upper.links] == [
        ("gap", 0, 3)
    ]
    assert len(upper.areas) == 2 and "robot" in lower.agents


@pytest.mark.parametrize(
    ("links", "message"),
    [
        ([{**LIFT, "stops": [[0, 0], [2, 0]]}], r"cell 0 of level 2 in link 0 ('A')"),
        ([LIFT, LIFT], "expected unique names, got 'A' twice at `metadata.navbake.links[1].name`"),
        ([{**LIFT, "stops": [[0, 0]]}], "at `metadata.navbake.links[0].stops`"),
        (
            [{**LIFT, "positions": [[0, 0, 0]]}],
            "a position for each of 2 stops, got 1, in link 'A'",
        ),
        ([[0, 0, 1, 0], {**LIFT, "state": "ajar"}], "'ajar' at `metadata.navbake.links[1].state`"),
        ([{**LIFT, "width": 0}], "at `metadata.navbake.links[0].width`"),
        ([LIFT, [0, 0, 1, 9]], "got cell 9 of level 1 in link 1"),
        ([LIFT, 3], "at `metadata.navbake.links[1]`"),
    ],
)
def test_a_broken_link_is_named(links, message, tmp_path):
    with pytest.raises(FormatError, match=re.escape(message)):
        read(dumps_navgrid(house([])).replace(b'"links":[]', _json("links", links)), tmp_path)


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"areas": [{"name": "lab", "cost": -1}]}, "at `metadata.navbake.areas[0].cost`"),
        (
            {"areas": [{"name": "lab", "cost": "high"}]},
            "invalid enum value 'high' at `metadata.navbake.areas[0].cost`",
        ),
        ({"areas": [{"name": "lab", "cost": 1e11}]}, "at `metadata.navbake.areas[0].cost`"),
        ({"areas": AREAS + AREAS[:1]}, "got 'lab' twice at `metadata.navbake.areas[2].name`"),
        ({"areas": [{"name": str(k)} for k in range(256)]}, "at most 255 areas, got 256"),
        ({"agents": {"robot": {"speed": 0}}}, "at `metadata.navbake.agents"),
    ],
)
def test_a_broken_area_or_agent_is_named(tables, message, tmp_path):
    name, table = next(iter(tables.items()))
    text = dumps_navgrid(house([])).replace(b'"links":[]', b'"links":[],' + _json(name, table))
    with pytest.raises(FormatError, match=re.escape(message)):
        read(text, tmp_path)


def _json(name, table):
    return b'"%s":%s' % (name.encode(), orjson.dumps(table))


def read(text, folder):
    (folder / "house.json").write_bytes(text)
    return read_navgrid(folder / "house.json")


def test_links_are_switched_without_copies_of_arrays():
    grid = house([[0, 3, 1, 3], LIFT, JUMP])
    closed = grid.with_links({"A": "closed"})
    assert [link.state for link in closed.links] == ["closed", "open"]
    assert [link.state for link in grid.links] == ["open", "open"]
    assert closed.levels[1].weights is grid.levels[1].weights
    assert closed.with_links({"A": "open"}).links == grid.links
    assert [link.state for link in grid.levels[1].with_links({"gap": "closed"}).links] == ["closed"]


def test_a_table_that_is_null_has_no_links():
    grid = house([])
    grid.metadata["navbake"]["links"] = None
    assert grid.with_links({}).links == ()


@pytest.mark.parametrize(
    ("states", "message"),
    [
        ({"gapp": "open"}, "no link 'gapp' in 'house': did you mean 'gap'? it has A, gap"),
        ({"A": "shut"}, "expected one of open, closed for 'A', got 'shut'"),
        ("closed", "expected states by link, as {'A': 'closed'}, got 'closed'"),
    ],
)
def test_an_unknown_link_or_state_is_named(states, message):
    with pytest.raises(QueryError, match=re.escape(message)):
        house([LIFT, JUMP]).with_links(states)


def test_a_link_is_told_from_a_door():
    with pytest.raises(
        QueryError, match="no door 'A' in 'house': it is a link, whose state `with_"
    ):
        house([LIFT]).with_doors({"A": "open"})
