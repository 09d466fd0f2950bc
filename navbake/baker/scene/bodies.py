"""The tree of a model's bodies."""

from typing import Any

import numpy as np

from navbake.types import Int


def find_subtree_ends(model: Any) -> Int:
    """Find the end of each body's subtree in the list of bodies, shape (nbody,), int64.

    Bodies are numbered depth first, so a body and all that hangs on it, directly or not, have
    the ids from its own to the one before its end.
    """
    end = list(range(1, model.nbody + 1))
    parent = model.body_parentid.tolist()
    for body in range(model.nbody - 1, 0, -1):  # children come after their parents
        end[parent[body]] = max(end[parent[body]], end[body])
    return np.array(end, dtype=np.int64)


def geoms_of_bodies(model: Any, first: int, end: int) -> Int:
    """Ids of the geoms of the bodies from `first` to before `end`, ascending as the bodies are."""
    low, high = np.searchsorted(model.geom_bodyid, [first, end])
    return np.arange(low, high, dtype=np.int64)
