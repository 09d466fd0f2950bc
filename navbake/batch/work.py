"""Makes what is asked for of one scene: what a worker does, on this machine or on a cluster."""

from __future__ import annotations

import time
import traceback
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from navbake._version import __version__
from navbake.batch.inputs import describe_inputs, find_inputs
from navbake.batch.job import Job
from navbake.batch.products import GRID, Product
from navbake.config.settings import BakeConfig, parse_config, settings_digest
from navbake.config.yaml_text import read_yaml
from navbake.errors import NavbakeError, printable
from navbake.files import write_whole
from navbake.navgrid.grid import NavGrid
from navbake.types import Json

SETTINGS = (".yaml", ".yml")
OK, FAILED = "ok", "failed"


class Order(NamedTuple):
    """What a worker is asked to do.

    Attributes:
        job: the scene.
        settings: those of the whole batch, as a YAML file has them.
        overrides: ``a.b=value``, which replace those of the batch and of the scene.
        products: what to make, see `products.Product.parse`.
        folder: of the batch's output.
    """

    job: Job
    settings: Json
    overrides: tuple[str, ...]
    products: tuple[str, ...]
    folder: str


def settings_of(order: Order) -> BakeConfig:
    """The settings of a scene: the batch's, replaced by its own, replaced by the overrides.

    Raises:
        ConfigError: they are wrong.
    """
    source = Path(order.job.source)
    own: Mapping[str, Any] = {}
    folder = Path()
    if source.suffix.lower() in SETTINGS:
        own, folder = read_yaml(source), source.parent
    else:
        own = {"scene": {"path": str(source)}}
    settings = merge(merge(order.settings, own), nest(order.job.settings))
    scene = settings.get("scene")
    if isinstance(scene, dict) and "id" not in scene:
        settings = merge(settings, {"scene": {"id": order.job.id}})
    return parse_config(settings, order.job.place, order.overrides, folder=folder)


def merge(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Settings laid over others, section by section."""
    merged = dict(below)
    for key, value in above.items():
        under = merged.get(key)
        is_section = isinstance(value, Mapping) and isinstance(under, Mapping)
        merged[key] = merge(under, value) if is_section else value
    return merged


def nest(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings by section, from keys such as ``agent.radius``."""
    nested: dict[str, Any] = {}
    for key, value in settings.items():
        *sections, last = str(key).split(".")
        part: dict[str, Any] = {last: nest(value) if isinstance(value, Mapping) else value}
        for section in reversed(sections):
            part = {section: part}
        nested = merge(nested, part)
    return nested


def do_order(order: Order) -> Json:
    """Bake a scene and write all that is asked for; returns its row of the index, never raises.

    Files appear whole, the grid last, so that where there is a grid, all is there.
    """
    begin = time.perf_counter()
    row: Json = {"id": order.job.id, "source": order.job.source, "status": FAILED}
    try:
        row |= _make(order)
    except NavbakeError as error:
        row["error"] = str(error)
    except MemoryError as error:
        row["error"] = f"it took more memory than it may: {printable(str(error))}"
    except Exception as error:
        line = traceback.format_exception_only(error)[-1].strip()
        row["error"] = printable(f"{line} (this is a fault of navbake)")
    row["seconds"] = round(time.perf_counter() - begin, 4)
    return row


def _make(order: Order) -> Json:
    from navbake.baker.pipeline import run_bake
    from navbake.formats.navgrid import write_navgrid

    config = settings_of(order)
    scene = Path(config.scene.path)
    folder = Path(order.folder, order.job.id)
    inputs = [path for named in config.inputs for path in find_inputs(named)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the grid keeps them
        result = run_bake(config, threads=1)
    grid = result.grid
    grid.timings = {}  # so that the same scene gives the same bytes
    products = [Product.parse(text) for text in order.products]
    folder.mkdir(parents=True, exist_ok=True)
    for product in products:
        for name, content in product.make(grid, config).items():
            write_whole(content, folder / name)
    write_navgrid(grid, folder / GRID)
    return {
        "status": OK,
        "version": __version__,
        "key": settings_digest(config),
        "products": list(order.products),
        "inputs": describe_inputs(list(dict.fromkeys(inputs)), Path(order.folder)),
        "scene_digest": grid.navbake.get("sceneDigest"),
        **_measure(grid),
        "warnings": len(grid.warnings),
        "stages": {name: round(seconds, 4) for name, seconds in result.timings.items()},
        "scene": str(scene),
    }


def _measure(grid: NavGrid) -> Json:
    """What the index says of a grid."""
    from navbake.auditor.audit import audit

    report = audit(grid)
    area = sum(
        float(np.count_nonzero(level.free)) * level.lattice.cell_size**2 for level in grid.levels
    )
    return {
        "levels": len(grid.levels),
        "cells": sum(level.width * level.height for level in grid.levels),
        "rooms": len(grid.rooms),
        "doors": len(grid.doors),
        "free_area": round(area, 6),
        "audit_errors": len(report.errors),
        "audit_remarks": len(report.remarks) - len(report.errors),
    }


def prepare() -> None:
    """What a worker does before its first scene: load what each bake needs."""
    import navbake.auditor.audit
    import navbake.baker.pipeline
    import navbake.formats.navgrid  # noqa: F401


do_order.prepare = prepare  # type: ignore[attr-defined]
