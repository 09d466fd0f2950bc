"""Grids as buildings of Open-RMF's traffic editor (``.building.yaml``), in metres.

A level has its floor as polygons with holes, walls along the outlines of what is wall, doors with
their way of moving, the lanes of a graph of routes, and the building the lifts whose cars are
known. A level is flat, at the height of most of its floor; what is up to 1 m off is laid flat, too.
Stairs, furniture, rooms and other links have no place in the format and are left out.

Source: open-rmf/rmf_traffic_editor, ``rmf_building_map_tools/building_map``. Its scenes are read by
`navbake.baker.readers.building`.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from navbake.formats.shapes import trace_polygons
from navbake.formats.source import Files, import_extra
from navbake.lazy import lazy
from navbake.navgrid.door_states import DoorLine, doorway_cells, find_door_lines
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import rounded
from navbake.navgrid.links import Link
from navbake.navgrid.rooms import Door
from navbake.types import Json
from navbake.yaml_text import encode_yaml

shapely = lazy("shapely")
routes = lazy("navbake.routes.build")

LOG = logging.getLogger(__name__)
WALL = 0.1  # thickness that simulators give walls [m]
GAP = 0.1  # of a lift's shaft round its car, in which there are no walls [m]
DECIMALS = 4
# types of values in the format
TEXT = 1
WHOLE = 2
REAL = 3
TRUE = 4
FLAT = 1.0  # how far a floor that is laid flat may be off the elevation [m]
SLIDES = 0.25  # share of a door's width that an open leaf may stand off its line if it slides


class _Level:
    """The vertices and edges of one level."""

    def __init__(self, elevation: float) -> None:
        self.numbers: dict[tuple[float, float, str], int] = {}
        kinds = ("doors", "floors", "holes", "lanes", "walls")
        self.content: Json = {"elevation": round(elevation, DECIMALS), **{k: [] for k in kinds}}

    def vertex(self, x: float, y: float, name: str = "") -> int:
        place = rounded(x, DECIMALS), rounded(y, DECIMALS), name
        return self.numbers.setdefault(place, len(self.numbers))


def encode_building(grid: NavGrid, path: Path) -> Files:
    """Encode a grid as a building; raises a MissingDependencyError without shapely."""
    import_extra("shapely")
    names = list(grid.level_names)
    if len({*names}) < len(names):
        names = [f"level {number}" for number in range(len(names))]
    levels = [_Level(_elevation(level)) for level in grid.levels]
    lifts = [link for link in grid.links if link.kind == "lift"]
    for number, (level, own) in enumerate(zip(grid.levels, levels, strict=True)):
        with np.errstate(invalid="ignore"):
            is_floor = np.abs(level.floor - own.content["elevation"]) <= FLAT
        for rings in trace_polygons(is_floor.astype(np.uint8), level.lattice).get(1, []):
            for k, ring in enumerate(rings):
                vertices = [own.vertex(x, y) for x, y in ring.tolist()]
                part = {"parameters": {}, "vertices": vertices}
                own.content["holes" if k else "floors"].append(part)
        _add_walls(own, grid, number, lifts)
        doors = {door.id: door for door in grid.doors}
        for line in _join_leaves(find_door_lines(grid, number)):
            own.content["doors"].append(_door(own, line, doors, level, number))
    _add_lanes(levels, grid)
    known = {link.name: _lift(link, grid, names) for link in lifts if link.car is not None}
    lost = [f"the link {link.name!r}" for link in grid.links if link.name not in known]
    lost += ["steps between levels"] if len(grid.step_array) else []
    lost += ["areas"] if grid.areas else []
    if lost:
        LOG.warning("buildings of Open-RMF have no place for %s: left out", ", ".join(lost))
    for own in levels:
        own.content["vertices"] = [[x, y, 0, name, {}] for x, y, name in own.numbers]
    content = {
        "building_name": grid.scene_id or "building",
        "coordinate_system": "cartesian_meters",
        "levels": {name: own.content for name, own in zip(names, levels, strict=True)},
        "lifts": known,
    }
    return {path: encode_yaml(content)}


def _elevation(level: SceneGrid2D) -> float:
    """The height of most of a level's free floor, to a centimetre; else its ground [m]."""
    floor = level.floor[level.free & ~np.isnan(level.floor)]
    if not len(floor):
        return level.ground
    heights, count = np.unique(np.round(floor, 2), return_counts=True)
    return float(heights[count.argmax()])


