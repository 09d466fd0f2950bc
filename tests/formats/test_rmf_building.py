"""Grids as buildings of Open-RMF, and what becomes of those when they are baked again."""

from __future__ import annotations

import logging
import math

import mujoco
import numpy as np
import pytest
import yaml

import navbake
from grid_maps import level_from
from open_rmf import check_lifts, load_as_adapter, load_yaml, make_nav_graph
from project_paths import GOLDEN, ROOT

LAB = ROOT / "tests" / "buildings" / "lab.building.yaml"

pytest.importorskip("shapely", reason="shapely is not installed")


@pytest.fixture(scope="module")
def baked():
    return navbake.bake(LAB)


@pytest.fixture(scope="module")
def written(baked, tmp_path_factory):
    path = tmp_path_factory.mktemp("building") / "lab.building.yaml"
    baked.convert(path)
    return path


@pytest.fixture(scope="module")
def content(written):
    return yaml.safe_load(written.read_text(encoding="utf-8"))


def values_of(edge):
    return {key: value for key, (_, value) in edge[2].items()}


def test_levels_doors_and_lifts_stand_in_the_file(content):
    original = yaml.safe_load(LAB.read_text(encoding="utf-8"))
    assert [level["elevation"] for level in content["levels"].values()] == [0.0, 3.5, 7.0]
    for one, other in zip(content["levels"].values(), original["levels"].values(), strict=True):
        mine, given = ({v["name"]: v for v in map(values_of, x["doors"])} for x in (one, other))
        assert mine.keys() == given.keys()
        for name, door in mine.items():
            assert door["type"] == given[name]["type"], name
            if "sliding" not in door["type"]:
                for key in ("motion_axis", "motion_direction"):
                    assert door[key] == given[name][key], name
    for name, lift in original["lifts"].items():
        mine = content["lifts"][name]
        place = [mine[key] for key in ("x", "y", "yaw", "width", "depth")]
        given = [lift["x"] / 50, -lift["y"] / 50, lift["yaw"], lift["width"], lift["depth"]]
        np.testing.assert_allclose(place, given, atol=1e-4)
        assert len(mine["level_doors"]) == len(lift["level_doors"])


def test_a_building_comes_back(baked, written):
    again = navbake.bake(written)
    assert [door.id for door in again.doors] == [door.id for door in baked.doors]
    assert [link.name for link in again.links] == [link.name for link in baked.links]
    assert [len(link.stops) for link in again.links] == [len(link.stops) for link in baked.links]
    for one, other in zip(again.levels, baked.levels, strict=True):
        x, y = np.meshgrid(other.lattice.center_x(), other.lattice.center_y())
        rows, cols = one.lattice.rows_cols(np.stack([x, y], axis=-1))
        inside = (rows < one.height) & (cols < one.width)
        free = np.zeros(other.shape, dtype=np.bool_)
        free[inside] = one.free[rows[inside], cols[inside]]
        shared = (free & other.free).sum() / (free | other.free).sum()
        assert shared > 0.93  # on another lattice, a wall of a cell takes two
        assert one.room_index.max() == other.room_index.max()


def test_lanes_are_free(baked, content):
    for number, level in enumerate(content["levels"].values()):
        lattice, free = baked.levels[number].lattice, baked.levels[number].free
        for door in baked.doors:  # lanes lead through closed doors
            for state in door.states:
                free = free | np.isin(
                    np.arange(free.size), door.cells_in(state, len(baked.levels))[number]
                ).reshape(free.shape)
        assert level["lanes"]
        for one, other, _ in level["lanes"]:
            if any(" car " in level["vertices"][end][3] for end in (one, other)):
                continue  # the car of a lift is on one level at a time
            a, b = (np.array(level["vertices"][end][:2]) for end in (one, other))
            steps = np.linspace(a, b, 2 + math.ceil(np.hypot(*(b - a)) / 0.02))
            assert free[lattice.rows_cols(steps)].all(), (number, a, b)


