"""What is drawn into MuJoCo's scenes: read back from `scene.geoms`, which takes no window."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import navbake
from grid_maps import level_from
from link_towers import DROP, LIFT, at, tower
from navbake.episodes.episode import Episode, Goal, ViewPoint
from navbake.errors import QueryError
from navbake.navgrid import colors
from navbake.navgrid.grid import SceneGrid2D
from navbake.runtime.draws import Pose, Spawns
from navbake.runtime.stand import StandPoses
from navbake.views.describe import list_arcs
from navbake.views.draw import BRIGHTNESS, LINE_LIFT, LINE_RADIUS, DrawCount
from navbake.views.layers import FLAT_TOLERANCE, LAYER_LIFT, make_panel, paint, tint_free_cells
from navbake.voxels.finder import VoxelFinder
from navbake.voxels.grid import VoxelGrid

MODEL = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><light/><geom size='1'/><body><geom size='2'/></body></worldbody></mujoco>"
)
LIFTED = np.array([0.0, 0.0, LINE_LIFT * LINE_RADIUS])
ROOM = """
#########
#...22..#
#...22..#
# .......
#########
"""


def make_scene(maxgeom=2000):
    return mujoco.MjvScene(MODEL, maxgeom)


def drawn(scene, kind):
    """The geoms of a type, in the order in which they were drawn."""
    number = getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}")
    return [geom for geom in scene.geoms[: scene.ngeom] if geom.type == number]


def draw_alone(content, **options):
    """A scene with nothing else in it."""
    scene = make_scene()
    count = navbake.draw(scene, content, **options)
    assert count == DrawCount(scene.ngeom, 0)
    return scene


def ends_of(geom):
    """Both ends of a capsule's axis, world x, y, z [m]."""
    axis = geom.mat[:, 2] * geom.size[2]
    return np.array([geom.pos - axis, geom.pos + axis])


def rgb_drawn(color):
    return pytest.approx(np.array(colors.rgb_of(color)) / 255 * BRIGHTNESS, abs=1e-6)


def texts_of(scene):
    return [geom.label for geom in drawn(scene, "label")]


def rasterize(scene, level):
    """Per cell, how many boxes its centre is under, the z of their top, and their colour."""
    rows, cols = np.indices(level.shape)
    x, y = np.moveaxis(level.lattice.positions(rows, cols), -1, 0)
    counts = np.zeros(level.shape, dtype=int)
    tops = np.full(level.shape, np.nan)
    rgb = np.full((*level.shape, 3), np.nan)
    for box in drawn(scene, "box"):
        x_axis, y_axis, normal = box.mat.T
        face = box.pos + normal * box.size[2]
        z = face[2] - ((x - face[0]) * normal[0] + (y - face[1]) * normal[1]) / normal[2]
        offsets = np.stack([x, y, z], axis=-1) - face
        is_under = np.abs(offsets @ x_axis) < box.size[0]
        is_under &= np.abs(offsets @ y_axis) < box.size[1]
        counts += is_under
        tops[is_under] = z[is_under]
        rgb[is_under] = box.rgba[:3]
    return counts, tops, rgb


def check_cells(level, layer="occupancy"):
    scene = draw_alone(level, layer=layer, labels=False)
    counts, tops, rgb = rasterize(scene, level)
    has_floor = ~np.isnan(level.floor_height)
    np.testing.assert_array_equal(counts, has_floor)
    lifts = (tops - level.floor)[has_floor]
    assert (np.abs(lifts - LAYER_LIFT - FLAT_TOLERANCE) <= FLAT_TOLERANCE + 1e-4).all()
    panel = tint_free_cells(make_panel(level, layer, 0))
    expected = paint(panel._replace(relief_step=0.0), 16) / 255 * BRIGHTNESS
    np.testing.assert_allclose(rgb[has_floor], expected[has_floor], atol=1e-6)
    return scene


def test_boxes_cover_the_cells_with_a_floor_once_in_the_layers_colours():
    level = level_from(ROOM)
    scene = check_cells(level)
    assert 4 <= len(drawn(scene, "box")) <= 12  # of 44 cells
    scene = check_cells(level, "floor")
    assert 2 <= len(drawn(scene, "box")) <= 8


