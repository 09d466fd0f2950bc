"""Cracks between slabs: a storey stays one floor, wherever cells fall, and real gaps stay gaps."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from floor_scenes import boards
from navbake.baker.bake.stages import bake_stages
from navbake.baker.columns.columns import Columns, cast_columns
from navbake.baker.columns.seams import close_cracks, resolve_seams

GROUND = '<geom type="plane" size="4 4 .1"/>'
HEIGHT = 3.0  # of the slabs' upper sides


def slab(x0: float, x1: float, y0: float, y1: float, z: float = HEIGHT, turn: float = 0.0) -> str:
    """A slab 0.2 m thick; x and y are turned round the origin."""
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    cos, sin = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    pos = f"{x * cos - y * sin!r} {x * sin + y * cos!r} {z - 0.1!r}"
    size = f"{(x1 - x0) / 2!r} {(y1 - y0) / 2!r} .1"
    return f'<geom type="box" size="{size}" pos="{pos}" euler="0 0 {turn!r}"/>'


def two_slabs(width: float, at: float = 0.0, turn: float = 0.0, step: float = 0.0) -> str:
    """Two slabs beside each other, and a crack of a width between them whose middle is at x."""
    return slab(-3, at - width / 2, -2, 2, turn=turn) + slab(
        at + width / 2, 3, -2, 2, HEIGHT + step, turn
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("cracks")


def stages_of(folder: Path, geoms: str, cell: float = 0.1, agent: dict | None = None, **floors):
    path = folder / "scene.xml"
    path.write_text(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>")
    bounds = {"bounds": [-2.5, -1.5, 2.5, 1.5], "cell_size": cell}
    scene = {"scene": {"path": str(path)}, "agent": agent or {}}
    return bake_stages({**scene, "grid": bounds, "floors": floors})


def heights(columns: Columns, z: float = HEIGHT, tolerance: float = 0.3) -> np.ndarray:
    """The height of each cell's storey, NaN for none."""
    out = np.full(columns.lattice.shape, np.nan)
    near = abs(columns.z - z) <= tolerance
    near &= columns.normal[:, 2] > 0
    cell = np.repeat(np.arange(out.size), np.diff(columns.start))
    out.flat[cell[near]] = columns.z[near]
    return out


@pytest.mark.parametrize("cell", [0.1, 0.02, 0.01])
def test_crack_over_cells_centres_is_closed(folder, cell):
    geoms = two_slabs(0.025, at=cell / 2)
    open_cells = np.isnan(heights(cast_columns(stages_of(folder, geoms, cell).shape_source)))
    assert open_cells.any()
    assert not np.isnan(heights(stages_of(folder, geoms, cell).columns)).any()


@pytest.mark.parametrize(
    ("width", "at", "closed"),
    [
        (0.059, 0.05, True),
        (0.061, 0.05, False),
        (0.04, 0.041, True),
        (0.04, 0.039, False),
    ],
)
def test_as_near_on_both_sides_as_is_said(folder, width, at, closed):
    columns = stages_of(folder, GROUND + two_slabs(width, at)).columns
    assert np.isnan(heights(columns)).any() == (not closed)
    wider = stages_of(folder, GROUND + two_slabs(width, at), crack=0.04).columns
    assert not np.isnan(heights(wider)).any()


def test_none_are_closed_where_that_is_asked_for(folder):
    columns = stages_of(folder, GROUND + two_slabs(0.005, at=0.05), crack=0).columns
    assert np.isnan(heights(columns)).any(axis=0).sum() == 1


def test_the_storey_is_one_floor_and_the_ground_below_stays(folder):
    # cut off by the bounds, the storey has no walls
    stages = stages_of(folder, GROUND + two_slabs(0.005, at=0.05), roofs=True)
    ground, storey = stages.floors.levels
    assert (storey.floor == HEIGHT).all()
    assert (ground.floor == 0).all()
    assert storey.standable.all()
    assert ground.standable.all()


@pytest.mark.parametrize("step", [0.2, -0.2])
def test_cell_over_a_crack_has_the_lower_floor(folder, step):
    stages = stages_of(folder, GROUND + two_slabs(0.01, at=0.05, step=step))
    floor = heights(stages.columns)
    col = int(stages.lattice.rows_cols([0.05, 0.0])[1])
    assert floor[:, col] == pytest.approx(min(HEIGHT, HEIGHT + step))


@pytest.mark.parametrize(("cell", "center"), [(0.04, 0.0), (0.1, 0.05)])
@pytest.mark.parametrize("beside", [0.009, 0.014, 0.02])
def test_what_is_buried_under_a_wall_beside_the_line_is_no_side(folder, cell, center, beside):
    """A thin wall on the lower slab, flush with the crack; what it stands in is occupied."""
    start, end = center - beside, center - beside + 0.028
    wall = f'<geom type="box" size=".01 2 1" pos="{end + 0.01} 0 {HEIGHT + 0.9}"/>'
    geoms = GROUND + two_slabs(0.028, at=(start + end) / 2, step=-0.001) + wall
    stages = stages_of(folder, geoms, cell, roofs=True, agent={"radius": 0.0})
    col = int(stages.lattice.rows_cols([center, 0.0])[1])
    assert np.isnan(heights(stages.columns)[:, col]).all()
    assert stages.occupancy.levels[-1][:, col].all()


