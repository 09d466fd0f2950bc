"""Drops compiled kernels whose sources have changed.

numba's cache on disk checks only the file that defines a kernel. A kernel that calls one of
another file would keep that one's old code after an edit or an upgrade. So the caches of all
modules that use a changed one are dropped, before the first kernel of a folder is loaded. So are
all caches where a named tuple has other fields: compiled code knows fields by their places.
"""

import hashlib
import json
import os
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).parent
IMPORT = re.compile(r"^from (navbake\.[\w.]*\bkernels\.\w+) import", re.MULTILINE)
TUPLE = re.compile(r"^class \w+\(NamedTuple\):\n(?:(?:    .*)?\n)*", re.MULTILINE)
FIELD = re.compile(r"^    (\w+): ", re.MULTILINE)
STAMP = "navbake-kernels.json"

# Options of a kernel that allocates no array: numba leaves its reference counts out (an option
# that numba has but does not document). Its caller keeps the arrays alive.
UNCOUNTED = {"_nrt": False}


def drop_stale_caches(cached: Callable[..., Any]) -> None:
    """Drop what was compiled from sources of a folder that have changed since.

    Any function of the folder made by ``numba.njit(cache=True)`` tells where numba keeps its code.
    """
    place = cached.stats.cache_path  # type: ignore[attr-defined]
    if place is None:
        return
    package = cached.__module__
    digests = {
        name.removeprefix(f"{package}."): digest
        for name, digest in _own_digests().items()
        if name.rpartition(".")[0] == package
    }
    stamp = Path(place) / STAMP
    try:
        known = dict(json.loads(stamp.read_text()))
    except (OSError, ValueError, TypeError):
        known = {}
    if known == digests:
        return
    for module, digest in digests.items():
        if known.get(module) != digest:
            for path in Path(place).glob(f"{module}.*.nb[ic]"):
                path.unlink(missing_ok=True)
    # Written beside and renamed. Where that fails, numba has not cached anything there either.
    beside = stamp.with_suffix(f".{os.getpid()}")
    try:
        stamp.parent.mkdir(parents=True, exist_ok=True)
        beside.write_text(json.dumps(digests))
        beside.replace(stamp)
    except OSError:
        beside.unlink(missing_ok=True)


@cache
def _own_digests() -> dict[str, str]:
    return digest_modules(PACKAGE)


def digest_modules(package: Path) -> dict[str, str]:
    """Hash each module of kernels, by its dotted name, with all that its compiled code depends on.

    That is the modules of kernels that it uses, and the fields of the package's named tuples.
    """
    sources = {path: path.read_bytes() for path in sorted(package.rglob("*.py"))}
    texts = {
        ".".join(path.relative_to(package.parent).with_suffix("").parts): text
        for path, text in sources.items()
        if path.parent.name == "kernels" and path.stem != "__init__"
    }
    has_tuples = [text.decode() for text in sources.values() if b"(NamedTuple)" in text]
    tuples = [found for text in has_tuples for found in TUPLE.findall(text)]
    fields = repr([(t.partition("(")[0], FIELD.findall(t)) for t in tuples]).encode()
    uses = {name: set(IMPORT.findall(text.decode())) for name, text in texts.items()}
    digests = {}
    for name in texts:
        # all modules that can be reached over imports, the module itself included
        found, left = {name}, [name]
        while left:
            new = uses.get(left.pop(), set()) - found
            found |= new
            left += new
        parts = b"\0".join([fields, *(texts.get(used, b"") for used in sorted(found))])
        digests[name] = hashlib.sha256(parts).hexdigest()
    return digests
