"""Files of graphs of routes; `navbake.formats.format_table.ROUTE_FORMATS` lists their formats.

- ``nav2-route``: GeoJSON of nav2's Route Server. A node is a Point with ``id`` and ``frame``. Each
  direction of a lane is a MultiLineString with ``id``, ``startid``, ``endid`` and ``cost``. Under
  ``metadata`` are navbake's other fields, and nav2's keys ``speed_limit`` [%] and
  ``abs_speed_limit`` [m/s]. nav2 may replace a cost (``overridable``) only where it is the length
  of a lane without a speed limit. So the prices of areas and links stay, whichever scorer nav2
  uses. nav2 knows no levels, so a file should hold one level, see `RouteGraph.on_level`.
- ``lif``: Layout Interchange Format of the VDMA (JSON). Each level is a layout. A node's id is its
  name. Each direction of a lane is an edge, in the layout of its start. The time of export is
  fixed, so that equal graphs have equal files.
- ``rmf``: navigation graph of Open-RMF (YAML). A level has vertices ``[x, y, {name, lift}]``, and
  a lane ``[from, to, {door_name, speed_limit}]`` for each direction of a lane between these. A
  vertex with ``lift`` is inside of the car, see `navbake.routes.lift_cars`; Open-RMF itself joins
  those of a lift on several levels. ``lifts`` has the cars, ``doors`` the ends of doors. Lanes
  between levels and over lifts stand in ``navbake.lanes``, and nodes on the floor of a car in
  ``navbake.nodes``, which Open-RMF ignores.
- ``graphml``, ``gml``: a directed graph, written by networkx, with an edge for each direction of a
  lane.

The key ``navbake`` holds what a format has no place for.

Sources: ``geojson_graph_file_loader.cpp``, ``route_planner.cpp`` and ``distance_scorer.cpp`` of
``nav2_route``; VDMA, Layout Interchange Format 1.0, checked by the package ``vdma-lif`` in tests;
``parse_graph.cpp`` of ``rmf_fleet_adapter``, ``building.py`` of ``rmf_building_map_tools``.
"""

from __future__ import annotations

import io
import itertools
import logging
import math
import warnings
from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import orjson

from navbake.errors import FormatError
from navbake.formats import source
from navbake.formats.allowance import (
    ABSENT,
    JsonPath,
    check_number,
    check_object,
    check_optional_object,
    format_value,
)
from navbake.formats.format_table import ROUTE_FORMATS, find_format
from navbake.formats.graphs import encode_networkx
from navbake.lazy import resolve
from navbake.navgrid.door_states import name_doors
from navbake.navgrid.lattice import MAX_COORDINATE
from navbake.navgrid.links import DEFAULT_SPEED
from navbake.navgrid.metadata import read_table
from navbake.routes.graph import (
    FLOOR,
    RECORD_FIELDS,
    Doorway,
    Lane,
    Node,
    RouteGraph,
    encode_element,
    join_opposite_lanes,
    split_two_way_lanes,
)
from navbake.routes.lift_cars import (
    LIFT,
    CarStop,
    find_nodes_in_cars,
    make_car_stops,
    plan_cars,
)
from navbake.types import Json
from navbake.yaml_text import encode_yaml

if TYPE_CHECKING:
    import networkx

LOG = logging.getLogger(__name__)

MAX_LIFT_NODES = 200  # of a lift; each is joined with all that are on other levels
MAX_LEVELS = 1000  # of a graph; each has a name, whether nodes are on it or not


def write_routes(graph: RouteGraph, path: str | PathLike[str], to: str | None = None) -> list[Path]:
    """Write a graph of routes.

    Args:
        graph: the graph.
        path: the path of the file.
        to: the name of a format; if None, the file's ending determines it.

    Returns:
        The paths of the written files.

    Raises:
        FormatError: there is no such format.
    """
    return source.write_files({Path(source.check_path(path)): encode_routes(graph, path, to)})


def encode_routes(graph: RouteGraph, path: str | PathLike[str], to: str | None = None) -> bytes:
    """Encode a graph of routes in a format; see `write_routes` for the arguments and errors."""
    file_format = find_format(path, to, writing=True, formats=ROUTE_FORMATS)
    content: bytes = resolve(f"navbake.formats.{file_format.encode}")(graph)
    return content


def read_routes(path: str | PathLike[str], origin: str | None = None) -> RouteGraph:
    """Read a graph of routes.

    Args:
        path: the path of the file.
        origin: the name of the format; if None, the file's ending determines it.

    Returns:
        The graph.

    Raises:
        FormatError: the format is unknown, or the file broken.
    """
    path = source.check_path(path)
    file_format = find_format(path, origin, writing=False, formats=ROUTE_FORMATS)
    graph: RouteGraph = resolve(f"navbake.formats.{file_format.read}")(path)
    return graph


class _NodeEntry(NamedTuple):
    """A node of a file."""

    number: object  # its index in the graph, if the file states it
    key: object  # its id in the file
    node: Node


