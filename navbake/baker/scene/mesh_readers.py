"""Mesh files as arrays, or made ready for trimesh, which reads some wrongly in silence.

Plain binary PLY and STL are read without trimesh, whose import takes longer than they do.
"""

import json
import os
import re
import struct
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from navbake.errors import SceneError
from navbake.formats.allowance import MAX_BYTES
from navbake.types import Float, Int32

STL_HEADER, STL_TRIANGLE = 84, 50  # [bytes]
MOST_HEADER = 1 << 20  # of a PLY; what counts stands before that [bytes]


def prepare_obj(path: Path) -> bytes:
    """An OBJ's text as trimesh reads it rightly: UTF-8, no indents, absolute indices.

    trimesh counts relative indices from the end of the file, not from where they stand, and
    passes over lines that are indented.
    """
    text = _as_utf8(path.read_bytes()).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    text = text.replace(b"\\\n", b" ")
    if re.search(rb"(?m)^(?:[ \t]+[vf]|[vf]\t)", text):
        text = b"\n".join(b" ".join(line.split()) for line in text.split(b"\n"))
    if not re.search(rb"(?m)^f(?=.*(?:#| -| 0+(?:[/ ]|$)))", text):
        return text
    lines, num_vertices = text.split(b"\n"), 0
    for number, line in enumerate(lines):
        num_vertices += line.startswith(b"v ")
        if line.startswith(b"f "):
            # references to vertices, counted from 1; textures and normals don't matter here
            words = [word.partition(b"/")[0] for word in line.partition(b"#")[0].split()[1:]]
            indices = [int(word) if re.fullmatch(rb"[-+]?\d{1,18}", word) else 0 for word in words]
            indices = [index + (index < 0) * (num_vertices + 1) for index in indices]
            if min(indices, default=1) <= 0:
                where = f"line {number + 1} of {path}"
                raise SceneError(f"expected numbers of vertices, counted from 1, in {where}")
            lines[number] = b"f " + " ".join(map(str, indices)).encode()
    return b"\n".join(lines)


def prepare_stl(path: Path) -> bytes:
    """An STL's bytes; refuses one that is cut off, or neither text nor binary."""
    data = path.read_bytes()
    if data.lstrip()[:5].lower() == b"solid" and b"facet" in (words := data.lower()):
        num_solids, num_ends = (
            len(re.findall(rb"(?m)^\s*" + word, words)) for word in (b"solid", b"endsolid")
        )
        if num_ends < num_solids:
            raise SceneError(f"{path} is cut off: its last solid has no end")
        return _as_utf8(data)
    count = int.from_bytes(data[STL_HEADER - 4 : STL_HEADER], "little")
    size = STL_HEADER + STL_TRIANGLE * count
    if len(data) < max(size, STL_HEADER):
        raise SceneError(
            f"{path} is cut off or no STL: expected {size} bytes for the {count} triangles of "
            f"its header, got {len(data)}"
        )
    return data[:size]  # trimesh takes no more, some writers append something


def prepare_ply(path: Path) -> bytes:
    """A PLY's bytes, as UTF-8 if it is text."""
    data = path.read_bytes()
    return _as_utf8(data) if b"format ascii" in data[:200] else data


def check_ply(path: Path, data: bytes, num_vertices: int, num_faces: int) -> None:
    """Refuse a PLY of which trimesh found fewer vertices or triangles than its header says."""
    header = data[:MOST_HEADER].partition(b"end_header")[0]
    for name, found in ((b"vertex", num_vertices), (b"face", num_faces)):
        said = re.search(rb"element %s (\d+)" % name, header)
        if said and int(said[1]) > found:
            raise SceneError(
                f"{path} is cut off: expected {int(said[1])} {name.decode()} elements, got {found}"
            )


def _as_utf8(data: bytes) -> bytes:
    """Text that decodes; trimesh needs another package to guess at other encodings."""
    return data.decode("utf-8-sig", errors="replace").encode()


PLY_FORMATS = {b"binary_little_endian": "<", b"binary_big_endian": ">"}
PLY_TYPES = {b"uchar": "u1", b"uint8": "u1", b"int": "i4", b"int32": "i4", b"uint": "u4"}
PLY_TYPES |= {b"uint32": "u4", b"float": "f4", b"float32": "f4", b"double": "f8", b"float64": "f8"}
PLY_COORDINATES = {b"x", b"y", b"z"}
# What a plain vertex may have; one with texture coordinates may belong to several vertices
PLY_VERTEX = PLY_COORDINATES | {b"nx", b"ny", b"nz", b"red", b"green", b"blue", b"alpha"}
PLY_HEADER = re.compile(
    rb"ply\nformat (?P<format>\w+) 1\.0\n(?:comment [^\n]*\n)*"
    rb"element vertex (?P<vertices>\d{1,10})\n(?P<properties>(?:property \w+ \w+\n)+)"
    rb"element face (?P<faces>\d{1,10})\n"
    rb"property list (?P<count>\w+) (?P<index>\w+) vertex_ind\w+\nend_header\n"
)


