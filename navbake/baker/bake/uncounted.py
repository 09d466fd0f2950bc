"""Warns of drawn geoms that don't count, as they can't collide, but stand on free floor."""

from __future__ import annotations

import numpy as np

from navbake.baker.core.constants import PLANE
from navbake.baker.floors.levels import Floors
from navbake.baker.occupancy.volume_kernels import BLOCKING
from navbake.baker.occupants.movable import MovableSearchInputs, find_movable_occupants
from navbake.baker.scene.collect import (
    CANT_COLLIDE_REASON,
    COLLIDES_IN_PAIRS_REASON,
    GeomSelection,
    collect_shapes,
    mark_drawn,
)
from navbake.baker.scene.scene import Scene
from navbake.baker.scene.skies import geom_boxes
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Int

# A geom is warned of if it would block at least this area of free floor [m²], and if at least this
# fraction of the floor that it would block is free: drawn geoms often lie a little beside geoms
# that collide for them
MIN_UNCOUNTED_AREA = 0.04
MIN_FREE_FRACTION = 0.5
MAX_NAMED_GEOMS = 5  # geoms that the warning names
# Thinner geoms are textures and pictures on what collides for them [m]
MIN_THICKNESS = 0.02


def warn_uncounted(scene: Scene, inputs: MovableSearchInputs) -> list[str]:
    """Warn of drawn geoms that stand on free floor, but don't block it, because they can't collide.

    Such geoms don't count in the bake: their contype and conaffinity are 0. If they collide at all,
    it is with the geoms of a ``<contact><pair>``.

    Args:
        scene: the posed scene.
        inputs: the inputs of the search for movables: floors, and the cells that structure
            occupies.

    Returns:
        One warning, which names the largest things; or none.
    """
    is_candidate = mark_drawn_uncounted(scene)
    if not is_candidate.any():
        return []
    free_by_level = [
        level.standable & ~is_occupied
        for level, is_occupied in zip(
            inputs.floors.levels, inputs.structure_occupancy.levels, strict=True
        )
    ]
    is_candidate &= _mark_over_free_floor(
        scene, inputs.floors, free_by_level, inputs.lattice, inputs.agent
    )
    candidate_geoms = np.flatnonzero(is_candidate)
    if not len(candidate_geoms):
        return []
    selections = {
        geom: GeomSelection(True, "", scene.selections[geom].mesh_mode)
        for geom in candidate_geoms.tolist()
    }
    shapes, *_ = collect_shapes(
        scene.model,
        scene.data,
        selections,
        scene.exact_meshes,
        geom_ids=selections,
        meshes=scene.meshes,
    )
    occupants = find_movable_occupants(inputs, shapes, is_candidate)
    num_blocked_cells = np.zeros(len(is_candidate), dtype=np.int64)
    num_free_cells = np.zeros(len(is_candidate), dtype=np.int64)
    for is_level_free, chunks in zip(free_by_level, occupants.entries, strict=True):
        for entries in chunks:
            is_blocking = (entries.flags & BLOCKING) > 0
            geom_ids = entries.geom[is_blocking]
            is_free = is_level_free.ravel()[entries.cell[is_blocking]]
            num_blocked_cells += np.bincount(geom_ids, minlength=len(num_blocked_cells))
            num_free_cells += np.bincount(geom_ids[is_free], minlength=len(num_free_cells))
    free_area = num_free_cells * inputs.lattice.cell_size**2
    is_uncounted = (free_area >= MIN_UNCOUNTED_AREA) & (
        num_free_cells >= MIN_FREE_FRACTION * num_blocked_cells
    )
    uncounted_geoms = np.flatnonzero(is_uncounted)
    if not len(uncounted_geoms):
        return []
    largest_geoms = uncounted_geoms[np.argsort(-free_area[uncounted_geoms], kind="stable")][
        :MAX_NAMED_GEOMS
    ].tolist()
    names = ", ".join(
        f"{scene.geoms[geom].name!r} ({free_area[geom]:.2f} m²)" for geom in largest_geoms
    )
    reasons = {scene.selections[geom].reason for geom in uncounted_geoms.tolist()}
    reason_text = "they can't collide"
    if COLLIDES_IN_PAIRS_REASON in reasons:
        reason_text = (
            "their contype and conaffinity are 0 (a <contact><pair> is of two geoms alone)"
        )
    num_more = len(uncounted_geoms) - len(largest_geoms)
    more_text = f", and {num_more} more" if num_more else ""
    return [
        f"drawn on free floor, but not counted, as {reason_text}: {names}{more_text}; "
        f"`scene.geoms: all` counts everything, `scene.exclude.geoms` silences this"
    ]


