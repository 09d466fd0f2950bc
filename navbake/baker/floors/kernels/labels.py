"""Connected parts of surfaces, block by block, and the pairs of parts that meet.

Union-find inside of each block; parts that meet over a border are pairs, which the caller unites.
"""

import numpy as np

from navbake.baker.floors.kernels.surfaces import STANDS, TOP
from navbake.baker.kernels.blocks import block_window
from navbake.baker.kernels.constants import SLACK
from navbake.compiled import UNCOUNTED, kernel, part
from navbake.navgrid.kernels.union_find import find_root, unite

# Kinds of pairs: both belong to one part; an agent steps from one to the other
JOINS, LINKS = 0, 1
# Pairs of so many parts of a block are counted in a table
FEW = 256


@part(inline="always")
def _group(surfaces, key, j):
    """The group of a surface, less than 0 for none: its key, or whether one can stand there."""
    if key.shape[0] > 0:
        return np.int64(key[j])
    return np.int64(0) if surfaces.marks[j] & STANDS else np.int64(-1)


@part(**UNCOUNTED)
def slope_joins(lattice, surfaces, a, b, way, step):
    """Whether slopes join two surfaces of neighbouring cells that no step joins.

    `b` is east (0) or south (1) of `a`. Each one's slope predicts a rise over a cell; the steeper
    is more than a step. Between the predictions lies whatever a floor with these two slopes may
    rise that bends somewhere on the way, as at a ramp's foot; or the rise is at most a step less
    or more than both.
    """
    dz = surfaces.z[b] - surfaces.z[a]
    if abs(dz) <= step + SLACK:
        return False
    normal = surfaces.normal
    # rows run south, against y
    axis, turn = (0, -lattice.cell_size) if way == 0 else (1, lattice.cell_size)
    one, other = turn * normal[a, axis] / normal[a, 2], turn * normal[b, axis] / normal[b, 2]
    if max(abs(one), abs(other)) <= step + SLACK:
        return False
    if min(one, other) - SLACK <= dz <= max(one, other) + SLACK:
        return True
    return abs(dz - one) <= step + SLACK and abs(dz - other) <= step + SLACK


@part(inline="always")
def _unite_with(lattice, surfaces, key, step, by_slopes, part, parent, cell, other, way):
    """Unite the surfaces of a cell with those of the one north or west of it."""
    first, length, z = surfaces.first, surfaces.length, surfaces.z
    for j in range(first[cell], first[cell] + length[cell]):
        if part[j] < 0:
            continue
        for i in range(first[other], first[other] + length[other]):
            if part[i] < 0 or _group(surfaces, key, i) != _group(surfaces, key, j):
                continue
            joins = abs(z[i] - z[j]) <= step + SLACK
            if by_slopes and not joins:
                joins = slope_joins(lattice, surfaces, i, j, way, step)
            if joins:
                unite(parent, np.int64(part[i]), np.int64(part[j]))


@part(**UNCOUNTED)
def _number_members(surfaces, key, window, width, part):
    """Number the surfaces of a block that belong to a group; returns how many they are."""
    row0, row1, col0, col1 = window
    num = 0
    for row in range(row0, row1):
        for cell in range(row * width + col0, row * width + col1):
            for j in range(surfaces.first[cell], surfaces.first[cell] + surfaces.length[cell]):
                if _group(surfaces, key, j) >= 0:
                    part[j] = num
                    num += 1
                else:
                    part[j] = -1
    return num


@part(**UNCOUNTED)
def _label_block(lattice, surfaces, key, step, by_slopes, window, part, parent, label):
    """Turn the numbers of surfaces in a block into those of their parts; returns how many."""
    row0, row1, col0, col1 = window
    first, length, width = surfaces.first, surfaces.length, lattice.width
    for row in range(row0, row1):
        for col in range(col0, col1):
            cell = row * width + col
            if length[cell] == 0:
                continue
            if col > col0:
                _unite_with(
                    lattice, surfaces, key, step, by_slopes, part, parent, cell, cell - 1, 0
                )
            if row > row0:
                _unite_with(
                    lattice, surfaces, key, step, by_slopes, part, parent, cell, cell - width, 1
                )
    parts = 0
    for n in range(parent.shape[0]):
        root = find_root(parent, n)
        if root == n:
            label[n] = parts
            parts += 1
        else:
            label[n] = label[root]
    for row in range(row0, row1):
        for cell in range(row * width + col0, row * width + col1):
            for j in range(first[cell], first[cell] + length[cell]):
                if part[j] >= 0:
                    part[j] = label[part[j]]
    return parts


