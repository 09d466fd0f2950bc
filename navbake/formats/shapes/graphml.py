"""GraphML: the rooms of a grid and the ways between them, as networkx, Gephi and yEd read it."""

from __future__ import annotations

import io
from pathlib import Path

from navbake.formats.shapes.cell_graph import import_networkx
from navbake.formats.shapes.room_graph import make_room_graph
from navbake.formats.source import Files
from navbake.navgrid.grid import NavGrid


def encode_graphml(grid: NavGrid, path: Path) -> Files:
    """Make a GraphML file of a grid's rooms, see `RoomGraph.to_networkx`.

    Raises:
        MissingDependencyError: networkx is not installed.
    """
    networkx = import_networkx()
    graph = make_room_graph(grid).to_networkx()
    named = networkx.relabel_nodes(graph, {node: _allowed(node) for node in graph})
    for _, entry in named.nodes(data=True):
        entry.update({key: _allowed(v) for key, v in entry.items() if isinstance(v, str)})
    for *_, entry in named.edges(data=True):
        entry.update({key: _allowed(v) for key, v in entry.items() if isinstance(v, str)})
    file = io.BytesIO()
    # this one of its writers needs the standard library alone, so all machines write the same
    networkx.write_graphml_xml(named, file)
    return {path: file.getvalue() + b"\n"}


def _allowed(text: str) -> str:
    """A name without what XML 1.0 can't hold: control characters become replacement characters."""
    return "".join(c if c >= " " and c not in "\ufffe\uffff" else "\ufffd" for c in text)
