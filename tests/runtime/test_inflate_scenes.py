"""Discs at all free centres of baked scenes, against the scenes' exact geometry."""

from __future__ import annotations

import tempfile
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import navbake
from navbake.navgrid.grid import MultiLevelGrid
from navbake.navgrid.islands import find_islands
from oracles.prisms import OCCUPIED, Prisms
from oracles.scene import Thing, cross_part, part_meets_prisms, part_of, scene_xml
from project_paths import ROOT

FOLDER = tempfile.TemporaryDirectory()
STEP, HEIGHT = 0.25, 1.14
GOLDEN = ROOT / "tests" / "golden"


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers of nine digits: MuJoCo 3 reads none that are as small as floats can be."""
    return st.floats(low, high).map(lambda number: round(number, 9))


LENGTHS = numbers(0.03, 0.5)
PLACES = st.tuples(numbers(-1.4, 1.4), numbers(-1.4, 1.4))
FLOOR = Thing("box", (1.6, 1.6, 0.1), (0.0, 0.0, -0.1))


@st.composite
def things(draw) -> Thing:
    """Something that stands, lies or hangs anywhere over the floor, turned as it likes."""
    kind = draw(st.sampled_from(["box", "sphere", "cylinder", "capsule", "ellipsoid"]))
    num = {"box": 3, "sphere": 1, "ellipsoid": 3}.get(kind, 2)
    size = tuple(draw(LENGTHS) for _ in range(num))
    quat = draw(st.tuples(*[numbers(-1, 1)] * 4))
    norm = float(np.linalg.norm(quat))
    quat = tuple(q / norm for q in quat) if norm > 0.1 else (1.0, 0.0, 0.0, 0.0)
    return Thing(kind, size, (*draw(PLACES), draw(numbers(0.0, 1.6))), quat)


@st.composite
def platforms(draw) -> Thing:
    """An upright box too high to step on, large enough to stand on."""
    half = draw(st.floats(0.15, 0.6))
    size = draw(st.floats(0.85, 1.2)), draw(st.floats(0.85, 1.2)), half
    return Thing("box", size, (*draw(PLACES), half))


def hits(scene: list[Thing], grid: navbake.SceneGrid2D | MultiLevelGrid, radius: float) -> list:
    """The free cells at which a disc of the agent's body meets a thing."""
    found = []
    for level in grid.levels:
        row, col = np.nonzero(level.free)
        x, y = level.lattice.positions(row, col).T
        floor = level.floor_height[row, col].astype(np.float64)
        margin = 1e-5  # float32 floors
        disc = Prisms(x, y, floor + STEP + margin, floor + HEIGHT - margin, radius - 1e-6, True)
        for thing in scene:
            part = part_of(thing)
            state = part_meets_prisms(part, cross_part(part, x, y), disc)
            found += [(thing, x[i], y[i], floor[i]) for i in np.flatnonzero(state == OCCUPIED)]
    return found


def bake(scene: list[Thing], cell: float, radius: float = 0.05):
    path = Path(FOLDER.name) / "scene.xml"
    path.write_text(scene_xml(scene))
    settings = {
        "scene": {"path": str(path)},
        "grid": {"cell_size": cell},
        "agent": {"radius": radius},
        "names": {"enabled": False},
        "floors": {"tops": True},
    }
    return navbake.bake(settings)


def has_low_bumps(grid) -> bool:
    """Whether floors lie a little over each other, so that bodies start at several heights."""
    for level in grid.levels:
        floor = np.unique(level.floor_height[~np.isnan(level.floor_height)])
        if (np.diff(floor) < 2 * STEP).any() and np.ptp(floor) > 1e-4:
            return True
    return False


@settings(max_examples=30, deadline=None)
@given(
    st.lists(things(), min_size=1, max_size=4),
    st.sampled_from([0.1, 0.16]),
    st.floats(0.02, 0.6),
)
def test_a_disc_on_any_free_cell_hits_nothing(scene, cell, radius):
    scene = [FLOOR, *scene]
    grid = bake(scene, cell)
    if not has_low_bumps(grid):
        inflated = grid.inflate(radius)
        assert not hits(scene, inflated, radius)
        if radius > 0.05:
            native = bake(scene, cell, radius)
            for own, other in zip(inflated.levels, native.levels, strict=True):
                assert (own.free <= other.free).all()


@settings(max_examples=20, deadline=None)
@given(
    st.lists(platforms(), min_size=1, max_size=2),
    st.sampled_from([0.16, 0.23]),
    st.floats(0.05, 0.6),
)
def test_a_disc_below_a_platform_does_not_hit_its_sides(scene, cell, radius):
    scene = [Thing("box", (2.3, 2.3, 0.1), (0.0, 0.0, -0.1)), *scene]
    grid = bake(scene, cell)
    if not has_low_bumps(grid):
        assert not hits(scene, grid.inflate(radius), radius)


