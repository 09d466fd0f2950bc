"""The bake, end to end: its stages, and the grid that is made of their results."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from navbake._version import __version__
from navbake.baker.bake.arguments import parse_arguments
from navbake.baker.bake.baked import BakedPose, BakedStructure
from navbake.baker.bake.boxes import rounded_ground
from navbake.baker.bake.stages import open_stages
from navbake.baker.bake.warnings import collect_warnings
from navbake.baker.core.clock import Progress, StageClock
from navbake.baker.core.windows import crop_cells
from navbake.baker.occupants.movable import name_occupants
from navbake.baker.scene.model import CompileLimits, SceneModel, mujoco_version
from navbake.baker.scene.scene import GeomReport, Scene
from navbake.config.keywords import SettingKeywords
from navbake.config.settings import BakeConfig
from navbake.errors import BakeWarning, printable
from navbake.navgrid.door_states import with_door_names
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.navgrid.islands import add_layers
from navbake.navgrid.links import Agent, Link, Stop
from navbake.navgrid.user_data import UserData
from navbake.threads import limit_threads
from navbake.types import Bool, Json

if TYPE_CHECKING:  # `typing` has it from Python 3.11 on
    from typing_extensions import Unpack

LOG = logging.getLogger("navbake")
# without it, Python prints warnings of loggers that nobody has set up
LOG.addHandler(logging.NullHandler())


@dataclass
class BakeResult:
    """What a bake yields: a grid, what became of each geom, and the seconds of each stage."""

    grid: SceneGrid2D | MultiLevelGrid
    geoms: list[GeomReport]
    timings: dict[str, float] = field(default_factory=dict)

    @property
    def warnings(self) -> list[str]:
        """What the user should know, one line each."""
        return list(self.grid.warnings)


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
        scene: the path of a scene (MJCF, MJB, URDF, USD, SDF, OBJ, PLY, STL, GLB, DAE) for default
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
    config, opened = parse_arguments(scene, data, settings, exclude, robot, limits)
    told = list[str]()

    def tell(hint: str) -> None:
        told.append(hint)
        warnings.warn(hint, BakeWarning, stacklevel=4)

    grid = run_bake(config, threads=threads, limits=limits, opened=opened, tell=tell).grid
    for warning in grid.warnings:
        if warning not in told:
            warnings.warn(warning, BakeWarning, stacklevel=2)
    return grid


def run_bake(
    config: BakeConfig,
    *,
    threads: int | None = None,
    progress: Progress | None = None,
    limits: CompileLimits | None = None,
    opened: SceneModel | None = None,
    tell: Callable[[str], None] | None = None,
) -> BakeResult:
    """Bake a scene, `opened` where its model is in memory, into a navigation grid.

    With `limits`, MuJoCo compiles the scene in a child process. `tell` is called early with each
    warning that axes or units look wrong.
    """
    clock = StageClock(progress)
    with limit_threads(threads):
        stages = open_stages(config, clock, limits, opened)
        scene = stages.scene
        hints = [printable(hint) for hint in scene.hints]
        for hint in hints:
            LOG.warning("%s: %s", scene.id, hint)
            if tell is not None:
                tell(hint)
        standing = stages.baked_structure
        moving = stages.baked_pose
        # gives back the memory of columns and of listed geometry, of which the grid needs none
        del stages
        scene.structure.forget_triangles()
        with clock.stage("grid"):
            grid = build_grid(config, standing, moving)
        if config.verify.sample is not None:
            with clock.stage("verify"):
                grid = _verified(grid, scene, config, config.verify.sample)
    grid.timings = clock.to_json()
    for warning in grid.warnings:
        if warning not in hints:
            LOG.warning("%s: %s", scene.id, warning)
    return BakeResult(grid, scene.geoms, clock.seconds)


def _verified(
    grid: SceneGrid2D | MultiLevelGrid, scene: Scene, config: BakeConfig, sample: int
) -> SceneGrid2D | MultiLevelGrid:
    """The grid with its verification by MuJoCo and FCL, and a warning if that disagrees."""
    # a bake that doesn't verify starts without FCL's and MuJoCo's shapes of the scene
    from navbake.verifier.verify import verify_scene

    report = verify_scene(grid, scene, config, sample=sample)
    found = len(report.findings)
    cells = report.checked
    verified = {"sample": sample, "cells": cells, "disagreements": found, "digest": report.digest}
    own: Json = {**grid.navbake, "verified": verified}
    if found:
        places = "1 place" if found == 1 else f"{found} places"
        own["warnings"] = [
            *grid.warnings,
            f"verify: MuJoCo and FCL disagree with the grid at {places}, with {cells} cells looked "
            "at; navbake verify lists them",
        ]
    checked: SceneGrid2D | MultiLevelGrid
    checked = grid.with_levels(grid.levels, {**grid.metadata, "navbake": own})
    return checked


# ---------------------------------------------------------------- the grid


def build_grid(
    config: BakeConfig, standing: BakedStructure, moving: BakedPose
) -> SceneGrid2D | MultiLevelGrid:
    """Make the grid of what stands and of what moves."""
    metadata = _metadata(config, standing, moving)
    grids = [
        _level_grid(number, config, standing, moving, metadata)
        for number in range(len(standing.floors.levels))
    ]
    grid: SceneGrid2D | MultiLevelGrid = grids[0]
    if len(grids) > 1:
        cell_size = standing.lattice.cell_size
        grid = MultiLevelGrid(grids=grids, metadata=metadata, cell_size=cell_size)
    add_layers(grid, config.attributes)
    return grid


def _level_grid(
    number: int, config: BakeConfig, standing: BakedStructure, moving: BakedPose, metadata: Json
) -> SceneGrid2D:
    """One level's grid, blocked by the doors in their states."""
    doors = [cut.door for cut in moving.grid_doors]
    window = standing.boxes.windows[number]
    level = standing.floors.levels[number]
    layers = standing.layers[number]
    part = standing.lattice.cut(*window)

    def with_doors(layer: Bool, name: str) -> NDArray[np.uint8]:
        cut = layer[window].copy()
        cells = cut.ravel()
        for door in doors:
            runs = getattr(door, name).get(door.state, {}).get(number, [])
            for first, count in zip(runs[::2], runs[1::2], strict=True):
                cells[first : first + count] = True
        return cut.view(np.uint8)

    attributes: dict[str, NDArray[Any]] = {
        "floorHeight": layers.floor,
        "roomIndex": layers.room_index,
        "occupancy": with_doors(moving.occupants.blocked[number], "cells"),
    }
    if moving.occupants.blocked_squares is not None:
        attributes["solid"] = with_doors(moving.occupants.blocked_squares[number], "solid")
    if layers.unseen is not None:
        attributes["unseen"] = layers.unseen
    if moving.areas.layers:
        attributes["area"] = np.ascontiguousarray(moving.areas.layers[number][window])
    user_data = UserData()
    if standing.occupants is not None and config.names.enabled:
        named = name_occupants(standing.occupants, moving.occupants, number, window)
        num_levels = len(standing.floors.levels)
        # found on first use
        user_data = UserData(lambda: with_door_names(named, doors, number, num_levels).source)
    return SceneGrid2D(
        width=part.width,
        height=part.height,
        cell_size=part.cell_size,
        min_yup=(part.x_min, rounded_ground(level), 0.0 - part.y_max),
        bbox_yup=standing.boxes.boxes[number],
        attributes=attributes,
        user_data=user_data,
        metadata=metadata,
    )


