"""What stands in the cells of a level, and which of them walls stand in, kept up to date."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from navbake.baker.columns import Columns, TiledShapes
from navbake.baker.contents.contents import Contents, group_triangles
from navbake.baker.contents.walls import WALL_BAND
from navbake.baker.floors.levels import Floors, LevelFloor
from navbake.baker.kernels.arrays import Probe, StoreyCells
from navbake.baker.kernels.constants import TOUCH
from navbake.baker.kernels.flags import BLOCKS, PROBED, STANDS, UNPROVED
from navbake.baker.kernels.tiles import tile_of
from navbake.baker.lattice import Window
from navbake.baker.occupancy.occupancy import Footprint
from navbake.baker.scene.names import find_free_bodies
from navbake.baker.scene.scene import Scene
from navbake.baker.update.columns import LiveColumns, Region
from navbake.baker.update.entries import LiveEntries
from navbake.baker.update.kernels.contents import Entries, count_in_tiles, list_in_tiles
from navbake.baker.update.kernels.pool import point_at
from navbake.baker.update.kinds import LiveKinds, NearMoved
from navbake.baker.warn import ContentNotes
from navbake.config.settings import BakeConfig
from navbake.navgrid.user_data import UserData
from navbake.threads import run_in_bands
from navbake.types import Bool, Int

# So many tiles are worth a call on another thread
LEAST_TILES = 8


class WallChanges(NamedTuple):
    """Whether rooms may be others: walls changed, or the cells that a building's mesh blocks."""

    walls: bool
    low: bool


