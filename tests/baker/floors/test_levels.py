"""Levels and floors of small scenes whose storeys one can tell by heart."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from navbake.baker.bake.pipeline import run_bake
from navbake.baker.bake.warnings import ROW_SAMPLING_STEP
from navbake.config.settings import parse_config
from navbake.errors import SceneError
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.navgrid.islands import find_islands

Grid = SceneGrid2D | MultiLevelGrid


def box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float, more: str = "") -> str:
    pos = f"{(x0 + x1) / 2} {(y0 + y1) / 2} {(z0 + z1) / 2}"
    size = f"{(x1 - x0) / 2} {(y1 - y0) / 2} {(z1 - z0) / 2}"
    return f'<geom type="box" pos="{pos}" size="{size}" {more}/>'


def ramp(x0: float, x1: float, y0: float, y1: float, rise: float, start: float = 0.0) -> list[str]:
    """A plate whose upper side runs straight from `start` at x0 to `start + rise` at x1."""
    length = math.hypot(x1 - x0, rise)
    angle = math.atan2(rise, x1 - x0)
    thick = 0.05
    x = (x0 + x1) / 2 + thick * math.sin(angle)
    z = start + rise / 2 - thick * math.cos(angle)
    size = f"{length / 2} {(y1 - y0) / 2} {thick}"
    pos = f"{x} {(y0 + y1) / 2} {z}"
    turn = f'euler="0 {-math.degrees(angle)} 0"'
    return [f'<geom type="box" pos="{pos}" size="{size}" {turn}/>']


def walls(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float, door: bool) -> list:
    """Four walls 0.1 m thick; a door 1 m wide and 2 m high in the one at x1."""
    t = 0.1
    middle = (y0 + y1) / 2
    sides = [
        box(x0, x1, y0, y0 + t, z0, z1),
        box(x0, x1, y1 - t, y1, z0, z1),
        box(x0, x0 + t, y0 + t, y1 - t, z0, z1),
    ]
    if not door:
        return [*sides, box(x1 - t, x1, y0 + t, y1 - t, z0, z1)]
    return [
        *sides,
        box(x1 - t, x1, y0 + t, middle - 0.5, z0, z1),
        box(x1 - t, x1, middle + 0.5, y1 - t, z0, z1),
        box(x1 - t, x1, middle - 0.5, middle + 0.5, z0 + 2, z1),
    ]


def slab_with_well(z: float) -> list[str]:
    """A floor over 10 x 8 m at height z, with a stairwell at x 1 to 5, y 1 to 2."""
    pieces = [(0, 10, 0, 1), (0, 1, 1, 2), (5, 10, 1, 2), (0, 10, 2, 8)]
    return [box(*piece, z - 0.3, z) for piece in pieces]


FLOOR = box(0, 10, 0, 8, -0.2, 0)
PLANE = '<geom type="plane" size="0 0 1" pos="0 0 {}"/>'
ROOF = box(-0.3, 10.3, -0.3, 8.3, 2.5, 2.7)


@pytest.fixture
def bake(tmp_path: Path):
    def run(geoms: list[str], **settings: object) -> Grid:
        path = tmp_path / "scene.xml"
        path.write_text(f"<mujoco><worldbody>{''.join(geoms)}</worldbody></mujoco>")
        return run_bake(parse_config({"scene": {"path": str(path)}, **settings})).grid

    return run


def grounds(grid: Grid) -> list[float]:
    return [round(level.ground, 6) for level in grid.levels]


def floor_at(grid: Grid, level: int, x: float, y: float) -> float:
    row, col = grid.levels[level].lattice.rows_cols([x, y])
    return float(grid.levels[level].floor_height[row, col])


def island_at(grid: Grid, level: int, x: float, y: float) -> int:
    row, col = grid.levels[level].lattice.rows_cols([x, y])
    return int(find_islands(grid)[level][row, col])


def floor_area(grid: Grid, level: int) -> float:
    part = grid.levels[level]
    return float(np.isfinite(part.floor_height).sum()) * part.cell_size**2


def test_flat_floor_is_one_level_over_the_whole_lattice(bake):
    grid = bake([FLOOR])
    assert isinstance(grid, SceneGrid2D)
    assert grid.shape == (80, 100)
    assert grid.free.all() and (grid.floor_height == 0).all()


def test_roof_is_no_level(bake):
    grid = bake([FLOOR, *walls(0, 10, 0, 8, 0, 2.5, door=True), ROOF])
    assert grounds(grid) == [0]


def test_roof_is_a_level_when_asked_for(bake):
    scene = [FLOOR, *walls(0, 10, 0, 8, 0, 2.5, door=True), ROOF]
    assert grounds(bake(scene, floors={"roofs": True})) == [0, 2.7]


def test_roof_over_a_house_on_open_ground_is_no_level(bake):
    house = [PLANE.format(-0.1), FLOOR, *walls(0, 10, 0, 8, 0, 2.5, door=True), ROOF]
    grid = bake(house, grid={"bounds": [-5, -5, 15, 13]})
    assert grounds(grid) == [-0.1]
    assert island_at(grid, 0, -3, -3) == island_at(grid, 0, 5, 4) > 0  # through the door


def test_top_of_what_stands_on_a_floor_is_furniture_however_large(bake):
    scene = [FLOOR, box(2, 6, 2, 6, 0, 3)]
    grid = bake(scene)
    assert grounds(grid) == [0]
    assert floor_at(grid, 0, 4, 4) == 0
    row, col = grid.lattice.rows_cols([4, 4])
    assert grid.occupancy[row, col] == 1
    with_tops = bake(scene, floors={"tops": True})
    assert floor_at(with_tops, 0, 4, 4) == 3


def test_bed_in_a_corner_is_furniture(bake):
    bed = [box(0.1, 1.8, 0.1, 2.1, 0.2, 0.55), box(0.1, 1.8, 0.1, 0.2, 0, 0.2)]
    grid = bake([FLOOR, *walls(0, 10, 0, 8, 0, 2.5, door=True), *bed])
    assert floor_at(grid, 0, 1, 1) == 0
    row, col = grid.lattice.rows_cols([1, 1])
    assert grid.occupancy[row, col] == 1


def test_bed_upstairs_is_furniture_over_a_frame(bake):
    """Its frame is wider than the mattress, and one can stand on the storey below."""
    upstairs = [box(0, 10, 0, 8, 2.7, 3), *walls(0, 10, 0, 8, 3, 5.7, door=False)]
    bed = [box(0.2, 2.0, 0.2, 2.4, 3.2, 3.32), box(0.3, 1.9, 0.3, 2.3, 3.32, 3.55)]
    legs = [box(x, x + 0.1, y, y + 0.1, 3, 3.2) for x in (0.2, 1.9) for y in (0.2, 2.3)]
    lower = [FLOOR, *walls(0, 10, 0, 8, 0, 2.7, door=True)]
    grid = bake([*lower, *upstairs, box(0, 10, 0, 8, 5.7, 5.9), *bed, *legs])
    assert grounds(grid) == [0, 3]
    assert floor_at(grid, 1, 1.1, 1.1) == 3


def test_house_on_a_plinth_keeps_its_floor(bake):
    """No step leads up to it, and the ground goes on under it, but it ends at its walls."""
    house = [box(0, 10, 0, 8, -0.1, 0), *walls(0, 10, 0, 8, 0, 2.5, door=True)]
    grid = bake([PLANE.format(-0.4), *house], grid={"bounds": [-8, -8, 18, 16]})
    assert floor_at(grid, 0, 5, 4) == 0
    assert island_at(grid, 0, 5, 4) != island_at(grid, 0, -3, -3) > 0


def test_walls_as_thick_as_rooms_are_no_floor(bake):
    """Mazes are made of blocks whose tops are wide."""
    blocks = [box(x, x + 2, y, y + 2, 0, h) for x, y, h in [(0, 0, 0.4), (2, 0, 0.4), (4, 2, 2)]]
    grid = bake([PLANE.format(0), *blocks, box(-2, 8, 6, 8, 0, 0.4)])
    for x, y in [(1, 1), (3, 1), (5, 3), (3, 7)]:
        row, col = grid.lattice.rows_cols([x, y])
        assert grid.occupancy[row, col] == 1, (x, y)
        assert grid.floor_height[row, col] == 0, (x, y)


def test_low_bump_blocks_nothing(bake):
    """Its sides are steeper than a slope, but what is lower than a step is no obstacle."""
    bump = '<geom type="box" size="0.05 0.6 0.05" euler="0 60 0" pos="5 4 0"/>'
    assert bake([FLOOR, bump]).free.all()


def test_two_storeys_joined_by_nothing(bake):
    lower = [FLOOR, *walls(0, 10, 0, 8, 0, 2.7, door=True)]
    upper = [box(0, 10, 0, 8, 2.7, 3), *walls(0, 10, 0, 8, 3, 5.7, door=False)]
    grid = bake([*lower, *upper, box(0, 10, 0, 8, 5.7, 5.9)])
    assert grounds(grid) == [0, 3]
    assert len(grid.steps) == 0
    assert floor_area(grid, 0) == pytest.approx(80) == floor_area(grid, 1)


RISE = 3.0 / 17


@pytest.mark.parametrize("storeys", [2, 3, 4])
@pytest.mark.parametrize("spacing", [0.5, 0.55])
def test_storeys_are_levels_although_none_is_wide_over_a_wide_place(bake, storeys, spacing):
    """Only stairs may take the place of narrow floors; another storey may not.

    A storey has a wide place at one end, where that above has rows of posts, and posts elsewhere.
    """
    heights = [round(2.7 * storey, 6) for storey in range(storeys)]
    geoms = [box(0, 8, 0, 3, 2.7 * storeys - 0.2, 2.7 * storeys)]
    for storey, z in enumerate(heights):
        geoms.append(box(0, 8, 0, 3, z - 0.2, z))
        first_x = 0.2 if storey % 2 else 2.2
        for x in np.arange(first_x, first_x + 5.6, spacing):
            for y in np.arange(0.2, 2.9, spacing):
                geoms.append(box(x, x + 0.1, y, y + 0.1, z, z + 1.4))
    grid = bake(geoms, agent={"radius": 0.05})
    assert grounds(grid) == heights


def test_a_floor_under_a_stair_and_its_landing_together_is_a_level(bake):
    """Under the stair or under the landing alone, what is left of it would be too small."""
    treads = [(1 + 0.25 * step, 0.15 * (step + 1)) for step in range(17)]
    stair = [box(x, x + 0.25, 0, 1, z - 0.05, z) for x, z in treads]
    landing = box(5.25, 6.55, 0, 1, 2.65, 2.7)
    grid = bake([box(0, 8, 0, 4, -0.2, 0), *stair, landing])
    assert len(grid.levels) == 2
    assert (grid.levels[0].attributes["floorHeight"][30:, 50:65] == 0).all()
    assert not [warning for warning in grid.warnings if "left out" in warning]


def test_part_of_a_storey_that_lies_a_little_lower_belongs_to_it(bake):
    """A terrace beside the house, 10 cm lower than the upper storey, and with nothing below it."""
    lower = [box(0, 10, 0, 8, -0.1, 0), *walls(0, 10, 0, 8, 0, 2.7, door=True)]
    upper = [box(0, 10, 0, 8, 2.7, 3.0), box(10, 13, 0, 8, 2.6, 2.9), box(0, 13, 0, 8, 5.7, 5.9)]
    grid = bake([*lower, *upper])
    assert grounds(grid) == [0, 2.9]
    assert floor_at(grid, 1, 12, 4) == pytest.approx(2.9)
    assert floor_at(grid, 1, 5, 4) == pytest.approx(3.0)


def storeys_with_stair(closed: bool) -> list[str]:
    steps = []
    for i in range(16):
        top = RISE * (i + 1)
        bottom = 0.0 if closed else top - 0.04
        steps.append(box(1 + 0.25 * i, 1.25 + 0.25 * i, 1, 2, bottom, top))
    shell = walls(0, 10, 0, 8, 0, 2.7, door=True) + walls(0, 10, 0, 8, 3, 5.7, door=False)
    return [FLOOR, *shell, *slab_with_well(3.0), box(0, 10, 0, 8, 5.7, 5.9), *steps]


@pytest.mark.parametrize("closed", [True, False], ids=["closed", "open treads"])
def test_stair_joins_two_storeys(bake, closed):
    grid = bake(storeys_with_stair(closed))
    assert grounds(grid) == [0, 3]
    assert len(grid.steps) > 0
    assert island_at(grid, 0, 8, 6) == island_at(grid, 1, 8, 6) > 0
    # every tread is somewhere, once
    for i in range(16):
        heights = [floor_at(grid, k, 1.12 + 0.25 * i, 1.55) for k in (0, 1)]
        assert sum(np.isclose(h, RISE * (i + 1), atol=1e-6) for h in heights) == 1, i


def test_closed_stair_belongs_to_the_level_it_rises_from(bake):
    grid = bake(storeys_with_stair(closed=True))
    for i in range(16):
        assert floor_at(grid, 0, 1.12 + 0.25 * i, 1.55) == pytest.approx(RISE * (i + 1))
        assert math.isnan(floor_at(grid, 1, 1.12 + 0.25 * i, 1.55))


def test_tread_over_a_floor_goes_up_into_the_stairwell(bake):
    grid = bake(storeys_with_stair(closed=False))
    high = 1 + 0.25 * 10.5  # tread 10: 1.94 m, one stands below it
    assert floor_at(grid, 0, high, 1.55) == 0
    assert floor_at(grid, 1, high, 1.55) == pytest.approx(RISE * 11)


def test_links_join_neighbours_a_step_apart(bake):
    grid = bake(storeys_with_stair(closed=False))
    step = 0.25 + 1e-6
    for level_a, cell_a, level_b, cell_b in grid.step_array.tolist():
        assert level_a < level_b
        a = grid.levels[level_a]
        b = grid.levels[level_b]
        spot_a = a.lattice.positions(*divmod(cell_a, a.width))
        spot_b = b.lattice.positions(*divmod(cell_b, b.width))
        assert np.abs(spot_a - spot_b).sum() == pytest.approx(0.1)
        height_a = a.floor_height.flat[cell_a]
        height_b = b.floor_height.flat[cell_b]
        assert abs(height_a - height_b) <= step


def test_spiral_stair_is_one_walk_and_loses_no_tread(bake):
    treads = []
    for i in range(36):
        turn = math.radians(20 * i)
        x = 5 + 0.9 * math.cos(turn)
        y = 4 + 0.9 * math.sin(turn)
        pos = f"{x} {y} {0.167 * (i + 1) - 0.03}"
        angle = f'euler="0 0 {20 * i}"'
        treads.append(f'<geom type="box" pos="{pos}" size="0.6 0.25 0.03" {angle}/>')
    grid = bake([FLOOR, *treads])
    assert len(grid.levels) >= 3  # two full turns over each other, and the floor
    for i in range(36):
        turn = math.radians(20 * i)
        x = 5 + 0.9 * math.cos(turn)
        y = 4 + 0.9 * math.sin(turn)
        on = [k for k, level in enumerate(grid.levels) if _holds(level, x, y, 0.167 * (i + 1))]
        assert len(on) == 1, i
        assert island_at(grid, on[0], x, y) == island_at(grid, 0, 1, 1), i


def _holds(level: SceneGrid2D, x: float, y: float, z: float) -> bool:
    row, col = level.lattice.rows_cols([x, y])
    if not (0 <= row < level.height and 0 <= col < level.width):
        return False
    return abs(level.floor_height[row, col] - z) < 1e-5


def test_ramp_up_to_a_mezzanine(bake):
    scene = [FLOOR, box(5.9, 10, 0, 8, 2.8, 3.0), *ramp(0, 6, 3.4, 4.6, 3.0)]
    grid = bake(scene)
    assert grounds(grid) == [0, 3]
    assert floor_at(grid, 0, 8, 6) == 0 and floor_at(grid, 1, 8, 6) == 3
    assert island_at(grid, 0, 8, 6) == island_at(grid, 1, 8, 6) > 0


def test_ramp_steeper_than_the_slope_is_no_floor(bake):
    scene = [FLOOR, *ramp(2, 4, 3, 5, 2.4)]
    gentle = bake(scene, agent={"max_slope": 51})
    assert floor_at(gentle, 0, 2.55, 4) == pytest.approx(0.66, abs=0.01)
    steep = bake(scene, agent={"max_slope": 49})
    assert floor_at(steep, 0, 2.55, 4) == 0  # the floor goes on below


def test_half_storeys_beside_each_other_make_two_levels(bake):
    scene = [
        box(0, 5, 0, 8, -0.2, 0),
        box(5, 10, 0, 8, 1.2, 1.4),
        box(0, 5, 0, 8, 2.6, 2.8),
        box(5, 10, 0, 8, 4, 4.2),
    ]
    grid = bake(scene, floors={"roofs": True})
    assert grounds(grid) == [0, 2.8]
    assert floor_at(grid, 0, 7, 4) == pytest.approx(1.4)
    assert floor_at(grid, 1, 7, 4) == pytest.approx(4.2)


def test_bridge_lies_over_the_ground_that_its_ramps_rise_from(bake):
    ground = box(-10, 20, 0, 10, -0.2, 0)
    ramps = ramp(-3, 3.05, 4, 5.5, 2.4) + ramp(6.95, 13, 4, 5.5, -2.4, start=2.4)
    grid = bake([ground, box(3, 7, 4, 5.5, 2.2, 2.4), *ramps])
    assert floor_at(grid, 0, 5, 4.75) == 0
    assert grounds(grid)[1] == pytest.approx(2.4)
    assert floor_at(grid, 1, 5, 4.75) == pytest.approx(2.4)
    assert island_at(grid, 0, 5, 4.75) == island_at(grid, 1, 5, 4.75) > 0


def test_basement_is_the_lowest_level(bake):
    grid = bake([box(0, 4, 0, 8, -2.7, -2.5), FLOOR])
    assert grounds(grid) == [-2.5, 0]


def test_several_buildings_of_different_height_share_levels(bake):
    ground = box(0, 30, 0, 10, -0.2, 0)
    first = [box(2, 8, 2, 8, 2.8, 3.0), box(2, 8, 2, 8, 5.8, 6.0)]
    second = [box(20, 26, 2, 8, 3.2, 3.4)]
    grid = bake([ground, *first, *second], floors={"roofs": True})
    assert grounds(grid) == [0, 3, 6]
    assert floor_at(grid, 1, 23, 5) == pytest.approx(3.4)


def test_hill_without_anything_over_it_is_one_level(bake, tmp_path):
    size = 10.0
    rows = 41
    y, x = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : rows * 1j]
    heights = np.exp(-4 * (x**2 + y**2))
    values = " ".join(f"{h:.5f}" for h in heights.ravel())
    field = f'<hfield name="h" nrow="{rows}" ncol="{rows}" size="{size} {size} 3 1" '
    path = tmp_path / "hill.xml"
    path.write_text(
        f'<mujoco><asset>{field} elevation="{values}"/></asset>'
        '<worldbody><geom type="hfield" hfield="h"/></worldbody></mujoco>'
    )
    config = parse_config({"scene": {"path": str(path)}})
    grid = run_bake(config).grid
    assert isinstance(grid, SceneGrid2D)
    assert np.nanmax(grid.floor_height) == pytest.approx(3, abs=0.02)


def test_table_is_furniture_and_the_floor_goes_on_under_it(bake):
    top = box(3, 4.4, 3, 4.4, 0.7, 0.75)
    legs = [box(x, x + 0.05, y, y + 0.05, 0, 0.7) for x in (3, 4.35) for y in (3, 4.35)]
    grid = bake([FLOOR, top, *legs])
    row, col = grid.lattice.rows_cols([3.7, 3.7])
    assert grid.floor_height[row, col] == 0
    assert grid.occupancy[row, col] == 1 and not grid.free[row, col]


def test_region_counts_when_it_is_large_enough(bake):
    """1.6 m square shrinks by 0.3 m to 1 m²."""
    tops = {"tops": True}
    large = bake([FLOOR, box(3, 4.6, 3, 4.6, 0, 0.8)], floors=tops)
    assert floor_at(large, 0, 3.8, 3.8) == pytest.approx(0.8)
    small = bake([FLOOR, box(3, 4.5, 3, 4.6, 0, 0.8)], floors=tops)
    assert floor_at(small, 0, 3.8, 3.8) == 0
    settable = bake([FLOOR, box(3, 4.5, 3, 4.6, 0, 0.8)], floors={**tops, "min_area": 0.5})
    assert floor_at(settable, 0, 3.8, 3.8) == pytest.approx(0.8)


def test_kerb_and_rug_belong_to_the_floor(bake):
    grid = bake([FLOOR, box(2, 3, 2, 3, 0, 0.25), box(5, 6, 5, 6, 0, 0.01)])
    assert floor_at(grid, 0, 2.5, 2.5) == pytest.approx(0.25)
    assert floor_at(grid, 0, 5.5, 5.5) == pytest.approx(0.01)
    assert grid.free.all()


def test_no_floor_beside_the_slab(bake):
    grid = bake([FLOOR, box(12, 12.5, 3, 3.5, 0, 1)])
    assert math.isnan(floor_at(grid, 0, 11, 4))
    row, col = grid.lattice.rows_cols([11, 4])
    assert grid.occupancy[row, col] == 1 and math.isinf(grid.weights[row, col])


def test_boxes_of_levels_do_not_overlap_in_height(bake):
    grid = bake(storeys_with_stair(closed=False))
    (low0, high0), (low1, high1) = [
        (level.bbox_yup[0][1], level.bbox_yup[1][1]) for level in grid.levels
    ]
    lowest = np.nanmin(grid.levels[1].floor_height)
    assert low0 == pytest.approx(-0.001) and low1 == pytest.approx(lowest - 0.001, abs=1e-6)
    assert high0 < low1 == pytest.approx(high0, abs=2e-6) and high1 >= 5.9 - 1e-9


@pytest.mark.parametrize(("width", "ground"), [(1.0, 0.0), (1.4, 0.1)])
def test_ground_is_the_commonest_height_of_the_floor_that_is_left_after_shrinking(
    bake, width, ground
):
    """The long walk has more floor than the room, but where it is narrow, less of it is left."""
    room = box(0, 4, 0, 4, -0.2, 0)
    walk = box(5, 25, 0, width, -0.2, 0.1)
    assert grounds(bake([room, walk])) == [ground]


def test_given_levels(bake):
    scene = [FLOOR, box(0, 10, 0, 8, 2.7, 3), box(0, 10, 0, 8, 5.7, 6)]
    levels = [{"ground": 0.0, "name": "ground floor"}, {"ground": 3.0, "top": 5.0}]
    grid = bake(scene, levels=levels)
    assert grounds(grid) == [0, 3]
    names = [level["name"] for level in grid.metadata["navbake"]["levels"]]
    assert names == ["ground floor", "level 1"]


def test_given_level_keeps_what_lies_between_ground_and_top(bake):
    scene = [FLOOR, box(0, 10, 0, 8, 2.7, 3)]
    grid = bake(scene, levels=[{"ground": -0.1, "top": 1.0}])
    assert isinstance(grid, SceneGrid2D)
    assert grid.min_yup[1] == pytest.approx(-0.1)
    assert (grid.floor_height == 0).all()


def test_given_level_outside_the_scene_is_refused(bake):
    with pytest.raises(SceneError, match=r"level 'attic' .*30 m"):
        bake([FLOOR], levels=[{"ground": 0.0}, {"ground": 30.0, "name": "attic"}])


def test_tells_of_large_tops_that_are_no_floors(tmp_path):
    """A dock that nothing leads to is named; a bed isn't."""
    pieces = [box(-10, 10, -10, 10, -0.2, 0), box(-1, 1, -6, -4, 0, 0.6, 'name="bed"')]
    pieces.append(box(-5, 5, 3, 7, 0, 1.2, 'name="dock"'))
    path = tmp_path / "yard.xml"
    path.write_text(f"<mujoco><worldbody>{''.join(pieces)}</worldbody></mujoco>")
    settings = {"scene": {"path": str(path)}}
    [warning] = run_bake(parse_config(settings)).warnings
    assert "'dock' (40.0 m² at 1.20 m)" in warning and "bed" not in warning
    settings["floors"] = {"tops": True}
    [warning] = run_bake(parse_config(settings)).warnings
    assert "no step leads to 40.0 m² of 'level 0'" in warning


