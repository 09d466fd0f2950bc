"""What the building itself is made of: floors, stairs, ceilings and roofs, but not its walls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from navbake.baker.floors.levels import Floors
from navbake.baker.kernels.constants import SAME, SLACK
from navbake.baker.kernels.contents import count_supports
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


class FloorSupport(NamedTuple):
    """What carries the floor of a storey.

    Attributes:
        geom: the geom whose surface each cell's floor is, shape (cells,), int32, -1 for none.
        gap: how far the next geom's floor lies below, shape (cells,), float64, inf for none [m].
    """

    geom: Int32
    gap: Float


class SupportCounts(NamedTuple):
    """By geom id: the cells whose floor it carries, shape (ngeom,), int64.

    Attributes:
        cells: how many there are.
        over: in how many the geom lies over another floor, no higher than a thing does.
        near: in how many it only covers one.
        stood_on: whether one can stand on it in any, bool.
    """

    cells: Int
    over: Int
    near: Int
    stood_on: Bool


@dataclass(frozen=True)
class Carriers:
    """The geoms that carry floors, by geom id, shape (ngeom,), bool.

    Attributes:
        building: those that belong to the building.
        things: those that only lie on its floors.
        stood_on: those of both that one can stand on somewhere; the others carry no more than
            what goes on of a floor under something.
    """

    building: Bool
    things: Bool
    stood_on: Bool


def find_carriers(
    floors: Floors,
    supports: Sequence[FloorSupport],
    extents: Extents,
    agent: AgentSettings,
    lattice: Lattice,
) -> Carriers:
    """Part the geoms that carry floors into those of the building and things on its floors.

    A thing (a rug, a pallet, a low box, a boulder) is at most 4 m² large together with what
    goes on at its height, lies over another floor, at most 1 m higher or solid down to it, and
    leads nowhere: no step goes on from it to a floor of the building. All else is the
    building's: floors, stairs, ramps, platforms, terrain.

    Args:
        floors: the storeys.
        supports: what carries them.
        extents: the geoms'.
        agent: its step.
        lattice: the cells.
    """
    num = len(extents.thin)
    cells, over, near = (np.zeros(num, dtype=np.int64) for _ in range(3))
    counts = SupportCounts(cells, over, near, np.zeros(num, dtype=np.bool_))
    height = np.fmax(extents.high - extents.low + COVERING, THING_HEIGHT) + SLACK
    for support, level in zip(supports, floors.levels, strict=True):
        count_supports(support, level.standable.ravel(), height, COVERING + SLACK, counts)
    carries, is_over, covering = cells > 0, over >= MOSTLY * cells, near >= MOSTLY * cells
    low, high, rise = _steps(floors, np.stack([support.geom for support in supports]), lattice)
    area = _plateau_cells(low, high, rise, cells) * lattice.cell_size**2
    things = carries & (area <= THING_AREA + SLACK) & is_over
    is_step = (rise > SAME) & (rise <= agent.traversable_floor_height + SLACK) & ~covering[low]
    low, high = low[is_step], high[is_step]
    while (leads_up := np.unique(low[things[low] & ~things[high]])).size:
        things[leads_up] = False
    return Carriers(carries & ~things, things, counts.stood_on)


def find_ceilings(extents: Extents, base: Float, static: Bool, agent: AgentSettings) -> Bool:
    """Mark ceilings and roofs: static, wide both ways, no taller than wide, and over all heads.

    Args:
        extents: the geoms'.
        base: least height of each geom over a floor that it hangs over, inf for none [m].
        static: which geoms can't move.
        agent: its height.
    """
    with np.errstate(invalid="ignore"):
        flat = extents.high - extents.low <= extents.thin
        wide = extents.thin >= CEILING_WIDTH
    ceilings: Bool = static & wide & flat & (base >= agent.height - SLACK)
    return ceilings


def _steps(floors: Floors, carrier: Int32, lattice: Lattice) -> tuple[Int, Int, Float]:
    """Pairs of geoms whose floors lie side by side: the lower, the higher, and by how much.

    Args:
        floors: the storeys.
        carrier: what carries them, shape (levels, cells), -1 for none.
        lattice: the cells.
    """
    floor = np.stack([level.floor.ravel() for level in floors.levels])
    links = floors.links
    ones = [carrier[links[:, 0], links[:, 1]]]
    others = [carrier[links[:, 2], links[:, 3]]]
    rises = [floor[links[:, 2], links[:, 3]] - floor[links[:, 0], links[:, 1]]]
    for number in range(len(carrier)):
        grid = carrier[number].reshape(lattice.shape)
        for beside, one, other in (
            (1, grid[:, :-1], grid[:, 1:]),
            (lattice.width, grid[:-1], grid[1:]),
        ):
            row, col = np.nonzero((one != other) & (one >= 0) & (other >= 0))
            a = row * lattice.width + col
            ones.append(carrier[number, a])
            others.append(carrier[number, a + beside])
            rises.append(floor[number, a + beside] - floor[number, a])
    first, second, rise = np.concatenate(ones), np.concatenate(others), np.concatenate(rises)
    low, high = np.where(rise >= 0, first, second), np.where(rise >= 0, second, first)
    return low.astype(np.int64), high.astype(np.int64), np.abs(rise)


def _plateau_cells(low: Int, high: Int, rise: Float, cells: Int) -> Int:
    """How many cells each geom carries together with all that go on at the same height."""
    level = rise <= SAME
    pairs = np.ones(int(level.sum())), (low[level], high[level])
    graph = coo_array(pairs, shape=(len(cells), len(cells)))
    _, plateau = connected_components(graph, directed=False)
    total: Int = np.bincount(plateau, cells).astype(np.int64)[plateau]
    return total
