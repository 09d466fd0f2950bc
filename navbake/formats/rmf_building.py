"""Grids as buildings of Open-RMF's traffic editor (``.building.yaml``), in metres.

Each level has its floor as polygons with holes, walls, doors that swing or slide, and the lanes of
a graph of routes. Walls follow the outlines of the grid's wall cells. The building has the lifts
whose car is known, with a vertex in the car on each level that they serve. A level is flat, at its
most frequent floor height; floor that is up to 1 m higher or lower is moved to that height. Floor
that is farther from it is left out, with the lanes that lead over it.

The format can't hold stairs, furniture, rooms and links other than lifts: they are left out.

In this module, `level` is a level of the grid, and `building_level` the level that is written.

Source: open-rmf/rmf_traffic_editor, ``rmf_building_map_tools/building_map``. Its scenes are read by
`navbake.baker.readers.building`.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from navbake.errors import count_of
from navbake.formats.shapes import trace_polygons
from navbake.formats.source import Files, import_extra
from navbake.lazy import lazy
from navbake.lengths import format_length
from navbake.navgrid.door_states import DoorLine, find_door_lines, mark_door_cells, name_doors
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.lattice import rounded
from navbake.navgrid.links import Link
from navbake.navgrid.rooms import Door
from navbake.navgrid.user_data import UserData
from navbake.routes.graph import LiftCar
from navbake.routes.lift_cars import (
    CarPlan,
    find_nodes_in_cars,
    is_in_car,
    list_landings,
    make_car_stops,
    plan_cars,
    to_car_frame,
)
from navbake.types import Bool, Float, Json
from navbake.yaml_text import encode_yaml

if TYPE_CHECKING:
    from shapely import LinearRing
    from shapely.geometry.base import BaseGeometry

    from navbake.routes.graph import Lane, RouteGraph

shapely = lazy("shapely")
routes = lazy("navbake.routes.build")

LOG = logging.getLogger(__name__)
WALL_THICKNESS = 0.1  # simulators give each wall this thickness [m]
SHAFT_GAP = 0.1  # distance of a lift's car from the walls of its shaft [m]
# Open-RMF takes vertices nearer to a car than 0.05 m to be in its shaft; this is a little more, as
# positions are rounded [m]
SHAFT_MARGIN = 0.06
DECIMALS = 4  # of coordinates
# the format writes a value after the number of its type
TEXT_TYPE = 1
INTEGER_TYPE = 2
REAL_TYPE = 3
BOOLEAN_TYPE = 4
# floor that is higher or lower than its level's elevation by more is left out [m]
MAX_HEIGHT_DIFFERENCE = 1.0
# a warning tells of floor that is moved up or down by more; less is no ramp and no step [m]
MIN_TOLD_SHIFT = 0.02
# a leaf slides if its open cells are nearer to the door's line than this share of its width
MAX_SLIDE_OFFSET = 0.25


class _BuildingLevel:
    """A level of the building while it is made; collects the parts of its entry in the file.

    Doors, lanes and walls are edges: numbers of two vertices, and values.

    Attributes:
        elevation: world z of the level's floor [m].
        doors: the edges of the doors.
        floors: the outer polygons of the floor.
        holes: the polygons that are cut out of the floor.
        lanes: the edges of the lanes.
        walls: the edges of the walls.
    """

    def __init__(self, elevation: float) -> None:
        # (x, y, name) -> number of the vertex, in the order of the file
        self._vertex_numbers: dict[tuple[float, float, str], int] = {}
        self.elevation = round(elevation, DECIMALS)
        self.doors: list[list[object]] = []
        self.floors: list[Json] = []
        self.holes: list[Json] = []
        self.lanes: list[list[object]] = []
        self.walls: list[list[object]] = []

    def add_vertex(self, x: float, y: float, name: str = "") -> int:
        """Return the number of the vertex with this place [m] and name; add it if it is new."""
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


def encode_building(
    grid: NavGrid, path: Path, progress: Callable[[str, float], None] | None = None
) -> Files:
    """Encode a grid as a building of Open-RMF; log a warning that names the parts left out.

    The warning names links (except lifts whose car is known), steps between levels, areas, floor
    that is too high or too low for its level with the lanes over it, and by how much other floor is
    moved up or down. Rooms and furniture are left out without a warning.

    Args:
        grid: the grid.
        path: the path of the file.
        progress: see `navbake.routes.build.make_routes`, which takes most of the time.

    Returns:
        The file's content by its path.

    Raises:
        MissingDependencyError: shapely is not installed.
    """
    import_extra("shapely")
    level_names = list(grid.level_names)
    if len({*level_names}) < len(level_names):
        level_names = [f"level {level_number}" for level_number in range(len(level_names))]
    lifts = [link for link in grid.links if link.kind == "lift"]
    building_levels = []
    left_out_floors = []
    for level_number, level in enumerate(grid.levels):
        building_level = _BuildingLevel(_find_elevation(level))
        left_out_floors.append(_mark_left_out_floor(level, building_level.elevation))
        _add_floors(building_level, level, left_out_floors[-1])
        _add_walls(building_level, grid, level_number, lifts)
        _add_doors(building_level, grid, level_number)
        building_levels.append(building_level)
    graph = routes.make_routes(grid, progress=progress)
    left_out_routes = _find_left_out_routes(graph, grid, left_out_floors)
    _add_lanes(building_levels, graph, left_out_routes)
    lift_entries = {
        link.name: _make_lift(link, LiftCar(link.name, *link.car), grid, level_names)
        for link in lifts
        if link.car is not None
    }
    floor_losses = _measure_floor_losses(
        grid, [building_level.elevation for building_level in building_levels], left_out_floors
    )
    _warn_of_omissions(grid, lift_entries, floor_losses, left_out_routes)
    content = {
        "building_name": grid.scene_id or "building",
        "coordinate_system": "cartesian_meters",
        "levels": {
            name: building_level.to_json()
            for name, building_level in zip(level_names, building_levels, strict=True)
        },
        "lifts": lift_entries,
    }
    return {path: encode_yaml(content)}


class _FloorLosses(NamedTuple):
    """What becomes of free floor because the levels of a building are flat.

    Attributes:
        left_out_area: the area that is left out [m²].
        largest_shift: how far other floor is moved up or down, at most [m].
    """

    left_out_area: float
    largest_shift: float


def _measure_floor_losses(
    grid: NavGrid, elevations: Sequence[float], left_out_floors: Sequence[Bool]
) -> _FloorLosses:
    """Measure how much free floor is left out, and how far the other is moved up or down.

    Args:
        grid: the grid.
        elevations: the elevation of each level of the building [m].
        left_out_floors: the floor of each level that is left out, see `_mark_left_out_floor`.
    """
    left_out_area = 0.0
    largest_shift = 0.0
    for level, elevation, is_left_out in zip(grid.levels, elevations, left_out_floors, strict=True):
        num_cells = int(np.count_nonzero(level.free & is_left_out))
        left_out_area += num_cells * level.lattice.cell_size**2
        heights = level.floor[level.free & ~is_left_out & ~np.isnan(level.floor)]
        level_shift = float(np.abs(heights - elevation).max(initial=0.0))
        largest_shift = max(largest_shift, level_shift)
    return _FloorLosses(left_out_area, largest_shift)


def _warn_of_omissions(
    grid: NavGrid,
    lift_entries: Mapping[str, Json],
    floor_losses: _FloorLosses,
    left_out_routes: _LeftOutRoutes,
) -> None:
    """Log a warning if something of the grid is left out, or floor is laid flat.

    Args:
        grid: the grid: its steps, its areas and its links without an entry are left out.
        lift_entries: the entry of each lift by its name.
        floor_losses: what becomes of the floor.
        left_out_routes: the lanes that are left out with their floor.
    """
    omitted_names = [
        f"the link {link.name!r}" for link in grid.links if link.name not in lift_entries
    ]
    if len(grid.step_array):
        omitted_names.append("steps between levels")
    if grid.areas:
        omitted_names.append("areas")
    if floor_losses.left_out_area:
        omitted_names.append(
            f"{floor_losses.left_out_area:.2f} m² of free floor more than "
            f"{MAX_HEIGHT_DIFFERENCE:g} m above or below its level's elevation"
        )
    if left_out_routes.lanes:
        omitted_names.append(f"{count_of(len(left_out_routes.lanes), 'lane')} over such floor")
    sentences = []
    if omitted_names:
        names_text = ", ".join(omitted_names)
        sentences.append(f"buildings of Open-RMF have no place for {names_text}: left out")
    if floor_losses.largest_shift > MIN_TOLD_SHIFT:
        sentences.append(
            "levels of Open-RMF are flat: floor is laid at its level's elevation, up to "
            f"{format_length(floor_losses.largest_shift)} m higher or lower than it is"
        )
    if sentences:
        LOG.warning("%s", "; ".join(sentences))


def _find_elevation(level: SceneGrid2D) -> float:
    """Return the most frequent floor height of a level's free cells [m], to a centimetre.

    If no free cell has a floor height, return the level's ground.
    """
    floor = level.floor[level.free & ~np.isnan(level.floor)]
    if not len(floor):
        return level.ground
    heights, counts = np.unique(np.round(floor, 2), return_counts=True)
    return float(heights[counts.argmax()])


def _mark_left_out_floor(level: SceneGrid2D, elevation: float) -> Bool:
    """Mark the cells whose floor is too high or too low for the flat level of a building.

    Args:
        level: the level of the grid.
        elevation: the elevation of the building's level [m].

    Returns:
        The mask, shape (height, width); False where there is no floor.
    """
    with np.errstate(invalid="ignore"):
        is_left_out: Bool = np.abs(level.floor - elevation) > MAX_HEIGHT_DIFFERENCE
    return is_left_out


def _add_floors(building_level: _BuildingLevel, level: SceneGrid2D, is_left_out: Bool) -> None:
    """Add a level's floor as polygons, and the holes in them, without the cells left out."""
    is_floor = ~np.isnan(level.floor) & ~is_left_out
    for outline, *holes in trace_polygons(is_floor.astype(np.uint8), level.lattice).get(1, []):
        building_level.floors.append(_make_polygon(building_level, outline))
        building_level.holes += [_make_polygon(building_level, hole) for hole in holes]


