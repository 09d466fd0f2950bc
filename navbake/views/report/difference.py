"""What differs between two grids: cell by cell, and in their rooms, doors and settings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.navgrid.colors import rgb_of
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.rooms import Room
from navbake.types import Bool, Float, Int, Json
from navbake.views.page.page import pack, table
from navbake.views.report.maps import describe_place, thinning, to_png

MOST_APART = 1.5  # of the grounds of two levels that are taken for the same storey [m]
MOST_ADDED = 4  # times the cells of two levels that a lattice over both may have, and
ALWAYS = 4_000_000  # as many cells at least
SAME_FLOOR = 1e-3  # by how much floors differ that are taken for the same [m]

# what became of a cell, in the order of what a reader wants to know first; colours are told apart
# by hue and by lightness, whatever colours one sees
CHANGE_COLORS = {
    "became free": "#009e73",
    "became blocked": "#d55e00",
    "floor moved": "#0072b2",
    "other room": "#cc79a7",
    "other weight": "#e69f00",
    "only in the first": "#6f5f4f",
    "only in the second": "#56b4e9",
}
ALIKE_COLORS = {
    "free in both": "#f7f3e8",
    "blocked in both": "#9aa2b1",
    "no floor in both": "#d9dde3",
}
CHANGES, ALIKE = tuple(CHANGE_COLORS), tuple(ALIKE_COLORS)
COLORS = CHANGE_COLORS | ALIKE_COLORS

Row = tuple[str, str, str]
"""What differs, and how the first and the second grid have it."""


def describe_changes(first: NavGrid, second: NavGrid, names: Sequence[str]) -> Json:
    """The sheet of two grids' difference, as a report has one of a grid."""
    pairs = match_levels(first, second)
    levels = [compare_levels(first.levels[i], second.levels[j], (i, j)) for i, j in pairs]
    columns = ("what", *names)
    cells = [
        (
            first.level_names[level.first],
            second.level_names[level.second],
            *(level.counts().get(name, 0) for name in CHANGES),
        )
        for level in levels
    ]
    alone = [
        ("only in the first", name, "")
        for number, name in enumerate(first.level_names)
        if number not in [level.first for level in levels]
    ] + [
        ("only in the second", "", name)
        for number, name in enumerate(second.level_names)
        if number not in [level.second for level in levels]
    ]
    num_changed = sum(sum(level.counts().values()) for level in levels)
    areas = [
        sum(np.count_nonzero(level.free) * level.lattice.cell_size**2 for level in grid.levels)
        for grid in (first, second)
    ]
    area = f"{areas[0]:.2f} to {areas[1]:.2f} m² ({areas[1] - areas[0]:+.2f})"
    tables = [
        table("Cells that changed", (*names, *CHANGES), cells, numbers=range(2, 2 + len(CHANGES))),
        table("Levels that only one has", columns, alone),
        table("Rooms that changed", columns, list_rooms(first, second, levels)),
        table("Doors that changed", columns, list_doors(first, second)),
        table("Settings that changed", columns, list_settings(first, second)),
    ]
    warnings = []
    if first.scene_id != second.scene_id:
        warnings.append(f"the scenes differ: {first.scene_id!r} and {second.scene_id!r}")
    ours, theirs = (grid.levels[0].lattice.cell_size for grid in (first, second))
    if abs(ours - theirs) > 1e-9:
        warnings.append(
            f"cells of {ours:g} m are compared with the cells of {theirs:g} m "
            "in which their centres lie"
        )
    return {
        "name": "difference",
        "facts": [
            ("first", names[0]),
            ("second", names[1]),
            ("cells that changed", f"{num_changed:,}"),
            *(("free area", area) for _ in levels[:1]),
        ],
        "warnings": warnings,
        "levels": [_show_level(first, second, level) for level in levels],
        "tables": [made for made in tables if made["rows"]],
    }


def _show_level(first: NavGrid, second: NavGrid, level: LevelDifference) -> Json:
    every = max(thinning(first.levels[level.first]), thinning(second.levels[level.second]))
    change = level.change[::every, ::every]
    colors = np.array([rgb_of(color) for color in COLORS.values()], dtype=np.uint8)
    there = np.bincount(change.ravel(), minlength=len(COLORS)) > 0
    legend = [entry for entry, is_there in zip(COLORS.items(), there, strict=True) if is_there]
    ours, theirs = first.level_names[level.first], second.level_names[level.second]
    layer: Json = {"name": "changes", "title": "", "png": to_png(colors[change]), "legend": legend}
    return {
        **describe_place(ours if ours == theirs else f"{ours} / {theirs}", level.lattice),
        "every": every,
        "of": [[0, level.first], [1, level.second]],
        "change": pack(change.astype(np.int64)),
        "kinds": [*COLORS],
        "layers": [{**layer, "scale": None, "labels": [], "doors": []}],
        "marks": [],
    }


