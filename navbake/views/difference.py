"""Finds the differences of two grids: of cells, rooms, doors and settings."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from navbake.navgrid.colors import rgb_of
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.rooms import Room
from navbake.types import Bool, Float, Int, Json
from navbake.views.notebook import encode_png
from navbake.views.page import pack, show_table
from navbake.views.tables import make_table

# most cells of a level that a page holds; of a larger level it has only each n-th row and column
MAX_PAGE_CELLS = 4_000_000
MAX_GROUND_GAP = 1.5  # levels of two grids whose grounds differ by more aren't the same level [m]
# The lattice that covers two levels may have this many times the cells of both together ...
MAX_COVER_FACTOR = 4
MIN_COVER_LIMIT = 4_000_000  # ... and in any case this many cells.
MAX_SAME_FLOOR_GAP = 1e-3  # floors that differ by at most this are the same [m]

# kind of change of a cell -> colour; most important first. Colours differ in hue and lightness.
CHANGE_COLORS = {
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
CHANGE_KINDS = tuple(CHANGE_COLORS)[:7]  # the last three kinds are no changes
ONLY_IN_FIRST = CHANGE_KINDS[5]
ONLY_IN_SECOND = CHANGE_KINDS[6]

DifferenceRow: TypeAlias = tuple[str, str, str]
"""What differs, its value in the first grid, and its value in the second."""


def describe_changes(first: NavGrid, second: NavGrid, names: Sequence[str]) -> Json:
    """Describe the differences of two grids for a report, which shows them on a sheet (tab).

    Args:
        first: the grid before.
        second: the grid after.
        names: the names of the first and of the second grid.

    Returns:
        The sheet's content as JSON; the keys are those of a grid's sheet in a report.
    """
    pairs = match_levels(first, second)
    levels = [
        compare_levels(first.levels[i], second.levels[j], level_numbers=(i, j)) for i, j in pairs
    ]
    level_names = [(first.level_names[i], second.level_names[j]) for i, j in pairs]
    num_changes = len(CHANGE_KINDS)
    counts = [
        np.bincount(level.change.ravel(), minlength=num_changes)[:num_changes] for level in levels
    ]
    changed_cells = [
        (*names_of_level, *count.tolist())
        for names_of_level, count in zip(level_names, counts, strict=True)
    ]
    unmatched_levels = [
        (ONLY_IN_FIRST, name, "")
        for number, name in enumerate(first.level_names)
        if number not in [pair[0] for pair in pairs]
    ]
    unmatched_levels += [
        (ONLY_IN_SECOND, "", name)
        for number, name in enumerate(second.level_names)
        if number not in [pair[1] for pair in pairs]
    ]
    doors = list_differences(
        {door.id: door.state for door in first.doors},
        {door.id: door.state for door in second.doors},
    )
    settings = list_differences(settings_of(first), settings_of(second))
    columns = ("what", *names)
    tables = {
        "Cells that changed": make_table(
            (*names, *CHANGE_KINDS), changed_cells, numbers=CHANGE_KINDS
        ),
        "Levels that only one has": make_table(columns, unmatched_levels),
        "Rooms that changed": make_table(columns, list_changed_rooms(first, second, levels)),
        "Doors that changed": make_table(columns, doors),
        "Settings that changed": make_table(columns, settings),
    }
    free_before = _free_area(first)
    free_after = _free_area(second)
    num_changed = sum(int(count.sum()) for count in counts)
    return {
        "name": "difference",
        "facts": [
            ("first", names[0]),
            ("second", names[1]),
            ("cells that changed", f"{num_changed:,}"),
            (
                "free area",
                f"{free_before:.2f} to {free_after:.2f} m² ({free_after - free_before:+.2f})",
            ),
        ],
        "warnings": _warn_of_mismatch(first, second),
        "levels": [
            _show_level(level, names_of_level)
            for level, names_of_level in zip(levels, level_names, strict=True)
        ],
        "tables": [show_table(title, table) for title, table in tables.items() if table.rows],
    }


def _free_area(grid: NavGrid) -> float:
    """Return the free area of all levels together [m²]."""
    area: float = sum(level.free.sum() * level.lattice.cell_size**2 for level in grid.levels)
    return area


def _warn_of_mismatch(first: NavGrid, second: NavGrid) -> list[str]:
    """Return warnings if two grids are of different scenes or have cells of different sizes."""
    warnings = []
    if first.scene_id != second.scene_id:
        warnings.append(f"the scenes differ: {first.scene_id!r} and {second.scene_id!r}")
    first_size = first.levels[0].lattice.cell_size
    second_size = second.levels[0].lattice.cell_size
    if abs(first_size - second_size) > 1e-9:
        compared_cells = f"the cells of {second_size:g} m in which their centres lie"
        warnings.append(f"cells of {first_size:g} m are compared with {compared_cells}")
    return warnings


def _show_level(level: LevelDifference, names: tuple[str, str]) -> Json:
    """Describe the map of a level's changes.

    Args:
        level: the difference of two levels.
        names: the names of the two levels.
    """
    extent = describe_extent(" / ".join(dict.fromkeys(names)), level.lattice)
    stride = extent["every"]
    change = level.change[::stride, ::stride]
    palette = np.array([rgb_of(color) for color in CHANGE_COLORS.values()], dtype=np.uint8)
    legend = [
        entry for number, entry in enumerate(CHANGE_COLORS.items()) if (change == number).any()
    ]
    layer = {
        "name": "changes",
        "title": "",
        "png": png_url(palette[change]),
        "legend": legend,
        "scale": None,
        "labels": [],
        "doors": [],
        "ways": [],
    }
    return {
        **extent,
        "of": [[0, level.first], [1, level.second]],
        "cells": pack({"change": change.ravel()}),
        "kinds": list(CHANGE_COLORS),
        "layers": [layer],
        "marks": [],
    }


def describe_extent(name: str, lattice: Lattice) -> Json:
    """Describe where a map lies in the world, and which of its cells a page shows.

    Args:
        name: the name of the map.
        lattice: the lattice of the map's cells.

    Returns:
        JSON with ``name``; ``width`` and ``height`` in cells; ``cellSize`` [m]; ``xMin`` and
        ``yMax``, world x and y of the upper left corner [m]; and ``every``: a page shows each
        ``every``-th row and column, so that it shows at most `MAX_PAGE_CELLS` cells.
    """
    every = 1
    while -(-lattice.height // every) * -(-lattice.width // every) > MAX_PAGE_CELLS:
        every += 1
    return {
        "name": name,
        "width": lattice.width,
        "height": lattice.height,
        "every": every,
        "cellSize": lattice.cell_size,
        "xMin": lattice.x_min,
        "yMax": lattice.y_max,
    }


def png_url(rgb: NDArray[np.uint8]) -> str:
    """Encode a picture as PNG in a data URL.

    Args:
        rgb: the colour of each pixel, shape (height, width, 3).
    """
    return "data:image/png;base64," + b64encode(encode_png(Image.fromarray(rgb))).decode("ascii")


class RoomMatch(NamedTuple):
    """A room of the first level, and the room of the second level that corresponds to it."""

    first: int  # index of the first level's room
    second: int  # index of the second level's room
    overlap: float  # intersection over union of their cells, 0 to 1


class LevelDifference(NamedTuple):
    """How a level of the first grid and a level of the second differ.

    Attributes:
        first: number of the first grid's level.
        second: number of the second grid's level.
        lattice: the lattice of the first level, extended to cover both levels.
        change: the kind of change of each cell of `lattice`, as an index into `CHANGE_COLORS`,
            shape (height, width).
        rooms: the rooms that are in both levels.
    """

    first: int
    second: int
    lattice: Lattice
    change: NDArray[np.uint8]
    rooms: list[RoomMatch]


def match_levels(first: NavGrid, second: NavGrid) -> list[tuple[int, int]]:
    """Find the levels of two grids that are the same level: those whose grounds are nearest in z.

    Two levels do not match if their grounds are more than `MAX_GROUND_GAP` apart, or if a lattice
    over both would have too many cells, see `MAX_COVER_FACTOR`.

    Args:
        first: a grid.
        second: a grid.

    Returns:
        For each pair of levels, their numbers in the first and in the second grid; ascending.
    """
    candidates = []
    for i, first_level in enumerate(first.levels):
        for j, second_level in enumerate(second.levels):
            cover = _cover_both(first_level.lattice, second_level.lattice)
            num_cells = first_level.free.size + second_level.free.size
            max_cells = max(MIN_COVER_LIMIT, MAX_COVER_FACTOR * num_cells)
            gap = abs(first_level.ground - second_level.ground)
            if gap <= MAX_GROUND_GAP and cover.width * cover.height <= max_cells:
                candidates.append((gap, i, j))
    pairs: dict[int, int] = {}
    for _, i, j in sorted(candidates):
        if i not in pairs and j not in pairs.values():
            pairs[i] = j
    return sorted(pairs.items())


def compare_levels(
    first: SceneGrid2D, second: SceneGrid2D, level_numbers: tuple[int, int]
) -> LevelDifference:
    """Compare two levels cell by cell.

    The first level's lattice is extended over both levels. At the centre of each of its cells, the
    cells of both levels that contain this point are compared.

    Args:
        first: a level of the first grid.
        second: a level of the second grid.
        level_numbers: the number of each level in its grid.
    """
    lattice = _cover_both(first.lattice, second.lattice)
    before = _resample(first, lattice)
    after = _resample(second, lattice)
    in_both = before.inside & after.inside
    rooms = _match_rooms(before.room, after.room)
    # whether a room of the first level (row) is the same as one of the second level (column)
    num_rooms = (int(before.room.max(initial=0)) + 1, int(after.room.max(initial=0)) + 1)
    is_same_room = np.zeros(num_rooms, bool)
    is_same_room[0, 0] = True
    for match in rooms:
        is_same_room[match.first, match.second] = True
    no_floor_before = np.isnan(before.floor)
    no_floor_after = np.isnan(after.floor)
    same_floor = np.isclose(
        before.floor, after.floor, rtol=0, atol=MAX_SAME_FLOOR_GAP, equal_nan=True
    )
    # conditions of the kinds in `CHANGE_COLORS`; a cell's kind is the first whose condition holds
    conditions = [
        after.free & ~before.free & before.inside,
        before.free & ~after.free & after.inside,
        ~same_floor & in_both,
        ~is_same_room[before.room, after.room] & in_both,
        (before.weight != after.weight) & in_both,
        ~after.inside & (before.free | ~no_floor_before),
        ~before.inside & (after.free | ~no_floor_after),
        before.free,
        ~no_floor_before,
    ]
    change = np.select(conditions, list(range(len(conditions))), len(conditions))
    first_number, second_number = level_numbers
    return LevelDifference(first_number, second_number, lattice, change.astype(np.uint8), rooms)


class ResampledLevel(NamedTuple):
    """The values of a level at the centres of a lattice's cells; arrays of the lattice's shape."""

    inside: Bool  # whether the level has a cell there; if not, it is taken as blocked, no floor
    free: Bool  # whether the level's cell is free
    floor: Float  # world z of the floor [m], NaN for none
    room: Int  # index of the room, 0 for none
    weight: Float  # cost of the cell; inf outside


def _resample(level: SceneGrid2D, lattice: Lattice) -> ResampledLevel:
    """Read a level's values at the centres of a lattice's cells."""
    source = level.lattice
    rows = np.floor((source.y_max - lattice.center_y()) / source.cell_size).astype(np.int64)
    cols = np.floor((lattice.center_x() - source.x_min) / source.cell_size).astype(np.int64)
    has_row = (rows >= 0) & (rows < source.height)
    has_col = (cols >= 0) & (cols < source.width)
    inside = has_row[:, None] & has_col
    cells = np.ix_(np.clip(rows, 0, source.height - 1), np.clip(cols, 0, source.width - 1))
    return ResampledLevel(
        inside=inside,
        free=level.free[cells] & inside,
        floor=np.where(inside, level.floor[cells], np.nan),
        room=np.where(inside, level.room_index[cells].astype(np.int64), 0),
        weight=np.where(inside, level.weights[cells].astype(np.float64), np.inf),
    )


def _cover_both(lattice: Lattice, second: Lattice) -> Lattice:
    """Extend a lattice by whole cells so that it covers a second one, too."""
    size = lattice.cell_size
    # by how many cells the second lattice extends beyond each side; rounding errors don't count
    beyond = (np.array(lattice.bounds) - second.bounds) * (1, 1, -1, -1) / size - 1e-6
    west, south, east, north = np.ceil(beyond).clip(min=0).astype(np.int64).tolist()
    return Lattice(
        lattice.x_min - west * size,
        lattice.y_max + north * size,
        size,
        lattice.width + west + east,
        lattice.height + south + north,
    )


def _match_rooms(first: Int, second: Int) -> list[RoomMatch]:
    """Pair rooms of two levels that are each other's best overlap.

    Args:
        first: the index of the first level's room at each cell, 0 for none.
        second: the index of the second level's room at each cell, the same shape.
    """
    # each column of `pairs` has room indices of both levels; `common`: the number of such cells
    pairs, common = np.unique(np.stack([first.ravel(), second.ravel()]), axis=1, return_counts=True)
    first_sizes = np.bincount(first.ravel())
    second_sizes = np.bincount(second.ravel())
    union = first_sizes[pairs[0]] + second_sizes[pairs[1]] - common
    overlap = common / union
    # sorted so that the largest overlap is last, and of equal overlaps the lowest room indices
    order = np.lexsort((-pairs[1], -pairs[0], overlap)).tolist()
    matches = [
        RoomMatch(int(pairs[0, k]), int(pairs[1, k]), float(overlap[k]))
        for k in order
        if pairs[:, k].all()
    ]
    # of a room's matches, the last remains, which has the largest overlap
    best_of_first = {match.first: match for match in matches}
    best_of_second = {match.second: match for match in matches}
    return sorted(
        match for match in best_of_first.values() if best_of_second[match.second] == match
    )


def list_changed_rooms(
    first: NavGrid, second: NavGrid, levels: Sequence[LevelDifference]
) -> list[DifferenceRow]:
    """List the rooms that were renamed, changed their cells, or are in only one of the grids.

    Args:
        first: a grid.
        second: a grid.
        levels: the differences of the levels that both grids have.
    """
    first_rooms = {(room.level, room.index): room for room in first.rooms}
    second_rooms = {(room.level, room.index): room for room in second.rooms}

    def describe_room(room: Room) -> str:
        return f"{room.name or room.id}, {room.area:.2f} m²"

    rows = []
    for level in levels:
        for match in level.rooms:
            before = first_rooms.pop((level.first, match.first), None)
            after = second_rooms.pop((level.second, match.second), None)
            if before is None or after is None:
                continue
            changes = []
            if before.name != after.name:
                changes.append("renamed")
            if match.overlap != 1:
                changes.append(f"{match.overlap:.1%} of their cells are common")
            if changes:
                rows.append(("; ".join(changes), describe_room(before), describe_room(after)))
    rows += [(ONLY_IN_FIRST, describe_room(room), "") for room in first_rooms.values()]
    rows += [(ONLY_IN_SECOND, "", describe_room(room)) for room in second_rooms.values()]
    return rows


def settings_of(grid: NavGrid) -> dict[str, str]:
    """Return a grid's settings: path, such as ``settings.agent.radius`` -> value as text.

    The scene's digest, the agent's radius, the inflations and the cells' size are among them.
    """
    return flatten(
        {
            "settings": grid.navbake.get("settings"),
            "sceneDigest": grid.navbake.get("sceneDigest"),
            "radius": f"{grid.agent_radius:g} m",
            "inflation": grid.metadata.get("inflation"),
            "cell size": f"{grid.cell_size * grid.unit:g} m",
        }
    )


def list_differences(first: Mapping[str, str], second: Mapping[str, str]) -> list[DifferenceRow]:
    """List the entries that only one of two mappings has, or that have different values.

    Args:
        first: values by key.
        second: values by key.

    Returns:
        Rows of key, first value and second value, sorted by key; ``""`` for a missing value.
    """
    keys = sorted(key for key in first.keys() | second.keys() if first.get(key) != second.get(key))
    return [(key, first.get(key, ""), second.get(key, "")) for key in keys]


def flatten(json: object, path: str = "") -> dict[str, str]:
    """Flatten nested JSON objects into one mapping.

    Args:
        json: an object, a list or a scalar. A list without objects becomes one text.
        path: the path of `json` itself; the paths of its entries begin with it.

    Returns:
        Path, such as ``scene.sites.0`` -> value as text; null is left out.
    """
    if isinstance(json, list) and any(isinstance(entry, dict) for entry in json):
        json = dict(enumerate(json))
    if not isinstance(json, dict):
        return {} if json is None else {path: str(json)}
    flat: dict[str, str] = {}
    for key, entry in json.items():
        flat |= flatten(entry, f"{path}.{key}" if path else str(key))
    return flat
