"""Rows of bakes, next to Recast and a plain loop; of updates, next to fresh bakes; of commands."""

from __future__ import annotations

import json
import os
import random
import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import navbake
from benchmarks.measure import Job, Row, Sample, SkipRow, run_process
from benchmarks.moving_scenes import make_hall, make_rooms, make_storeys
from benchmarks.peers import plain_loop_job, recast_job, why_no_recast
from benchmarks.scenes import (
    APARTMENT,
    CELL,
    DUNGEON,
    ROOMS,
    ROOT,
    SAMPLES,
    TRIANGLES,
    Scenes,
    num_cells,
)

WORKER = Path(__file__).with_name("worker.py")
NAVBAKE = [sys.executable, "-m", "navbake"]
SMALL = 9  # rooms of the smaller soup
MEDIUM = 400  # rooms of a house of 4 million cells
# Rooms of the houses whose cost per cell is compared; the limit is a ratio to the first of them
SIZES = (ROOMS, 4, 25, MEDIUM)
LARGE = 1600  # rooms of the largest: 16 million cells
BARE = {"rooms": "none", "doors": {"find": False}, "names": False}


def make_rows(scenes: Scenes) -> dict[str, Callable[[], Row]]:
    """The rows by name, each made when it is asked for."""
    rooms = scenes.rooms

    def soup(number: int) -> Path:
        return scenes.soup(number, triangles=TRIANGLES).path

    def house_row() -> Row:
        row = _against_recast(scenes, scenes.main, ratio=0.6)
        row.peers.append(plain_loop_job(scenes.main, rooms))
        return row

    def first_ray_row() -> Row:
        job = Job("navbake bake, up to the first ray", lambda: _work("first-ray", soup(rooms)))
        peer = Job("trimesh reads the file", lambda: _work("read-trimesh", soup(rooms)))
        return Row(job, [peer], ratio=2.0)

    def dungeon_row() -> Row:
        if not DUNGEON.exists():
            source = "Recast's repository has it, RecastDemo/Bin/Meshes"
            raise SkipRow(f"no {DUNGEON.name} in {DUNGEON.parent}: {source}")
        return _against_recast(scenes, DUNGEON)

    def share_row() -> Row:
        job = bake_job("with rooms, doors and names", scenes.main)
        return Row(job, [bake_job("without", scenes.main, BARE)], ratio=1.25)

    def doors_row() -> Row:
        bake = bake_job("", scenes.house(rooms, with_doors=True))

        def measure() -> Sample:
            sample = bake.measure()
            return sample._replace(seconds=(sample.facts or {})["stages"]["doors"])

        job = Job("180 doors, each in all its states", measure)
        peer = bake_job("the bake of the house without doors", scenes.house(rooms))
        return Row(job, [peer], ratio=0.25)

    def scaling_row() -> Row:
        job, *others = [_per_million(scenes, number) for number in (LARGE, *SIZES)]
        return Row(job, others, ratio=1.15, peak=1600)

    def triangle_memory_row() -> Row:
        name = "a million triangles, and their cells"
        return Row(_per_item(name, soup(SMALL), soup(rooms), "triangles"))

    return {
        "house": house_row,
        "many": lambda: _against_recast(
            scenes, scenes.house(rooms, triangles=TRIANGLES), ratio=0.75
        ),
        "soup": lambda: _against_recast(scenes, soup(SMALL), ratio=1.2),
        "soup-large": lambda: _against_recast(scenes, soup(rooms), ratio=1.0, peak=1000),
        "first-ray": first_ray_row,
        "dungeon": dungeon_row,
        "share": share_row,
        "doors": doors_row,
        "scaling": scaling_row,
        "cell-memory": lambda: Row(
            _per_item("a million cells", scenes.house(ROOMS), scenes.house(MEDIUM), "cells")
        ),
        "triangle-memory": triangle_memory_row,
        **{
            f"sample-{name}": partial(
                _against_recast, scenes, path, ratio=2.0 if name == "apartment" else None
            )
            for name, path in SAMPLES.items()
        },
        **_command_rows(scenes.folder),
        **{
            f"update {name}": partial(_update_row, name, 1, share) for name, share in MOVING.items()
        },
        "update 100 bodies": lambda: _update_row("house-100", 100, 0.10),
        "update whole": lambda: _update_row("whole", 1, 1.1),
    }


