"""Connected parts of graphs, by union-find.

Disjoint sets as a forest of parents (Galler and Fischer, 1964) with path halving (Tarjan and van
Leeuwen, 1984). Of two roots the lower item becomes the parent, so a root is the first member of
its set, whatever the order of the unions. Path halving alone keeps the trees shallow enough.
"""

import numpy as np

from navbake.compiled import UNCOUNTED, kernel, part


@part(**UNCOUNTED)
def find_root(parent, item):
    """The root of an item's set, its lowest member, which is its own parent."""
    while parent[item] != item:
        parent[item] = parent[parent[item]]
        item = parent[item]
    return item


@part(**UNCOUNTED)
def unite(parent, one, other):
    """Join the sets of two items."""
    one, other = find_root(parent, one), find_root(parent, other)
    if one != other:
        parent[max(one, other)] = min(one, other)


@kernel
def number_parts(pairs, count):
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