@kernel(nogil=True)
def label_blocks(lattice, surfaces, key, step, by_slopes, part, blocks, count, begin, end):
    """Number the connected parts of surfaces inside of each of ``blocks[begin:end]``.

    Surfaces of one group (`key`, (n,) int32, less than 0 for none; those that one can stand on if
    it is empty) in neighbouring cells hang together when they are at most a step apart, or where
    slopes join them. `part`, (n,) int32, receives their numbers, from 0 by their first members in
    the order of cells, -1 for surfaces of no group; `count`, by block, how many parts there are.
    """
    for k in range(begin, end):
        window = block_window(lattice, blocks[k])
        num = _number_members(surfaces, key, window, lattice.width, part)
        parent, label = np.arange(num), np.empty(num, np.int32)
        count[blocks[k]] = _label_block(
            lattice, surfaces, key, step, by_slopes, window, part, parent, label
        )


@part
def double(rows):
    """Rows with room for twice as many."""
    wide = np.empty((2 * rows.shape[0], rows.shape[1]), rows.dtype)
    wide[: rows.shape[0]] = rows
    return wide


@part(**UNCOUNTED)
def _list_pairs(lattice, surfaces, key, joining, part, block, rows, num, last):
    """See `list_pairs`; of one block. Returns how many rows there are then, -1 for no room."""
    first, length, z, width = surfaces.first, surfaces.length, surfaces.z, lattice.width
    step, reach, by_slopes = joining.step, joining.reach, joining.by_slopes
    row0, row1, col0, col1 = block_window(lattice, block)
    for row in range(row0, row1):
        for col in range(col0, col1):
            cell = row * width + col
            for way in range(2):
                at_border = col == col1 - 1 if way == 0 else row == row1 - 1
                if not at_border and reach < 0.0:
                    continue
                if (col == width - 1) if way == 0 else (row == lattice.height - 1):
                    continue
                other = cell + 1 if way == 0 else cell + width
                where = way + 1 if at_border else 0
                for a in range(first[cell], first[cell] + length[cell]):
                    if part[a] < 0:
                        continue
                    for b in range(first[other], first[other] + length[other]):
                        if part[b] < 0 or (where == 0 and part[a] == part[b]):
                            continue
                        gap, kind = abs(z[a] - z[b]), -1
                        joins = gap <= step + SLACK
                        if by_slopes and not joins:
                            joins = slope_joins(lattice, surfaces, a, b, way, step)
                        if joins and _group(surfaces, key, a) == _group(surfaces, key, b):
                            kind = JOINS
                        elif gap <= reach + SLACK and reach >= 0.0:
                            kind = LINKS
                        if kind < 0 or (kind == JOINS and where == 0):
                            continue
                        if last[kind, where, 0] == part[a] and last[kind, where, 1] == part[b]:
                            continue
                        last[kind, where, 0], last[kind, where, 1] = part[a], part[b]
                        if num == rows.shape[0]:
                            return np.int64(-1)
                        rows[num, 0], rows[num, 1] = kind, part[a]
                        rows[num, 2], rows[num, 3] = where, part[b]
                        num += 1
    return num


@kernel(nogil=True)
def list_pairs(lattice, surfaces, key, joining, part, blocks, begin, end):
    """List the pairs of parts that meet, inside of blocks and over their east and south borders.

    Parts of one group JOIN over a border where surfaces are at most a step apart, or slopes join
    them. Parts LINK that do not join and have surfaces at most a reach apart, everywhere; none do
    where it is less than 0: see `Joining`.

    Returns how many pairs each of ``blocks[begin:end]`` has, and rows of int32: the kind, the part
    in the block, 0 if the other is in the same block, 1 and 2 if it is in the one east and south
    of it, and the number of the other one there. Pairs may be listed several times.
    """
    counts = np.zeros(end - begin, np.int64)
    rows, num = np.empty((64, 4), np.int32), np.int64(0)
    for k in range(begin, end):
        before, num = num, np.int64(-1)
        while num < 0:
            last = np.full((2, 3, 2), np.int32(-1))
            num = _list_pairs(lattice, surfaces, key, joining, part, blocks[k], rows, before, last)
            if num < 0:
                rows = double(rows)
        counts[k - begin] = num - before
    return counts, rows[:num].copy()


