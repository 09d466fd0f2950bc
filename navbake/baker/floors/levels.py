"""Levels and floors: from the surfaces of all columns to the floors of each storey."""

from dataclasses import dataclass

import numpy as np

from navbake.baker.columns import Columns
from navbake.baker.floors.grounds import assign_levels, find_grounds, lower_grounds
from navbake.baker.floors.kernels.sheets import find_links, grow_floor
from navbake.baker.floors.outline import OccupancyTest
from navbake.baker.floors.roofs import drop_roofs, is_walled
from navbake.baker.floors.sheets import Standable, drop_furniture, find_standable
from navbake.baker.floors.tops import drop_tops
from navbake.baker.kernels.constants import SLACK
from navbake.baker.scene.shapes import Shapes
from navbake.config.settings import AgentSettings, FloorSettings, LevelSettings
from navbake.errors import SceneError
from navbake.types import Bool, Float, Int


@dataclass(frozen=True)
class LevelFloor:
    """One storey on the whole lattice.

    Attributes:
        name: as given, or ``level <number>``, lowest first.
        ground: ground height [m].
        floor: floor heights, shape (height, width), float64, NaN for none [m].
        standable: where the floor is a standable surface, shape (height, width), bool.
    """

    name: str
    ground: float
    floor: Float
    standable: Bool


@dataclass(frozen=True)
class DroppedSheet:
    """A sheet that is no floor: the top of furniture (see `drop_tops`), or a roof.

    Attributes:
        geom: the geom that most of it belongs to.
        height: of its highest point, world z [m].
        area: [m²].
    """

    geom: int
    height: float
    area: float


@dataclass(frozen=True)
class Floors:
    """All storeys, lowest first, and where they meet.

    Attributes:
        levels: the storeys.
        links: level a, cell a, level b, cell b of each step between two levels, shape (n, 4),
            int64, cells on the whole lattice.
        tops: large tops that are no floors, the largest first.
        roofs: roofs that walls stand on, likewise: storeys that nobody put a ceiling on?
    """

    levels: list[LevelFloor]
    links: Int
    tops: list[DroppedSheet]
    roofs: list[DroppedSheet]


def find_floors(
    columns: Columns,
    shapes: Shapes,
    agent: AgentSettings,
    settings: FloorSettings,
    given: list[LevelSettings] | None,
    is_occupied: OccupancyTest,
) -> Floors:
    """Find the storeys, the floor of each, and the steps between them.

    Args:
        shapes: the geometry that the columns were cast at.
        given: the levels of the configuration, or None to find them.

    Raises:
        SceneError: there is no floor at all, or none on a given level.
    """
    standable, floor_like = find_standable(columns, shapes, agent)
    if not len(standable.z):
        raise SceneError(_no_floor(columns, floor_like, agent))
    counted = drop_furniture(standable, settings)
    if not len(counted.z):
        raise SceneError(
            f"no floor: the largest standable sheet keeps less than {settings.min_area:g} m² "
            f"after shrinking by {settings.shrink:g} m; lower `floors.min_area` or "
            f"`floors.shrink` if it is a floor"
        )
    tops: list[DroppedSheet] = []
    roofs: list[DroppedSheet] = []
    names: list[str | None] = []
    if not settings.tops:
        every = counted
        counted = drop_tops(every, columns, agent, settings, is_occupied)
        tops = _describe_dropped(every, counted, columns)
    if given is None and not settings.roofs:
        every = counted
        counted = drop_roofs(every, columns, agent, is_occupied)
        roofs = _describe_dropped(every, counted, columns, walled_by=agent.height)
    if given is None:
        grounds = lower_grounds(counted, find_grounds(counted, agent, settings), agent)
    else:
        counted = _within_given(counted, given, columns)
        grounds, names = [level.ground for level in given], [level.name for level in given]
    level, grounds, labels = assign_levels(counted, grounds, names)
    floor_like[counted.surface] = False  # a floor goes on only where no other one is
    levels = [
        LevelFloor(label, ground, *_level_floor(k, level, counted, columns, floor_like, agent))
        for k, (label, ground) in enumerate(zip(labels, grounds, strict=True))
    ]
    return Floors(levels, _cell_links(counted, level, agent), tops, roofs)


