"""The settings of a bake, read from YAML and validated.

Each section is a class; the description of a field has its meaning, unit, range and default.
Lengths are in metres, positions in the world frame (z up), unless a description says otherwise.
"""

import hashlib
import itertools
import json
import os
import re
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    PrivateAttr,
    Tag,
    ValidationError,
    ValidationInfo,
    model_validator,
)

from navbake import samples
from navbake.config.field_types import (
    AlsoAcceptsInSchema,
    FilePath,
    Index,
    LevelKey,
    Name,
    NotNegative,
    OneOrMore,
    OptionalName,
    Outline,
    Patterns,
    Point3,
    Position,
    Positive,
    Section,
    Settings,
    expected_error,
    make_config_error,
    read_if_file,
    refuse_if,
    replace_error_text,
    resolve_path_setting,
    section,
    setting,
)
from navbake.config.links import Areas, AreaSettings, Links, LinkSettings, NamedAgent
from navbake.errors import ConfigError
from navbake.files import can_be_path, hint_at_file, readable_stem
from navbake.formats.scene_files import BUILDING_SUFFIXES, SCENE_SUFFIXES, scene_suffix
from navbake.formats.shapes import read_room_outlines
from navbake.known_names import append_hint
from navbake.types import Json, JsonValue
from navbake.yaml_text import apply_overrides, read_yaml

MeshMode = Literal["auto", "hull", "surface", "shell"]
"""How a mesh counts.

``hull``: its convex hull, solid; ``surface``: its triangles, solid where they close; ``shell``: its
triangles, nowhere solid; ``auto``: the bake chooses.
"""


def make_memory_path(name: str) -> Path:
    """Return the path that stands for a scene in memory, from its name: ``<apartment>``."""
    name = "".join(char if char.isprintable() and char not in "/\\" else "_" for char in name)
    return Path(f"<{name if name.strip('. ') else 'scene'}>")


def is_memory_path(path: str | PathLike[str]) -> bool:
    """Return whether a path stands for a scene in memory without a file."""
    return str(path).startswith("<") and str(path).endswith(">")


def find_scene_stem(path: str | PathLike[str]) -> str:
    """Return the name of a scene: a file's name without its ending, or the name in memory."""
    if is_memory_path(path):
        return str(path)[1:-1]
    stem = readable_stem(path)
    return stem.removesuffix(".building") if scene_suffix(path) in BUILDING_SUFFIXES else stem


Folder = Annotated[FilePath, AfterValidator(resolve_path_setting)]
ScenePath = Annotated[Folder, replace_error_text("the path of a scene file")]
refuse_wrong_id = refuse_if(
    lambda text: text in (".", "..") or not text.isprintable() or set(text) & set("/\\")
)
SceneId = Annotated[
    str,
    Field(min_length=1),
    AfterValidator(refuse_wrong_id),
    replace_error_text("text without / and \\ (a number needs quotes)"),
]


class ExcludeSettings(Settings):
    """The section ``scene.exclude``: bodies and geoms that a bake leaves out."""

    bodies: Patterns = setting([], "body name patterns (*, ?, [...]), with child bodies")
    geoms: Patterns = setting([], "geom name patterns")
    movable: bool = setting(
        False, "true: leave out all bodies that can move, but for doors; or false"
    )


MAX_SCAN_HOLE_AREA = (
    2.0  # largest hole that is closed in the floor of a scan: its `floors.fill` [m²]
)
RefuseZero = AfterValidator(
    refuse_if(lambda vector: sum(value * value for value in vector) < 1e-12)
)


