"""The surfaces of a drawing as GLB."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from navbake.views.viewer.mesh.drawing import Surface
from navbake.views.viewer.mesh.glb import Primitive, make_glb

MOST_FLAT = 400_000  # triangles with sharp edges; of more, edges are smooth, which takes less
LIGHT = 0.2, 0.3, 0.16, 0.8  # from everywhere, and on what faces along x, y and z


def write_surfaces(surfaces: Sequence[Surface], textures: Mapping[int, NDArray[np.uint8]]) -> bytes:
    """Write surfaces and the textures that they use as one GLB."""
    used = sorted({one.texture for one in surfaces if one.uv is not None})
    primitives = []
    for one in surfaces:
        shaded = shade(one if one.is_round or len(one.faces) > MOST_FLAT else _part(one))
        picture = None if one.uv is None else used.index(one.texture)
        primitives.append(
            Primitive(shaded.vertices, shaded.faces, shaded.colors, shaded.uv, picture)
        )
    return make_glb(primitives, [write_png(textures[number]) for number in used])


def shade(surface: Surface) -> Surface:
    """A surface with light and shade in its colours.

    The light comes from above, from the south-west and, weaker, from the south; both sides of a
    triangle are alike. So a browser has only colours to draw, which it does smoothly without a
    graphics card, too.
    """
    facing = np.abs(normals_of(surface))
    share = LIGHT[0] + facing @ np.array(LIGHT[1:], dtype=np.float32)
    colors = surface.colors.copy()
    colors[:, :3] *= share[:, None]
    return surface._replace(colors=colors)


def _part(surface: Surface) -> Surface:
    """The same triangles with corners of their own, so that edges between them are sharp."""
    corners = surface.faces.ravel()
    return surface._replace(
        vertices=surface.vertices[corners],
        faces=np.arange(len(corners), dtype=np.uint32).reshape(-1, 3),
        colors=surface.colors[corners],
        uv=None if surface.uv is None else surface.uv[corners],
    )


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