class _LaneEntry(NamedTuple):
    """A one-way lane of a file."""

    number: object  # its index among the graph's one-way lanes, if the file states it
    start: object  # key of its first node
    end: object  # key of its last node
    lane: Lane  # its `start` and `end` are 0 until all nodes are known


class _GraphReader:
    """Collects the nodes and one-way lanes of a file while it is read; then makes the graph.

    A key is what the file calls a node. Files that group nodes by level change their order; there,
    the entry of a node or lane has its index in the graph as ``number``.

    Attributes:
        root_place: the location of the whole file, for errors.
        nodes: key -> node.
        lanes: the one-way lanes, in the file's order.
    """

    def __init__(self, file: str) -> None:
        self.root_place = JsonPath(file)
        self.nodes: dict[object, _NodeEntry] = {}
        self.lanes: list[_LaneEntry] = []

    def add_node(self, key: object, position: object, entry: Json, place: JsonPath) -> None:
        """Add a node.

        Args:
            key: its id in the file.
            position: a list of x, y and maybe z [m].
            entry: further fields of the node.
            place: its location in the file, for errors.
        """
        if not isinstance(key, int | str | tuple):
            place.refuse("the id of a node", key)
        if key in self.nodes:
            place.fail(f"two nodes have the id {key!r}")
        if not isinstance(position, list) or len(position) not in (2, 3):
            place.refuse("a node's x and y [m]", position)
        coordinates = [float(check_number(value, place)) for value in [*position, 0.0][:3]]
        for coordinate in coordinates:
            if abs(coordinate) > MAX_COORDINATE:
                place.refuse(f"coordinates within {MAX_COORDINATE:g} m", coordinate)
        fields = {"name": str(key), **entry, "position": tuple(coordinates)}
        node = read_table(fields, Node, f"{place.path} in {place.file}")
        self.nodes[key] = _NodeEntry(entry.get("number"), key, node)

    def add_lane(self, start_key: object, end_key: object, entry: Json, place: JsonPath) -> None:
        """Add a one-way lane.

        Args:
            start_key: the key of its first node.
            end_key: the key of its last node.
            entry: further fields of the lane; without a length, it is the distance of the nodes.
            place: its location in the file, for errors.
        """
        for key in (start_key, end_key):
            key_parts = key if isinstance(key, tuple) else (key,)
            is_hashable = all(isinstance(key_part, int | str) for key_part in key_parts)
            if not is_hashable or key not in self.nodes:
                place.refuse("the id of a node", key)
        start_position = self.nodes[start_key].node.position
        end_position = self.nodes[end_key].node.position
        length = math.dist(start_position[:2], end_position[:2])
        fields = {"name": "", "length": length, "cost": entry.get("length", length), **entry}
        fields |= {"start": 0, "end": 0, "two_way": False}
        lane = read_table(fields, Lane, f"{place.path} in {place.file}")
        self.lanes.append(_LaneEntry(entry.get("number"), start_key, end_key, lane))

    def make_graph(
        self, graph_entry: object, level_names: Sequence[str] = ("level 0",)
    ) -> RouteGraph:
        """Make the graph of all nodes and lanes that were added.

        Args:
            graph_entry: navbake's own entry with fields of the graph; ignored unless it is an
                object.
            level_names: the names of the levels, lowest first; further levels get a number as name.

        Raises:
            FormatError: two nodes have the same name; or a node or a doorway is on an unknown
                level.
        """
        node_entries = _sort_by_number(list(self.nodes.values()))
        lane_entries = _sort_by_number(self.lanes)
        nodes = tuple(entry.node for entry in node_entries)
        index_of_key = {entry.key: number for number, entry in enumerate(node_entries)}
        lanes = [
            replace(entry.lane, start=index_of_key[entry.start], end=index_of_key[entry.end])
            for entry in lane_entries
        ]
        for entry in node_entries:
            if not 0 <= entry.node.level < MAX_LEVELS:
                self.root_place.fail(
                    f"expected a level from 0 to {MAX_LEVELS - 1} of node {entry.node.name!r}, "
                    f"got {format_value(entry.node.level)}"
                )
        num_levels = max((node.level for node in nodes), default=0) + 1
        all_level_names = [*level_names]
        all_level_names += [f"level {number}" for number in range(len(level_names), num_levels)]
        fields: Json = {"level_names": all_level_names}
        if isinstance(graph_entry, dict):
            fields |= graph_entry
        fields |= {"nodes": nodes, "lanes": join_opposite_lanes(lanes)}
        graph: RouteGraph = read_table(fields, RouteGraph, f"navbake in {self.root_place.file}")
        used_names = set[str]()
        for node in nodes:
            if node.name in used_names or not 0 <= node.level < len(graph.level_names):
                self.root_place.fail(f"expected nodes of unique names on known levels, got {node}")
            used_names.add(node.name)
        for doorway in graph.doorways:
            if not 0 <= doorway.level < len(graph.level_names):
                self.root_place.fail(f"expected doorways on known levels, got {doorway}")
        return graph


Entry = TypeVar("Entry", _NodeEntry, _LaneEntry)


