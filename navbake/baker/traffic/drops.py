"""Links that are found at edges of floors: drops, one way down, and jumps over gaps."""

from __future__ import annotations

import numpy as np

from navbake.baker.kernels.constants import SLACK
from navbake.baker.traffic.ground import (
    WAYS,
    Ground,
    Leaps,
    MadeLink,
    group_leaps,
    middle_of,
)
from navbake.config.traffic import LinkSettings
from navbake.types import Bool, Float

DROP, GAP = 1.0, 0.5  # heights of drops, and gaps, that are not in the settings [m]


def find_edges(ground: Ground, rule: LinkSettings) -> list[MadeLink]:
    """Find the drops or jumps of a rule, up to its height and over gaps up to its own [m].

    An edge is a free cell beside which no floor lies within a step. A drop leads straight from
    there to the first free cell that is lower than that; the agent goes on at its height and falls.
    A jump leads over a gap of at least a cell to a floor at about the same height, within a step
    unless the rule has a height. Nothing stands in the way: between them and over both ends, up to
    the agent's height over the higher one. Those side by side are one link, at their middle, whose
    stops are as far from the edge as an agent of its width needs, see `Ground.stand_back`.
    """
    is_drop = rule.auto == "drop"
    height = rule.height or (DROP if is_drop else ground.step)
    found = _cross(ground, GAP if rule.gap is None else rule.gap, height, is_drop=is_drop)
    found = found.only(_are_clear(found, ground))
    links = []
    for group in group_leaps(found, ground):
        k = group[middle_of(found.cell[group], ground.lattice)]
        width, way = round(ground.width_of(found.cell[group]), 6), int(found.way[k])
        stops = []
        for level, cell, back in (
            (int(found.level[k]), int(found.cell[k]), (way + 2) % 4),
            (int(found.other_level[k]), int(found.other_cell[k]), way),
        ):
            stops.append(ground.stop(level, ground.stand_back(level, cell, back, width)))
        links.append(MadeLink(stops, {"one_way": is_drop, "width": width}))
    return links


def _cross(ground: Ground, gap: float, height: float, *, is_drop: bool) -> Leaps:
    """The nearest landing of each edge in each direction; of jumps, in two of the four."""
    floors, free, (rows, cols) = ground.floors, ground.free, ground.lattice.shape
    parts = list[Leaps]()
    for way, (down, right) in enumerate(WAYS if is_drop else WAYS[:2]):
        for level in range(len(floors)):
            row, col = np.nonzero(free[level])
            z = floors[level, row, col]
            for num_between in range(ground.cells_in(gap) + 1):
                r, c = row + (num_between + 1) * down, col + (num_between + 1) * right
                inside = (r >= 0) & (r < rows) & (c >= 0) & (c < cols)
                row, col, z, r, c = (array[inside] for array in (row, col, z, r, c))
                heights: Float = floors[:, r, c] - z  # NaN for no floor
                with np.errstate(invalid="ignore"):
                    goes_on = ~(np.abs(heights) <= ground.step).any(axis=0)
                    if is_drop:
                        lower = np.where(heights < -ground.step, heights, -np.inf)
                        other = lower.argmax(axis=0)  # it falls onto the highest
                        lands = goes_on & (lower.max(axis=0) >= -height - SLACK)
                    else:
                        off = np.where(np.isnan(heights), np.inf, np.abs(heights))
                        other = off.argmin(axis=0)
                        lands = (off.min(axis=0) <= height + SLACK) & (num_between > 0)
                lands &= free[other, r, c]
                goes_on &= ~lands
                here = [array[lands] for array in (row, col, r, c, other)]
                count, width = len(here[0]), cols
                parts.append(
                    Leaps(
                        np.full(count, way),
                        np.full(count, level),
                        here[0] * width + here[1],
                        here[4],
                        here[2] * width + here[3],
                        np.full(count, num_between),
                        z[lands],
                        floors[here[4], here[2], here[3]],
                    )
                )
                row, col, z = row[goes_on], col[goes_on], z[goes_on]
    return Leaps.join(parts)


def _are_clear(found: Leaps, ground: Ground) -> Bool:
    """Whether nothing stands in the way of each, at its higher end and down to its lower one."""
    top = np.maximum(found.z, found.other_z)
    cells, owner = found.cells_passed(ground.lattice.width)
    asked = [(cells, top[owner], owner), (found.cell, top, np.arange(len(top)))]
    # the fall, in volumes over each other without a gap
    stride = ground.agent.height - ground.agent.traversable_floor_height
    low = found.other_z + stride
    while (falls := np.flatnonzero(low < top)).size:
        asked.append((found.other_cell[falls], low[falls], falls))
        low = low + stride
    cell, z, whose = (np.concatenate(arrays) for arrays in zip(*asked, strict=True))
    clear = np.ones(len(top), dtype=np.bool_)
    clear[whose[~ground.space.is_free(cell, z)]] = False
    return clear
