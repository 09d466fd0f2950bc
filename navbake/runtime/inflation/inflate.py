"""The same grid for a larger agent: cells that it can't stand on, and costs near walls.

How `exact` decides, for an agent whose centre is on a cell's centre:

- Occupied cells: the agent must not meet their squares. The bake has made a cell occupied where
  something meets its square or the disc of the baked radius round its centre, so all baked
  geometry lies in occupied squares. The baked radius is replaced, not added to: where its disc
  reaches beyond the square, the squares that something meets themselves (`SceneGrid2D.solid`)
  stand in for the occupied ones, and a cell that only the baked disc closed may become free.
- Higher floors that the agent meets: at most a step above its own. A ledge is a wall from below,
  and so is the step after the next one for an agent too large for the stair. In files that have
  but the occupancy of a larger radius, the bake has decided this up to that radius.
- Lower floors that the agent meets: at most a step below its own, unless `ledges` is ``ignore``.
  Of the floors of all levels in a column, the highest that isn't more than a step above the
  agent's counts. So the room under a gallery is no drop for an agent on the gallery, but the
  stair beside it is. Columns without any floor count as they do otherwise, see below.
- Slopes: a floor to which cells lead in a straight line, over steps and at least one link between
  neighbours more than a step apart, is neither a higher nor a lower one. The bake has found such
  links where a ramp within the slope rises more than a step over a cell.
- Other levels: the cells of both levels count, each where its floor is as high as the agent's
  (less than the body's height apart). So a thing under a landing does not block the stair to it.
- Outside of the grid: beyond a single level nothing was baked, and nothing blocks. Each of several
  levels is cut to the cells with a floor; beyond these is no floor, which counts as occupied.
- Cells without floor that are not occupied, in files of other programs: as in the original client,
  at least 0.7 of the cells that the disc covers must have a floor. Here this must hold for every
  smaller radius too, so that a larger agent is never free where a smaller one isn't.

Source: ``refine`` of the original client (sstk, ``NavScene.js``) for `minos` and the share of
floor; the inflation layer of nav2 (``nav2_costmap_2d``) for `costs="nav2"`.
"""

import math
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError
from navbake.navgrid.grid import MultiLevelGrid, NavGrid, SceneGrid2D
from navbake.navgrid.islands import add_layers
from navbake.runtime.inflation.discs import disc_offsets, half_widths
from navbake.runtime.inflation.surroundings import SLAB, Surroundings, find_surroundings
from navbake.types import Bool, Float, Int

AnyGrid = TypeVar("AnyGrid", SceneGrid2D, MultiLevelGrid)

MODES = ("exact", "minos")
COSTS = ("step", "nav2")
LEDGES = ("avoid", "ignore")
STEP_COST = 10.0
LETHAL_COST = 252.0  # nav2's highest cost of a cell that is not blocked
SCALING = 10.0  # [1/m], nav2's default in code
MAX_RADIUS = 10_000.0  # [m]
LEAST_FLOOR = 0.7


def inflate(
    grid: AnyGrid,
    radius: float,
    clearance: float | None = None,
    mode: str = "exact",
    *,
    costs: str = "step",
    scaling: float = SCALING,
    ledges: str = "avoid",
) -> AnyGrid:
    """See `SceneGrid2D.inflate`."""
    check_arguments(radius, clearance, mode, costs=costs, scaling=scaling, ledges=ledges)
    if clearance is None:
        reaches_1 = math.log(LETHAL_COST) / scaling  # distance at which nav2's costs fall to 1
        clearance = min(reaches_1, MAX_RADIUS) if costs == "nav2" else 0.0
    weights = []
    for number, level in enumerate(grid.levels):
        cell = level.lattice.cell_size
        if mode == "minos":
            weights.append(_refined(level, radius / cell, (radius + clearance) / cell))
            continue
        blocked = find_blocked(grid, number, radius, ledges)
        soft = level.weights
        if "solid" in level.attributes:
            opened = ~blocked & level.free_for_point & ~level.free
            if opened.any():
                soft = np.where(opened, 1.0, soft)
        if costs == "nav2":
            falling = nav2_costs(level, radius, radius + clearance, scaling)
            soft = np.maximum(soft, np.clip(falling, 1.0, LETHAL_COST))
        elif clearance > 0:
            near = find_blocked(grid, number, radius + clearance, ledges)
            soft = np.where(near, np.maximum(soft, STEP_COST), soft)
        weights.append(np.where(blocked, np.inf, soft))
    done = {"radius": float(radius), "clearance": float(clearance), "mode": mode}
    if mode == "exact":
        done["ledges"] = ledges
    if clearance > 0:
        done |= {"costs": costs, "scaling": float(scaling)} if costs == "nav2" else {"costs": costs}
    return _with_weights(grid, weights, done)


