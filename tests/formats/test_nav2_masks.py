"""Masks of nav2's costmap filters: which cells they mark, and that they come back as areas."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import shapely
import yaml
from PIL import Image

import navbake
from grid_maps import house_from, level_from
from map_grids import sample, small
from navbake.errors import FormatError, QueryError
from navbake.formats.convert import read_as
from navbake.formats.nav2_masks import read_keepout, read_speed
from navbake.navgrid.islands import add_layers
from navbake.navgrid.links import Area


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
    for path, level in zip(paths[1::3], house.levels, strict=True):
        np.testing.assert_array_equal(mask(path) == 100, level.room_index == 1)


def test_a_mask_that_marks_nothing_says_where_the_zones_are(tmp_path, caplog):
    """As of a level that the zone isn't on: no robot would stay out."""
    house = sample("house")
    upstairs = next(room for room in house.rooms if room.level == 1)
    path = tmp_path / "m.yaml"
    house.convert(path, "nav2-keepout", level=0, zone=[upstairs.id])
    assert caplog.messages == ["m.yaml marks no cell: the zones or areas are on level 1"]
    house.convert(path, "nav2-keepout", level=1, zone=[upstairs.id])
    house.convert(path, "nav2-keepout", zone=[upstairs.id])  # the mask of level 0 is empty
    assert len(caplog.records) == 1
    area = {"navbake": {"areas": [{"name": "pit", "cost": "inf"}]}}
    small().with_layers(metadata=area).convert(path, "nav2-keepout")
    assert caplog.messages[1:] == ["m.yaml marks no cell: the zones or areas have none"]


def test_zones_are_a_list(tmp_path):
    with pytest.raises(FormatError, match=r"expected a list of zones, as in \['1'\], got '1'"):
        sample("house").convert(tmp_path / "m.yaml", "nav2-keepout", zone="1")


def test_keepout_marks_every_cell_that_it_touches_and_speed_those_with_their_centre(tmp_path):
    # 5 × 3 cells of 0.1 m from x -3.7, y 12.1
    path = polygons(tmp_path / "z.json", (("desk", -3.68, 12.28, -3.46, 12.5), {}))
    small().convert(tmp_path / "m.yaml", "nav2-keepout", zones=path)
    expected = [[100, 100, 100, 0, 0], [100, 100, 100, 0, 0], [0] * 5]
    assert mask(tmp_path / "m.yaml").tolist() == expected
    small().convert(tmp_path / "m.yaml", "nav2-speed", zones=path, zone=["desk=40"])
    assert mask(tmp_path / "m.yaml").tolist() == [[40, 40, 0, 0, 0], [0] * 5, [0] * 5]


def test_a_slanted_line_of_4_cm_leaves_no_gap(tmp_path):
    level = level_from("\n".join(["." * 40] * 20))
    ring = [[0.0, -0.2], [4.0, -1.6], [4.0, -1.64], [0.0, -0.24], [0.0, -0.2]]
    geometry = {"type": "Polygon", "coordinates": [ring]}
    feature = {"type": "Feature", "properties": {"name": "line"}, "geometry": geometry}
    (tmp_path / "z.json").write_text(json.dumps(feature))
    level.convert(tmp_path / "m.yaml", "nav2-keepout", zones=tmp_path / "z.json")
    marked = mask(tmp_path / "m.yaml") == 100
    assert marked.any(axis=0).all()
    for (row, col), is_marked in np.ndenumerate(marked):
        x, y = level.lattice.positions(row, col)
        area = (
            shapely.Polygon(ring)
            .intersection(shapely.box(x - 0.05, y - 0.05, x + 0.05, y + 0.05))
            .area
        )
        assert is_marked == (area > 1e-12)


def test_a_zone_thinner_than_a_cell_says_so(tmp_path):
    path = polygons(tmp_path / "z.json", (("wire", -3.7, 12.26, -3.5, 12.27), {}))
    with pytest.raises(FormatError, match=r"'wire' in .* is thinner than a cell of level 0"):
        small().convert(tmp_path / "m.yaml", "nav2-speed", zones=path, zone=["wire=40"])
    small().convert(tmp_path / "m.yaml", "nav2-keepout", zones=path)
    assert mask(tmp_path / "m.yaml").tolist() == [[0] * 5, [100, 100, 0, 0, 0], [0] * 5]


def test_the_least_speed_counts(tmp_path):
    path = polygons(
        tmp_path / "z.json",
        (("slow", -3.7, 12.1, -3.5, 12.4), {}),
        (("all", -3.7, 12.1, -3.2, 12.4), {}),
        (("up", -3.7, 12.1, -3.2, 12.4), {"level": 1}),
    )
    grid = house_from([small(), small(ground=3.0)])
    zone = ["slow=20", "all=60", "up=5"]
    first, second = grid.convert(tmp_path / "m.yaml", "nav2-speed", zone=zone, zones=path)[1::3]
    assert mask(first).tolist() == [[20, 20, 60, 60, 60]] * 3
    assert mask(second).tolist() == [[5] * 5] * 3


