"""Checks of cells: of their state, free or blocked, and of their floors.

Each floor has to be a surface of the scene. The grid must not lack a place to stand on, nor a whole
level.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from navbake.config.settings import BakeConfig, FloorSettings
from navbake.navgrid.grid import GridBase
from navbake.types import Bool, Float, Int, Vector3
from navbake.verifier import report
from navbake.verifier.obstacles import ENCLOSING_KINDS, PlacedShape
from navbake.verifier.probes import (
    CIRCLE_DIRECTIONS,
    DISPUTED,
    EDGE_TOLERANCE,
    MAX_MEASURED_GAP,
    MIN_UPWARD_NORMAL_Z,
    TOUCHES,
    ObstacleProbe,
    SurfaceHit,
    VerticalLine,
)
from navbake.verifier.report import Finding, LevelCounts
from navbake.verifier.ridges import RidgeProbe
from navbake.verifier.sample import AgentSizes, CellPrisms, LevelSample, find_cell_shift

MAX_MEASURED_FINDINGS = 100  # findings of a kind whose depth or gap is measured

# a floor may be this far above or below a surface [m], plus this share of its largest coordinate,
# as floors are float32
FLOOR_TOLERANCE = 1e-4
FLOOR_TOLERANCE_SHARE = 1e-6
NORMAL_Z_MARGIN = 1e-5  # excess over the least z of a normal that makes a floor certain

GRID_DIRECTIONS = ((-1, 0), (1, 0), (0, -1), (0, 1))  # row and column to the neighboring cells
PROBE_DIRECTIONS = CIRCLE_DIRECTIONS[1::4]  # four, along none of the axes

SEARCH_STRIDE = 0.15  # distance between the places of a search, rounded to whole cells [m]
MAX_SEARCH_PLACES = 20_000  # largest number of places of one search
# A region that no level has counts as a missing level if it is clearly as large as a floor, if more
# than half of its outline are walls, and if only a small share of the outline are drops (the top of
# a table has drops all round). A ground may lie over a cellar or a pipe, up to some share.
LARGE_AREA_FACTOR = 1.25  # least area of such a region, relative to the least area of a floor
# least area of such a region: a few rays can't tell a smaller ground from the top of a thing [m²]
MIN_LEVEL_AREA = 1.0
MIN_WALL_SHARE = 0.5  # least share of the outline that walls have to be
MAX_DROP_SHARE = 0.2  # largest share of the outline that drops may be
# largest share of a ground's area that may lie over other places to stand; from 0.1 on, a bake may
# take the ground for a roof
MAX_COVERED_SHARE = 0.075
MIN_WALL_HEIGHT = 1.5  # parapets are lower than walls [m]
MIN_REACHED_AREA = 3.0  # area of the grid's floors that steps from a region have to lead to [m²]


class StandingPlace(NamedTuple):
    """A surface that an agent can stand on, at the centre of a cell.

    Attributes:
        row: Row of the cell on the lowest level's lattice; the cell may lie outside the grid.
        col: Column of the cell.
        surface_index: Index among the surfaces to stand on in the cell's column, 0 for the lowest.
    """

    row: int
    col: int
    surface_index: int


class OutlineEdge(NamedTuple):
    """One side of a place at the edge of a region; beyond it is a wall, a drop or nothing.

    Attributes:
        is_wall: Whether a wall stands beyond it.
        landing: The highest place to stand below a drop; None for a wall, or if there is none.
    """

    is_wall: bool
    landing: StandingPlace | None


class RegionSearch(NamedTuple):
    """A region that a search found: places to stand, connected by steps, that are on no level.

    Attributes:
        places: The places of the region.
        is_reached: Whether steps lead from the grid's floors to the region.
        outline: The edges of the region.
    """

    places: set[StandingPlace]
    is_reached: bool
    outline: list[OutlineEdge]


class LevelCell(NamedTuple):
    """A cell of a level: the height of its floor [m], NaN for none, and whether it is free."""

    floor: float
    is_free: bool


class LevelArrays(NamedTuple):
    """A level's floors, and the shift from rows and columns of level 0's lattice to the level's.

    Attributes:
        floor: Heights of the floors, (height, width) [m], NaN for none.
        is_free: Whether each cell is free, (height, width).
        row_shift: How much larger a cell's row is on this level than on level 0's lattice.
        col_shift: How much larger a cell's column is on this level than on level 0's lattice.
    """

    floor: Float
    is_free: Bool
    row_shift: int
    col_shift: int


def compute_floor_tolerance(*coordinates: float) -> float:
    """Return the largest difference of height at which a floor still lies on a surface [m].

    Args:
        coordinates: World coordinates of the place [m]; far from the origin, rounding is coarser.
    """
    return FLOOR_TOLERANCE + FLOOR_TOLERANCE_SHARE * max(map(abs, coordinates))


class FloorCheck:
    """Checks floors by MuJoCo's rays, and searches for places to stand that no level has.

    Places that steps connect form a region. A region that no level has is a fault in two cases:

    - Steps lead to it from the grid's floors.
    - It is as large as a floor, has few drops at its outline, and either is mostly surrounded by
      walls (so it is a level), or has hardly a place to stand below it (so it is a ground). This
      counts only if the settings of the bake leave no floors out, or if the grid has no floor.

    Any other region may be the top of furniture, a shelf or a roof, and is ignored. Ridges are no
    places to stand, see `RidgeProbe`.

    Rows and columns of cells refer to the lowest level's lattice. Cells may lie outside it.

    Args:
        grid: The inflated grid.
        probe: The obstacles that can carry floors.
        agent: The agent that the grid was baked for.
        config: The settings of the bake; None if they are unknown.

    Attributes:
        num_ignored_regions: The number of regions that were ignored so far.
        ignored_area: The area of the ignored regions [m²].
    """

    def __init__(
        self, grid: GridBase, probe: ObstacleProbe, agent: AgentSizes, config: BakeConfig | None
    ) -> None:
        self._agent = agent
        self._probe = probe
        self._settings = FloorSettings() if config is None else config.floors
        self._lattice = grid.levels[0].lattice
        self._levels = list[LevelArrays]()
        for level in grid.levels:
            cell_shift = find_cell_shift(self._lattice, level.lattice)
            self._levels.append(
                LevelArrays(level.floor, level.free, cell_shift.rows, cell_shift.cols)
            )
        bakes_all_floors = (
            config is not None and config.levels == "auto" and config.floors.reach == "all"
        )
        has_no_floor = all(np.isnan(level.floor).all() for level in self._levels)
        self._reports_unreached = bakes_all_floors or has_no_floor
        self._stride = max(1, round(SEARCH_STRIDE / self._lattice.cell_size))
        self._stride_length = self._stride * self._lattice.cell_size
        self._searched_places = set[StandingPlace]()
        self._lost_places = set[StandingPlace]()
        self.num_ignored_regions = 0
        self.ignored_area = 0.0
        self._line_at = lru_cache(200_000)(
            lambda row, col: probe.cast_line(*self._center(row, col))
        )
        self._all_standable_at = lru_cache(200_000)(
            lambda row, col: self._line_at(row, col).find_standable_hits(
                agent.height, agent.min_normal_z
            )
        )
        self._ridges = RidgeProbe(
            probe, agent, self._lattice, self._line_at, self._all_standable_at
        )
        # the same by lines slightly beside the cells' centres
        self._ridges_beside = [
            self._make_ridge_probe(EDGE_TOLERANCE * cos, EDGE_TOLERANCE * sin)
            for cos, sin in PROBE_DIRECTIONS
        ]
        self._standable_at = lru_cache(200_000)(self._find_standable)

    def _make_ridge_probe(self, x_offset: float, y_offset: float) -> RidgeProbe:
        """Return a probe of ridges whose lines run beside the cells' centres, at an offset [m]."""

        @lru_cache(200_000)
        def line_at(row: int, col: int) -> VerticalLine:
            x, y = self._center(row, col)
            return self._probe.cast_line(x + x_offset, y + y_offset)

        def standable_at(row: int, col: int) -> list[SurfaceHit]:
            return line_at(row, col).find_standable_hits(
                self._agent.height, self._agent.min_normal_z
            )

        return RidgeProbe(self._probe, self._agent, self._lattice, line_at, standable_at)

    def _find_standable(self, row: int, col: int) -> list[SurfaceHit]:
        """Return the surfaces to stand on in a cell, lowest first, that are on no ridges."""
        hits = self._all_standable_at(row, col)
        if self._settings.tops:
            return hits
        return [hit for hit in hits if not self._ridges.is_ridge(row, col, hit.z)]

    def check(self, sample: LevelSample, counts: LevelCounts) -> list[Finding]:
        """Check the floors of a level, and search for places to stand that no level has.

        A floor may lie inside a solid, as things lower than a step block nothing. No places to
        stand are looked for in cells whose floor is wrong, or whose surface is only beside the
        cell's centre.

        Args:
            sample: The cells of the level.
            counts: The level's counts, which the check adds to.

        Returns:
            A finding for each wrong floor, and one for each faulty region that was first found in
            one of these cells.
        """
        findings = list[Finding]()
        lattice_shift = find_cell_shift(sample.level.lattice, self._lattice)
        missing_places: list[tuple[int, int, float]] = []  # row, column, height
        # the grid's floors over holes of a scan are no surfaces
        is_unseen = sample.level.attributes.get("unseen", np.zeros(sample.level.shape))
        for cell, has_no_floor in enumerate(np.isnan(sample.floor).tolist()):
            position = sample.position(cell)
            x, y, z = position
            row = int(sample.rows[cell]) + lattice_shift.rows
            col = int(sample.cols[cell]) + lattice_shift.cols
            # the line of the lattice's cell, unless its centre is rounded otherwise
            if self._center(row, col) == (x, y):
                vertical_line = self._line_at(row, col)
                standable_hits = self._all_standable_at(row, col)
            else:
                vertical_line = self._probe.cast_line(x, y)
                standable_hits = vertical_line.find_standable_hits(
                    self._agent.height, self._agent.min_normal_z
                )
            tolerance = compute_floor_tolerance(x, y, z)
            if not has_no_floor:
                counts.floors += 1
            is_unchecked = has_no_floor or bool(is_unseen[sample.rows[cell], sample.cols[cell]])
            if is_unchecked or vertical_line.has_upward_hit(z - tolerance, z + tolerance):
                for hit in standable_hits:
                    is_missing = not self._has_floor(row, col, hit.z)
                    if is_missing and self._place_near(row, col, hit.z) is not None:
                        missing_places.append((row, col, hit.z))
                        findings += self._check_missing_place(row, col, (x, y, hit.z), sample, cell)
                continue
            # at the edge of a crack, a floor on a slope may have any of the slope's heights
            is_far_from_surfaces = all(abs(hit.z - z) > self._agent.step for hit in standable_hits)
            has_surface_nearby = self._probe.has_upward_hit_nearby(
                position,
                tolerance,
                self._settings.crack,
                min_normal_z=self._agent.min_normal_z if is_far_from_surfaces else np.inf,
            )
            if has_surface_nearby:
                counts.in_cracks += 1
            else:
                counts.floors_off += 1
                findings.append(self._floor_off_finding(sample, cell, z, vertical_line.hits))
        for row, col, z in missing_places:
            # the place itself is lost, or the one near it where a search began
            search_start_cell = (row - row % self._stride, col - col % self._stride)
            counts.lost += any(
                self._place_near(*row_col, z) in self._lost_places
                for row_col in ((row, col), search_start_cell)
            )
        return findings

    def _floor_off_finding(
        self, sample: LevelSample, cell: int, z: float, hits: list[SurfaceHit]
    ) -> Finding:
        """Return the finding for a floor where no surface is."""
        surface_gaps = [abs(hit.z - z) for hit in hits if hit.normal_z >= MIN_UPWARD_NORMAL_Z]
        smallest_gap = min(surface_gaps, default=None)
        if smallest_gap is None:
            surface_text = "over no surface"
        else:
            surface_text = f"{smallest_gap:.4f} m off the nearest surface"
        text = f"has its floor at {z:.4f} m, {surface_text}"
        return sample.make_finding(report.FLOOR_OFF, cell, text, None, smallest_gap)

    def _check_missing_place(
        self, row: int, col: int, position: Vector3, sample: LevelSample, cell: int
    ) -> list[Finding]:
        """Search the region of a place that no level has; return its finding if it is a fault.

        If the place is a step from a free cell, the search starts at the place itself. Otherwise it
        starts at the nearest place of a coarse grid, with a place every `SEARCH_STRIDE`. It is
        skipped if the region has been searched already, or is narrow like the top of furniture.
        """
        is_step = self._is_step_from_free_cell(row, col, position[2])
        is_step = is_step and self._is_certain(*position)
        is_step = is_step and not self._might_be_ridge(row, col, position[2])
        if not is_step:
            row = row - row % self._stride
            col = col - col % self._stride
        start_place = self._place_near(row, col, position[2])
        if start_place is None:
            return []
        start_hit = self._standable_at(row, col)[start_place.surface_index]
        x, y = self._center(row, col)
        standing_position = (x, y, start_hit.z)
        if not is_step:
            if start_place in self._searched_places or self._has_floor(row, col, start_hit.z):
                return []
            two_strides = 2 * self._stride
            neighbor_places = [
                self._place_near(
                    row + two_strides * row_offset, col + two_strides * col_offset, start_hit.z
                )
                for row_offset, col_offset in GRID_DIRECTIONS
            ]
            if neighbor_places.count(None) >= 2:
                return []
            if not self._is_certain(x, y, start_hit.z):
                return []

        region = self._search_region(start_place)
        self._searched_places |= region.places
        area = len({(place.row, place.col) for place in region.places}) * self._stride_length**2
        reason = "steps lead there" if region.is_reached else self._reason_for_level(region)
        if not reason:
            self.num_ignored_regions += 1
            self.ignored_area += area
            return []
        self._lost_places |= region.places
        geom = self._probe.obstacles.geom_name(start_hit.obstacle)
        text = f"on {geom!r}, {area:.2f} m² or more are on no level, and {reason}"
        finding = sample.make_finding(report.PLACE_LOST, cell, text, geom, round(area, 6))
        return [replace(finding, position=standing_position)]

    def _is_step_from_free_cell(self, row: int, col: int, z: float) -> bool:
        """Return whether the floor of a free neighbour cell is a surface at most a step away."""
        max_step = self._agent.step - FLOOR_TOLERANCE
        for row_offset, col_offset in GRID_DIRECTIONS:
            for level_cell in self._level_cells_at(row + row_offset, col + col_offset):
                floor = level_cell.floor
                if not level_cell.is_free or not abs(floor - z) <= max_step:
                    continue
                hits = self._standable_at(row + row_offset, col + col_offset)
                if any(abs(hit.z - floor) <= compute_floor_tolerance(floor) for hit in hits):
                    return True
        return False

    def _reason_for_level(self, region: RegionSearch) -> str:
        """Say why a region that no steps lead to is a level or a ground; empty if it is neither."""
        cells = {(place.row, place.col) for place in region.places}
        # floors are shrunk: only cells that are farther from the outline count
        num_strides = int(self._settings.shrink / self._stride_length) + 1
        cell_offsets = [
            multiple * self._stride for multiple in range(-num_strides, num_strides + 1)
        ]
        cell_offset_pairs = list(product(cell_offsets, cell_offsets))
        num_inner_cells = sum(
            all(
                (row + row_offset, col + col_offset) in cells
                for row_offset, col_offset in cell_offset_pairs
            )
            for row, col in cells
        )
        # a drop to the region itself, such as beside its own stairs, does not count
        num_drops = sum(
            edge.landing is not None and edge.landing not in region.places
            for edge in region.outline
        )
        least_area = max(LARGE_AREA_FACTOR * self._settings.min_area, MIN_LEVEL_AREA)
        is_large = num_inner_cells * self._stride_length**2 >= least_area
        has_few_drops = num_drops <= MAX_DROP_SHARE * len(region.outline)
        if not (is_large and self._reports_unreached and has_few_drops):
            return ""
        num_walls = sum(edge.is_wall for edge in region.outline)
        if num_walls > MIN_WALL_SHARE * len(region.outline):
            return "it has walls all round"
        cells_over_others = {
            (place.row, place.col)
            for place in region.places
            if any(
                place._replace(surface_index=lower_index) not in region.places
                for lower_index in range(place.surface_index)
            )
        }
        if len(cells_over_others) <= MAX_COVERED_SHARE * len(cells):
            return "there is nothing to stand on under it"
        return ""

    def _search_region(self, start_place: StandingPlace) -> RegionSearch:
        """Search breadth first over places that are a step apart, from one that no level has.

        The search continues over places that levels have, too. It ends early once their area
        reaches `MIN_REACHED_AREA`: then steps lead from the grid's floors to the region.
        """
        lost_places = {start_place}
        places_on_levels = set[StandingPlace]()
        queued_places = deque([start_place])
        outline = list[OutlineEdge]()
        is_reached = False
        while queued_places and len(lost_places) < MAX_SEARCH_PLACES and not is_reached:
            place = queued_places.popleft()
            z = self._standable_at(place.row, place.col)[place.surface_index].z
            for row_offset, col_offset in GRID_DIRECTIONS:
                row = place.row + row_offset * self._stride
                col = place.col + col_offset * self._stride
                # the floors outside the grid are unknown: the search ends there
                neighbor_place = (
                    self._place_near(row, col, z) if self._is_on_grid(row, col) else None
                )
                if neighbor_place is None:
                    if place in lost_places:
                        outline.append(
                            self._find_edge(place.row, place.col, row_offset, col_offset, z)
                        )
                    continue
                if neighbor_place in lost_places or neighbor_place in places_on_levels:
                    continue
                neighbor_z = self._standable_at(row, col)[neighbor_place.surface_index].z
                if not self._has_floor(row, col, neighbor_z):
                    lost_places.add(neighbor_place)
                elif place in lost_places and not self._is_walkable(
                    place.row, place.col, row_offset, col_offset, z
                ):
                    outline.append(self._find_edge(place.row, place.col, row_offset, col_offset, z))
                    continue
                else:
                    places_on_levels.add(neighbor_place)
                    reached_area = len(places_on_levels) * self._stride_length**2
                    is_reached = reached_area >= MIN_REACHED_AREA
                queued_places.append(neighbor_place)
        return RegionSearch(lost_places, is_reached, outline)

    def _is_walkable(self, row: int, col: int, row_offset: int, col_offset: int, z: float) -> bool:
        """Return whether an agent can walk a stride from cell to cell, starting at height z [m].

        Args:
            row: Row of the first cell.
            col: Column of the first cell.
            row_offset: Row offset of each next cell.
            col_offset: Column offset of each next cell.
            z: Height of the floor in the first cell [m].
        """
        for num_cells in range(1, self._stride + 1):
            next_row = row + num_cells * row_offset
            next_col = col + num_cells * col_offset
            place = self._place_near(next_row, next_col, z)
            if place is None:
                return False
            z = self._standable_at(next_row, next_col)[place.surface_index].z
        return True

    def _find_edge(
        self, row: int, col: int, row_offset: int, col_offset: int, z: float
    ) -> OutlineEdge:
        """Find what lies beyond one side of a place at the edge of a region.

        Args:
            row: Row of the place.
            col: Column of the place.
            row_offset: Row offset towards that side.
            col_offset: Column offset towards that side.
            z: Height of the place [m].
        """
        max_wall_bottom = z + self._agent.step
        min_wall_top = z + max(self._agent.height, MIN_WALL_HEIGHT)
        for _ in range(self._stride):
            row = row + row_offset
            col = col + col_offset
            solid_ranges = self._line_at(row, col).solid_ranges
            if any(bottom < max_wall_bottom and top > min_wall_top for bottom, top in solid_ranges):
                return OutlineEdge(is_wall=True, landing=None)
        num_surfaces_below = sum(hit.z < z for hit in self._standable_at(row, col))
        landing = StandingPlace(row, col, num_surfaces_below - 1) if num_surfaces_below else None
        return OutlineEdge(is_wall=False, landing=landing)

    def _place_near(self, row: int, col: int, z: float) -> StandingPlace | None:
        """Return the place in a cell that is nearest to a height [m]; None if over a step away."""
        height_gaps = [abs(hit.z - z) for hit in self._standable_at(row, col)]
        smallest_gap = min(height_gaps, default=np.inf)
        if smallest_gap > self._agent.step - FLOOR_TOLERANCE:
            return None
        return StandingPlace(row, col, height_gaps.index(smallest_gap))

    def _has_floor(self, row: int, col: int, z: float) -> bool:
        """Return whether any level has a floor in a cell at a height [m]."""
        return any(
            abs(z - floor) <= compute_floor_tolerance(floor)
            for floor, _ in self._level_cells_at(row, col)
        )

    def _is_on_grid(self, row: int, col: int) -> bool:
        """Return whether any level has a cell at a row and column."""
        for level in self._levels:
            num_rows, num_cols = level.floor.shape
            if 0 <= row + level.row_shift < num_rows and 0 <= col + level.col_shift < num_cols:
                return True
        return False

    def _level_cells_at(self, row: int, col: int) -> list[LevelCell]:
        """Return the cells at a row and column, of all levels that have one there."""
        cells = []
        for level in self._levels:
            level_row = row + level.row_shift
            level_col = col + level.col_shift
            if 0 <= level_row < len(level.floor) and 0 <= level_col < level.floor.shape[1]:
                floor = float(level.floor[level_row, level_col])
                cells.append(LevelCell(floor, bool(level.is_free[level_row, level_col])))
        return cells

    def _center(self, row: int, col: int) -> tuple[float, float]:
        """Return world x and y of a cell's centre [m]."""
        lattice = self._lattice
        x = lattice.x_min + (col + 0.5) * lattice.cell_size
        y = lattice.y_max - (row + 0.5) * lattice.cell_size
        return x, y

    def _is_certain(self, x: float, y: float, z: float) -> bool:
        """Return whether a position is a place to stand without any doubt.

        It must be one slightly beside its centre, too, and for an agent with slightly stricter
        limits: at the edge of a surface, or at a limit, rounding decides.
        """
        for cos, sin in PROBE_DIRECTIONS:
            vertical_line = self._probe.cast_line(
                x + EDGE_TOLERANCE * cos, y + EDGE_TOLERANCE * sin
            )
            standable_hits = vertical_line.find_standable_hits(
                self._agent.height + FLOOR_TOLERANCE, self._agent.min_normal_z + NORMAL_Z_MARGIN
            )
            if not any(abs(hit.z - z) <= FLOOR_TOLERANCE for hit in standable_hits):
                return False
        return True

    def _might_be_ridge(self, row: int, col: int, z: float) -> bool:
        """Return whether a place to stand is a ridge by any lines slightly beside the centres.

        Where a tread ends on the line through a cell's centre, rounding decides whether a step
        leads from there to the top of a wall.
        """
        if self._settings.tops:
            return False
        return any(ridges.is_ridge(row, col, z) for ridges in self._ridges_beside)


