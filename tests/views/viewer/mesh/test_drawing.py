"""A drawing has the volumes and places of the model's geoms, by MuJoCo's own measures."""

import mujoco
import numpy as np
import pytest
import trimesh

from navbake.views.viewer.mesh.drawing import draw_scene
from navbake.views.viewer.mesh.primitives import BOX, shape_of
from viewer_scenes import room_exhibit

SHAPES = {
    "box": ("0.2 0.3 0.4", 8 * 0.2 * 0.3 * 0.4, 1e-6),
    "sphere": ("0.3", 4 / 3 * np.pi * 0.3**3, 0.06),
    "capsule": ("0.2 0.5", np.pi * 0.2**2 * (1.0 + 4 / 3 * 0.2), 0.04),
    "cylinder": ("0.2 0.5", np.pi * 0.2**2 * 1.0, 0.03),
    "ellipsoid": ("0.2 0.3 0.4", 4 / 3 * np.pi * 0.2 * 0.3 * 0.4, 0.06),
}


class Loaded:
    """A model in its pose, as a loaded scene has it."""

    def __init__(self, xml):
        self.model = mujoco.MjModel.from_xml_string(xml)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, self.data)
        self.parts = {}


def draw(geoms, assets=""):
    return draw_scene(
        Loaded(f"<mujoco><asset>{assets}</asset><worldbody>{geoms}</worldbody></mujoco>")
    )


def as_mesh(drawing):
    return trimesh.util.concatenate(
        [trimesh.Trimesh(one.vertices, one.faces, process=False) for one in drawing.surfaces]
    )


@pytest.mark.parametrize("kind", SHAPES)
def test_a_shape_has_its_volume_and_faces_out(kind):
    size, volume, share = SHAPES[kind]
    drawing = draw(f'<geom type="{kind}" size="{size}" pos="1 2 3" euler="30 40 50"/>')
    mesh = as_mesh(drawing)
    mesh.merge_vertices()
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(volume, rel=share)
    np.testing.assert_allclose(mesh.center_mass, [1, 2, 3], atol=1e-6)


def test_a_mesh_is_where_mujoco_has_it():
    wedge = '<mesh name="w" vertex="0 0 0 1 0 0 0 2 0 0 0 3"/>'
    mesh = as_mesh(draw('<geom type="mesh" mesh="w" pos="5 0 0" euler="0 0 90"/>', wedge))
    np.testing.assert_allclose(mesh.bounds, [[3, 0, 0], [5, 1, 3]], atol=1e-6)


def test_a_height_field_is_as_high_as_it_says():
    field = '<hfield name="f" nrow="2" ncol="3" size="2 1 4 .1" elevation="0 0 0 0 0 1"/>'
    geom = '<geom type="hfield" hfield="f" pos="0 0 1"/>'
    mesh = as_mesh(draw(geom, field))
    np.testing.assert_allclose(mesh.bounds, [[-2, -1, 1], [2, 1, 5]], atol=1e-6)
    loaded = Loaded(f"<mujoco><asset>{field}</asset><worldbody>{geom}</worldbody></mujoco>")
    found = np.zeros(1, dtype=np.int32)
    for x, y, z in mesh.vertices:
        origin, down = np.array([0.999 * x, 0.999 * y, 9.0]), np.array([0.0, 0.0, -1.0])
        far = mujoco.mj_ray(loaded.model, loaded.data, origin, down, None, 1, -1, found, None)
        assert z == pytest.approx(9 - far, abs=0.05)


def test_an_endless_plane_reaches_beyond_all_else():
    box = '<geom type="box" size="1 1 1" pos="10 0 1"/>'
    plane = as_mesh(draw(box + '<geom type="plane" size="0 2 1" pos="0 0 0"/>'))
    low, high = plane.bounds
    assert low[0] < 9 and high[0] > 11
    np.testing.assert_allclose([low[1], high[1]], [-2, 2], atol=1e-6)


def test_what_is_hidden_is_drawn_when_asked_for():
    exhibit = room_exhibit()
    drawing = draw_scene(exhibit.scene)
    geoms = set(np.concatenate([one.geom for one in drawing.surfaces]).tolist())
    assert drawing.names == ("floor", "wall", "shown", "hidden", "table")
    assert drawing.has_hidden
    assert geoms == {0, 1, 2, 4}
    more = draw_scene(exhibit.scene, with_hidden=True)
    assert 3 in np.concatenate([one.geom for one in more.surfaces])
    fewer = draw_scene(exhibit.scene, removed={1})
    assert 1 not in np.concatenate([one.geom for one in fewer.surfaces])


def test_colors_are_the_materials_unless_the_geom_states_its_own():
    wood = '<material name="wood" rgba="1 0 0 1"/>'
    geoms = '<geom type="box" size="1 1 1" material="wood"/>'
    geoms += '<geom type="box" size="1 1 1" material="wood" rgba="0 1 0 1"/>'
    geoms += '<geom type="box" size="1 1 1" rgba="0 0 1 .5"/>'
    geoms += '<geom type="box" size="1 1 1" rgba="1 1 1 0"/>'
    drawing = draw(geoms, wood)
    found = {
        int(geom): tuple(one.colors[face[0]].round(3).tolist())
        for one in drawing.surfaces
        for geom, face in zip(one.geom, one.faces, strict=True)
    }
    assert found == {0: (1, 0, 0, 1), 1: (0, 1, 0, 1), 2: (0, 0, 1, 0.5)}
    assert len(drawing.surfaces) == 2  # what shines through is drawn by itself


def test_textures_lie_on_meshes_that_have_a_place_for_them():
    assets = '<texture name="t" type="2d" builtin="checker" rgb1="1 1 1" rgb2="0 0 0"'
    assets += ' width="8" height="8"/>'
    assets += '<material name="m" texture="t"/>'
    assets += (
        '<mesh name="w" vertex="0 0 0 1 0 0 0 1 0 0 0 1" texcoord="0 0 1 0 0 1 1 1"'
        ' face="0 2 1 0 1 3 1 2 3 0 3 2"/>'
    )
    drawing = draw('<geom type="mesh" mesh="w" material="m"/>', assets)
    (surface,) = drawing.surfaces
    assert surface.texture == 0 and surface.uv is not None
    assert drawing.textures[0].shape == (8, 8, 3)
    # other shapes have the texture's mean
    (box,) = draw('<geom type="box" size="1 1 1" material="m"/>', assets).surfaces
    assert box.texture == -1
    assert 0.1 < box.colors[0, 0] < 0.5


def test_a_shape_is_placed_as_often_as_asked():
    shape, sizes, halves = shape_of(BOX, np.array([[1.0, 1, 1], [2, 1, 1]]))
    turns = np.stack([np.eye(3)] * 2)
    placed = shape.place(sizes, halves, turns, np.array([[0.0, 0, 0], [5, 0, 0]]))
    np.testing.assert_allclose(placed[1].min(axis=0), [3, -1, -1])


def test_many_round_geoms_are_drawn_coarser():
    ball = '<geom type="sphere" size=".1" pos="{} 0 0"/>'
    one, many = (draw("".join(ball.format(k) for k in range(count))) for count in (1, 600))
    assert len(many.surfaces[0].faces) < 600 * len(one.surfaces[0].faces) / 4
