"""Towers: what a bake costs in scenes of many levels."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

import navbake
from navbake.baker.floors.surfaces import find_highest_within_step

SLAB = '<geom type="box" size="1 1 0.1" pos="0 0 {z:.1f}"/>'


def bake_tower(folder: Path, num_levels: int) -> float:
    """Bake slabs over each other, the last of which is the roof; return the CPU time [s]."""
    slabs = "".join(SLAB.format(z=2.6 * number) for number in range(num_levels + 1))
    path = folder / f"{num_levels}.xml"
    path.write_text(f"<mujoco><worldbody>{slabs}</worldbody></mujoco>")
    start = time.process_time()
    grid = navbake.bake(path)
    grid.save(folder / "tower.grid.json")
    seconds = time.process_time() - start
    assert len(grid.levels) == num_levels
    return seconds


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_the_time_of_a_bake_is_linear_in_its_levels(tmp_path):
    """It was nine times as long for four times the levels; noise may add a half."""
    bake_tower(tmp_path, 10)  # loads the kernels
    ratios = []
    for _ in range(3):
        few = bake_tower(tmp_path, 150)
        ratios.append(bake_tower(tmp_path, 600) / few)
        if ratios[-1] < 6.0:
            break
    assert min(ratios) < 6.0, ratios


@pytest.mark.parametrize("seed", range(5))
def test_the_highest_surface_within_a_step_is_found_in_tall_columns(seed):
    rng = np.random.default_rng(seed)
    columns = [np.sort(rng.integers(0, 40, rng.integers(0, 30)) * 0.1) for _ in range(40)]
    end = np.cumsum([len(column) for column in columns])
    first = end - [len(column) for column in columns]
    z = rng.uniform(-0.5, 4.5, 40)
    found = find_highest_within_step(first, end, np.concatenate(columns), z, 0.25)
    for column, height, highest in zip(columns, z, found, strict=True):
        near = column[abs(column - height) <= 0.25 + 1e-6]
        assert highest == near[-1] if len(near) else np.isnan(highest)
