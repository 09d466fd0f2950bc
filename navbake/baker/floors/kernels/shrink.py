"""What is left of a mask that is shrunk: an erosion by a disc, without a distance transform.

A cell survives when all cells nearer than the limit belong to the mask. Asked cell by cell, the
farthest neighbours first, and only until enough have survived, that is cheaper than a transform of
the whole lattice.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from navbake.compiled import UNCOUNTED, kernel, part
from navbake.types import Int


class AreaTest(NamedTuple):
    """Whether cells are enough for a floor: how many are left when their set is shrunk.

    Attributes:
        needed: so many cells have to be left.
        reach: how far the steps of `disc` lead [cells].
        disc: steps to the cells that have to be in the set around one that is left, the farthest
            first, shape (n, 2), int64.
        rim: those of them that one further west has not asked for, see `east_rim`.
    """

    needed: int
    reach: int
    disc: Int
    rim: Int


@lru_cache(maxsize=4)  # several tests of a scene ask for the same, and so do scenes of a batch
def near_offsets(limit: float, shorter: int) -> Int:
    """Steps to the cells that are nearer than a limit [cells], the farthest first; don't change it.

    Where no cell is as far from outside as the limit (the lattice's shorter side is given), those
    steps are enough of which one always leads out.
    """
    out = (shorter + 1) // 2
    if limit > out:
        return np.array([[0, out], [0, -out], [out, 0], [-out, 0]], dtype=np.int64)
    reach = int(np.ceil(limit))
    rows, cols = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    squares = (rows**2 + cols**2).ravel()
    order = np.argsort(-squares, kind="stable")
    squares = squares[order]
    chosen = order[(squares > 0) & (np.sqrt(squares) < limit)]
    return np.stack([rows.ravel()[chosen], cols.ravel()[chosen]], axis=1).astype(np.int64)


def east_rim(offsets: Int) -> Int:
    """The offsets that are none of the offsets one cell further west, nor the cell there itself.

    East of a cell all of whose neighbours belong to a set, only these are not known yet.
    """
    reach = int(np.abs(offsets).max(initial=0))
    known = np.zeros((2 * reach + 1, 2 * reach + 2), dtype=np.bool_)
    known[offsets[:, 0] + reach, offsets[:, 1] + reach] = True
    known[reach, reach] = True
    rim: Int = offsets[~known[offsets[:, 0] + reach, offsets[:, 1] + reach + 1]]
    return rim


@part(inline="always")
def is_left(mask, row, col, offsets):
    """Whether all cells at some steps from one belong to a mask."""
    for k in range(offsets.shape[0]):  # noqa: SIM110 (numba has no generators in `all`)
        if not mask[row + offsets[k, 0], col + offsets[k, 1]]:
            return False
    return True


@kernel(nogil=True, **UNCOUNTED)
def count_left(mask, test, needed):
    """Count the cells that are left of a mask, with a margin of `reach`; or enough of them."""
    found = 0
    for row in range(test.reach, mask.shape[0] - test.reach):
        follows = False
        for col in range(test.reach, mask.shape[1] - test.reach):
            follows = mask[row, col] and is_left(mask, row, col, test.rim if follows else test.disc)
            found += 1 if follows else 0
        if found >= needed:
            break
    return found
