"""The arrays behind `navbake.tensors`, and the cell of a position in them.

`navbake.navgrid.cells` has the rule for the cell of a position. With numpy, large batches run in
chunks that fit the processor's cache, on several threads. Other libraries run in parallel anyway.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeAlias, TypeVar

import numpy as np

from navbake.errors import QueryError

if TYPE_CHECKING:
    from navbake.runtime.search import Search

Namespace: TypeAlias = Any
"""An array library: numpy, torch, ``jax.numpy`` or another module of the Python array API."""
Array: TypeAlias = Any
"""An array of the library that the tensors were made for."""
DType: TypeAlias = Any
"""A dtype of that library."""
Ids: TypeAlias = Any
"""An integer, or an array of integers. A `scene_id` may be None if there is one scene."""


class LibraryArray(Protocol):
    """What type checkers know of an array of any library: numpy's, PyTorch's, JAX's or another."""

    @property
    def shape(self) -> tuple[int, ...]:
        """The length of each axis."""
        ...

    @property
    def dtype(self) -> object:
        """The type of the numbers."""
        ...


ArrayT = TypeVar("ArrayT", bound=LibraryArray)
"""The type of the caller's arrays: answers are arrays of the library that asks."""
FloatT = TypeVar("FloatT", bound=np.floating)
"""float32 or float64, the type of numpy's positions."""

NUMPY_NAMES = ("numpy", "array_api_compat.numpy")  # names of numpy as a namespace
# the coordinates, ids and masks of this many positions stay in the processor's second cache
POSITIONS_PER_CHUNK = 16_384
MAX_Z = 1e30  # positions this high or higher are invalid [m]


class PaddedShape(NamedTuple):
    """The shape that the cells of all scenes are padded to.

    Attributes:
        scenes: number of scenes.
        levels: the largest number of levels of a scene.
        rows: the largest number of rows of a level.
        cols: the largest number of columns of a level.
    """

    scenes: int
    levels: int
    rows: int
    cols: int


class SceneSearches(tuple["Search", ...]):
    """The search on each scene's grid, as a tuple that JAX treats as a constant.

    Two such tuples always compare as equal. So JAX doesn't compile a function again for tensors
    that differ only in their searches, which no compiled function reads.
    """

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, SceneSearches)

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:
        return hash(SceneSearches)


@dataclass(frozen=True, eq=False, repr=False)
class GridTensors:
    """One or several grids as arrays of one library, on one device; made by `make_tensors`.

    Scenes are padded to the largest numbers of levels, rows and columns. The id of a cell
    is ``((scene * levels + level) * rows + row) * cols + col``, over the padded `shape`; n is the
    number of ids. Arrays "by cell" are indexed by these ids, arrays "by level" by
    ``scene * levels + level``.
    """

    xp: Namespace  # the array library
    dtype: DType  # of positions and of all values in metres: float32 or float64
    index_dtype: DType  # the integer dtype that ids are computed in
    shape: PaddedShape
    num_rooms: int  # the largest number of rooms of a scene
    rooms: tuple[tuple[str, ...], ...]  # ``rooms[scene][r - 1]`` is the id of room number r
    areas: tuple[tuple[str, ...], ...]  # ``areas[scene][a - 1]`` is the name of area number a
    goals: tuple[str, ...]  # the goals as they were given, in the order of their numbers
    searches: SceneSearches  # for `with_goals`
    max_cells_per_metre: float  # of all levels; a number, so that JAX knows the shapes of `ranges`
    x_first: Array  # by level, x of the first column's edge and y of the first row's [m]
    y_first: Array
    cells_per_metre: Array  # by level, cells per metre
    # for each level: the smallest x of `dtype` in each column, then the smallest beyond the last
    x_edge: Array
    # for each level: the largest y of `dtype` in each row, then the largest beyond the last
    y_edge: Array
    # by level: a position is on the level if west <= x < east and south < y <= north
    west: Array
    east: Array
    north: Array
    south: Array
    num_rows: Array  # by level, without padding
    num_cols: Array
    # by cell, the lowest z of a position that is on the cell's floor, or else on the ground [m]
    lowest_z: Array
    # by cell, int32, the rank of the floor's height in the scene; cells without a floor rank lower.
    # Of the cells whose `lowest_z` isn't above a position, it is in the one of the highest rank.
    rank: Array
    # by cell, the highest z at which `is_navigable` holds, -inf where it never does [m]
    highest_z: Array
    floor: Array  # by cell [m], NaN for no floor
    ground: Array  # by level, z of its ground [m]
    room: Array  # by cell, int32, 0 for no room
    area: Array  # by cell, int32, 0 for no area
    island: Array  # by cell, int32, numbered from 1 through all scenes; 0 where it isn't free
    # by cell [m], see `navbake.navgrid.islands.measure_clearance`; 0 where it isn't free
    clearance: Array
    solid: Array  # by cell, bool, whether the cell hides what is behind it, see `ranges`
    cost: Array  # at ``goal * n + cell``, the cost of the cheapest path to the goal
    # at ``goal * n + cell``, int32, the id of the next cell on that path; at the goal it is the
    # cell's own id, without a path -1
    next_cell: Array
    cells_by_island: Array  # the free cells' ids, sorted by `island_key`; int32, shape (m,)
    island_key: Array  # of each of these cells: ``island * (num_rooms + 1) + room``
    cells_by_room: Array  # the free cells' ids, sorted by `room_key`; int32, shape (m,)
    room_key: Array  # of each of these cells: ``scene * (num_rooms + 1) + room``
    targets: tuple[str, ...]  # those of `with_stands` as they were given, in their order
    stand_repeats: int  # how many poses of a target are in one cell at most
    # the p poses from which targets are reached: world x, y and floor z [m], and yaw [rad]
    stand_x: Array
    stand_y: Array
    stand_z: Array
    stand_yaw: Array
    stand_key: Array  # of each pose, int32, ascending: ``target * n + cell``; shape (p,)
    # at ``target * scenes + scene``, the index of the first pose there, and at the end p; int32
    stand_start: Array

    def __repr__(self) -> str:
        targets_text = f", targets={self.targets!r}" if self.targets else ""
        return (
            f"GridTensors(dtype={self.dtype!r}, shape={self.shape!r}, goals={self.goals!r}"
            f"{targets_text})"
        )


