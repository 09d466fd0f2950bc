"""Bakes generated buildings and counts on how many the grid is as a person would say.

    python scripts/sweep_buildings.py --count 200 [--first 0] [--cell 0.1] [--set roof=gable]

Prints each building with a fault, then the figures of each kind of feature.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import warnings
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import navbake
from buildings.kinds import make_any
from buildings.truth import check


def main() -> None:
    args = _parse_args()
    wanted = dict(word.split("=", 1) for word in args.set)
    right: Counter[tuple[str, str]] = Counter()
    total: Counter[tuple[str, str]] = Counter()
    kinds: Counter[str] = Counter()
    num_right = levels_right = 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "building.xml"
        for seed in range(args.first, args.first + args.count):
            building = make_any(seed, **wanted)
            path.write_text(building.mjcf(), encoding="utf-8")
            settings = {"scene": {"path": str(path)}, **building.settings(args.cell)}
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                faults = check(navbake.bake(settings), building)
            num_right += not faults
            levels_right += not any(fault.startswith("levels") for fault in faults)
            kinds.update({" ".join(fault.split(":")[0].split()[:2]) for fault in faults})
            for feature in building.features.items():
                total[feature] += 1
                right[feature] += not faults
            if faults:
                words = " ".join(f"{k}={v}" for k, v in building.features.items())
                print(f"seed {seed}: {words}", *faults, sep="\n    ", flush=True)
    print(f"\n{num_right} of {args.count} right, {levels_right} with the right number of levels")
    for kind, number in kinds.most_common():
        print(f"  {kind}: {number}")
    for feature in sorted(total):
        print(f"{right[feature]:>5} of {total[feature]:>4}  {feature[0]}: {feature[1]}")


def _parse_args() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--count", type=int, default=200, help="how many buildings (200)")
    parser.add_argument("--first", type=int, default=0, help="the first seed (0)")
    parser.add_argument("--cell", type=float, default=0.1, help="cell size [m] (0.1)")
    parser.add_argument("--set", nargs="*", default=[], metavar="A=B", help="fix a feature")
    return parser.parse_args()


if __name__ == "__main__":
    main()
