"""Bakes MuJoCo scenes into navigation grids, and serves those grids to agents.

``navbake.bake(config)`` makes a grid, ``navbake.load(path)`` reads one. Importing navbake loads
none of its dependencies; each name below loads what it needs when it is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from navbake._version import __version__ as __version__
from navbake.errors import BakeWarning as BakeWarning
from navbake.errors import ConfigError as ConfigError
from navbake.errors import FormatError as FormatError
from navbake.errors import MissingDependencyError as MissingDependencyError
from navbake.errors import NavbakeError as NavbakeError
from navbake.errors import QueryError as QueryError
from navbake.errors import SceneError as SceneError
from navbake.lazy import resolve

if TYPE_CHECKING:  # by these forms, type checkers know which names are public
    from navbake import episodes as episodes
    from navbake import samples as samples
    from navbake import scores as scores
    from navbake import tensors as tensors
    from navbake.arena.map_descriptor import ExploredMap as ExploredMap
    from navbake.auditor.audit import audit as audit
    from navbake.baker.pipeline import bake as bake
    from navbake.baker.update.baker import Baker as Baker
    from navbake.baker.voxelize.voxelizer import Voxelizer as Voxelizer
    from navbake.baker.voxelize.voxelizer import create_voxel_grid as create_voxel_grid
    from navbake.config.settings import BakeConfig as BakeConfig
    from navbake.formats.grscenes import read_grscenes
    from navbake.formats.nav2 import read_nav2
    from navbake.formats.navgrid import read_navgrid
    from navbake.formats.npz import read_grid_npz
    from navbake.formats.omnigibson import read_omnigibson
    from navbake.formats.procthor import read_procthor
    from navbake.formats.voxels import read_voxels
    from navbake.navgrid.agents import Agent as Agent
    from navbake.navgrid.grid import MultiLevelGrid as MultiLevelGrid
    from navbake.navgrid.grid import SceneGrid2D as SceneGrid2D
    from navbake.runtime.path_finder import PathFinder as PathFinder
    from navbake.verifier.verify import verify as verify
    from navbake.views.report.report import write_report
    from navbake.views.viewer.view import view as view
    from navbake.voxels.grid import VoxelGrid as VoxelGrid

    from_grscenes = read_grscenes
    from_nav2 = read_nav2
    load = read_navgrid
    from_npz = read_grid_npz
    from_omnigibson = read_omnigibson
    from_procthor = read_procthor
    load_voxels = read_voxels
    report = write_report

# where each public name is that loads dependencies
_LAZY = {
    "Agent": "navbake.navgrid.agents:Agent",
    "audit": "navbake.auditor.audit:audit",
    "bake": "navbake.baker.pipeline:bake",
    "BakeConfig": "navbake.config.settings:BakeConfig",
    "Baker": "navbake.baker.update.baker:Baker",
    "ExploredMap": "navbake.arena.map_descriptor:ExploredMap",
    "MultiLevelGrid": "navbake.navgrid.grid:MultiLevelGrid",
    "PathFinder": "navbake.runtime.path_finder:PathFinder",
    "SceneGrid2D": "navbake.navgrid.grid:SceneGrid2D",
    "VoxelGrid": "navbake.voxels.grid:VoxelGrid",
    "Voxelizer": "navbake.baker.voxelize.voxelizer:Voxelizer",
    "create_voxel_grid": "navbake.baker.voxelize.voxelizer:create_voxel_grid",
    "from_grscenes": "navbake.formats.grscenes:read_grscenes",
    "from_nav2": "navbake.formats.nav2:read_nav2",
    "from_npz": "navbake.formats.npz:read_grid_npz",
    "from_omnigibson": "navbake.formats.omnigibson:read_omnigibson",
    "from_procthor": "navbake.formats.procthor:read_procthor",
    "load": "navbake.formats.navgrid:read_navgrid",
    "load_voxels": "navbake.formats.voxels:read_voxels",
    "report": "navbake.views.report.report:write_report",
    "verify": "navbake.verifier.verify:verify",
    "view": "navbake.views.viewer.view:view",
}

# of navbake, loaded when they are first asked for
_MODULES = ("episodes", "samples", "scores", "tensors")
_ERRORS = [name for name in globals() if name.endswith(("Error", "Warning"))]
__all__ = sorted([*_LAZY, *_MODULES, *_ERRORS, "__version__"])

# first guesses
_MEANT = {"load_grid": "load", "read": "load", "read_grid": "load", "load_scene": "bake"}
_MEANT |= dict.fromkeys(("sample_episodes", "generate_episodes"), "episodes.make_episodes")
_MEANT |= {"make_episodes": "episodes.make_episodes", "batch": "bake, or use `navbake batch`"}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(f"navbake.{name}")
    if name not in _LAZY:
        meant = f": write navbake.{_MEANT[name]}" if name in _MEANT else ""
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{meant}")
    value = resolve(_LAZY[name])
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY, *_MODULES})