class CellContacts(NamedTuple):
    """The obstacles that the prisms over the cells of a sample touch.

    Attributes:
        obstacle_of_cell: The id of an obstacle that a prism touches, (n,); -1 for none.
        prism_of_cell: For a cell with such an obstacle, which of the prisms over it touches the
            obstacle: its index in the list of `CellPrisms`, (n,); 0 for other cells.
        is_disputed: Whether MuJoCo and FCL contradict each other, (n,).
    """

    obstacle_of_cell: Int
    prism_of_cell: Int
    is_disputed: Bool


class CellCrossing(NamedTuple):
    """How often the vertical ray up from a cell's volume crosses an obstacle's surface.

    Attributes:
        obstacle: The obstacle's id.
        cell: The cell's index in the sample.
        num_exits: How often the ray leaves the volume that the surface encloses.
        num_entries: How often the ray enters that volume.
    """

    obstacle: int
    cell: int
    num_exits: int
    num_entries: int


class OccupancyCheck:
    """Checks whether cells are free or blocked as the grid says.

    The volume over a free cell, shrunk by the tolerance on all sides, must touch nothing and lie
    inside of nothing. The volume over a blocked cell, enlarged by the tolerance, must touch
    something or lie inside of something.

    Args:
        probe: The obstacles.
        agent: The agent that the grid was baked for.
        tolerance: The tolerance [m].
        inflation_reach: The largest distance from a cell's centre at which an inflation looked for
            a reason to block the cell [m]; 0 for a grid that is not inflated.

    Attributes:
        num_cells_without_ground: How many blocked cells touch nothing, but may be blocked all the
            same, because nobody can stand there within a step of the level's ground; counted only
            on levels that state no floors of cells.
    """

    def __init__(
        self,
        probe: ObstacleProbe,
        agent: AgentSizes,
        tolerance: float,
        inflation_reach: float = 0.0,
    ) -> None:
        self._probe = probe
        self._agent = agent
        self._obstacles = probe.obstacles
        self._tolerance = tolerance
        self._inflation_reach = inflation_reach
        self._num_findings: Counter[str] = Counter()
        self.num_cells_without_ground = 0

    def check_free(
        self, sample: LevelSample, counts: LevelCounts, volume: list[CellPrisms]
    ) -> list[Finding]:
        """Check the free cells of a sample.

        Args:
            sample: The cells.
            counts: The level's counts, which the check adds to.
            volume: The volume over each cell that has to be empty, as sets of prisms.

        Returns:
            A finding for each free cell that touches something, or has no floor.
        """
        has_volume = sample.is_free & ~np.isnan(sample.floor)
        contacts = self._find_contacts(sample, has_volume, volume, -self._tolerance)
        is_untouched = has_volume & (contacts.obstacle_of_cell < 0)
        enclosing_obstacle_of_cell = self._find_enclosing(sample, is_untouched, volume[0])
        obstacle_of_cell = np.where(
            enclosing_obstacle_of_cell >= 0, enclosing_obstacle_of_cell, contacts.obstacle_of_cell
        )

        text = "is free, though it has no floor"
        cells_without_floor = np.flatnonzero(sample.is_free & ~has_volume).tolist()
        findings = [
            sample.make_finding(report.NO_FLOOR, cell, text) for cell in cells_without_floor
        ]

        is_free_in_scene = has_volume & (obstacle_of_cell < 0)
        step_tolerance = self._agent.step + self._tolerance
        text = f"is free, but no floor is within {self._agent.step:g} m of its level's ground"
        for cell in np.flatnonzero(is_free_in_scene & (not sample.has_cell_floors)).tolist():
            # a floor is a surface that faces up, also one beside a crack or an edge
            position = sample.position(cell)
            x, y, z = position
            has_floor = self._probe.cast_line(x, y).has_upward_hit(
                z - step_tolerance, z + step_tolerance
            )
            if not has_floor and not self._probe.has_upward_hit_nearby(position, step_tolerance):
                is_free_in_scene[cell] = False
                findings.append(sample.make_finding(report.NO_FLOOR, cell, text))

        counts.disputed += int((is_free_in_scene & contacts.is_disputed).sum())
        counts.free_touches += int((obstacle_of_cell >= 0).sum())
        counts.free_free += int((is_free_in_scene & ~contacts.is_disputed).sum())
        for cell in np.flatnonzero(obstacle_of_cell >= 0).tolist():
            obstacle = int(obstacle_of_cell[cell])
            name = self._obstacles.geom_name(obstacle)
            depth = None
            if enclosing_obstacle_of_cell[cell] >= 0:
                text = f"is free, but lies inside of {name!r}"
            elif self._is_measured(report.FREE_TOUCHES):
                placed_prism = volume[int(contacts.prism_of_cell[cell])].prism_over_cell(
                    sample, cell
                )
                depth = self._probe.measure_depth(placed_prism.prism, placed_prism.center, obstacle)
                text = f"is free, but {name!r} reaches {depth:.4f} m into it"
            else:
                text = f"is free, but {name!r} reaches into it"
            findings.append(sample.make_finding(report.FREE_TOUCHES, cell, text, name, depth))
        return findings

    def check_blocked(
        self, sample: LevelSample, counts: LevelCounts, volume: list[CellPrisms], is_excused: Bool
    ) -> list[Finding]:
        """Check the blocked cells of a sample.

        Args:
            sample: The cells.
            counts: The level's counts, which the check adds to.
            volume: The volume over each cell that the bake considered, as sets of prisms.
            is_excused: The cells that an inflation blocked with a reason, (n,); they are not
                checked.

        Returns:
            A finding for each blocked cell that touches nothing.
        """
        is_checked = ~sample.is_free & ~np.isnan(sample.floor) & ~is_excused
        contacts = self._find_contacts(sample, is_checked, volume, self._tolerance)
        is_untouched = is_checked & (contacts.obstacle_of_cell < 0) & ~contacts.is_disputed
        is_untouched &= self._find_enclosing(sample, is_untouched, volume[0]) < 0
        for cell in np.flatnonzero(is_untouched & (not sample.has_cell_floors)).tolist():
            # a cell without a place to stand within a step of the ground may be blocked
            vertical_line = self._probe.cast_line(*sample.centers[cell])
            standable_hits = vertical_line.find_standable_hits(
                self._agent.height, self._agent.min_normal_z
            )
            ground_height = sample.floor[cell]
            is_untouched[cell] = any(
                abs(hit.z - ground_height) <= self._agent.step for hit in standable_hits
            )
            self.num_cells_without_ground += not is_untouched[cell]

        num_untouched = int(is_untouched.sum())
        counts.blocked_apart += num_untouched
        counts.blocked_blocked += int((~sample.is_free).sum()) - num_untouched
        return [
            self._blocked_finding(sample, cell, volume)
            for cell in np.flatnonzero(is_untouched).tolist()
        ]

    def _blocked_finding(self, sample: LevelSample, cell: int, volume: list[CellPrisms]) -> Finding:
        """Return the finding for a blocked cell that touches nothing."""
        name = None
        gap = None
        text = "is blocked, but touches nothing"
        if self._inflation_reach > 0 and not sample.is_occupied[cell]:
            text = f"is blocked for {self._inflation_reach:g} m, but nothing within that radius "
            text += "is in the way"
        elif self._is_measured(report.BLOCKED_APART):
            obstacle_gaps = []
            for prisms in volume:
                placed_prism = prisms.prism_over_cell(sample, cell)
                nearest_gap = self._probe.find_nearest_obstacle(
                    placed_prism.prism, placed_prism.center
                )
                if nearest_gap is not None:
                    obstacle_gaps.append(nearest_gap)
            text = f"is blocked, but nothing is within {MAX_MEASURED_GAP:g} m"
            if obstacle_gaps:
                gap, obstacle = min(obstacle_gaps)
                name = self._obstacles.geom_name(obstacle)
                text = "is blocked, but nothing touches the volume over it: the nearest geom, "
                text += f"{name!r}, is {gap:.4f} m off"
        return sample.make_finding(report.BLOCKED_APART, cell, text, name, gap)

    def _is_measured(self, kind: str) -> bool:
        """Count a finding of a kind; return whether to measure it, as only the first ones are."""
        self._num_findings[kind] += 1
        return self._num_findings[kind] <= MAX_MEASURED_FINDINGS

    def _find_contacts(
        self, sample: LevelSample, is_checked: Bool, volume: list[CellPrisms], margin: float
    ) -> CellContacts:
        """Find what the volumes over the checked cells, enlarged by a margin [m], touch."""
        obstacle_of_cell = np.full(len(is_checked), -1)
        prism_of_cell = np.zeros(len(is_checked), np.int64)
        is_disputed = np.zeros_like(is_checked)
        for prism_index, prisms in enumerate(volume):
            has_height = is_checked & (prisms.high_z > prisms.low_z)
            for obstacle, shape in enumerate(self._obstacles.shapes):
                # twice the margin: rounding must not exclude a cell by its box
                cells = _find_cells_near(
                    sample, has_height & (obstacle_of_cell < 0), shape, prisms, 2 * abs(margin)
                )
                for cell in cells.tolist():
                    prism, center = prisms.prism_over_cell(sample, cell)
                    contact = self._probe.find_contact(obstacle, prism, center, margin)
                    is_disputed[cell] |= contact == DISPUTED
                    if contact == TOUCHES:
                        obstacle_of_cell[cell] = obstacle
                        prism_of_cell[cell] = prism_index
        return CellContacts(obstacle_of_cell, prism_of_cell, is_disputed)

    def _find_enclosing(self, sample: LevelSample, is_checked: Bool, prisms: CellPrisms) -> Int:
        """Return the obstacle that the middle of each checked cell's volume lies in, -1 for none.

        If a point lies inside a solid, the ray up from it leaves solids more often than it enters
        them. At the surface of a cavity, entering and leaving are exchanged.
        """
        obstacle_of_cell = np.full(len(is_checked), -1)
        num_enclosing = np.zeros(len(is_checked), dtype=np.int64)
        for crossing in self._find_crossings(sample, is_checked, prisms):
            num_enclosing[crossing.cell] += crossing.num_exits - crossing.num_entries
            if crossing.num_exits > crossing.num_entries:
                obstacle_of_cell[crossing.cell] = crossing.obstacle
        obstacle_of_cell[num_enclosing <= 0] = -1
        return obstacle_of_cell

    def _find_crossings(
        self, sample: LevelSample, is_checked: Bool, prisms: CellPrisms
    ) -> Iterator[CellCrossing]:
        """Cast a ray up from the middle of each checked cell's volume at enclosing obstacles.

        Yields only cells whose middle lies in the obstacle's bounding box.
        """
        middle_z = (prisms.low_z + prisms.high_z) / 2
        point_prisms = CellPrisms(0.0, False, middle_z, middle_z)
        for obstacle, shape in enumerate(self._obstacles.shapes):
            if shape.kind not in ENCLOSING_KINDS:
                continue
            for cell in _find_cells_near(sample, is_checked, shape, point_prisms).tolist():
                x, y = sample.centers[cell].tolist()
                num_exits, num_entries = self._probe.count_crossings(
                    obstacle, (x, y, float(middle_z[cell]))
                )
                yield CellCrossing(obstacle, cell, num_exits, num_entries)