def _make_polygon(building_level: _BuildingLevel, corners: Float) -> Json:
    """Make the entry of a polygon, and add its corners (world x, y [m]) to the vertices."""
    vertices = [building_level.add_vertex(x, y) for x, y in corners.tolist()]
    return {"parameters": {}, "vertices": vertices}


# ---------------------------------------------------------------- walls


def _add_walls(
    building_level: _BuildingLevel, grid: NavGrid, level_number: int, lifts: Iterable[Link]
) -> None:
    """Add a level's walls: they run along the outlines of the wall cells, inside of these."""
    level = grid.levels[level_number]
    is_wall = _find_wall_cells(grid, level_number, lifts)
    cell_size = level.lattice.cell_size
    for outline, *holes in trace_polygons(is_wall.astype(np.uint8), level.lattice).get(1, []):
        wall_geometry = shapely.Polygon(outline, holes).simplify(cell_size / 2)
        for ring in _inset_rings(wall_geometry, cell_size):
            vertices = [building_level.add_vertex(x, y) for x, y in ring.coords]
            for start, end in pairwise(vertices):
                if start != end:
                    building_level.walls.append([start, end, {}])


def _find_wall_cells(grid: NavGrid, level_number: int, lifts: Iterable[Link]) -> Bool:
    """Mark the cells of a level that are part of a wall.

    These are the solid cells whose user data name a wall. If no cell's do, all solid cells with a
    floor count. Doorways, and the place of a lift's car, are no walls.

    Args:
        grid: the grid.
        level_number: the level's number.
        lifts: the grid's lifts.

    Returns:
        The mask, shape (height, width).
    """
    level = grid.levels[level_number]
    cells, entry_indices, entries = UserData.of(level.user_data).shared_entries()
    has_wall = np.array([bool(entry.get("walls")) for entry in entries], dtype=np.bool_)
    names_wall = np.zeros(level.shape, dtype=np.bool_)
    names_wall.flat[cells] = has_wall[entry_indices]
    is_wall: Bool = level.solid != 0
    is_wall &= names_wall if names_wall.any() else ~np.isnan(level.floor)
    is_wall &= ~mark_door_cells(grid, level_number, in_current_state=False)
    x, y = np.meshgrid(level.lattice.center_x(), level.lattice.center_y())
    for lift in lifts:
        if not lift.car:
            continue
        car = LiftCar(lift.name, *lift.car)
        car_x, car_y = to_car_frame(car, x, y)
        is_beside = abs(car_x) > car.width / 2 + SHAFT_GAP
        is_in_front = abs(car_y) > car.depth / 2 + SHAFT_GAP
        is_wall &= is_beside | is_in_front
    return is_wall


