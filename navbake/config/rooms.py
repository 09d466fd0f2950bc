"""The settings of the rooms: which sources divide the floor into rooms, in which order."""

from collections.abc import Mapping
from os import PathLike
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, ValidationInfo

from navbake.config.field_types import (
    Name,
    NotNegative,
    OptionalName,
    Patterns,
    Positive,
    Settings,
    check_distinct,
    expects,
    refusal,
    resolve,
    setting,
    to_path,
)
from navbake.errors import ConfigError, FormatError
from navbake.formats.geojson import read_room_outlines
from navbake.navgrid.polygon import find_fault

RoomSource = Literal["polygons", "geoms", "sites", "auto"]

DEFAULT_GEOMS = ("room|*", "room_*", "floor|*")
DEFAULT_SITES = ("room*",)


def _check_outline(points: list[list[float]]) -> list[list[float]]:
    if fault := find_fault(points):
        raise refusal("a simple outline", got=fault)
    return points


Point = Annotated[list[float], Field(min_length=2, max_length=2)]
Outline = Annotated[
    list[Point],
    Field(min_length=3),
    expects("3 or more corners [[x, y], …]"),
    AfterValidator(_check_outline),
]


DoorWidth = Annotated[Literal["auto"] | Positive, expects("a number > 0, or auto")]


class RoomPolygon(Settings):
    """A room that is given by its outline."""

    name: OptionalName = setting(None, "its name, or null")
    level: Annotated[
        Annotated[int, Field(ge=0)] | Name, expects("a level's number from 0, or its name")
    ] = setting(0, "its level: a number, 0 is the lowest, or a name")
    outdoors: bool = setting(False, "whether it is outdoors: true or false")
    points: Outline = Field(description="its outline [[x, y], …], world frame [m]; no default")
    rings: list[Outline] = setting([], "holes in it and parts apart from it, [[[x, y], …], …] [m]")


def _read_polygons(value: Any, info: ValidationInfo) -> Any:
    """Replace the path of a GeoJSON file by its polygons, so that the digest covers them."""
    if not isinstance(value, str | PathLike):
        return value
    path = resolve(to_path(value), info)
    if info.context:
        info.context.setdefault("inputs", []).append(path)
    try:
        return read_room_outlines(path)
    except FormatError as error:
        raise ConfigError(f"{error}, named at `rooms.polygons`") from error


class RoomSettings(Settings):
    """How the floor is divided into rooms."""

    # The key is `from`, a keyword of Python; so the field is `sources`, with that alias.
    model_config = ConfigDict(**Settings.model_config, populate_by_name=True)

    sources: Annotated[
        list[RoomSource],
        AfterValidator(check_distinct),
        expects("a list of some of polygons, geoms, sites, auto, each once"),
    ] = Field(
        default=["polygons", "geoms", "sites", "auto"],
        alias="from",
        description="polygons, geoms, sites, auto, in order of preference: a cell gets its room "
        "from the first that covers it, auto divides the rest at doors; default all four",
    )
    geoms: Patterns = setting(list(DEFAULT_GEOMS), "floor geoms, by name patterns (*, ?, [...])")
    sites: Patterns = setting(list(DEFAULT_SITES), "sites as volumes, by name patterns")
    polygons: Annotated[list[RoomPolygon], BeforeValidator(_read_polygons)] = setting(
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


def expand_rooms(value: Any) -> Any:
    """Expand the short forms ``auto``, ``none`` and null to the sections that they stand for."""
    for short, section in ((None, {}), ("auto", {"from": ["auto"]}), ("none", {"from": []})):
        if value == short:
            return section
    if not isinstance(value, Mapping | RoomSettings):
        raise refusal("auto, none or a mapping")
    return value
