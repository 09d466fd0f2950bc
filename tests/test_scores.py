"""Scores: the papers' formulas, what is defined at their edges, and what is refused."""

from __future__ import annotations

import json
import math
import warnings
from itertools import pairwise

import numpy as np
import pytest

from grid_maps import house_from, level_from, random_house, room
from navbake import PathFinder, load
from navbake.episodes import (
    Episode,
    EpisodeSet,
    Goal,
    Header,
    Stance,
    make_episodes,
    make_rules,
    make_task,
)
from navbake.errors import FormatError, QueryError
from navbake.scores import (
    MEAN_FIELDS,
    Measures,
    Trajectory,
    bootstrap,
    ndtw,
    path_length,
    read_trajectories,
    score_set,
    soft_spl,
    spl,
    success,
    summarize,
    wilson_interval,
)
from project_paths import GOLDEN

NAN, INF = math.nan, math.inf
MAP = """
..........
..........
.....#....
.....#....
..........
"""


def plain_dtw(p, q):
    """As its definition has it."""
    table = np.full((len(p) + 1, len(q) + 1), np.inf)
    table[0, 0] = 0.0
    for i, a in enumerate(p, start=1):
        for j, b in enumerate(q, start=1):
            before = min(table[i - 1, j], table[i, j - 1], table[i - 1, j - 1])
            table[i, j] = math.dist(a, b) + before
    return table[-1, -1]


def plan(**fields):
    grid = level_from(MAP)
    grid.metadata |= {"sceneId": "plan", **fields}
    grid.metadata["navbake"] = {"rooms": [room(0, 1, "0:1", "hall")]}
    grid.attributes["roomIndex"] = grid.free.astype(np.uint16)
    grid.attributes["roomIndex"][:, 5:] = 0
    return grid


def test_1000_random_trajectories_are_scored_as_the_formulas_have_it():
    rng = np.random.default_rng(0)
    grid = random_house(rng, num_levels=2, share=0.85, size=(12, 18))
    content = make_episodes(grid, sampler=make_rules(min_distance=0.3), count=1000)
    finder = PathFinder(grid)
    trajectories = []
    for e in content.episodes:
        path = finder.find_path(e.start, e.goals[0].position).positions
        count = int(rng.integers(0, len(path) + 1))
        noise = rng.normal(0, 0.02, (count, 3)) * (1, 1, 0)
        stop = bool(rng.random() < 0.8)
        places = [p for p in path[:count] + noise if finder.cell_at(p) is not None]
        trajectories.append(Trajectory(episode=e.id, positions=[*map(tuple, places)], stop=stop))
    rows = score_set(content, trajectories, grid)
    assert len(rows) == 1000
    assert 0.1 < np.mean([row["success"] for row in rows]) < 0.9
    for row, e, t in zip(rows, content.episodes, trajectories, strict=True):
        way = [e.start, *t.positions]
        p = sum(math.dist(a[:2], b[:2]) for a, b in pairwise(way))  # seen from above
        shortest, d = e.distance, row["distance"]
        if finder.is_navigable(way[-1]):
            assert d == finder.distances(way[-1], e.goals[0].position, weighted=False)
        s = float(t.stop and d <= 0.2)
        assert (row["success"], row["shortest"]) == (s, pytest.approx(shortest, rel=1e-12))
        assert row["length"] == pytest.approx(p, abs=1e-9)
        assert row["spl"] == pytest.approx(s * shortest / max(shortest, p), abs=1e-9)
        soft = max(0, 1 - d / shortest) * shortest / max(shortest, p)
        assert row["soft_spl"] == pytest.approx(soft, abs=1e-9)
        assert row["oracle_success"] >= s


def test_ndtw_is_its_definition():
    rng = np.random.default_rng(1)
    for m, n in ((1, 1), (1, 7), (9, 1), (12, 5), (30, 31)):
        p, q = rng.random((m, 3)), rng.random((n, 3))
        assert ndtw(p, q, 0.5) == pytest.approx(math.exp(-plain_dtw(p, q) / (n * 0.5)), abs=1e-12)
    assert ndtw(q, q) == 1.0
    assert math.isnan(ndtw(np.empty((0, 3)), q)) and math.isnan(ndtw(q, np.empty((0, 3))))


