"""Files of flights: JSON; MCAP is tested with that of grids."""

from __future__ import annotations

import json

import numpy as np
import pytest

import navbake
from navbake.errors import FormatError
from navbake.formats.flights import read_flight


@pytest.fixture(scope="module")
def flight():
    voxels = navbake.VoxelGrid(
        values=np.zeros((9, 9, 9), dtype=bool), origin=(0.0, 0.0, 0.0), res=0.1
    )
    return navbake.VoxelFinder(voxels, 0.1).find_path((0.2, 0.2, 0.2), (0.2, 0.7, 0.7))


def test_json_has_positions_and_numbers(tmp_path, flight):
    flight.save(tmp_path / "flight.json")
    facts = json.loads((tmp_path / "flight.json").read_text())
    assert facts["positions"] == flight.positions.tolist() == [[0.2, 0.2, 0.2], [0.2, 0.7, 0.7]]
    assert facts["length"] == flight.length == pytest.approx(0.5 * 2**0.5)
    assert facts["cost"] == flight.cost and facts["radius"] == 0.1


def test_another_ending_is_refused(tmp_path, flight):
    with pytest.raises(FormatError, match=r"expected a name that ends in \.json or \.mcap"):
        flight.save(tmp_path / "flight.csv")
    assert not list(tmp_path.iterdir())


def test_a_json_file_gives_the_path_back(tmp_path, flight):
    flight.save(tmp_path / "flight.json")
    again = read_flight(tmp_path / "flight.json")
    assert (again.positions == flight.positions).all() and not len(again.voxels)
    assert (again.length, again.cost, again.radius) == (flight.length, flight.cost, 0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("radius", "Radius"), "expected a path that `navbake fly` wrote as JSON in .*flight.json"),
        (("0.7", "null"), r"`null` - at `\$.positions"),
        (('"radius": 0.1', '"radius": 0'), "expected one finite position or more, and a radius"),
        (("{", ""), "expected a path that `navbake fly` wrote as JSON"),
    ],
)
def test_what_is_no_flight_is_told(tmp_path, flight, change, message):
    path = tmp_path / "flight.json"
    flight.save(path)
    path.write_text(path.read_text().replace(*change, 1))
    with pytest.raises(FormatError, match=message):
        read_flight(path)
