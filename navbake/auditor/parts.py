"""What is connected: the parts of a grid's cells, in plain array operations.

A check shares no code with what it checks, so this is another way than that of a bake: parts of an
image, in C. Two neighbours that lie more than a step apart are rare, and an image knows no such
thing; where there are some, the image is drawn with a cell of its own for each pair of neighbours.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import label

from navbake.types import Bool, Float, Int, Int32


class Steps(NamedTuple):
    """Marked cells of a level beside each other that lie more than a step apart.

    Attributes:
        down: flat ids of those whose neighbour in the next row does.
        right: of those whose neighbour in the next column does.
    """

    down: Int
    right: Int


def find_steps(mask: Bool, floor: Float, limit: float) -> Steps:
    """Find the steps between marked cells of a level that are higher than a limit [m].

    Cells without a floor are at no height, so that nothing lies a step above or below them.
    """
    floors = floor[mask]
    none = np.empty(0, dtype=np.int64)
    low, high = np.fmin.reduce(floors, initial=np.nan), np.fmax.reduce(floors, initial=np.nan)
    with np.errstate(invalid="ignore"):  # floors that are infinite are told as such
        if not high - low > limit:
            return Steps(none, none)
        width = mask.shape[1]
        is_down = (np.abs(floor[:-1] - floor[1:]) > limit) & mask[:-1] & mask[1:]
        is_right = (np.abs(floor[:, :-1] - floor[:, 1:]) > limit) & mask[:, :-1] & mask[:, 1:]
    rows, cols = np.nonzero(is_right)
    return Steps(np.flatnonzero(is_down), rows * width + cols)


def number_islands(masks: list[Bool], steps: list[Steps], links: Int) -> list[Int32]:
    """Number the connected parts of all levels' marked cells from 1, the largest first; 0 for none.

    Neighbours by an edge hang together unless there is a step between them; so do the ends of a
    link. Of parts of one size, that with the lowest cell comes first.

    Args:
        masks: the marked cells of each level, shape (height, width).
        steps: between them, see `find_steps`.
        links: level, cell, level and cell of each, shape (n, 4).
    """
    parts, before = [], 0
    for mask, between in zip(masks, steps, strict=True):
        part, count = _label_level(mask, between)
        if before:
            part[mask] += before
        parts.append(part)
        before += count
    root = _join(parts, links, before)
    size = np.zeros(before + 1, dtype=np.int64)
    for part in parts:
        size += np.bincount(part.ravel(), minlength=before + 1)
    whole = np.zeros_like(size)
    np.add.at(whole, root, size)
    roots = np.flatnonzero(root == np.arange(before + 1))[1:]  # without 0, which is no part
    number = np.zeros(before + 1, dtype=np.int32)
    number[roots[np.argsort(-whole[roots], kind="stable")]] = np.arange(1, len(roots) + 1)
    number = number[root]
    if np.array_equal(number, np.arange(before + 1)):
        return parts
    return [number[part] for part in parts]


def _label_level(mask: Bool, steps: Steps) -> tuple[Int32, int]:
    """The parts of one level, numbered by their first cells, 0 for none; and how many there are."""
    if not len(steps.down) and not len(steps.right):
        part, count = label(mask, output=np.int32)
        return part, count
    height, width = mask.shape
    joints = np.zeros((2 * height - 1, 2 * width - 1), dtype=np.bool_)
    joints[::2, ::2] = mask
    joints[1::2, ::2] = mask[:-1] & mask[1:]
    joints[::2, 1::2] = mask[:, :-1] & mask[:, 1:]
    rows, cols = np.divmod(steps.down, width)
    joints[2 * rows + 1, 2 * cols] = False
    rows, cols = np.divmod(steps.right, width)
    joints[2 * rows, 2 * cols + 1] = False
    part, count = label(joints, output=np.int32)
    return np.ascontiguousarray(part[::2, ::2]), count


def _join(parts: list[Int32], links: Int, count: int) -> Int:
    """The lowest of the parts that hang together over links, for each part from 0 on."""
    root = np.arange(count + 1)
    if not len(links):
        return root
    ends = [np.zeros(len(links), dtype=np.int64) for _ in range(2)]
    for number, part in enumerate(parts):
        for end, (level, cell) in zip(ends, ((0, 1), (2, 3)), strict=True):
            here = links[:, level] == number
            end[here] = part.ravel()[links[here, cell]]
    pairs = np.unique(np.sort(np.stack(ends, axis=1), axis=1), axis=0)
    pairs = pairs[pairs[:, 0] > 0]  # a blocked end joins nothing
    changed = True
    while changed:  # each pass takes the lower root to both ends
        low = np.minimum(root[pairs[:, 0]], root[pairs[:, 1]])
        before = root.copy()
        for side in (0, 1):
            np.minimum.at(root, pairs[:, side], low)
        root = root[root]
        changed = not np.array_equal(root, before)
    return root
