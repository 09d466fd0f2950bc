"""The command `navbake path`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from navbake.cli.files import GridFile, check_writable

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid
    from navbake.runtime.paths import path as paths

PLACE = "X,Y[,Z|,LEVEL]"


def path(
    grid: GridFile,
    start: Annotated[
        str,
        typer.Option(
            "--from", metavar=PLACE, help="World position [m]; a level as L0, the lowest, or L1."
        ),
    ],
    goals: Annotated[
        list[str],
        typer.Option(
            "--to",
            metavar=f"{PLACE}|room:NAME|object:NAME",
            help="Where to: a position, a room or next to an object. Of several positions, the "
            "one that is the cheapest to reach.",
        ),
    ],
    radius: Annotated[
        float | None,
        typer.Option(metavar="R", help="Inflate the grid for this radius first [m]."),
    ] = None,
    smooth: Annotated[
        bool, typer.Option(help="Pull the path straight, or keep to the cells' centres.")
    ] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="PNG", help="Draw the path.")
    ] = None,
) -> None:
    """Plan a path, or say why there is none, with exit status 1."""
    from navbake.formats.navgrid import read_navgrid
    from navbake.runtime.path_finder import PathFinder

    if output is not None:
        if output.suffix.lower() != ".png":
            raise typer.BadParameter(f"expected a name in .png, got {output}", param_hint="-o")
        check_writable(output)
    content = read_navgrid(grid)
    if radius is not None:
        content = content.inflate(radius)
    finder = PathFinder(content)
    origin = _parse_place(content, start, "--from")
    goal = _parse_goals(content, goals)
    found = finder.find_path(origin, goal, smooth=smooth)
    reason = None if found else finder.why_not(origin, goal)
    if as_json:
        print(json.dumps(_to_json(found, reason), indent=2, ensure_ascii=False))
    elif found:
        _print_path(found)
    else:
        print(f"no path: {reason}")
    if output is not None:
        from navbake.views.plot import plot_grid

        plot_grid(content, output, layers=("occupancy",), route=found)
    if not found:
        raise typer.Exit(1)


def _parse_goals(grid: NavGrid, texts: list[str]) -> Any:
    named = [text for text in texts if text.startswith(("room:", "object:"))]
    if named and len(texts) > 1:
        raise typer.BadParameter("several goals have to be positions", param_hint="--to")
    return texts[0] if named else [_parse_place(grid, text, "--to") for text in texts]


def _parse_place(grid: NavGrid, text: str, option: str) -> list[float]:
    """World x, y and z, if it is told or follows from the level."""
    parts = text.split(",")
    try:
        if len(parts) not in (2, 3):
            raise ValueError
        if len(parts) == 2 or not parts[2].strip().upper().startswith("L"):
            return [float(part) for part in parts]
        x, y, level = float(parts[0]), float(parts[1]), int(parts[2].strip()[1:])
    except ValueError:
        raise typer.BadParameter(
            f"expected {PLACE} as in 1.5,-2 or 1.5,-2,0.3 or 1.5,-2,L1, got {text}",
            param_hint=option,
        ) from None
    cell = grid.cell_at((x, y), level)
    z = grid.levels[level].ground if cell is None else float(grid.position_of(cell)[2])
    found = grid.cell_at((x, y, z))
    if found is not None and found.level != level:  # where the level is open to the one below
        raise typer.BadParameter(f"level {level} has no floor at {x:g}, {y:g}", param_hint=option)
    return [x, y, z]


def _to_json(found: paths.Path | None, reason: str | None) -> dict[str, Any]:
    if found is None:
        return {"path": None, "reason": reason}
    described = {
        "length": found.length,
        "cost": found.cost,
        "rooms": found.rooms,
        "doors": found.doors,
        "positions": found.positions.tolist(),
        "levels": found.levels.tolist(),
        "cells": found.cells.tolist(),
    }
    return {"path": described, "reason": None}


def _print_path(found: paths.Path) -> None:
    print(f"length  {found.length:.3f} m")
    print(f"cost    {found.cost:.3f}")
    print(f"rooms   {', '.join(found.rooms) or '-'}")
    print(f"doors   {', '.join(found.doors) or '-'}")
    print("      x       y       z  level")
    for (x, y, z), level in zip(found.positions, found.levels, strict=True):
        print(f"{x:7.3f} {y:7.3f} {z:7.3f}  {level}")
