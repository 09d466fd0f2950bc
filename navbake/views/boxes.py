"""Merges cells of a level, and voxels, into few boxes of one colour each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.formats.floor_mesh import cover_with_quads
from navbake.navgrid import colors
from navbake.navgrid.grid import SceneGrid2D
from navbake.types import Float, Int
from navbake.views.layers import FLAT_TOLERANCE, LAYER_LIFT, MAX_RISE
from navbake.voxels.grid import VoxelGrid

BOX_HEIGHT = 0.002  # of the boxes that show cells; sides of high ones shine through [m]


class Boxes(NamedTuple):
    """Boxes, the largest first.

    Attributes:
        centers: the middles, world x, y, z [m], shape (n, 3).
        half_sizes: half the edges along the box's own axes [m], shape (n, 3).
        rotations: the box's axes as columns, shape (n, 3, 3).
        rgb: red, green and blue, 0 to 255, shape (n, 3).
    """

    centers: Float
    half_sizes: Float
    rotations: Float
    rgb: NDArray[np.uint8]


def merge_cells(level: SceneGrid2D, cell_rgb: NDArray[np.uint8]) -> Boxes:
    """Cover the cells of a level that have a floor by few flat boxes that lie on the floor.

    The boxes cover each of these cells once, and no other. A box has one colour. Its lower face is
    off the floor by no more than `FLAT_TOLERANCE` at the middle of a cell; on a floor that slopes
    along both x and y, it also is level across a cell.

    Args:
        level: the level.
        cell_rgb: the colour of each cell, shape (height, width, 3).

    Returns:
        The boxes, `BOX_HEIGHT` high.
    """
    has_floor = ~np.isnan(level.floor_height)
    rgb_numbers = cell_rgb.astype(np.int64) @ np.array([1 << 16, 1 << 8, 1])
    _, color_index = np.unique(rgb_numbers, return_inverse=True)
    labels = np.where(has_floor, color_index.reshape(level.shape) + 1, 0).astype(np.int32)
    lattice = level.lattice
    cell_size = lattice.cell_size
    quads = cover_with_quads(
        labels, level.floor_or_ground, FLAT_TOLERANCE, MAX_RISE * cell_size, margin=0
    )
    # corners run from the lower left one anticlockwise, rows run against y
    num_rows = np.round(quads.rows[:, 0] - quads.rows[:, 3]).astype(np.int64)
    num_cols = np.round(quads.cols[:, 1] - quads.cols[:, 0]).astype(np.int64)
    rise_x = quads.heights[:, 1] - quads.heights[:, 0]
    rise_y = quads.heights[:, 3] - quads.heights[:, 0]
    # a box can't be sheared, so a quad that slopes along both axes becomes strips of one cell's
    # width, each of which slopes along its longer side alone
    slopes_twice = (rise_x != 0) & (rise_y != 0)
    has_row_strips = slopes_twice & (num_rows <= num_cols)
    has_col_strips = slopes_twice & (num_rows > num_cols)
    num_strips = np.where(has_row_strips, num_rows, np.where(has_col_strips, num_cols, 1))
    quad_index = np.repeat(np.arange(len(num_strips)), num_strips)
    first_strips = np.cumsum(num_strips) - num_strips
    strip_index = np.arange(len(quad_index)) - first_strips[quad_index]
    strip_middle = (strip_index + 0.5) / num_strips[quad_index]
    x_share = np.where(has_col_strips[quad_index], strip_middle, 0.5)
    y_share = np.where(has_row_strips[quad_index], strip_middle, 0.5)

    x_length = (num_cols * cell_size)[quad_index]
    y_length = (num_rows * cell_size)[quad_index]
    x = lattice.x_min + quads.cols[quad_index, 0] * cell_size + x_share * x_length
    y = lattice.y_max - quads.rows[quad_index, 0] * cell_size + y_share * y_length
    z = quads.heights[quad_index, 0] + x_share * rise_x[quad_index] + y_share * rise_y[quad_index]
    # the edges of each box, of which the one across strips is level
    x_edge = np.stack([x_length, np.zeros_like(x), rise_x[quad_index]], axis=1)
    y_edge = np.stack([np.zeros_like(x), y_length, rise_y[quad_index]], axis=1)
    is_row_strip = has_row_strips[quad_index]
    is_col_strip = has_col_strips[quad_index]
    y_edge[is_row_strip] = [0.0, cell_size, 0.0]
    x_edge[is_col_strip] = [cell_size, 0.0, 0.0]

    edge_lengths = np.stack([np.linalg.norm(x_edge, axis=1), np.linalg.norm(y_edge, axis=1)])
    x_axis = x_edge / edge_lengths[0][:, None]
    y_axis = y_edge / edge_lengths[1][:, None]
    rotations = np.stack([x_axis, y_axis, np.cross(x_axis, y_axis)], axis=2)
    # lifted straight up, so that boxes on a slope stay over their cells, and their tops over floors
    centers = np.stack([x, y, z + LAYER_LIFT + FLAT_TOLERANCE - BOX_HEIGHT / 2], axis=1)
    half_sizes = np.stack(
        [edge_lengths[0] / 2, edge_lengths[1] / 2, np.full(len(x), BOX_HEIGHT / 2)], axis=1
    )
    first_cells = quads.first_cell[quad_index]
    rgb = cell_rgb[first_cells[:, 0], first_cells[:, 1]]
    return _largest_first(Boxes(centers, half_sizes, rotations, rgb))


def merge_voxels(voxels: VoxelGrid) -> Boxes:
    """Cover the occupied voxels by few boxes, each of one ID.

    The boxes cover each of these voxels once, and no other. In each horizontal layer, voxels of one
    ID are covered by rectangles; equal rectangles in layers above each other are one box.

    Args:
        voxels: the voxels.

    Returns:
        The boxes, in the colours of rooms by ID; voxels without IDs are grey.
    """
    num_x, num_y, num_z = voxels.shape
    ids, label_index = np.unique(voxels.values, return_inverse=True)
    labels = np.where(voxels.occupied, label_index.reshape(voxels.shape) + 1, 0)
    # the layers one below the other in one plan, each followed by an empty row that parts them
    layers = np.zeros((num_z, num_x + 1, num_y), dtype=np.int32)
    layers[:, :num_x] = labels.transpose(2, 0, 1)
    plan = layers.reshape(num_z * (num_x + 1), num_y)
    quads = cover_with_quads(plan, np.zeros(plan.shape), 0.0, 0.0, margin=0)
    first_row, first_y = quads.first_cell.T
    layer, first_x = np.divmod(first_row, num_x + 1)
    num_rows = np.round(quads.rows[:, 0] - quads.rows[:, 3]).astype(np.int64)
    end_y = np.round(quads.cols[:, 1]).astype(np.int64)
    rectangles = np.column_stack(
        [first_x, first_y, first_x + num_rows, end_y, plan[first_row, first_y]]
    )
    lower, upper, box_labels = _stack_rectangles(rectangles, layer)

    palette = np.array([colors.rgb_of(color) for color in colors.ROOMS], dtype=np.uint8)
    box_ids = ids[box_labels - 1].astype(np.int64)
    rgb = palette[box_ids % len(palette)]
    if not voxels.is_segmented:
        rgb = np.full((len(lower), 3), colors.rgb_of(colors.NO_FLOOR), dtype=np.uint8)
    lower_corners = np.array(voxels.origin) + lower * voxels.res
    upper_corners = np.array(voxels.origin) + upper * voxels.res
    boxes = Boxes(
        centers=(lower_corners + upper_corners) / 2,
        half_sizes=(upper_corners - lower_corners) / 2,
        rotations=np.tile(np.eye(3), (len(lower), 1, 1)),
        rgb=rgb,
    )
    return _largest_first(boxes)


def _stack_rectangles(rectangles: Int, layer: Int) -> tuple[Int, Int, Int]:
    """Merge equal rectangles in consecutive layers into boxes.

    Args:
        rectangles: first x, first y, x after the last, y after the last, and label of each
            rectangle, shape (n, 5).
        layer: the layer of each rectangle, shape (n,).

    Returns:
        The first voxel of each box, and the voxel after its last, shape (m, 3); its label, (m,).
    """
    sort_indices = np.lexsort((layer, *rectangles.T))
    rectangles = rectangles[sort_indices]
    layer = layer[sort_indices]
    continues = np.zeros(len(layer), dtype=np.bool_)
    continues[1:] = (rectangles[1:] == rectangles[:-1]).all(axis=1) & (np.diff(layer) == 1)
    first_indices = np.flatnonzero(~continues)
    last_indices = np.append(first_indices[1:], len(layer)) - 1
    box_rectangles = rectangles[first_indices]
    lower = np.column_stack([box_rectangles[:, :2], layer[first_indices]])
    upper = np.column_stack([box_rectangles[:, 2:4], layer[last_indices] + 1])
    return lower, upper, box_rectangles[:, 4]


def _largest_first(boxes: Boxes) -> Boxes:
    """Sort boxes by their volume, so that the smallest are left out where there is no space."""
    sort_indices = np.argsort(-np.prod(boxes.half_sizes, axis=1), kind="stable")
    return Boxes(
        centers=boxes.centers[sort_indices],
        half_sizes=boxes.half_sizes[sort_indices],
        rotations=boxes.rotations[sort_indices],
        rgb=boxes.rgb[sort_indices],
    )
