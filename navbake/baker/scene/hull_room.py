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
from navbake.baker.core.limits import AgentLimits, make_agent_limits
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.scene.collect import GeomSelection, MeshTriangles, collect_shapes
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.lazy import lazy
from navbake.navgrid.islands import label_islands
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Int

if TYPE_CHECKING:
    import mujoco

ndimage = lazy("scipy.ndimage")  # only for a wide and long top

# The distance between the vertical lines on which room is searched for; larger for large meshes [m]
LINE_SPACING = 0.1
MAX_LINES = 10_000  # about the most lines that are searched for a mesh
# A mesh counts by its triangles if its hull hides at least this area of ground, more than a step
# below the hull [m²]
MIN_GROUND_AREA = 1.0
# A surface of a thing is its top if it is narrower, and drops along this share of its outline: as
# the floors of a scene are
MAX_TOP_WIDTH = 3.0  # [m]
MIN_DROP_SHARE = 0.25
# Directions that are up in a mesh's frame are equal if they are after rounding
UP_DECIMALS = 9
# What a hull hides, as warnings call it
STANDING_ROOM_TEXT = "room to stand in"
DEEPER_GROUND_TEXT = "ground that is more than a step deeper"

# The kind of room that may begin above a hit: room that needs a ceiling, or room above a floor; 0
# for neither
NEEDS_CEILING = 1
ROOM_OVER_FLOOR = 2


@dataclass(eq=False)
class HullRoomTest:
    """Tests what the convex hull of a mesh would hide: room for an agent, or ground.

    MuJoCo collides a mesh as its hull. The hull of a building fills its rooms, and that of a
    terrain covers its valleys.

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
    # Size of each geom's bounding box along x, y and z [m]
    _box_sizes: list[list[float]] = field(init=False)

    def __post_init__(self) -> None:
        """Measure the geoms' boxes."""
        all_geoms = np.arange(len(self.model.geom_aabb))
        self._box_sizes = _measure_boxes(self.model, self.data, all_geoms)

    def find_hidden(self, geom: int) -> str:
        """Return a text that says whether the hull of a mesh geom hides room or ground.

        Room is a stretch of a vertical line inside the hull and outside of closed parts of the
        mesh, at least as long as the agent is high. It must have a floor or a ceiling (begin at a
        surface that faces up, or end at one that faces down), unless the line meets no surface of
        the mesh. The lines with room have to cover as much area as a floor needs
        (`floors.min_area` after `floors.shrink`).

        Ground is the uppermost surface of a mesh that can't move, where it is no steeper than the
        agent's slope and more than a step below the hull. It is reported only if its area is at
        least `MIN_GROUND_AREA`, and if it is not the top of a thing, such as the seat of a couch
        (see `_mark_tops`).

        Args:
            geom: id of a mesh geom.

        Returns:
            STANDING_ROOM_TEXT, DEEPER_GROUND_TEXT, or an empty text if the hull hides neither.
        """
        if not self.is_large(geom) and not self._may_hide_ground(geom):
            return ""
        up_in_mesh_frame = np.round(self.data.geom_xmat[geom].reshape(3, 3)[2], UP_DECIMALS) + 0.0
        key = (int(self.model.geom_dataid[geom]), up_in_mesh_frame.tobytes())
        if key not in self._hidden:
            self._hidden[key] = self._search_hull(geom)
        return self._hidden[key]

    def _may_hide_ground(self, geom: int) -> bool:
        """Whether a mesh geom can't move, and its bounding box is large enough for ground."""
        body = int(self.model.geom_bodyid[geom])
        if self.model.body_weldid[body] != 0 or self.model.body_mocapid[body] >= 0:
            return False
        width, depth, height = self._box_sizes[geom]
        is_wide = width * depth >= MIN_GROUND_AREA - LIMIT_SLACK
        return is_wide and height > self.agent.traversable_floor_height

    def is_large(self, geom: int) -> bool:
        """Return whether the bounding box of a mesh geom is large enough for room to stand in.

        It has to be as high as the agent, and as large as a floor, see `find_hidden`.
        """
        return _has_room(self._box_sizes[geom], self.agent, self.floors)

    def _search_hull(self, geom: int) -> str:
        """Find what the hull of a mesh geom hides, see `find_hidden`, by casting vertical lines."""
        hull_shapes = self._collect(geom, "hull")
        bounds = hull_shapes.bounds
        if bounds is None or not np.isfinite(bounds).all():
            return ""
        is_large = self.is_large(geom)
        if not is_large and _measure_shadow(hull_shapes) < MIN_GROUND_AREA - LIMIT_SLACK:
            return ""
        mesh_shapes = self._collect(geom, "surface")
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
        if is_large and is_large_enough(lattice, self.floors, has_room):
            return STANDING_ROOM_TEXT
        if not self._may_hide_ground(geom):
            return ""
        limits = make_agent_limits(self.agent)
        is_gentle, top_z = _find_uppermost_surface(mesh_columns, limits)
        is_ground = is_gentle & ~_mark_tops(is_gentle, top_z, lattice, limits, bounds[0, 2])
        is_ground &= _find_depth(mesh_columns, hull_columns) > limits.max_step + LIMIT_SLACK
        ground_area = is_ground.sum() * lattice.cell_size**2
        return DEEPER_GROUND_TEXT if ground_area >= MIN_GROUND_AREA - LIMIT_SLACK else ""

    def _collect(self, geom: int, mesh_mode: str) -> Shapes:
        selection = {geom: GeomSelection(True, "", mesh_mode)}
        shapes, *_ = collect_shapes(
            self.model, self.data, selection, {}, geom_ids=selection, meshes=self.meshes
        )
        return shapes


