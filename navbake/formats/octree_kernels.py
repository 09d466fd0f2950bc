"""Decodes the nodes of OctoMap's files into leaves, and leaves into voxels.

Source: OctoMap 1.9, `OccupancyOcTreeBase::readBinaryNode`, `OcTreeBaseImpl::readNodesRecurs`.
"""

import numpy as np

from navbake.compiled import kernel

DEPTH = 16
# states of a child, as a ``.bt`` has them
UNKNOWN = 0
FREE = 1
OCCUPIED = 2
INNER = 3
# faults, which are returned instead of the number of leaves
OVERRUN = -1
TOO_DEEP = -2


@kernel
def read_leaves(node_bytes, log_odds, has_log_odds, leaves):
    """Read the nodes of a ``.bt``, or of an ``.ot``, depth first.

    Args:
        node_bytes: the nodes' bytes, shape (m,), uint8. In a ``.bt``, a node with children has 2
            bytes, 2 bits for each child. In an ``.ot``, each node has 4 bytes of log-odds, and a
            byte whose bits say which children exist.
        log_odds: the log-odds of each node of an ``.ot``, float32. A leaf is occupied if they are 0
            or more.
        has_log_odds: whether the data come from an ``.ot``.
        leaves: receives a row for each leaf: its lowest key along x, y and z, its level (its edge
            is 2**level voxels), and 1 if it is occupied; shape (n, 5), int32. Empty to only count
            the leaves.

    Returns:
        The number of leaves, the number of bytes that were read, and the number of nodes. If the
        data are wrong, OVERRUN or TOO_DEEP takes the place of the number of leaves.
    """
    writes_leaves = leaves.shape[0] > 0
    # rows (level, x, y, z) of nodes to be read; level 16 is the root, level 0 a voxel; it holds at
    # most 8 children of each level
    stack = np.zeros((8 * (DEPTH + 1), 4), np.int64)
    stack[0, 0] = DEPTH
    stack_size = 1
    byte_index = 0
    num_leaves = 0
    num_nodes = 0 if has_log_odds else 1
    while stack_size > 0:
        stack_size -= 1
        level, x, y, z = stack[stack_size]
        if byte_index + (5 if has_log_odds else 2) > node_bytes.shape[0]:
            return OVERRUN, byte_index, num_nodes
        if has_log_odds:
            child_bits = np.int64(node_bytes[byte_index + 4])
            byte_index += 5
            num_nodes += 1
            if child_bits == 0:
                if writes_leaves:
                    leaves[num_leaves, 0] = x << level
                    leaves[num_leaves, 1] = y << level
                    leaves[num_leaves, 2] = z << level
                    leaves[num_leaves, 3] = level
                    leaves[num_leaves, 4] = log_odds[num_nodes - 1] >= 0.0
                num_leaves += 1
                continue
        else:
            child_bits = np.int64(node_bytes[byte_index]) | (
                np.int64(node_bytes[byte_index + 1]) << 8
            )
            byte_index += 2
        for child in range(7, -1, -1):
            child_state = (
                INNER * (child_bits >> child & 1) if has_log_odds else child_bits >> (2 * child) & 3
            )
            if child_state == UNKNOWN:
                continue
            num_nodes += not has_log_odds
            child_x = 2 * x + (child & 1)
            child_y = 2 * y + (child >> 1 & 1)
            child_z = 2 * z + (child >> 2)
            if child_state == INNER:
                if level == (0 if has_log_odds else 1):
                    return TOO_DEEP, byte_index, num_nodes
                stack[stack_size, 0] = level - 1
                stack[stack_size, 1] = child_x
                stack[stack_size, 2] = child_y
                stack[stack_size, 3] = child_z
                stack_size += 1
                continue
            if writes_leaves:
                child_level = level - 1
                leaves[num_leaves, 0] = child_x << child_level
                leaves[num_leaves, 1] = child_y << child_level
                leaves[num_leaves, 2] = child_z << child_level
                leaves[num_leaves, 3] = child_level
                leaves[num_leaves, 4] = child_state == OCCUPIED
            num_leaves += 1
    return num_leaves, byte_index, num_nodes


@kernel
def fill_leaves(leaves, first_keys, is_occupied, is_known):
    """Write the state of each leaf of an octree into the voxels that the leaf covers.

    Args:
        leaves: the leaves, see `read_leaves`, shape (n, 5), int32.
        first_keys: the keys of the first voxel along x, y and z, shape (3,), int64.
        is_occupied: receives whether each voxel is occupied, shape (nx, ny, nz), bool.
        is_known: receives True in each voxel that a leaf covers, of the same shape.
    """
    num_x, num_y, num_z = is_occupied.shape
    for leaf_index in range(leaves.shape[0]):
        leaf_size = 1 << leaves[leaf_index, 3]
        x = leaves[leaf_index, 0] - first_keys[0]
        y = leaves[leaf_index, 1] - first_keys[1]
        z = leaves[leaf_index, 2] - first_keys[2]
        for i in range(max(x, 0), min(x + leaf_size, num_x)):
            for j in range(max(y, 0), min(y + leaf_size, num_y)):
                for k in range(max(z, 0), min(z + leaf_size, num_z)):
                    is_known[i, j, k] = True
                    is_occupied[i, j, k] = leaves[leaf_index, 4] != 0
