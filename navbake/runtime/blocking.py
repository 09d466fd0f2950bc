"""Obstacles that are added to a grid while it is in use.

An obstacle changes the grid's layers in place, until it is freed. It also blocks the grids that
were made from this one for other agents.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError, count_of
from navbake.navgrid.cells import Cell, Cells, check_cells, check_level, check_positions
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import measure_clearance, step_limit
from navbake.navgrid.obstacle_state import (
    BLOCKED,
    CHANGING_ATTRIBUTES,
    NUM_LAYERS,
    OCCUPIED,
    OCCUPIED_ATTRIBUTES,
    CellRange,
    Layers,
    ObstacleState,
)
from navbake.runtime.inflation import check_radius, compute_margins
from navbake.types import Float, Int

if TYPE_CHECKING:
    from typing_extensions import Self


class BlockArguments(TypedDict):
    """The arguments of a call of `block`, by which the same obstacle is added to other grids.

    `block` describes each of them.
    """

    cells: Cell | Cells | None
    disc: tuple[ArrayLike, float] | None
    box: tuple[ArrayLike, ArrayLike] | None
    level: int | None
    height: float | None
    margin: float | None


class AddedObstacle:
    """Cells that are blocked until `free` is called, or until the end of a with statement.

    `SceneGrid2D.block` makes it.

    Attributes:
        cells: for each level, the ids (row * width + column) of the cells where an agent can't
            stand because of the obstacle, ascending, int64. Cells that were not free before are
            included.
        arguments: the arguments of the call of `grid.block` that made the obstacle.
        copies: the same obstacle on grids for agents of other sizes.

    Example:
        >>> cart = grid.block(disc=((2.0, 1.0, 0.0), 0.3))
        >>> cart.free()
    """

    def __init__(
        self, grid: NavGrid, layers_by_level: list[Layers], arguments: BlockArguments
    ) -> None:
        self.arguments = arguments
        self.copies: list[AddedObstacle] = []
        self.cells = [level_layers[BLOCKED] for level_layers in layers_by_level]
        self._grid = grid
        self._blocked_levels: list[tuple[SceneGrid2D, ObstacleState, Layers]] = []
        for level, level_layers in zip(grid.levels, layers_by_level, strict=True):
            if any(len(ids) for ids in level_layers):
                if level.obstacle_state is None:
                    level.obstacle_state = _make_obstacle_state(level)
                _change_counts(level, level.obstacle_state, level_layers, is_added=True)
                self._blocked_levels.append((level, level.obstacle_state, level_layers))
        grid.obstacles.append(self)

    def __repr__(self) -> str:
        num_cells = sum(len(ids) for ids in self.cells)
        return f"AddedObstacle({count_of(num_cells, 'cell')})"

    def free(self) -> None:
        """Free the cells, except those that other obstacles block. A second call does nothing."""
        for level, obstacle_state, level_layers in self._blocked_levels:
            _change_counts(level, obstacle_state, level_layers, is_added=False)
        self._blocked_levels.clear()
        for fitted_copy in self.copies:
            fitted_copy.free()
        if self in self._grid.obstacles:
            self._grid.obstacles.remove(self)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.free()


def _make_obstacle_state(level: SceneGrid2D) -> ObstacleState:
    """Make the state of a level without obstacles yet; give it writable copies of its arrays."""
    # other grids may share the level's arrays, or they may be read-only
    level.weights = np.array(level.weights, order="C")
    level.attributes = dict(level.attributes)
    for name in CHANGING_ATTRIBUTES & level.attributes.keys():
        level.attributes[name] = np.array(level.attributes[name], order="C")
    attributes_without_obstacles = {
        name: level.attributes[name].copy()
        for name in OCCUPIED_ATTRIBUTES
        if name in level.attributes
    }
    layer_of_attribute = dict.fromkeys(attributes_without_obstacles, OCCUPIED)
    # As in a bake: cells that only the agent's disc blocks are occupied, but not solid. An inflated
    # grid is blocked for another radius than that of its occupancy.
    if "solid" in layer_of_attribute and level.navbake and "inflation" not in level.metadata:
        layer_of_attribute["occupancy"] = BLOCKED
    return ObstacleState(
        level.weights.copy(),
        attributes_without_obstacles,
        layer_of_attribute,
        _largest_clearance(level),
    )


def _change_counts(
    level: SceneGrid2D, obstacle_state: ObstacleState, layers: Layers, *, is_added: bool
) -> None:
    """Add an obstacle to a level's state or remove it, and update the level's arrays.

    Args:
        level: the level, whose arrays are written.
        obstacle_state: the level's counts of obstacles, written.
        layers: the ids of the obstacle's cells in each layer.
        is_added: whether to add the obstacle, else to remove it.
    """
    counts = obstacle_state.count.reshape(len(layers), -1)
    for layer_counts, ids in zip(counts, layers, strict=True):
        if is_added:
            layer_counts[ids] += 1
        else:
            layer_counts[ids] -= 1
    _write_cells(
        level.weights,
        obstacle_state.weights_without_obstacles,
        np.inf,
        counts[BLOCKED],
        layers[BLOCKED],
        is_added=is_added,
    )
    for name, layer in obstacle_state.attributes_without_obstacles.items():
        obstacle_layer = obstacle_state.layer_of_attribute[name]
        _write_cells(
            level.attributes[name],
            layer,
            1.0,
            counts[obstacle_layer],
            layers[obstacle_layer],
            is_added=is_added,
        )
    # one rectangle for all layers
    rows, cols = np.divmod(np.concatenate(layers), level.width)
    changed_range = (int(rows.min()), int(rows.max()) + 1, int(cols.min()), int(cols.max()) + 1)
    obstacle_state.log_change(changed_range)
    if obstacle_state.max_clearance is not None:
        _update_clearance(level, changed_range, obstacle_state.max_clearance)


def _write_cells(
    array: NDArray[np.generic],
    array_without_obstacles: NDArray[np.generic],
    blocked_value: float,
    counts: NDArray[np.uint16],
    ids: Int,
    *,
    is_added: bool,
) -> None:
    """Write an array of a level after an obstacle was added or removed.

    Args:
        array: weights or an attribute of a level, written.
        array_without_obstacles: the same array without obstacles. Receives the values of cells that
            get blocked.
        blocked_value: the value of blocked cells.
        counts: the number of obstacles on each cell, after the change.
        ids: ids of the obstacle's cells.
        is_added: whether the obstacle was added, else removed.
    """
    values = array.reshape(-1)
    values_without_obstacles = array_without_obstacles.reshape(-1)
    if is_added:
        # the first obstacle on a cell stores its present value: users may have written the array
        newly_blocked_ids = ids[counts[ids] == 1]
        values_without_obstacles[newly_blocked_ids] = values[newly_blocked_ids]
        values[newly_blocked_ids] = blocked_value
    else:
        freed_ids = ids[counts[ids] == 0]
        values[freed_ids] = values_without_obstacles[freed_ids]


def _update_clearance(
    level: SceneGrid2D, changed_range: CellRange, largest_clearance: float
) -> None:
    """Compute a level's layer ``clearance`` again after obstacles on some cells have changed.

    Args:
        level: the level, whose layer is written.
        changed_range: the cells that an obstacle was added to or removed from.
        largest_clearance: the largest clearance on the level without obstacles, in cells.
    """
    # Obstacles only reduce clearances. So only cells within the largest clearance of the changed
    # ones, in `inner_range`, can change. Their nearest blocked cells lie as far again outside, in
    # `outer_range`.
    margin = math.ceil(largest_clearance) + 2  # [cells]
    inner_range = _pad_range(changed_range, margin, level)
    outer_range = _pad_range(changed_range, 2 * margin, level)
    row0, row1, col0, col1 = inner_range
    rows = slice(row0 - outer_range[0], row1 - outer_range[0])
    cols = slice(col0 - outer_range[2], col1 - outer_range[2])
    level.attributes["clearance"][row0:row1, col0:col1] = measure_clearance(level, outer_range)[
        rows, cols
    ]


def _pad_range(cell_range: CellRange, margin: int, level: SceneGrid2D) -> CellRange:
    """Extend a rectangle of cells by a number of cells on each side, but not beyond the level."""
    return (
        max(cell_range[0] - margin, 0),
        min(cell_range[1] + margin, level.height),
        max(cell_range[2] - margin, 0),
        min(cell_range[3] + margin, level.width),
    )


def _largest_clearance(level: SceneGrid2D) -> float | None:
    """Compute the largest clearance of a level, in cells.

    Returns None if the level has no layer ``clearance``, or one that holds something else.
    """
    stored_clearance = level.attributes.get("clearance")
    if stored_clearance is None:
        return None
    measured_clearance = measure_clearance(level)
    # in files of other programs, a layer of this name may mean anything
    if stored_clearance.dtype != measured_clearance.dtype or not np.allclose(
        stored_clearance, measured_clearance, atol=1e-5
    ):
        return None
    return float(measured_clearance.max(initial=0)) / level.lattice.cell_size


# ---------------------------------------------------------------- shapes of obstacles


@dataclass(frozen=True)
class _UprightShape:
    """An obstacle with vertical sides. From above, it is a rectangle dilated by a radius.

    Attributes:
        lower_corner: of the rectangle, world x, y [m], shape (2,).
        upper_corner: of the rectangle, world x, y [m], shape (2,).
        radius: by which the rectangle is dilated [m]; 0 for a box.
        bottom: world z of its bottom [m], -inf for none.
        top: world z of its top [m], inf for none.
    """

    lower_corner: Float
    upper_corner: Float
    radius: float
    bottom: float
    top: float

    def distance(self, x: Float, y: Float, half_edge: float) -> Float:
        """Compute the distances on the map [m] from the rectangle to squares.

        Args:
            x: world x of the squares' centres [m].
            y: world y of the squares' centres [m].
            half_edge: half of a square's edge [m]; 0 for distances to the centres.

        Returns:
            0 where a square overlaps the rectangle; of the shape that `x` and `y` broadcast to.
        """
        dx = np.maximum(
            np.maximum(self.lower_corner[0] - x, x - self.upper_corner[0]) - half_edge, 0.0
        )
        dy = np.maximum(
            np.maximum(self.lower_corner[1] - y, y - self.upper_corner[1]) - half_edge, 0.0
        )
        return np.asarray(np.hypot(dx, dy))


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
    """Block cells of a grid for an obstacle, until it is freed: `SceneGrid2D.block`.

    Args:
        grid: the grid, whose arrays are written; grids in its `fitted_grids` get the same obstacle.
        cells: the cells to block: level, row and column, as numbers or as arrays. Pass exactly one
            of `cells`, `disc` and `box`.
        disc: an upright cylinder: its bottom's centre, world x, y, z or x, y [m], and its radius
            [m].
        box: lower and upper corner of a box along the axes, world x, y, z or x, y [m].
        level: the only level to block; positions then need no z. None for all levels that the
            obstacle reaches.
        height: height of the disc [m]; None for the agent's height.
        margin: radius of the agents that must not touch the obstacle [m]. None for the radius that
            the grid was inflated to, or for the baked one if the grid is not inflated.

    Raises:
        QueryError: not exactly one of cells, disc and box is given, or it is not valid.
    """
    arguments: BlockArguments = {
        "cells": cells,
        "disc": disc,
        "box": box,
        "level": level,
        "height": height,
        "margin": margin,
    }
    obstacle = AddedObstacle(grid, _find_layers(grid, arguments), arguments)
    obstacle.copies += [block(fitted_grid, **arguments) for fitted_grid in grid.fitted_grids or ()]
    return obstacle


def _find_layers(grid: NavGrid, arguments: BlockArguments) -> list[Layers]:
    """For each level, find the cells of each layer of an obstacle; `Layers` holds their ids."""
    cells = arguments["cells"]
    disc = arguments["disc"]
    box = arguments["box"]
    level = arguments["level"]
    if sum(shape is not None for shape in (cells, disc, box)) != 1:
        expected = "one of cells, disc and box"
        raise QueryError(f"expected {expected} to block", expected=expected)
    check_level(level, len(grid.levels))
    if cells is not None:
        cell_level, rows_of_cells, cols_of_cells = check_cells(grid, cells)
        layers_by_level = []
        for level_number, level_grid in enumerate(grid.levels):
            blocked_ids = np.unique(
                (rows_of_cells * level_grid.width + cols_of_cells)[cell_level == level_number]
            )
            layers_by_level.append([blocked_ids] * NUM_LAYERS)
        return layers_by_level
    if disc is not None:
        shape = _check_disc(grid, disc, level, arguments["height"])
    else:
        assert box is not None  # as one of the three is given
        shape = _check_box(grid, box, level)
    margins = compute_margins(grid, arguments["margin"])
    max_step = step_limit(grid) * grid.unit
    empty_layers = [np.empty(0, dtype=np.int64)] * NUM_LAYERS
    layers_by_level = []
    for level_number, level_grid in enumerate(grid.levels):
        if level is not None and level != level_number:
            layers_by_level.append(empty_layers)
            continue
        cell_size = level_grid.lattice.cell_size
        search_distance = shape.radius + max(margins.anywhere, cell_size)
        window = level_grid.lattice.window(
            np.array([shape.lower_corner, shape.upper_corner]), search_distance
        )
        if window is None:  # the obstacle is beside the level
            layers_by_level.append(empty_layers)
            continue
        rows, cols = window
        x = level_grid.lattice.center_x()[cols]
        y = level_grid.lattice.center_y()[rows, None]
        floor = level_grid.floor_of(rows, cols)
        floor = np.where(np.isnan(floor), level_grid.ground, floor)
        is_at_height = (shape.bottom < floor + grid.agent_height) & (shape.top > floor + max_step)
        distance_to_square = shape.distance(x, y, cell_size / 2)
        distance_to_center = shape.distance(x, y, 0.0)
        # A disc blocks no square that it only touches. A box, whose radius is 0, does, so that a
        # flat box blocks cells.
        if shape.radius > 0:
            is_touched = distance_to_square < shape.radius
        else:
            is_touched = distance_to_square <= 0
        layer_masks = []
        for margin_distance in (0.0, *margins):
            is_within = is_touched | (distance_to_center < shape.radius + margin_distance)
            layer_masks.append(is_at_height & is_within)
        row_start_ids = np.arange(rows.start, rows.stop)[:, None] * level_grid.width
        cell_ids: Int = row_start_ids + np.arange(cols.start, cols.stop)
        layers_by_level.append([cell_ids[mask] for mask in layer_masks])
    return layers_by_level


def _check_disc(
    grid: NavGrid, disc: tuple[ArrayLike, float], level: int | None, height: float | None
) -> _UprightShape:
    """Check a disc's centre, radius and height, and return its shape."""
    try:
        center, radius = disc
    except (TypeError, ValueError):
        raise QueryError(f"expected a disc's centre and radius, got {disc!r}") from None
    center_point = check_positions(center, len(grid.levels), level)
    if center_point.ndim != 1:
        raise QueryError(
            f"expected one centre of a disc, got an array of shape {center_point.shape}"
        )
    check_radius(radius, "radius of a disc")
    if height is not None:
        check_radius(height, "height of a disc")
    disc_height = grid.agent_height if height is None else height
    has_z = len(center_point) == 3
    return _UprightShape(
        lower_corner=center_point[:2],
        upper_corner=center_point[:2],
        radius=radius,
        bottom=center_point[2] if has_z else -math.inf,
        top=center_point[2] + disc_height if has_z else math.inf,
    )


def _check_box(grid: NavGrid, box: tuple[ArrayLike, ArrayLike], level: int | None) -> _UprightShape:
    """Check a box's corners, and return its shape."""
    expected = "expected a box's lower and upper corner"
    try:
        box_lower, box_upper = box
    except (TypeError, ValueError):
        raise QueryError(f"{expected}, got {box!r}") from None
    lower_corner = check_positions(box_lower, len(grid.levels), level)
    upper_corner = check_positions(box_upper, len(grid.levels), level)
    if (
        lower_corner.ndim != 1
        or lower_corner.shape != upper_corner.shape
        or (lower_corner > upper_corner).any()
    ):
        raise QueryError(f"{expected}, got {lower_corner} and {upper_corner}")
    has_z = len(lower_corner) == 3
    return _UprightShape(
        lower_corner=lower_corner[:2],
        upper_corner=upper_corner[:2],
        radius=0.0,
        bottom=lower_corner[2] if has_z else -math.inf,
        top=upper_corner[2] if has_z else math.inf,
    )
