"""Cracks: gaps between floors at one height that are too narrow for any agent."""

from __future__ import annotations

import numpy as np

from navbake.baker.columns import Columns, TiledShapes, cast_points, tiles_of_rows
from navbake.baker.floors.surfaces import agent_limits
from navbake.baker.kernels.arrays import Crossings
from navbake.baker.kernels.constants import OPEN_SURFACE, SAME, SLACK
from navbake.baker.kernels.cracks import (
    AWAY,
    CELL,
    GEOM,
    HEIGHT,
    RADIUS,
    SAME_PIECE,
    SAME_WAY,
    WAY,
    list_sides,
)
from navbake.baker.kernels.overlap import lines_blocked
from navbake.baker.seams import splice_columns
from navbake.config.settings import AgentSettings
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int

HAIR = 1e-6  # rays are cast this far beyond an edge [m]
ALL = np.empty(0, dtype=np.bool_)


def close_cracks(
    columns: Columns, tiled: TiledShapes, agent: AgentSettings, crack: float, asked: Bool = ALL
) -> Columns:
    """Add to columns the floors that bridge the cracks in which their lines run.

    Where surfaces that an agent could stand on are within a step of one height on opposite sides of
    a line, each nearer than `crack` [m], and none on it, the lower one is added to the line's
    column, as an open surface; of several within a step the lowest. Other cells do not matter.

    Args:
        tiled: what the columns were cast at, listed for lines up to `crack` away.
        asked: the cells whose cracks are closed, shape (cells,), all if it is empty.
    """
    if crack == 0:
        return columns
    shapes, parts = tiled.shapes, dict[int, tuple[Float, int]]()
    limits, tiles = agent_limits(agent), tiles_of_rows(columns.lattice, columns.known_rows)

    def find(first: int, end: int) -> None:
        geometry = shapes.solids, tiled.facets, tiled.tiles
        lines = columns.lattice, columns.crossings
        parts[first] = list_sides(*lines, *geometry, limits, crack, asked, first, end)

    run_in_bands(find, len(tiles), begin=tiles.start)
    found = [parts[first] for first in sorted(parts)]
    if not any(count for _, count in found):
        return columns
    sides = np.concatenate([notes[:count] for notes, count in found])
    sides = sides[np.argsort(sides[:, CELL], kind="stable")]
    cell, geom, way = sides[:, CELL].astype(np.int64), sides[:, GEOM], sides[:, WAY : WAY + 2]

    # rays just beyond the edges find the exact surfaces there
    beyond = columns.lattice.positions(*np.divmod(cell, columns.lattice.width))
    beyond += way * (sides[:, AWAY, None] + HAIR)
    rays = cast_points(tiled, cell, beyond)
    line = np.repeat(np.arange(len(cell)), np.diff(rays.start))
    off, is_up = abs(rays.z - sides[line, HEIGHT]), rays.normal[:, 2] >= limits.min_up
    is_piece = is_up & (rays.geom == geom[line]) & (off <= SAME_PIECE + sides[line, RADIUS])
    seen = np.flatnonzero(is_piece)
    seen = seen[np.lexsort((off[seen], line[seen]))]
    line, nearest = np.unique(line[seen], return_index=True)
    seen, cell, way = seen[nearest], cell[line], way[line]
    # a surface buried there, and not on the cell's line, only ends at the foot of something
    is_side = ~_are_buried(rays, line, rays.z[seen])
    is_side |= _are_buried(columns.crossings, cell, rays.z[seen])
    seen, cell, way = seen[is_side], cell[is_side], way[is_side]

    # of each two opposite sides the lower one bridges the line
    z, bridge = rays.z[seen], np.zeros(len(seen), dtype=np.bool_)
    for apart in range(1, int(np.unique(cell, return_counts=True)[1].max(initial=1))):
        one, other = slice(None, -apart), slice(apart, None)
        are_sides = (cell[one] == cell[other]) & (abs(z[one] - z[other]) <= limits.step + SLACK)
        are_sides &= (way[one] * way[other]).sum(axis=1) <= -SAME_WAY
        bridge[one] |= are_sides & (z[one] <= z[other])
        bridge[other] |= are_sides & (z[other] <= z[one])
    seen, cell, z = seen[bridge], cell[bridge], z[bridge]
    order, kept = np.lexsort((rays.geom[seen], z, cell)), list[int]()
    for n in order.tolist():  # of those of a cell within a step, the lowest
        if not kept or cell[kept[-1]] != cell[n] or z[n] - z[kept[-1]] > limits.step + SLACK:
            kept.append(n)
    return _add(columns, cell[kept], rays, seen[kept]) if kept else columns


def _are_buried(crossings: Crossings, cells: Int, z: Float) -> Bool:
    """Whether lines run within something just above a height."""
    buried = np.empty(len(cells), dtype=np.bool_)
    lines_blocked(cells, z + SAME, z + 2.0 * SAME, crossings, buried, 0, len(cells))
    return buried


def _add(columns: Columns, cell: Int, rays: Crossings, seen: Int) -> Columns:
    """Add surfaces to columns, by cell and then height."""
    old, z = columns.crossings, rays.z[seen]
    place, last = old.start[cell], old.start[cell + 1]
    while (below := (place < last) & (old.z[np.minimum(place, len(old.z) - 1)] < z)).any():
        place = place + below
    closed = np.full(len(z), OPEN_SURFACE, np.uint8)
    added = Crossings(np.arange(len(z) + 1), z, rays.normal[seen], rays.geom[seen], closed)
    return splice_columns(columns, cell, place, place, added)
