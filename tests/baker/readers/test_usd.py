"""Scenes in USD: whatever its units, axes and arcs, a stage bakes as what it shows."""

from __future__ import annotations

import json
import re
import sys
import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import navbake
from navbake.baker.geometry.shapes import triangulate
from navbake.baker.readers import parsed_scene
from navbake.baker.readers.parsed_scene import MAX_UNMERGED_GEOMS
from navbake.baker.scene.model import CompileLimits
from navbake.baker.scene.scene import Scene
from navbake.config.settings import SceneSettings
from navbake.errors import ConfigError, MissingDependencyError, SceneError
from scenes_alone import load_alone

pytest.importorskip("pxr", reason="usd-core is not installed")

from pxr import Gf, Usd, UsdGeom, UsdPhysics, Vt

from scene_files import leads_through
from usd_scenes import (
    FORMS,
    RAMP,
    RAMP_FACES,
    ROOM,
    add_mesh,
    new_stage,
    path_of,
    place,
    write_model,
    write_room,
)

SCENES = Path(__file__).parents[3] / "configs" / "scenes"
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
CUBE_FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def load(path: Path, **settings: Any) -> Scene:
    return load_alone(SceneSettings(path=path, id="room", **settings))


def bake_bytes(path: Path) -> str:
    """The grid as it is saved, less what says from which file, and names."""
    grid = navbake.bake({"scene": {"path": str(path), "id": "room"}, "names": False})
    grid.save(path.parent / "room.grid.json")
    saved = json.loads((path.parent / "room.grid.json").read_text())
    del saved["timings"], saved["metadata"]["navbake"]["settings"]["scene"]
    if path.suffix == ".usda" and "Proto" in path.read_text():
        del saved["metadata"]["navbake"]["sceneDigest"]  # whose geoms have other names
    return json.dumps(saved)


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> tuple[str, str]:
    """The digest of the room, and its grid."""
    path = write_room(tmp_path_factory.mktemp("room"), 1.0, "Z", "plain")
    return load(path).digest, bake_bytes(path)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("up", ["Y", "Z"])
@pytest.mark.parametrize("unit", [1.0, 0.01, 0.001])
def test_room_is_one_grid(tmp_path, room, unit, up, form):
    path = write_room(tmp_path, unit, up, form)
    found, (digest, expected) = bake_bytes(path), room
    if form == "point-instanced":
        plain = json.loads(expected)
        del plain["metadata"]["navbake"]["sceneDigest"]
        expected = json.dumps(plain)
    else:
        assert load(path).digest == digest
    assert found == expected


@pytest.mark.parametrize("suffix", [".usd", ".usdc", ".usdz"])
def test_room_in_other_files(tmp_path, room, suffix):
    assert load(write_room(tmp_path, 0.01, "Y", "plain", suffix)).digest == room[0]


def test_a_stage_bakes_as_the_mjcf_of_the_same_boxes(tmp_path, room):
    """The oracle is written from the room's table, without a reader of USD."""
    spec = mujoco.MjSpec()
    for name, (center, size) in ROOM.items():
        body = spec.worldbody.add_body(name=f"/World/Room/{name}")
        half = [side / 2 for side in size]
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=center, size=half)
    ramp = spec.worldbody.add_body(name="/World/Room/Ramp")
    fans = [(face[0], *face[k : k + 2]) for face in RAMP_FACES for k in range(1, len(face) - 1)]
    mesh = spec.add_mesh(name="ramp", uservert=np.ravel(RAMP), userface=np.ravel(fans))
    ramp.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name)
    stage = navbake.bake(write_room(tmp_path, 0.001, "Y", "plain"))
    compare(stage, navbake.bake(spec))


def compare(one: Any, other: Any, heights: float = 1e-6) -> None:
    """Grids are equal, floors to a micrometre, and so are rooms and doors."""
    assert len(one.levels) == len(other.levels)
    for a, b in zip(one.levels, other.levels, strict=True):
        assert np.array_equal(a.occupancy, b.occupancy)
        assert np.array_equal(a.room_index, b.room_index)
        assert np.array_equal(a.weights, b.weights)
        assert np.allclose(a.floor_height, b.floor_height, rtol=0, atol=heights, equal_nan=True)
    found, expected = (
        {path_of(door["id"].lstrip("/")): (door["cells"], door["state"]) for door in doors}
        for doors in (grid.metadata["navbake"]["doors"] for grid in (one, other))
    )
    assert found == expected


