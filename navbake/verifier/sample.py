"""The agent and the inflation that a grid states, the sampled cells, and the volumes over them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from navbake.auditor.facts import find_wrong_sizes, is_within, read_inflations
from navbake.errors import FormatError, QueryError, shorten
from navbake.navgrid.grid import GridBase, NavGrid, SceneGrid2D
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Int, Vector3
from navbake.verifier.probes import PlacedPrism, UprightPrism
from navbake.verifier.report import Finding

STEP_SLACK = 1e-5  # what rounding may add to the step between two floors [m]
# a square that overlaps a disc by a smaller share of the radius only touches it; an inflation
# ignores larger overlaps than this
TOUCHING_SHARE = 1e-10
DEFAULT_MAX_SLOPE = 45.0  # steepest floor, if the grid states none [degrees]
PRISM_DIGITS = 6  # prisms' heights are rounded to micrometres, so that many have equal sizes


class AgentSizes(NamedTuple):
    """The sizes of the agent that a grid was baked for.

    Attributes:
        height: The agent's height [m].
        radius: The agent's radius [m].
        step: The highest step that the agent takes [m].
        min_normal_z: The least z of a floor's unit normal: the cosine of the steepest slope.
    """

    height: float
    radius: float
    step: float
    min_normal_z: float

    @classmethod
    def of_grid(cls, grid: GridBase) -> AgentSizes:
        """Return the sizes of the agent that a grid states; missing ones are the format's defaults.

        Raises:
            FormatError: the grid states sizes that no agent can have.
        """
        problems = list(find_wrong_sizes(grid).values())
        max_slope = grid.navbake.get("maxSlope", DEFAULT_MAX_SLOPE)
        if not is_within(max_slope, 0, 90):
            slope_text = shorten(repr(max_slope))
            problems.append(f"`maxSlope` is {slope_text}, which is no slope of 0 to 90 degrees")
        if problems:
            text = f"the grid's metadata: {problems[0]}: cells can't be judged for such an agent"
            raise FormatError(text)
        min_normal_z = float(np.cos(np.radians(max_slope)))
        return cls(grid.agent_height, grid.agent_radius, grid.max_step, min_normal_z)


class InflatedGrid(NamedTuple):
    """A grid, inflated for a radius, and how far the inflation reached.

    Attributes:
        grid: The grid, inflated for the radius.
        radius: The radius of the cylinder that has to fit on free cells [m]; None for the baked
            footprint.
        inflation_reach: The largest distance from a cell's centre at which something may have made
            the inflation block the cell [m]; 0 for a grid that is not inflated.
        measures_from_centers: Whether every occupied cell within that distance makes the inflation
            block a cell, as in the mode ``minos``; otherwise only cells with a solid do.
    """

    grid: NavGrid
    radius: float | None
    inflation_reach: float
    measures_from_centers: bool = False


def inflate_for_radius(grid: NavGrid, radius: float | None, notes: list[str]) -> InflatedGrid:
    """Inflate a grid for a radius, unless it is inflated for that radius already.

    Args:
        grid: The grid.
        radius: The radius [m], >= 0; None for the inflation that the grid states.
        notes: Messages for the user are appended to it.

    Returns:
        The inflated grid, and how to verify it.

    Raises:
        QueryError: the grid is inflated for a larger radius, or a radius is asked for a grid that
            is inflated in the mode ``minos``.
    """
    inflations, invalid_entry = read_inflations(grid)
    if invalid_entry is not None:
        note = "the metadata's `inflation` isn't as navbake writes it"
        notes.append(f"{note}: what it closed has to touch something by itself")
    largest_radius = max((float(inflation["radius"]) for inflation in inflations), default=0.0)
    if any(inflation["mode"] == "minos" for inflation in inflations):
        if radius is not None:
            raise QueryError(
                "the grid was inflated in the mode minos, whose cells promise nothing for a "
                "radius: leave the radius out, or give the grid as it was before"
            )
        note = "inflated in the mode minos, which measures from the centres of cells"
        notes.append(f"{note}: free cells are judged by the baked footprint")
        return InflatedGrid(grid, None, largest_radius, measures_from_centers=True)
    if radius is None:
        return InflatedGrid(grid, largest_radius if inflations else None, largest_radius)
    if radius < largest_radius:
        raise QueryError(
            f"the grid was inflated for {largest_radius:g} m, which can't be undone for "
            f"{radius:g} m: "
            f"expected a radius of at least {largest_radius:g} m, or the grid as it was before"
        )
    inflated_grid = grid if inflations and radius == largest_radius else grid.inflate(radius)
    return InflatedGrid(inflated_grid, radius, radius)


@dataclass(frozen=True)
class LevelSample:
    """The sampled cells of one level.

    Attributes:
        level_number: The level's number, 0 for the lowest.
        level: The level's grid.
        rows: Rows of the cells, (n,), ascending.
        cols: Columns of the cells, (n,).
        centers: World x and y of the cells' centres, (n, 2) [m].
        floor: Heights of the floors, (n,) [m], NaN for none.
        is_free: Whether an agent can stand on the cell, (n,).
        is_occupied: Whether the occupancy layer marks the cell, (n,); an inflation does not change
            it.
        has_cell_floors: Whether the grid states a floor for each cell; otherwise all floors are
            at the level's ground.
    """

    level_number: int
    level: SceneGrid2D
    rows: Int
    cols: Int
    centers: Float
    floor: Float
    is_free: Bool
    is_occupied: Bool
    has_cell_floors: bool

    def position(self, cell: int) -> Vector3:
        """Return the centre of a cell, world x, y, z [m]; z is its floor or the level's ground.

        Args:
            cell: The cell's index in the sample.
        """
        x, y = self.centers[cell].tolist()
        z = float(self.floor[cell])
        return x, y, self.level.ground if np.isnan(z) else z

    def make_finding(
        self, kind: str, cell: int, text: str, geom: str | None = None, size: float | None = None
    ) -> Finding:
        """Make a finding about one of the cells.

        Args:
            kind: The kind of finding, a constant of `navbake.verifier.report`.
            cell: The cell's index in the sample.
            text: What is wrong.
            geom: The name of the geom that the finding is about; None for no geom.
            size: A measure of the disagreement [m or m²]; None if it is not measured.
        """
        row_col = (int(self.rows[cell]), int(self.cols[cell]))
        return Finding(kind, self.level_number, row_col, self.position(cell), text, geom, size)


def has_cell_floors(level: SceneGrid2D) -> bool:
    """Return whether a level states floors of single cells, not just its ground.

    When `navbake.runtime.inflation` inflates a grid of another program that has no floors of
    cells, it stores the ground as the floor of its free cells. Such floors don't count.
    """
    if not level.uses_cell_floors or level.navbake or "inflation" not in level.metadata:
        return level.uses_cell_floors
    floors = level.floor_height[~np.isnan(level.floor_height)]
    return bool((floors != np.float32(level.min_yup[1])).any())


def take_sample(
    grid: GridBase, num_cells: int | None, seed: int, levels_have_cell_floors: Sequence[bool]
) -> list[LevelSample]:
    """Draw cells of all levels at random, without replacement, each with the same probability.

    Args:
        grid: The grid.
        num_cells: How many cells to draw, >= 1; all cells if None or if the grid has fewer.
        seed: The seed of the random generator, >= 0.
        levels_have_cell_floors: For each level, whether it stated floors of single cells before the
            grid was inflated, see `has_cell_floors`.

    Returns:
        A sample for each level, which may be empty.
    """
    level_sizes = [level.width * level.height for level in grid.levels]
    sampled_cells = np.arange(sum(level_sizes))
    first_cell_of_level = np.cumsum([0, *level_sizes])
    if num_cells is not None and num_cells < len(sampled_cells):
        rng = np.random.default_rng(seed)
        sampled_cells = np.sort(rng.choice(len(sampled_cells), num_cells, replace=False))
    samples = []
    for level_number, (level, level_has_cell_floors) in enumerate(
        zip(grid.levels, levels_have_cell_floors, strict=True)
    ):
        is_on_level = (sampled_cells >= first_cell_of_level[level_number]) & (
            sampled_cells < first_cell_of_level[level_number + 1]
        )
        cell_ids = sampled_cells[is_on_level] - first_cell_of_level[level_number]
        rows, cols = np.divmod(cell_ids, level.width)
        floor_heights = (
            level.floor_of(rows, cols)
            if level_has_cell_floors
            else np.full(len(cell_ids), level.ground)
        )
        samples.append(
            LevelSample(
                level_number=level_number,
                level=level,
                rows=rows,
                cols=cols,
                centers=level.lattice.positions(rows, cols).reshape(-1, 2),
                floor=floor_heights,
                is_free=level.free[rows, cols],
                is_occupied=level.occupancy[rows, cols] != 0,
                has_cell_floors=level_has_cell_floors,
            )
        )
    return samples


class CellShift(NamedTuple):
    """How much larger a cell's row and column are on one lattice than on another."""

    rows: int
    cols: int


