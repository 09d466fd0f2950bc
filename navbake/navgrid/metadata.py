"""A grid's metadata on its attributes and single levels, and how its tables are read."""

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Annotated, Any

import msgspec
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.types import Json

Name = Annotated[str, msgspec.Meta(min_length=1)]
Positive = Annotated[float, msgspec.Meta(gt=0, le=1e10)]
NonNegative = Annotated[float, msgspec.Meta(ge=0, le=1e10)]
Arrays = Mapping[str, NDArray[Any]]

# Other names that the original client has for datatypes; source: sstk's `TypeUtils.js`
ALIASES = {"uint8clamped": "uint8", "uchar": "uint8"}


def datatype_name(stated: str) -> str:
    """Name the datatype of an array type: "uint8" for "Uint8Array" or "uchar"."""
    name = stated.lower().removesuffix("array")
    return ALIASES.get(name, name)


def describe_attributes(metadata: Json, levels: Iterable[Arrays]) -> list[Json]:
    """List ``{"name", "type", "dataType", …}`` of the levels' attributes, in their order.

    An entry of the metadata is kept, except a ``type`` that is not that of the array. If two
    levels differ in dtype, the first counts.
    """
    entries = metadata.get("cellAttributes")
    stated = {
        entry["name"]: entry
        for entry in (entries if isinstance(entries, list) else [])
        if isinstance(entry, dict) and isinstance(entry.get("name"), str)
    }
    described: dict[str, Json] = {}
    for arrays in levels:
        for name, array in arrays.items():
            if name not in described:
                own = stated.get(name, {})
                dtype = array.dtype
                # the array's dtype counts; the file's own name for it is kept
                kind = own.get("type")
                if not isinstance(kind, str) or datatype_name(kind) != dtype.name:
                    kind = f"{dtype.name.capitalize()}Array"
                data_type = "continuous" if dtype.kind == "f" else "categorical"
                described[name] = {"name": name, "type": kind, "dataType": data_type, **own}
                described[name]["type"] = kind
    return list(described.values())


def read_table(stated: Any, kind: Any, where: str) -> Any:
    """Read a table of a file as a type; a FormatError has the place of what doesn't fit."""
    try:
        return msgspec.convert(stated, kind)
    except msgspec.ValidationError as error:
        text = str(error) if "`$" in str(error) else f"{error} - at `$`"
        text = text.replace(" - at ", " at ").replace("`$", f"`{where}")
        place = text.rpartition(" at `")[2].rstrip("`")
        raise FormatError(f"{text[0].lower()}{text[1:]}", place=place) from error


def to_entry(thing: Any, *left_out: str) -> Json:
    """The fields of a dataclass as JSON, without those that are None."""
    names = (name for name in thing.__dataclass_fields__ if name not in left_out)
    fields = {name: getattr(thing, name) for name in names}
    return {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in fields.items()
        if value is not None
    }


def cut_metadata(metadata: Json, level: int) -> Json:
    """Cut a copy of a grid's metadata to one level, which becomes level 0 of a grid by itself.

    Rooms, doors, neighbours and links of other levels are removed. Broken parts stay as they are,
    as the whole grid reports them. Without navbake's metadata, `metadata` itself is returned.
    """
    own = metadata.get("navbake")
    if not isinstance(own, dict) or not own:
        return metadata
    cut = dict(own)
    for name, cut_table in CUTS.items():
        with suppress(AttributeError, KeyError, TypeError, ValueError):
            cut[name] = cut_table(own[name], level)
    return {**metadata, "navbake": cut}


def unflatten(links: Any) -> Any:
    """The entries of a table of links, whose steps may be one flat list of integers."""
    if isinstance(links, list) and links and not isinstance(links[0], list | tuple | dict):
        return [links[i : i + 4] for i in range(0, len(links), 4)]
    return links


def cut_links(links: Any, level: int) -> list[Any]:
    """The steps within one level, and the named links with two or more stops on it."""
    cut: list[Any] = []
    for entry in unflatten(links):
        if isinstance(entry, dict):
            pairs = zip(entry["stops"], entry["positions"], strict=True)
            kept = [([0, cell], position) for (on, cell), position in pairs if on == level]
            if len(kept) >= 2:
                stops, positions = map(list, zip(*kept, strict=True))
                cut.append({**entry, "stops": stops, "positions": positions})
        else:
            at, one, to, other = entry
            cut += [[0, one, 0, other]] if at == to == level else []
    return cut


def cut_rooms(rooms: list[Json], level: int) -> list[Json]:
    elsewhere = {room["id"] for room in rooms if room["level"] != level}
    # copied before they are changed: the whole keeps its table
    return [
        {
            **room,
            "level": 0,
            "neighbours": [n for n in room["neighbours"] if n["room"] not in elsewhere],
        }
        for room in rooms
        if room["level"] == level
    ]


def cut_doors(doors: list[Json], level: int) -> list[Json]:
    cut = []
    for door in doors:
        # a door on two levels (beside a stair) is on both, with the cells of each
        here: Json = {
            key: {
                state: [[0, *entry[1:]] for entry in entries if entry[0] == level]
                for state, entries in door[key].items()
            }
            for key in ("cells", "solid")
            if key in door
        }
        if any(any(by_state.values()) for by_state in here.values()):
            cut.append({**door, **here})
    return cut


CUTS: dict[str, Callable[[Any, int], Any]] = {
    "levels": lambda levels, level: levels[level : level + 1],
    "links": cut_links,
    "rooms": cut_rooms,
    "doors": cut_doors,
}
