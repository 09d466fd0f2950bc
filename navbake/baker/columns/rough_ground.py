"""Let agents stand on rough ground: on small steep facets, such as those of scans or of gravel.

The slope of ground is that of the plane through what a foot covers, not that of a single facet:
facets of a scan are steeper than the floor that was scanned.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from navbake.baker.columns.columns import (
    Columns,
    RowChunk,
    TiledShapes,
    cast_points,
    tile_of,
    tiles_of_rows,
)
from navbake.baker.columns.ground_kernels import CELLS_PER_TILE, GroundLines, find_ground_rises
from navbake.baker.core.constants import CONVEX_SOLID
from navbake.baker.core.limits import AgentLimits, make_agent_limits
from navbake.baker.core.tiles import TILE
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
# Fewer lines than this are not worth a call on another thread
MIN_LINES_PER_CALL = 1 << 14


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
    cell_ids, hit_indices = _find_cells_of_hits(columns, hit_indices, is_selected)
    low_z = columns.z[hit_indices] + SAME_HEIGHT
    high_z = columns.z[hit_indices] + limits.headroom - LIMIT_SLACK
    lacks_headroom = np.empty(len(hit_indices), dtype=np.bool_)
    run_in_chunks(
        find_blocked_lines, len(hit_indices), cell_ids, low_z, high_z, columns.hits, lacks_headroom
    )
    return cell_ids[~lacks_headroom], hit_indices[~lacks_headroom]


def _find_cells_of_hits(
    columns: Columns, hit_indices: Int, is_selected: Bool | None
) -> tuple[Int, Int]:
    """Find the cell of each hit, and leave out the hits of invalid columns.

    Args:
        columns: the columns.
        hit_indices: indices of hits, ascending, (n,).
        is_selected: mask of the cells whose columns are valid, see `replace_rough_ground_normals`.

    Returns:
        The cells of the hits that remain, (k,), and the indices of these hits, (k,).
    """
    # A column has the hits from its start up to the next column's. Of several columns that start at
    # the same hit, all but the last are empty.
    if is_selected is None:  # there are no hits but those of the valid rows
        first_cell, end_cell = columns.valid_rows.cell_range(columns.lattice)
        starts = columns.start[first_cell:end_cell]
        return first_cell + np.searchsorted(starts, hit_indices, side="right") - 1, hit_indices
    selected_cells = np.flatnonzero(is_selected)
    first_hits = columns.start[selected_cells]
    end_hits = columns.start[selected_cells + 1]
    column_index = np.searchsorted(first_hits, hit_indices, side="right") - 1
    is_in_column = (column_index >= 0) & (hit_indices < end_hits[column_index])
    return selected_cells[column_index[is_in_column]], hit_indices[is_in_column]


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
        slope_x: how much each plane rises along x, (n,).
        slope_y: how much it rises along y, (n,).
        z: its height at the hit, relative to the hit, (n,) [m].
        is_determined: whether the samples determine a plane (they don't if they lie on a line),
            (n,). If not, the other values have no meaning.
    """

    slope_x: Float
    slope_y: Float
    z: Float
    is_determined: Bool

    @property
    def normal(self) -> Float:
        """Unit normals, (n, 3)."""
        normal_z = 1.0 / np.sqrt(1.0 + self.slope_x**2 + self.slope_y**2)
        return np.stack([-self.slope_x * normal_z, -self.slope_y * normal_z, normal_z], axis=1)


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
    is_sample = ~np.isnan(sample_heights)
    # by circle, half of the circle, and direction in this half
    is_sample_of_halves = is_sample.reshape(
        -1, len(SAMPLED_RADIUS_FRACTIONS), 2, NUM_DIRECTIONS // 2
    )
    is_used = is_sample_of_halves & is_sample_of_halves[:, :, ::-1]
    is_used = is_used.reshape(is_sample.shape)
    min_variance = MIN_VARIANCE_FRACTION * foot_radius(columns.lattice) ** 2
    planes = _fit_planes(sample_offsets, sample_heights, is_used, min_variance)
    unpaired_indices = np.flatnonzero(~planes.is_determined)
    is_used[unpaired_indices] = is_sample[unpaired_indices]
    planes_of_all_samples = _fit_planes(
        sample_offsets, sample_heights[unpaired_indices], is_sample[unpaired_indices], min_variance
    )
    for values, values_of_unpaired in zip(planes, planes_of_all_samples, strict=True):
        values[unpaired_indices] = values_of_unpaired
    normal = planes.normal
    is_clearly_different = (
        normal[unpaired_indices] * columns.normal[hit_indices[unpaired_indices]]
    ).sum(axis=1) <= MAX_DIFFERENT_COSINE
    planes.is_determined[unpaired_indices] &= is_clearly_different
    is_flat = planes.is_determined & (normal[:, 2] >= limits.min_normal_z)
    flat_indices = np.flatnonzero(is_flat)
    bump_heights = _measure_bumps(planes, flat_indices, sample_heights, sample_offsets)
    max_bump = np.max(bump_heights, axis=1, where=is_used[flat_indices], initial=0.0)
    max_bump = np.maximum(max_bump, np.abs(planes.z[flat_indices]))
    is_flat[flat_indices] = max_bump <= MAX_BUMP_FRACTION * limits.max_step + LIMIT_SLACK
    return normal, is_flat


