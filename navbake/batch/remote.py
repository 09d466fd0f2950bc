"""Scenes on stores, and grids that are written to one: files are copied, on both ways."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from navbake._version import __version__
from navbake.batch.file_states import (
    Places,
    are_unchanged,
    describe_files,
    has_no_other,
    list_candidates,
    path_from,
)
from navbake.batch.full import FullError
from navbake.batch.products import GRID, NOTE, THUMBNAIL, noting
from navbake.batch.stores.mirror import Mirror, upload
from navbake.batch.stores.notes import read_note_at, write_note_at
from navbake.batch.stores.store import (
    Entry,
    Listing,
    is_unchanged,
    list_folder,
    list_tree,
    remove_files,
    state_of,
)
from navbake.batch.stores.urls import is_url, join, parent, shown, split_url
from navbake.config.settings import YAML_SUFFIXES
from navbake.config.yaml_text import override_key, parse_yaml
from navbake.errors import ConfigError, NavbakeError
from navbake.files import TEMPORARY, scratch_folder
from navbake.formats.scene_files import Folders
from navbake.types import Json

if TYPE_CHECKING:
    from navbake.batch.work import Order

POLYGONS = ("rooms", "polygons")  # the one setting that names a file


def is_remote(order: Order) -> bool:
    """Whether a scene, its outlines of rooms, or the output folder is on a store."""
    return is_url(order.folder) or any(map(is_url, _named(order)))


def refuse_unshared(orders: Iterable[Order], unshared: Collection[str]) -> None:
    """Raise a ConfigError for a URL of one of some schemes, whose files processes don't share."""
    for order in orders:
        for url in filter(is_url, (str(order.folder), *_named(order))):
            if url.partition("://")[0].lower() in unshared:
                raise ConfigError(
                    f"expected files that all processes share, got {shown(url)}: each process has "
                    "a memory of its own"
                )


def name_source(order: Order) -> str:
    """How the index calls a scene's source: from the output folder, if that is on this machine."""
    return _name_path(order.job.source, order)