def _metadata(config: BakeConfig, standing: BakedStructure, moving: BakedPose) -> Json:
    agent = config.agent
    scene = moving.scene
    levels = standing.floors.levels
    warned = collect_warnings(config, standing, moving)
    agents = {name: Agent(name, **one.model_dump()) for name, one in config.agents.items()}
    by_name = {name: one.to_json() for name, one in agents.items()}
    traffic = {"areas": moving.areas.table, "agents": by_name}
    return {
        "sceneId": scene.id,
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
            "sceneDigest": scene.digest,
            **standing.settings_metadata,
            "worldFrame": {
                "up": "z",
                "unit": "m",
                "handedness": "right",
                "fileFromWorld": "(X, Y, Z) = (x, z, -y)",
            },
            "maxSlope": agent.max_slope,
            "levels": [{"name": level.name, "ground": rounded_ground(level)} for level in levels],
            "links": [*standing.steps, *_named_links(standing, moving)],
            **{name: table for name, table in traffic.items() if table},
            "names": config.names.enabled,
            "rooms": moving.room_table,
            "doors": [cut.entry for cut in moving.grid_doors],
            **({"warnings": warned} if warned else {}),
        },
    }


def _named_links(standing: BakedStructure, moving: BakedPose) -> list[Json]:
    """The named links as a file states them, with cells counted on each level's rectangle."""

    def cut(stop: Stop) -> Stop:
        window = standing.boxes.windows[stop.level]
        cells, _ = crop_cells(np.array([stop.cell]), window, standing.lattice.width)
        return replace(stop, cell=int(cells[0]))

    links = moving.links.links
    return [Link(stops=tuple(map(cut, link.stops)), **link.fields).to_json() for link in links]
