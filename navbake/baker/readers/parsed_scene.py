"""Parsed scenes, which readers return, and how MuJoCo's models are built from them and compiled.

USD, SDF and building files become a model of MuJoCo, so that doors, poses, `scene.geoms`, updates,
checks and batches work with them like with MJCF. Solids and height fields are MuJoCo's own. Meshes
that never move are stored exactly, outside of the model, which has a tetrahedron for each.

The time that MjSpec takes to add a body grows with the number of bodies: 10,000 bodies take 1.4 s,
100,000 take minutes. So if a scene has more than `MAX_UNMERGED_GEOMS` geoms, static geoms with a
common parent are merged into one mesh, until about `NUM_MERGED_GROUPS` are left.
"""

from __future__ import annotations

import threading
import warnings as python_warnings
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from navbake.baker.geometry.shapes import Mesh, hull_faces, tessellate
from navbake.baker.readers.mesh import MAX_COORDINATE, NamedMesh, check_mesh, is_beyond_limit
from navbake.errors import ConfigError, NavbakeError, SceneError
from navbake.known_names import list_first, unique_name
from navbake.processes import is_lack_of_memory
from navbake.threads import baking
from navbake.types import Float, Int, Int32

# The model has this mesh in place of each that is stored exactly outside of the model
TETRAHEDRON = Mesh(
    vertices=np.eye(4, 3),
    faces=np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], dtype=np.int32),
)
PLACEHOLDER_NAME = "mesh"  # the name of the tetrahedron
MUJOCO_PREFIX = "MuJoCo: "  # navbake puts this before MuJoCo's warnings
_WARNING_LOCK = threading.Lock()  # all threads share MuJoCo's one hook for warnings
MAX_UNMERGED_GEOMS = 10_000  # static geoms are merged if a scene has more geoms than this
NUM_MERGED_GROUPS = 3000  # merging stops at this number of groups
MAX_GEOMS = 2_000_000  # the most geoms in a scene, where each instance counts
# Names in MuJoCo's XML -> MuJoCo's constants
GEOM_TYPES = {
    name: getattr(mujoco.mjtGeom, f"mjGEOM_{name.upper()}")
    for name in ("plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")
}
JOINT_TYPES = {
    name: getattr(mujoco.mjtJoint, f"mjJNT_{name.upper()}")
    for name in ("hinge", "slide", "ball", "free")
}


class ParsedGeom(NamedTuple):
    """A shape of a scene file, which becomes one geom of MuJoCo's model.

    Attributes:
        name: the shape's name, not necessarily unique.
        body: the name of the body that it belongs to.
        kind: one of `GEOM_TYPES`.
        size: the size as MuJoCo states it [m]; empty for a mesh.
        pose: from the geom's frame to the world, (4, 4) [m]; a mesh's may also scale.
        mesh: the triangles of a mesh, in the geom's frame; None for a solid.
        heights: the heights of a height field, from 0 to 1, row 0 at the smallest y; else None.
        mode: how a mesh counts with `scene.meshes: auto`: ``surface`` or ``hull``.
        collides: whether the geom can collide.
        drawn: whether the geom is drawn.
    """

    name: str
    body: str
    kind: str
    size: tuple[float, ...]
    pose: Float
    mesh: Mesh | None = None
    heights: Float | None = None
    mode: str = "surface"
    collides: bool = True
    drawn: bool = True


class ParsedJoint(NamedTuple):
    """A joint between a body and its parent; coordinates are in the world, in the initial pose.

    Attributes:
        name: the joint's name.
        kind: one of `JOINT_TYPES`.
        anchor: a point on the axis of rotation, (3,) [m].
        axis: the axis that the body rotates about, or slides along, (3,).
        limits: lowest and highest position [m or rad]; None if there are no limits.
        position: the joint's position in the initial pose [m or rad].
    """

    name: str
    kind: str
    anchor: Float
    axis: Float
    limits: tuple[float, float] | None = None
    position: float = 0.0


