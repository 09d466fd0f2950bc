"""The surfaces that floors are made of, cell by cell."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.baker.columns.columns import ColumnSource, RowChunk, cast_columns, tile_shapes
from navbake.baker.core.arrays import Planes
from navbake.baker.core.blocks import Blocks, join_arrays, list_rows
from navbake.baker.core.limits import agent_limits
from navbake.baker.core.tiles import BLOCK
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.floors.surface_kernels import Surfaces, list_surfaces
from navbake.baker.geometry.shapes import Shapes
from navbake.config.settings import AgentSettings
from navbake.navgrid.lattice import Lattice
from navbake.threads import LEAST_CELLS
from navbake.types import Float, Int, Int32


def find_standable_tops(shapes: Shapes, lattice: Lattice, agent: AgentSettings) -> Float:
    """The height of the top of each cell's column, NaN where it is too steep to stand on [m]."""
    columns = cast_columns(tile_shapes(shapes, lattice, 0.0))
    has_any = np.flatnonzero(np.diff(columns.start))
    last = columns.start[has_any + 1] - 1
    is_flat = columns.normal[last, 2] >= agent_limits(agent).min_up
    top = np.full(lattice.shape, np.nan)
    top.ravel()[has_any[is_flat]] = columns.z[last[is_flat]]
    return top


def slopes_may_join(lattice: Lattice, agent: AgentSettings) -> bool:
    """Whether a slope that is standable may rise more than a step over a cell."""
    rise = lattice.cell_size * np.tan(np.radians(agent.max_slope))
    return bool(rise > agent.traversable_floor_height)


def find_surfaces(columns: ColumnSource, planes: Planes, agent: AgentSettings) -> Surfaces:
    """Find the surfaces that floors may go on at, in all columns.

    Those of a block of cells lie together, which makes kernels a third faster.

    Args:
        planes: the infinite planes of the scene.
    """
    lattice = columns.lattice
    num_axes = 3 if slopes_may_join(lattice, agent) else 0
    no_rows = (
        np.empty(0),
        np.empty(0, dtype=np.int32),
        np.empty(0, dtype=np.uint8),
        np.empty((0, num_axes), dtype=np.float32),
    )
    first = np.zeros(lattice.width * lattice.height, dtype=np.int32)
    end = np.zeros(lattice.width * lattice.height, dtype=np.int32)
    num_surfaces = 0
    parts: list[list[NDArray[Any]]] = []
    for band in columns.row_chunks():
        cells = _cells_by_block(lattice, band.valid_rows)
        counts, arrays = list_rows(
            list_surfaces,
            cells,
            no_rows,
            lattice,
            band.hits,
            planes,
            agent_limits(agent),
            least=LEAST_CELLS,
        )
        end[cells] = num_surfaces + np.cumsum(counts)
        first[cells] = end[cells] - counts
        num_surfaces += int(counts.sum())
        parts.append(arrays)
    z, geom, marks, normal = join_arrays(parts)
    return Surfaces(lattice, first, end, z, geom, marks, normal)


def _cells_by_block(lattice: Lattice, rows: RowChunk) -> Int:
    """The cells of some rows, one block after the other."""
    blocks = Blocks(lattice)
    first_block = rows.first // BLOCK * blocks.cols
    end_block = -(-rows.end // BLOCK) * blocks.cols
    cells = blocks.cells(np.arange(first_block, end_block))
    first, end = rows.cell_range(lattice)
    return cells[(first <= cells) & (cells < end)]


def find_near(first: Int | Int32, end: Int | Int32, heights: Float, z: Float, step: float) -> Float:
    """The highest of the heights of each range within a step of a height, NaN for none [m]."""
    nearest = np.full(len(z), np.nan)
    for k in range(int((end - first).max(initial=0))):
        height = heights[np.minimum(first + k, end - 1)]
        is_near = (first + k < end) & (abs(height - z) <= step + LIMIT_SLACK)
        nearest[is_near] = height[is_near]
    return nearest
