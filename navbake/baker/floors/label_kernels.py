"""Connected parts of surfaces, block by block, the pairs of parts that meet, and their sizes.

Union-find inside of each block, as in `navbake.baker.core.union_find`; the caller unites parts that
meet over a border. Rows of `list_pairs` and `tally`, see `navbake.baker.core.blocks.list_rows`, are
three numbers and their count; the same three may come in several rows.
"""

import math
from typing import NamedTuple

import numpy as np

from navbake.baker.core.tiles import block_of, block_window
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors.surface_kernels import STANDS, TOP, slope_joins
from navbake.compiled import NO_REFCOUNT, kernel, subkernel
from navbake.types import Int, Int32

# Kinds of pairs: both belong to one part; an agent steps from one to the other; one lies next over
# the other
JOINS = 0
LINKS = 1
LIES = 2
# Floors whose heights round to the same multiple of this are one plateau [m]
PLATEAU = 0.02
# So many of the last rows are searched for the same three numbers
FEW = 8


class Joining(NamedTuple):
    """What joins surfaces of neighbouring cells, and what only links them.

    Attributes:
        step: the greatest gap between joined surfaces of one group [m].
        reach: the greatest gap between linked surfaces, less than 0 for no links [m].
        by_slopes: whether slopes join surfaces, too.
    """

    step: float
    reach: float = -1.0
    by_slopes: bool = False


class Numbering(NamedTuple):
    """How parts are numbered over all blocks.

    Attributes:
        part: see `label_blocks`.
        offset: the number of each block's first part, int64.
        number: receives the number of each surface's part, -1 for none, int32.
    """

    part: Int32
    offset: Int
    number: Int32


@subkernel(**NO_REFCOUNT)
def note_row(rows, begin, num, a, b, c):
    """Count three numbers in ``rows[begin:num]``; returns their row, -1 for no room."""
    for at in range(num - 1, max(begin, num - FEW) - 1, -1):
        if rows[at, 0] == a and rows[at, 1] == b and rows[at, 2] == c:
            rows[at, 3] += 1
            return at
    if num == rows.shape[0]:
        return np.int64(-1)
    rows[num, 0] = a
    rows[num, 1] = b
    rows[num, 2] = c
    rows[num, 3] = 1
    return num


@subkernel(inline="always")
def bin_of(z):
    """The multiple of PLATEAU that a height rounds to."""
    return np.int64(np.rint(z / PLATEAU))


@subkernel(inline="always")
def _group(surfaces, key, j):
    """The group of a surface, less than 0 for none, see `label_blocks`."""
    if key.shape[0] > 0:
        return np.int64(key[j])
    return np.int64(0) if surfaces.marks[j] & STANDS else np.int64(-1)


@subkernel(inline="always")
def _joins(surfaces, key, joining, a, b, way):
    """Whether two surfaces of neighbouring cells are of one part."""
    if _group(surfaces, key, a) != _group(surfaces, key, b):
        return False
    if abs(surfaces.z[a] - surfaces.z[b]) <= joining.step + LIMIT_SLACK:
        return True
    return joining.by_slopes and slope_joins(surfaces, a, b, way, joining.step)


@subkernel(inline="always")
def _far(joining):
    """The greatest gap between surfaces that join or are linked [m]."""
    return math.inf if joining.by_slopes else max(joining.step, joining.reach) + LIMIT_SLACK


@subkernel(inline="always")
def _find_root(part, j):
    """The root of a surface's set, see `label_blocks`."""
    while part[j] != -2 - j:
        above = -2 - part[j]
        part[j] = part[above]
        j = -2 - part[j]
    return j


@kernel(nogil=True, **NO_REFCOUNT)
def label_blocks(surfaces, key, joining, part, blocks, counts, columns, begin, end):
    """Number the connected parts of surfaces inside of each of ``blocks[begin:end]``; measure them.

    The rows are the parts, by their first members, see `list_rows`: how many
    surfaces a part has, and how many of these lie uppermost; its first member, by cell and rank;
    its first row and column, and past its last ones, (n, 7) int64. A column more has the lowest
    height [m].

    Args:
        key: the group of each surface, less than 0 for none, (n,) int32; if empty, all surfaces
            that one can stand on are one group. Only surfaces of one group are connected.
        part: receives the number of each surface's part in its block, -1 for none, (n,) int32.
    """
    measures, lowest = columns
    first = surfaces.first
    ends = surfaces.end
    z = surfaces.z
    lattice = surfaces.lattice
    far = _far(joining)
    offset = 0
    width = lattice.width
    for k in range(begin, end):
        row0, row1, col0, col1 = block_window(lattice, blocks[k])
        # at first `part` has the parents of union-find: -2 less their places
        for row in range(row0, row1):
            for cell in range(row * width + col0, row * width + col1):
                begin_here = first[cell]
                end_here = ends[cell]
                for j in range(begin_here, end_here):
                    part[j] = -2 - j if _group(surfaces, key, j) >= 0 else -1
                for way in range(2):
                    if cell == row * width + col0 if way == 0 else row == row0:
                        continue
                    other = cell - 1 if way == 0 else cell - width
                    low = first[other]
                    last = ends[other]
                    for j in range(begin_here, end_here):
                        if part[j] == -1:
                            continue
                        while low < last and z[low] < z[j] - far:
                            low += 1
                        for i in range(low, last):
                            if z[i] > z[j] + far:
                                break
                            if part[i] != -1 and _joins(surfaces, key, joining, i, j, way):
                                one = _find_root(part, i)
                                two = _find_root(part, j)
                                if one != two:
                                    part[max(one, two)] = -2 - min(one, two)
        num = 0
        for row in range(row0, row1):
            for col in range(col0, col1):
                cell = row * width + col
                rank = 0
                for j in range(first[cell], ends[cell]):
                    if part[j] == -1:
                        continue
                    root = j
                    while part[root] < -1 and part[root] != -2 - root:
                        root = -2 - part[root]
                    if part[root] < -1:
                        n = offset + num
                        if n == lowest.shape[0]:
                            return k
                        measures[n, :] = 0
                        lowest[n] = z[j]
                        measures[n, 2] = cell * 4096 + min(rank, 4095)
                        measures[n, 3] = row
                        measures[n, 4] = col
                        part[root] = num
                        num += 1
                    part[j] = part[root]
                    n = offset + part[j]
                    measures[n, 0] += 1
                    measures[n, 1] += 1 if surfaces.marks[j] & TOP else 0
                    measures[n, 4] = min(measures[n, 4], col)
                    measures[n, 5] = row + 1
                    measures[n, 6] = max(measures[n, 6], col + 1)
                    lowest[n] = min(lowest[n], z[j])
                    rank += 1
        counts[k] = num
        offset += num
    return end


