"""A scene in memory bakes into what its file bakes into; what is wrong with one is said."""

from __future__ import annotations

import importlib.util
import warnings as python_warnings
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
import yaml

import navbake
from box_worlds import FLOOR, body, box, world
from navbake.baker.bake.stages import bake_stages
from navbake.config.settings import load_config
from navbake.errors import ConfigError, NavbakeError, QueryError
from navbake.formats.navgrid import dumps_navgrid
from navbake.testing import assert_true
from project_paths import CONFIGS

SAMPLES = sorted(path.stem for path in CONFIGS.glob("*.yaml"))
WALLS = box("wall", -2, 1.9, 0, 2, 2, 2.5)
CHAIR = body("chair", box("seat", -0.2, -0.2, 0, 0.2, 0.2, 0.9), 'pos="-1 -1 0"')
ARM = body("arm", box("link", -0.3, -0.3, 0.3, 0.3, 0.3, 0.9), 'pos="0.5 0 0"')
BASE = body("base", f"<freejoint/>{box('trunk', -0.2, -0.2, 0, 0.2, 0.2, 0.3)}{ARM}")
NAMELESS = body("", box("post", -0.1, -0.1, 0, 0.1, 0.1, 1), 'pos="1.5 -1.5 0"')
HINGE = '<joint name="turn" type="hinge" axis="0 0 1"/>'
LEAF = body("leaf", HINGE + box("wing", 0, -0.02, 0.3, 0.8, 0.02, 1.2), 'pos="-1.5 0.8 0"')
SCENE = world(FLOOR + WALLS + CHAIR + BASE + NAMELESS + LEAF)
COARSE = {"cell_size": 0.2}

pytestmark = pytest.mark.filterwarnings("ignore::navbake.BakeWarning")


def bytes_of(*args, **settings) -> bytes:
    """The file of a bake, without its timings."""
    grid = navbake.bake(*args, **settings)
    grid.timings = {}
    return dumps_navgrid(grid)


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "room.xml"
    path.write_text(SCENE, encoding="utf-8")
    return path


@pytest.fixture
def model():
    return mujoco.MjModel.from_xml_string(SCENE)


@pytest.fixture
def spec():
    return mujoco.MjSpec.from_string(SCENE)


# ---------------------------------------------------------------- the same as the file's


def as_mesh(path: Path) -> trimesh.Scene:
    """A mesh file as navbake has trimesh read it."""
    options = {"split_objects": True, "split_groups": True, "group_material": False}
    more = options if path.suffix == ".obj" else {}
    return trimesh.load_scene(path, process=False, skip_materials=True, **more)


@pytest.mark.parametrize("name", SAMPLES)
def test_samples_bake_from_memory_as_from_their_files(name):
    settings = yaml.safe_load((CONFIGS / f"{name}.yaml").read_text(encoding="utf-8"))
    path = load_config(CONFIGS / f"{name}.yaml").scene.path
    expected = bytes_of(CONFIGS / f"{name}.yaml")
    if path.suffix == ".xml":
        assert bytes_of(mujoco.MjModel.from_xml_path(str(path)), **settings) == expected
        assert bytes_of(mujoco.MjSpec.from_file(str(path)), **settings) == expected
    else:
        assert bytes_of(as_mesh(path), **settings) == expected


def scenes_in(package: str, folder: str) -> Iterator[tuple[Path, mujoco.MjModel]]:
    """The MJCF files of a package that compile by themselves, and their models."""
    found = importlib.util.find_spec(package)
    if found is None or found.origin is None:
        pytest.skip(f"{package} is not installed")
    for path in sorted((Path(found.origin).parent / folder).rglob("*.xml")):
        try:
            model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError:  # a part of a scene, or one for another MuJoCo
            continue
        if model.ngeom:
            yield path, model


def bake_or_error(*args, **settings) -> tuple[bytes | str, list[str]]:
    """The file of a bake without its timings, or the error's text; and the bake's warnings."""
    try:
        grid = navbake.bake(*args, **settings)
    except NavbakeError as error:
        return str(error), []
    grid.timings = {}
    return dumps_navgrid(grid), grid.warnings


