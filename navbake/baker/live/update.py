"""Brings the values of a bake up to date after things in its scene moved, for `Baker`.

From the new pose follow the geoms that moved, the cells near them, the occupants of these cells,
the doors near them, and the grid. Floors, walls and rooms stay the same objects. If structure has
changed, the whole scene has to be baked. The functions of a bake do all of this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from navbake.baker.bake.baked import BakedPose, BakedStructure, GridDoor
from navbake.baker.bake.lattice import fit_lattice
from navbake.baker.bake.level_crops import make_grid_door
from navbake.baker.bake.uncounted import warn_uncounted
from navbake.baker.doors.doors import (
    ClassifiedLeaf,
    DoorInputs,
    closes_same_cells,
    mark_obstacle_geoms,
    move_leaf,
    select_doors,
)
from navbake.baker.doors.posed_leaves import find_blocked_cells, pose_leaves
from navbake.baker.geometry.shapes import Shapes
from navbake.baker.links.areas import paint_areas
from navbake.baker.links.links import bake_links
from navbake.baker.live.tracked_scene import SceneChange
from navbake.baker.occupants.cell_names import measure_names
from navbake.baker.occupants.lost_floors import find_lost_floors
from navbake.baker.occupants.movable import (
    MovableOccupants,
    MovableSearchInputs,
    find_affected_cells,
    update_movable_occupants,
)
from navbake.baker.scene.scene import Scene
from navbake.config.settings import BakeConfig
from navbake.navgrid.lattice import Lattice
from navbake.threads import limit_threads
from navbake.types import Bool, Float, Int

# With fewer boxes of moved geoms than this, one thread is faster.
MIN_BOXES_FOR_THREADS = 16


class FullBakeRequired(Exception):
    """Raised when an update is not enough and the whole scene must be baked; the text says why."""


class BakedScene(NamedTuple):
    """The values of the last bake or update that the next update reads.

    Attributes:
        structure: all that follows from structure and closed leaves.
        pose: all that depends on the scene's pose.
        door_inputs: the columns, floors and rooms on which the classification of leaves depends.
        movable_inputs: the floors and the occupancy of structure, for the search for movables.
        geoms_of_name: name in cells -> ids of the geoms that have it, see
            `navbake.baker.occupants.cell_names.name_geoms`; empty if the settings ask for no names.
        changed_rows: the rows of the lattice in which layers may differ from those of the bake or
            update before; all rows after a bake.
    """

    structure: BakedStructure
    pose: BakedPose
    door_inputs: DoorInputs
    movable_inputs: MovableSearchInputs
    geoms_of_name: dict[str, list[int]]
    changed_rows: slice


def update_baked_scene(
    baked_scene: BakedScene, change: SceneChange, config: BakeConfig
) -> BakedScene:
    """Return the values of a bake for the next pose, recomputed only near things that moved.

    Args:
        baked_scene: the values of the last bake or update. They are not to be used again, as the
            masks of its occupants are changed.
        change: the changes that the next pose makes.
        config: all settings.

    Returns:
        The values for the next pose; `structure` is the same object as before.

    Raises:
        FullBakeRequired: structure has changed, or the lattice, or the cells that a leaf closes.
    """
    structure = baked_scene.structure
    old_pose = baked_scene.pose
    scene = change.scene
    if change.full_bake_reason:
        raise FullBakeRequired(change.full_bake_reason)
    # the lattice follows from this box; without it, as where a ground is endless, from all geoms
    is_same_box = scene.bounds is not None and scene.bounds is old_pose.scene.bounds
    if not is_same_box and fit_lattice(scene, config) != structure.lattice:
        raise FullBakeRequired("the grid is another one: the box round the scene has changed")
    leaves = _update_leaves(baked_scene, scene)
    is_obstacle_geom = mark_obstacle_geoms(scene, leaves, config)
    is_changed_geom = change.is_changed_geom & (old_pose.is_obstacle_geom | is_obstacle_geom)
    is_changed_geom |= old_pose.is_obstacle_geom ^ is_obstacle_geom
    changed_boxes = np.concatenate(
        [
            _select_boxes(old_pose.scene, is_changed_geom & old_pose.is_obstacle_geom),
            _select_boxes(scene, is_changed_geom & is_obstacle_geom),
        ]
    )
    cells = find_affected_cells(baked_scene.movable_inputs, changed_boxes)
    occupants = old_pose.occupants
    changed_cells = [cells[:0] for _ in structure.floors.levels]
    lost_floor_areas = old_pose.lost_floor_areas
    grid_doors = old_pose.grid_doors
    with limit_threads(1 if len(changed_boxes) < MIN_BOXES_FOR_THREADS else None):
        if is_changed_geom.any():
            occupants, changed_cells = update_movable_occupants(
                old_pose.occupants,
                baked_scene.movable_inputs,
                shapes=scene.shapes,
                is_obstacle_geom=is_obstacle_geom,
                cells=cells,
            )
            lost_floor_areas = _update_lost_floors(
                scene, is_obstacle_geom, is_changed_geom, baked_scene, config
            )
        if leaves is not old_pose.leaves or occupants is not old_pose.occupants:
            grid_doors = _update_grid_doors(leaves, occupants, changed_cells, baked_scene, config)
    name_boxes = old_pose.name_boxes
    if structure.named_occupants is not None and change.is_changed_geom.any():
        name_boxes = _update_name_boxes(
            scene.shapes, change.is_changed_geom, structure.named_occupants.names, baked_scene
        )
    areas = old_pose.areas
    if config.areas:
        areas = paint_areas(
            scene, structure.lattice, structure.floors.levels, structure.rooms, config
        )
    links = old_pose.links
    if config.links:
        links = bake_links(
            scene,
            structure.lattice,
            floors=structure.floors,
            geometry=structure.link_geometry,
            leaves=leaves,
            is_obstacle_geom=is_obstacle_geom,
            occupied=occupants.blocked,
            config=config,
        )
    uncounted_warnings = old_pose.uncounted_warnings
    if change.is_uncounted_changed:
        uncounted_warnings = warn_uncounted(scene, baked_scene.movable_inputs)
    # areas, islands, clearance and doors may change far from what moved
    may_change_anywhere = bool(config.areas or config.attributes) or not _are_same_doors(
        grid_doors, old_pose.grid_doors
    )
    changed_rows = _rows_of_cells(cells, structure.lattice)
    if may_change_anywhere:
        changed_rows = slice(0, structure.lattice.height)
    pose = replace(
        old_pose,
        # the digest was computed on another thread meanwhile
        scene=replace(scene, digest=change.wait_for_digest()),
        leaves=leaves,
        is_obstacle_geom=is_obstacle_geom,
        occupants=occupants,
        lost_floor_areas=lost_floor_areas,
        grid_doors=grid_doors,
        areas=areas,
        links=links,
        name_boxes=name_boxes,
        uncounted_warnings=uncounted_warnings,
    )
    return baked_scene._replace(pose=pose, changed_rows=changed_rows)


def _are_same_doors(new_doors: list[GridDoor], old_doors: list[GridDoor]) -> bool:
    """Return whether all doors are the same objects as before."""
    return len(new_doors) == len(old_doors) and all(
        new_door is old_door for new_door, old_door in zip(new_doors, old_doors, strict=True)
    )


def _rows_of_cells(cells: Int, lattice: Lattice) -> slice:
    """Return the rows from that of the first to that of the last of some cells, ascending."""
    if not len(cells):
        return slice(0, 0)
    first_row, last_row = (cells[[0, -1]] // lattice.width).tolist()
    return slice(first_row, last_row + 1)


def _select_boxes(scene: Scene, is_selected_geom: Bool) -> Float:
    """Return the boxes of the marked geoms of a scene: lower corner, upper corner, (n, 6) [m]."""
    boxes: Float = scene.shapes.boxes[is_selected_geom[scene.shapes.geom_of_box]]
    return boxes


def _update_leaves(baked_scene: BakedScene, scene: Scene) -> list[ClassifiedLeaf]:
    """Bring the leaves up to date: pose again those that changed.

    Args:
        baked_scene: the values of the last bake or update.
        scene: the scene in the next pose.

    Returns:
        All leaves; the same list as before if none has changed.

    Raises:
        FullBakeRequired: a closed leaf blocks different cells than before, so rooms may change.
    """
    old_leaves = baked_scene.pose.leaves
    leaf_of_candidate = {leaf.candidate: leaf for leaf in old_leaves}
    # Unchanged candidates are the same objects as before.
    changed_candidates = [
        candidate for candidate in scene.leaves if candidate not in leaf_of_candidate
    ]
    if not changed_candidates:
        return old_leaves
    lattice = baked_scene.structure.lattice
    footprint = baked_scene.movable_inputs.footprint
    posed_leaves = pose_leaves(scene, changed_candidates, lattice, footprint.half_width)
    levels = baked_scene.structure.floors.levels
    old_leaf_of_id = {leaf.candidate.id: leaf for leaf in old_leaves}
    for leaf_cells in find_blocked_cells(posed_leaves, levels, footprint, lattice):
        candidate = leaf_cells.leaf.candidate
        old_leaf = old_leaf_of_id.get(candidate.id)
        if old_leaf is None or not closes_same_cells(leaf_cells, old_leaf):
            raise FullBakeRequired(f"the leaf {candidate.id!r} closes other cells")
        leaf_of_candidate[candidate] = move_leaf(leaf_cells, old_leaf, baked_scene.door_inputs)
    return [leaf_of_candidate[candidate] for candidate in scene.leaves]


def _update_lost_floors(
    scene: Scene,
    is_obstacle_geom: Bool,
    is_changed_geom: Bool,
    baked_scene: BakedScene,
    config: BakeConfig,
) -> dict[int, float]:
    """Measure again how much floor each movable body would carry if it could not move.

    Only bodies with changed geoms are measured again.

    Args:
        scene: the scene in the next pose.
        is_obstacle_geom: the geoms that only block cells in the next pose, (ngeom,).
        is_changed_geom: those that are or were such geoms and have changed, (ngeom,).
        baked_scene: the values of the last bake or update.
        config: all settings.

    Returns:
        Id of the body -> the area [m²], see `BakedPose.lost_floor_areas`.
    """
    structure = baked_scene.structure
    mover_of_geom = scene.mover_of_geom
    is_changed_body = np.zeros(len(scene.is_structure_body), dtype=np.bool_)
    is_changed_body[mover_of_geom[is_changed_geom]] = True
    changed_lost_areas = find_lost_floors(
        scene.shapes,
        is_obstacle_geom & is_changed_body[mover_of_geom],
        mover_of_geom=mover_of_geom,
        levels=structure.floors.levels,
        lattice=structure.lattice,
        agent=config.agent,
    )
    lost_areas = {
        body: area
        for body, area in baked_scene.pose.lost_floor_areas.items()
        if not is_changed_body[body]
    }
    lost_areas |= changed_lost_areas
    return dict(sorted(lost_areas.items()))


def _update_name_boxes(
    shapes: Shapes, is_changed_geom: Bool, names: list[str], baked_scene: BakedScene
) -> dict[str, list[float]]:
    """Measure again the boxes round the geoms of each name that a changed geom has.

    Args:
        shapes: all geometry that the bake uses, in the next pose.
        is_changed_geom: the geoms that have changed, (ngeom,).
        names: for each geom, the name under which cells list it.
        baked_scene: the values of the last bake or update.

    Returns:
        Name -> its box, see `BakedPose.name_boxes`.
    """
    old_boxes = baked_scene.pose.name_boxes
    changed_names = {names[geom] for geom in np.flatnonzero(is_changed_geom).tolist()}
    geoms = [geom for name in changed_names for geom in baked_scene.geoms_of_name[name]]
    changed_boxes = measure_names(shapes, np.array(geoms), [names[geom] for geom in geoms])
    if changed_boxes.keys() == changed_names and changed_names <= old_boxes.keys():
        return {**old_boxes, **changed_boxes}
    # a name has got a box, or lost it: the order of all names changes
    return measure_names(shapes, np.arange(len(names)), names)


def _update_grid_doors(
    leaves: list[ClassifiedLeaf],
    occupants: MovableOccupants,
    changed_cells: Sequence[Int],
    baked_scene: BakedScene,
    config: BakeConfig,
) -> list[GridDoor]:
    """Bring the doors of the grid up to date.

    A door is made again if it moved, or if the occupancy of a cell that it blocks changed.

    Args:
        leaves: all leaves in the next pose.
        occupants: the cells that anything but a door blocks in the next pose.
        changed_cells: for each level, ids of the cells whose occupancy has changed.
        baked_scene: the values of the last bake or update.
        config: all settings.

    Returns:
        The doors of the next pose.
    """
    door_leaves = select_doors(leaves)
    if not door_leaves:
        return []
    old_pose = baked_scene.pose
    is_changed_leaf = _mark_leaves_in_cells(
        door_leaves, changed_cells, baked_scene.structure.lattice
    )
    old_grid_doors = dict(zip(old_pose.door_leaves, old_pose.grid_doors, strict=True))
    grid_doors = []
    for leaf, is_changed in zip(door_leaves, is_changed_leaf.tolist(), strict=True):
        grid_door = old_grid_doors.get(leaf)
        if grid_door is None or is_changed:
            grid_door = make_grid_door(leaf, baked_scene.structure, occupants, config)
        grid_doors.append(grid_door)
    return grid_doors


def _mark_leaves_in_cells(
    leaves: Sequence[ClassifiedLeaf], cells_by_level: Sequence[Int], lattice: Lattice
) -> Bool:
    """Mark the leaves that block any of some cells, in any of their states.

    Args:
        leaves: the leaves.
        cells_by_level: for each level, ids of cells.
        lattice: the whole lattice.

    Returns:
        A mask of the leaves, shape (n,).
    """
    is_in_cells = np.zeros(len(leaves), dtype=np.bool_)
    for level, cells in enumerate(cells_by_level):
        if not len(cells):
            continue
        is_marked_cell = np.zeros(lattice.width * lattice.height, dtype=np.bool_)
        is_marked_cell[cells] = True
        # `blocked` has all cells of `blocked_squares`: the footprint includes the cell's square
        leaf_numbers = list[int]()
        cell_chunks = list[Int]()
        for leaf_number, leaf in enumerate(leaves):
            for cells_of_levels in leaf.blocked.values():
                leaf_numbers.append(leaf_number)
                cell_chunks.append(cells_of_levels[level])
        leaf_of_cell = np.repeat(leaf_numbers, [len(chunk) for chunk in cell_chunks])
        is_in_cells[leaf_of_cell[is_marked_cell[np.concatenate(cell_chunks)]]] = True
    return is_in_cells
