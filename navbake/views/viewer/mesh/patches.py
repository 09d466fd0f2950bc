"""A level's floor as level patches: large ones where it is flat, single cells on stairs and slopes.

Algorithm: a region quadtree (Samet, "The Quadtree and Related Hierarchical Data Structures", 1984),
made from the top down over a pyramid of least and greatest heights.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.types import Int

LARGEST = 8  # a patch spans up to 2 ** LARGEST cells a side
FLAT = 0.01  # heights in a patch differ by no more than this [m]
MOST = 200_000  # patches of a level; with more, FLAT is doubled until it is enough


class Patches(NamedTuple):
    """Level rectangles that cover all cells with a floor, none twice.

    Attributes:
        rows, cols: first, and last but one, shape (n, 2).
        z: of the highest floor in the patch, world frame, shape (n,) [m].
        flatness: by how much heights in a patch may differ [m].
    """

    rows: Int
    cols: Int
    z: NDArray[np.float32]
    flatness: float


def lay_patches(floor: NDArray[np.float32], most: int = MOST) -> Patches:
    """Cover a level's cells with patches.

    Cells without a floor may lie in a patch. A patch begins at a multiple of its side, so none
    crosses a multiple of ``2 ** LARGEST`` cells.

    Args:
        floor: world z of the floor, NaN for none, shape (height, width) [m].
        most: how many patches there may be, unless single cells are more.
    """
    lowest, highest = _pyramid(floor)
    flatness = FLAT
    while True:
        patches = _lay(floor.shape, lowest, highest, flatness)
        span = float(highest[-1].max() - lowest[-1].min()) if len(patches.z) else 0.0
        if len(patches.z) <= most or flatness > span:
            return patches
        flatness *= 2


def _pyramid(
    floor: NDArray[np.float32],
) -> tuple[list[NDArray[np.float32]], list[NDArray[np.float32]]]:
    """Least and greatest heights of blocks of 1, 2, 4, … cells a side; inf, -inf for no floor."""
    side = 1 << LARGEST
    padding = [(0, -length % side) for length in floor.shape]
    whole = np.pad(floor.astype(np.float32), padding, constant_values=np.nan)
    none = np.isnan(whole)
    lowest = [np.where(none, np.float32(np.inf), whole)]
    highest = [np.where(none, np.float32(-np.inf), whole)]
    for _ in range(LARGEST):
        for pyramid, join in ((lowest, np.minimum), (highest, np.maximum)):
            last = pyramid[-1]
            halved = join(last[::2], last[1::2])
            pyramid.append(join(halved[:, ::2], halved[:, 1::2]))
    return lowest, highest


def _lay(
    shape: tuple[int, ...],
    lowest: list[NDArray[np.float32]],
    highest: list[NDArray[np.float32]],
    flatness: float,
) -> Patches:
    rows, cols, heights = [], [], []
    is_open = np.ones(lowest[-1].shape, dtype=np.bool_)
    for scale in range(LARGEST, -1, -1):
        low, high = lowest[scale], highest[scale]
        is_open &= np.isfinite(low)
        with np.errstate(invalid="ignore"):  # where there is no floor
            is_flat = is_open & (high - low <= flatness)
        row, col = np.nonzero(is_flat)
        ends = (np.stack([first, first + 1], axis=1) << scale for first in (row, col))
        row_ends, col_ends = ends
        rows.append(np.minimum(row_ends, shape[0]))
        cols.append(np.minimum(col_ends, shape[1]))
        heights.append(high[is_flat])
        is_open = np.repeat(np.repeat(is_open & ~is_flat, 2, axis=0), 2, axis=1)
    return Patches(np.concatenate(rows), np.concatenate(cols), np.concatenate(heights), flatness)
