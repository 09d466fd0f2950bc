"""What stands in each cell: which geoms, what they are, and under which names."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns import Columns, TiledShapes, tiles_of_rows
from navbake.baker.contents.cell_names import BLOCKERS, OBJECTS, WALLS, name_cells, name_geoms
from navbake.baker.contents.structure import (
    Carriers,
    FloorSupport,
    find_carriers,
    find_ceilings,
)
from navbake.baker.contents.walls import (
    BUILDING,
    OBJECT,
    STRUCTURE,
    WALL,
    WALL_BAND,
    GeomsOverFloors,
    find_buildings,
    find_walls,
    is_static,
    match_walls,
    wall_candidates,
)
from navbake.baker.floors.levels import Floors, LevelFloor
from navbake.baker.floors.surfaces import agent_limits
from navbake.baker.gathered import Gathered
from navbake.baker.kernels import contents as kernels
from navbake.baker.kernels.arrays import Probe, StoreyCells
from navbake.baker.kernels.constants import TOUCH
from navbake.baker.kernels.flags import BLOCKS, PROBED, STANDS, UNPROVED
from navbake.baker.kernels.groups import Groups, count_groups, fill_groups
from navbake.baker.lattice import Window
from navbake.baker.occupancy.occupancy import Footprint
from navbake.baker.scene.extents import Extents, measure_geoms
from navbake.baker.scene.scene import Scene
from navbake.config.settings import AgentSettings, NameSettings
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.user_data import Shared, UserData, collector_off
from navbake.threads import run_in_bands
from navbake.types import Bool, Int, Int32


class LevelContents(NamedTuple):
    """The geoms of a storey's cells, ragged: cell i holds ``[start[i], start[i + 1])``.

    Attributes:
        lattice: the whole lattice.
        start: shape (cells + 1,), int64.
        geom: MuJoCo's geom ids, ascending in a cell, shape (n,), int32.
        stands: whether the geom meets the cell's square between floor and ceiling, shape (n,).
        blocks: whether it meets the volume that the occupancy is about, shape (n,), bool.
        upper: whether it stands there and meets the square in `WALL_BAND`, be that above the
            ceiling or not, shape (n,), bool; asked only of `wall_candidates`.
        carrier: the geom whose surface each cell's floor is, shape (cells,), int32, -1 for none.
    """

    lattice: Lattice
    start: Int
    geom: Int32
    stands: Bool
    blocks: Bool
    upper: Bool
    carrier: Int32

    @property
    def cell(self) -> Int:
        """Cell id of each entry, shape (n,), int64."""
        return np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))


@dataclass(frozen=True)
class Contents:
    """What stands in all cells with a floor.

    Attributes:
        levels: the storeys' cells, lowest first.
        kinds: by geom id, OBJECT, WALL, STRUCTURE or BUILDING, shape (ngeom,), uint8.
        names: by geom id, see `name_geoms`.
        warnings: what the user should know, one line each.
    """

    levels: list[LevelContents]
    kinds: NDArray[np.uint8]
    names: list[str]
    warnings: list[str]

    def wall_cells(self, level: int) -> Bool:
        """Mark the cells with a floor that a wall stands in and blocks, on the whole lattice."""
        listed = self.levels[level]
        chosen = self._is_wall(listed) & listed.stands & listed.blocks
        cells = np.zeros(len(listed.start) - 1, dtype=np.bool_)
        kernels.mark_cells(listed.start, chosen, cells)
        return cells.reshape(listed.lattice.shape)

    def low_cells(self, level: int) -> Bool:
        """Mark the cells with a floor that a building's mesh blocks only below `WALL_BAND`."""
        listed = self.levels[level]
        is_building = self.kinds[listed.geom] == BUILDING
        cells = np.zeros(len(listed.start) - 1, dtype=np.bool_)
        if is_building.any():
            cell = listed.cell
            cells[cell[is_building & listed.stands & listed.blocks]] = True
            cells[cell[is_building & listed.stands & listed.upper]] = False
        return cells.reshape(listed.lattice.shape)

    def user_data(self, level: int, window: Window) -> UserData:
        """Name what stands in a storey's cells, as the original client does.

        `objects` are all things but walls and the building's own floors, ceilings and stairs;
        `walls` are the walls; `blockers` are the names of all that blocks the cell, where that
        isn't the same as all of the former. Of what carries a floor, only things are named
        where one stands on them (rugs, pallets). Doors are no part of the contents: see
        `navbake.navgrid.doors.with_door_names`.

        The data is by cell id on the window: sorted names under each key that has any.
        """
        # deferred: it takes a while, and planning and plotting don't need it
        return UserData(partial(self._name_cells, level, window))

    def _name_cells(self, level: int, window: Window) -> Shared:
        return name_contents(self.levels[level], self.kinds, self.names, window)

    def _is_wall(self, listed: LevelContents) -> Bool:
        return is_wall(listed, self.kinds)


