"""The command that makes graphs of routes: `navbake routes`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from typer import BadParameter

import navbake
from navbake.cli.options import OUTPUT, STDOUT, GridFile, check_output, option, write_stdout
from navbake.cli.printing import say_unless_quiet
from navbake.errors import FormatError
from navbake.formats.convert import ROUTE_FORMATS, find_format

# Functions import what loads numpy when they run: --help stays quick.


def routes(
    grid: GridFile,
    output: Path = option("FILE", "File to write, - for stdout.", *OUTPUT, default=...),
    agent: str | None = option("NAME", "An agent that the grid names.  [default: the grid's own]"),
    radius: float | None = option(
        "METRES", "Radius of the agent [m].  [default: the agent's, else the grid's]"
    ),
    level: int | None = option("N", "Only this level; 0 is the lowest.", min=0),
    to: str | None = option("FORMAT", "Format of the file.  [default: by its ending]", "--to"),
) -> None:
    from navbake.formats.route_files import encode_routes, write_routes
    from navbake.navgrid.agents import Agent
    from navbake.routes.build import make_routes
    from navbake.runtime.agents import find_agent

    if output == STDOUT and to is None:
        raise BadParameter("expected a format: stdout has no ending", param_hint="--to")
    try:
        find_format(output, to, writing=True, formats=ROUTE_FORMATS)
    except FormatError as error:
        raise BadParameter(str(error), param_hint="--to" if to else "-o") from error
    check_output(output, inputs=[grid])
    content = navbake.load(grid)
    own = find_agent(content, agent)
    if radius is not None:
        own = replace(own or Agent(""), radius=radius)
    graph = make_routes(content, own)
    graph = graph if level is None else graph.on_level(level)
    if output == STDOUT:
        write_stdout(encode_routes(graph, output, to))
        return
    write_routes(graph, output, to)
    nodes, lanes = len(graph.nodes), len(graph.lanes)
    say_unless_quiet(f"{output}: {nodes} nodes, {lanes} lanes for a radius of {graph.radius:g} m")


routes.__doc__ = "\n\n".join(
    (
        "Make a graph of where agents drive: nodes, and lanes that are free for them.",
        "Example: navbake routes house.grid.json -o house.geojson",
        "Formats:",
        *(f"{form.name} ({', '.join(form.endings)}): {form.meaning}." for form in ROUTE_FORMATS),
    )
)
