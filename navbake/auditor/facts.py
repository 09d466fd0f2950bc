"""What the checks of an audit look at: layers of all levels in metres, and what is connected."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from navbake.auditor.inflation import Inflation, read_inflation
from navbake.auditor.parts import Steps, find_steps, number_islands
from navbake.errors import FormatError
from navbake.navgrid.doors import Door
from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.grid_base import GridBase
from navbake.navgrid.lattice import FARTHEST
from navbake.navgrid.rooms import Room
from navbake.types import Bool, Float, Int, Int32, Json, Vector3

SLACK = 1e-6  # metres that a step may be over the highest one


class Facts:
    """Layers and parts of a grid, each found when a check first asks for it.

    Attributes:
        grid: the grid, without what is blocked for a while.
        levels: its levels.
    """

    def __init__(self, grid: GridBase) -> None:
        self.grid: GridBase = grid.without_blocks()
        self.levels: list[SceneGrid2D] = self.grid.levels

    @cached_property
    def free(self) -> list[Bool]:
        """The free cells of each level."""
        return [level.free for level in self.levels]

    @cached_property
    def floors(self) -> list[Float]:
        """The floors of each level, NaN for none [m]."""
        return [level.floor for level in self.levels]

    @cached_property
    def step_limit(self) -> float:
        """How far apart floors of one walk may be: a step, and what float32 rounds off [m]."""
        highest = max(float(np.nanmax(np.abs(floor), initial=0)) for floor in self.floors)
        rounding = float(np.spacing(np.float32(min(highest, FARTHEST))))
        return self.grid.max_step + SLACK + rounding

    @cached_property
    def settings(self) -> Json:
        """The settings that the grid states; {} for none."""
        stated = self.grid.navbake.get("settings")
        return stated if isinstance(stated, dict) else {}

    @cached_property
    def inflation(self) -> Inflation:
        """What the grid says of its inflation."""
        return read_inflation(self.grid)

    @cached_property
    def doors(self) -> tuple[Door, ...]:
        """The doors; none where the table is broken, which a check tells."""
        try:
            return self.grid.doors
        except FormatError:
            return ()

    @cached_property
    def rooms(self) -> tuple[Room, ...] | None:
        """The rooms; None where the table is broken, which a check tells."""
        try:
            return self.grid.rooms
        except FormatError:
            return None

    @cached_property
    def links(self) -> Int:
        """The links, shape (n, 4); none where they are broken, which a check tells."""
        try:
            return self.grid.link_array
        except FormatError:
            return np.empty((0, 4), dtype=np.int64)

    @cached_property
    def door_cells(self) -> list[Bool]:
        """The cells of each level that a door blocks in any state."""
        return self._cells_of([(door, state) for door in self.doors for state in door.cells])

    @cached_property
    def standing_doors(self) -> list[Bool]:
        """The cells of each level that a door blocks as it stands."""
        return self._cells_of([(door, door.state) for door in self.doors])

    def _cells_of(self, doors: list[tuple[Door, str]]) -> list[Bool]:
        masks = [np.zeros(level.shape, dtype=np.bool_) for level in self.levels]
        for door, state in doors:
            for mask, cells in zip(masks, door.cells_in(state, len(masks)), strict=True):
                mask.ravel()[cells] = True
        return masks

    @cached_property
    def passable(self) -> list[Bool]:
        """The cells that are free, or would be without doors."""
        return [free | door for free, door in zip(self.free, self.door_cells, strict=True)]

    @cached_property
    def steps(self) -> list[Steps]:
        """Where free cells of each level lie more than a step beside each other."""
        layers = zip(self.free, self.floors, strict=True)
        return [find_steps(mask, floor, self.step_limit) for mask, floor in layers]

    @cached_property
    def islands(self) -> list[Int32]:
        """The connected parts of the free cells, numbered from 1, the largest first; 0 for none."""
        return number_islands(self.free, self.steps, self.links)

    @cached_property
    def open_islands(self) -> list[Int32]:
        """The same, if no door blocked anything."""
        if not self.doors:
            return self.islands
        layers = zip(self.passable, self.floors, strict=True)
        steps = [find_steps(mask, floor, self.step_limit) for mask, floor in layers]
        return number_islands(self.passable, steps, self.links)

    def place(self, number: int, row: int, col: int) -> Vector3:
        """World x, y and z of a cell; its level's ground where its floor is at no height [m]."""
        level = self.levels[number]
        x, y = level.lattice.positions(row, col).tolist()
        z = float(self.floors[number][row, col])
        return x, y, z if np.isfinite(z) else level.ground

    def first(self, number: int, mask: Bool) -> Vector3:
        """The place of the first marked cell of a level."""
        row, col = np.unravel_index(int(np.argmax(mask)), mask.shape)
        return self.place(number, int(row), int(col))
