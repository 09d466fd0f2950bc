"""What is left of a mask that is shrunk: an erosion by a disc, without a distance transform.

A cell survives when all cells nearer than the limit belong to the mask. Asked cell by cell and
only until enough have survived, that is cheaper than a transform of the whole lattice.
"""

import numpy as np

from navbake.compiled import UNCOUNTED, kernel


def near_offsets(limit: float, shorter: int) -> np.ndarray:
    """Steps to the cells that are nearer than a limit [cells], the farthest first, (n, 2) int64.

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


def east_rim(offsets: np.ndarray) -> np.ndarray:
    """The offsets that are none of the offsets one cell further west, nor the cell there itself.

    East of a cell all of whose neighbours belong to a set, only these are not known yet.
    """
    reach = int(np.abs(offsets).max(initial=0))
    known = np.zeros((2 * reach + 1, 2 * reach + 2), dtype=np.bool_)
    known[offsets[:, 0] + reach, offsets[:, 1] + reach] = True
    known[reach, reach] = True
    rim: np.ndarray = offsets[~known[offsets[:, 0] + reach, offsets[:, 1] + reach + 1]]
    return rim


@kernel(nogil=True, **UNCOUNTED)
def mark_inner(cells, offsets, rim, width, height, needed, mask, counted, inner):
    """Mark the cells of a set whose neighbours at all offsets belong to it, until enough are found.

    Far neighbours are asked first, because near the edge of a set one of them is missing soon. Of
    a cell that follows one that is marked, only the neighbours at the rim are asked, see
    `east_rim`. `mask` and `counted`, by cell, are all False, and so again afterwards. `inner`,
    (n,) bool, all False, receives the marks. Returns how many cells were found; one that is named
    twice counts once.
    """
    for cell in cells:
        mask[cell] = True
    found = 0
    for n in range(cells.shape[0]):
        if found >= needed:
            break
        row, col = cells[n] // width, cells[n] % width
        inner[n] = True
        follows = n > 0 and inner[n - 1] and cells[n - 1] == cells[n] - 1 and col > 0
        asked = rim if follows else offsets
        for k in range(asked.shape[0]):
            r, c = row + asked[k, 0], col + asked[k, 1]
            if r < 0 or r >= height or c < 0 or c >= width or not mask[r * width + c]:
                inner[n] = False
                break
        if inner[n] and not counted[cells[n]]:
            counted[cells[n]] = True
            found += 1
    for cell in cells:
        mask[cell] = False
        counted[cell] = False
    return found
