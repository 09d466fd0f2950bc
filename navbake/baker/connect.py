"""What hangs together: nodes over pairs, and cells over edges and corners.

scipy has such functions, but takes longer to load than the apartment to bake.
"""

import numpy as np

from navbake.navgrid.kernels.connect import list_touching, number_parts
from navbake.types import Int, Int32


def connect(pairs: Int, count: int) -> Int32:
    """The connected part of each of so many nodes, from 0 by their first nodes.

    Args:
        pairs: the nodes that hang together, shape (2, n).
        count: how many nodes there are.
    """
    part: Int32 = number_parts(np.ascontiguousarray(pairs, dtype=np.int64), count)
    return part


def touching(cells: Int, width: int) -> Int:
    """The pairs of cells that meet at an edge or a corner, as places in `cells`, shape (2, n).

    Args:
        cells: ascending cell ids, shape (m,).
        width: of the lattice.
    """
    pairs: Int = list_touching(np.ascontiguousarray(cells, dtype=np.int64), width)
    return pairs
