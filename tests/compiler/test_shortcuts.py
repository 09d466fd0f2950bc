"""Shortcuts through numba's compiler change how long it takes, and nothing else."""

from __future__ import annotations

import gc
import itertools
import os
import pickle
import subprocess
import sys
from contextlib import suppress

import numpy as np
import pytest
from llvmlite import ir as llvm
from numba.core import event, inline_closurecall, types
from numba.core.compiler import DEFAULT_FLAGS, run_frontend
from numba.core.postproc import PostProcessor
from numba.core.registry import cpu_target

from navbake import loading
from navbake.compiler import replaced
from navbake.compiler import shortcuts as module
from navbake.navgrid.kernels import islands, union_find
from project_paths import ROOT

JOIN = vars(islands)["_join"]
# numba's own functions, and what stands in their place
OWN = {name: (getattr(owner, name), ours) for owner, name, ours in replaced.REPLACED}

pytestmark = pytest.mark.skipif(not loading.loads_light(), reason="made for another numba")


def sample(values, start=1, *, limit=(2, 3)):
    total, parts = 0, []
    for i, value in enumerate(values):
        if i > start and value not in limit:
            parts.append((i, {"value": value}, f"{value}"))
            total += [x for x in parts if x][-1][0]
    return total, parts[start:]


@pytest.mark.parametrize("function", [sample, JOIN.py_func, union_find.unite.py_func])
def test_variables_of_statements_are_those_that_numba_lists(function):
    for block in run_frontend(function).blocks.values():
        for statement in block.body:
            for part in (statement, *(v for v in vars(statement).values())):
                numbas, ours = OWN["_rec_list_vars"]
                expected = [v.name for v in numbas(statement, part)]
                assert [v.name for v in ours(statement, part)] == expected


def test_options_are_those_that_numba_gives():
    flags = DEFAULT_FLAGS.copy()
    numbas, ours = OWN["values"]
    assert ours(flags) == numbas(flags)
    flags.release_gil, flags.boundscheck = True, True
    assert list(ours(flags).items()) == list(numbas(flags).items())


@pytest.mark.parametrize("function", [sample, JOIN.py_func, union_find.unite.py_func])
@pytest.mark.parametrize("emit_dels", [False, True])
def test_lifetimes_of_variables_are_those_that_numba_finds(function, emit_dels):
    found = []
    for post_process in OWN["run"]:
        function_ir = run_frontend(function)
        post_process(PostProcessor(function_ir), emit_dels=emit_dels)
        lifetime = function_ir.variable_lifetime
        blocks = {at: [str(each) for each in b.body] for at, b in function_ir.blocks.items()}
        found.append((blocks, lifetime.livemap, lifetime.deadmaps.combined))
    assert found[0] == found[1]


def test_variables_of_a_generator_are_those_that_numba_finds():
    def squares(count):
        for i in range(count):
            yield i * i

    states = []
    for post_process in OWN["run"]:
        function_ir = run_frontend(squares)
        post_process(PostProcessor(function_ir))
        states.append(function_ir.generator_info.state_vars)
    assert states[0] == states[1] != []


def test_sizes_of_types_are_those_that_numba_finds():
    numbas, ours = OWN["get_abi_sizeof"]
    context = cpu_target.target_context
    pair = llvm.LiteralStructType([llvm.IntType(8), llvm.DoubleType()])
    for of in (llvm.IntType(1), llvm.IntType(32), pair, llvm.ArrayType(pair, 3), pair):
        assert ours(context, of) == numbas(context, of)


def test_loops_of_ufuncs_are_those_that_numba_finds():
    numbas, ours = OWN["ufunc_find_matching_loop"]
    kinds = [types.int32, types.int64, types.float32, types.float64, types.boolean, types.none]
    for ufunc in (np.add, np.less, np.floor_divide, np.bitwise_and):
        for pair in itertools.product(kinds, repeat=2):
            assert ours(ufunc, list(pair)) == numbas(ufunc, list(pair))


def test_events_and_timers_are_for_others_as_numba_has_them():
    codegen = cpu_target.target_context.codegen()
    with event.install_recorder("numba:run_pass") as heard:
        with module.shortcuts(codegen), event.trigger_event("numba:run_pass"):
            assert not heard.buffer
        with event.trigger_event("numba:run_pass"):
            assert len(heard.buffer) == 1


