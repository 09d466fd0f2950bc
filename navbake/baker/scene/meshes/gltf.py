"""What a glTF or GLB holds that trimesh would leave out or misplace in silence."""

import json
import os
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from navbake.errors import SceneError

JSON_CHUNK = 0x4E4F534A
TRIANGLE_FAN = 6
MAX_BUFFER = 2 << 30  # of a file beside it [bytes]
UNREAD = {
    "EXT_mesh_gpu_instancing": "export its copies as nodes",
    "EXT_meshopt_compression": "export it without compression",
    "KHR_meshopt_compression": "export it without compression",
    "KHR_draco_mesh_compression": "export it without compression",
}


def check_gltf(path: Path) -> None:
    """Refuse a glTF or GLB file that trimesh would read as something else.

    Raises:
        SceneError: it is cut off or none, uses an extension that changes its shape, or numbers
            that trimesh reads wrongly (normalized, sparse).
    """
    try:
        data = path.read_bytes()
        header = json.loads(_json_chunk(data) if path.suffix.lower() == ".glb" else data)
        if not isinstance(header, dict):
            raise ValueError("its JSON is no object")
        problem = _find_problem(header, len(data)) or _find_outside(header, path.parent)
    except (ValueError, RecursionError, KeyError, IndexError, TypeError, AttributeError) as error:
        raise SceneError(f"broken glTF {path}: {' '.join(str(error).split())[:200]}") from error
    if problem:
        raise SceneError(f"cannot read {path}: {problem}")


def _json_chunk(data: bytes) -> bytes:
    if len(data) < 20 or not data.startswith(b"glTF"):
        raise ValueError("it has no GLB header")
    version, length, json_length, kind = struct.unpack_from("<4I", data, 4)
    if version != 2:
        raise ValueError(f"expected version 2, got {version}")
    if length > len(data):
        raise ValueError(f"it is cut off: expected {length} bytes, got {len(data)}")
    if kind != JSON_CHUNK or 20 + json_length > len(data):
        raise ValueError("its first chunk is no JSON")
    return data[20 : 20 + json_length]


def _find_outside(header: dict[str, Any], folder: Path) -> str:
    """Say what is wrong with the files that hold its buffers: a device would never end."""
    for buffer in header.get("buffers", []):
        uri = buffer.get("uri")
        if uri is None or uri.startswith("data:"):
            continue
        files = [folder / name for name in {uri, uri.strip(), unquote(uri)}]
        there = [file for file in files if os.path.exists(file)]
        if not there:
            return f"its buffer {uri[:80]!r} is missing"
        if not all(os.path.isfile(file) and file.stat().st_size <= MAX_BUFFER for file in there):
            return f"its buffer {uri[:80]!r} is no file of {MAX_BUFFER >> 20} MiB at most"
    return ""


def _find_problem(header: dict[str, Any], size: int) -> str:
    for name in header.get("extensionsUsed", []):
        if name in UNREAD:
            return f"it uses {name}: {UNREAD[name]}"
    accessors = header.get("accessors", [])
    for accessor in accessors:
        if "bufferView" not in accessor and accessor["count"] > max(size, 10_000_000):
            raise ValueError(f"it claims {accessor['count']} numbers without data")
    for mesh in header.get("meshes", []):
        for primitive in mesh["primitives"]:
            if primitive.get("mode") == TRIANGLE_FAN:
                return "it has triangle fans: export them as triangles"
            used = [primitive["attributes"].get("POSITION"), primitive.get("indices")]
            for accessor in (accessors[index] for index in used if index is not None):
                if "sparse" in accessor:
                    return "it has sparse accessors: export them as plain ones"
                if accessor.get("normalized"):
                    return "its positions are normalized integers: export it unquantized"
    return ""