class ParsedBody(NamedTuple):
    """A body that moves, or is fixed to a body that moves.

    Attributes:
        name: the body's name.
        parent: the parent body's name; empty for the world.
        pose: from the body's frame to the world, rigid, (4, 4) [m].
        joint: how the body moves relative to its parent; None if it is fixed to it.
    """

    name: str
    parent: str
    pose: Float
    joint: ParsedJoint | None


@dataclass
class ParsedScene:
    """The content of a scene file, as a reader parses it.

    Attributes:
        geoms: all shapes.
        bodies: name -> body, for bodies that move or are fixed to a body that moves, parents first.
            All other bodies never move.
        warnings: messages of one line.
        decimals: the number of decimals that coordinates in metres are rounded to; None to keep
            all.
        named_leaves: names of the bodies that are leaves of doors, as the file says.
        empty_bodies: names of bodies that the file has, but that are left out because settings
            exclude them and their files are missing or broken. Patterns of names match them
            nevertheless.
    """

    geoms: list[ParsedGeom] = field(default_factory=list)
    bodies: dict[str, ParsedBody] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    decimals: int | None = None
    named_leaves: set[str] = field(default_factory=set)
    empty_bodies: set[str] = field(default_factory=set)


def check_geom_count(num_geoms: int, path: Path) -> None:
    """Raise an error if a scene has too many geoms: nested instances of models can make millions.

    Args:
        num_geoms: the number of geoms so far, plus the number of models that contain them.
        path: the scene's path, for the error.

    Raises:
        SceneError: there are more than `MAX_GEOMS`.
    """
    if num_geoms > MAX_GEOMS:
        excess_text = f"more than {MAX_GEOMS:,} pieces and models, each instance counted"
        raise SceneError(
            f"{path} has {excess_text}, the most that navbake reads: bake a part of it"
        )


@contextmanager
def convert_read_errors(source_text: str) -> Iterator[None]:
    """Convert errors inside a with statement to SceneErrors that say what was being read.

    navbake's own errors, OSError and MemoryError are not converted. Numbers that are too large for
    numpy's arithmetic make no warning: results that are not finite are refused later.

    Args:
        source_text: the name of the thing that is read, such as ``prim /World of room.usda``.
    """
    try:
        with np.errstate(all="ignore"):
            yield
    except (NavbakeError, OSError, MemoryError):
        raise
    except Exception as error:  # a value of the wrong type, a solver that fails, …
        reason = " ".join(f"{type(error).__name__} {error}".split())[:300]
        raise SceneError(f"cannot read {source_text}: {reason}") from error


class JointTree:
    """A tree of bodies and the joints between them.

    Args:
        poses: name -> rigid pose in the world, (4, 4) [m], for all bodies that may move.
    """

    def __init__(self, poses: Mapping[str, Float]) -> None:
        self._poses = poses
        # Child's name -> its parent's name (empty for the world), and -> the joint between them
        self._parents: dict[str, str] = {}
        self._joints: dict[str, ParsedJoint | None] = {}

    def attach(self, parent: str, child: str, joint: ParsedJoint | None) -> bool:
        """Make a body the child of another body, or of the world.

        Args:
            parent: the parent's name; empty for the world.
            child: the body's name.
            joint: how the child moves relative to the parent; None if it is fixed to it.

        Returns:
            Whether the child was attached. It is not attached if it has a parent already, or if it
            is the parent or one of the parent's ancestors.
        """
        ancestor = parent
        while ancestor and ancestor != child:
            ancestor = self._parents.get(ancestor, "")
        if child in self._parents or ancestor == child:
            return False
        self._parents[child] = parent
        self._joints[child] = joint
        return True

    def is_attached(self, name: str) -> bool:
        """Return whether a body is the child of another body, or of the world."""
        return name in self._parents

    def make_bodies(self, fixed_names: Collection[str] = ()) -> dict[str, ParsedBody]:
        """Return name -> body, for bodies that move or are fixed to a moving body, parents first.

        A body that was not attached gets a free joint, unless `fixed_names` names it.

        Args:
            fixed_names: names of bodies that don't move if they are not attached.
        """
        zero_vector = np.zeros(3)
        for name in self._poses:
            if name not in self._parents:
                joint = (
                    None
                    if name in fixed_names
                    else ParsedJoint(name, "free", zero_vector, zero_vector)
                )
                self._parents[name] = ""
                self._joints[name] = joint
        bodies: dict[str, ParsedBody] = {}
        remaining_names = dict.fromkeys(self._poses)
        while remaining_names:
            for name in [
                name for name in remaining_names if self._parents[name] not in remaining_names
            ]:
                del remaining_names[name]
                parent = self._parents[name]
                joint = self._joints[name]
                if joint is not None or parent in bodies:
                    parent = parent if parent in bodies else ""
                    bodies[name] = ParsedBody(name, parent, self._poses[name], joint)
        return bodies