class SceneSettings(Settings):
    """The section ``scene``: the scene's file, how it is read, its pose, and what of it counts."""

    id: SceneId = setting("", "the scene's id, without / and \\", "the scene file's stem")
    path: ScenePath = Field(
        description="MJCF, MJB, URDF, USD, SDF, OBJ, PLY, STL, GLB or DAE, relative to this file; "
        "no default"
    )
    up: Annotated[
        Literal["auto", "level", "x", "-x", "y", "-y", "z", "-z"] | Annotated[Point3, RefuseZero],
        replace_error_text("auto, level, an axis (x, -x, y, -y, z, -z) or a direction [x, y, z]"),
    ] = setting(
        "auto",
        "what is up in mesh files: an axis (x, -x, y, -y, z, -z), a direction [x, y, z], level (as "
        "what stands on its flat surfaces says), or auto: as the file says, else z",
    )
    scan: bool = setting(
        False,
        "whether the mesh is a scan: true (up: level where the file says no axis, "
        "floors.fill: 2.0, pieces below 0.1 m2 left out) or false",
    )
    unit: Positive = setting(1.0, "the unit of mesh files [m], > 0; of USD in place of its own")
    model_path: Annotated[list[Folder], OneOrMore] = setting(
        [],
        "folders of the models of an SDF scene (model://…), or of the ROS packages of a URDF, "
        "relative to this file",
    )
    strict: bool = setting(
        False,
        "whether models and meshes of an SDF that aren't there are an error; else they are left "
        "out, and a warning lists them",
    )
    geoms: Literal["auto", "collision", "visual", "all"] = setting(
        "auto", "auto (those that can collide, or all if none can), collision, visual, all"
    )
    # with tags, pydantic checks one branch of the union, so that errors are about that one
    meshes: Annotated[
        Annotated[
            MeshMode,
            replace_error_text("auto, hull, surface, shell or {pattern: one of these}"),
            Tag("=one"),
        ]
        | Annotated[dict[Name, MeshMode], Tag("=each")],
        Discriminator(lambda value: "=each" if isinstance(value, dict) else "=one"),
    ] = setting("auto", "hull, surface, shell (never solid), auto, or {name pattern: hull}")
    ground: Annotated[float | None, replace_error_text("a height in metres, or null")] = setting(
        None, "height of endless ground that is added [m], or null"
    )
    exclude: Section[ExcludeSettings] = section(ExcludeSettings, "what is left out, by pattern")
    keyframe: Annotated[
        str | Index | None, replace_error_text("a keyframe's name or index, or null")
    ] = setting(None, "pose: a keyframe's name, or index >= 0, or null")
    joints: dict[
        Name, Annotated[float | list[float], replace_error_text("a number or a list of numbers")]
    ] = setting({}, "pose, after the keyframe: {joint name: position [m or rad], or a list}")

    @model_validator(mode="before")
    @classmethod
    def _default_id(cls, settings: object) -> object:
        """Set `id` to its default: the stem of the path."""
        if isinstance(settings, Mapping) and settings.get("id") is None:
            path = settings.get("path")
            stem = ""
            if isinstance(path, str | PathLike) and can_be_path(str(path)):
                stem = find_scene_stem(path)
            return {**settings, "id": stem or "scene"}
        return settings


DEFAULT_GEOMS = ("room|*", "room_*", "floor|*")
DEFAULT_SITES = ("room*",)
RoomSource = Literal["polygons", "geoms", "sites", "auto"]
DoorWidth = Annotated[Literal["auto"] | Positive, replace_error_text("a number > 0, or auto")]
OnceEach = AfterValidator(refuse_if(lambda value: len(set(value)) < len(value)))


class RoomPolygon(Settings):
    """An entry of ``rooms.polygons``: a room with its outline."""

    name: OptionalName = setting(None, "its name, or null")
    level: LevelKey = setting(0, "its level: a number, 0 is the lowest, or a name")
    outdoors: bool = setting(False, "whether it is outdoors: true or false")
    points: Outline = Field(description="its outline [[x, y], …], world frame [m]; no default")
    rings: list[Outline] = setting([], "holes in it and parts apart from it, [[[x, y], …], …] [m]")


