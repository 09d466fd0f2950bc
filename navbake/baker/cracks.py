"""Cracks: gaps between floors at one height that are too narrow to be any."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from navbake.baker.columns import Columns, TiledShapes, tiles_of_rows
from navbake.baker.floors.surfaces import agent_limits
from navbake.baker.kernels.arrays import Crossings
from navbake.baker.kernels.constants import OPEN_SURFACE, SLACK
from navbake.baker.kernels.cracks import Notes, find_bridges, mark_facing_up
from navbake.config.settings import AgentSettings
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int

ALL = np.empty(0, dtype=np.bool_)


def close_cracks(
    columns: Columns, tiled: TiledShapes, agent: AgentSettings, crack: float, asked: Bool = ALL
) -> Columns:
    """Add to columns the floors that bridge the cracks in which their lines run.

    Where surfaces that an agent could stand on are at one height (within a step) on opposite sides
    of a line, each nearer than `crack` [m], and none is there on the line, the surface of the
    lower side is the line's, too; all others of the column stay as they are. It encloses nothing.
    Of several at heights within a step, the lowest is. No other cell is looked at.

    Args:
        tiled: what the columns were cast at, listed for lines up to `crack` away.
        asked: the cells whose cracks are closed, shape (cells,), all if it is empty.
    """
    if crack == 0:
        return columns
    shapes, parts = tiled.shapes, dict[int, tuple[Notes, int]]()
    geometry = shapes.solids, tiled.facets, shapes.planes, tiled.heights
    faces_up = np.empty(len(tiled.facets.geom), dtype=np.bool_)
    limits, tiles = agent_limits(agent), tiles_of_rows(columns.lattice, columns.known_rows)

    facing = mark_facing_up, len(faces_up), tiled.facets.corners, limits.min_up, faces_up
    run_in_bands(*facing, least=4096)

    def find(first: int, end: int) -> None:
        lines = columns.lattice, columns.crossings
        near = geometry, faces_up, tiled.tiles, limits, crack, asked
        parts[first] = find_bridges(*lines, *near, first, end)

    run_in_bands(find, len(tiles), begin=tiles.start)
    found = [parts[first] for first in sorted(parts)]
    if not any(count for _, count in found):
        return columns
    of = np.concatenate([notes.of[:count] for notes, count in found])
    seen = np.concatenate([notes.seen[:count] for notes, count in found])
    return _add(columns, *_choose(of, seen, limits.step + SLACK))


def _choose(of: Int, seen: Float, step: float) -> tuple[Int, Float]:
    """Of the floors that bridge cracks of one cell, those that none lower one is a step off."""
    order = np.lexsort((of[:, 2], of[:, 1], seen[:, 4], seen[:, 3], of[:, 0]))
    of, seen, kept = of[order], seen[order], list[int]()
    for n, (cell, low) in enumerate(zip(of[:, 0].tolist(), seen[:, 3].tolist(), strict=True)):
        if not kept or of[kept[-1], 0] != cell or low - seen[kept[-1], 3] > step:
            kept.append(n)
    return of[kept], seen[kept]


def _add(columns: Columns, of: Int, seen: Float) -> Columns:
    """Columns with more surfaces, by cell and then height."""
    old, (cell, z) = columns.crossings, (of[:, 0], seen[:, 3])
    place, last = old.start[cell], old.start[cell + 1]
    heights = np.append(old.z, np.inf)
    while (below := (place < last) & (heights[place] < z)).any():
        place = place + below
    first, end = columns.known_rows.cells(columns.lattice)
    start = old.start.copy()
    start[first : end + 1] += np.searchsorted(cell, np.arange(first, end + 1))
    new = Crossings(
        start,
        np.insert(old.z, place, z),
        np.insert(old.normal, place, seen[:, :3], axis=0),
        np.insert(old.geom, place, of[:, 1]),
        np.insert(old.closed, place, OPEN_SURFACE),
    )
    return replace(columns, crossings=new)
