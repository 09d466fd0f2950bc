"""Maps of ROS: what is written is what nav2 reads, by its own formulas, written out here."""

import itertools
import math
import struct
import warnings
import zlib

import numpy as np
import pytest
import shapely
import shapely.affinity
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

import navbake
from grid_maps import house_from, level_from
from map_grids import CELLS, SAMPLES, random_level, sample, small
from navbake.errors import FormatError, QueryError
from navbake.formats.nav2 import MapYaml, read_pixel_values
from navbake.formats.occupancy import (
    compute_occupancy_values,
    lattice_from_corner,
    level_from_values,
)
from navbake.formats.source import Pixels
from navbake.runtime.inflation import nav2_costs
from project_paths import SHARED_DATA


def load_as_nav2(path):
    """The occupancy grid that nav2's map server makes, by its rules from Humble to Jazzy, pixel by
    pixel: the data, row 0 at the bottom, and what the YAML says. Pillow and PyYAML read the files.
    Its branch main makes the same of every file of these tests."""
    stated = yaml.safe_load(path.read_text())
    image = Image.open(path.parent / stated["image"])
    has_alpha = "A" in image.getbands()
    pixels = np.array(image.convert("RGBA" if has_alpha else "RGB"))
    data = np.full(pixels.shape[:2], -1)
    for row in range(data.shape[0]):
        for col in range(data.shape[1]):
            rgb, alpha = pixels[row, col, :3].tolist(), pixels[row, col, -1] if has_alpha else None
            value = humble_value(stated, rgb, alpha)
            assert value == main_value(stated, rgb, alpha)
            data[data.shape[0] - row - 1, col] = value
    return data, stated


def humble_value(stated, rgb, alpha):
    channels = [value / 255 for value in rgb]
    if stated["mode"] == "trinary" and alpha is not None:
        channels.append(alpha / 255)
    shade = sum(channels) / len(channels)
    occ = shade if stated["negate"] else 1.0 - shade
    if stated["mode"] == "raw":
        value = round(shade * 255)
        return value if value <= 100 else -1
    if stated["mode"] == "scale" and alpha not in (None, 255):
        return -1
    if stated["occupied_thresh"] < occ:
        return 100
    if occ < stated["free_thresh"]:
        return 0
    span = stated["occupied_thresh"] - stated["free_thresh"]
    return -1 if stated["mode"] == "trinary" else round((occ - stated["free_thresh"]) / span * 100)


def main_value(stated, rgb, alpha):
    """By the rules of nav2's branch main, whose numbers have single precision."""
    red, green, blue = (257 * int(value) for value in rgb)  # GraphicsMagick's quanta
    grey = (306 * red + 601 * green + 117 * blue) // 1024 // 257
    if stated["mode"] == "raw":
        return grey if grey <= 100 else -1
    if alpha not in (None, 255):
        return -1
    occ = np.float32(grey) / np.float32(255)
    occ = occ if stated["negate"] else np.float32(1) - occ
    free, most = np.float32(stated["free_thresh"]), np.float32(stated["occupied_thresh"])
    if occ <= free:
        return 0
    if occ >= most:
        return 100
    span = np.float32(stated["occupied_thresh"] - stated["free_thresh"])
    return -1 if stated["mode"] == "trinary" else math.floor((occ - free) / span * 100 + 0.5)


def expected_values(level):
    """Row 0 at the bottom."""
    floor = ~np.isnan(level.floor_height)
    return np.where(level.free, 0, np.where(floor, 100, -1))[::-1]


@pytest.mark.parametrize("image", ["pgm", "png"])
@pytest.mark.parametrize("name", SAMPLES)
def test_nav2_reads_each_sample_cell_by_cell(tmp_path, name, image):
    grid = sample(name)
    written = grid.to_nav2(tmp_path / "map.yaml", image=image, stairs="free")
    paths = written[1::2]
    assert len(paths) == len(grid.levels)
    for path, level in zip(paths, grid.levels, strict=True):
        data, stated = load_as_nav2(path)
        np.testing.assert_array_equal(data, expected_values(level))
        assert stated["resolution"] == level.lattice.cell_size
        check_positions(level, data, stated)