SIDE_BY_SIDE = """
building_name: pair
coordinate_system: cartesian_meters
levels:
  L1: &level
    elevation: 0
    vertices: [[0, 0, 0, ""], [7, 0, 0, ""], [7, 6, 0, ""], [0, 6, 0, ""]]
    floors: [{vertices: [0, 1, 2, 3], parameters: {}}]
    walls: [[0, 1, {}], [1, 2, {}], [2, 3, {}], [3, 0, {}]]
  L2: {elevation: 3, vertices: [[0, 0, 0, ""], [7, 0, 0, ""], [7, 6, 0, ""], [0, 6, 0, ""]],
       floors: [{vertices: [0, 1, 2, 3], parameters: {}}],
       walls: [[0, 1, {}], [1, 2, {}], [2, 3, {}], [3, 0, {}]]}
lifts:
  west: {x: 2.4, y: 4.9, yaw: 0, width: 1.6, depth: 1.8, initial_floor_name: L1,
         doors: {d: {door_type: 2, x: 0, y: -0.9, motion_axis_orientation: 0, width: 1.0}},
         level_doors: {L1: [d], L2: [d]}}
  east: {x: 4.2, y: 4.9, yaw: 0, width: 1.6, depth: 1.8, initial_floor_name: L2,
         doors: {d: {door_type: 2, x: 0, y: -0.9, motion_axis_orientation: 0, width: 1.0}},
         level_doors: {L1: [d], L2: [d]}}
"""


def test_open_rmf_takes_a_building_with_two_lifts_side_by_side(tmp_path):
    (tmp_path / "pair.building.yaml").write_text(SIDE_BY_SIDE.replace("&level", ""))
    grid = navbake.bake(tmp_path / "pair.building.yaml")
    grid.routes().save(tmp_path / "pair.yaml")
    grid.convert(tmp_path / "again.building.yaml")
    served = {"west": {*grid.level_names}, "east": {*grid.level_names}}
    check_lifts(*load_as_adapter(load_yaml(tmp_path / "pair.yaml")), served)
    nav_graph = make_nav_graph(load_yaml(tmp_path / "again.building.yaml"))
    check_lifts(*load_as_adapter(nav_graph), served)


@pytest.mark.parametrize("name", ["tower", "lab"])
def test_open_rmf_takes_the_lifts_of_exported_buildings(tmp_path, baked, name):
    grid = baked if name == "lab" else navbake.load(GOLDEN / "tower.grid.json.gz")
    grid.convert(tmp_path / "a.building.yaml")
    building = load_yaml(tmp_path / "a.building.yaml")
    served = {name: {*lift["level_doors"]} for name, lift in building["lifts"].items()}
    assert len(served) == 2 and all(len(levels) >= 2 for levels in served.values())
    check_lifts(*load_as_adapter(make_nav_graph(building)), served)


def test_what_is_lost_is_said(tmp_path, caplog):
    grid = navbake.load(GOLDEN / "house.grid.json.gz")
    with caplog.at_level(logging.WARNING):
        grid.convert(tmp_path / "house.building.yaml")
    assert "no place for steps between levels" in caplog.text
    content = yaml.safe_load((tmp_path / "house.building.yaml").read_text(encoding="utf-8"))
    assert len(content["levels"]) == 2
    assert content["lifts"] == {}
    assert all(level["walls"] and level["floors"] for level in content["levels"].values())


def test_a_level_is_laid_flat_at_most_of_its_floor(tmp_path):
    grid = navbake.load(GOLDEN / "tower.grid.json.gz")  # its lobby lies 0.9 m over the yard
    grid.convert(tmp_path / "tower.building.yaml")
    content = yaml.safe_load((tmp_path / "tower.building.yaml").read_text(encoding="utf-8"))
    first = next(iter(content["levels"].values()))
    shapely = pytest.importorskip("shapely")
    floor = floor_of(first)
    assert floor.contains(shapely.Point(0.0, -0.5))
    assert floor.contains(shapely.Point(7.0, -3.0))


