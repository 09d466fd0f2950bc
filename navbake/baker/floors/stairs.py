"""Stairs: the treads, ramps and landings between floors, which open no storeys."""

import numpy as np

from navbake.baker.floors.kernels.places import climb
from navbake.baker.floors.kernels.sheets import find_links, join_by_steps
from navbake.baker.floors.sheets import Standable
from navbake.config.settings import AgentSettings
from navbake.types import Bool, Float, Int

# Floors whose heights round to the same multiple of this are one plateau [m]
PLATEAU = 0.02
# How many times larger the floors are that a stair joins than any of its treads and landings
TIMES_LARGER = 4


def find_stairs(standable: Standable, agent: AgentSettings) -> Bool:
    """Tell stairs and ramps from the floors that they join.

    A tread, a landing or a piece of a ramp is a part of a stair when by going only up from it one
    gets to a floor more than four times as large, and so by going only down. So a mezzanine is
    none, because its stair only leads down; nor is a cellar, nor the floor of a tower on its way
    up, which is as large as the others. How large a floor is counts everything of its sheet at
    about its height, since walls and thresholds divide floors.

    Returns:
        Which surfaces are parts of stairs, shape (n,), bool. None is where no two surfaces lie
        over each other, because there it makes no difference.
    """
    lattice, start, z = standable.lattice, standable.start, standable.z
    step = agent.traversable_floor_height
    if (np.diff(start) <= 1).all():
        return np.zeros(len(z), dtype=np.bool_)
    part, size = join_by_steps(lattice, start, z, standable.sheet, PLATEAU)
    low = np.full(len(size), np.inf)
    np.minimum.at(low, part, z)
    area = _areas_about(standable, max(step, PLATEAU) / 2)
    floor_area = np.zeros(len(size), dtype=np.int64)
    np.maximum.at(floor_area, part, area)
    a, b = part[find_links(lattice, start, z, part.astype(np.int64), step)].T
    lower, upper = np.where(low[a] < low[b], (a, b), (b, a))
    rises = low[lower] < low[upper]
    lower, upper = lower[rises], upper[rises]
    orders = np.argsort(low[lower], kind="stable"), np.argsort(low[upper], kind="stable")
    above, below = climb(lower, upper, floor_area, *orders)
    stair_parts = TIMES_LARGER * floor_area < np.minimum(above, below)
    is_stair: Bool = stair_parts[part]
    return is_stair


def _areas_about(standable: Standable, half_step: float) -> Int:
    """How many surfaces of its sheet are at about the height of each, within half a step."""
    sheet, z = standable.sheet, standable.z
    order = np.lexsort((z, sheet))
    # one sheet after the other on one axis, so far apart that no window reaches the next
    span = float(z.max() - z.min()) + 4 * half_step
    rank: Int = np.cumsum(np.diff(sheet[order], prepend=sheet[order[0]]) != 0)
    place: Float = rank * span + (z[order] - z.min())
    area = np.empty(len(z), dtype=np.int64)
    first = np.searchsorted(place, place - half_step, side="left")
    area[order] = np.searchsorted(place, place + half_step, side="right") - first
    return area
