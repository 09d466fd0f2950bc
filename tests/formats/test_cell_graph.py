"""The graph of cells: scipy's and networkx's shortest paths cost what the run time's do."""

from __future__ import annotations

import math
import sys

import networkx
import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.csgraph import connected_components, dijkstra

import navbake
from grid_maps import house_from, level_from, random_house
from navbake.errors import MissingDependencyError, QueryError
from navbake.navgrid.islands import find_islands
from project_paths import GOLDEN

SLACK = 1e-9


def with_weights(grid, rng, values):
    for level in grid.levels:
        weights = level.weights
        free = np.isfinite(weights)
        weights[free] = rng.choice(values, size=free.sum())
    return grid


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("cut_corners", [False, True])
def test_scipy_finds_paths_of_the_same_cost(seed, cut_corners):
    rng = np.random.default_rng(seed)
    grid = with_weights(random_house(rng), rng, [1.0, 2.0, 3.5])
    if seed == 5:
        grid = grid.inflate(0.1)
    graph = grid.to_graph(cut_corners=cut_corners)
    finder = navbake.PathFinder(grid, cut_corners=cut_corners)
    cost = dijkstra(graph.matrix)
    ends = rng.integers(0, len(graph.cell), size=(40, 2)).tolist()
    for one, other in ends:
        start, goal = graph.position[[one, other]]
        assert graph.node_at(start) == one
        path = finder.find_path(start, goal, smooth=False)
        expected = math.inf if path is None else path.cost
        assert cost[one, other] == pytest.approx(expected, abs=SLACK)
    if len(ends):
        field = finder.distance_field(graph.position[ends[0][1]])
        fields = np.concatenate([level.ravel() for level in field])
        flat = np.concatenate([level.free.ravel() for level in grid.levels])
        np.testing.assert_allclose(cost[:, ends[0][1]], fields[flat], rtol=0, atol=SLACK)


@pytest.mark.parametrize("name", ["apartment", "clutter", "house", "terrain", "warehouse"])
def test_samples(name):
    grid = navbake.load(GOLDEN / f"{name}.grid.json.gz")
    graph, finder = grid.to_graph(), navbake.PathFinder(grid)
    assert graph.matrix.has_sorted_indices and graph.matrix.has_canonical_format
    islands = np.concatenate([v.ravel() for v in find_islands(grid)])
    num_parts, part = connected_components(graph.matrix, directed=False)
    assert num_parts == islands.max()
    free = np.concatenate([level.free.ravel() for level in grid.levels])
    assert len(np.unique(np.stack([part, islands[free]]), axis=1).T) == num_parts
    rng = np.random.default_rng(0)
    start = int(rng.integers(len(graph.cell)))
    cost = dijkstra(graph.matrix, indices=start)
    for goal in rng.integers(0, len(graph.cell), size=10).tolist():
        path = finder.find_path(graph.position[start], graph.position[goal], smooth=False)
        expected = math.inf if path is None else path.cost
        assert cost[goal] == pytest.approx(expected, abs=SLACK)


def test_nodes_are_the_free_cells():
    lower, upper = level_from("..#\n#..", x=1.0), level_from("#.\n", ground=3.0, x=1.0)
    grid = house_from([lower, upper], links=[((0, 0, 0), (1, 0, 1))])
    graph = grid.to_graph()
    assert graph.level.tolist() == [0, 0, 0, 0, 1]
    assert list(zip(graph.row.tolist(), graph.col.tolist(), strict=True)) == [
        (0, 0), (0, 1), (1, 1), (1, 2), (0, 1),
    ]  # fmt: skip
    assert graph.cell.tolist() == [0, 1, 4, 5, 1]
    np.testing.assert_allclose(
        graph.position, grid.position_of((graph.level, graph.row, graph.col)), rtol=0, atol=0
    )
    dense = graph.matrix.toarray()
    # the corner between (0, 0) and (1, 1), and that of (0, 1) and (1, 2), have a blocked cell
    expected = np.zeros((5, 5))
    for one, other in ((0, 1), (1, 2), (2, 3), (0, 4)):
        expected[one, other] = expected[other, one] = 0.1
    np.testing.assert_allclose(dense, expected)
    corners = grid.to_graph(cut_corners=True).matrix.toarray()
    assert corners[0, 2] == pytest.approx(0.1 * math.sqrt(2))
    assert graph.node_at([1.05, -0.05, 3.0], level=0) == 0
    assert graph.node_at([1.25, -0.05, 0.0]) is None  # blocked
    assert graph.node_at([9.0, 9.0, 0.0]) is None


