"""The command `navbake doctor`: what an issue about an installation needs to know."""

import os
import platform
import re
import sys
import time
from collections.abc import Iterator
from ctypes.util import find_library
from importlib.metadata import PackageNotFoundError, requires, version
from itertools import chain
from pathlib import Path

from navbake import samples
from navbake._version import __version__
from navbake.cli.options import flag
from navbake.errors import NavbakeError
from navbake.lazy import lazy

compiled = lazy("navbake.compiled")  # numba loads slowly
config = lazy("navbake.config.settings")
pipeline = lazy("navbake.baker.pipeline")
threads = lazy("navbake.threads")

SAMPLE = "apartment"
USUAL = 0.5  # [s] a warm bake of the sample takes 0.05 to 0.2 s on a desktop's cores
REQUIREMENT = re.compile(r"""([\w.-]+)[^;]*(?:;.*?extra == ["'](?P<extra>[\w-]+)["'])?""")


def doctor(no_bake: bool = flag("--no-bake", "Leave out the bake.")) -> None:
    """Print what is installed and whether it works, to paste into an issue.

    Versions, the folder of compiled code, cores, OpenGL, extras with the command that installs
    each, and the time of a sample's bake. The first bake on a machine compiles for half a minute.
    The exit status is 1 if the bake fails.

    Example: navbake doctor
    """
    parts = (_describe_versions(), _describe_machine(), _describe_cache(), _describe_extras())
    for name, text in chain.from_iterable(parts):
        print(f"{name:<12} {text}")
    if not no_bake:
        print(f"{'bake':<12} {_time_bake()}")


def _describe_versions() -> Iterator[tuple[str, str]]:
    yield "navbake", f"{__version__} in {Path(samples.__file__).parent}"
    yield "python", f"{platform.python_version()} in {sys.executable}"
    yield "system", f"{platform.platform()}, {platform.machine()}"
    yield "packages", ", ".join(f"{name} {_installed(name) or 'MISSING'}" for name in _needed()[""])


def _needed() -> dict[str, list[str]]:
    """The packages that navbake requires, by extra, those that it always requires under ""."""
    needed: dict[str, list[str]] = {"": []}
    for line in requires("navbake") or ():
        found = REQUIREMENT.match(line)
        assert found is not None
        needed.setdefault(found["extra"] or "", []).append(found[1])
    return needed


def _installed(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _describe_machine() -> Iterator[tuple[str, str]]:
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    yield "cores", f"{os.cpu_count()}, usable {usable}, threads of a bake {threads.num_threads()}"
    found = [name for name in ("EGL", "OSMesa", "GL") if find_library(name)]
    screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") or "none"
    libraries = ", ".join(found) or "none"
    yield (
        "OpenGL",
        f"libraries {libraries}, display {screen}; only the browser of `view` draws by it",
    )


def _describe_cache() -> Iterator[tuple[str, str]]:
    folder = compiled.cache_folder()
    if folder is None:
        yield "compiled", f"NO FOLDER CAN BE WRITTEN: each process compiles anew; {compiled.REMEDY}"
        return
    entries = [entry for group in compiled.read_list() for entry in group]
    cold = len(compiled.list_cold(entries))
    files = [path for path in folder.rglob("*.nb?") if path.is_file()]
    used = {Path(kernel.stats.cache_path).parent for kernel in compiled.KERNELS}
    stale = [path for path in files if path.parent.parent not in used]
    state = f"{len(entries) - cold} of {len(entries)} functions are compiled"
    yield "compiled", f"{folder}, {_megabytes(files)} MB: {state}"
    if stale:
        folders = len({path.parent.parent for path in stale})
        yield "", f"{_megabytes(stale)} MB in {folders} folders are of other sources: not used"


def _megabytes(files: list[Path]) -> str:
    return f"{sum(path.stat().st_size for path in files) / 1e6:.1f}"


def _describe_extras() -> Iterator[tuple[str, str]]:
    for extra, packages in sorted(_needed().items()):
        if extra in ("", "test", "bench", "docs", "tensors-test"):  # of developers
            continue
        have = [f"{name} {_installed(name)}" for name in packages if _installed(name)]
        missing = [name for name in packages if not _installed(name)]
        lack = f'missing {", ".join(missing)}: pip install "navbake[{extra}]"'
        yield (
            f"[{extra}]",
            "; ".join([*([", ".join(have)] if have else []), *([lack] if missing else [])]),
        )


def _time_bake() -> str:
    """Bake the sample twice, the first time with what compiling there is to do."""
    settings, taken = config.load_config(samples.path(SAMPLE)), []
    try:
        for _ in range(2):
            begin = time.perf_counter()
            grid = pipeline.bake(settings)
            taken.append(time.perf_counter() - begin)
    except NavbakeError as error:
        raise NavbakeError(f"the sample {SAMPLE!r} can't be baked: {error}") from error
    free = sum(int(level.free.sum()) for level in grid.levels)
    is_usual = "as usual" if taken[1] <= USUAL else f"SLOW: usually below {USUAL} s"
    return f"{SAMPLE}: {taken[0]:.2f} s, again {taken[1]:.2f} s ({is_usual}), {free} free cells"
