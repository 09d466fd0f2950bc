"""The outlines of labelled cells, exactly along the cells' edges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navbake.navgrid.lattice import Lattice
from navbake.types import Float, Int, Int32

# Functions import kernels when they run: numba takes long to load.

DECIMALS = 9  # of coordinates: a nanometre
SMALLEST = 1e-6  # cells with an edge below this keep all digits [m]


@dataclass(frozen=True, eq=False)
class Outlines:
    """Rings round the connected parts of labelled cells.

    A part is cells of one label that share edges; cells that only touch at a corner are two parts.
    No ring has a corner twice, and rings of one label meet at single corners at most. So each part
    is a valid polygon, and all parts of a label a valid multipolygon (OGC simple features),
    whatever the cells are.

    Attributes:
        corners: of all rings, row and column of corners of cells, shape (n, 2), int32; (0, 0) is
            the upper left corner of the first cell. Outer rings run anticlockwise in the world,
            holes clockwise (RFC 7946). The first corner is not repeated.
        ring_start: where each ring starts among the corners, and n; shape (num_rings + 1,).
        part_start: where each part starts among the rings, and their number; its first ring is the
            outer one, the others are holes.
        label: of each part, int32.
    """

    corners: Int32
    ring_start: Int
    part_start: Int
    label: Int32


def place_corners(corners: NDArray[np.integer], lattice: Lattice) -> Float:
    """World x, y of corners of cells [m], shape (..., 2), to a nanometre where cells are larger."""
    x = lattice.x_min + corners[..., 1] * lattice.cell_size
    y = lattice.y_max - corners[..., 0] * lattice.cell_size
    points = np.stack([x, y], axis=-1)
    if lattice.cell_size > SMALLEST:
        points = np.round(points, DECIMALS)
    placed: Float = points + 0.0  # no -0.0
    return placed


def trace_outlines(labels: NDArray[np.integer]) -> Outlines:
    """Trace the outlines of all labels of a level.

    Args:
        labels: of the cells, shape (height, width), 0 for none.

    Returns:
        The parts by label, then by their first cells in reading order.
    """
    from navbake.formats.kernels.outlines import count_sides, number_regions, trace_rings

    own = np.ascontiguousarray(labels, dtype=np.int32)
    parts = np.pad(number_regions(own), 1)
    corners, start, part = trace_rings(parts, count_sides(parts))
    # rings by label and part, the outer one first
    flat = parts[1:-1, 1:-1].ravel()
    label = np.zeros(int(flat.max(initial=0)) + 1, dtype=np.int32)
    label[flat] = own.ravel()
    is_hole = _doubled_areas(corners, start) < 0
    order = np.lexsort((np.arange(len(part)), is_hole, part, label[part]))
    gathered, ring_start = _gather(corners, start, order)
    first = np.unique(_ranks(part[order]), return_index=True)[1]
    part_start = np.append(first, len(order)).astype(np.int64)
    return Outlines(gathered, ring_start, part_start, label[part[order][first]])


def _ranks(values: Int32) -> Int:
    """The number of each run of equal values."""
    return np.cumsum(np.diff(values, prepend=values[:1]) != 0)


def _doubled_areas(corners: Int32, start: Int) -> Int:
    """Twice the areas of rings in cells, > 0 where they run anticlockwise in the world."""
    row, col = corners.astype(np.int64).T
    after = np.arange(1, len(corners) + 1)
    after[start[1:] - 1] = start[:-1]  # of a ring's last corner, its first one
    # rows run against y
    cross = row * col[after] - col * row[after]
    return np.add.reduceat(cross, start[:-1]) if len(start) > 1 else np.zeros(0, dtype=np.int64)


def _gather(corners: Int32, start: Int, order: Int) -> tuple[Int32, Int]:
    """Rings in another order: their corners, and where each starts."""
    count = np.diff(start)[order]
    new_start = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    source = np.arange(len(corners)) + np.repeat(start[order] - new_start[:-1], count)
    return corners[source], new_start
