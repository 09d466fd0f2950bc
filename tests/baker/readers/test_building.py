"""Buildings of Open-RMF as scenes: levels on images, in metres, turned; doors and lifts."""

from __future__ import annotations

import copy
import math
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import yaml

import navbake
from navbake.baker.readers.building import make_slab, read_building
from navbake.baker.scene.model import CompileLimits
from navbake.config.settings import SceneSettings
from navbake.errors import SceneError
from project_paths import ROOT
from scenes_alone import load_alone

LAB = ROOT / "tests" / "buildings" / "lab.building.yaml"
DOORS = {
    0: ["front_right", "front_left", "store", "office_right", "office_left", "inner"],
    1: ["lab_1", "lab_2"],
    2: ["server_1", "server_2"],
}
PIXEL = 1 / 50  # of L1 [m]

pytest.importorskip("shapely", reason="shapely is not installed")


@pytest.fixture(scope="module")
def lab():
    return yaml.safe_load(LAB.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def baked():
    return navbake.bake(LAB)


@pytest.fixture
def write(tmp_path):
    """Returns a function that writes a building; its path."""

    def call(content) -> Path:
        path = tmp_path / "lab.building.yaml"
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        return path

    return call


def to_metres(lab):
    """The same building in metres, y up, without fiducials."""
    lab, to_world = copy.deepcopy(lab), {
        "L1": lambda x, y: (x * PIXEL, -y * PIXEL),
        "L2": lambda x, y: ((x - 100) * PIXEL, -(y - 50) * PIXEL),
        "L3": lambda x, y: ((400 - y) * 2 * PIXEL, -x * 2 * PIXEL),
    }  # fmt: skip
    lab["coordinate_system"] = "cartesian_meters"
    for name, level in lab["levels"].items():
        level["vertices"] = [[*to_world[name](x, y), 0, n] for x, y, _, n in level["vertices"]]
        del level["fiducials"]
        level.pop("measurements", None)
    for lift in lab["lifts"].values():
        lift["x"], lift["y"] = lift["x"] * PIXEL, -lift["y"] * PIXEL
    return lab


def test_levels_doors_and_lifts_are_found(baked):
    assert baked.scene_id == "lab"
    assert baked.warnings == ()  # no step leads upstairs, but lifts do
    assert [level.ground for level in baked.levels] == [0.0, 3.5, 7.0]
    for number, names in DOORS.items():
        assert [door.id for door in baked.doors if number in door.levels] == names
    stops = {link.name: [stop.level for stop in link.stops] for link in baked.links}
    assert stops == {"A": [0, 1, 2], "B": [0, 1]}
    assert {link.kind for link in baked.links} == {"lift"}
    for level in baked.levels:  # 16 m by 10 m, all images over each other
        assert (level.width, level.height) == (161, 101)
        assert level.free.sum() * 0.01 == pytest.approx(150, abs=3)


def test_a_lift_leads_upstairs(baked):
    finder = navbake.PathFinder(baked)
    path = finder.find_path((3, -3, 0), (3, -3, 7))
    assert path is not None
    assert path.links == ["A"]
    closed = navbake.PathFinder(baked.with_links({"A": "closed"}))
    assert closed.find_path((3, -3, 0), (3, -3, 7)) is None
    assert "'A'" in closed.why_not((3, -3, 0), (3, -3, 7))
    assert closed.find_path((3, -3, 0), (3, -3, 3.5)).links == ["B"]


def test_an_open_door_lets_through(baked):
    at, beyond = (3.5, -5, 0), (3.5, -7, 0)
    assert navbake.PathFinder(baked).find_path(at, beyond) is None
    opened = baked.with_doors({"store": "open"})
    assert navbake.PathFinder(opened).find_path(at, beyond).doors == ["store"]


@pytest.mark.parametrize(
    ("kind", "direction", "axis", "side"),
    [
        # the hinge in the west or east; the leaf swings to the south (-1) or the north
        ("hinged", 1, "start", -1), ("hinged", -1, "start", 1),
        ("hinged", 1, "end", 1), ("double_hinged", 1, "start", -1),
        ("double_hinged", -1, "start", 1),
    ],
)  # fmt: skip
def test_doors_swing_as_the_editor_draws_them(lab, write, kind, direction, axis, side):
    lab = copy.deepcopy(lab)
    door = lab["levels"]["L1"]["doors"][1][2]
    door |= {"type": [1, kind], "motion_direction": [2, direction], "motion_axis": [1, axis]}
    grid = navbake.bake(write(lab), doors={"state": "open"})
    ids = [door.id for door in grid.doors if door.id.startswith("store")]
    assert len(ids) == (2 if kind == "double_hinged" else 1)
    level = grid.levels[0]
    blocked = ~level.free
    x, y = level.lattice.center_x(), level.lattice.center_y()
    near = blocked & (abs(x - 3.5) < 0.6)[None, :] & (abs(y + 6 - side * 0.3) < 0.15)[:, None]
    other = blocked & (abs(x - 3.5) < 0.6)[None, :] & (abs(y + 6 + side * 0.3) < 0.15)[:, None]
    assert near.any()
    assert not other.any()
    column = np.nonzero(near)[1].min()
    if kind == "hinged":
        assert x[column] == pytest.approx(3.0 if axis == "start" else 4.0, abs=0.2)


def test_metres_and_pixels_give_the_same_grid(lab, write, baked):
    grid = navbake.bake(write(to_metres(lab)))
    for one, other in zip(grid.levels, baked.levels, strict=True):
        np.testing.assert_array_equal(one.free, other.free)
        np.testing.assert_array_equal(one.room_index, other.room_index)
    assert [link.name for link in grid.links] == ["A", "B"]


def test_a_hole_and_the_shafts_have_no_floor(baked):
    for x, y, z, has_floor in [
        (0.8, -8.2, 3.5, False), (0.8, -8.2, 0.0, True),  # the light well of L2
        (14.6, -1.2, 0.0, True), (14.6, -1.2, 3.5, False), (14.6, -1.2, 7.0, False),  # A's car
        (12.0, -1.2, 3.5, True), (12.0, -1.2, 0.0, False), (12.0, -1.2, 7.0, True),
    ]:  # fmt: skip
        level = baked.levels[round(z / 3.5)]
        rows, cols = level.lattice.rows_cols(np.array([[x, y]]))
        assert np.isfinite(level.floor[rows, cols]).all() == has_floor, (x, y, z)


def test_fiducials_lay_levels_over_each_other_in_any_pose(lab, write, baked):
    lab = copy.deepcopy(lab)
    level, turn = lab["levels"]["L2"], 0.3

    def move(x, y):
        c, s = math.cos(turn) * 1.7, math.sin(turn) * 1.7
        return [x * c - y * s + 31.0, x * s + y * c - 12.0]

    level["vertices"] = [[*move(x, y), 0, name] for x, y, _, name in level["vertices"]]
    level["fiducials"] = [[*move(x, y), name] for x, y, name in level["fiducials"]]
    grid = navbake.bake(write(lab))
    differ = [(a.free != b.free).sum() for a, b in zip(grid.levels, baked.levels, strict=True)]
    assert max(differ) <= 5  # by rounding, of cells on edges


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda lab: lab["levels"]["L1"].pop("measurements"), "level 'L1' .* has no measurement"),
        (lambda lab: lab.update(coordinate_system="web_mercator"), "web_mercator: expected ref"),
        (
            lambda lab: lab.update(coordinate_system="wgs84"),
            "expected the parameter `generate_crs`",
        ),
        (lambda lab: lab["levels"]["L1"]["walls"].append([0, 99, {}]), "index 99"),
        (
            lambda lab: [
                lab["levels"][level]["fiducials"].append([k, 2 * k, f"f{k}"])
                for level in ("L1", "L2")
                for k in range(501)
            ],
            "fiducials with 'L1', expected 500 at most",
        ),
        (lambda lab: lab.pop("levels"), "expected `levels`"),
        (lambda lab: lab["lifts"]["A"].update(initial_floor_name="L9"), "lift 'A' .*KeyError 'L9'"),
        (
            lambda lab: lab["levels"]["L1"]["walls"].append([0, 0, {}, []]),
            None,  # a pillar
        ),
        (
            lambda lab: lab["levels"]["L1"]["doors"][1].__setitem__(1, 5),
            "door 'store' .* vertices coincide",
        ),
        (
            lambda lab: lab["levels"]["L1"]["measurements"].append([0, 0, {"distance": [3, 2]}]),
            "cannot read .*: FloatingPointError",
        ),
        (
            lambda lab: lab["levels"]["L1"]["floors"].append({"vertices": [0, "x", 2]}),
            "cannot read .*lab.building.yaml: ValueError",
        ),
    ],
)
def test_what_is_wrong_is_named(lab, write, change, named):
    lab = copy.deepcopy(lab)
    change(lab)
    expectation = nullcontext() if named is None else pytest.raises(SceneError, match=named)
    with expectation:
        load_alone(SceneSettings(path=write(lab)))


