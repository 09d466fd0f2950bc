"""Bakes and verifies odd meshes and broken scene files, and counts what came out.

    python scripts/sweep_meshes.py --meshes 2500 --files 400 [--seed 0]

The meshes are of the kinds of `tests/odd_meshes.py`, by default settings and by lowered ones. The
files are rooms in SDF, URDF and USD, with some of their numbers, words and elements changed. Each
is baked and verified, or refused by an error of navbake in one line. Anything else is a fault:
another error, a warning of numpy, a verification that disagrees, more than `MAX_SECONDS`.
"""

from __future__ import annotations

import argparse
import random
import re
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import navbake
from odd_meshes import KINDS, LOWERED

MAX_SECONDS = 20.0  # that a bake and its verification may take; the first also compiles [s]
SAMPLE = 100  # cells that are verified
ODD_NUMBERS = ("0", "-1", "1e4", "-1e-9", "1e17", "nan", "inf", "0.05", "3", "1e-3", "")

BOXES = {
    "floor": ("0 0 -0.05", "4 4 0.1"),
    "south": ("0 -1.9 1.3", "4 0.2 2.6"),
    "north": ("0 1.9 1.3", "4 0.2 2.6"),
    "table": ("1 0.5 0.4", "0.8 0.6 0.8"),
}
SDF_BOX = """
<model name="{name}"><static>1</static><link name="l"><collision name="c"><pose>{pos} 0 0 0</pose>
<geometry><box><size>{size}</size></box></geometry></collision></link></model>"""
SDF = f"""<sdf version="1.9"><world name="w">
{"".join(SDF_BOX.format(name=name, pos=pos, size=size) for name, (pos, size) in BOXES.items())}
<model name="ball"><pose>-1 0 0.3 0 0 0</pose><link name="l"><collision name="c"><geometry>
<sphere><radius>0.3</radius></sphere></geometry></collision></link></model>
<model name="can"><static>1</static><link name="l"><pose>0 1 0.5 0 0 1</pose><collision name="c">
<geometry><cylinder><radius>0.2</radius><length>1</length></cylinder></geometry></collision>
</link></model></world></sdf>"""
URDF_BOX = """
<link name="{name}"><collision><origin xyz="{pos}" rpy="0 0 0"/><geometry>
<box size="{size}"/></geometry></collision></link>
<joint name="{name}_joint" type="fixed"><parent link="base"/><child link="{name}"/></joint>"""
URDF = f"""<robot name="room"><link name="base"/>
{"".join(URDF_BOX.format(name=name, pos=pos, size=size) for name, (pos, size) in BOXES.items())}
<link name="door"><collision><origin xyz="0 0.4 1" rpy="0 0 0"/><geometry><box size="0.05 0.8 2"/>
</geometry></collision></link><joint name="hinge" type="revolute"><parent link="base"/>
<child link="door"/><origin xyz="0 0 0" rpy="0 0 0.3"/><axis xyz="0 0 1"/>
<limit lower="0" upper="1.5" effort="1" velocity="1"/></joint></robot>"""
USDA_BOX = """
def Cube "{name}" (prepend apiSchemas = ["PhysicsCollisionAPI"])
{{
    double size = 1
    double3 xformOp:translate = ({pos})
    float3 xformOp:scale = ({size})
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
}}"""
USDA = f"""#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Z"
)
{
    "".join(
        USDA_BOX.format(name=name, pos=pos.replace(" ", ", "), size=size.replace(" ", ", "))
        for name, (pos, size) in BOXES.items()
    )
}
def Mesh "ramp" (prepend apiSchemas = ["PhysicsCollisionAPI"])
{{
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-2, -1, 0), (-1, -1, 0.2), (-1, 1, 0.2), (-2, 1, 0)]
}}"""
FILES = {".sdf": SDF, ".urdf": URDF, ".usda": USDA}


