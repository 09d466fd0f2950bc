"""How far away the nearest obstacle is, and where."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.runtime.flat_grid import FlatGrid
from navbake.runtime.places.checks import check_distance
from navbake.types import Bool, Float


@dataclass(frozen=True, eq=False)
class Obstacle:
    """The nearest point of an obstacle.

    Attributes:
        distance: to it, on the map [m].
        position: world x, y, z [m] of the point, shape (3,), float64; z is the floor's at the
            position that was asked about.
    """

    distance: float
    position: Float


def nearest_obstacle(
    flat: FlatGrid,
    occupied: Bool,
    position: ArrayLike,
    agent_height: float,
    *,
    level: int | None = None,
    max_distance: float = math.inf,
) -> Obstacle | None:
    """`PathFinder.nearest_obstacle`, of the occupied cells of a mask, by flat id."""
    # saves numba at start-up
    from navbake.runtime.kernels.nearest import TO_OBSTACLE, Wanted, nearest_cell

    check_distance(max_distance)
    p, home = flat.locate(position, level)
    if home is None:
        raise QueryError(f"{', '.join(f'{v:g}' for v in p)} lies beside the grid: no obstacles")
    z = flat.positions(home)[2]
    overlap = overlap_height(flat, agent_height)
    number = int(flat.level_of(home))
    wanted = Wanted(flat.layout, occupied, flat.floors.z, TO_OBSTACLE, overlap)
    cell, distance = nearest_cell(wanted, number, np.array([p[0], p[1], z]), float(max_distance))
    if cell < 0:
        return None
    half = flat.layout.cell_size[number] / 2
    center = flat.positions(cell)[:2]
    return Obstacle(distance, np.append(np.clip(p[:2], center - half, center + half), z))


def overlap_height(flat: FlatGrid, agent_height: float) -> float:
    """Floors less than this apart are at one height for an agent [m]; as `grid.inflate` has it."""
    return agent_height - flat.floors.max_step