# success, l, p: SPL; then d, l, p: SoftSPL
EDGES = [
    (spl, (1.0, 2.0, 4.0), 0.5),
    (spl, (1.0, 4.0, 2.0), 1.0),  # shorter than the shortest: no more than 1
    (spl, (1.0, 0.0, 0.0), 1.0),
    (spl, (1.0, 0.0, 3.0), 1.0),
    (spl, (0.0, 0.0, 3.0), 0.0),
    (spl, (0.0, NAN, 3.0), 0.0),
    (spl, (0.0, INF, 3.0), 0.0),
    (spl, (1.0, NAN, 3.0), NAN),
    (spl, (1.0, INF, 3.0), NAN),
    (soft_spl, (1.0, 2.0, 2.0), 0.5),
    (soft_spl, (3.0, 2.0, 2.0), 0.0),
    (soft_spl, (0.0, 0.0, 0.0), 1.0),
    (soft_spl, (0.5, 0.0, 1.0), 0.0),
    (soft_spl, (INF, 2.0, 2.0), 0.0),
    (soft_spl, (NAN, 2.0, 2.0), NAN),
    (soft_spl, (1.0, INF, 2.0), NAN),
    (success, (0.2, 0.2, True), 1.0),
    (success, (0.2, 0.2, False), 0.0),
    (success, (NAN, 0.2, True), 0.0),
]


@pytest.mark.parametrize(("function", "given", "expected"), EDGES)
@pytest.mark.filterwarnings("error")
def test_edges(function, given, expected):
    found = function(*map(np.array, given))
    assert float(found) == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize("name", ["jax.numpy", "torch"])
def test_other_libraries_agree(name):
    xp = pytest.importorskip(name)
    for function, given, expected in EDGES:
        found = function(*(xp.asarray(value) for value in given), xp=xp)
        assert float(found) == pytest.approx(expected, nan_ok=True)
    p, q = np.random.default_rng(2).random((2, 9, 3))
    found = ndtw(xp.asarray(p[:5]), xp.asarray(q), 0.5, xp=xp)
    assert float(found) == pytest.approx(ndtw(p[:5], q, 0.5), rel=1e-5)


def test_jax_compiles_them():
    jax = pytest.importorskip("jax")
    compiled = jax.jit(lambda p, q: ndtw(p, q, xp=jax.numpy))
    p, q = np.random.default_rng(2).random((2, 6, 3))
    assert float(compiled(p, q)) == pytest.approx(ndtw(p, q), rel=1e-5)
    shares = jax.jit(lambda *given: spl(*given, xp=jax.numpy))(*np.ones((3, 4)))
    assert shares.tolist() == [1.0] * 4


def test_path_length():
    assert path_length([(0, 0, 0), (3, 4, 0), (3, 4, 2)]) == 7.0
    assert path_length([(1, 2, 3)]) == path_length(np.empty((0, 3))) == 0.0


def test_bootstrap():
    values = np.random.default_rng(0).random(400)
    found = bootstrap([*values, NAN])
    assert found.known == 400 and found.mean == pytest.approx(values.mean())
    half = 1.96 * values.std() / 20
    assert (found.low, found.high) == pytest.approx(
        (found.mean - half, found.mean + half), abs=0.01
    )
    assert bootstrap(values) == found
    assert math.isnan(bootstrap([NAN]).mean) and bootstrap([]).known == 0
    assert bootstrap([0.5])[:3] == (0.5, 0.5, 0.5)