def find_cell_shift(source: Lattice, target: Lattice) -> CellShift:
    """Return how much larger a cell's row and column are on a target than on a source lattice.

    Args:
        source: The lattice that rows and columns refer to.
        target: The lattice to convert to, with the same cell size.
    """
    y_offset = target.y_max - source.y_max
    x_offset = source.x_min - target.x_min
    return CellShift(round(y_offset / source.cell_size), round(x_offset / source.cell_size))


class LevelCells(NamedTuple):
    """The floors of n cells of a level, some of which may lie outside the level.

    Attributes:
        level_number: The level's number, 0 for the lowest.
        floor: Heights of the floors, (n,) [m], NaN for none.
        blocks_others: Whether an inflation may block other cells because of this cell, (n,).
        is_inside: Whether the cell lies on the level's lattice, (n,).
    """

    level_number: int
    floor: Float
    blocks_others: Bool
    is_inside: Bool


class CellNeighborhood:
    """Looks up the floors near cells, and whether an inflation had a reason to block cells.

    Args:
        grid: The inflated grid.
        step: The highest step that the agent takes [m].
        measures_from_centers: Whether any occupied cell makes the inflation block other cells, as
            in the mode ``minos``; otherwise only cells with a solid do.
    """

    def __init__(self, grid: GridBase, step: float, *, measures_from_centers: bool = False) -> None:
        self._step = step
        self._lattices = [level.lattice for level in grid.levels]
        self._floors = [level.floor for level in grid.levels]
        # a cell that blocks others must be blocked itself, so that it is verified, too
        self._blocking_cells = [
            (level.occupancy != 0) & ~level.free & (measures_from_centers | (level.solid != 0))
            for level in grid.levels
        ]

    def find_floors_under(
        self, level_number: int, rows: Int, cols: Int, floor: Float, radius: float
    ) -> tuple[Float, Float]:
        """Find the lowest and the highest floor under each of n discs, on any level.

        Floors that are more than a step above or below the disc's own floor are ignored.

        Args:
            level_number: The level of the discs' centres.
            rows: Rows of the discs' centres, (n,).
            cols: Columns of the discs' centres, (n,).
            floor: The floor of each disc, (n,) [m].
            radius: The discs' radius [m].

        Returns:
            The lowest floor and the highest floor of each disc, (n,) each [m].
        """
        lowest_floor = floor.copy()
        highest_floor = floor.copy()
        for cells in self._cells_under(level_number, rows, cols, radius):
            is_within_step = np.abs(cells.floor - floor) <= self._step + STEP_SLACK
            lowest_floor = np.where(
                is_within_step, np.fmin(lowest_floor, cells.floor), lowest_floor
            )
            highest_floor = np.where(
                is_within_step, np.fmax(highest_floor, cells.floor), highest_floor
            )
        return lowest_floor, highest_floor

    def has_blocking_reason(
        self, level_number: int, rows: Int, cols: Int, floor: Float, radius: float
    ) -> Bool:
        """Return whether an inflation had a reason to block cells.

        A reason is another cell whose square overlaps the disc around the cell's centre: a cell
        that is occupied, has no floor, or has one more than a step higher or lower. A cell of
        another level is a reason only if its floor is more than a step higher, or if it has a floor
        and is occupied. Beyond the edge of a grid of a single level, nothing is a reason.

        Args:
            level_number: The level of the cells.
            rows: Rows of the cells, (n,).
            cols: Columns of the cells, (n,).
            floor: The floors of the cells, (n,) [m].
            radius: The radius of the inflation [m].

        Returns:
            Whether there is a reason, (n,).
        """
        is_excused = np.zeros(len(rows), dtype=np.bool_)
        for cells in self._cells_under(level_number, rows, cols, radius):
            if cells.level_number == level_number:
                is_ledge = ~(np.abs(cells.floor - floor) <= self._step - STEP_SLACK)
                is_possible_reason = cells.is_inside | (len(self._lattices) > 1)
                is_excused |= (cells.blocks_others | is_ledge) & is_possible_reason
            else:
                is_higher = cells.floor > floor + self._step
                is_excused |= ~np.isnan(cells.floor) & (cells.blocks_others | is_higher)
        return is_excused

    def _cells_under(
        self, level_number: int, rows: Int, cols: Int, radius: float
    ) -> Iterator[LevelCells]:
        """Yield the cells that open discs around n cells' centres overlap.

        There is one item for each level and each offset in rows and columns from the centre: the n
        cells at this offset from the n centres.
        """
        cell_size = self._lattices[level_number].cell_size
        max_cell_offset = int(radius / cell_size + 0.5) + 1
        # the distance from the centre to the nearest edge of a row or column of cells
        cell_offsets = np.arange(-max_cell_offset, max_cell_offset + 1)
        edge_distance = np.maximum(np.abs(cell_offsets) - 0.5, 0.0) * cell_size
        is_overlapping = np.hypot(edge_distance[:, None], edge_distance) < radius * (
            1 - TOUCHING_SHARE
        )
        for row_offset, col_offset in (np.argwhere(is_overlapping) - max_cell_offset).tolist():
            for target_level in range(len(self._lattices)):
                yield self.find_cells_on_level(
                    level_number, target_level, rows + row_offset, cols + col_offset
                )

    def find_cells_on_level(
        self, source_level: int, target_level: int, rows: Int, cols: Int
    ) -> LevelCells:
        """Return the cells of one level at rows and columns of another level's lattice.

        Args:
            source_level: The level that rows and columns refer to.
            target_level: The level whose floors are returned.
            rows: Rows of the cells, (n,); the cells may lie outside the levels.
            cols: Columns of the cells, (n,).
        """
        target_lattice = self._lattices[target_level]
        cell_shift = find_cell_shift(self._lattices[source_level], target_lattice)
        target_rows = rows + cell_shift.rows
        target_cols = cols + cell_shift.cols
        is_inside = target_lattice.holds(target_rows, target_cols)
        target_rows = np.where(is_inside, target_rows, 0)
        target_cols = np.where(is_inside, target_cols, 0)
        floor = np.where(is_inside, self._floors[target_level][target_rows, target_cols], np.nan)
        blocks_others = is_inside & self._blocking_cells[target_level][target_rows, target_cols]
        return LevelCells(target_level, floor, blocks_others, is_inside)


