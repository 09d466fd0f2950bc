"""Find ridges: tops of walls and beams, which are no floors even where a step leads to them."""

from __future__ import annotations

import numpy as np

from navbake.baker.core.components import label_components, list_adjacent_pairs
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors.component_kernels import JoinRule
from navbake.baker.floors.outline import RegionContext, find_neighbor_cells, make_probe_ranges
from navbake.baker.floors.reach import MAX_DISTANCE_ON_SURFACE
from navbake.baker.floors.regions import make_region_join_rule
from navbake.baker.floors.ridge_kernels import list_narrow_runs, list_surfaces_of_runs
from navbake.baker.floors.surface_kernels import EAST, NORTH, SOUTH, WEST, Surfaces
from navbake.baker.floors.surfaces import find_highest_within_step
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Int, Int32

# A strip of floor between two drops is a ridge, such as the top of a wall, if it is narrower [m]
RIDGE_WIDTH = 0.4
# Only rows of cells up to this length are measured. A row along x or y that crosses a ridge
# obliquely is longer than the ridge is wide: at 45 degrees 1.4 times [m]
MAX_RUN_LENGTH = 2.0 * RIDGE_WIDTH
# An empty array of rows of `list_narrow_runs`
NO_RUNS = np.empty((0, 6), dtype=np.int64)


def find_ridges(region_context: RegionContext, positions: list[list[float]]) -> Int:
    """Find ridges: the surfaces of large regions where these are narrower than 0.4 m.

    A ridge has a drop on both sides. Its width is measured along rows of cells that cross it along
    x and along y, from drop to drop. A row that ends at a wall, or at a surface within a step, ends
    at no drop; the region isn't narrow there.

    Args:
        region_context: all regions, and the hits of all columns.
        positions: `floors.from`: x, y, z of each position, world frame [m]. A ridge with such a
            position on it is a floor, and not marked.

    Returns:
        Ids of the surfaces, ascending, shape (n,), int64.
    """
    regions = region_context.regions
    surfaces = regions.surfaces
    cell_size = regions.lattice.cell_size
    join_rule = make_region_join_rule(regions.lattice, region_context.agent)
    max_run_cells = int(MAX_RUN_LENGTH / cell_size + LIMIT_SLACK)
    labelled_surfaces = regions.label_surfaces(region_context.is_large)
    _, (runs,) = regions.blocks.list_rows(
        list_narrow_runs, (NO_RUNS,), labelled_surfaces, join_rule, max_run_cells
    )
    runs = runs[_mark_runs_between_drops(region_context, runs)]
    if not len(runs):
        return np.empty(0, dtype=np.int64)
    surface_ids, cell_ids, region_width = _measure_widths(surfaces, join_rule, runs)
    is_narrow = region_width < RIDGE_WIDTH - LIMIT_SLACK
    surface_ids = surface_ids[is_narrow]
    cell_ids = cell_ids[is_narrow]
    # narrow surfaces in cells that share a side or a corner make up a ridge
    _, cell_index = np.unique(cell_ids, return_inverse=True)
    ridge_cells = np.unique(cell_ids)
    ridge_of_surface = label_components(
        list_adjacent_pairs(ridge_cells, regions.lattice.width), len(ridge_cells)
    )[cell_index]
    is_floor_ridge = _mark_short_ridges(ridge_of_surface, cell_ids, regions.lattice)
    is_floor_ridge |= _mark_ridges_at_positions(
        ridge_of_surface, surface_ids, cell_ids, region_context, positions
    )
    ridge_surfaces: Int = surface_ids[~is_floor_ridge[ridge_of_surface]]
    return ridge_surfaces


def _measure_widths(surfaces: Surfaces, join_rule: JoinRule, runs: Int) -> tuple[Int, Int, Float]:
    """Measure how wide a region is between its drops, at each surface of some rows of cells.

    Args:
        surfaces: all surfaces.
        join_rule: the rule by which the surfaces of a row of cells are joined.
        runs: the rows of cells with drops at both ends, as `list_narrow_runs` lists them,
            shape (k, 6).

    Returns:
        The ids of the surfaces, ascending, (n,); their cells, (n,); and the width of the region at
        each of them, square to its drops, (n,) [m].
    """
    num_cells = runs[:, 1]
    first_row_of_run = np.cumsum(num_cells) - num_cells
    surface_cells = np.empty((int(num_cells.sum()), 2), dtype=np.int64)
    run_in_chunks(
        list_surfaces_of_runs, len(runs), surfaces, join_rule, runs, first_row_of_run, surface_cells
    )
    surface_ids, first_occurrence, surface_index = np.unique(
        surface_cells[:, 0], return_index=True, return_inverse=True
    )
    # a strip of width w at an angle a to x has the length w / sin(a) along x, w / cos(a) along y
    run_length = np.repeat(num_cells, num_cells) * surfaces.lattice.cell_size
    inverse_square_width = np.bincount(surface_index, 1.0 / run_length**2)
    return surface_ids, surface_cells[first_occurrence, 1], 1.0 / np.sqrt(inverse_square_width)


