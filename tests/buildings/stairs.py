"""Stairs of four kinds, each in a rectangle of its own that begins at (0, 0).

Treads rise by at most 0.19 m. A flight is left at the rectangle's low x side and arrives where
its kind says; the slab above is open over all treads that need the headroom.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from random import Random
from typing import NamedTuple

from buildings.parts import Building, Point, Rect, Stairway, shifted

RISER = 0.19
HEADROOM = 2.05
SOLID = 99.0  # thickness of treads that reach down to the floor [m]
KINDS = ("straight", "half_landing", "l_shape", "spiral")


@dataclass
class Stairs:
    """One storey's stairs, heights from the floor where they begin.

    Attributes:
        size: of the rectangle, along x and y.
        treads: rectangle and height of each tread and landing.
        sectors: corners and height of each tread of a spiral.
        openings: where the slab above is open.
        guards: where a railing or a wall may stand round the opening, outside of it.
        bridges: parts of the slab above that reach into the opening.
        pole: the middle of a spiral, or None.
    """

    size: tuple[float, float]
    treads: list[tuple[Rect, float]]
    sectors: list[tuple[list[tuple[float, float]], float]]
    openings: list[Rect]
    guards: list[Rect]
    bridges: list[Rect]
    pole: Rect | None = None

    def tread_prism(self, number: int, base: float, thickness: float) -> list[Point]:
        corners, height = self.sectors[number]
        top = base + height
        return [(x, y, z) for z in (top - thickness, top) for x, y in corners]


def place_stairs(
    made: Building, stairs: Stairs, x: float, y: float, z: float, thickness: float
) -> None:
    """Stand stairs in a building, on a floor at z."""
    for rect, height in stairs.treads:
        made.add(shifted(rect, x, y), max(z, z + height - thickness), z + height)
    for i in range(len(stairs.sectors)):
        points = stairs.tread_prism(i, z, 0.06)
        made.prisms.append([(x + a, y + b, c) for a, b, c in points])
    top = z + max(h for _, h in [*stairs.treads, *stairs.sectors])
    if stairs.pole:
        made.add(shifted(stairs.pole, x, y), z, top)
    made.stairs.append(Stairway((x, y, x + stairs.size[0], y + stairs.size[1]), z, top))


class Flight(NamedTuple):
    """What the kinds of stairs have in common: measures of their treads."""

    number: int
    riser: float
    depth: float
    width: float
    slab: float
    guard: float
    whole: bool


def make_stairs(kind: str, rise: float, slab: float, guard: float, rng: Random) -> Stairs:
    """Stairs of a kind that rise to the next floor, through a slab of some thickness."""
    number = math.ceil(rise / RISER)
    number += number % 2 if kind == "half_landing" else 0  # equal flights
    depth, width, whole = rng.uniform(0.26, 0.29), rng.uniform(0.95, 1.2), rng.random() < 0.5
    if kind == "spiral":
        return _spiral(number, rise / number, guard, rng)
    maker = {"straight": _straight, "half_landing": _half_landing, "l_shape": _l_shape}[kind]
    return maker(Flight(number, rise / number, depth, width, slab, guard, whole))


def _open_from(flight: Flight) -> float:
    """Where along the first flight the slab above is open: over all of it, or from there on."""
    number, riser, depth, _, slab, _, whole = flight
    if whole:
        return 0.0
    low = sum((i + 1) * riser + HEADROOM <= number * riser - slab for i in range(number))
    return low * depth


def _straight(flight: Flight) -> Stairs:
    n, riser, depth, width, _, guard, _ = flight
    length = (n - 1) * depth
    treads = [((i * depth, 0.0, (i + 1) * depth, width), (i + 1) * riser) for i in range(n - 1)]
    start = _open_from(flight)
    guards = [(start, width, length, width + guard)]
    return Stairs((length, width), treads, [], [(start, 0.0, length, width)], guards, [])


def _half_landing(flight: Flight) -> Stairs:
    n, riser, depth, width, _, guard, _ = flight
    first = n // 2
    length, gap = (first - 1) * depth, 0.1
    across = 2 * width + gap
    treads = [((i * depth, 0.0, (i + 1) * depth, width), (i + 1) * riser) for i in range(first - 1)]
    treads.append(((length, 0.0, length + width, across), first * riser))
    for i in range(first - 1):
        end = length - i * depth
        treads.append(((end - depth, width + gap, end, across), (first + 1 + i) * riser))
    guards = [
        (0.0, across, length + width + guard, across + guard),
        (length + width, 0.0, length + width + guard, across),
    ]
    opening = (0.0, 0.0, length + width, across)
    return Stairs((length + width + guard, across), treads, [], [opening], guards, [])


def _l_shape(flight: Flight) -> Stairs:
    n, riser, depth, width, _, guard, _ = flight
    first = n // 2
    length, second = (first - 1) * depth, (n - first - 1) * depth
    treads = [((i * depth, 0.0, (i + 1) * depth, width), (i + 1) * riser) for i in range(first - 1)]
    treads.append(((length, 0.0, length + width, width), first * riser))
    for i in range(n - first - 1):
        rect = (length, width + i * depth, length + width, width + (i + 1) * depth)
        treads.append((rect, (first + 1 + i) * riser))
    start = min(_open_from(flight), length)
    openings = [
        (start, 0.0, length + width, width),
        (length, width, length + width, width + second),
    ]
    guards = [
        (start, width, length, width + guard),
        (length - guard, width + guard, length, width + second),
    ]
    return Stairs((length + width, width + second), treads, [], openings, guards, [])


def _spiral(n: int, riser: float, guard: float, rng: Random) -> Stairs:
    """One turn a storey; a bridge at +x is the last step, and the next storey's begin there."""
    radius, edge = rng.uniform(1.15, 1.3), 2 * math.pi / n
    sectors = []
    for i in range(n - 1):
        a, b = (i + 0.5) * edge, (i + 1.5) * edge
        inner, outer = 0.06, radius
        corners = [
            (radius + r * math.cos(t), radius + r * math.sin(t))
            for r, t in ((inner, a), (outer, a), (outer, b), (inner, b))
        ]
        sectors.append((corners, (i + 1) * riser))
    half = radius * math.tan(edge / 2)
    side = 2 * radius
    bridge = (radius + 0.35, radius - half, side, radius + half)
    guards = [
        (-guard, side, side + guard, side + guard),
        (-guard, 0.0, 0.0, side),
        (side, 0.0, side + guard, radius - 0.5),
        (side, radius + 0.5, side + guard, side),
    ]
    pole = (radius - 0.06, radius - 0.06, radius + 0.06, radius + 0.06)
    return Stairs((side, side), [], sectors, [(0.0, 0.0, side, side)], guards, [bridge], pole)