@pytest.mark.parametrize(
    ("package", "folder", "least"),
    [("gymnasium_robotics", "envs", 25), ("dm_control", "suite", 15)],
)
def test_scenes_of_others_bake_from_memory_as_from_their_files(package, folder, least, capsys):
    """Robots among tables, kitchens, mazes; whether there is a floor for an agent or not.

    What MuJoCo warns of as it compiles a file, it does not say of a model that is compiled.
    """
    settings = {
        "agent": {"height": 0.3, "radius": 0.02, "traversable_floor_height": 0.03},
        "grid": {"cell_size": 0.25, "margin": 0.5, "max_cells": 20_000},
        "floors": {"min_area": 0.05, "shrink": 0.0},
    }
    num_scenes = num_grids = 0
    for path, model in scenes_in(package, folder):
        expected, warnings = bake_or_error(path, **settings)
        if not any(warning.startswith("MuJoCo: ") for warning in warnings):
            found, _ = bake_or_error(model, scene={"path": path}, **settings)
            assert found == expected, path
            num_scenes, num_grids = num_scenes + 1, num_grids + isinstance(found, bytes)
    with capsys.disabled():
        print(f" {package}: {num_scenes} scenes the same, {num_grids} of them grids ", end="")
    assert num_scenes >= least


def table_scene(rng: np.random.Generator) -> str:
    """A table in a room with things on it that can be moved, as LIBERO's tasks have them."""
    wide, deep, top = rng.uniform([0.5, 0.4, 0.4], [1.2, 0.8, 0.95])
    table = box("table_top", -wide, -deep, top - 0.05, wide, deep, top)
    for number, (x, y) in enumerate(((-1, -1), (-1, 1), (1, -1), (1, 1))):
        x, y = x * (wide - 0.06), y * (deep - 0.06)
        table += box(f"leg {number}", x - 0.03, y - 0.03, 0, x + 0.03, y + 0.03, top - 0.05)
    look = 'contype="0" conaffinity="0" group="1"'
    wall = f'<geom name="wall_visual" type="box" size="2 0.01 1.5" pos="0 2 1.5" {look}/>'
    things = ""
    for number in range(4):
        x, y = rng.uniform([-wide, -deep], [wide, deep])
        kind = rng.choice(["box", "cylinder", "sphere"])
        geom = f'<geom type="{kind}" size="0.05 0.05 0.05"/>'
        things += body(f"thing_{number}", f"<freejoint/>{geom}", f'pos="{x} {y} {top + 0.06}"')
    mount = body("mount", box("", -0.2, -0.2, 0, 0.2, 0.2, 0.9), f'pos="{-wide - 0.4} 0 0"')
    floor = '<geom name="floor" type="plane" size="3 3 0.1"/>'
    return world(floor + wall + body("table", table) + things + mount)


@pytest.mark.parametrize("seed", range(5))
def test_tables_bake_from_memory_as_from_their_files(seed, tmp_path):
    path = tmp_path / "table.xml"
    path.write_text(table_scene(np.random.default_rng(seed)), encoding="utf-8")
    grid = {"cell_size": 0.1, "margin": 1.0}  # the floor, a plane, is endless
    expected = bytes_of(path, robot="mount", grid=grid)
    settings = {"scene": {"path": path}, "grid": grid}
    model = mujoco.MjModel.from_xml_path(str(path))
    assert bytes_of(model, robot=model.body("mount"), **settings) == expected
    spec = mujoco.MjSpec.from_file(str(path))
    assert bytes_of(spec, robot=spec.body("mount"), **settings) == expected


@pytest.mark.parametrize("suffix", ["glb", "obj", "stl", "ply"])
def test_mesh_bakes_from_memory_as_from_its_file(suffix, tmp_path):
    rooms = room_of_meshes()
    path = tmp_path / f"room.{suffix}"
    (rooms if suffix in ("glb", "obj") else rooms.to_geometry()).export(path)
    settings = {"scene": {"up": "z"}, "grid": COARSE}
    expected = bytes_of(path, **settings)
    settings["scene"] = {"up": "z", "path": path}
    assert bytes_of(as_mesh(path), **settings) == expected


