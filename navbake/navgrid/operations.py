"""Methods of grids whose functions live in modules above the grid.

A grid has methods like `inflate`, `block` and `save` for convenience, and the run time, the views
and the formats import the grid. So the grid may not import them: it names the function, which is
imported when the method is first looked at. Signature and docstring are the function's.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from types import MethodType
from typing import Any, Generic, TypeVar

Result = TypeVar("Result")


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
