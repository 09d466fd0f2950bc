"""What runs in a process of its own: a bake, and a command up to its first ray.

    python worker.py bake SETTINGS [--warm-up SETTINGS] [--threads N]
    python worker.py first-ray SETTINGS
    python worker.py read SETTINGS
    python worker.py read-trimesh SETTINGS

SETTINGS is JSON. Each prints a line of JSON; its `seconds`, if any, leave out what starts up.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))
from benchmarks.measure import peak

SHORT = 0.5  # a bake is repeated for at least this long [s]


def bake(settings: dict[str, Any], warm_up: dict[str, Any], threads: int | None) -> dict[str, Any]:
    """Bake by the clock, after a bake that warms up; short bakes several times, their median."""
    from navbake.baker.bake.pipeline import run_bake
    from navbake.config.settings import parse_config

    warnings.simplefilter("ignore")
    if warm_up:
        run_bake(parse_config(warm_up), threads=threads)
    times: list[float] = []
    while not times or (not _is_long(settings) and sum(times) < SHORT):
        start = time.perf_counter()
        done = run_bake(parse_config(settings), threads=threads)
        times.append(time.perf_counter() - start)
    return {
        "seconds": statistics.median(times),
        "stages": done.timings,
        "peak": peak(),
        "doors": len(done.grid.doors),
        "cells": sum(level.width * level.height for level in done.grid.levels),
        "triangles": count_triangles(settings["scene"]["path"]),
    }


def count_triangles(path: str) -> int:
    """How many triangles a PLY has, by its header; 0 for another file."""
    with open(path, "rb") as file:
        words = file.read(1000).split()
    return int(words[words.index(b"face") + 1]) if b"face" in words else 0


def read_mesh(path: str, *, by_trimesh: bool = False) -> dict[str, Any]:
    """Read a mesh file by the clock, as a warm bake does, or as trimesh."""
    import trimesh

    from navbake.baker.readers.mesh import read_named_meshes

    read: Callable[[], Any] = partial(read_named_meshes, Path(path))
    if by_trimesh:
        read = partial(trimesh.load, path, process=False, force="mesh")
    else:
        read()
    start = time.perf_counter()
    read()
    return {"seconds": time.perf_counter() - start}


def _is_long(settings: dict[str, Any]) -> bool:
    return os.path.getsize(settings["scene"]["path"]) > 10**7


def reach_first_ray(settings: dict[str, Any]) -> None:
    """Run the command `navbake bake`, and end the process where the first ray would be cast."""
    import navbake.baker.columns.column_sources as column_sources
    from navbake.cli.main import main

    def end(*_: Any, **__: Any) -> None:
        print("{}", flush=True)
        raise SystemExit

    column_sources.cast_columns = end  # type: ignore[attr-defined]
    path = settings["scene"]["path"]
    options = ["--set", f"grid.cell_size={settings['grid']['cell_size']}"]
    # nothing is ever written there
    sys.argv = ["navbake", "bake", path, "-o", f"{path}.grid.json", *options]
    main()


def main() -> None:
    parser = argparse.ArgumentParser(description="Run one job by the clock.")
    parser.add_argument("job", choices=("bake", "first-ray", "read", "read-trimesh"))
    parser.add_argument("settings", type=json.loads)
    parser.add_argument("--warm-up", type=json.loads, default={})
    parser.add_argument("--threads", type=int)
    given = parser.parse_args()
    if given.job == "bake":
        print(json.dumps(bake(given.settings, given.warm_up, given.threads)))
    elif given.job.startswith("read"):
        by_trimesh = given.job == "read-trimesh"
        print(json.dumps(read_mesh(given.settings["scene"]["path"], by_trimesh=by_trimesh)))
    else:
        reach_first_ray(given.settings)


if __name__ == "__main__":
    main()
