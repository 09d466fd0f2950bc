"""A drawing has the volumes and places of the model's geoms; cut, what a plain clipper leaves."""

import io
from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np
import pytest
import trimesh
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from navbake.views.viewer import meshes
from navbake.views.viewer.meshes import Drawing, Surface, coarsen, cut_drawing, draw_scene
from navbake.views.viewer.view_state import ViewState, first_choices
from viewer_scenes import room_view_state

# whole millimetres or so: a corner is in the plane of a cut or clearly beside it
HEIGHTS = st.integers(-3072, 3072).map(lambda n: n / 1024)
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
        self.exact_meshes = {}


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


def test_meshes_that_look_alike_are_sent_once_where_mujoco_has_them(monkeypatch):
    """Those across the cut, of another colour, tilted or few are sent as triangles."""
    monkeypatch.setattr(meshes, "MAX_MESH_TRIANGLES", 20)  # some have to be drawn coarser
    asset = '<mesh name="w" vertex="0 0 0 1 0 0 0 2 0 0 0 3"/>'
    geom = '<geom type="mesh" mesh="w" pos="{} 0 {}" euler="{} 0 {}" rgba="{} 0 0 1"/>'.format
    alike = [geom(3 * n, 0.1 * n, 0, 40 * n, 1) for n in range(6)]
    others = [geom(20, 0, 30, 0, 1), *[geom(30, 0, 0, 0, 0.5)] * 3]
    geoms = "".join([*alike, *others])
    scene = Loaded(f"<mujoco><asset>{asset}</asset><worldbody>{geoms}</worldbody></mujoco>")
    drawing = draw_scene(scene)
    (batch,) = drawing.batches
    assert batch.geoms.tolist() == [*range(6)] and [share for _, share in batch.lod] == [0.5, 0.5]
    sent = trimesh.load(io.BytesIO(batch.content), file_type="glb", force="mesh", process=False)
    exact = np.concatenate([one.vertices[one.faces].reshape(-1, 3) for one in drawing.surfaces])
    owners = np.concatenate([np.repeat(one.face_geoms, 3) for one in drawing.surfaces])
    for geom, turn, place in zip(batch.geoms, batch.rotations, batch.positions, strict=True):
        placed = sent.vertices @ trimesh.transformations.quaternion_matrix(turn)[:3, :3].T + place
        np.testing.assert_allclose(
            np.unique(placed.round(4), axis=0), np.unique(exact[owners == geom].round(4), axis=0),
            atol=2e-4,
        )  # fmt: skip
    lowest = [exact[owners == geom, 2].max() for geom in batch.geoms]
    np.testing.assert_allclose(batch.tops, lowest, atol=1e-5)
    # the cut parts them: each geom is sent in one way
    view_state = ViewState(room_view_state().grid, scene)
    chosen = replace(first_choices(view_state.grid), cut=(lowest[2] + lowest[3]) / 2)
    ((_, below),) = view_state.batches(chosen)
    assert below.tolist() == [True] * 3 + [False] * 3
    rest = trimesh.load(io.BytesIO(view_state.scene_glb(chosen)), file_type="glb", process=False)
    whole = replace(chosen, cut=None)
    uncut = trimesh.load(io.BytesIO(view_state.scene_glb(whole)), file_type="glb", process=False)
    assert view_state.batches(whole)[0][1].all() and not view_state.batches(replace(whole, cut=1.0))
    assert rest.bounds[0, 0] == pytest.approx(exact[owners == 3, 0].min(), abs=1e-4)
    assert uncut.bounds[0, 0] == pytest.approx(20, abs=1e-4)
    assert not view_state.batches(replace(whole, with_scene=False))


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
    view_state = room_view_state()
    drawing = draw_scene(view_state.scene)
    geoms = {int(geom) for one in drawing.surfaces for geom in one.geom}
    assert drawing.names == ("floor", "wall", "shown", "hidden", "table")
    assert drawing.has_hidden
    assert geoms == {0, 1, 2, 4}
    more = draw_scene(view_state.scene, with_hidden=True)
    assert 3 in np.concatenate([one.geom for one in more.surfaces])
    fewer = draw_scene(view_state.scene, removed={1})
    assert 1 not in np.concatenate([one.geom for one in fewer.surfaces])


