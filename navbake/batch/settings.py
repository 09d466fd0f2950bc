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
from navbake.config.settings import YAML_SUFFIXES, BakeConfig, parse_config
from navbake.config.yaml_text import apply_overrides, decode_yaml, override_key
from navbake.errors import ConfigError, shorten
from navbake.types import Json

OF_EACH = ("path", "id")  # keys of `scene` that no two scenes can share


class Job(NamedTuple):
    """One scene of a batch.

    Attributes:
        id: unique in the batch; the folder of what is made of it, parts between slashes. Empty
            while it isn't known yet.
        source: the path or URL of the scene, or of its settings (YAML).
        settings: what replaces the batch's settings for it, by section.
        place: where it stands in a list, for messages.
        list: the URL of the list that names it; empty where the user does, or a list that is here.
    """

    id: str
    source: str
    settings: Json
    place: str
    list: str = ""


def read_shared(path: str | os.PathLike[str]) -> Json:
    """Read the settings that all scenes share from a YAML file; its path may be a URL.

    Raises:
        ConfigError: no such file, no YAML, no mapping, or one that names a scene.
    """
    text = plain_path(os.fspath(path))
    settings = nest(_read_mapping(text).items(), parent(text), shown(text))
    check_shared(settings, shown(text))
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


def check_settings(sources: Iterable[str], shared: Json, overrides: Sequence[str]) -> None:
    """Find out what is wrong with what all scenes share before any scene fails.

    A file of outlines is looked for unless it is on a store, or is another one for each scene: in
    an override, a path is relative to the scene's YAML, where it has one.

    Raises:
        ConfigError: a setting is wrong, or a file isn't there.
    """
    for override in overrides:
        key = override_key(override)
        if key[0] == "scene" and (len(key) == 1 or key[1] in OF_EACH):
            raise ConfigError(f"expected no --set {override}: the batch's sources name the scenes")
    outlines = outlines_of(apply_overrides(shared, overrides))
    is_of_each = outlines and not os.path.isabs(outlines) and any(map(is_yaml, sources))
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

    Its own are those of its YAML file, replaced by those of its row in a list. Files that its YAML
    and overrides name are relative to the YAML's folder.

    Args:
        job: the scene.
        shared: those of the batch.
        overrides: ``a.b=value``.
        fetch: the path of a file, which it copies if it is on a store.

    Raises:
        ConfigError: they are wrong.
    """
    place = f"the settings of {job.place}"
    own: Mapping[str, Any] = {"scene": {"path": job.source}}
    outlines = outlines_of(apply_overrides({}, overrides))
    if is_yaml(job.source):
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


def is_yaml(source: str) -> bool:
    """Whether a scene's source is settings (YAML)."""
    return Path(source).suffix.lower() in YAML_SUFFIXES


def nest(settings: Iterable[tuple[str, Any]], folder: Folder, place: str) -> dict[str, Any]:
    """Settings by section, from keys such as ``agent.radius``; files are relative to a folder.

    Raises:
        ConfigError: a key is none, or has keys below a value; the message names the `place`.
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
    """The file of room outlines that settings name; None where they name none."""
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
    """Settings with another path of their scene and of a file of room outlines."""
    changed = dict(settings)
    for section, key in (("scene", "path"), ("rooms", "polygons")):
        inner = settings.get(section)
        if isinstance(inner, Mapping) and isinstance(inner.get(key), str):
            changed[section] = {**inner, key: change(inner[key])}
    return changed
