"""The agent and the inflation that a grid states, the cells that are looked at, their volumes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from navbake.auditor.facts import find_wrong_sizes, is_within, read_inflations
from navbake.errors import FormatError, QueryError, shorten
from navbake.navgrid.grid import GridBase, SceneGrid2D
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Int, Vector3
from navbake.verifier.probes import Column
from navbake.verifier.report import Finding

SLACK = 1e-5  # that rounding may add to a step [m]
TINY = 1e-10  # share of a radius by which a square only touches a disc; less than inflation takes


class AgentSizes(NamedTuple):
    """For whom the grid is: height, radius and step as baked [m]."""

    height: float
    radius: float
    step: float
    min_up: float  # least z of a floor's unit normal

    @classmethod
    def of(cls, grid: GridBase) -> AgentSizes:
        """The agent that a grid states, with the format's defaults for what it doesn't state."""
        wrong = list(find_wrong_sizes(grid).values())
        slope = grid.navbake.get("maxSlope", 45.0)
        if not is_within(slope, 0, 90):
            shown = shorten(repr(slope))
            wrong.append(f"`maxSlope` is {shown}, which is no slope of 0 to 90 degrees")
        if wrong:
            text = f"the grid's metadata: {wrong[0]}: cells can't be judged for such an agent"
            raise FormatError(text)
        min_up = float(np.cos(np.radians(slope)))
        return cls(grid.agent_height, grid.agent_radius, grid.max_step, min_up)


class Inflated(NamedTuple):
    """A grid as it is verified, and what was done to it for a larger agent."""

    grid: Any
    radius: float | None  # of the cylinder on free cells [m]; None for the baked footprint
    reach: float  # how far from a closed cell's centre the reason may be [m]
    by_centres: bool = False  # whether that is any occupied cell, as in the mode ``minos``


def inflate_for(grid: Any, radius: float | None, notes: list[str]) -> Inflated:
    """Inflate a grid for a radius [m]; it stays as it is if None. May add notes.

    One that was inflated for a larger radius, or in the mode ``minos``, is a QueryError.
    """
    done, broken = read_inflations(grid)
    if broken is not None:
        note = "the metadata's `inflation` isn't as navbake writes it"
        notes.append(f"{note}: what it closed has to touch something by itself")
    largest = max((float(one["radius"]) for one in done), default=0.0)
    if any(one["mode"] == "minos" for one in done):
        if radius is not None:
            raise QueryError(
                "the grid was inflated in the mode minos, whose cells promise nothing for a "
                "radius: leave the radius out, or give the grid as it was before"
            )
        note = "inflated in the mode minos, which measures from the centres of cells"
        notes.append(f"{note}: free cells are judged by the baked footprint")
        return Inflated(grid, None, largest, by_centres=True)
    if radius is None:
        return Inflated(grid, largest if done else None, largest)
    if radius < largest:
        raise QueryError(
            f"the grid was inflated for {largest:g} m, which can't be undone for {radius:g} m: "
            f"expected a radius of at least {largest:g} m, or the grid as it was before"
        )
    inflated = grid if done and radius == largest else grid.inflate(radius)
    return Inflated(inflated, radius, radius)


@dataclass(frozen=True)
class LevelSample:
    """Cells of one level, shape (n,)."""

    number: int
    level: SceneGrid2D
    rows: Int
    cols: Int
    xy: Float
    floor: Float  # NaN for none [m]
    free: Bool  # whether an agent can stand there
    occupied: Bool  # as the layer says; an inflation leaves it as baked
    states_floors: bool  # whether the grid states floors of cells; else all are at the ground

    def place(self, k: int) -> Vector3:
        """The centre of a cell, at its floor, or at the level's ground if it has none [m]."""
        x, y = self.xy[k].tolist()
        z = float(self.floor[k])
        return x, y, self.level.ground if np.isnan(z) else z

    def finding(
        self, kind: str, k: int, text: str, geom: str | None = None, size: float | None = None
    ) -> Finding:
        """A finding about one of the cells."""
        cell = int(self.rows[k]), int(self.cols[k])
        return Finding(kind, self.number, cell, self.place(k), text, geom, size)


def states_floors(level: SceneGrid2D) -> bool:
    """Whether cells of a level have floors of their own, not the ground that an inflation wrote."""
    if not level.uses_cell_floors or level.navbake or "inflation" not in level.metadata:
        return level.uses_cell_floors
    floors = level.floor_height[~np.isnan(level.floor_height)]
    return bool((floors != np.float32(level.min_yup[1])).any())


def take_sample(
    grid: GridBase, number: int | None, seed: int, with_floors: Sequence[bool]
) -> list[LevelSample]:
    """Draw cells of all levels, each as likely as any other; all of them if None.

    `with_floors` is what `states_floors` said of each level before the grid was inflated.
    """
    sizes = [level.width * level.height for level in grid.levels]
    chosen = np.arange(sum(sizes))
    start = np.cumsum([0, *sizes])
    if number is not None and number < len(chosen):
        chosen = np.sort(np.random.default_rng(seed).choice(len(chosen), number, replace=False))
    samples = []
    for k, (level, has_own) in enumerate(zip(grid.levels, with_floors, strict=True)):
        cells = chosen[(chosen >= start[k]) & (chosen < start[k + 1])] - start[k]
        rows, cols = np.divmod(cells, level.width)
        floor = level.floor_of(rows, cols) if has_own else np.full(len(cells), level.ground)
        xy = level.lattice.positions(rows, cols).reshape(-1, 2)
        free = level.free[rows, cols]
        occupied = level.occupancy[rows, cols] != 0
        samples.append(LevelSample(k, level, rows, cols, xy, floor, free, occupied, has_own))
    return samples


