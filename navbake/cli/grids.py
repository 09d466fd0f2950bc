"""The commands that look at a grid: `navbake info`, `rooms`, `why` and `plot`."""

from pathlib import Path

from typer import BadParameter, Option

import navbake
from navbake.cli import printing
from navbake.cli.options import AsJson, GridFile, check_output

# Functions import views when they run: --help loads no numpy, no matplotlib.


def info(grid: GridFile, as_json: AsJson = False) -> None:
    """Print a summary of a grid: levels, areas, doors, versions."""
    from navbake.views.info import describe

    content = navbake.load(grid)
    facts = describe(content)
    if as_json:
        printing.print_json(facts)
        return
    shown = [printing.summary_table(facts), printing.level_table(facts)]
    if content.doors:
        shown.append(printing.door_table(content.doors, content.level_names))
    printing.print_tables(*shown)
    if content.warnings:
        print()
    for warning in content.warnings:
        print(f"warning: {warning}")


def rooms(grid: GridFile, as_json: AsJson = False) -> None:
    """List the rooms of a grid, what each opens to, and the doors."""
    content = navbake.load(grid)
    found, doors = content.rooms, content.doors
    if as_json:
        lists = {"rooms": [r.to_json() for r in found], "doors": [d.to_json() for d in doors]}
        printing.print_json({"scene_id": content.scene_id, **lists})
        return
    printing.print_tables(printing.room_table(found, content.level_names))
    print(f"{len(found)} room{'' if len(found) == 1 else 's'}")
    if doors:
        print()
        printing.print_tables(printing.door_table(doors, content.level_names))


def why(
    grid: GridFile,
    at: str = Option(
        ..., metavar="X,Y[,LEVEL]", help="World position [m]; levels count from 0, the lowest."
    ),
    as_json: AsJson = False,
) -> None:
    """Print what a grid holds at a position, and what blocks it.

    Without a LEVEL, each level that spans the position is printed.
    """
    from navbake.views.why import describe_column

    x, y, *level = at.split(",") if at.count(",") in (1, 2) else ("", "")
    try:
        position, levels = (float(x), float(y)), [int(number) for number in level]
    except ValueError:
        raise BadParameter(
            f"expected X,Y or X,Y,LEVEL as in 1.5,-2,0, got {at}", param_hint="--at"
        ) from None
    content = navbake.load(grid)
    if levels:
        cells = [content.describe_cell(*position, levels[0])]
    else:
        cells = describe_column(content, *position)
    if as_json:
        printing.print_json(cells)
    else:
        printing.print_tables(*map(printing.cell_table, cells))


def plot(
    grid: GridFile,
    output: Path = Option(..., "-o", "--output", metavar="PNG", help="PNG to write."),
    level: int | None = Option(
        None, min=0, help="Draw only this level; 0 is the lowest.  [default: all]"
    ),
    layers: list[str] | None = Option(
        None,
        "--layer",
        metavar="LAYER",
        help="Draw occupancy, floor, rooms, clearance, island or weights. May be repeated.  "
        "[default: occupancy and floor]",
    ),
) -> None:
    """Draw a grid: a row for each level, a column for each layer."""
    from navbake.views.layers import LAYERS
    from navbake.views.plot import DEFAULT_LAYERS, plot_grid

    for layer in layers or ():
        if layer not in LAYERS:
            raise BadParameter(
                f"expected one of {', '.join(LAYERS)}, got {layer}", param_hint="--layer"
            )
    check_output(output, ".png")
    chosen = tuple(layers or DEFAULT_LAYERS)
    print(plot_grid(navbake.load(grid), output, level=level, layers=chosen))
