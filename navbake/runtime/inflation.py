"""Inflates a grid: blocked cells for a larger agent, costs near walls, and footprints.

The docstring of `navbake.runtime.surroundings` has the rules for blocked cells. A footprint must
not overlap an occupied cell's square (touching is allowed). It needs a floor under its origin only.

In an inflated grid, a cell is free if an agent fits at its centre. Other movements need more:

- A diagonal step needs two cells that are free for a larger radius. The larger discs round the two
  centres cover the agent's disc all along the step.
- A line off the centres needs cells in which the agent fits anywhere. It may also pass cells near
  occupied squares of their own level. There, `navbake.runtime.line_kernels` sweeps the disc along
  the line.
- Beside a step in the floor, agents move from centre to centre only: the grid tells the step's
  place only to half a cell.

Source: ``refine`` of MINOS's client (``NavScene.js`` in sstk) for mode ``minos`` and for
`surroundings.LEAST_FLOOR`; the inflation layer of nav2 (``nav2_costmap_2d``) for costs ``nav2``.
"""

from __future__ import annotations

import math
import warnings
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.known_names import check_choice
from navbake.lazy import lazy
from navbake.navgrid.grid import MAX_RADIUS, MultiLevelGrid, NavGrid, SceneGrid2D
from navbake.navgrid.islands import add_layers
from navbake.navgrid.lattice import Lattice, find_outline_fault, touch_cells
from navbake.runtime import surroundings
from navbake.runtime.flat_grid import RealNumber
from navbake.runtime.surroundings import (
    find_blocked,
    find_blocked_in_stack,
    find_margin,
    look_up_by_distance,
    stack_levels,
)
from navbake.types import Bool, Float, Int, Int32, Json

if TYPE_CHECKING:
    from navbake.runtime.inflation_kernels import LevelStack

compiled = lazy("navbake.compiled")  # numba loads slowly
kernels = lazy("navbake.runtime.inflation_kernels")
threads = lazy("navbake.threads")

AnyGrid = TypeVar("AnyGrid", SceneGrid2D, MultiLevelGrid)

INFLATION_MODES = ("exact", "minos")
CLEARANCE_COSTS = ("step", "nav2")
LEDGE_RULES = ("avoid", "ignore")
STEP_COST = 10.0  # least weight of cells within the clearance, with costs=``step``
MAX_FREE_COST = 252  # nav2's highest cost of a cell that is not blocked
INSCRIBED_COST = 253  # nav2's cost of cells within the inscribed radius
OCCUPIED_COST = 254  # nav2's cost of occupied cells
NAV2_SCALING = 10.0  # [1/m], nav2's default in code
STEEP_RISE = 1.001  # in cells: if the floors of neighbours differ by more, it is no slope
MAX_HEADINGS = 720
MAX_FOOTPRINT_REACH = 1000  # [cells] from a footprint's origin
DISTANCE_SLACK = 1e-9  # share of a cell by which distances may be rounded
COST_SLACK = 1e-9  # by which a cost may be rounded
# [cells squared] up to which costs are tabulated: the kernel adds the last step to it, in int32
MAX_SQUARED_DISTANCE = 2**31 - 1 - 2 * 46_341
SQUARES_AT_ONCE = 1 << 18  # how many costs are computed at once, to limit memory


class Margins(NamedTuple):
    """How far an obstacle must be from a cell's centre so that an agent can use the cell [m].

    Attributes:
        standing: least distance at which an agent can stand at the centre.
        diagonal: least distance at which it can also step from the centre to a diagonal neighbour.
        anywhere: least distance at which it can stand at every point of the cell.
    """

    standing: float
    diagonal: float
    anywhere: float


