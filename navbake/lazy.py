"""Imports libraries, and functions of higher modules, when they are first used.

A module names such a library at its top, beside its other imports: ``trimesh = lazy("trimesh")``.
The library is imported when an attribute of it is first read. `tests/test_imports.py` counts the
call as an import, and lists what each command may load.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any


class lazy:
    """A module that is imported when an attribute of it is first read.

    Args:
        name: The full name of the module.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        module_member = getattr(import_module(self._name), attribute)
        setattr(self, attribute, module_member)  # from now on it is read without this function
        return module_member


def resolve(where: str) -> Any:
    """Import an object of a module, and return it.

    Args:
        where: The module and the object's name, as ``module:name``.
    """
    module, _, name = where.partition(":")
    return getattr(import_module(module), name)
