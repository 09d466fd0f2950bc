"""How much longer routes are than paths."""

from __future__ import annotations

import numpy as np

import navbake

ENDS = 3.0  # metres from the ends of a path to a node, at most


def ratios(grid, graph, pairs, seed=0, least=9.0):
    """The lengths of routes over those of the shortest paths, between random places of an island.

    A route leads from the start by a path of at most 3 m to a node, over lanes to a node as near to
    the goal, and on to it; the best pair of nodes counts, and the ends with it. Paths are longer
    than 9 m: of shorter ones, the first and last 3 m are most.
    """
    finder = navbake.PathFinder(grid.inflate(graph.radius) if graph.radius else grid)
    search, rng, found = finder.search, np.random.default_rng(seed), []
    cells = [search.flat.cells_at(node.position, node.level) for node in graph.nodes]
    cells, ways = np.array(cells).ravel(), graph.distances()
    large = np.flatnonzero(search.islands.areas > 4)
    share = search.islands.areas[large] / search.islands.areas[large].sum()
    while len(found) < pairs:
        island = int(rng.choice(large, p=share))
        start, goal = finder.random_point(rng, 2, island=island)
        path = finder.find_path(start, goal)
        if path.length <= least:
            continue
        near = []
        for end in (start, goal):
            away = search.field(np.atleast_1d(search.flat.cells_at(end)), by="length")[cells]
            near.append(np.where(away <= ENDS, away, np.inf))
        found.append(float((near[0][:, None] + ways + near[1]).min() / path.length))
    return np.array(found)


def worst_ratio(grid, graph, pairs, seed=0):
    return ratios(grid, graph, pairs, seed).max()