def break_file(text: str, rng: random.Random) -> str:
    """Change one to four numbers, words or lines of a scene file."""
    for _ in range(rng.randint(1, 4)):
        kind = rng.random()
        if kind < 0.7:
            numbers = list(re.finditer(r"-?\d+(\.\d+)?", text))
            number = rng.choice(numbers)
            if rng.random() < 0.5:
                new = rng.choice(ODD_NUMBERS)
            else:
                new = f"{float(number.group()) * rng.uniform(-2, 2) + rng.uniform(-0.5, 0.5):.4g}"
            text = text[: number.start()] + new + text[number.end() :]
        elif kind < 0.85:
            words = list(re.finditer(r"[A-Za-z_]{3,}", text))
            word, other = rng.choice(words), rng.choice(words)
            text = text[: word.start()] + other.group() + text[word.end() :]
        else:
            lines = text.split("\n")
            number = rng.randrange(len(lines))
            lines[number : number + 1] = rng.choice(([], [lines[number]] * 2))
            text = "\n".join(lines)
    return text


def try_scene(scene: Any, settings: dict[str, Any]) -> tuple[str, str]:
    """Bake and verify a scene: what came out, and a text where that is a fault."""
    start = time.perf_counter()
    outcome, text = "baked", ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            warnings.simplefilter("ignore", navbake.BakeWarning)
            grid = navbake.bake(scene, **settings)
            report = navbake.verify(grid, scene, sample=SAMPLE)
        if not report.ok:
            outcome, text = "disagrees", "; ".join(map(str, report.findings[:2]))
    except navbake.NavbakeError as error:
        outcome = "refused"
        if "\n" in str(error):
            outcome, text = "many lines", str(error)
    except Exception:
        outcome, text = "error", traceback.format_exc(limit=-3)
    seconds = time.perf_counter() - start
    if seconds > MAX_SECONDS:
        outcome, text = "slow", f"{seconds:.1f} s"
    return outcome, text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--meshes", type=int, default=2500, help="how many meshes (2500)")
    parser.add_argument(
        "--files", type=int, default=400, help="how many files of each format (400)"
    )
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    num_faults = 0
    print(f"{'kind':24}{'baked':>7}{'refused':>9}{'faults':>8}{'slowest s':>11}", flush=True)

    def show(kind: str, counts: Counter[str], slowest: float) -> None:
        faults = counts.total() - counts["baked"] - counts["refused"]
        line = f"{counts['baked']:7,}{counts['refused']:9,}{faults:8,}"
        print(f"{kind:24}{line}{slowest:11.1f}", flush=True)

    def sweep(kind: str, scenes: list[tuple[str, Any, dict[str, Any]]]) -> int:
        counts = Counter[str]()
        slowest = 0.0
        for name, scene, settings in scenes:
            start = time.perf_counter()
            outcome, text = try_scene(scene, settings)
            slowest = max(slowest, time.perf_counter() - start)
            counts[outcome] += 1
            if text:
                print(f"{kind} {name}: {outcome}: {text}", flush=True)
        show(kind, counts, slowest)
        return counts.total() - counts["baked"] - counts["refused"]

    settings_of = {"default": {}, "lowered": LOWERED}
    per_kind = -(-given.meshes // (len(KINDS) * len(settings_of)))
    for make in KINDS:
        for settings_name, settings in settings_of.items():
            scenes = []
            for seed in range(given.seed, given.seed + per_kind):
                scenes.append((f"seed {seed}", make(np.random.default_rng(seed)), settings))
            num_faults += sweep(f"{make.__name__}, {settings_name}", scenes)
    with tempfile.TemporaryDirectory() as folder:
        for suffix, text in FILES.items():
            files = []
            for number in range(given.files):
                path = Path(folder, f"{number}{suffix}")
                path.write_text(break_file(text, random.Random(f"{given.seed} {path.name}")))
                files.append((path.name, path, {}))
            num_faults += sweep(suffix, files)
    if num_faults:
        sys.exit(f"{num_faults} faults")


if __name__ == "__main__":
    main()
