"""Graphs of routes: lanes are free by exact distances, and routes hardly longer than paths."""

from __future__ import annotations

import itertools
import math

import mujoco
import numpy as np
import pytest
import shapely
import yaml
from scipy.ndimage import label
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

import navbake
from grid_maps import house_from, level_from
from navbake.auditor.facts import Facts
from navbake.auditor.routes import measure_distances_to_squares
from navbake.errors import QueryError
from navbake.navgrid.links import Agent
from navbake.routes import lane_kernels
from navbake.routes.build import make_routes, thin_mask
from navbake.routes.lane_graph import LaneGraph
from navbake.runtime.flat_grid import find_leaf_cells
from navbake.runtime.grid_arrays import COL_STEP, ROW_STEP
from project_paths import GOLDEN
from route_ratios import TOLL, with_toll, worst_ratio

SAMPLES = ("apartment", "clutter", "house", "terrain", "warehouse")


def sample(name):
    return navbake.load(GOLDEN / f"{name}.grid.json.gz")


@pytest.fixture(scope="module", params=SAMPLES)
def made(request):
    grid = sample(request.param)
    return grid, make_routes(grid)


def test_routes_are_hardly_longer_than_paths(made):
    grid, graph = made
    assert worst_ratio(grid, graph, pairs=25) <= 1.15


def test_every_large_island_is_reached_and_joined(made):
    grid, graph = made
    search = navbake.PathFinder(grid.inflate(graph.radius)).search
    cells = [search.flat.cells_at(node.position, node.level) for node in graph.nodes]
    islands = search.islands.number[np.array(cells).ravel()]
    assert {*islands.tolist()} == {*np.flatnonzero(search.islands.areas >= 4).tolist()}
    joined = np.isfinite(graph.distances())
    np.testing.assert_array_equal(joined, islands[:, None] == islands)
    # and each of their cells is near a node
    field = search.compute_cost_field(np.array(cells).ravel(), by="length")
    large = (search.islands.areas >= 4)[search.islands.number] & search.flat.free
    assert field[large].max() <= 1.8


def test_no_lane_meets_an_occupied_square(made):
    grid, graph = made
    assert graph.audit(grid).errors == []
    # shapely says the same of the level where no other one goes on
    facts, level = Facts(grid), grid.levels[0]
    centers = level.lattice.positions(*np.nonzero((level.solid != 0) & ~np.isnan(level.floor)))
    half = level.lattice.cell_size / 2
    squares = shapely.box(*(centers - half).T, *(centers + half).T)
    tree = shapely.STRtree(squares)
    for lane in graph.lanes:
        one, other = graph.nodes[lane.start], graph.nodes[lane.end]
        if lane.kind == "floor" and one.level == other.level == 0:
            line = shapely.LineString([one.position[:2], other.position[:2]])
            near = tree.query(line, predicate="dwithin", distance=graph.radius - 1e-5)
            over = [grid.at(centers[k], 1).free for k in near] if len(facts.levels) > 1 else []
            assert all(over) and len(over) == len(near)


def find_detours(grid, graph, max_distance):
    """Pairs of nodes with a free lane between them, and a route that costs over 5 % more.

    Returns the names of the nodes, the cost of the lane, and that of the route.
    """
    is_inflated = grid.inflated_radius >= graph.radius
    search = navbake.PathFinder(grid if is_inflated else grid.inflate(graph.radius)).search
    flat = search.flat
    door_of_cell = {
        cell: door.id for door in grid.doors for cell in find_leaf_cells(door, flat).tolist()
    }
    route_costs = graph.distances()
    detours = []
    for i, j in itertools.combinations(range(len(graph.nodes)), 2):
        one, other = graph.nodes[i], graph.nodes[j]
        ends = one.position[:2], other.position[:2]
        if one.level != other.level or not 0 < math.dist(*ends) <= max_distance:
            continue
        cells = [int(flat.cells_at(end, one.level)) for end in ends]
        if not lane_kernels.sees(*cells, search.graph, search.off_center):
            continue
        on_lane = lane_kernels.sample_line(*ends, one.level, flat.layout).tolist()
        doors = {door_of_cell.get(cell) for cell in on_lane}
        if not doors <= {None, one.door, other.door}:
            continue
        weight = lane_kernels.measure_mean_weight(*ends, one.level, search.graph)
        cost = math.dist(*ends) * weight
        if route_costs[i, j] > 1.05 * cost + 1e-5:
            detours.append((one.name, other.name, cost, route_costs[i, j]))
    return detours


