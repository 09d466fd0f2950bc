"""Rooms: which one each cell belongs to, and the table of all of them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from navbake.baker.columns import Columns
from navbake.baker.floors.levels import Floors
from navbake.baker.kernels.labels import measure_rooms
from navbake.baker.rooms.openings import (
    Opening,
    Room,
    find_openings,
    find_room_links,
    match_doors,
)
from navbake.baker.rooms.segmentation import number_by_place, order_by_place, segment_rooms
from navbake.baker.rooms.sources import Claim, claim_by_geoms, claim_by_polygons, claim_by_sites
from navbake.baker.scene.scene import Scene
from navbake.config.rooms import RoomSettings
from navbake.config.settings import AgentSettings
from navbake.errors import SceneError
from navbake.navgrid.lattice import Lattice

Bool = NDArray[np.bool_]
Float = NDArray[np.float64]
Int = NDArray[np.int64]
Labels = NDArray[np.int32]
Json = dict[str, Any]

MAX_ROOMS = np.iinfo(np.uint16).max  # of a level
# A segment that marked rooms hold this much of is theirs altogether
HALF = 0.5
# Names that can't be ids, because ids of rooms without a name of their own look like that
ID_LIKE = re.compile(r"\d+:\d+")


@dataclass(frozen=True)
class Rooms:
    """The rooms of a scene.

    Attributes:
        index: the room of each cell by level, shape (height, width) of the whole lattice,
            uint16, 1-based, 0 for none.
        table: what the file tells of each room, by level and index: ``index``, ``id``, ``name``
            (or None), ``level``, ``area`` [m²], ``centroid`` (world x, y, z [m]), ``source``
            (polygons, geoms, sites, auto), ``neighbours``: ``room`` (its id), ``kind`` (open,
            door, link), ``door`` (its id, or None).
        openings: where rooms of a level meet.
        links: pairs of rooms of two levels between which a step leads.
        lattice: the cells.
        warnings: what the user should know, one line each.
    """

    index: list[NDArray[np.uint16]]
    table: list[Json]
    openings: list[Opening]
    links: list[tuple[Room, Room]]
    lattice: Lattice
    warnings: list[str]

    def room_at(self, level: int, cell: int) -> str | None:
        """The id of the room of a level's cell, counted on the whole lattice; None for none."""
        index = int(self.index[level].flat[cell])
        return self._ids.get((level, index))

    @cached_property
    def _ids(self) -> dict[Room, str]:
        return {(room["level"], room["index"]): room["id"] for room in self.table}

    def with_doors(self, doors: Mapping[str, Sequence[Int]]) -> Rooms:
        """Name the doors between neighbours.

        Args:
            doors: by a door's id, the cells it blocks when closed, by level, ids on the whole
                lattice.
        """
        named = match_doors(self.openings, doors, self.lattice)
        return replace(self, table=_with_neighbours(self.table, self.openings, self.links, named))


def find_rooms(
    scene: Scene,
    columns: Columns,
    floors: Floors,
    walls: Sequence[Bool],
    settings: RoomSettings,
    agent: AgentSettings,
) -> Rooms:
    """Tell which room each cell belongs to.

    A cell's room is that of the first source that has one for it. Cells without a floor, and
    cells that a wall stands in, belong to none. On each level, rooms are numbered by their
    first cells in reading order: from large y to small, from small x to large. A room that
    reaches over several levels is one room on each.

    Args:
        scene: the scene.
        columns: all surfaces.
        floors: the storeys and the steps between them.
        walls: by level, the cells that a wall stands in, shape (height, width), bool.
        settings: the sources and their settings.
        agent: its height and step.

    Raises:
        ConfigError: a polygon names a level that there is not.
        SceneError: a level has more than 65,535 rooms.
    """
    levels, lattice = floors.levels, columns.lattice
    drawing = _Drawing(
        [~np.isnan(level.floor) & ~wall for level, wall in zip(levels, walls, strict=True)]
    )
    for source in settings.sources:
        if source == "geoms":
            claim = claim_by_geoms(
                scene, columns, levels, settings.geoms, agent.traversable_floor_height
            )
            drawing.take(claim, source)
        elif source == "sites":
            claim = claim_by_sites(
                scene, levels, settings.sites, lattice, agent.height, settings.min_area
            )
            drawing.take(claim, source)
        elif source == "polygons":
            claim = claim_by_polygons(levels, settings.polygons, lattice)
            drawing.take(claim, source)
        else:
            drawing.fill([level.floor for level in levels], settings, lattice.cell_size)
    index, rooms = drawing.number()
    openings = find_openings(index, floors, agent.traversable_floor_height)
    links = find_room_links(index, floors)
    table = _describe(index, rooms, floors, lattice)
    table = _with_neighbours(table, openings, links, {})
    return Rooms(index, table, openings, links, lattice, drawing.warnings)


