"""What the checks of an audit read (a grid's layers and islands), and the findings they yield."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from itertools import permutations
from typing import NamedTuple

import numpy as np
from scipy.ndimage import label
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from navbake.errors import FormatError, count_of, shorten
from navbake.navgrid.grid import GridBase, SceneGrid2D
from navbake.navgrid.lattice import MAX_COORDINATE
from navbake.navgrid.rooms import Door, Room
from navbake.types import Bool, Float, Int, Int32, Json, Vector3

ERROR = "error"
REMARK = "remark"
INFLATION_MODES = ("exact", "minos")
MAX_INFLATION = 10_000.0  # the largest radius, and the largest clearance [m]
STEP_SLACK = 1e-6  # by which a step may exceed the agent's highest step [m]

ABOVE_AND_BELOW = (np.s_[:-1], np.s_[1:])
"""Two slices of an array: all rows but the last, and for each of their cells the cell below."""
LEFT_AND_RIGHT = (np.s_[:, :-1], np.s_[:, 1:])
"""Two slices of an array: all columns but the last, and for each of their cells the next one."""


class Finding(NamedTuple):
    """A fault that a check yields. `Remark` adds the name of the check."""

    severity: str  # ERROR or REMARK
    level: int | None  # 0 is the lowest; None for the whole grid
    place: Vector3 | None  # world x, y, z [m]; None if it is about no single place
    text: str  # what is wrong


@dataclass(frozen=True)
class Remark:
    """One fault of a grid, or of a graph of routes, that a person would notice."""

    check: str  # what it is about, in a word or two
    severity: str  # ERROR for what can't be right, REMARK for what may be meant
    level: int | None  # 0 is the lowest; None for the whole grid
    place: Vector3 | None  # world x, y, z [m]; None if it is about no single place
    text: str  # what is wrong

    def __str__(self) -> str:
        """Return the remark on one line: severity, place and text."""
        where = "" if self.level is None else f"level {self.level}"
        if self.place is not None:
            where += " ({:.2f}, {:.2f}, {:.2f})".format(*self.place)
        return f"{self.severity}: {where.strip()}{': ' if where else ''}{self.text}"

    def to_json(self) -> Json:
        """Return the remark as a JSON object."""
        place = None if self.place is None else [round(v, 6) for v in self.place]
        return {**vars(self), "place": place}


@dataclass
class AuditReport:
    """All remarks on a grid, or on a graph of routes."""

    scene_id: str | None
    remarks: list[Remark] = field(default_factory=list)  # errors first
    checks: list[str] = field(default_factory=list)  # what the checks that ran look for

    @property
    def errors(self) -> list[Remark]:
        """The remarks that are errors: what they describe can't be right."""
        return [remark for remark in self.remarks if remark.severity == ERROR]

    @property
    def ok(self) -> bool:
        """Whether there are no errors."""
        return not self.errors

    def to_json(self) -> Json:
        """Return the report as a JSON object."""
        return {
            "ok": self.ok,
            "sceneId": self.scene_id,
            "checks": list(self.checks),
            "remarks": [remark.to_json() for remark in self.remarks],
        }