def test_no_lane_between_nodes_in_sight_would_save_over_five_percent(made):
    # corners of paths are nodes like all others: some lay 0.1 m apart, joined over 6 m
    grid, graph = made
    assert find_detours(grid, graph, max_distance=4.0) == []


TWO_ROOMS_WITH_A_DOOR = """<mujoco><worldbody>
  <geom type="box" pos="3 2 -.1" size="3 2 .1"/>
  <geom type="box" pos="3 .05 1.2" size="3 .05 1.2"/>
  <geom type="box" pos="3 3.95 1.2" size="3 .05 1.2"/>
  <geom type="box" pos=".05 2 1.2" size=".05 2 1.2"/>
  <geom type="box" pos="5.95 2 1.2" size=".05 2 1.2"/>
  <geom type="box" pos="3 .8 1.2" size=".05 .7 1.2"/>
  <geom type="box" pos="3 3.15 1.2" size=".05 .75 1.2"/>
  <body name="door" pos="3 1.5 1"><joint axis="0 0 1" range="0 92"/>
    <geom type="box" pos="0 .45 0" size=".02 .44 1"/></body>
  {boxes}
</worldbody></mujoco>"""


@pytest.mark.parametrize("seed", range(4))
def test_nodes_near_a_door_are_joined_to_its_node(seed):
    # where a path between two rooms can't take a lane through the door, its corners lay beside the
    # door's node without a lane to it
    rng = np.random.default_rng(seed)
    boxes = "".join(
        f'<geom type="box" pos="{x} {y} .3" size="{half_size} {half_size} .3"/>'
        for x, y, half_size in rng.uniform((0.3, 0.3, 0.05), (5.7, 3.7, 0.2), (14, 3))
        if not 2.6 < x < 3.4
    )
    grid = navbake.bake(
        mujoco.MjModel.from_xml_string(TWO_ROOMS_WITH_A_DOOR.format(boxes=boxes)),
        doors={"state": "open"},
        agent={"radius": 0.1},
    )
    graph = make_routes(grid)
    assert "door" in {node.kind for node in graph.nodes}
    assert find_detours(grid, graph, max_distance=4.0) == []
    for node in graph.nodes:
        is_at_door = node.kind == "waypoint" and math.dist(node.position[:2], (3.0, 1.95)) < 0.5
        num_lanes = sum(graph.index_of(node.name) in (lane.start, lane.end) for lane in graph.lanes)
        assert num_lanes >= 2 or not is_at_door


def test_a_grid_without_room_for_the_agent_has_an_empty_graph():
    graph = make_routes(sample("apartment"), Agent("wide", radius=0.45))
    assert graph.nodes == () and graph.lanes == ()


def test_doors_rooms_and_stops_are_nodes():
    grid = sample("house")
    graph = make_routes(grid)
    kinds = {node.name: node for node in graph.nodes}
    assert {door.id for door in grid.doors} <= kinds.keys()
    assert {room.id for room in grid.rooms} <= kinds.keys()
    stairs = [lane for lane in graph.lanes if lane.kind == "stairs"]
    assert len(stairs) == 2 and all(lane.two_way for lane in stairs)
    for node in graph.nodes:
        assert grid.at(node.position[:2], node.level).room == node.room
        assert node.position[2] == pytest.approx(grid.at(node.position[:2], node.level).floor)
    # whoever changes rooms through a door drives over its node
    for lane in graph.lanes:
        one, other = graph.nodes[lane.start], graph.nodes[lane.end]
        if lane.door:
            assert lane.door in (one.door, other.door) or one.room != other.room
    assert make_routes(grid) == graph


def test_a_closed_door_and_a_larger_agent_part_the_graph():
    grid = sample("apartment")
    free = make_routes(grid)
    shut = make_routes(grid.with_doors("closed"))
    assert np.isfinite(free.distances()).all()
    assert not np.isfinite(shut.distances()).all() and {n.kind for n in shut.nodes} >= {"room"}
    grid = sample("house")
    wide = make_routes(grid, Agent("wide", radius=0.45))
    assert wide.radius == 0.45 and "door" not in {node.kind for node in wide.nodes}
    assert wide.audit(grid).errors == []


