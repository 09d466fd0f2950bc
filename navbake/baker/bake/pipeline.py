"""The bake, end to end: `run_bake` runs the stages, and `build_grid` makes the grid."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from navbake._version import __version__
from navbake.baker.bake.arguments import References, parse_arguments
from navbake.baker.bake.baked import BakedPose, BakedStructure
from navbake.baker.bake.boxes import rounded_ground
from navbake.baker.bake.stages import open_stages
from navbake.baker.bake.warnings import collect_warnings
from navbake.baker.core.clock import Progress, StageClock
from navbake.baker.core.windows import crop_cells
from navbake.baker.occupants.movable import name_occupants
from navbake.baker.scene.model import CompileLimits, SceneInput, SceneModel, mujoco_version
from navbake.baker.scene.scene import GeomReport, Scene
from navbake.config.keywords import SettingKeywords
from navbake.config.settings import BakeConfig
from navbake.errors import BakeWarning, printable
from navbake.mujoco_types import MjDataLike
from navbake.navgrid.door_states import with_door_names
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.navgrid.islands import add_layers
from navbake.navgrid.links import Agent, Link, Stop
from navbake.navgrid.user_data import UserData, copy_json
from navbake.threads import baking, limit_threads
from navbake.types import Bool, Json

if TYPE_CHECKING:  # `typing` has it from Python 3.11 on
    from typing_extensions import Unpack

LOG = logging.getLogger("navbake")
# Without a handler, Python prints the warnings of loggers that nobody has set up.
LOG.addHandler(logging.NullHandler())


@dataclass
class BakeResult:
    """The result of a bake.

    Attributes:
        grid: the grid, not saved yet.
        geoms: by geom id, whether the bake uses the geom, its role, and the reason.
        timings: by name of a stage, how long the stage took [s].
    """

    grid: SceneGrid2D | MultiLevelGrid
    geoms: list[GeomReport]
    timings: dict[str, float] = field(default_factory=dict)

    @property
    def warnings(self) -> list[str]:
        """The warnings of the bake, one line each."""
        return list(self.grid.warnings)


def bake(
    scene: SceneInput,
    data: MjDataLike | None = None,
    /,
    *,
    exclude: Mapping[str, object] | None = None,
    robot: References | None = None,
    threads: int | None = None,
    isolate: bool = False,
    **settings: Unpack[SettingKeywords],
) -> SceneGrid2D | MultiLevelGrid:
    """Bake a MuJoCo scene, or a building mesh, into a navigation grid.

    The grid says for each cell of each storey how high the floor is, whether an agent can stand
    there, which room the cell belongs to, and what stands in it. Lengths are in metres, angles in
    degrees, positions in MuJoCo's world frame, z up. The first bake on a machine compiles
    navbake's kernels; ``navbake warm-up`` does that beforehand.

    Each warning is issued as a `BakeWarning`, is written to the logger ``navbake``, and stays in
    `grid.warnings`, also when the grid is saved.

    A scene in memory bakes into the same bytes as its file, where the settings name that file as
    ``scene={"path": …}``. Without a path the grid names no file, and its id is the model's name.
    ``docs/live.md`` says more.

    Args:
        scene: the path of a scene (MJCF, MJB, URDF, USD, SDF, OBJ, PLY, STL, GLB, DAE) for default
            settings; the path of a YAML file with settings; the same as a mapping; a
            `BakeConfig`; or a scene in memory: a mujoco.MjModel or MjSpec, a trimesh.Scene or
            Trimesh. It is not changed.
        data: the mujoco.MjData whose joint positions and mocap bodies are the pose to bake, where
            `scene` is a model or spec. If None, the pose is that of the settings, or else as
            modelled.
        exclude: bodies and geoms to leave out in addition to those that the settings exclude, as
            ``{"bodies": […], "geoms": […], "movable": True}``: by name, by id, by name pattern
            (``"chair*"``) or as ``model.body("table")``. All descendants of a body are left out
            with it.
        robot: the body of the robot, or several, by name, by id or as ``model.body("panda")``;
            left out with all its descendants.
        threads: number of threads, >= 1; all cores if None. The grid doesn't depend on it.
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
        ConfigError: a setting is wrong, or names a body that doesn't exist; the data belongs to a
            different model; `scene` has a type that cannot be baked.
        SceneError: the scene cannot be read or compiled, or holds nothing to bake.
        NavbakeError: this process was forked while another thread was baking.

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
    config, scene_model = parse_arguments(scene, data, settings, exclude, robot, limits)
    early_hints = list[str]()

    def warn_early(hint: str) -> None:
        early_hints.append(hint)
        warnings.warn(hint, BakeWarning, stacklevel=4)

    result = run_bake(
        config, threads=threads, limits=limits, scene_model=scene_model, warn_early=warn_early
    )
    for warning in result.grid.warnings:
        if warning not in early_hints:
            warnings.warn(warning, BakeWarning, stacklevel=2)
    return result.grid


