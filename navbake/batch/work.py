"""Makes what is asked for of one scene: what a worker does."""

from __future__ import annotations

import os
import time
import traceback
import warnings
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from navbake import samples
from navbake._version import __version__
from navbake.auditor.audit import audit
from navbake.baker.pipeline import run_bake
from navbake.batch.file_states import Places, describe_files
from navbake.batch.full import FullError, telling_full
from navbake.batch.job import Job
from navbake.batch.products import (
    GRID,
    THUMBNAIL,
    Product,
    noting,
    remove_products,
    write_note,
    write_thumbnail,
)
from navbake.batch.remote import is_remote, make_remote, name_source, remove_remote_products
from navbake.batch.settings import digest_settings, settings_of
from navbake.batch.stores.urls import Folder
from navbake.config.settings import BakeConfig, load_config
from navbake.errors import NavbakeError, printable
from navbake.files import scratch_folder, without_waiting
from navbake.formats.navgrid import write_navgrid
from navbake.formats.scene_files import look_for_inputs
from navbake.navgrid.grid import NavGrid
from navbake.processes import lacked_memory
from navbake.types import Json

OK, FAILED, LEFT = "ok", "failed", "left"
ERROR = "error"  # how a scene fails where its process goes on
DIGITS = 4  # of seconds


class Order(NamedTuple):
    """What a worker is asked to do.

    Attributes:
        job: the scene.
        settings: those that all scenes share, by section.
        overrides: ``a.b=value``, which replace those of the batch and of the scene.
        products: what to make besides the grid.
        folder: where the folders of the scenes are; a URL if that is on a store.
        thumbnail: whether to make a small picture for the batch's page.
    """

    job: Job
    settings: Json
    overrides: tuple[str, ...]
    products: tuple[Product, ...]
    folder: Folder
    thumbnail: bool = False

    @property
    def place(self) -> Path:
        """The scene's folder, which is on this machine."""
        assert isinstance(self.folder, Path), "remote.py knows places on stores"
        return self.folder / self.job.id


def key_of(order: Order, config: BakeConfig) -> str:
    """What the result depends on besides the scene's files, hashed."""
    return digest_settings(config, [str(product) for product in order.products])


def prepare(products: Sequence[Product], thumbnail: bool) -> None:
    """Make all of a sample, so that no scene pays for loading what that needs."""
    config = load_config(samples.path("apartment"), ["grid.cell_size=0.5"])
    grid = run_bake(config, threads=1).grid
    with scratch_folder() as folder:
        for product in products:
            with suppress(NavbakeError):  # the scenes will say what is wrong
                product.make(grid, config, folder)
        if thumbnail:
            write_thumbnail(grid, folder)
        write_navgrid(grid, folder / GRID)
    audit(grid)


def row_of(order: Order, status: str) -> Json:
    """How a scene's row in the index begins."""
    return {"id": order.job.id, "status": status, "source": name_source(order)}


def do_order(order: Order) -> Json:
    """Bake a scene and write all that is asked for; returns its row of the index.

    Files appear whole, the grid last: where there is a grid, all is there. Of a scene that fails,
    nothing is there. What is wrong with it is in its row; a MemoryError alone is raised, also for
    what `lacked_memory` knows, because nobody knows what state it leaves the process in. A scene
    for which the output has no room is ``left``, with the reason as ``error``.
    """
    begin = time.perf_counter()
    try:
        row = make_remote(order, _make) if is_remote(order) else _make(order)
    except MemoryError:
        raise
    except FullError as error:
        _remove_made(order)
        row = {**row_of(order, LEFT), "error": str(error)}
    except Exception as error:
        if lacked_memory(error):
            raise MemoryError(str(error)) from error
        row = fail(order, ERROR, _told(error))
    return row | {"seconds": round(time.perf_counter() - begin, DIGITS)}


def _told(error: Exception) -> str:
    if isinstance(error, NavbakeError):
        return str(error)
    if isinstance(error, OSError):
        return printable(str(error))
    line = traceback.format_exception_only(error)[-1].strip()
    return printable(f"{line} (navbake should have said what is wrong)")


def fail(order: Order, how: str, why: str) -> Json:
    """The row of a scene that failed, of which nothing stays."""
    _remove_made(order)
    return {**row_of(order, FAILED), "how": how, "error": why}


def _remove_made(order: Order) -> None:
    if isinstance(order.folder, Path):
        remove_products(order.place)
    else:
        remove_remote_products(order)


def _make(order: Order) -> Json:
    config = settings_of(order.job, order.settings, order.overrides)
    # before the bake: what changes meanwhile is noticed by the next run
    named = [Path(path) for path in config.inputs]
    looked = [look_for_inputs(name) for name in named]  # the scene is the first
    search = looked[0][1]
    inputs = [path for found, _ in looked for path in found if os.path.isfile(path)]
    assert isinstance(order.folder, Path)
    places = Places(order.folder)
    stated = describe_files(inputs, places)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the row has those that matter
        result = run_bake(config, threads=1)
    grid = result.grid
    grid.timings = {}  # the same scene, the same bytes
    # without waiting: the batch does, once, when all is done
    with telling_full(order.place), without_waiting():
        order.place.mkdir(parents=True, exist_ok=True)
        made = _write_products(order, grid, config)
    return {
        **row_of(order, OK),
        "version": __version__,
        "key": key_of(order, config),
        "scene_digest": grid.navbake.get("sceneDigest"),
        "settings_digest": grid.navbake.get("settingsDigest"),
        **_measure(grid),
        "warnings": list(grid.warnings),
        "audit": [str(remark) for remark in audit(grid).remarks],
        "inputs": stated,
        "named": [places.of_file(path) for path in named],
        "sought": {
            "folders": [places.of_folder(path) for path in search.folders],
            "names": list(search.names),
        },
        "files": describe_files(
            [order.place / name for name in (GRID, *made)], Places(order.place), may_change=False
        ),
        "stages": {name: round(seconds, DIGITS) for name, seconds in result.timings.items()},
    }


def _write_products(order: Order, grid: NavGrid, config: BakeConfig) -> list[str]:
    """Write all that is asked for in place of what was made before; the names of the products."""
    place = order.place
    remove_products(place)
    names = [name for product in order.products for name in product.names(grid)]
    if order.thumbnail:
        names.append(THUMBNAIL)
    there = [name for name in names if os.path.lexists(place / name)]
    with noting(names, there, partial(write_note, place)):
        made = [name for product in order.products for name in product.make(grid, config, place)]
        if order.thumbnail:
            write_thumbnail(grid, place)
    write_navgrid(grid, place / GRID)
    return made


def _measure(grid: NavGrid) -> Json:
    """What the index says of a grid; areas in m²."""
    cell = (grid.cell_size * grid.unit) ** 2
    free = sum(int(np.count_nonzero(level.free)) for level in grid.levels)
    return {
        "levels": len(grid.levels),
        "cells": sum(level.width * level.height for level in grid.levels),
        "free_area": round(free * cell, 6),
        "rooms": len(grid.rooms),
        "doors": len(grid.doors),
    }
