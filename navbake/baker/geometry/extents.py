"""Upright boxes around geoms, aligned with the sides of each geom."""

from typing import NamedTuple

import numpy as np

from navbake.baker.core.arrays import Solids
from navbake.baker.geometry.shapes import Shapes, support_distances
from navbake.baker.geometry.triangle_kernels import (
    QUARTER_TURN,
    find_facing_directions,
    measure_spans,
)
from navbake.threads import run_in_chunks
from navbake.types import Float, Int, Int32

# How many directions of vertical faces are distinguished, over a quarter turn
DIRECTIONS = 180
TRIANGLES_PER_CALL = 1 << 16  # whose directions are found at a time


class Extents(NamedTuple):
    """Upright boxes around geoms, by geom id; NaN for infinite planes and geoms that don't count.

    Attributes:
        center: x and y of the boxes' middles, (n, 2) [m].
        short_axis: horizontal unit vectors along the shorter sides, (n, 2).
        short_side: lengths of the shorter horizontal sides, (n,) [m].
        long_side: lengths of the longer horizontal sides, (n,) [m].
        bottom: heights of the bottoms, (n,) [m].
        top: heights of the tops, (n,) [m].
    """

    center: Float
    short_axis: Float
    short_side: Float
    long_side: Float
    bottom: Float
    top: Float

    @property
    def long_axis(self) -> Float:
        """Horizontal unit vectors along the longer sides, shape (n, 2), float64."""
        return np.stack([-self.short_axis[:, 1], self.short_axis[:, 0]], axis=1)

    def half_widths(self, geoms: Int, direction: Float) -> Float:
        """Return how far the boxes of geoms reach from their middles in a horizontal direction.

        Args:
            geoms: geom ids, (k,).
            direction: unit vectors, (2,) or (k, 2).

        Returns:
            shape (k,) [m].
        """
        on_short = np.abs((self.short_axis[geoms] * direction).sum(axis=-1))
        on_long = np.abs((self.long_axis[geoms] * direction).sum(axis=-1))
        widths = on_short * self.short_side[geoms] + on_long * self.long_side[geoms]
        return np.asarray(widths / 2)


def measure_extents(shapes: Shapes, num_geoms: int) -> Extents:
    """Compute the upright box of each geom that has geometry in `shapes`.

    A solid's box is aligned with the one of the solid's own axes that makes it smallest; a box of
    triangles is aligned with the direction that most of their vertical faces face.

    Args:
        shapes: the geometry.
        num_geoms: number of geoms in the scene.
    """
    extents = Extents(
        center=np.full((num_geoms, 2), np.nan),
        short_axis=np.full((num_geoms, 2), np.nan),
        short_side=np.full(num_geoms, np.nan),
        long_side=np.full(num_geoms, np.nan),
        bottom=np.full(num_geoms, np.nan),
        top=np.full(num_geoms, np.nan),
    )
    _measure_solids(shapes.solids, extents)
    for facets in shapes.facets_in_batches():
        if len(facets.geom):
            _measure_triangles(facets.geom, facets.corners, extents)
    return extents


def _measure_solids(solids: Solids, out: Extents) -> None:
    """Write the extents of solids."""
    axes = solids.mat.reshape(-1, 3, 3)
    least_area = np.full(len(solids.geom), np.inf)
    for axis in range(3):
        direction = axes[:, :2, axis]
        length = np.hypot(direction[:, 0], direction[:, 1])[:, None]
        direction = np.where(length > 1e-6, direction / np.maximum(length, 1e-6), [1.0, 0.0])
        normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
        half_along = _horizontal_half_widths(solids, axes, direction)
        half_across = _horizontal_half_widths(solids, axes, normal)
        area = half_along * half_across
        is_smaller = area < least_area * (1 - 1e-9)  # rounding alone never picks another axis
        least_area[is_smaller] = area[is_smaller]
        is_short = (half_along <= half_across)[:, None]
        geom = solids.geom[is_smaller]
        out.short_axis[geom] = np.where(is_short, direction, normal)[is_smaller]
        out.short_side[geom] = 2 * np.minimum(half_along, half_across)[is_smaller]
        out.long_side[geom] = 2 * np.maximum(half_along, half_across)[is_smaller]
    out.center[solids.geom] = solids.pos[:, :2]
    out.bottom[solids.geom] = solids.bounds[:, 2]
    out.top[solids.geom] = solids.bounds[:, 5]