def run_bake(
    config: BakeConfig,
    *,
    threads: int | None = None,
    progress: Progress | None = None,
    limits: CompileLimits | None = None,
    scene_model: SceneModel | None = None,
    warn_early: Callable[[str], None] | None = None,
) -> BakeResult:
    """Bake a scene into a navigation grid.

    Load the scene. Compute all that follows from structure, then all that depends on the pose.
    Make the grid from both, and verify a sample of its cells where the settings ask for it.

    Args:
        config: all settings.
        threads: number of threads, >= 1; all cores if None. The grid doesn't depend on it.
        progress: called with a stage's name and 0 when the stage begins, 1 when it ends.
        limits: limits for MuJoCo's compiler, which then runs in a child process.
        scene_model: the compiled model; None to load the file that `config` names.
        warn_early: called with each warning that axes or units look wrong, before the floors are
            found.

    Returns:
        The grid, the role of each geom, and the timings of the stages.

    Raises:
        ConfigError: the lattice would have too many cells, or would be endless.
        SceneError: the scene cannot be read, or has nothing to bake.
        NavbakeError: this process was forked while another thread was baking.
    """
    clock = StageClock(progress)
    with baking(), limit_threads(threads):
        stages = open_stages(config, clock, limits, scene_model)
        scene = stages.scene
        hints = [printable(hint) for hint in scene.hints]
        for hint in hints:
            LOG.warning("%s: %s", scene.id, hint)
            if warn_early is not None:
                warn_early(hint)
        baked_structure = stages.baked_structure
        baked_pose = stages.baked_pose
        # The grid needs neither columns nor expanded triangles: give back their memory.
        del stages
        scene.structure.forget_triangles()
        with clock.stage("grid"):
            grid = build_grid(config, baked_structure, baked_pose)
        if config.verify.sample is not None:
            with clock.stage("verify"):
                grid = _verify_grid(grid, scene, config, config.verify.sample)
    grid.timings = clock.to_json()
    for warning in grid.warnings:
        if warning not in hints:
            LOG.warning("%s: %s", scene.id, warning)
    return BakeResult(grid, scene.geoms, clock.seconds)


def _verify_grid(
    grid: SceneGrid2D | MultiLevelGrid, scene: Scene, config: BakeConfig, sample: int
) -> SceneGrid2D | MultiLevelGrid:
    """Compare a sample of cells with what MuJoCo and FCL say of them.

    Args:
        grid: the grid.
        scene: the posed scene.
        config: all settings.
        sample: how many cells to compare.

    Returns:
        The grid with the counts in its metadata, and with a warning if any cell differs.
    """
    # A bake that doesn't verify starts without FCL's and MuJoCo's shapes of the scene.
    from navbake.verifier.verify import verify_scene

    report = verify_scene(grid, scene, config, sample=sample)
    num_findings = len(report.findings)
    counts_to_store = {
        "sample": sample,
        "cells": report.checked,
        "disagreements": num_findings,
        "digest": report.digest,
    }
    metadata: Json = {**grid.navbake, "verified": counts_to_store}
    if num_findings:
        num_places_text = "1 place" if num_findings == 1 else f"{num_findings} places"
        warning = (
            f"verify: MuJoCo and FCL disagree with the grid at {num_places_text}, with "
            f"{report.checked} cells looked at; navbake verify lists them"
        )
        metadata["warnings"] = [*grid.warnings, warning]
    verified_grid: SceneGrid2D | MultiLevelGrid
    verified_grid = grid.with_levels(grid.levels, {**grid.metadata, "navbake": metadata})
    return verified_grid


# ---------------------------------------------------------------- the grid


def build_grid(
    config: BakeConfig, baked_structure: BakedStructure, baked_pose: BakedPose
) -> SceneGrid2D | MultiLevelGrid:
    """Make the grid: metadata, then the layers of each level with the doors in their states.

    Args:
        config: all settings.
        baked_structure: all that follows from structure and closed leaves.
        baked_pose: all that depends on the scene's pose.

    Returns:
        A `SceneGrid2D` for one level, a `MultiLevelGrid` for several.
    """
    metadata = _make_metadata(config, baked_structure, baked_pose)
    level_grids = [
        _build_level_grid(level, config, baked_structure, baked_pose, metadata)
        for level in range(len(baked_structure.floors.levels))
    ]
    grid: SceneGrid2D | MultiLevelGrid = level_grids[0]
    if len(level_grids) > 1:
        cell_size = baked_structure.lattice.cell_size
        grid = MultiLevelGrid(grids=level_grids, metadata=metadata, cell_size=cell_size)
    add_layers(grid, config.attributes)
    return grid


