"""The links between levels, as a file's metadata state them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError


def read_links(stated: Any, num_cells: Sequence[int]) -> NDArray[np.int64]:
    """Check links: a flat list of whole numbers, four a link, or a list of lists of four.

    Args:
        stated: what stands at ``metadata.navbake.links``, None for nothing.
        num_cells: number of cells of each level.

    Returns:
        Shape (n, 4), int64: level, cell id on it, other level, cell id on that.

    Raises:
        FormatError: they are no links, or lead to a level or a cell that there is not.
    """
    where = "at `metadata.navbake.links`"
    numbers = [] if stated is None else stated
    if isinstance(numbers, list) and any(isinstance(link, list | tuple) for link in numbers):
        if any(not isinstance(link, list | tuple) or len(link) != 4 for link in numbers):
            raise FormatError(f"expected links of 4 numbers each {where}")
        numbers = [number for link in numbers for number in link]
    if not isinstance(numbers, list) or len(numbers) % 4 or not set(map(type, numbers)) <= {int}:
        raise FormatError(f"expected a list of whole numbers, 4 a link, {where}")
    links = np.array(numbers, dtype=np.float64).reshape(-1, 4)  # float64: nothing overflows
    for column, name in ((0, "level"), (2, "level"), (1, "cell"), (3, "cell")):
        limit = len(num_cells) if name == "level" else _pick(num_cells, links[:, column - 1])
        bad = (links[:, column] < 0) | (links[:, column] >= limit)
        if bad.any():
            number = int(np.argmax(bad))
            raise FormatError(
                f"expected a {name} that there is, got {links[number, column]:.0f} "
                f"in link {number} {where}"
            )
    return links.astype(np.int64)


def _pick(num_cells: Sequence[int], levels: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.array(num_cells, dtype=np.int64)[levels.astype(np.int64)]
