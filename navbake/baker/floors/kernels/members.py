"""The surfaces of chosen sheets: which they are, how they end, and what is left of a shrunk sheet.

An edge is one of a cell's four sides beyond which the cell has no neighbour of its own sheet
(contour following cell by cell, as in Recast's region contours).
"""

import math
from typing import Any, NamedTuple

import numpy as np

from navbake.baker.kernels.blocks import block_of, block_window
from navbake.baker.kernels.constants import SLACK
from navbake.compiled import UNCOUNTED, kernel, part
from navbake.types import Float, Int, Int32


class Labelled(NamedTuple):
    """Surfaces and the sheets that they belong to.

    Attributes:
        lattice: the cells.
        first, length, z, geom: see `Surfaces`.
        part: the number of each surface's part in its block, -1 for none.
        offset: the number of each block's first part, int64.
        sheet: the sheet of each part, -1 for those that are not asked for, int32.
    """

    lattice: Any
    first: Int
    length: Int32
    z: Float
    geom: Int32
    part: Int32
    offset: Int
    sheet: Int32


class Shrinking(NamedTuple):
    """How a set of cells is shrunk.

    Attributes:
        reach: how far the steps of `disc` lead [cells].
        disc, rim: see `near_offsets` and `east_rim`.
    """

    reach: int
    disc: Int
    rim: Int


@part(inline="always")
def sheet_of(labelled, block, j):
    """The sheet of a surface in a block, -1 for none that is asked for."""
    part = labelled.part[j]
    return labelled.sheet[labelled.offset[block] + part] if part >= 0 else np.int32(-1)


@part(inline="always")
def _holds(labelled, row, col, sheet):
    """Whether a cell has a surface of a sheet."""
    lattice = labelled.lattice
    cell, block = row * lattice.width + col, block_of(lattice, row, col)
    for j in range(labelled.first[cell], labelled.first[cell] + labelled.length[cell]):
        if sheet_of(labelled, block, j) == sheet:
            return True
    return False


@part(**UNCOUNTED)
def _collect(labelled, window, cells, z, geom, place):
    """See `collect_members`; counts alone where there is no room."""
    row0, col0, row1, col1 = window
    lattice, count = labelled.lattice, 0
    for row in range(row0, row1):
        for col in range(col0, col1):
            cell, block = row * lattice.width + col, block_of(lattice, row, col)
            for j in range(labelled.first[cell], labelled.first[cell] + labelled.length[cell]):
                if sheet_of(labelled, block, j) < 0:
                    continue
                if count < cells.shape[0]:
                    cells[count], z[count] = cell, labelled.z[j]
                    geom[count], place[count] = labelled.geom[j], j
                count += 1
    return count


@kernel(nogil=True)
def collect_members(labelled, window):
    """The surfaces of sheets in a window of rows and columns, cell by cell.

    Returns cell, height, geom and place of each.
    """
    cells, z, place = np.empty(0, np.int64), np.empty(0), np.empty(0, np.int64)
    geom = np.empty(0, np.int32)
    count = _collect(labelled, window, cells, z, geom, place)
    cells, z, place = np.empty(count, np.int64), np.empty(count), np.empty(count, np.int64)
    geom = np.empty(count, np.int32)
    _collect(labelled, window, cells, z, geom, place)
    return cells, z, geom, place


@kernel(nogil=True, **UNCOUNTED)
def mark_members(labelled, window, margin, mask):
    """Mark the cells of sheets in a window, in a mask with a margin around it."""
    row0, col0, row1, col1 = window
    lattice = labelled.lattice
    for row in range(row0, row1):
        for col in range(col0, col1):
            cell, block = row * lattice.width + col, block_of(lattice, row, col)
            for j in range(labelled.first[cell], labelled.first[cell] + labelled.length[cell]):
                if sheet_of(labelled, block, j) >= 0:
                    mask[row - row0 + margin, col - col0 + margin] = True


@part(inline="always")
def sum_left(mask, reach, disc, rim, needed):
    """How many cells of a mask, without a margin, are left when it is shrunk; or enough of them."""
    found = 0
    for row in range(reach, mask.shape[0] - reach):
        follows = False
        for col in range(reach, mask.shape[1] - reach):
            follows = mask[row, col] and is_left(mask, row, col, rim if follows else disc)
            found += 1 if follows else 0
        if found >= needed:
            break
    return found


@part(inline="always")
def is_left(mask, row, col, offsets):
    """Whether all cells at some steps from one belong to a mask."""
    for k in range(offsets.shape[0]):  # noqa: SIM110 (numba has no generators in `all`)
        if not mask[row + offsets[k, 0], col + offsets[k, 1]]:
            return False
    return True


