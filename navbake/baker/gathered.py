"""Arrays that come block by block and become one."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


class Gathered:
    """Arrays that grow at their ends, in place: there is never room for twice as much.

    Args:
        empty: an empty array of each one's dtype, and its shape but for the first axis.
    """

    def __init__(self, *empty: NDArray[Any]) -> None:
        self._arrays = [np.empty(array.shape, array.dtype) for array in empty]

    def __len__(self) -> int:
        return len(self._arrays[0])

    def add(self, *parts: NDArray[Any]) -> None:
        """Add a part to each, all of one length."""
        for whole, part in zip(self._arrays, parts, strict=True):
            count = len(whole)
            # nothing else refers to it yet
            whole.resize((count + len(part), *whole.shape[1:]), refcheck=False)
            whole[count:] = part

    def take(self) -> list[NDArray[Any]]:
        """The arrays; nothing is added after that."""
        return self._arrays
