"""Octrees of depth 16 out of dense voxels, and back.

Built bottom up: a pyramid holds the state of every node over the grid, level by level, 0 the
voxels, 16 the root. Arrays of a level begin at its own first node, ``first key >> level``. Trees
are written and read depth first, in OctoMap's order (child 0 first; child number x + 2 y + 4 z),
with a stack of our own, of (level, x, y, z).

Source: OctoMap 1.9, `OcTreeBaseImpl::pruneRecurs`, `OccupancyOcTreeBase::writeBinaryNode`.
"""

import numpy as np

from navbake.compiled import kernel, part

DEPTH = 16
UNKNOWN, FREE, OCCUPIED, MIXED_FREE, MIXED = 0, 1, 2, 3, 4  # the mixed ones have children
OVERRUN, TOO_DEEP = -1, -2


@kernel(nogil=True)
def join_states(below, first, above, row, end):
    """Find the states of a level's nodes from those below, whose first node is `first`.

    Fills ``above[row:end]``.
    """
    nx, ny, nz = below.shape
    for i in range(row, end):
        for j in range(above.shape[1]):
            for k in range(above.shape[2]):
                # the first child's index below, which is -1 where a node begins before the grid
                x = 2 * (first[0] // 2 + i) - first[0]
                y = 2 * (first[1] // 2 + j) - first[1]
                z = 2 * (first[2] // 2 + k) - first[2]
                one, is_occupied, same = 0, False, True
                for child in range(8):
                    cx, cy, cz = x + (child & 1), y + (child >> 1 & 1), z + (child >> 2)
                    state = 0
                    if 0 <= cx < nx and 0 <= cy < ny and 0 <= cz < nz:
                        state = int(below[cx, cy, cz])
                    if child == 0:
                        one = state
                    same = same and state == one and state < MIXED_FREE
                    is_occupied |= state in (OCCUPIED, MIXED)
                # eight equal leaves are pruned: their parent is a leaf of that state
                if same:
                    above[i, j, k] = one
                else:
                    above[i, j, k] = MIXED if is_occupied else MIXED_FREE


@part
def _state(levels, first, level, x, y, z):
    nodes = levels[level]
    i, j, k = x - (first[0] >> level), y - (first[1] >> level), z - (first[2] >> level)
    if 0 <= i < nodes.shape[0] and 0 <= j < nodes.shape[1] and 0 <= k < nodes.shape[2]:
        return int(nodes[i, j, k])
    return UNKNOWN


@part
def _child(x, y, z, child):
    return 2 * x + (child & 1), 2 * y + (child >> 1 & 1), 2 * z + (child >> 2)


@part
def _new_stack():
    # an array, because numba's lists take twice as long; 8 children wait at each level at most
    stack = np.empty((8 * (DEPTH + 1), 4), np.int64)
    return stack, _push(stack, 0, DEPTH, 0, 0, 0)


@part
def _push(stack, depth, level, x, y, z):
    stack[depth, 0], stack[depth, 1], stack[depth, 2], stack[depth, 3] = level, x, y, z
    return depth + 1


@part
def _put_leaf(leaves, num, level, x, y, z, state):
    if leaves.shape[0] > 0:
        leaves[num, 0], leaves[num, 1], leaves[num, 2] = x << level, y << level, z << level
        leaves[num, 3], leaves[num, 4] = level, state
    return num + 1


@kernel
def write_tree(levels, first, out):
    """Write a pyramid's nodes as a ``.bt`` has them: 2 bits a child, 2 bytes an inner node.

    Args:
        first: (3,) int64, the key of the first voxel.
        out: uint8, receives the bytes; empty to count them only.

    Returns:
        The number of bytes, and of all nodes.
    """
    if _state(levels, first, DEPTH, 0, 0, 0) == UNKNOWN:
        return 0, 0
    stack, depth = _new_stack()
    num_bytes, num_nodes = 0, 1
    while depth > 0:
        depth -= 1
        level, x, y, z = stack[depth]
        bits = 0
        # from the last child to the first, so that the first is taken from the stack next
        for child in range(7, -1, -1):
            cx, cy, cz = _child(x, y, z, child)
            state = _state(levels, first, level - 1, cx, cy, cz)
            bits |= min(state, 3) << (2 * child)  # 3: it has children of its own
            if state != UNKNOWN:
                num_nodes += 1
            if state >= MIXED_FREE:
                depth = _push(stack, depth, level - 1, cx, cy, cz)
        if out.shape[0] > 0:
            out[num_bytes], out[num_bytes + 1] = bits & 255, bits >> 8
        num_bytes += 2
    return num_bytes, num_nodes


@kernel
def write_odds(odds, levels, first, out):
    """Write a pyramid's nodes as an ``.ot`` has them: 4 bytes of log-odds, 1 of children.

    `odds` (3, 4) uint8 are the bytes of the log-odds of UNKNOWN, FREE and OCCUPIED. An inner node
    has the greatest of its children's. See `write_tree`.
    """
    if _state(levels, first, DEPTH, 0, 0, 0) == UNKNOWN:
        return 0, 0
    stack, depth = _new_stack()
    num_nodes = 0
    while depth > 0:
        depth -= 1
        level, x, y, z = stack[depth]
        state = _state(levels, first, level, x, y, z)
        children = 0
        if state >= MIXED_FREE:
            for child in range(7, -1, -1):
                cx, cy, cz = _child(x, y, z, child)
                if _state(levels, first, level - 1, cx, cy, cz) != UNKNOWN:
                    children |= 1 << child
                    depth = _push(stack, depth, level - 1, cx, cy, cz)
        if out.shape[0] > 0:
            value = OCCUPIED if state in (OCCUPIED, MIXED) else FREE
            for k in range(4):
                out[5 * num_nodes + k] = odds[value, k]
            out[5 * num_nodes + 4] = children
        num_nodes += 1
    return 5 * num_nodes, num_nodes


@kernel
def read_tree(data, leaves):
    """Read a ``.bt``'s nodes.

    Args:
        data: uint8.
        leaves: (n, 5) int32, receives each leaf's first key x, y, z, its level and its state;
            empty to count them only.

    Returns:
        The number of leaves, of bytes, and of all nodes; the first is OVERRUN or TOO_DEEP where
        the data are wrong.
    """
    stack, depth = _new_stack()
    place, num_leaves, num_nodes = 0, 0, 1
    while depth > 0:
        depth -= 1
        level, x, y, z = stack[depth]
        if place + 2 > data.shape[0]:
            return OVERRUN, place, num_nodes
        bits = np.int64(data[place]) | (np.int64(data[place + 1]) << 8)
        place += 2
        for child in range(7, -1, -1):
            state = bits >> (2 * child) & 3
            if state == UNKNOWN:
                continue
            num_nodes += 1
            cx, cy, cz = _child(x, y, z, child)
            if state == 3:
                if level == 1:
                    return TOO_DEEP, place, num_nodes
                depth = _push(stack, depth, level - 1, cx, cy, cz)
                continue
            num_leaves = _put_leaf(leaves, num_leaves, level - 1, cx, cy, cz, state)
    return num_leaves, place, num_nodes


@kernel
def read_odds(odds, data, leaves):
    """Read an ``.ot``'s nodes, 5 bytes each, like `read_tree`.

    `odds`, float32, are their log-odds; leaves of 0 and more are OCCUPIED, others FREE.
    """
    stack, depth = _new_stack()
    num_leaves, num_nodes = 0, 0
    while depth > 0:
        depth -= 1
        level, x, y, z = stack[depth]
        if 5 * num_nodes + 5 > data.shape[0]:
            return OVERRUN, 5 * num_nodes, num_nodes
        children = data[5 * num_nodes + 4]
        state = OCCUPIED if odds[num_nodes] >= 0.0 else FREE
        num_nodes += 1
        if children == 0:
            num_leaves = _put_leaf(leaves, num_leaves, level, x, y, z, state)
            continue
        if level == 0:
            return TOO_DEEP, 5 * num_nodes, num_nodes
        for child in range(7, -1, -1):
            if children >> child & 1:
                cx, cy, cz = _child(x, y, z, child)
                depth = _push(stack, depth, level - 1, cx, cy, cz)
    return num_leaves, 5 * num_nodes, num_nodes


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
                    values[i, j, k] = leaves[n, 4] == OCCUPIED
