"""Lists of boxes by the tiles or bands of a lattice that they lie over."""

import numpy as np

from navbake.baker.kernels.tiles import BAND, TILE, list_boxes
from navbake.navgrid.lattice import Lattice
from navbake.threads import num_threads, run_in_bands
from navbake.types import Float, Int, Int32

# Chunks of boxes for each thread; fewer boxes than so many a tile aren't worth counts of their own
CHUNKS, WORTH = 2, 4


def tile_of(lattice: Lattice, cell: Int | int) -> Int:
    """The tile that holds each cell; tiles are numbered row by row."""
    row, col = np.divmod(cell, lattice.width)
    tile: Int = row // TILE * -(-lattice.width // TILE) + col // TILE
    return tile


def list_by_tile(boxes: Float, grow: float, lattice: Lattice) -> tuple[Int, Int32]:
    """List, for each tile, the boxes, shape (n, 6), that reach into it, grown in the plane [m].

    Returns:
        The list of tile t is ``item[start[t] : start[t + 1]]``, ascending; start, shape
        (tiles + 1,), int64, and item, shape (start[-1],), int32.
    """
    tiles = -(-lattice.width // TILE) * -(-lattice.height // TILE)
    return _list(boxes, grow, lattice, tiles, by_band=False)


def list_by_band(boxes: Float, grow: float, lattice: Lattice) -> tuple[Int, Int32]:
    """List, for each band of rows, the boxes that hold a cell's centre there, as `list_by_tile`."""
    return _list(boxes, grow, lattice, -(-lattice.height // BAND), by_band=True)


def _list(
    boxes: Float, grow: float, lattice: Lattice, count: int, *, by_band: bool
) -> tuple[Int, Int32]:
    threads, chunks = num_threads(), 1
    if threads > 1 and len(boxes) > WORTH * count:
        # no more counts than boxes, however many threads there are
        chunks = min(CHUNKS * threads, len(boxes) // count)
    cursor = np.zeros((chunks, count), dtype=np.int64)
    under = np.empty((len(boxes), 4), dtype=np.int32)
    asked = boxes, grow, lattice, by_band, under, cursor
    run_in_bands(list_boxes, chunks, *asked, np.empty(0, dtype=np.int32))
    start = np.zeros(count + 1, dtype=np.int64)
    np.cumsum(cursor.sum(axis=0), out=start[1:])
    # each chunk's boxes over a tile follow those of the chunks before it
    cursor[:] = np.cumsum(cursor, axis=0) - cursor + start[:-1]
    item = np.empty(start[-1], dtype=np.int32)
    if len(item):
        run_in_bands(list_boxes, chunks, *asked, item)
    return start, item
