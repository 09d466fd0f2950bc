"""Makes `GridTensors` of grids for the caller's array library."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.errors import MissingDependencyError, QueryError
from navbake.navgrid.islands import measure_clearance, values_by_area
from navbake.navgrid.links import Agent
from navbake.runtime.flat_grid import check_distance
from navbake.runtime.no_path import describe_blocked_goal
from navbake.runtime.paths import find_target
from navbake.runtime.places import MAX_DROP
from navbake.runtime.search import Search
from navbake.runtime.stand import StandTargets, stand_poses
from navbake.runtime.stand_cells import StandRules
from navbake.tensors.grid_tensors import (
    Array,
    GridTensors,
    Namespace,
    PaddedShape,
    SceneSearches,
    device_of,
    register_pytree,
)
from navbake.types import Bool, Float

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.runtime.paths import Goal

Floating = np.dtype[np.floating]
"""float32 or float64."""
Arrays = dict[str, NDArray[Any]]
"""Name of a field of `GridTensors` -> its array of numpy."""
STAND_NAMES = ("stand_x", "stand_y", "stand_z", "stand_yaw")  # fields of `GridTensors`
# Floats of the dtype that must lie within a cell's edge, so that a position is in the right cell
MIN_FLOATS_PER_CELL = 8


def make_tensors(
    grids: NavGrid | Sequence[NavGrid],
    xp: Namespace = np,
    *,
    device: object = None,
    dtype: str | None = None,
    goals: Sequence[Goal] | Sequence[Sequence[Goal]] = (),
    max_drop: float = MAX_DROP,
    cut_corners: bool = False,
    agent: str | Agent | None = None,
) -> GridTensors:
    """Turn one or several grids into arrays of one library, on one device.

    Later changes of a grid have no effect, also obstacles that are added later: make new tensors
    then.

    Args:
        grids: one grid, or several, numbered as `scene_id` in the order given.
        xp: ``numpy``, ``torch``, ``jax.numpy`` or another module that follows the Python array
            API.
        device: the device of the arrays, as the library names it; None for the library's default.
        dtype: ``"float32"`` or ``"float64"``, the dtype of positions and of all values in metres;
            None for the library's default. float32 is refused if the grid is so far from the origin
            that float32 can't tell cells apart.
        goals: for one grid, a sequence of goals as `PathFinder.find_path` takes them. For several
            grids, such a sequence for each grid, all equally long. `distance_to_goal` and
            `path_step` number goals in this order.
        max_drop: `is_navigable` holds up to this height above the floor [m], >= 0.
        cut_corners: allow diagonal steps past blocked corners.
        agent: the name of an agent that the grids list, or a `navbake.Agent`; the arrays are made
            of the grids for its size. None for each grid's own.

    Returns:
        The tensors.

    Raises:
        QueryError: an argument is not valid, no cell of a goal is free, or there are 2^31 cells or
            more.
        MissingDependencyError: the extra ``tensors`` isn't installed.

    Example:
        >>> t = make_tensors(grid, torch, device="cuda", goals=["room:Kitchen"])
    """
    grid_list, goals_of_grids = _check_grids(grids, goals)
    check_distance(max_drop, "max_drop")
    xp, make_array = _open_library(xp, device, dtype)
    library_dtype = make_array(np.zeros(1)).dtype
    float_dtype: Floating = np.dtype("float64" if library_dtype == xp.float64 else "float32")
    searches = [Search(grid, cut_corners=cut_corners, agent=agent) for grid in grid_list]
    grid_list = [search.grid for search in searches]
    shape = _find_padded_shape(grid_list)
    _check_size(shape, len(goals_of_grids[0]))
    arrays = _make_lattices(grid_list, shape, float_dtype)
    arrays |= _make_layers(searches, shape, float_dtype, max_drop)
    arrays |= _make_goal_fields(searches, goals_of_grids, shape, float_dtype)
    room_ids = tuple(tuple(room.id for room in search.rooms.rooms) for search in searches)
    num_rooms = max(len(rooms_of_scene) for rooms_of_scene in room_ids)
    arrays |= _sort_free_cells(arrays["room"], arrays["island"], num_rooms, shape)
    register_pytree(xp)
    return GridTensors(
        xp=xp,
        dtype=library_dtype,
        index_dtype=make_array(np.zeros(1, dtype=np.int64)).dtype,
        shape=shape,
        num_rooms=num_rooms,
        rooms=room_ids,
        areas=tuple(tuple(area.name for area in grid.areas) for grid in grid_list),
        goals=_name_goals(goals_of_grids[0]),
        searches=SceneSearches(searches),
        max_cells_per_metre=max(
            1 / level.lattice.cell_size for grid in grid_list for level in grid.levels
        ),
        targets=(),
        stand_repeats=0,
        **{name: make_array(np.empty(0)) for name in STAND_NAMES},
        stand_key=make_array(np.empty(0, dtype=np.int32)),
        stand_start=make_array(np.zeros(1, dtype=np.int32)),
        **{name: make_array(array) for name, array in arrays.items()},
    )


def with_goals(
    tensors: GridTensors, goals: Sequence[Goal] | Sequence[Sequence[Goal]]
) -> GridTensors:
    """Return tensors with other goals, faster than by making new tensors.

    Only the paths to the goals are computed anew; all other arrays are shared with the old tensors.
    Obstacles count as they were when the old tensors were made.

    Args:
        tensors: the tensors.
        goals: as for `make_tensors`.

    Returns:
        The tensors with these goals, numbered in this order.

    Raises:
        QueryError: a goal is not valid, or no cell of it is free.

    Example:
        >>> t = grid.tensors(torch, goals=[(1.0, 2.0, 0.0)])
        >>> t = with_goals(t, [(1.5, 2.0, 0.0)])
    """
    grids = [search.grid for search in tensors.searches]
    _, goals_of_grids = _check_grids(grids[0] if len(grids) == 1 else grids, goals)
    _check_size(tensors.shape, len(goals_of_grids[0]))
    xp = tensors.xp
    float_dtype: Floating = np.dtype("float64" if tensors.dtype == xp.float64 else "float32")
    goal_fields = _make_goal_fields(
        list(tensors.searches), goals_of_grids, tensors.shape, float_dtype
    )
    arrays = {
        name: xp.asarray(array, device=device_of(tensors)) for name, array in goal_fields.items()
    }
    return replace(tensors, goals=_name_goals(goals_of_grids[0]), **arrays)


def with_stands(
    tensors: GridTensors,
    targets: Sequence[StandTargets] | Sequence[Sequence[StandTargets]],
    *,
    reach: tuple[float, float] = (0.3, 0.8),
    footprint: ArrayLike | None = None,
    facing: str | None = "target",
    height: float | None = None,
    sight: bool | float = True,
) -> GridTensors:
    """Return tensors that know where a robot's base can stand to reach things.

    These are all poses that `PathFinder.stand_poses` finds, one in each cell. `sample_stand` draws
    from them, and `can_reach` tests other poses. All arrays but those of poses are shared with the
    old tensors.

    Args:
        tensors: the tensors.
        targets: for tensors of one grid, a sequence of targets as `PathFinder.stand_poses` takes
            them: a position, ``object:NAME``, ``category:NAME``, or a list of these, any of which
            counts. For several grids, such a sequence for each grid, all equally long.
        reach: least and greatest distance from the base's axis to the target [m].
        footprint: outline of the base, shape (k, 2) [m]; None for a disc of the grid's radius.
        facing: ``target``, or None for random headings.
        height: height of the shoulder over the floor [m], for distances in space.
        sight: True, False, or the height of the eye over the floor [m].

    Returns:
        The tensors with these targets, numbered in this order.

    Raises:
        QueryError: an argument is not valid, or there is no pose for a target.

    Example:
        >>> t = with_stands(grid.tensors(torch), ["object:mug", "category:drawer"])
        >>> positions, yaw = sample_stand(t, torch.rand(4096), target=0)
    """
    grids = [search.grid for search in tensors.searches]
    _, targets_of_grids = _check_grids(grids[0] if len(grids) == 1 else grids, targets, "targets")
    num_targets = len(targets_of_grids[0])
    _check_size(tensors.shape, num_targets)
    rules = StandRules(reach, footprint, facing, height, sight, start=None)
    num_cells = math.prod(tensors.shape)
    poses_by_group: list[NDArray[Any]] = []
    keys_by_group: list[NDArray[Any]] = []
    for target_number in range(num_targets):
        for scene_number, search in enumerate(tensors.searches):
            target = targets_of_grids[scene_number][target_number]
            target_poses = stand_poses(search, target, rules, count=None, spread=0.0, seed=0)
            if not len(target_poses):
                reason = "; ".join(target_poses.why_not.values())
                raise QueryError(
                    f"no pose reaches target {target_number} in {search.grid.scene_id!r}: {reason}",
                    key="targets",
                    value=target,
                )
            padded_ids = _pad_ids(search, tensors.shape, scene_number)
            cells = padded_ids[search.flat.cells_at(target_poses.positions)]
            order = np.argsort(cells, kind="stable")
            group_poses = np.column_stack([target_poses.positions, target_poses.headings])
            poses_by_group.append(group_poses[order])
            keys_by_group.append(target_number * num_cells + cells[order].astype(np.int64))
    stand_key = np.concatenate([np.empty(0, dtype=np.int64), *keys_by_group])
    _, repeats = np.unique(stand_key, return_counts=True)
    num_poses = [len(keys) for keys in keys_by_group]
    xp = tensors.xp
    device = device_of(tensors)
    poses = np.concatenate([np.empty((0, len(STAND_NAMES))), *poses_by_group])
    stand_start = np.cumsum([0, *num_poses]).astype(np.int32)
    return replace(
        tensors,
        targets=_name_goals(targets_of_grids[0]),
        stand_repeats=int(repeats.max(initial=0)),
        stand_key=xp.asarray(stand_key.astype(np.int32), device=device),
        stand_start=xp.asarray(stand_start, device=device),
        **{
            name: xp.asarray(values, dtype=tensors.dtype, device=device)
            for name, values in zip(STAND_NAMES, np.ascontiguousarray(poses.T), strict=True)
        },
    )


def _name_goals(goals: Sequence[object]) -> tuple[str, ...]:
    """Return the texts of goals, each in one line."""
    return tuple(" ".join(str(goal).split()) for goal in goals)


def _pad_ids(search: Search, shape: PaddedShape, scene_number: int) -> NDArray[np.int32]:
    """Return the padded id of each of a grid's cells, by flat id.

    Args:
        search: the search on the grid.
        shape: the shape that all grids are padded to.
        scene_number: the grid's number.
    """
    padded_ids = np.arange(math.prod(shape), dtype=np.int32).reshape(shape)
    ids_of_levels = [
        padded_ids[scene_number, level_number, : level.height, : level.width].ravel()
        for level_number, level in enumerate(search.grid.levels)
    ]
    return np.concatenate(ids_of_levels)


def _check_size(shape: PaddedShape, num_goals: int) -> None:
    """Check that int32 can number the cells of all goals or targets.

    Raises:
        QueryError: there are too many cells.
    """
    if math.prod(shape) * max(num_goals, 1) >= 2**31:
        size_text = f"{' x '.join(map(str, shape))} for each of {num_goals} goals or targets"
        raise QueryError(f"expected less than 2^31 cells in all, got {size_text}")


def _check_grids(
    grids: NavGrid | Sequence[NavGrid],
    goals: Sequence[Any] | Sequence[Sequence[Any]],
    noun: str = "goals",
) -> tuple[list[Any], list[Sequence[Any]]]:
    """Check the arguments, and return the grids as a list, and a list of the goals of each grid.

    Args:
        grids: the grid or grids.
        goals: the goals, or those of each grid.
        noun: the argument's name, for errors.
    """
    is_single = hasattr(grids, "levels")
    if not is_single and not isinstance(grids, Iterable):
        raise QueryError(f"expected a grid or several, got {grids!r}")
    grid_list: list[Any] = [grids] if is_single else list(grids)  # type: ignore[arg-type]
    if not grid_list or not all(hasattr(grid, "levels") for grid in grid_list):
        raise QueryError(f"expected grids, at least one grid, got {grid_list}")
    if isinstance(goals, str):
        raise QueryError(f"expected a list of {noun}, got {goals!r}: write {noun}=[{goals!r}]")
    if len(goals) and all(isinstance(goal, int | float | np.number) for goal in goals):
        position = tuple(np.asarray(goals, dtype=np.float64).tolist())
        raise QueryError(
            f"expected a list of {noun}, got one position {position}: write {noun}=[{position}]"
        )
    goals_of_grids: list[Any] = [goals] if is_single else list(goals) or [()] * len(grid_list)
    is_list_by_grid = [
        isinstance(goals_of_grid, Sequence | np.ndarray) and not isinstance(goals_of_grid, str)
        for goals_of_grid in goals_of_grids
    ]
    if len(goals_of_grids) != len(grid_list) or not all(is_list_by_grid):
        expected = f"a list of {noun} for each of {len(grid_list)} grids"
        hint = f"write {noun}=[[…], […]], all equally long"
        raise QueryError(f"expected {expected}, got {goals!r}: {hint}")
    num_goals_of_grids = [len(goals_of_grid) for goals_of_grid in goals_of_grids]
    if len(set(num_goals_of_grids)) != 1:
        expected = f"as many {noun} for each of {len(grid_list)} grids"
        raise QueryError(f"expected {expected}, got {num_goals_of_grids}")
    return grid_list, goals_of_grids


def _find_padded_shape(grids: list[Any]) -> PaddedShape:
    """Find how many grids there are, and the largest numbers of levels, rows and columns."""
    levels = [level for grid in grids for level in grid.levels]
    return PaddedShape(
        scenes=len(grids),
        levels=max(len(grid.levels) for grid in grids),
        rows=max(level.height for level in levels),
        cols=max(level.width for level in levels),
    )


def _open_library(
    xp: Namespace, device: object, dtype: str | None
) -> tuple[Namespace, Callable[[NDArray[Any]], Array]]:
    """Check a library, and return its namespace and a function that makes its arrays.

    Args:
        xp: the library.
        device: the device of the arrays; None for the library's default.
        dtype: ``float32`` or ``float64``, the dtype of floats; None for the library's default.

    Returns:
        The library's namespace by the array API; and a function that converts an array of numpy.
    """
    try:
        from array_api_compat import array_namespace  # of the extra [tensors]
    except ImportError as error:
        message = 'tensors need array-api-compat: pip install "navbake[tensors]"'
        raise MissingDependencyError(message) from error
    try:
        probe_array = xp.asarray([0.0])
        namespace = array_namespace(probe_array)
    except (AttributeError, TypeError) as error:
        expected = "numpy, torch, jax.numpy or another module of the Python array API"
        raise QueryError(f"expected {expected}, got {xp!r}") from error
    if dtype not in (None, "float32", "float64"):
        raise QueryError(f'expected a dtype "float32" or "float64", got {dtype!r}')
    float_dtype = probe_array.dtype if dtype is None else getattr(namespace, dtype)
    device_option = {} if device is None else {"device": device}

    def make_array(array: NDArray[Any]) -> Array:
        array_dtype = float_dtype if array.dtype.kind == "f" else None
        try:
            return namespace.asarray(array, dtype=array_dtype, **device_option)
        except Exception as error:  # each library has errors of its own
            if device is None:
                raise
            arrays_text = f"{namespace.__name__} can be made on the device {device!r}"
            raise QueryError(f"no array of {arrays_text}: {str(error).splitlines()[0]}") from error

    if make_array(np.zeros(1)).dtype != float_dtype:  # JAX has no 64-bit types by default
        raise QueryError(f"{namespace.__name__} has no {dtype} in its configuration: use float32")
    return namespace, make_array


def _pad(search: Search, values: NDArray[Any], shape: PaddedShape, padding: float) -> NDArray[Any]:
    """Arrange the values of a grid's cells by level, row and column, padded to the largest grid.

    Args:
        search: the search on the grid, which has the flat ids of cells.
        values: a value for each cell of the grid, by flat id.
        shape: the largest numbers of levels, rows and columns of any grid.
        padding: the value of cells beyond the grid.

    Returns:
        The values, shape (levels, rows, cols).
    """
    padded_values = np.full(shape[1:], padding, dtype=values.dtype)
    for level_number, level in enumerate(search.grid.levels):
        level_values = values[search.flat.cells_of(level_number)].reshape(level.shape)
        padded_values[level_number, : level.height, : level.width] = level_values
    return padded_values


def _make_lattices(grids: list[NavGrid], shape: PaddedShape, dtype: Floating) -> Arrays:
    """Make the arrays with the edges and numbers of the columns and rows of each level."""
    level_shape = (shape.scenes, shape.levels)
    arrays: Arrays = {
        name: np.zeros(level_shape, dtype=dtype)
        for name in ("x_first", "y_first", "cells_per_metre", "west", "east", "north", "south")
    }
    arrays["x_edge"] = np.zeros((*level_shape, shape.cols + 1), dtype=dtype)
    arrays["y_edge"] = np.zeros((*level_shape, shape.rows + 1), dtype=dtype)
    arrays["num_rows"] = np.zeros(level_shape, dtype=np.int32)
    arrays["num_cols"] = np.zeros(level_shape, dtype=np.int32)
    for scene_number, grid in enumerate(grids):
        for level_number, level in enumerate(grid.levels):
            x_min, y_max, cell_size, width, height = level.lattice
            outer_edges = [x_min, x_min + width * cell_size, y_max, y_max - height * cell_size]
            max_coordinate = np.abs(outer_edges).max()
            if np.spacing(max_coordinate.astype(dtype)) > cell_size / MIN_FLOATS_PER_CELL:
                place_text = f"at x, y up to {max_coordinate:g} m in {grid.scene_id!r}"
                raise QueryError(
                    f"{dtype} can't tell cells of {cell_size:g} m apart {place_text}: use float64"
                )
            x_edge = find_first_in_cells(x_min, cell_size, width, dtype)
            y_edge = -find_first_in_cells(
                -y_max, cell_size, height, dtype
            )  # the same formula, bit for bit
            level_index = (scene_number, level_number)
            arrays["x_edge"][level_index][: width + 1] = x_edge
            arrays["y_edge"][level_index][: height + 1] = y_edge
            arrays["num_rows"][level_index] = height
            arrays["num_cols"][level_index] = width
            arrays["x_first"][level_index] = x_min
            arrays["y_first"][level_index] = y_max
            arrays["cells_per_metre"][level_index] = 1 / cell_size
            arrays["west"][level_index] = x_edge[0]
            arrays["east"][level_index] = x_edge[-1]
            arrays["north"][level_index] = y_edge[0]
            arrays["south"][level_index] = y_edge[-1]
    return {name: array.ravel() for name, array in arrays.items()}


def _make_layers(
    searches: list[Search], shape: PaddedShape, dtype: Floating, max_drop: float
) -> Arrays:
    """Make the arrays that have a value for each cell of all scenes, and `ground`."""
    layers_of_scenes: dict[str, list[NDArray[Any]]] = {}
    ground = np.zeros((shape.scenes, shape.levels))
    num_islands = 0
    for scene_number, search in enumerate(searches):
        flat_grid = search.flat
        levels = search.grid.levels
        floor_z = flat_grid.floors.z
        ground[scene_number, : len(levels)] = flat_grid.floors.ground
        ground_of_cell = flat_grid.floors.ground[flat_grid.level_of(np.arange(flat_grid.num_cells))]
        # a position over a cell without a floor counts from the level's ground
        standing_z = np.where(np.isnan(floor_z), ground_of_cell, floor_z)
        unique_z, ranks = np.unique(standing_z, return_inverse=True)
        ranks = np.where(np.isnan(floor_z), ranks, ranks + len(unique_z)).astype(np.int32)
        # the highest z is found like the lowest one, with the signs of z and the floors changed
        highest_z = -find_lowest_within_step(-standing_z, max_drop, dtype)
        island_numbers = search.islands.number
        island_numbers = np.where(island_numbers > 0, island_numbers + num_islands, 0).astype(
            np.int32
        )
        num_islands += search.islands.count
        area_numbers = range(1, len(search.grid.areas) + 1)
        area_of_cell = (
            values_by_area(search.grid, area_numbers, 0).astype(np.int32) + 0 * island_numbers
        )
        layers = {
            "lowest_z": (
                find_lowest_within_step(standing_z, flat_grid.floors.max_step, dtype),
                np.inf,
            ),
            "rank": (ranks, -1),
            "highest_z": (np.where(flat_grid.free, highest_z, -np.inf), -np.inf),
            "floor": (floor_z, np.nan),
            "room": (search.rooms.number, 0),
            "island": (island_numbers, 0),
            "area": (area_of_cell, 0),
            "clearance": (
                np.concatenate([measure_clearance(level).ravel() for level in levels]),
                0,
            ),
            "solid": (search.occupied, False),
        }
        for name, (values, padding) in layers.items():
            padded_values = _pad(search, values, shape, padding)
            layers_of_scenes.setdefault(name, []).append(padded_values)
    arrays = {name: np.stack(layers).ravel() for name, layers in layers_of_scenes.items()}
    arrays["ground"] = ground.ravel()
    return {
        name: array.astype(dtype) if array.dtype.kind == "f" else array
        for name, array in arrays.items()
    }


def _make_goal_fields(
    searches: list[Search], goals: list[Sequence[Goal]], shape: PaddedShape, dtype: Floating
) -> Arrays:
    """Make the arrays `cost` and `next_cell` of the cheapest path from each cell to each goal.

    Raises:
        QueryError: a goal is not valid, or no cell of it is free.
    """
    cost = np.full((len(goals[0]), shape.scenes, *shape[1:]), np.inf, dtype=dtype)
    next_cell = np.full(cost.shape, -1, dtype=np.int32)
    for scene_number, search in enumerate(searches):
        # flat id -> padded id; its last entry, -1, is looked up for no next cell, which is also -1
        padded_id_of_cell = np.append(_pad_ids(search, shape, scene_number), np.int32(-1))
        for goal_number, goal in enumerate(goals[scene_number]):
            target = find_target(search, goal)
            goal_cells = target.free_cells(search.flat)
            if not len(goal_cells):
                reason = describe_blocked_goal(search, target)
                raise QueryError(
                    f"no path leads to goal {goal_number} in {search.grid.scene_id!r}: {reason}",
                    key="goals",
                    value=goal,
                )
            cost_of_cell, next_cell_of_cell = search.find_next_cells(goal_cells)
            cost[goal_number, scene_number] = _pad(search, cost_of_cell, shape, np.inf)
            next_cell[goal_number, scene_number] = _pad(
                search, padded_id_of_cell[next_cell_of_cell], shape, -1
            )
    return {"cost": cost.ravel(), "next_cell": next_cell.ravel()}


def _sort_free_cells(
    room_of_cell: NDArray[Any], island_of_cell: NDArray[Any], num_rooms: int, shape: PaddedShape
) -> Arrays:
    """Make the arrays of free cells, sorted by island and room, and sorted by scene and room."""
    free_cells = np.flatnonzero(island_of_cell)
    scene_of_cell = free_cells // int(np.prod(shape[1:]))
    num_groups = max(int(island_of_cell.max(initial=0)) + 1, shape.scenes)
    if num_groups * (num_rooms + 1) >= 2**31:
        raise QueryError("too many islands and rooms in all: make tensors of fewer grids at once")
    arrays: Arrays = {}
    for name, group_of_cell in (("island", island_of_cell[free_cells]), ("room", scene_of_cell)):
        sort_keys = (group_of_cell * (num_rooms + 1) + room_of_cell[free_cells]).astype(np.int32)
        sort_indices = np.argsort(sort_keys, kind="stable")
        arrays[f"cells_by_{name}"] = free_cells[sort_indices].astype(np.int32)
        arrays[f"{name}_key"] = sort_keys[sort_indices]
    return arrays


# A position's column is ``floor((x - x_min) / cell_size)`` in float64. In float32, this formula is
# wrong near the edges of columns. So a bisection finds the smallest number of the dtype that the
# float64 formula puts into each column, and one comparison with it gives the exact column. The same
# is done for the lowest and the highest z at which a position is on a floor.


def find_smallest_true(
    condition: Callable[[Float], Bool], low: Float, high: Float, dtype: Floating
) -> NDArray[np.floating]:
    """For each of n conditions, find the smallest number of a dtype that meets it, by bisection.

    Args:
        condition: takes n numbers, and returns whether each condition holds at its number, shape
            (n,). A condition that holds at a number holds at every larger one.
        low: numbers at which the conditions don't hold, shape (n,).
        high: numbers at which the conditions hold, shape (n,).
        dtype: the dtype of the numbers.

    Returns:
        The numbers, shape (n,).
    """
    last_false = low.astype(dtype)
    first_true = high.astype(dtype)
    while True:
        middle = last_false + (first_true - last_false) / 2
        is_between = (middle > last_false) & (middle < first_true)
        if not is_between.any():
            return first_true
        is_true = condition(middle.astype(np.float64))
        first_true = np.where(is_between & is_true, middle, first_true)
        last_false = np.where(is_between & ~is_true, middle, last_false)


def find_first_in_cells(
    x_min: float, col_width: float, num_cols: int, dtype: Floating
) -> NDArray[np.floating]:
    """Find where columns begin: the smallest number of a dtype that lies in each column.

    With these numbers, one comparison tells exactly in which column an x of the dtype lies.

    Args:
        x_min: the first column's edge [m].
        col_width: width of a column [m].
        num_cols: number of columns.
        dtype: the dtype of the numbers.

    Returns:
        The smallest x in each column, then the smallest x beyond the last one, shape
        (num_cols + 1,) [m].
    """
    col_numbers = np.arange(num_cols + 1, dtype=np.float64)
    column_edges = x_min + col_numbers * col_width

    def is_in_cell(x: Float) -> Bool:
        return np.asarray(np.floor((x - x_min) / col_width) >= col_numbers)

    return find_smallest_true(
        is_in_cell, column_edges - col_width / 2, column_edges + col_width / 2, dtype
    )


def find_lowest_within_step(
    floor_z: Float, max_step: float, dtype: Floating
) -> NDArray[np.floating]:
    """Find the lowest z that counts as on each floor: at most a step below the floor.

    Args:
        floor_z: z of floors, shape (n,) [m].
        max_step: the highest step [m].
        dtype: the dtype of the numbers.

    Returns:
        The lowest z of the dtype for each floor, shape (n,) [m].
    """
    unique_z, index_of_floor = np.unique(floor_z, return_inverse=True)
    # bounds beyond the rounding of the exact thresholds
    exact_z = unique_z - max_step
    margin = 1e-9 + 16 * float(np.finfo(dtype).eps) * (np.abs(unique_z) + np.abs(exact_z))
    lowest_z = find_smallest_true(
        lambda z: unique_z <= z + max_step, exact_z - margin, exact_z + margin, dtype
    )
    return lowest_z[index_of_floor]
