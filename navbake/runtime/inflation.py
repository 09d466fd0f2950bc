"""Inflates a grid: blocked cells for a larger agent, costs near walls, and footprints.

`navbake.runtime.surroundings` has the rule for blocked cells. A footprint must not overlap an
occupied cell's square (touching is allowed) and needs a floor under its origin only.

In an inflated grid, free means that an agent fits at a cell's centre. Diagonal steps therefore need
cells that are free for a larger radius, whose discs at both ends cover the way. Lines off the
centres need cells in which the agent fits anywhere; or cells with only squares of their own level
nearby, where a sweep of the disc decides. Beside a step of the floor, which is known to half a cell
only, steps go from centre to centre.

Source: ``refine`` of the original client (sstk, ``NavScene.js``) for `minos` and the share of
floor; the inflation layer of nav2 (``nav2_costmap_2d``) for `costs="nav2"`.
"""

import math
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.lazy import lazy
from navbake.navgrid.grid import MAX_RADIUS, MultiLevelGrid, NavGrid, SceneGrid2D
from navbake.navgrid.islands import add_layers
from navbake.navgrid.lattice import Lattice, find_outline_fault, touch_cells
from navbake.runtime import surroundings
from navbake.runtime.flat_grid import REAL
from navbake.runtime.surroundings import find_blocked
from navbake.types import Bool, Float, Int, Int32

ndimage = lazy("scipy.ndimage")

AnyGrid = TypeVar("AnyGrid", SceneGrid2D, MultiLevelGrid)

MODES = ("exact", "minos")
COSTS = ("step", "nav2")
LEDGES = ("avoid", "ignore")
STEP_COST = 10.0
LETHAL_COST = 252.0  # nav2's highest cost of a cell that is not blocked
SCALING = 10.0  # [1/m], nav2's default in code
STEEP = 1.001  # rise, in cells, over which neighbours are a step, not a slope
MAX_HEADINGS = 720
MAX_REACH = 1000  # [cells] of a footprint


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
    """Inflate a grid for an agent of another radius; the metadata list it under ``inflation``.

    ``exact``: a cell stays free if the open disc of the radius round its centre overlaps no
    occupied cell's square, and no floor more than a step higher or lower (see
    `navbake.runtime.surroundings`). The radius replaces the baked one. ``minos``: the weights of
    the original client's ``refine``, cell for cell.

    A blocked cell stays so, unless only the baked disc blocked it (see `SceneGrid2D.solid`;
    or in ``refine`` at radius 0 with a clearance). Occupancy stays as baked.

    Args:
        radius: of the agent [m], 0 to 10,000.
        clearance: how far beyond the radius cells cost more [m]; None is 0 for ``step``, and
            the distance where the cost falls to 1 for ``nav2``.
        mode: ``exact`` or ``minos``.
        costs: the least weight of such a cell: ``step``, 10; ``nav2``, the cost of nav2's
            inflation layer, ``floor(252 exp(-scaling (d - radius)))``, d from the centre of
            the nearest occupied cell of the level.
        scaling: of ``nav2`` [1/m], > 0.
        ledges: of ``exact``: ``avoid`` keeps the disc off floors more than a step lower,
            ``ignore`` allows it to overhang them.
    """
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
            soft = np.where(level.free_for_point & ~level.free, 1.0, soft)
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

    def noted(metadata: dict[str, Any]) -> dict[str, Any]:
        earlier: Any = metadata.get("inflation")
        return {**metadata, "inflation": [*(earlier if isinstance(earlier, list) else []), done]}

    levels = []
    for level, weight in zip(grid.levels, weights, strict=True):
        # Attributes that a file without them would derive from the weights are stored first, so
        # that inflating does not change them, and the grid can be inflated again.
        baked: dict[str, Any] = {"occupancy": level.occupancy, "floorHeight": level.floor_height}
        kept = {key: v.copy() for key, v in baked.items() if key not in level.attributes}
        if not level.uses_cell_floors:  # the file's values are not the floor
            kept["floorHeight"] = baked["floorHeight"].copy()
        metadata = noted(level.metadata)
        levels.append(level.with_layers(weights=weight, attributes=kept, metadata=metadata))
    inflated = grid.with_levels(levels, noted(grid.metadata))
    if grid.navbake:  # in files of other programs these names may mean anything
        names = {name for level in levels for name in level.attributes}
        add_layers(inflated, names & {"island", "clearance"})
    return inflated


