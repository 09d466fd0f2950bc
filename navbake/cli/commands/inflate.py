"""The command `navbake inflate`."""

from pathlib import Path

from typer import Option

import navbake
from navbake.cli.options import (
    GRIDS,
    STDOUT,
    GridFile,
    beside_output,
    check_output,
    refuse_unused,
    write_stdout,
)
from navbake.cli.printing import say_unless_quiet


def inflate(
    grid: GridFile,
    radius: float = Option(..., metavar="METRES", help="Radius of the agent [m]."),
    output: Path = Option(
        ...,
        "-o",
        "--output",
        metavar="FILE",
        help="File to write (.json or .json.gz), - for stdout; not GRID itself.",
    ),
    clearance: float | None = Option(
        None,
        metavar="METRES",
        help="Distance beyond the radius within which cells cost more [m].  "
        "[default: 0; with nav2 costs, up to where the cost falls to 1]",
    ),
    mode: str = Option(
        "exact",
        metavar="exact|minos",
        help="exact (its disc meets no occupied cell) or minos (the original client's).",
    ),
    costs: str = Option(
        "step",
        metavar="step|nav2",
        help="Cost of cells within the clearance: step (10), or nav2 (exponential).",
    ),
    scaling: float | None = Option(
        None,
        metavar="FACTOR",
        help="How fast nav2 costs fall, its cost_scaling_factor [1/m].  [default: 10]",
    ),
    ledges: str | None = Option(
        None,
        metavar="avoid|ignore",
        help="avoid (no drop of more than a step within the radius) or ignore.  [default: avoid]",
    ),
) -> None:
    """Inflate the obstacles of a grid for an agent of another radius.

    Example: navbake inflate house.grid.json --radius 0.3 -o wide.grid.json
    """
    from navbake.formats.navgrid import dumps_navgrid  # loads numpy
    from navbake.runtime.inflation import SCALING, check_arguments  # loads numpy

    refuse_unused(
        ("--scaling", scaling is not None, costs == "nav2", "--costs nav2"),
        ("--ledges", ledges is not None, mode != "minos", "--mode exact"),
    )
    scaling, ledges = SCALING if scaling is None else scaling, ledges or "avoid"
    # The arguments are checked before the grid is read: a large one takes seconds.
    check_arguments(radius, clearance, mode, costs=costs, scaling=scaling, ledges=ledges)
    check_output(output, *GRIDS, inputs=[grid])
    before = navbake.load(grid)
    after = before.inflate(radius, clearance, mode, costs=costs, scaling=scaling, ledges=ledges)
    if output == STDOUT:
        write_stdout(dumps_navgrid(after))
    else:
        after.save(output)
    areas = [
        sum(int(level.free.sum()) * level.lattice.cell_size**2 for level in content.levels)
        for content in (before, after)
    ]
    share = f" ({areas[1] / areas[0]:.1%})" if areas[0] else ""
    with beside_output(output):
        say_unless_quiet(
            f"{output}: {areas[1]:.2f} of {areas[0]:.2f} m² free{share} "
            f"for an agent of radius {radius:g} m ({mode})"
        )
