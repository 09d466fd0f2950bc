"""Compares a grid with its scene, by MuJoCo and FCL, and with nothing of what baked it."""

from __future__ import annotations

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
from navbake.types import Float
from navbake.verifier.doors import pose_doors
from navbake.verifier.floors import FloorCheck
from navbake.verifier.lines import Lines
from navbake.verifier.lost import SheetSearch
from navbake.verifier.mesh_parts import UNCLEAR
from navbake.verifier.obstacles import Obstacles, build_obstacles
from navbake.verifier.occupancy import Footprint, OccupancyCheck
from navbake.verifier.probes import Probes
from navbake.verifier.report import (
    BLOCKED_APART,
    PLACE_LOST,
    Finding,
    LevelCounts,
    VerifyReport,
)
from navbake.verifier.sample import Agent, Bands, LevelSample, baked_bands, take_sample
from navbake.verifier.source import SceneSource, find_source
from navbake.verifier.surroundings import Surroundings
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
            grid names, beside the grid or in the current folder.
        sample: how many cells to look at, >= 1, drawn from those of all levels; all if None.
        seed: of the sample and of the paths.
        radius: of the cylinder that stands on free cells [m], and runs along paths: that of the
            grid's inflation if None, else the baked footprint. A grid that isn't inflated is
            inflated for it.
        paths: how many paths to plan and to sweep a cylinder along.
        tolerance: what touches by less than this touches by rounding [m], > 0.
        force: compare with a scene that isn't the one that was baked.
        data: the mujoco.MjData with the pose of a model or spec; the pose that the grid states,
            a keyframe and joints, if None.

    Raises:
        QueryError: there is no scene, or it isn't the grid's; an option is out of its range.
        SceneError, ConfigError, FormatError: the scene, settings or grid can't be read.
    """
    options = Options(sample, seed, radius, paths, tolerance)
    _check_options(options)
    path = None if isinstance(grid, GridBase) else Path(grid)
    content: Any = grid if path is None else read_navgrid(path)
    source = find_source(content, scene, path, force=force, data=data)
    floors = floors_to_expect(source.config) if source.are_known else None
    return verify_scene(content, source.scene, options, floors, source.notes)


def floors_to_expect(config: BakeConfig) -> FloorSettings | None:
    """The settings of floors by which a storey may be missed; None if some may be left out."""
    all_count = config.levels == "auto" and config.floors.reach == "all"
    return config.floors if all_count else None


def verify_scene(
    grid: NavGrid,
    scene: Scene,
    options: Options,
    floors: FloorSettings | None,
    notes: Sequence[str] = (),
) -> VerifyReport:
    """Compare a grid with a loaded scene.

    Args:
        floors: the settings of the bake, where they are known and leave out no storeys.
        notes: what the report is to say first.
    """
    content: Any = grid.without_blocks()
    notes = [*notes, *(["what was blocked at run time is left out"] if grid.is_blocked else [])]
    content, radius = _inflated(content, options.radius, notes)
    agent, doors = Agent.of(content), pose_doors(scene, content)
    obstacles = build_obstacles(scene, doors.data, doors.removed)
    fixed = build_obstacles(scene, doors.data, doors.geoms) if doors.geoms else obstacles
    report = VerifyReport(
        scene_id=content.scene_id,
        num_cells=sum(level.width * level.height for level in content.levels),
        seed=options.seed,
        tolerance=options.tolerance,
        radius=radius,
        notes=notes,
    )
    samples = take_sample(content, options.sample, options.seed)
    report.levels = [LevelCounts(name) for name in content.level_names]
    for sample, counts in zip(samples, report.levels, strict=True):
        counts.cells = len(sample)
    probes, lines = Probes(obstacles), Lines(obstacles)
    check = OccupancyCheck(probes, lines, agent, options.tolerance)
    around = Surroundings(content, agent.step)
    for sample, counts in zip(samples, report.levels, strict=True):
        footprint, bands = _volume(sample, agent, around, radius)
        report.findings += check.run(sample, counts, footprint, bands)
        if radius is not None:
            report.findings += _check_inflation(sample, counts, around, radius, content)
    _check_floors(report, content, samples, FloorCheck(content, Lines(fixed), agent), floors)
    if options.paths:
        _sweep(report, content, probes, agent, options)
    _add_notes(report, obstacles, doors.unknown, content)
    report.findings.sort(key=lambda found: (found.level, found.cell or (-1, -1), found.kind))
    return report


def _check_options(options: Options) -> None:
    if options.radius is not None and not 0 <= options.radius < np.inf:
        raise QueryError(f"expected a radius >= 0 m, got {options.radius!r}")
    if not 0 < options.tolerance < np.inf:
        raise QueryError(f"expected a tolerance > 0 m, got {options.tolerance!r}")
    if options.paths < 0:
        raise QueryError(f"expected a number of paths >= 0, got {options.paths!r}")
    if options.sample is not None and options.sample < 1:
        raise QueryError(f"expected a sample of at least 1 cell, got {options.sample!r}")


def _inflated(grid: Any, radius: float | None, notes: list[str]) -> tuple[Any, float | None]:
    """The grid for a radius, and the radius of the cylinder that stands on its free cells [m]."""
    stated = grid.metadata.get("inflation")
    done = (
        [entry for entry in stated if isinstance(entry, dict)] if isinstance(stated, list) else []
    )
    if not done:
        return (grid, None) if radius is None else (grid.inflate(radius), radius)
    if radius is not None:
        return grid, radius
    exact = [e["radius"] for e in done if e.get("mode") == "exact" and "radius" in e]
    if len(exact) < len(done):
        notes.append(
            "inflated in the mode minos, which measures from the centres of cells: free cells are "
            "judged by the baked footprint"
        )
        return grid, None
    return grid, max(float(r) for r in exact)


def _volume(
    sample: LevelSample, agent: Agent, around: Surroundings, radius: float | None
) -> tuple[Footprint, Bands]:
    """What has to be free over the floor of a free cell.

    For a larger agent, it is the cylinder between the heights that all floors under it leave free.
    """
    if radius is None:
        return agent.footprint(sample.level.lattice.cell_size), baked_bands(sample, agent)
    cells = sample.rows, sample.cols
    low, high = around.floors_under(sample.number, *cells, sample.floor, radius)
    return [(radius, True)] if radius > 0 else [], Bands(high + agent.step, low + agent.height)


def _check_inflation(
    sample: LevelSample, counts: LevelCounts, around: Surroundings, radius: float, grid: Any
) -> list[Finding]:
    """The cells that an inflation closed without a reason within the radius."""
    asked = ~sample.free & ~sample.occupied & ~np.isnan(sample.floor)
    cells = np.flatnonzero(asked)
    # a cell's own square, so that what a margin of a clearance closed has a reason as well
    reach = radius + grid.levels[sample.number].lattice.cell_size * 1e-6
    reasons = around.has_reason(
        sample.number, sample.rows[cells], sample.cols[cells], sample.floor[cells], reach
    )
    findings = []
    for cell in cells[~reasons].tolist():
        counts.blocked_blocked -= 1
        counts.blocked_apart += 1
        place: Float = np.array([*sample.xy[cell], sample.floor[cell]])
        text = f"is blocked for {radius:g} m, but nothing within that radius is in the way"
        at = int(sample.rows[cell]), int(sample.cols[cell])
        x, y, z = place.tolist()
        findings.append(Finding(BLOCKED_APART, sample.number, at, (x, y, z), text))
    return findings


def _check_floors(
    report: VerifyReport,
    grid: Any,
    samples: list[LevelSample],
    check: FloorCheck,
    floors: FloorSettings | None,
) -> None:
    stated = [level.uses_cell_floors for level in grid.levels]
    if not all(stated):
        report.notes.append(
            "the grid states no floors of cells, so cells are judged over their level's ground, "
            "and neither floors nor lost places are looked for"
        )
        return
    settings = floors or FloorSettings()
    search = SheetSearch(check, check.agent, grid.levels[0].lattice.cell_size, settings.shrink)
    left, area = 0, 0.0
    for sample, counts in zip(samples, report.levels, strict=True):
        wrong = check.check_floors(sample, counts)
        report.findings += wrong
        for unknown in check.find_unknown(sample, {found.cell for found in wrong}):
            row, col = check.on_lowest(sample.number, unknown.cell)
            sheet = search.from_place(row, col, unknown.place[2], exact=unknown.is_step)
            if sheet is None or (unknown.is_step and not sheet.reached):
                continue
            is_storey = floors is not None and sheet.is_storey(settings.min_area)
            if not sheet.reached and not is_storey:
                left, area = left + 1, area + sheet.area
                continue
            how = "steps lead there" if sheet.reached else "it has walls all round"
            text = f"on {sheet.geom!r}, {sheet.area:.2f} m² or more are on no level, and {how}"
            cell, size = (sample.number, unknown.cell), round(sheet.area, 6)
            found = Finding(PLACE_LOST, *cell, sheet.place, text, sheet.geom, size)
            counts.lost += 1
            report.findings.append(found)
    if left:
        report.notes.append(
            f"{left} places to stand, {area:.1f} m², are on no level: no steps lead there, and "
            "none has walls all round, so they are tops of furniture, shelves or roofs"
        )


def _sweep(report: VerifyReport, grid: Any, probes: Probes, agent: Agent, options: Options) -> None:
    radius = report.radius if report.radius is not None else agent.radius
    if radius <= 0:
        report.notes.append("no paths were swept: the agent has no radius")
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
