"""Compile a scene in a child process, with limits of time and memory.

A crash of MuJoCo's compiler ends its process, and Python can't stop it while it is busy. In a child
process both become errors. The model comes back as a file (MJB).
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import mujoco

from navbake.baker.scene.mesh_scene import MeshPart
from navbake.baker.scene.model import OpenScene, ground_of, load_model
from navbake.baker.scene.specs import catch_warnings
from navbake.config.settings import SceneSettings
from navbake.errors import NavbakeError, SceneError
from navbake.files import scratch_folder
from navbake.processes import end_with_parent, ending_of, lacked_memory, limit_memory

# The child gets this process's module path first of all: with -c, Python would look in the current
# folder, which is as little to be trusted as the scene.
CHILD = (
    "import sys; sys.path[:] = {path!r}; "
    "from navbake.baker.scene.isolated import compile_job; compile_job(sys.argv[1])"
)
IMPORT_SECONDS = 120.0  # what the child may take besides, to start and to end, on a busy machine
ALARM = int(getattr(signal, "SIGALRM", 14))
JOB, MODEL, RESULT = "job.pickle", "model.mjb", "result.pickle"
STARTED = "started"  # what the child writes when it begins to compile


class CompileLimits(NamedTuple):
    """What MuJoCo may take to compile a scene; memory is limited on Linux only."""

    seconds: float = 60.0
    memory: float = 4.0  # that it may reserve beyond what the process starts with [GiB]


def load_isolated(settings: SceneSettings, limits: CompileLimits, warnings: list[str]) -> OpenScene:
    """`load_model` in a child process."""
    scene = Path(settings.path)
    with scratch_folder() as place:
        (place / JOB).write_bytes(pickle.dumps((settings, limits)))
        path = [entry or os.getcwd() for entry in sys.path]
        command = [sys.executable, "-c", CHILD.format(path=path), str(place)]
        streams: Any = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
        longest = limits.seconds + IMPORT_SECONDS  # the child ends itself, but on Windows
        try:
            status = subprocess.run(command, **streams, timeout=longest).returncode
        except subprocess.TimeoutExpired:
            status = -ALARM
        if status == -ALARM:
            raise SceneError(
                f"MuJoCo did not compile {scene} within {limits.seconds:g} s: make the scene "
                "smaller, or give it more time"
            )
        if not (place / STARTED).exists():
            raise NavbakeError(
                f"cannot start a process to compile {scene} in ({ending_of(status)}): does "
                f"{sys.executable!r} find navbake?"
            )
        if not (place / RESULT).exists():
            raise SceneError(
                f"MuJoCo crashed as it compiled {scene} ({ending_of(status)}): the scene asks for "
                f"too much, or for more than {limits.memory:g} GiB of memory, or is broken"
            )
        warned, error, parts = pickle.loads((place / RESULT).read_bytes())
        warnings += warned
        if error is not None:
            raise error
        model = mujoco.MjModel.from_binary_path(str(place / MODEL))
    return OpenScene(model, parts, ground_of(model, settings), warnings)


def compile_job(folder: str) -> None:
    """Compile the scene of a job, in the child, and write the model or the error."""
    place = Path(folder)
    settings, limits = pickle.loads((place / JOB).read_bytes())
    limit_memory(limits.memory)
    end_with_parent()
    (place / STARTED).touch()
    if hasattr(signal, "setitimer"):  # whose signal ends this process, whatever MuJoCo does
        signal.setitimer(signal.ITIMER_REAL, limits.seconds)
    failed: Exception | None = None
    parts: dict[int, MeshPart] = {}
    with catch_warnings() as warned:
        try:
            model, parts, *_ = load_model(settings, warned)
            mujoco.mj_saveModel(model, str(place / MODEL), None)
        except Exception as error:
            if not lacked_memory(error) and not isinstance(error, NavbakeError):
                raise
            lacks = f"{settings.path} needs more than {limits.memory:g} GiB of memory"
            failed = SceneError(lacks) if lacked_memory(error) else error
    (place / RESULT).write_bytes(pickle.dumps((warned, failed, parts)))
