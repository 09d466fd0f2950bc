"""Files of graphs of routes; `navbake.formats.convert.ROUTE_FORMATS` lists their formats.

- ``nav2-route``: GeoJSON of nav2's Route Server. A node is a Point with ``id`` and ``frame``. Each
  direction of a lane is a MultiLineString with ``id``, ``startid``, ``endid`` and ``cost``. Under
  ``metadata`` are navbake's other fields, and nav2's keys ``speed_limit`` [%] and
  ``abs_speed_limit`` [m/s]. nav2 may replace (``overridable``) a cost only where it is the length
  of a lane without a speed limit, so prices survive whatever scores the other lanes. nav2 knows no
  levels, so a file should hold one level, see `RouteGraph.on_level`.
- ``lif``: Layout Interchange Format of the VDMA (JSON). Each level is a layout. A node's id is its
  name. Each direction of a lane is an edge, in the layout of its start. The time of export is
  fixed, so that equal graphs have equal files.
- ``rmf``: navigation graph of Open-RMF (YAML). A level has vertices ``[x, y, {name, lift}]``, and
  a lane ``[from, to, {door_name, speed_limit}]`` for each direction of a lane between these.
  Open-RMF itself joins the vertices of a lift on several levels. Lanes between levels stand in
  ``navbake.lanes``, which it ignores.
- ``graphml``: a directed graph, written by networkx, with an edge for each direction of a lane.

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
from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import orjson

from navbake.errors import FormatError
from navbake.formats import source
from navbake.formats.allowance import (
    ABSENT,
    JsonPath,
    check_number,
    check_object,
    check_optional_object,
)
from navbake.formats.convert import ROUTE_FORMATS, find_format
from navbake.formats.graphs import encode_networkx
from navbake.lazy import resolve
from navbake.navgrid.links import DEFAULT_SPEED
from navbake.navgrid.metadata import read_table
from navbake.routes.graph import FLOOR, Lane, Node, RouteGraph, directed, to_entry, undirected
from navbake.types import Json
from navbake.yaml_text import encode_yaml

LOG = logging.getLogger(__name__)


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
        top: the top of the file, for errors.
        nodes: key -> node.
        lanes: the one-way lanes, in the file's order.
    """

    def __init__(self, file: str) -> None:
        self.top = JsonPath(file)
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
        fields = {"name": str(key), **entry, "position": tuple(coordinates)}
        node = read_table(fields, Node, f"{place.path} in {place.file}")
        self.nodes[key] = _NodeEntry(entry.get("number"), key, node)

    def add_lane(self, start: object, end: object, entry: Json, place: JsonPath) -> None:
        """Add a one-way lane.

        Args:
            start: the key of its first node.
            end: the key of its last node.
            entry: further fields of the lane; without a length, it is the distance of the nodes.
            place: its location in the file, for errors.
        """
        for key in (start, end):
            if not isinstance(key, int | str | tuple) or key not in self.nodes:
                place.refuse("the id of a node", key)
        start_position = self.nodes[start].node.position
        end_position = self.nodes[end].node.position
        length = math.dist(start_position[:2], end_position[:2])
        fields = {"name": "", "length": length, "cost": entry.get("length", length), **entry}
        fields |= {"start": 0, "end": 0, "two_way": False}
        lane = read_table(fields, Lane, f"{place.path} in {place.file}")
        self.lanes.append(_LaneEntry(entry.get("number"), start, end, lane))

    def make_graph(
        self, graph_entry: object, level_names: Sequence[str] = ("level 0",)
    ) -> RouteGraph:
        """Make the graph of all nodes and lanes that were added.

        Args:
            graph_entry: navbake's own entry with fields of the graph; ignored unless it is an
                object.
            level_names: the names of the levels, lowest first; further levels get a number as name.

        Raises:
            FormatError: two nodes have the same name, or a node is on an unknown level.
        """
        node_entries = _sort_by_number(list(self.nodes.values()))
        lane_entries = _sort_by_number(self.lanes)
        nodes = tuple(entry.node for entry in node_entries)
        index_of_key = {entry.key: number for number, entry in enumerate(node_entries)}
        lanes = [
            replace(entry.lane, start=index_of_key[entry.start], end=index_of_key[entry.end])
            for entry in lane_entries
        ]
        num_levels = max((node.level for node in nodes), default=0) + 1
        names = [*level_names]
        names += [f"level {number}" for number in range(len(level_names), num_levels)]
        fields: Json = {"level_names": names}
        if isinstance(graph_entry, dict):
            fields |= graph_entry
        fields |= {"nodes": nodes, "lanes": undirected(lanes)}
        graph: RouteGraph = read_table(fields, RouteGraph, f"navbake in {self.top.file}")
        used_names = set[str]()
        for node in nodes:
            if node.name in used_names or not 0 <= node.level < len(graph.level_names):
                self.top.fail(f"expected nodes of unique names on known levels, got {node}")
            used_names.add(node.name)
        return graph