@pytest.mark.parametrize("layer", ["occupancy", "rooms", "clearance", "weights", "island"])
def test_boxes_cover_a_sample(layer):
    grid = navbake.bake(navbake.samples.path("apartment"))
    scene = check_cells(grid, layer)
    assert len(drawn(scene, "box")) < np.count_nonzero(~np.isnan(grid.floor_height)) / 4


def slope_level(rise_x, rise_y, shape=(7, 9), holes=()):
    rows, cols = np.indices(shape)
    floor = 0.5 + rise_x * cols - rise_y * rows
    for row, col in holes:
        floor[row, col] = np.nan
    return SceneGrid2D(
        width=shape[1],
        height=shape[0],
        cell_size=0.1,
        min_yup=(-0.3, 0.0, 0.2),
        weights=np.where(np.isnan(floor), np.inf, 1.0),
        attributes={"floorHeight": floor.astype(np.float32)},
    )


@pytest.mark.parametrize(("rise_x", "rise_y"), [(0.03, 0.0), (0.0, -0.05), (0.03, 0.02)])
def test_boxes_lie_on_slopes(rise_x, rise_y):
    """On those along both axes in strips, since a box has right angles."""
    scene = check_cells(slope_level(rise_x, rise_y))
    assert len(drawn(scene, "box")) == (7 if rise_x and rise_y else 1)


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6))
def test_boxes_cover_random_levels(seed):
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 12, size=2).tolist())
    holes = np.argwhere(rng.random(shape) < 0.2)
    check_cells(slope_level(rng.choice([0.0, 0.04]), rng.choice([0.0, -0.03]), shape, holes))


def test_a_level_is_drawn_alone_or_with_all_others():
    grid = tower(LIFT, DROP, storeys=3)
    one_z = {round(float(box.pos[2])) for box in drawn(draw_alone(grid, level=1), "box")}
    all_z = {round(float(box.pos[2])) for box in drawn(draw_alone(grid), "box")}
    assert (one_z, all_z) == ({3}, {0, 3, 6})


def test_a_finder_is_drawn_as_its_grid_for_the_agent():
    grid = navbake.bake(navbake.samples.path("apartment"))
    inflated = grid.inflate(0.2)
    finder = navbake.PathFinder(inflated)
    assert draw_alone(finder).ngeom == draw_alone(inflated).ngeom != draw_alone(grid).ngeom


def test_doors_are_lines_from_jamb_to_jamb_paler_unless_closed():
    grid = navbake.bake(navbake.samples.path("apartment"))
    panel = make_panel(grid, "occupancy", 0)
    for state, opacity in (("closed", 1.0), ("open", 0.4)):
        capsules = drawn(draw_alone(grid.with_doors(state)), "capsule")
        assert len(capsules) == len(panel.doors) > 2
        for capsule, door in zip(capsules, panel.doors, strict=True):
            ends = sorted(map(tuple, ends_of(capsule)[:, :2]))
            np.testing.assert_allclose(ends, sorted([door.start, door.end]), atol=1e-5)
            assert capsule.rgba[3] == pytest.approx(opacity)
            assert capsule.rgba[:3] == rgb_drawn(colors.DOOR)


def test_names_of_rooms_stand_over_them_and_only_if_wanted():
    grid = navbake.bake(navbake.samples.path("apartment"))
    assert set(texts_of(draw_alone(grid, layer="rooms"))) == {room.name for room in grid.rooms}
    assert texts_of(draw_alone(grid, layer="rooms", labels=False)) == []
    finder = navbake.PathFinder(grid)
    room_of_name = {room.name: room.id for room in grid.rooms}
    for label in drawn(draw_alone(grid, layer="rooms"), "label"):
        assert finder.room_at(label.pos) == room_of_name[label.label]


def test_names_that_mujoco_cannot_write_are_ids_or_cut():
    goals = (
        Goal(position=(1.0, 1.0, 0.0), name="küche", room="0:4"),
        Goal(position=(1.0, 1.0, 0.0), name="küche"),
        Goal(position=(1.0, 1.0, 0.0), name="a" * 200),
        Goal(position=(1.0, 1.0, 0.0), name="two\nlines"),
    )
    episode = Episode(
        id="7", scene="s", task="point", start=(0.0, 0.0, 0.0), heading=0.0, goals=goals
    )
    long = "a" * 96 + "..."
    assert texts_of(draw_alone(episode)) == ["7", "0:4", "k?che", long, r"two\nlines"]


