"""A compiled and posed MuJoCo model of any scene file; the one user of mujoco."""

from __future__ import annotations

import threading
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from xml.parsers import expat

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.baker.scene.mesh_scene import MESH_SUFFIXES, read_mesh_parts
from navbake.baker.scene.meshes.part import MeshPart
from navbake.baker.scene.names import name_at
from navbake.baker.scene.urdf import read_urdf
from navbake.config.scene import SceneSettings
from navbake.errors import ConfigError, SceneError

XML_SUFFIXES = frozenset({".xml", ".mjcf", ".urdf"})
MJB_SUFFIX = ".mjb"
# How far beyond its range a joint may be told to go, for angles that someone rounded [rad or m]
RANGE_SLACK = 1e-4


@dataclass(frozen=True)
class PosedModel:
    """A scene as MuJoCo has it.

    Attributes:
        model: the mujoco.MjModel.
        data: its mujoco.MjData, all geoms placed.
        parts: the meshes of a mesh scene by geom id, world frame, exact: the model rounds them to
            float32 in frames of its own.
        warnings: what MuJoCo warned of.
        notes: what else the user should know of the pose.
    """

    model: Any
    data: Any
    parts: dict[int, MeshPart]
    warnings: list[str]
    notes: list[str]


def load_model(settings: SceneSettings) -> PosedModel:
    """Load a scene file, compile it and pose it.

    Args:
        settings: the `scene` part of the configuration.

    Raises:
        SceneError: the file is missing or broken.
        ConfigError: the settings ask for a keyframe or joint that isn't there.
    """
    with _catch_warnings() as warnings:
        model, parts = _load_model(settings, warnings)
        data = pose_model(model, settings)
    return PosedModel(model, data, parts, warnings, _find_out_of_range(model, settings))


def mujoco_version() -> str:
    """The installed MuJoCo's version."""
    return str(mujoco.__version__)


@cache
def mujoco_library() -> str:
    """Path of MuJoCo's shared library, whose rays the kernels call."""
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll"):
        for path in sorted(folder.glob(pattern)):
            return str(path)
    raise SceneError(f"MuJoCo's shared library is not in {folder}: reinstall mujoco")


# ---------------------------------------------------------------- loading


def _load_model(settings: SceneSettings, warnings: list[str]) -> tuple[Any, dict[int, MeshPart]]:
    """The compiled model, and its meshes by geom id where they are known exactly."""
    path = Path(settings.path)
    try:
        if not path.exists():
            raise SceneError(f"no scene file at {path}")
        if not path.is_file():
            kind = "folder" if path.is_dir() else "device"
            raise SceneError(f"expected a scene file, got a {kind} at {path}")
        suffix = path.suffix.lower()
        if suffix in MESH_SUFFIXES:
            parts = read_mesh_parts(path, settings.up, settings.unit)
            model = _compile(path, warnings, lambda: _build_model(parts))
            return model, {int(model.geom(part.name).id): part for part in parts}
        if suffix == MJB_SUFFIX:
            return _load_mjb(path, warnings), {}
        if suffix in XML_SUFFIXES:
            return _load_xml(path, warnings), {}
    except OSError as error:
        raise SceneError(f"cannot read {path}: {error.strerror or error}") from error
    known = ", ".join(sorted({MJB_SUFFIX} | XML_SUFFIXES | MESH_SUFFIXES))
    raise SceneError(f"cannot tell what {path} is: expected one of {known}")


def _load_mjb(path: Path, warnings: list[str]) -> Any:
    try:
        return _compile(path, warnings, lambda: mujoco.MjModel.from_binary_path(str(path)))
    except SceneError as error:
        raise SceneError(
            f"{error} (an MJB fits only the MuJoCo that wrote it, this is {mujoco_version()}: "
            f"save it again, or bake its XML)"
        ) from error


def _load_xml(path: Path, warnings: list[str]) -> Any:
    if path.stat().st_size == 0:
        raise SceneError(f"{path} is empty: expected an MJCF or URDF scene")
    root = _peek_root(path)
    if root == "robot":
        urdf = read_urdf(path)
        return _compile(path, warnings, lambda: _build_urdf(urdf.text, urdf.meshes))
    if root not in ("mujoco", ""):
        raise SceneError(f"expected <mujoco> or <robot> in {path}, got <{root[:40]}>")
    try:  # MuJoCo's parser is the judge of MJCF, also where Python's is stricter
        return _compile(path, warnings, lambda: mujoco.MjModel.from_xml_path(str(path)))
    except SceneError as error:
        problem = _find_xml_problem(path)
        if problem:
            raise SceneError(f"broken XML in {path}: {problem}") from error
        raise