ROOM = "\n".join(["." * 30] * 30)


def two_rooms(**navbake_keys):
    lower, upper = level_from(ROOM), level_from(ROOM, ground=3.0)
    grid = house_from([lower, upper])
    grid.metadata["navbake"] |= navbake_keys
    return grid


def lift(name, **more):
    stops = [[0, 5 * 30 + 5], [1, 5 * 30 + 5]]
    positions = [[0.55, -0.55, 0.0], [0.55, -0.55, 3.0]]
    return {"name": name, "kind": "lift", "stops": stops, "positions": positions, **more}


def test_links_are_lanes_for_those_who_may_use_them():
    agents = {"robot": {"radius": 0.2, "speed": 0.5}, "cart": {}}
    links = [
        lift("A", seconds=12, agents=["robot"]),
        lift("B", one_way=True, cost=4, state="closed"),
    ]
    graph = make_routes(two_rooms(links=links, agents=agents), "robot")
    (lane,) = [lane for lane in graph.lanes if lane.link]
    assert (lane.kind, lane.link, lane.length, lane.seconds, lane.two_way) == (
        "lift",
        "A",
        3.0,
        12,
        True,
    )
    stops = [graph.nodes[end] for end in (lane.start, lane.end)]
    assert [(n.name, n.kind, n.level, n.link) for n in stops] == [
        ("A 0", "stop", 0, "A"), ("A 1", "stop", 1, "A"),
    ]  # fmt: skip
    assert (graph.agent, graph.radius, graph.speed) == ("robot", 0.2, 0.5)
    assert not [
        lane
        for lane in make_routes(two_rooms(links=links, agents=agents), "cart").lanes
        if lane.link
    ]
    down = make_routes(two_rooms(links=[lift("B", one_way=True, cost=4)]))
    (lane,) = [lane for lane in down.lanes if lane.link]
    assert (lane.two_way, lane.cost, lane.seconds) == (False, 4, 4)
    ways = down.distances()
    assert np.isfinite(ways[lane.start, lane.end]) and np.isinf(ways[lane.end, lane.start])
    assert [r.check for r in down.audit(two_rooms()).remarks].count("parts") == 1
    with pytest.raises(QueryError, match=r"no agent 'robt' in 'house'.*robot"):
        make_routes(two_rooms(agents=agents), "robt")


def test_routes_go_round_what_costs_more():
    grid = with_toll(sample("tower"), TOLL, 10.0)
    # of 1,600 paths longer than 4 m, the worst route costs 17 % more than its path
    assert worst_ratio(grid, make_routes(grid), pairs=100, least=4.0) <= 1.2


def test_lifts_that_stop_on_one_cell_have_a_node_each(tmp_path):
    graph = make_routes(two_rooms(links=[lift("A"), lift("B")]))
    stops = [node for node in graph.nodes if node.kind == "stop"]
    assert [(n.name, n.link, n.level) for n in stops] == [
        ("A 0", "A", 0), ("A 1", "A", 1), ("B 0", "B", 0), ("B 1", "B", 1),
    ]  # fmt: skip
    for lane in (lane for lane in graph.lanes if lane.link):
        assert {graph.nodes[end].link for end in (lane.start, lane.end)} == {lane.link}
    assert np.isfinite(graph.distances()).all()
    assert graph.distances()[graph.index_of("A 0"), graph.index_of("B 0")] == 0.0
    graph.save(tmp_path / "a.nav.yaml")
    levels = yaml.safe_load((tmp_path / "a.nav.yaml").read_text())["levels"]
    for own in levels.values():
        assert [v[2]["lift"] for v in own["vertices"] if "lift" in v[2]] == ["A", "B"]
    assert graph.audit(two_rooms()).errors == []


