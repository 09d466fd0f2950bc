"""Describes a grid and its cells as JSON, and lists links and stairs for pictures."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.lengths import format_bounds, format_length, format_position
from navbake.navgrid.cells import check_positions, describe_outside, place_at
from navbake.navgrid.colors import LINK, LINK_CLOSED, STAIRS
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.islands import find_islands, group_steps
from navbake.navgrid.links import Area, Link
from navbake.navgrid.user_data import NAME_KEYS, names_in
from navbake.types import Float, Int, Int32, Json
from navbake.views.tables import Table, make_table

# key of a file's metadata -> its key in the result of `describe`
MADE_BY_KEYS = {
    "version": "navbake",
    "mujoco": "mujoco",
    "sceneDigest": "scene_digest",
    "settingsDigest": "settings_digest",
}
AGENT_KEYS = {
    "agentHeight": "height",
    "agentRadius": "radius",
    "traversableFloorHeight": "traversable_floor_height",
    "maxSlope": "max_slope",
}
INFLATION_KEYS = ("radius", "clearance", "mode")
STAIR = "stair"
STEEP_RAMP = "steep"
# largest distance of an arc from its straight line, relative to the length of the line
ARC_BULGE = 0.15
NUM_ARC_POINTS = 17  # number of points of an arc
BOX_ROUNDING = 2e-4  # a file rounds boxes outwards to 0.1 mm, and floors to float32 [m]
LEAST_RISE = 1e-3  # a thing whose top is nearer than this to the floor carries it [m]


def describe(grid: NavGrid) -> Json:
    """Summarise a grid as JSON.

    Args:
        grid: a grid of one or several levels.

    Returns:
        - ``type``, ``scene_id``, ``cell_size`` [m], ``num_islands``, ``num_steps``, ``warnings``
        - ``agent``, ``made_by``: settings of the agent, and versions and digests, as far as the
          file has these
        - ``levels``: the lowest first; lengths in cells, areas in m2, heights as world z [m], None
          without a floor
        - ``links``, ``areas``, ``agents``: as in the file; an area also has its size, ``m2`` [m²]
        - ``doors``: see `navbake.navgrid.rooms.Door.to_json`
        - ``inflated``: radius and clearance [m] and mode of each inflation since the bake
    """
    metadata = {**grid.metadata, **grid.navbake}
    island_layers = find_islands(grid)
    levels = []
    for name, level, island_of_cell in zip(
        grid.level_names, grid.levels, island_layers, strict=True
    ):
        levels.append(_describe_level(name, level, island_of_cell))
    return {
        "type": type(grid).__name__,
        "scene_id": grid.scene_id,
        "cell_size": grid.levels[0].lattice.cell_size,
        "agent": {name: metadata[key] for key, name in AGENT_KEYS.items() if key in metadata},
        "made_by": {
            name: metadata[key] for key, name in MADE_BY_KEYS.items() if key in grid.navbake
        },
        "levels": levels,
        "num_islands": max(int(island_of_cell.max(initial=0)) for island_of_cell in island_layers),
        "num_steps": len(grid.step_array),
        "links": [link.to_json() for link in grid.links],
        "areas": _describe_areas(grid),
        "agents": {name: agent.to_json() for name, agent in grid.agents.items()},
        "doors": [door.to_json() for door in grid.doors],
        "inflated": _list_inflations(grid),
        "warnings": list(grid.warnings),
    }


def _describe_level(name: str, level: SceneGrid2D, island_of_cell: Int32) -> Json:
    """Summarise a level as JSON: its size, heights and areas, and its numbers of islands and rooms.

    Args:
        name: the level's name.
        level: the level.
        island_of_cell: the number of each cell's island, 0 for none, shape (height, width).
    """
    cell_area = level.lattice.cell_size**2
    floor_heights = level.floor[np.isfinite(level.floor)]
    island_sizes = np.bincount(island_of_cell.ravel())[1:]
    return {
        "name": name,
        "width": level.width,
        "height": level.height,
        "ground": _round_to_millionth(level.ground),
        "floor_min": _round_to_millionth(floor_heights.min()) if floor_heights.size else None,
        "floor_max": _round_to_millionth(floor_heights.max()) if floor_heights.size else None,
        "floor_area": _round_to_millionth(floor_heights.size * cell_area),
        "free_area": _round_to_millionth(np.count_nonzero(level.free) * cell_area),
        "num_islands": int(np.count_nonzero(island_sizes)),
        "largest_island_area": _round_to_millionth(island_sizes.max(initial=0) * cell_area),
        "num_rooms": int(np.count_nonzero(np.unique(level.room_index))),
    }


def _describe_areas(grid: NavGrid) -> list[Json]:
    """Describe each area of a grid; its size is that on all levels together [m²]."""
    area_sizes_by_level = [
        np.bincount(level.area_index.ravel(), minlength=256) * level.lattice.cell_size**2
        for level in grid.levels
    ]
    area_sizes = np.sum(area_sizes_by_level, axis=0)
    return [
        {**area.to_json(), "m2": _round_to_millionth(area_sizes[area_number])}
        for area_number, area in enumerate(grid.areas, start=1)
    ]


def _list_inflations(grid: NavGrid) -> list[Json]:
    """List the inflations in a grid's metadata; entries that `inflate` hasn't made are left out."""
    inflations = grid.metadata.get("inflation")
    if not isinstance(inflations, list):
        return []
    return [
        {key: inflation[key] for key in INFLATION_KEYS}
        for inflation in inflations
        if isinstance(inflation, dict) and inflation.keys() >= set(INFLATION_KEYS)
    ]


def _round_to_millionth(value: float) -> float:
    """Round to a millionth, so that the float32 of 2.8 is not shown as 2.799999952."""
    return round(float(value), 6) + 0.0  # + 0.0 turns -0.0 into 0.0


def describe_cell(grid: NavGrid, position: ArrayLike, level: int | None = None) -> Json:
    """Describe the cell at a position.

    Args:
        grid: a grid of one or several levels.
        position: world x, y, z [m], shape (3,); x, y with a level or on a grid of one level.
        level: the number of the level, 0 is the lowest; None to find it by z.

    Returns:
        - ``level``, ``row``, ``col``, ``cell`` (its id), ``center`` (world x, y [m])
        - ``floor``: world z of the floor [m], None without a floor
        - ``free``, ``occupied``, ``weight`` (None for infinite)
        - ``room``: the room as in `NavGrid.rooms`; the room's index if it isn't listed there; None
          outside of rooms
        - ``island``: the island's number, 1 for the largest; None where the cell isn't free
        - ``area``: the area's name, None outside of areas
        - ``links``: the names of the links that have a stop in the cell
        - ``doors``, ``objects``, ``walls``: names of what stands in the cell
        - ``blockers``: names of what blocks the cell, as far as they are known
        - ``lower_than_step``: names of what rises over the floor of a free cell by no more than the
          grid's highest step, so that it is no obstacle, as far as the file has the heights of
          things

    Raises:
        QueryError: the level does not exist, or the position is not valid or in no cell.
    """
    place = place_at(grid, position, level)
    if place is None:
        coordinates = np.asarray(position, dtype=np.float64).tolist()
        if level is None:
            outside_text = describe_outside(grid, position)
        else:
            bounds_text = format_bounds(grid.levels[level].lattice.bounds)
            outside_text = f"lies beside level {level}: it spans {bounds_text}"
        raise QueryError(
            f"{format_position(coordinates)} {outside_text}",
            key="position",
            value=tuple(coordinates),
        )
    level_number, row, col = place.cell
    level_grid = grid.levels[level_number]
    cell_id = row * level_grid.width + col
    user_data = level_grid.user_data.get(cell_id, {})
    occupants = {kind: sorted(names_in(user_data, kind)) for kind in NAME_KEYS}
    blockers = []
    if not place.free:
        # a file lists blockers only where they differ from all occupants of the cell
        blockers = sorted(names_in(user_data, "blockers"))
        blockers = blockers or sorted(set().union(*occupants.values()))
    lower_than_step = []
    if place.free and place.floor is not None:
        names = sorted(set().union(*occupants.values()))
        lower_than_step = _find_lower_than_step(grid, names, place.floor)
    return {
        "level": level_number,
        "row": row,
        "col": col,
        "cell": cell_id,
        "center": [float(coordinate) for coordinate in level_grid.lattice.positions(row, col)],
        "floor": place.floor,
        "free": place.free,
        "occupied": place.occupied,
        "weight": place.weight if place.free else None,
        "room": _describe_room(grid, level_number, int(level_grid.room_index[row, col])),
        "island": place.island,
        "area": place.area,
        "links": [
            link.name
            for link in grid.links
            if any((stop.level, stop.cell) == (level_number, cell_id) for stop in link.stops)
        ],
        **occupants,
        "blockers": blockers,
        "lower_than_step": lower_than_step,
    }


def _find_lower_than_step(grid: NavGrid, names: Sequence[str], floor: float) -> list[str]:
    """Return which things rise over a floor, and by no more than the grid's highest step.

    Args:
        grid: the grid.
        names: names of the things; those whose box the file doesn't have are left out.
        floor: world z of the floor [m].
    """
    boxes = grid.name_boxes
    return [
        name
        for name in names
        if name in boxes and LEAST_RISE < boxes[name][5] - floor <= grid.max_step + BOX_ROUNDING
    ]


def _describe_room(grid: NavGrid, level: int, room_index: int) -> Json | int | None:
    """Describe the room that has an index on a level; return the index if no such room is listed.

    None for the index 0, which stands for no room.
    """
    for room in grid.rooms:
        if (room.level, room.index) == (level, room_index):
            return room.to_json()
    return room_index or None


def describe_column(grid: NavGrid, x: float, y: float) -> list[Json]:
    """Describe the cell at a position on each level that extends there.

    Args:
        grid: a grid of one or several levels.
        x: world x [m].
        y: world y [m].

    Returns:
        The description of each cell, see `describe_cell`; the lowest level first.

    Raises:
        QueryError: the position is not finite, or lies outside of all levels.
    """
    check_positions((x, y), 1)
    cell_descriptions = []
    error_texts = []
    for level in range(len(grid.levels)):
        try:
            cell_descriptions.append(describe_cell(grid, (x, y), level))
        except QueryError as error:
            error_texts.append(str(error))
    if not cell_descriptions:
        raise QueryError("; ".join(error_texts))
    return cell_descriptions


# --- links and stairs -----------------------------------------------------------------------------


class StopPoint(NamedTuple):
    """A point where a link or stair begins, stops or ends."""

    level: int  # number of the level, 0 is the lowest
    x: float  # world x [m]
    y: float  # world y [m]
    z: float  # world z [m]

    @property
    def position(self) -> tuple[float, float, float]:
        """The point as world x, y, z [m]."""
        return self.x, self.y, self.z


class Connection(NamedTuple):
    """A connection between places, as pictures show it: a named link, a stair or a steep ramp.

    The grid's table of steps lists pairs of cells between which agents can go. A stair is a group
    of such pairs between the same two levels, whose first cells touch each other. A steep ramp is
    a group within one level.

    Attributes:
        name: the link's name; for a stair or ramp, its kind and number, such as ``stair 1``.
        kind: the link's kind; or `STAIR` or `STEEP_RAMP`.
        stops: the link's stops; for a stair or ramp, the mean positions of its two ends.
        link: the link; None for a stair or ramp.
        num_steps: the number of pairs of cells of the stair or ramp (not of treads); 0 for a link.
    """

    name: str
    kind: str
    stops: tuple[StopPoint, ...]
    link: Link | None
    num_steps: int = 0

    @property
    def is_closed(self) -> bool:
        """Whether the connection is a closed link."""
        return self.link is not None and self.link.state == "closed"

    @property
    def is_one_way(self) -> bool:
        """Whether agents may use the connection only from its first stop to its last."""
        return self.link is not None and self.link.one_way

    @property
    def color(self) -> str:
        """The colour in which scenes show the connection, as ``#rrggbb``."""
        if self.link is None:
            return STAIRS
        return LINK_CLOSED if self.is_closed else LINK

    def label(self) -> str:
        """Return the connection's name for pictures; ``(closed)`` follows that of a closed link."""
        return f"{self.name} (closed)" if self.is_closed else self.name


