"""The warnings of a bake, one line each."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from navbake.baker.bake.baked import BakedPose, BakedStructure, FloorLattice
from navbake.baker.bake.boxes import LevelBoxes
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.doors.doors import warn_doors
from navbake.baker.floors.levels import Floors
from navbake.baker.floors.outline import mark_cropped_sides
from navbake.baker.floors.reach import REPORTED_AREA
from navbake.baker.floors.rejected import LARGE_TOP
from navbake.baker.occupancy.occupancy import Occupancy
from navbake.baker.occupants.standing import StandingOccupants
from navbake.baker.rooms.rooms import Rooms
from navbake.baker.scene.names import body_name
from navbake.baker.scene.scene import Scene
from navbake.config.settings import BakeConfig
from navbake.errors import printable
from navbake.types import Bool, Float, Int

SPARSE = 64  # a first look at floors reads one row of so many
ROWS = 64  # of a level, looked at together for a cell that is free
# How far below a given ground the floor that it means lies at most: the thickness of a slab [m]
NEAR_GROUND = 0.5
LEAST_HOLE = 0.05  # of the holes of a mesh that a warning names [m²]
MAX_MOVABLE = 3  # bodies that can move that a warning names at most
# Warnings of large surfaces, from which size on [m²]
DROPPED = {
    "tops": (
        LARGE_TOP,
        "not a floor, because it is higher than a step over the floor beside it: the top of "
        "{what}; {keep}, `floors.tops: true` keeps all",
    ),
    "roofs": (
        0.0,
        "not a level, because it is open to the sky and has no walls around: the roof {what}; "
        "{keep}, `floors.roofs: true` keeps all",
    ),
    "small_starts": (
        0.0,
        "a floor only because `floors.from` names it, as it is too small otherwise: {what}; give "
        "the height of the floor that one starts from, at a place where nothing stands on it",
    ),
}
LOST = {
    "removed_by_reach": (
        REPORTED_AREA,
        "left out by `floors.reach: steps`, because no step leads there: {what}; {keep}",
    ),
    "enclosed_by_meshes": (
        0.0,
        "no floor, because it lies inside of a closed mesh: {what}; `scene.meshes: shell` makes "
        "meshes hollow, all or by pattern",
    ),
    "enclosed_by_planes": (
        REPORTED_AREA,
        "no floor, because it lies inside of an endless plane, which is solid below: {area} m² at "
        "{z} m under {name}; leave the plane out by `scene.exclude.geoms`, or lower it",
    ),
    "voids": (
        REPORTED_AREA,
        "not a level, because no step leads there and nobody can stand upright (a plenum, a crawl "
        "space): the void over {what}; `floors.voids: true` keeps all",
    ),
    "without_level": (
        0.0,
        "left out, because their columns hold more floors than there are levels, and no walk needs "
        "them: {cells} cells of {what}",
    ),
}


def warn_of_structure(
    config: BakeConfig,
    scene: Scene,
    extended: FloorLattice,
    floors: Floors,
    occupancy: Occupancy,
    standing_occupants: StandingOccupants | None,
    rooms: Rooms,
    boxes: LevelBoxes,
    holes: Float,
) -> list[str]:
    """The warnings of what stands, in the order of the stages, whose values the arguments are."""
    warnings = [
        *_warn_cropped(config, extended, scene),
        *_warn_patches(floors, scene, DROPPED),
        *_warn_high_grounds(config, floors),
        *_warn_patches(floors, scene, LOST),
        *_warn_holes(config, holes),
        *_warn_hidden_ground(config, floors, scene),
        *(standing_occupants.warnings if standing_occupants else ()),
        *rooms.warnings,
        *_warn_interleaved(floors, occupancy, boxes),
    ]
    return [printable(warning) for warning in warnings]


def collect_warnings(config: BakeConfig, standing: BakedStructure, moving: BakedPose) -> list[str]:
    """The warnings of all stages: of the scene, of what stands, then of the pose."""
    warnings = [
        *_warn_unreached(standing.floors, moving),
        *_warn_nothing_free(config, standing.floors, moving),
        *_warn_movable(standing, moving),
        *_warn_lost_floors(moving),
        *warn_doors(
            moving.placed_doors,
            {cut.door.id for cut in moving.grid_doors if cut.is_stuck},
            config.doors.state,
        ),
        *moving.areas.warnings,
        *moving.links.warnings,
    ]
    of_scene = [*moving.scene.warnings, *moving.scene.unused]
    return [
        *map(printable, of_scene),
        *standing.warnings,
        *map(printable, warnings),
    ]


def _warn_cropped(config: BakeConfig, extended: FloorLattice, scene: Scene) -> Iterator[str]:
    """Warn where floors were judged on a part of the scene, as the whole has too many cells."""
    whole = extended.lattice
    if scene.bounds is not None and mark_cropped_sides(whole, scene.bounds).any():
        x0, y0, x1, y1 = whole.bounds
        yield (
            "which floors are roofs or reached was decided on a part of the scene, "
            f"x {x0:.6g} to {x1:.6g} m and y {y0:.6g} to {y1:.6g} m: all of it has more cells than "
            f"`grid.max_cells` = {config.grid.max_cells}"
        )


def _warn_nothing_free(config: BakeConfig, floors: Floors, moving: BakedPose) -> Iterator[str]:
    """Warn of levels without a cell that an agent can stand in."""
    full = [
        repr(level.name)
        for level, taken in zip(floors.levels, moving.occupants.blocked, strict=True)
        if not _has_free(level.standable, taken)
    ]
    if full:
        agent = config.agent
        lying = (
            "; does the scene lie on its side (`scene.up`)?" if moving.scene.exact_meshes else ""
        )
        yield (
            f"nothing is free on {', '.join(full)}: an agent {agent.height:g} m high of "
            f"{agent.radius:g} m radius can stand nowhere there; `navbake why` names what blocks a "
            f"place{lying}"
        )


def _has_free(standable: Bool, taken: Bool) -> bool:
    """Whether any cell is standable, and not taken; most levels have one in their first rows."""
    rows = range(0, len(taken), ROWS)
    return any((standable[row : row + ROWS] > taken[row : row + ROWS]).any() for row in rows)


def _warn_movable(standing: BakedStructure, moving: BakedPose) -> Iterator[str]:
    """Warn of what can move and takes floor: robots, and things that move later."""
    scene = moving.scene
    taken = moving.occupants.num_blocked_alone
    bodies = np.flatnonzero(taken)
    bodies = bodies[~scene.is_structure_body[bodies]]  # else a leaf that hangs on no joint
    is_robot = np.isin(bodies, list(scene.actuated))
    robots = bodies[is_robot]
    things = bodies[~is_robot]

    def name(bodies: Int) -> str:
        largest = bodies[np.argsort(-taken[bodies], kind="stable")][:MAX_MOVABLE]
        named = []
        for body in largest.tolist():
            area = taken[body] * standing.lattice.cell_size**2
            named.append(f"{body_name(scene.model, body)!r} ({area:.2f} m²)")
        more = f", and {len(bodies) - len(named)} more" if len(bodies) > len(named) else ""
        return ", ".join(named) + more

    if len(robots):
        pattern = body_name(scene.model, int(robots[0]))
        yield (
            f"bodies with actuators take floor, where they stand now: {name(robots)}; what is to "
            f"drive through the grid is left out by `scene.exclude.bodies: [{pattern}]` in the "
            f"settings, by `robot=` in Python"
        )
    if len(things):
        yield (
            f"bodies that can move take floor, where they stand now: {name(things)}; "
            f"`scene.exclude.movable: true` leaves all such bodies out, `scene.exclude.bodies` "
            f"those that its patterns name"
        )


def _warn_lost_floors(moving: BakedPose) -> Iterator[str]:
    """Warn of what can move and would be floor where there is none."""
    for body, area in moving.lost_floors.items():
        if moving.scene.is_structure_body[body]:  # a leaf without a joint
            continue
        name = body_name(moving.scene.model, body)
        yield (
            f"{name!r} moves and carries no floor, though {area:.1f} m² of it lie over none: "
            f"`floors.movable: [{name}]` lets it carry floor in the baked pose; where its top is "
            f"more than a step over the floor beside it, `floors.from` has to name it, too"
        )


def _warn_patches(
    floors: Floors, scene: Scene, texts: dict[str, tuple[float, str]]
) -> Iterator[str]:
    """Warn of large surfaces: the name, area and height of the first, and how many more."""
    for name, (least, text) in texts.items():
        patches = [one for one in getattr(floors, name) if one.area >= least]
        if patches:
            first = patches[0]
            more = f", and {len(patches) - 1} more" if patches[1:] else ""
            x, y, z = first.position
            area = f"{first.area:.1f}"
            height = f"{z:.2f}"
            on = repr(scene.geoms[first.geom].name)
            cells = sum(len(one.cells) for one in patches)
            what = f"{on} ({area} m² at {height} m{more})"
            keep = f"`floors.from: [[{x:.2f}, {y:.2f}, {height}]]` keeps it"
            yield text.format(what=what, keep=keep, cells=cells, area=area, z=height, name=on)


def _warn_high_grounds(config: BakeConfig, floors: Floors) -> Iterator[str]:
    """Warn of grounds in `levels` that are a little higher than the floors that were meant.

    Their level has no floor within a step above, another a large one within `NEAR_GROUND` below.
    """
    levels = floors.levels
    given = [] if config.levels == "auto" else [level.ground for level in config.levels]
    step = config.agent.traversable_floor_height
    cell_area = config.grid.cell_size**2
    for level in levels:
        if level.ground not in given or np.nanmin(level.floor) <= level.ground + step + LIMIT_SLACK:
            continue
        others = [other.floor[other.standable] for other in levels if other is not level]
        z = np.concatenate([np.empty(0), *others])
        drop = np.round((level.ground - z) * 100)  # [cm]
        drop = drop[(drop > 0) & (drop <= NEAR_GROUND * 100)].astype(np.int64)
        count = np.bincount(drop, minlength=1)
        area = int(count.max()) * cell_area
        below = int(count.argmax()) / 100
        if area >= config.floors.min_area:
            yield (
                f"{level.name!r} has no floor near its ground, {level.ground:.2f} m: one of "
                f"{area:.1f} m² lies {below:.2f} m below it and is on another level; "
                f"`ground: {level.ground - below:.6g}` in `levels` takes it in"
            )


def _warn_unreached(floors: Floors, moving: BakedPose) -> Iterator[str]:
    """Warn of what no step leads to, level by level; not of a level at which a link stops."""
    linked = {stop.level for link in moving.links.links for stop in link.stops}
    for part in floors.unreached:
        if part.is_whole_level and part.level in linked:
            continue
        name = floors.levels[part.level].name
        patch = part.patch
        on = moving.scene.geoms[patch.geom].name
        area = f"{patch.area:.1f} m²"
        x, y, z = patch.position
        what = f"{area} of {name!r} (most of it on {on!r}, as at {x:.2f}, {y:.2f}, {z:.2f})"
        if part.is_whole_level:
            what = f"{name!r} ({area} at {z:.2f} m, most of it on {on!r})"
        noun = "levels" if part.is_whole_level else "floors"
        yield (
            f"no step leads to {what}: `floors.reach: steps` leaves such {noun} out, "
            "`floors.from` names places that count as reached"
        )


def _warn_holes(config: BakeConfig, holes: Float) -> Iterator[str]:
    """Warn of holes in the floor of a mesh."""
    area = holes[holes >= LEAST_HOLE]
    if len(area):
        number = "a hole" if len(area) == 1 else f"{len(area)} holes"
        text = "closed and marked in the layer `unseen`"
        if not config.floors.fill:
            text = "no floor: `floors.fill` closes holes up to an area, `scene.scan: true` does so"
        yield f"the mesh is open in its floor, {number} of {area.sum():.2f} m² in all: {text}"


def _warn_hidden_ground(config: BakeConfig, floors: Floors, scene: Scene) -> Iterator[str]:
    """Warn of an infinite level plane that lies lower than all floors of the grid."""
    levels = floors.levels
    planes = scene.structure.planes
    if config.grid.bounds is not None or config.grid.margin > 0:
        return
    step = config.agent.traversable_floor_height
    # most planes aren't lower than the floor of some cells
    rows = [level.floor[::SPARSE] for level in levels]
    some = min(float(np.fmin.reduce(row, axis=None, initial=np.inf)) for row in rows)
    if (planes.pos[:, 2] < some - step).any():
        lowest = min(float(np.nanmin(level.floor)) for level in levels)
        is_hidden = (planes.normal[:, 2] >= 1.0 - 1e-9) & (planes.pos[:, 2] < lowest - step)
        for plane in np.flatnonzero(is_hidden)[:1].tolist():
            name = scene.geoms[planes.geom[plane]].name
            z = planes.pos[plane, 2]
            yield (
                f"{name!r} is endless, and the grid covers only the box of the "
                f"other geoms, which hides it: `grid.margin` or `grid.bounds` shows the ground at "
                f"{z:.2f} m around them"
            )


def _warn_interleaved(floors: Floors, occupancy: Occupancy, boxes: LevelBoxes) -> Iterator[str]:
    """Warn of free cells that the original client takes for another level's."""
    if boxes.lost:
        pairs = zip(floors.levels, occupancy.levels, strict=True)
        num_free = sum(np.count_nonzero(~np.isnan(level.floor[~taken])) for level, taken in pairs)
        names = ", ".join(repr(floors.levels[number].name) for number in boxes.lost_on)
        yield (
            f"levels interleave in height: MINOS's client finds a position's level by `bbox` "
            f"and misses {boxes.lost} of {num_free} free cells, on {names}; navbake goes by "
            f"floors and misses none; other grounds in `levels` may part them"
        )