def read_plain(data: bytes, suffix: str) -> tuple[Float, Int32] | None:
    """The vertices and triangles of a binary PLY or STL that holds nothing but these.

    None where the file is anything else or broken: trimesh knows more, and says what is wrong.
    """
    if suffix == ".ply":
        return _read_plain_ply(data)
    count = int.from_bytes(data[STL_HEADER - 4 : STL_HEADER], "little")
    is_text = data[:STL_HEADER].lstrip()[:5].lower() in (b"solid", b"")
    if suffix != ".stl" or is_text or not count or len(data) != STL_HEADER + STL_TRIANGLE * count:
        return None
    facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    corners = np.frombuffer(data, facet, count, STL_HEADER)["corners"].reshape(-1, 3)
    return _to_float64(corners.T), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def _read_plain_ply(data: bytes) -> tuple[Float, Int32] | None:
    header = PLY_HEADER.match(data)
    if header is None or header["format"] not in PLY_FORMATS:
        return None
    order = PLY_FORMATS[header["format"]]
    named = [line.split()[1:] for line in header["properties"].splitlines()]
    names = {name for _, name in named}
    kinds = {*(kind for kind, _ in named), header["count"], header["index"]}
    is_known = len(names) == len(named) and PLY_COORDINATES <= names <= PLY_VERTEX
    if not is_known or not kinds <= PLY_TYPES.keys():
        return None
    vertex = np.dtype([(name.decode(), order + PLY_TYPES[kind]) for kind, name in named])
    count, index = (order + PLY_TYPES[header[key]] for key in ("count", "index"))
    face = np.dtype([("count", count), ("index", index, 3)])
    num_vertices, num_faces = int(header["vertices"]), int(header["faces"])
    middle = header.end() + num_vertices * vertex.itemsize
    if not num_vertices or not num_faces or len(data) != middle + num_faces * face.itemsize:
        return None
    of_faces = np.frombuffer(data, face, num_faces, middle)
    of_vertices = np.frombuffer(data, vertex, num_vertices, header.end())
    faces = of_faces["index"].astype(np.int32)  # one too large for that is negative
    # the number of a polygon's corners stands before each; it has to be three for all
    if (of_faces["count"] != 3).any() or not 0 <= faces.min() <= faces.max() < num_vertices:
        return None
    return _to_float64([of_vertices[axis] for axis in "xyz"]), faces


def _to_float64(axes: Iterable[NDArray[np.floating]]) -> Float:
    with np.errstate(invalid="ignore"):  # of NaNs that signal; all NaNs are refused later
        return np.stack([axis.astype(np.float64) for axis in axes], axis=1) + 0.0  # no -0.0


JSON_CHUNK = 0x4E4F534A
TRIANGLE_FAN = 6
UNREAD = {
    "EXT_mesh_gpu_instancing": "export its copies as nodes",
    "EXT_meshopt_compression": "export it without compression",
    "KHR_meshopt_compression": "export it without compression",
    "KHR_draco_mesh_compression": "export it without compression",
}


def check_gltf(path: Path) -> None:
    """Refuse a glTF or GLB file that is cut off, or that trimesh would read as something else."""
    try:
        data = path.read_bytes()
        text = data
        if path.suffix.lower() == ".glb":
            if len(data) < 20 or not data.startswith(b"glTF"):
                raise ValueError("it has no GLB header")
            version, length, json_length, kind = struct.unpack_from("<4I", data, 4)
            if version != 2:
                raise ValueError(f"expected version 2, got {version}")
            if length > len(data):
                raise ValueError(f"it is cut off: expected {length} bytes, got {len(data)}")
            if kind != JSON_CHUNK or 20 + json_length > len(data):
                raise ValueError("its first chunk is no JSON")
            text = data[20 : 20 + json_length]
        header = json.loads(text)
        if not isinstance(header, dict):
            raise ValueError("its JSON is no object")
        problem = next(_find_problems(header, len(data), path.parent), "")
    except (ValueError, RecursionError, KeyError, IndexError, TypeError, AttributeError) as error:
        raise SceneError(f"broken glTF {path}: {' '.join(str(error).split())[:200]}") from error
    if problem:
        raise SceneError(f"cannot read {path}: {problem}")


def _find_problems(header: dict[str, Any], size: int, folder: Path) -> Iterator[str]:
    used = (name for name in header.get("extensionsUsed", []) if name in UNREAD)
    yield from (f"it uses {name}: {UNREAD[name]}" for name in used)
    accessors = header.get("accessors", [])
    for accessor in accessors:
        if "bufferView" not in accessor and accessor["count"] > max(size, 10_000_000):
            raise ValueError(f"it claims {accessor['count']} numbers without data")
    for primitive in (each for mesh in header.get("meshes", []) for each in mesh["primitives"]):
        if primitive.get("mode") == TRIANGLE_FAN:
            yield "it has triangle fans: export them as triangles"
        indices = primitive["attributes"].get("POSITION"), primitive.get("indices")
        for accessor in (accessors[index] for index in indices if index is not None):
            if "sparse" in accessor:
                yield "it has sparse accessors: export them as plain ones"
            if accessor.get("normalized"):
                yield "its positions are normalized integers: export it unquantized"
    for uri in (buffer.get("uri") for buffer in header.get("buffers", [])):
        if uri is None or uri.startswith("data:"):
            continue
        files = [folder / name for name in {uri, uri.strip(), unquote(uri)}]
        there = [file for file in files if os.path.exists(file)]
        if not there:
            yield f"its buffer {uri[:80]!r} is missing"
        # a device would never end
        if not all(os.path.isfile(file) and file.stat().st_size <= MAX_BYTES for file in there):
            yield f"its buffer {uri[:80]!r} is no file of {MAX_BYTES >> 20} MiB at most"


PREPARE = {".obj": prepare_obj, ".stl": prepare_stl, ".ply": prepare_ply}
