"""Keeps the grid of a scene up to date while things in it move, by the functions that a bake calls.

Columns are cast again near what moved, floors merged again from their blocks, and occupancy and
contents found again in these cells; rooms and doors only if anything that they read has changed.
"""

from __future__ import annotations

import logging
import threading
import time
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from navbake.baker import column_blocks
from navbake.baker.arguments import take_input
from navbake.baker.clock import StageClock
from navbake.baker.column_blocks import cast_at, list_once, place_columns
from navbake.baker.columns import Columns, take_columns, take_runs
from navbake.baker.doors.candidates import DoorCandidate, mark_geoms
from navbake.baker.doors.doors import (
    LeafCells,
    PlacedLeaf,
    block_cells,
    place_doors,
    pose_leaves,
)
from navbake.baker.floors.levels import FloorFinder
from navbake.baker.following import (
    FollowedDoors,
    FollowedScene,
    FullBake,
    Moved,
    boxes_of,
)
from navbake.baker.kernels.arrays import Crossings
from navbake.baker.kernels.constants import BUILDING, TOUCH, WALL
from navbake.baker.lattice import cells_near, cut_cells, lay_lattice
from navbake.baker.pipeline import build_grid
from navbake.baker.rooms.flags import RoomFlags, are_equal, find_markers
from navbake.baker.scene.scene import open_file
from navbake.baker.stages import Stages, take_first_look
from navbake.config.keywords import SettingKeywords
from navbake.errors import BakeWarning
from navbake.navgrid.grid import NavGrid
from navbake.threads import LEAST_CELLS, limit_threads
from navbake.types import Bool, Float, Int, Int32

if TYPE_CHECKING:  # `typing` has it from Python 3.11 on
    from typing_extensions import Unpack

LOG = logging.getLogger("navbake")

# If moved geometry is near more than this share of the cells, a full bake is as fast
MOST_CELLS = 0.5
# Who asks for the columns of more than this share of the cells gets a copy of all, which is kept
COPY_SHARE = 1 / 8
# A full store of columns is made so many times as large as it has to be
GROWTH = 1.25


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


# ---------------------------------------------------------------- stages


class KeptColumns:
    """The columns of a lattice, each a run of one store; see `ColumnSource`.

    A new column is appended, and its cell points at it from then on. When the store is full, what
    no cell points at is dropped (as in a log-structured store; Rosenblum and Ousterhout, 1992).
    """

    def __init__(self, columns: Columns) -> None:
        self.lattice = columns.lattice
        self._cells = np.arange(self.lattice.width * self.lattice.height)
        self._all: Columns | None = None  # a copy of all, until one changes
        self._some: tuple[Bool, Columns] | None = None  # the cells that were asked for last
        self._hold(columns.crossings)

    def _hold(self, crossings: Crossings) -> None:
        """Make the crossings of all cells the whole store, without room for more."""
        self._first, self._counts = crossings.start[:-1].copy(), np.diff(crossings.start)
        self._used, self._arrays = len(crossings.z), list[NDArray[Any]](crossings[1:])

    def _make_room(self, more: int) -> None:
        """Make room for `more` crossings at least."""
        if self._counts.sum() < self._used:  # drop what no cell points at
            self._hold(self.take(self._cells))
        room = int((self._used + more) * GROWTH) + 100
        for number, array in enumerate(self._arrays):
            self._arrays[number] = np.empty((room, *array.shape[1:]), dtype=array.dtype)
            self._arrays[number][: self._used] = array[: self._used]

    def blocks(self) -> Iterator[Columns]:
        """All columns, in one block."""
        if self._all is None:
            self._all = Columns(self.lattice, self.take(self._cells))
        yield self._all

    def at(self, cells: Int | Int32) -> Columns:
        """Columns in which those of some cells are known, whatever the order of their ids."""
        if self._all is not None or len(cells) > COPY_SHARE * len(self._cells):
            return next(self.blocks())
        if self._some is None or not self._some[0][cells].all():
            mask = np.zeros(len(self._cells), dtype=np.bool_)
            mask[cells] = True
            asked = np.flatnonzero(mask)
            self._some = mask, place_columns(self.lattice, asked, self.take(asked))
        return self._some[1]

    def take(self, cells: Int) -> Crossings:
        """The columns of some cells, ascending, numbered as these are."""
        return take_runs(self._arrays, self._first[cells], self._counts[cells])

    def put(self, cells: Int, crossings: Crossings) -> None:
        """Replace the columns of some cells, ascending; crossings are numbered as these are."""
        self._all, self._some, end = None, None, self._used + len(crossings.z)
        if end > len(self._arrays[0]):
            self._make_room(len(crossings.z))
            end = self._used + len(crossings.z)
        for array, new in zip(self._arrays, crossings[1:], strict=True):
            array[self._used : end] = new
        self._first[cells] = self._used + crossings.start[:-1]
        self._counts[cells], self._used = np.diff(crossings.start), end