def find_connections(grid: NavGrid) -> list[Connection]:
    """List a grid's connections: links in the file's order, then stairs, then steep ramps."""
    connections = []
    for link in grid.links:
        stops = tuple(StopPoint(stop.level, *stop.position) for stop in link.stops)
        connections.append(Connection(link.name, link.kind, stops, link))
    return [*connections, *_find_stairs(grid)]


def _find_stairs(grid: NavGrid) -> Iterator[Connection]:
    """Find the stairs, then the steep ramps.

    Steps from touching cells between the same two levels make one stair. Within one level, they
    make a steep ramp.
    """
    count_of_kind = {STAIR: 0, STEEP_RAMP: 0}
    # each row is a step: level and cell of one end, level and cell of the other end
    step_groups = group_steps(grid, grid.step_array)
    for steps in sorted(step_groups, key=lambda steps: bool(steps[0, 0] == steps[0, 2])):
        first_level = int(steps[0, 0])
        second_level = int(steps[0, 2])
        kind = STEEP_RAMP if first_level == second_level else STAIR
        count_of_kind[kind] += 1
        stops = (
            _mean_position(grid, first_level, steps[:, 1]),
            _mean_position(grid, second_level, steps[:, 3]),
        )
        yield Connection(f"{kind} {count_of_kind[kind]}", kind, stops, None, len(steps))