@pytest.mark.parametrize(
    ("to", "options", "culprit"),
    [
        ("nav2-keepout", {}, "a mask needs zones"),
        ("nav2-speed", {}, "a mask needs zones"),
        ("nav2-speed", {"zone": ["1=5"], "absolute": True}, "for masks of the grid's areas"),
        ("nav2-keepout", {"zone": ["1"], "agent": "robot"}, "for masks of the grid's areas"),
        ("nav2-keepout", {"zone": ["attic"]}, "called 'attic': the grid has .+, "),
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


# ---------------------------------------------------------------- areas

TABLE = [
    {"name": "lab", "cost": "inf"},
    {"name": "staff", "agents": ["robot"], "speed": 0.5},
    {"name": "carpet", "cost": 2, "speed": 0.24},
    {"name": "plain"},
]
AGENTS = {"robot": {"speed": 0.8}, "cart": {}}


def with_areas(seed=1, levels=2):
    rng, parts = np.random.default_rng(seed), []
    for number in range(levels):
        level = small(ground=3.0 * number)
        level.attributes["area"] = rng.integers(0, 5, level.shape).astype(np.uint8)
        parts.append(level)
    grid = house_from(parts)
    grid.metadata["navbake"] |= {"areas": TABLE, "agents": AGENTS}
    return grid


def info(path):
    """The parameters of nav2's info server, and of the map server that serves the mask."""
    nodes = yaml.safe_load(path.with_name(f"{path.stem}_filter.yaml").read_text())
    own, served = (node["ros__parameters"] for node in nodes.values())
    assert own["mask_topic"] == served["topic_name"] and served["yaml_filename"] == path.name
    return own


@pytest.mark.parametrize(("agent", "barred"), [(None, [1]), ("robot", [1]), ("cart", [1, 2])])
def test_keepout_is_what_bars_an_agent(tmp_path, agent, barred):
    grid = with_areas()
    paths = grid.convert(tmp_path / "m.yaml", "nav2-keepout", agent=agent)
    assert [p.name for p in paths[:3]] == ["m_0.pgm", "m_0.yaml", "m_0_filter.yaml"]
    for path, level in zip(paths[1::3], grid.levels, strict=True):
        expected = np.where(np.isin(level.area_index, barred), 100, 0)
        np.testing.assert_array_equal(mask(path), expected)
        assert info(path)["type"] == 0
        back = read_keepout(path)
        assert back.areas == (Area("keepout", math.inf),)
        np.testing.assert_array_equal(back.area_index, expected // 100)
        assert back.lattice == pytest.approx(level.lattice) and back.ground == level.ground
        assert not navbake.PathFinder(back).search.flat.free[expected.ravel() > 0].any()


@pytest.mark.parametrize(
    ("options", "values", "scale", "speeds"),
    [
        ({}, {2: 50, 3: 24}, (1, 0.0, 1.0), {2: 0.5, 3: 0.24}),
        ({"agent": "robot"}, {2: 62, 3: 30}, (1, 0.0, 1.0), {2: 0.496, 3: 0.24}),
        ({"absolute": True}, {2: 50, 3: 24}, (2, 0.0, 0.01), {2: 0.5, 3: 0.24}),
    ],
)
def test_limits_of_areas_come_back(tmp_path, options, values, scale, speeds):
    grid = with_areas()
    paths = grid.convert(tmp_path / "m.yaml", "nav2-speed", **options)
    agent = grid.agents.get(options.get("agent"))
    for path, level in zip(paths[1::3], grid.levels, strict=True):
        expected = np.zeros(level.shape, int)
        for number, value in values.items():
            expected[level.area_index == number] = value
        np.testing.assert_array_equal(mask(path), expected)
        own = info(path)
        assert (own["type"], own["base"], own["multiplier"]) == scale
        back = read_speed(path, agent=agent)
        found = np.array([0.0, *(area.speed for area in back.areas)])[back.area_index]
        for number, speed in speeds.items():
            assert found[level.area_index == number] == pytest.approx(speed)
        np.testing.assert_array_equal(back.area_index > 0, expected > 0)
    by_ending = read_as(paths[1], "nav2-speed")
    assert all(area.name.startswith("speed ") for area in by_ending.areas)


def test_odd_speeds_are_rounded_down(tmp_path):
    level = small()
    level.attributes["area"] = np.ones(level.shape, np.uint8)
    level.metadata["navbake"] = {"areas": [{"name": "a", "speed": 1.2345}]}
    level.convert(tmp_path / "m.yaml", "nav2-speed", absolute=True)
    assert info(tmp_path / "m.yaml")["multiplier"] == pytest.approx(0.012345)
    assert read_speed(tmp_path / "m.yaml").areas[0].speed == pytest.approx(1.2345)
    level.convert(tmp_path / "m.yaml", "nav2-speed")
    assert mask(tmp_path / "m.yaml").max() == 100  # of 1 m/s


def test_a_limit_that_is_rounded_down_to_nothing_is_refused(tmp_path):
    level = small()
    level.attributes["area"] = np.ones(level.shape, np.uint8)
    areas = [{"name": "fast", "speed": 2.0}, {"name": "creep", "speed": 0.005}]
    level.metadata["navbake"] = {"areas": areas}
    for options, least in (({"absolute": True}, "0.02"), ({}, "0.01")):
        text = f"of {least} m/s or more, .*, got 0.005 m/s in area 'creep'"
        with pytest.raises(FormatError, match=text):
            level.convert(tmp_path / "m.yaml", "nav2-speed", **options)


def test_costs_that_a_keepout_mask_lacks_are_named(tmp_path, caplog):
    with_areas().convert(tmp_path / "m.yaml", "nav2-keepout")
    (record,) = caplog.records
    assert record.getMessage() == "a keepout mask has no costs of areas: left out of carpet"
    with_areas().convert(tmp_path / "m.yaml", "nav2-speed")
    assert len(caplog.records) == 1


def test_the_layer_of_islands_follows_a_mask(tmp_path):
    level = level_from("." * 9)
    add_layers(level, {"island"})
    path = polygons(tmp_path / "z.json", (("desk", 0.41, -0.09, 0.49, -0.01), {}))
    level.convert(tmp_path / "m.yaml", "nav2-keepout", zones=path)
    back = read_keepout(tmp_path / "m.yaml", grid=level)
    assert back.attributes["island"].tolist() == [[1] * 4 + [0] + [2] * 4]


def test_a_mask_is_laid_on_a_grid(tmp_path):
    grid = with_areas()
    grid.convert(tmp_path / "m.yaml", "nav2-keepout", level=1, agent="cart")
    plain = house_from([small(), small(ground=3.0)])
    done = read_keepout(tmp_path / "m.yaml", grid=plain, level=1)
    barred = np.isin(grid.levels[1].area_index, [1, 2])
    np.testing.assert_array_equal(done.levels[1].area_index, barred)
    assert not done.levels[0].area_index.any() and not plain.areas
    again = read_keepout(tmp_path / "m.yaml", grid=done, level=0)
    assert [area.name for area in again.areas] == ["keepout", "keepout (2)"]
    done.save(tmp_path / "g.json")
    np.testing.assert_array_equal(navbake.load(tmp_path / "g.json").levels[1].area_index, barred)
    again = read_as(tmp_path / "m.yaml", "nav2-keepout")
    again.convert(tmp_path / "n.yaml", "nav2-keepout")
    np.testing.assert_array_equal(mask(tmp_path / "n.yaml"), mask(tmp_path / "m.yaml"))


def test_costs_of_other_masks(tmp_path):
    Image.fromarray(np.array([[0, 1, 98, 99, 100, 255]], np.uint8)).save(tmp_path / "m.pgm")
    stated = {"image": "m.pgm", "mode": "raw", "resolution": 0.5, "origin": [0, 0, 0], "negate": 0}
    stated |= {"occupied_thresh": 0.65, "free_thresh": 0.196}
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(stated))
    areas = read_keepout(tmp_path / "m.yaml").areas
    assert [(a.name, a.cost) for a in areas] == [
        ("cost 1", 1.0), ("cost 98", 252.0), ("keepout 99", math.inf), ("keepout", math.inf),
    ]  # fmt: skip
    assert [a.speed for a in read_speed(tmp_path / "m.yaml").areas] == [0.01, 0.98, 0.99, 1.0]


def test_what_is_no_mask_is_refused(tmp_path):
    grid = with_areas()
    with pytest.raises(QueryError, match="no agent 'robt'"):
        grid.convert(tmp_path / "m.yaml", "nav2-keepout", agent="robt")
    grid.metadata["navbake"]["areas"] = [{"name": "plain"}]
    with pytest.raises(FormatError, match="no area of the grid bars all agents"):
        grid.convert(tmp_path / "m.yaml", "nav2-keepout")
    with pytest.raises(FormatError, match="no area of the grid has a speed"):
        grid.convert(tmp_path / "m.yaml", "nav2-speed")
    level = with_areas(levels=1).levels[0]
    level.metadata["navbake"] = {"areas": TABLE}
    level.convert(tmp_path / "m.yaml", "nav2-speed")
    with pytest.raises(FormatError, match="no level 1"):
        read_speed(tmp_path / "m.yaml", grid=level, level=1)
    for text, culprit in (
        ("a: 3", "an object"), ("a: {ros__parameters: {type: 7, base: 0, multiplier: 1}}", "type"),
        ("a: {ros__parameters: {type: 1, multiplier: x, base: 0}}", "multiplier"),
        ("a: {ros__parameters: {}}", "a node with type"), ("a: b: c", "parameters of a filter"),
    ):  # fmt: skip
        (tmp_path / "m_filter.yaml").write_text(text)
        with pytest.raises(FormatError, match=culprit):
            read_speed(tmp_path / "m.yaml")
