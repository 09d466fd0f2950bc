"""The facts of a grid that an audit checks (its layers and islands), and the findings of checks."""

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
from navbake.lengths import format_length
from navbake.navgrid.grid import DEFAULT_STEP, GridBase, SceneGrid2D
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
            where += f" ({', '.join(map(format_length, self.place))})"
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
    checks: list[str] = field(default_factory=list)  # that ran, by `Remark.check`

    @property
    def errors(self) -> list[Remark]:
        """The remarks whose severity is ERROR."""
        return [remark for remark in self.remarks if remark.severity == ERROR]

    @property
    def ok(self) -> bool:
        """Whether there are no errors."""
        return not self.errors

    def to_json(self) -> Json:
        """Return the report as a JSON object."""
        return {
            "ok": self.ok,
            "scene_id": self.scene_id,
            "checks": list(self.checks),
            "remarks": [remark.to_json() for remark in self.remarks],
        }


def number_islands(
    masks_of_levels: list[Bool],
    floors: list[Float],
    step_limit: float,
    two_way_connections: Int,
    one_way_connections: Int | None = None,
) -> list[Int32]:
    """Number the connected components of all levels' marked cells.

    This shares no code with the bake. Cells that share an edge are connected unless their floors
    lie more than a step apart. Cells that can be reached only in one direction are on different
    islands: one-way connections join two cells only where a chain of connections also leads back
    (strongly connected components).

    Args:
        masks_of_levels: the marked cells of each level, shape (height, width).
        floors: the floor of each cell of each level, shape (height, width) [m]; NaN for none.
        step_limit: how far the floors of connected neighbours may lie apart [m].
        two_way_connections: connections that lead both ways: level and cell of both ends, shape
            (n, 4).
        one_way_connections: connections that lead from their first end to their second end only,
            shape (n, 4).

    Returns:
        The island of each cell of each level, numbered from 1 by descending size; 0 for unmarked
        cells. Among islands of equal size, the one with the lowest level and cell id comes first.
    """
    labels_of_levels = list[Int32]()
    num_labels = 1
    for is_marked, floor in zip(masks_of_levels, floors, strict=True):
        level_labels, num_level_labels = _label_walkable(is_marked, floor, step_limit)
        level_labels[is_marked] += num_labels - 1
        labels_of_levels.append(level_labels)
        num_labels += num_level_labels
    connection_arrays = [two_way_connections, two_way_connections[:, [2, 3, 0, 1]]]
    if one_way_connections is not None:
        connection_arrays.append(one_way_connections)
    connection_ends = np.concatenate(connection_arrays).T
    labels_of_ends = np.zeros((2, connection_ends.shape[1]), dtype=np.int64)
    for end_labels, (level_of_end, cell_ids) in zip(
        labels_of_ends, (connection_ends[:2], connection_ends[2:]), strict=True
    ):
        for level_number, level_labels in enumerate(labels_of_levels):
            is_on_level = level_of_end == level_number
            end_labels[is_on_level] = level_labels.ravel()[cell_ids[is_on_level]]
    labels_of_ends = labels_of_ends[
        :, (labels_of_ends > 0).all(axis=0)
    ]  # a blocked end connects nothing
    graph = coo_array(
        (np.ones(labels_of_ends.shape[1]), tuple(labels_of_ends)), shape=(num_labels, num_labels)
    )
    num_groups, group_of_label = connected_components(graph, connection="strong")
    # groups are numbered by their first labels
    first_label_of_group = np.unique(group_of_label, return_index=True)[1]
    group_of_label = np.argsort(np.argsort(first_label_of_group))[group_of_label]
    group_sizes_of_levels = [
        np.bincount(group_of_label[level_labels.ravel()], minlength=num_groups)
        for level_labels in labels_of_levels
    ]
    group_sizes = np.sum(group_sizes_of_levels, axis=0)
    island_of_group = np.zeros(num_groups, dtype=np.int32)  # group 0, the unmarked cells, stays 0
    island_of_group[1 + np.argsort(-group_sizes[1:], kind="stable")] = np.arange(1, num_groups)
    return [island_of_group[group_of_label][level_labels] for level_labels in labels_of_levels]