def _refined(level: SceneGrid2D, radius: float, far: float) -> Float:
    """The weights of the original client's ``refine``, by radii in cells.

    The client divides the sum of radius and clearance; its window lacks its far row and column.
    """
    occupied = level.occupancy != 0
    reach = min(math.ceil(far - 0.5), max(level.shape) + 1)
    if reach <= 0:
        return np.where(occupied, np.inf, 1.0)
    steps = np.arange(-reach, reach)
    squares = steps[:, None] ** 2 + steps**2
    inner = _to_runs(np.argwhere(squares < radius * radius) - reach)
    outer = _to_runs(np.argwhere(squares < far * far) - reach)
    masks = (occupied, np.ones_like(occupied), ~np.isnan(level.floor_height))
    hits, within, with_floor = (count_runs(mask, inner) for mask in masks)
    too_few = (within > 0) & (with_floor / np.maximum(within, 1) < surroundings.LEAST_FLOOR)
    soft = np.where(count_runs(occupied, outer) > 0, STEP_COST, 1.0)
    return np.where((hits > 0) | too_few, np.inf, soft)


def nav2_costs(
    level: SceneGrid2D, radius: float, inflation_radius: float, scaling: float = SCALING
) -> NDArray[np.uint8]:
    """The costs of nav2's inflation layer for a level's cells.

    254 on occupied cells, 253 up to the inscribed radius, then ``floor(252 exp(-scaling (d -
    radius)))`` [1/m], 0 beyond the inflation radius [m]; d to the nearest occupied cell's centre.
    """
    solid = level.solid != 0
    cell = level.lattice.cell_size
    if not solid.any():
        return np.zeros(level.shape, dtype=np.uint8)
    # squared distances in cells are whole numbers: tabulate their costs
    squares = np.rint(ndimage.distance_transform_edt(~solid) ** 2).astype(np.int32)
    last = min(int(squares.max()), math.ceil((inflation_radius / cell) ** 2 * 1.001) + 1)
    distance = np.sqrt(np.arange(last + 1)) * cell
    slack = 1e-9 * cell
    falling = np.floor(LETHAL_COST * np.exp(-scaling * np.maximum(distance - radius, 0)) + 1e-9)
    cost = np.where(distance <= radius + slack, 253, falling)
    cost[distance > inflation_radius + slack] = 0
    cost[0] = 254
    costs: NDArray[np.uint8] = cost.astype(np.uint8).take(squares, mode="clip")
    return costs


def check_radius(radius: float, name: str = "radius") -> None:
    """Raise a QueryError for anything but a number from 0 to 10,000 m."""
    if not isinstance(radius, REAL) or isinstance(radius, bool) or not 0 <= radius <= MAX_RADIUS:
        raise QueryError(f"expected 0 to {MAX_RADIUS:,.0f} m as {name}, got {radius!r}")


def check_word(value: str, known: tuple[str, ...], name: str) -> None:
    if value not in known:
        raise QueryError(f"expected {' or '.join(known)} as {name}, got {value!r}")


def check_arguments(
    radius: float, clearance: float | None, mode: str, *, costs: str, scaling: float, ledges: str
) -> None:
    """Raise a QueryError for arguments that `inflate` doesn't take."""
    check_radius(radius)
    if clearance is not None:
        check_radius(clearance, "clearance")
    check_word(mode, MODES, "mode")
    check_word(costs, COSTS, "costs")
    check_word(ledges, LEDGES, "ledges")
    if mode == "minos" and costs != "step":
        raise QueryError("mode minos has costs of its own (step): leave `costs` out")
    if not isinstance(scaling, REAL) or not 0 < scaling < math.inf:
        raise QueryError(f"expected a number > 0 [1/m] as scaling, got {scaling!r}")


def ledges_of(grid: NavGrid) -> str:
    """The `ledges` of the grid's inflation; ``ignore`` in files without it, ``avoid`` for none."""
    avoids = any(entry.get("ledges") == "avoid" for entry in grid.exact_inflations)
    return "avoid" if avoids or not grid.inflated_radius else "ignore"


def margins_of(grid: NavGrid, radius: float | None = None) -> tuple[float, float, float]:
    """Least distances [m] from a block to stand, to step diagonally, and to be off the centre."""
    if radius is not None:
        check_radius(radius, "margin")
    radius = grid.radius if radius is None else float(radius)
    if not grid.inflated_radius:
        return radius, radius, radius
    return radius, *_larger(radius, max(p.lattice.cell_size for p in grid.levels))


def find_room(grid: NavGrid) -> tuple[Bool, Bool, Bool] | None:
    """Find the cells of an inflated grid where an agent fits off their centres.

    Returns three masks over flat cells, False beside a step of the floor: (1) fits on a diagonal
    step; (2) fits anywhere in the cell; (3) as 2, but cells blocked only by occupied squares of
    their own level count, too. None if the radius is 0.
    """
    radius = grid.inflated_radius
    if radius == 0.0:
        return None
    ledges = ledges_of(grid)
    masks = []
    for number, level in enumerate(grid.levels):
        # not beside a neighbour whose floor is a step higher or lower, not a slope
        floor = level.floor_height.astype(np.float64)
        inside = np.ones(level.shape, dtype=np.bool_)
        for near, far in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
            is_step = np.abs(floor[near] - floor[far]) > STEEP * level.cell_size  # False for NaN
            inside[near] &= ~is_step
            inside[far] &= ~is_step
        diagonal, anywhere = _larger(radius, level.lattice.cell_size)
        is_clear = inside & ~find_blocked(grid, number, anywhere, ledges)
        by_squares = inside & ~find_blocked(grid, number, anywhere, ledges, by_own=False)
        can_turn = inside & ~find_blocked(grid, number, diagonal, ledges)
        masks.append([mask.ravel() for mask in (can_turn, is_clear, is_clear | by_squares)])
    one, two, three = (np.concatenate(parts) for parts in zip(*masks, strict=True))
    return one, two, three


