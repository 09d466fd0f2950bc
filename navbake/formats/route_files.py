"""Files of graphs of routes; `navbake.formats.convert.ROUTE_FORMATS` lists their formats.

- ``nav2-route``: GeoJSON of nav2's Route Server. A node is a Point with ``id`` and ``frame``, a
  lane a MultiLineString with ``id``, ``startid``, ``endid`` and ``cost``, one for each direction.
  ``metadata`` hold what else navbake knows, and nav2's keys ``speed_limit`` [%] and
  ``abs_speed_limit`` [m/s]. The costs of links and stairs aren't ``overridable`` by lengths. nav2
  knows no levels: its graphs are those of `RouteGraph.on_level`.
- ``lif``: Layout Interchange Format of the VDMA (JSON). A level is a layout, a node's name its id,
  and a lane an edge for each direction, in the layout of its start. The time of export is fixed, so
  that a graph has one file.
- ``rmf``: navigation graph of Open-RMF (YAML). A level has vertices ``[x, y, {name, lift}]``, and
  lanes ``[from, to, {door_name, speed_limit}]`` between its own, one for each direction. Open-RMF
  joins the vertices of a lift on several levels itself; other lanes between levels stand in
  ``navbake.lanes``, which it ignores.
- ``graphml``: by networkx, directed, with an edge for each direction of a lane.

The key ``navbake`` holds what a format has no place for.

Sources: ``geojson_graph_file_loader.cpp`` of ``nav2_route``; VDMA, Layout Interchange Format 1.0,
checked by the package ``vdma-lif`` in tests; ``parse_graph.cpp`` of ``rmf_fleet_adapter``.
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
from typing import Any

import orjson

from navbake.errors import FormatError
from navbake.formats import source
from navbake.formats.allowance import (
    MISSING,
    JsonPath,
    check_number,
    check_object,
    check_optional_object,
)
from navbake.formats.convert import ROUTE_FORMATS, find_format
from navbake.formats.graphs import encode_networkx
from navbake.lazy import resolve
from navbake.navgrid.links import SPEED
from navbake.navgrid.metadata import read_table
from navbake.routes.graph import FLOOR, Lane, Node, RouteGraph, directed, to_entry, undirected
from navbake.types import Json
from navbake.yaml_text import encode_yaml

LOG = logging.getLogger(__name__)


def write_routes(graph: RouteGraph, path: str | PathLike[str], to: str | None = None) -> list[Path]:
    """Write a graph of routes, in a format given by name or else by the file's ending."""
    return source.write_files({Path(source.check_path(path)): encode_routes(graph, path, to)})


def encode_routes(graph: RouteGraph, path: str | PathLike[str], to: str | None = None) -> bytes:
    """Encode a graph of routes, in a format given by name or else by the file's ending."""
    form = find_format(path, to, writing=True, formats=ROUTE_FORMATS)
    content: bytes = resolve(f"navbake.formats.{form.encode}")(graph)
    return content


def read_routes(path: str | PathLike[str], origin: str | None = None) -> RouteGraph:
    """Read a graph of routes, in a format given by name or else by the file's ending.

    Raises a FormatError if the format is unknown, or the file broken.
    """
    form = find_format(source.check_path(path), origin, writing=False, formats=ROUTE_FORMATS)
    graph: RouteGraph = resolve(f"navbake.formats.{form.read}")(path)
    return graph