STATIC_FIELDS = (
    "xp",
    "dtype",
    "index_dtype",
    "shape",
    "num_rooms",
    "rooms",
    "areas",
    "goals",
    "searches",
    "max_cells_per_metre",
    "targets",
    "stand_repeats",
)


def register_pytree(xp: Namespace) -> None:
    """Register GridTensors as a pytree of JAX, so that JAX can compile functions that take it.

    Does nothing for other libraries.
    """
    if xp.__name__.split(".")[0] != "jax":
        return
    from jax import tree_util  # the caller's library

    array_names = [field.name for field in fields(GridTensors) if field.name not in STATIC_FIELDS]
    with suppress(ValueError):  # registered before
        tree_util.register_dataclass(
            GridTensors, data_fields=array_names, meta_fields=list(STATIC_FIELDS)
        )


def locate_in_scenes(
    tensors: GridTensors, positions: Array, scene_id: Ids
) -> tuple[Array, Array, Array]:
    """Find the cell and the level of each position, in the position's scene.

    Args:
        tensors: the tensors.
        positions: checked world positions, shape (..., 3) [m].
        scene_id: checked scenes, shape (...), -1 for unknown ones; None for a single scene.

    Returns:
        Ids of the cells, 0 for none; numbers of the levels in their scenes, 0 for none; and whether
        each position is in a cell; all of shape (...).
    """
    xp = tensors.xp
    first_level_index = find_first_level(tensors, scene_id)
    x = positions[..., 0]
    y = positions[..., 1]
    z = positions[..., 2]
    if scene_id is not None:
        z = xp.where(scene_id >= 0, z, xp.nan)  # unknown scenes
    best_cell = xp.zeros_like(x, dtype=tensors.index_dtype)
    best_level = best_cell
    if tensors.shape.levels == 1:  # no choice of a level
        cell, is_in_cell = clamp_to_level(tensors, x, y, first_level_index)
        is_in_cell = is_in_cell & (z >= tensors.lowest_z[cell]) & (z < MAX_Z)
        return xp.where(is_in_cell, cell, 0), best_level, is_in_cell
    best_rank = best_cell - 1
    for level_number in range(tensors.shape.levels):
        cell, is_in_cell = clamp_to_level(tensors, x, y, first_level_index + level_number)
        rank = tensors.rank[cell]
        is_better = is_in_cell & (z >= tensors.lowest_z[cell]) & (z < MAX_Z) & (rank > best_rank)
        best_cell = xp.where(is_better, cell, best_cell)
        best_level = xp.where(is_better, level_number, best_level)
        best_rank = xp.where(is_better, rank, best_rank)
    return best_cell, best_level, best_rank >= 0