@pytest.mark.parametrize("radius", [0.1, 0.2, 0.22])
def test_the_house_stays_one_over_its_stairs(radius):
    house = navbake.load(GOLDEN / "house.grid.json.gz")
    inflated = house.inflate(radius)
    below, above = find_islands(inflated)
    assert any((below == k).sum() > 300 and (above == k).sum() > 300 for k in (1, 2, 3))


def slab(x_min: float, x_max: float, y_min: float, y_max: float, thickness: float, top: float):
    """A box that lies flat, by its edges and its top [m]."""
    size = ((x_max - x_min) / 2, (y_max - y_min) / 2, thickness / 2)
    return Thing("box", size, ((x_min + x_max) / 2, (y_min + y_max) / 2, top - thickness / 2))


def open_stairs(num_storeys: int, thickness: float) -> list[Thing]:
    """Storeys with a straight flight from each to the next, of thin treads, all over each other."""
    storey_height, num_treads, tread = 3.0, 15, 0.3
    first, last = 1.2, 1.2 + (num_treads - 1) * tread
    end = last + 1.2
    scene = [slab(0.0, end, 0.0, 2.4, 0.2, 0.0)]
    for storey in range(1, num_storeys):
        z = storey * storey_height
        for k in range(1, num_treads):
            top = z - storey_height + k * storey_height / num_treads
            x = first + (k - 1) * tread
            scene.append(slab(x, x + tread, 0.0, 1.2, thickness, top))
        scene.append(slab(0.0, end, 1.2, 2.4, 0.2, z))
        scene.append(slab(last, end, 0.0, 1.2, 0.2, z))
        scene.append(slab(0.0, first, 0.0, 1.2, 0.2, z))
    return scene


def dog_leg_stairs(num_storeys: int, thickness: float) -> list[Thing]:
    """Storeys with two flights and a landing from each to the next, all over each other."""
    storey_height, num_treads, tread = 3.0, 8, 0.28
    first, last = 1.4, 1.4 + num_treads * tread
    rise = storey_height / (2 * num_treads)
    scene = [slab(0.0, last + 1.2, 0.0, 3.4, 0.2, 0.0)]
    for storey in range(1, num_storeys):
        z = (storey - 1) * storey_height
        for k in range(num_treads):
            x = first + k * tread
            scene.append(slab(x, x + tread, 0.0, 1.1, thickness, z + (k + 1) * rise))
        middle = z + num_treads * rise
        scene.append(slab(last, last + 1.2, 0.0, 2.2, 0.15, middle))
        for k in range(num_treads - 1):
            x = last - k * tread
            scene.append(slab(x - tread, x, 1.1, 2.2, thickness, middle + (k + 1) * rise))
        scene.append(slab(0.0, last + 1.2, 2.2, 3.4, 0.2, z + storey_height))
        scene.append(slab(0.0, first + tread, 0.0, 2.2, 0.2, z + storey_height))
    return scene


@pytest.mark.parametrize("num_storeys", [2, 3, 4])
@pytest.mark.parametrize(
    ("make_stairs", "y", "max_radius"), [(open_stairs, 1.8, 0.35), (dog_leg_stairs, 2.8, 0.25)]
)
def test_open_stairs_over_each_other_are_open_in_any_number_of_storeys(
    make_stairs, y, max_radius, num_storeys
):
    scene = make_stairs(num_storeys, 0.05)
    grid = bake(scene, 0.1)
    assert len(grid.levels) == num_storeys
    start, goal = (0.7, y, 0.0), (0.7, y, (num_storeys - 1) * 3.0)
    passage = navbake.PathFinder(grid).max_radius(start, goal)
    assert passage.radius == pytest.approx(max_radius, abs=1e-6)
    for radius in (0.1, 0.2):
        inflated = grid.inflate(radius)
        assert navbake.PathFinder(inflated).find_path(start, goal) is not None
        assert not hits(scene, inflated, radius)


UPPER_FLOOR = """
<geom name="upper" type="box" size="1.0 1.5 0.1" pos="1.0 0 2.5"/>
"""
GROUND_FLOOR = """
<mujoco><worldbody>
  <geom name="floor" type="box" size="2 1.5 0.1" pos="0 0 -0.1"/>
  <geom name="wall" type="box" size="0.1 0.75 0.5" pos="0.5 -0.75 0.5"/>
  <geom name="shelf" type="box" size="0.4 0.1 0.5" pos="-1.6 1.4 0.5"/>
  {upper}
</worldbody></mujoco>
"""


