"""What a grid says of its inflation, and which cells an inflation may have closed."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter

from navbake.navgrid.grid_base import GridBase
from navbake.types import Bool

MODES = ("exact", "minos")
FARTHEST = 10_000.0  # the largest radius, and the largest clearance [m]


class Inflation(NamedTuple):
    """What a grid's metadata say under `inflation`.

    Attributes:
        reach: how far from a cell's centre may be what closed it [m]; None if nothing is said of
            any inflation.
        broken: what is wrong with it, in words; None if nothing is.
    """

    reach: float | None
    broken: str | None


def read_inflation(grid: GridBase) -> Inflation:
    """Read what a grid's metadata say of its inflation; what can't be read counts as nothing."""
    stated = grid.metadata.get("inflation")
    if stated is None:
        return Inflation(None, None)
    if not isinstance(stated, list):
        return Inflation(None, f"`inflation` is {stated!r}, expected a list of what was done")
    reaches, broken = [], None
    for number, entry in enumerate(stated):
        reach = _reach_of(entry)
        if reach is not None:
            reaches.append(reach)
        elif broken is None:
            broken = f"`inflation[{number}]` is {entry!r}, expected its radius [m] and mode"
    return Inflation(max(reaches, default=None), broken)


def _reach_of(entry: Any) -> float | None:
    """Radius and clearance in all [m]; None for what `inflate` doesn't write."""
    if not isinstance(entry, dict) or entry.get("mode") not in MODES:
        return None
    lengths: list[Any] = [entry.get("radius"), entry.get("clearance", 0)]
    are_numbers = all(type(length) in (int, float) for length in lengths)
    if not are_numbers or not all(0 <= length <= FARTHEST for length in lengths):
        return None
    return float(sum(lengths))


def find_reasons(grid: GridBase, number: int, reach: float) -> Bool:
    """The cells of a level that have something within reach [m] for which they may be closed.

    That is a cell that is occupied or has no floor, a floor more than a step higher or lower, a
    floor of another level less than the agent's height away, or the edge of the level. They are
    looked for in a square, so that more cells have a reason than an inflation closes, never less.
    """
    level = grid.levels[number]
    cells = min(math.ceil(reach / level.lattice.cell_size) + 1, max(level.shape))
    floor, size = level.floor, 2 * cells + 1
    blocks = (level.occupancy != 0) | np.isnan(floor) | _near_levels(grid, number)
    found: Bool = maximum_filter(blocks, size, mode="constant", cval=True)
    high = maximum_filter(np.where(np.isnan(floor), -np.inf, floor), size)
    low = minimum_filter(np.where(np.isnan(floor), np.inf, floor), size)
    with np.errstate(invalid="ignore"):  # where there is no floor
        found |= (high - floor > grid.max_step) | (floor - low > grid.max_step)
    return found


def _near_levels(grid: GridBase, number: int) -> Bool:
    """The cells of a level where another one has a floor less than the agent's height away."""
    level = grid.levels[number]
    near, own = np.zeros(level.shape, dtype=np.bool_), level.floor
    known = own[~np.isnan(own)]
    for other in grid.levels:
        if other is level or not len(known):
            continue
        floor, body = other.floor, grid.agent_height
        at = np.argwhere((floor > known.min() - body) & (floor < known.max() + body))
        rows, cols = level.lattice.rows_cols(other.lattice.positions(at[:, 0], at[:, 1]))
        inside = (rows >= 0) & (cols >= 0) & (rows < level.height) & (cols < level.width)
        near[rows[inside], cols[inside]] = True
    return near
