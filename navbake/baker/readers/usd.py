"""Reads a USD stage as pieces: prims that are drawn or collide, and bodies with their joints.

pxr comes with the extra [usd]. MuJoCo's own plugin for USD is not used: it leaves out units, the up
axis, instancers, visibility and purpose.

A prim is drawn unless it, or one above it, is invisible, a guide, or a proxy beside render prims.
It collides by the collision API, its own or of a prim above it, drawn or not. What does neither is
left out. Coordinates are rounded to `DECIMALS`: USD's are 32-bit floats, of which 3.7 m are
3.7000000477 and 370 cm aren't.

Source: Pixar, Universal Scene Description, schemas UsdGeom and UsdPhysics.
"""

from __future__ import annotations

import re
from functools import cache
from itertools import permutations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.baker.geometry.shapes import Mesh, tessellate, triangulate
from navbake.baker.readers.mesh import rotation_to_z_up
from navbake.baker.readers.parsed_scene import (
    JointTree,
    ParsedGeom,
    ParsedJoint,
    ParsedScene,
    check_count,
    reading,
)
from navbake.config.settings import SceneSettings
from navbake.errors import ConfigError, SceneError
from navbake.formats.source import import_extra
from navbake.known_names import list_first
from navbake.lazy import lazy
from navbake.types import Float

Gf = lazy("pxr.Gf")
Tf = lazy("pxr.Tf")
Usd = lazy("pxr.Usd")
UsdGeom = lazy("pxr.UsdGeom")
UsdPhysics = lazy("pxr.UsdPhysics")
UsdUtils = lazy("pxr.UsdUtils")

DECIMALS = 6  # of lengths [m]; of turns three more
# The frames of solids whose axis is x, y or z, as columns: their third one is the axis
FRAMES = {"X": np.eye(3)[:, [1, 2, 0]], "Y": np.eye(3)[:, [2, 0, 1]], "Z": np.eye(3)}
ORDERS = np.array(list(permutations(range(3))))
SKEW = 1e-6  # of a turn that is none
SOLIDS = "Cube", "Sphere", "Cylinder", "Capsule", "Cone", "Plane"  # types of prims
JOINT_KINDS = {"PhysicsRevoluteJoint": "hinge", "PhysicsPrismaticJoint": "slide"}
JOINT_KINDS |= {"PhysicsSphericalJoint": "ball", "PhysicsFixedJoint": "fixed"}


class _State(NamedTuple):
    """What a prim takes over from those above it."""

    matrix: Any  # Gf.Matrix4d, to the stage's world
    visible: bool = True
    purpose: str = "default"
    body: str = ""  # the rigid body that it is part of
    component: str = ""  # the model that it is part of
    collides: bool = False
    approximation: str = "none"


_Read = tuple[str, tuple[float, ...], Float, Mesh | None]  # as in `_Found`


class _Found(NamedTuple):
    """A prim's geometry before it is placed."""

    name: str
    body: str
    kind: str  # as in `ParsedGeom`; or cone
    size: tuple[float, ...]  # in the prim's own frame and unit, as `ParsedGeom.size`
    frame: Float  # (3, 3), of a solid in the prim's frame
    mesh: Mesh | None
    matrix: Any  # the prim's
    mode: str
    collides: bool
    purpose: str  # of what is drawn, else empty


def read_stage(path: Path, settings: SceneSettings) -> ParsedScene:
    """Read a .usd, .usda, .usdc or .usdz file.

    Lengths and the up axis are the stage's own, unless `scene.unit` or `scene.up` say otherwise.
    Names are paths of prims. References that can't be resolved are warned of.

    Raises:
        MissingDependencyError: usd-core is not installed.
        SceneError: the stage is broken, or one of its prims is.
    """
    import_extra("pxr.Usd", "usd", f"{path}, a USD scene,")
    quiet = UsdUtils.CoalescingDiagnosticDelegate()  # else pxr writes to stderr
    try:
        stage = Usd.Stage.Open(str(path))
        return _Reader(stage, path, settings).read()
    except Tf.ErrorException as error:
        said = re.findall(r" : '(.*?)'\s*(?=\n\tError|\n*$)", str(error), re.DOTALL)
        reason = " ".join((said or [str(error)])[0].split())[:300]
        raise SceneError(f"cannot read the USD stage {path}: {reason}") from error
    finally:
        quiet.TakeUncoalescedDiagnostics()