def mark_drawn_uncounted(scene: Scene) -> Bool:
    """Mark the drawn geoms of structure that don't count as they can't collide, shape (ngeom,).

    So are those that collide in a ``<contact><pair>`` alone. Planes, and geoms thinner than
    `MIN_THICKNESS`, aren't marked. Where the marked geoms stand decides what `warn_uncounted` says.

    Args:
        scene: the scene; the mask does not depend on its pose.
    """
    reasons = [selection.reason for selection in scene.selections]
    is_candidate: Bool = np.isin(reasons, (CANT_COLLIDE_REASON, COLLIDES_IN_PAIRS_REASON))
    is_candidate &= mark_drawn(scene.model)
    is_candidate &= scene.is_structure_body[scene.mover_of_geom]
    is_candidate &= scene.model.geom_type != PLANE
    is_candidate &= 2.0 * scene.model.geom_aabb[:, 3:].min(axis=1) >= MIN_THICKNESS
    return is_candidate


def _mark_over_free_floor(
    scene: Scene, floors: Floors, free_by_level: list[Bool], lattice: Lattice, agent: AgentSettings
) -> Bool:
    """Mark the geoms whose bounding boxes lie over free floor, at a height where an agent would be.

    At least a quarter of the cells under the box have to be free on some level. Geoms around the
    whole scene, such as a sky, aren't marked.

    Args:
        scene: the posed scene.
        floors: the floors of all levels.
        free_by_level: the free cells of each level, (height, width).
        lattice: the whole lattice.
        agent: the agent, whose step and height are used.
    """
    lower_corners, upper_corners = geom_boxes(scene.model, scene.data)
    is_over_free_floor = np.zeros(len(lower_corners), dtype=np.bool_)
    is_around_all = np.zeros(len(lower_corners), dtype=np.bool_)  # as a sky is
    if scene.bounds is not None:
        is_around_all = (
            (lower_corners <= scene.bounds[0]) & (upper_corners >= scene.bounds[1])
        ).all(axis=1)
    with np.errstate(invalid="ignore"):
        first_col = np.floor((lower_corners[:, 0] - lattice.x_min) / lattice.cell_size)
        end_col = np.ceil((upper_corners[:, 0] - lattice.x_min) / lattice.cell_size)
        first_row = np.floor((lattice.y_max - upper_corners[:, 1]) / lattice.cell_size)
        end_row = np.ceil((lattice.y_max - lower_corners[:, 1]) / lattice.cell_size)
    window_limits = [
        np.clip(np.nan_to_num(limit), 0, length).astype(np.int64)
        for limit, length in (
            (first_row, lattice.height),
            (end_row, lattice.height),
            (first_col, lattice.width),
            (end_col, lattice.width),
        )
    ]
    num_cells = np.maximum(
        (window_limits[1] - window_limits[0]) * (window_limits[3] - window_limits[2]), 1
    )
    for level, is_level_free in zip(floors.levels, free_by_level, strict=True):
        heights = level.floor[is_level_free]
        if not len(heights):
            continue
        is_at_agent_height = upper_corners[:, 2] > heights.min() + agent.traversable_floor_height
        is_at_agent_height &= lower_corners[:, 2] < heights.max() + agent.height
        num_free_cells = _sum_windows(is_level_free, window_limits)
        is_over_free_floor |= is_at_agent_height & (
            num_free_cells >= MIN_FREE_FRACTION / 2 * num_cells
        )
    return is_over_free_floor & ~is_around_all


def _sum_windows(is_marked: Bool, window_limits: list[Int]) -> Int:
    """Count the marked cells in each of some windows.

    Args:
        is_marked: the marked cells, shape (height, width).
        window_limits: the first rows of the windows, the ends of their rows, their first columns,
            and the ends of their columns, shape (n,) each; ends are exclusive.

    Returns:
        How many cells are marked in each window, shape (n,).
    """
    first_row, end_row, first_col, end_col = window_limits
    cumulative_count = np.zeros((is_marked.shape[0] + 1, is_marked.shape[1] + 1), dtype=np.int64)
    np.cumsum(np.cumsum(is_marked, axis=0, dtype=np.int64), axis=1, out=cumulative_count[1:, 1:])
    num_marked_cells: Int = (
        cumulative_count[end_row, end_col] - cumulative_count[first_row, end_col]
    )
    num_marked_cells -= (
        cumulative_count[end_row, first_col] - cumulative_count[first_row, first_col]
    )
    return num_marked_cells
