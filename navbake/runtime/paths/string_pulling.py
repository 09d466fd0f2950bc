"""Turns a route over cells into a line on the floor, straight where it can be."""

import numpy as np

from navbake.runtime.paths.search import Search
from navbake.types import Float, Int

# Functions import kernels when they run: numba takes long to load.

SAME = 1e-9  # metres between two points that are one
BEND = 1e-3  # metres that a line may be off the height of the floor in the middle of a cell


def pull_route(
    search: Search, route: Int, *, smooth: bool, start: Float | None, end: Float | None
) -> tuple[Float, Int]:
    """Make a line along a route: world x, y, floor z [m], shape (m, 3), and the level of each.

    It runs through the cells' centres or, if smooth, straight on wherever all cells that it
    touches are free, all steps between them small enough, the obstacles as far away as the grid
    asks for, and the cost no higher; then no three of its points are in one line, but for heights
    of the floor. Over a link it runs as the route does. It begins and ends at
    `start` and `end`, world x, y [m] in the first and last cell; at the cell's centre if None, or
    if obstacles are too near there.
    """
    from navbake.runtime.kernels.arrays import Line  # saves numba at start-up
    from navbake.runtime.kernels.string import lay_on_floor, pull_string

    flat = search.flat
    level = flat.level_of(route)
    points = np.ascontiguousarray(flat.positions(route)[:, :2])
    is_link = search.are_links(route)
    if start is not None and _can_join(start, points[0], level[0], search):
        points, level = np.vstack([start, points]), np.append(level[0], level)
        is_link = np.append(False, is_link)
    if end is not None and _can_join(points[-1], end, level[-1], search):
        points, level = np.vstack([points, end]), np.append(level, level[-1])
        is_link = np.append(is_link, False)
    line = Line(points, level, is_link)
    if smooth:
        kept = pull_string(line, search.graph, search.off_center)
        line = Line(points[kept], level[kept], is_link[np.flatnonzero(kept)[:-1]])
    positions, levels = lay_on_floor(line, flat.layout, flat.floors, BEND)
    return positions, levels


def _can_join(a: Float, b: Float, level: int, search: Search) -> bool:
    """Whether two points are not the same, and a line between them stays free."""
    from navbake.runtime.kernels.string import can_pass

    if np.abs(a - b).max() <= SAME:
        return False
    return bool(can_pass(a, b, level, search.graph, search.off_center))