# ---------------------------------------------------------------- models of parsed scenes


def build_model(
    parsed_scene: ParsedScene, path: Path, ground: float | None, warnings: list[str]
) -> tuple[mujoco.MjModel, dict[int, NamedMesh]]:
    """Build and compile a model of a parsed scene.

    Args:
        parsed_scene: the scene that a reader parsed.
        path: the scene's path, for errors.
        ground: z of the endless ground that `scene.ground` adds [m]; None for no ground.
        warnings: the list to which warnings are added.

    Returns:
        The model; and geom id -> exact mesh in the world frame, for the meshes that never move. The
        model has a tetrahedron in place of each of these.

    Raises:
        SceneError: there is no geometry, or MuJoCo can't compile the model.
    """
    warnings += parsed_scene.warnings
    bodies = parsed_scene.bodies
    used_names = set[str]()
    static_meshes = dict[str, NamedMesh]()
    moving_meshes = dict[str, NamedMesh]()
    geoms = list[ParsedGeom]()
    stray_names = list[str]()
    for geom in merge_geoms(parsed_scene, path, warnings):
        geom = geom._replace(name=unique_name(geom.name, used_names))
        body = bodies.get(geom.body)
        if geom.kind == "plane" and any(geom.size) and body is not None:
            # MuJoCo allows planes on static bodies only.
            geom = geom._replace(kind="mesh", size=(), mesh=tessellate("plane", geom.size))
        if geom.mesh is not None:
            # The vertices of a moving mesh are stored in the frame of its body.
            pose = _transform_to_body(geom.pose, body)
            mesh = _join_posed_meshes([geom.mesh], pose[None], parsed_scene.decimals)
            named_mesh = NamedMesh(geom.name, mesh.vertices, mesh.faces, geom.mode)
            if is_beyond_limit(named_mesh.vertices):
                stray_names.append(geom.name)
                continue
            named_mesh = check_mesh(named_mesh, path)
            if not len(named_mesh.faces):
                continue
            if body is None:
                static_meshes[geom.name] = named_mesh
            else:
                moving_meshes[geom.name] = named_mesh
        elif is_beyond_limit(geom.pose[None, :3, 3]):
            stray_names.append(geom.name)
            continue
        geoms.append(geom)
    if stray_names:
        names_text = list_first([repr(name) for name in stray_names], max_names=5)
        warnings.append(
            f"geom {names_text} of {path} left out: it lies beyond {MAX_COORDINATE:g} m"
        )
    if stray_names and not geoms:
        problem_text = f"all geometry lies beyond {MAX_COORDINATE:g} m, as {stray_names[0]!r}"
        raise SceneError(f"{problem_text} of {path}: check its poses and units")
    if not geoms:
        reasons_text = "".join(f"; {warning}" for warning in parsed_scene.warnings)
        problem_text = f"no geometry in {path}: expected at least one mesh or solid"
        raise SceneError(f"{problem_text}{reasons_text}")

    def build() -> mujoco.MjModel:
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        spec_bodies = {"": spec.worldbody}
        for body in bodies.values():
            spec_bodies[body.name] = _add_body(spec_bodies[body.parent], body, bodies)
        if static_meshes:
            fill_mesh(spec.add_mesh(name=PLACEHOLDER_NAME), TETRAHEDRON.vertices, TETRAHEDRON.faces)
        for geom in geoms:
            if geom.body not in spec_bodies:
                spec_bodies[geom.body] = spec.worldbody.add_body(name=geom.body)
            spec_geom = spec_bodies[geom.body].add_geom(name=geom.name, type=GEOM_TYPES[geom.kind])
            spec_geom.contype = int(geom.collides)
            spec_geom.conaffinity = int(geom.collides)
            spec_geom.rgba = (0.5, 0.5, 0.5, float(geom.drawn))
            if geom.name in static_meshes:
                spec_geom.meshname = PLACEHOLDER_NAME
            elif geom.name in moving_meshes:
                mesh = moving_meshes[geom.name]
                fill_mesh(spec.add_mesh(name=geom.name), mesh.vertices, mesh.faces)
                spec_geom.meshname = geom.name
            else:
                _set_solid(spec, spec_geom, geom, bodies.get(geom.body))
        for name in sorted(parsed_scene.empty_bodies - spec_bodies.keys()):
            spec.worldbody.add_body(name=name)
        return compile_geometry(spec, ground, warnings)

    model = compile_model(path, warnings, build)
    exact_meshes = {
        mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, name): mesh
        for name, mesh in static_meshes.items()
    }
    return model, exact_meshes


