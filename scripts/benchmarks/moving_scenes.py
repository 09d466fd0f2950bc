"""Scenes in which things are moved: halls, houses of many rooms and storeys, and what is unkind.

Unkind are a ceiling slab as wide as the floor, ground beyond the walls that no step reaches, bounds
wider than the building, a second storey: what the floors of a whole scene depend on.
"""

from __future__ import annotations

import math
import random
import re
from typing import Any

from make_house import ROOM, make_house

HALL = 30.0  # edge of the hall [m]
STOREY = 3.0  # from the floor of a storey to that of the next [m]
WIDER = 1.0  # by how much bounds are wider than the building [m]

Settings = dict[str, Any]


def box(name: str, x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> str:
    """A box geom between coordinates."""
    pos = " ".join(f"{(low + high) / 2:.4f}" for low, high in (x, y, z))
    size = " ".join(f"{(high - low) / 2:.4f}" for low, high in (x, y, z))
    return f'<geom name="{name}" type="box" pos="{pos}" size="{size}"/>'


def thing(name: str, geom: str, pos: tuple[float, float, float]) -> str:
    """A body with a free joint and one geom."""
    place = " ".join(f"{value:.4f}" for value in pos)
    return f'<body name="{name}" pos="{place}"><freejoint/><geom {geom}/></body>'


def make_hall(*, ceiling: bool, ground: bool, wider: bool) -> tuple[str, Settings]:
    """An empty hall with one chair."""
    edge = HALL
    parts = [box("floor", (0, edge), (0, edge), (-0.1, 0))]
    parts += [
        box("south", (0, edge), (0, 0.1), (0, 2.6)),
        box("north", (0, edge), (edge - 0.1, edge), (0, 2.6)),
        box("west", (0, 0.1), (0, edge), (0, 2.6)),
        box("east", (edge - 0.1, edge), (0, edge), (0, 2.6)),
    ]
    if ceiling:
        parts.append(box("ceiling", (0, edge), (0, edge), (2.6, 2.7)))
    if ground:
        parts.append('<geom name="ground" type="plane" size="0 0 1" pos="0 0 -0.3"/>')
    parts.append(thing("chair", 'type="box" size="0.2 0.2 0.4"', (10, 10, 0.4)))
    settings: Settings = {"grid": {"cell_size": 0.05}}
    if wider:
        settings["grid"]["bounds"] = [-WIDER, -WIDER, edge + WIDER, edge + WIDER]
    return wrap("".join(parts)), settings


def make_rooms(
    rooms: int, *, ceiling: bool = False, wider: bool = False, free: bool = True
) -> tuple[str, Settings]:
    """A house of furnished rooms over an endless plane, a body for each piece of furniture."""
    xml = make_house(rooms)
    edge = math.isqrt(rooms) * ROOM
    if ceiling:
        xml = add(xml, box("ceiling", (0, edge), (0, edge), (2.5, 2.7)))
    settings: Settings = {"grid": {"cell_size": 0.05}}
    if wider:
        settings["grid"]["bounds"] = [-WIDER, -WIDER, edge + WIDER, edge + WIDER]
    return free_pieces(xml) if free else xml, settings


def make_storeys(
    storeys: int, *, ceiling: bool, wider: bool, rooms: int = 4, cell_size: float = 0.1
) -> tuple[str, Settings]:
    """A house of some storeys over ground, with stairs, free furniture, and what else moves.

    There are a robot on a planar base, a person (a mocap body), a cupboard with a hinged leaf that
    is no door, and a ball and a crate that are stacked.
    """
    xml = make_house(rooms, with_doors=True)
    edge = math.isqrt(rooms) * ROOM
    body = re.search("<worldbody>(.*)</worldbody>", xml, re.DOTALL)
    assert body is not None
    own = re.sub(r'<geom name="ground"[^>]*/>', "", body[1])
    parts = []
    for number in range(1, storeys):
        above = re.sub(r'name="', f'name="up{number}_', own)
        parts.append(f'<frame pos="0 0 {number * STOREY}">{above}</frame>')
        parts.append(_stairs(number, edge))
    top = storeys * STOREY
    if ceiling:
        parts.append(box("ceiling", (0, edge), (0, edge), (top - 0.4, top - 0.2)))
    parts.append(
        '<body name="robot" pos="2.5 2.5 0.4">'
        '<joint name="drive_x" type="slide" axis="1 0 0" range="-2 2"/>'
        '<joint name="drive_y" type="slide" axis="0 1 0" range="-2 2"/>'
        '<joint name="yaw" axis="0 0 1" range="-3 3"/>'
        '<geom type="box" size="0.3 0.2 0.35"/>'
        '<body name="arm" pos="0.2 0 0.5"><joint name="lift_arm" axis="0 1 0" range="-1 1"/>'
        '<geom type="capsule" fromto="0 0 0 0.3 0 0.1" size="0.05"/></body></body>'
    )
    parts.append(
        '<body name="person" mocap="true" pos="1 1 0.8">'
        '<geom type="capsule" size="0.2 0.5"/></body>'
    )
    parts.append(
        f'<body name="cupboard" pos="{edge - 0.5:.3f} {edge / 2 + 1.5:.3f} 0">'
        '<geom type="box" pos="0.2 0 0.9" size="0.02 0.4 0.9"/>'
        '<geom type="box" pos="0 0.4 0.9" size="0.2 0.02 0.9"/>'
        '<geom type="box" pos="0 -0.4 0.9" size="0.2 0.02 0.9"/>'
        '<body name="cupboard_leaf" pos="-0.22 -0.4 0"><joint name="cupboard_leaf" axis="0 0 1" '
        'range="0 1.5"/><geom type="box" pos="0 0.4 0.9" size="0.02 0.39 0.88"/></body></body>'
    )
    parts.append(thing("ball", 'type="sphere" size="0.2"', (1.5, 3.5, 0.2)))
    parts.append(thing("crate", 'type="box" size="0.3 0.3 0.1"', (1.5, 2.8, 0.1)))
    settings: Settings = {"grid": {"cell_size": cell_size}}
    if wider:
        settings["grid"]["bounds"] = [-WIDER, -WIDER, edge + WIDER, edge + WIDER]
    return free_pieces(add(xml, "".join(parts))), settings


def _stairs(number: int, edge: float) -> str:
    """A flight outside of the house, along its east wall, up to a storey by a landing."""
    steps = 15
    low = (number - 1) * STOREY
    parts = []
    for k in range(steps):
        top = low + (k + 1) * STOREY / steps
        y = (0.3 + 0.28 * k, 0.3 + 0.28 * (k + 1))
        parts.append(box(f"stair_{number}_{k}", (edge, edge + 0.9), y, (top - 0.2, top)))
    return "".join(parts)


def add(xml: str, parts: str) -> str:
    """The scene with further parts of the world."""
    return xml.replace("</worldbody>", f"{parts}</worldbody>")


def wrap(parts: str) -> str:
    """A scene of some parts of the world."""
    return f"<mujoco><worldbody>{parts}</worldbody></mujoco>"


def free_pieces(xml: str) -> str:
    """The house with a body and a free joint for each piece of furniture."""

    def as_body(match: re.Match[str]) -> str:
        geom = match.group(0)
        name = re.search(r' name="([^"]+)"', geom).group(1)  # type: ignore[union-attr]
        pos = re.search(r' pos="([^"]+)"', geom).group(1)  # type: ignore[union-attr]
        geom = re.sub(r' pos="[^"]+"', "", geom).replace(f'name="{name}"', f'name="{name}_geom"')
        return f'<body name="{name}" pos="{pos}"><freejoint/>{geom}</body>'

    return re.sub(r'<geom name="[^"]*piece[^>]*/>', as_body, xml)


def make_any(seed: int) -> tuple[str, Settings]:
    """A house of one to three storeys, with what is unkind by chance."""
    rng = random.Random(seed)
    return make_storeys(
        1 + seed % 3,
        ceiling=rng.random() < 0.7,
        wider=rng.random() < 0.6,
        rooms=rng.choice((1, 4)),
        cell_size=rng.choice((0.1, 0.08)),
    )
