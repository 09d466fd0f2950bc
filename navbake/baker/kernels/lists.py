"""Which ragged lists are equal, by a hash table with open addressing.

The hash is FNV-1a (Fowler, Noll and Vo) over the values, with a shift that mixes the high bits
down; lists with equal hashes are compared.
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
