"""The command `navbake inflate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from navbake.cli.options import GridFile, check_output

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid


def inflate(
    grid: GridFile,
    radius: Annotated[float, Option(metavar="R", help="Radius of the agent [m].")],
    output: Annotated[
        Path,
        Option("-o", "--output", metavar="OUT", help="File to write; it may be GRID itself."),
    ],
    clearance: Annotated[
        float | None,
        Option(
            metavar="C",
            help="Distance beyond the radius within which cells cost more [m].  "
            "[default: 0; with nav2 costs, up to where the cost falls to 1]",
        ),
    ] = None,
    mode: Annotated[
        str,
        Option(
            help="exact (the agent's disc meets no occupied cell) or minos (the original "
            "client's rule)."
        ),
    ] = "exact",
    costs: Annotated[
        str, Option(help="Cost of cells within the clearance: step (10), or nav2 (exponential).")
    ] = "step",
    scaling: Annotated[
        float, Option(help="How fast nav2 costs fall, its cost_scaling_factor [1/m].")
    ] = 10.0,
) -> None:
    """Inflate the obstacles of a grid for an agent of another radius."""
    # Imported here, so that --help loads no numpy.
    from navbake.formats.navgrid import read_navgrid
    from navbake.runtime.inflation.inflate import check_arguments

    check_arguments(radius, clearance, mode, costs, scaling)
    check_output(output)
    before = read_navgrid(grid)
    after = before.inflate(radius, clearance, mode, costs=costs, scaling=scaling)
    after.save(output)
    print(f"{output}: {_compare(before, after)} for an agent of radius {radius:g} m ({mode})")


def _compare(before: NavGrid, after: NavGrid) -> str:
    """How much of the free area is left, in words."""
    areas = [
        sum(int(level.free.sum()) * level.lattice.cell_size**2 for level in grid.levels)
        for grid in (before, after)
    ]
    share = f" ({areas[1] / areas[0]:.1%})" if areas[0] else ""
    return f"{areas[1]:.2f} of {areas[0]:.2f} m² free{share}"
