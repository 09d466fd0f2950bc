"""Graphs of routes as the GeoJSON of nav2's Route Server.

A node is a Point with ``id`` and ``frame``, a lane a MultiLineString with ``id``, ``startid``,
``endid`` and ``cost``, one for each direction. ``metadata`` hold what else navbake knows, and
nav2's keys ``speed_limit`` [%] and ``abs_speed_limit`` [m/s]. The costs of links and stairs aren't
``overridable`` by lengths. nav2 knows no levels: its graphs are those of `RouteGraph.on_level`.

Source: ``geojson_graph_file_loader.cpp`` of ``nav2_route``.
"""

from __future__ import annotations

import logging
from os import PathLike
from typing import Any

import orjson

from navbake.formats.allowance import MISSING, JsonPath, json_object, optional_object
from navbake.formats.allowance import number as number_of
from navbake.formats.route_rows import Rows, make_graph
from navbake.formats.source import read_object
from navbake.navgrid.agents import SPEED
from navbake.routes.graph import FLOOR, RouteGraph, directed, entry_of
from navbake.types import Json

LOG = logging.getLogger(__name__)
FRAME = "map"
LINES = ("LineString", "MultiLineString")


def encode_routes(graph: RouteGraph) -> bytes:
    """Encode a graph as a FeatureCollection; logs a warning if its nodes are on several levels."""
    count = len({node.level for node in graph.nodes})
    if count > 1:
        LOG.warning(
            "nav2 knows no levels: the nodes of all %d are in one graph; choose one level by "
            "--level, or graph.on_level()", count,
        )  # fmt: skip
    features = []
    for number, node in enumerate(graph.nodes):
        own = {"id": number, "frame": FRAME, "metadata": entry_of(node, "position")}
        features.append(_feature("Point", list(node.position), own))
    for number, lane in enumerate(directed(graph.lanes), len(graph.nodes)):
        more = entry_of(lane, "start", "end", "two_way", "cost", "speed")
        if lane.speed is not None:
            share = min(100.0, 100.0 * lane.speed / graph.speed)
            more |= {"abs_speed_limit": lane.speed, "speed_limit": share}
        ends = [list(graph.nodes[end].position) for end in (lane.start, lane.end)]
        own = {"id": number, "startid": lane.start, "endid": lane.end, "cost": lane.cost}
        own |= {"overridable": lane.kind == FLOOR, "metadata": more}
        features.append(_feature("MultiLineString", [ends], own))
    content = {"type": "FeatureCollection", "navbake": entry_of(graph), "features": features}
    return orjson.dumps(content, option=orjson.OPT_APPEND_NEWLINE)


def _feature(kind: str, coordinates: list[Any], properties: Json) -> Json:
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def read_routes(path: str | PathLike[str]) -> RouteGraph:
    """Read a graph of nav2's Route Server; raises a FormatError.

    A ``speed_limit`` without ``abs_speed_limit`` is percent of the agent's speed, which is 1 m/s
    where the file has none.
    """
    content, name = read_object(path, expected="a GeoJSON FeatureCollection")
    place, rows = JsonPath(name), Rows()
    top = json_object(content, place)
    features = top.get("features")
    if not isinstance(features, list):
        place["features"].refuse("a list of features", features)
    about = optional_object(top, "navbake", place)
    fastest = float(number_of(about.get("speed", SPEED), place["navbake"]["speed"]))
    for number, feature in enumerate(features):
        at = place["features"][number]
        geometry = json_object(json_object(feature, at).get("geometry"), at["geometry"])
        own = json_object(feature.get("properties"), at["properties"])
        more = optional_object(own, "metadata", at["properties"])
        if geometry.get("type") == "Point":
            spot = geometry.get("coordinates")
            rows.add_node(own.get("id", MISSING), spot, more, at)
        elif geometry.get("type") in LINES:
            entry = {key: own[key] for key in ("cost",) if key in own}
            if "abs_speed_limit" in more:
                entry["speed"] = more["abs_speed_limit"]
            elif more.get("speed_limit"):  # 0 is no limit
                share = float(number_of(more["speed_limit"], at["properties"]["metadata"]))
                entry["speed"] = share / 100.0 * fastest
            ends = own.get("startid", MISSING), own.get("endid", MISSING)
            rows.add_lane(*ends, {"name": str(own.get("id", "")), **more, **entry}, at)
    return make_graph(rows, about, place)
