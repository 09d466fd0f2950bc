"""Makes `GridTensors` of grids for the caller's array library."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navbake.errors import MissingDependencyError, QueryError
from navbake.navgrid.islands import cells_of_areas, clearance
from navbake.navgrid.links import Agent
from navbake.runtime.flat_grid import check_distance
from navbake.runtime.paths import find_target
from navbake.runtime.places import MAX_DROP
from navbake.runtime.search import Search
from navbake.tensors.grid_tensors import GridTensors, Shape, register_pytree
from navbake.types import Bool, Float

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.runtime.paths import Goal

Floating = np.dtype[np.floating]
Made = dict[str, NDArray[Any]]
FINEST = 8  # least width of a cell in numbers of the dtype


def make_tensors(
    grids: NavGrid | Sequence[NavGrid],
    xp: Any = np,
    *,
    device: Any = None,
    dtype: str | None = None,
    goals: Sequence[Goal] | Sequence[Sequence[Goal]] = (),
    max_drop: float = MAX_DROP,
    cut_corners: bool = False,
    agent: str | Agent | None = None,
) -> GridTensors:
    """Turn one or several grids into arrays of one library, on one device.

    Later changes of a grid, blocks included, have no effect: make new tensors then.

    Args:
        grids: one grid, or several, numbered as `scene_id` in the order given.
        xp: ``numpy``, ``torch``, ``jax.numpy`` or another module that follows the Python array
            API.
        device: of the arrays, as the library names it; its default unless given.
        dtype: ``"float32"`` or ``"float64"``: of positions and of all values in metres; the
            library's default unless given. float32 is refused if it can't resolve cells so far
            from the origin.
        goals: of one grid, goals as `PathFinder.find_path` takes them; of several, such a
            sequence for each, all equally long. `distance_to_goal` and `path_step` number them in
            this order.
        max_drop: largest height above the floor for `is_navigable` [m], >= 0.
        cut_corners: as in `PathFinder`.
        agent: as in `PathFinder`: the arrays are those of the grids for its size.
    """
    is_one = hasattr(grids, "levels")
    if not is_one and not isinstance(grids, Iterable):
        raise QueryError(f"expected a grid or several, got {grids!r}")
    several: list[Any] = [grids] if is_one else list(grids)  # type: ignore[arg-type]
    if not several or not all(hasattr(grid, "levels") for grid in several):
        raise QueryError(f"expected grids, at least one grid, got {several}")
    if isinstance(goals, str):
        raise QueryError(f"expected a list of goals, got {goals!r}: write goals=[{goals!r}]")
    per_grid: list[Any] = [goals] if is_one else list(goals) or [()] * len(several)
    if len(per_grid) != len(several) or len({len(g) for g in per_grid}) != 1:
        wanted = f"as many goals for each of {len(several)} grids"
        raise QueryError(f"expected {wanted}, got {[len(g) for g in per_grid]}")
    check_distance(max_drop, "max_drop")
    xp, make = _open_library(xp, device, dtype)
    of_library = make(np.zeros(1)).dtype
    floating: Floating = np.dtype("float64" if of_library == xp.float64 else "float32")
    searches = [Search(grid, cut_corners=cut_corners, agent=agent) for grid in several]
    several = [search.grid for search in searches]
    levels = [level for grid in several for level in grid.levels]
    most = max(len(grid.levels) for grid in several)
    shape = Shape(len(several), most, *np.max([v.shape for v in levels], axis=0).tolist())
    if math.prod(shape) * max(len(per_grid[0]), 1) >= 2**31:
        text = f"{' x '.join(map(str, shape))} for each of {len(per_grid[0])} goals"
        raise QueryError(f"expected less than 2^31 cells in all, got {text}")
    made = _lattices(several, shape, floating) | _layers(searches, shape, floating, max_drop)
    made |= _goal_fields(searches, per_grid, shape, floating)
    rooms = tuple(tuple(room.id for room in search.rooms.rooms) for search in searches)
    num_rooms = max(len(of_scene) for of_scene in rooms)
    made |= _orders(made["room"], made["island"], num_rooms, shape)
    register_pytree(xp)
    return GridTensors(
        xp=xp,
        dtype=of_library,
        index=make(np.zeros(1, dtype=np.int64)).dtype,
        shape=shape,
        num_rooms=num_rooms,
        rooms=rooms,
        areas=tuple(tuple(area.name for area in grid.areas) for grid in several),
        goals=tuple(str(goal) for goal in per_grid[0]),
        **{name: make(value) for name, value in made.items()},
    )


def _open_library(
    xp: Any, device: Any, dtype: str | None
) -> tuple[Any, Callable[[NDArray[Any]], Any]]:
    """A library's namespace, and a function that makes arrays of it, floats in the dtype."""
    try:
        from array_api_compat import array_namespace  # of the extra [tensors]
    except ImportError as error:
        message = 'tensors need array-api-compat: pip install "navbake[tensors]"'
        raise MissingDependencyError(message) from error
    try:
        probe = xp.asarray([0.0])
        space = array_namespace(probe)
    except (AttributeError, TypeError) as error:
        wanted = "numpy, torch, jax.numpy or another module of the Python array API"
        raise QueryError(f"expected {wanted}, got {xp!r}") from error
    if dtype not in (None, "float32", "float64"):
        raise QueryError(f'expected a dtype "float32" or "float64", got {dtype!r}')
    wanted = probe.dtype if dtype is None else getattr(space, dtype)

    def make(value: NDArray[Any]) -> Any:
        given = {} if device is None else {"device": device}
        try:
            return space.asarray(value, dtype=wanted if value.dtype.kind == "f" else None, **given)
        except Exception as error:  # each library has errors of its own
            if device is None:
                raise
            where = f"{space.__name__} can be made on the device {device!r}"
            raise QueryError(f"no array of {where}: {str(error).splitlines()[0]}") from error

    if make(np.zeros(1)).dtype != wanted:  # JAX has no 64-bit types by default
        raise QueryError(f"{space.__name__} has no {dtype} in its configuration: use float32")
    return space, make


