"""Compiled kernels don't outlive the sources that they were compiled from."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import navbake
from navbake.compiled import digest_modules

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
    (kernels.parent / "compiled.py").write_bytes((real / "compiled.py").read_bytes())
    source = (real / "runtime" / "kernels" / "__init__.py").read_bytes()
    (kernels / "__init__.py").write_bytes(source)
    (kernels / "inner.py").write_text(INNER)
    (kernels / "outer.py").write_text(OUTER)
    (kernels / "other.py").write_text(INNER.replace("inner", "other"))
    return kernels


def ask(package: Path) -> str:
    """What the kernels return in a process of their own, and how often each was compiled."""
    code = (
        "from navbake.kernels.outer import outer\n"
        "from navbake.kernels.other import other\n"
        "print(outer(), other(), sum(other.stats.cache_hits.values()))"
    )
    env = {**os.environ, "PYTHONPATH": str(package.parents[1])}
    env.pop("NUMBA_CACHE_DIR", None)
    run = subprocess.run(
        # -B: bytecode is kept by time and size, which the changed sources have in common
        [sys.executable, "-B", "-c", code],
        cwd=package.parents[1],
        env=env,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return run.stdout.strip()


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
