"""Levels and floors: from the surfaces of all columns to the floors of each storey."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from navbake.baker.blocks import Blocks, Rows
from navbake.baker.columns import Columns, ColumnSource
from navbake.baker.floors.enclosed import EnclosedFinder
from navbake.baker.floors.facts import SheetFacts
from navbake.baker.floors.growth import FloorChanges, FloorGrowth
from navbake.baker.floors.kernels.members import count_edges
from navbake.baker.floors.outline import KnownEdges, OccupancyTest, Site, find_cropped
from navbake.baker.floors.patch import Patch, describe_sheets
from navbake.baker.floors.reach import (
    Unreached,
    find_starts,
    find_unreached,
    largest_of_lowest,
)
from navbake.baker.floors.rejected import Changed, Rejected, find_rejected, given_spans
from navbake.baker.floors.sheets import AreaTest, Sheets
from navbake.baker.floors.storeys import Placed, Storeys
from navbake.baker.floors.surfaces import SurfaceStore
from navbake.baker.kernels.arrays import Crossings
from navbake.baker.scene.shapes import Planes, Shapes
from navbake.config.settings import AgentSettings, FloorSettings, LevelSettings
from navbake.errors import SceneError
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int

# A dropped roof is told of when it is this many times as large as the largest floor that is left:
# walls and eaves alone make it larger than the floor under it, but not by a third
LARGE_ROOF = 4 / 3


@dataclass(frozen=True)
class LevelFloor:
    """One storey on the whole lattice.

    Attributes:
        name: as given, or ``level <number>``, lowest first.
        ground: ground height [m].
        floor: floor heights, shape (height, width), float64, NaN for none [m].
        standable: where the floor is a standable surface, shape (height, width), bool.
    """

    name: str
    ground: float
    floor: Float
    standable: Bool


@dataclass(frozen=True)
class Floors:
    """All storeys, lowest first, and where they meet.

    Attributes:
        levels: the storeys.
        links: level a, cell a, level b, cell b, shape (n, 4), int64, cells on the whole lattice:
            each step between two levels, and each pair of neighbours, on one level or two, that
            their slopes join but no step does.
        tops: large tops and shelves that are no floors, the largest first.
        roofs: roofs that are clearly larger than every floor that is left, the largest first.
        small_starts: what `floors.from` names, though it is too small for a floor.
        unreached: what no step leads to, by level, lowest first.
        left_out: floors that `floors.reach: steps` leaves out, the largest first.
        enclosed: floors inside of closed meshes; the geom of each is the mesh's.
    """

    levels: list[LevelFloor]
    links: Int
    tops: list[Patch]
    roofs: list[Patch]
    small_starts: list[Patch]
    unreached: list[Unreached]
    left_out: list[Patch]
    enclosed: list[Patch]


class FloorFinder:
    """Finds the storeys, the floor of each, and the steps between them; keeps them up to date.

    All standable surfaces → the sheets that are large enough → those of them that count, without
    tops, shelves and roofs → their levels → those that are reached → floors, level by level. What
    is local is found block by block, and again where something changed; what is global is merged.

    Args:
        lattice: the cells.
        given: the levels of the configuration, or None to find them.

    Attributes:
        changed: what the last update changed on each level; None where all may be new.
    """

    def __init__(
        self,
        lattice: Lattice,
        agent: AgentSettings,
        settings: FloorSettings,
        given: Sequence[LevelSettings] | None,
    ) -> None:
        self._lattice, self._agent, self._settings, self._given = lattice, agent, settings, given
        self._blocks, self._now = Blocks(lattice), 0
        self._store, self._enclosed = SurfaceStore(lattice, agent), EnclosedFinder(lattice, agent)
        self._sheets = Sheets(self._store, self._blocks, agent)
        self._facts, self._sizes, self._known = SheetFacts(), SheetFacts(), KnownEdges()
        self._last = np.zeros(self._blocks.num, dtype=np.int64)  # the update that changed a block
        nothing = np.empty(0, dtype=np.int64)
        self._seen = Rows(self._blocks.num, np.empty(0, dtype=np.bool_))
        self._edges = Rows(self._blocks.num, nothing, nothing)
        self._cropped: Bool | None = None
        # where what is reached decides, surfaces are placed before and after that
        self._storeys, self._kept_storeys = (
            Storeys(self._sheets, agent, settings) for _ in range(2)
        )
        self._placed_by: Storeys | None = None
        self._growth = FloorGrowth(self._sheets, agent)
        self._stale = self._blocks.all()
        self.changed: list[FloorChanges] | None = None

    def add(self, columns: Columns, planes: Planes) -> None:
        """Take the columns of a block of rows; these come in their order."""
        self._store.add(columns, planes)
        self._enclosed.add(columns, planes)

    def finish(self) -> None:
        """Note that all columns have been added."""
        self._store.finish()

    def replace(self, cells: Int, crossings: Crossings, planes: Planes) -> None:
        """Replace the columns of some cells, ascending; crossings are numbered as these are."""
        changed = self._store.replace(cells, crossings, planes)
        self._enclosed.replace(cells, crossings, planes)
        self._stale |= self._blocks.holding(changed)

    def find(
        self, columns: ColumnSource, shapes: Shapes, is_occupied: OccupancyTest, near: Bool
    ) -> Floors:
        """Find the floors.

        Args:
            columns: as they are now.
            shapes: the geometry that they were cast at.
            near: the blocks near which geometry differs from the last time.

        Raises:
            SceneError: there is no floor at all, none on a given level, or none at a place that one
                starts from.
        """
        self._now += 1
        surfaces, sheets, settings = self._store.surfaces, self._sheets, self._settings
        stale, self._stale = self._stale, np.zeros_like(self._stale)
        enclosed = self._enclosed.found(surfaces, settings)
        sheets.update(stale)
        if not len(sheets.key):
            raise SceneError(_no_floor(self._store, self._agent))
        is_large, drops, changed = self._judge(stale, near)
        cropped = find_cropped(self._lattice, shapes.bounds)
        self._known.begin(self._last, self._now)
        agent = self._agent
        site = Site(sheets, is_large, columns, agent, settings, is_occupied, cropped, self._known)
        if self._cropped is None or not np.array_equal(cropped, self._cropped):
            self._cropped, self._facts = cropped, SheetFacts()
        self._facts.begin(sheets.digest, self._now)
        rejected = find_rejected(site, drops, changed, self._facts, self._given)
        starts = find_starts(site, self._store, rejected, settings.starts)
        counts = is_large & ~rejected.any | starts
        if not counts.any():
            raise SceneError(_no_large_floor(settings))
        placed, left_out, unreached = self._place_reached(columns, counts, starts, stale)
        bars = is_large | starts
        self._growth.update(placed, bars, stale)
        self.changed = self._growth.changed
        return Floors(
            [self._level_floor(k, *level) for k, level in enumerate(self._names(placed))],
            self._growth.links,
            *self._describe(site, rejected, starts, counts),
            unreached=unreached,
            left_out=left_out,
            enclosed=enclosed,
        )

    def _judge(self, stale: Bool, near: Bool) -> tuple[Bool, Int, Changed]:
        """Which sheets are large, how they drop to others, and when what is near them changed.

        Args:
            stale: the blocks with other surfaces.
            near: those with other geometry.
        """
        sheets, blocks, agent = self._sheets, self._blocks, self._agent
        is_large = self._find_large()
        reach = int(np.ceil(self._settings.shrink / self._lattice.cell_size)) + 1
        rows = np.where(is_large, sheets.key, -1)[sheets.of_part]
        other = stale | self._seen.put_all(sheets.labels.count, rows)
        chosen = np.flatnonzero(blocks.around(other, reach))
        counts = sheets.labels.count[chosen]
        offset = np.cumsum(counts) - counts
        edges, drops = np.zeros((2, int(counts.sum())), dtype=np.int64)
        asked = sheets.labelled(is_large), agent.traversable_floor_height, reach, chosen, offset
        run_in_bands(count_edges, len(chosen), *asked, edges, drops)
        self._edges.put(chosen, counts, edges, drops)
        self._last[blocks.around(other | near, reach + 1)] = self._now
        edges, drops = self._edges.take()
        block, last = sheets.labels.block, np.zeros((2, len(is_large)), dtype=np.int64)
        np.maximum.at(last[0], sheets.of_part, self._last[block])
        at_edge = edges > 0
        np.maximum.at(last[1], sheets.of_part[at_edge], self._last[block[at_edge]])
        return is_large, sheets.sum(drops), Changed(last[0], last[1], np.zeros_like(last[0]))

    def _find_large(self) -> Bool:
        """Which sheets are large enough after shrinking."""
        sheets = self._sheets
        least = AreaTest(self._lattice, self._settings).needed
        asked = sheets.size >= least
        never = np.zeros(len(asked), dtype=np.int64)
        self._sizes.begin(sheets.digest, self._now)
        return self._sizes.mask(
            "large", asked, never, lambda some: sheets.left(some, self._settings)
        )

    def _place_reached(
        self, columns: ColumnSource, counted: Bool, starts: Bool, stale: Bool
    ) -> tuple[Placed, list[Patch], list[Unreached]]:
        """Place the surfaces that count on levels; of all, or of those that steps lead to.

        What is reached is decided before levels are given, from the lowest level that there is.

        Returns:
            The surfaces on their levels, the sheets that are left out because no step leads to
            them, and what no step leads to of those that are not.
        """
        sheets, given, settings = self._sheets, self._given, self._settings
        by_steps, patches = settings.reach == "steps", list[Patch]()
        placed, reached, source = None, starts, self._storeys
        if not starts.any() or (given is None and not by_steps):
            placed = self._storeys.update(counted, stale, (), False)
            if not starts.any():
                reached = largest_of_lowest(placed.counts, len(counted))
        else:
            self._storeys.miss(stale)
        for number, span in enumerate(given_spans(given or ())):
            if not (counted & sheets.between(*span)).any():
                raise SceneError(_no_floor_on(given or (), number, columns))
        kept = counted & reached if by_steps else counted
        if given is not None or placed is None or not np.array_equal(kept, counted):
            source = self._kept_storeys
            placed = source.update(kept, stale, given or (), given is not None)
            if not (placed.key >= 0).any():
                raise SceneError(_no_reached(bool(starts.any())))
        else:
            self._kept_storeys.miss(stale)
        if source is not self._placed_by:
            self._placed_by, placed = source, placed._replace(changed=self._blocks.all())
        if by_steps:
            left = counted & ~reached
            patches = describe_sheets(sheets, left, self._facts, given)
        return placed, patches, find_unreached(sheets, placed, reached)

    def _names(self, placed: Placed) -> list[tuple[str, float]]:
        return list(zip(placed.labels, placed.grounds, strict=True))

    def _level_floor(self, k: int, label: str, ground: float) -> LevelFloor:
        floor, ring = self._growth.levels[k]
        shape = self._lattice.shape
        return LevelFloor(label, ground, floor.reshape(shape), (ring == 0).reshape(shape))

    def _describe(
        self, site: Site, rejected: Rejected, starts: Bool, counts: Bool
    ) -> tuple[list[Patch], list[Patch], list[Patch]]:
        """Tops, roofs, and starts that are too small for floors."""
        sheets, facts = self._sheets, self._facts
        is_told = sheets.size > LARGE_ROOF * sheets.size[counts].max()
        return (
            describe_sheets(sheets, (rejected.tops | rejected.shelves) & ~starts, facts),
            describe_sheets(sheets, rejected.roofs & ~starts & is_told, facts),
            describe_sheets(sheets, starts & ~site.is_large, facts),
        )


def find_floors(
    columns: ColumnSource,
    shapes: Shapes,
    agent: AgentSettings,
    settings: FloorSettings,
    given: Sequence[LevelSettings] | None,
    is_occupied: OccupancyTest,
) -> tuple[Floors, FloorFinder]:
    """Find the floors of a scene, and what keeps them up to date; see `FloorFinder`."""
    finder = FloorFinder(columns.lattice, agent, settings, given)
    for block in columns.blocks():
        finder.add(block, shapes.planes)
    finder.finish()
    every = Blocks(columns.lattice).all()
    return finder.find(columns, shapes, is_occupied, every), finder


def _no_floor_on(given: Sequence[LevelSettings], number: int, columns: ColumnSource) -> str:
    level = given[number]
    name = f"level {level.name!r}" if level.name else f"level {number}"
    above = given[number + 1].ground if given[number + 1 :] else np.inf
    top = above if level.top is None else min(above, level.top)
    spans = [(block.z.min(), block.z.max()) for block in columns.blocks() if len(block.z)]
    low, high = float(np.min(spans)), float(np.max(spans))
    return (
        f"no floor on {name} (ground {level.ground:g} m, top {top:g} m) of `levels`: "
        f"the scene's surfaces span {low:g} to {high:g} m"
    )


def _no_reached(has_starts: bool) -> str:
    what = "what `floors.from` names" if has_starts else "the largest floor of the lowest level"
    return f"no floor: {what} lies outside of the `levels`"


def _no_large_floor(settings: FloorSettings) -> str:
    return (
        f"no floor: the largest standable sheet keeps less than {settings.min_area:g} m² "
        f"after shrinking by {settings.shrink:g} m; lower `floors.min_area` or "
        f"`floors.shrink` if it is a floor"
    )


def _no_floor(store: SurfaceStore, agent: AgentSettings) -> str:
    if not store.num_surfaces:
        return "no floor at all: no vertical line through a cell's centre meets a geom"
    if not store.num_floor_like:
        return (
            f"no floor at all: none of {store.num_surfaces} surfaces faces up within "
            f"{agent.max_slope:g}° (a mesh may be inside out, or `scene.up` wrong)"
        )
    return (
        f"no floor at all: none of {store.num_floor_like} surfaces that face up has "
        f"{agent.height:g} m of headroom (a wrong unit, or everything lies inside of a solid: "
        f"`scene.meshes: shell` makes closed meshes hollow)"
    )
