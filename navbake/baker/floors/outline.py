"""Find out how regions end at their edges: at walls, at drops, at the lattice's border.

A region is a set of connected surfaces on which an agent can stand. An edge is a side of a cell
beyond which the cell's region has no surface. The rules for tops, shelves and roofs, in `rejected`,
ask how regions end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.columns import ColumnSource
from navbake.baker.core.arrays import HeightRange
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors.region_kernels import (
    SAME_REGION,
    LabelledSurfaces,
    RegionEdges,
    find_surfaces_below,
    list_edges,
    mark_hole_edges,
)
from navbake.baker.floors.regions import Regions
from navbake.baker.floors.surfaces import find_highest_within_step
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Int, Int32

# How a region ends at an edge, see `RegionContext.classify_edges`
WALL = 0  # something stands there at an agent's feet and at its head
BARRIER = 1  # something stands there at an agent's feet only
DROP = 2  # a floor lies more than a step lower
BORDER = 3  # the lattice ends
OPEN = 4  # none of these
# A wall is what meets two thin volumes over a floor: one at an agent's feet, one at its head. This
# is the height of each volume [m]
PROBE_HEIGHT = 0.01
# An empty array with the dtype and shape of what `list_edges` lists
NO_EDGES = np.empty((0, 5), dtype=np.int64)
# Fewer cells than this are not worth a call on another thread
MIN_CELLS_PER_THREAD = 1000

OccupancyTest = Callable[[Int, Float, HeightRange | None], Bool]
"""Tests whether a geom stands on the floor of each of some cells.

