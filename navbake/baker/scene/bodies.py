"""The tree of a model's bodies."""

from typing import Any

import numpy as np

from navbake.baker.kernels.constants import FREE
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


def find_free_bodies(model: Any) -> Int:
    """Find the body with a free joint that each geom hangs on, shape (ngeom,); -1 for none.

    MuJoCo gives free joints to children of the world alone, so there is at most one.
    """
    root = np.full(model.nbody, -1, dtype=np.int64)
    end = find_subtree_ends(model)
    for body in model.jnt_bodyid[model.jnt_type == FREE].tolist():
        root[body : end[body]] = body
    free: Int = root[model.geom_bodyid]
    return free
