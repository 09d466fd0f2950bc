"""Find ridges: tops of walls and beams, which are no floors even where a step leads to them."""

from __future__ import annotations

import numpy as np

from navbake.baker.core.components import adjacent_pairs, label_components
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors.component_kernels import JoinRule
from navbake.baker.floors.outline import RegionContext, neighbor_cells, probe_ranges
from navbake.baker.floors.reach import MAX_DISTANCE_ON_SURFACE
from navbake.baker.floors.regions import region_join_rule
from navbake.baker.floors.ridge_kernels import list_narrow_runs, list_run_surfaces
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


def find_ridges(context: RegionContext, positions: list[list[float]]) -> Bool:
    """Find ridges: the surfaces of large regions where these are narrower than 0.4 m.

    A ridge has a drop on both sides. Its width follows from the rows of cells that cross it along x
    and along y. A row that ends at a wall, or at a surface within a step, has no drop there, and
    counts as endless.

    Args:
        context: all regions, and the hits of all columns.
        positions: `floors.from`: x, y, z of each position, world frame [m]. A ridge with such a
            position on it is a floor, and not marked.

    Returns:
        A mask of the surfaces, shape (surfaces,).
    """
    regions = context.regions
    surfaces = regions.surfaces
    cell_size = regions.lattice.cell_size
    is_ridge = np.zeros(len(surfaces.z), dtype=np.bool_)
    rule = region_join_rule(regions.lattice, context.agent)
    max_cells = int(MAX_RUN_LENGTH / cell_size + LIMIT_SLACK)
    labelled = regions.label_surfaces(context.is_large)
    _, (runs,) = regions.blocks.list_rows(list_narrow_runs, (NO_RUNS,), labelled, rule, max_cells)
    runs = runs[_mark_runs_between_drops(context, runs)]
    if not len(runs):
        return is_ridge
    surface, cell, width = _measure_widths(surfaces, rule, runs)
    is_narrow = width < RIDGE_WIDTH - LIMIT_SLACK
    surface = surface[is_narrow]
    cell = cell[is_narrow]
    # narrow surfaces in cells that share a side or a corner make up a ridge
    _, place = np.unique(cell, return_inverse=True)
    cells = np.unique(cell)
    ridge = label_components(adjacent_pairs(cells, regions.lattice.width), len(cells))[place]
    is_floor = _mark_short(ridge, cell, regions.lattice)
    is_floor |= _mark_named(ridge, surface, cell, context, positions)
    is_ridge[surface[~is_floor[ridge]]] = True
    return is_ridge


def _measure_widths(surfaces: Surfaces, rule: JoinRule, runs: Int) -> tuple[Int, Int, Float]:
    """Measure how wide a region is between its drops, at each surface of some rows of cells.

    Args:
        surfaces: all surfaces.
        rule: the rule by which the surfaces of a row of cells are joined.
        runs: the rows of cells with drops at both ends, as `list_narrow_runs` lists them,
            shape (k, 6).

    Returns:
        The ids of the surfaces, ascending, (n,); their cells, (n,); and the width of the region at
        each of them, square to its drops, (n,) [m].
    """
    num_cells = runs[:, 1]
    start = np.cumsum(num_cells) - num_cells
    surface_cells = np.empty((int(num_cells.sum()), 2), dtype=np.int64)
    run_in_chunks(list_run_surfaces, len(runs), surfaces, rule, runs, start, surface_cells)
    surface, first, place = np.unique(surface_cells[:, 0], return_index=True, return_inverse=True)
    # a strip at an angle a to x is cut by w / sin(a) along x, and by w / cos(a) along y
    length = np.repeat(num_cells, num_cells) * surfaces.lattice.cell_size
    inverse_square = np.bincount(place, 1.0 / length**2)
    return surface, surface_cells[first, 1], 1.0 / np.sqrt(inverse_square)


def _mark_runs_between_drops(context: RegionContext, runs: Int) -> Bool:
    """Mark the rows of cells that have a drop at both ends.

    Args:
        context: all regions, and the hits of all columns.
        runs: rows of cells, as `list_narrow_runs` lists them, shape (n, 6).

    Returns:
        A mask, shape (n,).
    """
    axis, _, surface, cell, last_surface, last_cell = runs.T
    direction = np.where(axis == EAST, EAST, SOUTH)
    opposite = np.where(axis == EAST, WEST, NORTH)
    # the ends of one run are far from those of another: cast their columns together
    beyond = neighbor_cells(context.regions.lattice, cell, direction)
    beyond_last = neighbor_cells(context.regions.lattice, last_cell, opposite)
    all_beyond = np.concatenate([beyond, beyond_last])
    context.cast_ahead(all_beyond[all_beyond >= 0])
    is_between = _mark_drops(context, surface, cell, direction)
    last = np.flatnonzero(is_between)
    is_between[last] = _mark_drops(context, last_surface[last], last_cell[last], opposite[last])
    return is_between


