"""Bakes MuJoCo scenes into navigation grids, and answers agents' queries to these grids.

``navbake.bake(config)`` makes a grid, ``navbake.load(path)`` reads one. Importing navbake imports
none of its dependencies; each name below imports what it needs when it is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from navbake._version import __version__
from navbake.errors import (
    BakeWarning,
    ConfigError,
    FormatError,
    MissingDependencyError,
    NavbakeError,
    QueryError,
    SceneError,
)
from navbake.lazy import resolve

if TYPE_CHECKING:
    from navbake import episodes, samples, scores, tensors
    from navbake.arena.map_descriptor import ExploredMap
    from navbake.auditor.audit import audit
    from navbake.baker.bake.pipeline import bake
    from navbake.baker.live.baker import Baker
    from navbake.baker.voxels.local_flight import LocalFlight
    from navbake.baker.voxels.voxelize import Voxelizer, create_voxel_grid
    from navbake.config.settings import BakeConfig
    from navbake.formats.grscenes import read_grscenes as from_grscenes
    from navbake.formats.nav2 import read_nav2 as from_nav2
    from navbake.formats.navgrid import read_navgrid as load
    from navbake.formats.npz import read_grid_npz as from_npz
    from navbake.formats.omnigibson import read_omnigibson as from_omnigibson
    from navbake.formats.procthor import read_procthor as from_procthor
    from navbake.formats.voxels import read_voxels as load_voxels
    from navbake.navgrid.door_states import DoorStateWarning
    from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
    from navbake.navgrid.links import Agent
    from navbake.runtime.inflation import InflationWarning
    from navbake.runtime.path_finder import PathFinder
    from navbake.verifier.verify import verify
    from navbake.views.draw import draw
    from navbake.views.report import write_report as report
    from navbake.views.viewer.view import view
    from navbake.voxels.finder import VoxelFinder
    from navbake.voxels.grid import VoxelGrid

__all__ = [
    "Agent",
    "BakeConfig",
    "BakeWarning",
    "Baker",
    "ConfigError",
    "DoorStateWarning",
    "ExploredMap",
    "FormatError",
    "InflationWarning",
    "LocalFlight",
    "MissingDependencyError",
    "MultiLevelGrid",
    "NavbakeError",
    "PathFinder",
    "QueryError",
    "SceneError",
    "SceneGrid2D",
    "VoxelFinder",
    "VoxelGrid",
    "Voxelizer",
    "__version__",
    "audit",
    "bake",
    "create_voxel_grid",
    "draw",
    "episodes",
    "from_grscenes",
    "from_nav2",
    "from_npz",
    "from_omnigibson",
    "from_procthor",
    "load",
    "load_voxels",
    "report",
    "samples",
    "scores",
    "tensors",
    "verify",
    "view",
]

# For each public name that needs dependencies: where it is defined, as ``module:name``, or the
# module that it is.
_LAZY = {
    "Agent": "navbake.navgrid.links:Agent",
    "audit": "navbake.auditor.audit:audit",
    "bake": "navbake.baker.bake.pipeline:bake",
    "BakeConfig": "navbake.config.settings:BakeConfig",
    "Baker": "navbake.baker.live.baker:Baker",
    "DoorStateWarning": "navbake.navgrid.door_states:DoorStateWarning",
    "ExploredMap": "navbake.arena.map_descriptor:ExploredMap",
    "InflationWarning": "navbake.runtime.inflation:InflationWarning",
    "LocalFlight": "navbake.baker.voxels.local_flight:LocalFlight",
    "MultiLevelGrid": "navbake.navgrid.grid:MultiLevelGrid",
    "PathFinder": "navbake.runtime.path_finder:PathFinder",
    "SceneGrid2D": "navbake.navgrid.grid:SceneGrid2D",
    "VoxelFinder": "navbake.voxels.finder:VoxelFinder",
    "VoxelGrid": "navbake.voxels.grid:VoxelGrid",
    "Voxelizer": "navbake.baker.voxels.voxelize:Voxelizer",
    "create_voxel_grid": "navbake.baker.voxels.voxelize:create_voxel_grid",
    "draw": "navbake.views.draw:draw",
    "from_grscenes": "navbake.formats.grscenes:read_grscenes",
    "from_nav2": "navbake.formats.nav2:read_nav2",
    "from_npz": "navbake.formats.npz:read_grid_npz",
    "from_omnigibson": "navbake.formats.omnigibson:read_omnigibson",
    "from_procthor": "navbake.formats.procthor:read_procthor",
    "load": "navbake.formats.navgrid:read_navgrid",
    "load_voxels": "navbake.formats.voxels:read_voxels",
    "report": "navbake.views.report:write_report",
    "verify": "navbake.verifier.verify:verify",
    "view": "navbake.views.viewer.view:view",
    "episodes": "navbake.episodes",
    "samples": "navbake.samples",
    "scores": "navbake.scores",
    "tensors": "navbake.tensors",
}

# Wrong names that people try first -> what to write instead.
_GUESSES = {
    "load_grid": "load",
    "read": "load",
    "read_grid": "load",
    "load_scene": "bake",
    "sample_episodes": "episodes.make_episodes",
    "generate_episodes": "episodes.make_episodes",
    "make_episodes": "episodes.make_episodes",
    "batch": "bake, or use `navbake batch`",
}


def __getattr__(name: str) -> Any:
    """Import a public name on first use."""
    if name not in _LAZY:
        hint = f": write navbake.{_GUESSES[name]}" if name in _GUESSES else ""
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")
    source = _LAZY[name]
    public_object = resolve(source) if ":" in source else importlib.import_module(source)
    globals()[name] = public_object
    return public_object


def __dir__() -> list[str]:
    """List the module's names, including public names that are not imported yet."""
    return sorted({*globals(), *_LAZY})
