"""The list of kernels: its types come back, it is complete, and processes share its work."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import typeof

from navbake.kernel_list import (
    FILE,
    START,
    Entry,
    KernelList,
    decode,
    encode,
    plan,
    read_list,
)

ROOT = Path(__file__).parents[1]


class Pair(NamedTuple):
    one: np.ndarray
    two: float


def test_types_come_back():
    frozen = np.zeros(3)
    frozen.flags.writeable = False
    values = [
        1, 2.5, True, np.int32(3), np.zeros((2, 3), np.float32), np.zeros((2, 2, 2), bool),
        np.zeros((3, 4))[:, ::2], np.asfortranarray(np.zeros((3, 4))), frozen, (1, 2.0), (1, 1),
        Pair(np.zeros(2), 1.0), Pair(np.zeros(2, np.int8), 1.0), (Pair(np.zeros(2), 1.0), 3),
    ]  # fmt: skip
    tuples: dict = {}
    for value in values:
        written = json.loads(json.dumps(encode(typeof(value), tuples)))
        # this module is not to be imported again by its name
        tuples_here = {k: [v[0], v[1]] for k, v in tuples.items()}
        sys.modules.setdefault(Pair.__module__, sys.modules[__name__])
        assert decode(written, tuples_here) == typeof(value)
    assert len(tuples) == 2
    with pytest.raises(ValueError, match="expected numbers, arrays or tuples"):
        encode(typeof("text"), tuples)


def test_a_list_that_cannot_be_read_is_empty(monkeypatch, tmp_path):
    for text in (None, "", "[]", '{"kernels": [1]}'):
        path = tmp_path / "kernels.json"
        if text is not None:
            path.write_text(text)
        monkeypatch.setattr("navbake.kernel_list.FILE", path)
        read_list.cache_clear()
        assert read_list().entries == []
    read_list.cache_clear()


USE = """
import json
import threading
import navbake
from navbake.dispatch import Kernel
from navbake.kernel_list import encode
called, own, compile_one = [], threading.local(), Kernel.compile
def note(kernel, sig):
    own.depth = getattr(own, "depth", 0) + 1
    try:
        return compile_one(kernel, sig)
    finally:
        own.depth -= 1
        if not own.depth:
            called.append([kernel.full_name, [encode(t, {}) for t in sig]])
Kernel.compile = note
navbake.bake("configs/apartment.yaml")
print("\\n" + json.dumps(called))
"""


def test_the_list_has_what_a_bake_calls():
    """If it fails: run `python scripts/list_kernels.py`."""
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", USE],
        cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    # a prime tells classes of one name apart in the list, and `encode` sees one at a time here
    listed = [
        [entry.name, json.loads(json.dumps(entry.types).replace("'", ""))]
        for entry in read_list().entries[: read_list().num_common]
    ]
    missing = [call for call in json.loads(run.stdout.splitlines()[-1]) if call not in listed]
    assert missing == [], f"{FILE.name} is out of date: run `python scripts/list_kernels.py`"


HELP = """
import json, os, sys
from navbake import dispatch, kernel_list
import navbake.formats.kernels.runs as runs
modules = [runs.__name__]
if sys.argv[1:] == ["help"]:
    cold = [k.full_name for k in dispatch.KERNELS]
    kernel_list.compile_listed(cold, 0, 1, os.getppid())
else:
    import numpy as np
    entries, tuples, _ = kernel_list.read_list()
    hits = 0
    for entry in entries:
        if entry.module in modules:
            kernel = getattr(runs, entry.name.rpartition(".")[2])
            kernel.compile(tuple(kernel_list.decode(t, tuples) for t in entry.types))
            hits += sum(kernel.stats.cache_hits.values())
            assert not kernel.stats.cache_misses, entry
    print(hits)
"""


def test_what_a_helper_compiles_is_found(tmp_path):
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", HELP, "help"], env=env, check=True)
    run = subprocess.run(
        [sys.executable, "-c", HELP], env=env, stdout=subprocess.PIPE, text=True, check=True
    )
    assert int(run.stdout) > 0


def finish(seconds: list[float], num_helpers: int) -> float:
    """When a process has all its kernels that takes what is left, in order, beside its helpers."""
    plans = plan(seconds, num_helpers)
    done = {}
    for numbers in plans:
        clock = START
        for number in numbers:
            clock += seconds[number]
            assert done.setdefault(number, clock) == clock, "taken twice"
    clock = 0.0
    for number, cost in enumerate(seconds):
        clock = max(clock, done[number]) if number in done else clock + cost
    return clock


@given(
    st.lists(st.floats(0.05, 8.0), min_size=1, max_size=60),
    st.integers(min_value=0, max_value=3),
)
def test_a_plan_shares_the_work_and_nobody_waits_long(seconds, num_helpers):
    clock, total, longest = finish(seconds, num_helpers), sum(seconds), max(seconds)
    assert clock <= total + 1e-9  # no worse than alone
    even = (total + num_helpers * START) / (1 + num_helpers)
    assert clock <= even + START + 2 * longest + 1e-9


def test_the_plan_of_a_bake_is_nearly_even():
    found = read_list()
    seconds = [entry.seconds for entry in found.entries[: found.num_common]]
    even = (sum(seconds) + START) / 2
    assert finish(seconds, 1) < 1.1 * even
    assert finish(seconds, 3) < 0.7 * even


def test_what_few_need_comes_last():
    entries = [Entry(f"module.kernel_{number}", 1.0, []) for number in range(4)]
    found = KernelList(entries, {}, num_common=2)
    names = [entry.name for entry in entries]
    assert found.cold(names) == (entries[:2], entries[2:])
    assert found.cold(names[1:3]) == (entries[1:2], entries[2:3])
    assert found.cold(names[2:]) == (entries[2:], [])


LINK = """
import sys
import numpy as np
from numba import types
from navbake.navgrid.kernels.union_find import find_root, unite
parent, items = types.Array(types.int64, 1, "C"), (types.int64, types.int64)
if sys.argv[1:] == ["callee"]:
    find_root.compile((parent, types.int64))
else:
    chain = np.array([0, 0, 1, 3, 3])
    if sys.argv[1:] == ["called"]:
        assert find_root(chain, 2) == 0
    unite(chain, 2, 4)
    assert chain.tolist() == [0, 0, 0, 0, 3], chain
    print(sum(find_root.stats.cache_hits.values()), sum(unite.stats.cache_misses.values()))
"""


@pytest.mark.parametrize("before", ["untouched", "called"])
def test_a_kernel_that_was_loaded_is_linked_into_one_that_is_compiled(tmp_path, before):
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", LINK, "callee"], env=env, check=True)
    run = subprocess.run(
        [sys.executable, "-c", LINK, before], env=env, stdout=subprocess.PIPE, text=True, check=True
    )
    assert run.stdout.split() == ["1", "1"]


def test_processes_beside_find_mujoco():
    """LLVM ends a process that compiles a call of what nobody has loaded."""
    code = """
import os
from navbake import kernel_list
kernel_list.read_list = lambda: kernel_list.KernelList([], {})
kernel_list.compile_listed(["baker.kernels.rays.cast_lines"], 0, 1, os.getppid())
from llvmlite import binding
assert binding.address_of_symbol("mju_rayGeom")
"""
    subprocess.run([sys.executable, "-c", code], check=True)
