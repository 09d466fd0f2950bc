"""What compiled kernels were compiled from: the digests of their sources."""

import hashlib
import json
import re
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parent
IMPORT = re.compile(r"^from (navbake\.[\w.]*\bkernels\.\w+) import", re.MULTILINE)
TUPLE = re.compile(r"^class \w+\(NamedTuple\):\n(?:(?:    .*)?\n)*", re.MULTILINE)
FIELD = re.compile(r"^    (\w+): ", re.MULTILINE)
STAMP = "navbake-kernels.json"
ABOVE = ("batch", "cli")  # what calls no kernels: no tuple of theirs gets into one


def digest_folder(package: str) -> dict[str, str]:
    """Hash each module of a folder of kernels, by its name within the folder."""
    return {
        name.removeprefix(f"{package}."): digest
        for name, digest in _own_digests().items()
        if name.rpartition(".")[0] == package
    }


def read_stamp(place: str | Path) -> dict[str, str]:
    """Read of which sources the compiled kernels in a folder are; empty where nothing says so."""
    try:
        return dict(json.loads((Path(place) / STAMP).read_text()))
    except (OSError, ValueError, TypeError):
        return {}


@cache
def _own_digests() -> dict[str, str]:
    return digest_modules(PACKAGE)


def digest_modules(package: Path) -> dict[str, str]:
    """Hash each module of kernels, by its dotted name, with all that its compiled code depends on.

    That is the modules of kernels that it uses, and the fields of the package's named tuples, but
    for those `ABOVE` what kernels are given.
    """
    sources = {
        path: path.read_bytes()
        for path in sorted(package.rglob("*.py"))
        if path.relative_to(package).parts[0] not in ABOVE
    }
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
