"""Finds movable bodies (a bridge, a stage) whose tops would be floor if they could not move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.core.windows import clip_boxes
from navbake.baker.floors.levels import LevelFloor
from navbake.baker.floors.surfaces import find_standable_tops
from navbake.baker.geometry.shapes import Shapes
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Int

# The top of a movable body is worth a warning if at least this area of it would be floor [m²]
MIN_LOST_AREA = 1.0


def find_lost_floors(
    shapes: Shapes,
    is_checked: Bool,
    mover_of_geom: Int,
    levels: Sequence[LevelFloor],
    lattice: Lattice,
    agent: AgentSettings,
) -> dict[int, float]:
    """Find the movable bodies (a bridge, a stage) whose tops would be floor if they could not move.

    Args:
        shapes: all geometry that the bake uses.
        is_checked: for each geom, whether it is one of the movable geoms to check, shape (ngeom,),
            bool.
        mover_of_geom: for each geom, the id of the body that it moves with, shape (ngeom,).
        levels: the levels with the floors that structure makes.
        lattice: the lattice of the floors.
        agent: the agent that would stand on the tops.

    Returns:
        Body id -> the area of the body's top where structure has no floor below it [m²]. Bodies
        with less than `MIN_LOST_AREA` are left out.
    """
    min_area = MIN_LOST_AREA - LIMIT_SLACK
    cell_area = lattice.cell_size**2
    geom_of_box = shapes.geom_of_box
    is_checked_box = is_checked[geom_of_box]
    # an endless geom counts as far as the lattice reaches
    boxes = clip_boxes(lattice, shapes.boxes[is_checked_box], 0.0)
    movers = mover_of_geom[geom_of_box[is_checked_box]]
    box_areas = np.maximum(boxes[:, 3:5] - boxes[:, :2], 0.0).prod(axis=1)
    large_movers = np.flatnonzero(np.bincount(movers, box_areas) >= min_area)
    area_of_mover = dict[int, float]()
    for mover in large_movers.tolist():
        mover_boxes = boxes[movers == mover]
        lowest_corner = mover_boxes[:, :3].min(axis=0)
        highest_corner = mover_boxes[:, 3:].max(axis=0)
        window = lattice.window(np.stack([lowest_corner, highest_corner]))
        if window is None:
            continue
        # first a bound that is quickly found: no floor anywhere below the mover's highest point
        has_no_floor = np.ones(lattice.cut(*window).shape, dtype=np.bool_)
        for level in levels:
            has_no_floor &= ~(level.floor[window] <= highest_corner[2])
        if np.count_nonzero(has_no_floor) * cell_area < min_area:
            continue
        mover_shapes = shapes.only(is_checked & (mover_of_geom == mover))
        top_height = find_standable_tops(mover_shapes, lattice.cut(*window), agent)
        is_lost_floor = ~np.isnan(top_height)
        for level in levels:
            is_lost_floor &= ~(level.floor[window] <= top_height)
        area = np.count_nonzero(is_lost_floor) * cell_area
        if area >= min_area:
            area_of_mover[mover] = area
    return area_of_mover
