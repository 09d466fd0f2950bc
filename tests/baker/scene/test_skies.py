"""Skies: solids around all else, which can't be entered."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import navbake
from navbake.baker.scene.skies import find_skies

GROUND = '<geom name="ground" type="box" size="5 5 .05" pos="0 0 -.05"/>'
SKIES = {
    "sphere": '<geom name="sky" type="sphere" size="50"/>',
    "box": '<geom name="sky" type="box" size="30 30 30" euler="0 0 30"/>',
    "cylinder": '<geom name="sky" type="cylinder" size="40 20"/>',
    "capsule": '<geom name="sky" type="capsule" size="40 20"/>',
    "ellipsoid": '<geom name="sky" type="ellipsoid" size="40 50 30"/>',
}


def posed(geoms):
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data


def names_of_skies(geoms, min_room=1.14):
    model, data = posed(geoms)
    counted = np.ones(model.ngeom, dtype=np.bool_)
    return [model.geom(geom).name for geom in find_skies(model, data, counted, min_room)]


@pytest.mark.parametrize("kind", SKIES)
def test_every_kind_of_solid_may_be_a_sky(kind):
    assert names_of_skies(GROUND + SKIES[kind]) == ["sky"]


def test_skies_lie_in_each_other():
    outer = '<geom name="outer" type="sphere" size="90"/>'
    assert names_of_skies(GROUND + SKIES["sphere"] + outer) == ["outer", "sky"]


@pytest.mark.parametrize(
    "geoms",
    [
        GROUND,  # nothing around it
        GROUND + '<geom type="sphere" size="6"/>',  # the corners of the ground stick out
        GROUND + '<geom type="box" size="9 9 9" pos="5 0 0"/>',  # its side sticks out
        GROUND + '<geom type="box" size="6 6 .5"/>',  # nobody has room in it
        SKIES["box"],  # alone, it may be anything
    ],
)
def test_what_is_no_sky(geoms):
    assert names_of_skies(geoms) == []


def test_a_sky_is_left_out_and_told():
    spec = mujoco.MjSpec.from_string(
        f"<mujoco><worldbody>{GROUND}{SKIES['sphere']}</worldbody></mujoco>"
    )
    with pytest.warns(navbake.BakeWarning, match="sky"):
        grid = navbake.bake(spec)
    assert grid.free.all()
    assert grid.free.size == 100 * 100


@pytest.mark.parametrize(
    "hidden", ['type="box" size=".5 .5 .5" pos="0 0 .5"', 'type="sphere" size=".05"']
)
@pytest.mark.parametrize("ground", ["", '<geom type="plane" size="0 0 1"/>'])
def test_a_thing_with_something_hidden_in_it_is_no_sky(hidden, ground):
    xml = f'<geom name="tank" type="box" size="3 3 1.5" pos="0 0 1.5"/><geom {hidden}/>{ground}'
    spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{xml}</worldbody></mujoco>")
    grid = navbake.bake(spec, grid={"bounds": [-4, -4, 4, 4]})
    assert not [text for text in grid.warnings if "under a sky" in text]
    assert grid.levels[0].at((0.05, 0.05, 3.0)).floor == pytest.approx(3.0)  # its top


def test_a_sky_that_leaves_no_floor_is_in_the_error():
    """A solid room of boxes: without it, only its furniture is left."""
    walls = "".join(
        f'<geom type="box" size=".05 2 1" pos="{x} 0 1"/><geom type="box" size="2 .05 1" '
        f'pos="0 {x} 1"/>' for x in (-2, 2)
    )  # fmt: skip
    room = '<geom name="room" type="box" size="3 3 3" pos="0 0 2"/>'
    spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{walls}{room}</worldbody></mujoco>")
    with pytest.raises(navbake.SceneError, match=r"no floor.* as under a sky: 'room'"):
        navbake.bake(spec)
