"""Wavefront OBJ: all objects and groups, polygons of any size, relative indices.

trimesh's reader takes relative indices from the end of the file, which puts faces elsewhere in
silence, and MuJoCo's takes the first group only; so this one is navbake's own.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from navbake.bake.meshes.part import MeshPart
from navbake.bake.meshes.polygon import triangulate
from navbake.errors import SceneError


def read_obj(path: Path) -> list[MeshPart]:
    """Read the surfaces of an OBJ file; materials, normals and textures don't matter here.

    Args:
        path: the file.

    Returns:
        A part for each pair of object (``o``) and group (``g``) that has faces, in the order
        they come up, named ``object_group``; the file's stem where it names neither.

    Raises:
        SceneError: a vertex that is no three numbers, or a face of vertices that aren't there.
    """
    text = path.read_bytes().decode("utf-8-sig", errors="replace")
    text = text.replace("\r\n", "\n").replace("\r", "\n").replace("\\\n", " ")
    vertices: list[tuple[float, float, float]] = []
    pieces: dict[tuple[str, str], _Faces] = {}
    name = ("", "")
    for number, line in enumerate(text.split("\n"), start=1):
        tokens = line.split()
        if not tokens:
            continue
        try:
            if tokens[0] == "v":
                vertices.append((float(tokens[1]), float(tokens[2]), float(tokens[3])))
            elif tokens[0] == "f":
                pieces.setdefault(name, _Faces()).add(tokens[1:], len(vertices))
            elif tokens[0] == "o":
                name = (" ".join(tokens[1:]), "")
            elif tokens[0] == "g":
                name = (name[0], " ".join(tokens[1:]))
        except (ValueError, IndexError) as error:
            expected = "three numbers" if tokens[0] == "v" else "numbers of vertices, from 1 on"
            raise SceneError(
                f"broken OBJ {path}: expected {expected} in line {number}, got {line[:60]!r}"
            ) from error
    points = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    parts = []
    for (object_name, group), faces in pieces.items():
        highest = max(faces.corners, default=-1)
        if highest >= len(points):
            raise SceneError(
                f"broken OBJ {path}: a face of vertex {highest + 1}, "
                f"but there are only {len(points)}"
            )
        corners = np.array(faces.corners, dtype=np.int64)
        sizes = np.array(faces.sizes, dtype=np.int64)
        label = "_".join(filter(None, (object_name, group))) or path.stem
        parts.append(MeshPart(label, points, triangulate(points, corners, sizes)))
    return parts


class _Faces:
    """The polygons of one part."""

    def __init__(self) -> None:
        self.corners: list[int] = []
        self.sizes: list[int] = []

    def add(self, references: list[str], num_vertices: int) -> None:
        """Take one face: ``v``, ``v/t``, ``v//n`` or ``v/t/n`` each, up to a comment.

        Raises:
            ValueError: a reference is no number, is 0, or reaches before the first vertex.
        """
        before = len(self.corners)
        for reference in references:
            if reference[0] == "#":
                break
            number = int(reference.partition("/")[0])
            if number == 0 or number < -num_vertices:
                raise ValueError(reference)
            self.corners.append(number - 1 if number > 0 else number + num_vertices)
        self.sizes.append(len(self.corners) - before)
