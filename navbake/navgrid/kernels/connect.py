"""Connected parts of graphs, and pairs of cells that touch, by union-find.

Disjoint sets as a forest of parents (Galler and Fischer, 1964) with path halving (Tarjan and van
Leeuwen, 1984). Of two roots the lower item becomes the parent, not that of the larger tree: so a
root is the first member of its set, whatever the order in which sets were joined, and numbers
that follow the roots depend on nothing else. Path halving alone keeps the trees shallow enough.
"""

import numpy as np

from navbake.compiled import UNCOUNTED, kernel, part


@part(**UNCOUNTED)
def find_root(parent, item):
    """The root of an item's set, its lowest member; of roots, `parent` has themselves."""
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
    """Number the connected parts of a graph from 0, by their first nodes.

    Pairs of nodes that hang together are (2, n) int64. Returns the part of each of `count` nodes,
    int32.
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
