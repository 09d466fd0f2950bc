"""How far away the nearest obstacle is, and where."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import QueryError
from navbake.navgrid.cells import check_positions
from navbake.runtime.places.locate import flat_cell, place_of
from navbake.runtime.places.sample import check_distance

if TYPE_CHECKING:
    from navbake.runtime.flat_grid import Walk


@dataclass(frozen=True, eq=False)
class Obstacle:
    """The nearest point of an obstacle.

    Attributes:
        distance: to it, on the map [m].
        position: world x, y, z [m] of the point, shape (3,), float64; z is that of the floor
            below the asker.
    """

    distance: float
    position: NDArray[np.float64]


def nearest_obstacle(
    walk: Walk,
    occupied: NDArray[np.bool_],
    position: ArrayLike,
    agent_height: float,
    *,
    level: int | None = None,
    max_distance: float = math.inf,
) -> Obstacle | None:
    """Find the nearest point of an occupied cell's square on the position's level.

    Beyond the edge of the grid nothing is known, and nothing counts. Where the level ends and
    another goes on, as at the top of stairs, that is no obstacle: the other one counts where its
    floor is less than the agent's height, less a step, above or below, and its own isn't.

    Args:
        walk: the grid.
        occupied: by flat id, shape (n,), bool.
        position: world x, y, z [m]; x, y will do on one level.
        agent_height: [m].
        level: which level; then z does not count.
        max_distance: farther ones don't count [m], >= 0.

    Returns:
        None where there is none so near; distance 0 within an occupied cell.

    Raises:
        QueryError: there is no such level, the position is none or in no cell of the grid, or
            the distance is negative.
    """
    from navbake.runtime.kernels.nearest import TO_OBSTACLE, nearest_cell

    check_distance(max_distance)
    p = check_positions(position, walk.num_levels, level)
    home = flat_cell(walk, p, level)
    if home is None:
        raise QueryError(f"{', '.join(f'{v:g}' for v in p)} lies beside the grid: no obstacles")
    z = walk.positions(np.array(home))[2]
    overlap = agent_height - walk.max_step  # as `grid.inflate` has it
    number = int(walk.level_of(np.array(home)))
    point = np.array([p[0], p[1], z])
    cell, distance = nearest_cell(
        place_of(walk), number, occupied, walk.floor, point, max_distance, TO_OBSTACLE, overlap
    )
    if cell < 0:
        return None
    half = walk.cell_size[number] / 2
    center = walk.positions(np.array(cell))[:2]
    return Obstacle(distance, np.append(np.clip(p[:2], center - half, center + half), z))
