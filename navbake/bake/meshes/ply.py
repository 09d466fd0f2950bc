"""PLY: text and binary of either byte order, polygons of any and of mixed sizes.

trimesh's reader takes no binary file whose polygons differ in size, as Blender writes them, and
takes a text that is cut off in silence; so this one is navbake's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.bake.meshes.part import MeshPart
from navbake.bake.meshes.polygon import triangulate
from navbake.errors import SceneError

TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip
BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
CORNERS = ("vertex_indices", "vertex_index")

# a scalar property: its values; a list: all values, and how many each element has
Column = tuple[NDArray[np.int64], NDArray[np.int64]] | NDArray[np.float64]


@dataclass(frozen=True)
class _Property:
    name: str
    type: str
    count_type: str = ""  # of lists


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property]

    def as_doubles(self) -> _Element:
        doubles = [_Property(p.name, "f8", p.count_type and "f8") for p in self.properties]
        return _Element(self.name, self.count, doubles)


def read_ply(path: Path) -> list[MeshPart]:
    """Read a PLY file's vertices and faces; colours and normals don't matter here.

    Args:
        path: the file.

    Returns:
        One part, named by the file's stem.

    Raises:
        SceneError: it is no PLY, is cut off, or a face has vertices that aren't there.
    """
    try:
        found = _read_elements(path.read_bytes())
        vertex, face = found["vertex"], found.get("face", {})
        vertices = np.stack([np.asarray(vertex[axis]) for axis in "xyz"], axis=1).astype(float)
        lists = [face[name] for name in CORNERS if isinstance(face.get(name), tuple)]
    except KeyError as error:
        raise SceneError(f"broken PLY {path}: it has no {error}") from error
    except (ValueError, IndexError, OverflowError) as error:
        raise SceneError(f"broken PLY {path}: {error}") from error
    corners, sizes = lists[0] if lists else np.zeros((2, 0), dtype=np.int64)
    if len(corners) and not 0 <= int(corners.min()) <= int(corners.max()) < len(vertices):
        raise SceneError(f"broken PLY {path}: a face has vertices that are not there")
    return [MeshPart(path.stem, vertices, triangulate(vertices, corners, sizes))]


def _read_elements(data: bytes) -> dict[str, dict[str, Column]]:
    """All properties, by the element's name, then their own."""
    encoding, elements, offset = _read_header(data)
    order = BYTE_ORDERS[encoding]
    if encoding == "ascii":  # as if it were binary with doubles only
        data, offset = np.array([float(n) for n in data[offset:].split()]).tobytes(), 0
    found: dict[str, dict[str, Column]] = {}
    for element in elements:
        if encoding == "ascii":
            element = element.as_doubles()
        found[element.name], offset = _read_element(data, offset, element, order)
    return found


def _read_header(data: bytes) -> tuple[str, list[_Element], int]:
    """The encoding, the elements, and where the data begins."""
    end = data.find(b"end_header")
    if not data.startswith(b"ply") or end < 0:
        raise ValueError("it has no PLY header")
    first = data.find(b"\n", end) + 1
    encoding = ""
    elements: list[_Element] = []
    for line in data[:end].decode("ascii", errors="replace").splitlines():
        words = line.split()
        if words[:1] == ["format"]:
            encoding = words[1]
        elif words[:1] == ["element"]:
            elements.append(_Element(words[1], int(words[2]), []))
        elif words[:2] == ["property", "list"]:
            elements[-1].properties.append(_Property(words[4], TYPES[words[3]], TYPES[words[2]]))
        elif words[:1] == ["property"]:
            elements[-1].properties.append(_Property(words[2], TYPES[words[1]]))
    if encoding not in BYTE_ORDERS:
        raise ValueError(f"expected one of {', '.join(BYTE_ORDERS)} as its format")
    if any(element.count < 0 for element in elements):
        raise ValueError("an element has a negative count")
    return encoding, elements, first


def _read_element(
    data: bytes, offset: int, element: _Element, order: str
) -> tuple[dict[str, Column], int]:
    """The values of one element, and where the next one begins."""
    sizes = _first_sizes(data, offset, element, order)
    fields: list[tuple[str, str] | tuple[str, str, int]] = []
    for prop, size in zip(element.properties, sizes, strict=True):
        if prop.count_type:
            fields += [(f"{prop.name}#", order + prop.count_type)]
            fields += [(prop.name, order + prop.type, size)]
        else:
            fields += [(prop.name, order + prop.type)]
    record = np.dtype(fields)
    if offset + element.count * record.itemsize <= len(data):
        table = np.frombuffer(data, record, element.count, offset)
        lists = [(p, s) for p, s in zip(element.properties, sizes, strict=True) if p.count_type]
        if all((table[f"{prop.name}#"] == size).all() for prop, size in lists):
            columns: dict[str, Column] = {
                prop.name: table[prop.name].astype(np.float64) for prop in element.properties
            }
            for prop, size in lists:
                values = table[prop.name].astype(np.int64).ravel()
                columns[prop.name] = (values, np.full(element.count, size, dtype=np.int64))
            return columns, offset + element.count * record.itemsize
    if not any(prop.count_type for prop in element.properties):
        raise _CutOff(element)
    return _read_rows(data, offset, element, order)


def _first_sizes(data: bytes, offset: int, element: _Element, order: str) -> list[int]:
    """How long the lists of the first row are; 0 for what is no list."""
    sizes = []
    for prop in element.properties:
        size = 0
        if prop.count_type and element.count:
            (size,), offset = _take(data, offset, order + prop.count_type, 1, element)
        sizes.append(int(size))
        length = int(size) if prop.count_type else min(1, element.count)
        _, offset = _take(data, offset, order + prop.type, length, element)
    return sizes


def _read_rows(
    data: bytes, offset: int, element: _Element, order: str
) -> tuple[dict[str, Column], int]:
    """The lists of an element whose rows differ in length, row by row."""
    values: dict[str, list[NDArray[np.int64]]] = {p.name: [] for p in element.properties}
    for _ in range(element.count):
        for prop in element.properties:
            length = 1
            if prop.count_type:
                (length,), offset = _take(data, offset, order + prop.count_type, 1, element)
            row, offset = _take(data, offset, order + prop.type, int(length), element)
            if prop.count_type:
                values[prop.name].append(row)
    columns: dict[str, Column] = {}
    for name, rows in values.items():
        if rows:
            sizes = np.array([len(row) for row in rows], dtype=np.int64)
            columns[name] = (np.concatenate(rows).astype(np.int64), sizes)
    return columns, offset


def _take(
    data: bytes, offset: int, kind: str, count: int, element: _Element
) -> tuple[NDArray[Any], int]:
    """Some numbers of one type, and where the next ones begin."""
    end = offset + count * int(kind[-1])
    if count < 0:
        raise ValueError(f"a list of its {element.name} elements has a negative length")
    if end > len(data):
        raise _CutOff(element)
    return np.frombuffer(data, kind, count, offset), end


class _CutOff(ValueError):
    """The data ends before its header says."""

    def __init__(self, element: _Element) -> None:
        super().__init__(f"it is cut off in its {element.count} {element.name} elements")
