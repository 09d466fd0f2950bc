"""Compiled kernels are kept where that can be, and don't outlive their sources."""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import navbake
from navbake.compiled import KERNELS, decode_type, import_object, list_uncompiled, read_list

INNER = """from navbake.compiled import kernel

@kernel
def inner():
    return 1
"""
OUTER = """from navbake.compiled import kernel, subkernel
from navbake.kernels.inner import inner

@subkernel
def half():
    return 1

@kernel(nogil=True)
def outer():
    return inner() * half()
"""
LIST = {
    "bake": [["kernels.outer.outer", 5.0, []], ["kernels.other.other", 8.0, []]],
    "others": [["kernels.lone.lone", 3.0, ["float64 1 C"]], ["kernels.gone.gone", 9.0, []]],
}
ASK = """
from navbake.compiled import ensure_compiled
ensure_compiled()
from navbake.kernels.outer import outer
from navbake.kernels.other import other
print(outer(), other(), *(sum(k.stats.cache_hits.values()) for k in (outer, other)))
"""


@pytest.fixture
def package(tmp_path):
    """A package of the same name with some kernels of its own."""
    kernels = tmp_path / "navbake" / "kernels"
    kernels.mkdir(parents=True)
    real = Path(navbake.__file__).parent
    for name in ("compiled", "lazy"):
        shutil.copy(real / f"{name}.py", kernels.parent)
    (kernels.parent / "__init__.py").write_text("")
    (kernels / "__init__.py").write_text("")
    (kernels.parent / "kernels.json").write_text(json.dumps(LIST))
    (kernels / "inner.py").write_text(INNER)
    (kernels / "outer.py").write_text(OUTER)
    (kernels / "other.py").write_text(INNER.replace("inner", "other"))
    (kernels / "lone.py").write_text(INNER.replace("inner()", "lone(x)"))
    return kernels


def start(package: Path, code: str = ASK, **env: str) -> subprocess.Popen[str]:
    # bytecode is kept by time and size, which the changed sources have in common
    own = {"PYTHONPATH": str(package.parents[1]), "PYTHONDONTWRITEBYTECODE": "1"}
    full = {**os.environ, **own, **env}
    if "NUMBA_CACHE_DIR" not in env:
        full.pop("NUMBA_CACHE_DIR", None)
    return subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=package.parents[1],
        env=full,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def run(package: Path, code: str = ASK, **env: str) -> tuple[str, str]:
    process = start(package, code, **env)
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return out.strip(), err


def test_code_is_kept_until_a_source_changes(package):
    out, err = run(package)
    assert out == "1 1 1 1"  # other processes compiled
    assert err.startswith("navbake: compiling for this machine, once: about 8 s")
    assert run(package) == ("1 1 1 1", "")
    times = (package / "inner.py").stat()
    (package / "inner.py").write_text(INNER.replace("return 1", "return 2"))
    os.utime(package / "inner.py", ns=(times.st_atime_ns, times.st_mtime_ns))  # as wheels have it
    out, err = run(package)
    assert out == "2 1 1 1" and "about 5 s" in err  # what does not import it was kept


def test_all_is_compiled_beforehand_and_what_is_not_is_named(package, tmp_path):
    warm = "from navbake.compiled import warm_up; print(warm_up())"
    env = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    assert run(package, warm, **env)[0] == "[]"  # what is out of date in the list is nobody's
    assert run(package, **env) == ("1 1 1 1", "")
    shutil.copytree(tmp_path / "cache", tmp_path / "copy")
    assert run(package, NUMBA_CACHE_DIR=str(tmp_path / "copy")) == ("1 1 1 1", "")


LONE = """
import numpy as np
from navbake import compiled
compiled.FIRST_PROGRESS = 0.05
compiled.ensure_compiled("kernels.lone")
from navbake.kernels.lone import lone
print(lone(np.zeros(3)))
"""


def test_lines_say_how_long_compiling_takes_and_how_far_it_is(package):
    """Of a kernel that no bake calls, which is compiled alone."""
    out, err = run(package, LONE)
    first, *others = err.splitlines()
    assert out == "1" and re.fullmatch(r"navbake: compiling .*, once: about 3 s", first)
    assert others and all(
        re.fullmatch(r"navbake: compiled [01] of 1 functions after \d+ s", line) for line in others
    )
    assert len(others) < 10  # each after twice as long as the last: ten would take 50 s
    assert run(package, LONE) == ("1", "")


