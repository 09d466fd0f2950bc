"""Floors that are lost inside of closed meshes: storeys that someone drew as closed boxes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from navbake.baker.columns import Columns, cells_of
from navbake.baker.floors.kernels.enclosed import count_ends, find_holders
from navbake.baker.floors.kernels.sheets import group_members, join_by_steps
from navbake.baker.floors.patch import Patch
from navbake.baker.floors.sheets import AreaTest, agent_limits, middle_of
from navbake.baker.kernels.constants import CLOSED_SURFACE
from navbake.baker.scene.shapes import Shapes
from navbake.config.settings import AgentSettings, FloorSettings
from navbake.threads import run_in_bands
from navbake.types import Bool, Float, Int

# A floor that goes on beyond this share of its outline is what a closed thing stands on
GOES_ON = 0.25
# Unless the thing is so large that it may well be a building [m2]
BUILDING = 50.0


def find_enclosed(
    columns: Columns,
    shapes: Shapes,
    floor_like: Bool,
    agent: AgentSettings,
    settings: FloorSettings,
) -> list[Patch]:
    """Find floors that closed meshes hold, so that nobody can stand on them.

    They face up within the slope, have headroom, and are large enough to be floors. Where such
    a floor goes on outside at its height, a closed thing only stands on it, like a crate, unless
    it is as large as a building.

    Args:
        floor_like: which surfaces face up within the slope, shape (n,).

    Returns:
        The floors, the largest first; the geom of each is the mesh that holds it.
    """
    lattice, step = columns.lattice, agent.traversable_floor_height
    at_cell, found = np.zeros(len(columns.start) - 1, dtype=np.bool_), []
    for geom, cells, z in list_enclosed(columns, shapes, agent, settings):
        area = len(cells) * lattice.cell_size**2
        surfaces = cells, z, columns.crossings, floor_like
        edges, goes_on = count_ends(lattice, *surfaces, step, at_cell)
        if area >= BUILDING or goes_on < GOES_ON * edges:
            found.append(Patch(geom, area, middle_of(lattice, cells, z), cells))
    return sorted(found, key=lambda floor: -floor.area)


def list_enclosed(
    columns: Columns, shapes: Shapes, agent: AgentSettings, settings: FloorSettings
) -> Iterator[tuple[int, Int, Float]]:
    """List what is large enough for a floor inside of closed meshes: mesh, cells, heights [m]."""
    if not (columns.crossings.closed == CLOSED_SURFACE).any():
        return
    lattice, limits = columns.lattice, agent_limits(agent)
    holder = np.empty(len(columns.z), dtype=np.int32)
    num = len(columns.start) - 1
    run_in_bands(find_holders, num, lattice, columns.crossings, shapes.planes, limits, holder)
    start = np.concatenate([[0], np.cumsum(holder >= 0)])[columns.start]
    surface = np.flatnonzero(holder >= 0)
    z, geom = columns.z[surface], holder[surface].astype(np.int64)
    part, size = join_by_steps(lattice, start, z, geom, limits.step)
    cell = cells_of(start)
    first, member = group_members(part, size)
    test = AreaTest(lattice, settings)
    for number in np.flatnonzero(size >= test.needed).tolist():
        members = member[first[number] : first[number + 1]]
        if test.passes(cell[members]):
            yield int(geom[members[0]]), cell[members], z[members]
