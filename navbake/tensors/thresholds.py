"""Numbers at which an answer changes, exact to the last bit of the positions' dtype.

The run time finds a position's cell in float64: ``floor((x - x_min) / cell_size)``. In float32 the
same formula gives another cell near an edge. So for each edge the smallest number is searched, of
the dtype that positions have, for which the formula in float64 gives the next cell. One comparison
with that number then decides as float64 does. Floors and drops are treated alike.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from navbake.types import Bool, Float


def smallest_true(
    holds: Callable[[Float], Bool], low: Float, high: Float, dtype: np.dtype[np.floating]
) -> NDArray[np.floating]:
    """Find, of each element, the smallest number for which a condition holds; by bisection.

    The condition is monotone: false up to some number, true from there on. Floats of one dtype are
    ordered as the integers that their bits make are, so the bisection runs over those integers and
    ends after at most 64 steps, whatever the scale.

    Args:
        holds: the condition for float64 numbers, shape (n,) to (n,).
        low: numbers for which it is false, shape (n,), float64.
        high: numbers for which it is true.
        dtype: float32 or float64; the numbers tried are of that dtype.
    """
    false, true = _to_order(low.astype(dtype)), _to_order(high.astype(dtype))
    assert not holds(_from_order(false, dtype)).any() and holds(_from_order(true, dtype)).all()
    while True:
        middle = (false & true) + ((false ^ true) >> 1)  # the mean, which can't overflow
        is_open = middle > false
        if not is_open.any():
            return _from_order(true, dtype).astype(dtype)
        found = holds(_from_order(middle, dtype))
        true = np.where(is_open & found, middle, true)
        false = np.where(is_open & ~found, middle, false)


def first_in_cell(
    least: float, cell_size: float, count: int, dtype: np.dtype[np.floating]
) -> NDArray[np.floating]:
    """The smallest x of `dtype` in each of some columns, and beyond the last; (count + 1,)."""
    edge = np.arange(count + 1, dtype=np.float64)

    def holds(x: Float) -> Bool:
        return np.asarray(np.floor((x - least) / cell_size) >= edge)

    middle = least + edge * cell_size
    return smallest_true(holds, middle - cell_size / 2, middle + cell_size / 2, dtype)


def last_in_cell(
    most: float, cell_size: float, count: int, dtype: np.dtype[np.floating]
) -> NDArray[np.floating]:
    """The largest y of `dtype` in each of some rows, and beyond the last; (count + 1,)."""
    # (most - y) is (-y - -most) to the last bit
    return -first_in_cell(-most, cell_size, count, dtype)


def lowest_reaching(
    floors: Float, max_step: float, dtype: np.dtype[np.floating]
) -> NDArray[np.floating]:
    """The lowest z of `dtype` from which floors are at most a step above, by floor [m]."""

    def holds(z: Float, floor: Float) -> Bool:
        return np.asarray(floor <= z + max_step)

    return _by_floor(floors, lambda floor: floor - max_step, holds, dtype)


def highest_standing(
    floors: Float, max_drop: float, dtype: np.dtype[np.floating]
) -> NDArray[np.floating]:
    """The highest z of `dtype` that is at most `max_drop` above floors, by floor [m]."""

    def holds(down: Float, floor: Float) -> Bool:
        return np.asarray(-down - floor <= max_drop)

    return -_by_floor(floors, lambda floor: -floor - max_drop, holds, dtype)


def _by_floor(
    floors: Float,
    exact: Callable[[Float], Float],
    holds: Callable[[Float, Float], Bool],
    dtype: np.dtype[np.floating],
) -> NDArray[np.floating]:
    """`smallest_true` of a condition that depends on the floor; each height is looked at once.

    Args:
        floors: heights, of any shape [m].
        exact: where exact arithmetic has the thresholds, by floor [m].
        holds: the condition, for numbers and their floors.
        dtype: see `smallest_true`.
    """
    some, where = np.unique(floors, return_inverse=True)
    middle = exact(some)
    # farther from there than rounding can move a threshold
    reach = 1e-9 + 16 * float(np.finfo(dtype).eps) * (np.abs(some) + np.abs(middle))
    found = smallest_true(lambda v: holds(v, some), middle - reach, middle + reach, dtype)
    return found[where.reshape(floors.shape)]


def _to_order(values: NDArray[np.floating]) -> NDArray[np.int64]:
    """Integers in the order of the numbers."""
    bits = values.view(np.int32 if values.dtype == np.float32 else np.int64).astype(np.int64)
    return np.where(bits < 0, _lowest(values.dtype) - bits, bits)


def _from_order(order: NDArray[np.int64], dtype: np.dtype[np.floating]) -> Float:
    """The numbers that integers of `_to_order` stand for, as float64."""
    bits = np.where(order < 0, _lowest(dtype) - order, order)
    as_int = np.int32 if dtype == np.float32 else np.int64
    return bits.astype(as_int).view(dtype).astype(np.float64)


def _lowest(dtype: np.dtype[np.floating]) -> int:
    return int(np.iinfo(np.int32 if dtype == np.float32 else np.int64).min)
