"""Keeps the grid of a scene up to date while things in it move, with the functions of a bake.

A pose → the geoms that moved → the cells near them → the occupants of these cells → the doors near
them → the grid. Floors, walls and rooms stay the same objects. If structure has changed, the whole
scene is baked.
"""

from __future__ import annotations

import logging
import threading
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.baker.bake.arguments import References, parse_arguments
from navbake.baker.bake.baked import BakedPose, BakedStructure
from navbake.baker.bake.lattice import fit_lattice
from navbake.baker.bake.level_crops import make_grid_door
from navbake.baker.bake.pipeline import build_grid
from navbake.baker.bake.stages import make_links, mark_obstacle_geoms, open_stages
from navbake.baker.core.clock import StageClock
from navbake.baker.doors.doors import (
    ClassifiedLeaf,
    DoorContext,
    closes_same_cells,
    move_leaf,
)
from navbake.baker.doors.posed_leaves import find_blocked_cells, pose_leaves
from navbake.baker.links.areas import paint_areas
from navbake.baker.live.tracked_scene import SceneChange, TrackedScene
from navbake.baker.occupants.lost_floors import find_lost_floors
from navbake.baker.occupants.movable import (
    MovableContext,
    update_movable_occupants,
)
from navbake.baker.scene.model import SceneInput, SceneModel
from navbake.baker.scene.scene import Scene, load_scene_file
from navbake.config.keywords import SettingKeywords
from navbake.config.settings import BakeConfig
from navbake.errors import BakeWarning
from navbake.navgrid.grid import NavGrid
from navbake.threads import baking, limit_threads
from navbake.types import Bool, Float, Int

if TYPE_CHECKING:  # `typing` has it from Python 3.11 on
    import mujoco
    from typing_extensions import Unpack

LOG = logging.getLogger("navbake")

# With fewer boxes of moved geoms than this, one thread is faster.
MIN_BOXES_FOR_THREADS = 16


class FullBakeRequired(Exception):
    """Raised when an update is not enough and the whole scene must be baked; the text says why."""


class Changes(NamedTuple):
    """What an update changed.

    Attributes:
        grid: the new grid, `Baker.grid`.
        cells: for each level, the ids of the cells in which any layer changed (floor, room,
            occupancy, weight, or a layer of `attributes`), ascending, int64. A cell's id is
            col + row * width.
        is_new: True if the grid's levels, or the rectangle of any level, changed. Cell ids of the
            old grid are then invalid, and `cells` lists all cells of the new one.
        reason: why the whole scene was baked; empty if only cells near moved things were updated.
        seconds: how long the update took [s].
    """

    grid: NavGrid
    cells: list[Int]
    is_new: bool
    reason: str
    seconds: float


class BakedScene(NamedTuple):
    """The values of the last bake or update that the next update reads.

    Attributes:
        structure: all that follows from structure and closed leaves.
        pose: all that depends on the scene's pose.
        door_context: the columns, floors and rooms on which the classification of leaves depends.
        movable_context: the floors and the occupancy of structure, for the search for movables.
    """

    structure: BakedStructure
    pose: BakedPose
    door_context: DoorContext
    movable_context: MovableContext


