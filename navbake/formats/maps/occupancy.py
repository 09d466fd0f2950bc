"""Levels as the values of ROS's ``nav_msgs/OccupancyGrid``: -1 unknown, 0 free to 100 occupied.

Here arrays are as everywhere in navbake, row 0 at the top (largest y); a message has it at the
bottom. Between 0 and 100, a value stands for a cost, as ``nav2_costmap_2d`` publishes costmaps:
99 for a cell that the robot's centre can't be on, 1 to 98 for the costs 1 to 252.

Source: nav2's ``costmap_2d_publisher.cpp`` for the values of costs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.runtime.inflation import SCALING, nav2_costs
from navbake.types import Float, Vector3

UNKNOWN, FREE, INSCRIBED, OCCUPIED = -1, 0, 99, 100
LEAST_COST, MOST_COST = 1, 252  # of a cell that isn't blocked
LETHAL = 253  # and above: the cost of cells that are

Values = NDArray[np.int8]


def values_of(grid: NavGrid, number: int) -> Values:
    """The values of a level's cells, shape (height, width), int8.

    Unknown where the grid states floors and has none there; free where the weight is finite, with
    the cost that a weight above 1 is; occupied where something stands; and 99 where only an
    inflation, or a block, keeps the agent out.
    """
    level = grid.levels[number]
    with np.errstate(invalid="ignore"):
        costs = np.where(level.weights > 1, np.clip(level.weights, LEAST_COST, MOST_COST), 0)
    values = publish_costs(costs.astype(np.uint8))
    values[~level.free] = INSCRIBED
    values[~level.free & (level.occupancy != 0)] = OCCUPIED
    if "floorHeight" in level.attributes:
        values[~level.free & np.isnan(level.floor_height)] = UNKNOWN
    return values


def inflated_values(
    grid: NavGrid, number: int, radius: float, inflation: float, scaling: float = SCALING
) -> Values:
    """The values of a level's costmap: its obstacles inflated by nav2's formula.

    Cells that a robot of this radius can't stand on for other reasons (a drop, another level's
    obstacle) cost as much as those within the radius of an obstacle.

    Args:
        radius: the robot's inscribed radius [m].
        inflation: nav2's ``inflation_radius`` [m], beyond which nothing costs.
        scaling: nav2's ``cost_scaling_factor`` [1/m].

    Raises:
        QueryError: an argument is out of its range, or the inflation less than the radius.
    """
    if not inflation >= radius:
        raise QueryError(
            f"expected an inflation of at least the radius {radius:g} m, got {inflation:g}"
        )
    inflated = grid.inflate(radius, inflation - radius, costs="nav2", scaling=scaling)
    values, level = values_of(inflated, number), grid.levels[number]
    costs = nav2_costs(level, radius, inflation, scaling)
    is_free = (values >= FREE) & (values < INSCRIBED)
    values[is_free] = np.maximum(values, publish_costs(costs))[is_free]
    return values


def publish_costs(costs: NDArray[np.uint8]) -> Values:
    """The values as which nav2 publishes costs from 0 to 252."""
    table = 1 + 97 * (np.arange(256) - 1) // 251
    table[0], table[LETHAL:] = FREE, INSCRIBED
    return table.astype(np.int8)[costs]


def cost_of(values: Values) -> Float:
    """The least cost that is published as each value from 1 to 98; 1 for the value 0."""
    costs = 1 + np.ceil(251 * (np.arange(OCCUPIED + 1) - 1) / 97)
    costs[0] = 1
    return costs[np.clip(values, 0, OCCUPIED)]


def level_from_values(
    values: Values, cell_size: float, corner: tuple[float, float, float], metadata: dict[str, Any]
) -> SceneGrid2D:
    """Make a level of values.

    100 is occupied, 99 blocked, -1 has no floor, and 1 to 98 weigh what their cost is. The floor
    of all other cells is flat, under what is occupied, too.

    Args:
        values: shape (height, width), int8.
        cell_size: edge of a cell [m].
        corner: world x and y of the lower left corner, and the floor's z [m].
    """
    height, width = values.shape
    x, y, z = corner
    blocked = (values < FREE) | (values >= INSCRIBED)
    floor = np.where(values == UNKNOWN, np.float32(np.nan), np.float32(z))
    low: Vector3 = (x, z, 0.0 - (y + height * cell_size))
    return SceneGrid2D(
        width=width,
        height=height,
        cell_size=cell_size,
        min_yup=low,
        weights=np.where(blocked, np.inf, cost_of(values)),
        attributes={
            "floorHeight": floor,
            "occupancy": ((values == OCCUPIED) | (values == UNKNOWN)).astype(np.uint8),
        },
        metadata=metadata,
    )
