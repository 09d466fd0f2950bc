"""Bakes one scene of a batch in a worker, and decides whether it is done already."""

from __future__ import annotations

import hashlib
import json
import os
import time
import traceback
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from navbake import samples
from navbake._version import __version__
from navbake.auditor.audit import audit
from navbake.baker.bake.pipeline import run_bake
from navbake.baker.readers.mesh import MESH_SUFFIXES
from navbake.baker.scene.model import limit_mesh_cache
from navbake.batch import store
from navbake.batch.products import (
    GRID_NAME,
    PRODUCT_FILE_PATTERN,
    RECORD_NAME,
    THUMBNAIL_NAME,
    make_product,
)
from navbake.batch.scenes import Job, outlines_of, settings_of
from navbake.config.settings import (
    BakeConfig,
    load_config,
    settings_digest,
    settings_to_state,
)
from navbake.errors import NavbakeError, printable
from navbake.files import remove_leftovers, scratch_folder
from navbake.formats.navgrid import read_navgrid, write_navgrid
from navbake.formats.scene_files import find_inputs, scene_suffix
from navbake.formats.source import write_bytes
from navbake.lazy import lazy
from navbake.navgrid.grid import NavGrid
from navbake.processes import lacked_memory
from navbake.types import Json
from navbake.yaml_text import apply_overrides

notebook = lazy("navbake.views.notebook")  # loads Pillow

OK = "ok"
FAILED = "failed"
LEFT_OUT = "left"
NOT_RECORDED = "new"  # why a scene without a record isn't done
RAISED = "error"  # of a failure in a process that goes on
SECONDS_DECIMALS = 4  # of seconds
# Of meshes that MuJoCo keeps in a worker [bytes]; by itself it keeps 500 MB
MESH_CACHE_SIZE = 64 << 20
# keys of a record that are not in the index: files that don't count, and parts of the key
RECORD_ONLY_KEYS = ("more", "content", "settings", "products")


class Plan(NamedTuple):
    """The options of a batch."""

    folder: store.Folder  #: The output folder, a Path or a URL.
    settings: Json  #: Those that all scenes share, by section.
    #: ``a.b=value``, which replace those of the batch and of the scene.
    overrides: tuple[str, ...] = ()
    products: tuple[str, ...] = ()  #: Besides the grid, see `products.parse_products`.
    thumbnail: bool = False  #: Whether to make a small picture for the batch's page.
    has_table: bool = False  #: Whether the index is written as Parquet as well.
    #: Further hosts that lists, settings and redirects on the web may lead to.
    hosts: tuple[str, ...] = ()

    def place(self, job: Job) -> store.Folder:
        """Return a scene's output folder.

        Raises a NavbakeError if the folder is a link that leads out of the batch's output folder.
        """
        place = store.as_folder(store.join(self.folder, job.id))
        store.check_inside(self.folder, place)
        return place

    def trusted_urls(self, job: Job) -> list[str]:
        """Return the URLs of a scene that the user gave, not those that a list gave."""
        settings = [self.settings, apply_overrides({}, self.overrides)]
        settings += [] if job.list else [job.settings]
        return [name for name in (job.list or job.source, *map(outlines_of, settings)) if name]


class BatchScene(NamedTuple):
    """The settings, input files and digests of a scene that is to be baked."""

    config: BakeConfig  #: Its settings, with paths on this machine.
    #: Size and digest of each input file, by its path from the output folder, or its URL.
    inputs: dict[str, Json]
    key: str  #: Changes when the grid or a product may change; see `open_scene`.
    #: The key without products, id and, but of mesh scenes, the file's name: scenes with the same
    #: have the same cells.
    content: str
    settings: str  #: Digest of the settings.


# ---------------------------------------------------------------- the key


