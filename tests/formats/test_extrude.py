"""Extruded grids: scenes that bake to the cells that they were made of."""

import warnings
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

import navbake
from grid_maps import house_from, level_from
from map_grids import CELLS, SAMPLES, sample, small
from navbake.errors import FormatError
from navbake.formats.occupancy import lattice_from_corner, level_from_values
from project_paths import SHARED_DATA


def bake_again(grid, path, **options):
    """The grid of the scene that a grid is extruded to."""
    scene, settings_path = grid.to_mjcf(path, **options)
    assert scene == path
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", navbake.BakeWarning)
        return navbake.bake(settings_path)


def check_same(level, back, exact_floors=True):
    assert back.lattice == pytest.approx(level.lattice, abs=1e-6)
    np.testing.assert_array_equal(back.free, level.free)
    occupied = ~level.free
    np.testing.assert_array_equal(back.occupancy != 0, occupied)
    known = ~np.isnan(level.floor)
    # what touches no free cell through cells with a floor has no floor any more
    parts, _ = ndimage.label(known, structure=np.ones((3, 3)))
    reached = np.isin(parts, parts[level.free]) & known
    if not exact_floors:
        assert not (~np.isnan(back.floor) & ~known).any()
        straight, _ = ndimage.label(known)
        reached = np.isin(straight, straight[level.free]) & known
        assert (~np.isnan(back.floor))[reached].all()
        return
    np.testing.assert_array_equal(~np.isnan(back.floor), reached)
    np.testing.assert_allclose(back.floor[reached], level.floor[reached], atol=1e-6)


def levels_of_samples():
    return [(name, k) for name in SAMPLES for k in range(len(sample(name).levels))]


@pytest.mark.parametrize(("name", "number"), levels_of_samples())
def test_each_level_of_the_samples_bakes_to_itself(tmp_path, name, number):
    grid = sample(name)
    check_same(grid.levels[number], bake_again(grid, tmp_path / "a.xml", level=number))


def places(grid):
    """World positions of the free cells, on their floors [0.1 mm]."""
    found = set()
    for level in grid.levels:
        rows, cols = np.nonzero(level.free)
        xyz = np.c_[level.lattice.positions(rows, cols), level.floor[rows, cols]]
        found |= set(map(tuple, np.round(xyz * 1e4).astype(int).tolist()))
    return found


@pytest.mark.parametrize("name", ["clutter", "house", "warehouse"])
def test_several_levels_have_the_same_places_at_the_same_heights(tmp_path, name):
    grid = sample(name)
    back = bake_again(grid, tmp_path / "a.xml")
    assert len(back.levels) == len(grid.levels)
    assert places(back) == places(grid)


@pytest.mark.parametrize("world", ["aws_small_house", "turtlebot3_world"])
def test_maps_of_real_worlds_bake_to_themselves(tmp_path, world):
    path = SHARED_DATA / world / "map.yaml"
    if not path.exists():
        pytest.skip("the real maps are not here")
    level = navbake.from_nav2(path)
    check_same(level, bake_again(level, tmp_path / "a.xml"))


@settings(max_examples=60, deadline=None)
@given(
    CELLS,
    st.sampled_from([0.02, 0.05, 0.1, 0.37, 1.0]),
    st.floats(-900, 900),
    st.floats(-900, 900),
    st.floats(-20, 20),
)
def test_any_map_bakes_to_itself(tmp_path_factory, values, cell, x, y, z):
    if not (values == 0).any():
        values[0, 0] = 0
    level = level_from_values(values, lattice_from_corner(values, x, y, cell), round(z, 3), {})
    folder = tmp_path_factory.mktemp("map")
    check_same(level, bake_again(level, folder / "a.xml"), exact_floors=False)


@pytest.mark.parametrize(
    "text",
    [
        ".",
        "#.",
        ".#.\n#.#\n.#.",  # they touch at corners alone
        ". .\n . \n. .",
        ". #\n   \n# .",
        "12345\n54321\n00000",
        "0 9 0 9\n9 9 0 9\n0#9#0 0",
    ],
)
def test_single_cells_corners_and_steps(tmp_path, text):
    level = level_from(text, cell_size=0.25, x=-40.1, y_max=17.3, ground=-1.5)
    check_same(level, bake_again(level, tmp_path / "a.xml"))


