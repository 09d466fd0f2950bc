"""Wavefront OBJ: the floor mesh as text, an object a level, a group a room."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError
from navbake.formats.shapes.floor_mesh import TOLERANCE, FloorMesh, make_floor_mesh
from navbake.formats.shapes.room_colors import color_mesh
from navbake.formats.source import Files
from navbake.navgrid.grid import NavGrid

UPS = ("y", "z")
VERTEX = "v %.10g %.10g %.10g %.3f %.3f %.3f\n"
FACE = "f %d %d %d\nf %d %d %d\n"


def encode_obj(grid: NavGrid, path: Path, *, tolerance: float = TOLERANCE, up: str = "y") -> Files:
    """Make an OBJ of a grid's walkable floor; see `make_floor_mesh` for its quads.

    Each level is an object, each room a group of it, and each vertex has the colour of its room
    after its position, which most programs read and the others skip. The format separates names by
    spaces, so each character of a name that is no letter, digit, ``.`` or ``-`` becomes ``_``.

    Args:
        path: the file.
        tolerance: see `make_floor_mesh` [m].
        up: ``y``: ``(x, z, -y)`` of the world, as Recast, Unity and most programs take it; or
            ``z``: the world's own x, y, z. Metres.

    Raises:
        QueryError: an argument is out of its range.
    """
    if up not in UPS:
        raise QueryError(f"expected y or z as up, got {up!r}")
    mesh = make_floor_mesh(grid, tolerance)
    return {path: list(list_lines(mesh, color_mesh(grid, mesh), up))}


def list_lines(mesh: FloorMesh, colors: list[NDArray[np.uint8]], up: str) -> Iterator[bytes]:
    """The content of an OBJ file, in pieces; `colors` are those of each level's rooms, sRGB."""
    yield f"# the walkable floor of a navbake grid, in metres, {up} up\n".encode()
    done = 0
    levels, groups = _Names(), _Names()
    for level, of_level in zip(mesh.levels, colors, strict=True):
        yield f"o {levels.name(level.name)}\n".encode()
        x, y, z = level.vertices.T
        z = np.round(z, 6)  # drops the noise of float32
        points = np.stack([x, z, 0.0 - y] if up == "y" else [x, y, z], axis=1)
        shades = of_level[np.repeat(level.room, 4)] / 255
        values = np.hstack([points, shades]).ravel().tolist()
        yield ((VERTEX * len(points)) % tuple(values)).encode()
        faces = level.faces + done + 1  # counted from 1 through the file
        for room in np.unique(level.room).tolist():
            own = faces[np.repeat(level.room == room, 2)].ravel().tolist()
            yield f"g {groups.name(level.rooms[room])}\n".encode()
            yield ((FACE * (len(own) // 6)) % tuple(own)).encode()
        done += len(points)


class _Names:
    """Names as OBJ takes them, each used once: what would be a second gets a number."""

    def __init__(self) -> None:
        self._used: set[str] = set()

    def name(self, name: str) -> str:
        """The name of the next object or group."""
        plain = re.sub(r"[^\w.\-]", "_", name) or "_"
        found, number = plain, 1
        while found in self._used:
            number += 1
            found = f"{plain}_{number}"
        self._used.add(found)
        return found
