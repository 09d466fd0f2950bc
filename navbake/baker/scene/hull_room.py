"""Finds meshes whose convex hull hides room or ground, such as buildings and terrain.

MuJoCo collides such a mesh as its hull, which would fill the rooms of a building.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from navbake.baker.columns.columns import Columns, cast_columns, tile_shapes
from navbake.baker.core.area_test import is_large_enough
from navbake.baker.core.constants import OPEN_SURFACE
from navbake.baker.core.limits import AgentLimits, agent_limits
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.scene.collect import GeomSelection, MeshTriangles, collect_shapes
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Int

if TYPE_CHECKING:
    import mujoco

# The distance between the vertical lines on which room is searched for; larger for large meshes [m]
LINE_SPACING = 0.1
MAX_LINES = 10_000  # about the most lines that are searched for a mesh
# A mesh counts by its triangles if its hull hides at least this area of ground, more than a step
# below the hull [m²]
MIN_GROUND_AREA = 1.0
# Directions that are up in a mesh's frame are equal if they are after rounding
UP_DECIMALS = 9
# What a hull hides, as warnings call it
ROOM = "room to stand in"
GROUND = "ground that is more than a step deeper"

# What may begin above a hit: room that needs a ceiling, or room above a floor; 0 for neither
NEEDS_CEILING = 1
ROOM_OVER_FLOOR = 2


@dataclass(eq=False)
class HullRoomTest:
    """Tests whether the hull of a mesh hides room for an agent, or ground, in a posed model.

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
    # Id of a mesh and the direction that is up in its frame, as bytes -> what its hull hides;
    # turning a mesh about the vertical changes nothing
    _hidden: dict[tuple[int, bytes], str] = field(default_factory=dict, init=False)

    def find_hidden(self, geom: int) -> str:
        """Return what the hull of a mesh geom hides: ROOM, GROUND, or an empty text for nothing.

        Room is a free stretch of a vertical line that is at least as long as the agent is high. It
        is inside the hull and outside of closed parts of the mesh. It begins at a surface that
        faces up, or ends at one that faces down; or the line meets no surface of the mesh at all.
        The lines with room have to cover as much area as a floor needs (`floors.min_area` after
        `floors.shrink`).

        Ground is the uppermost surface of a mesh that can't move, where it is no steeper than the
        agent's slope, and more than a step below the hull. It counts from `MIN_GROUND_AREA` on.

        Args:
            geom: id of a mesh geom.
        """
        if not self.is_large(geom) and not self._may_hide_ground(geom):
            return ""
        up = np.round(self.data.geom_xmat[geom].reshape(3, 3)[2], UP_DECIMALS) + 0.0
        key = (int(self.model.geom_dataid[geom]), up.tobytes())
        if key not in self._hidden:
            self._hidden[key] = self._search_hull(geom)
        return self._hidden[key]

    def _box_size(self, geom: int) -> tuple[float, float, float]:
        """The size of a mesh geom's bounding box, x, y and z [m]; 0 if its pose isn't finite."""
        rotation = self.data.geom_xmat[geom].reshape(3, 3)
        if not np.isfinite(rotation).all():
            return (0.0, 0.0, 0.0)
        # Floats of Python, as NumPy's would warn of an area beyond all floats.
        width, depth, height = (2 * np.abs(rotation) @ self.model.geom_aabb[geom, 3:]).tolist()
        return (width, depth, height)

    def _may_hide_ground(self, geom: int) -> bool:
        """Whether a mesh geom can't move, and its bounding box is large enough for ground."""
        body = int(self.model.geom_bodyid[geom])
        if self.model.body_weldid[body] != 0 or self.model.body_mocapid[body] >= 0:
            return False
        width, depth, height = self._box_size(geom)
        is_wide = width * depth >= MIN_GROUND_AREA - LIMIT_SLACK
        return is_wide and height > self.agent.traversable_floor_height

    def is_large(self, geom: int) -> bool:
        """Return whether the bounding box of a mesh geom is large enough for room to stand in.

        It has to be as high as the agent, and as large as a floor, see `find_hidden`.
        """
        width, depth, height = self._box_size(geom)
        floor_width = width - 2 * self.floors.shrink
        floor_depth = depth - 2 * self.floors.shrink
        if min(floor_width, floor_depth) < 0 or height < self.agent.height - LIMIT_SLACK:
            return False
        return floor_width * floor_depth >= self.floors.min_area - LIMIT_SLACK

    def _search_hull(self, geom: int) -> str:
        """Find what the hull of a mesh geom hides, see `find_hidden`, by casting vertical lines."""
        mesh_shapes = self._collect(geom, "surface")
        hull_shapes = self._collect(geom, "hull")
        bounds = hull_shapes.bounds
        if bounds is None or not np.isfinite(bounds).all():
            return ""
        x_min, y_min, x_max, y_max = bounds[:, :2].ravel().tolist()
        width = x_max - x_min
        depth = y_max - y_min
        # Spacing by length is larger for a long and thin box.
        spacing_by_area = math.sqrt(width * depth / MAX_LINES)
        spacing_by_length = max(width, depth) / MAX_LINES
        spacing = max(LINE_SPACING, spacing_by_area, spacing_by_length)
        lattice = Lattice.cover((x_min, y_min, x_max, y_max), spacing)
        mesh_columns = cast_columns(tile_shapes(mesh_shapes, lattice, spacing / 2))
        hull_columns = cast_columns(tile_shapes(hull_shapes, lattice, spacing / 2))
        has_room = _mark_room(mesh_columns, hull_columns, self.agent.height)
        if self.is_large(geom) and is_large_enough(lattice, self.floors, has_room):
            return ROOM
        if not self._may_hide_ground(geom):
            return ""
        is_ground = _mark_ground(mesh_columns, hull_columns, agent_limits(self.agent))
        ground_area = is_ground.sum() * lattice.cell_size**2
        return GROUND if ground_area >= MIN_GROUND_AREA - LIMIT_SLACK else ""

    def _collect(self, geom: int, mesh_mode: str) -> Shapes:
        selection = {geom: GeomSelection(True, "", mesh_mode)}
        shapes, *_ = collect_shapes(
            self.model, self.data, selection, {}, geom_ids=selection, meshes=self.meshes
        )
        return shapes


