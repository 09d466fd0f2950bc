"""The random generators that callers hand over."""

import numpy as np
from numpy.random import Generator

from navbake.errors import QueryError


def as_generator(rng: object) -> Generator:
    """Return a random generator: `rng` itself, or a new one if it is None.

    Raises:
        QueryError: `rng` is neither a numpy Generator nor None.
    """
    if rng is None:
        return np.random.default_rng()
    if not isinstance(rng, Generator):
        expected = "a numpy.random.Generator, or None"
        hint = "make one with numpy.random.default_rng"
        raise QueryError(
            f"expected {expected}, got {rng!r}: {hint}",
            key="rng",
            value=rng,
            expected=expected,
            hint=hint,
        )
    return rng
