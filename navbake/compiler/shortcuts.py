"""Shortcuts through numba's compiler, for kernels of navbake.

They leave out work whose result nobody uses, so that the code that comes out does the same:

- Machine code is made of what Python calls, and not of what is only linked into that.
- LLVM's passes over functions are made ready once for a module.
- Some of numba's functions are done with less work, see `navbake.compiler.replaced`.
- Python looks for garbage seldom: a compiler makes much, and little of it are circles.

Source: `CPUCodeLibrary` of numba 0.68. With other versions, kernels are compiled as numba does it,
which is slower.
"""

# numba has few types
# mypy: disable-error-code="attr-defined,no-untyped-call,misc"

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import environment
from numba.core.codegen import JITCodeLibrary

from navbake.compiler.garbage import BETWEEN_COLLECTIONS


class LeanLibrary(JITCodeLibrary):
    """Code of a function and of all that it calls; machine code is made when Python calls it."""

    _is_generated = False

    def _optimize_functions(self, module: Any) -> None:
        # with one manager of passes, and not one for each function that is only declared, too
        module.data_layout = self._codegen._data_layout
        passes, builder = self._codegen._function_pass_manager()
        for function in module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def _generate(self) -> None:
        if self._is_generated:
            return
        self._is_generated = True
        self._dynamic_globals.clear()  # found once more
        super()._finalize_final_module()
        for variable in self._final_module.global_variables:
            found = environment.lookup_environment(variable.name)
            if found is not None:
                self._codegen.set_env(variable.name, found)

    @property
    def codegen(self) -> Any:
        """What keeps the environments of machine code."""
        return self._codegen if self._is_generated else NoMachineCode(self._codegen)

    def get_pointer_to_function(self, name: str) -> int:
        """The address of a function; 0 if the library doesn't define it."""
        self._ensure_finalized()
        try:
            is_defined = not self._final_module.get_function(name).is_declaration
        except NameError:
            is_defined = False
        if not is_defined:
            return 0
        self._generate()
        return int(super().get_pointer_to_function(name))

    def serialize_using_object_code(self) -> tuple[str, str, Any]:
        """What is kept on disk: of what is only linked into other code, no machine code."""
        if self._is_generated:
            return super().serialize_using_object_code()  # type: ignore[no-any-return]
        return self.name, "bitcode", self._get_module_for_linking().as_bitcode()


class NoMachineCode:
    """Stands for what keeps the environments of machine code, for a library that has none."""

    def __init__(self, codegen: Any) -> None:
        self._codegen = codegen

    def __getattr__(self, name: str) -> Any:
        return getattr(self._codegen, name)

    def set_env(self, name: str, found: Any) -> None:
        """Do nothing: whoever makes the machine code does it."""


@contextmanager
def library_class(codegen: Any, cls: type[JITCodeLibrary]) -> Iterator[None]:
    """Make libraries of a class of one's own inside; numba's lock is held."""
    before = vars(codegen).get("_library_class")
    codegen._library_class = cls  # over its class's
    try:
        yield
    finally:
        if before is None:
            del codegen._library_class
        else:
            codegen._library_class = before


@contextmanager
def shortcuts(codegen: Any) -> Iterator[None]:
    """Compile by shortcuts inside; numba's lock is held.

    Args:
        codegen: the `JITCPUCodegen` whose libraries are lean.
    """
    if "_library_class" in vars(codegen):  # a kernel that the kernel calls
        yield
        return
    from navbake.compiler.replaced import REPLACED  # more of numba, which loading doesn't need

    threshold = gc.get_threshold()
    before = [getattr(owner, name) for owner, name, _ in REPLACED]
    try:
        if threshold[0] > 0:  # else Python never looks
            gc.set_threshold(max(threshold[0], BETWEEN_COLLECTIONS), *threshold[1:])
        for owner, name, function in REPLACED:
            setattr(owner, name, function)
        with library_class(codegen, LeanLibrary):
            yield
    finally:
        for (owner, name, _), function in zip(REPLACED, before, strict=True):
            setattr(owner, name, function)
        gc.set_threshold(*threshold)