def _label_walkable(is_marked: Bool, floor: Float, step_limit: float) -> tuple[Int32, int]:
    """Label the connected components of a level's marked cells; return the labels and their number.

    Cells that share an edge are connected unless their floors lie more than a step apart.
    """
    are_both_marked = []  # masks: a cell and its lower neighbour, or its right one, are both marked
    is_within_step = []  # masks: the floors of both are at most a step apart
    for cell_slices, neighbor_slices in (ABOVE_AND_BELOW, LEFT_AND_RIGHT):
        are_both_marked.append(is_marked[cell_slices] & is_marked[neighbor_slices])
        with np.errstate(invalid="ignore"):  # another check reports infinite floors
            is_within_step.append(
                ~(np.abs(floor[cell_slices] - floor[neighbor_slices]) > step_limit)
            )
    if all(
        (within_step | ~both_marked).all()
        for both_marked, within_step in zip(are_both_marked, is_within_step, strict=True)
    ):
        labels, num_labels = label(is_marked, output=np.int32)
        return np.ascontiguousarray(labels), num_labels
    # an array with an entry for each cell, and one between neighbours for the passage between them
    is_passage = np.zeros(2 * np.array(is_marked.shape) - 1, dtype=np.bool_)
    is_passage[::2, ::2] = is_marked
    is_passage[1::2, ::2] = are_both_marked[0] & is_within_step[0]
    is_passage[::2, 1::2] = are_both_marked[1] & is_within_step[1]
    labels, num_labels = label(is_passage, output=np.int32)
    return np.ascontiguousarray(labels[::2, ::2]), num_labels


def read_inflations(grid: GridBase) -> tuple[list[Json], str | None]:
    """Read the inflations of a grid from its metadata.

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
    for index, inflation_entry in enumerate(entries):
        has_mode = (
            isinstance(inflation_entry, dict) and inflation_entry.get("mode") in INFLATION_MODES
        )
        entry_fields = inflation_entry if has_mode else {}
        lengths = {
            "radius": entry_fields.get("radius"),
            "clearance": entry_fields.get("clearance", 0),
        }
        if all(is_within(length, 0, MAX_INFLATION) for length in lengths.values()):
            inflations.append({"mode": entry_fields["mode"], **lengths})
        elif problem is None:
            problem = (
                f"`inflation[{index}]` is {inflation_entry!r}, expected its radius [m] and mode"
            )
    return inflations, problem


def is_within(value: object, minimum: float, maximum: float) -> bool:
    """Return whether a value is a number from `minimum` to `maximum`; a bool is no number."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return minimum <= value <= maximum