class RoomSettings(Settings):
    """The section ``rooms``: how the floor is divided into rooms."""

    # `from` is a keyword of Python, so it is an alias of `sources`
    model_config = ConfigDict(**Settings.model_config, populate_by_name=True)

    sources: Annotated[
        list[RoomSource],
        OnceEach,
        replace_error_text("a list of some of polygons, geoms, sites, auto, each once"),
    ] = Field(
        default=["polygons", "geoms", "sites", "auto"],
        alias="from",
        description="polygons, geoms, sites, auto, in order of preference: a cell gets its room "
        "from the first that covers it, auto divides the rest at doors; default all four",
    )
    geoms: Patterns = setting(list(DEFAULT_GEOMS), "floor geoms, by name patterns")
    sites: Patterns = setting(list(DEFAULT_SITES), "sites as volumes, by name patterns")
    polygons: Annotated[
        list[RoomPolygon],
        BeforeValidator(read_if_file("rooms.polygons", read_room_outlines)),
        AlsoAcceptsInSchema("string", "null"),
    ] = setting(
        [],
        "outlines in metres: a GeoJSON file, relative to this file, or a list of "
        "{name: hall, level: 0, points: [[0, 0], [4, 0], [4, 3]]}",
    )
    door_width: DoorWidth = setting(
        "auto",
        "auto: no gap wider than this separates rooms [m], > 0, and none that is nearly as wide as "
        "the spaces on both sides; or auto: 2.5, at the mouth of a long passage 3.2",
    )
    min_area: NotNegative = setting(1.0, "auto, sites: smallest area of a room [m2], >= 0")


def expand_rooms(value: object) -> object:
    """Expand ``rooms: auto``, ``rooms: none`` and null to the sections that they stand for."""
    if value is None:
        return {}
    if value == "auto":
        return {"from": ["auto"]}
    if value == "none":
        return {"from": []}
    if not isinstance(value, Mapping | RoomSettings):
        raise expected_error("auto, none or a mapping")
    return value


YAML_SUFFIXES = (".yaml", ".yml")
# matches in the YAML of a building that has lifts
LIFTS_KEY = re.compile(rb"^lifts:\s+[^\s{]", re.MULTILINE)
MAP_KEYS = frozenset({"image", "resolution", "origin"})  # keys in the YAML of a nav2 map


def _check_below_height(value: float, info: ValidationInfo) -> float:
    """Refuse a step that is not lower than the agent."""
    height = info.data.get("height")
    if height is not None and value >= height:
        raise expected_error(f"a number >= 0 and < `agent.height` ({height:g})")
    return value


def _check_above_ground(value: float | None, info: ValidationInfo) -> float | None:
    """Refuse a level's top that is not above its ground."""
    ground = info.data.get("ground")
    if value is not None and ground is not None and value <= ground:
        raise expected_error(f"a number > `ground` ({ground:g}), or null")
    return value


class AgentSettings(Settings):
    """The section ``agent``: the dimensions of the robot, and what it can climb."""

    height: Positive = setting(1.14, "height of the agent [m], > 0")
    radius: NotNegative = setting(0.05, "radius of its footprint [m], >= 0")
    traversable_floor_height: Annotated[NotNegative, AfterValidator(_check_below_height)] = setting(
        0.25, "highest step; what is lower is no obstacle [m], >= 0, < height"
    )
    max_slope: Annotated[
        float, Field(ge=0, le=89.9), replace_error_text("a number of degrees from 0 to 89.9")
    ] = setting(45.0, "steepest floor [degrees], 0 to 89.9")


