"""The grid that is written: levels, occupancy, rooms, doors and what made them, put together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake._version import __version__
from navbake.baker.boxes import Box, written_ground
from navbake.baker.lattice import Window, cut_cells
from navbake.baker.scene.model import mujoco_version
from navbake.baker.stages import Stages
from navbake.baker.warn import collect_warnings
from navbake.navgrid.doors import Door, Runs, to_runs, with_door_names
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.navgrid.islands import add_layers
from navbake.navgrid.user_data import UserData
from navbake.types import Int, Json


def build_grid(stages: Stages) -> SceneGrid2D | MultiLevelGrid:
    """Put what the stages found into the grid that is written."""
    windows = stages.boxes.windows
    doors = _cut_doors(stages, windows)
    metadata = _metadata(stages, windows, doors)
    places = enumerate(zip(windows, stages.boxes.boxes, strict=True))
    grids = [_level_grid(stages, number, *place, doors, metadata) for number, place in places]
    grid: SceneGrid2D | MultiLevelGrid = grids[0]
    if len(grids) > 1:
        grid = MultiLevelGrid(grids=grids, metadata=metadata, cell_size=stages.lattice.cell_size)
    add_layers(grid, stages.config.attributes)
    return grid


def _level_grid(
    stages: Stages,
    number: int,
    window: Window,
    box: Box,
    doors: Sequence[Door],
    metadata: Json,
) -> SceneGrid2D:
    """One level's grid, blocked by the doors in their states."""
    level, part = stages.floors.levels[number], stages.lattice.cut(*window)
    num_levels = len(stages.floors.levels)
    occupied = stages.occupancy.levels[number][window].copy()
    for door in doors:
        occupied.ravel()[door.cells_in(door.state, num_levels)[number]] = True
    attributes: dict[str, NDArray[Any]] = {
        "floorHeight": np.ascontiguousarray(stages.floor_layers[number][window]),
        "roomIndex": np.ascontiguousarray(stages.rooms.index[number][window]),
        "occupancy": occupied.view(np.uint8),
    }
    if stages.occupancy.solid is not None:
        solid = stages.occupancy.solid[number][window].copy()
        for door in doors:
            solid.ravel()[door.solid_in(door.state, num_levels)[number]] = True
        attributes["solid"] = solid.view(np.uint8)
    user_data = UserData()
    if stages.contents is not None and stages.config.names.enabled:  # read on first use
        named = stages.contents.user_data(number, window)
        user_data = with_door_names(named, doors, number, num_levels)
    return SceneGrid2D(
        width=part.width,
        height=part.height,
        cell_size=part.cell_size,
        min_yup=(part.x_min, written_ground(level), 0.0 - part.y_max),
        bbox_yup=box,
        weights=np.where(occupied, np.inf, 1.0),
        attributes=attributes,
        user_data=user_data,
        metadata=metadata,
    )


def _metadata(stages: Stages, windows: list[Window], doors: Sequence[Door]) -> Json:
    config, agent = stages.config, stages.config.agent
    warnings = collect_warnings(stages)
    return {
        "sceneId": stages.scene.id,
        "cellAttributes": [
            {"name": "floorHeight", "type": "Float32Array", "dataType": "continuous"},
            {"name": "roomIndex", "type": "Uint16Array", "dataType": "categorical"},
            {"name": "occupancy", "type": "Uint8Array", "dataType": "categorical"},
        ],
        "agentHeight": agent.height,
        "agentRadius": agent.radius,
        "traversableFloorHeight": agent.traversable_floor_height,
        "useCellFloorHeight": True,
        # what the format doesn't know
        "navbake": {
            "version": __version__,
            "mujoco": mujoco_version(),
            "sceneDigest": stages.scene.digest,
            **stages.stated_settings,
            "worldFrame": {
                "up": "z",
                "unit": "m",
                "handedness": "right",
                "fileFromWorld": "(X, Y, Z) = (x, z, -y)",
            },
            "maxSlope": agent.max_slope,
            "levels": [
                {"name": level.name, "ground": written_ground(level)}
                for level in stages.floors.levels
            ],
            "links": _cut_links(stages.floors.links, windows, stages.lattice.width).tolist(),
            "names": config.names.enabled,
            "rooms": stages.room_table,
            "doors": [_door_entry(door) for door in doors],
            **({"warnings": warnings} if warnings else {}),
        },
    }


def _door_entry(door: Door) -> Json:
    """A door as the file states it; see `navbake.navgrid.doors.parse_doors`."""
    stated = {"id": door.id, "joint": door.joint, "rooms": list(door.rooms)}
    return {
        **stated,
        "state": door.state,
        "cells": _by_state(door.cells),
        **({"solid": _by_state(door.solid)} if door.solid else {}),
    }


def _by_state(cells: Mapping[str, Mapping[int, Runs]]) -> Json:
    return {state: list(map(list, runs.items())) for state, runs in cells.items()}


def _cut_doors(stages: Stages, windows: list[Window]) -> list[Door]:
    """The doors in the wanted state, with cells counted on each level's own rectangle."""

    def to_file(levels: list[Int]) -> dict[int, list[int]]:
        cut = (cut_cells(*pair, width)[0] for pair in zip(levels, windows, strict=True))
        return {number: to_runs(cells) for number, cells in enumerate(cut) if len(cells)}

    width, wanted = stages.lattice.width, stages.config.doors.state
    doors = []
    for door in stages.doors.placed:
        cells, solid = (
            {state: to_file(levels) for state, levels in by_state.items()}
            for by_state in (door.cells, door.solid)
        )
        doors.append(Door(door.id, door.joint, door.rooms, door.state(wanted), cells, solid))
    return doors


def _cut_links(links: Int, windows: list[Window], width: int) -> Int:
    """The links with cells counted on each level's own rectangle."""
    links = links.copy()
    for number, window in enumerate(windows):
        for level, cell in ((0, 1), (2, 3)):
            here = links[:, level] == number
            # a linked cell has a floor, so that none drops out
            links[here, cell] = cut_cells(links[here, cell], window, width)[0]
    return links
