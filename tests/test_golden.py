"""The sample scenes bake into what they always did; a change shows where, in text."""

from __future__ import annotations

import numpy as np
import pytest

import navbake
from differences import difference_map, first_difference
from navbake.baker.pipeline import run_bake
from navbake.config.settings import load_config
from project_paths import ROOT

SAMPLES = sorted(path.stem for path in (ROOT / "configs").glob("*.yaml"))


def golden(name: str):
    return navbake.load(ROOT / "tests" / "golden" / f"{name}.grid.json.gz")


def forget(grid, *keys: str) -> None:
    """Leave out what navbake's metadata state under some keys, levels' own included."""
    for one in (grid, *grid.levels):
        for key in keys:
            one.navbake.pop(key, None)


def describe_change(kept, baked) -> str | None:
    """None if two grids are the same but for versions and timings, else what differs, where."""
    if kept.navbake["mujoco"] != baked.navbake["mujoco"]:  # it rounds poses in its own way
        forget(kept, "sceneDigest")
        forget(baked, "sceneDigest")
    forget(kept, "version", "mujoco")
    forget(baked, "version", "mujoco")
    difference = first_difference(kept, baked)
    if difference is None:
        return None
    maps = [
        f"level {number}\n{difference_map(a, b)}"
        for number, (a, b) in enumerate(zip(kept.levels, baked.levels, strict=False))
    ]
    return "\n".join([difference, *maps])


@pytest.mark.parametrize("name", SAMPLES)
def test_sample_is_what_it_was(name):
    baked = run_bake(load_config(ROOT / "configs" / f"{name}.yaml")).grid
    change = describe_change(golden(name), baked)
    if change:
        pytest.fail(f"{name} (scripts/make_golden.py {name} keeps the change): {change}")


def test_change_in_one_cell_shows_where():
    changed = golden("apartment")
    level = changed.levels[0]
    row, col = (int(v) for v in np.argwhere(level.free)[100])
    level.occupancy[row, col] = 1
    level.weights[row, col] = np.inf
    change = describe_change(golden("apartment"), changed)
    assert f"row {row}, col {col}" in change.replace("[", "").replace("]", "") or str(row) in change
    assert change.count("x") >= 1
    picture = [line for line in change.splitlines() if set(line) <= set(".# x")]
    assert sum("x" in line for line in picture) == 1