def _mark_runs_between_drops(region_context: RegionContext, runs: Int) -> Bool:
    """Mark the rows of cells that have a drop at both ends.

    Args:
        region_context: all regions, and the hits of all columns.
        runs: rows of cells, as `list_narrow_runs` lists them, shape (n, 6): few, as rows between
            walls have the floor within a step beyond their ends.

    Returns:
        A mask, shape (n,).
    """
    axis, _, surface_ids, cell_ids, other_surface_ids, other_cell_ids = runs.T
    direction = np.where(axis == EAST, EAST, SOUTH)
    opposite_direction = np.where(axis == EAST, WEST, NORTH)
    # the ends of one run are far from those of another: cast their columns together
    cells_beyond = find_neighbor_cells(region_context.regions.lattice, cell_ids, direction)
    other_cells_beyond = find_neighbor_cells(
        region_context.regions.lattice, other_cell_ids, opposite_direction
    )
    all_cells_beyond = np.concatenate([cells_beyond, other_cells_beyond])
    region_context.cast_ahead(all_cells_beyond[all_cells_beyond >= 0])
    is_between_drops = _mark_drops(region_context, surface_ids, cell_ids, direction)
    runs_with_drop = np.flatnonzero(is_between_drops)
    is_between_drops[runs_with_drop] = _mark_drops(
        region_context,
        other_surface_ids[runs_with_drop],
        other_cell_ids[runs_with_drop],
        opposite_direction[runs_with_drop],
    )
    return is_between_drops


def _mark_drops(
    region_context: RegionContext, surface_ids: Int, cell_ids: Int, direction: Int
) -> Bool:
    """Mark the edges of surfaces at which an agent would fall by more than a step.

    At such an edge the next cell in the given direction has no surface within a step of the
    surface's height, or the scene ends. With `floors.fill`, which closes holes, the next cell must
    have a lower surface. And nothing that an agent's feet would meet, such as a wall or a parapet,
    stands in the cells on either side of the edge.

    Args:
        region_context: all regions, and the hits of all columns.
        surface_ids: ids of surfaces, (n,).
        cell_ids: the cell of each surface, (n,).
        direction: EAST, SOUTH, WEST or NORTH: the side of each cell that is tested, (n,).

    Returns:
        A mask of the edges, shape (n,).
    """
    lattice = region_context.regions.lattice
    max_step = region_context.agent.traversable_floor_height
    z = region_context.regions.surfaces.z[surface_ids]
    cells_beyond = find_neighbor_cells(lattice, cell_ids, direction)
    is_drop = (cells_beyond >= 0) | ~region_context.is_cropped[direction]
    indices_inside = np.flatnonzero(cells_beyond >= 0)
    columns = region_context.columns.columns_at(cells_beyond[indices_inside])
    first_hit = columns.start[cells_beyond[indices_inside]]
    end_hit = columns.start[cells_beyond[indices_inside] + 1]
    continued_z = find_highest_within_step(
        first_hit, end_hit, columns.z, z[indices_inside], max_step
    )
    is_drop[indices_inside[~np.isnan(continued_z)]] = False
    if region_context.settings.fill:
        lowest_z = np.full(len(indices_inside), np.inf)
        lowest_z[end_hit > first_hit] = columns.z[first_hit[end_hit > first_hit]]
        is_drop[indices_inside[lowest_z > z[indices_inside] - max_step]] = False
        is_drop[cells_beyond < 0] = False
    range_at_feet, _ = make_probe_ranges(region_context.agent)
    for cells in (cells_beyond, cell_ids):
        tested_indices = np.flatnonzero(is_drop & (cells >= 0))
        is_drop[tested_indices] = ~region_context.is_occupied(
            cells[tested_indices], z[tested_indices], range_at_feet
        )
    return is_drop


def _mark_short_ridges(ridge_of_surface: Int32, cell_ids: Int, lattice: Lattice) -> Bool:
    """Mark ridges at most `RIDGE_WIDTH` (0.4 m) long, which are no tops of walls or beams.

    They are tops of posts, and corners of wide floors that are turned against the lattice.

    Args:
        ridge_of_surface: the ridge of each surface, (n,).
        cell_ids: the cell of each surface, (n,).
        lattice: the cells.

    Returns:
        A mask of the ridges, shape (ridges,).
    """
    max_cells = RIDGE_WIDTH / lattice.cell_size + LIMIT_SLACK
    is_short = np.ones(int(ridge_of_surface.max(initial=-1)) + 1, dtype=np.bool_)
    for row_or_col in np.divmod(cell_ids, lattice.width):
        lowest_index = np.full(len(is_short), np.iinfo(np.int64).max)
        highest_index = np.full(len(is_short), -1)
        np.minimum.at(lowest_index, ridge_of_surface, row_or_col)
        np.maximum.at(highest_index, ridge_of_surface, row_or_col)
        is_short &= highest_index - lowest_index + 1 <= max_cells
    return is_short


def _mark_ridges_at_positions(
    ridge_of_surface: Int32,
    surface_ids: Int,
    cell_ids: Int,
    region_context: RegionContext,
    positions: list[list[float]],
) -> Bool:
    """Mark the ridges that have at least one of some positions on them.

    Args:
        ridge_of_surface: the ridge of each surface, (n,).
        surface_ids: ids of the surfaces, (n,).
        cell_ids: the cell of each surface, (n,).
        region_context: all regions.
        positions: x, y, z of each position, world frame [m].

    Returns:
        A mask of the ridges, shape (ridges,).
    """
    lattice = region_context.regions.lattice
    surface_heights = region_context.regions.surfaces.z[surface_ids]
    has_position = np.zeros(int(ridge_of_surface.max(initial=-1)) + 1, dtype=np.bool_)
    for x, y, z in positions:
        row, col = lattice.rows_cols([x, y])
        is_at_position = cell_ids == int(row) * lattice.width + int(col)
        is_at_position &= np.abs(surface_heights - z) <= MAX_DISTANCE_ON_SURFACE + LIMIT_SLACK
        if 0 <= col < lattice.width:
            has_position[ridge_of_surface[is_at_position]] = True
    return has_position
