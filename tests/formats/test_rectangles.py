"""Rectangles that cover cells: each cell once, none beside them, few."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from navbake.formats.rectangles import cover_by_rectangles

LABELS = arrays(
    np.int32, st.tuples(st.integers(1, 12), st.integers(1, 12)), elements=st.integers(0, 3)
)


def drawn(shape, rectangles):
    """How often each cell is covered, and the label that covers it."""
    times, labels = np.zeros(shape, int), np.zeros(shape, int)
    for (row, col, end_row, end_col), label in zip(*rectangles, strict=True):
        times[row:end_row, col:end_col] += 1
        labels[row:end_row, col:end_col] = label
    return times, labels


@settings(deadline=None)  # the first call compiles
@given(LABELS)
def test_each_cell_with_a_label_lies_in_one_rectangle_of_its_label(labels):
    times, covered = drawn(labels.shape, cover_by_rectangles(labels))
    np.testing.assert_array_equal(times, labels != 0)
    np.testing.assert_array_equal(covered, labels)


def slow_cover(labels):
    """The same rule, cell by cell."""
    left, found = labels != 0, []
    for row, col in np.argwhere(left):
        if not left[row, col]:
            continue
        same = left & (labels == labels[row, col])
        sizes = {}
        for end_row in range(row + 1, labels.shape[0] + 1):
            for end_col in range(col + 1, labels.shape[1] + 1):
                if same[row:end_row, col:end_col].all():
                    sizes[(end_row, end_col)] = (end_row - row) * (end_col - col)
        end_row, end_col = min(sizes, key=lambda end: (-sizes[end], end[0]))
        left[row:end_row, col:end_col] = False
        found.append((row, col, end_row, end_col))
    return found


@settings(deadline=None)  # the first call compiles
@given(LABELS)
def test_the_largest_from_each_corner_is_taken(labels):
    np.testing.assert_array_equal(
        cover_by_rectangles(labels).bounds, np.reshape(slow_cover(labels), (-1, 4))
    )


@pytest.mark.parametrize("dtype", [bool, np.uint8, np.uint16, np.int64])
def test_takes_masks_and_labels_of_any_width(dtype):
    cells = np.array([[1, 1, 0], [1, 1, 1]], dtype)
    rectangles = cover_by_rectangles(cells)
    assert rectangles.bounds.tolist() == [[0, 0, 2, 2], [1, 2, 2, 3]]
    assert rectangles.labels.dtype == dtype and rectangles.labels.all()
    assert len(cover_by_rectangles(np.zeros((3, 0), dtype)).bounds) == 0


def test_a_floor_plan_takes_few():
    """100 rooms of 10 × 10 cells with a door each: walls and floors."""
    plan = np.zeros((121, 121), int)
    for k in range(10):
        for m in range(10):
            plan[1 + 12 * k : 12 + 12 * k, 1 + 12 * m : 12 + 12 * m] = 1
            plan[5 + 12 * k : 8 + 12 * k, 12 + 12 * m] = m < 9
    assert len(cover_by_rectangles(plan == 1).bounds) <= 190
    assert len(cover_by_rectangles(plan == 0).bounds) <= 250
