"""A click finds the cell below the nearest thing that is shown."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import navbake
from navbake.views.viewer.choices import first_choices
from navbake.views.viewer.picking import Ray, pick
from navbake.views.viewer.view import make_exhibit
from viewer_scenes import room_exhibit


@pytest.fixture(scope="module")
def room():
    return room_exhibit()


def down(x, y):
    return Ray.of((x, y, 10), (0, 0, -1))


def pick_in(exhibit, ray, **choices):
    chosen = replace(first_choices(exhibit.grid), cut=None, **choices)
    surfaces = exhibit.surfaces(chosen)
    return pick(exhibit.grid, ray, surfaces, exhibit.carpets, chosen.levels)


def test_the_floor_is_a_cell_and_a_table_is_the_cell_below(room):
    found = pick_in(room, down(-1.03, 1.04))
    assert found.geom is None
    assert found.cell == room.grid.cell_at((-1.03, 1.04))
    np.testing.assert_allclose(found.position, (-1.03, 1.04, 0), atol=1e-6)
    table = pick_in(room, down(1.03, 0.52))
    assert room.drawing(first_choices(room.grid)).names[table.geom] == "table"
    assert table.position[2] == pytest.approx(0)


def test_nothing_is_nothing(room):
    assert pick_in(room, down(50, 50)) is None
    assert pick_in(room, Ray.of((0, 0, 10), (0, 0, 1))) is None


def test_what_is_not_drawn_is_not_clicked(room):
    assert pick_in(room, down(1.03, 0.52), with_scene=False).geom is None


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_clicks_meet_what_mujocos_rays_meet():
    scene = navbake.samples.path("apartment").parent / "scenes" / "apartment.xml"
    model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    exhibit = make_exhibit(navbake.bake(model, grid={"cell_size": 0.2}), model)
    rng = np.random.default_rng(0)
    is_box = model.geom_type == mujoco.mjtGeom.mjGEOM_BOX
    met = 0
    for _ in range(80):
        origin = np.array([*rng.uniform(-4, 4, 2), 6.0])
        direction = np.array([*rng.uniform(-0.5, 0.5, 2), -1.0])
        geom = np.zeros(1, dtype=np.int32)
        mujoco.mj_ray(model, data, origin, direction, None, 1, -1, geom, None)
        found = pick_in(exhibit, Ray.of(origin, direction))
        # floors are met as cells, and round things have corners here
        if geom[0] >= 0 and is_box[geom[0]] and found is not None and found.geom is not None:
            met += 1
            assert found.geom == geom[0]
    assert met > 20


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_of_two_storeys_the_one_below_the_click_counts():
    house = navbake.samples.path("house")
    exhibit = make_exhibit(navbake.bake(house), house)
    grid = exhibit.grid
    upper, lower = grid.levels[1], grid.levels[0]
    floors = np.argwhere((np.abs(upper.floor - upper.ground) < 0.01)[: lower.height, : lower.width])
    row, col = floors[len(floors) // 2]
    x, y = upper.lattice.positions(row, col)
    ray = Ray.of((x, y, upper.ground + 0.5), (0, 0, -1))
    assert pick_in(exhibit, ray).cell.level == 1
    assert pick_in(exhibit, ray, levels=(0,), with_scene=False).cell.level == 0
