"""Towers whose storeys are rows of cells, joined by named links."""

import numpy as np

from grid_maps import house_from, level_from

AREAS = [{"name": "lab", "cost": 1, "agents": ["robot"]}, {"name": "mud", "cost": 3, "speed": 0.25}]
AGENTS = {"robot": {"radius": 0.0, "speed": 0.5}, "person": {"speed": 2.0}}


def link(name, kind, *stops, **more):
    """A link of stops (level, column), on levels 3 m apart of one row of cells of 0.1 m."""
    places = [[round(0.1 * col + 0.05, 3), -0.05, 3.0 * level] for level, col in stops]
    cells = [list(stop) for stop in stops]
    return {"name": name, "kind": kind, "stops": cells, "positions": places, "one_way": False,
            "state": "open"} | more  # fmt: skip


def tower(*links, storeys=2, width=20, areas=(), row=None):
    """Storeys of one row of cells; `areas` are (level, first column, last, number)."""
    row = row or "." * width
    levels = [level_from(row, ground=3.0 * k) for k in range(storeys)]
    for level in levels:
        level.attributes["area"] = np.zeros(level.shape, dtype=np.uint8)
    for level, first, last, number in areas:
        levels[level].attributes["area"][0, first : last + 1] = number
    grid = house_from(levels)
    own = {"links": list(links), "areas": AREAS, "agents": AGENTS}
    metadata = {**grid.metadata, "navbake": own}
    for level in levels:
        level.metadata = {}
    return grid.with_levels(levels, metadata)


def at(level, col):
    return 0.1 * col + 0.05, -0.05, 3.0 * level


LIFT = link("A", "lift", (0, 5), (1, 5), (2, 5), seconds=12.0, width=0.9)
DROP = link("dock", "drop", (1, 15), (0, 15), one_way=True, cost=4.0, agents=["robot", "person"])
