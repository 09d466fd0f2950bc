"""Patches of surfaces, as warnings describe them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from navbake.baker.floors.sheets import Standable, middle_of
from navbake.types import Bool, Int, Int32


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


def describe_patch(standable: Standable, members: Int) -> Patch:
    """Describe some surfaces, given by their indices, shape (n,), n >= 1."""
    geoms = standable.geom[members]
    cells, z = standable.cell[members], standable.z[members]
    area = len(members) * standable.lattice.cell_size**2
    place = middle_of(standable.lattice, cells, z)
    return Patch(int(np.bincount(geoms).argmax()), area, place, cells)


def describe_sheets(standable: Standable, chosen: Bool) -> list[Patch]:
    """Describe some sheets, shape (sheets,), the largest first."""
    sheets = standable.members(np.flatnonzero(chosen))
    patches = [describe_patch(standable, members) for _, members in sheets]
    return sorted(patches, key=lambda patch: -patch.area)