def _pad(search: Search, values: NDArray[Any], shape: Shape, outside: float) -> NDArray[Any]:
    """Values by flat id as an array (levels, rows, cols), padded to `shape`."""
    padded = np.full(shape[1:], outside, dtype=values.dtype)
    for number, level in enumerate(search.grid.levels):
        part = values[search.flat.cells_of(number)].reshape(level.shape)
        padded[number, : level.height, : level.width] = part
    return padded


def _lattices(grids: list[NavGrid], shape: Shape, dtype: Floating) -> Made:
    """Edges of the columns and rows of each level."""
    num = shape.scenes, shape.levels
    names = ("x_first", "y_first", "scale", "west", "east", "north", "south")
    found: Made = {name: np.zeros(num, dtype=dtype) for name in names}
    found["x_edge"] = np.zeros((*num, shape.cols + 1), dtype=dtype)
    found["y_edge"] = np.zeros((*num, shape.rows + 1), dtype=dtype)
    found |= {name: np.zeros(num, dtype=np.int32) for name in ("num_rows", "num_cols")}
    for at in ((s, k) for s, grid in enumerate(grids) for k in range(len(grid.levels))):
        x_min, y_max, size, width, height = grids[at[0]].levels[at[1]].lattice
        farthest = np.abs([x_min, x_min + width * size, y_max, y_max - height * size]).max()
        if np.spacing(farthest.astype(dtype)) > size / FINEST:
            where = f"at x, y up to {farthest:g} m in {grids[at[0]].scene_id!r}"
            raise QueryError(f"{dtype} can't tell cells of {size:g} m apart {where}: use float64")
        x_edge = first_in_cell(x_min, size, width, dtype)
        y_edge = -first_in_cell(-y_max, size, height, dtype)  # the same formula, bit for bit
        found["x_edge"][at][: width + 1] = x_edge
        found["y_edge"][at][: height + 1] = y_edge
        found["num_rows"][at] = height
        found["num_cols"][at] = width
        sides = x_edge[0], x_edge[-1], y_edge[0], y_edge[-1]
        for name, value in zip(names, (x_min, y_max, 1 / size, *sides), strict=True):
            found[name][at] = value
    return {name: value.ravel() for name, value in found.items()}


def _layers(searches: list[Search], shape: Shape, dtype: Floating, max_drop: float) -> Made:
    """The layers of all scenes, by cell."""
    found: dict[str, list[NDArray[Any]]] = {}
    ground = np.zeros((shape.scenes, shape.levels))
    num_islands = 0
    for number, search in enumerate(searches):
        flat = search.flat
        levels = search.grid.levels
        z = search.flat.floors.z
        ground[number, : len(levels)] = flat.floors.ground
        own = flat.floors.ground[flat.level_of(np.arange(flat.num_cells))]
        stand = np.where(np.isnan(z), own, z)
        heights, rank = np.unique(stand, return_inverse=True)
        rank = np.where(np.isnan(z), rank, rank + len(heights)).astype(np.int32)
        # mirrored: the lowest number from which the mirrored floor is at most the drop above
        top = np.where(flat.free, -lowest_reaching(-stand, max_drop, dtype), -np.inf)
        island = search.islands.number
        island = np.where(island > 0, island + num_islands, 0).astype(np.int32)
        num_islands += search.islands.count
        areas = range(1, len(search.grid.areas) + 1)
        layers = {
            "reach": (lowest_reaching(stand, flat.floors.max_step, dtype), np.inf),
            "rank": (rank, -1),
            "top": (top, -np.inf),
            "floor": (z, np.nan),
            "room": (search.rooms.number, 0),
            "island": (island, 0),
            "area": (cells_of_areas(search.grid, areas, 0).astype(np.int32) + 0 * island, 0),
            "clearance": (np.concatenate([clearance(v).ravel() for v in levels]), 0),
        }
        for name, (values, outside) in layers.items():
            found.setdefault(name, []).append(_pad(search, values, shape, outside))
    arrays = {name: np.stack(parts).ravel() for name, parts in found.items()}
    arrays["ground"] = ground.ravel()
    return {n: v.astype(dtype) if v.dtype.kind == "f" else v for n, v in arrays.items()}


