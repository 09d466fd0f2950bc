"""Graphs of routes as GraphML, by networkx: directed, with an edge for each direction of a lane."""

from __future__ import annotations

import io
import re
from os import PathLike
from typing import Any

import orjson

from navbake.errors import FormatError
from navbake.formats.allowance import JsonPath
from navbake.formats.route_rows import Rows, make_graph
from navbake.formats.source import import_extra, path_name, read_bytes
from navbake.routes.graph import RouteGraph, directed, entry_of
from navbake.types import Json


def to_networkx(graph: RouteGraph) -> Any:
    """Convert a graph to a networkx MultiDiGraph, whose nodes are the names.

    Nodes have ``x``, ``y``, ``z`` [m] and the fields of a Node, edges those of a Lane.
    """
    made = import_extra("networkx").MultiDiGraph()
    about = entry_of(graph)
    made.graph.update({**about, "level_names": orjson.dumps(about["level_names"]).decode()})
    for number, node in enumerate(graph.nodes):
        x, y, z = node.position
        made.add_node(node.name, x=x, y=y, z=z, number=number, **entry_of(node, "position", "name"))
    for number, lane in enumerate(directed(graph.lanes)):
        ends = graph.nodes[lane.start].name, graph.nodes[lane.end].name
        made.add_edge(*ends, number=number, **entry_of(lane, "start", "end", "two_way"))
    return made


def encode_routes(graph: RouteGraph) -> bytes:
    """Encode a graph; control characters, which XML can't hold, are replaced."""
    networkx = import_extra("networkx")

    def allowed(value: Any) -> Any:
        is_text = isinstance(value, str)
        return re.sub("[\0-\x08\x0b-\x1f\ufffe\uffff]", "\ufffd", value) if is_text else value

    made = to_networkx(graph)
    named = networkx.relabel_nodes(made, {node: allowed(node) for node in made})
    for entry in (
        named.graph,
        *dict(named.nodes(data=True)).values(),
        *(e for *_, e in named.edges(data=True)),
    ):
        entry.update({key: allowed(value) for key, value in entry.items()})
    file = io.BytesIO()
    networkx.write_graphml_xml(named, file)
    return file.getvalue() + b"\n"


def read_routes(path: str | PathLike[str]) -> RouteGraph:
    """Read a graph whose nodes have ``x`` and ``y``; raises a FormatError."""
    networkx = import_extra("networkx")
    data, name = read_bytes(path)
    try:
        found = networkx.read_graphml(io.BytesIO(data), force_multigraph=True)
    except Exception as error:  # networkx and expat raise many types
        why = " ".join(str(error).split())[:200] or type(error).__name__
        raise FormatError(f"expected GraphML, {path_name(name)} can't be read: {why}") from error
    place, rows = JsonPath(name), Rows()
    for node, entry in found.nodes(data=True):
        spot = [entry.get("x"), entry.get("y"), entry.get("z", 0.0)]
        rows.add_node(node, spot, {**entry, "name": str(node)}, place[str(node)])
    for one, other, entry in found.edges(data=True):
        for ends in [(one, other)] if found.is_directed() else [(one, other), (other, one)]:
            rows.add_lane(*ends, {"name": f"{one} - {other}", **entry}, place[f"{one} - {other}"])
    about: Json = dict(found.graph)
    try:
        about["level_names"] = orjson.loads(about.get("level_names", '["level 0"]'))
    except (orjson.JSONDecodeError, TypeError) as error:
        raise FormatError(f"expected a list of names as level_names in {name}") from error
    about = {
        key: value for key, value in about.items() if key not in ("node_default", "edge_default")
    }
    return make_graph(rows, about, place)
