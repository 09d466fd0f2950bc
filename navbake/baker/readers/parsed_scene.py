"""Pieces of a scene as its reader finds them, and how models of MuJoCo are made and compiled.

USD and SDF become a model of MuJoCo, so that doors, poses, `scene.geoms`, updates, checks and
batches work on them as on MJCF. Solids and height fields are MuJoCo's own; meshes that never move
are kept exact beside the model, see `model_of_meshes`.

MjSpec adds a body in time proportional to those that it has: 1.4 s for 10,000, minutes for 100,000.
So of more than `MERGE_ABOVE` pieces, static ones that stand together become one mesh, until
`MERGE_DOWN_TO` are left.
"""

from __future__ import annotations

import threading
import warnings as python_warnings
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from navbake.baker.geometry.shapes import Mesh, hull_faces, tessellate
from navbake.baker.readers.mesh import NamedMesh, check_mesh
from navbake.errors import ConfigError, NavbakeError, SceneError
from navbake.known_names import unique_name
from navbake.processes import lacked_memory
from navbake.types import Float, Int, Int32

TETRAHEDRON = np.eye(4, 3), np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
"""Vertices and faces, counter-clockwise from outside."""
BY_MUJOCO = "MuJoCo: "  # what its warnings begin with
_WARNING_LOCK = threading.Lock()  # MuJoCo has one hook for warnings, whatever the thread
MERGE_ABOVE = 10_000
MERGE_DOWN_TO = 3000
MAX_GEOMS = 2_000_000  # of a scene, instances counted each
STAND_IN = "mesh"  # the name of the tetrahedron in place of meshes that are kept exact
# MuJoCo's types by the names that they have in its XML
KINDS = {
    name: getattr(mujoco.mjtGeom, f"mjGEOM_{name.upper()}")
    for name in ("plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")
}
JOINTS = {
    name: getattr(mujoco.mjtJoint, f"mjJNT_{name.upper()}")
    for name in ("hinge", "slide", "ball", "free")
}


class ParsedGeom(NamedTuple):
    """A shape of a scene file, which becomes one geom of MuJoCo's model."""

    name: str
    body: str  # the body that it belongs to
    kind: str  # one of `KINDS`
    size: tuple[float, ...]  # MuJoCo's [m]; of a mesh empty
    pose: Float  # (4, 4), from its own frame to the world [m]; rigid unless it is a mesh
    mesh: Mesh | None = None
    heights: Float | None = None  # of a height field, 0 to 1, row 0 at the smallest y
    mode: str = "surface"  # of a mesh, as what `scene.meshes: auto` counts it: surface or hull
    collides: bool = True
    drawn: bool = True


class ParsedJoint(NamedTuple):
    """How a body moves against its parent, in the world's frame as the scene stands."""

    name: str
    kind: str  # one of `JOINTS`
    anchor: Float
    axis: Float
    limits: tuple[float, float] | None = None  # [m or rad]
    position: float = 0.0  # as the scene stands [m or rad]


class ParsedBody(NamedTuple):
    """A body that moves, or hangs on one that does."""

    name: str
    parent: str  # another body's name, or empty for the world
    pose: Float  # (4, 4), rigid
    joint: ParsedJoint | None


@dataclass
class ParsedScene:
    """All that a reader found in a scene. Bodies that are not listed never move."""

    pieces: list[ParsedGeom] = field(default_factory=list)
    bodies: dict[str, ParsedBody] = field(default_factory=dict)  # by name, parents first
    warnings: list[str] = field(default_factory=list)
    decimals: int | None = None  # to which coordinates are rounded [m]
    named_leaves: set[str] = field(default_factory=set)  # bodies that the file says are doors


def check_count(count: int, path: Path) -> None:
    """Refuse more pieces than a few lines of instances in instances should make."""
    if count > MAX_GEOMS:
        most = f"more than {MAX_GEOMS:,} pieces and models, each instance counted"
        raise SceneError(f"{path} has {most}, the most that navbake reads: bake a part of it")


@contextmanager
def reading(what: str) -> Iterator[None]:
    """Make a SceneError, which names the file or a part of it, of all that a reader can't take."""
    try:
        yield
    except (NavbakeError, OSError, MemoryError):
        raise
    except Exception as error:  # a value of the wrong type, a solver that fails, …
        reason = " ".join(f"{type(error).__name__} {error}".split())[:300]
        raise SceneError(f"cannot read {what}: {reason}") from error


