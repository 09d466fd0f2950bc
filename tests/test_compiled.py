"""Compiled kernels are kept where that can be, and don't outlive their sources."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import navbake
from navbake.digests import digest_modules

MACHINERY = ("compiled", "digests", "dispatch", "errors", "folder_lock", "kernel_list", "loading")
INNER = """from numba import njit

@njit(cache=True)
def inner():
    return 1
"""
OUTER = """from numba import njit

from navbake.kernels.inner import inner

@njit(cache=True)
def outer():
    return inner()
"""


@pytest.fixture
def package(tmp_path):
    """A package of the same name with two kernels of its own, and what keeps them fresh."""
    kernels = tmp_path / "navbake" / "kernels"
    kernels.mkdir(parents=True)
    (tmp_path / "navbake" / "__init__.py").write_text("")
    real = Path(navbake.__file__).parent
    for name in MACHINERY:
        shutil.copy(real / f"{name}.py", kernels.parent)
    shutil.copytree(real / "compiler", kernels.parent / "compiler")
    source = (real / "runtime" / "kernels" / "__init__.py").read_bytes()
    (kernels / "__init__.py").write_bytes(source)
    (kernels / "inner.py").write_text(INNER)
    (kernels / "outer.py").write_text(OUTER)
    (kernels / "other.py").write_text(INNER.replace("inner", "other"))
    return kernels


ASK = (
    "from navbake.kernels.outer import outer\n"
    "from navbake.kernels.other import other\n"
    "print(outer(), other(), sum(other.stats.cache_hits.values()))"
)


def start(package: Path, code: str = ASK, no_writes: bool = False, **env: str) -> subprocess.Popen:
    """Start a process that uses the package; `no_writes` is a disk that is full."""
    full = {**os.environ, "PYTHONPATH": str(package.parents[1]), **env}
    if "NUMBA_CACHE_DIR" not in env:
        full.pop("NUMBA_CACHE_DIR", None)

    def fill_disk() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))

    return subprocess.Popen(
        # -B: bytecode is kept by time and size, which the changed sources have in common
        [sys.executable, "-B", "-c", code],
        cwd=package.parents[1],
        env=full,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=fill_disk if no_writes else None,
    )


def run(package: Path, code: str = ASK, **options) -> tuple[str, str]:
    process = start(package, code, **options)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    return out.strip(), err


def ask(package: Path) -> str:
    """What the kernels return in a process of their own, and how often each was compiled."""
    return run(package)[0]


def test_a_changed_kernel_is_compiled_anew_in_all_that_use_it(package):
    assert ask(package) == "1 1 0"
    assert ask(package) == "1 1 1"
    times = (package / "inner.py").stat()
    (package / "inner.py").write_text(INNER.replace("return 1", "return 2"))
    os.utime(package / "inner.py", ns=(times.st_atime_ns, times.st_mtime_ns))  # as wheels have it
    assert ask(package) == "2 1 1"  # the one that has nothing to do with it was kept


def test_digests_follow_what_is_used(package):
    before = digest_modules(package.parent)
    (package / "inner.py").write_text(INNER.replace("return 1", "return 2"))
    after = digest_modules(package.parent)
    changed = {name for name in before if before[name] != after[name]}
    assert changed == {"navbake.kernels.inner", "navbake.kernels.outer"}


def test_digests_follow_the_fields_of_named_tuples(package):
    """Compiled code reads a field by its place, so that swapping two would mix them up."""
    text = "from typing import NamedTuple\n\nclass Ball(NamedTuple):\n    '''A ball.'''\n\n"
    ball = package.parent / "ball.py"
    ball.write_text(text + "    radius: float\n    mass: float\n")
    before = digest_modules(package.parent)
    ball.write_text(text + "    radius: float\n    mass: float\n\n\nWEIGHT = 1\n")
    assert digest_modules(package.parent) == before
    ball.write_text(text + "    mass: float\n    radius: float\n")
    after = digest_modules(package.parent)
    assert all(before[name] != after[name] for name in before)
    (package.parent / "batch").mkdir()
    (package.parent / "batch" / "job.py").write_text(text + "    radius: float\n")
    assert digest_modules(package.parent) == after  # no kernel is given one of a batch's


@pytest.fixture
def read_only(package, tmp_path):
    """The environment in which no folder can be written: there are files in their places."""
    (package / "__pycache__").write_text("")
    (tmp_path / "file").write_text("")
    place = str(tmp_path / "file")
    return {"NUMBA_CACHE_DIR": place, "HOME": place, "XDG_CACHE_HOME": place}


SLOW = "import navbake.dispatch as d; d.SECONDS = 2.0\n"  # as if kernels took long


def test_compiles_in_memory_where_nothing_can_be_written(package, read_only):
    out, err = run(package, SLOW + ASK, **read_only)
    assert out == "1 1 0"
    assert len(err.splitlines()) == 1
    assert "compiling in memory: about 6 s, in each process anew" in err
    assert "set NUMBA_CACHE_DIR to a folder that can be written" in err


def test_says_once_that_it_compiles_and_for_how_long(package):
    out, err = run(package, SLOW + ASK)
    assert out == "1 1 0" and err == "navbake: compiling for this machine, once: about 6 s\n"
    out, err = run(package, SLOW + ASK)
    assert out == "1 1 1" and err == ""


def test_says_nothing_where_it_takes_less_than_a_second(package):
    fast = SLOW.replace("2.0", "0.1")
    assert run(package, fast + ASK) == ("1 1 0", "")


def test_code_is_kept_elsewhere_where_the_given_folder_cannot_be_written(package, tmp_path):
    (tmp_path / "file").write_text("")
    bad = {"NUMBA_CACHE_DIR": str(tmp_path / "file")}
    assert run(package, **bad)[0] == "1 1 0"
    assert run(package, **bad)[0] == "1 1 1"


def test_a_full_disk_is_told_once(package):
    out, err = run(package, no_writes=True)
    assert out == "1 1 0"
    told = [line for line in err.splitlines() if "cannot keep compiled code in" in line]
    assert len(told) == 1 and "set NUMBA_CACHE_DIR" in told[0]
    assert run(package)[0] == "1 1 0"  # nothing broken was left
    assert run(package)[0] == "1 1 1"


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("size", [0, 1, 40, 200])
def test_broken_files_are_replaced(package, ending, size):
    ask(package)
    for path in (package / "__pycache__").glob(f"*.{ending}"):
        path.write_bytes(path.read_bytes()[:size])
    assert ask(package) == "1 1 0"
    assert ask(package) == "1 1 1"


def test_an_interrupted_compile_is_cold(package):
    """numba writes the index first: then no code is there that it lists."""
    ask(package)
    for path in (package / "__pycache__").glob("other*.nbc"):
        path.unlink()
    out, err = run(package, SLOW + ASK)
    assert out == "1 1 0" and "compiling for this machine" in err


def test_a_folder_that_can_only_be_read_is_used(package, tmp_path):
    """As in a container that was warmed up when its image was built."""
    ask(package)
    deny = """
