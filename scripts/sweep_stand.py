"""Holds poses from which a base reaches things against MuJoCo, and measures how long they take.

    python scripts/sweep_stand.py --poses 2000 --timed 10000

In the apartment, the house and random kitchens, poses are found for all objects with a rectangular
footprint. The base as a box must meet nothing, by `mj_geomDistance`; the distance from its axis to
the object's geoms must be within reach, and a ray from its eye must meet the object first. For each
object without a pose, brute force tries all free cells, each at the headings towards the object
and at 64 others, by the same measures; what it reaches is counted as missed.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import time
import warnings
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import navbake
from kitchens import make_kitchen
from navbake.navgrid.grid import NavGrid
from stand_truth import BaseInScene

SIZE = (0.5, 0.4)  # length and width of the base [m]
RADIUS = 0.2  # with which it drives [m]
OUTLINE = [(0.25, 0.2), (-0.25, 0.2), (-0.25, -0.2), (0.25, -0.2)]
REACH = (0.3, 0.8)  # [m]
SLACK = 1e-3  # by which MuJoCo's distances may be off [m]
NUM_HEADINGS = 64


def judge_scene(grid: NavGrid, base: BaseInScene, counts: Counter[str], label: str) -> None:
    """Count what is true of the poses for all objects of a scene, and which objects are missed."""
    finder = navbake.PathFinder(grid.inflate(RADIUS))
    names = [name for name in finder.search.names.list_objects() if name in base.geoms_of]
    targets = [f"object:{name}" for name in names]
    poses = finder.stand_poses(targets, reach=REACH, footprint=OUTLINE)
    for index, target_index in enumerate(poses.target_index.tolist()):
        name = names[target_index]
        judgement = base.judge(poses.positions[index], poses.headings[index], name)
        is_in_reach = REACH[0] - SLACK <= judgement.distance <= REACH[1] + SLACK
        counts["poses"] += 1
        counts["poses that meet something"] += bool(judgement.met)
        counts["poses out of reach"] += not is_in_reach
        counts["poses that don't see the object"] += not judgement.is_seen
        if judgement.met or not is_in_reach or not judgement.is_seen:
            place = poses.positions[index].round(2).tolist()
            print(f"{label}: {name} from {place}: {judgement}", flush=True)
    counts["objects"] += len(names)
    for name, reason in poses.why_not.items():
        counts["objects without a pose"] += 1
        if is_reached_by_brute_force(finder, base, name):
            counts["objects that brute force reaches"] += 1
            print(f"{label}: {name} is missed: {reason}", flush=True)


def is_reached_by_brute_force(finder: navbake.PathFinder, base: BaseInScene, name: str) -> bool:
    """Whether a base on any free cell, at any heading, reaches and sees an object, by MuJoCo."""
    search = finder.search
    for position in search.flat.positions(np.flatnonzero(search.flat.free)):
        base.put(position, 0.0)
        if not REACH[0] <= base.measure(name) <= REACH[1] or not base.sees(name):
            continue
        for index in range(NUM_HEADINGS):
            base.put(position, 2.0 * math.pi * index / NUM_HEADINGS)
            if not base.list_met():
                return True
    return False


def measure_time(count: int) -> tuple[int, int, float]:
    """Find poses for a thousand objects in one call: how many poses, objects, and seconds."""
    grid = navbake.bake(navbake.samples.path("warehouse")).inflate(RADIUS)
    finder = navbake.PathFinder(grid)
    rng = np.random.default_rng(0)
    num_targets = count // 10
    points = finder.random_point(rng, num_targets)
    names = finder.search.names.list_objects()
    targets = [*points[len(names) :].tolist(), *(f"object:{name}" for name in names)]
    seconds = []
    for _ in range(3):
        begin = time.perf_counter()
        poses = finder.stand_poses(
            targets, count=12, footprint=OUTLINE, spread=0.1, sight=True, reach=REACH
        )
        seconds.append(time.perf_counter() - begin)
    return len(poses), len(targets), min(seconds)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--poses", type=int, default=2000, help="least number of poses (2000)")
    parser.add_argument("--timed", type=int, default=10_000, help="poses whose time counts (10000)")
    args = parser.parse_args()
    warnings.simplefilter("ignore", navbake.BakeWarning)
    counts: Counter[str] = Counter()
    for sample, keyframe in (("apartment", None), ("house", "doors_open")):
        settings = navbake.samples.path(sample)
        grid = navbake.bake(settings)
        scene = settings.parent / "scenes" / f"{sample}.xml"
        judge_scene(
            grid, BaseInScene(str(scene), SIZE, grid.agent_height, keyframe), counts, sample
        )
    seed = 0
    with tempfile.TemporaryDirectory() as folder:
        while counts["poses"] < args.poses:
            scene = Path(folder) / f"kitchen_{seed}.xml"
            scene.write_text(make_kitchen(seed))
            grid = navbake.bake(scene)
            base = BaseInScene(str(scene), SIZE, grid.agent_height)
            judge_scene(grid, base, counts, f"kitchen {seed}")
            seed += 1
    num_poses, num_targets, seconds = measure_time(args.timed)
    for name, number in counts.items():
        print(f"{number:>6}  {name}")
    print(f"{num_poses} poses for {num_targets} targets in {seconds:.2f} s")


if __name__ == "__main__":
    main()