def are_any_large(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    geoms: Int,
    agent: AgentSettings,
    floors: FloorSettings,
) -> bool:
    """Return whether any of some mesh geoms is large enough for room, see `HullRoomTest.is_large`.

    Args:
        model: the model.
        data: the model's pose.
        geoms: ids of the geoms, (n,).
        agent: the agent that needs the room.
        floors: the settings that say how large a floor has to be.
    """
    return any(_has_room(size, agent, floors) for size in _measure_boxes(model, data, geoms))


def _has_room(box_size: list[float], agent: AgentSettings, floors: FloorSettings) -> bool:
    """Return whether a box is as high as an agent, and as large as a floor has to be.

    Args:
        box_size: the box's size along x, y and z [m].
        agent: the agent.
        floors: the settings that say how large a floor has to be.
    """
    width, depth, height = box_size
    floor_width = width - 2 * floors.shrink
    floor_depth = depth - 2 * floors.shrink
    if min(floor_width, floor_depth) < 0 or height < agent.height - LIMIT_SLACK:
        return False
    return floor_width * floor_depth >= floors.min_area - LIMIT_SLACK


def _measure_boxes(model: mujoco.MjModel, data: mujoco.MjData, geoms: Int) -> list[list[float]]:
    """Measure the boxes round some geoms along x, y and z [m]; 0 if a pose isn't finite."""
    rotations = data.geom_xmat[geoms].reshape(-1, 3, 3)
    is_finite = np.isfinite(rotations).all(axis=(1, 2), keepdims=True)
    half_sizes = model.geom_aabb[geoms, 3:, np.newaxis]
    box_sizes = 2.0 * np.abs(np.where(is_finite, rotations, 0.0)) @ half_sizes
    # Floats of Python, as NumPy's would warn of an area beyond all floats.
    box_size_lists: list[list[float]] = box_sizes[:, :, 0].tolist()
    return box_size_lists