@pytest.mark.parametrize(
    ("change", "warned"),
    [
        *(
            (
                lambda lab, corners=corners: lab["levels"]["L1"]["floors"].append(
                    {"vertices": corners}
                ),
                "L1/floor_2 .* no area",
            )
            for corners in ([0, 0, 0], [0, 1, 0])
        ),
        (lambda lab: lab["levels"]["L2"].update(fiducials=[]), "shares 0 fiducials"),
        (lambda lab: lab["levels"]["L1"]["doors"][1][2].update(type=[1, "iris"]), "'iris'"),
        (
            lambda lab: lab["lifts"]["B"].update(level_doors={"L1": ["door1"]}),
            "lift 'B' .* 1 level",
        ),
    ],
)
def test_what_is_left_out_is_warned_of(lab, write, change, warned):
    lab = copy.deepcopy(lab)
    change(lab)
    with pytest.warns(navbake.BakeWarning, match=warned):
        navbake.bake(write(lab))


def test_a_slab_is_closed_and_faces_outward():
    outline = np.array([[0, 0], [4, 0], [4, 3], [0, 3]], dtype=float)
    hole = np.array([[1, 1], [2, 1], [2, 2], [1, 2]], dtype=float)
    mesh = make_slab(outline, [hole], 1.0)
    import trimesh  # slow to load

    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert solid.is_watertight
    assert solid.volume == pytest.approx((12 - 1) * 0.1)