def _add_body(
    spec_parent: mujoco.MjsBody, body: ParsedBody, bodies: Mapping[str, ParsedBody]
) -> mujoco.MjsBody:
    """Add a body and its joint to the parent's body in a spec."""
    pose = _transform_to_body(body.pose, bodies.get(body.parent))
    spec_body = spec_parent.add_body(name=body.name, pos=pose[:3, 3], quat=_quaternion(pose))
    joint = body.joint
    if joint is None:
        return spec_body
    spec_joint = spec_body.add_joint(name=joint.name, type=JOINT_TYPES[joint.kind])
    if joint.kind != "free":  # MuJoCo states position and axis in the body's frame
        rotation = body.pose[:3, :3]
        spec_joint.pos = (joint.anchor - body.pose[:3, 3]) @ rotation
        spec_joint.axis = joint.axis @ rotation
        spec_joint.ref = joint.position
    if joint.limits is not None:
        spec_joint.range = joint.limits
        spec_joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
    return spec_body


def _set_solid(
    spec: mujoco.MjSpec, spec_geom: mujoco.MjsGeom, geom: ParsedGeom, body: ParsedBody | None
) -> None:
    """Set the pose and the size of a spec's geom: a solid, a plane or a height field."""
    pose = _transform_to_body(geom.pose, body)
    spec_geom.pos = pose[:3, 3]
    spec_geom.quat = _quaternion(pose)
    if geom.heights is None:
        line_spacing = float(geom.kind == "plane")  # MuJoCo wants it for a plane's grid lines
        spec_geom.size = (*geom.size, line_spacing, 0.0)[:3]
        return
    num_rows, num_cols = geom.heights.shape
    height_field = spec.add_hfield(name=geom.name, nrow=num_rows, ncol=num_cols)
    height_field.size = geom.size
    height_field.userdata = geom.heights.ravel()
    spec_geom.hfieldname = geom.name


def _transform_to_body(pose: Float, body: ParsedBody | None) -> Float:
    """Convert a pose from the world frame to the frame of a body; unchanged if body is None."""
    return pose if body is None else np.asarray(np.linalg.solve(body.pose, pose))


def _quaternion(pose: Float) -> Float:
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(pose[:3, :3]).ravel())
    return quaternion