Entry = TypeVar("Entry", _NodeEntry, _LaneEntry)


def _sort_by_number(entries: list[Entry]) -> list[Entry]:
    """Sort entries by their numbers; return them as they are if one has none."""
    numbers = [entry.number for entry in entries if isinstance(entry.number, int)]
    if len(numbers) < len(entries):
        return entries
    order = sorted(range(len(entries)), key=numbers.__getitem__)
    return [entries[index] for index in order]


def _add_height(x: object, y: object, navbake_entry: Json) -> list[object]:
    """Return the position of a node: x, y, and z if navbake's own entry for the node states it."""
    position = navbake_entry.get("position", [0.0, 0.0, 0.0])
    return [x, y, *(position[2:] if isinstance(position, list) else [])]


# ---------------------------------------------------------------- nav2

# nav2 refuses a graph with a cost of 0 that it may not replace: such costs are written as this [m]
MIN_NAV2_COST = 1e-6
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
    count = len({node.level for node in graph.nodes})
    if count > 1:
        LOG.warning(
            "nav2 knows no levels: the nodes of all %d are in one graph; choose one level by "
            "--level, or graph.on_level()", count,
        )  # fmt: skip
    features = []
    for number, node in enumerate(graph.nodes):
        properties = {"id": number, "frame": "map", "metadata": to_entry(node, "position")}
        features.append(_make_feature("Point", list(node.position), properties))
    for number, lane in enumerate(directed(graph.lanes), len(graph.nodes)):
        metadata = to_entry(lane, "start", "end", "two_way", "cost", "speed")
        if lane.speed is not None:
            # nav2 reads these as floats and fails on integers
            percent = min(100.0, 100.0 * lane.speed / graph.speed)
            metadata |= {"abs_speed_limit": float(lane.speed), "speed_limit": percent}
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
        start = list(graph.nodes[lane.start].position)
        end = list(graph.nodes[lane.end].position)
        features.append(_make_feature("MultiLineString", [[start, end]], properties))
    content = {"type": "FeatureCollection", "navbake": to_entry(graph), "features": features}
    return orjson.dumps(content, option=orjson.OPT_APPEND_NEWLINE)


def _make_feature(kind: str, coordinates: Sequence[object], properties: Json) -> Json:
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def read_nav2_route(path: str | PathLike[str]) -> RouteGraph:
    """Read a graph of nav2's Route Server.

    A lane's ``speed_limit`` is a percentage of the agent's speed, which is 1 m/s if the file
    doesn't state it. It counts only if the lane has no ``abs_speed_limit``.
    """
    content, name = source.read_json(path, expected="a GeoJSON FeatureCollection")
    reader = _GraphReader(name)
    top = check_object(content, reader.top)
    features = top.get("features")
    if not isinstance(features, list):
        reader.top["features"].refuse("a list of features", features)
    graph_entry = check_optional_object(top, "navbake", reader.top)
    speed_place = reader.top["navbake"]["speed"]
    agent_speed = check_number(graph_entry.get("speed", DEFAULT_SPEED), speed_place)
    for index, feature in enumerate(features):
        place = reader.top["features"][index]
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
                percent = float(check_number(metadata["speed_limit"], metadata_place))
                entry["speed"] = percent / 100.0 * float(agent_speed)
            start = properties.get("startid", ABSENT)
            end = properties.get("endid", ABSENT)
            reader.add_lane(start, end, entry, place)
    return reader.make_graph(graph_entry)