def find_wrong_sizes(grid: GridBase) -> dict[str, str]:
    """Return a message for each wrong size of the agent in a grid's metadata.

    Args:
        grid: a grid of any program.

    Returns:
        Key of the metadata, such as ``agentHeight`` -> message. The key ``step`` has a message if
        the agent's step is at least as high as the agent. Empty if nothing is wrong.
    """
    problems = {}
    for key, minimum, expected in (
        ("agentHeight", math.ulp(0.0), "> 0"),
        ("agentRadius", 0.0, ">= 0"),
        ("traversableFloorHeight", 0.0, ">= 0"),
    ):
        length = grid.metadata.get(key)
        if length is not None and not is_within(length, minimum, MAX_COORDINATE / grid.unit):
            problems[key] = f"`{key}` is {shorten(repr(length))}, which is no length {expected}"
    if not problems and grid.max_step >= grid.agent_height:
        steps_text = f"takes steps of {grid.max_step:g} m"
        problems["step"] = f"the agent of {grid.agent_height:g} m {steps_text}"
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
        steps: the grid's `step_array`: level and cell of both ends of each step, shape (n, 4).
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
        self.steps: Int = np.empty((0, 4), dtype=np.int64)
        with suppress(FormatError):
            self.doors = self.grid.doors
        with suppress(FormatError):
            self.rooms = self.grid.rooms
        with suppress(FormatError):
            self.steps = self.grid.step_array
        self.passages: Int = np.empty((0, 4), dtype=np.int64)
        with suppress(FormatError):
            self.passages = self._list_passages()
        self.forbidden_areas: list[int] = []
        with suppress(FormatError):
            self.forbidden_areas = [
                area_number
                for area_number, area in enumerate(self.grid.areas, 1)
                if area.bars(None)
            ]

    def _list_passages(self) -> Int:
        """List the `passages`: each pair of stops that an open link leads between."""
        passages = []
        for link in self.grid.links:
            max_diameter = link.width or np.inf
            if link.state != "open" or max_diameter + STEP_SLACK < 2 * self.grid.radius:
                continue
            for start_index, end_index in permutations(range(len(link.stops)), 2):
                if link.one_way and end_index < start_index:
                    continue
                first_stop = link.stops[start_index]
                last_stop = link.stops[end_index]
                passages.append(
                    (first_stop.level, first_stop.cell, last_stop.level, last_stop.cell)
                )
        return np.array(passages, dtype=np.int64).reshape(-1, 4)

    @cached_property
    def step_limit(self) -> float:
        """Largest height difference of connected floors [m]: a step, plus float32 rounding."""
        highest_floor = max(float(np.nanmax(np.abs(floor), initial=0)) for floor in self.floors)
        rounding = float(np.spacing(np.float32(min(highest_floor, MAX_COORDINATE))))
        return self.grid.max_step + STEP_SLACK + rounding

    @cached_property
    def has_lower_step(self) -> bool:
        """Whether the grid is for lower steps than its settings say that it was baked for.

        `PathFinder.grid` is so for an agent that takes lower steps.
        """
        agent_settings = self.settings.get("agent", {})
        if not self.settings or not isinstance(agent_settings, dict):
            return False
        baked_step = agent_settings.get("traversable_floor_height", DEFAULT_STEP)
        if type(baked_step) not in (int, float):
            return False
        return self.grid.max_step < baked_step and not math.isclose(self.grid.max_step, baked_step)

    @cached_property
    def inflation_reach(self) -> float | None:
        """Largest distance from a cell's centre at which an inflation looked for obstacles [m].

        That is the largest sum of an inflation's radius and clearance; None without an inflation.
        """
        inflations, _ = read_inflations(self.grid)
        reach_of_inflations = [
            float(inflation["radius"] + inflation["clearance"]) for inflation in inflations
        ]
        return max(reach_of_inflations, default=None)

    def mark_door_cells(self, doors: list[tuple[Door, str]]) -> list[Bool]:
        """Mark the cells of each level that doors block.

        Args:
            doors: pairs of a door and one of its states.

        Returns:
            For each level, a mask of the cells that any of these doors blocks in its state, shape
            (height, width).
        """
        masks = [np.zeros(level.shape, dtype=np.bool_) for level in self.levels]
        for door, state in doors:
            for mask, cells in zip(masks, door.cells_in(state, len(masks)), strict=True):
                mask.ravel()[cells] = True
        return masks

    @cached_property
    def passable(self) -> list[Bool]:
        """For each level, a mask of the cells that are free or that a door blocks in any state."""
        doors_and_states = [(door, state) for door in self.doors for state in door.cells]
        door_cells = self.mark_door_cells(doors_and_states)
        return [
            is_free | is_door_cell
            for is_free, is_door_cell in zip(self.free, door_cells, strict=True)
        ]

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
        return number_islands(self.free, self.floors, self.step_limit, self.steps)

    def _number_islands(self, masks: list[Bool]) -> list[Int32]:
        """Number the islands of marked cells, except in areas that no agent may enter."""
        if self.forbidden_areas:
            masks = [
                mask & ~np.isin(level.area_index, self.forbidden_areas)
                for mask, level in zip(masks, self.levels, strict=True)
            ]
        return number_islands(masks, self.floors, self.step_limit, self.steps, self.passages)

    def find_position(self, level_number: int, row: int, col: int) -> Vector3:
        """Return world x, y, z of a cell [m]; z is its floor, or the level's ground without one."""
        level = self.levels[level_number]
        x, y = level.lattice.positions(row, col).tolist()
        z = float(self.floors[level_number][row, col])
        return x, y, z if np.isfinite(z) else level.ground

    def find_first_position(self, level_number: int, is_marked: Bool) -> Vector3:
        """Return the position of the first marked cell of a level, world x, y and z [m].

        Args:
            level_number: the level's index.
            is_marked: the marked cells, at least one, shape (height, width).
        """
        row, col = np.unravel_index(int(np.argmax(is_marked)), is_marked.shape)
        return self.find_position(level_number, int(row), int(col))

    def report_wrong_cells(
        self, level_number: int, is_wrong: Bool, predicate: str
    ) -> Iterator[Finding]:
        """Yield one error about all wrong cells of a level; nothing if none is wrong.

        The error is located at the first wrong cell.

        Args:
            level_number: the level's index.
            is_wrong: the wrong cells, shape (height, width).
            predicate: the fault, such as ``free by weight``. The message puts "3 cells are"
                before it, or "3 cells have" if it begins with the article "a".
        """
        num_wrong = int(np.count_nonzero(is_wrong))
        if not num_wrong:
            return
        if predicate.startswith("a "):
            verb = "has" if num_wrong == 1 else "have"
        else:
            verb = "is" if num_wrong == 1 else "are"
        text = f"{count_of(num_wrong, 'cell')} {verb} {predicate}"
        yield Finding(ERROR, level_number, self.find_first_position(level_number, is_wrong), text)
