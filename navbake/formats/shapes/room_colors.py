"""The colours of rooms in meshes: those of the pictures."""

import numpy as np
from numpy.typing import NDArray

from navbake.formats.shapes.floor_mesh import FloorMesh
from navbake.navgrid.colors import FREE, color_rooms, rgb_of
from navbake.navgrid.grid import NavGrid


def color_mesh(grid: NavGrid, mesh: FloorMesh) -> list[NDArray[np.uint8]]:
    """A colour for each of `LevelMesh.rooms`, sRGB, shape (n, 3), by level; neighbours' differ."""
    found = []
    for number, level in enumerate(mesh.levels):
        colors = color_rooms(grid, number)[level.indices]
        colors[0] = rgb_of(FREE)
        found.append(colors)
    return found
