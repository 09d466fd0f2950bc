"""Grids as arrays of numpy, PyTorch, JAX and others: batched questions, on any device.

``t = grid.tensors(torch, device="cuda")`` makes the arrays; the functions here answer questions
about many positions at once. They are pure: no random state, no loops over data, no branches on
values. So they run inside ``jax.jit``, ``jax.vmap``, ``torch.vmap`` and ``torch.compile``.
navbake imports no framework here: it uses the one that the caller hands over, by the Python array
API (https://data-apis.org/array-api/).
"""

from navbake.tensors.build import make_tensors
from navbake.tensors.grid_tensors import GridTensors
from navbake.tensors.questions import (
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
    room,
    sample,
)

__all__ = [
    "GridTensors",
    "clearance",
    "distance_to_goal",
    "distances",
    "floor",
    "heights",
    "is_navigable",
    "island",
    "level_at",
    "make_tensors",
    "patch",
    "path_step",
    "room",
    "sample",
]
