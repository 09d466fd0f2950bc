"""What upright boxes make of a grid's cells, by exact geometry: the oracle of several tests."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from navbake.navgrid.grid import SceneGrid2D
from navbake.types import Bool, Float

RADIUS, STEP, HEIGHT = 0.05, 0.25, 1.14  # of the agent, as in the settings' defaults [m]
TINY = 1e-6  # what touches by less than this touches by rounding [m]

Corners = tuple[float, float, float, float, float, float]
"""x0, y0, z0, x1, y1, z1 of a box [m]."""


def centers(level: SceneGrid2D) -> tuple[Float, Float]:
    """World x and y of each cell's centre, shape (height, width) [m]."""
    at = level.lattice.positions(*np.indices(level.shape))
    return at[..., 0], at[..., 1]


def within(level: SceneGrid2D, x0: float, y0: float, x1: float, y1: float) -> Bool:
    """The cells whose centres lie in a rectangle."""
    x, y = centers(level)
    inside: Bool = (x0 < x) & (x < x1) & (y0 < y) & (y < y1)
    return inside


def met_by_boxes(
    x: Float,
    y: Float,
    floor: Float,
    cell: float,
    boxes: Iterable[Corners],
    slack: float = TINY,
) -> Bool:
    """The cells in which a box meets the open volume over the footprint.

    Args:
        x, y: of the cells' centres [m].
        floor: of each cell; NaN meets nothing [m].
        cell: their size [m].
        slack: by how much a box has to reach into the volume; below 0, it may be so far off [m].
    """
    met: Bool = np.zeros(x.shape, dtype=np.bool_)
    for x0, y0, z0, x1, y1, z1 in boxes:
        beside_x = np.maximum(np.maximum(x0 - x, x - x1), 0.0)
        beside_y = np.maximum(np.maximum(y0 - y, y - y1), 0.0)
        in_square = np.maximum(beside_x, beside_y) < cell / 2 - slack
        in_disc = np.hypot(beside_x, beside_y) < RADIUS - slack
        with np.errstate(invalid="ignore"):
            in_height = (z0 < floor + HEIGHT - slack) & (z1 > floor + STEP + slack)
        met |= in_height & (in_square | in_disc)
    return met


def occupied_by_boxes(level: SceneGrid2D, boxes: Iterable[Corners]) -> Bool:
    """The cells of a level with a floor that boxes occupy, for the default agent."""
    x, y = centers(level)
    floor = level.floor_height.astype(np.float64)
    return met_by_boxes(x, y, floor, level.cell_size, boxes)
