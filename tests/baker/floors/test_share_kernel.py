"""What lies above and below of sheets, counted in one pass, against one surface after another."""

from __future__ import annotations

import numpy as np
import pytest

from navbake.baker.floors.kernels.roofs import count_open_and_over
from navbake.baker.floors.sheets import Standable
from navbake.navgrid.lattice import Lattice


@pytest.mark.parametrize("seed", range(20))
def test_counts_what_is_open_and_what_lies_over_another_sheet(seed):
    rng = np.random.default_rng(seed)
    columns = [np.sort(rng.integers(0, 5, rng.integers(0, 5)) * 1.0) for _ in range(12)]
    stands = [rng.random(len(column)) < 0.7 for column in columns]
    start = np.concatenate([[0], np.cumsum([int(marks.sum()) for marks in stands])])
    z, is_standable = np.concatenate(columns), np.concatenate(stands)
    surface = np.flatnonzero(is_standable)
    sheet = rng.integers(0, 4, len(surface))
    size, counts = np.bincount(sheet, minlength=4), rng.random(4) < 0.7
    cell = np.repeat(np.arange(12), np.diff(start))
    no_slopes = np.empty((0, 2), dtype=np.int64)
    lattice = Lattice(width=4, height=3, cell_size=1.0, x_min=0.0, y_max=3.0)
    geom = np.zeros(len(surface), dtype=np.int32)
    is_top = np.array([z[i] == columns[c][-1] for i, c in zip(surface, cell, strict=True)], bool)
    parts = z[surface], cell, surface, geom, is_top, sheet, size, no_slopes
    is_open, is_over = count_open_and_over(every := Standable(lattice, start, *parts), counts)
    expected = np.zeros((2, 4), dtype=np.int64)
    for i in np.flatnonzero(counts[sheet]).tolist():
        top = columns[cell[i]][-1]
        below = sheet[i - 1] if i and cell[i - 1] == cell[i] else sheet[i]
        expected[:, sheet[i]] += [top <= every.z[i], below != sheet[i]]
    np.testing.assert_array_equal([is_open, is_over], expected)
