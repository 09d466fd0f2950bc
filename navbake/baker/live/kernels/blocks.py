"""Whether a large sheet hangs together, found out block by block.

Connected components in two steps, as in hierarchical path finding (Botea, Müller and Schaeffer,
"Near optimal hierarchical path-finding", 2004): inside of each square block of cells, and then of
the blocks' parts, over the blocks' borders. What changes a few cells changes the parts of a few
blocks, and the second step has few nodes.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.kernels.constants import SLACK
from navbake.compiled import kernel
from navbake.navgrid.kernels.union_find import find_root, unite
from navbake.types import Float, Int

# Edge of a block [cells]; it has at most half as many parts as cells
EDGE = 32
MOST_PARTS = EDGE * EDGE // 2


class Blocks(NamedTuple):
    """The parts of a sheet in blocks of cells. Of each cell, at most one surface belongs to it.

    Attributes:
        height: of the sheet in each cell, NaN for none, (cells,) float64 [m].
        part: the part of its block that each cell belongs to, (cells,) int16, -1 for none.
        num_parts: how many parts each block has, (blocks,) int64.
        size: how many cells each of them has, (blocks, MOST_PARTS) int16.
        pairs: parts that meet over the eastern and the southern border of each block, and how
            many such pairs there are, (blocks, 2, EDGE, 2) int16 and (blocks, 2) int64.
    """

    height: Float
    part: NDArray[np.int16]
    num_parts: Int
    size: NDArray[np.int16]
    pairs: NDArray[np.int16]
    num_pairs: Int

    @classmethod
    def empty(cls, width: int, height: int) -> "Blocks":
        """No parts, for a lattice."""
        cells, blocks = width * height, -(-width // EDGE) * -(-height // EDGE)
        return cls(
            np.full(cells, np.nan),
            np.full(cells, -1, dtype=np.int16),
            np.zeros(blocks, dtype=np.int64),
            np.zeros((blocks, MOST_PARTS), dtype=np.int16),
            np.zeros((blocks, 2, EDGE, 2), dtype=np.int16),
            np.zeros((blocks, 2), dtype=np.int64),
        )


@kernel(nogil=True)
def list_blocks(lattice, cells):
    """The blocks that some cells are in, and those with a border to them: two ascending lists."""
    columns, rows = -(-lattice.width // EDGE), -(-lattice.height // EDGE)
    own, around = np.zeros(rows * columns, np.bool_), np.zeros(rows * columns, np.bool_)
    for cell in cells:
        own[cell // lattice.width // EDGE * columns + cell % lattice.width // EDGE] = True
    for block in np.flatnonzero(own):
        around[block] = True
        if block % columns > 0:
            around[block - 1] = True
        if block >= columns:
            around[block - columns] = True
    return np.flatnonzero(own), np.flatnonzero(around)


@kernel(nogil=True)
def label_blocks(lattice, pool, sheet, step, blocks, listed, begin, end):
    """Find the parts of a sheet in each of the blocks ``listed[begin:end]``."""
    height, part, width = blocks.height, blocks.part, lattice.width
    first, length, sheets, z = pool.first, pool.length, pool.sheet, pool.z
    columns, parent = -(-width // EDGE), np.empty(EDGE * EDGE, np.int64)
    for block in listed[begin:end]:
        row0, col0 = block // columns * EDGE, block % columns * EDGE
        row1, col1 = min(row0 + EDGE, lattice.height), min(col0 + EDGE, width)
        for row in range(row0, row1):
            for col in range(col0, col1):
                cell, n = row * width + col, (row - row0) * EDGE + col - col0
                height[cell], parent[n] = math.nan, n
                for j in range(first[cell], first[cell] + length[cell]):
                    if sheets[j] == sheet:
                        height[cell] = z[j]
                # what is NaN is no step apart
                if col > col0 and abs(height[cell - 1] - height[cell]) <= step + SLACK:
                    unite(parent, n, n - 1)
                if row > row0 and abs(height[cell - width] - height[cell]) <= step + SLACK:
                    unite(parent, n, n - EDGE)
        count = 0
        for row in range(row0, row1):
            for col in range(col0, col1):
                cell, n = row * width + col, (row - row0) * EDGE + col - col0
                part[cell] = -1
                if math.isnan(height[cell]):
                    continue
                root = find_root(parent, n)
                if root == n:
                    part[cell] = count
                    blocks.size[block, count] = 0
                    count += 1
                else:
                    part[cell] = part[(row0 + root // EDGE) * width + col0 + root % EDGE]
                blocks.size[block, part[cell]] += 1
        blocks.num_parts[block] = count


@kernel(nogil=True)
def meet_at_borders(lattice, step, blocks, listed):
    """Find the parts that meet at the eastern and southern borders of some blocks."""
    part, height, width = blocks.part, blocks.height, lattice.width
    columns = -(-width // EDGE)
    for block in listed:
        row0, col0 = block // columns * EDGE, block % columns * EDGE
        row1, col1 = min(row0 + EDGE, lattice.height), min(col0 + EDGE, width)
        for way in range(2):
            count = 0
            inside = col1 < width if way == 0 else row1 < lattice.height
            first = row0 * width + col1 - 1 if way == 0 else (row1 - 1) * width + col0
            along, across = (width, 1) if way == 0 else (1, width)
            for k in range((row1 - row0 if way == 0 else col1 - col0) if inside else 0):
                cell = first + k * along
                other = cell + across
                if not abs(height[cell] - height[other]) <= step + SLACK:
                    continue
                pair = blocks.pairs[block, way]
                is_known = count > 0 and pair[count - 1, 0] == part[cell]
                if not (is_known and pair[count - 1, 1] == part[other]):
                    pair[count, 0], pair[count, 1] = part[cell], part[other]
                    count += 1
            blocks.num_pairs[block, way] = count


@kernel(nogil=True)
def join_parts(lattice, blocks):
    """Find what hangs together of all parts of all blocks.

    Returns the first number of each block's parts among all parts, (blocks + 1,) int64; the whole
    that each part belongs to, (parts,) int64; and how many cells each whole has, int64.
    """
    columns, num = -(-lattice.width // EDGE), blocks.num_parts.shape[0]
    first = np.zeros(num + 1, np.int64)
    for block in range(num):
        first[block + 1] = first[block] + blocks.num_parts[block]
    parent = np.arange(first[num])
    for block in range(num):
        for way in range(2):
            other = block + 1 if way == 0 else block + columns
            for k in range(blocks.num_pairs[block, way]):
                pair = blocks.pairs[block, way, k]
                unite(parent, first[block] + pair[0], first[other] + pair[1])
    whole, size, count = np.empty(first[num], np.int64), np.zeros(first[num], np.int64), 0
    for block in range(num):
        for k in range(blocks.num_parts[block]):
            node = first[block] + k
            root = find_root(parent, node)
            if root == node:
                whole[node] = count
                count += 1
            else:
                whole[node] = whole[root]
            size[whole[node]] += blocks.size[block, k]
    return first, whole, size[:count].copy()


@kernel(nogil=True)
def cells_of_whole(lattice, blocks, first, whole, number):
    """The cells that belong to one whole, block by block."""
    width, columns = lattice.width, -(-lattice.width // EDGE)
    count = 0
    for block in range(blocks.num_parts.shape[0]):
        for k in range(blocks.num_parts[block]):
            count += blocks.size[block, k] if whole[first[block] + k] == number else 0
    cells, at = np.empty(count, np.int64), 0
    for block in range(blocks.num_parts.shape[0]):
        if not (whole[first[block] : first[block + 1]] == number).any():
            continue
        row0, col0 = block // columns * EDGE, block % columns * EDGE
        for row in range(row0, min(row0 + EDGE, lattice.height)):
            for cell in range(row * width + col0, row * width + min(col0 + EDGE, width)):
                part = blocks.part[cell]
                if part >= 0 and whole[first[block] + part] == number:
                    cells[at] = cell
                    at += 1
    return cells
