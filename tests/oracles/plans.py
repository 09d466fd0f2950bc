"""Holds paths, fields, islands and reasons of one random building against its plain graph."""

import re
from functools import cache, partial
from itertools import pairwise

import numpy as np
from scipy.sparse.csgraph import connected_components, dijkstra

from navbake import PathFinder
from oracles.links import AGENTS, area_bars, plan_graph, random_building, what_bars

CLOSE = 1e-9
NAMED = "reasons: a link or an area"
SENTENCE = re.compile(r"the (link|area) '([^']+)'(?: \(\w+\))? ([^;]+)$")


def check_plans(seed, counts, pairs=6):
    """Faults of a building, one line each; `counts` counts what was compared."""
    rng, faults = np.random.default_rng(seed), []
    grid = random_building(rng)
    for name in (None, *AGENTS):
        finder = PathFinder(grid, agent=name)
        flat, graphs = (
            finder.search.flat,
            {
                by: plan_graph(finder.grid, name, by, turns=finder.search.free_diagonally)
                for by in ("cost", "time")
            },
        )
        standing = np.concatenate([level.free.ravel() for level in finder.grid.levels])
        free = np.flatnonzero(flat.free)
        if len(free) < 2:
            continue
        islands = connected_components(graphs["cost"], connection="strong")[1]
        same = islands[free[:, None]] == islands[free[None, :40]]
        number = finder.islands.number
        if (same != (number[free[:, None]] == number[free[None, :40]])).any():
            faults.append(f"islands of {name}")
        for start, goal in rng.choice(free, (pairs, 2)).tolist():
            for by, graph in graphs.items():
                faults += _check_path(finder, graph, (start, goal), by, name, counts)
        anywhere = np.flatnonzero(standing)
        find_open_graph = cache(partial(plan_graph, finder.grid, name, all_open=True))
        for start, goal in [(rng.choice(free), rng.choice(anywhere)) for _ in range(pairs)]:
            graph = graphs["cost"]
            faults += _check_reason(finder, graph, find_open_graph, (start, goal), name, counts)
    return faults


def _check_path(finder, graph, ends, by, name, counts):
    start, goal = ends
    flat, what = finder.search.flat, f"{by} of {name} from {ends[0]} to {ends[1]}"
    places = flat.positions(np.array(ends))
    reached = dijkstra(graph, indices=start)
    path = finder.find_path(places[0], places[1], by=by, smooth=False)
    counts["paths"] += 1
    if path is None or not np.isfinite(reached[goal]):
        counts["paths that there aren't"] += 1
        return [f"{what}: {path}, {reached[goal]}"] if path or np.isfinite(reached[goal]) else []
    counts["paths over links"] += bool(path.links)
    spent = path.cost if by == "cost" else path.seconds
    width = flat.layout.width
    cells = [int(flat.layout.start[k] + r * width[k] + c) for k, r, c in path.cells.tolist()]
    faults = []
    if not np.isclose(spent, reached[goal], rtol=CLOSE, atol=CLOSE):
        faults.append(f"{what}: {spent} in place of {reached[goal]}")
    along = sum(graph[a, b] for a, b in pairwise(cells)) if len(cells) > 1 else 0.0
    if not np.isclose(spent, along, rtol=CLOSE, atol=CLOSE):
        faults.append(f"{what}: {spent}, its steps {along}")
    known = {
        entry["name"]: entry for entry in finder.grid.navbake["links"] if isinstance(entry, dict)
    }
    stops = [[tuple(map(int, stop)) for stop in known[link]["stops"]] for link in path.links]
    ids = [(k, r * int(width[k]) + c) for k, r, c in path.cells.tolist()]
    if not all(any(a in each and b in each for a, b in pairwise(ids)) for each in stops):
        faults.append(f"{what}: links {path.links} aren't on it")
    field = finder.distances(places[0], places[1], by=by)
    if not np.isclose(field, reached[goal], rtol=CLOSE, atol=CLOSE):
        faults.append(f"{what}: field {field} in place of {reached[goal]}")
    return faults


def _check_reason(finder, graph, find_open_graph, ends, name, counts):
    start, goal = (int(end) for end in ends)
    flat, grid, what = (
        finder.search.flat,
        finder.grid,
        f"reason of {name} from {ends[0]} to {ends[1]}",
    )
    places = flat.positions(np.array([start, goal]))
    reason = finder.why_not(places[0], places[1])
    reached = np.isfinite(dijkstra(graph, indices=start))
    if reached[goal] or reason is None:
        return [f"{what}: {reason!r}"] if (reason is None) != reached[goal] else []
    counts["reasons"] += 1
    own, radius = grid.navbake, AGENTS.get(name, {}).get("radius", 0.0)
    everything = find_open_graph()
    to_goal = np.isfinite(dijkstra(everything.T, indices=goal))
    area = np.concatenate([level.attributes["area"].ravel() for level in grid.levels])
    if not flat.free[goal]:
        counts["reasons: the goal in an area"] += 1
        entry = own["areas"][area[goal] - 1]
        return (
            []
            if f"lies in the area {entry['name']!r}, which bars" in reason
            else [f"{what}: {reason}"]
        )
    found = SENTENCE.search(reason)
    if not to_goal[start]:
        counts["reasons: no link or area"] += 1
        by_radius = " for a radius of " in reason  # a smaller agent has a way, this one has none
        return [f"{what}: {reason}, but no way is there"] if found and not by_radius else []
    if not found:
        return [f"{what}: {reason}"]
    kind, called, why = found.groups()
    counts[f"reasons: {kind} {' '.join(why.split()[:2])}"] += 1
    counts[NAMED] += 1
    near = reached | np.isin(np.arange(flat.num_cells), everything[np.flatnonzero(reached)].indices)
    if kind == "area":
        entry = next(e for e in own["areas"] if e["name"] == called)
        of_area = (area == own["areas"].index(entry) + 1) & ~flat.free
        ok = area_bars(entry, name) and (of_area & near & to_goal).any()
        ok &= why == (
            "bars all agents" if name is None or entry["cost"] == "inf" else f"bars {name!r}"
        )
        return [] if ok else [f"{what}: {reason}"]
    entry = next(e for e in own["links"] if isinstance(e, dict) and e["name"] == called)
    expected = what_bars(entry, name, radius)
    stops = np.array([flat.layout.start[level] + cell for level, cell in entry["stops"]])
    ok = reached[stops].any() and to_goal[stops].any()
    ok &= why == expected or (entry["one_way"] and why == "leads the other way only")
    return [] if ok else [f"{what}: {reason}"]
