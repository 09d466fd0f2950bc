"""Segments that are hollows of the building, and no rooms, and segments that are outdoors.

A segment is a part of the floor between gaps, see `segmentation.py`. All levels of a stack are
looked at together, see `LevelStack`: each of their segments has a number of its own.

`find_room_segments` calls the other functions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from navbake.baker.core.components import (
    RowRuns,
    find_row_runs,
    label_components,
    label_runs,
    list_adjacent_pairs,
)
from navbake.baker.core.level_stacks import LevelStack, make_level_stacks
from navbake.baker.rooms.flags import MIN_OUTDOOR_EDGE, RoomFlags
from navbake.baker.rooms.segmentation import CELL_ROUNDING, measure_widest_places
from navbake.baker.rooms.walls import measure_squared_distances
from navbake.types import Bool, Float, Int, Int32

# A space that nothing leads into is a room if it has at least this area [m²] and greatest width [m]
MIN_CLOSED_ROOM_AREA = 2.0
MIN_CLOSED_ROOM_WIDTH = 1.0

# A cell that is not under the sky is under eaves if it is at most this far from the edge [m]
MAX_EAVES_DEPTH = 1.2
# Outdoors, at least this share of the floor is under the sky or under eaves
MIN_OPEN_SHARE = 0.5


class StackedSegments(NamedTuple):
    """The segments of the levels of a stack, each with a number of its own.

    Attributes:
        stack: the levels.
        segment: the segment of each cell, from 1, 0 for none, shape (rows, width).
        runs: the runs of cells of one segment in the rows of `segment`.
        level_index: by segment, the index of its level in the stack, 0 for segment 0, shape
            (segments + 1,).
    """

    stack: LevelStack
    segment: Int32
    runs: RowRuns
    level_index: Int


def find_room_segments(
    segments: Sequence[Int32],
    room_numbers: Sequence[Int32],
    flags: RoomFlags,
    cells_beyond: Sequence[Int],
) -> tuple[list[Int32], set[int]]:
    """Leave out the segments that are cavities, and unite outdoor segments that touch.

    Args:
        segments: for each level, the part of the floor between gaps that each cell belongs to, from
            1, 0 for none, shape (height, width).
        room_numbers: for each level, the marked room of each cell, 0 for none.
        flags: the flags of the cells of all levels, and the steps between cells.
        cells_beyond: for each level, ids of cells in the spaces that closed leaves lead into, shape
            (n,).

    Returns:
        For each level, the number of each cell's segment, 0 for none, in which no number is of two
        levels; and the numbers of the segments that are outdoors.
    """
    numbered_segments = list[Int32]()
    outdoor_segments = set[int]()
    num_segments = 0  # on the levels so far
    for stack in make_level_stacks(len(segments), flags.lattice.shape):
        stacked_segments = _number_segments(stack, segments)
        is_cavity = _mark_cavities(stacked_segments, room_numbers, flags, cells_beyond)
        united_segment, is_outdoors = _find_outdoors(stacked_segments, flags)
        number = united_segment + np.int32(num_segments)
        number[0] = 0
        number[is_cavity] = 0
        _, segment, runs, _ = stacked_segments
        numbered_segments += list(stack.unstack(runs.paint(number[runs.value], segment.shape)))
        outdoor_segments.update(number[is_outdoors].tolist())
        num_segments += len(united_segment) - 1
    return numbered_segments, outdoor_segments


def _number_segments(stack: LevelStack, segments: Sequence[Int32]) -> StackedSegments:
    """Give the segments of all levels of a stack different numbers.

    Args:
        stack: the levels.
        segments: for each level of the scene, the segment of each cell, from 1, 0 for none.
    """
    segment = stack.stack(segments)
    num_segments_of_level = stack.unstack(segment).max(axis=(1, 2), initial=0)
    if len(stack.levels) > 1:
        num_segments_below = np.cumsum(num_segments_of_level) - num_segments_of_level
        by_level = stack.unstack(segment)  # a view: the sum is written into `segment`
        by_level += np.where(by_level > 0, num_segments_below[:, None, None], 0).astype(np.int32)
    level_index = np.repeat(np.arange(len(stack.levels)), num_segments_of_level)
    return StackedSegments(stack, segment, find_row_runs(segment), np.append(0, level_index))


def _mark_cavities(
    stacked_segments: StackedSegments,
    room_numbers: Sequence[Int32],
    flags: RoomFlags,
    cells_beyond: Sequence[Int],
) -> Bool:
    """Mark the segments that are cavities: hollow walls, shafts, chases.

    Nothing leads into a cavity: it touches no other segment or room and not the grid's edge, no
    link (a step to another level, or a slope) ends in it, and no closed door leaf leads into it.
    And it is smaller than `MIN_CLOSED_ROOM_AREA`, or narrower than `MIN_CLOSED_ROOM_WIDTH`. The
    largest segment of a level is never a cavity.

    Args:
        stacked_segments: the segments of the levels of a stack.
        room_numbers: for each level of the scene, the marked room of each cell, 0 for none.
        flags: the flags of the cells of all levels, and the steps between cells.
        cells_beyond: for each level of the scene, ids of cells in the spaces that closed leaves
            lead into.

    Returns:
        By segment, whether it is a cavity, shape (segments + 1,).
    """
    stack, segment, runs, level_index = stacked_segments
    cell_size = flags.lattice.cell_size
    num_labels = len(level_index)
    area = runs.count_cells(runs.value, num_labels) * cell_size**2
    # all marked rooms together count as one more segment, whose number is `num_labels`: segments
    # that touch it are connected
    room_runs = find_row_runs(stack.stack(room_numbers) > 0)
    space_runs = runs.merged_with(
        room_runs._replace(value=np.full(len(room_runs.row), num_labels, dtype=np.int32))
    )
    first_run, second_run = space_runs.list_touching()
    touching_spaces = space_runs.value[np.stack([first_run, second_run])]
    is_connected = np.zeros(num_labels + 1, dtype=np.bool_)
    is_connected[touching_spaces[:, touching_spaces[0] != touching_spaces[1]]] = True
    is_connected = is_connected[:num_labels]
    is_connected[0] = True
    is_connected[segment[stack.stack([level.is_at_edge for level in flags.levels])]] = True
    for level_number in stack.levels:
        cells = stack.cells_of(level_number, cells_beyond[level_number])
        is_connected[segment.ravel()[cells]] = True
    for level_column, cell_column in ((0, 1), (2, 3)):  # of both ends of steps
        level_of_step = flags.steps[:, level_column]
        is_in_stack = (level_of_step >= stack.levels[0]) & (level_of_step <= stack.levels[-1])
        cells = stack.cells_of(level_of_step[is_in_stack], flags.steps[is_in_stack, cell_column])
        is_connected[segment.ravel()[cells]] = True
    largest_area = np.zeros(len(stack.levels))
    np.maximum.at(largest_area, level_index[1:], area[1:])
    is_connected |= area >= largest_area[level_index]
    is_cavity: Bool = ~is_connected & (area < MIN_CLOSED_ROOM_AREA)
    if (is_connected | is_cavity).all():
        return is_cavity
    reach = int(MIN_CLOSED_ROOM_WIDTH / cell_size) + 2
    widest_squared = measure_widest_places(
        segment, runs, segment > 0, ~is_connected & ~is_cavity, reach
    )
    is_wide = widest_squared >= (MIN_CLOSED_ROOM_WIDTH / cell_size) ** 2 - CELL_ROUNDING
    return is_cavity | ~is_connected & ~is_wide


def _find_outdoors(stacked_segments: StackedSegments, flags: RoomFlags) -> tuple[Int32, Bool]:
    """Find the segments that are outdoors, and unite those that touch.

    A segment is outdoors if it touches the edge of the grid over a connected length that is wider
    than any door, and if at least half of its cells have nothing above an agent's head or lie under
    eaves. Outdoor segments that a wall separates stay apart, unless the ground is endless. Segments
    on both sides of a ditch are united.

    Args:
        stacked_segments: the segments of the levels of a stack.
        flags: the flags of the cells of all levels.

    Returns:
        By segment, the lowest number of the segments that it is united with, itself included; and
        whether it is outdoors; shape (segments + 1,) each.
    """
    stack, segment, runs, level_index = stacked_segments
    cell_size = flags.lattice.cell_size
    num_labels = len(level_index)
    is_at_edge = stack.stack([level.is_at_edge for level in flags.levels])
    edge_extents = _measure_edge_extents(segment, is_at_edge & (segment > 0), num_labels)
    is_candidate = edge_extents * cell_size > MIN_OUTDOOR_EDGE
    if not is_candidate.any():
        return np.arange(num_labels, dtype=np.int32), is_candidate
    is_in_candidate = runs.paint(is_candidate[runs.value], segment.shape)
    is_under_sky = stack.stack([level.is_under_sky for level in flags.levels])
    is_under_open_sky = is_under_sky[is_in_candidate]
    if not is_under_open_sky.all():
        # where the lattice crops the scene, rooms go on beyond it
        is_at_scene_end = stack.unstack(is_in_candidate) & flags.is_at_scene_end
        if is_at_scene_end.any():
            reach = int(MAX_EAVES_DEPTH / cell_size) + 1
            squared_distance = _measure_squared_distances_on_levels(is_at_scene_end, reach)
            distance = np.sqrt(squared_distance[stack.unstack(is_in_candidate)]) * cell_size
            is_under_open_sky |= distance <= MAX_EAVES_DEPTH
    cell_segments = segment[is_in_candidate]
    num_under_open_sky = np.bincount(cell_segments[is_under_open_sky], minlength=num_labels)
    num_cells = runs.count_cells(runs.value, num_labels)
    is_outdoors = is_candidate & (num_under_open_sky >= MIN_OPEN_SHARE * num_cells)
    is_bank = stack.stack([level.is_bank for level in flags.levels])
    united_segment = _unite_touching(runs, is_outdoors, is_bank)
    if flags.has_ground:
        lowest_segment = np.full(len(stack.levels), num_labels, dtype=np.int32)
        np.minimum.at(lowest_segment, level_index[is_outdoors], united_segment[is_outdoors])
        united_segment[is_outdoors] = lowest_segment[level_index[is_outdoors]]
    return united_segment, is_outdoors


def _measure_squared_distances_on_levels(is_target: Bool, reach: int) -> Int32:
    """Measure how far each cell is from the nearest target cell of its level.

    Args:
        is_target: a mask of the target cells, shape (levels, height, width).
        reach: the largest distance that is measured, >= 0 [cells].

    Returns:
        The squared distances, of the shape of `is_target`, see `measure_squared_distances`.
    """
    num_levels, height, width = is_target.shape
    # so far apart that no level is in reach of another
    is_target_apart = np.zeros((num_levels, height + reach, width), dtype=np.bool_)
    is_target_apart[:, :height] = is_target
    squared_distance = measure_squared_distances(is_target_apart.reshape(-1, width), reach)
    return squared_distance.reshape(is_target_apart.shape)[:, :height]


def _unite_touching(runs: RowRuns, is_outdoors: Bool, is_bank: Bool) -> Int32:
    """Unite outdoor segments that touch each other, or the same bank (ground that is too steep).

    Args:
        runs: the runs of cells of one segment in rows.
        is_outdoors: by segment, whether it is outdoors.
        is_bank: cells without a floor whose ground is too steep, see `LevelFlags.is_bank`.

    Returns:
        By segment, the lowest number of the segments that it is united with, itself included.
    """
    bank_runs = find_row_runs(is_bank)
    bank_of_run, num_bank_cells = label_runs(bank_runs)
    # nodes are the segments and then the banks; no cell is in a segment and in a bank
    node_runs = runs.merged_with(
        bank_runs._replace(value=bank_of_run + np.int32(len(is_outdoors) - 1))
    )
    may_join = np.concatenate([is_outdoors, np.ones(len(num_bank_cells) - 1, dtype=np.bool_)])
    first_run, second_run = node_runs.list_touching()
    touching_nodes = node_runs.value[np.stack([first_run, second_run])]
    # the first node of a component is its least
    component = label_components(
        touching_nodes[:, may_join[touching_nodes].all(axis=0)], len(may_join)
    )
    lowest_node = np.unique(component, return_index=True)[1].astype(np.int32)
    return lowest_node[component][: len(is_outdoors)]


def _measure_edge_extents(segment: Int32, is_at_edge: Bool, num_labels: int) -> Float:
    """Measure over which connected length each segment touches the edge of the grid [cells].

    Of several connected pieces of a segment's cells at the edge, the longest counts. The length of
    a piece is the diagonal of the rectangle round it.

    Args:
        segment: the segment of each cell, shape (height, width).
        is_at_edge: a mask of the cells at the edge that are in a segment.
        num_labels: the number of segments, plus 1.

    Returns:
        The lengths by segment, 0 for segments that don't touch the edge, shape (num_labels,).
    """
    edge_cells = np.flatnonzero(is_at_edge)
    rows, cols = np.divmod(edge_cells, segment.shape[1])
    segment_of_cell = segment[rows, cols]
    pairs = list_adjacent_pairs(edge_cells, segment.shape[1])
    piece_of_cell = label_components(
        pairs[:, segment_of_cell[pairs[0]] == segment_of_cell[pairs[1]]], len(edge_cells)
    )
    extent = np.zeros(len(edge_cells))
    for coordinates in (rows, cols):
        lowest_index = np.full(len(edge_cells), np.inf)
        highest_index = np.full(len(edge_cells), -np.inf)
        np.minimum.at(lowest_index, piece_of_cell, coordinates)
        np.maximum.at(highest_index, piece_of_cell, coordinates)
        extent = np.hypot(extent, (highest_index - lowest_index)[piece_of_cell])
    max_extent = np.zeros(num_labels)
    np.maximum.at(max_extent, segment_of_cell, extent + 1)
    return max_extent
