"""Bakes one scene of a batch in a worker process, and decides whether a scene is done already."""

from __future__ import annotations

import hashlib
import json
import os
import time
import traceback
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from navbake import samples
from navbake._version import __version__
from navbake.baker.bake.pipeline import run_bake
from navbake.baker.scene.model import limit_mesh_cache
from navbake.batch import store
from navbake.batch.products import (
    GRID_NAME,
    PRODUCT_FILE_PATTERN,
    RECORD_NAME,
    THUMBNAIL_NAME,
    make_product,
)
from navbake.batch.scene_row import FileState, SceneRecord, SceneRow
from navbake.batch.scenes import Job, find_room_outlines_path, merge_settings
from navbake.config.settings import (
    BakeConfig,
    load_config,
    select_settings_to_store,
    settings_digest,
)
from navbake.errors import NavbakeError, printable
from navbake.files import remove_leftovers, scratch_folder
from navbake.formats.navgrid import read_navgrid, write_navgrid
from navbake.formats.scene_files import MESH_SUFFIXES, find_inputs, scene_suffix
from navbake.formats.source import write_bytes
from navbake.lazy import lazy
from navbake.navgrid.grid import NavGrid
from navbake.processes import is_lack_of_memory
from navbake.types import Json
from navbake.yaml_text import apply_overrides

# loaded by workers that bake, not by the batch itself
audit = lazy("navbake.auditor.audit")  # loads scipy
notebook = lazy("navbake.views.notebook")  # loads Pillow

# statuses of a row
OK = "ok"
FAILED = "failed"
LEFT = "left"  # the batch ended before the scene
NOT_RECORDED = "new"  # the reason to bake a scene that has no record
ERROR = "error"  # a row's `how` if the bake raised an error and the worker process goes on
SECONDS_DECIMALS = 4  # decimals of durations in a row
# Size of the cache of meshes that MuJoCo keeps in a worker [bytes]; MuJoCo's default is 500 MB.
MESH_CACHE_SIZE = 64 << 20
RECORD_ONLY_KEYS = ("more", "content", "settings", "products")  # keys of a record, not of a row


class Plan(NamedTuple):
    """The options of a batch: its output folder, its settings, and what it makes of each scene."""

    folder: store.Folder  #: The output folder, a Path or a URL.
    settings: Json  #: The settings that all scenes share, by section.
    #: Settings as ``a.b=value``; they replace the shared settings and those of a scene.
    overrides: tuple[str, ...] = ()
    products: tuple[str, ...] = ()  #: What to make besides the grid, see `products.parse_products`.
    thumbnail: bool = False  #: Whether to make a small picture for the batch's page.
    writes_parquet: bool = False  #: Whether the index is written as Parquet as well.
    #: Further hosts that lists, settings and redirects on the web may lead to.
    hosts: tuple[str, ...] = ()

    def scene_folder(self, job: Job) -> store.Folder:
        """Return a scene's output folder.

        Raises a NavbakeError if the folder is a link that leads out of the batch's output folder.
        """
        folder = store.as_folder(store.join(self.folder, job.id))
        store.check_inside(self.folder, folder)
        return folder

    def trusted_urls(self, job: Job) -> list[str]:
        """Return the paths and URLs by which the user named a scene's files.

        These are the list (or the scene, if it isn't in a list), and the file of room outlines in
        the batch's settings. They don't include what a list names, as others may have written it.
        """
        settings = [self.settings, apply_overrides({}, self.overrides)]
        settings += [] if job.list_url else [job.settings]
        paths = [job.list_url or job.source, *map(find_room_outlines_path, settings)]
        return [path for path in paths if path]


class BatchScene(NamedTuple):
    """The settings, input files and digests of a scene that is to be baked."""

    config: BakeConfig  #: The scene's settings, with paths on this machine.
    #: For each input file, by its URL or its path from the output folder: its size and digest.
    inputs: dict[str, FileState]
    key: str  #: Digest that changes when the grid or a product may change; see `open_scene`.
    #: Digest like the key, but without the products and the scene's id; without the scene file's
    #: name, too, unless it is a mesh. Scenes with the same digest have the same cells.
    content_digest: str
    settings_digest: str  #: Digest of the settings.


