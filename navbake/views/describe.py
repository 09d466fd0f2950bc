"""Describes a grid, and one of its cells, as JSON; from the file alone."""

import numpy as np

from navbake.errors import QueryError
from navbake.navgrid.cells import check_positions
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.islands import find_islands
from navbake.navgrid.user_data import NAMES, names_in
from navbake.runtime.place import place_at
from navbake.types import Json

MADE_BY = {
    "version": "navbake",
    "mujoco": "mujoco",
    "sceneDigest": "scene_digest",
    "settingsDigest": "settings_digest",
}
AGENT = {
    "agentHeight": "height",
    "agentRadius": "radius",
    "traversableFloorHeight": "traversable_floor_height",
    "maxSlope": "max_slope",
}
INFLATION = ("radius", "clearance", "mode")


def describe(grid: NavGrid) -> Json:
    """Summarise a grid as JSON.

    ``agent`` and ``made_by`` are the agent's settings, and the versions and digests, as far as the
    file has them; ``levels`` begin with the lowest, in cells, m and m2, heights are world z, None
    without floor; ``links``, ``areas`` and ``agents`` are as in the file, areas with their ``m2``;
    ``inflated`` has radius and clearance [m] and mode of each inflation since the
    bake. For ``doors`` see `navbake.navgrid.doors.Door.to_json`.
    """
    islands, levels = find_islands(grid), []
    stated, noted = {**grid.metadata, **grid.navbake}, grid.metadata.get("inflation")
    for name, level, island in zip(grid.level_names, grid.levels, islands, strict=True):
        area = level.lattice.cell_size**2
        floor = level.floor[np.isfinite(level.floor)]
        sizes = np.bincount(island.ravel())[1:]
        levels.append(
            {
                "name": name,
                "width": level.width,
                "height": level.height,
                "ground": _rounded(level.ground),
                "floor_min": _rounded(floor.min()) if floor.size else None,
                "floor_max": _rounded(floor.max()) if floor.size else None,
                "floor_area": _rounded(floor.size * area),
                "free_area": _rounded(np.count_nonzero(level.free) * area),
                "num_islands": int(np.count_nonzero(sizes)),
                "largest_island_area": _rounded(sizes.max(initial=0) * area),
                "num_rooms": int(np.count_nonzero(np.unique(level.room_index))),
            }
        )
    cell_size = grid.levels[0].lattice.cell_size
    cells = np.sum([np.bincount(v.area_index.ravel(), minlength=256) for v in grid.levels], axis=0)
    return {
        "type": type(grid).__name__,
        "scene_id": grid.scene_id,
        "cell_size": cell_size,
        "agent": {name: stated[key] for key, name in AGENT.items() if key in stated},
        "made_by": {name: stated[key] for key, name in MADE_BY.items() if key in grid.navbake},
        "levels": levels,
        "num_islands": max(int(island.max(initial=0)) for island in islands),
        "num_steps": len(grid.step_array),
        "links": [link.to_json() for link in grid.links],
        "areas": [
            {**area.to_json(), "m2": _rounded(cells[number] * cell_size**2)}
            for number, area in enumerate(grid.areas, start=1)
        ],
        "agents": {name: agent.to_json() for name, agent in grid.agents.items()},
        "doors": [door.to_json() for door in grid.doors],
        # what `inflate` noted; a file of another program may have anything there
        "inflated": [
            {key: entry[key] for key in INFLATION}
            for entry in (noted if isinstance(noted, list) else [])
            if isinstance(entry, dict) and entry.keys() >= set(INFLATION)
        ],
        "warnings": list(grid.warnings),
    }


def _rounded(value: float) -> float:
    """To a millionth, finer than float32 heights are, so that 2.8 is not 2.799999952."""
    return round(float(value), 6) + 0.0  # + 0.0 turns -0.0 into 0.0


def describe_cell(grid: NavGrid, x: float, y: float, level: int | None = None) -> Json:
    """Describe the cell at a position; the grid's method says what it takes and raises.

    Returns:
        ``level``, ``row``, ``col``, ``cell`` (its id), ``center`` (world x, y [m]), ``floor``
        (world z [m], None for none), ``free``, ``occupied``, ``weight`` (None for infinite),
        ``room`` (its entry in the grid's `rooms`, else its index, None for none), ``island``
        (from 1, the largest; None where it isn't free), ``area`` (its name, None for none) and
        ``links`` (names of those with a stop in it); names of what stands in the cell: ``doors``,
        ``objects``, ``walls``, and of what blocks it, if stated: ``blockers``.
    """
    place = place_at(grid, (x, y), level)
    if place is None:
        x0, y0, x1, y1 = grid.levels[level or 0].lattice.bounds
        span = f"it spans x {x0:g} to {x1:g}, y {y0:g} to {y1:g}"
        raise QueryError(f"{x:g}, {y:g} lies beside level {level or 0}: {span}")
    number, row, col = place.cell
    here = grid.levels[number]
    cell, index = row * here.width + col, int(here.room_index[row, col])
    entry = here.user_data.get(cell, {})
    names = {key: sorted(names_in(entry, key)) for key in NAMES}
    standing = sorted(set().union(*names.values()))
    rooms = (room.to_json() for room in grid.rooms if (room.level, room.index) == (number, index))
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
        "room": next(rooms, index or None),
        "island": place.island,
        "area": place.area,
        "links": [
            link.name
            for link in grid.links
            if any((stop.level, stop.cell) == (number, cell) for stop in link.stops)
        ],
        **names,
        # a file lists blockers only where they differ from all that stands in the cell
        "blockers": [] if place.free else sorted(names_in(entry, "blockers")) or standing,
    }


def describe_column(grid: NavGrid, x: float, y: float) -> list[Json]:
    """Describe the cell at a world position [m] on each level that spans it, lowest first.

    Raises a QueryError if the position is no number, or beside all levels.
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