def test_no_two_levels_are_called_the_same(tmp_path):
    """A given name that looks like a number's doesn't take another level's."""
    path = tmp_path / "tower.xml"
    slabs = "".join(box(0, 4, 0, 4, z - 0.2, z) for z in (0, 3, 6))
    path.write_text(f"<mujoco><worldbody>{slabs}</worldbody></mujoco>")
    levels = [{"ground": 0.0, "name": "level 1"}, {"ground": 3.0}, {"ground": 6.0}]
    grid = run_bake(parse_config({"scene": {"path": str(path)}, "levels": levels})).grid
    names = [level["name"] for level in grid.navbake["levels"]]
    assert names == ["level 1", "level 1'", "level 2"]


def test_tells_of_an_endless_ground_that_the_grid_hides(tmp_path):
    path = tmp_path / "plinth.xml"
    plane = '<geom name="ground" type="plane" size="0 0 1"/>'
    path.write_text(f"<mujoco><worldbody>{plane}{box(-2, 2, -2, 2, 0, 0.8)}</worldbody></mujoco>")
    settings = {"scene": {"path": str(path)}}
    [warning] = run_bake(parse_config(settings)).warnings
    assert "'ground' is endless" in warning and "the ground at 0.00 m" in warning
    result = run_bake(parse_config({**settings, "grid": {"margin": 2.0}}))
    assert result.grid.levels[0].ground == 0.0
    assert not any("endless" in warning for warning in result.warnings)


def test_a_pit_as_deep_as_the_endless_ground_shows_it(tmp_path):
    """Its floor is found in rows that the first look at floors leaves out."""
    path = tmp_path / "pit.xml"
    plane = '<geom name="ground" type="plane" size="0 0 1"/>'
    parts = (-7, 7, -7, 1), (-7, 7, 5, 7), (-7, -2, 1, 5), (2, 7, 1, 5)
    plinth = "".join(box(*part, 0, 0.3) for part in parts)
    path.write_text(f"<mujoco><worldbody>{plane}{plinth}</worldbody></mujoco>")
    result = run_bake(parse_config({"scene": {"path": str(path)}}))
    floors = [level.floor for level in result.grid.levels]
    assert min(np.nanmin(floor) for floor in floors) == 0.0
    assert min(np.nanmin(floor[::ROW_SAMPLING_STEP]) for floor in floors) > 0.25
    assert not any("endless" in warning for warning in result.warnings)