class _Rows:
    """Nodes, by their key in a file, and one-way lanes while the file is read.

    A ``number`` in an entry is its place in the graph, where files group nodes by level.
    """

    def __init__(self, file: str) -> None:
        self.top = JsonPath(file)
        self.nodes: dict[Any, tuple[Any, Node]] = {}  # each after its number
        self.lanes: list[tuple[Any, Any, Any, Lane]] = []  # each after number, start and end

    def add_node(self, key: Any, position: Any, entry: Json, place: JsonPath) -> None:
        """Add a node at x, y and maybe z [m]."""
        if not isinstance(key, int | str | tuple):
            place.refuse("the id of a node", key)
        if key in self.nodes:
            place.fail(f"two nodes have the id {key!r}")
        if not isinstance(position, list) or len(position) not in (2, 3):
            place.refuse("a node's x and y [m]", position)
        x, y, z = (float(check_number(v, place)) for v in [*position, 0.0][:3])
        fields = {"name": str(key), **entry, "position": (x, y, z)}
        node = read_table(fields, Node, f"{place.path} in {place.file}")
        self.nodes[key] = entry.get("number"), node

    def add_lane(self, start: Any, end: Any, entry: Json, place: JsonPath) -> None:
        """Add a lane one way between the keys of nodes, its length by them unless stated."""
        for key in (start, end):
            if not isinstance(key, int | str | tuple) or key not in self.nodes:
                place.refuse("the id of a node", key)
        one = self.nodes[start][1].position
        other = self.nodes[end][1].position
        length = math.dist(one[:2], other[:2])
        fields = {"name": "", "length": length, "cost": entry.get("length", length), **entry}
        fields |= {"start": 0, "end": 0, "two_way": False}  # until all nodes are known
        lane = read_table(fields, Lane, f"{place.path} in {place.file}")
        self.lanes.append((entry.get("number"), start, end, lane))

    def make_graph(self, about: Any, level_names: Sequence[str] = ("level 0",)) -> RouteGraph:
        """Make the graph, with the fields of the file's own entry `about` it, if that is one."""
        rows = _in_order([(own, key, node) for key, (own, node) in self.nodes.items()])
        nodes = tuple(node for *_, node in rows)
        index = {key: k for k, (_, key, _) in enumerate(rows)}
        lanes = [
            replace(lane, start=index[start], end=index[end])
            for _, start, end, lane in _in_order(self.lanes)
        ]
        highest = max((node.level for node in nodes), default=0)
        names = [*level_names, *(f"level {k}" for k in range(len(level_names), highest + 1))]
        fields = {"level_names": names, **(about if isinstance(about, dict) else {})}
        fields |= {"nodes": nodes, "lanes": undirected(lanes)}
        graph: RouteGraph = read_table(fields, RouteGraph, f"navbake in {self.top.file}")
        taken = set[str]()
        for node in nodes:
            if node.name in taken or not 0 <= node.level < len(graph.level_names):
                self.top.fail(f"expected nodes of unique names on known levels, got {node}")
            taken.add(node.name)
        return graph


def _in_order(rows: list[Any]) -> list[Any]:
    """Rows by the numbers that they begin with; as they are if one has none."""
    is_numbered = all(isinstance(row[0], int) for row in rows)
    return sorted(rows, key=lambda row: row[0]) if is_numbered else rows


def _with_height(x: Any, y: Any, own: Json) -> list[Any]:
    """A position on a map, with the z of navbake's own entry if it has one."""
    position = own.get("position", [0.0, 0.0, 0.0])
    return [x, y, *(position[2:] if isinstance(position, list) else [])]


# ---------------------------------------------------------------- nav2


def encode_nav2_route(graph: RouteGraph) -> bytes:
    """Encode a graph as a FeatureCollection; logs a warning if its nodes are on several levels."""
    count = len({node.level for node in graph.nodes})
    if count > 1:
        LOG.warning(
            "nav2 knows no levels: the nodes of all %d are in one graph; choose one level by "
            "--level, or graph.on_level()", count,
        )  # fmt: skip
    features = []
    for number, node in enumerate(graph.nodes):
        own = {"id": number, "frame": "map", "metadata": to_entry(node, "position")}
        features.append(_feature("Point", list(node.position), own))
    for number, lane in enumerate(directed(graph.lanes), len(graph.nodes)):
        more = to_entry(lane, "start", "end", "two_way", "cost", "speed")
        if lane.speed is not None:
            share = min(100.0, 100.0 * lane.speed / graph.speed)
            more |= {"abs_speed_limit": lane.speed, "speed_limit": share}
        ends = [list(graph.nodes[end].position) for end in (lane.start, lane.end)]
        own = {"id": number, "startid": lane.start, "endid": lane.end, "cost": lane.cost}
        own |= {"overridable": lane.kind == FLOOR, "metadata": more}
        features.append(_feature("MultiLineString", [ends], own))
    content = {"type": "FeatureCollection", "navbake": to_entry(graph), "features": features}
    return orjson.dumps(content, option=orjson.OPT_APPEND_NEWLINE)


