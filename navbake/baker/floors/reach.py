"""What steps lead to: where one starts, and the floors that no step leads to from there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from navbake.baker.floors.outline import DROP, Site, find_edges, find_endings
from navbake.baker.floors.patch import Patch, describe_patch
from navbake.baker.floors.rejected import Rejected
from navbake.baker.floors.sheets import Standable
from navbake.baker.floors.tops import LARGE_TOP
from navbake.baker.kernels.constants import SLACK
from navbake.errors import SceneError
from navbake.types import Bool, Int

# A position that is at most this far from a surface lies on it, furniture or not [m]
ON_SURFACE = 0.02
# A sheet that no step leads to, beside floors that are reached, is told of from this size on:
# shafts and niches are smaller [m²]
TOLD_AREA = 6.0


@dataclass(frozen=True)
class Unreached:
    """What no step leads to on a level, from where one starts.

    Attributes:
        level: its number.
        patch: the floors there, all together; the place is on the largest.
        whole: whether no floor of the level is reached.
    """

    level: int
    patch: Patch
    whole: bool


def find_starts(site: Site, rejected: Rejected, positions: list[list[float]]) -> Bool:
    """Find the sheets that one stands on at some positions.

    A position within 2 cm of a surface lies on it, whatever it is. Elsewhere one stands on the
    highest floor of the column that is at most a step higher than the position, however far below
    it. Roofs, and tops of at least 6 m², such as platforms, are floors here; furniture is none:
    over a desk, one stands on the floor that the desk's top drops to along most of its outline.
    Only where there is none, one stands on the furniture.

    Args:
        rejected: the sheets that are no floors unless one starts there.
        positions: `floors.from`, x, y, z of each [m].

    Returns:
        Which sheets they are, shape (sheets,), bool.

    Raises:
        SceneError: there is no floor at a position.
    """
    every, step = site.every, site.agent.traversable_floor_height
    size = site.large.sheet_size
    is_large_top = rejected.tops & (size * every.lattice.cell_size**2 >= LARGE_TOP)
    counts = (size > 0) & ~rejected.shelves & (~rejected.tops | is_large_top)
    starts = np.zeros(len(size), dtype=np.bool_)
    for number, (x, y, z) in enumerate(positions):
        row, col = (int(i) for i in every.lattice.rows_cols([x, y]))
        first = last = 0
        if 0 <= row < every.lattice.height and 0 <= col < every.lattice.width:
            cell = row * every.lattice.width + col
            first, last = every.start[cell : cell + 2]
        heights, sheets = every.z[first:last], every.sheet[first:last]
        below = sheets[heights <= z + step + SLACK]
        if not len(below):
            there = ", ".join(f"{height:.2f}" for height in heights)
            raise SceneError(
                f"no floor at `floors.from[{number}]` ({x:g}, {y:g}, {z:g}): expected one that "
                f"an agent can stand on, at most a step higher; "
                + (f"floors there are at {there} m" if there else "there is none in that cell")
            )
        exactly = sheets[abs(heights - z) <= ON_SURFACE + SLACK]
        floors = below[counts[below]]
        if len(exactly):
            starts[exactly[-1]] = True
        elif len(floors):
            starts[floors[-1]] = True
        else:
            starts[_floor_beside(site, counts, int(below[-1]))] = True
    return starts


def _floor_beside(site: Site, counts: Bool, furniture: int) -> int:
    """The floor that a sheet of furniture drops to along most of its outline, else itself."""
    is_thing = np.arange(len(counts)) == furniture
    standable = site.every.only_sheets(counts | is_thing)
    edges = find_edges(standable, is_thing, site.agent.traversable_floor_height, site.reach)
    endings = find_endings(edges, standable, site.columns, site.agent, site.is_occupied)
    drops = endings.kind == DROP
    floors = standable.sheets_at(endings.cell[drops], endings.landing[drops])
    return int(np.bincount(floors).argmax()) if len(floors) else furniture


def largest_of_lowest(standable: Standable, level: Int) -> Bool:
    """The sheet with the largest floor on the lowest level, as a mask, shape (sheets,)."""
    size = np.bincount(standable.sheet[level == 0], minlength=len(standable.sheet_size))
    reached = np.zeros(len(size), dtype=np.bool_)
    reached[size.argmax()] = True
    return reached


def find_unreached(standable: Standable, level: Int, reached: Bool) -> list[Unreached]:
    """Find the floors that no step leads to, one entry a level, lowest first.

    Of a level where a part is reached, only the sheets count that have at least 6 m² there.

    Args:
        reached: which sheets are reached, shape (sheets,), bool.
    """
    unreached = []
    is_reached = reached[standable.sheet]
    for number in np.unique(level[~is_reached]).tolist():
        members = np.flatnonzero((level == number) & ~is_reached)
        whole = not (is_reached & (level == number)).any()
        area = np.bincount(standable.sheet[members]) * standable.lattice.cell_size**2
        if not whole:
            members = members[area[standable.sheet[members]] >= TOLD_AREA - SLACK]
        if len(members):
            largest = members[standable.sheet[members] == area.argmax()]
            place = describe_patch(standable, largest).place
            patch = replace(describe_patch(standable, members), place=place)
            unreached.append(Unreached(number, patch, whole))
    return unreached
