"""Pictures of grids with places marked on them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from navbake.cli.options import STDOUT, write_stdout

if TYPE_CHECKING:
    from navbake.navgrid.grid import NavGrid


def write_marked(
    grid: NavGrid, output: Path, marks: Sequence[tuple[int, float, float, str]]
) -> None:
    """Draw a grid's occupancy with marks: level, world x and y [m], and what is there."""
    from navbake.views.plot import Mark, plot_grid, render_png  # loads matplotlib

    drawn = [Mark(*mark) for mark in marks]
    if output == STDOUT:
        write_stdout(render_png(grid, layers=("occupancy",), marks=drawn))
    else:
        plot_grid(grid, output, layers=("occupancy",), marks=drawn)
