"""The floor mesh as binary glTF (.glb): an object a level, a material a room."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from navbake.formats.gltf import Buffer
from navbake.formats.shapes.floor_mesh import TOLERANCE, FloorMesh, LevelMesh, make_floor_mesh
from navbake.formats.shapes.room_colors import color_mesh
from navbake.formats.source import Files
from navbake.navgrid.grid import NavGrid
from navbake.types import Json


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
    return parts.pack()


class _Parts:
    """The lists of a glTF file as it grows."""

    def __init__(self) -> None:
        self._buffer = Buffer()
        self._nodes: list[Json] = []
        self._meshes: list[Json] = []
        self._materials: list[Json] = []

    def pack(self) -> bytes:
        """The content of the file."""
        scenes = [{"nodes": list(range(len(self._nodes)))}]
        lists = {"nodes": self._nodes, "meshes": self._meshes, "materials": self._materials}
        return self._buffer.pack({"scenes": scenes, **lists})

    def add_level(self, level: LevelMesh, colors: NDArray[np.uint8]) -> None:
        """Add a level as an object."""
        x, y, z = level.origin
        node: Json = {"name": level.name, "translation": [x, z, 0.0 - y]}
        if len(level.room):
            node["mesh"] = len(self._meshes)
            self._meshes.append(self._mesh(level, colors))
        self._nodes.append(node)

    def _mesh(self, level: LevelMesh, colors: NDArray[np.uint8]) -> Json:
        local = level.vertices - level.origin
        up_is_y = np.stack([local[:, 0], local[:, 2], 0.0 - local[:, 1]], axis=1)
        turned = up_is_y.astype(np.float32)
        primitives = []
        # the quads of a room are in a row
        counts = np.bincount(level.room, minlength=len(level.rooms))
        ends = np.cumsum(counts).tolist()
        for room, (end, count) in enumerate(zip(ends, counts.tolist(), strict=True)):
            if not count:
                continue
            corners = turned[4 * (end - count) : 4 * end]
            faces = level.faces[: 2 * count].astype(np.uint32)
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
                    "attributes": {"POSITION": self._buffer.add_positions(corners)},
                    "indices": self._buffer.add_indices(faces),
                    "material": len(self._materials),
                    "extras": {"room": level.rooms[room]},
                }
            )
            self._materials.append(material)
        return {"name": level.name, "primitives": primitives}


def _linear(value: int) -> float:
    """A part of a colour from sRGB, 0 to 255, to linear, 0 to 1 (IEC 61966-2-1)."""
    share = value / 255
    return round(share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4, 6)
