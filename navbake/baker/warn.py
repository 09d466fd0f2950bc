"""The warnings of a bake, one line each."""

import numpy as np

from navbake.baker.boxes import LevelBoxes
from navbake.baker.floors.levels import DroppedSheet, Floors
from navbake.baker.scene.scene import Scene
from navbake.baker.stages import Stages
from navbake.config.settings import BakeConfig

# A top that is no floor is worth a warning from this area on; beds are smaller [m²]
LARGE_TOP = 6.0


def collect_warnings(stages: Stages) -> list[str]:
    """The warnings of all stages, in their order."""
    return [
        *stages.scene.warnings,
        *stages.unmatched,
        *warn_missing_floors(stages.scene, stages.floors, stages.config),
        *(stages.contents.warnings if stages.contents else ()),
        *stages.rooms.warnings,
        *stages.doors.warnings,
        *warn_interleaved(stages.floors, stages.boxes),
    ]


def warn_missing_floors(scene: Scene, floors: Floors, config: BakeConfig) -> list[str]:
    """Warn of large surfaces that were not taken as floors."""
    warnings = []
    large = [top for top in floors.tops if top.area >= LARGE_TOP]
    if large:
        warnings.append(
            f"not a floor, because no step leads there: the top of {_describe_tops(scene, large)}; "
            "`floors.tops: true` makes it one"
        )
    if floors.roofs:
        roofs = _describe_tops(scene, floors.roofs)
        warnings.append(
            f"left out as a roof, though it has walls: the top of {roofs}; it is open to the sky "
            "and no step leads there: `floors.roofs: true` keeps it"
        )
    return [*warnings, *_warn_hidden_ground(scene, floors, config)]


def warn_interleaved(floors: Floors, boxes: LevelBoxes) -> list[str]:
    """Warn of free cells that the original client takes for another level's."""
    if not boxes.lost:
        return []
    names = ", ".join(repr(floors.levels[number].name) for number in boxes.lost_on)
    return [
        f"levels interleave in height: the original client finds a position's level by `bbox` and "
        f"misses {boxes.lost} of {boxes.num_free} free cells, on {names}; navbake goes by floors "
        f"and misses none; other grounds in `levels` may part them"
    ]


def _warn_hidden_ground(scene: Scene, floors: Floors, config: BakeConfig) -> list[str]:
    """Warn of an infinite level plane that lies lower than all floors of the grid."""
    if config.grid.bounds is not None or config.grid.margin > 0:
        return []
    planes = scene.shapes.planes
    lowest = min(float(np.nanmin(level.floor)) for level in floors.levels)
    step = config.agent.traversable_floor_height
    for geom, point, normal in zip(planes.geom, planes.pos, planes.normal, strict=True):
        if normal[2] >= 1.0 - 1e-9 and point[2] < lowest - step:
            return [
                f"{scene.geoms[geom].name!r} is endless, and the grid covers only the box of the "
                f"other geoms, which hides it: `grid.margin` or `grid.bounds` shows the ground at "
                f"{point[2]:.2f} m around them"
            ]
    return []


def _describe_tops(scene: Scene, tops: list[DroppedSheet]) -> str:
    """The name, area and height of the first of some tops, and how many more there are."""
    first = tops[0]
    more = f", and {len(tops) - 1} more" if tops[1:] else ""
    name = scene.geoms[first.geom].name
    return f"{name!r} ({first.area:.1f} m² at {first.height:.2f} m{more})"
