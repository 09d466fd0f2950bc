"""A mesh counts by the hull that MuJoCo collides with; scipy finds the same, and is not loaded."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from navbake.baker.scene.collect import MeshTriangles
from navbake.baker.scene.model import load_model
from navbake.config.settings import SceneSettings
from navbake.errors import SceneError


def compile_mesh(points, geom="", **attributes):
    spec = mujoco.MjSpec()
    values = np.asarray(points, dtype=np.float32).ravel()
    mesh = spec.add_mesh(name="mesh", uservert=values, **attributes)
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    body = spec.worldbody.add_body()
    collides = 0 if geom == "drawn" else 1
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH, meshname="mesh", contype=collides, conaffinity=collides
    )
    return spec.compile()


def hull_corners(model):
    triangles = MeshTriangles(model).get(0, "hull")
    return triangles.vertices[triangles.faces]


def volume(corners):
    return float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6


def check_hull(model, corners):
    points = model.mesh_vert.astype(float)
    expected = ConvexHull(points)
    assert volume(corners) == pytest.approx(expected.volume, rel=1e-5)  # outward, and closed
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    offset = np.einsum("ij,ij->i", normal, corners[:, 0])
    assert (points @ normal.T <= offset + 1e-6).all()
    edges = {
        (a.tobytes(), b.tobytes()) for t in corners for a, b in zip(t, t[[1, 2, 0]], strict=True)
    }
    assert len(edges) == 3 * len(corners) and all((b, a) in edges for a, b in edges)


@pytest.mark.parametrize("seed", range(5))
def test_the_hull_is_that_of_scipy(seed):
    points = np.random.default_rng(seed).normal(size=(40, 3))
    model = compile_mesh(points)
    assert model.mesh_graphadr[0] >= 0
    check_hull(model, hull_corners(model))


def test_a_mesh_whose_hull_mujoco_does_not_make_has_one():
    model = compile_mesh(np.random.default_rng(0).normal(size=(40, 3)), geom="drawn")
    model.mesh_graphadr[0] = -1
    check_hull(model, hull_corners(model))


def test_a_hull_has_no_more_vertices_than_maxhullvert():
    model = compile_mesh(np.random.default_rng(0).normal(size=(200, 3)), maxhullvert=12)
    corners = hull_corners(model)
    assert len(np.unique(corners.reshape(-1, 3), axis=0)) <= 12
    assert 0 < volume(corners) < ConvexHull(model.mesh_vert.astype(float)).volume


def test_a_broken_hull_is_told():
    model = compile_mesh(np.random.default_rng(0).normal(size=(40, 3)))
    model.mesh_graph[-1] = 10_000
    with pytest.raises(SceneError, match="mesh 'mesh' is broken: faces of missing vertices"):
        MeshTriangles(model).get(0, "hull")


@pytest.mark.parametrize("count", [1000, -1])
def test_a_hull_without_its_faces_is_told(count):
    model = compile_mesh(np.random.default_rng(0).normal(size=(40, 3)))
    model.mesh_graph[1] = count
    with pytest.raises(SceneError, match="mesh 'mesh' is broken: its hull's faces are missing"):
        MeshTriangles(model).get(0, "hull")


def test_a_mesh_of_type_sdf_gets_no_octree(tmp_path):
    """Filling it takes longer than all else that MuJoCo compiles, and no bake looks at it."""
    path = tmp_path / "scene.xml"
    path.write_text(
        '<mujoco><asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>'
        '<worldbody><geom type="sdf" mesh="m"/></worldbody></mujoco>'
    )
    plain = mujoco.MjModel.from_xml_path(str(path))
    if not hasattr(plain, "noct") or not hasattr(mujoco.MjSpec().add_mesh(), "octree_maxdepth"):
        pytest.skip("this MuJoCo fills it always")
    model = load_model(SceneSettings(path=path), [])[0]
    assert plain.noct > 1000 > model.noct
    for name in ("geom_type", "geom_dataid", "mesh_vert", "mesh_face", "mesh_graph", "geom_aabb"):
        assert np.array_equal(getattr(model, name), getattr(plain, name)), name
