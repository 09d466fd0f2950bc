"""A named piece of a mesh file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class MeshPart:
    """One named piece of a mesh file.

    Attributes:
        name: as the file has it; unique only once `read_mesh_parts` has seen it.
        vertices: shape (n, 3), float64: the file's own frame and unit from a reader, the world's
            [m] from `read_mesh_parts`.
        faces: shape (m, 3), int64, indices into `vertices`, counter-clockwise from outside.
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
