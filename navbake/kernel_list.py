"""The list of kernels that Python calls, with the types that it calls them with.

numba compiles a kernel for the types of its first call's arguments, so nobody knows them before
that call, and one kernel after the other is compiled. With the list, processes of their own
compile what a command will need later on. `scripts/list_kernels.py` writes it; an entry that is
out of date costs time, and nothing else.
"""

# numba has no types
# mypy: disable-error-code="no-untyped-call,attr-defined"

from __future__ import annotations

import gc
import importlib
import json
import os
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

FILE = Path(__file__).with_name("kernels.json")
PREFIX = "navbake."
BETWEEN_COLLECTIONS = 200_000  # objects that are made, net, before Python looks for garbage
RAYS = "navbake.baker.kernels.rays"  # its kernels call MuJoCo


class Entry(NamedTuple):
    """A kernel and the types of its arguments, encoded.

    Attributes:
        name: its module and name, without the package's.
        seconds: what compiling it took where the list was made [s].
        types: of its arguments, see `encode`.
    """

    name: str
    seconds: float
    types: list[Any]

    @property
    def module(self) -> str:
        """The kernel's module."""
        return PREFIX + self.name.rpartition(".")[0]


class KernelList(NamedTuple):
    """All entries, in the order in which a bake and then the run time call the kernels.

    Attributes:
        entries: the kernels.
        tuples: named tuples by the names that the entries call them: class, types of fields.
    """

    entries: list[Entry]
    tuples: dict[str, list[Any]]


@cache
def read_list() -> KernelList:
    """Read the list; empty where there is none."""
    try:
        data = json.loads(FILE.read_text(encoding="utf-8"))
        return KernelList([Entry(*entry) for entry in data["kernels"]], data["tuples"])
    except (OSError, ValueError, TypeError, KeyError):
        return KernelList([], {})


def write_list(found: KernelList) -> None:
    """Write the list, a line for each tuple and kernel."""
    tuples = ",\n".join(f"{json.dumps(k)}: {json.dumps(v)}" for k, v in found.tuples.items())
    kernels = ",\n".join(json.dumps(list(entry)) for entry in found.entries)
    text = f'{{"tuples": {{\n{tuples}\n}},\n"kernels": [\n{kernels}\n]}}\n'
    FILE.write_text(text, encoding="utf-8")


def encode(of: Any, tuples: dict[str, list[Any]]) -> Any:
    """Write one of numba's types as JSON; named tuples are added to `tuples`.

    Raises:
        ValueError: no type that a kernel is called with from Python.
    """
    from numba import types  # the list is read without numba

    if isinstance(of, types.Array):
        access = "" if of.mutable else " readonly"
        return f"{of.dtype} {of.ndim} {of.layout}{access}"
    if isinstance(of, types.BaseNamedTuple):
        cls = of.instance_class
        value = [f"{cls.__module__}.{cls.__qualname__}", [encode(t, tuples) for t in of.types]]
        name = cls.__name__
        while tuples.setdefault(name, value) != value:  # the same class with other fields
            name += "'"
        return {"tuple": name}
    if isinstance(of, types.BaseTuple):
        return [encode(t, tuples) for t in of.types]
    if isinstance(of, types.Boolean | types.Integer | types.Float):
        return str(of)
    raise ValueError(f"expected numbers, arrays or tuples of them, got {of}")


def decode(value: Any, tuples: dict[str, list[Any]]) -> Any:
    """Make one of numba's types from what `encode` wrote."""
    from numba import types  # the list is read without numba

    if isinstance(value, dict):
        path, fields = tuples[value["tuple"]]
        module, _, name = path.rpartition(".")
        cls = getattr(importlib.import_module(module), name)
        return types.BaseTuple.from_types([decode(t, tuples) for t in fields], cls)
    if isinstance(value, list):
        return types.BaseTuple.from_types([decode(t, tuples) for t in value])
    dtype, *rest = value.split()
    scalar = types.boolean if dtype == "bool" else getattr(types, dtype)
    if not rest:
        return scalar
    return types.Array(scalar, int(rest[0]), rest[1], readonly="readonly" in rest)


def compile_listed(modules: Iterable[str], share: float, parent: int) -> None:
    """Compile the kernels of some modules that no other process has compiled or is compiling.

    It goes from the end of the list to its beginning, as whoever needs them comes from there.

    Args:
        modules: their names.
        share: where to begin, from 0, the end of the list, to 1.
        parent: the process that needs them; when it ends, this one does.
    """
    entries, tuples = read_list()
    wanted = set(modules)
    if RAYS in wanted:
        # LLVM ends a process that compiles a call of what it does not find
        library = importlib.import_module(f"{PREFIX}baker.scene.model").mujoco_library()
        importlib.import_module(RAYS).load_mujoco_library(library)
    left = [entry for entry in reversed(entries) if entry.module in wanted]
    begin = int(len(left) * share)
    for entry in left[begin:] + left[:begin]:
        if os.getppid() != parent:
            return
        try:
            kernel = getattr(importlib.import_module(entry.module), entry.name.rpartition(".")[2])
            kernel.compile_if_free(tuple(decode(t, tuples) for t in entry.types))
        except (
            Exception
        ):  # out of date: whoever needs the kernel compiles it and says what is wrong
            continue


def main() -> None:
    """Compile beside another process, see `navbake.dispatch`: the arguments are JSON."""
    gc.set_threshold(BETWEEN_COLLECTIONS, *gc.get_threshold()[1:])
    compile_listed(**json.loads(sys.argv[1]))