def _feature(kind: str, coordinates: list[Any], properties: Json) -> Json:
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def read_nav2_route(path: str | PathLike[str]) -> RouteGraph:
    """Read a graph of nav2's Route Server.

    A ``speed_limit`` without ``abs_speed_limit`` is percent of the agent's speed, which is 1 m/s
    where the file has none.
    """
    content, name = source.read_json(path, expected="a GeoJSON FeatureCollection")
    rows = _Rows(name)
    place = rows.top
    top = check_object(content, rows.top)
    features = top.get("features")
    if not isinstance(features, list):
        place["features"].refuse("a list of features", features)
    about = check_optional_object(top, "navbake", place)
    fastest = float(check_number(about.get("speed", SPEED), place["navbake"]["speed"]))
    for k, feature in enumerate(features):
        at = place["features"][k]
        geometry = check_object(check_object(feature, at).get("geometry"), at["geometry"])
        own = check_object(feature.get("properties"), at["properties"])
        more = check_optional_object(own, "metadata", at["properties"])
        if geometry.get("type") == "Point":
            rows.add_node(own.get("id", MISSING), geometry.get("coordinates"), more, at)
        elif geometry.get("type") in ("LineString", "MultiLineString"):
            entry = {key: own[key] for key in ("cost",) if key in own}
            if "abs_speed_limit" in more:
                entry["speed"] = more["abs_speed_limit"]
            elif more.get("speed_limit"):  # 0 is no limit
                share = float(check_number(more["speed_limit"], at["properties"]["metadata"]))
                entry["speed"] = share / 100.0 * fastest
            ends = own.get("startid", MISSING), own.get("endid", MISSING)
            rows.add_lane(*ends, {"name": str(own.get("id", "")), **more, **entry}, at)
    return rows.make_graph(about)


# ---------------------------------------------------------------- LIF


def encode_lif(graph: RouteGraph) -> bytes:
    """Encode a graph as a collection of layouts."""
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
        moves = {
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
                "vehicleTypeEdgeProperties": [moves],
                "navbake": {**to_entry(lane, "start", "end", "two_way"), "number": number},
            }
        )
    about = {"projectIdentification": graph.scene_id or "", "creator": "navbake"}
    about |= {"exportTimestamp": "1970-01-01T00:00:00Z", "lifVersion": "1.0.0"}
    content = {"metaInformation": about, "layouts": layouts, "navbake": to_entry(graph)}
    return orjson.dumps(content, option=orjson.OPT_APPEND_NEWLINE)


def read_lif(path: str | PathLike[str]) -> RouteGraph:
    """Read a LIF; of several types of vehicles, the first one's speed counts.

    Nodes have the names that it states, or their ids, if it states a name twice.
    """
    content, name = source.read_json(path, expected="a LIF (JSON)")
    rows = _Rows(name)
    top = check_object(content, rows.top)
    layouts = [
        (layout, rows.top["layouts"][level])
        for level, layout in enumerate(_objects(top, "layouts", rows.top))
    ]
    nodes = [
        (level, node, at["nodes"][number])
        for level, (layout, at) in enumerate(layouts)
        for number, node in enumerate(_objects(layout, "nodes", at))
    ]
    stated = [str(node.get("nodeName") or node.get("nodeId")) for _, node, _ in nodes]
    key = "nodeName" if len({*stated}) == len(stated) else "nodeId"
    for level, node, here in nodes:
        spot = check_object(node.get("nodePosition"), here["nodePosition"])
        own = check_optional_object(node, "navbake", here)
        named = {"name": node.get(key) or node.get("nodeId"), "level": level, **own}
        position = _with_height(spot.get("x"), spot.get("y"), own)
        rows.add_node(node.get("nodeId", MISSING), position, named, here)
    for layout, at in layouts:
        for number, edge in enumerate(_objects(layout, "edges", at)):
            here = at["edges"][number]
            own = check_optional_object(edge, "navbake", here)
            kinds = _objects(edge, "vehicleTypeEdgeProperties", here) if not own else []
            speed = {"speed": kinds[0]["maxSpeed"]} if kinds and kinds[0].get("maxSpeed") else {}
            ends = edge.get("startNodeId", MISSING), edge.get("endNodeId", MISSING)
            rows.add_lane(*ends, {"name": edge.get("edgeId"), **speed, **own}, here)
    names = [str(own.get("layoutName") or f"level {k}") for k, (own, _) in enumerate(layouts)]
    return rows.make_graph(top.get("navbake"), names)


