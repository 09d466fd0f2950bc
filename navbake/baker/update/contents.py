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
from navbake.baker.kernels.groups import Groups
from navbake.baker.kernels.tiles import tile_of
from navbake.baker.lattice import Window
from navbake.baker.occupancy.occupancy import Footprint
from navbake.baker.scene.names import find_free_bodies
from navbake.baker.scene.scene import Scene
from navbake.baker.update.entries import LiveEntries
from navbake.baker.update.kernels.contents import Entries, count_in_tiles, list_in_tiles
from navbake.baker.update.kinds import LiveKinds, NearMoved
from navbake.baker.warn import ContentNotes
from navbake.config.settings import BakeConfig
from navbake.navgrid.lattice import Lattice
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
        lattice: Lattice,
    ) -> None:
        """Take over the contents of a bake; the scene is without doors."""
        self._config, self._lattice, self.names = config, lattice, contents.names
        # NaN everywhere, and so again after each use
        self._floor = np.full(lattice.width * lattice.height, np.nan)
        free_body, num = find_free_bodies(scene.model), int(scene.model.nbody)
        self._entries = [LiveEntries(level, lattice, free_body, num) for level in contents.levels]
        known = config, scene, contents, floors, columns.crossings
        self._kinds = LiveKinds(*known, lattice, self._entries)
        self._mark_all_walls()

    def follow(self, near: NearMoved, tiled: TiledShapes, occupied: Sequence[Bool]) -> WallChanges:
        """Bring the contents up to date.

        Args:
            tiled: the geometry.
            occupied: of all cells of each level, up to date.
        """
        self._kinds.measure_moved(near.scene, near.moved)
        levels, bounds = near.floors.levels, near.scene.bounds
        marked, cells = near.moved.copy(), []
        groups = group_triangles(tiled)
        highest = -np.inf if bounds is None else float(bounds[1, 2])
        tops = [*(level.ground for level in levels[1:]), highest]
        for listed, top, mask, level, changes in zip(
            self._entries, tops, occupied, levels, near.changes, strict=True
        ):
            entries = self._list(top, tiled, groups, near, mask, level)
            cells.append(listed.replace(near.cells, entries, marked))
            listed.mark_geoms(changes.heights, marked)
        return self._mark_walls(cells, self._kinds.follow(near, marked, self._entries))

    def _list(
        self,
        top: float,
        tiled: TiledShapes,
        groups: Groups,
        touched: NearMoved,
        occupied: Bool,
        level: LevelFloor,
    ) -> Entries:
        """List the geoms of touched cells; see `_LevelLister` of the contents of a bake."""
        agent, lattice, cells, shapes = (
            self._config.agent,
            self._lattice,
            touched.cells,
            tiled.shapes,
        )
        floor = level.floor.reshape(-1)[cells]
        self._floor[cells] = floor
        ceiling, slots = np.empty(len(self._floor)), np.zeros(len(self._floor) + 1, dtype=np.int64)
        ceiling[cells] = np.maximum(top, floor + agent.height) - TOUCH
        tiles = np.flatnonzero(np.bincount(tile_of(lattice, cells)))
        footprint = Footprint.of(agent, lattice.cell_size)
        nothing = np.empty(0, dtype=np.int32), np.empty(0, dtype=np.uint8)
        storey = StoreyCells(self._floor, ceiling, occupied.reshape(-1), slots, *nothing)
        few = {"least": LEAST_TILES}
        lists = tiled.tiles, groups
        boxes = shapes.solids, shapes.planes, lists
        run_in_bands(count_in_tiles, len(tiles), lattice, *boxes, footprint, storey, tiles, **few)
        slot = np.concatenate([[0], np.cumsum(slots[cells + 1])])
        slots[cells], slots[cells + 1] = slot[:-1], slot[1:]
        geom, flags = np.empty(slot[-1], dtype=np.int32), np.zeros(slot[-1], dtype=np.uint8)
        storey = storey._replace(geom=geom, flags=flags)
        probe = Probe(WALL_BAND[0] + TOUCH, WALL_BAND[1] - TOUCH, self._kinds.candidates)
        geometry = (shapes.solids, tiled.facets, shapes.planes), lists
        asked = lattice, touched.columns.crossings, *geometry, footprint, probe, storey, tiles
        run_in_bands(list_in_tiles, len(tiles), *asked, **few)
        self._floor[cells] = np.nan
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

    def wall_cells(self, level: int) -> Bool:
        """See `Contents.wall_cells`."""
        return self.wall[level].reshape(self._lattice.shape)

    def low_cells(self, level: int) -> Bool:
        """See `Contents.low_cells`."""
        return self.low[level].reshape(self._lattice.shape)

    def user_data(self, level: int, window: Window) -> UserData:
        """See `Contents.user_data`: made when someone looks at it, of what there is now."""
        kinds = self._kinds
        support = kinds.supports[level]
        return self._entries[level].user_data(support, kinds.kinds, self.names, window)

    def notes(self) -> ContentNotes:
        """What is to be told of the contents."""
        taken = np.sum([listed.taken for listed in self._entries], axis=0)
        return ContentNotes(taken, self._kinds.warnings)
