"""What a grid knows of one cell, and why an agent can't stand there; from the file alone."""

from navbake.errors import QueryError
from navbake.navgrid.cells import check_positions
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.user_data import NAMES, names_in
from navbake.runtime.places.place import place_at
from navbake.types import Json


def describe_cell(grid: NavGrid, x: float, y: float, level: int | None = None) -> Json:
    """Describe the cell at a position; the grid's method says what it takes and raises.

    Returns:
        ``level``, ``row``, ``col``, ``cell`` (its id), ``center`` (world x, y [m]), ``floor``
        (world z [m], None for none), ``free``, ``occupied``, ``weight`` (None for infinite),
        ``room`` (its entry in the grid's `rooms`, else its index, None for none), ``island``
        (from 1, the largest; None where it isn't free), ``doors``, ``objects``, ``walls``: names
        of what stands in the cell; ``blockers``: names of what blocks it, as far as the file
        states them.
    """
    place = place_at(grid, (x, y), level)
    if place is None:
        x0, y0, x1, y1 = grid.levels[level or 0].lattice.bounds
        raise QueryError(
            f"{x:g}, {y:g} lies beside level {level or 0}: "
            f"it spans x {x0:g} to {x1:g}, y {y0:g} to {y1:g}"
        )
    number, row, col = place.cell
    here = grid.levels[number]
    cell = row * here.width + col
    entry = here.user_data.get(cell, {})
    names = {key: sorted(names_in(entry, key)) for key in NAMES}
    standing = sorted(set().union(*names.values()))
    return {
        "level": number,
        "row": row,
        "col": col,
        "cell": cell,
        "center": [float(v) for v in here.lattice.positions(row, col)],
        "floor": place.floor,
        "free": place.free,
        "occupied": place.occupied,
        "weight": place.weight if place.free else None,
        "room": _room(grid, number, int(here.room_index[row, col])),
        "island": place.island,
        **names,
        # a file lists blockers only where they differ from all that stands in the cell
        "blockers": [] if place.free else sorted(names_in(entry, "blockers")) or standing,
    }


def describe_column(grid: NavGrid, x: float, y: float) -> list[Json]:
    """Describe the cell at a world position [m] on each level that spans it, lowest first.

    Raises:
        QueryError: the position is no number, or beside all levels.
    """
    check_positions((x, y), 1)
    found, beside = [], []
    for level in range(len(grid.levels)):
        try:
            found.append(describe_cell(grid, x, y, level))
        except QueryError as error:
            beside.append(str(error))
    if not found:
        raise QueryError("; ".join(beside))
    return found


def _room(grid: NavGrid, level: int, index: int) -> Json | int | None:
    for room in grid.rooms:
        if (room.level, room.index) == (level, index):
            return room.to_json()
    return index or None
