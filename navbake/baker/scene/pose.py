"""Poses of a compiled model: keyframes and joint values, checked against its joints."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from navbake.baker.core.constants import BALL, FREE, HINGE, SLIDE
from navbake.baker.scene.names import names_at
from navbake.config.settings import SceneSettings
from navbake.errors import ConfigError, SceneError
from navbake.known_names import list_first
from navbake.types import Int32

# How far beyond its range a joint may go, for rounded angles [rad or m]
RANGE_SLACK = 1e-4
EXPECTED = {
    FREE: "7 numbers (x, y, z [m], quaternion w, x, y, z)",
    BALL: "4 numbers (quaternion w, x, y, z)",
    SLIDE: "1 number [m]",
    HINGE: "1 number [rad]",
}


def pose_model(model: Any, settings: SceneSettings) -> Any:
    """The model's data, with all geoms placed by the keyframe and the joint values of settings."""

    def id_of(name: str, kind: str, setting: str, code: int, addresses: Int32) -> int:
        """The id of a keyframe or joint; raises a ConfigError that lists those that there are."""
        named = [known for known in names_at(model, addresses.tolist()) if known]
        if name in named:
            return int(mujoco.mj_name2id(model, code, name))
        listed = list_first(named, 20) or "none with a name"
        raise ConfigError(f"no {kind} {name!r} for `scene.{setting}`: {settings.path} has {listed}")

    data = mujoco.MjData(model)
    kinds = mujoco.mjtObj
    with _errors_of(f"pose {settings.path}"):
        key = settings.keyframe
        if isinstance(key, int) and key >= model.nkey:
            has = f"{settings.path} has {model.nkey} of them, counted from 0"
            raise ConfigError(f"no keyframe {key} for `scene.keyframe`: {has}")
        if isinstance(key, str):
            key = id_of(key, "keyframe", "keyframe", kinds.mjOBJ_KEY, model.name_keyadr)
        if key is not None:
            mujoco.mj_resetDataKeyframe(model, data, key)
        for name, value in settings.joints.items():
            joint = id_of(name, "joint", "joints", kinds.mjOBJ_JOINT, model.name_jntadr)
            expected = EXPECTED[int(model.jnt_type[joint])]
            values = np.atleast_1d(np.asarray(value, dtype=np.float64))
            where = f"at `scene.joints.{name}`"
            if len(values) != int(expected[0]):
                raise ConfigError(f"expected {expected} {where}, got {len(values)}")
            if len(values) >= 4 and not values[-4:].any():
                raise ConfigError(f"expected a quaternion that is not 0 {where}")
            address = int(model.jnt_qposadr[joint])
            data.qpos[address : address + len(values)] = values
        mujoco.mj_kinematics(model, data)
    return data


@contextmanager
def _errors_of(what: str) -> Iterator[None]:
    """Raise MuJoCo's errors as a SceneError that says what it can't do."""
    try:
        yield
    except (mujoco.FatalError, mujoco.UnexpectedError, ValueError) as error:
        reason = " ".join(str(error).split())[:400]
        raise SceneError(f"MuJoCo cannot {what}: {reason}") from error


def warn_out_of_range(model: Any, settings: SceneSettings) -> list[str]:
    """Warn of joints that the settings move out of their range."""
    notes = []
    for name, value in settings.joints.items():
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        low, high = (float(v) for v in model.jnt_range[joint])
        position = float(np.ravel(value)[0])
        unit = {SLIDE: "m", HINGE: "rad"}
        is_within = low - RANGE_SLACK <= position <= high + RANGE_SLACK
        kind = int(model.jnt_type[joint])
        if kind in unit and model.jnt_limited[joint] and not is_within:
            ranges = f"ranges from {low:.6g} to {high:.6g} {unit[kind]}, got {position:.6g}"
            posed = f"at `scene.joints.{name}`: it is posed there anyway"
            notes.append(f"joint {name!r} {ranges} {posed}")
    return notes


def data_of_qpos(model: Any, qpos: ArrayLike) -> Any:
    """A model's data with all joints at positions of shape (nq,), and all geoms placed."""
    wanted = f"expected {model.nq} joint positions (nq)"
    try:
        positions = np.asarray(qpos, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{wanted}, got {qpos!r}") from error
    if positions.shape != (model.nq,):
        raise ConfigError(f"{wanted}, got {positions.shape}")
    data = mujoco.MjData(model)
    data.qpos[:] = positions
    mujoco.mj_kinematics(model, data)
    return data


def data_with_joints(model: Any, data: Any, positions: Mapping[int, float]) -> Any:
    """A copy of a model's data with hinges and slides moved, by their ids [rad or m]."""
    moved = mujoco.MjData(model)
    moved.qpos[:] = data.qpos
    moved.mocap_pos[:] = data.mocap_pos
    moved.mocap_quat[:] = data.mocap_quat
    for joint, position in positions.items():
        moved.qpos[model.jnt_qposadr[joint]] = position
    mujoco.mj_kinematics(model, moved)
    return moved


def place_geoms(model: Any, data: Any) -> None:
    """Place all geoms of a data by its joint positions and mocap bodies."""
    with _errors_of("take the pose"):
        mujoco.mj_kinematics(model, data)