def _list_of(content: Json, key: str, place: JsonPath) -> list[Any]:
    """A list that may be missing or null."""
    found = content.get(key) or []
    if not isinstance(found, list):
        place[key].refuse("a list", found)
    return found


def _objects(content: Json, key: str, place: JsonPath) -> list[Json]:
    listed = _list_of(content, key, place)
    return [check_object(entry, place[key][number]) for number, entry in enumerate(listed)]


# ---------------------------------------------------------------- Open-RMF


def encode_rmf(graph: RouteGraph) -> bytes:
    """Encode a graph as a building's navigation graph."""
    lifts = {lane.link for lane in graph.lanes if lane.kind == "lift"}
    names = list(graph.level_names)
    if len({*names}) < len(names):
        names = [f"level {number}" for number in range(len(names))]
    levels: list[Json] = [{"vertices": [], "lanes": []} for _ in names]
    between = []
    place = []
    for number, node in enumerate(graph.nodes):
        x, y, _ = node.position
        vertices = levels[node.level]["vertices"]
        place.append(len(vertices))
        lift = {"lift": node.link} if node.link in lifts and node.link else {}
        own = {**to_entry(node), "position": list(node.position), "number": number}
        vertices.append([x, y, {"name": node.name, **lift, "navbake": own}])
    for number, lane in enumerate(directed(graph.lanes)):
        own = {**to_entry(lane, "start", "end", "two_way"), "number": number}
        known: Json = {"door_name": lane.door} if lane.door else {}
        known |= {} if lane.speed is None else {"speed_limit": lane.speed}
        level = graph.nodes[lane.start].level
        to_level = graph.nodes[lane.end].level
        if level == to_level:
            ends = [place[lane.start], place[lane.end]]
            levels[level]["lanes"].append([*ends, {**known, "navbake": own}])
        else:
            between.append([lane.start, lane.end, {"navbake": own}])
    about = {**to_entry(graph), "level_names": list(graph.level_names), "lanes": between}
    content = {
        "building_name": graph.scene_id or "building",
        "levels": dict(zip(names, levels, strict=True)),
        "navbake": about,
    }
    return encode_yaml(content)


