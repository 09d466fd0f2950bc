"""Rooms in a scene in which things move: found again only where something they read has changed."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from navbake.baker.columns import Columns
from navbake.baker.floors.growth import FloorChanges
from navbake.baker.floors.levels import Floors, LevelFloor
from navbake.baker.kernels.arrays import Crossings
from navbake.baker.kernels.constants import SLACK
from navbake.baker.rooms.flags import Blocked, keep_holes, read_flags
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
from navbake.baker.update.columns import LiveColumns, Region
from navbake.baker.update.contents import LiveContents
from navbake.baker.update.kernels.regions import are_in
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
        changes: of the floors, by level.
    """

    old: Region
    new: Region
    changes: list[FloorChanges]


class LiveRooms:
    """The rooms of a scene, where floors and walls are known."""

    def __init__(
        self, config: BakeConfig, scene: Scene, columns: LiveColumns, floors: Floors
    ) -> None:
        self._config, self._columns = config, columns
        self.marks = RoomMarks(config, scene)
        self._have_stairs = self._find_stairs(floors)

    def find(self, scene: Scene, floors: Floors, contents: LiveContents | None) -> Rooms:
        """Find all rooms again; the scene is without doors."""
        config, shape = self._config, self._columns.lattice.shape
        if contents is None:
            none = np.zeros(shape, dtype=np.bool_)
            blocked = [Blocked(none, none) for _ in floors.levels]
        else:
            blocked = [
                Blocked(wall.reshape(shape), low.reshape(shape))
                for wall, low in zip(contents.wall, contents.low, strict=True)
            ]
        overhead = self._columns.overhead(floors.levels, config.agent)
        flags = read_flags(scene, overhead, floors, blocked, config.rooms, config.agent)
        rooms = find_rooms(flags, config.rooms, config.agent.traversable_floor_height)
        self._have_stairs = self._find_stairs(floors)
        return rooms

    def follow(self, rooms: Rooms, was: Floors, floors: Floors, seen: Seen) -> Rooms | None:
        """The rooms with other columns and floors, where walls and marks are as they were.

        None where they are to be found again. Those that know all that `find_rooms` reads to be the
        same need not: of cells with a floor, whether they are under the sky, if that was asked, and
        the surfaces of geoms that mark rooms. Of cells without a floor, beside these, and at the
        lattice's edge, it reads more. Heights of floors decide where rooms have stairs, where they
        open to each other, and how high their middles are. Links between levels join rooms.
        """
        heights = [change.heights for change in seen.changes]
        if not len(seen.new.cells) and not any(map(len, heights)):
            return rooms
        if not np.array_equal(was.links, floors.links):
            return None
        if not _same_marks(seen.old.columns, seen.new.columns, self.marks.geoms):
            return None
        for level, change in zip(floors.levels, seen.changes, strict=True):
            if np.isnan(change.before).any() or self._reads_other(level, change, seen):
                return None
            if not self._same_sky(level, change, seen):
                return None
        if not any(map(len, heights)):
            return rooms
        lattice = self._columns.lattice
        if self.marks.are_there or any(
            _are_between_rooms(index, cells, lattice)
            for index, cells in zip(rooms.index, heights, strict=True)
        ):
            return None
        if self._have_stairs or self._find_stairs(floors):
            return None
        (index,) = rooms.index
        named = [NamedRoom(room.name, str(room.source), room.outdoors) for room in rooms.table]
        heights_of = [level.floor for level in floors.levels]
        table = describe_rooms([index], [named], heights_of, lattice)
        return replace(rooms, table=name_neighbours(table, rooms.openings, rooms.links, {}))

    def _find_stairs(self, floors: Floors) -> bool:
        """Whether any part of a space may be as steep as a stair."""
        if len(floors.levels) > 1:
            return True
        level, size = floors.levels[0], self._columns.lattice.cell_size
        label = (~np.isnan(level.floor)).astype(np.int32)
        return bool(mark_steep(label, level.floor, size).any())

    def _reads_other(self, level: LevelFloor, change: FloorChanges, seen: Seen) -> bool:
        """Whether rooms read something else at the edge of the floor, or where there is none."""
        lattice, agent = self._columns.lattice, self._config.agent
        if _is_at_edge(level, change.heights, lattice).any():
            return True
        cells = seen.new.cells
        has_floor = ~np.isnan(level.floor.reshape(-1)[cells])
        if _is_at_edge(level, cells[has_floor], lattice).any():
            return True
        told = []
        for region in (seen.old, seen.new):
            columns = region.columns
            bare = np.flatnonzero(~has_floor)
            holes, is_empty = ~has_floor, columns.start[bare] == columns.start[bare + 1]
            asked = Columns(lattice, columns)
            keep_holes(holes, columns.start, level.ground, asked, agent)
            last = columns.start[bare + 1] - 1
            top = np.where(is_empty, np.nan, columns.z[last]) if len(columns.z) else np.empty(0)
            up = np.where(is_empty, 0, columns.normal[last, 2]) if len(columns.z) else np.empty(0)
            told.append((holes, is_empty, top, up))
        return not all(
            np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
            for one, other in zip(*told, strict=True)
        )

    def _same_sky(self, level: LevelFloor, change: FloorChanges, seen: Seen) -> bool:
        """Whether the same cells are under the sky, of those with other columns or floors."""
        floor, height = level.floor.reshape(-1).copy(), self._config.agent.height
        cells, asked = seen.new.cells, change.heights
        rest = self._columns.gather(asked[~are_in(asked, cells)])
        now = [_is_under_sky(region, floor, height) for region in (seen.new, rest)]
        floor[asked] = change.before
        was = [_is_under_sky(region, floor, height) for region in (seen.old, rest)]
        return all(np.array_equal(one, other) for one, other in zip(was, now, strict=True))


def _is_under_sky(region: Region, floor: Float, height: float) -> Bool:
    """Whether nothing is above the heads of agents in cells with a floor."""
    start, z = region.columns.start, region.columns.z
    floors = floor[region.cells]
    filled = ~np.isnan(floors) & (start[1:] > start[:-1])
    result = np.zeros(len(floors), dtype=np.bool_)
    result[filled] = z[start[1:][filled] - 1] <= floors[filled] + height + SLACK
    return result


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