def _sort_by_number(entries: list[Entry]) -> list[Entry]:
    """Sort entries by their numbers; return them as they are if one has none."""
    numbers = [entry.number for entry in entries if isinstance(entry.number, int)]
    if len(numbers) < len(entries):
        return entries
    sort_indices = sorted(range(len(entries)), key=numbers.__getitem__)
    return [entries[index] for index in sort_indices]


def _add_height(x: object, y: object, navbake_entry: Json) -> list[object]:
    """Return the position of a node: x, y, and z if navbake's own entry for the node states it."""
    position = navbake_entry.get("position", [0.0, 0.0, 0.0])
    return [x, y, *(position[2:] if isinstance(position, list) else [])]


# ---------------------------------------------------------------- nav2

# nav2 refuses a graph with a cost of 0 that it may not replace: such costs are written as this [m]
MIN_NAV2_COST = 1e-6
# fields of an edge with the properties of its types of vehicles, in LIF 1 and in LIF 2
LIF_EDGE_PROPERTIES = ("vehicleTypeEdgeProperties", "mobileRobotTypeEdgeProperties")
COST_TOLERANCE = 1e-6  # costs and lengths are rounded to micrometres [m]


def _nav2_may_score(lane: Lane) -> bool:
    """Whether nav2 may score a lane by its length instead of its cost.

    Links and stairs have costs of their own, and so do lanes through areas that have a price.
    nav2's `DistanceScorer` divides lengths by ``speed_limit``, which its `AdjustSpeedLimit` takes
    as a percentage: it would make lanes with a speed limit cheap.
    """
    is_priced = abs(lane.cost - lane.length) > COST_TOLERANCE
    return lane.kind == FLOOR and lane.speed is None and not is_priced


def encode_nav2_route(graph: RouteGraph) -> bytes:
    """Encode a graph for nav2's Route Server; log a warning if its nodes are on several levels."""
    num_levels = len({node.level for node in graph.nodes})
    if num_levels > 1:
        LOG.warning(
            "nav2 knows no levels: the nodes of all %d are in one graph; choose one level by "
            "--level, or graph.on_level()", num_levels,
        )  # fmt: skip
    features = []
    for number, node in enumerate(graph.nodes):
        properties = {"id": number, "frame": "map", "metadata": encode_element(node, "position")}
        features.append(_make_feature("Point", list(node.position), properties))
    for number, lane in enumerate(split_two_way_lanes(graph.lanes), len(graph.nodes)):
        metadata = encode_element(lane, "start", "end", "two_way", "cost", "speed")
        if lane.speed is not None:
            # nav2 reads these as floats and fails on integers
            speed_percent = min(100.0, 100.0 * lane.speed / graph.speed)
            metadata |= {"abs_speed_limit": float(lane.speed), "speed_limit": speed_percent}
        if lane.cost < MIN_NAV2_COST:
            metadata["cost"] = lane.cost
        properties = {
            "id": number,
            "startid": lane.start,
            "endid": lane.end,
            "cost": max(lane.cost, MIN_NAV2_COST),
            "overridable": _nav2_may_score(lane),
            "metadata": metadata,
        }
        start_position = list(graph.nodes[lane.start].position)
        end_position = list(graph.nodes[lane.end].position)
        features.append(
            _make_feature("MultiLineString", [[start_position, end_position]], properties)
        )
    content = {"type": "FeatureCollection", "navbake": encode_element(graph), "features": features}
    return orjson.dumps(content, option=orjson.OPT_APPEND_NEWLINE)


