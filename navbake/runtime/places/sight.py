"""What stands between two positions."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.runtime.flat_grid import FlatGrid
from navbake.types import Bool, Int32


class Sight(NamedTuple):
    """What lines of sight depend on, by flat id."""

    clear: Bool  # where nothing stands
    room: Int32  # number of the room, 0 for none


NO_ROOMS = np.empty(0, dtype=np.int32)


def line_of_sight(
    flat: FlatGrid, clear: Bool, a: ArrayLike, b: ArrayLike, level: int | None = None
) -> bool:
    """`PathFinder.line_of_sight`, through the cells of a mask, by flat id."""
    from navbake.runtime.kernels.crossing import is_in_sight  # saves numba at start-up

    (p, one), (q, other) = (flat.locate(end, level) for end in (a, b))
    if one is None or other is None:
        return False
    space = flat.sight_through(clear)
    return bool(is_in_sight(space, NO_ROOMS, one, p[0], p[1], other, q[0], q[1]))