def remote_key_of(order: Order) -> str:
    """What the result depends on besides the scene's files, hashed; settings (YAML) are one.

    `work.key_of` hashes settings as they are validated, for which they have to be read. These are
    hashed as they were given, so that 10,000 scenes are known to be done by listings alone.
    """
    stated = {
        "id": order.job.id,
        "source": name_source(order),
        "settings": [order.settings, order.job.settings, order.overrides],
        "products": [str(product) for product in order.products],
        "version": __version__,
    }
    canonical = json.dumps(stated, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(canonical.encode()).hexdigest()


def make_remote(order: Order, make: Callable[[Order], Json]) -> Json:
    """Make what is asked for of a scene in a temporary folder; `make` does so of what is near.

    On a store, files appear whole as well, the grid last. Errors and the row name what is on a
    store by its URL.
    """
    settings = _settings_here(order)  # before the bake, see `work._make`
    with scratch_folder() as scratch:
        scratch = Path(os.path.realpath(scratch))  # as paths from the output folder lead to it
        mirror = Mirror(scratch / "in")
        try:
            near = _bring(order, mirror)
            if isinstance(order.folder, str):
                near = near._replace(folder=scratch / "out")
            row = make(near)
        except (NavbakeError, OSError) as error:
            if isinstance(error, FullError) and isinstance(order.folder, Path):
                raise  # else it is the temporary folder that has no room
            raise NavbakeError(mirror.told(str(error))) from error
        row |= {
            "source": name_source(order),
            "key": remote_key_of(order),
            **_looked_here(order, near, row, mirror),
            "inputs": {**_inputs(order, near, row["inputs"], mirror), **settings},
        }
        if isinstance(order.folder, str):
            place = f"{order.folder}/{order.job.id}"
            names = [name for name in row["files"] if name != GRID]
            if order.thumbnail:  # it is no product, so the row doesn't name it
                names.append(THUMBNAIL)
            there = remove_products_at(place)
            with noting(names, there, partial(write_note_at, place)):
                entries = upload({name: near.place / name for name in (*names, GRID)}, place)
            row["files"] = {
                name: state_of(entries[name], state) for name, state in row["files"].items()
            }
    return row


def remove_products_at(place: str) -> set[str]:
    """Do on a store what `products.remove_products` does on this machine.

    Returns:
        The names of the files that are left.
    """
    found = list_folder(place)
    noted = read_note_at(place) if NOTE in found else set()
    others = [*sorted(noted), *filter(TEMPORARY.fullmatch, found)]
    names = [name for name in (GRID, *others, NOTE) if name in found]
    remove_files(f"{place}/{name}" for name in names)
    return found.keys() - set(names)


def remove_remote_products(order: Order) -> None:
    """Remove what was made of a scene that failed, as far as the store lets."""
    with suppress(NavbakeError):
        remove_products_at(f"{order.folder}/{order.job.id}")


def find_done(orders: Sequence[Order], known: Mapping[str, Json]) -> set[str]:
    """The ids of scenes on stores that the index knows to be done; see `batch.run_batch`.

    The stores are asked for listings of folders, see `Listing.load`; a file is read only where its
    size and tag don't prove that it is the same.
    """
    rows = {order.job.id: _row_of(order, known) for order in orders}
    todo = [order for order in orders if rows[order.job.id]]
    if not todo:
        return set()
    listing = Listing()
    with suppress(NavbakeError):  # what can't be listed is asked for by itself, and isn't done
        listing.load({parent(url) for order in todo for url in _remote_inputs(order, rows)})
    folder = todo[0].folder
    made = list_tree(folder, is_own=True) if isinstance(folder, str) else {}
    base = folder if isinstance(folder, Path) else Path()
    places, listed = Places(base), Folders(base)
    todo = [order for order in todo if _is_found(order, rows[order.job.id], places, listed)]
    return {o.job.id for o in todo if _is_done(o, rows[o.job.id], listing, made)}


def _named(order: Order) -> list[str]:
    """The paths that an order names, as far as they are in no file."""
    outlines = [_outlines_of(order.settings), _outlines_of(order.job.settings)]
    given = [text.partition("=")[2].strip() for text in order.overrides if _is_outlines(text)]
    return [order.job.source, *(name for name in (*outlines, *given) if name is not None)]


def _outlines_of(settings: Json) -> str | None:
    """The file of room outlines that settings name; None where they name none."""
    rooms = settings.get(POLYGONS[0])
    name = rooms.get(POLYGONS[1]) if isinstance(rooms, Mapping) else None
    return name if isinstance(name, str) else None


def _is_outlines(override: str) -> bool:
    return override_key(override) == POLYGONS


def _bring(order: Order, mirror: Mirror) -> Order:
    """The order with all that is on stores copied to this machine."""
    source = order.job.source
    if is_url(source):
        fetch = mirror.fetch_settings if _is_settings(source) else mirror.fetch_scene
        path = fetch(source)
        source = str(path)
    overrides = []
    for text in order.overrides:
        name = _outlines_given(text, order.job.source)
        if name is not None:
            text = f"{'.'.join(POLYGONS)}={json.dumps(str(mirror.fetch(name)))}"
        overrides.append(text)
    job = order.job._replace(source=source, settings=_bring_outlines(order.job.settings, mirror))
    settings = _bring_outlines(order.settings, mirror)
    return order._replace(job=job, settings=settings, overrides=tuple(overrides))


def _outlines_given(override: str, source: str) -> str | None:
    """The URL of the outlines that an override names; None where it names none on a store."""
    if not _is_outlines(override):
        return None
    name = parse_yaml(override.partition("=")[2], f"--set {override}")
    if not isinstance(name, str):
        return None
    # as on this machine: see `settings_of`
    is_beside = is_url(source) and _is_settings(source) and not os.path.isabs(name)
    if is_beside and not is_url(name):
        return join(parent(source), name, f"--set {override}")
    return name if is_url(name) else None


def _is_settings(source: str) -> bool:
    """Whether a scene's source is settings (YAML)."""
    path = split_url(source).text if is_url(source) else source
    return Path(path).suffix.lower() in YAML_SUFFIXES


def _bring_outlines(settings: Json, mirror: Mirror) -> Json:
    name = _outlines_of(settings)
    if name is None or not is_url(name):
        return settings
    rooms = {**settings[POLYGONS[0]], POLYGONS[1]: str(mirror.fetch(name))}
    return {**settings, POLYGONS[0]: rooms}


def _settings_here(order: Order) -> Json:
    """The state of a scene's settings (YAML) on this machine; {} where it has none here.

    They aren't read to find out whether a scene is done (see `remote_key_of`): they are a file like
    others.
    """
    source = order.job.source
    if is_url(source) or not _is_settings(source) or not os.path.isfile(source):
        return {}
    (state,) = describe_files([Path(source)], Places(Path())).values()
    return {_name_path(source, order): state}


def _inputs(order: Order, near: Order, stated: Json, mirror: Mirror) -> Json:
    """The states of a scene's files, by their URLs where they are on a store."""
    inputs, folder = {}, os.path.realpath(near.folder)
    for name, state in stated.items():
        path = os.path.normpath(os.path.join(folder, name))
        url, entry = mirror.url_of(path), mirror.entry(path)
        if url is None:
            inputs[_name_path(path, order)] = state
        else:
            inputs[shown(url)] = state_of(entry or Entry(None, None), state)
    source = order.job.source
    if is_url(source) and shown(source) not in inputs:
        inputs[shown(source)] = mirror.state(source)
    return inputs


def _looked_here(order: Order, near: Order, row: Json, mirror: Mirror) -> Json:
    """The scene, and where its files were looked for, if that is on this machine.

    A store is not asked whether it has a new file that may be meant instead.
    """
    if is_url(order.job.source):
        return {"named": [], "sought": {}}
    folder = os.path.realpath(near.folder)
    stated: Json = {"named": row["named"][:1], "sought": row["sought"]["folders"]}
    for key, paths in stated.items():
        full = (os.path.normpath(os.path.join(folder, path)) for path in paths)
        stated[key] = [_name_path(path, order) for path in full if mirror.url_of(path) is None]
    return {**stated, "sought": {**row["sought"], "folders": stated["sought"]}}


def _name_path(path: str, order: Order) -> str:
    if is_url(path):
        return shown(path)
    if isinstance(order.folder, str):
        return Path(path).absolute().as_posix()
    return path_from(path, order.folder)


def _row_of(order: Order, known: Mapping[str, Json]) -> Json:
    """The row of a scene that is done as far as the index says; {} if it isn't.

    An index on a store may come from a stranger. So no store is asked for a file that it states but
    those that the scene is on.
    """
    row = known.get(order.job.id, {})
    is_same = row.get("status") == "ok" and row.get("key") == remote_key_of(order)
    has_files = all(isinstance(row.get(key), dict) and row[key] for key in ("inputs", "files"))
    return row if is_same and has_files and _has_own_inputs(row, order) else {}


def _has_own_inputs(row: Json, order: Order) -> bool:
    """Whether the files that a row states are on stores that the order names."""
    roots = {shown(split_url(url).root) for url in _named(order) if is_url(url)}
    try:
        return all(shown(split_url(name).root) in roots for name in row["inputs"] if is_url(name))
    except NavbakeError:  # what no batch writes
        return False


def _remote_inputs(order: Order, rows: Mapping[str, Json]) -> list[str]:
    return [_real(name, order) for name in rows[order.job.id]["inputs"] if is_url(name)]


def _real(name: str, order: Order) -> str:
    """The URL that the index shows without its password or query."""
    for url in filter(is_url, _named(order)):
        root = split_url(url).root
        if name == shown(url):
            return url
        if shown(root) != root and name.startswith(f"{shown(root)}/"):
            return root + name[len(shown(root)) :]
    return name


def _is_done(order: Order, row: Json, listing: Listing, made: Mapping[str, Entry]) -> bool:
    try:
        here = {name: state for name, state in row["inputs"].items() if not is_url(name)}
        if not are_unchanged(here, order.folder if isinstance(order.folder, Path) else Path()):
            return False
        for name in row["inputs"].keys() - here.keys():
            url = _real(name, order)
            if not is_unchanged(row["inputs"][name], listing.entry(url), url):
                return False
        if isinstance(order.folder, Path):
            return are_unchanged(row["files"], order.place)
        return all(
            is_unchanged(
                state,
                made.get(f"{order.job.id}/{name}"),
                f"{order.folder}/{order.job.id}/{name}",
            )
            for name, state in row["files"].items()
        )
    except (NavbakeError, KeyError, TypeError, AttributeError):  # or no row of a batch's
        return False


def _is_found(order: Order, row: Json, places: Places, listed: Folders) -> bool:
    """Whether this machine has no file that a scene of its own may mean instead of a known one."""
    if is_url(order.job.source):
        return True
    try:
        scene = os.path.join(places.folder, row["named"][0])
        if not os.path.isfile(scene):  # who reads a pipe may wait for ever
            return False
        here = [os.path.join(places.folder, name) for name in row["inputs"] if not is_url(name)]
        known = {*row["inputs"], *map(places.of_file, here)}
        return has_no_other(list_candidates(row["sought"], scene, listed), known, places)
    except (NavbakeError, KeyError, TypeError, AttributeError, IndexError, ValueError):
        return False
