"""Roofs: sheets that are open to the sky over an enclosed level, and so no levels themselves."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from navbake.baker.columns import Columns
from navbake.baker.floors.outline import OccupancyTest
from navbake.baker.floors.sheets import Standable, mask_window
from navbake.baker.kernels.constants import SLACK, TOUCH
from navbake.baker.kernels.occupancy import lines_blocked
from navbake.config.settings import AgentSettings
from navbake.types import Bool, Float, Int

# Openings up to twice this wide do not make an enclosed level a part of outside [m]
DOOR_HALF_WIDTH = 0.6
# The share of a sheet that has to lie open to the sky, or over a floor, for a roof
MOSTLY, HALF = 0.9, 0.5


def drop_roofs(
    standable: Standable, columns: Columns, agent: AgentSettings, is_occupied: OccupancyTest
) -> Standable:
    """Drop the sheets that are roofs: open to the sky, over an enclosed level.

    No step reaches a roof: a sheet that steps reach includes the floors below, which are not
    open to the sky. A level is enclosed when most of the free floor under the sheet can't be
    reached from outside of it except through openings no wider than a door.
    """
    cells = standable.cell
    last_of_column = columns.start[cells + 1] - 1
    to_sky = columns.z[last_of_column] - standable.z <= SLACK
    below = np.arange(len(cells)) - 1
    over_floor = (below >= 0) & (cells[np.maximum(below, 0)] == cells)
    sheet, size = standable.sheet, np.maximum(standable.sheet_size, 1)
    sky_share = np.bincount(sheet, to_sky, len(size)) / size
    over_share = np.bincount(sheet, over_floor, len(size)) / size
    keep = np.ones(len(size), dtype=np.bool_)
    under = _EnclosedTest(standable, columns, agent, is_occupied)
    candidates = np.flatnonzero((sky_share >= MOSTLY) & (over_share >= HALF))
    for roof, members in standable.members(candidates):
        keep[roof] = not under.is_enclosed(cells[members], below[members[over_floor[members]]])
    return standable.only_sheets(keep)


def is_walled(cells: Int, z: Float, columns: Columns, height: float) -> bool:
    """Whether something higher than an agent [m] stands along most of the edge of a sheet."""
    lattice = columns.lattice
    floor, top = np.full(lattice.shape, np.nan), np.full(lattice.shape, -np.inf)
    floor.ravel()[cells] = z
    filled = np.flatnonzero(np.diff(columns.start))
    top.ravel()[filled] = columns.z[columns.start[filled + 1] - 1]
    edges = walled = 0
    for one, other in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        for a, b in ((one, other), (other, one)):
            is_edge = ~np.isnan(floor[a]) & np.isnan(floor[b])
            edges += int(np.count_nonzero(is_edge))
            walled += int(np.count_nonzero(top[b][is_edge] >= floor[a][is_edge] + height))
    return walled > HALF * edges


@dataclass(frozen=True)
class _EnclosedTest:
    """Whether a floor under a sheet is shut off from outside of the sheet's outline."""

    standable: Standable
    columns: Columns
    agent: AgentSettings
    is_occupied: OccupancyTest

    def is_enclosed(self, roof_cells: Int, under: Int) -> bool:
        """Decide from a roof's cells, and from the standable surfaces right under it."""
        lattice = self.standable.lattice
        margin = int(np.ceil(DOOR_HALF_WIDTH / lattice.cell_size)) + 2
        roof, row0, col0 = mask_window(roof_cells, lattice, margin)
        floor = np.full(roof.shape, np.nan)
        row, col = np.divmod(self.standable.cell[under], lattice.width)
        floor[row - row0, col - col0] = self.standable.z[under]
        has_floor = ~np.isnan(floor)
        nearest = ndimage.distance_transform_edt(
            ~has_floor, return_distances=False, return_indices=True
        )
        floor = floor[tuple(nearest)]
        blocked = self._blocked(floor, has_floor, row0, col0)
        free = roof & has_floor & ~blocked
        if not free.any():
            return False  # a solid's top is no roof over a room
        distance = ndimage.distance_transform_edt(~blocked) * lattice.cell_size
        wide = ~blocked & (distance > DOOR_HALF_WIDTH) & (has_floor | ~roof)
        # an object on a roof interrupts its sheet, but the hole is not outside of the roof
        outline = ndimage.binary_fill_holes(roof)
        inner = wide & outline
        if not inner.any():
            return True  # nothing but narrow places
        part, _ = ndimage.label(wide)
        outside = np.unique(part[wide & ~outline])
        reached = np.isin(part, outside[outside > 0]) & inner
        return bool(reached.sum() < HALF * inner.sum())

    def _blocked(self, floor: Float, has_floor: Bool, row0: Int, col0: Int) -> Bool:
        """Cells of a window that something blocks at the height of the floor there or nearby."""
        lattice = self.standable.lattice
        row, col = np.indices(floor.shape) + np.reshape([row0, col0], (2, 1, 1))
        inside = (row >= 0) & (row < lattice.height) & (col >= 0) & (col < lattice.width)
        cells = row * lattice.width + col
        blocked = np.zeros(floor.shape, dtype=np.bool_)
        exact = inside & has_floor
        blocked[exact] = self.is_occupied(cells[exact], floor[exact])
        # where the roof has no floor below, only lines are cast: the height is a neighbour's
        rough = inside & ~has_floor
        answers = np.zeros(int(rough.sum()), dtype=np.bool_)
        low = floor[rough] + self.agent.traversable_floor_height + TOUCH
        high = floor[rough] + self.agent.height - TOUCH
        lines_blocked(cells[rough], low, high, self.columns.crossings, answers)
        blocked[rough] = answers
        return blocked
