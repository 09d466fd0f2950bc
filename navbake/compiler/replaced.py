"""Functions of numba's compiler, done with less work.

Each takes the place of one of numba's while navbake's kernels are compiled, see
`navbake.compiler.shortcuts`, and gives the same answer or leaves out what nobody reads:

- What is inlined into a kernel's source is not copied first, twice: it was made for this call.
- Which variables a statement has, and which options a function, is found out with fewer calls.
- Sizes of types and loops of ufuncs are kept, as they are asked for again and again.
- Which variables live where is worked out when somebody asks; only generators do so always.
- Nobody is told when a pass or a call of LLVM begins and ends, and no error message is coloured:
  numba makes hundreds for each kernel as it tries what a function may mean, and shows none.
- Functions get no wrapper for ctypes, and kernels on disk no listing of their types.

Source: the functions named in `REPLACED`, of numba 0.68.
"""

# numba has few types
# mypy: disable-error-code="attr-defined,no-untyped-call,misc"

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

from numba.core import errors, event, inline_closurecall, ir, transforms
from numba.core.annotations.type_annotations import TypeAnnotation
from numba.core.base import BaseContext
from numba.core.inline_closurecall import InlineWorker
from numba.core.lowering import Lower
from numba.core.postproc import PostProcessor, VariableLifetime
from numba.core.targetconfig import TargetConfig
from numba.core.typing import npydecl

NO_COPIES = SimpleNamespace(deepcopy=lambda block: block)
HOLDERS = (ir.Var, ir.Inst, list, tuple, dict)  # in the order in which numba asks

_numbas_post_process = PostProcessor.run
_numbas_matching_loop = npydecl.ufunc_find_matching_loop


def _inline_function(
    worker: Any, caller: Any, block: Any, i: int, function: Any, types: Any = None
) -> Any:
    """`InlineWorker.inline_function` without copies."""
    callee = worker.run_untyped_passes(function)
    copy = inline_closurecall.copy
    inline_closurecall.copy = NO_COPIES  # type: ignore[assignment]
    try:
        free = function.__code__.co_freevars
        return worker.inline_ir(caller, block, i, callee, free, arg_typs=types)
    finally:
        inline_closurecall.copy = copy


@cache
def _defaults(config: type[TargetConfig]) -> dict[str, Any]:
    return {name: option.default for name, option in config.options.items()}


def _values(config: TargetConfig) -> dict[str, Any]:
    """`TargetConfig.values`, which compares options thousands of times."""
    return {**_defaults(type(config)), **config._values}


@cache
def _kind_of(cls: type) -> type | None:
    """What a field of a statement is that may hold variables; None for what can't."""
    return next((kind for kind in HOLDERS if issubclass(cls, kind)), None)


def _list_vars(statement: ir.Inst, value: Any) -> list[ir.Var]:
    """`Inst._rec_list_vars`: the variables in a field of a statement."""
    kind = _kind_of(type(value))  # type: ignore[arg-type]
    if kind is None:
        return []
    if kind is ir.Var:
        return [value]
    if kind is ir.Inst:
        return list(value.list_vars())
    found: list[ir.Var] = []
    for each in value.values() if kind is dict else value:
        found += _list_vars(statement, each)
    return found


def _post_process(processor: Any, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:
    """`PostProcessor.run` without which variables live where blocks begin."""
    function = processor.func_ir
    if function.is_generator:
        _numbas_post_process(processor, emit_dels, extend_lifetimes)
        return
    function.blocks = transforms.canonicalize_cfg(function.blocks)
    function.variable_lifetime = VariableLifetime(function.blocks)
    function.generator_info = None
    if emit_dels:
        processor._insert_var_dels(extend_lifetimes=extend_lifetimes)


@cache
def _size_of(target_data: Any, of: Any) -> int:
    return int(of.get_abi_size(target_data))


def _get_size(context: Any, of: Any) -> int:
    """`BaseContext.get_abi_sizeof`, which makes LLVM parse a module."""
    return _size_of(context.target_data, of)


@cache
def _kept_loop(ufunc: Any, types: tuple[Any, ...]) -> Any:
    return _numbas_matching_loop(ufunc, types)


def _matching_loop(ufunc: Any, types: Any) -> Any:
    """`ufunc_find_matching_loop`: typing asks for it at each operator."""
    return _kept_loop(ufunc, tuple(types))


def _tell_nobody(kind: str, data: Any = None, exc_details: Any = None) -> None:
    """`start_event` and `end_event`."""


def _leave_plain(scheme: Any, message: str, *how: Any, **more: Any) -> str:
    """`HighlightColorScheme._markup`, which looks at the terminal each time."""
    return message


def _no_wrapper(lower: Any) -> None:
    """`Lower.create_cfunc_wrapper`: only ctypes calls what it makes."""


def _no_listing(annotation: Any) -> str:
    """`TypeAnnotation.__str__`, which is kept with a kernel for who inspects its types."""
    return ""


# What is put in place of what while navbake's kernels are compiled
REPLACED: tuple[tuple[Any, str, Any], ...] = (
    (InlineWorker, "inline_function", _inline_function),
    (TargetConfig, "values", _values),
    (ir.Inst, "_rec_list_vars", _list_vars),
    (PostProcessor, "run", _post_process),
    (BaseContext, "get_abi_sizeof", _get_size),
    (npydecl, "ufunc_find_matching_loop", _matching_loop),
    (event, "start_event", _tell_nobody),
    (event, "end_event", _tell_nobody),
    (Lower, "create_cfunc_wrapper", _no_wrapper),
    (TypeAnnotation, "__str__", _no_listing),
)
if hasattr(errors, "HighlightColorScheme"):  # else colorama is missing, and nothing is coloured
    REPLACED += ((errors.HighlightColorScheme, "_markup", _leave_plain),)
