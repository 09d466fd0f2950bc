"""Walls at many places of the raster, and houses on slabs of many heights: none is special."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from box_truth import TINY, Corners, centers, occupied_by_boxes, within
from box_worlds import box, world
from hard_cases import GROUND, STONES, house_on_slab
from navbake.baker.pipeline import run_bake
from navbake.config.settings import parse_config
from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.islands import find_islands
from navbake.runtime.path_finder import PathFinder

# Each wall crosses a lane of its own, 0.7 m wide; the lanes lie beside each other, 0.1 m apart
LANE, PITCH, HALF = 0.7, 0.8, 0.6  # width, distance, half length [m]
# every multiple of 1 cm, and 1 mm past it
PLACES = [round(n / 100 + past, 3) for n in range(-45, 46) for past in (0.0, 0.001)]
BLIND = 'contype="0" conaffinity="0"'  # else MuJoCo wants a hull of it


def lanes(kind: str, along: str, cell: float, radius: float, folder) -> SceneGrid2D:
    """A grid of lanes along an axis, with a wall without thickness across each of them."""
    length = PITCH * len(PLACES)

    def corners(a0, b0, a1, b1) -> tuple[float, float, float, float]:
        return (a0, b0, a1, b1) if along == "x" else (b0, a0, b1, a1)

    pieces, vertices = [], []
    for number, place in enumerate(PLACES):
        x0, y0, x1, y1 = corners(-HALF, PITCH * number, HALF, PITCH * number + LANE)
        pieces.append(box("", x0, y0, -0.1, x1, y1, 0))
        middle, half = PITCH * number + LANE / 2, LANE / 2
        if kind == "plane":
            x, y = corners(place, middle, 0, 0)[:2] if along == "x" else (middle, place)
            turn, size = ("1 0 0", f"1 {half}") if along == "x" else ("0 1 0", f"{half} 1")
            pieces.append(f'<geom type="plane" size="{size} 1" pos="{x} {y} 1" zaxis="{turn}"/>')
        for side in (middle - half, middle + half):
            for z in (0.0, 2.0):
                vertices.append((place, side, z) if along == "x" else (side, place, z))
    asset = ""
    if kind == "mesh":
        text = " ".join(str(value) for vertex in vertices for value in vertex)
        quads = [f"{i} {i + 1} {i + 2} {i + 1} {i + 3} {i + 2}" for i in range(0, len(vertices), 4)]
        asset = f'<mesh name="m" vertex="{text}" face="{" ".join(quads)}" inertia="shell"/>'
        pieces.append(f'<geom type="mesh" mesh="m" {BLIND}/>')
    path = folder / "lanes.xml"
    path.write_text(world("".join(pieces), asset), encoding="utf-8")
    bounds = list(corners(-HALF, 0.0, HALF, length))
    settings = {
        "scene": {"path": str(path), "geoms": "all"},
        "grid": {"cell_size": cell, "bounds": bounds},
        "agent": {"radius": radius},
        "rooms": {"segment": False},
    }
    grid = run_bake(parse_config(settings)).grid
    assert isinstance(grid, SceneGrid2D)
    return grid
