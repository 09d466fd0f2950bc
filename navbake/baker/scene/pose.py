"""Poses compiled models by keyframes, joint values of the settings, or all joint positions."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from navbake.baker.core.constants import BALL, FREE, HINGE, SLIDE
from navbake.baker.scene.names import find_joint_of_body, name_at, names_at
from navbake.config.settings import SceneSettings
from navbake.errors import ConfigError, SceneError
from navbake.known_names import list_first
from navbake.types import Int32

# A joint may be this far out of its range without a warning: angles are rounded [rad or m]
RANGE_SLACK = 1e-4
# Type of a joint -> the values that set its position, as errors state them
JOINT_VALUE_TEXTS = {
    FREE: "7 numbers (x, y, z [m], quaternion w, x, y, z)",
    BALL: "4 numbers (quaternion w, x, y, z)",
    SLIDE: "1 number [m]",
    HINGE: "1 number [rad]",
}
JOINT_UNITS = {SLIDE: "m", HINGE: "rad"}


def pose_model(model: mujoco.MjModel, settings: SceneSettings) -> mujoco.MjData:
    """Pose a model by the keyframe and the joint values of the settings.

    Args:
        model: the model.
        settings: `scene.keyframe` and `scene.joints` are used; errors name `scene.path`.

    Returns:
        The model's data, with the poses of all geoms computed.

    Raises:
        ConfigError: the model has no such keyframe or joint, or a joint's value is wrong.
        SceneError: MuJoCo cannot pose the model.
    """
    data = mujoco.MjData(model)
    with _raise_scene_errors(f"pose {settings.path}"):
        keyframe = settings.keyframe
        if isinstance(keyframe, int) and keyframe >= model.nkey:
            number_text = f"{settings.path} has {model.nkey} of them, counted from 0"
            raise ConfigError(f"no keyframe {keyframe} for `scene.keyframe`: {number_text}")
        if isinstance(keyframe, str):
            keyframe = _find_keyframe(model, keyframe, settings)
        if keyframe is not None:
            mujoco.mj_resetDataKeyframe(model, data, keyframe)
        for name, setting_value in settings.joints.items():
            joint = _find_joint(model, name, settings)
            expected_text = JOINT_VALUE_TEXTS[int(model.jnt_type[joint])]
            joint_values = np.atleast_1d(np.asarray(setting_value, dtype=np.float64))
            setting_text = f"at `scene.joints.{name}`"
            if len(joint_values) != int(expected_text[0]):
                raise ConfigError(
                    f"expected {expected_text} {setting_text}, got {len(joint_values)}"
                )
            if len(joint_values) >= 4 and not joint_values[-4:].any():
                raise ConfigError(f"expected a quaternion that is not 0 {setting_text}")
            qpos_address = int(model.jnt_qposadr[joint])
            data.qpos[qpos_address : qpos_address + len(joint_values)] = joint_values
        mujoco.mj_kinematics(model, data)
    return data


def _find_keyframe(model: mujoco.MjModel, name: str, settings: SceneSettings) -> int:
    _check_name(model, name, "keyframe", "keyframe", model.name_keyadr, settings)
    return int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, name))


def _find_joint(model: mujoco.MjModel, name: str, settings: SceneSettings) -> int:
    joint = int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name))
    hint = _suggest_joint_of_body(model, name) if joint < 0 else ""
    _check_name(model, name, "joint", "joints", model.name_jntadr, settings, hint)
    return joint


def _suggest_joint_of_body(model: mujoco.MjModel, name: str) -> str:
    """Name the joint of the body of this name, for an error; empty if it has none with a name."""
    joint = find_joint_of_body(model, name)
    joint_name = "" if joint is None else name_at(model, model.name_jntadr[joint])
    return f"{name!r} is moved by its joint {joint_name!r}; " if joint_name else ""


def _check_name(
    model: mujoco.MjModel,
    name: str,
    object_kind: str,
    setting_key: str,
    addresses: Int32,
    settings: SceneSettings,
    hint: str = "",
) -> None:
    """Raise a ConfigError unless a model has a keyframe or joint with the given name.

    Args:
        model: the model.
        name: the name of the keyframe or joint.
        object_kind: ``keyframe`` or ``joint``, for the error.
        setting_key: the key of the setting that states the name, for the error.
        addresses: the addresses of the names of all keyframes or joints.
        settings: errors name `scene.path`.
        hint: what the error says before it lists the names.
    """
    names = [model_name for model_name in names_at(model, addresses.tolist()) if model_name]
    if name not in names:
        names_text = list_first(names, 20) or "none with a name"
        raise ConfigError(
            f"no {object_kind} {name!r} for `scene.{setting_key}`: {hint}{settings.path} has "
            f"{names_text}"
        )


@contextmanager
def _raise_scene_errors(action: str) -> Iterator[None]:
    """Convert MuJoCo's errors inside a with statement to SceneErrors: MuJoCo cannot do `action`."""
    try:
        yield
    except (mujoco.FatalError, mujoco.UnexpectedError, ValueError) as error:
        reason = " ".join(str(error).split())[:400]
        raise SceneError(f"MuJoCo cannot {action}: {reason}") from error


