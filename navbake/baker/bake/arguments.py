"""The arguments of `navbake.bake`: a scene, its pose, settings, and bodies that are left out."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import ValidationError

from navbake.baker.scene.model import (
    CompileLimits,
    SceneModel,
    is_in_memory,
    load_from_memory,
    name_of,
)
from navbake.baker.scene.names import all_names
from navbake.baker.scene.scene import load_scene_file
from navbake.config.field_types import make_config_error
from navbake.config.keywords import config_with, memory_config
from navbake.config.settings import BakeConfig, ExcludeSettings
from navbake.errors import ConfigError
from navbake.known_names import suggest

WILDCARDS = re.compile(r"([*?[])")


def parse_arguments(
    scene: Any,
    data: Any,
    settings: Mapping[str, Any],
    exclude: Mapping[str, Any] | None = None,
    robot: Any = None,
    limits: CompileLimits | None = None,
) -> tuple[BakeConfig, SceneModel | None]:
    """Check the arguments of `navbake.bake`; `limits` are for MuJoCo to compile a file.

    Returns all settings; and the scene's model, None where the bake loads the settings' file.
    """
    opened: SceneModel | None = None
    if is_in_memory(scene):
        if limits is not None:
            raise ConfigError("`isolate` is for scene files: this scene is in memory")
        config = memory_config(name_of(scene), settings)
        opened = load_from_memory(scene, data, config.scene)
    else:
        if data is not None:
            raise ConfigError(
                "expected a data with a mujoco.MjModel or MjSpec: give the model, too; the pose "
                "of a file is set by `scene.keyframe` and `scene.joints`"
            )
        if isinstance(scene, str) and scene.lstrip().startswith("<"):
            raise ConfigError(
                "expected a file, settings or a model, got XML text: "
                "`mujoco.MjSpec.from_string` makes a model of it"
            )
        config = config_with(scene, settings)
    if exclude is None and robot is None:
        return config, opened
    # whether there are such bodies is seen in the model, which the bake then has no need to load
    opened = opened or load_scene_file(config.scene, limits)
    names = all_names(opened.model)
    own = config.scene.exclude
    given = {} if exclude is None else exclude
    if not isinstance(given, Mapping):
        wanted = "`exclude` as {'bodies': […], 'geoms': […]}"
        raise ConfigError(f"expected {wanted}, got {type(given).__name__}")
    geoms = [geom.geom for geom in names.geoms]
    bodies = _patterns_of(given.get("bodies", []), names.bodies, "body", "exclude")
    bodies += _patterns_of([] if robot is None else robot, names.bodies, "body", "robot")
    patterns = {
        "bodies": [*own.bodies, *bodies],
        "geoms": [*own.geoms, *_patterns_of(given.get("geoms", []), geoms, "geom", "exclude")],
    }
    try:
        excluded = ExcludeSettings.model_validate({"movable": own.movable, **given, **patterns})
    except ValidationError as error:
        raise make_config_error(error, {"": ExcludeSettings}, "`exclude`") from error
    changed = config.scene.model_copy(update={"exclude": excluded})
    return config.model_copy(update={"scene": changed}), opened


def _patterns_of(given: Any, names: Sequence[str], kind: str, keyword: str) -> list[str]:
    """Patterns of one or several bodies or geoms, given by name, id or pattern."""
    first = 1 if kind == "body" else 0  # the world, body 0, is no body of the scene
    patterns = list[str]()
    is_one = isinstance(given, str) or not isinstance(given, Sequence | np.ndarray)
    for one in [given] if is_one else given:
        # what MuJoCo's models and specs have for a body or a geom
        name = one if isinstance(one, str) else getattr(one, "name", "") or getattr(one, "id", one)
        if not isinstance(name, str):
            index = name.__index__() if hasattr(name, "__index__") else -1
            if isinstance(name, bool) or not first <= index < len(names):
                wanted = f"the name or id of a {kind} in `{keyword}`, {first} to {len(names) - 1}"
                raise ConfigError(f"expected {wanted}, got {one!r}")
            name = names[index]
        elif name not in names[first:]:
            if keyword == "robot" or not WILDCARDS.search(name):
                near = suggest(name, names[first:])
                raise ConfigError(f"no {kind} {name!r} for `{keyword}`: {near}")
            patterns.append(name)
            continue
        patterns.append(WILDCARDS.sub(r"[\1]", name))
    return patterns
