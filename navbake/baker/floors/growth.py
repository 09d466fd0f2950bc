"""The floor of each level: where an agent can stand, and how the floor extends under things."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navbake.baker.core.blocks import Blocks, list_rows
from navbake.baker.floors import growth_kernels as kernels
from navbake.baker.floors.growth_kernels import NO_FLOOR, GrowthState
from navbake.baker.floors.level_assignment import LevelAssignment
from navbake.baker.floors.region_kernels import LabelledSurfaces
from navbake.baker.floors.regions import Regions
from navbake.baker.floors.surfaces import may_slopes_join
from navbake.config.settings import AgentSettings
from navbake.threads import LEAST_CELLS
from navbake.types import Bool, Float, Int, Int32

NO_CELLS = np.empty(0, dtype=np.int64)
NO_LINKS = np.empty((0, 4), dtype=np.int64)


class GrownFloor(NamedTuple):
    """The floor of a level on the whole lattice.

    Attributes:
        height: the height of the floor in each cell, NaN where there is none, shape (cells,),
            float64 [m].
        ring: the number of the ring in which the floor grew into each cell: 0 where an agent can
            stand, -1 for no floor, shape (cells,), int32.
    """

    height: Float
    ring: Int32


def grow_floors(
    regions: Regions, assignment: LevelAssignment, stops_growth: Bool, agent: AgentSettings
) -> list[GrownFloor]:
    """Find the floor of each level: where an agent can stand, and what grows from there.

    Args:
        regions: all regions.
        assignment: the level of each surface.
        stops_growth: the regions at whose surfaces no floor grows, shape (regions,), bool.
        agent: the agent, of which the height and step are used.

    Returns:
        The floors, the lowest level first.
    """
    labelled = regions.label_surfaces(stops_growth)
    return [
        grow_level(labelled, assignment.level, assignment.final_level, number, agent)
        for number in range(len(assignment.grounds))
    ]


def grow_level(
    labelled: LabelledSurfaces,
    level: Int32,
    final_level: Int,
    grown_level: int,
    agent: AgentSettings,
) -> GrownFloor:
    """Find the floor of one level: where an agent can stand, and what grows from there.

    Args:
        labelled: all surfaces; the labelled regions are those at whose surfaces no floor grows.
        level: `LevelAssignment.level`.
        final_level: `LevelAssignment.final_level`.
        grown_level: the final number of the level whose floor grows.
        agent: the agent, of which the height and step are used.
    """
    surfaces = labelled.surfaces
    num_cells = surfaces.lattice.width * surfaces.lattice.height
    state = GrowthState(
        surfaces=surfaces,
        level=level,
        final_level=final_level,
        grown_level=grown_level,
        height=agent.height,
        step=agent.traversable_floor_height,
        floor=np.empty(num_cells),
        ring=np.empty(num_cells, dtype=np.int32),
        option=np.empty(len(surfaces.z), dtype=np.uint8),
    )
    blocks = Blocks(surfaces.lattice)
    _, (open_cells,) = blocks.list_rows(kernels.start_growth, (NO_CELLS,), labelled, state)
    front = open_cells
    ring_number = 1
    # all threads grow rings of many cells, one thread the rings after them
    while len(front) >= LEAST_CELLS:
        _, (front,) = list_rows(
            kernels.grow_ring, front, (NO_CELLS,), state, ring_number, least=LEAST_CELLS
        )
        ring_number += 1
    kernels.grow_remaining_rings(state, ring_number, front)
    # cells into which no floor grew
    not_reached = open_cells[state.ring[open_cells] < NO_FLOOR]
    state.ring[not_reached] = NO_FLOOR
    return GrownFloor(state.floor, state.ring)


def find_level_links(regions: Regions, assignment: LevelAssignment, agent: AgentSettings) -> Int:
    """Find the steps between levels, and the neighboring cells that only a slope joins.

    Args:
        regions: all regions.
        assignment: the level of each surface.
        agent: the agent, of which the step and slope are used.

    Returns:
        `navbake.baker.floors.levels.Floors.links`, sorted.
    """
    by_slopes = may_slopes_join(regions.lattice, agent)
    if len(assignment.grounds) == 1 and not by_slopes:
        return NO_LINKS
    _, (links,) = regions.blocks.list_rows(
        kernels.list_links,
        (NO_LINKS,),
        regions.surfaces,
        assignment.level,
        assignment.final_level,
        agent.traversable_floor_height,
        by_slopes,
    )
    return links[np.lexsort(links.T[::-1])]
