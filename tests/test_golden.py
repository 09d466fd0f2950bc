"""The sample scenes bake into what they always did, byte for byte; a change shows where."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

import navbake
from differences import difference_map, first_difference
from navbake.baker.bake.pipeline import run_bake
from navbake.config.settings import load_config
from navbake.formats.navgrid import dumps_navgrid
from project_paths import CONFIGS, GOLDEN

SAMPLES = sorted(path.stem for path in CONFIGS.glob("*.yaml"))


def golden_file(name: str) -> Path:
    return GOLDEN / f"{name}.grid.json.gz"


def file_of(baked, kept) -> bytes:
    """A grid's file, without what may differ from the one that was kept.

    That is timings, versions, and the scene's digest with MuJoCo's version: another MuJoCo rounds
    poses in its own way.
    """
    baked.timings = {}
    content = dumps_navgrid(baked)
    same_mujoco = baked.navbake["mujoco"] == kept.navbake["mujoco"]
    for key in ("version", "mujoco") if same_mujoco else ("version", "mujoco", "sceneDigest"):
        own, other = (f'"{key}":"{grid.navbake[key]}"'.encode() for grid in (baked, kept))
        assert content.count(own) == 1
        content = content.replace(own, other)
    return content


def describe_change(kept, baked) -> str | None:
    """None if two grids are the same, else what differs, where."""
    difference = first_difference(kept, baked)
    if difference is None:
        return None
    maps = [
        f"level {number}\n{difference_map(a, b)}"
        for number, (a, b) in enumerate(zip(kept.levels, baked.levels, strict=False))
    ]
    return "\n".join([difference, *maps])


@pytest.mark.parametrize("name", SAMPLES)
def test_sample_is_what_it_was(name, tmp_path):
    path = golden_file(name)
    kept = navbake.load(path)
    baked = run_bake(load_config(CONFIGS / f"{name}.yaml")).grid
    content = file_of(baked, kept)
    (tmp_path / "baked.grid.json").write_bytes(content)
    change = describe_change(kept, navbake.load(tmp_path / "baked.grid.json"))
    if change:
        pytest.fail(f"{name} (scripts/make_golden.py {name} keeps the change): {change}")
    assert content == gzip.decompress(path.read_bytes())
    assert not baked.warnings  # what people start from warns of nothing


def test_change_in_one_cell_shows_where():
    kept, changed = (navbake.load(golden_file("apartment")) for _ in range(2))
    level = changed.levels[0]
    row, col = (int(v) for v in np.argwhere(level.free)[100])
    level.occupancy[row, col] = 1
    level.weights[row, col] = np.inf
    change = describe_change(kept, changed)
    assert change.startswith(f"weights: 1 of {level.free.size} cells differ")
    assert f"the first at row {row}, col {col}: 1.0 and inf" in change
    picture = [line for line in change.splitlines() if line and set(line) <= set(".# x")]
    assert len(picture) == level.height // 2  # a character is two cells wide and high
    assert picture[row // 2][col // 2] == "x"
    assert sum(line.count("x") for line in picture) == 1
