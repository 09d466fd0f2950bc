"""Masks of nav2's filters: rooms and polygons, with the values that its filters take."""

import json

import numpy as np
import pytest
import yaml
from PIL import Image

from grid_maps import house_from
from map_grids import sample, small
from navbake.errors import FormatError


def mask(path):
    """The values of a mask as nav2's map server reads raw images, row 0 at the top."""
    stated = yaml.safe_load(path.read_text())
    assert stated["mode"] == "raw" and stated["negate"] == 0
    return np.array(Image.open(path.parent / stated["image"]))


def polygons(path, *features):
    def feature(name, x0, y0, x1, y1, **properties):
        ring = [[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]]
        geometry = {"type": "Polygon", "coordinates": [ring]}
        return {"type": "Feature", "properties": {"name": name, **properties}, "geometry": geometry}

    found = [feature(*args, **properties) for args, properties in features]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": found}))
    return path


def test_robots_stay_out_of_rooms_by_name_id_and_number(tmp_path):
    house = sample("house")
    room = house.rooms[1]
    level = house.levels[room.level]
    for name in (room.name or room.id, room.id):
        house.convert(tmp_path / "m.yaml", "nav2-keepout", level=room.level, zone=[name])
        inside = level.room_index == room.index
        np.testing.assert_array_equal(mask(tmp_path / "m.yaml"), np.where(inside, 100, 0))
    paths = house.convert(tmp_path / "m.yaml", "nav2-keepout", zone=["1"])
    for path, level in zip(paths[1::2], house.levels, strict=True):
        np.testing.assert_array_equal(mask(path) == 100, level.room_index == 1)


def test_polygons_hold_the_cells_whose_centres_they_hold(tmp_path):
    # 5 × 3 cells of 0.1 m from x -3.7, y 12.1
    path = polygons(tmp_path / "z.json", (("desk", -3.68, 12.28, -3.46, 12.5), {}))
    small().convert(tmp_path / "m.yaml", "nav2-keepout", zones=path)
    expected = [[100, 100, 0, 0, 0], [0] * 5, [0] * 5]
    assert mask(tmp_path / "m.yaml").tolist() == expected


def test_the_least_speed_counts(tmp_path):
    path = polygons(
        tmp_path / "z.json",
        (("slow", -3.7, 12.1, -3.5, 12.4), {}),
        (("all", -3.7, 12.1, -3.2, 12.4), {}),
        (("up", -3.7, 12.1, -3.2, 12.4), {"level": 1}),
    )
    grid = house_from([small(), small(ground=3.0)])
    zone = ["slow=20", "all=60", "up=5"]
    first, second = grid.convert(tmp_path / "m.yaml", "nav2-speed", zone=zone, zones=path)[1::2]
    assert mask(first).tolist() == [[20, 20, 60, 60, 60]] * 3
    assert mask(second).tolist() == [[5] * 5] * 3


@pytest.mark.parametrize(
    ("to", "options", "culprit"),
    [
        ("nav2-keepout", {}, "a mask needs zones"),
        ("nav2-speed", {}, "a mask needs zones"),
        ("nav2-keepout", {"zone": ["attic"]}, "called 'attic'; there are: .+, "),
        ("nav2-speed", {"zone": ["kitchen"]}, "NAME=PERCENT, 1 to 100, as zone, got 'kitchen'"),
        ("nav2-speed", {"zone": ["kitchen=0"]}, "got 'kitchen=0'"),
        ("nav2-speed", {"zone": ["kitchen=101"]}, "got 'kitchen=101'"),
        ("nav2-keepout", {"zone": ["1"], "image": "tif"}, "pgm or png"),
        ("nav2-keepout", {"zones": "away.json"}, "'far' in away.json lies outside of level 0"),
        ("nav2-keepout", {"zones": "up.json"}, "no level 7"),
        ("nav2-keepout", {"zones": "absent.json"}, "absent.json"),
    ],
)
def test_what_makes_no_mask_is_refused(tmp_path, monkeypatch, to, options, culprit):
    monkeypatch.chdir(tmp_path)
    polygons(tmp_path / "away.json", (("far", 900, 900, 901, 901), {}))
    polygons(tmp_path / "up.json", (("up", 0, 0, 1, 1), {"level": 7}))
    with pytest.raises(FormatError, match=culprit) as caught:
        sample("house").convert(tmp_path / "m.yaml", to, **options)
    assert "\n" not in str(caught.value) and not (tmp_path / "m.yaml").exists()
