"""Bakes start anywhere: after a fork, from threads, in new processes, and warm after warm-up."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import navbake
from navbake.compiled import read_kernel_list

ROOT = Path(__file__).parents[1]
SCENE = """<mujoco model="stool">
<worldbody>
  <geom type="box" size="2 2 .1" pos="0 0 -.1"/>
  <geom type="box" size=".2 .2 .5" pos=".5 .5 .5"/>
</worldbody></mujoco>"""


IN_PROCESSES = """
import multiprocessing, sys
from test_starts import bake_and_voxelize

if __name__ == "__main__":
    scene, method = sys.argv[1:]
    expected = bake_and_voxelize(scene)
    with multiprocessing.get_context(method).Pool(4) as pool:
        assert pool.map_async(bake_and_voxelize, [scene] * 8).get(240) == [expected] * 8
"""

FORKED_MIDWAY = """
import os, signal, sys, threading
import numpy as np
import navbake
from navbake.baker.bake.pipeline import run_bake
from navbake.config.settings import as_config
from navbake.errors import NavbakeError
from navbake.threads import run_beside, run_in_chunks
from test_starts import bake_and_voxelize

def fork_and(do):
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    signal.alarm(60)  # ends a child that waits for ever
    try:
        do()
    except NavbakeError as error:
        print(error, flush=True)
        os._exit(1)
    os._exit(0)

scene = sys.argv[1]
config = as_config({"scene": {"path": scene}})
baker = navbake.Baker(scene)
voxelizer = navbake.Voxelizer(scene)
expected = bake_and_voxelize(scene)
is_baking = threading.Event()
go_on = threading.Event()

def wait(stage, share):
    is_baking.set()
    go_on.wait()

thread = threading.Thread(target=run_bake, args=(config,), kwargs={"progress": wait})
thread.start()
is_baking.wait()
for do in (
    lambda: navbake.bake(scene),
    lambda: navbake.Baker(scene),
    lambda: baker.update(),
    lambda: navbake.Voxelizer(scene),
    lambda: run_beside(len, ""),
    lambda: run_in_chunks(np.zeros, 10_000),
):
    assert fork_and(do) == 1
# what needs no lock still works
assert fork_and(lambda: baker.grid.inflate(0.2)) == 0
go_on.set()
thread.join()
assert bake_and_voxelize(scene) == expected
assert fork_and(lambda: os._exit(bake_and_voxelize(scene) != expected)) == 0

def fork_in_bake(stage, share):
    # the thread that bakes is in the new process, too
    if (stage, share) == ("grid", 0):
        assert fork_and(lambda: os._exit(bake_and_voxelize(scene) != expected)) == 0
        print("forked in a bake", flush=True)

run_bake(config, progress=fork_in_bake)
"""


def bake_and_voxelize(path: str) -> str:
    """A digest of a scene's grid and of its voxels."""
    grid = navbake.bake({"scene": {"path": path}})
    voxels = navbake.Voxelizer(path).create(res=0.1, align=True)
    voxels.save(f"{path}.{os.getpid()}-{id(voxels)}.bt")  # by parallel kernels, too
    data = grid.levels[0].occupancy.tobytes() + voxels.values.tobytes()
    return hashlib.sha256(data).hexdigest()


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "stool.xml"
    path.write_text(SCENE)
    return str(path)


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_bakes_in_processes_after_a_bake(scene, method, tmp_path):
    """In a process of its own: with the threads of libraries that other tests load, forks hang."""
    script = tmp_path / "in_processes.py"
    script.write_text(IN_PROCESSES)
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    subprocess.run(
        [sys.executable, script, scene, method],
        env={**os.environ, "PYTHONPATH": path},
        check=True,
        timeout=300,
    )


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_process_forked_while_another_thread_bakes_says_so(scene):
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FORKED_MIDWAY, scene],
        env={**os.environ, "PYTHONPATH": path, "NUMBA_NUM_THREADS": "2"},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        timeout=300,
    )
    *errors, last = run.stdout.splitlines()
    assert last == "forked in a bake"
    assert len(errors) == 6
    assert set(errors) == {
        "this process was forked while another thread was baking, so it can't bake: start "
        'processes by multiprocessing.get_context("spawn"), or fork before another thread bakes'
    }