@pytest.mark.parametrize("share", [0.5, 0.9, 1.0])
def test_the_interval_of_few_successes_contains_their_share(share):
    """The exact chance that the interval holds the true share, of 17 episodes."""
    assert wilson_interval([1.0] * 17)[:2] == (1.0, pytest.approx(17 / (17 + 1.959964**2)))
    chance = 0.0
    for num_successes in range(18):
        values = [1.0] * num_successes + [0.0] * (17 - num_successes)
        found = wilson_interval([*values, NAN])
        assert found.mean == pytest.approx(num_successes / 17) and found.known == 17
        if found.low <= share <= found.high:
            ways = math.comb(17, num_successes)
            chance += ways * share**num_successes * (1 - share) ** (17 - num_successes)
    assert chance > 0.92
    assert math.isnan(wilson_interval([NAN]).low) and wilson_interval([]).known == 0


def test_groups_have_the_interval_of_their_kind():
    row = {"episode": "a", **dict.fromkeys(MEAN_FIELDS, 1.0)}
    (group,) = summarize([row] * 17)
    assert group["success"] == wilson_interval([1.0] * 17) != bootstrap([1.0] * 17)
    assert group["oracle_success"] == group["success"]
    assert group["spl"] == bootstrap([1.0] * 17)


def episode(start=(0.05, -0.05, 0.0), goal=(0.95, -0.05, 0.0), radius=0.1, **fields):
    goals = fields.pop("goals", (Goal(position=goal, radius=radius),))
    given = {"id": "0", "scene": "plan", "task": "point", "heading": 0.0, **fields}
    return Episode(start=start, goals=goals, **given)


def run(task, positions, stopped=True, times=None, grid=None):
    measures = Measures(PathFinder(grid or plan()), task)
    measures.steps(positions, times)
    return measures.scores(stopped=stopped)


def test_a_straight_run():
    way = [(0.05 + 0.1 * k, -0.05, 0.0) for k in range(10)]
    found = run(episode(), way, times=[0.5 * k for k in range(10)])
    for key in ("success", "spl", "soft_spl", "oracle_success"):
        assert found[key] == pytest.approx(1.0)
    assert (found["distance"], found["collisions"], found["time"]) == (0.0, 0.0, 4.5)
    assert found["ndtw"] > 0.95 and math.isnan(found["coverage"])
    # it passes the goal and goes back
    found = run(episode(), [*way, *way[::-1]])
    assert (found["success"], found["oracle_success"]) == (0.0, 1.0)
    assert found["length"] == pytest.approx(1.8)
    assert run(episode(), way, stopped=False)["success"] == 0.0


def test_an_empty_trajectory_stays_at_the_start():
    found = run(episode(), [])
    assert (found["success"], found["spl"], found["length"]) == (0.0, 0.0, 0.0)
    assert found["distance"] == found["shortest"] == pytest.approx(0.9)
    assert math.isnan(found["time"])
    at_goal = run(episode(goal=(0.05, -0.05, 0.0)), [])
    assert (at_goal["spl"], at_goal["soft_spl"], at_goal["shortest"]) == (1.0, 1.0, 0.0)


def test_positions_over_the_floor_count_on_it():
    # those of MINOS are 0.545 m above the floor
    way = [(0.05 + 0.1 * k, -0.05, 0.0) for k in range(10)]
    raised_start = episode(start=(0.05, -0.05, 0.545))
    on_floor = run(episode(), way)
    assert on_floor["spl"] == pytest.approx(1.0) and on_floor["length"] == pytest.approx(0.9)
    raised_way = [(x, y, 0.545) for x, y, _ in way]
    np.testing.assert_equal(run(raised_start, way), on_floor)
    np.testing.assert_equal(run(raised_start, raised_way), on_floor)
    assert run(raised_start, [])["length"] == 0.0
    assert run(raised_start, [way[0]])["length"] == 0.0


def test_the_shortest_path_over_stairs_has_all_of_the_spl():
    grid = load(GOLDEN / "house.grid.json.gz")
    finder = PathFinder(grid)
    content = make_episodes(grid, "point", count=30, seed=1)
    assert any(e.levels[0] != e.levels[1] for e in content.episodes)
    runs = [
        Trajectory(
            episode=e.id,
            positions=finder.find_path(e.start, e.goals[0].position).positions.tolist(),
        )
        for e in content.episodes
    ]
    assert {row["spl"] for row in score_set(content, runs, grid)} == {1.0}


