"""Flags cells by the hits of structure on the vertical line through their centres.

A cell can be empty, a hole, steep ground, under the sky, or hold something tall.
"""

from __future__ import annotations

from collections.abc import Sequence

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
    hits: ColumnHits, levels: Sequence[LevelFloor], cells: slice, agent: AgentSettings
) -> NDArray[np.uint8]:
    """Find the `COLUMN_FLAGS` of some cells on all levels, which the search for rooms reads.

    Args:
        hits: hits of structure on the vertical lines of these cells only, in the cells' order.
        levels: for each level, the floor of each cell, and the height of the ground.
        cells: the range of cell ids.
        agent: the agent; its height, highest step and largest slope are read.

    Returns:
        The bits `COLUMN_FLAGS` (empty, a hole, steep, under the sky, something tall) of these cells
        on each level, shape (levels, cells), uint8.
    """
    floors = np.stack([level.floor.reshape(-1)[cells] for level in levels])
    flags = np.empty(floors.shape, dtype=np.uint8)
    run_in_chunks(
        kernels.flag_columns,
        floors.shape[1],
        hits,
        floors,
        np.array([level.ground for level in levels]),
        make_agent_limits(agent),
        WALL_HEIGHTS.low,
        flags,
        min_chunk_size=-(-LEAST_CELLS // len(levels)),
    )
    return flags
