"""Warns, before a bake begins, that it needs more memory than the machine has free."""

from __future__ import annotations

import logging

from navbake.baker.columns.column_sources import expands_on_request
from navbake.baker.geometry.shapes import Shapes
from navbake.navgrid.lattice import Lattice
from navbake.processes import measure_free_memory

LOG = logging.getLogger(__name__)
# Measured on bakes of 16 million cells, of 2 million triangles in many meshes (those in one mesh
# take half as much), and of 32 million triangles that are expanded chunk by chunk; a bake of many
# levels takes more [bytes]
BYTES_PER_CELL = 130
BYTES_PER_TRIANGLE = 130
BYTES_PER_TRIANGLE_ON_REQUEST = 45
GB = 1e9  # [bytes]


def estimate_memory(structure: Shapes, lattice: Lattice, margin: float) -> int:
    """Estimate how much more memory a bake needs than is in use when it begins [bytes].

    Args:
        structure: the geometry that floors are found on.
        lattice: the cells of the whole scene.
        margin: shapes within this distance of a tile of cells are listed for it [m].
    """
    num_triangles = int(structure.meshes.num_triangles.sum())
    bytes_per_triangle = BYTES_PER_TRIANGLE
    if expands_on_request(structure, lattice, margin):
        bytes_per_triangle = BYTES_PER_TRIANGLE_ON_REQUEST
    return BYTES_PER_CELL * lattice.width * lattice.height + bytes_per_triangle * num_triangles


def warn_of_memory(structure: Shapes, lattice: Lattice, margin: float) -> None:
    """Log a warning if a bake needs more memory than the machine has free.

    The warning isn't stored in the grid: on another machine, the same bake has enough memory.

    Args:
        structure: the geometry that floors are found on.
        lattice: the cells of the whole scene.
        margin: shapes within this distance of a tile of cells are listed for it [m].
    """
    needed_bytes = estimate_memory(structure, lattice, margin)
    free_bytes = measure_free_memory()
    if needed_bytes <= free_bytes:
        return
    num_cells = lattice.width * lattice.height
    num_triangles = int(structure.meshes.num_triangles.sum())
    LOG.warning(
        f"this bake needs about {needed_bytes / GB:.1f} GB of memory, "
        f"and {free_bytes / GB:.1f} GB are free: "
        f"{num_cells} cells and {num_triangles} triangles: raise `grid.cell_size`, bake a part "
        f"(`grid.bounds`), or leave geoms out (`scene.exclude`)"
    )
