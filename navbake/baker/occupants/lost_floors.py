"""What can move and would be floor: a bridge, a stage, over which the grid then has none."""

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

# The least floor on something that can move that is worth a warning [m²]
LEAST_FLOOR = 1.0


def find_lost_floors(
    shapes: Shapes,
    chosen: Bool,
    mover_of: Int,
    levels: Sequence[LevelFloor],
    lattice: Lattice,
    agent: AgentSettings,
) -> dict[int, float]:
    """Find the bodies that can move whose tops would be floor where what stands has none below.

    Args:
        shapes: all geometry that counts.
        chosen: by geom id, whether it can move and is looked at.
        mover_of: by geom id, the body that it moves with.

    Returns:
        The area of each body's top over no floor, `LEAST_FLOOR` or more, by body id [m²].
    """
    geoms = shapes.boxed_geoms
    is_chosen = chosen[geoms]
    # what is endless is looked at on the lattice
    boxes = clip_boxes(lattice, shapes.boxes[is_chosen], 0.0)
    movers = mover_of[geoms[is_chosen]]
    size = np.clip(boxes[:, 3:5] - boxes[:, :2], 0.0, None).prod(axis=1)
    large = np.flatnonzero(np.bincount(movers, size) >= LEAST_FLOOR - LIMIT_SLACK)
    areas = dict[int, float]()
    for mover in large.tolist():
        own = boxes[movers == mover]
        low = own[:, :3].min(axis=0)
        high = own[:, 3:].max(axis=0)
        window = lattice.window(np.stack([low, high]))
        if window is None:
            continue
        bare = np.ones(lattice.cut(*window).shape, dtype=np.bool_)
        for level in levels:
            bare &= ~(level.floor[window] <= high[2])
        if np.count_nonzero(bare) * lattice.cell_size**2 < LEAST_FLOOR - LIMIT_SLACK:
            continue
        top = find_standable_tops(
            shapes.only(chosen & (mover_of == mover)), lattice.cut(*window), agent
        )
        bare = ~np.isnan(top)
        for level in levels:
            bare &= ~(level.floor[window] <= top)
        area = np.count_nonzero(bare) * lattice.cell_size**2
        if area >= LEAST_FLOOR - LIMIT_SLACK:
            areas[mover] = area
    return areas
