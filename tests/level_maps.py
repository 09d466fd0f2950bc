"""Levels as maps one can read, for tests of the run time."""

from __future__ import annotations

import numpy as np

from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D

CELL = 0.1
AGENT = {"agentHeight": 1.14, "agentRadius": 0.05, "traversableFloorHeight": 0.25}


def make_level(occupied, floor=None, col=0, row=0, cell=CELL, unit=1.0, **fields) -> SceneGrid2D:
    """A level whose cell 0 is at a place of the common lattice."""
    occupied = np.array(occupied, np.uint8)
    floor = np.zeros(occupied.shape) if floor is None else np.array(floor)
    floor = np.broadcast_to(floor, occupied.shape).astype(np.float32)
    return SceneGrid2D(
        width=occupied.shape[1],
        height=occupied.shape[0],
        cell_size=cell,
        min_yup=(col * cell, 0.0, row * cell),
        unit=unit,
        weights=np.where((occupied == 0) & ~np.isnan(floor), 1.0, np.inf),
        attributes={"floorHeight": floor, "occupancy": occupied},
        **{"metadata": dict(AGENT), **fields},
    )


def level_of(*rows: str, **fields) -> SceneGrid2D:
    """A level from a map: ``#`` occupied, space no floor, a digit the floor in tenths."""
    cells = np.array([list(row) for row in rows])
    floor = np.array([[int(c) / 10 if c.isdigit() else np.nan for c in row] for row in rows])
    floor[cells == "#"] = 0.0
    return make_level((cells == "#") | (cells == " "), floor, **fields)


def shown(level: SceneGrid2D) -> list[str]:
    return ["".join(".#"[int(not free)] for free in row) for row in level.free]


def stack(*levels: SceneGrid2D, links=()) -> MultiLevelGrid:
    metadata = {**AGENT, "navbake": {"links": [v for link in links for v in link]}}
    for level in levels:
        level.metadata = metadata
    return MultiLevelGrid(grids=list(levels), cell_size=levels[0].cell_size, metadata=metadata)


def stairs(*upper: str) -> MultiLevelGrid:
    """A flight up from the left at the level 0, over a room whose wall is below the landing."""
    lower = level_of(*["000#" + "#" * 8] * 5)
    lower.attributes["floorHeight"][:, 3:9] = [0.2, 0.4, 0.6, 0.8, 1.0, 1.2]
    lower.attributes["occupancy"][:, 3:9] = 0
    lower.weights = np.where(lower.occupancy == 0, 1.0, np.inf)
    top = level_of(*upper, col=9)
    top.attributes["floorHeight"] += np.float32(1.4)
    width = lower.width
    links = [[0, row * width + 8, 1, row * top.width] for row in range(5)]
    return stack(lower, top, links=links)
