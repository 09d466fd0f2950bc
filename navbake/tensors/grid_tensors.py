"""What the functions of `navbake.tensors` look things up in."""

from contextlib import suppress
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple, TypeAlias

Array: TypeAlias = Any
"""An array of whatever library the tensors were made for."""


class Shape(NamedTuple):
    """How many scenes, levels, rows and columns the arrays have room for."""

    scenes: int
    levels: int
    rows: int
    cols: int


@dataclass(frozen=True, eq=False)
class GridTensors:
    """One or several grids as arrays of one library, on one device; made by `make_tensors`.

    Scenes are padded to the most levels, rows and columns that one of them has. The id of a cell
    is ``((scene * levels + level) * rows + row) * cols + col``, over the padded `shape`; n is the
    number of ids. Arrays named ``…_first``, ``…_scale``, ``…_ground`` have one value a level of a
    scene, at ``scene * levels + level``. Positions are world x, y, z [m] in the dtype `dtype`.

    Attributes:
        xp: the array library's namespace.
        dtype: of positions and of all values in metres: float32 or float64 of the library.
        index: the integer dtype that ids are computed in.
        shape: the padded shape.
        same_lattice: whether all levels of each scene have their cells at the same x, y.
        one_ground: whether no scene has a second level, so that no level is to be chosen.
        rooms: ids of the rooms of each scene; number r of `room` is ``rooms[scene][r - 1]``.
        goals: what `goal` of `distance_to_goal` numbers, as it was given.
        x_first, y_first: x of the first column's edge and y of the first row's [m].
        scale: cells per metre.
        x_edge: the smallest number of `dtype` in each column or beyond it, ``cols + 1`` a level.
        y_edge: the largest number of `dtype` in each row or beyond it, ``rows + 1`` a level.
        west, east, north, south: the first and the last of these of each level: x from west to
            below east and y from north to above south are on it.
        num_rows, num_cols: of each level, without padding.
        reach: by cell, the lowest z [m] from which the cell's floor is at most a step above; of a
            cell without a floor the same of its level's ground; inf in padding.
        rank: by cell, int32, its place among the heights of a scene's floors, all grounds below
            all floors; -1 in padding. Of the floors that a position reaches, the highest rank
            counts.
        top: by cell, the highest z [m] at which `is_navigable` holds; -inf where nobody can stand.
        floor: by cell [m], NaN for no floor.
        ground: z of each level's ground [m].
        room: by cell, int32, 0 for no room.
        island: by cell, int32, counted through all scenes from 1; 0 where it isn't free.
        clearance: by cell [m], see `navbake.navgrid.islands.clearance`; 0 where it isn't free.
        cost: by goal and cell, at ``goal * n + cell``, what the cheapest path to the goal costs.
        onward: by goal and cell, the id of the next cell of that path; itself at the goal, -1
            where no path is; int32.
        by_island: the free cells' ids, sorted by `island_key`; int32, shape (m,).
        island_key: of each of them ``island * (num_rooms + 1) + room``.
        by_room: the free cells' ids, sorted by `room_key`; int32, shape (m,).
        room_key: of each of them ``scene * (num_rooms + 1) + room``.
        num_rooms: the most rooms that a scene has.
    """

    xp: Any = field(repr=False)
    dtype: Any
    index: Any = field(repr=False)
    shape: Shape
    same_lattice: bool
    one_ground: bool
    num_rooms: int
    rooms: tuple[tuple[str, ...], ...] = field(repr=False)
    goals: tuple[str, ...]
    x_first: Array = field(repr=False)
    y_first: Array = field(repr=False)
    scale: Array = field(repr=False)
    x_edge: Array = field(repr=False)
    y_edge: Array = field(repr=False)
    west: Array = field(repr=False)
    east: Array = field(repr=False)
    north: Array = field(repr=False)
    south: Array = field(repr=False)
    num_rows: Array = field(repr=False)
    num_cols: Array = field(repr=False)
    reach: Array = field(repr=False)
    rank: Array = field(repr=False)
    top: Array = field(repr=False)
    floor: Array = field(repr=False)
    ground: Array = field(repr=False)
    room: Array = field(repr=False)
    island: Array = field(repr=False)
    clearance: Array = field(repr=False)
    cost: Array = field(repr=False)
    onward: Array = field(repr=False)
    by_island: Array = field(repr=False)
    island_key: Array = field(repr=False)
    by_room: Array = field(repr=False)
    room_key: Array = field(repr=False)


STATIC: tuple[str, ...] = (
    "xp", "dtype", "index", "shape", "same_lattice", "one_ground", "num_rooms", "rooms", "goals",
)  # fmt: skip
ARRAYS = tuple(f.name for f in fields(GridTensors) if f.name not in STATIC)


def register_pytree(xp: Any) -> None:
    """Let JAX see the arrays of GridTensors when it traces a function that takes one."""
    if xp.__name__.split(".")[0] != "jax":
        return
    from jax import tree_util  # the caller handed over JAX

    def flatten(t: GridTensors) -> tuple[tuple[Array, ...], tuple[Any, ...]]:
        return tuple(getattr(t, n) for n in ARRAYS), tuple(getattr(t, n) for n in STATIC)

    def unflatten(static: tuple[Any, ...], arrays: tuple[Array, ...]) -> GridTensors:
        return GridTensors(**dict(zip(STATIC + ARRAYS, (*static, *arrays), strict=True)))

    with suppress(ValueError):  # registered before
        tree_util.register_pytree_node(GridTensors, flatten, unflatten)
