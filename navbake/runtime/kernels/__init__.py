"""Kernels: plain arrays in and out, compiled by numba and cached on disk."""

from numba import njit

from navbake.compiled import drop_stale_caches


@njit(cache=True)
def _cached() -> None:
    """Does nothing; numba says where its cached code is."""


drop_stale_caches(_cached)
