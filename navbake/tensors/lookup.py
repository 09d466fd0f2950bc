"""Which cell a position is in: the rule of `navbake.navgrid.cells`, for arrays of any library.

numpy answers large batches in pieces that fit the processor's cache, on several threads. The other
libraries run whole expressions on threads or devices of their own.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from navbake.errors import QueryError
from navbake.tensors.grid_tensors import Array, GridTensors

NUMPY = ("numpy", "array_api_compat.numpy")
PIECE = 16_384  # positions: their coordinates, ids and masks stay in the second cache
FAR = 1e30  # metres; what lies higher is no position


def locate(
    t: GridTensors, positions: Array, scene_id: Array | int | None
) -> tuple[Array, Array, Array]:
    """Find the cells of checked positions, shape (..., 3), on the nearest floor below each.

    Ids of cells and levels, 0 where there is none, and whether there is one; shape (...).
    """
    xp, shape = t.xp, t.shape
    x, y, z = positions[..., 0], positions[..., 1], positions[..., 2]
    first = first_level(t, scene_id)
    if scene_id is not None:
        z = xp.where(scene_id >= 0, z, xp.nan)  # in no scene, so nowhere
    cell, inside = on_level(t, x, y, first)
    if t.one_ground:
        inside = inside & (z >= t.reach[cell]) & (z < FAR)
        return xp.where(inside, cell, 0), xp.zeros_like(cell), inside
    best, level = xp.zeros_like(cell), xp.zeros_like(cell)
    highest = xp.full_like(cell, -1)  # the rank of the best floor
    for k in range(shape.levels):
        if k and t.same_lattice:
            cell = cell + shape.rows * shape.cols
        elif k:
            cell, inside = on_level(t, x, y, first + k)
        rank = t.rank[cell]
        better = inside & (z >= t.reach[cell]) & (z < FAR) & (rank > highest)
        best = xp.where(better, cell, best)
        level = xp.where(better, k, level)
        highest = xp.where(better, rank, highest)
    return best, level, highest >= 0


def on_level(t: GridTensors, x: Array, y: Array, first: Array | int) -> tuple[Array, Array]:
    """The cells at x, y of one level, clamped to valid ids, and whether they are there.

    `first` is the number of the level among those of all scenes, shape (...) or one for all. The
    nearest edge is found by rounding, which half a cell of error can't mislead; on which side of
    that edge a position is, is decided exactly.
    """
    xp, shape = t.xp, t.shape
    west, east, north, south = t.west[first], t.east[first], t.north[first], t.south[first]
    in_cols = (x >= west) & (x < east)  # False for NaN
    x = xp.where(in_cols, x, west)
    col = xp.astype(xp.round((x - t.x_first[first]) * t.scale[first]), t.index)
    col = col - xp.astype(x < t.x_edge[first * (shape.cols + 1) + col], t.index)
    in_rows = (y <= north) & (y > south)
    y = xp.where(in_rows, y, north)
    row = xp.astype(xp.round((t.y_first[first] - y) * t.scale[first]), t.index)
    row = row - xp.astype(y > t.y_edge[first * (shape.rows + 1) + row], t.index)
    return (first * shape.rows + row) * shape.cols + col, in_cols & in_rows


def first_level(t: GridTensors, scene_id: Array | int | None) -> Array | int:
    """The number of the first level of each scene, among those of all scenes."""
    if scene_id is None:
        return 0
    return t.xp.where(scene_id >= 0, scene_id, 0) * t.shape.levels


def split(t: GridTensors, cell: Array) -> tuple[Array, Array, Array]:
    """Level among those of all scenes, row and column of cells."""
    level, rest = cell // (t.shape.rows * t.shape.cols), cell % (t.shape.rows * t.shape.cols)
    return level, rest // t.shape.cols, rest % t.shape.cols


def check_positions(t: GridTensors, positions: Array) -> Array:
    """Check the shape and dtype of world positions, (..., 3)."""
    given = as_array(t, positions)
    if given.ndim == 0 or given.shape[-1] != 3:
        raise QueryError(f"expected positions of shape (..., 3) [m], got {tuple(given.shape)}")
    return given


def as_array(t: GridTensors, values: Array) -> Array:
    """Numbers as an array of the tensors' dtype; an array of another dtype is refused.

    A position that is rounded to another dtype may be in another cell.
    """
    if isinstance(values, int | float | Sequence):
        return _new_array(t, values, t.dtype)
    if getattr(values, "dtype", None) != t.dtype:
        kind = getattr(values, "dtype", "no numbers")
        raise QueryError(
            f"expected an array of {t.dtype}, as the tensors are, got {type(values).__name__} of "
            f"{kind}: convert it, or make the tensors with that dtype"
        )
    return values


def check_scenes(t: GridTensors, scene_id: Array | int | None, shape: tuple[int, ...]) -> Array:
    """The scenes of positions of a shape (...), -1 for unknown ones; None where there is one."""
    if scene_id is None:
        if t.shape.scenes > 1:
            raise QueryError(f"expected a scene_id, 0 to {t.shape.scenes - 1}: there are several")
        return None
    if isinstance(scene_id, int | np.integer):
        scene_id = check_number(scene_id, "scene", t.shape.scenes)
        if t.shape.scenes == 1:
            return None
    return check_numbers(t, scene_id, "scene", t.shape.scenes, shape)


def check_number(given: int | np.integer, what: str, count: int) -> int:
    """Check the number of a scene or goal: 0 to count - 1."""
    if not 0 <= given < count:
        raise QueryError(f"no {what} {given}: expected 0 to {count - 1}")
    return int(given)


def check_numbers(
    t: GridTensors, given: Array | int, what: str, count: int, shape: tuple[int, ...]
) -> Array:
    """Numbers, 0 to count - 1, of scenes, goals or rooms as an array of a shape; -1 for others.

    They can't be refused: no code may look at the numbers of an array, as it may be traced.
    """
    if isinstance(given, int | Sequence | np.ndarray | np.integer):
        given = _new_array(t, given, None)
    if not hasattr(given, "dtype") or not t.xp.isdtype(given.dtype, "integral"):
        kind = getattr(given, "dtype", type(given).__name__)
        raise QueryError(f"expected an integer or integers as {what}, got {kind}")
    numbers = t.xp.astype(given, t.index)
    numbers = t.xp.where((numbers >= 0) & (numbers < count), numbers, -1)
    return broadcast(t, numbers, shape, what)


def broadcast(t: GridTensors, values: Array, shape: tuple[int, ...], what: str) -> Array:
    """Values in a shape that they fit."""
    try:
        return t.xp.broadcast_to(values, shape)
    except (ValueError, RuntimeError, TypeError) as error:
        raise QueryError(
            f"expected a {what} that fits the shape {tuple(shape)}, got one of shape "
            f"{tuple(values.shape)}"
        ) from error


def device_of(t: GridTensors) -> Array:
    """Where the arrays are; None for the default, as in what JAX compiles."""
    return getattr(t.floor, "device", None)


def _new_array(t: GridTensors, values: Array, dtype: Array) -> Array:
    """Python's or numpy's numbers as an array on the tensors' device."""
    try:
        return t.xp.asarray(values, dtype=dtype, device=device_of(t))
    except (ValueError, TypeError, RuntimeError) as error:
        raise QueryError(f"expected numbers, got {values!r:.60}") from error


