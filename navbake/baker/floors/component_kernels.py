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
from navbake.baker.floors.surface_kernels import EAST, STANDABLE, UNCOVERED, slopes_join
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Int, Int32

# Kinds of pairs of components
JOINED = 0  # they are connected, and only the border of two blocks divides them
LINKED = 1  # they are not connected, but an agent can step from one to the other
STACKED = 2  # in a cell, the first lies above the second one, with no other component between them
# Height of the bins of a histogram of heights: blocks of cells are counted one by one, and counts
# in the same bin are added up. Also the largest difference in height of adjacent surfaces of one
# plateau, which is a tread, a landing or a piece of a ramp [m]
HEIGHT_BIN = 0.02
# `count_row` looks for three numbers only in this many of the latest rows. If they stand in an
# older row, they get another row
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


class JoinRule(NamedTuple):
    """The limits within which surfaces of neighboring cells are connected, or else linked.

    Attributes:
        step: two surfaces of the same group, see `label_blocks`, are connected if their heights
            differ by at most this [m].
        link_step: two surfaces that are not connected are linked if their heights differ by at most
            this [m]; negative if no links are listed.
        by_slopes: whether surfaces of the same group are also connected where `slopes_join` says
            so.
    """

    step: float
    link_step: float = -1.0
    by_slopes: bool = False


class ComponentNumbering(NamedTuple):
    """The components of surfaces, numbered in each block from 0, and numbered over all blocks.

    Attributes:
        in_block: for each surface, the number of its component in the block, -1 for none, see
            `label_blocks`, int32.
        offset: for each block, how many components all blocks before it have, int64.
        overall: receives, for each surface, the number of its component over all blocks, -1 for
            none, int32.
    """

    in_block: Int32
    offset: Int
    overall: Int32


@subkernel(**NO_REFCOUNT)
def count_row(rows, begin, num, a, b, c):
    """Count one more occurrence of three numbers, such as a pair of components and its kind.

    The count stands in the row that begins with these numbers. If none of the latest
    NUM_RECENT_ROWS rows does, a row is appended.

    Args:
        rows: three numbers and their count in each row, (n, 4) int64.
        begin: index of the first row of the current block of cells.
        num: index past the last row written so far.
        a: the first of the three numbers.
        b: the second number.
        c: the third number.

    Returns:
        The index of the row with the count, or -1 if there is no room for another row.
    """
    for row in range(num - 1, max(begin, num - NUM_RECENT_ROWS) - 1, -1):
        if rows[row, 0] == a and rows[row, 1] == b and rows[row, 2] == c:
            rows[row, 3] += 1
            return row
    # the search is short, as neighboring cells mostly repeat the last numbers
    if num == rows.shape[0]:
        return np.int64(-1)
    rows[num, 0] = a
    rows[num, 1] = b
    rows[num, 2] = c
    rows[num, 3] = 1
    return num


@subkernel(inline="always")
def height_bin(z):
    """Return the index of the bin of heights whose middle is nearest to height z [m].

    Bins are HEIGHT_BIN high; the middle of bin 0 is at height 0.
    """
    return np.int64(np.rint(z / HEIGHT_BIN))


@subkernel(inline="always")
def _group_of(surfaces, group, j):
    """Return the group of surface j; negative if the surface is in no component.

    If the array `group` is empty, all STANDABLE surfaces are in group 0, see `label_blocks`.
    """
    if group.shape[0] > 0:
        return np.int64(group[j])
    return np.int64(0) if surfaces.marks[j] & STANDABLE else np.int64(-1)


@subkernel(inline="always")
def _are_joined(surfaces, group, rule, a, b, direction):
    """Return whether surfaces a and b are connected: same group, and joined by a step or slopes.

    `direction` is EAST or SOUTH, from the cell of a to the neighboring cell of b; `rule` is a
    `JoinRule`.
    """
    if _group_of(surfaces, group, a) != _group_of(surfaces, group, b):
        return False
    if abs(surfaces.z[a] - surfaces.z[b]) <= rule.step + LIMIT_SLACK:
        return True
    return rule.by_slopes and slopes_join(surfaces, a, b, direction, rule.step)


@subkernel(inline="always")
def _max_rise(rule):
    """Return an upper limit of the difference in height between connected or linked surfaces [m].

    It is infinite if slopes connect surfaces.
    """
    return math.inf if rule.by_slopes else max(rule.step, rule.link_step) + LIMIT_SLACK


@subkernel(inline="always")
def _find_root(component, j):
    """Return the root of the union-find set that surface j is in.

    ``component[j]`` is ``-2 - p``, where surface p is the parent of j; a root is its own parent.
    """
    while component[j] != -2 - j:
        parent = -2 - component[j]
        component[j] = component[parent]
        j = -2 - component[j]
    return j


