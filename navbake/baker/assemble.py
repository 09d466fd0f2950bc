"""The grid that is written: levels, occupancy, rooms, doors and what made them, put together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake._version import __version__
from navbake.baker.contents.contents import Contents
from navbake.baker.doors.doors import Door, describe_doors
from navbake.baker.floors.levels import Floors
from navbake.baker.rooms.rooms import Rooms
from navbake.baker.scene.model import mujoco_version
from navbake.baker.scene.scene import Scene
from navbake.config.settings import BakeConfig, settings_digest
from navbake.navgrid.door_states import name_door_cells
from navbake.navgrid.doors import Door as StatedDoor
from navbake.navgrid.doors import parse_doors
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.navgrid.islands import add_layers
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.user_data import UserData

Int = NDArray[np.int64]
Window = tuple[slice, slice]


Box = tuple[tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True)
class Baked:
    """All that the stages found, on the whole lattice.

    Attributes:
        scene: the scene, doors included.
        lattice: the cells.
        floors: the storeys.
        occupied: per storey, shape (height, width), bool: by all but doors.
        doors: the doors.
        rooms: the rooms.
        contents: what stands in the cells, or None where nobody asked.
    """

    scene: Scene
    lattice: Lattice
    floors: Floors
    occupied: list[NDArray[np.bool_]]
    doors: list[Door]
    rooms: Rooms
    contents: Contents | None


def build_grid(baked: Baked, config: BakeConfig) -> SceneGrid2D | MultiLevelGrid:
    """Put what the stages found into the grid that is written.

    One level keeps the whole lattice; of several, each is cut to the cells that have a floor.
    """
    levels, lattice = baked.floors.levels, baked.lattice
    if len(levels) == 1:
        windows = [(slice(0, lattice.height), slice(0, lattice.width))]
    else:
        windows = [_window(level.floor) for level in levels]
    metadata = _metadata(baked, config, windows)
    sizes = [(rows.stop - rows.start) * (cols.stop - cols.start) for rows, cols in windows]
    doors = parse_doors(metadata["navbake"]["doors"], sizes)
    grids = [
        _level_grid(baked, config, number, window, box, doors, metadata)
        for number, (window, box) in enumerate(
            zip(windows, _level_boxes(baked, config, windows), strict=True)
        )
    ]
    grid: SceneGrid2D | MultiLevelGrid = grids[0]
    if len(grids) > 1:
        grid = MultiLevelGrid(grids=grids, metadata=metadata, cell_size=lattice.cell_size)
    add_layers(grid, config.attributes)
    return grid


def _level_grid(
    baked: Baked,
    config: BakeConfig,
    number: int,
    window: Window,
    box: Box,
    doors: Sequence[StatedDoor],
    metadata: dict[str, Any],
) -> SceneGrid2D:
    level, part = baked.floors.levels[number], baked.lattice.cut(*window)
    num_levels = len(baked.floors.levels)
    occupied = baked.occupied[number][window].copy()
    for door in doors:
        occupied.ravel()[door.cells_in(door.state, num_levels)[number]] = True
    return SceneGrid2D(
        width=part.width,
        height=part.height,
        cell_size=part.cell_size,
        min_yup=(part.x_min, level.ground, 0.0 - part.y_max),
        bbox_yup=box,
        weights=np.where(occupied, np.inf, 1.0),
        attributes={
            "floorHeight": level.floor[window].astype(np.float32),
            "roomIndex": np.ascontiguousarray(baked.rooms.index[number][window]),
            "occupancy": occupied.astype(np.uint8),
        },
        user_data=_user_data(baked, config, number, window, doors),
        metadata=metadata,
    )


def _user_data(
    baked: Baked, config: BakeConfig, number: int, window: Window, doors: Sequence[StatedDoor]
) -> UserData:
    if not config.names.enabled or baked.contents is None:
        return UserData()
    shared = baked.contents.user_data(number, window)
    return name_door_cells(shared, doors, number, len(baked.floors.levels))


def _cut_cells(cells: Int, window: Window, lattice: Lattice) -> Int:
    """Cells of the whole lattice as cells of a level's rectangle; those beside it drop out."""
    rows, cols = window
    row, col = np.divmod(cells, lattice.width)
    inside = (row >= rows.start) & (row < rows.stop) & (col >= cols.start) & (col < cols.stop)
    cut: Int = ((row - rows.start) * (cols.stop - cols.start) + col - cols.start)[inside]
    return cut


def _window(floor: NDArray[np.float64]) -> tuple[slice, slice]:
    """The smallest rectangle that holds all cells with a floor."""
    has_floor = ~np.isnan(floor)
    rows = np.flatnonzero(has_floor.any(axis=1))
    cols = np.flatnonzero(has_floor.any(axis=0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1)


def _level_boxes(baked: Baked, config: BakeConfig, windows: Sequence[Window]) -> list[Box]:
    """Each level's box, y up: from its ground to the next level's, none overlapping in height."""
    scene, lattice, levels = baked.scene, baked.lattice, baked.floors.levels
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


def _metadata(baked: Baked, config: BakeConfig, windows: Sequence[Window]) -> dict[str, Any]:
    scene, levels = baked.scene, baked.floors.levels
    cut: Callable[[int, Int], Int] = lambda level, cells: _cut_cells(  # noqa: E731
        cells, windows[level], baked.lattice
    )
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
            "levels": [{"name": level.name, "ground": level.ground} for level in levels],
            "links": _cut_links(baked.floors, windows, baked.lattice).tolist(),
            "names": config.names.enabled,
            "rooms": baked.rooms.table,
            "doors": describe_doors(baked.doors, config.doors.state, cut),
        },
    }


def _cut_links(floors: Floors, windows: Sequence[Window], lattice: Lattice) -> NDArray[np.int64]:
    """The links with cells counted on each level's own rectangle."""
    links = floors.links.copy()
    for side in (0, 2):
        row, col = np.divmod(links[:, side + 1], lattice.width)
        row0 = np.array([window[0].start for window in windows])[links[:, side]]
        col0 = np.array([window[1].start for window in windows])[links[:, side]]
        width = np.array([w[1].stop - w[1].start for w in windows])[links[:, side]]
        links[:, side + 1] = (row - row0) * width + (col - col0)
    return links
