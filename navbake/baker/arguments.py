"""What a bake is given in Python: a scene, its pose, settings, and bodies that are left out."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from navbake.baker.scene.isolated import CompileLimits
from navbake.baker.scene.model import OpenScene, is_in_memory, name_of, open_memory
from navbake.baker.scene.names import all_names
from navbake.baker.scene.scene import open_file
from navbake.config.keywords import config_with, memory_config
from navbake.config.settings import BakeConfig, ExcludeSettings
from navbake.errors import ConfigError
from navbake.known_names import find_near, suggest

WILDCARDS = re.compile(r"([*?[])")


def take_input(
    scene: Any,
    data: Any,
    settings: Mapping[str, Any],
    exclude: Mapping[str, Any] | None = None,
    robot: Any = None,
    limits: CompileLimits | None = None,
) -> tuple[BakeConfig, OpenScene | None]:
    """Take what `navbake.bake` is given, see there; `limits` are for MuJoCo to compile a file.

    Returns all settings; and the scene's model, None where the bake loads the settings' file.

    Raises:
        ConfigError: what is given is wrong, or names what isn't there.
        SceneError: the scene can't be compiled or read.
    """
    opened: OpenScene | None = None
    if is_in_memory(scene):
        if limits is not None:
            raise ConfigError("`isolate` is for scene files: this scene is in memory")
        config = memory_config(name_of(scene), settings)
        opened = open_memory(scene, data, config.scene)
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
    opened = opened or open_file(config.scene, limits)
    names = all_names(opened.model)
    geoms = [geom.geom for geom in names.geoms]
    given, own = _check_exclude(exclude), config.scene.exclude
    excluded = ExcludeSettings(
        bodies=[
            *own.bodies,
            *_patterns_of(given["bodies"], names.bodies, "body", "exclude"),
            *_patterns_of([] if robot is None else robot, names.bodies, "body", "robot"),
        ],
        geoms=[*own.geoms, *_patterns_of(given["geoms"], geoms, "geom", "exclude")],
        movable=own.movable if given["movable"] is None else given["movable"],
    )
    changed = config.scene.model_copy(update={"exclude": excluded})
    return config.model_copy(update={"scene": changed}), opened


def _check_exclude(given: Mapping[str, Any] | None) -> dict[str, Any]:
    taken: dict[str, Any] = {"bodies": [], "geoms": [], "movable": None}
    if given is not None and not isinstance(given, Mapping):
        raise ConfigError(
            f"expected `exclude` as {{'bodies': […], 'geoms': […]}}, got {type(given).__name__}"
        )
    for key in given or ():
        if key not in taken:
            near = find_near(key, taken)
            hint = f"did you mean {near[0]!r}? " if near else ""
            raise ConfigError(f"unknown key `{key}` of `exclude`: {hint}it has {', '.join(taken)}")
    taken |= given or {}
    if not isinstance(taken["movable"], bool | None):
        raise ConfigError(f"expected true or false as `exclude.movable`, got {taken['movable']!r}")
    return taken


def _patterns_of(given: Any, names: Sequence[str], kind: str, keyword: str) -> list[str]:
    """Patterns of bodies or geoms, of which one or several are given."""
    given = given.tolist() if isinstance(given, np.ndarray) else given
    if not isinstance(given, Sequence) or isinstance(given, str):
        given = [given]
    return [_pattern_of(one, names, kind, keyword) for one in given]


def _pattern_of(given: Any, names: Sequence[str], kind: str, keyword: str) -> str:
    """The pattern of one body or geom by its name or id, or the pattern that is given."""
    what = f"expected the name or id of a {kind} in `{keyword}`"
    first = 1 if kind == "body" else 0  # the world, body 0, is no body of the scene
    # what MuJoCo's models and specs have for a body or a geom
    number = given if isinstance(given, str) else getattr(given, "name", "")
    number = number or getattr(given, "id", given)
    if isinstance(number, str):
        if number in names[first:]:
            return WILDCARDS.sub(r"[\1]", number)
        if keyword == "exclude" and WILDCARDS.search(number):
            return number
        raise ConfigError(f"no {kind} {number!r} for `{keyword}`: {suggest(number, names[first:])}")
    try:
        index = number.__index__()
    except (AttributeError, TypeError):
        raise ConfigError(f"{what}, got {given!r}") from None
    if isinstance(number, bool) or not first <= index < len(names):
        raise ConfigError(f"{what}, {first} to {len(names) - 1}, got {given!r}")
    return WILDCARDS.sub(r"[\1]", names[index])
