"""Geometry as arrays: boxes, height fields, planes, hulls, closedness; MuJoCo is the oracle."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
import pytest

from navbake.baker.geometry import shapes
from navbake.baker.geometry.mesh_parts import split_mesh
from navbake.baker.scene import collect
from oracles.rays import first_hit

RNG_SEEDS = range(4)
CUBE = np.array(list(itertools.product((0.0, 1.0), repeat=3)))
TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])


def is_closed(triangles):
    corners = np.reshape(triangles, (-1, 3))
    split = split_mesh(corners, np.arange(len(corners)).reshape(-1, 3))
    return split.description == "closed surface"


def volume(triangles):
    """By the divergence theorem: positive where they face out."""
    return np.einsum("ij,ij->", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])) / 6


def test_numbers_of_types_are_those_of_mujoco():
    for number, name in collect.TYPE_NAMES.items():
        assert mujoco.mjtGeom(number).name == f"mjGEOM_{name.upper()}"
    assert len(collect.TYPE_NAMES) == int(mujoco.mjtGeom.mjNGEOMTYPES)


# ---------------------------------------------------------------- boxes


@pytest.mark.parametrize("kind", collect.SOLID_TYPES)
def test_solid_bounds_touch_the_solid_on_all_sides(kind):
    rng = np.random.default_rng(kind)
    pos, size = rng.normal(size=3), rng.uniform(0.2, 1.0, size=3)
    mat, quat = np.zeros(9), rng.normal(size=4)
    mujoco.mju_quat2Mat(mat, quat / np.linalg.norm(quat))
    box = shapes.solid_bounds(np.array([kind]), pos[None], mat[None], size[None])[0]
    low, high = box[:3], box[3:]
    for axis, side in itertools.product(range(3), (-1, 1)):
        # rays along the side of a box face, just within and just outside of it
        along = np.eye(3)[(axis + 1) % 3]
        offsets = np.linspace(low[axis - 1], high[axis - 1], 4001)
        for shift, expected in ((-2e-3, True), (1e-9, False)):
            start = np.empty((len(offsets), 3))
            start[:, axis] = (high if side > 0 else low)[axis] + side * shift
            start[:, (axis + 1) % 3] = low[(axis + 1) % 3] - 1
            start[:, axis - 1] = offsets
            hits = [mujoco.mju_rayGeom(pos, mat, size, s, along, kind, None) for s in start]
            assert (max(hits) >= 0) == expected, (axis, side)


def of_plane(half):
    """The triangles of a plane; half-sizes of 0 are infinite."""
    vertices, faces = shapes.tessellate(
        "plane", [size or shapes.ENDLESS_HALF_SIZE for size in half]
    )
    return vertices[faces]


def test_bounds_leave_out_endless_planes():
    def box_of(corners, geom, endless):
        none = np.zeros(0, np.int32)
        solids = shapes.Solids(none, none, *(np.zeros((0, n)) for n in (3, 9, 3, 6)))
        planes = shapes.Planes(none, np.zeros((0, 3)), np.zeros((0, 9)))
        own = []
        for number in sorted(set(geom)):
            vertices = np.array(corners, float)[np.array(geom) == number].reshape(-1, 3)
            faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
            part, closed = np.zeros(len(faces), np.int32), np.zeros(len(faces), np.uint8)
            triangles = shapes.GeomTriangles(vertices, faces, part, closed, "surface")
            own.append((number, triangles))
        meshes = shapes.gather_meshes(own)
        return shapes.Shapes(solids, planes, meshes, np.array(endless)).bounds

    large = TETRAHEDRON[[0, 1, 2]] * 1e5  # finite, however large
    strip = of_plane((2.0, 0.0))
    both = np.concatenate([large[None], strip])
    np.testing.assert_array_equal(box_of(both, [0, 1, 1], [False, True])[1], [1e5, 1e5, 0])
    assert box_of(strip, [0, 0], [True]) is None


def test_boxes_are_those_of_used_vertices_whatever_the_meshes_sizes():
    rng = np.random.default_rng(0)
    meshes = []
    for geom, (num_vertices, num_faces) in enumerate([(3, 1), (8, 20), (5000, 4000), (40, 3)]):
        vertices = rng.normal(size=(num_vertices, 3))
        faces = rng.integers(0, num_vertices, size=(num_faces, 3), dtype=np.int32)
        part, closed = np.zeros(num_faces, np.int32), np.zeros(num_faces, np.uint8)
        triangles = shapes.GeomTriangles(vertices, faces, part, closed, "surface")
        # a second geom of the same mesh, which shares its faces
        meshes += [(2 * geom, triangles), (2 * geom + 1, triangles._replace(vertices=-vertices))]
    boxes = shapes.gather_meshes(meshes).boxes
    for box, (_, triangles) in zip(boxes, meshes, strict=True):
        corners = triangles.vertices[triangles.faces.ravel()]
        np.testing.assert_array_equal(box, [*corners.min(axis=0), *corners.max(axis=0)])


# ---------------------------------------------------------------- height fields and planes


def height_field_triangles(heights, size):
    """The corners of all triangles of a height field."""
    pieces = list(shapes.make_height_field_pieces(heights, size))
    return np.concatenate([piece.vertices[piece.faces] for piece in pieces])


@pytest.mark.parametrize("triangles_per_piece", [1, 20, 1 << 16])
@pytest.mark.parametrize("seed", RNG_SEEDS)
def test_height_field_is_what_mujoco_s_rays_see(seed, triangles_per_piece, monkeypatch):
    monkeypatch.setattr(shapes, "TRIANGLES_PER_PIECE", triangles_per_piece)
    rng = np.random.default_rng(seed)
    rows, cols = rng.integers(2, 7, size=2)
    size = rng.uniform(0.3, 2.0, size=4)
    elevation = " ".join(map(repr, rng.random(rows * cols).tolist()))
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><asset><hfield name="h" nrow="{rows}" ncol="{cols}"
        size="{size[0]} {size[1]} {size[2]} {size[3]}" elevation="{elevation}"/></asset>
        <worldbody><geom type="hfield" hfield="h"/></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    heights = model.hfield_data.reshape(rows, cols).astype(float)
    triangles = height_field_triangles(heights, model.hfield_size[0].astype(float))
    num_hits = 0
    for _ in range(1000):
        start = rng.uniform(-1, 1, size=3) * size[:3] * 1.2
        start[2] = size[2] + 0.5 if rng.random() < 0.7 else -size[3] - 0.5
        aim = rng.uniform(-1, 1, size=3) * [*size[:2], 0.1]
        way = aim - start if rng.random() < 0.5 else np.array([0, 0, -np.sign(start[2])])
        expected = mujoco.mj_rayHfield(model, data, 0, start, way.astype(float), None)
        assert first_hit(triangles, start, way) == pytest.approx(expected, abs=1e-7)
        num_hits += expected >= 0
    assert num_hits > 300
    assert is_closed(triangles)


def test_height_field_fills_its_box():
    triangles = height_field_triangles(np.ones((3, 4)), np.array([2.0, 1.0, 0.7, 0.3]))
    assert volume(triangles) == pytest.approx(4 * 2 * 1.0)
    flat = triangles.reshape(-1, 3)
    np.testing.assert_allclose([flat.min(axis=0), flat.max(axis=0)], [[-2, -1, -0.3], [2, 1, 0.7]])


@pytest.mark.parametrize("half", [(2.0, 3.0), (2.0, 0.0), (0.0, 3.0)])
def test_plane_is_what_mujoco_s_rays_see(half):
    triangles = of_plane(half)
    down, size = np.array([0, 0, -1.0]), np.array([*half, 1.0])
    for x, y in itertools.product((-9e3, -3.1, -2.1, -1.9, 0.1, 2.9, 9e3), repeat=2):
        start = np.array([x, y, 1.0])
        expected = mujoco.mju_rayGeom(np.zeros(3), np.eye(3).ravel(), size, start, down, 0, None)
        assert first_hit(triangles, start, down) == pytest.approx(expected)


# ---------------------------------------------------------------- hulls


@pytest.mark.parametrize("seed", RNG_SEEDS)
def test_hull_faces_out_and_holds_all_points(seed):
    points = np.random.default_rng(seed).normal(size=(50, 3))
    hull = points[shapes.hull_faces(points)]
    normal = np.cross(hull[:, 1] - hull[:, 0], hull[:, 2] - hull[:, 0])
    offset = np.einsum("ij,ij->i", normal, hull[:, 0])
    assert (points @ normal.T <= offset + 1e-9).all()
    assert is_closed(hull)


def test_hull_of_a_cube():
    inside = np.array([[0.5, 0.5, 0.5]])
    points = np.concatenate([CUBE, CUBE, inside])
    hull = points[shapes.hull_faces(points)]
    assert len(hull) == 12
    assert volume(hull) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "points",
    [CUBE[:3], CUBE[:4], CUBE[[0, 0, 0, 0, 0]], np.zeros((0, 3)), CUBE[:, [0, 1, 1]] * [1, 1, 0]],
)
def test_flat_points_have_no_hull(points):
    assert shapes.hull_faces(points) is None
