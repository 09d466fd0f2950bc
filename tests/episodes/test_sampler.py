"""Episodes drawn on grids: all can be solved, by the rules of their sampler, the same each time."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from math import atan2
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra
from scipy.stats import chisquare

from grid_maps import house_from, level_from, random_house, room
from navbake import PathFinder
from navbake.episodes import (
    Splits,
    Stance,
    make_episodes,
    make_rules,
    make_task,
    read_episodes,
    write_episodes,
)
from navbake.episodes.goals import find_goal_cells
from navbake.errors import ConfigError, FormatError, QueryError
from project_paths import GOLDEN

FLOOR = """
....................
....................
....................
..............######
..............#.....
.....###......#.....
.....###......#.....
.....###............
....................
"""


def plan(scene="plan", text=None, cell_size=0.5):
    rows = (text or FLOOR).strip("\n").split("\n")
    width = max(map(len, rows))
    grid = level_from("\n".join(row.ljust(width, "#") for row in rows), cell_size=cell_size)
    grid.metadata["sceneId"] = scene
    index = np.zeros(grid.shape, dtype=np.uint16)
    index[grid.free] = 1
    index[4:, 15:] = 2 * grid.free[4:, 15:]
    grid.attributes["roomIndex"] = index
    table = room(0, 1, "0:1", "hall"), room(0, 2, "0:2", "kitchen")
    grid.metadata["navbake"] = {"rooms": list(table)}
    top = {row * grid.width + col for row in (5, 6, 7) for col in (5, 6, 7)}
    table_top = {cell: {"objects": ["table_1"]} for cell in sorted(top)}
    shut_in = {6 * grid.width + 6: {"objects": ["table_1", "lamp_2"]}}
    wall = {3 * grid.width + 17: {"objects": ["wall"], "walls": ["wall"]}}
    rug = {4 * grid.width + 18: {"objects": ["rug_7"]}}
    grid.user_data = {**table_top, **shut_in, **wall, **rug}
    return grid


def replay(grid, episodes):
    """Each episode's distance by `find_path` along cells, None where there is no path."""
    finder = PathFinder(grid)
    for e in episodes:
        places = [v.position for goal in e.goals for v in goal.view_points]
        goal = places or (f"room:{e.goals[0].room}" if e.goals[0].room else e.goals[0].position)
        here, total = e.start, 0.0
        for stop in [goal] if e.task != "sequence" else [g.position for g in e.goals]:
            path = finder.find_path(here, stop, smooth=False)
            total += path.length
            here = path.positions[-1]
        yield total


@pytest.mark.parametrize("task", ["point", "object", "room", "sequence"])
@pytest.mark.parametrize("sampler", ["uniform", "habitat", "stratified", "minos"])
def test_all_can_be_solved_and_distances_are_those_of_paths(task, sampler):
    grid = plan()
    rules = make_rules(sampler, edges=(1.0, 2.0, 4.0)) if sampler == "stratified" else sampler
    found = make_episodes(grid, task, rules, count=40)
    assert len(found) > 10
    distances = [e.distance for e in found.episodes]
    np.testing.assert_allclose(list(replay(grid, found.episodes)), distances, rtol=1e-6)
    assert min(distances) >= 1.0
    assert [e.id for e in found.episodes] == [str(k) for k in range(len(found))]
    assert all(e.ratio is None or e.ratio >= 1 - 1e-9 for e in found.episodes)
    if sampler == "minos":
        assert all(e.rooms and e.doors is not None for e in found.episodes)
        assert all(e.rooms[0] == e.room for e in found.episodes)


STANCE = Stance(reach=(0.2, 1.2), tolerance=0.5)


def test_objects_to_be_reached_are_reached_from_their_nearest_pose():
    grid = plan()
    task = make_task("reach", stance=STANCE, objects=("table*", "rug*"))
    content = make_episodes(grid, task, count=40)
    finder = PathFinder(grid)
    assert {episode.goals[0].name for episode in content.episodes} == {"table_1", "rug_7"}
    for episode in content.episodes:
        (goal,) = episode.goals
        assert (episode.task, goal.radius, goal.stance) == ("reach", 0.0, STANCE)
        poses = finder.stand_poses(f"object:{goal.name}", reach=(0.2, 1.2), count=None)
        path = finder.find_path(episode.start, poses.positions, smooth=False)
        assert episode.distance == pytest.approx(path.length, rel=1e-6) and episode.distance >= 1
        views = np.array([(*view.position, view.heading) for view in goal.view_points])
        assert 0 < len(views) <= 16
        assert finder.can_reach(
            f"object:{goal.name}", views[:, :3], views[:, 3], reach=(0.2, 1.2), tolerance=0.0
        ).all()