@part(inline="always")
def _mix(cell, bits, geom):
    """A number for a surface, so that the sum over a sheet tells sheets apart."""
    x = np.uint64(bits) ^ (np.uint64(cell) * np.uint64(0x9E3779B97F4A7C15))
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27)) ^ (np.uint64(geom) << np.uint64(40))) * np.uint64(
        0x94D049BB133111EB
    )
    return x ^ (x >> np.uint64(31))


@kernel(nogil=True, **UNCOUNTED)
def measure_parts(lattice, surfaces, bits, part, blocks, offset, measured, begin, end):
    """Measure the parts of ``blocks[begin:end]``; block k's begin at ``offset[k]`` in the results.

    Args:
        bits: the heights' bits, int64.
        measured: receives how many surfaces each part has, and over how many nothing lies, int64;
            its first member, as its cell and its place there, int64; its first row and column, and
            past its last ones, (n, 4) int32; and a sum over its members, uint64.
    """
    size, tops, first_key, box, digest = measured
    first, length = surfaces.first, surfaces.length
    for k in range(begin, end):
        row0, row1, col0, col1 = block_window(lattice, blocks[k])
        for row in range(row0, row1):
            for col in range(col0, col1):
                cell, rank = row * lattice.width + col, 0
                for j in range(first[cell], first[cell] + length[cell]):
                    if part[j] < 0:
                        continue
                    n = offset[k] + part[j]
                    if size[n] == 0:
                        first_key[n] = cell * 4096 + min(rank, 4095)
                        box[n, 0], box[n, 1], box[n, 2], box[n, 3] = row, col, row + 1, col + 1
                    size[n] += 1
                    tops[n] += 1 if surfaces.marks[j] & TOP else 0
                    box[n, 1], box[n, 2] = min(box[n, 1], col), row + 1
                    box[n, 3] = max(box[n, 3], col + 1)
                    digest[n] += _mix(cell, bits[j], surfaces.geom[j])
                    rank += 1


@part(**UNCOUNTED)
def _list_stacks(lattice, surfaces, part, block, rows, num, known):
    """See `list_stacks`; of one block. Returns how many rows there are then, -1 for no room.

    `known` holds the place of a pair's row, -1 for none; it is empty where there are many parts.
    """
    first, length = surfaces.first, surfaces.length
    row0, row1, col0, col1 = block_window(lattice, block)
    for row in range(row0, row1):
        for cell in range(row * lattice.width + col0, row * lattice.width + col1):
            for a in range(first[cell] + 1, first[cell] + length[cell]):
                if part[a] < 0:
                    continue
                is_next = True
                for b in range(a - 1, first[cell] - 1, -1):
                    if part[b] < 0:
                        continue
                    at = np.int64(-1)
                    if known.shape[0] > 0:
                        at = np.int64(known[part[a], part[b]])
                    if at < 0:
                        if num == rows.shape[0]:
                            return np.int64(-1)
                        at = num
                        rows[at, 0], rows[at, 1], rows[at, 2] = part[a], part[b], 0
                        if known.shape[0] > 0:
                            known[part[a], part[b]] = at
                        num += 1
                    rows[at, 2] += 1 if is_next else 0
                    is_next = False
    return num


@kernel(nogil=True)
def list_stacks(lattice, surfaces, part, blocks, count, begin, end):
    """List which parts lie over which in the columns of ``blocks[begin:end]``.

    Returns how many rows each block has, and the rows, int32: the part above, the one below, and
    in how many columns nothing that one can stand on lies in between. Rows may repeat.
    """
    counts = np.zeros(end - begin, np.int64)
    rows, num = np.empty((64, 3), np.int32), np.int64(0)
    for k in range(begin, end):
        before, num, parts = num, np.int64(-1), count[blocks[k]]
        while num < 0:
            known = np.full((parts, parts) if parts <= FEW else (0, 0), np.int32(-1))
            num = _list_stacks(lattice, surfaces, part, blocks[k], rows, before, known)
            if num < 0:
                rows = double(rows)
        counts[k - begin] = num - before
    return counts, rows[:num].copy()
