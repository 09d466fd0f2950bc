"""Episodes of flights: against scipy's Dijkstra, by their rules, in files, and scored."""

from __future__ import annotations

import copy
import json
import math
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
import pytest

import navbake
from navbake.episodes import (
    EpisodeSet,
    Header,
    digest_of_voxels,
    make_episodes,
    make_flight_episodes,
    make_flight_finder,
    make_flight_rules,
    read_episodes,
    write_episodes,
)
from navbake.errors import ConfigError, QueryError
from navbake.scores import FlightMeasures, Trajectory, path_length, score_set
from navbake.voxels.finder import VoxelFinder
from navbake.voxels.grid import VoxelGrid
from oracles.flights import find_costs, fits, make_graph

RADIUS = 0.12
SHAPE = (12, 9, 8)


@cache
def scatter(seed=0):
    """Two halls of 10 cm voxels with things in them, and a wall between with a window."""
    occupied = np.random.default_rng(seed).random(SHAPE) < 0.01
    occupied[6] = True
    occupied[6, 2:7, 2:7] = False
    return VoxelGrid(values=occupied, origin=(-0.4, 1.0, 0.2), res=0.1)


@cache
def draw(seed=0, **rules):
    finder = VoxelFinder(scatter(seed), RADIUS)
    rules = make_flight_rules(**{"min_distance": 0.3, **rules})
    return make_flight_episodes(finder, rules, count=25, seed=seed, scene="halls", file="a.npz")


def route_cost(voxels, graph, start, goal):
    """The least cost from start to goal: scipy's Dijkstra between the centres that both see."""
    finder = VoxelFinder(voxels, RADIUS)
    free = np.flatnonzero(fits(voxels, RADIUS))
    centers = voxels.bounds[0] + (np.stack(np.unravel_index(free, SHAPE), -1) + 0.5) * 0.1
    ends = []
    for position in (start, goal):
        near = np.abs(voxels.indices(centers) - voxels.indices(position)).max(axis=1) <= 1
        is_joined = near & finder.sees(centers, np.broadcast_to(position, centers.shape))
        lengths = np.linalg.norm(centers[is_joined] - position, axis=1)
        ends.append((free[is_joined], lengths))
    (starts, start_lengths), (goals, goal_lengths) = ends
    costs = find_costs(graph, starts.tolist())[:, goals]
    return (costs + start_lengths[:, None] + goal_lengths).min()


@pytest.mark.parametrize("seed", range(2))
def test_distances_are_those_of_dijkstra_between_what_start_and_goal_see(seed):
    voxels = scatter(seed)
    graph = make_graph(voxels, RADIUS)
    finder = VoxelFinder(voxels, RADIUS)
    for episode in draw(seed).episodes:
        start, goal = episode.start, episode.goals[0].position
        expected = route_cost(voxels, graph, start, goal)
        if finder.sees(start, goal):
            expected = math.dist(start, goal)
        assert episode.distance == pytest.approx(expected, abs=1e-9)
        assert episode.straight == pytest.approx(math.dist(start, goal))
        assert finder.is_free([start, goal]).all()
        path = np.array(episode.path)
        assert path[[0, -1]] == pytest.approx(np.array([start, goal]))
        assert finder.sees(path[:-1], path[1:]).all()
        assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() <= 0.25 + 1e-9
        assert path_length(path) <= episode.distance + 1e-9
    assert {episode.ratio == pytest.approx(1.0) for episode in draw(seed).episodes} == {True, False}


def test_costs_at_places_are_those_of_paths_from_there():
    finder = VoxelFinder(scatter(), RADIUS, cost_of_clearance=0.2)
    rng = np.random.default_rng(5)
    starts = finder.random_point(rng, 30)
    goal = finder.random_point(rng)
    costs = finder.costs_at(finder.distance_field(goal), starts)
    for start, cost in zip(starts, costs, strict=True):
        path = finder.find_path(start, goal)
        assert cost == (math.inf if path is None else pytest.approx(path.cost, abs=1e-9))
    wall = (0.25, 1.05, 0.25)
    assert finder.costs_at(finder.distance_field(goal), wall) == math.inf
    with pytest.raises(QueryError, match="expected a field of shape"):
        finder.costs_at(costs, starts)


