"""What differs between two grids: cell by cell, and in their rooms, doors and settings."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from navbake.navgrid.colors import rgb_of
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.rooms import Room
from navbake.types import Int, Json
from navbake.views.notebook import encode_png
from navbake.views.page import pack, show_table
from navbake.views.tables import make_table

MAX_SHOWN = 4_000_000  # cells of a level that a page holds; of larger ones only every n-th
MOST_APART = 1.5  # of the grounds of two levels that are taken for the same storey [m]
MOST_ADDED = 4  # times the cells of two levels that a lattice over both may have, and
ALWAYS = 4_000_000  # as many cells at least
SAME_FLOOR = 1e-3  # by how much floors differ that are taken for the same [m]

# what became of a cell, most telling first; colours differ by hue and by lightness
COLORS = {
    "became free": "#009e73",
    "became blocked": "#d55e00",
    "floor moved": "#0072b2",
    "other room": "#cc79a7",
    "other weight": "#e69f00",
    "only in the first": "#6f5f4f",
    "only in the second": "#56b4e9",
    "free in both": "#f7f3e8",
    "blocked in both": "#9aa2b1",
    "no floor in both": "#d9dde3",
}
CHANGES = tuple(COLORS)[:7]  # the others are alike in both
ONLY = CHANGES[5:]

Row = tuple[str, str, str]
"""What differs, and how the first and the second grid have it."""


def describe_changes(first: NavGrid, second: NavGrid, names: Sequence[str]) -> Json:
    """The sheet of two grids' difference, as a report has one of a grid."""
    grids = (first, second)
    warnings = []
    pairs = match_levels(first, second)
    levels = [compare_levels(first.levels[i], second.levels[j], (i, j)) for i, j in pairs]
    called = [(first.level_names[i], second.level_names[j]) for i, j in pairs]
    most = len(CHANGES)
    counts = [np.bincount(level.change.ravel(), minlength=most)[:most] for level in levels]
    cells = [(*both, *count.tolist()) for both, count in zip(called, counts, strict=True)]
    alone = [
        (ONLY[side], *("" if side else name, name if side else ""))
        for side, grid in enumerate(grids)
        for number, name in enumerate(grid.level_names)
        if number not in [pair[side] for pair in pairs]
    ]
    columns = ("what", *names)
    doors = [{door.id: door.state for door in grid.doors} for grid in grids]
    tables = {
        "Cells that changed": make_table((*names, *CHANGES), cells, numbers=CHANGES),
        "Levels that only one has": make_table(columns, alone),
        "Rooms that changed": make_table(columns, list_changed_rooms(first, second, levels)),
        "Doors that changed": make_table(columns, list_differences(*doors)),
        "Settings that changed": make_table(columns, list_differences(*map(settings_of, grids))),
    }
    if first.scene_id != second.scene_id:
        warnings.append(f"the scenes differ: {first.scene_id!r} and {second.scene_id!r}")
    ours, theirs = (grid.levels[0].lattice.cell_size for grid in grids)
    if abs(ours - theirs) > 1e-9:
        where = f"with the cells of {theirs:g} m in which their centres lie"
        warnings.append(f"cells of {ours:g} m are compared {where}")
    areas = [[v.free.sum() * v.lattice.cell_size**2 for v in grid.levels] for grid in grids]
    before, after = map(sum, areas)
    changed = f"{sum(int(count.sum()) for count in counts):,}"
    facts = {"first": names[0], "second": names[1], "cells that changed": changed}
    facts["free area"] = f"{before:.2f} to {after:.2f} m² ({after - before:+.2f})"
    return {
        "name": "difference",
        "facts": [*facts.items()],
        "warnings": warnings,
        "levels": [_show_level(*each) for each in zip(levels, called, strict=True)],
        "tables": [show_table(title, made) for title, made in tables.items() if made.rows],
    }


