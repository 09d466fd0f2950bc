"""The formats of graphs of routes, by name and ending."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from navbake.errors import FormatError
from navbake.formats.source import Files, check_path, write_files
from navbake.lazy import resolve

if TYPE_CHECKING:
    from navbake.routes.graph import RouteGraph

ROUTE_FORMATS: dict[str, tuple[str, tuple[str, ...], str]] = {
    "nav2-route": ("route_geojson", (".geojson",), "nav2's Route Server"),
    "lif": ("lif", (".json", ".lif"), "Layout Interchange Format of the VDMA"),
    "rmf": ("rmf_graph", (".yaml", ".yml"), "navigation graph of Open-RMF"),
    "graphml": ("route_graphml", (".graphml",), "networkx, Gephi, yEd"),
}
"""By name: module, endings, and what the format is for."""


def find_module(path: str | os.PathLike[str], name: str | None = None) -> str:
    """The module of a format, given by name or else by a file's ending; raises a FormatError."""
    if name is not None:
        if name not in ROUTE_FORMATS:
            known = ", ".join(ROUTE_FORMATS)
            raise FormatError(f"expected a format of routes ({known}), got {name}")
        return f"navbake.formats.{ROUTE_FORMATS[name][0]}"
    for module, endings, _ in ROUTE_FORMATS.values():
        if os.fsdecode(path).lower().endswith(endings):
            return f"navbake.formats.{module}"
    listed = ", ".join(f"{'/'.join(ends)} ({k})" for k, (_, ends, _) in ROUTE_FORMATS.items())
    raise FormatError(f"expected a name that ends as one of {listed}, got {os.fsdecode(path)}")


def write_routes(
    graph: RouteGraph, path: str | os.PathLike[str], to: str | None = None
) -> list[Path]:
    """Write a graph of routes, in a format given by name or else by the file's ending."""
    module = find_module(check_path(path), to)
    files: Files = {Path(path): resolve(f"{module}:encode_routes")(graph)}
    return write_files(files)


def read_routes(path: str | os.PathLike[str], origin: str | None = None) -> RouteGraph:
    """Read a graph of routes, in a format given by name or else by the file's ending.

    Raises:
        FormatError: the format is unknown, or the file broken.
    """
    graph: RouteGraph = resolve(f"{find_module(check_path(path), origin)}:read_routes")(path)
    return graph
