"""Kernels: plain arrays in and out, compiled by numba and cached on disk."""

from navbake.kernels.freshness import drop_stale_caches

drop_stale_caches()
