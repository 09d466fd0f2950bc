"""Levels and floors: from the surfaces of all columns to the floors of each storey."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from navbake.baker.blocks import BlockAnswers, BlockTable, Seen
from navbake.baker.columns import Columns, ColumnSource
from navbake.baker.floors.growth import FloorGrowth
from navbake.baker.floors.kernels.members import list_edges
from navbake.baker.floors.kernels.surfaces import HELD
from navbake.baker.floors.outline import NO_EDGES, OccupancyTest, Site, find_cropped
from navbake.baker.floors.reach import (
    Unreached,
    UnreachedFloors,
    Upright,
    find_enclosed,
    find_starts,
    find_voids,
    largest_of_lowest,
)
from navbake.baker.floors.rejected import are_told, find_rejected
from navbake.baker.floors.sheets import Patch, SheetFacts, Sheets, area_test
from navbake.baker.floors.storeys import Placed, Storeys, given_spans
from navbake.baker.floors.surfaces import SurfaceStore
from navbake.baker.kernels.constants import SLACK
from navbake.baker.lattice import Window, cut_cells
from navbake.baker.scene.shapes import Planes, Shapes
from navbake.config.settings import AgentSettings, FloorSettings, LevelSettings
from navbake.errors import SceneError
from navbake.types import Bool, Float, Int


@dataclass(frozen=True)
class LevelFloor:
    """One storey on the whole lattice.

    Attributes:
        name: as given, or ``level <number>``, lowest first.
        ground: ground height [m].
        floor: floor heights, shape (height, width), float64, NaN for none [m].
        standable: where the floor is a standable surface, shape (height, width), bool.
        unseen: the part of it that closes a hole, shape (height, width), bool; None where holes
            stay.
    """

    name: str
    ground: float
    floor: Float
    standable: Bool
    unseen: Bool | None = None


@dataclass(frozen=True)
class Floors:
    """All storeys, lowest first, and where they meet.

    Attributes:
        levels: the storeys.
        links: level a, cell a, level b, cell b, shape (n, 4), int64, cells on the whole lattice:
            steps between two levels, and neighbours that slopes join but no step does.
        tops: large tops and shelves that are no floors, the largest first.
        roofs: roofs that a user may miss, the largest first.
        small_starts: floors only because `floors.from` names them.
        unreached: what no step leads to, by level, lowest first.
        left_out: floors that `floors.reach: steps` leaves out, the largest first.
        enclosed, in_planes: floors inside of closed meshes and of infinite planes, whose geoms the
            patches have.
        voids: levels left out as no step reaches them and nobody can stand upright there.
        spare: surfaces left out because all levels of their columns are taken.
    """

    levels: list[LevelFloor]
    links: Int
    tops: list[Patch]
    roofs: list[Patch]
    small_starts: list[Patch]
    unreached: list[Unreached]
    left_out: list[Patch]
    enclosed: list[Patch]
    in_planes: list[Patch]
    voids: list[Patch]
    spare: list[Patch]


class FloorFinder:
    """Finds the storeys, the floor of each, and the steps between them; keeps them up to date.

    Standable surfaces → large sheets → without tops, shelves and roofs → levels → those that are
    reached → floors. Blocks are evaluated again where something changed, and merged.
    """

    def __init__(
        self,
        store: SurfaceStore,
        agent: AgentSettings,
        settings: FloorSettings,
        given: Sequence[LevelSettings] | None,
    ) -> None:
        self._store, self._agent, self._settings, self._given = store, agent, settings, given
        self._spans, self._lattice = given_spans(given or ()), store.lattice
        self._blocks = store.blocks
        self._sheets = Sheets(store, agent)
        # surfaces that closed meshes hold: their sheets, and the floors found there, which may be
        # others where `_held_stale` has any of the blocks with such surfaces
        self._held = Sheets(store, agent)
        self._held_stale, self._has_held = self._blocks.all(), self._blocks.all()
        self._enclosed = list[Patch]()
        self._facts, self._large = SheetFacts(), Seen(self._blocks.num)
        self._edges, self._walls = (
            BlockTable(self._blocks.num, NO_EDGES),
            BlockAnswers(self._blocks.num),
        )
        # the last update in which something changed in or near each block
        self._last = np.zeros(self._blocks.num, dtype=np.int64)
        self._cropped: Bool | None = None
        # for surfaces before and after those that are not reached are left out
        self._storeys, self._kept_storeys = (
            Storeys(self._sheets, agent, settings) for _ in range(2)
        )
        self._placed_by: Storeys | None = None
        self._growth = FloorGrowth(self._sheets, agent)
        self._upright, self._unreached = Upright(self._blocks), UnreachedFloors(self._blocks)
        # how far beyond a sheet's edge floors are looked for; and the blocks with other surfaces
        # than in the last update, and with other columns so near that they matter
        self._reach = int(np.ceil(settings.shrink / self._lattice.cell_size)) + 1
        self._stale, self._near = self._blocks.all(), self._blocks.all()

    @property
    def changed(self) -> Int | None:
        """The cells where the last update changed a floor; None where all may be new."""
        return None if self._settings.fill else self._growth.changed

    def replace(self, cells: Int, columns: Columns, planes: Planes) -> None:
        """Replace the columns of some cells, see `SurfaceStore.replace`."""
        replaced, held = self._store.replace(cells, columns, planes)
        self._stale |= self._blocks.holding(replaced)
        self._near |= self._blocks.near(cells, self._reach + 1)
        self._upright.stale |= self._blocks.holding(cells)
        self._held_stale |= self._blocks.near(replaced, 1)
        self._has_held |= self._blocks.holding(held)

    def find(self, columns: ColumnSource, shapes: Shapes, is_occupied: OccupancyTest) -> Floors:
        """Find the floors in columns, which were cast at shapes.

        Raises:
            SceneError: there is no floor at all, none on a given level, or none at a place that one
                starts from.
        """
        sheets, facts, settings, agent = self._sheets, self._facts, self._settings, self._agent
        sheets.update(self._stale, self._near)
        self._stale, self._near = np.zeros((2, self._blocks.num), dtype=np.bool_)
        if not len(sheets.key):
            raise SceneError(_no_floor(self._store, agent))
        cropped = find_cropped(self._lattice, shapes.bounds)
        if self._cropped is None or not np.array_equal(cropped, self._cropped):
            self._cropped, self._facts = cropped, (facts := SheetFacts())
            self._walls = BlockAnswers(self._blocks.num)
        facts.begin(sheets)
        is_large = facts.mask(
            "large",
            sheets.size >= area_test(self._lattice, settings).needed,
            lambda asked: sheets.left(asked, settings),
        )
        site = Site(
            sheets, is_large, columns, agent, settings, is_occupied, cropped,
            *self._find_edges(is_large), facts, self._walls,
        )  # fmt: skip
        tops, shelves, roofs = find_rejected(site, self._spans)
        starts = find_starts(site, tops, shelves, settings.starts)
        counts = is_large & ~(tops | shelves | roofs) | starts
        if not counts.any():
            raise SceneError(
                f"no floor: the largest standable sheet keeps less than {settings.min_area:g} m² "
                f"after shrinking by {settings.shrink:g} m; lower `floors.min_area` or "
                f"`floors.shrink` if it is a floor"
            )
        placed, left_out, voids, unreached = self._place_reached(site, counts, starts)
        self._growth.update(placed, is_large | starts)
        levels, shape = [], self._lattice.shape
        for name, ground, (floor, ring) in zip(
            placed.labels, placed.grounds, self._growth.levels, strict=True
        ):
            standable = (ring == 0).reshape(shape)
            level = LevelFloor(name, ground, floor.reshape(shape), standable)
            fill = settings.fill / self._lattice.cell_size**2
            levels.append(fill_holes(level, fill, is_occupied) if fill else level)
        held = self._find_enclosed()
        return Floors(
            levels,
            self._growth.links,
            tops=facts.describe((tops | shelves) & ~starts),
            roofs=facts.describe(are_told(site, roofs & ~starts, counts)),
            small_starts=facts.describe(starts & ~is_large),
            unreached=unreached,
            left_out=left_out,
            enclosed=[one for one in held if one.geom not in shapes.planes.geom],
            in_planes=[one for one in held if one.geom in shapes.planes.geom],
            voids=voids,
            spare=placed.spare,
        )

    def _find_enclosed(self) -> list[Patch]:
        """The floors inside of closed meshes, found again where some are or were."""
        if (self._held_stale & self._has_held).any():
            surfaces, held = self._store.surfaces, self._held
            is_held = surfaces.marks & HELD != 0
            self._has_held, self._enclosed = np.zeros_like(self._has_held), []
            if is_held.any():
                key = np.where(is_held, surfaces.geom, np.int32(-1))
                held.update(self._held_stale, self._held_stale, key)
                self._has_held = held.labels.count > 0
                self._held_stale = np.zeros_like(self._has_held)
                self._enclosed = find_enclosed(held, self._agent, self._settings)
        return self._enclosed

    def _find_edges(self, is_large: Bool) -> tuple[tuple[Int, Int], int, Int, Int, Int]:
        """The fields of a `Site` from `edges` to `at_edges`."""
        sheets, blocks, reach = self._sheets, self._blocks, self._reach
        keys = np.where(is_large, sheets.key, -1)[sheets.of_part]
        # the parts of a stale block are numbered anew, so that others may have the same keys
        other = sheets.stale | self._large.differ(sheets.labels.count, keys)
        other = blocks.around(other, reach + 1) | (sheets.last_near == sheets.now)
        lowest = sheets.low[is_large].min(initial=np.inf)
        step = self._agent.traversable_floor_height
        asked = sheets.labelled(is_large), lowest, step, reach
        self._edges.fill(list_edges, np.flatnonzero(other), *asked)
        self._last[other] = sheets.now
        block, (rows,) = self._edges.take()
        last, ends = np.zeros((2, len(is_large)), dtype=np.int64), np.zeros_like(sheets.of_part)
        ends[sheets.labels.offset[block] + rows[:, 0]] = 1
        of_part = self._last[sheets.labels.block]
        np.maximum.at(last[0], sheets.of_part, of_part)
        np.maximum.at(last[1], sheets.of_part, of_part * ends)
        return (block, rows), reach, self._last, last[0], last[1]

    def _place_reached(
        self, site: Site, counted: Bool, starts: Bool
    ) -> tuple[Placed, list[Patch], list[Patch], list[Unreached]]:
        """Place the sheets that count on levels, with `floors.reach: steps` those that are reached.

        Returns the placed surfaces, and `left_out`, `voids` and `unreached` of `Floors`.
        """
        sheets, given, settings = self._sheets, self._given, self._settings
        by_steps, patches = settings.reach == "steps", list[Patch]()
        placed, reached, source = None, starts, self._storeys
        voids = np.zeros_like(counted)
        if not starts.any() or (given is None and not by_steps):
            placed = source.update(counted, ())
            if not starts.any():
                reached = largest_of_lowest(placed.counts, len(counted))
            if given is None and not settings.voids:
                is_given = bool(starts.any())
                reached, voids = find_voids(site, self._upright, placed.counts, reached, is_given)
        for number, span in enumerate(self._spans):
            if not sheets.between(counted, *span).any():
                raise SceneError(_no_floor_on(given or (), number, site.columns))
        kept = counted & reached if by_steps else counted & ~voids
        if given is not None or placed is None or not np.array_equal(kept, counted):
            source = self._kept_storeys
            placed = source.update(kept, given or ())
            if not len(placed.counts):
                what = "the largest floor of the lowest level"
                what = "what `floors.from` names" if starts.any() else what
                raise SceneError(f"no floor: {what} lies outside of the `levels`")
        if source is not self._placed_by:
            self._placed_by, placed = source, placed._replace(changed=self._blocks.all())
        if by_steps:
            patches = self._facts.describe(counted & ~reached, self._spans)
        told = [] if by_steps else self._facts.describe(voids)
        return placed, patches, told, self._unreached.find(sheets, placed, reached)


def find_floors(
    columns: ColumnSource,
    shapes: Shapes,
    agent: AgentSettings,
    settings: FloorSettings,
    given: Sequence[LevelSettings] | None,
    is_occupied: OccupancyTest,
) -> tuple[Floors, FloorFinder]:
    """Find the floors of a scene; returns also the finder that keeps them up to date."""
    store = SurfaceStore(columns.lattice, agent)
    for block in columns.blocks():
        store.add(block, shapes.planes)
    store.finish()
    finder = FloorFinder(store, agent, settings, given)
    return finder.find(columns, shapes, is_occupied), finder


def fill_holes(level: LevelFloor, largest: float, is_occupied: OccupancyTest) -> LevelFloor:
    """Close the holes of a floor that floor surrounds, up to `largest` cells each.

    Heights there are interpolated from those round the hole (linearly, over Delaunay's triangles).
    Holes that nobody gets to from the floor, such as the inside of a pillar, stay.
    """
    from scipy.interpolate import griddata  # scipy loads slowly, and few ask for this
    from scipy.ndimage import binary_dilation, label  # likewise

    holes, _ = label(np.isnan(level.floor))  # by their edges
    size = np.bincount(holes.ravel())
    for edge in (holes[0], holes[-1], holes[:, 0], holes[:, -1]):
        size[edge] = holes.size + 1
    size[0] = holes.size + 1
    unseen: Bool = (size <= largest + SLACK)[holes]
    if not unseen.any():
        return replace(level, unseen=unseen)
    near = binary_dilation(unseen, np.ones((3, 3)))
    rim, floor = near & ~unseen & ~np.isnan(level.floor), level.floor.copy()
    floor[unseen] = griddata(np.argwhere(rim), floor[rim], np.argwhere(unseen))
    near &= ~np.isnan(floor)
    free = near.copy()
    free[near] = ~is_occupied(np.flatnonzero(near), floor[near], None)
    # free cells connected to floor that was seen, and things that stand in such a hole
    open_part, _ = label(free)
    reached = free & np.isin(open_part, open_part[free & rim])
    unseen &= reached | (np.isin(holes, holes[reached & unseen]) & ~free)
    floor[~unseen & (holes > 0)] = np.nan
    return replace(level, floor=floor, standable=level.standable | unseen, unseen=unseen)


def crop_floors(floors: Floors, window: Window) -> Floors:
    """Cut a window out of the floors of a whole scene; patches and parts beside it are left out.

    Levels without a standable surface in the window are left out.

    Raises:
        SceneError: no floor lies in the window.
    """
    shown = [k for k, level in enumerate(floors.levels) if level.standable[window].any()]
    if not shown:
        raise SceneError("no floor lies inside of `grid.bounds`")
    number = np.full(len(floors.levels), -1, dtype=np.int64)
    number[shown] = np.arange(len(shown))
    levels = []
    for new, old in enumerate(shown):
        level = floors.levels[old]
        name = f"level {new}" if level.name == f"level {old}" else level.name
        floor, standable = level.floor[window].copy(), level.standable[window].copy()
        unseen = None if level.unseen is None else level.unseen[window].copy()
        levels.append(LevelFloor(name, level.ground, floor, standable, unseen))
    width = floors.levels[0].floor.shape[1]

    def is_shown(patch: Patch) -> bool:
        return bool(cut_cells(patch.cells.astype(np.int64), window, width)[1].any())

    links = floors.links
    kept = (number[links[:, 0]] >= 0) & (number[links[:, 2]] >= 0)
    for cell in (1, 3):
        kept &= cut_cells(links[:, cell], window, width)[1]
    links = links[kept]
    for on, cell in ((0, 1), (2, 3)):
        links[:, on] = number[links[:, on]]
        links[:, cell] = cut_cells(links[:, cell], window, width)[0]
    unreached = [
        replace(part, level=int(number[part.level]))
        for part in floors.unreached
        if number[part.level] >= 0 and is_shown(part.patch)
    ]
    told = "tops", "roofs", "small_starts", "left_out", "enclosed", "in_planes", "voids", "spare"
    patches = {name: list(filter(is_shown, getattr(floors, name))) for name in told}
    return Floors(levels=levels, links=links, unreached=unreached, **patches)


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
