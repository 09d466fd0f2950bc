"""Floors that are lost inside of closed meshes: storeys that someone drew as closed boxes."""

from __future__ import annotations

import numpy as np

from navbake.baker.columns import Columns
from navbake.baker.floors.kernels.enclosed import (
    count_ends,
    find_holders,
    group_members,
    join_by_steps,
)
from navbake.baker.floors.kernels.surfaces import Surfaces
from navbake.baker.floors.patch import Patch
from navbake.baker.floors.sheets import AreaTest, middle_of
from navbake.baker.floors.surfaces import agent_limits
from navbake.baker.kernels.arrays import Crossings
from navbake.baker.kernels.constants import CLOSED_SURFACE
from navbake.baker.scene.shapes import Planes
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_bands
from navbake.types import Float, Int, Int32

# A floor that goes on beyond this share of its outline is what a closed thing stands on
GOES_ON = 0.25
# Unless the thing is so large that it may well be a building [m2]
BUILDING = 50.0


class EnclosedFinder:
    """Finds floors that closed meshes hold, so that nobody can stand on them.

    They face up within the slope, have headroom, and are large enough to be floors. Where such
    a floor goes on outside at its height, a closed thing only stands on it, like a crate, unless
    it is as large as a building.

    Args:
        lattice: the cells.
        agent: who would stand there.
    """

    def __init__(self, lattice: Lattice, agent: AgentSettings) -> None:
        self._lattice, self._limits = lattice, agent_limits(agent)
        # cell, height and holder of each surface, in the order of cells
        self._held = np.empty(0, dtype=np.int64), np.empty(0), np.empty(0, dtype=np.int32)

    def add(self, columns: Columns, planes: Planes) -> None:
        """Look at the columns of a block of rows."""
        first, end = columns.known_rows.cells(self._lattice)
        crossings = columns.crossings._replace(start=columns.start[first : end + 1])
        self._join(self._find(np.arange(first, end), crossings, planes))

    def replace(self, cells: Int, crossings: Crossings, planes: Planes) -> None:
        """Look at the columns of some cells again; crossings are numbered as these are."""
        kept = ~np.isin(self._held[0], cells)
        self._held = tuple(array[kept] for array in self._held)  # type: ignore[assignment]
        self._join(self._find(cells, crossings, planes))

    def _find(self, cells: Int, crossings: Crossings, planes: Planes) -> tuple[Int, Float, Int32]:
        if not (crossings.closed == CLOSED_SURFACE).any():
            return self._held[0][:0], self._held[1][:0], self._held[2][:0]
        holder = np.empty(len(crossings.z), dtype=np.int32)
        asked = self._lattice, cells, crossings, planes, self._limits, holder
        run_in_bands(find_holders, len(cells), *asked)
        surface = np.flatnonzero(holder >= 0)
        cell = cells[np.searchsorted(crossings.start, surface, side="right") - 1]
        return cell, crossings.z[surface], holder[surface]

    def _join(self, more: tuple[Int, Float, Int32]) -> None:
        if len(more[0]):
            cell = np.concatenate([self._held[0], more[0]])
            z = np.concatenate([self._held[1], more[1]])
            holder = np.concatenate([self._held[2], more[2]])
            order = np.argsort(cell, kind="stable")
            self._held = cell[order], z[order], holder[order]

    def found(self, surfaces: Surfaces, settings: FloorSettings) -> list[Patch]:
        """The floors, the largest first; the geom of each is the mesh that holds it."""
        lattice, step = self._lattice, self._limits.step
        cell, z, geom = self._held
        if not len(cell):
            return []
        start = np.searchsorted(cell, np.arange(lattice.width * lattice.height + 1))
        part, size = join_by_steps(lattice, start, z, geom, step)
        first, member = group_members(part, size)
        test = AreaTest(lattice, settings)
        at_cell = np.zeros(lattice.width * lattice.height, dtype=np.bool_)
        found = []
        for number in np.flatnonzero(size >= test.needed).tolist():
            members = member[first[number] : first[number + 1]]
            if not test.passes(cell[members]):
                continue
            area = len(members) * lattice.cell_size**2
            held = cell[members], z[members]
            edges, goes_on = count_ends(lattice, *held, surfaces, step, at_cell)
            if area >= BUILDING or goes_on < GOES_ON * edges:
                place = middle_of(lattice, cell[members], z[members])
                found.append(Patch(int(geom[members[0]]), area, place, cell[members]))
        return sorted(found, key=lambda floor: -floor.area)
