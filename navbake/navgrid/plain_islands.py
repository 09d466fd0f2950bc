"""The connected parts of free cells in plain numpy, for processes that have not loaded numba.

Connected components (Shiloach and Vishkin, 1982): cells of a row that are connected make one run.
Each run points at the lowest run that it is known to be connected with, at first itself. Then, in
turns, the ends of all pairs of connected runs are hooked, the higher to the lower, and all pointers
are followed to their ends, until no pair is left whose ends differ.
"""

import numpy as np

from navbake.types import Bool, Float, Int, Int32


def label_plainly(
    start: Int, width: Int, free: Bool, floor: Float, limit: float, links: Int
) -> Int32:
    """Number the parts as `navbake.navgrid.kernels.islands.label_islands` does; takes the same.

    Returns:
        The part of each cell, shape (n,), int32, 0 where it isn't free.
    """
    # float32, and a difference of two that is rounded to it, could pass a limit
    floor = floor.astype(np.float64)
    begins, below = free.copy(), [np.zeros((0, 2), dtype=np.int64)]
    for first, last, columns in zip(start[:-1], start[1:], width, strict=True):
        shape = (-1, int(columns))
        is_free, height = free[first:last].reshape(shape), floor[first:last].reshape(shape)
        cell = np.arange(first, last).reshape(shape)
        right = is_free[:, 1:] & is_free[:, :-1] & _are_level(height[:, 1:], height[:, :-1], limit)
        begins[first:last].reshape(shape)[:, 1:] &= ~right
        down = is_free[1:] & is_free[:-1] & _are_level(height[1:], height[:-1], limit)
        below.append(np.stack([cell[:-1][down], cell[1:][down]], axis=1))
    run = np.cumsum(begins) - 1
    links = links[free[links].all(axis=1)]
    root = _join(int(np.count_nonzero(begins)), run[np.concatenate([*below, links])])
    parts, number = np.unique(root, return_inverse=True)
    size = np.bincount(number[run[free]], minlength=len(parts))
    rank = np.empty(len(parts), dtype=np.int32)
    # stable, so that equal parts stay in the order of their first cells
    rank[np.argsort(-size, kind="stable")] = np.arange(1, len(parts) + 1)
    island = np.zeros(len(free), dtype=np.int32)
    island[free] = rank[number[run[free]]]
    return island


def _are_level(one: Float, other: Float, limit: float) -> Bool:
    """Whether floors differ by at most a limit; where one isn't known, they do."""
    return np.asarray(~(np.abs(one - other) > limit))


def _join(num: int, pairs: Int) -> Int:
    """For each of some items, the lowest one that it is connected with over pairs."""
    root = np.arange(num)
    while len(pairs):
        ends = root[pairs]
        pairs = pairs[ends[:, 0] != ends[:, 1]]
        low, high = (function(root[pairs], axis=1) for function in (np.min, np.max))
        np.minimum.at(root, high, low)
        while (root[root] != root).any():
            root = root[root]
    return root
