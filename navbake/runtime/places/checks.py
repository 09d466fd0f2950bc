"""Refuses what is no distance and no source of random numbers."""

from __future__ import annotations

import numpy as np

from navbake.errors import QueryError

REAL = int | float | np.integer | np.floating


def check_generator(rng: object) -> np.random.Generator:
    """Refuse, with a QueryError, what draws no numbers of its own, such as a seed."""
    if isinstance(rng, np.random.Generator):
        return rng
    raise QueryError(
        f"expected a numpy.random.Generator, got {rng!r}: make one with numpy.random.default_rng"
    )


def check_distance(distance: float, name: str = "max_distance") -> None:
    """Refuse, with a QueryError, what is no number, negative, or NaN."""
    if not (isinstance(distance, REAL) and distance >= 0):
        raise QueryError(f"expected a {name} >= 0 m, got {distance!r}")


def check_distances(min_distance: float, max_distance: float) -> None:
    """Refuse, with a QueryError, what are no numbers, negative, not in order, or NaN."""
    numbers = isinstance(min_distance, REAL) and isinstance(max_distance, REAL)
    if not (numbers and 0 <= min_distance <= max_distance):
        raise QueryError(
            f"expected 0 <= min_distance <= max_distance [m], got {min_distance} and {max_distance}"
        )