class Baker:
    """Bakes a scene, and keeps its grid up to date while bodies move and joints turn.

    `grid` equals the grid that `navbake.bake` makes of the scene in its current pose, bit for bit.
    An update recomputes only cells near things that moved. Floors, walls and rooms follow from
    structure, which does not move, and are kept. See ``docs/live.md``.

    A grid is never written to: each update makes a new grid, which shares unchanged arrays with the
    last one. So any thread may read `grid` while a second thread updates. A `PathFinder` keeps
    its grid until its method `use` is called with the new grid.

    Args:
        scene, data, exclude, robot, settings: see `navbake.bake`.
        threads: number of threads, >= 1; all cores if None.

    Raises:
        ConfigError: a setting is wrong.
        SceneError: the scene cannot be read, or holds nothing to bake.

    Example:
        >>> baker = navbake.Baker("my_scene.xml", grid={"bounds": [0, 0, 8, 6]})
        >>> finder = navbake.PathFinder(baker.grid)
        >>> changes = baker.update(bodies={"chair_3": [2.0, 1.5, 0.0]})
        >>> finder.use(changes.grid)
    """

    def __init__(
        self,
        scene: SceneInput,
        data: mujoco.MjData | None = None,
        /,
        *,
        exclude: Mapping[str, object] | None = None,
        robot: References | None = None,
        threads: int | None = None,
        **settings: Unpack[SettingKeywords],
    ) -> None:
        config, scene_model = parse_arguments(scene, data, settings, exclude, robot)
        if scene_model is None:
            scene_model = load_scene_file(config.scene)
        self._config = config
        self._scene_model = scene_model
        self._threads = threads
        self._lock = threading.Lock()
        with baking(), limit_threads(threads):
            baked = self._bake(scene_model)
            # None during an update, and after one that failed
            self._baked: BakedScene | None = baked
            self._tracked_scene = TrackedScene(config, scene_model, baked.pose.scene)
            self._grid = build_grid(config, baked.structure, baked.pose)
        for warning in self._grid.warnings:
            warnings.warn(warning, BakeWarning, stacklevel=2)

    @property
    def grid(self) -> NavGrid:
        """The grid of the scene in its current pose; each update makes a new one."""
        return self._grid

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model of the scene."""
        return self._scene_model.model

    @property
    def pose(self) -> tuple[Float, Float, Float]:
        """Copies of qpos, mocap_pos and mocap_quat in the current pose."""
        arrays = self._tracked_scene.pose_arrays
        return arrays.qpos.copy(), arrays.mocap_pos.copy(), arrays.mocap_quat.copy()

    def update(
        self,
        data: mujoco.MjData | None = None,
        *,
        bodies: Mapping[str, ArrayLike] | None = None,
        joints: Mapping[str, float] | None = None,
    ) -> Changes:
        """Update the grid to a new pose, or to changes that were written to the model.

        Each call also compares the model with its last state: a geom whose size, pose on its body,
        colour or group was written to may have moved, appeared or vanished. So a call without
        arguments updates the grid to such changes. Changes of the vertices of meshes or of the
        data of height fields are not noticed.

        Args:
            data: the mujoco.MjData whose joint positions and mocap bodies are the new pose; the
                last pose if None.
            bodies: bodies with a free joint, and mocap bodies, by name: x, y, z [m] to keep the
                orientation, or x, y, z and a quaternion w, x, y, z; world frame.
            joints: positions of hinges and slides, by name [rad or m].

        Returns:
            The new grid, and which cells changed.

        Raises:
            QueryError: there is no such body or joint, or a pose is not finite.
            ConfigError: the data belongs to a different model, for example one compiled after
                geoms were added.
            SceneError: the scene holds nothing to bake any more; `grid` stays as it was.

        Example:
            >>> changes = baker.update(bodies={"chair_3": [2.0, 1.5, 0.0]}, joints={"door_1": 1.2})
            >>> changes.cells[0]  # of the lowest level
        """
        begin = time.perf_counter()
        with baking(), self._lock, limit_threads(self._threads):
            change = self._tracked_scene.move(data, bodies, joints)
            # After an error or an interruption below, the next update bakes the whole scene.
            old_baked = self._baked
            self._baked = None
            reason = ""
            try:
                if old_baked is None:
                    raise FullBakeRequired("the last update failed")
                baked = update_baked_scene(old_baked, change, self._config)
            except FullBakeRequired as required:
                reason = str(required)
                LOG.debug("the whole scene is baked again: %s", reason)
                baked = self._bake(self._scene_model._replace(data=change.scene.data))
            # It was computed on another thread meanwhile.
            baked = _with_digest(baked, change.wait_for_digest())
            old_grid = self._grid
            grid = build_grid(self._config, baked.structure, baked.pose)
            cells, is_new = _find_changed_cells(old_grid, grid)
            self._tracked_scene.commit(baked.pose.scene, change.snapshot)
            self._grid = grid
            self._baked = baked
            return Changes(grid, cells, is_new, reason, time.perf_counter() - begin)

    def _bake(self, scene_model: SceneModel) -> BakedScene:
        stages = open_stages(self._config, StageClock(), scene_model=scene_model)
        return BakedScene(
            structure=stages.baked_structure,
            pose=stages.baked_pose,
            door_context=stages.door_context,
            movable_context=stages.movable_context,
        )


def update_baked_scene(baked: BakedScene, change: SceneChange, config: BakeConfig) -> BakedScene:
    """Return the values of a bake for the next pose, recomputed only near things that moved.

    Args:
        baked: the values of the last bake or update.
        change: what the next pose changes.
        config: all settings.

    Returns:
        The values for the next pose; `structure` is the same object as before.

    Raises:
        FullBakeRequired: structure has changed, or the lattice, or the cells that a leaf closes.
    """
    structure = baked.structure
    old_pose = baked.pose
    scene = change.scene
    if change.full_bake_reason:
        raise FullBakeRequired(change.full_bake_reason)
    if fit_lattice(scene, config) != structure.lattice:
        raise FullBakeRequired("the grid is another one: the box round the scene has changed")
    leaves = _update_leaves(baked, scene)
    is_obstacle_geom = mark_obstacle_geoms(scene, leaves, config)
    is_changed = change.changed_geoms & (old_pose.is_obstacle_geom | is_obstacle_geom)
    is_changed |= old_pose.is_obstacle_geom ^ is_obstacle_geom
    boxes = np.concatenate(
        [
            _boxes_of_geoms(old_pose.scene, is_changed & old_pose.is_obstacle_geom),
            _boxes_of_geoms(scene, is_changed & is_obstacle_geom),
        ]
    )
    pose = replace(old_pose, scene=scene, leaves=leaves, is_obstacle_geom=is_obstacle_geom)
    with limit_threads(1 if len(boxes) < MIN_BOXES_FOR_THREADS else None):
        if is_changed.any():
            occupants = update_movable_occupants(
                old_pose.occupants,
                baked.movable_context,
                shapes=scene.shapes,
                is_obstacle_geom=is_obstacle_geom,
                boxes=boxes,
            )
            lost_floors = _update_lost_floors(pose, structure, is_changed, config)
            pose = replace(pose, occupants=occupants, lost_floors=lost_floors)
        if leaves is not old_pose.leaves or pose.occupants is not old_pose.occupants:
            pose = _update_grid_doors(pose, baked, config)
    if config.areas:
        areas = paint_areas(
            scene, structure.lattice, structure.floors.levels, structure.rooms, config
        )
        pose = replace(pose, areas=areas)
    if config.links:
        links = make_links(
            scene,
            structure,
            leaves=leaves,
            is_obstacle_geom=is_obstacle_geom,
            occupied=pose.occupants.blocked,
            config=config,
        )
        pose = replace(pose, links=links)
    return baked._replace(pose=pose)


def _with_digest(baked: BakedScene, digest: str) -> BakedScene:
    scene = replace(baked.pose.scene, digest=digest)
    return baked._replace(pose=replace(baked.pose, scene=scene))


def _boxes_of_geoms(scene: Scene, mask: Bool) -> Float:
    """Return the boxes of the marked geoms of a scene: lower corner, upper corner, (n, 6) [m]."""
    boxes: Float = scene.shapes.boxes[mask[scene.shapes.boxed_geoms]]
    return boxes


def _update_leaves(baked: BakedScene, scene: Scene) -> list[ClassifiedLeaf]:
    """Bring the leaves up to date: classify those leaves again that changed.

    Args:
        baked: the values of the last bake or update.
        scene: the scene in the next pose.

    Returns:
        All leaves; the same list as before if none has changed.

    Raises:
        FullBakeRequired: a closed leaf blocks different cells than before, so rooms may change.
    """
    old_leaves = baked.pose.leaves
    leaf_of_candidate = {leaf.candidate: leaf for leaf in old_leaves}
    # Unchanged candidates are the same objects as before.
    changed_candidates = [
        candidate for candidate in scene.leaves if candidate not in leaf_of_candidate
    ]
    if not changed_candidates:
        return old_leaves
    lattice = baked.structure.lattice
    footprint = baked.movable_context.footprint
    posed_leaves = pose_leaves(scene, changed_candidates, lattice, footprint.half_width)
    levels = baked.structure.floors.levels
    old_leaf_of_id = {leaf.candidate.id: leaf for leaf in old_leaves}
    for leaf_cells in find_blocked_cells(posed_leaves, levels, footprint, lattice):
        candidate = leaf_cells.leaf.candidate
        old_leaf = old_leaf_of_id.get(candidate.id)
        if old_leaf is None or not closes_same_cells(leaf_cells, old_leaf):
            raise FullBakeRequired(f"the leaf {candidate.id!r} closes other cells")
        leaf_of_candidate[candidate] = move_leaf(leaf_cells, old_leaf, baked.door_context)
    return [leaf_of_candidate[candidate] for candidate in scene.leaves]


def _update_lost_floors(
    pose: BakedPose, structure: BakedStructure, is_changed: Bool, config: BakeConfig
) -> dict[int, float]:
    """Bring up to date how much floor each movable body would carry if it could not move.

    Only bodies with changed geoms are measured again.

    Args:
        pose: the values of the next pose, with the areas of the last one.
        structure: all that follows from structure.
        is_changed: the geoms that have changed, (ngeom,).
        config: all settings.

    Returns:
        Id of the body -> the area [m²], see `BakedPose.lost_floors`.
    """
    scene = pose.scene
    mover_of = scene.mover_of
    is_changed_body = np.zeros(len(scene.is_structure_body), dtype=np.bool_)
    is_changed_body[mover_of[is_changed]] = True
    changed_areas = find_lost_floors(
        scene.shapes,
        pose.is_obstacle_geom & is_changed_body[mover_of],
        mover_of=mover_of,
        levels=structure.floors.levels,
        lattice=structure.lattice,
        agent=config.agent,
    )
    areas = {body: area for body, area in pose.lost_floors.items() if not is_changed_body[body]}
    areas |= changed_areas
    return dict(sorted(areas.items()))


def _update_grid_doors(pose: BakedPose, baked: BakedScene, config: BakeConfig) -> BakedPose:
    """Bring the doors of the grid up to date.

    A door is made again if it moved, or if the occupancy of a cell that it blocks changed.

    Args:
        pose: the values of the next pose, with the doors of the last one.
        baked: the values of the last bake or update.
        config: all settings.

    Returns:
        The values of the next pose, with its doors.
    """
    door_leaves = pose.door_leaves
    if not door_leaves:
        return replace(pose, grid_doors=[])
    old_pose = baked.pose
    changed_cells = _mark_changed_cells(pose.occupants.blocked, old_pose.occupants.blocked)
    changed_squares = _mark_changed_cells(
        pose.occupants.blocked_squares or [], old_pose.occupants.blocked_squares or []
    )
    old_grid_doors = dict(zip(old_pose.door_leaves, old_pose.grid_doors, strict=True))
    grid_doors = []
    for leaf in door_leaves:
        grid_door = old_grid_doors.get(leaf)
        if (
            grid_door is None
            or _blocks_any(leaf.blocked, changed_cells)
            or _blocks_any(leaf.blocked_squares, changed_squares)
        ):
            grid_door = make_grid_door(leaf, baked.structure, pose.occupants, config)
        grid_doors.append(grid_door)
    return replace(pose, grid_doors=grid_doors)


def _mark_changed_cells(new_layers: Sequence[Bool], old_layers: Sequence[Bool]) -> list[Bool]:
    """Return for each level a mask of the cells, by id, in which its two layers differ."""
    return [(new != old).ravel() for new, old in zip(new_layers, old_layers, strict=True)]


def _blocks_any(blocked: Mapping[str, Sequence[Int]], marked: Sequence[Bool]) -> bool:
    """Return whether a leaf blocks any marked cell, in any of its states.

    Args:
        blocked: state -> for each level, the cells that the leaf blocks.
        marked: for each level, a flat mask of cells; or an empty list, which marks none.
    """
    for cells_of_levels in blocked.values():
        for mask, cells in zip(marked, cells_of_levels, strict=False):
            if mask[cells].any():
                return True
    return False


def _find_changed_cells(old_grid: NavGrid, new_grid: NavGrid) -> tuple[list[Int], bool]:
    """Find the cells of each level in which any layer changed.

    Returns:
        For each level, the ids of the cells; and whether the levels or their lattices changed. If
        they did, all cells of the new grid are returned.
    """
    old_lattices = [level.lattice for level in old_grid.levels]
    new_lattices = [level.lattice for level in new_grid.levels]
    if old_lattices != new_lattices:
        return [np.arange(level.width * level.height) for level in new_grid.levels], True
    changed_cells = []
    for old_level, new_level in zip(old_grid.levels, new_grid.levels, strict=True):
        # Weights follow from the occupancy.
        is_changed = old_level.attributes["occupancy"] != new_level.attributes["occupancy"]
        for name, new_layer in new_level.attributes.items():
            old_layer = old_level.attributes[name]
            if name == "occupancy" or np.may_share_memory(old_layer, new_layer):
                continue
            is_layer_changed = old_layer != new_layer
            if new_layer.dtype.kind == "f":
                is_layer_changed &= ~(np.isnan(old_layer) & np.isnan(new_layer))
            is_changed |= is_layer_changed
        changed_cells.append(np.flatnonzero(is_changed))
    return changed_cells, False
