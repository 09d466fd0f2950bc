"""Ridges: tops of walls and beams, which are no floors even where a step leads to them."""

from __future__ import annotations

import numpy as np

from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors.outline import RegionContext, neighbor_cells, probe_ranges
from navbake.baker.floors.reach import MAX_DISTANCE_ON_SURFACE
from navbake.baker.floors.regions import Regions, find_regions, region_join_rule
from navbake.baker.floors.ridge_kernels import list_narrow_runs, measure_runs
from navbake.baker.floors.surface_kernels import EAST, NORTH, SOUTH, WEST, Surfaces
from navbake.baker.floors.surfaces import find_highest_within_step
from navbake.threads import run_in_chunks
from navbake.types import Bool, Int, Int32

# What is narrower between two drops is a ridge [m]
RIDGE_WIDTH = 0.4
# Runs of cells across a ridge are at most this long: of an oblique one, they are longer than it is
# wide [m]
MAX_RUN_LENGTH = 2.0 * RIDGE_WIDTH
# An empty array of rows of `list_narrow_runs`
NO_RUNS = np.empty((0, 6), dtype=np.int64)


def find_ridges(context: RegionContext, positions: list[list[float]]) -> Bool:
    """Find the surfaces of large regions that are narrower than 0.4 m between two drops.

    The width of a strip follows from the lengths of its runs of cells along x and y. A run that
    meets a wall, or a surface within a step, at one of its ends has no two drops, and counts as
    endless.

    Args:
        context: all regions.
        positions: `floors.from`: ridges on which such a position lies are floors [m].

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
    num_cells_across = np.zeros((len(surfaces.z), 2), dtype=np.int32)
    run_in_chunks(measure_runs, len(runs), surfaces, rule, runs, num_cells_across)
    in_run = np.flatnonzero(num_cells_across.any(axis=1))
    lengths = num_cells_across[in_run] * cell_size
    # a strip at an angle a to x is cut by w / sin(a) along x, and by w / cos(a) along y
    inverse_lengths = np.divide(1.0, lengths, out=np.zeros(lengths.shape), where=lengths > 0.0)
    width = 1.0 / np.hypot(inverse_lengths[:, 0], inverse_lengths[:, 1])
    is_ridge[in_run] = width < RIDGE_WIDTH - LIMIT_SLACK
    if not is_ridge.any():
        return is_ridge
    group = np.where(is_ridge, np.int32(0), np.int32(-1))
    ridges = find_regions(surfaces, context.agent, group)
    is_floor = _mark_corners(ridges, is_ridge, num_cells_across)
    is_floor |= _mark_named_ridges(ridges, positions)
    is_ridge[is_ridge] = ~is_floor[ridges.region_of(np.flatnonzero(is_ridge))]
    return is_ridge


def _mark_runs_between_drops(context: RegionContext, runs: Int) -> Bool:
    """Mark the runs, as `list_narrow_runs` lists them, with a drop at both ends."""
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
    """Mark the edges of surfaces beyond which it goes down by more than a step.

    Beyond a drop there is a lower surface or none, and neither a surface within a step nor
    something that stands there, such as a wall or a parapet. Where a scan's holes are closed, there
    has to be a lower surface.

    Args:
        context: all regions.
        surface: ids of surfaces, (n,).
        cell: the cell of each, (n,).
        direction: the direction out of each, (n,).
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


def _mark_corners(ridges: Regions, is_ridge: Bool, num_cells_across: Int32) -> Bool:
    """Mark the ridges that are corners of wide floors, such as that of a tier turned by 45 degrees.

    A line along x or y cuts a corner short, but not a line along the other axis; and the corner is
    no longer than a ridge is wide.

    Args:
        ridges: the connected ridges.
        is_ridge: mask of the surfaces that are ridges, shape (surfaces,).
        num_cells_across: the cells of each surface's runs, see `measure_runs`.

    Returns:
        A mask of the ridges, shape (ridges,).
    """
    sides = ridges.box[:, 2:] - ridges.box[:, :2]  # rows and columns
    max_cells = RIDGE_WIDTH / ridges.lattice.cell_size + LIMIT_SLACK
    is_short = (sides <= max_cells).all(axis=1)
    surface = np.flatnonzero(is_ridge)
    is_cut_twice = (num_cells_across[surface] > 0).all(axis=1)
    num_cut_twice = np.bincount(ridges.region_of(surface), is_cut_twice, ridges.num)
    is_corner: Bool = is_short & (num_cut_twice == 0)
    return is_corner


def _mark_named_ridges(ridges: Regions, positions: list[list[float]]) -> Bool:
    """Mark the ridges on which one of some positions lies.

    Args:
        ridges: the connected ridges.
        positions: x, y, z of each [m].

    Returns:
        A mask of the ridges, shape (ridges,).
    """
    surfaces = ridges.surfaces
    lattice = ridges.lattice
    is_named = np.zeros(ridges.num, dtype=np.bool_)
    for x, y, z in positions:
        row, col = lattice.rows_cols([x, y])
        if not (0 <= row < lattice.height and 0 <= col < lattice.width):
            continue
        cell = int(row) * lattice.width + int(col)
        surface_ids = np.arange(surfaces.first[cell], surfaces.end[cell])
        is_near = np.abs(surfaces.z[surface_ids] - z) <= MAX_DISTANCE_ON_SURFACE + LIMIT_SLACK
        ridges_at_position = ridges.region_of(surface_ids[is_near])
        is_named[ridges_at_position[ridges_at_position >= 0]] = True
    return is_named


def without_surfaces(surfaces: Surfaces, mask: Bool) -> Surfaces:
    """Return surfaces of which those that a mask marks are neither standable nor floor-like.

    Args:
        surfaces: all surfaces.
        mask: shape (surfaces,).
    """
    return surfaces._replace(marks=np.where(mask, np.uint8(0), surfaces.marks))
