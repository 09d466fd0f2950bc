"""Blocks of a grid's cells for moving things, and the grids for agents of other sizes.

A block changes the grid's layers in place, until it is freed; grids made for other agents follow.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any
from weakref import WeakSet

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.navgrid.cells import Cell, Cells, check_cells, check_level, check_positions
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import clearance, renew_islands, step_limit
from navbake.navgrid.links import Agent
from navbake.navgrid.obstacle_state import (
    BLOCKED,
    CHANGING,
    NUM_LAYERS,
    OCCUPIED,
    OCCUPIED_LAYERS,
    Layers,
    ObstacleState,
)
from navbake.runtime.inflation import check_radius, ledges_of, margins_of
from navbake.types import Float, Int

if TYPE_CHECKING:
    from typing_extensions import Self

SAME = 1e-9  # [m] between two sizes that are one
ROUNDING = 1e-5  # [m] of floors in files, which are float32


class AddedObstacle:
    """Cells that are blocked until `free` is called, or until the end of a with statement.

    Attributes:
        cells: flat ids of the cells where an agent can't stand because of the block, by level, each
            ascending, int64; including cells that were not free before.
        arguments: of `grid.block` that made it.
    """

    def __init__(
        self, grid: NavGrid, layers: list[Layers], arguments: dict[str, Any] | None = None
    ) -> None:
        self.arguments = arguments or {}
        self._grid = grid
        self.copies: list[AddedObstacle] = []  # on grids for agents of other sizes
        self.cells = [of_level[BLOCKED] for of_level in layers]
        self._held: list[tuple[SceneGrid2D, ObstacleState, Layers]] = []
        for level, of_level in zip(grid.levels, layers, strict=True):
            if any(len(ids) for ids in of_level):
                state = level.obstacle_state = level.obstacle_state or _begin(level)
                _change(level, state, of_level, is_held=True)
                self._held.append((level, state, of_level))
        grid.obstacles.append(self)

    def free(self) -> None:
        """Free the cells, except those held by other blocks. Further calls do nothing."""
        for level, state, of_level in self._held:
            _change(level, state, of_level, is_held=False)
        self._held.clear()
        for copied in self.copies:
            copied.free()
        if self in self._grid.obstacles:
            self._grid.obstacles.remove(self)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.free()


def _begin(level: SceneGrid2D) -> ObstacleState:
    """The state of an unblocked level; the level gets writable copies of its arrays."""
    # others may share the level's arrays, or they may be read-only
    level.weights = np.array(level.weights, order="C")
    level.attributes = dict(level.attributes)
    for name in CHANGING & level.attributes.keys():
        level.attributes[name] = np.array(level.attributes[name], order="C")
    occupied = {
        name: level.attributes[name].copy() for name in OCCUPIED_LAYERS if name in level.attributes
    }
    return ObstacleState(level.weights.copy(), occupied, _farthest(level))


def _change(level: SceneGrid2D, state: ObstacleState, cells: Layers, *, is_held: bool) -> None:
    """AddedObstacle or free cells."""
    count = state.count.reshape(len(cells), -1)
    for number, ids in zip(count, cells, strict=True):
        if is_held:
            number[ids] += 1
        else:
            number[ids] -= 1
    changed: list[tuple[int, NDArray[Any], NDArray[Any], float]] = [
        (BLOCKED, level.weights, state.weights, np.inf),
        *((OCCUPIED, level.attributes[name], own, 1.0) for name, own in state.occupied.items()),
    ]
    for layer, array, clean, value in changed:
        now = array.reshape(-1)
        before = clean.reshape(-1)
        ids = cells[layer]
        if is_held:
            # the first block reads the arrays again: they are writable
            first = ids[count[layer, ids] == 1]
            before[first] = now[first]
            now[first] = value
        else:
            left = ids[count[layer, ids] == 0]
            now[left] = before[left]
    # one window for all layers
    rows, cols = np.divmod(np.concatenate(cells), level.width)
    window = (int(rows.min()), int(rows.max()) + 1, int(cols.min()), int(cols.max()) + 1)
    state.log_change(window)
    if state.farthest is None:
        return
    # No clearance exceeds that without blocks, so cells farther from the window keep theirs; the
    # nearest blocked cell of one at the rim of `inner` may be a whole reach further out.
    reach = math.ceil(state.farthest) + 2
    inner, outer = (
        (
            max(window[0] - by, 0), min(window[1] + by, level.height),
            max(window[2] - by, 0), min(window[3] + by, level.width),
        )
        for by in (reach, 2 * reach)
    )  # fmt: skip
    row0, row1, col0, col1 = inner
    here = np.s_[row0 - outer[0] : row1 - outer[0], col0 - outer[2] : col1 - outer[2]]
    level.attributes["clearance"][row0:row1, col0:col1] = clearance(level, outer)[here]


def _farthest(level: SceneGrid2D) -> float | None:
    """The largest clearance of a level, in cells; None without that layer."""
    stored = level.attributes.get("clearance")
    if stored is None:
        return None
    measured = clearance(level)
    # in files of other programs, a layer of this name may mean anything
    if stored.dtype != measured.dtype or not np.allclose(stored, measured, atol=1e-5):
        return None
    return float(measured.max(initial=0)) / level.lattice.cell_size


def block(
    grid: NavGrid,
    *,
    cells: Cell | Cells | None = None,
    disc: tuple[ArrayLike, float] | None = None,
    box: tuple[ArrayLike, ArrayLike] | None = None,
    level: int | None = None,
    height: float | None = None,
    margin: float | None = None,
) -> AddedObstacle:
    """AddedObstacle cells of a grid for a moving thing until they are freed.

    The grid's weights, occupancy and ``clearance`` layer change in place, and each
    `PathFinder` on it takes the change over, those of agents of other sizes with the margin of
    theirs. Blocks may overlap. A disc or box blocks the cells
    where an agent on the floor would collide with it: their square overlaps it, or a disc of
    `margin` round their centre does. Grids derived from this one keep its current blocks.

    Free the cells by `free` of the returned block, or use the block as a context manager.

    Args:
        cells: level, row and column, as `cell_at` and `cells_at` return them; without the rest.
        disc: centre and radius [m]; blocks all levels that it reaches into from the centre's z
            up, or the level's whole height if the centre is x, y.
        box: lower and upper corner, world frame [m]; of the level's height if x, y.
        level: block this level only; then a position needs no z.
        height: of the disc [m]; the agent's if None.
        margin: the agent's radius [m]; if None, that of the inflation, else of the bake.

    Raises:
        QueryError: not exactly one of cells, disc and box is given, or it is not valid.
    """
    given: dict[str, Any] = {
        "cells": cells, "disc": disc, "box": box, "level": level, "height": height, "margin": margin
    }  # fmt: skip
    made = AddedObstacle(grid, _find_layers(grid, **given), given)
    made.copies += [block(fitted, **given) for fitted in grid.fitted_grids or ()]
    return made


def _find_layers(
    grid: NavGrid,
    cells: Cell | Cells | None,
    disc: tuple[ArrayLike, float] | None,
    box: tuple[ArrayLike, ArrayLike] | None,
    level: int | None,
    height: float | None,
    margin: float | None,
) -> list[Layers]:
    """The cells of each layer of a block's, by level."""
    if sum(thing is not None for thing in (cells, disc, box)) != 1:
        raise QueryError("expected one of cells, disc and box to block")
    check_level(level, len(grid.levels))
    if cells is not None:
        number, row, col = check_cells(grid, cells)
        ids = [(row * part.width + col)[number == k] for k, part in enumerate(grid.levels)]
        return [[np.unique(of_level)] * NUM_LAYERS for of_level in ids]
    # an upright obstacle; from above, a rectangle dilated by a radius
    radius = 0.0
    tall = 0.0
    levels = len(grid.levels)
    wanted = "a disc's centre and radius" if disc else "a box's lower and upper corner"
    things: Any = disc or box
    try:
        one, other = things
    except (TypeError, ValueError):
        raise QueryError(f"expected {wanted}, got {things!r}") from None
    if disc is not None:
        low = high = check_positions(one, levels, level)
        if low.ndim != 1:
            raise QueryError(f"expected one centre of a disc, got an array of shape {low.shape}")
        check_radius(radius := other, "radius of a disc")
        if height is not None:
            check_radius(height, "height of a disc")
        tall = grid.agent_height if height is None else height
    else:
        low = check_positions(one, levels, level)
        high = check_positions(other, levels, level)
        if low.ndim != 1 or low.shape != high.shape or (low > high).any():
            raise QueryError(f"expected {wanted}, got {low} and {high}")
    bottom, top = (low[2], high[2] + tall) if len(low) == 3 else (-math.inf, math.inf)
    margins = (0.0, *margins_of(grid, margin))
    step = step_limit(grid) * grid.unit

    def away(x: Float, y: Float, half: float) -> Float:
        """Distances from the rectangle to squares of half edge `half` round points."""
        dx = np.maximum(np.maximum(low[0] - x, x - high[0]) - half, 0.0)
        dy = np.maximum(np.maximum(low[1] - y, y - high[1]) - half, 0.0)
        return np.asarray(np.hypot(dx, dy))

    layers: list[Layers] = []
    for k, part in enumerate(grid.levels):
        size = part.lattice.cell_size
        reach = radius + max(margins[-1], size)
        window = part.lattice.window(np.array([low[:2], high[:2]]), reach)
        if level not in (None, k) or window is None:
            layers.append([np.empty(0, dtype=np.int64)] * NUM_LAYERS)
            continue
        rows, cols = window
        x = part.lattice.center_x()[cols]
        y = part.lattice.center_y()[rows, None]
        floor = part.floor_of(rows, cols)
        floor = np.where(np.isnan(floor), part.ground, floor)
        in_band = (bottom < floor + grid.agent_height) & (top > floor + step)
        to_square = away(x, y, size / 2)
        gap = away(x, y, 0.0)
        # a disc is open: it may touch a square. A box is closed, so that a flat one blocks cells.
        meets = in_band & (to_square < radius if radius > 0 else to_square <= 0)
        held = [meets | (in_band & (gap < radius + more)) for more in margins]
        first = np.arange(rows.start, rows.stop)[:, None] * part.width
        inside: Int = first + np.arange(cols.start, cols.stop)
        layers.append([inside[mask] for mask in held])
    return layers