@contextmanager
def open_scene(plan: Plan, job: Job, *, copy_all: bool) -> Iterator[BatchScene]:
    """Find a scene's files and compute its key; copies from stores exist inside the with statement.

    The key is a digest of the settings, navbake's version, the products, and the name and content
    (on a store: the store's digest) of each input file. Textures and skins are left out, as they
    change no cell. With `copy_all`, all files are copied from stores; without, only files that name
    further files.
    """
    store.allow_hosts(plan.hosts)
    store.check_host(job.source, plan.trusted_urls(job))
    with store.Mirror(plan.trusted_urls(job)) as mirror:
        try:
            config = settings_of(job, plan.settings, plan.overrides, mirror.fetch)
            scene = _describe(plan, config, mirror)
            if copy_all and mirror.url_of(config.inputs[0]):
                for path in find_inputs(
                    config.inputs[0], mirror, with_textures=True, folders=config.scene.model_path
                ):
                    mirror.ensure_local(path)
            yield scene
        except (NavbakeError, OSError) as error:
            translated = mirror.translate_paths(str(error))
            if store.why_full(error) or translated == str(error):
                raise
            raise NavbakeError(translated) from error


def _describe(plan: Plan, config: BakeConfig, mirror: store.Mirror) -> BatchScene:
    """The files and the key of a scene from its settings."""
    # the grid states the name
    home = config.inputs[0].parent
    name = config.inputs[0].name
    inputs: dict[str, Json] = {}
    files: list[list[Any]] = []
    for config_input in config.inputs:  # the scene is the first
        for path in find_inputs(config_input, mirror, folders=config.scene.model_path):
            if mirror.has(path):
                url = mirror.url_of(path)
                state = mirror.describe(path)
                inputs[_name(plan, url or path)] = state
                files.append([store.shown(url) if url else _relative(path, home), *state.values()])
    settings = config.model_dump(
        mode="json", exclude={"output": True, "scene": {"path", "model_path"}}
    )
    common = {"settings": settings, "scene": name, "version": __version__, "files": sorted(files)}
    unnamed = {
        **common,
        "settings": {**settings, "scene": {**settings["scene"], "id": ""}},
        # parts of a mesh scene may be named after its file
        "scene": name if scene_suffix(name) in MESH_SUFFIXES else scene_suffix(name),
        "files": sorted(["" if file[0] == name else file[0], *file[1:]] for file in files),
    }
    with_products = {**common, "products": list(plan.products)}
    texts = (
        json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
        for value in (with_products, unnamed, settings)
    )
    return BatchScene(
        config, inputs, *(hashlib.sha256(text.encode()).hexdigest() for text in texts)
    )


def check_record(
    plan: Plan, job: Job, sizes: Mapping[str, int] | None = None
) -> tuple[Json | None, str]:
    """Return the row of a scene that is done, or the reason why it has to be baked.

    A scene is done if its recorded key is the same and its files exist. Of the two values, the row
    is None if it isn't done. The reason is ``new``; ``made files`` if files are missing or have
    another size; or the part of the key that changed: ``version``, ``products``, ``settings``, or
    ``files`` and their names. `sizes` has the sizes of all files in an output folder on a store.
    """
    if sizes is not None and f"{job.id}/{RECORD_NAME}" not in sizes:
        return None, NOT_RECORDED
    try:
        place = plan.place(job)
        row = read_record(place)
        if row["id"] != job.id:
            return None, NOT_RECORDED
        for name, state in row["files"].items():
            path = Path(store.join(place, name))
            size_here = os.path.getsize(path) if sizes is None and path.exists() else None
            if (size_here if sizes is None else sizes.get(f"{job.id}/{name}")) != state["size"]:
                return None, "made files"
        with open_scene(plan, job, copy_all=False) as scene:
            if row["key"] != scene.key:
                now = {"version": __version__, "products": [*plan.products]}
                now["settings"] = scene.settings
                changed = [name for name, value in now.items() if row.get(name, value) != value]
                names = sorted({*row["inputs"], *scene.inputs})
                differ = [n for n in names if row["inputs"].get(n) != scene.inputs.get(n)]
                if differ:
                    changed.append(f"files: {' '.join(Path(name).name for name in differ)}")
                return None, ", ".join(changed) or "files"
        row = {key: value for key, value in row.items() if key not in RECORD_ONLY_KEYS}
    except (NavbakeError, OSError, KeyError, TypeError, AttributeError, ValueError):
        return None, NOT_RECORDED
    return {**row, "source": _name(plan, job.source)}, ""  # it may have moved


