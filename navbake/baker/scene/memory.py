"""Scenes that are in memory: MuJoCo's models and specs, trimesh's scenes and meshes."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from navbake.baker.scene.mesh_scene import MeshPart, is_mesh_scene, take_mesh_parts
from navbake.baker.scene.model import (
    OpenScene,
    catch_warnings,
    compile_model,
    compile_spec,
    model_of_parts,
)
from navbake.baker.scene.names import name_at
from navbake.baker.scene.pose import data_with_joints
from navbake.config.scene import SceneSettings
from navbake.errors import ConfigError

NO_NAME = "MuJoCo Model"  # what MuJoCo calls a model that was given no name
# What decides where a model's geoms stand: a data fits a model that is the same in these
SIZES = ("nq", "nmocap", "nbody", "ngeom")


def is_in_memory(scene: Any) -> bool:
    """Whether something is a scene itself: an MjModel, an MjSpec, a trimesh.Scene or a Trimesh."""
    return isinstance(scene, mujoco.MjModel | mujoco.MjSpec) or is_mesh_scene(scene)


def name_of(scene: Any) -> str:
    """The name of a scene in memory: its model's own, else ``scene``."""
    if isinstance(scene, mujoco.MjSpec):
        name = str(scene.modelname)
    else:
        name = name_at(scene, 0) if isinstance(scene, mujoco.MjModel) else ""
    return "scene" if name in ("", NO_NAME) else name


def open_memory(scene: Any, data: Any, settings: SceneSettings) -> OpenScene:
    """The model of a scene in memory, in the pose of a data; neither is changed.

    A spec is compiled as a copy. MuJoCo warned of a model when that was compiled, so these
    warnings are known of specs alone.

    Args:
        scene: what `is_in_memory` takes.
        data: a mujoco.MjData of the model, whose joint positions and mocap bodies are the pose;
            None for the pose that the settings ask for.
        settings: of the scene; their path is what errors call it.

    Raises:
        SceneError: a spec does not compile, or a mesh is broken.
        ConfigError: the data is of another model, or goes with other settings of the pose.
    """
    with catch_warnings() as warned:
        opened = _open(scene, settings, warned)
    if data is None:
        return opened
    if settings.keyframe is not None or settings.joints:
        key = "keyframe" if settings.keyframe is not None else "joints"
        raise ConfigError(f"expected a pose by `scene.{key}` or by a data, got both")
    check_data(opened.model, data, str(settings.path))
    return opened._replace(data=data_with_joints(opened.model, data, {}))


def _open(scene: Any, settings: SceneSettings, warned: list[str]) -> OpenScene:
    path, ground = settings.path, settings.ground
    parts: dict[int, MeshPart]
    if isinstance(scene, mujoco.MjModel):
        if ground is not None:
            raise ConfigError(
                f"`scene.ground` can't be added to {path}, which is compiled: give its MjSpec or "
                "its file"
            )
        return OpenScene(scene, {}, None, warned)
    if isinstance(scene, mujoco.MjSpec):
        model = compile_model(path, warned, lambda: compile_spec(scene.copy(), ground, warned))
        parts = {}
    else:
        found = take_mesh_parts(scene, path, settings.up, settings.unit)
        model, parts = model_of_parts(found, path, ground, warned)
    return OpenScene(model, parts, None if ground is None else int(model.ngeom) - 1, warned)


def check_data(model: Any, data: Any, name: str) -> None:
    """Check that a mujoco.MjData fits a model, by its numbers of things and its joints.

    Args:
        name: what an error calls the model's scene.

    Raises:
        ConfigError: it is none, or of another model.
    """
    if not isinstance(data, mujoco.MjData):
        raise ConfigError(f"expected a mujoco.MjData of {name}, got {type(data).__name__}")
    other = data.model
    for size in SIZES:
        expected, got = int(getattr(model, size)), int(getattr(other, size))
        if expected != got:
            raise ConfigError(
                f"the data is of another model than {name}: expected {size} = {expected}, got {got}"
            )
    if not np.array_equal(model.jnt_type, other.jnt_type):
        raise ConfigError(f"the data is of another model than {name}: its joints differ")
