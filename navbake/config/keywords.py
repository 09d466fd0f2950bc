"""Settings as Python's keywords, which replace those of a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from navbake.config.settings import (
    SECTIONS,
    YAML_SUFFIXES,
    BakeConfig,
    as_config,
    memory_path,
    parse_config,
)
from navbake.config.yaml_text import read_yaml
from navbake.errors import ConfigError


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
    attributes: Sequence[str]
    verify: Mapping[str, Any]
    output: str | PathLike[str] | None


def config_with(config: Any, keywords: Mapping[str, Any]) -> BakeConfig:
    """Settings in any form that `as_config` takes, with keywords laid over them.

    A section's keys are replaced one by one, everything else as a whole. Tuples count as lists,
    and NumPy's numbers as Python's. Raises a ConfigError for wrong settings.
    """
    if not isinstance(config, BakeConfig | str | PathLike | Mapping):
        raise ConfigError(
            "expected a scene (mujoco.MjModel or MjSpec, trimesh.Scene or Trimesh), the path of "
            f"a scene or of a YAML file, or settings; got {type(config).__name__}{_hint(config)}"
        )
    if not keywords:
        return as_config(config)
    source, folder = "the settings with the keywords", Path()
    if isinstance(config, BakeConfig):
        config = config.model_dump(by_alias=True, exclude_unset=True)
    elif not isinstance(config, Mapping):
        path = Path(config)
        source, config = f"{path} with the keywords", {"scene": {"path": path}}
        if path.suffix.lower() in YAML_SUFFIXES:
            config, folder = read_yaml(path), path.parent
            if not isinstance(config, Mapping):
                return as_config(path)  # which says what is wrong with it
    return parse_config(_lay_over(config, keywords), source, folder=folder)


def memory_config(name: str, keywords: Mapping[str, Any]) -> BakeConfig:
    """The settings of a scene in memory, by its name.

    A `scene.path` among the keywords is what the grid names; nothing is read from there.
    """
    return parse_config(_lay_over({"scene": {"path": memory_path(name)}}, keywords), "the keywords")


def _lay_over(settings: Mapping[str, Any], keywords: Mapping[str, Any], at: str = "") -> Any:
    """Settings with others in their place: those of sections key by key."""
    laid = dict(settings)
    for key, value in keywords.items():
        value, where, below = _plain(value), f"{at}.{key}".lstrip("."), laid.get(key)
        if where in SECTIONS and isinstance(value, Mapping) and isinstance(below, Mapping):
            value = _lay_over(below, value, where)
        laid[key] = value
    return laid


def _plain(value: Any) -> Any:
    """A value as YAML would have it: lists for tuples and arrays, Python's own numbers."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def _hint(given: Any) -> str:
    """What to give in place of things that are close to a scene."""
    if type(given).__name__ == "MjData":
        return ": give its model first, then the data"
    # dm_control's models; then environments, and dm_control's Physics
    return next((f": give its `{name}`" for name in ("ptr", "model") if hasattr(given, name)), "")
