"""Checks the arguments of `navbake.bake`: a scene, its pose, settings, and bodies to leave out."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, SupportsIndex, TypeAlias, TypeGuard

import numpy as np
from pydantic import ValidationError

from navbake.baker.scene.model import (
    CompileLimits,
    SceneInput,
    SceneModel,
    is_in_memory,
    load_from_memory,
    name_of,
)
from navbake.baker.scene.names import all_names
from navbake.baker.scene.scene import load_scene_file
from navbake.config.field_types import make_config_error
from navbake.config.keywords import add_keywords_to_config, make_memory_config
from navbake.config.settings import BakeConfig, ExcludeSettings
from navbake.errors import ConfigError
from navbake.known_names import suggest
from navbake.mujoco_types import MjDataLike

if TYPE_CHECKING:
    import mujoco

WILDCARDS = re.compile(r"([*?[])")

# A body or a geom: its name, its id, or MuJoCo's view of it, as ``model.body("table")``
Reference: TypeAlias = "str | SupportsIndex | object"
References: TypeAlias = "Reference | Sequence[Reference]"


def parse_arguments(
    scene: SceneInput,
    data: MjDataLike | None,
    settings: Mapping[str, object],
    exclude: Mapping[str, object] | None = None,
    robot: References | None = None,
    limits: CompileLimits | None = None,
) -> tuple[BakeConfig, SceneModel | None]:
    """Check the arguments of `navbake.bake`, and return all settings.

    Args:
        scene: a path, settings, or a scene in memory.
        data: the pose of a model in memory; None for the settings' pose.
        settings: sections of settings by name.
        exclude: bodies and geoms to leave out, as ``{"bodies": […], "geoms": […]}``.
        robot: the body of the robot, or several bodies, to leave out.
        limits: limits for MuJoCo's compiler, for scene files.

    Returns:
        The settings, and the compiled model of the scene; None where the bake has to load the file
        that the settings name.

    Raises:
        ConfigError: an argument is wrong, or names a body or geom that the scene does not have.
        SceneError: the scene cannot be read.
    """
    scene_model: SceneModel | None = None
    if is_in_memory(scene):
        if limits is not None:
            raise ConfigError("`isolate` is for scene files: this scene is in memory")
        config = make_memory_config(name_of(scene), settings)
        scene_model = load_from_memory(scene, data, config.scene)
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
        config = add_keywords_to_config(scene, settings)
    if exclude is None and robot is None:
        return config, scene_model
    # The model says which bodies there are. The bake needs it as well, and does not load it again.
    if scene_model is None:
        scene_model = load_scene_file(config, limits)
    exclude_settings = _merge_exclude_settings(
        scene_model.model, config.scene.exclude, exclude, robot
    )
    scene_settings = config.scene.model_copy(update={"exclude": exclude_settings})
    return config.model_copy(update={"scene": scene_settings}), scene_model


def _merge_exclude_settings(
    model: mujoco.MjModel,
    settings: ExcludeSettings,
    exclude: Mapping[str, object] | None,
    robot: References | None,
) -> ExcludeSettings:
    """Add what the arguments `exclude` and `robot` name to the settings of `scene.exclude`.

    Args:
        model: the compiled scene, which has the names of bodies and geoms.
        settings: the settings of `scene.exclude`.
        exclude: bodies and geoms to leave out, as ``{"bodies": […], "geoms": […]}``.
        robot: the body of the robot, or several bodies, to leave out.

    Raises:
        ConfigError: an argument is wrong, or names a body or geom that the scene does not have.
    """
    if exclude is None:
        exclude = {}
    if not isinstance(exclude, Mapping):
        expected_form_text = "`exclude` as {'bodies': […], 'geoms': […]}"
        raise ConfigError(f"expected {expected_form_text}, got {type(exclude).__name__}")
    names = all_names(model)
    geom_names = [geom.geom for geom in names.geoms]
    body_patterns = [
        *settings.bodies,
        *_find_patterns(exclude.get("bodies", []), names.bodies, "body", "exclude"),
        *_find_patterns([] if robot is None else robot, names.bodies, "body", "robot"),
    ]
    geom_patterns = [
        *settings.geoms,
        *_find_patterns(exclude.get("geoms", []), geom_names, "geom", "exclude"),
    ]
    merged_settings = {
        "movable": settings.movable,
        **exclude,
        "bodies": body_patterns,
        "geoms": geom_patterns,
    }
    try:
        return ExcludeSettings.model_validate(merged_settings)
    except ValidationError as error:
        raise make_config_error(error, {"": ExcludeSettings}, "`exclude`") from error


def _find_patterns(
    references: References, all_names_by_id: Sequence[str], body_or_geom: str, keyword: str
) -> list[str]:
    """Turn references to bodies or geoms into name patterns.

    Args:
        references: one or several bodies or geoms, each by its name or id, as a name pattern, or as
            MuJoCo's view of it.
        all_names_by_id: the names of all bodies or geoms, by id.
        body_or_geom: ``body`` or ``geom``.
        keyword: the argument of `navbake.bake` that has the references, for errors.

    Raises:
        ConfigError: a reference is of a wrong type, or names nothing in the scene.
    """
    first_id = 1 if body_or_geom == "body" else 0  # the world, body 0, is no body of the scene
    patterns = list[str]()
    for reference in references if _are_several(references) else [references]:
        name_or_id = _name_or_id(reference)
        if isinstance(name_or_id, str):
            name = name_or_id
            if name not in all_names_by_id[first_id:]:
                if keyword == "robot" or not WILDCARDS.search(name):
                    suggestion = suggest(name, all_names_by_id[first_id:])
                    raise ConfigError(f"no {body_or_geom} {name!r} for `{keyword}`: {suggestion}")
                patterns.append(name)
                continue
        else:
            reference_id = name_or_id.__index__() if isinstance(name_or_id, SupportsIndex) else -1
            if isinstance(name_or_id, bool) or not first_id <= reference_id < len(all_names_by_id):
                reference_text = f"the name or id of a {body_or_geom} in `{keyword}`"
                expected_text = f"{reference_text}, {first_id} to {len(all_names_by_id) - 1}"
                raise ConfigError(f"expected {expected_text}, got {reference!r}")
            name = all_names_by_id[reference_id]
        patterns.append(WILDCARDS.sub(r"[\1]", name))
    return patterns


def _are_several(references: References) -> TypeGuard[Sequence[Reference]]:
    """Return whether an argument is a list of references to bodies or geoms, rather than one."""
    return isinstance(references, Sequence | np.ndarray) and not isinstance(references, str)


def _name_or_id(reference: Reference) -> object:
    """Return the name that a reference to a body or geom has; if it has no name, its id."""
    if isinstance(reference, str):
        return reference
    return getattr(reference, "name", "") or getattr(reference, "id", reference)
