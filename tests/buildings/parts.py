"""What generated buildings are put together from: boxes, prisms, walls and slabs.

Lengths are in metres. A rectangle is (x0, y0, x1, y1) in the building's own frame, whose origin
is the outer corner of the house; `Placing` turns and shifts the whole building into the world.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from navbake.types import Float

Rect = tuple[float, float, float, float]
Point = tuple[float, float, float]


class Box(NamedTuple):
    """A solid box: a rectangle from one height to another."""

    rect: Rect
    bottom: float
    top: float


class Opening(NamedTuple):
    """A gap in a wall, along the wall's longer side, from its foot up to the head."""

    start: float
    end: float
    head: float


class Patch(NamedTuple):
    """A floor that has to be found, and the place that it belongs to."""

    place: str
    rect: Rect
    z: float
    holes: tuple[Rect, ...] = ()


class Stairway(NamedTuple):
    """Where steps lie between two heights; cells of it may be floor at any height in between."""

    rect: Rect
    bottom: float
    top: float


class Placing(NamedTuple):
    """How the building lies in the world.

    It is mirrored and turned by quarters, which keeps rectangles along the axes ("placed"); then
    tilted about x, turned about z, and shifted.

    Attributes:
        tilt, turn: angles [degrees].
    """

    mirrored: bool = False
    quarters: int = 0
    x: float = 0.0
    y: float = 0.0
    tilt: float = 0.0
    turn: float = 0.0

    def point(self, x: float, y: float) -> tuple[float, float]:
        """A point of the building, placed."""
        x = -x if self.mirrored else x
        for _ in range(self.quarters):
            x, y = -y, x
        return x, y

    def rect(self, rect: Rect) -> Rect:
        """A rectangle of the building, placed."""
        (x0, y0), (x1, y1) = self.point(*rect[:2]), self.point(*rect[2:])
        return min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1)

    def rotation(self) -> Float:
        """From placed to world coordinates, shape (3, 3)."""
        (a, b), (c, d) = (
            (math.cos(math.radians(angle)), math.sin(math.radians(angle)))
            for angle in (self.turn, self.tilt)
        )
        return np.array([[a, -b, 0], [b, a, 0], [0, 0, 1]]) @ [[1, 0, 0], [0, c, -d], [0, d, c]]

    def quat(self) -> str:
        """The same as a quaternion of MuJoCo's."""
        turn, tilt = math.radians(self.turn) / 2, math.radians(self.tilt) / 2
        w, x = math.cos(turn) * math.cos(tilt), math.cos(turn) * math.sin(tilt)
        y, z = math.sin(turn) * math.sin(tilt), math.sin(turn) * math.cos(tilt)
        return f"{w!r} {x!r} {y!r} {z!r}"

    def back(self, x: Float, y: Float, z: Float) -> tuple[Float, Float, Float]:
        """Placed coordinates of points of the world."""
        points = np.stack([x - self.x, y - self.y, z], axis=-1) @ self.rotation()
        return points[..., 0], points[..., 1], points[..., 2]

    def under(self, x: Float, y: Float, z: float) -> tuple[Float, Float]:
        """Where vertical lines of the world cross a placed height."""
        turn = self.rotation()
        across = np.stack([x - self.x - turn[0, 2] * z, y - self.y - turn[1, 2] * z], axis=-1)
        points = across @ np.linalg.inv(turn[:2, :2]).T
        return points[..., 0], points[..., 1]


