"""A window of a scene (`grid.bounds`) shows what a bake of the whole scene has there."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from box_worlds import box, world
from navbake.baker.bake.lattice import extend_lattice
from navbake.baker.bake.pipeline import BakeResult, run_bake
from navbake.baker.bake.stages import bake_stages
from navbake.baker.floors.below_grounds import FloorBelowGround
from navbake.baker.floors.levels import Floors, LevelFloor, crop_floors
from navbake.baker.floors.reach import UnreachedFloors
from navbake.baker.floors.regions import Patch
from navbake.config.settings import parse_config
from navbake.errors import SceneError
from navbake.navgrid.lattice import Lattice

# Off the lattice, so that no edge lies on a cell's centre, and rounding decides nothing
OFF = 0.0137


def ring(x0: float, y0: float, z0: float, x1: float, y1: float, z1: float) -> list[str]:
    walls = [(x0, y0, x1, y0 + 0.1), (x0, y1 - 0.1, x1, y1), (x0, y0, x0 + 0.1, y1)]
    walls.append((x1 - 0.1, y0 + 2, x1, y1))
    return [box("", a + OFF, b + OFF, z0, c + OFF, d + OFF, z1) for a, b, c, d in walls]


def slab(name: str, x0: float, y0: float, x1: float, y1: float, z: float) -> str:
    return box(name, x0 + OFF, y0 + OFF, z - 0.2, x1 + OFF, y1 + OFF, z)


# A house of two storeys with stairs outside, the upper one without its ceiling; a second one
# under a roof, which no step leads to; a shelf, a bed and a block
SCENE = [
    slab("yard", -5, -4, 15, 9, 0),
    *ring(0, 0, 0, 6, 5, 2.8), slab("upper", 0, 0, 6, 5, 3), *ring(0, 0, 3, 6, 5, 5.6),
    *(box("", 6 + 0.3 * k + OFF, OFF, 0, 6.3 + 0.3 * k + OFF, 1.5, 3 - 0.2 * k)
      for k in range(15)),
    *ring(9, 4, 0, 14, 8, 2.8), slab("landing", 9, 4, 14, 8, 3), *ring(9, 4, 3, 14, 8, 5.6),
    slab("roof", 9, 4, 14, 8, 5.8),
    box("bed", 1, 1, 0, 3, 3, 0.5), box("shelf", -4, 0, 1.9, -3, 6, 2.0),
    box("block", -4, 6.5, 0, 0, 8.5, 1.0),
]  # fmt: skip


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "scene.xml"
    path.write_text(world("".join(SCENE)))
    return path


CELL = 0.2
PLAIN = {"rooms": {"sources": []}, "names": {"enabled": False}, "agent": {"radius": 0.25}}


def bake(path: Path, bounds: list[float] | None = None, **more: object) -> BakeResult:
    grid = {"cell_size": CELL, "bounds": bounds}
    return run_bake(parse_config({"scene": {"path": str(path)}, "grid": grid, **PLAIN, **more}))


def grounds(result: BakeResult) -> list[float]:
    return [round(level.ground, 6) for level in result.grid.levels]


@pytest.fixture(scope="module")
def whole_result(path: Path) -> BakeResult:
    return bake(path)


def layers(result: BakeResult, part: Lattice) -> dict[float, np.ndarray]:
    """What the levels hold in the cells of a lattice, by ground: floor, occupied, solid."""
    layers_by_ground = {}
    for level in result.grid.levels:
        rows, _ = level.lattice.rows_cols(np.stack([part.center_y() * 0, part.center_y()], axis=1))
        _, cols = level.lattice.rows_cols(np.stack([part.center_x(), part.center_x() * 0], axis=1))
        has_row = (rows >= 0) & (rows < level.height)
        has_col = (cols >= 0) & (cols < level.width)
        values = np.stack([np.full(part.shape, np.nan), *np.ones((2, *part.shape))])
        for out, layer in zip(values, ("floorHeight", "occupancy", "solid"), strict=True):
            cells = np.ix_(rows[has_row], cols[has_col])
            out[np.ix_(has_row, has_col)] = level.attributes[layer][cells]
        layers_by_ground[round(level.ground, 6)] = values
    return layers_by_ground


@settings(max_examples=30, deadline=None)
@given(corners=st.lists(st.integers(0, 10_000), min_size=4, max_size=4))
def test_a_window_is_cut_from_the_whole(path, whole_result, corners):
    lattice = whole_result.grid.levels[0].lattice  # the yard's, so the whole scene's
    col, last_col = sorted(n % (lattice.width + 1) for n in corners[:2])
    row, last_row = sorted(n % (lattice.height + 1) for n in corners[2:])
    assume(col < last_col and row < last_row)
    part = lattice.cut(slice(row, last_row), slice(col, last_col))
    expected = layers(whole_result, part)
    shown = {}
    with contextlib.suppress(SceneError):  # no floor lies in the window
        shown = layers(bake(path, list(part.bounds)), part)
    for ground, values in shown.items():
        np.testing.assert_array_equal(values, expected.pop(ground))
    # levels without a standable surface in the window are not there
    assert all(occupied.all() for _, occupied, _ in expected.values())


def test_the_scene_is_what_its_comment_says(whole_result):
    assert grounds(whole_result) == [0, 3]
    top, unreached = whole_result.warnings
    assert "the top of 'block'" in top
    assert "no step leads to 16.9 m² of 'level 1' (most of it on 'landing'" in unreached


@pytest.mark.parametrize(
    ("bounds", "expected", "area"),
    [
        ([1.0, 1.0, 5.0, 4.0], [0, 3], 0),  # inside of the house without its ceiling
        ([10.0, 5.0, 13.0, 7.0], [0, 3], 1),  # under the roof, and no roof
        ([-4.6, 0.2, -2.0, 4.0], [0], 0),  # across the shelf
        ([-3.6, 7.0, -1.0, 8.2], [0], None),  # on the block, which is no floor
        ([6.6, 0.4, 8.2, 1.2], [0], 0),  # on the stairs
    ],
)
def test_windows_show_no_roofs_and_no_tops(path, bounds, expected, area):
    if area is None:
        with pytest.raises(SceneError, match="no floor lies inside"):
            bake(path, bounds)
        return
    result = bake(path, bounds)
    assert grounds(result) == expected
    assert sum("no step leads" in text for text in result.warnings) == area


def test_levels_of_a_window_are_numbered_anew_and_keep_their_steps(path, whole_result):
    stages = bake_stages({"scene": {"path": str(path)}, "grid": {"cell_size": CELL}})
    lattice = stages.lattice
    steps = stages.floors.steps
    assert len(steps)
    row, col = np.divmod(steps[:, [1, 3]], lattice.width)
    rows = slice(int(row.min()) - 3, int(row.max()) + 2)
    cols = slice(int(col.min()) - 3, int(col.max()) + 2)
    cut = lattice.cut(rows, cols)
    grid = {"cell_size": CELL, "bounds": list(cut.bounds)}
    window = bake_stages({"scene": {"path": str(path)}, "grid": grid})
    moved = steps.copy()
    moved[:, [1, 3]] = (row - rows.start) * cut.width + col - cols.start
    np.testing.assert_array_equal(window.floors.steps, moved)
    assert [level.name for level in window.floors.levels] == ["level 0", "level 1"]
    upper = bake(path, [11.0, 6.0, 12.0, 7.0], floors={"from": [[11, 6, 3]], "reach": "steps"})
    assert grounds(upper) == [3]
    assert upper.grid.metadata["navbake"]["levels"] == [{"name": "level 0", "ground": 3.0}]


def test_levels_and_steps_of_a_window_are_numbered_anew():
    """On the second of four levels, the window shows no standable surface."""
    floor = np.arange(8.0).reshape(2, 4)
    everywhere = np.ones((2, 4), dtype=bool)
    first = np.arange(4) < np.ones((2, 1))
    levels = [
        LevelFloor("level 0", 0.0, floor, everywhere),
        LevelFloor("level 1", 3.0, floor + 3, first),
        LevelFloor("level 2", 6.0, floor + 6, everywhere),
        LevelFloor("attic", 9.0, floor + 9, everywhere),
    ]
    steps = np.array([[0, 0, 1, 0], [0, 1, 2, 2], [0, 4, 2, 5], [1, 1, 2, 2], [2, 6, 3, 7]])
    cells = np.array([[0, 4], [4, 5]])
    patches = [Patch(0, 1.0, (0.0, 0.0, 0.0), cells[k]) for k in (0, 1)]
    unreached = [UnreachedFloors(level, patches[1], True) for level in (1, 2)]
    low = [FloorBelowGround(3.0, 2.9, patch) for patch in patches]
    scene_floors = Floors(
        levels, steps, patches, [], [], unreached, [], patches[:1], [], [], [], low
    )
    window = crop_floors(scene_floors, (slice(0, 2), slice(1, 4)))
    assert [level.name for level in window.levels] == ["level 0", "level 1", "attic"]
    assert [level.ground for level in window.levels] == [0, 6, 9]
    assert window.steps.tolist() == [[0, 0, 1, 1], [1, 4, 2, 5]]
    assert window.tops == patches[1:] and window.enclosed_by_meshes == []
    assert [part.level for part in window.unreached_floors] == [1]
    assert window.floors_below_grounds == low[1:]
    np.testing.assert_array_equal(window.levels[1].floor, floor[:, 1:] + 6)
    nowhere = replace(scene_floors, levels=[replace(level, standable=first) for level in levels])
    with pytest.raises(SceneError, match="no floor lies inside"):
        crop_floors(nowhere, (slice(0, 2), slice(1, 4)))


def test_one_may_start_outside_of_the_window(path):
    """On the yard, or in the upper storey that no step leads to."""
    outside = {"from": [[-1, -1, 0]], "reach": "steps"}
    assert grounds(bake(path, [10.0, 5.0, 13.0, 7.0], floors=outside)) == [0]
    inside = {"from": [[11, 6, 3]], "reach": "steps"}
    assert grounds(bake(path, [10.0, 5.0, 12.0, 5.8], floors=inside)) == [3]
    with pytest.raises(SceneError, match="no floor lies inside"):
        bake(path, [0.0, 0.0, 5.0, 4.0], floors=inside)


def test_a_window_of_a_scene_beyond_the_limit_is_judged_by_what_fits(path):
    """Of the house without its ceiling, no wall is seen; its upper storey stays a level."""
    grid = {"cell_size": CELL, "bounds": [1.0, 1.0, 5.0, 4.0], "max_cells": 20 * 15}
    result = run_bake(parse_config({"scene": {"path": str(path)}, **PLAIN, "grid": grid}))
    [warning] = [text for text in result.warnings if "decided on a part of the scene" in text]
    assert "`grid.max_cells` = 300" in warning
    assert grounds(result) == [0, 3]


@pytest.mark.parametrize(
    ("max_cells", "sides"),
    [
        (1000, [0.0, -1.0, 3.5, 3.0]),
        (56, [0.0, -1.0, 3.5, 3.0]),
        (55, [0.0, -0.5, 3.5, 3.0]),
        (41, [0.0, 0.5, 3.5, 3.0]),
        (29, [0.5, 1.0, 3.5, 3.0]),
        (1, [1.0, 1.5, 3.0, 3.0]),
    ],
)
def test_the_whole_is_laid_around_the_window(max_cells, sides):
    """It goes on by whole cells, no farther to one side than to another where there is more."""
    window = Lattice(1.0, 3.0, 0.5, 4, 3)  # x 1 to 3, y 1.5 to 3
    extended, (rows, cols) = extend_lattice(
        window, np.array([[0.2, -1.0, 0], [3.4, 3.0, 1]]), max_cells
    )
    assert extended.cut(rows, cols) == window
    assert list(extended.bounds) == sides
    assert extend_lattice(window, None, max_cells)[0] == window
