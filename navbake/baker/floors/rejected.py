"""Which sheets are no floors, though they are large enough: tops, shelves and roofs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from navbake.baker.floors.outline import Site
from navbake.baker.floors.roofs import find_roofs, find_shelves, measure_shares
from navbake.baker.floors.sheets import Standable
from navbake.baker.floors.tops import find_tops
from navbake.baker.kernels.constants import SLACK
from navbake.config.settings import LevelSettings
from navbake.types import Bool

# A given ground takes in floors down to this much below it [m]
GIVEN_TOLERANCE = 0.02


class Rejected(NamedTuple):
    """The large sheets that are no floors; masks, shape (sheets,), of which one sheet is in one.

    Attributes:
        tops: tops of what stands on a floor, see `find_tops`.
        shelves: see `find_shelves`.
        roofs: see `find_roofs`.
    """

    tops: Bool
    shelves: Bool
    roofs: Bool

    @property
    def any(self) -> Bool:
        """The sheets that are in one of the three."""
        rejected: Bool = self.tops | self.shelves | self.roofs
        return rejected


def find_rejected(site: Site, given: Sequence[LevelSettings] | None) -> Rejected:
    """Find the large sheets that are no floors, each judged by itself among all the others.

    A roof counts as a floor nevertheless where it is the only one there is: in the whole scene,
    or on a level that is given.

    Args:
        given: the levels of the configuration, or None where they are to be found.
    """
    none = np.zeros(len(site.large.sheet_size), dtype=np.bool_)
    tops = shelves = roofs = none
    shares = measure_shares(site)
    if not site.settings.tops:
        tops, shelves = find_tops(site), find_shelves(site, shares)
    if not site.settings.roofs:
        roofs = find_roofs(site, shares)
    is_floor = (site.large.sheet_size > 0) & ~(tops | shelves | roofs)
    if not is_floor.any():
        roofs = none
    for level in given_levels(site.large, given or ()):
        on_level = np.bincount(site.large.sheet[level], minlength=len(none)) > 0
        if not (on_level & is_floor).any():
            roofs = roofs & ~on_level
    return Rejected(tops & ~roofs, shelves & ~roofs, roofs)


def given_levels(standable: Standable, given: Sequence[LevelSettings]) -> Iterator[Bool]:
    """Tell which surfaces lie on each of the given levels, from its ground to its top, shape (n,).

    A level begins a little below its ground, since a hand that writes 3.0 means a floor at 2.99.
    """
    for number, level in enumerate(given):
        above = given[number + 1].ground - GIVEN_TOLERANCE if given[number + 1 :] else np.inf
        top = above if level.top is None else min(above, level.top)
        yield (standable.z >= level.ground - GIVEN_TOLERANCE) & (standable.z < top - SLACK)
