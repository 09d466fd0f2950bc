"""The rooms that a grid tells of."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from navbake.errors import FormatError

if TYPE_CHECKING:
    from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D

WHERE = "metadata.navbake.rooms"


def describe_rooms(grid: SceneGrid2D | MultiLevelGrid) -> list[dict[str, Any]]:
    """List a grid's rooms, by level and index.

    Of files without a room table, what `roomIndex` tells.

    Args:
        grid: a grid of one or several levels.

    Returns:
        ``index`` (in `room_index`), ``id`` (unique in the file), ``name`` (or None), ``level``,
        ``area`` [m²], ``centroid`` (world x, y, z [m]), ``source`` (or None) and ``neighbours``
        of each; of these, ``room`` (its id), ``kind`` (open, door, link), ``door`` (or None).

    Raises:
        FormatError: the file's room table is broken.
    """
    stated = grid.navbake.get("rooms")
    if stated is None:
        return [
            room for number, level in enumerate(grid.levels) for room in _measure(level, number)
        ]
    if not isinstance(stated, list):
        raise FormatError(f"expected a list at `{WHERE}`, got {type(stated).__name__}")
    for number, room in enumerate(stated):
        _check(room, f"{WHERE}[{number}]", len(grid.levels))
    return sorted(stated, key=lambda room: (room["level"], room["index"]))


def _measure(level: SceneGrid2D, number: int) -> list[dict[str, Any]]:
    x, y = np.meshgrid(level.lattice.center_x(), level.lattice.center_y())
    floor = level.floor_height.astype(np.float64) * level.unit
    z = np.where(np.isnan(floor), level.ground, floor)
    index = level.room_index
    count = np.bincount(index.ravel())
    sums = [np.bincount(index.ravel(), values.ravel()) for values in (x, y, z)]
    return [
        {
            "index": int(room),
            "id": f"{number}:{room}",
            "name": None,
            "level": number,
            "area": round(float(count[room]) * level.lattice.cell_size**2, 6),
            "centroid": [round(float(total[room] / count[room]), 6) + 0.0 for total in sums],
            "source": None,
            "neighbours": [],
        }
        for room in np.flatnonzero(count)
        if room
    ]


def _check(room: Any, where: str, num_levels: int) -> None:
    if not isinstance(room, dict):
        raise FormatError(f"expected a room at `{where}`, got {type(room).__name__}")
    kinds: dict[str, tuple[type, ...]] = {
        "index": (int,),
        "id": (str,),
        "name": (str, type(None)),
        "level": (int,),
        "area": (int, float),
        "centroid": (list,),
        "neighbours": (list,),
    }
    for key, kind in kinds.items():
        if not isinstance(room.get(key), kind) or isinstance(room[key], bool):
            raise FormatError(f"expected {kind[0].__name__} at `{where}.{key}`")
    if not 0 <= room["level"] < num_levels or room["index"] < 1:
        raise FormatError(f"expected a level and an index that there are at `{where}`")
    if len(room["centroid"]) != 3 or not all(type(v) in (int, float) for v in room["centroid"]):
        raise FormatError(f"expected [x, y, z] at `{where}.centroid`")
    for neighbour in room["neighbours"]:
        if not isinstance(neighbour, dict) or not isinstance(neighbour.get("room"), str):
            raise FormatError(f"expected neighbours with a `room` at `{where}.neighbours`")
