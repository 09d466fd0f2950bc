"""What steps lead to: the sheets that count as reached, and the levels that none of them is on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navbake.baker.columns import Columns
from navbake.baker.floors.sheets import Standable
from navbake.baker.kernels.constants import SLACK
from navbake.errors import SceneError
from navbake.types import Bool, Int


@dataclass(frozen=True)
class UnreachedLevel:
    """A level that no step leads to from where one starts.

    Attributes:
        level: its number.
        geom: the geom that most of its floor belongs to.
        area: of its floors [m²].
    """

    level: int
    geom: int
    area: float


def find_starts(
    standable: Standable, large: Standable, positions: list[list[float]], step: float
) -> Bool:
    """Find the sheets that one stands on at some positions.

    One stands on the highest standable surface of the column that is at most a step higher than
    the position, however far below it; on what is too small for a floor only where there is no
    floor below that is large enough.

    Args:
        standable: all standable surfaces.
        large: those of the sheets that are large enough for floors.
        positions: `floors.from`, x, y, z of each [m].
        step: the largest step [m].

    Returns:
        Which sheets they are, shape (sheets,), bool.

    Raises:
        SceneError: there is no floor at a position.
    """
    starts, lattice = np.zeros(len(standable.sheet_size), dtype=np.bool_), standable.lattice
    for number, (x, y, z) in enumerate(positions):
        row, col = (int(i) for i in lattice.rows_cols([x, y]))
        first = last = 0
        if 0 <= row < lattice.height and 0 <= col < lattice.width:
            cell = row * lattice.width + col
            first, last = standable.start[cell : cell + 2]
        heights, sheets = standable.z[first:last], standable.sheet[first:last]
        below = np.flatnonzero(heights <= z + step + SLACK)
        if not len(below):
            there = ", ".join(f"{height:.2f}" for height in heights)
            raise SceneError(
                f"no floor at `floors.from[{number}]` ({x:g}, {y:g}, {z:g}): expected one that "
                f"an agent can stand on, at most a step higher; "
                + (f"floors there are at {there} m" if there else "there is none in that cell")
            )
        on_floor = below[large.sheet_size[sheets[below]] > 0]
        starts[sheets[[*below, *on_floor][-1]]] = True
    return starts


def largest_of_lowest(standable: Standable, level: Int) -> Bool:
    """The sheet with the largest floor on the lowest level, as a mask, shape (sheets,)."""
    size = np.bincount(standable.sheet[level == 0], minlength=len(standable.sheet_size))
    reached = np.zeros(len(size), dtype=np.bool_)
    reached[size.argmax()] = True
    return reached


def find_unreached(
    standable: Standable, level: Int, reached: Bool, columns: Columns
) -> list[UnreachedLevel]:
    """Find the levels that no reached sheet is on, lowest first."""
    unreached = []
    is_reached = reached[standable.sheet]
    for number in np.setdiff1d(level, level[is_reached]):
        members = np.flatnonzero(level == number)
        geoms = columns.geom[standable.surface[members]]
        area = len(members) * standable.lattice.cell_size**2
        unreached.append(UnreachedLevel(int(number), int(np.bincount(geoms).argmax()), area))
    return unreached
