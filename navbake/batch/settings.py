"""The settings of each scene: those of the batch, replaced by its own."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from navbake._version import __version__
from navbake.batch.job import Job
from navbake.config.settings import YAML_SUFFIXES, BakeConfig, parse_config
from navbake.config.yaml_text import override_key, read_yaml
from navbake.errors import ConfigError
from navbake.types import Json

OF_EACH = ("path", "id")  # keys of `scene` that no two scenes can share


def read_shared(path: str | os.PathLike[str]) -> Json:
    """Read the settings that all scenes share from a YAML file.

    Raises:
        ConfigError: no such file, no YAML, no mapping, or one that names a scene.
    """
    settings = _mapping(read_yaml(Path(path)), path)
    settings = nest(settings, Path(path).parent)
    check_shared(settings, str(path))
    return settings


def check_shared(settings: Mapping[str, Any], place: str) -> None:
    """Refuse settings for several scenes that say which scene it is."""
    scene = settings.get("scene")
    for key in OF_EACH:
        if isinstance(scene, Mapping) and key in scene:
            raise ConfigError(
                f"expected no `scene.{key}` in {place}: the batch's sources name the scenes"
            )


def check_overrides(overrides: Sequence[str]) -> None:
    """Refuse ``--set`` of what no two scenes can share."""
    for override in overrides:
        key = override_key(override)
        if key[0] == "scene" and (len(key) == 1 or key[1] in OF_EACH):
            raise ConfigError(f"expected no --set {override}: the batch's sources name the scenes")


def settings_of(job: Job, shared: Json, overrides: Sequence[str]) -> BakeConfig:
    """The settings of a scene: the batch's, replaced by its own, replaced by the overrides.

    Its own are those of its YAML file, replaced by those of its row in a list.

    Raises:
        ConfigError: they are wrong.
    """
    source, folder = Path(job.source), Path()
    own: Mapping[str, Any] = {"scene": {"path": job.source}}
    if source.suffix.lower() in YAML_SUFFIXES:
        own, folder = _mapping(read_yaml(source), source), source.parent
    settings = merge(merge({"scene": {"id": job.id}}, shared), merge(own, job.settings))
    return parse_config(settings, f"the settings of {job.place}", overrides, folder=folder)


def digest_settings(config: BakeConfig, products: Sequence[str]) -> str:
    """Hash all that decides over what is made of a scene, but for its files.

    That is each setting, the name of the scene's file (which the grid states), the products, and
    the version of navbake. `settings_digest` is another: it leaves out what changes no cell.
    """
    stated = {
        "settings": config.model_dump(mode="json", exclude={"output": True, "scene": {"path"}}),
        "file": Path(config.scene.path).name,
        "products": list(products),
        "version": __version__,
    }
    canonical = json.dumps(stated, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()


def merge(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Settings laid over others, section by section; a section without keys changes nothing."""
    merged = dict(below)
    for key, value in above.items():
        under = merged.get(key)
        if isinstance(under, Mapping) and isinstance(value, Mapping):
            merged[key] = merge(under, value)
        elif not (isinstance(under, Mapping) and value is None):
            merged[key] = value
    return merged


def nest(settings: Mapping[str, Any], folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Settings by section, from keys such as ``agent.radius``; files are relative to a folder."""
    nested: dict[str, Any] = {}
    for key, value in settings.items():
        *sections, last = override_key(f"{key}=")
        part: dict[str, Any] = {last: value}
        for section in reversed(sections):
            part = {section: part}
        nested = merge(nested, part)
    rooms = nested.get("rooms")
    if isinstance(rooms, Mapping) and isinstance(rooms.get("polygons"), str):
        path = os.path.abspath(os.path.join(folder, rooms["polygons"]))
        nested["rooms"] = {**rooms, "polygons": path}
    return nested


def _mapping(value: Any, path: str | os.PathLike[str]) -> Mapping[str, Any]:
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise ConfigError(f"expected a mapping of settings in {path}")
    return value