def name_contents(
    listed: LevelContents, kinds: NDArray[np.uint8], names: Sequence[str], window: Window
) -> Shared:
    """The user data of a storey's cells, see `Contents.user_data`."""
    kind = kinds[listed.geom]
    bits = np.where(listed.blocks, BLOCKERS, 0)
    bits |= np.where(listed.stands & is_wall(listed, kinds), WALLS, 0)
    bits |= np.where(listed.stands & (kind == OBJECT), OBJECTS, 0)
    carrier = listed.carrier
    below = np.flatnonzero(carrier >= 0)
    below = below[kinds[carrier[below]] == OBJECT]
    cell = np.concatenate([listed.cell, below])
    geom = np.concatenate([listed.geom, carrier[below]])
    bits = np.concatenate([bits, np.full(len(below), OBJECTS)])
    with collector_off():
        return Shared(*name_cells(cell, geom, bits, names, listed.lattice, window))


def is_wall(listed: LevelContents, kinds: NDArray[np.uint8]) -> Bool:
    """Whether each entry of a storey's cells is a wall there."""
    kind = kinds[listed.geom]
    wall: Bool = (kind == WALL) | ((kind == BUILDING) & listed.upper)
    return wall


def classify_geoms(
    scene: Scene,
    extents: Extents,
    over_floors: GeomsOverFloors,
    carriers: Carriers,
    agent: AgentSettings,
    settings: NameSettings,
) -> tuple[NDArray[np.uint8], list[str]]:
    """Tell what each geom is, see `Contents.kinds`; and what the user should know."""
    buildings = find_buildings(scene, extents, over_floors)
    ceilings = find_ceilings(extents, over_floors.base, is_static(scene), agent)
    kinds = np.full(len(scene.geoms), OBJECT, dtype=np.uint8)
    kinds[carriers.building | ceilings] = STRUCTURE
    kinds[find_walls(scene, extents, over_floors, carriers, buildings)] = WALL
    kinds[buildings] = BUILDING
    warnings: list[str] = []
    if settings.walls:  # walls of the settings replace those by shape
        named, warnings = match_walls(scene, settings.walls)
        kinds[kinds == WALL] = OBJECT
        kinds[named] = WALL
    return kinds, warnings


class KnownGeoms(NamedTuple):
    """What is known of geoms before the floors are.

    Attributes:
        extents: boxes round them.
        groups: the triangles over each tile by geom.
    """

    extents: Extents
    groups: Groups

    @classmethod
    def of(cls, scene: Scene, tiled: TiledShapes) -> "KnownGeoms":
        """Of the geoms of a scene, and of its geometry."""
        return cls(measure_geoms(scene.shapes, len(scene.geoms)), group_triangles(tiled))


class ContentsFinder:
    """Lists what stands in every cell with a floor, block by block, and classifies each geom.

    Args:
        scene: without doors, as is what was found in it.
        tiled: its geometry.
        known: what is known of its geoms.
        floors: the storeys.
        agent: who stands there.
    """

    def __init__(
        self,
        scene: Scene,
        tiled: TiledShapes,
        known: KnownGeoms,
        floors: Floors,
        agent: AgentSettings,
    ) -> None:
        self._scene, self._tiled, self._floors, self._agent = scene, tiled, floors, agent
        self._extents = known.extents
        # each storey ends at the next one's ground, the last one at the scene's top [m]
        highest = -np.inf if scene.bounds is None else float(scene.bounds[1, 2])
        tops = [*(level.ground for level in floors.levels[1:]), highest]
        candidates = wall_candidates(scene, self._extents)
        self._levels = [
            _LevelLister(tiled, known.groups, level, top, agent, candidates)
            for level, top in zip(floors.levels, tops, strict=True)
        ]

    def add(self, columns: Columns, occupied: Sequence[Bool]) -> None:
        """List what stands in the cells of a block, of which one knows which are occupied."""
        for level, mask in zip(self._levels, occupied, strict=True):
            level.add(columns, mask)

    def found(self, settings: NameSettings) -> Contents:
        """What stands in all cells, and what each geom is."""
        scene, extents, agent, floors = self._scene, self._extents, self._agent, self._floors
        levels = [level.found() for level in self._levels]
        gaps = [level.gap for level in self._levels]
        carry = [FloorSupport(one.carrier, gap) for one, gap in zip(levels, gaps, strict=True)]
        self._levels.clear()
        step = agent.traversable_floor_height
        carriers = find_carriers(floors, carry, extents, step, self._tiled.lattice)
        over_floors = measure_over_floors(levels, floors, extents)
        kinds, warnings = classify_geoms(scene, extents, over_floors, carriers, agent, settings)
        return Contents(levels, kinds, name_geoms(scene), warnings)


