"""A cut drawing is what a slow, plain clipper leaves, and cut solids are closed."""

from itertools import pairwise

import mujoco
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from navbake.views.viewer.mesh.cut import cut_drawing
from navbake.views.viewer.mesh.drawing import Drawing, Surface, draw_scene

HEIGHTS = st.floats(-3, 3, width=32)


def surface_of(corners, uv=None):
    count = len(corners)
    return Surface(
        corners.reshape(-1, 3).astype(np.float32),
        np.arange(3 * count, dtype=np.uint32).reshape(-1, 3),
        np.zeros(count, np.int32),
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


@settings(deadline=None)
@given(arrays(np.float32, (4, 3, 3), elements=HEIGHTS), HEIGHTS)
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
        model = mujoco.MjModel.from_xml_string(xml.format(kind))
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        scene = type("Loaded", (), {"model": model, "data": data, "parts": {}})
        drawing = draw_scene(scene)
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
    np.testing.assert_allclose(left.uv[at_cut, 1], 0.5)


def test_all_below_is_kept_and_all_above_is_not():
    surface = surface_of(np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 1]]], dtype=np.float32))
    drawing = drawing_of(surface, solid=False)
    assert cut_drawing(drawing, 2.0) == (surface,)
    assert cut_drawing(drawing, -1.0) == ()