def number_islands(
    masks: list[Bool],
    floors: list[Float],
    step_limit: float,
    links: Int,
    one_way_links: Int | None = None,
) -> list[Int32]:
    """Number the connected components of all levels' marked cells.

    This shares no code with the bake. Cells that share an edge are connected unless their floors
    lie more than a step apart.

    Args:
        masks: the marked cells of each level, shape (height, width).
        floors: the floor of each cell of each level, shape (height, width) [m]; NaN for none.
        step_limit: how far the floors of connected neighbours may lie apart [m].
        links: links that connect both ways: level and cell of both ends, shape (n, 4).
        one_way_links: links that lead from their first end to their second end only, shape (n, 4).
            They connect two cells if they lead, one after the other, from each to the other.

    Returns:
        The island of each cell of each level, numbered from 1 by descending size; 0 for unmarked
        cells. Among islands of equal size, the one with the lowest level and cell id comes first.
    """
    labels = list[Int32]()
    num_labels = 1
    for mask, floor in zip(masks, floors, strict=True):
        level_labels, count = _label_walkable(mask, floor, step_limit)
        level_labels[mask] += num_labels - 1
        labels.append(level_labels)
        num_labels += count
    connections = [links, links[:, [2, 3, 0, 1]]]
    if one_way_links is not None:
        connections.append(one_way_links)
    level_cells = np.concatenate(connections).T
    ends = np.zeros((2, level_cells.shape[1]), dtype=np.int64)
    for end, (level, cell) in zip(ends, (level_cells[:2], level_cells[2:]), strict=True):
        for number, level_labels in enumerate(labels):
            on_level = level == number
            end[on_level] = level_labels.ravel()[cell[on_level]]
    ends = ends[:, (ends > 0).all(axis=0)]  # a blocked end connects nothing
    graph = coo_array((np.ones(ends.shape[1]), tuple(ends)), shape=(num_labels, num_labels))
    num_groups, group = connected_components(graph, connection="strong")
    # groups are numbered by their first labels
    first_label = np.unique(group, return_index=True)[1]
    group = np.argsort(np.argsort(first_label))[group]
    sizes = [np.bincount(group[part.ravel()], minlength=num_groups) for part in labels]
    size = np.sum(sizes, axis=0)
    island = np.zeros(num_groups, dtype=np.int32)  # group 0, the unmarked cells, stays 0
    island[1 + np.argsort(-size[1:], kind="stable")] = np.arange(1, num_groups)
    return [island[group][level_labels] for level_labels in labels]


def _label_walkable(mask: Bool, floor: Float, step_limit: float) -> tuple[Int32, int]:
    """Label a level's marked cells by what steps connect; return the labels and their count."""
    pairs = []  # masks: a cell and its lower neighbour, or its right one, are both marked
    is_step = []  # masks: the floors of both are at most a step apart
    for cells, neighbors in (ABOVE_AND_BELOW, LEFT_AND_RIGHT):
        pairs.append(mask[cells] & mask[neighbors])
        with np.errstate(invalid="ignore"):  # another check reports infinite floors
            is_step.append(~(np.abs(floor[cells] - floor[neighbors]) > step_limit))
    if all((step | ~pair).all() for pair, step in zip(pairs, is_step, strict=True)):
        labels, count = label(mask, output=np.int32)
        return np.ascontiguousarray(labels), count
    # an array with an entry for each cell, and one between neighbours for the passage between them
    passages = np.zeros(2 * np.array(mask.shape) - 1, dtype=np.bool_)
    passages[::2, ::2] = mask
    passages[1::2, ::2] = pairs[0] & is_step[0]
    passages[::2, 1::2] = pairs[1] & is_step[1]
    labels, count = label(passages, output=np.int32)
    return np.ascontiguousarray(labels[::2, ::2]), count


def read_inflations(grid: GridBase) -> tuple[list[Json], str | None]:
    """Read from a grid's metadata how it was inflated.

    Args:
        grid: a grid of any program.

    Returns:
        The inflations, each with ``mode``, and ``radius`` and ``clearance`` [m]; and a message
        about the first entry that can't be read, None if all can.
    """
    entries = grid.metadata.get("inflation", [])
    if not isinstance(entries, list):
        return [], f"`inflation` is {entries!r}, expected a list of what was done"
    inflations = list[Json]()
    problem = None
    for number, entry in enumerate(entries):
        has_mode = isinstance(entry, dict) and entry.get("mode") in INFLATION_MODES
        fields = entry if has_mode else {}
        lengths = {"radius": fields.get("radius"), "clearance": fields.get("clearance", 0)}
        if all(is_within(length, 0, MAX_INFLATION) for length in lengths.values()):
            inflations.append({"mode": fields["mode"], **lengths})
        elif problem is None:
            problem = f"`inflation[{number}]` is {entry!r}, expected its radius [m] and mode"
    return inflations, problem


