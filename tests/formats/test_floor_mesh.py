"""The floor as a mesh: each free cell once, at its height, with few quads."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import navbake
from grid_maps import house_from, level_from
from level_maps import level_of, make_level
from navbake.errors import QueryError
from navbake.formats.floor_mesh import make_floor_mesh
from project_paths import GOLDEN

SAMPLES = ("apartment", "clutter", "house", "terrain", "warehouse")
NOISE = 1e-6  # of float32 heights [m]


def quads_of(mesh, level):
    """First and last row and column of each quad, half-open, and z at given rows and columns."""
    lattice = level.lattice
    for quad in mesh.vertices.reshape(-1, 4, 3):
        col0, col1 = np.rint((quad[[0, 2], 0] - lattice.x_min) / lattice.cell_size).astype(int)
        row1, row0 = np.rint((lattice.y_max - quad[[0, 2], 1]) / lattice.cell_size).astype(int)
        normal = np.cross(quad[1] - quad[0], quad[3] - quad[0])
        assert normal[2] > 0  # it faces up
        assert abs((quad[2] - quad[0]) @ normal) < 1e-9 * normal[2] + 1e-12  # it is flat

        def height(rows, cols, quad=quad, normal=normal):
            x = lattice.x_min + cols * lattice.cell_size - quad[0, 0]
            y = lattice.y_max - rows * lattice.cell_size - quad[0, 1]
            return quad[0, 2] - (normal[0] * x + normal[1] * y) / normal[2]

        yield (row0, row1, col0, col1), height


def check(level, mesh, tolerance=0.001):
    """Covers each free cell once, within the tolerance, and cracks are no wider than steps."""
    covered = np.zeros(level.shape, dtype=int)
    z = np.where(np.isnan(level.floor), level.ground, level.floor)
    edges = np.zeros((*level.shape, 2, 2))  # z of the mesh at each cell's corners
    rise = np.zeros(level.shape)
    for room, ((row0, row1, col0, col1), height) in zip(
        mesh.room, quads_of(mesh, level), strict=True
    ):
        inside = np.s_[row0:row1, col0:col1]
        covered[inside] += 1
        rows, cols = np.mgrid[inside]
        assert np.abs(height(rows + 0.5, cols + 0.5) - z[inside]).max() <= tolerance + NOISE
        corners = [[height(rows + i, cols + j) for j in (0, 1)] for i in (0, 1)]
        edges[inside] = np.moveaxis(np.array(corners), (0, 1), (2, 3))
        rise[inside] = np.abs(corners[0][0] - corners[1][1]).max(initial=0) + np.abs(
            np.array(corners[0][1]) - corners[1][0]
        ).max(initial=0)
        numbers = np.unique(level.room_index[inside])
        assert len(numbers) == 1 and (numbers[0] > 0) == (room > 0)
    np.testing.assert_array_equal(covered, level.free)
    # where two cells meet, the mesh is open by their step, and what quads rise over half a cell
    for one, other, near, far in (
        (np.s_[:, :-1], np.s_[:, 1:], np.s_[..., :, 1], np.s_[..., :, 0]),
        (np.s_[:-1], np.s_[1:], np.s_[..., 1, :], np.s_[..., 0, :]),
    ):
        both = level.free[one] & level.free[other]
        crack = np.abs(edges[one][near] - edges[other][far]).max(axis=-1)
        allowed = np.abs(z[one] - z[other]) + rise[one] + rise[other] + 2 * tolerance + NOISE
        assert (crack[both] <= allowed[both]).all()
    assert mesh.area == pytest.approx(level.free.sum() * level.lattice.cell_size**2)


@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.parametrize("tolerance", [0.001, 0.02, 0.0])
def test_samples(name, tolerance):
    grid = navbake.load(GOLDEN / f"{name}.grid.json.gz")
    mesh = make_floor_mesh(grid, tolerance)
    for level, part in zip(grid.levels, mesh.levels, strict=True):
        check(level, part, tolerance)
    free = sum(int(level.free.sum()) for level in grid.levels)
    assert len(mesh.faces) < 2 * free
    if name != "terrain" and tolerance:
        assert len(mesh.faces) < 0.1 * free
    assert mesh.vertices[mesh.faces].shape == (len(mesh.faces), 3, 3)
    assert mesh.area == pytest.approx(free * grid.levels[0].lattice.cell_size ** 2)


HEIGHTS = arrays(np.float32, (6, 9), elements=st.sampled_from([0.0, 0.0, 0.05, 0.1, 0.2, 1.0]))
SLOPES = st.tuples(*[st.sampled_from([0.0, 0.03, -0.1, 0.2])] * 2)


@settings(deadline=None)
@given(HEIGHTS, SLOPES, arrays(bool, (6, 9)), st.sampled_from([0.0, 0.001, 0.03]))
def test_any_heights(heights, slope, occupied, tolerance):
    rows, cols = np.mgrid[:6, :9]
    level = make_level(occupied, heights + rows * slope[0] + cols * slope[1], col=3, row=-7)
    level.attributes["roomIndex"] = (cols // 4 + rows // 3).astype(np.uint16)
    check(level, make_floor_mesh(level, tolerance).levels[0], tolerance)


def test_a_level_room_is_one_quad_and_rooms_are_apart():
    level = level_of(*["0" * 8] * 5)
    assert len(make_floor_mesh(level).levels[0].room) == 1
    level.attributes["roomIndex"] = np.repeat([[0, 0, 0, 1, 1, 1, 2, 2]], 5, axis=0).astype("u2")
    mesh = make_floor_mesh(level).levels[0]
    assert mesh.room.tolist() == [0, 1, 2]
    assert mesh.rooms == ["no room", "0:1", "0:2"]


def test_stairs_are_level_treads():
    level = level_of(*["000222444666"] * 4)
    mesh = make_floor_mesh(level).levels[0]
    heights = mesh.vertices.reshape(-1, 4, 3)[:, :, 2]
    assert np.allclose(heights, [[0.0] * 4, [0.2] * 4, [0.4] * 4, [0.6] * 4])


@pytest.mark.parametrize("axis", [0, 1])
def test_a_ramp_is_one_slope_up_to_the_steepest(axis):
    rise = np.arange(12) * 0.05
    floor = np.broadcast_to(rise[:, None] if axis == 0 else rise, (12, 12))
    mesh = make_floor_mesh(make_level(np.zeros((12, 12)), floor)).levels[0]
    assert len(mesh.room) == 1
    assert np.ptp(mesh.vertices[:, 2]) == pytest.approx(12 * 0.05)
    steep = make_level(np.zeros((12, 12)), floor * 2.1)  # more than 45 degrees at cells of 0.1 m
    mesh = make_floor_mesh(steep).levels[0]
    assert len(mesh.room) == 12
    assert (np.ptp(mesh.vertices.reshape(-1, 4, 3)[:, :, 2], axis=1) == 0).all()
    steep.metadata = {"navbake": {"maxSlope": 50.0}}
    assert len(make_floor_mesh(steep).levels[0].room) == 1


def test_levels_and_places_without_floor():
    lower = level_from("...#\n....", x=-3.0, y_max=7.0)
    upper = level_from("##\n##", ground=3.0)
    mesh = make_floor_mesh(house_from([lower, upper]))
    assert [level.name for level in mesh.levels] == ["level 0", "level 1"]
    assert [len(level.room) for level in mesh.levels] == [2, 0]
    assert mesh.levels[1].area == 0.0 and mesh.levels[1].rooms == ["no room"]
    assert mesh.levels[0].origin == pytest.approx((-3.0, 7.0, 0.0))
    one = make_floor_mesh(level_from(".", ground=2.0)).levels[0]
    assert np.allclose(one.vertices, [[0, -0.1, 2], [0.1, -0.1, 2], [0.1, 0, 2], [0, 0, 2]])
    # a free cell without a floor of its own lies on the ground
    bare = level_from("..", ground=1.5, floors=False)
    bare.attributes["floorHeight"] = np.array([[np.nan, 1.5]], dtype=np.float32)
    assert len(make_floor_mesh(bare).levels[0].room) == 1


def test_areas_that_bar_all_agents_are_left_open_in_the_mesh_and_in_its_file(tmp_path):
    level = level_from("......\n......")
    level.attributes["area"] = np.array([[0, 1, 1, 2, 0, 3]] * 2, dtype=np.uint8)
    pit = {"name": "pit", "cost": "inf"}
    areas = [pit, {"name": "mud", "cost": 2.0}, {"name": "staff", "agents": ["robot"]}]
    grid = level.with_layers(metadata={"navbake": {"areas": areas}})
    mesh = grid.to_mesh()
    assert mesh.area == pytest.approx(0.08)
    assert not ((mesh.vertices[:, 0] > 0.11) & (mesh.vertices[:, 0] < 0.29)).any()
    grid.convert(tmp_path / "floor.obj", up="z")
    lines = (tmp_path / "floor.obj").read_text().splitlines()
    corners = [line.split()[1:4] for line in lines if line.startswith("v ")]
    assert np.allclose(np.array(corners, dtype=float), mesh.vertices, atol=1e-6)


@pytest.mark.parametrize("tolerance", [-0.1, float("nan"), float("inf"), "1"])
def test_refuses_a_tolerance_that_is_none(tolerance):
    with pytest.raises(QueryError, match="expected a tolerance of 0 m or more, got"):
        level_from(".").to_mesh(tolerance)
