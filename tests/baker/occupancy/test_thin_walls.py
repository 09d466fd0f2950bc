"""Walls without thickness, wherever they stand on the raster, block the cells that they touch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import navbake
from box_worlds import box, stages_of_xml, world
from navbake.baker.bake.pipeline import bake
from navbake.baker.bake.stages import Stages
from navbake.baker.occupants.movable import name_occupants
from navbake.navgrid.grid import SceneGrid2D

CELL, HALF = 0.1, 1.0  # of the raster [m], and of the floor's shorter side [m]
FLOOR = box("floor", -1, -HALF, -0.1, 1, HALF, 0)
# every multiple of 1 cm over three cells, and 1 mm past it
PLACES = [round(n / 100 + past, 3) for n in range(-10, 21) for past in (0.0, 0.001)]
LOOSE = 'contype="0" conaffinity="0"'  # else MuJoCo wants a hull of it
KINDS = ("plane", "mesh")
GRID = {"bounds": [-1, -HALF, 1, HALF], "cell_size": CELL}


def thin_wall(kind: str, x: float, low: float = 0.0, high: float = 2.0) -> tuple[str, str]:
    """A wall across the floor at x, and the assets that it needs."""
    if kind == "plane":
        size, pos = f"{(high - low) / 2} {HALF} .1", f"{x} 0 {(low + high) / 2}"
        return f'<geom name="thin" type="plane" size="{size}" pos="{pos}" zaxis="1 0 0"/>', ""
    corners = [(x, y, z) for y in (-HALF, HALF) for z in (low, high)]
    text = " ".join(str(value) for corner in corners for value in corner)
    asset = f'<mesh name="m" vertex="{text}" face="0 1 2 1 3 2" inertia="shell"/>'
    return f'<geom name="thin" type="mesh" mesh="m" {LOOSE}/>', asset


def stages_with_wall(folder: Path, kind: str, x: float, **wall: float) -> Stages:
    geom, asset = thin_wall(kind, x, **wall)
    settings = {"scene": {"geoms": "all"}, "grid": GRID}
    return stages_of_xml(folder, world(FLOOR + geom, asset), **settings)


def touched_columns(x: float) -> list[int]:
    """The columns of cells whose closed squares hold x."""
    edge = np.arange(20) * CELL - 1
    return np.flatnonzero((edge <= x + 1e-9) & (x <= edge + CELL + 1e-9)).tolist()


def blocked_columns(occupied: NDArray[np.bool_]) -> list[int]:
    """The columns of cells that are occupied, none of them in part."""
    blocked = occupied.any(axis=0)
    np.testing.assert_array_equal(blocked, occupied.all(axis=0))
    return np.flatnonzero(blocked).tolist()


@pytest.mark.parametrize("kind", KINDS)
def test_wall_blocks_the_cells_that_it_touches(tmp_path, kind):
    for x in PLACES:
        stages = stages_with_wall(tmp_path, kind, x)
        assert blocked_columns(stages.occupancy.levels[0]) == touched_columns(x), x


@pytest.mark.parametrize("kind", KINDS)
def test_wall_on_a_line_has_its_name_on_both_sides(tmp_path, kind):
    stages = stages_with_wall(tmp_path, kind, 0.3)
    assert stages.standing_occupants is not None
    walls = stages.standing_occupants.mark_walls(0)[0]
    assert blocked_columns(walls) == touched_columns(0.3) == [12, 13]
    window = (slice(0, 20), slice(0, 20))
    names = name_occupants(stages.standing_occupants, stages.occupants, 0, window)
    for cell, entry in names.items():
        beside = cell % 20 in (12, 13)
        assert (entry.get("walls") == ["thin"]) == beside


def test_sheet_between_floor_and_step_or_over_the_head_blocks_nothing(tmp_path):
    """Its upper and lower edges only touch the band, which stays open in height."""
    for low, high in ((0.0, 0.25), (1.14, 2.0)):
        stages = stages_with_wall(tmp_path, "plane", 0.3, low=low, high=high)
        assert not stages.occupancy.levels[0].any()
    ceiling = f'<geom type="plane" size="1 {HALF} .1" pos="0 0 1.14" euler="180 0 0"/>'
    settings = {"scene": {"geoms": "all"}, "grid": GRID}
    stages = stages_of_xml(tmp_path, world(FLOOR + ceiling), **settings)
    assert not stages.occupancy.levels[0].any()


def test_closed_wall_blocks_no_cell_that_it_only_touches(tmp_path):
    """Only what encloses nothing meets a cell with its edges."""
    solid = box("wall", 0.1, -HALF, 0, 0.3, HALF, 2)
    settings = {"floors": {"min_area": 0.1}, "grid": GRID}
    stages = stages_of_xml(tmp_path, world(FLOOR + solid), **settings)
    assert blocked_columns(stages.occupancy.levels[0]) == [11, 12]


def test_wider_agent_keeps_its_distance_from_a_thin_wall(tmp_path):
    """The disc counts with its rim: centres at exactly its radius are blocked."""
    geom, asset = thin_wall("mesh", 0.3)
    settings = {"scene": {"geoms": "all"}, "grid": GRID, "agent": {"radius": 0.25}}
    stages = stages_of_xml(tmp_path, world(FLOOR + geom, asset), **settings)
    assert blocked_columns(stages.occupancy.levels[0]) == [10, 11, 12, 13, 14, 15]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("x", [0.0, 0.3, 0.301, 0.35])
def test_no_way_and_no_sight_through_it(tmp_path, kind, x):
    geom, asset = thin_wall(kind, x)
    path = tmp_path / "scene.xml"
    path.write_text(world(FLOOR + geom, asset))
    grid = bake({"scene": {"path": path, "geoms": "all"}, "grid": GRID})
    assert isinstance(grid, SceneGrid2D)
    start, goal = (-0.75, 0.05, 0.0), (0.75, 0.05, 0.0)
    for larger in (grid, grid.inflate(0.15)):
        finder = navbake.PathFinder(larger)
        assert not finder.find_path(start, goal)
        assert not finder.line_of_sight(start, goal)
        assert finder.find_path(start, (-0.45, -0.35, 0.0))
