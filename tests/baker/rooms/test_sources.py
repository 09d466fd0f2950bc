"""Rooms that someone marked in the scene or in the settings."""

from __future__ import annotations

import numpy as np
import pytest

from navbake.baker.bake.pipeline import run_bake
from navbake.config.settings import parse_config
from navbake.errors import ConfigError

# two slabs, 4 x 4 m each, side by side
SLABS = """
<geom name="floor|west" type="box" pos="-2 0 -.1" size="2 2 .1"/>
<geom name="floor|east" type="box" pos="2 0 -.1" size="2 2 .1"/>
"""
SQUARE = [[-2, -2], [0, -2], [0, 0], [-2, 0]]


def bake(tmp_path, body, asset="", **settings):
    path = tmp_path / "scene.xml"
    path.write_text(
        f"<mujoco><asset>{asset}</asset><worldbody>{body}</worldbody></mujoco>", encoding="utf-8"
    )
    config = {"scene": {"path": path}, "grid": {"cell_size": 0.25}, **settings}
    return run_bake(parse_config(config))


def rooms_of(result, level=0):
    """Names of the rooms by index, and the cells of each as (x, y)."""
    grid = result.grid.levels[level]
    x, y = np.meshgrid(grid.lattice.center_x(), grid.lattice.center_y())
    table = [room for room in result.grid.rooms if room.level == level]
    assert sorted(np.unique(grid.room_index[grid.room_index > 0])) == [r.index for r in table]
    return {
        room.name: (x[grid.room_index == room.index], y[grid.room_index == room.index])
        for room in table
    }


def span(cells):
    x, y = cells
    return [float(v) for v in (x.min() - 0.125, y.min() - 0.125, x.max() + 0.125, y.max() + 0.125)]


# ---------------------------------------------------------------- what they leave


SITE = '<site name="room_desk" type="box" pos="-2 0 1" size=".5 .5 1"/>'


def test_a_room_is_as_large_as_its_site(tmp_path):
    """A site of 1 m² in a room of 16 m², which keeps the rest."""
    wall = '<geom type="box" pos="0 0 1" size=".05 2 1"/>'
    result = bake(tmp_path, SLABS.replace("floor|", "slab ") + wall + SITE)
    table = [(room.name, room.source, round(room.area, 2)) for room in result.grid.rooms]
    assert sorted(table, key=lambda room: room[2])[0] == ("room_desk", "sites", 1.0)
    rest = [area for name, source, area in table if (name, source) == (None, "auto")]
    assert rest == pytest.approx([14.0, 15.0], abs=0.6)  # less the cells of the wall
    assert span(rooms_of(result)["room_desk"]) == [-2.5, -0.5, -1.5, 0.5]


def test_a_mark_that_covers_most_of_a_room_ends_where_it_ends(tmp_path):
    points = [[-4, -2], [-1, -2], [-1, 2], [-4, 2]]
    given = {"from": ["polygons", "auto"], "polygons": [{"name": "most", "points": points}]}
    wall = '<geom type="box" pos="0 0 1" size=".05 2 1"/>'
    result = bake(tmp_path, SLABS + wall, rooms=given)
    assert span(rooms_of(result)["most"]) == [-4, -2, -1, 2]
    areas = sorted(round(room.area, 1) for room in result.grid.rooms)
    assert len(areas) == 3 and areas[0] == pytest.approx(3.5, abs=0.6) and areas[1] == 12.0


# ---------------------------------------------------------------- geoms


def test_floor_geoms(tmp_path):
    rooms = rooms_of(bake(tmp_path, SLABS))
    assert span(rooms["west"]) == [-4, -2, 0, 2]
    assert span(rooms["east"]) == [0, -2, 4, 2]


def test_rugs_and_furniture_change_nothing(tmp_path):
    things = """
    <geom name="rug" type="box" pos="0 0 .01" size="1 1 .01"/>
    <geom name="mat" type="box" pos="-3 1 .025" size=".5 .5 .024"/>
    <geom name="table" type="box" pos="2 0 .7" size=".5 .5 .02"/>
    <geom name="cupboard" type="box" pos="3.5 1.5 .5" size=".5 .5 .5"/>
    """
    bare, full = bake(tmp_path, SLABS), bake(tmp_path, SLABS + things)
    np.testing.assert_array_equal(full.grid.levels[0].room_index, bare.grid.levels[0].room_index)