class LiveStages:
    """The `stages` of a scene with some bodies taken for doors, kept up to date.

    Columns and floors are kept on the lattice on which floors are judged, all other stages on the
    window of it that is baked.
    """

    def __init__(self, stages: Stages) -> None:
        self._finder: FloorFinder
        stages.floors, self._finder = stages.judge_floors()
        source, (lattice, _) = stages.judged_columns, stages.judged
        self._kept = None
        if lattice.width * lattice.height <= column_blocks.KEPT_CELLS:
            (columns,) = source.blocks()
            self._kept = KeptColumns(columns)
        self._take_over(stages)

    def _take_over(self, stages: Stages) -> None:
        """Find all stages after the floors, and keep what updates need of them."""
        _ = stages.contents
        self._markers = find_markers(stages.scene, stages.config.rooms)
        self._cells = stages.cells
        self._room_flags: RoomFlags | None = stages.room_flags
        _ = stages.doors
        stages.free_geometry()
        self.stages = stages

    def follow(self, moved: Moved, candidates: list[DoorCandidate], unmatched: list[str]) -> str:
        """Bring all up to date, with other candidates for doors or the same.

        Returns why all stages after the floors were found anew, "" if they were not. After an
        error, this object is of no use.

        Raises:
            FullBake: the lattice is another one, or so much moved that a bake takes no longer.
            SceneError: there is no floor.
        """
        was, scene = self.stages, moved.scene
        now = replace(was, scene=scene, candidates=candidates, unmatched=unmatched)
        now.stated_settings = was.stated_settings
        left_out, leaves_out = (mark_geoms(len(moved.geoms), s.candidates) for s in (was, now))
        # moved, unless as doors before and now; or in the scene only before, or only now
        differs = (moved.geoms & ~(left_out & leaves_out)) | (left_out ^ leaves_out)
        boxes = np.concatenate([boxes_of(one.doorless.shapes.only(differs)) for one in (was, now)])
        if lay_lattice(scene, now.config) != was.lattice or now.judged != was.judged:
            raise FullBake("the grid is another one: the box round the scene has changed")
        (lattice, window), reach = now.judged, max(now.footprint.reach, now.config.floors.crack)
        near = cells_near(lattice, boxes, reach + 2 * TOUCH)
        if len(near) > MOST_CELLS * lattice.width * lattice.height:
            raise FullBake("what moved is near most of the cells")
        if self._kept:
            now.judged_columns = self._kept
        known, self._markers = self._markers, find_markers(scene, now.config.rooms)
        planes, before = (len(one.doorless.shapes.planes.geom) for one in (now, was))
        flags_hold = np.array_equal(known[1], self._markers[1]) and planes == before
        flags_hold &= not (moved.every & known[0]).any()
        flags_hold &= np.array_equal(_box(was), _box(now))
        now.floors, touched, changed = was.floors, near[:0], near[:0]
        # few cells are not worth a second thread
        with limit_threads(1 if len(near) < LEAST_CELLS else None):
            if len(near):
                flags_hold &= self._cast(now, near)
                now.floors, finder = now.judge_floors(self._finder)
                levels = [
                    [(one.name, one.ground) for one in some.floors.levels] for some in (was, now)
                ]
                if finder.changed is None or levels[0] != levels[1]:
                    self._take_over(now)
                    return "there are other levels"
                changed = cut_cells(finder.changed, window, lattice.width)[0]
                touched = cut_cells(near, window, lattice.width)[0]
                touched = list_once(was.lattice, np.append(touched, changed))
            now.occupancy, now.contents = was.occupancy, was.contents
            if len(touched):
                flags_hold &= self._look_again(now, differs, touched, not len(changed))
                flags_hold &= np.array_equal(was.floors.links, now.floors.links)
            if not len(changed):
                now.floor_layers = was.floor_layers
                if len(now.floors.levels) == 1 and np.array_equal(_box(was), _box(now)):
                    now.boxes = was.boxes  # which then depend on floors alone
            else:
                self._room_flags = None  # they share the arrays of floors, which were written to
        now.leaf_cells = _follow_leaves(was, now, touched, len(changed) > 0)
        flags_hold &= not len(touched)  # what stands there may close an opening
        closed = [[leaf.closed for leaf in stages.leaf_cells] for stages in (was, now)]
        if not are_equal(closed[0], closed[1]):
            self._room_flags = None
        if not flags_hold or self._room_flags is None:
            now.cells = self._cells
            flags, self._room_flags = self._room_flags, now.room_flags
            flags_hold = flags is not None and are_equal(now.room_flags, flags)
        if flags_hold or are_equal(now.rooms, was.rooms):
            now.rooms = was.rooms
        now.doors = _follow_doors(was, now)
        if now.rooms is was.rooms and now.doors is was.doors:
            now.room_table = was.room_table
        if now.boxes.windows == was.boxes.windows:
            same = now.occupancy is was.occupancy
            known_doors = was.cut_doors if same else {}
            now.cut_doors = {one: known_doors.get(one) or now.cut_door(one) for one in now.placed}
        now.free_geometry()
        self.stages = now
        return ""

    def _cast(self, now: Stages, near: Int) -> bool:
        """Cast columns again; returns whether surely no surface changed that marks a room."""
        config, marks = now.config, self._markers[0]
        found = cast_at(now.judged_shapes, config.agent, config.floors.crack, near)
        crossings = take_columns(found.crossings, near)
        self._finder.replace(near, found, now.doorless.shapes.planes)
        if self._kept is None:
            return not marks.any()
        holds = not marks.any() or _same_surfaces(self._kept.take(near), crossings, marks)
        self._kept.put(near, crossings)
        return holds

    def _look_again(self, now: Stages, differs: Bool, touched: Int, floors_hold: bool) -> bool:
        """Find occupancy and contents again in the cells near what moved or with another floor.

        Returns whether rooms depend on nothing that changed there.
        """
        columns, (finder, of_columns) = now.baked_columns.at(touched), self._cells
        crossings, was = take_columns(columns.crossings, touched), now.contents
        holds = not of_columns.look(touched, crossings, now.floors.levels)
        known = now.doorless, now.floors, columns, now.tiled.at(touched)
        finder.look_again(*known, touched, differs, floors_hold)
        now.occupancy, now.contents = finder.occupancy, finder.found(now.config.names)
        if was is not None and now.contents is not None:
            holds &= now.contents.have_same_walls(was, touched)
            # widths of gaps are measured up to walls
            own = now.contents.partitions[differs]
            holds &= not ((own == WALL) | (own == BUILDING)).any()
        return holds