def _show_level(level: LevelDifference, names: tuple[str, str]) -> Json:
    place = describe_extent(" / ".join(dict.fromkeys(names)), level.lattice)
    change = level.change[:: place["every"], :: place["every"]]
    colors = np.array([rgb_of(color) for color in COLORS.values()], dtype=np.uint8)
    legend = [entry for n, entry in enumerate(COLORS.items()) if (change == n).any()]
    layer: Json = {"name": "changes", "title": "", "png": png_url(colors[change]), "legend": legend}
    return {
        **place,
        "of": [[0, level.first], [1, level.second]],
        "cells": pack({"change": change.ravel()}),
        "kinds": [*COLORS],
        "layers": [{**layer, "scale": None, "labels": [], "doors": [], "ways": []}],
        "marks": [],
    }


def describe_extent(name: str, lattice: Lattice) -> Json:
    """Where a map lies in the world, and every which row and column of it a page shows."""
    every = 1
    while -(-lattice.height // every) * -(-lattice.width // every) > MAX_SHOWN:
        every += 1
    place = {"name": name, "width": lattice.width, "height": lattice.height, "every": every}
    return place | {"cellSize": lattice.cell_size, "xMin": lattice.x_min, "yMax": lattice.y_max}


def png_url(rgb: NDArray[np.uint8]) -> str:
    """A picture, shape (rows, cols, 3), as the URL of a PNG that holds all of it."""
    return "data:image/png;base64," + b64encode(encode_png(Image.fromarray(rgb))).decode("ascii")


class LevelDifference(NamedTuple):
    """How a level of the first grid and one of the second differ."""

    first: int  # their numbers
    second: int
    lattice: Lattice  # the cells of the first one's lattice that cover both
    change: NDArray[np.uint8]  # of each cell: the number of its entry in `COLORS`
    rooms: list[tuple[int, int, float]]  # that are the same, and intersection over union


def match_levels(first: NavGrid, second: NavGrid) -> list[tuple[int, int]]:
    """Pair the levels of two grids whose grounds are the nearest, at most `MOST_APART` apart.

    Levels too far from each other to be drawn together are no pair; see `MOST_ADDED`.
    """
    apart = []
    for i, one in enumerate(first.levels):
        for j, other in enumerate(second.levels):
            both = _cover_both(one.lattice, other.lattice)
            own = one.free.size + other.free.size
            distance = abs(one.ground - other.ground)
            is_near = both.width * both.height <= max(ALWAYS, MOST_ADDED * own)
            apart += [(distance, i, j)] if distance <= MOST_APART and is_near else []
    pairs: dict[int, int] = {}
    for _, i, j in sorted(apart):
        if i not in pairs and j not in pairs.values():
            pairs[i] = j
    return sorted(pairs.items())


def compare_levels(
    first: SceneGrid2D, second: SceneGrid2D, pair: tuple[int, int]
) -> LevelDifference:
    """Compare two levels at the centres of the first one's cells, of both or beyond its edges.

    Each is compared with the cell of the second level that holds it.
    """
    lattice = _cover_both(first.lattice, second.lattice)
    sampled = _sample(first, lattice), _sample(second, lattice)
    there, free, floor, room, weight = zip(*sampled, strict=True)
    rooms = _match_rooms(*room)
    both = there[0] & there[1]
    same_room = np.zeros([int(of_one.max(initial=0)) + 1 for of_one in room], bool)
    same_room[0, 0] = True
    for a, b, _ in rooms:
        same_room[a, b] = True
    has_none = [np.isnan(heights) for heights in floor]
    moved = ~np.isclose(*floor, rtol=0, atol=SAME_FLOOR, equal_nan=True)
    happened = [
        free[1] & ~free[0] & there[0],
        free[0] & ~free[1] & there[1],
        moved & both,
        ~same_room[room] & both,
        (weight[0] != weight[1]) & both,
        ~there[1] & (free[0] | ~has_none[0]),
        ~there[0] & (free[1] | ~has_none[1]),
        free[0],
        ~has_none[0],
    ]
    change = np.select(happened, [*range(len(happened))], len(happened)).astype(np.uint8)
    return LevelDifference(*pair, lattice, change, rooms)


def _sample(level: SceneGrid2D, lattice: Lattice) -> tuple[NDArray[Any], ...]:
    """Whether a level has a cell at the centres of a lattice's; free; floor [m]; room; weight."""
    own = level.lattice
    rows = np.floor((own.y_max - lattice.center_y()) / own.cell_size).astype(np.int64)
    cols = np.floor((lattice.center_x() - own.x_min) / own.cell_size).astype(np.int64)
    inside = ((rows >= 0) & (rows < own.height))[:, None] & ((cols >= 0) & (cols < own.width))
    at = np.ix_(np.clip(rows, 0, own.height - 1), np.clip(cols, 0, own.width - 1))
    return (
        inside,
        level.free[at] & inside,
        np.where(inside, level.floor[at], np.nan),
        np.where(inside, level.room_index[at].astype(np.int64), 0),
        np.where(inside, level.weights[at].astype(np.float64), np.inf),
    )


def _cover_both(lattice: Lattice, other: Lattice) -> Lattice:
    """The cells of a lattice, and as many more beside them as cover another one, too."""
    size = lattice.cell_size
    # of each side; what lies on an edge but for rounding isn't beyond it
    beyond = (np.array(lattice.bounds) - other.bounds) * (1, 1, -1, -1) / size - 1e-6
    left, bottom, right, top = np.ceil(beyond).clip(min=0).astype(np.int64).tolist()
    shape = lattice.width + left + right, lattice.height + top + bottom
    return Lattice(lattice.x_min - left * size, lattice.y_max + top * size, size, *shape)


def _match_rooms(one: Int, other: Int) -> list[tuple[int, int, float]]:
    """Pair rooms each of which overlaps the other the most, with intersection over union."""
    pairs, common = np.unique(np.stack([one.ravel(), other.ravel()]), axis=1, return_counts=True)
    all_one = np.bincount(one.ravel())
    all_other = np.bincount(other.ravel())
    share = common / (all_one[pairs[0]] + all_other[pairs[1]] - common)
    # the largest share last; of equal ones the lowest rooms
    order = [k for k in np.lexsort((-pairs[1], -pairs[0], share)).tolist() if pairs[:, k].all()]
    found = [(*pairs[:, k].tolist(), float(share[k])) for k in order]
    best_of_one = {a: (a, b, share) for a, b, share in found}
    best_of_other = {b: (a, b, share) for a, b, share in found}
    return sorted(pair for pair in best_of_one.values() if best_of_other[pair[1]] == pair)


def list_changed_rooms(first: NavGrid, second: NavGrid, levels: list[LevelDifference]) -> list[Row]:
    """The rooms that changed: names and areas."""
    rows = []
    rooms = [{(room.level, room.index): room for room in grid.rooms} for grid in (first, second)]

    def shown(room: Room) -> str:
        return f"{room.name or room.id}, {room.area:.2f} m²"

    for level in levels:
        for a, b, share in level.rooms:
            one = rooms[0].pop((level.first, a), None)
            other = rooms[1].pop((level.second, b), None)
            if one is None or other is None:
                continue
            whats = ["renamed"] if one.name != other.name else []
            whats += [f"{share:.1%} of their cells are common"] if share != 1 else []
            if whats:
                rows.append(("; ".join(whats), shown(one), shown(other)))
    rows += [(ONLY[0], shown(room), "") for room in rooms[0].values()]
    return rows + [(ONLY[1], "", shown(room)) for room in rooms[1].values()]


def settings_of(grid: NavGrid) -> dict[str, str]:
    """The settings and digests of a grid, by their path in the metadata."""
    own = {key: grid.navbake.get(key) for key in ("settings", "sceneDigest")}
    own |= {"radius": f"{grid.agent_radius:g} m", "inflation": grid.metadata.get("inflation")}
    return flatten({**own, "cell size": f"{grid.cell_size * grid.unit:g} m"})


def list_differences(one: dict[str, str], other: dict[str, str]) -> list[Row]:
    """The entries that only one has, or that are others."""
    keys = sorted(key for key in one.keys() | other.keys() if one.get(key) != other.get(key))
    return [(key, one.get(key, ""), other.get(key, "")) for key in keys]


def flatten(value: Any, path: str = "") -> dict[str, str]:
    """The values in nested objects by their paths; lists of objects count from 0."""
    if isinstance(value, list) and any(isinstance(inner, dict) for inner in value):
        value = dict(enumerate(value))
    if not isinstance(value, dict):
        return {} if value is None else {path: str(value)}
    found: dict[str, str] = {}
    for key, inner in value.items():
        found |= flatten(inner, f"{path}.{key}" if path else str(key))
    return found