class GridSettings(Settings):
    """The section ``grid``: the size and the extent of the cells."""

    cell_size: Positive = setting(0.1, "edge of a cell [m], > 0")
    bounds: Annotated[
        Annotated[
            list[float],
            Field(min_length=4, max_length=4),
            AfterValidator(refuse_if(lambda box: box[0] >= box[2] or box[1] >= box[3])),
        ]
        | None,
        replace_error_text("[x_min, y_min, x_max, y_max] with min < max, or null"),
    ] = setting(None, "[x_min, y_min, x_max, y_max] of a part [m], or null")
    margin: NotNegative = setting(0.0, "added on each side [m], >= 0")
    max_cells: Annotated[int, Field(ge=1), replace_error_text("a whole number >= 1")] = setting(
        25_000_000, "refuse more cells than this, >= 1"
    )


class LevelSettings(Settings):
    """An entry of ``levels``: one storey."""

    ground: float = Field(description="height of the level's ground, world z [m]; no default")
    top: Annotated[
        float | None,
        replace_error_text("a number > ground, or null"),
        AfterValidator(_check_above_ground),
    ] = setting(None, "height where it ends [m], > ground", "the next level's ground")
    name: OptionalName = setting(None, "its name, or null")


class FloorSettings(Settings):
    """The section ``floors``: which surfaces are floors."""

    # `from` is a keyword of Python, so it is an alias of `starts`
    model_config = ConfigDict(**Settings.model_config, populate_by_name=True)

    min_area: NotNegative = setting(1.0, "smallest area of a floor, after shrinking [m2], >= 0")
    shrink: NotNegative = setting(0.3, "distance to shrink floors by for that [m], >= 0")
    crack: NotNegative = setting(0.03, "floors nearer than this have no gap between [m], >= 0")
    fill: NotNegative = setting(
        0.0,
        "largest hole that is closed where floor surrounds it, for scans [m2], >= 0",
        "0.0, or 2.0 with `scene.scan`",
    )
    tops: bool = setting(False, "keep large tops of things on a floor (beds): true or false")
    roofs: bool = setting(False, "keep roofs as levels: true or false")
    voids: bool = setting(False, "keep voids under 1.8 m (plenums) as levels: true or false")
    reach: Literal["all", "steps"] = setting("all", "floors: all, or those that steps lead to")
    movable: Patterns = setting(
        [], "body name patterns of what carries floors though it moves (a drawbridge, a stage)"
    )
    starts: list[Position] = Field(
        default=[],
        alias="from",
        description="places that count as reached, a list of [x, y, z] [m]; default the largest "
        "floor of the lowest level",
    )


class NameSettings(Settings):
    """The section ``names``: names of what stands in the cells."""

    enabled: bool = setting(True, "write them: true or false")
    walls: Patterns = setting([], "patterns of walls: bodies, geoms or meshes", "[], by shape")


class DoorSettings(Settings):
    """The section ``doors``: which bodies are doors, and their state."""

    patterns: Patterns = setting([], "body name patterns of doors (*, ?, [...])")
    find: bool = setting(True, "find doors between rooms by shape and joint: true or false")
    state: Literal["modelled", "open", "closed", "removed"] = setting(
        "modelled", "state of all doors: modelled, open, closed or removed"
    )


class VerifySettings(Settings):
    """The section ``verify``: comparing the grid with the scene after the bake."""

    sample: Annotated[
        int | None, Field(ge=1), replace_error_text("a whole number >= 1, or null")
    ] = setting(None, "how many cells to look at after the bake, or null for none")


def _check_ascending(levels: list[LevelSettings]) -> list[LevelSettings]:
    """Refuse levels that overlap, are not in ascending order, or have the same name."""
    names: set[str] = set()
    for index, level in enumerate(levels):
        if level.name in names:
            raise expected_error("no name twice", got=f'"{level.name}"', at=f"[{index}].name")
        if level.name:
            names.add(level.name)
    for index, (level_below, level) in enumerate(itertools.pairwise(levels)):
        if level.ground <= level_below.ground:
            text = f"a ground above that of the level before ({level_below.ground:g})"
            raise expected_error(text, got=f"{level.ground:g}", at=f"[{index + 1}].ground")
        if level_below.top is not None and level_below.top > level.ground:
            text = f"a top up to the next level's ground ({level.ground:g})"
            raise expected_error(text, got=f"{level_below.top:g}", at=f"[{index}].top")
    return levels


