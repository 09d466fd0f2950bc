"""Merges settings.

Keyword arguments override the settings of a file. In a batch, a scene's own settings override those
of the batch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from navbake.config.field_types import show_value
from navbake.config.settings import (
    SECTIONS,
    BakeConfig,
    as_config,
    find_scene_path,
    find_source,
    is_settings,
    make_default_settings,
    make_memory_path,
    parse_config,
    read_settings,
)
from navbake.errors import ConfigError, shorten


class SettingKeywords(TypedDict, total=False):
    """The settings as keywords of a function: the sections of a YAML file, see docs/settings.md."""

    scene: Mapping[str, object]
    agent: Mapping[str, object]
    grid: Mapping[str, object]
    levels: str | Sequence[Mapping[str, object]]
    floors: Mapping[str, object]
    names: bool | Mapping[str, object]
    rooms: str | Mapping[str, object]
    doors: Mapping[str, object]
    agents: Mapping[str, object]
    areas: str | PathLike[str] | Sequence[Mapping[str, object]]
    links: str | PathLike[str] | Sequence[Mapping[str, object]]
    attributes: Sequence[str]
    verify: Mapping[str, object]
    output: str | PathLike[str] | None


def overlay_settings(
    lower_settings: Mapping[str, Any],
    upper_settings: Mapping[str, Any],
    place: str,
    section: str = "",
) -> dict[str, Any]:
    """Merge two mappings of settings key by key: those of the upper replace those of the lower.

    A section that has no keys in `upper_settings` keeps those of `lower_settings`.

    Args:
        lower_settings: Nested mappings of settings.
        upper_settings: Nested mappings of settings, which replace those of `lower_settings`.
        place: What `upper_settings` was read from, for messages.
        section: Dotted key of the section that both mappings belong to; "" for the top.

    Returns:
        The merged settings, a new mapping.

    Raises:
        ConfigError: `upper_settings` has keys for a section of which `lower_settings` has a plain
            value, such as ``rooms: none``.
    """
    merged_settings = dict(lower_settings)
    for key, value in upper_settings.items():
        lower_value = merged_settings.get(key)
        dotted_key = f"{section}.{key}".lstrip(".")
        if isinstance(lower_value, Mapping) and (value is None or isinstance(value, Mapping)):
            merged_settings[key] = overlay_settings(lower_value, value or {}, place, dotted_key)
        elif lower_value is None or not isinstance(value, Mapping):
            merged_settings[key] = value
        elif value:
            hint = "write the first as keys, too, or leave one of the two out"
            key_above = f"{dotted_key}.{next(iter(value))}"
            raise ConfigError(
                f"`{dotted_key}` is {show_value(lower_value)}, so there is no key for "
                f"`{shorten(key_above)}` in {place}: {hint}",
                path=place,
                key=key_above,
                hint=hint,
            )
    return merged_settings


def add_keywords_to_config(config: object, keywords: Mapping[str, Any]) -> BakeConfig:
    """Merge keywords over settings, and validate the result.

    Args:
        config: Settings in any form of `as_config`.
        keywords: Settings as nested mappings; tuples and arrays count as lists, and NumPy's numbers
            as Python's.

    Returns:
        The validated settings.

    Raises:
        ConfigError: A setting is wrong, or `config` has another type.
    """
    if not isinstance(config, BakeConfig | str | PathLike | Mapping):
        expected = (
            "a scene (mujoco.MjModel or MjSpec, trimesh.Scene or Trimesh), the path of a scene or "
            "of a YAML file, or settings"
        )
        hint = _describe_scene_attribute(config)
        raise ConfigError(
            f"expected {expected}; got {type(config).__name__}{hint}",
            expected=expected,
            hint=hint.removeprefix(": ") or None,
        )
    if not keywords:
        return as_config(config)
    source_text = "the settings with the keywords"
    folder = Path()
    settings_file = ""
    settings: Mapping[str, Any]
    if isinstance(config, BakeConfig):
        settings = config.model_dump(by_alias=True, exclude_unset=True)
    elif isinstance(config, Mapping):
        settings = config
    else:
        path = find_source(config)
        source_text = f"{path} with the keywords"
        settings = make_default_settings(path)
        if is_settings(path):
            settings = read_settings(path)
            settings_file = str(path)
            folder = path.parent
            if not isinstance(settings, Mapping):
                return as_config(path)  # raises the error
    merged_settings = overlay_settings(settings, _check_keywords(keywords), source_text)
    if find_scene_path(merged_settings) != find_scene_path(settings):
        settings_file = ""
    return parse_config(
        merged_settings,
        source_text,
        folder=folder,
        settings_file=settings_file,
    )


def make_memory_config(name: str, keywords: Mapping[str, Any]) -> BakeConfig:
    """Return the settings of a scene in memory.

    Args:
        name: The name of the scene.
        keywords: Settings as nested mappings. A `scene.path` among them is stored in the grid as
            the scene's path, but the file is not read.

    Returns:
        The validated settings.

    Raises:
        ConfigError: A setting is wrong.
    """
    settings: Mapping[str, Any] = {"scene": {"path": make_memory_path(name)}}
    source_text = "the keywords"
    return parse_config(
        overlay_settings(settings, _check_keywords(keywords), source_text), source_text
    )


def _check_keywords(keywords: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the values of keywords to YAML values.

    Raises:
        ConfigError: A keyword is a setting of a section; the message names the section.
    """
    for key in keywords.keys() - BakeConfig.model_fields:
        for section, model in SECTIONS.items():
            setting_key = key.removeprefix(f"{section}_")
            if setting_key in model.model_fields and section in BakeConfig.model_fields:
                hint = f'write `{section}={{"{setting_key}": …}}`'
                raise ConfigError(f"{hint} in place of `{key}`", key=key, hint=hint)
    return {key: _as_yaml_value(value) for key, value in keywords.items()}


def _as_yaml_value(value: object) -> object:
    """Convert tuples and arrays in a value to lists, and NumPy's numbers to Python's."""
    if isinstance(value, Mapping):
        return {key: _as_yaml_value(element) for key, element in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_as_yaml_value(element) for element in value]
    return value


def _describe_scene_attribute(scene: object) -> str:
    """Name the attribute to give in place of an object that holds a scene; "" for other objects."""
    if type(scene).__name__ == "MjData":
        return ": give its model first, then the data"
    # dm_control's models have `ptr`; environments and dm_control's Physics have `model`
    for attribute in ("ptr", "model"):
        if hasattr(scene, attribute):
            return f": give its `{attribute}`"
    return ""
