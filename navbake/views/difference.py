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
from navbake.views.page import describe_table, pack_json
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
"""The name of a thing that differs, its value in the first grid, and its value in the second."""


def describe_changes(first_grid: NavGrid, second_grid: NavGrid, grid_names: Sequence[str]) -> Json:
    """Describe the differences of two grids for a report, which shows them on a sheet (tab).

    Args:
        first_grid: the grid before.
        second_grid: the grid after.
        grid_names: the names of the first and of the second grid.

    Returns:
        The sheet's content as JSON; the keys are those of a grid's sheet in a report.
    """
    level_pairs = match_levels(first_grid, second_grid)
    level_differences = [
        compare_levels(
            first_grid.levels[first_number],
            second_grid.levels[second_number],
            level_numbers=(first_number, second_number),
        )
        for first_number, second_number in level_pairs
    ]
    level_names = [
        (first_grid.level_names[first_number], second_grid.level_names[second_number])
        for first_number, second_number in level_pairs
    ]
    num_change_kinds = len(CHANGE_KINDS)
    change_counts = [
        np.bincount(difference.change_of_cell.ravel(), minlength=num_change_kinds)[
            :num_change_kinds
        ]
        for difference in level_differences
    ]
    change_rows = [
        (*names_of_level, *change_counts_of_level.tolist())
        for names_of_level, change_counts_of_level in zip(level_names, change_counts, strict=True)
    ]
    unmatched_level_rows = [
        (ONLY_IN_FIRST, name, "")
        for level_number, name in enumerate(first_grid.level_names)
        if level_number not in [pair[0] for pair in level_pairs]
    ]
    unmatched_level_rows += [
        (ONLY_IN_SECOND, "", name)
        for level_number, name in enumerate(second_grid.level_names)
        if level_number not in [pair[1] for pair in level_pairs]
    ]
    door_rows = list_differences(
        {door.id: door.state for door in first_grid.doors},
        {door.id: door.state for door in second_grid.doors},
    )
    setting_rows = list_differences(read_settings(first_grid), read_settings(second_grid))
    headings = ("what", *grid_names)
    tables = {
        "Cells that changed": make_table(
            (*grid_names, *CHANGE_KINDS), change_rows, numbers=CHANGE_KINDS
        ),
        "Levels that only one has": make_table(headings, unmatched_level_rows),
        "Rooms that changed": make_table(
            headings, list_changed_rooms(first_grid, second_grid, level_differences)
        ),
        "Doors that changed": make_table(headings, door_rows),
        "Settings that changed": make_table(headings, setting_rows),
    }
    area_before = _free_area(first_grid)
    area_after = _free_area(second_grid)
    num_changed_cells = sum(
        int(change_counts_of_level.sum()) for change_counts_of_level in change_counts
    )
    return {
        "name": "difference",
        "facts": [
            ("first", grid_names[0]),
            ("second", grid_names[1]),
            ("cells that changed", f"{num_changed_cells:,}"),
            (
                "free area",
                f"{area_before:.2f} to {area_after:.2f} m² ({area_after - area_before:+.2f})",
            ),
        ],
        "warnings": _warn_of_mismatch(first_grid, second_grid),
        "levels": [
            _show_level(difference, names_of_level)
            for difference, names_of_level in zip(level_differences, level_names, strict=True)
        ],
        "tables": [describe_table(title, table) for title, table in tables.items() if table.rows],
    }


def _free_area(grid: NavGrid) -> float:
    """Return the free area of all levels together [m²]."""
    free_area: float = sum(level.free.sum() * level.lattice.cell_size**2 for level in grid.levels)
    return free_area


def _warn_of_mismatch(first_grid: NavGrid, second_grid: NavGrid) -> list[str]:
    """Return warnings if two grids are of different scenes or have cells of different sizes."""
    warnings = []
    if first_grid.scene_id != second_grid.scene_id:
        warnings.append(f"the scenes differ: {first_grid.scene_id!r} and {second_grid.scene_id!r}")
    first_cell_size = first_grid.levels[0].lattice.cell_size
    second_cell_size = second_grid.levels[0].lattice.cell_size
    if abs(first_cell_size - second_cell_size) > 1e-9:
        comparison_text = f"the cells of {second_cell_size:g} m in which their centres lie"
        warnings.append(f"cells of {first_cell_size:g} m are compared with {comparison_text}")
    return warnings


