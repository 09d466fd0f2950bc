"""Stages of USD that tests write: one room in many ways, and any compiled model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("pxr", reason="usd-core is not installed")

from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdUtils, Vt

# boxes of a room with a doorway, z up: centre and size [m]
ROOM = {
    "Floor": ((2.05, 1.55, -0.05), (4.1, 3.1, 0.1)),
    "WallWest": ((0.05, 1.55, 1.25), (0.1, 3.1, 2.5)),
    "WallEast": ((4.05, 1.55, 1.25), (0.1, 3.1, 2.5)),
    "WallSouth": ((2.05, 0.05, 1.25), (3.9, 0.1, 2.5)),
    "WallNorthWest": ((0.87, 3.05, 1.25), (1.54, 0.1, 2.5)),
    "WallNorthEast": ((3.22, 3.05, 1.25), (1.56, 0.1, 2.5)),
    "Table": ((1.13, 0.77, 0.37), (1.27, 0.83, 0.74)),
}
# a ramp beside the eastern wall
RAMP = [(3.03, 0.61, 0), (3.97, 0.61, 0), (3.97, 2.43, 0), (3.03, 2.43, 0)]
RAMP += [(3.03, 2.43, 0.63), (3.97, 2.43, 0.63)]
RAMP_FACES = [(0, 3, 2, 1), (0, 1, 5, 4), (2, 3, 4, 5), (0, 4, 3), (1, 2, 5)]
FORMS = ("plain", "referenced", "instanced", "point-instanced")


def new_stage(path: Path, unit: float = 1.0, up: str = "Z") -> Any:
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, unit)
    UsdGeom.SetStageUpAxis(stage, up)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    return stage


def turned(point: Any, up: str) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in point)
    return (x, y, z) if up == "Z" else (x, z, -y)


def add_mesh(stage: Any, path: str, points: Any, faces: Any, collides: bool = True) -> Any:
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(Vt.Vec3fArray([Gf.Vec3f(*map(float, point)) for point in points]))
    mesh.CreateFaceVertexCountsAttr([len(face) for face in faces])
    mesh.CreateFaceVertexIndicesAttr([int(corner) for face in faces for corner in face])
    if collides:
        UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
    return mesh


def place(prim: Any, pos: Any = (0, 0, 0), quat: Any = None, scale: Any = None) -> None:
    """Give a prim a pose: position, quaternion w, x, y, z, and scale."""
    xform = UsdGeom.Xformable(prim)
    xform.AddTranslateOp().Set(Gf.Vec3d(*map(float, pos)))
    if quat is not None:
        w, x, y, z = map(float, quat)
        precision = UsdGeom.XformOp.PrecisionDouble
        xform.AddOrientOp(precision).Set(Gf.Quatd(w, x, y, z))
    if scale is not None:
        xform.AddScaleOp().Set(Gf.Vec3f(*map(float, scale)))


def write_room(folder: Path, unit: float, up: str, form: str, suffix: str = ".usda") -> Path:
    """Write the room; the prims of all forms but the point-instanced have the same paths."""
    path, room = folder / f"room{suffix}", "/World/Room"
    own = folder / "asset.usda" if form in ("referenced", "instanced") else path
    if suffix == ".usdz":
        own = path = folder / "room.usdc"
    stage = new_stage(own, unit, up)
    UsdGeom.Xform.Define(stage, room)
    if form == "point-instanced":
        proto = UsdGeom.Cube.Define(stage, f"{room}/Proto/Cube")
        proto.CreateSizeAttr(1.0)
        UsdPhysics.CollisionAPI.Apply(proto.GetPrim())
        boxes = UsdGeom.PointInstancer.Define(stage, room)
        boxes.CreatePrototypesRel().AddTarget(f"{room}/Proto")
        boxes.CreateProtoIndicesAttr([0] * len(ROOM))
        centers, sizes = zip(*ROOM.values(), strict=True)
        boxes.CreatePositionsAttr([
            Gf.Vec3f(*(v / unit for v in turned(center, up))) for center in centers
        ])  # fmt: skip
        boxes.CreateScalesAttr([
            Gf.Vec3f(*(abs(v) / unit for v in turned(size, up))) for size in sizes
        ])  # fmt: skip
    else:
        for name, (center, size) in ROOM.items():
            cube = UsdGeom.Cube.Define(stage, f"{room}/{name}")
            cube.CreateSizeAttr(1.0)
            sides = [abs(v) / unit for v in turned(size, up)]
            place(cube, [v / unit for v in turned(center, up)], scale=sides)
            UsdPhysics.CollisionAPI.Apply(cube.GetPrim())
    points = [[v / unit for v in turned(point, up)] for point in RAMP]
    where = "/World/Ramp" if form == "point-instanced" else f"{room}/Ramp"
    add_mesh(stage, where, points, RAMP_FACES)
    stage.Save()
    if own != path:
        outer = new_stage(path, unit, up)
        if form == "instanced":
            prim = outer.DefinePrim(room)
            prim.GetReferences().AddReference("./asset.usda", room)
            prim.SetInstanceable(True)
        else:
            outer.GetDefaultPrim().GetReferences().AddReference("./asset.usda")
        outer.Save()
    if suffix == ".usdz":
        path = folder / "room.usdz"
        assert UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(own)), str(path))
    return path


def write_model(model: Any, path: Path, data: Any = None) -> Path:
    """Write a compiled model as a stage: `/<body>/<geom>` each, joints as UsdPhysics has them.

    Geoms of bodies that never move have no rigid body; a body is a component, so that its name is
    that of what stands in a cell.
    """
    data = mujoco.MjData(model) if data is None else data
    mujoco.mj_kinematics(model, data)
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, "Z")
    for body in range(1, model.nbody):
        prim = UsdGeom.Xform.Define(stage, path_of(model.body(body).name)).GetPrim()
        if model.body_weldid[body]:
            UsdPhysics.RigidBodyAPI.Apply(prim)
            place(prim, data.xpos[body], data.xquat[body])
    for geom in range(model.ngeom):
        _write_geom(stage, model, data, geom)
    for joint in range(model.njnt):
        _write_joint(stage, model, data, joint)
    stage.Save()
    return path


def path_of(name: str) -> str:
    return "/" + "".join(char if char.isalnum() else "_" for char in name)


def _write_geom(stage: Any, model: Any, data: Any, geom: int) -> None:
    body = int(model.geom_bodyid[geom])
    name = model.geom(geom).name or f"geom_{geom}"
    above = path_of(model.body(body).name) if body else ""
    path, kind = above + path_of(name), int(model.geom_type[geom])
    size = model.geom_size[geom].tolist()
    pos, mat = data.geom_xpos[geom].copy(), data.geom_xmat[geom].reshape(3, 3).copy()
    if body and model.body_weldid[body]:
        turn = data.xmat[body].reshape(3, 3)
        pos, mat = turn.T @ (pos - data.xpos[body]), turn.T @ mat
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, mat.ravel())
    types = mujoco.mjtGeom
    scale = None
    if kind == types.mjGEOM_BOX:
        prim = UsdGeom.Cube.Define(stage, path)
        scale = size
    elif kind == types.mjGEOM_SPHERE:
        prim = UsdGeom.Sphere.Define(stage, path)
        prim.CreateRadiusAttr(size[0])
    elif kind == types.mjGEOM_ELLIPSOID:
        prim = UsdGeom.Sphere.Define(stage, path)
        scale = size
        prim.CreateRadiusAttr(1.0)
    elif kind in (types.mjGEOM_CYLINDER, types.mjGEOM_CAPSULE):
        is_capsule = kind == types.mjGEOM_CAPSULE
        prim = (UsdGeom.Capsule if is_capsule else UsdGeom.Cylinder).Define(stage, path)
        prim.CreateRadiusAttr(size[0])
        prim.CreateHeightAttr(2 * size[1])
        prim.CreateAxisAttr("Z")
    elif kind == types.mjGEOM_PLANE:
        prim = UsdGeom.Plane.Define(stage, path)
        prim.CreateAxisAttr("Z")
    else:
        from navbake.baker.geometry.shapes import make_height_field_pieces

        number = int(model.geom_dataid[geom])
        if kind == types.mjGEOM_HFIELD:
            rows, cols = int(model.hfield_nrow[number]), int(model.hfield_ncol[number])
            first = int(model.hfield_adr[number])
            heights = model.hfield_data[first : first + rows * cols].reshape(rows, cols)
            pieces = list(make_height_field_pieces(heights, model.hfield_size[number]))
            points = np.concatenate(
                [piece.vertices[piece.faces].reshape(-1, 3) for piece in pieces]
            )
            faces = np.arange(len(points)).reshape(-1, 3)
        else:
            mesh = model.mesh(number)
            first, start = int(mesh.vertadr[0]), int(mesh.faceadr[0])
            points = model.mesh_vert[first : first + int(mesh.vertnum[0])]
            faces = model.mesh_face[start : start + int(mesh.facenum[0])]
        prim = add_mesh(stage, path, points, faces, collides=False)
    place(prim, pos, quat, scale)
    if model.geom_contype[geom] or model.geom_conaffinity[geom]:
        UsdPhysics.CollisionAPI.Apply(prim.GetPrim())


def _write_joint(stage: Any, model: Any, data: Any, joint: int) -> None:
    kinds = mujoco.mjtJoint
    kind, body = int(model.jnt_type[joint]), int(model.jnt_bodyid[joint])
    if kind not in (kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE):
        return
    name = path_of(model.joint(joint).name or f"joint_{joint}") + "_joint"
    schema = UsdPhysics.RevoluteJoint if kind == kinds.mjJNT_HINGE else UsdPhysics.PrismaticJoint
    made = schema.Define(stage, name)
    made.CreateBody1Rel().AddTarget(path_of(model.body(body).name))
    made.CreateAxisAttr("Z")
    # a frame whose z is the joint's axis, in the body and in the world
    quat, turn = np.empty(4), np.empty(9)
    mujoco.mju_quatZ2Vec(quat, model.jnt_axis[joint])
    mujoco.mju_quat2Mat(turn, quat)
    made.CreateLocalPos1Attr(Gf.Vec3f(*model.jnt_pos[joint].tolist()))
    made.CreateLocalRot1Attr(Gf.Quatf(*map(float, quat)))
    # the other frame is where the joint's position is 0
    position, outer = float(data.qpos[model.jnt_qposadr[joint]]), np.empty(4)
    anchor = data.xanchor[joint].copy()
    mujoco.mju_mulQuat(outer, data.xquat[body], quat)
    if kind == kinds.mjJNT_HINGE:
        back = np.array([np.cos(position / 2), 0.0, 0.0, -np.sin(position / 2)])
        mujoco.mju_mulQuat(outer, outer.copy(), back)
    else:
        anchor -= position * data.xaxis[joint]
    made.CreateLocalPos0Attr(Gf.Vec3f(*anchor.tolist()))
    made.CreateLocalRot0Attr(Gf.Quatf(*map(float, outer)))
    if model.jnt_limited[joint]:
        low, high = model.jnt_range[joint]
        factor = 180 / np.pi if kind == kinds.mjJNT_HINGE else 1.0
        made.CreateLowerLimitAttr(float(low * factor))
        made.CreateUpperLimitAttr(float(high * factor))