def _mark_drops(context: RegionContext, surface: Int, cell: Int, direction: Int) -> Bool:
    """Mark the edges of surfaces at which an agent would fall by more than a step.

    At such an edge the next cell in the given direction has no surface within a step of the
    surface's height, or the scene ends. With `floors.fill`, which closes holes, the next cell must
    have a lower surface. And nothing that an agent's feet would meet, such as a wall or a parapet,
    stands in the cells on either side of the edge.

    Args:
        context: all regions, and the hits of all columns.
        surface: ids of surfaces, (n,).
        cell: the cell of each surface, (n,).
        direction: EAST, SOUTH, WEST or NORTH: the side of each cell that is tested, (n,).

    Returns:
        A mask of the edges, shape (n,).
    """
    lattice = context.regions.lattice
    step = context.agent.traversable_floor_height
    z = context.regions.surfaces.z[surface]
    beyond = neighbor_cells(lattice, cell, direction)
    is_drop = (beyond >= 0) | ~context.is_cropped[direction]
    inside = np.flatnonzero(beyond >= 0)
    columns = context.columns.covering(beyond[inside])
    first = columns.start[beyond[inside]]
    end = columns.start[beyond[inside] + 1]
    continued = find_highest_within_step(first, end, columns.z, z[inside], step)
    is_drop[inside[~np.isnan(continued)]] = False
    if context.settings.fill:
        lowest = np.full(len(inside), np.inf)
        lowest[end > first] = columns.z[first[end > first]]
        is_drop[inside[lowest > z[inside] - step]] = False
        is_drop[beyond < 0] = False
    at_feet, _ = probe_ranges(context.agent)
    for cells in (beyond, cell):
        tested = np.flatnonzero(is_drop & (cells >= 0))
        is_drop[tested] = ~context.is_occupied(cells[tested], z[tested], at_feet)
    return is_drop


def _mark_short(ridge: Int32, cell: Int, lattice: Lattice) -> Bool:
    """Mark the ridges that are at most `RIDGE_WIDTH` long, and so are no tops of walls or beams.

    They are tops of posts, and corners of wide floors that are turned against the lattice.

    Args:
        ridge: the ridge of each surface, (n,).
        cell: the cell of each surface, (n,).
        lattice: the cells.

    Returns:
        A mask of the ridges, shape (ridges,).
    """
    max_cells = RIDGE_WIDTH / lattice.cell_size + LIMIT_SLACK
    is_short = np.ones(int(ridge.max(initial=-1)) + 1, dtype=np.bool_)
    for place in np.divmod(cell, lattice.width):
        lowest = np.full(len(is_short), np.iinfo(np.int64).max)
        highest = np.full(len(is_short), -1)
        np.minimum.at(lowest, ridge, place)
        np.maximum.at(highest, ridge, place)
        is_short &= highest - lowest + 1 <= max_cells
    return is_short


def _mark_named(
    ridge: Int32, surface: Int, cell: Int, context: RegionContext, positions: list[list[float]]
) -> Bool:
    """Mark the ridges that have at least one of some positions on them.

    Args:
        ridge: the ridge of each surface, (n,).
        surface: ids of the surfaces, (n,).
        cell: the cell of each surface, (n,).
        context: all regions.
        positions: x, y, z of each position, world frame [m].

    Returns:
        A mask of the ridges, shape (ridges,).
    """
    lattice = context.regions.lattice
    heights = context.regions.surfaces.z[surface]
    is_named = np.zeros(int(ridge.max(initial=-1)) + 1, dtype=np.bool_)
    for x, y, z in positions:
        row, col = lattice.rows_cols([x, y])
        is_at_position = cell == int(row) * lattice.width + int(col)
        is_at_position &= np.abs(heights - z) <= MAX_DISTANCE_ON_SURFACE + LIMIT_SLACK
        if 0 <= col < lattice.width:
            is_named[ridge[is_at_position]] = True
    return is_named


def without_surfaces(surfaces: Surfaces, mask: Bool) -> Surfaces:
    """Return the surfaces with all their marks removed where a mask is True.

    No agent stands on such a surface then, but a floor beside it may still go on there.

    Args:
        surfaces: all surfaces.
        mask: shape (surfaces,), bool.
    """
    return surfaces._replace(marks=np.where(mask, np.uint8(0), surfaces.marks))
