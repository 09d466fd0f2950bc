"""Tables of a grid's facts: the command line prints them, and a report shows them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from navbake.errors import printable

if TYPE_CHECKING:
    from navbake.navgrid.links import Link
    from navbake.navgrid.rooms import Door, Room
    from navbake.types import Json

LEVEL_COLUMNS = {
    "#": "{index}",
    "name": "{name}",
    "cells": "{width} x {height}",
    "ground m": "{ground:.3f}",
    "floor m": "{floor}",
    "floor m2": "{floor_area:.2f}",
    "free m2": "{free_area:.2f}",
    "islands": "{num_islands}",
    "largest m2": "{largest_island_area:.2f}",
}
"""Headings, and the format of their cells by the facts of a level."""


class Table(NamedTuple):
    """Rows of as many cells as there are headings."""

    headings: Sequence[str]  # one a column; all empty for a table without a line of them
    rows: Sequence[Sequence[str]]  # cells as text, control characters escaped
    numbers: frozenset[str] = frozenset()  # headings of the columns that are aligned on the right
    gap: int = 2  # spaces between printed columns

    def without_empty_columns(self) -> Table:
        """The table without the columns in which no row has anything."""
        kept = [i for i in range(len(self.headings)) if any(row[i] for row in self.rows)]
        rows = [[row[i] for i in kept] for row in self.rows]
        return self._replace(headings=[self.headings[i] for i in kept], rows=rows)


def make_table(
    headings: Sequence[str],
    rows: Iterable[Sequence[Any]],
    numbers: Iterable[str] = (),
    gap: int = 2,
) -> Table:
    """A table of any values; None is an empty cell."""
    cells = [[printable("" if cell is None else str(cell)) for cell in row] for row in rows]
    return Table(headings, cells, frozenset(numbers), gap)


def summarize(facts: Json) -> list[tuple[str, str]]:
    """Facts about a whole grid, from `navbake.views.describe.describe`."""
    inflated = "{radius}, clearance {clearance} ({mode})"
    agent = {  # sizes, and a slope
        f"agent {name.replace('_', ' ')} {'[deg]' if 'slope' in name else '[m]'}": str(value)
        for name, value in facts["agent"].items()
    }
    return [
        ("scene", facts["scene_id"] or "not named"),
        ("cell size [m]", f"{facts['cell_size']:g}"),
        *agent.items(),
        *(("inflated to [m]", inflated.format_map(entry)) for entry in facts["inflated"]),
        ("islands", str(facts["num_islands"])),
        ("steps", str(facts["num_steps"])),
        *((key, str(len(facts[key]))) for key in ("links", "areas", "agents") if facts[key]),
        ("doors", str(len(facts["doors"]))),
    ]


def level_table(facts: Json) -> Table:
    """A row for each level, from `navbake.views.describe.describe`; rooms only if there are any."""
    columns = dict(LEVEL_COLUMNS)
    if any(level["num_rooms"] for level in facts["levels"]):
        columns["rooms"] = "{num_rooms}"
    rows = []
    for index, level in enumerate(facts["levels"]):
        has_floor = level["floor_min"] is not None
        floor = "{floor_min:.3f} to {floor_max:.3f}".format_map(level) if has_floor else "none"
        known = {**level, "index": index, "floor": floor}
        rows.append([text.format_map(known) for text in columns.values()])
    return make_table(tuple(columns), rows, numbers=columns.keys() - {"name"}, gap=1)


def room_table(rooms: Sequence[Room], levels: Sequence[str]) -> Table:
    """A row for each room, without empty columns; `levels` are the levels' names."""
    rows = []
    for room in rooms:
        opens_to = []
        for neighbour in room.neighbours:
            how = neighbour.door or ("steps" if neighbour.kind == "link" else "")
            opens_to.append(f"{neighbour.room} ({how})" if how else neighbour.room)
        index = "" if room.id == f"{room.level}:{room.index}" else room.index
        named = (room.id, room.name, levels[room.level] if len(levels) > 1 else "", index)
        source = f"{room.source or ''}{', outdoors' if room.outdoors else ''}"
        facts = f"{room.area:.2f}", _place(room.centroid), source, ", ".join(opens_to)
        rows.append((*named, *facts))
    headings = ("id", "name", "level", "index", "m2", "centroid x y z m", "from", "opens to")
    return make_table(headings, rows, numbers=("index", "m2")).without_empty_columns()