def _peek_root(path: Path) -> str:
    """The tag of an XML file's root; empty where Python's parser doesn't get that far."""
    try:
        for _, element in ElementTree.iterparse(path, events=("start",)):
            return str(element.tag)
    except (ElementTree.ParseError, ValueError, LookupError):
        pass
    return ""


def _find_xml_problem(path: Path) -> str:
    """What keeps a file from being XML, and where; empty if nothing does."""
    try:
        with path.open("rb") as file:
            expat.ParserCreate().ParseFile(file)
    except (expat.ExpatError, ValueError, LookupError) as error:
        return str(error)
    return ""


def _compile(path: Path, warnings: list[str], load: Callable[[], Any]) -> Any:
    try:
        return load()
    except SceneError:
        raise
    except Exception as error:  # mujoco raises ValueError, FatalError and UnexpectedError
        lines = [*str(error).splitlines(), *warnings] or [type(error).__name__]
        reason = "; ".join(" ".join(line.split()) for line in lines if line.strip())
        reason = reason.removeprefix("Error: ").removeprefix("XML Error: ")
        raise SceneError(f"MuJoCo cannot load {path}: {reason[:400]}") from error


def _build_model(parts: list[MeshPart]) -> Any:
    """A model of mesh parts: one static body and geom a part, which can't collide."""
    spec = mujoco.MjSpec()
    for part in parts:
        center = (part.vertices.min(axis=0) + part.vertices.max(axis=0)) / 2
        _fill_mesh(spec.add_mesh(name=part.name), part.vertices - center, part.faces)
        body = spec.worldbody.add_body(name=part.name, pos=center)
        body.add_geom(
            name=part.name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=part.name,
            contype=0,
            conaffinity=0,
        )
    return _compile_for_its_shape(spec)


def _build_urdf(text: str, files: dict[str, Path]) -> Any:
    """A model of a URDF, its meshes read as mesh scenes are, whatever their format."""
    spec = mujoco.MjSpec.from_string(text)
    read: dict[str, tuple[NDArray[np.float64], NDArray[np.int64]]] = {}
    for mesh in spec.meshes:
        if mesh.file not in read:
            read[mesh.file] = _join_parts(read_mesh_parts(files[mesh.file]))
        vertices, faces = read[mesh.file]
        mesh.file = ""
        _fill_mesh(mesh, vertices, faces)
    return _compile_for_its_shape(spec)


def _compile_for_its_shape(spec: Any) -> Any:
    """Compile a spec whatever its masses and inertias are, because they don't matter here."""
    spec.compiler.balanceinertia = True
    spec.compiler.boundmass = max(spec.compiler.boundmass, 1e-6)
    spec.compiler.boundinertia = max(spec.compiler.boundinertia, 1e-6)
    return spec.compile()


def _join_parts(parts: list[MeshPart]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, first, strict=False)]
    return np.concatenate([part.vertices for part in parts]), np.concatenate(faces)


def _fill_mesh(mesh: Any, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> None:
    spare = np.repeat(vertices[-1:], max(0, 4 - len(vertices)), axis=0)  # MuJoCo wants four
    mesh.uservert = np.concatenate([vertices, spare]).astype(np.float32).ravel()
    mesh.userface = faces.astype(np.int32).ravel()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # it need not be closed


_WARNING_LOCK = threading.Lock()


@contextmanager
def _catch_warnings() -> Iterator[list[str]]:
    """Collect what MuJoCo warns of; otherwise it goes to stderr and ./MUJOCO_LOG.TXT."""
    with _WARNING_LOCK:
        before = mujoco.get_mju_user_warning()
        warnings: list[str] = []
        mujoco.set_mju_user_warning(warnings.append)
        try:
            yield warnings
        finally:
            mujoco.set_mju_user_warning(before)


# ---------------------------------------------------------------- posing


def pose_model(model: Any, settings: SceneSettings) -> Any:
    """The model's data, with all geoms placed by the keyframe and the joint values asked for.

    Raises:
        ConfigError: there is no such keyframe or joint.
        SceneError: MuJoCo can't place the geoms.
    """
    try:
        data = mujoco.MjData(model)
        if settings.keyframe is not None:
            mujoco.mj_resetDataKeyframe(model, data, _keyframe_id(model, settings))
        for name, value in settings.joints.items():
            _set_joint(model, data, settings, name, value)
        mujoco.mj_kinematics(model, data)
    except (mujoco.FatalError, mujoco.UnexpectedError, ValueError) as error:
        reason = " ".join(str(error).split())[:400]
        raise SceneError(f"MuJoCo cannot pose {settings.path}: {reason}") from error
    return data


def _keyframe_id(model: Any, settings: SceneSettings) -> int:
    key = settings.keyframe
    if isinstance(key, int):
        if key < model.nkey:
            return key
        raise ConfigError(
            f"no keyframe {key} for `scene.keyframe`: {settings.path} has {model.nkey} of them, "
            f"counted from 0"
        )
    found = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, key)
    if found >= 0:
        return int(found)
    names = _listed(model, model.name_keyadr)
    raise ConfigError(f"no keyframe {key!r} for `scene.keyframe`: {settings.path} has {names}")


