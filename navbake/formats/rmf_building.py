"""Grids as buildings of Open-RMF's traffic editor (``.building.yaml``), in metres.

A level has its floor as polygons with holes, walls along the outlines of wall cells, doors that
swing or slide, and the lanes of a graph of routes; the building has the lifts with a car. A level
is flat, at the height of most of its floor; floors that are up to 1 m higher or lower are moved to
that height.
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
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from navbake.formats.shapes import trace_polygons
from navbake.formats.source import Files, import_extra
from navbake.lazy import lazy
from navbake.navgrid.door_states import DoorLine, find_door_lines, mark_door_cells
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import rounded
from navbake.navgrid.links import Link
from navbake.navgrid.rooms import Door
from navbake.types import Float, Json
from navbake.yaml_text import encode_yaml

if TYPE_CHECKING:
    from shapely import LinearRing
    from shapely.geometry.base import BaseGeometry

shapely = lazy("shapely")
routes = lazy("navbake.routes.build")

LOG = logging.getLogger(__name__)
WALL_THICKNESS = 0.1  # that simulators give walls [m]
SHAFT_GAP = 0.1  # between a lift's car and the walls of its shaft [m]
DECIMALS = 4  # of coordinates
# types of values in the format
TEXT_TYPE = 1
INTEGER_TYPE = 2
REAL_TYPE = 3
BOOLEAN_TYPE = 4
MAX_HEIGHT_OFF = 1.0  # by which a floor may be off the elevation if it is laid flat [m]
MAX_SLIDE_OFFSET = 0.25  # share of a door's width that a sliding leaf may stand off its line


class _BuildingLevel:
    """A level of the building while it is made: its entry, and the numbers of its vertices."""

    def __init__(self, elevation: float) -> None:
        self._vertex_numbers: dict[tuple[float, float, str], int] = {}
        self.elevation = round(elevation, DECIMALS)
        self.doors: list[list[object]] = []
        self.floors: list[Json] = []
        self.holes: list[Json] = []
        self.lanes: list[list[object]] = []
        self.walls: list[list[object]] = []

    def add_vertex(self, x: float, y: float, name: str = "") -> int:
        """Return the number of the vertex at x, y [m], and add it if it is new."""
        vertex = (rounded(x, DECIMALS), rounded(y, DECIMALS), name)
        return self._vertex_numbers.setdefault(vertex, len(self._vertex_numbers))

    def to_json(self) -> Json:
        """Return the level's entry in the file."""
        return {
            "elevation": self.elevation,
            "doors": self.doors,
            "floors": self.floors,
            "holes": self.holes,
            "lanes": self.lanes,
            "walls": self.walls,
            "vertices": [[x, y, 0, name, {}] for x, y, name in self._vertex_numbers],
        }


def encode_building(grid: NavGrid, path: Path) -> Files:
    """Encode a grid as a building; log a warning of links and areas that the format can't hold.

    Args:
        grid: the grid.
        path: the path of the file.

    Returns:
        The file's content by its path.

    Raises:
        MissingDependencyError: shapely is not installed.
    """
    import_extra("shapely")
    level_names = list(grid.level_names)
    if len({*level_names}) < len(level_names):
        level_names = [f"level {number}" for number in range(len(level_names))]
    levels = [_BuildingLevel(_find_elevation(scene)) for scene in grid.levels]
    lifts = [link for link in grid.links if link.kind == "lift"]
    doors = {door.id: door for door in grid.doors}
    for number, (scene, level) in enumerate(zip(grid.levels, levels, strict=True)):
        _add_floors(level, scene)
        _add_walls(level, grid, number, lifts)
        for name, leaves in _join_leaves(find_door_lines(grid, number)).items():
            level.doors.append(_make_door(level, name, leaves, doors, scene, number))
    _add_lanes(levels, grid)
    lift_entries = {
        link.name: _make_lift(link, link.car, grid, level_names)
        for link in lifts
        if link.car is not None
    }

    omitted = [f"the link {link.name!r}" for link in grid.links if link.name not in lift_entries]
    if len(grid.step_array):
        omitted.append("steps between levels")
    if grid.areas:
        omitted.append("areas")
    if omitted:
        LOG.warning("buildings of Open-RMF have no place for %s: left out", ", ".join(omitted))
    content = {
        "building_name": grid.scene_id or "building",
        "coordinate_system": "cartesian_meters",
        "levels": {name: level.to_json() for name, level in zip(level_names, levels, strict=True)},
        "lifts": lift_entries,
    }
    return {path: encode_yaml(content)}


def _find_elevation(level: SceneGrid2D) -> float:
    """Return the most frequent height of a level's free floor, to a centimetre; else its ground."""
    floor = level.floor[level.free & ~np.isnan(level.floor)]
    if not len(floor):
        return level.ground
    heights, count = np.unique(np.round(floor, 2), return_counts=True)
    return float(heights[count.argmax()])


