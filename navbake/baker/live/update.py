"""Keeps the grid of a scene up to date while things in it move, by the functions that a bake calls.

Poses → what moved → cells near it → occupants of these cells → doors near them → the grid. Floors,
walls and rooms stay the same objects; where what stands has changed, the whole scene is baked.
"""

from __future__ import annotations

import logging
import threading
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.baker.bake.arguments import parse_arguments
from navbake.baker.bake.baked import BakedPose, BakedStructure, GridDoor
from navbake.baker.bake.lattice import fit_lattice
from navbake.baker.bake.pipeline import build_grid
from navbake.baker.bake.stages import (
    make_grid_door,
    make_links,
    mark_in_the_way,
    open_stages,
)
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
from navbake.baker.scene.model import SceneModel
from navbake.baker.scene.scene import Scene, load_scene_file
from navbake.config.keywords import SettingKeywords
from navbake.config.settings import BakeConfig
from navbake.errors import BakeWarning
from navbake.navgrid.grid import NavGrid
from navbake.threads import limit_threads
from navbake.types import Bool, Float, Int

if TYPE_CHECKING:  # `typing` has it from Python 3.11 on
    from typing_extensions import Unpack

LOG = logging.getLogger("navbake")

# With fewer boxes than this, one thread is faster
FEW_BOXES = 16


class FullBakeRequired(Exception):
    """Raised when an update needs a whole bake; the text says why."""


class Changes(NamedTuple):
    """What an update changed.

    Attributes:
        grid: the grid as it is now, `Baker.grid`.
        cells: for each level, the ids of the cells of which any layer is another one (floor, room,
            occupancy with weight, and those of `attributes`), ascending, int64;
            id = col + row * width.
        is_new: whether the grid's levels or their rectangles are others: then all cells are
            listed.
        reason: why the whole scene was baked again; empty where only what is near to what moved
            was looked at.
        seconds: how long it took.
    """

    grid: NavGrid
    cells: list[Int]
    is_new: bool
    reason: str
    seconds: float


class BakedScene(NamedTuple):
    """What a bake found, and what is looked at again when something moves."""

    standing: BakedStructure
    moving: BakedPose
    door_context: DoorContext
    movable_context: MovableContext


class Baker:
    """Bakes a scene, and keeps its grid up to date while bodies move and joints turn.

    `grid` is what `navbake.bake` makes of the scene in its pose of now, bit for bit. An update
    looks again only near what moved; floors, walls and rooms are made by what stands, so that they
    stay. See ``docs/live.md``.

    Grids are never written to: each update makes a new one, which shares with the last what is the
    same in both. So whoever holds a grid has a snapshot that stays as it is, and any thread may
    read `grid` while another one updates. A `PathFinder` goes on answering about its own grid,
    until its method `use` moves it to the new one.

    Args:
        scene, data, exclude, robot, settings: see `navbake.bake`.
        threads: how many to use, >= 1; all cores if None.

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
        scene: Any,
        data: Any = None,
        /,
        *,
        exclude: Mapping[str, Any] | None = None,
        robot: Any = None,
        threads: int | None = None,
        **settings: Unpack[SettingKeywords],
    ) -> None:
        config, opened = parse_arguments(scene, data, settings, exclude, robot)
        opened = opened or load_scene_file(config.scene)
        self._config = config
        self._opened = opened
        self._threads = threads
        self._lock = threading.Lock()
        with limit_threads(threads):
            # None while it is brought up to date, and after that has failed
            self._baked: BakedScene | None = self._bake(opened)
            self._scene = TrackedScene(config, opened, self._baked.moving.scene)
            self._grid = build_grid(config, self._baked.standing, self._baked.moving)
        for warning in self._grid.warnings:
            warnings.warn(warning, BakeWarning, stacklevel=2)

    @property
    def grid(self) -> NavGrid:
        """The grid of the scene as it is now; each update makes a new one."""
        return self._grid

    @property
    def model(self) -> Any:
        """The scene's mujoco.MjModel."""
        return self._opened.model

    @property
    def pose(self) -> tuple[Float, Float, Float]:
        """Copies of the qpos, mocap_pos and mocap_quat of the data that is baked now."""
        qpos, position, quaternion = map(np.copy, self._scene.kept)
        return qpos, position, quaternion

    def update(
        self,
        data: Any = None,
        *,
        bodies: Mapping[str, ArrayLike] | None = None,
        joints: Mapping[str, float] | None = None,
    ) -> Changes:
        """Bring the grid up to date.

        Without arguments, it looks at the model again: a geom whose size, pose on its body, colour
        or group was written there may have moved, appeared or vanished. What was written into
        meshes and height fields isn't seen.

        Args:
            data: the mujoco.MjData whose joint positions and mocap bodies are the new pose; the
                last pose if None.
            bodies: bodies with a free joint, and mocap bodies, by name: x, y, z [m], or these and
                a quaternion w, x, y, z; world frame.
            joints: positions of hinges and slides, by name [rad or m].

        Returns:
            The new grid, and which cells changed.

        Raises:
            QueryError: there is no such body or joint, or a pose is no number.
            ConfigError: the data is of another model, as when geoms were added to it.
            SceneError: the scene as it is now holds nothing to bake; `grid` stays as it was.
        """
        begin = time.perf_counter()
        with self._lock, limit_threads(self._threads):
            moved = self._scene.pose(data, bodies, joints)
            # an error, or an interruption, anywhere below: the next update bakes all again
            before = self._baked
            self._baked = None
            reason = ""
            try:
                if before is None:
                    raise FullBakeRequired("the last update failed")
                now = follow(before, moved, self._config)
            except FullBakeRequired as why:
                reason = str(why)
                LOG.debug("the whole scene is baked again: %s", reason)
                now = self._bake(self._opened._replace(data=moved.scene.data))
            # found beside all of that
            now = _with_digest(now, moved.digest())
            old = self._grid
            grid = build_grid(self._config, now.standing, now.moving)
            cells, is_new = _compare(old, grid)
            self._scene.keep(now.moving.scene, moved.compared)
            self._grid = grid
            self._baked = now
            return Changes(grid, cells, is_new, reason, time.perf_counter() - begin)

    def _bake(self, opened: SceneModel) -> BakedScene:
        stages = open_stages(self._config, StageClock(), opened=opened)
        return BakedScene(
            stages.baked_structure, stages.baked_pose, stages.door_context, stages.movable_context
        )


