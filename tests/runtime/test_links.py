"""Plans over links and areas for agents: small towers by hand, and random ones against Dijkstra."""

import math
import re
from collections import Counter

import numpy as np
import pytest

import navbake
from grid_maps import house_from, level_from
from link_towers import DROP, LIFT, at, link, tower
from navbake import Agent, PathFinder, tensors
from navbake.errors import QueryError
from navbake.navgrid.islands import add_layers, find_islands
from oracles.plans import check_plans


@pytest.mark.parametrize("seed", range(12))
def test_paths_fields_islands_and_reasons_equal_a_plain_graph(seed):
    assert check_plans(seed, Counter(), pairs=3) == []


def test_a_lift_costs_its_length_and_lasts_its_seconds():
    finder = PathFinder(tower(LIFT, storeys=3))
    path = finder.find_path(at(0, 2), at(2, 9))
    assert path.links == ["A"]
    assert path.cost == pytest.approx(0.3 + 6.0 + 0.4)  # over the storey in between
    assert path.seconds == pytest.approx(0.3 + 12.0 + 0.4)
    np.testing.assert_allclose(path.positions[path.stops[0]], [at(0, 5), at(2, 5)], atol=1e-6)
    assert "links A" in repr(path)
    robot = PathFinder(tower(LIFT, storeys=3), agent="robot").find_path(at(0, 2), at(2, 9))
    assert robot.seconds == pytest.approx(0.7 / 0.5 + 12.0)


def test_a_path_by_time_goes_round_mud_that_one_by_cost_takes():
    levels = [level_from("......\n......\n......")]
    levels[0].attributes["area"] = np.array([[0] * 6, [0] * 6, [0, 1, 1, 1, 1, 0]], dtype=np.uint8)
    metadata = {"navbake": {"areas": [{"name": "mud", "speed": 0.1}]}}
    finder = PathFinder(levels[0].with_layers(metadata=metadata))
    ends = (0.05, -0.25), (0.55, -0.25)
    one, other = (finder.find_path(*ends, by=by, smooth=False) for by in ("cost", "time"))
    assert (one.cost, one.seconds) == pytest.approx((0.5, 4 * 1.0 + 0.1))
    assert other.seconds == pytest.approx(0.3 + 0.2 * math.sqrt(2))
    assert other.cost == pytest.approx(other.seconds)  # at 1 m/s
    assert finder.distances(ends[0], ends[1], by="time") == pytest.approx(other.seconds)
    with pytest.raises(QueryError, match="expected cost or time as by, got 'speed'"):
        finder.find_path(*ends, by="speed")


def test_areas_price_and_bar():
    grid = tower(storeys=1, areas=[(0, 5, 9, 2), (0, 12, 12, 1)])
    finder = PathFinder(grid)
    assert finder.find_path(at(0, 2), at(0, 14)).cost == pytest.approx(0.7 + 0.5 * 3)
    person = PathFinder(grid, agent="person")
    assert person.find_path(at(0, 2), at(0, 14)) is None
    assert person.why_not(at(0, 2), at(0, 14)).endswith("; the area 'lab' bars 'person'")
    assert "lies in the area 'lab', which bars 'person'" in person.why_not(at(0, 2), at(0, 12))
    assert not person.is_navigable(at(0, 12)) and finder.is_navigable(at(0, 12))
    assert grid.at(at(0, 12)).area == "lab" and grid.at(at(0, 2)).area is None


@pytest.mark.parametrize(
    ("given", "agent", "reason"),
    [
        ({"state": "closed"}, None, "the link 'A' (lift) is closed"),
        ({"agents": ["robot"]}, "person", "the link 'A' (lift) bars 'person'"),
        ({"width": 0.5}, Agent("wide", 0.3),
         "the link 'A' (lift) is 0.5 m wide, narrower than the agent's 0.6 m"),
    ],
)  # fmt: skip
def test_the_reason_names_the_link(given, agent, reason):
    lift = {**LIFT, "stops": LIFT["stops"][:2], "positions": LIFT["positions"][:2], **given}
    levels = [np.ones((21, 41))] * 2
    grid = tower(lift)
    if isinstance(agent, Agent):  # with room for it
        levels = [level_from("\n".join(["." * 41] * 21), ground=3.0 * k, y_max=1.0) for k in (0, 1)]
        lift["stops"] = [[k, 10 * 41 + 20] for k in (0, 1)]
        lift["positions"] = [[2.05, -0.05, 3.0 * k] for k in (0, 1)]
        grid = house_from(levels).with_levels(levels, {"navbake": {"links": [lift]}})
    finder = PathFinder(grid, agent=agent)
    ends = (at(0, 2), at(1, 9)) if agent != Agent("wide", 0.3) else ((1.5, 0, 0), (2.5, 0, 3.0))
    assert finder.find_path(*ends) is None
    assert finder.why_not(*ends).endswith(reason)


