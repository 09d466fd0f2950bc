"""STL: binary, or text with any number of solids."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.bake.meshes.part import MeshPart
from navbake.errors import SceneError

HEADER = 84
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("pad", "<u2")])


def read_stl(path: Path) -> list[MeshPart]:
    """Read an STL file; normals are taken from the triangles' turn.

    Args:
        path: the file.

    Returns:
        One part of a binary file, named by the file's stem; a part for each solid of a text.

    Raises:
        SceneError: it is neither, or it is cut off.
    """
    data = path.read_bytes()
    count = int.from_bytes(data[80:HEADER], "little") if len(data) >= HEADER else 0
    if len(data) >= HEADER and len(data) == HEADER + count * RECORD.itemsize:
        return [_part(path.stem, np.frombuffer(data, RECORD, count, HEADER)["corners"])]
    if data.lstrip()[:5].lower() == b"solid" and b"facet" in data.lower():
        return _read_text(path, data.decode("utf-8", errors="replace"))
    if len(data) < HEADER:
        raise SceneError(f"broken STL {path}: it ends in its header, after {len(data)} bytes")
    if count and len(data) > HEADER + count * RECORD.itemsize:  # something was appended
        return [_part(path.stem, np.frombuffer(data, RECORD, count, HEADER)["corners"])]
    raise SceneError(
        f"broken STL {path}: expected {HEADER + count * RECORD.itemsize} bytes for the "
        f"{count} triangles of its header, got {len(data)}"
    )


def _read_text(path: Path, text: str) -> list[MeshPart]:
    parts: list[MeshPart] = []
    name, is_open = path.stem, False
    numbers: list[float] = []
    for number, line in enumerate(text.splitlines(), start=1):
        tokens = line.split()
        word = tokens[0].lower() if tokens else ""
        if word == "solid":
            name, numbers, is_open = " ".join(tokens[1:]) or path.stem, [], True
        elif word == "vertex":
            try:
                x, y, z = (float(token) for token in tokens[1:])
            except ValueError as error:
                raise SceneError(
                    f"broken STL {path}: expected three numbers in line {number}, "
                    f"got {line.strip()[:60]!r}"
                ) from error
            numbers += [x, y, z]
        elif word.startswith("endsolid"):
            if len(numbers) % 9:
                raise SceneError(f"broken STL {path}: solid {name!r} has no 3 vertices a facet")
            parts.append(_part(name, np.array(numbers).reshape(-1, 3, 3)))
            is_open = False
    if is_open:
        raise SceneError(f"broken STL {path}: it is cut off, solid {name!r} has no end")
    return parts


def _part(name: str, corners: NDArray[Any]) -> MeshPart:
    vertices = corners.reshape(-1, 3).astype(np.float64)
    return MeshPart(name, vertices, np.arange(len(vertices)).reshape(-1, 3))
