"""Patches of surfaces, as warnings describe them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from navbake.baker.floors.kernels.members import Members
from navbake.baker.floors.sheets import SheetFacts, Sheets
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Int, Int32


@dataclass(frozen=True)
class Patch:
    """Surfaces that lie side by side, such as a sheet that is no floor.

    Attributes:
        geom: the geom that most of it belongs to.
        area: [m²].
        place: x, y, z of a place near its middle, in world coordinates [m].
        cells: its cells, shape (n,), int32.
    """

    geom: int
    area: float
    place: tuple[float, float, float]
    cells: Int32 = field(repr=False, compare=False)


def middle_of(lattice: Lattice, cells: Int | Int32, z: Float) -> tuple[float, float, float]:
    """A place on a floor, of its cells the one nearest to its middle: world x, y, z [m].

    Args:
        cells, z: the floor's cells, and its height in each, shape (n,) [m].
    """
    row, col = np.divmod(cells, lattice.width)
    nearest = int(((row - row.mean()) ** 2 + (col - col.mean()) ** 2).argmin())
    x, y = lattice.center_x()[col[nearest]], lattice.center_y()[row[nearest]]
    return float(x), float(y), float(z[nearest])


def describe_members(lattice: Lattice, members: Members, largest: Members | None = None) -> Patch:
    """Describe some surfaces, one at least; the place is on the largest part of them, if given."""
    area = len(members.cell) * lattice.cell_size**2
    place = middle_of(lattice, *(largest or members)[:2])
    geom = int(np.bincount(members.geom).argmax())
    return Patch(geom, area, place, members.cell.astype(np.int32))


def describe_sheets(
    sheets: Sheets, chosen: Bool, facts: SheetFacts, spans: Sequence[tuple[float, float]] = ()
) -> list[Patch]:
    """Describe some sheets, shape (sheets,), the largest first.

    Args:
        facts: keeps what is known of those that stay.
        spans: only what lies in these spans of heights is described, if there are any [m].
    """

    def describe(asked: Bool) -> list[Patch | None]:
        found: list[Patch | None] = []
        for sheet in np.flatnonzero(asked).tolist():
            members = sheets.members(sheet)
            if spans:
                z = members.z
                members = members.only(np.any([(z >= a) & (z < b) for a, b in spans], axis=0))
            found.append(describe_members(sheets.lattice, members) if len(members.z) else None)
        return found

    name = "patch of levels" if spans else "patch"
    patches = [patch for patch in facts.of(name, chosen, describe) if patch]
    return sorted(patches, key=lambda patch: -patch.area)