# ---------------------------------------------------------------- the key


@contextmanager
def open_scene(plan: Plan, job: Job, *, copy_all: bool) -> Iterator[BatchScene]:
    """Find a scene's files and compute its key.

    The key is a digest of the settings, navbake's version, the products, and the name and content
    (on a store: the store's digest) of each input file. Textures and skins are left out, because
    they change no cell.

    Args:
        plan: the batch's options.
        job: the scene.
        copy_all: whether all files on stores are copied to this machine; otherwise only files that
            name further files are.

    Yields:
        The scene. Its copies of files are removed at the end of the with statement.

    Raises:
        NavbakeError: the settings are wrong, or a file can't be read or is on a host that isn't
            allowed. An OSError is raised as it is.
    """
    store.allow_hosts(plan.hosts)
    store.check_host(job.source, plan.trusted_urls(job))
    with store.Mirror(plan.trusted_urls(job)) as mirror:
        try:
            config = merge_settings(job, plan.settings, plan.overrides, mirror.fetch)
            scene = _describe_scene(plan, config, mirror)
            if copy_all and mirror.url_of(config.inputs[0]):
                for path in find_inputs(
                    config.inputs[0], mirror, with_textures=True, folders=config.scene.model_path
                ):
                    mirror.ensure_local(path)
            yield scene
        except (NavbakeError, OSError) as error:
            translated_message = mirror.translate_paths(str(error))
            if store.find_disk_full_error(error) or translated_message == str(error):
                raise
            raise NavbakeError(translated_message) from error


def _describe_scene(plan: Plan, config: BakeConfig, mirror: store.Mirror) -> BatchScene:
    """Find the input files of a scene and compute its digests.

    Args:
        plan: the batch's options.
        config: the scene's settings.
        mirror: holds the copies of files on stores.
    """
    scene_folder = config.inputs[0].parent
    scene_name = config.inputs[0].name  # part of the key, because the grid states it
    inputs: dict[str, FileState] = {}
    file_rows: list[list[Any]] = []  # for each file: its path or URL, then the values of its state
    for input_path in config.inputs:  # the scene is the first
        for path in find_inputs(input_path, mirror, folders=config.scene.model_path):
            if mirror.has(path):
                url = mirror.url_of(path)
                state = mirror.describe(path)
                inputs[_index_path(plan, url or path)] = state
                shown_path = (
                    store.without_secrets(url) if url else _relative_path(path, scene_folder)
                )
                file_rows.append([shown_path, *state.values()])
    settings = config.model_dump(
        mode="json", exclude={"output": True, "scene": {"path", "model_path"}}
    )
    scene_facts = {
        "settings": settings,
        "scene": scene_name,
        "version": __version__,
        "files": sorted(file_rows),
    }
    suffix = scene_suffix(scene_name)
    # equal scenes of other names and ids have the same content
    facts_without_names = {
        **scene_facts,
        "settings": {**settings, "scene": {**settings["scene"], "id": ""}},
        # parts of a mesh scene may be named after its file
        "scene": scene_name if suffix in MESH_SUFFIXES else suffix,
        "files": sorted(["" if path == scene_name else path, *state] for path, *state in file_rows),
    }
    return BatchScene(
        config=config,
        inputs=inputs,
        key=_digest_json({**scene_facts, "products": list(plan.products)}),
        content_digest=_digest_json(facts_without_names),
        settings_digest=_digest_json(settings),
    )


