"""The warnings of a bake, one line each."""

import numpy as np

from navbake.baker.boxes import LevelBoxes
from navbake.baker.floors.levels import DroppedSheet, Floors
from navbake.baker.floors.tops import LARGE_TOP
from navbake.baker.scene.scene import Scene
from navbake.baker.stages import Stages
from navbake.config.settings import BakeConfig


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
    """Warn of large surfaces that were not taken as floors, and of levels without a way there."""
    warnings = []
    large = [top for top in floors.tops if top.area >= LARGE_TOP]
    if large:
        warnings.append(
            "not a floor, because it is higher than a step over the floor beside it: the top of "
            f"{_describe_tops(scene, large)}; {_remedy(large[0])}, `floors.tops: true` keeps all"
        )
    if floors.roofs:
        warnings.append(
            "not a level, because it is open to the sky and has no walls around, though no floor "
            f"is larger: the roof {_describe_tops(scene, floors.roofs)}; "
            f"{_remedy(floors.roofs[0])}, `floors.roofs: true` keeps all"
        )
    for unreached in floors.unreached:
        level, name = floors.levels[unreached.level], scene.geoms[unreached.geom].name
        warnings.append(
            f"no step leads to {level.name!r} ({unreached.area:.1f} m² at {level.ground:.2f} m, "
            f"most of it on {name!r}): `floors.reach: steps` leaves such levels out, "
            "`floors.from` names places that count as reached"
        )
    if floors.enclosed:
        meshes = _describe_tops(scene, floors.enclosed)
        warnings.append(
            f"no floor, because it lies inside of a closed mesh: {meshes}; `scene.meshes: shell` "
            "makes meshes hollow, all or by pattern"
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


def _remedy(sheet: DroppedSheet) -> str:
    """How to keep a sheet that was dropped."""
    x, y, z = sheet.place
    return f"`floors.from: [[{x:.2f}, {y:.2f}, {z:.2f}]]` keeps it"


def _describe_tops(scene: Scene, tops: list[DroppedSheet]) -> str:
    """The name, area and height of the first of some tops, and how many more there are."""
    first = tops[0]
    more = f", and {len(tops) - 1} more" if tops[1:] else ""
    name = scene.geoms[first.geom].name
    return f"{name!r} ({first.area:.1f} m² at {first.height:.2f} m{more})"