def check_line(capsules, points):
    """That capsules lead from point to point."""
    assert len(capsules) == len(points) - 1
    for capsule, start, end in zip(capsules, points[:-1], points[1:], strict=True):
        np.testing.assert_allclose(ends_of(capsule), [start, end], atol=1e-5)
        np.testing.assert_allclose(capsule.size[:2], LINE_RADIUS)


def test_a_path_is_capsules_with_arrows_along_it():
    grid = navbake.bake(navbake.samples.path("apartment"))
    path = navbake.PathFinder(grid.inflate(0.2)).find_path((-4.0, -2.0, 0.0), (3.5, 0.5, 0.0))
    scene = draw_alone(path)
    points = path.positions + LIFTED
    capsules = drawn(scene, "capsule")
    check_line(capsules, points)
    assert all(capsule.rgba[:3] == rgb_drawn(colors.ROUTE) for capsule in capsules)
    arrows = drawn(scene, "arrow")
    assert len(arrows) == np.ceil(path.length) - (path.length % 1 < 0.135)
    tips = np.array([arrow.pos + arrow.mat[:, 2] * arrow.size[2] / 2 for arrow in arrows])
    starts, directions = points[:-1], np.diff(points, axis=0)
    for arrow, tip in zip(arrows, tips, strict=True):
        shares = ((tip - starts) * directions).sum(axis=1) / (directions**2).sum(axis=1)
        offsets = starts + shares.clip(0, 1)[:, None] * directions - tip
        nearest = int(np.argmin(np.linalg.norm(offsets, axis=1)))
        assert np.linalg.norm(offsets[nearest]) < 1e-5
        assert min(abs(shares[nearest]), abs(shares[nearest] - 1)) < 1e-4 or (
            arrow.mat[:, 2] @ directions[nearest] / np.linalg.norm(directions[nearest])
            == pytest.approx(1.0)
        )
    np.testing.assert_allclose(tips[0], points[-1], atol=1e-5)
    (ball,) = drawn(scene, "sphere")
    np.testing.assert_allclose(ball.pos, points[0], atol=1e-5)


def test_links_of_a_path_and_of_a_grid_are_arcs():
    grid = tower(LIFT, DROP, storeys=3)
    path = navbake.PathFinder(grid).find_path(at(0, 1), at(1, 8))
    assert path.links == ["A"]
    scene = draw_alone(path)
    on_link = [geom for geom in drawn(scene, "capsule") if geom.rgba[:3] == rgb_drawn(colors.LINK)]
    first, last = path.stops[0]
    assert len(on_link) == 16
    np.testing.assert_allclose(ends_of(on_link[0])[0], path.positions[first] + LIFTED, atol=1e-5)
    np.testing.assert_allclose(ends_of(on_link[-1])[1], path.positions[last] + LIFTED, atol=1e-5)
    assert len(drawn(scene, "capsule")) == 16 + 2  # and a line on each level

    scene = draw_alone(grid, layer="links")
    arcs = list_arcs(grid, (0, 1, 2))
    assert [arc.is_one_way for arc in arcs] == [False, False, True]
    points = np.concatenate([arc.points[:-1] for arc in arcs]) + LIFTED
    starts = [ends_of(capsule)[0] for capsule in drawn(scene, "capsule")]
    np.testing.assert_allclose(starts, points, atol=1e-5)
    assert len(drawn(scene, "arrow")) == 4  # on the drop of more than 3 m, which is one-way
    assert sorted(texts_of(scene)) == ["A", "A", "A", "dock", "dock"]
    assert drawn(draw_alone(grid, layer="links", level=0), "arrow") == []