def check_positions(level, data, stated):
    """1,000 world positions lie in the same cell by nav2's formula."""
    rng = np.random.default_rng(3)
    x_min, y_min, x_max, y_max = level.lattice.bounds
    xy = rng.uniform((x_min, y_min), (x_max, y_max), size=(1000, 2))
    col, row = np.floor((xy - stated["origin"][:2]) / stated["resolution"]).astype(int).T
    rows, cols = level.lattice.rows_cols(xy)
    np.testing.assert_array_equal(cols, col)
    np.testing.assert_array_equal(rows, data.shape[0] - 1 - row)


@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
@pytest.mark.parametrize("seed", range(3))
def test_each_mode_off_the_origin_and_not_square(tmp_path, mode, seed):
    level = random_level(seed)
    level.to_nav2(tmp_path / "map.yaml", mode=mode)
    data, stated = load_as_nav2(tmp_path / "map.yaml")
    expected = expected_values(level)
    if mode != "trinary":  # what is blocked, but not occupied
        blocked = ~level.free & (level.occupancy == 0)
        expected = np.where(blocked[::-1], 99, expected)
    np.testing.assert_array_equal(data, expected)
    assert stated["origin"] == [-12.5, pytest.approx(31.25 - 23 * 0.05), 0]
    check_positions(level, data, stated)
    back = navbake.from_nav2(tmp_path / "map.yaml")
    np.testing.assert_array_equal(back.free, level.free)
    np.testing.assert_array_equal(np.isnan(back.floor), np.isnan(level.floor))
    if mode != "trinary":
        np.testing.assert_array_equal(back.occupancy, level.occupancy)
    assert back.lattice == pytest.approx(level.lattice, abs=1e-9)
    assert back.ground == 0.4 and (back.floor[back.free] == np.float32(0.4)).all()


@pytest.mark.parametrize("mode", ["scale", "raw"])
def test_a_costmap_has_the_costs_of_nav2s_formula(tmp_path, mode):
    level = level_from("........\n........\n...##...\n........\n........\n........", x=4, y_max=-2)
    level.to_nav2(tmp_path / "map.yaml", mode=mode, radius=0.1, inflation=0.35, scaling=7.0)
    data, _ = load_as_nav2(tmp_path / "map.yaml")
    obstacles = np.argwhere(level.occupancy)
    for row in range(level.height):
        for col in range(level.width):
            d = 0.1 * min(math.hypot(row - r, col - c) for r, c in obstacles)
            inscribed = d <= 0.1 + 1e-9 or not level.inflate(0.1).free[row, col]
            value = 1 + 97 * (math.floor(252 * math.exp(-7.0 * (d - 0.1))) - 1) // 251
            value = 0 if d > 0.35 + 1e-9 else value
            value = 100 if d == 0 else 99 if inscribed else value
            assert data[level.height - 1 - row, col] == value


def test_a_map_for_a_point_states_no_radius(tmp_path):
    sample("house").to_nav2(tmp_path / "a.yaml", radius=0.0, level=0)
    assert "radius" not in yaml.safe_load((tmp_path / "a.yaml").read_text())["navbake"]
    assert navbake.from_nav2(tmp_path / "a.yaml").radius == 0.0


@pytest.mark.parametrize("radius", [None, 0.3])
def test_a_map_comes_back_inflated_for_the_radius_of_its_cells(tmp_path, radius):
    flat = sample("apartment")
    flat.to_nav2(tmp_path / "a.yaml", radius=radius)
    back = navbake.from_nav2(tmp_path / "a.yaml")
    assert back.inflated_radius == (radius or flat.agent_radius)
    again = back.inflate(back.radius)
    np.testing.assert_array_equal(again.free, back.free)
    # a larger agent is free nowhere that it would not be on the grid itself
    larger = back.inflate(0.5)
    assert 0 < larger.free.sum() < back.free.sum()
    truth = flat.inflate(0.5)
    assert not (larger.free & ~truth.free).any()
    # and on more than where the blocked cells count as things that stand there
    num_larger = larger.free.sum()
    back.metadata.pop("inflation")
    back.attributes["occupancy"] = (~back.free).astype(np.uint8)
    assert back.inflate(0.5).free.sum() < num_larger or radius is None
    back.to_nav2(tmp_path / "b.yaml")
    assert (tmp_path / "a.pgm").read_bytes() == (tmp_path / "b.pgm").read_bytes()