def _show_level(difference: LevelDifference, level_names: tuple[str, str]) -> Json:
    """Describe the map of a level's changes.

    Args:
        difference: the difference of two levels.
        level_names: the names of the two levels.
    """
    map_extent = describe_extent(" / ".join(dict.fromkeys(level_names)), difference.lattice)
    stride = map_extent["every"]
    change_of_cell = difference.change_of_cell[::stride, ::stride]
    palette = np.array([rgb_of(color) for color in CHANGE_COLORS.values()], dtype=np.uint8)
    legend = [
        entry
        for kind_index, entry in enumerate(CHANGE_COLORS.items())
        if (change_of_cell == kind_index).any()
    ]
    layer = {
        "name": "changes",
        "title": "",
        "png": encode_png_url(palette[change_of_cell]),
        "legend": legend,
        "scale": None,
        "labels": [],
        "doors": [],
        "ways": [],
    }
    return {
        **map_extent,
        "of": [[0, difference.first_number], [1, difference.second_number]],
        "cells": pack_json({"change": change_of_cell.ravel()}),
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
    stride = 1
    while -(-lattice.height // stride) * -(-lattice.width // stride) > MAX_PAGE_CELLS:
        stride += 1
    return {
        "name": name,
        "width": lattice.width,
        "height": lattice.height,
        "every": stride,
        "cellSize": lattice.cell_size,
        "xMin": lattice.x_min,
        "yMax": lattice.y_max,
    }


def encode_png_url(rgb: NDArray[np.uint8]) -> str:
    """Encode a picture as PNG in a data URL.

    Args:
        rgb: the colour of each pixel, shape (height, width, 3).
    """
    return "data:image/png;base64," + b64encode(encode_png(Image.fromarray(rgb))).decode("ascii")


class RoomMatch(NamedTuple):
    """A room of the first level, and the room of the second level that corresponds to it."""

    first_room: int  # index of the first level's room
    second_room: int  # index of the second level's room
    overlap: float  # intersection over union of their cells, 0 to 1


class LevelDifference(NamedTuple):
    """The differences between a level of the first grid and a level of the second.

    Attributes:
        first_number: number of the first grid's level.
        second_number: number of the second grid's level.
        lattice: the lattice of the first level, extended to cover both levels.
        change_of_cell: the kind of change of each cell of `lattice`, as an index into
            `CHANGE_COLORS`, shape (height, width).
        room_matches: the rooms that are in both levels.
    """

    first_number: int
    second_number: int
    lattice: Lattice
    change_of_cell: NDArray[np.uint8]
    room_matches: list[RoomMatch]


def match_levels(first_grid: NavGrid, second_grid: NavGrid) -> list[tuple[int, int]]:
    """Pair the levels of two grids whose grounds are nearest in height.

    Two levels do not match if their grounds are more than `MAX_GROUND_GAP` apart, or if a lattice
    over both would have too many cells, see `MAX_COVER_FACTOR`.

    Args:
        first_grid: the first grid.
        second_grid: the second grid.

    Returns:
        For each pair of levels, their numbers in the first and in the second grid; ascending.
    """
    candidate_pairs = []
    for first_number, first_level in enumerate(first_grid.levels):
        for second_number, second_level in enumerate(second_grid.levels):
            covering_lattice = _cover_both(first_level.lattice, second_level.lattice)
            num_cells = first_level.free.size + second_level.free.size
            max_cells = max(MIN_COVER_LIMIT, MAX_COVER_FACTOR * num_cells)
            ground_gap = abs(first_level.ground - second_level.ground)
            if (
                ground_gap <= MAX_GROUND_GAP
                and covering_lattice.width * covering_lattice.height <= max_cells
            ):
                candidate_pairs.append((ground_gap, first_number, second_number))
    second_number_of_first: dict[int, int] = {}
    for _, first_number, second_number in sorted(candidate_pairs):
        if (
            first_number not in second_number_of_first
            and second_number not in second_number_of_first.values()
        ):
            second_number_of_first[first_number] = second_number
    return sorted(second_number_of_first.items())


def compare_levels(
    first_level: SceneGrid2D, second_level: SceneGrid2D, level_numbers: tuple[int, int]
) -> LevelDifference:
    """Compare two levels cell by cell, and match their rooms.

    The first level's lattice is extended over both levels. At the centre of each of its cells, the
    cells of both levels that contain this point are compared.

    Args:
        first_level: a level of the first grid.
        second_level: a level of the second grid.
        level_numbers: the number of each level in its grid.
    """
    lattice = _cover_both(first_level.lattice, second_level.lattice)
    values_before = _resample(first_level, lattice)
    values_after = _resample(second_level, lattice)
    is_in_both = values_before.is_inside & values_after.is_inside
    room_matches = _match_rooms(values_before.room_index, values_after.room_index)
    # whether a room of the first level (row) is the same as one of the second level (column)
    table_shape = (
        int(values_before.room_index.max(initial=0)) + 1,
        int(values_after.room_index.max(initial=0)) + 1,
    )
    is_same_room = np.zeros(table_shape, bool)
    is_same_room[0, 0] = True
    for match in room_matches:
        is_same_room[match.first_room, match.second_room] = True
    had_floor = ~np.isnan(values_before.floor_height)
    has_floor = ~np.isnan(values_after.floor_height)
    is_same_floor = np.isclose(
        values_before.floor_height,
        values_after.floor_height,
        rtol=0,
        atol=MAX_SAME_FLOOR_GAP,
        equal_nan=True,
    )
    has_other_room = ~is_same_room[values_before.room_index, values_after.room_index]
    was_free = values_before.is_free
    is_free = values_after.is_free
    # a cell has the first kind whose mask has it; so cells are the same in both levels from "free
    # in both" on, and what is left has no floor in both
    mask_of_kind: dict[str, Bool] = {
        "became free": is_free & ~was_free & values_before.is_inside,
        "became blocked": was_free & ~is_free & values_after.is_inside,
        "floor moved": ~is_same_floor & is_in_both,
        "other room": has_other_room & is_in_both,
        "other weight": (values_before.weight != values_after.weight) & is_in_both,
        "only in the first": ~values_after.is_inside & (was_free | had_floor),
        "only in the second": ~values_before.is_inside & (is_free | has_floor),
        "free in both": was_free,
        "blocked in both": had_floor,
    }
    kind_numbers = {kind: number for number, kind in enumerate(CHANGE_COLORS)}
    kind_of_cell = np.select(
        list(mask_of_kind.values()),
        [kind_numbers[kind] for kind in mask_of_kind],
        default=kind_numbers["no floor in both"],
    )
    first_number, second_number = level_numbers
    return LevelDifference(
        first_number, second_number, lattice, kind_of_cell.astype(np.uint8), room_matches
    )


class ResampledLevel(NamedTuple):
    """The values of a level at the centres of a lattice's cells; arrays of the lattice's shape."""

    is_inside: Bool  # whether the level has a cell there; if not, it is taken as blocked, no floor
    is_free: Bool  # whether the level's cell is free
    floor_height: Float  # world z of the floor [m], NaN for none
    room_index: Int  # index of the room, 0 for none
    weight: Float  # cost of the cell; inf outside


def _resample(level: SceneGrid2D, lattice: Lattice) -> ResampledLevel:
    """Read a level's values at the centres of a lattice's cells."""
    level_lattice = level.lattice
    level_rows = np.floor(
        (level_lattice.y_max - lattice.center_y()) / level_lattice.cell_size
    ).astype(np.int64)
    level_cols = np.floor(
        (lattice.center_x() - level_lattice.x_min) / level_lattice.cell_size
    ).astype(np.int64)
    has_row = (level_rows >= 0) & (level_rows < level_lattice.height)
    has_col = (level_cols >= 0) & (level_cols < level_lattice.width)
    is_inside = has_row[:, None] & has_col
    cell_indices = np.ix_(
        np.clip(level_rows, 0, level_lattice.height - 1),
        np.clip(level_cols, 0, level_lattice.width - 1),
    )
    return ResampledLevel(
        is_inside=is_inside,
        is_free=level.free[cell_indices] & is_inside,
        floor_height=np.where(is_inside, level.floor[cell_indices], np.nan),
        room_index=np.where(is_inside, level.room_index[cell_indices].astype(np.int64), 0),
        weight=np.where(is_inside, level.weights[cell_indices].astype(np.float64), np.inf),
    )


def _cover_both(first_lattice: Lattice, second_lattice: Lattice) -> Lattice:
    """Extend a lattice by whole cells so that it covers a second one, too."""
    cell_size = first_lattice.cell_size
    # by how many cells the second lattice extends beyond each side; rounding errors don't count
    num_excess_cells = (np.array(first_lattice.bounds) - second_lattice.bounds) * (
        1,
        1,
        -1,
        -1,
    ) / cell_size - 1e-6
    num_west, num_south, num_east, num_north = (
        np.ceil(num_excess_cells).clip(min=0).astype(np.int64).tolist()
    )
    return Lattice(
        first_lattice.x_min - num_west * cell_size,
        first_lattice.y_max + num_north * cell_size,
        cell_size,
        first_lattice.width + num_west + num_east,
        first_lattice.height + num_south + num_north,
    )


def _match_rooms(first_room_index: Int, second_room_index: Int) -> list[RoomMatch]:
    """Pair rooms of two levels that are each other's best overlap.

    Args:
        first_room_index: the index of the first level's room at each cell, 0 for none.
        second_room_index: the index of the second level's room at each cell, the same shape.
    """
    # each column of `room_pairs` has a room index of each level, and `common_sizes` the number of
    # cells with both
    room_pairs, common_sizes = np.unique(
        np.stack([first_room_index.ravel(), second_room_index.ravel()]), axis=1, return_counts=True
    )
    first_sizes = np.bincount(first_room_index.ravel())
    second_sizes = np.bincount(second_room_index.ravel())
    union_sizes = first_sizes[room_pairs[0]] + second_sizes[room_pairs[1]] - common_sizes
    overlaps = common_sizes / union_sizes
    # sorted so that the largest overlap is last, and of equal overlaps the lowest room indices
    pair_order = np.lexsort((-room_pairs[1], -room_pairs[0], overlaps)).tolist()
    matches = [
        RoomMatch(
            int(room_pairs[0, pair_index]),
            int(room_pairs[1, pair_index]),
            float(overlaps[pair_index]),
        )
        for pair_index in pair_order
        if room_pairs[:, pair_index].all()
    ]
    # of a room's matches, the last remains, which has the largest overlap
    best_match_of_first = {match.first_room: match for match in matches}
    best_match_of_second = {match.second_room: match for match in matches}
    return sorted(
        match
        for match in best_match_of_first.values()
        if best_match_of_second[match.second_room] == match
    )


def list_changed_rooms(
    first_grid: NavGrid, second_grid: NavGrid, level_differences: Sequence[LevelDifference]
) -> list[DifferenceRow]:
    """List the rooms that were renamed, changed their cells, or are in only one of the grids.

    Args:
        first_grid: the first grid.
        second_grid: the second grid.
        level_differences: the differences of the levels that both grids have.
    """
    first_rooms = {(room.level, room.index): room for room in first_grid.rooms}
    second_rooms = {(room.level, room.index): room for room in second_grid.rooms}

    def describe_room(room: Room) -> str:
        return f"{room.name or room.id}, {room.area:.2f} m²"

    rows = []
    for difference in level_differences:
        for match in difference.room_matches:
            room_before = first_rooms.pop((difference.first_number, match.first_room), None)
            room_after = second_rooms.pop((difference.second_number, match.second_room), None)
            if room_before is None or room_after is None:
                continue
            change_texts = []
            if room_before.name != room_after.name:
                change_texts.append("renamed")
            if match.overlap != 1:
                change_texts.append(f"{match.overlap:.1%} of their cells are common")
            if change_texts:
                rows.append(
                    ("; ".join(change_texts), describe_room(room_before), describe_room(room_after))
                )
    rows += [(ONLY_IN_FIRST, describe_room(room), "") for room in first_rooms.values()]
    rows += [(ONLY_IN_SECOND, "", describe_room(room)) for room in second_rooms.values()]
    return rows


def read_settings(grid: NavGrid) -> dict[str, str]:
    """Return a grid's settings as a flat mapping: path of a setting -> its value as text.

    A path is, for example, ``settings.agent.radius``. The scene's digest, the agent's radius, the
    inflations and the cells' size are among the settings.
    """
    return flatten_json(
        {
            "settings": grid.navbake.get("settings"),
            "sceneDigest": grid.navbake.get("sceneDigest"),
            "radius": f"{grid.agent_radius:g} m",
            "inflation": grid.metadata.get("inflation"),
            "cell size": f"{grid.cell_size * grid.unit:g} m",
        }
    )


def list_differences(
    first_values: Mapping[str, str], second_values: Mapping[str, str]
) -> list[DifferenceRow]:
    """List the entries that only one of two mappings has, or that have different values.

    Args:
        first_values: key -> value in the first grid, as text.
        second_values: key -> value in the second grid, as text.

    Returns:
        Rows of key, first value and second value, sorted by key; ``""`` for a missing value.
    """
    keys = sorted(
        key
        for key in first_values.keys() | second_values.keys()
        if first_values.get(key) != second_values.get(key)
    )
    return [(key, first_values.get(key, ""), second_values.get(key, "")) for key in keys]


def flatten_json(json_value: object, path: str = "") -> dict[str, str]:
    """Flatten nested JSON objects into one mapping of paths to texts.

    Args:
        json_value: an object, a list or a scalar. A list without objects becomes one text.
        path: the path of `json_value` itself; the paths of its entries begin with it.

    Returns:
        Path, such as ``scene.sites.0`` -> value as text; null is left out.
    """
    if isinstance(json_value, list) and any(isinstance(entry, dict) for entry in json_value):
        json_value = dict(enumerate(json_value))
    if not isinstance(json_value, dict):
        return {} if json_value is None else {path: str(json_value)}
    flat_entries: dict[str, str] = {}
    for entry_key, entry in json_value.items():
        flat_entries |= flatten_json(entry, f"{path}.{entry_key}" if path else str(entry_key))
    return flat_entries
