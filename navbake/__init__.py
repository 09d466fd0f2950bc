"""Bakes MuJoCo scenes into navigation grids, and serves those grids to agents.

``navbake.bake(config)`` makes a grid, ``navbake.load(path)`` reads one. Importing navbake loads
none of its dependencies; each name below loads what it needs when it is first used.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from os import PathLike
from types import ModuleType
from typing import TYPE_CHECKING, Any

import navbake.bake as _bake_package
from navbake._version import __version__
from navbake.errors import (
    ConfigError,
    FormatError,
    MissingDependencyError,
    NavbakeError,
    QueryError,
    SceneError,
)

if TYPE_CHECKING:
    from navbake.config import BakeConfig
    from navbake.explored import ExploredMap
    from navbake.formats.navgrid import read_navgrid as load
    from navbake.grid import MultiLevelGrid, SceneGrid2D
    from navbake.runtime.path_finder import PathFinder
    from navbake.voxels.files import read_voxels as load_voxels
    from navbake.voxels.grid import VoxelGrid
    from navbake.voxels.voxelize import Voxelizer, create_voxel_grid

    def bake(
        config: BakeConfig | str | PathLike[str] | Mapping[str, Any],
        *,
        threads: int | None = None,
    ) -> SceneGrid2D | MultiLevelGrid:
        """See `_CallableBake.__call__`."""


__all__ = [
    "BakeConfig",
    "ConfigError",
    "ExploredMap",
    "FormatError",
    "MissingDependencyError",
    "MultiLevelGrid",
    "NavbakeError",
    "PathFinder",
    "QueryError",
    "SceneError",
    "SceneGrid2D",
    "VoxelGrid",
    "Voxelizer",
    "__version__",
    "bake",
    "create_voxel_grid",
    "load",
    "load_voxels",
]

_LAZY = {
    "BakeConfig": ("navbake.config", "BakeConfig"),
    "ExploredMap": ("navbake.explored", "ExploredMap"),
    "MultiLevelGrid": ("navbake.grid", "MultiLevelGrid"),
    "PathFinder": ("navbake.runtime.path_finder", "PathFinder"),
    "SceneGrid2D": ("navbake.grid", "SceneGrid2D"),
    "VoxelGrid": ("navbake.voxels.grid", "VoxelGrid"),
    "Voxelizer": ("navbake.voxels.voxelize", "Voxelizer"),
    "create_voxel_grid": ("navbake.voxels.voxelize", "create_voxel_grid"),
    "load": ("navbake.formats.navgrid", "read_navgrid"),
    "load_voxels": ("navbake.voxels.files", "read_voxels"),
}


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _LAZY[name]
    value = getattr(import_module(module), attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY})


class _CallableBake(ModuleType):
    """`navbake.bake` is the package of the baker and, called, the bake itself."""

    def __call__(
        self,
        config: BakeConfig | str | PathLike[str] | Mapping[str, Any],
        *,
        threads: int | None = None,
    ) -> SceneGrid2D | MultiLevelGrid:
        """Bake a scene.

        Args:
            config: settings, the path of a YAML or of a scene file, or the YAML as a mapping.
            threads: number of threads, >= 1; all cores if None. The result doesn't depend on it.

        Returns:
            The grid, not saved yet.

        Raises:
            ConfigError: a setting is wrong.
            SceneError: the scene cannot be read, or holds nothing to bake.
        """
        from navbake.bake.pipeline import run_bake
        from navbake.config import as_config

        return run_bake(as_config(config), threads=threads).grid


_bake_package.__class__ = _CallableBake
_bake_package.__doc__ = _CallableBake.__call__.__doc__ or ""
del _bake_package
