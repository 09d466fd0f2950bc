"""What the geoms of a scene are, furniture or walls, kept up to date where things move.

That depends on how large they are, on the cells that they stand in, and on which of them carry
floors. All geoms are told apart again only where something that decides this has changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from navbake.baker.columns import Columns
from navbake.baker.contents.contents import Contents, classify_geoms
from navbake.baker.contents.structure import Carriers, FloorSupport, find_carriers
from navbake.baker.contents.walls import (
    NEAR_FLOOR,
    GeomsOverFloors,
    candidates_of,
    is_static,
    is_surface,
)
from navbake.baker.floors.growth import FloorChanges
from navbake.baker.floors.levels import Floors, LevelFloor
from navbake.baker.floors.surfaces import agent_limits
from navbake.baker.kernels.arrays import Crossings
from navbake.baker.kernels.constants import TOUCH
from navbake.baker.kernels.contents import describe_floors
from navbake.baker.lattice import cells_near
from navbake.baker.occupancy.occupancy import Footprint
from navbake.baker.scene.extents import Extents, measure_geoms
from navbake.baker.scene.scene import Scene
from navbake.baker.update.entries import LiveEntries
from navbake.baker.update.following import boxes_of
from navbake.config.settings import BakeConfig
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Int, Int32


class NearMoved(NamedTuple):
    """What moved, and what is near.

    Attributes:
        scene: as it is now, without doors.
        moved: the geoms whose geometry differs, shape (ngeom,), bool.
        cells: all those near what moved, and all others whose floor changed, ascending.
        crossings: their columns, numbered as these are.
        columns: the same by the cells' ids.
        floors: up to date.
        changes: of the floors, by level.
    """

    scene: Scene
    moved: Bool
    cells: Int
    crossings: Crossings
    columns: Columns
    floors: Floors
    changes: list[FloorChanges]


class LiveKinds:
    """What each geom is, see `Contents.kinds`, and what decides it.

    Attributes:
        kinds: shape (ngeom,), uint8.
        warnings: of telling the geoms apart.
        candidates: the geoms that may be walls, see `candidates_of`.
        supports: by level, what carries the floor in each cell; where that changes, `geom` is a
            new array.
        carried, stood_on: in how many cells each geom carries a floor, and one that can be stood
            on, shape (ngeom,), int64.
    """

    def __init__(
        self,
        config: BakeConfig,
        scene: Scene,
        contents: Contents,
        floors: Floors,
        crossings: Crossings,
        lattice: Lattice,
        entries: Sequence[LiveEntries],
    ) -> None:
        """Take over what a bake found; the scene is without doors."""
        self._config, self._lattice = config, lattice
        self.kinds, self.warnings = contents.kinds, contents.warnings
        self.supports = [self._describe(level, crossings) for level in floors.levels]
        num = len(scene.geoms)
        self._extents = measure_geoms(scene.shapes, num)
        self._is_static = is_static(scene)
        self._reports, self._is_surface = scene.geoms, is_surface(scene)
        self.candidates = candidates_of(self._is_static, self._is_surface, self._extents)
        self._base, self._rise = np.full(num, np.inf), np.full(num, -np.inf)
        # by level, the cells that each geom stands in, and those where it does in the walls' band
        self._cells, self._upper_cells = np.zeros((2, len(floors.levels), num), dtype=np.int64)
        self._carriers, self._links = self._find_carriers(floors), floors.links
        self.carried, self.stood_on = np.zeros((2, num), dtype=np.int64)
        for support, level in zip(self.supports, floors.levels, strict=True):
            self.carried += self._count_by_geom(support.geom)
            self.stood_on += self._count_by_geom(support.geom[level.standable.ravel()])
        self._roots = np.asarray(scene.model.body_rootid)[scene.model.geom_bodyid]
        every, sizes = (
            np.arange(lattice.width * lattice.height),
            (self._extents.low, self._extents.high),
        )
        for k, (listed, level) in enumerate(zip(entries, floors.levels, strict=True)):
            asked = every, level.floor.reshape(-1), sizes, np.ones(num, dtype=np.bool_)
            listed.measure(*asked, self._measured(k))

    def _measured(self, level: int) -> tuple[Float, Float, Int, Int]:
        """What is measured of geoms, where cells are counted on one level."""
        return self._base, self._rise, self._cells[level], self._upper_cells[level]

    def measure_moved(self, scene: Scene, moved: Bool) -> None:
        """Measure the geoms that moved."""
        new = measure_geoms(scene.shapes.only(moved), len(moved))
        extents = Extents(*(array.copy() for array in self._extents))
        for old, now in zip(extents, new, strict=True):
            old[moved] = now[moved]
        self._extents = extents
        if scene.geoms is not self._reports:  # others count, or as something else
            self._reports, self._is_surface = scene.geoms, is_surface(scene)
        self.candidates = candidates_of(self._is_static, self._is_surface, extents)

    def follow(self, near: NearMoved, marked: Bool, listed: Sequence[LiveEntries]) -> bool:
        """Bring all up to date.

        Args:
            marked: the geoms that moved, or whose entries or floors changed.
            listed: up to date.

        Returns:
            Whether all geoms are what they were.
        """
        carried = self._follow_support(near)
        decided = (self._is_static | self._is_surface) & marked
        was = self._decisive(decided)
        self._measure_marked(near.scene, marked, near.floors, listed)
        now = self._decisive(decided)
        as_before = all(np.array_equal(one, other) for one, other in zip(was, now, strict=True))
        if not carried:
            was_carried, self._carriers = self._carriers, self._find_carriers(near.floors)
            carried = _decide_the_same(was_carried, self._carriers, self._is_static)
        if carried and as_before and not self._may_be_others(near.moved):
            return True
        return self._classify(near.scene)

    def _decisive(self, geoms: Bool) -> list[Float | Int]:
        """What was measured of some geoms, as far as it can decide what they are.

        How deep a geom reaches under a floor does not: all that begins so low may be a wall, and
        none of it is a ceiling.
        """
        low = min(NEAR_FLOOR, self._config.agent.height / 2)
        counts = (cells.max(axis=0)[geoms] for cells in (self._cells, self._upper_cells))
        return [np.maximum(self._base[geoms], low), self._rise[geoms], *counts]

    def _measure_marked(
        self, scene: Scene, marked: Bool, floors: Floors, listed: Sequence[LiveEntries]
    ) -> None:
        """Measure geoms again over all cells that they may be in."""
        lattice, agent = self._lattice, self._config.agent
        self._base[marked], self._rise[marked] = np.inf, -np.inf
        self._cells[:, marked] = self._upper_cells[:, marked] = 0
        footprint = Footprint.of(agent, lattice.cell_size)
        reach = max(lattice.cell_size / 2, footprint.reach) + 2 * TOUCH
        boxes, _ = boxes_of(scene.shapes.only(marked))
        cells = cells_near(lattice, boxes, reach)
        sizes = self._extents.low, self._extents.high
        for k, (one, level) in enumerate(zip(listed, floors.levels, strict=True)):
            one.measure(cells, level.floor.reshape(-1), sizes, marked, self._measured(k))

    def _follow_support(self, near: NearMoved) -> bool:
        """Find what carries floors again; whether all that carriers rest on is as it was."""
        cells = near.cells
        min_up, stood_on = agent_limits(self._config.agent).min_up, self.stood_on > 0
        moved = near.moved
        holds = not (self.stood_on[moved].any() or self.carried[moved].any())
        holds &= np.array_equal(self._links, near.floors.links)
        self._links = near.floors.links
        for k, (level, changes) in enumerate(zip(near.floors.levels, near.changes, strict=True)):
            support = FloorSupport(np.empty(len(cells), dtype=np.int32), np.empty(len(cells)))
            floor = level.floor.reshape(-1)[cells]
            describe_floors(floor, near.crossings, min_up, support)
            known = self.supports[k]
            was = known.geom[cells]
            differs = support.geom != was
            is_other = differs | (support.gap != known.gap[cells])
            holds &= not is_other.any() and not len(changes.heights)
            self.carried += self._count_by_geom(support.geom[differs])
            self.carried -= self._count_by_geom(was[differs])
            shifted = np.union1d(cells[differs], changes.standable)
            before = known.geom[shifted]
            if is_other.any():
                geom, gap = known.geom.copy(), known.gap  # no grid has the gaps
                geom[cells], gap[cells] = support.geom, support.gap
                self.supports[k] = FloorSupport(geom, gap)
            stands = level.standable.reshape(-1)[shifted]
            self.stood_on += self._count_by_geom(self.supports[k].geom[shifted][stands])
            stands ^= np.isin(shifted, changes.standable)  # as it was
            self.stood_on -= self._count_by_geom(before[stands])
        return holds and bool(((self.stood_on > 0) == stood_on).all())

    def _count_by_geom(self, carrier: Int32) -> Int:
        """How often each geom is the carrier, -1 for none; shape (ngeom,)."""
        return np.bincount(carrier[carrier >= 0], minlength=len(self._is_static))

    def _describe(self, level: LevelFloor, crossings: Crossings) -> FloorSupport:
        floor = level.floor.ravel()
        support = FloorSupport(np.empty(len(floor), dtype=np.int32), np.empty(len(floor)))
        describe_floors(floor, crossings, agent_limits(self._config.agent).min_up, support)
        return support

    def _find_carriers(self, floors: Floors) -> Carriers:
        step = self._config.agent.traversable_floor_height
        return find_carriers(floors, self.supports, self._extents, step, self._lattice)

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
        size = self._lattice.cell_size**2
        areas = (cells.max(axis=0) * size for cells in (self._cells, self._upper_cells))
        over = GeomsOverFloors(self._base, self._rise, *areas)
        agent, names = self._config.agent, self._config.names
        was = self.kinds
        self.kinds, self.warnings = classify_geoms(
            scene, self._extents, over, self._carriers, agent, names
        )
        return bool((self.kinds == was).all())


def _decide_the_same(one: Carriers, other: Carriers, static: Bool) -> bool:
    """Whether walls and structure are the same with other carriers, see `classify_geoms`.

    What only lies on floors, and what one can stand on, is asked of static geoms alone.
    """
    differs = one.building != other.building
    differs |= static & ((one.things != other.things) | (one.stood_on != other.stood_on))
    return not differs.any()