class OffCenterMasks(NamedTuple):
    """Three masks, by flat id: where an agent fits when it isn't at the centre of a cell.

    All of them are False in cells beside a step in the floor.

    Attributes:
        diagonal: whether the agent fits on the way to a diagonal neighbour.
        anywhere: whether the agent fits at every point of the cell.
        sweepable: whether nothing but occupied squares of the cell's own level can be in the
            agent's way. There, sweeping its disc over these squares decides exactly. True also
            where `anywhere` is.
    """

    diagonal: Bool
    anywhere: Bool
    sweepable: Bool


class InflationWarning(UserWarning):
    """A warning that an agent's radius isn't the one that a grid's inflation suggests.

    `SceneGrid2D.inflate` and `MultiLevelGrid.inflate` issue it where a grid stays inflated for a
    larger radius than the wanted one: obstacles that an inflation or a map has made wider can't be
    made narrower again. `PathFinder.use` issues it where a grid that isn't inflated replaces one
    that was inflated for a larger radius than that of the new grid.

    ``warnings.simplefilter("error", navbake.InflationWarning)`` turns it into an error,
    ``"ignore"`` silences it.
    """


def inflate(
    grid: AnyGrid,
    radius: float,
    clearance: float | None = None,
    mode: str = "exact",
    *,
    costs: str = "step",
    scaling: float = NAV2_SCALING,
    ledges: str = "avoid",
) -> AnyGrid:
    """Inflate a grid for an agent of another radius: `SceneGrid2D.inflate`.

    Mode ``exact`` blocks cells by the rules in the docstring of `navbake.runtime.surroundings`. If
    the grid has a layer ``solid``, `radius` replaces the radius of the bake. So it may be smaller,
    too, and cells become free. Costs ``nav2`` depend on the distance to the nearest cell that
    blocks: a cell that a geom overlaps, or that has no floor. The hole in a level at the top of a
    stair doesn't block, as the floor of another level goes on there at the same height.

    Args:
        grid: the grid, which stays as it is.
        radius: the agent's radius [m], 0 to 10,000.
        clearance: distance beyond the radius in which cells cost more [m]. None means 0 with
            costs=``step``; with ``nav2``, the distance at which the cost has fallen to 1.
        mode: ``exact``, or ``minos`` for the weights that MINOS's client computes (``refine``).
        costs: ``step`` for a fixed weight within the clearance, or ``nav2`` for costs by nav2's
            formula.
        scaling: how fast costs by nav2's formula fall with the distance [1/m], > 0.
        ledges: whether an agent keeps away from drops, in mode ``exact``: ``avoid`` or ``ignore``.

    Returns:
        A new grid; the metadata of the grid list the inflation under ``inflation``.

    Raises:
        QueryError: an argument is out of its range, or they exclude each other.
    """
    check_arguments(radius, clearance, mode, costs=costs, scaling=scaling, ledges=ledges)
    if clearance is None:
        distance_of_cost_1 = math.log(MAX_FREE_COST) / scaling  # where nav2's costs fall to 1
        clearance = min(distance_of_cost_1, MAX_RADIUS) if costs == "nav2" else 0.0
    if mode == "exact" and radius < grid.inflated_radius:
        warnings.warn(
            f"the grid of {grid.scene_id!r} stays inflated for {grid.inflated_radius:g} m, not "
            f"{radius:g} m: inflate the grid as it was baked",
            InflationWarning,
            stacklevel=3,
        )
    # a map shows no smaller obstacles than those that block now; a bake's layer `solid` does
    is_map = not any("solid" in level.attributes for level in grid.levels)
    is_inflated_enough = (
        is_map
        and 0.0 < radius <= grid.inflated_radius
        and ledges in (ledges_setting(grid), "ignore")
    )
    weights_by_level = []
    for level_number, level in enumerate(grid.levels):
        if mode == "minos":
            cell_size = level.lattice.cell_size
            weights_by_level.append(
                _refine_weights(level, radius / cell_size, (radius + clearance) / cell_size)
            )
            continue
        find_opened = partial(_mark_opened, level)
        if costs == "nav2":
            # neither depends on the blocked cells: another thread finds both meanwhile
            find_opened = threads.run_beside(find_opened)
            find_costs = partial(nav2_costs, level=level_number)
            wait_for_costs = threads.run_beside(
                find_costs, grid, radius, radius + clearance, scaling
            )
        if is_inflated_enough:
            is_blocked = ~level.free
        else:
            is_blocked = find_blocked(grid, level_number, radius, ledges)
        least_weights = None
        if costs == "nav2":
            least_weights = np.clip(wait_for_costs(), 1, MAX_FREE_COST)
        elif clearance > 0:
            is_in_clearance = find_blocked(grid, level_number, radius + clearance, ledges)
            least_weights = np.where(is_in_clearance, np.uint8(STEP_COST), np.uint8(0))
        weights_by_level.append(_combine_weights(level, find_opened(), is_blocked, least_weights))

    inflation_entry: Json = {"radius": float(radius), "clearance": float(clearance), "mode": mode}
    if mode == "exact":
        inflation_entry["ledges"] = ledges
    if clearance > 0:
        inflation_entry["costs"] = costs
        if costs == "nav2":
            inflation_entry["scaling"] = float(scaling)
    levels = []
    for level, level_weights in zip(grid.levels, weights_by_level, strict=True):
        # If a file lacks these attributes, they are derived from the weights, which inflating
        # changes: so they are stored before, and the grid can be inflated again.
        layers_before: dict[str, NDArray[np.generic]] = {
            "occupancy": level.occupancy,
            "floorHeight": level.floor_height,
        }
        attributes = {
            name: layer.copy()
            for name, layer in layers_before.items()
            if name not in level.attributes
        }
        if not level.uses_cell_floors:  # the file's values are not the floor
            attributes["floorHeight"] = layers_before["floorHeight"].copy()
        metadata = _add_inflation_entry(level.metadata, inflation_entry)
        levels.append(
            level.with_layers(weights=level_weights, attributes=attributes, metadata=metadata)
        )
    inflated_grid = grid.with_levels(levels, _add_inflation_entry(grid.metadata, inflation_entry))
    if grid.navbake:  # in files of other programs these names may mean anything
        layer_names = {name for level in levels for name in level.attributes}
        add_layers(inflated_grid, layer_names & {"island", "clearance"})
    return inflated_grid


