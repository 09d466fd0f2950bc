"""Columns that can be replaced one by one: a pool of crossings that only grows.

A cell's column is a run of the pool. A new column goes where the last one was if there is room for
it. Else it is written behind all others, and the cell points at it from then on (a log-structured
store; Rosenblum and Ousterhout, 1992), so that nothing has to make room in the middle. The pool is
written anew when it is full.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.compiled import UNCOUNTED, kernel, part
from navbake.types import Int, Int32


class Pool(NamedTuple):
    """The columns of all cells; cell i holds ``[first[i], first[i] + length[i])``.

    Attributes:
        first: (cells,) int64.
        length: (cells,) int32.
        room: how long each column may become where it is, (cells,) int32.
        z, normal, geom, closed: as in `Crossings`, with room at the end.
    """

    first: Int
    length: Int32
    room: Int32
    z: NDArray[np.float64]
    normal: NDArray[np.float32]
    geom: Int32
    closed: NDArray[np.uint8]


@kernel(nogil=True, **UNCOUNTED)
def copy_columns(source, at, columns, begin, end):
    """Copy columns ``[begin, end)`` of those whose lengths are known from where a source has them.

    Args:
        source: a pool, or `Crossings`.
        at: where in the source each column begins, (n,) int64; -1 for those that it has not.
        columns: `Crossings` with their `start`; receive the others.
    """
    start, z, normal, geom, closed = columns
    for n in range(begin, end):
        j = at[n]
        if j < 0:
            continue
        for i in range(start[n], start[n + 1]):
            z[i], geom[i], closed[i] = source.z[j], source.geom[j], source.closed[j]
            for axis in range(3):
                normal[i, axis] = source.normal[j, axis]
            j += 1


@part(inline="always")
def _are_equal(one, other):
    """Whether two numbers are the same to the last bit; 0.0 and -0.0 aren't."""
    return one == other and (one != 0.0 or math.copysign(1.0, one) == math.copysign(1.0, other))


@kernel(nogil=True, **UNCOUNTED)
def differs(pool, cells, new, result, first, end):
    """Whether the columns of ``cells[first:end]`` differ in any bit from new ones, (n,) bool."""
    for n in range(first, end):
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


@kernel(nogil=True, **UNCOUNTED)
def put(pool, cells, new, used):
    """Write new columns of some cells, numbered as `cells` are; those too long behind `used`.

    Returns how much of the pool is used now.
    """
    first, length, room = pool.first, pool.length, pool.room
    for n in range(cells.shape[0]):
        cell, count = cells[n], new.start[n + 1] - new.start[n]
        if count > room[cell]:
            first[cell], room[cell] = used, count
            used += count
        length[cell], j = count, first[cell]
        for i in range(new.start[n], new.start[n + 1]):
            pool.z[j], pool.geom[j], pool.closed[j] = new.z[i], new.geom[i], new.closed[i]
            for axis in range(3):
                pool.normal[j, axis] = new.normal[i, axis]
            j += 1
    return used


@kernel(nogil=True, **UNCOUNTED)
def point_at(cells, local_start, start):
    """Let the sparse `start`, (all cells + 1,), hold the columns of some cells, ascending.

    Only the places of these cells and the one behind each mean anything.
    """
    for n in range(cells.shape[0]):
        start[cells[n]] = local_start[n]
        start[cells[n] + 1] = local_start[n + 1]
