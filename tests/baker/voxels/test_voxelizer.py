"""Voxel grids of scenes: where they lie, what fills them, poses, and what is wrong."""

import mujoco
import numpy as np
import pytest

import navbake
from navbake import ConfigError, SceneError, Voxelizer, create_voxel_grid
from navbake.threads import limit_threads
from navbake.voxels.grid import Placement, place_grid

SCENE = """
<mujoco>
  <asset>
    <hfield name="hills" nrow="3" ncol="3" size="1 1 .5 .1" elevation="0 .2 0 .2 1 .2 0 .2 0"/>
  </asset>
  <worldbody>
    <geom name="floor" type="box" size="2 2 .1" pos="0 0 -.1"/>
    <body name="table" pos="1 1 0">
      <geom name="top" type="box" size=".4 .4 .05" pos="0 0 .75"/>
      <body name="drawer" pos="0 0 .55">
        <joint name="pull" type="slide" axis="1 0 0" range="0 1"/>
        <geom name="front" type="box" size=".2 .2 .05"/>
        <geom type="sphere" size=".04" pos="0 0 .1"/>
      </body>
    </body>
    <body name="arm" pos="-1 -1 .5">
      <joint name="turn" type="hinge" axis="0 0 1"/>
      <geom name="link" type="capsule" fromto="0 0 0 .6 0 0" size=".05"/>
      <geom name="wedge" type="mesh" mesh="wedge" pos=".6 0 .2"/>
    </body>
    <geom name="lamp" type="sphere" size=".2" pos="0 0 1.5"/>
  </worldbody>
  <keyframe><key name="out" qpos=".5 1"/></keyframe>
</mujoco>
""".replace("</asset>", '<mesh name="wedge" vertex="0 0 0 .3 0 0 0 .2 0 0 0 .1"/></asset>')


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "room.xml"
    path.write_text(SCENE)
    return str(path)


@pytest.fixture(scope="module")
def voxelizer(path):
    return Voxelizer(path)


