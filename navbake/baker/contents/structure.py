"""What the building itself is made of: floors, stairs, ceilings and roofs, but not its walls."""

from typing import NamedTuple

import numpy as np

from navbake.baker.connect import connect
from navbake.baker.floors.levels import Floors
from navbake.baker.kernels.constants import SAME, SLACK
from navbake.baker.lattice import list_differing
from navbake.baker.scene.extents import Extents
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.types import Bool, Float, Int, Int32

# A thing that one can stand on is at most this large, and lies at most this high over a floor
# unless it is solid down to it [m², m], in at least this share of its cells
THING_AREA, THING_HEIGHT, MOSTLY = 4.0, 1.0, 0.9
# What is no higher than this is no step on the way up [m]
COVERING = 0.03
# A ceiling is at least this wide both ways [m]
CEILING_WIDTH = 1.5

Steps = tuple[Int, Int, Float]
"""Pairs of geoms whose floors lie side by side: the lower, the higher, and by how much [m]."""


class Carriers(NamedTuple):
    """The geoms that carry floors, by geom id, shape (ngeom,), bool.

    Attributes:
        building: those that belong to the building.
        things: those that only lie on its floors.
        stood_on: those of both that one can stand on somewhere; the others only carry floor
            that continues under something.
    """

    building: Bool
    things: Bool
    stood_on: Bool


def find_carriers(
    counts: Int, stood_on: Bool, cell_size: float, step: float, steps: Steps
) -> Carriers:
    """Classify geoms that carry floors as parts of the building or things on its floors.

    A geom is a thing (a rug, a pallet, a low box, a boulder) if all of these hold:

    a. Its floor, with the floors that continue it at the same height, covers at most 4 m².
    b. In at least 90 % of its cells there is another floor below it,
    c. which is at most 1 m lower, or down to which it is solid.
    d. It covers 90 % of its cells by at most 3 cm, or no step leads up from it to the building.

    All else is the building's: floors, stairs, ramps, platforms, terrain.

    Args:
        counts: in how many cells each geom carries the floor, in how many of those it lies on
            another one (c), and in how many it only covers that (d), (3, ngeom).
        stood_on: whether one can stand on it anywhere, (ngeom,).
        step: the highest one [m].
    """
    cells, over, near = counts
    carries, is_over, covering = cells > 0, over >= MOSTLY * cells, near >= MOSTLY * cells
    low, high, rise = steps
    is_level = rise <= SAME
    plateau = connect(np.stack([low[is_level], high[is_level]]), len(cells))
    area = np.bincount(plateau, cells)[plateau] * cell_size**2
    things = carries & (area <= THING_AREA + SLACK) & is_over
    is_step = (rise > SAME) & (rise <= step + SLACK) & ~covering[low]
    low, high = low[is_step], high[is_step]
    # a thing that leads to the building is part of it, and may make another one lead there
    while (leads_up := np.unique(low[things[low] & ~things[high]])).size:
        things[leads_up] = False
    return Carriers(carries & ~things, things, stood_on)


def find_ceilings(extents: Extents, base: Float, static: Bool, agent: AgentSettings) -> Bool:
    """Mark ceilings and roofs: static, wide both ways, no taller than wide, and above head height.

    `base` is the least height of each geom over a floor that it hangs over, inf for none [m].
    """
    flat = extents.high - extents.low <= extents.thin
    high = base >= agent.height - SLACK
    ceilings: Bool = static & (extents.thin >= CEILING_WIDTH) & flat & high
    return ceilings


def find_steps(floors: Floors, carrier: Int32, lattice: Lattice) -> Steps:
    """Find where the floors of two geoms lie side by side.

    `carrier` is the geom that carries each floor, shape (levels, cells), -1 for none.
    """
    floor = np.concatenate([level.floor.ravel() for level in floors.levels])
    pairs = [floors.links[:, [0, 2]] * carrier.shape[1] + floors.links[:, [1, 3]]]
    for number, geom in enumerate(carrier.reshape(-1, *lattice.shape)):
        cells = list_differing(geom).T
        meet = (carrier[number][cells] >= 0).all(axis=1)
        pairs.append(cells[meet] + number * geom.size)  # cells of all levels are numbered on
    cells = np.concatenate(pairs)
    rise = floor[cells[:, 1]] - floor[cells[:, 0]]
    geoms = carrier.ravel()[cells].astype(np.int64)
    geoms[rise < 0] = geoms[rise < 0, ::-1]
    return geoms[:, 0], geoms[:, 1], np.abs(rise)