def _goal_fields(
    searches: list[Search], goals: list[Sequence[Goal]], shape: Shape, dtype: Floating
) -> Made:
    """Cost and next cell of the cheapest path to each goal, by cell."""
    cost = np.full((len(goals[0]), shape.scenes, *shape[1:]), np.inf, dtype=dtype)
    onward = np.full(cost.shape, -1, dtype=np.int32)
    every = np.arange(math.prod(shape), dtype=np.int32).reshape(shape)
    for number, search in enumerate(searches):
        # padded ids by flat id, and -1 at the end, for none
        levels = enumerate(search.grid.levels)
        parts = [every[number, k, : v.height, : v.width].ravel() for k, v in levels]
        ids = np.concatenate([*parts, np.array([-1], dtype=np.int32)])
        for k, goal in enumerate(goals[number]):
            field, following = search.find_next_cells(
                find_target(search, goal).free_cells(search.flat)
            )
            cost[k, number] = _pad(search, field, shape, np.inf)
            onward[k, number] = _pad(search, ids[following], shape, -1)
    return {"cost": cost.ravel(), "onward": onward.ravel()}


def _orders(room: NDArray[Any], island: NDArray[Any], num_rooms: int, shape: Shape) -> Made:
    """The free cells sorted by island and room, and by scene and room."""
    free = np.flatnonzero(island)
    of_scene = free // int(np.prod(shape[1:]))
    if max(int(island.max(initial=0)) + 1, shape.scenes) * (num_rooms + 1) >= 2**31:
        raise QueryError("too many islands and rooms in all: make tensors of fewer grids at once")
    found: Made = {}
    for name, group in (("island", island[free]), ("room", of_scene)):
        key = (group * (num_rooms + 1) + room[free]).astype(np.int32)
        order = np.argsort(key, kind="stable")
        found[f"by_{name}"] = free[order].astype(np.int32)
        found[f"{name}_key"] = key[order]
    return found


# A position's cell is ``floor((x - x_min) / cell_size)`` in float64; in float32 the formula is
# wrong near edges. So a bisection finds the smallest number of the dtype in each cell by the
# float64 formula, and one comparison with it gives the exact cell. Likewise floors and drops.


def smallest_true(
    holds: Callable[[Float], Bool], low: Float, high: Float, dtype: Floating
) -> NDArray[np.floating]:
    """The smallest number of a dtype at which each of monotone conditions holds, by bisection."""
    false = low.astype(dtype)
    true = high.astype(dtype)
    while True:
        middle = false + (true - false) / 2
        is_open = (middle > false) & (middle < true)
        if not is_open.any():
            return true
        found = holds(middle.astype(np.float64))
        true = np.where(is_open & found, middle, true)
        false = np.where(is_open & ~found, middle, false)


def first_in_cell(least: float, size: float, count: int, dtype: Floating) -> NDArray[np.floating]:
    """The smallest x of `dtype` in each of some columns, and beyond the last; (count + 1,)."""
    edge = np.arange(count + 1, dtype=np.float64)
    middle = least + edge * size

    def holds(x: Float) -> Bool:
        return np.asarray(np.floor((x - least) / size) >= edge)

    return smallest_true(holds, middle - size / 2, middle + size / 2, dtype)


def lowest_reaching(floors: Float, max_step: float, dtype: Floating) -> NDArray[np.floating]:
    """The lowest z of `dtype` from which floors are at most a step above, by floor [m]."""
    some, where = np.unique(floors, return_inverse=True)
    # bounds beyond the rounding of the exact thresholds
    exact = some - max_step
    reach = 1e-9 + 16 * float(np.finfo(dtype).eps) * (np.abs(some) + np.abs(exact))
    return smallest_true(lambda z: some <= z + max_step, exact - reach, exact + reach, dtype)[where]