def _digest_json(json_object: Json) -> str:
    """Return the sha256 of a JSON object, whatever the order of its keys."""
    json_text = json.dumps(json_object, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(json_text.encode()).hexdigest()


class Inspection(NamedTuple):
    """The input files and digests of a scene; they are found without a bake."""

    inputs: dict[str, FileState]  #: Name of each input file -> its state, as in `BatchScene`.
    key: str  #: Digest that changes when the grid or a product may change.
    content_digest: str  #: Digest that scenes with the same cells have in common.
    settings_digest: str  #: Digest of the settings.
    error: str = ""  #: Why the scene can't be read; the other values are empty then.


def inspect_scenes(plan: Plan, jobs: Sequence[Job]) -> list[Inspection]:
    """Find the input files and digests of scenes.

    All scenes are read at the same time, because stores respond slowly. Call it in a worker
    process, since the files may be those of strangers.

    Args:
        plan: the batch's options.
        jobs: the scenes.

    Returns:
        An inspection for each scene, in order; that of a scene that can't be read has `error`.
    """

    def inspect(job: Job) -> Inspection:
        try:
            with open_scene(plan, job, copy_all=False) as scene:
                return Inspection(
                    scene.inputs, scene.key, scene.content_digest, scene.settings_digest
                )
        except (NavbakeError, OSError) as error:
            return make_broken_inspection(str(error))

    with ThreadPoolExecutor(max(1, len(jobs))) as pool:
        return [*pool.map(inspect, jobs)]


def make_broken_inspection(reason: str) -> Inspection:
    """Return the inspection of a scene that can't be read."""
    return Inspection({}, "", "", "", printable(reason))


def find_record(
    plan: Plan, job: Job, size_of_file: Mapping[str, int] | None = None
) -> tuple[Json | None, str]:
    """Read a scene's record, and check that the files that the batch made are still there.

    The scene itself isn't read.

    Args:
        plan: the batch's options.
        job: the scene.
        size_of_file: path -> size of each file in the output folder [bytes], if it is on a store;
            None if the folder is on this machine.

    Returns:
        The record, and ``""``; or None, and the reason to bake the scene: ``new`` without a valid
        record, ``made files`` if files are missing or have another size.
    """
    if size_of_file is not None and f"{job.id}/{RECORD_NAME}" not in size_of_file:
        return None, NOT_RECORDED
    try:
        folder = plan.scene_folder(job)
        record = read_record(folder)
        if record["id"] != job.id:
            return None, NOT_RECORDED
        for name, state in record["files"].items():
            path = Path(store.join(folder, name))
            if size_of_file is not None:
                size = size_of_file.get(f"{job.id}/{name}")
            else:
                size = os.path.getsize(path) if path.exists() else None
            if size != state["size"]:
                return None, "made files"
    except (NavbakeError, OSError, KeyError, TypeError, AttributeError, ValueError):
        return None, NOT_RECORDED
    return record, ""


def check_record(
    plan: Plan, job: Job, record: Json, inspection: Inspection
) -> tuple[SceneRow | None, str]:
    """Check whether a scene is done: whether its key is the one in its record.

    Args:
        plan: the batch's options.
        job: the scene.
        record: the scene's record, from `find_record`.
        inspection: the scene as it is now.

    Returns:
        The row of a scene that is done, and ``""``. For others, None and the reason to bake them:
        ``new`` if the scene can't be read, or the record is broken; or the parts of the key that
        changed: ``version``, ``products``, ``settings``, or ``files`` and their names.
    """
    if inspection.error:
        return None, NOT_RECORDED
    try:
        if record["key"] != inspection.key:
            return None, _describe_changes(plan, record, inspection)
    except (KeyError, TypeError, AttributeError, ValueError):
        return None, NOT_RECORDED
    row = {key: value for key, value in record.items() if key not in RECORD_ONLY_KEYS}
    # the source may have moved
    return cast(SceneRow, {**row, "source": _index_path(plan, job.source)}), ""


def _describe_changes(plan: Plan, record: Json, inspection: Inspection) -> str:
    """Return the parts of a scene's key that changed since its record, as text for a reason."""
    current_values = {
        "version": __version__,
        "products": [*plan.products],
        "settings": inspection.settings_digest,
    }
    change_texts = [
        name for name, value in current_values.items() if record.get(name, value) != value
    ]
    paths = sorted({*record["inputs"], *inspection.inputs})
    changed_paths = [
        path for path in paths if record["inputs"].get(path) != inspection.inputs.get(path)
    ]
    if changed_paths:
        change_texts.append(f"files: {' '.join(Path(path).name for path in changed_paths)}")
    removed_products = [
        product for product in record.get("products", ()) if product not in plan.products
    ]
    if removed_products:
        change_texts.remove("products")
        change_texts.append(f"products: removes {' '.join(removed_products)}")
    return ", ".join(change_texts) or "files"


def read_record(folder: store.Folder) -> Json:
    """Return the record of the files that a batch made in a folder; {} if there is no valid record.

    In a finished scene's folder, the record is a `SceneRecord`. While a scene's files are being
    written, and in the folder of a batch's shards, it has only `files`, and maybe `more`: the names
    of files that `files` lacks. Nothing is checked but that `files` is a dict.
    """
    with suppress(NavbakeError, ValueError):
        record = json.loads(store.read_file(store.join(folder, RECORD_NAME)))
        if isinstance(record, dict) and isinstance(record.get("files"), dict):
            return record
    return {}


def write_record(folder: store.Folder, record: Mapping[str, Any]) -> None:
    """Write the record of the files that a batch made in a folder, see `read_record`."""
    store.write_file(folder, RECORD_NAME, json.dumps(record, allow_nan=False).encode())


def remove_made_files(folder: store.Folder) -> set[str]:
    """Remove from a scene's folder the files that batches made, and return their names.

    These are the grid, the recorded files, the record, and temporary files of killed processes. The
    folder may hold the user's own files, too. To tell them apart, the names of all products are
    recorded before the products are written.
    """
    record = read_record(folder)
    recorded_names = {*record.get("files", ()), *record.get("more", ())} - {GRID_NAME}
    made_file_names = set(filter(PRODUCT_FILE_PATTERN.fullmatch, recorded_names))
    # the grid first, since a scene with a grid counts as done; the record last, since it names them
    store.remove_files(folder, [GRID_NAME, *sorted(made_file_names), RECORD_NAME])
    if isinstance(folder, Path):
        remove_leftovers(folder, min_age=0)
    return made_file_names


# ---------------------------------------------------------------- the bake


def bake_scene(plan: Plan, job: Job) -> SceneRow:
    """Bake a scene and write all products; return the scene's row of the index.

    Each file appears whole, and the grid appears last. A scene that fails leaves no files, and its
    row has the reason. If the output has no room, the row's status is ``left``.

    Raises:
        MemoryError: the process lacked memory; it can't be trusted any more. It also replaces other
            errors that `is_lack_of_memory` recognizes. No other error is raised.
    """
    begin_time = time.perf_counter()
    try:
        return _bake_and_write(plan, job, begin_time)
    except Exception as error:
        if is_lack_of_memory(error):
            raise MemoryError(str(error)) from error
        reason = str(error)
        if not isinstance(error, NavbakeError | OSError):
            reason = f"{traceback.format_exception_only(error)[-1].strip()} (an unexpected error)"
        seconds = time.perf_counter() - begin_time
        row = record_failure(plan, job, ERROR, printable(reason), seconds)
        disk_full_error = store.find_disk_full_error(error)
        if disk_full_error is not None:
            folder_name = store.without_secrets(os.fspath(plan.scene_folder(job)))
            row = begin_row(plan, job, LEFT)
            row["error"] = str(store.make_write_error(f"into {folder_name}", disk_full_error))
        return row


def begin_row(plan: Plan, job: Job, status: str) -> SceneRow:
    """Return a scene's row of the index with the fields that every row has.

    Args:
        plan: the batch's options.
        job: the scene.
        status: ``ok``, ``failed`` or ``left``.
    """
    return {"id": job.id, "status": status, "source": _index_path(plan, job.source)}


def record_failure(plan: Plan, job: Job, how: str, reason: str, seconds: float) -> SceneRow:
    """Remove the files of a failed scene, and return its row of the index.

    Args:
        plan: the batch's options.
        job: the scene.
        how: the kind of failure, see `SceneRow`.
        reason: the reason, for the row's `error`.
        seconds: how long the last attempt took [s].
    """
    with suppress(NavbakeError):
        remove_made_files(plan.scene_folder(job))
    row = begin_row(plan, job, FAILED)
    row["how"] = how
    row["error"] = reason
    return {**row, **_end_times(seconds)}


def current_time() -> str:
    """Return the current time in UTC as ISO 8601, in milliseconds."""
    iso_time = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
    return iso_time.replace("+00:00", "Z")


def prepare_worker(products: Iterable[str], thumbnail: bool) -> None:
    """Set up a worker process: bake a sample, and make all products of it once.

    All modules are loaded by this, so that their loading doesn't count in the first scene's time.

    Args:
        products: the batch's products, as `products.parse_products` returns them.
        thumbnail: whether to make a thumbnail, too.
    """
    limit_mesh_cache(MESH_CACHE_SIZE)
    config = load_config(samples.path("apartment"), ["grid.cell_size=0.5"])
    grid = run_bake(config, threads=1).grid
    with scratch_folder() as folder:
        for product in products:
            with suppress(NavbakeError):  # the scenes will raise it again
                make_product(product, grid, config, folder)
        if thumbnail:
            write_bytes(notebook.draw_thumbnail(grid), folder / THUMBNAIL_NAME)
        write_navgrid(grid, folder / GRID_NAME)
    audit.audit(grid)


def _bake_and_write(plan: Plan, job: Job, begin_time: float) -> SceneRow:
    """Bake a scene, write all its files, and return its row of the index.

    Args:
        plan: the batch's options.
        job: the scene.
        begin_time: when the scene was begun, by `time.perf_counter` [s]; the row's `seconds` count
            from then.
    """
    folder = plan.scene_folder(job)
    with open_scene(plan, job, copy_all=True) as scene:
        grid = _copy_twin(plan, job, scene)
        timings = dict[str, float]()
        if grid is None:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the grid's warnings are in the row
                bake_result = run_bake(scene.config, threads=1)
            grid = bake_result.grid
            timings = bake_result.timings
        grid.timings = {}  # they differ each time, but equal scenes give equal bytes
        num_free_cells = sum(int(np.count_nonzero(level.free)) for level in grid.levels)
        row: SceneRow = {
            **begin_row(plan, job, OK),
            "version": __version__,
            "key": scene.key,
            "scene_digest": grid.navbake.get("sceneDigest"),
            "settings_digest": grid.navbake.get("settingsDigest"),
            "levels": len(grid.levels),
            "cells": sum(level.width * level.height for level in grid.levels),
            "free_area": round(num_free_cells * (grid.cell_size * grid.unit) ** 2, 6),
            "rooms": len(grid.rooms),
            "doors": len(grid.doors),
            "warnings": list(grid.warnings),
            "audit": [str(remark) for remark in audit.audit(grid).remarks],
            "inputs": scene.inputs,
            "stages": {name: round(seconds, SECONDS_DECIMALS) for name, seconds in timings.items()},
        }
        earlier_names = remove_made_files(folder)
        product_fields = _write_products(plan, folder, grid, scene.config)
        row = {
            **row,
            **product_fields,
            "warnings": [*row["warnings"], *product_fields["warnings"]],
            **_end_times(time.perf_counter() - begin_time),
        }
        removed_names = earlier_names - row["files"].keys() - {THUMBNAIL_NAME}
        record: SceneRecord = {
            **row,
            "more": [THUMBNAIL_NAME] if plan.thumbnail else [],
            "content": scene.content_digest,
            "settings": scene.settings_digest,
            "products": [*plan.products],
        }
        write_record(folder, record)
        if removed_names:  # by this run: later ones don't say so again
            row["removed"] = sorted(removed_names)
    return row


def _copy_twin(plan: Plan, job: Job, scene: BatchScene) -> NavGrid | None:
    """Copy the grid of a scene's twin: an equal scene of the batch, which is baked already.

    The copy has this scene's id and settings in its metadata, and is what a bake of this scene
    would give. Returns None if the scene has no twin, the twin isn't done, or a warning of its
    grid may name one of the twin's files.
    """
    if not job.twin:
        return None
    try:
        twin_folder = plan.scene_folder(job._replace(id=job.twin))
        if read_record(twin_folder).get("content") != scene.content_digest:
            return None
        grid = read_navgrid(store.read_file(store.join(twin_folder, GRID_NAME)))
    except NavbakeError:
        return None
    stated_path = grid.navbake.get("settings", {}).get("scene", {}).get("path", "")
    if any(
        "/" in warning or os.sep in warning or stated_path in warning for warning in grid.warnings
    ):
        return None
    navbake_metadata = {**grid.navbake, "settings": select_settings_to_store(scene.config)}
    navbake_metadata["settingsDigest"] = settings_digest(scene.config)
    metadata = {**grid.metadata, "sceneId": scene.config.scene.id, "navbake": navbake_metadata}
    return grid.with_levels(grid.levels, metadata)


def _write_products(
    plan: Plan, scene_folder: store.Folder, grid: NavGrid, config: BakeConfig
) -> SceneRow:
    """Make all products of a grid, and write them and, last, the grid into the scene's folder.

    Args:
        plan: the batch's options.
        scene_folder: the folder to write into.
        grid: the scene's grid.
        config: the scene's settings.

    Returns:
        Three fields of the scene's row: `warnings`, those of the products only; `episodes`, if
            there are any; and `files`, without the thumbnail.
    """
    row_fields: SceneRow = {"warnings": []}
    with scratch_folder() as scratch_path:
        for product in plan.products:
            product_fields = make_product(product, grid, config, scratch_path)
            row_fields["warnings"] += product_fields.get("warnings", [])
            for measure, counts in product_fields.get("episodes", {}).items():
                count_sums = row_fields.setdefault("episodes", {}).get(measure, [0] * len(counts))
                row_fields["episodes"][measure] = [
                    count_sum + count for count_sum, count in zip(count_sums, counts, strict=True)
                ]
        write_navgrid(grid, scratch_path / GRID_NAME)
        made_file_names = sorted(os.listdir(scratch_path))
        row_fields["files"] = {
            file_name: store.describe_file(scratch_path / file_name)
            for file_name in made_file_names
        }
        if plan.thumbnail:
            write_bytes(notebook.draw_thumbnail(grid), scratch_path / THUMBNAIL_NAME)
        other_file_names = [
            file_name for file_name in os.listdir(scratch_path) if file_name != GRID_NAME
        ]
        # an existing file of such a name is the user's until it is replaced
        is_local = isinstance(scene_folder, Path)
        new_file_names = [
            file_name
            for file_name in other_file_names
            if not (is_local and os.path.lexists(store.join(scene_folder, file_name)))
        ]
        if new_file_names:
            write_record(scene_folder, {"files": {}, "more": new_file_names})
        for file_name in (*other_file_names, GRID_NAME):
            store.write_file(scene_folder, file_name, (scratch_path / file_name).read_bytes())
    return row_fields


def _end_times(seconds: float) -> SceneRow:
    """Return the fields of a row that say how long a scene took [s], and that it ends now."""
    return {"seconds": round(seconds, SECONDS_DECIMALS), "ended": current_time()}


def _index_path(plan: Plan, path: str | Path) -> str:
    """Return how the index names a file: its URL, or its path from the output folder.

    If the output folder is on a store, a local file has its absolute path.
    """
    if store.is_url(path):
        return store.without_secrets(str(path))
    if isinstance(plan.folder, Path):
        return _relative_path(path, os.path.realpath(plan.folder))
    return Path(os.path.abspath(path)).as_posix()


def _relative_path(path: str | Path, folder: str | Path) -> str:
    """Return a path from a folder, with slashes; the absolute path on another drive."""
    if os.pardir in Path(path).parts:  # `a/..` isn't the current folder if `a` is a link
        path = os.path.realpath(path)
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # another drive on Windows
        return Path(os.path.abspath(path)).as_posix()
