"""The warnings of a bake, one line each."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from navbake.baker.bake.baked import BakedPose, BakedStructure, FloorLattice
from navbake.baker.bake.boxes import LevelBoxes
from navbake.baker.bake.lattice import MAX_EXTENSION
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.doors.doors import warn_doors
from navbake.baker.floors.below_grounds import MAX_GROUND_ERROR
from navbake.baker.floors.levels import Floors
from navbake.baker.floors.outline import mark_cropped_sides
from navbake.baker.floors.reach import REPORTED_AREA
from navbake.baker.floors.rejected import LARGE_TOP_AREA
from navbake.baker.occupancy.occupancy import StructureOccupancy
from navbake.baker.occupants.standing import StandingOccupants
from navbake.baker.rooms.rooms import Rooms
from navbake.baker.scene.names import body_name
from navbake.baker.scene.scene import Scene
from navbake.config.settings import BakeConfig
from navbake.errors import printable
from navbake.lengths import format_coordinate, format_length, format_position
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.rooms import has_building
from navbake.types import Bool, Float, Int

ROW_SAMPLING_STEP = 64  # every 64th row is read first, to see how low a level's floor is
ROWS_PER_CHUNK = 64  # rows of a level that are searched together for a free cell
# Unreached floors are warned of level by level on at most this many levels, those with the largest
# unreached floors; one more warning sums up the others
MAX_LISTED_UNREACHED_LEVELS = 5
# A room outdoors with more than this fraction of the area of all rooms is warned of
YARD_SHARE = 0.75
MIN_HOLE_AREA = 0.05  # smaller holes in a mesh aren't counted in a warning [m²]
MAX_NAMED_BODIES = 3  # movable bodies that a warning names
# Cells are too coarse where they are larger than `MAX_BUILDING_CELL` and the scene is narrower than
# `MIN_CELLS_ACROSS` of them. An opening is free for certain only if it is two cells wide, so larger
# cells close doors of a metre. Open land is baked so coarsely, too, but spans more cells.
MAX_BUILDING_CELL = 0.5  # [m]
MIN_CELLS_ACROSS = 20


class PatchWarning(NamedTuple):
    """The warning of one kind of patches: connected surfaces that are no floor, or a small one.

    Attributes:
        min_area: the least area of a patch that is warned of [m²].
        text: a format string. Its fields: ``what`` describes the largest patch, ``keep`` says how a
            user keeps that patch as a floor; ``area`` [m²], ``z`` [m] and ``name`` are the largest
            patch's; ``cells`` is the number of cells of all patches together.
    """

    min_area: float
    text: str


# Warnings of patches, by the attribute of `Floors` that lists them
PATCH_WARNINGS_BEFORE_GROUNDS = {
    "tops": PatchWarning(
        min_area=LARGE_TOP_AREA,
        text=(
            "not a floor, because it is higher than a step over the floor beside it: the top of "
            "{what}; {keep}, `floors.tops: true` keeps all"
        ),
    ),
    "roofs": PatchWarning(
        min_area=0.0,
        text=(
            "not a level, because it is open to the sky and has no walls around: the roof "
            "{what}; {keep}, `floors.roofs: true` keeps all"
        ),
    ),
    "small_starts": PatchWarning(
        min_area=0.0,
        text=(
            "a floor only because `floors.from` names it, as it is too small otherwise: {what}; "
            "give the height of the floor that one starts from, at a place where nothing stands "
            "on it"
        ),
    ),
}
PATCH_WARNINGS_AFTER_GROUNDS = {
    "removed_floors": PatchWarning(
        min_area=REPORTED_AREA,
        text="left out by `floors.reach: steps`, because no step leads there: {what}; {keep}",
    ),
    "enclosed_by_meshes": PatchWarning(
        min_area=0.0,
        text=(
            "no floor, because it lies inside of a closed mesh: {what}; `scene.meshes: shell` "
            "makes meshes hollow, all or by pattern"
        ),
    ),
    "enclosed_by_planes": PatchWarning(
        min_area=REPORTED_AREA,
        text=(
            "no floor, because it lies inside of an endless plane, which is solid below: {area} "
            "m² at {z} m under {name}; leave the plane out by `scene.exclude.geoms`, or lower it"
        ),
    ),
    "voids": PatchWarning(
        min_area=REPORTED_AREA,
        text=(
            "not a level, because no step leads there and nobody can stand upright (a plenum, a "
            "crawl space): the void over {what}; `floors.voids: true` keeps all"
        ),
    ),
    "surfaces_without_level": PatchWarning(
        min_area=0.0,
        text=(
            "left out, because their columns hold more floors than there are levels, and no walk "
            "needs them: {cells} cells of {what}"
        ),
    ),
}


def warn_of_structure(
    config: BakeConfig,
    scene: Scene,
    floor_lattice: FloorLattice,
    floors: Floors,
    occupancy: StructureOccupancy,
    standing_occupants: StandingOccupants | None,
    rooms: Rooms,
    boxes: LevelBoxes,
    hole_areas: Float,
) -> list[str]:
    """Collect the warnings that concern structure, in the order of the stages.

    Args:
        config: all settings.
        scene: the posed scene.
        floor_lattice: the lattice of the whole scene, on which floors were found.
        floors: the levels, and the surfaces that became no floor.
        occupancy: the cells of each level that structure occupies.
        standing_occupants: the structure in each cell; None where it was not needed.
        rooms: the rooms, with their warnings.
        boxes: the levels' boxes, and for how many cells the original client finds a wrong level by
            them.
        hole_areas: the area of each hole in the floor of a mesh [m²], shape (n,).

    Returns:
        The warnings, one printable line each.
    """
    warnings = [
        *_warn_coarse(floor_lattice.lattice),
        *_warn_cropped(config, floor_lattice, scene),
        *_warn_patches(floors, scene, PATCH_WARNINGS_BEFORE_GROUNDS),
        *_warn_high_grounds(config, floors),
        *_warn_floors_below_grounds(floors, scene),
        *_warn_patches(floors, scene, PATCH_WARNINGS_AFTER_GROUNDS),
        *_warn_holes(config, hole_areas),
        *_warn_hidden_ground(config, floors, scene),
        *(standing_occupants.warnings if standing_occupants else ()),
        *rooms.warnings,
        *_warn_yard(rooms),
        *_warn_interleaved(floors, occupancy, boxes),
    ]
    return [printable(warning) for warning in warnings]


def collect_warnings(
    config: BakeConfig, baked_structure: BakedStructure, baked_pose: BakedPose
) -> list[str]:
    """Collect all warnings of a bake: about the scene, then the structure, then the pose.

    Args:
        config: all settings.
        baked_structure: all that follows from structure, with its warnings.
        baked_pose: all that depends on the scene's pose.

    Returns:
        The warnings, one printable line each.
    """
    scene_warnings = [*baked_pose.scene.warnings, *baked_pose.scene.pattern_warnings]
    stuck_doors = {grid_door.door.id for grid_door in baked_pose.grid_doors if grid_door.is_stuck}
    pose_warnings = [
        *baked_pose.uncounted_warnings,
        *_warn_unreached(baked_structure.floors, baked_pose),
        *_warn_nothing_free(config, baked_structure.floors, baked_pose),
        *_warn_movable(baked_structure, baked_pose),
        *_warn_lost_floors(baked_pose),
        *warn_doors(baked_pose.door_leaves, stuck_doors, config.doors.state),
        *baked_pose.areas.warnings,
        *baked_pose.links.warnings,
    ]
    return [
        *map(printable, scene_warnings),
        *baked_structure.warnings,
        *map(printable, pose_warnings),
    ]


def _warn_coarse(lattice: Lattice) -> Iterator[str]:
    """Warn of cells that are too coarse for the scene that they cover."""
    num_cells_across = min(lattice.width, lattice.height)
    if lattice.cell_size > MAX_BUILDING_CELL and num_cells_across < MIN_CELLS_ACROSS:
        yield (
            f"cells of {lattice.cell_size:g} m are coarse for a scene of {lattice.width} x "
            f"{lattice.height} cells: what is narrower than two cells, such as a door, may be "
            "closed; set `grid.cell_size`, 0.1 by default"
        )


def _warn_cropped(config: BakeConfig, floor_lattice: FloorLattice, scene: Scene) -> Iterator[str]:
    """Warn where floors were found on a part of the scene, around `grid.bounds`."""
    lattice = floor_lattice.lattice
    if scene.bounds is not None and mark_cropped_sides(lattice, scene.bounds).any():
        x_min, y_min, x_max, y_max = lattice.bounds
        yield (
            "which floors are roofs or reached was decided on a part of the scene, "
            f"x {x_min:.6g} to {x_max:.6g} m and y {y_min:.6g} to {y_max:.6g} m: around "
            f"`grid.bounds`, up to {MAX_EXTENSION:g} m and `grid.max_cells` = "
            f"{config.grid.max_cells}; `floors.from` names places that are floors"
        )


def _warn_nothing_free(config: BakeConfig, floors: Floors, baked_pose: BakedPose) -> Iterator[str]:
    """Warn of levels without a cell that an agent can stand in."""
    full_level_names = [
        repr(level.name)
        for level, is_blocked in zip(floors.levels, baked_pose.occupants.blocked, strict=True)
        if not _has_free_cell(level.standable, is_blocked)
    ]
    if full_level_names:
        agent = config.agent
        is_mesh = bool(baked_pose.scene.exact_meshes)
        hint = "; does the scene lie on its side (`scene.up`)?" if is_mesh else ""
        yield (
            f"nothing is free on {', '.join(full_level_names)}: an agent {agent.height:g} m high "
            f"of {agent.radius:g} m radius can stand nowhere there; `navbake why` names what "
            f"blocks a place{hint}"
        )


def _has_free_cell(is_standable: Bool, is_blocked: Bool) -> bool:
    """Return whether any cell of a level is standable and not blocked.

    Rows are searched chunk by chunk, as most levels have such a cell in their first rows.
    """
    for row in range(0, len(is_blocked), ROWS_PER_CHUNK):
        rows = slice(row, row + ROWS_PER_CHUNK)
        if (is_standable[rows] > is_blocked[rows]).any():
            return True
    return False


def _warn_movable(baked_structure: BakedStructure, baked_pose: BakedPose) -> Iterator[str]:
    """Warn of movables that occupy floor: robots, and things that may be elsewhere later."""
    scene = baked_pose.scene
    num_blocked_cells = baked_pose.occupants.num_free_cells_blocked
    cell_area = baked_structure.lattice.cell_size**2
    movable_bodies = np.flatnonzero(num_blocked_cells)
    # Structure among them is a leaf that hangs on no joint.
    movable_bodies = movable_bodies[~scene.is_structure_body[movable_bodies]]
    is_actuated_body = np.zeros(len(scene.is_structure_body), dtype=np.bool_)
    is_actuated_body[[*scene.actuated_bodies]] = True
    is_robot_body = is_actuated_body[movable_bodies]
    robot_bodies = movable_bodies[is_robot_body]
    other_bodies = movable_bodies[~is_robot_body]

    def describe_largest_blockers(movable_bodies: Int) -> str:
        largest_first = np.argsort(-num_blocked_cells[movable_bodies], kind="stable")
        largest_bodies = movable_bodies[largest_first[:MAX_NAMED_BODIES]]
        body_texts = [
            f"{body_name(scene.model, body)!r} ({num_blocked_cells[body] * cell_area:.2f} m²)"
            for body in largest_bodies.tolist()
        ]
        num_more = len(movable_bodies) - len(body_texts)
        return ", ".join(body_texts) + (f", and {num_more} more" if num_more else "")

    if len(robot_bodies):
        pattern = body_name(scene.model, int(robot_bodies[0]))
        yield (
            f"bodies with actuators take floor, where they stand now: "
            f"{describe_largest_blockers(robot_bodies)}; what is to drive through the grid is left "
            f"out by `scene.exclude.bodies: [{pattern}]` in the settings, by `robot=` in Python"
        )
    if len(other_bodies):
        yield (
            f"bodies that can move take floor, where they stand now: "
            f"{describe_largest_blockers(other_bodies)}; "
            f"`scene.exclude.movable: true` leaves all such bodies out, `scene.exclude.bodies` "
            f"those that its patterns name"
        )


def _warn_lost_floors(baked_pose: BakedPose) -> Iterator[str]:
    """Warn of movables whose tops would be floor, if they were structure, where there is none."""
    scene = baked_pose.scene
    for body, area in baked_pose.lost_floor_areas.items():
        if scene.is_structure_body[body]:  # a leaf without a joint
            continue
        name = body_name(scene.model, body)
        yield (
            f"{name!r} moves and carries no floor, though {area:.1f} m² of it lie over none: "
            f"`floors.movable: [{name}]` lets it carry floor in the baked pose; where its top is "
            f"more than a step over the floor beside it, `floors.from` has to name it, too"
        )


def _warn_patches(
    floors: Floors, scene: Scene, patch_warnings: dict[str, PatchWarning]
) -> Iterator[str]:
    """Warn of patches of surface, with the name, area and height of the first one of each kind.

    Args:
        floors: the levels, and the lists of patches.
        scene: the posed scene, for the names of geoms.
        patch_warnings: attribute of `floors` that is a list of patches -> the warning about them.
    """
    for attribute, (min_area, text) in patch_warnings.items():
        patches = [patch for patch in getattr(floors, attribute) if patch.area >= min_area]
        if not patches:
            continue
        largest_patch = patches[0]
        x, y, z = largest_patch.position
        name = repr(scene.geoms[largest_patch.geom].name)
        area_text = f"{largest_patch.area:.1f}"
        height_text = format_length(z)
        more_text = f", and {len(patches) - 1} more" if len(patches) > 1 else ""
        position_text = f"[{format_length(x)}, {format_length(y)}, {height_text}]"
        yield text.format(
            what=f"{name} ({area_text} m² at {height_text} m{more_text})",
            keep=f"`floors.from: [{position_text}]` keeps it",
            cells=sum(len(patch.cells) for patch in patches),
            area=area_text,
            z=height_text,
            name=name,
        )


def _warn_high_grounds(config: BakeConfig, floors: Floors) -> Iterator[str]:
    """Warn of grounds in the setting `levels` that are a little higher than the meant floors.

    It is so where a level has no floor within a step above its ground, and another level has a
    large floor within `MAX_GROUND_ERROR` below that ground.
    """
    if config.levels == "auto":
        return
    ground_heights = [level.ground for level in config.levels]
    max_step = config.agent.traversable_floor_height
    for level in floors.levels:
        if level.ground not in ground_heights:
            continue
        if np.nanmin(level.floor) <= level.ground + max_step + LIMIT_SLACK:
            continue
        heights_by_level = [
            neighbor.floor[neighbor.standable]
            for neighbor in floors.levels
            if neighbor is not level
        ]
        standable_heights = np.concatenate([np.empty(0), *heights_by_level])
        depths_below = np.round((level.ground - standable_heights) * 100)  # [cm]
        depths_below = depths_below[
            (depths_below > 0) & (depths_below <= MAX_GROUND_ERROR * 100)
        ].astype(np.int64)
        num_cells_at_depth = np.bincount(depths_below, minlength=1)
        area = int(num_cells_at_depth.max()) * config.grid.cell_size**2
        depth = int(num_cells_at_depth.argmax()) / 100
        if area >= config.floors.min_area:
            yield (
                f"{level.name!r} has no floor near its ground, {format_length(level.ground)} m: "
                f"one of {area:.1f} m² lies {depth:.2f} m below it and is on another level; "
                f"`ground: {level.ground - depth:.6g}` in `levels` takes it in"
            )


def _warn_floors_below_grounds(floors: Floors, scene: Scene) -> Iterator[str]:
    """Warn of floors that are on no level, because the ground in the setting `levels` is higher.

    Args:
        floors: the levels, and the floors below their grounds.
        scene: the posed scene, for the names of geoms.
    """
    name_of_ground = {level.ground: level.name for level in floors.levels}
    for floor in floors.floors_below_grounds:
        patch = floor.patch
        ground_text = f"{format_length(floor.ground)} m"
        if floor.ground in name_of_ground:  # the level may lie outside of `grid.bounds`
            ground_text += f" of {name_of_ground[floor.ground]!r}"
        yield (
            f"on no level, because it lies below the ground {ground_text}: {patch.area:.1f} m² of "
            f"floor, from {format_length(floor.lower_ground)} m up, most of it on "
            f"{scene.geoms[patch.geom].name!r}, as at {format_position(patch.position)}; "
            f"`ground: {format_coordinate(floor.lower_ground)}` in `levels` takes it in"
        )


def _warn_unreached(floors: Floors, baked_pose: BakedPose) -> Iterator[str]:
    """Warn of floors that no step leads to, level by level.

    A whole level that no step leads to is not warned of if a link stops on it.
    """
    linked_levels = {stop.level for link in baked_pose.links.links for stop in link.stops}
    reported_floors = [
        level_floors
        for level_floors in floors.unreached_floors
        if not (level_floors.is_whole_level and level_floors.level in linked_levels)
    ]
    sorted_floors = sorted(reported_floors, key=lambda level_floors: -level_floors.patch.area)
    smaller_floors = sorted_floors[MAX_LISTED_UNREACHED_LEVELS:]
    summed_levels = {level_floors.level for level_floors in smaller_floors}
    for level_floors in reported_floors:
        if level_floors.level in summed_levels:
            continue
        is_whole_level = level_floors.is_whole_level
        name = floors.levels[level_floors.level].name
        patch = level_floors.patch
        geom = baked_pose.scene.geoms[patch.geom].name
        area = f"{patch.area:.1f} m²"
        x, y, z = patch.position
        floor_text = f"{area} of {name!r} (most of it on {geom!r}, as at {x:.2f}, {y:.2f}, {z:.2f})"
        if is_whole_level:
            floor_text = f"{name!r} ({area} at {z:.2f} m, most of it on {geom!r})"
        yield (
            f"no step leads to {floor_text}: `floors.reach: steps` leaves such "
            f"{'levels' if is_whole_level else 'floors'} out, `floors.from` names places that "
            "count as reached"
        )
    if smaller_floors:
        summed_area = sum(level_floors.patch.area for level_floors in smaller_floors)
        yield (
            f"no step leads to floors of {len(smaller_floors)} more levels, either, "
            f"{summed_area:.1f} m² in all: `floors.reach: steps` leaves them out"
        )


def _warn_holes(config: BakeConfig, hole_areas: Float) -> Iterator[str]:
    """Warn of holes in the floor of a mesh."""
    large_hole_areas = hole_areas[hole_areas >= MIN_HOLE_AREA]
    if len(large_hole_areas):
        number_text = "a hole" if len(large_hole_areas) == 1 else f"{len(large_hole_areas)} holes"
        outcome_text = "closed and marked in the layer `unseen`"
        if not config.floors.fill:
            outcome_text = (
                "no floor: `floors.fill` closes holes up to an area, `scene.scan: true` does so"
            )
        area = large_hole_areas.sum()
        size_text = f"{number_text} of {area:.2f} m² in all"
        yield f"the mesh is open in its floor, {size_text}: {outcome_text}"


def _warn_hidden_ground(config: BakeConfig, floors: Floors, scene: Scene) -> Iterator[str]:
    """Warn of an infinite horizontal plane that lies lower than all floors of the grid.

    The grid then doesn't show it, though agents may walk on it around the other geoms.
    """
    if config.grid.bounds is not None or config.grid.margin > 0:
        return
    levels = floors.levels
    planes = scene.structure.planes
    max_step = config.agent.traversable_floor_height
    # Most planes are not even lower than the floors of some rows.
    sampled_rows = [level.floor[::ROW_SAMPLING_STEP] for level in levels]
    lowest_sampled_floor = min(
        float(np.fmin.reduce(rows, axis=None, initial=np.inf)) for rows in sampled_rows
    )
    if not (planes.pos[:, 2] < lowest_sampled_floor - max_step).any():
        return
    lowest_floor = min(float(np.nanmin(level.floor)) for level in levels)
    is_horizontal = planes.normal[:, 2] >= 1.0 - 1e-9
    is_hidden_plane = is_horizontal & (planes.pos[:, 2] < lowest_floor - max_step)
    for plane in np.flatnonzero(is_hidden_plane)[:1].tolist():
        name = scene.geoms[planes.geom[plane]].name
        z = planes.pos[plane, 2]
        yield (
            f"{name!r} is endless, and the grid covers only the box of the "
            f"other geoms, which hides it: `grid.margin` or `grid.bounds` shows the ground at "
            f"{format_length(z)} m around them"
        )


def _warn_yard(rooms: Rooms) -> Iterator[str]:
    """Warn of a yard round a building with more than `YARD_SHARE` of the area of all rooms."""
    if not has_building(rooms.table):
        return
    total_area = sum(room.area for room in rooms.table)
    for room in rooms.table:
        if room.outdoors and room.area > YARD_SHARE * total_area:
            yield (
                f"{room.area / total_area:.0%} of the floor, {room.area:.0f} of {total_area:.0f} "
                f"m², is outdoors, in {room.id!r}: most places that are drawn at random lie there; "
                "`grid.bounds` or a smaller `grid.margin` bakes less of it, and "
                "`outdoors=False` draws places indoors"
            )


def _warn_interleaved(
    floors: Floors, occupancy: StructureOccupancy, boxes: LevelBoxes
) -> Iterator[str]:
    """Warn of free cells that MINOS's client would put on a wrong level, or on none.

    It finds a position's level by the levels' boxes, though levels may interleave in height.

    Args:
        floors: the levels and their floors.
        occupancy: the cells of each level that structure occupies.
        boxes: the levels' boxes, and how many free cells the client misplaces.
    """
    if not boxes.num_misplaced_cells:
        return
    num_free_cells = sum(
        np.count_nonzero(~np.isnan(level.floor[~is_occupied]))
        for level, is_occupied in zip(floors.levels, occupancy.levels, strict=True)
    )
    names = ", ".join(repr(floors.levels[level].name) for level in boxes.misplaced_levels)
    yield (
        f"only for users of MINOS: levels interleave in height, and its client, which finds a "
        f"position's level by `bbox`, misses {boxes.num_misplaced_cells} of {num_free_cells} free "
        f"cells, on {names}; "
        f"navbake goes by floors and misses none; other grounds in `levels` may part them"
    )
