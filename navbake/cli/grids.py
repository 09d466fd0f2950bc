"""The commands that look at a grid: `navbake info`, `rooms`, `why` and `plot`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import BadParameter, Option

from navbake.cli.options import AsJson, GridFile, check_output
from navbake.cli.printing import print_json

# Functions import grids and views when they run: --help loads no numpy, no matplotlib.


def info(grid: GridFile, as_json: AsJson = False) -> None:
    """Print a summary of a grid: levels, areas, doors, versions."""
    from navbake.cli.tables import door_table, level_table, print_tables, summary_table
    from navbake.formats.navgrid import read_navgrid
    from navbake.views.info import describe

    content = read_navgrid(grid)
    facts = describe(content)
    if as_json:
        print_json(facts)
        return
    tables = [summary_table(facts), level_table(facts)]
    if content.doors:
        tables.append(door_table(content.doors, content.level_names))
    print_tables(*tables)


def rooms(grid: GridFile, as_json: AsJson = False) -> None:
    """List the rooms of a grid, what each opens to, and the doors."""
    from navbake.cli.tables import door_table, print_tables, room_table
    from navbake.formats.navgrid import read_navgrid

    content = read_navgrid(grid)
    found, doors = content.rooms, content.doors
    if as_json:
        tables = {"rooms": [r.to_json() for r in found], "doors": [d.to_json() for d in doors]}
        print_json({"scene_id": content.scene_id, **tables})
        return
    print_tables(room_table(found, content.level_names))
    print(f"{len(found)} room{'' if len(found) == 1 else 's'}")
    if doors:
        print()
        print_tables(door_table(doors, content.level_names))


def why(
    grid: GridFile,
    at: Annotated[
        str,
        Option(metavar="X,Y[,LEVEL]", help="World position [m]; levels count from 0, the lowest."),
    ],
    as_json: AsJson = False,
) -> None:
    """Print what a grid holds at a position, and what blocks it.

    Without a LEVEL, each level that spans the position is printed.
    """
    from navbake.cli.tables import cell_table, print_tables
    from navbake.formats.navgrid import read_navgrid
    from navbake.views.why import describe_cell, describe_column

    parts = at.split(",")
    try:
        if len(parts) not in (2, 3):
            raise ValueError
        x, y = float(parts[0]), float(parts[1])
        level = int(parts[2]) if len(parts) == 3 else None
    except ValueError:
        raise BadParameter(
            f"expected X,Y or X,Y,LEVEL as in 1.5,-2,0, got {at}", param_hint="--at"
        ) from None
    content = read_navgrid(grid)
    if level is None:
        cells = describe_column(content, x, y)
    else:
        cells = [describe_cell(content, x, y, level)]
    if as_json:
        print_json(cells)
    else:
        print_tables(*(cell_table(facts) for facts in cells))


def plot(
    grid: GridFile,
    output: Annotated[Path, Option("-o", "--output", metavar="PNG", help="PNG to write.")],
    level: Annotated[
        int | None, Option(min=0, help="Draw only this level; 0 is the lowest.  [default: all]")
    ] = None,
    layers: Annotated[
        list[str] | None,
        Option(
            "--layer",
            metavar="LAYER",
            help="Draw occupancy, floor, rooms, clearance, island or weights. May be repeated.  "
            "[default: occupancy and floor]",
        ),
    ] = None,
) -> None:
    """Draw a grid: a row for each level, a column for each layer."""
    from navbake.formats.navgrid import read_navgrid
    from navbake.views.layers import LAYERS
    from navbake.views.plot import DEFAULT_LAYERS, plot_grid

    for layer in layers or ():
        if layer not in LAYERS:
            raise BadParameter(
                f"expected one of {', '.join(LAYERS)}, got {layer}", param_hint="--layer"
            )
    check_output(output, ".png")
    chosen = tuple(layers or DEFAULT_LAYERS)
    print(plot_grid(read_navgrid(grid), output, level=level, layers=chosen))