def test_floor_goes_on_under_a_wall_across_a_crack(folder):
    wall = f'<geom type="box" size="1 .2 1" pos="0 0 {HEIGHT + 1}"/>'
    stages = stages_of(folder, GROUND + two_slabs(0.02, at=0.05) + wall, roofs=True)
    assert (stages.floors.levels[-1].floor == HEIGHT).all()


def test_sides_under_walls_are_none(folder):
    wall = '<geom type="box" size=".01 2 1" pos="{} 0 {}"/>'
    walls = wall.format(0.031, 4) + wall.format(0.069, 3.6)  # to 1 mm beyond the crack's edges
    stages = stages_of(folder, GROUND + two_slabs(0.02, at=0.05) + walls, 0.1)
    assert stages.columns.z.size == cast_columns(stages.shape_source).z.size


def test_two_floors_more_than_a_step_apart_have_no_crack(folder):
    geoms = GROUND + two_slabs(0.01, at=0.05, step=0.3)
    stages = stages_of(folder, geoms)
    assert stages.columns.hits.z.size == cast_columns(stages.shape_source).z.size


def test_crossing_of_two_cracks(folder):
    half, geoms = 0.01, GROUND
    for x in ((-3, 0.05 - half), (0.05 + half, 3)):
        for y in ((-2, 0.05 - half), (0.05 + half, 2)):
            geoms += slab(*x, *y)
    assert not np.isnan(heights(stages_of(folder, geoms).columns)).any()


def test_cracks_over_each_other(folder):
    geoms = GROUND + two_slabs(0.01, at=0.05)
    upper = geoms + slab(-3, 0.045, -2, 2, 6.0) + slab(0.055, 3, -2, 2, 6.0)
    columns = stages_of(folder, upper).columns
    assert not np.isnan(heights(columns)).any()
    assert not np.isnan(heights(columns, 6.0)).any()


@pytest.mark.parametrize(
    ("lower", "upper"),
    [(0.032, 0.032), (0.068, 0.068), (0.05, 0.032), (0.068, 0.05), (0.06, 0.068)],
)
def test_cracks_over_each_other_need_not_be_plumb(folder, lower, upper):
    """Three storeys' joints, some aside by up to the width of one: a line is moved past all."""
    joints = [(HEIGHT, lower), (2 * HEIGHT, upper), (3 * HEIGHT, 0.05)]
    geoms = [
        part
        for z, at in joints
        for part in (slab(-3, at - 0.014, -2, 2, z), slab(at + 0.014, 3, -2, 2, z))
    ]
    columns = stages_of(folder, GROUND + "".join(geoms), roofs=True).columns
    for z, _ in joints:
        assert not np.isnan(heights(columns, z)).any()


def test_what_stands_in_a_crack_blocks_it(folder):
    wall = '<geom type="box" size=".002 2 1.5" pos=".05 0 3"/>'
    stages = stages_of(folder, GROUND + two_slabs(0.01, at=0.05) + wall, roofs=True)
    col = int(stages.lattice.rows_cols([0.05, 0.0])[1])
    assert stages.occupancy.levels[-1][:, col].all()


def test_a_drain_is_no_gap_and_a_shaft_is_one(folder):
    """A hole is as wide as its shorter side: 2 cm for the drain."""
    for size, closed in ((0.02, True), (0.1, False)):
        low, high = 0.05 - size / 2, 0.05 + size / 2
        around = slab(-3, low, -2, 2) + slab(high, 3, -2, 2)
        geoms = GROUND + around + slab(low, high, -2, -0.2) + slab(low, high, 0.2, 2)
        assert np.isnan(heights(stages_of(folder, geoms).columns)).any() == (not closed)


@pytest.mark.parametrize("near", [0.0, 0.002, 0.004])
def test_inner_corner_is_no_crack(folder, near):
    """Beside its apex, tops of walls are near in opposite directions; the floor below stays."""
    low = 0.05 - near
    walls = f"""
        <geom type="box" size="1 .1 1" pos="{low + 1} {low - 0.1} 1"/>
        <geom type="box" size=".1 1 1" pos="{low - 0.1} {low + 0.8} 1"/>"""
    stages = stages_of(folder, GROUND + walls)
    lines = resolve_seams(cast_columns(stages.shape_source), stages.shape_source)
    assert stages.columns.z.size == lines.z.size


def test_scene_without_cracks_keeps_its_columns(folder):
    geoms = GROUND + slab(-2, 2, -1, 1) + '<geom type="box" size=".05 1 1" pos="0 0 1"/>'
    stages = stages_of(folder, geoms)
    columns = cast_columns(stages.shape_source)
    assert close_cracks(columns, stages.shape_source, stages.config.agent, 0.03) is columns


