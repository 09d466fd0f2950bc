"""The warnings of a bake, one line each."""

from __future__ import annotations

import numpy as np

from navbake.baker.boxes import LevelBoxes
from navbake.baker.floors.levels import Floors
from navbake.baker.floors.outline import find_cropped
from navbake.baker.floors.reach import TOLD_AREA, Unreached
from navbake.baker.floors.rejected import LARGE_TOP
from navbake.baker.floors.sheets import Patch
from navbake.baker.kernels.constants import SLACK
from navbake.baker.scene.names import body_name
from navbake.baker.scene.scene import Scene
from navbake.baker.stages import Stages
from navbake.config.settings import BakeConfig
from navbake.errors import printable
from navbake.types import Int

SPARSE = 64  # a first look at floors reads one row of so many
# How far below a ground that was given the floor lies that was meant, at most: the thickness of a
# slab with what is laid on it, so that the top of one is not taken for another storey's [m]
NEAR_GROUND = 0.5
MAX_MOVABLE = 3  # bodies with a free joint that a warning names at most


def collect_warnings(stages: Stages) -> list[str]:
    """The warnings of all stages, in their order."""
    contents, cell_area = stages.contents, stages.lattice.cell_size**2
    warnings = [
        *stages.scene.warnings,
        *stages.unmatched,
        *warn_part_judged(stages),
        *warn_nothing_free(stages),
        *(warn_movable(stages.scene, contents.taken, cell_area) if contents else ()),
        *warn_missing_floors(stages.scene, stages.floors, stages.config),
        *(contents.warnings if contents else ()),
        *stages.rooms.warnings,
        *stages.doors.warnings,
        *warn_interleaved(stages.floors, stages.boxes),
    ]
    return [printable(warning) for warning in warnings]


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
            f"is as large: the roof {_describe_tops(scene, floors.roofs)}; "
            f"{_remedy(floors.roofs[0])}, `floors.roofs: true` keeps all"
        )
    if floors.small_starts:
        warnings.append(
            "a floor only because `floors.from` names it, as it is too small otherwise: "
            f"{_describe_tops(scene, floors.small_starts)}; give the height of the floor that "
            "one starts from, at a place where nothing stands on it"
        )
    warnings += _warn_high_grounds(floors, config)
    warnings += [_describe_unreached(scene, floors, part) for part in floors.unreached]
    left_out = [patch for patch in floors.left_out if patch.area >= TOLD_AREA]
    if left_out:
        warnings.append(
            "left out by `floors.reach: steps`, because no step leads there: "
            f"{_describe_tops(scene, left_out)}; {_remedy(left_out[0])}"
        )
    if floors.enclosed:
        meshes = _describe_tops(scene, floors.enclosed)
        warnings.append(
            f"no floor, because it lies inside of a closed mesh: {meshes}; `scene.meshes: shell` "
            "makes meshes hollow, all or by pattern"
        )
    return [*warnings, *_warn_hidden_ground(scene, floors, config)]


def warn_part_judged(stages: Stages) -> list[str]:
    """Warn where floors were judged on a part of the scene, as the whole has too many cells."""
    (whole, _), grid, bounds = stages.judged, stages.config.grid, stages.scene.bounds
    if bounds is None or not find_cropped(whole, bounds).any():
        return []
    x0, y0, x1, y1 = whole.bounds
    return [
        "which floors are roofs or reached was decided on a part of the scene, "
        f"x {x0:.6g} to {x1:.6g} m and y {y0:.6g} to {y1:.6g} m: all of it has more cells than "
        f"`grid.max_cells` = {grid.max_cells}"
    ]


def warn_nothing_free(stages: Stages) -> list[str]:
    """Warn of levels without a cell that an agent can stand in."""
    full = [
        repr(level.name)
        for level, taken in zip(stages.floors.levels, stages.occupancy.levels, strict=True)
        if not (level.standable > taken).any()  # one pass: standable, and not taken
    ]
    if not full:
        return []
    agent = stages.config.agent
    lying = "; does the scene lie on its side (`scene.up`)?" if stages.scene.parts else ""
    return [
        f"nothing is free on {', '.join(full)}: an agent {agent.height:g} m high of "
        f"{agent.radius:g} m radius can stand nowhere there; `navbake why` names what blocks a "
        f"place{lying}"
    ]


