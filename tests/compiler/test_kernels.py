"""What takes long to compile is not in the kernels."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from numba import njit

from navbake.baker.kernels import rays
from navbake.baker.scene.model import mujoco_library
from navbake.kernel_list import PREFIX, decode, read_list

# numba's function that tells shapes that differ; it needs those that make text
ERROR = "raise_with_shape_context"


def uses_text(library) -> bool:
    module = getattr(library, "_get_module_for_linking")()  # noqa: B009 - numba's own name
    return any(ERROR in function.name for function in module.functions)


@pytest.mark.parametrize(
    "name",
    [
        "baker.kernels.tiles.list_near",
        "baker.kernels.rays.cast_points_at",
        "navgrid.kernels.connect.list_touching",
        "runtime.kernels.routes.find_route",
        "runtime.kernels.lines.lay_route",
    ],
)
def test_no_array_is_assigned_to_a_slice(name):
    rays.load_mujoco_library(mujoco_library())  # LLVM ends a process that lacks what rays call
    found = read_list()
    entry = next(entry for entry in found.entries if entry.name == name)
    module, _, function = f"{PREFIX}{name}".rpartition(".")
    kernel = getattr(importlib.import_module(module), function)
    signature = tuple(decode(of, found.tuples) for of in entry.types)
    kernel.compile(signature)
    assert not uses_text(kernel.overloads[signature].library)


def test_slices_need_text():
    @njit
    def copy(source, target):
        target[: source.shape[0]] = source

    copy(np.zeros(2), np.zeros(3))
    assert uses_text(copy.overloads[copy.signatures[0]].library)
