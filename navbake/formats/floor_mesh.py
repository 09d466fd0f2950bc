"""The walkable floor of a grid as a mesh: a few quads in place of one for each cell."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.errors import QueryError
from navbake.navgrid.colors import FREE, color_rooms, rgb_of
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.lattice import FARTHEST
from navbake.types import Float, Int

TOLERANCE = 0.001  # [m]
MAX_SLOPE = 45.0  # of files that state none [deg]
SLACK = 1e-6  # of the steepest slope: what rounding makes of it
NO_ROOM = "no room"


@dataclass(frozen=True, eq=False)
class LevelMesh:
    """The walkable floor of a level: quads, each of two triangles, four vertices of its own.

    Attributes:
        name: of the level.
        origin: the outer corner of the level's cell 0, on its ground: world x, y, z [m].
        vertices: world x, y, z [m], shape (4 n, 3), float64; of each quad anticlockwise from above.
        room: by quad, which of `rooms` it is in, shape (n,), int64, ascending; 0 for none.
        rooms: the rooms' names by that number, each once; 0 is "no room".
        indices: the rooms' indices on the level by that number, see `SceneGrid2D.room_index`.
    """

    name: str
    origin: tuple[float, float, float]
    vertices: Float
    room: Int
    rooms: list[str]
    indices: list[int]

    @property
    def faces(self) -> Int:
        """The vertices of each triangle, anticlockwise from above, shape (2 n, 3), int64."""
        first = 4 * np.arange(len(self.room))[:, None, None]
        faces: Int = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
        return faces

    @property
    def area(self) -> float:
        """Seen from above [m²]; that of the free cells."""
        quads = self.vertices.reshape(-1, 4, 3)
        return float(np.prod(quads[:, 2, :2] - quads[:, 0, :2], axis=1).sum())


@dataclass(frozen=True, eq=False)
class FloorMesh:
    """The walkable floor of a grid, level by level.

    Attributes:
        levels: one mesh a level, lowest first; without quads where no cell is free.
    """

    levels: list[LevelMesh]

    @property
    def vertices(self) -> Float:
        """Of all levels, world x, y, z [m], shape (n, 3), float64."""
        return np.concatenate([level.vertices for level in self.levels])

    @property
    def faces(self) -> Int:
        """The triangles of all levels as rows of `vertices`, shape (m, 3), int64."""
        first = np.cumsum([0] + [len(level.vertices) for level in self.levels])
        return np.concatenate([v.faces + n for v, n in zip(self.levels, first, strict=False)])

    @property
    def area(self) -> float:
        """Seen from above [m²]; that of the free cells."""
        return sum(level.area for level in self.levels)


def make_floor_mesh(grid: NavGrid, tolerance: float = TOLERANCE) -> FloorMesh:
    """Make a mesh of the cells where an agent can stand.

    Each free cell is covered once, each other cell is left open. Cells of one room that form a
    rectangle whose floor is a plane within the tolerance become one quad: level, or sloped where
    three cells or more in a line rise evenly, up to the grid's `maxSlope` (45 degrees where it
    states none). So at each cell's centre the mesh has the cell's floor height within the
    tolerance, stairs are level treads, and ramps are slopes. A grid doesn't tell a ramp from stairs
    whose treads are all one cell deep: both become a slope.

    There are no risers: between treads the mesh is open, as high as the step. Where two quads
    meet, they differ in height by the step between the floors of the cells, plus at most what each
    quad rises over half a cell. A free cell without floor height lies on the level's ground.

    Args:
        grid: a grid of one or several levels.
        tolerance: how far the mesh may be off the floor at a cell's centre [m], >= 0.

    Raises:
        QueryError: the tolerance is none.
    """
    is_length = isinstance(tolerance, int | float | np.number) and 0 <= tolerance <= FARTHEST
    if not is_length:
        raise QueryError(f"expected a tolerance of 0 m or more, got {tolerance!r}")
    # rooms by number, each name once in the whole grid, so that names tell rooms apart
    count = Counter(room.name for room in grid.rooms)
    names = {
        (room.level, room.index): room.name if room.name and count[room.name] == 1 else room.id
        for room in grid.rooms
    }
    stated: Any = grid.navbake.get("maxSlope")
    is_angle = type(stated) in (int, float) and 0 <= stated < 90
    steepest = math.tan(math.radians(stated if is_angle else MAX_SLOPE)) * (1 + SLACK)
    numbers = range(len(grid.levels))
    return FloorMesh([_mesh_level(grid, k, names, float(tolerance), steepest) for k in numbers])


def _mesh_level(
    grid: NavGrid, number: int, names: dict[tuple[int, int], str], tolerance: float, steepest: float
) -> LevelMesh:
    from navbake.formats.kernels.planes import cover_planes  # numba loads slowly

    level = grid.levels[number]
    lattice, size = level.lattice, level.lattice.cell_size
    z = np.where(np.isnan(level.floor), level.ground, level.floor)
    index = level.room_index.astype(np.int32)
    labels = np.where(level.free, index + 1, 0)
    bounds, planes = cover_planes(labels, z, tolerance, steepest * size)
    room = index[bounds[:, 0], bounds[:, 1]]
    order = np.argsort(room, kind="stable")
    bounds, planes, room = bounds[order], planes[order], room[order]
    row0, col0, row1, col1 = bounds.T
    # anticlockwise from above, from the lower left corner; rows run against y
    rows = np.stack([row1, row1, row0, row0], axis=1)
    cols = np.stack([col0, col1, col1, col0], axis=1)
    down, right = rows - row0[:, None] - 0.5, cols - col0[:, None] - 0.5  # from the first centre
    heights = planes[:, :1] + right * planes[:, 1:2] + down * planes[:, 2:]
    corners = [lattice.x_min + cols * size, lattice.y_max - rows * size, heights]
    found, room = np.unique(room, return_inverse=True)
    indices = [i for i in found.tolist() if i]
    return LevelMesh(
        name=grid.level_names[number],
        origin=(lattice.x_min, lattice.y_max, level.ground),
        vertices=np.stack(corners, axis=-1).reshape(-1, 3),
        # 0 is no room, also where all cells are in one
        room=room.astype(np.int64) + (len(indices) == len(found)),
        rooms=[NO_ROOM, *(names.get((number, i), f"{number}:{i}") for i in indices)],
        indices=[0, *indices],
    )


def color_mesh(grid: NavGrid, mesh: FloorMesh) -> list[NDArray[np.uint8]]:
    """A colour for each of `LevelMesh.rooms`, sRGB, shape (n, 3), by level; neighbours' differ."""
    found = []
    for number, level in enumerate(mesh.levels):
        colors = color_rooms(grid, number)[level.indices]
        colors[0] = rgb_of(FREE)
        found.append(colors)
    return found
