"""The command `navbake path`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer import BadParameter, Exit, Option

import navbake
from navbake.cli.options import STDOUT, AsJson, GridFile, beside_output, check_output, write_stdout
from navbake.cli.places import PLACE, PLACE_HELP, parse_place, position_of_place
from navbake.cli.printing import print_json, say

if TYPE_CHECKING:
    from navbake.runtime import paths

NAMED = ("room:", "object:")


def path(
    grid: GridFile,
    start: str = Option(..., "--from", metavar=PLACE, help=f"Start, {PLACE_HELP}."),
    goals: list[str] = Option(
        ...,
        "--to",
        metavar=f"{PLACE}|room:NAME|object:NAME",
        help="Goal: a position, a room, or an object to stop beside. Repeat it with several "
        "positions to reach the cheapest of them.",
    ),
    radius: float | None = Option(
        None, metavar="METRES", help="Inflate the grid for this agent radius first [m]."
    ),
    smooth: bool = Option(True, help="Straighten the path, or follow the cells' centres."),
    as_json: AsJson = False,
    output: Path | None = Option(
        None, "-o", "--output", metavar="PNG|SVG", help="Draw the path; - for a PNG on stdout."
    ),
) -> None:
    """Plan a path through a grid, or say why there is none.

    The exit status is 1 if there is none.

    Example: navbake path house.grid.json --from 0,-4.8 --to -2.2,-3.2,L1
    """
    if output is not None:
        check_output(output, ".png", ".svg", inputs=[grid])
    is_named = any(goal.startswith(NAMED) for goal in goals)
    if len(goals) > 1 and is_named:
        raise BadParameter("several goals have to be positions", param_hint="--to")
    begin = parse_place(start, "--from")
    ends = [] if is_named else [parse_place(text, "--to") for text in goals]
    content = navbake.load(grid)
    if radius is not None:
        content = content.inflate(radius)
    finder = navbake.PathFinder(content)
    origin = position_of_place(content, begin, "--from")
    goal: Any = goals[0] if is_named else [position_of_place(content, p, "--to") for p in ends]
    found = finder.find_path(origin, goal, smooth=smooth)
    reason = None if found else finder.why_not(origin, goal)
    with beside_output(output):
        if as_json:
            print_json({"path": _to_json(found) if found else None, "reason": reason})
        elif found:
            _print_path(found)
        else:
            say(f"no path: {reason}")
    if output is not None:
        from navbake.views.plot import plot_grid, render_png  # loads numpy

        if output == STDOUT:
            write_stdout(render_png(content, layers=("occupancy",), route=found))
        else:
            plot_grid(content, output, layers=("occupancy",), route=found)
    if not found:
        raise Exit(1)


def _to_json(found: paths.Path) -> dict[str, Any]:
    described = {key: getattr(found, key) for key in ("length", "cost", "rooms", "doors")}
    arrays = {key: getattr(found, key).tolist() for key in ("positions", "levels", "cells")}
    return described | arrays


def _print_path(found: paths.Path) -> None:
    print(f"length  {found.length:.3f} m")
    print(f"cost    {found.cost:.3f}")
    say(f"rooms   {', '.join(found.rooms) or '-'}")
    say(f"doors   {', '.join(found.doors) or '-'}")
    print("      x       y       z  level")
    for (x, y, z), level in zip(found.positions, found.levels, strict=True):
        print(f"{x:7.3f} {y:7.3f} {z:7.3f}  {level}")
