"""Measure the upright box around each geom: rotated about z so that it follows the geom's sides."""

from typing import NamedTuple

import numpy as np

from navbake.baker.core.arrays import Facets, Solids
from navbake.baker.geometry.shapes import Shapes, support_distances
from navbake.baker.geometry.triangle_kernels import (
    QUARTER_TURN,
    find_facing_directions,
    measure_spans,
)
from navbake.threads import run_in_chunks
from navbake.types import Float, Int, Int32

# To find the direction that most vertical faces of a geom face, a quarter turn is divided into this
# many directions, half a degree apart
NUM_DIRECTIONS = 180
# The directions of this many triangles are found at a time
TRIANGLES_PER_CALL = 1 << 16


class Extents(NamedTuple):
    """Upright boxes around geoms, rotated about z; index n of each array is for geom id n.

    Infinite planes, and geoms that don't count, have NaN.

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

    def half_widths(self, geom_ids: Int, direction: Float) -> Float:
        """Return half the width of geoms' boxes, measured along a horizontal direction.

        Args:
            geom_ids: geom ids, shape (k,).
            direction: unit vectors, shape (2,) or (k, 2).

        Returns:
            Half widths, shape (k,) [m].
        """
        short_axis_cosine = np.abs((self.short_axis[geom_ids] * direction).sum(axis=-1))
        long_axis_cosine = np.abs((self.long_axis[geom_ids] * direction).sum(axis=-1))
        widths = (
            short_axis_cosine * self.short_side[geom_ids]
            + long_axis_cosine * self.long_side[geom_ids]
        )
        return np.asarray(widths / 2)


def measure_extents(shapes: Shapes, num_geoms: int) -> Extents:
    """Compute the upright box of each geom that has geometry in `shapes`.

    A solid's box follows one of the solid's own axes: the one that makes the box smallest, seen
    from above. A box around triangles follows the direction that most of their vertical faces face.

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
    _measure_triangles(shapes, extents)
    return extents


def _measure_solids(solids: Solids, extents: Extents) -> None:
    """Compute the upright boxes of solids, and write them to `extents`, at the solids' geom ids."""
    axes = solids.mat.reshape(-1, 3, 3)
    least_area = np.full(len(solids.geom), np.inf)
    for axis in range(3):
        direction = axes[:, :2, axis]
        horizontal_length = np.hypot(direction[:, 0], direction[:, 1])[:, None]
        direction = np.where(
            horizontal_length > 1e-6, direction / np.maximum(horizontal_length, 1e-6), [1.0, 0.0]
        )
        perpendicular = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
        half_width_along = _horizontal_half_widths(solids, axes, direction)
        half_width_across = _horizontal_half_widths(solids, axes, perpendicular)
        area = half_width_along * half_width_across
        is_smaller = area < least_area * (1 - 1e-9)  # rounding alone never picks another axis
        least_area[is_smaller] = area[is_smaller]
        is_short = (half_width_along <= half_width_across)[:, None]
        geom_ids = solids.geom[is_smaller]
        extents.short_axis[geom_ids] = np.where(is_short, direction, perpendicular)[is_smaller]
        extents.short_side[geom_ids] = (
            2 * np.minimum(half_width_along, half_width_across)[is_smaller]
        )
        extents.long_side[geom_ids] = (
            2 * np.maximum(half_width_along, half_width_across)[is_smaller]
        )
    extents.center[solids.geom] = solids.pos[:, :2]
    extents.bottom[solids.geom] = solids.bounds[:, 2]
    extents.top[solids.geom] = solids.bounds[:, 5]


def _horizontal_half_widths(solids: Solids, axes: Float, direction: Float) -> Float:
    """Return half the width of solids, measured along horizontal directions.

    Args:
        solids: n solids.
        axes: their rotation matrices, shape (n, 3, 3).
        direction: a unit vector for each solid, shape (n, 2).

    Returns:
        Half widths, shape (n,) [m].
    """
    local_direction = np.einsum("nij,ni->nj", axes[:, :2], direction)
    return support_distances(solids.kind, local_direction, solids.size)


