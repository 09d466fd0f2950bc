"""Libraries and functions of modules above that are loaded at their first use.

A module names such a library at its top, where its other imports stand:
``trimesh = lazy("trimesh")``. So imports stay in one place, and nothing is loaded until a function
asks the name for something. `tests/test_imports.py` counts the call as an import, and lists what
each command may load.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from types import MethodType
from typing import Any, Generic, TypeVar

Result = TypeVar("Result")


class lazy:
    """A module by its full name, which is imported when something of it is first used."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        value = getattr(import_module(self._name), attribute)
        setattr(self, attribute, value)  # found without this function from now on
        return value


def resolve(where: str) -> Any:
    """Import what stands at ``module:name``."""
    module, _, name = where.partition(":")
    return getattr(import_module(module), name)


class Method(Generic[Result]):
    """A function at ``module:name`` that takes the object first, as a method of its class."""

    def __init__(self, where: str) -> None:
        self.where = where

    def __get__(self, instance: object, owner: type | None = None) -> Callable[..., Result]:
        function: Callable[..., Result] = resolve(self.where)
        return function if instance is None else MethodType(function, instance)
