"""The command `navbake path`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from typer import BadParameter, Exit, Option

import navbake
from navbake.cli.options import AsJson, GridFile, check_output
from navbake.cli.printing import print_json

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.runtime.paths import path as paths

POSITION = "X,Y[,Z|,LEVEL]"
NAMED = ("room:", "object:")


def path(
    grid: GridFile,
    start: str = Option(
        ..., "--from", metavar=POSITION, help="Start [m]; in place of z a level, L0 is the lowest."
    ),
    goals: list[str] = Option(
        ...,
        "--to",
        metavar=f"{POSITION}|room:NAME|object:NAME",
        help="Goal: a position, a room, or an object to stop beside. Repeat it with several "
        "positions to reach the cheapest of them.",
    ),
    radius: float | None = Option(
        None, metavar="R", help="Inflate the grid for this agent radius first [m]."
    ),
    smooth: bool = Option(True, help="Straighten the path, or follow the cells' centres."),
    as_json: AsJson = False,
    output: Path | None = Option(None, "-o", "--output", metavar="PNG", help="Draw the path."),
) -> None:
    """Plan a path through a grid, or say why there is none.

    The exit status is 1 if there is none.
    """
    if output is not None:
        check_output(output, ".png")
    if len(goals) > 1 and any(goal.startswith(NAMED) for goal in goals):
        raise BadParameter("several goals have to be positions", param_hint="--to")
    content = navbake.load(grid)
    if radius is not None:
        content = content.inflate(radius)
    finder = navbake.PathFinder(content)
    origin = _parse_position(content, start, "--from")
    goal: Any = goals[0]
    if not goal.startswith(NAMED):
        goal = [_parse_position(content, text, "--to") for text in goals]
    found = finder.find_path(origin, goal, smooth=smooth)
    reason = None if found else finder.why_not(origin, goal)
    if as_json:
        print_json({"path": _to_json(found) if found else None, "reason": reason})
    elif found:
        _print_path(found)
    else:
        print(f"no path: {reason}")
    if output is not None:
        from navbake.views.plot import plot_grid  # loads numpy

        plot_grid(content, output, layers=("occupancy",), route=found)
    if not found:
        raise Exit(1)


def _parse_position(grid: NavGrid, text: str, option: str) -> list[float]:
    """World x, y and, where the text gives z or a level, z."""
    parts = text.split(",")
    try:
        if len(parts) not in (2, 3):
            raise ValueError
        if len(parts) == 2 or not parts[2].strip().upper().startswith("L"):
            return [float(part) for part in parts]
        x, y, level = float(parts[0]), float(parts[1]), int(parts[2].strip()[1:])
    except ValueError:
        raise BadParameter(
            f"expected {POSITION} as in 1.5,-2 or 1.5,-2,0.3 or 1.5,-2,L1, got {text}",
            param_hint=option,
        ) from None
    cell = grid.cell_at((x, y), level)
    z = grid.levels[level].ground if cell is None else float(grid.position_of(cell)[2])
    found = grid.cell_at((x, y, z))
    if found is not None and found.level != level:  # where the level is open to the one below
        raise BadParameter(f"level {level} has no floor at {x:g}, {y:g}", param_hint=option)
    return [x, y, z]


def _to_json(found: paths.Path) -> dict[str, Any]:
    described = {key: getattr(found, key) for key in ("length", "cost", "rooms", "doors")}
    arrays = {key: getattr(found, key).tolist() for key in ("positions", "levels", "cells")}
    return described | arrays


def _print_path(found: paths.Path) -> None:
    print(f"length  {found.length:.3f} m")
    print(f"cost    {found.cost:.3f}")
    print(f"rooms   {', '.join(found.rooms) or '-'}")
    print(f"doors   {', '.join(found.doors) or '-'}")
    print("      x       y       z  level")
    for (x, y, z), level in zip(found.positions, found.levels, strict=True):
        print(f"{x:7.3f} {y:7.3f} {z:7.3f}  {level}")