def door_table(doors: Sequence[Door], levels: Sequence[str]) -> Table:
    """A row for each door, without empty columns; `levels` are the levels' names."""
    has_joints = any(door.joint != door.id for door in doors)
    rows = []
    for door in doors:
        joint = (door.joint or "none") if has_joints else ""
        on = ", ".join(levels[level] for level in door.levels) if len(levels) > 1 else ""
        # a body that a pattern made a door may stand anywhere
        rooms = [room or "outside" for room in door.rooms] if any(door.rooms) else ["nothing"]
        # of a door as modelled also the state that this is the same as, if it is known
        is_between = door.state == "modelled" and {"open", "closed"} <= set(door.states)
        like = door.like or ("half-open" if is_between else None)
        state = f"{door.state} ({like})" if like else door.state
        rows.append((door.id, joint, on, " - ".join(rooms), state, ", ".join(door.states)))
    headings = ("door", "joint", "level", "joins", "is", "can be")
    return make_table(headings, rows).without_empty_columns()


def link_table(links: Sequence[Link], levels: Sequence[str]) -> Table:
    """A row for each named link, without empty columns; `levels` are the levels' names."""
    rows = []
    for link in links:
        way = " > " if link.one_way else " - "
        stops = way.join(_place(stop.position) for stop in link.stops)
        on = ", ".join(dict.fromkeys(levels[stop.level] for stop in link.stops))
        sizes = map(_number, (link.width, link.cost, link.seconds))
        rows.append((link.name, link.kind, stops, on, *sizes, _names(link.agents), link.state))
    headings = ("link", "kind", "stops x y z m", "levels", "wide m", "cost m", "s", "for", "is")
    return make_table(headings, rows, numbers=("wide m", "cost m", "s")).without_empty_columns()


def area_table(areas: Sequence[Json]) -> Table:
    """A row for each area, from `navbake.views.describe.describe`, without empty columns."""
    rows = [
        (a["name"], a["cost"], _number(a.get("speed")), _names(a.get("agents")), f"{a['m2']:.2f}")
        for a in areas
    ]
    headings = ("area", "cost", "m/s", "for", "m2")
    return make_table(headings, rows, numbers=("cost", "m/s", "m2")).without_empty_columns()


def agent_table(agents: Mapping[str, Json]) -> Table:
    """A row for each agent, from `navbake.views.describe.describe`, without empty columns."""
    keys = {"radius": "radius m", "height": "height m", "step": "step m", "speed": "m/s"}
    rows = [(name, *(_number(agent.get(key)) for key in keys)) for name, agent in agents.items()]
    return make_table(("agent", *keys.values()), rows, keys.values()).without_empty_columns()


def _place(position: Iterable[float]) -> str:
    return " ".join(f"{value:.2f}" for value in position)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:g}"


def _names(agents: Iterable[str] | None) -> str:
    return "" if agents is None else ", ".join(agents) or "nobody"


def cell_facts(facts: Json) -> dict[str, str | list[str]]:
    """The facts of `navbake.views.describe.describe_cell`, as text or lists of names."""
    room = facts["room"]
    weight = facts["weight"]
    floor = facts["floor"]
    return {
        "level": str(facts["level"]),
        "cell": "{cell} (row {row}, col {col})".format_map(facts),
        "center [m]": ", ".join(f"{v:.3f}" for v in facts["center"]),
        "floor [m]": "none" if floor is None else f"{floor:.3f}",
        "weight": "infinite" if weight is None else f"{weight:g}",
        "room": str(room["id"] if isinstance(room, dict) else room or "none"),
        "island": str(facts["island"] or "none"),
        **({"area": facts["area"]} if facts["area"] else {}),
        **({"links": facts["links"]} if facts["links"] else {}),
        **{key: facts[key] for key in ("doors", "objects", "walls")},
    }
