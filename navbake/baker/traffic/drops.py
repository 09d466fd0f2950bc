"""Links that are found at edges of floors: drops, one way down, and jumps over gaps."""

from __future__ import annotations

import numpy as np

from navbake.baker.kernels.constants import SLACK
from navbake.baker.traffic.ground import LEAP, WAYS, Ground, MadeLink
from navbake.config.traffic import LinkSettings
from navbake.types import Bool, Float, Int

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
    most = SLACK + (rule.height or (DROP if is_drop else ground.step))

    def land(rows: Int, cols: Int, z: Float, between: int) -> tuple[Int, Bool, Bool]:
        rise: Float = np.nan_to_num(ground.floors[:, rows, cols] - z, nan=-np.inf)
        goes_on = np.asarray(~(np.abs(rise) <= ground.step).any(axis=0))
        if is_drop:  # it falls onto the highest
            rise = np.where(rise < -ground.step, rise, -np.inf)
            level, lands = rise.argmax(axis=0), goes_on & (rise.max(axis=0) >= -most)
        else:
            level = np.abs(rise).argmin(axis=0)
            lands = (np.abs(rise).min(axis=0) <= most) & (between > 0)
        lands = lands & ground.free[level, rows, cols]
        return level, np.asarray(lands), goes_on

    gap, ways = GAP if rule.gap is None else rule.gap, range(len(WAYS) if is_drop else 2)
    parts = [ground.look_out((n, free), ways, gap, land) for n, free in enumerate(ground.free)]
    found = np.concatenate([np.empty(0, dtype=LEAP), *parts])
    links = []
    for _, middle, width in ground.group(found[ground.are_clear(found, ground.space)]):
        _, level, cell, other, other_cell, *_ = middle.tolist()
        back = (int(middle["way"]) + 2) % len(WAYS)
        stops = [
            ground.stand_back(level, cell, back, width),
            ground.stand_back(other, other_cell, int(middle["way"]), width),
        ]
        links.append(MadeLink(stops, {"one_way": is_drop, "width": width}))
    return links
