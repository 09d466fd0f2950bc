"""The surfaces of a drawing as GLB."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from navbake.views.viewer.mesh.drawing import Surface
from navbake.views.viewer.mesh.glb import Primitive, make_glb


def write_surfaces(surfaces: Sequence[Surface], textures: Mapping[int, NDArray[np.uint8]]) -> bytes:
    """Write surfaces and the textures that they use as one GLB."""
    used = sorted({one.texture for one in surfaces if one.uv is not None})
    primitives = [
        Primitive(
            one.vertices,
            one.faces,
            normals=normals_of(one) if one.is_round else None,
            colors=one.colors,
            uv=one.uv,
            picture=None if one.uv is None else used.index(one.texture),
        )
        for one in surfaces
    ]
    return make_glb(primitives, [write_png(textures[number]) for number in used])


def normals_of(surface: Surface) -> NDArray[np.float32]:
    """The normal of each vertex: the mean of its triangles' by their areas, shape (n, 3)."""
    corners = surface.vertices[surface.faces]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    ids, weight = surface.faces.ravel(), np.repeat(facing, 3, axis=0)
    count = len(surface.vertices)
    total = np.stack([np.bincount(ids, weight[:, axis], count) for axis in range(3)], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    unit = np.divide(total, length, out=np.zeros_like(total), where=length > 0)
    unit[length[:, 0] == 0] = (0, 0, 1)
    normals: NDArray[np.float32] = unit.astype(np.float32)
    return normals


def write_png(pixels: NDArray[np.uint8]) -> bytes:
    """A picture as PNG, packed fast rather than small: it goes no farther than this machine."""
    # loads Pillow, which the command line's start does without
    from PIL import Image

    content = io.BytesIO()
    Image.fromarray(pixels).save(content, "PNG", compress_level=1)
    return content.getvalue()