def shift_between(one: Lattice, two: Lattice) -> tuple[int, int]:
    """What to add to row and column of a cell on one lattice to have those on another."""
    down = two.y_max - one.y_max
    right = one.x_min - two.x_min
    return round(down / one.cell_size), round(right / one.cell_size)


class Neighbourhood:
    """The floors of all levels; cells are closed by what is occupied (`by_centres`) or solid."""

    def __init__(self, grid: GridBase, step: float, *, by_centres: bool = False) -> None:
        self._step = step
        self._lattices = [level.lattice for level in grid.levels]
        self._floors = [level.floor for level in grid.levels]
        # what is a reason has to be blocked itself, so that it is judged in its turn
        self._occupied = [
            (level.occupancy != 0) & ~level.free & (by_centres | (level.solid != 0))
            for level in grid.levels
        ]

    def floors_under(
        self, number: int, rows: Int, cols: Int, floor: Float, radius: float
    ) -> tuple[Float, Float]:
        """The lowest and highest floor within a step of a disc's own, of any level, (n,) [m]."""
        low = floor.copy()
        high = floor.copy()
        for _, there, *_ in self._around(number, rows, cols, radius):
            near = np.abs(there - floor) <= self._step + SLACK
            low = np.where(near, np.fmin(low, there), low)
            high = np.where(near, np.fmax(high, there), high)
        return low, high

    def has_reason(self, number: int, rows: Int, cols: Int, floor: Float, radius: float) -> Bool:
        """Whether a disc meets what may close its cell: an occupied square, an edge, a ledge.

        Beyond a single level nothing was baked, and nothing closes cells.
        """
        found = np.zeros(len(rows), dtype=np.bool_)
        for other, there, occupied, inside in self._around(number, rows, cols, radius):
            if other == number:
                is_ledge = ~(np.abs(there - floor) <= self._step - SLACK)
                found |= (occupied | is_ledge) & (inside | (len(self._lattices) > 1))
            else:
                found |= ~np.isnan(there) & (occupied | (there > floor + self._step))
        return found

    def _around(
        self, number: int, rows: Int, cols: Int, radius: float
    ) -> Iterator[tuple[int, Float, Bool, Bool]]:
        """What open discs round cells' centres meet, cell by cell: each level, and its `look`."""
        cell_size = self._lattices[number].cell_size
        reach = int(radius / cell_size + 0.5) + 1
        beyond = np.maximum(np.abs(np.arange(-reach, reach + 1)) - 0.5, 0.0) * cell_size
        is_met = np.hypot(beyond[:, None], beyond) < radius * (1 - TINY)
        for row, col in (np.argwhere(is_met) - reach).tolist():
            for other in range(len(self._lattices)):
                yield other, *self.look(number, other, rows + row, cols + col)

    def look(self, number: int, other: int, rows: Int, cols: Int) -> tuple[Float, Bool, Bool]:
        """Floor (else NaN) and occupancy of another level at cells of one; whether it has them."""
        two = self._lattices[other]
        down, right = shift_between(self._lattices[number], two)
        r = rows + down
        c = cols + right
        inside = two.holds(r, c)
        r = np.where(inside, r, 0)
        c = np.where(inside, c, 0)
        floor = np.where(inside, self._floors[other][r, c], np.nan)
        return floor, inside & self._occupied[other][r, c], inside


class Part(NamedTuple):
    """One part of the volume over each cell: a square's or a disc's."""

    half: float  # half of its edge, or its radius [m]
    is_round: bool  # whether it is a disc's
    low: Float  # the heights between which nothing may touch [m]
    high: Float

    def put_over(self, sample: LevelSample, k: int) -> tuple[Column, Float]:
        """Its column over a cell, to the micrometre, so that few differ; and its centre [m]."""
        low = self.low[k]
        high = self.high[k]
        column = Column(self.half, self.half, round(float(high - low) / 2, 6), self.is_round)
        return column, np.array([*sample.xy[k], (low + high) / 2])


def volume_over(
    sample: LevelSample, body: AgentSizes, around: Neighbourhood, radius: float | None = None
) -> list[Part]:
    """The volume over each cell: its square as baked, joined with a disc.

    The disc is the bake's; or one for the radius of a larger agent [m], between the heights that
    all floors under it leave free.
    """
    half = sample.level.lattice.cell_size / 2
    floor = sample.floor
    square = Part(half, False, floor + body.step, floor + body.height)
    if radius is None:
        disc = square._replace(half=body.radius, is_round=True)
        is_inside = body.radius >= half * np.sqrt(2.0)
        return ([] if is_inside else [square]) + ([disc] if body.radius > half else [])
    if radius <= half:
        return [square]
    cells = sample.rows, sample.cols
    low, high = around.floors_under(sample.number, *cells, floor, radius)
    return [square, Part(radius, True, high + body.step, low + body.height)]
