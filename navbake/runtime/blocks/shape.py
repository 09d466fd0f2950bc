"""Which cells an obstacle of a given shape blocks."""

import math
from dataclasses import dataclass

import numpy as np

from navbake.navgrid.block_state import NUM_LAYERS, Layers
from navbake.navgrid.grid import SceneGrid2D
from navbake.types import Float, Int


@dataclass(frozen=True)
class Margins:
    """How far from an obstacle a cell's centre has to be [m].

    Attributes:
        center: for an agent to stand there.
        diagonal: to step diagonally from there.
        off_center: to be anywhere in the cell.
    """

    center: float
    diagonal: float
    off_center: float


@dataclass(frozen=True)
class Shape:
    """An upright obstacle, seen from above: a rectangle grown by a radius.

    Attributes:
        x_min, y_min, x_max, y_max: the rectangle, a point for a disc, world [m].
        radius: by how much it is grown [m], >= 0.
        bottom, top: world z [m]; infinite if it fills the level.
    """

    x_min: float
    y_min: float
    x_max: float
    y_max: float
    radius: float
    bottom: float = -math.inf
    top: float = math.inf


def cells_of_shape(
    level: SceneGrid2D, shape: Shape, margins: Margins, step: float, height: float
) -> Layers:
    """Find the cells that an obstacle blocks for an agent of a height that steps over `step` [m].

    There the obstacle reaches into the heights from `step` to `height` above the floor, and meets
    the cell's square or the disc of a margin round its centre.
    """
    lattice = level.lattice
    size = lattice.cell_size
    reach = shape.radius + max(margins.off_center, size)
    rows, cols = lattice.rows_cols(
        [[shape.x_min - reach, shape.y_max + reach], [shape.x_max + reach, shape.y_min - reach]]
    )
    row0, row1 = max(int(rows[0]), 0), min(int(rows[1]) + 1, level.height)
    col0, col1 = max(int(cols[0]), 0), min(int(cols[1]) + 1, level.width)
    if row0 >= row1 or col0 >= col1:
        return cells_alone(np.empty(0, dtype=np.int64))
    x = lattice.center_x()[col0:col1]
    y = lattice.center_y()[row0:row1, None]
    floor = level.floor_of(slice(row0, row1), slice(col0, col1))
    floor = np.where(np.isnan(floor), level.ground, floor)
    in_band = (shape.bottom < floor + height) & (shape.top > floor + step)
    to_square, gap = _distance(shape, x, y, size / 2), _distance(shape, x, y, 0.0)
    # a disc is open: it may touch a square. A box is closed, so that a flat one has cells, too.
    meets = in_band & (to_square < shape.radius if shape.radius > 0 else to_square <= 0)
    ids = np.arange(row0, row1)[:, None] * level.width + np.arange(col0, col1)
    return [
        ids[meets | (in_band & (gap < shape.radius + margin))]
        for margin in (0.0, margins.center, margins.diagonal, margins.off_center)
    ]


def cells_alone(cells: Int) -> Layers:
    """Cells that are blocked by themselves, without an agent's margin around them."""
    return [np.unique(cells)] * NUM_LAYERS


def _distance(shape: Shape, x: Float, y: Float, half: float) -> Float:
    """From the shape's rectangle to squares round points, of half an edge."""
    dx = np.maximum(np.maximum(shape.x_min - x, x - shape.x_max) - half, 0.0)
    dy = np.maximum(np.maximum(shape.y_min - y, y - shape.y_max) - half, 0.0)
    return np.asarray(np.hypot(dx, dy))
