"""Flies random pairs through sample scenes, and counts what agrees with slow answers.

    python scripts/sweep_flights.py --pairs 1000 [--res 0.1] [--radius 0.25] [--cost 0.0]

A cost is right where it equals that of scipy's Dijkstra, on a graph of all moves that is made
without any of the finder's code, to 1e-9; a path where its swept ball meets no geom in MuJoCo by
more than 1e-6 m; a distance where it equals the least of those to all occupied voxels, to 1e-6 m.
Times are beside those of scipy's Dijkstra; `scripts/bench.py` has those of others.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import navbake
from navbake.voxels.finder import VoxelFinder
from navbake.voxels.grid import VoxelGrid

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from oracles.flights import CapsuleProbe, find_costs, make_large_graph

SCENES = ("house", "warehouse", "tower")
STARTS = 40  # scipy answers all goals of one start at once
DISTANCES = 300  # voxels whose distances are compared


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--pairs", type=int, default=1000, help="pairs in each scene (1000)")
    parser.add_argument("--res", type=float, default=0.1, help="edge of a voxel [m] (0.1)")
    parser.add_argument("--radius", type=float, default=0.25, help="radius of the ball [m] (0.25)")
    parser.add_argument("--cost", type=float, default=0.0, help="cost of clearance [m] (0)")
    parser.add_argument("--scene", action="append", choices=SCENES, help="some scenes; all")
    args = parser.parse_args()
    num_faults = 0
    for name in args.scene or SCENES:
        num_faults += sweep(name, args)
    raise SystemExit(num_faults > 0)


def sweep(name: str, args: Any) -> int:
    """Compare flights in one scene, print counts and ratios, and return the number of faults."""
    settings = navbake.samples.path(name)
    voxelizer = navbake.Voxelizer(settings)
    voxels = voxelizer.create(res=args.res)
    begin = time.perf_counter()
    finder = VoxelFinder(voxels, args.radius, cost_of_clearance=args.cost)
    took_to_make = time.perf_counter() - begin
    probe = CapsuleProbe(
        str(settings.parent / "scenes" / f"{name}.xml"),
        [geom.counted for geom in voxelizer.scene.geoms],
        voxelizer.scene.data.qpos,
    )
    begin = time.perf_counter()
    graph = make_large_graph(voxels, args.radius, args.cost)
    took_graph = time.perf_counter() - begin
    rng = np.random.default_rng(0)
    voxel_numbers = np.flatnonzero(finder.islands.labels == 1)
    starts = rng.choice(voxel_numbers, STARTS)
    goals = rng.choice(voxel_numbers, (STARTS, -(-args.pairs // STARTS)))
    find_path(finder, starts[0], goals[0, 0])  # compiles
    faults = compare_distances(voxels, rng)
    took = took_scipy = 0.0
    num_pairs = num_segments = 0
    lengths = []
    for start, goals_of_start in zip(starts, goals, strict=True):
        begin = time.perf_counter()
        expected = find_costs(graph, [int(start)])[0]
        took_scipy += (time.perf_counter() - begin) * len(goals_of_start)
        for goal in goals_of_start:
            begin = time.perf_counter()
            path = find_path(finder, start, goal)
            took += time.perf_counter() - begin
            num_pairs += 1
            if path is None or abs(path.cost - expected[goal]) > 1e-9 * max(1.0, expected[goal]):
                faults.append(f"cost {path and path.cost} from {start} to {goal}: {expected[goal]}")
                continue
            lengths.append(path.length / max(path.cost, 1e-9))
            for one, other in itertools.pairwise(path.positions):
                num_segments += 1
                clearance = probe.clearance(one, other, args.radius)
                if clearance < -1e-6:
                    faults.append(f"{one} to {other} meets a geom by {-clearance} m")
    for fault in faults:
        print(f"{name}: {fault}", flush=True)
    took_pair = took / num_pairs
    print(
        f"{name}: {'×'.join(map(str, voxels.shape))} voxels, {num_pairs} pairs, "
        f"{num_segments} lines in MuJoCo, {len(faults)} faults; the finder is made in "
        f"{1e3 * took_to_make:.0f} ms, scipy's graph in {took_graph:.1f} s; a path "
        f"{1e3 * took_pair:.1f} ms, {np.mean(lengths):.3f} of its route; "
        f"scipy {took_scipy / num_pairs / took_pair:.1f} times as long",
        flush=True,
    )
    return len(faults)


def find_path(finder: VoxelFinder, start: int, goal: int) -> Any:
    """The path between two voxels' centres, by their flat numbers."""
    return finder.find_path(*centers(finder.voxels, [start, goal]))


def centers(voxels: VoxelGrid, numbers: Any) -> Any:
    """World x, y, z of voxels' centres, by their flat numbers."""
    index = np.stack(np.unravel_index(np.asarray(numbers), voxels.shape), axis=-1)
    return voxels.bounds[0] + (index + 0.5) * voxels.res


def compare_distances(voxels: VoxelGrid, rng: np.random.Generator) -> list[str]:
    """Compare distances of random voxels with the least over all occupied ones."""
    values = voxels.distances().values
    cubes = np.argwhere(voxels.occupied)
    faults = []
    for number in rng.choice(values.size, DISTANCES):
        voxel = np.array(np.unravel_index(number, voxels.shape))
        excess = np.maximum(np.abs(cubes - voxel) - 0.5, 0.0)
        expected = voxels.res * math.sqrt((excess**2).sum(axis=1).min())
        if abs(values.flat[number] - expected) > 1e-6:
            faults.append(f"distance {values.flat[number]} of {voxel}: {expected}")
    return faults


if __name__ == "__main__":
    main()