def _mean_position(grid: NavGrid, level: int, cells: Int) -> StopPoint:
    """Return the mean position of the floors of cells, which are given by their ids on a level."""
    rows, cols = np.divmod(cells, grid.levels[level].width)
    x, y = grid.levels[level].lattice.positions(rows, cols).mean(axis=0).tolist()
    z = float(grid.levels[level].floor_or_ground[rows, cols].mean())
    return StopPoint(level, x, y, z)


class Arc(NamedTuple):
    """A curved line that shows a connection, from one stop to the next one."""

    points: Float  # world x, y, z [m], shape (n, 3)
    color: str  # as ``#rrggbb``
    is_one_way: bool  # whether agents may use the connection only from the first to the last point


def list_arcs(grid: NavGrid, levels: Collection[int]) -> list[Arc]:
    """List the arcs of a grid's connections between stops on given levels.

    Args:
        grid: a grid of one or several levels.
        levels: the numbers of the levels; an arc with an end on another level is left out.

    Returns:
        The arcs, in the order of `find_connections`.
    """
    arcs = []
    for connection in find_connections(grid):
        for start, end in itertools.pairwise(connection.stops):
            if start.level in levels and end.level in levels:
                points = compute_arc(np.array(start.position), np.array(end.position))
                arcs.append(Arc(points, connection.color, connection.is_one_way))
    return arcs


