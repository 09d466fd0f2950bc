"""Windows in buildings of one mesh: openings in walls through which nobody can walk."""

import numpy as np

from navbake.baker.rooms.directions import find_directions, turned
from navbake.baker.rooms.kernels.gaps import drop_thick, mark_bridges
from navbake.types import Bool

# A sill is at most this thick [m]; it fills every cell it touches, one more on each side
SILL_THICKNESS = 0.5


def find_windows(low: Bool, wall: Bool, cell_size: float) -> Bool:
    """Mark the cells of sills and parapets that continue a wall.

    Where walls, floors and furniture are one mesh, only heights tell what is wall: that reaches
    above heads. A window's sill doesn't. But along the direction of a wall it goes from one piece
    of wall to the next without a break, to a cell on either side of a line, and it is as thin as
    a wall. A table or a bed ends
    somewhere, and a counter along a wall has no wall at its ends, or fills a niche that is deeper
    than a wall is thick.

    Args:
        low: cells that the building blocks at an agent's height, but not above heads.
        wall: cells that it blocks there, too.
        cell_size: edge of a cell [m].

    Returns:
        Shape and dtype of the masks.
    """
    found = np.zeros(low.shape, dtype=np.bool_)
    if not low.any():
        return found
    for direction in find_directions(~wall, cell_size):
        # drawn sills are as wide as their wall, so that each line of theirs ends at it
        bridge = np.zeros(turned(low, direction).shape, dtype=np.bool_)
        mark_bridges(turned(low, direction), turned(wall, direction), direction.shift, bridge)
        drop_thick(bridge, int(SILL_THICKNESS * direction.stretch / cell_size) + 2)
        found |= bridge.T if direction.swapped else bridge
    return found