def _find_cells_near(
    sample: LevelSample,
    is_checked: Bool,
    shape: PlacedShape,
    prisms: CellPrisms,
    margin: float = 0.0,
) -> Int:
    """Return the checked cells whose prism, enlarged by a margin [m], overlaps a shape's box."""
    lattice = sample.level.lattice
    half_width = prisms.half_size + margin
    # rows ascend in a sample: only those between the box's ends are compared
    box_y = np.array([shape.high_corner[1] + half_width, shape.low_corner[1] - half_width])
    box_rows = (lattice.y_max - box_y) / lattice.cell_size
    first_row, last_row = np.clip(box_rows, 0, lattice.height).astype(np.int64)
    begin_index, end_index = np.searchsorted(sample.rows, [first_row - 1, last_row + 1])
    window = slice(begin_index, end_index)
    x, y = sample.centers[window].T
    low_z = prisms.low_z[window] - margin
    high_z = prisms.high_z[window] + margin
    overlaps = is_checked[window] & (low_z < shape.high_corner[2]) & (high_z > shape.low_corner[2])
    overlaps &= (x + half_width > shape.low_corner[0]) & (x - half_width < shape.high_corner[0])
    overlaps &= (y + half_width > shape.low_corner[1]) & (y - half_width < shape.high_corner[1])
    return np.asarray(begin_index + np.flatnonzero(overlaps))
