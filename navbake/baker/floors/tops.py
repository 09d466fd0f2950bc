"""Tops of what stands on a floor, such as beds, blocks and thick walls: no floors themselves."""

import numpy as np

from navbake.baker.floors.outline import (
    DROP,
    Edges,
    Endings,
    Site,
    find_edges,
    find_endings,
    find_rims,
    is_known,
    share_of_known,
)
from navbake.baker.kernels.constants import SLACK, TOUCH
from navbake.baker.kernels.occupancy import lines_blocked
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int

# A top drops to a floor along at least this share of its outline
DROP_SHARE = 0.25
# With room for an agent under more than this share of it, a sheet is a mezzanine, no top
ROOM_SHARE = 0.5
# Beds, counters and desks are smaller. A larger top has to lie on a floor that is larger [m²]
LARGE_TOP = 6.0


def find_tops(site: Site) -> Bool:
    """Find the tops of what stands on a floor: beds, blocks, counters, walls that are metres thick.

    A sheet that no step reaches is such a top when

    - at least a quarter of its outline drops to a floor that an agent could stand on, beside it
      (see `find_endings`): a house's floor on its plinth is none, because it ends at walls. Holes
      in a sheet belong to its outline only where they drop;
    - it has at most 6 m², or the largest floor that it drops to is larger than itself: what is
      larger than all that lies lower is the ground, and what lies lower a pool, a ditch, a track
      bed or a yard in front of a dock. A floor that winds through the sheet makes it a block with
      corridors nevertheless, whatever their sizes: the rim of a hole that it drops to is longer
      there than its outer outline, which a pit's is not;
    - there is no room for an agent under most of it, from the height of that floor up: so a
      mezzanine is none, because one can stand below.

    Returns:
        Which sheets they are, shape (sheets,), bool.
    """
    standable, agent = site.large, site.agent
    size, step = standable.sheet_size, agent.traversable_floor_height
    edges = find_edges(standable, size > 0, step, site.reach)
    # most sheets have no floor below their edges: only the others are looked at closely
    has_floor = np.asarray((~np.isnan(edges.floors)).any(axis=1))
    asked = np.bincount(standable.sheet[edges.surface], has_floor, len(size)) > 0
    of_asked = asked[standable.sheet[edges.surface]]
    edges, has_floor = edges.only(of_asked), has_floor[of_asked]
    rim = find_rims(edges, standable)
    certain = ((edges.cells[:, 0] >= 0) | ~site.cropped[edges.way]) & (rim == 0)
    may_drop = ~(share_of_known(standable, edges, has_floor, certain | has_floor) < DROP_SHARE)
    chosen = may_drop[standable.sheet[edges.surface]]
    edges, rim = edges.only(chosen), rim[chosen]
    endings = find_endings(edges, standable, site.columns, agent, site.is_occupied)
    drops, known = endings.kind == DROP, is_known(edges, endings.kind, site.cropped)
    # other holes are where things stand on the sheet, such as pillows
    known &= (rim == 0) | drops
    is_top = share_of_known(standable, edges, drops, known) >= DROP_SHARE
    is_top &= _lies_on_floor(site, edges, endings, rim, is_top)
    sheet, landing = standable.sheet[edges.surface[drops]], endings.landing[drops]
    beside = _medians(sheet, landing, np.bincount(sheet, minlength=len(size)))
    beside[~is_top] = np.nan
    return is_top & (_count_over_room(site, beside) <= ROOM_SHARE * size)


def _lies_on_floor(site: Site, edges: Edges, endings: Endings, rim: Int, asked: Bool) -> Bool:
    """Whether sheets lie on a floor that is larger, or that winds through them; small ones do."""
    standable, drops = site.large, np.flatnonzero(endings.kind == DROP)
    size, sheet = standable.sheet_size, standable.sheet[edges.surface]
    largest = np.zeros(len(size), dtype=np.int64)
    floor = standable.sheets_at(endings.cell[drops], endings.landing[drops])
    np.maximum.at(largest, sheet[drops], size[floor])
    lies = (size * standable.lattice.cell_size**2 <= LARGE_TOP) | (largest > size)
    for number in np.unique(sheet[(asked & ~lies)[sheet]]):
        own = sheet == number
        drops_in = np.bincount(rim[own], endings.kind[own] == DROP)
        lies[number] = drops_in[1:].max(initial=0) > (rim[own] == 0).sum()
    return lies


def _medians(group: Int, values: Float, count: Int) -> Float:
    """The median of each group's values, the lower of two, NaN where a group has none."""
    ordered = values[np.lexsort((values, group))]
    median = np.full(len(count), np.nan)
    filled = np.flatnonzero(count)
    middle = np.cumsum(count) - count + (count - 1) // 2
    median[filled] = ordered[middle[filled]]
    return median


def _count_over_room(site: Site, beside: Float) -> Int:
    """Count the cells of each sheet under which there is room for an agent.

    It stands there at the height of the floor beside, shape (sheets,), or on a floor above that
    [m]; NaN for sheets that are not asked for.
    """
    standable, agent = site.large, site.agent
    asked = np.flatnonzero(~np.isnan(beside[standable.sheet]))
    sheet, cells = standable.sheet[asked], standable.cell[asked].astype(np.int64)
    floor, step = beside[sheet], agent.traversable_floor_height
    below = asked - 1
    has_floor = (below >= 0) & (standable.cell[below] == cells)
    has_floor &= standable.z[below] >= floor - step - SLACK
    blocked = np.zeros(len(cells), dtype=np.bool_)
    low, high = floor + step + TOUCH, floor + agent.height - TOUCH
    lines = cells, low, high, site.columns.at(cells).crossings, blocked
    run_in_bands(lines_blocked, len(cells), *lines, least=1000)
    return np.bincount(sheet[has_floor | ~blocked], minlength=len(beside))