def test_what_is_out_of_reach_is_no_goal(tmp_path):
    with pytest.raises(QueryError, match=r"keeps the rules: 200 not in reach"):
        make_episodes(plan(), make_task("reach", objects=("table*",)))  # cells as large as arms
    with pytest.raises(QueryError, match="no object 'tabel' in 'plan': it has lamp_2, rug_7"):
        make_episodes(plan(), make_task("reach", objects=("tabel",)))
    with pytest.raises(ConfigError, match="expected no radius of a task reach"):
        make_task("reach", radius=0.5)
    content = make_episodes(plan(), make_task("reach", stance=STANCE), count=10)
    for ending in (".jsonl", ".parquet"):
        write_episodes(content, tmp_path / f"set{ending}")
        assert read_episodes(tmp_path / f"set{ending}").episodes == content.episodes
    with pytest.raises(FormatError, match="no task 'reach' in habitat-pointnav or"):
        write_episodes(content, tmp_path / "set.json")


def test_over_levels_and_links():
    grid = random_house(np.random.default_rng(3), num_levels=3, share=0.9)
    found = make_episodes(grid, "point", make_rules(min_distance=0.3), count=200)
    np.testing.assert_allclose(
        list(replay(grid, found.episodes)), [e.distance for e in found.episodes], rtol=1e-6
    )
    assert {abs(a - b) for a, b in (e.levels for e in found.episodes)} >= {0, 1}
    graph = grid.to_graph()
    costs = dijkstra(graph.matrix)
    nodes = [(graph.node_at(e.start), graph.node_at(e.goals[0].position)) for e in found.episodes]
    np.testing.assert_allclose(
        [costs[pair] for pair in nodes], [e.distance for e in found.episodes], rtol=1e-6
    )
    same = make_episodes(grid, "point", make_rules("minos", min_distance=0.3), count=200)
    assert {a - b for a, b in (e.levels for e in same.episodes)} == {0}
    assert same.header.rejected["another level"] > 0


def test_the_same_seed_gives_the_same_bytes_and_other_scenes_change_nothing(tmp_path):
    for name in ("a", "b"):
        write_episodes(make_episodes(plan(), count=30, seed=7), tmp_path / f"{name}.jsonl.gz")
    assert (tmp_path / "a.jsonl.gz").read_bytes() == (tmp_path / "b.jsonl.gz").read_bytes()
    alone = make_episodes(plan(), count=30, seed=7).episodes
    assert make_episodes(plan(), count=30, seed=8).episodes != alone
    beside = make_episodes([plan("other"), plan()], count=60, seed=7).episodes[30:]
    assert [msgspec.structs.replace(e, id="") for e in beside] == [
        msgspec.structs.replace(e, id="") for e in alone
    ]


def test_another_process_gives_the_same_bytes(tmp_path):
    for hash_seed in ("1", "2"):
        name = tmp_path / f"{hash_seed}.jsonl"
        source = Path(__file__).with_name("draw_all_tasks.py")
        threads = {"NUMBA_NUM_THREADS": hash_seed, "OMP_NUM_THREADS": hash_seed}
        env = {**os.environ, "PYTHONHASHSEED": hash_seed, **threads}
        subprocess.run(
            [sys.executable, source, GOLDEN / "house.grid.json.gz", name], env=env, check=True
        )
    assert (tmp_path / "1.jsonl").read_bytes() == (tmp_path / "2.jsonl").read_bytes()
    assert len(read_episodes(tmp_path / "1.jsonl")) > 50


def with_yard(grid):
    """Turn the hall of `plan` into a yard."""
    hall, kitchen = grid.metadata["navbake"]["rooms"]
    rooms = [{**hall, "outdoors": True}, {**kitchen, "area": 12.0}]
    grid.metadata["navbake"]["rooms"] = rooms
    return grid


@pytest.mark.parametrize("task", ["point", "explore"])
def test_outdoors_is_left_out_where_there_are_rooms(task):
    episodes = make_episodes(with_yard(plan()), task, make_rules(min_distance=0.5), count=30)
    assert {episode.room for episode in episodes.episodes} == {"0:2"}
    rules = make_rules(min_distance=0.5, outdoors=True)
    episodes = make_episodes(with_yard(plan()), task, rules, count=30)
    assert {episode.room for episode in episodes.episodes} == {"0:1", "0:2"}


