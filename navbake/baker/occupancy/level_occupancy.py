"""Checks which cells of each level are occupied, and lists the geoms over their floors.

The structure of a bake is checked by this, and so are movables, see `navbake.baker.occupants`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.columns import Columns, TiledShapes
from navbake.baker.core.arrays import HeightRange
from navbake.baker.core.components import expand_ranges
from navbake.baker.core.limits import make_agent_limits
from navbake.baker.core.tolerances import TOUCH_DEPTH
from navbake.baker.floors.levels import Floors
from navbake.baker.occupancy.footprint import Footprint
from navbake.baker.occupancy.occupancy import NO_OCCUPANT_LISTS, CellOccupancy, check_occupancy
from navbake.baker.occupancy.volume_kernels import OccupantLists
from navbake.config.settings import AgentSettings
from navbake.types import Bool, Int, Int32

# Heights over a floor at which walls are, but neither sills nor most furniture [m]
WALL_HEIGHTS = HeightRange(1.5, 1.8)
# The last level ends this far above its floors [m]
TOP_LEVEL_HEIGHT = 100.0


class LevelOccupancy(NamedTuple):
    """The occupancy of some cells of a level, and the lists of the geoms in them.

    Attributes:
        cells: ids of the checked cells that have a floor, shape (n,).
        occupancy: the occupancy of these cells.
        occupant_lists: where the list of each cell's geoms begins in `occupancy.geom`; all arrays
            are empty if no lists were requested.
    """

    cells: Int
    occupancy: CellOccupancy
    occupant_lists: OccupantLists


def find_level_ceilings(floors: Floors) -> list[float]:
    """Return the height at which each level ends: the next level's ground, inf for the last [m]."""
    return [*(level.ground for level in floors.levels[1:]), np.inf]


def check_level_occupancy(
    columns: Columns,
    tiled_shapes: TiledShapes,
    footprint: Footprint,
    cells: Int,
    floors: Floors,
    agent: AgentSettings,
    wall_candidates: Bool | None,
) -> list[LevelOccupancy]:
    """Check which cells of each level are occupied by geoms, and list the geoms in each cell.

    All levels are checked in one pass over the geoms.

    Args:
        columns: the geoms' hits on the vertical line through each cell's centre.
        tiled_shapes: the geoms near the cells.
        footprint: the volume over a floor that has to be free.
        cells: cell ids, ascending.
        floors: the floors of all levels.
        agent: the agent; its height and largest slope are read.
        wall_candidates: mask by geom id of the geoms that are tested for AT_WALL_HEIGHT, bool; None
            to list no occupants.

    Returns:
        For each level, its cells that have a floor, their occupancy, and the lists of their
        occupants. All levels' lists are in the same arrays.
    """
    # the floors of all levels, in ascending order of cells, and of heights in a cell
    floor_by_level = np.stack([level.floor.ravel()[cells] for level in floors.levels], axis=1)
    has_floor = ~np.isnan(floor_by_level)
    cell_index, level_number = np.nonzero(has_floor)
    floor_heights = floor_by_level[has_floor]
    if np.any((np.diff(cell_index) == 0) & (np.diff(floor_heights) < 0)):  # levels interleave
        sort_indices = np.lexsort((floor_heights, cell_index))
        cell_index = cell_index[sort_indices]
        level_number = level_number[sort_indices]
        floor_heights = floor_heights[sort_indices]
    floor_cells = cells[cell_index]
    # index of each level's floor in each cell among all these floors
    floor_index = np.empty(has_floor.shape, dtype=np.int64)
    floor_index[cell_index, level_number] = np.arange(len(floor_heights))
    occupant_lists = NO_OCCUPANT_LISTS
    if wall_candidates is not None:
        level_ceilings = np.array(find_level_ceilings(floors))
        ceiling = np.minimum(level_ceilings[level_number], floor_heights + TOP_LEVEL_HEIGHT)
        occupant_lists = OccupantLists(
            ceiling=np.maximum(ceiling, floor_heights + agent.height) - TOUCH_DEPTH,
            list_start=np.empty(len(floor_cells), dtype=np.int32),
            floor_geom=np.empty(len(floor_cells), dtype=np.int32),
            gap_below=np.empty(len(floor_cells)),
            is_wall_candidate=wall_candidates,
            wall_low=WALL_HEIGHTS.low + TOUCH_DEPTH,
            wall_high=WALL_HEIGHTS.high - TOUCH_DEPTH,
            min_normal_z=make_agent_limits(agent).min_normal_z,
        )
    occupancy = check_occupancy(
        columns, tiled_shapes, footprint, floor_cells, floor_heights, occupant_lists
    )
    occupancy_by_level = []
    for has_level_floor, level_floor_index in zip(has_floor.T, floor_index.T, strict=True):
        floor_indices = level_floor_index[has_level_floor]
        level_lists = occupant_lists
        if wall_candidates is not None:
            level_lists = occupant_lists._replace(
                ceiling=occupant_lists.ceiling[floor_indices],
                list_start=occupant_lists.list_start[floor_indices],
                floor_geom=occupant_lists.floor_geom[floor_indices],
                gap_below=occupant_lists.gap_below[floor_indices],
            )
        cell_occupancy = occupancy._replace(
            occupied=occupancy.occupied[floor_indices],
            square_occupied=occupancy.square_occupied[floor_indices],
        )
        occupancy_by_level.append(
            LevelOccupancy(cells[has_level_floor], cell_occupancy, level_lists)
        )
    return occupancy_by_level


def select_list_entries(
    list_starts: Int32, geom: Int32, flags: NDArray[np.uint8], cells: Int
) -> tuple[Int, Int32, NDArray[np.uint8]]:
    """Return the geoms that are listed for some cells, ordered by cell and then geom.

    Args:
        list_starts: by cell id, the index into `geom` at which the cell's list begins. The list
            ends before the next -1 in `geom`.
        geom: geom ids of all lists, one list after the other.
        flags: the flags of each entry of `geom`.
        cells: cell ids, shape (n,).

    Returns:
        For each pair of a cell and a geom in it: the index of the cell in `cells`, the geom's id,
        and its flags.
    """
    first_entries = list_starts[cells]
    list_lengths = np.zeros(len(cells), dtype=np.int64)
    unfinished_lists = np.flatnonzero(geom[first_entries] >= 0)
    while len(unfinished_lists):  # cells whose lists go on
        list_lengths[unfinished_lists] += 1
        next_geom = geom[first_entries[unfinished_lists] + list_lengths[unfinished_lists]]
        unfinished_lists = unfinished_lists[next_geom >= 0]
    cell_index, entry_index = expand_ranges(first_entries, first_entries + list_lengths)
    return cell_index, geom[entry_index], flags[entry_index]