def _add_floors(level: _BuildingLevel, scene: SceneGrid2D) -> None:
    """Add the floor of a level as polygons, and the holes in them."""
    with np.errstate(invalid="ignore"):
        is_floor = np.abs(scene.floor - level.elevation) <= MAX_HEIGHT_OFF
    for rings in trace_polygons(is_floor.astype(np.uint8), scene.lattice).get(1, []):
        for k, ring in enumerate(rings):
            vertices = [level.add_vertex(x, y) for x, y in ring.tolist()]
            polygons = level.holes if k else level.floors
            polygons.append({"parameters": {}, "vertices": vertices})


def _add_walls(level: _BuildingLevel, grid: NavGrid, number: int, lifts: Iterable[Link]) -> None:
    """Add walls along the outlines of wall cells, half their thickness inside of these."""
    scene = grid.levels[number]
    has_wall_name = np.zeros(scene.shape, dtype=np.bool_)
    for cell, entry in scene.user_data.items():
        has_wall_name.flat[cell] = bool(entry.get("walls"))
    # without names of walls, all that stands on a floor is one
    is_wall = scene.solid != 0
    is_wall &= has_wall_name if has_wall_name.any() else ~np.isnan(scene.floor)
    is_wall &= ~mark_door_cells(grid, number, in_current_state=False)
    x, y = np.meshgrid(scene.lattice.center_x(), scene.lattice.center_y())
    for link in lifts:
        if not link.car:
            continue
        _, _, _, width, depth = link.car
        along, aside = _to_car_frame(link.car, x, y)
        is_wall &= (abs(along) > width / 2 + SHAFT_GAP) | (abs(aside) > depth / 2 + SHAFT_GAP)
    cell_size = scene.lattice.cell_size
    for rings in trace_polygons(is_wall.astype(np.uint8), scene.lattice).get(1, []):
        area = shapely.Polygon(rings[0], rings[1:]).simplify(cell_size / 2)
        for ring in _inset_rings(area, cell_size):
            vertices = [level.add_vertex(x, y) for x, y in ring.coords]
            for start, end in pairwise(vertices):
                if start != end:
                    level.walls.append([start, end, {}])


def _inset_rings(area: BaseGeometry, cell_size: float) -> Iterator[LinearRing]:
    """Yield rings half a wall and half a cell inside of an area; less where it is narrower.

    A blocked cell is one that a wall touches, so walls end half a cell inside of them on average.
    """
    remaining_parts = [area]
    full_inset = (WALL_THICKNESS + cell_size) / 2
    for share in (1.0, 0.95, 0.75, 0.5, 0.25, 0.0):
        inset = share * full_inset
        parts = remaining_parts
        remaining_parts = []
        for part in parts:
            inner = part.buffer(-inset, join_style="mitre")
            for polygon in shapely.get_parts(inner):
                yield polygon.exterior
                yield from polygon.interiors
            # what the walls do not cover is tried again with a smaller inset
            uncovered = part.difference(inner.buffer(1.05 * inset, join_style="mitre"))
            remaining_parts += [
                piece for piece in shapely.get_parts(uncovered) if piece.area > cell_size**2
            ]


Coordinates = TypeVar("Coordinates", float, Float)


def _to_car_frame(
    car: tuple[float, float, float, float, float], x: Coordinates, y: Coordinates
) -> tuple[Coordinates, Coordinates]:
    """Convert world x and y to the frame of a lift's car [m]."""
    car_x, car_y, yaw, _, _ = car
    cos = math.cos(yaw)
    sin = math.sin(yaw)
    dx = x - car_x
    dy = y - car_y
    return dx * cos + dy * sin, dy * cos - dx * sin


def _join_leaves(lines: Iterable[DoorLine]) -> dict[str, list[DoorLine]]:
    """Return the leaves of each door by its name; ``NAME_right`` and ``NAME_left`` are of NAME."""
    lines = list(lines)
    ids = {line.id for line in lines}
    doors: dict[str, list[DoorLine]] = {}
    for line in lines:
        stem, _, side = line.id.rpartition("_")
        is_leaf = side in ("right", "left") and {f"{stem}_right", f"{stem}_left"} <= ids
        doors.setdefault(stem if is_leaf else line.id, []).append(line)
    return doors


