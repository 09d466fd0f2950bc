"""Libraries that load slowly and that not every command needs: each is loaded at its first use.

A module names such a library at its top, where its other imports stand:
``trimesh = lazy("trimesh")``. So imports stay in one place, and nothing is loaded until a function
asks the name for something. `tests/test_imports.py` counts the call as an import, and lists what
each command may load.
"""

from importlib import import_module
from typing import Any


class LazyModule:
    """Stands for a module, which is imported when something of it is first asked for."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        value = getattr(import_module(self._name), attribute)
        setattr(self, attribute, value)  # found without this function from now on
        return value


def lazy(name: str) -> Any:
    """A module by its full name, loaded when something of it is first used."""
    return LazyModule(name)
