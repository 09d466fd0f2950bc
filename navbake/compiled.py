"""Drops compiled kernels whose sources have changed.

numba's cache on disk checks only the file that defines a kernel. A kernel that calls one of
another file would keep that one's old code after an edit or an upgrade. So the caches of all
modules that use a changed one are dropped, before the first kernel of a folder is loaded. So are
all caches where a named tuple has other fields: compiled code knows fields by their places.
"""

import json
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from navbake.digests import STAMP, digest_folder, read_stamp
from navbake.dispatch import install
from navbake.folder_lock import folder_lock

# each folder of kernels imports this module before its first kernel is made
install()

# Options of a kernel that allocates no array: numba leaves its reference counts out (an option
# that numba has but does not document). Its caller keeps the arrays alive.
UNCOUNTED: Any = {"_nrt": False}


def drop_stale_caches(cached: Callable[..., Any]) -> None:
    """Drop what was compiled from sources of a folder that have changed since.

    Any function of the folder made by ``numba.njit(cache=True)`` tells where numba keeps its code.
    """
    stats = getattr(cached, "stats", None)  # None under NUMBA_DISABLE_JIT
    if stats is None or stats.cache_path is None:
        return
    place = Path(stats.cache_path)
    digests = digest_folder(cached.__module__)
    if read_stamp(place) == digests:
        return
    # A folder that can't be written has nothing to drop: it is chosen only where it is fresh.
    with suppress(OSError):
        place.mkdir(parents=True, exist_ok=True)
        with folder_lock(place).hold(""):
            _drop(place, digests)


def _drop(place: Path, digests: dict[str, str]) -> None:
    known = read_stamp(place)  # another process may have been faster
    for module, digest in digests.items():
        if known.get(module) != digest:
            for path in place.glob(f"{module}.*.nb[ic]"):
                path.unlink(missing_ok=True)
    if known == digests:
        return
    # written beside and renamed
    beside = place / f"{STAMP}.{os.getpid()}"
    try:
        beside.write_text(json.dumps(digests))
        beside.replace(place / STAMP)
    except OSError:
        beside.unlink(missing_ok=True)
