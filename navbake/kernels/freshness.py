"""Keeps compiled kernels from outliving their sources.

numba's cache on disk looks at the file that a kernel stands in alone. A kernel that calls one of
another file would keep that one's old code, after an edit and, as the cache stays when a package
is replaced, after an upgrade. So the caches of all modules that use a changed one are dropped.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from pathlib import Path

from numba import njit

IMPORT = re.compile(r"^from navbake\.kernels\.(\w+) import", re.MULTILINE)
STAMP = "navbake-kernels.json"


@njit(cache=True)
def _nothing() -> None:
    """Tells where numba keeps the kernels of this folder."""


def drop_stale_caches() -> None:
    """Drop what was compiled from other sources than there are now."""
    folder = _nothing.stats.cache_path
    if folder is None:
        return
    digests = digest_modules(Path(__file__).parent)
    stamp = Path(folder) / STAMP
    known = _read(stamp)
    if known == digests:
        return
    for module, digest in digests.items():
        if known.get(module) != digest:
            for path in Path(folder).glob(f"{module}.*.nb[ic]"):
                path.unlink(missing_ok=True)
    _write(stamp, digests)


def digest_modules(folder: Path) -> dict[str, str]:
    """Hash each module together with all modules that it uses, directly or not."""
    sources = {path.stem: path.read_bytes() for path in sorted(folder.glob("*.py"))}
    uses = {name: set(IMPORT.findall(text.decode())) for name, text in sources.items()}
    digests = {}
    for name in sources:
        found, left = {name}, [name]
        while left:
            new = uses.get(left.pop(), set()) - found
            found |= new
            left += new
        parts = b"\0".join(sources.get(used, b"") for used in sorted(found))
        digests[name] = hashlib.sha256(parts).hexdigest()
    return digests


def _read(stamp: Path) -> dict[str, str]:
    try:
        known = json.loads(stamp.read_text())
    except (OSError, ValueError):
        return {}
    return known if isinstance(known, dict) else {}


def _write(stamp: Path, digests: dict[str, str]) -> None:
    """Write beside and rename; a folder that can't be written to holds no caches of ours."""
    beside = stamp.with_suffix(f".{os.getpid()}")
    try:
        stamp.parent.mkdir(parents=True, exist_ok=True)
        beside.write_text(json.dumps(digests))
        beside.replace(stamp)
    except OSError:
        beside.unlink(missing_ok=True)
