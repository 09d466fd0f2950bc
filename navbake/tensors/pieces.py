"""Lets numpy answer large batches in pieces that fit the processor's cache, on several threads.

The other libraries run whole expressions on threads or devices of their own.
"""

import math
from collections.abc import Callable

import numpy as np

from navbake.tensors.grid_tensors import Array, GridTensors

NUMPY = ("numpy", "array_api_compat.numpy")
PIECE = 16_384  # positions: their coordinates, ids and masks stay in the second cache


def answer_all(
    t: GridTensors, answer: Callable[..., Array], positions: Array, *further: Array | int | None
) -> Array:
    """Answer a question about positions of any shape (..., 3).

    Args:
        t: whose library the arrays are of.
        answer: takes positions of shape (m, 3) and the others of shape (m,), or all as they are
            given here; gives an array of shape (m, ...).
        positions: shape (..., 3).
        further: shape (...); or None or an integer, which stay as they are.
    """
    shape = tuple(positions.shape[:-1])
    if t.xp.__name__ not in NUMPY or math.prod(shape) < 2 * PIECE:
        return answer(positions, *further)
    count = math.prod(shape)
    from navbake.threads import run_in_bands  # saves numba where batches are small

    whole = [
        a if a is None or isinstance(a, int) else np.reshape(a, (count, *a.shape[len(shape) :]))
        for a in (positions, *further)
    ]

    def piece(first: int, last: int) -> Array:
        parts = (a[first:last] if isinstance(a, np.ndarray) else a for a in whole)
        return answer(*parts)

    start = piece(0, PIECE)
    found = np.empty((count, *start.shape[1:]), dtype=start.dtype)
    found[:PIECE] = start

    def fill(first: int, last: int) -> None:
        for begin in range(PIECE + first, PIECE + last, PIECE):
            end = min(begin + PIECE, PIECE + last)
            found[begin:end] = piece(begin, end)

    run_in_bands(fill, count - PIECE, least=PIECE)
    return found.reshape(*shape, *found.shape[1:])
