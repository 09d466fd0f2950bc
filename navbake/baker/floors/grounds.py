"""Grounds: at which heights the storeys begin, and which surface is on which storey."""

import numpy as np

from navbake.baker.floors.kernels.places import place_on_levels
from navbake.baker.floors.kernels.sheets import find_links, group_members, join_by_steps
from navbake.baker.floors.sheets import AreaTest, Standable
from navbake.baker.floors.stairs import PLATEAU
from navbake.baker.kernels.constants import SLACK
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.types import Bool, Float, Int, Int32

# Decimals of the grounds that are found: what a float adds to 3.0 is no height
DECIMALS = 9


def find_grounds(
    standable: Standable, is_stair: Bool, agent: AgentSettings, settings: FloorSettings
) -> list[float]:
    """Find the ground heights of the storeys, lowest first.

    The lowest storey's ground is the lowest floor that is large enough (as sheets are, after
    shrinking). A new storey begins where floors that are large enough lie over floors of the
    storey below; so a hill, a half-storey beside another, or a platform with nothing under it
    opens none, nor do stairs with their landings. What is too small for that gets its place in
    `assign_levels`.

    Args:
        is_stair: which surfaces are parts of stairs, see `find_stairs`, shape (n,).
    """
    cells, z = standable.cell, standable.z
    is_lowest = _lowest_of_columns(cells)
    ground = _lowest_plateau(standable, np.flatnonzero(is_lowest & ~is_stair), agent, settings)
    grounds = [_common_height(z[is_lowest]) if ground is None else ground]
    rest = np.flatnonzero(~is_lowest & ~is_stair)
    while len(rest):
        ground = _lowest_plateau(standable, rest, agent, settings)
        if ground is None:
            break
        grounds.append(ground)
        above = np.flatnonzero(z >= ground - SLACK)
        rest = above[~_lowest_of_columns(cells[above]) & ~is_stair[above]]
    return [round(ground, DECIMALS) for ground in grounds]


def lower_grounds(
    standable: Standable, is_stair: Bool, grounds: list[float], agent: AgentSettings
) -> list[float]:
    """Lower each ground to what lies a little below it and is connected to nothing else.

    A part of the level below that lies within a step under a ground, and that steps join to
    nothing but the level of that ground, belongs up there: few floors are quite flat. A stair's
    upper treads are no such part.
    """
    step, lattice = agent.traversable_floor_height, standable.lattice
    for _ in grounds[1:]:
        level = _place(standable, is_stair, grounds)
        group = level.astype(np.int32)
        part, size = join_by_steps(lattice, standable.start, standable.z, group, step)
        links = find_links(lattice, standable.start, standable.z, level, step)
        here, there = np.concatenate([links, links[:, ::-1]]).T
        lowered = list(grounds)
        low = np.full(len(size), np.inf)
        np.minimum.at(low, part, standable.z)
        has_floor = np.bincount(part[~is_stair], minlength=len(size)) > 0
        for k in range(1, len(grounds)):
            on_below, is_above = level[here] == k - 1, level[there] == k
            to_above, to_others = (
                np.bincount(part[here[on_below & on_other]], minlength=len(size)) > 0
                for on_other in (is_above, ~is_above)
            )
            joins = has_floor & to_above & ~to_others & (low >= grounds[k] - step - SLACK)
            if joins.any():
                lowered[k] = min(grounds[k], round(float(low[joins].min()), DECIMALS))
        if lowered == grounds:
            break
        grounds = lowered
    return grounds


def assign_levels(
    standable: Standable,
    is_stair: Bool,
    grounds: list[float],
    names: list[str | None],
    tolerance: float,
) -> tuple[Int, list[float], list[str]]:
    """Give each surface its level; none shares a column's level with another.

    A surface belongs to the highest ground at or below it (the lowest ones to the first). Where
    two of a column would be on one level, its surfaces are placed on the levels in their order,
    treads and landings of stairs moved rather than floors (see `place_on_levels`). Only where a
    column has more surfaces than there are levels, a level of its own is opened at the lowest
    surface that found no place.

    Args:
        is_stair: which surfaces are parts of stairs, shape (n,).
        names: the levels' names, None for those without; empty if none has one.
        tolerance: how far below a ground its floors may lie [m].

    Returns:
        The level of each surface, shape (n,), int64, the grounds and the names of all levels.
    """
    named = dict(zip(grounds, names, strict=False))
    grounds = sorted(grounds)
    level = _place(standable, is_stair, grounds, tolerance)
    while (level < 0).any():
        grounds = sorted([*grounds, _own_ground(standable.z[level < 0], grounds)])
        level = _place(standable, is_stair, grounds, tolerance)
    used = np.unique(level)
    grounds = [grounds[k] for k in used]
    return np.searchsorted(used, level), grounds, _label([named.get(ground) for ground in grounds])


def _label(names: list[str | None]) -> list[str]:
    """Name the levels that have no name by their number; no two are called the same."""
    labels: list[str] = []
    for number, name in enumerate(names):
        label = name or f"level {number}"
        while label in labels or (not name and label in names):
            label += "'"
        labels.append(label)
    return labels


def _lowest_of_columns(cells: Int32) -> Bool:
    """Mark the first surface of each column, given the cells of sorted surfaces."""
    return np.concatenate([[True], cells[1:] != cells[:-1]])[: len(cells)]


def _common_height(z: Float) -> float:
    """The lowest member of the most common height, rounded to plateaus [m]."""
    level: Int = np.round(z / PLATEAU).astype(np.int64)
    level = level - level.min()
    return float(z[level == np.bincount(level).argmax()].min())


def _lowest_plateau(
    standable: Standable, surfaces: Int, agent: AgentSettings, settings: FloorSettings
) -> float | None:
    """The ground of the lowest large floor among surfaces, or None.

    Looks through windows of heights one step high, half a step apart, from the lowest up.
    """
    lattice, cells, z = standable.lattice, standable.cell[surfaces], standable.z[surfaces]
    half_step = max(agent.traversable_floor_height, PLATEAU) / 2
    place = z - z.min()
    place /= half_step
    window: Int32 = place.astype(np.int32)
    del place
    counts = np.bincount(window)
    start, member = group_members(window, counts)
    test = AreaTest(lattice, settings)
    both = counts + np.append(counts[1:], 0)
    for number in np.flatnonzero((both > 0) & (both >= test.needed)):
        chosen = member[start[number] : start[min(number + 2, len(counts))]]
        if test.passes(cells[chosen]):
            heights = z[chosen][test.inner(cells[chosen])]
            # the cells that shrinking leaves decide, not stairs or thresholds at the edge
            return _common_height(heights if len(heights) else z[chosen])
    return None


def _place(
    standable: Standable, is_stair: Bool, grounds: list[float], tolerance: float = SLACK
) -> Int:
    """The level of each surface by the grounds, -1 where all that it could go to are taken."""
    base = np.searchsorted(np.array(grounds) - tolerance, standable.z, side="right") - 1
    level = np.empty(len(standable.z), dtype=np.int64)
    place_on_levels(standable.start, np.maximum(base, 0), is_stair, len(grounds), level)
    return level


def _own_ground(lost: Float, grounds: list[float]) -> float:
    """The lowest height among surfaces without a level that is no ground yet [m]."""
    new = lost[np.abs(lost[:, None] - grounds).min(axis=1) > SLACK]
    # where all are grounds, their columns are taken on every level: open one above all
    return round(float(new.min()), DECIMALS) if len(new) else max(grounds) + 1.0
