"""Recast, the navigation mesh builder of game engines, as a peer: compiled here, run on triangles.

It takes Debian's `librecast-dev` and g++. Where either is missing, rows say so.
"""

from __future__ import annotations

import shutil
import subprocess
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.measure import Job, Sample, run_process
from benchmarks.scenes import AGENT, CELL, MAX_SLOPE, RADIUS, STEP, Soup

SOURCE = Path(__file__).with_suffix(".cpp")
HEADERS = Path("/usr/include/recastnavigation")


@cache
def why_missing() -> str:
    """Say why Recast can't be run here; empty where it can."""
    if shutil.which("g++") is None:
        return "no Recast to compare with: there is no g++"
    if not HEADERS.is_dir():
        return "no Recast to compare with: apt install librecast-dev"
    return ""


def compile_recast(folder: Path) -> Path:
    """Compile the program, if it isn't there yet."""
    program = folder / "recast_bench"
    if not program.exists():
        flags = ["-std=c++17", "-O3", "-DNDEBUG", f"-I{HEADERS}"]
        command = ["g++", *flags, str(SOURCE), "-o", str(program), "-lRecast"]
        subprocess.run(command, check=True)
    return program


def recast_job(folder: Path, soup: Soup) -> Job:
    """Recast from rasterizing to regions, over a soup of triangles, without reading them."""
    program = compile_recast(folder)
    path = folder / f"{soup.path.stem}.triangles"

    def measure() -> Sample:
        if not path.exists():
            _write(path, soup)
        numbers = [str(value) for value in (CELL, STEP, AGENT, RADIUS, MAX_SLOPE)]
        return run_process([str(program), str(path), *numbers])

    return Job("Recast, rasterize to regions", measure)


def _write(path: Path, soup: Soup) -> None:
    """Write what the program reads: y is up, and the corners stay anticlockwise from outside."""
    vertices, corners = soup.read()
    turned = np.stack([vertices[:, 0], vertices[:, 2], -vertices[:, 1]], axis=1)
    with open(path, "wb") as file:
        file.write(np.array([len(vertices), len(corners)], "<i4").tobytes())
        file.write(turned.astype("<f4").tobytes())
        file.write(corners.astype("<i4").tobytes())
