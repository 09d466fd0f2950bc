"""What is connected, held against a walk from cell to cell."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from navbake.auditor.facts import number_islands

STEP = 0.25
HEIGHTS = (0.0, 0.1, 0.3, 5.0, np.inf, np.nan)  # steps and none between them


def walk(masks, floors, links):
    """The numbers of all cells, by walking from each cell to all that it leads to."""
    cells = {(k, r, c) for k, mask in enumerate(masks) for r, c in np.argwhere(mask).tolist()}
    over = {}
    for a, one, b, other in links.tolist():
        ends = (a, *divmod(one, masks[a].shape[1])), (b, *divmod(other, masks[b].shape[1]))
        for here, there in (ends, ends[::-1]):
            over.setdefault(here, []).append(there)
    parts, seen = [], set()
    for start in sorted(cells):
        if start in seen:
            continue
        part, left = [], [start]
        seen.add(start)
        while left:
            here = left.pop()
            part.append(here)
            k, row, col = here
            beside = [(k, row + 1, col), (k, row - 1, col), (k, row, col + 1), (k, row, col - 1)]
            beside = [n for n in beside if n in cells and not _is_step(floors[k], here, n)]
            for there in [*beside, *(n for n in over.get(here, ()) if n in cells)]:
                if there not in seen:
                    seen.add(there)
                    left.append(there)
        parts.append(part)
    numbers = [np.zeros(mask.shape, dtype=np.int32) for mask in masks]
    for number, part in enumerate(sorted(parts, key=lambda part: (-len(part), min(part))), 1):
        for k, row, col in part:
            numbers[k][row, col] = number
    return numbers


def _is_step(floor, here, there):
    with np.errstate(invalid="ignore"):
        return abs(floor[here[1:]] - floor[there[1:]]) > STEP


@st.composite
def houses(draw):
    """Masks, floors and links of one to three small levels."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shapes = draw(st.lists(st.tuples(st.integers(1, 7), st.integers(1, 7)), min_size=1, max_size=3))
    heights = draw(st.lists(st.sampled_from(HEIGHTS), min_size=1, max_size=4))
    masks = [rng.random(shape) < 0.7 for shape in shapes]
    floors = [rng.choice(np.array(heights), shape) for shape in shapes]
    count = draw(st.integers(0, 4)) if len(shapes) > 1 else 0
    ends = rng.integers(len(shapes), size=(count, 2))
    sizes = np.array([mask.size for mask in masks])
    cells = (rng.random((count, 2)) * sizes[ends]).astype(np.int64)
    links = np.stack([ends[:, 0], cells[:, 0], ends[:, 1], cells[:, 1]], axis=1)
    return masks, floors, links


@given(houses())
def test_islands_are_what_a_walk_reaches(house):
    masks, floors, links = house
    found = number_islands(masks, floors, STEP, links)
    for number, expected in zip(found, walk(masks, floors, links), strict=True):
        np.testing.assert_array_equal(number, expected)
