"""Measure how the time of a bake grows with the number of levels.

    python scripts/bench_levels.py [--levels 250 500 1000]

Bakes towers of slabs, 16 m² each, and saves their grids. Prints the CPU time of each tower, and its
ratio to that of the tower before: 2 where the time is linear and the number of levels doubles.
Kernels are compiled beforehand. CPU time is measured, as other work on the machine changes the
wall time.
"""

from __future__ import annotations

import argparse
import time
import warnings
from pathlib import Path

import navbake
from navbake.files import scratch_folder

STOREY = 2.6  # height of a storey [m]


def main() -> None:
    """Print a line for each tower."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--levels", type=int, nargs="+", default=[250, 500, 1000])
    args = parser.parse_args()
    warnings.simplefilter("ignore", navbake.BakeWarning)
    with scratch_folder() as folder:
        measure_tower(20, folder)  # loads the kernels
        print(f"{'levels':>8}{'CPU [s]':>10}{'ratio':>8}")
        seconds_before = None
        for num_levels in args.levels:
            seconds = measure_tower(num_levels, folder)
            ratio = "" if seconds_before is None else f"{seconds / seconds_before:.2f}"
            print(f"{num_levels:>8}{seconds:>10.2f}{ratio:>8}", flush=True)
            seconds_before = seconds


def measure_tower(num_levels: int, folder: Path) -> float:
    """Bake a tower and save its grid.

    Args:
        num_levels: how many levels the tower has, without its roof.
        folder: the folder for the scene and the grid.

    Returns:
        The CPU time of all threads [s].
    """
    scene = folder / f"tower-{num_levels}.xml"
    scene.write_text(make_tower(num_levels), encoding="utf-8")
    start = time.process_time()
    grid = navbake.bake(scene)
    grid.save(folder / f"tower-{num_levels}.grid.json")
    assert len(grid.levels) == num_levels
    return time.process_time() - start


def make_tower(num_levels: int) -> str:
    """Write the MJCF of a tower: slabs of 4 x 4 m over each other, with a roof at the top."""
    slabs = "".join(
        f'<geom type="box" size="2 2 0.1" pos="0 0 {STOREY * number:.1f}"/>'
        for number in range(num_levels + 1)
    )
    return f"<mujoco><worldbody>{slabs}</worldbody></mujoco>"


if __name__ == "__main__":
    main()
