"""Keeps compiled kernels from outliving their sources.

numba's cache on disk looks at the file that a kernel stands in alone. A kernel that calls one of
another file would keep that one's old code, after an edit and, as the cache stays when a package
is replaced, after an upgrade. So the caches of all modules that use a changed one are dropped.
Each package of kernels calls `drop_stale_caches` before its first kernel is loaded.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).parent
IMPORT = re.compile(r"^from (navbake\.[\w.]*\bkernels\.\w+) import", re.MULTILINE)
STAMP = "navbake-kernels.json"


def drop_stale_caches(cached: Callable[..., Any]) -> None:
    """Drop what was compiled from other sources than there are now.

    Args:
        cached: a function of the kernels' folder, made by ``numba.njit(cache=True)``; it tells
            where numba keeps what is compiled there.
    """
    place = cached.stats.cache_path  # type: ignore[attr-defined]
    if place is None:
        return
    package = cached.__module__
    digests = {
        name.removeprefix(f"{package}."): digest
        for name, digest in digest_modules(PACKAGE).items()
        if name.rpartition(".")[0] == package
    }
    stamp = Path(place) / STAMP
    known = _read(stamp)
    if known == digests:
        return
    for module, digest in digests.items():
        if known.get(module) != digest:
            for path in Path(place).glob(f"{module}.*.nb[ic]"):
                path.unlink(missing_ok=True)
    _write(stamp, digests)


def digest_modules(package: Path) -> dict[str, str]:
    """Hash each module of kernels together with all others that it uses, directly or not.

    Args:
        package: navbake's folder; kernels are in its folders of that name.

    Returns:
        By the modules' dotted names.
    """
    sources = {
        ".".join((package.name, *path.relative_to(package).with_suffix("").parts)): path
        for path in sorted(package.rglob("kernels/*.py"))
        if path.stem != "__init__"
    }
    texts = {name: path.read_bytes() for name, path in sources.items()}
    uses = {name: set(IMPORT.findall(text.decode())) for name, text in texts.items()}
    digests = {}
    for name in texts:
        found, left = {name}, [name]
        while left:
            new = uses.get(left.pop(), set()) - found
            found |= new
            left += new
        parts = b"\0".join(texts.get(used, b"") for used in sorted(found))
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
