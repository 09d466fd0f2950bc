"""How many threads the kernels run on."""

from collections.abc import Iterator
from contextlib import contextmanager

import numba
import numpy as np

from navbake.errors import ConfigError


@contextmanager
def limit_threads(count: int | None) -> Iterator[None]:
    """Run what is inside on at most `count` threads, or a ConfigError; None changes nothing."""
    before = numba.get_num_threads()
    if count is not None:
        is_whole = isinstance(count, int | np.integer) and not isinstance(count, bool)
        if not is_whole or count < 1:
            raise ConfigError(f"expected a number of threads >= 1, got {count!r}")
        most = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
        numba.set_num_threads(min(int(count), most))
    try:
        yield
    finally:
        numba.set_num_threads(before)
