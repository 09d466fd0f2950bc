"""How often Python looks for garbage in processes that load and compile much."""

import gc

# How many objects are made, net, before Python looks for garbage. Imports, loaded kernels and a
# compiler make some 100 thousand, most of which stay: by default it looks through them again and
# again.
BETWEEN_COLLECTIONS = 200_000


def collect_seldom() -> None:
    """Let this process look for garbage less often than by default."""
    gc.set_threshold(BETWEEN_COLLECTIONS, *gc.get_threshold()[1:])