def read_record(place: store.Folder) -> Json:
    """Return the record of the files that a batch made in a scene's folder; {} if none."""
    with suppress(NavbakeError, ValueError):
        record = json.loads(store.read_file(store.join(place, RECORD_NAME)))
        if isinstance(record, dict) and isinstance(record.get("files"), dict):
            return record
    return {}


def write_record(place: store.Folder, record: Json) -> None:
    """Write the record of the files in a scene's folder, see `remove_made`."""
    store.write_file(place, RECORD_NAME, json.dumps(record, allow_nan=False).encode())


def remove_made(place: store.Folder) -> None:
    """Remove a scene's recorded outputs and leftovers of killed writers, and nothing else.

    A scene's folder may hold the user's own files. To tell them apart, the names of all products
    are recorded before they are made.
    """
    record = read_record(place)
    made = filter(
        PRODUCT_FILE_PATTERN.fullmatch,
        {*record.get("files", ()), *record.get("more", ())} - {GRID_NAME},
    )
    # the grid first, as it marks completeness; the record last, as it names the others
    store.remove_files(place, [GRID_NAME, *sorted(made), RECORD_NAME])
    if isinstance(place, Path):
        remove_leftovers(place, age=0)


# ---------------------------------------------------------------- the bake


def bake_scene(plan: Plan, job: Job) -> Json:
    """Bake a scene and write all products; return the scene's row of the index.

    Each file appears whole, and the grid appears last. A scene that fails leaves no files, and its
    row has the reason. Of all errors, only a MemoryError is raised, also in place of errors that
    `lacked_memory` recognizes, as the state of the process is unknown then. If the output has no
    room, the row's status is ``left``.
    """
    begin = time.perf_counter()
    try:
        return _make(plan, job, begin)
    except Exception as error:
        if lacked_memory(error):
            raise MemoryError(str(error)) from error
        why = str(error)
        if not isinstance(error, NavbakeError | OSError):
            why = f"{traceback.format_exception_only(error)[-1].strip()} (an unexpected error)"
        row = fail(plan, job, RAISED, printable(why), time.perf_counter() - begin)
        if full := store.why_full(error):
            refused = store.refused(f"into {store.shown(os.fspath(plan.place(job)))}", full)
            return {**begin_row(plan, job, LEFT_OUT), "error": str(refused)}
        return row


def begin_row(plan: Plan, job: Job, status: str) -> Json:
    """Return the first fields of a scene's row in the index."""
    return {"id": job.id, "status": status, "source": _name(plan, job.source)}


def fail(plan: Plan, job: Job, how: str, why: str, seconds: float) -> Json:
    """Remove the files of a failed scene, and return its row of the index."""
    with suppress(NavbakeError):
        remove_made(plan.place(job))
    return {**begin_row(plan, job, FAILED), "how": how, "error": why, **_times(seconds)}


def stamp() -> str:
    """Return the current time in UTC as ISO 8601, to a millisecond."""
    now = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
    return now.replace("+00:00", "Z")


def prepare(products: Iterable[str], thumbnail: bool) -> None:
    """Set up a worker, and make all products of a sample once.

    Thus modules are loaded before the first scene, and don't count in its time.
    """
    limit_mesh_cache(MESH_CACHE_SIZE)
    config = load_config(samples.path("apartment"), ["grid.cell_size=0.5"])
    grid = run_bake(config, threads=1).grid
    with scratch_folder() as folder:
        for product in products:
            with suppress(NavbakeError):  # raised again by the scenes
                make_product(product, grid, config, folder)
        if thumbnail:
            write_bytes(notebook.draw_thumbnail(grid), folder / THUMBNAIL_NAME)
        write_navgrid(grid, folder / GRID_NAME)
    audit(grid)


