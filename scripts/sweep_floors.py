"""Looks for floors that are lost, and for floors where none is, in labyrinths and on boards.

    python scripts/sweep_floors.py --labyrinths 200 --first 9000
    python scripts/sweep_floors.py --boards

The walls of a labyrinth are as thick as its corridors, or 1.5 m; their tops are no floors, however
large. Boards, bars and slats are floors at any width, gap and step of the grid.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import navbake
from floor_scenes import boards, labyrinth, open_area

SIZES = ((1.0, None), (2.0, None), (3.0, None), (2.0, 1.5))  # corridors, walls [m]
WIDTHS, GAPS = (0.03, 0.05, 0.07, 0.09, 0.1, 0.12), (0.005, 0.01, 0.015, 0.02, 0.025)
CELLS = (0.05, 0.08, 0.1, 0.13)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--labyrinths", type=int, default=0, help="how many, of each size (0)")
    parser.add_argument("--first", type=int, default=9000, help="the first seed (9000)")
    parser.add_argument("--boards", action="store_true", help="sweep decks of boards")
    args = parser.parse_args()
    num = right = 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.xml"
        scenes = [labyrinths(args.first, args.labyrinths), decks() if args.boards else iter(())]
        for name, xml, settings, area in itertools.chain(*scenes):
            path.write_text(xml, encoding="utf-8")
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                grid = navbake.bake({"scene": {"path": str(path)}, **settings})
            free = grid.levels[0].free
            is_flat = (grid.levels[0].floor_height[free] == 0.0).all()
            found = free.sum() * grid.cell_size**2
            is_right = len(grid.levels) == 1 and is_flat and area < found < 2 * area
            num, right = num + 1, right + is_right
            if not is_right:
                heights = [round(level.ground, 3) for level in grid.levels]
                print(f"{name}: {found:.1f} m² free of {area:.1f}, levels at {heights}", flush=True)
    print(f"{right} of {num} right")


def labyrinths(first: int, count: int) -> Iterator[tuple[str, str, dict[str, object], float]]:
    """Name, MJCF, settings, and the least area that is free [m²]."""
    if count:
        import labmaze  # only these need it
    for seed in range(first, first + count):
        maze = labmaze.RandomMaze(height=17, width=17, random_seed=seed)
        walls = np.array(maze.entity_layer) == "*"
        for corridor, wall in SIZES:
            name = f"labyrinth {seed}, corridors of {corridor} m, walls of {wall or corridor} m"
            area = 0.75 * open_area(walls, corridor, wall)
            yield name, labyrinth(walls, corridor, wall), {"grid": {"cell_size": 0.15}}, area


def decks() -> Iterator[tuple[str, str, dict[str, object], float]]:
    """The same of decks; of gratings, too."""
    kinds = [*itertools.product(WIDTHS, GAPS, [0.03]), (0.01, 0.04, 0.05)]
    for (width, gap, crack), cell, turn in itertools.product(kinds, CELLS, (0.0, 30.0)):
        grid = {"cell_size": cell, "bounds": [-1.4, -1.4, 1.4, 1.4]}
        settings = {"grid": grid, "floors": {"crack": crack}}
        name = f"boards of {width} m, gaps of {gap} m, cells of {cell} m, turned by {turn}°"
        yield name, boards(width, gap, turn), settings, 2.8**2 - 1e-6


if __name__ == "__main__":
    main()
