"""Doors that an agent could walk on, such as trapdoors and bridges; the grid has no floor there."""

from collections.abc import Sequence

import numpy as np

from navbake.baker.columns import ColumnSource, cast_columns, tile_shapes
from navbake.baker.doors.candidates import DoorCandidate, pose_doors
from navbake.baker.floors.levels import LevelFloor
from navbake.baker.kernels.constants import SLACK
from navbake.baker.lattice import EDGES
from navbake.baker.scene.extents import measure_geoms
from navbake.baker.scene.scene import Scene
from navbake.baker.scene.shapes import Shapes
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.types import Float

MIN_AREA = 0.5  # of floor on a door that is worth a warning [m²]
WHEN = {"modelled": "as it is modelled", "open": "when it is open", "closed": "when it is closed"}


def warn_walkable_doors(
    scene: Scene,
    doors: Sequence[DoorCandidate],
    columns: ColumnSource,
    floors: Sequence[LevelFloor],
    agent: AgentSettings,
) -> list[str]:
    """Warn of doors that carry 0.5 m² of floor or more, in any of their states.

    Floor is what faces up within the agent's slope and has its headroom. It has to lie no more
    than a step from a floor beside it, and not on a floor, as a mat does. The columns and floors
    are without doors.
    """
    warnings: dict[str, str] = {}
    for state, when in WHEN.items():
        left = [door for door in doors if door.id not in warnings]
        if not left:
            break
        shapes = pose_doors(scene, left, state)
        extents = measure_geoms(shapes, scene.model.ngeom)
        for door in left:
            # seen from above, most doors are too small, which is quickly found
            if np.nansum((extents.thin * extents.long)[door.geoms]) < MIN_AREA - SLACK:
                continue
            area = _walkable_area(door.only(shapes), columns, floors, agent)
            if area >= MIN_AREA - SLACK:
                warnings[door.id] = (
                    f"door {door.id!r} carries {area:.1f} m² of floor {when}, which is "
                    f"missing in the grid, because doors carry no floor: exclude it from `doors` "
                    f"if agents walk on it"
                )
    return [warnings[door.id] for door in doors if door.id in warnings]


def _walkable_area(
    shapes: Shapes, columns: ColumnSource, floors: Sequence[LevelFloor], agent: AgentSettings
) -> float:
    """How much of the top of a door an agent can stand on, if a step leads there [m²]."""
    lattice, bounds = columns.lattice, shapes.bounds()
    window = None if bounds is None else lattice.window(bounds)
    if window is None:
        return 0.0
    top = _level_tops(shapes, lattice.cut(*window), agent)
    rows, cols = window
    step = agent.traversable_floor_height + SLACK
    parts = [level.floor[window] for level in floors]
    for floor in parts:  # what lies on a floor is a mat
        top[np.abs(top - floor) <= step] = np.nan
    places = np.argwhere(~np.isnan(top))
    known = columns.at((places[:, 0] + rows.start) * lattice.width + places[:, 1] + cols.start)
    for r, c in places.tolist():
        cell = (r + rows.start) * lattice.width + c + cols.start
        above = known.z[known.start[cell] : known.start[cell + 1]]
        above = above[above > top[r, c] + SLACK]
        if len(above) and above[0] < top[r, c] + agent.height - SLACK:
            top[r, c] = np.nan
    if not any(_is_beside(top, floor, step) for floor in parts):
        return 0.0
    return float(np.count_nonzero(~np.isnan(top))) * lattice.cell_size**2


def _level_tops(shapes: Shapes, lattice: Lattice, agent: AgentSettings) -> Float:
    """The height of each cell's highest surface if its slope allows to stand on it, else NaN."""
    columns = cast_columns(tile_shapes(shapes, lattice, 0.0))
    top = np.full(lattice.width * lattice.height, np.nan)
    has_any = np.flatnonzero(np.diff(columns.start))
    last = columns.start[has_any + 1] - 1
    flat = columns.normal[last, 2] >= np.cos(np.radians(agent.max_slope)) - SLACK
    top[has_any[flat]] = columns.z[last[flat]]
    return top.reshape(lattice.shape)


def _is_beside(top: Float, floor: Float, step: float) -> bool:
    """Whether a floor lies no more than a step from a top in the next cell."""
    sides = [(a, b) for one, other in EDGES for a, b in ((one, other), (other, one))]
    return any(bool((np.abs(top[a] - floor[b]) <= step).any()) for a, b in sides)
