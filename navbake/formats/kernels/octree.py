"""The nodes of OctoMap's files, depth first: from states of voxels, and as leaves and voxels.

The walks have a stack of their own, of (level, x, y, z): level 16 is the root, 0 a voxel. Child
number x + 2 y + 4 z, child 0 first.

Source: OctoMap 1.9, `OccupancyOcTreeBase::readBinaryNode`, `OcTreeBaseImpl::readNodesRecurs`, and
what writes for them.
"""

import numpy as np

from navbake.compiled import kernel

DEPTH = 16
UNKNOWN, FREE, OCCUPIED, INNER = 0, 1, 2, 3  # of a child, as a ``.bt`` has them
OVERRUN, TOO_DEEP = -1, -2
# states of nodes, as bits: what eight children are together is their bitwise or. MIXED nodes have
# children that differ, MIXED_FREE ones none that is occupied
IS_UNKNOWN, IS_FREE, IS_OCCUPIED, MIXED_FREE, MIXED = 1, 2, 4, 8, 16


@kernel
def pack_nodes(states, shape, first, odds, nodes):
    """Write the nodes of a ``.bt``, or of an ``.ot``, which has `odds`.

    Args:
        states: of the nodes over a grid, level by level from the voxels to the root, uint8.
        shape: of each level, (17, 3).
        first: key of each level's first node, (17, 3).
        odds: uint8, the log-odds of what is free and occupied, (2, 4); (0, 4) for a ``.bt``.
        nodes: uint8, receives the nodes: in a ``.bt``, 2 bits for each child of a node with
            children; in an ``.ot``, for each node the log-odds and a bit for each child.

    Returns:
        The number of bytes, and of all nodes.
    """
    has_odds = odds.shape[0] > 0
    start = np.zeros(DEPTH + 1, np.int64)
    for level in range(DEPTH):
        start[level + 1] = start[level] + shape[level, 0] * shape[level, 1] * shape[level, 2]
    stack = np.zeros((8 * (DEPTH + 1), 4), np.int64)
    stack[0, 0], depth, place, num_nodes = DEPTH, 1, 0, 1
    while depth > 0:
        depth -= 1
        level, x, y, z = stack[depth]
        state = states[start[level] + (x * shape[level, 1] + y) * shape[level, 2] + z]
        below, bits = level - 1, 0
        for child in range(7, -1, -1) if state >= MIXED_FREE else range(0):
            cx = 2 * (x + first[level, 0]) + (child & 1) - first[below, 0]
            cy = 2 * (y + first[level, 1]) + (child >> 1 & 1) - first[below, 1]
            cz = 2 * (z + first[level, 2]) + (child >> 2) - first[below, 2]
            if not (0 <= cx < shape[below, 0] and 0 <= cy < shape[below, 1]):
                continue
            if not 0 <= cz < shape[below, 2]:
                continue
            own = states[start[below] + (cx * shape[below, 1] + cy) * shape[below, 2] + cz]
            if own == IS_UNKNOWN:
                continue
            num_nodes += 1
            two_bits = FREE if own == IS_FREE else OCCUPIED if own == IS_OCCUPIED else INNER
            bits |= 1 << child if has_odds else two_bits << 2 * child
            if has_odds or own >= MIXED_FREE:
                stack[depth, 0], stack[depth, 1], stack[depth, 2] = below, cx, cy
                stack[depth, 3] = cz
                depth += 1
        if has_odds:  # a node has the greatest log-odds of its children
            nodes[place : place + 4] = odds[1 if state & (IS_OCCUPIED | MIXED) else 0]
            nodes[place + 4] = bits
            place += 5
        else:
            nodes[place], nodes[place + 1] = bits & 255, bits >> 8
            place += 2
    return place, num_nodes


@kernel
def read_leaves(data, odds, has_odds, leaves):
    """Read the nodes of a ``.bt``, or of an ``.ot``, which `has_odds`.

    Args:
        data: uint8. In a ``.bt``, 2 bits for each child of a node with children; in an ``.ot``,
            4 bytes of log-odds and one of which children there are, for each node.
        odds: float32, the log-odds of each node of an ``.ot``: 0 and more are occupied.
        leaves: (n, 5) int32, receives each leaf's first key x, y, z, its level, and 1 if it is
            occupied; empty to count them only.

    Returns:
        The number of leaves, of bytes, and of all nodes; the first is OVERRUN or TOO_DEEP where
        the data are wrong.
    """
    fills = leaves.shape[0] > 0
    # an array, because numba's lists take twice as long; 8 children wait at each level at most
    stack = np.zeros((8 * (DEPTH + 1), 4), np.int64)
    stack[0, 0], depth = DEPTH, 1
    place, num_leaves, num_nodes = 0, 0, 0 if has_odds else 1
    while depth > 0:
        depth -= 1
        level, x, y, z = stack[depth]
        if place + (5 if has_odds else 2) > data.shape[0]:
            return OVERRUN, place, num_nodes
        if has_odds:
            bits = np.int64(data[place + 4])
            place += 5
            num_nodes += 1
            if bits == 0:
                if fills:
                    leaves[num_leaves, 0], leaves[num_leaves, 1] = x << level, y << level
                    leaves[num_leaves, 2], leaves[num_leaves, 3] = z << level, level
                    leaves[num_leaves, 4] = odds[num_nodes - 1] >= 0.0
                num_leaves += 1
                continue
        else:
            bits = np.int64(data[place]) | (np.int64(data[place + 1]) << 8)
            place += 2
        for child in range(7, -1, -1):
            state = INNER * (bits >> child & 1) if has_odds else bits >> (2 * child) & 3
            if state == UNKNOWN:
                continue
            num_nodes += not has_odds
            cx, cy, cz = 2 * x + (child & 1), 2 * y + (child >> 1 & 1), 2 * z + (child >> 2)
            if state == INNER:
                if level == (0 if has_odds else 1):
                    return TOO_DEEP, place, num_nodes
                stack[depth, 0], stack[depth, 1] = level - 1, cx
                stack[depth, 2], stack[depth, 3] = cy, cz
                depth += 1
                continue
            if fills:
                size = level - 1
                leaves[num_leaves, 0], leaves[num_leaves, 1] = cx << size, cy << size
                leaves[num_leaves, 2], leaves[num_leaves, 3] = cz << size, size
                leaves[num_leaves, 4] = state == OCCUPIED
            num_leaves += 1
    return num_leaves, place, num_nodes


@kernel
def fill_leaves(leaves, first, values, known):
    """Write leaves into voxels, occupied or not, and known; `first` is the first voxel's key."""
    num_x, num_y, num_z = values.shape
    for n in range(leaves.shape[0]):
        size = 1 << leaves[n, 3]
        x, y, z = leaves[n, 0] - first[0], leaves[n, 1] - first[1], leaves[n, 2] - first[2]
        for i in range(max(x, 0), min(x + size, num_x)):
            for j in range(max(y, 0), min(y + size, num_y)):
                for k in range(max(z, 0), min(z + size, num_z)):
                    known[i, j, k] = True
                    values[i, j, k] = leaves[n, 4] != 0