def room_of_meshes(y_up: bool = False) -> trimesh.Scene:
    scene = trimesh.Scene()
    for name, size, place in (
        ("floor", (6, 4, 0.1), (0, 0, -0.05)),
        ("wall", (0.1, 4, 2.5), (3, 0, 1.25)),
        ("table", (1, 1, 0.7), (0, 0, 0.35)),
    ):
        mesh = trimesh.creation.box(size)
        mesh.apply_translation(place)
        if y_up:
            mesh.vertices = mesh.vertices[:, [0, 2, 1]] * [1, 1, -1]
            assert mesh.volume > 0
        scene.add_geometry(mesh, node_name=name, geom_name=f"{name} mesh")
    return scene


def test_only_what_names_the_file_differs_without_its_name(path, model):
    grid, kept = navbake.bake(model, grid=COARSE), navbake.bake(path, grid=COARSE)
    assert (grid.scene_id, kept.scene_id) == ("scene", "room")
    assert "path" not in grid.navbake["settings"]["scene"]
    same = navbake.bake(model, scene={"id": "room"}, grid=COARSE)
    same.navbake["settings"]["scene"]["path"] = "room.xml"
    same.timings, kept.timings = {}, {}
    assert dumps_navgrid(same) == dumps_navgrid(kept)


def test_id_is_the_name_of_the_model():
    for model_name, scene_id in (("my flat", "my flat"), ("a/b", "a_b"), ("..", "scene")):
        xml = SCENE.replace("<mujoco>", f'<mujoco model="{model_name}">')
        spec = mujoco.MjSpec.from_string(xml)
        for scene in (spec, spec.compile()):
            assert navbake.bake(scene, grid=COARSE).scene_id == scene_id


def test_mesh_scene_has_the_names_of_its_nodes():
    scene = room_of_meshes()
    grid = navbake.bake(scene)
    assert grid.blockers((0.0, 0.0)) == ["table"]
    assert_true(grid, scene, sample=200)
    joined = scene.to_geometry()
    bare = navbake.bake(trimesh.Trimesh(joined.vertices, joined.faces), exclude={"movable": True})
    assert bare.blockers((0.0, 0.0)) == [bare.scene_id] == ["scene"]
    assert (bare.occupancy == grid.occupancy).all()
    assert navbake.bake(scene, robot="table").blockers((0.0, 0.0)) == []


def test_mesh_scene_lies_as_the_settings_say():
    upright, lying = room_of_meshes(), room_of_meshes(y_up=True)
    grid = navbake.bake(upright)
    turned = navbake.bake(lying, scene={"up": "y"})
    assert (turned.occupancy == grid.occupancy).all()
    half = room_of_meshes().apply_scale(100)
    assert (navbake.bake(half, scene={"unit": 0.01}).occupancy == grid.occupancy).all()


def test_nothing_that_is_given_changes(model, spec):
    data = mujoco.MjData(model)
    data.qpos[0] = 0.25
    before = data.qpos.copy(), data.geom_xpos.copy(), spec.to_xml()
    mesh = room_of_meshes()
    vertices = {name: geometry.vertices.copy() for name, geometry in mesh.geometry.items()}
    navbake.bake(model, data, grid=COARSE)
    navbake.bake(spec, scene={"ground": -1.0}, grid=COARSE)
    navbake.bake(mesh, scene={"unit": 2.0, "up": "z"}, grid=COARSE)
    assert (data.qpos == before[0]).all() and (data.geom_xpos == before[1]).all()
    assert spec.to_xml() == before[2]
    assert all((mesh.geometry[name].vertices == vertices[name]).all() for name in vertices)


# ---------------------------------------------------------------- poses


