"""Areas take the cells that they say, by rooms, polygons, boxes and geoms."""

from __future__ import annotations

import warnings

import mujoco
import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

import navbake
from box_worlds import box, world
from navbake.errors import BakeWarning, ConfigError
from navbake.navgrid.lattice import Lattice, cover_cells, touch_cells

FLOOR = box("floor", 0, 0, -0.1, 6, 4, 0)
LATTICE = Lattice(-1.0, 2.0, 0.1, 37, 29)


def bake(*areas, content="", **settings):
    model = mujoco.MjModel.from_xml_string(world(FLOOR + content))
    agents = {"robot": {"speed": 0.5}}
    return navbake.bake(model, areas=list(areas), agents=agents, **settings)


def squares(lattice, slack=1e-7):
    """The cells' open squares, as polygons."""
    x, y = np.meshgrid(lattice.center_x(), lattice.center_y())
    half = lattice.cell_size / 2 - slack
    return shapely.box(x - half, y - half, x + half, y + half)


@given(st.integers(0, 2**32 - 1))
def test_touched_cells_are_those_that_shapely_says(seed):
    rng = np.random.default_rng(seed)
    kind, count = seed % 3, int(rng.integers(3, 8))
    if kind == 0:
        angle = np.sort(rng.uniform(0, 2 * np.pi, count))
        away = rng.uniform(0.05, 1.5, (count, 1)) * np.stack([np.cos(angle), np.sin(angle)], 1)
        ring = rng.uniform([-1, -1], [2.7, 2]) + away
    elif kind == 1:  # a thin wall
        start, way = rng.uniform([-1, -1], [2.7, 2]), rng.normal(size=2)
        way /= np.linalg.norm(way)
        side, end = np.array([-way[1], way[0]]) * 0.02, start + way * rng.uniform(0.1, 3)
        ring = np.array([start - side, start + side, end + side, end - side])
    else:  # along cells' edges
        x, y = (np.sort(rng.choice(n, 2, replace=False)) * 0.1 - 1 for n in (38, 30))
        ring = np.array([(x[0], y[0] + 0.1), (x[1], y[0] + 0.1), (x[1], y[1] + 0.1)])
    polygon = shapely.Polygon(ring)
    if polygon.is_valid and polygon.area > 1e-9:
        expected = shapely.intersects(polygon, squares(LATTICE))
        assert np.array_equal(touch_cells([ring], LATTICE), expected)


def test_a_slanted_thin_keep_out_zone_has_no_gaps():
    wall = [(1.0, 1.0), (5.0, 2.6), (4.985, 2.637), (0.985, 1.037)]  # 4 cm thick
    with pytest.warns(BakeWarning, match="area 'no' is only 0.0399 m wide, thinner than"):
        grid = bake({"name": "no", "polygon": wall, "cost": float("inf")})
    marked = grid.levels[0].area_index == 1
    assert np.array_equal(marked, shapely.intersects(shapely.Polygon(wall), squares(grid.lattice)))
    assert marked.any(axis=0).sum() == 41  # no column is left out
    with pytest.warns(BakeWarning, match="by their centres, so it has gaps"):
        slow = bake({"name": "slow", "polygon": wall, "cost": 2})
    assert 0 < (slow.levels[0].area_index == 1).any(axis=0).sum() < 40


def test_other_areas_take_cells_by_their_centres_and_later_ones_win():
    one, two = [(1, 1), (3.04, 1), (3.04, 3), (1, 3)], [(2, 2), (4, 2), (4, 3.5), (2, 3.5)]
    grid = bake(
        {"name": "carpet", "polygon": one, "cost": 2, "speed": 0.5},
        {"name": "lab", "polygon": two, "agents": ["robot"]},
    )
    index = np.zeros(grid.shape, dtype=np.uint8)
    index[cover_cells([one], grid.lattice)] = 1
    index[touch_cells([two], grid.lattice)] = 2
    assert np.array_equal(grid.area_index, index) and grid.area_index.dtype == np.uint8
    assert [area.to_json() for area in grid.areas] == [
        {"name": "carpet", "cost": 2.0, "speed": 0.5},
        {"name": "lab", "cost": 1.0, "agents": ["robot"]},
    ]


def test_a_box_takes_the_floors_in_it():
    content = box("podium", 3.01, 0.01, 0, 5.99, 3.99, 0.2)
    corners = [[2, 1, 0.1], [5, 2, 1]]
    marked = bake({"name": "up", "box": corners, "cost": 3}, content=content).area_index == 1
    grid = bake(content=content)
    x, y = np.meshgrid(grid.lattice.center_x(), grid.lattice.center_y())
    assert np.array_equal(marked, (x > 3) & (x < 5) & (y > 1) & (y < 2))


@pytest.mark.parametrize("cost", [2.0, float("inf")])
def test_geoms_mark_what_they_stand_on(cost):
    turned = 'contype="0" conaffinity="0" euler="0 0 30" type="box"'
    content = f'<geom name="zone_1" {turned} pos="2 2 0.5" size="0.8 0.33 0.5"/>'
    content += '<geom name="zone_2" contype="0" conaffinity="0" type="cylinder" pos="4 2 1"'
    content += ' size="0.52 1.2"/><geom name="zone_high" contype="0" conaffinity="0" type="box"'
    content += ' pos="5 3.5 3" size="0.5 0.4 0.1"/>'
    area = {"name": "zone", "geoms": ["zone_*"], "cost": cost}
    content = f"<frame>{content}</frame>"
    grid = bake(area, content=content, scene={"exclude": {"geoms": ["zone_*"]}})
    angle = np.radians(30)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    ring = np.array([(-0.8, -0.33), (0.8, -0.33), (0.8, 0.33), (-0.8, 0.33)]) @ turn + 2
    shape = shapely.union(shapely.Polygon(ring), shapely.Point(4, 2).buffer(0.52, 4096))
    x, y = np.meshgrid(grid.lattice.center_x(), grid.lattice.center_y())
    asked = squares(grid.lattice, 2e-6) if cost > 2 else shapely.points(x, y)
    assert np.array_equal(grid.area_index == 1, shapely.intersects(shape, asked))


def test_a_room_gives_its_cells_by_name_or_id():
    content = '<site name="room_a" type="box" pos="1.5 2 1" size="1.49 1.9 0.99"/>'
    grid = bake({"name": "a", "room": "room_a", "cost": 5}, content=content)
    (room,) = (room for room in grid.rooms if room.name == "room_a")
    assert np.array_equal(grid.area_index == 1, grid.room_index == room.index)


def test_what_has_no_place_is_named():
    room = {"name": "hall", "points": [(0, 0), (3, 0), (3, 4), (0, 4)]}
    with pytest.warns(BakeWarning, match=r"no room 'hal' for area 'a': .*hall"):
        bake({"name": "a", "room": "hal", "cost": 2}, rooms={"polygons": [room]})
    with pytest.warns(BakeWarning, match="area 'b' covers no cell with a floor"):
        bake({"name": "b", "polygon": [(8, 8), (9, 8), (9, 9)], "cost": 2})
    with pytest.warns(BakeWarning, match="of area 'c', `geoms` pattern 'flor' matches nothing"):
        bake({"name": "c", "geoms": "flor", "cost": 2})
    with pytest.raises(ConfigError, match="no level 'attic' for area 'd': there are 0"):
        bake({"name": "d", "polygon": [(1, 1), (2, 1), (2, 2)], "level": "attic"})


def test_no_warning_where_all_is_well():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bake({"name": "a", "polygon": [(1, 1), (2, 1), (2, 2), (1, 2)], "cost": 2})
