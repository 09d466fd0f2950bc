"""Triangles as binary glTF (GLB), which browsers draw: what the viewer sends of scene and grid.

Source: Khronos Group, glTF 2.0 Specification, and its extension ``KHR_materials_unlit``.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from navbake.formats.gltf import Buffer
from navbake.types import Json

NEAREST, MIPMAPS, CLAMP = 9728, 9987, 33071  # how pictures are sampled


class Primitive(NamedTuple):
    """Triangles that are drawn alike, in their colours as they are.

    Attributes:
        vertices: shape (n, 3), world frame [m].
        faces: indices into `vertices`, shape (m, 3).
        colors: red, green, blue and opacity of each vertex, 0 to 1, linear light, shape (n, 4).
        uv: place of each vertex on a picture, from its upper left corner, shape (n, 2).
        picture: which of the pictures; None for none.
        opacity: of all of it; below 1, what is behind shines through.
        is_cut_out: parts of the picture are clear, and nothing is drawn there.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]
    colors: NDArray[np.float32] | None = None
    uv: NDArray[np.float32] | None = None
    picture: int | None = None
    opacity: float = 1.0
    is_cut_out: bool = False


def make_glb(primitives: Sequence[Primitive], pictures: Sequence[bytes] = ()) -> bytes:
    """Write triangles as one GLB.

    Args:
        primitives: those without triangles are left out.
        pictures: PNG files.
    """
    buffer = Buffer()
    shown = [one for one in primitives if len(one.faces)]
    parts = [{**_add(one, buffer), "material": number} for number, one in enumerate(shown)]
    views = [buffer.add_bytes(picture) for picture in pictures]
    document: Json = {"extensionsUsed": ["KHR_materials_unlit"], "scenes": [{}]}
    if parts:
        document["scenes"] = [{"nodes": [0]}]
        document |= {"nodes": [{"mesh": 0}], "meshes": [{"primitives": parts}]}
        document["materials"] = [_material(one) for one in shown]
    if views:
        document["images"] = [{"bufferView": view, "mimeType": "image/png"} for view in views]
        document["samplers"] = [
            {"magFilter": NEAREST, "minFilter": MIPMAPS, "wrapS": CLAMP, "wrapT": CLAMP}
        ]
        document["textures"] = [{"source": number, "sampler": 0} for number in range(len(views))]
    return buffer.pack(document)


def _add(one: Primitive, buffer: Buffer) -> Json:
    """Append the arrays of a primitive, and return its entry."""
    attributes = {"POSITION": buffer.add_positions(np.asarray(one.vertices, np.float32))}
    if one.colors is not None:
        steps = np.round(np.clip(one.colors, 0, 1) * 65535).astype(np.uint16)
        attributes["COLOR_0"] = buffer.add_vectors(steps, normalized=True)
    if one.uv is not None:
        attributes["TEXCOORD_0"] = buffer.add_vectors(one.uv.astype(np.float32))
    indices = buffer.add_indices(np.asarray(one.faces, np.uint32))
    return {"attributes": attributes, "indices": indices}


def _material(one: Primitive) -> Json:
    looks: Json = {"metallicFactor": 0.0, "roughnessFactor": 0.9}
    looks["baseColorFactor"] = [1.0, 1.0, 1.0, one.opacity]
    if one.picture is not None:
        looks["baseColorTexture"] = {"index": one.picture}
    is_clear = one.opacity < 1 or (one.colors is not None and bool((one.colors[:, 3] < 1).any()))
    mode = "BLEND" if is_clear else "MASK" if one.is_cut_out else "OPAQUE"
    material = {"pbrMetallicRoughness": looks, "alphaMode": mode, "doubleSided": True}
    return {**material, "extensions": {"KHR_materials_unlit": {}}}
