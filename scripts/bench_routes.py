"""Measures graphs of routes: how much more routes cost than paths, and that lanes are free.

    python scripts/bench_routes.py [--pairs 500] [--rooms 100] [GRID …]

Without grids it takes a house of many rooms, the samples, and the tower with a box in its lobby
whose cells cost ten times as much. For each it prints nodes and lanes,
the processor time that making them takes, the ratio of the costs of routes to those of paths of
more than 9 m between random places (see `route_ratios` in the tests), islands of more than 4 m²
without a node, and lanes on which the agent's disc meets an occupied square, by exact distances.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import numpy as np

import navbake
from benchmarks.scenes import AGENT, CELL, RADIUS, ROOMS, SAMPLES, Scenes
from navbake.routes.build import make_routes
from project_paths import GOLDEN
from route_ratios import TOLL, ratios, with_toll

ASKED = 1.15


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("grids", nargs="*", type=Path, help="files to measure")
    parser.add_argument("--pairs", type=int, default=500, help="paths of each grid")
    parser.add_argument("--rooms", type=int, default=ROOMS, help="of the house")
    args = parser.parse_args()
    if args.grids:
        grids = {path.name: navbake.load(path) for path in args.grids}
    else:
        with tempfile.TemporaryDirectory() as folder:
            scene = Scenes(Path(folder)).house(args.rooms)
            agent = {"radius": RADIUS, "height": AGENT}
            settings = {"scene": {"path": str(scene)}, "grid": {"cell_size": CELL}, "agent": agent}
            grids = {f"house-{args.rooms}": navbake.bake(settings)}
        names = (*SAMPLES, "tower")
        grids |= {name: navbake.load(GOLDEN / f"{name}.grid.json.gz") for name in names}
        grids["tower, toll"] = with_toll(grids["tower"], TOLL, 10.0)
    head = f"{'grid':12} nodes lanes  time [s]  ratio: mean   99 %    max  over {ASKED}"
    print(f"{head}  islands  lanes not free")
    for name, grid in grids.items():
        begin = time.process_time()
        graph = make_routes(grid)
        spent = time.process_time() - begin
        found, (missed, touching) = ratios(grid, graph, args.pairs), faults(grid, graph)
        over = np.count_nonzero(found > ASKED)
        sizes = f"{name:12} {len(graph.nodes):5} {len(graph.lanes):5} {spent:9.1f}"
        shares = f"{found.mean():12.3f} {np.quantile(found, 0.99):6.3f} {found.max():6.3f}"
        print(f"{sizes} {shares} {over:10} {missed:8} {touching:15}", flush=True)


def faults(grid: navbake.NavGrid, graph: navbake.routes.graph.RouteGraph) -> tuple[int, int]:
    """Islands that are large and have no node, and lanes that aren't free."""
    search = navbake.PathFinder(grid.inflate(graph.radius) if graph.radius else grid).search
    cells = [search.flat.cells_at(node.position, node.level) for node in graph.nodes]
    reached = {*search.islands.number[np.array(cells).ravel()].tolist()}
    missed = {*np.flatnonzero(search.islands.areas > 4.0).tolist()} - reached
    lanes = [remark for remark in graph.audit(grid).remarks if remark.check == "lanes"]
    return len(missed), len(lanes)


if __name__ == "__main__":
    main()
