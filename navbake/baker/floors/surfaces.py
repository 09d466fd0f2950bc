"""Find the surfaces that floors may consist of, in the columns of all cells.

A column is the vertical line through a cell's centre; a surface is a place where it crosses
geometry that faces up.
"""

from __future__ import annotations

import numpy as np

from navbake.baker.columns.columns import ColumnSource, cast_columns, tile_shapes
from navbake.baker.core.arrays import Planes
from navbake.baker.core.blocks import Blocks, RowsBuilder, list_rows_in_pieces
from navbake.baker.core.limits import make_agent_limits
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors.surface_kernels import Surfaces, list_surfaces
from navbake.baker.geometry.shapes import Shapes
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import LEAST_CELLS
from navbake.types import Float, Int, Int32


def find_standable_tops(shapes: Shapes, lattice: Lattice, agent: AgentSettings) -> Float:
    """Find the height of the uppermost surface over each cell's centre, if it is not too steep.

    Args:
        shapes: the geometry whose upper side is measured.
        lattice: the cells.
        agent: the agent, of which the slope is used.

    Returns:
        Heights, shape (height, width), float64 [m]; NaN where there is no surface, or the uppermost
        one is steeper than `agent.max_slope`.
    """
    columns = cast_columns(tile_shapes(shapes, lattice, 0.0))
    hit_cells = np.flatnonzero(np.diff(columns.start))
    uppermost_hits = columns.start[hit_cells + 1] - 1
    is_gentle = columns.normal[uppermost_hits, 2] >= make_agent_limits(agent).min_normal_z
    top_height = np.full(lattice.shape, np.nan)
    top_height.ravel()[hit_cells[is_gentle]] = columns.z[uppermost_hits[is_gentle]]
    return top_height


def may_slopes_join(lattice: Lattice, agent: AgentSettings) -> bool:
    """Return whether the steepest slope that an agent can climb rises by more than a step per cell.

    Only then can a slope join surfaces of neighboring cells that no step joins.

    Args:
        lattice: the lattice of the cells.
        agent: the agent, of which the slope and step are used.
    """
    rise_per_cell = lattice.cell_size * np.tan(np.radians(agent.max_slope))
    return bool(rise_per_cell > agent.traversable_floor_height)


def find_surfaces(columns: ColumnSource, planes: Planes, agent: AgentSettings) -> Surfaces:
    """Find the surfaces that floors may consist of: where the columns cross geometry that faces up.

    The surfaces of one block of cells follow each other, which makes kernels a third faster.

    Args:
        columns: the hits of all columns.
        planes: the infinite planes of the scene.
        agent: the agent, of which the slope, step and height are used.
    """
    lattice = columns.lattice
    # normals are stored only where slopes may join surfaces
    num_axes = 3 if may_slopes_join(lattice, agent) else 0
    no_rows = (
        np.empty(0),
        np.empty(0, dtype=np.int32),
        np.empty(0, dtype=np.uint8),
        np.empty((0, num_axes), dtype=np.float32),
    )
    blocks = Blocks(lattice)
    first_surface = np.empty(lattice.shape, dtype=np.int32)
    end_surface = np.empty(lattice.shape, dtype=np.int32)
    surfaces_builder = RowsBuilder(no_rows)
    for chunk in columns.row_chunks():
        first_row, end_row = chunk.valid_rows
        cells = blocks.list_cells(first_row, end_row)
        num_surfaces_in_cell, pieces = list_rows_in_pieces(
            list_surfaces,
            cells,
            no_rows,
            lattice,
            chunk.hits,
            planes,
            make_agent_limits(agent),
            least=LEAST_CELLS,
        )
        # surfaces of this chunk come after those of earlier chunks
        start = np.zeros(len(cells) + 1, dtype=np.int32)
        np.cumsum(num_surfaces_in_cell, out=start[1:])
        start += np.int32(surfaces_builder.num_rows)
        blocks.order_by_cell(start[:-1], first_row, first_surface[first_row:end_row])
        blocks.order_by_cell(start[1:], first_row, end_surface[first_row:end_row])
        surfaces_builder.append(pieces, end_row / lattice.height)
    z, geom, flags, normal = surfaces_builder.build()
    return Surfaces(lattice, first_surface.ravel(), end_surface.ravel(), z, geom, flags, normal)


def find_highest_within_step(
    first_surface: Int | Int32, end_surface: Int | Int32, heights: Float, z: Float, max_step: float
) -> Float:
    """Find in each cell the highest surface that differs from a height by at most a step.

    Args:
        first_surface: the index of each cell's first surface in `heights`, shape (n,).
        end_surface: the index past each cell's last surface, shape (n,).
        heights: the heights of all surfaces, ascending in each cell [m].
        z: for each cell, the height to compare with, shape (n,) [m].
        max_step: the highest step [m].

    Returns:
        Heights, shape (n,) [m]; NaN for a cell without such a surface.
    """
    highest_z = np.full(len(z), np.nan)
    if not len(heights):
        return highest_z
    # bisect in all cells at once: the first surface that is more than a step higher
    begin = first_surface.astype(np.int64)
    end = end_surface.astype(np.int64)
    for _ in range(int((end - begin).max(initial=0)).bit_length()):
        middle = (begin + end) // 2
        height = heights[np.minimum(middle, len(heights) - 1)]
        is_above = height - z > max_step + LIMIT_SLACK
        end = np.where((begin < end) & is_above, middle, end)
        begin = np.where((begin < end) & ~is_above, middle + 1, begin)
    height = heights[begin - 1]
    is_near = (begin > first_surface) & (abs(height - z) <= max_step + LIMIT_SLACK)
    highest_z[is_near] = height[is_near]
    return highest_z
