"""The colours of a level's rooms."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.navgrid.colors import (
    DOOR,
    DOORWAY,
    FREE,
    NO_FLOOR,
    OCCUPIED,
    color_rooms,
    darkened,
    rgb_of,
)
from navbake.navgrid.door_lines import doorway_cells
from navbake.navgrid.grid import NavGrid
from navbake.types import Bool


class RoomCells(NamedTuple):
    """What the colour of a cell in a picture of rooms follows from; arrays (height, width)."""

    colors: NDArray[np.uint8]  # shape (2 n + 3, 3): see `paint`
    room_index: NDArray[np.uint16]
    free: Bool
    floor: NDArray[np.float32]  # NaN for none
    doorway: Bool  # where a closed door would stand
    door: Bool  # where one stands now

    @classmethod
    def of(cls, grid: NavGrid, number: int) -> RoomCells:
        """The cells of one level."""
        level = grid.levels[number]
        rooms = color_rooms(grid, number)
        colors = np.stack([darkened(rooms), rooms], axis=1).reshape(-1, 3)
        colors[:2] = rgb_of(OCCUPIED), rgb_of(FREE)
        more = [rgb_of(color) for color in (NO_FLOOR, DOORWAY, DOOR)]
        return cls(
            np.concatenate([colors, more]).astype(np.uint8),
            level.room_index,
            level.free,
            level.floor_height,
            doorway_cells(grid, number, blocked=False),
            doorway_cells(grid, number, blocked=True),
        )

    def paint(self, rows: slice = slice(None)) -> NDArray[np.uint8]:
        """Colours of some rows, shape (number of rows, width, 3).

        A room has two colours, for occupied and for free cells; the last three are no floor, a
        doorway, and a door in the way.
        """
        code = self.room_index[rows] * np.intp(2) + self.free[rows]
        code[np.isnan(self.floor[rows])] = len(self.colors) - 3
        code[self.doorway[rows]] = len(self.colors) - 2
        code[self.door[rows]] = len(self.colors) - 1
        painted: NDArray[np.uint8] = self.colors.take(code, axis=0)
        return painted