@dataclass
class Building:
    """A building: its geometry and the truth about it.

    Attributes:
        features: what it has, a word for each kind of feature.
        boxes, prisms: its geometry; a prism is the hull of its points.
        plane: whether there is endless ground at 0.
        floors: what has to be floor.
        maybe: further floors that may be found or not, as thresholds of doors.
        stairs: where steps lie.
        joined: pairs of places between which one can walk, directly.
        levels: how many storeys a person would count.
        placing: how it lies in the world.
    """

    features: dict[str, str] = field(default_factory=dict)
    boxes: list[Box] = field(default_factory=list)
    prisms: list[list[Point]] = field(default_factory=list)
    plane: bool = False
    floors: list[Patch] = field(default_factory=list)
    maybe: list[Patch] = field(default_factory=list)
    stairs: list[Stairway] = field(default_factory=list)
    joined: list[tuple[str, str]] = field(default_factory=list)
    levels: int = 1
    placing: Placing = field(default_factory=Placing)

    def add(self, rect: Rect, bottom: float, top: float) -> None:
        self.boxes.append(Box(rect, bottom, top))

    def slab(self, rect: Rect, top: float, thickness: float, holes: Sequence[Rect] = ()) -> None:
        for piece in subtract(rect, holes):
            self.add(piece, top - thickness, top)

    def wall(self, rect: Rect, bottom: float, top: float, openings: Sequence[Opening] = ()) -> None:
        """A wall with openings along its longer side, which don't overlap."""
        along_x = rect[2] - rect[0] >= rect[3] - rect[1]
        start, end = (rect[0], rect[2]) if along_x else (rect[1], rect[3])
        pieces = []
        for opening in sorted(openings):
            pieces.append((start, opening.start, bottom))
            if opening.head < top - 0.05:
                pieces.append((opening.start, opening.end, opening.head))
            start = opening.end
        pieces.append((start, end, bottom))
        for a, b, foot in pieces:
            if b - a > 1e-9:
                piece = (a, rect[1], b, rect[3]) if along_x else (rect[0], a, rect[2], b)
                self.add(piece, foot, top)

    def mjcf(self) -> str:
        """The building as an MJCF text."""
        assets, geoms = [], []
        if self.plane:
            geoms.append('<geom name="ground" type="plane" size="0 0 1"/>')
        for rect, bottom, top in self.boxes:
            x0, y0, x1, y1 = self.placing.rect(rect)
            pos = f"{(x0 + x1) / 2:.9g} {(y0 + y1) / 2:.9g} {(bottom + top) / 2:.9g}"
            size = f"{(x1 - x0) / 2:.9g} {(y1 - y0) / 2:.9g} {(top - bottom) / 2:.9g}"
            geoms.append(f'<geom type="box" pos="{pos}" size="{size}"/>')
        for number, points in enumerate(self.prisms):
            placed = [(*self.placing.point(x, y), z) for x, y, z in points]
            vertices = " ".join(f"{v:.9g}" for point in placed for v in point)
            assets.append(f'<mesh name="prism_{number}" vertex="{vertices}"/>')
            geoms.append(f'<geom type="mesh" mesh="prism_{number}"/>')
        pos, quat = f"{self.placing.x!r} {self.placing.y!r} 0", self.placing.quat()
        body = f'<body pos="{pos}" quat="{quat}">'
        lines = ["<mujoco>", "<asset>", *assets, "</asset>", "<worldbody>", body, *geoms]
        return "\n".join([*lines, "</body>", "</worldbody>", "</mujoco>"])

    def settings(self, cell_size: float) -> dict[str, dict[str, float]]:
        """The settings to bake it with, but for `scene`."""
        # an endless plane doesn't count towards the scene's box
        return {"grid": {"cell_size": cell_size, "margin": 1.5 if self.plane else 0.0}}


def subtract(rect: Rect, holes: Sequence[Rect]) -> list[Rect]:
    """Rectangles that make up a rectangle less some holes."""
    ys = sorted({rect[1], rect[3], *(y for h in holes for y in (h[1], h[3]))})
    pieces = []
    for y0, y1 in pairwise(ys):
        if y1 <= rect[1] or y0 >= rect[3]:
            continue
        x = rect[0]
        for hole in sorted(h for h in holes if h[1] < y1 and h[3] > y0):
            if hole[0] > x:
                pieces.append((x, y0, min(hole[0], rect[2]), y1))
            x = max(x, hole[2])
        if x < rect[2]:
            pieces.append((x, y0, rect[2], y1))
    return pieces


def shifted(rect: Rect, x: float, y: float) -> Rect:
    return rect[0] + x, rect[1] + y, rect[2] + x, rect[3] + y


def frame(rect: Rect, thickness: float) -> list[Rect]:
    """Four walls along the inside of a rectangle: low y, high x, high y, low x."""
    x0, y0, x1, y1 = rect
    return [
        (x0, y0, x1, y0 + thickness),
        (x1 - thickness, y0 + thickness, x1, y1 - thickness),
        (x0, y1 - thickness, x1, y1),
        (x0, y0 + thickness, x0 + thickness, y1 - thickness),
    ]
