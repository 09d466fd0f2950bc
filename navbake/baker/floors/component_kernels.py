"""Label the connected components of surfaces block by block, and list where components meet.

A component is a set of surfaces in neighboring cells, each connected to the next one by a step or
by slopes. It is found inside of one block of cells, by union-find with path halving (Tarjan and van
Leeuwen, 1984); the caller merges components that meet across the border of two blocks.

Kernels here list rows of numbers, for `navbake.baker.core.blocks.list_rows`. A row of `list_pairs`
or `cross_tabulate` has three numbers, and a count of how often these three occur together. The same
three numbers may have several rows; their counts have to be added up.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.baker.core.tiles import block_of, block_window
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors.surface_kernels import (
    EAST,
    STANDABLE,
    UNCOVERED,
    are_joined_by_slopes,
    find_first_not_below,
)
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Int, Int32

# Kinds of pairs of components; for plain ints, numba would compile `count_row` once for each
JOINED = np.int64(0)  # they are connected, and only the border of two blocks divides them
LINKED = np.int64(1)  # they are not connected, but an agent can step from one to the other
# In a cell, the first lies above the second one, with no other component between them
STACKED = np.int64(2)
# In place of a number that rows of `count_row` don't need
NO_NUMBER = np.int64(0)
# Height of the bins of a histogram of heights: blocks of cells are counted one by one, and counts
# in the same bin are added up. Also the largest difference in height of adjacent surfaces of one
# plateau, which is a tread, a landing or a piece of a ramp [m]
HEIGHT_BIN = 0.02
# `count_row` looks for three numbers only in a likely row, and in this many of the latest rows. If
# they stand in another row, they get one more
NUM_RECENT_ROWS = 8
# The key of a surface is cell * MAX_RANK + rank, where rank counts the labelled surfaces of the
# cell from the lowest, 0
MAX_RANK = 4096
# The numbers in a row of `label_blocks`. The first surface is the lowest one of the lowest cell id;
# ends are exclusive
NUM_SURFACES = 0  # how many surfaces the component has
NUM_UNCOVERED = 1  # how many of them are UNCOVERED
FIRST_SURFACE = 2  # key of the first surface, see MAX_RANK
FIRST_ROW = 3
FIRST_COL = 4
END_ROW = 5
END_COL = 6
# Columns of the heights of `label_blocks`
LOWEST = 0
HIGHEST = 1


class JoinRule(NamedTuple):
    """The rule by which surfaces of neighboring cells are connected, or only linked.

    Connected surfaces are in one component. Linked surfaces are not, but the pair of their
    components is listed, for example because an agent can step from one to the other.

    Attributes:
        max_step: two surfaces of the same group, see `label_blocks`, are connected if their heights
            differ by at most this [m].
        max_link_step: two surfaces that are not connected are linked if their heights differ by at
            most this [m]; negative if no links are listed.
        can_slopes_join: whether surfaces of the same group are also connected where
            `are_joined_by_slopes` says so.
    """

    max_step: float
    max_link_step: float = -1.0
    can_slopes_join: bool = False


class ComponentNumbering(NamedTuple):
    """The components of surfaces, numbered in each block, and numbered over all blocks.

    Attributes:
        number_in_block: for each surface, the number of its component, -1 for none, int32. The
            numbers of a block are consecutive, and start anywhere, see `label_blocks`.
        offset_of_block: for each block, what is added to `number_in_block` for `overall_number`,
            int64.
        overall_number: receives, for each surface, the number of its component over all blocks, -1
            for none, int32.
    """

    number_in_block: Int32
    offset_of_block: Int
    overall_number: Int32


class PairRows(NamedTuple):
    """The rows in which the pairs of a block's components are counted, see `count_row`.

    Attributes:
        rows: the numbers of two components, the kind of the pair and its count in each row, (n, 4)
            int64.
        first_row: index of the block's first row.
        num_rows: index past the last row written so far.
        likely_row: index of the row that likely counts the next pair.
    """

    rows: Int
    first_row: int | np.int64
    num_rows: int | np.int64
    likely_row: int | np.int64


@subkernel(**NO_REFCOUNT)
def count_row(rows, first_row, num_rows, likely_row, first_number, second_number, third_number):
    """Count one more occurrence of three numbers, such as two components and the kind of pair.

    The count stands in the row that begins with these numbers. If neither the likely row nor any of
    the latest NUM_RECENT_ROWS rows does, a row is appended.

    Args:
        rows: three numbers and their count in each row, (n, 4) int64.
        first_row: index of the first row of the current block of cells.
        num_rows: index past the last row written so far.
        likely_row: index of the row that is looked at first. In a tower, most columns count the
            same numbers in the same order: the row after that of the last count in the column, or
            else the first row of the column before.
        first_number: the first of the three numbers; int64, as they all are.
        second_number: the second number.
        third_number: the third number.

    Returns:
        The index of the row with the count, or -1 if there is no room for another row.
    """
    if (
        first_row <= likely_row < num_rows
        and rows[likely_row, 0] == first_number
        and rows[likely_row, 1] == second_number
        and rows[likely_row, 2] == third_number
    ):
        rows[likely_row, 3] += 1
        return np.int64(likely_row)
    for row in range(num_rows - 1, max(first_row, num_rows - NUM_RECENT_ROWS) - 1, -1):
        if (
            rows[row, 0] == first_number
            and rows[row, 1] == second_number
            and rows[row, 2] == third_number
        ):
            rows[row, 3] += 1
            return row
    # the search is short, as neighboring cells mostly repeat the last numbers
    if num_rows == rows.shape[0]:
        return np.int64(-1)
    rows[num_rows, 0] = first_number
    rows[num_rows, 1] = second_number
    rows[num_rows, 2] = third_number
    rows[num_rows, 3] = 1
    return num_rows


@subkernel(inline="always")
def height_bin(z):
    """Return the index of the bin of heights whose middle is nearest to height z [m].

    Bins are HEIGHT_BIN high; the middle of bin 0 is at height 0.
    """
    return np.int64(np.rint(z / HEIGHT_BIN))


@subkernel(inline="always")
def _group_of(surfaces, group_of_surface, surface):
    """Return the group of a surface; negative if the surface is in no component.

    If the array `group_of_surface` is empty, all STANDABLE surfaces are in group 0, see
    `label_blocks`.
    """
    if group_of_surface.shape[0] > 0:
        return np.int64(group_of_surface[surface])
    return np.int64(0) if surfaces.flags[surface] & STANDABLE else np.int64(-1)


@subkernel(inline="always")
def _are_joined(surfaces, group_of_surface, rule, surface_a, surface_b, direction):
    """Return whether two surfaces are connected: of one group, and joined by a step or slopes.

    `direction` is EAST or SOUTH, from the cell of a to the neighboring cell of b; `rule` is a
    `JoinRule`.
    """
    if _group_of(surfaces, group_of_surface, surface_a) != _group_of(
        surfaces, group_of_surface, surface_b
    ):
        return False
    if abs(surfaces.z[surface_a] - surfaces.z[surface_b]) <= rule.max_step + LIMIT_SLACK:
        return True
    return rule.can_slopes_join and are_joined_by_slopes(
        surfaces, surface_a, surface_b, direction, rule.max_step
    )


@subkernel(inline="always")
def max_rise_of(rule):
    """Return the largest difference in height that connected or linked surfaces may have [m].

    It is infinite if slopes connect surfaces.
    """
    return (
        math.inf if rule.can_slopes_join else max(rule.max_step, rule.max_link_step) + LIMIT_SLACK
    )


@subkernel(inline="always")
def _find_root(component_of_surface, surface):
    """Return the root of the union-find set that a surface is in.

    ``component_of_surface[j]`` is ``-2 - p``, where surface p is the parent of j; a root is its own
    parent.
    """
    while component_of_surface[surface] != -2 - surface:
        parent = -2 - component_of_surface[surface]
        component_of_surface[surface] = component_of_surface[parent]
        surface = -2 - component_of_surface[surface]
    return surface


@subkernel(forceinline=True, **NO_REFCOUNT)
def _unite_with_neighbor(
    surfaces, group_of_surface, rule, max_rise, component_of_surface, cell, neighbor, direction
):
    """Unite a cell's surfaces with those of its western or northern neighbor that they join.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        group_of_surface: the group of each surface, see `label_blocks`.
        rule: a `JoinRule`.
        max_rise: the largest difference in height of joined surfaces, see `max_rise_of` [m].
        component_of_surface: the parents of union-find, see `label_blocks`; is changed.
        cell: id of the cell.
        neighbor: id of the neighbor.
        direction: the direction from the neighbor to the cell, EAST or SOUTH.
    """
    z = surfaces.z
    first_near_surface = surfaces.first[neighbor]
    end_in_neighbor = surfaces.end[neighbor]
    for surface in range(np.int64(surfaces.first[cell]), surfaces.end[cell]):
        if component_of_surface[surface] == -1:
            continue
        first_near_surface = find_first_not_below(
            z, first_near_surface, end_in_neighbor, z[surface] - max_rise
        )
        for near_surface in range(first_near_surface, end_in_neighbor):
            if z[near_surface] > z[surface] + max_rise:
                break
            if component_of_surface[near_surface] != -1 and _are_joined(
                surfaces, group_of_surface, rule, near_surface, surface, direction
            ):
                root = _find_root(component_of_surface, surface)
                near_root = _find_root(component_of_surface, near_surface)
                # the lower id is the root, whatever the order of unions
                component_of_surface[max(root, near_root)] = -2 - min(root, near_root)


@subkernel(forceinline=True, **NO_REFCOUNT)
def _unite_surfaces(surfaces, group_of_surface, rule, window, component_of_surface):
    """Unite the surfaces of a block that are connected, by union-find.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        group_of_surface: the group of each surface, see `label_blocks`.
        rule: a `JoinRule`.
        window: rows and columns of the block, see `block_window`.
        component_of_surface: receives the parents of union-find, see `label_blocks`.
    """
    max_rise = max_rise_of(rule)
    width = surfaces.lattice.width
    row_first, row_end, col_first, col_end = window
    for row in range(row_first, row_end):
        for col in range(col_first, col_end):
            cell = row * width + col
            for surface in range(np.int64(surfaces.first[cell]), surfaces.end[cell]):
                has_group = _group_of(surfaces, group_of_surface, surface) >= 0
                component_of_surface[surface] = -2 - surface if has_group else -1
            for direction in range(2):
                is_first = col == col_first if direction == EAST else row == row_first
                if not is_first:
                    _unite_with_neighbor(
                        surfaces,
                        group_of_surface,
                        rule,
                        max_rise,
                        component_of_surface,
                        cell,
                        cell - 1 if direction == EAST else cell - width,
                        direction,
                    )


@subkernel(forceinline=True, **NO_REFCOUNT)
def _measure_components(surfaces, window, component_of_surface, first_row, measures, heights):
    """Number the components of a block, and measure them.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        window: rows and columns of the block, see `block_window`.
        component_of_surface: the parents of union-find, see `label_blocks`; receives the numbers.
        first_row: index of the block's first row in `measures` and `heights`.
        measures: receives the numbers of each component, see `label_blocks`.
        heights: receives its lowest and its highest height.

    Returns:
        How many components the block has; -1 if there is no room for their rows.
    """
    z = surfaces.z
    num_components = 0
    row_first, row_end, col_first, col_end = window
    for row in range(row_first, row_end):
        for col in range(col_first, col_end):
            cell = row * surfaces.lattice.width + col
            rank = 0
            for surface in range(surfaces.first[cell], surfaces.end[cell]):
                if component_of_surface[surface] == -1:
                    continue
                # parents are negative, and numbers are not: a root that has one ends the search
                root = surface
                while component_of_surface[root] < -1 and component_of_surface[root] != -2 - root:
                    root = -2 - component_of_surface[root]
                if component_of_surface[root] < -1:  # the root has no number yet
                    if first_row + num_components == heights.shape[0]:
                        return -1
                    component_of_surface[root] = num_components
                    row_index = first_row + num_components
                    num_components += 1
                    measures[row_index, :] = 0
                    heights[row_index, LOWEST] = z[surface]
                    heights[row_index, HIGHEST] = z[surface]
                    # surfaces are visited in the order of cells: this is the first one
                    measures[row_index, FIRST_SURFACE] = cell * MAX_RANK + min(rank, MAX_RANK - 1)
                    measures[row_index, FIRST_ROW] = row
                    measures[row_index, FIRST_COL] = col
                component_of_surface[surface] = component_of_surface[root]
                row_index = first_row + component_of_surface[surface]
                measures[row_index, NUM_SURFACES] += 1
                measures[row_index, NUM_UNCOVERED] += (
                    1 if surfaces.flags[surface] & UNCOVERED else 0
                )
                measures[row_index, FIRST_COL] = min(measures[row_index, FIRST_COL], col)
                measures[row_index, END_ROW] = row + 1
                measures[row_index, END_COL] = max(measures[row_index, END_COL], col + 1)
                heights[row_index, LOWEST] = min(heights[row_index, LOWEST], z[surface])
                heights[row_index, HIGHEST] = max(heights[row_index, HIGHEST], z[surface])
                rank += 1
    return num_components


@kernel(nogil=True, **NO_REFCOUNT)
def label_blocks(
    surfaces,
    group_of_surface,
    rule,
    component_of_surface,
    blocks,
    row_counts,
    row_arrays,
    begin,
    end,
):
    """Label and measure the connected components of surfaces inside of ``blocks[begin:end]``.

    A kernel for `navbake.baker.core.blocks.list_rows`. It lists a row for each component of a
    block, in the order of their first surfaces. A component's first surface is its lowest one in
    the first of its cells, row by row from the north-west.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        group_of_surface: the group of each surface, (n,) int32. Only surfaces of the same group are
            connected; surfaces of a negative group are in no component. If empty, all STANDABLE
            surfaces are in one group, and the others in none.
        rule: a `JoinRule`: the limits within which surfaces are connected, or else linked.
        component_of_surface: receives, for each surface, the number of its component in its block,
            -1 for none, (n,) int32. While a block is labelled, it holds the parents of union-find:
            -2 - p for parent p.
        blocks: ids of blocks of cells.
        row_counts: receives how many components each block has.
        row_arrays: two arrays that receive the rows: seven numbers of each component, at the
            indices from NUM_SURFACES to END_COL, (n, 7) int64; and its lowest and its highest
            height, at the indices LOWEST and HIGHEST, (n, 2) float64 [m].
        begin: index in `blocks` of the first block to label.
        end: index past the last one.

    Returns:
        The index in `blocks` of the first block whose rows had no room; `end` if all had room.
    """
    measures, heights = row_arrays
    num_components_before = 0
    for block_index in range(begin, end):
        window = block_window(surfaces.lattice, blocks[block_index])
        _unite_surfaces(surfaces, group_of_surface, rule, window, component_of_surface)
        num_components = _measure_components(
            surfaces, window, component_of_surface, num_components_before, measures, heights
        )
        if num_components < 0:
            return block_index
        row_counts[block_index] = num_components
        num_components_before += num_components
    return end


@subkernel(forceinline=True, **NO_REFCOUNT)
def _list_stacked_pairs(surfaces, numbering, block_offset, cell, pair_rows):
    """Number a cell's components over all blocks, and count the pairs that lie over each other.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        numbering: a `ComponentNumbering`, whose `overall_number` is written.
        block_offset: the `offset_of_block` of the cell's block.
        cell: id of the cell.
        pair_rows: the rows in which pairs are counted, as `PairRows`.

    Returns:
        The index past the last row then, -1 if there is no room for another row; and the row of
        the cell's first pair, -1 if it has none.
    """
    num_rows = np.int64(pair_rows.num_rows)
    likely_row = np.int64(pair_rows.likely_row)
    first_pair_row = np.int64(-1)
    number_below = np.int32(-1)
    for surface in range(surfaces.first[cell], surfaces.end[cell]):
        numbering.overall_number[surface] = -1
        if numbering.number_in_block[surface] < 0:
            continue
        numbering.overall_number[surface] = block_offset + numbering.number_in_block[surface]
        number = numbering.overall_number[surface]
        if number_below >= 0:
            row_index = count_row(
                pair_rows.rows,
                pair_rows.first_row,
                num_rows,
                likely_row,
                np.int64(number),
                np.int64(number_below),
                STACKED,
            )
            if row_index < 0:
                return np.int64(-1), first_pair_row
            if first_pair_row < 0:
                first_pair_row = row_index
            likely_row = row_index + 1
            num_rows = max(num_rows, row_index + 1)
        number_below = number
    return num_rows, first_pair_row


@subkernel(forceinline=True, **NO_REFCOUNT)
def _kind_of_pair(surfaces, group_of_surface, rule, surface, near_surface, direction, is_at_border):
    """Return the kind of a pair of surfaces in neighboring cells, JOINED or LINKED; -1 for none.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        group_of_surface: the group of each surface, see `label_blocks`.
        rule: a `JoinRule`.
        surface: a surface.
        near_surface: a surface of another component of the same block, or of any of another block,
            in the neighboring cell.
        direction: the direction from the first to the second one, EAST or SOUTH.
        is_at_border: whether the border of two blocks is between them.
    """
    if _are_joined(surfaces, group_of_surface, rule, surface, near_surface, direction):
        # inside of a block, connected surfaces are one component already
        return JOINED if is_at_border else np.int64(-1)
    rise = abs(surfaces.z[surface] - surfaces.z[near_surface])
    return LINKED if rise <= rule.max_link_step + LIMIT_SLACK else np.int64(-1)


@subkernel(forceinline=True, **NO_REFCOUNT)
def _list_pairs_with_neighbor(
    surfaces, group_of_surface, rule, numbering, row, col, direction, is_at_border, pair_rows
):
    """Count the pairs of components that meet between a cell and its eastern or southern neighbor.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        group_of_surface: the group of each surface, see `label_blocks`.
        rule: a `JoinRule`.
        numbering: a `ComponentNumbering`, which has the overall numbers of the cell's components.
        row: row of the cell.
        col: its column.
        direction: the direction of the neighbor, EAST or SOUTH.
        is_at_border: whether the neighbor is in another block.
        pair_rows: the rows in which pairs are counted, as `PairRows`.

    Returns:
        The index past the last row then, -1 if there is no room for another row; and the row of
        the first of these pairs, -1 if there is none.
    """
    z = surfaces.z
    lattice = surfaces.lattice
    number_in_block = numbering.number_in_block
    cell = row * lattice.width + col
    neighbor = cell + (1 if direction == EAST else lattice.width)
    neighbor_block = block_of(lattice, row + direction, col + 1 - direction)
    neighbor_offset = numbering.offset_of_block[neighbor_block]
    max_rise = max_rise_of(rule)
    first_near_surface = surfaces.first[neighbor]
    end_in_neighbor = surfaces.end[neighbor]
    num_rows = np.int64(pair_rows.num_rows)
    likely_row = np.int64(pair_rows.likely_row)
    first_pair_row = np.int64(-1)
    for surface in range(np.int64(surfaces.first[cell]), surfaces.end[cell]):
        if number_in_block[surface] < 0:
            continue
        first_near_surface = find_first_not_below(
            z, first_near_surface, end_in_neighbor, z[surface] - max_rise
        )
        for near_surface in range(first_near_surface, end_in_neighbor):
            if z[near_surface] > z[surface] + max_rise:
                break
            is_same_component = (
                not is_at_border and number_in_block[surface] == number_in_block[near_surface]
            )
            if number_in_block[near_surface] < 0 or is_same_component:
                continue
            pair_kind = _kind_of_pair(
                surfaces, group_of_surface, rule, surface, near_surface, direction, is_at_border
            )
            if pair_kind < 0:
                continue
            row_index = count_row(
                pair_rows.rows,
                pair_rows.first_row,
                num_rows,
                likely_row,
                np.int64(numbering.overall_number[surface]),
                neighbor_offset + number_in_block[near_surface],
                pair_kind,
            )
            if row_index < 0:
                return np.int64(-1), first_pair_row
            if first_pair_row < 0:
                first_pair_row = row_index
            likely_row = row_index + 1
            num_rows = max(num_rows, row_index + 1)
    return num_rows, first_pair_row


@kernel(nogil=True, **NO_REFCOUNT)
def list_pairs(
    surfaces, group_of_surface, rule, numbering, blocks, row_counts, row_arrays, begin, end
):
    """Number components over all blocks, and list the pairs of components that meet.

    A kernel for `navbake.baker.core.blocks.list_rows`. It lists the pairs that meet inside of
    ``blocks[begin:end]``, or across the eastern and southern borders of these blocks.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        group_of_surface: the group of each surface, see `label_blocks`.
        rule: a `JoinRule`: the limits within which surfaces are connected, or else linked.
        numbering: a `ComponentNumbering`, whose `overall_number` is written.
        blocks: ids of blocks of cells.
        row_counts: receives how many rows each block has.
        row_arrays: one array that receives the rows, (n, 4) int64: the numbers of two components
            over all blocks; the kind of the pair; and how often they meet. Kinds: JOINED if the two
            are connected across the border of their blocks; LINKED if surfaces of them are linked,
            see `JoinRule`; STACKED if the first lies above the second in a cell, with no other
            component in between.
        begin: index in `blocks` of the first block to list.
        end: index past the last one.

    Returns:
        The index in `blocks` of the first block whose rows had no room; `end` if all had room.
    """
    lattice = surfaces.lattice
    rows = row_arrays[0]
    num_rows = np.int64(0)
    for block_index in range(begin, end):
        block = blocks[block_index]
        first_row = num_rows
        # of the last cell with such pairs: most cells count the pairs of the cell before
        first_stacked_row = num_rows
        first_eastern_row = num_rows
        first_southern_row = num_rows
        row_first, row_end, col_first, col_end = block_window(lattice, block)
        for row in range(row_first, row_end):
            for col in range(col_first, col_end):
                num_rows, first_pair_row = _list_stacked_pairs(
                    surfaces,
                    numbering,
                    numbering.offset_of_block[block],
                    row * lattice.width + col,
                    PairRows(rows, first_row, num_rows, first_stacked_row),
                )
                if num_rows < 0:
                    return block_index
                if first_pair_row >= 0:
                    first_stacked_row = first_pair_row
                for direction in range(2):
                    is_east = direction == EAST
                    is_at_border = col == col_end - 1 if is_east else row == row_end - 1
                    is_last = col == lattice.width - 1 if is_east else row == lattice.height - 1
                    if is_last or (not is_at_border and rule.max_link_step < 0.0):
                        continue
                    num_rows, first_pair_row = _list_pairs_with_neighbor(
                        surfaces,
                        group_of_surface,
                        rule,
                        numbering,
                        row,
                        col,
                        direction,
                        is_at_border,
                        PairRows(
                            rows,
                            first_row,
                            num_rows,
                            first_eastern_row if is_east else first_southern_row,
                        ),
                    )
                    if num_rows < 0:
                        return block_index
                    if first_pair_row >= 0 and is_east:
                        first_eastern_row = first_pair_row
                    elif first_pair_row >= 0:
                        first_southern_row = first_pair_row
        row_counts[block_index] = num_rows - first_row
    return end


@kernel(nogil=True, **NO_REFCOUNT)
def cross_tabulate(
    surfaces,
    label_of_surface,
    second_label_of_surface,
    level_of_surface,
    blocks,
    row_counts,
    row_arrays,
    begin,
    end,
):
    """Count the surfaces for each combination of two labels and a level (or a bin of heights).

    The surfaces of ``blocks[begin:end]`` are counted, except those with a negative first label or
    with level -1. This is a kernel for `navbake.baker.core.blocks.list_rows`.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        label_of_surface: the first label of each surface, such as the number of its component,
            int32.
        second_label_of_surface: the second label of each surface, int32.
        level_of_surface: the level of each surface, int32; if empty, surfaces are counted by their
            heights, in bins of `height_bin`, instead of by level.
        blocks: ids of blocks of cells.
        row_counts: receives how many rows each block has.
        row_arrays: two arrays that receive the rows: the two labels, the level or height bin, and
            the number of surfaces, (n, 4) int64; and the lowest height of these surfaces, (n,)
            float64 [m].
        begin: index in `blocks` of the first block to count.
        end: index past the last one.

    Returns:
        The index in `blocks` of the first block whose rows had no room; `end` if all had room.
    """
    rows, lowest_z = row_arrays
    num_rows = np.int64(0)
    lattice = surfaces.lattice
    for block_index in range(begin, end):
        num_rows_before = num_rows
        first_row_of_column = num_rows  # of the last column with any count
        row0, row1, col0, col1 = block_window(lattice, blocks[block_index])
        for row in range(row0, row1):
            for cell in range(row * lattice.width + col0, row * lattice.width + col1):
                likely_row = first_row_of_column
                has_counted = False
                for j in range(surfaces.first[cell], surfaces.end[cell]):
                    if label_of_surface[j] < 0 or (
                        level_of_surface.shape[0] > 0 and level_of_surface[j] == -1
                    ):
                        continue
                    z = surfaces.z[j]
                    level_or_bin = (
                        np.int64(level_of_surface[j])
                        if level_of_surface.shape[0] > 0
                        else height_bin(z)
                    )
                    row_index = count_row(
                        rows,
                        num_rows_before,
                        num_rows,
                        likely_row,
                        np.int64(label_of_surface[j]),
                        np.int64(second_label_of_surface[j]),
                        level_or_bin,
                    )
                    if row_index < 0:
                        return block_index
                    if not has_counted:
                        first_row_of_column = row_index
                    has_counted = True
                    likely_row = row_index + 1
                    lowest_z[row_index] = min(lowest_z[row_index], z) if row_index < num_rows else z
                    num_rows = max(num_rows, row_index + 1)
        row_counts[block_index] = num_rows - num_rows_before
    return end
