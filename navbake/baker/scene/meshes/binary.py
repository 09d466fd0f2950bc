"""Plain binary PLY and STL files, read without trimesh, whose import takes longer than they do."""

import re

import numpy as np
from numpy.typing import NDArray

from navbake.baker.scene.meshes.text import STL_HEADER, STL_TRIANGLE
from navbake.types import Float, Int32

PLY_FORMATS = {b"binary_little_endian": "<", b"binary_big_endian": ">"}
PLY_TYPES = {b"uchar": "u1", b"uint8": "u1", b"int": "i4", b"int32": "i4", b"uint": "u4"}
PLY_TYPES |= {b"uint32": "u4", b"float": "f4", b"float32": "f4", b"double": "f8", b"float64": "f8"}
PLY_COORDINATES = {b"x", b"y", b"z"}
# What else a plain vertex may have; one with texture coordinates may belong to several vertices
PLY_IGNORED = {b"nx", b"ny", b"nz", b"red", b"green", b"blue", b"alpha"}
PLY_HEADER = re.compile(
    rb"ply\nformat (?P<format>\w+) 1\.0\n(?:comment [^\n]*\n)*"
    rb"element vertex (?P<vertices>\d+)\n(?P<properties>(?:property \w+ \w+\n)+)"
    rb"element face (?P<faces>\d+)\nproperty list (?P<count>\w+) (?P<index>\w+) vertex_ind\w+\n"
    rb"end_header\n"
)
MOST_DIGITS = 10  # of a number of vertices or faces


def read_plain_ply(data: bytes) -> tuple[Float, Int32] | None:
    """The vertices and triangles of a binary PLY that holds nothing but these.

    Returns:
        None where the file is anything else or broken: trimesh knows more, and says what is wrong.
    """
    header = PLY_HEADER.match(data)
    if header is None or header["format"] not in PLY_FORMATS:
        return None
    order = PLY_FORMATS[header["format"]]
    named = [tuple(line.split()[1:]) for line in header["properties"].splitlines()]
    names = [name for _, name in named]
    known = len(set(names)) == len(names) and set(names) <= PLY_COORDINATES | PLY_IGNORED
    kinds = [*(kind for kind, _ in named), header["count"], header["index"]]
    if not known or not set(names) >= PLY_COORDINATES or not set(kinds) <= PLY_TYPES.keys():
        return None
    if max(len(header["vertices"]), len(header["faces"])) > MOST_DIGITS:
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


def read_plain_stl(data: bytes) -> tuple[Float, Int32] | None:
    """The vertices and triangles of a binary STL; None where it is text, or broken."""
    count = int.from_bytes(data[STL_HEADER - 4 : STL_HEADER], "little")
    is_text = data[:STL_HEADER].lstrip()[:5].lower() in (b"solid", b"")
    if is_text or not count or len(data) != STL_HEADER + STL_TRIANGLE * count:
        return None
    facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    corners = np.frombuffer(data, facet, count, STL_HEADER)["corners"].reshape(-1, 3)
    return _to_float64(list(corners.T)), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def _to_float64(axes: list[NDArray[np.floating]]) -> Float:
    vertices = np.empty((len(axes[0]), 3))
    with np.errstate(invalid="ignore"):  # of NaNs that signal; all NaNs are refused later
        for axis, values in enumerate(axes):
            vertices[:, axis] = values
    vertices += 0.0  # -0.0 becomes 0.0
    return vertices
