"""Numbers of connected parts of graphs, by union-find, and of equal lists, by a hash table.

Disjoint sets as a forest of parents (Galler and Fischer, 1964) with path halving (Tarjan and van
Leeuwen, 1984). Of two roots the lower item becomes the parent, so a root is the first member of
its set, whatever the order of the unions. Path halving alone keeps the trees shallow enough.

The table is one with open addressing, and the hash FNV-1a (Fowler, Noll and Vo) over the values,
with a shift that mixes the high bits down; lists with equal hashes are compared.
"""

import numpy as np

from navbake.compiled import NO_REFCOUNT, kernel, subkernel


@subkernel(**NO_REFCOUNT)
def find_root(parent, item):
    """The root of an item's set, its lowest member, which is its own parent."""
    while parent[item] != item:
        parent[item] = parent[parent[item]]
        item = parent[item]
    return item


@subkernel(**NO_REFCOUNT)
def unite(parent, one, other):
    """Join the sets of two items."""
    one = find_root(parent, one)
    other = find_root(parent, other)
    if one != other:
        parent[max(one, other)] = min(one, other)


@kernel
def number_components(pairs, count):
    """The connected part of each of `count` nodes, by first nodes from 0, int32.

    `pairs` are the edges, (2, n) int64.
    """
    parent = np.arange(count)
    for k in range(pairs.shape[1]):
        unite(parent, pairs[0, k], pairs[1, k])
    part = np.empty(count, dtype=np.int32)
    parts = 0
    for node in range(count):
        root = find_root(parent, node)
        if root == node:
            part[node] = parts
            parts += 1
        else:
            part[node] = part[root]
    return part


@kernel
def number_distinct_lists(start, value, number):
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


@subkernel(inline="always")
def _are_equal(start, value, a, b):
    if start[a + 1] - start[a] != start[b + 1] - start[b]:
        return False
    k = 0
    num = start[a + 1] - start[a]
    while k < num and value[start[a] + k] == value[start[b] + k]:
        k += 1
    return k == num
