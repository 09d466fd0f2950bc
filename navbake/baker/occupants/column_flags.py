"""Flags of the cells' columns, which rooms are found by: nothing there, a hole, a bank, the sky."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.arrays import ColumnHits
from navbake.baker.core.limits import agent_limits
from navbake.baker.floors.levels import LevelFloor
from navbake.baker.occupants import list_kernels as kernels
from navbake.baker.occupants.kinds import WALL_HEIGHTS
from navbake.config.settings import AgentSettings
from navbake.threads import LEAST_CELLS, run_in_chunks


def flag_columns(
    hits: ColumnHits,
    level: LevelFloor,
    cells: slice,
    agent: AgentSettings,
    flags: NDArray[np.uint8],
) -> None:
    """Flag the columns of some cells as a level sees them.

    Args:
        hits: of these cells alone, in their order.
        flags: by cell of the lattice, receives `COLUMN_FLAGS` of the kernels.
    """
    floor = level.floor.ravel()[cells]
    run_in_chunks(
        kernels.flag_columns,
        len(floor),
        hits,
        floor,
        level.ground,
        agent_limits(agent),
        WALL_HEIGHTS[0],
        flags[cells],
        least=LEAST_CELLS,
    )