def test_poses_are_discs_with_an_arrow_to_where_they_face():
    poses = StandPoses(
        positions=np.array([[0.0, 1.0, 0.5], [2.0, 3.0, 0.5], [4.0, 3.0, 0.0]]),
        headings=np.array([0.0, np.pi / 2, np.pi]),
        target_index=np.array([0, 0, 1]),
        distances=np.ones(3),
        path_lengths=np.ones(3),
        targets=("sofa", "mug"),
        target_boxes=np.zeros((2, 6)),
        outline=np.zeros((3, 2)),
        why_not={},
    )
    scene = draw_alone(poses)
    arrows = drawn(scene, "arrow")
    directions = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0]])
    np.testing.assert_allclose([arrow.mat[:, 2] for arrow in arrows], directions, atol=1e-5)
    for kind in ("cylinder", "arrow"):
        positions = [geom.pos[:2] for geom in drawn(scene, kind)]
        np.testing.assert_allclose(positions, poses.positions[:, :2], atol=1e-6)
        assert [
            list(colors.MARKS).index(color)
            for geom in drawn(scene, kind)
            for color in colors.MARKS
            if geom.rgba[:3] == rgb_drawn(color)
        ] == [0, 0, 1]
    assert texts_of(scene) == ["sofa", "mug"]
    spawns = Spawns(poses.positions, poses.headings)
    assert draw_alone(spawns).ngeom == draw_alone(poses, labels=False).ngeom == 6
    (arrow,) = drawn(draw_alone(Pose(poses.positions[1], np.pi / 2), color="#ff0000"), "arrow")
    np.testing.assert_allclose(arrow.mat[:, 2], [0, 1, 0], atol=1e-6)
    assert arrow.rgba[:3] == rgb_drawn("#ff0000")


def test_an_episode_is_its_start_its_path_and_its_goals():
    goals = (
        Goal(position=(3.0, 0.0, 0.5), radius=0.4, name="mug"),
        Goal(view_points=(ViewPoint(position=(1.0, 2.0, 0.0), heading=0.0),), category="sofa"),
        Goal(room="1:2"),  # nobody knows where
    )
    path = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (3.0, 0.0, 0.5))
    episode = Episode(
        id="e1", scene="s", task="object", start=path[0], heading=0.7, goals=goals, path=path
    )
    scene = draw_alone(episode)
    balls = np.array([ball.pos for ball in drawn(scene, "sphere")])
    np.testing.assert_allclose(balls - LIFTED, [[0, 0, 0], [3, 0, 0.5], [1, 2, 0]], atol=1e-6)
    (disc,) = drawn(scene, "cylinder")
    np.testing.assert_allclose(disc.size[:2], 0.4)
    check_line(drawn(scene, "capsule"), np.array(path) + LIFTED)
    np.testing.assert_allclose(
        drawn(scene, "arrow")[0].mat[:, 2], [np.cos(0.7), np.sin(0.7), 0.0], atol=1e-6
    )
    assert texts_of(scene) == ["e1", "mug", "sofa"]


def fill(scene, voxels):
    """How many boxes each voxel's centre is in, and the colour of the last."""
    centers = np.array(voxels.origin) + (np.indices(voxels.shape).T + 0.5).T.reshape(3, -1).T * (
        voxels.res
    )
    counts = np.zeros(len(centers), dtype=int)
    rgb = np.full((len(centers), 3), np.nan)
    for box in drawn(scene, "box"):
        np.testing.assert_array_equal(box.mat, np.eye(3))
        is_in = (np.abs(centers - box.pos) < box.size).all(axis=1)
        counts += is_in
        rgb[is_in] = box.rgba[:3]
    return counts.reshape(voxels.shape), rgb.reshape(*voxels.shape, 3)


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6))
def test_boxes_fill_the_occupied_voxels_once(seed):
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(1, 7, size=3).tolist())
    ids = rng.integers(0, 4, size=shape).astype(np.uint16) * 1000
    voxels = VoxelGrid(values=ids, origin=(0.3, -1.0, 2.0), res=0.1)
    counts, rgb = fill(draw_alone(voxels), voxels)
    np.testing.assert_array_equal(counts, voxels.occupied)
    for number in np.unique(ids[ids > 0]).tolist():
        color = colors.ROOMS[number % len(colors.ROOMS)]
        (drawn_rgb,) = np.unique(rgb[ids == number], axis=0)
        assert drawn_rgb == rgb_drawn(color)
    alike = voxels.without_ids()
    scene = draw_alone(alike, color="#102030")
    np.testing.assert_array_equal(fill(scene, alike)[0], voxels.occupied)
    assert all(box.rgba[:3] == rgb_drawn("#102030") for box in drawn(scene, "box"))