@kernel(nogil=True, **NO_REFCOUNT)
def list_pairs(surfaces, key, joining, numbering, blocks, counts, columns, begin, end):
    """Number parts over all blocks, and list the pairs of parts in and beside blocks that meet.

    Looks at ``blocks[begin:end]``, and over their east and south borders.

    The rows: the part in the block, the other one, and the kind: JOINS (over borders alone), LINKS
    or LIES.

    Args:
        numbering: see `Numbering`.
    """
    first = surfaces.first
    ends = surfaces.end
    z = surfaces.z
    lattice = surfaces.lattice
    rows = columns[0]
    num = np.int64(0)
    width = lattice.width
    far = _far(joining)
    part = numbering.part
    offset = numbering.offset
    number = numbering.number
    for k in range(begin, end):
        before = num
        row0, row1, col0, col1 = block_window(lattice, blocks[k])
        for row in range(row0, row1):
            for col in range(col0, col1):
                cell = row * width + col
                lower = np.int32(-1)
                for a in range(first[cell], ends[cell]):
                    number[a] = -1
                    if part[a] < 0:
                        continue
                    number[a] = offset[blocks[k]] + part[a]
                    if lower >= 0:
                        at = note_row(rows, before, num, number[a], lower, LIES)
                        if at < 0:
                            return k
                        num = max(num, at + 1)
                    lower = number[a]
                for way in range(2):
                    at_border = col == col1 - 1 if way == 0 else row == row1 - 1
                    if not at_border and joining.reach < 0.0:
                        continue
                    if (col == width - 1) if way == 0 else (row == lattice.height - 1):
                        continue
                    other = cell + (1 if way == 0 else width)
                    other_offset = offset[block_of(lattice, row + way, col + 1 - way)]
                    low = first[other]
                    last = ends[other]
                    for a in range(first[cell], ends[cell]):
                        if part[a] < 0:
                            continue
                        while low < last and z[low] < z[a] - far:
                            low += 1
                        for b in range(low, last):
                            if z[b] > z[a] + far:
                                break
                            if part[b] < 0 or (not at_border and part[a] == part[b]):
                                continue
                            joins = _joins(surfaces, key, joining, a, b, way)
                            apart = abs(z[a] - z[b]) > joining.reach + LIMIT_SLACK
                            if (not at_border) if joins else apart:
                                continue
                            kind = JOINS if joins else LINKS
                            to = other_offset + part[b]
                            at = note_row(rows, before, num, number[a], to, kind)
                            if at < 0:
                                return k
                            num = max(num, at + 1)
        counts[k] = num - before
    return end


@kernel(nogil=True, **NO_REFCOUNT)
def tally(surfaces, own, other, level, blocks, counts, columns, begin, end):
    """Count the surfaces of ``blocks[begin:end]`` whose `own` number is >= 0.

    The rows: the `own` and the `other` number, and the level, unless that is -1; if `level` is
    empty, the multiple of PLATEAU. A column more has the lowest height of each row [m].
    """
    rows, low = columns
    num = np.int64(0)
    lattice = surfaces.lattice
    for k in range(begin, end):
        before = num
        row0, row1, col0, col1 = block_window(lattice, blocks[k])
        for row in range(row0, row1):
            for cell in range(row * lattice.width + col0, row * lattice.width + col1):
                for j in range(surfaces.first[cell], surfaces.end[cell]):
                    if own[j] < 0 or (level.shape[0] > 0 and level[j] == -1):
                        continue
                    z = surfaces.z[j]
                    value = np.int64(level[j]) if level.shape[0] > 0 else bin_of(z)
                    at = note_row(rows, before, num, own[j], other[j], value)
                    if at < 0:
                        return k
                    low[at] = min(low[at], z) if at < num else z
                    num = max(num, at + 1)
        counts[k] = num - before
    return end
