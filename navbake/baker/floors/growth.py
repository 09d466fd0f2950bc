"""Find the floor of each level: where an agent can stand, and where floor continues under things.

The floor begins at the level's surfaces on which an agent can stand. From there it grows cell by
cell under tables, beds and walls, see `growth_kernels`. Links between levels are found here, too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navbake.baker.core.blocks import LEAST_BLOCKS, Blocks, list_rows
from navbake.baker.floors import growth_kernels as kernels
from navbake.baker.floors.growth_kernels import (
    BARRIER,
    NO_FLOOR,
    NO_LEVEL,
    NO_LEVEL_ABOVE,
    GrowingSurfaces,
    GrowthState,
)
from navbake.baker.floors.level_assignment import LevelAssignment
from navbake.baker.floors.regions import Regions
from navbake.baker.floors.surface_kernels import RIDGE_FLAGS
from navbake.baker.floors.surfaces import may_slopes_join
from navbake.config.settings import AgentSettings
from navbake.errors import SceneError
from navbake.threads import LEAST_CELLS, run_in_chunks
from navbake.types import Bool, Float, Int, Int32

# Surfaces whose levels are looked up together: few enough for the cache
SURFACES_PER_PIECE = 1 << 16
NO_CELLS = np.empty(0, dtype=np.int64)
NO_STEPS = np.empty((0, 4), dtype=np.int64)
# Numbers of levels are stored as int16, and the greatest one stands for no level
MAX_LEVELS = int(NO_LEVEL_ABOVE)


class GrownFloor(NamedTuple):
    """The floor of one level in all cells of the lattice, as `grow_levels` finds it.

    Attributes:
        height: the height of the floor in each cell, NaN where there is none, shape (cells,),
            float64 [m].
        ring_of_cell: how many cells the floor had to grow to reach each cell: 0 where an agent can
            stand, -1 where there is no floor, shape (cells,), int32.
    """

    height: Float
    ring_of_cell: Int32


def select_growing_surfaces(
    regions: Regions, assignment: LevelAssignment, is_growth_barrier: Bool
) -> GrowingSurfaces:
    """Select what the growth of floors depends on.

    Args:
        regions: all regions.
        assignment: the level of each surface.
        is_growth_barrier: the regions whose surfaces floors don't grow onto, such as roofs and tops
            of furniture, shape (regions,), bool. Nor do they grow onto ridges, which are in no
            region.
    """
    surfaces = regions.surfaces
    component_of_surface = regions.components.component_of_surface
    # the last entry of each table is for surfaces of no component, and for those on no level
    is_barrier_component = np.append(is_growth_barrier[regions.region_of_component], False)
    level_without_floor = np.where(is_barrier_component, BARRIER, NO_LEVEL).astype(np.int16)
    level_of_number = np.append(assignment.final_level, NO_LEVEL).astype(np.int16)
    level_of_surface = np.empty(len(surfaces.z), dtype=np.int16)

    def write_levels(begin: int, end: int) -> None:
        for first_surface in range(begin, end, SURFACES_PER_PIECE):
            piece = slice(first_surface, min(first_surface + SURFACES_PER_PIECE, end))
            level = level_of_surface[piece]
            number = np.maximum(assignment.preliminary_level[piece], -1)
            # "wrap", as -1 stands for the last entry
            np.take(level_of_number, number, mode="wrap", out=level)
            other_level = np.take(level_without_floor, component_of_surface[piece], mode="wrap")
            other_level[surfaces.flags[piece] == RIDGE_FLAGS] = BARRIER
            np.copyto(level, other_level, where=level == NO_LEVEL)

    run_in_chunks(write_levels, len(surfaces.z), min_chunk_size=LEAST_CELLS)
    return GrowingSurfaces(
        surfaces.lattice, surfaces.first, surfaces.end, surfaces.z, level_of_surface
    )


def grow_levels(
    surfaces: GrowingSurfaces, num_levels: int, agent: AgentSettings
) -> list[GrownFloor]:
    """Find the floors of all levels: where an agent can stand, and where they lie under things.

    Floors continue under tables, beds and other things.

    Args:
        surfaces: all surfaces, with their levels.
        num_levels: how many levels there are.
        agent: the agent, of which the height and step are used.

    Returns:
        The floors, the lowest level first.

    Raises:
        SceneError: there are more levels than `MAX_LEVELS`.
    """
    if num_levels > MAX_LEVELS:
        raise SceneError(
            f"expected at most {MAX_LEVELS} levels, got {num_levels}: raise `floors.min_area`"
        )
    num_cells = surfaces.lattice.width * surfaces.lattice.height
    highest_level_below = np.empty(len(surfaces.z), dtype=np.int16)
    lowest_level_above = np.empty(len(surfaces.z), dtype=np.int16)
    floor_heights = np.empty((num_levels, num_cells))
    ring_of_cells = np.empty((num_levels, num_cells), dtype=np.int32)

    def start_floors(begin: int, end: int) -> None:
        floor_heights[:, begin:end] = np.nan
        ring_of_cells[:, begin:end] = NO_FLOOR
        kernels.start_floors(
            surfaces,
            highest_level_below,
            lowest_level_above,
            floor_heights,
            ring_of_cells,
            begin,
            end,
        )

    run_in_chunks(start_floors, num_cells, min_chunk_size=LEAST_CELLS)
    can_grow = np.empty(len(surfaces.z), dtype=np.uint8)
    floors = []
    for level_number in range(num_levels):
        growth_state = GrowthState(
            surfaces=surfaces,
            highest_level_below=highest_level_below,
            lowest_level_above=lowest_level_above,
            level_number=level_number,
            agent_height=agent.height,
            max_step=agent.traversable_floor_height,
            floor_height=floor_heights[level_number],
            ring_of_cell=ring_of_cells[level_number],
            can_grow=can_grow,
        )
        if growth_state.ring_of_cell.any():  # some cells have no floor yet
            _grow_level(growth_state)
        floors.append(GrownFloor(growth_state.floor_height, growth_state.ring_of_cell))
    return floors


def _grow_level(growth_state: GrowthState) -> None:
    """Let the floor of one level continue under things, from where an agent can stand.

    Args:
        growth_state: the level, with its floor where an agent can stand; its `floor_height`,
            `ring_of_cell` and `can_grow` are written.
    """
    blocks = Blocks(growth_state.surfaces.lattice)
    _, (open_cells,) = blocks.list_rows(
        kernels.start_growth, (NO_CELLS,), growth_state, least=LEAST_BLOCKS
    )
    cells_to_grow = open_cells
    ring_number = 1
    # a ring is the cells that the floor grows into at the same time; all threads grow large rings,
    # one thread grows the small rings after them
    while len(cells_to_grow) >= LEAST_CELLS:
        _, (cells_to_grow,) = list_rows(
            kernels.grow_ring,
            cells_to_grow,
            (NO_CELLS,),
            growth_state,
            ring_number,
            least=LEAST_CELLS,
        )
        ring_number += 1
    kernels.grow_remaining_rings(growth_state, ring_number, cells_to_grow)
    # cells into which no floor grew
    unreached_cells = open_cells[growth_state.ring_of_cell[open_cells] < NO_FLOOR]
    growth_state.ring_of_cell[unreached_cells] = NO_FLOOR


def find_listed_steps(regions: Regions, assignment: LevelAssignment, agent: AgentSettings) -> Int:
    """Find neighboring cells joined by a step between levels, or by a slope too steep for a step.

    These are steps from a floor of one level to a floor of another. They are also places on one
    level where the floors of two neighboring cells differ by more than a step, but a slope joins
    them.

    Args:
        regions: all regions.
        assignment: the level of each surface.
        agent: the agent, of which the step and slope are used.

    Returns:
        The steps, sorted, shape (n, 4), int64. Columns: the lower level, the cell on it, the upper
        level, the cell on it; both levels are the same where a slope joins two cells of one level.
    """
    can_slopes_join = may_slopes_join(regions.lattice, agent)
    if len(assignment.grounds) == 1 and not can_slopes_join:
        return NO_STEPS
    _, (steps,) = regions.blocks.list_rows(
        kernels.list_links,
        (NO_STEPS,),
        regions.surfaces,
        assignment.preliminary_level,
        assignment.final_level,
        agent.traversable_floor_height,
        can_slopes_join,
    )
    return steps[np.lexsort(steps.T[::-1])]
