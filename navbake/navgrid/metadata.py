"""Describes a grid's attributes, cuts its metadata for single levels, and parses its tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import msgspec
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.types import Json, JsonValue

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Name = Annotated[str, msgspec.Meta(min_length=1)]
Positive = Annotated[float, msgspec.Meta(gt=0, le=1e10)]
NonNegative = Annotated[float, msgspec.Meta(ge=0, le=1e10)]
Table = TypeVar("Table")
Arrays = Mapping[str, NDArray[Any]]

# Other names that MINOS's client has for datatypes; source: sstk's `TypeUtils.js`
DATATYPE_ALIASES = {"uint8clamped": "uint8", "uchar": "uint8"}


def datatype_name(array_type: str) -> str:
    """Return numpy's name of a file's array type: "uint8" for "Uint8Array" and for "uchar"."""
    name = array_type.lower().removesuffix("array")
    return DATATYPE_ALIASES.get(name, name)


def describe_attributes(metadata: Json, levels: Iterable[Arrays]) -> list[Json]:
    """Make the list ``cellAttributes`` of a file's metadata: an entry for each attribute.

    Entries that the metadata already have are kept, but ``type`` is corrected if it isn't the type
    of the array. If levels differ in the dtype of an attribute, the first level's dtype counts.

    Args:
        metadata: The metadata of the grid.
        levels: For each level, name -> attribute.

    Returns:
        For each attribute ``{"name", "type", "dataType", …}``.
    """
    entries = metadata.get("cellAttributes")
    file_entry_by_name: dict[str, Json] = {}
    for entry in entries if isinstance(entries, list) else []:
        if isinstance(entry, dict) and isinstance(entry.get("name"), str):
            file_entry_by_name[entry["name"]] = entry
    entry_by_attribute: dict[str, Json] = {}
    for arrays in levels:
        for name, array in arrays.items():
            if name in entry_by_attribute:
                continue
            entry = file_entry_by_name.get(name, {})
            dtype = array.dtype
            # the array's dtype counts; the file's name for it is not changed
            array_type = entry.get("type")
            if not isinstance(array_type, str) or datatype_name(array_type) != dtype.name:
                array_type = f"{dtype.name.capitalize()}Array"
            data_type = "continuous" if dtype.kind == "f" else "categorical"
            entry_by_attribute[name] = {
                "name": name,
                "type": array_type,
                "dataType": data_type,
                **entry,
            }
            entry_by_attribute[name]["type"] = array_type
    return list(entry_by_attribute.values())


def read_table(entries: JsonValue, table_type: type[Table], place: str) -> Table:
    """Convert a table of a file to a Python type, and check it.

    Args:
        entries: The parsed JSON of the table.
        table_type: The type, such as ``list[Room]``; msgspec checks it.
        place: The place of the table, such as ``metadata.navbake.rooms``.

    Raises:
        FormatError: The table does not have this type; the message names the place.
    """
    try:
        return msgspec.convert(entries, table_type)
    except msgspec.ValidationError as error:
        # msgspec writes places as `$.area` or `$[0].name`, and none for the whole
        error_text = str(error) if "`$" in str(error) else f"{error} - at `$`"
        error_text = error_text.replace(" - at ", " at ").replace("`$", f"`{place}")
        faulty_place = error_text.rpartition(" at `")[2].rstrip("`")
        raise FormatError(f"{error_text[0].lower()}{error_text[1:]}", place=faulty_place) from error


def to_entry(record: DataclassInstance, *left_out_fields: str) -> Json:
    """Convert a dataclass to a JSON object, without the fields that are None.

    Args:
        record: An object of a dataclass.
        *left_out_fields: Names of fields to leave out.
    """
    entry: Json = {}
    for name in record.__dataclass_fields__:
        value = getattr(record, name)
        if name not in left_out_fields and value is not None:
            entry[name] = list(value) if isinstance(value, tuple) else value
    return entry


def cut_metadata(metadata: Json, level: int) -> Json:
    """Return a copy of a grid's metadata for one level, as level 0 of a grid of its own.

    The copy lacks the rooms, doors, neighbours and links of other levels. Broken tables are copied
    unchanged; reading them raises the error.

    Args:
        metadata: The metadata of the grid; returned unchanged if they have nothing under
            ``navbake``.
        level: Number of the level, 0 is the lowest.
    """
    tables = metadata.get("navbake")
    if not isinstance(tables, dict) or not tables:
        return metadata
    level_tables = dict(tables)
    for name, cut_table in CUT_FUNCTIONS.items():
        with suppress(AttributeError, KeyError, TypeError, ValueError):
            level_tables[name] = cut_table(tables[name], level)
    return {**metadata, "navbake": level_tables}


def unflatten(links: JsonValue) -> JsonValue:
    """Split a flat list of steps' integers into one list of four for each step.

    Any other table of links is returned unchanged, see `navbake.navgrid.links.parse_steps`.
    """
    if isinstance(links, list) and links and not isinstance(links[0], list | tuple | dict):
        return [links[i : i + 4] for i in range(0, len(links), 4)]
    return links


def cut_levels(levels: list[Json], level: int) -> list[Json]:
    """Cut a list with an entry for each level down to one level's entry."""
    return levels[level : level + 1]


def cut_links(links: JsonValue, level: int) -> list[JsonValue]:
    """Cut a table of links down to one level, which becomes level 0.

    Steps within the level are kept, and named links with at least two stops on it.
    """
    level_links: list[JsonValue] = []
    for entry in unflatten(links):
        if isinstance(entry, dict):
            stops = []
            positions = []
            for (stop_level, cell), position in zip(
                entry["stops"], entry["positions"], strict=True
            ):
                if stop_level == level:
                    stops.append([0, cell])
                    positions.append(position)
            if len(stops) >= 2:
                level_links.append({**entry, "stops": stops, "positions": positions})
        else:
            first_level, first_cell, second_level, second_cell = entry
            if first_level == second_level == level:
                level_links.append([0, first_cell, 0, second_cell])
    return level_links


def cut_rooms(rooms: list[Json], level: int) -> list[Json]:
    """Cut a table of rooms down to one level, which becomes level 0.

    The rooms' neighbours on other levels are left out.
    """
    other_room_ids = {room["id"] for room in rooms if room["level"] != level}
    level_rooms = []
    for room in rooms:
        if room["level"] == level:
            neighbours = [
                neighbour
                for neighbour in room["neighbours"]
                if neighbour["room"] not in other_room_ids
            ]
            # a copy: the whole grid's table stays as it is
            level_rooms.append({**room, "level": 0, "neighbours": neighbours})
    return level_rooms


def cut_doors(doors: list[Json], level: int) -> list[Json]:
    """Cut a table of doors down to one level, which becomes level 0.

    Doors with cells on the level are kept, without their cells on other levels.
    """
    level_doors = []
    for door in doors:
        # a door beside a stair may be on two levels: it is in the tables of both
        cells_on_level: Json = {}
        for key in ("cells", "solid"):
            if key in door:
                cells_on_level[key] = {
                    state: [[0, *entry[1:]] for entry in entries if entry[0] == level]
                    for state, entries in door[key].items()
                }
        if any(any(entries_by_state.values()) for entries_by_state in cells_on_level.values()):
            level_doors.append({**door, **cells_on_level})
    return level_doors


CUT_FUNCTIONS: dict[str, Callable[[JsonValue, int], JsonValue]] = {
    "levels": cut_levels,
    "links": cut_links,
    "rooms": cut_rooms,
    "doors": cut_doors,
}
"""Name of a table -> function that takes the table and a level, and returns the level's part."""