@kernel(nogil=True, **NO_REFCOUNT)
def label_blocks(surfaces, group, rule, component, blocks, counts, columns, begin, end):
    """Label and measure the connected components of surfaces inside of ``blocks[begin:end]``.

    A kernel for `navbake.baker.core.blocks.list_rows`. It lists a row for each component of a
    block, in the order of their first surfaces. A component's first surface is its lowest one in
    the first of its cells, row by row from the north-west.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        group: the group of each surface, (n,) int32. Only surfaces of the same group are connected;
            surfaces of a negative group are in no component. If empty, all STANDABLE surfaces are
            in one group, and the others in none.
        rule: a `JoinRule`: the limits within which surfaces are connected, or else linked.
        component: receives, for each surface, the number of its component in its block, -1 for
            none, (n,) int32. While a block is labelled, it holds the parents of union-find: -2 - p
            for parent p.
        blocks: ids of blocks of cells.
        counts: receives how many components each block has.
        columns: two arrays that receive the rows: seven numbers of each component, at the indices
            from NUM_SURFACES to END_COL, (n, 7) int64; and its lowest height, (n,) float64 [m].
        begin: index in `blocks` of the first block to label.
        end: index past the last one.

    Returns:
        The index in `blocks` of the first block whose rows had no room; `end` if all had room.
    """
    measures, lowest = columns
    first = surfaces.first
    ends = surfaces.end
    z = surfaces.z
    lattice = surfaces.lattice
    max_rise = _max_rise(rule)
    offset = 0
    width = lattice.width
    for k in range(begin, end):
        row0, row1, col0, col1 = block_window(lattice, blocks[k])
        # unite each cell's surfaces with the surfaces of its western and northern neighbors
        for row in range(row0, row1):
            for cell in range(row * width + col0, row * width + col1):
                first_in_cell = first[cell]
                end_in_cell = ends[cell]
                for j in range(first_in_cell, end_in_cell):
                    component[j] = -2 - j if _group_of(surfaces, group, j) >= 0 else -1
                for direction in range(2):
                    if cell == row * width + col0 if direction == EAST else row == row0:
                        continue
                    neighbor = cell - 1 if direction == EAST else cell - width
                    low = first[neighbor]
                    last = ends[neighbor]
                    for j in range(first_in_cell, end_in_cell):
                        if component[j] == -1:
                            continue
                        # heights ascend in both cells, so `low` only moves up
                        while low < last and z[low] < z[j] - max_rise:
                            low += 1
                        for i in range(low, last):
                            if z[i] > z[j] + max_rise:
                                break
                            if component[i] == -1:
                                continue
                            if _are_joined(surfaces, group, rule, i, j, direction):
                                root_i = _find_root(component, i)
                                root_j = _find_root(component, j)
                                if root_i != root_j:
                                    # the lower id is the root, whatever the order of unions
                                    component[max(root_i, root_j)] = -2 - min(root_i, root_j)
        # replace parents by numbers, which are >= 0, and measure
        num = 0
        for row in range(row0, row1):
            for col in range(col0, col1):
                cell = row * width + col
                rank = 0
                for j in range(first[cell], ends[cell]):
                    if component[j] == -1:
                        continue
                    root = j
                    while component[root] < -1 and component[root] != -2 - root:
                        root = -2 - component[root]
                    if component[root] < -1:  # the root has no number yet
                        n = offset + num
                        if n == lowest.shape[0]:
                            return k
                        measures[n, :] = 0
                        lowest[n] = z[j]
                        # surfaces are visited in the order of cells: this is the first one
                        measures[n, FIRST_SURFACE] = cell * MAX_RANK + min(rank, MAX_RANK - 1)
                        measures[n, FIRST_ROW] = row
                        measures[n, FIRST_COL] = col
                        component[root] = num
                        num += 1
                    component[j] = component[root]
                    n = offset + component[j]
                    measures[n, NUM_SURFACES] += 1
                    measures[n, NUM_UNCOVERED] += 1 if surfaces.marks[j] & UNCOVERED else 0
                    measures[n, FIRST_COL] = min(measures[n, FIRST_COL], col)
                    measures[n, END_ROW] = row + 1
                    measures[n, END_COL] = max(measures[n, END_COL], col + 1)
                    lowest[n] = min(lowest[n], z[j])
                    rank += 1
        counts[k] = num
        offset += num
    return end


