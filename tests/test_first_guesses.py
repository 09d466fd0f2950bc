"""What somebody writes who has read nothing yet works, or is answered with what to write."""

from __future__ import annotations

import numpy as np
import pytest

import navbake
from navbake import PathFinder, VoxelFinder, VoxelGrid, samples
from navbake.episodes import make_episodes
from navbake.errors import ConfigError, FormatError, QueryError
from navbake.tensors import make_tensors, sample
from project_paths import GOLDEN

GRID = navbake.load(GOLDEN / "apartment.grid.json.gz")
VOXELS = VoxelGrid(values=np.zeros((8, 8, 8), dtype=np.bool_), origin=(0.0, 0.0, 0.0), res=0.1)
APARTMENT = str(samples.path("apartment"))


@pytest.mark.parametrize(
    ("guess", "error", "answer"),
    [
        (lambda: navbake.load_grid("a.json"), AttributeError, r"'load_grid': write navbake\.load"),
        (lambda: navbake.bake("a.grid.json"), ConfigError, r"a grid, not a scene: .*navbake\.load"),
        (lambda: navbake.load(APARTMENT), FormatError, r"`navbake bake \S*apartment.yaml` makes"),
        (
            lambda: navbake.load(APARTMENT),
            FormatError,
            r"`navbake convert \S*apartment.yaml apartment.grid",
        ),
        (lambda: GRID.tensors(goals="room:kitchen"), QueryError, r"a list of goals.*\['room:kit"),
        (lambda: PathFinder(GRID).room_of("sopha"), QueryError, "did you mean 'sofa'"),
        (lambda: navbake.make_episodes, AttributeError, r"write navbake\.episodes\.make_episodes"),
        (lambda: PathFinder(GRID).snap_point, AttributeError, r"write `snap\(position\)`"),
        (lambda: PathFinder(GRID).num_islands, AttributeError, r"write `islands\.count`"),
        (lambda: PathFinder(VOXELS), QueryError, "expected a navigation grid.* got a VoxelGrid"),
        (
            lambda: VoxelFinder(VOXELS, 0.1).random_point(0),
            QueryError,
            r"expected a numpy\.random\.Generator, or None, got 0",
        ),
        (
            lambda: GRID.tensors(goals=(3.0, 2.0, 0.0)),
            QueryError,
            r"write goals=\[\(3\.0, 2\.0, 0\.0\)\]",
        ),
        (
            lambda: make_tensors([GRID, GRID], goals=[(1, 3, 0)]),
            QueryError,
            "a list of goals for each of 2 grids",
        ),
        (
            lambda: sample(GRID.tensors(), np.zeros((1, 3)), room="kitchen"),
            QueryError,
            r"write t\.rooms\[scene\]\.index\('kitchen'\) \+ 1",
        ),
        (
            lambda: PathFinder(GRID).fly_to,
            AttributeError,
            "'PathFinder' has no attribute 'fly_to'$",
        ),
        (lambda: PathFinder(GRID).find_path("room:hall", (0, 0)), QueryError, "are goals, not pl"),
        (lambda: make_episodes(GRID, "objectnav"), ConfigError, "did you mean 'object'"),
        (lambda: navbake.load(GOLDEN), FormatError, r"expected a file, got the folder \S*golden"),
        (lambda: navbake.loads, AttributeError, "no attribute 'loads'$"),
        *(
            (lambda given=given: navbake.bake(APARTMENT, **given), ConfigError, answer)
            for given, answer in (
                (
                    {"agent_radius": 0.3},
                    r'write `agent=\{"radius": …\}` in place .* `agent_radius`',
                ),
                ({"radius": 0.3}, r'write `agent=\{"radius": …\}`'),
                ({"cell_size": 0.3}, r'write `grid=\{"cell_size": …\}`'),
                ({"colour": 1}, "unknown key `colour`"),
            )
        ),
    ],
)
def test_a_guess_is_answered(guess, error, answer):
    with pytest.raises(error, match=answer):
        guess()


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_a_sample_is_baked_by_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    coarse = {"cell_size": 0.5}
    by_name, by_path = navbake.bake("apartment", grid=coarse), navbake.bake(APARTMENT, grid=coarse)
    assert by_name.scene_id == by_path.scene_id == "apartment"
    (tmp_path / "apartment").write_text("somebody's own")
    assert str(samples.find("apartment")) == "apartment" and str(samples.find("no")) == "no"
