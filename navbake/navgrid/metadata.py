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


def split_metadata(metadata: Json, num_levels: int) -> list[Json]:
    """Divide a grid's metadata among its levels, each as level 0 of a grid of its own.

    Each level's metadata are a copy without the rooms, doors, neighbours and links of other levels.
    Broken tables are copied unchanged; reading them raises the error.

    Args:
        metadata: The metadata of the grid; returned unchanged for each level if they have nothing
            under ``navbake``.
        num_levels: Number of levels of the grid.

    Returns:
        The metadata of each level, lowest level first.
    """
    tables = metadata.get("navbake")
    if not isinstance(tables, dict) or not tables:
        return [metadata] * num_levels
    parts_of_table: dict[str, list[Any]] = {}
    for name, split_table in SPLIT_FUNCTIONS.items():
        with suppress(AttributeError, KeyError, TypeError, ValueError):
            parts_of_table[name] = split_table(tables[name], num_levels)
    return [
        {
            **metadata,
            "navbake": {**tables, **{name: parts[level] for name, parts in parts_of_table.items()}},
        }
        for level in range(num_levels)
    ]


def unflatten(links: JsonValue) -> JsonValue:
    """Split a flat list of steps' integers into one list of four for each step.

    Any other table of links is returned unchanged, see `navbake.navgrid.links.parse_steps`.
    """
    if isinstance(links, list) and links and not isinstance(links[0], list | tuple | dict):
        return [links[i : i + 4] for i in range(0, len(links), 4)]
    return links


def split_levels(levels: list[Json], num_levels: int) -> list[list[Json]]:
    """Divide a list with an entry for each level into lists of one entry."""
    return [levels[level : level + 1] for level in range(num_levels)]


def split_links(links: JsonValue, num_levels: int) -> list[list[JsonValue]]:
    """Divide a table of links among levels, each of which becomes level 0 of its part.

    Steps within a level are kept, and named links with at least two stops on it.
    """
    links_by_level: list[list[JsonValue]] = [[] for _ in range(num_levels)]
    for entry in unflatten(links):
        if isinstance(entry, dict):
            stops_by_level: dict[int, list[JsonValue]] = {}
            positions_by_level: dict[int, list[JsonValue]] = {}
            for (stop_level, cell), position in zip(
                entry["stops"], entry["positions"], strict=True
            ):
                stops_by_level.setdefault(stop_level, []).append([0, cell])
                positions_by_level.setdefault(stop_level, []).append(position)
            for level, stops in stops_by_level.items():
                if len(stops) >= 2 and 0 <= level < num_levels:
                    positions = positions_by_level[level]
                    links_by_level[level].append({**entry, "stops": stops, "positions": positions})
        else:
            first_level, first_cell, second_level, second_cell = entry
            if first_level == second_level and 0 <= first_level < num_levels:
                links_by_level[first_level].append([0, first_cell, 0, second_cell])
    return links_by_level


def split_rooms(rooms: list[Json], num_levels: int) -> list[list[Json]]:
    """Divide a table of rooms among levels, each of which becomes level 0 of its part.

    The rooms' neighbours on other levels are left out.
    """
    levels_of_room_id: dict[str, set[int]] = {}
    for room in rooms:
        levels_of_room_id.setdefault(room["id"], set()).add(room["level"])
    rooms_by_level: list[list[Json]] = [[] for _ in range(num_levels)]
    for room in rooms:
        level = room["level"]
        if not 0 <= level < num_levels:
            continue
        neighbours = [
            neighbour
            for neighbour in room["neighbours"]
            if levels_of_room_id.get(neighbour["room"], {level}) == {level}
        ]
        # a copy: the whole grid's table stays as it is
        rooms_by_level[level].append({**room, "level": 0, "neighbours": neighbours})
    return rooms_by_level


def split_doors(doors: list[Json], num_levels: int) -> list[list[Json]]:
    """Divide a table of doors among levels, each of which becomes level 0 of its part.

    A door beside a stair may be on two levels: it is in the tables of both, on each without its
    cells on the other.
    """
    doors_by_level: list[list[Json]] = [[] for _ in range(num_levels)]
    for door in doors:
        entry_of_level: dict[int, Json] = {}
        for key in ("cells", "solid"):
            for state, runs_by_level in door.get(key, {}).items():
                for level, runs in runs_by_level:
                    if not 0 <= level < num_levels:
                        continue
                    if level not in entry_of_level:
                        entry_of_level[level] = _without_cells(door)
                    entry_of_level[level][key][state].append([0, runs])
        for level, entry in entry_of_level.items():
            doors_by_level[level].append(entry)
    return doors_by_level


def _without_cells(door: Json) -> Json:
    """Return a copy of a door's entry that has no cells in any state."""
    no_cells: Json = {
        key: {state: [] for state in door[key]} for key in ("cells", "solid") if key in door
    }
    return {**door, **no_cells}


SPLIT_FUNCTIONS: dict[str, Callable[[JsonValue, int], list[Any]]] = {
    "levels": split_levels,
    "links": split_links,
    "rooms": split_rooms,
    "doors": split_doors,
}
"""Name of a table -> function that divides the table among a number of levels."""
