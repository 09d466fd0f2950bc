"""What of a scene's metadata is about one of its levels.

A level of a file with several takes over the metadata of the whole. What navbake states there of
levels (rooms, doors, links, names) is cut to the one level, so that the level is a grid by itself.
"""

from __future__ import annotations

from typing import Any

from navbake.types import Json


def cut_metadata(metadata: Json, level: int) -> Json:
    """Cut the metadata of a grid of several levels to one of them, which becomes level 0.

    Args:
        metadata: of the whole grid; not changed. What is broken in it stays as it is: the whole
            grid says what is wrong.
        level: which level.

    Returns:
        The metadata: without the rooms of other levels, ways to these, doors that stand on other
        levels alone, and links. `metadata` itself where navbake states nothing in it.
    """
    own = metadata.get("navbake")
    if not isinstance(own, dict) or not own:
        return metadata
    cut = dict(own)
    if _are_objects(own.get("levels")):
        cut["levels"] = own["levels"][level : level + 1]
    if "links" in own:
        cut["links"] = []
    if _are_objects(own.get("rooms")):
        cut["rooms"] = _cut_rooms(own["rooms"], level)
    if _are_objects(own.get("doors")):
        cut["doors"] = _cut_doors(own["doors"], level)
    return {**metadata, "navbake": cut}


def _are_objects(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(entry, dict) for entry in value)


def _cut_rooms(rooms: list[Json], level: int) -> list[Json]:
    elsewhere = {str(room.get("id")) for room in rooms if room.get("level") != level}
    cut = []
    for room in rooms:
        if room.get("level") == level:
            # copied before it is changed: the whole keeps its table
            room = {**room, "level": 0}
            if _are_objects(room.get("neighbours")):
                ways = [way for way in room["neighbours"] if str(way.get("room")) not in elsewhere]
                room["neighbours"] = ways
            cut.append(room)
    return cut


def _cut_doors(doors: list[Json], level: int) -> list[Json]:
    cut = []
    for door in doors:
        cells = door.get("cells")
        if isinstance(cells, dict) and all(isinstance(entry, list) for entry in cells.values()):
            # a door on two levels (beside a stair) is on both, with the cells of each
            here = {
                state: [[0, *entry[1:]] for entry in entries if _is_on(entry, level)]
                for state, entries in cells.items()
            }
            if any(here.values()):
                cut.append({**door, "cells": here})
    return cut


def _is_on(entry: Any, level: int) -> bool:
    return isinstance(entry, list) and entry[:1] == [level]
