"""The bake, end to end: its stages, and the grid that they make."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from navbake.baker.arguments import take_input
from navbake.baker.assemble import build_grid
from navbake.baker.clock import Progress, StageClock
from navbake.baker.scene.isolated import CompileLimits
from navbake.baker.scene.model import OpenScene
from navbake.baker.scene.scene import GeomReport
from navbake.baker.stages import Stages, settle_doors, take_first_look
from navbake.config.keywords import SettingKeywords
from navbake.config.settings import BakeConfig
from navbake.errors import BakeWarning
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.threads import limit_threads
from navbake.types import Json

if TYPE_CHECKING:  # `typing` has it from Python 3.11 on
    from typing_extensions import Unpack

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
    scene: Any,
    data: Any = None,
    /,
    *,
    exclude: Mapping[str, Any] | None = None,
    robot: Any = None,
    threads: int | None = None,
    isolate: bool = False,
    **settings: Unpack[SettingKeywords],
) -> SceneGrid2D | MultiLevelGrid:
    """Bake a MuJoCo scene, or a building mesh, into a navigation grid.

    The grid says for each cell of each storey how high the floor is, whether an agent can stand
    there, which room the cell belongs to, and what stands in it. Lengths are in metres, angles in
    degrees, positions in MuJoCo's world frame, z up. The first bake on a machine compiles
    navbake's kernels; ``navbake warm-up`` does that beforehand.

    What a user should know about the bake is warned of, each line as a `BakeWarning`, and stays
    in `grid.warnings`, also when the grid is saved. The logger ``navbake`` gets it, too.

    A scene in memory bakes into what its file bakes into, byte for byte, where the settings name
    that file as ``scene={"path": …}``; without, the grid names no file, and its id is the model's
    name. ``docs/live.md`` says more.

    Args:
        scene: the path of a scene (MJCF, MJB, URDF, OBJ, PLY, STL, GLB, DAE) for default
            settings; the path of a YAML file with settings; the same as a mapping; a
            `BakeConfig`; or a scene in memory: a mujoco.MjModel or MjSpec, a trimesh.Scene or
            Trimesh. It is not changed.
        data: the mujoco.MjData whose joint positions and mocap bodies are the pose to bake, of a
            model or spec; as modelled, or as the settings say, if None.
        exclude: what is left out besides, as ``{"bodies": […], "geoms": […], "movable": True}``:
            by name, by id, by name pattern (``"chair*"``) or as ``model.body("table")``. All that
            hangs on a body is left out with it.
        robot: the body of the robot, or several, by name, by id or as ``model.body("panda")``;
            left out with all that hangs on it.
        threads: how many to use, >= 1; all cores if None. The result doesn't depend on it.
        isolate: let MuJoCo compile the scene in a process of its own, within 60 s and 4 GiB, so
            that a crash of its compiler is a SceneError. For scene files only.
        settings: sections of settings by name, as in the YAML file, in place of those that
            `scene` brings: a section's keys are replaced one by one. The most used:
            ``agent={"height": 1.2, "radius": 0.2, "traversable_floor_height": 0.1}`` [m] (the
            last is the highest step) and ``grid={"cell_size": 0.05}`` [m]. ``docs/settings.md``
            lists all; ``navbake init SCENE`` writes a YAML file with all, explained.

    Returns:
        A `SceneGrid2D`, or a `MultiLevelGrid` where there are several levels; not saved yet.
        ``grid.levels`` lists the levels of either, with arrays of shape (height, width).

    Raises:
        ConfigError: a setting is wrong, or names a body that isn't there; the data is of another
            model; the scene is nothing that can be baked.
        SceneError: the scene cannot be read or compiled, or holds nothing to bake.

    Example:
        >>> import navbake
        >>> grid = navbake.bake(navbake.samples.path("apartment"))
        >>> grid.save("apartment.grid.json")
        >>> grid = navbake.bake("my_scene.xml", agent={"radius": 0.2}, grid={"cell_size": 0.05})
        >>> grid = navbake.bake(model, data, robot="panda", agent={"height": 1.2})
        >>> finder = navbake.PathFinder(grid)
        >>> path = finder.find_path(finder.random_point(), finder.random_point())
    """
    limits = CompileLimits() if isolate else None
    config, opened = take_input(scene, data, settings, exclude, robot, limits)
    grid = run_bake(config, threads=threads, limits=limits, opened=opened).grid
    for warning in grid.warnings:
        warnings.warn(warning, BakeWarning, stacklevel=2)
    return grid


def run_bake(
    config: BakeConfig,
    *,
    threads: int | None = None,
    progress: Progress | None = None,
    limits: CompileLimits | None = None,
    opened: OpenScene | None = None,
) -> BakeResult:
    """Bake a scene into a navigation grid.

    Args:
        threads: how many to use, >= 1; all cores if None. It never changes the result.
        progress: called with each stage's name, and 0 when it begins or 1 when it ends.
        limits: MuJoCo compiles the scene in a child process, within these; here if None.
        opened: the scene's model, where it is in memory; see `take_input`.

    Returns:
        The grid, and what is worth knowing about how it came about.

    Raises:
        SceneError: the scene can't be read, or has nothing to bake.
        ConfigError: settings don't fit the scene.
    """
    clock = StageClock(progress)
    with limit_threads(threads):
        stages = settle_doors(take_first_look(config, clock, limits, opened))
        stages.free_geometry()
        with clock.stage("grid"):
            grid = build_grid(stages)
        if config.verify.sample is not None:
            with clock.stage("verify"):
                grid = _verified(grid, stages, config.verify.sample)
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


def _verified(
    grid: SceneGrid2D | MultiLevelGrid, stages: Stages, sample: int
) -> SceneGrid2D | MultiLevelGrid:
    """The grid with what a verification by MuJoCo and FCL found, and a warning if it disagrees."""
    # a bake that doesn't verify starts without FCL's and MuJoCo's shapes of the scene
    from navbake.verifier.verify import Options, verify_scene

    report = verify_scene(grid, stages.scene, Options(sample=sample), stages.config)
    found, looked = len(report.findings), {"sample": sample, "cells": report.checked}
    verified = {**looked, "disagreements": found, "digest": report.digest}
    own: Json = {**grid.navbake, "verified": verified}
    if found:
        places = f"{found} place{'s' if found > 1 else ''}, with {report.checked} cells looked at"
        text = f"verify: MuJoCo and FCL disagree with the grid at {places}"
        own["warnings"] = [*grid.warnings, f"{text}; navbake verify lists them"]
    metadata = {**grid.metadata, "navbake": own}
    checked: SceneGrid2D | MultiLevelGrid = grid.with_levels(grid.levels, metadata)
    return checked