class LevelDifference(NamedTuple):
    """How a level of the first grid and one of the second differ.

    Attributes:
        first, second: their numbers.
        lattice: the cells of the first one's lattice that cover both.
        change: what became of each cell: the number of its entry in `CHANGES` + `ALIKE`, uint8.
        rooms: pairs of rooms that are the same, and their intersection over union.
    """

    first: int
    second: int
    lattice: Lattice
    change: NDArray[np.uint8]
    rooms: list[tuple[int, int, float]]

    def counts(self) -> dict[str, int]:
        """Cells by what became of them, for the changes that there are."""
        count = np.bincount(self.change.ravel(), minlength=len(CHANGES))
        return {name: int(count[i]) for i, name in enumerate(CHANGES) if count[i]}


def match_levels(first: NavGrid, second: NavGrid) -> list[tuple[int, int]]:
    """Pair the levels of two grids whose grounds are the nearest, at most `MOST_APART` apart.

    Levels that lie too far from each other to be drawn together are no pair; see `MOST_ADDED`.
    """
    apart = [
        (abs(one.ground - other.ground), i, j)
        for i, one in enumerate(first.levels)
        for j, other in enumerate(second.levels)
    ]
    pairs: list[tuple[int, int]] = []
    for distance, i, j in sorted(apart):
        taken = any(i == a or j == b for a, b in pairs)
        if distance <= MOST_APART and not taken and _are_near(first.levels[i], second.levels[j]):
            pairs.append((i, j))
    return sorted(pairs)


def _are_near(first: SceneGrid2D, second: SceneGrid2D) -> bool:
    """Whether a lattice over both has not far more cells than they have."""
    both = _cover_both(first.lattice, second.lattice)
    own = first.weights.size + second.weights.size
    return both.width * both.height <= max(ALWAYS, MOST_ADDED * own)


def compare_levels(
    first: SceneGrid2D, second: SceneGrid2D, pair: tuple[int, int]
) -> LevelDifference:
    """Compare two levels at the centres of the first one's cells.

    Its lattice goes on beyond its edges as far as the second one reaches. So grids with cells of
    the same size that lie on each other are compared cell by cell, and others by the cell of the
    second that holds the centre.
    """
    lattice = _cover_both(first.lattice, second.lattice)
    one, other = _Sampled.of(first, lattice), _Sampled.of(second, lattice)
    rooms = _match_rooms(one.room, other.room)
    same_room = np.zeros(
        (int(one.room.max(initial=0)) + 1, int(other.room.max(initial=0)) + 1), bool
    )
    same_room[0, 0] = True
    for a, b, _ in rooms:
        same_room[a, b] = True
    # NaN, no floor, differs from every height, and not from itself
    moved = ~(np.abs(one.floor - other.floor) <= SAME_FLOOR)
    moved &= ~(np.isnan(one.floor) & np.isnan(other.floor))
    happened = (
        other.free & ~one.free & one.there,
        one.free & ~other.free & other.there,
        moved & one.there & other.there,
        ~same_room[one.room, other.room] & one.there & other.there,
        (one.weight != other.weight) & one.there & other.there,
        one.there & ~other.there & one.holds_anything,
        other.there & ~one.there & other.holds_anything,
        one.free,
        ~np.isnan(one.floor),
    )
    change = np.full(lattice.shape, len(CHANGES) + len(ALIKE) - 1, dtype=np.uint8)
    for number, mask in reversed(list(enumerate(happened))):
        change[mask] = number
    return LevelDifference(*pair, lattice, change, rooms)


