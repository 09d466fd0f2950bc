"""What the checks of an audit look at, layers in metres and what is connected; what they yield."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from itertools import permutations
from typing import Any

import numpy as np
from scipy.ndimage import label
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from navbake.errors import FormatError, count_of, shorten
from navbake.navgrid.grid import GridBase, SceneGrid2D
from navbake.navgrid.lattice import FARTHEST
from navbake.navgrid.rooms import Door, Room
from navbake.types import Bool, Float, Int, Int32, Json, Vector3

ERROR = "error"
REMARK = "remark"
Found = tuple[str, int | None, Vector3 | None, str]
"""What a check yields: severity, level, place and text of a `Remark`."""
MODES = ("exact", "minos")
MOST_INFLATED = 10_000.0  # the largest radius, and the largest clearance [m]
SLACK = 1e-6  # metres that a step may be over the highest one


DOWN = (np.s_[:-1], np.s_[1:])
RIGHT = (np.s_[:, :-1], np.s_[:, 1:])
"""Where the cells of an array stand that have one below, or to the right; and where these stand."""


@dataclass(frozen=True)
class Remark:
    """One thing that a person would notice."""

    check: str  # what it is about, in a word or two
    severity: str  # ERROR for what can't be right, REMARK for what may be meant
    level: int | None  # 0 is the lowest; None for the whole grid
    place: Vector3 | None  # world x, y, z [m]; None where no place is meant
    text: str  # what it is, in words

    def __str__(self) -> str:
        """One line: how bad, where, what."""
        where = "" if self.level is None else f"level {self.level}"
        if self.place is not None:
            where += " ({:.2f}, {:.2f}, {:.2f})".format(*self.place)
        return f"{self.severity}: {where.strip()}{': ' if where else ''}{self.text}"

    def to_json(self) -> Json:
        """The remark as JSON."""
        place = None if self.place is None else [round(v, 6) for v in self.place]
        return {**vars(self), "place": place}


@dataclass
class AuditReport:
    """All remarks on a grid."""

    scene_id: str | None
    remarks: list[Remark] = field(default_factory=list)  # errors first
    checks: list[str] = field(default_factory=list)  # that ran

    @property
    def errors(self) -> list[Remark]:
        """The remarks that can't be right."""
        return [remark for remark in self.remarks if remark.severity == ERROR]

    @property
    def ok(self) -> bool:
        """Whether there are no errors."""
        return not self.errors

    def to_json(self) -> Json:
        """The report as JSON."""
        return {
            "ok": self.ok,
            "sceneId": self.scene_id,
            "checks": list(self.checks),
            "remarks": [remark.to_json() for remark in self.remarks],
        }


def number_islands(
    masks: list[Bool], floors: list[Float], limit: float, links: Int, ways: Int | None = None
) -> list[Int32]:
    """Number the connected parts of all levels' marked cells from 1, the largest first; 0 for none.

    Neighbours by an edge hang together unless their floors lie more than a limit [m] apart, and so
    do the ends of a link (level, cell, level, cell), shape (n, 4), and what `ways`, of the same
    shape, join in both directions. It shares no code with a bake. Of parts of one size, that with
    the lowest cell comes first.
    """
    parts = list[Int32]()
    count = 1
    for mask, floor in zip(masks, floors, strict=True):
        both = [mask[one] & mask[other] for one, other in (DOWN, RIGHT)]
        with np.errstate(invalid="ignore"):  # floors that are infinite are told as such
            steps = [np.abs(floor[one] - floor[other]) > limit for one, other in (DOWN, RIGHT)]
        joints = mask
        stride = 1
        if any((pair & step).any() for pair, step in zip(both, steps, strict=True)):
            joints = np.zeros(2 * np.array(mask.shape) - 1, dtype=np.bool_)
            stride = 2
            joints[::2, ::2] = mask
            joints[1::2, ::2] = both[0] & ~steps[0]
            joints[::2, 1::2] = both[1] & ~steps[1]
        part, num = label(joints, output=np.int32)
        part = np.ascontiguousarray(part[::stride, ::stride])
        part[mask] += count - 1
        parts.append(part)
        count += num
    both_ways = np.concatenate([links, links[:, [2, 3, 0, 1]], links[:0] if ways is None else ways])
    ends = np.zeros((2, len(both_ways)), dtype=np.int64)
    for number, part in enumerate(parts):
        for end, (level, cell) in zip(ends, (both_ways[:, :2].T, both_ways[:, 2:].T), strict=True):
            end[level == number] = part.ravel()[cell[level == number]]
    ends = ends[:, (ends > 0).all(axis=0)]  # a blocked end joins nothing
    pairs = coo_array((np.ones(ends.shape[1]), tuple(ends)), shape=(count, count))
    num, group = connected_components(pairs, connection="strong")
    first = np.unique(group, return_index=True)[1]
    group = np.argsort(np.argsort(first))[group]  # numbered by their first parts
    size = np.sum([np.bincount(group[part.ravel()], minlength=num) for part in parts], axis=0)
    numbers = np.zeros(num, dtype=np.int32)  # 0 stays the one of no part
    numbers[1 + np.argsort(-size[1:], kind="stable")] = np.arange(1, num)
    return [numbers[group][part] for part in parts]