def _box(stages: Stages) -> Float:
    """The box round the scene, infinite where it is endless."""
    bounds = stages.scene.bounds
    return np.full((2, 3), np.inf) if bounds is None else bounds


def _follow_leaves(was: Stages, now: Stages, touched: Int, floors_changed: bool) -> list[LeafCells]:
    """What each leaf blocks; as it was but for those that moved, or whose floors changed."""
    known = {cells.leaf.candidate: cells for cells in was.leaf_cells}
    new = [candidate for candidate in now.candidates if candidate not in known]
    leaves = pose_leaves(now.scene, new, now.lattice, now.footprint.reach)
    if floors_changed:
        mask = np.zeros(now.lattice.shape, dtype=np.bool_)
        mask.ravel()[touched] = True
        for cells in was.leaf_cells:
            box = cells.leaf.box
            window = None if box is None else now.lattice.window(box, now.footprint.reach)
            if window is not None and mask[window].any():
                leaves.append(cells.leaf)
    for cells in block_cells(leaves, now.floors.levels, now.footprint, now.lattice):
        known[cells.leaf.candidate] = cells
    return [known[candidate] for candidate in now.candidates]


def _follow_doors(was: Stages, now: Stages) -> list[PlacedLeaf]:
    """Place the leaves again if anything that they depend on may have changed."""
    doors = place_doors(now.leaf_cells, now.door_context)
    return was.doors if are_equal(doors, was.doors) else doors


def _same_surfaces(old: Crossings, new: Crossings, geoms: Bool) -> bool:
    """Whether some geoms have the same surfaces in columns of the same cells."""
    found = []
    for columns in (old, new):
        cell = np.repeat(np.arange(len(columns.start) - 1), np.diff(columns.start))
        own = geoms[columns.geom]
        found.append((cell[own], columns.z[own], columns.normal[own], columns.geom[own]))
    return all(np.array_equal(one, other) for one, other in zip(*found, strict=True))