def test_compiles_in_memory_where_nothing_can_be_written(package, tmp_path):
    (package.parent / "__pycache__").write_text("")  # files where folders would be
    (tmp_path / "file").write_text("")
    place = {"XDG_CACHE_HOME": str(tmp_path / "file")}
    out, err = run(package, **place)
    assert out == "1 1 0 0" and err.count("\n") == 1
    assert "compiling in memory" in err and "set NUMBA_CACHE_DIR to a folder" in err
    warm = "from navbake.compiled import warm_up; print(warm_up())"
    assert "kernels.other.other" in run(package, warm, **place)[0]


DENY = """
import tempfile
def fail(*args, dir=None, **options):
    if "navbake-kernels" in str(dir) and str(dir).startswith({folder!r}):
        raise PermissionError(13, "Permission denied")
    return make(*args, dir=dir, **options)
make, tempfile.TemporaryFile = tempfile.TemporaryFile, fail
"""


def test_a_folder_that_can_only_be_read_is_used(package, tmp_path):
    """As in a container that was warmed up when its image was built."""
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "TMPDIR": str(tmp_path / "tmp")}
    (tmp_path / "tmp").mkdir()
    run(package, **cache)
    deny = DENY.format(folder=cache["NUMBA_CACHE_DIR"])
    assert run(package, deny + ASK, **cache) == ("1 1 1 1", "")
    (package / "inner.py").write_text(INNER.replace("return 1", "return 2"))
    assert run(package, deny + ASK, **cache)[0] == "2 1 1 1"
    assert list((tmp_path / "tmp").iterdir()) == []


def test_many_processes_compile_at_once(package):
    processes = [start(package) for _ in range(4)]
    outs = [process.communicate(timeout=300) for process in processes]
    assert all(process.returncode == 0 for process in processes), outs
    assert all(out.strip() == "1 1 1 1" for out, _ in outs)
    assert run(package)[0] == "1 1 1 1"


def test_kernels_of_others_stay_as_they_are(package):
    code = "import navbake.compiled, numba\nprint(numba.njit(lambda: 3)(), numba.config.CACHE_DIR)"
    assert run(package, code) == ("3", "")


def test_the_list_names_kernels_with_their_types():
    """If it fails: run `python scripts/list_kernels.py`."""
    for entry in [*read_list()[0], *read_list()[1]]:
        found = import_object(entry.name)
        assert found in KERNELS, entry.name
        assert len(entry.types) == found.py_func.__code__.co_argcount, entry.name
        for each in entry.types:
            decode_type(each)


CALLED = """
import contextlib, json, sys
from pathlib import Path
from navbake.cli.main import main
from navbake.compiled import KERNELS
with contextlib.suppress(SystemExit):
    main(['bake', 'configs/apartment.yaml', '-o', sys.argv[1]])
called = {}
for one in KERNELS:
    if one.signatures and not one.stats.cache_misses:
        code = list(Path(one.stats.cache_path).glob(f'*.{one.__name__}-*.nbc'))
        size = sum(path.stat().st_size for path in code) / len(code)  # of other types, too
        types = len(one.signatures)
        called[f'{one.__module__}.{one.__name__}'] = types, types * size
print(json.dumps(called))
"""
MOST, MOST_BYTES = 33, 3_400_000  # that a bake loads: each costs 1 ms, and 0.04 ms for each KB


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_the_list_has_what_a_bake_calls_which_is_little(tmp_path):
    """If the list lacks a kernel: run `python scripts/list_kernels.py`."""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", CALLED, str(tmp_path / "a.grid.json")],
        cwd=Path(navbake.__file__).parents[1], stdout=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    names = [entry.name for entry in read_list()[0]]
    called = json.loads(done.stdout.splitlines()[-1])
    missing = [k for k, (n, _) in called.items() if names.count(k.removeprefix("navbake.")) < n]
    assert missing == [] and list_uncompiled(read_list()[0]) == []
    assert len(called) <= MOST
    assert sum(size for _, size in called.values()) <= MOST_BYTES


def test_what_is_compiled_ahead_by_a_prefix_is_in_the_list():
    """A prefix of a module that was moved compiles nothing, and the first query waits."""
    names = [entry.name for group in read_list() for entry in group]
    prefixes = []
    for path in sorted(Path(navbake.__file__).parent.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            function = getattr(node, "func", None)
            name = getattr(function, "attr", getattr(function, "id", ""))
            if isinstance(node, ast.Call) and name == "ensure_compiled":
                prefixes += [argument.value for argument in node.args]
    assert len(prefixes) >= 6
    for prefix in prefixes:
        assert any(name.startswith(prefix) for name in names), prefix
