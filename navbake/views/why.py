"""What a grid knows of one place, and why an agent can't stand there; from the file alone."""

from __future__ import annotations

import math
from numbers import Real
from typing import TYPE_CHECKING, Any

from navbake.errors import QueryError
from navbake.navgrid.door_states import NAMES
from navbake.navgrid.islands import islands_of

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid, SceneGrid2D


def describe_cell(grid: NavGrid, x: float, y: float, level: int | None = None) -> dict[str, Any]:
    """Tell what a grid knows of the cell at a place.

    Args:
        grid: the grid.
        x, y: world position [m].
        level: which level, 0 is the lowest; may be left out where there is but one.

    Returns:
        ``level``, ``row``, ``col``, ``cell`` (its id), ``center`` (world x, y [m]), ``floor``
        (world z [m], None for none), ``free``, ``occupied``, ``weight`` (None for infinite),
        ``room`` (its entry in the grid's `rooms`, else its index, None for none), ``island``
        (from 1, the largest; None where it isn't free), ``doors``, ``objects``, ``walls``: names
        of what stands in the cell; ``blockers``: names of what blocks it, where the file tells.

    Raises:
        QueryError: there is no such level, or the position is no number or beside the grid.
    """
    if level is None and len(grid.levels) > 1:
        raise QueryError(f"expected a level of {grid.scene_id!r}, 0 to {len(grid.levels) - 1}")
    level = level or 0
    part = _level(grid, level)
    row, col = _cell(part, x, y, level)
    entry = part.user_data.get(row * part.width + col, {})
    floor, weight = float(part.floor_height[row, col]), float(part.weights[row, col])
    free = math.isfinite(weight)
    names = {key: sorted(_strings(entry.get(key))) for key in NAMES}
    return {
        "level": level,
        "row": row,
        "col": col,
        "cell": row * part.width + col,
        "center": [float(v) for v in part.lattice.positions(row, col)],
        "floor": None if math.isnan(floor) else floor * part.unit,
        "free": free,
        "occupied": bool(part.occupancy[row, col]),
        "weight": weight if free else None,
        "room": _room(grid, level, int(part.room_index[row, col])),
        "island": int(islands_of(grid)[level][row, col]) if free else None,
        **names,
        "blockers": [] if free else _blockers(entry, names),
    }


def describe_column(grid: NavGrid, x: float, y: float) -> list[dict[str, Any]]:
    """Tell what a grid knows of a place on each level that spans it.

    Args:
        grid: the grid.
        x, y: world position [m].

    Returns:
        `describe_cell` of each, lowest first, at least one.

    Raises:
        QueryError: the position is no number, or beside all levels.
    """
    beside = []
    found = []
    for level in range(len(grid.levels)):
        try:
            found.append(describe_cell(grid, x, y, level))
        except QueryError as error:
            beside.append(str(error))
    if not found:
        raise QueryError(beside[0] if len(set(beside)) == 1 else "; ".join(beside))
    return found


def _level(grid: NavGrid, level: int) -> SceneGrid2D:
    if not 0 <= level < len(grid.levels):
        raise QueryError(
            f"no level {level} in {grid.scene_id!r}: expected 0 to {len(grid.levels) - 1}"
        )
    return grid.levels[level]


def _cell(part: SceneGrid2D, x: float, y: float, level: int) -> tuple[int, int]:
    are_numbers = all(isinstance(v, Real) for v in (x, y))
    if not (are_numbers and math.isfinite(x) and math.isfinite(y)):
        raise QueryError(f"expected a position of finite numbers, got {x}, {y}")
    row, col = (int(v) for v in part.lattice.rows_cols([x, y]))
    if 0 <= row < part.height and 0 <= col < part.width:
        return row, col
    x0, y0, x1, y1 = part.lattice.bounds
    raise QueryError(
        f"{x:g}, {y:g} lies beside level {level}: it spans x {x0:g} to {x1:g}, y {y0:g} to {y1:g}"
    )


def _room(grid: NavGrid, level: int, index: int) -> Any:
    if index == 0:
        return None
    found = [room for room in grid.rooms if (room.level, room.index) == (level, index)]
    return found[0].to_json() if found else index


def _blockers(entry: dict[str, Any], names: dict[str, list[str]]) -> list[str]:
    """A file says it where it differs from all that stands there."""
    stated = entry.get("blockers")
    return sorted(_strings(stated)) if stated else sorted({n for key in NAMES for n in names[key]})


def _strings(value: Any) -> list[str]:
    return [v for v in value if isinstance(v, str)] if isinstance(value, list) else []
