"""Graphs of routes as LIF, the Layout Interchange Format of the VDMA (JSON).

A level is a layout, a node's name its id, and a lane an edge for each direction. An edge between
levels is in the layout of its start. The key ``navbake`` holds what LIF has no place for. The time
of export is fixed, so that a graph has one file.

Source: VDMA, Layout Interchange Format 1.0; checked by the package ``vdma-lif`` in tests.
"""

from __future__ import annotations

from os import PathLike
from typing import Any

import orjson

from navbake.formats.allowance import MISSING, JsonPath, json_object, optional_object
from navbake.formats.route_rows import Rows, make_graph
from navbake.formats.source import read_object
from navbake.routes.graph import RouteGraph, directed, entry_of
from navbake.types import Json

VERSION = "1.0.0"
EXPORTED = "1970-01-01T00:00:00Z"
VEHICLE = "agent"  # the type of an agent without a name


def encode_routes(graph: RouteGraph) -> bytes:
    """Encode a graph as a collection of layouts."""
    vehicle = graph.agent or VEHICLE
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
                "navbake": {**entry_of(node), "number": number},
            }
        )
    for number, lane in enumerate(directed(graph.lanes)):
        start, end = graph.nodes[lane.start], graph.nodes[lane.end]
        layouts[start.level]["edges"].append(
            {
                "edgeId": f"edge {number}",
                "startNodeId": start.name,
                "endNodeId": end.name,
                "vehicleTypeEdgeProperties": [
                    {
                        "vehicleTypeId": vehicle,
                        "orientationType": "TANGENTIAL",
                        "rotationAllowed": True,
                        "maxSpeed": graph.speed if lane.speed is None else lane.speed,
                    }
                ],
                "navbake": {**entry_of(lane, "start", "end", "two_way"), "number": number},
            }
        )
    about = {"projectIdentification": graph.scene_id or "", "creator": "navbake"}
    about |= {"exportTimestamp": EXPORTED, "lifVersion": VERSION}
    content = {"metaInformation": about, "layouts": layouts, "navbake": entry_of(graph)}
    return orjson.dumps(content, option=orjson.OPT_APPEND_NEWLINE)


def read_routes(path: str | PathLike[str]) -> RouteGraph:
    """Read a LIF; of several types of vehicles, the first one's speed counts.

    Nodes have the names that it states, or their ids, if it states a name twice.

    Raises:
        FormatError: it is none.
    """
    content, name = read_object(path, expected="a LIF (JSON)")
    place, rows, names = JsonPath(name), Rows(), []
    top = json_object(content, place)
    stated = [
        str(node.get("nodeName") or node.get("nodeId"))
        for level, layout in enumerate(_objects(top, "layouts", place))
        for node in _objects(layout, "nodes", place["layouts"][level])
    ]
    key = "nodeName" if len({*stated}) == len(stated) else "nodeId"
    for level, layout in enumerate(_objects(top, "layouts", place)):
        at = place["layouts"][level]
        names.append(str(layout.get("layoutName") or f"level {level}"))
        for number, node in enumerate(_objects(layout, "nodes", at)):
            here = at["nodes"][number]
            spot = json_object(node.get("nodePosition"), here["nodePosition"])
            own = optional_object(node, "navbake", here)
            z = own.get("position", [0.0, 0.0, 0.0])
            at_xyz = [spot.get("x"), spot.get("y"), *(z[2:] if isinstance(z, list) else [])]
            named = {"name": node.get(key) or node.get("nodeId"), "level": level}
            rows.add_node(node.get("nodeId", MISSING), at_xyz, {**named, **own}, here)
    for level, layout in enumerate(_objects(top, "layouts", place)):
        for number, edge in enumerate(_objects(layout, "edges", place["layouts"][level])):
            here = place["layouts"][level]["edges"][number]
            own = optional_object(edge, "navbake", here)
            kinds = _objects(edge, "vehicleTypeEdgeProperties", here) if not own else []
            speed = {"speed": kinds[0]["maxSpeed"]} if kinds and kinds[0].get("maxSpeed") else {}
            ends = edge.get("startNodeId", MISSING), edge.get("endNodeId", MISSING)
            rows.add_lane(*ends, {"name": edge.get("edgeId"), **speed, **own}, here)
    return make_graph(rows, top.get("navbake"), place, level_names=names)


def _objects(content: Json, key: str, place: JsonPath) -> list[Any]:
    """A list of objects; none if it is missing or null."""
    found = content.get(key) or []
    if not isinstance(found, list):
        place[key].refuse("a list", found)
    return [json_object(entry, place[key][number]) for number, entry in enumerate(found)]