def test_what_mujoco_warns_of_a_spec_is_kept(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(
        '<mujoco><compiler settotalmass="3"/><worldbody><geom type="box" size="2 2 .1"/>'
        '<body pos="0 0 2"><freejoint/><geom size=".2"/></body></worldbody></mujoco>'
    )
    expected = bytes_of(path)
    with python_warnings.catch_warnings():
        python_warnings.simplefilter("error", UserWarning)  # it is a BakeWarning, and no other
        python_warnings.simplefilter("ignore", navbake.BakeWarning)
        assert bytes_of(mujoco.MjSpec.from_file(str(path)), scene={"path": str(path)}) == expected


def test_pose_of_a_data_is_that_of_the_joints(path, model):
    data = mujoco.MjData(model)
    data.joint("turn").qpos[:] = 1.0  # nothing is placed anew: `geom_xpos` is that of another pose
    posed = navbake.bake(model, data, grid=COARSE)
    by_joint = navbake.bake(path, scene={"joints": {"turn": 1.0}}, grid=COARSE)
    assert posed.navbake["sceneDigest"] == by_joint.navbake["sceneDigest"]
    assert (posed.occupancy == by_joint.occupancy).all()
    assert (posed.occupancy != navbake.bake(model, grid=COARSE).occupancy).any()


def test_mocap_bodies_stand_where_the_data_has_them():
    crate = body("crate", box("", -0.3, -0.3, 0, 0.3, 0.3, 1), 'mocap="true"')
    model = mujoco.MjModel.from_xml_string(world(FLOOR + crate))
    data = mujoco.MjData(model)
    data.mocap_pos[0] = 1, 1, 0
    grid = navbake.bake(model, data, grid=COARSE)
    assert grid.at((0.1, 0.1)).free and not grid.at((1.1, 1.1)).free


def test_grid_is_verified_by_the_model_in_its_pose(path, model):
    data = mujoco.MjData(model)
    data.joint("turn").qpos[:] = 1.0
    grid = navbake.bake(model, data, exclude={"bodies": ["base"]}, grid=COARSE)
    assert_true(grid, model, data=data)
    with pytest.raises(QueryError, match=r"<scene> isn't the scene .* another pose"):
        navbake.verify(grid, model)
    assert_true(navbake.bake(path, grid=COARSE), model)
    posed = navbake.bake(path, scene={"joints": {"turn": 1.0}}, grid=COARSE)
    assert_true(posed, model)  # the grid states the pose
    assert_true(posed, model, data=data)
    with pytest.raises(ConfigError, match="give the model, too"):
        navbake.verify(grid, path, data=data)


# ---------------------------------------------------------------- what is left out


def test_bodies_are_left_out_by_name_id_pattern_and_view(path, model, spec):
    expected = bytes_of(path, scene={"exclude": {"bodies": ["base"]}}, grid=COARSE)
    number = model.body("base").id
    settings = {"scene": {"path": path}, "grid": COARSE}
    for base in ("base", number, np.int64(number), model.body("base")):
        assert bytes_of(model, robot=base, **settings) == expected
        assert bytes_of(model, robot=[base], **settings) == expected
        assert bytes_of(model, exclude={"bodies": [base]}, **settings) == expected
        assert bytes_of(path, robot=base, grid=COARSE) == expected
    assert bytes_of(spec, robot=spec.body("base"), **settings) == expected
    pattern = bytes_of(path, scene={"exclude": {"bodies": ["b*"]}}, grid=COARSE)
    assert bytes_of(model, exclude={"bodies": "b*"}, **settings) == pattern
    grid = navbake.bake(model, robot="base", grid=COARSE)
    assert grid.at((0.5, 0.1)).free  # the arm went with its base
    assert not grid.at((-1.0, -1.0)).free
    both = navbake.bake(model, robot="base", exclude={"bodies": ["chair"]}, grid=COARSE)
    assert both.at((0.5, 0.1)).free and both.at((-1.0, -1.0)).free


def test_geoms_and_bodies_without_a_name_are_left_out_by_id(model):
    post = model.geom("post")
    place = 1.5, -1.5
    assert not navbake.bake(model, grid=COARSE).at(place).free
    by_body = navbake.bake(model, exclude={"bodies": [int(post.bodyid[0])]}, grid=COARSE)
    by_geom = navbake.bake(model, exclude={"geoms": [post.id]}, grid=COARSE)
    assert by_body.at(place).free and by_geom.at(place).free


def test_names_with_wildcards_in_them_mean_themselves():
    crates = "".join(
        body(name, box("", x - 0.2, -0.2, 0, x + 0.2, 0.2, 1))
        for name, x in (("a[1]", -1), ("a1", 1))
    )
    model = mujoco.MjModel.from_xml_string(world(FLOOR + crates))
    for given in ("a[1]", 1):
        grid = navbake.bake(model, robot=given)
        assert grid.at((-1.0, 0.0)).free and not grid.at((1.0, 0.0)).free


def test_pattern_that_matches_nothing_is_warned_of(model):
    with pytest.warns(navbake.BakeWarning, match=r"'sofa\*' matches nothing"):
        navbake.bake(model, exclude={"bodies": ["sofa*"]}, grid=COARSE)


# ---------------------------------------------------------------- other ways in


def test_stages_and_voxels_take_models(path, model):
    data = mujoco.MjData(model)
    data.joint("turn").qpos[:] = 1.0
    assert bake_stages(model, data, grid=COARSE).lattice == bake_stages(path, grid=COARSE).lattice
    place = {"position": (0, 0, 0.5), "cells": (20, 20, 10), "res": 0.1}
    posed = navbake.Voxelizer(path, scene={"joints": {"turn": 1.0}})
    for one, same in (
        (navbake.Voxelizer(model, data), posed),
        (navbake.Voxelizer(model, robot="base"), navbake.Voxelizer(path, ignore="base")),
    ):
        assert (one.create(**place).values == same.create(**place).values).all()
    values = navbake.create_voxel_grid(room_of_meshes(), (0, 0, 0.3), 3, 3, 3, 0.2).values
    assert values.all()
    with pytest.raises(ConfigError, match="expected `robot` where the scene is loaded"):
        navbake.Voxelizer(navbake.Voxelizer(model).scene, robot="base")


# ---------------------------------------------------------------- what is wrong


EMPTY = mujoco.MjModel.from_xml_string("<mujoco/>")
NO_SCENE = r"expected a scene \(mujoco.MjModel or MjSpec, trimesh.Scene or Trimesh\)"


def broken_spec():
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(name="g", type=mujoco.mjtGeom.mjGEOM_MESH, meshname="sofa")
    return spec


def with_nan(model):
    data = mujoco.MjData(model)
    data.qpos[:] = np.nan
    return data


@pytest.mark.parametrize(
    ("args", "settings", "message"),
    [
        (lambda m: (EMPTY,), {}, "<scene> has no geoms: nothing to bake"),
        (lambda m: (broken_spec(),), {}, "MuJoCo cannot load <scene>: mesh 'sofa' not found"),
        (lambda m: (trimesh.Scene(),), {}, "no triangles in <scene>"),
        (lambda m: (m, mujoco.MjData(EMPTY)), {}, "data is of another model than <scene>"),
        (lambda m: (m, m), {}, "expected a mujoco.MjData of <scene>, got MjModel"),
        (
            lambda m: (m, with_nan(m)),
            {},
            "has a pose or size that is no number, or beyond 1e.100 m, in <scene>",
        ),
        (lambda m: (mujoco.MjData(m),), {}, f"{NO_SCENE}.* got MjData: give its model first"),
        (lambda m: (42,), {}, f"{NO_SCENE}.* got int"),
        (lambda m: (None,), {}, f"{NO_SCENE}.* got NoneType"),
        (lambda m: ("a.xml", mujoco.MjData(m)), {}, "give the model, too"),
        (lambda m: (m,), {"agnt": {}}, "unknown key `agnt`, the nearest known one is `agent`"),
        (lambda m: (m,), {"radius": 0.2}, "write `agent=.*in place of `radius`"),
        (lambda m: (m,), {"agent": {"radus": 1}}, "unknown key `agent.radus`.* `agent.radius`"),
        (lambda m: (m,), {"agent": 0.2}, "expected a mapping, got 0.2 at `agent` in the keywords"),
        (lambda m: (m,), {"robot": "bse"}, "no body 'bse' for `robot`: did you mean 'base'"),
        (lambda m: (m,), {"robot": "b*"}, r"no body 'b\*' for `robot`"),
        (lambda m: (m,), {"robot": 99}, "the name or id of a body in `robot`, 1 to 5, got 99"),
        (lambda m: (m,), {"robot": 0}, "1 to 5, got 0"),
        (lambda m: (m,), {"robot": True}, "expected the name or id of a body in `robot`"),
        (lambda m: (m,), {"robot": {"radius": 0.2}}, "expected the name or id of a body"),
        (lambda m: (m,), {"exclude": {"bodies": "chairs"}}, "did you mean 'chair'"),
        (lambda m: (m,), {"exclude": {"geoms": ["seet"]}}, "no geom 'seet'.*did you mean 'seat'"),
        (
            lambda m: (m,),
            {"exclude": {"body": "base"}},
            "unknown key `body`, the nearest known one is `bodies`, in `exclude`",
        ),
        (lambda m: (m,), {"exclude": ["base"]}, "expected `exclude` as .* got list"),
        (
            lambda m: (m,),
            {"exclude": {"movable": "yes"}},
            'true or false, got "yes" at `movable` in `exclude`',
        ),
        (lambda m: (m, mujoco.MjData(m)), {"scene": {"keyframe": 0}}, "by a data, got both"),
        (lambda m: (m,), {"scene": {"ground": 0.0}}, "`scene.ground` can't be added to <scene>"),
        (lambda m: (m,), {"isolate": True}, "`isolate` is for scene files"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(args, settings, message, model):
    with pytest.raises(NavbakeError, match=message) as caught:
        navbake.bake(*args(model), **settings)
    assert "\n" not in str(caught.value)


def test_data_of_a_model_with_other_joints_is_refused():
    slide, hinge = (
        mujoco.MjModel.from_xml_string(
            world(FLOOR + body("door", f'<joint type="{kind}"/>{box("", 0, 0, 0, 1, 0.1, 1)}'))
        )
        for kind in ("slide", "hinge")
    )
    with pytest.raises(ConfigError, match="its joints differ"):
        navbake.bake(slide, mujoco.MjData(hinge))


def test_things_that_hold_a_model_are_told_apart(model):
    class Physics:
        """As dm_control's and gymnasium's environments have it."""

    physics = Physics()
    physics.model = Physics()
    physics.model.ptr = model
    with pytest.raises(ConfigError, match="got Physics: give its `model`"):
        navbake.bake(physics)
    with pytest.raises(ConfigError, match="got Physics: give its `ptr`"):
        navbake.bake(physics.model)


def test_ground_is_advised_as_the_caller_gives_it():
    walls = "".join(box("", x - 0.1, -3, 0, x + 0.1, 3, 2) for x in (-3, 3))
    spec = mujoco.MjSpec.from_string(world(walls))
    with pytest.raises(navbake.SceneError) as caught:
        navbake.bake(spec)
    assert 'its ground, `scene={"ground": 0}` adds it to an MjSpec' in str(caught.value)
    assert navbake.bake(spec, scene={"ground": 0}).free.any()
    block = '<geom type="box" size=".4 .4 1" pos="0 0 1"/><geom type="plane" size="0 0 1"/>'
    spec = mujoco.MjSpec.from_string(world(block))
    with pytest.raises(navbake.SceneError) as caught:
        navbake.bake(spec)
    assert '`grid={"margin": 5}` takes in more of it' in str(caught.value)
    mesh = trimesh.util.concatenate(
        [trimesh.creation.box((0.2, 6, 2), np.eye(4) + np.eye(4, k=3) * x) for x in (-3, 3)]
    )
    with pytest.raises(navbake.SceneError) as caught:  # its axes or unit are wrong more often
        navbake.bake(mesh, scene={"up": "z"})
    assert "ground" not in str(caught.value) and "`scene.up`" in str(caught.value)
