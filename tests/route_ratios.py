"""How much more routes cost than paths."""

from __future__ import annotations

import numpy as np

import navbake

TOLL = (-2.0, -1.5, 2.0, 0.0)  # a box in the tower's lobby, x0, y0 to x1, y1 [m]
ENDS = 3.0  # metres from the ends of a path to a node, at most


def ratios(grid, graph, pairs, seed=0, least=9.0):
    """The costs of routes over those of the cheapest paths, between random places of an island.

    A route leads from the start by a path of at most 3 m to a node, over lanes to a node as near to
    the goal, and on to it; the best pair of nodes counts, and the ends with it. Paths are longer
    than 9 m: of shorter ones, the first and last 3 m are most. Without areas and links costs are
    lengths.
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
            cell = np.atleast_1d(search.flat.cells_at(end))
            away, cost = (
                search.compute_cost_field(cell, by=by)[cells] for by in ("length", "cost")
            )
            near.append(np.where(away <= ENDS, cost, np.inf))
        cost = cost_of(path, search)
        found.append(float((near[0][:, None] + ways + near[1]).min() / cost))
    return np.array(found)


def cost_of(path, search):
    """The cost of a smoothed path: lengths by their cells' weights, and the costs of links."""
    costs = {link.name: link.cost for link in search.grid.links}
    taken, total = dict(zip(path.stops[:, 0].tolist(), path.links, strict=True)), 0.0
    stops = dict(path.stops.tolist())
    at = 0
    while at < len(path.positions) - 1:
        onward = stops.get(at, at + 1)
        a, b = path.positions[[at, onward]]
        if at in taken:
            cost = costs[taken[at]]
            total += np.linalg.norm(b - a) if cost is None else cost
        else:
            length = float(np.hypot(*(b - a)[:2]))
            shares = (np.arange(int(length / 0.01) + 1) + 0.5) / (int(length / 0.01) + 1)
            cells = search.flat.cells_at(a[:2] + shares[:, None] * (b - a)[:2], path.levels[at])
            weights = search.flat.weight[cells]
            weights = weights[np.isfinite(weights)]  # of stairs, the cells of one level are free
            total += length * (weights.mean() if len(weights) else 1.0)
        at = onward
    return total


def with_toll(grid, box, cost):
    """The grid with one more area: the cells of level 0 from x0, y0 to x1, y1 [m] have a cost."""
    lowest = grid.levels[0]
    at = lowest.lattice.positions(*np.indices(lowest.shape))
    index = lowest.area_index.copy()
    index[((at >= box[:2]) & (at <= box[2:])).all(axis=-1)] = len(grid.areas) + 1
    own = {"areas": [*(area.to_json() for area in grid.areas), {"name": "toll", "cost": cost}]}
    levels = [
        level.with_layers(
            attributes={"area": index} if level is lowest else {},
            metadata={**level.metadata, "navbake": {**level.navbake, **own}},
        )
        for level in grid.levels
    ]
    return grid.with_levels(levels, {**grid.metadata, "navbake": {**grid.navbake, **own}})


def worst_ratio(grid, graph, pairs, seed=0, least=9.0):
    return ratios(grid, graph, pairs, seed, least).max()
