"""Loads compiled kernels from disk without what only the compiler needs.

numba gets ready to compile whenever it loads: it imports and registers all functions that it can
compile, and scipy's linear algebra, compiles its runtime, and reads each kernel's bitcode beside
its machine code. That takes longer than all else. Machine code needs none of it, so it waits for
the first kernel that is compiled: then numba's compiler gets ready itself, and a kernel's bitcode
is read when it is linked into another.

Source: `FunctionCache.load_overload`, `CPUCodeLibrary._unserialize`, `_Runtime.initialize` and
`Environment` of numba 0.68. With other versions, kernels are loaded as numba does it, which is
slower.
"""

# numba has few types
# mypy: disable-error-code="attr-defined,call-arg,no-untyped-call,misc"

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numba
from llvmlite import binding
from numba.core import environment
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompileResult
from numba.core.runtime import _nrt_python

from navbake.compiler.shortcuts import NoMachineCode, library_class

MADE_FOR = "0.68."


def loads_light() -> bool:
    """Whether this numba is one that this module was made for."""
    return str(numba.__version__).startswith(MADE_FOR)


class LoadedLibrary(JITCodeLibrary):
    """Machine code that was loaded, and bitcode that is read when it is asked for."""

    @classmethod
    def _unserialize(cls, codegen: Any, state: tuple[str, str, Any]) -> Any:
        name, kind, data = state
        library = cls(codegen, name)
        library._has_machine_code = kind == "object"
        if library._has_machine_code:
            machine_code, library._bitcode = data
            engine = codegen._engine._ee
            engine.add_object_file(binding.object_file.ObjectFileRef.from_data(machine_code))
            engine.finalize_object()
        else:  # only other kernels call it, see `LeanLibrary`
            library._bitcode = data
        library._finalized = True
        return library

    @property
    def codegen(self) -> Any:
        """What keeps the environments of machine code."""
        return self._codegen if self._has_machine_code else NoMachineCode(self._codegen)

    def get_pointer_to_function(self, name: str) -> int:
        """The address of a function that the machine code defines; 0 if there is none."""
        if not self._has_machine_code:
            return 0
        address: int = self._codegen._engine.get_function_address(name)
        return address

    def _get_module_for_linking(self) -> Any:
        if self._shared_module is None:
            self._shared_module = binding.parse_bitcode(self._bitcode)
            self._codegen._engine._load_defined_symbols(self._shared_module)
        return self._shared_module


@contextmanager
def few_environments() -> Iterator[None]:
    """Read kernels without the environments that numba keeps for each function inlined into them.

    An environment holds the constants that are no numbers: what an error says, for instance. Most
    have none, and no code reads those. Making them imports the modules of all these functions.
    """
    make = environment._rebuild_env
    environment._rebuild_env = _make_environment
    try:
        yield
    finally:
        environment._rebuild_env = make


def _make_environment(module: str, constants: list[Any], name: str) -> Any:
    found = environment.lookup_environment(name)
    if found is not None:
        return found
    loaded = sys.modules.get(module)
    found = environment.Environment(vars(loaded) if loaded else {"__name__": module})
    found.consts[:] = constants
    found.env_name = name
    environment.Environment._memo[name] = found
    return found


@cache
def _name_runtime() -> None:
    """Tell LLVM where the functions are that allocate arrays."""
    for name, address in _nrt_python.c_helpers.items():
        binding.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


def rebuild(target_context: Any, payload: tuple[Any, ...]) -> Any:
    """Make a compiled kernel of what `CompileResult._reduce` returned."""
    _name_runtime()
    codegen = target_context.codegen()
    *most, referenced = payload
    with library_class(codegen, LoadedLibrary):
        used = tuple(each for each in referenced if len(each.consts))
        return CompileResult._rebuild(target_context, *most, used)
