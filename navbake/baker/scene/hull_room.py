"""Whether the hull of a mesh hides room for an agent, as that of a whole building does."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from navbake.baker.columns.columns import Columns, cast_columns, tile_shapes
from navbake.baker.core.area_test import is_large_enough
from navbake.baker.core.constants import OPEN_SURFACE
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.scene.collect import GeomSelection, MeshTriangles, collect_shapes
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool

# The spacing of the lines by which room in a hull is found, unless there would be too many [m]
SPACING = 0.1
MOST_LINES = 10_000


@dataclass(eq=False)
class HullRoomTest:
    """Finds the meshes of a posed model whose hulls hide room for an agent."""

    model: Any
    data: Any
    meshes: MeshTriangles
    agent: AgentSettings
    floors: FloorSettings
    _answers: dict[tuple[int, bytes], bool] = field(default_factory=dict, init=False)

    def hides_room(self, geom: int) -> bool:
        """Whether a mesh's hull hides room for an agent to stand in.

        Room is a free stretch of a vertical line inside of the hull, at least as long as the agent
        is high: over a surface that faces up, or under one that faces down, or where the mesh has
        none; but not inside of the mesh's closed parts. It has to be as large as a floor
        (`floors.min_area` after `floors.shrink`).
        """
        if not self.is_large(geom):
            return False
        key = int(self.model.geom_dataid[geom]), self.data.geom_xmat[geom].tobytes()
        if key not in self._answers:
            self._answers[key] = self._look(geom)
        return self._answers[key]

    def is_large(self, geom: int) -> bool:
        """Whether the box of a mesh is large enough for room."""
        mat = self.data.geom_xmat[geom].reshape(3, 3)
        if not np.isfinite(mat).all():
            return False
        x, y, z = 2 * np.abs(mat) @ self.model.geom_aabb[geom, 3:]
        # floats of Python: NumPy's warn of an area beyond all floats
        left = [float(side) - 2 * self.floors.shrink for side in (x, y)]
        if min(left) < 0 or z < self.agent.height - LIMIT_SLACK:
            return False
        return left[0] * left[1] >= self.floors.min_area - LIMIT_SLACK

    def _look(self, geom: int) -> bool:
        chosen = [{geom: GeomSelection(True, "", mode)} for mode in ("surface", "hull")]
        shapes = [
            collect_shapes(self.model, self.data, one, {}, one, self.meshes)[0] for one in chosen
        ]
        bounds = shapes[1].bounds
        if bounds is None or not np.isfinite(bounds).all():
            return False
        x0, y0, x1, y1 = bounds[:, :2].ravel().tolist()
        width = x1 - x0
        depth = y1 - y0
        # a limit for a long and thin box, too
        by_area = math.sqrt(width * depth / MOST_LINES)
        by_length = max(width, depth) / MOST_LINES
        spacing = max(SPACING, by_area, by_length)
        lattice = Lattice.cover((x0, y0, x1, y1), spacing)
        in_mesh, in_hull = (cast_columns(tile_shapes(one, lattice, spacing / 2)) for one in shapes)
        has_room = _find_room(in_mesh, in_hull, self.agent.height)
        return is_large_enough(lattice, self.floors, has_room)


def _find_room(mesh: Columns, hull: Columns, height: float) -> Bool:
    """Mark the cells on whose line there is room; see `HullRoomTest.hides_room`."""
    # a line enters the hull (starts = 1) and leaves it (ends = 1), which turns nothing inside; in
    # the mesh, room is over what faces up (starts = 2) and under what faces down (ends = 1)
    up = (mesh.normal[:, 2] > 0).astype(np.int64)
    hull_up = (hull.normal[:, 2] > 0).astype(np.int64)
    turned = np.where(mesh.hits.closed == OPEN_SURFACE, 0, 1 - 2 * up)
    cells = [np.repeat(np.arange(len(c.start) - 1), np.diff(c.start)) for c in (hull, mesh)]
    marks = (1 - hull_up, 2 * up), (hull_up, 1 - up), (np.zeros_like(hull_up), turned)
    pairs = cells, (hull.z, mesh.z), *marks
    cell, z, starts, ends, turns = (np.concatenate(pair) for pair in pairs)
    order = np.lexsort((ends, z, cell))
    cell = cell[order]
    z = z[order]
    starts = starts[order]
    ends = ends[order]
    turns = turns[order]
    inside = np.cumsum(turns)
    inside -= np.concatenate([[0], inside])[np.searchsorted(cell, cell)]  # what went on before it
    is_gap = (cell[1:] == cell[:-1]) & (np.diff(z) >= height - LIMIT_SLACK) & (inside[:-1] <= 0)
    lower = starts[:-1]
    upper = ends[1:]
    is_room = is_gap & ((lower == 2) | ((lower == 1) & (upper >= 1)))
    marked = np.zeros(len(mesh.start) - 1, dtype=np.bool_)
    marked[cell[:-1][is_room]] = True
    return marked