@part(**UNCOUNTED)
def _count_left(labelled, sheet, window, shrinking, needed, mask):
    """See `count_left`; of a window of rows and columns. `mask` is all False."""
    row0, row1, col0, col1 = window
    lattice, reach = labelled.lattice, shrinking.reach
    for row in range(max(row0 - reach, 0), min(row1 + reach, lattice.height)):
        for col in range(max(col0 - reach, 0), min(col1 + reach, lattice.width)):
            if _holds(labelled, row, col, sheet):
                mask[row - row0 + reach, col - col0 + reach] = True
    return sum_left(mask, reach, shrinking.disc, shrinking.rim, needed)


@kernel(nogil=True)
def count_left(labelled, boxes, sheets, start, blocks, shrinking, needed, result, begin, end):
    """Tell which of ``sheets[begin:end]`` keep enough cells when they are shrunk.

    Args:
        boxes: rows and columns of every sheet.
        start, blocks: of each sheet of the list, the blocks that hold it.
        shrinking: how sheets are shrunk.
        needed: so many cells are enough.
        result: receives the answers, by sheet.
    """
    reach = shrinking.reach
    for n in range(begin, end):
        sheet, found = sheets[n], 0
        for b in range(start[n], start[n + 1]):
            if found >= needed:
                break
            row0, row1, col0, col1 = block_window(labelled.lattice, blocks[b])
            row0, row1 = max(row0, boxes[sheet, 0]), min(row1, boxes[sheet, 2])
            col0, col1 = max(col0, boxes[sheet, 1]), min(col1, boxes[sheet, 3])
            if row1 > row0 and col1 > col0:
                mask = np.zeros((row1 - row0 + 2 * reach, col1 - col0 + 2 * reach), np.bool_)
                window = row0, row1, col0, col1
                found += _count_left(labelled, sheet, window, shrinking, needed - found, mask)
        result[sheet] = found >= needed


@part(inline="always")
def _next(lattice, row, col, way):
    """The next cell east (0), south (1), west (2) or north (3); a row less than 0 for none."""
    row += 1 if way == 1 else (-1 if way == 3 else 0)
    col += 1 if way == 0 else (-1 if way == 2 else 0)
    if row >= lattice.height or col < 0 or col >= lattice.width:
        row = -1
    return row, col


@part(inline="always")
def _look_out(labelled, row, col, way, sheet, limit, cells, floors, landing):
    """Look out from an edge: see `list_edges`; whether there is any floor."""
    lattice, has_floor = labelled.lattice, False
    for k in range(cells.shape[0]):
        cells[k], floors[k], landing[k] = -1, math.nan, -1
        if row >= 0:
            row, col = _next(lattice, row, col, way)
        if row < 0 or _holds(labelled, row, col, sheet):
            row = -1
            continue
        cell, block = row * lattice.width + col, block_of(lattice, row, col)
        cells[k] = cell
        for j in range(labelled.first[cell], labelled.first[cell] + labelled.length[cell]):
            other = sheet_of(labelled, block, j)
            if other >= 0 and labelled.z[j] < limit:
                floors[k], landing[k] = labelled.z[j], other
                has_floor = True
    return has_floor


@part(**UNCOUNTED)
def _count_edges(labelled, step, block, before, edges, drops, cells, floors, landing):
    """See `count_edges`; of one block."""
    lattice = labelled.lattice
    row0, row1, col0, col1 = block_window(lattice, block)
    for row in range(row0, row1):
        for col in range(col0, col1):
            cell = row * lattice.width + col
            for j in range(labelled.first[cell], labelled.first[cell] + labelled.length[cell]):
                sheet = sheet_of(labelled, block, j)
                if sheet < 0:
                    continue
                n, limit = before + labelled.part[j], labelled.z[j] - step - SLACK
                for way in range(4):
                    r, c = _next(lattice, row, col, way)
                    if r >= 0 and _holds(labelled, r, c, sheet):
                        continue
                    edges[n] += 1
                    if _look_out(labelled, row, col, way, sheet, limit, cells, floors, landing):
                        drops[n] += 1


@kernel(nogil=True)
def count_edges(labelled, step, reach, blocks, offset, edges, drops, begin, end):
    """Count the edges of parts in ``blocks[begin:end]``, and those before which a floor lies.

    Block k's parts begin at ``offset[k]`` in the results, int64; see `list_edges`.
    """
    cells, floors = np.empty(reach, np.int64), np.empty(reach)
    landing = np.empty(reach, np.int32)
    for k in range(begin, end):
        _count_edges(labelled, step, blocks[k], offset[k], edges, drops, cells, floors, landing)


