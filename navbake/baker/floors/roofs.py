"""Roofs and shelves: sheets over a floor that no step reaches, and that are no storeys."""

import numpy as np
from scipy import ndimage

from navbake.baker.columns import Columns
from navbake.baker.floors.outline import (
    BORDER,
    DROP,
    WALL,
    Edges,
    OccupancyTest,
    find_edges,
    find_endings,
)
from navbake.baker.floors.sheets import AreaTest, Standable, mask_window
from navbake.baker.kernels.constants import SLACK
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.types import Bool, Float

# The share of a roof that lies open to the sky: a higher one's eaves may cover a lower one's side
SKY_SHARE = 0.75
# The share of a roof or a shelf that lies over a floor; and the share of its outline that has
# walls if it is a storey, or that drops if it is a shelf
HALF = 0.5
# No shelf is deeper: pallet racks are 1.1 m, or 2.2 m back to back [m]
SHELF_DEPTH = 2.5


def drop_roofs(
    standable: Standable, columns: Columns, agent: AgentSettings, is_occupied: OccupancyTest
) -> Standable:
    """Drop the sheets that are roofs: open to the sky, over a floor, and without walls.

    A storey that was drawn without its ceiling has walls as high as an agent along more than half
    of its outline, and stays; parapets are too low, and a lower roof beside a higher part of the
    house has a wall on one side only. What is closed below, or open, does not matter: a carport's
    roof is one, and so are a tree's crown, a parasol and the upper shelf of a rack outdoors. No
    step reaches a roof: the sheet of one that stairs lead to includes the floors below, which
    are not open to the sky.

    Only the uppermost slab of a tower of slabs on columns is a roof, as the others are covered.
    """
    if (np.diff(standable.start) <= 1).all():
        return standable
    sky, over = _shares(standable, columns)
    candidates = (sky >= SKY_SHARE) & (over >= HALF)
    if not candidates.any():
        return standable
    edges = _outer_edges(standable, candidates, agent, reach=1)
    ending, _ = find_endings(edges, standable, agent, is_occupied)
    # how the sheet ends beyond the lattice is not known
    walls, known = (_count(standable, edges, which) for which in (ending == WALL, ending != BORDER))
    return standable.only_sheets(~candidates | (walls > HALF * known))


def drop_shelves(
    standable: Standable,
    columns: Columns,
    agent: AgentSettings,
    settings: FloorSettings,
    is_occupied: OccupancyTest,
) -> Standable:
    """Drop the sheets that are shelves, under whatever ceiling: narrow, and open at their sides.

    A shelf lies over a floor, is nowhere deeper than 2.5 m, and more than half of its outline
    drops to a floor beside it. So a mezzanine that no stair leads to is none, because it is
    deeper, nor a gallery from wall to wall, because one of its two sides is a wall, nor what is
    left to stand in of an attic. What is open to the sky is left to `drop_roofs`.

    Args:
        settings: `shrink`, how far from the sheet's edge the floor beside may begin [m].
    """
    if (np.diff(standable.start) <= 1).all():
        return standable
    sky, over = _shares(standable, columns)
    candidates = (sky < SKY_SHARE) & (over >= HALF)
    lattice = standable.lattice
    deep = {"min_area": lattice.cell_size**2, "shrink": SHELF_DEPTH / 2}
    test = AreaTest(lattice, settings.model_copy(update=deep))
    for sheet, members in standable.members(np.flatnonzero(candidates)):
        candidates[sheet] = not test.passes(standable.cell[members])
    if not candidates.any():
        return standable
    # a post at its edge may block the cell beside: one more
    reach = int(np.ceil(settings.shrink / lattice.cell_size)) + 1
    edges = _outer_edges(standable, candidates, agent, reach)
    ending, landing = find_endings(edges, standable, agent, is_occupied)
    drops = (ending == DROP) & _is_open(edges, landing, standable.z[edges.surface], columns)
    num_drops, num_edges = (_count(standable, edges, which) for which in (drops, ending >= 0))
    return standable.only_sheets(~candidates | (num_drops <= HALF * num_edges))


def _is_open(edges: Edges, landing: Float, z: Float, columns: Columns) -> Bool:
    """Whether nothing lies between the floor that an edge drops to and the edge's own height.

    An attic ends where its roof comes down. The storey below is no floor that it drops to.
    """
    lands = np.argmax(edges.floors == landing[:, None], axis=1)
    cell = edges.cells[np.arange(len(lands)), lands]
    first, last = columns.start[cell], columns.start[cell + 1]
    is_open = np.ones(len(cell), dtype=np.bool_)
    for k in range(int((last - first).max(initial=0))):
        height = columns.z[np.minimum(first + k, last - 1)]
        is_open &= (height <= landing + SLACK) | (height > z)
    return is_open


def _shares(standable: Standable, columns: Columns) -> tuple[Float, Float]:
    """The share of each sheet that is open to the sky, and that lies over another that counts."""
    cells, sheet, size = standable.cell, standable.sheet, np.maximum(standable.sheet_size, 1)
    last_of_column = columns.start[cells + 1] - 1
    to_sky = columns.z[last_of_column] - standable.z <= SLACK
    below = np.maximum(np.arange(len(cells)) - 1, 0)
    over_floor = (cells[below] == cells) & (sheet[below] != sheet)
    return (
        np.bincount(sheet, to_sky, len(size)) / size,
        np.bincount(sheet, over_floor, len(size)) / size,
    )


def _outer_edges(standable: Standable, chosen: Bool, agent: AgentSettings, reach: int) -> Edges:
    """The edges of some sheets along their outlines, without those of the holes in them.

    What stands on a roof, or on a shelf, interrupts its sheet, but is no wall around it.
    """
    edges = find_edges(standable, chosen, agent.traversable_floor_height, reach)
    width, outer = standable.lattice.width, edges.cells[:, 0]
    sheet = standable.sheet[edges.surface]
    kept = outer < 0
    for number, members in standable.members(np.flatnonzero(chosen)):
        mask, row0, col0 = mask_window(standable.cell[members], standable.lattice, margin=1)
        outside = ~ndimage.binary_fill_holes(mask)
        own = np.flatnonzero((sheet == number) & (outer >= 0))
        row, col = np.divmod(outer[own], width)
        kept[own] = outside[row - row0, col - col0]
    return edges.only(kept)


def _count(standable: Standable, edges: Edges, which: Bool) -> Float:
    """How many edges of each sheet are of some kind."""
    sheet = standable.sheet[edges.surface]
    count: Float = np.bincount(sheet, which, len(standable.sheet_size)).astype(np.float64)
    return count