def read_rmf(path: str | PathLike[str]) -> RouteGraph:
    """Read a navigation graph of Open-RMF."""
    content, name = source.read_yaml(path, expected="a navigation graph")
    rows = _Rows(name)
    place = rows.top
    top = check_object(content, rows.top)
    levels = check_object(top.get("levels"), place["levels"])
    about = check_optional_object(top, "navbake", place)
    for level, (level_name, part) in enumerate(levels.items()):
        at = place["levels"][str(level_name)]
        part = check_object(part, at)
        for k, (x, y, vertex) in enumerate(_triples(part, "vertices", at)):
            here = at["vertices"][k]
            own = check_optional_object(vertex, "navbake", here)
            named = {"name": vertex.get("name") or f"{level_name} {k}", "level": level}
            if vertex.get("lift"):
                named |= {"link": vertex["lift"], "kind": "stop"}
            rows.add_node((level, k), _with_height(x, y, own), {**named, **own}, here)
        for k, (start, end, lane) in enumerate(_triples(part, "lanes", at)):
            known = {"door": lane.get("door_name"), "speed": lane.get("speed_limit")}
            entry = {"name": f"{level_name} {k}"}
            entry |= {key: value for key, value in known.items() if value}
            entry |= check_optional_object(lane, "navbake", at["lanes"][k])
            rows.add_lane((level, start), (level, end), entry, at["lanes"][k])
    # of nodes with one number, the first has it
    numbered = [(own, key) for key, (own, _) in rows.nodes.items() if isinstance(own, int | float)]
    keys = dict(reversed(numbered))
    for k, (start, end, lane) in enumerate(_triples(about, "lanes", place["navbake"])):
        here = place["navbake"]["lanes"][k]
        for number in (start, end):
            if not isinstance(number, int | float) or number not in keys:
                here.refuse("the number of a node", number)
        rows.add_lane(keys[start], keys[end], check_optional_object(lane, "navbake", here), here)
    # lifts join their levels
    nodes = [(key, node) for key, (_, node) in rows.nodes.items()] if not about else []
    for (key, node), (other_key, other) in itertools.permutations(nodes, 2):
        if node.link and node.link == other.link and node.level != other.level:
            entry = {"name": node.link, "kind": "lift", "link": node.link}
            length = math.dist(node.position, other.position)
            rows.add_lane(key, other_key, {**entry, "length": length}, place)
    return rows.make_graph(about, [str(level) for level in levels])


def _triples(content: Json, key: str, place: JsonPath) -> list[list[Any]]:
    """A list of rows of two numbers and an object, which may be missing."""
    found = _list_of(content, key, place)
    for number, row in enumerate(found):
        if not isinstance(row, list) or len(row) < 2:
            place[key][number].refuse("a list of two numbers and an object", row)
    return [[*row[:2], row[-1] if isinstance(row[-1], dict) else {}] for row in found]


# ---------------------------------------------------------------- GraphML


def encode_graphml(graph: RouteGraph) -> bytes:
    """Encode a graph by networkx: nodes by name, with ``x``, ``y``, ``z`` [m]."""
    made = source.import_extra("networkx").MultiDiGraph()
    about = to_entry(graph)
    made.graph.update({**about, "level_names": orjson.dumps(about["level_names"]).decode()})
    for number, node in enumerate(graph.nodes):
        x, y, z = node.position
        made.add_node(node.name, x=x, y=y, z=z, number=number, **to_entry(node, "position", "name"))
    for number, lane in enumerate(directed(graph.lanes)):
        ends = graph.nodes[lane.start].name, graph.nodes[lane.end].name
        made.add_edge(*ends, number=number, **to_entry(lane, "start", "end", "two_way"))
    return encode_networkx(made)


def read_graphml(path: str | PathLike[str]) -> RouteGraph:
    """Read a graph whose nodes have ``x`` and ``y``."""
    networkx = source.import_extra("networkx")
    data, name = source.read_bytes(path)
    try:
        found = networkx.read_graphml(io.BytesIO(data), force_multigraph=True)
    except Exception as error:  # networkx and expat raise many types
        why = " ".join(str(error).split())[:200] or type(error).__name__
        raise FormatError(
            f"expected GraphML, {source.format_path(name)} can't be read: {why}"
        ) from error
    rows = _Rows(name)
    for node, entry in found.nodes(data=True):
        spot = [entry.get("x"), entry.get("y"), entry.get("z", 0.0)]
        rows.add_node(node, spot, {**entry, "name": str(node)}, rows.top[str(node)])
    for one, other, entry in found.edges(data=True):
        own = {"name": f"{one} - {other}", **entry}
        for ends in [(one, other)] if found.is_directed() else [(one, other), (other, one)]:
            rows.add_lane(*ends, own, rows.top[f"{one} - {other}"])
    about: Json = dict(found.graph)
    try:
        about["level_names"] = orjson.loads(about.get("level_names", '["level 0"]'))
    except (orjson.JSONDecodeError, TypeError) as error:
        raise FormatError(f"expected a list of names as level_names in {name}") from error
    return rows.make_graph(about)
