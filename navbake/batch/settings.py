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
from navbake.batch.stores.store import read_file
from navbake.batch.stores.urls import Folder, is_url, join, parent, plain_path, shown
from navbake.config.settings import YAML_SUFFIXES, BakeConfig, parse_config
from navbake.config.yaml_text import MAX_BYTES, decode_yaml, override_key, read_yaml
from navbake.errors import ConfigError
from navbake.types import Json

OF_EACH = ("path", "id")  # keys of `scene` that no two scenes can share


def read_shared(path: str | os.PathLike[str]) -> Json:
    """Read the settings that all scenes share from a YAML file; its path may be a URL.

    Raises:
        ConfigError: no such file, no YAML, no mapping, or one that names a scene.
        NavbakeError: a store refuses it.
    """
    text = plain_path(os.fspath(path))
    name = shown(text)
    folder: Folder = parent(text) if is_url(text) else Path(text).parent
    if is_url(text):
        content = decode_yaml(read_file(text, MAX_BYTES), name)
    else:
        content = read_yaml(Path(text))
    settings = nest(_mapping(content, name), folder, name)
    check_shared(settings, name)
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


def without_urls(
    settings: Mapping[str, Any], overrides: Sequence[str]
) -> tuple[dict[str, Any], list[str]]:
    """Settings and overrides without outlines of rooms on a store, which no check should fetch."""
    rooms = settings.get("rooms")
    left = dict(settings)
    if isinstance(rooms, Mapping) and is_url(rooms.get("polygons")):
        left["rooms"] = {key: value for key, value in rooms.items() if key != "polygons"}
    return left, [text for text in overrides if not is_url(text.partition("=")[2].strip())]


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
        scene = own.get("scene")
        if isinstance(scene, Mapping) and is_url(scene.get("path")):
            raise ConfigError(
                f"expected a path from the folder of {source} as `scene.path`, got "
                f"{shown(scene['path'])}: name the scene in a list, with settings in its row"
            )
    # an id may have folders, which `scene.id` may not
    base = {"scene": {"id": job.id.replace("/", "_")}}
    settings = merge(merge(base, shared), merge(own, job.settings))
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


def nest(settings: Mapping[str, Any], folder: Folder, place: str = "") -> dict[str, Any]:
    """Settings by section, from keys such as ``agent.radius``; files are relative to a folder.

    Args:
        settings: what to nest.
        folder: a Path, or the URL of a folder.
        place: where the settings stand, for messages.

    Raises:
        ConfigError: settings on a store name a file elsewhere.
    """
    nested: dict[str, Any] = {}
    for key, value in settings.items():
        *sections, last = override_key(f"{key}=")
        part: dict[str, Any] = {last: value}
        for section in reversed(sections):
            part = {section: part}
        nested = merge(nested, part)
    rooms = nested.get("rooms")
    if isinstance(rooms, Mapping) and isinstance(rooms.get("polygons"), str):
        path = join(folder, rooms["polygons"], place)
        nested["rooms"] = {**rooms, "polygons": path if is_url(path) else os.path.abspath(path)}
    return nested


def _mapping(value: Any, path: str | os.PathLike[str]) -> Mapping[str, Any]:
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise ConfigError(f"expected a mapping of settings in {path}")
    return value