def find_agent(grid: NavGrid, agent: str | Agent | None) -> Agent | None:
    """The agent of a name that the grid lists; an agent, or None, as it is given."""
    if agent is None or isinstance(agent, Agent):
        return agent
    known: Mapping[str, Agent] = grid.agents
    if agent not in known:
        raise QueryError(f"no agent {agent!r} in {grid.scene_id!r}: {suggest(agent, known)}")
    return known[agent]


def fit_grid(grid: NavGrid, agent: Agent | None) -> NavGrid:
    """The grid for an agent's size: inflated to its radius, with steps as low as it takes.

    It follows the blocks of the given grid, which is returned itself if it fits. Goes by floors
    alone where steps are lowered: a ramp that rises more over a cell is none for the agent.

    Raises:
        QueryError: the agent is higher, takes higher steps, or is smaller than the grid was
            inflated for.
    """
    if agent is None:
        return grid
    of = f"the grid of {grid.scene_id or 'scene'!r}"
    name = f" (agent {agent.name!r})"
    name = name if agent.name else ""
    for what, key, stated, most in (
        ("agents", "height", agent.height, grid.agent_height),
        ("steps", "traversable_floor_height", agent.step, grid.max_step),
    ):
        if stated is not None and stated > most + SAME:
            got = f"got {stated:g} m{name}: bake it with agent.{key}={stated:g}"
            raise QueryError(f"{of} is for {what} up to {most:g} m, {got}")
    clean: NavGrid = grid.without_blocks()
    fitted = clean
    radius = agent.radius
    if agent.step is not None and agent.step < grid.max_step - SAME:
        floor = np.concatenate([level.floor.ravel() for level in clean.levels])
        start = np.cumsum([0] + [level.width * level.height for level in clean.levels])
        ends = start[clean.step_array[:, ::2]] + clean.step_array[:, 1::2]
        is_low = np.abs(np.diff(floor[ends])[:, 0]) <= agent.step + ROUNDING
        metadata = {**clean.metadata, "traversableFloorHeight": agent.step / clean.unit}
        if not is_low.all():
            links = [*clean.step_array[is_low].tolist(), *(link.to_json() for link in clean.links)]
            metadata["navbake"] = {**clean.navbake, "links": links}
        fitted = clean.with_levels([level.with_layers() for level in clean.levels], metadata)
        renew_islands(fitted)
    if radius is not None and not math.isclose(radius, grid.radius, abs_tol=SAME):
        check_radius(radius)
        if radius < grid.inflated_radius:
            got = f"got {radius:g} m{name}: plan on the grid as it was baked"
            raise QueryError(f"{of} was inflated to {grid.radius:g} m, {got}")
        fitted = fitted.inflate(radius, ledges=ledges_of(grid))
    if fitted is clean:
        return grid
    grid.fitted_grids = grid.fitted_grids or WeakSet()
    grid.fitted_grids.add(fitted)
    for held in grid.obstacles:
        held.copies.append(block(fitted, **held.arguments))
    return fitted
