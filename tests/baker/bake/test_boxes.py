"""The levels' boxes: the original client finds each free cell's own level by them."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from box_worlds import box, stages_of_xml, world
from navbake.baker.bake.boxes import BOX_GAP, BOX_MARGIN, find_level_boxes
from navbake.baker.bake.pipeline import build_grid, run_bake
from navbake.baker.floors.levels import LevelFloor
from navbake.config.settings import load_config
from navbake.navgrid.grid import MultiLevelGrid
from navbake.navgrid.lattice import Lattice
from original_client import look_up
from project_paths import CONFIGS

SAMPLES = sorted(path.stem for path in CONFIGS.glob("*.yaml"))
# treads with room to stand in under them are on the level above
INTERLEAVED = {"house": 0.006}


def interleaved(warnings):
    return [warning for warning in warnings if "interleave" in warning]


def check_client(grid, warnings, most_lost=0.0):
    """Each free cell is found but for a share, and a warning says how many are not."""
    found = look_up(grid)
    assert found.free and found.lost <= most_lost * found.free
    assert look_up(grid, by_cells=True).lost == found.lost
    if found.lost:
        [warning] = interleaved(warnings)
        assert warning.startswith("only for users of MINOS: ")
        assert f"misses {found.lost} of " in warning
    else:
        assert not interleaved(warnings)
    heights = [(low[1], high[1]) for low, high in (level.bbox_yup for level in grid.levels)]
    assert all(low < high for low, high in heights)
    if isinstance(grid, MultiLevelGrid):
        for level in grid.levels:
            lowest = float(np.nanmin(level.floor_height))
            assert 0 < lowest - level.bbox_yup[0][1] == pytest.approx(BOX_MARGIN, abs=1e-6)
        if not found.lost:
            assert all(a[1] < b[0] for a, b in pairwise(heights))


def bake_xml(folder, xml, **sections):
    stages = stages_of_xml(folder, xml, **sections)
    return build_grid(stages.config, stages.baked_structure, stages.baked_pose)


@pytest.mark.parametrize("name", SAMPLES)
def test_client_finds_each_free_cell_of_a_sample(name):
    result = run_bake(load_config(CONFIGS / f"{name}.yaml", ["names.enabled=false"]))
    check_client(result.grid, result.warnings, INTERLEAVED.get(name, 0.0))


SLABS = [
    box("low", -3, -2, -0.1, 3, 2, 0),
    box("high", -3, -2, 2.6, 3, 2, 2.7),
    # walls, so that the upper slab is no roof
    *(box("", x, -2, 2.7, x + 0.1, 2, 4.2) for x in (-3, 2.9)),
    *(box("", -3, y, 2.7, 3, y + 0.1, 4.2) for y in (-2, 1.9)),
]


@pytest.mark.parametrize("shift", [0.0, -0.3, 17.123456789, -2.7, 1234.5678])
def test_client_finds_each_free_cell_of_two_slabs(tmp_path, shift):
    """2.7 as float32 lies above 2.7, and -0.3 below -0.3."""
    moved = f'<body pos="0 0 {shift!r}">{"".join(SLABS)}</body>'
    stages = stages_of_xml(tmp_path, world(moved), grid={"cell_size": 0.2})
    grid = build_grid(stages.config, stages.baked_structure, stages.baked_pose)
    assert [level.ground for level in grid.levels] == pytest.approx([shift, 2.7 + shift])
    check_client(grid, [])
    low, high = grid.levels
    assert low.bbox_yup[1][1] == pytest.approx(high.bbox_yup[0][1] - BOX_GAP, abs=5e-7)


def test_box_of_one_level_is_the_scenes_own(tmp_path):
    """By its geometry: not the lattice, which is larger, nor the floor, which is higher."""
    pieces = box("", -1.93, -1, -0.35, 1.93, 1.51, 0) + box("", 0, 0, 0, 0.3, 0.3, 2.13)
    grid = bake_xml(tmp_path, world(pieces))
    assert grid.bbox_yup == ((-1.93, -0.35, -1.51), (1.93, 2.13, 1.0))
    assert grid.min_yup[1] == 0 and look_up(grid).lost == 0


def test_box_of_one_level_holds_floors_beside_the_scenes_own(tmp_path):
    pieces = '<geom type="plane" size="0 0 1"/>' + box("", -0.5, -0.5, 0.5, 0.5, 0.5, 0.7)
    grid = bake_xml(tmp_path, world(pieces), grid={"margin": 2.0})
    assert grid.bbox_yup == ((-2.5, -BOX_MARGIN, -2.5), (2.5, 0.7, 2.5))
    bounds = {"grid": {"bounds": [-1, -1, 3, 2]}}
    assert bake_xml(tmp_path, world(pieces), **bounds).bbox_yup == (
        (-1.0, -BOX_MARGIN, -2.0),
        (3.0, 0.7, 1.0),
    )
    endless = world('<geom type="plane" size="0 0 1"/>')
    grid = bake_xml(tmp_path, endless, **bounds)
    assert grid.bbox_yup == ((-1.0, -BOX_MARGIN, -2.0), (3.0, 1.14, 1.0))
    assert look_up(grid).lost == 0


def test_grounds_are_written_without_noise(tmp_path):
    pieces = box("", -2, -2, -0.1, 2, 2, 3.1e-16)
    grid = bake_xml(tmp_path, world(pieces))
    assert grid.min_yup[1] == 0 and math.copysign(1, grid.min_yup[1]) == 1
    assert grid.navbake["levels"][0]["ground"] == 0
    grid = bake_xml(tmp_path, world(pieces), levels=[{"ground": -0.1 - 2e-17}])
    assert grid.min_yup[1] == -0.1


# ---------------------------------------------------------------- any levels at all


HEIGHTS = st.sampled_from([0.0, 0.1, 0.5, 0.7, 1.3, 1.3005, 2.7, 2.8, 3.0])
WIDTH = 6


@st.composite
def floors(draw, most_levels=2):
    """Levels of one row, and where they are occupied; the highest ones are not the last always."""
    levels, occupied = [], []
    for number in range(draw(st.integers(2, most_levels))):
        cells = st.lists(HEIGHTS | st.none(), min_size=WIDTH, max_size=WIDTH)
        row = np.array([draw(cells)], dtype=float) + 0.4 * number
        if np.isnan(row).all():
            row[0, draw(st.integers(0, WIDTH - 1))] = number
        level = LevelFloor(f"level {number}", float(np.nanmin(row)), row, ~np.isnan(row))
        levels.append(level)
        blocked = draw(st.lists(st.booleans(), min_size=WIDTH, max_size=WIDTH))
        occupied.append(np.array([blocked]) & (draw(st.integers(0, 2)) == 0))
    return levels, occupied


LATTICE = Lattice(0.0, 1.0, 1.0, WIDTH, 1)


def floor_cols(level):
    """The columns from the first cell of a level that has a floor to the last one."""
    cols = np.flatnonzero(~np.isnan(level.floor[0]))
    return slice(int(cols[0]), int(cols[-1]) + 1)


def count_lost(levels, occupied, heights):
    """Cell by cell: how many free cells are not in the first box that holds them."""
    lost = 0
    cols_of_boxes = [floor_cols(level) for level in levels]
    for number, (level, blocked) in enumerate(zip(levels, occupied, strict=True)):
        for col in range(WIDTH):
            z = float(np.float32(level.floor[0, col]))
            if math.isnan(z) or blocked[0, col]:
                continue
            holding = [
                other
                for other, (cols, (low, high)) in enumerate(
                    zip(cols_of_boxes, heights, strict=True)
                )
                if cols.start <= col < cols.stop and low <= z <= high
            ]
            lost += holding[:1] != [number]
    return lost


@given(floors(most_levels=4))
@settings(max_examples=200, deadline=None)
def test_lost_cells_are_counted_right(scene):
    found = find_level_boxes(*scene, LATTICE, None, 1.14)
    heights = [(low[1], high[1]) for low, high in found.boxes]
    assert count_lost(*scene, heights) == found.num_misplaced_cells
    for level, (low, high) in zip(scene[0], found.boxes, strict=True):
        cols = floor_cols(level)
        assert (low[0], high[0]) == (cols.start, cols.stop) and low[1] <= high[1]


@given(floors(most_levels=4))
@settings(max_examples=50, deadline=None)
def test_levels_have_one_cell_around_their_floors_where_the_lattice_has_one(scene):
    levels, occupied = scene
    found = find_level_boxes(levels, occupied, LATTICE, None, 1.14)
    for level, (_, cols) in zip(levels, found.windows, strict=True):
        cols_of_floor = floor_cols(level)
        assert cols.start == max(cols_of_floor.start - 1, 0)
        assert cols.stop == min(cols_of_floor.stop + 1, WIDTH)


@given(floors())
@settings(max_examples=200, deadline=None)
def test_of_two_levels_no_other_boxes_lose_fewer(scene):
    found = find_level_boxes(*scene, LATTICE, None, 1.14)
    (low0, _), (low1, high1) = ((low[1], high[1]) for low, high in found.boxes)
    every = np.unique(np.concatenate([level.floor.ravel() for level in scene[0]]))
    tops = [low0, *every[~np.isnan(every)].astype(np.float32).astype(float)]
    fewest = min(count_lost(*scene, [(low0, top), (low1, high1)]) for top in tops)
    assert found.num_misplaced_cells == fewest


@given(floors(most_levels=4))
@settings(max_examples=200, deadline=None)
def test_boxes_share_no_height_over_a_cell_unless_levels_interleave(scene):
    levels, occupied = scene
    found = find_level_boxes(*scene, LATTICE, None, 1.14)
    for a in range(len(levels)):
        free = levels[a].floor[~np.isnan(levels[a].floor) & ~occupied[a]]
        for b in range(a + 1, len(levels)):
            one, other = floor_cols(levels[a]), floor_cols(levels[b])
            apart = one.start >= other.stop or other.start >= one.stop
            lowest = np.nanmin(levels[b].floor)
            if not apart and len(free) and lowest - 2 * BOX_MARGIN > free.max():
                assert found.boxes[a][1][1] < found.boxes[b][0][1]


def levels_of(*rows):
    """Levels of one row each, NaN for no floor, all free; and their boxes over `LATTICE`."""
    floors = [np.array([row]) for row in rows]
    levels = [LevelFloor("", float(np.nanmin(z)), z, ~np.isnan(z)) for z in floors]
    free = [np.zeros(z.shape, dtype=np.bool_) for z in floors]
    return levels, find_level_boxes(levels, free, LATTICE, None, 1.5)


NONE = math.nan


def test_boxes_of_levels_side_by_side_share_no_height():
    """The client's grid also takes the cells one column beyond the last for its own."""
    _, found = levels_of([0, 0, 0, NONE, NONE, NONE], [NONE, NONE, NONE, 1, 1, 1])
    assert found.boxes[0][1][1] < found.boxes[1][0][1]