@pytest.mark.parametrize("name", ["house", "apartment", "warehouse"])
@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_samples(tmp_path, name):
    spec = mujoco.MjSpec.from_file(str(SCENES / f"{name}.xml"))
    stage = write_model(spec.compile(), tmp_path / f"{name}.usdc")
    # names differ, so that geoms would mark rooms in the MJCF only
    settings = {"rooms": "auto"}
    for state in ("modelled", "closed"):
        grids = [
            navbake.bake({"scene": {"path": str(path)}, "doors": {"state": state}, **settings})
            for path in (stage, SCENES / f"{name}.xml")
        ]
        compare(*grids)


def test_isolated(tmp_path, room):
    settings = SceneSettings(path=write_room(tmp_path, 1.0, "Z", "plain"), id="room")
    assert load_alone(settings, limits=CompileLimits()).digest == room[0]


def names(scene: Scene, counted: bool = True) -> set[str]:
    return {geom.name for geom in scene.geoms if geom.counted == counted}


def test_visibility_purpose_and_collision(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    for name in ("Drawn", "Hidden", "Guide", "Proxy", "Ground"):
        prim = UsdGeom.Cube.Define(stage, f"/World/{name}/Cube")
        above = UsdGeom.Imageable(stage.GetPrimAtPath(f"/World/{name}"))
        UsdGeom.Xform.Define(stage, f"/World/{name}")
        if name == "Hidden":
            above.MakeInvisible()
        elif name in ("Guide", "Proxy", "Ground"):
            above.CreatePurposeAttr("guide" if name == "Ground" else name.lower())
        if name == "Ground":
            UsdPhysics.CollisionAPI.Apply(prim.GetPrim())
    stage.Save()
    scene = load(tmp_path / "a.usda", geoms="visual")
    assert names(scene) == {"/World/Drawn/Cube", "/World/Proxy/Cube"}
    for reason in ("/World/Hidden/Cube .*invisible", "/World/Guide/Cube .*guide"):
        assert any(re.search(reason, text) for text in scene.warnings)
    assert names(load(tmp_path / "a.usda", geoms="collision")) == {"/World/Ground/Cube"}
    render = UsdGeom.Cube.Define(stage, "/World/Render")
    render.CreatePurposeAttr("render")
    collider = UsdGeom.Cube.Define(stage, "/World/Collider")
    collider.CreatePurposeAttr("proxy")
    UsdPhysics.CollisionAPI.Apply(collider.GetPrim())
    stage.Save()
    scene = load(tmp_path / "a.usda", geoms="visual")
    assert names(scene) == {"/World/Drawn/Cube", "/World/Render"}
    found = names(load(tmp_path / "a.usda", geoms="collision"))
    assert found == {"/World/Ground/Cube", "/World/Collider"}


def test_a_collider_that_is_switched_off_counts_as_drawn(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    cube = UsdGeom.Cube.Define(stage, "/World/Cube").GetPrim()
    UsdPhysics.CollisionAPI.Apply(cube).CreateCollisionEnabledAttr(False)
    stage.Save()
    (geom,) = load(tmp_path / "a.usda").geoms
    assert geom.counted and "no geom can collide" in geom.reason


def test_meshes_collide_as_their_approximation_says(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    for name in ("none", "convexHull", "boundingCube", "convexDecomposition"):
        prim = add_mesh(stage, f"/World/{name}", CUBE[:4], [(0, 1, 3), (0, 3, 2)]).GetPrim()
        mesh = UsdPhysics.MeshCollisionAPI.Apply(prim)
        mesh.CreateApproximationAttr(name)
    add_mesh(stage, "/World/cube", CUBE, CUBE_FACES)
    stage.Save()
    shapes = {geom.name.rpartition("/")[2]: geom.shape for geom in load(tmp_path / "a.usda").geoms}
    assert shapes["none"] == shapes["convexDecomposition"] == "surface"
    assert shapes["cube"] == "closed surface"
    hull = {geom.name: geom.shape for geom in load(tmp_path / "a.usda", meshes="hull").geoms}
    assert hull["/World/cube"] == "hull"


def test_solids(tmp_path):
    """Solids stay solids under scales that keep them so, else they become meshes."""
    stage = new_stage(tmp_path / "a.usda", up="Y")
    expected = {
        ("Sphere", (1, 1, 1)): "sphere", ("Sphere", (1, 2, 1)): "ellipsoid",
        ("Cylinder", (2, 2, 3)): "cylinder", ("Cylinder", (2, 1, 3)): "mesh",
        ("Capsule", (2, 2, 2)): "capsule", ("Capsule", (1, 1, 2)): "mesh",
        ("Cone", (1, 1, 1)): "mesh", ("Cube", (1, 2, -3)): "box",
    }  # fmt: skip
    for number, (kind, scale) in enumerate(expected):
        prim = getattr(UsdGeom, kind).Define(stage, f"/World/Solid{number}")
        place(prim, (10 * number, 0, 0), scale=scale)
    tilted = UsdGeom.Cube.Define(stage, "/World/Skew")
    UsdGeom.Xformable(tilted).AddScaleOp().Set(Gf.Vec3f(1, 2, 1))
    UsdGeom.Xformable(tilted).AddRotateZOp().Set(30.0)
    UsdGeom.Xformable(tilted).AddTranslateOp().Set(Gf.Vec3d(-20, 0, 0))
    plane = UsdGeom.Plane.Define(stage, "/World/Plane")
    plane.CreateAxisAttr("Y")
    stage.Save()
    scene = load(tmp_path / "a.usda")
    found = {geom.name: geom.type for geom in scene.geoms}
    assert [found[f"/World/Solid{k}"] for k in range(len(expected))] == list(expected.values())
    assert found["/World/Skew"] == "mesh"
    bounds = {name: scene.shapes.only(np.array([g.name == name for g in scene.geoms])).bounds
              for name in found}  # fmt: skip
    # y up: the stage's (x, y, z) is the world's (x, -z, y); a cylinder of height 2 along z
    assert np.allclose(bounds["/World/Solid2"], [[18, -3, -2], [22, 3, 2]], atol=1e-9)
    assert np.allclose(bounds["/World/Solid6"][:, 1], [-1, 1], atol=1e-9)
    assert np.allclose(bounds["/World/Solid7"], [[69, -3, -2], [71, 3, 2]], atol=1e-9)
    UsdPhysics.CollisionAPI.Apply(plane.GetPrim())
    stage.Save()
    (plane,) = load(tmp_path / "a.usda", geoms="collision").shapes.planes.normal
    assert np.allclose(plane, [0, 0, 1])


def test_mirrors_left_hands_and_open_meshes(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    place(add_mesh(stage, "/World/Mirror", CUBE, CUBE_FACES), scale=(-1, 1, 1))
    left = add_mesh(stage, "/World/Left", CUBE, [face[::-1] for face in CUBE_FACES])
    left.CreateOrientationAttr("leftHanded")
    add_mesh(stage, "/World/Open", CUBE, CUBE_FACES[:5])
    holes = add_mesh(stage, "/World/Holes", CUBE, CUBE_FACES)
    holes.CreateHoleIndicesAttr([5])
    UsdGeom.Subset.CreateGeomSubset(left, "part", "face", Vt.IntArray([0, 1]))
    stage.Save()
    shapes = {geom.name: geom.shape for geom in load(tmp_path / "a.usda").geoms}
    assert shapes == {
        "/World/Mirror": "closed surface", "/World/Left": "closed surface",
        "/World/Open": "surface", "/World/Holes": "surface",
    }  # fmt: skip


@pytest.mark.parametrize("turn", [np.eye(3), np.eye(3)[[1, 2, 0]], np.eye(3)[[2, 0, 1]]])
def test_concave_polygons(turn):
    """An L and a comb, either way round, as sets of points: each is in one triangle at most."""
    comb = [(0, 0), (7, 0), (7, 3), (6, 3), (6, 1), (4, 1), (4, 3), (3, 3), (3, 1), (1, 1), (1, 3)]
    for flat in ([(0, 0), (4, 0), (4, 1), (1, 1), (1, 3), (0, 3)], [*comb, (0, 3)]):
        for way in (1, -1):
            points = np.column_stack([np.array(flat[::way], float), np.zeros(len(flat))]) @ turn
            count = np.array([len(flat)])
            faces = triangulate(points, count, np.arange(len(flat)), np.empty(0, np.int64))
            corners = points[faces]
            cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            x, y = np.array(flat).T
            area = abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2
            # their areas add up, and all wind as the polygon
            assert np.linalg.norm(cross.sum(axis=0)) / 2 == pytest.approx(area)
            assert np.linalg.norm(cross, axis=1).sum() / 2 == pytest.approx(area)
            assert len(faces) == len(flat) - 2


def test_instances_of_parts_and_masks(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    trees = UsdGeom.PointInstancer.Define(stage, "/World/Trees")
    place(UsdGeom.Cube.Define(stage, "/World/Trees/Tree/Crown"), (0, 0, 3))
    UsdGeom.Cylinder.Define(stage, "/World/Trees/Tree/Trunk")
    place(UsdGeom.Xform.Define(stage, "/World/Trees/Tree"), (0, 1, 0))
    trees.CreatePrototypesRel().AddTarget("/World/Trees/Tree")
    trees.CreateProtoIndicesAttr([0, 0, 0])
    trees.CreatePositionsAttr([Gf.Vec3f(10 * k, 0, 0) for k in range(3)])
    trees.CreateInvisibleIdsAttr([1])
    place(trees, (0, 0, 5))
    stage.Save()
    scene = load(tmp_path / "a.usda")
    crown = [geom for geom in scene.geoms if geom.name.endswith("Crown")]
    assert [geom.name for geom in crown] == ["/World/Trees/0/Crown", "/World/Trees/2/Crown"]
    assert crown[1].body == "/World/Trees/2"
    assert np.allclose(scene.data.geom_xpos[crown[1].id], [20, 1, 8])
    trees.CreatePrototypesRel().SetTargets(["/World/Nothing"])
    stage.Save()
    with pytest.raises(SceneError, match=r"prototype /World/Nothing of /World/Trees"):
        load(tmp_path / "a.usda")


def test_components_name_what_stands_in_a_cell(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    for name in ("Leg", "Top"):
        UsdGeom.Cube.Define(stage, f"/World/Table/{name}")
    stage.GetPrimAtPath("/World/Table").SetMetadata("kind", "component")
    UsdGeom.Cube.Define(stage, "/World/Box")
    stage.Save()
    bodies = {geom.name: geom.body for geom in load(tmp_path / "a.usda").geoms}
    assert bodies["/World/Table/Leg"] == bodies["/World/Table/Top"] == "/World/Table"
    assert bodies["/World/Box"] == "/World/Box"


def test_joints_of_any_order(tmp_path):
    """A drawer in a free cupboard; a joint that closes a loop; bodies that hang on nothing."""
    stage = new_stage(tmp_path / "a.usda", unit=0.01)
    for name in ("Cupboard", "Drawer", "Ball", "Held"):
        cube = UsdGeom.Cube.Define(stage, f"/World/{name}")
        UsdPhysics.RigidBodyAPI.Apply(cube.GetPrim())
        place(cube, (100, 0, 50))
    UsdPhysics.RigidBodyAPI(stage.GetPrimAtPath("/World/Held")).CreateKinematicEnabledAttr(True)
    # the drawer is the first of its ends, and the cupboard the second
    slide = UsdPhysics.PrismaticJoint.Define(stage, "/World/Slide")
    slide.CreateBody0Rel().AddTarget("/World/Cupboard")
    slide.CreateBody1Rel().AddTarget("/World/Drawer")
    slide.CreateAxisAttr("X")
    slide.CreateLowerLimitAttr(0.0)
    slide.CreateUpperLimitAttr(40.0)
    loop = UsdPhysics.RevoluteJoint.Define(stage, "/World/Loop")
    loop.CreateBody0Rel().AddTarget("/World/Drawer")
    loop.CreateBody1Rel().AddTarget("/World/Cupboard")
    stage.Save()
    scene = load(tmp_path / "a.usda")
    model = scene.model
    joint = model.joint("/World/Slide")
    assert np.allclose(joint.range, [0, 0.4]) and np.allclose(joint.axis, [1, 0, 0])
    drawer, cupboard = model.body("/World/Drawer"), model.body("/World/Cupboard")
    assert int(drawer.parentid[0]) == int(cupboard.id)
    kinds = {body: int(model.body(f"/World/{body}").jntnum[0]) for body in ("Ball", "Held")}
    assert kinds == {"Ball": 1, "Held": 0}
    assert any("/World/Loop" in text and "other joints" in text for text in scene.warnings)


def test_arcs_that_lead_nowhere_are_named(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    UsdGeom.Cube.Define(stage, "/World/Cube")
    stage.DefinePrim("/World/Lost").GetReferences().AddReference("./missing.usda")
    stage.DefinePrim("/World/Late").GetPayloads().AddPayload("./gone.usda")
    stage.DefinePrim("/World/Loop").GetReferences().AddInternalReference("/World/Loop")
    UsdGeom.BasisCurves.Define(stage, "/World/Wire")
    stage.Save()
    warnings = load(tmp_path / "a.usda").warnings
    for name, text in {"Lost": "missing.usda", "Late": "gone.usda", "Loop": "Cycle",
                       "Wire": "BasisCurves"}.items():  # fmt: skip
        (line,) = [line for line in warnings if line.startswith(f"prim /World/{name}")]
        assert text in line and "\n" not in line


def test_broken_stages(tmp_path):
    (tmp_path / "a.usda").write_text('#usda 1.0\ndef Cube "A" {\n')
    with pytest.raises(SceneError, match=r"cannot read the USD stage .*a\.usda: .*a\.usda:\d"):
        load(tmp_path / "a.usda")
    (tmp_path / "b.usdc").write_bytes(b"PXR-USDC" + bytes(40))
    with pytest.raises(SceneError, match=r"cannot read the USD stage .*b\.usdc"):
        load(tmp_path / "b.usdc")
    stage = new_stage(tmp_path / "c.usda")
    stage.Save()
    with pytest.raises(SceneError, match=r"no geometry in .*c\.usda"):
        load(tmp_path / "c.usda")
    mesh = add_mesh(stage, "/World/Mesh", CUBE, [(0, 1, 9)])
    stage.Save()
    with pytest.raises(SceneError, match=r"mesh /World/Mesh of .*from 0 to 7, got 0 to 9"):
        load(tmp_path / "c.usda")
    mesh.CreateFaceVertexCountsAttr([4])
    stage.Save()
    with pytest.raises(SceneError, match=r"mesh /World/Mesh of .*4 corners, but"):
        load(tmp_path / "c.usda")
    with pytest.raises(ConfigError, match=r"scene.up: level.*c\.usda"):
        load(tmp_path / "c.usda", up="level")


BODY = 'prepend apiSchemas = ["PhysicsRigidBodyAPI"]'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('def Cylinder "A" {token axis = "W"}', "expected X, Y or Z as axis of /A in .*'W'"),
        ('def Cube "A" {string size = "x"}', "cannot read prim /A of .*a.usda: "),
        (
            'def Mesh "A" {float3 points = (0, 0, 0); int[] faceVertexCounts = [3]; '
            "int[] faceVertexIndices = [0, 1, 2]}",
            "mesh /A of .* is broken",
        ),
        (
            f'def Cube "A" ({BODY}) {{float3 xformOp:scale = (nan, 1, 1); '
            'uniform token[] xformOpOrder = ["xformOp:scale"]}',
            "cannot read prim /A of .*a.usda: LinAlgError",
        ),
        (
            'def PointInstancer "A" {rel prototypes = </A>; int[] protoIndices = [0]; '
            "point3f[] positions = [(0, 0, 0)]}",
            "point instancer /A of .*a.usda contains itself",
        ),
        (
            f'def Cube "A" ({BODY}) {{ }}\ndef PhysicsRevoluteJoint "J" '
            '{rel physics:body1 = </A>; uniform token physics:axis = "W"}',
            "expected X, Y or Z as physics:axis of /J in .*'W'",
        ),
    ],
)
def test_broken_prims_are_named(tmp_path, text, message):
    (tmp_path / "a.usda").write_text(
        "#usda 1.0\n" + re.sub(r"[{}]|; ", r"\n\g<0>\n", text).replace(";", "")
    )
    with pytest.raises(SceneError, match=message) as raised:
        load(tmp_path / "a.usda")
    assert "\n" not in str(raised.value)


def test_a_drawn_plane_may_move(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    UsdPhysics.RigidBodyAPI.Apply(UsdGeom.Xform.Define(stage, "/World/Tray").GetPrim())
    plane = UsdGeom.Plane.Define(stage, "/World/Tray/Plane")
    plane.CreateWidthAttr(2.0)
    plane.CreateLengthAttr(4.0)
    stage.Save()
    model = load(tmp_path / "a.usda").model
    sides = np.ptp(model.mesh_vert, axis=0)
    assert np.allclose(sorted(sides), [0, 2, 4]) and int(model.body("/World/Tray").jntnum[0]) == 1


def test_an_open_door_frees_its_doorway(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    walls = [
        ((0, 0, -0.05), (4, 2, 0.05)),
        ((0, 1.3, 1), (0.1, 0.7, 1)),
        ((0, -1.3, 1), (0.1, 0.7, 1)),
    ]
    leaf = ((0, 0, 1.05), (0.03, 0.58, 1.0))
    for number, (at, half) in enumerate([*walls, leaf]):
        cube = UsdGeom.Cube.Define(stage, "/World/Door" if number == 3 else f"/World/Part{number}")
        place(cube, at, scale=half)
        UsdPhysics.CollisionAPI.Apply(cube.GetPrim())
    UsdPhysics.RigidBodyAPI.Apply(cube.GetPrim())
    hinge = UsdPhysics.RevoluteJoint.Define(stage, "/World/Hinge")
    hinge.CreateBody1Rel().AddTarget("/World/Door")
    hinge.CreateLocalPos0Attr(Gf.Vec3f(0, 0.58, 1.05))
    hinge.CreateLocalPos1Attr(Gf.Vec3f(0, 1, 0))
    hinge.CreateAxisAttr("Z")
    hinge.CreateLowerLimitAttr(0.0)
    hinge.CreateUpperLimitAttr(90.0)
    stage.Save()
    leads_through(tmp_path / "a.usda")


def test_instances_are_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(parsed_scene, "MAX_GEOMS", 6)
    with pytest.raises(SceneError, match=r"room\.usda has more than 6 pieces"):
        load(write_room(tmp_path, 1.0, "Z", "point-instanced"))


def test_unit_and_up_may_be_set(tmp_path, room):
    path = write_room(tmp_path, 0.01, "Z", "plain")
    stage = Usd.Stage.Open(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, "Y")
    stage.Save()
    assert load(path, unit=0.01, up="z").digest == room[0]


def test_many_prims_become_few_meshes(tmp_path):
    stage = new_stage(tmp_path / "a.usda")
    bolts = UsdGeom.PointInstancer.Define(stage, "/World/Bolts")
    UsdGeom.Cube.Define(stage, "/World/Bolts/Bolt").CreateSizeAttr(0.5)
    bolts.CreatePrototypesRel().AddTarget("/World/Bolts/Bolt")
    bolts.CreateProtoIndicesAttr([0] * MAX_UNMERGED_GEOMS)
    bolts.CreatePositionsAttr([Gf.Vec3f(k % 100, k // 100, 0) for k in range(MAX_UNMERGED_GEOMS)])
    UsdGeom.Cube.Define(stage, "/World/Other/Cube")
    stage.Save()
    scene = load(tmp_path / "a.usda")
    assert names(scene) == {"/World/Bolts", "/World/Other/Cube"}
    (bolts,) = [geom for geom in scene.geoms if geom.name == "/World/Bolts"]
    assert bolts.shape == "closed surface"
    assert np.allclose(scene.bounds, [[-1, -1, -1], [99.25, 99.25, 1]])
    assert any("10001 pieces" in text for text in scene.warnings)


def test_without_usd_core(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr.Usd", None)
    (tmp_path / "a.usda").write_text("#usda 1.0\n")
    with pytest.raises(MissingDependencyError, match=r'pip install "navbake\[usd\]"'):
        load(tmp_path / "a.usda")


@pytest.mark.parametrize(("suffix", "hint"), [(".fbx", "assimp"), (".ifc", "ifcopenshell")])
def test_what_has_to_be_converted(tmp_path, suffix, hint):
    (tmp_path / f"a{suffix}").write_text("x")
    with pytest.raises(SceneError, match=rf"a\{suffix}: .*{hint}"):
        load(tmp_path / f"a{suffix}")


@pytest.mark.parametrize(
    ("head", "size", "problem"),
    [
        ('upAxis = "sideways"', "1", r"expected X, Y or Z as upAxis of .*got 'sideways'"),
        ('upAxis = "Z"', "1e308", r"coordinates that are no numbers"),
    ],
)
def test_absurd_values_are_one_line_without_numpys_warnings(tmp_path, head, size, problem):
    path = tmp_path / "room.usda"
    points = f"[(0,0,0),({size},0,0),({size},{size},0),(0,{size},-{size})]"
    path.write_text(
        f'#usda 1.0\n(\n    {head}\n)\ndef Mesh "M" {{\n    point3f[] points = {points}\n'
        "    int[] faceVertexCounts = [4]\n    int[] faceVertexIndices = [0,1,2,3]\n"
        f"    float3 xformOp:scale = ({size}, 1, 1)\n"
        '    uniform token[] xformOpOrder = ["xformOp:scale"]\n}\n'
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(SceneError, match=problem):
            load(path)
