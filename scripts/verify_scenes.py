"""Verifies and audits grids of many scenes, and prints what came of it, a row each.

    python scripts/verify_scenes.py configs/*.yaml                    # the samples, all cells
    python scripts/verify_scenes.py --houses 20 --paths 50 --radius 0.1 0.2 0.3
    python scripts/verify_scenes.py house-100.xml --set grid.cell_size=0.05 --sample 100000

Scenes are baked first; of houses that are made at random, and of `--grid` files, which are read,
likewise. The exit status is 1 if any grid disagrees with its scene.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import navbake
from buildings.make import make_building
from navbake.config.settings import BakeConfig, load_config, parse_config

HEAD = ("scene", "cells", "free", "blocked", "floors", "disputed", "wrong", "remarks", "s")


def main() -> None:
    options = _parse_options()
    total: dict[str, float] = dict.fromkeys(HEAD[1:], 0)
    swept: dict[float, list[float]] = {radius: [0, 0, 0, 0] for radius in options.radius}
    print(" ".join(f"{name:>9}" for name in HEAD))
    with tempfile.TemporaryDirectory() as folder:
        for name, grid, scene in _grids(options, Path(folder)):
            begin = time.perf_counter()
            report = navbake.verify(grid, scene, sample=options.sample, seed=options.seed)
            counts, remarks = report.total, navbake.audit(grid).remarks
            row = {
                "cells": counts.cells,
                "free": counts.free_free,
                "blocked": counts.blocked_blocked,
                "floors": counts.floors,
                "disputed": counts.disputed,
                "wrong": len(report.findings),
                "remarks": len(remarks),
                "s": time.perf_counter() - begin,
            }
            _print_row(name, row)
            for found in report.findings[:5]:
                print(f"    {found.kind}, level {found.level} {found.position}: {found.text}")
            for remark in remarks[:5]:
                print(f"    {remark}")
            for key, value in row.items():
                total[key] += value
            for radius in options.radius if options.paths else ():
                more = {"sample": 1, "radius": radius, "paths": options.paths}
                sweeps = navbake.verify(grid, scene, seed=options.seed, **more).sweeps
                if sweeps is not None:
                    done = (sweeps.paths, sweeps.length, sweeps.touching, sweeps.beside)
                    swept[radius] = [a + b for a, b in zip(swept[radius], done, strict=True)]
    _print_row("all", total)
    for radius, (paths, length, touching, beside) in swept.items():
        if options.paths:
            print(
                f"{paths} paths of {length:.0f} m swept with {radius:g} m: {touching} touch, "
                f"{beside} meet what lies within a step of their ends"
            )
            total["wrong"] += touching
    raise SystemExit(1 if total["wrong"] else 0)


def _print_row(name: str, row: dict[str, float]) -> None:
    texts = [f"{value:.1f}" if key == "s" else f"{value:,.0f}" for key, value in row.items()]
    print(" ".join([f"{name[:20]:>9}", *(f"{text:>9}" for text in texts)]), flush=True)


def _grids(options: argparse.Namespace, folder: Path) -> Iterator[tuple[str, Any, BakeConfig]]:
    for path in options.scenes:
        config = load_config(path, options.set)
        grid = navbake.load(options.grid) if options.grid else _bake(config)
        yield path.stem, grid, config
    for seed in range(options.first, options.first + options.houses):
        building = make_building(seed)
        path = folder / f"house-{seed}.xml"
        path.write_text(building.mjcf(), encoding="utf-8")
        config = parse_config({"scene": {"path": str(path)}, **building.settings(options.cell)})
        yield path.stem, _bake(config), config


def _bake(config: BakeConfig) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return navbake.bake(config)


def _parse_options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Verify and audit grids of many scenes.")
    parser.add_argument("scenes", type=Path, nargs="*", help="scenes, or settings (YAML)")
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE")
    parser.add_argument("--grid", type=Path, help="the grid of the only scene, so as not to bake")
    parser.add_argument("--houses", type=int, default=0, help="houses made at random")
    parser.add_argument("--first", type=int, default=0, help="seed of the first house")
    parser.add_argument("--cell", type=float, default=0.1, help="cells of houses [m]")
    parser.add_argument("--sample", type=int, default=None, help="cells to look at (all)")
    parser.add_argument("--paths", type=int, default=0, help="paths to sweep, in each scene")
    parser.add_argument("--radius", type=float, nargs="*", default=[0.1, 0.2, 0.3], help="[m]")
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


if __name__ == "__main__":
    main()
