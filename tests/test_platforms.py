"""navbake's modules load, and bake, without what Windows and macOS lack.

The libraries are imported first, as they are built for this system. Then the names that another
system lacks are taken away, and only navbake's own code meets that.
"""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from project_paths import ROOT

POSIX_MODULES = ("fcntl", "grp", "pwd", "resource", "termios")
POSIX_NAMES = {
    "os": "fork getuid geteuid killpg mkfifo nice setsid sysconf O_NOFOLLOW O_NONBLOCK O_DIRECTORY "
    "register_at_fork sched_getaffinity statvfs wait4",
    "signal": "SIGKILL SIGHUP SIGALRM SIGPIPE SIGTSTP SIGUSR1 alarm pthread_sigmask setitimer",
}
TAKE_AWAY = """
import importlib, os, pkgutil, signal, sys, urllib.request, xml.sax.saxutils
import filelock, fsspec, matplotlib.pyplot, mujoco, msgspec, numba, numpy, orjson, pebble, PIL.Image
import pyarrow, pydantic, rich.progress, scipy.ndimage, scipy.spatial, trimesh, typer, viser
sys.platform = {platform!r}
if {platform!r} == "win32":
    for name in {modules!r}:
        sys.modules[name] = None
    for module, names in {names!r}.items():
        for name in names.split():
            if hasattr(sys.modules[module], name):
                delattr(sys.modules[module], name)
"""
LOAD_ALL = """
import navbake
for found in pkgutil.walk_packages(navbake.__path__, "navbake."):
    if not found.name.endswith("__main__"):
        importlib.import_module(found.name)
"""
BAKE = """
scene = '''<mujoco><worldbody><geom type="box" size="2 2 .1" pos="0 0 -.1"/>
<geom type="box" size=".1 2 1" pos="0 1 1"/></worldbody></mujoco>'''
grid = navbake.bake(mujoco.MjModel.from_xml_string(scene))
grid.save(sys.argv[1])
path = navbake.PathFinder(navbake.load(sys.argv[1]).inflate(0.2)).find_path((-1, 1), (1, 1))
assert path.length > 2.5, path
"""


@pytest.mark.parametrize("platform", ["win32", "darwin"])
def test_modules_load_and_bake(platform, tmp_path):
    take_away = TAKE_AWAY.format(platform=platform, modules=POSIX_MODULES, names=POSIX_NAMES)
    code = take_away + LOAD_ALL + BAKE
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "room.grid.json")],
        cwd=ROOT, capture_output=True, text=True, check=False,
        env={**os.environ, "MPLBACKEND": "agg", "MUJOCO_GL": "disable"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