import tempfile
def fail(*args, dir=None, **options):
    raise PermissionError(13, "Permission denied")
tempfile.TemporaryFile = fail
"""
    assert run(package, deny + ASK) == ("1 1 1", "")
    (package / "inner.py").write_text(INNER.replace("return 1", "return 2"))
    out, _ = run(package, deny + ASK)  # what is not fresh is not used
    assert out == "2 1 0"


def test_kernels_are_compiled_without_the_compiler_switched_on(package):
    fast = SLOW.replace("2.0", "0.1")
    out, err = run(package, fast + ASK, NUMBA_DISABLE_JIT="1")
    assert out == "1 1 0"
    assert err.startswith("navbake: NUMBA_DISABLE_JIT is set, but navbake")


def test_many_processes_compile_each_kernel_once(package):
    code = ASK + "\nprint(sum(outer.stats.cache_misses.values()))"
    processes = [start(package, code) for _ in range(6)]
    outs = [process.communicate(timeout=120) for process in processes]
    assert all(process.returncode == 0 for process in processes), outs
    answers = [out.split() for out, _ in outs]
    assert all(answer[:2] == ["1", "1"] for answer in answers)
    # the first one compiled, the others found its code
    assert sum(int(answer[2]) for answer in answers) == len(answers) - 1
    assert sum(int(answer[3]) for answer in answers) == 1


def test_kernels_of_others_stay_as_they_are(package):
    code = (
        "import navbake.kernels, numba\n"
        "@numba.njit(cache=False)\ndef mine():\n    return 3\n"
        "print(mine(), type(mine).__name__)"
    )
    assert run(package, code)[0] == "3 CPUDispatcher"
