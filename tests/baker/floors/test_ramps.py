"""Ramps that rise more than a step over a cell are one walk, at any size of cells."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import navbake
from navbake.baker.bake.pipeline import build_grid
from navbake.baker.bake.stages import bake_stages
from navbake.baker.floors.component_kernels import JoinRule
from navbake.baker.floors.regions import find_components
from navbake.baker.floors.surface_kernels import FLOOR_LIKE, STANDABLE, Surfaces
from navbake.navgrid.islands import find_islands
from navbake.navgrid.lattice import Lattice
from navbake.runtime.path_finder import PathFinder
from standable import regions_of

# a floor at 0, a ramp that rises 1 m over x 0 to RUN, and a floor at 1, each 4 m wide
STEP = 0.02


def scene(run: float, beside: str = "") -> str:
    length = math.hypot(run, 1.0)
    angle = math.atan2(1.0, run)
    x = run / 2 + 0.05 * math.sin(angle)
    z = 0.5 - 0.05 * math.cos(angle)
    turn = f'euler="0 {-math.degrees(angle)} 0"'
    return f"""<mujoco><worldbody>
      <geom type="box" size="1.5 2 .1" pos="-1.5 0 -.1"/>
      <geom type="box" size="{length / 2} 2 .05" pos="{x} 0 {z}" {turn}/>
      <geom type="box" size="1.5 2 .1" pos="{run + 1.5} 0 .9"/>{beside}
    </worldbody></mujoco>"""


@pytest.fixture
def stages_of(tmp_path: Path):
    def run(xml: str, cell: float = 0.1, step: float = STEP, **agent):
        path = tmp_path / "ramp.xml"
        path.write_text(xml)
        agent = {"traversable_floor_height": step, "max_slope": 60, **agent}
        config = {"scene": {"path": str(path)}, "agent": agent, "grid": {"cell_size": cell}}
        return bake_stages(config)

    return run


@pytest.fixture
def bake(stages_of):
    def run(*args, **kwargs):
        stages = stages_of(*args, **kwargs)
        return build_grid(stages.config, stages.baked_structure, stages.baked_pose)

    return run


@pytest.mark.parametrize(("cell", "run"), [(0.1, 3.7), (0.14, 3.7), (0.13, 3.7)])
def test_ramp_is_one_walk_when_it_rises_more_than_a_step_over_a_cell(bake, cell, run):
    """Up to two steps: beyond that, the ramp itself is in the way over half a cell."""
    assert STEP < cell / run <= 2 * STEP
    grid = bake(scene(run), cell)
    assert len(grid.levels) == 1
    assert find_islands(grid)[0].max() == 1


@pytest.mark.parametrize("cell", [0.1, 0.25, 0.5, 1.0])
@pytest.mark.parametrize("run", [3.7, 1.0])
def test_ramp_is_one_region_at_any_cell_size(stages_of, cell, run):
    stages = stages_of(scene(run), cell)
    assert regions_of(stages).num_regions == 1


def test_ramp_steeper_than_the_slope_is_none(bake):
    grid = bake(scene(1.0), max_slope=40)
    assert max(islands.max() for islands in find_islands(grid)) == 2


def test_step_beside_a_ramp_is_none(bake):
    """A box as high as the ramp rises over a cell, but flat, joins nothing."""
    rise = 0.1 * 1.0 / 3.7
    box = f'<geom type="box" size=".75 1 {rise / 2}" pos="-1.5 0 {rise / 2}"/>'
    grid = bake(scene(3.7, box))
    assert not PathFinder(grid).is_navigable((-1.5, 0.0, rise))


def test_with_a_usual_step_no_slope_is_needed(bake):
    grid = bake(scene(1.0), step=0.25)
    assert grid.step_array.shape == (0, 4)
    assert find_islands(grid)[0].max() == 1


def test_agents_walk_over_it(bake, tmp_path):
    grid = bake(scene(3.7))
    assert len(grid.step_array)
    assert (grid.step_array[:, [0, 2]] == 0).all()
    finder = PathFinder(grid)
    path = finder.find_path((-2.0, 0.0, 0.0), (5.0, 1.5, 1.0))
    # pulled straight, up the slope in one line
    assert path.length == pytest.approx(math.hypot(7.0, 1.5))
    assert finder.try_step((-1.0, 0.0, 0.0), (5.0, 0.5, 1.0), slide=False)[:2] == pytest.approx(
        (5.0, 0.5)
    )
    distance = finder.distance_field((-2.0, 0.0, 0.0))
    assert np.isfinite(distance[0]).all()


def test_links_are_in_the_file_and_on_the_level(bake, tmp_path):
    grid = bake(scene(3.7))
    grid.save(tmp_path / "ramp.grid.json")
    again = navbake.load(tmp_path / "ramp.grid.json")
    assert again.step_array.tolist() == grid.step_array.tolist()
    assert find_islands(again)[0].max() == 1


def test_level_of_several_keeps_its_slopes(bake):
    """An upper floor, under a roof: its level and the ramp's are whole grids by themselves."""
    upper = "".join(f'<geom type="box" size="1.5 2 .1" pos="-1.5 0 {z}"/>' for z in (2.9, 4.9))
    grid = bake(scene(3.7, upper))
    assert len(grid.levels) == 2
    lower = grid.levels[0]
    assert len(lower.step_array) == len(grid.step_array) > 0
    assert find_islands(lower)[0].max() == 1


@pytest.mark.parametrize("rise", [0.1, 0.3])
def test_slopes_join_what_they_predict(rise):
    """Pairs of surfaces with slopes, against the rule spelled out."""
    lattice = Lattice(0.0, 1.0, 1.0, 2, 1)
    generator = np.random.default_rng(7)
    first = np.arange(2, dtype=np.int32)
    ids = np.zeros(2, dtype=np.int32)
    marks = np.full(2, FLOOR_LIKE | STANDABLE, dtype=np.uint8)
    for _ in range(300):
        rise_by_first, rise_by_second = generator.uniform(-rise, rise, 2)
        dz = generator.uniform(-0.5, 0.5)
        normal = np.array([[-rise_by_first, 0.3, 1], [-rise_by_second, -0.2, 1]], dtype=np.float32)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        z = np.array([0.0, dz])
        surfaces = Surfaces(lattice, first, first + np.int32(1), z, ids, marks, normal)
        components = find_components(surfaces, JoinRule(0.12, can_slopes_join=True))
        is_steep = max(abs(rise_by_first), abs(rise_by_second)) > 0.12
        between = min(rise_by_first, rise_by_second) <= dz <= max(rise_by_first, rise_by_second)
        near = max(abs(dz - rise_by_first), abs(dz - rise_by_second)) <= 0.12
        expected = abs(dz) <= 0.12 or (is_steep and (between or near))
        assert components.num_components == (1 if expected else 2)