def test_areas_bar_slow_and_price_lanes():
    areas = [{"name": "lab", "cost": "inf"}, {"name": "carpet", "cost": 2, "speed": 0.3}]
    areas.append({"name": "staff", "cost": 1, "agents": ["cart"]})
    level = level_from(ROOM)
    index = np.zeros(level.shape, np.uint8)
    index[:, 14:16], index[12:18, 14:16] = 2, 1
    index[:3] = 3
    level.attributes["area"] = index
    level.metadata["navbake"] = {"areas": areas, "agents": {"robot": {}}}
    graph = make_routes(level, "robot")
    barred = [shapely.box(1.4, -1.8, 1.6, -1.2), shapely.box(0, -0.3, 3, 0)]
    lines = [
        shapely.LineString(
            [graph.nodes[lane.start].position[:2], graph.nodes[lane.end].position[:2]]
        )
        for lane in graph.lanes
    ]
    assert not any(line.crosses(box) for line in lines for box in barred)
    for lane, line in zip(graph.lanes, lines, strict=True):
        share = line.intersection(shapely.box(1.4, -3, 1.6, 0)).length
        assert lane.cost == pytest.approx(lane.length + share, abs=0.06)
        assert lane.speed == (0.3 if share > 0.03 else lane.speed)
    assert any(lane.speed == 0.3 for lane in graph.lanes)


def test_progress_grows_to_one():
    reports = []
    make_routes(two_rooms(), progress=lambda *report: reports.append(report))
    names, fractions = zip(*reports, strict=True)
    assert set(names) == {"routes"}
    assert fractions[0] == 0.0
    assert fractions[-1] == 1.0
    assert list(fractions) == sorted(fractions)


def test_lane_graph_finds_the_routes_that_dijkstra_finds():
    rng = np.random.default_rng(4)
    for _ in range(20):
        num_nodes = 30
        points = rng.uniform(0, 5, (num_nodes, 2))
        lane_graph = LaneGraph(least_weight=1.0)
        for x, y in points.tolist():
            lane_graph.add_node(x, y)
        costs = np.zeros((num_nodes, num_nodes))
        for start, end in rng.integers(0, num_nodes, (50, 2)).tolist():
            if start == end or costs[start, end]:
                continue
            # a lane over a link may cost less than its length
            factor = rng.uniform(1, 3) if rng.random() < 0.9 else 0.2
            costs[start, end] = factor * math.dist(points[start], points[end])
            lane_graph.add_lane(start, end, costs[start, end])
        route_costs = dijkstra(csr_array(costs))
        for start in range(num_nodes):
            for end in range(num_nodes):
                cost = route_costs[start, end]
                assert lane_graph.has_route(start, end, math.inf) == math.isfinite(cost)
                if math.isfinite(cost):
                    assert lane_graph.has_route(start, end, cost * (1 + 1e-12))
                    assert start == end or not lane_graph.has_route(start, end, cost * 0.999)


def test_a_node_added_after_others_were_removed_has_no_lanes():
    lane_graph = LaneGraph(least_weight=1.0)
    lane_graph.add_node(0.0, 0.0)
    lane_graph.add_node(5.0, 0.0)
    lane_graph.remove_last_node()
    lane_graph.add_node(1.0, 0.0)
    assert not lane_graph.has_route(0, 1, math.inf)
    lane_graph.add_lane(0, 1, 1.0)
    assert lane_graph.has_route(0, 1, 1.0)


def thin_plainly(mask):
    """Zhang and Suen's thinning, cell by cell."""
    mask = np.pad(mask, 1)
    ring = ((-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1))
    is_changed = True
    while is_changed:
        is_changed = False
        for is_first_pass in (True, False):
            removed = []
            for row, col in np.argwhere(mask):
                neighbors = [mask[row + i, col + j] for i, j in ring]
                num_runs = sum(
                    not here and there
                    for here, there in zip(neighbors, neighbors[1:] + neighbors[:1], strict=True)
                )
                north, _, east, _, south, _, west, _ = neighbors
                if is_first_pass:
                    must_stay = (north and east and south) or (east and south and west)
                else:
                    must_stay = (north and east and west) or (north and south and west)
                if 2 <= sum(neighbors) <= 6 and num_runs == 1 and not must_stay:
                    removed.append((row, col))
            for row, col in removed:
                mask[row, col] = False
                is_changed = True
    return mask[1:-1, 1:-1]


def test_thinning_keeps_what_is_connected():
    rng = np.random.default_rng(2)
    for _ in range(20):
        mask = rng.random((20, 30)) < 0.8
        thin = thin_mask(mask)
        np.testing.assert_array_equal(thin, thin_plainly(mask))
        assert (thin <= mask).all()
        eight = np.ones((3, 3))
        assert label(thin, eight)[1] == label(mask, eight)[1]


