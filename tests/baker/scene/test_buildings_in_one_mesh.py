"""Buildings in one mesh: hulls that hide room, closed boxes, ground that is missing, Qhull."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from navbake.baker.bake.pipeline import BakeResult, run_bake
from navbake.baker.scene.scene import Scene
from navbake.config.settings import AgentSettings, FloorSettings, SceneSettings, parse_config
from navbake.errors import ConfigError, SceneError
from project_paths import SHARED_DATA
from scenes_alone import load_alone

HARD = SHARED_DATA / "hard_cases"


def box(x0, y0, z0, x1, y1, z1):
    size, middle = (x1 - x0, y1 - y0, z1 - z0), ((x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2)
    return np.array(trimesh.creation.box(size).triangles) + np.array(middle)


def walls(height, side=4.0):
    """Four walls round the origin, 0.2 m thick."""
    out, within = side / 2, side / 2 - 0.2
    return np.concatenate(
        [
            box(-out, -out, 0, out, -within, height),
            box(-out, within, 0, out, out, height),
            box(-out, -within, 0, -within, within, height),
            box(within, -within, 0, out, within, height),
        ]
    )


def save(folder: Path, *pieces, name="house.stl") -> Path:
    corners = np.concatenate(pieces).reshape(-1, 3)
    faces = np.arange(len(corners)).reshape(-1, 3)
    trimesh.Trimesh(corners, faces, process=False).export(folder / name)
    return folder / name


def scene_of(folder: Path, *pieces, geom="", **settings) -> Scene:
    """A scene of one mesh that collides."""
    number = len(list(folder.iterdir()))  # MuJoCo keeps files that it has read by their names
    mesh, path = save(folder, *pieces, name=f"{number}.stl"), folder / "scene.xml"
    path.write_text(
        f'<mujoco><asset><mesh name="m" file="{mesh}" inertia="shell"/></asset><worldbody>'
        f'<geom name="house" type="mesh" mesh="m" {geom}/></worldbody></mujoco>'
    )
    return load_alone(SceneSettings(path=path, **settings))


# ---------------------------------------------------------------- hulls that hide room

SLAB = box(-2, -2, -0.2, 2, 2, 0)
ROOF = box(-2, -2, 2.3, 2, 2, 2.5)
OPEN_ROCK = np.array(trimesh.creation.icosphere(2, 3.0).triangles)
OPEN_ROCK = OPEN_ROCK[OPEN_ROCK[:, :, 2].min(axis=1) > -1.0]  # no bottom

HIDING = {
    "walls alone": (walls(2.5),),
    "walls on a slab": (walls(2.5), SLAB),
    "a house": (walls(2.3), SLAB, ROOF),
    "a roof on a post": (ROOF, box(-0.1, -0.1, 0, 0.1, 0.1, 2.3)),
    "a valley": (box(-2, -2, -0.2, 2, 2, 0), box(-2, -2, 0, -1.5, 2, 2), box(1.5, -2, 0, 2, 2, 2)),
}
FULL = {
    "a block": (box(-2, -2, 0, 2, 2, 2.5),),
    "low walls": (walls(1.1), SLAB[:0]),
    "a cupboard": (walls(2.0, side=1.2), box(-0.6, -0.6, -0.2, 0.6, 0.6, 0)),
    "a rock without a bottom": (OPEN_ROCK,),
}


@pytest.mark.parametrize("name", HIDING)
def test_mesh_whose_hull_hides_room_counts_by_its_triangles(tmp_path, name):
    scene = scene_of(tmp_path, *HIDING[name])
    assert scene.geoms[0].shape in ("surface", "closed surface")
    (warning,) = scene.warnings
    assert "'house' counts by its triangles" in warning and "MuJoCo collides the hull" in warning


@pytest.mark.parametrize("name", FULL)
def test_other_meshes_count_as_mujoco_collides_them(tmp_path, name):
    scene = scene_of(tmp_path, *FULL[name])
    assert scene.geoms[0].shape == "hull" and not scene.warnings


def test_it_turns_on_the_pose_and_on_what_is_asked(tmp_path):
    house = (walls(2.3), SLAB, ROOF)
    assert scene_of(tmp_path, *house, meshes="hull").geoms[0].shape == "hull"
    assert not scene_of(tmp_path, *house, meshes="surface").warnings
    assert not scene_of(tmp_path, *house, geom='contype="0" conaffinity="0"').warnings
    path = tmp_path / "scene.xml"
    assert scene_of(tmp_path, walls(1.5)).geoms[0].shape == "closed surface"
    tall, picky = AgentSettings(height=1.6), FloorSettings(min_area=10.0)
    assert load_alone(SceneSettings(path=path), tall).geoms[0].shape == "hull"
    assert load_alone(SceneSettings(path=path), floors=picky).geoms[0].shape == "hull"
    # standing on its side, the ring is a tunnel
    ring = (walls(1.1),)
    assert scene_of(tmp_path, *ring).geoms[0].shape == "hull"
    assert scene_of(tmp_path, *ring, geom='euler="90 0 0"').geoms[0].shape == "closed surface"


# ---------------------------------------------------------------- shells


def bake(path: Path, **scene) -> BakeResult:
    return run_bake(parse_config({"scene": {"path": str(path), "geoms": "all", **scene}}))


def test_storeys_drawn_as_closed_boxes(tmp_path):
    """A warning names the storey that is lost inside; as a shell it can be walked on."""
    path = save(tmp_path, box(-4, -4, 0, 4, 4, 3), box(-4, -4, 3, 4, 4, 6), name="house.stl")
    solid = bake(path)
    assert [level.min_yup[1] for level in solid.grid.levels] == [6.0]
    (warning,) = solid.warnings
    assert "inside of a closed mesh: 'house' (64.0 m² at 3.00 m)" in warning
    assert "`scene.meshes: shell`" in warning
    hollow = bake(path, meshes={"house": "shell"})
    assert hollow.geoms[0].shape == "shell" and not hollow.warnings
    (level,) = hollow.grid.levels  # what lies over it is a roof now
    assert level.min_yup[1] == 3.0 and level.free.sum() * 0.01 > 60


def test_things_that_stand_on_a_floor_are_no_lost_storeys(tmp_path):
    sheet = np.array([[[-5, -5, 0], [5, -5, 0], [5, 5, 0]], [[-5, -5, 0], [5, 5, 0], [-5, 5, 0.0]]])
    for bottom in (0.0, -0.1):  # on it, and stuck in it
        crate = box(-1.5, -1.5, bottom, 1.5, 1.5, 2.5)
        result = bake(save(tmp_path, sheet, crate))
        assert not any("inside of" in warning for warning in result.warnings)
        (level,) = result.grid.levels  # its top is furniture
        assert level.free.sum() == 10_000 - 900
    (warning,) = (w for w in bake(save(tmp_path, sheet * 4, crate * 4)).warnings if "inside" in w)
    assert "(144.0 m² at 0.00 m)" in warning  # as large as a building


# ---------------------------------------------------------------- ground


def test_ground_under_a_mesh(tmp_path):
    path = save(tmp_path, walls(2.5), name="house.obj")
    grid = bake(path, ground=0.0).grid
    (level,) = grid.levels
    assert level.min_yup[1] == 0.0
    assert level.free.sum() == 36 * 36
    assert np.nanmax(level.floor_height[level.free]) == 0.0
    report = load_alone(SceneSettings(path=path, ground=-1.5)).geoms[-1]
    assert (report.name, report.type, report.shape) == ("ground", "plane", "half-space")
    assert report.counted and report.reason == "added by `scene.ground`"


def test_ground_in_mjcf_keeps_ids_and_what_auto_takes(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(
        '<mujoco><default><geom contype="0"/></default><worldbody><body name="ground">'
        '<geom name="ground" size="1"/><freejoint/></body><geom name="b" size="1"/>'
        "</worldbody></mujoco>"
    )
    plain, with_ground = (load_alone(SceneSettings(path=path, ground=z)) for z in (None, 0.25))
    names = [geom.name for geom in plain.geoms]
    assert [geom.name for geom in with_ground.geoms] == [*names, "ground#2"]
    assert [geom.reason for geom in with_ground.geoms[:-1]] == [g.reason for g in plain.geoms]
    assert with_ground.shapes.planes.pos.tolist() == [[0.0, 0.0, 0.25]]
    assert plain.digest != with_ground.digest
    np.testing.assert_array_equal(plain.bounds, with_ground.bounds)
    with pytest.raises(SceneError, match="none of the 2 geoms"):
        load_alone(SceneSettings(path=path, ground=0.0, exclude={"geoms": ["*"]}))
    mujoco.mj_saveModel(plain.model, str(tmp_path / "scene.mjb"))
    with pytest.raises(ConfigError, match=r"`scene.ground` can't be added to an MJB"):
        load_alone(SceneSettings(path=tmp_path / "scene.mjb", ground=0.0))


# ---------------------------------------------------------------- hard cases


@pytest.mark.skipif(not HARD.is_dir(), reason=f"no hard cases in {HARD}")
def test_hard_cases_of_one_mesh():
    crate = bake(HARD / "3_crate_one_mesh.obj", geoms="auto").grid
    (level,) = crate.levels
    assert level.free.sum() * 0.01 == pytest.approx(91, abs=0.7)
    house = bake(HARD / "8_building_hull.xml", geoms="auto")
    assert house.geoms[0].shape == "closed surface"
    assert house.grid.levels[0].min_yup[1] == pytest.approx(0, abs=1e-6)
    assert "MuJoCo collides the hull" in house.warnings[0]
    (level,) = bake(HARD / "9_stray_triangle.stl", meshes="surface").grid.levels
    blocked = np.argwhere(~level.free)
    assert len(blocked) > 395 and level.free.sum() * 0.01 == pytest.approx(96, abs=0.1)
    thick = bake(HARD / "1b_thick_wall_one_mesh.obj").grid.levels[0]
    assert (~thick.free).any(axis=0).nonzero()[0].tolist() == [19, 20]
