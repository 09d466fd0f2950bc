"""Stairs open no storeys: their treads and landings find room on those that there are."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from navbake.baker.bake.pipeline import run_bake
from navbake.baker.core.blocks import Blocks
from navbake.baker.floors.level_assignment import NO_HISTOGRAM_ROWS
from navbake.baker.floors.level_kernels import (
    MOVE_FLOOR,
    MOVE_STAIR,
    SKIP_FLOOR,
    SKIP_STAIR,
    Candidates,
    LevelRule,
    assign_surfaces_to_levels,
    find_largest_areas,
)
from navbake.baker.floors.surface_kernels import Surfaces
from navbake.config.settings import parse_config
from navbake.errors import SceneError
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.navgrid.islands import find_islands
from navbake.navgrid.lattice import Lattice

Grid = SceneGrid2D | MultiLevelGrid
RISE = 3.0


def box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float) -> str:
    pos = f"{(x0 + x1) / 2} {(y0 + y1) / 2} {(z0 + z1) / 2}"
    size = f"{(x1 - x0) / 2} {(y1 - y0) / 2} {(z1 - z0) / 2}"
    return f'<geom type="box" pos="{pos}" size="{size}"/>'


@pytest.fixture
def bake(tmp_path: Path):
    def run(geoms: list[str], **settings: object) -> Grid:
        path = tmp_path / "scene.xml"
        path.write_text(f"<mujoco><worldbody>{''.join(geoms)}</worldbody></mujoco>")
        return run_bake(parse_config({"scene": {"path": str(path)}, **settings})).grid

    return run


def grounds(grid: Grid) -> list[float]:
    return [level.ground for level in grid.levels]


def storeys(number: int, well: tuple[float, float, float, float]) -> list[str]:
    """Slabs of 10 x 8 m, 3 m apart, with a well in all but the lowest, walls and a roof."""
    x0, x1, y0, y1 = well
    geoms = [box(0, 10, 0, 8, -0.2, 0)]
    for k in range(1, number):
        pieces = [(0, 10, 0, y0), (0, x0, y0, y1), (x1, 10, y0, y1), (0, 10, y1, 8)]
        geoms += [box(*piece, RISE * k - 0.2, RISE * k) for piece in pieces if piece[2] < piece[3]]
    top = RISE * number
    walls = [(0, 10, -0.1, 0), (0, 10, 8, 8.1), (-0.1, 0, 0, 8), (10, 10.1, 0, 8)]
    return [*geoms, *(box(*wall, -0.2, top) for wall in walls), box(0, 10, 0, 8, top - 0.2, top)]


def half_landing(z: float, landing: float) -> tuple[list[str], list[tuple[float, float, float]]]:
    """Two flights of open treads and a landing; and x, y, height of each tread."""
    treads = []
    at = []
    for i in range(9):
        for y, height, x in [(1.0, i + 1, 2 + 0.28 * i), (2.2, 17 - i, 2 + 0.28 * i)]:
            top = z + RISE * height / 18
            treads.append(box(x, x + 0.28, y, y + 1.1, top - 0.06, top))
            at.append((x + 0.14, y + 0.55, top))
    end = 2 + 0.28 * 9
    treads.append(box(end, end + landing, 1.0, 3.3, z + RISE / 2 - 0.1, z + RISE / 2))
    return treads, [*at, (end + landing / 2, 2.0, z + RISE / 2)]


def spiral(z: float, turn: float) -> tuple[list[str], list[tuple[float, float, float]]]:
    """Treads round a middle, 18 a storey, over an angle in a storey [degrees].

    The uppermost reaches over the edge of the floor above.
    """
    treads = []
    at = []
    for i in range(18):
        angle = turn * i / 18
        length = 0.8 if i == 17 else 0.6
        radius = 0.3 + length
        x = 4 + radius * math.cos(math.radians(angle))
        y = 3 + radius * math.sin(math.radians(angle))
        top = z + RISE * (i + 1) / 18
        pose = f'pos="{x} {y} {top - 0.03}" euler="0 0 {angle}"'
        treads.append(f'<geom type="box" {pose} size="{length} 0.22 0.03"/>')
        at.append((x, y, top))
    return treads, at


def levels_at(grid: Grid, x: float, y: float, z: float) -> list[int]:
    """The levels whose floor at a position is at a height."""
    levels = []
    for number, level in enumerate(grid.levels):
        row, col = level.lattice.rows_cols([x, y])
        if 0 <= row < level.height and 0 <= col < level.width:
            levels += [number] if abs(level.floor_height[row, col] - z) < 1e-4 else []
    return levels


@pytest.mark.parametrize("number", [2, 3, 5])
@pytest.mark.parametrize("landing", [1.2, 2.0])
def test_half_landings_open_no_storeys(bake, number, landing):
    geoms = storeys(number, (2, 4.52 + landing, 1, 3.3))
    treads = []
    for k in range(number - 1):
        flights, at = half_landing(RISE * k, landing)
        geoms = [*geoms, *flights]
        treads = [*treads, *at]
    grid = bake(geoms)
    assert grounds(grid) == [RISE * k for k in range(number)]
    islands = find_islands(grid)
    for x, y, z in treads:  # every tread and landing is somewhere, once, on the one walk
        [level] = levels_at(grid, x, y, z)
        row, col = grid.levels[level].lattice.rows_cols([x, y])
        assert islands[level][row, col] == 1
    for k, level in enumerate(grid.levels):  # no floor was moved off its level
        row, col = level.lattice.rows_cols([8, 6])
        assert level.floor_height[row, col] == pytest.approx(RISE * k)
        assert islands[k][row, col] == 1


@pytest.mark.parametrize("number", [2, 4])
def test_a_spiral_of_one_turn_a_storey_opens_none(bake, number):
    geoms = storeys(number, (2.5, 5.5, 1.5, 4.5))
    treads = []
    for k in range(number - 1):
        flights, at = spiral(RISE * k, 360)
        geoms = [*geoms, *flights]
        treads = [*treads, *at]
    grid = bake(geoms)
    assert grounds(grid) == [RISE * k for k in range(number)]
    for x, y, z in treads:
        assert len(levels_at(grid, x, y, z)) == 1


def test_a_spiral_of_two_turns_opens_none(bake):
    """Two of its treads lie over each other, and the floor below, which nobody needs there."""
    flights, treads = spiral(0, 720)
    grid = bake([*storeys(2, (2.5, 5.5, 1.5, 4.5)), *flights])
    assert grounds(grid) == [0, 3]
    for x, y, z in treads:
        assert len(levels_at(grid, x, y, z)) == 1


def test_mezzanine_on_a_stair_of_its_own_is_a_level(bake):
    """It is small beside the storeys and lies between them, but its stair ends there."""
    flights, _ = half_landing(0, 1.2)
    geoms = [*storeys(2, (2, 5.72, 1, 3.3)), *flights, box(8, 10, 5, 8, 1.4, 1.5)]
    treads = [box(6.5 + 0.15 * i, 10, 3.8 + 0.12 * i, 5, 0, 0.15 * (i + 1)) for i in range(9)]
    assert grounds(bake([*geoms, *treads])) == [0, 1.5, 3]


@pytest.mark.parametrize("off", [0.003, 0.019, -0.003])
def test_given_ground_takes_in_floors_a_little_below_it(bake, off):
    geoms = storeys(2, (2, 5, 1, 3))
    levels = [{"ground": off}, {"ground": RISE + off, "top": 5.0}]
    grid = bake(geoms, levels=levels)
    assert grounds(grid) == [off, RISE + off]
    assert levels_at(grid, 8, 6, 0.0) == [0] and levels_at(grid, 8, 6, RISE) == [1]


def test_given_ground_too_far_above_a_floor_does_not_take_it_in(bake):
    grid = bake(storeys(2, (2, 5, 1, 3)), levels=[{"ground": 0.0}, {"ground": 2.98, "top": 5.0}])
    assert levels_at(grid, 8, 6, RISE) == [1]
    with pytest.raises(SceneError, match=r"no floor on level 1 \(ground 3.03 m"):
        bake(storeys(2, (2, 5, 1, 3)), levels=[{"ground": 0.0}, {"ground": 3.03, "top": 5.0}])


def test_grounds_are_round(bake):
    """Heights of slabs are sums of floats, as 2.7 + 0.3 + 3.1 - 0.1."""
    slabs = [box(0, 4, 0, 4, z - 0.1, z) for z in (0.1 + 0.2, 2.7 + 0.3 + 1.1 - 0.1)]
    grid = bake([*slabs, box(0, 4, 0, 4, 6.5, 6.6)])
    assert grounds(grid) == [0.3, 4.0]


# ---------------------------------------------------------------- places of a column


def place_slowly(base: list[int], is_stair: list[bool], num_levels: int) -> tuple[int, list[int]]:
    """The least cost over all ways to place a column in order, and one of the ways."""
    best = (10**18, [])
    for choice in itertools.product(range(-1, num_levels), repeat=len(base)):
        placed = [k for k in choice if k >= 0]
        if placed == sorted(set(placed)):
            cost = 0
            for level, wanted, stair in zip(choice, base, is_stair, strict=True):
                move, skip = (MOVE_STAIR, SKIP_STAIR) if stair else (MOVE_FLOOR, SKIP_FLOOR)
                cost += skip if level < 0 else move * abs(level - wanted)
            best = min(best, (cost, list(choice)))
    return best


def cost_of(level: list[int], base: list[int], is_stair: list[bool]) -> int:
    total = 0
    for k, wanted, stair in zip(level, base, is_stair, strict=True):
        move, skip = (MOVE_STAIR, SKIP_STAIR) if stair else (MOVE_FLOOR, SKIP_FLOOR)
        total += skip if k < 0 else move * abs(k - wanted)
    return total


def place(base: list[int], is_stair: list[bool], num_levels: int) -> list[int]:
    """The levels of the surfaces of one column, -1 where all are taken."""
    num = len(base)
    z = np.array(base) + 0.01 * np.arange(num)
    none = np.empty((0, 3), dtype=np.float32)
    ids = np.zeros(num, dtype=np.int32)
    surfaces = Surfaces(
        lattice=Lattice(0.0, 1.0, 1.0, 1, 1),
        first=np.zeros(1, dtype=np.int32),
        end=np.array([num], dtype=np.int32),
        z=z,
        geom=ids,
        flags=np.zeros(num, dtype=np.uint8),
        normal=none,
    )
    candidates = Candidates(
        group_of_surface=ids.astype(np.int8),
        component_of_surface=np.arange(num, dtype=np.int32),
        is_stair=np.array(is_stair),
    )
    level = np.empty(num, dtype=np.int32)
    grounds = np.arange(num_levels, dtype=np.float64)
    Blocks(surfaces.lattice).list_rows(
        assign_surfaces_to_levels,
        NO_HISTOGRAM_ROWS,
        surfaces,
        candidates,
        LevelRule(grounds, tolerance=1e-6, skips_floors=False),
        ids,
        level,
    )
    return np.maximum(level, -1).tolist()


COLUMN = st.integers(1, 4).flatmap(
    lambda num: st.tuples(
        st.lists(st.tuples(st.integers(0, num - 1), st.booleans()), min_size=1, max_size=5).map(
            sorted
        ),
        st.just(num),
    )
)


@given(COLUMN)
def test_places_are_the_best_in_order(column):
    surfaces, num_levels = column
    base = [b for b, _ in surfaces]
    is_stair = [s for _, s in surfaces]
    level = place(base, is_stair, num_levels)
    used = [k for k in level if k >= 0]
    assert len(set(used)) == len(used)
    assert len(used) == min(len(base), num_levels)  # as long as there is room, none is lost
    best, choice = place_slowly(base, is_stair, num_levels)
    if used == sorted(used) and len(used) == len(base):
        # in order, or one was left out of it and happened to come in order
        assert cost_of(level, base, is_stair) == best or -1 in choice
    if is_stair == [True] * len(base) or not any(is_stair):
        assert len(used) < len(base) or cost_of(level, base, is_stair) == best


def test_columns_of_stairwells():
    tread = True
    floor = False
    # floor, then half-landings over each other: each goes one up
    assert place([0, 0, 1, 2], [floor, tread, tread, tread], 4) == [0, 1, 2, 3]
    # a tread between two floors goes to a level that is free, and no floor moves
    assert place([0, 0, 1], [floor, tread, floor], 3) == [0, 2, 1]
    assert place([0, 0, 1], [floor, tread, floor], 2) == [0, -1, 1]
    # of two floors the upper one goes up
    assert place([1, 1], [floor, floor], 3) == [1, 2]
    assert place([0, 0], [floor, floor], 1) == [0, -1]
    # down where only that leaves the floor above alone
    assert place([1, 1, 2], [tread, tread, floor], 3) == [0, 1, 2]


@given(st.integers(2, 8).flatmap(lambda n: st.tuples(
    st.lists(st.tuples(st.integers(0, n - 1), st.integers(0, n - 1)), max_size=12),
    st.lists(st.integers(1, 50), min_size=n, max_size=n),
)))  # fmt: skip
@settings(deadline=None)  # the first one may compile
def test_climbing_stairs_finds_the_largest_floor_above_and_below(graph):
    """Parts are numbered by their heights; each is asked what it leads to, step by step."""
    steps, area = graph
    edges = sorted({(min(a, b), max(a, b)) for a, b in steps if a != b})
    lower, upper = np.array(edges, dtype=np.int64).reshape(-1, 2).T
    above, below = find_largest_areas(
        lower,
        upper,
        np.array(area),
        np.argsort(lower, kind="stable"),
        np.argsort(upper, kind="stable"),
    )

    def reach(part: int, up: bool) -> set[int]:
        steps_onward = edges if up else [(b, a) for a, b in edges]
        following = {b for a, b in steps_onward if a == part}
        return following.union(*(reach(next_part, up) for next_part in following))

    for part in range(len(area)):
        assert above[part] == max([area[upper_part] for upper_part in reach(part, True)], default=0)
        assert below[part] == max(
            [area[lower_part] for lower_part in reach(part, False)], default=0
        )