def _make_feature(geometry_type: str, coordinates: Sequence[object], properties: Json) -> Json:
    geometry = {"type": geometry_type, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def read_nav2_route(path: str | PathLike[str]) -> RouteGraph:
    """Read a graph of nav2's Route Server.

    A lane's ``speed_limit`` is a percentage of the agent's speed, which is 1 m/s if the file
    doesn't state it. It is ignored if the lane also has an ``abs_speed_limit``.

    Args:
        path: the path of the file.

    Returns:
        The graph.

    Raises:
        FormatError: the file is broken.
    """
    content, name = source.read_json(path, expected="a GeoJSON FeatureCollection")
    reader = _GraphReader(name)
    root = check_object(content, reader.root_place)
    features = root.get("features")
    if not isinstance(features, list):
        reader.root_place["features"].refuse("a list of features", features)
    graph_entry = check_optional_object(root, "navbake", reader.root_place)
    speed_place = reader.root_place["navbake"]["speed"]
    agent_speed = check_number(graph_entry.get("speed", DEFAULT_SPEED), speed_place)
    for index, feature in enumerate(features):
        place = reader.root_place["features"][index]
        geometry = check_object(check_object(feature, place).get("geometry"), place["geometry"])
        properties = check_object(feature.get("properties"), place["properties"])
        metadata = check_optional_object(properties, "metadata", place["properties"])
        if geometry.get("type") == "Point":
            key = properties.get("id", ABSENT)
            reader.add_node(key, geometry.get("coordinates"), metadata, place)
        elif geometry.get("type") in ("LineString", "MultiLineString"):
            entry = {"name": str(properties.get("id", "")), **metadata}
            if "cost" in properties and "cost" not in metadata:
                entry["cost"] = properties["cost"]
            if "abs_speed_limit" in metadata:
                entry["speed"] = metadata["abs_speed_limit"]
            elif metadata.get("speed_limit"):  # 0 is no limit
                metadata_place = place["properties"]["metadata"]
                speed_percent = float(check_number(metadata["speed_limit"], metadata_place))
                entry["speed"] = speed_percent / 100.0 * float(agent_speed)
            start_key = properties.get("startid", ABSENT)
            end_key = properties.get("endid", ABSENT)
            reader.add_lane(start_key, end_key, entry, place)
    return reader.make_graph(graph_entry)


# ---------------------------------------------------------------- LIF


def encode_lif(graph: RouteGraph) -> bytes:
    """Encode a graph in the VDMA's Layout Interchange Format (JSON): each level is a layout."""
    vehicle_type = graph.agent or "agent"
    layouts: list[Json] = [
        {
            "layoutId": f"{number}",
            "layoutName": name,
            "layoutVersion": "1",
            "layoutLevelId": f"{number}",
            "nodes": [],
            "edges": [],
            "stations": [],
        }
        for number, name in enumerate(graph.level_names)
    ]
    for number, node in enumerate(graph.nodes):
        x, y, _ = node.position
        layouts[node.level]["nodes"].append(
            {
                "nodeId": node.name,
                "nodeName": node.name,
                "mapId": graph.level_names[node.level],
                "nodePosition": {"x": x, "y": y},
                "vehicleTypeNodeProperties": [{"vehicleTypeId": vehicle_type}],
                "navbake": {**encode_element(node), "number": number},
            }
        )
    for number, lane in enumerate(split_two_way_lanes(graph.lanes)):
        start_node = graph.nodes[lane.start]
        end_node = graph.nodes[lane.end]
        vehicle_properties = {
            "vehicleTypeId": vehicle_type,
            "orientationType": "TANGENTIAL",
            "rotationAllowed": True,
            "maxSpeed": graph.speed if lane.speed is None else lane.speed,
        }
        layouts[start_node.level]["edges"].append(
            {
                "edgeId": f"edge {number}",
                "startNodeId": start_node.name,
                "endNodeId": end_node.name,
                "vehicleTypeEdgeProperties": [vehicle_properties],
                "navbake": {**encode_element(lane, "start", "end", "two_way"), "number": number},
            }
        )
    file_info = {
        "projectIdentification": graph.scene_id or "",
        "creator": "navbake",
        "exportTimestamp": "1970-01-01T00:00:00Z",
        "lifVersion": "1.0.0",
    }
    content = {"metaInformation": file_info, "layouts": layouts, "navbake": encode_element(graph)}
    return orjson.dumps(content, option=orjson.OPT_APPEND_NEWLINE)


def read_lif(path: str | PathLike[str]) -> RouteGraph:
    """Read a graph from a file of the Layout Interchange Format (LIF), version 1 or 2.

    Each layout becomes a level. Version 2 groups layouts under ``origins``: their positions are
    taken as they are, as if all origins had the same frame. Nodes keep their names; if two nodes
    have the same name, all nodes are named by their ids. If an edge states speeds for several types
    of vehicles, the first one is used.

    Args:
        path: the path of the file.

    Returns:
        The graph.

    Raises:
        FormatError: the file is no LIF, or is broken.
    """
    content, name = source.read_json(path, expected="a LIF (JSON)")
    reader = _GraphReader(name)
    root = check_object(content, reader.root_place)
    layouts = _list_layouts(root, reader.root_place)
    name_key = _unique_name_key(layouts)
    for level, (layout, layout_place) in enumerate(layouts):
        for number, node in enumerate(_check_objects(layout, "nodes", layout_place)):
            place = layout_place["nodes"][number]
            position = check_object(node.get("nodePosition"), place["nodePosition"])
            navbake_entry = check_optional_object(node, "navbake", place)
            node_name = node.get(name_key) or node.get("nodeId")
            reader.add_node(
                node.get("nodeId", ABSENT),
                _add_height(position.get("x"), position.get("y"), navbake_entry),
                {"name": node_name, "level": level, **navbake_entry},
                place,
            )
    for layout, layout_place in layouts:
        for number, edge in enumerate(_check_objects(layout, "edges", layout_place)):
            place = layout_place["edges"][number]
            navbake_entry = check_optional_object(edge, "navbake", place)
            entry: Json = {"name": edge.get("edgeId")}
            if not navbake_entry:
                vehicle_properties = [
                    properties
                    for key in LIF_EDGE_PROPERTIES
                    for properties in _check_objects(edge, key, place)
                ]
                if vehicle_properties and vehicle_properties[0].get("maxSpeed"):
                    entry["speed"] = vehicle_properties[0]["maxSpeed"]
            start_key = edge.get("startNodeId", ABSENT)
            end_key = edge.get("endNodeId", ABSENT)
            reader.add_lane(start_key, end_key, entry | navbake_entry, place)
    level_names = [
        str(layout.get("layoutName") or f"level {level}")
        for level, (layout, _) in enumerate(layouts)
    ]
    return reader.make_graph(root.get("navbake"), level_names)


def _list_layouts(root: Json, place: JsonPath) -> list[tuple[Json, JsonPath]]:
    """List the layouts of a LIF, each with its place in the file.

    Version 1 has them at the top, version 2 in the ``origins``.

    Raises:
        FormatError: the file has neither, or something else at their place.
    """
    if "layouts" not in root and "origins" not in root:
        meta_information = check_optional_object(root, "metaInformation", place)
        version = meta_information.get("lifVersion")
        stated_version = "no lifVersion" if version is None else f"lifVersion {version!r}"
        expected = "`layouts` (LIF 1) or `origins` (LIF 2)"
        place.fail(f"expected {expected}, got neither, with {stated_version}")
    layouts = [
        (layout, place["layouts"][number])
        for number, layout in enumerate(_check_objects(root, "layouts", place))
    ]
    for number, origin in enumerate(_check_objects(root, "origins", place)):
        origin_place = place["origins"][number]
        layouts += [
            (layout, origin_place["layouts"][index])
            for index, layout in enumerate(_check_objects(origin, "layouts", origin_place))
        ]
    return layouts


def _unique_name_key(layouts: list[tuple[Json, JsonPath]]) -> str:
    """Return the field with the nodes' names: ``nodeName``, or ``nodeId`` if names occur twice."""
    nodes = [node for layout, place in layouts for node in _check_objects(layout, "nodes", place)]
    node_names = [str(node.get("nodeName") or node.get("nodeId")) for node in nodes]
    return "nodeName" if len({*node_names}) == len(node_names) else "nodeId"


def _check_list(content: Json, key: str, place: JsonPath) -> list[object]:
    """Return the list in a field of a JSON object; [] if the field is missing or null."""
    entries = content.get(key) or []
    if not isinstance(entries, list):
        place[key].refuse("a list", entries)
    return entries


def _check_objects(content: Json, key: str, place: JsonPath) -> list[Json]:
    """Return the list of objects in a field of a JSON object; [] if it is missing or null."""
    entries = _check_list(content, key, place)
    return [check_object(entry, place[key][number]) for number, entry in enumerate(entries)]


# ---------------------------------------------------------------- Open-RMF


def encode_rmf(graph: RouteGraph) -> bytes:
    """Encode a graph as a navigation graph of Open-RMF.

    A lift has a vertex in its car on each level that it serves, with lanes to and from the landings
    there. Open-RMF would misread lanes between levels, lanes over lifts, and nodes on the floor of
    a car. So these are written under the key ``navbake``, which Open-RMF ignores.
    """
    level_names = _unique_level_names(graph)
    levels: list[Json] = [{"vertices": [], "lanes": []} for _ in level_names]
    car_plans = plan_cars(graph)
    guessed_lifts = [lift for lift, plan in car_plans.items() if plan.is_guess]
    if guessed_lifts:
        LOG.warning(
            "the cars of %s are not known: they are taken to be between the landings; check their "
            "places in `lifts`, and the vertices in them", ", ".join(map(repr, guessed_lifts)),
        )  # fmt: skip
    car_stops = make_car_stops(graph, car_plans.values())
    lift_of_node = {stop.node: stop.lift for stop in car_stops if stop.node is not None}
    nodes_in_cars = find_nodes_in_cars(graph, car_plans.values())
    hidden_nodes = []
    vertex_of_node = {}  # node -> index of its vertex on its level
    for number, node in enumerate(graph.nodes):
        navbake_entry = {**encode_element(node), "position": list(node.position), "number": number}
        if number in nodes_in_cars:
            hidden_nodes.append(navbake_entry)
            continue
        fields: Json = {"name": node.name}
        if number in lift_of_node:
            fields["lift"] = lift_of_node[number]
        fields["navbake"] = navbake_entry
        vertices = levels[node.level]["vertices"]
        vertex_of_node[number] = len(vertices)
        vertices.append([node.position[0], node.position[1], fields])
    door_names = name_doors(
        [*(doorway.door for doorway in graph.doorways), *(lane.door or "" for lane in graph.lanes)]
    )
    hidden_lanes = []
    for number, lane in enumerate(split_two_way_lanes(graph.lanes)):
        navbake_entry = {**encode_element(lane, "start", "end", "two_way"), "number": number}
        level = graph.nodes[lane.start].level
        is_hidden = lane.start not in vertex_of_node or lane.end not in vertex_of_node
        is_hidden |= level != graph.nodes[lane.end].level or lane.kind == LIFT
        if is_hidden:
            hidden_lanes.append([lane.start, lane.end, {"navbake": navbake_entry}])
            continue
        fields = {}
        if lane.door:
            fields["door_name"] = door_names[lane.door]
        if lane.speed is not None:
            fields["speed_limit"] = lane.speed
        fields["navbake"] = navbake_entry
        start_vertex = vertex_of_node[lane.start]
        end_vertex = vertex_of_node[lane.end]
        levels[level]["lanes"].append([start_vertex, end_vertex, fields])
    for stop in car_stops:
        _add_car_stop(levels[stop.level], stop, vertex_of_node)
    graph_entry = {
        **encode_element(graph),
        "level_names": list(graph.level_names),
        "lanes": hidden_lanes,
    }
    if hidden_nodes:
        graph_entry["nodes"] = hidden_nodes
    cars = [plan.car for plan in car_plans.values()]
    cars += [car for car in graph.cars if car.name not in car_plans]
    content = {
        "building_name": graph.scene_id or "building",
        "doors": _list_rmf_doors(graph.doorways, door_names, level_names),
        "levels": dict(zip(level_names, levels, strict=True)),
        "lifts": {
            car.name: {"position": [car.x, car.y, car.yaw], "dims": [car.width, car.depth]}
            for car in cars
        },
        "navbake": graph_entry,
    }
    return encode_yaml(content)


def _unique_level_names(graph: RouteGraph) -> list[str]:
    """Return the names of the levels, or numbered names if a name stands twice."""
    names = list(graph.level_names)
    if len({*names}) < len(names):
        return [f"level {number}" for number in range(len(names))]
    return names


def _add_car_stop(level: Json, stop: CarStop, vertex_of_node: dict[int, int]) -> None:
    """Add the vertex in a lift's car to a level, unless a node is there, and lanes to the landings.

    Args:
        level: the level's entry in the file.
        stop: the place in the car.
        vertex_of_node: index of a node -> index of its vertex on its level.
    """
    if stop.node is not None:
        car_vertex = vertex_of_node[stop.node]
    else:
        car_vertex = len(level["vertices"])
        fields = {"name": stop.name, "lift": stop.lift, "navbake": {"car": stop.lift}}
        level["vertices"].append([stop.x, stop.y, fields])
    lanes = [(vertex_of_node[node], car_vertex) for node in stop.entries if node != stop.node]
    lanes += [(car_vertex, vertex_of_node[node]) for node in stop.exits if node != stop.node]
    for start, end in lanes:
        level["lanes"].append([start, end, {"navbake": {"car": stop.lift}}])


def _list_rmf_doors(
    doorways: Sequence[Doorway], door_names: dict[str, str], level_names: Sequence[str]
) -> Json:
    """Make the table of doors: the ends of each, over both leaves of a double door.

    Args:
        doorways: the lines of the leaves.
        door_names: id of a leaf -> name of its door.
        level_names: the names of the levels.
    """
    doors: Json = {}
    for name in dict.fromkeys(door_names[doorway.door] for doorway in doorways):
        leaves = [doorway for doorway in doorways if door_names[doorway.door] == name]
        level = min(doorway.level for doorway in leaves)
        ends = [end for leaf in leaves if leaf.level == level for end in (leaf.start, leaf.end)]
        start, end = max(itertools.combinations(ends, 2), key=lambda pair: math.dist(*pair))
        doors[name] = {"endpoints": [list(start), list(end)], "map": level_names[level]}
    return doors


def read_rmf(path: str | PathLike[str]) -> RouteGraph:
    """Read a graph from a navigation graph of Open-RMF.

    Args:
        path: the path of the file.

    Returns:
        The graph.

    Raises:
        FormatError: the file is broken.
    """
    content, name = source.read_yaml_source(path, expected="a navigation graph")
    reader = _GraphReader(name)
    root = check_object(content, reader.root_place)
    levels = check_object(root.get("levels"), reader.root_place["levels"])
    graph_entry = check_optional_object(root, "navbake", reader.root_place)
    for level, (level_name, level_content) in enumerate(levels.items()):
        place = reader.root_place["levels"][str(level_name)]
        _read_rmf_level(reader, level, str(level_name), check_object(level_content, place), place)
    _read_hidden_nodes(reader, graph_entry)
    _read_hidden_lanes(reader, graph_entry)
    level_names = [str(level_name) for level_name in levels]
    if not graph_entry:
        _join_lifts(reader)
        graph_entry = {
            "cars": _read_rmf_lifts(root, reader.root_place),
            "doorways": _read_rmf_doors(root, reader.root_place, level_names),
        }
    return reader.make_graph(graph_entry, level_names)


def _is_in_added_car(entry: Json, place: JsonPath) -> bool:
    """Whether a vertex or lane of a file was added by `encode_rmf` for a lift's car."""
    return "car" in check_optional_object(entry, "navbake", place)


def _read_rmf_level(
    reader: _GraphReader, level: int, name: str, content: Json, place: JsonPath
) -> None:
    """Read the vertices and lanes of a level, without those that navbake added for lifts' cars.

    The key of a node is the pair of its level's number and its index on the level.
    """
    for number, (x, y, vertex) in enumerate(_check_rows(content, "vertices", place)):
        vertex_place = place["vertices"][number]
        navbake_entry = check_optional_object(vertex, "navbake", vertex_place)
        if _is_in_added_car(vertex, vertex_place):
            continue
        entry: Json = {"name": vertex.get("name") or f"{name} {number}", "level": level}
        if vertex.get("lift"):
            entry |= {"link": vertex["lift"], "kind": "stop"}
        position = _add_height(x, y, navbake_entry)
        reader.add_node((level, number), position, {**entry, **navbake_entry}, vertex_place)
    for number, (start, end, lane) in enumerate(_check_rows(content, "lanes", place)):
        lane_place = place["lanes"][number]
        if _is_in_added_car(lane, lane_place):
            continue
        entry = {"name": f"{name} {number}"}
        if lane.get("door_name"):
            entry["door"] = lane["door_name"]
        if lane.get("speed_limit"):
            entry["speed"] = lane["speed_limit"]
        entry |= check_optional_object(lane, "navbake", lane_place)
        reader.add_lane((level, start), (level, end), entry, lane_place)


def _read_rmf_lifts(root: Json, place: JsonPath) -> list[Json]:
    """Read the table of lifts: for each, the fields of its `LiftCar`."""
    cars = []
    for name, lift in check_optional_object(root, "lifts", place).items():
        lift_place = place["lifts"][str(name)]
        lift_entry = check_object(lift, lift_place)
        position = _check_numbers(lift_entry, "position", 3, lift_place)
        dimensions = _check_numbers(lift_entry, "dims", 2, lift_place)
        fields = ("x", "y", "yaw", "width", "depth")
        values = zip(fields, [*position, *dimensions], strict=True)
        cars.append({"name": str(name), **dict(values)})
    return cars


def _read_rmf_doors(root: Json, place: JsonPath, level_names: list[str]) -> list[Json]:
    """Read the table of doors: for each, the fields of its `Doorway`."""
    doorways = []
    level_numbers = {name: number for number, name in enumerate(level_names)}
    for name, door in check_optional_object(root, "doors", place).items():
        door_place = place["doors"][str(name)]
        door_entry = check_object(door, door_place)
        level_name = str(door_entry.get("map"))
        if level_name not in level_numbers:
            door_place["map"].refuse("the name of a level", door_entry.get("map"))
        ends = _check_list(door_entry, "endpoints", door_place)
        if len(ends) != 2:
            door_place["endpoints"].refuse("two points", ends)
        start = _check_numbers({"endpoints": ends[0]}, "endpoints", 2, door_place)
        end = _check_numbers({"endpoints": ends[1]}, "endpoints", 2, door_place)
        level = level_numbers[level_name]
        doorways.append({"door": str(name), "level": level, "start": start, "end": end})
    return doorways


def _check_numbers(content: Json, key: str, count: int, place: JsonPath) -> list[float]:
    """Return the list of `count` numbers in a field of an object."""
    values = _check_list(content, key, place)
    if len(values) != count:
        place[key].refuse(f"{count} numbers", values)
    return [float(check_number(value, place[key])) for value in values]


def _read_hidden_nodes(reader: _GraphReader, graph_entry: Json) -> None:
    """Read the nodes of navbake's own entry, which lie in the cars of lifts."""
    place = reader.root_place["navbake"]
    for index, node in enumerate(_check_objects(graph_entry, "nodes", place)):
        reader.add_node(("navbake", index), node.get("position"), node, place["nodes"][index])


def _read_hidden_lanes(reader: _GraphReader, graph_entry: Json) -> None:
    """Read the lanes of navbake's own entry; they refer to nodes by their indices in the graph."""
    key_of_number: dict[object, object] = {}
    for entry in reader.nodes.values():
        if isinstance(entry.number, int | float):
            key_of_number.setdefault(entry.number, entry.key)
    place = reader.root_place["navbake"]
    for index, (start, end, lane) in enumerate(_check_rows(graph_entry, "lanes", place)):
        lane_place = place["lanes"][index]
        for number in (start, end):
            if not isinstance(number, int | float) or number not in key_of_number:
                lane_place.refuse("the number of a node", number)
        navbake_entry = check_optional_object(lane, "navbake", lane_place)
        reader.add_lane(key_of_number[start], key_of_number[end], navbake_entry, lane_place)


def _join_lifts(reader: _GraphReader) -> None:
    """Add lanes between the nodes of each lift on different levels; Open-RMF does the same."""
    nodes_of_lift: dict[str, list[_NodeEntry]] = {}
    for node_entry in reader.nodes.values():
        if node_entry.node.link:
            nodes_of_lift.setdefault(node_entry.node.link, []).append(node_entry)
    for link, node_entries in nodes_of_lift.items():
        if len(node_entries) > MAX_LIFT_NODES:
            reader.root_place.fail(
                f"expected {MAX_LIFT_NODES} nodes at most of lift {link[:40]!r}, "
                f"got {len(node_entries):,}"
            )
        for start_entry, end_entry in itertools.permutations(node_entries, 2):
            if start_entry.node.level != end_entry.node.level:
                length = math.dist(start_entry.node.position, end_entry.node.position)
                lane_entry = {"name": link, "kind": "lift", "link": link, "length": length}
                reader.add_lane(start_entry.key, end_entry.key, lane_entry, reader.root_place)


def _check_rows(content: Json, key: str, place: JsonPath) -> list[tuple[Any, Any, Json]]:
    """Return the rows in a field of a JSON object: two values, and an object ({} for none)."""
    rows = []
    for number, row in enumerate(_check_list(content, key, place)):
        if not isinstance(row, list) or len(row) < 2:
            place[key][number].refuse("a list of two numbers and an object", row)
        rows.append((row[0], row[1], row[-1] if isinstance(row[-1], dict) else {}))
    return rows


# ---------------------------------------------------------------- GraphML and GML


def encode_graphml(graph: RouteGraph) -> bytes:
    """Encode a graph as GraphML by networkx: nodes by name, with ``x``, ``y``, ``z`` [m]."""
    return encode_networkx(_to_networkx(graph))


def encode_gml(graph: RouteGraph) -> bytes:
    """Encode a graph as GML by networkx, with the attributes of `encode_graphml`."""
    return encode_networkx(_to_networkx(graph), as_gml=True)


def _to_networkx(graph: RouteGraph) -> networkx.MultiDiGraph[str]:
    """Convert a graph to networkx, with an edge for each direction of a lane."""
    nx_graph: networkx.MultiDiGraph[str] = source.import_extra("networkx").MultiDiGraph()
    graph_entry = encode_element(graph)
    for name in ("level_names", *RECORD_FIELDS):  # attributes of GraphML are no lists
        if name in graph_entry:
            graph_entry[name] = orjson.dumps(graph_entry[name]).decode()
    nx_graph.graph.update(graph_entry)
    for number, node in enumerate(graph.nodes):
        x, y, z = node.position
        fields = encode_element(node, "position", "name")
        nx_graph.add_node(node.name, x=x, y=y, z=z, number=number, **fields)
    for number, lane in enumerate(split_two_way_lanes(graph.lanes)):
        start_name = graph.nodes[lane.start].name
        end_name = graph.nodes[lane.end].name
        fields = encode_element(lane, "start", "end", "two_way")
        nx_graph.add_edge(start_name, end_name, number=number, **fields)
    return nx_graph


def read_graphml(path: str | PathLike[str]) -> RouteGraph:
    """Read a graph from GraphML; its nodes must have ``x`` and ``y`` [m].

    Args:
        path: the path of the file.

    Returns:
        The graph.

    Raises:
        FormatError: the file is broken.
    """
    networkx_module = source.import_extra("networkx")
    content, name = source.read_bytes(path)
    try:
        with warnings.catch_warnings():  # of types, which are checked below
            warnings.simplefilter("ignore")
            nx_graph = networkx_module.read_graphml(io.BytesIO(content), force_multigraph=True)
    except Exception as error:  # networkx and expat raise many types
        raise _unreadable("GraphML", name, error) from error
    return _from_networkx(nx_graph, name)


def read_gml(path: str | PathLike[str]) -> RouteGraph:
    """Read a graph from GML.

    Its nodes must have ``x`` and ``y`` [m], or ``graphics`` with these, as yEd and Gephi write
    them. Nodes are named by their labels, or by their ids if a label is missing or not unique.

    Args:
        path: the path of the file.

    Returns:
        The graph.

    Raises:
        FormatError: the file is broken.
    """
    networkx_module = source.import_extra("networkx")
    content, name = source.read_bytes(path)
    nx_graph: networkx.Graph[object]
    try:
        try:
            nx_graph = networkx_module.read_gml(io.BytesIO(content), label="label")
        except networkx_module.NetworkXError as error:
            if "label" not in str(error):
                raise
            nx_graph = networkx_module.read_gml(io.BytesIO(content), label="id")
    except Exception as error:  # networkx raises many types
        raise _unreadable("GML", name, error) from error
    for _, entry in nx_graph.nodes(data=True):
        graphics = entry.get("graphics")
        if isinstance(graphics, dict):
            entry.update({key: graphics[key] for key in "xyz" if key in graphics} | entry)
    return _from_networkx(nx_graph, name)


def _unreadable(format_name: str, name: str, error: Exception) -> FormatError:
    """Make the error for a file that networkx can't read."""
    reason = " ".join(str(error).split())[:200] or type(error).__name__
    return FormatError(
        f"expected {format_name}, {source.format_path(name)} can't be read: {reason}"
    )


def _from_networkx(nx_graph: networkx.Graph[Any], name: str) -> RouteGraph:
    """Make a graph of one of networkx; ``name`` is the file's, for errors."""
    reader = _GraphReader(name)
    for node, entry in nx_graph.nodes(data=True):
        position = [entry.get("x"), entry.get("y"), entry.get("z", 0.0)]
        reader.add_node(node, position, {**entry, "name": str(node)}, reader.root_place[str(node)])
    for start, end, edge in nx_graph.edges(data=True):
        place = reader.root_place[f"{start} - {end}"]
        entry = {"name": f"{start} - {end}", **edge}
        reader.add_lane(start, end, entry, place)
        if not nx_graph.is_directed():
            reader.add_lane(end, start, entry, place)
    graph_entry: Json = dict(nx_graph.graph)
    for key in ("level_names", *RECORD_FIELDS):
        if key not in graph_entry:
            continue
        try:
            graph_entry[key] = orjson.loads(graph_entry[key])
        except (orjson.JSONDecodeError, TypeError) as error:
            raise FormatError(f"expected a list as {key} in {name}") from error
    return reader.make_graph(graph_entry)