def _measure_triangles(shapes: Shapes, extents: Extents) -> None:
    """Compute the upright boxes of geoms made of triangles, and write them to `extents`."""
    geom_ids = np.unique(shapes.meshes.geom)
    if not len(geom_ids):
        return
    group_of_geom = np.zeros(int(geom_ids[-1]) + 1, dtype=np.int32)
    group_of_geom[geom_ids] = np.arange(len(geom_ids))
    facing_areas = FacingAreas(len(geom_ids))
    for facets in shapes.facets_in_batches():
        facing_areas.add(facets, group_of_geom[facets.geom])
    angle = facing_areas.find_angles()
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    perpendicular = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    lowest_coordinates = np.full((len(geom_ids), 3), np.inf)
    highest_coordinates = np.full((len(geom_ids), 3), -np.inf)
    for facets in shapes.facets_in_batches():
        measure_spans(
            facets.vertices,
            facets.faces,
            group_of_geom[facets.geom],
            direction,
            lowest_coordinates,
            highest_coordinates,
        )
    width_along, width_across, _ = (highest_coordinates - lowest_coordinates).T
    middle_coordinates = (lowest_coordinates + highest_coordinates) / 2
    is_short = (width_along <= width_across)[:, None]
    extents.short_axis[geom_ids] = np.where(is_short, direction, perpendicular)
    extents.short_side[geom_ids] = np.minimum(width_along, width_across)
    extents.long_side[geom_ids] = np.maximum(width_along, width_across)
    extents.center[geom_ids] = (
        direction * middle_coordinates[:, :1] + perpendicular * middle_coordinates[:, 1:2]
    )
    extents.bottom[geom_ids] = lowest_coordinates[:, 2]
    extents.top[geom_ids] = highest_coordinates[:, 2]


class FacingAreas:
    """Finds the horizontal direction that most vertical faces of a group of triangles face.

    A face counts by its area as seen from the side. Directions a quarter turn apart count as equal.
    Triangles are added bit by bit, so that they need not all be in memory.
    """

    def __init__(self, num_groups: int) -> None:
        """Start without triangles.

        Args:
            num_groups: number of groups.
        """
        # for each group and direction: the area of its faces as seen from the side, and the sum of
        # these areas times the angle from the direction
        self._area = np.zeros(num_groups * NUM_DIRECTIONS)
        self._area_times_angle = np.zeros(num_groups * NUM_DIRECTIONS)
        self._num_groups = num_groups

    def add(self, facets: Facets, group_of_triangle: Int32) -> None:
        """Add triangles.

        Args:
            facets: m triangles.
            group_of_triangle: the group of each triangle, from 0, shape (m,).
        """
        direction_index = np.empty(TRIANGLES_PER_CALL, np.int32)
        double_side_area = np.empty(TRIANGLES_PER_CALL)
        area_times_angle = np.empty(TRIANGLES_PER_CALL)
        for first_triangle in range(0, len(group_of_triangle), TRIANGLES_PER_CALL):
            batch_faces = facets.faces[first_triangle : first_triangle + TRIANGLES_PER_CALL]
            run_in_chunks(
                find_facing_directions,
                len(batch_faces),
                facets.vertices,
                batch_faces,
                NUM_DIRECTIONS,
                direction_index,
                double_side_area,
                area_times_angle,
                min_chunk_size=4096,
            )
            first_index_of_group = group_of_triangle[
                first_triangle : first_triangle + TRIANGLES_PER_CALL
            ] * np.int64(NUM_DIRECTIONS)
            flat_index = first_index_of_group + direction_index[: len(batch_faces)]
            np.add.at(self._area, flat_index, double_side_area[: len(batch_faces)])
            np.add.at(self._area_times_angle, flat_index, area_times_angle[: len(batch_faces)])

    def find_angles(self) -> Float:
        """Find, for each group, the horizontal direction that most of its vertical faces face.

        Returns:
            The angle of that direction from x, from 0 to a quarter turn, shape (groups,) [rad].
        """
        best_direction = self._area.reshape(self._num_groups, NUM_DIRECTIONS).argmax(axis=1)
        best_flat_index = np.arange(self._num_groups) * NUM_DIRECTIONS + best_direction
        best_area = self._area[best_flat_index]
        best_area_times_angle = self._area_times_angle[best_flat_index]
        mean_angle_offset = best_area_times_angle / np.where(best_area > 0.0, best_area, 1.0)
        angle: Float = best_direction * (QUARTER_TURN / NUM_DIRECTIONS) + mean_angle_offset
        return angle
