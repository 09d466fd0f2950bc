"""Compiled kernels are kept where that can be, and don't outlive their sources."""

from __future__ import annotations

import ast
import json
import os
import pickle
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest

import navbake
from navbake.compiled import (
    KERNELS,
    decode_type,
    import_object,
    list_uncompiled,
    read_kernel_list,
    read_sources,
)
from numba_forks import NumbaForks

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
    return make_package(tmp_path)


def make_package(folder: Path) -> Path:
    """Make a package of the same name with some kernels of its own; return their folder."""
    kernels = folder / "navbake" / "kernels"
    kernels.mkdir(parents=True)
    real = Path(navbake.__file__).parent
    for name in ("compiled", "errors", "lazy", "owners", "processes"):
        shutil.copy(real / f"{name}.py", kernels.parent)
    (kernels.parent / "__init__.py").write_text("")
    (kernels / "__init__.py").write_text("")
    (kernels.parent / "kernels.json").write_text(json.dumps(LIST))
    (kernels / "inner.py").write_text(INNER)
    (kernels / "outer.py").write_text(OUTER)
    (kernels / "other.py").write_text(INNER.replace("inner", "other"))
    (kernels / "lone.py").write_text(INNER.replace("inner()", "lone(x)"))
    return kernels


def make_environment(package: Path, env: dict[str, str]) -> dict[str, str]:
    # bytecode is kept by time and size, which the changed sources have in common
    own = {"PYTHONPATH": str(package.parents[1]), "PYTHONDONTWRITEBYTECODE": "1"}
    full = {**os.environ, **own, **env}
    if "NUMBA_CACHE_DIR" not in env:
        full.pop("NUMBA_CACHE_DIR", None)
    return full


