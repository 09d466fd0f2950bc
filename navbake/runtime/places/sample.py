"""Random places where an agent can stand, even by area."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from navbake.types import Bool, Float, Int

if TYPE_CHECKING:
    from navbake.runtime.flat_grid import FlatGrid

INSIDE = 1e-6  # of a cell: how far from its edges a point stays
SLACK = 1e-9  # metres


def draw_positions(
    flat: FlatGrid, cells: Int, rng: np.random.Generator, count: int, *, anywhere: bool = False
) -> Float:
    """Draw positions in cells, each as likely as its area has it.

    Args:
        flat: the grid.
        cells: flat ids, shape (n,), n >= 1.
        rng: draws.
        count: how many, with repetition, >= 0.
        anywhere: all over the cells, so up to half a cell nearer to obstacles than the agent's
            radius; else at their centres, where it fits.

    Returns:
        World x, y and floor z [m], shape (count, 3), float64.
    """
    chosen = cells[_draw(flat, cells, rng, count)]
    positions = flat.positions(chosen)
    if anywhere:
        size = flat.layout.cell_size[flat.level_of(chosen)]
        half = 0.5 - INSIDE
        positions[:, :2] += rng.uniform(-half, half, size=(count, 2)) * size[:, None]
    return positions


def _draw(flat: FlatGrid, cells: Int, rng: np.random.Generator, count: int) -> Int:
    sizes = flat.layout.cell_size
    if len(set(sizes)) == 1:
        return rng.integers(len(cells), size=count)
    # cells of different areas: a point on their areas in a row falls into one of them
    edges = np.cumsum(sizes[flat.level_of(cells)] ** 2)
    found = np.searchsorted(edges, rng.uniform(0.0, edges[-1], size=count), side="right")
    return np.minimum(found, len(cells) - 1)


def cells_in_annulus(
    flat: FlatGrid, level: int, point: Float, distances: tuple[float, float], allowed: Bool
) -> Int:
    """The allowed cells of a level whose centres are so far from a point on the map.

    Args:
        flat: the grid.
        level: which level.
        point: x, y [m].
        distances: the smallest and the largest [m], both included.
        allowed: by flat id, shape (n,), bool.

    Returns:
        Flat ids, ascending, shape (n,), int64.
    """
    layout = flat.layout
    size, width = float(layout.cell_size[level]), int(layout.width[level])
    row = (layout.y_max[level] - point[1]) / size - 0.5
    col = (point[0] - layout.x_min[level]) / size - 0.5
    reach = distances[1] / size
    rows = _near(row, reach, int(layout.height[level]))
    cols = _near(col, reach, width)
    squared = ((rows - row)[:, None] ** 2 + (cols - col) ** 2) * size**2
    low, high = max(distances[0] - SLACK, 0.0), distances[1] + SLACK
    near = (squared >= low**2) & (squared <= high**2)
    cells = (int(layout.start[level]) + rows[:, None] * width + cols)[near]
    found: Int = cells[allowed[cells]].astype(np.int64)
    return found


def _near(at: float, reach: float, count: int) -> Int:
    """The numbers from 0 to count - 1 that are within reach of a place."""
    first = math.ceil(min(max(at - reach, 0.0), count))
    return np.arange(first, math.floor(max(min(at + reach, count - 1), -1.0)) + 1)
