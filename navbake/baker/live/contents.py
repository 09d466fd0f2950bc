"""What stands in the cells of a level, kept up to date where things move.

Entries are kept by bands of rows, which are never written to: a band with a changed cell is
replaced. So a grid that was handed out can still read the names of what stood in its cells then.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns import Columns, TiledShapes
from navbake.baker.contents.contents import (
    Contents,
    LevelContents,
    classify_geoms,
    group_triangles,
    measure_over_floors,
    name_contents,
)
from navbake.baker.contents.structure import Carriers, FloorSupport, find_carriers
from navbake.baker.contents.walls import (
    NEAR_FLOOR,
    WALL_BAND,
    GeomsOverFloors,
    candidates_of,
    is_static,
    is_surface,
)
from navbake.baker.floors.levels import Floors, LevelFloor
from navbake.baker.floors.sheets import agent_limits
from navbake.baker.kernels.arrays import Crossings, Probe, StoreyCells
from navbake.baker.kernels.constants import TOUCH
from navbake.baker.kernels.contents import describe_floors
from navbake.baker.kernels.flags import BLOCKS, PROBED, STANDS, UNPROVED
from navbake.baker.kernels.tiles import tile_of
from navbake.baker.lattice import Window
from navbake.baker.live.columns import LiveColumns, Region
from navbake.baker.live.following import boxes_of
from navbake.baker.live.growth import FloorChanges
from navbake.baker.live.kernels.contents import (
    count_in_tiles,
    count_taken,
    list_in_tiles,
    measure_entries,
    replace_entries,
)
from navbake.baker.live.kernels.pool import point_at
from navbake.baker.live.kernels.regions import cells_of_boxes
from navbake.baker.occupancy.occupancy import Footprint
from navbake.baker.scene.bodies import find_free_bodies
from navbake.baker.scene.extents import Extents, measure_geoms
from navbake.baker.scene.scene import Scene
from navbake.baker.warn import ContentNotes
from navbake.config.settings import BakeConfig
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.user_data import Shared, UserData
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int, Int32

ROWS = 8  # of cells in a band
# So many tiles are worth a call on another thread
LEAST_TILES = 8


class Entries(NamedTuple):
    """The geoms of some cells, ragged as in `LevelContents`.

    Attributes:
        start: shape (cells + 1,), int64.
        geom: MuJoCo's geom ids, ascending in a cell, shape (n,), int32.
        flags: STANDS, BLOCKS and PROBED, shape (n,), uint8.
    """

    start: Int
    geom: Int32
    flags: NDArray[np.uint8]


class WallChanges(NamedTuple):
    """Whether rooms may be others: walls changed, or the cells that a building's mesh blocks."""

    walls: bool
    low: bool


