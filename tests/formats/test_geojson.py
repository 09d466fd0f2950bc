"""GeoJSON that holds rooms, files that don't, and what grids are written as."""

from __future__ import annotations

import csv
import json
import sys

import numpy as np
import pytest
import shapely

import navbake
from grid_maps import level_from
from navbake.errors import FormatError, MissingDependencyError
from navbake.formats.shapes import read_room_outlines
from project_paths import GOLDEN

SQUARE = [[0, 0], [4, 0], [4, 3], [0, 3], [0, 0]]
HOLE = [[1, 1], [2, 1], [2, 2], [1, 2], [1, 1]]


def feature(coordinates, kind="Polygon", **properties):
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def read(tmp_path, content):
    path = tmp_path / "plan.geojson"
    text = content if isinstance(content, str) else json.dumps(content)
    path.write_text(text, encoding="utf-8")
    return read_room_outlines(path)


def test_reads_polygons_with_holes_and_parts(tmp_path):
    features = [
        feature([SQUARE, HOLE], name="küche", level=1.0),
        feature([[SQUARE], [[[9, 9, 5.0], [10, 9, 5.0], [9, 10, 5.0]]]], "MultiPolygon"),
        feature([SQUARE], name="客厅", level="roof", outdoors=True),
    ]
    kitchen, parts, living = read(tmp_path, {"type": "FeatureCollection", "features": features})
    assert (kitchen["name"], kitchen["level"]) == ("küche", 1)
    assert kitchen["points"] == SQUARE[:-1]
    assert kitchen["rings"] == [HOLE[:-1]]
    assert (parts["name"], parts["level"]) == (None, 0)
    assert parts["rings"] == [[[9, 9], [10, 9], [9, 10]]]
    assert (living["name"], living["level"]) == ("客厅", "roof")
    assert [room["outdoors"] for room in (kitchen, parts, living)] == [False, False, True]


def test_reads_a_single_feature(tmp_path):
    assert len(read(tmp_path, feature([SQUARE]))) == 1


@pytest.mark.parametrize(
    ("content", "culprit"),
    [
        ("{", "broken JSON in .*line 1"),
        ("[]", "expected a GeoJSON FeatureCollection"),
        ({"type": "Point", "coordinates": [0, 0]}, "got Point"),
        ({"type": "FeatureCollection", "features": [{}]}, "feature 0 of"),
        (feature([0, 0], "Point"), "expected a Polygon or MultiPolygon, got Point in feature 0"),
        (feature([SQUARE], level=-1), "got -1 in feature 0"),
        (feature([SQUARE], level=True), "got True in feature 0"),
        (feature([SQUARE], level=0.5), "got 0.5 in feature 0"),
        (feature([SQUARE], outdoors="yes"), "true or false at `properties.outdoors`, got yes"),
        (feature([SQUARE], name=7), "expected text at `properties.name`, got 7"),
        (feature([[[0, 0], [1, 0], [0, 0]]], name="wc"), r"got 2 in feature 0 \('wc'\)"),
        (feature([[[0, 0], [1, 1], [1, 0], [0, 1]]], name="wc"), "sides that cross.*'wc'"),
        (feature([[["0", 0], [1, 1], [1, 0]]]), "positions"),
        (feature([[[None, 0], [1, 1], [1, 0]]]), "positions"),
        (
            {**feature([SQUARE]), "properties": []},
            "an object at `properties`, got a list of 0 in f",
        ),
        ({**feature([SQUARE]), "properties": [1]}, "an object at `properties`, got a list of 1"),
        ({**feature([SQUARE]), "properties": "wc"}, "an object at `properties`, got wc"),
        ({**feature([SQUARE]), "properties": 0}, "an object at `properties`, got 0"),
        ({"type": "\n"}, r"got \\n in "),
        (feature([[[0, 0], [1e308, 0], [-1e308, 1e308]]]), "corners beyond 1e.10 m in feature 0"),
        (feature([[[x, x * x] for x in range(10_001)]]), "10001 corners, more than 10000"),
        (feature(7), "rings"),
        (feature([]), "expected an outline, got none"),
        ({"type": "Feature", "geometry": None}, "got none in feature 0"),
    ],
)
def test_refuses(tmp_path, content, culprit):
    with pytest.raises(FormatError, match=culprit) as caught:
        read(tmp_path, content)
    assert "plan.geojson" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_refuses_what_is_not_there(tmp_path):
    with pytest.raises(FormatError, match=r"no such file: .*none\.geojson"):
        read_room_outlines(tmp_path / "none.geojson")
    with pytest.raises(FormatError, match="expected a file, got the folder"):
        read_room_outlines(tmp_path)


def test_a_name_that_no_file_can_have_is_refused(tmp_path):
    with pytest.raises(FormatError, match=r"no such file: .*aaa\.geojson"):
        read_room_outlines(tmp_path / f"{'a' * 300}.geojson")


