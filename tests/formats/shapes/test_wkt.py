"""The table with WKT: read by csv and shapely, it has the shapes of the grid."""

from __future__ import annotations

import csv
import sys

import pytest
import shapely

import navbake
from grid_maps import level_from
from navbake.errors import MissingDependencyError
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


def test_without_shapely_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "shapely", None)
    with pytest.raises(MissingDependencyError, match=r'pip install "navbake\[convert\]"'):
        level_from(".").convert(tmp_path / "plan.wkt")
    assert not list(tmp_path.iterdir())
    with pytest.raises(MissingDependencyError, match=r'pip install "navbake\[convert\]"'):
        _ = level_from(".").to_polygons()[0].geometry
    level_from(".").convert(tmp_path / "plan.geojson")  # takes none
