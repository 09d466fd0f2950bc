"""Label the connected components of surfaces block by block, and list where components meet.

Connected-component labelling by union-find with path halving (Tarjan and van Leeuwen, 1984), inside
of each block of cells; the caller merges components that meet across a block's border. The rows
that `list_pairs` and `cross_tabulate` list, as `navbake.baker.core.blocks.list_rows` describes, are
three numbers and how often they occur; the same three may come in several rows.
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
JOINED = 0  # they are one component, which the border of two blocks divides
LINKED = 1  # an agent steps from one to the other
STACKED = 2  # the first lies above the second one, with no third one in between
# Heights are counted in bins of this size; surfaces side by side whose heights differ by at most
# this are one plateau [m]
HEIGHT_BIN = 0.02
# So many of the last rows are compared with the next three numbers; older equal ones stay apart
NUM_RECENT_ROWS = 8
# A component's first surface has the key cell * MAX_RANK + rank, its rank among those of its cell
MAX_RANK = 4096


class JoinRule(NamedTuple):
    """Limits within which surfaces of neighboring cells are connected, or only linked.

    Attributes:
        step: the largest difference of height of connected surfaces of one group [m].
        link_step: the largest difference of height of linked surfaces; less than 0 if links are not
            listed [m].
        by_slopes: whether slopes connect surfaces, too, see `slopes_join`.
    """

    step: float
    link_step: float = -1.0
    by_slopes: bool = False


class ComponentNumbering(NamedTuple):
    """How components are numbered: inside of their blocks, and over all blocks.

    Attributes:
        in_block: by surface, the number of its component in its block, see `label_blocks`, int32.
        offset: by block, the number of its first component over all blocks, int64.
        overall: by surface, receives the number of its component over all blocks, -1 for none,
            int32.
    """

    in_block: Int32
    offset: Int
    overall: Int32


@subkernel(**NO_REFCOUNT)
def count_row(rows, begin, num, a, b, c):
    """Count an occurrence of three numbers in the row that counts them; append it if there is none.

    Returns the index of the row, or -1 if there is no room.

    Args:
        rows: three numbers and how often they occur, (n, 4) int64.
        begin: the first row of the current block.
        num: the index past the last row.
        a: the first of the numbers.
        b: the second one.
        c: the third one.
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
    """Return the index of the bin, HEIGHT_BIN high, whose center is nearest to a height."""
    return np.int64(np.rint(z / HEIGHT_BIN))


@subkernel(inline="always")
def _group_of(surfaces, group, j):
    """The group of a surface, less than 0 for none, see `label_blocks`."""
    if group.shape[0] > 0:
        return np.int64(group[j])
    return np.int64(0) if surfaces.marks[j] & STANDABLE else np.int64(-1)


@subkernel(inline="always")
def _are_joined(surfaces, group, rule, a, b, direction):
    """Whether two surfaces of neighboring cells are connected."""
    if _group_of(surfaces, group, a) != _group_of(surfaces, group, b):
        return False
    if abs(surfaces.z[a] - surfaces.z[b]) <= rule.step + LIMIT_SLACK:
        return True
    return rule.by_slopes and slopes_join(surfaces, a, b, direction, rule.step)


@subkernel(inline="always")
def _max_rise(rule):
    """The largest difference of height of surfaces that are connected or linked [m]."""
    return math.inf if rule.by_slopes else max(rule.step, rule.link_step) + LIMIT_SLACK


@subkernel(inline="always")
def _find_root(component, j):
    """The root of a surface's set, where ``-2 - component[j]`` is the parent of j."""
    while component[j] != -2 - j:
        parent = -2 - component[j]
        component[j] = component[parent]
        j = -2 - component[j]
    return j


