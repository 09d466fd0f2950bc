"""GLB that other readers take for the triangles that were written."""

import io

import numpy as np
import trimesh

from navbake.views.viewer.mesh.glb import Primitive, make_glb
from navbake.views.viewer.mesh.render import write_png

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 2, 3]], dtype=np.float32)
FACES = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)


def read(content):
    return trimesh.load_scene(io.BytesIO(content), file_type="glb", process=False)


def test_triangles_and_colors_are_read_as_they_were_written():
    colors = np.array([[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 1], [1, 1, 1, 1]], dtype=np.float32)
    (mesh,) = read(make_glb([Primitive(VERTICES, FACES, colors)])).geometry.values()
    np.testing.assert_array_equal(mesh.vertices, VERTICES)
    np.testing.assert_array_equal(mesh.faces, FACES)


def test_a_picture_lies_as_it_was_laid():
    picture = np.arange(4 * 2 * 3, dtype=np.uint8).reshape(2, 4, 3)
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], dtype=np.float32)
    content = make_glb([Primitive(VERTICES, FACES, uv=uv, picture=0)], [write_png(picture)])
    (mesh,) = read(content).geometry.values()
    np.testing.assert_array_equal(np.asarray(mesh.visual.material.baseColorTexture), picture)
    # trimesh counts v from below
    np.testing.assert_allclose(mesh.visual.uv, np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1))


def test_nothing_is_a_file_too():
    empty = Primitive(VERTICES, FACES[:0])
    assert not read(make_glb([empty])).geometry
    assert len(make_glb([])) % 4 == 0


def test_what_shines_through_says_so():
    clear = np.tile(np.array([1, 1, 1, 0.5], dtype=np.float32), (4, 1))
    for primitive, mode in (
        (Primitive(VERTICES, FACES), b"OPAQUE"),
        (Primitive(VERTICES, FACES, clear), b"BLEND"),
        (Primitive(VERTICES, FACES, opacity=0.5), b"BLEND"),
        (Primitive(VERTICES, FACES, is_cut_out=True), b"MASK"),
    ):
        assert b'"alphaMode":"' + mode in make_glb([primitive])
