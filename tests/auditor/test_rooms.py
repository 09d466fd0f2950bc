"""Where rooms lie, held against what a bake measures."""

from __future__ import annotations

import numpy as np
import pytest

from grid_maps import level_from
from navbake.auditor.audit import find_room_centers

MAP = """
..2..
. .3.
..#..
"""


@pytest.mark.parametrize("seed", range(5))
def test_middles_of_rooms_are_the_means_of_their_cells(seed):
    level = level_from(MAP, cell_size=0.3, x=-0.45, y_max=2.0)
    index = np.random.default_rng(seed).integers(0, 4, level.shape)
    level.attributes["roomIndex"] = index.astype(np.uint16)
    expected = {room.index: room.centroid for room in level.measure_rooms()}
    found = find_room_centers(level)
    assert found.keys() == expected.keys()
    for room, middle in found.items():
        assert middle == pytest.approx(expected[room], abs=2e-6)