It is called with the ids of cells, (n,); the floor's height in each [m], (n,); and a range of
heights above the floor [m], None for the range from a step to the agent's height. It returns for
each cell whether a geom meets that range over the cell's square, (n,) bool.
"""


class EdgeEndings(NamedTuple):
    """How regions end at their edges, see `RegionContext.classify_edges`; shape (edges,) each.

    Attributes:
        ending: WALL, BARRIER, DROP, BORDER or OPEN, uint8.
        floor_height: the height of the floor that a DROP leads to, NaN at other edges [m].
        floor_region: the region of that floor, -1 at other edges, int32.
        is_beyond_known: whether it is known what lies beyond the edge, bool. It is unknown at a
            side of the lattice beyond which the scene goes on.
    """

    ending: NDArray[np.uint8]
    floor_height: Float
    floor_region: Int32
    is_beyond_known: Bool


class ListedEdges(NamedTuple):
    """Edges of regions, as `list_edges` lists them.

    Attributes:
        region: the region that ends at each edge, shape (edges,), int32.
        cell: the cell on the region's side, shape (edges,), int64.
        surface_id: the region's surface in that cell, shape (edges,), int64.
        direction: EAST, SOUTH, WEST or NORTH, out of the region, shape (edges,), int64.
        has_drop: 1 if another region has a surface more than a step lower in the cells beyond the
            edge, else 0, shape (edges,), int64.
    """

    region: Int32
    cell: Int
    surface_id: Int
    direction: Int
    has_drop: Int


@dataclass(frozen=True, eq=False)
class RegionContext:
    """The regions of a scene with their edges, for the rules that find tops, roofs and shelves.

    Attributes:
        regions: all regions, also those of furniture.
        is_large: which regions are large enough for floors, shape (regions,), bool.
        columns: the hits of all columns.
        agent: the agent whose floors are found.
        settings: the settings of `floors`.
        is_occupied: tests whether something stands on a floor in some cells.
        is_cropped: whether the scene goes on beyond the lattice's sides east, south, west and
            north, shape (4,), bool.
    """

    regions: Regions
    is_large: Bool
    columns: ColumnSource
    agent: AgentSettings
    settings: FloorSettings
    is_occupied: OccupancyTest
    is_cropped: Bool

    @property
    def num_cells_beyond(self) -> int:
        """The number of cells straight beyond an edge in which lower floors are searched."""
        return int(np.ceil(self.settings.shrink / self.regions.lattice.cell_size)) + 1

    @cached_property
    def edges(self) -> ListedEdges:
        """The edges of the large regions; they are listed when they are first asked for."""
        regions = self.regions
        lowest_z = regions.lowest_z[self.is_large].min(initial=np.inf)
        _, (edge_rows,) = regions.blocks.list_rows(
            list_edges,
            (NO_EDGES,),
            regions.label_surfaces(self.is_large),
            lowest_z,
            self.agent.traversable_floor_height,
            self.num_cells_beyond,
        )
        component, cell, surface_id, direction, has_drop = edge_rows.T
        return ListedEdges(
            region=regions.region_of_component[component],
            cell=cell,
            surface_id=surface_id,
            direction=direction,
            has_drop=has_drop,
        )

    def cast_ahead(self, cells: Int) -> None:
        """Cast the columns of many cells at once, so that later requests for some of them are fast.

        A `ColumnSource` keeps at least the columns that it cast last.

        Args:
            cells: ids of all cells whose columns will be needed.
        """
        self.columns.columns_at(cells)

    def select_edges(self, is_selected_region: Bool, num_cells_beyond: int) -> RegionEdges:
        """Return the edges of some large regions, and the lower floors beyond these edges.

        Args:
            is_selected_region: which large regions, shape (regions,).
            num_cells_beyond: how many cells beyond an edge to search for lower floors.
        """
        regions = self.regions
        max_step = self.agent.traversable_floor_height
        is_selected = is_selected_region[self.edges.region]
        cell = self.edges.cell[is_selected]
        edges = RegionEdges(
            region=self.edges.region[is_selected],
            cell=cell,
            z=regions.surfaces.z[self.edges.surface_id[is_selected]],
            direction=self.edges.direction[is_selected],
            cells_beyond=np.full((len(cell), num_cells_beyond), -1),
            floors_below=np.full((len(cell), num_cells_beyond), np.nan),
            regions_below=np.full((len(cell), num_cells_beyond), -1, dtype=np.int32),
        )
        labelled_surfaces = regions.label_surfaces(self.is_large)
        # edges beyond which, in the cells so far, neither the region began again nor the lattice
        # ended
        open_edges = np.arange(len(cell))
        for k in range(num_cells_beyond):
            cells = find_neighbor_cells(
                regions.lattice, edges.cell[open_edges], edges.direction[open_edges], k + 1
            )
            is_inside = cells >= 0
            open_edges = open_edges[is_inside]
            cells = cells[is_inside]
            # a surface within a step is no drop
            height_limits = edges.z[open_edges] - max_step - LIMIT_SLACK
            surface_below, regions_below = find_highest_below(
                labelled_surfaces, cells, height_limits, edges.region[open_edges]
            )
            is_outside_region = surface_below != SAME_REGION
            open_edges = open_edges[is_outside_region]
            surface_below = surface_below[is_outside_region]
            edges.cells_beyond[open_edges, k] = cells[is_outside_region]
            edges.regions_below[open_edges, k] = regions_below[is_outside_region]
            has_floor = surface_below >= 0
            floor_heights = labelled_surfaces.surfaces.z[surface_below[has_floor]]
            edges.floors_below[open_edges[has_floor], k] = floor_heights
        return edges

    def classify_barriers(self, edges: RegionEdges, agent: AgentSettings) -> NDArray[np.uint8]:
        """Say what stands at each edge of a region, from the obstacles in the cells on both sides.

        Whether the floor drops beyond the edge is not looked at.

        Args:
            edges: the edges.
            agent: the agent whose step and height define walls and barriers; may differ from the
                context's agent.

        Returns:
            The kind of each edge, shape (edges,), uint8. WALL: something stands in the way of the
            agent's head and feet. BARRIER: something stands in the way of the feet alone. BORDER:
            the lattice ends there. OPEN: nothing stands in either cell; there may be a floor
            beyond, or a drop.
        """
        outer_cells = find_neighbor_cells(self.regions.lattice, edges.cell, edges.direction)
        ending = np.full(len(outer_cells), OPEN, dtype=np.uint8)
        ending[outer_cells < 0] = BORDER
        candidate_edges = np.arange(len(outer_cells))
        range_at_feet, range_at_head = make_probe_ranges(agent)
        # what is in the way of the feet is a barrier; if of the head, too, it is a wall
        for height_range, ending_if_blocked in ((range_at_feet, BARRIER), (range_at_head, WALL)):
            is_blocked = self.is_occupied(
                edges.cell[candidate_edges], edges.z[candidate_edges], height_range
            )
            unblocked_indices = np.flatnonzero(~is_blocked & (outer_cells[candidate_edges] >= 0))
            unblocked_outer_cells = outer_cells[candidate_edges[unblocked_indices]]
            is_blocked[unblocked_indices] = self.is_occupied(
                unblocked_outer_cells, edges.z[candidate_edges[unblocked_indices]], height_range
            )
            candidate_edges = candidate_edges[is_blocked]
            ending[candidate_edges] = ending_if_blocked
        return ending

    def classify_edges(self, edges: RegionEdges) -> EdgeEndings:
        """Classify how a region ends at each of its edges.

        - WALL: something stands in the cell on this side of the edge, or in the one beyond, at an
          agent's feet (just above a step) and at its head (just below its height).
        - BARRIER: something stands at an agent's feet only: a parapet, a headboard, a sill.
        - DROP: one of `edges.cells_beyond` has a floor that lies more than a step lower, and on
          which the agent can stand. Nothing at an agent's feet stands before it. As several cells
          are searched, the floor past the frame of a bed is found. It is no drop if a surface goes
          on from the region over that floor, with room for the agent below it.
        - BORDER: the lattice ends.
        - OPEN: none of these: beyond the edge there is an abyss, a steep slope, or a floor on which
          no agent can stand.

        If there is nothing in the cells at the edge, but at an agent's feet in a cell farther out,
        the edge is a BARRIER, too.

        Args:
            edges: edges of large regions, see `select_edges`.
        """
        agent = self.agent
        range_at_feet, _ = make_probe_ranges(agent)
        # the columns of all these cells are cast at once, see `cast_ahead`
        cells_beyond = edges.cells_beyond[edges.cells_beyond >= 0]
        columns = self.columns.columns_at(np.concatenate([edges.cell, cells_beyond]))
        ending = self.classify_barriers(edges, agent)
        floor_height = np.full(len(ending), np.nan)
        floor_region = np.full(len(ending), -1, dtype=np.int32)
        # the height of the surface that continues from the region, NaN where none does
        continued_z = edges.z.copy()
        candidate_edges = np.flatnonzero(ending == OPEN)
        for k in range(edges.cells_beyond.shape[1]):
            candidate_edges = candidate_edges[edges.cells_beyond[candidate_edges, k] >= 0]
            if k > 0:  # `classify_barriers` has tested the nearest cell
                cells = edges.cells_beyond[candidate_edges, k]
                is_blocked_at_feet = self.is_occupied(
                    cells, edges.z[candidate_edges], range_at_feet
                )
                ending[candidate_edges[is_blocked_at_feet]] = BARRIER
                candidate_edges = candidate_edges[~is_blocked_at_feet]
            cells = edges.cells_beyond[candidate_edges, k]
            continued_z[candidate_edges] = find_highest_within_step(
                columns.start[cells],
                columns.start[cells + 1],
                columns.z,
                continued_z[candidate_edges],
                agent.traversable_floor_height,
            )
            edges_with_floor = candidate_edges[~np.isnan(edges.floors_below[candidate_edges, k])]
            floor_heights = edges.floors_below[edges_with_floor, k]
            # with a surface above it that continues from the region, the floor is another storey
            is_covered = continued_z[edges_with_floor] > floor_heights + agent.height + LIMIT_SLACK
            is_floor_occupied = self.is_occupied(
                edges.cells_beyond[edges_with_floor, k], floor_heights, None
            )
            drop_edges = edges_with_floor[~is_covered & ~is_floor_occupied]
            ending[drop_edges] = DROP
            floor_height[drop_edges] = edges.floors_below[drop_edges, k]
            floor_region[drop_edges] = edges.regions_below[drop_edges, k]
            # edges without an ending so far are tried one cell farther out
            candidate_edges = candidate_edges[ending[candidate_edges] == OPEN]
        is_beyond_known = self.mark_known_beyond(ending, edges.direction)
        return EdgeEndings(ending, floor_height, floor_region, is_beyond_known)

    def mark_known_beyond(self, ending: NDArray[np.uint8], direction: Int) -> Bool:
        """Mark the edges for which it is known what lies beyond them.

        It is unknown only at those sides of the lattice beyond which the scene goes on.

        Args:
            ending: how the region ends at each edge, WALL to OPEN, shape (edges,).
            direction: the direction out of the region, EAST to NORTH, shape (edges,).

        Returns:
            A mask, shape (edges,), bool.
        """
        is_beyond_known: Bool = (ending != BORDER) | ~self.is_cropped[direction]
        return is_beyond_known

    def compute_edge_fraction(self, edges: RegionEdges, is_marked: Bool, is_counted: Bool) -> Float:
        """Compute the fraction of each region's edges that a mask marks.

        Args:
            edges: the edges.
            is_marked: the mask, shape (edges,).
            is_counted: all other edges are left out, such as those where it is unknown what lies
                beyond, shape (edges,).

        Returns:
            Fractions from 0 to 1, shape (regions,), float64; NaN for regions without a counted
            edge.
        """
        num_marked = np.bincount(edges.region, is_marked & is_counted, len(self.is_large))
        num_counted = np.bincount(edges.region, is_counted, len(self.is_large))
        marked_fraction = np.full(len(num_counted), np.nan)
        np.divide(num_marked, num_counted, out=marked_fraction, where=num_counted > 0)
        return marked_fraction


def find_highest_below(
    labelled_surfaces: LabelledSurfaces,
    cells: Int,
    height_limits: Float,
    excluded_regions: Int32 | None = None,
) -> tuple[Int, Int32]:
    """Find in each cell the highest surface that lies below a given height.

    Args:
        labelled_surfaces: all surfaces, and the regions whose surfaces count.
        cells: ids of cells, shape (n,).
        height_limits: for each cell, the height below which the surface must lie, shape (n,) [m].
        excluded_regions: for each cell, a region. If it has a surface in the cell, at any height,
            the answer for the cell is SAME_REGION, shape (n,); None for no such regions.

    Returns:
        The ids of the surfaces, NO_SURFACE if there is none, or SAME_REGION; and the regions of the
        surfaces, -1 for none; shape (n,) each.
    """
    if excluded_regions is None:
        excluded_regions = np.full(len(cells), -1, dtype=np.int32)
    surface_below = np.empty(len(cells), dtype=np.int64)
    regions_below = np.empty(len(cells), dtype=np.int32)
    run_in_chunks(
        find_surfaces_below,
        len(cells),
        labelled_surfaces,
        cells,
        excluded_regions,
        height_limits,
        surface_below,
        regions_below,
        min_chunk_size=MIN_CELLS_PER_THREAD,
    )
    return surface_below, regions_below


def mark_cropped_sides(lattice: Lattice, bounds: Float | None) -> Bool:
    """Mark the sides of the lattice beyond which the scene continues.

    Args:
        lattice: the lattice.
        bounds: the lowest and the highest corner of the scene's box, shape (2, 3) [m]; None if the
            scene is endless.

    Returns:
        A mask of the sides east, south, west and north, shape (4,), bool.
    """
    if bounds is None:
        return np.ones(4, dtype=np.bool_)
    x_min, y_min, x_max, y_max = lattice.bounds
    scene_min, scene_max = bounds
    scene_reach_beyond = np.array(
        [scene_max[0] - x_max, y_min - scene_min[1], x_min - scene_min[0], scene_max[1] - y_max]
    )
    return scene_reach_beyond > LIMIT_SLACK


def find_hole_edges(edges: RegionEdges, lattice: Lattice) -> Bool:
    """Mark the edges at the rims of holes in regions; all others are at the outer rims.

    Args:
        edges: all edges of some regions.
        lattice: the lattice of their cells.

    Returns:
        A mask, shape (edges,), bool.
    """
    sort_indices = np.argsort(edges.region, kind="stable")
    first_edge_of_region = np.append(
        np.flatnonzero(np.diff(edges.region[sort_indices], prepend=-1)), len(sort_indices)
    )
    is_in_hole_sorted = np.empty(len(sort_indices), dtype=np.bool_)
    mark_hole_edges(
        edges.cell[sort_indices],
        edges.direction[sort_indices],
        first_edge_of_region,
        lattice,
        is_in_hole_sorted,
    )
    is_in_hole = np.empty(len(sort_indices), dtype=np.bool_)
    is_in_hole[sort_indices] = is_in_hole_sorted
    return is_in_hole


def find_neighbor_cells(
    lattice: Lattice, cells: Int, direction: Int | int, distance: int = 1
) -> Int:
    """Return the neighbors of cells in a direction, `distance` cells away.

    Args:
        lattice: the lattice.
        cells: ids of cells, shape (n,).
        direction: EAST (0), SOUTH (1), WEST (2) or NORTH (3), for each cell or for all.
        distance: how many cells to go.

    Returns:
        Ids of cells, shape (n,); -1 beyond the lattice.
    """
    row, col = np.divmod(cells, lattice.width)
    row = row + distance * np.array([0, 1, 0, -1])[direction]
    col = col + distance * np.array([1, 0, -1, 0])[direction]
    is_inside = (row >= 0) & (row < lattice.height) & (col >= 0) & (col < lattice.width)
    return np.where(is_inside, row * lattice.width + col, -1)


def make_probe_ranges(agent: AgentSettings) -> tuple[HeightRange, HeightRange]:
    """Return two thin ranges of heights above a floor [m]: at an agent's feet, and at its head.

    An obstacle that an agent can't step over meets the first range, which begins at the agent's
    step. An obstacle as high as a wall meets both ranges.
    """
    feet_height = agent.traversable_floor_height
    head_height = agent.height
    thickness = min(PROBE_HEIGHT, (head_height - feet_height) / 2)
    return HeightRange(feet_height, feet_height + thickness), HeightRange(
        head_height - thickness, head_height
    )
