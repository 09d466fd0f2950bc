"""Finds meshes whose hull hides room for an agent, as the hull of a building does."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from navbake.baker.columns.columns import Columns, cast_columns, tile_shapes
from navbake.baker.core.area_test import is_large_enough
from navbake.baker.core.constants import OPEN_SURFACE
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.scene.collect import GeomSelection, MeshTriangles, collect_shapes
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Int

if TYPE_CHECKING:
    import mujoco

# The spacing of the vertical lines on which room is searched for, unless there were too many [m]
LINE_SPACING = 0.1
MAX_LINES = 10_000

# What may begin above a hit: room that needs a ceiling, or room over a floor; 0 for neither
NEEDS_CEILING = 1
ROOM_OVER_FLOOR = 2


@dataclass(eq=False)
class HullRoomTest:
    """Tests whether the hull of a mesh hides room for an agent, in a posed model.

    Attributes:
        model: the model.
        data: the model's pose.
        meshes: the triangles of the model's meshes.
        agent: the agent that needs the room.
        floors: the settings that say how large a floor has to be.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    meshes: MeshTriangles
    agent: AgentSettings
    floors: FloorSettings
    # by the mesh and its orientation
    _has_room: dict[tuple[int, bytes], bool] = field(default_factory=dict, init=False)

    def hides_room(self, geom: int) -> bool:
        """Return whether the hull of a mesh geom hides room for an agent to stand in.

        Room is a free stretch of a vertical line, at least as long as the agent is high. It lies
        inside the hull, but not inside closed parts of the mesh: over a surface that faces up,
        under one that faces down, or where the line meets no surface. The room's area has to be
        that of a floor (`floors.min_area` after `floors.shrink`).
        """
        if not self.is_large(geom):
            return False
        key = (int(self.model.geom_dataid[geom]), self.data.geom_xmat[geom].tobytes())
        if key not in self._has_room:
            self._has_room[key] = self._find_room(geom)
        return self._has_room[key]

    def is_large(self, geom: int) -> bool:
        """Return whether the bounding box of a mesh geom is large enough for an agent's room."""
        rotation = self.data.geom_xmat[geom].reshape(3, 3)
        if not np.isfinite(rotation).all():
            return False
        width, depth, height = 2 * np.abs(rotation) @ self.model.geom_aabb[geom, 3:]
        # Floats of Python, as NumPy's would warn of an area beyond all floats.
        floor_width = float(width) - 2 * self.floors.shrink
        floor_depth = float(depth) - 2 * self.floors.shrink
        if min(floor_width, floor_depth) < 0 or height < self.agent.height - LIMIT_SLACK:
            return False
        return floor_width * floor_depth >= self.floors.min_area - LIMIT_SLACK

    def _find_room(self, geom: int) -> bool:
        """Cast vertical lines at the mesh and at its hull, and test the area of lines with room."""
        mesh_shapes = self._collect(geom, "surface")
        hull_shapes = self._collect(geom, "hull")
        bounds = hull_shapes.bounds
        if bounds is None or not np.isfinite(bounds).all():
            return False
        x_min, y_min, x_max, y_max = bounds[:, :2].ravel().tolist()
        width = x_max - x_min
        depth = y_max - y_min
        # The second limit is for a long and thin box.
        spacing_by_area = math.sqrt(width * depth / MAX_LINES)
        spacing_by_length = max(width, depth) / MAX_LINES
        spacing = max(LINE_SPACING, spacing_by_area, spacing_by_length)
        lattice = Lattice.cover((x_min, y_min, x_max, y_max), spacing)
        mesh_columns = cast_columns(tile_shapes(mesh_shapes, lattice, spacing / 2))
        hull_columns = cast_columns(tile_shapes(hull_shapes, lattice, spacing / 2))
        has_room = _mark_room(mesh_columns, hull_columns, self.agent.height)
        return is_large_enough(lattice, self.floors, has_room)

    def _collect(self, geom: int, mesh_mode: str) -> Shapes:
        selection = {geom: GeomSelection(True, "", mesh_mode)}
        shapes, *_ = collect_shapes(
            self.model, self.data, selection, {}, only=selection, meshes=self.meshes
        )
        return shapes


def _mark_room(mesh: Columns, hull: Columns, height: float) -> Bool:
    """Mark the cells on whose line there is room; see `HullRoomTest.hides_room`.

    All hits of a line are sorted by height. Each says what may begin above it and whether a room
    may end at it. A stretch is room where a room begins at its lower hit and ends at its upper one,
    outside of the mesh's closed parts.

    Args:
        mesh: the hits of the mesh's surfaces.
        hull: the hits of the hull, on the same lattice.
        height: the least height of room [m].
    """
    # A line enters the hull at a hit that faces down: room may begin there. It leaves at a hit that
    # faces up: room may end there. In the mesh, room begins over a hit that faces up, whatever is
    # above it, and ends under one that faces down.
    hull_faces_up = (hull.normal[:, 2] > 0).astype(np.int64)
    mesh_faces_up = (mesh.normal[:, 2] > 0).astype(np.int64)
    begins = np.concatenate([NEEDS_CEILING * (1 - hull_faces_up), ROOM_OVER_FLOOR * mesh_faces_up])
    ends = np.concatenate([hull_faces_up, 1 - mesh_faces_up])
    # By how many closed parts a line is deeper inside above the hit
    mesh_depth = np.where(mesh.hits.closed == OPEN_SURFACE, 0, 1 - 2 * mesh_faces_up)
    depth_changes = np.concatenate([np.zeros_like(hull_faces_up), mesh_depth])
    cell = np.concatenate([_cells_of_hits(hull), _cells_of_hits(mesh)])
    z = np.concatenate([hull.z, mesh.z])
    order = np.lexsort((ends, z, cell))
    cell = cell[order]
    z = z[order]
    begins = begins[order]
    ends = ends[order]
    depth = np.cumsum(depth_changes[order])
    # less the depth at the end of the cells before
    depth -= np.concatenate([[0], depth])[np.searchsorted(cell, cell)]
    is_high = (cell[1:] == cell[:-1]) & (np.diff(z) >= height - LIMIT_SLACK)
    is_outside = depth[:-1] <= 0
    is_over_floor = begins[:-1] == ROOM_OVER_FLOOR
    is_below_ceiling = (begins[:-1] == NEEDS_CEILING) & (ends[1:] >= 1)
    is_room = is_high & is_outside & (is_over_floor | is_below_ceiling)
    has_room = np.zeros(len(mesh.start) - 1, dtype=np.bool_)
    has_room[cell[:-1][is_room]] = True
    return has_room


def _cells_of_hits(columns: Columns) -> Int:
    """The cell of each hit."""
    return np.repeat(np.arange(len(columns.start) - 1), np.diff(columns.start))