def is_within(value: object, least: float, most: float) -> bool:
    """Return whether a value is a number from `least` to `most`; a bool is no number."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return least <= value <= most


def find_wrong_sizes(grid: GridBase) -> dict[str, str]:
    """Return what is wrong with the agent's sizes in a grid's metadata.

    Returns:
        Key of the metadata, such as ``agentHeight`` -> message. The key ``step`` has a message if
        the agent's step is at least as high as the agent. Empty if nothing is wrong.
    """
    problems = {}
    for key, least, expected in (
        ("agentHeight", math.ulp(0.0), "> 0"),
        ("agentRadius", 0.0, ">= 0"),
        ("traversableFloorHeight", 0.0, ">= 0"),
    ):
        length = grid.metadata.get(key)
        if length is not None and not is_within(length, least, MAX_COORDINATE / grid.unit):
            problems[key] = f"`{key}` is {shorten(repr(length))}, which is no length {expected}"
    if not problems and grid.max_step >= grid.agent_height:
        steps = f"takes steps of {grid.max_step:g} m"
        problems["step"] = f"the agent of {grid.agent_height:g} m {steps}"
    return problems


class Facts:
    """The layers, tables and islands of a grid, without obstacles that were added to it.

    Broken tables count as empty (`rooms` as None); checks report them.

    Attributes:
        grid: the grid without added obstacles.
        levels: the grid's levels, lowest first.
        free: for each level, a mask of the free cells, shape (height, width).
        floors: for each level, the height of each cell's floor, shape (height, width) [m]; NaN for
            none.
        settings: the settings of the bake; empty for grids of other programs.
        doors: the grid's doors.
        rooms: the grid's rooms; None if their table is broken.
        links: the grid's `step_array`: level and cell of both ends of each step, shape (n, 4).
        passages: directed connections over open named links through which the agent fits: level and
            cell of the first and of the last stop, shape (n, 4).
        forbidden_areas: the numbers of the areas that no agent may enter.
    """

    def __init__(self, grid: GridBase) -> None:
        self.grid: GridBase = grid.without_obstacles()
        self.levels: list[SceneGrid2D] = self.grid.levels
        self.free: list[Bool] = [level.free for level in self.levels]
        self.floors: list[Float] = [level.floor for level in self.levels]
        settings = self.grid.navbake.get("settings")
        self.settings: Json = settings if isinstance(settings, dict) else {}
        self.doors: tuple[Door, ...] = ()
        self.rooms: tuple[Room, ...] | None = None
        self.links: Int = np.empty((0, 4), dtype=np.int64)
        with suppress(FormatError):
            self.doors = self.grid.doors
        with suppress(FormatError):
            self.rooms = self.grid.rooms
        with suppress(FormatError):
            self.links = self.grid.step_array
        self.passages: Int = np.empty((0, 4), dtype=np.int64)
        with suppress(FormatError):
            self.passages = self._list_passages()
        self.forbidden_areas: list[int] = []
        with suppress(FormatError):
            self.forbidden_areas = [
                number for number, area in enumerate(self.grid.areas, 1) if area.bars(None)
            ]

    def _list_passages(self) -> Int:
        """List the `passages`: each pair of stops that an open link leads between."""
        passages = []
        for link in self.grid.links:
            width = link.width or np.inf
            if link.state != "open" or width + STEP_SLACK < 2 * self.grid.radius:
                continue
            for start, end in permutations(range(len(link.stops)), 2):
                if link.one_way and end < start:
                    continue
                first = link.stops[start]
                last = link.stops[end]
                passages.append((first.level, first.cell, last.level, last.cell))
        return np.array(passages, dtype=np.int64).reshape(-1, 4)

    @cached_property
    def step_limit(self) -> float:
        """Largest height difference of connected floors [m]: a step, plus float32 rounding."""
        highest = max(float(np.nanmax(np.abs(floor), initial=0)) for floor in self.floors)
        rounding = float(np.spacing(np.float32(min(highest, MAX_COORDINATE))))
        return self.grid.max_step + STEP_SLACK + rounding

    @cached_property
    def inflation_reach(self) -> float | None:
        """Largest distance from a cell's centre at which an inflation looked for obstacles [m].

        That is the largest sum of an inflation's radius and clearance; None without an inflation.
        """
        inflations, _ = read_inflations(self.grid)
        reaches = [float(entry["radius"] + entry["clearance"]) for entry in inflations]
        return max(reaches, default=None)

    def cells_of(self, doors: list[tuple[Door, str]]) -> list[Bool]:
        """Return for each level a mask of the cells that doors block in the given states."""
        masks = [np.zeros(level.shape, dtype=np.bool_) for level in self.levels]
        for door, state in doors:
            for mask, cells in zip(masks, door.cells_in(state, len(masks)), strict=True):
                mask.ravel()[cells] = True
        return masks

    @cached_property
    def passable(self) -> list[Bool]:
        """For each level, a mask of the cells that are free or that a door blocks in any state."""
        all_states = [(door, state) for door in self.doors for state in door.cells]
        door_cells = self.cells_of(all_states)
        return [free | door for free, door in zip(self.free, door_cells, strict=True)]

    @cached_property
    def islands(self) -> list[Int32]:
        """For each level, the island of each cell: 1 is the largest; 0 for no island."""
        return self._number_islands(self.free)

    @cached_property
    def open_islands(self) -> list[Int32]:
        """For each level, the island of each cell, as if no door blocked anything."""
        return self._number_islands(self.passable)

    @cached_property
    def islands_without_links(self) -> list[Int32]:
        """For each level, the island of each cell, as if there were no named links."""
        return number_islands(self.free, self.floors, self.step_limit, self.links)

    def _number_islands(self, masks: list[Bool]) -> list[Int32]:
        """Number the islands of marked cells, except in areas that no agent may enter."""
        if self.forbidden_areas:
            masks = [
                mask & ~np.isin(level.area_index, self.forbidden_areas)
                for mask, level in zip(masks, self.levels, strict=True)
            ]
        return number_islands(masks, self.floors, self.step_limit, self.links, self.passages)

    def place(self, number: int, row: int, col: int) -> Vector3:
        """Return world x, y, z of a cell [m]; z is its floor, or the level's ground without one."""
        level = self.levels[number]
        x, y = level.lattice.positions(row, col).tolist()
        z = float(self.floors[number][row, col])
        return x, y, z if np.isfinite(z) else level.ground

    def first_place(self, number: int, mask: Bool) -> Vector3:
        """Return the position of the first marked cell of a level, world x, y and z [m]."""
        row, col = np.unravel_index(int(np.argmax(mask)), mask.shape)
        return self.place(number, int(row), int(col))

    def error_on_cells(self, number: int, mask: Bool, predicate: str) -> Iterator[Finding]:
        """Yield one error about all marked cells of a level; nothing if none is marked.

        The error is located at the first marked cell.

        Args:
            number: the level's index.
            mask: the wrong cells, shape (height, width).
            predicate: what is wrong, such as ``free by weight``. The message puts "3 cells are"
                before it, or "3 cells have" if it begins with the article "a".
        """
        count = int(np.count_nonzero(mask))
        if not count:
            return
        if predicate.startswith("a "):
            verb = "has" if count == 1 else "have"
        else:
            verb = "is" if count == 1 else "are"
        text = f"{count_of(count, 'cell')} {verb} {predicate}"
        yield Finding(ERROR, number, self.first_place(number, mask), text)
