"""Number the connected components of a graph, by union-find, and equal lists, by a hash table.

Disjoint sets as a forest of parents (Galler and Fischer, 1964) with path halving (Tarjan and van
Leeuwen, 1984). Of two roots the lower node becomes the parent, so a root is the first member of
its set, whatever the order of the unions. Path halving alone keeps the trees shallow enough.

The hash table has open addressing, and the hash is FNV-1a (Fowler, Noll and Vo) over the values,
with a shift that mixes the high bits down; lists with equal hashes are compared.
"""

import numpy as np

from navbake.compiled import NO_REFCOUNT, kernel, subkernel


@subkernel(**NO_REFCOUNT)
def find_root(parent, node):
    """Return the root of a node's set: its lowest member, which is its own parent.

    Args:
        parent: the parent of each node, (n,) integers; paths are halved on the way.
        node: the node.
    """
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@subkernel(**NO_REFCOUNT)
def unite(parent, first_node, second_node):
    """Join the sets of two nodes.

    Args:
        parent: the parent of each node, (n,) integers; changed.
        first_node: one node.
        second_node: the other node.
    """
    first_root = find_root(parent, first_node)
    second_root = find_root(parent, second_node)
    if first_root != second_root:
        parent[max(first_root, second_root)] = min(first_root, second_root)


@kernel
def number_components(pairs, num_nodes):
    """Number the connected components of a graph from 0, in the order of their first nodes.

    Args:
        pairs: the two nodes of each edge, (2, n) int64.
        num_nodes: number of nodes; nodes are numbered from 0.

    Returns:
        The component of each node, (num_nodes,) int32.
    """
    parent = np.arange(num_nodes)
    for k in range(pairs.shape[1]):
        unite(parent, pairs[0, k], pairs[1, k])
    component_of_node = np.empty(num_nodes, dtype=np.int32)
    num_components = 0
    for node in range(num_nodes):
        root = find_root(parent, node)
        if root == node:
            component_of_node[node] = num_components
            num_components += 1
        else:
            component_of_node[node] = component_of_node[root]
    return component_of_node


@kernel
def number_distinct_lists(start, entries, number_of_list):
    """Number lists from 0, in the order of first occurrence; equal lists get the same number.

    Args:
        start: list i is ``entries[start[i] : start[i + 1]]``, (lists + 1,) integers.
        entries: the entries of all lists, integers >= 0.
        number_of_list: receives the number of each list, (lists,).

    Returns:
        For each number, the index of the first list that has it, (numbers,) int64.
    """
    num_lists = start.shape[0] - 1
    hash_table_size = 16
    while hash_table_size < 2 * num_lists:  # at most half full, so that probing stays short
        hash_table_size *= 2
    hash_table = np.full(hash_table_size, -1, np.int64)
    first_list_of_number = np.empty(num_lists, np.int64)
    num_distinct_lists = 0
    for i in range(num_lists):
        hash_value = np.uint64(1469598103934665603)
        for j in range(start[i], start[i + 1]):
            hash_value = (hash_value ^ np.uint64(entries[j])) * np.uint64(1099511628211)
            hash_value ^= hash_value >> np.uint64(29)
        slot = np.int64(hash_value & np.uint64(hash_table_size - 1))
        while hash_table[slot] >= 0 and not _are_equal(
            start, entries, first_list_of_number[hash_table[slot]], i
        ):
            slot = (slot + 1) & (hash_table_size - 1)
        if hash_table[slot] < 0:
            hash_table[slot] = num_distinct_lists
            first_list_of_number[num_distinct_lists] = i
            num_distinct_lists += 1
        number_of_list[i] = hash_table[slot]
    return first_list_of_number[:num_distinct_lists].copy()


@subkernel(inline="always")
def _are_equal(start, entries, first_list, second_list):
    """Return whether two lists have the same entries; see `number_distinct_lists`."""
    if start[first_list + 1] - start[first_list] != start[second_list + 1] - start[second_list]:
        return False
    k = 0
    length = start[first_list + 1] - start[first_list]
    while k < length and entries[start[first_list] + k] == entries[start[second_list] + k]:
        k += 1
    return k == length
