"""Tables of a grid's facts: the command line prints them, and a report shows them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from navbake.errors import printable
from navbake.lengths import format_length

if TYPE_CHECKING:
    from navbake.navgrid.links import Link
    from navbake.navgrid.rooms import Door, Room
    from navbake.types import Json

LEVEL_COLUMNS = {
    "#": "{index}",
    "name": "{name}",
    "cells": "{width} x {height}",
    "ground m": "{ground_text}",
    "floor m": "{floor}",
    "floor m2": "{floor_area:.2f}",
    "free m2": "{free_area:.2f}",
    "islands": "{num_islands}",
    "largest m2": "{largest_island_area:.2f}",
}
"""Heading of a column -> the format of its cells, which names the facts of a level."""


class Table(NamedTuple):
    """A table of text.

    Attributes:
        headings: the headings of the columns; all empty for a table without headings.
        rows: the rows, with a text for each column; control characters are escaped.
        numbers: the headings of columns of numbers, which are aligned on the right.
        gap: the number of spaces between printed columns.
    """

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    numbers: frozenset[str] = frozenset()
    gap: int = 2

    def without_empty_columns(self) -> Table:
        """Return the table without the columns that are empty in all rows."""
        column_indices = [i for i in range(len(self.headings)) if any(row[i] for row in self.rows)]
        rows = [[row[i] for i in column_indices] for row in self.rows]
        return self._replace(headings=[self.headings[i] for i in column_indices], rows=rows)


def make_table(
    headings: Sequence[str],
    rows: Iterable[Sequence[object]],
    numbers: Iterable[str] = (),
    gap: int = 2,
) -> Table:
    """Make a table of values.

    Args:
        headings: the headings of the columns.
        rows: the rows, with a value for each column; None is an empty cell.
        numbers: the headings of columns of numbers, which are aligned on the right.
        gap: the number of spaces between printed columns.
    """
    cells = [[printable("" if cell is None else str(cell)) for cell in row] for row in rows]
    return Table(headings, cells, frozenset(numbers), gap)


def list_grid_facts(facts: Json) -> list[tuple[str, str]]:
    """List the main facts about a grid as pairs of a name and a text.

    Args:
        facts: the grid's description, the result of `navbake.views.describe.describe`.
    """
    inflation_format = "{radius}, clearance {clearance} ({mode})"
    agent_facts = {  # its sizes [m], and the largest slope [deg]
        f"agent {name.replace('_', ' ')} {'[deg]' if 'slope' in name else '[m]'}": str(value)
        for name, value in facts["agent"].items()
    }
    return [
        ("scene", facts["scene_id"] or "not named"),
        ("cell size [m]", f"{facts['cell_size']:g}"),
        *agent_facts.items(),
        *(
            ("inflated to [m]", inflation_format.format_map(inflation))
            for inflation in facts["inflated"]
        ),
        ("islands", str(facts["num_islands"])),
        ("steps", str(facts["num_steps"])),
        *((key, str(len(facts[key]))) for key in ("links", "areas", "agents") if facts[key]),
        ("doors", str(len(facts["doors"]))),
    ]


def make_level_table(facts: Json) -> Table:
    """Make a table with a row for each level; the number of rooms is shown only if there are rooms.

    Args:
        facts: the grid's description, the result of `navbake.views.describe.describe`.
    """
    format_of_column = dict(LEVEL_COLUMNS)
    if any(level["num_rooms"] for level in facts["levels"]):
        format_of_column["rooms"] = "{num_rooms}"
    rows = []
    for level_number, level in enumerate(facts["levels"]):
        has_floor = level["floor_min"] is not None
        floor_text = "none"
        if has_floor:
            floor_text = f"{_height_text(level['floor_min'])} to {_height_text(level['floor_max'])}"
        ground_text = _height_text(level["ground"])
        level_facts = {
            **level,
            "index": level_number,
            "floor": floor_text,
            "ground_text": ground_text,
        }
        rows.append(
            [cell_format.format_map(level_facts) for cell_format in format_of_column.values()]
        )
    return make_table(
        tuple(format_of_column), rows, numbers=format_of_column.keys() - {"name"}, gap=1
    )


def make_room_table(rooms: Sequence[Room], level_names: Sequence[str]) -> Table:
    """Make a table with a row for each room, without empty columns.

    Args:
        rooms: the rooms of a grid.
        level_names: the names of the grid's levels.
    """
    rows = []
    for room in rooms:
        neighbour_texts = []
        for neighbour in room.neighbours:
            opening_text = neighbour.door or ("steps" if neighbour.kind == "link" else "")
            neighbour_texts.append(
                f"{neighbour.room} ({opening_text})" if opening_text else neighbour.room
            )
        source_text = room.source or ""
        if room.outdoors:
            source_text += ", outdoors"
        rows.append(
            (
                room.id,
                room.name,
                level_names[room.level] if len(level_names) > 1 else "",
                "" if room.id == f"{room.level}:{room.index}" else room.index,
                f"{room.area:.2f}",
                _position_text(room.centroid),
                source_text,
                ", ".join(neighbour_texts),
            )
        )
    headings = ("id", "name", "level", "index", "m2", "centroid x y z m", "from", "opens to")
    return make_table(headings, rows, numbers=("index", "m2")).without_empty_columns()


def make_door_table(doors: Sequence[Door], level_names: Sequence[str]) -> Table:
    """Make a table with a row for each door, without empty columns.

    Args:
        doors: the doors of a grid.
        level_names: the names of the grid's levels.
    """
    has_joints = any(door.joint != door.id for door in doors)
    rows = []
    for door in doors:
        joint_text = (door.joint or "none") if has_joints else ""
        level_text = (
            ", ".join(level_names[level] for level in door.levels) if len(level_names) > 1 else ""
        )
        # a body that the user declared a door may stand anywhere, and join no rooms
        room_names = [room or "outside" for room in door.rooms] if any(door.rooms) else ["nothing"]
        # the pose in which a door was modelled may be that of another state
        is_half_open = door.state == "modelled" and {"open", "closed"} <= set(door.states)
        equal_state = door.like or ("half-open" if is_half_open else None)
        state_text = f"{door.state} ({equal_state})" if equal_state else door.state
        states_text = ", ".join(door.states)
        rows.append(
            (door.id, joint_text, level_text, " - ".join(room_names), state_text, states_text)
        )
    headings = ("door", "joint", "level", "joins", "is", "can be")
    return make_table(headings, rows).without_empty_columns()


def make_link_table(links: Sequence[Link], level_names: Sequence[str]) -> Table:
    """Make a table with a row for each named link, without empty columns.

    Args:
        links: the links of a grid.
        level_names: the names of the grid's levels.
    """
    rows = []
    for link in links:
        separator = " > " if link.one_way else " - "
        rows.append(
            (
                link.name,
                link.kind,
                separator.join(_position_text(stop.position) for stop in link.stops),
                ", ".join(dict.fromkeys(level_names[stop.level] for stop in link.stops)),
                _number_text(link.width),
                _number_text(link.cost),
                _number_text(link.seconds),
                _agents_text(link.agents),
                link.state,
            )
        )
    headings = ("link", "kind", "stops x y z m", "levels", "wide m", "cost m", "s", "for", "is")
    return make_table(headings, rows, numbers=("wide m", "cost m", "s")).without_empty_columns()


def make_area_table(areas: Sequence[Json]) -> Table:
    """Make a table with a row for each area, without empty columns.

    Args:
        areas: the grid's areas, ``areas`` in the result of `navbake.views.describe.describe`.
    """
    rows = [
        (
            area["name"],
            area["cost"],
            _number_text(area.get("speed")),
            _agents_text(area.get("agents")),
            f"{area['m2']:.2f}",
        )
        for area in areas
    ]
    headings = ("area", "cost", "m/s", "for", "m2")
    return make_table(headings, rows, numbers=("cost", "m/s", "m2")).without_empty_columns()


def make_agent_table(agents: Mapping[str, Json]) -> Table:
    """Make a table with a row for each agent, without empty columns.

    Args:
        agents: the grid's agents, ``agents`` in the result of `navbake.views.describe.describe`.
    """
    heading_of_key = {"radius": "radius m", "height": "height m", "step": "step m", "speed": "m/s"}
    rows = [
        (name, *(_number_text(agent.get(key)) for key in heading_of_key))
        for name, agent in agents.items()
    ]
    return make_table(
        ("agent", *heading_of_key.values()), rows, heading_of_key.values()
    ).without_empty_columns()


def _position_text(position: Iterable[float]) -> str:
    return " ".join(map(format_length, position))


def _height_text(z: float) -> str:
    return format_length(z, 3)


def _number_text(value: float | None) -> str:
    return "" if value is None else f"{value:g}"


def _agents_text(agents: Iterable[str] | None) -> str:
    return "" if agents is None else ", ".join(agents) or "nobody"


def list_cell_facts(facts: Json) -> dict[str, str | list[str]]:
    """Return the facts of a cell for a table: name of a fact -> its text, or a list of names.

    Args:
        facts: the cell's description, the result of `navbake.views.describe.describe_cell`.
    """
    room = facts["room"]
    weight = facts["weight"]
    floor = facts["floor"]
    return {
        "level": str(facts["level"]),
        "cell": "{cell} (row {row}, col {col})".format_map(facts),
        "center [m]": ", ".join(format_length(coordinate, 3) for coordinate in facts["center"]),
        "floor [m]": "none" if floor is None else _height_text(floor),
        "weight": "infinite" if weight is None else f"{weight:g}",
        "room": str(room["id"] if isinstance(room, dict) else room or "none"),
        "island": str(facts["island"] or "none"),
        **({"area": facts["area"]} if facts["area"] else {}),
        **({"links": facts["links"]} if facts["links"] else {}),
        **{key: facts[key] for key in ("doors", "objects", "walls")},
        **({"lower than a step": facts["lower_than_step"]} if facts.get("lower_than_step") else {}),
    }