class BakeConfig(Settings):
    """All settings of a bake; see docs/settings.md.

    Example:
        >>> config = BakeConfig.model_validate({"scene": {"path": "house.xml"}})
        >>> grid = navbake.bake(config)
    """

    scene: Section[SceneSettings] = Field(description="the scene: what of it counts, its pose")
    agent: Section[AgentSettings] = section(AgentSettings, "the agent that must fit")
    grid: Section[GridSettings] = section(GridSettings, "the cells")
    # for the tags, see `scene.meshes`
    levels: Annotated[
        Annotated[
            Literal["auto"],
            replace_error_text("auto or a list of {ground: …, top: …, name: …}"),
            Tag("=auto"),
        ]
        | Annotated[
            list[LevelSettings], Field(min_length=1), AfterValidator(_check_ascending), Tag("=list")
        ],
        Discriminator(lambda value: "=list" if isinstance(value, list) and value else "=auto"),
    ] = setting(
        "auto",
        "the storeys: auto, or a list, lowest first, of {ground: 0.0, top: 2.7, name: first floor}"
        " [m]; top and name may be left out",
    )
    floors: Section[FloorSettings] = section(FloorSettings, "which surfaces are floors")
    names: Annotated[
        Section[NameSettings],  # `names: false` is short for `names: {enabled: false}`
        BeforeValidator(lambda value: {"enabled": value} if isinstance(value, bool) else value),
        AlsoAcceptsInSchema("boolean"),
    ] = section(NameSettings, "names of what stands in the cells, or false")
    rooms: Annotated[
        RoomSettings,
        BeforeValidator(expand_rooms),
        AlsoAcceptsInSchema("null", words=("auto", "none")),
    ] = section(
        RoomSettings,
        "how rooms are told apart; `rooms: auto` divides at doors only, none: no rooms",
    )
    doors: Section[DoorSettings] = section(DoorSettings, "which bodies are doors, and their state")
    agents: Annotated[
        dict[Name, NamedAgent],
        BeforeValidator(lambda value: value or {}),
        AlsoAcceptsInSchema("null"),
    ] = setting(
        {}, "agents by name, for links and areas: {robot: {radius: 0.3, height: 1.2, speed: 0.8}}"
    )
    areas: Areas = setting(
        [],
        "areas with a price, a speed or a ban, later ones win: a JSON or GeoJSON file, or a list "
        "of {name: lab, room: lab, cost: .inf}, of a room, a polygon, a box or geoms",
    )
    links: Links = setting(
        [],
        "ways between places that no step joins: a JSON or GeoJSON file, or a list of {name: A, "
        "kind: lift, stops: [[3, 2, 0], [3, 2, 3]], seconds: 12}, and of {auto: drop} to find some",
    )
    attributes: Annotated[
        list[Literal["island", "clearance"]],
        OnceEach,
        replace_error_text("a list of some of island, clearance, each once"),
    ] = setting([], "further layers to write: island, clearance")
    verify: Section[VerifySettings] = section(VerifySettings, "comparing grid and scene")
    output: FilePath | None = setting(None, "file, from the current folder on", "<id>.grid.json")
    _input_files: tuple[Path, ...] = PrivateAttr(())
    _settings_file: str = PrivateAttr("")

    @model_validator(mode="before")
    @classmethod
    def _default_fill(cls, settings: object) -> object:
        """Set `floors.fill` to its default for scans."""
        if isinstance(settings, Mapping):
            scene = settings.get("scene")
            floors = settings.get("floors") or {}
            is_scan = isinstance(scene, Mapping) and scene.get("scan") is True
            if is_scan and isinstance(floors, Mapping) and "fill" not in floors:
                return {**settings, "floors": {**floors, "fill": MAX_SCAN_HOLE_AREA}}
        return settings

    @property
    def inputs(self) -> tuple[Path, ...]:
        """The files that a bake reads: the scene, and files of room outlines, areas and links."""
        return (Path(self.scene.path), *self._input_files)

    @property
    def settings_file(self) -> str:
        """The YAML file that `scene.path` was read from, for messages; "" for none."""
        return self._settings_file

    def __eq__(self, other: object) -> bool:
        """Return whether all settings are equal, whatever files they are read from."""
        return isinstance(other, BakeConfig) and self.__dict__ == other.__dict__


