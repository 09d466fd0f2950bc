"""Random buildings with links and areas, their graph by plain loops, and what bars an agent."""

import itertools
import math

import numpy as np
from scipy.sparse import coo_array

from navbake.navgrid.grid import MultiLevelGrid
from oracles.ways import make_level, stack, step_graph

TINY = 1e-300  # a step that costs nothing, as scipy takes 0 for no step
AGENTS = {
    "robot": {"speed": 0.7},
    "person": {"radius": 0.15, "speed": 1.4},
    "cart": {"radius": 0.1},
}


def random_building(rng):
    """One to four storeys with rooms, stairs, up to seven links and up to six areas."""
    shape, levels = rng.integers(8, 22, size=2), []
    for number in range(rng.integers(1, 5)):
        free = rng.random(shape) < rng.uniform(0.9, 1.0)
        for _ in range(rng.integers(0, 3)):  # walls, some with a door
            line, along = rng.integers(1, shape.min() - 1), rng.integers(2)
            wall = free[line] if along else free[:, line]
            wall[:] = False
            wall[rng.integers(len(wall))] = rng.random() < 0.6
        floor = 3.0 * number + rng.choice([0.0, 0.2, 0.4], shape, p=[0.95, 0.03, 0.02])
        weights = (
            rng.choice([1.0, 1.5, 10.0], shape, p=[0.7, 0.2, 0.1]) if rng.random() < 0.5 else None
        )
        col0, row0 = rng.integers(-3, 4, size=2)
        levels.append(
            make_level(free, floor, weights, col0=int(col0), row0=int(row0), ground=3.0 * number)
        )
    steps = []
    for k in range(len(levels) - 1):
        if rng.random() < 0.5:
            steps.append([k, int(rng.integers(free.size)), k + 1, int(rng.integers(free.size))])
    for level in levels:
        area = np.zeros(shape, dtype=np.uint8)
        for _ in range(rng.integers(0, 4)):
            row, col = rng.integers(0, shape)
            area[row : row + rng.integers(1, 8), col : col + rng.integers(1, 8)] = rng.integers(7)
            if rng.random() < 0.3:
                area[row] = rng.integers(7)
        level.attributes["area"] = area
    table = [random_area(rng, f"area {k}") for k in range(rng.integers(0, 7))]
    links = [random_link(rng, f"link {k}", levels) for k in range(rng.integers(0, 12))]
    grid = stack(levels, [*steps, *links])
    own = {"links": [*steps, *links], "areas": table, "agents": AGENTS}
    metadata = {**grid.metadata, "sceneId": "tower", "navbake": own}
    return MultiLevelGrid(grids=levels, cell_size=0.1, metadata=metadata)


def random_area(rng, name):
    cost = rng.choice([1.0, 0.5, 2.0, 4.5, math.inf], p=[0.15, 0.1, 0.25, 0.15, 0.35])
    entry = {"name": name, "cost": "inf" if math.isinf(cost) else float(cost)}
    if rng.random() < 0.4:
        entry["speed"] = float(rng.choice([0.2, 0.5, 3.0]))
    if rng.random() < 0.3:
        entry["agents"] = [str(each) for each in rng.choice(list(AGENTS), rng.integers(0, 3))]
    return entry


def random_link(rng, name, levels):
    stops, positions = [], []
    for _ in range(rng.integers(2, 5)):
        level = int(rng.integers(len(levels)))
        free = np.flatnonzero(levels[level].free)
        cell = int(
            rng.choice(free) if rng.random() < 0.9 else rng.integers(levels[level].free.size)
        )
        row, col = divmod(cell, levels[level].width)
        x, y = levels[level].lattice.positions(row, col).tolist()
        stops.append([level, cell])
        positions.append([x, y, float(levels[level].floor_height[row, col])])
    entry = {"name": name, "kind": str(rng.choice(["lift", "drop", "ladder"]))}
    entry |= {"stops": stops, "positions": positions, "one_way": bool(rng.random() < 0.4)}
    for key, values in (
        ("width", (0.1, 0.25, 0.9)),
        ("cost", (0.0, 0.3, 4.0)),
        ("seconds", (0.0, 6.0)),
    ):
        if rng.random() < 0.4:
            entry[key] = float(rng.choice(values))
    if rng.random() < 0.3:
        entry["agents"] = [str(each) for each in rng.choice(list(AGENTS), rng.integers(0, 3))]
    return {**entry, "state": "closed" if rng.random() < 0.35 else "open"}


