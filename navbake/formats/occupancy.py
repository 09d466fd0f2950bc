"""Levels as the values of ROS's ``nav_msgs/OccupancyGrid``: -1 unknown, 0 free to 100 occupied.

Maps that don't lie along the world's axes are turned, or laid on cells that do.

Here arrays are as everywhere in navbake, row 0 at the top (largest y); a message has it at the
bottom. Between 0 and 100, a value stands for a cost, as ``nav2_costmap_2d`` publishes costmaps:
99 for a cell that the robot's centre can't be on, 1 to 98 for the costs 1 to 252.

Source: nav2's ``costmap_2d_publisher.cpp`` for the values of costs.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError, QueryError
from navbake.formats.allowance import MAX_PIXELS
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import Lattice
from navbake.runtime.inflation import SCALING, nav2_costs
from navbake.types import Float, Vector3

UNKNOWN, FREE, INSCRIBED, OCCUPIED = -1, 0, 99, 100
LEAST_COST, MOST_COST = 1, 252  # of a cell that isn't blocked
LETHAL = 253  # and above: the cost of cells that are
TOUCH = 1e-9  # of a cell: squares that overlap by less don't
PIECE = 1 << 18  # cells that are looked at together, for the memory that it takes

Values = NDArray[np.int8]
Corner = tuple[float, float]


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


def turn(values: Values, corner: Corner, resolution: float, quarters: int) -> tuple[Values, Corner]:
    """Turn a map by quarters, counter-clockwise, about its lower left corner.

    Args:
        values: shape (height, width), row 0 at the top.
        corner: world x, y of the lower left corner of its own lower left cell [m].
        resolution: edge of a cell [m].

    Returns:
        The values in the world's directions, and the corner that is now the lower left one.
    """
    height, width = (count * resolution for count in values.shape)
    left, below = ((0, 0), (height, 0), (width, height), (0, width))[quarters % 4]
    turned = np.ascontiguousarray(np.rot90(values, quarters % 4))
    return turned, (corner[0] - left, corner[1] - below)


def resample(
    values: Values, corner: Corner, resolution: float, yaw: float, *, occupied: int
) -> tuple[Values, Corner]:
    """Lay a map that is turned by any angle on cells of the same size along the world's axes.

    A cell takes the value at its centre, -1 (unknown) beside the map. But it is occupied wherever
    an occupied cell of the map reaches into its square.

    Args:
        values, corner, resolution: as of `turn`.
        yaw: counter-clockwise [rad].
        occupied: the value of occupied cells.

    Returns:
        The values, and the lower left corner, which is that of the box around the turned map or up
        to half a cell further out.

    Raises:
        FormatError: it would be too many cells.
    """
    height, width = values.shape
    cos, sin = math.cos(yaw), math.sin(yaw)
    # corners of the map in cells, from its own corner, in the world's directions
    xs, ys = (0, width * cos, width * cos - height * sin, -height * sin), (
        0, width * sin, width * sin + height * cos, height * cos,
    )  # fmt: skip
    lattice = Lattice.cover((min(xs), min(ys), max(xs), max(ys)), 1.0)
    if lattice.width * lattice.height > MAX_PIXELS:
        raise FormatError(f"the turned map has {lattice.width} × {lattice.height} cells, too many")
    turned: Values = np.full(lattice.shape, -1, dtype=np.int8)
    x, y = lattice.center_x(), lattice.center_y()[:, None]
    num_rows = max(1, PIECE // lattice.width)  # of one piece
    for start in range(0, lattice.height, num_rows):
        piece = slice(start, start + num_rows)
        col, up = np.floor(cos * x + sin * y[piece]), np.floor(-sin * x + cos * y[piece])
        inside = (col >= 0) & (col < width) & (up >= 0) & (up < height)
        cols, rows = col[inside].astype(np.int64), height - 1 - up[inside].astype(np.int64)
        turned[piece][inside] = values[rows, cols]
    full_rows, full_cols = np.nonzero(values == occupied)
    for start in range(0, len(full_rows), PIECE):
        part = slice(start, start + PIECE)
        right, up = full_cols[part] + 0.5, height - full_rows[part] - 0.5
        _mark_met(turned, lattice, cos * right - sin * up, sin * right + cos * up, yaw, occupied)
    x_min, y_min, _, _ = lattice.bounds
    return turned, (corner[0] + x_min * resolution, corner[1] + y_min * resolution)


def _mark_met(
    turned: Values,
    lattice: Lattice,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    yaw: float,
    occupied: int,
) -> None:
    """Mark the cells whose squares the turned unit squares round some centres meet.

    Separating axes of two squares: along each side's direction of both, the centres must be
    nearer than half of the extents together.
    """
    cos, sin = abs(math.cos(yaw)), abs(math.sin(yaw))
    reach = (1.0 + cos + sin) / 2 - TOUCH  # half extents along any of the four directions
    row, col = lattice.rows_cols(np.stack([x, y], axis=-1))
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            rows, cols = row + down, col + right
            dx = lattice.x_min + cols + 0.5 - x
            dy = lattice.y_max - rows - 0.5 - y
            along, across = (
                math.cos(yaw) * dx + math.sin(yaw) * dy,
                (math.cos(yaw) * dy - math.sin(yaw) * dx),
            )
            far = np.max(np.abs([dx, dy, along, across]), axis=0)
            meets = (far < reach) & (rows >= 0) & (rows < lattice.height)
            meets &= (cols >= 0) & (cols < lattice.width)
            turned[rows[meets], cols[meets]] = occupied