@pytest.mark.parametrize("x", np.linspace(0.0, 0.1, 4))
def test_ground_round_a_rock_is_no_crack(folder, x):
    """A slope, and a rock on it whose top is a step higher than the slope at its rim."""
    slope = '<geom type="box" size="3 3 .1" euler="0 12 0"/>'
    rock = f'<geom type="ellipsoid" size=".35 .35 .3" pos="{x} 0 .15"/>'
    stages = stages_of(folder, slope + rock)
    columns = cast_columns(stages.shape_source)
    assert close_cracks(columns, stages.shape_source, stages.config.agent, 0.03) is columns


@given(
    width=st.floats(0.001, 0.029),
    at=st.floats(-0.1, 0.1),
    turn=st.floats(0, 180, allow_subnormal=False),  # MuJoCo 3 reads none
)
@settings(max_examples=25, deadline=None)
def test_crack_at_any_angle(folder, width, at, turn):
    """Whichever way it runs, and wherever the cells' centres are."""
    stages = stages_of(folder, GROUND + two_slabs(width, at, turn))
    # the middle of the scene, which the slabs cover whichever way they are turned
    x, y = np.meshgrid(stages.lattice.center_x(), stages.lattice.center_y())
    floor = heights(stages.columns)[np.hypot(x, y) < 1.4]
    assert (abs(floor - HEIGHT) < 1e-6).all()


@pytest.mark.parametrize("turn", [0, 30, 45])
@pytest.mark.parametrize("cell", [0.05, 0.08, 0.1, 0.13])
@pytest.mark.parametrize(
    ("board", "gap", "crack"),
    [(0.03, 0.025, 0.03), (0.09, 0.01, 0.03), (0.12, 0.005, 0.03), (0.01, 0.04, 0.05)],
)
def test_boards_and_gratings_are_floors(folder, board, gap, crack, cell, turn):
    """At any width and any step of the grid; the slab half a metre below is no floor there."""
    path = folder / "scene.xml"
    path.write_text(boards(board, gap, turn))
    grid = {"bounds": [-2.5, -1.5, 2.5, 1.5], "cell_size": cell}
    stages = bake_stages({"scene": {"path": str(path)}, "grid": grid, "floors": {"crack": crack}})
    (level,) = stages.floors.levels
    inside = np.hypot(*np.meshgrid(stages.lattice.center_x(), stages.lattice.center_y())) < 1.4
    assert (level.floor[inside] == 0.0).all()
    assert not stages.occupancy.levels[0][inside].any()


def test_closing_a_tilted_deck_leaves_other_storeys_as_they_are(folder):
    """To the last bit, above and below, where cracks of one storey are closed."""
    path, columns = folder / "scene.xml", []
    path.write_text(boards(0.09, 0.01, turn=17.0, tilt=1.0, storeys=2))
    for crack in (0.0, 0.03):
        scene = {"scene": {"path": str(path)}, "floors": {"crack": crack}}
        columns.append(bake_stages(scene).columns)
    was, now = (
        [set(one.z[one.start[n] : one.start[n + 1]].tolist()) for n in range(len(one.start) - 1)]
        for one in columns
    )
    assert all(before <= after for before, after in zip(was, now, strict=True))
    assert sum(len(after) > len(before) for before, after in zip(was, now, strict=True)) > 100


@pytest.mark.parametrize("kind", ["capsule", "cylinder"])
def test_round_bars(folder, kind):
    """With a radius of 1 cm, 3 cm apart from axis to axis."""
    bar = '<geom type="{}" size=".01 2" pos="{} 0 2.99" euler="90 0 0"/>'
    geoms = "".join(bar.format(kind, 0.03 * k) for k in range(-100, 101))
    floor = heights(stages_of(folder, GROUND + geoms, 0.013).columns, 2.99, 0.011)
    assert not np.isnan(floor).any()


def tilted(edge_x: float, edge_z: float, side: int, slope: float = 0.4) -> str:
    """A thin slab that falls to the east, with the end of its upper side in the east or west."""
    turn, half = math.atan(slope), 0.01
    along, up = (math.cos(turn), -math.sin(turn)), (math.sin(turn), math.cos(turn))
    x, z = (e - side * a - half * u for e, a, u in zip((edge_x, edge_z), along, up, strict=True))
    return f'<geom type="box" size="1 2 {half}" pos="{x} 0 {z}" euler="0 {math.degrees(turn)} 0"/>'


@pytest.mark.parametrize(("rise", "closed"), [(0.22, True), (0.28, False)])
def test_slopes_whose_edges_are_more_than_a_step_apart_have_no_crack(folder, rise, closed):
    """Heights are those at the edges."""
    geoms = GROUND + tilted(0.045, HEIGHT, 1) + tilted(0.055, HEIGHT + rise, -1)
    stages = stages_of(folder, geoms)
    added = len(stages.columns.z) - len(cast_columns(stages.shape_source).z)
    assert added == (stages.lattice.height if closed else 0)