@kernel(nogil=True, **NO_REFCOUNT)
def label_blocks(surfaces, group, rule, component, blocks, counts, columns, begin, end):
    """Label and measure the connected components of surfaces inside of ``blocks[begin:end]``.

    The rows, see `list_rows`, are the components in the order of their first surfaces. They have
    seven numbers, int64: how many surfaces the component has, and how many of these are UNCOVERED;
    the key of its first surface, see MAX_RANK; its first row and first column, and the row and
    column past its last ones. A second array has the lowest height of each component [m].

    Args:
        surfaces: all surfaces.
        group: by surface, its group, less than 0 for none, (n,) int32; if empty, all STANDABLE
            surfaces are one group. Only surfaces of one group are connected.
        rule: a `JoinRule`.
        component: by surface, receives the number of its component in its block, -1 for none, (n,)
            int32. While a block is labelled, it stores the parent's id p of union-find as -2 - p.
        blocks: ids of blocks.
        counts: receives the number of rows of each block.
        columns: receive the rows: an array for each field of a row.
        begin: the first of the blocks to label.
        end: the index past the last one.
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
        # unite each cell's surfaces with those of its western and northern neighbors
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
                        measures[n, 2] = cell * MAX_RANK + min(rank, MAX_RANK - 1)
                        measures[n, 3] = row
                        measures[n, 4] = col
                        component[root] = num
                        num += 1
                    component[j] = component[root]
                    n = offset + component[j]
                    measures[n, 0] += 1
                    measures[n, 1] += 1 if surfaces.marks[j] & UNCOVERED else 0
                    measures[n, 4] = min(measures[n, 4], col)
                    measures[n, 5] = row + 1
                    measures[n, 6] = max(measures[n, 6], col + 1)
                    lowest[n] = min(lowest[n], z[j])
                    rank += 1
        counts[k] = num
        offset += num
    return end


@kernel(nogil=True, **NO_REFCOUNT)
def list_pairs(surfaces, group, rule, numbering, blocks, counts, columns, begin, end):
    """Number components over all blocks, and list the pairs of components that meet.

    Pairs lie inside of ``blocks[begin:end]``, or across the eastern and southern borders of these.

    Each row holds the first component, by its number in the block; the second component; and the
    kind of the pair: JOINED (only across borders), LINKED or STACKED.

    Args:
        surfaces: all surfaces.
        group: as `label_blocks` takes it.
        rule: a `JoinRule`.
        numbering: a `ComponentNumbering`.
        blocks: ids of blocks.
        counts: receives the number of rows of each block.
        columns: receive the rows: an array for each field of a row.
        begin: the first of the blocks to list.
        end: the index past the last one.
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
                        at = count_row(rows, num_before, num, number[a], lower, STACKED)
                        if at < 0:
                            return k
                        num = max(num, at + 1)
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
                            at = count_row(rows, num_before, num, number[a], second, kind)
                            if at < 0:
                                return k
                            num = max(num, at + 1)
        counts[k] = num - num_before
    return end


@kernel(nogil=True, **NO_REFCOUNT)
def cross_tabulate(surfaces, label, second_label, level, blocks, counts, columns, begin, end):
    """Count the surfaces of ``blocks[begin:end]`` by two labels and their levels or height bins.

    Surfaces whose first label is less than 0 or whose level is -1 are left out. Each row holds the
    two labels, and the level or, if `level` is empty, the `height_bin`. A second array holds the
    lowest height of the surfaces of each row [m].

    Args:
        surfaces: all surfaces.
        label: by surface, int32.
        second_label: by surface, int32.
        level: by surface, int32, or empty.
        blocks: ids of blocks.
        counts: receives the number of rows of each block.
        columns: receive the rows: an array for each field of a row.
        begin: the first of the blocks to count.
        end: the index past the last one.
    """
    rows, low = columns
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
                    at = count_row(rows, num_before, num, label[j], second_label[j], third)
                    if at < 0:
                        return k
                    low[at] = min(low[at], z) if at < num else z
                    num = max(num, at + 1)
        counts[k] = num - num_before
    return end
