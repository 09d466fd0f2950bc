"""Whether rooms can be others after something moved: what they read of columns and floors."""

from __future__ import annotations

import numpy as np

from navbake.baker.floors.levels import LevelFloor
from navbake.baker.kernels.arrays import Crossings
from navbake.baker.kernels.constants import SLACK
from navbake.baker.live.columns import Region
from navbake.baker.rooms.rooms import Rooms
from navbake.baker.rooms.sources import match_geoms, match_sites
from navbake.baker.scene.names import names_at
from navbake.baker.scene.scene import Scene
from navbake.config.settings import BakeConfig
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float


class RoomMarks:
    """The geoms and sites of a scene that mark rooms."""

    def __init__(self, config: BakeConfig, scene: Scene) -> None:
        model, sources = scene.model, config.rooms.sources
        geoms, sites = (
            names_at(model, addresses.tolist())
            for addresses in (model.name_geomadr, model.name_siteadr)
        )
        self.geoms = np.zeros(model.ngeom, dtype=np.bool_)
        if "geoms" in sources:
            self.geoms[match_geoms(geoms, config.rooms)[0]] = True
        self._sites = match_sites(sites, config.rooms)[0] if "sites" in sources else []
        self.keep(scene)

    def keep(self, scene: Scene) -> None:
        """Take the sites' poses for those that the next ones are compared with."""
        self._poses = self._poses_of(scene)

    def have_moved(self, scene: Scene, moved: Bool) -> bool:
        """Whether any of them did; `moved` are geoms, whether they count or not."""
        sites_hold = np.array_equal(self._poses_of(scene), self._poses)
        return bool((moved & self.geoms).any()) or not sites_hold

    def _poses_of(self, scene: Scene) -> Float:
        data = scene.data
        return np.hstack([data.site_xpos[self._sites], data.site_xmat[self._sites]])


def rooms_hold(
    rooms: Rooms, old: Region, new: Region, level: LevelFloor, marks: RoomMarks, height: float,
    lattice: Lattice,
) -> bool:  # fmt: skip
    """Whether rooms are the same with other columns in some cells, where floors and walls are.

    That is so where all that `find_rooms` reads of these columns is the same: of cells with a
    floor, whether they are under the sky, if that was asked, and the surfaces of geoms that mark
    rooms. Of cells without a floor, beside these, and at the lattice's edge, it reads more.

    Args:
        old, new: the columns before and now.
        height: of the agent [m].
    """
    cells = new.cells
    if not len(cells):
        return True
    if _is_at_edge(level, cells, lattice).any():
        return False
    if rooms.asked_sky:
        floor = level.floor.reshape(-1)[cells]
        was, now = (
            region.columns.z[region.columns.start[1:] - 1] <= floor + height + SLACK
            for region in (old, new)
        )
        if (was != now).any():
            return False
    return _same_marks(old.columns, new.columns, marks.geoms)


def _is_at_edge(level: LevelFloor, cells: np.ndarray, lattice: Lattice) -> Bool:
    """Whether cells have no floor, or a side without any."""
    row, col = np.divmod(cells, lattice.width)
    is_edge = np.isnan(level.floor[row, col])
    for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
        r, c = row + down, col + right
        inside = (r >= 0) & (r < lattice.height) & (c >= 0) & (c < lattice.width)
        is_edge |= ~inside
        is_edge[inside] |= np.isnan(level.floor[r[inside], c[inside]])
    return is_edge


def _same_marks(old: Crossings, new: Crossings, geoms: Bool) -> bool:
    """Whether the surfaces of some geoms are the same in columns of the same cells."""
    found = []
    for columns in (old, new):
        cell = np.repeat(np.arange(len(columns.start) - 1), np.diff(columns.start))
        own = geoms[columns.geom]
        found.append((cell[own], columns.z[own], columns.normal[own], columns.geom[own]))
    return all(np.array_equal(one, other) for one, other in zip(*found, strict=True))