def test_bakes_in_threads(scene):
    expected = bake_and_voxelize(scene)
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(bake_and_voxelize, [scene] * 12)) == [expected] * 12


def read_me() -> tuple[list[list[str]], str]:
    """The README's commands for a sample, and its Python."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```(sh|python)\n(.*?)```", text, re.DOTALL)
    shell = "\n".join(block for kind, block in blocks if kind == "sh")
    commands = [
        shlex.split(line, comments=True)[1:]
        for line in shell.splitlines()
        if line.startswith("navbake ") and "warm-up" not in line and "completion" not in line
    ]
    assert len(commands) >= 8
    return commands, "".join(block for kind, block in blocks if kind == "python")


@pytest.fixture
def empty_folder(tmp_path):
    folder = tmp_path / "empty"
    folder.mkdir()
    return folder


def use_read_me() -> str:
    """Code that runs the README, and prints how many types each kernel was called with."""
    commands, python = read_me()
    return f"""
import json
from navbake.cli.main import main
for command in {commands!r}:
    try:
        main(command)
    except SystemExit as end:
        assert not end.code, command
exec({python!r})
from navbake.compiled import KERNELS
warm = [k for k in KERNELS if not k.stats.cache_misses]
print('\\n' + json.dumps({{f'{{k.__module__}}.{{k.__name__}}': len(k.signatures) for k in warm}}))
"""


def test_the_read_me_runs_in_an_empty_folder_and_compiles_nothing_after_warm_up(empty_folder):
    """What the README's commands call, with the types that they call it with, is in the list.

    What this run compiles is left out: the kernels that a kernel calls are compiled with it.
    """
    pytest.importorskip("matplotlib")
    run = subprocess.run(
        [sys.executable, "-c", use_read_me()],
        cwd=empty_folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout[-3000:]
    # a grid is verified with the settings of its bake
    assert "settings are others" not in run.stdout
    names = {command[0] for command in read_me()[0]}
    assert names >= {"samples", "init", "geoms", "bake", "info", "rooms", "why", "path", "plot"}
    assert "verify" in names
    assert (empty_folder / "apartment.png").stat().st_size > 10_000
    used = {name: n for name, n in json.loads(run.stdout.splitlines()[-1]).items() if n}
    names = [f"navbake.{entry.name}" for entry in [*read_kernel_list()[0], *read_kernel_list()[1]]]
    assert len(used) > 20
    assert [name for name, n in used.items() if names.count(name) < n] == []


AGAIN = """
import numba.core.compiler as compiler
import navbake

def refuse(context, target, function, *rest, **options):
    raise AssertionError(f"{function} is compiled in each process")

compiler.compile_extra = refuse
navbake.bake("configs/apartment.yaml")
"""


@pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
def test_a_bake_compiles_nothing_that_was_compiled_before():
    """As would a helper of kernels without a cache that Python calls: it costs 0.3 s each time."""
    navbake.bake(ROOT / "configs" / "apartment.yaml")
    subprocess.run([sys.executable, "-W", "ignore", "-c", AGAIN], cwd=ROOT, check=True)


@pytest.mark.skipif("NAVBAKE_EXAMPLES" not in os.environ, reason="it compiles all for minutes")
def test_the_read_me_runs_where_nothing_can_be_written(empty_folder, tmp_path):
    pytest.importorskip("matplotlib")
    site = tmp_path / "site"
    shutil.copytree(
        ROOT / "navbake", site / "navbake", ignore=shutil.ignore_patterns("__pycache__")
    )
    shutil.copytree(ROOT / "configs", site / "navbake" / "sample_files")  # as a wheel has them
    (site / "navbake" / "__pycache__").write_text("")  # a file, so that no folder can be made there
    place = str(tmp_path / "file")
    Path(place).write_text("")
    env = {"NUMBA_CACHE_DIR": place, "HOME": place, "XDG_CACHE_HOME": place}
    run = subprocess.run(
        [sys.executable, "-B", "-c", use_read_me()],
        cwd=empty_folder,
        env={**os.environ, "PYTHONPATH": str(site), **env},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
    assert "compiling in memory" in run.stderr
    assert "set NUMBA_CACHE_DIR" in run.stderr