class JointTree:
    """Joints between bodies, as a tree: a body hangs on the first one that it is tied to.

    Attributes:
        poses: of all bodies that may move, by name, (4, 4), rigid.
    """

    def __init__(self, poses: Mapping[str, Float]) -> None:
        self.poses = poses
        self._ties: dict[
            str, tuple[str, ParsedJoint | None]
        ] = {}  # by body: its parent and its joint

    def tie(self, parent: str, child: str, joint: ParsedJoint | None) -> bool:
        """Tie a body to another one, or to the world (empty); by no joint, they are one piece.

        Returns whether it did: not where the child hangs on one already, or the parent on it.
        """
        above = parent
        while above and above != child:
            above = self._ties.get(above, ("", None))[0]
        if child in self._ties or above:
            return False
        self._ties[child] = parent, joint
        return True

    def has(self, name: str) -> bool:
        """Whether a body hangs on another one, or on the world."""
        return name in self._ties

    def make_bodies(self, held: Collection[str] = ()) -> dict[str, ParsedBody]:
        """All bodies that move, parents first; what hangs on nothing is free, unless it is held."""
        free = np.zeros(3)
        for name in self.poses:
            joint = None if name in held else ParsedJoint(name, "free", free, free)
            self._ties.setdefault(name, ("", joint))
        moving: dict[str, ParsedBody] = {}
        left = dict.fromkeys(self.poses)
        while left:
            for name in [name for name in left if self._ties[name][0] not in left]:
                del left[name]
                parent, joint = self._ties[name]
                if joint is not None or parent in moving:
                    parent = parent if parent in moving else ""
                    moving[name] = ParsedBody(name, parent, self.poses[name], joint)
        return moving


def build_model(
    found: ParsedScene, path: Path, ground: float | None, warnings: list[str]
) -> tuple[Any, dict[int, NamedMesh]]:
    """Compile what a reader found; returns the model, and the static meshes by geom id."""
    warnings += found.warnings
    taken = set[str]()
    parts = dict[str, NamedMesh]()
    moving = dict[str, NamedMesh]()
    pieces = list[ParsedGeom]()
    for piece in merge_geoms(found, path, warnings):
        piece = piece._replace(name=unique_name(piece.name, taken))
        if piece.kind == "plane" and any(piece.size) and piece.body in found.bodies:
            # MuJoCo has planes on static bodies only
            piece = piece._replace(kind="mesh", size=(), mesh=tessellate("plane", piece.size))
        if piece.mesh is not None:
            # a mesh that moves is in the frame of its body
            body = found.bodies.get(piece.body)
            mesh = _place([piece.mesh], _own_pose(piece.pose, body)[None], found.decimals)
            part = check_mesh(NamedMesh(piece.name, *mesh, piece.mode), path)
            if not len(part.faces):
                continue
            (parts if body is None else moving)[piece.name] = part
        pieces.append(piece)
    if not pieces:
        raise SceneError(f"no geometry in {path}: expected at least one mesh or solid")

    def build() -> Any:
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        holders = {"": spec.worldbody}
        for body in found.bodies.values():
            own = _own_pose(body.pose, found.bodies.get(body.parent))
            holder = holders[body.parent].add_body(name=body.name, **_place_of(own))
            holders[body.name] = holder
            if (joint := body.joint) is None:
                continue
            made = holder.add_joint(name=joint.name, type=JOINTS[joint.kind])
            if joint.kind != "free":  # the others are in the body's frame
                turn = body.pose[:3, :3]
                made.pos = (joint.anchor - body.pose[:3, 3]) @ turn
                made.axis = joint.axis @ turn
                made.ref = joint.position
            if joint.limits is not None:
                made.range = joint.limits
                made.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        if parts:
            fill_mesh(spec.add_mesh(name=STAND_IN), *TETRAHEDRON)
        for piece in pieces:
            if piece.body not in holders:
                holders[piece.body] = spec.worldbody.add_body(name=piece.body)
            geom = holders[piece.body].add_geom(name=piece.name, type=KINDS[piece.kind])
            geom.contype = geom.conaffinity = int(piece.collides)
            geom.rgba = (0.5, 0.5, 0.5, float(piece.drawn))
            if piece.name in parts:
                geom.meshname = STAND_IN
            elif piece.name in moving:
                mesh = moving[piece.name]
                fill_mesh(spec.add_mesh(name=piece.name), mesh.vertices, mesh.faces)
                geom.meshname = piece.name
            else:
                place = _place_of(_own_pose(piece.pose, found.bodies.get(piece.body)))
                geom.pos = place["pos"]
                geom.quat = place["quat"]
                if piece.heights is None:
                    last = float(piece.kind == "plane")  # MuJoCo wants the spacing of its lines
                    geom.size = (*piece.size, last, 0.0)[:3]
                else:
                    rows, cols = piece.heights.shape
                    field = spec.add_hfield(name=piece.name, nrow=rows, ncol=cols)
                    field.size = piece.size
                    field.userdata = piece.heights.ravel()
                    geom.hfieldname = piece.name
        return compile_geometry(spec, ground, warnings)

    model = compile_model(path, warnings, build)
    kind = mujoco.mjtObj.mjOBJ_GEOM
    return model, {mujoco.mj_name2id(model, kind, name): part for name, part in parts.items()}