# ---------------------------------------------------------------- LIF


def encode_lif(graph: RouteGraph) -> bytes:
    """Encode a graph in the VDMA's Layout Interchange Format (JSON): each level is a layout."""
    vehicle = graph.agent or "agent"
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
                "vehicleTypeNodeProperties": [{"vehicleTypeId": vehicle}],
                "navbake": {**to_entry(node), "number": number},
            }
        )
    for number, lane in enumerate(directed(graph.lanes)):
        start = graph.nodes[lane.start]
        end = graph.nodes[lane.end]
        vehicle_properties = {
            "vehicleTypeId": vehicle,
            "orientationType": "TANGENTIAL",
            "rotationAllowed": True,
            "maxSpeed": graph.speed if lane.speed is None else lane.speed,
        }
        layouts[start.level]["edges"].append(
            {
                "edgeId": f"edge {number}",
                "startNodeId": start.name,
                "endNodeId": end.name,
                "vehicleTypeEdgeProperties": [vehicle_properties],
                "navbake": {**to_entry(lane, "start", "end", "two_way"), "number": number},
            }
        )
    file_info = {
        "projectIdentification": graph.scene_id or "",
        "creator": "navbake",
        "exportTimestamp": "1970-01-01T00:00:00Z",
        "lifVersion": "1.0.0",
    }
    content = {"metaInformation": file_info, "layouts": layouts, "navbake": to_entry(graph)}
    return orjson.dumps(content, option=orjson.OPT_APPEND_NEWLINE)


def read_lif(path: str | PathLike[str]) -> RouteGraph:
    """Read a graph from a file of the Layout Interchange Format (LIF).

    Nodes get the names that the file states; if two nodes have the same name, all nodes get their
    ids as names. If an edge has several types of vehicles, the first one's speed is used.
    """
    content, name = source.read_json(path, expected="a LIF (JSON)")
    reader = _GraphReader(name)
    top = check_object(content, reader.top)
    layouts = _check_objects(top, "layouts", reader.top)
    name_key = _unique_name_key(layouts, reader.top["layouts"])
    for level, layout in enumerate(layouts):
        layout_place = reader.top["layouts"][level]
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
    for level, layout in enumerate(layouts):
        layout_place = reader.top["layouts"][level]
        for number, edge in enumerate(_check_objects(layout, "edges", layout_place)):
            place = layout_place["edges"][number]
            navbake_entry = check_optional_object(edge, "navbake", place)
            entry: Json = {"name": edge.get("edgeId")}
            if not navbake_entry:
                vehicle_types = _check_objects(edge, "vehicleTypeEdgeProperties", place)
                if vehicle_types and vehicle_types[0].get("maxSpeed"):
                    entry["speed"] = vehicle_types[0]["maxSpeed"]
            start = edge.get("startNodeId", ABSENT)
            end = edge.get("endNodeId", ABSENT)
            reader.add_lane(start, end, entry | navbake_entry, place)
    names = [
        str(layout.get("layoutName") or f"level {level}") for level, layout in enumerate(layouts)
    ]
    return reader.make_graph(top.get("navbake"), names)


