"""The bake, end to end: its stages, and the grid that they make."""

import logging
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

from navbake.baker.assemble import build_grid
from navbake.baker.clock import Progress, StageClock
from navbake.baker.scene.scene import GeomReport
from navbake.baker.stages import settle_doors, take_first_look
from navbake.config.settings import BakeConfig, as_config
from navbake.errors import BakeWarning
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.threads import limit_threads

LOG = logging.getLogger("navbake")
# without it, Python prints warnings of loggers that nobody has set up
LOG.addHandler(logging.NullHandler())


@dataclass
class BakeResult:
    """What a bake yields.

    Attributes:
        grid: the grid; a MultiLevelGrid where there are several levels.
        geoms: what became of each geom.
        warnings: what the user should know, one line each.
        timings: seconds of each stage, in their order.
        by_ray: how many cells a ray alone proved occupied.
        by_fcl: how many had no proof either way, so that FCL decided.
    """

    grid: SceneGrid2D | MultiLevelGrid
    geoms: list[GeomReport]
    warnings: list[str]
    timings: dict[str, float] = field(default_factory=dict)
    by_ray: int = 0
    by_fcl: int = 0


def bake(
    config: BakeConfig | str | PathLike[str] | Mapping[str, Any], *, threads: int | None = None
) -> SceneGrid2D | MultiLevelGrid:
    """Bake a scene.

    What a user should know about the bake is warned of, each line as a `BakeWarning`, and stays
    in `grid.warnings`, also when the grid is saved. The logger ``navbake`` gets it, too.

    Args:
        config: settings, the path of a YAML or of a scene file, or the YAML as a mapping.
        threads: number of threads, >= 1; all cores if None. The result doesn't depend on it.

    Returns:
        The grid, not saved yet.

    Raises:
        ConfigError: a setting is wrong.
        SceneError: the scene cannot be read, or holds nothing to bake.
    """
    grid = run_bake(as_config(config), threads=threads).grid
    for warning in grid.warnings:
        warnings.warn(warning, BakeWarning, stacklevel=2)
    return grid


def run_bake(
    config: BakeConfig, *, threads: int | None = None, progress: Progress | None = None
) -> BakeResult:
    """Bake a scene into a navigation grid.

    Args:
        threads: how many to use, >= 1; all cores if None. It never changes the result.
        progress: called with each stage's name, and 0 when it begins or 1 when it ends.

    Returns:
        The grid, and what is worth knowing about how it came about.

    Raises:
        SceneError: the scene can't be read, or has nothing to bake.
        ConfigError: settings don't fit the scene.
    """
    clock = StageClock(progress)
    with limit_threads(threads):
        stages = settle_doors(take_first_look(config, clock))
        with clock.stage("grid"):
            grid = build_grid(stages)
    grid.timings = clock.to_json()
    for warning in grid.warnings:
        LOG.warning("%s: %s", stages.scene.id, warning)
    return BakeResult(
        grid=grid,
        geoms=stages.scene.geoms,
        warnings=list(grid.warnings),
        timings=clock.seconds,
        by_ray=stages.occupancy.by_ray,
        by_fcl=stages.occupancy.by_fcl,
    )
