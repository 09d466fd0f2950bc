"""How wide the way between two places is at its narrowest."""

import math
from dataclasses import dataclass

import numpy as np

from navbake.navgrid.grid import NavGrid
from navbake.runtime.flat_grid import FlatGrid
from navbake.runtime.inflation.margins import exact_radius, ledges_of
from navbake.runtime.paths.passage import deflated, find_widest, flanks, with_weights
from navbake.runtime.paths.search import Search
from navbake.types import Float, Int

MAX_STOPS = 200  # cells that are looked at for the narrowest one


@dataclass(frozen=True, eq=False)
class Gap:
    """The narrowest place on the widest way."""

    width: float  # between the obstacles [m]; on the centres of cells, up to a cell more is needed
    position: Float  # world x, y, z of a cell there [m], shape (3,)


def find_gap(grid: NavGrid, flat: FlatGrid, origin: int, goals: Int) -> Gap | None:
    """Find the gap that keeps an agent of an inflated grid's radius from a goal.

    Origin and goals are free cells, by flat id, in different islands. None if the grid isn't
    inflated, or no smaller radius passes.
    """
    if exact_radius(grid) == 0.0:
        return None
    plain = deflated(grid.without_blocks())
    widest = find_widest(plain, flat, (origin, goals), ledges_of(grid))
    if widest is None or math.isinf(widest.radius):
        return None
    route = Search(with_weights(plain, np.where(widest.free, 1.0, np.inf))).route(origin, goals)
    if route is None:
        return None
    # of the widest way, the cells that a slightly larger agent loses: the gap is one of them
    taken = np.concatenate([route, flanks(flat, route)])
    stops = taken[~widest.free_for_larger[taken]]
    return _measure(plain, flat, stops, widest.radius) if len(stops) else None


def _measure(grid: NavGrid, flat: FlatGrid, stops: Int, radius: float) -> Gap:
    """The narrowest of some cells, and the width from what is nearest there to the other side."""
    best, width, narrowest = np.inf, 2 * radius, int(stops[0])
    for stop in stops[:MAX_STOPS].tolist():
        here, low, high = _squares_near(grid, flat, stop, 4 * radius)
        nearest = np.clip(here, low, high) - here
        distance = np.linalg.norm(nearest, axis=1)
        if not len(distance) or distance.min() >= best:
            continue
        k = int(np.argmin(distance))
        best, narrowest, width = float(distance[k]), stop, 2 * radius
        # the other side: what lies within 60 degrees of the opposite direction
        opposite = nearest @ -nearest[k] > 0.5 * distance * distance[k]
        if opposite.any():
            side = here + nearest[k]
            across = np.linalg.norm(np.clip(side, low, high) - side, axis=1)[opposite]
            width = float(across.min())
    return Gap(width, flat.positions(narrowest))


def _squares_near(
    grid: NavGrid, flat: FlatGrid, cell: int, reach: float
) -> tuple[Float, Float, Float]:
    """A cell's centre, and the lower and upper corners of occupied cells round it, x, y [m]."""
    number, row, col = flat.cell(cell)
    level, size = grid.levels[number], flat.layout.cell_size[number]
    span = int(reach / size) + 2
    row0, col0 = max(row - span, 0), max(col - span, 0)
    occupied = level.solid[row0 : row + span + 1, col0 : col + span + 1]
    rows, cols = np.nonzero(occupied)
    centers = level.lattice.positions(rows + row0, cols + col0)
    here = level.lattice.positions(row, col)
    return here, centers - size / 2, centers + size / 2