def find_blocked(grid: NavGrid, number: int, radius: float, ledges: str = "avoid") -> Bool:
    """Find the cells of a level that `exact` blocks for a radius [m]; see the module's head.

    Cells that are not free before may be either.
    """
    from navbake.runtime.kernels.inflation import dilate  # saves numba at start-up

    cells = radius / grid.levels[number].lattice.cell_size
    around = find_surroundings(grid, number, math.ceil(cells) + 1)
    occupied = around.occupied[around.level]
    blocked: Bool = dilate(occupied, half_widths(cells, occupied.shape))
    if cells > 0:
        block_by_others(around, radius, disc_offsets(cells, occupied.shape)[0], ledges, blocked)
        _block_by_holes(around, cells, blocked)
    return blocked[around.rows, around.cols]


def find_blocked_by_others(
    grid: NavGrid, number: int, radius: float, ledges: str = "avoid"
) -> Bool:
    """Find the cells of a level within a radius [m] of anything but its own occupied cells.

    That is what `find_blocked` finds without them, and wherever another level's cells count.
    """
    cells = radius / grid.levels[number].lattice.cell_size
    around = find_surroundings(grid, number, math.ceil(cells) + 1)
    blocked: Bool = np.zeros(around.occupied.shape[1:], dtype=np.bool_)
    _block_by_holes(around, cells, blocked)
    # as if only other levels were occupied, and these wherever they have a floor
    others = np.ones_like(around.occupied)
    others[around.level] = 0
    offsets = disc_offsets(cells, blocked.shape)[0]
    block_by_others(replace(around, occupied=others), radius, offsets, ledges, blocked)
    return blocked[around.rows, around.cols]


def block_by_others(
    around: Surroundings, radius: float, offsets: Int, ledges: str, blocked: Bool
) -> None:
    """Add what other levels and floors block to `blocked`, and free what other levels free.

    `blocked` holds what the level's own occupied cells block, `offsets` the steps from an agent's
    cell to those that it meets; the radius [m] is the agent's, or of a circle around it.
    """
    from navbake.runtime.kernels.inflation import (  # saves numba at start-up
        block_above_drops,
        block_across,
        block_below_floors,
        tile_ranges,
    )

    floor, slopes, level = around.floor, around.slopes, around.level
    ranges = tile_ranges(floor)
    reach = int(np.abs(offsets).max(initial=0))
    if len(floor) > 1:
        overlap = around.height - around.step
        block_across(floor, around.occupied, ranges, level, offsets, overlap, reach, blocked)
    if radius > around.baked_radius:
        top = around.height + SLAB
        block_below_floors(floor, slopes, ranges, level, offsets, reach, around.step, top, blocked)
    if ledges == "avoid":
        block_above_drops(floor, slopes, ranges, level, offsets, reach, around.step, blocked)


def _block_by_holes(around: Surroundings, cells: float, blocked: Bool) -> None:
    """Block cells round which holes that are not occupied leave too little floor."""
    from navbake.runtime.kernels.inflation import block_near_holes, dilate  # saves numba

    has_floor = ~np.isnan(around.floor[around.level])
    holes = ~has_floor & (around.occupied[around.level] == 0)
    if not holes.any():
        return
    table = half_widths(cells, holes.shape, of_squares=False)
    todo = dilate(holes.view(np.uint8), table) & has_floor
    offsets, squares = disc_offsets(cells, holes.shape, of_squares=False)
    block_near_holes(has_floor, todo, offsets, squares, LEAST_FLOOR, blocked)


def _refined(level: SceneGrid2D, radius: float, far: float) -> Float:
    """The weights that the original client's ``refine`` gives.

    In cells: the radius, and the sum of radius and clearance. The client divides the sum, which
    in floating point is not the sum of the quotients.

    Source: sstk, ``NavScene.js``; the window leaves out its far row and column, as there.
    """
    from navbake.runtime.kernels.inflation import refine_window  # saves numba at start-up

    occupied = np.ascontiguousarray(level.occupancy)
    reach = math.ceil(far - 0.5)
    if reach <= 0:
        return np.where(occupied != 0, np.inf, 1.0)
    has_floor = ~np.isnan(level.floor_height)
    weights = np.empty(level.shape)
    reach = min(reach, max(level.shape) + 1)
    refine_window(occupied, has_floor, radius, far, reach, LEAST_FLOOR, weights)
    return weights