def test_a_costmap_comes_back_with_the_same_values(tmp_path):
    house = sample("house").levels[0]
    house.to_nav2(tmp_path / "a.yaml", mode="raw", radius=0.25, inflation=0.6)
    back = navbake.from_nav2(tmp_path / "a.yaml")
    back.to_nav2(tmp_path / "b.yaml", mode="raw")
    assert (tmp_path / "a.pgm").read_bytes() == (tmp_path / "b.pgm").read_bytes()
    costs = nav2_costs(house, 0.25, 0.6)
    near = back.free & (costs > 1)
    assert near.any() and (back.weights[near] <= costs[near]).all()
    assert (costs[near] - back.weights[near] <= 3).all()  # 252 costs in 98 values


def test_an_inflated_map_is_free_where_the_inflated_grid_is(tmp_path):
    house = sample("house")
    house.to_nav2(tmp_path / "map.yaml", radius=0.4, level=1)
    data, _ = load_as_nav2(tmp_path / "map.yaml")
    np.testing.assert_array_equal((data == 0)[::-1], house.inflate(0.4).levels[1].free)


def test_each_level_has_its_map_and_the_image_comes_first(tmp_path):
    written = sample("house").to_nav2(tmp_path / "map.yaml")
    names = ["map_0.pgm", "map_0.yaml", "map_1.pgm", "map_1.yaml"]
    assert [path.name for path in written] == names
    assert navbake.from_nav2(written[3]).ground == 3.0
    assert [p.name for p in sample("house").to_nav2(tmp_path / "top.yml", level=1)] == [
        "top.pgm",
        "top.yml",
    ]


def test_a_grid_without_floors_of_its_own_has_nothing_unknown(tmp_path):
    level = level_from("..#\n..#", floors=False)
    level.to_nav2(tmp_path / "map.yaml")
    assert load_as_nav2(tmp_path / "map.yaml")[0].tolist() == [[0, 0, 100], [0, 0, 100]]


# ---------------------------------------------------------------- reading


def write_map(folder, pixels, image="map.pgm", **changed):
    """A map as other programs write it."""
    Image.fromarray(np.asarray(pixels, np.uint8)).save(folder / image)
    stated = {"image": image, "resolution": 0.5, "origin": [1.0, 2.0, 0.0], "negate": 0}
    stated |= {"occupied_thresh": 0.65, "free_thresh": 0.196}
    stated = {key: value for key, value in (stated | changed).items() if value is not None}
    (folder / "map.yaml").write_text(yaml.safe_dump(stated))
    return folder / "map.yaml"


def kinds_of(level):
    """A line for each row: . free, # occupied, x blocked, ? no floor."""
    marks = np.where(level.occupancy != 0, "#", "x")
    marks = np.where(level.free, ".", np.where(np.isnan(level.floor), "?", marks))
    return ["".join(row) for row in marks]


def test_reads_what_map_saver_writes(tmp_path):
    (tmp_path / "map.pgm").write_bytes(
        b"P5\n# CREATOR: map_saver.cpp 0.050 m/pix\n3 2\n255\n"
        + bytes([254, 0, 205, 254, 254, 100])
    )
    (tmp_path / "map.yaml").write_text(
        "image: map.pgm\nresolution: 0.050000\norigin: [-1.000000, -2.000000, 0.000000]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n\n"
    )
    level = navbake.from_nav2(tmp_path / "map.yaml")
    assert kinds_of(level) == [".#?", "..?"]
    assert level.lattice.bounds == pytest.approx((-1, -2, -0.85, -1.9))
    assert level.metadata["nav2"]["origin"] == [-1, -2, 0]
    assert navbake.PathFinder(level).find_path((-0.98, -1.92, 0), (-0.92, -1.98, 0))


def test_unknown_that_a_threshold_makes_free_is_told(tmp_path, caplog):
    """As by the 0.25 that nav2's map saver writes beside its own grey of 205."""
    path = write_map(tmp_path, [[254, 205, 205, 0]], free_thresh=0.25)
    assert kinds_of(navbake.from_nav2(path)) == ["...#"]
    [record] = caplog.records
    assert record.name.startswith("navbake.formats")
    assert record.getMessage() == (
        f"{path}: 2 pixels of grey 205, which map savers write for unknown, are free by "
        "`free_thresh: 0.25`; 0.196 leaves them unknown"
    )
    caplog.clear()
    assert kinds_of(navbake.from_nav2(write_map(tmp_path, [[254, 205, 0]]))) == [".?#"]
    assert kinds_of(navbake.from_nav2(write_map(tmp_path, [[254, 210, 0]], free_thresh=0.25)))
    high = np.full((1, 2), 205 * 257, dtype=">u2")
    path = write_map(tmp_path, [[0]], free_thresh=0.25)
    assert not caplog.records
    (tmp_path / "map.pgm").write_bytes(b"P5\n2 1\n65535\n" + high.tobytes())
    assert kinds_of(navbake.from_nav2(path)) == [".."]
    assert "2 pixels of grey 205" in caplog.text