def test_distances_are_those_of_shapely():
    rng = np.random.default_rng(3)
    centers = rng.uniform(-1, 1, (200, 2))
    for _ in range(20):
        ends = rng.uniform(-1, 1, (2, 2))
        ends[1] = ends[1] if rng.random() < 0.7 else ends[0] + [0, rng.random()]
        squares = shapely.box(*(centers - 0.05).T, *(centers + 0.05).T)
        expected = shapely.distance(shapely.LineString(ends), squares)
        np.testing.assert_allclose(
            measure_distances_to_squares(ends, centers, 0.05), expected, atol=1e-4
        )


def sample_plainly(flat, start, end, level):
    """The cells of points on a line that are about a quarter of a cell apart."""
    cell_size = flat.layout.cell_size[level]
    num_points = math.ceil(math.dist(start, end) / cell_size * 4) + 1
    fractions = (np.arange(num_points) + 0.5) / num_points
    points = np.array(start) + fractions[:, None] * (np.array(end) - start)
    return flat.cells_at(points, level)


def sees_plainly(search, cell, target):
    """Whether a line between cells' centres is free, or a row, column or diagonal of steps."""
    level, row, col = search.flat.to_cell(cell)
    _, target_row, target_col = search.flat.to_cell(target)
    start, end = np.round(search.flat.positions(np.array([cell, target]))[:, :2], 6)
    if search.can_pass(start, end, level):
        return True
    num_steps = max(abs(target_row - row), abs(target_col - col))
    for direction, step in enumerate(zip(ROW_STEP.tolist(), COL_STEP.tolist(), strict=True)):
        if (row + num_steps * step[0], col + num_steps * step[1]) == (target_row, target_col):
            width = int(search.flat.layout.width[level])
            crossed = cell + (step[0] * width + step[1]) * np.arange(num_steps)
            return bool(num_steps and (search.graph.moves[crossed] >> direction & 1).all())
    return False


def test_lanes_are_seen_and_priced_as_numpy_does():
    grid = with_toll(sample("tower"), TOLL, 10.0).inflate(0.2)
    search = navbake.PathFinder(grid).search
    flat, graph = search.flat, search.graph
    rng = np.random.default_rng(1)
    free_cells = np.flatnonzero(flat.free[flat.cells_of(0)])
    answers = []
    for _ in range(400):
        cells = rng.choice(free_cells, 3)
        if rng.random() < 0.5:  # near each other, along a row, a column or a diagonal
            step = rng.choice([1, flat.layout.width[0], flat.layout.width[0] + 1])
            cells = cells[0] + step * np.array([0, 2, 5])
        if not flat.free[cells].all():
            continue
        answers.append(lane_kernels.sees(cells[0], cells[1], graph, search.off_center))
        assert answers[-1] == sees_plainly(search, cells[0], cells[1])
        points = flat.positions(cells)
        costs = []
        for start, end in ((points[0], points[1]), (points[1], points[2])):
            ends = tuple(start[:2].tolist()), tuple(end[:2].tolist())
            sampled = sample_plainly(flat, *ends, 0)
            np.testing.assert_array_equal(lane_kernels.sample_line(*ends, 0, flat.layout), sampled)
            mean_weight = lane_kernels.measure_mean_weight(*ends, 0, graph)
            np.testing.assert_allclose(mean_weight, flat.weight[sampled].mean(), rtol=1e-12)
            costs.append(math.dist(*ends) * mean_weight)
        assert lane_kernels.measure_polyline(points, 0, graph) == pytest.approx(sum(costs))
        on_path = np.stack([points[0], (points[0] + points[1]) / 2 + 0.01, points[1]])
        corners = lane_kernels.find_corner_cells(on_path, 0, flat.layout)
        np.testing.assert_array_equal(corners, cells[:2])
        farthest, _ = lane_kernels.find_farthest_corner(
            cells[0], cells[1:], 1.05, graph, search.off_center
        )
        straight = lane_kernels.measure_polyline(points[[0, 2]], 0, graph)
        is_skipped = sees_plainly(search, cells[0], cells[2]) and straight <= 1.05 * sum(costs)
        assert farthest == int(is_skipped)
    assert 0.1 < np.mean(answers) < 0.9