def _join_posed_meshes(meshes: Sequence[Mesh], poses: Float, decimals: int | None) -> Mesh:
    """Join meshes, each moved by its pose, to one mesh.

    Args:
        meshes: n meshes, which are not changed.
        poses: transforms of the meshes; they may scale, mirror or skew, (n, 4, 4).
        decimals: the number of decimals that coordinates are rounded to; None to keep all.
    """
    vertex_counts = [len(mesh.vertices) for mesh in meshes]
    face_counts = [len(mesh.faces) for mesh in meshes]
    matrices = poses[:, :3, :3]
    mesh_of_vertex = np.repeat(np.arange(len(meshes)), vertex_counts)
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    vertices = (matrices[mesh_of_vertex] @ vertices[:, :, None])[:, :, 0]
    vertices = vertices + poses[mesh_of_vertex, :3, 3]
    if decimals is not None:
        vertices = np.round(vertices, decimals) + 0.0  # no -0.0
    mesh_of_face = np.repeat(np.arange(len(meshes)), face_counts)
    faces = np.concatenate([mesh.faces for mesh in meshes])
    is_mirrored = np.linalg.det(matrices)[mesh_of_face] < 0  # this reverses the order of corners
    faces[is_mirrored] = faces[is_mirrored, ::-1]
    first_vertices = (np.cumsum(vertex_counts) - vertex_counts).astype(np.int32)
    return Mesh(vertices, faces + first_vertices[mesh_of_face, None])


# ---------------------------------------------------------------- merging


def merge_geoms(parsed_scene: ParsedScene, path: Path, warnings: list[str]) -> list[ParsedGeom]:
    """Merge static geoms of a scene with more than `MAX_UNMERGED_GEOMS` geoms into meshes.

    Geoms of the same body, or whose bodies' names begin with the same path, are merged, the largest
    groups first. A merged mesh has the name of the body or path. Moving geoms, planes and height
    fields are not merged.

    Args:
        parsed_scene: the scene that a reader parsed.
        path: the scene's path, for the warning.
        warnings: the list to which a warning is added if geoms are merged.

    Returns:
        The geoms after merging; the scene's own list if there are at most `MAX_UNMERGED_GEOMS`.
    """
    geoms = parsed_scene.geoms
    if len(geoms) <= MAX_UNMERGED_GEOMS:
        return geoms
    groups: dict[tuple[object, ...], list[ParsedGeom]] = {}
    for geom_number, (geom, group_name) in enumerate(
        zip(geoms, _find_group_names(geoms), strict=True)
    ):
        is_unmergeable = geom.body in parsed_scene.bodies or geom.kind in ("plane", "hfield")
        is_alone = is_unmergeable or "\0" in group_name
        group_key: tuple[object, ...] = (group_name, geom.collides, geom.drawn)
        if is_alone:
            group_key = (geom_number,)
        groups.setdefault(group_key, []).append(geom)
    merged_geoms = []
    for group_key, group_geoms in groups.items():
        is_alone = len(group_key) == 1
        merged_geoms.append(
            group_geoms[0]
            if is_alone
            else _merge_group(str(group_key[0]), group_geoms, parsed_scene.decimals)
        )
    warnings.append(
        f"{path} has {len(geoms)} pieces of geometry: of more than {MAX_UNMERGED_GEOMS}, those "
        f"that stand together count as one mesh, by the name that they share; {len(merged_geoms)} "
        "are left"
    )
    return merged_geoms


def _find_group_names(geoms: Sequence[ParsedGeom]) -> list[str]:
    r"""Return the name of the group that each geom is merged into.

    At first, each geom is a group of its own, named ``body\0number``. Then groups are merged into
    their parents: a geom's is its body, that of ``a/b`` is ``a``.
    """
    group_names = [f"{geom.body}\0{geom_number}" for geom_number, geom in enumerate(geoms)]
    distinct_names = set(group_names)
    while len(distinct_names) > NUM_MERGED_GROUPS:
        num_children_of_parent = Counter(_parent_name(name) for name in distinct_names)
        num_groups = len(distinct_names)
        merged_parents = set[str]()
        for parent, num_children in num_children_of_parent.most_common():
            if num_groups <= NUM_MERGED_GROUPS or (num_children == 1 and merged_parents):
                break
            merged_parents.add(parent)
            num_groups -= num_children - 1
        if num_groups == len(distinct_names):
            merged_parents = set(num_children_of_parent)
        parent_names = [_parent_name(name) for name in group_names]
        group_names = [
            parent if parent in merged_parents else name
            for name, parent in zip(group_names, parent_names, strict=True)
        ]
        distinct_names = set(group_names)
    return group_names


