"""The settings of the rooms."""

import json

import pytest

from navbake.config.settings import load_config, parse_config, settings_digest
from navbake.errors import ConfigError

SQUARE = [[0, 0], [4, 0], [4, 3], [0, 3]]


def rooms(value):
    return parse_config({"scene": {"path": "a.xml"}, "rooms": value}, "house.yaml").rooms


def test_short_forms():
    assert rooms(None).sources == ["polygons", "geoms", "sites", "auto"]
    assert rooms("auto").sources == ["auto"]
    assert rooms("none").sources == []
    assert rooms({"from": ["sites", "auto"]}).sources == ["sites", "auto"]
    assert rooms({}).geoms == ["room|*", "room_*", "floor|*"]
    assert rooms({}).sites == ["room*"]
    assert rooms({}).door_width == "auto"


def test_polygons():
    room = rooms({"polygons": [{"name": "廊", "level": "upper", "points": SQUARE}]}).polygons[0]
    assert (room.name, room.level, room.rings, room.outdoors) == ("廊", "upper", [], False)
    assert room.points == [[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]]


def test_a_geojson_file_is_read_beside_the_yaml(tmp_path):
    geometry = {"type": "Polygon", "coordinates": [[*SQUARE, SQUARE[0]]]}
    plan = {"type": "Feature", "properties": {"name": "hall"}, "geometry": geometry}
    (tmp_path / "plan.geojson").write_text(json.dumps(plan))
    yaml = tmp_path / "house.yaml"
    yaml.write_text("scene: {path: a.xml}\nrooms: {polygons: plan.geojson}\n")
    config = load_config(yaml)
    assert [room.name for room in config.rooms.polygons] == ["hall"]
    written = {"rooms": {"polygons": [{"name": "hall", "points": SQUARE}]}}
    same = parse_config({"scene": {"path": "a.xml"}, **written})
    assert settings_digest(config) == settings_digest(same)
    assert parse_config(config.model_dump()) == config


@pytest.mark.parametrize(
    ("value", "culprit"),
    [
        ("doors", 'expected auto, none or a mapping, got "doors" at `rooms`'),
        (3, "got 3 at `rooms`"),
        ({"form": ["auto"]}, "unknown key `rooms.form`, the nearest known one is `rooms.from`"),
        ({"from": ["auto", "auto"]}, 'each once, got ["auto", "auto"] at `rooms.from`'),
        ({"from": ["walls"]}, "polygons, geoms, sites, auto, each once"),
        ({"door_width": 0}, "expected a number > 0, or auto, got 0 at `rooms.door_width`"),
        ({"min_area": -1}, "expected a number >= 0, got -1 at `rooms.min_area`"),
        ({"polygons": "none.geojson"}, "no such file: none.geojson, named at `rooms.polygons`"),
        ({"polygons": "p" * 5000}, f"{'p' * 300}, named at `rooms.polygons`"),
        ({"polygons": [{"name": "a"}]}, "found none at `rooms.polygons[0].points`"),
        ({"polygons": [{"points": SQUARE[:2]}]}, "got a list of 2 at `rooms.polygons[0].points`"),
        ({"polygons": [{"points": [[0, 0], [1, 0], [1]]}]}, "expected 3 or more corners"),
        (
            {"polygons": [{"points": [[0, 0], [1, 1], [1, 0], [0, 1]]}]},
            "got sides that cross: [0, 0] to [1, 1] and [1, 0] to [0, 1] at "
            "`rooms.polygons[0].points` in house.yaml",
        ),
        ({"polygons": [{"points": SQUARE, "level": -1}]}, "got -1 at `rooms.polygons[0].level`"),
        ({"polygons": [{"points": SQUARE, "name": ""}]}, "at `rooms.polygons[0].name`"),
        ({"polygons": [{"points": SQUARE, "hole": []}]}, "unknown key `rooms.polygons[0].hole`"),
    ],
)
def test_refuses(value, culprit):
    with pytest.raises(ConfigError) as caught:
        rooms(value)
    assert culprit in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1500
