"""Kernels: arrays and tuples of them in and out, compiled by numba and cached on disk.

A helper with ``inline="always"`` becomes part of its caller's code before types are inferred. As a
function of its own it would be optimized once more in each kernel that reaches it, and its tuples
of arrays would be passed for each cell. So what many call is a function, and what the body of a
parallel loop calls (see `arrays`); other helpers are inlined.
"""

from numba import njit

from navbake.compiled import drop_stale_caches


@njit(cache=True)
def _cached() -> None:
    """Tells where numba keeps the kernels of this folder."""


drop_stale_caches(_cached)