def read_inflations(grid: GridBase) -> tuple[list[Json], str | None]:
    """What a grid was inflated for; and what is wrong with the first entry that can't be read.

    Entries have a ``mode``, ``radius`` and ``clearance`` [m].
    """
    stated = grid.metadata.get("inflation", [])
    if not isinstance(stated, list):
        return [], f"`inflation` is {stated!r}, expected a list of what was done"
    done = list[Json]()
    broken = None
    for number, entry in enumerate(stated):
        known = entry if isinstance(entry, dict) and entry.get("mode") in MODES else {}
        lengths = {"radius": known.get("radius"), "clearance": known.get("clearance", 0)}
        if all(is_within(length, 0, MOST_INFLATED) for length in lengths.values()):
            done.append({"mode": known["mode"], **lengths})
        elif broken is None:
            broken = f"`inflation[{number}]` is {entry!r}, expected its radius [m] and mode"
    return done, broken


def is_within(value: Any, least: float, most: float) -> bool:
    """Whether something is a number in a range."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and least <= value <= most


def find_wrong_sizes(grid: GridBase) -> dict[str, str]:
    """What is wrong with the sizes of an agent that a grid states, by their keys."""
    wrong = {}
    for key, least, expected in (
        ("agentHeight", math.ulp(0.0), "> 0"),
        ("agentRadius", 0.0, ">= 0"),
        ("traversableFloorHeight", 0.0, ">= 0"),
    ):
        stated = grid.metadata.get(key)
        if stated is not None and not is_within(stated, least, FARTHEST / grid.unit):
            wrong[key] = f"`{key}` is {shorten(repr(stated))}, which is no length {expected}"
    if not wrong and grid.max_step >= grid.agent_height:
        sizes = grid.agent_height, grid.max_step
        wrong["step"] = "the agent of {:g} m takes steps of {:g} m".format(*sizes)
    return wrong


class Facts:
    """Layers and parts of a grid without its blocks.

    Tables that are broken count as empty, and `rooms` are None then: checks report them.
    """

    def __init__(self, grid: GridBase) -> None:
        self.grid: GridBase = grid.without_blocks()
        self.levels: list[SceneGrid2D] = self.grid.levels
        self.free: list[Bool] = [level.free for level in self.levels]
        self.floors: list[Float] = [level.floor for level in self.levels]  # NaN for none [m]
        stated = self.grid.navbake.get("settings")
        self.settings: Json = stated if isinstance(stated, dict) else {}
        self.doors: tuple[Door, ...] = ()
        self.rooms: tuple[Room, ...] | None = None
        self.links: Int = np.empty((0, 4), dtype=np.int64)  # steps between levels
        with suppress(FormatError):
            self.doors = self.grid.doors
        with suppress(FormatError):
            self.rooms = self.grid.rooms
        with suppress(FormatError):
            self.links = self.grid.step_array
        self.ways: Int = np.empty((0, 4), dtype=np.int64)  # over open links, from stop to stop
        with suppress(FormatError):
            passages = [
                (one.level, one.cell, other.level, other.cell)
                for link in self.grid.links
                if link.state == "open" and (link.width or np.inf) + SLACK >= 2 * self.grid.radius
                for one, other in permutations(link.stops, 2)
                if not link.one_way or link.stops.index(one) < link.stops.index(other)
            ]
            self.ways = np.array(passages, dtype=np.int64).reshape(-1, 4)
        self.barred: list[int] = []  # numbers of areas where nobody goes
        with suppress(FormatError):
            self.barred = [k for k, area in enumerate(self.grid.areas, 1) if area.bars(None)]

    @cached_property
    def step_limit(self) -> float:
        """How far apart floors of one walk may be: a step, and what float32 rounds off [m]."""
        highest = max(float(np.nanmax(np.abs(floor), initial=0)) for floor in self.floors)
        rounding = float(np.spacing(np.float32(min(highest, FARTHEST))))
        return self.grid.max_step + SLACK + rounding

    @cached_property
    def reach(self) -> float | None:
        """How far from the centre of a cell that an inflation closed the cause may be [m].

        The radius and clearance, the largest of several inflations; None without any.
        """
        done, _ = read_inflations(self.grid)
        return max((float(one["radius"] + one["clearance"]) for one in done), default=None)

    def cells_of(self, doors: list[tuple[Door, str]]) -> list[Bool]:
        """The cells of each level that doors block in some states."""
        masks = [np.zeros(level.shape, dtype=np.bool_) for level in self.levels]
        for door, state in doors:
            for mask, cells in zip(masks, door.cells_in(state, len(masks)), strict=True):
                mask.ravel()[cells] = True
        return masks

    @cached_property
    def passable(self) -> list[Bool]:
        """The cells that are free, or would be without doors."""
        doors = self.cells_of([(door, state) for door in self.doors for state in door.cells])
        return [free | door for free, door in zip(self.free, doors, strict=True)]

    @cached_property
    def islands(self) -> list[Int32]:
        """The connected parts of the free cells, numbered from 1, the largest first; 0 for none."""
        return self._number(self.free)

    @cached_property
    def open_islands(self) -> list[Int32]:
        """The same, if no door blocked anything."""
        return self._number(self.passable)

    @cached_property
    def walks(self) -> list[Int32]:
        """The islands if there were no named links."""
        return number_islands(self.free, self.floors, self.step_limit, self.links)

    def _number(self, masks: list[Bool]) -> list[Int32]:
        if self.barred:
            pairs = zip(masks, self.levels, strict=True)
            masks = [mask & ~np.isin(level.area_index, self.barred) for mask, level in pairs]
        return number_islands(masks, self.floors, self.step_limit, self.links, self.ways)

    def place(self, number: int, row: int, col: int) -> Vector3:
        """World x, y and z of a cell; its level's ground where its floor is at no height [m]."""
        level = self.levels[number]
        x, y = level.lattice.positions(row, col).tolist()
        z = float(self.floors[number][row, col])
        return x, y, z if np.isfinite(z) else level.ground

    def first(self, number: int, mask: Bool) -> Vector3:
        """The place of the first marked cell of a level."""
        row, col = np.unravel_index(int(np.argmax(mask)), mask.shape)
        return self.place(number, int(row), int(col))

    def on_cells(self, number: int, mask: Bool, what: str) -> Iterator[Found]:
        """One error on all marked cells of a level, with the place of the first; none on none."""
        count = int(np.count_nonzero(mask))
        if count:
            verb = ("have", "has") if what.startswith("a ") else ("are", "is")
            text = f"{count_of(count, 'cell')} {verb[count == 1]} {what}"
            yield ERROR, number, self.first(number, mask), text