@kernel(nogil=True, **NO_REFCOUNT)
def list_pairs(surfaces, group, rule, numbering, blocks, counts, columns, begin, end):
    """Number components over all blocks, and list the pairs of components that meet.

    A kernel for `navbake.baker.core.blocks.list_rows`. It lists the pairs that meet inside of
    ``blocks[begin:end]``, or across the eastern and southern borders of these blocks.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        group: the group of each surface, see `label_blocks`.
        rule: a `JoinRule`: the limits within which surfaces are connected, or else linked.
        numbering: a `ComponentNumbering`, whose `overall` is written.
        blocks: ids of blocks of cells.
        counts: receives how many rows each block has.
        columns: one array that receives the rows, (n, 4) int64: the numbers of two components over
            all blocks; the kind of the pair, JOINED (only across borders), LINKED or STACKED; and
            how often they meet.
        begin: index in `blocks` of the first block to list.
        end: index past the last one.

    Returns:
        The index in `blocks` of the first block whose rows had no room; `end` if all had room.
    """
    first = surfaces.first
    ends = surfaces.end
    z = surfaces.z
    lattice = surfaces.lattice
    rows = columns[0]
    num = np.int64(0)
    width = lattice.width
    max_rise = _max_rise(rule)
    component = numbering.in_block
    offset = numbering.offset
    number = numbering.overall
    for k in range(begin, end):
        num_before = num
        row0, row1, col0, col1 = block_window(lattice, blocks[k])
        for row in range(row0, row1):
            for col in range(col0, col1):
                cell = row * width + col
                lower = np.int32(-1)
                for a in range(first[cell], ends[cell]):
                    number[a] = -1
                    if component[a] < 0:
                        continue
                    number[a] = offset[blocks[k]] + component[a]
                    if lower >= 0:
                        row_index = count_row(rows, num_before, num, number[a], lower, STACKED)
                        if row_index < 0:
                            return k
                        num = max(num, row_index + 1)
                    lower = number[a]
                for direction in range(2):
                    at_border = col == col1 - 1 if direction == EAST else row == row1 - 1
                    if not at_border and rule.link_step < 0.0:
                        continue
                    if (col == width - 1) if direction == EAST else (row == lattice.height - 1):
                        continue
                    neighbor = cell + (1 if direction == EAST else width)
                    neighbor_block = block_of(lattice, row + direction, col + 1 - direction)
                    neighbor_offset = offset[neighbor_block]
                    low = first[neighbor]
                    last = ends[neighbor]
                    for a in range(first[cell], ends[cell]):
                        if component[a] < 0:
                            continue
                        # heights ascend in both cells, so `low` only moves up
                        while low < last and z[low] < z[a] - max_rise:
                            low += 1
                        for b in range(low, last):
                            if z[b] > z[a] + max_rise:
                                break
                            if component[b] < 0:
                                continue
                            if not at_border and component[a] == component[b]:
                                continue
                            joined = _are_joined(surfaces, group, rule, a, b, direction)
                            is_too_high = abs(z[a] - z[b]) > rule.link_step + LIMIT_SLACK
                            # inside of a block, connected surfaces are one component already
                            if (not at_border) if joined else is_too_high:
                                continue
                            kind = JOINED if joined else LINKED
                            second = neighbor_offset + component[b]
                            row_index = count_row(rows, num_before, num, number[a], second, kind)
                            if row_index < 0:
                                return k
                            num = max(num, row_index + 1)
        counts[k] = num - num_before
    return end


@kernel(nogil=True, **NO_REFCOUNT)
def cross_tabulate(surfaces, label, second_label, level, blocks, counts, columns, begin, end):
    """Count how many surfaces have the same two labels and the same level, or height.

    The surfaces of ``blocks[begin:end]`` are counted, except those with a negative first label or
    with level -1. This is a kernel for `navbake.baker.core.blocks.list_rows`.

    Args:
        surfaces: the surfaces of all cells, as `Surfaces`.
        label: the first label of each surface, such as the number of its component, int32.
        second_label: the second label of each surface, int32.
        level: the level of each surface, int32; if empty, surfaces are counted by their heights, in
            bins of `height_bin`, instead of by level.
        blocks: ids of blocks of cells.
        counts: receives how many rows each block has.
        columns: two arrays that receive the rows: the two labels, the level or height bin, and the
            number of surfaces, (n, 4) int64; and the lowest height of these surfaces, (n,) float64
            [m].
        begin: index in `blocks` of the first block to count.
        end: index past the last one.

    Returns:
        The index in `blocks` of the first block whose rows had no room; `end` if all had room.
    """
    rows, lowest = columns
    num = np.int64(0)
    lattice = surfaces.lattice
    for k in range(begin, end):
        num_before = num
        row0, row1, col0, col1 = block_window(lattice, blocks[k])
        for row in range(row0, row1):
            for cell in range(row * lattice.width + col0, row * lattice.width + col1):
                for j in range(surfaces.first[cell], surfaces.end[cell]):
                    if label[j] < 0 or (level.shape[0] > 0 and level[j] == -1):
                        continue
                    z = surfaces.z[j]
                    third = np.int64(level[j]) if level.shape[0] > 0 else height_bin(z)
                    row_index = count_row(rows, num_before, num, label[j], second_label[j], third)
                    if row_index < 0:
                        return k
                    lowest[row_index] = min(lowest[row_index], z) if row_index < num else z
                    num = max(num, row_index + 1)
        counts[k] = num - num_before
    return end
