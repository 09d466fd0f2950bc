"""Random places where an agent can stand, even by area."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError

if TYPE_CHECKING:
    from navbake.runtime.flat_grid import Walk

Number = int | float | np.integer | np.floating
INSIDE = 1e-6  # of a cell: how far from its edges a point stays
SLACK = 1e-9  # metres


def draw_positions(
    walk: Walk,
    cells: NDArray[np.int64],
    rng: np.random.Generator,
    count: int,
    *,
    anywhere: bool = False,
) -> NDArray[np.float64]:
    """Draw positions in cells, each as likely as its area has it.

    Args:
        walk: the grid.
        cells: flat ids, shape (n,), n >= 1.
        rng: draws.
        count: how many, with repetition, >= 0.
        anywhere: all over the cells, so up to half a cell nearer to obstacles than the agent's
            radius; else at their centres, where it fits.

    Returns:
        World x, y and floor z [m], shape (count, 3), float64.
    """
    chosen = cells[_draw(walk, cells, rng, count)]
    positions = walk.positions(chosen)
    if anywhere:
        size = walk.cell_size[walk.level_of(chosen)]
        half = 0.5 - INSIDE
        positions[:, :2] += rng.uniform(-half, half, size=(count, 2)) * size[:, None]
    return positions


def _draw(
    walk: Walk, cells: NDArray[np.int64], rng: np.random.Generator, count: int
) -> NDArray[np.int64]:
    if len(set(walk.cell_size)) == 1:
        return rng.integers(len(cells), size=count)
    edges = np.cumsum(walk.cell_size[walk.level_of(cells)] ** 2)
    found = np.searchsorted(edges, rng.uniform(0.0, edges[-1], size=count), side="right")
    return np.minimum(found, len(cells) - 1)


def cells_in_annulus(
    walk: Walk,
    level: int,
    x: float,
    y: float,
    min_distance: float,
    max_distance: float,
    allowed: NDArray[np.bool_],
) -> NDArray[np.int64]:
    """The allowed cells of a level whose centres are so far from a point on the map.

    Args:
        walk: the grid.
        level: which level.
        x, y: the point [m].
        min_distance, max_distance: [m], both included.
        allowed: by flat id, shape (n,), bool.

    Returns:
        Flat ids, ascending, shape (n,), int64.
    """
    size, width = float(walk.cell_size[level]), int(walk.width[level])
    row = (walk.y_max[level] - y) / size - 0.5
    col = (x - walk.x_min[level]) / size - 0.5
    reach = max_distance / size
    rows = _near(row, reach, int(walk.height[level]))
    cols = _near(col, reach, width)
    squared = ((rows - row)[:, None] ** 2 + (cols - col) ** 2) * size**2
    low, high = max(min_distance - SLACK, 0.0), max_distance + SLACK
    near = (squared >= low**2) & (squared <= high**2)
    cells = (int(walk.start[level]) + rows[:, None] * width + cols)[near]
    found: NDArray[np.int64] = cells[allowed[cells]].astype(np.int64)
    return found


def _near(at: float, reach: float, count: int) -> NDArray[np.int64]:
    """The numbers from 0 to count - 1 that are within reach of a place."""
    first = math.ceil(min(max(at - reach, 0.0), count))
    return np.arange(first, math.floor(max(min(at + reach, count - 1), -1.0)) + 1)


def check_generator(rng: object) -> np.random.Generator:
    """Refuse what draws no numbers of its own, as a seed.

    Raises:
        QueryError: it is no `numpy.random.Generator`.
    """
    if isinstance(rng, np.random.Generator):
        return rng
    raise QueryError(
        f"expected a numpy.random.Generator, got {rng!r}: make one with numpy.random.default_rng"
    )


def check_distance(distance: float, name: str = "max_distance") -> None:
    """Refuse what is no distance.

    Raises:
        QueryError: it is no number, negative, or NaN.
    """
    if not (isinstance(distance, Number) and distance >= 0):
        raise QueryError(f"expected a {name} >= 0 m, got {distance!r}")


def check_distances(min_distance: float, max_distance: float) -> None:
    """Refuse distances that are none.

    Raises:
        QueryError: they are negative, not in order, or NaN.
    """
    numbers = isinstance(min_distance, Number) and isinstance(max_distance, Number)
    if not (numbers and 0 <= min_distance <= max_distance):
        raise QueryError(
            f"expected 0 <= min_distance <= max_distance [m], got {min_distance} and {max_distance}"
        )