def test_without_a_path_there_is_no_progress_and_no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for distance in (INF, 1.0, NAN):
            assert math.isnan(soft_spl(np.array(distance), np.array(INF), np.array(2.0)))


@pytest.mark.parametrize(
    ("place", "problem"),
    [
        ((0.55, -0.05, -0.65), "position 0 of episode '0', 0.55, -0.05, -0.65, lies below every"),
        ((9.0, -0.05, 0.0), "lies beside the grid"),
    ],
)
def test_positions_in_no_cell_say_where_they_lie(place, problem):
    with pytest.raises(QueryError, match=problem):
        run(episode(), [place])


def test_starting_elsewhere_costs_the_way_there():
    found = run(episode(), [(0.95, -0.05, 0.0)])
    assert found["length"] == pytest.approx(0.9)


def test_collisions_and_positions_in_obstacles():
    through = [(0.45, -0.25, 0.0), (0.55, -0.25, 0.0), (0.65, -0.25, 0.0)]
    found = run(episode(start=(0.35, -0.25, 0.0)), through)
    assert found["collisions"] == 2.0
    assert math.isfinite(found["distance"])
    measures = Measures(PathFinder(plan()), episode())
    free = measures.step((0.45, -0.25, 0.0))
    assert measures.step((0.55, -0.25, 0.0)) == pytest.approx(0.1, abs=0.6)  # from beside it
    assert free > 0.5


def test_steps_one_by_one_are_those_at_once():
    way = [(0.05 + 0.1 * k, -0.05 - 0.1 * (k % 2), 0.0) for k in range(8)]
    measures = Measures(PathFinder(plan()), episode())
    seen = [measures.step(p, 0.1 * k) for k, p in enumerate(way)]
    assert seen[-1] == measures.distance < seen[0]
    at_once = run(episode(), way, times=[0.1 * k for k in range(8)])
    np.testing.assert_equal(measures.scores(stopped=True), at_once)


def test_a_sequence_counts_in_order():
    goals = tuple(Goal(position=p, radius=0.0) for p in ((0.95, -0.05, 0.0), (0.05, -0.45, 0.0)))
    task = episode(task="sequence", goals=goals)
    there = [(0.05 + 0.1 * k, -0.05, 0.0) for k in range(10)]
    back = [(0.95 - 0.1 * k, -0.45, 0.0) for k in range(10)]
    first = run(task, back[::-1])  # the second goal first
    assert first["success"] == 0.0 and first["oracle_success"] == 0.0
    found = run(task, [*there, *back])
    assert (found["success"], found["distance"]) == (1.0, 0.0)
    assert found["shortest"] == pytest.approx(PathFinder(plan()).distances(
        (0.95, -0.05), (0.05, -0.45), weighted=False) + 0.9)  # fmt: skip


def test_rooms_objects_and_exploring():
    to_room = episode(start=(0.95, -0.05, 0.0), task="room", goals=(Goal(room="0:1"),))
    found = run(to_room, [(0.95 - 0.1 * k, -0.05, 0.0) for k in range(6)])
    assert (found["success"], found["shortest"]) == (1.0, pytest.approx(0.5))
    explore = episode(task="explore", goals=(Goal(share=0.5, radius=0.3),))
    found = run(explore, [])
    assert found["success"] == 0.0 and 0 < found["coverage"] < 0.5
    assert math.isnan(found["spl"]) and math.isnan(found["distance"])
    found = run(explore, [(0.05 + 0.1 * k, -0.15, 0.0) for k in range(10)])
    assert found["success"] == 1.0 and found["coverage"] > 0.5
    planar = episode(goal=(0.65, -0.25, 0.0), radius=0.25, extra={"success": "planar"})
    found = run(planar, [(0.45, -0.25, 0.0)])
    assert found["distance"] > 0.25 and found["success"] == 1.0  # through the wall


