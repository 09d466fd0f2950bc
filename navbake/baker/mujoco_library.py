"""Makes MuJoCo's functions known to compiled code."""

from functools import cache
from pathlib import Path

import mujoco
from llvmlite import binding

from navbake.errors import SceneError


@cache
def mujoco_library() -> str:
    """Path of MuJoCo's shared library, whose rays the kernels call."""
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll"):
        for path in sorted(folder.glob(pattern)):
            return str(path)
    raise SceneError(f"MuJoCo's shared library is not in {folder}: reinstall mujoco")


@cache
def load_mujoco_library() -> None:
    """Let compiled code find MuJoCo's functions.

    Whatever compiles or loads a kernel that calls one has to do this before: LLVM ends a process
    that asks for a function in vain.
    """
    binding.load_library_permanently(mujoco_library())
