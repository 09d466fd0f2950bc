"""Compares a grid with its scene, by MuJoCo and FCL, and with nothing of what baked it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from navbake.baker.scene.scene import Scene
from navbake.config.settings import BakeConfig, FloorSettings
from navbake.errors import FormatError, QueryError
from navbake.formats.navgrid import read_navgrid
from navbake.navgrid.grid import NavGrid
from navbake.navgrid.grid_base import GridBase
from navbake.verifier.floors import FloorCheck, SheetSearch
from navbake.verifier.lines import CRACK, Lines
from navbake.verifier.obstacles import UNCLEAR, Obstacles
from navbake.verifier.occupancy import OccupancyCheck
from navbake.verifier.probes import Probes
from navbake.verifier.report import PLACE_LOST, Finding, LevelCounts, VerifyReport
from navbake.verifier.sample import (
    Agent,
    LevelSample,
    Surroundings,
    inflate_for,
    states_floors,
    take_sample,
    volume_over,
)
from navbake.verifier.source import SceneSource, find_source, pose_doors
from navbake.verifier.sweeps import sweep_paths

SAMPLE = 100_000  # cells that are looked at unless told otherwise
TOLERANCE = 1e-4  # what touches by less than this touches by rounding [m]


class Options(NamedTuple):
    """How a grid is verified; see `verify`."""

    sample: int | None = SAMPLE
    seed: int = 0
    radius: float | None = None
    paths: int = 0
    tolerance: float = TOLERANCE


def verify(
    grid: NavGrid | str | PathLike[str],
    scene: SceneSource | None = None,
    *,
    sample: int | None = SAMPLE,
    seed: int = 0,
    radius: float | None = None,
    paths: int = 0,
    tolerance: float = TOLERANCE,
    force: bool = False,
    data: Any = None,
) -> VerifyReport:
    """Compare a grid with its scene, cell by cell.

    MuJoCo and FCL put the volume over a cell into the scene, and tell what it touches. MuJoCo's
    rays tell whether each floor is a surface, and whether there are places to stand that no level
    has. Nothing of it is shared with the code that baked the grid, but the loading of the scene.
    `docs/verify.md` says what agreement means.

    Args:
        grid: a grid of one or several levels, or the path of its file.
        scene: settings, the path of a YAML or of a scene file, the YAML as a mapping, or a scene
            in memory (mujoco.MjModel, MjSpec, trimesh.Scene, Trimesh); None for the file that the
            grid names, beside the grid or in the current folder, or in ``scenes`` there.
        sample: how many cells to look at, >= 1, drawn from those of all levels; all if None.
        seed: of the sample and of the paths.
        radius: of the cylinder that stands on free cells [m], and runs along paths: that of the
            grid's inflation if None, else the baked footprint. A grid that isn't inflated, or for
            a smaller radius, is inflated for it.
        paths: how many paths to plan and to sweep a cylinder along.
        tolerance: what touches by less than this touches by rounding [m], > 0, and at most a
            quarter of a cell's edge and of the height that is judged.
        force: compare with a scene that isn't the one that was baked.
        data: the mujoco.MjData with the pose of a model or spec; the pose that the grid states,
            a keyframe and joints, if None.

    Raises:
        QueryError: there is no scene, or it isn't the grid's; an option is out of its range, or
            the radius below that of the grid's inflation.
        SceneError, ConfigError, FormatError: the scene, settings or grid can't be read, or the
            grid's metadata state sizes that no agent can have.
    """
    options = Options(sample, seed, radius, paths, tolerance)
    whole, number = int | np.integer, int | float | np.integer | np.floating
    asked: list[tuple[Any, Any, float, str]] = [
        (sample, whole, 1, "a sample of at least 1 cell"),
        (seed, whole, 0, "a whole number >= 0 as seed"),
        (paths, whole, 0, "a number of paths >= 0"),
        (radius, number, 0, "a radius >= 0 m"),
        (tolerance, number, math.ulp(0.0), "a tolerance > 0 m"),
    ]
    for value, kind, least, expected in asked:
        if value is None and expected.startswith(("a sample", "a radius")):
            continue  # all cells, the grid's own radius
        is_number = isinstance(value, kind) and not isinstance(value, bool)
        if not (is_number and least <= value < np.inf):
            raise QueryError(f"expected {expected}, got {value!r}")
    path = None if isinstance(grid, GridBase) else Path(grid)
    content: Any = grid if path is None else read_navgrid(path)
    source = find_source(content, scene, path, force=force, data=data)
    config = source.config if source.are_known else None
    return verify_scene(content, source.scene, options, config, source.notes)


def verify_scene(
    grid: NavGrid,
    scene: Scene,
    options: Options,
    config: BakeConfig | None,
    notes: Sequence[str] = (),
) -> VerifyReport:
    """Compare a grid with a loaded scene, with the settings of the bake, where they are known.

    Notes come first in the report. Raises as `verify`.
    """
    content: Any = grid.without_blocks()
    agent, doors = Agent.of(content), pose_doors(scene, content)
    sizes = [level.lattice.cell_size for level in content.levels]
    most = min(*sizes, agent.height - agent.step) / 4
    if options.tolerance > most:
        raise QueryError(
            f"expected a tolerance of at most {most:g} m, got {options.tolerance:g}: volumes are "
            "made smaller by it on all sides, and half of a cell's width and of the height has to "
            "stay"
        )
    with_floors = [states_floors(level) for level in content.levels]
    content, inflation, told = inflate_for(content, options.radius)
    report = VerifyReport(
        scene_id=content.scene_id,
        num_cells=sum(level.width * level.height for level in content.levels),
        seed=options.seed,
        tolerance=options.tolerance,
        radius=inflation.radius,
        levels=[LevelCounts(name) for name in content.level_names],
        notes=[*notes, *told],
    )
    if inflation.reach > 0 and config is not None and config.grid.bounds is not None:
        report.notes.append(
            "`grid.bounds` cut the grid, which knows nothing of what lies beyond: a larger agent's "
            "cylinder may touch it"
        )
    if grid.is_blocked:
        report.notes.append("what was blocked at run time is left out")
    samples = take_sample(content, options.sample, options.seed, with_floors)
    obstacles = Obstacles(scene, doors.data, doors.removed)
    probes, lines = Probes(obstacles), Lines(obstacles)
    check = OccupancyCheck(probes, lines, agent, options.tolerance, inflation.reach)
    around = Surroundings(content, agent.step, by_centres=inflation.by_centres)
    for sample, counts in zip(samples, report.levels, strict=True):
        counts.cells = len(sample)
        # what an inflation closed for a reason; all else has to touch something by itself
        excused = np.zeros(len(sample), dtype=np.bool_)
        if inflation.reach > 0:
            excused = ~sample.free & ~sample.occupied & ~np.isnan(sample.floor)
            closed = sample.rows[excused], sample.cols[excused], sample.floor[excused]
            excused[excused] = around.has_reason(sample.number, *closed, inflation.reach)
        volume = volume_over(sample, agent, around, inflation.radius)
        report.findings += check.check_free(sample, counts, volume)
        baked = volume_over(sample, agent, around)
        report.findings += check.check_blocked(sample, counts, baked, excused)
    if all(with_floors):
        fixed = Obstacles(scene, doors.data, doors.geoms) if doors.geoms else obstacles
        crack = CRACK if config is None else config.floors.crack
        floors = FloorCheck(content, Lines(fixed), agent, crack)
        _check_floors(report, content, samples, floors, config)
    else:
        report.notes.append(
            "the grid states no floors of cells, so cells are judged over their level's ground: "
            "free ones need a floor within a step of it, and lost places aren't looked for"
        )
    if check.num_groundless:
        report.notes.append(
            f"{check.num_groundless} blocked cells touch nothing, but the scene has no place to "
            "stand there within a step of their level's ground"
        )
    if options.paths:
        _sweep(report, content, probes, agent, options)
    _add_notes(report, obstacles, doors.unknown, content)
    report.findings.sort(key=lambda found: (found.level, found.cell or (-1, -1), found.kind))
    return report


def _check_floors(
    report: VerifyReport,
    grid: GridBase,
    samples: list[LevelSample],
    check: FloorCheck,
    config: BakeConfig | None,
) -> None:
    """Look for floors that are off, and for places that are lost.

    Floors by themselves are asked for where the settings don't leave out any; and where the grid
    has no floor at all, whatever the settings.
    """
    leaves_out = config is None or config.levels != "auto" or config.floors.reach != "all"
    has_floors = any((~np.isnan(level.floor_height)).any() for level in grid.levels)
    is_asked = not leaves_out or not has_floors
    settings = FloorSettings() if config is None else config.floors
    search = SheetSearch(check, grid.levels[0].lattice.cell_size, settings.shrink)
    left, area = 0, 0.0
    for sample, counts in zip(samples, report.levels, strict=True):
        wrong, places = check.run(sample, counts)
        report.findings += wrong
        for k, unknown in places:
            sheet = search.from_place(unknown)
            if sheet is None:
                continue
            how = sheet.why_floor(settings.min_area) if is_asked else None
            how = "steps lead there" if sheet.reached else how
            if how is None:
                left, area = left + 1, area + sheet.area
                continue
            text = f"on {sheet.geom!r}, {sheet.area:.2f} m² or more are on no level, and {how}"
            cell, size = (sample.number, sample.cell(k)), round(sheet.area, 6)
            found = Finding(PLACE_LOST, *cell, sheet.place, text, sheet.geom, size)
            counts.lost += 1
            report.findings.append(found)
    if left:
        report.notes.append(
            f"{left} {'place' if left == 1 else 'places'} to stand, {area:.1f} m² in all, on no "
            "level: no steps lead there; too small for a floor, or the top of furniture, of a "
            "shelf, or of a roof"
        )


def _sweep(report: VerifyReport, grid: Any, probes: Probes, agent: Agent, options: Options) -> None:
    radius = report.radius if report.radius is not None else agent.radius
    if radius <= options.tolerance:
        report.notes.append("no paths were swept: the agent's radius isn't above the tolerance")
        return
    inflated = grid if report.radius is not None else grid.inflate(radius)
    try:
        swept = sweep_paths(
            inflated, probes, agent, radius, (options.paths, options.seed, options.tolerance)
        )
    except FormatError as error:
        report.notes.append(f"no paths were swept: {error}")
        return
    report.sweeps = swept[0]
    report.findings += swept[1]
    if swept[0].paths < options.paths:
        report.notes.append(f"only {swept[0].paths} paths were found between random places")


def _add_notes(report: VerifyReport, obstacles: Obstacles, unknown: list[str], grid: Any) -> None:
    surfaces = {item.geom for item in obstacles.items if not item.same_in_mujoco}
    if surfaces:
        names = sorted(obstacles.names[geom] for geom in surfaces)
        more = f" and {len(names) - 1} more count" if names[1:] else " counts"
        report.notes.append(
            f"{names[0]!r}{more} by the surface, where MuJoCo collides hulls, infinite "
            "planes or nothing: FCL and MuJoCo's rays judge alone"
        )
    if any(item.kind == UNCLEAR for item in obstacles.items):
        report.notes.append("some meshes are nearly closed: what lies inside of them isn't judged")
    if report.total.disputed:
        report.notes.append(
            f"MuJoCo and FCL contradict each other over {report.total.disputed} cells, or they lie "
            "in meshes that are nearly closed: these cells aren't counted"
        )
    if unknown:
        report.notes.append(f"the scene has no doors {', '.join(map(repr, unknown[:5]))}")
    if not grid.navbake:
        report.notes.append(
            f"the grid is of another program: an agent of {grid.agent_height:g} m, radius "
            f"{grid.agent_radius:g} m, step {grid.max_step:g} m"
        )