def _set_joint(
    model: Any, data: Any, settings: SceneSettings, name: str, value: float | list[float]
) -> None:
    joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
    if joint < 0:
        names = _listed(model, model.name_jntadr)
        raise ConfigError(f"no joint {name!r} for `scene.joints`: {settings.path} has {names}")
    kind = mujoco.mjtJoint(model.jnt_type[joint])
    expected = {
        mujoco.mjtJoint.mjJNT_FREE: "7 numbers (x, y, z [m], quaternion w, x, y, z)",
        mujoco.mjtJoint.mjJNT_BALL: "4 numbers (quaternion w, x, y, z)",
        mujoco.mjtJoint.mjJNT_SLIDE: "1 number [m]",
        mujoco.mjtJoint.mjJNT_HINGE: "1 number [rad]",
    }[kind]
    values = np.atleast_1d(np.asarray(value, dtype=np.float64))
    if len(values) != int(expected[0]):
        raise ConfigError(f"expected {expected} at `scene.joints.{name}`, got {len(values)}")
    if len(values) >= 4 and not values[-4:].any():
        raise ConfigError(f"expected a quaternion that is not 0 at `scene.joints.{name}`")
    address = int(model.jnt_qposadr[joint])
    data.qpos[address : address + len(values)] = values


def _find_out_of_range(model: Any, settings: SceneSettings) -> list[str]:
    """Tell which joints the settings put where they can't go."""
    notes = []
    for name, value in settings.joints.items():
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        unit = {mujoco.mjtJoint.mjJNT_SLIDE: "m", mujoco.mjtJoint.mjJNT_HINGE: "rad"}.get(
            mujoco.mjtJoint(model.jnt_type[joint])
        )
        if unit is None or not model.jnt_limited[joint]:
            continue
        position = float(np.atleast_1d(np.asarray(value, dtype=np.float64))[0])
        low, high = (float(v) for v in model.jnt_range[joint])
        if not low - RANGE_SLACK <= position <= high + RANGE_SLACK:
            notes.append(
                f"joint {name!r} ranges from {low:.6g} to {high:.6g} {unit}, got {position:.6g} "
                f"at `scene.joints.{name}`: it is posed there all the same"
            )
    return notes


def _listed(model: Any, addresses: NDArray[np.int32]) -> str:
    named = [name for address in addresses if (name := name_at(model, address))]
    if not named:
        return "none with a name"
    return ", ".join(named[:20]) + (f" and {len(named) - 20} more" if len(named) > 20 else "")


def data_of_qpos(model: Any, qpos: ArrayLike) -> Any:
    """A model's data with all joints at given positions, all geoms placed.

    Args:
        model: the mujoco.MjModel.
        qpos: positions, shape (nq,).

    Raises:
        ConfigError: there are more or fewer joint positions.
    """
    try:
        positions = np.asarray(qpos, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"expected {model.nq} joint positions (nq), got {qpos!r}") from error
    if positions.shape != (model.nq,):
        raise ConfigError(f"expected {model.nq} joint positions (nq), got {positions.shape}")
    data = mujoco.MjData(model)
    data.qpos[:] = positions
    mujoco.mj_kinematics(model, data)
    return data


def data_with_joints(model: Any, data: Any, positions: Mapping[int, float]) -> Any:
    """A copy of a model's data with hinges and slides moved, all geoms placed anew.

    Args:
        model: the mujoco.MjModel.
        data: its mujoco.MjData; not changed.
        positions: where joints go, by their ids [rad or m].
    """
    moved = mujoco.MjData(model)
    moved.qpos[:] = data.qpos
    moved.mocap_pos[:] = data.mocap_pos
    moved.mocap_quat[:] = data.mocap_quat
    for joint, position in positions.items():
        moved.qpos[model.jnt_qposadr[joint]] = position
    mujoco.mj_kinematics(model, moved)
    return moved