def nav2_costs(
    level: SceneGrid2D, radius: float, inflation_radius: float, scaling: float = SCALING
) -> NDArray[np.uint8]:
    """The costs that nav2's inflation layer gives the cells of a level.

    254 on occupied cells, 253 up to the inscribed radius, then ``floor(252 exp(-scaling (d -
    radius)))`` [1/m], 0 beyond the inflation radius [m]; d to the nearest occupied cell's centre.
    """
    from navbake.runtime.kernels.inflation import squared_distances  # saves numba at start-up

    cell = level.lattice.cell_size
    reach = min(math.ceil(inflation_radius / cell) + 1, sum(level.shape))
    squares = squared_distances(np.ascontiguousarray(level.solid), reach)
    # there are few different distances, so each cost is computed once and looked up
    known = np.sqrt(np.arange(2 * (reach + 1) ** 2 + 1)) * cell
    known[(reach + 1) ** 2 :] = np.inf
    slack = 1e-9 * cell
    falling = np.floor(LETHAL_COST * np.exp(-scaling * np.maximum(known - radius, 0)) + 1e-9)
    cost = np.where(known <= radius + slack, 253, falling)
    cost = np.where(known > inflation_radius + slack, 0, cost)
    cost[0] = 254
    costs: NDArray[np.uint8] = cost.astype(np.uint8)[squares]
    return costs


def check_radius(radius: float, name: str = "radius") -> None:
    """Raise a QueryError for anything but a number from 0 to 10,000 m."""
    is_number = isinstance(radius, int | float | np.integer | np.floating)
    if not is_number or isinstance(radius, bool) or not 0 <= radius <= MAX_RADIUS:
        raise QueryError(f"expected 0 to {MAX_RADIUS:,.0f} m as {name}, got {radius!r}")


def check_ledges(ledges: str) -> None:
    """Raise a QueryError for anything but ``avoid`` and ``ignore``."""
    if ledges not in LEDGES:
        raise QueryError(f"expected {' or '.join(LEDGES)} as ledges, got {ledges!r}")


def check_arguments(
    radius: float,
    clearance: float | None,
    mode: str,
    *,
    costs: str,
    scaling: float,
    ledges: str = "avoid",
) -> None:
    """Raise a QueryError for what `inflate` can't do."""
    check_radius(radius)
    if clearance is not None:
        check_radius(clearance, "clearance")
    for value, known, name in ((mode, MODES, "mode"), (costs, COSTS, "costs")):
        if value not in known:
            raise QueryError(f"expected {' or '.join(known)} as {name}, got {value!r}")
    check_ledges(ledges)
    if mode == "minos" and costs != "step":
        raise QueryError("mode minos has costs of its own (step): leave `costs` out")
    is_number = isinstance(scaling, int | float | np.integer | np.floating)
    if not is_number or not 0 < scaling < math.inf:
        raise QueryError(f"expected a number > 0 [1/m] as scaling, got {scaling!r}")


def _with_weights(grid: AnyGrid, weights: list[Float], done: dict[str, Any]) -> AnyGrid:
    """The grid with other weights, layers that follow from them, and a note in its metadata."""
    levels = []
    for level, weight in zip(grid.levels, weights, strict=True):
        # Attributes that a file without them would derive from the weights are stored first, so
        # that inflating does not change them, and the grid can be inflated again.
        baked: dict[str, Any] = {"occupancy": level.occupancy, "floorHeight": level.floor_height}
        kept = {key: v.copy() for key, v in baked.items() if key not in level.attributes}
        if not level.uses_cell_floors:  # what the file stores is not the floor
            kept["floorHeight"] = baked["floorHeight"].copy()
        noted = _noted(level.metadata, done)
        levels.append(level.with_layers(weights=weight, attributes=kept, metadata=noted))
    inflated = grid.with_levels(levels, _noted(grid.metadata, done))
    if grid.navbake:  # in files of other programs these names may mean anything
        names = {name for level in levels for name in level.attributes}
        add_layers(inflated, names & {"island", "clearance"})
    return inflated


def _noted(metadata: dict[str, Any], done: dict[str, Any]) -> dict[str, Any]:
    earlier = metadata.get("inflation")
    return {**metadata, "inflation": [*(earlier if isinstance(earlier, list) else []), done]}