def test_an_object_is_reached_by_a_pose_that_faces_it():
    grid = plan()
    grid.user_data = {25: {"objects": ["pole"]}, 35: {"objects": ["pole"]}}
    finder = PathFinder(grid)
    stance = Stance(
        reach=(0.05, 0.4), tolerance=0.3, footprint=((0.08, 0.04), (-0.04, -0.04), (-0.04, 0.04))
    )
    goal = Goal(name="pole", stance=stance)
    task = episode(start=(0.95, -0.05, 0.0), task="reach", goals=(goal,))
    poses = finder.stand_poses("object:pole", reach=(0.05, 0.4), footprint=stance.footprint)
    place, heading = poses.positions[0], float(poses.headings[0])

    def measure(*moves, stopped=True):
        measures = Measures(finder, task)
        for position, move_heading in moves:
            measures.step(position, heading=move_heading)
        return measures.scores(stopped=stopped)

    arrived = measure((place, heading + 0.2))
    assert (arrived["success"], arrived["distance"], arrived["oracle_success"]) == (1.0, 0.0, 1.0)
    length = finder.find_path(task.start, poses_of_all(finder, stance), smooth=False).length
    assert arrived["shortest"] == pytest.approx(length, rel=1e-6)
    turned_away = measure((place, heading + 0.2), (place, heading + 0.4))
    assert (turned_away["success"], turned_away["distance"]) == (0.0, 0.0)
    assert (turned_away["oracle_success"], turned_away["spl"]) == (1.0, 0.0)
    assert measure((place, heading), stopped=False)["success"] == 0.0
    assert measure((task.start, heading))["success"] == 0.0
    assert measure()["success"] == 0.0  # it stayed at its start
    measures = Measures(finder, task)
    measures.step(place)
    with pytest.raises(QueryError, match="expected a heading for each of 1 positions, got 0 in"):
        measures.scores(stopped=True)
    any_heading = Stance(reach=(0.05, 0.4), tolerance=None)
    loose = episode(task="reach", goals=(Goal(name="pole", stance=any_heading),))
    assert run(loose, [place], grid=grid)["success"] == 1.0  # without headings
    gone = episode(task="reach", goals=(Goal(name="mug", stance=stance),))
    with pytest.raises(QueryError, match="no object 'mug' in 'plan'"):
        Measures(finder, gone)


def test_measures_end_where_their_finder_moves_to_another_grid():
    finder = PathFinder(plan())
    measures = Measures(finder, episode())
    measures.step((0.15, -0.05, 0.0))
    finder.use(plan())
    for go_on in (
        lambda: measures.step((0.25, -0.05, 0.0)),
        lambda: measures.scores(stopped=True),
    ):
        with pytest.raises(QueryError, match=r"changed its grid .* episode '0': make the measures"):
            go_on()
    assert Measures(finder, episode()).step((0.25, -0.05, 0.0)) > 0.0


def poses_of_all(finder, stance):
    return finder.stand_poses(
        "object:pole", reach=stance.reach, footprint=stance.footprint, count=None
    ).positions


def test_trajectories_have_headings(tmp_path):
    grid = plan()
    grid.user_data = {25: {"objects": ["pole"]}, 35: {"objects": ["pole"]}}
    task = make_task("reach", stance={"reach": (0.05, 0.4)})
    content = make_episodes(grid, task, make_rules(min_distance=0.1), count=5)
    rows = []
    for number, each in enumerate(content.episodes):
        view = each.goals[0].view_points[0]
        heading = view.heading + math.pi * (number == 0)
        rows.append({"episode": each.id, "positions": [view.position], "headings": [heading]})
    lines = tmp_path / "runs.jsonl"
    lines.write_text("".join(json.dumps(row) + "\n" for row in rows))
    archive = tmp_path / "runs.npz"
    np.savez(
        archive,
        episode=[row["episode"] for row in rows],
        start=np.arange(6),
        positions=np.concatenate([row["positions"] for row in rows]),
        headings=np.concatenate([row["headings"] for row in rows]),
    )
    for path in (lines, archive):
        scored = score_set(content, read_trajectories(path), grid)
        assert [row["success"] for row in scored] == [0.0, 1.0, 1.0, 1.0, 1.0]
    short = Trajectory(episode="0", positions=[(0.05, -0.05, 0.0)] * 2, headings=[0.0])
    with pytest.raises(QueryError, match="expected a heading for each position of episode '0'"):
        score_set(content, [short], grid, partial=True)


