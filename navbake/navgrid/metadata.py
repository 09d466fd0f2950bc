"""What a grid's metadata state of its attributes, its links and its single levels."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from navbake.errors import FormatError
from navbake.types import Int, Json

Arrays = Mapping[str, NDArray[Any]]

# Other names that the original client has for datatypes; source: sstk's `TypeUtils.js`
ALIASES = {"uint8clamped": "uint8", "uchar": "uint8"}


def datatype_name(stated: str) -> str:
    """Name the datatype of an array type: "uint8" for "Uint8Array" or "uchar"."""
    name = stated.lower().removesuffix("array")
    return ALIASES.get(name, name)


def describe_attributes(metadata: Json, levels: Iterable[Arrays]) -> list[Json]:
    """List ``{"name", "type", "dataType", …}`` of the levels' attributes, in their order.

    An entry of the metadata is kept, except a ``type`` that is not that of the array. Where two
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
            described.setdefault(name, _describe(name, array.dtype, stated.get(name, {})))
    return list(described.values())


def _describe(name: str, dtype: np.dtype[Any], stated: Json) -> Json:
    # the array decides; what the file states is kept where it says the same in other words
    kind = stated.get("type")
    if not isinstance(kind, str) or datatype_name(kind) != dtype.name:
        kind = f"{dtype.name.capitalize()}Array"
    data_type = "continuous" if dtype.kind == "f" else "categorical"
    return {"name": name, "type": kind, "dataType": data_type} | stated | {"type": kind}


@dataclass(frozen=True)
class Link:
    """A step from a cell to another that heights alone don't tell of, taken either way.

    It leads to another level, or to a neighbour on the same one, more than a step higher or lower,
    on a ramp that rises so much over a cell.

    Attributes:
        level, cell: a level and the id of a cell on it (col + row * width).
        other_level, other_cell: where the step leads.
    """

    level: int
    cell: int
    other_level: int
    other_cell: int


def parse_links(stated: Any, num_cells: Sequence[int]) -> Int:
    """Read ``metadata.navbake.links``, None for nothing, on levels of so many cells.

    They are a flat list of whole numbers, four a link, or a list of lists of four. The result has
    the fields of a `Link` in each row, shape (n, 4), int64, read-only.
    """
    where = "at `metadata.navbake.links`"
    numbers = [] if stated is None else stated
    # navbake writes a list of lists; both forms become one flat list
    if isinstance(numbers, list) and any(isinstance(link, list | tuple) for link in numbers):
        if any(not isinstance(link, list | tuple) or len(link) != 4 for link in numbers):
            raise FormatError(f"expected links of 4 numbers each {where}")
        numbers = [number for link in numbers for number in link]
    if not isinstance(numbers, list) or len(numbers) % 4 or not set(map(type, numbers)) <= {int}:
        raise FormatError(f"expected a list of whole numbers, 4 a link, {where}")
    stated_links = np.array(numbers, dtype=np.float64).reshape(-1, 4)  # float64: no overflow
    for column, name in ((0, "level"), (2, "level"), (1, "cell"), (3, "cell")):
        limit: Any = len(num_cells)
        if name == "cell":  # the levels were checked before
            limit = np.array(num_cells, dtype=np.int64)[stated_links[:, column - 1].astype(int)]
        bad = (stated_links[:, column] < 0) | (stated_links[:, column] >= limit)
        if bad.any():
            number = int(np.argmax(bad))
            raise FormatError(
                f"expected an existing {name}, got {stated_links[number, column]:.0f} "
                f"in link {number} {where}"
            )
    links = stated_links.astype(np.int64)
    links.flags.writeable = False
    return links


def cut_metadata(metadata: Json, level: int) -> Json:
    """Cut the metadata of a grid to one level, which becomes level 0 of a grid by itself.

    Rooms and doors of other levels go, and neighbours on other levels and links to them. What is
    broken stays as it is: the whole grid says what is wrong. `metadata` is not changed, and
    returned where navbake states nothing in it.
    """
    own = metadata.get("navbake")
    if not isinstance(own, dict) or not own:
        return metadata
    cut = dict(own)
    if _are_objects(own.get("levels")):
        cut["levels"] = own["levels"][level : level + 1]
    if "links" in own:
        cut["links"] = _cut_links(own["links"], level)
    if _are_objects(own.get("rooms")):
        cut["rooms"] = _cut_rooms(own["rooms"], level)
    if _are_objects(own.get("doors")):
        cut["doors"] = _cut_doors(own["doors"], level)
    return {**metadata, "navbake": cut}


def _are_objects(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(entry, dict) for entry in value)


def _cut_links(links: Any, level: int) -> list[Any]:
    """The links within one level: neighbours on a ramp that rises more than a step over a cell."""
    if not isinstance(links, list):
        return []
    if not all(isinstance(row, list) for row in links):  # a flat list, four numbers a link
        links = [links[i : i + 4] for i in range(0, len(links), 4)]
    own = [row for row in links if len(row) == 4 and row[0] == row[2] == level]
    return [[0, row[1], 0, row[3]] for row in own]


def _cut_rooms(rooms: list[Json], level: int) -> list[Json]:
    elsewhere = {str(room.get("id")) for room in rooms if room.get("level") != level}
    # copied before they are changed: the whole keeps its table
    cut = [{**room, "level": 0} for room in rooms if room.get("level") == level]
    for room in cut:
        if _are_objects(room.get("neighbours")):
            near = room["neighbours"]
            room["neighbours"] = [n for n in near if str(n.get("room")) not in elsewhere]
    return cut


def _cut_doors(doors: list[Json], level: int) -> list[Json]:
    def on_level(entries: list[Any]) -> list[Any]:
        return [[0, *e[1:]] for e in entries if isinstance(e, list) and e[:1] == [level]]

    cut = []
    for door in doors:
        # a door on two levels (beside a stair) is on both, with the cells of each
        here: Json = {}
        for key in ("cells", "solid"):
            stated = door.get(key)
            if isinstance(stated, dict) and all(isinstance(e, list) for e in stated.values()):
                here[key] = {state: on_level(entries) for state, entries in stated.items()}
        if any(any(by_state.values()) for by_state in here.values()):
            cut.append({**door, **here})
    return cut
