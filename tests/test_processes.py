"""Limits of a process, and whether an error came of them."""

from __future__ import annotations

from itertools import pairwise

import pytest

from navbake import processes as child
from navbake.errors import SceneError
from navbake.processes import is_lack_of_memory, limit_memory

pytestmark = pytest.mark.skipif(child.resource is None, reason="Windows limits no process so")


@pytest.fixture
def limited(monkeypatch):
    """Let this process' memory seem to be limited."""
    monkeypatch.setattr(child.resource, "getrlimit", lambda _: (1 << 30, 1 << 40))


def error_of(*chain):
    """The last of some errors, each of which came of the one before it."""
    for cause, error in pairwise(chain):
        error.__cause__ = cause
    return chain[-1]


LACKING = {
    "Python": (MemoryError(),),
    "a reader": (MemoryError(), SceneError("cannot read the mesh a.obj: broken")),
    "MuJoCo": (ValueError("engine error: Could not allocate memory"), SceneError("no")),
    "C++": (RuntimeError("Caught an unknown exception!"), SceneError("no"), SceneError("no")),
    "a library": (ImportError("a.so: Cannot allocate memory"),),
    "the system": (OSError(12, "Cannot allocate memory"), SceneError("cannot read a.xml")),
}


@pytest.mark.parametrize("chain", LACKING.values(), ids=LACKING)
def test_libraries_say_in_many_ways_that_memory_is_short(limited, chain):
    assert is_lack_of_memory(error_of(*chain))


def test_what_was_being_handled_counts_as_the_cause(limited):
    error = SceneError("broken")
    error.__context__ = MemoryError()
    assert is_lack_of_memory(error)


def test_other_errors_and_names_of_files_are_not_taken_for_it(limited):
    assert not is_lack_of_memory(error_of(ValueError("no such mesh"), SceneError("broken")))
    assert not is_lack_of_memory(SceneError("no scene file at unknown exception.xml"))


def test_without_a_limit_sizes_that_a_file_states_may_be_the_cause(monkeypatch):
    infinity = child.resource.RLIM_INFINITY
    monkeypatch.setattr(child.resource, "getrlimit", lambda _: (infinity, infinity))
    for name, chain in LACKING.items():
        assert is_lack_of_memory(error_of(*chain)) == (name == "Python")


@pytest.mark.parametrize("gib", [None, float("inf"), 1e12, 2.0**33 - 1e-3])
def test_more_than_a_process_can_have_is_no_limit(monkeypatch, gib):
    set_ = []
    infinity = child.resource.RLIM_INFINITY
    monkeypatch.setattr(child.resource, "getrlimit", lambda _: (infinity, infinity))
    monkeypatch.setattr(child.resource, "setrlimit", lambda *given: set_.append(given))
    limit_memory(gib)
    assert set_ == [(child.resource.RLIMIT_CORE, (0, 0))]