def _parent_name(name: str) -> str:
    return name.rpartition("\0" if "\0" in name else "/")[0] or "/"


def _merge_group(name: str, group_geoms: Sequence[ParsedGeom], decimals: int | None) -> ParsedGeom:
    """Merge geoms into one geom, a mesh in the world frame.

    Args:
        name: the name of the merged geom and of its body.
        group_geoms: the geoms, which all have the same `collides` and `drawn`.
        decimals: the number of decimals that coordinates are rounded to; None to keep all.
    """
    mesh_of_shape: dict[tuple[object, ...], Mesh] = {}
    meshes = list[Mesh]()
    for geom in group_geoms:
        shape_key = (geom.kind, geom.size, geom.mode, id(geom.mesh))
        if shape_key not in mesh_of_shape:
            mesh = geom.mesh or tessellate(geom.kind, geom.size)
            hull_triangles = hull_faces(mesh.vertices) if geom.mode == "hull" else None
            mesh_of_shape[shape_key] = (
                mesh if hull_triangles is None else Mesh(mesh.vertices, hull_triangles)
            )
        meshes.append(mesh_of_shape[shape_key])
    poses = np.stack([geom.pose for geom in group_geoms])
    return ParsedGeom(
        name=name,
        body=name,
        kind="mesh",
        size=(),
        pose=np.eye(4),
        mesh=_join_posed_meshes(meshes, poses, decimals),
        collides=group_geoms[0].collides,
        drawn=group_geoms[0].drawn,
    )


# ---------------------------------------------------------------- compiling


def build_model_of_meshes(
    meshes: list[NamedMesh], path: Path, ground: float | None, warnings: list[str]
) -> tuple[mujoco.MjModel, dict[int, NamedMesh]]:
    """Compile a model that has a body and a geom for each mesh, with the mesh's name.

    The geoms can't collide, and their shape is a tetrahedron: MuJoCo would need many seconds to
    compile the triangles of the meshes.

    Args:
        meshes: the meshes, which have unique names.
        path: the scene's path, for errors.
        ground: z of the endless ground that `scene.ground` adds [m]; None for no ground.
        warnings: the list to which warnings are added.

    Returns:
        The model; and geom id -> mesh.
    """

    def build() -> mujoco.MjModel:
        spec = mujoco.MjSpec()
        for mesh in meshes:
            fill_mesh(spec.add_mesh(name=mesh.name), TETRAHEDRON.vertices, TETRAHEDRON.faces)
            body = spec.worldbody.add_body(name=mesh.name)
            geom = body.add_geom(name=mesh.name, type=mujoco.mjtGeom.mjGEOM_MESH)
            geom.meshname = mesh.name
            geom.contype = 0
            geom.conaffinity = 0
        return compile_geometry(spec, ground, warnings)

    model = compile_model(path, warnings, build)
    return model, {int(model.geom(mesh.name).id): mesh for mesh in meshes}


def compile_model(
    path: Path, warnings: list[str], load_model: Callable[[], mujoco.MjModel], hint: str = ""
) -> mujoco.MjModel:
    """Call a function that compiles a model, and convert MuJoCo's errors to SceneErrors.

    Args:
        path: the scene's path, for the error.
        warnings: warnings so far, which the error quotes.
        load_model: the function, which returns the model.
        hint: text to add to the error, unless memory was lacking.

    Returns:
        The model.

    Raises:
        SceneError: MuJoCo can't compile the model.
    """
    try:
        return load_model()
    except (ConfigError, SceneError):
        raise
    except Exception as error:  # mujoco raises ValueError, FatalError and UnexpectedError
        messages = str(error).splitlines()
        messages += [warning.removeprefix(MUJOCO_PREFIX) for warning in warnings]
        messages = messages or [type(error).__name__]
        # without repetitions, in order
        distinct_messages = dict.fromkeys(" ".join(message.split()) for message in messages)
        reason = "; ".join(
            distinct_message for distinct_message in distinct_messages if distinct_message
        )
        reason = reason.removeprefix("Error: ").removeprefix("XML Error: ")
        hint = "" if is_lack_of_memory(error) else hint
        raise SceneError(f"MuJoCo cannot load {path}: {reason[:400]}{hint}") from error


