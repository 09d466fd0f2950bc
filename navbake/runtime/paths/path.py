"""A path that was found: where it runs, what it costs, what it goes through."""

from dataclasses import dataclass, field

import numpy as np

from navbake.types import Float, Int


@dataclass(frozen=True, eq=False)
class Path:
    """A path on the floor.

    Attributes:
        positions: world x, y, z [m], shape (n, 3), float64, n >= 1; z is the floor's height.
            Between two of them the path is straight.
        levels: level of each position, shape (n,), int64.
        cells: level, row and column of each cell of the route, shape (m, 3), int64. A smooth
            path leaves the route's cells where that is shorter and costs no more.
        length: of the path, seen from above [m].
        cost: of the route over cells: the length of each step [m] times the weight of the cell
            that it leads to.
        rooms: ids of the rooms on the way, in order; a room that is entered again is there again.
        doors: ids of the doors on the way, in order.
    """

    positions: Float = field(repr=False)
    levels: Int = field(repr=False)
    cells: Int = field(repr=False)
    length: float
    cost: float
    rooms: list[str]
    doors: list[str]

    def at(self, distance: float) -> Float:
        """The position at a distance along the path, seen from above.

        Args:
            distance: from the start [m], limited to 0 and the length of the path.

        Returns:
            World x, y, z [m], shape (3,), float64.
        """
        run = np.concatenate([[0.0], np.cumsum(_lengths(self.positions))])
        return np.array([np.interp(distance, run, axis) for axis in self.positions.T])


def path_length(positions: Float) -> float:
    """The length of a line through positions, seen from above [m]."""
    return float(_lengths(positions).sum())


def _lengths(positions: Float) -> Float:
    return np.asarray(np.hypot(*np.diff(positions[:, :2], axis=0).T))