def _own_pose(pose: Float, body: ParsedBody | None) -> Float:
    """A pose in the frame of a body; in the world's without."""
    return pose if body is None else np.asarray(np.linalg.solve(body.pose, pose))


def _place_of(pose: Float) -> dict[str, Float]:
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(pose[:3, :3]).ravel())
    return {"pos": pose[:3, 3], "quat": quat}


def _place(meshes: Sequence[Mesh], poses: Float, decimals: int | None) -> Mesh:
    """Meshes at poses, shape (n, 4, 4), as one."""
    counts = [len(mesh.vertices) for mesh in meshes]
    owner = np.repeat(np.arange(len(meshes)), counts)
    turns = poses[:, :3, :3]
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    vertices = (turns[owner] @ vertices[:, :, None])[:, :, 0] + poses[owner, :3, 3]
    if decimals is not None:
        vertices = np.round(vertices, decimals) + 0.0  # no -0.0
    faces = np.concatenate([mesh.faces for mesh in meshes])
    owner = np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes])
    mirrors = np.linalg.det(turns)[owner] < 0  # which turn every triangle over
    faces[mirrors] = faces[mirrors, ::-1]
    first = (np.cumsum(counts) - counts).astype(np.int32)
    return Mesh(vertices, faces + first[owner, None])


def merge_geoms(found: ParsedScene, path: Path, warnings: list[str]) -> list[ParsedGeom]:
    """Make meshes of static pieces with a common body, or a common path, until few are left.

    Where most stand together goes first. Such a mesh has the name of what they have in common, and
    a warning says so. What moves, planes and height fields stay.
    """
    pieces = found.pieces
    if len(pieces) <= MERGE_ABOVE:
        return pieces
    stays = [p.body in found.bodies or p.kind in ("plane", "hfield") for p in pieces]
    # a piece stands in its body, a body in what its path names before its last "/"
    owners = [f"{piece.body}\0{number}" for number, piece in enumerate(pieces)]
    while len(left := set(owners)) > MERGE_DOWN_TO:
        count = Counter(map(_above, left))
        num = len(left)
        chosen = set[str]()
        for name, size in count.most_common():
            if num <= MERGE_DOWN_TO or (size == 1 and chosen):
                break
            chosen.add(name)
            num -= size - 1
        chosen = chosen if num < len(left) else set(count)
        owners = [above if (above := _above(name)) in chosen else name for name in owners]
    groups: dict[tuple[Any, ...], list[ParsedGeom]] = {}
    for number, (piece, owner) in enumerate(zip(pieces, owners, strict=True)):
        alone = stays[number] or "\0" in owner
        key = (number,) if alone else (owner, piece.collides, piece.drawn)
        groups.setdefault(key, []).append(piece)
    merged = [
        group[0] if len(key) == 1 else _merge(str(key[0]), group, found.decimals)
        for key, group in groups.items()
    ]
    what = f"of more than {MERGE_ABOVE}, those that stand together count as one mesh"
    text = f"{what}, by the name that they share; {len(merged)} are left"
    warnings.append(f"{path} has {len(pieces)} pieces of geometry: {text}")
    return merged


def _above(name: str) -> str:
    return name.rpartition("\0" if "\0" in name else "/")[0] or "/"


def _merge(name: str, group: Sequence[ParsedGeom], decimals: int | None) -> ParsedGeom:
    known: dict[Any, Mesh] = {}
    meshes = list[Mesh]()
    for piece in group:
        key = (piece.kind, piece.size, piece.mode, id(piece.mesh))
        if key not in known:
            mesh = piece.mesh or tessellate(piece.kind, piece.size)
            hull = hull_faces(mesh.vertices) if piece.mode == "hull" else None
            known[key] = mesh if hull is None else Mesh(mesh.vertices, hull)
        meshes.append(known[key])
    mesh = _place(meshes, np.stack([piece.pose for piece in group]), decimals)
    rights = group[0].collides, group[0].drawn
    return ParsedGeom(name, name, "mesh", (), np.eye(4), mesh, None, "surface", *rights)


