"""Columns that can be replaced one by one: a pool of crossings that only grows.

A cell's column is a run of the pool. A new column is written behind all others, and the cell points
at it from then on (a log-structured store; Rosenblum and Ousterhout, 1992), so that nothing has to
make room in the middle. The pool is written anew when too much of it is garbage.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from navbake.baker.kernels.arrays import Crossings
from navbake.compiled import UNCOUNTED
from navbake.types import Int, Int32

# What a surface is: one that floors may go on at, one that an agent can stand on
FLOOR_LIKE, STANDABLE = 1, 2


class Pool(NamedTuple):
    """The columns of all cells; cell i holds ``[first[i], first[i] + length[i])``.

    Attributes:
        first: (cells,) int64.
        length: (cells,) int32.
        z, normal, geom, closed: as in `Crossings`, with room at the end.
        marks: FLOOR_LIKE and STANDABLE, see `mark_surfaces`, (n,) uint8.
        sheet: the sheet of each surface that an agent can stand on, -1 for the others, (n,) int32.
    """

    first: Int
    length: Int32
    z: NDArray[np.float64]
    normal: NDArray[np.float32]
    geom: Int32
    closed: NDArray[np.uint8]
    marks: NDArray[np.uint8]
    sheet: Int32


@njit(cache=True)
def gather(pool, cells):
    """The columns of some cells, as `Crossings` whose columns are numbered as `cells` are.

    Returns them, and the place of each crossing in the pool, (n,) int64.
    """
    start = np.zeros(cells.shape[0] + 1, np.int64)
    for n in range(cells.shape[0]):
        start[n + 1] = start[n] + pool.length[cells[n]]
    total = start[cells.shape[0]]
    z, normal, geom = np.empty(total), np.empty((total, 3), np.float32), np.empty(total, np.int32)
    closed, place = np.empty(total, np.uint8), np.empty(total, np.int64)
    for n in range(cells.shape[0]):
        begin = pool.first[cells[n]]
        for i in range(start[n], start[n + 1]):
            j = begin + i - start[n]
            z[i], geom[i], closed[i], place[i] = pool.z[j], pool.geom[j], pool.closed[j], j
            for axis in range(3):
                normal[i, axis] = pool.normal[j, axis]
    return Crossings(start, z, normal, geom, closed), place


@njit(cache=True)
def gather_standable(pool, cells):
    """The surfaces of some cells that an agent can stand on.

    Returns where those of each cell begin, (cells + 1,) int64, as `cells` are numbered; and of each
    surface its height [m] and its place in the pool, int64.
    """
    length, first, marks = pool.length, pool.first, pool.marks
    most = 0
    for cell in cells:
        most += length[cell]
    start, z = np.zeros(cells.shape[0] + 1, np.int64), np.empty(most)
    place, at = np.empty(most, np.int64), 0
    for n in range(cells.shape[0]):
        for j in range(first[cells[n]], first[cells[n]] + length[cells[n]]):
            if marks[j] & STANDABLE:
                z[at], place[at] = pool.z[j], j
                at += 1
        start[n + 1] = at
    return start, z[:at].copy(), place[:at].copy()


@njit(cache=True, **UNCOUNTED)
def find_tops(pool, top, up):
    """The height of each cell's highest surface [m], and the z of its normal: see `Overhead`."""
    for cell in range(pool.first.shape[0]):
        if pool.length[cell] > 0:
            last = pool.first[cell] + pool.length[cell] - 1
            top[cell], up[cell] = pool.z[last], pool.normal[last, 2]


@njit(inline="always")
def _are_equal(one, other):
    """Whether two numbers are the same to the last bit; 0.0 and -0.0 aren't."""
    return one == other and (one != 0.0 or math.copysign(1.0, one) == math.copysign(1.0, other))


@njit(cache=True, **UNCOUNTED)
def differs(pool, cells, new, result):
    """Whether the column of each cell differs in any bit from a new one, into (n,) bool."""
    for n in range(cells.shape[0]):
        begin, count = pool.first[cells[n]], pool.length[cells[n]]
        result[n] = count != new.start[n + 1] - new.start[n]
        for k in range(count):
            if result[n]:
                break
            i, j = new.start[n] + k, begin + k
            same = _are_equal(new.z[i], pool.z[j]) and new.geom[i] == pool.geom[j]
            same = same and new.closed[i] == pool.closed[j]
            for axis in range(3):
                same = same and _are_equal(new.normal[i, axis], pool.normal[j, axis])
            result[n] = not same


