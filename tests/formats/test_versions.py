"""Grids that each version of navbake wrote are read, and answer as they did.

All are the sample house at cells of 0.2 m. Nothing before 0.3.0 was released: the files of 0.1 and
0.2 both say 0.1.0.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import navbake
from navbake._version import __version__

HERE = Path(__file__).parent / "versions"
FREE = {
    "0.1.0": [2781, 1004],
    "0.2.0": [2781, 1004],
    "0.3.0": [2771, 983],
    "0.4.0": [2771, 983],
}
"""The free cells of each level."""


def test_each_version_has_a_file():
    assert {path.name.removesuffix(".grid.json.gz") for path in HERE.iterdir()} == {*FREE}
    assert __version__ in FREE


@pytest.mark.parametrize("version", FREE)
def test_a_file_is_read_and_answers(version, caplog, tmp_path):
    grid = navbake.load(HERE / f"{version}.grid.json.gz")
    assert not caplog.messages
    assert [int(level.free.sum()) for level in grid.levels] == FREE[version]
    assert {room.level for room in grid.rooms} == {0, 1}
    assert "door_kitchen" in {door.id for door in grid.doors}
    finder = navbake.PathFinder(grid)
    start = finder.snap(grid.rooms[0].centroid)
    path = finder.find_path(start, next(f"room:{room.id}" for room in grid.rooms if room.level))
    assert path is not None
    assert set(path.levels) == {0, 1}  # by the stairs
    # a larger agent, from the layer `solid` where the file has one
    assert 0 < grid.inflate(0.2).levels[0].free.sum() < FREE[version][0]
    grid.save(tmp_path / "again.grid.json")
    again = navbake.load(tmp_path / "again.grid.json")
    for level, other in zip(grid.levels, again.levels, strict=True):
        np.testing.assert_array_equal(level.weights, other.weights)
