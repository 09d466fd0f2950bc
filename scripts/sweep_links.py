"""Plans over random links and areas, and counts what agrees with Dijkstra on a plain graph.

    python scripts/sweep_links.py --paths 2000 --reasons 500 [--first 0]

Buildings of one to four storeys, three agents and none, by cost and by time. A path is right where
its cost equals that of scipy's Dijkstra to 1e-9, a reason where the link or area that it names is
the first that bars the agent on some way to the goal.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from oracles.plans import NAMED, check_plans


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--paths", type=int, default=2000, help="how many paths (2000)")
    parser.add_argument(
        "--reasons",
        type=int,
        default=500,
        help="how many reasons that name a link or an area (500)",
    )
    parser.add_argument("--first", type=int, default=0, help="the first seed (0)")
    args = parser.parse_args()
    counts: Counter[str] = Counter()
    seed = args.first
    while counts["paths"] < args.paths or counts[NAMED] < args.reasons:
        faults = check_plans(seed, counts)
        for fault in faults:
            print(f"seed {seed}: {fault}", flush=True)
        counts["faults"] += len(faults)
        seed += 1
    for name, number in sorted(counts.items()):
        print(f"{number:>6}  {name}")
    raise SystemExit(counts["faults"] > 0)


if __name__ == "__main__":
    main()
