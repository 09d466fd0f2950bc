"""Clearances that an agent of a known radius needs to move, not only to stand.

In an inflated grid, an agent may stand at the centres of free cells. Between them, or anywhere
else in a cell, it may be nearer to an obstacle. So diagonal steps need cells that would be free
for a radius so much larger that the discs round both ends cover the way. Straight lines off the
centres need cells in which the agent may be anywhere; or cells near which nothing but solid
squares of their own level is in the way, so that a sweep of the disc along the line tells. Straight
steps need nothing more: a square beside such a step is straight beside one of its ends, and as near
to it.

Floors are known at cells' centres: where one is a step higher than the next, the edge between
them may be half a cell off, and so may the edges beside it. There, steps go straight from centre
to centre, as the bake knows them.
"""

import math

import numpy as np

from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.runtime.blocks.shape import Margins
from navbake.runtime.inflation.inflate import (
    MAX_RADIUS,
    check_radius,
    find_blocked,
    find_blocked_by_others,
)
from navbake.types import Bool, Json

STEEP = 1.001  # rise, in cells, over which neighbours are a step, not a slope


def exact_radius(grid: NavGrid) -> float:
    """The radius that the grid was inflated for in mode `exact` [m]; 0 if it wasn't."""
    radii = [entry.get("radius") for entry in _exact_entries(grid)]
    numbers = (float(r) for r in radii if isinstance(r, int | float))
    return max((r for r in numbers if 0 <= r <= MAX_RADIUS), default=0.0)


def _exact_entries(grid: NavGrid) -> list[Json]:
    done = grid.metadata.get("inflation")  # in files of other programs this may be anything
    entries = [e for e in done if isinstance(e, dict)] if isinstance(done, list) else []
    return [entry for entry in entries if entry.get("mode") == "exact"]


def ledges_of(grid: NavGrid) -> str:
    """Whether the grid's inflation avoids ledges: ``avoid`` or ``ignore``.

    Files that were inflated before there was a choice say nothing, and ignore them.
    """
    avoids = any(entry.get("ledges") == "avoid" for entry in _exact_entries(grid))
    return "avoid" if avoids else "ignore"


def agent_radius(grid: NavGrid) -> float:
    """The radius of the agent [m]: that of the inflation, else that of the bake."""
    return exact_radius(grid) or grid.agent_radius


def margins_of(grid: NavGrid, radius: float | None = None) -> Margins:
    """How far an agent of a radius [m], by default the grid's, has to stay away from blocks."""
    if radius is not None:
        check_radius(radius, "margin")
    radius = agent_radius(grid) if radius is None else float(radius)
    if not exact_radius(grid):
        return Margins(radius, radius, radius)
    return Margins(radius, *_larger(radius, max(p.lattice.cell_size for p in grid.levels)))


def find_room(grid: NavGrid) -> tuple[Bool, Bool, Bool] | None:
    """Find the cells clear enough to step diagonally, and those clear off their centres.

    Of the latter, first those that are clear, then with those where only squares of their own
    level may be in the way. Masks by flat id; they say nothing of cells that are not free. None
    without a radius.
    """
    radius = exact_radius(grid)
    if radius == 0.0:
        return None
    ledges, masks = ledges_of(grid), []
    for number, level in enumerate(grid.levels):
        inside = ~_at_edges(level)
        diagonal, anywhere = _larger(radius, level.lattice.cell_size)
        is_clear = inside & ~find_blocked(grid, number, anywhere, ledges)
        by_squares = inside & ~find_blocked_by_others(grid, number, anywhere, ledges)
        can_turn = inside & ~find_blocked(grid, number, diagonal, ledges)
        masks.append([mask.ravel() for mask in (can_turn, is_clear, is_clear | by_squares)])
    one, two, three = (np.concatenate(parts) for parts in zip(*masks, strict=True))
    return one, two, three


def _at_edges(level: SceneGrid2D) -> Bool:
    """Cells with a neighbour whose floor is a step higher or lower, not a slope."""
    floor = level.floor_height.astype(np.float64)
    at_edge = np.zeros(level.shape, dtype=np.bool_)
    for near, far in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        is_step = np.abs(floor[near] - floor[far]) > STEEP * level.cell_size  # False for NaN
        at_edge[near] |= is_step
        at_edge[far] |= is_step
    return at_edge


def _larger(radius: float, cell_size: float) -> tuple[float, float]:
    """Radii [m] at a cell's centre that make a diagonal step, or any position in the cell, free."""
    # Halfway along a diagonal step, half a diagonal from both ends, a point at distance r from the
    # way is the farthest from them: sqrt(r² + (s / sqrt 2)²). A corner of the cell is s / sqrt 2
    # from its centre.
    return math.sqrt(radius**2 + cell_size**2 / 2), radius + cell_size / math.sqrt(2)
