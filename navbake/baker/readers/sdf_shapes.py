"""Geometry of SDF that MuJoCo has no shape for: height maps, extruded outlines and images.

The area that outlines (``<polyline>``) enclose is cut into trapezoids, at the y of corners and
crossings, and each trapezoid becomes a convex prism. So holes, and outlines that cross themselves,
need no rules of their own. A trapezoid is not cut at the y of a corner elsewhere: it goes on as
long as its two sides do. So there are about as many trapezoids as corners and crossings. What an
odd number of outlines encloses is solid, as in Gazebo.

Sources: SDFormat specification 1.12, geometry.sdf; gazebosim/gz-common, MeshManager.cc
(ExtrudePolyline: several outlines, the first one's height) and DelaunayTriangulation.cc (what an
even number of outlines encloses is a hole); gazebosim/gazebo-classic,
MapShape.cc (pixels that are not brighter than the threshold are boxes, from the corner of the
first pixel on).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from navbake.baker.geometry.shapes import Mesh, hull_faces
from navbake.errors import FormatError, SceneError
from navbake.formats.floor_mesh import cover_with_quads
from navbake.formats.source import read_pixels
from navbake.types import Float

HEIGHT_FIELD_BASE = 0.1  # thickness of a height field below its lowest point [m]
MIN_HEIGHT_RANGE = 1e-6  # least difference between a height field's highest and lowest point [m]
MIN_SLICE_HEIGHT = 1e-9  # least size of a trapezoid along y [m]
# The most edges that the outlines of a geometry may have, as all pairs are tested for crossings
MAX_EDGES = 2000
# The most heights (y) at which these edges may cross: each makes more prisms, and outlines of
# buildings hardly ever cross
MAX_CROSSINGS = 500
MAX_BOXES = 20_000  # the most boxes that an image may stand for


class HeightField(NamedTuple):
    """A height field that is read from an image.

    Attributes:
        heights: the heights, scaled to 0 to 1; row 0 is at the smallest y.
        size: the size as MuJoCo states it: half of the width, half of the depth, the difference
            between the highest and lowest point, and the thickness of the base [m].
        lowest_height: the lowest height [m].
    """

    heights: Float
    size: tuple[float, float, float, float]
    lowest_height: float


def read_height_field(file: Path, dimensions: Sequence[float]) -> HeightField:
    """Read a height field from an image: the brighter a pixel, the higher the ground.

    The first row of pixels is at the largest y.

    Args:
        file: the image.
        dimensions: the height field's width, its depth, and the height of the brightest pixel [m].

    Raises:
        SceneError: the image is broken.
    """
    brightness = _read_brightness(file)[::-1]
    brightness /= max(float(brightness.max()), 1.0)
    min_brightness = float(brightness.min())
    max_brightness = float(brightness.max())
    height_range = max((max_brightness - min_brightness) * dimensions[2], MIN_HEIGHT_RANGE)
    return HeightField(
        heights=(brightness - min_brightness) / ((max_brightness - min_brightness) or 1.0),
        size=(dimensions[0] / 2, dimensions[1] / 2, height_range, HEIGHT_FIELD_BASE),
        lowest_height=min_brightness * dimensions[2],
    )


def _read_brightness(file: Path, white_value: float | None = None) -> Float:
    """Read the brightness of an image's pixels, shape (height, width).

    Args:
        file: the image.
        white_value: the number that stands for white; None to leave the numbers of the file as they
            are.
    """
    try:
        pixels = read_pixels(file)
    except FormatError as error:
        raise SceneError(str(error)) from error
    brightness: Float = pixels.channel_sum.astype(np.float64)
    if white_value is not None:
        brightness *= white_value / (3.0 * pixels.max_channel)
    return brightness


class ImageBox(NamedTuple):
    """A box over dark pixels of an image.

    Attributes:
        center: x, y [m], from the corner of the image's first pixel.
        half_sizes: half of its size along x and y [m].
    """

    center: tuple[float, float]
    half_sizes: tuple[float, float]


def read_image_boxes(file: Path, pixel_size: float, threshold: float) -> list[ImageBox]:
    """Read an image whose dark pixels stand for boxes, and join adjacent pixels to few boxes.

    Args:
        file: the image; its columns run along x, its rows along y.
        pixel_size: the edge of a pixel [m].
        threshold: pixels up to this brightness are dark; white is 255.

    Raises:
        SceneError: the image is broken, or needs more than `MAX_BOXES` boxes.
    """
    is_dark = _read_brightness(file, white_value=255.0) <= threshold
    quads = cover_with_quads(is_dark.astype(np.int32), np.zeros(is_dark.shape), 0.0, 0.0, 0.0)
    num_boxes = len(quads.first_cell)
    if num_boxes > MAX_BOXES:
        hint = "make the image smaller, or its threshold lower"
        raise SceneError(f"{file} stands for {num_boxes} boxes, {MAX_BOXES} at most: {hint}")
    x = pixel_size * quads.cols
    y = pixel_size * quads.rows
    lowest_corners = np.stack([x.min(axis=1), y.min(axis=1)], axis=1)
    highest_corners = np.stack([x.max(axis=1), y.max(axis=1)], axis=1)
    centers = (lowest_corners + highest_corners) / 2
    half_sizes = (highest_corners - lowest_corners) / 2
    return [
        ImageBox((center_x, center_y), (half_x, half_y))
        for (center_x, center_y), (half_x, half_y) in zip(
            centers.tolist(), half_sizes.tolist(), strict=True
        )
    ]


def extrude_outlines(outlines: Sequence[Float], height: float) -> list[Mesh]:
    """Divide the area that outlines enclose into convex prisms, from z = 0 upwards.

    Args:
        outlines: the corners x, y of each outline, closed or not, (n, 2) [m].
        height: the height of the prisms [m].

    Returns:
        Convex prisms that touch; none if the outlines enclose nothing.

    Raises:
        ValueError: the outlines have more than `MAX_EDGES` edges, or these cross at more than
            `MAX_CROSSINGS` heights (y).
    """
    with np.errstate(all="ignore"):  # coordinates near the largest numbers make no prism
        return _extrude(outlines, height)


def _extrude(outlines: Sequence[Float], height: float) -> list[Mesh]:
    """Make prisms of what outlines enclose, see `extrude_outlines`; numbers may overflow."""
    edge_starts = np.concatenate(outlines)
    edge_ends = np.concatenate([np.roll(outline, -1, axis=0) for outline in outlines])
    is_horizontal = edge_starts[:, 1] == edge_ends[:, 1]
    points_down = edge_starts[:, 1] > edge_ends[:, 1]
    lower_ends = np.where(points_down[:, None], edge_ends, edge_starts)[~is_horizontal]
    upper_ends = np.where(points_down[:, None], edge_starts, edge_ends)[~is_horizontal]
    if len(lower_ends) > MAX_EDGES:
        raise ValueError(f"an outline of {len(lower_ends)} edges, {MAX_EDGES} at most")
    slopes = (upper_ends[:, 0] - lower_ends[:, 0]) / (upper_ends[:, 1] - lower_ends[:, 1])
    corner_heights = np.unique(edge_starts[:, 1])
    cut_heights = np.unique(
        np.concatenate([corner_heights, _crossing_heights(lower_ends, upper_ends, slopes)])
    )
    num_crossings = _count_slices(cut_heights) - _count_slices(corner_heights)
    if num_crossings > MAX_CROSSINGS:
        raise ValueError(
            f"an outline that crosses itself at {num_crossings} heights, "
            f"{MAX_CROSSINGS} at most: give its points in their order along the outline"
        )
    prisms = []
    for left_edge, right_edge, bottom, top in _find_trapezoids(
        lower_ends, upper_ends, slopes, cut_heights
    ):
        side_edges = np.array([left_edge, right_edge])
        bottom_x = lower_ends[side_edges, 0] + slopes[side_edges] * (
            bottom - lower_ends[side_edges, 1]
        )
        top_x = lower_ends[side_edges, 0] + slopes[side_edges] * (top - lower_ends[side_edges, 1])
        corners = np.array(
            [(bottom_x[0], bottom), (bottom_x[1], bottom), (top_x[1], top), (top_x[0], top)]
        )
        prism = _extrude_convex(corners, height)
        if prism is not None:
            prisms.append(prism)
    return prisms


def _count_slices(cut_heights: Float) -> int:
    """Count the slices between neighboring cuts, without slices that are too thin for a prism.

    `cut_heights` are the y of the cuts, ascending, (n,) [m].
    """
    return int(np.count_nonzero(np.diff(cut_heights) >= MIN_SLICE_HEIGHT))


class _Trapezoid(NamedTuple):
    """A trapezoid between two edges, with sides parallel to x.

    Attributes:
        left_edge: the index of the edge at smaller x.
        right_edge: the index of the edge at larger x.
        bottom: y of the side at smaller y [m].
        top: y of the side at larger y [m].
    """

    left_edge: int
    right_edge: int
    bottom: float
    top: float


def _find_trapezoids(
    lower_ends: Float, upper_ends: Float, slopes: Float, cut_heights: Float
) -> list[_Trapezoid]:
    """Cut the area that edges enclose into trapezoids with sides parallel to x.

    A trapezoid goes on along y as long as the same two edges bound the area.

    Args:
        lower_ends: the lower end of each edge, (m, 2) [m].
        upper_ends: the upper end of each edge, (m, 2) [m].
        slopes: dx / dy of each edge, (m,).
        cut_heights: y of all corners and crossings, ascending, (n,) [m].
    """
    trapezoids = []
    # left and right edge -> where they became sides
    bottom_of_sides: dict[tuple[int, int], float] = {}
    slice_top = 0.0
    for bottom, top in zip(cut_heights[:-1].tolist(), cut_heights[1:].tolist(), strict=True):
        if top - bottom < MIN_SLICE_HEIGHT:
            continue
        edge_indices = np.flatnonzero((lower_ends[:, 1] <= bottom) & (upper_ends[:, 1] >= top))
        middle_x = lower_ends[edge_indices, 0] + slopes[edge_indices] * (
            (bottom + top) / 2 - lower_ends[edge_indices, 1]
        )
        edge_indices_by_x = edge_indices[np.argsort(middle_x, kind="stable")].tolist()
        # an odd number of edges is to the left of what is enclosed
        side_pairs = [*zip(edge_indices_by_x[::2], edge_indices_by_x[1::2], strict=False)]
        for left_edge, right_edge in bottom_of_sides.keys() - {*side_pairs}:
            trapezoids.append(
                _Trapezoid(left_edge, right_edge, bottom_of_sides[left_edge, right_edge], slice_top)
            )
        bottom_of_sides = {
            side_pair: bottom_of_sides.get(side_pair, bottom) for side_pair in side_pairs
        }
        slice_top = top
    trapezoids += [
        _Trapezoid(*side_pair, bottom, slice_top) for side_pair, bottom in bottom_of_sides.items()
    ]
    return sorted(trapezoids)


def _crossing_heights(lower_ends: Float, upper_ends: Float, slopes: Float) -> Float:
    """Return the y at which edges cross, for each pair of edges that do, (n,) [m].

    Args:
        lower_ends: the lower end of each edge, (m, 2) [m].
        upper_ends: the upper end of each edge, (m, 2) [m].
        slopes: dx / dy of each edge, (m,).
    """
    x_at_zero = lower_ends[:, 0] - slopes * lower_ends[:, 1]
    slope_differences = slopes[:, None] - slopes[None, :]
    # edges with a common corner meet nowhere else; by rounding they would cross just beside it
    corner_of_end = np.unique(
        np.concatenate([lower_ends, upper_ends]), axis=0, return_inverse=True
    )[1].ravel()
    corners_of_edges = corner_of_end.reshape(2, -1)
    may_cross = slope_differences != 0.0
    for first_end, second_end in ((0, 0), (0, 1), (1, 0), (1, 1)):
        may_cross &= corners_of_edges[first_end][:, None] != corners_of_edges[second_end][None, :]
    x_differences = x_at_zero[None, :] - x_at_zero[:, None]
    crossing_y = np.divide(
        x_differences, slope_differences, where=may_cross, out=np.full_like(x_differences, 0)
    )
    min_y = np.maximum(lower_ends[:, None, 1], lower_ends[None, :, 1])
    max_y = np.minimum(upper_ends[:, None, 1], upper_ends[None, :, 1])
    return np.asarray(crossing_y[may_cross & (crossing_y > min_y) & (crossing_y < max_y)])


def _extrude_convex(corners: Float, height: float) -> Mesh | None:
    """Make a prism of a convex outline, (n, 2) [m]; None if it has no volume."""
    if not np.isfinite(corners).all():
        return None
    distinct_corners = np.unique(corners, axis=0)
    bottom_vertices = np.column_stack([distinct_corners, np.zeros(len(distinct_corners))])
    vertices = np.concatenate([bottom_vertices, bottom_vertices + np.array([0.0, 0.0, height])])
    faces = hull_faces(vertices) if len(distinct_corners) >= 3 else None
    return None if faces is None else Mesh(vertices, faces)
