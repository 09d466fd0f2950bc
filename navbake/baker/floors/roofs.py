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
    probe_bands,
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
# Steps by row and column against the ways of edges: east, south, west, north
INWARD = np.array([[0, -1], [-1, 0], [0, 1], [1, 0]])
# No shelf is deeper: pallet racks are 1.1 m, or 2.2 m back to back [m]
SHELF_DEPTH = 2.5


def drop_roofs(
    standable: Standable,
    columns: Columns,
    agent: AgentSettings,
    settings: FloorSettings,
    is_occupied: OccupancyTest,
) -> Standable:
    """Drop the sheets that are roofs: open to the sky, over a floor, and without walls.

    A storey that was drawn without its ceiling has walls as high as an agent along more than half
    of its outline, and stays. Its walls may stand a little inside of its slab's rim, even where
    they are too thin to part its floor. Parapets are too low, and a lower roof beside a higher
    part of the house has a wall on one side only. What is closed below, or open, does not matter:
    a carport's roof is one, and so are a tree's crown, a parasol and the upper shelf of a rack
    outdoors. No step reaches a roof: the sheet of one that stairs lead to includes the floors
    below, which are not open to the sky.

    Only the uppermost slab of a tower of slabs on columns is a roof, as the others are covered.

    Args:
        settings: `shrink`, how far inside of the outline walls may stand [m].
    """
    if (np.diff(standable.start) <= 1).all():
        return standable
    sky, over = _shares(standable, columns)
    candidates = (sky >= SKY_SHARE) & (over >= HALF)
    if not candidates.any():
        return standable
    edges = _outer_edges(standable, candidates, agent, reach=1)
    ending, _ = find_endings(edges, standable, columns, agent, is_occupied)
    # how the sheet ends beyond the lattice is not known
    is_wall, is_known = ending == WALL, ending != BORDER
    reach = int(np.ceil(settings.shrink / standable.lattice.cell_size))
    ends = np.flatnonzero(is_known & ~is_wall)
    is_wall[ends] = _find_inner_walls(edges.only(ends), standable, agent, reach, is_occupied)
    walls, known = (_count(standable, edges, which) for which in (is_wall, is_known))
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
    ending, _ = find_endings(edges, standable, columns, agent, is_occupied)
    drops = ending == DROP
    num_drops, num_edges = (_count(standable, edges, which) for which in (drops, ending >= 0))
    return standable.only_sheets(~candidates | (num_drops <= HALF * num_edges))


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


def _find_inner_walls(
    edges: Edges, standable: Standable, agent: AgentSettings, reach: int, is_occupied: OccupancyTest
) -> Bool:
    """Whether a wall stands on a sheet near each of some edges, at most `reach` cells inside."""
    lattice, z = standable.lattice, standable.z[edges.surface]
    bands = probe_bands(agent)
    row, col = np.divmod(standable.cell[edges.surface], lattice.width)
    inward_row, inward_col = INWARD[edges.way].T
    has_wall = np.zeros(len(z), dtype=np.bool_)
    for k in range(1, reach + 1):
        beside_row, beside_col = row + k * inward_row, col + k * inward_col
        inside = (beside_row >= 0) & (beside_row < lattice.height)
        inside &= (beside_col >= 0) & (beside_col < lattice.width)
        asked = np.flatnonzero(inside & ~has_wall)
        cells = beside_row[asked] * lattice.width + beside_col[asked]
        for band in bands:
            stands = is_occupied(cells, z[asked], band)
            asked, cells = asked[stands], cells[stands]
        has_wall[asked] = True
    return has_wall


def _count(standable: Standable, edges: Edges, which: Bool) -> Float:
    """How many edges of each sheet are of some kind."""
    sheet = standable.sheet[edges.surface]
    count: Float = np.bincount(sheet, which, len(standable.sheet_size)).astype(np.float64)
    return count