def test_mujoco_loads_it_and_an_agent_stands_where_it_is_free(tmp_path):
    small().to_mjcf(tmp_path / "a.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "a.xml"))
    names = [model.geom(k).name for k in range(model.ngeom)]
    assert {name.split("_")[0] for name in names} == {"floor", "wall"}
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for row in range(3):
        for col in range(5):
            x, y = small().lattice.positions(row, col)
            hit = mujoco.mj_ray(
                model, data, [x, y, 50.0], [0, 0, -1.0], None, 1, -1, np.zeros(1, np.int32), None
            )  # fmt: skip
            top = None if hit < 0 else round(50 - hit, 6)
            floor = small().floor[row, col]
            expected = 0.0 if small().free[row, col] else None if np.isnan(floor) else 2.5
            assert top == expected


def test_flat_floors_lie_at_the_ground_and_take_fewer_boxes(tmp_path):
    level = level_from("01234\n43210", ground=1.0)
    back = bake_again(level, tmp_path / "a.xml", flat=True)
    assert (back.floor == 1.0).all() and back.free.all()
    assert count_boxes(tmp_path / "a.xml") == 1
    level.to_mjcf(tmp_path / "b.xml")
    assert count_boxes(tmp_path / "b.xml") == 9


def count_boxes(path):
    return len(ET.parse(path).findall("./worldbody/geom"))


def test_large_maps_take_few_boxes(tmp_path):
    rooms = np.zeros((1000, 1000), np.int8)
    rooms[::50], rooms[:, ::50] = 100, 100
    rooms[25::50, ::50] = 0
    rng = np.random.default_rng(0)
    for row, col in rng.integers(0, 990, (2000, 2)):
        rooms[row : row + 6, col : col + 9] = 100
    level_from_values(rooms, lattice_from_corner(rooms, 0, 0, 0.05), 0, {}).to_mjcf(
        tmp_path / "a.xml"
    )
    assert count_boxes(tmp_path / "a.xml") < 10_000
    chess = (np.indices((1000, 1000)).sum(axis=0) % 2 * 100).astype(np.int8)
    with pytest.raises(FormatError, match="500,001 boxes, expected 200,000 at most"):
        level_from_values(chess, lattice_from_corner(chess, 0, 0, 0.05), 0, {}).to_mjcf(
            tmp_path / "b.xml"
        )


def test_names_are_escaped(tmp_path):
    level = small()
    level.metadata["sceneId"] = 'a"<&>\x01-->\n'
    level.to_mjcf(tmp_path / "x--y.xml")
    assert ET.parse(tmp_path / "x--y.xml").getroot().get("model") == 'a"<&>-->'
    assert navbake.bake(tmp_path / "x--y.yaml").free.sum() == level.free.sum()
    level.to_mjcf(tmp_path / "x---y----z.xml")
    assert ET.parse(tmp_path / "x---y----z.xml").getroot().tag == "mujoco"


@pytest.mark.parametrize(
    ("options", "culprit"),
    [
        ({"level": 1}, "no level 1: the grid has 1"),
        ({"height": 1.0}, r"higher than the agent \(1.14 m\), got 1 m"),
        ({"height": float("nan")}, "got nan m"),
    ],
)
def test_wrong_options_are_refused(tmp_path, options, culprit):
    with pytest.raises(FormatError, match=culprit):
        small().to_mjcf(tmp_path / "a.xml", **options)
    with pytest.raises(FormatError, match=r"ends in \.xml"):
        small().to_mjcf(tmp_path / "a.mjcf")
    with pytest.raises(FormatError, match="no free cell"):
        level_from("##\n##").to_mjcf(tmp_path / "a.xml")
    with pytest.raises(FormatError, match="ascending grounds"):
        house_from([small(ground=1.0), small()]).to_mjcf(tmp_path / "a.xml")
    with pytest.raises(FormatError, match="on one lattice"):
        house_from([small(), small(ground=3.0, x=0.33)]).to_mjcf(tmp_path / "a.xml")
    assert list(tmp_path.iterdir()) == []
