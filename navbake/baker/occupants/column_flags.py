"""Flags cells by the hits of structure on the vertical line through their centres.

A cell can be empty, a hole, steep ground, under the sky, or hold something tall.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from navbake.baker.core.arrays import ColumnHits
from navbake.baker.core.limits import make_agent_limits
from navbake.baker.floors.levels import LevelFloor
from navbake.baker.occupancy.occupancy import WALL_HEIGHTS
from navbake.baker.occupants import column_flag_kernels as kernels
from navbake.config.settings import AgentSettings
from navbake.threads import LEAST_CELLS, run_in_chunks


def flag_columns(
    hits: ColumnHits,
    level: LevelFloor,
    cells: slice,
    agent: AgentSettings,
    flags: NDArray[np.uint8],
) -> None:
    """Write the `COLUMN_FLAGS` of some cells of a level, which the search for rooms reads.

    Args:
        hits: hits of structure on the vertical lines of these cells only, in the cells' order.
        level: the floor of each cell, and the height of the ground.
        cells: the range of cell ids.
        agent: the agent; its height, highest step and largest slope are read.
        flags: receives the bits `COLUMN_FLAGS` (empty, a hole, steep, under the sky, something
            tall) of these cells, indexed by cell id on the whole lattice, uint8.
    """
    floor = level.floor.ravel()[cells]
    run_in_chunks(
        kernels.flag_columns,
        len(floor),
        hits,
        floor,
        level.ground,
        make_agent_limits(agent),
        WALL_HEIGHTS.low,
        flags[cells],
        min_chunk_size=LEAST_CELLS,
    )