def test_a_step_that_is_a_link_too_counts_once():
    ramp = level_from("05", cell_size=0.5)  # more than a step, so that a link makes it a slope
    ramp.metadata = {"traversableFloorHeight": 0.25, "navbake": {"links": [[0, 0, 0, 1]]}}
    assert ramp.to_graph().matrix.toarray().tolist() == [[0.0, 0.5], [0.5, 0.0]]
    ramp.metadata = {"traversableFloorHeight": 0.25}
    assert ramp.to_graph().matrix.nnz == 0


def test_steps_to_cells_without_weight_cost_nothing_but_are_there():
    level = level_from("...")
    level.weights[0, 1] = 0.0
    graph = level.to_graph()
    assert graph.matrix.nnz == 4
    assert dijkstra(graph.matrix, indices=0).tolist() == pytest.approx([0.0, 0.0, 0.1])


def test_blocks_count_as_they_are():
    level = level_from("...")
    block = level.block(cells=(0, 0, 1))
    assert level.to_graph().matrix.shape == (2, 2)
    block.free()
    assert level.to_graph().matrix.nnz == 4


@pytest.mark.parametrize("text", ["##", "."])
def test_few_cells(text):
    graph = level_from(text).to_graph()
    count = text.count(".")
    assert graph.matrix.shape == (count, count) and graph.matrix.nnz == 0
    assert graph.position.shape == (count, 3)
    assert len(graph.to_networkx()) == count


def test_scipy_reads_the_file(tmp_path):
    grid = navbake.load(GOLDEN / "clutter.grid.json.gz")
    graph = grid.to_graph(cut_corners=True)
    (path,) = grid.convert(tmp_path / "cells.graph.npz", cut_corners=True)
    read = sparse.load_npz(path)
    assert isinstance(read, sparse.csr_array)
    assert (read != graph.matrix).nnz == 0
    with np.load(path) as file:
        for name in ("level", "row", "col", "cell", "position"):
            np.testing.assert_array_equal(file[name], getattr(graph, name))
    graph.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == path.read_bytes()


def test_networkx_finds_paths_of_the_same_cost():
    rng = np.random.default_rng(3)
    grid = with_weights(random_house(rng), rng, [1.0, 4.0])
    graph = grid.to_graph()
    found = graph.to_networkx()
    names = list(found)
    assert names == list(
        zip(*(v.tolist() for v in (graph.level, graph.row, graph.col)), strict=True)
    )
    assert found.nodes[names[5]]["position"] == pytest.approx(graph.position[5])
    expected = dijkstra(graph.matrix, indices=0)
    cost = networkx.single_source_dijkstra_path_length(found, names[0])
    for number, name in enumerate(names):
        assert cost.get(name, math.inf) == pytest.approx(expected[number])


def test_refuses():
    with pytest.raises(QueryError, match="expected cells or rooms as kind of graph, got 'doors'"):
        level_from(".").to_graph("doors")
    level = level_from("..")
    level.weights[0, 0] = -1.0
    with pytest.raises(QueryError, match="expected weights >= 0"):
        level.to_graph()


def test_without_networkx_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "networkx", None)
    with pytest.raises(MissingDependencyError, match=r'pip install "navbake\[convert\]"'):
        level_from(".").to_graph().to_networkx()
