"""The list of kernels that Python calls, with the types that it calls them with.

numba compiles a kernel for the types of its first call's arguments, so nobody knows them before
that call, and one kernel after the other is compiled. With the list, processes of their own
compile what a command will need later on. `scripts/list_kernels.py` writes it; an entry that is
out of date costs time, and nothing else.
"""

# numba has no types
# mypy: disable-error-code="no-untyped-call,attr-defined"

from __future__ import annotations

import importlib
import json
import os
import sys
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from navbake.compiler.garbage import collect_seldom

FILE = Path(__file__).with_name("kernels.json")
PREFIX = "navbake."
START = 2.0  # how long a process that helps takes until it compiles [s]
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
        num_common: how many entries, the first ones, the bake of a sample calls.
    """

    entries: list[Entry]
    tuples: dict[str, list[Any]]
    num_common: int = 0

    def cold(self, names: Iterable[str]) -> tuple[list[Entry], list[Entry]]:
        """The entries of some kernels: those that are needed soon, and the others.

        A bake needs few kernels but those that the bake of a sample calls; whoever calls none of
        these may need all.
        """
        wanted = set(names)
        common = [entry for entry in self.entries[: self.num_common] if entry.name in wanted]
        rest = [entry for entry in self.entries[self.num_common :] if entry.name in wanted]
        return (common, rest) if common else (rest, [])


@cache
def read_list() -> KernelList:
    """Read the list; empty where there is none."""
    try:
        data = json.loads(FILE.read_text(encoding="utf-8"))
        entries = [Entry(*entry) for entry in data["kernels"]]
        return KernelList(entries, data["tuples"], data.get("num_common", len(entries)))
    except (OSError, ValueError, TypeError, KeyError):
        return KernelList([], {})


def write_list(found: KernelList) -> None:
    """Write the list, a line for each tuple and kernel."""
    tuples = ",\n".join(f"{json.dumps(k)}: {json.dumps(v)}" for k, v in found.tuples.items())
    kernels = ",\n".join(json.dumps(list(entry)) for entry in found.entries)
    count = f'"num_common": {found.num_common}'
    text = f'{{"tuples": {{\n{tuples}\n}},\n{count},\n"kernels": [\n{kernels}\n]}}\n'
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


def plan(seconds: list[float], num_helpers: int) -> list[list[int]]:
    """Share kernels between the process that needs them, in their order, and some that help it.

    A helper takes the longest one that it has ready before it is needed, if all goes as the list
    says; so what is left in the end is short, and nobody waits long. The others are left to the
    process that needs them.

    Args:
        seconds: what each kernel takes, in the order in which they are needed.

    Returns:
        For each helper, which kernels it takes, in its order.
    """
    left = dict(enumerate(seconds))
    plans: list[list[int]] = [[] for _ in range(num_helpers)]
    busy = [START] * num_helpers
    while busy:
        helper = busy.index(min(busy))
        needed, longest = 0.0, None
        for number, cost in left.items():
            if needed >= busy[helper] + cost and (longest is None or cost >= left[longest]):
                longest = number
            needed += cost
        if longest is None:
            break
        plans[helper].append(longest)
        busy[helper] += left.pop(longest)
    return plans


def compile_listed(cold: Sequence[str], number: int, count: int, parent: int) -> None:
    """Compile kernels that no other process has compiled or is compiling.

    First those of the plan, then what is left, from the end of the list to its beginning, as
    whoever needs them comes from there.

    Args:
        cold: the names of the kernels, without the package's.
        number: which helper this is, of `count`.
        parent: the process that needs them; when it ends, this one does.
    """
    found = read_list()
    soon, rest = found.cold(cold)
    if any(PREFIX + name.rpartition(".")[0] == RAYS for name in cold):
        # LLVM ends a process that compiles a call of what it does not find
        library = importlib.import_module(f"{PREFIX}baker.scene.model").mujoco_library()
        importlib.import_module(RAYS).load_mujoco_library(library)
    planned = plan([entry.seconds for entry in soon], count)[number]
    for entry in [*(soon[i] for i in planned), *reversed(soon), *reversed(rest)]:
        if os.getppid() != parent:
            return
        try:
            kernel = getattr(importlib.import_module(entry.module), entry.name.rpartition(".")[2])
            kernel.compile_if_free(tuple(decode(t, found.tuples) for t in entry.types))
        except (
            Exception
        ):  # out of date: whoever needs the kernel compiles it and says what is wrong
            continue


def main() -> None:
    """Compile beside another process, see `navbake.dispatch`: the arguments are JSON."""
    collect_seldom()
    compile_listed(**json.loads(sys.argv[1]))