def test_the_seed_and_the_scene_decide():
    finder = VoxelFinder(scatter(), RADIUS)
    sets = [
        make_flight_episodes(finder, count=5, seed=seed, scene=scene)
        for seed, scene in ((1, "a"), (1, "a"), (2, "a"), (1, "b"))
    ]
    starts = [[episode.start for episode in content.episodes] for content in sets]
    assert sets[0] == sets[1]
    assert starts[0] != starts[2] != starts[3] != starts[0]


def test_rules_are_kept_and_what_they_refuse_is_counted():
    content = draw(min_distance=0.5, max_distance=0.9, min_ratio=1.05, reach=0.07)
    for episode in content.episodes:
        assert 0.5 <= episode.distance <= 0.9 and episode.ratio >= 1.05
        assert episode.goals[0].radius == 0.07
    assert content.header.rejected.keys() >= {"too near", "too far", "too straight"}
    assert content.header.sampler["rules"]["max_distance"] == 0.9
    with pytest.raises(QueryError, match="no flight in 'halls' keeps the rules: 2048 too near"):
        draw(min_distance=50)


def test_halls_that_nothing_connects_have_flights_inside_each():
    occupied = np.zeros((20, 8, 8), dtype=bool)
    occupied[10] = True
    finder = VoxelFinder(VoxelGrid(values=occupied, origin=(0.0, 0.0, 0.0), res=0.1), 0.1)
    content = make_flight_episodes(finder, make_flight_rules(min_distance=0.2), count=20)
    sides = [(e.start[0] < 1.0, e.goals[0].position[0] < 1.0) for e in content.episodes]
    assert {*sides} == {(True, True), (False, False)} and content.header.rejected["no path"] > 5


@pytest.mark.parametrize("name", ["set.jsonl", "set.jsonl.gz", "set.parquet"])
def test_a_file_gives_the_set_back(tmp_path, name):
    if name.endswith("parquet"):
        pytest.importorskip("pyarrow")
    content = draw()
    write_episodes(content, tmp_path / name)
    assert read_episodes(tmp_path / name) == content
    assert content.header.agent.radius == RADIUS and content.header.agent.height == 2 * RADIUS
    [entry] = content.header.grids
    assert (entry.scene, entry.file) == ("halls", "a.npz")
    assert entry.digest == digest_of_voxels(scatter())


def test_other_voxels_have_another_digest():
    voxels = scatter()
    moved = VoxelGrid(values=voxels.values, origin=(0.0, 0.0, 0.0), res=0.1)
    partly = VoxelGrid(
        values=voxels.values, origin=voxels.origin, res=0.1, known=np.zeros(SHAPE, dtype=bool)
    )
    digests = {digest_of_voxels(each) for each in (voxels, scatter(1), moved, partly)}
    named = VoxelGrid(values=voxels.values.astype(np.uint8) * 3, origin=voxels.origin, res=0.1)
    assert len(digests) == 4 and digest_of_voxels(named) == digest_of_voxels(voxels)


def test_whoever_flies_the_shortest_path_succeeds():
    content = draw()
    finder = make_flight_finder(content, scatter())
    trajectories = []
    for episode in content.episodes:
        path = finder.find_path(episode.start, episode.goals[0].position)
        trajectories.append(Trajectory(episode=episode.id, positions=path.positions.tolist()))
    for row, episode in zip(
        score_set(content, trajectories, scatter()), content.episodes, strict=True
    ):
        assert (row["success"], row["spl"], row["collisions"]) == (1.0, 1.0, 0.0)
        assert row["shortest"] == pytest.approx(episode.distance, abs=1e-9)
        assert row["distance"] == 0.0 and row["scene"] == "halls" and math.isnan(row["coverage"])
        assert row["length"] <= row["shortest"] + 1e-9 and 0.5 < row["ndtw"] <= 1.0


def test_straight_lines_meet_things_and_a_way_round_costs():
    content = draw()
    finder = make_flight_finder(content, scatter())
    episodes = [e for e in content.episodes if not finder.sees(e.start, e.goals[0].position)]
    episode = episodes[0]
    goal = episode.goals[0].position
    measures = FlightMeasures(finder, episode)
    assert measures.step(goal) == 0.0
    assert measures.scores(stopped=True)["collisions"] == 1
    assert measures.scores(stopped=False)["success"] == 0.0
    # there and back, and there again
    measures.steps([episode.start, goal])
    scores = measures.scores(stopped=True)
    assert scores["length"] == pytest.approx(3 * episode.straight)
    shares = episode.distance / max(episode.distance, 3 * episode.straight)
    assert scores["spl"] == pytest.approx(shares)


