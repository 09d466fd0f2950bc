"""Cuts the metadata of a grid of several levels to one of them.

A level of a file takes over the metadata of the whole. What navbake states there of levels
(rooms, doors, links, names) is cut to the one level, so that the level is a grid by itself.
"""

from typing import Any

from navbake.types import Json


def cut_metadata(metadata: Json, level: int) -> Json:
    """Cut metadata to one level, which becomes level 0: without rooms and doors of other levels.

    Neighbours on other levels and links to them go, too. What is broken stays as it is: the whole
    grid says what is wrong. `metadata` is not changed, and returned where navbake states nothing
    in it.
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
    rows = links if all(isinstance(row, list) for row in links) else _in_fours(links)
    own = [row for row in rows if len(row) == 4 and row[0] == row[2] == level]
    return [[0, row[1], 0, row[3]] for row in own]


def _in_fours(numbers: list[Any]) -> list[Any]:
    return [numbers[i : i + 4] for i in range(0, len(numbers), 4)]


def _cut_rooms(rooms: list[Json], level: int) -> list[Json]:
    elsewhere = {str(room.get("id")) for room in rooms if room.get("level") != level}
    # copied before they are changed: the whole keeps its table
    cut = [{**room, "level": 0} for room in rooms if room.get("level") == level]
    for room in cut:
        if _are_objects(room.get("neighbours")):
            near = [
                other for other in room["neighbours"] if str(other.get("room")) not in elsewhere
            ]
            room["neighbours"] = near
    return cut


def _cut_doors(doors: list[Json], level: int) -> list[Json]:
    cut = []
    for door in doors:
        # a door on two levels (beside a stair) is on both, with the cells of each
        here = {
            key: {state: _cells_on(level, entries) for state, entries in door[key].items()}
            for key in ("cells", "solid")
            if _are_by_state(door.get(key))
        }
        if any(any(by_state.values()) for by_state in here.values()):
            cut.append({**door, **here})
    return cut


def _are_by_state(cells: Any) -> bool:
    return isinstance(cells, dict) and all(isinstance(entry, list) for entry in cells.values())


def _cells_on(level: int, entries: list[Any]) -> list[Any]:
    return [[0, *e[1:]] for e in entries if isinstance(e, list) and e[:1] == [level]]
