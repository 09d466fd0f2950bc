"""Describes a grid and its cells as JSON, and its links and stairs as pictures show them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from navbake.errors import QueryError
from navbake.navgrid.cells import check_positions, place_at
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.islands import find_islands, group_steps
from navbake.navgrid.links import Area, Link
from navbake.navgrid.user_data import NAMES, names_in
from navbake.types import Float, Json
from navbake.views.tables import Table, make_table

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
STAIR = "stair"
STEEP = "steep"
BULGE = 0.15  # how far an arc bends from the straight line, by its length
ARC = 17  # points of an arc

Place = tuple[int, float, float, float]
"""A level, and world x, y, z [m]."""


def describe(grid: NavGrid) -> Json:
    """Summarise a grid as JSON.

    ``agent`` and ``made_by`` are the agent's settings, and the versions and digests, as far as the
    file has them; ``levels`` begin with the lowest, in cells, m and m2, heights are world z, None
    without floor; ``links``, ``areas`` and ``agents`` are as in the file, areas with their ``m2``;
    ``inflated`` has radius and clearance [m] and mode of each inflation since the
    bake. For ``doors`` see `navbake.navgrid.rooms.Door.to_json`.
    """
    islands = find_islands(grid)
    levels = []
    stated = {**grid.metadata, **grid.navbake}
    noted = grid.metadata.get("inflation")
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
    sizes_of_areas = np.sum(
        [
            np.bincount(level.area_index.ravel(), minlength=256) * level.lattice.cell_size**2
            for level in grid.levels
        ],
        axis=0,
    )
    return {
        "type": type(grid).__name__,
        "scene_id": grid.scene_id,
        "cell_size": grid.levels[0].lattice.cell_size,
        "agent": {name: stated[key] for key, name in AGENT.items() if key in stated},
        "made_by": {name: stated[key] for key, name in MADE_BY.items() if key in grid.navbake},
        "levels": levels,
        "num_islands": max(int(island.max(initial=0)) for island in islands),
        "num_steps": len(grid.step_array),
        "links": [link.to_json() for link in grid.links],
        "areas": [
            {**area.to_json(), "m2": _rounded(sizes_of_areas[number])}
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
    cell = row * here.width + col
    index = int(here.room_index[row, col])
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
    found = []
    beside = []
    for level in range(len(grid.levels)):
        try:
            found.append(describe_cell(grid, x, y, level))
        except QueryError as error:
            beside.append(str(error))
    if not found:
        raise QueryError("; ".join(beside))
    return found


# --- links and stairs -----------------------------------------------------------------------------


class Way(NamedTuple):
    """A named link, or the steps side by side that make a stair or a steep ramp."""

    name: str
    kind: str
    places: tuple[Place, ...]  # its stops, or the middles of the steps' two ends
    link: Link | None  # None for steps
    num_steps: int = 0

    @property
    def is_closed(self) -> bool:
        return self.link is not None and self.link.state == "closed"

    @property
    def one_way(self) -> bool:
        return self.link is not None and self.link.one_way

    def label(self) -> str:
        """What stands at its stops."""
        return f"{self.name} (closed)" if self.is_closed else self.name


def find_ways(grid: NavGrid) -> list[Way]:
    """The named links in the file's order, then stairs, then steep ramps, by level."""
    stops = [tuple((stop.level, *stop.position) for stop in link.stops) for link in grid.links]
    links = [Way(one.name, one.kind, at, one) for one, at in zip(grid.links, stops, strict=True)]
    return [*links, *_find_stairs(grid)]


def _find_stairs(grid: NavGrid) -> Iterator[Way]:
    """Steps from one level to another that begin side by side are one stair."""
    count = {STAIR: 0, STEEP: 0}
    groups = group_steps(grid, grid.step_array)
    for some in sorted(groups, key=lambda steps: bool(steps[0, 0] == steps[0, 2])):
        pair = some[0, ::2].tolist()
        kind = STEEP if pair[0] == pair[1] else STAIR
        count[kind] += 1
        ends: list[Place] = []
        for on, at in zip(pair, (some[:, 1], some[:, 3]), strict=True):
            rows, cols = np.divmod(at, grid.levels[on].width)
            x, y = grid.levels[on].lattice.positions(rows, cols).mean(axis=0).tolist()
            ends.append((on, x, y, float(grid.levels[on].floor_or_ground[rows, cols].mean())))
        yield Way(f"{kind} {count[kind]}", kind, tuple(ends), None, len(some))


def bend(start: Float, end: Float) -> Float:
    """An arc from one position to another, shape (`ARC`, 3) [m].

    Between heights it bends to the side, else up.
    """
    along = end - start
    side = np.array([0.0, 0.0, 1.0])
    flat = float(np.hypot(along[0], along[1]))
    if abs(along[2]) > flat:
        side = np.array([-along[1], along[0], 0.0]) / flat if flat > 1e-6 else -np.eye(3)[1]
    t = np.linspace(0.0, 1.0, ARC)[:, None]
    arc: Float = start + t * along + 4 * t * (1 - t) * BULGE * np.linalg.norm(along) * side
    return arc


def describe_area(area: Area) -> str:
    """An area in a few words: ``lab: keep-out``, ``lobby: price 2, at most 0.6 m/s``."""
    facts = ["keep-out"] if math.isinf(area.cost) else []
    facts += [f"price {area.cost:g}"] if not facts and area.cost != 1 else []
    facts += [f"at most {area.speed:g} m/s"] if area.speed is not None else []
    facts += [] if area.agents is None else [f"for {', '.join(area.agents) or 'nobody'}"]
    return f"{area.name}: {', '.join(facts)}" if facts else area.name


def stair_table(grid: NavGrid) -> Table:
    """A row for each stair, and each steep ramp: its steps side by side, and their middle."""
    names = grid.level_names
    rows = []
    for way in find_ways(grid):
        if way.link is None:
            (one, x, y, _), (other, *_) = way.places
            place = f"{x:.2f}, {y:.2f}"
            rows.append((way.name, names[one], names[other], way.num_steps, place))
    headings = ("name", "from", "to", "steps", "mean place x, y [m]")
    return make_table(headings, rows, numbers=("steps",))
