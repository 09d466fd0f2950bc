"""Arrays that come block by block and become one."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

# Room is made for this much more than the blocks so far let expect: what isn't used takes no memory
SPARE = 1.1


class Gathered:
    """Arrays that grow at their ends, in place: there is never room for twice as much.

    Args:
        empty: an empty array of each one's dtype, and its shape but for the first axis.
    """

    def __init__(self, *empty: NDArray[Any]) -> None:
        self._arrays = [np.empty(array.shape, array.dtype) for array in empty]
        self._are_others = False  # whether the arrays are those of the part that was added
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, *parts: NDArray[Any], share: float = 1.0) -> None:
        """Add a part to each, all of one length.

        Args:
            share: how much of the whole is known with this part, > 0 to 1: so much room is made at
                once that most parts only fill it. The system gives new arrays larger pages than
                those that grow. A first part that is all of it is kept as it is, without a copy:
                nobody changes it afterwards.
        """
        begin, self._count = self._count, self._count + len(parts[0])
        known = zip(parts, self._arrays, strict=True)
        if begin == 0 and share >= 1.0 and all(part.dtype == own.dtype for part, own in known):
            self._arrays, self._are_others = list(parts), True
            return
        if self._are_others:  # what belongs to others can't grow
            self._arrays, self._are_others = [array.copy() for array in self._arrays], False
        room = self._count
        if room and share < 1.0:
            room = max(room, int(SPARE * room / share))
        for number, (array, part) in enumerate(zip(self._arrays, parts, strict=True)):
            shape = (room, *array.shape[1:])
            if begin == 0:
                self._arrays[number] = np.empty(shape, array.dtype)
            elif self._count > len(array):
                array.resize(shape, refcheck=False)  # nothing else refers to it yet
            self._arrays[number][begin : self._count] = part

    def take(self) -> list[NDArray[Any]]:
        """The arrays; nothing is added after that."""
        return [array[: self._count] for array in self._arrays]