def _make(plan: Plan, job: Job, begin: float) -> Json:
    place = plan.place(job)
    with open_scene(plan, job, copy_all=True) as scene:
        grid = _copy_twin(plan, job, scene)
        timings = dict[str, float]()
        if grid is None:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the row has the relevant ones
                result = run_bake(scene.config, threads=1)
            grid = result.grid
            timings = result.timings
        grid.timings = {}  # the same scene, the same bytes
        free = sum(int(np.count_nonzero(level.free)) for level in grid.levels)
        row = {
            **begin_row(plan, job, OK),
            "version": __version__,
            "key": scene.key,
            "scene_digest": grid.navbake.get("sceneDigest"),
            "settings_digest": grid.navbake.get("settingsDigest"),
            "levels": len(grid.levels),
            "cells": sum(level.width * level.height for level in grid.levels),
            "free_area": round(free * (grid.cell_size * grid.unit) ** 2, 6),  # m²
            "rooms": len(grid.rooms),
            "doors": len(grid.doors),
            "warnings": list(grid.warnings),
            "audit": [str(remark) for remark in audit(grid).remarks],
            "inputs": scene.inputs,
            "stages": {name: round(seconds, SECONDS_DECIMALS) for name, seconds in timings.items()},
        }
        remove_made(place)
        row["files"] = _write_products(plan, place, grid, scene.config, row)
        row |= _times(time.perf_counter() - begin)
        parts = [[THUMBNAIL_NAME] * plan.thumbnail, scene.content, scene.settings, [*plan.products]]
        write_record(place, {**row, **dict(zip(RECORD_ONLY_KEYS, parts, strict=True))})
    return row


def _copy_twin(plan: Plan, job: Job, scene: BatchScene) -> NavGrid | None:
    """The grid of an equal scene under this one's name, as its own bake would make it.

    None without such a scene, if it isn't done, or if a warning names one of its files.
    """
    if not job.twin:
        return None
    try:
        place = plan.place(job._replace(id=job.twin))
        if read_record(place).get("content") != scene.content:
            return None
        grid = read_navgrid(store.read_file(store.join(place, GRID_NAME)))
    except NavbakeError:
        return None
    stated_path = grid.navbake.get("settings", {}).get("scene", {}).get("path", "")
    if any("/" in line or os.sep in line or stated_path in line for line in grid.warnings):
        return None
    navbake_metadata = {**grid.navbake, "settings": settings_to_state(scene.config)}
    navbake_metadata["settingsDigest"] = settings_digest(scene.config)
    metadata = {**grid.metadata, "sceneId": scene.config.scene.id, "navbake": navbake_metadata}
    return grid.with_levels(grid.levels, metadata)


def _write_products(
    plan: Plan, place: store.Folder, grid: NavGrid, config: BakeConfig, row: Json
) -> Json:
    """Write all products, the grid last; returns size and digest of each file by its name.

    The products' values are added to the scene's `row`.
    """
    with scratch_folder() as folder:
        for product in plan.products:
            noted = make_product(product, grid, config, folder)
            row["warnings"] += noted.pop("warnings", [])
            for measure, counts in noted.pop("episodes", {}).items():
                before = row.setdefault("episodes", {}).get(measure, [0] * len(counts))
                row["episodes"][measure] = [a + b for a, b in zip(before, counts, strict=True)]
        write_navgrid(grid, folder / GRID_NAME)
        files = {name: store.describe_file(folder / name) for name in sorted(os.listdir(folder))}
        if plan.thumbnail:
            write_bytes(notebook.draw_thumbnail(grid), folder / THUMBNAIL_NAME)
        other_names = [name for name in os.listdir(folder) if name != GRID_NAME]
        # existing files are the user's until replaced
        is_local = isinstance(place, Path)
        new_names = [
            name
            for name in other_names
            if not (is_local and os.path.lexists(store.join(place, name)))
        ]
        if new_names:
            write_record(place, {"files": {}, "more": new_names})
        for name in (*other_names, GRID_NAME):
            store.write_file(place, name, (folder / name).read_bytes())
    return files


def _times(seconds: float) -> Json:
    return {"seconds": round(seconds, SECONDS_DECIMALS), "ended": stamp()}


def _name(plan: Plan, path: str | Path) -> str:
    """The index's name of a file: its URL, or its path from the output folder."""
    if store.is_url(path):
        return store.shown(str(path))
    if isinstance(plan.folder, Path):
        return _relative(path, os.path.realpath(plan.folder))
    return Path(os.path.abspath(path)).as_posix()


def _relative(path: str | Path, folder: str | Path) -> str:
    if os.pardir in Path(path).parts:  # after a link, `..` leads elsewhere than its text
        path = os.path.realpath(path)
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # another drive on Windows
        return Path(os.path.abspath(path)).as_posix()
