"""What a user should know about the floors that were found, one line each."""

from __future__ import annotations

import numpy as np

from navbake.baker.floors.levels import DroppedSheet, Floors
from navbake.baker.scene.scene import Scene
from navbake.config.settings import BakeConfig

# From this size on one is told of a top that is no floor; beds are smaller [m²]
LARGE_TOP = 6.0


def remark_floors(scene: Scene, floors: Floors, config: BakeConfig) -> list[str]:
    """Tell of what might be meant as floor, and isn't any."""
    return [
        *_remark_tops(scene, floors.tops),
        *_remark_roofs(scene, floors.roofs),
        *_remark_planes(scene, floors, config),
    ]


def _remark_tops(scene: Scene, tops: list[DroppedSheet]) -> list[str]:
    large = [top for top in tops if top.area >= LARGE_TOP]
    if not large:
        return []
    return [
        f"no floor, because no step leads there: the top of {_place(scene, large)}; "
        "`floors.tops: true` makes it one"
    ]


def _remark_roofs(scene: Scene, roofs: list[DroppedSheet]) -> list[str]:
    if not roofs:
        return []
    return [
        f"left out as a roof, though it has walls: the top of {_place(scene, roofs)}; it is open "
        "to the sky and no step leads there: `floors.roofs: true` keeps it"
    ]


def _remark_planes(scene: Scene, floors: Floors, config: BakeConfig) -> list[str]:
    """Tell of an endless ground that lies lower than all that the grid has of floors."""
    if config.grid.bounds is not None or config.grid.margin > 0:
        return []
    planes = scene.shapes.planes
    lowest = min(float(np.nanmin(level.floor)) for level in floors.levels)
    step = config.agent.traversable_floor_height
    for geom, point, normal in zip(planes.geom, planes.pos, planes.normal, strict=True):
        if normal[2] >= 1.0 - 1e-9 and point[2] < lowest - step:
            return [
                f"{scene.geoms[geom].name!r} is endless, so the grid covers the other geoms' box, "
                f"which hides it: `grid.margin` or `grid.bounds` shows the ground at "
                f"{point[2]:.2f} m around them"
            ]
    return []


def _place(scene: Scene, tops: list[DroppedSheet]) -> str:
    first = tops[0]
    more = f", and {len(tops) - 1} more" if tops[1:] else ""
    name = scene.geoms[first.geom].name
    return f"{name!r} ({first.area:.1f} m² at {first.height:.2f} m{more})"