def test_reads_text_pgm_and_16_bits(tmp_path):
    path = write_map(tmp_path, [[0]])
    (tmp_path / "map.pgm").write_text("P2\n# a comment\n3 1 # another\n15\n0 15 7\n")
    assert kinds_of(navbake.from_nav2(path)) == ["#.?"]
    high = np.array([[0, 65535, 52685]], dtype=">u2")
    (tmp_path / "map.pgm").write_bytes(b"P5\n3 1\n65535\n" + high.tobytes())
    assert kinds_of(navbake.from_nav2(path)) == ["#.?"]
    Image.fromarray(high.astype(np.uint16)).save(tmp_path / "deep.png")
    assert kinds_of(navbake.from_nav2(write_map(tmp_path, [[0]], image="map.bmp"))) == ["#"]
    path.write_text(path.read_text().replace("map.bmp", "deep.png"))
    assert kinds_of(navbake.from_nav2(path)) == ["#.?"]


GREYS = [[0, 89, 90, 127, 205, 206, 254, 255]]


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({}, "##???..."),  # 1 - 89 / 255 > 0.65; 1 - 205 / 255 > 0.196
        ({"free_thresh": 0.25}, "##??...."),
        ({"occupied_thresh": 0.9}, "#????..."),
        ({"negate": 1}, ".???####"),
        ({"negate": True}, ".???####"),
        ({"negate": "yes"}, ".???####"),
        ({"mode": "scale"}, "##x....."),  # 90 is 99 of 100
        ({"mode": "raw"}, "...?????"),  # up to 98 a cost, beyond 100 unknown
    ],
)
def test_modes_thresholds_and_negate(tmp_path, changed, expected):
    assert kinds_of(navbake.from_nav2(write_map(tmp_path, GREYS, **changed))) == [expected]


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_reads_every_pixel_as_nav2_does(data):
    free = data.draw(st.floats(0, 0.9) | st.integers(0, 51).map(lambda k: k / 255))
    most = data.draw(st.floats(min(free + 0.05, 1), 1) | st.just(min(free + 0.2, 1)))
    mode = data.draw(st.sampled_from(["trinary", "scale", "raw"]))
    negate, alpha = data.draw(st.booleans()), data.draw(st.none() | st.integers(0, 255))
    own = {"mode": mode, "negate": negate, "free_thresh": free, "occupied_thresh": most}
    rgb = [data.draw(st.integers(0, 255)) for _ in range(3)]
    opacity = None if alpha is None else np.array([[alpha]], np.uint8)
    luma = np.array([[(306 * rgb[0] + 601 * rgb[1] + 117 * rgb[2]) // 1024]], np.uint8)
    pixels = Pixels(np.array([[sum(rgb)]], np.uint16), 255, opacity, luma)
    stated = MapYaml("", 1, (0, 0, 0), mode, negate, most, free)
    assert int(read_pixel_values(pixels, stated, "main")[0, 0]) == main_value(own, rgb, alpha)
    # sums of floats may round to either side of a threshold, or of a half
    near = [{**own, "free_thresh": free + e, "occupied_thresh": most + e} for e in (-1e-9, 0, 1e-9)]
    read = int(read_pixel_values(pixels, stated)[0, 0])
    assert read in [humble_value(each, rgb, alpha) for each in near]


COLOURS = [
    [0, 0, 0, 255], [254, 254, 254, 255], [254, 254, 254, 0], [0, 0, 0, 0],  # opaque or not
    [255, 90, 0, 255], [0, 200, 0, 255],  # luma 129 and 117
]  # fmt: skip


@pytest.mark.parametrize(
    ("changed", "humble", "main"),
    [
        ({}, "#.?#??", "#.????"),
        ({"occupied_thresh": 0.5}, "#.?#?#", "#.???#"),
        # on both thresholds: black is 1.0, white 0.0
        ({"occupied_thresh": 1.0, "free_thresh": 0.0}, "??????", "#?????"),
        ({"mode": "scale"}, "#.??.#", "#.??.."),
    ],
)
def test_rules_by_version(tmp_path, changed, humble, main):
    path = write_map(tmp_path, [COLOURS], image="map.png", **changed)
    assert kinds_of(navbake.from_nav2(path)) == [humble]
    assert kinds_of(navbake.from_nav2(path, rules="humble")) == [humble]
    assert kinds_of(navbake.from_nav2(path, rules="main")) == [main]


def test_thresholds_are_inclusive_on_main(tmp_path):
    path = write_map(tmp_path, [[0, 1, 254, 255]], occupied_thresh=1.0, free_thresh=0.0)
    assert kinds_of(navbake.from_nav2(path)) == ["????"]
    assert kinds_of(navbake.from_nav2(path, rules="main")) == ["#??."]
    with pytest.raises(FormatError, match="expected humble or main as rules, got 'jazzy'"):
        navbake.from_nav2(path, rules="jazzy")


@pytest.mark.parametrize("yaw", [1.5708, -1.5708, 3.1416, 6.2832])
def test_a_rounded_quarter_turn_is_a_quarter(tmp_path, yaw, caplog):
    level = sample("apartment")
    (_, path) = level.to_nav2(tmp_path / "map.yaml")
    stated = yaml.safe_load(path.read_text())
    levels = []
    for turn in (yaw, round(yaw / (math.pi / 2)) * math.pi / 2):
        stated["origin"][2] = turn
        path.write_text(yaml.safe_dump(stated))
        levels.append(navbake.from_nav2(path))
    assert "is turned" not in caplog.text
    np.testing.assert_array_equal(levels[0].weights, levels[1].weights)
    assert levels[0].lattice == levels[1].lattice
    assert np.count_nonzero(levels[0].free) == np.count_nonzero(level.free)


@pytest.mark.parametrize("yaw", [0.3, -1.2, math.pi / 4, math.pi / 2 + 0.005])
def test_a_turned_cell_is_occupied_from_a_hundredth_on(tmp_path, yaw, caplog):
    level = random_level(5, (17, 23))
    (_, path) = level.to_nav2(tmp_path / "map.yaml")
    stated = yaml.safe_load(path.read_text())
    stated["origin"] = [0.0, 0.0, yaw]
    path.write_text(yaml.safe_dump(stated))
    turned = navbake.from_nav2(path)
    assert f"is turned by {yaw:g} rad: it is laid on cells along the world's axes" in caplog.text
    blocked = np.argwhere(~level.free & ~np.isnan(level.floor))
    squares = [shapely.box(c, level.height - 1 - r, c + 1, level.height - r) for r, c in blocked]
    full = shapely.affinity.rotate(shapely.union_all(squares), yaw, (0, 0), use_radians=True)
    full = shapely.affinity.scale(full, 0.05, 0.05, origin=(0, 0))
    values = compute_occupancy_values(turned, 0)
    for (row, col), value in np.ndenumerate(values):
        x, y = turned.lattice.positions(row, col)
        share = full.intersection(shapely.box(x - 0.025, y - 0.025, x + 0.025, y + 0.025)).area
        if abs(share / 0.05**2 - 0.01) > 1e-6:
            assert (value == 100) == (share > 0.01 * 0.05**2)


@pytest.mark.parametrize("quarters", [-1, 0, 1, 2, 3, 4])
def test_a_map_turned_by_quarters_is_turned_exactly(tmp_path, quarters):
    level = small()
    (_, path) = level.to_nav2(tmp_path / "map.yaml")
    stated = yaml.safe_load(path.read_text())
    stated["origin"] = [7.0, -3.0, quarters * math.pi / 2]
    path.write_text(yaml.safe_dump(stated))
    turned = navbake.from_nav2(path)
    assert turned.shape == (level.shape if quarters % 2 == 0 else level.shape[::-1])
    check_turned(level, turned, stated, exact=True)


@settings(max_examples=25, deadline=None)
@given(CELLS, st.floats(-7, 7) | st.sampled_from([math.atan2(3, 4), math.pi / 4]))
def test_a_map_turned_by_any_angle_keeps_its_centres_and_has_no_gap(tmp_path_factory, values, yaw):
    level = level_from_values(values, lattice_from_corner(values, 0.0, 0.0, 0.1), 0.0, {})
    (_, path) = level.to_nav2(tmp_path_factory.mktemp("turned") / "map.yaml")
    stated = yaml.safe_load(path.read_text())
    stated["origin"] = [7.0, -3.0, yaw]
    path.write_text(yaml.safe_dump(stated))
    check_turned(level, navbake.from_nav2(path), stated, exact=False)


def check_turned(level, turned, stated, exact):
    """Each position has what the map has there, by ROS's own transform; or is occupied, where an
    occupied cell reaches into the cell."""
    x, y, yaw = stated["origin"]
    rng = np.random.default_rng(1)
    x0, y0, x1, y1 = turned.lattice.bounds
    points = rng.uniform((x0, y0), (x1, y1), size=(2000, 2))
    rows, cols = turned.lattice.rows_cols(points)
    values = compute_occupancy_values(turned, 0)[rows, cols]
    if not exact:
        points = turned.lattice.positions(rows, cols)
    along = (points - (x, y)) @ [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    trinary = np.where(
        compute_occupancy_values(level, 0) == 99, 100, compute_occupancy_values(level, 0)
    )

    def map_at(nudge):
        col, up = np.floor(along / stated["resolution"] + nudge).astype(int).T
        inside = (col >= 0) & (col < level.width) & (up >= 0) & (up < level.height)
        there = np.full(len(points), -1)
        there[inside] = trinary[level.height - 1 - up[inside], col[inside]]
        return there

    if exact:
        np.testing.assert_array_equal(values, map_at((0, 0)))
        return
    # which are occupied otherwise: `test_a_turned_cell_is_occupied_from_a_hundredth_on`;
    # a centre may lie on the line between cells, as it does for a turn of 3 : 4; rounding decides
    # then which of them it is in
    sides = [map_at(nudge) for nudge in itertools.product((-1e-9, 1e-9), repeat=2)]
    assert ((values == sides).any(axis=0) | (values == 100)).all()


@pytest.mark.parametrize("world", ["aws_small_house", "turtlebot3_world"])
def test_the_maps_of_real_worlds_come_back_as_they_were(tmp_path, world):
    path = SHARED_DATA / world / "map.yaml"
    if not path.exists():
        pytest.skip("the real maps are not here")
    level = navbake.from_nav2(path)
    level.to_nav2(tmp_path / "map.yaml")
    again = navbake.from_nav2(tmp_path / "map.yaml")
    np.testing.assert_array_equal(again.weights, level.weights)
    np.testing.assert_array_equal(again.floor_height, level.floor_height)
    assert again.lattice == level.lattice
    before, after = (
        np.array(Image.open(p)) for p in (path.with_suffix(".pgm"), tmp_path / "map.pgm")
    )
    np.testing.assert_array_equal(before, after)
    said = [yaml.safe_load(p.read_text()) for p in (path, tmp_path / "map.yaml")]
    assert said[1].items() >= {**said[0], "mode": "trinary"}.items()


# ---------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    ("changed", "culprit"),
    [
        ({"image": None}, "expected the name of an image, got nothing at `image`"),
        ({"image": ""}, "`image`"),
        ({"image": "absent.pgm"}, "isn't there: .*absent.pgm"),
        ({"resolution": 0}, "`resolution`"),
        ({"resolution": -0.05}, "`resolution`"),
        ({"resolution": math.inf}, "`resolution`"),
        ({"resolution": "fine"}, "`resolution`"),
        ({"resolution": None}, "`resolution`"),
        ({"resolution": 1e11}, "`resolution`"),
        ({"origin": [0, 0]}, "three numbers, got a list of 2 at `origin`"),
        ({"origin": [0, 0, math.nan]}, "`origin"),
        ({"origin": [1e11, 0, 0]}, "within 1e\\+10 m"),
        ({"origin": None}, "`origin`"),
        ({"free_thresh": 0.7}, "free_thresh < occupied_thresh <= 1, got 0.7 and 0.65"),
        ({"free_thresh": -0.1}, "0 <= free_thresh"),
        ({"occupied_thresh": 1.1}, "occupied_thresh <= 1"),
        ({"occupied_thresh": None}, "`occupied_thresh`"),
        ({"mode": "binary"}, "trinary or scale or raw, got 'binary'"),
        ({"negate": 0.5}, "`negate`"),
        ({"negate": None}, "`negate`"),
    ],
)  # fmt: skip
def test_a_yaml_that_is_no_map_is_refused_in_a_line(tmp_path, changed, culprit):
    path = write_map(tmp_path, [[0]])
    stated = yaml.safe_load(path.read_text()) | changed
    path.write_text(yaml.safe_dump({k: v for k, v in stated.items() if v is not None}))
    with pytest.raises(FormatError, match=culprit) as caught:
        navbake.from_nav2(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["absent.pgm", "x" * 300, "a\0b", "no/such/folder.pgm"])
def test_an_image_that_is_not_there_is_said_in_a_line(tmp_path, name):
    path = write_map(tmp_path, [[0]])
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | {"image": name}))
    with pytest.raises(FormatError, match="isn't there"):
        navbake.from_nav2(path)


@pytest.mark.parametrize("text", ["", "[]", "a: [", "\xff", "image: &a [*a]"])
def test_what_is_no_yaml_is_refused(tmp_path, text):
    (tmp_path / "map.yaml").write_bytes(text.encode("latin-1"))
    with pytest.raises(FormatError, match=r"map\.yaml"):
        navbake.from_nav2(tmp_path / "map.yaml")
    with pytest.raises(FormatError, match=r"absent\.yaml"):
        navbake.from_nav2(tmp_path / "absent.yaml")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"GIF89a",
        b"P5\n3 2\n255\n\x00",
        b"P5\n999999 999999\n255\n\x00",
        b"P5\n10000 10000\n255\n\x00",  # of which Pillow warns
        b"P5\n-3 2\n255\n\x00\x00\x00\x00\x00\x00",
        b"P2\n2 1\n255\nx y\n",
        b"\x89PNG\r\n\x1a\n\x00\x00",
    ],
)
def test_a_broken_image_is_refused_in_a_line(tmp_path, content):
    path = write_map(tmp_path, [[0]])
    (tmp_path / "map.pgm").write_bytes(content)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        with pytest.raises(FormatError, match=r"map\.pgm") as caught:
            navbake.from_nav2(path)
    assert "\n" not in str(caught.value) and warned == []


