"""Flags of the cells' columns, which rooms are found by: nothing there, a hole, a bank, the sky."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from navbake.baker.contents.kinds import WALL_BAND
from navbake.baker.floors.levels import LevelFloor
from navbake.baker.floors.surfaces import agent_limits
from navbake.baker.kernels import gaps as kernels
from navbake.baker.kernels.arrays import Crossings
from navbake.config.settings import AgentSettings
from navbake.threads import LEAST_CELLS, run_in_bands


def flag_columns(
    crossings: Crossings,
    level: LevelFloor,
    cells: slice,
    agent: AgentSettings,
    flags: NDArray[np.uint8],
) -> None:
    """Flag the columns of some cells as a level sees them.

    Args:
        crossings: of these cells alone, in their order.
        flags: by cell of the lattice, receives `COLUMN_FLAGS` of the kernels.
    """
    floor = level.floor.ravel()[cells]
    run_in_bands(
        kernels.flag_columns,
        len(floor),
        crossings,
        floor,
        level.ground,
        agent_limits(agent),
        WALL_BAND[0],
        flags[cells],
        least=LEAST_CELLS,
    )