def _add_walls(own: _Level, grid: NavGrid, number: int, lifts: Iterable[Link]) -> None:
    """Add walls along the outlines of what is wall, half their thickness inside of it."""
    level = grid.levels[number]
    named = np.zeros(level.shape, dtype=np.bool_)
    for cell, entry in level.user_data.items():
        named.flat[cell] = bool(entry.get("walls"))
    walls = level.solid != 0
    walls &= named if named.any() else ~np.isnan(level.floor)
    walls &= ~doorway_cells(grid, number, blocked=False)
    x, y = np.meshgrid(level.lattice.center_x(), level.lattice.center_y())
    for car in filter(None, (link.car for link in lifts)):
        along, aside = _to_car(car, x, y)
        walls &= (abs(along) > car[3] / 2 + GAP) | (abs(aside) > car[4] / 2 + GAP)
    parts = trace_polygons(walls.astype(np.uint8), level.lattice).get(1, [])
    for rings in parts:
        area = shapely.Polygon(rings[0], rings[1:]).simplify(level.lattice.cell_size / 2)
        for ring in _inside(area, level.lattice.cell_size):
            corners = [own.vertex(x, y) for x, y in ring.coords]
            pairs = [pair for pair in pairwise(corners) if pair[0] != pair[1]]
            own.content["walls"] += [[*pair, {}] for pair in pairs]


def _inside(area: Any, cell_size: float) -> Iterator[Any]:
    """Rings inside of an area: half a wall and half a cell, less where it is narrower than that.

    A blocked cell is one that a wall touches, so walls end half a cell inside of them on average.
    """
    left = [area]
    full = (WALL + cell_size) / 2
    for inset in (full, 0.95 * full, 0.75 * full, full / 2, full / 4, 0.0):
        parts = left
        left = []
        for part in parts:
            inner = part.buffer(-inset, join_style="mitre")
            for polygon in shapely.get_parts(inner):
                yield from (polygon.exterior, *polygon.interiors)
            rest = part.difference(inner.buffer(1.05 * inset, join_style="mitre"))
            left += [one for one in shapely.get_parts(rest) if one.area > cell_size**2]


def _to_car(car: tuple[float, ...], x: Any, y: Any) -> tuple[Any, Any]:
    """World x and y in the frame of a lift's car [m]."""
    cos = math.cos(car[2])
    sin = math.sin(car[2])
    dx = x - car[0]
    dy = y - car[1]
    return dx * cos + dy * sin, dy * cos - dx * sin


def _join_leaves(lines: Iterable[DoorLine]) -> list[tuple[str, list[DoorLine]]]:
    """Doors by name, with their leaves: ``NAME_right`` and ``NAME_left`` are one door's."""
    lines = list(lines)
    ids = {line.id for line in lines}
    doors: dict[str, list[DoorLine]] = {}
    for line in lines:
        stem, _, side = line.id.rpartition("_")
        is_leaf = side in ("right", "left") and {f"{stem}_right", f"{stem}_left"} <= ids
        doors.setdefault(stem if is_leaf else line.id, []).append(line)
    return list(doors.items())


