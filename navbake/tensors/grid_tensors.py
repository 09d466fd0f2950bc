"""The arrays behind `navbake.tensors`, and the cell of a position in them.

The rule is that of `navbake.navgrid.cells`. For numpy, large batches run in pieces that fit the
processor's cache, on several threads; other libraries parallelize whole expressions themselves.
"""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from navbake.errors import QueryError

Array: TypeAlias = Any
"""An array of whatever library the tensors were made for."""
Ids: TypeAlias = Any
"""An integer, or integers as an array; as `scene_id` None where there is one scene."""

NUMPY = ("numpy", "array_api_compat.numpy")
PIECE = 16_384  # positions: their coordinates, ids and masks stay in the second cache
FAR = 1e30  # [m]; higher positions are invalid


class Shape(NamedTuple):
    """Padded numbers of scenes, levels, rows and columns."""

    scenes: int
    levels: int
    rows: int
    cols: int


@dataclass(frozen=True, eq=False, repr=False)
class GridTensors:
    """One or several grids as arrays of one library, on one device; made by `make_tensors`.

    Scenes are padded to the largest numbers of levels, rows and columns. The id of a cell
    is ``((scene * levels + level) * rows + row) * cols + col``, over the padded `shape`; n is the
    number of ids. Arrays "by level" are indexed by ``scene * levels + level``.
    """

    xp: Any  # the array library's namespace
    dtype: Any  # of positions and of all values in metres: float32 or float64 of the library
    index: Any  # the integer dtype that ids are computed in
    shape: Shape  # padded
    num_rooms: int  # the most rooms of a scene
    rooms: tuple[tuple[str, ...], ...]  # number r of `room` is ``rooms[scene][r - 1]``
    areas: tuple[tuple[str, ...], ...]  # likewise of `area`
    goals: tuple[str, ...]  # the given goals by number
    x_first: Array  # by level, x of the first column's edge and y of the first row's [m]
    y_first: Array
    scale: Array  # by level, cells per metre
    x_edge: Array  # the smallest number of `dtype` in each column or beyond it, cols + 1 a level
    y_edge: Array  # the largest number of `dtype` in each row or beyond it, rows + 1 a level
    # by level: x from west to below east and y from north to above south are on it
    west: Array
    east: Array
    north: Array
    south: Array
    num_rows: Array  # by level, without padding
    num_cols: Array
    # by cell, the lowest z [m] from which its floor, or else the ground, is at most a step above
    reach: Array
    # by cell, int32, the rank of its floor among a scene's, grounds below all floors: the highest
    # reachable floor is a position's
    rank: Array
    top: Array  # by cell, the highest z [m] at which `is_navigable` holds; -inf where it never does
    floor: Array  # by cell [m], NaN for no floor
    ground: Array  # by level, z of its ground [m]
    room: Array  # by cell, int32, 0 for no room
    area: Array  # by cell, int32, 0 for no area
    island: Array  # by cell, int32, numbered from 1 through all scenes; 0 where it isn't free
    clearance: Array  # by cell [m], see `navbake.navgrid.islands.clearance`; 0 where it isn't free
    cost: Array  # at ``goal * n + cell``, the cost of the cheapest path to the goal
    # likewise, int32, the id of that path's next cell; itself at the goal, -1 for no path
    onward: Array
    by_island: Array  # the free cells' ids, sorted by `island_key`; int32, shape (m,)
    island_key: Array  # of each of them ``island * (num_rooms + 1) + room``
    by_room: Array  # the free cells' ids, sorted by `room_key`; int32, shape (m,)
    room_key: Array  # of each of them ``scene * (num_rooms + 1) + room``

    def __repr__(self) -> str:
        return f"GridTensors(dtype={self.dtype!r}, shape={self.shape!r}, goals={self.goals!r})"


STATIC = ("xp", "dtype", "index", "shape", "num_rooms", "rooms", "areas", "goals")


def register_pytree(xp: Any) -> None:
    """Register GridTensors as a pytree, so that JAX traces functions of it."""
    if xp.__name__.split(".")[0] != "jax":
        return
    from jax import tree_util  # the caller's library

    arrays = [f.name for f in fields(GridTensors) if f.name not in STATIC]
    with suppress(ValueError):  # registered before
        tree_util.register_dataclass(GridTensors, data_fields=arrays, meta_fields=list(STATIC))


def locate(t: GridTensors, positions: Array, scene_id: Ids) -> tuple[Array, Array, Array]:
    """Ids of the cells and levels of checked positions, 0 for none, and whether there is one."""
    xp = t.xp
    first = first_level(t, scene_id)
    x = positions[..., 0]
    y = positions[..., 1]
    z = positions[..., 2]
    if scene_id is not None:
        z = xp.where(scene_id >= 0, z, xp.nan)  # unknown scenes
    best = level = xp.zeros_like(x, dtype=t.index)
    if t.shape.levels == 1:  # no choice of a level
        cell, inside = on_level(t, x, y, first)
        inside = inside & (z >= t.reach[cell]) & (z < FAR)
        return xp.where(inside, cell, 0), level, inside
    highest = best - 1  # the rank of the best floor
    for k in range(t.shape.levels):
        cell, inside = on_level(t, x, y, first + k)
        rank = t.rank[cell]
        better = inside & (z >= t.reach[cell]) & (z < FAR) & (rank > highest)
        best = xp.where(better, cell, best)
        level = xp.where(better, k, level)
        highest = xp.where(better, rank, highest)
    return best, level, highest >= 0