def follow(before: BakedScene, moved: SceneChange, config: BakeConfig) -> BakedScene:
    """Bring a baked scene up to date after something moved.

    Raises:
        FullBakeRequired: what stands is another, or the lattice, or how leaves close.
    """
    standing = before.standing
    was = before.moving
    scene = moved.scene
    if moved.structure:
        raise FullBakeRequired(moved.structure)
    if fit_lattice(scene, config) != standing.lattice:
        raise FullBakeRequired("the grid is another one: the box round the scene has changed")
    doors = _follow_doors(before, scene)
    in_the_way = mark_in_the_way(scene, doors, config)
    differs = moved.geoms & (was.in_the_way | in_the_way)
    differs |= was.in_the_way ^ in_the_way
    boxes = np.concatenate(
        [
            _boxes_of_some(was.scene, differs & was.in_the_way),
            _boxes_of_some(scene, differs & in_the_way),
        ]
    )
    moving = replace(was, scene=scene, doors=doors, in_the_way=in_the_way)
    with limit_threads(1 if len(boxes) < FEW_BOXES else None):
        if differs.any():
            moving = replace(
                moving,
                occupants=update_movable_occupants(
                    was.occupants,
                    before.movable_context,
                    shapes=scene.shapes,
                    in_the_way=in_the_way,
                    boxes=boxes,
                ),
                lost_floors=_follow_lost_floors(moving, standing, differs, config),
            )
        if doors is not was.doors or moving.occupants is not was.occupants:
            moving = _cut_doors_again(moving, before, config)
    if config.areas:
        areas = paint_areas(scene, standing.lattice, standing.floors.levels, standing.rooms, config)
        moving = replace(moving, areas=areas)
    if config.links:
        links = make_links(
            scene,
            standing,
            doors=doors,
            in_the_way=in_the_way,
            occupied=moving.occupants.blocked,
            config=config,
        )
        moving = replace(moving, links=links)
    return before._replace(moving=moving)


def _with_digest(baked: BakedScene, digest: str) -> BakedScene:
    """The same with the digest of its scene."""
    scene = replace(baked.moving.scene, digest=digest)
    return baked._replace(moving=replace(baked.moving, scene=scene))


def _boxes_of_some(scene: Scene, chosen: Bool) -> Float:
    """The boxes of the chosen geoms of a scene, (n, 6) [m]."""
    boxes: Float = scene.shapes.boxes[chosen[scene.shapes.boxed_geoms]]
    return boxes