def clamp_to_level(
    tensors: GridTensors, x: Array, y: Array, level: Array | int
) -> tuple[Array, Array]:
    """Find the cell of each position x, y on a level; positions outside get a cell at its edge.

    Rounding finds the nearest edge between cells. Then an exact comparison tells on which side of
    the edge the position is.

    Args:
        tensors: the tensors.
        x: world x, shape (...) [m].
        y: world y, shape (...) [m].
        level: the level's index among the levels of all scenes, or an index for each position.

    Returns:
        Ids of cells; and whether each position is on the level, and so in this cell; both of shape
        (...).
    """
    xp = tensors.xp
    shape = tensors.shape
    west = tensors.west[level]
    east = tensors.east[level]
    north = tensors.north[level]
    south = tensors.south[level]
    is_in_cols = (x >= west) & (x < east)  # False for NaN
    x = xp.where(is_in_cols, x, west)
    col = xp.astype(
        xp.round((x - tensors.x_first[level]) * tensors.cells_per_metre[level]), tensors.index_dtype
    )
    col = col - xp.astype(x < tensors.x_edge[level * (shape.cols + 1) + col], tensors.index_dtype)
    is_in_rows = (y <= north) & (y > south)
    y = xp.where(is_in_rows, y, north)
    row = xp.astype(
        xp.round((tensors.y_first[level] - y) * tensors.cells_per_metre[level]), tensors.index_dtype
    )
    row = row - xp.astype(y > tensors.y_edge[level * (shape.rows + 1) + row], tensors.index_dtype)
    return (level * shape.rows + row) * shape.cols + col, is_in_cols & is_in_rows


def find_first_level(tensors: GridTensors, scene_id: Ids) -> Array | int:
    """Return the index of each scene's lowest level among the levels of all scenes.

    Args:
        tensors: the tensors.
        scene_id: an integer or integers, -1 for unknown scenes, which count as 0; None for 0.
    """
    if scene_id is None:
        return 0
    return tensors.xp.where(scene_id >= 0, scene_id, 0) * tensors.shape.levels


def to_level_row_col(tensors: GridTensors, cells: Array) -> tuple[Array, Array, Array]:
    """Convert ids of cells to three arrays: level, row and column.

    A level is its index among the levels of all scenes.
    """
    cells_per_level = tensors.shape.rows * tensors.shape.cols
    cell_of_level = cells % cells_per_level
    return (
        cells // cells_per_level,
        cell_of_level // tensors.shape.cols,
        cell_of_level % tensors.shape.cols,
    )


def check_positions(tensors: GridTensors, positions: Array) -> Array:
    """Check world positions, and return them as an array of shape (..., 3).

    Raises:
        QueryError: the shape or the dtype is wrong.
    """
    checked_positions = as_array(tensors, positions)
    if checked_positions.ndim == 0 or checked_positions.shape[-1] != 3:
        raise QueryError(
            f"expected positions of shape (..., 3) [m], got {tuple(checked_positions.shape)}"
        )
    return checked_positions


def as_array(tensors: GridTensors, values: Array) -> Array:
    """Convert numbers to an array of the tensors' dtype.

    Arrays of other dtypes are refused, as rounding might move a position into another cell.

    Raises:
        QueryError: it is an array of another dtype, or holds no numbers.
    """
    if isinstance(values, int | float | Sequence):
        return _make_array(tensors, values, tensors.dtype)
    dtype = getattr(values, "dtype", "no numbers")
    if dtype != tensors.dtype:
        array_text = f"{type(values).__name__} of {dtype}"
        hint = "convert it, or make the tensors with that dtype"
        raise QueryError(
            f"expected an array of {tensors.dtype}, as the tensors are, got {array_text}: {hint}"
        )
    return values


def check_scenes(tensors: GridTensors, scene_id: Ids, shape: tuple[int, ...]) -> Array:
    """Check the scene of each position, and broadcast scene numbers to a shape.

    Args:
        tensors: the tensors.
        scene_id: an integer or integers; None only for tensors of one scene.
        shape: the shape of the positions, without the last axis.

    Returns:
        Integers of this shape, -1 for unknown scenes; None for tensors of one scene, unless
        `scene_id` is an array.

    Raises:
        QueryError: there are several scenes and none is given, or they don't fit the shape.
    """
    if scene_id is None:
        if tensors.shape.scenes > 1:
            raise QueryError(
                f"expected a scene_id, 0 to {tensors.shape.scenes - 1}: there are several"
            )
        return None
    if isinstance(scene_id, int | np.integer):
        scene_id = check_number(scene_id, "scene", tensors.shape.scenes)
        if tensors.shape.scenes == 1:
            return None
    return check_numbers(tensors, scene_id, "scene", tensors.shape.scenes, shape)


def check_number(number: int | np.integer, label: str, count: int) -> int:
    """Check that the number of a scene or goal is in its range, and return it.

    Args:
        number: the number.
        label: a word for the numbered things, such as ``goal``, for errors.
        count: how many such things there are.

    Raises:
        QueryError: it is not from 0 to count - 1.
    """
    if not 0 <= number < count:
        raise QueryError(f"no {label} {number}: expected 0 to {count - 1}")
    return int(number)


