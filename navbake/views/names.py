"""Which names a picture shows, and where: of rooms and of doors."""

from __future__ import annotations

import numpy as np

from navbake.navgrid.door_lines import DoorLine
from navbake.navgrid.grid import NavGrid, SceneGrid2D
from navbake.navgrid.rooms import Room
from navbake.types import Bool
from navbake.views.panel import Label

MAX_SIDE = 400  # cells of a room that are looked at for a name's place, along its longer side


def label_rooms(grid: NavGrid, number: int) -> tuple[Label, ...]:
    """The names of a level's rooms, each where the largest disc fits into the room."""
    # Imported here, as scipy takes longer to load than most pictures to draw.
    from scipy.ndimage import find_objects

    level = grid.levels[number]
    boxes = find_objects(level.room_index.astype(np.int32))
    labels = []
    for room in grid.rooms:
        if room.level == number and room.index <= len(boxes) and boxes[room.index - 1]:
            box = boxes[room.index - 1]
            labels.append(_place_name(level, level.room_index[box] == room.index, box, room))
    return tuple(labels)


def label_doors(marks: tuple[DoorLine, ...]) -> tuple[Label, ...]:
    """The doors' ids and widths, each in the middle of its doorway."""
    return tuple(
        Label(
            f"{mark.id} {mark.width:.1f} m", f"{mark.width:.1f} m", *mark.middle, 0.0, 0.0, number
        )
        for number, mark in enumerate(marks, 1)
    )


def _place_name(level: SceneGrid2D, mask: Bool, box: tuple[slice, slice], room: Room) -> Label:
    """Put a room's name into the middle of the runs of its cells through the disc's centre."""
    from scipy.ndimage import distance_transform_edt  # as above

    stride = max(1, -(-max(mask.shape) // MAX_SIDE))
    mask = mask[::stride, ::stride]
    space = distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1]
    row, col = np.unravel_index(int(np.argmax(space)), space.shape)
    first, last = _run(mask[row], int(col))
    top, bottom = _run(mask[:, (first + last) // 2], int(row))
    middle = box[0].start + row * stride, box[1].start + (first + last) / 2 * stride
    x, y = level.lattice.positions(*middle)
    edge = level.lattice.cell_size * stride
    half = min(int(row) - top, bottom - int(row))  # the name's middle is in this row
    size = (last - first + 1) * edge, (2 * half + 1) * edge
    fallback = f"{room.level}:{room.index}"
    return Label(room.name or fallback, fallback, float(x), float(y), *size, room.index)


def _run(line: Bool, at: int) -> tuple[int, int]:
    """The first and the last of the true values in a row that hold a place."""
    others = np.flatnonzero(~np.pad(line, 1)) - 1
    after = int(np.searchsorted(others, at))
    return int(others[after - 1]) + 1, int(others[after]) - 1
