"""The floor of each level: where one can stand, and how it grows under things."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navbake.baker.core.blocks import Blocks, list_rows
from navbake.baker.floors import growth_kernels as kernels
from navbake.baker.floors.growth_kernels import Growing
from navbake.baker.floors.member_kernels import Labelled
from navbake.baker.floors.regions import Regions
from navbake.baker.floors.storeys import Placed
from navbake.baker.floors.surfaces import slopes_may_join
from navbake.config.settings import AgentSettings
from navbake.threads import LEAST_CELLS
from navbake.types import Bool, Float, Int, Int32

NO_CELLS = np.empty(0, dtype=np.int64)
NO_LINKS = np.empty((0, 4), dtype=np.int64)


class GrownFloor(NamedTuple):
    """The floor of a level on the whole lattice.

    Attributes:
        height: by cell, NaN where there is none, float64 [m].
        ring: by cell, in which step it grew there: 0 where one can stand, -1 for none, int32.
    """

    height: Float
    ring: Int32


def grow_floors(
    regions: Regions, placed: Placed, bars: Bool, agent: AgentSettings
) -> list[GrownFloor]:
    """Find the floor of each level, lowest first.

    Args:
        placed: the surfaces on their levels.
        bars: the regions at whose surfaces no floor grows, shape (regions,), bool.
    """
    barred = regions.labelled(bars)
    numbers = range(len(placed.grounds))
    return [grow_level(barred, placed.level, placed.number, n, agent) for n in numbers]


def grow_level(
    barred: Labelled, level: Int32, number: Int, grown_level: int, agent: AgentSettings
) -> GrownFloor:
    """Find the floor of a level: where one can stand, and what grows from there.

    Args:
        barred: all surfaces, and the regions at whose surfaces no floor grows.
        level, number: see `Placed`.
        grown_level: the number of the level.
    """
    surfaces = barred.surfaces
    num_cells = surfaces.lattice.width * surfaces.lattice.height
    growing = Growing(
        surfaces=surfaces,
        level=level,
        number=number,
        own=grown_level,
        height=agent.height,
        step=agent.traversable_floor_height,
        floor=np.empty(num_cells),
        ring=np.empty(num_cells, dtype=np.int32),
        option=np.empty(len(surfaces.z), dtype=np.uint8),
    )
    _, (options,) = Blocks(surfaces.lattice).list_rows(kernels.stand, (NO_CELLS,), barred, growing)
    cells = options
    ring = 1
    # all threads grow rings of many cells, one thread those after them
    while len(cells) >= LEAST_CELLS:
        _, (cells,) = list_rows(
            kernels.grow_ring, cells, (NO_CELLS,), growing, ring, least=LEAST_CELLS
        )
        ring += 1
    kernels.grow(growing, ring, cells)
    not_reached = options[growing.ring[options] < -1]
    growing.ring[not_reached] = -1
    return GrownFloor(growing.floor, growing.ring)


def find_links(regions: Regions, placed: Placed, agent: AgentSettings) -> Int:
    """Find where levels meet, and the neighbours that slopes join but no step does.

    Returns:
        `links` of `navbake.baker.floors.levels.Floors`.
    """
    by_slopes = slopes_may_join(regions.lattice, agent)
    if len(placed.grounds) == 1 and not by_slopes:
        return NO_LINKS
    _, (links,) = regions.blocks.list_rows(
        kernels.list_links,
        (NO_LINKS,),
        regions.surfaces,
        (placed.level, placed.number),
        agent.traversable_floor_height,
        by_slopes,
    )
    return links[np.lexsort(links.T[::-1])]
