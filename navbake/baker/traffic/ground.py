"""What links are found on: the floors of all levels, where they are free, and the room above."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from navbake.baker.columns import ColumnSource, TiledShapes, cast_columns, tile_shapes
from navbake.baker.connect import connect, touching
from navbake.baker.kernels.constants import SLACK
from navbake.baker.occupancy.occupancy import Footprint, look_at_cells
from navbake.baker.scene.scene import Scene
from navbake.baker.scene.shapes import Shapes
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.links import Stop
from navbake.types import Bool, Float, Int, Json

WAYS = ((0, 1), (1, 0), (0, -1), (-1, 0))
"""The directions in which links cross gaps, as steps of row and column."""


ROOM = 0.5  # between a stop and the edge, for agents larger than the bake's [m]


class MadeLink(NamedTuple):
    """A link: its stops, with cells on the whole lattice, and further fields of a `Link`."""

    stops: list[Stop]
    fields: Json


class Space(NamedTuple):
    """Geometry that an agent may collide with, and the lattice of its cells."""

    columns: ColumnSource
    tiled: TiledShapes
    footprint: Footprint

    @classmethod
    def of(cls, shapes: Shapes, lattice: Lattice, footprint: Footprint) -> Space:
        """The space of some geometry on a lattice, most often a part of the whole one."""
        tiled = tile_shapes(shapes, lattice, footprint.reach)
        return cls(cast_columns(tiled), tiled, footprint)

    def is_free(self, cells: Int, heights: Float) -> Bool:
        """Whether an agent that stands at a height over a cell meets nothing, for (n,) of both."""
        pairs = np.unique(
            np.stack([cells.astype(np.float64), heights]), axis=1, return_inverse=True
        )
        (asked, floors), back = pairs[0], pairs[1].reshape(-1)
        asked = asked.astype(np.int64)
        columns = self.columns.at(asked)
        occupied = look_at_cells(columns, self.tiled, self.footprint, asked, floors).occupied
        return np.asarray(~occupied[back])


class Ground(NamedTuple):
    """The levels of a bake as finders of links read them.

    Attributes:
        scene: without its doors.
        floors, free: of all levels, shape (levels, height, width) of the whole lattice; cells that
            a door blocks in any of its states are not free.
        space: the geometry of the scene.
    """

    scene: Scene
    lattice: Lattice
    floors: Float
    free: Bool
    space: Space
    agent: AgentSettings

    @property
    def step(self) -> float:
        """The highest step, with room for rounding [m]."""
        return self.agent.traversable_floor_height + SLACK

    def stop(self, level: int, cell: int) -> Stop:
        """A stop in the middle of a cell."""
        row, col = divmod(cell, self.lattice.width)
        x, y = self.lattice.positions(row, col).tolist()
        z = float(np.float32(self.floors[level, row, col]))
        return Stop(level, cell, (round(x, 6) + 0.0, round(y, 6) + 0.0, round(z, 6) + 0.0))

    def stand_back(self, level: int, cell: int, way: int, width: float) -> int:
        """The cell from which any agent that fits through a width is off the edge, at most `ROOM`.

        It lies straight beyond a cell in a direction, over free cells without a step between;
        where these end earlier, the last of them.
        """
        (down, right), (rows, cols) = WAYS[way], self.lattice.shape
        row, col = divmod(cell, cols)
        size = self.lattice.cell_size
        for _ in range(math.ceil(min(width / 2, ROOM) / size - 0.5 - SLACK)):
            r, c = row + down, col + right
            if not (0 <= r < rows and 0 <= c < cols and self.free[level, r, c]):
                break
            if abs(self.floors[level, r, c] - self.floors[level, row, col]) > self.step:
                break
            row, col = r, c
        return row * cols + col

    def cells_in(self, length: float) -> int:
        """How many cells lie between the ends of a gap of a length [m]."""
        return math.floor(length / self.lattice.cell_size + SLACK)

    def width_of(self, cells: Int) -> float:
        """How wide the way is that leads through cells side by side, for discs [m]."""
        row, col = np.divmod(cells, self.lattice.width)
        length = math.hypot(np.ptp(row), np.ptp(col)) * self.lattice.cell_size
        return length + max(2 * self.agent.radius, self.lattice.cell_size)


class Leaps(NamedTuple):
    """Ways straight from cells to others, shape (n,): each is a candidate for a link.

    Attributes:
        way: index into `WAYS`.
        level, cell, other_level, other_cell: both ends.
        num_between: how many cells lie between them.
        z, other_z: the floors of both [m].
    """

    way: Int
    level: Int
    cell: Int
    other_level: Int
    other_cell: Int
    num_between: Int
    z: Float
    other_z: Float

    def only(self, chosen: Bool) -> Leaps:
        """Those that are marked."""
        return Leaps._make(array[chosen] for array in self)

    @classmethod
    def join(cls, parts: list[Leaps]) -> Leaps:
        """Several as one."""
        ints, floats = np.empty(0, dtype=np.int64), np.empty(0)
        parts = [cls(ints, ints, ints, ints, ints, ints, floats, floats), *parts]
        return cls._make(np.concatenate(arrays) for arrays in zip(*parts, strict=True))

    def cells_passed(self, width: int) -> tuple[Int, Int]:
        """The cells after the first up to the last of each, and whose each is."""
        owner = np.repeat(np.arange(len(self.cell)), self.num_between + 1)
        first = np.repeat(
            np.cumsum(self.num_between + 1) - self.num_between - 1, self.num_between + 1
        )
        step = np.array([down * width + right for down, right in WAYS])[self.way]
        passed = self.cell[owner] + (np.arange(len(owner)) - first + 1) * step[owner]
        return passed, owner


def group_leaps(found: Leaps, ground: Ground) -> list[Int]:
    """Group leaps of one way and pair of levels that start side by side, without a step.

    Returns the indices of each group, ascending by cells; groups by levels and first cells.
    """
    groups = list[Int]()
    keys = np.stack([found.level, found.other_level, found.way])
    for key in np.unique(keys, axis=1).T:
        own = np.flatnonzero((keys == key[:, None]).all(axis=0))
        own = own[np.argsort(found.cell[own], kind="stable")]
        pairs = touching(found.cell[own], ground.lattice.width)
        ends = own[pairs]
        holds = np.abs(np.diff(found.z[ends], axis=0)) <= ground.step
        holds &= np.abs(np.diff(found.other_z[ends], axis=0)) <= ground.step
        part = connect(pairs[:, holds[0]], len(own))
        groups += [own[part == number] for number in range(int(part.max(initial=-1)) + 1)]
    return groups


def middle_of(cells: Int, lattice: Lattice) -> int:
    """The place in `cells` of the one nearest to their mean."""
    at = np.stack(np.divmod(cells, lattice.width)).astype(np.float64)
    return int(np.argmin(np.round(np.square(at - at.mean(axis=1, keepdims=True)).sum(axis=0), 9)))