def _measure_shadow(hull_shapes: Shapes) -> float:
    """Return the area that a convex hull covers, seen from above [m²]."""
    (hull,) = hull_shapes.meshes.triangles
    x, y = np.moveaxis(hull.vertices[hull.faces][:, :, :2], 2, 0)
    # twice the area of each face, seen from above; negative for faces that face down
    double_areas = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0])
    double_areas -= (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    return float(np.abs(double_areas).sum()) / 4


def _mark_room(mesh_columns: Columns, hull_columns: Columns, min_height: float) -> Bool:
    """Mark the cells on whose vertical line a mesh's hull hides room for an agent.

    See `HullRoomTest.find_hidden` for what room is. The hits of a line are sorted by z. For each
    hit, it is known what room may begin above it, and whether room may end at it. The stretch of
    the line between two hits is room if room may begin at the lower hit. Where room needs a
    ceiling, room must also be able to end at the upper hit. The stretch has to be outside of the
    mesh's closed parts.

    Args:
        mesh_columns: the hits of the mesh's surfaces.
        hull_columns: the hits of the hull, on the same lattice.
        min_height: the least height of room [m].

    Returns:
        For each cell of the lattice, whether there is room, shape (cells,).
    """
    # Upwards, a line enters the hull at a hit that faces down: room may begin there. It leaves the
    # hull at a hit that faces up: room may end there. In the mesh, room begins above a hit that
    # faces up, whatever is above it, and ends below one that faces down.
    hull_faces_up = (hull_columns.normal[:, 2] > 0).astype(np.int64)
    mesh_faces_up = (mesh_columns.normal[:, 2] > 0).astype(np.int64)
    room_begin_kind = np.concatenate(
        [NEEDS_CEILING * (1 - hull_faces_up), ROOM_OVER_FLOOR * mesh_faces_up]
    )
    can_room_end = np.concatenate([hull_faces_up, 1 - mesh_faces_up])
    # How the number of closed parts that the line is in changes at a hit: +1, -1 or 0
    mesh_depth_change = np.where(mesh_columns.hits.closed == OPEN_SURFACE, 0, 1 - 2 * mesh_faces_up)
    closed_part_changes = np.concatenate([np.zeros_like(hull_faces_up), mesh_depth_change])
    cell_of_hit = np.concatenate(
        [_list_cells_of_hits(hull_columns), _list_cells_of_hits(mesh_columns)]
    )
    z = np.concatenate([hull_columns.z, mesh_columns.z])
    sort_indices = np.lexsort((can_room_end, z, cell_of_hit))
    cell_of_hit = cell_of_hit[sort_indices]
    z = z[sort_indices]
    room_begin_kind = room_begin_kind[sort_indices]
    can_room_end = can_room_end[sort_indices]
    num_closed_parts = np.cumsum(closed_part_changes[sort_indices])
    # Each cell starts at depth 0: subtract the depth at the end of the previous cell.
    num_closed_parts -= np.concatenate([[0], num_closed_parts])[
        np.searchsorted(cell_of_hit, cell_of_hit)
    ]
    is_high_enough = (cell_of_hit[1:] == cell_of_hit[:-1]) & (
        np.diff(z) >= min_height - LIMIT_SLACK
    )
    is_outside = num_closed_parts[:-1] <= 0
    is_over_floor = room_begin_kind[:-1] == ROOM_OVER_FLOOR
    is_below_ceiling = (room_begin_kind[:-1] == NEEDS_CEILING) & (can_room_end[1:] >= 1)
    is_room = is_high_enough & is_outside & (is_over_floor | is_below_ceiling)
    has_room = np.zeros(len(mesh_columns.start) - 1, dtype=np.bool_)
    has_room[cell_of_hit[:-1][is_room]] = True
    return has_room


def _find_uppermost_surface(mesh_columns: Columns, limits: AgentLimits) -> tuple[Bool, Float]:
    """Find the uppermost surface of a mesh on the vertical line of each cell.

    Args:
        mesh_columns: the hits of the mesh's surfaces.
        limits: the agent's limits, of which the slope is used.

    Returns:
        Whether the surface is no steeper than the agent's slope, shape (cells,); and its height,
        NaN for cells without a hit, shape (cells,) [m].
    """
    is_gentle = np.zeros(len(mesh_columns.start) - 1, dtype=np.bool_)
    top_z = np.full(len(mesh_columns.start) - 1, np.nan)
    cells = np.flatnonzero(np.diff(mesh_columns.start) > 0)
    top_hits = mesh_columns.start[cells + 1] - 1
    is_gentle[cells] = mesh_columns.normal[top_hits, 2] >= limits.min_normal_z
    top_z[cells] = mesh_columns.z[top_hits]
    return is_gentle, top_z


def _find_depth(mesh_columns: Columns, hull_columns: Columns) -> Float:
    """Return how deep below the hull the mesh's uppermost surface is, shape (cells,) [m].

    It is 0 in cells whose line misses the mesh or its hull.
    """
    depth = np.zeros(len(mesh_columns.start) - 1)
    cells = np.flatnonzero((np.diff(mesh_columns.start) > 0) & (np.diff(hull_columns.start) > 0))
    depth[cells] = (
        hull_columns.z[hull_columns.start[cells + 1] - 1]
        - mesh_columns.z[mesh_columns.start[cells + 1] - 1]
    )
    return depth


def _mark_tops(
    is_gentle: Bool, top_z: Float, lattice: Lattice, limits: AgentLimits, bottom: float
) -> Bool:
    """Mark the cells of surfaces that are tops of a thing, such as the seat of a couch.

    A surface consists of neighbouring cells whose heights differ by at most a step. It is a top if
    it is more than a step above the bottom of the mesh everywhere, a quarter of its outline drops
    by more than a step, and it is nowhere wider than `MAX_TOP_WIDTH`. Beside the mesh, the floor is
    taken to be at the mesh's bottom.

    Args:
        is_gentle: whether the uppermost surface of each cell is within the agent's slope, (cells,).
        top_z: the height of that surface, NaN for none, (cells,) [m].
        lattice: the cells.
        limits: the agent's limits, of which the step is used.
        bottom: the height of the mesh's bottom [m].
    """
    surface_of_cell = label_islands(
        first_cells=np.array([0, len(is_gentle)]),
        widths=np.array([lattice.width]),
        is_free=is_gentle,
        floor=top_z,
        max_rise=limits.max_step + LIMIT_SLACK,
        steps=np.empty((0, 2), dtype=np.int64),
    ).reshape(lattice.height, lattice.width)
    # a rim of cells beside the mesh
    padded_surfaces = np.pad(surface_of_cell, 1)
    padded_height = np.pad(np.nan_to_num(top_z, nan=bottom).reshape(surface_of_cell.shape), 1)
    padded_height[[0, -1]] = bottom
    padded_height[:, [0, -1]] = bottom
    num_outline_edges = np.zeros(padded_surfaces.max() + 1, dtype=np.int64)
    num_drops = np.zeros(padded_surfaces.max() + 1, dtype=np.int64)
    for axis, roll_shift in ((0, 1), (0, -1), (1, 1), (1, -1)):
        is_outline_edge = np.roll(padded_surfaces, roll_shift, axis) != padded_surfaces
        is_drop = is_outline_edge & (
            padded_height - np.roll(padded_height, roll_shift, axis) > limits.max_step + LIMIT_SLACK
        )
        num_outline_edges += np.bincount(
            padded_surfaces[is_outline_edge], minlength=len(num_outline_edges)
        )
        num_drops += np.bincount(padded_surfaces[is_drop], minlength=len(num_drops))
    lowest_of_surface = np.full(len(num_outline_edges), np.inf)
    np.minimum.at(lowest_of_surface, padded_surfaces.ravel(), padded_height.ravel())
    is_top = num_drops >= MIN_DROP_SHARE * num_outline_edges
    is_top &= lowest_of_surface > bottom + limits.max_step + LIMIT_SLACK
    is_top[0] = False  # cells of no surface
    for surface in np.flatnonzero(is_top).tolist():
        is_in_surface = padded_surfaces == surface
        rows, cols = np.nonzero(is_in_surface)
        if (min(np.ptp(rows), np.ptp(cols)) + 1) * lattice.cell_size < MAX_TOP_WIDTH:
            continue  # no surface is wider than the box around it; most tops of furniture end here
        # an edge of the surface is half a cell from the centre of its outermost cell
        distances = ndimage.distance_transform_edt(is_in_surface)
        half_width = (distances.max() - 0.5) * lattice.cell_size
        is_top[surface] = 2 * half_width < MAX_TOP_WIDTH
    is_top_cell: Bool = is_top[surface_of_cell.ravel()]
    return is_top_cell


def _list_cells_of_hits(columns: Columns) -> Int:
    """Return the id of the cell of each hit, shape (hits,)."""
    return np.repeat(np.arange(len(columns.start) - 1), np.diff(columns.start))