def test_what_a_kernel_may_not_do_is_told():
    code = """
import numpy as np
from navbake.navgrid.kernels import islands
islands.label_islands.compile(tuple([__import__("numba").types.unicode_type] * 6))
"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    assert done.returncode == 1 and "numba.core.errors.TypingError" in done.stderr
    assert "islands.py" in done.stderr


def test_numba_is_as_it_was_afterwards():
    def in_place():
        return [getattr(owner, name) for owner, name, _ in replaced.REPLACED]

    def library():
        return getattr(codegen, "_library_class")  # noqa: B009 - numba's own name

    codegen = cpu_target.target_context.codegen()
    before, library_before = in_place(), library()
    threshold, copy = gc.get_threshold(), inline_closurecall.copy
    with suppress(ValueError), module.shortcuts(codegen):
        with module.shortcuts(codegen):
            assert library() is module.LeanLibrary
        assert library() is module.LeanLibrary
        assert in_place() == [ours for _, _, ours in replaced.REPLACED]
        raise ValueError
    assert in_place() == before and library() is library_before
    assert "_library_class" not in vars(codegen)
    assert (threshold, copy) == (gc.get_threshold(), inline_closurecall.copy)


class Stubborn:
    """Something of numba's that cannot be replaced: the attempt ends in an error."""

    own = "numba's"

    def __setattr__(self, name, value):
        if value != self.own:
            raise KeyboardInterrupt


def test_numba_is_as_it_was_where_replacing_ends_half_way(monkeypatch):
    owners = [(owner, name) for owner, name, _ in replaced.REPLACED]
    before = [getattr(owner, name) for owner, name in owners]
    half = (*replaced.REPLACED[:3], (Stubborn(), "own", "ours"), *replaced.REPLACED[3:])
    monkeypatch.setattr(replaced, "REPLACED", half)
    threshold = gc.get_threshold()
    with (
        pytest.raises(KeyboardInterrupt),
        module.shortcuts(cpu_target.target_context.codegen()),
    ):
        pass
    assert [getattr(owner, name) for owner, name in owners] == before
    assert gc.get_threshold() == threshold


@pytest.mark.parametrize(("own", "expected"), [(700, 200_000), (10**6, 10**6), (0, 0)])
def test_garbage_is_looked_for_seldom_or_never(own, expected):
    threshold = gc.get_threshold()
    gc.set_threshold(own)
    try:
        with module.shortcuts(cpu_target.target_context.codegen()):
            assert gc.get_threshold()[0] == expected
        assert gc.get_threshold()[0] == own
    finally:
        gc.set_threshold(*threshold)


USE = """
import sys
from navbake import loading
if "plain" in sys.argv:
    loading.MADE_FOR = "0.0."
import numpy as np
from navbake.navgrid.kernels import islands
start, width = np.array([0, 15]), np.array([5])
free = np.array([1, 1, 0, 1, 1,  1, 1, 0, 0, 0,  0, 0, 0, 1, 1], bool)
links = np.zeros((0, 2), np.int64)
part, size = islands.label_islands(start, width, free, np.zeros(15, np.float32), 0.1, links)
assert part.tolist() == [1, 1, 0, 2, 2,  1, 1, 0, 0, 0,  0, 0, 0, 3, 3], part
assert size.tolist() == [0, 4, 2, 2], size
print(sum(islands._join.stats.cache_hits.values()))
print(sum(islands.label_islands.stats.cache_hits.values()))
"""


def use(folder, *arguments):
    """Label islands in a process; how often `_join` and `label_islands` were found on disk."""
    env = {**os.environ, "NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": str(ROOT)}
    code = [sys.executable, "-c", USE, *arguments]
    done = subprocess.run(code, env=env, stdout=subprocess.PIPE, text=True, check=True)
    return [int(word) for word in done.stdout.split()]


def kinds(folder):
    """By kernel, whether machine code is kept or LLVM's alone."""
    found = {}
    for path in folder.rglob("islands.*.nbc"):
        found[path.name.partition("-")[0]] = pickle.loads(path.read_bytes())[0][1]
    return found


def test_machine_code_is_kept_of_what_python_calls(tmp_path):
    assert use(tmp_path) == [0, 0]
    assert kinds(tmp_path) == {
        "islands.label_islands": "object",
        "islands._join": "bitcode",
        "islands._rank": "bitcode",
    }
    assert use(tmp_path) == [0, 1]
    for path in tmp_path.rglob("islands.label_islands*"):
        path.unlink()
    assert use(tmp_path) == [1, 0]  # what was kept is linked into what is compiled
    assert use(tmp_path) == [0, 1]


def test_kernels_are_compiled_without_shortcuts_by_another_numba(tmp_path):
    assert use(tmp_path, "plain") == [0, 0]
    assert set(kinds(tmp_path).values()) == {"object"}
    assert use(tmp_path, "plain") == [0, 1]