def _unique_name_key(layouts: list[Json], place: JsonPath) -> str:
    """Return the field with the nodes' names: ``nodeName``, or ``nodeId`` if names occur twice."""
    nodes = [
        node
        for level, layout in enumerate(layouts)
        for node in _check_objects(layout, "nodes", place[level])
    ]
    names = [str(node.get("nodeName") or node.get("nodeId")) for node in nodes]
    return "nodeName" if len({*names}) == len(names) else "nodeId"


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
    """Encode a graph as a navigation graph of Open-RMF."""
    lifts = {lane.link for lane in graph.lanes if lane.kind == "lift"}
    names = list(graph.level_names)
    if len({*names}) < len(names):
        names = [f"level {number}" for number in range(len(names))]
    levels: list[Json] = [{"vertices": [], "lanes": []} for _ in names]
    vertex_of_node = []  # for each node, the index of its vertex on its level
    for number, node in enumerate(graph.nodes):
        x, y, _ = node.position
        vertices = levels[node.level]["vertices"]
        vertex_of_node.append(len(vertices))
        fields: Json = {"name": node.name}
        if node.link and node.link in lifts:
            fields["lift"] = node.link
        fields["navbake"] = {**to_entry(node), "position": list(node.position), "number": number}
        vertices.append([x, y, fields])
    lanes_between_levels = []
    for number, lane in enumerate(directed(graph.lanes)):
        navbake_entry = {**to_entry(lane, "start", "end", "two_way"), "number": number}
        level = graph.nodes[lane.start].level
        if level != graph.nodes[lane.end].level:
            lanes_between_levels.append([lane.start, lane.end, {"navbake": navbake_entry}])
            continue
        fields = {}
        if lane.door:
            fields["door_name"] = lane.door
        if lane.speed is not None:
            fields["speed_limit"] = lane.speed
        fields["navbake"] = navbake_entry
        start = vertex_of_node[lane.start]
        end = vertex_of_node[lane.end]
        levels[level]["lanes"].append([start, end, fields])
    graph_entry = {
        **to_entry(graph),
        "level_names": list(graph.level_names),
        "lanes": lanes_between_levels,
    }
    content = {
        "building_name": graph.scene_id or "building",
        "levels": dict(zip(names, levels, strict=True)),
        "navbake": graph_entry,
    }
    return encode_yaml(content)


def read_rmf(path: str | PathLike[str]) -> RouteGraph:
    """Read a graph from a navigation graph of Open-RMF."""
    content, name = source.read_yaml(path, expected="a navigation graph")
    reader = _GraphReader(name)
    top = check_object(content, reader.top)
    levels = check_object(top.get("levels"), reader.top["levels"])
    graph_entry = check_optional_object(top, "navbake", reader.top)
    for level, (level_name, level_content) in enumerate(levels.items()):
        place = reader.top["levels"][str(level_name)]
        _read_rmf_level(reader, level, str(level_name), check_object(level_content, place), place)
    _read_lanes_between_levels(reader, graph_entry)
    if not graph_entry:
        _join_lifts(reader)
    return reader.make_graph(graph_entry, [str(level_name) for level_name in levels])


def _read_rmf_level(
    reader: _GraphReader, level: int, name: str, content: Json, place: JsonPath
) -> None:
    """Read the vertices and lanes of a level.

    The key of a node is the pair of its level's number and its index on the level.
    """
    for number, (x, y, vertex) in enumerate(_check_rows(content, "vertices", place)):
        vertex_place = place["vertices"][number]
        navbake_entry = check_optional_object(vertex, "navbake", vertex_place)
        entry: Json = {"name": vertex.get("name") or f"{name} {number}", "level": level}
        if vertex.get("lift"):
            entry |= {"link": vertex["lift"], "kind": "stop"}
        position = _add_height(x, y, navbake_entry)
        reader.add_node((level, number), position, {**entry, **navbake_entry}, vertex_place)
    for number, (start, end, lane) in enumerate(_check_rows(content, "lanes", place)):
        lane_place = place["lanes"][number]
        entry = {"name": f"{name} {number}"}
        if lane.get("door_name"):
            entry["door"] = lane["door_name"]
        if lane.get("speed_limit"):
            entry["speed"] = lane["speed_limit"]
        entry |= check_optional_object(lane, "navbake", lane_place)
        reader.add_lane((level, start), (level, end), entry, lane_place)