def test_cells_that_a_lower_box_loses_count_no_more():
    """The second level keeps its cell at 0.95: the third one's two at 0.9 are the first one's."""
    lower, middle = [0, 1, 1, 1, 1, NONE], [0.7, NONE, NONE, NONE, NONE, 0.95]
    _, found = levels_of(lower, middle, [2, 0.9, 0.9, 2, 2, 2])
    assert (found.num_misplaced_cells, found.misplaced_levels) == (3, [1, 2])


def test_the_lowest_box_begins_below_its_ground():
    levels, _ = levels_of([0.0] * WIDTH, [3.0] * WIDTH)
    levels[0] = replace(levels[0], ground=-0.5)
    free = [np.zeros((1, WIDTH), dtype=np.bool_)] * 2
    low, _ = find_level_boxes(levels, free, LATTICE, None, 1.5).boxes[0]
    assert low[1] == pytest.approx(-0.5 - BOX_MARGIN)


def test_box_of_one_level_holds_floors_as_they_are_written():
    """In float32, 0.1 is a hair higher: higher than the scene's top."""
    level = LevelFloor("", 0.1, np.full((1, WIDTH), 0.1), np.ones((1, WIDTH), dtype=np.bool_))
    free = np.zeros((1, WIDTH), dtype=np.bool_)
    scene = np.array([[0.0, 0.0, -1.0], [WIDTH, 1.0, 0.1]])
    [(_, high)] = find_level_boxes([level], [free], LATTICE, scene, 1.5).boxes
    assert high[1] >= float(np.float32(0.1))


def two_stairs():
    """Up to a slab 3 m high: a solid stair, and one with room under its upper treads."""
    pieces = [box("", 0, 0, -0.1, 9, 6, 0), box("", 5, 0, 2.8, 9, 6, 3)]
    for number in range(16):
        x, top = 1 + 0.25 * number, 0.1875 * (number + 1)
        pieces.append(box("", x, 1, 0, x + 0.25, 2, top))
        pieces.append(box("", x, 4, top - 0.04, x + 0.25, 5, top))
    return "".join(pieces)


def test_warning_counts_the_cells_that_levels_cost(tmp_path):
    """The treads over a floor are on the level above, as high as treads of the level below."""
    stages = stages_of_xml(tmp_path, world(two_stairs()), grid={"cell_size": 0.1})
    grid = build_grid(stages.config, stages.baked_structure, stages.baked_pose)
    assert len(grid.levels) == 2
    found = look_up(grid)
    [warning] = interleaved(grid.warnings)
    assert 0 < found.lost < 300 and f"misses {found.lost} of {found.free} free cells" in warning
    assert "on 'level " in warning and "`levels`" in warning
