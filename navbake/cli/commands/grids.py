"""The commands that look at a grid: `navbake info`, `rooms` and `why`."""

from typer import Option

import navbake
from navbake.cli import printing
from navbake.cli.options import AsJson, GridFile
from navbake.cli.places import PLACE, PLACE_HELP, parse_place
from navbake.errors import QueryError

# Functions import views when they run: --help loads no numpy.


def info(grid: GridFile, as_json: AsJson = False) -> None:
    """Print a summary of a grid: levels, areas, doors, versions.

    Example: navbake info house.grid.json
    """
    from navbake.views.describe import describe

    content = navbake.load(grid)
    facts = describe(content)
    if as_json:
        printing.print_json(facts)
        return
    shown = [printing.summary_table(facts), printing.level_table(facts)]
    if content.doors:
        shown.append(printing.door_table(content.doors, content.level_names))
    printing.print_tables(*shown)
    printing.print_warnings(content.warnings)


def rooms(grid: GridFile, as_json: AsJson = False) -> None:
    """List the rooms of a grid, what each opens to, and the doors.

    Example: navbake rooms house.grid.json
    """
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
    at: str = Option(..., metavar=PLACE, help=f"World position, {PLACE_HELP}."),
    as_json: AsJson = False,
) -> None:
    """Print what a grid holds at a position, and what blocks it.

    Of X,Y alone, each level that spans the position is printed; of X,Y,Z, the one whose floor is
    the nearest below it.

    Example: navbake why house.grid.json --at 1.5,0.2,L0
    """
    from navbake.views.describe import describe_column

    x, y, z, level = parse_place(at, "--at")
    content = navbake.load(grid)
    if z is not None:
        cell = content.cell_at((x, y, z))
        if cell is None:
            raise QueryError(f"{at} is in no cell: it lies beside the grid, or below its floors")
        level = cell.level
    if level is None:
        cells = describe_column(content, x, y)
    else:
        cells = [content.describe_cell(x, y, level)]
    if as_json:
        printing.print_json(cells)
    else:
        printing.print_tables(*map(printing.cell_table, cells))