class LiveContents:
    """The contents of the levels of a scene, kept up to date.

    Attributes:
        wall, low: by level, see `Contents.wall_cells` and `Contents.low_cells`, shape (cells,).
    """

    def __init__(
        self,
        config: BakeConfig,
        scene: Scene,
        contents: Contents,
        floors: Floors,
        columns: Columns,
        live: LiveColumns,
    ) -> None:
        """Take over the contents of a bake; the scene is without doors."""
        self._config, self._live, self.names = config, live, contents.names
        free_body, num = find_free_bodies(scene.model), int(scene.model.nbody)
        self._entries = [
            LiveEntries(level, live.lattice, free_body, num) for level in contents.levels
        ]
        known = config, scene, contents, floors, columns.crossings
        self._kinds = LiveKinds(*known, live, self._entries)
        self._mark_all_walls()

    def follow(self, near: NearMoved, tiled: TiledShapes, occupied: Sequence[Bool]) -> WallChanges:
        """Bring the contents up to date.

        Args:
            tiled: the geometry near the region.
            occupied: of all cells of each level, up to date.
        """
        self._kinds.measure_moved(near.scene, near.moved)
        levels, bounds = near.floors.levels, near.scene.bounds
        marked, cells = near.moved.copy(), []
        highest = -np.inf if bounds is None else float(bounds[1, 2])
        tops = [*(level.ground for level in levels[1:]), highest]
        for listed, top, mask, level, changes in zip(
            self._entries, tops, occupied, levels, near.changes, strict=True
        ):
            entries = self._list(top, tiled, near.region, mask, level)
            cells.append(listed.replace(near.region.cells, entries, marked))
            listed.mark_geoms(changes.heights, marked)
        return self._mark_walls(cells, self._kinds.follow(near, marked, self._entries))

    def _list(
        self, top: float, tiled: TiledShapes, touched: Region, occupied: Bool, level: LevelFloor
    ) -> Entries:
        """List the geoms of touched cells; see `_LevelLister` of the contents of a bake."""
        live, scratch, agent = self._live, self._live.scratch, self._config.agent
        lattice, cells, shapes = live.lattice, touched.cells, tiled.shapes
        floor = level.floor.reshape(-1)[cells]
        scratch.floor[cells] = floor
        scratch.ceiling[cells] = np.maximum(top, floor + agent.height) - TOUCH
        groups = group_triangles(tiled)
        tiles = np.flatnonzero(np.bincount(tile_of(lattice, cells)))
        footprint = Footprint.of(agent, lattice.cell_size)
        nothing = np.empty(0, dtype=np.int32), np.empty(0, dtype=np.uint8)
        storey = StoreyCells(
            scratch.floor, scratch.ceiling, occupied.reshape(-1), scratch.slot, *nothing
        )
        few = {"least": LEAST_TILES}
        scratch.slot[cells + 1] = 0
        lists = tiled.tiles, groups
        boxes = shapes.solids, shapes.planes, lists
        run_in_bands(count_in_tiles, len(tiles), lattice, *boxes, footprint, storey, tiles, **few)
        slot = np.concatenate([[0], np.cumsum(scratch.slot[cells + 1])])
        point_at(cells, slot, scratch.slot)
        geom, flags = np.empty(slot[-1], dtype=np.int32), np.zeros(slot[-1], dtype=np.uint8)
        storey = storey._replace(geom=geom, flags=flags)
        probe = Probe(WALL_BAND[0] + TOUCH, WALL_BAND[1] - TOUCH, self._kinds.candidates)
        geometry = (shapes.solids, tiled.facets, shapes.planes), lists
        asked = lattice, touched.by_id(scratch), *geometry, footprint, probe, storey, tiles
        run_in_bands(list_in_tiles, len(tiles), *asked, **few)
        scratch.floor[cells] = np.nan
        kept = flags > 0
        start, flags = np.concatenate([[0], np.cumsum(kept)])[slot], flags[kept]
        unproved = np.flatnonzero(flags & UNPROVED)
        if len(unproved):  # what FCL found out about the cell decides
            inside = cells[np.searchsorted(start, unproved, side="right") - 1]
            flags[unproved[occupied.reshape(-1)[inside]]] |= BLOCKS
        return Entries(start, geom[kept], flags & np.uint8(STANDS | BLOCKS | PROBED))

    def _mark_all_walls(self) -> None:
        contents = self._contents_of([None] * len(self._entries))
        levels = range(len(self._entries))
        self.wall = [contents.wall_cells(k).ravel() for k in levels]
        self.low = [contents.low_cells(k).ravel() for k in levels]

    def _mark_walls(self, cells: Sequence[Int], kinds_hold: bool) -> WallChanges:
        """Bring `wall` and `low` up to date where entries changed; everywhere for other kinds."""
        if not kinds_hold:
            old = self.wall, self.low
            self._mark_all_walls()
            return WallChanges(
                *(
                    any(bool((a != b).any()) for a, b in zip(was, now, strict=True))
                    for was, now in zip(old, (self.wall, self.low), strict=True)
                )
            )
        part, walls, lows = self._contents_of(cells), False, False
        for k, own in enumerate(cells):
            if len(own):
                wall, low = part.wall_cells(k).ravel(), part.low_cells(k).ravel()
                walls |= bool((wall != self.wall[k][own]).any())
                lows |= bool((low != self.low[k][own]).any())
                self.wall[k][own], self.low[k][own] = wall, low
        return WallChanges(walls, lows)

    def _contents_of(self, cells: Sequence[Int | None]) -> Contents:
        """The contents of some cells of each level, in one row, or of all."""
        kinds = self._kinds
        levels = [
            listed.all(support) if own is None else listed.of(own, support)
            for own, listed, support in zip(cells, self._entries, kinds.supports, strict=True)
        ]
        return Contents(levels, kinds.kinds, self.names, kinds.warnings)

    def user_data(self, level: int, window: Window) -> UserData:
        """See `Contents.user_data`: made when someone looks at it, of what there is now."""
        kinds = self._kinds
        support = kinds.supports[level]
        return self._entries[level].user_data(support, kinds.kinds, self.names, window)

    def notes(self) -> ContentNotes:
        """What is to be told of the contents."""
        taken = np.sum([listed.taken for listed in self._entries], axis=0)
        return ContentNotes(taken, self._kinds.warnings)
