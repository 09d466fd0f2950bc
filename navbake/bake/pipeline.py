"""The bake, end to end: scene, columns, levels and floors, occupancy, grid."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numba
import numpy as np
from numpy.typing import NDArray

from navbake._version import __version__
from navbake.bake.columns import Columns, TiledShapes, cast_columns, tile_shapes
from navbake.bake.levels import Floors, LevelFloor, find_floors
from navbake.bake.occupancy import Footprint, check_occupancy
from navbake.bake.scene import GeomReport, Scene, load_scene, mujoco_version
from navbake.config import BakeConfig, settings_digest
from navbake.errors import ConfigError, SceneError
from navbake.grid import MultiLevelGrid, SceneGrid2D
from navbake.islands import clearance, find_islands
from navbake.lattice import Lattice

STAGES = ("scene", "columns", "floors", "occupancy", "grid")

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
            scene = load_scene(config.scene)
            lattice = lay_lattice(scene, config)
        footprint = Footprint.of(config.agent, lattice.cell_size)
        with clock.stage("columns"):
            tiled = tile_shapes(scene.shapes, lattice, footprint.reach)
            columns = cast_columns(tiled)
        questions = _Questions(columns, tiled, footprint)
        with clock.stage("floors"):
            given = None if config.levels == "auto" else list(config.levels)
            floors = find_floors(
                columns, scene.shapes, config.agent, config.floors, given, questions.ask
            )
        with clock.stage("occupancy"):
            questions.forget_counts()
            occupied = [_level_occupancy(level, questions) for level in floors.levels]
        with clock.stage("grid"):
            grid = build_grid(scene, config, lattice, floors, occupied)
    grid.timings = clock.written()
    return BakeResult(
        grid=grid,
        geoms=scene.geoms,
        warnings=scene.warnings,
        timings=clock.seconds,
        by_ray=questions.by_ray,
        by_fcl=questions.by_fcl,
    )


def lay_lattice(scene: Scene, config: BakeConfig) -> Lattice:
    """Lay one lattice over the scene, or over the bounds of the settings.

    Raises:
        ConfigError: the scene is endless and no bounds are set, or there are too many cells.
    """
    settings = config.grid
    if settings.bounds is not None:
        bounds = tuple(settings.bounds)
    elif scene.bounds is not None:
        bounds = (*scene.bounds[0, :2], *scene.bounds[1, :2])
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


def build_grid(
    scene: Scene,
    config: BakeConfig,
    lattice: Lattice,
    floors: Floors,
    occupied: list[NDArray[np.bool_]],
) -> SceneGrid2D | MultiLevelGrid:
    """Put levels, occupancy and what made them into the grid that is written.

    One level keeps the whole lattice; of several, each is cut to the cells that have a floor.

    Args:
        scene: the scene.
        config: all settings.
        lattice: the whole lattice.
        floors: the storeys on it.
        occupied: per storey, shape (height, width), bool.
    """
    single = len(floors.levels) == 1
    windows = [
        (slice(0, lattice.height), slice(0, lattice.width)) if single else _window(level.floor)
        for level in floors.levels
    ]
    bboxes = _level_boxes(scene, config, lattice, floors.levels, windows)
    grids = [
        _level_grid(level, mask, lattice, window, bbox)
        for level, mask, window, bbox in zip(floors.levels, occupied, windows, bboxes, strict=True)
    ]
    metadata = _metadata(scene, config, floors, windows, lattice)
    grid: SceneGrid2D | MultiLevelGrid
    if single:
        grid = grids[0]
        grid.metadata = metadata
    else:
        grid = MultiLevelGrid(grids=grids, metadata=metadata, cell_size=lattice.cell_size)
        for level in grids:
            level.metadata = metadata
    _add_layers(grid, config)
    return grid


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

    def forget_counts(self) -> None:
        self.by_ray = self.by_fcl = 0


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
        self.seconds[name] = time.perf_counter() - begin
        if self._progress is not None:
            self._progress(name, 1.0)

    def written(self) -> dict[str, float]:
        """The timings as the file has them [ms]."""
        millis = {f"{name}Millis": round(1e3 * s, 3) for name, s in self.seconds.items()}
        return {"createMillis": round(1e3 * sum(self.seconds.values()), 3), **millis}


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


def _level_occupancy(level: LevelFloor, questions: _Questions) -> NDArray[np.bool_]:
    """Occupied cells of a storey: by geometry, and where there is no floor."""
    cells = np.flatnonzero(~np.isnan(level.floor))
    occupied = np.ones(level.floor.size, dtype=np.bool_)
    occupied[cells] = questions.ask(cells, level.floor.ravel()[cells])
    return occupied.reshape(level.floor.shape)


def _window(floor: NDArray[np.float64]) -> tuple[slice, slice]:
    """The smallest rectangle that holds all cells with a floor."""
    has_floor = ~np.isnan(floor)
    rows = np.flatnonzero(has_floor.any(axis=1))
    cols = np.flatnonzero(has_floor.any(axis=0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1)


Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def _level_boxes(
    scene: Scene,
    config: BakeConfig,
    lattice: Lattice,
    levels: list[LevelFloor],
    windows: list[tuple[slice, slice]],
) -> list[Box]:
    """Each level's box, y up: from its ground to the next level's, none overlapping in height."""
    bottoms = [level.ground for level in levels]
    bottoms[0] = min(bottoms[0], float(np.nanmin(levels[0].floor)))
    highest = max(float(np.nanmax(level.floor)) for level in levels) + config.agent.height
    top = highest if scene.bounds is None else max(highest, float(scene.bounds[1, 2]))
    tops = [*bottoms[1:], top]
    boxes = []
    for window, bottom, level_top in zip(windows, bottoms, tops, strict=True):
        x0, y0, x1, y1 = lattice.cut(*window).bounds
        if scene.bounds is not None and config.grid.bounds is None:
            x0, y0 = max(x0, float(scene.bounds[0, 0])), max(y0, float(scene.bounds[0, 1]))
            x1, y1 = min(x1, float(scene.bounds[1, 0])), min(y1, float(scene.bounds[1, 1]))
        boxes.append(((x0, bottom, 0.0 - y1), (x1, level_top, 0.0 - y0)))
    return boxes


def _level_grid(
    level: LevelFloor,
    occupied: NDArray[np.bool_],
    lattice: Lattice,
    window: tuple[slice, slice],
    bbox: Box,
) -> SceneGrid2D:
    part = lattice.cut(*window)
    return SceneGrid2D(
        width=part.width,
        height=part.height,
        cell_size=part.cell_size,
        min_yup=(part.x_min, level.ground, 0.0 - part.y_max),
        bbox_yup=bbox,
        weights=np.where(occupied[window], np.inf, 1.0),
        attributes={
            "floorHeight": level.floor[window].astype(np.float32),
            "roomIndex": np.zeros(part.shape, dtype=np.uint16),
            "occupancy": occupied[window].astype(np.uint8),
        },
    )


def _metadata(
    scene: Scene,
    config: BakeConfig,
    floors: Floors,
    windows: list[tuple[slice, slice]],
    lattice: Lattice,
) -> dict[str, object]:
    return {
        "sceneId": scene.id,
        "cellAttributes": [
            {"name": "floorHeight", "type": "Float32Array", "dataType": "continuous"},
            {"name": "roomIndex", "type": "Uint16Array", "dataType": "categorical"},
            {"name": "occupancy", "type": "Uint8Array", "dataType": "categorical"},
        ],
        "agentHeight": config.agent.height,
        "agentRadius": config.agent.radius,
        "traversableFloorHeight": config.agent.traversable_floor_height,
        "useCellFloorHeight": True,
        "navbake": {
            "version": __version__,
            "mujoco": mujoco_version(),
            "sceneDigest": scene.digest,
            "settingsDigest": settings_digest(config),
            "worldFrame": {
                "up": "z",
                "unit": "m",
                "handedness": "right",
                "fileFromWorld": "(X, Y, Z) = (x, z, -y)",
            },
            "maxSlope": config.agent.max_slope,
            "levels": [{"name": level.name, "ground": level.ground} for level in floors.levels],
            "links": _cut_links(floors, windows, lattice).tolist(),
        },
    }


def _cut_links(
    floors: Floors, windows: list[tuple[slice, slice]], lattice: Lattice
) -> NDArray[np.int64]:
    """The links with cells counted on each level's own rectangle."""
    links = floors.links.copy()
    for side in (0, 2):
        row, col = np.divmod(links[:, side + 1], lattice.width)
        row0 = np.array([window[0].start for window in windows])[links[:, side]]
        col0 = np.array([window[1].start for window in windows])[links[:, side]]
        width = np.array([w[1].stop - w[1].start for w in windows])[links[:, side]]
        links[:, side + 1] = (row - row0) * width + (col - col0)
    return links


def _add_layers(grid: SceneGrid2D | MultiLevelGrid, config: BakeConfig) -> None:
    """Add the layers asked for."""
    if "island" in config.attributes:
        for level, island in zip(grid.levels, find_islands(grid), strict=True):
            level.attributes["island"] = np.minimum(island, 65535).astype(np.uint16)
    if "clearance" in config.attributes:
        for level in grid.levels:
            level.attributes["clearance"] = clearance(level)