def _inset_rings(wall_geometry: BaseGeometry, cell_size: float) -> Iterator[LinearRing]:
    """Yield the middle lines of walls that fill an area of wall cells.

    A line runs half a wall and half a cell inside of the area's outline: a wall cell is one that a
    wall touches, so a wall ends half a cell inside of it on average. Where the area is too narrow
    for that, the line runs nearer to the outline.
    """
    remaining_parts = [wall_geometry]
    full_inset = (WALL_THICKNESS + cell_size) / 2
    for inset_fraction in (1.0, 0.95, 0.75, 0.5, 0.25, 0.0):
        inset = inset_fraction * full_inset
        parts = remaining_parts
        remaining_parts = []
        for part in parts:
            inset_area = part.buffer(-inset, join_style="mitre")
            for polygon in shapely.get_parts(inset_area):
                yield polygon.exterior
                yield from polygon.interiors
            # what these walls don't cover gets walls with a smaller inset
            uncovered_geometry = part.difference(
                inset_area.buffer(1.05 * inset, join_style="mitre")
            )
            remaining_parts += [
                uncovered_part
                for uncovered_part in shapely.get_parts(uncovered_geometry)
                if uncovered_part.area > cell_size**2
            ]


# ---------------------------------------------------------------- doors


class _DoorMotion(NamedTuple):
    """How a door opens."""

    kind: str  # ``hinged`` or ``sliding``
    # the side of the door's line to which it swings: 1 for the left, looking from end to start
    direction: int
    axis: str  # the end of the line at which the hinge is, ``start`` or ``end``


