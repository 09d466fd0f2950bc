"""Parts of kernels as functions that Python can call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from navbake.compiled import kernel


def callable_part(subkernel: Any) -> Callable[..., Any]:
    """A part of a kernel as a function of its own, whose code is stored as that of kernels is.

    Args:
        subkernel: what `navbake.compiled.subkernel` returned.
    """
    return kernel(subkernel.py_func)
