"""Triangles as binary glTF (GLB), which browsers draw: what the viewer sends of scene and grid.

Source: Khronos Group, glTF 2.0 Specification, and its extension ``KHR_materials_unlit``.
"""

import json
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

FLOAT, USHORT, UINT = 5126, 5123, 5125  # glTF's component types
ARRAY, ELEMENTS = 34962, 34963  # and its kinds of buffers
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
    writer = _Writer()
    meshes = [writer.add(one) for one in primitives if len(one.faces)]
    images = [
        {"bufferView": writer.view(np.frombuffer(picture, np.uint8)), "mimeType": "image/png"}
        for picture in pictures
    ]
    sampler = {"magFilter": NEAREST, "minFilter": MIPMAPS, "wrapS": CLAMP, "wrapT": CLAMP}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "navbake"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0] if meshes else []}],
        "buffers": [{"byteLength": len(writer.data)}],
        "bufferViews": writer.views,
        "accessors": writer.accessors,
    }
    if meshes:
        document |= {"nodes": [{"mesh": 0}], "meshes": [{"primitives": meshes}]}
        document["materials"] = writer.materials
    if images:
        textures = [{"source": number, "sampler": 0} for number in range(len(images))]
        document |= {"images": images, "samplers": [sampler], "textures": textures}
    if not writer.data:  # glTF has no empty buffers
        for key in ("buffers", "bufferViews", "accessors"):
            del document[key]
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(writer.data), b"BIN\0") + writer.data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


class _Writer:
    """The one buffer of a GLB, and the tables of what lies where in it."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self.materials: list[dict[str, Any]] = []

    def view(self, array: NDArray[Any], target: int | None = None) -> int:
        """Append an array's bytes, and return the number of its buffer view."""
        content = array.tobytes()
        found = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(content)}
        self.views.append(found if target is None else {**found, "target": target})
        self.data += content + b"\0" * (-len(content) % 4)
        return len(self.views) - 1

    def _accessor(self, array: NDArray[Any], component: int, shape: str, **more: Any) -> int:
        target = ELEMENTS if shape == "SCALAR" else ARRAY
        view = self.view(array, target)
        count = array.size if shape == "SCALAR" else len(array)
        entry = {"bufferView": view, "componentType": component, "count": count, "type": shape}
        self.accessors.append({**entry, **more})
        return len(self.accessors) - 1

    def add(self, one: Primitive) -> dict[str, Any]:
        """Append the arrays of a primitive and its material, and return its entry."""
        vertices = np.ascontiguousarray(one.vertices, np.float32)
        bounds = {"min": vertices.min(axis=0).tolist(), "max": vertices.max(axis=0).tolist()}
        attributes = {"POSITION": self._accessor(vertices, FLOAT, "VEC3", **bounds)}
        if one.colors is not None:
            steps = np.round(np.clip(one.colors, 0, 1) * 65535).astype(np.uint16)
            attributes["COLOR_0"] = self._accessor(steps, USHORT, "VEC4", normalized=True)
        if one.uv is not None:
            attributes["TEXCOORD_0"] = self._accessor(one.uv.astype(np.float32), FLOAT, "VEC2")
        self.materials.append(_material(one))
        faces = np.ascontiguousarray(one.faces, np.uint32)
        return {
            "attributes": attributes,
            "indices": self._accessor(faces, UINT, "SCALAR"),
            "material": len(self.materials) - 1,
        }


def _material(one: Primitive) -> dict[str, Any]:
    looks: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 0.9}
    looks["baseColorFactor"] = [1.0, 1.0, 1.0, one.opacity]
    if one.picture is not None:
        looks["baseColorTexture"] = {"index": one.picture}
    is_clear = one.opacity < 1 or (one.colors is not None and bool((one.colors[:, 3] < 1).any()))
    mode = "BLEND" if is_clear else "MASK" if one.is_cut_out else "OPAQUE"
    material = {"pbrMetallicRoughness": looks, "alphaMode": mode, "doubleSided": True}
    return {**material, "extensions": {"KHR_materials_unlit": {}}}