def _read_lanes_between_levels(reader: _GraphReader, graph_entry: Json) -> None:
    """Read the lanes of navbake's own entry; they refer to nodes by their indices in the graph."""
    key_of_number: dict[object, object] = {}
    for entry in reader.nodes.values():
        if isinstance(entry.number, int | float):
            key_of_number.setdefault(entry.number, entry.key)
    place = reader.top["navbake"]
    for index, (start, end, lane) in enumerate(_check_rows(graph_entry, "lanes", place)):
        lane_place = place["lanes"][index]
        for number in (start, end):
            if not isinstance(number, int | float) or number not in key_of_number:
                lane_place.refuse("the number of a node", number)
        navbake_entry = check_optional_object(lane, "navbake", lane_place)
        reader.add_lane(key_of_number[start], key_of_number[end], navbake_entry, lane_place)


def _join_lifts(reader: _GraphReader) -> None:
    """Add lanes between the nodes of each lift on different levels; Open-RMF does the same."""
    for start, end in itertools.permutations(list(reader.nodes.values()), 2):
        link = start.node.link
        if link and link == end.node.link and start.node.level != end.node.level:
            length = math.dist(start.node.position, end.node.position)
            entry = {"name": link, "kind": "lift", "link": link, "length": length}
            reader.add_lane(start.key, end.key, entry, reader.top)


def _check_rows(content: Json, key: str, place: JsonPath) -> list[tuple[Any, Any, Json]]:
    """Return the rows in a field of a JSON object: two values, and an object ({} for none)."""
    triples = []
    for number, row in enumerate(_check_list(content, key, place)):
        if not isinstance(row, list) or len(row) < 2:
            place[key][number].refuse("a list of two numbers and an object", row)
        triples.append((row[0], row[1], row[-1] if isinstance(row[-1], dict) else {}))
    return triples


# ---------------------------------------------------------------- GraphML


def encode_graphml(graph: RouteGraph) -> bytes:
    """Encode a graph as GraphML by networkx: nodes by name, with ``x``, ``y``, ``z`` [m]."""
    nx_graph = source.import_extra("networkx").MultiDiGraph()
    graph_entry = to_entry(graph)
    level_names = orjson.dumps(graph_entry["level_names"]).decode()
    nx_graph.graph.update({**graph_entry, "level_names": level_names})
    for number, node in enumerate(graph.nodes):
        x, y, z = node.position
        fields = to_entry(node, "position", "name")
        nx_graph.add_node(node.name, x=x, y=y, z=z, number=number, **fields)
    for number, lane in enumerate(directed(graph.lanes)):
        start = graph.nodes[lane.start].name
        end = graph.nodes[lane.end].name
        fields = to_entry(lane, "start", "end", "two_way")
        nx_graph.add_edge(start, end, number=number, **fields)
    return encode_networkx(nx_graph)


def read_graphml(path: str | PathLike[str]) -> RouteGraph:
    """Read a graph from GraphML; its nodes must have ``x`` and ``y``."""
    networkx = source.import_extra("networkx")
    data, name = source.read_bytes(path)
    try:
        nx_graph = networkx.read_graphml(io.BytesIO(data), force_multigraph=True)
    except Exception as error:  # networkx and expat raise many types
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise FormatError(
            f"expected GraphML, {source.format_path(name)} can't be read: {reason}"
        ) from error
    reader = _GraphReader(name)
    for node, entry in nx_graph.nodes(data=True):
        position = [entry.get("x"), entry.get("y"), entry.get("z", 0.0)]
        reader.add_node(node, position, {**entry, "name": str(node)}, reader.top[str(node)])
    for start, end, edge in nx_graph.edges(data=True):
        place = reader.top[f"{start} - {end}"]
        entry = {"name": f"{start} - {end}", **edge}
        reader.add_lane(start, end, entry, place)
        if not nx_graph.is_directed():
            reader.add_lane(end, start, entry, place)
    graph_entry: Json = dict(nx_graph.graph)
    try:
        graph_entry["level_names"] = orjson.loads(graph_entry.get("level_names", '["level 0"]'))
    except (orjson.JSONDecodeError, TypeError) as error:
        raise FormatError(f"expected a list of names as level_names in {name}") from error
    return reader.make_graph(graph_entry)