def _add_doors(building_level: _BuildingLevel, grid: NavGrid, level_number: int) -> None:
    """Add a level's doors; the two leaves of a double door become one door."""
    level = grid.levels[level_number]
    doors = {door.id: door for door in grid.doors}
    for name, leaves in _join_leaves(find_door_lines(grid, level_number)).items():
        start, end = _find_line_ends(leaves)
        open_positions = _find_open_positions(doors[leaves[0].id], level, level_number)
        motion = _find_motion(doors[leaves[0].id], start, end, open_positions, len(leaves))
        door_fields = {
            "name": [TEXT_TYPE, name],
            "type": [TEXT_TYPE, f"double_{motion.kind}" if len(leaves) > 1 else motion.kind],
            "motion_axis": [TEXT_TYPE, motion.axis],
            "motion_degrees": [REAL_TYPE, 90.0],
            # the format counts the side as seen from the hinge
            "motion_direction": [
                INTEGER_TYPE,
                motion.direction if motion.axis == "start" else -motion.direction,
            ],
            "right_left_ratio": [REAL_TYPE, 1.0],
        }
        start_vertex = building_level.add_vertex(*start)
        end_vertex = building_level.add_vertex(*end)
        building_level.doors.append([start_vertex, end_vertex, door_fields])


def _join_leaves(lines: Iterable[DoorLine]) -> dict[str, list[DoorLine]]:
    """Return the lines of each door's leaves by the door's name, see `name_doors`."""
    lines = list(lines)
    door_names = name_doors(line.id for line in lines)
    leaves_of_door: dict[str, list[DoorLine]] = {}
    for line in lines:
        leaves_of_door.setdefault(door_names[line.id], []).append(line)
    return leaves_of_door