def _follow_doors(before: BakedScene, scene: Scene) -> list[ClassifiedLeaf]:
    """The leaves of a scene as they are now; the same list where none is another.

    Raises:
        FullBakeRequired: a leaf closes other cells than before, so that rooms may be others.
    """
    was = before.moving.doors
    by_candidate = {placed.candidate: placed for placed in was}
    others = [leaf for leaf in scene.leaves if leaf not in by_candidate]
    if not others:
        return was
    lattice = before.standing.lattice
    footprint = before.movable_context.footprint
    leaves = pose_leaves(scene, others, lattice, footprint.reach)
    by_id = {placed.candidate.id: placed for placed in was}
    for cells in find_blocked_cells(leaves, before.standing.floors.levels, footprint, lattice):
        leaf = cells.leaf.candidate
        former = by_id.get(leaf.id)
        if former is None or not closes_same_cells(cells, former):
            raise FullBakeRequired(f"the leaf {leaf.id!r} closes other cells")
        by_candidate[leaf] = move_leaf(cells, former, before.door_context)
    return [by_candidate[leaf] for leaf in scene.leaves]


def _follow_lost_floors(
    moving: BakedPose, standing: BakedStructure, differs: Bool, config: BakeConfig
) -> dict[int, float]:
    """How much floor there would be on what can move; looked at again where geoms differ."""
    mover_of = moving.scene.mover_of
    is_other = np.zeros(len(moving.scene.is_structure_body), dtype=np.bool_)
    is_other[mover_of[differs]] = True
    found = find_lost_floors(
        moving.scene.shapes,
        moving.in_the_way & is_other[mover_of],
        mover_of=mover_of,
        levels=standing.floors.levels,
        lattice=standing.lattice,
        agent=config.agent,
    )
    kept = {body: area for body, area in moving.lost_floors.items() if not is_other[body]}
    return dict(sorted((kept | found).items()))


def _cut_doors_again(moving: BakedPose, before: BakedScene, config: BakeConfig) -> BakedPose:
    """The doors as the grid has them: those that moved, and those where cells differ, again."""
    placed_doors = moving.placed_doors
    if not placed_doors:
        return replace(moving, grid_doors=[])
    standing = before.standing
    was = before.moving
    differing = [
        _differ(moving.occupants.blocked, was.occupants.blocked),
        _differ(moving.occupants.blocked_squares or [], was.occupants.blocked_squares or []),
    ]
    cut_by = dict(zip(was.placed_doors, was.grid_doors, strict=True))
    grid_doors = list[GridDoor]()
    for placed in placed_doors:
        cut = cut_by.get(placed)
        if cut is None or _blocks_any(placed, differing):
            cut = make_grid_door(placed, standing, moving.occupants, config)
        grid_doors.append(cut)
    return replace(moving, grid_doors=grid_doors)


def _differ(now: Sequence[Bool], before: Sequence[Bool]) -> list[Bool]:
    """The cells of each level in which two layers differ, as flat masks."""
    return [(one != other).ravel() for one, other in zip(now, before, strict=True)]


def _blocks_any(placed: ClassifiedLeaf, differing: Sequence[Sequence[Bool]]) -> bool:
    """Whether a leaf blocks any marked cell, or square of a cell, in any of its states."""
    for by_state, marked in zip((placed.blocked, placed.blocked_squares), differing, strict=True):
        for levels in by_state.values():
            if any(mask[cells].any() for mask, cells in zip(marked, levels, strict=False)):
                return True
    return False


def _compare(old: NavGrid, new: NavGrid) -> tuple[list[Int], bool]:
    """The cells that differ in any layer, by level; all where levels or lattices do."""
    pairs = list(zip(old.levels, new.levels, strict=False))
    same = len(old.levels) == len(new.levels) and all(a.lattice == b.lattice for a, b in pairs)
    if not same:
        return [np.arange(level.width * level.height) for level in new.levels], True
    cells = []
    for one, other in pairs:
        # weights are what the occupancy says
        differs = one.attributes["occupancy"] != other.attributes["occupancy"]
        for name, layer in other.attributes.items():
            before = one.attributes[name]
            if name != "occupancy" and not np.may_share_memory(before, layer):
                changed = before != layer
                if layer.dtype.kind == "f":
                    changed &= ~(np.isnan(before) & np.isnan(layer))
                differs |= changed
        cells.append(np.flatnonzero(differs))
    return cells, False
