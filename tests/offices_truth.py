"""Whether the rooms of a baked office or flat are those that a person would draw."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from navbake.baker.bake.stages import Stages, bake_stages
from navbake.navgrid.lattice import Lattice
from offices import Plan

IN_FRONT = 0.5  # metres: depth of what is looked at before and behind a window


def bake_plan(
    plan: Plan, folder: Path, *, as_mesh: bool, cell_size: float = 0.1, door_width: Any = "auto"
) -> Stages:
    """Bake a plan as boxes or as one mesh, as a user would who says nothing about its rooms."""
    path = folder / ("plan.stl" if as_mesh else "plan.xml")
    if as_mesh:
        plan.write_stl(path)
    else:
        path.write_text(plan.as_mjcf(), encoding="utf-8")
    return bake_stages(
        {
            "scene": {"path": str(path), "meshes": "surface"},
            "grid": {"cell_size": cell_size},
            "rooms": {"from": ["auto"], "door_width": door_width},
        }
    )


def overlaps(rooms: NDArray[np.uint16], truth: list[NDArray[np.bool_]]) -> list[float]:
    """Intersection over union of each true room with the room that most of it is in.

    Cells that are in no room count as missed. A room that is the best of several true ones has
    the others' cells in its union, so that it is right for one at most.
    """
    size = np.bincount(rooms.ravel())
    shares = []
    for mask in truth:
        inside = np.bincount(rooms[mask], minlength=len(size))
        inside[0] = 0
        room = int(inside.argmax())
        both = int(inside[room])
        shares.append(both / (np.count_nonzero(mask) + int(size[room]) - both) if both else 0.0)
    return shares


def count_leaks(rooms: NDArray[np.uint16], plan: Plan, lattice: Lattice) -> int:
    """The number of windows through whose opening the cells of one room are connected.

    Looked at are the cells in front of the opening and in it, so that a door beside it counts not.
    """
    u, v = plan.in_plan(lattice)
    leaks = 0
    for window in plan.windows:
        du, dv = u - window.middle[0], v - window.middle[1]
        along = np.abs(du * window.way[0] + dv * window.way[1])
        across = dv * window.way[0] - du * window.way[1]
        near = (along < window.width / 2) & (np.abs(across) < window.thick / 2 + IN_FRONT)
        for room in np.unique(rooms[near & (rooms > 0)]):
            part, _ = ndimage.label(near & (rooms == room), np.ones((3, 3)))
            sides = [set(np.unique(part[s * across > window.thick / 2])) - {0} for s in (-1, 1)]
            leaks += bool(sides[0] & sides[1])
    return leaks