@pytest.mark.parametrize(
    ("given", "reason"),
    [({"agents": ["robot"]}, "bars 'person'"), ({"state": "closed"}, "is closed")],
)
def test_a_link_that_leads_the_other_way_is_not_said_to_bar(given, reason):
    """Nobody gets up over a drop, whoever may use it."""
    person = PathFinder(tower({**DROP, **given}), agent="person")
    up = person.why_not(at(0, 14), at(1, 2))
    assert up.endswith("the link 'dock' (drop) leads the other way only")
    assert person.why_not(at(1, 2), at(0, 14)).endswith(f"the link 'dock' (drop) {reason}")


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"speed": 0.0}, "expected a speed > 0, got 0.0"),
        ({"speed": -2}, "expected a speed > 0, got -2"),
        ({"speed": math.nan}, "expected a speed > 0, got nan"),
        ({"step": -0.1}, "expected a step >= 0 m, got -0.1"),
        ({"step": math.nan}, "expected a step >= 0 m, got nan"),
        ({"height": 0}, "expected a height > 0, got 0"),
        ({"height": math.nan}, "expected a height > 0, got nan"),
        ({"radius": "0.2"}, "expected 0 to 10,000 m as radius, got '0.2'"),
    ],
)
def test_agents_that_cannot_be_are_refused(numbers, message):
    with pytest.raises(QueryError, match=re.escape(message)):
        PathFinder(tower(storeys=1), agent=Agent("odd", **numbers))


def test_states_are_switched_without_a_bake():
    grid = tower(LIFT, DROP, storeys=3)
    closed = PathFinder(grid.with_links({"A": "closed"}))
    assert closed.find_path(at(0, 2), at(1, 2)) is None
    assert closed.find_path(at(1, 2), at(0, 2)).links == ["dock"]
    assert closed.why_not(at(0, 14), at(1, 2)).endswith(
        "the link 'dock' (drop) leads the other way only"
    ) or (closed.why_not(at(0, 2), at(1, 2)).endswith("the link 'A' (lift) is closed"))


def test_a_one_way_drop_parts_islands_but_leads_on():
    grid = tower(DROP)
    finder = PathFinder(grid)
    assert finder.islands.count == 2 and not finder.same_island(at(0, 2), at(1, 2))
    numbers = np.concatenate([number.ravel() for number in find_islands(grid)])
    np.testing.assert_array_equal(finder.islands.number, numbers)
    rng = np.random.default_rng(0)
    down = finder.random_point(rng, 300, reachable_from=at(1, 2))
    assert {0.0, 3.0} == set(down[:, 2].tolist())
    up = finder.random_point(rng, 50, reachable_from=at(0, 2))
    assert {0.0} == set(up[:, 2].tolist())
    spawned = finder.spawn(rng, 12, reachable_from=at(1, 2), min_distance=0.1).positions
    assert {0.0, 3.0} == set(spawned[:, 2].tolist())
    assert finder.distances(at(1, 14), at(0, 14)) == pytest.approx(0.1 + 4.0 + 0.1)
    assert finder.distances(at(0, 14), at(1, 14)) == math.inf
    near = finder.random_point_near(rng, at(1, 14), 4.3, 200)
    assert {0.0, 3.0} == set(near[:, 2].tolist())
    assert {0.0} == set(finder.random_point_near(rng, at(0, 14), 4.3, 50)[:, 2].tolist())
    with pytest.raises(QueryError, match="island 2 can't be reached: the position is on 1"):
        finder.random_point(rng, island=2, reachable_from=at(0, 2))


def test_the_layer_of_islands_follows_the_links():
    grid = tower(link("A", "lift", (0, 5), (1, 5)))
    for level, number in zip(grid.levels, find_islands(grid), strict=True):
        level.attributes["island"] = number.astype(np.uint16)
    assert grid.values_at("island", [at(0, 2), at(1, 2)]).tolist() == [1, 1]
    closed = grid.with_links({"A": "closed"})
    assert closed.values_at("island", [at(0, 2), at(1, 2)]).tolist() == [1, 2]