class _Reader:
    def __init__(self, stage: Any, path: Path, settings: SceneSettings) -> None:
        self._stage = stage
        self._path = path
        self._time = Usd.TimeCode.EarliestTime()
        self._unit, self._to_world = _frame_of(stage, path, settings)
        self._result = ParsedScene(decimals=DECIMALS)
        self._found: list[_Found] = []
        self._rigid: dict[str, Any] = {}  # bodies' matrices, by path
        self._kinematic: set[str] = set()
        self._joints: list[Any] = []
        self._meshes: dict[Any, Mesh | None] = {}
        self._open: list[Any] = []  # point instancers whose prototypes are read
        self._left_out: dict[str, list[str]] = {}

    def read(self) -> ParsedScene:
        for error in self._stage.GetCompositionErrors():
            where = re.findall(r"<([^>]*)>", str(error.rootSite))
            text = re.sub(r",@anon:[^@]*@", "", " ".join(str(error).split()))[:300]
            prim = where[-1] if where else "/"
            self._result.warnings.append(f"prim {prim} of {self._path}: {text}")
        self._walk(self._stage.GetPseudoRoot(), _State(Gf.Matrix4d(1.0)))
        self._tie_bodies()
        self._place()
        for reason, names in self._left_out.items():
            text = f"prim {list_first(names)} of {self._path} left out: {reason}"
            self._result.warnings.append(text)
        return self._result

    # ------------------------------------------------------------ prims

    def _walk(self, root: Any, state: _State, prefix: str = "") -> None:
        """Find the geometry of a prim and those below it, with names less a prefix."""
        below = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
        left = [(root, state)]
        while left:
            prim, above = left.pop()
            name = str(prim.GetPath()).removeprefix(prefix)
            with reading(f"prim {prim.GetPath()} of {self._path}"):
                state = self._state_of(prim, name, above)
                is_open = self._read_prim(prim, name, state)
            if is_open:
                left += [(child, state) for child in reversed(prim.GetFilteredChildren(below))]

    def _read_prim(self, prim: Any, name: str, state: _State) -> bool:
        """Read one prim; whether those below it are to be read."""
        kind = str(prim.GetTypeName())
        if kind == "PointInstancer":
            self._read_instancer(prim, name, state)
            return False  # the prototypes below it aren't drawn by themselves
        if kind in (*SOLIDS, "Mesh"):
            self._take(prim, name, kind, state)
        elif kind.startswith("Physics") and kind.endswith("Joint"):
            self._joints.append(prim)
        elif kind.startswith(("Cylinder", "Capsule")) and prim.IsA(UsdGeom.Gprim):
            self._take(prim, name, kind.partition("_")[0], state)
        elif kind and prim.IsA(UsdGeom.Gprim):
            self._leave_out(f"{kind} is no surface that navbake reads", name)
        return True

    def _state_of(self, prim: Any, name: str, above: _State) -> _State:
        matrix, visible, purpose, body, component, collides, approximation = above
        names = prim.GetAuthoredPropertyNames()  # one call, where most prims have few
        if "visibility" in names:
            visible = visible and self._get(prim, "visibility") != "invisible"
        if "purpose" in names:
            purpose = str(self._get(prim, "purpose"))
        if "xformOpOrder" in names:
            xform = UsdGeom.Xformable(prim)
            own = xform.GetLocalTransformation(self._time)
            matrix = own if xform.GetResetXformStack() else own * matrix
        if not component and name.count("/") > 1 and prim.GetMetadata("kind") == "component":
            component = name
        if prim.GetAppliedSchemas():
            if prim.HasAPI(UsdPhysics.RigidBodyAPI):
                rigid = UsdPhysics.RigidBodyAPI(prim)
                if rigid.GetRigidBodyEnabledAttr().Get(self._time):
                    _rigid(self._world_of(matrix))  # which fails here, by the prim's name
                    body = name
                    self._rigid[name] = matrix
                    if rigid.GetKinematicEnabledAttr().Get(self._time):
                        self._kinematic.add(name)
            if prim.HasAPI(UsdPhysics.CollisionAPI):
                enabled = UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr()
                collides = bool(enabled.Get(self._time))
            if prim.HasAPI(UsdPhysics.MeshCollisionAPI):
                approximation = str(UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get())
        return _State(matrix, visible, purpose, body, component, collides, approximation)

    def _take(self, prim: Any, name: str, kind: str, state: _State) -> None:
        drawn = state.purpose if state.visible and state.purpose != "guide" else ""
        if not drawn and not state.collides:
            self._leave_out("it is invisible" if not state.visible else "it is a guide", name)
            return
        is_hull = state.collides and state.approximation in ("convexHull", "boundingCube")
        mode = "hull" if is_hull else "surface"
        read = (
            self._read_mesh(prim, state) if kind == "Mesh" else self._read_solid(prim, kind, state)
        )
        if read is not None:
            body = state.body or state.component or name
            more = state.matrix, mode, state.collides, drawn
            self._found.append(_Found(name, body, *read, *more))

    def _leave_out(self, reason: str, name: str) -> None:
        self._left_out.setdefault(reason, []).append(name)

    def _get(self, prim: Any, name: str) -> Any:
        return prim.GetAttribute(name).Get(self._time)

    def _axis_of(self, prim: Any, name: str) -> str:
        axis = str(self._get(prim, name))
        if axis not in FRAMES:
            where = f"{name} of {prim.GetPath()} in {self._path}"
            raise SceneError(f"expected X, Y or Z as {where}, got {axis[:40]!r}")
        return axis

    def _read_solid(self, prim: Any, kind: str, state: _State) -> _Read:
        """A solid; of two radii, the larger one; a plane is endless where it collides."""
        if kind == "Cube":
            return "box", (float(self._get(prim, "size")) / 2,) * 3, np.eye(3), None
        if kind == "Sphere":
            return "ellipsoid", (float(self._get(prim, "radius")),) * 3, np.eye(3), None
        axis = self._axis_of(prim, "axis")
        if kind == "Plane":
            width = float(self._get(prim, "width")) / 2
            length = float(self._get(prim, "length")) / 2
            sides = (width, length) if axis == "Z" else (length, width)
            return "plane", (0.0, 0.0) if state.collides else sides, FRAMES[axis], None
        radii = [prim.GetAttribute(key) for key in ("radius", "radiusBottom", "radiusTop")]
        radius = max(float(each.Get(self._time)) for each in radii if each)
        return kind.lower(), (radius, float(self._get(prim, "height")) / 2), FRAMES[axis], None

    def _read_mesh(self, prim: Any, state: _State) -> _Read | None:
        shared = prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim
        key = shared.GetPath(), state.collides and state.approximation == "boundingCube"
        if key not in self._meshes:
            self._meshes[key] = self._triangles_of(prim, is_box=key[1])
        mesh = self._meshes[key]
        return None if mesh is None else ("mesh", (), np.eye(3), mesh)

    def _triangles_of(self, prim: Any, is_box: bool) -> Mesh | None:
        """A mesh in its own frame, counter-clockwise; None for an empty one."""
        keys = "points", "faceVertexCounts", "faceVertexIndices"
        points, counts, indices = (self._get(prim, key) for key in keys)
        if not points or not counts:
            return None
        vertices = np.array(points, dtype=np.float64).reshape(-1, 3)
        counts = np.array(counts)
        indices = np.array(indices if indices is not None else [], int)
        where = f"mesh {prim.GetPath()} of {self._path}"
        if counts.min() < 0 or counts.sum() != len(indices):
            corners = f"{counts.sum()} corners, but faceVertexIndices {len(indices)}"
            raise SceneError(f"{where} is broken: its faces have {corners}")
        if len(indices) and not 0 <= indices.min() <= indices.max() < len(vertices):
            expected = f"expected faceVertexIndices from 0 to {len(vertices) - 1}"
            got = f"got {indices.min()} to {indices.max()}"
            raise SceneError(f"{where} is broken: {expected}, {got}")
        if is_box:
            box = tessellate("box", (0.5, 0.5, 0.5))
            low = vertices.min(axis=0)
            high = vertices.max(axis=0)
            return Mesh(low + (box.vertices + 0.5) * (high - low), box.faces)
        holes = np.array(self._get(prim, "holeIndices") or [], dtype=np.int64)
        faces = triangulate(vertices, counts, indices, holes)
        if self._get(prim, "orientation") == "leftHanded":
            faces = faces[:, ::-1]
        return Mesh(vertices, faces)

    def _read_instancer(self, prim: Any, name: str, state: _State) -> None:
        """The prototypes of a point instancer at its points, named ``instancer/number/…``."""
        instancer = UsdGeom.PointInstancer(prim)
        prototypes = instancer.GetPrototypesRel().GetForwardedTargets()
        numbers = instancer.GetProtoIndicesAttr().Get(self._time)
        if not numbers or not prototypes:
            return
        roots = [self._stage.GetPrimAtPath(path) for path in prototypes]
        for number, root in zip(prototypes, roots, strict=True):
            if not root:
                raise SceneError(f"prototype {number} of {name} in {self._path} is missing")
        if not 0 <= min(numbers) <= max(numbers) < len(roots):
            raise SceneError(
                f"expected protoIndices of {name} in {self._path} from 0 to {len(roots) - 1}, got "
                f"{min(numbers)} to {max(numbers)}"
            )
        # a prototype's own transform comes with its geometry
        places = instancer.ComputeInstanceTransformsAtTime(
            self._time, self._time, UsdGeom.PointInstancer.ExcludeProtoXform,
            UsdGeom.PointInstancer.IgnoreMask,
        )  # fmt: skip
        mask = list(instancer.ComputeMaskAtTime(self._time)) or [True] * len(numbers)
        if not len(places) == len(mask) == len(numbers):
            raise SceneError(
                f"expected as many positions as protoIndices of {name} in {self._path}, got "
                f"{len(places)} and {len(numbers)}"
            )
        if prim.GetPath() in self._open:
            raise SceneError(f"point instancer {prim.GetPath()} of {self._path} contains itself")
        self._open.append(prim.GetPath())
        samples = dict[int, list[_Found]]()
        for number, (proto, place, shown) in enumerate(zip(numbers, places, mask, strict=True)):
            if not shown:
                continue
            if proto not in samples:  # found once, at the origin
                samples[proto] = self._find_sample(roots[proto], state)
            matrix = place * state.matrix
            own = f"{name}/{number}"
            check_count(len(self._found) + len(samples[proto]), self._path)
            for one in samples[proto]:
                place = one.matrix * matrix
                body = state.body or own
                self._found.append(one._replace(name=own + one.name, body=body, matrix=place))
        self._open.pop()

    def _find_sample(self, root: Any, state: _State) -> list[_Found]:
        """The geometry of a prototype, which is of one piece, by names below it."""
        kept = (self._found, dict(self._rigid), list(self._joints))
        self._found = []
        self._walk(root, state._replace(matrix=Gf.Matrix4d(1.0)), str(root.GetPath()))
        sample = self._found
        self._found, self._rigid, self._joints = kept
        return sample

    # ------------------------------------------------------------ bodies and joints

    def _tie_bodies(self) -> None:
        """Make bodies of rigid prims: each hangs on another by one joint, or is free, or stays."""
        ties = JointTree({name: _rigid(self._world_of(m)) for name, m in self._rigid.items()})
        frames = UsdGeom.XformCache(self._time)
        for prim in self._joints:
            joint = UsdPhysics.Joint(prim)
            name = str(prim.GetPath())
            kind = JOINT_KINDS.get(str(prim.GetTypeName()), "")
            if not joint.GetJointEnabledAttr().Get(self._time):
                continue
            relations = joint.GetBody0Rel(), joint.GetBody1Rel()
            parent, child = (self._body_of(end.GetForwardedTargets()) for end in relations)
            # the second body hangs on the first one, unless it stays or hangs elsewhere
            is_turned = not child or (ties.has(child) and bool(parent) and not ties.has(parent))
            if is_turned:
                parent, child = child, parent
            if not kind or not child:
                unknown = f"{prim.GetTypeName()} is no joint that navbake reads"
                self._leave_out("it ties no rigid body" if kind else unknown, name)
                continue
            with reading(f"joint {name} of {self._path}"):
                made = self._read_joint(joint, prim, kind, frames, is_turned)
            if not ties.tie(parent, child, made):
                self._leave_out("its bodies hang on other joints already", name)
        self._result.bodies = ties.make_bodies(self._kinematic)

    def _body_of(self, targets: list[Any]) -> str:
        """The rigid body that the end of a joint belongs to; empty for what never moves."""
        prim = self._stage.GetPrimAtPath(targets[0]) if targets else None
        while prim and str(prim.GetPath()) not in self._rigid:
            prim = prim.GetParent()
        name = str(prim.GetPath()) if prim else ""
        return "" if name in self._kinematic else name

    def _read_joint(
        self, joint: Any, prim: Any, kind: str, frames: Any, is_turned: bool
    ) -> ParsedJoint | None:
        if kind == "fixed":
            return None
        ends = []
        for number, relation in enumerate((joint.GetBody0Rel(), joint.GetBody1Rel())):
            targets = relation.GetForwardedTargets()
            body = self._stage.GetPrimAtPath(targets[0]) if targets else None
            matrix = frames.GetLocalToWorldTransform(body) if body else Gf.Matrix4d(1.0)
            world = self._world_of(matrix)
            place = np.array(self._get(prim, f"physics:localPos{number}"), dtype=np.float64)
            turn = np.array(Gf.Matrix3d(self._get(prim, f"physics:localRot{number}"))).T
            ends.append((world[:3, :3] @ place + world[:3, 3], _rigid(world)[:3, :3] @ turn))
        (start, before), (anchor, after) = ends
        number = 0 if kind == "ball" else "XYZ".index(self._axis_of(prim, "physics:axis"))
        axis = after[:, number]
        position = 0.0
        limits = None
        if kind == "slide":
            position = float(axis @ (anchor - start))
        elif kind == "hinge":
            across = before.T @ after
            one = (number + 1) % 3
            two = (number + 2) % 3
            position = float(np.arctan2(across[two, one], across[one, one]))
        if kind != "ball":
            ends_at = [float(self._get(prim, f"physics:{key}Limit")) for key in ("lower", "upper")]
            low, high = np.radians(ends_at) if kind == "hinge" else np.array(ends_at) * self._unit
            if np.isfinite([low, high]).all() and low < high:
                limits = (_round(low, 3), _round(high, 3))
        way = -1.0 if is_turned else 1.0
        return ParsedJoint(
            str(prim.GetPath()), kind, np.round(anchor, DECIMALS),
            np.round(way * axis, DECIMALS + 3) + 0.0, limits, _round(position),
        )  # fmt: skip

    # ------------------------------------------------------------ places

    def _world_of(self, matrix: Any) -> Float:
        """A prim's matrix as it places points in the world, (4, 4) [m]."""
        return np.asarray(self._to_world @ np.array(matrix).T)

    def _place(self) -> None:
        """Make pieces of what was found: their poses, and solids that are no longer any."""
        has_render = any(one.purpose == "render" for one in self._found)
        if has_render:
            for one in self._found:
                if one.purpose == "proxy" and not one.collides:
                    self._leave_out("it is a proxy beside render prims", one.name)
            self._found = [one for one in self._found if one.purpose != "proxy" or one.collides]
        if not self._found:
            return
        world = self._to_world @ np.array([one.matrix for one in self._found]).transpose(0, 2, 1)
        world[:, :3, :3] = world[:, :3, :3] @ np.stack([one.frame for one in self._found])
        scales = np.linalg.norm(world[:, :3, :3], axis=1)
        turns = world[:, :3, :3] / np.where(scales > 0, scales, 1.0)[:, None]
        skews = np.abs(turns.transpose(0, 2, 1) @ turns - np.eye(3)).max(axis=(1, 2)) > SKEW
        kinds = [one.kind if one.mesh is None else "" for one in self._found]
        turns, scales = _straighten(np.array(kinds), np.round(turns, DECIMALS + 3), scales)
        poses = np.tile(np.eye(4), (len(world), 1, 1))
        poses[:, :3, :3] = turns
        poses[:, :3, 3] = np.round(world[:, :3, 3], DECIMALS) + 0.0
        solid = cache(tessellate)
        rows = zip(self._found, world, poses, scales.tolist(), skews.tolist(), strict=True)
        for one, matrix, pose, scale, is_skew in rows:
            size = None if one.mesh is not None else _scaled(one.kind, one.size, scale, is_skew)
            kind = one.kind
            mesh = one.mesh
            if size is None:
                kind = "mesh"
                pose = matrix
                mesh = mesh or solid(one.kind, one.size)
            elif kind == "ellipsoid" and size[0] == size[1] == size[2]:
                kind = "sphere"
                size = size[:1]
            drawn = bool(one.purpose) and not (has_render and one.purpose == "proxy")
            shape = (kind, size or (), pose, mesh, None)
            rights = (one.mode, one.collides, drawn)
            self._result.pieces.append(ParsedGeom(one.name, one.body, *shape, *rights))


