"""The tree of a model's bodies."""

from __future__ import annotations

from typing import Any

import numpy as np

from navbake.types import Int


def find_subtree_ends(model: Any) -> Int:
    """Find where the bodies that hang on each body end.

    Bodies are numbered depth first, so a body and all that hangs on it, directly or not, have
    the ids from its own to the one before its end.

    Returns:
        By body id, shape (nbody,), int64.
    """
    end = list(range(1, model.nbody + 1))
    parent = model.body_parentid.tolist()
    for body in range(model.nbody - 1, 0, -1):  # children come after their parents
        end[parent[body]] = max(end[parent[body]], end[body])
    return np.array(end, dtype=np.int64)


def geoms_of_bodies(model: Any, first: int, end: int) -> Int:
    """The ids of the geoms of the bodies from `first` to before `end`, ascending.

    Geoms are numbered by their bodies.
    """
    low, high = np.searchsorted(model.geom_bodyid, [first, end])
    return np.arange(low, high, dtype=np.int64)
