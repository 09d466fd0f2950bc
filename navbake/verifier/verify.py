"""Compares a grid with its scene by MuJoCo and FCL, independently of the code that baked it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from navbake.baker.scene.scene import Scene
from navbake.config.settings import BakeConfig
from navbake.errors import FormatError, QueryError, count_of
from navbake.formats.navgrid import read_navgrid
from navbake.mujoco_types import MjDataLike
from navbake.navgrid.grid import GridBase, NavGrid
from navbake.types import Bool
from navbake.verifier.cells import FloorCheck, OccupancyCheck
from navbake.verifier.obstacles import Obstacles
from navbake.verifier.probes import ObstacleProbe
from navbake.verifier.report import Finding, LevelCounts, SweepCounts, VerifyReport
from navbake.verifier.sample import (
    AgentSizes,
    CellNeighborhood,
    InflatedGrid,
    LevelSample,
    has_cell_floors,
    inflate_for_radius,
    make_volumes,
    take_sample,
)
from navbake.verifier.source import SceneSource, find_source, pose_doors
from navbake.verifier.sweeps import PathSweep, check_links

DEFAULT_SAMPLE = 100_000  # number of cells that are checked
DEFAULT_TOLERANCE = 1e-4  # touches that are less deep are attributed to rounding [m]


def verify(
    grid: NavGrid | str | PathLike[str],
    scene: SceneSource | None = None,
    *,
    sample: int | None = DEFAULT_SAMPLE,
    seed: int = 0,
    radius: float | None = None,
    paths: int = 0,
    tolerance: float = DEFAULT_TOLERANCE,
    force: bool = False,
    data: MjDataLike | None = None,
    model_path: Sequence[str | PathLike[str]] = (),
) -> VerifyReport:
    """Compare a grid with its scene, cell by cell.

    MuJoCo and FCL compute what the volume over a cell touches. MuJoCo's rays show whether each
    floor is a surface, and whether the scene has a place to stand that is on no level. Only the
    loading of the scene is shared with the code that baked the grid. `docs/verify.md` describes
    what agreement means.

    Args:
        grid: A grid of one or several levels, or the path of its file.
        scene: Settings, the path of a YAML or of a scene file, the YAML as a mapping, or a scene
            in memory (mujoco.MjModel, MjSpec, trimesh.Scene, Trimesh). If None, the file that the
            grid names, beside the grid or in the current folder, or in ``scenes`` there.
        sample: The number of cells to check, >= 1, drawn from those of all levels; None for all.
        seed: The seed of the sample and of the paths, >= 0.
        radius: The radius of the cylinder that has to fit on free cells [m], >= 0, and that is
            swept along paths. If None, the radius of the grid's inflation; for a grid without
            inflation, the baked footprint. A grid without inflation, or with one for a smaller
            radius, is first inflated for this radius.
        paths: The number of paths to plan, and to sweep the cylinder along, >= 0.
        tolerance: The depth up to which touches are attributed to rounding [m], > 0; at most a
            quarter of a cell's edge, and of the height of the volume over a cell.
        force: Whether to compare the grid with a scene that is not the one of its bake.
        data: The pose of a model or spec. If None, the pose that the grid states: a keyframe and
            joints.
        model_path: The folders of the models and packages that the scene's file names, as the
            setting `scene.model_path`; grids don't state it.

    Returns:
        The counts of each level, and each disagreement with its position.

    Raises:
        QueryError: there is no scene, or it is not the grid's; an argument is out of its range, or
            the radius is smaller than that of the grid's inflation.
        SceneError: the scene cannot be read.
        ConfigError: the settings are wrong.
        FormatError: the grid cannot be read, or its metadata states sizes that no agent can have.

    Example:
        >>> report = navbake.verify("house.grid.json", "house.yaml", paths=100)
        >>> report.ok
        True
    """
    _check_arguments(sample=sample, seed=seed, radius=radius, paths=paths, tolerance=tolerance)
    path = None if isinstance(grid, GridBase) else Path(grid)
    # a grid of one level has the same attributes as a grid of several
    nav_grid: Any = grid if path is None else read_navgrid(path)
    loaded_scene, config, notes = find_source(
        nav_grid, scene, path, force=force, data=data, model_path=model_path
    )
    return verify_scene(
        nav_grid,
        loaded_scene,
        config,
        sample=sample,
        seed=seed,
        radius=radius,
        paths=paths,
        tolerance=tolerance,
        notes=notes,
    )


def _check_arguments(
    *,
    sample: int | None,
    seed: int,
    radius: float | None,
    paths: int,
    tolerance: float,
) -> None:
    """Raise a QueryError for the first argument of `verify` that is out of its range."""
    if sample is not None:
        _check_number(sample, "a sample of at least 1 cell", minimum=1, is_whole=True)
    _check_number(seed, "a whole number >= 0 as seed", minimum=0, is_whole=True)
    _check_number(paths, "a number of paths >= 0", minimum=0, is_whole=True)
    if radius is not None:
        _check_number(radius, "a radius >= 0 m", minimum=0)
    _check_number(tolerance, "a tolerance > 0 m", minimum=math.ulp(0.0))


def _check_number(
    argument: object, expected_text: str, *, minimum: float, is_whole: bool = False
) -> None:
    """Raise a QueryError unless an argument is a finite number >= a minimum, maybe whole."""
    number_types = (int, np.integer) if is_whole else (int, float, np.integer, np.floating)
    is_number = isinstance(argument, number_types) and not isinstance(argument, bool)
    if not is_number or not minimum <= argument < np.inf:  # type: ignore[operator]
        raise QueryError(f"expected {expected_text}, got {argument!r}")


def verify_scene(
    grid: NavGrid,
    scene: Scene,
    config: BakeConfig | None,
    *,
    sample: int | None = DEFAULT_SAMPLE,
    seed: int = 0,
    radius: float | None = None,
    paths: int = 0,
    tolerance: float = DEFAULT_TOLERANCE,
    notes: Sequence[str] = (),
) -> VerifyReport:
    """Compare a grid with a loaded scene.

    Args:
        grid: The grid.
        scene: The scene.
        config: The settings of the bake; None if they are unknown.
        sample: How many cells to look at, drawn at random; None for all.
        seed: Seed of the draw of cells and paths.
        radius: The radius of the agent that has to fit on free cells [m]; None for the radius of
            the grid's inflation, or else the baked footprint.
        paths: How many paths to sweep a cylinder along.
        tolerance: Touches that are no deeper than this count as rounding [m].
        notes: Messages for the user, which come first in the report.

    Returns:
        The counts of each level, and each disagreement with its position.

    Raises:
        QueryError: The tolerance is too large, or the radius is smaller than that of the grid's
            inflation.
        SceneError: MuJoCo cannot hold the scene's shapes.
        FormatError: The grid's metadata states sizes that no agent can have.
    """
    # without obstacles; grids of one level and of several levels have different types
    baked_grid: Any = grid.without_obstacles()
    agent = AgentSizes.of_grid(baked_grid)
    notes = list(notes)
    door_pose = pose_doors(scene, baked_grid)
    cell_size = baked_grid.levels[0].lattice.cell_size
    max_tolerance = min(cell_size, agent.height - agent.step) / 4
    if tolerance > max_tolerance:
        raise QueryError(
            f"expected a tolerance of at most {max_tolerance:g} m, got {tolerance:g}: volumes are "
            "made smaller by it on all sides, and half of a cell's width and of the height has to "
            "stay"
        )
    levels_have_cell_floors = [has_cell_floors(level) for level in baked_grid.levels]
    inflated_grid = inflate_for_radius(baked_grid, radius, notes)
    verified_grid = inflated_grid.grid
    if inflated_grid.inflation_reach > 0 and config is not None and config.grid.bounds is not None:
        note = "`grid.bounds` cut the grid, which knows nothing of what lies beyond"
        notes.append(f"{note}: a larger agent's cylinder may touch it")
    if grid.is_blocked:
        notes.append("what was blocked at run time is left out")

    obstacles = Obstacles(scene, door_pose.data, door_pose.removed_geoms)
    probe = ObstacleProbe(obstacles)
    occupancy_check = OccupancyCheck(probe, agent, tolerance, inflated_grid.inflation_reach)
    floor_check = None
    if all(levels_have_cell_floors):
        floor_obstacles = obstacles
        if door_pose.floorless_geoms:
            floor_obstacles = Obstacles(scene, door_pose.data, door_pose.floorless_geoms)
        floor_check = FloorCheck(verified_grid, ObstacleProbe(floor_obstacles), agent, config)
    neighborhood = CellNeighborhood(
        verified_grid, agent.step, measures_from_centers=inflated_grid.measures_from_centers
    )
    samples = take_sample(verified_grid, sample, seed, levels_have_cell_floors)
    levels = list[LevelCounts]()
    findings = list[Finding]()
    for level_sample, name in zip(samples, verified_grid.level_names, strict=True):
        counts = LevelCounts(name, cells=len(level_sample.rows))
        levels.append(counts)
        free_volume = make_volumes(level_sample, agent, neighborhood, inflated_grid.radius)
        findings += occupancy_check.check_free(level_sample, counts, free_volume)
        baked_volume = make_volumes(level_sample, agent, neighborhood)
        is_excused = _mark_excused_cells(level_sample, neighborhood, inflated_grid.inflation_reach)
        findings += occupancy_check.check_blocked(level_sample, counts, baked_volume, is_excused)
        if floor_check is not None:
            findings += floor_check.check(level_sample, counts)
    link_findings, link_notes = check_links(grid, scene, probe, agent, tolerance)
    findings += link_findings
    notes += link_notes
    notes += _describe_unchecked(floor_check, occupancy_check)

    sweep_counts = None
    if paths:
        sweep_counts, path_findings, path_notes = _sweep_paths(
            inflated_grid, probe, agent, tolerance=tolerance, num_paths=paths, seed=seed
        )
        findings += path_findings
        notes += path_notes

    findings.sort(key=lambda finding: (finding.level, finding.cell or (-1, -1), finding.kind))
    # the report holds the list of notes: those that follow need its totals, or come last
    report = VerifyReport(
        scene_id=verified_grid.scene_id,
        num_cells=sum(level.width * level.height for level in verified_grid.levels),
        seed=seed,
        tolerance=tolerance,
        radius=inflated_grid.radius,
        levels=levels,
        sweeps=sweep_counts,
        findings=findings,
        notes=notes,
    )
    notes += _describe_one_sided_checks(obstacles, report.total.disputed)
    if door_pose.unknown_doors:
        notes.append(f"the scene has no doors {', '.join(map(repr, door_pose.unknown_doors[:5]))}")
    if not verified_grid.navbake:
        sizes_text = f"radius {verified_grid.agent_radius:g} m, step {verified_grid.max_step:g} m"
        note = f"the grid is of another program: an agent of {verified_grid.agent_height:g} m"
        notes.append(f"{note}, {sizes_text}")
    return report


def _sweep_paths(
    inflated_grid: InflatedGrid,
    probe: ObstacleProbe,
    agent: AgentSizes,
    *,
    tolerance: float,
    num_paths: int,
    seed: int,
) -> tuple[SweepCounts | None, list[Finding], list[str]]:
    """Sweep a cylinder along paths between random places.

    Args:
        inflated_grid: The grid; one without a radius is inflated for the agent's.
        probe: The obstacles.
        agent: The agent that the grid was baked for.
        tolerance: Touches that are no deeper than this count as rounding [m].
        num_paths: How many paths to sweep, >= 1.
        seed: Seed of the draw of paths.

    Returns:
        The counts, None if no path was swept; the disagreements; and notes for the user.
    """
    radius = agent.radius if inflated_grid.radius is None else inflated_grid.radius
    if radius <= tolerance:
        return None, [], ["no paths were swept: the agent's radius isn't above the tolerance"]
    swept_grid = inflated_grid.grid
    if inflated_grid.radius is None:
        swept_grid = swept_grid.inflate(radius)
    try:
        path_sweep = PathSweep(swept_grid, probe, agent, radius, tolerance)
        counts, findings = path_sweep.sweep_random_paths(num_paths, seed)
    except FormatError as error:
        return None, [], [f"no paths were swept: {error}"]
    notes = []
    if counts.paths < num_paths:
        notes.append(f"only {counts.paths} paths were found between random places")
    return counts, findings, notes


def _mark_excused_cells(
    sample: LevelSample, neighborhood: CellNeighborhood, inflation_reach: float
) -> Bool:
    """Mark the cells of a sample that an inflation blocked with a reason, (n,).

    Any other blocked cell has to touch something itself.
    """
    is_excused = (
        (inflation_reach > 0) & ~sample.is_free & ~sample.is_occupied & ~np.isnan(sample.floor)
    )
    is_excused[is_excused] = neighborhood.has_blocking_reason(
        sample.level_number,
        sample.rows[is_excused],
        sample.cols[is_excused],
        sample.floor[is_excused],
        inflation_reach,
    )
    return np.asarray(is_excused)


def _describe_unchecked(
    floor_check: FloorCheck | None, occupancy_check: OccupancyCheck
) -> list[str]:
    """Return notes about the cells and places that the checks left out."""
    notes = []
    if floor_check is None:
        notes.append(
            "the grid states no floors of cells, so cells are judged over their level's ground: "
            "free ones need a floor within a step of it, and lost places aren't looked for"
        )
    elif floor_check.num_ignored_regions:
        notes.append(
            f"{count_of(floor_check.num_ignored_regions, 'place')} to stand, "
            f"{floor_check.ignored_area:.1f} m² in all, on no level: no steps lead there; too "
            "small for a floor, or the top of furniture, of a shelf, or of a roof"
        )
    if occupancy_check.num_cells_without_ground:
        reason = "the scene has no place to stand there within a step of their level's ground"
        notes.append(
            f"{occupancy_check.num_cells_without_ground} blocked cells touch nothing, but {reason}"
        )
    return notes


def _describe_one_sided_checks(obstacles: Obstacles, num_disputed: int) -> list[str]:
    """Return notes about the obstacles that only one of the two libraries checks reliably."""
    notes = []
    surface_geoms = {shape.geom for shape in obstacles.shapes if not shape.is_same_in_mujoco}
    if surface_geoms:
        names = sorted(obstacles.geom_names[geom] for geom in surface_geoms)
        counted_text = f"{names[0]!r} counts"
        if len(names) > 1:
            counted_text = f"{names[0]!r} and {len(names) - 1} more count"
        reason = "where MuJoCo collides hulls, infinite planes or nothing"
        notes.append(f"{counted_text} by the surface, {reason}: FCL and MuJoCo's rays judge alone")
    if num_disputed:
        note = f"MuJoCo and FCL contradict each other over {num_disputed} cells"
        notes.append(f"{note}: these cells aren't counted")
    return notes