def test_isolated():
    settings = SceneSettings(path=LAB)
    assert load_alone(settings, limits=CompileLimits()).digest == load_alone(settings).digest


NARROW = {
    "coordinate_system": "cartesian_meters",
    "levels": {
        "L1": {
            "elevation": 0,
            # a hall, and a WC of 1.0 x 1.8 m in its corner behind a door as wide as itself
            "vertices": [
                [0, 0, 0, ""], [6, 0, 0, ""], [6, 5, 0, ""], [0, 5, 0, ""],
                [1.1, 0, 0, ""], [1.1, 1.9, 0, ""], [0, 1.9, 0, ""],
                [3, 3, 0, ""], [4, 3, 0, ""],
            ],
            "floors": [{"vertices": [0, 1, 2, 3]}],
            "walls": [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5]],
            "doors": [
                [5, 6, {"name": [1, "wc"], "type": [1, "hinged"]}],
                [7, 8, {"name": [1, "screen"], "type": [1, "sliding"]}],
            ],
        }
    },
}  # fmt: skip


@pytest.mark.parametrize("find", [True, False])
def test_what_the_file_calls_a_door_is_one(write, find):
    """Also in the middle of a hall, where nothing but the file says so."""
    path = write(NARROW)
    grid = navbake.bake(path, doors={"find": find})
    assert [door.id for door in grid.doors] == ["wc", "screen"]
    wc, screen = grid.doors
    assert set(wc.rooms) == {"0:1", "0:2"}
    assert screen.rooms == (None, None)
    ends = (0.5, 0.9, 0), (0.5, 4, 0)
    assert navbake.PathFinder(grid).find_path(*ends) is None
    opened = navbake.bake(path, doors={"find": find, "state": "open"})
    assert navbake.PathFinder(opened).find_path(*ends) is not None