class _Drawing:
    """Rooms as the sources add them, each cell to the first that has a room for it."""

    def __init__(self, open_cells: Sequence[Bool]) -> None:
        self._open = open_cells
        self._owner = [np.zeros(mask.shape, dtype=np.int32) for mask in open_cells]
        self._rooms: list[tuple[str | None, str]] = []  # name and source; owners count from 1
        self.warnings: list[str] = []

    def take(self, claim: Claim, source: str) -> None:
        """Add what a source claims."""
        self.warnings += claim.warnings
        if not claim.names:
            return
        for open_cells, owner, label in zip(self._open, self._owner, claim.labels, strict=True):
            fresh = np.where(open_cells & (owner == 0), label, 0)
            number = np.zeros(len(claim.names) + 1, dtype=np.int32)
            for k in np.flatnonzero(np.bincount(fresh.ravel())[1:]):
                self._rooms.append((claim.names[k], source))
                number[k + 1] = len(self._rooms)
            owner += number[fresh]

    def fill(self, floors: Sequence[Float], settings: RoomSettings, cell_size: float) -> None:
        """Part what is left at gaps that are no wider than a door.

        Where marked rooms hold most of a segment, they share the rest of it, and everywhere what
        is too small for a room; each part of that goes to the room that it touches most.
        """
        labels = []
        names: list[str | None] = []
        for number, open_cells in enumerate(self._open):
            segment = segment_rooms(
                open_cells, cell_size, settings.door_width, settings.min_area, floors[number]
            )
            owner = self._owner[number]
            if owner.any():
                least = settings.min_area / cell_size**2
                self._owner[number], segment = share_rest(owner, segment, least)
            labels.append(np.where(segment > 0, segment + len(names), 0))
            names += [None] * int(segment.max(initial=0))
        self.take(Claim(names, labels), "auto")

    def number(self) -> tuple[list[NDArray[np.uint16]], list[list[tuple[str | None, str]]]]:
        """Number the rooms of each level; also tells the name and the source of each."""
        index, rooms = [], []
        for level, owner in enumerate(self._owner):
            order = order_by_place(owner)
            if len(order) > MAX_ROOMS:
                raise SceneError(
                    f"expected at most {MAX_ROOMS} rooms on a level, got {len(order)} on level "
                    f"{level}: raise `rooms.min_area` or `rooms.door_width`"
                )
            number = np.zeros(len(self._rooms) + 1, dtype=np.uint16)
            number[order] = np.arange(1, len(order) + 1)
            index.append(number[owner])
            rooms.append([self._rooms[k - 1] for k in order])
        return index, rooms


def share_rest(owner: Labels, segment: Labels, least: float) -> tuple[Labels, Labels]:
    """Share what marked rooms leave of segments.

    Args:
        owner: the marked room of each cell, shape (height, width), int32, 0 for none.
        segment: the segment of each cell, likewise.
        least: cells that a room has at least.

    Returns:
        Owners with what they take over, and new rooms in what is left, each of the same shape.
    """
    left = np.where(owner == 0, segment, 0)
    part = _label_equal(left)
    count = int(part.max(initial=0)) + 1
    cells = np.bincount(part.ravel(), minlength=count)
    all_of = np.bincount(segment.ravel())
    held = np.bincount(segment[owner > 0].ravel(), minlength=len(all_of)) / np.maximum(all_of, 1)
    of_part = np.zeros(count, dtype=np.int32)
    of_part[part.ravel()] = left.ravel()
    touched = _most_touched(part, owner, count)
    joins = (touched > 0) & ((cells < least) | (held[of_part] >= HALF))
    is_room = ~joins & (cells >= least)
    joins[0] = is_room[0] = False
    taken = np.where(joins[part], touched[part], owner).astype(np.int32)
    return taken, number_by_place(np.where(is_room[part], part, 0).astype(np.int32))


