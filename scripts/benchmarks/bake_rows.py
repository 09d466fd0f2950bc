"""Rows of bakes: houses of rooms, of many triangles, as soups, next to Recast and a plain loop."""

from __future__ import annotations

import json
import os
import statistics
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.measure import Job, Row, Sample, run_process
from benchmarks.plain_loop import plain_loop_job
from benchmarks.recast import recast_job, why_missing
from benchmarks.scenes import (
    CELL,
    DUNGEON,
    ROOT,
    SAMPLES,
    TRIANGLES,
    Scenes,
    num_cells,
)

WORKER = Path(__file__).with_name("worker.py")
SMALL = 9  # rooms of the smaller soup
SIZES = (4, 25, 100, 400)  # rooms of the houses whose cost per cell is compared
LARGE = 1600  # rooms of the largest: 16 million cells
BARE = {"rooms": "none", "doors": {"find": False}, "names": False}


def make_rows(scenes: Scenes) -> dict[str, Callable[[], Row]]:
    """The rows by name, each made when it is asked for."""
    main = scenes.rooms

    def house_row() -> Row:
        row = _against_recast(scenes, scenes.main, ratio=1.0)
        row.peers.append(plain_loop_job(scenes.main, main))
        return row

    def many_row() -> Row:
        return _against_recast(scenes, scenes.house(main, triangles=TRIANGLES), ratio=1.0)

    def small_soup_row() -> Row:
        path = scenes.soup(SMALL, triangles=TRIANGLES).path
        return _against_recast(scenes, path, ratio=1.5)

    def large_soup_row() -> Row:
        path = scenes.soup(main, triangles=TRIANGLES).path
        return _against_recast(scenes, path, ratio=1.5, peak=1200)

    def first_ray_row() -> Row:
        path = scenes.soup(main, triangles=TRIANGLES).path
        command = [sys.executable, str(WORKER), "first-ray", json.dumps(_settings(path))]
        job = Job("navbake bake, up to the first ray", lambda: run_process(command))
        return Row(job, [_read_job(path)], limit=2.0)

    def dungeon_row() -> Row:
        if not DUNGEON.exists():
            job = Job("dungeon.obj", lambda: Sample(float("nan")))
            return Row(job, missing=f"no scene: {DUNGEON.name} isn't there")
        return _against_recast(scenes, DUNGEON)

    def share_row() -> Row:
        job = bake_job("with rooms, doors and names", scenes.main)
        return Row(job, [bake_job("without", scenes.main, BARE)], ratio=1.3)

    def doors_row() -> Row:
        path = scenes.house(main, with_doors=True)
        bake = bake_job("", path)

        def measure() -> Sample:
            sample = bake.measure()
            return Sample((sample.facts or {})["stages"]["doors"], sample.peak, sample.facts)

        return Row(Job("180 doors, each in all its states", measure), limit=1.0)

    def scaling_row() -> Row:
        jobs = [_per_million(scenes, rooms) for rooms in (LARGE, *SIZES)]
        return Row(jobs[0], jobs[1:], ratio=1.3)

    def tiles_row() -> Row:
        name = f"house-{LARGE}, {num_cells(LARGE):,} cells"
        job = bake_job(name, scenes.house(LARGE), warm_up=scenes.house(SIZES[0]))
        return Row(job, limit=16.0, peak=2500)

    def cell_memory_row() -> Row:
        return Row(_per_item("a million cells", *(scenes.house(n) for n in SIZES[-2:]), "cells"))

    def triangle_memory_row() -> Row:
        soups = (scenes.soup(n, triangles=TRIANGLES).path for n in (SMALL, main))
        return Row(_per_item("a million triangles, and their cells", *soups, "triangles"))

    rows: dict[str, Callable[[], Row]] = {
        "house": house_row,
        "many": many_row,
        "soup": small_soup_row,
        "soup-large": large_soup_row,
        "first-ray": first_ray_row,
        "dungeon": dungeon_row,
        "share": share_row,
        "doors": doors_row,
        "scaling": scaling_row,
        "tiles": tiles_row,
        "cell-memory": cell_memory_row,
        "triangle-memory": triangle_memory_row,
    }
    for name in SAMPLES:
        path = ROOT / "configs" / "scenes" / f"{name}.xml"
        rows[f"sample-{name}"] = lambda path=path: _against_recast(scenes, path)  # type: ignore[misc]
    return rows


def bake_job(
    name: str,
    path: Path,
    more: dict[str, Any] | None = None,
    threads: int | None = None,
    warm_up: Path | None = None,
) -> Job:
    """A bake in a process of its own, warm, without starting up.

    It is warmed up with another scene where one is given, or where its own is large.
    """
    if warm_up is None:
        is_small = os.path.getsize(path) < 10**7
        warm_up = path if is_small else ROOT / "configs/scenes/apartment.xml"
    command = [sys.executable, str(WORKER), "bake", json.dumps(_settings(path) | (more or {}))]
    command += ["--warm-up", json.dumps(_settings(warm_up) | (more or {}))]
    command += ["--threads", str(threads)] if threads else []
    return Job(name, lambda: run_process(command))


def _settings(path: Path) -> dict[str, Any]:
    return {"scene": {"path": str(path)}, "grid": {"cell_size": CELL}}


def _against_recast(
    scenes: Scenes, path: Path, ratio: float | None = None, peak: float | None = None
) -> Row:
    """A bake without reading a mesh file, next to Recast over the same triangles."""
    job = bake_job(path.name, path)
    if path.suffix != ".xml":
        job = _without_reading(job, path)
    if why_missing():
        return Row(job, ratio=ratio, peak=peak, missing=why_missing())
    recast = recast_job(scenes.folder, scenes.soup_of(path))
    return Row(job, [recast], ratio=ratio, peak=peak)


def _without_reading(job: Job, path: Path) -> Job:
    """Take off the time that trimesh needs to read the file, the median of three."""
    read = _read_job(path)
    taken: list[float] = []

    def measure() -> Sample:
        if not taken:
            taken.append(statistics.median(read.measure().seconds for _ in range(3)))
        sample = job.measure()
        facts = {**(sample.facts or {}), "read": taken[0]}
        return Sample(sample.seconds - taken[0], sample.peak, facts)

    return Job(f"{job.name}, after reading", measure)


def _read_job(path: Path) -> Job:
    command = [sys.executable, str(WORKER), "read", json.dumps(_settings(path))]
    return Job("trimesh reads the file", lambda: run_process(command))


def _per_million(scenes: Scenes, rooms: int) -> Job:
    job = bake_job("", scenes.house(rooms), warm_up=scenes.house(SIZES[0]))

    def measure() -> Sample:
        sample = job.measure()
        return Sample(sample.seconds / num_cells(rooms) * 1e6, sample.peak, sample.facts)

    return Job(f"house-{rooms}, a million cells", measure)


def _per_item(name: str, small: Path, large: Path, counted: str) -> Job:
    """What a million of something adds to a bake's time and to its peak, from a small one on."""
    bakes = bake_job("", small), bake_job("", large)

    def measure() -> Sample:
        one, other = (bake.measure() for bake in bakes)
        millions = (other.facts[counted] - one.facts[counted]) / 1e6  # type: ignore[index]
        more = None if one.peak is None or other.peak is None else other.peak - one.peak
        return Sample((other.seconds - one.seconds) / millions, more and more / millions)

    return Job(name, measure)