class CellPrisms(NamedTuple):
    """A prism over each cell of a sample, all with the same footprint.

    Attributes:
        half_size: Half of the edge of a square, or the radius of a disc [m].
        is_round: Whether the footprint is a disc.
        low_z: The lower end over each cell, (n,) [m].
        high_z: The upper end over each cell, (n,) [m]; it may lie below the lower end.
    """

    half_size: float
    is_round: bool
    low_z: Float
    high_z: Float

    def prism_over_cell(self, sample: LevelSample, cell: int) -> PlacedPrism:
        """Return the prism over a cell.

        Args:
            sample: The sample.
            cell: The cell's index in the sample.
        """
        low_z = self.low_z[cell]
        high_z = self.high_z[cell]
        half_height = round(float(high_z - low_z) / 2, PRISM_DIGITS)
        prism = UprightPrism(self.half_size, self.half_size, half_height, self.is_round)
        return PlacedPrism(prism, np.array([*sample.centers[cell], (low_z + high_z) / 2]))


def make_volumes(
    sample: LevelSample,
    agent: AgentSizes,
    neighborhood: CellNeighborhood,
    radius: float | None = None,
) -> list[CellPrisms]:
    """Make the volume over each cell that must be empty if the cell is free.

    For the agent of the bake, it is the union of two prisms, over the cell's square and over the
    agent's disc, from a step above the cell's floor up to the agent's height. For a larger agent,
    the disc's prism begins a step above the highest floor under the disc, and ends at the agent's
    height above the lowest one.

    Args:
        sample: The cells.
        agent: The agent that the grid was baked for.
        neighborhood: The floors of the grid.
        radius: The radius of a larger agent [m]; None for the agent of the bake.

    Returns:
        The prisms over all squares, those over all discs, or both. If one footprint contains the
        other, only the prisms of the larger footprint are returned.
    """
    half_cell_size = sample.level.lattice.cell_size / 2
    floor_heights = sample.floor
    square_prisms = CellPrisms(
        half_cell_size, False, floor_heights + agent.step, floor_heights + agent.height
    )
    if radius is None:
        disc_prisms = square_prisms._replace(half_size=agent.radius, is_round=True)
        if agent.radius >= half_cell_size * np.sqrt(2.0):  # the disc covers the square
            return [disc_prisms]
        return [square_prisms, disc_prisms] if agent.radius > half_cell_size else [square_prisms]
    if radius <= half_cell_size:
        return [square_prisms]
    lowest_floor, highest_floor = neighborhood.find_floors_under(
        sample.level_number, sample.rows, sample.cols, floor_heights, radius
    )
    return [
        square_prisms,
        CellPrisms(radius, True, highest_floor + agent.step, lowest_floor + agent.height),
    ]