def bake_job(
    name: str, path: Path, more: dict[str, Any] | None = None, warm_up: Path | None = None
) -> Job:
    """A bake in a process of its own, warm, without starting up.

    It is warmed up with another scene where one is given, or where its own is large.
    """
    if warm_up is None:
        warm_up = path if path.stat().st_size < 10**7 else ROOT / "configs/scenes/apartment.xml"
    before = json.dumps(_settings(warm_up) | (more or {}))
    return Job(name, lambda: _work("bake", path, more, "--warm-up", before))


def _work(job: str, path: Path, more: dict[str, Any] | None = None, *options: str) -> Sample:
    settings = json.dumps(_settings(path) | (more or {}))
    return run_process([sys.executable, str(WORKER), job, settings, *options])


def _settings(path: Path) -> dict[str, Any]:
    return {"scene": {"path": str(path)}, "grid": {"cell_size": CELL}}


def _against_recast(
    scenes: Scenes, path: Path, ratio: float | None = None, peak: float | None = None
) -> Row:
    """A bake without reading a mesh file, next to Recast over the same triangles."""
    job = bake_job(path.name, path)
    if path.suffix != ".xml":
        job = _without_reading(job, path)
    missing = why_no_recast()
    peers = [] if missing else [recast_job(scenes.folder, scenes.soup_of(path))]
    return Row(job, peers, ratio=ratio, peak=peak, missing=missing)


def _without_reading(job: Job, path: Path) -> Job:
    """Take off the time that a bake needs to read the file, the median of three."""
    taken: list[float] = []

    def measure() -> Sample:
        if not taken:
            taken.append(statistics.median(_work("read", path).seconds for _ in range(3)))
        sample = job.measure()
        facts = {**(sample.facts or {}), "read": taken[0]}
        return Sample(sample.seconds - taken[0], sample.peak, facts)

    return Job(f"{job.name}, after reading", measure)


def _per_million(scenes: Scenes, rooms: int) -> Job:
    """A bake's time for a million cells, without MuJoCo's reading of the scene.

    MuJoCo's time grows faster than the number of geoms: at 1,600 rooms, it is most of a bake.
    """
    job = bake_job("", scenes.house(rooms), warm_up=scenes.house(4))

    def measure() -> Sample:
        sample = job.measure()
        seconds = sample.seconds - (sample.facts or {})["stages"]["scene"]
        return sample._replace(seconds=seconds / num_cells(rooms) * 1e6)

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


# --- commands ------------------------------------------------------------------------------


def _command_rows(folder: Path) -> dict[str, Callable[[], Row]]:
    grid = folder / "apartment.grid.json"
    bake = [*NAVBAKE, "bake", str(APARTMENT), "-o", str(grid), "--quiet"]

    def run_cold() -> Sample:
        with tempfile.TemporaryDirectory() as empty:
            return run_process(bake, {**os.environ, "NUMBA_CACHE_DIR": empty})

    def show_info() -> Sample:
        if not grid.exists():
            run_process(bake)
        return run_process([*NAVBAKE, "info", str(grid)])

    def python(code: str) -> Sample:
        return run_process([sys.executable, "-c", code])

    cold = Job("navbake bake, nothing compiled", run_cold)
    warm = Job("navbake bake, all compiled", lambda: run_process(bake))
    info = Job("navbake info GRID", show_info)
    numba = Job("import numba", lambda: python("import numba"))
    bare = Job("bare Python", lambda: python("pass"))
    return {
        "cold": lambda: Row(cold, [numba], ratio=40.0),
        "warm": lambda: Row(warm, [numba], excess=0.5),
        "info": lambda: Row(info, [numba], ratio=1.0),
        "import": lambda: Row(Job("import navbake", lambda: python("import navbake")), [bare]),
    }