STOREYS_BESIDE_A_SHAFT = """<mujoco><worldbody>
  <geom type="box" pos="2.5 2 -.1" size="2.5 2 .1"/>
  <geom type="box" pos="2.5 2 2.9" size="2.5 2 .1"/>
  <geom name="west" type="box" pos="-.05 2 3" size=".05 2 3"/>
  <geom name="east" type="box" pos="5.05 2 3" size=".05 2 3"/>
  <geom name="south" type="box" pos="2.5 -.05 3" size="2.5 .05 3"/>
  <geom name="north" type="box" pos="2.5 4.05 3" size="2.5 .05 3"/>
  <body name="car" pos="{x} {y} 0"><joint name="j" type="slide" axis="0 0 1" range="0 3"/>
    <geom type="box" size=".65 .7 .05" pos="0 0 -.05"/></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("side", "x", "y"),
    [("west", -0.7, 2.0), ("east", 5.7, 2.0), ("south", 2.5, -0.75), ("north", 2.5, 4.75)],
)
@pytest.mark.parametrize("height", [0.0, 1.5, 3.0])
def test_a_lift_beside_a_level_starts_where_its_car_stands(tmp_path, side, x, y, height):
    lines = STOREYS_BESIDE_A_SHAFT.format(x=x, y=y).splitlines()
    # the wall between the storeys and the shaft is left out
    scene = "\n".join(line for line in lines if f'name="{side}"' not in line)
    grid = navbake.bake(
        mujoco.MjModel.from_xml_string(scene),
        scene={"joints": {"j": height}},
        links=[{"auto": "lift"}],
    )
    # the shaft lies beyond the edge of the levels without the car
    level = grid.levels[1 if height == 0.0 else 0]
    assert not level.lattice.holds(*level.lattice.rows_cols((x, y)))
    grid.convert(tmp_path / "a.building.yaml")
    lift = load_yaml(tmp_path / "a.building.yaml")["lifts"]["car"]
    level_names = list(load_yaml(tmp_path / "a.building.yaml")["levels"])
    assert lift["initial_floor_name"] == level_names[1 if height == 3.0 else 0]


def floor_of(level):
    """The floor of a level of a building, as a polygon of shapely."""
    shapely = pytest.importorskip("shapely")
    outlines, holes = (
        [
            shapely.Polygon([level["vertices"][v][:2] for v in part["vertices"]])
            for part in level[key]
        ]
        for key in ("floors", "holes")
    )
    return shapely.union_all(outlines).difference(shapely.union_all(holes))


def test_floor_far_from_its_level_is_left_out_with_its_lanes_and_told(tmp_path, caplog):
    shapely = pytest.importorskip("shapely")
    grid = navbake.load(GOLDEN / "warehouse.grid.json.gz")  # a dock lies 1.2 m over the yard
    with caplog.at_level(logging.WARNING):
        grid.convert(tmp_path / "a.building.yaml")
    content = load_yaml(tmp_path / "a.building.yaml")
    left_out_area = 0.0
    largest_shift = 0.0
    num_lanes = 0
    for level, building_level in zip(grid.levels, content["levels"].values(), strict=True):
        shifts = np.abs(level.floor[level.free] - building_level["elevation"])
        left_out_area += np.count_nonzero(shifts > 1.0) * level.cell_size**2
        largest_shift = max(largest_shift, shifts[shifts <= 1.0].max())
        floor = floor_of(building_level).buffer(0.01)
        vertices = building_level["vertices"]
        num_lanes += len(building_level["lanes"])
        for start, end, _ in building_level["lanes"]:
            line = shapely.LineString([vertices[start][:2], vertices[end][:2]])
            assert floor.contains(line)
        # a name stands for a node, and each of them is an end of a lane
        ends = {end for lane in building_level["lanes"] for end in lane[:2]}
        assert all(k in ends for k, vertex in enumerate(vertices) if vertex[3])
    assert left_out_area > 30.0
    left_out_lanes = [lane for lane in grid.routes().lanes if lane.kind == "floor"]
    num_left_out = len(left_out_lanes) - num_lanes
    assert num_left_out > 20
    assert f"{left_out_area:.2f} m² of free floor more than 1 m above or below" in caplog.text
    assert f"{num_left_out} lanes over such floor" in caplog.text
    assert f"up to {largest_shift:.2f} m higher or lower than it is" in caplog.text


def test_nothing_is_told_of_level_floors(tmp_path, caplog):
    grid = level_from("\n".join(["." * 30] * 30))
    with caplog.at_level(logging.WARNING):
        grid.convert(tmp_path / "a.building.yaml")
    assert caplog.text == ""
