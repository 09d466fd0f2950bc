"""glTF 2.0 in its binary form (.glb): the floor mesh, an object a level, a material a room.

Written here rather than by trimesh: what is written is a header, a JSON object and two arrays, and
the formats load no library for meshes.

Source: glTF 2.0 Specification, Khronos Group, sections 3 and 4.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake._version import __version__
from navbake.formats.shapes.floor_mesh import TOLERANCE, FloorMesh, LevelMesh, make_floor_mesh
from navbake.formats.shapes.room_colors import color_mesh
from navbake.formats.source import Files
from navbake.navgrid.grid import NavGrid
from navbake.types import Json

MAGIC, VERSION, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 2, 0x4E4F534A, 0x004E4942
FLOAT, UINT32 = 5126, 5125
VERTICES, INDICES = 34962, 34963  # targets of buffer views


def encode_glb(grid: NavGrid, path: Path, *, tolerance: float = TOLERANCE) -> Files:
    """Make a GLB of a grid's walkable floor; see `make_floor_mesh` for its quads.

    y is up, in metres, as glTF has it: ``(x, z, -y)`` of the world. Each level is an object by its
    name, whose origin is the outer corner of the level's cell 0 on its ground; each room a material
    by its name, in its colour of the pictures.

    Args:
        path: the file.
        tolerance: see `make_floor_mesh` [m].
    """
    mesh = make_floor_mesh(grid, tolerance)
    return {path: pack_glb(mesh, color_mesh(grid, mesh))}


def pack_glb(mesh: FloorMesh, colors: list[NDArray[np.uint8]]) -> bytes:
    """The content of a GLB file; `colors` are those of each level's rooms, sRGB."""
    parts = _Parts()
    for level, of_level in zip(mesh.levels, colors, strict=True):
        parts.add_level(level, of_level)
    text = orjson.dumps(parts.describe())
    text += b" " * (-len(text) % 4)
    data = b"".join(parts.data)  # arrays of 4 bytes a value
    chunks = struct.pack("<II", len(text), JSON_CHUNK) + text
    if data:
        chunks += struct.pack("<II", len(data), BINARY_CHUNK) + data
    return struct.pack("<III", MAGIC, VERSION, 12 + len(chunks)) + chunks


class _Parts:
    """The lists of a glTF file as it grows."""

    def __init__(self) -> None:
        self.data: list[bytes] = []
        self._size = 0
        self._lists: dict[str, list[Json]] = {
            name: [] for name in ("nodes", "meshes", "materials", "accessors", "bufferViews")
        }

    def describe(self) -> Json:
        """The JSON object; lists without entries are left out, as glTF demands."""
        lists = {name: entries for name, entries in self._lists.items() if entries}
        scene = {"nodes": list(range(len(self._lists["nodes"])))}
        buffers = {"buffers": [{"byteLength": self._size}]} if self.data else {}
        asset = {"version": "2.0", "generator": f"navbake {__version__}"}
        return {"asset": asset, "scene": 0, "scenes": [scene], **lists, **buffers}

    def add_level(self, level: LevelMesh, colors: NDArray[np.uint8]) -> None:
        """Add a level as an object."""
        x, y, z = level.origin
        node: Json = {"name": level.name, "translation": [x, z, 0.0 - y]}
        if len(level.room):
            node["mesh"] = self._add("meshes", self._mesh(level, colors))
        self._add("nodes", node)

    def _mesh(self, level: LevelMesh, colors: NDArray[np.uint8]) -> Json:
        local = level.vertices - level.origin
        turned = np.stack([local[:, 0], local[:, 2], 0.0 - local[:, 1]], axis=1).astype("<f4")
        primitives = []
        # the quads of a room are in a row
        counts = np.bincount(level.room, minlength=len(level.rooms))
        ends = np.cumsum(counts).tolist()
        for room, (end, count) in enumerate(zip(ends, counts.tolist(), strict=True)):
            if not count:
                continue
            material = {
                "name": level.rooms[room],
                "pbrMetallicRoughness": {
                    "baseColorFactor": [*(_linear(c) for c in colors[room].tolist()), 1.0],
                    "metallicFactor": 0.0,
                },
                "doubleSided": True,
            }
            primitives.append(
                {
                    "attributes": {"POSITION": self._vertices(turned[4 * (end - count) : 4 * end])},
                    "indices": self._indices(level.faces[: 2 * count].ravel().astype("<u4")),
                    "material": self._add("materials", material),
                    "extras": {"room": level.rooms[room]},
                }
            )
        return {"name": level.name, "primitives": primitives}

    def _vertices(self, points: NDArray[np.float32]) -> int:
        view = self._view(points.tobytes(), VERTICES)
        low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
        accessor = {"bufferView": view, "componentType": FLOAT, "count": len(points)}
        return self._add("accessors", {**accessor, "type": "VEC3", "min": low, "max": high})

    def _indices(self, corners: NDArray[np.uint32]) -> int:
        view = self._view(corners.tobytes(), INDICES)
        accessor = {"bufferView": view, "componentType": UINT32, "count": len(corners)}
        return self._add("accessors", {**accessor, "type": "SCALAR"})

    def _view(self, content: bytes, target: int) -> int:
        view = {"buffer": 0, "byteOffset": self._size, "byteLength": len(content)}
        self.data.append(content)
        self._size += len(content)
        return self._add("bufferViews", {**view, "target": target})

    def _add(self, name: str, entry: Json) -> int:
        self._lists[name].append(entry)
        return len(self._lists[name]) - 1


def _linear(value: int) -> float:
    """A part of a colour from sRGB, 0 to 255, to linear, 0 to 1 (IEC 61966-2-1)."""
    share = value / 255
    return round(share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4, 6)