def _straighten(kinds: NDArray[np.str_], turns: Float, scales: Float) -> tuple[Float, Float]:
    """Choose of the frames in which solids are the same that nearest to the world's.

    So a box is the same whether the stage is y or z up. Takes and returns frames as columns,
    (n, 3, 3), and scales along them, (n, 3).
    """
    order = np.tile(np.arange(3), (len(turns), 1))
    boxes = np.flatnonzero((kinds == "box") | (kinds == "ellipsoid"))
    match = np.abs(turns[boxes][:, np.arange(3)[None], ORDERS]).sum(axis=2)
    order[boxes] = ORDERS[match.argmax(axis=1)]
    turns = np.take_along_axis(turns, order[:, None, :], axis=2)
    scales = np.take_along_axis(scales, order, axis=1)
    is_even = kinds != "plane"  # the same in a mirror
    for axis in range(3):
        turns[is_even & (turns[:, axis, axis] < 0), :, axis] *= -1
    is_upright = np.isin(kinds, ("cylinder", "capsule")) & (turns[:, 2, 2] == 1.0)
    turns[is_upright] = np.eye(3)
    turns[np.linalg.det(turns) < 0, :, 0] *= -1
    return turns + 0.0, scales


def _scaled(
    kind: str, size: tuple[float, ...], scale: list[float], is_skew: bool
) -> tuple[float, ...] | None:
    """The size of a solid that is scaled along its axes [m]; None where it is no such solid now."""
    x, y, z = (_round(value) for value in scale)
    is_uneven = kind == "capsule" and not x == y == z
    if is_skew or kind == "cone" or is_uneven or (kind == "cylinder" and x != y):
        return None
    factors = (scale[0], scale[2]) if kind in ("cylinder", "capsule") else scale
    return tuple(_round(a * b) for a, b in zip(size, factors, strict=False))