# --- updates -------------------------------------------------------------------------------


# Scenes in which one body is pushed, and the share of a fresh bake that an update may take
IN_A_ROW = 5  # updates of which the median is taken
MOVING = {
    "hall": 0.02,
    "hall, ceiling": 0.02,
    "hall, ground": 0.01,
    "hall, ceiling and ground": 0.01,
    "36 rooms": 0.02,
    "36 rooms, ceiling": 0.02,
    "36 rooms, wider": 0.01,
    "storeys": 0.02,
    "storeys, wider": 0.02,
    "storeys, ceiling": 0.02,
    "house-100": 0.01,
    "apartment": 0.04,
}


def _make_moving(name: str) -> tuple[Any, dict[str, Any]]:
    """The model of a row of updates, and its settings."""
    from sweep_moves import make_model  # beside bench.py

    kind, _, more = name.partition(", ")
    if kind == "hall":
        ground = "ground" in more
        xml, settings = make_hall(ceiling="ceiling" in more, ground=ground, wider=ground)
    elif kind == "36 rooms":
        xml, settings = make_rooms(36, ceiling=more == "ceiling", wider=more == "wider")
    elif kind == "storeys":
        xml, settings = make_storeys(
            2, ceiling=more == "ceiling", wider=more == "wider", rooms=9, cell_size=CELL
        )
    elif kind == "apartment":
        return make_model("apartment")
    else:
        xml, settings = make_rooms(100)
    return mujoco.MjModel.from_xml_string(xml), settings


def _update_row(kind: str, count: int, share: float) -> Row:
    """Furniture is pushed by up to half a metre from where it stood at first.

    Of `whole`, a wall is lifted and put down, so that all is baked again.
    """
    warnings.simplefilter("ignore", navbake.BakeWarning)
    model, settings = _make_moving("house-100" if kind == "whole" else kind)
    baker = navbake.Baker(model, **settings)
    rng = random.Random(0)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    free = model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
    places = {model.body(int(body)).name: data.xpos[body].copy() for body in free}
    low = np.min(list(places.values()), axis=0)
    high = np.max(list(places.values()), axis=0)
    wall = model.geom(1).id
    lifts = cycle((0.01, -0.01))

    def draw(place: Any) -> list[float]:
        xy = place[:2] + np.array([rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5)])
        if len(places) > 1:  # nothing stands beyond the house
            xy = np.clip(xy, low[:2], high[:2])
        return [*xy, place[2]]

    def update_once() -> Sample:
        moves = {}
        if kind == "whole":
            model.geom_pos[wall, 2] += next(lifts)
        else:
            names = rng.sample(sorted(places), count)
            moves = {name: draw(places[name]) for name in names}
        begin = time.perf_counter()
        changes = baker.update(bodies=moves)
        seconds = time.perf_counter() - begin
        if (kind == "whole") == (changes.reason == ""):
            raise RuntimeError(f"{kind}: an update for another reason: {changes.reason!r}")
        return Sample(seconds, facts={"reason": changes.reason, "cells": len(changes.cells[0])})

    def update() -> Sample:
        # they follow one another where they are used
        samples = [update_once() for _ in range(1 if kind == "whole" else IN_A_ROW)]
        return sorted(samples, key=lambda sample: sample.seconds)[len(samples) // 2]

    def bake() -> Sample:
        data.qpos[:] = baker.pose[0]
        begin = time.perf_counter()
        navbake.bake(model, data, **settings)
        return Sample(time.perf_counter() - begin)

    num_cells = sum(level.width * level.height for level in baker.grid.levels)
    name = f"Baker.update: {kind}, {count} of {len(places)} bodies, {num_cells:,} cells"
    fresh = Job("a fresh bake of the model in memory", bake, warms_up=True)
    return Row(Job(name, update, warms_up=True), [fresh], ratio=share)
