"""Compares a grid with its scene, by MuJoCo and FCL, and with nothing of what baked it."""

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
from navbake.navgrid.grid import GridBase, NavGrid
from navbake.verifier.cells import FloorCheck, OccupancyCheck
from navbake.verifier.obstacles import UNCLEAR, Obstacles
from navbake.verifier.probes import ObstacleProbe
from navbake.verifier.report import Finding, LevelCounts, VerifyReport
from navbake.verifier.sample import (
    AgentSizes,
    CellNeighborhood,
    has_cell_floors,
    inflate_for,
    take_sample,
    volume_over,
)
from navbake.verifier.source import SceneSource, find_source, pose_doors
from navbake.verifier.sweeps import PathSweep, check_links

SAMPLE = 100_000  # cells that are looked at unless told otherwise
TOLERANCE = 1e-4  # what touches by less than this touches by rounding [m]


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

    MuJoCo and FCL say what the volume over a cell touches, and MuJoCo's rays whether each floor is
    a surface, and whether a place to stand is on no level. It shares the loading of the scene
    alone with the code that baked the grid. `docs/verify.md` says what agreement means.

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
    whole = int | np.integer
    number = int | float | np.integer | np.floating
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
    found, config, notes = find_source(content, scene, path, force=force, data=data)
    options: Any = {"sample": sample, "seed": seed, "radius": radius, "paths": paths}
    options |= {"tolerance": tolerance, "notes": notes}
    return verify_scene(content, found, config, **options)


def verify_scene(
    grid: NavGrid,
    scene: Scene,
    config: BakeConfig | None,
    *,
    sample: int | None = SAMPLE,
    seed: int = 0,
    radius: float | None = None,
    paths: int = 0,
    tolerance: float = TOLERANCE,
    notes: Sequence[str] = (),
) -> VerifyReport:
    """Compare a grid with a loaded scene, with the settings of the bake, where they are known.

    Notes come first in the report. Raises as `verify`.
    """
    content: Any = grid.without_blocks()
    body = AgentSizes.of_grid(content)
    notes = list(notes)
    doors = pose_doors(scene, content)
    most = min(content.levels[0].lattice.cell_size, body.height - body.step) / 4
    if tolerance > most:
        raise QueryError(
            f"expected a tolerance of at most {most:g} m, got {tolerance:g}: volumes are made "
            "smaller by it on all sides, and half of a cell's width and of the height has to stay"
        )
    with_floors = [has_cell_floors(level) for level in content.levels]
    content, cylinder, reach, by_centres = inflate_for(content, radius, notes)
    if reach > 0 and config is not None and config.grid.bounds is not None:
        note = "`grid.bounds` cut the grid, which knows nothing of what lies beyond"
        notes.append(f"{note}: a larger agent's cylinder may touch it")
    if grid.is_blocked:
        notes.append("what was blocked at run time is left out")
    num_cells = sum(level.width * level.height for level in content.levels)
    levels = []
    obstacles = Obstacles(scene, doors.data, doors.removed)
    findings = list[Finding]()
    probes = ObstacleProbe(obstacles)
    check = OccupancyCheck(probes, body, tolerance, reach)
    around = CellNeighborhood(content, body.step, by_centers=by_centres)
    floors = None
    if all(with_floors):
        fixed = Obstacles(scene, doors.data, doors.no_floors) if doors.no_floors else obstacles
        floors = FloorCheck(content, ObstacleProbe(fixed), body, config)
    samples = take_sample(content, sample, seed, with_floors)
    for own, name in zip(samples, content.level_names, strict=True):
        levels.append(counts := LevelCounts(name, cells=len(own.rows)))
        # what an inflation closed for a reason; all else has to touch something by itself
        excused = (reach > 0) & ~own.free & ~own.occupied & ~np.isnan(own.floor)
        closed = own.rows[excused], own.cols[excused], own.floor[excused]
        excused[excused] = around.has_reason(own.level_id, *closed, reach)
        findings += check.check_free(own, counts, volume_over(own, body, around, cylinder))
        findings += check.check_blocked(own, counts, volume_over(own, body, around), excused)
        findings += [] if floors is None else floors.check(own, counts)
    of_links, unchecked = check_links(grid, scene, probes, body, tolerance)
    findings += of_links
    notes += unchecked
    if floors is None:
        notes.append(
            "the grid states no floors of cells, so cells are judged over their level's ground: "
            "free ones need a floor within a step of it, and lost places aren't looked for"
        )
    elif floors.num_ignored_regions:
        notes.append(
            f"{count_of(floors.num_ignored_regions, 'place')} to stand, "
            f"{floors.ignored_area:.1f} m² in all, on no level: no steps lead there; too small for "
            "a floor, or the top of furniture, of a shelf, or of a roof"
        )
    if check.num_groundless:
        why = "the scene has no place to stand there within a step of their level's ground"
        notes.append(f"{check.num_groundless} blocked cells touch nothing, but {why}")
    swept = None
    width = body.radius if cylinder is None else cylinder
    if paths and width <= tolerance:
        notes.append("no paths were swept: the agent's radius isn't above the tolerance")
    elif paths:
        inflated = content if cylinder is not None else content.inflate(width)
        try:
            swept, touching = PathSweep(inflated, probes, body, width, tolerance).run(paths, seed)
            findings += touching
            if swept.paths < paths:
                notes.append(f"only {swept.paths} paths were found between random places")
        except FormatError as error:
            notes.append(f"no paths were swept: {error}")
    findings.sort(key=lambda found: (found.level, found.cell or (-1, -1), found.kind))
    report = VerifyReport(
        content.scene_id, num_cells, seed, tolerance, cylinder, levels, swept, findings, notes
    )
    surfaces = {item.geom for item in obstacles.shapes if not item.is_same_in_mujoco}
    if surfaces:
        names = sorted(obstacles.geom_names[geom] for geom in surfaces)
        more = f" and {len(names) - 1} more count" if names[1:] else " counts"
        why = "where MuJoCo collides hulls, infinite planes or nothing: FCL and MuJoCo's rays judge"
        notes.append(f"{names[0]!r}{more} by the surface, {why} alone")
    if any(item.kind == UNCLEAR for item in obstacles.shapes):
        notes.append("some meshes are nearly closed: what lies inside of them isn't judged")
    if report.total.disputed:
        note = f"MuJoCo and FCL contradict each other over {report.total.disputed} cells"
        why = "or they lie in meshes that are nearly closed"
        notes.append(f"{note}, {why}: these cells aren't counted")
    if doors.unknown:
        notes.append(f"the scene has no doors {', '.join(map(repr, doors.unknown[:5]))}")
    if not content.navbake:
        sizes = f"radius {content.agent_radius:g} m, step {content.max_step:g} m"
        note = f"the grid is of another program: an agent of {content.agent_height:g} m"
        notes.append(f"{note}, {sizes}")
    return report