def test_a_wall_of_voxels_is_one_box():
    values = np.zeros((8, 3, 5), dtype=bool)
    values[:, 1] = True
    assert draw_alone(VoxelGrid(values=values, origin=(0, 0, 0), res=0.1)).ngeom == 1


def test_a_flight_lies_where_it_flies_in_a_tube():
    values = np.zeros((30, 10, 10), dtype=bool)
    values[15, :6] = True
    finder = VoxelFinder(VoxelGrid(values=values, origin=(0, 0, 0), res=0.1), radius=0.12)
    path = finder.find_path((0.3, 0.3, 0.5), (2.7, 0.3, 0.5))
    capsules = drawn(draw_alone(path), "capsule")
    middle = len(capsules) // 2
    check_line(capsules[:middle], path.positions)
    for tube, line in zip(capsules[middle:], capsules[:middle], strict=True):
        np.testing.assert_allclose(ends_of(tube), ends_of(line), atol=1e-6)
        assert tube.size[0] == pytest.approx(0.12)
        assert tube.rgba[3] < 0.5
    assert draw_alone(finder).ngeom == draw_alone(finder.voxels).ngeom > 0


def test_opacity_and_radius_hold_for_all_that_is_drawn():
    path = navbake.PathFinder(tower(LIFT, storeys=3)).find_path(at(0, 1), at(1, 8))
    scene = draw_alone(path, opacity=0.5, radius=0.01)
    assert {float(geom.rgba[3]) for geom in scene.geoms[: scene.ngeom]} == {0.5}
    assert {round(float(geom.size[0]), 4) for geom in drawn(scene, "capsule")} == {0.01}


def test_a_full_scene_takes_lines_names_and_the_largest_boxes_and_says_so():
    grid = navbake.bake(navbake.samples.path("apartment"))
    whole = draw_alone(grid, layer="rooms")
    scene = make_scene(maxgeom=60)
    with pytest.warns(UserWarning, match=r"geoms of \d+ left out, as the scene holds 60: make"):
        count = navbake.draw(scene, grid, layer="rooms")
    assert count == DrawCount(60, whole.ngeom - 60)
    assert scene.ngeom == scene.maxgeom == 60
    assert texts_of(scene) == texts_of(whole)
    assert len(drawn(scene, "capsule")) == len(drawn(whole, "capsule"))
    volumes = [np.prod(box.size) for box in drawn(whole, "box")]
    assert volumes == sorted(volumes, reverse=True)
    voxels = VoxelGrid(values=np.ones((1, 1, 1), bool), origin=(0.0, 0.0, 0.0), res=1.0)
    with pytest.warns(UserWarning, match="1 geom of 1 left out"):
        assert navbake.draw(scene, voxels) == DrawCount(0, 1)


def record(geom):
    names = [name for name in dir(geom) if not name.startswith("_")]
    return {name: np.array(getattr(geom, name)).tolist() for name in names}


