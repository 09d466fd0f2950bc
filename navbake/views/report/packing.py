"""Arrays in a page: compressed, as text that the page's script unpacks."""

import zlib
from base64 import b64encode
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.types import Float, Int, Json

LEVEL = 6  # of compression: 9 takes five times as long for 2 % less
NONE = -1  # stands for no value before packing


def pack(values: Int, *, smooth: bool = False) -> Json:
    """Pack whole numbers >= -1, shape (rows, cols); -1 stands for no value.

    They become unsigned numbers of as few bytes as hold them, the largest of which is no value.

    Args:
        smooth: whether neighbours in a row differ by little. Then differences are packed, which
            take less room.

    Returns:
        ``bytes`` of a number, whether ``deltas`` were packed, and ``data``: zlib, then base64.
    """
    kinds = (np.uint8, np.uint16, np.uint32)
    highest = int(values.max(initial=0))
    kind: Any = next(kind for kind in kinds if highest < np.iinfo(kind).max)
    stored = values.astype(kind)  # -1 becomes the largest number
    if smooth:
        stored = np.diff(stored, axis=1, prepend=np.zeros((len(stored), 1), dtype=kind))
    # first bytes of all numbers, then second bytes, …: alike ones stand together
    planes = stored.astype(stored.dtype.newbyteorder("<")).view(np.uint8)
    planes = planes.reshape(-1, stored.itemsize).T
    return {"bytes": stored.itemsize, "deltas": smooth, "data": to_text(planes.tobytes())}


def to_text(data: bytes) -> str:
    """Compress bytes into text."""
    return b64encode(zlib.compress(data, LEVEL)).decode("ascii")


def number_distinct(values: NDArray[Any]) -> tuple[Int, list[Any]]:
    """Number distinct values: which one each is, int64, and the values, ascending."""
    distinct, number = np.unique(values, return_inverse=True)
    return number.reshape(values.shape).astype(np.int64), distinct.tolist()


def to_steps(values: Float, step: float, lowest: float | None = None) -> tuple[Int, float]:
    """Round metres to whole steps, with -1 where they are not finite.

    Args:
        lowest: from where the steps count [m], no more than any value; the least value if None.

    Returns:
        The steps, int64, and from where they count [m].
    """
    finite = np.isfinite(values)
    if lowest is None:
        lowest = float(values[finite].min()) if finite.any() else 0.0
    steps = np.full(values.shape, NONE, dtype=np.int64)
    steps[finite] = np.round((values[finite] - lowest) / step)
    return steps, lowest