class _Sampled(NamedTuple):
    """A level at the centres of a lattice's cells; arrays of the lattice's shape."""

    there: Bool  # whether the level has a cell there
    free: Bool
    floor: Float  # world z [m], NaN for none
    room: Int
    weight: Float

    @property
    def holds_anything(self) -> Bool:
        return np.asarray(self.free | ~np.isnan(self.floor))

    @classmethod
    def of(cls, level: SceneGrid2D, lattice: Lattice) -> _Sampled:
        own = level.lattice
        rows = np.floor((own.y_max - lattice.center_y()) / own.cell_size).astype(np.int64)
        cols = np.floor((lattice.center_x() - own.x_min) / own.cell_size).astype(np.int64)
        inside = ((rows >= 0) & (rows < own.height))[:, None] & ((cols >= 0) & (cols < own.width))
        at = np.ix_(np.clip(rows, 0, own.height - 1), np.clip(cols, 0, own.width - 1))
        return cls(
            there=inside,
            free=level.free[at] & inside,
            floor=np.where(inside, level.floor[at], np.nan),
            room=np.where(inside, level.room_index[at].astype(np.int64), 0),
            weight=np.where(inside, level.weights[at].astype(np.float64), np.inf),
        )


def _cover_both(lattice: Lattice, other: Lattice) -> Lattice:
    """The cells of a lattice, and as many more beside them as cover another one, too."""
    x0, y0, x1, y1 = other.bounds
    size = lattice.cell_size
    slack = 1e-6 * size  # of what lies on an edge but for rounding
    left = max(0, int(np.ceil((lattice.x_min - x0 - slack) / size)))
    top = max(0, int(np.ceil((y1 - lattice.y_max - slack) / size)))
    right = max(0, int(np.ceil((x1 - lattice.bounds[2] - slack) / size)))
    bottom = max(0, int(np.ceil((lattice.bounds[1] - y0 - slack) / size)))
    return Lattice(
        lattice.x_min - left * size,
        lattice.y_max + top * size,
        size,
        lattice.width + left + right,
        lattice.height + top + bottom,
    )


def _match_rooms(one: Int, other: Int) -> list[tuple[int, int, float]]:
    """Pair rooms each of which overlaps the other the most, with intersection over union."""
    num_one, num_other = int(one.max(initial=0)) + 1, int(other.max(initial=0)) + 1
    codes, counts = np.unique(one * num_other + other, return_counts=True)
    cells_one = np.bincount(one.ravel(), minlength=num_one)
    cells_other = np.bincount(other.ravel(), minlength=num_other)
    overlaps = []
    for code, count in zip(codes.tolist(), counts.tolist(), strict=True):
        a, b = divmod(code, num_other)
        if a and b:
            share = count / (int(cells_one[a]) + int(cells_other[b]) - count)
            overlaps.append((share, a, b))
    overlaps.sort(key=lambda found: (found[0], -found[1], -found[2]))
    best_of_one = {a: (b, share) for share, a, b in overlaps}
    best_of_other = {b: a for _, a, b in overlaps}
    return sorted((a, b, share) for a, (b, share) in best_of_one.items() if best_of_other[b] == a)


def list_rooms(first: NavGrid, second: NavGrid, levels: list[LevelDifference]) -> list[Row]:
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
    rows += [("only in the first", shown(room), "") for room in rooms[0].values()]
    return rows + [("only in the second", "", shown(room)) for room in rooms[1].values()]


def list_doors(first: NavGrid, second: NavGrid) -> list[Row]:
    """The doors that only one of two grids has, or that are in another state."""
    return _differing(*({door.id: door.state for door in grid.doors} for grid in (first, second)))


def list_settings(first: NavGrid, second: NavGrid) -> list[Row]:
    """The settings and digests that differ, by their path in the metadata."""
    return _differing(*(dict(flatten(_settings_of(grid))) for grid in (first, second)))


def _differing(one: dict[str, str], other: dict[str, str]) -> list[Row]:
    keys = sorted(one.keys() | other.keys())
    rows = [(key, one.get(key, ""), other.get(key, "")) for key in keys]
    return [row for row in rows if row[1] != row[2]]


def _settings_of(grid: NavGrid) -> Json:
    own: Json = {
        key: grid.navbake[key] for key in ("settings", "sceneDigest") if key in grid.navbake
    }
    facts = {"cell size": f"{grid.cell_size * grid.unit:g} m", "radius": f"{grid.agent_radius:g} m"}
    return {**own, **facts, "inflation": grid.metadata.get("inflation")}


def flatten(value: Any, path: str = "") -> list[tuple[str, str]]:
    """The values in nested objects, each with its path; lists of objects count from 0."""

    def walk(part: Any, path: str) -> Iterator[tuple[str, str]]:
        if isinstance(part, list) and any(isinstance(inner, dict) for inner in part):
            part = dict(enumerate(part))
        if isinstance(part, dict):
            for key, inner in part.items():
                yield from walk(inner, f"{path}.{key}" if path else str(key))
        elif part is not None:
            yield path, str(part)

    return list(walk(value, path))