def _measure_bumps(
    planes: GroundPlanes, plane_indices: Int, sample_heights: Float, sample_offsets: Float
) -> Float:
    """Return how far samples are above or below some of the planes through them.

    Args:
        planes: planes, one for each row of samples.
        plane_indices: indices of the planes, (k,).
        sample_heights: heights of the ground relative to each hit, NaN for none, (n, samples) [m].
        sample_offsets: x and y of the samples relative to the hit, (2, samples) [m].

    Returns:
        Vertical distances, NaN where there is no sample, (k, samples) [m].
    """
    distances = sample_heights[plane_indices] - planes.z[plane_indices, None]
    distances -= planes.slope_x[plane_indices, None] * sample_offsets[0]
    distances -= planes.slope_y[plane_indices, None] * sample_offsets[1]
    return np.abs(distances)


def _fit_planes(
    sample_offsets: Float, sample_heights: Float, is_used: Bool, min_variance: float
) -> GroundPlanes:
    """Fit a plane to each row of samples, and to the hit itself, which is at the origin.

    Args:
        sample_offsets: x and y of the samples relative to the hit, (2, samples) [m].
        sample_heights: their heights relative to the hit, NaN for none, (n, samples) [m].
        is_used: mask of the samples that count, (n, samples).
        min_variance: the samples determine a plane if their variance along each horizontal
            direction is at least this [m²].
    """
    # what depends on the places of the samples alone is computed once for each set of samples; a
    # set's number has a bit for each of the 16 samples
    sample_set = np.packbits(is_used, axis=1).view(np.uint16).ravel()
    _, first_of_set, set_index = np.unique(sample_set, return_index=True, return_inverse=True)
    is_in_set = is_used[first_of_set]
    num_samples = 1.0 + is_in_set.sum(axis=1)
    x = np.where(is_in_set, sample_offsets[0], 0.0)
    y = np.where(is_in_set, sample_offsets[1], 0.0)
    mean_x = x.sum(axis=1) / num_samples
    mean_y = y.sum(axis=1) / num_samples
    var_x = (x * x).sum(axis=1) / num_samples - mean_x**2
    var_y = (y * y).sum(axis=1) / num_samples - mean_y**2
    cov_xy = (x * y).sum(axis=1) / num_samples - mean_x * mean_y
    least_variance = (var_x + var_y) / 2.0 - np.hypot((var_x - var_y) / 2.0, cov_xy)
    is_determined = least_variance >= min_variance
    determinant = np.where(is_determined, var_x * var_y - cov_xy**2, 1.0)
    moments = np.stack([num_samples, mean_x, mean_y, var_x, var_y, cov_xy, determinant])
    num_samples, mean_x, mean_y, var_x, var_y, cov_xy, determinant = moments[:, set_index]
    z = np.where(is_used, sample_heights, 0.0)
    mean_z = z.sum(axis=1) / num_samples
    cov_xz = (z * sample_offsets[0]).sum(axis=1) / num_samples - mean_x * mean_z
    cov_yz = (z * sample_offsets[1]).sum(axis=1) / num_samples - mean_y * mean_z
    slope_x = (cov_xz * var_y - cov_yz * cov_xy) / determinant
    slope_y = (cov_yz * var_x - cov_xz * cov_xy) / determinant
    plane_z = mean_z - slope_x * mean_x - slope_y * mean_y
    return GroundPlanes(slope_x, slope_y, plane_z, is_determined[set_index])


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
    centers = lattice.positions(*np.divmod(cell_ids, lattice.width))
    points = (centers[:, None] + sample_offsets.T).reshape(-1, 2)
    z = np.repeat(columns.z[hit_indices], sample_offsets.shape[1])
    ground_heights = find_ground(tiled_shapes, points, z, limits.max_step + LIMIT_SLACK)
    return ground_heights.reshape(len(cell_ids), -1)


