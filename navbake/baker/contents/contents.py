"""What stands in each cell: whether it is occupied, by which geoms, what they are, and their names.

One walk over the cells finds all, block by block, and again for some cells where things move.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.blocks import Blocks
from navbake.baker.columns import Columns, TiledShapes
from navbake.baker.connect import ranges
from navbake.baker.contents.cell_names import BLOCKERS, OBJECTS, WALLS, name_cells, name_geoms
from navbake.baker.contents.kinds import (
    COVERING,
    NEAR_FLOOR,
    THING_HEIGHT,
    WALL_BAND,
    Classified,
    GeomsOverFloors,
    classify_geoms,
    find_carriers,
    find_steps,
    is_static,
    is_surface,
    wall_candidates,
)
from navbake.baker.floors.levels import Floors
from navbake.baker.floors.surfaces import agent_limits
from navbake.baker.kernels import contents as kernels
from navbake.baker.kernels.constants import BUILDING, OBJECT, SLACK, TOUCH, WALL
from navbake.baker.kernels.contents import LevelContents
from navbake.baker.kernels.walk import BLOCKS, PROBED, STANDS, Listing
from navbake.baker.lattice import Window
from navbake.baker.occupancy.occupancy import NO_LISTING, Footprint, Found, Occupancy, look_at_cells
from navbake.baker.scene.extents import Extents, measure_geoms
from navbake.baker.scene.names import find_free_bodies
from navbake.baker.scene.scene import Scene
from navbake.config.settings import AgentSettings, NameSettings
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.user_data import Shared, UserData, collector_off
from navbake.threads import LEAST_CELLS, run_in_bands
from navbake.types import Bool, Float, Int, Int32

# Lists get so many times the room that they are expected to need, and so many where some are
# replaced, as the old ones stay
SPARE, ROOM = 1.1, 2
# How far above its floors the last storey ends, whatever moves at the scene's top [m]
OPEN_ABOVE = 100.0
# Empty columns of `measure_blocks`
NO_MEASURES = np.empty((0, 7), dtype=np.int64), np.empty((0, 2))


@dataclass(frozen=True)
class Contents:
    """What stands in all cells with a floor.

    Attributes:
        levels: the storeys' cells, lowest first.
        kinds: by geom id, OBJECT, WALL, STRUCTURE or BUILDING, shape (ngeom,), uint8.
        partitions: the same for rooms, which walls by shape and panes part whatever their names.
        names: by geom id, see `name_geoms`.
        warnings: what the user should know, one line each.
        taken: how many cells each body with a free joint takes, see `count_taken`; shape
            (nbody,), int64.
    """

    levels: list[LevelContents]
    kinds: NDArray[np.uint8]
    partitions: NDArray[np.uint8]
    names: list[str]
    warnings: list[str]
    taken: Int

    def have_same_walls(self, other: Contents, cells: Int) -> bool:
        """Whether `mark_walls` is the same in contents that differ at most in some cells."""
        same_kinds = np.array_equal(self.partitions, other.partitions)
        asked = cells if same_kinds else None
        levels = range(len(self.levels))
        return all(
            np.array_equal(self.mark_walls(k, asked), other.mark_walls(k, asked)) for k in levels
        )

    def mark_walls(self, level: int, cells: Int | None = None) -> tuple[Bool, Bool]:
        """Mark the cells, all or some, that a wall stands in and blocks.

        Also returns those that a building's mesh blocks only below `WALL_BAND`.
        """
        listed = self.levels[level]
        asked = np.arange(len(listed.first)) if cells is None else cells
        shape = listed.lattice.shape if cells is None else cells.shape
        walls, lows = np.empty((2, len(asked)), dtype=np.bool_)
        known = listed, self.partitions, asked, walls, lows
        run_in_bands(kernels.mark_walls, len(asked), *known, least=LEAST_CELLS)
        return walls.reshape(shape), lows.reshape(shape)

    def user_data(self, level: int, window: Window) -> UserData:
        """Name what stands in a storey's cells, as the original client does.

        `objects` are all things but walls and the building's own floors, ceilings and stairs, also
        those that one stands on (rugs, pallets); `walls` the walls. Both stand, hang or lie between
        the floor and the next storey. `blockers` are what the agent's disc or square meets in its
        band, where these are not the same names. `navbake.navgrid.door_states.with_door_names` adds
        the doors.

        The data is by cell id on the window: sorted names under each key that has any.
        """
        # deferred: planning and plotting don't need it
        return UserData(partial(self._name_cells, level, window))

    def _name_cells(self, level: int, window: Window) -> Shared:
        listed = self.levels[level]
        cell, geom, flags = take_entries(listed, np.arange(len(listed.first)))
        kind, carrier = self.kinds[geom], listed.carrier
        stands, is_upper = (flags & STANDS) > 0, (flags & PROBED) > 0
        is_wall = (kind == WALL) | ((kind == BUILDING) & is_upper)
        bits = np.where(flags & BLOCKS, BLOCKERS, 0)
        bits |= np.where(stands & is_wall, WALLS, 0)
        bits |= np.where(stands & (kind == OBJECT), OBJECTS, 0)
        below = np.flatnonzero(carrier >= 0)
        below = below[self.kinds[carrier[below]] == OBJECT]
        cell = np.concatenate([cell, below])
        geom = np.concatenate([geom, carrier[below]])
        bits = np.concatenate([bits, np.full(len(below), OBJECTS)])
        with collector_off():
            return Shared(*name_cells(cell, geom, bits, self.names, listed.lattice, window))


class CellFinder:
    """Finds what stands in all cells, block by block, and again in some where things move.

    Attributes:
        occupancy: of the cells looked at so far; the others count as open.

    Args:
        scene: the scene without its doors.
        floors: the storeys.
        agent: who stands there.
        extents: of the scene's geoms; None where contents are not asked for.
    """

    def __init__(
        self,
        scene: Scene,
        lattice: Lattice,
        floors: Floors,
        agent: AgentSettings,
        extents: Extents | None,
    ) -> None:
        self._scene, self._floors, self._agent, self._extents = scene, floors, agent, extents
        self._footprint = Footprint.of(agent, lattice.cell_size)
        has_solid = self._footprint.radius > 0.0
        taken = [np.isnan(level.floor) for level in floors.levels]
        solid = [mask.copy() for mask in taken] if has_solid else None
        self.occupancy = Occupancy(taken, 0, 0, solid)
        self._listed: list[LevelContents] = []
        if extents is not None:
            num = lattice.width * lattice.height
            for _ in floors.levels:
                first, carrier = np.zeros(num, dtype=np.int32), np.full(num, -1, dtype=np.int32)
                nothing = np.empty(0, dtype=np.int32), np.empty(0, dtype=np.uint8)
                self._listed.append(
                    LevelContents(lattice, first, *nothing, carrier, np.full(num, np.inf))
                )
            self._judge(scene, extents)
            self._names, self._free_body = name_geoms(scene), find_free_bodies(scene.model)
            self._taken = np.zeros(scene.model.nbody, dtype=np.int64)
        self._used = [0 for _ in self._listed]
        self._blocks = Blocks(lattice)
        self._steps: tuple[Int, Int, Float] | None = None
        self._basis: list[NDArray[Any]] = []  # of what `_classified` is found from
        self._classified: Classified | None = None

    def _judge(self, scene: Scene, extents: Extents) -> None:
        """Mark geoms by their shapes and joints alone; the classes of others follow from these."""
        self._static, self._probed = is_static(scene), wall_candidates(scene, extents)
        self._decisive = self._static | is_surface(scene) | self._probed

    def add(self, columns: Columns, tiled: TiledShapes) -> None:
        """Add the cells of a block; blocks come in the order of their rows."""
        lattice = columns.lattice
        cells = np.arange(*columns.known_rows.cells(lattice))
        self._look(columns, tiled, cells, (int(cells[-1]) + 1) / (lattice.width * lattice.height))

    def look_again(
        self,
        scene: Scene,
        floors: Floors,
        columns: Columns,
        tiled: TiledShapes,
        cells: Int,
        moved: Bool,
        floors_hold: bool,
    ) -> None:
        """Update cells where things moved; earlier results of `found` are not changed.

        Args:
            cells: all near what moved, and all whose column or floor changed, ascending.
            moved: by geom id, whether its geometry changed.
            floors_hold: whether no floor changed its height.
        """
        self._scene, was, self._floors = scene, self._floors, floors
        if not floors_hold or not np.array_equal(was.links, floors.links):
            self._steps = None
        if self._extents is not None:
            new = measure_geoms(scene.shapes.only(moved), len(moved))
            extents = Extents(*(array.copy() for array in self._extents))
            for old, now in zip(extents, new, strict=True):
                old[moved] = now[moved]
            self._extents = extents
            # moving parts count in the body whose size makes a static panel furniture
            self._judge(scene, extents)
            roots = np.asarray(scene.model.body_rootid)[scene.model.geom_bodyid]
            own = np.unique(roots[moved])
            of_moving = self._static & np.isin(roots, own[own > 0])
            if ((self._decisive & moved) | of_moving).any():
                self._basis = []
        self._look(columns, tiled, cells, None)

    def _look(self, columns: Columns, tiled: TiledShapes, cells: Int, share: float | None) -> None:
        """Find what stands in some cells, ascending; `share` as for `_put_lists`."""
        floors, (taken, by_ray, by_fcl, solid) = self._floors, self.occupancy
        # each storey ends at the next one's ground, or else high above its floors [m]
        tops = [*(level.ground for level in floors.levels[1:]), np.inf]
        listing, probed = NO_LISTING, np.empty(0, dtype=np.bool_)
        if self._extents is not None:
            probed = self._probed
        for k, (level, top) in enumerate(zip(floors.levels, tops, strict=True)):
            floor = level.floor.ravel()[cells]
            has_floor = ~np.isnan(floor)
            here, heights = cells[has_floor], floor[has_floor]
            if self._extents is not None:
                num, band = len(here), (WALL_BAND[0] + TOUCH, WALL_BAND[1] - TOUCH)
                first, carrier = np.empty((2, num), dtype=np.int32)
                ceiling = np.minimum(top, heights + OPEN_ABOVE)
                ceiling = np.maximum(ceiling, heights + self._agent.height) - TOUCH
                min_up = agent_limits(self._agent).min_up
                listing = Listing(ceiling, first, carrier, np.empty(num), probed, *band, min_up)
            found = look_at_cells(columns, tiled, self._footprint, here, heights, listing)
            for layers, mask in ((taken, found.occupied), (solid, found.solid)):
                if layers is not None:
                    layer = layers[k].reshape(-1)
                    layer[cells] = True
                    layer[here] = mask
            if share is not None:
                by_ray, by_fcl = by_ray + found.by_ray, by_fcl + found.by_fcl
            if self._extents is not None:
                self._put_lists(k, cells, has_floor, listing, found, share)
        self.occupancy = Occupancy(taken, by_ray, by_fcl, solid)

    def _put_lists(
        self,
        k: int,
        cells: Int,
        has_floor: Bool,
        listing: Listing,
        found: Found,
        share: float | None,
    ) -> None:
        """Put the lists of some cells into a level's contents.

        `share` of all cells are known with these; None for an update, which copies the contents.
        """
        listed, used, num = self._listed[k], self._used[k], len(found.geom)
        carrier, gap = np.full(len(cells), -1, dtype=np.int32), np.full(len(cells), np.inf)
        first = np.zeros(len(cells), dtype=np.int32)
        carrier[has_floor], gap[has_floor] = listing.carrier, listing.gap
        if share is None:
            count_taken(listed, cells, self._free_body, self._taken, -1)
            if not np.array_equal(listed.carrier[cells], carrier):
                self._steps = None
            listed = listed._replace(first=listed.first.copy(), carrier=listed.carrier.copy())
        if used + num > len(listed.geom):
            if share is None:
                listed, used = _compact(listed)
            more = ROOM if share is None else SPARE / share if share < 1.0 else 1.0
            size = int((used + num) * more)
            geom, flags = np.empty(size, dtype=np.int32), np.empty(size, dtype=np.uint8)
            geom[:used], flags[:used] = listed.geom[:used], listed.flags[:used]
            listed = listed._replace(geom=geom, flags=flags)
        listed.geom[used : used + num] = found.geom
        listed.flags[used : used + num] = found.flags
        first[has_floor] = listing.first + np.int32(used)
        listed.first[cells], listed.carrier[cells], listed.gap[cells] = first, carrier, gap
        self._listed[k], self._used[k] = listed, used + num
        count_taken(listed, cells, self._free_body, self._taken, 1)

    def found(self, settings: NameSettings) -> Contents | None:
        """The contents of all cells; None where they are not asked for."""
        extents, floors, scene, agent = self._extents, self._floors, self._scene, self._agent
        if extents is None:
            return None
        over_floors, counts, stood_on = self._measure_levels(extents)
        if self._steps is None:
            carrier = np.stack([level.carrier for level in self._listed])
            self._steps = find_steps(floors, carrier, self._listed[0].lattice)
        cell_size, step = self._listed[0].lattice.cell_size, agent.traversable_floor_height
        carriers = find_carriers(counts, stood_on, cell_size, step, self._steps)
        # geoms are classified again only where their basis has changed, in which it does not matter
        # how deep one reaches under a floor
        static, decisive = self._static, self._decisive
        base = np.maximum(over_floors.base, min(NEAR_FLOOR, agent.height / 2))
        measured = np.stack([base, *over_floors[1:]])[:, decisive]
        basis = [measured, carriers.building, carriers.things[static], carriers.stood_on[static]]
        basis.append(decisive)
        same = len(basis) == len(self._basis) and all(map(np.array_equal, basis, self._basis))
        if not same or self._classified is None:
            known = scene, extents, over_floors, carriers, agent, settings
            self._classified = classify_geoms(*known)
            self._basis = basis
        kinds, partitions, warnings = self._classified
        levels, taken = list(self._listed), self._taken.copy()
        return Contents(levels, kinds, partitions, self._names, warnings, taken)

    def _measure_levels(self, extents: Extents) -> tuple[GeomsOverFloors, Int, Bool]:
        """How geoms stand over floors, and the arguments of `find_carriers`."""
        num, heights = len(extents.low), (extents.low, extents.high)
        base, rise, stood_on = np.full(num, np.inf), np.full(num, -np.inf), np.zeros(num, np.bool_)
        on_floor = np.fmax(extents.high - extents.low + COVERING, THING_HEIGHT) + SLACK
        limits = on_floor, COVERING + SLACK
        counts = np.zeros((len(self._listed), 5, num), dtype=np.int64)
        for k, (listed, level) in enumerate(zip(self._listed, self._floors.levels, strict=True)):
            layers = level.floor.ravel(), level.standable.ravel()
            asked = listed, layers, heights, limits
            _, (rows, over) = self._blocks.list_rows(kernels.measure_blocks, NO_MEASURES, *asked)
            geom = rows[:, 0]
            np.add.at(counts[k].T, geom, rows[:, 1:6])
            stood_on[geom[rows[:, 6] > 0]] = True
            np.minimum.at(base, geom, over[:, 0])
            np.maximum.at(rise, geom, over[:, 1])
        area = counts[:, :2].max(axis=0) * self._listed[0].lattice.cell_size ** 2
        return GeomsOverFloors(base, rise, *area), counts[:, 2:].sum(axis=0), stood_on


def take_entries(listed: LevelContents, cells: Int) -> tuple[Int, Int32, NDArray[np.uint8]]:
    """What stands in some cells, by cell and then geom: places in `cells`, geoms and flags."""
    first, counts = listed.first[cells], np.zeros(len(cells), dtype=np.int64)
    left = np.flatnonzero(listed.geom[first] >= 0)
    while len(left):  # cells whose lists go on
        counts[left] += 1
        left = left[listed.geom[first[left] + counts[left]] >= 0]
    cell, place = ranges(first, first + counts)
    return cell, listed.geom[place], listed.flags[place]


def count_taken(listed: LevelContents, cells: Int, body_of: Int, taken: Int, by: int) -> None:
    """Add `by` to `taken` for each body and each of some cells that it takes.

    A cell that only bodies with a free joint block is taken by each of these; `body_of` each geom
    is -1 for none. So a cup on a table takes none.
    """
    if not (body_of >= 0).any():
        return
    cell, geom, flags = take_entries(listed, cells)
    blocks = (flags & BLOCKS) > 0
    cell, body = cell[blocks], body_of[geom[blocks]]
    is_fixed = np.zeros(len(cells), dtype=np.bool_)
    is_fixed[cell[body < 0]] = True
    free = ~is_fixed[cell]
    pairs = np.unique(cell[free] * len(taken) + body[free])
    taken += by * np.bincount(pairs % len(taken), minlength=len(taken))


def _compact(listed: LevelContents) -> tuple[LevelContents, int]:
    """Contents without the lists that no cell has, and the length of the others."""
    cell, geom, flags = take_entries(listed, np.arange(len(listed.first)))
    is_first = np.diff(cell, prepend=-1) > 0
    # an end before each list but the first, which begins at 1
    place = np.arange(len(cell)) + np.cumsum(is_first)
    size = len(cell) + int(np.count_nonzero(is_first)) + 1
    geoms, marks = np.full(size, -1, dtype=np.int32), np.zeros(size, dtype=np.uint8)
    geoms[place], marks[place] = geom, flags
    first = np.zeros_like(listed.first)
    first[cell[is_first]] = place[is_first]
    return listed._replace(first=first, geom=geoms, flags=marks), size
