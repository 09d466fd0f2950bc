"""Keeps the grid of a scene up to date while things in it move."""

from __future__ import annotations

import logging
import threading
import time
import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from navbake.baker.arguments import take_input
from navbake.baker.clock import StageClock
from navbake.baker.pipeline import build_grid
from navbake.baker.scene.scene import open_file
from navbake.baker.stages import Stages, take_first_look
from navbake.baker.update.following import FollowedDoors, FollowedScene, FullBake, Moved
from navbake.baker.update.stages import LiveStages
from navbake.config.keywords import SettingKeywords
from navbake.errors import BakeWarning
from navbake.navgrid.grid import NavGrid
from navbake.threads import limit_threads
from navbake.types import Float, Int

if TYPE_CHECKING:  # `typing` has it from Python 3.11 on
    from typing_extensions import Unpack

LOG = logging.getLogger("navbake")


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


class Baker:
    """Bakes a scene, and keeps its grid up to date while bodies move and joints turn.

    `grid` is what `navbake.bake` makes of the scene in its pose of now, bit for bit. An update asks
    again only what is near to what moved, as far as nothing else depends on it; see
    ``docs/live.md``. Bodies with a free joint are part of the scene, where they stand.

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
        config, opened = take_input(scene, data, settings, exclude, robot)
        opened = opened or open_file(config.scene)
        self._config, self._opened, self._threads = config, opened, threads
        self._lock = threading.Lock()
        with limit_threads(threads):
            first = take_first_look(config, StageClock(), opened=opened)
            self._scene = FollowedScene(config, opened, first.scene)
            # None while they are brought up to date, and after that has failed
            self._passes: list[LiveStages] | None = self._bake(first)
            self._grid = build_grid(self._passes[-1].stages)
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
            known, self._passes = self._passes, None
            passes, reason = self._follow(known, moved)
            moved.scene.digest = moved.digest()  # found beside all of that
            old, grid = self._grid, build_grid(passes[-1].stages)
            cells, is_new = _compare(old, grid)
            self._scene.keep(moved.scene)
            self._grid, self._passes = grid, passes
            return Changes(grid, cells, is_new, reason, time.perf_counter() - begin)

    def _follow(self, known: list[LiveStages] | None, moved: Moved) -> tuple[list[LiveStages], str]:
        """Bring the stages up to date, or find them anew; with why."""
        try:
            if known is None:
                raise FullBake("the last update failed")
            candidates, unmatched = self._doors.pose(moved.scene, moved.every)
            passes, reasons = list[LiveStages](), list[str]()
            for one in known:  # until one rejects nothing: others were of another pose
                reasons.append(one.follow(moved, candidates, unmatched))
                passes.append(one)
                candidates = one.stages.settled
                if len(candidates) == len(one.stages.candidates):
                    break
            return self._settle(passes), next(filter(None, reasons), "")
        except FullBake as why:
            LOG.debug("all is baked again: %s", why)
            opened = self._opened._replace(data=moved.scene.data)
            return self._bake(take_first_look(self._config, StageClock(), opened=opened)), str(why)

    def _bake(self, first: Stages) -> list[LiveStages]:
        """Find all stages; see `settle_doors`."""
        self._doors = FollowedDoors(self._config, first.scene, first.candidates, first.unmatched)
        return self._settle([LiveStages(first)])

    def _settle(self, passes: list[LiveStages]) -> list[LiveStages]:
        """Find the stages again without what the last ones reject as doors, until none does."""
        while (last := passes[-1].stages).rejected:
            passes.append(LiveStages(replace(last, candidates=last.settled)))
        return passes


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
