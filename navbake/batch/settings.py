"""The settings of each scene: those of the batch, replaced by its own."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from navbake.batch.store import Folder, is_url, join, parent, plain_path, read_file, shown
from navbake.config.field_types import show_value
from navbake.config.keywords import merge
from navbake.config.settings import BakeConfig, is_settings, parse_config
from navbake.errors import ConfigError, shorten
from navbake.types import Json
from navbake.yaml_text import apply_overrides, decode_yaml, override_key

OF_EACH = ("path", "id")  # keys of `scene` that are unique


class Job(NamedTuple):
    """One scene of a batch."""

    id: str  #: Unique in the batch; the output folder, parts between slashes. Empty until known.
    source: str  #: The path or URL of the scene, or of its settings (YAML).
    settings: Json  #: Override the batch's settings for it, by section.
    place: str  #: Its place in a list, for messages.
    list: str = ""  #: The URL of its list; empty for local lists and sources given by the user.
    twin: str = ""  #: The id of an equal scene, whose grid serves for this one; empty without one.


def read_shared(path: str | os.PathLike[str]) -> Json:
    """Read the settings that all scenes share from a YAML file; its path may be a URL.

    Raises a ConfigError for a missing file, no YAML, no mapping, or settings that select a scene.
    """
    text = plain_path(os.fspath(path))
    settings = nest(_read_mapping(text).items(), parent(text), shown(text))
    check_shared(settings, shown(text))
    return settings


def check_shared(settings: Mapping[str, Any], place: str) -> None:
    """Refuse shared settings that select a scene."""
    scene = {} if settings.get("scene") is None else settings["scene"]
    hint = "the batch's sources name the scenes"
    if not isinstance(scene, Mapping):
        got = f"got {show_value(scene)}: {hint}"
        raise ConfigError(f"expected settings as `scene` in {place}, {got}")
    for key in OF_EACH:
        if key in scene:
            raise ConfigError(f"expected no `scene.{key}` in {place}: {hint}")


def check_settings(sources: Iterable[str], shared: Json, overrides: Sequence[str]) -> None:
    """Check the shared settings and overrides before any scene.

    A file of outlines must exist, unless it is on a store, or an override makes it relative to each
    scene's YAML. Raises a ConfigError.
    """
    for override in overrides:
        key = override_key(override)
        if key[0] == "scene" and (len(key) == 1 or key[1] in OF_EACH):
            raise ConfigError(f"expected no --set {override}: the batch's sources name the scenes")
    outlines = outlines_of(apply_overrides(shared, overrides))
    is_of_each = outlines and not os.path.isabs(outlines) and any(map(is_settings, sources))
    if is_of_each or is_url(outlines):
        overrides = [*overrides, "rooms.polygons=[]"]
    settings_of(Job("scene", "scene.xml", {}, "the batch"), shared, overrides)


def settings_of(
    job: Job,
    shared: Json,
    overrides: Sequence[str],
    fetch: Callable[[str], Path] = Path,
) -> BakeConfig:
    """The settings of a scene: the batch's, replaced by its own, replaced by the overrides.

    Its own are those of its YAML file, replaced by those of its row in a list. Paths in its YAML
    and overrides are relative to the YAML's folder. `fetch` returns the local path of a file,
    copied if it is on a store. Raises a ConfigError.
    """
    place = f"the settings of {job.place}"
    own: Mapping[str, Any] = {"scene": {"path": job.source}}
    outlines = outlines_of(apply_overrides({}, overrides))
    if is_settings(job.source):
        folder = parent(job.source)
        own = _with_files(_read_mapping(job.source), lambda name: join(folder, name))
        outlines = outlines and join(folder, outlines)
    settings = dict(of_id(job.id))
    for part in (shared, own, job.settings):
        settings = merge(settings, part, place)
    settings = _with_files(settings, lambda name: str(fetch(name)))
    if outlines:  # JSON is YAML, whatever the path is
        overrides = [*overrides, f"rooms.polygons={json.dumps(str(fetch(outlines)))}"]
    return parse_config(settings, place, overrides)


def of_id(name: str) -> Json:
    """The settings that give a grid its scene's id, which may have folders; `scene.id` may not."""
    return {"scene": {"id": name.replace("/", "_")}}


def nest(settings: Iterable[tuple[str, Any]], folder: Folder, place: str) -> dict[str, Any]:
    """Nest settings with keys such as ``agent.radius`` by section; paths are relative to a folder.

    Raises a ConfigError, with the `place`, if a key is unknown, or has keys below a value.
    """
    nested: dict[str, Any] = {}
    for key, value in settings:
        try:
            sections = override_key(f"{key.replace('=', '..')}=")
        except ConfigError as error:
            message = f"expected a setting such as `agent.radius`, got `{shorten(key)}` at {place}"
            raise ConfigError(message) from error
        for section in reversed(sections):
            value = {section: value}
        nested = merge(nested, value, place)

    def resolve(name: str) -> str:
        path = join(folder, name)
        return path if is_url(path) else os.path.abspath(path)

    return _with_files(nested, resolve)


def outlines_of(settings: Mapping[str, Any]) -> str | None:
    """The file of room outlines in settings, None for none."""
    rooms = settings.get("rooms")
    name = rooms.get("polygons") if isinstance(rooms, Mapping) else None
    return name if isinstance(name, str) else None


def _read_mapping(path: str) -> Mapping[str, Any]:
    value, name = decode_yaml(read_file(path), shown(path)), shown(path)
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise ConfigError(f"expected a mapping of settings in {name}")
    return value


def _with_files(settings: Mapping[str, Any], change: Callable[[str], str]) -> dict[str, Any]:
    """Settings with changed paths of their scene and files of room outlines, areas and links."""
    changed = dict(settings)
    for key in ("areas", "links"):
        if isinstance(changed.get(key), str):
            changed[key] = change(changed[key])
    for section, key in (("scene", "path"), ("rooms", "polygons")):
        inner = settings.get(section)
        if isinstance(inner, Mapping) and isinstance(inner.get(key), str):
            changed[section] = {**inner, key: change(inner[key])}
    return changed