def warn_movable(scene: Scene, taken: Int, cell_area: float) -> list[str]:
    """Warn of bodies with a free joint that take floor: agents, and things that move later.

    Args:
        taken: how many cells each body takes, see `Contents`.
        cell_area: of one cell [m²].
    """
    bodies = np.flatnonzero(taken)
    if not len(bodies):
        return []
    first = bodies[np.argsort(-taken[bodies], kind="stable")][:MAX_MOVABLE].tolist()
    named = [
        f"{body_name(scene.model, body)!r} ({int(taken[body]) * cell_area:.2f} m²)"
        for body in first
    ]
    left = len(bodies) - len(named)
    more = f", and {left} more" if left else ""
    return [
        f"bodies with a free joint take floor, where they stand now: "
        f"{', '.join(named)}{more}; `scene.exclude.movable: true` leaves all such "
        f"bodies out, `scene.exclude.bodies` those that its patterns name"
    ]


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
    planes, step = scene.shapes.planes, config.agent.traversable_floor_height
    # most planes aren't lower than the floor of some cells
    rows = [level.floor[::SPARSE] for level in floors.levels]
    some = min(float(np.fmin.reduce(row, axis=None, initial=np.inf)) for row in rows)
    if not (planes.pos[:, 2] < some - step).any():
        return []
    lowest = min(float(np.nanmin(level.floor)) for level in floors.levels)
    for geom, point, normal in zip(planes.geom, planes.pos, planes.normal, strict=True):
        if normal[2] >= 1.0 - 1e-9 and point[2] < lowest - step:
            return [
                f"{scene.geoms[geom].name!r} is endless, and the grid covers only the box of the "
                f"other geoms, which hides it: `grid.margin` or `grid.bounds` shows the ground at "
                f"{point[2]:.2f} m around them"
            ]
    return []


def _warn_high_grounds(floors: Floors, config: BakeConfig) -> list[str]:
    """Warn of grounds in `levels` that are a little higher than the floors that were meant.

    Such a floor goes to another level, and the name to whatever lies above. A ground is told of
    where its level has no floor within a step above it, and another has one as large as a sheet
    has to be within `NEAR_GROUND` below it.
    """
    warnings = []
    given = [] if config.levels == "auto" else [level.ground for level in config.levels]
    step, cell_area = config.agent.traversable_floor_height, config.grid.cell_size**2
    for level in floors.levels:
        if level.ground not in given or np.nanmin(level.floor) <= level.ground + step + SLACK:
            continue
        others = [other.floor[other.standable] for other in floors.levels if other is not level]
        z = np.concatenate([np.empty(0), *others])
        drop = np.round((level.ground - z) * 100)  # [cm]
        drop = drop[(drop > 0) & (drop <= NEAR_GROUND * 100)].astype(np.int64)
        count = np.bincount(drop, minlength=1)
        area, below = int(count.max()) * cell_area, int(count.argmax()) / 100
        if area >= config.floors.min_area:
            warnings.append(
                f"{level.name!r} has no floor near its ground, {level.ground:.2f} m: one of "
                f"{area:.1f} m² lies {below:.2f} m below it and is on another level; "
                f"`ground: {level.ground - below:.6g}` in `levels` takes it in"
            )
    return warnings


def _describe_unreached(scene: Scene, floors: Floors, part: Unreached) -> str:
    """The warning of what no step leads to on a level."""
    level, patch = floors.levels[part.level], part.patch
    name, area = scene.geoms[patch.geom].name, f"{patch.area:.1f} m²"
    x, y, z = patch.place
    if part.whole:
        what = f"{level.name!r} ({area} at {z:.2f} m, most of it on {name!r})"
    else:
        what = f"{area} of {level.name!r} (most of it on {name!r}, as at {x:.2f}, {y:.2f}, {z:.2f})"
    return (
        f"no step leads to {what}: `floors.reach: steps` leaves such "
        f"{'levels' if part.whole else 'floors'} out, `floors.from` names places that count as "
        "reached"
    )


def _remedy(sheet: Patch) -> str:
    """How to keep a sheet that was dropped."""
    x, y, z = sheet.place
    return f"`floors.from: [[{x:.2f}, {y:.2f}, {z:.2f}]]` keeps it"


def _describe_tops(scene: Scene, tops: list[Patch]) -> str:
    """The name, area and height of the first of some tops, and how many more there are."""
    first = tops[0]
    more = f", and {len(tops) - 1} more" if tops[1:] else ""
    name = scene.geoms[first.geom].name
    return f"{name!r} ({first.area:.1f} m² at {first.place[2]:.2f} m{more})"