def _mark_room(mesh: Columns, hull: Columns, height: float) -> Bool:
    """Mark the cells on whose vertical line a mesh's hull hides room for an agent.

    See `HullRoomTest.find_hidden`. The hits of a line are sorted by z. For each hit, it is known
    what room may begin above it, and whether room may end at it. The stretch of the line between
    two hits is room if room may begin at the lower hit and, where room needs a ceiling, may end at
    the upper one; it has to be outside of the mesh's closed parts.

    Args:
        mesh: the hits of the mesh's surfaces.
        hull: the hits of the hull, on the same lattice.
        height: the least height of room [m].

    Returns:
        For each cell of the lattice, whether there is room, shape (cells,).
    """
    # Upwards, a line enters the hull at a hit that faces down: room may begin there. It leaves the
    # hull at a hit that faces up: room may end there. In the mesh, room begins above a hit that
    # faces up, whatever is above it, and ends below one that faces down.
    hull_faces_up = (hull.normal[:, 2] > 0).astype(np.int64)
    mesh_faces_up = (mesh.normal[:, 2] > 0).astype(np.int64)
    begins = np.concatenate([NEEDS_CEILING * (1 - hull_faces_up), ROOM_OVER_FLOOR * mesh_faces_up])
    ends = np.concatenate([hull_faces_up, 1 - mesh_faces_up])
    # How the number of closed parts that the line is in changes at a hit: +1, -1 or 0
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
    # Each cell starts at depth 0: subtract the depth at the end of the previous cell.
    depth -= np.concatenate([[0], depth])[np.searchsorted(cell, cell)]
    is_high_enough = (cell[1:] == cell[:-1]) & (np.diff(z) >= height - LIMIT_SLACK)
    is_outside = depth[:-1] <= 0
    is_over_floor = begins[:-1] == ROOM_OVER_FLOOR
    is_below_ceiling = (begins[:-1] == NEEDS_CEILING) & (ends[1:] >= 1)
    is_room = is_high_enough & is_outside & (is_over_floor | is_below_ceiling)
    has_room = np.zeros(len(mesh.start) - 1, dtype=np.bool_)
    has_room[cell[:-1][is_room]] = True
    return has_room


def _mark_ground(mesh: Columns, hull: Columns, limits: AgentLimits) -> Bool:
    """Mark the cells in which the uppermost surface of a mesh is ground that its hull hides.

    It is no steeper than the agent's slope, and more than a step below the hull.

    Args:
        mesh: the hits of the mesh's surfaces.
        hull: the hits of the hull, on the same lattice.
        limits: the agent's limits: its slope and step.
    """
    is_ground = np.zeros(len(mesh.start) - 1, dtype=np.bool_)
    cells = np.flatnonzero((np.diff(mesh.start) > 0) & (np.diff(hull.start) > 0))
    mesh_top = mesh.start[cells + 1] - 1
    hull_top = hull.start[cells + 1] - 1
    is_gentle = mesh.normal[mesh_top, 2] >= limits.min_up
    is_deep = hull.z[hull_top] - mesh.z[mesh_top] > limits.step + LIMIT_SLACK
    is_ground[cells] = is_gentle & is_deep
    return is_ground


def _cells_of_hits(columns: Columns) -> Int:
    """Return the id of the cell of each hit, shape (hits,)."""
    return np.repeat(np.arange(len(columns.start) - 1), np.diff(columns.start))