def test_furniture_named_like_a_room_is_none(tmp_path):
    """A dome whose rim alone is at the height of the floor."""
    dome = '<geom name="room_0_dome" type="ellipsoid" size="1.5 1.5 1.2" pos="-2 0 -1.19"/>'
    assert set(rooms_of(bake(tmp_path, SLABS + dome))) == {"west", "east"}


def test_a_podium_over_most_of_a_room_leaves_the_room(tmp_path):
    podium = '<geom name="podium" type="box" size="1.8 1.8 .1" pos="-2 0 .1"/>'
    rooms = rooms_of(bake(tmp_path, SLABS + podium))
    assert set(rooms) == {"west", "east"}
    assert span(rooms["west"]) == [-4, -2, 0, 2]


def test_a_house_is_none_of_the_ground_under_it(tmp_path):
    """The floors of its rooms are a step over the ground, which is a room by its name."""
    body = """
    <geom name="floor|ground" type="box" size="6 4 .1" pos="0 0 -.1"/>
    <geom name="slab" type="box" size="3 2 .1" pos="0 0 .1"/>
    <geom type="box" size="3 .1 1.3" pos="0 1.9 1.3"/>
    <geom type="box" size="3 .1 1.3" pos="0 -1.9 1.3"/>
    <geom type="box" size=".1 1.8 1.3" pos="-2.9 0 1.3"/>
    <geom type="box" size=".1 1.3 1.3" pos="2.9 -.5 1.3"/>
    """
    rooms = rooms_of(bake(tmp_path, body))
    assert set(rooms) == {"ground", None}
    assert span(rooms[None])[:2] == pytest.approx([-2.75, -1.75], abs=0.26)


def test_geoms_that_are_only_drawn(tmp_path):
    """A floor that collides under floors that don't, of which one is a mesh a hair above it."""
    body = """
    <geom name="ground" type="plane" size="4 2 .1"/>
    <geom name="room|1" type="box" pos="-2 0 -.01" size="2 2 .01" contype="0" conaffinity="0"/>
    <geom name="room|2" type="mesh" mesh="l" contype="0" conaffinity="0" pos="0 0 .002"/>
    """
    # an L, whose hull would be larger
    asset = """<mesh name="l" inertia="shell"
        vertex="0 -2 0  4 -2 0  4 0 0  2 0 0  2 2 0  0 2 0"
        face="0 1 2 0 2 3 0 3 4 0 4 5"/>"""
    rooms = rooms_of(bake(tmp_path, body, asset, rooms={"from": ["geoms"]}))
    assert span(rooms["room|1"]) == [-4, -2, 0, 2]
    assert len(rooms["room|2"][0]) == 12 * 16
    assert not ((rooms["room|2"][0] > 2) & (rooms["room|2"][1] > 0)).any()


def test_parts_of_a_mesh_file_that_are_left_out(tmp_path):
    path = tmp_path / "scene.obj"
    corners = ("-4 -2", "0 -2", "4 -2", "4 2", "0 2", "-4 2")
    text = "".join(f"v {corner} 0\n" for corner in corners)
    rooms = "o floor|west\nf 1 2 5 6\no floor|east\nf 2 3 4 5\n"
    path.write_text(f"{text}o slab\nf 1 3 4 6\n{rooms}")
    scene = {"path": path, "exclude": {"geoms": ["floor|*"]}}
    config = {"scene": scene, "grid": {"cell_size": 0.25}}
    rooms = rooms_of(run_bake(parse_config(config)))
    assert span(rooms["west"]) == [-4, -2, 0, 2]


