"""The surfaces that floors are made of, kept cell by cell."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.blocks import Blocks, fit, join_parts, list_rows
from navbake.baker.columns import Columns
from navbake.baker.floors.kernels import surfaces as kernels
from navbake.baker.floors.kernels.surfaces import Surfaces
from navbake.baker.kernels.arrays import AgentLimits
from navbake.baker.kernels.constants import SLACK
from navbake.baker.kernels.tiles import SIZE
from navbake.baker.scene.shapes import Planes
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import LEAST_CELLS
from navbake.types import Float, Int, Int32


def agent_limits(agent: AgentSettings) -> AgentLimits:
    min_up = float(np.cos(np.radians(agent.max_slope))) - SLACK
    return AgentLimits(min_up, agent.height, agent.traversable_floor_height)


def slopes_may_join(lattice: Lattice, agent: AgentSettings) -> bool:
    """Whether a slope that is standable may rise more than a step over a cell."""
    rise = lattice.cell_size * np.tan(np.radians(agent.max_slope))
    return bool(rise > agent.traversable_floor_height)


class SurfaceStore:
    """The floor-like surfaces of all cells, found in columns; those of some can be replaced.

    Attributes:
        surfaces: as kernels take them; its arrays are written to.
        num_surfaces, num_floor_like: how many crossings a bake had, and how many are floor-like.
    """

    surfaces: Surfaces

    def __init__(self, lattice: Lattice, agent: AgentSettings) -> None:
        self.lattice, self.blocks, self._limits = lattice, Blocks(lattice), agent_limits(agent)
        axes = 3 if slopes_may_join(lattice, agent) else 0
        # empty columns of `list_surfaces`
        empty = np.empty(0), np.empty(0, np.int32), np.empty(0, np.uint8)
        self._empty = *empty, np.empty((0, axes), np.float32)
        self.num_surfaces = self.num_floor_like = 0
        self._parts: list[list[NDArray[Any]]] = []
        self._first, self._length = np.zeros((2, lattice.width * lattice.height), dtype=np.int32)
        self._used = 0

    def add(self, columns: Columns, planes: Planes) -> None:
        """Add some rows of columns.

        The surfaces of a block lie together, which makes its kernels a third faster.
        """
        rows, row = columns.known_rows, np.arange(self.blocks.num) // self.blocks.cols * SIZE
        cells = self.blocks.cells((row < rows.end) & (row + SIZE > rows.first))
        first, end = rows.cells(self.lattice)
        cells = cells[(first <= cells) & (cells < end)]
        start, *arrays = self._list(cells, columns, planes)
        self._first[cells], self._length[cells] = self._used + start[:-1], np.diff(start)
        self._used += int(start[-1])
        self.num_surfaces += len(columns.z)
        self.num_floor_like += int(start[-1])
        self._parts.append(arrays)

    def finish(self) -> None:
        """Make `surfaces` of what was added."""
        arrays = join_parts(self._parts)
        self.surfaces = Surfaces._make([self._first, self._length, self._length, *arrays])
        del self._parts

    def replace(self, cells: Int, columns: Columns, planes: Planes) -> tuple[Int, Int]:
        """Replace the surfaces of some cells, ascending.

        Returns those that changed, and those with surfaces that something holds; they may repeat.

        A cell's surfaces that exceed the room of its run go behind all others.
        """
        start, *found = self._list(cells, columns, planes)
        if self.surfaces.room is self.surfaces.length:
            self.surfaces = self.surfaces._replace(room=self.surfaces.length.copy())
        first, length, room = self.surfaces[:3]
        arrays: list[NDArray[Any]] = list(self.surfaces[3:])
        count = np.diff(start)
        own = np.repeat(np.arange(len(cells)), count)
        rank = np.arange(len(own)) - start[own]  # of each surface in its column
        changed = count != length[cells]
        same = ~changed[own]
        pairs = [
            (array[(first[cells][own] + rank)[same]], new[same])
            for array, new in zip(arrays, found, strict=True)
        ]
        pairs[0] = pairs[0][0].view(np.int64), pairs[0][1].view(np.int64)  # -0.0 is not 0.0
        for one, other in pairs:
            differs = (one != other).any(axis=tuple(range(1, one.ndim)))
            changed[own[same][differs]] = True
        moved = count > room[cells]
        room[cells[moved]] = count[moved]
        first[cells[moved]] = self._used + np.cumsum(count[moved]) - count[moved]
        self._used += int(count[moved].sum())
        length[cells] = count
        if self._used > len(arrays[0]):
            size = self._used + self._used // 4
            arrays = [fit(array, size) for array in arrays]
            self.surfaces = Surfaces._make([first, length, room, *arrays])
        for array, new in zip(arrays, found, strict=True):
            array[first[cells][own] + rank] = new
        return cells[changed], cells[own[found[2] & kernels.HELD != 0]]

    def at(self, cell: int) -> Int:
        """The places of the surfaces of a cell."""
        return np.arange(self.surfaces.length[cell]) + int(self.surfaces.first[cell])

    def _list(self, cells: Int, columns: Columns, planes: Planes) -> list[NDArray[Any]]:
        """The floor-like surfaces of some cells: where those of each begin, and their arrays."""
        known = self.lattice, columns.crossings, planes, self._limits
        count, found = list_rows(
            kernels.list_surfaces, cells, self._empty, *known, least=LEAST_CELLS
        )
        return [np.append(0, np.cumsum(count)), *found]


def find_near(first: Int | Int32, end: Int | Int32, heights: Float, z: Float, step: float) -> Float:
    """The highest of the heights of each range within a step of a height, NaN for none [m]."""
    found = np.full(len(z), np.nan)
    for k in range(int((end - first).max(initial=0))):
        height = heights[np.minimum(first + k, end - 1)]
        near = (first + k < end) & (abs(height - z) <= step + SLACK)
        found[near] = height[near]
    return found