def export_ground(folder, upper: str) -> tuple[np.ndarray, bytes, int]:
    """Inflate a ground floor, and write it as nav2's map; also how many levels the grid has."""
    (folder / "scene.xml").write_text(GROUND_FLOOR.format(upper=upper))
    grid = navbake.bake(folder / "scene.xml", floors={"reach": "all", "roofs": True})
    inflated = grid.inflate(0.3)
    grid.to_nav2(folder / "map.yaml", level=0, radius=0.3)
    return inflated.levels[0].free, (folder / "map.pgm").read_bytes(), len(grid.levels)


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_a_floor_ends_alike_whether_there_is_a_storey_over_it_or_not(tmp_path):
    free_alone, map_alone, num_levels_alone = export_ground(tmp_path, "")
    free_below, map_below, num_levels = export_ground(tmp_path, UPPER_FLOOR)
    assert (num_levels_alone, num_levels) == (1, 2)
    np.testing.assert_array_equal(free_below, free_alone)
    assert map_below == map_alone
    # nothing is known beyond the grid, so its edge does not block
    assert free_below[-1, :10].all()
    assert free_below[10:15, 0].all()
    assert not free_below[0].all()  # the shelf


WALLS_BESIDE_FLOORS = """
<mujoco><worldbody>
  <geom name="floor" type="box" size="2 1.5 0.1" pos="0 0 -0.1"/>
  <geom name="slab" type="box" size="{slab_x} 1.5 0.1" pos="{slab_pos} 0 2.9"/>
  <geom name="south" type="box" size="2.1 0.05 3" pos="0 -1.55 3"/>
  <geom name="north" type="box" size="2.1 0.05 3" pos="0 1.55 3"/>
  <geom name="west" type="box" size="0.05 1.6 3" pos="-2.05 0 3"/>
  <geom name="east" type="box" size="0.05 1.6 3" pos="2.05 0 3"/>
</worldbody></mujoco>
"""


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
@pytest.mark.parametrize("cell_size", [0.05, 0.1, 0.17])
@pytest.mark.parametrize(("slab_x", "slab_pos"), [(2.0, 0.0), (1.0, -1.0)])
def test_outer_walls_beside_the_floors_of_storeys_keep_larger_agents_away(
    tmp_path, cell_size, slab_x, slab_pos
):
    """No floor lies under the walls: each level is cropped to the cells that have one."""
    path = tmp_path / "scene.xml"
    path.write_text(WALLS_BESIDE_FLOORS.format(slab_x=slab_x, slab_pos=slab_pos))
    grid = navbake.bake(path, grid={"cell_size": cell_size}, floors={"reach": "all"})
    assert len(grid.levels) == 2
    wide = navbake.bake(
        path, grid={"cell_size": cell_size}, floors={"reach": "all"}, agent={"radius": 0.3}
    )
    for level, wide_level in zip(grid.inflate(0.3).levels, wide.levels, strict=True):
        row, col = np.nonzero(level.free)
        x, y = level.lattice.positions(row, col).T
        assert len(x) and np.abs(x).max() < 1.7 + 1e-6 and np.abs(y).max() < 1.2 + 1e-6
        # the wide bake lets the agent hang over the edge of the slab, the inflated grid does not
        assert (level.free <= wide_level.free).all()
        if slab_x == 2.0 and cell_size != 0.17:  # whose cells end at the walls' faces
            np.testing.assert_array_equal(level.free, wide_level.free)


@pytest.mark.parametrize(("name", "keyframe"), [("house", "doors_open"), ("apartment", None)])
def test_a_body_on_free_cells_of_the_samples_touches_nothing(name, keyframe):
    radius, step = 0.25, 0.25
    grid = navbake.load(GOLDEN / f"{name}.grid.json.gz")
    half = (grid.metadata["agentHeight"] - step) / 2
    spec = mujoco.MjSpec.from_file(str(ROOT / "configs" / "scenes" / f"{name}.xml"))
    body = spec.worldbody.add_body(name="agent", mocap=True)
    size = [radius - 1e-4, half - 1e-4, 0]
    body.add_geom(name="agent", type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=size)
    model = spec.compile()
    data = mujoco.MjData(model)
    if keyframe:
        mujoco.mj_resetDataKeyframe(model, data, model.key(keyframe).id)
    agent = model.geom("agent").id
    collides = (model.geom_contype | model.geom_conaffinity) != 0
    for level in grid.inflate(radius).levels:
        row, col = np.nonzero(level.free)
        floor = level.floor_height[row, col]
        order = np.random.default_rng(0).permutation(len(row))
        on_stairs = order[np.abs(floor - np.median(floor))[order] > 0.06]
        for k in [*on_stairs[:150], *order[:150]]:
            x, y = level.lattice.positions(row[k], col[k])
            data.mocap_pos[0] = x, y, floor[k] + step + half
            mujoco.mj_kinematics(model, data)
            away = np.linalg.norm(data.geom_xpos - data.geom_xpos[agent], axis=1)
            is_near = (away < model.geom_rbound + radius + half) | (model.geom_rbound == 0)
            for geom in np.flatnonzero(collides & is_near):
                if geom != agent:
                    away_by = mujoco.mj_geomDistance(model, data, agent, geom, 0.01, None)
                    assert away_by > -1e-4, (model.geom(geom).name, x, y, floor[k])