def what_bars(entry, name, radius):
    """What keeps an agent from a link: "is closed", "bars …", "is … wide"; None for nothing."""
    if entry["state"] == "closed":
        return "is closed"
    if name is not None and name not in entry.get("agents", [name]):
        return f"bars {name!r}"
    if entry.get("width", math.inf) < 2 * radius - 1e-9:
        return f"is {entry['width']:g} m wide, narrower than the agent's {2 * radius:g} m"
    return None


def area_bars(entry, name):
    return entry["cost"] == "inf" or (name is not None and name not in entry.get("agents", [name]))


def plan_graph(grid, name, by="cost", *, all_open=False, turns=None):
    """Costs of all steps and passages for an agent, as a sparse matrix over flat ids.

    `grid` fits the agent's size, which has room for a diagonal step at both ends where `turns`
    says so. With `all_open` nothing is barred, and links lead both ways.
    """
    own = grid.navbake
    agent = AGENTS.get(name, {})
    speed, radius = agent.get("speed", 1.0), agent.get("radius", 0.0)
    levels = []
    for level in grid.levels:
        weights = level.weights.copy()
        for row, col in np.ndindex(level.shape):
            number = int(level.attributes["area"][row, col])
            area = own["areas"][number - 1] if 0 < number <= len(own["areas"]) else {"cost": 1.0}
            if area_bars(area, name) and not all_open:
                weights[row, col] = np.inf
            elif math.isfinite(weights[row, col]):
                if by == "time":
                    weights[row, col] = 1.0 / min(speed, area.get("speed", math.inf))
                elif not all_open:
                    weights[row, col] *= float(area["cost"])
        levels.append(level.with_layers(weights=weights))
    priced = stack(levels, [entry for entry in own["links"] if isinstance(entry, list)])
    steps = step_graph(priced).tocoo()
    one, other = steps.coords
    if turns is not None:
        of_level = np.concatenate([np.full(v.free.size, k) for k, v in enumerate(levels)])
        places = np.concatenate([np.argwhere(np.ones(v.shape)) for v in levels])
        is_diagonal = (np.abs(places[one] - places[other]) == 1).all(axis=1)
        is_diagonal &= of_level[one] == of_level[other]
        kept = ~is_diagonal | (turns[one] & turns[other])
        steps = coo_array((steps.data[kept], (one[kept], other[kept])), shape=steps.shape)
    graph = steps.todok()
    start = np.cumsum([0] + [level.free.size for level in levels])
    for entry in own["links"]:
        if isinstance(entry, list) or (what_bars(entry, name, radius) and not all_open):
            continue
        for i, j in itertools.permutations(range(len(entry["stops"])), 2):
            (a, cell), (b, other) = entry["stops"][i], entry["stops"][j]
            ends = start[a] + cell, start[b] + other
            is_free = levels[a].free.flat[cell] and levels[b].free.flat[other]
            if not is_free or ends[0] == ends[1] or (entry["one_way"] and j < i and not all_open):
                continue
            between = entry["positions"][min(i, j) : max(i, j) + 1]
            length = sum(math.dist(p, q) for p, q in itertools.pairwise(between))
            spent = entry.get("cost", length)
            if by == "time":
                spent = entry.get("seconds", spent / speed)
            graph[ends] = max(min(spent, graph.get(ends, 0.0) or math.inf), TINY)
    return coo_array(graph).tocsr()
