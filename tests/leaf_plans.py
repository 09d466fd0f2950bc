"""Plans of rooms, each behind closed leaves, at any place on the lattice and any angle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

WALL = 0.1  # thickness [m]
NARROWEST = 0.9  # room [m]
HIGH, LEAF_HIGH, GAP = 2.5, 2.05, 0.01  # walls, leaves, and the gap round leaves [m]


class Rect(NamedTuple):
    """A room's floor between its walls [m]."""

    x0: float
    x1: float
    y0: float
    y1: float

    @property
    def area(self) -> float:
        return (self.x1 - self.x0) * (self.y1 - self.y0)


class Leaf(NamedTuple):
    """A closed leaf, and the rooms on its two sides, by their places in the plan's list."""

    name: str
    rooms: tuple[int, int]


def box(x0: float, x1: float, y0: float, y1: float, z0: float = 0.0, z1: float = HIGH) -> str:
    """A box between planes [m]."""
    x, y, z = (x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2
    size = f"{(x1 - x0) / 2:.6f} {(y1 - y0) / 2:.6f} {(z1 - z0) / 2:.6f}"
    return f'<geom type="box" pos="{x:.6f} {y:.6f} {z:.6f}" size="{size}"/>'


def leaf(
    name: str,
    x: float,
    y: float,
    width: float,
    *,
    along: str = "x",
    sign: int = 1,
    high: float = LEAF_HIGH,
) -> str:
    """A leaf that hangs at a point and closes an opening from there on, along x or y [m]."""
    middle = sign * width / 2
    half = width / 2 - GAP
    pos, size = (f"{middle} 0", f"{half} 0.02") if along == "x" else (f"0 {middle}", f"0.02 {half}")
    return (
        f'<body name="{name}" pos="{x:.6f} {y:.6f} 0"><joint axis="0 0 {sign}" range="0 1.5"/>'
        f'<geom type="box" pos="{pos} {high / 2}" size="{size} {high / 2 - GAP}"/></body>'
    )


def room(x0: float, x1: float, y0: float, y1: float) -> str:
    """A floor with walls round it; `x0` to `y1` are the walls' inner faces [m]."""
    return (
        box(x0 - WALL, x1 + WALL, y0 - WALL, y1 + WALL, -0.1, 0.0)
        + box(x0 - WALL, x0, y0 - WALL, y1 + WALL)
        + box(x1, x1 + WALL, y0 - WALL, y1 + WALL)
        + box(x0, x1, y0 - WALL, y0)
        + box(x0, x1, y1, y1 + WALL)
    )


def world(*parts: str, angle: float = 0.0) -> str:
    """An MJCF text of these things, turned by an angle [rad]."""
    content = "".join(parts)
    return (
        '<mujoco><compiler angle="radian"/><worldbody>'
        f'<frame euler="0 0 {angle}">{content}</frame></worldbody></mujoco>'
    )


class Plan(NamedTuple):
    """Rooms that closed leaves part, and what they are made of."""

    rooms: list[Rect]
    leaves: list[Leaf]
    text: str


class Split(NamedTuple):
    """A wall across a room with an opening in it, along x or y, by where it is on both axes [m]."""

    along: str
    across: tuple[float, float]
    ends: tuple[float, float]
    opening: tuple[float, float]

    def rect(self, first: float, last: float) -> Rect:
        """The part of the wall between two places along it."""
        return (
            Rect(*self.across, first, last)
            if self.along == "y"
            else Rect(first, last, *self.across)
        )


def draw_plan(seed: int, turned: bool) -> Plan:
    """Divide a rectangle by walls, one in each room, with a leaf or two in an opening of each."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0.0, 0.2, 2)
    whole = Rect(x, x + rng.uniform(5.0, 10.0), y, y + rng.uniform(3.0, 7.0))
    rooms = [whole]
    openings = list[Rect]()
    leaves = list[Leaf]()
    parts = [room(*whole)]
    for number in range(rng.integers(1, 6)):
        # the largest room is divided across its longer side
        k = max(range(len(rooms)), key=lambda k: rooms[k].area)
        drawn = (_draw_split(rng, rooms[k]) for _ in range(20))
        split = next((s for s in drawn if s and not _ends_in_opening(s, openings)), None)
        if split is None:
            break
        openings.append(split.rect(*split.opening))
        parts += _wall(split)
        first, last = split.opening
        place = split.across[0] + WALL * rng.uniform(0.2, 0.8)
        names = [f"leaf_{number}"]
        if last - first > 1.4:
            names = [f"leaf_{number}_a", f"leaf_{number}_b"]
        for hinge, sign, name in zip((first, last), (1, -1), names, strict=False):
            spot = (place, hinge) if split.along == "y" else (hinge, place)
            width = (last - first) / len(names)
            parts.append(leaf(name, *spot, width, along=split.along, sign=sign))
        old, (low, high) = rooms[k], split.across
        if split.along == "y":
            rooms[k] = old._replace(x1=low)
            rooms.append(old._replace(x0=high))
        else:
            rooms[k] = old._replace(y1=low)
            rooms.append(old._replace(y0=high))
        leaves += [Leaf(name, (k, len(rooms) - 1)) for name in names]
    angle = rng.uniform(0.0, np.pi) if turned else 0.0
    return Plan(rooms, leaves, world(*parts, angle=angle))


def _draw_split(rng: np.random.Generator, old: Rect) -> Split | None:
    """A wall across the longer side of a room; None where what it leaves is too narrow."""
    along = "y" if old.x1 - old.x0 >= old.y1 - old.y0 else "x"
    low, high, first, last = old if along == "y" else (old.y0, old.y1, old.x0, old.x1)
    at = low + rng.uniform(NARROWEST, max(NARROWEST, (high - low) / 2))
    if high - at - WALL < NARROWEST:
        return None
    width = rng.uniform(0.7, min(2.9, last - first - 2 * WALL))
    start = rng.uniform(first + WALL, last - WALL - width)
    return Split(along, (at, at + WALL), (first, last), (start, start + width))


def _ends_in_opening(split: Split, openings: list[Rect]) -> bool:
    """Whether a wall would end in or at an opening of another one."""
    x0, x1, y0, y1 = split.rect(*split.ends)
    beside = 1.5 * WALL
    return any(
        x0 - beside <= other.x1
        and x1 + beside >= other.x0
        and y0 - beside <= other.y1
        and y1 + beside >= other.y0
        for other in openings
    )


def _wall(split: Split) -> list[str]:
    """The boxes of a wall with an opening under a lintel."""
    first, last = split.opening
    above = LEAF_HIGH + GAP
    return [
        box(*split.rect(split.ends[0], first)),
        box(*split.rect(last, split.ends[1])),
        box(*split.rect(first, last), above),
    ]