# ---------------------------------------------------------------- specs


def model_of_meshes(
    parts: list[NamedMesh], path: Path, ground: float | None, warnings: list[str]
) -> tuple[Any, dict[int, NamedMesh]]:
    """A model with mesh parts' names, and the parts by geom id.

    Each is a static body with one geom, which can't collide. It is a tetrahedron, as MuJoCo would
    compile the part's triangles for many seconds.
    """

    def build() -> Any:
        spec = mujoco.MjSpec()
        for part in parts:
            fill_mesh(spec.add_mesh(name=part.name), *TETRAHEDRON)
            body = spec.worldbody.add_body(name=part.name)
            geom = body.add_geom(name=part.name, type=mujoco.mjtGeom.mjGEOM_MESH)
            geom.meshname = part.name
            geom.contype = 0
            geom.conaffinity = 0
        return compile_geometry(spec, ground, warnings)

    model = compile_model(path, warnings, build)
    return model, {int(model.geom(part.name).id): part for part in parts}


def compile_model(path: Path, warnings: list[str], load: Callable[[], Any], hint: str = "") -> Any:
    """Call `load`; MuJoCo's error is raised as a SceneError, with its warnings."""
    try:
        return load()
    except (ConfigError, SceneError):
        raise
    except Exception as error:  # mujoco raises ValueError, FatalError and UnexpectedError
        said = [*str(error).splitlines(), *(w.removeprefix(BY_MUJOCO) for w in warnings)]
        lines = dict.fromkeys(" ".join(line.split()) for line in said or [type(error).__name__])
        reason = "; ".join(line for line in lines if line)  # each once, in order
        reason = reason.removeprefix("Error: ").removeprefix("XML Error: ")
        hint = "" if lacked_memory(error) else hint
        raise SceneError(f"MuJoCo cannot load {path}: {reason[:400]}{hint}") from error


def compile_spec(spec: Any, ground: float | None, warnings: list[str]) -> Any:
    """Compile a spec; what MuJoCo warns of is added to `warnings`.

    Endless ground is added at a height, under a name that nothing else has.
    """
    for mesh in spec.meshes:
        # Geoms of type sdf collide by a field of distances in an octree, which takes 0.2 s a mesh
        # to fill. They count by their triangles here. Older MuJoCos fill it always.
        if hasattr(mesh, "octree_maxdepth"):
            mesh.octree_maxdepth = 0
    if ground is not None:
        name = unique_name("ground", {thing.name for thing in (*spec.geoms, *spec.bodies)})
        body = spec.worldbody.add_body(name=name, pos=(0.0, 0.0, ground))
        # it collides with nothing, so that `scene.geoms: auto` judges the scene's own geoms
        plane = mujoco.mjtGeom.mjGEOM_PLANE
        body.add_geom(name=name, type=plane, size=(0, 0, 1), contype=0, conaffinity=0)
    with python_warnings.catch_warnings(record=True) as said:  # MjSpec warns by Python's means
        python_warnings.simplefilter("always")
        model = spec.compile()
    texts = [f"{BY_MUJOCO}{each.message}" for each in said]
    warnings.extend(text for text in texts if text not in warnings)
    return model


def compile_geometry(spec: Any, ground: float | None, warnings: list[str]) -> Any:
    """Compile a spec with any masses and inertias, which a bake does not need."""
    spec.compiler.balanceinertia = True
    spec.compiler.boundmass = max(spec.compiler.boundmass, 1e-6)
    spec.compiler.boundinertia = max(spec.compiler.boundinertia, 1e-6)
    return compile_spec(spec, ground, warnings)


def fill_mesh(mesh: Any, vertices: Float, faces: Int | Int32) -> None:
    spare = np.repeat(vertices[-1:], max(0, 4 - len(vertices)), axis=0)  # MuJoCo wants four
    mesh.uservert = np.concatenate([vertices, spare]).astype(np.float32).ravel()
    mesh.userface = faces.astype(np.int32).ravel()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # it need not be closed


@contextmanager
def catch_warnings() -> Iterator[list[str]]:
    """Yield a list that receives MuJoCo's warnings, each after `BY_MUJOCO`.

    Without this, MuJoCo writes them to ./MUJOCO_LOG.TXT.
    """
    with _WARNING_LOCK:
        before = mujoco.get_mju_user_warning()
        warnings: list[str] = []
        mujoco.set_mju_user_warning(lambda text: warnings.append(f"{BY_MUJOCO}{text}"))
        try:
            yield warnings
        finally:
            mujoco.set_mju_user_warning(before)
