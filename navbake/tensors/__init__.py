"""Grids as arrays of numpy, PyTorch, JAX and others: batched queries on any device.

``t = grid.tensors(torch, device="cuda")`` makes the arrays; the functions here take many positions
at once. They are pure, without random state, loops over data or branches on values, and so run
inside ``jax.jit``, ``jax.vmap``, ``torch.vmap`` and ``torch.compile``. navbake imports no framework
here: it uses the caller's by the Python array API (https://data-apis.org/array-api/).
"""

from navbake.tensors.build import make_tensors, with_goals, with_stands
from navbake.tensors.grid_tensors import GridTensors
from navbake.tensors.questions import (
    area,
    can_reach,
    clearance,
    distance_to_goal,
    distances,
    floor,
    heights,
    is_navigable,
    island,
    level_at,
    patch,
    path_step,
    ranges,
    room,
    sample,
    sample_stand,
)

__all__ = [
    "GridTensors", "area", "can_reach", "clearance", "distance_to_goal", "distances", "floor",
    "heights", "is_navigable", "island", "level_at", "make_tensors", "patch", "path_step",
    "ranges", "room", "sample", "sample_stand", "with_goals", "with_stands",
]  # fmt: skip
