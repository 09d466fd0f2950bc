"""Which edges of a region are at the rims of holes, next to pairs of cells on a lattice."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from navbake.baker.core.components import label_components, list_adjacent_pairs
from navbake.baker.floors.outline import find_hole_edges, find_neighbor_cells
from navbake.baker.floors.region_kernels import RegionEdges
from navbake.navgrid.lattice import Lattice

MASKS = arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=9))


def edges_of(mask: np.ndarray, number: int) -> tuple[Lattice, list[np.ndarray]]:
    """The edges of a region with the cells of a mask: its number, their cells and directions."""
    lattice = Lattice(0.0, float(mask.shape[0]), 1.0, mask.shape[1], mask.shape[0])
    cell, direction = (part.ravel() for part in np.meshgrid(np.flatnonzero(mask), np.arange(4)))
    neighbor = find_neighbor_cells(lattice, cell, direction)
    ends = (neighbor < 0) | ~mask.ravel()[neighbor]
    return lattice, [np.full(ends.sum(), number, dtype=np.int32), cell[ends], direction[ends]]


def slow_holes(mask: np.ndarray, cell: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The same by all pairs of cells beyond the edges, on a lattice with a margin."""
    inside = np.pad(mask, 2).ravel()
    width = mask.shape[1] + 4
    row, col = np.divmod(cell, mask.shape[1])
    outer = (row + 2) * width + col + 2 + np.array([1, width, -1, -width])[direction]
    cells, where = np.unique(outer, return_inverse=True)
    first, second = pairs = list_adjacent_pairs(cells, width)
    low = cells[first]
    high = cells[second]
    at_corner = ~np.isin(high - low, (1, width))
    pinched = at_corner & inside[high - width] & inside[low + width]
    return label_components(pairs[:, ~pinched], len(cells))[where] > 0


@given(mask=MASKS, twice=st.booleans())
def test_edges_of_holes_are_those_that_no_cells_beyond_join_to_the_first(mask, twice) -> None:
    lattice, (number, cell, direction) = edges_of(mask, 3)
    if twice:  # two regions
        number = np.append(number, number + 2)
        cell = np.tile(cell, 2)
        direction = np.tile(direction, 2)
    order = np.random.default_rng(0).permutation(len(cell))
    nothing = np.empty(0)
    edges = RegionEdges(
        number[order], cell[order], nothing, direction[order], nothing, nothing, nothing
    )
    expected = slow_holes(mask, cell[order], direction[order])
    np.testing.assert_array_equal(find_hole_edges(edges, lattice), expected)