def test_colors_are_the_materials_unless_the_geom_states_its_own():
    wood = '<material name="wood" rgba="1 0 0 1"/>'
    geoms = '<geom type="box" size="1 1 1" material="wood"/>'
    geoms += '<geom type="box" size="1 1 1" material="wood" rgba="0 1 0 1"/>'
    geoms += '<geom type="box" size="1 1 1" rgba="0 0 1 .5"/>'
    geoms += '<geom type="box" size="1 1 1" rgba="1 1 1 0"/>'
    drawing = draw(geoms, wood)
    found = {
        int(geom): tuple(color.round(3).tolist())
        for one in drawing.surfaces
        for geom, color in zip(one.geom, one.colors, strict=True)
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


def test_many_round_geoms_are_drawn_coarser():
    ball = '<geom type="sphere" size=".1" pos="{} 0 0"/>'
    one, many = (draw("".join(ball.format(k) for k in range(count))) for count in (1, 600))
    assert len(many.surfaces[0].faces) < 600 * len(one.surfaces[0].faces) / 4


def test_large_meshes_are_drawn_coarser():
    ball = trimesh.creation.icosphere(subdivisions=5)
    vertices, faces = coarsen(ball.vertices, ball.faces, 2000)
    assert 200 < len(faces) <= 2000
    assert trimesh.Trimesh(vertices, faces).volume == pytest.approx(4 / 3 * np.pi, rel=0.15)
    assert len(coarsen(ball.vertices, ball.faces, 1)[1]) < 200


def surface_of(corners, uv=None):
    count = len(corners)
    return Surface(
        corners.reshape(-1, 3).astype(np.float32),
        np.arange(3 * count, dtype=np.uint32).reshape(-1, 3),
        np.zeros(3 * count, np.int32),
        np.ones((3 * count, 4), np.float32),
        uv,
    )


def drawing_of(surface, solid):
    return Drawing((surface,), {}, np.zeros((2, 3)), ("thing",), np.array([solid]), False)


def area_below(triangle, height):
    """The area of a triangle's part below a height: Sutherland and Hodgman, corner by corner."""
    polygon = []
    for one, other in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
        if one[2] <= height:
            polygon.append(one)
        if (one[2] <= height) != (other[2] <= height):
            polygon.append(one + (height - one[2]) / (other[2] - one[2]) * (other - one))
    sides = pairwise(polygon[1:])
    fan = [np.cross(b - polygon[0], c - polygon[0]) for b, c in sides]
    return sum(np.linalg.norm(normal) for normal in fan) / 2


def area_of(surfaces):
    total = 0.0
    for one in surfaces:
        a, b, c = one.vertices[one.faces].astype(np.float64).transpose(1, 0, 2)
        total += np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    return total


def area_of_outline(points):
    """The area of a closed line, by the shoelace formula."""
    x, y = points[:, 0], points[:, 1]
    return abs(np.dot(x[:-1], y[1:]) - np.dot(x[1:], y[:-1])) / 2


@given(arrays(np.float32, (4, 3, 3), elements=HEIGHTS), HEIGHTS)
@example(np.float32([[[0, 0, 0], [0, 0, 1], [0, 0, 0]], [[1, 0, 0], [0, 0, 0], [0, 1, 0]]]), 0.0)
def test_what_is_left_has_the_area_of_the_plain_clipper(triangles, height):
    left = cut_drawing(drawing_of(surface_of(triangles), solid=False), float(height))
    expected = sum(area_below(t.astype(np.float64), float(height)) for t in triangles)
    assert area_of(left) == pytest.approx(expected, abs=1e-3)
    for one in left:
        assert one.vertices[one.faces][..., 2].max(initial=-9.0) <= height + 1e-5


@pytest.mark.parametrize("height", [0.8, 1.0, 1.3])
def test_a_cut_solid_is_closed(height):
    geom = '<geom type="{}" size=".3 .4 .5" pos="0 0 1" euler="20 30 0"/>'
    xml = f"<mujoco><worldbody>{geom}</worldbody></mujoco>"
    for kind in ("box", "cylinder", "ellipsoid"):
        drawing = draw_scene(Loaded(xml.format(kind)))
        pieces = cut_drawing(drawing, height)
        whole = trimesh.Trimesh(drawing.surfaces[0].vertices, drawing.surfaces[0].faces)
        # on the section of the whole lies a cap of the same area
        cap = sum(area_of([one]) for one in pieces if np.ptp(one.vertices[:, 2]) < 1e-6)
        section = whole.section([0, 0, 1], [0, 0, height])
        assert cap == pytest.approx(area_of_outline(section.discrete[0]), rel=1e-4)


def test_uv_go_along():
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0, 0, 2]]], dtype=np.float32)
    surface = surface_of(corners, np.array([[0, 0], [1, 0], [0, 1]], dtype=np.float32))
    (left,) = cut_drawing(drawing_of(surface, solid=False), 1.0)
    at_cut = left.vertices[:, 2] == 1.0
    np.testing.assert_allclose(left.uv[at_cut, 1], 0.5, atol=1e-6)


def test_all_below_is_kept_and_all_above_is_not():
    surface = surface_of(np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 1]]], dtype=np.float32))
    drawing = drawing_of(surface, solid=False)
    assert cut_drawing(drawing, 2.0) == (surface,)
    assert cut_drawing(drawing, -1.0) == ()
