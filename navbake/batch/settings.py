"""The settings of each scene: those of the batch, replaced by its own."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from navbake.batch.store import Folder, is_url, join, parent, plain_path, read_file, shown
from navbake.config.field_types import show_value
from navbake.config.settings import YAML_SUFFIXES, BakeConfig, parse_config
from navbake.config.yaml_text import apply_overrides, decode_yaml, override_key
from navbake.errors import ConfigError, shorten
from navbake.types import Json

OF_EACH = ("path", "id")  # keys of `scene` that no two scenes can share


class Job(NamedTuple):
    """One scene of a batch.

    Attributes:
        id: unique in the batch; the folder of what is made of it, parts between slashes.
        source: the path or URL of the scene, or of its settings (YAML).
        settings: what replaces the batch's settings for it, by section.
        place: where it stands in a list, for messages.
    """

    id: str
    source: str
    settings: Json
    place: str


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
    outlines = _polygons_of(apply_overrides(shared, overrides))
    is_of_each = outlines and not os.path.isabs(outlines) and any(map(is_yaml, sources))
    if is_of_each or is_url(outlines):
        overrides = [*overrides, "rooms.polygons=[]"]
    settings_of(Job("scene", "scene.xml", {}, "the batch"), shared, overrides)


def settings_of(
    job: Job,
    shared: Json,
    overrides: Sequence[str],
    fetch: Callable[[str], Path] | None = None,
) -> BakeConfig:
    """The settings of a scene: the batch's, replaced by its own, replaced by the overrides.

    Its own are those of its YAML file, replaced by those of its row in a list. Files that overrides
    name are relative to the YAML file's folder, as in `load_config`.

    Args:
        job: the scene.
        shared: those of the batch.
        overrides: ``a.b=value``.
        fetch: copies a file of a store and returns its path; None where nothing is on a store.

    Raises:
        ConfigError: they are wrong.
    """
    place, folder = f"the settings of {job.place}", Path()
    own: Mapping[str, Any] = {"scene": {"path": job.source}}
    if is_yaml(job.source):
        own, above = _read_mapping(job.source), parent(job.source)
        if isinstance(above, Path):
            folder = above
        else:  # what it names is on the store
            own = _with_files(own, lambda name: join(above, name))
            overrides = _with_outlines(overrides, lambda name: join(above, name))
    settings: Mapping[str, Any] = of_id(job.id)
    for part in (shared, own, job.settings):
        settings = merge(settings, part, place)
    if fetch is not None:

        def bring(name: str) -> str:
            return str(fetch(name)) if is_url(name) else name

        settings = _with_files(settings, bring)
        overrides = _with_outlines(overrides, bring)
    return parse_config(settings, place, overrides, folder=folder)


def of_id(name: str) -> Json:
    """The settings that give a grid its scene's id, which may have folders; `scene.id` may not."""
    return {"scene": {"id": name.replace("/", "_")}}


def is_yaml(source: str) -> bool:
    """Whether a scene's source is settings (YAML)."""
    return Path(source).suffix.lower() in YAML_SUFFIXES


def urls_in(source: str, settings: Sequence[Json], overrides: Sequence[str]) -> list[str]:
    """The URLs that a scene's source, its settings and overrides name outside of any file."""
    given = [source, *map(_polygons_of, settings), *map(_polygons_of, overrides)]
    return [name for name in given if name is not None and is_url(name)]


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


def nest(settings: Iterable[tuple[str, Any]], folder: Folder, place: str) -> dict[str, Any]:
    """Settings by section, from keys such as ``agent.radius``; files are relative to a folder.

    Args:
        settings: keys and values; each setting may stand once, however its key is written.
        folder: a Path, or the URL of a folder.
        place: where the settings stand, for messages.

    Raises:
        ConfigError: a setting stands twice, or a key is none.
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
        _add(nested, value, place)

    def resolve(name: str) -> str:
        path = join(folder, name)
        return path if is_url(path) else os.path.abspath(path)

    return _with_files(nested, resolve)


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


def _read_mapping(path: str) -> Mapping[str, Any]:
    value, name = decode_yaml(read_file(path), shown(path)), shown(path)
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise ConfigError(f"expected a mapping of settings in {name}")
    return value


def _polygons_of(settings: Mapping[str, Any] | str) -> str | None:
    """The file of room outlines that settings, or an override, name; None where they name none."""
    if isinstance(settings, str):
        settings = apply_overrides({}, [settings])
    rooms = settings.get("rooms")
    name = rooms.get("polygons") if isinstance(rooms, Mapping) else None
    return name if isinstance(name, str) else None


def _with_outlines(overrides: Sequence[str], change: Callable[[str], str]) -> list[str]:
    """Overrides with another path of a file of room outlines; the last one for a key counts."""
    names = [name for name in map(_polygons_of, overrides) if name is not None]
    return [*overrides, *(f"rooms.polygons={change(name)}" for name in names)]


def _with_files(settings: Mapping[str, Any], change: Callable[[str], str]) -> dict[str, Any]:
    """Settings with another path of their scene and of a file of room outlines."""
    changed = dict(settings)
    for section, key in (("scene", "path"), ("rooms", "polygons")):
        inner = settings.get(section)
        if isinstance(inner, Mapping) and isinstance(inner.get(key), str):
            changed[section] = {**inner, key: change(inner[key])}
    return changed