def _mark_opened(level: SceneGrid2D) -> Bool:
    """Mark the cells that are free in an inflated level unless something blocks them there.

    Args:
        level: the level before. Its layer ``solid`` says which cells only the baked radius blocks;
            without it, no cell is marked.
    """
    if "solid" not in level.attributes:
        return np.zeros(level.shape, dtype=np.bool_)
    return np.ascontiguousarray(level.free_for_point)


def _combine_weights(
    level: SceneGrid2D,
    is_opened: Bool,
    is_blocked: Bool,
    least_weights: NDArray[np.uint8] | None,
) -> Float:
    """Compute the weights of an inflated level.

    Args:
        level: the level before.
        is_opened: where cells of infinite weight weigh 1 now, unless they are blocked, shape
            (height, width).
        is_blocked: whether each cell is blocked now, shape (height, width).
        least_weights: the least weight of each free cell, 0 for none, shape (height, width); None
            if no cell has one.

    Returns:
        Weights, inf in blocked cells, shape (height, width).
    """
    compiled.ensure_compiled("runtime.inflation_kernels.")
    # kernels take writeable arrays
    old_weights = np.require(level.weights, np.float64, ["C", "W"])
    if least_weights is None:
        least_weights = np.zeros(level.shape, dtype=np.uint8)
    weights = np.empty(level.shape)
    threads.run_in_chunks(
        kernels.combine_weights,
        level.height,
        old_weights,
        is_opened,
        np.ascontiguousarray(least_weights),
        np.ascontiguousarray(is_blocked),
        weights,
        min_chunk_size=max(1, threads.LEAST_CELLS // level.width),
    )
    return weights


def _add_inflation_entry(metadata: Json, entry: Json) -> Json:
    """Return a copy of metadata, with one more entry in the list of inflations."""
    inflations = metadata.get("inflation")
    earlier_inflations = inflations if isinstance(inflations, list) else []
    return {**metadata, "inflation": [*earlier_inflations, entry]}


def _refine_weights(level: SceneGrid2D, radius: float, outer_radius: float) -> Float:
    """Compute the weights that MINOS's client computes (``refine`` of its ``NavScene.js``).

    Args:
        level: a grid of one level.
        radius: the agent's radius, in cells.
        outer_radius: radius plus clearance, in cells.

    Returns:
        Weights, inf in blocked cells, shape (height, width).
    """
    is_occupied = level.occupancy != 0
    window_radius = min(math.ceil(outer_radius - 0.5), max(level.shape) + 1)
    if window_radius <= 0:
        return np.where(is_occupied, np.inf, 1.0)
    # without the last one, as in the client
    axis_offsets = np.arange(-window_radius, window_radius)
    squared_distances = axis_offsets[:, None] ** 2 + axis_offsets**2
    inner_runs = _find_runs(np.argwhere(squared_distances < radius * radius) - window_radius)
    outer_runs = _find_runs(
        np.argwhere(squared_distances < outer_radius * outer_radius) - window_radius
    )
    num_occupied = count_covered_cells(is_occupied, inner_runs)
    num_cells = count_covered_cells(np.ones_like(is_occupied), inner_runs)
    num_with_floor = count_covered_cells(~np.isnan(level.floor_height), inner_runs)
    floor_share = num_with_floor / np.maximum(num_cells, 1)
    lacks_floor = (num_cells > 0) & (floor_share < surroundings.LEAST_FLOOR)
    free_weights = np.where(count_covered_cells(is_occupied, outer_runs) > 0, STEP_COST, 1.0)
    return np.where((num_occupied > 0) | lacks_floor, np.inf, free_weights)


def nav2_costs(
    grid: NavGrid,
    radius: float,
    inflation_radius: float,
    scaling: float = NAV2_SCALING,
    *,
    level: int = 0,
) -> NDArray[np.uint8]:
    """Compute the costs of nav2's inflation layer for a level's cells.

    A cell counts as occupied by the rules of `grid.inflate`, see
    `navbake.runtime.surroundings.look_up_by_distance`. So each cell that is free in
    ``grid.inflate(radius)`` costs 252 at most.

    Args:
        grid: the grid, of one level or several.
        radius: the inscribed radius [m].
        inflation_radius: distance beyond which costs are 0 [m].
        scaling: ``cost_scaling_factor`` [1/m].
        level: the number of the level.

    Returns:
        uint8, shape (height, width): 254 on occupied cells, 253 up to the inscribed radius, then
        ``floor(252 exp(-scaling (d - radius)))``, d from the nearest occupied cell's centre [m].
        Cells more than 46,339 cells away from it cost 0.
    """
    cell_size = grid.levels[level].lattice.cell_size
    # at this distance, costs have fallen to 1
    max_distance = min(inflation_radius, radius + math.log(MAX_FREE_COST) / scaling)
    # squared distances in cells are whole numbers: tabulate their costs
    max_squared_distance = math.ceil((max_distance / cell_size) ** 2 * 1.001) + 1
    # no two cells of the grid are farther from each other than its corners
    bounds = np.array([stacked_level.lattice.bounds for stacked_level in grid.levels])
    extent = np.ceil((bounds[:, 2:].max(axis=0) - bounds[:, :2].min(axis=0)) / cell_size) + 1
    num_squares = 1 + min(max_squared_distance, int((extent**2).sum()), MAX_SQUARED_DISTANCE - 1)
    distance_slack = DISTANCE_SLACK * cell_size
    cost_table = np.empty(num_squares, dtype=np.uint8)
    for begin in range(0, num_squares, SQUARES_AT_ONCE):
        costs = cost_table[begin : begin + SQUARES_AT_ONCE]
        distances = np.sqrt(np.arange(begin, begin + len(costs))) * cell_size
        decay = np.exp(-scaling * np.maximum(distances - radius, 0))
        costs[:] = np.floor(MAX_FREE_COST * decay + COST_SLACK)
        costs[distances <= radius + distance_slack] = INSCRIBED_COST
        costs[distances > inflation_radius + distance_slack] = 0
    cost_table[0] = OCCUPIED_COST
    return look_up_by_distance(grid, level, cost_table)


# ---------------------------------------------------------------- arguments


def check_radius(radius: float, name: str = "radius") -> None:
    """Check that a radius that a user passes is a number from 0 to 10,000 [m].

    Args:
        radius: expected to be a number from 0 to 10,000 [m].
        name: the argument's name in the error.

    Raises:
        QueryError: the radius is anything else.
    """
    is_number = isinstance(radius, RealNumber) and not isinstance(radius, bool)
    if not is_number or not 0 <= radius <= MAX_RADIUS:
        expected = f"0 to {MAX_RADIUS:,.0f} m"
        raise QueryError(
            f"expected {expected} as {name}, got {radius!r}",
            key=name,
            value=radius,
            expected=expected,
        )


def check_arguments(
    radius: float, clearance: float | None, mode: str, *, costs: str, scaling: float, ledges: str
) -> None:
    """Check the arguments of `inflate`.

    Args:
        radius: expected to be 0 to 10,000 [m].
        clearance: expected to be 0 to 10,000 [m], or None.
        mode: expected to be one of `INFLATION_MODES`.
        costs: expected to be one of `CLEARANCE_COSTS`; ``step`` in mode ``minos``.
        scaling: expected to be > 0 [1/m].
        ledges: expected to be one of `LEDGE_RULES`.

    Raises:
        QueryError: an argument is out of its range, or they exclude each other.
    """
    check_radius(radius)
    if clearance is not None:
        check_radius(clearance, "clearance")
    check_choice(mode, INFLATION_MODES, "mode", QueryError)
    check_choice(costs, CLEARANCE_COSTS, "costs", QueryError)
    check_choice(ledges, LEDGE_RULES, "ledges", QueryError)
    if mode == "minos" and costs != "step":
        hint = "leave `costs` out"
        raise QueryError(
            f"mode minos has costs of its own (step): {hint}", key="costs", value=costs, hint=hint
        )
    if not isinstance(scaling, RealNumber) or not 0 < scaling < math.inf:
        expected = "a number > 0 [1/m]"
        raise QueryError(
            f"expected {expected} as scaling, got {scaling!r}",
            key="scaling",
            value=scaling,
            expected=expected,
        )


# ---------------------------------------------------------------- off the centres of cells


def ledges_setting(grid: NavGrid) -> str:
    """Return the argument `ledges` that the grid was inflated with: ``avoid`` or ``ignore``.

    The result is ``ignore`` for an inflated grid whose file doesn't state it, and ``avoid`` for a
    grid that is not inflated.
    """
    avoids_ledges = any(entry.get("ledges") == "avoid" for entry in grid.exact_inflations)
    return "avoid" if avoids_ledges or not grid.inflated_radius else "ignore"


def compute_margins(grid: NavGrid, radius: float | None = None) -> Margins:
    """Compute how far an added obstacle must be from a cell's centre so that the cell stays usable.

    Args:
        grid: the grid.
        radius: the agent's radius [m]; None for the grid's.

    Returns:
        The distances for standing at the cell's centre, for stepping to a diagonal neighbour, and
        for standing anywhere in the cell [m], see `Margins`. In a grid that isn't inflated, all
        three are the radius.

    Raises:
        QueryError: the radius is no number from 0 to 10,000.
    """
    if radius is not None:
        check_radius(radius, "margin")
    radius = grid.radius if radius is None else float(radius)
    if not grid.inflated_radius:
        return Margins(radius, radius, radius)
    largest_cell_size = max(level.lattice.cell_size for level in grid.levels)
    return Margins(
        standing=radius,
        diagonal=_diagonal_radius(radius, largest_cell_size),
        anywhere=_anywhere_radius(radius, largest_cell_size),
    )


def find_off_center_masks(grid: NavGrid) -> OffCenterMasks | None:
    """Mark the cells of an inflated grid where an agent fits when it isn't at their centres.

    Returns:
        The masks; None if the grid isn't inflated, or was inflated to a radius of 0.
    """
    radius = grid.inflated_radius
    if radius == 0.0:
        return None
    ledge_rule = ledges_setting(grid)
    diagonal_masks = []
    anywhere_masks = []
    sweepable_masks = []
    for level_number, level in enumerate(grid.levels):
        # False beside a neighbour whose floor is too much higher or lower for a slope
        floor_z = level.floor_height.astype(np.float64)
        has_no_step = np.ones(level.shape, dtype=np.bool_)
        column_neighbors = (np.s_[:, :-1], np.s_[:, 1:])
        row_neighbors = (np.s_[:-1], np.s_[1:])
        for first_neighbors, second_neighbors in (column_neighbors, row_neighbors):
            rise = np.abs(floor_z[first_neighbors] - floor_z[second_neighbors])
            is_step = rise > STEEP_RISE * level.cell_size  # False for NaN
            has_no_step[first_neighbors] &= ~is_step
            has_no_step[second_neighbors] &= ~is_step
        cell_size = level.lattice.cell_size
        anywhere_radius = _anywhere_radius(radius, cell_size)
        diagonal_radius = _diagonal_radius(radius, cell_size)  # smaller
        margin = find_margin(anywhere_radius, cell_size)
        stack, level_window = stack_levels(grid, level_number, margin)
        is_blocked = find_blocked_in_stack(
            grid, level_number, stack, level_window, anywhere_radius, ledge_rule
        )
        # also marks cells that aren't blocked: all cells of other levels count as occupied there
        may_floors_block = find_blocked_in_stack(
            grid,
            level_number,
            stack,
            level_window,
            anywhere_radius,
            ledge_rule,
            counts_own_occupied=False,
        )
        is_blocked_diagonally = find_blocked_in_stack(
            grid, level_number, stack, level_window, diagonal_radius, ledge_rule
        )
        diagonal_masks.append((has_no_step & ~is_blocked_diagonally).ravel())
        anywhere_masks.append((has_no_step & ~is_blocked).ravel())
        sweepable_masks.append((has_no_step & ~(is_blocked & may_floors_block)).ravel())
    return OffCenterMasks(
        diagonal=np.concatenate(diagonal_masks),
        anywhere=np.concatenate(anywhere_masks),
        sweepable=np.concatenate(sweepable_masks),
    )


def _diagonal_radius(radius: float, cell_size: float) -> float:
    """Compute the radius [m] for which both cells of a diagonal step must be free."""
    # Halfway along a diagonal step, half a diagonal from both ends, a point at distance r from the
    # line is the farthest from them: sqrt(r² + (s / sqrt 2)²).
    return math.sqrt(radius**2 + cell_size**2 / 2)


def _anywhere_radius(radius: float, cell_size: float) -> float:
    """Compute the radius [m] for which a cell must be free, so that agents fit anywhere in it."""
    # a corner of the cell is s / sqrt 2 from its centre
    return radius + cell_size / math.sqrt(2)


# ---------------------------------------------------------------- footprints


def inflate_footprint(
    grid: NavGrid, polygon: ArrayLike, num_headings: int = 16, *, ledges: str = "avoid"
) -> list[Bool]:
    """Mark the cells where an agent with a polygonal footprint can stand, for each heading.

    This is the code of `SceneGrid2D.inflate_footprint`.

    Args:
        grid: a grid of one or several levels.
        polygon: the outline from above, shape (n, 2), n >= 3, in the agent's frame [m]: x ahead,
            y to the left, its centre at the origin. No two sides cross.
        num_headings: number of headings; heading k is ``2 π k / num_headings`` [rad],
            counter-clockwise from the world's x.
        ledges: ``avoid`` to keep the footprint off drops, or ``ignore`` to let it reach over them.

    Returns:
        For each level, shape (num_headings, height, width), bool: whether the cell is free
        and the polygon, its origin on the cell's centre, overlaps no occupied cell's square.

    Raises:
        QueryError: the polygon or another argument is not valid.
    """
    check_choice(ledges, LEDGE_RULES, "ledges", QueryError)
    outline = check_polygon(polygon)
    if not isinstance(num_headings, int | np.integer) or not 1 <= num_headings <= MAX_HEADINGS:
        raise QueryError(f"expected 1 to {MAX_HEADINGS} headings, got {num_headings!r}")
    return [
        find_free_headings(
            grid,
            level_number,
            (slice(0, level.height), slice(0, level.width)),
            outline,
            num_headings,
            ledges,
        )
        for level_number, level in enumerate(grid.levels)
    ]


def find_free_headings(
    grid: NavGrid,
    level_number: int,
    window: tuple[slice, slice],
    outline: Float,
    num_headings: int,
    ledges: str,
) -> Bool:
    """Mark the cells of a window where an agent with a polygonal footprint can stand.

    Args:
        grid: a grid of one or several levels.
        level_number: number of the level.
        window: rows and columns of the level.
        outline: the footprint from above, from `check_polygon`, shape (n, 2) [m].
        num_headings: number of headings, as in `inflate_footprint`.
        ledges: ``avoid`` to keep the footprint off drops, or ``ignore``.

    Returns:
        Shape (num_headings, rows, columns), bool, as from `inflate_footprint`.

    Raises:
        QueryError: the polygon reaches over too many cells.
    """
    level = grid.levels[level_number]
    cell_size = level.lattice.cell_size
    radius = float(np.hypot(*outline.T).max())
    reach = math.ceil(radius / cell_size) + 1
    if reach > MAX_FOOTPRINT_REACH:
        limit_text = f"within {MAX_FOOTPRINT_REACH} cells"
        raise QueryError(f"expected a polygon {limit_text}, got one of {reach}")
    level_stack, (level_rows, level_cols) = stack_levels(grid, level_number, reach)
    level_stack, (rows, cols) = _crop_stack(
        level_stack,
        slice(level_rows.start + window[0].start, level_rows.start + window[0].stop),
        slice(level_cols.start + window[1].start, level_cols.start + window[1].stop),
        reach,
    )
    is_occupied = level_stack.occupied[level_stack.level] != 0
    is_free_for_point = level.free_for_point[window]
    is_free = np.empty((num_headings, *is_free_for_point.shape), dtype=np.bool_)
    # the cells round the agent's cell, in units of a cell: `touch_cells` finds the polygon's
    reach_lattice = Lattice(-reach - 0.5, reach + 0.5, 1.0, 2 * reach + 1, 2 * reach + 1)
    x, y = outline.T / cell_size
    for heading_index in range(num_headings):
        angle = 2 * math.pi * heading_index / num_headings
        cos = math.cos(angle)
        sin = math.sin(angle)
        rotated_outline = np.stack([cos * x - sin * y, sin * x + cos * y], axis=1)
        cell_offsets = np.ascontiguousarray(
            np.argwhere(touch_cells([rotated_outline], reach_lattice)) - reach
        )
        is_blocked = count_covered_cells(is_occupied, _find_runs(cell_offsets)) > 0
        surroundings.block_by_floors(
            grid, level_number, level_stack, radius, cell_offsets, ledges, is_blocked
        )
        is_free[heading_index] = is_free_for_point & ~is_blocked[rows, cols]
    return is_free


def _crop_stack(
    stack: LevelStack, rows: slice, cols: slice, margin: int
) -> tuple[LevelStack, tuple[slice, slice]]:
    """Cut a window and what lies within a margin of it out of a stack.

    Args:
        stack: the cells of a level and of the levels around it.
        rows: rows of the window.
        cols: columns of the window.
        margin: by how many cells the result extends beyond the window, where the stack does.

    Returns:
        The cells, contiguous; and the rows and columns of the window in them.
    """
    first_row = max(rows.start - margin, 0)
    first_col = max(cols.start - margin, 0)
    cells = np.s_[:, first_row : rows.stop + margin, first_col : cols.stop + margin]
    cropped_stack = stack._replace(
        floor=np.ascontiguousarray(stack.floor[cells]),
        occupied=np.ascontiguousarray(stack.occupied[cells]),
        slope_bits=np.ascontiguousarray(stack.slope_bits[cells]),
    )
    return cropped_stack, (
        slice(rows.start - first_row, rows.stop - first_row),
        slice(cols.start - first_col, cols.stop - first_col),
    )


def check_polygon(polygon: ArrayLike) -> Float:
    """Check the outline of a footprint.

    Args:
        polygon: expected to be the outline of an area, shape (n, 2), n >= 3 [m].

    Returns:
        The outline as float64, shape (n, 2).

    Raises:
        QueryError: it is anything else.
    """
    expected = "expected a polygon of shape (n, 2) [m]"
    try:
        outline = np.asarray(polygon, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise QueryError(f"{expected}, got {polygon!r}") from error
    if outline.ndim != 2 or outline.shape[1] != 2 or len(outline) < 3:
        raise QueryError(f"{expected}, n >= 3, got {outline.shape}")
    if not np.isfinite(outline).all():
        raise QueryError("expected a polygon of finite numbers [m]")
    fault = find_outline_fault(outline)
    if fault:
        raise QueryError(f"expected the outline of an area, got {fault}")
    return outline


def count_covered_cells(mask: Bool, runs: Int) -> Int32:
    """Count how many marked cells a shape covers when it is put on each cell of an array.

    Args:
        mask: the marked cells, bool, shape (rows, cols).
        runs: the shape, as runs of cells side by side in a row. Each has a row, a first and a last
            column, relative to the cell that the shape is put on; shape (n, 3).

    Returns:
        For each cell, the count with the shape put on it, int32, shape (rows, cols).
    """
    rows, cols = mask.shape
    padding = int(np.abs(runs).max(initial=0)) + 1
    running_sums = np.cumsum(
        np.pad(mask, padding), axis=1, dtype=np.int32
    )  # a run is one difference
    counts = np.zeros(mask.shape, dtype=np.int32)
    for row, first_col, last_col in (runs + padding).tolist():
        row_sums = running_sums[row : row + rows]
        counts += row_sums[:, last_col : last_col + cols]
        counts -= row_sums[:, first_col - 1 : first_col - 1 + cols]
    return counts


def _find_runs(cell_offsets: Int) -> Int:
    """Join offsets of cells into runs along rows.

    Args:
        cell_offsets: row and column of each cell, sorted, shape (m, 2).

    Returns:
        Row, first column and last column of each run, shape (n, 3).
    """
    rows, cols = cell_offsets.T
    is_first = np.ones(len(rows), dtype=np.bool_)
    is_first[1:] = (rows[1:] != rows[:-1]) | (cols[1:] != cols[:-1] + 1)
    is_last = np.roll(is_first, -1)
    return np.stack([rows[is_first], cols[is_first], cols[is_last]], axis=1)