def _rigid(world: Float) -> Float:
    """The pose of a frame without its scale, (4, 4)."""
    turn, _, other = np.linalg.svd(world[:3, :3])
    pose = np.eye(4)
    pose[:3, :3] = np.round(turn @ other * np.sign(np.linalg.det(turn @ other)), DECIMALS + 3) + 0.0
    pose[:3, 3] = np.round(world[:3, 3], DECIMALS) + 0.0
    return pose


def _round(value: float, more: int = 0) -> float:
    return round(float(value), DECIMALS + more) + 0.0


def _frame_of(stage: Any, path: Path, settings: SceneSettings) -> tuple[float, Float]:
    """The metres of a stage's unit, and the matrix from its frame to the world, (4, 4)."""
    if settings.up == "level":
        raise ConfigError(f"`scene.up: level` is for mesh files, {path} says what is up itself")
    up = settings.up if settings.up != "auto" else str(UsdGeom.GetStageUpAxis(stage)).lower()
    is_set = "unit" in settings.model_fields_set
    unit = settings.unit if is_set else float(UsdGeom.GetStageMetersPerUnit(stage))
    if not 0 < unit < np.inf:
        raise SceneError(f"expected metersPerUnit > 0 in {path}, got {unit:g}")
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_to_z_up(up) * unit
    return unit, matrix
