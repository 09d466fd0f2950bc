"""The table with WKT: read by csv and shapely, it has the shapes of the grid."""

from __future__ import annotations

import csv
import sys

import numpy as np
import pytest
import shapely

import navbake
from grid_maps import level_from
from navbake.errors import MissingDependencyError
from navbake.navgrid.rooms import measure_rooms
from project_paths import GOLDEN


@pytest.mark.parametrize("name", ["apartment", "house", "terrain"])
def test_shapely_reads_what_is_written(tmp_path, name):
    grid = navbake.load(GOLDEN / f"{name}.grid.json.gz")
    (path,) = grid.convert(tmp_path / "plan.wkt")
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for row, shape in zip(rows, grid.to_polygons(), strict=True):
        assert shapely.equals_exact(shapely.from_wkt(row.pop("WKT")), shape.geometry, tolerance=0)
        expected = {key: "" if v is None else str(v) for key, v in shape.properties.items()}
        assert row == {key: expected[key] for key in row}
        assert set(row) == {"kind", "level", "levelName", "height", "id", "name", "area"}


@pytest.mark.parametrize("name", ["a\rb", "a\nb", 'a,"b"', "=1+1", " a "])
def test_any_name_comes_back(tmp_path, name):
    level = level_from("..")
    level.attributes["roomIndex"] = np.array([[1, 1]], dtype=np.uint16)
    table = [{**room.to_json(), "name": name} for room in measure_rooms(level, 0)]
    level.metadata["navbake"] = {"rooms": table}
    (path,) = level.convert(tmp_path / "plan.csv")
    with open(path, newline="", encoding="utf-8") as file:
        [room, walkable] = csv.DictReader(file)
    assert (room["kind"], room["name"], walkable["kind"]) == ("room", name, "walkable")


def test_without_shapely_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "shapely", None)
    with pytest.raises(MissingDependencyError, match=r'pip install "navbake\[convert\]"'):
        level_from(".").convert(tmp_path / "plan.wkt")
    assert not list(tmp_path.iterdir())
    with pytest.raises(MissingDependencyError, match=r'pip install "navbake\[convert\]"'):
        _ = level_from(".").to_polygons()[0].geometry
    level_from(".").convert(tmp_path / "plan.geojson")  # takes none