def _door(
    own: _Level,
    line: tuple[str, list[DoorLine]],
    doors: dict[str, Door],
    level: SceneGrid2D,
    number: int,
) -> list[Any]:
    """The edge of a door, from its hinge: how it moves is read from the cells of its open leaf."""
    name, leaves = line
    ends = np.array([end for leaf in leaves for end in (leaf.start, leaf.end)])
    apart = np.linalg.norm(ends[:, None] - ends[None], axis=2)
    start, end = ends[list(np.unravel_index(int(apart.argmax()), apart.shape))]
    width = float(np.hypot(*(end - start)))
    back = (start - end) / max(width, 1e-9)
    aside = np.array([-back[1], back[0]])
    is_double = len(leaves) > 1
    kind = "hinged"
    direction = 1
    axis = "start"
    first = doors[leaves[0].id]
    cells = first.solid_in("open", number + 1)[number]
    cells = cells if len(cells) else first.cells_in("open", number + 1)[number]
    opened = level.lattice.positions(*np.divmod(cells, level.width))
    # without open cells it slides into a wall, but for one that may swing out of the grid
    if not len(opened) and "open" in first.cells and None not in first.rooms:
        kind = "sliding"
    elif len(opened):
        off = (opened - (start + end) / 2).mean(axis=0)
        direction = 1 if off @ aside >= 0 else -1
        if abs(off @ aside) < SLIDES * width / len(leaves):
            kind = "sliding"
        if not is_double:
            axis = "start" if off @ back >= 0 else "end"
    values = {
        "name": [TEXT, name],
        "type": [TEXT, f"double_{kind}" if is_double else kind],
        "motion_axis": [TEXT, axis],
        "motion_degrees": [REAL, 90.0],
        "motion_direction": [WHOLE, direction if axis == "start" else -direction],
        "right_left_ratio": [REAL, 1.0],
    }
    return [own.vertex(*start), own.vertex(*end), values]


def _add_lanes(levels: list[_Level], grid: NavGrid) -> None:
    """Add the lanes of the grid's graph of routes on each level."""
    graph = routes.make_routes(grid)
    for lane in graph.lanes:
        ends = [graph.nodes[end] for end in (lane.start, lane.end)]
        if ends[0].level != ends[1].level or lane.link is not None:
            continue
        own = levels[ends[0].level]
        one, other = (own.vertex(*node.position[:2], node.name) for node in ends)
        values = {"bidirectional": [TRUE, lane.two_way], "graph_idx": [WHOLE, 0]}
        if lane.speed is not None:
            values["speed_limit"] = [REAL, lane.speed]
        own.content["lanes"].append([one, other, values])


def _lift(link: Link, grid: NavGrid, names: list[str]) -> Json:
    """The entry of a lift: its car, and a door at each side with a stop."""
    assert link.car is not None
    x, y, yaw, width, depth = link.car
    doors: Json = {}
    level_doors: dict[str, list[str]] = {}
    initial = None
    for stop in link.stops:
        along, aside = _to_car(link.car, *stop.position[:2])
        if abs(along) - width / 2 >= abs(aside) - depth / 2:
            at = (math.copysign(width / 2, along), 0.0)
            turn = math.pi / 2
            side = "right" if along > 0 else "left"
        else:
            at = (0.0, math.copysign(depth / 2, aside))
            turn = 0.0
            side = "front" if aside > 0 else "back"
        opening = min(link.width or 1.0, (depth if turn else width) - 2 * GAP)
        doors[side] = {
            "door_type": 2, "x": round(at[0], DECIMALS), "y": round(at[1], DECIMALS),
            "width": round(opening, DECIMALS), "motion_axis_orientation": round(turn, 6),
        }  # fmt: skip
        listed = level_doors.setdefault(names[stop.level], [])
        listed += [] if side in listed else [side]
        level = grid.levels[stop.level]
        cell = level.lattice.rows_cols(np.array([x, y]))
        if initial is None and np.isfinite(level.floor[tuple(cell)]):
            initial = names[stop.level]
    return {
        "x": x, "y": y, "yaw": yaw, "width": width, "depth": depth,
        "initial_floor_name": initial or next(iter(level_doors)),
        "lowest_floor": names[min(stop.level for stop in link.stops)],
        "highest_floor": names[max(stop.level for stop in link.stops)],
        "level_doors": level_doors, "doors": doors,
    }  # fmt: skip
