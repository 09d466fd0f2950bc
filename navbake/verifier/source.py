"""Finds the scene of a grid and the settings of its bake, and poses doors as the grid has them."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from navbake.baker.scene.model import is_in_memory, load_from_memory, name_of
from navbake.baker.scene.names import body_name, find_subtree_ends, geoms_of_bodies
from navbake.baker.scene.scene import Scene, load_scene
from navbake.config.settings import (
    BakeConfig,
    as_config,
    is_settings,
    make_memory_path,
    parse_config,
    settings_digest,
)
from navbake.errors import ConfigError, QueryError
from navbake.mujoco_types import MjDataLike
from navbake.navgrid.grid import GridBase
from navbake.navgrid.rooms import Door

SCENES_FOLDER = "scenes"  # scenes, such as those of the samples, are often in such a folder
DEFAULT_HINGE_RANGE = np.pi / 2  # how far a hinged door opens, if the joint has no range [rad]
DEFAULT_SLIDE_RANGE = 1.0  # how far a sliding door opens, if the joint has no range [m]
HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)

SceneSource = BakeConfig | str | PathLike[str] | Mapping[str, Any] | Any
"""Settings, the path of a YAML or a scene file, the content of a YAML, or a scene in memory."""


class NoSceneError(QueryError):
    """Raised when a grid names no scene, or the file that it names is in none of the folders."""


def find_source(
    grid: GridBase,
    source: SceneSource | None,
    grid_path: Path | None,
    *,
    force: bool,
    data: MjDataLike | None = None,
    model_path: Sequence[str | PathLike[str]] = (),
) -> tuple[Scene, BakeConfig | None, list[str]]:
    """Load the scene of a grid.

    A scene file, or a scene in memory, is loaded with the settings that the grid states.

    Args:
        grid: The grid.
        source: The scene or its settings; None for the file that the grid names.
        grid_path: The file of the grid, beside which the scene is looked for; None for a grid in
            memory.
        force: Whether to accept a scene that is not the one of the bake.
        data: The pose of a scene in memory; None for the pose that the settings state.
        model_path: The folders that replace the setting `scene.model_path`; () to leave it.

    Returns:
        The scene; the settings of the bake, None if the scene's settings differ from them; and
        notes for the user.

    Raises:
        NoSceneError: no source is given, and the grid names no scene that exists.
        QueryError: the scene's file does not exist, or it is not the grid's and `force` is False.
        ConfigError: the settings are wrong, or `data` is given without a model.
        SceneError: the scene cannot be read.
    """
    stated_settings = grid.navbake.get("settings")
    if not isinstance(stated_settings, dict):
        stated_settings = {}
    stated_scene = stated_settings.get("scene")
    if not isinstance(stated_scene, dict):
        stated_scene = {}
    if source is None:
        source = _find_file(grid, stated_scene.get("path"), grid_path)
    is_file = isinstance(source, str | PathLike) and not is_settings(source)
    if data is not None:
        if not is_in_memory(source):
            problem = "expected a data with a mujoco.MjModel or MjSpec: give the model, too"
            raise ConfigError(problem)
        stated_scene = {
            key: setting_value
            for key, setting_value in stated_scene.items()
            if key not in ("keyframe", "joints")
        }

    scene_model = None
    if is_in_memory(source) or is_file:
        path = make_memory_path(name_of(source)) if is_in_memory(source) else Path(str(source))
        if is_file and not path.exists():
            raise QueryError(f"no scene at {path}: it may have moved; give its path")
        try:
            config = parse_config({**stated_settings, "scene": {**stated_scene, "path": path}})
        except ConfigError:  # the settings of another version
            config = parse_config({"scene": {"path": path}}, str(path))
        if is_in_memory(source):
            scene_model = load_from_memory(source, data, config.scene)
    else:
        config = as_config(source)
    if model_path:
        folders = [Path(folder) for folder in model_path]
        scene_settings = config.scene.model_copy(update={"model_path": folders})
        config = config.model_copy(update={"scene": scene_settings})
    scene = load_scene(config, scene_model=scene_model)

    notes = []
    bake_digest = grid.navbake.get("sceneDigest")
    if bake_digest is None:
        notes.append("the grid has no digest of its scene, so nothing says that it is this one")
    elif bake_digest != scene.digest:
        mujoco_version = grid.navbake.get("mujoco", "another version")
        reason = f"their digests differ; the bake's MuJoCo was {mujoco_version}"
        note = f"{config.scene.path} isn't the scene that the grid was baked from"
        notes.append(f"{note}, or stands in another pose ({reason})")
        if not force:
            raise QueryError(f"{notes[0]}: --force, or force=True, compares them anyway")
    has_bake_settings = grid.navbake.get("settingsDigest") in (None, settings_digest(config))
    if stated_settings and (is_in_memory(source) or is_file):
        has_bake_settings = True
    if grid.navbake and not has_bake_settings:
        notes.append("the settings are others than those of the bake (their digests differ)")
    bake_config = config if grid.navbake and has_bake_settings else None
    return scene, bake_config, notes


def _find_file(grid: GridBase, stated_path: object, grid_path: Path | None) -> Path:
    """Find the file of a grid's scene by its name.

    It is looked for beside the grid, in the current folder, and in ``scenes`` in both.
    """
    grid_name = grid.scene_id or "the grid"
    if not isinstance(stated_path, str) or not stated_path:
        problem = f"{grid_name} doesn't say which scene it was baked from"
        raise NoSceneError(f"{problem}: give the scene, or the settings of its bake")
    file_name = Path(stated_path).name
    folders = dict.fromkeys([grid_path.parent if grid_path else Path(), Path()])
    for folder in folders:
        for path in (folder / file_name, folder / SCENES_FOLDER / file_name):
            if os.path.isfile(path):
                return path
    folder_names = [
        str(folder) if str(folder) != "." else "the current folder" for folder in folders
    ]
    raise NoSceneError(
        f"the scene {file_name} that {grid_name} was baked from isn't in "
        f"{' or '.join(folder_names)}, nor in {SCENES_FOLDER!r} there: give its path, "
        "or the settings of its bake (--scene)"
    )


class DoorPose(NamedTuple):
    """The pose of a scene whose doors have the states that a grid gives them.

    Attributes:
        data: The pose, with kinematics computed.
        removed_geoms: The ids of the geoms that the pose lacks: those of removed doors, and of
            open doors that no single hinge or slide moves, as a bake takes these out of their
            openings.
        floorless_geoms: The ids of the geoms that carry no floor: geoms of doors, and geoms that
            can move, except the cars of lifts.
        unknown_doors: The ids of doors that the scene does not have.
    """

    data: mujoco.MjData
    removed_geoms: set[int]
    floorless_geoms: set[int]
    unknown_doors: list[str]


def pose_doors(scene: Scene, grid: GridBase) -> DoorPose:
    """Return the pose of a scene whose doors have the states that a grid gives them.

    Args:
        scene: The scene, which stays as it is.
        grid: The grid; the ids of its doors are names of bodies of the scene.

    Returns:
        The pose, and which geoms are removed or carry no floor.
    """
    model = scene.model
    data = copy.copy(scene.data)
    named_bodies = [(body_name(model, body), body) for body in range(1, model.nbody)]
    # doors that share their name with others are named with the body's number, too
    numbered_names = {f"{name} (body {body})": body for name, body in named_bodies}
    body_of_name = dict(named_bodies) | numbered_names
    subtree_ends = find_subtree_ends(model)
    removed_geoms = set[int]()
    unknown_doors = list[str]()
    floorless_geoms = set(np.flatnonzero(~scene.is_structure).tolist())
    for link in grid.links:
        # the cars of lifts carry floors; that a body is a car shows by its name alone
        car_body = body_of_name.get(link.name) if link.kind == "lift" else None
        if car_body is not None:
            floorless_geoms -= set(
                geoms_of_bodies(model, car_body, int(subtree_ends[car_body])).tolist()
            )
    for door in grid.doors:
        body = body_of_name.get(door.id)
        if body is None:
            unknown_doors.append(door.id)
            continue
        door_geoms = set(geoms_of_bodies(model, body, int(subtree_ends[body])).tolist())
        floorless_geoms |= door_geoms
        joint_position = _joint_position(model, body, door)
        if joint_position is not None:
            data.qpos[model.jnt_qposadr[model.body_jntadr[body]]] = joint_position
        elif door.state in ("open", "removed"):  # an open door that no joint opens is taken out
            removed_geoms |= door_geoms
    mujoco.mj_kinematics(model, data)
    return DoorPose(data, removed_geoms, floorless_geoms, unknown_doors)


def _joint_position(model: mujoco.MjModel, body: int, door: Door) -> float | None:
    """Return the position of a door's joint in the door's state [rad, or m for a sliding door].

    A closed door is at 0, or at the position of its range that is nearest to 0. An open one is at
    the end of the range that is farther from there. None if no joint moves the door: in other
    states, and if its body does not have exactly one joint, a hinge or a slide.
    """
    joint_id = int(model.body_jntadr[body])
    if door.state not in ("open", "closed") or joint_id < 0 or model.body_jntnum[body] != 1:
        return None
    joint_type = int(model.jnt_type[joint_id])
    if joint_type not in (HINGE, SLIDE):
        return None
    low = 0.0
    high = DEFAULT_HINGE_RANGE if joint_type == HINGE else DEFAULT_SLIDE_RANGE
    if model.jnt_limited[joint_id]:
        low, high = model.jnt_range[joint_id].tolist()
    closed_position = min(max(0.0, low), high)
    if door.state == "closed":
        return closed_position
    return max(high, low, key=lambda range_end: abs(range_end - closed_position))