def test_outdoors_is_taken_where_no_building_stands():
    grid = with_yard(plan())
    hall, hut = grid.metadata["navbake"]["rooms"]
    grid.metadata["navbake"]["rooms"] = [hall, {**hut, "area": 7.0}]
    episodes = make_episodes(grid, sampler=make_rules(min_distance=0.5), count=30)
    assert {episode.room for episode in episodes.episodes} == {"0:1", "0:2"}


def test_outdoors_is_taken_where_nothing_else_is_free():
    rows = FLOOR.strip("\n").split("\n")
    kitchen_is_full = "\n".join([*rows[:4], *(row[:15] + "#" * 5 for row in rows[4:])])
    grid = with_yard(plan(text=kitchen_is_full))
    episodes = make_episodes(grid, count=20)
    assert {episode.room for episode in episodes.episodes} == {"0:1"}


def test_rejections_are_counted():
    text = FLOOR.replace(
        ".....###............\n....................", 2 * (".............." + "######\n")
    )
    rules = make_rules("habitat", max_distance=6.0, min_island=1.5)
    found = make_episodes(plan(text=text), sampler=rules, count=50)
    assert found.header.rejected.keys() >= {"no path", "too near", "too far", "straight, by chance"}
    with pytest.raises(QueryError, match=r"no episode of 'plan' keeps the rules: \d+ too near"):
        make_episodes(plan(), sampler=make_rules(min_distance=99.0), count=5)


def test_habitats_rule_has_its_distribution():
    """Ratios and lengths against all pairs, each with its exact probability to be kept."""
    grid = plan(cell_size=1.0)
    finder = PathFinder(grid)
    places = finder.search.flat.positions(np.flatnonzero(finder.search.flat.free))
    length = finder.distances(places, goals=places, weighted=False)
    air = np.linalg.norm(places[:, None] - places, axis=-1)
    ratio = length / np.where(air > 0, air, 1.0)
    keep = np.where(ratio < 1.1, np.minimum(1.0, 20 * (ratio - 0.98) ** 2), 1.0)
    keep *= (length >= 1) & (length <= 30)
    # a goal has 10 tries, and one that is met is met by each start as its own chance has it
    rate = keep.mean(axis=0)
    expected = keep / keep.sum(axis=0) * (1 - (1 - rate) ** 10)
    found = make_episodes(grid, sampler=make_rules("habitat", goals=3000), count=3000, seed=1)
    for measure, values, edges in (
        ("ratio", ratio, [0.0, 1.02, 1.05, 1.08, 1.1, 1.2, 1.4, 9.0]),
        ("distance", length, [0.0, 3.0, 6.0, 9.0, 12.0, 15.0, 18.0, 99.0]),
    ):
        counted, _ = np.histogram([getattr(e, measure) for e in found.episodes], edges)
        wanted, _ = np.histogram(values, edges, weights=expected)
        used = wanted > 0
        assert not counted[~used].any()
        wanted = wanted[used] / wanted.sum() * counted.sum()
        assert chisquare(counted[used], wanted).pvalue > 0.01, measure