class LiveContents:
    """The contents of the one level of a scene, kept up to date.

    Attributes:
        wall, low: see `Contents.wall_cells` and `Contents.low_cells`, shape (cells,).
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
        listed = contents.levels[0]
        self._config, self._live, self.kinds = config, live, contents.kinds
        self.names, self.warnings = contents.names, contents.warnings
        self._bands = _split(listed, live.lattice)
        self.support, num = self._describe(floors.levels[0], columns.crossings), len(scene.geoms)
        self._extents = measure_geoms(scene.shapes, num)
        self._is_static = is_static(scene)
        self._is_surface = is_surface(scene)
        self._candidates = candidates_of(self._is_static, self._is_surface, self._extents)
        over = measure_over_floors(contents.levels, floors, self._extents)
        cells = live.lattice.cell_size**2
        area, upper_area = (
            np.rint(area / cells).astype(np.int64) for area in (over.area, over.upper_area)
        )
        self._measured: tuple[Float, Float, Int, Int] = over.base, over.rise, area, upper_area
        self._carriers = self._find_carriers(floors)
        self._stood_on = self._count_stood_on(floors.levels[0])
        self._roots = np.asarray(scene.model.body_rootid)[scene.model.geom_bodyid]
        self.wall, self.low = contents.wall_cells(0).ravel(), contents.low_cells(0).ravel()
        self._free_body = find_free_bodies(scene.model)
        self.taken = np.zeros(scene.model.nbody, dtype=np.int64)
        if (self._free_body >= 0).any():
            for band in self._bands:
                count_taken(band, np.arange(len(band.start) - 1), self._free_body, self.taken, 1)

    # ------------------------------------------------------------------ updates

    def follow(
        self,
        scene: Scene,
        moved: Bool,
        near: TiledShapes,
        touched: Region,
        occupied: Bool,
        floors: Floors,
        changes: FloorChanges,
    ) -> WallChanges:
        """Bring the contents up to date.

        Args:
            scene: as it is now, without doors.
            moved: the geoms whose geometry differs, shape (ngeom,).
            near: its geometry near the touched cells.
            touched: all cells near what moved, and all others whose column or floor changed.
            occupied: of all cells, up to date.
            floors: up to date.
            changes: of the floors.
        """
        level = floors.levels[0]
        self._measure_moved(scene, moved)
        entries = self._list(scene, near, touched, occupied, level)
        marked = moved.copy()
        cells = self._replace(touched.cells, entries, marked)
        self._mark_geoms(changes.heights, marked)
        carried = self._follow_support(touched, level, changes, moved)
        decided = (self._is_static | self._is_surface) & marked
        was = self._decisive(decided)
        self._measure_marked(scene, marked, level)
        now = self._decisive(decided)
        as_before = all(np.array_equal(one, other) for one, other in zip(was, now, strict=True))
        kinds_hold = carried and as_before and not self._may_be_others(moved)
        if not kinds_hold:
            if not carried:
                was_carried, self._carriers = self._carriers, self._find_carriers(floors)
                carried = _decide_the_same(was_carried, self._carriers, self._is_static)
            kinds_hold = carried and as_before and not self._may_be_others(moved)
            kinds_hold = kinds_hold or self._classify(scene)
        return self._mark_walls(cells, kinds_hold)

    def _measure_moved(self, scene: Scene, moved: Bool) -> None:
        new = measure_geoms(scene.shapes.only(moved), len(moved))
        extents = Extents(*(array.copy() for array in self._extents))
        for old, now in zip(extents, new, strict=True):
            old[moved] = now[moved]
        self._extents = extents
        self._candidates = candidates_of(self._is_static, self._is_surface, extents)

    def _list(
        self, scene: Scene, near: TiledShapes, touched: Region, occupied: Bool, level: LevelFloor
    ) -> Entries:
        """List the geoms of the touched cells; see `_list_level` of the contents of a bake."""
        live, scratch, agent = self._live, self._live.scratch, self._config.agent
        lattice, cells, shapes = live.lattice, touched.cells, near.shapes
        top = -np.inf if scene.bounds is None else float(scene.bounds[1, 2])
        floor = level.floor.reshape(-1)[cells]
        scratch.floor[cells] = floor
        scratch.ceiling[cells] = np.maximum(top, floor + agent.height) - TOUCH
        groups = group_triangles(near)
        tiles = np.unique(tile_of(lattice, cells))
        footprint = Footprint.of(agent, lattice.cell_size)
        nothing = np.empty(0, dtype=np.int32), np.empty(0, dtype=np.uint8)
        storey = StoreyCells(
            scratch.floor, scratch.ceiling, occupied.reshape(-1), scratch.slot, *nothing
        )
        few = {"least": LEAST_TILES}
        scratch.slot[cells + 1] = 0
        lists = near.tiles, groups
        boxes = shapes.solids, shapes.planes, lists
        run_in_bands(count_in_tiles, len(tiles), lattice, *boxes, footprint, storey, tiles, **few)
        slot = np.concatenate([[0], np.cumsum(scratch.slot[cells + 1])])
        point_at(cells, slot, scratch.slot)
        geom, flags = np.empty(slot[-1], dtype=np.int32), np.zeros(slot[-1], dtype=np.uint8)
        storey = storey._replace(geom=geom, flags=flags)
        probe = Probe(WALL_BAND[0] + TOUCH, WALL_BAND[1] - TOUCH, self._candidates)
        geometry = (shapes.solids, near.facets, shapes.planes), lists
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

    def _replace(self, cells: Int, entries: Entries, marked: Bool) -> Int:
        """Put new entries of cells in place; marks their geoms, returns the cells that changed."""
        per_band = ROWS * self._live.lattice.width
        counted = (self._free_body >= 0).any()
        bands, changed = list(self._bands), []
        for number, own in _by_band(cells, per_band):
            start = entries.start[own.start : own.stop + 1]
            here = slice(int(start[0]), int(start[-1]))
            new = start - start[0], entries.geom[here], entries.flags[here]
            local = cells[own] - number * per_band
            start, geom, flags, differs = replace_entries(bands[number], local, *new, marked)
            if not differs.any():
                continue
            changed.append(cells[own][differs])
            if counted:
                count_taken(bands[number], local[differs], self._free_body, self.taken, -1)
            bands[number] = Entries(start, geom, flags)
            if counted:
                count_taken(bands[number], local[differs], self._free_body, self.taken, 1)
        self._bands = bands
        return np.concatenate([np.empty(0, dtype=np.int64), *changed])

    def _decisive(self, geoms: Bool) -> list[Float | Int]:
        """What was measured of some geoms, as far as it can decide what they are.

        How deep a geom reaches under a floor does not: all that begins so low may be a wall, and
        none of it is a ceiling.
        """
        base, *others = (array[geoms] for array in self._measured)
        low = min(NEAR_FLOOR, self._config.agent.height / 2)
        return [np.maximum(base, low), *others]

    def _mark_geoms(self, cells: Int, marked: Bool) -> None:
        """Mark the geoms in some cells."""
        per_band = ROWS * self._live.lattice.width
        for number, own in _by_band(cells, per_band):
            _, geom, _ = _take(self._bands[number], cells[own] - number * per_band)
            marked[geom] = True

    def _measure_marked(self, scene: Scene, marked: Bool, level: LevelFloor) -> None:
        """Measure geoms again over all cells that they may be in."""
        lattice, agent = self._live.lattice, self._config.agent
        for array, nothing in zip(self._measured, (np.inf, -np.inf, 0, 0), strict=True):
            array[marked] = nothing
        footprint = Footprint.of(agent, lattice.cell_size)
        reach = max(lattice.cell_size / 2, footprint.reach) + 2 * TOUCH
        boxes, _ = boxes_of(scene.shapes.only(marked))
        cells = cells_of_boxes(lattice, boxes, reach, 1.0, self._live.scratch.flag)
        per_band, floor = ROWS * lattice.width, level.floor.reshape(-1)
        sizes = self._extents.low, self._extents.high
        for number, own in _by_band(cells, per_band):
            first = number * per_band
            asked = self._bands[number], first, cells[own] - first
            measure_entries(*asked, floor, *sizes, marked, self._measured)

    # ------------------------------------------------------------------ what geoms are

    def _follow_support(
        self, touched: Region, level: LevelFloor, changes: FloorChanges, moved: Bool
    ) -> bool:
        """Find what carries floors again; whether all that carriers rest on is as it was."""
        cells = touched.cells
        support = FloorSupport(np.empty(len(cells), dtype=np.int32), np.empty(len(cells)))
        floor = level.floor.reshape(-1)[cells]
        min_up = agent_limits(self._config.agent).min_up
        describe_floors(floor, touched.columns, min_up, support)
        differs = support.geom != self.support.geom[cells]
        differs |= support.gap != self.support.gap[cells]
        holds = not differs.any() and not len(changes.heights)
        holds &= not self._stood_on[moved].any() and not self._carries[moved].any()
        if differs.any():
            geom, gap = self.support.geom.copy(), self.support.gap  # no grid has the gaps
            geom[cells], gap[cells] = support.geom, support.gap
            self.support = FloorSupport(geom, gap)
        if not holds:
            self._stood_on = self._count_stood_on(level)
            return False
        was = self._stood_on > 0
        geom, stands = self.support.geom, level.standable.reshape(-1)
        shifted = changes.standable[geom[changes.standable] >= 0]
        np.add.at(self._stood_on, geom[shifted], np.where(stands[shifted], 1, -1))
        return bool(((self._stood_on > 0) == was).all())

    def _describe(self, level: LevelFloor, crossings: Crossings) -> FloorSupport:
        floor = level.floor.ravel()
        support = FloorSupport(np.empty(len(floor), dtype=np.int32), np.empty(len(floor)))
        describe_floors(floor, crossings, agent_limits(self._config.agent).min_up, support)
        return support

    def _count_stood_on(self, level: LevelFloor) -> Int:
        """In how many cells each geom carries a floor that one can stand on."""
        geom = self.support.geom
        carried = geom[geom >= 0]
        self._carries = np.bincount(carried, minlength=len(self.names)) > 0
        stood_on = geom[(geom >= 0) & level.standable.reshape(-1)]
        return np.bincount(stood_on, minlength=len(self.names))

    def _find_carriers(self, floors: Floors) -> Carriers:
        step = self._config.agent.traversable_floor_height
        return find_carriers(floors, [self.support], self._extents, step, self._live.lattice)

    def _may_be_others(self, moved: Bool) -> bool:
        """Whether geoms may be walls now, or none any more, by what moved.

        What a joint moves is a wall only where a mesh holds a whole building, or the settings name
        it. But a static panel is furniture, not a wall, by the size of the body that it is a part
        of, moving parts included.
        """
        if (moved & (self._is_static | self._is_surface)).any():
            return True
        roots = np.unique(self._roots[moved])
        return bool((self._is_static & np.isin(self._roots, roots[roots > 0])).any())

    def _classify(self, scene: Scene) -> bool:
        """Tell what each geom is; whether that is the same as before."""
        base, rise, area, upper_area = self._measured
        size = self._live.lattice.cell_size**2
        areas: list[Float] = [np.asarray(cells * size) for cells in (area, upper_area)]
        over = GeomsOverFloors(base, rise, *areas)
        agent, names = self._config.agent, self._config.names
        was = self.kinds
        self.kinds, self.warnings = classify_geoms(
            scene, self._extents, over, self._carriers, agent, names
        )
        return bool((self.kinds == was).all())

    def _mark_walls(self, cells: Int, kinds_hold: bool) -> WallChanges:
        """Bring `wall` and `low` up to date where entries changed; everywhere for other kinds."""
        old = self.wall, self.low
        if not kinds_hold:
            contents = Contents([self._assemble()], self.kinds, self.names, self.warnings)
            self.wall, self.low = contents.wall_cells(0).ravel(), contents.low_cells(0).ravel()
            changed = (
                bool((a != b).any()) for a, b in zip(old, (self.wall, self.low), strict=True)
            )
            return WallChanges(*changed)
        if not len(cells):
            return WallChanges(False, False)
        listed = self._level_of(cells)
        part = Contents([listed], self.kinds, self.names, self.warnings)
        wall, low = part.wall_cells(0).ravel(), part.low_cells(0).ravel()
        changes = WallChanges(
            bool((wall != self.wall[cells]).any()), bool((low != self.low[cells]).any())
        )
        self.wall[cells], self.low[cells] = wall, low
        return changes

    def _level_of(self, cells: Int) -> LevelContents:
        """The contents of some cells, as those of a level with one row of cells."""
        per_band = ROWS * self._live.lattice.width
        taken = [
            _take(self._bands[number], cells[own] - number * per_band)
            for number, own in _by_band(cells, per_band)
        ]
        line = self._live.lattice._replace(width=len(cells), height=1)
        return _to_level(_join(taken), line, self.support)

    # ------------------------------------------------------------------ what is told

    def user_data(self, window: Window) -> UserData:
        """See `Contents.user_data`: made when someone looks at it, of what there is now."""
        known = self._bands, self._live.lattice, self.support, self.kinds, self.names
        return UserData(partial(_name_bands, *known, window))

    def notes(self) -> ContentNotes:
        """What is to be told of the contents."""
        return ContentNotes(self.taken, self.warnings)

    def _assemble(self) -> LevelContents:
        return _to_level(_join(self._bands), self._live.lattice, self.support)


def _split(listed: LevelContents, lattice: Lattice) -> list[Entries]:
    flags = np.where(listed.stands, STANDS, 0) | np.where(listed.blocks, BLOCKS, 0)
    flags = flags | np.where(listed.upper, PROBED, 0)
    bits: NDArray[np.uint8] = flags.astype(np.uint8)
    per_band, bands = ROWS * lattice.width, []
    for first in range(0, len(listed.start) - 1, per_band):
        start = listed.start[first : first + per_band + 1]
        here = slice(int(start[0]), int(start[-1]))
        bands.append(Entries(start - start[0], listed.geom[here], bits[here]))
    return bands


def _decide_the_same(one: Carriers, other: Carriers, static: Bool) -> bool:
    """Whether walls and structure are the same with other carriers, see `classify_geoms`.

    What only lies on floors, and what one can stand on, is asked of static geoms alone.
    """
    differs = one.building != other.building
    differs |= static & ((one.things != other.things) | (one.stood_on != other.stood_on))
    return not differs.any()


def _by_band(cells: Int, per_band: int) -> list[tuple[int, slice]]:
    """Of ascending cells, each band's number and which of them are in it."""
    number = cells // per_band
    first = np.flatnonzero(np.diff(number, prepend=-1))
    ends = np.append(first[1:], len(cells))[: len(first)]
    pairs = zip(number[first].tolist(), first.tolist(), ends.tolist(), strict=True)
    return [(band, slice(begin, end)) for band, begin, end in pairs]


