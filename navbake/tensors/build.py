"""Makes `GridTensors` of grids, for whatever array library the caller hands over."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navbake.errors import MissingDependencyError, QueryError
from navbake.navgrid.islands import clearance
from navbake.runtime.flat_grid import check_distance
from navbake.runtime.paths import find_field
from navbake.runtime.places import MAX_DROP
from navbake.runtime.search import Search
from navbake.tensors.grid_tensors import GridTensors, Shape, register_pytree
from navbake.types import Bool, Float

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.runtime.flat_grid import FlatGrid
    from navbake.runtime.paths import Goal

Floating = np.dtype[np.floating]
FINEST = 8  # how many numbers of the dtype a cell is wide, at least


def make_tensors(
    grids: NavGrid | Sequence[NavGrid],
    xp: Any = np,
    *,
    device: Any = None,
    dtype: str | None = None,
    goals: Sequence[Goal] | Sequence[Sequence[Goal]] = (),
    max_drop: float = MAX_DROP,
    cut_corners: bool = False,
) -> GridTensors:
    """Turn one or several grids into arrays of one library, on one device.

    Later changes of a grid, blocks included, aren't seen: make new tensors then.

    Args:
        grids: one grid; or several, which functions tell apart by `scene_id`, their place in the
            sequence.
        xp: ``numpy``, ``torch``, ``jax.numpy`` or another module that follows the Python array
            API.
        device: where the arrays shall be, as the library names it; its default unless given.
        dtype: ``"float32"`` or ``"float64"``: of positions and of all values in metres. Unless
            given, what the library makes of a Python float.
        goals: of one grid, goals as `PathFinder.find_path` takes them; of several, such a
            sequence for each, all equally long. `distance_to_goal` and `path_step` know them by
            their places.
        max_drop: how far above the floor `is_navigable` lets a position be [m], >= 0.
        cut_corners: as `PathFinder` has it.

    Raises:
        QueryError: a goal is unknown or can't be stood on, the grids have different numbers of
            goals, there is no such device or dtype, or float32 can't tell neighbouring cells
            apart so far from the origin.
        MissingDependencyError: array-api-compat is not installed.
    """
    is_one = hasattr(grids, "levels")
    several: list[Any] = [grids] if is_one else _check_grids(grids)
    per_grid: list[Any] = [goals] if is_one else list(goals) or [()] * len(several)
    if len(per_grid) != len(several) or len({len(g) for g in per_grid}) != 1:
        raise QueryError(
            f"expected as many goals for each of {len(several)} grids, got "
            f"{[len(g) for g in per_grid]}"
        )
    check_distance(max_drop, "max_drop")
    target = _Target(xp, device, dtype)
    scenes = [
        _Scene(grid, list(given), cut_corners)
        for grid, given in zip(several, per_grid, strict=True)
    ]
    shape = Shape(
        len(scenes),
        max(len(s.grid.levels) for s in scenes),
        max(level.height for s in scenes for level in s.grid.levels),
        max(level.width for s in scenes for level in s.grid.levels),
    )
    num_goals = len(per_grid[0])
    if math.prod(shape) * max(num_goals, 1) >= 2**31:
        text = " x ".join(map(str, shape)) + (
            f" for each of {num_goals} goals" if num_goals else ""
        )
        raise QueryError(f"expected less than 2^31 cells in all, got {text}")
    made = {
        **_lattices(scenes, shape, target.floating),
        **_layers(scenes, shape, target.floating, max_drop),
        **_goal_fields(scenes, shape, target.floating),
    }
    num_rooms = max(len(s.cache.rooms.rooms) for s in scenes)
    made |= _orders(made["room"], made["island"], num_rooms, shape)
    arrays = {name: target.array(value) for name, value in made.items()}
    lattices = [{level.lattice for level in s.grid.levels} for s in scenes]
    register_pytree(target.xp)
    return GridTensors(
        xp=target.xp,
        dtype=target.dtype,
        index=target.index,
        shape=shape,
        same_lattice=all(len(of_scene) == 1 for of_scene in lattices),
        one_ground=shape.levels == 1,
        num_rooms=num_rooms,
        rooms=tuple(tuple(room.id for room in s.cache.rooms.rooms) for s in scenes),
        goals=tuple(str(goal) for goal in per_grid[0]),
        **arrays,
    )


class _Target:
    """The library, device and dtype that arrays are made for."""

    def __init__(self, xp: Any, device: Any, dtype: str | None) -> None:
        try:
            from array_api_compat import array_namespace  # of the extra [tensors]
        except ImportError as error:
            message = 'tensors need array-api-compat: pip install "navbake[tensors]"'
            raise MissingDependencyError(message) from error
        try:
            probe = xp.asarray([0.0])
            self.xp = array_namespace(probe)
        except (AttributeError, TypeError) as error:
            raise QueryError(
                f"expected numpy, torch, jax.numpy or another module of the Python array API, got "
                f"{xp!r}"
            ) from error
        if dtype not in (None, "float32", "float64"):
            raise QueryError(f'expected a dtype "float32" or "float64", got {dtype!r}')
        self._device = device
        wanted = probe.dtype if dtype is None else getattr(self.xp, dtype)
        # JAX has no float64 and no int64 unless it was told to
        self.dtype = self._make(np.zeros(1), wanted).dtype
        if self.dtype != wanted:
            raise QueryError(f"{self.xp.__name__} has no {dtype} as it is set up: use float32")
        self.floating = np.dtype("float64" if self.dtype == self.xp.float64 else "float32")
        self.index = self._make(np.zeros(1, dtype=np.int64), None).dtype

    def array(self, value: NDArray[Any]) -> Any:
        """The array in the library, on the device; integers and masks keep their dtype."""
        return self._make(value, self.dtype if value.dtype.kind == "f" else None)

    def _make(self, value: NDArray[Any], dtype: Any) -> Any:
        given = {} if self._device is None else {"device": self._device}
        try:
            return self.xp.asarray(value, dtype=dtype, **given)
        except Exception as error:  # each library has errors of its own
            if self._device is None:
                raise
            reason = str(error).splitlines()[0]
            raise QueryError(
                f"no array of {self.xp.__name__} can be made on the device {self._device!r}: "
                f"{reason}"
            ) from error


class _Scene:
    """One grid with what follows from it."""

    def __init__(self, grid: NavGrid, goals: list[Goal], cut_corners: bool) -> None:
        self.grid = grid
        self.cache = Search(grid, cut_corners=cut_corners)
        self.flat: FlatGrid = self.cache.flat
        self.fields = [find_field(self.cache, goal, None) for goal in goals]

    def pad(self, values: NDArray[Any], shape: Shape, outside: float) -> NDArray[Any]:
        """Values by flat id as an array (levels, rows, cols) with room for all scenes."""
        padded = np.full(shape[1:], outside, dtype=values.dtype)
        for number, level in enumerate(self.grid.levels):
            part = values[self.flat.cells_of(number)].reshape(level.shape)
            padded[number, : level.height, : level.width] = part
        return padded

    def padded_ids(self, scene: int, shape: Shape) -> NDArray[np.int32]:
        """The id in the padded arrays of each cell, by flat id; and -1 at the end, for none."""
        ids = np.arange(np.prod(shape[1:]), dtype=np.int32).reshape(shape[1:])
        ids += np.int32(scene * ids.size)
        parts = [ids[k, : v.height, : v.width].ravel() for k, v in enumerate(self.grid.levels)]
        return np.concatenate([*parts, np.array([-1], dtype=np.int32)])


def _check_grids(grids: Any) -> list[Any]:
    if not isinstance(grids, Iterable):
        raise QueryError(f"expected a grid or several, got {grids!r}")
    several = list(grids)
    if not several:
        raise QueryError("expected at least one grid, got none")
    for grid in several:
        if not hasattr(grid, "levels"):
            raise QueryError(f"expected grids, got {grid!r}")
    return several


def _lattices(scenes: list[_Scene], shape: Shape, dtype: Floating) -> dict[str, NDArray[Any]]:
    """Where the columns and rows of each level lie."""
    num = shape.scenes * shape.levels
    found: dict[str, NDArray[Any]] = {
        name: np.zeros(num, dtype=dtype)
        for name in ("x_first", "y_first", "scale", "west", "east", "north", "south")
    }
    found["x_edge"] = np.zeros((num, shape.cols + 1), dtype=dtype)
    found["y_edge"] = np.zeros((num, shape.rows + 1), dtype=dtype)
    found["num_rows"] = np.zeros(num, dtype=np.int32)
    found["num_cols"] = np.zeros(num, dtype=np.int32)
    for number, scene in enumerate(scenes):
        for k, level in enumerate(scene.grid.levels):
            at, (x_min, y_max, size, width, height) = number * shape.levels + k, level.lattice
            ends = np.array([x_min, x_min + width * size, y_max, y_max - height * size])
            if np.spacing(np.abs(ends).max().astype(dtype)) > size / FINEST:
                raise QueryError(
                    f"{dtype} can't tell cells of {size:g} m apart at x, y up to "
                    f"{np.abs(ends).max():g} m in {scene.grid.scene_id!r}: use float64"
                )
            found["x_first"][at], found["y_first"][at] = x_min, y_max
            found["scale"][at] = 1 / size
            x_edge = first_in_cell(x_min, size, width, dtype)
            y_edge = last_in_cell(y_max, size, height, dtype)
            found["x_edge"][at, : width + 1], found["y_edge"][at, : height + 1] = x_edge, y_edge
            found["west"][at], found["east"][at] = x_edge[0], x_edge[-1]
            found["north"][at], found["south"][at] = y_edge[0], y_edge[-1]
            found["num_rows"][at], found["num_cols"][at] = height, width
    return {name: value.ravel() for name, value in found.items()}


def _layers(
    scenes: list[_Scene], shape: Shape, dtype: Floating, max_drop: float
) -> dict[str, NDArray[Any]]:
    """The layers of all scenes, by cell."""
    found: dict[str, list[NDArray[Any]]] = {}
    ground = np.zeros((shape.scenes, shape.levels))
    num_islands = 0
    for number, scene in enumerate(scenes):
        flat, levels = scene.flat, scene.grid.levels
        ground[number, : len(levels)] = flat.floors.ground
        own = flat.floors.ground[flat.level_of(np.arange(flat.num_cells))]
        stand = np.where(np.isnan(flat.floors.z), own, flat.floors.z)
        heights, rank = np.unique(stand, return_inverse=True)
        rank = np.where(np.isnan(flat.floors.z), rank, rank + len(heights)).astype(np.int32)
        island = scene.cache.islands.number
        layers = {
            "reach": (lowest_reaching(stand, flat.floors.max_step, dtype), np.inf),
            "rank": (rank, -1),
            "top": (
                np.where(flat.free, highest_standing(stand, max_drop, dtype), -np.inf),
                -np.inf,
            ),
            "floor": (flat.floors.z, np.nan),
            "room": (scene.cache.rooms.number, 0),
            "island": (np.where(island > 0, island + num_islands, 0).astype(np.int32), 0),
            "clearance": (np.concatenate([clearance(v).ravel() for v in levels]), 0),
        }
        num_islands += scene.cache.islands.count
        for name, (values, outside) in layers.items():
            found.setdefault(name, []).append(scene.pad(values, shape, outside))
    arrays = {name: np.stack(parts).ravel() for name, parts in found.items()}
    of_floats = {n: v.astype(dtype) if v.dtype.kind == "f" else v for n, v in arrays.items()}
    return {**of_floats, "ground": ground.ravel().astype(dtype)}


def _goal_fields(scenes: list[_Scene], shape: Shape, dtype: Floating) -> dict[str, NDArray[Any]]:
    """Cost and next cell of the cheapest path to each goal, by cell."""
    num = len(scenes[0].fields)
    cost = np.full((num, shape.scenes, *shape[1:]), np.inf, dtype=dtype)
    onward = np.full(cost.shape, -1, dtype=np.int32)
    for number, scene in enumerate(scenes):
        ids = scene.padded_ids(number, shape)
        for goal, field in enumerate(scene.fields):
            cost[goal, number] = scene.pad(field, shape, np.inf)
            onward[goal, number] = scene.pad(ids[scene.cache.onward(field)], shape, -1)
    return {"cost": cost.ravel(), "onward": onward.ravel()}


def _orders(
    room: NDArray[np.int32], island: NDArray[np.int32], num_rooms: int, shape: Shape
) -> dict[str, NDArray[Any]]:
    """The free cells sorted by island and room, and by scene and room."""
    free = np.flatnonzero(island)
    of_scene = free // int(np.prod(shape[1:]))
    if max(int(island.max(initial=0)) + 1, shape.scenes) * (num_rooms + 1) >= 2**31:
        raise QueryError("too many islands and rooms in all: make tensors of fewer grids at once")
    found = {}
    for name, group in (("island", island[free]), ("room", of_scene)):
        key = (group * (num_rooms + 1) + room[free]).astype(np.int32)
        order = np.argsort(key, kind="stable")
        found[f"by_{name}"] = free[order].astype(np.int32)
        found[f"{name}_key"] = key[order]
    return found


# --- numbers at which an answer changes --------------------------------------------------------
# The run time finds a position's cell in float64: ``floor((x - x_min) / cell_size)``. In float32
# the same formula gives another cell near an edge. So for each edge the smallest number is
# searched, of the dtype that positions have, for which the formula in float64 gives the next cell.
# One comparison with that number then decides as float64 does. Floors and drops are treated alike.


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
