"""The bake, end to end: its stages, and the grid that is put together from what they found."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navbake._version import __version__
from navbake.baker.arguments import take_input
from navbake.baker.boxes import written_ground
from navbake.baker.clock import Progress, StageClock
from navbake.baker.lattice import cut_cells
from navbake.baker.scene.isolated import CompileLimits
from navbake.baker.scene.model import OpenScene, mujoco_version
from navbake.baker.scene.scene import GeomReport
from navbake.baker.stages import Stages, settle_doors, take_first_look
from navbake.baker.warn import collect_warnings
from navbake.config.keywords import SettingKeywords
from navbake.config.settings import BakeConfig
from navbake.errors import BakeWarning
from navbake.navgrid.doors import Door, Runs, to_runs, with_door_names
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.navgrid.islands import add_layers
from navbake.navgrid.user_data import UserData
from navbake.threads import limit_threads
from navbake.types import Int, Json

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
    from navbake.verifier.verify import verify_scene

    report = verify_scene(grid, stages.scene, stages.config, sample=sample)
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


# ---------------------------------------------------------------- the grid


def build_grid(stages: Stages) -> SceneGrid2D | MultiLevelGrid:
    """Put what the stages found into the grid that is written."""
    doors = _cut_doors(stages)
    metadata = _metadata(stages, doors)
    count = len(stages.floors.levels)
    grids = [_level_grid(stages, number, doors, metadata) for number in range(count)]
    grid: SceneGrid2D | MultiLevelGrid = grids[0]
    if len(grids) > 1:
        grid = MultiLevelGrid(grids=grids, metadata=metadata, cell_size=stages.lattice.cell_size)
    add_layers(grid, stages.config.attributes)
    return grid


def _level_grid(stages: Stages, number: int, doors: Sequence[Door], metadata: Json) -> SceneGrid2D:
    """One level's grid, blocked by the doors in their states."""
    window, num_levels = stages.boxes.windows[number], len(stages.floors.levels)
    level, part = stages.floors.levels[number], stages.lattice.cut(*window)
    occupied = stages.occupancy.levels[number][window].copy()
    for door in doors:
        occupied.ravel()[door.cells_in(door.state, num_levels)[number]] = True
    attributes: dict[str, NDArray[Any]] = {
        "floorHeight": np.ascontiguousarray(stages.floor_layers[number][window]),
        "roomIndex": np.ascontiguousarray(stages.rooms.index[number][window]),
        "occupancy": occupied.view(np.uint8),
    }
    if stages.occupancy.solid is not None:
        solid = stages.occupancy.solid[number][window].copy()
        for door in doors:
            solid.ravel()[door.solid_in(door.state, num_levels)[number]] = True
        attributes["solid"] = solid.view(np.uint8)
    user_data = UserData()
    if stages.contents is not None and stages.config.names.enabled:  # read on first use
        named = stages.contents.user_data(number, window)
        user_data = with_door_names(named, doors, number, num_levels)
    return SceneGrid2D(
        width=part.width,
        height=part.height,
        cell_size=part.cell_size,
        min_yup=(part.x_min, written_ground(level), 0.0 - part.y_max),
        bbox_yup=stages.boxes.boxes[number],
        weights=np.where(occupied, np.inf, 1.0),
        attributes=attributes,
        user_data=user_data,
        metadata=metadata,
    )


def _metadata(stages: Stages, doors: Sequence[Door]) -> Json:
    config, agent, levels = stages.config, stages.config.agent, stages.floors.levels
    warned = collect_warnings(stages)
    return {
        "sceneId": stages.scene.id,
        "cellAttributes": [
            {"name": "floorHeight", "type": "Float32Array", "dataType": "continuous"},
            {"name": "roomIndex", "type": "Uint16Array", "dataType": "categorical"},
            {"name": "occupancy", "type": "Uint8Array", "dataType": "categorical"},
        ],
        "agentHeight": agent.height,
        "agentRadius": agent.radius,
        "traversableFloorHeight": agent.traversable_floor_height,
        "useCellFloorHeight": True,
        # what the format doesn't know
        "navbake": {
            "version": __version__,
            "mujoco": mujoco_version(),
            "sceneDigest": stages.scene.digest,
            **stages.stated_settings,
            "worldFrame": {
                "up": "z",
                "unit": "m",
                "handedness": "right",
                "fileFromWorld": "(X, Y, Z) = (x, z, -y)",
            },
            "maxSlope": agent.max_slope,
            "levels": [{"name": level.name, "ground": written_ground(level)} for level in levels],
            "links": _cut_links(stages).tolist(),
            "names": config.names.enabled,
            "rooms": stages.room_table,
            "doors": [_door_entry(door) for door in doors],
            **({"warnings": warned} if warned else {}),
        },
    }


def _door_entry(door: Door) -> Json:
    """A door as the file states it; see `navbake.navgrid.doors.parse_doors`."""

    def by_state(cells: Mapping[str, Mapping[int, Runs]]) -> Json:
        return {state: list(map(list, runs.items())) for state, runs in cells.items()}

    stated = {"id": door.id, "joint": door.joint, "rooms": list(door.rooms), "state": door.state}
    solid = {"solid": by_state(door.solid)} if door.solid else {}
    return {**stated, "cells": by_state(door.cells), **solid}


def _cut_doors(stages: Stages) -> list[Door]:
    """The doors in the wanted state, with cells counted on each level's own rectangle."""

    def to_file(by_state: Mapping[str, list[Int]]) -> dict[str, dict[int, list[int]]]:
        cut: dict[str, dict[int, list[int]]] = {}
        for state, levels in by_state.items():
            pairs = enumerate(zip(levels, stages.boxes.windows, strict=True))
            inside = ((k, cut_cells(*pair, stages.lattice.width)[0]) for k, pair in pairs)
            cut[state] = {number: to_runs(cells) for number, cells in inside if len(cells)}
        return cut

    wanted, doors = stages.config.doors.state, list[Door]()
    for door in stages.doors.placed:
        cells, solid = to_file(door.cells), to_file(door.solid)
        doors.append(Door(door.id, door.joint, door.rooms, door.state(wanted), cells, solid))
    return doors


def _cut_links(stages: Stages) -> Int:
    """The links with cells counted on each level's own rectangle."""
    links = stages.floors.links.copy()
    for number, window in enumerate(stages.boxes.windows):
        for level, cell in ((0, 1), (2, 3)):
            here = links[:, level] == number
            # a linked cell has a floor, so that none drops out
            links[here, cell] = cut_cells(links[here, cell], window, stages.lattice.width)[0]
    return links
