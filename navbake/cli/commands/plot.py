"""The command `navbake plot`."""

from pathlib import Path

from typer import BadParameter, Option

import navbake
from navbake.cli.options import STDOUT, GridFile, check_output, write_stdout
from navbake.cli.printing import say_unless_quiet

PICTURES = (".png", ".svg")

# Functions import views when they run: --help loads no numpy, no matplotlib.


def plot(
    grid: GridFile,
    output: Path = Option(
        ..., "-o", "--output", metavar="PNG|SVG", help="Picture to write; - for a PNG on stdout."
    ),
    level: int | None = Option(
        None, metavar="N", min=0, help="Draw only this level; 0 is the lowest.  [default: all]"
    ),
    layers: list[str] | None = Option(
        None,
        "--layer",
        metavar="LAYER",
        help="Draw occupancy, floor, rooms, doors, clearance, island, weights or links. May be "
        "repeated.  [default: occupancy and floor]",
    ),
) -> None:
    """Draw a grid: a row for each level, a column for each layer.

    Up is the world's +y.

    Example: navbake plot house.grid.json -o house.png --layer rooms --layer floor
    """
    from navbake.views.layers import LAYERS
    from navbake.views.plot import DEFAULT_LAYERS, plot_grid, render_png

    for layer in layers or ():
        if layer not in LAYERS:
            raise BadParameter(
                f"expected one of {', '.join(LAYERS)}, got {layer}", param_hint="--layer"
            )
    check_output(output, *PICTURES, inputs=[grid])
    content, chosen = navbake.load(grid), tuple(layers or DEFAULT_LAYERS)
    if output == STDOUT:
        write_stdout(render_png(content, level=level, layers=chosen))
    else:
        say_unless_quiet(plot_grid(content, output, level=level, layers=chosen))
