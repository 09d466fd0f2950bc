"""What a bake is given in Python: a scene, its pose, settings, and bodies that are left out."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from navbake.baker.scene.isolated import CompileLimits
from navbake.baker.scene.model import OpenScene, is_in_memory, name_of, open_memory
from navbake.baker.scene.names import all_names, body_name
from navbake.baker.scene.scene import open_file
from navbake.config.keywords import config_with, memory_config
from navbake.config.scene import ExcludeSettings
from navbake.config.settings import BakeConfig
from navbake.errors import ConfigError
from navbake.known_names import find_near, suggest

WILDCARDS = re.compile(r"([*?[])")


class BakeInput(NamedTuple):
    """The settings of a bake, and its scene where that is loaded already.

    Attributes:
        config: all settings.
        opened: the scene's model; None where the bake loads the file of the settings.
    """

    config: BakeConfig
    opened: OpenScene | None


class LeftOut(NamedTuple):
    """What `bake` is told to leave out of the scene.

    Attributes:
        exclude: `bodies`, `geoms` and `movable`, as of `scene.exclude`; things may be given by
            name, by id, by pattern, or as MuJoCo's own views of them.
        robot: a body, or several, left out with all that hangs on them; no pattern.
    """

    exclude: Mapping[str, Any] | None = None
    robot: Any = None


def take_input(
    scene: Any,
    data: Any,
    settings: Mapping[str, Any],
    left_out: LeftOut | None = None,
    limits: CompileLimits | None = None,
) -> BakeInput:
    """Take what `navbake.bake` is given.

    Args:
        scene: a scene in memory, or settings; see `navbake.bake`.
        data: the mujoco.MjData with the pose of a scene in memory, or None.
        settings: sections of settings, by name.
        left_out: what is left out besides.
        limits: MuJoCo compiles the scene's file within these.

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
    if left_out is None or (left_out.exclude is None and left_out.robot is None):
        return BakeInput(config, opened)
    # whether there are such bodies is seen in the model, which the bake then has no need to load
    opened = opened or open_file(config.scene, limits)
    return BakeInput(_leave_out(config, opened.model, left_out), opened)


def _leave_out(config: BakeConfig, model: Any, left_out: LeftOut) -> BakeConfig:
    """The settings with what is left out besides, as patterns of `scene.exclude`."""
    bodies = [body_name(model, body) for body in range(model.nbody)]
    geoms = [names.geom for names in all_names(model).geoms]
    given = _check_exclude(left_out.exclude)
    own = config.scene.exclude
    robots = [] if left_out.robot is None else _listed(left_out.robot)
    exclude = ExcludeSettings(
        bodies=[
            *own.bodies,
            *(_pattern_of(one, bodies, "body", "exclude") for one in _listed(given["bodies"])),
            *(_pattern_of(one, bodies, "body", "robot") for one in robots),
        ],
        geoms=[
            *own.geoms,
            *(_pattern_of(one, geoms, "geom", "exclude") for one in _listed(given["geoms"])),
        ],
        movable=own.movable if given["movable"] is None else given["movable"],
    )
    scene = config.scene.model_copy(update={"exclude": exclude})
    return config.model_copy(update={"scene": scene})


def _check_exclude(given: Mapping[str, Any] | None) -> dict[str, Any]:
    taken: dict[str, Any] = {"bodies": [], "geoms": [], "movable": None}
    if given is None:
        return taken
    if not isinstance(given, Mapping):
        raise ConfigError(
            f"expected `exclude` as {{'bodies': […], 'geoms': […]}}, got {type(given).__name__}"
        )
    for key, value in given.items():
        if key not in taken:
            near = find_near(key, taken)
            hint = f"did you mean {near[0]!r}? " if near else ""
            raise ConfigError(f"unknown key `{key}` of `exclude`: {hint}it has {', '.join(taken)}")
        taken[key] = value
    if not isinstance(taken["movable"], bool | None):
        raise ConfigError(f"expected true or false as `exclude.movable`, got {taken['movable']!r}")
    return taken


def _listed(given: Any) -> Sequence[Any]:
    given = given.tolist() if isinstance(given, np.ndarray) else given
    return given if isinstance(given, Sequence) and not isinstance(given, str) else [given]


def _pattern_of(given: Any, names: list[str], kind: str, keyword: str) -> str:
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