def test_the_widest_agent_is_that_of_the_link():
    levels = [level_from("\n".join(["." * 41] * 21), ground=3.0 * k, y_max=1.0) for k in (0, 1)]
    lift = link("A", "lift", (0, 0), (1, 0), width=0.5)
    lift["stops"] = [[k, 10 * 41 + 20] for k in (0, 1)]
    lift["positions"] = [[2.05, -0.05, 3.0 * k] for k in (0, 1)]
    finder = PathFinder(house_from(levels).with_levels(levels, {"navbake": {"links": [lift]}}))
    widest = finder.max_radius((1.5, 0.0, 0.0), (2.5, 0.0, 3.0))
    assert widest.radius == 0.25
    np.testing.assert_allclose(widest.position[:2], (2.05, -0.05), atol=1e-6)


@pytest.mark.parametrize(
    ("agent", "message"),
    [
        ("robto", "no agent 'robto' in 'house': did you mean 'robot'? it has robot, person"),
        (Agent("tall", height=2.0), "for agents up to 1.14 m, got 2 m (agent 'tall'): bake it with "
         "agent.height=2"),
        (Agent("hopper", step=0.4), "for steps up to 0.25 m, got 0.4 m (agent 'hopper'): bake it "
         "with agent.traversable_floor_height=0.4"),
    ],
)  # fmt: skip
def test_an_agent_that_does_not_fit_is_named(agent, message):
    with pytest.raises(QueryError, match=re.escape(message)):
        PathFinder(tower(LIFT, storeys=3), agent=agent)


def test_an_agent_smaller_than_the_inflation_is_named():
    grid = level_from("." * 30 + "\n" + "." * 30).inflate(0.2)
    with pytest.raises(QueryError, match=r"was inflated to 0.2 m, got 0.1 m \(agent 'thin'\)"):
        PathFinder(grid, agent=Agent("thin", 0.1))


@pytest.mark.parametrize("radius", [0.1, 0.2, 0.3])
def test_the_finders_grid_is_the_inflated_one_also_for_the_baked_radius(radius):
    for baked_radius in (0.0, 0.1, 0.2):
        grid = level_from("\n".join(["." * 12 + "#" + "." * 12] * 4 + ["." * 25] * 12))
        grid = grid.with_levels([grid], {**grid.metadata, "agentRadius": baked_radius})
        finder = PathFinder(grid, agent=Agent("robot", radius))
        assert (finder.grid.free == grid.inflate(radius).free).all()
        assert finder.grid.describe_radius() == grid.inflate(radius).describe_radius()
        again = PathFinder(finder.grid, agent=Agent("robot", radius))
        assert again.grid is finder.grid


def test_a_lower_step_takes_less():
    levels = [level_from("..222", ground=0.0), level_from("....", x=0.5, ground=0.2)]
    grid = house_from(levels, [((0, 0, 4), (1, 0, 0))])
    ends = (0.05, -0.05, 0.0), (0.85, -0.05, 0.2)
    assert PathFinder(grid).find_path(*ends) is not None
    assert PathFinder(grid, agent=Agent("wheels", step=0.1)).find_path(*ends) is None
    up = house_from(
        [level_from("...."), level_from("....", x=0.4, ground=0.2)], [((0, 0, 3), (1, 0, 0))]
    )
    ends = (0.05, -0.05, 0.0), (0.65, -0.05, 0.2)
    assert PathFinder(up).find_path(*ends) is not None
    finder = PathFinder(up, agent=Agent("wheels", step=0.1))
    assert finder.find_path(*ends) is None
    add_layers(up, {"island"})
    stored = PathFinder(up, agent=Agent("wheels", step=0.1)).grid
    np.testing.assert_equal([v.attributes["island"] for v in stored.levels], find_islands(stored))
    assert stored.levels[1].attributes["island"].max() == 2


def test_lengths_by_time_are_refused():
    finder = PathFinder(tower())
    with pytest.raises(QueryError, match=r"by='cost' for lengths .*, got by='time'"):
        finder.distance_field(at(0, 2), weighted=False, by="time")


def test_blocks_reach_the_finders_of_agents_of_other_sizes():
    grid = level_from("\n".join(["." * 30] * 12))
    with grid.block(disc=((0.5, -0.6), 0.05)):
        finder = PathFinder(grid, agent=Agent("robot", 0.2))  # made while it is blocked
        assert not finder.is_navigable((0.66, -0.6))
        block = grid.block(disc=((1.5, -0.6), 0.05))
        assert not finder.is_navigable((1.66, -0.6))
        assert PathFinder(grid).is_navigable((1.66, -0.6))
        block.free()
        assert finder.is_navigable((1.66, -0.6))
    assert finder.is_navigable((0.66, -0.6))
    finder.use(level_from("\n".join(["." * 30] * 9)))  # as after an update
    assert finder.grid.inflated_radius == 0.2