def _find_line_ends(leaves: list[DoorLine]) -> tuple[Float, Float]:
    """Return the two ends of the line over all leaves of a door, world x, y [m]."""
    ends = np.array([end for leaf in leaves for end in (leaf.start, leaf.end)])
    distances = np.linalg.norm(ends[:, None] - ends[None], axis=2)
    start_index, end_index = np.unravel_index(int(distances.argmax()), distances.shape)
    return ends[start_index], ends[end_index]


def _find_open_positions(door: Door, level: SceneGrid2D, level_number: int) -> Float:
    """Return the centres of the cells that a door's leaf covers when it is open.

    If its bare leaf covers none, the cells count that it blocks for the agent.

    Args:
        door: the door.
        level: a level of the grid.
        level_number: the level's number.

    Returns:
        World x, y [m], shape (n, 2).
    """
    open_cells = door.solid_in("open", level_number + 1)[level_number]
    if not len(open_cells):
        open_cells = door.cells_in("open", level_number + 1)[level_number]
    positions: Float = level.lattice.positions(*np.divmod(open_cells, level.width))
    return positions


def _find_motion(
    door: Door, start: Float, end: Float, open_positions: Float, num_leaves: int
) -> _DoorMotion:
    """Find out whether a door swings or slides, and to which side, from its open leaf.

    A door whose open leaf covers no cell slides into a wall; but it is taken to swing if it may
    swing out of the grid, because it leads out of all rooms.

    Args:
        door: the door; of a double door, the one of its first leaf.
        start: one end of the door's line, world x, y [m].
        end: the other end.
        open_positions: the cells of the open leaf, see `_find_open_positions`.
        num_leaves: the number of the door's leaves.
    """
    if not len(open_positions):
        is_sliding = "open" in door.cells and None not in door.rooms
        return _DoorMotion("sliding" if is_sliding else "hinged", direction=1, axis="start")
    width = float(np.hypot(*(end - start)))
    start_direction = (start - end) / max(width, 1e-9)  # unit vector from end to start
    side_direction = np.array([-start_direction[1], start_direction[0]])  # to the left of that
    leaf_offset = (open_positions - (start + end) / 2).mean(axis=0)
    is_sliding = abs(leaf_offset @ side_direction) < MAX_SLIDE_OFFSET * width / num_leaves
    is_hinged_at_end = num_leaves == 1 and leaf_offset @ start_direction < 0
    return _DoorMotion(
        kind="sliding" if is_sliding else "hinged",
        direction=1 if leaf_offset @ side_direction >= 0 else -1,
        axis="end" if is_hinged_at_end else "start",
    )


# ---------------------------------------------------------------- lanes and lifts


class _LeftOutRoutes(NamedTuple):
    """The part of a graph of routes that is on floor which a building leaves out.

    Attributes:
        nodes: the indices of the nodes that stand on such floor.
        lanes: the indices of the lanes on a level that begin on it, end on it, or lead over it.
    """

    nodes: frozenset[int]
    lanes: frozenset[int]


