"""Labyrinths and decks of boards, for tests and sweeps."""

from __future__ import annotations

import math

import numpy as np

from box_worlds import box, world
from navbake.types import Bool


def labyrinth(walls: Bool, corridor: float, wall: float | None = None, height: float = 2.0) -> str:
    """An MJCF of the walls of a maze on a slab.

    Args:
        walls: which squares are wall, shape (rows, cols), walls in odd rows and columns only.
        corridor: width of the squares in even rows and columns [m].
        wall: of the others; that of corridors if None [m].
    """
    widths = [
        np.where(np.arange(num) % 2, corridor, corridor if wall is None else wall)
        for num in walls.shape
    ]
    y, x = (np.concatenate([[0.0], np.cumsum(width)]).tolist() for width in widths)
    geoms = [box("", 0, 0, -0.1, x[-1], y[-1], 0)]
    for row, line in enumerate(walls.tolist()):
        ends = np.flatnonzero(np.diff([False, *line, False])).reshape(-1, 2).tolist()
        geoms += [box("", x[a], y[row], 0, x[b], y[row + 1], height) for a, b in ends]
    return world("".join(geoms))


def open_area(walls: Bool, corridor: float, wall: float | None = None) -> float:
    """What a labyrinth's corridors cover [m²]."""
    rows, cols = (
        np.where(np.arange(num) % 2, corridor, corridor if wall is None else wall)
        for num in walls.shape
    )
    return float(np.outer(rows, cols)[~walls].sum())


def boards(width: float, gap: float, turn: float = 0.0, tilt: float = 0.0, storeys: int = 1) -> str:
    """Decks of boards of 5 x 4 m, over a slab of 6 x 6 m half a metre below; more at 3 m each.

    Args:
        turn, tilt: of all about z, and of boards about x before [degrees].
    """
    geoms, pitch = ['<geom type="box" pos="0 0 -.6" size="3 3 .1"/>'], width + gap
    turns = f"{math.cos(math.radians(turn) / 2)!r} 0 0 {math.sin(math.radians(turn) / 2)!r}"
    for storey in range(storeys):
        tilts = tilt if storey == 0 else 0.0
        geoms.append(f'<body pos="0 0 {3 * storey}" quat="{turns}"><body euler="{tilts} 0 0">')
        for k in range(-int(2.5 / pitch), int(2.5 / pitch) + 1):
            x = k * pitch + 0.0137
            geoms.append(f'<geom type="box" pos="{x!r} 0 -.1" size="{width / 2!r} 2 .1"/>')
        geoms.append("</body></body>")
    return world("".join(geoms))
