"""The settings of each scene: those of the batch, replaced by its own."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from navbake._version import __version__
from navbake.batch.job import Job
from navbake.batch.stores.store import read_file
from navbake.batch.stores.urls import Folder, is_url, join, parent, plain_path, shown
from navbake.config.errors import show_value
from navbake.config.settings import YAML_SUFFIXES, BakeConfig, parse_config
from navbake.config.yaml_text import (
    MAX_BYTES,
    apply_overrides,
    decode_yaml,
    override_key,
    read_yaml,
)
from navbake.errors import ConfigError, shorten
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
    settings = nest(_mapping(content, name).items(), folder, name)
    check_shared(settings, name)
    return settings


def check_shared(settings: Mapping[str, Any], place: str) -> None:
    """Refuse settings for several scenes that say which scene it is."""
    scene = settings.get("scene")
    if scene is None:
        return
    if not isinstance(scene, Mapping):
        raise ConfigError(
            f"expected settings as `scene` in {place}, got {show_value(scene)}: the batch's "
            "sources name the scenes"
        )
    for key in OF_EACH:
        if key in scene:
            raise ConfigError(
                f"expected no `scene.{key}` in {place}: the batch's sources name the scenes"
            )


def check_overrides(overrides: Sequence[str]) -> None:
    """Refuse ``--set`` of what no two scenes can share."""
    for override in overrides:
        key = override_key(override)
        if key[0] == "scene" and (len(key) == 1 or key[1] in OF_EACH):
            raise ConfigError(f"expected no --set {override}: the batch's sources name the scenes")


def check_settings(jobs: Sequence[Job], shared: Json, overrides: Sequence[str]) -> None:
    """Find out what is wrong with what all scenes share before any scene fails.

    A file of outlines is looked for unless it is on a store, or is another one for each scene: in
    an override, a path is relative to the scene's YAML, where it has one.

    Raises:
        ConfigError: a setting is wrong, or a file isn't there.
    """
    rooms = apply_overrides(shared, overrides).get("rooms")
    outlines = rooms.get("polygons") if isinstance(rooms, Mapping) else None
    if isinstance(outlines, str):
        # paths of the shared settings are absolute
        is_of_each = not os.path.isabs(outlines) and any(_is_yaml(job.source) for job in jobs)
        if is_of_each or is_url(outlines):
            overrides = [*overrides, "rooms.polygons=[]"]
    settings_of(Job("scene", "scene.xml", {}, "the batch"), shared, overrides)


def settings_of(job: Job, shared: Json, overrides: Sequence[str]) -> BakeConfig:
    """The settings of a scene: the batch's, replaced by its own, replaced by the overrides.

    Its own are those of its YAML file, replaced by those of its row in a list. Files that overrides
    name are relative to the YAML file's folder, as in `load_config`.

    Raises:
        ConfigError: they are wrong.
    """
    source, folder = Path(job.source), Path()
    own: Mapping[str, Any] = {"scene": {"path": job.source}}
    if _is_yaml(source):
        own, folder = _mapping(read_yaml(source), source), source.parent
        scene = own.get("scene")
        if isinstance(scene, Mapping) and is_url(scene.get("path")):
            raise ConfigError(
                f"expected a path from the folder of {source} as `scene.path`, got "
                f"{shown(scene['path'])}: name the scene in a list, with settings in its row"
            )
    place = f"the settings of {job.place}"
    settings = of_id(job.id)
    for part in (shared, own, job.settings):
        settings = merge(settings, part, place)
    return parse_config(settings, place, overrides, folder=folder)


def of_id(name: str) -> Json:
    """The settings that give a grid its scene's id, which may have folders; `scene.id` may not."""
    return {"scene": {"id": name.replace("/", "_")}}


def _is_yaml(source: str | os.PathLike[str]) -> bool:
    return Path(source).suffix.lower() in YAML_SUFFIXES


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


def merge(
    below: Mapping[str, Any], above: Mapping[str, Any], place: str = "", section: str = ""
) -> dict[str, Any]:
    """Settings laid over others, section by section; a section without keys changes nothing.

    Args:
        below: what is replaced, key by key.
        above: what replaces it.
        place: what the settings are of, for messages.
        section: the key under which both stand, for messages.

    Raises:
        ConfigError: there are keys above for what is a value below, as ``rooms: none``. They would
            undo it; --set refuses that, too.
    """
    merged = dict(below)
    for key, value in above.items():
        under, name = merged.get(key), f"{section}.{key}".lstrip(".")
        if value == {} or (value is None and isinstance(under, Mapping)):
            merged.setdefault(key, value)
        elif isinstance(value, Mapping) and isinstance(under, Mapping):
            merged[key] = merge(under, value, place, name)
        elif isinstance(value, Mapping) and under is not None:
            inner = f"{name}.{next(iter(value))}"
            raise ConfigError(
                f"`{name}` is {show_value(under)}, so there is no key for `{shorten(inner)}` in "
                f"{place}: write the first as keys, too, or leave one of the two out"
            )
        else:
            merged[key] = value
    return merged


def nest(settings: Iterable[tuple[str, Any]], folder: Folder, place: str = "") -> dict[str, Any]:
    """Settings by section, from keys such as ``agent.radius``; files are relative to a folder.

    Args:
        settings: keys and values; each setting may stand once, however its key is written.
        folder: a Path, or the URL of a folder.
        place: where the settings stand, for messages.

    Raises:
        ConfigError: a setting stands twice, a key is none, or settings on a store name a file
            elsewhere.
    """
    nested: dict[str, Any] = {}
    for key, value in settings:
        *sections, last = _split_key(key, place)
        part: dict[str, Any] = {last: value}
        for section in reversed(sections):
            part = {section: part}
        _add(nested, part, place)
    rooms = nested.get("rooms")
    if isinstance(rooms, Mapping) and isinstance(rooms.get("polygons"), str):
        path = join(folder, rooms["polygons"], place)
        nested["rooms"] = {**rooms, "polygons": path if is_url(path) else os.path.abspath(path)}
    return nested


def _split_key(key: str, place: str) -> tuple[str, ...]:
    try:
        if "=" not in key:
            return override_key(f"{key}=")
    except ConfigError:
        pass
    raise ConfigError(f"expected a setting such as `agent.radius`, got `{shorten(key)}` at {place}")


def _add(settings: dict[str, Any], more: Mapping[str, Any], place: str, section: str = "") -> None:
    """Add settings to those of the same place, none of which they may set again."""
    for key, value in more.items():
        known, name = settings.get(key), f"{section}.{key}".lstrip(".")
        if known is None and (key not in settings or isinstance(value, Mapping)):
            settings[key] = value
        elif isinstance(known, Mapping) and isinstance(value, Mapping):
            settings[key] = dict(known)
            _add(settings[key], value, place, name)
        elif not (isinstance(known, Mapping) and value is None):
            raise ConfigError(f"expected each setting once, got `{shorten(name)}` twice at {place}")


def _mapping(value: Any, path: str | os.PathLike[str]) -> Mapping[str, Any]:
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise ConfigError(f"expected a mapping of settings in {path}")
    return value