def test_nothing_but_the_added_geoms_changes():
    scene = make_scene()
    data = mujoco.MjData(MODEL)
    mujoco.mj_forward(MODEL, data)
    camera, option = mujoco.MjvCamera(), mujoco.MjvOption()
    mujoco.mjv_updateScene(MODEL, data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
    num_before = scene.ngeom
    before = [record(geom) for geom in scene.geoms[:num_before]]
    flags, num_lights, maxgeom = scene.flags.tolist(), scene.nlight, scene.maxgeom
    grid = tower(LIFT, DROP, storeys=3)
    count = navbake.draw(scene, grid, layer="links")
    assert [record(geom) for geom in scene.geoms[:num_before]] == before
    assert scene.ngeom == num_before + count.added
    assert (scene.flags.tolist(), scene.nlight, scene.maxgeom) == (flags, num_lights, maxgeom)
    for geom in scene.geoms[num_before : scene.ngeom]:
        assert (geom.objtype, geom.objid, geom.segid) == (0, -1, -1)
        assert geom.category == mujoco.mjtCatBit.mjCAT_DECOR
    first = [record(geom) for geom in scene.geoms[num_before : scene.ngeom]]
    scene.ngeom = num_before
    navbake.draw(scene, grid, layer="links")
    assert [record(geom) for geom in scene.geoms[num_before : scene.ngeom]] == first


GRID = level_from(ROOM)
PATH = navbake.PathFinder(GRID).find_path((0.15, -0.15), (0.7, -0.3))


@pytest.mark.parametrize(
    ("content", "options", "words"),
    [
        (None, {}, "expected a grid, finder, path, .*, got NoneType: .* finder.why_not says why"),
        ([PATH], {}, "expected a grid, finder, path, poses, voxels or episode, got list"),
        (GRID, {"opacity": 0}, "expected an opacity > 0, at most 1, got 0"),
        (GRID, {"opacity": np.nan}, "expected an opacity > 0, at most 1, got nan"),
        (GRID, {"radius": -0.1}, "expected a radius > 0 m, got -0.1"),
        (PATH, {"color": "red"}, "expected a colour such as #1864ab, got 'red'"),
        (PATH, {"layer": "rooms"}, "a Path is drawn without `layer`, got 'rooms'"),
        (GRID, {"color": "#ff0000"}, "a SceneGrid2D is drawn without `color`, got '#ff0000'"),
        (GRID, {"layer": "room"}, "expected one of occupancy, floor, .* as layer, got 'room'"),
        (GRID, {"level": 3}, "level"),
    ],
)
def test_wrong_arguments_are_refused_in_one_line_and_nothing_is_drawn(content, options, words):
    scene = make_scene()
    with pytest.raises(QueryError, match=words) as refused:
        navbake.draw(scene, content, **options)
    assert "\n" not in str(refused.value)
    assert scene.ngeom == 0


def test_a_viewer_in_place_of_its_scene_is_refused():
    words = "expected an mjvScene, such as viewer.user_scn or renderer.scene, got MjModel"
    with pytest.raises(QueryError, match=words) as refused:
        navbake.draw(MODEL, GRID)
    assert refused.value.key == "scene"


SEEN = """
import mujoco, numpy as np, navbake
from navbake.runtime.draws import Pose
model = mujoco.MjModel.from_xml_string('''<mujoco><worldbody><light pos="0 0 9"/>
<geom type="plane" size="4 4 .1" rgba=".2 .2 .2 1"/></worldbody></mujoco>''')
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
try:
    renderer = mujoco.Renderer(model, 60, 80)
except Exception as error:
    raise SystemExit(f"no rendering: {error}")
camera = mujoco.MjvCamera()
camera.distance, camera.azimuth, camera.elevation = 6.0, 90.0, -90.0
voxels = navbake.VoxelGrid(values=np.ones((4, 4, 1), bool), origin=(-1, -1, 0), res=0.5)
renderer.update_scene(data, camera)
before = renderer.render().astype(int)
navbake.draw(renderer.scene, voxels, color="#ff0000")
after = renderer.render().astype(int)
is_changed = (before != after).any(axis=2)
red, green, blue = after[is_changed].mean(axis=0)
renderer.update_scene(data, camera)
navbake.draw(renderer.scene, Pose(np.zeros(3), 0.0), radius=0.1)
is_pose = (renderer.render() != before).any(axis=2)
rows, columns = np.nonzero(is_pose)
assert 13 <= columns.max() - 40 <= 17, columns  # 1.2 m at 12.5 pixels for each
assert 0.02 < is_changed.mean() < 0.9 and red > green + 50, (is_changed.mean(), red, green)
renderer.enable_segmentation_rendering()
renderer.update_scene(data, camera)
before = renderer.render()
navbake.draw(renderer.scene, voxels)
assert (renderer.render() == before).all()
print("seen")
"""


def test_what_is_drawn_is_seen_in_pictures_but_not_in_segmentations():
    environment = {**os.environ, "MUJOCO_GL": "egl"} if sys.platform == "linux" else None
    command = [sys.executable, "-c", SEEN]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if "no rendering" in done.stderr or "gl_context" in done.stderr or "OpenGL" in done.stderr:
        pytest.skip(f"MuJoCo can't render here: {done.stderr.strip().splitlines()[-1]}")
    assert done.stdout == "seen\n", done.stderr


def test_samples_fit_into_a_scene_without_warnings():
    for name in ("terrain", "tower"):
        grid = navbake.bake(navbake.samples.path(name))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert navbake.draw(make_scene(maxgeom=10_000), grid, layer="floor").left_out == 0
