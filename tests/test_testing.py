"""The assertions for tests of grids: they raise whatever Python was told of `assert`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import navbake
import navbake.testing as testing
from grid_maps import level_from
from navbake.testing import assert_sound, assert_true
from project_paths import CONFIGS

APARTMENT = CONFIGS / "apartment.yaml"


@pytest.fixture(scope="module")
def baked(tmp_path_factory):
    """The apartment's grid, baked with the MuJoCo that is installed: others have other digests."""
    path = tmp_path_factory.mktemp("baked") / "apartment.grid.json"
    navbake.bake(APARTMENT).save(path)
    return path


def test_give_the_reports(baked):
    assert assert_true(baked, APARTMENT, sample=50).checked == 50
    assert assert_sound(baked).ok


def test_assert_true_lists_ten_places(baked):
    grid = navbake.load(baked)
    grid.attributes["floorHeight"] += np.float32(0.1)
    with pytest.raises(AssertionError) as caught:
        assert_true(grid, APARTMENT, sample=50)
    head, *places, rest = str(caught.value).split("\n")
    assert head == "apartment: grid and scene disagree" and len(places) == 10
    assert all("level 0, (" in place for place in places)
    assert rest.startswith("and ") and rest.endswith(" more")


def test_assert_sound_lists_what_it_finds():
    level = level_from("..........\n" * 10)
    with pytest.raises(AssertionError, match="an audit finds\nremark: all 100 cells are free"):
        assert_sound(level)
    assert assert_sound(level, remarks=False).ok
    level.weights[3, 3] = -1
    with pytest.raises(
        AssertionError, match=r"error: level 0 .*1 cell has a weight that is no cost"
    ):
        assert_sound(level, remarks=False)


def test_raise_in_an_optimized_python_too(baked):
    """There, an assert statement does nothing."""
    path = Path(testing.__file__)
    module: dict[str, Any] = {"__name__": "optimized"}
    exec(compile(path.read_text(encoding="utf-8"), path, "exec", optimize=1), module)
    with pytest.raises(AssertionError):
        module["assert_sound"](level_from("..........\n" * 10))
    wrong = navbake.load(baked)
    wrong.attributes["floorHeight"] += np.float32(0.1)
    with pytest.raises(AssertionError):
        module["assert_true"](wrong, APARTMENT, sample=50)