@pytest.mark.parametrize("is_first", [True, False])
def test_frames_of_an_animation_that_make_no_sense_are_passed_over_silently(tmp_path, is_first):
    path = write_map(tmp_path, np.full((2, 2), 254), image="map.png")
    content = (tmp_path / "map.png").read_bytes()
    frames = b"acTL" + bytes(8)  # of which there are none
    place = content.index(b"IDAT" if is_first else b"IEND") - 4
    chunk = struct.pack(">I", 8) + frames + struct.pack(">I", zlib.crc32(frames))
    (tmp_path / "map.png").write_bytes(content[:place] + chunk + content[place:])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert kinds_of(navbake.from_nav2(path)) == ["..", ".."]


def test_an_image_that_unpacks_to_too_much_is_refused(tmp_path):
    path = write_map(tmp_path, np.zeros((7000, 7000)), image="map.png")
    assert (tmp_path / "map.png").stat().st_size < 50_000
    with pytest.raises(
        FormatError, match=r"more memory than a file of .* may fill .* in .*map.png"
    ):
        navbake.from_nav2(path)


@pytest.mark.parametrize(
    ("options", "culprit"),
    [
        ({"mode": "grey"}, "trinary or scale or raw as mode, got 'grey'"),
        ({"image": "tif"}, "pgm or png as image, got 'tif'"),
        ({"mode": "scale", "image": "pgm"}, "expected image png"),
        ({"level": 2}, "no level 2: the grid has 2"),
        ({"inflation": 0.5}, "mode trinary has no costs"),
        ({"scaling": 3.0}, "inflation"),
        ({"radius": -1.0}, "as radius, got -1"),
        ({"inflation": 0.1, "mode": "raw", "radius": 0.2}, "at least the radius 0.2 m, got 0.1"),
        ({"inflation": math.nan, "mode": "raw"}, "got nan"),
    ],
)
def test_options_that_make_no_sense_are_refused_before_anything_is_written(
    tmp_path, options, culprit
):
    with pytest.raises((FormatError, QueryError), match=culprit):
        sample("house").to_nav2(tmp_path / "map.yaml", **options)
    with pytest.raises(FormatError, match=r"ends in \.yaml or \.yml"):
        small().to_nav2(tmp_path / "map.txt")
    assert list(tmp_path.iterdir()) == []


def test_a_house_of_levels_without_metadata_is_written(tmp_path):
    grid = house_from([small(), small(ground=3.0)])
    assert len(grid.to_nav2(tmp_path / "map.yaml")) == 4
