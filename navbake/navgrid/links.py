"""The links between cells, as a file's metadata state them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from navbake.errors import FormatError
from navbake.types import Int


@dataclass(frozen=True)
class Link:
    """A step from a cell to another that heights alone don't tell of, taken either way.

    It leads to another level, or to a neighbour on the same one, more than a step higher or lower,
    on a ramp that rises so much over a cell.

    Attributes:
        level, cell: a level and the id of a cell on it (col + row * width).
        other_level, other_cell: where the step leads.
    """

    level: int
    cell: int
    other_level: int
    other_cell: int


def parse_links(stated: Any, num_cells: Sequence[int]) -> Int:
    """Read ``metadata.navbake.links``, None for nothing, on levels of so many cells.

    They are a flat list of whole numbers, four a link, or a list of lists of four. The result has
    the fields of a `Link` in each row, shape (n, 4), int64, read-only.
    """
    where = "at `metadata.navbake.links`"
    numbers = [] if stated is None else stated
    # navbake writes a list of lists; both forms become one flat list
    if isinstance(numbers, list) and any(isinstance(link, list | tuple) for link in numbers):
        if any(not isinstance(link, list | tuple) or len(link) != 4 for link in numbers):
            raise FormatError(f"expected links of 4 numbers each {where}")
        numbers = [number for link in numbers for number in link]
    if not isinstance(numbers, list) or len(numbers) % 4 or not set(map(type, numbers)) <= {int}:
        raise FormatError(f"expected a list of whole numbers, 4 a link, {where}")
    stated_links = np.array(numbers, dtype=np.float64).reshape(-1, 4)  # float64: no overflow
    for column, name in ((0, "level"), (2, "level"), (1, "cell"), (3, "cell")):
        limit: Any = len(num_cells)
        if name == "cell":  # the levels were checked before
            limit = np.array(num_cells, dtype=np.int64)[stated_links[:, column - 1].astype(int)]
        bad = (stated_links[:, column] < 0) | (stated_links[:, column] >= limit)
        if bad.any():
            number = int(np.argmax(bad))
            raise FormatError(
                f"expected an existing {name}, got {stated_links[number, column]:.0f} "
                f"in link {number} {where}"
            )
    links = stated_links.astype(np.int64)
    links.flags.writeable = False
    return links
