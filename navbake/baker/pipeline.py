"""The bake, end to end: scene, columns, floors, occupancy, contents, rooms, doors, grid."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from navbake.baker.assemble import Baked, build_grid
from navbake.baker.columns import Columns, TiledShapes, cast_columns, tile_shapes
from navbake.baker.contents.contents import Contents, find_contents
from navbake.baker.doors.bodies import DoorBody, find_door_bodies, without_doors
from navbake.baker.doors.doors import Door, Place, place_doors, tell_stuck
from navbake.baker.doors.floors import find_carrying_doors
from navbake.baker.floors.levels import Floors, LevelFloor, find_floors
from navbake.baker.occupancy.occupancy import Footprint, check_occupancy
from navbake.baker.remarks import remark_floors
from navbake.baker.rooms.rooms import Rooms, find_rooms
from navbake.baker.scene.scene import GeomReport, Scene, load_scene
from navbake.config.settings import BakeConfig, as_config
from navbake.errors import ConfigError, SceneError
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.navgrid.lattice import Lattice

STAGES = ("scene", "columns", "floors", "occupancy", "contents", "rooms", "doors", "grid")

Progress = Callable[[str, float], None]


@dataclass
class BakeResult:
    """What a bake yields.

    Attributes:
        grid: the grid; a MultiLevelGrid where there are several levels.
        geoms: what became of each geom.
        warnings: what the user should know, one line each.
        timings: seconds of each stage, in their order.
        by_ray: how many cells a ray alone proved occupied.
        by_fcl: how many had no proof either way, so that FCL decided.
    """

    grid: SceneGrid2D | MultiLevelGrid
    geoms: list[GeomReport]
    warnings: list[str]
    timings: dict[str, float] = field(default_factory=dict)
    by_ray: int = 0
    by_fcl: int = 0


def bake(
    config: BakeConfig | str | PathLike[str] | Mapping[str, Any],
    *,
    threads: int | None = None,
) -> SceneGrid2D | MultiLevelGrid:
    """Bake a scene.

    Args:
        config: settings, the path of a YAML or of a scene file, or the YAML as a mapping.
        threads: number of threads, >= 1; all cores if None. The result doesn't depend on it.

    Returns:
        The grid, not saved yet.

    Raises:
        ConfigError: a setting is wrong.
        SceneError: the scene cannot be read, or holds nothing to bake.
    """
    return run_bake(as_config(config), threads=threads).grid


def run_bake(
    config: BakeConfig, *, threads: int | None = None, progress: Progress | None = None
) -> BakeResult:
    """Bake a scene into a navigation grid.

    Args:
        config: all settings.
        threads: how many to use, >= 1; all cores if None. It never changes the result.
        progress: told each stage's name and how far it is, 0 to 1.

    Returns:
        The grid, and what is worth knowing about how it came about.

    Raises:
        SceneError: the scene can't be read, or has nothing to bake.
        ConfigError: settings don't fit the scene.
    """
    clock = _StageClock(progress)
    with _threads(threads):
        with clock.stage("scene"):
            whole = load_scene(config.scene)
            lattice = lay_lattice(whole, config)
            bodies, idle = find_door_bodies(whole, config.doors)
        found, doors, carrying = _find_places(whole, lattice, bodies, config, clock)
        with clock.stage("grid"):
            found_all = (found.floors, found.occupied, doors, found.rooms, found.contents)
            grid = build_grid(Baked(whole, lattice, *found_all), config)
    grid.timings = clock.written()
    return BakeResult(
        grid=grid,
        geoms=whole.geoms,
        warnings=[
            *whole.warnings,
            *idle,
            *remark_floors(whole, found.floors, config),
            *(found.contents.warnings if found.contents else ()),
            *found.rooms.warnings,
            *tell_stuck(doors, config.doors.state),
            *carrying,
        ],
        timings=clock.seconds,
        by_ray=found.questions.by_ray,
        by_fcl=found.questions.by_fcl,
    )


@dataclass(frozen=True)
class _Found:
    """What was found in a scene."""

    scene: Scene
    columns: Columns
    questions: _Questions
    floors: Floors
    occupied: list[NDArray[np.bool_]]
    contents: Contents | None
    rooms: Rooms


def _find_places(
    whole: Scene,
    lattice: Lattice,
    bodies: Sequence[DoorBody],
    config: BakeConfig,
    clock: _StageClock,
) -> tuple[_Found, list[Door], list[str]]:
    """Find floors, rooms and doors; the warnings are of doors that carry floors.

    What may be a door is left out at first. What joins no rooms after all (a cupboard's door)
    stands on the floors and has a part in everything, so all is found once more with it.
    """
    footprint = Footprint.of(config.agent, lattice.cell_size)
    while True:
        found = _find_rooms(without_doors(whole, bodies), lattice, footprint, config, clock)
        with clock.stage("doors"), _threads(1):  # a door is too small to be worth more
            floors, rooms = found.floors.levels, found.rooms
            place = Place(lattice, floors, found.occupied, footprint, rooms.room_at)
            doors, strays = place_doors(whole, bodies, place)
            bodies = [body for body in bodies if body.id not in {stray.id for stray in strays}]
            if strays:
                continue
            rooms = rooms.with_doors({door.id: door.swept for door in doors})
            carrying = find_carrying_doors(whole, bodies, found.columns, floors, config.agent)
        return replace(found, rooms=rooms), doors, carrying


def _find_rooms(
    scene: Scene,
    lattice: Lattice,
    footprint: Footprint,
    config: BakeConfig,
    clock: _StageClock,
) -> _Found:
    """Find floors, what is occupied, what stands there, and rooms; doors are none of it."""
    with clock.stage("columns"):
        tiled = tile_shapes(scene.shapes, lattice, footprint.reach)
        columns = cast_columns(tiled)
    questions = _Questions(columns, tiled, footprint)
    with clock.stage("floors"), _located(config.scene.path, scene):
        given = None if config.levels == "auto" else list(config.levels)
        # what a roof encloses doesn't depend on how wide the agent is
        point = config.agent.model_copy(update={"radius": 0.0})
        narrow = Footprint.of(point, lattice.cell_size)
        is_blocked = _Questions(columns, tiled, narrow).ask
        floors = find_floors(columns, scene.shapes, config.agent, config.floors, given, is_blocked)
    with clock.stage("occupancy"):
        occupied = [_level_occupancy(level, questions) for level in floors.levels]
    with clock.stage("contents"):
        contents = _list_contents(scene, columns, tiled, floors, occupied, config)
    with clock.stage("rooms"):
        walls = _wall_cells(contents, floors)
        rooms = find_rooms(scene, columns, floors, walls, config.rooms, config.agent)
    return _Found(scene, columns, questions, floors, occupied, contents, rooms)


def lay_lattice(scene: Scene, config: BakeConfig) -> Lattice:
    """Lay one lattice over the scene, or over the bounds of the settings.

    Raises:
        ConfigError: the scene is endless and no bounds are set, or there are too many cells.
    """
    settings = config.grid
    if settings.bounds is not None:
        bounds = tuple(settings.bounds)
    elif scene.bounds is not None:
        bounds = (*scene.bounds[0, :2].tolist(), *scene.bounds[1, :2].tolist())
    else:
        raise ConfigError(
            f"only infinite planes count in {config.scene.path}, so the grid has no end: "
            f"set `grid.bounds` to [x_min, y_min, x_max, y_max]"
        )
    if not np.isfinite(bounds).all():
        raise SceneError(f"the scene {config.scene.path} has geoms at no finite place")
    sides = [bounds[2] - bounds[0], bounds[3] - bounds[1]]
    cells = 1.0
    for side in sides:
        cells *= max(1.0, (side + 2 * settings.margin) / settings.cell_size)
    if cells > settings.max_cells:
        raise ConfigError(
            f"a grid of {cells:.3g} cells is more than `grid.max_cells` = {settings.max_cells}: "
            f"{sides[0]:.6g} x {sides[1]:.6g} m at `grid.cell_size` = {settings.cell_size:g} m; "
            f"check the scene's unit (`scene.unit`), the cell size, or raise the limit"
        )
    return Lattice.cover(tuple(float(b) for b in bounds), settings.cell_size, settings.margin)


class _Questions:
    """Occupancy questions to one scene, and how they were answered."""

    def __init__(self, columns: Columns, tiled: TiledShapes, footprint: Footprint) -> None:
        self._columns, self._tiled, self._footprint = columns, tiled, footprint
        self.by_ray = self.by_fcl = 0

    def ask(self, cells: NDArray[np.int64], floors: NDArray[np.float64]) -> NDArray[np.bool_]:
        answer = check_occupancy(self._columns, self._tiled, self._footprint, cells, floors)
        self.by_ray += answer.by_ray
        self.by_fcl += answer.by_fcl
        return answer.occupied


class _StageClock:
    """Times stages and reports them."""

    def __init__(self, progress: Progress | None) -> None:
        self._progress = progress
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        begin = time.perf_counter()
        if self._progress is not None:
            self._progress(name, 0.0)
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin
        if self._progress is not None:
            self._progress(name, 1.0)

    def written(self) -> dict[str, float]:
        """The timings as the file has them [ms]."""
        millis = {f"{name}Millis": round(1e3 * s, 3) for name, s in self.seconds.items()}
        return {"createMillis": round(1e3 * sum(self.seconds.values()), 3), **millis}


@contextmanager
def _located(path: Path, scene: Scene) -> Iterator[None]:
    """Say which scene it is that has no floor, and where it is: units and bounds go wrong."""
    try:
        yield
    except SceneError as error:
        if scene.bounds is None:
            raise SceneError(f"{path}: {error}") from error
        sides = zip("xyz", *scene.bounds.tolist(), strict=True)
        spans = ", ".join(f"{axis} {low:.6g} to {high:.6g}" for axis, low, high in sides)
        endless = scene.shapes.planes.geom
        if len(endless):
            spans += f" without {scene.geoms[endless[0]].name!r}, which is endless"
            spans += ": `grid.margin` or `grid.bounds` shows more of it"
        raise SceneError(f"{path}: {error}; the scene spans, in m, {spans}") from error


@contextmanager
def _threads(count: int | None) -> Iterator[None]:
    before = numba.get_num_threads()
    if count is not None:
        most = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
        if count < 1:
            raise ConfigError(f"expected a number of threads >= 1, got {count}")
        numba.set_num_threads(min(count, most))
    try:
        yield
    finally:
        numba.set_num_threads(before)


def _list_contents(
    scene: Scene,
    columns: Columns,
    tiled: TiledShapes,
    floors: Floors,
    occupied: list[NDArray[np.bool_]],
    config: BakeConfig,
) -> Contents | None:
    """What stands in the cells, where names or rooms ask for it."""
    if not config.names.enabled and not config.rooms.sources:
        return None
    return find_contents(scene, columns, tiled, floors, occupied, config.agent, config.names)


def _wall_cells(contents: Contents | None, floors: Floors) -> list[NDArray[np.bool_]]:
    if contents is None:
        return [np.zeros(level.floor.shape, dtype=np.bool_) for level in floors.levels]
    return [contents.wall_cells(number) for number in range(len(floors.levels))]


def _level_occupancy(level: LevelFloor, questions: _Questions) -> NDArray[np.bool_]:
    """Occupied cells of a storey: by geometry, and where there is no floor."""
    cells = np.flatnonzero(~np.isnan(level.floor))
    occupied = np.ones(level.floor.size, dtype=np.bool_)
    occupied[cells] = questions.ask(cells, level.floor.ravel()[cells])
    return occupied.reshape(level.floor.shape)
