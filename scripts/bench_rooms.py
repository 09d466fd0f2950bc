"""Divides generated offices and flats into rooms and counts those that are as a person would say.

    python scripts/bench_rooms.py [--count 100] [--first 1000] [--cell 0.1] [--door-width 1.0]

Each plan is baked as boxes and as one mesh, with a fixed `rooms.door_width`, and with `auto`. A
room is found where one of the grid's rooms reaches an intersection over union of 0.8 with it;
floor that got no room counts against it. A window leaks where one room is connected through its
opening. The constants of `navbake/baker/rooms/gap_limits.py` were chosen on plans 0 to 99.

    python scripts/bench_rooms.py --flats --count 400

bakes flats with doorways of 0.7 to 1.4 m, half of them turned, at three sizes of cells.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import numpy as np

from offices import make_flat, make_plan
from offices_truth import bake_plan, count_leaks, overlaps

FOUND = 0.8  # intersection over union
SIZES = (0.05, 0.08, 0.1)  # of cells, for flats [m]


def main() -> None:
    args = _parse_args()
    if args.flats:
        _measure_flats(args)
        return
    widths = [*args.door_width, "auto"]
    with tempfile.TemporaryDirectory() as name:
        for as_mesh in (False, True):
            print("as one mesh" if as_mesh else "as boxes", flush=True)
            for width in widths:
                _measure(args, as_mesh, width, Path(name))


def _measure_flats(args: argparse.Namespace) -> None:
    """Counts rooms that are found at each size of cells, and flats with as many at all sizes."""
    shares: dict[float, list[float]] = {size: [] for size in SIZES}
    same = 0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(args.first, args.first + args.count):
            plan = make_flat(seed)
            counts, missed = [], []
            for size, found in shares.items():
                stages = bake_plan(plan, Path(folder), as_mesh=False, cell_size=size)
                rooms = stages.rooms.index[0]
                here = overlaps(rooms, plan.truth(stages.lattice))
                found += here
                counts.append(int(rooms.max()))
                missed.append(sum(share < FOUND for share in here))
            same += len(set(counts)) == 1
            if args.each and (any(missed) or len(set(counts)) > 1):
                print(f"    flat {seed}: {len(plan.rooms)} rooms, {counts} found, {missed} missed")
    for size, found in shares.items():
        print(f"  cells of {size} m: {np.mean(np.array(found) >= FOUND):.1%} of {len(found)} rooms")
    print(f"  as many rooms at all sizes: {same} of {args.count} flats")


def _measure(args: argparse.Namespace, as_mesh: bool, width: float | str, folder: Path) -> None:
    shares: list[float] = []
    leaks = windows = close = 0
    start = time.perf_counter()
    for seed in range(args.first, args.first + args.count):
        plan = make_plan(seed)
        stages = bake_plan(plan, folder, as_mesh=as_mesh, cell_size=args.cell, door_width=width)
        rooms = stages.rooms.index[0]
        found = overlaps(rooms, plan.truth(stages.lattice))
        shares += found
        here = count_leaks(rooms, plan, stages.lattice)
        leaks += here
        windows += len(plan.windows)
        close += len(stages.rooms.warnings)
        missed = sum(share < FOUND for share in found)
        if args.each and width == "auto" and (missed or here):
            turned = f", turned by {np.rad2deg(plan.turn):.1f} degrees" if plan.turn else ""
            print(f"    plan {seed}: {missed} of {len(found)} missed, {here} leaks{turned}")
    share = float(np.mean(np.array(shares) >= FOUND))
    word = width if isinstance(width, str) else f"{width:.2f} m"
    print(
        f"  door_width {word}: {share:.1%} of {len(shares)} rooms found, {leaks} of {windows} "
        f"windows leak, {close} plans with close calls, {time.perf_counter() - start:.0f} s",
        flush=True,
    )


def _parse_args() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--count", type=int, default=100, help="how many plans (100)")
    parser.add_argument("--first", type=int, default=1000, help="the first seed (1000)")
    parser.add_argument("--cell", type=float, default=0.1, help="cell size [m] (0.1)")
    parser.add_argument(
        "--door-width", type=float, nargs="*", default=[1.0], help="fixed widths [m] (1.0)"
    )
    parser.add_argument("--flats", action="store_true", help="flats at three sizes of cells")
    parser.add_argument("--each", action="store_true", help="also names plans with a fault")
    return parser.parse_args()


if __name__ == "__main__":
    main()
