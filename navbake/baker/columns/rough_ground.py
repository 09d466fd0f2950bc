"""Let agents stand on rough ground: on small steep facets, such as those of scans or of gravel.

The slope of ground is that of the plane through what a foot covers, not that of a single facet:
facets of a scan are steeper than the floor that was scanned.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from navbake.baker.columns.columns import Columns, TiledShapes, cast_points, tile_of
from navbake.baker.columns.ground_kernels import GroundLines, raise_ground
from navbake.baker.core.constants import CONVEX_SOLID
from navbake.baker.core.limits import AgentLimits, make_agent_limits
from navbake.baker.core.tolerances import LIMIT_SLACK, SAME_HEIGHT
from navbake.baker.geometry.overlap_kernels import find_blocked_lines
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import run_in_chunks
from navbake.types import Bool, Float, Int

# The radius of the ground that a foot covers; on larger cells, the cells' size is the radius [m]
FOOT_RADIUS = 0.1
# Points around a cell's line at which the ground is sampled: in this many directions, on circles
# whose radii are these fractions of the foot's radius
NUM_DIRECTIONS = 8
SAMPLED_RADIUS_FRACTIONS = (0.5, 1.0)
# Of these samples, those on the outer circle east, north, west and south of the line
AXIS_SAMPLES = slice(-NUM_DIRECTIONS, None, NUM_DIRECTIONS // 4)
# These four decide first whether the ground is clearly too steep: it is if the plane through them
# rises more than this many times as much as the agent's steepest slope
CLEARLY_STEEP_FACTOR = 1.5
# Bumps are at most this fraction of a step above or below the plane through the ground
MAX_BUMP_FRACTION = 1.0 / 3.0
# The samples determine a plane if their least variance along any horizontal direction is at least
# this fraction of the squared radius: samples along a line don't
MIN_VARIANCE_FRACTION = 0.02
# A facet differs from the plane clearly if the cosine of their angle is at most this
MAX_DIFFERENT_COSINE = np.cos(np.radians(10.0))
# Facets around which all threads sample the ground at a time, which limits the memory that it takes
FACETS_AT_A_TIME = 1 << 17
# Fewer facets than this are not worth a call on another thread
MIN_FACETS_PER_CALL = 1024
# Fewer hits than this are not worth a call on another thread
MIN_HITS_PER_CALL = 1 << 16
# Lines over fewer tiles than this are not worth a call on another thread
MIN_TILES_PER_CALL = 8


def foot_radius(lattice: Lattice) -> float:
    """Return the radius around a cell's centre in which the ground is sampled [m].

    It is the radius of a foot, or the edge of a cell if that is larger.
    """
    return max(FOOT_RADIUS, lattice.cell_size)


def replace_rough_ground_normals(
    columns: Columns,
    tiled_shapes: TiledShapes,
    agent: AgentSettings,
    is_selected: Bool | None = None,
) -> Columns:
    """Replace the normals of steep facets where the ground around them is flat enough as a whole.

    An agent can then stand on them. A triangle steeper than the agent's slope, with the agent's
    headroom above it, receives the normal of a plane that is fitted to samples of the ground around
    it. The plane may not be steeper than the agent's slope, and each sample has to lie within a
    third of a step of it. Primitives and hulls are smooth, and keep their normals.

    Four of the samples, east, north, west and south of the centre, are compared first: if the
    ground between them is much steeper than the agent's slope, the facet keeps its normal, and no
    plane is fitted.

    The ground is sampled by vertical rays on circles around the cell's centre, up to `foot_radius`
    away. A ray's sample is the highest surface that faces up and lies at most a step above or below
    the triangle. Samples outside of the lattice don't count. The plane is fitted to the samples
    that have a partner on the opposite side of the centre. If these determine no plane, as beside
    walls, it is fitted to all samples, see `_mark_flat_ground`. The result for a cell does not
    depend on the columns of other cells.

    Args:
        columns: the columns.
        tiled_shapes: the shapes that they were cast from, listed also for cells within
            `foot_radius`.
        agent: the agent: its slope, step and height.
        is_selected: mask of the cells whose columns are valid, shape (cells,); None for those of
            `columns.valid_rows`.
    """
    limits = make_agent_limits(agent)
    cell_ids, hit_indices = _find_steep_facets(columns, limits, is_selected)
    if not len(hit_indices):
        return columns
    normal = columns.normal.copy()
    sample_offsets = make_sample_offsets(foot_radius(columns.lattice))

    def replace_normals(first_facet: int, end_facet: int) -> None:
        chunk_hits = hit_indices[first_facet:end_facet]
        sample_heights = _sample_ground(
            columns,
            tiled_shapes,
            limits,
            cell_ids[first_facet:end_facet],
            chunk_hits,
            sample_offsets,
        )
        is_steep = _mark_clearly_steep(sample_heights, sample_offsets, limits)
        chunk_hits = chunk_hits[~is_steep]
        plane_normal, is_ground = _mark_flat_ground(
            columns, limits, chunk_hits, sample_heights[~is_steep], sample_offsets
        )
        normal[chunk_hits[is_ground]] = plane_normal[is_ground]

    for first_facet in range(0, len(hit_indices), FACETS_AT_A_TIME):
        run_in_chunks(
            replace_normals,
            min(FACETS_AT_A_TIME, len(hit_indices) - first_facet),
            begin=first_facet,
            min_chunk_size=MIN_FACETS_PER_CALL,
        )
    return replace(columns, hits=columns.hits._replace(normal=normal))


def _find_steep_facets(
    columns: Columns, limits: AgentLimits, is_selected: Bool | None
) -> tuple[Int, Int]:
    """Find the hits on which an agent could stand if they were less steep; none of convex solids.

    Args:
        columns: the columns.
        limits: the agent's limits.
        is_selected: mask of the cells whose columns are valid, see `replace_rough_ground_normals`.

    Returns:
        The cells of the hits, (n,), and the indices of the hits, (n,).
    """
    steep_hits_of_chunk = {0: np.empty(0, dtype=np.int64)}  # by the first hit of the chunk

    def find_steep_hits(first_hit: int, end_hit: int) -> None:
        chunk = slice(first_hit, end_hit)
        steep_hits = first_hit + np.flatnonzero(columns.hits.closed[chunk] != CONVEX_SOLID)
        normal_z = columns.normal[steep_hits, 2]
        is_steep = (normal_z > 0.0) & (normal_z < limits.min_normal_z)
        steep_hits_of_chunk[first_hit] = steep_hits[is_steep]

    run_in_chunks(find_steep_hits, len(columns.z), min_chunk_size=MIN_HITS_PER_CALL)
    hit_indices = np.concatenate(
        [steep_hits_of_chunk[first_hit] for first_hit in sorted(steep_hits_of_chunk)]
    )
    if not len(hit_indices):
        return hit_indices, hit_indices
    # all other columns may be invalid; the hits of these are in the order of their cells
    first_cell, end_cell = columns.valid_rows.cell_range(columns.lattice)
    cells = np.arange(first_cell, end_cell)
    if is_selected is not None:
        cells = np.flatnonzero(is_selected)
    first_hits = columns.start[cells]
    end_hits = columns.start[cells + 1]
    # of several columns that begin at the same hit, all but the last are empty
    column_index = np.searchsorted(first_hits, hit_indices, side="right") - 1
    is_in_column = (column_index >= 0) & (hit_indices < end_hits[column_index])
    column_index = column_index[is_in_column]
    hit_indices = hit_indices[is_in_column]
    cell_ids = cells[column_index]
    low_z = columns.z[hit_indices] + SAME_HEIGHT
    high_z = columns.z[hit_indices] + limits.headroom - LIMIT_SLACK
    lacks_headroom = np.empty(len(hit_indices), dtype=np.bool_)
    run_in_chunks(
        find_blocked_lines, len(hit_indices), cell_ids, low_z, high_z, columns.hits, lacks_headroom
    )
    return cell_ids[~lacks_headroom], hit_indices[~lacks_headroom]


def _mark_clearly_steep(sample_heights: Float, sample_offsets: Float, limits: AgentLimits) -> Bool:
    """Mark the hits around which the ground rises much more than the agent's slope.

    Args:
        sample_heights: heights of the ground relative to each hit, NaN for none, (n, samples) [m].
        sample_offsets: x and y of the samples relative to the hit, (2, samples) [m].
        limits: the agent's limits.
    """
    east, north, west, south = sample_heights[:, AXIS_SAMPLES].T
    radius = sample_offsets[0, AXIS_SAMPLES][0]
    slope = np.hypot(east - west, north - south) / (2.0 * radius)  # NaN where a sample is missing
    max_slope = math.sqrt(1.0 / limits.min_normal_z**2 - 1.0)
    is_steep: Bool = slope > CLEARLY_STEEP_FACTOR * max_slope
    return is_steep


def make_sample_offsets(radius: float) -> Float:
    """Return where the ground is sampled: x and y relative to a hit, (2, samples) [m].

    The samples lie on circles around the hit, the innermost first, and there counter-clockwise
    from x.

    Args:
        radius: the radius of the outermost circle [m].
    """
    angle = np.arange(NUM_DIRECTIONS) * (2.0 * np.pi / NUM_DIRECTIONS)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    return np.concatenate(
        [fraction * radius * circle for fraction in SAMPLED_RADIUS_FRACTIONS], axis=1
    )


class GroundPlanes(NamedTuple):
    """Planes fitted to samples of the ground around hits, by least squares.

    Attributes:
        normal: unit normals, (n, 3).
        max_bump: the greatest vertical distance of a sample from its plane, (n,) [m].
        is_determined: whether the samples determine a plane (they don't if they lie on a line),
            (n,). If not, the other values have no meaning.
    """

    normal: Float
    max_bump: Float
    is_determined: Bool


def _mark_flat_ground(
    columns: Columns,
    limits: AgentLimits,
    hit_indices: Int,
    sample_heights: Float,
    sample_offsets: Float,
) -> tuple[Float, Bool]:
    """Fit planes to the ground around hits, and mark the planes that are flat enough.

    A plane is fitted to the pairs of samples on opposite sides of the cell's line, if these
    determine a plane: so a smooth slope keeps its own steepness, however it bends. Beside walls and
    edges they determine none, and all samples count. The steep facet then has to differ clearly
    from the plane through them.

    Args:
        columns: the columns.
        limits: the agent's limits.
        hit_indices: indices of hits, (n,).
        sample_heights: heights of the ground relative to each hit, NaN for none, (n, samples) [m].
        sample_offsets: x and y of the samples relative to the hit, (2, samples) [m].

    Returns:
        The unit normals of the planes, (n, 3), and which of the planes are ground that the agent
        can stand on, (n,).
    """
    directions_per_half_turn = NUM_DIRECTIONS // 2
    opposite_heights = np.roll(
        sample_heights.reshape(-1, len(SAMPLED_RADIUS_FRACTIONS), NUM_DIRECTIONS),
        directions_per_half_turn,
        axis=2,
    )
    paired_heights = np.where(
        np.isnan(opposite_heights.reshape(sample_heights.shape)), np.nan, sample_heights
    )
    min_variance = MIN_VARIANCE_FRACTION * foot_radius(columns.lattice) ** 2
    planes = _fit_planes(sample_offsets, paired_heights, min_variance)
    unpaired_indices = np.flatnonzero(~planes.is_determined)
    planes_of_all_samples = _fit_planes(
        sample_offsets, sample_heights[unpaired_indices], min_variance
    )
    is_clearly_different = (
        planes_of_all_samples.normal * columns.normal[hit_indices[unpaired_indices]]
    ).sum(axis=1) <= MAX_DIFFERENT_COSINE
    planes.normal[unpaired_indices] = planes_of_all_samples.normal
    planes.max_bump[unpaired_indices] = planes_of_all_samples.max_bump
    planes.is_determined[unpaired_indices] = (
        planes_of_all_samples.is_determined & is_clearly_different
    )
    is_flat = planes.is_determined & (planes.normal[:, 2] >= limits.min_normal_z)
    is_flat &= planes.max_bump <= MAX_BUMP_FRACTION * limits.max_step + LIMIT_SLACK
    return planes.normal, is_flat


def _fit_planes(sample_offsets: Float, sample_heights: Float, min_variance: float) -> GroundPlanes:
    """Fit a plane to each row of samples, and to the hit itself, which is at the origin.

    Args:
        sample_offsets: x and y of the samples relative to the hit, (2, samples) [m].
        sample_heights: their heights relative to the hit, NaN for none, (n, samples) [m].
        min_variance: the samples determine a plane if their variance along each horizontal
            direction is at least this [m²].
    """
    is_sample = ~np.isnan(sample_heights)
    num_samples = 1.0 + is_sample.sum(axis=1)
    x = np.where(is_sample, sample_offsets[0], 0.0)
    y = np.where(is_sample, sample_offsets[1], 0.0)
    z = np.where(is_sample, sample_heights, 0.0)
    mean_x = x.sum(axis=1) / num_samples
    mean_y = y.sum(axis=1) / num_samples
    mean_z = z.sum(axis=1) / num_samples
    var_x = (x * x).sum(axis=1) / num_samples - mean_x**2
    var_y = (y * y).sum(axis=1) / num_samples - mean_y**2
    cov_xy = (x * y).sum(axis=1) / num_samples - mean_x * mean_y
    cov_xz = (x * z).sum(axis=1) / num_samples - mean_x * mean_z
    cov_yz = (y * z).sum(axis=1) / num_samples - mean_y * mean_z
    least_variance = (var_x + var_y) / 2.0 - np.hypot((var_x - var_y) / 2.0, cov_xy)
    is_determined = least_variance >= min_variance
    determinant = np.where(is_determined, var_x * var_y - cov_xy**2, 1.0)
    slope_x = (cov_xz * var_y - cov_yz * cov_xy) / determinant
    slope_y = (cov_yz * var_x - cov_xz * cov_xy) / determinant
    plane_z_at_hit = mean_z - slope_x * mean_x - slope_y * mean_y  # at the hit
    bump_heights = np.abs(z - plane_z_at_hit[:, None] - slope_x[:, None] * x - slope_y[:, None] * y)
    max_bump = np.maximum(
        np.where(is_sample, bump_heights, 0.0).max(axis=1), np.abs(plane_z_at_hit)
    )
    normal_z = 1.0 / np.sqrt(1.0 + slope_x**2 + slope_y**2)
    return GroundPlanes(
        np.stack([-slope_x * normal_z, -slope_y * normal_z, normal_z], axis=1),
        max_bump,
        is_determined,
    )


def _sample_ground(
    columns: Columns,
    tiled_shapes: TiledShapes,
    limits: AgentLimits,
    cell_ids: Int,
    hit_indices: Int,
    sample_offsets: Float,
) -> Float:
    """Sample the ground around hits.

    Args:
        columns: the columns.
        tiled_shapes: the shapes.
        limits: the agent's limits.
        cell_ids: the cell of each hit, (n,).
        hit_indices: indices of hits, (n,).
        sample_offsets: x and y of the samples relative to the cell's centre, (2, samples) [m].

    Returns:
        The heights of the ground relative to the hit, NaN where there is none, (n, samples) [m].
    """
    lattice = columns.lattice
    num_samples = sample_offsets.shape[1]
    centers = lattice.positions(*np.divmod(cell_ids, lattice.width))
    points = (centers[:, None] + sample_offsets.T).reshape(-1, 2)
    rows, cols = lattice.rows_cols(points)
    is_inside = (rows >= 0) & (rows < lattice.height) & (cols >= 0) & (cols < lattice.width)
    inside_indices = np.flatnonzero(is_inside)
    ground_heights = np.full(len(points), np.nan)
    ground_heights[inside_indices] = find_ground(
        tiled_shapes,
        (rows * lattice.width + cols)[inside_indices],
        points[inside_indices],
        columns.z[hit_indices][inside_indices // num_samples],
        limits.max_step + LIMIT_SLACK,
    )
    return ground_heights.reshape(len(cell_ids), -1)


def find_ground(
    tiled_shapes: TiledShapes, cells: Int, points: Float, z: Float, max_rise: float
) -> Float:
    """Find the ground at points: the highest surface that faces up, near a given height.

    The result is what the columns of `cast_points` give, in less time.

    Args:
        tiled_shapes: the shapes on a lattice.
        cells: id of the cell that holds each point, (n,).
        points: x and y of the points, (n, 2) [m].
        z: the height near which the ground of each point is, (n,) [m].
        max_rise: how far ground is above or below this height at most [m].

    Returns:
        How far the ground is above the heights, NaN where there is none, (n,) [m].
    """
    lattice = tiled_shapes.lattice
    tiles = tile_of(lattice, cells)
    order = np.argsort(tiles * lattice.width * lattice.height + cells)
    is_first_of_tile = np.diff(tiles[order], prepend=-1) > 0
    lines = GroundLines(
        points=points[order],
        cells=cells[order],
        z=z[order],
        tiles=tiles[order][is_first_of_tile],
        start=np.append(np.flatnonzero(is_first_of_tile), len(cells)),
    )
    rise_in_order = np.full(len(cells), -np.inf)
    edge_rise = np.full(len(cells), -np.inf)
    run_in_chunks(
        raise_ground,
        len(lines.tiles),
        lattice,
        tiled_shapes.geometry,
        tiled_shapes.tile_index,
        lines,
        max_rise,
        rise_in_order,
        edge_rise,
        min_chunk_size=MIN_TILES_PER_CALL,
    )
    rise = np.full(len(cells), np.nan)
    is_ground = rise_in_order > -np.inf
    rise[order[is_ground]] = rise_in_order[is_ground]
    # a hit at a triangle's edge may be superfluous: whether it is, only the whole column tells
    uncertain_lines = order[edge_rise > rise_in_order]
    rise[uncertain_lines] = np.nan
    hits = cast_points(tiled_shapes, cells[uncertain_lines], points[uncertain_lines])
    line_of_hit = np.repeat(uncertain_lines, np.diff(hits.start))
    rise_of_hit = hits.z - z[line_of_hit]
    is_ground_hit = (hits.normal[:, 2] > 0.0) & (np.abs(rise_of_hit) <= max_rise)
    # heights ascend along a line: the last assignment is that of the highest surface
    rise[line_of_hit[is_ground_hit]] = rise_of_hit[is_ground_hit]
    return rise
