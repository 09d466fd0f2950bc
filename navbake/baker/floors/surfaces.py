"""The surfaces that floors are made of, kept cell by cell."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns import Columns
from navbake.baker.floors.kernels import surfaces as kernels
from navbake.baker.floors.kernels.surfaces import Surfaces
from navbake.baker.gathered import Gathered
from navbake.baker.kernels.arrays import AgentLimits, Crossings
from navbake.baker.kernels.constants import CLOSED_SURFACE, SLACK
from navbake.baker.scene.shapes import Planes
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_bands
from navbake.types import Float, Int

LEAST_CELLS = 4096  # so many are worth a call on another thread


def agent_limits(agent: AgentSettings) -> AgentLimits:
    """What an agent can stand and walk on, as kernels take it."""
    min_up = float(np.cos(np.radians(agent.max_slope))) - SLACK
    return AgentLimits(min_up, agent.height, agent.traversable_floor_height)


def slopes_may_join(lattice: Lattice, agent: AgentSettings) -> bool:
    """Whether a slope that is standable may rise more than a step over a cell."""
    rise = lattice.cell_size * np.tan(np.radians(agent.max_slope))
    return bool(rise > agent.traversable_floor_height)


class SurfaceStore:
    """The floor-like surfaces of all cells, found in columns; those of some can be replaced.

    Args:
        lattice: the cells.
        agent: who stands there.

    Attributes:
        surfaces: as kernels take them; its arrays are written to.
        held: surfaces that closed meshes hold, so that nobody can stand there: the cell, height and
            mesh of each, in the order of cells.
        num_surfaces, num_floor_like: how many crossings were looked at in a bake, and how many of
            them a floor may go on at.
    """

    surfaces: Surfaces

    def __init__(self, lattice: Lattice, agent: AgentSettings) -> None:
        self.lattice, self._limits = lattice, agent_limits(agent)
        self._has_slopes = slopes_may_join(lattice, agent)
        self.num_surfaces = self.num_floor_like = 0
        self.held = np.empty(0, dtype=np.int64), np.empty(0), np.empty(0, dtype=np.int32)
        heights, ids = np.empty(0), np.empty(0, np.int32)
        normals = np.empty((0, 3), np.float32)
        self._gathered = Gathered(heights, ids, np.empty(0, np.uint8))
        self._normals = Gathered(normals)
        self._length = np.zeros(lattice.width * lattice.height, dtype=np.int32)

    def add(self, columns: Columns, planes: Planes) -> None:
        """Take the columns of a block; blocks come in the order of their rows."""
        first, end = columns.known_rows.cells(self.lattice)
        crossings = columns.crossings._replace(start=columns.start[first : end + 1])
        found = self._list(np.arange(first, end), crossings, planes)
        start, *arrays, normal = found
        self._length[first:end] = np.diff(start)
        self.num_surfaces += len(columns.z)
        self.num_floor_like += int(start[-1])
        share = end / len(self._length)
        self._gathered.add(*arrays, share=share)
        if self._has_slopes:
            self._normals.add(normal, share=share)

    def finish(self) -> None:
        """Make the surfaces of what was added."""
        (normal,), arrays = self._normals.take(), self._gathered.take()
        length = self._length
        first = np.cumsum(length, dtype=np.int64) - length
        self._used = len(arrays[0])
        self.surfaces = Surfaces._make([first, length, length.copy(), *arrays, normal])
        del self._gathered, self._normals, self._length

    def replace(self, cells: Int, crossings: Crossings, planes: Planes) -> Int:
        """Replace the surfaces of some cells by those of new columns; returns which changed.

        Args:
            cells: ascending.
            crossings: numbered as `cells` are.
        """
        kept = ~np.isin(self.held[0], cells)
        self.held = self.held[0][kept], self.held[1][kept], self.held[2][kept]
        found = self._list(cells, crossings, planes)
        changed = np.zeros(len(cells), dtype=np.bool_)
        asked = cells, *found
        used = kernels.put_surfaces(self.surfaces, *asked, self._used, changed)
        if used > len(self.surfaces.z):
            *places, z, geom, marks, normal = self.surfaces
            room = used + used // 4
            wide = [_widen(array, room) for array in (z, geom, marks)]
            normal = _widen(normal, room) if self._has_slopes else normal
            self.surfaces = Surfaces._make([*places, *wide, normal])
            used = kernels.put_surfaces(self.surfaces, *asked, self._used, changed)
        self._used = used
        return cells[changed]

    def at(self, cell: int) -> Int:
        """The places of the surfaces of a cell."""
        return np.arange(self.surfaces.length[cell]) + int(self.surfaces.first[cell])

    def _list(self, cells: Int, crossings: Crossings, planes: Planes) -> list[NDArray[Any]]:
        """The floor-like surfaces of some cells: where those of each begin, and their arrays."""
        num, few = len(cells), {"least": LEAST_CELLS}
        marks, count = np.empty(len(crossings.z), dtype=np.uint8), np.zeros(num + 1, dtype=np.int64)
        asked = self.lattice, cells, crossings, planes, self._limits, marks, count[1:]
        run_in_bands(kernels.mark_surfaces, num, *asked, **few)
        start = np.cumsum(count)
        total = int(start[-1])
        normal = np.empty((total if self._has_slopes else 0, 3), dtype=np.float32)
        ids, kept = np.empty(total, np.int32), np.empty(total, np.uint8)
        found: list[NDArray[Any]] = [start, np.empty(total), ids, kept, normal]
        run_in_bands(kernels.list_surfaces, num, crossings, marks, *found, **few)
        if (crossings.closed == CLOSED_SURFACE).any():
            holder = np.empty(len(crossings.z), dtype=np.int32)
            known = self.lattice, cells, crossings, planes, self._limits, holder
            run_in_bands(kernels.find_holders, num, *known)
            surface = np.flatnonzero(holder >= 0)
            cell = cells[np.searchsorted(crossings.start, surface, side="right") - 1]
            cell = np.append(self.held[0], cell)
            order = np.argsort(cell, kind="stable")
            z = np.append(self.held[1], crossings.z[surface])[order]
            self.held = cell[order], z, np.append(self.held[2], holder[surface])[order]
        return found


def _widen(array: NDArray[Any], room: int) -> NDArray[Any]:
    wide = np.empty((room, *array.shape[1:]), dtype=array.dtype)
    wide[: len(array)] = array
    return wide


def find_near(first: Int, end: Int, heights: Float, z: Float, step: float) -> Float:
    """The highest of the heights of each range within a step of a height, NaN for none [m]."""
    found = np.full(len(z), np.nan)
    for k in range(int((end - first).max(initial=0))):
        height = heights[np.minimum(first + k, end - 1)]
        near = (first + k < end) & (abs(height - z) <= step + SLACK)
        found[near] = height[near]
    return found
