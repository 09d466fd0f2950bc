"""Connected surfaces: parts inside of blocks, and the wholes that they make together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navbake.baker.blocks import Blocks, BlockTable
from navbake.baker.connect import connect
from navbake.baker.floors.kernels.labels import JOINS, LINKS, label_blocks, list_pairs
from navbake.baker.floors.kernels.surfaces import Surfaces
from navbake.threads import run_in_bands
from navbake.types import Bool, Int, Int32

NO_KEY = np.empty(0, dtype=np.int32)
# An empty array of rows that count, see `navbake.baker.floors.kernels.labels`
NO_ROWS = np.empty((0, 4), dtype=np.int64)


class Joining(NamedTuple):
    """What joins surfaces of neighbouring cells, and what only links them.

    Attributes:
        step: surfaces of one group at most so far apart hang together [m].
        reach: parts that do not, and have surfaces at most so far apart, are linked [m]; none are
            where it is less than 0.
        by_slopes: whether slopes join surfaces, too.
    """

    step: float
    reach: float = -1.0
    by_slopes: bool = False


class Labels:
    """The connected parts of surfaces in each block, and what joins and links them.

    Parts are numbered one block after the other.

    Attributes:
        part: the number of each surface's part in its block, -1 for none, int32.
        count: how many parts each block has.
        offset: the number of each block's first part, and of all parts, shape (blocks + 1,).
    """

    def __init__(self, blocks: Blocks, joining: Joining) -> None:
        self.blocks, self._joining = blocks, joining
        self.part, self.count = np.empty(0, dtype=np.int32), np.zeros(blocks.num, dtype=np.int64)
        self._pairs = BlockTable(blocks.num, NO_ROWS)

    def update(self, surfaces: Surfaces, stale: Bool, key: Int32 = NO_KEY) -> None:
        """Find the parts of stale blocks again; see `label_blocks` for the key."""
        self.part = fit(self.part, len(surfaces.z))
        chosen, near = np.flatnonzero(stale), np.flatnonzero(self.blocks.before(stale))
        asked = self.blocks.lattice, surfaces, key, self._joining, self.part
        run_in_bands(label_blocks, len(chosen), *asked, chosen, self.count)
        self._pairs.fill(list_pairs, near, *asked)
        self.offset = np.concatenate([[0], np.cumsum(self.count)])

    @property
    def block(self) -> Int:
        """The block of each part."""
        return np.repeat(np.arange(self.blocks.num), self.count)

    def merge(self) -> tuple[Int32, Int]:
        """The whole that each part belongs to, numbered by their first parts; and linked wholes.

        Returns:
            The numbers, shape (parts,), and pairs of wholes, each once, shape (2, m): first the
            one with the lower number.
        """
        block, (rows,) = self._pairs.take()
        one, other, what, _ = rows.T
        step = np.array([0, 1, self.blocks.cols])[what % 3]
        pairs = np.stack([self.offset[block] + one, self.offset[block + step] + other])
        whole = connect(pairs[:, what // 3 == JOINS], int(self.offset[-1]))
        links = np.sort(whole[pairs[:, what // 3 == LINKS]], axis=0)
        links = links[:, links[0] != links[1]].astype(np.int64)
        if links.size:
            links = np.stack(np.divmod(np.unique(links[0] * len(whole) + links[1]), len(whole)))
        return whole, links


def fit(array: Int32, length: int) -> Int32:
    """The array with room for so many surfaces."""
    if len(array) >= length:
        return array
    wide = np.empty(length, dtype=array.dtype)
    wide[: len(array)] = array
    return wide
