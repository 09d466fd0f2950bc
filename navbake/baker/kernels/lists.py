"""Ragged lists: which of them are equal; a hash table with open addressing.

Lists are hashed like FNV-1a (Fowler, Noll and Vo) over their values, with a shift that mixes the
high bits down. Equal hashes are no proof, so lists are compared.
"""

import numpy as np

from navbake.compiled import kernel, part


@kernel
def number_lists(start, value, number):
    """Number ragged lists so that equal ones share a number, by first appearance.

    List i is ``value[start[i] : start[i + 1]]``, of integers >= 0; `number` receives the numbers.
    Returns the first list of each number, int64.
    """
    num = start.shape[0] - 1
    size = 16
    while size < 2 * num:  # at most half full, so that probing stays short
        size *= 2
    table = np.full(size, -1, np.int64)
    first = np.empty(num, np.int64)
    count = 0
    for i in range(num):
        key = np.uint64(1469598103934665603)
        for j in range(start[i], start[i + 1]):
            key = (key ^ np.uint64(value[j])) * np.uint64(1099511628211)
            key ^= key >> np.uint64(29)
        place = np.int64(key & np.uint64(size - 1))
        while table[place] >= 0 and not _are_equal(start, value, first[table[place]], i):
            place = (place + 1) & (size - 1)
        if table[place] < 0:
            table[place] = count
            first[count] = i
            count += 1
        number[i] = table[place]
    return first[:count].copy()


@part(inline="always")
def _are_equal(start, value, a, b):
    if start[a + 1] - start[a] != start[b + 1] - start[b]:
        return False
    k, num = 0, start[a + 1] - start[a]
    while k < num and value[start[a] + k] == value[start[b] + k]:
        k += 1
    return k == num


@kernel(nogil=True)
def count_heights(floor, occupied):
    """The different heights of free cells, and how many cells have each; in any order.

    `floor`, (rows, columns) float64, is NaN where there is none.
    """
    size, count = 64, 0
    table = np.full(size, -1, np.int64)
    height, number = np.empty(size), np.zeros(size, np.int64)
    last = np.int64(-1)
    for row in range(floor.shape[0]):
        for col in range(floor.shape[1]):
            z = floor[row, col]
            if occupied[row, col] or np.isnan(z):
                continue
            if last < 0 or height[last] != z:
                if 2 * count >= size:  # at most half full, so that probing stays short
                    size *= 2
                    table = np.full(size, -1, np.int64)
                    height, number = np.concatenate((height, height)), _widen(number)
                    for k in range(count):
                        table[_place(table, height, height[k])] = k
                place = _place(table, height, z)
                if table[place] < 0:
                    table[place], height[count] = count, z
                    count += 1
                last = table[place]
            number[last] += 1
    return height[:count].copy(), number[:count].copy()


@part
def _widen(number):
    wide = np.zeros(2 * number.shape[0], np.int64)
    wide[: number.shape[0]] = number
    return wide


@part(inline="always")
def _place(table, height, z):
    """Where a height is in a hash table, or where it belongs."""
    size = table.shape[0]
    key = np.uint64(np.int64(z * 1e7)) * np.uint64(0x9E3779B97F4A7C15)
    place = np.int64((key >> np.uint64(40)) & np.uint64(size - 1))
    while table[place] >= 0 and height[table[place]] != z:
        place = (place + 1) & (size - 1)
    return place