def test_blocked_cells_stay_barred_and_priced():
    grid = tower(storeys=1, areas=[(0, 5, 9, 2), (0, 12, 12, 1)])
    finder = PathFinder(grid, agent="person")
    with grid.block(disc=(at(0, 12), 0.2)):
        assert not finder.is_navigable(at(0, 13))
    assert finder.is_navigable(at(0, 13)) and not finder.is_navigable(at(0, 12))
    assert finder.find_path(at(0, 2), at(0, 11)).cost == pytest.approx(0.4 + 0.5 * 3)


@pytest.mark.parametrize("value", [0.2, None, ["robot"], b"robot"])
def test_a_number_in_place_of_an_agents_name_is_told(value):
    with pytest.raises(QueryError, match=r"expected text as the name.*radius=0\.2") as caught:
        navbake.Agent(value)
    assert (caught.value.key, caught.value.value) == ("name", value)


@pytest.mark.parametrize("value", [0.2, ["robot"], {"radius": 0.2}])
def test_what_is_no_agent_is_told_with_how_to_write_one(value):
    grid = tower()
    for ask in (
        lambda: PathFinder(grid, agent=value),
        lambda: grid.tensors(agent=value),
        lambda: grid.routes(value),
    ):
        with pytest.raises(QueryError, match=r"expected the name of an agent.*radius=0\.2"):
            ask()


def test_a_follower_stands_at_a_stop_until_it_is_at_the_next():
    finder = PathFinder(tower(link("A", "lift", (0, 10), (1, 10))))
    base = finder.follow(finder.find_path(at(0, 2), at(1, 15)), speed=0.5)
    p, ride = np.array(at(0, 2)), 0
    for _ in range(400):
        command = base.command(p, 0.0)
        if base.state == "arrived":
            break
        if base.state == "riding":
            assert (base.link, command.forward, command.turn) == ("A", 0.0, 0.0)
            np.testing.assert_allclose(command.waypoint, at(1, 10), atol=1e-6)
            assert abs(p[0] - 1.05) <= 0.06
            p, ride = p + np.array([0.0, 0.0, 0.1]), ride + 1  # the lift takes it up
            continue
        assert base.link is None
        p = p + np.array([command.forward * 0.05, 0.0, 0.0])
    assert base.state == "arrived" and abs(p[0] - 1.55) <= 0.05
    assert p[2] == pytest.approx(2.8, abs=0.15) and ride >= 27
    assert base.num_replans == 0


def test_a_follower_that_replans_at_a_stop_rides_no_longer():
    finder = PathFinder(tower(link("A", "lift", (0, 10), (1, 10))))
    base = finder.follow(finder.find_path(at(0, 2), at(1, 15)))
    base.command(at(0, 10), 0.0)
    base.command(at(0, 10), 0.0)
    assert base.state == "riding"
    assert base.replan(at(1, 12))  # it took another way up
    assert (base.state, base.link) == ("driving", None)
    assert base.command(at(1, 12), 0.0).forward > 0.0


def test_tensors_agree_with_the_finder():
    pytest.importorskip("array_api_compat")
    grid = tower(LIFT, DROP, storeys=3, areas=[(0, 5, 9, 2), (1, 12, 12, 1)])
    for agent in (None, "person"):
        finder, goal = PathFinder(grid, agent=agent), at(0, 2)
        t = grid.tensors(goals=[goal], agent=agent)
        p = np.array([at(k, col) for k in range(3) for col in range(20)])
        np.testing.assert_allclose(tensors.distance_to_goal(t, p), finder.distances(p, goal))
        islands = [finder.island_at(each) or 0 for each in p]
        np.testing.assert_array_equal(tensors.island(t, p), islands)
        np.testing.assert_array_equal(tensors.is_navigable(t, p), finder.is_navigable(p))
        areas = [grid.at(each).area for each in p]
        named = [None, *t.areas[0]]
        assert [named[k] for k in tensors.area(t, p).tolist()] == areas


def test_episodes_are_those_of_the_agent():
    grid = tower(LIFT, DROP, storeys=3)
    found = navbake.episodes.make_episodes(grid, count=6, seed=1, agent="person")
    assert (found.header.agent.name, found.header.agent.speed) == ("person", 2.0)
    finder = PathFinder(grid, agent="person")
    for episode in found.episodes:
        d = finder.distances(episode.start, episode.goals[0].position, weighted=False)
        assert episode.distance == pytest.approx(float(d))
    found.check_grid(grid)
    with pytest.raises(QueryError, match="another grid of 'house'"):
        found.check_grid(grid.with_links({"A": "closed"}))
