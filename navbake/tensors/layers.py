"""What the cells of positions hold.

Each function takes positions of any shape (..., 3) and gives values of shape (...). A position with
a NaN, an infinite one and one beside the grid give NaN, False, 0 or -1.
"""

from collections.abc import Callable

from navbake.errors import QueryError
from navbake.tensors.grid_tensors import Array, GridTensors
from navbake.tensors.locate import (
    bounded,
    check_positions,
    check_scenes,
    first_level,
    locate,
)
from navbake.tensors.pieces import answer_all

MODES = ("nearest", "bilinear")


def level_at(t: GridTensors, positions: Array, scene_id: Array | int | None = None) -> Array:
    """The level that each position is on, int32: `PathFinder.cell_at` gives the same; -1 for none.

    Args:
        t: tensors of one or several grids.
        positions: world x, y, z [m], shape (..., 3), in the tensors' dtype.
        scene_id: which grid, where there are several; an integer or integers of shape (...).

    Raises:
        QueryError: positions have another shape or dtype, or there is no such scene. The same
            holds of all functions of this package.
    """
    xp = t.xp

    def answer(p: Array, scenes: Array) -> Array:
        found = locate(t, p, scenes)
        return xp.astype(xp.where(found.inside, found.level, -1), xp.int32)

    return _ask(t, answer, positions, scene_id)


def floor(t: GridTensors, positions: Array, scene_id: Array | int | None = None) -> Array:
    """World z of the floor under each position [m], NaN where there is none; see `level_at`."""
    return _value(t, t.floor, t.xp.nan, positions, scene_id)


def room(t: GridTensors, positions: Array, scene_id: Array | int | None = None) -> Array:
    """The room of each position, int32, 0 for none; ``t.rooms[scene][number - 1]`` is its id."""
    return _value(t, t.room, 0, positions, scene_id)


def island(t: GridTensors, positions: Array, scene_id: Array | int | None = None) -> Array:
    """The connected part that each position is on, int32, 0 for none.

    Two positions that can be walked between have the same number. Numbers count through all
    scenes.
    """
    return _value(t, t.island, 0, positions, scene_id)


def is_navigable(t: GridTensors, positions: Array, scene_id: Array | int | None = None) -> Array:
    """Whether an agent can stand at each position, bool; as `PathFinder.are_navigable`.

    How far above the floor a position may be was said when the tensors were made.
    """

    def answer(p: Array, scenes: Array) -> Array:
        found = locate(t, p, scenes)
        return found.inside & (p[..., 2] <= t.top[found.cell])

    return _ask(t, answer, positions, scene_id)


def clearance(
    t: GridTensors, positions: Array, scene_id: Array | int | None = None, mode: str = "bilinear"
) -> Array:
    """How far the nearest cell that isn't free is from each position [m]; NaN beside the grid.

    Of each cell that is free, `navbake.navgrid.islands.clearance`: from its centre to the nearest
    centre of another that isn't, less half a cell. Of the others 0.

    Args:
        t, positions, scene_id: see `level_at`.
        mode: ``"nearest"`` gives the value of the position's cell, as ``grid.values_at`` does.
            ``"bilinear"`` interpolates between the centres of the four cells round the position,
            on the position's level; at the edge of the grid the outer cells go on. Libraries that
            differentiate give the gradient by the position.
    """
    if mode not in MODES:
        raise QueryError(f"expected a mode of {', '.join(MODES)}, got {mode!r}")
    if mode == "nearest":
        return _value(t, t.clearance, t.xp.nan, positions, scene_id)
    return _ask(t, lambda p, scenes: _bilinear(t, p, scenes), positions, scene_id)


def _bilinear(t: GridTensors, p: Array, scenes: Array) -> Array:
    """`clearance` between the centres of cells."""
    xp, shape = t.xp, t.shape
    found = locate(t, p, scenes)
    level = first_level(t, scenes) + found.level
    # where a position is in no cell, nothing of it may get into the gradient
    x = xp.where(found.inside, p[..., 0], t.x_first[level])
    y = xp.where(found.inside, p[..., 1], t.y_first[level])
    across = (x - t.x_first[level]) * t.scale[level] - 0.5
    down = (t.y_first[level] - y) * t.scale[level] - 0.5
    last_col, last_row = t.num_cols[level] - 1, t.num_rows[level] - 1
    col0 = bounded(xp, xp.astype(xp.floor(across), t.index), 0, last_col)
    row0 = bounded(xp, xp.astype(xp.floor(down), t.index), 0, last_row)
    col1 = xp.minimum(col0 + 1, last_col)
    row1 = xp.minimum(row0 + 1, last_row)
    share_x = bounded(xp, across - xp.astype(col0, t.dtype), 0.0, 1.0)
    share_y = bounded(xp, down - xp.astype(row0, t.dtype), 0.0, 1.0)
    first = level * (shape.rows * shape.cols)

    def value(row: Array, col: Array) -> Array:
        return t.clearance[first + row * shape.cols + col]

    upper = value(row0, col0) * (1 - share_x) + value(row0, col1) * share_x
    lower = value(row1, col0) * (1 - share_x) + value(row1, col1) * share_x
    return xp.where(found.inside, upper * (1 - share_y) + lower * share_y, xp.nan)


def _value(
    t: GridTensors, layer: Array, outside: float, positions: Array, scene_id: Array | int | None
) -> Array:
    """The values of a layer in the cells of positions."""

    def answer(p: Array, scenes: Array) -> Array:
        found = locate(t, p, scenes)
        return t.xp.where(found.inside, layer[found.cell], outside)

    return _ask(t, answer, positions, scene_id)


def _ask(
    t: GridTensors,
    answer: Callable[..., Array],
    positions: Array,
    scene_id: Array | int | None,
) -> Array:
    p = check_positions(t, positions)
    return answer_all(t, answer, p, check_scenes(t, scene_id, p.shape[:-1]))
