"""Rooms in a scene in which things move: found again only where something they read has changed."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from navbake.baker.floors.levels import Floors, LevelFloor
from navbake.baker.kernels.arrays import Crossings
from navbake.baker.kernels.constants import SLACK
from navbake.baker.live.columns import LiveColumns, Region
from navbake.baker.live.contents import LiveContents
from navbake.baker.live.kernels.regions import are_in, join_cells
from navbake.baker.rooms.flags import Blocked, read_flags
from navbake.baker.rooms.rooms import (
    NamedRoom,
    RoomIndex,
    Rooms,
    describe_rooms,
    find_rooms,
    name_neighbours,
)
from navbake.baker.rooms.segmentation import mark_steep
from navbake.baker.rooms.sources import match_geoms, match_sites
from navbake.baker.scene.names import names_at
from navbake.baker.scene.scene import Scene
from navbake.config.settings import BakeConfig
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Int


class RoomMarks:
    """The geoms and sites of a scene that mark rooms.

    Attributes:
        geoms: which geoms do, shape (ngeom,), bool.
        are_there: whether anything does, drawn rooms included.
    """

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
        drawn = "polygons" in sources and bool(config.rooms.polygons)
        self.are_there = bool(self.geoms.any()) or len(self._sites) > 0 or drawn
        self.keep(scene)

    def keep(self, scene: Scene) -> None:
        """Take the sites' poses and sizes for those that the next ones are compared with."""
        self._poses = self._poses_of(scene)

    def have_moved(self, scene: Scene, moved: Bool) -> bool:
        """Whether any of them did; `moved` are geoms, whether they count or not."""
        sites_hold = np.array_equal(self._poses_of(scene), self._poses)
        return bool((moved & self.geoms).any()) or not sites_hold

    def _poses_of(self, scene: Scene) -> Float:
        data = scene.data
        placed = data.site_xpos, data.site_xmat, scene.model.site_size
        shape = scene.model.site_type[self._sites, None]
        return np.hstack([*(array[self._sites] for array in placed), shape])


class Seen(NamedTuple):
    """What rooms may read that has changed.

    Attributes:
        old, new: the columns of the same cells, before and now.
        heights: the cells whose floor has another height, or has one where there was none, or
            none, ascending.
        before: the floor that these had, NaN for none [m].
    """

    old: Region
    new: Region
    heights: Int
    before: Float


class LiveRooms:
    """The rooms of the one level of a scene, where floors and walls are known."""

    def __init__(
        self, config: BakeConfig, scene: Scene, columns: LiveColumns, floors: Floors
    ) -> None:
        self._config, self._columns = config, columns
        self.marks = RoomMarks(config, scene)
        self._have_stairs = self._find_stairs(floors.levels[0])

    def find(self, scene: Scene, floors: Floors, contents: LiveContents | None) -> Rooms:
        """Find all rooms again; the scene is without doors."""
        config, shape, level = self._config, floors.levels[0].floor.shape, floors.levels[0]
        none = np.zeros(shape, dtype=np.bool_)
        blocked = Blocked(none, none)
        if contents is not None:
            blocked = Blocked(contents.wall.reshape(shape), contents.low.reshape(shape))
        overhead = self._columns.overhead(level, config.agent)
        flags = read_flags(scene, overhead, floors, [blocked], config.rooms, config.agent)
        rooms = find_rooms(flags, config.rooms, config.agent.traversable_floor_height)
        self._have_stairs = self._find_stairs(level)
        return rooms

    def follow(self, rooms: Rooms, floors: Floors, seen: Seen) -> Rooms | None:
        """The rooms with other columns and floors, where walls and marks are as they were.

        None where they are to be found again. Those that know all that `find_rooms` reads to be the
        same need not: of cells with a floor, whether they are under the sky, if that was asked, and
        the surfaces of geoms that mark rooms. Of cells without a floor, beside these, and at the
        lattice's edge, it reads more. Heights of floors decide where rooms have stairs, where they
        open to each other, and how high their middles are.
        """
        level, lattice = floors.levels[0], self._columns.lattice
        changed = join_cells(seen.new.cells, seen.heights)
        if not len(changed):
            return rooms
        if _is_at_edge(level, changed, lattice).any() or np.isnan(seen.before).any():
            return None
        if not self._same_sky(level, seen):
            return None
        if not _same_marks(seen.old.columns, seen.new.columns, self.marks.geoms):
            return None
        if not len(seen.heights):
            return rooms
        if self.marks.are_there or _are_between_rooms(rooms.index[0], seen.heights, lattice):
            return None
        if self._have_stairs or self._find_stairs(level):
            return None
        named = [NamedRoom(room.name, str(room.source), room.outdoors) for room in rooms.table]
        table = describe_rooms(rooms.index, [named], [level.floor], lattice)
        return replace(rooms, table=name_neighbours(table, rooms.openings, rooms.links, {}))

    def _find_stairs(self, level: LevelFloor) -> bool:
        """Whether any part of a space may be as steep as a stair."""
        cell_size = self._columns.lattice.cell_size
        label = (~np.isnan(level.floor)).astype(np.int32)
        return bool(mark_steep(label, level.floor, cell_size).any())

    def _same_sky(self, level: LevelFloor, seen: Seen) -> bool:
        """Whether the same cells are under the sky, of those with other columns or floors."""
        floor, height = level.floor.reshape(-1).copy(), self._config.agent.height
        cells, asked = seen.new.cells, seen.heights
        rest = self._columns.gather(asked[~are_in(asked, cells)])
        now = [_is_under_sky(region, floor, height) for region in (seen.new, rest)]
        floor[asked] = seen.before
        was = [_is_under_sky(region, floor, height) for region in (seen.old, rest)]
        return all(np.array_equal(one, other) for one, other in zip(was, now, strict=True))


def _is_under_sky(region: Region, floor: Float, height: float) -> Bool:
    """Whether nothing is above the heads of agents in cells with a floor."""
    top = region.columns.z[region.columns.start[1:] - 1]
    return np.asarray(top <= floor[region.cells] + height + SLACK)


def _are_between_rooms(index: RoomIndex, cells: Int, lattice: Lattice) -> bool:
    """Whether one of some cells, none at the lattice's edge, has another room beside it."""
    flat = index.reshape(-1)
    own = flat[cells]
    others = (flat[cells + step] for step in (1, -1, lattice.width, -lattice.width))
    return any(bool(((own != other) & (own > 0) & (other > 0)).any()) for other in others)


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
