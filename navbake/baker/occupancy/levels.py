"""The occupancy of all storeys."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navbake.baker.columns import Columns, TiledShapes
from navbake.baker.floors.levels import Floors
from navbake.baker.occupancy.occupancy import Footprint, check_occupancy
from navbake.types import Bool


@dataclass(frozen=True)
class Occupancy:
    """Which cells are occupied, and how that was decided.

    Attributes:
        levels: of each storey, shape (height, width) of the whole lattice, bool: a geom meets
            the volume over the cell's floor, or there is no floor.
        by_ray: how many cells a ray alone proved occupied.
        by_fcl: how many cells had no proof either way, so that FCL decided.
    """

    levels: list[Bool]
    by_ray: int
    by_fcl: int


def find_occupancy(
    floors: Floors, columns: Columns, tiled: TiledShapes, footprint: Footprint
) -> Occupancy:
    """Decide for every cell of every storey whether it is occupied; see `check_occupancy`."""
    levels, by_ray, by_fcl = [], 0, 0
    for level in floors.levels:
        cells = np.flatnonzero(~np.isnan(level.floor))
        answers = check_occupancy(columns, tiled, footprint, cells, level.floor.ravel()[cells])
        occupied = np.ones(level.floor.size, dtype=np.bool_)
        occupied[cells] = answers.occupied
        levels.append(occupied.reshape(level.floor.shape))
        by_ray += answers.by_ray
        by_fcl += answers.by_fcl
    return Occupancy(levels, by_ray, by_fcl)