@pytest.mark.parametrize("name", ["apartment", "clutter", "house", "terrain", "warehouse"])
def test_shapely_reads_what_is_written(tmp_path, name):
    grid = navbake.load(GOLDEN / f"{name}.grid.json.gz")
    (path,) = grid.convert(tmp_path / "plan.geojson")
    written = json.loads(path.read_bytes())
    assert written["navbake"]["cellSize"] == grid.cell_size
    shapes = grid.to_polygons()
    for entry, shape in zip(written["features"], shapes, strict=True):
        read = shapely.from_geojson(json.dumps(entry["geometry"]))
        assert read.is_valid and shapely.equals_exact(read, shape.geometry, tolerance=0)
        assert entry["properties"] == shape.properties
    outlines = read_room_outlines(path)
    assert [(o["name"], o["level"]) for o in outlines] == [(r.name, r.level) for r in grid.rooms]


@pytest.mark.parametrize("name", ["apartment", "clutter"])
def test_rooms_that_were_written_divide_a_bake_alike(tmp_path, name):
    """All that is not in a wall gets the room that it had."""
    grid = navbake.load(GOLDEN / f"{name}.grid.json.gz")
    grid.convert(tmp_path / "rooms.geojson")
    settings = navbake.samples.path(name)
    rooms = {"from": ["polygons"], "polygons": str(tmp_path / "rooms.geojson")}
    again = navbake.bake(settings, rooms=rooms)
    assert {room.source for room in again.rooms} == {"polygons"}
    for one, other in zip(grid.levels, again.levels, strict=True):
        np.testing.assert_array_equal(one.room_index, other.room_index)


def test_names_with_odd_letters_come_back(tmp_path):
    level = level_from("..")
    level.attributes["roomIndex"] = np.array([[1, 2]], dtype=np.uint16)
    names = ['a "b"\\<c>&\n', "客厅\x01"]
    level.metadata["navbake"] = {
        "rooms": [
            {"index": k, "id": name, "name": name, "level": 0, "area": 0.01,
             "centroid": [0, 0, 0], "neighbours": []}
            for k, name in enumerate(names, 1)
        ]
    }  # fmt: skip
    level.convert(tmp_path / "plan.geojson")
    assert [r["name"] for r in read_room_outlines(tmp_path / "plan.geojson")] == names


def test_a_grid_without_shapes_is_an_empty_collection(tmp_path):
    level_from("#").convert(tmp_path / "plan.geojson")
    assert json.loads((tmp_path / "plan.geojson").read_text())["features"] == []
    assert read_room_outlines(tmp_path / "plan.geojson") == []


def test_what_is_no_room_is_left_out(tmp_path):
    line = {"type": "LineString", "coordinates": [[0, 0], [1, 0]]}
    door = {"type": "Feature", "properties": {"kind": "door"}, "geometry": line}
    other = feature([SQUARE], name="hall")
    other["properties"]["kind"] = "kitchen"  # not a kind of ours
    rooms = read(tmp_path, {"type": "FeatureCollection", "features": [door, other]})
    assert [room["name"] for room in rooms] == ["hall"]


# ---------------------------------------------------------------- WKT


@pytest.mark.parametrize("name", ["apartment", "house", "terrain"])
def test_shapely_reads_what_is_written_of_a_table(tmp_path, name):
    grid = navbake.load(GOLDEN / f"{name}.grid.json.gz")
    (path,) = grid.convert(tmp_path / "plan.wkt")
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for row, shape in zip(rows, grid.to_polygons(), strict=True):
        assert shapely.equals_exact(shapely.from_wkt(row.pop("WKT")), shape.geometry, tolerance=0)
        expected = {key: "" if v is None else str(v) for key, v in shape.properties.items()}
        assert row == {key: expected[key] for key in row}
        assert set(row) == {"kind", "level", "levelName", "height", "id", "name", "area"}


def table_of_room(folder, name):
    """The rows of a CSV of a room with a name, and of the walkable area."""
    level = level_from("..")
    level.attributes["roomIndex"] = np.array([[1, 1]], dtype=np.uint16)
    table = [{**room.to_json(), "name": name} for room in level.measure_rooms()]
    level.metadata["navbake"] = {"rooms": table}
    (path,) = level.convert(folder / "plan.csv")
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("name", ['a,"b"', "a=1", " a ", "Küche"])
def test_any_name_comes_back_of_a_table(tmp_path, name):
    [room, walkable] = table_of_room(tmp_path, name)
    assert (room["kind"], room["name"], walkable["kind"]) == ("room", name, "walkable")


def test_without_shapely_it_says_what_to_install_of_a_table(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "shapely", None)
    with pytest.raises(MissingDependencyError, match=r'pip install "navbake\[convert\]"'):
        level_from(".").convert(tmp_path / "plan.wkt")
    assert not list(tmp_path.iterdir())
    with pytest.raises(MissingDependencyError, match=r'pip install "navbake\[convert\]"'):
        _ = level_from(".").to_polygons()[0].geometry
    level_from(".").convert(tmp_path / "plan.geojson")  # takes none


def test_no_cell_of_a_table_is_a_formula_or_holds_control_characters(tmp_path):
    for name, written in (
        *((f"{begin}cmd|' /C calc'!A0", f"'{begin}cmd|' /C calc'!A0") for begin in "=+-@"),
        ("\x1b[2Ja\r\nb\t=1", r"\x1b[2Ja\r\nb\t=1"),
    ):
        assert table_of_room(tmp_path, name)[0]["name"] == written
