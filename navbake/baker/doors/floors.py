"""Doors that one could walk on, such as trapdoors and bridges; the grid has no floor there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns import Columns, cast_columns, tile_shapes
from navbake.baker.doors.bodies import DoorBody, pose_doors
from navbake.baker.floors.levels import LevelFloor
from navbake.baker.kernels.constants import SLACK
from navbake.baker.scene.extents import measure_geoms
from navbake.baker.scene.scene import Scene
from navbake.baker.scene.shapes import Shapes
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice

Bool = NDArray[np.bool_]
Float = NDArray[np.float64]

LARGE = 0.5  # how much floor a door carries at least to be told of [m²]
HOW = {"modelled": "as it is modelled", "open": "when it is open", "closed": "when it is closed"}


def find_carrying_doors(
    scene: Scene,
    doors: Sequence[DoorBody],
    columns: Columns,
    floors: Sequence[LevelFloor],
    agent: AgentSettings,
) -> list[str]:
    """Tell of doors that carry half a square metre of floor or more, in any of their states.

    That is what faces up within the agent's slope, has its headroom, lies no more than a step
    from a floor beside it, and not on one (as a mat does).

    Args:
        scene: the whole scene, as modelled.
        doors: the doors.
        columns: all surfaces of what is no door.
        floors: the storeys, without doors.
        agent: its height, step and slope.

    Returns:
        A warning for each, one line.
    """
    told: dict[str, str] = {}
    for state, how in HOW.items():
        left = [door for door in doors if door.id not in told]
        if not left:
            break
        shapes = pose_doors(scene, left, state)
        extents = measure_geoms(shapes, scene.model.ngeom)
        for door in left:
            if np.nansum((extents.thin * extents.long)[door.geoms]) < LARGE - SLACK:
                continue
            mask = np.zeros(scene.model.ngeom, dtype=np.bool_)
            mask[door.geoms] = True
            area = _carried_area(shapes.only(mask), columns, floors, agent)
            if area >= LARGE - SLACK:
                told[door.id] = (
                    f"door {door.id!r} carries {area:.1f} m² of floor {how}, which the grid "
                    f"hasn't, as doors carry none: let `doors` leave it out if agents walk on it"
                )
    return [told[door.id] for door in doors if door.id in told]


def _carried_area(
    shapes: Shapes, columns: Columns, floors: Sequence[LevelFloor], agent: AgentSettings
) -> float:
    """How much of the top of a door one can stand on, if a step leads there [m²]."""
    lattice = columns.lattice
    bounds = shapes.bounds()
    window = None if bounds is None else lattice.window(bounds, 0.0)
    if window is None:
        return 0.0
    top = _tops(shapes, lattice.cut(*window), agent)
    rows, cols = window
    step = agent.traversable_floor_height + SLACK
    parts = [level.floor[window] for level in floors]
    for floor in parts:
        top[np.abs(top - floor) <= step] = np.nan
    row, col = np.nonzero(~np.isnan(top))
    for r, c in zip(row.tolist(), col.tolist(), strict=True):
        cell = (r + rows.start) * lattice.width + c + cols.start
        above = columns.z[columns.start[cell] : columns.start[cell + 1]]
        above = above[above > top[r, c] + SLACK]
        if len(above) and above[0] < top[r, c] + agent.height - SLACK:
            top[r, c] = np.nan
    if not any(_is_beside(top, floor, step) for floor in parts):
        return 0.0
    return float(np.count_nonzero(~np.isnan(top))) * lattice.cell_size**2


def _tops(shapes: Shapes, lattice: Lattice, agent: AgentSettings) -> Float:
    """The highest surface of each cell if one could stand on it by its slope, else NaN."""
    columns = cast_columns(tile_shapes(shapes, lattice, 0.0))
    top = np.full(lattice.width * lattice.height, np.nan)
    has_any = np.flatnonzero(np.diff(columns.start))
    last = columns.start[has_any + 1] - 1
    flat = columns.normal[last, 2] >= np.cos(np.radians(agent.max_slope)) - SLACK
    top[has_any[flat]] = columns.z[last[flat]]
    return top.reshape(lattice.shape)


def _is_beside(top: Float, floor: Float, step: float) -> bool:
    """Whether a floor lies no more than a step from a top in the next cell."""
    pairs = [
        (top[:, :-1], floor[:, 1:]),
        (top[:, 1:], floor[:, :-1]),
        (top[:-1], floor[1:]),
        (top[1:], floor[:-1]),
    ]
    return any(bool((np.abs(one - other) <= step).any()) for one, other in pairs)
