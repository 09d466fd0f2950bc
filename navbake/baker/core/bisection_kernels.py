"""Bisection in the heights of a column, for kernels.

A column of a tower has thousands of heights, of which a step of the work needs those near a floor.
"""

from navbake.compiled import NO_REFCOUNT, subkernel


@subkernel(**NO_REFCOUNT)
def find_first_above(heights, begin, end, limit):
    """Return the index of the first height above a limit, in a range of ascending heights.

    Args:
        heights: heights, or other numbers, ascending in the range.
        begin: index of the first height of the range.
        end: index past the last one.
        limit: the limit.

    Returns:
        The index; `end` if no height of the range is above the limit.
    """
    while begin < end:
        middle = (begin + end) // 2
        if heights[middle] > limit:
            end = middle
        else:
            begin = middle + 1
    return begin


@subkernel(**NO_REFCOUNT)
def find_first_at_or_above(heights, begin, end, limit):
    """Return the index of the first height at or above a limit, in a range of ascending heights.

    Args:
        heights: heights, or other numbers, ascending in the range.
        begin: index of the first height of the range.
        end: index past the last one.
        limit: the limit.

    Returns:
        The index; `end` if all heights of the range are below the limit.
    """
    while begin < end:
        middle = (begin + end) // 2
        if heights[middle] >= limit:
            end = middle
        else:
            begin = middle + 1
    return begin