def _find_left_out_routes(
    graph: RouteGraph, grid: NavGrid, left_out_floors: Sequence[Bool]
) -> _LeftOutRoutes:
    """Find the nodes and lanes on floor that is left out.

    Args:
        graph: the grid's graph of routes.
        grid: the grid.
        left_out_floors: the floor of each level that is left out, see `_mark_left_out_floor`.
    """
    node_indices = set()
    for node_index, node in enumerate(graph.nodes):
        row, col = grid.levels[node.level].lattice.rows_cols(node.position)
        if left_out_floors[node.level][row, col]:
            node_indices.add(node_index)
    lane_indices = set()
    for lane_index, lane in enumerate(graph.lanes):
        start = graph.nodes[lane.start]
        end = graph.nodes[lane.end]
        if lane.link is not None or start.level != end.level:
            continue
        lattice = grid.levels[start.level].lattice
        # both ends, and points between them that are at most half a cell apart
        num_points = 2 + math.ceil(2 * lane.length / lattice.cell_size)
        points = np.linspace(start.position[:2], end.position[:2], num_points)
        rows, cols = lattice.rows_cols(points)
        if left_out_floors[start.level][rows, cols].any():
            lane_indices.add(lane_index)
    return _LeftOutRoutes(frozenset(node_indices), frozenset(lane_indices))


def _add_lanes(
    building_levels: list[_BuildingLevel], graph: RouteGraph, left_out_routes: _LeftOutRoutes
) -> None:
    """Add the lanes of the grid's graph of routes, except those over links and between levels.

    The graph that Open-RMF makes of a building takes all vertices in a lift's shaft for vertices of
    the lift. So a lift has one vertex there, in the middle of its car, on each level that it
    serves, with lanes to the landings; nodes on the floor of a car are left out, and landings in a
    shaft are moved out of it.

    Args:
        building_levels: the levels, to which the lanes are added.
        graph: the grid's graph of routes.
        left_out_routes: the nodes and lanes that are left out with their floor; landings among
            them have no lanes to the car. Other nodes that no lane needs then are left out, too.
    """
    car_plans = [plan for plan in plan_cars(graph).values() if not plan.is_guess]
    nodes_in_shafts = find_nodes_in_cars(graph, car_plans, SHAFT_MARGIN)
    landing_positions = _place_landings(graph, car_plans)

    def add_node(node_index: int) -> int:
        node = graph.nodes[node_index]
        x, y = landing_positions.get(node_index, node.position[:2])
        vertex: int = building_levels[node.level].add_vertex(x, y, node.name)
        return vertex

    def add_lane(level: int, start: int, end: int, lane: Lane | None = None) -> None:
        is_two_way = lane.two_way if lane is not None else False
        lane_fields: Json = {
            "bidirectional": [BOOLEAN_TYPE, is_two_way],
            "graph_idx": [INTEGER_TYPE, 0],
        }
        if lane is not None and lane.speed is not None:
            lane_fields["speed_limit"] = [REAL_TYPE, lane.speed]
        building_levels[level].lanes.append([start, end, lane_fields])

    for lane_index, lane in enumerate(graph.lanes):
        if lane_index in left_out_routes.lanes:
            continue
        level = graph.nodes[lane.start].level
        is_in_shaft = lane.start in nodes_in_shafts or lane.end in nodes_in_shafts
        if level == graph.nodes[lane.end].level and lane.link is None and not is_in_shaft:
            add_lane(level, add_node(lane.start), add_node(lane.end), lane)
    for stop in make_car_stops(graph, car_plans):
        entries = [node for node in stop.entries if node not in left_out_routes.nodes]
        exits = [node for node in stop.exits if node not in left_out_routes.nodes]
        if not entries and not exits:
            continue
        car_vertex = building_levels[stop.level].add_vertex(stop.x, stop.y, stop.name)
        for node_index in entries:
            add_lane(stop.level, add_node(node_index), car_vertex)
        for node_index in exits:
            add_lane(stop.level, car_vertex, add_node(node_index))