def _describe_dropped(
    every: Standable, counted: Standable, columns: Columns, walled_by: float | None = None
) -> list[DroppedSheet]:
    """Describe the sheets that were dropped, or those with walls of a height around them."""
    dropped = []
    gone = np.flatnonzero((every.sheet_size > 0) & (counted.sheet_size == 0))
    for _, members in every.members(gone):
        z = every.z[members]
        if walled_by is None or is_walled(every.cell[members], z, columns, walled_by):
            geoms = columns.geom[every.surface[members]]
            area = len(members) * every.lattice.cell_size**2
            dropped.append(DroppedSheet(int(np.bincount(geoms).argmax()), float(z.max()), area))
    return sorted(dropped, key=lambda sheet: -sheet.area)


def _within_given(standable: Standable, given: list[LevelSettings], columns: Columns) -> Standable:
    """Keep the surfaces between the grounds and the tops of the given levels."""
    kept = np.zeros(len(standable.z), dtype=np.bool_)
    next_grounds = [*(level.ground for level in given[1:]), np.inf]
    for number, (level, above) in enumerate(zip(given, next_grounds, strict=True)):
        top = above if level.top is None else min(above, level.top)
        on_level = (standable.z >= level.ground - SLACK) & (standable.z < top - SLACK)
        if not on_level.any():
            name = f"level {level.name!r}" if level.name else f"level {number}"
            low, high = float(columns.z.min()), float(columns.z.max())
            raise SceneError(
                f"no floor on {name} (ground {level.ground:g} m, top {top:g} m) of `levels`: "
                f"the scene's surfaces span {low:g} to {high:g} m"
            )
        kept |= on_level
    return standable.only(kept)


def _level_floor(
    k: int, level: Int, standable: Standable, columns: Columns, goes_on: Bool, agent: AgentSettings
) -> tuple[Float, Bool]:
    """The floor of level `k`, continued where `goes_on`; and where it is standable."""
    lattice, cells, z = standable.lattice, standable.cell, standable.z
    floor = np.full(lattice.width * lattice.height, np.nan)
    floor[cells[level == k]] = z[level == k]
    is_standable = ~np.isnan(floor)
    lowest, highest = np.full(floor.shape, -np.inf), np.full(floor.shape, np.inf)
    below, above = np.flatnonzero(level < k), np.flatnonzero(level > k)[::-1]
    # of several in a column, the last one written stays: here the highest, there the lowest
    lowest[cells[below]] = z[below] + agent.height - SLACK
    highest[cells[above]] = z[above] - agent.height + SLACK
    step = agent.traversable_floor_height
    grow_floor(lattice, columns.crossings, goes_on, floor, lowest, highest, step)
    return floor.reshape(lattice.shape), is_standable.reshape(lattice.shape)


def _cell_links(standable: Standable, level: Int, agent: AgentSettings) -> Int:
    step = agent.traversable_floor_height
    a, b = find_links(standable.lattice, standable.start, standable.z, level, step).T
    links = np.stack([level[a], standable.cell[a], level[b], standable.cell[b]], axis=1)
    return links[np.lexsort(links.T[::-1])]


def _no_floor(columns: Columns, floor_like: Bool, agent: AgentSettings) -> str:
    if not len(columns.z):
        return "no floor at all: no vertical line through a cell's centre meets a geom"
    if not floor_like.any():
        return (
            f"no floor at all: none of {len(columns.z)} surfaces faces up within "
            f"{agent.max_slope:g}° (a mesh may be inside out, or `scene.up` wrong)"
        )
    return (
        f"no floor at all: none of {int(floor_like.sum())} surfaces that face up has "
        f"{agent.height:g} m of headroom (a wrong unit, or everything lies inside of a solid)"
    )