@njit(cache=True, **UNCOUNTED)
def put(pool, cells, new, marks, used):
    """Write new columns of some cells, numbered as `cells` are, behind the `used` part.

    Their surfaces belong to no sheet yet.
    """
    for n in range(cells.shape[0]):
        begin = used + new.start[n]
        pool.first[cells[n]], pool.length[cells[n]] = begin, new.start[n + 1] - new.start[n]
        for i in range(new.start[n], new.start[n + 1]):
            j = used + i
            pool.z[j], pool.geom[j], pool.closed[j] = new.z[i], new.geom[i], new.closed[i]
            pool.marks[j], pool.sheet[j] = marks[i], -1
            for axis in range(3):
                pool.normal[j, axis] = new.normal[i, axis]


@njit(cache=True, **UNCOUNTED)
def point_at(cells, local_start, start):
    """Let the sparse `start`, (all cells + 1,), hold the columns of some cells, ascending.

    Only the places of these cells and the one behind each mean anything.
    """
    for n in range(cells.shape[0]):
        start[cells[n]] = local_start[n]
        start[cells[n] + 1] = local_start[n + 1]


@njit(cache=True)
def take_columns(columns, cells, some):
    """The columns of some of the cells; both ascending, and all of the former are among them."""
    start, number, n = np.zeros(some.shape[0] + 1, np.int64), np.empty(some.shape[0], np.int64), 0
    for k in range(some.shape[0]):
        while cells[n] < some[k]:
            n += 1
        number[k] = n
        start[k + 1] = start[k] + columns.start[n + 1] - columns.start[n]
    total = start[some.shape[0]]
    z, normal, geom = np.empty(total), np.empty((total, 3), np.float32), np.empty(total, np.int32)
    closed = np.empty(total, np.uint8)
    for k in range(some.shape[0]):
        j = columns.start[number[k]]
        for i in range(start[k], start[k + 1]):
            z[i], geom[i], closed[i] = columns.z[j], columns.geom[j], columns.closed[j]
            for axis in range(3):
                normal[i, axis] = columns.normal[j, axis]
            j += 1
    return Crossings(start, z, normal, geom, closed)


@njit(cache=True)
def gather_replaced(pool, cells, some, new):
    """The columns of some cells, of which some are replaced by new ones; all ascending."""
    start, k = np.zeros(cells.shape[0] + 1, np.int64), 0
    for n in range(cells.shape[0]):
        count = np.int64(pool.length[cells[n]])
        if k < some.shape[0] and some[k] == cells[n]:
            count = new.start[k + 1] - new.start[k]
            k += 1
        start[n + 1] = start[n] + count
    total = start[cells.shape[0]]
    z, normal, geom = np.empty(total), np.empty((total, 3), np.float32), np.empty(total, np.int32)
    closed, k = np.empty(total, np.uint8), 0
    for n in range(cells.shape[0]):
        if k < some.shape[0] and some[k] == cells[n]:
            j = new.start[k]
            k += 1
            for i in range(start[n], start[n + 1]):
                z[i], geom[i], closed[i] = new.z[j], new.geom[j], new.closed[j]
                for axis in range(3):
                    normal[i, axis] = new.normal[j, axis]
                j += 1
        else:
            j = pool.first[cells[n]]
            for i in range(start[n], start[n + 1]):
                z[i], geom[i], closed[i] = pool.z[j], pool.geom[j], pool.closed[j]
                for axis in range(3):
                    normal[i, axis] = pool.normal[j, axis]
                j += 1
    return Crossings(start, z, normal, geom, closed)


@njit(cache=True)
def replace_columns(old, numbers, new):
    """Columns of which some, by their numbers, ascending, are replaced by new ones."""
    num = old.start.shape[0] - 1
    start, k = np.zeros(num + 1, np.int64), 0
    for n in range(num):
        count = old.start[n + 1] - old.start[n]
        if k < numbers.shape[0] and numbers[k] == n:
            count = new.start[k + 1] - new.start[k]
            k += 1
        start[n + 1] = start[n] + count
    total = start[num]
    z, normal, geom = np.empty(total), np.empty((total, 3), np.float32), np.empty(total, np.int32)
    columns = Crossings(start, z, normal, geom, np.empty(total, np.uint8))
    _copy_replaced(old, numbers, new, columns)
    return columns


@njit(inline="always")
def _copy_column(source, j, into, first, last):
    """Copy crossings, from the j-th on, to ``[first, last)`` of others."""
    for i in range(first, last):
        into.z[i], into.geom[i], into.closed[i] = source.z[j], source.geom[j], source.closed[j]
        for axis in range(3):
            into.normal[i, axis] = source.normal[j, axis]
        j += 1


@njit(cache=True, **UNCOUNTED)
def _copy_replaced(old, numbers, new, into):
    """Write the columns of `replace_columns`, whose `start` is known."""
    start, k = into.start, 0
    for n in range(start.shape[0] - 1):
        if k < numbers.shape[0] and numbers[k] == n:
            _copy_column(new, new.start[k], into, start[n], start[n + 1])
            k += 1
        else:
            _copy_column(old, old.start[n], into, start[n], start[n + 1])