def _make_door(
    level: _BuildingLevel,
    name: str,
    leaves: list[DoorLine],
    doors: dict[str, Door],
    scene: SceneGrid2D,
    number: int,
) -> list[object]:
    """Make the edge of a door, from its hinge on.

    Whether it swings or slides, and to which side, follows from the cells of its open leaf.
    """
    # from end to end of all leaves
    ends = np.array([end for leaf in leaves for end in (leaf.start, leaf.end)])
    distances = np.linalg.norm(ends[:, None] - ends[None], axis=2)
    start, end = ends[list(np.unravel_index(int(distances.argmax()), distances.shape))]
    width = float(np.hypot(*(end - start)))
    backward = (start - end) / max(width, 1e-9)
    sideward = np.array([-backward[1], backward[0]])

    is_double = len(leaves) > 1
    motion = "hinged"
    direction = 1
    axis = "start"
    door = doors[leaves[0].id]
    open_cells = door.solid_in("open", number + 1)[number]
    if not len(open_cells):
        open_cells = door.cells_in("open", number + 1)[number]
    positions = scene.lattice.positions(*np.divmod(open_cells, scene.width))
    # without open cells it slides into a wall, but for one that may swing out of the grid
    if not len(positions) and "open" in door.cells and None not in door.rooms:
        motion = "sliding"
    elif len(positions):
        offset = (positions - (start + end) / 2).mean(axis=0)
        direction = 1 if offset @ sideward >= 0 else -1
        if abs(offset @ sideward) < MAX_SLIDE_OFFSET * width / len(leaves):
            motion = "sliding"
        if not is_double:
            axis = "start" if offset @ backward >= 0 else "end"
    values = {
        "name": [TEXT_TYPE, name],
        "type": [TEXT_TYPE, f"double_{motion}" if is_double else motion],
        "motion_axis": [TEXT_TYPE, axis],
        "motion_degrees": [REAL_TYPE, 90.0],
        "motion_direction": [INTEGER_TYPE, direction if axis == "start" else -direction],
        "right_left_ratio": [REAL_TYPE, 1.0],
    }
    return [level.add_vertex(*start), level.add_vertex(*end), values]


def _add_lanes(levels: list[_BuildingLevel], grid: NavGrid) -> None:
    """Add the lanes of the grid's graph of routes on each level."""
    graph = routes.make_routes(grid)
    for lane in graph.lanes:
        start = graph.nodes[lane.start]
        end = graph.nodes[lane.end]
        if start.level != end.level or lane.link is not None:
            continue
        level = levels[start.level]
        start_vertex = level.add_vertex(start.position[0], start.position[1], start.name)
        end_vertex = level.add_vertex(end.position[0], end.position[1], end.name)
        values = {"bidirectional": [BOOLEAN_TYPE, lane.two_way], "graph_idx": [INTEGER_TYPE, 0]}
        if lane.speed is not None:
            values["speed_limit"] = [REAL_TYPE, lane.speed]
        level.lanes.append([start_vertex, end_vertex, values])


def _make_lift(
    link: Link,
    car: tuple[float, float, float, float, float],
    grid: NavGrid,
    level_names: list[str],
) -> Json:
    """Make the entry of a lift: its car, and a door at each side with a stop."""
    x, y, yaw, width, depth = car
    doors: Json = {}
    level_doors: dict[str, list[str]] = {}
    initial_level = None
    for stop in link.stops:
        along, aside = _to_car_frame(car, stop.position[0], stop.position[1])
        if abs(along) - width / 2 >= abs(aside) - depth / 2:
            side = "right" if along > 0 else "left"
            door_x = math.copysign(width / 2, along)
            door_y = 0.0
            door_yaw = math.pi / 2
            side_length = depth
        else:
            side = "front" if aside > 0 else "back"
            door_x = 0.0
            door_y = math.copysign(depth / 2, aside)
            door_yaw = 0.0
            side_length = width
        door_width = min(link.width or 1.0, side_length - 2 * SHAFT_GAP)
        doors[side] = {
            "door_type": 2,
            "x": round(door_x, DECIMALS),
            "y": round(door_y, DECIMALS),
            "width": round(door_width, DECIMALS),
            "motion_axis_orientation": round(door_yaw, 6),
        }
        sides = level_doors.setdefault(level_names[stop.level], [])
        if side not in sides:
            sides.append(side)
        # the car stands on the first level that has a floor in the shaft
        scene = grid.levels[stop.level]
        row, col = scene.lattice.rows_cols(np.array([x, y]))
        if initial_level is None and np.isfinite(scene.floor[row, col]):
            initial_level = level_names[stop.level]
    return {
        "x": x,
        "y": y,
        "yaw": yaw,
        "width": width,
        "depth": depth,
        "initial_floor_name": initial_level or next(iter(level_doors)),
        "lowest_floor": level_names[min(stop.level for stop in link.stops)],
        "highest_floor": level_names[max(stop.level for stop in link.stops)],
        "level_doors": level_doors,
        "doors": doors,
    }