def start(package: Path, code: str = ASK, **env: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=package.parents[1],
        env=make_environment(package, env),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


FORKS = NumbaForks()


@pytest.fixture(scope="module", autouse=True)
def end_forks() -> Iterator[None]:
    yield
    FORKS.close()


def run(package: Path, code: str = ASK, **env: str) -> tuple[str, str]:
    """Run code as a new process does; where Python forks safely, in one that has numba already."""
    if sys.platform == "linux":
        status, out, err = FORKS.run(code, package.parents[1], make_environment(package, env))
    else:
        process = start(package, code, **env)
        out, err = process.communicate(timeout=300)
        status = process.returncode
    assert status == 0, err
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
compiled.FIRST_PROGRESS_DELAY = 0.05
compiled.ensure_compiled("kernels.lone")
from navbake.kernels.lone import lone
print(lone(np.zeros(3)))
"""


def test_lines_say_how_long_compiling_takes_and_how_far_it_is(package):
    """Of a kernel that no bake calls, which is compiled alone."""
    out, err = run(package, LONE)
    first, *others = err.splitlines()
    assert out == "1" and re.fullmatch(r"navbake: compiling .*, once: about 3 s, more .*", first)
    assert others and all(
        re.fullmatch(r"navbake: compiled (0 of 1 .* \d+ s|1 of 1 .* \d+ s: about 0 s left)", line)
        for line in others
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


# ---------------------------------------------------------------- what others could put there

OTHER_USER = 54321
ASK_ONE = """
from navbake.kernels.other import other
print(other(), *other.stats.cache_hits.values())
"""
only_root = pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root gives files away"
)


class Poison:
    """What writes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def poison(package: Path, folder: Path) -> Path:
    """Compile into a folder whose indexes then make a file when they are read; return that file."""
    assert run(package, ASK_ONE, NUMBA_CACHE_DIR=str(folder))[0] == "1"
    trace = folder.with_name("ran")
    for path in folder.rglob("*.nbi"):
        path.write_bytes(pickle.dumps(Poison(trace)))
    return trace


@pytest.fixture(scope="module")
def poisoned(tmp_path_factory):
    """A package, a folder of its poisoned code, and the file that this makes when it runs."""
    folder = tmp_path_factory.mktemp("poisoned")
    package = make_package(folder)
    return package, folder / "shared", poison(package, folder / "shared")


def give_away(path: Path) -> None:
    os.chown(path, OTHER_USER, OTHER_USER)
    for inner in path.rglob("*"):
        os.chown(inner, OTHER_USER, OTHER_USER, follow_symlinks=False)


def move_behind_link(path: Path) -> None:
    """Leave a link in place of a folder, which another user has from now on."""
    give_away(path.rename(path.with_name("moved")))
    path.symlink_to(path.with_name("moved"))


def only_of(pattern: str, change: Callable[[Path], None]) -> Callable[[Path], None]:
    return lambda folder: change(next(folder.glob(pattern)))


OPEN_WAYS = {
    "another user's": lambda folder: give_away(folder),
    "another user's kernels": only_of("navbake-kernels", give_away),
    "another user's module": only_of("navbake-kernels/kernels.*", give_away),
    "another user's file": only_of("navbake-kernels/kernels.*/*/*.nbi", give_away),
    "for all to write": lambda folder: folder.chmod(0o777),
    "kernels for all to write": only_of("navbake-kernels", lambda path: path.chmod(0o777)),
    "sticky kernels for all to write": only_of("navbake-kernels", lambda path: path.chmod(0o1777)),
    "for a group to write": only_of("navbake-kernels", lambda path: path.chmod(0o775)),
    "a file for all to write": only_of("*/kernels.*/*/*.nbi", lambda path: path.chmod(0o666)),
    "a link": move_behind_link,
    "a link of a module": only_of("navbake-kernels/kernels.*", move_behind_link),
    "a link of a file": only_of("navbake-kernels/kernels.*/*/*.nbi", move_behind_link),
}


@only_root
@pytest.mark.parametrize("way", OPEN_WAYS)
def test_code_that_another_user_may_have_put_there_is_not_run(poisoned, tmp_path, way):
    package, folder, trace = poisoned
    shared = shutil.copytree(folder, tmp_path / "shared")
    OPEN_WAYS[way](shared)
    out, err = run(package, ASK_ONE, NUMBA_CACHE_DIR=str(shared), HOME=str(tmp_path / "home"))
    assert out == "1" and not trace.exists()
    assert re.fullmatch(
        rf"navbake: compiled code in {tmp_path}/\S+ is not used, as .*{tmp_path}.*, and would run "
        rf"as you; it is kept in {tmp_path}/home/.cache/navbake-kernels: set NUMBA_CACHE_DIR .*\n",
        err,
    )
    assert list((tmp_path / "home").rglob("*.nbc"))


def test_code_that_nobody_else_may_write_is_run(poisoned):
    """Else the test above would prove nothing."""
    package, folder, trace = poisoned
    run(package, ASK_ONE, NUMBA_CACHE_DIR=str(folder))
    assert trace.exists()
    trace.unlink()


@only_root
@pytest.mark.parametrize("variable", ["NUMBA_CACHE_DIR", "XDG_CACHE_HOME"])
def test_in_a_folder_of_all_users_their_own_part_is_used(package, tmp_path, variable):
    """As in /tmp: what another user made there first is refused, what the user makes is not."""
    (package.parent / "__pycache__").write_text("")  # so that no folder can be made there
    everyones = tmp_path / "tmp"
    everyones.mkdir()
    everyones.chmod(0o1777)
    place = {"HOME": str(tmp_path / "home"), "TMPDIR": str(everyones)}
    assert run(package, ASK_ONE, **place, **{variable: str(everyones / "mine")}) == ("1", "")
    assert run(package, ASK_ONE, **place, **{variable: str(everyones / "mine")}) == ("1 1", "")
    trace = poison(package, everyones / "theirs")
    give_away(everyones / "theirs")
    for _ in range(2):
        out, err = run(package, ASK_ONE, **place, **{variable: str(everyones / "theirs")})
        assert out.startswith("1") and not trace.exists()
        refused = f"{everyones}/theirs/navbake-kernels"
        assert err.count("\n") == 1 and f"as {refused} belongs to user {OTHER_USER}," in err


@only_root
def test_the_package_folder_may_be_another_users(package, tmp_path):
    """As in a container that runs as root on a user's files; a new folder is not worth a line."""
    cache = package.parent / "__pycache__"
    trace = poison(package, cache)
    give_away(cache)
    place = {"HOME": str(tmp_path / "home")}
    place["XDG_CACHE_HOME"] = str(tmp_path / "home" / ".cache")
    out, err = run(package, ASK_ONE, **place)
    assert out == "1" and not trace.exists()
    assert err.count("\n") == 1 and "belongs to user" in err
    shutil.rmtree(cache / "navbake-kernels")
    assert run(package, ASK_ONE, **place) == ("1 1", "")


@only_root
def test_where_every_folder_is_another_users_one_for_the_process_is_made(package, tmp_path):
    trace = poison(package, tmp_path / "shared")
    give_away(tmp_path / "shared")
    for name in ("home", "tmp"):
        (tmp_path / name).mkdir()
    give_away(tmp_path / "home")
    place = {"NUMBA_CACHE_DIR": str(tmp_path / "shared"), "HOME": str(tmp_path / "home")}
    out, err = run(package, ASK_ONE, **place, TMPDIR=str(tmp_path / "tmp"))
    assert out == "1" and f"kept in {tmp_path}/tmp/navbake-kernels-" in err
    assert list((tmp_path / "tmp").iterdir()) == []
    give_away(tmp_path / "tmp")
    out, err = run(package, ASK_ONE, **place, TMPDIR=str(tmp_path / "tmp"))
    assert out == "1" and "kept in memory" in err
    assert not trace.exists()


def test_many_processes_compile_at_once(package):
    processes = [start(package) for _ in range(4)]
    outs = [process.communicate(timeout=300) for process in processes]
    assert all(process.returncode == 0 for process in processes), outs
    assert all(out.strip() == "1 1 1 1" for out, _ in outs)
    assert run(package)[0] == "1 1 1 1"


def test_kernels_of_others_stay_as_they_are(package):
    code = "import navbake.compiled, numba\nprint(numba.njit(lambda: 3)(), numba.config.CACHE_DIR)"
    process = start(package, code)
    out, err = process.communicate(timeout=300)
    assert (process.returncode, out.strip(), err) == (0, "3", "")


def test_the_list_names_kernels_with_their_types():
    """If it fails: run `python scripts/list_kernels.py`."""
    for entry in [*read_kernel_list()[0], *read_kernel_list()[1]]:
        found = import_object(entry.name)
        assert found in KERNELS, entry.name
        assert len(entry.types) == found.py_func.__code__.co_argcount, entry.name
        for each in entry.types:
            decode_type(each)


@cache
def package_trees() -> dict[Path, ast.Module]:
    """The syntax tree of each module of the package."""
    paths = sorted(Path(navbake.__file__).parent.rglob("*.py"))
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in paths}