def _larger(radius: float, cell_size: float) -> tuple[float, float]:
    """Radii [m] at a cell's centre that free a diagonal step, and any position in the cell."""
    # Halfway along a diagonal step, half a diagonal from both ends, a point at distance r from the
    # way is the farthest from them: sqrt(r² + (s / sqrt 2)²). A corner of the cell is s / sqrt 2
    # from its centre.
    return math.sqrt(radius**2 + cell_size**2 / 2), radius + cell_size / math.sqrt(2)


def inflate_footprint(
    grid: NavGrid, polygon: ArrayLike, num_headings: int = 16, *, ledges: str = "avoid"
) -> list[Bool]:
    """Find where an agent with a polygonal footprint can stand, by heading.

    Args:
        polygon: its outline from above, shape (n, 2), n >= 3, in its own frame [m]: x ahead,
            y to the left, its centre at the origin. Without crossings.
        num_headings: number k is ``2 π k / num_headings``, counter-clockwise from the world's x.
        ledges: as of `inflate`.

    Returns:
        For each level, shape (num_headings, height, width), bool: whether the cell is free
        and the polygon, its origin on the cell's centre, overlaps no occupied cell's square.
    """
    check_word(ledges, LEDGES, "ledges")
    wanted = "expected a polygon of shape (n, 2) [m]"
    try:
        outline = np.asarray(polygon, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise QueryError(f"{wanted}, got {polygon!r}") from error
    if outline.ndim != 2 or outline.shape[1] != 2 or len(outline) < 3:
        raise QueryError(f"{wanted}, n >= 3, got {outline.shape}")
    if not np.isfinite(outline).all():
        raise QueryError("expected a polygon of finite numbers [m]")
    fault = find_outline_fault(outline)
    if fault:
        raise QueryError(f"expected the outline of an area, got {fault}")
    if not isinstance(num_headings, int | np.integer) or not 1 <= num_headings <= MAX_HEADINGS:
        raise QueryError(f"expected 1 to {MAX_HEADINGS} headings, got {num_headings!r}")
    masks = []
    for number, level in enumerate(grid.levels):
        radius = float(np.hypot(*outline.T).max())
        cell = level.lattice.cell_size
        reach = math.ceil(radius / cell) + 1
        if reach > MAX_REACH:
            raise QueryError(f"expected a polygon within {MAX_REACH} cells, got one of {reach}")
        stack, inside = surroundings.find_surroundings(grid, number, reach)
        free = np.empty((num_headings, *level.shape), dtype=np.bool_)
        # the cells round the agent's, by which the polygon's squares are found in their unit
        around = Lattice(-reach - 0.5, reach + 0.5, 1.0, 2 * reach + 1, 2 * reach + 1)
        for k in range(num_headings):
            angle = 2 * math.pi * k / num_headings
            cos = math.cos(angle)
            sin = math.sin(angle)
            x, y = outline.T / cell
            turned = np.stack([cos * x - sin * y, sin * x + cos * y], axis=1)
            offsets = np.ascontiguousarray(np.argwhere(touch_cells([turned], around)) - reach)
            runs = _to_runs(offsets)
            blocked = count_runs(stack.occupied[stack.level] != 0, runs) > 0
            surroundings.block_by_others(grid, number, stack, radius, offsets, ledges, blocked)
            free[k] = level.free_for_point & ~blocked[inside]
        masks.append(free)
    return masks


def count_runs(mask: Bool, runs: Int) -> Int32:
    """Count the marked cells under a shape of runs (row, first column, last column)."""
    rows, cols = mask.shape
    pad = int(np.abs(runs).max(initial=0)) + 1
    before = np.cumsum(np.pad(mask, pad), axis=1, dtype=np.int32)  # a run is one difference
    count = np.zeros(mask.shape, dtype=np.int32)
    for row, first, last in (runs + pad).tolist():
        line = before[row : row + rows]
        count += line[:, last : last + cols] - line[:, first - 1 : first - 1 + cols]
    return count


def _to_runs(offsets: Int) -> Int:
    """Pack steps (row, col) into runs: row, first column, last column."""
    row, col = offsets.T
    is_first = np.ones(len(row), dtype=np.bool_)
    is_first[1:] = (row[1:] != row[:-1]) | (col[1:] != col[:-1] + 1)
    is_last = np.roll(is_first, -1)
    return np.stack([row[is_first], col[is_first], col[is_last]], axis=1)
