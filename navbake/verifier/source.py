"""The scene of a grid, the settings that it was baked with, and its doors as the grid has them."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping
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
    memory_path,
    parse_config,
    settings_digest,
)
from navbake.errors import ConfigError, QueryError
from navbake.navgrid.grid import GridBase
from navbake.navgrid.rooms import Door

SCENES = "scenes"  # a folder in which scenes often are, as those of the samples
SceneSource = BakeConfig | str | PathLike[str] | Mapping[str, Any] | Any
"""Settings, the path of a YAML or of a scene file, the YAML as a mapping, or a scene in memory."""


class NoSceneError(QueryError):
    """The grid names no scene, or the scene that it names isn't where it is looked for."""


def find_source(
    grid: GridBase,
    given: SceneSource | None,
    grid_path: Path | None,
    *,
    force: bool,
    data: Any = None,
) -> tuple[Scene, BakeConfig | None, list[str]]:
    """Load the scene of a grid: the one that is given, or the one that the grid names.

    A scene file, and a scene in memory, gets the settings that the grid states. `data` is the pose
    of a scene in memory; as the settings say if None.

    Returns:
        The scene; the settings of the bake, None where the grid was baked with others; and what the
        user should know of them.

    Raises:
        QueryError: no scene is given or found; or it isn't the grid's, unless `force` is set.
    """
    stated = grid.navbake.get("settings")
    stated = stated if isinstance(stated, dict) else {}
    own = stated.get("scene")
    own = own if isinstance(own, dict) else {}
    if given is None:
        given = _find_file(grid, own.get("path"), grid_path)
    is_file = isinstance(given, str | PathLike) and not is_settings(given)
    opened = None
    in_memory = is_in_memory(given)
    if data is not None:
        if not in_memory:
            text = "expected a data with a mujoco.MjModel or MjSpec: give the model, too"
            raise ConfigError(text)
        own = {key: own[key] for key in own if key not in ("keyframe", "joints")}
    if in_memory or is_file:
        path = memory_path(name_of(given)) if in_memory else Path(str(given))
        if is_file and not path.exists():
            raise QueryError(f"no scene at {path}: it may have moved; give its path")
        try:
            config = parse_config({**stated, "scene": {**own, "path": path}})
        except ConfigError:  # of another version
            config = parse_config({"scene": {"path": path}}, str(path))
        opened = load_from_memory(given, data, config.scene) if in_memory else None
    else:
        config = as_config(given)
    scene = load_scene(config, scene_model=opened)
    notes = []
    digest = grid.navbake.get("sceneDigest")
    version = grid.navbake.get("mujoco", "another version")
    if digest is None:
        notes.append("the grid has no digest of its scene, so nothing says that it is this one")
    elif digest != scene.digest:
        why = f"their digests differ; the bake's MuJoCo was {version}"
        note = f"{config.scene.path} isn't the scene that the grid was baked from"
        notes.append(f"{note}, or stands in another pose ({why})")
        if not force:
            raise QueryError(f"{notes[0]}: --force, or force=True, compares them anyway")
    are_known = grid.navbake.get("settingsDigest") in (None, settings_digest(config))
    are_known |= bool(stated) and (in_memory or is_file)
    if grid.navbake and not are_known:
        notes.append("the settings are others than those of the bake (their digests differ)")
    return scene, config if grid.navbake and are_known else None, notes


def _find_file(grid: GridBase, stated: object, grid_path: Path | None) -> Path:
    """The stated scene's file: beside the grid, in the current folder, or in ``scenes`` there."""
    whose = grid.scene_id or "the grid"
    if not isinstance(stated, str) or not stated:
        text = f"{whose} doesn't say which scene it was baked from"
        raise NoSceneError(f"{text}: give the scene, or the settings of its bake")
    name = Path(stated).name
    folders = dict.fromkeys([grid_path.parent if grid_path else Path(), Path()])
    for folder in folders:
        for place in (folder / name, folder / SCENES / name):
            if os.path.isfile(place):
                return place
    names = [str(folder) if str(folder) != "." else "the current folder" for folder in folders]
    raise NoSceneError(
        f"the scene {name} that {whose} was baked from isn't in {' or '.join(names)}, nor in "
        f"{SCENES!r} there: give its path, or the settings of its bake (--scene)"
    )


HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)


class DoorPose(NamedTuple):
    """How the doors stand."""

    data: Any  # with the doors' joints moved
    removed: set[int]  # ids of the geoms of removed doors
    no_floors: set[int]  # ids of the geoms that make no floor: doors', and what can move
    unknown: list[str]  # ids of doors that the scene doesn't have


def pose_doors(scene: Scene, grid: GridBase) -> DoorPose:
    """Move the doors of a scene into the states that a grid states."""
    model = scene.model
    data = copy.copy(scene.data)
    numbered = [(body_name(model, body), body) for body in range(1, model.nbody)]
    # doors whose name others share state their number, too
    bodies = dict(numbered) | {f"{name} (body {body})": body for name, body in numbered}
    ends = find_subtree_ends(model)
    removed = set[int]()
    unknown = list[str]()
    no_floors = set(np.flatnonzero(~scene.is_structure).tolist())
    # a grid doesn't state how its lifts were found; their cars carry floors
    for link in grid.links:
        if link.kind == "lift" and (body := bodies.get(link.name)) is not None:
            no_floors -= set(geoms_of_bodies(model, body, int(ends[body])).tolist())
    for door in grid.doors:
        if (body := bodies.get(door.id)) is None:
            unknown.append(door.id)
            continue
        own = set(geoms_of_bodies(model, body, int(ends[body])).tolist())
        no_floors |= own
        if door.state == "removed":
            removed |= own
        elif (position := _position(model, body, door)) is not None:
            data.qpos[model.jnt_qposadr[model.body_jntadr[body]]] = position
    mujoco.mj_kinematics(model, data)
    return DoorPose(data, removed, no_floors, unknown)


def _position(model: Any, body: int, door: Door) -> float | None:
    """Where its hinge or slide is in the door's state [rad or m]; None as it is modelled.

    Closed is 0 or next to it, open the end farther from it; without a range, 90 degrees or 1 m.
    """
    joint = int(model.body_jntadr[body])
    if door.state not in ("open", "closed") or joint < 0 or model.body_jntnum[body] != 1:
        return None
    if (kind := int(model.jnt_type[joint])) not in (HINGE, SLIDE):
        return None
    low = 0.0
    high = np.pi / 2 if kind == HINGE else 1.0
    if model.jnt_limited[joint]:
        low, high = model.jnt_range[joint].tolist()
    closed = min(max(0.0, low), high)
    return closed if door.state == "closed" else max(high, low, key=lambda end: abs(end - closed))
