"""How much may change before the floor has to be measured again.

Whether a sheet is a floor, and what its ground is, depends on the whole of it: on how many cells
are left when it is shrunk, and on the most common of its lowest heights. All of that is measured
once, with how many cells may change before any of it can come out otherwise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navbake.baker.floors.levels import LARGE_ROOF, LevelFloor
from navbake.baker.floors.stairs import PLATEAU
from navbake.baker.live.growth import FloorChanges
from navbake.baker.live.kernels.regions import are_in
from navbake.baker.live.not_local import NotLocal
from navbake.baker.live.sheets import LiveSheets
from navbake.types import Float, Int


class Measured(NamedTuple):
    """The ground of a floor, and how far the floor is from being judged otherwise.

    Attributes:
        lowest: the lowest of all floors [m].
        bucket: the ground's height in multiples of PLATEAU.
        bucket_low: the lowest floor of about that height [m].
        left: so many cells may change before the floor has to be measured again.
    """

    lowest: float
    bucket: int
    bucket_low: float
    left: int


class FloorBudget:
    """The measures of the one floor, taken again where they may be others.

    Args:
        level: its arrays are read again when the floor is measured.
        sheets: the floor's sheet and the others.
        step: the highest step of the agent [m].
    """

    def __init__(self, level: LevelFloor, sheets: LiveSheets, step: float) -> None:
        self._level, self._sheets, self._step = level, sheets, step
        self._known = self._measure()

    def check(self, heights: Float) -> None:
        """Make sure that new surfaces of the floor, at some heights [m], are no lower ground."""
        known = self._known
        number: Int = np.round(heights / PLATEAU).astype(np.int64)
        if (heights < known.lowest).any():
            raise NotLocal("a floor is lower than all others")
        if ((number == known.bucket) & (heights < known.bucket_low)).any():
            raise NotLocal("a floor is a little lower than the ground")

    def spend(self, changes: FloorChanges) -> None:
        """Measure the floor again where so much has changed that it may be judged otherwise."""
        stands = self._level.standable.reshape(-1)
        flipped = changes.standable
        risen = changes.heights[stands[changes.heights]]
        risen = risen[~are_in(risen, flipped)]
        if not len(flipped) + len(risen):
            return
        # a change of height counts as one of all that is near; two counts are compared
        num = self._count_changed(flipped) + len(self._sheets.around(risen, self._sheets.reach))
        self._known = self._known._replace(left=self._known.left - 2 * num)
        if self._known.left < 0:
            was, self._known = self._known, self._measure()
            if was[:3] != self._known[:3]:
                raise NotLocal("the ground has another height")

    def _count_changed(self, flipped: Int) -> int:
        """How many cells are left now when the floor is shrunk and weren't, or the other way.

        Cells of the floor that became standable, or are no longer, count too. In any part of the
        floor that goes by heights no more cells can have changed.
        """
        sheets, stands = self._sheets, self._level.standable.reshape(-1)
        region = sheets.around(flipped, 2 * sheets.reach)
        near = are_in(region, sheets.around(flipped, sheets.reach))
        is_flipped = are_in(region, flipped)
        now = stands[region]
        left = np.zeros((2, len(region)), dtype=np.bool_)
        for row, marks in zip(left, (now, now ^ is_flipped), strict=True):
            row[marks] = sheets.test.inner(region[marks])
        return int(np.count_nonzero(((left[0] != left[1]) & near) | is_flipped))

    def _measure(self) -> Measured:
        """Measure the floor.

        The ground is the most common height, to 2 cm, of what is left of the lowest floors when
        they are shrunk, see `find_grounds`; and the lowest floor of that height.
        """
        sheets = self._sheets
        standable, floor = self._level.standable.ravel(), self._level.floor.ravel()
        main = standable
        if len(sheets.other_floor):
            main = standable.copy()
            main[sheets.other_floor] = False
        every = np.flatnonzero(standable)
        cells = np.flatnonzero(main) if len(sheets.other_floor) else every
        if len(cells) <= sheets.other_sizes.max(initial=0):
            raise NotLocal("another floor is as large")
        inner_cells = sheets.test.inner(cells)
        left = [np.count_nonzero(inner_cells) - sheets.needed]
        z = floor[every]
        lowest, half_step = float(z.min()), max(self._step, PLATEAU) / 2
        is_low = ((z - lowest) / half_step).astype(np.int64) <= 1
        if len(cells) == np.count_nonzero(is_low) == len(every):
            inner = inner_cells  # all is as low, and of one sheet
        else:
            every, z = every[is_low], z[is_low]
            inner = sheets.test.inner(every)
        left.append(np.count_nonzero(inner) - sheets.needed)
        if min(left) <= 0:
            raise NotLocal("hardly any floor is left when it is shrunk")
        number: Int = np.round(z / PLATEAU).astype(np.int64)
        first = int(number.min())
        counts = np.bincount(number[inner] - first)
        bucket = int(counts.argmax())
        in_bucket = number == bucket + first
        bucket_low = float(z[inner & in_bucket].min())
        if z[in_bucket].min() < bucket_low:
            raise NotLocal("the lowest floor of the ground's height is only at its edge")
        left.append(counts[bucket] - np.delete(counts, bucket).max(initial=0))
        left += [np.count_nonzero(inner & (z == bucket_low)), np.count_nonzero(z == lowest)]
        for size in sheets.other_sizes:  # larger or smaller sheets are judged by the floor's size
            left += [abs(len(cells) - size), abs(len(cells) - size / LARGE_ROOF)]
        return Measured(lowest, bucket + first, bucket_low, int(min(left)) - 1)
