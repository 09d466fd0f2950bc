"""Colours for regions of a map, such that neighbours differ."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.types import Int


def find_neighbours(index: NDArray[Any], reach: int) -> set[tuple[int, int]]:
    """Which regions of a map are near each other, along a row or a column.

    Args:
        index: the region of each cell from 1, 0 for none, shape (height, width), integers.
        reach: how many cells of no region may lie between, as those of a wall do.

    Returns:
        Pairs of two regions, the smaller number first.
    """
    pairs: set[tuple[int, int]] = set()
    for lines in (index, index.T):
        line, place = np.nonzero(lines[:, 1:] != lines[:, :-1])
        before, after = lines[line, place], lines[line, place + 1]
        touch = (before != 0) & (after != 0)
        _collect(pairs, before[touch], after[touch])
        # a gap opens at one change and closes at the next one of the same line
        gap = (line[1:] == line[:-1]) & (after[:-1] == 0) & (before[:-1] != 0)
        gap &= np.diff(place) <= reach
        _collect(pairs, before[:-1][gap], after[1:][gap])
    return pairs


def _collect(pairs: set[tuple[int, int]], one: NDArray[Any], other: NDArray[Any]) -> None:
    apart = one != other
    both = np.stack([one[apart], other[apart]], axis=1).astype(np.int64)
    both.sort(axis=1)
    pairs.update(map(tuple, np.unique(both, axis=0).tolist()))


def choose_colors(count: int, pairs: Iterable[tuple[int, int]], num_colors: int) -> Int:
    """A colour for each of some regions, none like a neighbour's while there are enough colours.

    Greedy colouring (Welsh and Powell 1967): the region with most neighbours chooses first. Of
    the colours that fewest of its neighbours have, it takes the one that is least used so far.

    Args:
        count: how many regions there are; they are numbered from 1.
        pairs: which are neighbours.
        num_colors: how many colours there are.

    Returns:
        Numbers of colours from 0, shape (count + 1,); that of region 0 means nothing.
    """
    near: list[set[int]] = [set() for _ in range(count + 1)]
    for one, other in pairs:
        near[one].add(other)
        near[other].add(one)
    chosen = np.full(count + 1, -1, dtype=np.int64)
    used = [0] * num_colors
    for region in sorted(range(1, count + 1), key=lambda region: (-len(near[region]), region)):
        beside = [0] * num_colors
        for other in near[region]:
            if chosen[other] >= 0:
                beside[chosen[other]] += 1
        best = min(range(num_colors), key=lambda color: (beside[color], used[color], color))
        chosen[region] = best
        used[best] += 1
    chosen[0] = 0
    return chosen
