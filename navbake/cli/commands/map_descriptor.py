"""The command `navbake mdf`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from typer import Argument, BadParameter, Option

import navbake
from navbake.cli.options import AsJson, refuse_unused
from navbake.cli.printing import print_json
from navbake.errors import ConfigError

if TYPE_CHECKING:
    from numpy.typing import NDArray

SQUARE = 0.1  # edge of a square unless given [m]

# Functions import what reads grids when they run: --help stays quick.


class Squares(NamedTuple):
    """Options that lay the descriptor's squares over a level."""

    level: int | None = Option(
        None, metavar="N", min=0, help="Which level; 0 is the lowest.  [default: 0]"
    )
    corner: tuple[float, float] | None = Option(
        None, metavar="X Y", help="Lower left corner [m].  [default: the level's]"
    )
    rows: int | None = Option(
        None, metavar="N", min=1, help="Squares up.  [default: the whole level; decoding: 20]"
    )
    cols: int | None = Option(
        None, metavar="N", min=1, help="Squares across.  [default: the whole level; decoding: 15]"
    )
    square: float | None = Option(
        None, metavar="METRES", help="Edge of a square [m].  [default: 0.1]"
    )

    @property
    def shape(self) -> tuple[int, int] | None:
        return None if self.rows is None or self.cols is None else (self.rows, self.cols)


def mdf(
    squares: Squares,
    grid: Path | None = Argument(None, metavar="GRID", help="A NavGrid file."),
    decode: tuple[str, str] | None = Option(
        None, metavar="P1 P2", help="Draw this descriptor in place of a GRID."
    ),
    explored: Path | None = Option(
        None,
        metavar="NPY",
        help="Which squares are explored: an array [row, col], row 0 at the top.  [default: all]",
    ),
    as_json: AsJson = False,
) -> None:
    """Write a level as a map descriptor (two hex strings) and draw it.

    Example: navbake mdf house.grid.json --square 0.2
    """
    if (grid is None) == (decode is None):
        raise BadParameter("expected a GRID, or --decode P1 P2", param_hint="GRID")
    if (squares.rows is None) != (squares.cols is None):
        raise BadParameter("expected both or none of them", param_hint="--rows, --cols")
    refuse_unused(
        *(
            (name, value is not None, decode is None, "a GRID")
            for name, value in (
                ("--level", squares.level),
                ("--corner", squares.corner),
                ("--square", squares.square),
                ("--explored", explored),
            )
        )
    )
    from navbake.arena import map_descriptor  # loads numpy

    if decode is not None:
        part1, part2 = decode
        known, filled = map_descriptor.decode(part1, part2, squares.shape or map_descriptor.ARENA)
    else:
        assert grid is not None
        known, filled = _read_squares(grid, squares, explored)
        part1, part2 = map_descriptor.encode(known, filled)
    drawing = map_descriptor.draw(known, filled)
    if as_json:
        facts = {"rows": known.shape[0], "cols": known.shape[1], "part1": part1, "part2": part2}
        print_json({**facts, "map": drawing.split("\n")})
        return
    if decode is None:
        print(f"{part1}\n{part2}")
    print(drawing)


def _read_squares(
    path: Path, squares: Squares, explored: Path | None
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Which squares of a level are explored, and which hold an obstacle."""
    import numpy as np  # --help does without it

    from navbake.arena.arena import find_obstacles, place_squares
    from navbake.formats.npz import read_npy  # which loads numpy

    levels = navbake.load(path).levels
    number = squares.level or 0
    if number >= len(levels):
        raise ConfigError(f"no level {number} in {path}: it has {len(levels)}, counted from 0")
    level = levels[number]
    edge = SQUARE if squares.square is None else squares.square
    placed = place_squares(level, square=edge, corner=squares.corner, shape=squares.shape)
    filled = find_obstacles(level, placed)
    if explored is None:
        return np.ones_like(filled), filled
    return read_npy(explored), filled