def bounded(xp: Array, values: Array, low: Array | float, high: Array | float) -> Array:
    """Values cut off at a lowest and a highest; NaN stays."""
    return xp.where(values < low, low, xp.where(values > high, high, values))


def answer_all(
    t: GridTensors, answer: Callable[..., Array], positions: Array, *further: Array | int | None
) -> Array:
    """Answer a question about positions of any shape (..., 3), in pieces where that is quicker.

    `answer` takes positions of shape (m, 3) and the others of shape (m,), or all as they are given
    here, and gives an array of shape (m, ...). Further arguments of shape (...), None or an
    integer; the latter stay as they are.
    """
    shape = tuple(positions.shape[:-1])
    count = math.prod(shape)
    if t.xp.__name__ not in NUMPY or count < 2 * PIECE:
        return answer(positions, *further)
    from navbake.threads import run_in_bands  # saves numba where batches are small

    whole = [
        a if a is None or isinstance(a, int) else np.reshape(a, (count, *a.shape[len(shape) :]))
        for a in (positions, *further)
    ]

    def piece(first: int, last: int) -> Array:
        return answer(*(a[first:last] if isinstance(a, np.ndarray) else a for a in whole))

    start = piece(0, PIECE)
    found = np.empty((count, *start.shape[1:]), dtype=start.dtype)
    found[:PIECE] = start

    def fill(first: int, last: int) -> None:
        for begin in range(PIECE + first, PIECE + last, PIECE):
            end = min(begin + PIECE, PIECE + last)
            found[begin:end] = piece(begin, end)

    run_in_bands(fill, count - PIECE, least=PIECE)
    return found.reshape(*shape, *found.shape[1:])