def test_doors_of_a_file_are_named_in_a_process_of_its_own(write):
    settings = SceneSettings(path=write(NARROW))
    names = load_alone(settings, limits=CompileLimits()).named_leaves
    assert names == load_alone(settings).named_leaves == {"wc", "screen"}


@pytest.mark.parametrize("crs", ["EPSG:32632", "EPSG:3414"])  # easting first, northing first
@pytest.mark.parametrize("with_offset", [True, False])
def test_a_building_in_wgs84_is_projected_as_the_editors_tools_do_it(tmp_path, crs, with_offset):
    """In rmf_building_map_tools: wgs84_transform.py; building.py, parse_yaml: the parameters."""
    pyproj = pytest.importorskip("pyproj")
    corners = np.array([(0, 0), (6, 0), (6, 4), (0, 4)], dtype=float)
    offset = np.array([500_123.0, 5_300_456.0] if crs == "EPSG:32632" else [28_001.5, 38_002.25])
    to_degrees = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    shifted = corners + np.array([0.5, 0.25]) + offset
    degrees = np.stack(to_degrees.transform(*shifted.T), axis=1).tolist()
    middle = np.array([3.5, 2.25])
    car = [float(v) for v in to_degrees.transform(*(offset + middle))]
    level = {
        "vertices": [[*point, 0, ""] for point in degrees],
        "floors": [{"vertices": [0, 1, 2, 3], "parameters": {}}],
        "walls": [[0, 1, {}], [1, 2, {}], [2, 3, {}], [3, 0, {}]],
    }
    lift = {"x": car[0], "y": car[1], "yaw": 0, "width": 1.5, "depth": 1.5,
            "level_doors": {"L1": ["d"], "L2": ["d"]}, "doors": {}}  # fmt: skip
    parameters = {"generate_crs": [1, crs]}
    if with_offset:
        parameters |= {"suggested_offset_x": [3, float(offset[0])],
                       "suggested_offset_y": [3, float(offset[1])]}  # fmt: skip
    content = {
        "building_name": "geo", "coordinate_system": "wgs84", "parameters": parameters,
        "levels": {"L1": {"elevation": 0, **level}, "L2": {"elevation": 3, **level}},
        "lifts": {"A": lift},
    }  # fmt: skip
    path = tmp_path / "geo.building.yaml"
    path.write_text(yaml.safe_dump(content))
    parsed = read_building(path, SceneSettings(path=str(path)))
    origin = offset if with_offset else np.floor(shifted.min(axis=0) / 1000) * 1000
    wall = next(geom for geom in parsed.geoms if geom.name == "L1/wall_1")
    np.testing.assert_allclose(wall.pose[:2, 3], offset + middle - (0, 2) - origin, atol=1e-6)
    assert wall.size[0] == pytest.approx(3.05, abs=1e-6)
    body = parsed.bodies["A"]
    np.testing.assert_allclose(body.pose[:2, 3], offset + middle - origin, atol=1e-6)
    assert len(parsed.warnings) == (not with_offset)
    for wrong in ("EPSG:4326", "nonsense", "EPSG:2272"):  # degrees, nothing, feet
        content["parameters"]["generate_crs"] = [1, wrong]
        path.write_text(yaml.safe_dump(content))
        with pytest.raises(SceneError, match="expected a projection in metres as `generate_crs`"):
            read_building(path, SceneSettings(path=str(path)))
