"""What an inflation closes, and that it is what `why_not` names."""

from __future__ import annotations

import pytest

import navbake
from grid_maps import house_from, level_from
from navbake.formats.graphs import make_room_graph
from navbake.runtime.passage import find_lost_connections
from navbake.runtime.search import Search
from project_paths import GOLDEN


def cuts_of(grid, radius):
    return [name for name, _ in find_lost_connections(Search(grid), Search(grid.inflate(radius)))]


@pytest.mark.parametrize("radius", [0.35, 0.42, 0.5])
@pytest.mark.parametrize("name", ["house", "apartment", "clutter"])
def test_the_doors_are_those_that_steps_no_longer_pass(name, radius):
    grid = navbake.load(GOLDEN / f"{name}.grid.json.gz")
    before, after = (
        {way.door for way in make_room_graph(own).ways if way.kind == "door" and way.passable}
        for own in (grid, grid.inflate(radius))
    )
    named = {text for text in cuts_of(grid, radius) if text.startswith("door")}
    assert named == {f"door {door!r}" for door in before - after}


# a room, treads and a landing; another one above it
GROUND = "\n".join(["............1122"] * 8)
ABOVE = "\n".join(["................"] * 8)


def test_a_landing_between_blocked_treads_is_no_way():
    def stairs(ground):
        upper = level_from(ABOVE, x=1.6, ground=0.4)
        steps = [((0, row, 15), (1, row, 0)) for row in range(8)]
        return house_from([level_from(ground), upper], steps)

    before, after = Search(stairs(GROUND)), Search(stairs(GROUND.replace("11", "++")))
    assert before.islands.count == 1 and after.islands.count == 2
    ((name, _),) = find_lost_connections(before, after)
    assert name == "the stairs between level 0 and 1 near (1.60, -0.40)"
    assert find_lost_connections(before, before) == find_lost_connections(after, after) == []


def test_one_of_two_stairs_is_named_and_a_closed_door_is_not():
    steps = [((0, 0, 0), (1, 0, 0)), ((0, 3, 0), (1, 3, 0)), ((0, 4, 0), (1, 4, 0))]
    lower, upper = (level_from("\n".join(["." * 12] * 6), ground=z) for z in (0.0, 0.04))
    before = house_from([lower, upper], steps)
    blocked = house_from(
        [level_from("+" + "." * 11 + "\n" + "\n".join(["." * 12] * 5)), upper], steps
    )
    ((name, _),) = find_lost_connections(Search(before), Search(blocked))
    assert name == "the ramp between level 0 and 1 near (0.05, -0.05)"
    house = navbake.load(GOLDEN / "house.grid.json.gz").with_doors({"door_front": "closed"})
    assert "door 'door_front'" not in cuts_of(house, 0.5) and "door 'door_back'" in cuts_of(
        house, 0.5
    )
