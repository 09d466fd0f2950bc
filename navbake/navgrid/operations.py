"""Operations of grids that live in modules above the grid, found by name.

A grid has methods like `inflate`, `block` and `save` for convenience, and the run time, the views
and the formats import the grid. So the grid may not import them. It calls them by name instead:
`navbake/__init__.py` registers for each operation where its function is, and the function is
imported when it is first called.
"""

from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any

OPERATIONS: dict[str, str] = {}
"""Where the function of each operation is: ``module:function`` by ``grid.METHOD`` or
``voxels.METHOD``."""


def resolve(where: str) -> Any:
    """Import what stands at ``module:name``."""
    module, _, name = where.partition(":")
    return getattr(import_module(module), name)


@cache
def operation(name: str) -> Callable[..., Any]:
    """The function of an operation, which takes the object itself first."""
    found: Callable[..., Any] = resolve(OPERATIONS[name])
    return found