def find_source(path: str | PathLike[str]) -> Path:
    """Return the path of a scene or of settings.

    Args:
        path: The path, which is returned as it is; or the bare name of a sample, whose path is
            returned.

    Raises:
        ConfigError: The path belongs to a grid.
    """
    if str(path).lower().endswith((".grid.json", ".json.gz")):
        hint = (
            f"`navbake info {path}` describes it, `navbake inflate {path} RADIUS -o FILE` makes "
            "another one of it, navbake.load reads it in Python"
        )
        raise ConfigError(f"{path} is a grid, not a scene: {hint}", path=str(path), hint=hint)
    return samples.find(path)


def is_settings(path: str | PathLike[str]) -> bool:
    """Return whether a file holds settings, not a scene, by the ending of its name."""
    return scene_suffix(path) in YAML_SUFFIXES


def make_default_settings(scene: Path) -> dict[str, Any]:
    """Return the default settings for a scene file; a building with lifts gets links for them."""
    settings: dict[str, Any] = {"scene": {"path": scene}}
    if scene_suffix(scene) in BUILDING_SUFFIXES and scene.is_file():
        settings["links"] = [{"auto": "lift"}] if LIFTS_KEY.search(scene.read_bytes()) else []
    return settings


def load_config(path: str | PathLike[str], overrides: Sequence[str] = ()) -> BakeConfig:
    """Read the settings from a YAML file, or take the defaults for a scene file.

    Args:
        path: The path of a YAML file, which ends in .yaml or .yml; or the path of a scene, which
            may also be a building's YAML; or the bare name of a sample, see `navbake.samples.find`.
            `scene.path` is relative to the YAML file.
        overrides: Texts ``a.b=value``, each of which replaces a setting of the file.

    Raises:
        ConfigError: The file cannot be read, or a setting is wrong.
    """
    path = find_source(path)
    if not is_settings(path):
        return parse_config(make_default_settings(path), f"the settings of {path}", overrides)
    settings = read_settings(path)
    return parse_config(settings, str(path), overrides, folder=path.parent, settings_file=str(path))


def read_settings(path: Path) -> JsonValue:
    """Read a YAML file of settings.

    Args:
        path: The path of the file.

    Raises:
        ConfigError: There is no such file, and the message names one that may have been meant; or
            the file cannot be read.
    """
    if not os.path.lexists(path):
        hint = hint_at_file(path, (*YAML_SUFFIXES, *SCENE_SUFFIXES))
        message = append_hint(f"no such file: {path}", hint)
        raise ConfigError(message, path=str(path), hint=hint or None)
    return read_yaml(path)