def compile_spec(spec: mujoco.MjSpec, ground: float | None, warnings: list[str]) -> mujoco.MjModel:
    """Compile a spec, and collect MuJoCo's warnings.

    Args:
        spec: the spec, which is changed.
        ground: z of an endless ground to add, with a name not yet used [m]; None for no ground.
        warnings: the list to which MuJoCo's warnings are added.

    Returns:
        The compiled model.
    """
    for mesh in spec.meshes:
        # For geoms of type sdf, MuJoCo computes an octree of distances, 0.2 s for each mesh.
        # navbake needs their triangles only. Older versions of MuJoCo have no such option.
        if hasattr(mesh, "octree_maxdepth"):
            mesh.octree_maxdepth = 0
    if ground is not None:
        used_names = {element.name for element in (*spec.geoms, *spec.bodies)}
        name = unique_name("ground", used_names)
        body = spec.worldbody.add_body(name=name, pos=(0.0, 0.0, ground))
        # It collides with nothing, so that `scene.geoms: auto` depends on the scene's own geoms.
        plane_type = mujoco.mjtGeom.mjGEOM_PLANE
        body.add_geom(name=name, type=plane_type, size=(0, 0, 1), contype=0, conaffinity=0)
    # MjSpec uses Python's warnings.
    with python_warnings.catch_warnings(record=True) as recorded_warnings:
        python_warnings.simplefilter("always")
        model = spec.compile()
    warning_texts = [f"{MUJOCO_PREFIX}{warning.message}" for warning in recorded_warnings]
    warnings.extend(text for text in warning_texts if text not in warnings)
    return model


def compile_geometry(
    spec: mujoco.MjSpec, ground: float | None, warnings: list[str]
) -> mujoco.MjModel:
    """Compile a spec even if masses or inertias in it are invalid, as a bake doesn't use them.

    Invalid masses and inertias are corrected before the spec is compiled.

    Args:
        spec: the spec, which is changed.
        ground: z of an endless ground to add [m]; None for no ground.
        warnings: the list to which MuJoCo's warnings are added.

    Returns:
        The compiled model.
    """
    spec.compiler.balanceinertia = True
    spec.compiler.boundmass = max(spec.compiler.boundmass, 1e-6)
    spec.compiler.boundinertia = max(spec.compiler.boundinertia, 1e-6)
    return compile_spec(spec, ground, warnings)


def fill_mesh(mesh: mujoco.MjsMesh, vertices: Float, faces: Int | Int32) -> None:
    """Write triangles to a mesh of a spec. They need not form a closed surface.

    Args:
        mesh: the spec's mesh, which is changed.
        vertices: shape (n, 3) [m].
        faces: indices of vertices, shape (m, 3).
    """
    num_missing = max(0, 4 - len(vertices))  # MuJoCo wants four vertices
    padding = np.repeat(vertices[-1:], num_missing, axis=0)
    mesh.uservert = np.concatenate([vertices, padding]).astype(np.float32).ravel()
    mesh.userface = faces.astype(np.int32).ravel()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # the mesh need not be closed


@contextmanager
def catch_warnings() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings inside a with statement, instead of in ./MUJOCO_LOG.TXT.

    Yields:
        A list that receives the warnings, each with `MUJOCO_PREFIX` before it.
    """
    with baking(), _WARNING_LOCK:
        old_hook = mujoco.get_mju_user_warning()
        warnings: list[str] = []
        mujoco.set_mju_user_warning(lambda text: warnings.append(f"{MUJOCO_PREFIX}{text}"))
        try:
            yield warnings
        finally:
            mujoco.set_mju_user_warning(old_hook)