def _label_equal(label: Labels) -> Labels:
    """Number the parts of equal labels that hang together over edges; 0 stays."""
    cells = np.flatnonzero(label)
    node = np.full(label.shape, -1, dtype=np.int64)
    node.ravel()[cells] = np.arange(len(cells))
    pairs = []
    for one, other in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        same = (label[one] == label[other]) & (label[one] > 0)
        pairs.append(np.stack([node[one][same], node[other][same]]))
    sources, targets = np.concatenate(pairs, axis=1)
    edges = np.ones(len(sources), dtype=np.bool_), (sources, targets)
    _, number = connected_components(coo_array(edges, shape=(len(cells),) * 2), directed=False)
    part = np.zeros(label.shape, dtype=np.int32)
    part.ravel()[cells] = number + 1
    return part


def _most_touched(part: Labels, owner: Labels, count: int) -> Labels:
    """The owner that each part has most edges in common with, 0 for none; of several the first."""
    keys = []
    base = int(owner.max(initial=0)) + 1
    for one, other in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        for a, b in ((one, other), (other, one)):
            meet = (part[a] > 0) & (owner[b] > 0)
            keys.append(part[a][meet].astype(np.int64) * base + owner[b][meet])
    key, edges = np.unique(np.concatenate(keys), return_counts=True)
    order = np.lexsort((-key, edges))  # the last one written stays
    touched = np.zeros(count, dtype=np.int32)
    touched[key[order] // base] = key[order] % base
    return touched


def _describe(
    index: Sequence[NDArray[np.uint16]],
    rooms: Sequence[Sequence[tuple[str | None, str]]],
    floors: Floors,
    lattice: Lattice,
) -> list[Json]:
    names = Counter(name for level in rooms for name, _ in level)
    table = []
    for number, (label, level) in enumerate(zip(index, floors.levels, strict=True)):
        count, *center = measure_rooms(
            label, level.floor, lattice.center_x(), lattice.center_y(), len(rooms[number])
        )
        for k, (name, source) in enumerate(rooms[number], 1):
            is_unique = name is not None and names[name] == 1 and not ID_LIKE.fullmatch(name)
            table.append(
                {
                    "index": k,
                    "id": name if is_unique else f"{number}:{k}",
                    "name": name,
                    "level": number,
                    "area": round(float(count[k]) * lattice.cell_size**2, 6),
                    "centroid": [round(float(c[k] / count[k]), 6) + 0.0 for c in center],
                    "source": source,
                }
            )
    return table


def _with_neighbours(
    table: Sequence[Json],
    openings: Sequence[Opening],
    links: Sequence[tuple[Room, Room]],
    doors: Mapping[int, Sequence[str]],
) -> list[Json]:
    """Tell of each room what it opens to: without a door, by which door, by a step elsewhere."""
    ids = {(room["level"], room["index"]): room["id"] for room in table}
    found: dict[Room, set[tuple[Room, str, str]]] = {room: set() for room in ids}
    for number, opening in enumerate(openings):
        a, b = ((opening.level, room) for room in opening.rooms)
        for door in doors.get(number, [""]):
            kind = "door" if door else "open"
            found[a].add((b, kind, door))
            found[b].add((a, kind, door))
    for a, b in links:
        found[a].add((b, "link", ""))
        found[b].add((a, "link", ""))
    return [
        {
            **room,
            "neighbours": [
                {"room": ids[other], "door": door or None, "kind": kind}
                for other, kind, door in sorted(found[room["level"], room["index"]])
            ],
        }
        for room in table
    ]