@pytest.mark.parametrize("task", ["object", "room", "sequence", "explore", "point", "reach"])
def test_sets_of_all_tasks_are_scored(task):
    grid = plan()
    grid.user_data = {25: {"objects": ["pole"]}, 35: {"objects": ["pole"]}}
    rules = make_rules(min_distance=0.1)
    stance = {"reach": (0.05, 0.4)}
    content = make_episodes(grid, make_task(task, length=2, stance=stance), rules, count=10)
    runs = [Trajectory(episode=e.id, positions=[]) for e in content.episodes]
    rows = score_set(content, runs, grid)
    if task != "explore":
        np.testing.assert_allclose(
            [r["shortest"] for r in rows], [e.distance for e in content.episodes]
        )


def set_of(grid, count=6):
    content = make_episodes(grid, sampler=make_rules(min_distance=0.2), count=count)
    return content, [Trajectory(episode=e.id, positions=[e.start]) for e in content.episodes]


def test_what_is_refused():
    grid = plan()
    content, runs = set_of(grid)
    with pytest.raises(QueryError, match="another grid of 'plan'"):
        score_set(content, runs, plan(traversableFloorHeight=0.1))
    with pytest.raises(QueryError, match="1 of 6 episodes have no trajectory, as '2'"):
        score_set(content, runs[:2] + runs[3:], grid)
    assert len(score_set(content, runs[:2], grid, partial=True)) == 2
    assert len(score_set(content, runs, plan(traversableFloorHeight=0.1), force=True)) == 6
    with pytest.raises(QueryError, match="the set has no episode 'x'"):
        score_set(content, [*runs, Trajectory(episode="x", positions=[])], grid)
    with pytest.raises(QueryError, match="one trajectory of episode '0', got two"):
        score_set(content, [*runs, runs[0]], grid)
    with pytest.raises(QueryError, match="no grid of 'plan', the scene of episode '0'"):
        score_set(content, runs, [])
    foreign = EpisodeSet(Header(), content.episodes)
    with pytest.raises(QueryError, match="doesn't say which grid"):
        score_set(foreign, runs, grid)
    for position, message in (
        ((99.0, 0.0, 0.0), r"position 1 of episode '0', 99, 0, 0, lies beside the grid"),
        ((NAN, 0.0, 0.0), r"expected finite numbers at position 1 of episode '0'"),
    ):
        way = [content.episodes[0].start, position]
        bad = [Trajectory(episode="0", positions=way), *runs[1:]]
        with pytest.raises(QueryError, match=message):
            score_set(content, bad, grid)
    with pytest.raises(QueryError, match="a time for each position of episode '0'"):
        score_set(content, [Trajectory(episode="0", positions=[], times=[1.0]), *runs[1:]], grid)
    with pytest.raises(QueryError, match="no agent can stand at the goal of episode '0'"):
        Measures(PathFinder(grid), episode(goal=(50.0, 0.0, 0.0)))


def test_an_agent_of_the_set_is_given_its_grid():
    level = level_from("." * 30 + ("\n" + "." * 30) * 20)
    house = house_from([level])
    content = make_episodes(house, radius=0.15, count=5)
    runs = [Trajectory(episode=e.id, positions=[]) for e in content.episodes]
    assert len(score_set(content, runs, house)) == 5  # inflated here, too