def test_the_list_has_all_kernels():
    """Else the first scene that needs one waits for its compilation, as a mesh with a cavity did.

    If it fails: let `scripts/list_kernels.py` call the kernel, and run it.
    """
    folder = Path(navbake.__file__).parent
    names = {entry.name for entries in read_kernel_list() for entry in entries}
    missing = []
    for path, tree in package_trees().items():
        module = ".".join(path.relative_to(folder).with_suffix("").parts)
        for node in ast.walk(tree):
            decorators = getattr(node, "decorator_list", [])
            called = [getattr(decorator, "func", decorator) for decorator in decorators]
            if any(getattr(function, "id", "") == "kernel" for function in called):
                name = f"{module}.{node.name}"
                if name not in names:
                    missing.append(name)
    assert missing == []


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
# That a bake loads: each costs 1 ms, and 0.04 ms for each KB. `start_floors` and the bisection of
# columns need 160 KB: without them, a tower's bake takes a time that grows with its levels' square.
# `find_ground_rises` needs 215 KB: without it, the ground under steep facets is most of a soup's
# bake. Code for processors with AVX-512 is about 3 % longer
MOST, MOST_BYTES = 35, 3_800_000


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_the_list_has_what_a_bake_calls_which_is_little(tmp_path):
    """If the list lacks a kernel: run `python scripts/list_kernels.py`."""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", CALLED, str(tmp_path / "a.grid.json")],
        cwd=Path(navbake.__file__).parents[1], stdout=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    names = [entry.name for entry in read_kernel_list()[0]]
    called = json.loads(done.stdout.splitlines()[-1])
    missing = [k for k, (n, _) in called.items() if names.count(k.removeprefix("navbake.")) < n]
    assert missing == [] and list_uncompiled(read_kernel_list()[0]) == []
    assert len(called) <= MOST
    assert sum(size for _, size in called.values()) <= MOST_BYTES


def test_what_is_compiled_ahead_by_a_prefix_is_in_the_list():
    """A prefix of a module that was moved compiles nothing, and the first query waits."""
    names = [entry.name for group in read_kernel_list() for entry in group]
    prefixes = []
    for tree in package_trees().values():
        for node in ast.walk(tree):
            function = getattr(node, "func", None)
            name = getattr(function, "attr", getattr(function, "id", ""))
            if isinstance(node, ast.Call) and name == "ensure_compiled":
                prefixes += [argument.value for argument in node.args]
    assert len(prefixes) >= 6
    for prefix in prefixes:
        assert any(name.startswith(prefix) for name in names), prefix


def test_kernels_depend_on_few_modules():
    """Else a change of the settings or of a message would compile them anew."""
    package = Path(navbake.__file__).parent
    kernel_files = sorted(package.rglob("*_kernels.py"))
    assert kernel_files
    for path in kernel_files:
        module = ".".join(path.relative_to(package.parent).with_suffix("").parts)
        needed = read_sources(module)
        assert len(needed) <= 20 and "navbake.config.settings" not in needed, module