def test_strata_have_as_many_episodes_each():
    for strata, edges in (("distance", (1.0, 3.0, 5.0)), ("rooms", (1.0, 2.0))):
        rules = make_rules("stratified", strata=strata, edges=edges)
        found = make_episodes(plan(), sampler=rules, count=60)
        values = [len(e.rooms) if strata == "rooms" else e.distance for e in found.episodes]
        counts = np.bincount(np.searchsorted(edges, values, side="right") - 1)
        assert counts.tolist() == [60 // len(edges)] * len(edges)
        assert found.header.rejected["stratum full"] > 0


@pytest.mark.parametrize(("headings", "turn"), [("goal", 0.0), ("away", np.pi)])
def test_starts_may_face_the_goal_or_away(headings, turn):
    for e in make_episodes(plan(), sampler=make_rules(headings=headings), count=10).episodes:
        dx, dy = np.subtract(e.goals[0].position, e.start)[:2]
        off = e.heading - atan2(dy, dx) - turn
        assert np.cos(off) == pytest.approx(1.0)


def test_paths_are_kept():
    found = make_episodes(plan(), sampler="minos", count=10)
    for e in found.episodes:
        assert e.path[0] == e.start and e.path[-1] == e.goals[0].position
        steps = np.linalg.norm(np.diff(e.path, axis=0), axis=1)
        assert steps.max() <= 0.25 + 1e-9 and steps.sum() <= e.distance + 1e-9
    assert not make_episodes(plan(), count=1).episodes[0].path


def test_objects_have_view_points_and_categories():
    grid = plan()
    found = make_episodes(grid, "object", count=30)
    assert Counter(e.goals[0].category for e in found.episodes).keys() == {"table", "rug"}
    assert found.header.rejected["not in sight"] > 0
    finder = PathFinder(grid)
    for e in found.episodes:
        (goal,) = e.goals
        for view in goal.view_points:
            assert finder.is_navigable(view.position)
            dx, dy = np.subtract(goal.position, view.position)[:2]
            assert view.heading == pytest.approx(atan2(dy, dx))
            assert view.iou is None
    # the wall of the kitchen hides the rug from the hall
    rug = next(e.goals[0] for e in found.episodes if e.goals[0].category == "rug")
    assert {finder.room_at(view.position) for view in rug.view_points} == {"0:2"}


@pytest.mark.parametrize(
    ("objects", "names"),
    [
        (("tab*",), {"table_1"}),
        (("table_1", "rug*"), {"table_1", "rug_7"}),
        ({"flat": ("rug*", "table*")}, {"table_1", "rug_7"}),
    ],
)
def test_objects_by_patterns(objects, names):
    found = make_episodes(plan(), make_task("object", objects=objects), count=20)
    assert {goal.name for e in found.episodes for goal in e.goals} == names
    if isinstance(objects, dict):
        assert {goal.category for e in found.episodes for goal in e.goals} == {"flat"}
        assert all(len(e.goals) == 2 for e in found.episodes)


def test_an_object_of_two_categories_has_the_one_that_an_episode_asks_for():
    by_category = {"flat": ("rug*", "table*"), "any": ("*",)}
    found = make_episodes(plan(), make_task("object", objects=by_category), count=20)
    categories = [{goal.category for goal in e.goals} for e in found.episodes]
    assert {"flat"} in categories and {"any"} in categories and len(set.union(*categories)) == 2
    assert all(len(each) == 1 for each in categories)


def test_rooms_and_exploring():
    found = make_episodes(plan(), make_task("room", rooms=("kit*",)), count=10)
    assert {(e.goals[0].room, e.goals[0].name) for e in found.episodes} == {("0:2", "kitchen")}
    assert all(e.room == "0:1" for e in found.episodes)
    by_type = {"food": ("kit*",), "any": ("0:*",)}
    found = make_episodes(
        plan(), make_task("room", rooms=by_type), make_rules(min_distance=0), count=30
    )
    goals = {e.goals[0].category: {goal.room for goal in e.goals} for e in found.episodes}
    assert goals == {"food": {"0:2"}, "any": {"0:1", "0:2"}}
    with pytest.raises(QueryError, match="no room of category 'bath' in 'plan'"):
        make_episodes(plan(), make_task("room", rooms={"bath": ("b*",)}))
    explore = make_episodes(plan(), make_task("explore", share=0.5), "habitat", count=10)
    assert {e.distance for e in explore.episodes} == {None}
    assert {e.goals[0].share for e in explore.episodes} == {0.5}


@pytest.mark.parametrize("of", ["object", "room"])
def test_sequences_of_objects_and_rooms(of):
    found = make_episodes(plan(), make_task("sequence", of=of, length=2), count=10)
    finder = PathFinder(plan())
    for e in found.episodes:
        names = [goal.name if of == "object" else goal.room for goal in e.goals]
        assert sorted(names) == (["rug_7", "table_1"] if of == "object" else ["0:1", "0:2"])
        stops = [[v.position for v in g.view_points] or f"room:{g.room}" for g in e.goals]
        first = finder.distances(e.start, stops[0], weighted=False)
        legs = finder.search.flat.positions(find_goal_cells(finder, e.goals[0]))
        between = finder.distances(legs, stops[1], weighted=False).min()
        assert e.distance == pytest.approx(first + between, rel=1e-9)
        assert e.ratio >= 1.0
    with pytest.raises(ConfigError, match=r"Invalid enum value 'door' - at `\$.of`"):
        make_task("sequence", of="door")


@pytest.mark.parametrize("goals", [{"objects": ("table*",)}, {"rooms": ("kit*",)}])
@pytest.mark.parametrize(
    ("name", "of", "named"),
    [
        ("point", "point", ""),
        ("explore", "point", ""),
        ("object", "point", "objects"),
        ("reach", "point", "objects"),
        ("room", "point", "rooms"),
        ("sequence", "point", ""),
        ("sequence", "object", "objects"),
        ("sequence", "room", "rooms"),
    ],
)
def test_goals_that_a_task_does_not_have_are_refused(name, of, named, goals):
    """They were passed over, and the set had other goals than those that were named."""
    (field,) = goals
    if field == named:
        assert getattr(make_task(name, of=of, **goals), field)
        return
    with pytest.raises(ConfigError, match=f"expected no {field} of a task {name}"):
        make_task(name, of=of, **goals)


def test_splits_are_of_whole_scenes_or_rooms():
    names = [f"scene {k}" for k in range(20)]
    parts = Splits(shares={"train": 0.7, "val": 0.3})
    found = make_episodes([plan(name) for name in names], count=60, splits=parts)
    of = {name: {e.split for e in found.episodes if e.scene == name} for name in names}
    assert all(len(splits) == 1 for splits in of.values())
    assert set().union(*of.values()) == {"train", "val"}
    parts = Splits(shares={"train": 1, "val": 1}, by="room")
    found = make_episodes(plan(), count=60, splits=parts, seed=1)
    by_room = {(e.room, e.split) for e in found.episodes}
    assert len(by_room) == len({e.room for e in found.episodes}) == 2


def test_the_agent():
    found = make_episodes(plan(), radius=0.3, height=1.0, speed=0.5, count=5)
    agent = found.header.agent
    assert (agent.radius, agent.height, agent.speed) == (0.3, 1.0, 0.5)
    found.check_grid(plan().inflate(0.3))
    with pytest.raises(QueryError, match=r"agent of radius 0.3 m, the grid of 'plan' for 0 m"):
        found.check_grid(plan())
    with pytest.raises(QueryError, match=r"agents up to 1.14 m, got 2 m"):
        make_episodes(plan(), height=2.0)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"task": "fly"}, "expected one of point, .*got 'fly'"),
        ({"sampler": "habitatt"}, "no sampler 'habitatt': did you mean 'habitat'"),
        ({"count": 0}, "expected a count >= 1, got 0"),
        ({"seed": -1}, "expected a seed >= 0, got -1"),
        ({"height": -1.0}, "expected a height > 0, got -1.0"),
        ({"height": np.nan}, "expected a height > 0, got nan"),
        ({"speed": 0.0}, "expected a speed > 0, got 0.0"),
        ({"radius": -0.1}, "expected 0 to 10,000 m as radius, got -0.1"),
        ({"task": make_task("object", objects=("tible_1",))}, "no object 'tible_1' in 'plan': did"),
        ({"task": make_task("object", objects={"cup": ("cup*",)})}, "no object of category 'cup'"),
        ({"task": make_task("room", rooms=("kitchn",))}, "no room 'kitchn' in 'plan': did you"),
        ({"grids": [plan(), plan()]}, "grids of different scenes, got plan, plan"),
        ({"grids": [plan(), plan("b").inflate(0.6)]}, "agents of several sizes"),
        ({"grids": plan(text="##\n##")}, "no agent can stand anywhere in 'plan'"),
    ],
)
def test_wrong_questions(given, message):
    with pytest.raises((QueryError, ConfigError), match=message):
        make_episodes(**{"grids": plan(), **given})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"min_distanse": 1}, "no rule 'min_distanse' of a sampler: did you mean 'min_distance'"),
        ({"min_distance": "far"}, r"\$.min_distance"),
        ({"strata": "colour"}, "expected one of distance, .* as strata, got 'colour'"),
        ({"headings": "north"}, "expected one of random, goal, away as headings, got 'north'"),
        ({"edges": (2.0, 1.0)}, "expected ascending edges"),
    ],
)
def test_wrong_rules(changes, message):
    with pytest.raises(ConfigError, match=message):
        make_rules("uniform", **changes)


def test_a_house_of_levels_without_a_name():
    grid = house_from([level_from("." * 20 + "\n" + "." * 20, cell_size=0.5)])
    del grid.metadata["sceneId"]
    assert {e.scene for e in make_episodes(grid, count=3).episodes} == {"scene"}
