"""Takes the obstacles that were added to a grid (see `block`) out of its layers again."""

from __future__ import annotations

import numpy as np

from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import measure_clearance
from navbake.navgrid.obstacle_state import BLOCKED


def without_obstacles(grid: NavGrid) -> NavGrid:
    """Return a grid in which no added obstacle blocks a cell: `GridBase.without_obstacles`.

    Args:
        grid: The grid, which stays as it is.
    """
    if not grid.is_blocked:
        return grid
    return grid.with_levels([_free_level(level) for level in grid.levels])


def _free_level(level: SceneGrid2D) -> SceneGrid2D:
    """Return a level in which no added obstacle blocks a cell; the level itself if none does now.

    Args:
        level: The level, which stays as it is.
    """
    obstacle_state = level.obstacle_state
    if obstacle_state is None or not obstacle_state.is_blocked:
        return level
    occupied_attributes = {
        name: np.where(
            obstacle_state.mask_of(obstacle_state.layer_of_attribute[name]),
            layer_without_obstacles,
            level.attributes[name],
        )
        for name, layer_without_obstacles in obstacle_state.attributes_without_obstacles.items()
    }
    weights = np.where(
        obstacle_state.mask_of(BLOCKED), obstacle_state.weights_without_obstacles, level.weights
    )
    free_level = level.with_layers(weights=weights, attributes=occupied_attributes)
    if obstacle_state.max_clearance is not None:  # adding the obstacles changed this layer, too
        free_level.attributes["clearance"] = measure_clearance(free_level)
    return free_level
