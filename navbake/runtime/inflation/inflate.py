"""The same grid for a larger agent: cells that it can't stand on, and costs near walls.

How `exact` decides, for an agent whose centre is on a cell's centre:

- Occupied cells: the agent must not meet their squares. The bake has made a cell occupied where
  something meets its square or the disc of the baked radius round its centre, so all baked
  geometry lies in occupied squares. The baked radius is replaced, not added to.
- Higher floors that the agent meets: at most a step above its own. A ledge is a wall from below,
  and so is the step after the next one for an agent too large for the stair. Up to the baked
  radius the bake has decided this, more precisely than squares can. Lower floors are ignored.
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
) -> AnyGrid:
    """See `SceneGrid2D.inflate`."""
    check_arguments(radius, clearance, mode, costs, scaling)
    if clearance is None:
        reaches_1 = math.log(LETHAL_COST) / scaling  # distance at which nav2's costs fall to 1
        clearance = min(reaches_1, MAX_RADIUS) if costs == "nav2" else 0.0
    weights = []
    for number, level in enumerate(grid.levels):
        cell = level.lattice.cell_size
        if mode == "minos":
            weights.append(_refined(level, radius / cell, clearance / cell))
            continue
        blocked = find_blocked(grid, number, radius)
        soft = level.weights
        if costs == "nav2":
            falling = nav2_costs(level, radius, radius + clearance, scaling)
            soft = np.maximum(soft, np.clip(falling, 1.0, LETHAL_COST))
        elif clearance > 0:
            near = find_blocked(grid, number, radius + clearance)
            soft = np.where(near, np.maximum(soft, STEP_COST), soft)
        weights.append(np.where(blocked, np.inf, soft))
    done = {"radius": float(radius), "clearance": float(clearance), "mode": mode}
    if clearance > 0:
        done |= {"costs": costs, "scaling": float(scaling)} if costs == "nav2" else {"costs": costs}
    return _with_weights(grid, weights, done)


def find_blocked(grid: NavGrid, number: int, radius: float) -> Bool:
    """Find the cells of a level that `exact` blocks for a radius [m]; see the module's head.

    Cells that are not free before may be either.
    """
    from navbake.runtime.kernels.inflation import dilate  # saves numba at start-up

    cells = radius / grid.levels[number].lattice.cell_size
    around = find_surroundings(grid, number, math.ceil(cells) + 1)
    occupied = around.occupied[around.level]
    blocked: Bool = dilate(occupied, half_widths(cells, occupied.shape))
    if cells > 0:
        block_by_others(around, radius, disc_offsets(cells, occupied.shape)[0], blocked)
        _block_by_holes(around, cells, blocked)
    return blocked[around.rows, around.cols]


def block_by_others(around: Surroundings, radius: float, offsets: Int, blocked: Bool) -> None:
    """Add what other levels and higher floors block to `blocked`, and free what they free.

    `blocked` holds what the level's own occupied cells block, `offsets` the steps from an agent's
    cell to those that it meets; the radius [m] is the agent's, or of a circle around it.
    """
    from navbake.runtime.kernels.inflation import block_across, block_below_floors  # saves numba

    floor, level = around.floor, around.level
    reach = int(np.abs(offsets).max(initial=0))
    if len(floor) > 1:
        overlap = around.height - around.step
        block_across(floor, around.occupied, level, offsets, overlap, reach, blocked)
    if radius > around.baked_radius:
        top = around.height + SLAB
        block_below_floors(floor, level, offsets, reach, around.step, top, blocked)


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


def _refined(level: SceneGrid2D, radius: float, clearance: float) -> Float:
    """The weights that the original client's ``refine`` gives; radius and clearance in cells.

    Source: sstk, ``NavScene.js``; the window leaves out its far row and column, as there.
    """
    from navbake.runtime.kernels.inflation import refine_window  # saves numba at start-up

    occupied = np.ascontiguousarray(level.occupancy)
    reach = math.ceil(radius + clearance - 0.5)
    if reach <= 0:
        return np.where(occupied != 0, np.inf, 1.0)
    has_floor = ~np.isnan(level.floor_height)
    weights = np.empty(level.shape)
    reach = min(reach, max(level.shape) + 1)
    refine_window(occupied, has_floor, radius, clearance, reach, LEAST_FLOOR, weights)
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
    squares = squared_distances(np.ascontiguousarray(level.occupancy), reach)
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


def check_arguments(
    radius: float, clearance: float | None, mode: str, costs: str, scaling: float
) -> None:
    """Raise a QueryError for what `inflate` can't do."""
    check_radius(radius)
    if clearance is not None:
        check_radius(clearance, "clearance")
    for value, known, name in ((mode, MODES, "mode"), (costs, COSTS, "costs")):
        if value not in known:
            raise QueryError(f"expected {' or '.join(known)} as {name}, got {value!r}")
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
