"""Floors that are lost inside of closed meshes: storeys that someone drew as closed boxes."""

from __future__ import annotations

import numpy as np

from navbake.baker.connect import connect, ranges
from navbake.baker.floors.patch import Patch, middle_of
from navbake.baker.floors.sheets import area_test, is_large
from navbake.baker.floors.surfaces import SurfaceStore, find_near
from navbake.baker.kernels.constants import SLACK
from navbake.config.settings import FloorSettings
from navbake.navgrid.lattice import Lattice
from navbake.types import Float, Int

# A floor that goes on beyond this share of its outline is what a closed thing stands on
GOES_ON = 0.25
# Unless the thing is so large that it may well be a building [m2]
BUILDING = 50.0


def find_enclosed(store: SurfaceStore, settings: FloorSettings, step: float) -> list[Patch]:
    """Find floors that closed meshes hold, so that nobody can stand on them, the largest first.

    They face up within the slope, have headroom, and are large enough to be floors. Where such
    a floor goes on outside at its height, a closed thing only stands on it, like a crate, unless
    it is as large as a building. The geom of each patch is the mesh that holds it.
    """
    lattice, (cell, z, geom) = store.lattice, store.held
    pairs = [np.empty((2, 0), dtype=np.int64)]
    for way in range(2):
        other = _beside(lattice, cell, way)
        begin = np.searchsorted(cell, other)
        end = np.where(other < 0, begin, np.searchsorted(cell, other, side="right"))
        one, two = ranges(begin, end)
        near = (geom[one] == geom[two]) & (abs(z[one] - z[two]) <= step + SLACK)
        pairs.append(np.stack([one[near], two[near]]))
    part, found = connect(np.concatenate(pairs, axis=1), len(cell)), []
    needed = max(area_test(lattice, settings).needed, 1)
    for number in np.flatnonzero(np.bincount(part) >= needed).tolist():
        members = np.flatnonzero(part == number)
        cells, heights = cell[members], z[members]
        if is_large(lattice, settings, cells):
            area = len(cells) * lattice.cell_size**2
            if area >= BUILDING or not _goes_on(store, cells, heights, step):
                place = middle_of(lattice, cells, heights)
                found.append(Patch(int(geom[members[0]]), area, place, cells.astype(np.int32)))
    return sorted(found, key=lambda floor: -floor.area)


def _beside(lattice: Lattice, cell: Int, way: int) -> Int:
    """The next cell of each in the east (0), south (1), west (2) or north (3), -1 for none."""
    row, col = np.divmod(cell, lattice.width)
    row, col = row + (0, 1, 0, -1)[way], col + (1, 0, -1, 0)[way]
    inside = (row >= 0) & (row < lattice.height) & (col >= 0) & (col < lattice.width)
    return np.where(inside, row * lattice.width + col, -1)


def _goes_on(store: SurfaceStore, cells: Int, heights: Float, step: float) -> bool:
    """Whether floors go on at a floor's height beyond a share of its outline."""
    surfaces, edges, goes_on = store.surfaces, 0, 0
    for way in range(4):
        other = _beside(store.lattice, cells, way)
        at_edge = ~np.isin(other, cells)
        edges += int(np.count_nonzero(at_edge))
        at_edge &= other >= 0
        other = other[at_edge]
        first = surfaces.first[other]
        column = first, first + surfaces.length[other], surfaces.z
        near = find_near(*column, heights[at_edge], step)
        goes_on += int(np.count_nonzero(~np.isnan(near)))
    return goes_on >= GOES_ON * edges