def _place_landings(
    graph: RouteGraph, car_plans: Iterable[CarPlan]
) -> dict[int, tuple[float, float]]:
    """Move landings that lie in the shaft of their lift straight out of it.

    Args:
        graph: the graph of routes.
        car_plans: the lifts' cars.

    Returns:
        Index of a moved node -> world x, y [m].
    """
    landings = list_landings(graph)
    landing_positions = {}
    for plan in car_plans:
        car = plan.car
        for node_index in landings[car.name]:
            x, y = graph.nodes[node_index].position[:2]
            if not is_in_car(car, x, y, SHAFT_MARGIN):
                continue
            car_x, car_y = to_car_frame(car, x, y)
            door = _find_car_door(car, x, y)
            if door.x:
                car_x = door.x + math.copysign(SHAFT_GAP, door.x)
            else:
                car_y = door.y + math.copysign(SHAFT_GAP, door.y)
            cos = math.cos(car.yaw)
            sin = math.sin(car.yaw)
            landing_positions[node_index] = (
                car.x + car_x * cos - car_y * sin,
                car.y + car_x * sin + car_y * cos,
            )
    return landing_positions


class _CarDoor(NamedTuple):
    """A door of a lift's car: the middle of one side of the car, in the car's frame."""

    side: str  # ``right``, ``left``, ``front`` or ``back``
    x: float  # [m]
    y: float  # [m]
    yaw: float  # direction of the side [rad]
    side_length: float  # [m]


def _find_car_door(car: LiftCar, x: float, y: float) -> _CarDoor:
    """Find the door on the side of a lift's car that faces a stop at world x, y [m]."""
    stop_x, stop_y = to_car_frame(car, x, y)
    if abs(stop_x) - car.width / 2 >= abs(stop_y) - car.depth / 2:
        side = "right" if stop_x > 0 else "left"
        return _CarDoor(side, math.copysign(car.width / 2, stop_x), 0.0, math.pi / 2, car.depth)
    side = "front" if stop_y > 0 else "back"
    return _CarDoor(side, 0.0, math.copysign(car.depth / 2, stop_y), 0.0, car.width)


def _make_lift(link: Link, car: LiftCar, grid: NavGrid, level_names: list[str]) -> Json:
    """Make the entry of a lift: its car, and a door on each side of the car that has a stop.

    Args:
        link: the lift.
        car: its car.
        grid: the grid.
        level_names: the names of the building's levels.
    """
    doors: Json = {}  # side of the car -> entry of its door
    level_doors: dict[str, list[str]] = {}  # level's name -> sides that open there
    initial_level_name = None
    for stop in link.stops:
        door = _find_car_door(car, stop.position[0], stop.position[1])
        door_width = min(link.width or 1.0, door.side_length - 2 * SHAFT_GAP)
        doors[door.side] = {
            "door_type": 2,
            "x": round(door.x, DECIMALS),
            "y": round(door.y, DECIMALS),
            "width": round(door_width, DECIMALS),
            "motion_axis_orientation": round(door.yaw, 6),
        }
        sides = level_doors.setdefault(level_names[stop.level], [])
        if door.side not in sides:
            sides.append(door.side)
        # the car stands on the level of the first stop that has a floor in the shaft; a shaft may
        # lie beyond the edge of a level, which ends where its floor ends
        level = grid.levels[stop.level]
        row, col = level.lattice.rows_cols(np.array([car.x, car.y]))
        has_floor = level.lattice.holds(row, col) and np.isfinite(level.floor[row, col])
        if initial_level_name is None and has_floor:
            initial_level_name = level_names[stop.level]
    return {
        "x": car.x,
        "y": car.y,
        "yaw": car.yaw,
        "width": car.width,
        "depth": car.depth,
        "initial_floor_name": initial_level_name or next(iter(level_doors)),
        "lowest_floor": level_names[min(stop.level for stop in link.stops)],
        "highest_floor": level_names[max(stop.level for stop in link.stops)],
        "level_doors": level_doors,
        "doors": doors,
    }
