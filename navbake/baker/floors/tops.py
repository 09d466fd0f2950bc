"""Tops of what stands on a floor, such as beds, blocks and thick walls: no floors themselves."""

import numpy as np

from navbake.baker.columns import Columns
from navbake.baker.floors.outline import DROP, OccupancyTest, find_edges, find_endings
from navbake.baker.floors.sheets import Standable
from navbake.baker.kernels.constants import SLACK, TOUCH
from navbake.baker.kernels.occupancy import lines_blocked
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.types import Float, Int

# A top drops to a floor along at least this share of its outline
DROP_SHARE = 0.25
# With room for an agent under more than this share of it, a sheet is a mezzanine, no top
ROOM_SHARE = 0.5


def drop_tops(
    standable: Standable,
    columns: Columns,
    agent: AgentSettings,
    settings: FloorSettings,
    is_occupied: OccupancyTest,
) -> Standable:
    """Drop the tops of what stands on a floor: beds, blocks, counters, walls that are metres thick.

    A sheet that no step reaches is such a top when at least a quarter of its outline drops to a
    floor that an agent could stand on, beside it (see `find_endings`), and when there is no room
    for an agent under most of it, from the height of that floor up. So a house's floor on its
    plinth is none, because it ends at walls; nor is a mezzanine, because one can stand below.

    Args:
        settings: `shrink`, how far from the sheet's edge the floor may begin [m].
    """
    size, step = standable.sheet_size, agent.traversable_floor_height
    # the side of the thing itself may block the cell at its edge: one more
    reach = int(np.ceil(settings.shrink / standable.lattice.cell_size)) + 1
    edges = find_edges(standable, size > 0, step, reach)
    sheet = standable.sheet[edges.surface]
    enough = DROP_SHARE * np.bincount(sheet, minlength=len(size))
    # most sheets have no floor below their edges: only the others are looked at closely
    has_floor = ~np.isnan(edges.floors).all(axis=1)
    edges = edges.only((np.bincount(sheet, has_floor, len(size)) >= enough)[sheet])
    ending, landing = find_endings(edges, standable, columns, agent, is_occupied)
    drops = ending == DROP
    sheet, landing = standable.sheet[edges.surface[drops]], landing[drops]
    count = np.bincount(sheet, minlength=len(size))
    beside = _medians(sheet, landing, count)
    beside[count < enough] = np.nan
    over_room = _count_over_room(standable, columns, beside, agent)
    return standable.only_sheets(np.isnan(beside) | (over_room > ROOM_SHARE * size))


def _medians(group: Int, values: Float, count: Int) -> Float:
    """The median of each group's values, the lower of two, NaN where a group has none."""
    ordered = values[np.lexsort((values, group))]
    median = np.full(len(count), np.nan)
    filled = np.flatnonzero(count)
    middle = np.cumsum(count) - count + (count - 1) // 2
    median[filled] = ordered[middle[filled]]
    return median


def _count_over_room(
    standable: Standable, columns: Columns, beside: Float, agent: AgentSettings
) -> Int:
    """Count the cells of each sheet under which there is room for an agent.

    It stands there at the height of the floor beside, shape (sheets,), or on a floor above that
    [m]; NaN for sheets that are not asked for.
    """
    asked = np.flatnonzero(~np.isnan(beside[standable.sheet]))
    sheet, cells = standable.sheet[asked], standable.cell[asked]
    floor, step = beside[sheet], agent.traversable_floor_height
    below = asked - 1
    has_floor = (below >= 0) & (standable.cell[below] == cells)
    has_floor &= standable.z[below] >= floor - step - SLACK
    blocked = np.zeros(len(cells), dtype=np.bool_)
    low, high = floor + step + TOUCH, floor + agent.height - TOUCH
    lines_blocked(cells, low, high, columns.crossings, blocked)
    return np.bincount(sheet[has_floor | ~blocked], minlength=len(beside))
