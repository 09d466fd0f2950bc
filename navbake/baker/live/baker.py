"""Bakes a scene, and keeps its grid up to date while things in it move: the class `Baker`.

The steps of an update are in `navbake.baker.live.update`.
"""

from __future__ import annotations

import logging
import threading
import time
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.baker.bake.arguments import References, parse_arguments
from navbake.baker.bake.pipeline import build_grid
from navbake.baker.bake.stages import open_stages
from navbake.baker.core.clock import StageClock
from navbake.baker.live.tracked_scene import TrackedScene
from navbake.baker.live.update import BakedScene, FullBakeRequired, update_baked_scene
from navbake.baker.scene.model import SceneInput, SceneModel
from navbake.baker.scene.scene import load_scene_file
from navbake.config.keywords import SettingKeywords
from navbake.errors import BakeWarning, count_of
from navbake.mujoco_types import MjDataLike
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.user_data import without_garbage_collection
from navbake.threads import baking, limit_threads
from navbake.types import Float, Int

if TYPE_CHECKING:  # `typing` has it from Python 3.11 on
    import mujoco
    from typing_extensions import Unpack

LOG = logging.getLogger("navbake")


class Changes(NamedTuple):
    """The result of an update: the new grid, and the cells that differ from the last one.

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

    def __repr__(self) -> str:
        num_cells = sum(len(cells) for cells in self.cells)
        kind = "whole bake" if self.reason else "update"
        reason_text = f", {self.reason}" if self.reason else ""
        new_text = ", new levels" if self.is_new else ""
        cells_text = count_of(num_cells, "changed cell")
        return (
            f"Changes({self.grid.scene_id!r}, {cells_text}{new_text}, {kind} in "
            f"{self.seconds:.3f} s{reason_text})"
        )


class Baker:
    """Bakes a scene, and keeps its grid up to date while bodies move and joints turn.

    `grid` equals the grid that `navbake.bake` makes of the scene in its current pose, bit for bit.
    An update recomputes only cells near things that moved. Floors, walls and rooms follow from
    structure, which does not move, and are kept. See ``docs/live.md``.

    A grid is never written to: each update makes a new grid, which shares unchanged arrays with the
    last one. So any thread may read `grid` while a second thread updates. A `PathFinder` keeps its
    grid until its method `use` is called with the new grid.

    Args:
        scene, data, exclude, robot: the scene, its pose, and what is left out, as for
            `navbake.bake`.
        threads: number of threads, >= 1; all cores if None.
        **settings: settings, as for `navbake.bake`.

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
        data: MjDataLike | None = None,
        /,
        *,
        exclude: Mapping[str, object] | None = None,
        robot: References | None = None,
        threads: int | None = None,
        **settings: Unpack[SettingKeywords],
    ) -> None:
        config, scene_model = parse_arguments(scene, data, settings, exclude, robot)
        if scene_model is None:
            scene_model = load_scene_file(config)
        self._config = config
        self._scene_model = scene_model
        self._threads = threads
        self._lock = threading.Lock()
        with baking(), limit_threads(threads):
            baked_scene = self._bake(scene_model)
            # None during an update, and after one that failed
            self._baked: BakedScene | None = baked_scene
            self._tracked_scene = TrackedScene(config, scene_model, baked_scene.pose.scene)
            self._grid = build_grid(config, baked_scene.structure, baked_scene.pose)
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
        pose_arrays = self._tracked_scene.pose_arrays
        return pose_arrays.qpos.copy(), pose_arrays.mocap_pos.copy(), pose_arrays.mocap_quat.copy()

    def update(
        self,
        data: MjDataLike | None = None,
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
        start_time = time.perf_counter()
        with baking(), self._lock, limit_threads(self._threads):
            reason = ""
            try:
                # not while another update or a bake of the whole scene runs, which may take long
                with without_garbage_collection():
                    change = self._tracked_scene.find_change(data, bodies, joints)
                    # After an error or an interruption below, the next update bakes all.
                    old_baked_scene = self._baked
                    self._baked = None
                    if old_baked_scene is None:
                        raise FullBakeRequired("the last update failed")
                    baked_scene = update_baked_scene(old_baked_scene, change, self._config)
            except FullBakeRequired as full_bake_required:
                reason = str(full_bake_required)
                LOG.debug("the whole scene is baked again: %s", reason)
                baked_scene = self._bake(self._scene_model._replace(data=change.scene.data))
            # Also while the last grid and pose are given back: then the collector, which counts
            # objects made less objects freed, mostly finds nothing to do after an update.
            with without_garbage_collection():
                grid = build_grid(self._config, baked_scene.structure, baked_scene.pose)
                cells, is_new = _find_changed_cells(self._grid, grid, baked_scene)
                self._tracked_scene.commit(baked_scene.pose.scene, change.snapshot)
                self._grid = grid
                self._baked = baked_scene
            return Changes(grid, cells, is_new, reason, time.perf_counter() - start_time)

    def _bake(self, scene_model: SceneModel) -> BakedScene:
        stages = open_stages(self._config, StageClock(), scene_model=scene_model)
        structure = stages.baked_structure
        geoms_of_name: dict[str, list[int]] = {}
        if structure.named_occupants is not None:
            for geom, name in enumerate(structure.named_occupants.names):
                geoms_of_name.setdefault(name, []).append(geom)
        return BakedScene(
            structure=structure,
            pose=stages.baked_pose,
            door_inputs=stages.door_inputs,
            movable_inputs=stages.movable_inputs,
            geoms_of_name=geoms_of_name,
            changed_rows=slice(0, structure.lattice.height),
        )


def _find_changed_cells(
    old_grid: NavGrid, new_grid: NavGrid, baked_scene: BakedScene
) -> tuple[list[Int], bool]:
    """Find the cells of each level in which any layer changed.

    Args:
        old_grid: the last grid.
        new_grid: the new grid.
        baked_scene: the values of which the new grid is made.

    Returns:
        For each level, the ids of the cells; and whether the levels or their lattices changed. If
        they did, all cells of the new grid are returned.
    """
    old_lattices = [level.lattice for level in old_grid.levels]
    new_lattices = [level.lattice for level in new_grid.levels]
    if old_lattices != new_lattices:
        return [np.arange(level.width * level.height) for level in new_grid.levels], True
    changed_cells = []
    changed_rows = baked_scene.changed_rows
    for old_level, new_level, (window_rows, _) in zip(
        old_grid.levels, new_grid.levels, baked_scene.structure.boxes.windows, strict=True
    ):
        first_row = max(changed_rows.start - window_rows.start, 0)
        rows = slice(first_row, max(changed_rows.stop - window_rows.start, 0))
        # Weights follow from the occupancy.
        is_changed_cell = (
            old_level.attributes["occupancy"][rows] != new_level.attributes["occupancy"][rows]
        )
        for layer_name, new_layer in new_level.attributes.items():
            old_layer = old_level.attributes[layer_name]
            if layer_name == "occupancy" or np.may_share_memory(old_layer, new_layer):
                continue
            is_layer_changed = old_layer[rows] != new_layer[rows]
            if new_layer.dtype.kind == "f":
                is_layer_changed &= ~(np.isnan(old_layer[rows]) & np.isnan(new_layer[rows]))
            is_changed_cell |= is_layer_changed
        changed_cells.append(np.flatnonzero(is_changed_cell) + first_row * new_level.width)
    return changed_cells, False
