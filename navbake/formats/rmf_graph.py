"""Graphs of routes as navigation graphs of Open-RMF (YAML).

A level has vertices ``[x, y, {name, lift}]``, and lanes ``[from, to, {door_name, speed_limit}]``
between its own, one for each direction. Open-RMF joins the vertices of a lift on several levels
itself; other lanes between levels stand in ``navbake.lanes``, which it ignores, as it does the key
``navbake`` of vertices and lanes.

Source: ``parse_graph.cpp`` of ``rmf_fleet_adapter``.
"""

from __future__ import annotations

from os import PathLike
from typing import Any

import yaml

from navbake.formats.allowance import JsonPath, json_object, optional_object
from navbake.formats.route_rows import Rows, make_graph
from navbake.formats.source import read_yaml
from navbake.routes.graph import RouteGraph, directed, entry_of
from navbake.types import Json

LIFT = "lift"


def encode_routes(graph: RouteGraph) -> bytes:
    """Encode a graph as a building's navigation graph."""
    lifts = {lane.link for lane in graph.lanes if lane.kind == LIFT}
    names = list(graph.level_names)
    if len({*names}) < len(names):
        names = [f"level {number}" for number in range(len(names))]
    levels: list[Json] = [{"vertices": [], "lanes": []} for _ in names]
    between, place = [], []
    for number, node in enumerate(graph.nodes):
        x, y, _ = node.position
        vertices = levels[node.level]["vertices"]
        place.append(len(vertices))
        lift = {LIFT: node.link} if node.link in lifts and node.link else {}
        own = {**entry_of(node), "position": list(node.position), "number": number}
        vertices.append([x, y, {"name": node.name, **lift, "navbake": own}])
    for number, lane in enumerate(directed(graph.lanes)):
        own = {**entry_of(lane, "start", "end", "two_way"), "number": number}
        known: Json = {"door_name": lane.door} if lane.door else {}
        known |= {} if lane.speed is None else {"speed_limit": lane.speed}
        levels_of = [graph.nodes[end].level for end in (lane.start, lane.end)]
        if levels_of[0] == levels_of[1]:
            ends = [place[lane.start], place[lane.end]]
            levels[levels_of[0]]["lanes"].append([*ends, {**known, "navbake": own}])
        else:
            between.append([lane.start, lane.end, {"navbake": own}])
    about = {**entry_of(graph), "level_names": list(graph.level_names), "lanes": between}
    content = {
        "building_name": graph.scene_id or "building",
        "levels": dict(zip(names, levels, strict=True)),
        "navbake": about,
    }
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, allow_unicode=True)
    return text.encode()


def read_routes(path: str | PathLike[str]) -> RouteGraph:
    """Read a navigation graph; raises a FormatError."""
    content, name = read_yaml(path, expected="a navigation graph")
    place, rows = JsonPath(name), Rows()
    top = json_object(content, place)
    levels = json_object(top.get("levels"), place["levels"])
    own = optional_object(top, "navbake", place)
    for level, (level_name, part) in enumerate(levels.items()):
        at = place["levels"][str(level_name)]
        part = json_object(part, at)
        for number, vertex in enumerate(_rows(part, "vertices", at)):
            here = at["vertices"][number]
            more = optional_object(vertex[2], "navbake", here)
            named = {"name": vertex[2].get("name") or f"{level_name} {number}", "level": level}
            if vertex[2].get(LIFT):
                named |= {"link": vertex[2][LIFT], "kind": "stop"}
            z = more.get("position", [0.0, 0.0, 0.0])
            spot = [*vertex[:2], *(z[2:] if isinstance(z, list) else [])]
            rows.add_node((level, number), spot, {**named, **more}, here)
        for number, lane in enumerate(_rows(part, "lanes", at)):
            known = {"door": lane[2].get("door_name"), "speed": lane[2].get("speed_limit")}
            entry = {"name": f"{level_name} {number}"}
            entry |= {key: value for key, value in known.items() if value}
            entry |= optional_object(lane[2], "navbake", at["lanes"][number])
            rows.add_lane((level, lane[0]), (level, lane[1]), entry, at["lanes"][number])
    at = place["navbake"]
    for number, lane in enumerate(_rows(own, "lanes", at)):
        here = at["lanes"][number]
        start, end = (rows.key_of(which, here) for which in lane[:2])
        rows.add_lane(start, end, optional_object(lane[2], "navbake", at), here)
    if not own:
        rows.join_lifts()
    return make_graph(rows, own, place, level_names=[str(level) for level in levels])


def _rows(content: Json, key: str, place: JsonPath) -> list[list[Any]]:
    """A list of rows of two numbers and an object, which may be missing."""
    found: Any = content.get(key) or []
    if not isinstance(found, list):
        place[key].refuse("a list", found)
    for number, row in enumerate(found):
        if not isinstance(row, list) or len(row) < 2:
            place[key][number].refuse("a list of two numbers and an object", row)
    ends = [row[-1] if isinstance(row[-1], dict) else {} for row in found]
    return [[*row[:2], end] for row, end in zip(found, ends, strict=True)]