def on_level(t: GridTensors, x: Array, y: Array, first: Array | int) -> tuple[Array, Array]:
    """Clamped, always valid cell ids of x, y on one level, and whether they are inside.

    `first` is the level's number among those of all scenes. Rounding finds the nearest edge, and an
    exact comparison the position's side of it.
    """
    xp = t.xp
    shape = t.shape
    west = t.west[first]
    east = t.east[first]
    north = t.north[first]
    south = t.south[first]
    in_cols = (x >= west) & (x < east)  # False for NaN
    x = xp.where(in_cols, x, west)
    col = xp.astype(xp.round((x - t.x_first[first]) * t.scale[first]), t.index)
    col = col - xp.astype(x < t.x_edge[first * (shape.cols + 1) + col], t.index)
    in_rows = (y <= north) & (y > south)
    y = xp.where(in_rows, y, north)
    row = xp.astype(xp.round((t.y_first[first] - y) * t.scale[first]), t.index)
    row = row - xp.astype(y > t.y_edge[first * (shape.rows + 1) + row], t.index)
    return (first * shape.rows + row) * shape.cols + col, in_cols & in_rows


def first_level(t: GridTensors, scene_id: Ids) -> Array | int:
    """The number of each scene's first level among those of all scenes."""
    return 0 if scene_id is None else t.xp.where(scene_id >= 0, scene_id, 0) * t.shape.levels


def split(t: GridTensors, cell: Array) -> tuple[Array, Array, Array]:
    """Level among those of all scenes, row and column of cells."""
    level = cell // (t.shape.rows * t.shape.cols)
    rest = cell % (t.shape.rows * t.shape.cols)
    return level, rest // t.shape.cols, rest % t.shape.cols


def check_positions(t: GridTensors, positions: Array) -> Array:
    """Check the shape and dtype of world positions, (..., 3)."""
    given = as_array(t, positions)
    if given.ndim == 0 or given.shape[-1] != 3:
        raise QueryError(f"expected positions of shape (..., 3) [m], got {tuple(given.shape)}")
    return given


def as_array(t: GridTensors, values: Array) -> Array:
    """Numbers as an array of the tensors' dtype; other dtypes might round to another cell."""
    if isinstance(values, int | float | Sequence):
        return _new_array(t, values, t.dtype)
    if (kind := getattr(values, "dtype", "no numbers")) != t.dtype:
        found = f"{type(values).__name__} of {kind}"
        hint = "convert it, or make the tensors with that dtype"
        raise QueryError(f"expected an array of {t.dtype}, as the tensors are, got {found}: {hint}")
    return values


def check_scenes(t: GridTensors, scene_id: Ids, shape: tuple[int, ...]) -> Array:
    """Scenes in a shape (...), -1 for unknown ones; None for tensors of one scene."""
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
    t: GridTensors, given: Ids, what: str, count: int, shape: tuple[int, ...]
) -> Array:
    """`given` as integers in a shape, -1 in place of any that is not from 0 to count - 1.

    Traced arrays can't raise for these. Raises a QueryError for what are no integers, or does not
    fit the shape.
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
    """Values broadcast to a shape; a QueryError if they don't fit."""
    try:
        return t.xp.broadcast_to(values, shape)
    except (ValueError, RuntimeError, TypeError) as error:
        wanted = f"expected a {what} that fits the shape {tuple(shape)}"
        raise QueryError(f"{wanted}, got one of shape {tuple(values.shape)}") from error


def device_of(t: GridTensors) -> Array:
    """The arrays' device; None for the default, as inside JAX's traced functions."""
    return getattr(t.floor, "device", None)


def _new_array(t: GridTensors, values: Array, dtype: Array) -> Array:
    """Numbers of Python or numpy as an array on the tensors' device."""
    try:
        return t.xp.asarray(values, dtype=dtype, device=device_of(t))
    except (ValueError, TypeError, RuntimeError) as error:
        raise QueryError(f"expected numbers, got {values!r:.60}") from error


def bounded(xp: Array, values: Array, low: Array | float, high: Array | float) -> Array:
    """Values clipped to a range; NaN stays."""
    return xp.where(values < low, low, xp.where(values > high, high, values))


def answer_all(
    t: GridTensors, answer: Callable[..., Array], positions: Array, *further: Array | int | None
) -> Array:
    """Apply a function to positions of any shape (..., 3), in pieces where that is faster."""
    shape = tuple(positions.shape[:-1])
    count = math.prod(shape)
    if t.xp.__name__ not in NUMPY or count < 2 * PIECE:
        return answer(positions, *further)
    from navbake.threads import run_in_chunks  # saves numba for small batches

    whole = [
        a if a is None or isinstance(a, int) else np.reshape(a, (count, *a.shape[len(shape) :]))
        for a in (positions, *further)
    ]
    parts: dict[int, Array] = {}

    def fill(first: int, last: int) -> None:
        for begin in range(first, last, PIECE):
            piece = slice(begin, min(begin + PIECE, last))
            parts[begin] = answer(*(a[piece] if isinstance(a, np.ndarray) else a for a in whole))

    run_in_chunks(fill, count, least=PIECE)
    found = np.concatenate([parts[begin] for begin in sorted(parts)])
    return found.reshape(*shape, *found.shape[1:])
