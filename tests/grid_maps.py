"""Grids to ask: from maps that one can read, and random ones of several levels with links."""

from __future__ import annotations

import numpy as np

from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D

STEP = 0.25


def level_from(text, cell_size=0.1, x=0.0, y_max=0.0, ground=0.0, floors=True, **fields):
    """A level from a map, its upper left corner at x, y_max.

    ``.`` free, a digit free and so many times 0.1 m over the ground, ``#`` occupied, ``+``
    blocked but not occupied (as by a larger radius), space: no floor.
    """
    cells = np.array([list(row) for row in text.strip("\n").split("\n")])
    height, width = cells.shape
    free = (cells == ".") | np.char.isdigit(cells)
    rise = np.where(np.char.isdigit(cells), cells, "0").astype(float) * 0.1
    floor = np.where(cells == " ", np.nan, ground + rise).astype(np.float32)
    attributes = {"occupancy": ((cells == "#") | (cells == " ")).astype(np.uint8)}
    if floors:
        attributes["floorHeight"] = floor
    return SceneGrid2D(
        width=width,
        height=height,
        cell_size=cell_size,
        min_yup=(x, ground, -y_max),
        weights=np.where(free, 1.0, np.inf),
        attributes=attributes,
        metadata={"traversableFloorHeight": STEP},
        **fields,
    )


def house_from(levels, links=(), rooms=None, cell_size=0.1):
    """Levels as one grid; links as ((level, row, col), (level, row, col))."""
    flat = []
    for (a, row_a, col_a), (b, row_b, col_b) in links:
        flat.append([a, row_a * levels[a].width + col_a, b, row_b * levels[b].width + col_b])
    metadata = {"traversableFloorHeight": STEP, "sceneId": "house", "navbake": {"links": flat}}
    for level in levels:
        level.metadata = metadata
    if rooms is not None:
        metadata["navbake"]["rooms"] = rooms
    return MultiLevelGrid(grids=list(levels), cell_size=cell_size, metadata=metadata)


def random_house(rng, num_levels=2, share=0.7, size=(8, 15), steps=True):
    """Levels on one lattice, none of them square, with steps on them and links between them."""
    cell_size = 0.1
    shape = np.array([rng.integers(*size), rng.integers(*size) + size[1]])
    levels = []
    for number in range(num_levels):
        row, col = rng.integers(0, 3, size=2)
        height, width = shape - rng.integers(0, 3, size=2) - (row, col)
        free = rng.random((height, width)) < share
        rise = rng.integers(0, 5, size=(height, width)) * 0.1 if steps else np.zeros(free.shape)
        floor = (2.0 * number + rise).astype(np.float32)
        occupied = ~free & (rng.random(free.shape) < 0.8)
        floor[occupied & (rng.random(free.shape) < 0.3)] = np.nan
        level = SceneGrid2D(
            width=int(width),
            height=int(height),
            cell_size=cell_size,
            min_yup=(-0.7 + col * cell_size, 2.0 * number, -1.3 + row * cell_size),
            weights=np.where(free, 1.0, np.inf),
            attributes={"occupancy": occupied.astype(np.uint8), "floorHeight": floor},
        )
        levels.append(level)
    return house_from(levels, list(_links(rng, levels)))


def _links(rng, levels):
    """Some neighbouring cells of two levels, each free."""
    for a in range(len(levels) - 1):
        low, high = levels[a], levels[a + 1]
        down = round((low.lattice.y_max - high.lattice.y_max) / 0.1)
        along = round((high.lattice.x_min - low.lattice.x_min) / 0.1)
        for row, col in np.argwhere(low.free):
            way = ((0, 1), (1, 0), (0, -1), (-1, 0))[rng.integers(4)]
            there = (row - down + way[0], col - along + way[1])
            inside = 0 <= there[0] < high.height and 0 <= there[1] < high.width
            if inside and high.free[there] and rng.random() < 0.1:
                yield (a, int(row), int(col)), (a + 1, int(there[0]), int(there[1]))


def room(level, index, id, name=None):
    """An entry of the table of rooms in a grid's metadata."""
    return {
        "level": level, "index": index, "id": id, "name": name, "area": 1.0,
        "centroid": [0.0, 0.0, 0.0], "neighbours": [],
    }  # fmt: skip
