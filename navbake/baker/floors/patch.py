"""Patches of surfaces, as warnings describe them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from navbake.baker.floors.facts import SheetFacts
from navbake.baker.floors.rejected import given_spans
from navbake.baker.floors.sheets import Members, Sheets, middle_of
from navbake.config.settings import LevelSettings
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Int32


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


def describe_members(lattice: Lattice, members: Members) -> Patch:
    """Describe some surfaces, one at least."""
    area = len(members.cell) * lattice.cell_size**2
    place = middle_of(lattice, members.cell, members.z)
    geom = int(np.bincount(members.geom).argmax())
    return Patch(geom, area, place, members.cell.astype(np.int32))


def describe_sheets(
    sheets: Sheets,
    chosen: Bool,
    facts: SheetFacts,
    given: Sequence[LevelSettings] | None = None,
) -> list[Patch]:
    """Describe some sheets, shape (sheets,), the largest first.

    Args:
        facts: keeps what is known of those that stay.
        given: only what lies on these levels is described, if any are given.
    """

    def describe(asked: Bool) -> list[Patch | None]:
        found: list[Patch | None] = []
        for sheet in np.flatnonzero(asked).tolist():
            members = sheets.members(sheet)
            if given:
                z = members.z
                inside = np.any([(z >= a) & (z < b) for a, b in given_spans(given)], axis=0)
                members = members.only(inside)
            found.append(describe_members(sheets.lattice, members) if len(members.z) else None)
        return found

    never = np.zeros(len(chosen), dtype=np.int64)
    patches = [
        patch
        for patch in facts.of("patch of levels" if given else "patch", chosen, never, describe)
        if patch
    ]
    return sorted(patches, key=lambda patch: -patch.area)