def _take(band: Entries, cells: Int) -> Entries:
    counts = np.diff(band.start)[cells]
    start = np.concatenate([[0], np.cumsum(counts)])
    taken = np.repeat(band.start[cells] - start[:-1], counts) + np.arange(start[-1])
    return Entries(start, band.geom[taken], band.flags[taken])


def _join(bands: Sequence[Entries]) -> Entries:
    ends = np.cumsum([0, *(len(band.geom) for band in bands)])
    starts = [band.start[:-1] + end for band, end in zip(bands, ends, strict=False)]
    geom = np.concatenate([np.empty(0, dtype=np.int32), *(band.geom for band in bands)])
    flags = np.concatenate([np.empty(0, dtype=np.uint8), *(band.flags for band in bands)])
    return Entries(np.concatenate([*starts, ends[-1:]]), geom, flags)


def _to_level(entries: Entries, lattice: Lattice, support: FloorSupport) -> LevelContents:
    stands, blocks, upper = ((entries.flags & flag) > 0 for flag in (STANDS, BLOCKS, PROBED))
    return LevelContents(lattice, entries.start, entries.geom, stands, blocks, upper, support.geom)


def _name_bands(
    bands: Sequence[Entries],
    lattice: Lattice,
    support: FloorSupport,
    kinds: NDArray[np.uint8],
    names: Sequence[str],
    window: Window,
) -> Shared:
    return name_contents(_to_level(_join(bands), lattice, support), kinds, names, window)
