"""Loads compiled kernels from disk without what only the compiler needs.

numba gets ready to compile whenever it loads: it imports and registers all functions that it can
compile, and scipy's linear algebra, and reads each kernel's bitcode beside its machine code. That
takes longer than all else. Machine code needs none of it, so it waits for the first kernel that is
compiled: then numba's compiler registers its functions itself, and a kernel's bitcode is read when
it is linked into another.

Source: `FunctionCache.load_overload` and `CPUCodeLibrary._unserialize` of numba 0.68. With other
versions, kernels are loaded as numba does it, which is slower.
"""

# numba has few types
# mypy: disable-error-code="attr-defined,no-untyped-call,misc"

from __future__ import annotations

import importlib
from functools import cache
from typing import Any

import numba
from llvmlite import binding
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompileResult
from numba.core.runtime import rtsys
from numba.np import linalg

MADE_FOR = "0.68."


def loads_light() -> bool:
    """Whether this numba is one that this module was made for."""
    return str(numba.__version__).startswith(MADE_FOR)


class LoadedLibrary(JITCodeLibrary):
    """Machine code that was loaded, and bitcode that is read when it is asked for."""

    @classmethod
    def _unserialize(cls, codegen: Any, state: tuple[str, str, Any]) -> Any:
        name, kind, data = state
        if kind != "object":
            return super()._unserialize(codegen, state)
        library = cls(codegen, name)
        machine_code, library._bitcode = data
        library.enable_object_caching()
        library._set_compiled_object(machine_code)
        library._finalize_final_module()
        return library

    def get_pointer_to_function(self, name: str) -> int:
        """The address of a function that the machine code defines."""
        address: int = self._codegen._engine.get_function_address(name)
        return address

    def _get_module_for_linking(self) -> Any:
        if self._shared_module is None:
            self._shared_module = binding.parse_bitcode(self._bitcode)
            self._codegen._engine._load_defined_symbols(self._shared_module)
        return self._shared_module


@cache
def skip_probe() -> None:
    """Import numba's functions of arrays without scipy's linear algebra.

    Kernels name the module that a function of numpy's comes from. It imports BLAS only to know
    whether it is there. Whoever compiles a function that calls BLAS still loads it.
    """
    probe = linalg.ensure_blas
    linalg.ensure_blas = lambda: None  # scipy is there: navbake depends on it
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        linalg.ensure_blas = probe


def rebuild(target_context: Any, payload: tuple[Any, ...]) -> Any:
    """Make a compiled kernel of what `CompileResult._reduce` returned."""
    rtsys.initialize(target_context)  # what allocates arrays
    codegen = target_context.codegen()
    codegen._library_class = LoadedLibrary  # over its class's; numba's lock is held
    try:
        return CompileResult._rebuild(target_context, *payload)
    finally:
        del codegen._library_class