def test_in_a_wall_the_nearest_free_place_counts():
    content = draw()
    finder = make_flight_finder(content, scatter())
    wall = (0.25, 1.05, 0.25)
    place = finder.snap(wall)
    episodes = [e for e in content.episodes if not finder.sees(place, e.goals[0].position)]
    episode = episodes[0]
    measures = FlightMeasures(finder, episode)
    field = finder.distance_field(episode.goals[0].position)
    expected = finder.costs_at(field, place) + math.dist(wall, place)
    assert measures.step(wall) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cost_of_clearance": 0.1}, "expected a finder without `cost_of_clearance`"),
        ({"count": 0}, "expected a count >= 1, got 0"),
        ({"seed": -1}, "expected a seed >= 0, got -1"),
        ({"radius": 3.0}, "a ball of 3 m fits nowhere"),
    ],
)
def test_what_makes_no_set_is_told(changes, message):
    ball = {"radius": RADIUS} | {k: changes[k] for k in changes if k not in ("count", "seed")}
    draws = {key: changes[key] for key in changes if key in ("count", "seed")}
    with pytest.raises(QueryError, match=message):
        make_flight_episodes(VoxelFinder(scatter(), **ball), **draws)


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        ({"min_dist": 1}, "no rule 'min_dist' of flights: did you mean 'min_distance'"),
        ({"min_ratio": "0.5"}, "min_ratio"),
        ({"reach": "near"}, "reach"),
    ],
)
def test_wrong_rules_are_told(rules, message):
    with pytest.raises(ConfigError, match=message):
        make_flight_rules(**rules)


def test_sets_are_scored_in_their_own_voxels_alone():
    content = draw()
    none = [Trajectory(episode=episode.id, positions=()) for episode in content.episodes]
    with pytest.raises(QueryError, match="the set was made in other voxels"):
        score_set(content, none, scatter(1))
    emptier = VoxelGrid(values=np.zeros(SHAPE, dtype=bool), origin=scatter().origin, res=0.1)
    assert len(score_set(content, none, emptier, force=True)) == 25
    with pytest.raises(QueryError, match="doesn't say for which ball"):
        score_set(EpisodeSet(Header(), content.episodes), none, scatter())
    outside = msgspec.structs.replace(none[0], positions=[(9.0, 9.0, 9.0)])
    with pytest.raises(QueryError, match="9, 9, 9, lies beside the voxels"):
        score_set(content, [outside, *none[1:]], scatter())


def test_grids_score_no_flights_and_voxels_nothing_else():
    flights = draw()
    grid = navbake.load(Path(__file__).parents[1] / "golden/apartment.grid.json.gz")
    walks = make_episodes(grid, count=2)
    run = [Trajectory(episode="0", positions=())]
    with pytest.raises(QueryError, match="expected voxels for episode '0', whose task is 'fly'"):
        score_set(
            EpisodeSet(
                walks.header, (msgspec.structs.replace(flights.episodes[0], scene="apartment"),)
            ),
            run,
            grid,
        )
    mixed = EpisodeSet(flights.header, (msgspec.structs.replace(walks.episodes[0], scene="halls"),))
    with pytest.raises(QueryError, match="expected a navigation grid for episode '0'"):
        score_set(mixed, run, scatter())


def test_heights_and_unknown_voxels_are_those_of_the_set():
    known = np.ones(SHAPE, dtype=bool)
    known[:, :, 5:] = False
    voxels = VoxelGrid(values=scatter().values, origin=scatter().origin, res=0.1, known=known)
    finder = VoxelFinder(voxels, RADIUS, max_height=0.8, unknown="free")
    content = make_flight_episodes(finder, make_flight_rules(min_distance=0.3), count=5)
    assert max(episode.start[2] for episode in content.episodes) <= 0.8
    again = make_flight_finder(content, voxels)
    assert (again.max_height, again.unknown, again.radius) == (0.8, "free", RADIUS)
    assert (again.free == finder.free).all()
    header = json.loads(msgspec.json.encode(content.header))
    assert header["sampler"]["flight"] == {
        "min_height": None, "max_height": 0.8, "unknown": "free"
    }  # fmt: skip


def test_measures_end_where_their_finder_moves_to_other_voxels():
    content = draw()
    finder = make_flight_finder(content, scatter())
    episode = content.episodes[0]
    measures = FlightMeasures(finder, episode)
    finder.use(copy.copy(scatter()))
    with pytest.raises(QueryError, match="the finder has changed its grid"):
        measures.step(episode.start)