def compute_arc(start: Float, end: Float) -> Float:
    """Compute points of an arc between two positions, along which a link is drawn.

    The arc bulges upward; or to the side, if it is steeper than 45 degrees.

    Args:
        start: position where the arc starts, world x, y, z, shape (3,) [m].
        end: position where the arc ends, world x, y, z, shape (3,) [m].

    Returns:
        World x, y, z of the points, from start to end, shape (`NUM_ARC_POINTS`, 3) [m].
    """
    displacement = end - start
    bulge_direction = np.array([0.0, 0.0, 1.0])
    horizontal_length = float(np.hypot(displacement[0], displacement[1]))
    if abs(displacement[2]) > horizontal_length:
        if horizontal_length > 1e-6:
            bulge_direction = np.array([-displacement[1], displacement[0], 0.0]) / horizontal_length
        else:
            bulge_direction = np.array([0.0, -1.0, 0.0])
    fractions = np.linspace(0.0, 1.0, NUM_ARC_POINTS)[:, None]
    # 4 t (1 - t) is a parabola: 0 at both ends, 1 in the middle
    bulge_offsets = (
        4 * fractions * (1 - fractions) * ARC_BULGE * np.linalg.norm(displacement) * bulge_direction
    )
    arc_points: Float = start + fractions * displacement + bulge_offsets
    return arc_points


def describe_area(area: Area) -> str:
    """Describe an area in a few words: ``lab: keep-out``, ``lobby: price 2, at most 0.6 m/s``."""
    facts = []
    if math.isinf(area.cost):
        facts.append("keep-out")
    elif area.cost != 1:
        facts.append(f"price {area.cost:g}")
    if area.speed is not None:
        facts.append(f"at most {area.speed:g} m/s")
    if area.agents is not None:
        facts.append(f"for {', '.join(area.agents) or 'nobody'}")
    return f"{area.name}: {', '.join(facts)}" if facts else area.name


def make_stair_table(grid: NavGrid) -> Table:
    """Make a table with a row for each stair and each steep ramp, see `Connection`."""
    rows = []
    for connection in find_connections(grid):
        if connection.link is not None:
            continue
        start, end = connection.stops
        rows.append(
            (
                connection.name,
                grid.level_names[start.level],
                grid.level_names[end.level],
                connection.num_steps,
                f"{format_length(start.x)}, {format_length(start.y)}",
            )
        )
    headings = ("name", "from", "to", "steps", "mean place x, y [m]")
    return make_table(headings, rows, numbers=("steps",))