def check_numbers(
    tensors: GridTensors, numbers: Ids, label: str, count: int, shape: tuple[int, ...]
) -> Array:
    """Check numbers of scenes, goals or rooms, and broadcast them to a shape.

    Args:
        tensors: the tensors.
        numbers: an integer or integers.
        label: a word for the numbered things, for errors.
        count: how many such things there are.
        shape: the shape of the result.

    Returns:
        Integers, -1 in place of any that is not from 0 to count - 1: traced arrays can't raise.

    Raises:
        QueryError: they are no integers, or don't fit the shape.
    """
    if isinstance(numbers, str):
        hint = ""
        if label == "room":
            hint = f": write t.rooms[scene].index({numbers!r}) + 1"
        raise QueryError(f"expected an integer or integers as {label}, got {numbers!r}{hint}")
    if isinstance(numbers, int | Sequence | np.ndarray | np.integer):
        numbers = _make_array(tensors, numbers, None)
    if not hasattr(numbers, "dtype") or not tensors.xp.isdtype(numbers.dtype, "integral"):
        value_type = getattr(numbers, "dtype", type(numbers).__name__)
        raise QueryError(f"expected an integer or integers as {label}, got {value_type}")
    numbers = tensors.xp.astype(numbers, tensors.index_dtype)
    numbers = tensors.xp.where((numbers >= 0) & (numbers < count), numbers, -1)
    return broadcast(tensors, numbers, shape, label)


def broadcast(tensors: GridTensors, values: Array, shape: tuple[int, ...], label: str) -> Array:
    """Broadcast values to a shape.

    Args:
        tensors: the tensors.
        values: the values.
        shape: the shape of the result.
        label: a word for the values, for errors.

    Raises:
        QueryError: the values can't be broadcast to the shape.
    """
    try:
        return tensors.xp.broadcast_to(values, shape)
    except (ValueError, RuntimeError, TypeError) as error:
        expected = f"expected a {label} that fits the shape {tuple(shape)}"
        raise QueryError(f"{expected}, got one of shape {tuple(values.shape)}") from error


def device_of(tensors: GridTensors) -> object:
    """Return the arrays' device; None inside functions that JAX traces, for the default one."""
    return getattr(tensors.floor, "device", None)


def _make_array(tensors: GridTensors, values: Array, dtype: DType) -> Array:
    """Make an array on the tensors' device of numbers of Python or numpy."""
    try:
        return tensors.xp.asarray(values, dtype=dtype, device=device_of(tensors))
    except (ValueError, TypeError, RuntimeError) as error:
        raise QueryError(f"expected numbers, got {values!r:.60}") from error


def clip(xp: Namespace, values: Array, low: Array | float, high: Array | float) -> Array:
    """Clip values to the range from low to high; NaN stays NaN."""
    return xp.where(values < low, low, xp.where(values > high, high, values))


def apply_in_chunks(
    tensors: GridTensors,
    function: Callable[..., Array],
    positions: Array,
    *other_arguments: Array | int | None,
) -> Array:
    """Apply a function to positions, in chunks on several threads where that is faster.

    Args:
        tensors: the tensors.
        function: takes positions and the other arguments; returns an array with an entry for each
            position.
        positions: shape (..., 3) [m].
        other_arguments: arrays with an entry for each position, which are cut like the positions;
            or numbers or None, which are passed as they are.

    Returns:
        The results of the function for all positions, shape (...).
    """
    shape = tuple(positions.shape[:-1])
    num_positions = math.prod(shape)
    if tensors.xp.__name__ not in NUMPY_NAMES or num_positions < 2 * POSITIONS_PER_CHUNK:
        return function(positions, *other_arguments)
    from navbake.threads import run_in_chunks  # saves numba for small batches

    def flatten(argument: Array | int | None) -> Array | int | None:
        if argument is None or isinstance(argument, int):
            return argument
        return np.reshape(argument, (num_positions, *argument.shape[len(shape) :]))

    arguments = [flatten(argument) for argument in (positions, *other_arguments)]
    results: dict[int, Array] = {}  # by the first position of each chunk

    def fill_results(first_position: int, stop_position: int) -> None:
        for chunk_start in range(first_position, stop_position, POSITIONS_PER_CHUNK):
            chunk_slice = slice(chunk_start, min(chunk_start + POSITIONS_PER_CHUNK, stop_position))
            results[chunk_start] = function(
                *(
                    argument[chunk_slice] if isinstance(argument, np.ndarray) else argument
                    for argument in arguments
                )
            )

    run_in_chunks(fill_results, num_positions, min_chunk_size=POSITIONS_PER_CHUNK)
    values = np.concatenate([results[chunk_start] for chunk_start in sorted(results)])
    return values.reshape(*shape, *values.shape[1:])