def scene_of(tmp_path, geoms, settings=None):
    path = tmp_path / "scene.xml"
    path.write_text(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>")
    return Voxelizer({"scene": {"path": str(path), **(settings or {})}})


# ---------------------------------------------------------------- where it lies


def test_the_seeds_call(path, tmp_path):
    grid = create_voxel_grid(path, (0.5, 0, 1), 10, 8, 6, 0.25, tmp_path / "map.binvox")
    assert grid.shape == (10, 8, 6) and grid.values.dtype == np.bool_
    np.testing.assert_allclose(grid.bounds, [[-0.75, -1, 0.25], [1.75, 1, 1.75]])
    assert grid.at([0, 0, 1.5]) and not grid.at([0, 0, 0.5])
    back = navbake.load_voxels(tmp_path / "map.binvox")
    np.testing.assert_array_equal(back.values, grid.values)


def test_a_size_in_metres_is_covered(voxelizer):
    grid = voxelizer.create((0, 0, 1), size=(1.0, 0.55, 0.7), res=0.1)
    assert grid.shape == (10, 6, 7)
    np.testing.assert_allclose(grid.bounds.mean(axis=0), [0, 0, 1])


def test_without_a_centre_the_scenes_box_is_covered(voxelizer):
    grid = voxelizer.create(res=0.3)
    low, high = voxelizer.scene.bounds
    assert (grid.bounds[0] <= low + 1e-9).all() and (grid.bounds[1] >= high - 1e-9).all()
    assert (grid.bounds[0] > low - 0.3).all() and (grid.bounds[1] < high + 0.3).all()
    off = np.array(grid.origin) / 0.3
    np.testing.assert_allclose(off, np.round(off), atol=1e-9)


def test_a_grid_for_an_octree_is_moved_onto_its_lattice(voxelizer, tmp_path):
    grid = create_voxel_grid(voxelizer, (0.03, 0, 1.5), 5, 6, 6, 0.1, tmp_path / "a.bt")
    back = navbake.load_voxels(tmp_path / "a.bt")
    np.testing.assert_allclose(grid.origin, [-0.2, -0.3, 1.2], atol=1e-9)
    np.testing.assert_allclose(back.centers(), grid.centers(), atol=1e-9)
    assert len(grid.centers()) > 50
    assert grid.notes == ["the grid was moved by 0.02 m onto whole multiples of its edge"]
    with pytest.raises(navbake.FormatError, match="--align"):
        voxelizer.create((0.03, 0, 1), (5, 5, 5), res=0.1).save(tmp_path / "b.bt")
    with pytest.raises(navbake.FormatError, match="--align"):
        create_voxel_grid(voxelizer, (0.03, 0, 1), 5, 5, 5, of=tmp_path / "b.bt", align=False)


def test_a_grid_may_be_aligned_for_any_file_or_none(voxelizer, tmp_path):
    for of in (None, tmp_path / "a.npz"):
        grid = create_voxel_grid(voxelizer, (0.03, 0, 1.5), 5, 6, 6, 0.1, of, align=True)
        np.testing.assert_allclose(grid.origin, [-0.2, -0.3, 1.2], atol=1e-9)
    left = create_voxel_grid(voxelizer, (0.03, 0, 1.5), res=0.1, size=(0.5, 0.6, 0.6))
    np.testing.assert_allclose(left.origin, [-0.22, -0.3, 1.2], atol=1e-9)
    with pytest.raises(TypeError, match="alined"):
        create_voxel_grid(voxelizer, (0, 0, 0), 4, 4, 4, alined=True)


def test_a_small_grid_is_part_of_a_large_one(voxelizer):
    whole = voxelizer.fill(Placement(np.array([-2.2, -2.2, -0.3]), 0.1, (44, 44, 22)))
    part = voxelizer.fill(Placement(np.array([-1.3, 0.2, 0.4]), 0.1, (20, 17, 9)))
    np.testing.assert_array_equal(part.values, whole.values[9:29, 24:41, 7:16])


def test_touching_does_not_count(tmp_path):
    box = '<geom type="box" size=".1 .1 .1"/>'
    values = scene_of(tmp_path, box).fill(Placement(np.full(3, -0.3), 0.1, (6, 6, 6))).values
    assert values[2:4, 2:4, 2:4].all() and values.sum() == 8


def test_planes_are_half_spaces_and_height_fields_are_solid(tmp_path):
    plane = '<geom type="plane" size="0 0 1"/><geom type="sphere" size=".1" pos="9 9 9"/>'
    values = scene_of(tmp_path, plane).fill(Placement(np.full(3, -0.4), 0.1, (8, 8, 8))).values
    assert values[:, :, :4].all() and not values[:, :, 4:].any()
    (tmp_path / "hills.xml").write_text(
        SCENE.replace(
            '<geom name="floor"', '<geom name="hills" type="hfield" hfield="hills"/><geom'
        )
    )
    hills = Voxelizer(
        {"scene": {"path": str(tmp_path / "hills.xml"), "exclude": {"bodies": ["*"]}}}
    )
    grid = hills.fill(Placement(np.array([-1, -1, -0.1]), 0.1, (20, 20, 12)), segments="geom")
    number = next(n for n, name in grid.names.items() if name == "hills")
    column = grid.values[10, 10]
    assert (column[1:5] == number).all() and column[7] == 0


# ---------------------------------------------------------------- poses


@pytest.mark.parametrize(
    ("pose", "settings"),
    [
        ({"joints": {"pull": 0.7, "turn": 2.0}}, {"joints": {"pull": 0.7, "turn": 2.0}}),
        ({"keyframe": "out"}, {"keyframe": "out"}),
        ({"keyframe": 0, "joints": {"turn": 0.3}}, {"keyframe": 0, "joints": {"turn": 0.3}}),
        ({"qpos": [0.2, -0.5]}, {"joints": {"pull": 0.2, "turn": -0.5}}),
    ],
)
def test_a_new_pose_is_that_of_a_scene_loaded_in_it(path, pose, settings):
    moving = Voxelizer(path)
    moving.set_pose(joints={"pull": -3, "turn": 9})  # from somewhere else
    moving.set_pose(**pose)
    fresh = Voxelizer({"scene": {"path": path, **settings}})
    place = Placement(np.array([-2.2, -2.2, -0.3]), 0.07, (62, 62, 30))
    np.testing.assert_array_equal(
        moving.fill(place, "geom").values, fresh.fill(place, "geom").values
    )


def test_takes_the_data_of_a_running_simulation(path):
    model = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(model)
    data.qpos[:] = 0.4, 1.1
    mujoco.mj_forward(model, data)
    first, second = Voxelizer(path), Voxelizer(path)
    first.set_pose(data=data)
    second.set_pose(qpos=data.qpos)
    a, b = (v.create((0, 0, 0.5), (40, 40, 20), res=0.1).values for v in (first, second))
    np.testing.assert_array_equal(a, b)


def test_bad_poses(path, voxelizer, tmp_path):
    with pytest.raises(ConfigError, match=r"no joint 'pul'.*pull"):
        voxelizer.set_pose(joints={"pul": 1.0})
    with pytest.raises(ConfigError, match="no keyframe 'in'"):
        voxelizer.set_pose(keyframe="in")
    with pytest.raises(ConfigError, match=r"expected 2 joint positions \(nq\), got \(3,\)"):
        voxelizer.set_pose(qpos=[1, 2, 3])
    with pytest.raises(ConfigError, match=r"2 joint positions \(nq\), got 'out'"):
        voxelizer.set_pose(qpos="out")
    with pytest.raises(ConfigError, match="index >= 0, got -1"):
        voxelizer.set_pose(keyframe=-1)
    with pytest.raises(ConfigError, match="joints as positions by name"):
        voxelizer.set_pose(joints=["pull"])
    with pytest.raises(ConfigError, match="MjData of this scene, got int"):
        voxelizer.set_pose(data=3)
    with pytest.raises(ConfigError, match="one of joints"):
        voxelizer.set_pose()
    with pytest.raises(ConfigError, match="one of joints"):
        voxelizer.set_pose(qpos=[1, 2], keyframe=0)
    with pytest.raises(SceneError, match="infinite or NaN coordinates"):
        voxelizer.set_pose(qpos=[np.nan, 0])
    other = scene_of(tmp_path, '<geom type="sphere" size=".1"/>')
    with pytest.raises(ConfigError, match="data of this scene's 7 geoms, got 1"):
        voxelizer.set_pose(data=other.scene.data)


# ---------------------------------------------------------------- what fills it


def names_at(grid, *places):
    return [grid.names.get(int(n), "") for n in grid.at(np.array(places, dtype=float))]


PLACES = ((1, 1, 0.75), (1, 1, 0.55), (1, 1, 0.66), (0, 0, -0.1), (0, 0, 1.5), (0, 0, 0.5))


@pytest.mark.parametrize(
    ("segments", "names"),
    [
        ("geom", ["top", "front", "geom 4", "floor", "lamp", ""]),
        ("body", ["table", "drawer", "drawer", "world", "world", ""]),
        ("top", ["table", "table", "table", "floor", "lamp", ""]),
        (["table", "l*"], ["table", "table", "table", "other", "l*", ""]),
        (["drawer", "t*"], ["t*", "drawer", "drawer", "other", "other", ""]),
    ],
)
def test_segments(voxelizer, segments, names):
    voxelizer.set_pose(qpos=[0, 0])
    grid = voxelizer.create((0, 0, 1), (80, 80, 50), res=0.05, segments=segments)
    assert grid.values.dtype == np.uint8
    assert names_at(grid, *PLACES) == names
    plain = voxelizer.create((0, 0, 1), (80, 80, 50), res=0.05)
    np.testing.assert_array_equal(grid.occupied, plain.values)


def test_ids_of_geoms_are_those_of_a_cameras_segmentation(tmp_path):
    """MuJoCo's geom id and 1, whatever is left out before it."""
    seen = '<geom name="seen" type="box" size=".2 .2 .2" contype="0" conaffinity="0"/>'
    met = '<geom name="met" type="box" size=".2 .2 .2" pos="1 0 0"/>'
    grid = scene_of(tmp_path, seen + met).create((1, 0, 0), (2, 2, 2), res=0.1, segments="geom")
    assert (grid.values == 2).all() and grid.names == {2: "met"}


def test_ids_of_patterns_and_of_what_none_matches(voxelizer):
    grid = voxelizer.create((0, 0, 1), (40, 40, 24), res=0.1, segments={"table": 7, "lamp": 300})
    assert grid.values.dtype == np.uint16
    assert grid.names == {7: "table", 300: "lamp", 301: "other"}
    wide = voxelizer.create((0, 0, 1), (40, 40, 24), res=0.1, segments={"*": 70000, "x": 2})
    assert wide.values.dtype == np.uint32 and set(np.unique(wide.values)) == {0, 70000}
    assert "segments" in wide.notes[0] and "'x'" in wide.notes[0]


def test_where_several_meet_the_least_id_wins_whatever_the_order(tmp_path):
    boxes = '<geom name="a" type="box" size=".3 .3 .3"/><geom name="b" type="sphere" size=".2"/>'
    voxelizer = scene_of(tmp_path, boxes)
    for ids in ({"a": 1, "b": 2}, {"a": 2, "b": 1}):
        grid = voxelizer.create((0, 0, 0), (8, 8, 8), res=0.1, segments=ids)
        assert grid.names[int(grid.at([0.01, 0.01, 0.01]))] == ("a" if ids["a"] == 1 else "b")


def test_more_than_255_geoms_lose_nothing(tmp_path):
    spheres = "".join(
        f'<geom name="s{n}" type="sphere" size=".2" pos="{n % 20} {n // 20} 0"/>'
        for n in range(300)
    )
    voxelizer = scene_of(tmp_path, spheres)
    grid = voxelizer.create((9.5, 7, 0), (20, 15, 1), res=1.0, segments="geom")
    np.testing.assert_array_equal(grid.values[:, :, 0].T.ravel(), np.arange(1, 301))
    grid.save(tmp_path / "a.npz")
    back = navbake.load_voxels(tmp_path / "a.npz")
    np.testing.assert_array_equal(back.values, grid.values)
    assert back.names == grid.names and back.names[300] == "s299"
    with pytest.raises(navbake.FormatError, match="up to 300"):
        grid.save(tmp_path / "a.binvox")


def test_ignores_bodies_with_what_hangs_on_them(path):
    grid = Voxelizer(path, ignore="table").create((0, 0, 1), (40, 40, 24), res=0.1)
    assert not grid.at([1, 1, 0.75]) and not grid.at([1, 1, 0.55]) and grid.at([0, 0, 1.5])


# ---------------------------------------------------------------- size and sameness


def test_the_same_with_any_number_of_threads(voxelizer):
    voxelizer.set_pose(qpos=[0.3, 0.4])
    grids = []
    for count in (1, None):
        with limit_threads(count):
            grid = voxelizer.create((0, 0, 1), (81, 77, 50), res=0.05, segments="geom")
        grids.append(grid.values)
    assert grids[0].tobytes() == grids[1].tobytes()


def test_beyond_2_to_the_24_voxels_there_are_no_holes(tmp_path):
    """Where an index of 32 bits in a float can't tell neighbours apart."""
    voxelizer = scene_of(tmp_path, '<geom type="box" size="1.3 1.3 1.3" euler="0 0 0"/>')
    values = voxelizer.create((0, 0, 0), (260, 260, 260), res=0.01).values
    assert values.size > 2**24 and values.all()
    assert values.itemsize == 1


# ---------------------------------------------------------------- what is wrong


@pytest.mark.parametrize(
    ("arguments", "culprit"),
    [
        ({"cells": (0, 5, 5)}, r"whole numbers >= 1, got \[0, 5, 5\]"),
        ({"cells": (5, -5, 5)}, r"whole numbers >= 1, got \[5, -5, 5\]"),
        ({"cells": (5, 5.5, 5)}, "whole numbers >= 1"),
        ({"cells": (5, 5)}, "3 counts of cells"),
        ({"size": (1, 0, 1)}, r"size > 0 m along each axis, got \[1.0, 0.0, 1.0\]"),
        ({"size": (1, float("inf"), 1)}, "a size x, y, z in metres, got"),
        ({"cells": (5, 5, 5), "size": (1, 1, 1)}, "either counts of cells or a size"),
        ({}, "beside the centre"),
        ({"cells": (5, 5, 5), "res": 0}, "`res`, the edge of a voxel, to be >= 1e-05 m, got 0"),
        ({"cells": (5, 5, 5), "res": -0.1}, "`res`"),
        ({"cells": (5, 5, 5), "res": "wide"}, "`res`.*wide"),
        ({"cells": (5, 5, 5), "position": (1, 2)}, r"the centre to be x, y, z \[m\]"),
        ({"cells": (5, 5, 5), "position": (1, 2, np.nan)}, "the centre"),
        ({"cells": (10**5, 10**5, 10**5)}, "GiB, and .* GiB of memory are free"),
        ({"size": (1e4, 1e4, 1e4), "res": 1e-3}, "GiB of memory are free"),
        ({"size": (1e20, 1, 1), "align": True}, r"1e\+21 × 10 × 10 voxels .*of memory are free"),
        ({"size": (1e308, 1, 1), "res": 1e-5}, "GiB of memory are free"),
        ({"cells": (10**30, 1, 1), "align": True}, r"1e\+30 × 1 × 1 voxels .*memory are free"),
        ({"cells": (10**400, 1, 1)}, "GiB of memory are free"),
        ({"cells": 5}, r"3 counts of cells.*\[5\]"),
        ({"cells": (5, 5, 5), "segments": "geoms"}, "geom, body, top, or name patterns.*'geoms'"),
        ({"cells": (5, 5, 5), "segments": []}, "geom, body, top, or name patterns"),
        ({"cells": (5, 5, 5), "segments": {"a": 0}}, "an ID from 1 to .* 'a', got 0"),
    ],
)
def test_bad_input_says_what_is_wrong(voxelizer, arguments, culprit):
    with pytest.raises(ConfigError, match=culprit) as caught:
        voxelizer.create(**{"position": (0, 0, 0), "res": 0.1, **arguments})
    assert "\n" not in str(caught.value)


def test_more_bad_input(voxelizer, path, tmp_path):
    with pytest.raises(ConfigError, match=r"3 counts of cells.*\[4, 4\]"):
        create_voxel_grid(path, (0, 0, 0), 4, 4)
    with pytest.raises(ConfigError, match="`ignore` where the Voxelizer is made"):
        create_voxel_grid(voxelizer, (0, 0, 0), 4, 4, 4, ignore=["a"])
    endless = scene_of(tmp_path, '<geom type="plane" size="0 0 1"/>')
    with pytest.raises(ConfigError, match="only infinite planes count"):
        endless.create(res=0.1)
    with pytest.raises(navbake.QueryError, match="no voxel at"):
        voxelizer.create((0, 0, 0), (4, 4, 4), res=0.1).at([9, 9, 9])
    with pytest.raises(navbake.FormatError, match=r"shape \(nx, ny, nz\)"):
        navbake.VoxelGrid(values=np.zeros((3, 3), bool), origin=(0, 0, 0), res=1)
    with pytest.raises(navbake.FormatError, match="dtype bool, uint8, uint16, uint32, got int64"):
        navbake.VoxelGrid(values=np.zeros((3, 3, 3), int), origin=(0, 0, 0), res=1)


def test_placing_needs_no_scene():
    place = place_grid((0, 0, 0), (3, 4, 5), None, 0.1, None, align=True)
    np.testing.assert_allclose(place.origin, [-0.2, -0.2, -0.2])
    assert place.shape == (3, 4, 5)
