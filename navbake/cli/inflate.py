"""The command `navbake inflate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from navbake.cli.files import GridFile, check_writable

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid


def inflate(
    grid: GridFile,
    radius: Annotated[float, typer.Option(metavar="R", help="Radius of the agent [m].")],
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="OUT", help="File to write; GRID itself will do."),
    ],
    clearance: Annotated[
        float | None,
        typer.Option(
            metavar="C",
            help="How far beyond the radius cells cost more [m].  "
            "[default: 0; with nav2, as far as the cost reaches 1]",
        ),
    ] = None,
    mode: Annotated[
        str, typer.Option(help="exact: no disc meets an occupied square; minos: as the original.")
    ] = "exact",
    costs: Annotated[
        str, typer.Option(help="What cells within the clearance cost: step (10), or nav2.")
    ] = "step",
    scaling: Annotated[float, typer.Option(help="How fast nav2's costs fall [1/m].")] = 10.0,
) -> None:
    """Make a grid good for a larger agent."""
    from navbake.formats.navgrid import read_navgrid
    from navbake.runtime.inflation.inflate import check_arguments

    check_arguments(radius, clearance, mode, costs, scaling)
    check_writable(output)
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
