"""Checks distances and sources of random numbers; raises QueryError."""

import numpy as np

from navbake.errors import QueryError

REAL = int | float | np.integer | np.floating


def as_generator(rng: object) -> np.random.Generator:
    """The generator given, or a new one for None; raises for anything else, such as a seed."""
    if rng is None:
        return np.random.default_rng()
    if isinstance(rng, np.random.Generator):
        return rng
    raise QueryError(
        f"expected a numpy.random.Generator, or None, got {rng!r}: make one with "
        "numpy.random.default_rng"
    )


def check_distance(distance: float, name: str = "max_distance") -> None:
    """Raise for anything but a number >= 0."""
    if not (isinstance(distance, REAL) and distance >= 0):
        raise QueryError(f"expected a {name} >= 0 m, got {distance!r}")


def check_distances(min_distance: float, max_distance: float) -> None:
    """Raise for anything but two numbers >= 0 in order."""
    numbers = isinstance(min_distance, REAL) and isinstance(max_distance, REAL)
    if not (numbers and 0 <= min_distance <= max_distance):
        raise QueryError(
            f"expected 0 <= min_distance <= max_distance [m], got {min_distance} and {max_distance}"
        )