def test_what_is_no_floor_is_no_room(tmp_path):
    """A wall, a lamp and a box that stands on the floor have names like rooms."""
    body = """
    <geom name="room_floor" type="box" pos="0 0 -.1" size="2 2 .1"/>
    <geom name="room_wall" type="box" pos="0 1.9 1" size="2 .1 1"/>
    <geom name="room_lamp" type="box" pos="0 0 2" size=".5 .5 .1"/>
    <geom name="room_object" type="box" pos="0 -1 .3" size=".4 .4 .3"/>
    """
    assert list(rooms_of(bake(tmp_path, body))) == ["room_floor"]


def test_a_geom_on_two_storeys_is_a_room_on_each(tmp_path):
    body = """
    <geom name="floor|all" type="mesh" mesh="both"/>
    """
    asset = """<mesh name="both" inertia="shell"
        vertex="-2 -2 0  2 -2 0  2 2 0  -2 2 0  -2 -2 3  2 -2 3  2 2 3  -2 2 3"
        face="0 1 2 0 2 3 4 5 6 4 6 7"/>"""
    scene = {"meshes": "surface", "path": tmp_path / "scene.xml"}
    table = bake(tmp_path, body, asset, scene=scene, floors={"roofs": True}).grid.navbake["rooms"]
    assert [(room["id"], room["name"]) for room in table] == [("0:1", "all"), ("1:1", "all")]


# ---------------------------------------------------------------- sites


@pytest.mark.parametrize(
    ("site", "expected"),
    [
        ('type="box" pos="-2 0 1.25" size="1 1.5 1.25"', [-3, -1.5, -1, 1.5]),
        ('type="box" pos="-2 0 0" size="1 1.5 .005"', [-3, -1.5, -1, 1.5]),  # on the floor
        ('type="box" pos="-2 0 -.02" size="1 1.5 .01"', [-3, -1.5, -1, 1.5]),  # just under it
        ('type="cylinder" pos="-2 0 1" size="1 1"', [-3, -1, -1, 1]),
        ('type="sphere" pos="-2 0 .8" size="1"', [-3, -1, -1, 1]),
        ('type="ellipsoid" pos="-2 0 .8" size="1 1.5 1"', [-3, -1.5, -1, 1.5]),
        ('type="capsule" pos="-2 0 .5" size=".5 1" euler="90 0 0"', [-2.5, -1.5, -1.5, 1.5]),
    ],
)
def test_sites(tmp_path, site, expected):
    floor = '<geom type="box" pos="0 0 -.1" size="4 2 .1"/>'
    result = bake(
        tmp_path, f'{floor}<site name="room_a" {site}/>', rooms={"from": ["sites"], "min_area": 0.2}
    )
    x0, y0, x1, y1 = span(rooms_of(result)["room_a"])
    found, wanted = np.array([x0, y0, x1, y1]), np.array(expected)
    assert (np.abs(found - wanted) <= 0.25).all()
    assert (found[:2] >= wanted[:2] - 1e-9).all()
    assert (found[2:] <= wanted[2:] + 1e-9).all()


def test_a_site_stays_on_its_storey(tmp_path):
    """It pokes 10 cm into the next one."""
    body = """
    <geom type="box" pos="0 0 -.1" size="2 2 .1"/>
    <geom type="box" pos="0 0 2.6" size="2 2 .1"/>
    <site name="room_low" type="box" pos="0 0 1.4" size="2 2 1.4"/>
    """
    settings = {"rooms": {"from": ["sites"]}, "floors": {"roofs": True}}
    result = bake(tmp_path, body, **settings)
    assert len(result.grid.levels) == 2
    assert list(rooms_of(result, 0)) == ["room_low"]
    assert list(rooms_of(result, 1)) == []


def test_turned_sites_on_bodies(tmp_path):
    body = """
    <geom type="box" pos="0 0 -.1" size="4 2 .1"/>
    <body pos="-2 0 1" euler="0 0 45"><site name="room_a" type="box" size="1 1 1"/></body>
    """
    x, y = rooms_of(bake(tmp_path, body, rooms={"from": ["sites"]}))["room_a"]
    assert (np.abs(x + 2) + np.abs(y) <= np.sqrt(2) + 1e-9).all()
    assert len(x) == pytest.approx(64, abs=8)