def parse_config(
    settings: object,
    source: str = "the settings",
    overrides: Sequence[str] = (),
    folder: str | PathLike[str] = "",
    *,
    settings_file: str = "",
) -> BakeConfig:
    """Validate settings.

    Args:
        settings: Nested mappings, as read from YAML.
        source: Name of the file that the settings come from, for messages.
        overrides: Texts ``a.b=value``, each of which replaces a setting.
        folder: The folder that `scene.path` and other paths are relative to.
        settings_file: The YAML file that the settings' `scene.path` comes from, "" for none.

    Raises:
        ConfigError: A setting is wrong.
    """
    if not isinstance(settings, Mapping):
        expected = "a mapping of settings"
        raise ConfigError(
            f"expected {expected} in {source}: `scene: {{path: …}}`",
            path=source,
            value=settings,
            expected=expected,
        )
    if settings.keys() >= MAP_KEYS:
        hint = "`navbake convert` makes a grid of it, to .xml a scene"
        raise ConfigError(
            f"expected settings in {source}, got a map of nav2: {hint}",
            path=source,
            expected="settings",
            hint=hint,
        )
    # null is a section's defaults, so that a file without `scene` lacks `scene.path`
    overridden_settings = apply_overrides(settings, overrides)
    if find_scene_path(overridden_settings) != find_scene_path(settings):
        settings_file = ""
    settings = {"scene": None, **overridden_settings}
    context: dict[str, Any] = {"folder": folder, "inputs": []}
    try:
        config = BakeConfig.model_validate(settings, context=context)
    except ValidationError as error:
        raise make_config_error(error, SECTIONS, source, overrides) from error
    config._input_files = tuple(context["inputs"])
    config._settings_file = settings_file
    return config


def find_scene_path(settings: Mapping[str, Any]) -> object:
    """Return `scene.path` of settings that aren't validated; None if they have none."""
    scene_settings = settings.get("scene")
    return scene_settings.get("path") if isinstance(scene_settings, Mapping) else None


def as_config(config: BakeConfig | str | PathLike[str] | Mapping[str, Any]) -> BakeConfig:
    """Return settings of any form (`BakeConfig`, YAML or scene file, mapping) as a `BakeConfig`."""
    if isinstance(config, str | PathLike):
        return load_config(config)
    return config if isinstance(config, BakeConfig) else parse_config(config)


def settings_digest(config: BakeConfig) -> str:
    """Hash the settings that change cells: sha256 of their canonical JSON, 64 hex digits."""
    excluded_settings: Any = {"output": True, "verify": True, "grid": {"max_cells"}}
    excluded_settings["scene"] = {
        "path",
        "model_path",
        "strict",
    }  # a strict bake has the same cells
    # without these settings, the digest is the same as in versions that did not have them
    if not config.floors.movable:
        excluded_settings["floors"] = {"movable"}
    excluded_settings |= {
        name: True for name in ("agents", "areas", "links") if not getattr(config, name)
    }
    settings = config.model_dump(mode="json", exclude=excluded_settings)
    canonical_json = json.dumps(settings, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical_json.encode()).hexdigest()


def select_settings_to_store(config: BakeConfig) -> Json:
    """Return the settings that are stored in a grid's file: those that differ from the defaults.

    Only the sections scene, agent, grid, levels and floors are stored. The scene's file is stored
    without its folder, so that grids don't depend on it; a scene in memory has no file. The states
    of doors are in the grid itself.
    """
    settings: Json = config.model_dump(
        include={"scene", "agent", "grid", "levels", "floors"},
        mode="json",
        by_alias=True,
        exclude_defaults=True,
    )
    scene = dict(settings.get("scene", {}))
    scene["path"] = Path(config.scene.path).name
    scene.pop("model_path", None)
    scene.pop("strict", None)
    if is_memory_path(config.scene.path):
        del scene["path"]
    settings["scene"] = scene
    return {key: value for key, value in settings.items() if value != {}}


SECTIONS: dict[str, type[BaseModel]] = {
    "": BakeConfig,
    "scene": SceneSettings,
    "scene.exclude": ExcludeSettings,
    "agent": AgentSettings,
    "grid": GridSettings,
    "levels": LevelSettings,
    "floors": FloorSettings,
    "doors": DoorSettings,
    "rooms": RoomSettings,
    "rooms.polygons": RoomPolygon,
    "names": NameSettings,
    "agents": NamedAgent,
    "areas": AreaSettings,
    "links": LinkSettings,
    "verify": VerifySettings,
}
"""Dotted key of a section -> its class."""
