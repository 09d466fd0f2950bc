"""glTF 2.0 in its binary form (GLB): arrays that lie in one buffer, and the container of it.

Written here rather than by trimesh: it is a header, a JSON object and the buffer, and what writes
pictures and formats loads no library for meshes.

Source: glTF 2.0 Specification, Khronos Group, sections 3 and 4.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from navbake._version import __version__
from navbake.types import Json

COMPONENTS = {np.dtype("<f4"): 5126, np.dtype("<u2"): 5123, np.dtype("<u4"): 5125}
VERTICES, INDICES = 34962, 34963  # targets of buffer views


class Buffer:
    """The one buffer of a GLB, and the tables of what lies where in it."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._views: list[Json] = []
        self._accessors: list[Json] = []

    def add_bytes(self, content: bytes, target: int | None = None) -> int:
        """Append bytes, and return the number of their buffer view."""
        view = {"buffer": 0, "byteOffset": len(self._data), "byteLength": len(content)}
        self._views.append(view if target is None else {**view, "target": target})
        self._data += content + bytes(-len(content) % 4)
        return len(self._views) - 1

    def add_indices(self, faces: NDArray[np.uint32]) -> int:
        """Append indices into vertices, any shape, and return the number of their accessor."""
        return self._add(np.ravel(faces), "SCALAR", INDICES, {})

    def add_vectors(self, values: NDArray[Any], **more: Any) -> int:
        """Append a vector for each vertex, shape (n, 2), (n, 3) or (n, 4); likewise.

        Args:
            values: float32 or uint16.
            more: further entries of the accessor.
        """
        return self._add(values, f"VEC{values.shape[1]}", VERTICES, more)

    def add_positions(self, vertices: NDArray[np.float32]) -> int:
        """Append vertices, shape (n, 3), n > 0; glTF demands the bounds of these."""
        low, high = vertices.min(axis=0).tolist(), vertices.max(axis=0).tolist()
        return self.add_vectors(vertices, min=low, max=high)

    def _add(self, values: NDArray[Any], shape: str, target: int, more: Json) -> int:
        values = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
        view = self.add_bytes(values.tobytes(), target)
        component = COMPONENTS[values.dtype]
        entry = {"bufferView": view, "componentType": component, "count": len(values)}
        self._accessors.append({**entry, "type": shape, **more})
        return len(self._accessors) - 1

    def pack(self, document: Json) -> bytes:
        """The content of a GLB file.

        Args:
            document: the rest of the JSON object; what is empty is left out, as glTF demands.
        """
        tables = {"accessors": self._accessors, "bufferViews": self._views}
        if self._data:
            tables["buffers"] = [{"byteLength": len(self._data)}]
        asset = {"version": "2.0", "generator": f"navbake {__version__}"}
        whole = {"asset": asset, "scene": 0, **document, **tables}
        text = orjson.dumps({key: value for key, value in whole.items() if value not in ([], {})})
        chunks = _chunk(text + b" " * (-len(text) % 4), b"JSON")
        if self._data:
            chunks += _chunk(bytes(self._data), b"BIN\0")
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _chunk(content: bytes, kind: bytes) -> bytes:
    return struct.pack("<I4s", len(content), kind) + content