def _build_level_grid(
    level: int,
    config: BakeConfig,
    baked_structure: BakedStructure,
    baked_pose: BakedPose,
    metadata: Json,
) -> SceneGrid2D:
    """Make the grid of one level, in which doors in their states block cells."""
    doors = [grid_door.door for grid_door in baked_pose.grid_doors]
    occupants = baked_pose.occupants
    window = baked_structure.boxes.windows[level]
    layers = baked_structure.layers[level]
    lattice = baked_structure.lattice.cut(*window)

    def add_doors(is_occupied: Bool, cells_attribute: str) -> NDArray[np.uint8]:
        """Crop a layer to the level's rectangle, and add the runs of cells that doors block."""
        layer = is_occupied[window].copy()
        flat_layer = layer.ravel()
        for door in doors:
            runs = getattr(door, cells_attribute).get(door.state, {}).get(level, [])
            for first_cell, num_cells in zip(runs[::2], runs[1::2], strict=True):
                flat_layer[first_cell : first_cell + num_cells] = True
        return layer.view(np.uint8)

    attributes: dict[str, NDArray[np.generic]] = {
        "floorHeight": layers.floor,
        "roomIndex": layers.room_index,
        "occupancy": add_doors(occupants.blocked[level], "cells"),
    }
    if occupants.blocked_squares is not None:
        attributes["solid"] = add_doors(occupants.blocked_squares[level], "solid")
    if layers.unseen is not None:
        attributes["unseen"] = layers.unseen
    if baked_pose.areas.layers:
        attributes["area"] = np.ascontiguousarray(baked_pose.areas.layers[level][window])
    user_data = UserData()
    if baked_structure.named_occupants is not None:
        cell_names = name_occupants(baked_structure.named_occupants, occupants, level, window)
        num_levels = len(baked_structure.floors.levels)
        # Names are put into words when user data is first read.
        user_data = UserData(lambda: with_door_names(cell_names, doors, level, num_levels).source)
    ground = rounded_ground(baked_structure.floors.levels[level])
    return SceneGrid2D(
        width=lattice.width,
        height=lattice.height,
        cell_size=lattice.cell_size,
        min_yup=(lattice.x_min, ground, 0.0 - lattice.y_max),
        bbox_yup=baked_structure.boxes.boxes[level],
        attributes=attributes,
        user_data=user_data,
        metadata=metadata,
    )


def _make_metadata(
    config: BakeConfig, baked_structure: BakedStructure, baked_pose: BakedPose
) -> Json:
    """Make the metadata of a grid: the format's own keys, and navbake's under ``navbake``.

    They are copies: users may change them, and the grids of later updates use the same values.
    """
    agent = config.agent
    agents = {
        name: Agent(name, **settings.model_dump()).to_json()
        for name, settings in config.agents.items()
    }
    navbake_metadata: Json = {
        "version": __version__,
        "mujoco": mujoco_version(),
        "sceneDigest": baked_pose.scene.digest,
        **copy_json(baked_structure.settings_metadata),
        "worldFrame": {
            "up": "z",
            "unit": "m",
            "handedness": "right",
            "fileFromWorld": "(X, Y, Z) = (x, z, -y)",
        },
        "maxSlope": agent.max_slope,
        "levels": [
            {"name": level.name, "ground": rounded_ground(level)}
            for level in baked_structure.floors.levels
        ],
        "links": [
            *map(list, baked_structure.steps),
            *_named_links_to_json(baked_structure, baked_pose),
        ],
    }
    if baked_pose.areas.table:
        navbake_metadata["areas"] = copy_json(baked_pose.areas.table)
    if agents:
        navbake_metadata["agents"] = agents
    navbake_metadata["names"] = config.names.enabled
    if baked_structure.named_occupants is not None:
        navbake_metadata["boxes"] = copy_json(baked_pose.name_boxes)
    navbake_metadata["rooms"] = copy_json(baked_pose.room_table)
    navbake_metadata["doors"] = [copy_json(grid_door.entry) for grid_door in baked_pose.grid_doors]
    bake_warnings = collect_warnings(config, baked_structure, baked_pose)
    if bake_warnings:
        navbake_metadata["warnings"] = bake_warnings
    return {
        "sceneId": baked_pose.scene.id,
        "cellAttributes": [
            {"name": "floorHeight", "type": "Float32Array", "dataType": "continuous"},
            {"name": "roomIndex", "type": "Uint16Array", "dataType": "categorical"},
            {"name": "occupancy", "type": "Uint8Array", "dataType": "categorical"},
        ],
        "agentHeight": agent.height,
        "agentRadius": agent.radius,
        "traversableFloorHeight": agent.traversable_floor_height,
        "useCellFloorHeight": True,
        "navbake": navbake_metadata,
    }


def _named_links_to_json(baked_structure: BakedStructure, baked_pose: BakedPose) -> list[Json]:
    """Return the named links as they are written to a file.

    The cells of their stops are counted on each level's own rectangle.
    """

    def crop_stop(stop: Stop) -> Stop:
        window = baked_structure.boxes.windows[stop.level]
        cells, _ = crop_cells(np.array([stop.cell]), window, baked_structure.lattice.width)
        return replace(stop, cell=int(cells[0]))

    entries = []
    for link in baked_pose.links.links:
        stops = tuple(crop_stop(stop) for stop in link.stops)
        entries.append(Link(stops=stops, **link.fields).to_json())
    return entries