def test_summaries():
    rows = [
        {"shortest": d, "room": r, "scene": "plan", "split": None, "success": s, **dict.fromkeys(
            ("spl", "soft_spl", "oracle_success", "ndtw", "length", "collisions", "time",
             "coverage"), s), "distance": INF}
        for d, r, s in ((0.5, "a", 1.0), (2.0, "b", 0.0), (5.0, "a", 0.0), (50.0, "a", 1.0))
    ]  # fmt: skip
    (everything,) = summarize(rows)
    assert (everything["episodes"], everything["success"].mean) == (4, 0.5)
    assert everything["distance"].known == 0
    by_room = {group["group"]: group["success"].mean for group in summarize(rows, "room")}
    assert by_room == {"a": pytest.approx(2 / 3), "b": 0.0}
    ratios = [row | {"ratio": r} for row, r in zip(rows, (1.0, None, 1.3, 9.0), strict=True)]
    by_ratio = [(group["group"], group["episodes"]) for group in summarize(ratios, "ratio")]
    assert by_ratio == [("-", 1), ("1 to 1.1", 1), ("1.25 to 1.5", 1), ("2 and more", 1)]
    names = [group["group"] for group in summarize(rows, "distance")]
    assert names == ["0 to 1 m", "1 to 3 m", "3 to 6 m", "40 and more m"]
    with pytest.raises(QueryError, match="one of all, distance"):
        summarize(rows, "colour")


def test_trajectories_come_from_both_formats(tmp_path):
    runs = [
        Trajectory(episode="a", positions=((0.0, 1.0, 2.0), (1.0, 1.0, 2.0)), times=(0.0, 0.5)),
        Trajectory(episode="b", positions=(), stop=False, times=()),
    ]
    lines = [
        {"episode": t.episode, "positions": t.positions, "stop": t.stop, "times": t.times}
        for t in runs
    ]
    (tmp_path / "runs.jsonl").write_text("\n".join(map(json.dumps, lines)) + "\n")
    arrays = {
        "episode": np.array(["a", "b"]), "start": np.array([0, 2, 2]),
        "positions": np.array(runs[0].positions), "stop": np.array([True, False]),
        "times": np.array([0.0, 0.5]),
    }  # fmt: skip
    np.savez(tmp_path / "runs.npz", **arrays)
    for name in ("runs.jsonl", "runs.npz"):
        read = read_trajectories(tmp_path / name)
        plain = [(t.episode, [*map(tuple, t.positions)], t.stop, [*t.times]) for t in read]
        assert plain == [("a", [*runs[0].positions], True, [0.0, 0.5]), ("b", [], False, [])]
    for broken in (
        {"start": np.array([0, 9, 2])}, {"start": np.array([0, 2])}, {"positions": np.zeros(4)},
        {"times": np.zeros(9)}, {"episode": np.array(["a", {}], dtype=object)},
    ):  # fmt: skip
        np.savez(tmp_path / "bad.npz", **{**arrays, **broken})
        with pytest.raises(FormatError, match=r"expected an?.*bad\.npz"):
            read_trajectories(tmp_path / "bad.npz")
    (tmp_path / "empty.jsonl").write_text("\n")
    nothing = {
        "episode": np.empty(0, str),
        "start": np.zeros(1, int),
        "positions": np.zeros((0, 3)),
    }
    np.savez(tmp_path / "empty.npz", **nothing)
    for name in ("empty.jsonl", "empty.npz"):
        with pytest.raises(FormatError, match=rf"expected .*{name}"):
            read_trajectories(tmp_path / name)
    (tmp_path / "bad.npz").write_bytes(b"PK nothing")
    with pytest.raises(FormatError, match=r"bad\.npz"):
        read_trajectories(tmp_path / "bad.npz")
    (tmp_path / "bad.jsonl").write_text('{"episode": "a", "positions": [[1, 2]]}')
    with pytest.raises(FormatError, match=r"Expected `array` of length 3 .* line 1"):
        read_trajectories(tmp_path / "bad.jsonl")