def _horizontal_half_widths(solids: Solids, axes: Float, direction: Float) -> Float:
    """Return how far solids reach from their centres in horizontal directions, (n, 2); (n,) [m]."""
    local_direction = np.einsum("nij,ni->nj", axes[:, :2], direction)
    return support_distances(solids.kind, local_direction, solids.size)


def _measure_triangles(geom: Int32, corners: Float, out: Extents) -> None:
    """Write the extents of geoms made of triangles; `geom` is ascending."""
    first = np.flatnonzero(np.diff(geom, prepend=np.int32(-1)))
    geom_ids = geom[first]
    num_triangles = np.diff(first, append=len(geom))
    group = np.repeat(np.arange(len(first), dtype=np.int32), num_triangles)
    angle = facing_angles(corners, group, len(first))
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    low = np.full((len(first), 3), np.inf)
    high = np.full((len(first), 3), -np.inf)
    measure_spans(corners, group, direction, low, high)
    along, across, _ = (high - low).T
    middle = (low + high) / 2
    is_short = (along <= across)[:, None]
    out.short_axis[geom_ids] = np.where(is_short, direction, normal)
    out.short_side[geom_ids] = np.minimum(along, across)
    out.long_side[geom_ids] = np.maximum(along, across)
    out.center[geom_ids] = direction * middle[:, :1] + normal * middle[:, 1:2]
    out.bottom[geom_ids] = low[:, 2]
    out.top[geom_ids] = high[:, 2]


def facing_angles(corners: Float, group: Int32, num_groups: int) -> Float:
    """Find the horizontal direction that most vertical faces of each group face.

    Args:
        corners: of triangles, shape (m, 3, 3) [m].
        group: of each triangle, below `num_groups`, (m,).
        num_groups: number of groups.

    Returns:
        The angle from x, modulo a quarter turn, (num_groups,) [rad].
    """
    # by group and direction: the area of faces as seen from the side, and the same times the angle
    # to the direction
    area = np.zeros(num_groups * DIRECTIONS)
    area_times_angle = np.zeros(num_groups * DIRECTIONS)
    direction = np.empty(TRIANGLES_PER_CALL, np.int32)
    weight = np.empty(TRIANGLES_PER_CALL)
    weighted_angle = np.empty(TRIANGLES_PER_CALL)
    for first in range(0, len(group), TRIANGLES_PER_CALL):
        batch = corners[first : first + TRIANGLES_PER_CALL]
        run_in_chunks(
            find_facing_directions,
            len(batch),
            batch,
            DIRECTIONS,
            direction,
            weight,
            weighted_angle,
            least=4096,
        )
        first_entry = group[first : first + TRIANGLES_PER_CALL] * np.int64(DIRECTIONS)
        entry = first_entry + direction[: len(batch)]
        np.add.at(area, entry, weight[: len(batch)])
        np.add.at(area_times_angle, entry, weighted_angle[: len(batch)])
    best = area.reshape(num_groups, DIRECTIONS).argmax(axis=1)
    best_entry = np.arange(num_groups) * DIRECTIONS + best
    best_area = area[best_entry]
    best_sum = area_times_angle[best_entry]
    offset = best_sum / np.where(best_area > 0.0, best_area, 1.0)
    angle: Float = best * (QUARTER_TURN / DIRECTIONS) + offset
    return angle