def warn_out_of_range(model: mujoco.MjModel, settings: SceneSettings) -> list[str]:
    """Make a warning for each joint that the settings move out of its range.

    Args:
        model: the model.
        settings: `scene.joints` is used; the model has all joints that it names.
    """
    warnings = []
    for name, setting_value in settings.joints.items():
        joint = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        range_start = float(model.jnt_range[joint, 0])
        range_end = float(model.jnt_range[joint, 1])
        position = float(np.ravel(setting_value)[0])
        is_within = range_start - RANGE_SLACK <= position <= range_end + RANGE_SLACK
        joint_type = int(model.jnt_type[joint])
        if joint_type in JOINT_UNITS and model.jnt_limited[joint] and not is_within:
            warnings.append(
                f"joint {name!r} ranges from {range_start:.6g} to {range_end:.6g} "
                f"{JOINT_UNITS[joint_type]}, got {position:.6g} at `scene.joints.{name}`: it is "
                "posed there anyway"
            )
    return warnings


def data_of_qpos(model: mujoco.MjModel, qpos: ArrayLike) -> mujoco.MjData:
    """Return a model's data with the joint positions `qpos`, and the poses of geoms computed.

    Args:
        model: the model.
        qpos: the positions of all joints, shape (nq,) [m or rad].

    Raises:
        ConfigError: `qpos` has a different shape, or contains something that is no number.
    """
    expected_text = f"expected {model.nq} joint positions (nq)"
    try:
        joint_positions = np.asarray(qpos, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{expected_text}, got {qpos!r}") from error
    if joint_positions.shape != (model.nq,):
        raise ConfigError(f"{expected_text}, got {joint_positions.shape}")
    data = mujoco.MjData(model)
    data.qpos[:] = joint_positions
    mujoco.mj_kinematics(model, data)
    return data


def data_with_joints(
    model: mujoco.MjModel, data: mujoco.MjData, joint_positions: Mapping[int, float]
) -> mujoco.MjData:
    """Return a copy of a model's data with some joints moved, and the poses of geoms computed.

    Args:
        model: the model.
        data: the model's data, which is not changed.
        joint_positions: id of a hinge or slide -> its new position [rad or m].
    """
    copied_data = mujoco.MjData(model)
    copied_data.qpos[:] = data.qpos
    copied_data.mocap_pos[:] = data.mocap_pos
    copied_data.mocap_quat[:] = data.mocap_quat
    for joint, position in joint_positions.items():
        copied_data.qpos[model.jnt_qposadr[joint]] = position
    mujoco.mj_kinematics(model, copied_data)
    return copied_data


def place_geoms(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Compute the poses of all geoms in a model's data from its joint positions and mocap bodies.

    Args:
        model: the model.
        data: the model's data, in which the poses are written.

    Raises:
        SceneError: MuJoCo cannot compute them.
    """
    with _raise_scene_errors("take the pose"):
        mujoco.mj_kinematics(model, data)
