"""Merges settings: keywords over a file's, a scene's over a batch's."""

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
    defaults_of,
    find_source,
    is_settings,
    memory_path,
    parse_config,
)
from navbake.errors import ConfigError, shorten
from navbake.yaml_text import read_yaml


class SettingKeywords(TypedDict, total=False):
    """The settings as keywords: the sections of a YAML file, see `docs/settings.md`."""

    scene: Mapping[str, Any]
    agent: Mapping[str, Any]
    grid: Mapping[str, Any]
    levels: str | Sequence[Mapping[str, Any]]
    floors: Mapping[str, Any]
    names: bool | Mapping[str, Any]
    rooms: str | Mapping[str, Any]
    doors: Mapping[str, Any]
    agents: Mapping[str, Any]
    areas: str | PathLike[str] | Sequence[Mapping[str, Any]]
    links: str | PathLike[str] | Sequence[Mapping[str, Any]]
    attributes: Sequence[str]
    verify: Mapping[str, Any]
    output: str | PathLike[str] | None


def merge(
    below: Mapping[str, Any], above: Mapping[str, Any], place: str, section: str = ""
) -> dict[str, Any]:
    """Merge settings key by key, `above` over `below`; a section without keys changes nothing.

    Raises a ConfigError, with the `place`, for keys below a value of `below`, as ``rooms: none``.
    """
    merged = dict(below)
    for key, value in above.items():
        under = merged.get(key)
        name = f"{section}.{key}".lstrip(".")
        if isinstance(under, Mapping) and (value is None or isinstance(value, Mapping)):
            merged[key] = merge(under, value or {}, place, name)
        elif under is None or not isinstance(value, Mapping):
            merged[key] = value
        elif value:
            raise ConfigError(
                f"`{name}` is {show_value(under)}, so there is no key for "
                f"`{shorten(f'{name}.{next(iter(value))}')}` in {place}: write the first as keys, "
                "too, or leave one of the two out"
            )
    return merged


def config_with(config: Any, keywords: Mapping[str, Any]) -> BakeConfig:
    """Settings in any form of `as_config`, with keywords over them, see `merge`.

    Tuples count as lists, and NumPy's numbers as Python's. Raises a ConfigError for wrong settings.
    """
    if not isinstance(config, BakeConfig | str | PathLike | Mapping):
        raise ConfigError(
            "expected a scene (mujoco.MjModel or MjSpec, trimesh.Scene or Trimesh), the path of "
            f"a scene or of a YAML file, or settings; got {type(config).__name__}{_hint(config)}"
        )
    if not keywords:
        return as_config(config)
    source = "the settings with the keywords"
    folder = Path()
    if isinstance(config, BakeConfig):
        config = config.model_dump(by_alias=True, exclude_unset=True)
    elif not isinstance(config, Mapping):
        path = find_source(config)
        source = f"{path} with the keywords"
        config = defaults_of(path)
        if is_settings(path):
            config = read_yaml(path)
            folder = path.parent
            if not isinstance(config, Mapping):
                return as_config(path)  # raises
    return parse_config(merge(config, _checked(keywords), source), source, folder=folder)


def memory_config(name: str, keywords: Mapping[str, Any]) -> BakeConfig:
    """The settings of a scene in memory.

    A `scene.path` in the keywords becomes the grid's, but isn't read.
    """
    settings: Mapping[str, Any] = {"scene": {"path": memory_path(name)}}
    return parse_config(merge(settings, _checked(keywords), "the keywords"), "the keywords")


def _checked(keywords: Mapping[str, Any]) -> Any:
    """The keywords as YAML values; a ConfigError suggests the section of a setting outside one."""
    for key in keywords.keys() - BakeConfig.model_fields:
        for section, model in SECTIONS.items():
            name = key.removeprefix(f"{section}_")
            if name in model.model_fields and section in BakeConfig.model_fields:
                raise ConfigError(f'write `{section}={{"{name}": …}}` in place of `{key}`')
    return _plain(keywords)


def _plain(value: Any) -> Any:
    """A value as in YAML: lists for tuples and arrays, Python's own numbers."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def _hint(given: Any) -> str:
    """A remedy for objects similar to a scene."""
    if type(given).__name__ == "MjData":
        return ": give its model first, then the data"
    # dm_control's models; then environments, and dm_control's Physics
    return next((f": give its `{name}`" for name in ("ptr", "model") if hasattr(given, name)), "")