def find_ground(tiled_shapes: TiledShapes, points: Float, z: Float, max_rise: float) -> Float:
    """Find the ground at points: the highest surface that faces up, near a given height.

    The result is what the columns of `cast_points` give, in less time.

    Args:
        tiled_shapes: the shapes on a lattice.
        points: x and y of the points, (n, 2) [m].
        z: the height near which the ground of each point is, (n,) [m].
        max_rise: how far ground is above or below this height at most [m].

    Returns:
        How far the ground is above the heights, NaN where there is none and outside of the lattice,
        (n,) [m].
    """
    lattice = tiled_shapes.lattice
    rise = np.full(len(points), np.nan)
    is_uncertain = np.zeros(len(points), dtype=np.bool_)

    def find_rises(first_line: int, end_line: int) -> None:
        num_lines = end_line - first_line
        tiles = _tiles_of_lines(lattice, points[first_line:end_line, 1])
        lines = GroundLines(
            points=np.empty((num_lines, 2)),
            z=np.empty(num_lines),
            rise=np.full(num_lines, -np.inf),
            edge_rise=np.full(num_lines, -np.inf),
            original_index=np.empty(num_lines, dtype=np.int64),
            place=np.empty(num_lines, dtype=np.int64),
            first_tile=tiles.start,
            start=np.zeros(len(tiles) * CELLS_PER_TILE + 2, dtype=np.int64),
        )
        find_ground_rises(
            lattice,
            tiled_shapes.geometry,
            tiled_shapes.tile_index,
            points[first_line:end_line],
            z[first_line:end_line],
            max_rise,
            lines,
            rise[first_line:end_line],
            is_uncertain[first_line:end_line],
        )

    run_in_chunks(find_rises, len(points), min_chunk_size=MIN_LINES_PER_CALL)
    # a hit at a triangle's edge may be superfluous: whether it is, only the whole column tells
    uncertain_lines = np.flatnonzero(is_uncertain)
    if not len(uncertain_lines):  # the usual case; also casting no lines takes a while
        return rise
    rows, cols = lattice.rows_cols(points[uncertain_lines])
    cells = rows * lattice.width + cols
    order = np.argsort(tile_of(lattice, cells), kind="stable")  # lines of a tile are cast together
    uncertain_lines = uncertain_lines[order]
    hits = cast_points(tiled_shapes, cells[order], points[uncertain_lines])
    line_of_hit = np.repeat(uncertain_lines, np.diff(hits.start))
    rise_of_hit = hits.z - z[line_of_hit]
    is_ground_hit = (hits.normal[:, 2] > 0.0) & (np.abs(rise_of_hit) <= max_rise)
    # heights ascend along a line: the last assignment is that of the highest surface
    rise[line_of_hit[is_ground_hit]] = rise_of_hit[is_ground_hit]
    return rise


def _tiles_of_lines(lattice: Lattice, y: Float) -> range:
    """Return the ids of the tiles in all rows of tiles that some lines run through.

    Args:
        lattice: the cells.
        y: y of each line, at least one; also outside of the lattice [m].
    """
    rows, _ = lattice.rows_cols([[lattice.x_min, y.max()], [lattice.x_min, y.min()]])
    first_row, last_row = np.clip(rows, 0, lattice.height - 1).tolist()
    end_row = min((last_row // TILE + 1) * TILE, lattice.height)
    return tiles_of_rows(lattice, RowChunk(first_row, end_row))
