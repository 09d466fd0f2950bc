"""Floors that are lost inside of closed meshes: storeys that someone drew as closed boxes."""

from __future__ import annotations

import numpy as np

from navbake.baker.columns import Columns
from navbake.baker.floors.kernels.enclosed import count_ends, find_holders
from navbake.baker.floors.kernels.sheets import group_members, join_by_steps
from navbake.baker.floors.patch import Patch
from navbake.baker.floors.sheets import AreaTest, Footing, agent_limits, middle_of
from navbake.baker.gathered import Gathered
from navbake.baker.kernels.constants import CLOSED_SURFACE
from navbake.baker.scene.shapes import Shapes
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_bands

# A floor that goes on beyond this share of its outline is what a closed thing stands on
GOES_ON = 0.25
# Unless the thing is so large that it may well be a building [m2]
BUILDING = 50.0


class EnclosedFinder:
    """Finds floors that closed meshes hold, so that nobody can stand on them; block by block.

    They face up within the slope, have headroom, and are large enough to be floors. Where such
    a floor goes on outside at its height, a closed thing only stands on it, like a crate, unless
    it is as large as a building.

    Args:
        lattice: the cells.
        shapes: the geometry that the columns were cast at.
        agent: who would stand there.
    """

    def __init__(self, lattice: Lattice, shapes: Shapes, agent: AgentSettings) -> None:
        self._lattice, self._planes, self._limits = lattice, shapes.planes, agent_limits(agent)
        ids, heights = np.empty(0, dtype=np.int32), np.empty(0)
        self.holds_floor = False  # anything as large as one
        self._held = Gathered(ids, heights, ids)  # cell, height and holder of each surface

    def add(self, columns: Columns) -> None:
        """Look at the columns of a block; blocks come in the order of their rows."""
        if not (columns.crossings.closed == CLOSED_SURFACE).any():
            return
        holder = np.empty(len(columns.z), dtype=np.int32)
        first, end = columns.known_rows.cells(self._lattice)
        asked = self._lattice, columns.crossings, self._planes, self._limits, holder
        run_in_bands(find_holders, end - first, *asked, begin=first)
        surface = np.flatnonzero(holder >= 0)
        column = columns.start[first : end + 1]
        cell = first + np.searchsorted(column, surface, side="right") - 1
        self._held.add(cell, columns.z[surface], holder[surface])

    def found(self, footing: Footing, settings: FloorSettings) -> list[Patch]:
        """The floors, the largest first; the geom of each is the mesh that holds it."""
        lattice, step = self._lattice, self._limits.step
        cell, z, geom = self._held.take()
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
            self.holds_floor = True
            area = len(members) * lattice.cell_size**2
            surfaces = cell[members], z[members]
            edges, goes_on = count_ends(lattice, *surfaces, footing, step, at_cell)
            if area >= BUILDING or goes_on < GOES_ON * edges:
                place = middle_of(lattice, cell[members], z[members])
                found.append(Patch(int(geom[members[0]]), area, place, cell[members]))
        return sorted(found, key=lambda floor: -floor.area)