class EdgeRoom(NamedTuple):
    """Room for edges: see `list_edges`."""

    sheet: Int32
    cell: Int
    z: Float
    way: Int
    cells: Int
    floors: Float
    landing: Int32


@part
def _make_room(count, reach):
    shape = count, reach
    return EdgeRoom(
        np.empty(count, np.int32), np.empty(count, np.int64), np.empty(count),
        np.empty(count, np.int64), np.empty(shape, np.int64), np.empty(shape),
        np.empty(shape, np.int32),
    )  # fmt: skip


@part(**UNCOUNTED)
def _list_edges(labelled, chosen, step, block, num, room):
    """See `list_edges`; of one block. Counts alone where there is no room."""
    lattice = labelled.lattice
    row0, row1, col0, col1 = block_window(lattice, block)
    for row in range(row0, row1):
        for col in range(col0, col1):
            cell = row * lattice.width + col
            for j in range(labelled.first[cell], labelled.first[cell] + labelled.length[cell]):
                sheet = sheet_of(labelled, block, j)
                if sheet < 0 or not chosen[sheet]:
                    continue
                limit = labelled.z[j] - step - SLACK
                for way in range(4):
                    r, c = _next(lattice, row, col, way)
                    if r >= 0 and _holds(labelled, r, c, sheet):
                        continue
                    if num < room.sheet.shape[0]:
                        room.sheet[num], room.cell[num] = sheet, cell
                        room.z[num], room.way[num] = labelled.z[j], way
                        _look_out(labelled, row, col, way, sheet, limit,
                                  room.cells[num], room.floors[num], room.landing[num])  # fmt: skip
                    num += 1
    return num


@kernel(nogil=True)
def list_edges(labelled, chosen, step, reach, blocks, begin, end):
    """List the edges of chosen sheets in ``blocks[begin:end]``, and what lies beyond them.

    Args:
        labelled: the surfaces that count.
        chosen: which sheets are asked for, bool.
        step: [m].
        reach: how many cells one looks out.

    Returns:
        How many edges each block has; the sheet, cell and height of each; the way out: east (0),
        south (1), west (2), north (3); the cells beyond, the nearest first, -1 from where the
        lattice ends, or the sheet begins again, (edges, reach) int64; the highest floor of another
        sheet that lies more than a step below the edge in each of these, NaN for none [m], and its
        sheet, -1 for none.
    """
    counts, room, num = np.zeros(end - begin, np.int64), _make_room(0, reach), 0
    for k in range(begin, end):
        before = num
        num = _list_edges(labelled, chosen, step, blocks[k], num, room)
        counts[k - begin] = num - before
    room, num = _make_room(num, reach), 0
    for k in range(begin, end):
        num = _list_edges(labelled, chosen, step, blocks[k], num, room)
    return (
        counts, room.sheet, room.cell, room.z, room.way, room.cells, room.floors, room.landing
    )  # fmt: skip


@kernel(nogil=True)
def look_below(labelled, cells, places):
    """The next labelled surface below some surfaces in their cells: its height [m], and its sheet.

    NaN and -1 where there is none.
    """
    z, sheet = np.full(cells.shape[0], math.nan), np.full(cells.shape[0], np.int32(-1))
    width = labelled.lattice.width
    for n in range(cells.shape[0]):
        block = block_of(labelled.lattice, cells[n] // width, cells[n] % width)
        for j in range(places[n] - 1, labelled.first[cells[n]] - 1, -1):
            other = sheet_of(labelled, block, j)
            if other >= 0:
                z[n], sheet[n] = labelled.z[j], other
                break
    return z, sheet


@kernel(nogil=True, **UNCOUNTED)
def mark_between(labelled, low, high, found):
    """Mark the sheets that have a surface from a height up to below another one [m]."""
    width = labelled.lattice.width
    for cell in range(labelled.first.shape[0]):
        block = block_of(labelled.lattice, cell // width, cell % width)
        for j in range(labelled.first[cell], labelled.first[cell] + labelled.length[cell]):
            if low <= labelled.z[j] < high:
                sheet = sheet_of(labelled, block, j)
                if sheet >= 0:
                    found[sheet] = True


@kernel(nogil=True, **UNCOUNTED)
def find_nearest(row, col, middle_row, middle_col):
    """Which of some cells is the nearest to a place, the first of several."""
    best, nearest = math.inf, 0
    for n in range(row.shape[0]):
        away = math.hypot(row[n] - middle_row, col[n] - middle_col)
        if away < best:
            best, nearest = away, n
    return nearest
