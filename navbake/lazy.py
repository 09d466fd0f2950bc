"""Imports libraries, and functions of higher modules, when they are first used.

A module names such a library at its top, beside its other imports: ``trimesh = lazy("trimesh")``.
The library is imported when an attribute of it is first read. `tests/test_imports.py` counts the
call as an import, and lists what each command may load.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from types import MethodType
from typing import Any, Generic, TypeVar

Result = TypeVar("Result")


class lazy:
    """A module that is imported when an attribute of it is first read.

    Args:
        name: The full name of the module.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        value = getattr(import_module(self._name), attribute)
        setattr(self, attribute, value)  # from now on it is read without this function
        return value


def resolve(where: str) -> Any:
    """Import the object ``name`` of a module, given as ``module:name``."""
    module, _, name = where.partition(":")
    return getattr(import_module(module), name)


class Method(Generic[Result]):
    """A function at ``module:name`` that takes the object first, as a method of its class."""

    def __init__(self, where: str) -> None:
        self.where = where

    def __get__(self, instance: object, owner: type | None = None) -> Callable[..., Result]:
        function: Callable[..., Result] = resolve(self.where)
        return function if instance is None else MethodType(function, instance)
