"""Which cell a position is in: the rule of `navbake.navgrid.cells`, for arrays of any library."""

from typing import NamedTuple

from navbake.errors import QueryError
from navbake.tensors.grid_tensors import Array, GridTensors

FAR = 1e30  # metres; what lies higher is no position


class Located(NamedTuple):
    """The cells of positions, of any shape (...).

    Attributes:
        cell: ids, `GridTensors` says of what; 0 where there is none.
        level: 0 where there is none.
        inside: whether there is one.
    """

    cell: Array
    level: Array
    inside: Array


def locate(t: GridTensors, positions: Array, scene_id: Array | int | None) -> Located:
    """Find the cells of checked positions, shape (..., 3), on the nearest floor below each."""
    xp, shape = t.xp, t.shape
    x, y, z = positions[..., 0], positions[..., 1], positions[..., 2]
    first = first_level(t, scene_id)
    cell, inside = on_level(t, x, y, first)
    if t.one_ground:
        inside = inside & (z >= t.reach[cell]) & (z < FAR)
        return Located(xp.where(inside, cell, 0), xp.zeros_like(cell), inside)
    best, level = xp.zeros_like(cell), xp.zeros_like(cell)
    highest = xp.full_like(z, -xp.inf)  # how high the best floor is; a ground is below all floors
    is_floor = xp.zeros_like(inside)
    for k in range(shape.levels):
        if k and t.same_lattice:
            cell = cell + shape.rows * shape.cols
        elif k:
            cell, inside = on_level(t, x, y, first + k)
        reach, has_floor = t.reach[cell], ~xp.isnan(t.floor[cell])
        reached = inside & (z >= reach) & (z < FAR)
        better = reached & ((has_floor & ~is_floor) | ((has_floor == is_floor) & (reach > highest)))
        best = xp.where(better, cell, best)
        level = xp.where(better, k, level)
        highest = xp.where(better, reach, highest)
        is_floor = is_floor | (better & has_floor)
    return Located(best, level, highest > -xp.inf)


def on_level(t: GridTensors, x: Array, y: Array, first: Array | int) -> tuple[Array, Array]:
    """The cells at x, y of one level, and whether they are there; a cell that exists in any case.

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
    return scene_id * t.shape.levels


def split(t: GridTensors, cell: Array) -> tuple[Array, Array, Array]:
    """Level among those of all scenes, row and column of cells."""
    level, rest = cell // (t.shape.rows * t.shape.cols), cell % (t.shape.rows * t.shape.cols)
    return level, rest // t.shape.cols, rest % t.shape.cols


def centers(t: GridTensors, cell: Array) -> Array:
    """World x, y of cells' centres [m], shape (..., 2)."""
    level, row, col = split(t, cell)
    size = 1 / t.scale[level]
    x = t.x_first[level] + (t.xp.astype(col, t.dtype) + 0.5) * size
    y = t.y_first[level] - (t.xp.astype(row, t.dtype) + 0.5) * size
    return t.xp.stack([x, y], axis=-1)


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
    if not hasattr(values, "dtype"):
        return t.xp.asarray(values, dtype=t.dtype)
    if values.dtype != t.dtype:
        raise QueryError(
            f"expected an array of {t.dtype}, as the tensors are, got {values.dtype}: convert it, "
            "or make the tensors with that dtype"
        )
    return values


def check_scenes(t: GridTensors, scene_id: Array | int | None, shape: tuple[int, ...]) -> Array:
    """The scenes of positions of a shape (...); None where there is one scene."""
    if scene_id is None:
        if t.shape.scenes > 1:
            raise QueryError(f"expected a scene_id, 0 to {t.shape.scenes - 1}: there are several")
        return None
    if isinstance(scene_id, int):
        if not 0 <= scene_id < t.shape.scenes:
            raise QueryError(f"no scene {scene_id}: expected 0 to {t.shape.scenes - 1}")
        return t.xp.full(shape, scene_id, dtype=t.index) if t.shape.scenes > 1 else None
    ids = t.xp.astype(scene_id, t.index)
    try:
        return t.xp.broadcast_to(ids, shape)
    except (ValueError, RuntimeError, TypeError) as error:
        raise QueryError(
            f"expected a scene_id that fits positions of shape {shape}, got one of shape "
            f"{tuple(ids.shape)}"
        ) from error


def bounded(xp: Array, values: Array, low: Array | float, high: Array | float) -> Array:
    """Values cut off at a lowest and a highest; NaN stays."""
    return xp.where(values < low, low, xp.where(values > high, high, values))