def test_markers_are_no_rooms(tmp_path):
    markers = "".join(f'<site name="room_{k}" pos="{k - 3} 0 0"/>' for k in range(7))
    result = bake(tmp_path, SLABS + markers)
    assert list(rooms_of(result)) == ["west", "east"]
    (warning,) = result.warnings
    assert warning.startswith("sites that hold less than 1 m² of floor")
    assert "room_0, room_1" in warning
    assert "…; make each site as large as its room, or draw the room" in warning


# ---------------------------------------------------------------- polygons


def test_polygons_by_level_and_name(tmp_path):
    body = """
    <geom type="box" pos="0 0 -.1" size="4 2 .1"/>
    <geom type="box" pos="0 0 2.6" size="4 2 .1"/>
    """
    levels = [{"ground": 0.0, "name": "below"}, {"ground": 2.7, "name": "above"}]
    polygons = [
        {"name": "hall", "points": SQUARE},
        {"name": "hall", "level": "above", "points": SQUARE},
        {"name": "all", "level": 1, "points": [[-4, -2], [4, -2], [4, 2], [-4, 2]]},
    ]
    result = bake(
        tmp_path,
        body,
        levels=levels,
        floors={"roofs": True},
        rooms={"from": ["polygons"], "polygons": polygons},
    )
    assert span(rooms_of(result, 0)["hall"]) == [-2, -2, 0, 0]
    assert span(rooms_of(result, 1)["hall"]) == [-2, -2, 0, 0]
    assert len(rooms_of(result, 1)["all"][0]) == 32 * 16 - 64
    ids = [room.id for room in result.grid.rooms]
    assert ids == ["0:1", "all", "1:2"]
    (warning,) = result.warnings
    assert "no step leads to 'above'" in warning


def test_a_level_that_there_is_not(tmp_path):
    polygons = [{"name": "attic", "level": 3, "points": SQUARE}]
    with pytest.raises(ConfigError, match=r"no level 3 for room 'attic'.*there are 0 \(level 0\)"):
        bake(tmp_path, SLABS, rooms={"polygons": polygons})
    polygons = [{"level": "attic", "points": SQUARE}]
    with pytest.raises(ConfigError, match=r"no level 'attic' for room \[0\]"):
        bake(tmp_path, SLABS, rooms={"polygons": polygons})


def test_a_polygon_beside_its_level(tmp_path):
    polygons = [{"name": "moon", "points": [[90, 0], [91, 0], [91, 1]]}]
    result = bake(tmp_path, SLABS, rooms={"polygons": polygons})
    (warning,) = result.warnings
    assert warning == (
        "room 'moon' of `rooms.polygons` has no floor on level 0, whose floor spans "
        "x -3.88 to 3.88, y -1.88 to 1.88 m"
    )
    assert list(rooms_of(result)) == ["west", "east"]


# ---------------------------------------------------------------- several


def test_the_first_source_wins(tmp_path):
    body = SLABS + '<site name="room_a" type="box" pos="-1 0 1" size="1 2 1"/>'
    polygons = [{"name": "p", "points": SQUARE}]
    for order in (["polygons", "geoms", "sites"], ["sites", "geoms", "polygons"]):
        rooms = rooms_of(bake(tmp_path, body, rooms={"from": order, "polygons": polygons}))
        assert len(rooms["east"][0]) == 256
        if order[0] == "polygons":
            assert {name: len(cells[0]) for name, cells in rooms.items()} == {
                "west": 192, "p": 64, "east": 256,
            }  # fmt: skip
        else:
            assert {name: len(cells[0]) for name, cells in rooms.items()} == {
                "west": 128, "room_a": 128, "east": 256,
            }  # fmt: skip


def test_patterns_that_match_nothing(tmp_path):
    result = bake(tmp_path, SLABS, rooms={"geoms": ["flor|*", "floor|*"], "sites": ["zone*"]})
    assert result.warnings == [
        "`rooms.geoms` pattern 'flor|*' matches nothing",
        "`rooms.sites` pattern 'zone*' matches nothing",
    ]
    assert bake(tmp_path, SLABS).warnings == []  # the default ones may
