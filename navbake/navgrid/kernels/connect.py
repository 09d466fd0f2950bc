"""Connected parts of a graph, by union-find."""

import numpy as np
from numba import njit

from navbake.navgrid.kernels.union_find import find_root, unite


@njit(cache=True)
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