class _LevelLister:
    """Lists the geoms of one storey's cells; a cell's ceiling is never lower than the agent.

    Attributes:
        gap: see `FloorSupport`, of the cells that were looked at.
    """

    def __init__(
        self,
        tiled: TiledShapes,
        groups: Groups,
        level: LevelFloor,
        top: float,
        agent: AgentSettings,
        probed: Bool,
    ) -> None:
        self._tiled, self._groups, self._agent = tiled, groups, agent
        self._floor, self._top = level.floor.ravel(), top
        self._probe = Probe(WALL_BAND[0] + TOUCH, WALL_BAND[1] - TOUCH, probed)
        num_cells = len(self._floor)
        self._start = np.zeros(num_cells + 1, dtype=np.int64)
        self._listed = Gathered(np.empty(0, dtype=np.int32), np.empty(0, dtype=np.uint8))
        self._carrier, self.gap = np.empty(num_cells, dtype=np.int32), np.empty(num_cells)

    def add(self, columns: Columns, occupied: Bool) -> None:
        """List the geoms of the cells of a block; blocks come in the order of their rows."""
        lattice, tiled, floor, groups = columns.lattice, self._tiled, self._floor, self._groups
        shapes, known = tiled.shapes, columns.known_rows
        first, end = known.cells(lattice)
        # arrays of all cells, of which only the pages of these rows are ever touched
        ceiling, slot = np.empty(len(floor)), np.zeros(len(floor) + 1, dtype=np.int64)
        ceiling[first:end] = np.maximum(self._top, floor[first:end] + self._agent.height) - TOUCH
        lists = np.empty(0, dtype=np.int32), np.empty(0, dtype=np.uint8)  # no room yet
        cells = StoreyCells(floor, ceiling, occupied.ravel(), slot, *lists)
        footprint = Footprint.of(self._agent, lattice.cell_size)
        tiles = tiles_of_rows(lattice, known)
        boxes = (lattice, shapes.solids, shapes.planes, tiled.tiles, groups, footprint)
        work = len(tiles), *boxes, cells
        run_in_bands(kernels.count_candidates, *work, begin=tiles.start)
        slots = slot[first : end + 1]
        np.cumsum(slots, out=slots)
        geom, flags = np.empty(slots[-1], dtype=np.int32), np.zeros(slots[-1], dtype=np.uint8)
        cells = cells._replace(geom=geom, flags=flags)
        geometry = ((shapes.solids, tiled.facets, shapes.planes), tiled.tiles, groups)
        asked = lattice, columns.crossings, *geometry, footprint, self._probe, cells
        run_in_bands(kernels.list_geoms, len(tiles), *asked, begin=tiles.start)
        kept = flags > 0
        before = np.zeros(len(kept) + 1, dtype=np.int64)
        np.cumsum(kept, out=before[1:])
        start, flags = before[slots], flags[kept]
        unproved = np.flatnonzero(flags & UNPROVED)
        if len(unproved):  # what FCL found out about the cell decides
            inside = first + np.searchsorted(start, unproved, side="right") - 1
            flags[unproved[occupied.ravel()[inside]]] |= BLOCKS
        self._start[first + 1 : end + 1] = start[1:] + len(self._listed)
        self._listed.add(geom[kept], flags, share=end / len(floor))
        part = slice(first, end)
        support = FloorSupport(self._carrier[part], self.gap[part])
        crossings = columns.crossings._replace(start=columns.start[first : end + 1])
        kernels.describe_floors(floor[part], crossings, agent_limits(self._agent).min_up, support)

    def found(self) -> LevelContents:
        """What stands in the storey's cells."""
        geom, flags = self._listed.take()
        stands, blocks, upper = ((flags & flag) > 0 for flag in (STANDS, BLOCKS, PROBED))
        lattice = self._tiled.lattice
        return LevelContents(lattice, self._start, geom, stands, blocks, upper, self._carrier)


def group_triangles(tiled: TiledShapes) -> Groups:
    """Group the triangles over each tile by geom."""
    known = tiled.facets, tiled.tiles
    start = np.zeros_like(tiled.tiles.triangle_start)
    run_in_bands(count_groups, len(start) - 1, *known, start[1:])
    np.cumsum(start, out=start)
    first = np.full(start[-1] + 1, len(tiled.tiles.triangle_item))
    groups = Groups(start, first, np.empty((start[-1], 6)))
    run_in_bands(fill_groups, len(start) - 1, *known, groups)
    return groups


def measure_over_floors(
    levels: Sequence[LevelContents], floors: Floors, extents: Extents
) -> GeomsOverFloors:
    num = len(extents.low)
    base, rise = np.full(num, np.inf), np.full(num, -np.inf)
    # cells that a geom stands in, and those where it does so in the walls' band, by storey
    cells = np.zeros((2, len(levels), num), dtype=np.int64)
    for listed, level, in_all, in_band in zip(levels, floors.levels, *cells, strict=True):
        floor = level.floor.ravel()
        kernels.measure_over_floors(listed, floor, extents, base, rise, in_all, in_band)
    area, upper_area = cells.max(axis=1) * levels[0].lattice.cell_size ** 2
    return GeomsOverFloors(base, rise, area, upper_area)
