"""Offices and flats at random, with the rooms that a person would draw.

A plan is made of upright boxes, in metres, in a frame of its own that is turned in the world. It
can be written as boxes (MJCF) or as one mesh (STL).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from navbake.navgrid.lattice import Lattice

STEP = 1e-6  # metres: shorter pieces of walls are none
SILL = (0.7, 1.0)  # heights of the sills of windows [m]
HEAD = (2.0, 2.15)  # heights of the lintels of doors and windows [m]

Rect = tuple[float, float, float, float]
"""x0, y0, x1, y1 in the plan's frame [m]."""


@dataclass(frozen=True)
class Opening:
    """A hole in a wall.

    Attributes:
        at, width: distance of its middle from the wall's start, and its width [m].
        sill, head: its lower and its upper end over the floor; 0 for a door; the wall's height
            for one without a lintel [m].
    """

    at: float
    width: float
    sill: float
    head: float


@dataclass(frozen=True)
class Window:
    """Where a window is in a plan.

    Attributes:
        middle, way: its middle, and the direction of its wall, each (2,) [m].
        width, thick: of the opening and of the wall [m].
    """

    middle: NDArray[np.float64]
    way: NDArray[np.float64]
    width: float
    thick: float


@dataclass
class Plan:
    """The boxes of a building, and its rooms.

    Attributes:
        boxes: name, centre, half sizes and turn about z of each [m, rad].
        rooms: the outline of each room, corners without the walls, shape (n, 2) [m].
        turn: of the whole plan in the world [rad].
        widths: of most doors, and of the widest opening [m]; None for 0.8 to 2.2, all alike.
        doors: middle and half width of each door [m].
        windows: openings that nobody can walk through.
        solid: the outlines of what stands in rooms from floor to ceiling, shape (4, 2) [m].
    """

    rng: np.random.Generator
    height: float
    turn: float = 0.0
    widths: tuple[float, float, float] | None = None
    boxes: list[tuple[str, NDArray[np.float64], NDArray[np.float64], float]] = field(
        default_factory=list
    )
    rooms: list[NDArray[np.float64]] = field(default_factory=list)
    doors: list[tuple[float, float, float]] = field(default_factory=list)
    windows: list[Window] = field(default_factory=list)
    solid: list[NDArray[np.float64]] = field(default_factory=list)

    def has_door_near(self, rect: Rect, gap: float) -> bool:
        """Whether a door, as wide as it is both ways, comes so near to a rectangle."""
        x0, y0, x1, y1 = rect
        return any(
            x0 - half - gap < x < x1 + half + gap and y0 - half - gap < y < y1 + half + gap
            for x, y, half in self.doors
        )

    def box(self, name: str, rect: Rect, low: float, high: float) -> None:
        """Add a box over a rectangle."""
        x0, y0, x1, y1 = rect
        center = np.array([(x0 + x1) / 2, (y0 + y1) / 2, (low + high) / 2])
        half = np.array([(x1 - x0) / 2, (y1 - y0) / 2, (high - low) / 2])
        if (half > STEP).all():
            self.boxes.append((f"{name}_{len(self.boxes)}", center, half, 0.0))

    def pier(self, name: str, rect: Rect) -> None:
        """Add a box from floor to ceiling that stands in a room."""
        x0, y0, x1, y1 = rect
        self.box(name, rect, 0.0, self.height)
        self.solid.append(np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]))

    def wall(
        self,
        start: tuple[float, float],
        end: tuple[float, float],
        thick: float,
        openings: list[Opening] | None = None,
    ) -> None:
        """Add a wall along a line, its pieces beside, below and above its openings."""
        begin, way = np.array(start), np.array(end) - np.array(start)
        length = float(np.hypot(*way))
        turn = float(np.arctan2(way[1], way[0]))
        way = way / length

        def piece(a: float, b: float, low: float, high: float) -> None:
            if b - a > STEP and high - low > STEP:
                middle = begin + way * (a + b) / 2
                center = np.array([*middle, (low + high) / 2])
                half = np.array([(b - a) / 2, thick / 2, (high - low) / 2])
                self.boxes.append((f"wall_{len(self.boxes)}", center, half, turn))

        done = 0.0
        for opening in sorted(openings or [], key=lambda o: o.at):
            a, b = opening.at - opening.width / 2, opening.at + opening.width / 2
            if opening.sill == 0.0:
                self.doors.append((*(begin + way * opening.at), opening.width / 2))
            else:
                self.windows.append(Window(begin + way * opening.at, way, opening.width, thick))
            piece(done, a, 0.0, self.height)
            piece(a, b, 0.0, opening.sill)
            piece(a, b, opening.head, self.height)
            done = b
        piece(done, length, 0.0, self.height)

    def door(self, low: float, high: float, widest: float = 2.2) -> Opening:
        """A door between two places along a wall, with a lintel or none."""
        if self.widths is None:
            width = float(self.rng.uniform(0.8, min(widest, 2.2, high - low)))
        else:
            least, usual, most = np.minimum(self.widths, min(widest, high - low))
            is_opening = self.rng.random() < 0.2
            width = float(self.rng.uniform(*((usual, most) if is_opening else (least, usual))))
        at = float(self.rng.uniform(low + width / 2, high - width / 2))
        head = self.height if self.rng.random() < 0.4 else float(self.rng.uniform(*HEAD))
        return Opening(at, width, 0.0, head)

    def window(self, low: float, high: float) -> Opening:
        """A window between two places along a wall, with a lintel or none."""
        width = float(self.rng.uniform(0.6, min(2.4, high - low)))
        at = float(self.rng.uniform(low + width / 2, high - width / 2))
        head = self.height if self.rng.random() < 0.3 else float(self.rng.uniform(*HEAD))
        return Opening(at, width, float(self.rng.uniform(*SILL)), head)

    def room(self, *corners: tuple[float, float]) -> None:
        self.rooms.append(np.array(corners))

    def rect_room(self, rect: Rect) -> None:
        x0, y0, x1, y1 = rect
        self.room((x0, y0), (x1, y0), (x1, y1), (x0, y1))

    def furnish(self, rect: Rect) -> None:
        """Put a few things into a room, away from its walls but for wardrobes in its corners."""
        x0, y0, x1, y1 = rect
        for _ in range(int((x1 - x0) * (y1 - y0) / 12) + 1):
            a, b = self.rng.uniform(0.4, 1.0, 2)
            if x1 - x0 < 2 * a + 1.6 or y1 - y0 < 2 * b + 1.6:
                continue
            x = self.rng.uniform(x0 + a + 0.7, x1 - a - 0.7)
            y = self.rng.uniform(y0 + b + 0.7, y1 - b - 0.7)
            self.box("table", (x - a, y - b, x + a, y + b), 0.0, float(self.rng.uniform(0.4, 0.9)))
        if self.rng.random() < 0.3 and x1 - x0 > 3.0 and y1 - y0 > 3.0:
            self.box("wardrobe", (x0, y0, x0 + 1.0, y0 + 0.6), 0.0, 2.0)

    def to_world(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        cos, sin = np.cos(self.turn), np.sin(self.turn)
        turned: NDArray[np.float64] = points @ np.array([[cos, sin], [-sin, cos]])
        return turned

    def as_mjcf(self) -> str:
        """The plan as boxes."""
        geoms = []
        for name, center, half, turn in self.boxes:
            x, y = self.to_world(center[:2])
            pos, size = f"{x} {y} {center[2]}", " ".join(map(str, half))
            angle = np.rad2deg(turn + self.turn)
            geoms.append(
                f'<geom name="{name}" type="box" pos="{pos}" size="{size}" euler="0 0 {angle}"/>'
            )
        return f'<mujoco><compiler angle="degree"/><worldbody>{"".join(geoms)}</worldbody></mujoco>'

    def write_stl(self, path: Path) -> None:
        """Write the plan as one mesh, a binary STL."""
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])
        triangles = []
        for _, center, half, turn in self.boxes:
            cos, sin = np.cos(turn), np.sin(turn)
            points = corners * half
            points[:, :2] = points[:, :2] @ np.array([[cos, sin], [-sin, cos]])
            points += center
            points[:, :2] = self.to_world(points[:, :2])
            triangles.append(points[faces])
        data = np.concatenate(triangles)
        record = np.zeros(len(data), dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
        record["v"] = data
        path.write_bytes(bytes(80) + np.uint32(len(data)).tobytes() + record.tobytes())

    def in_plan(self, lattice: Lattice) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The coordinates of the cells' centres in the plan's frame [m]."""
        x, y = np.meshgrid(lattice.center_x(), lattice.center_y())
        cos, sin = np.cos(self.turn), np.sin(self.turn)
        return x * cos + y * sin, y * cos - x * sin

    def truth(self, lattice: Lattice) -> list[NDArray[np.bool_]]:
        """The cells of each room whose centres are half a cell or more from all that is solid."""
        u, v = self.in_plan(lattice)
        gap = lattice.cell_size / 2
        blocked = np.zeros(lattice.shape, dtype=np.bool_)
        for corners in self.solid:
            inside, near = _inside(corners, u, v, gap)
            blocked |= inside | near
        rooms = []
        for corners in self.rooms:
            inside, near = _inside(corners, u, v, gap)
            rooms.append(inside & ~near & ~blocked)
        return rooms


def _inside(
    corners: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64], gap: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """The points in a polygon, by the even-odd rule, and those that are so near to its edges."""
    inside = np.zeros(u.shape, dtype=np.bool_)
    near = np.zeros(u.shape, dtype=np.bool_)
    for (x0, y0), (x1, y1) in pairwise([*corners, corners[0]]):
        if y0 != y1:
            inside ^= ((y0 > v) != (y1 > v)) & (u < (x1 - x0) * (v - y0) / (y1 - y0) + x0)
        length = np.hypot(x1 - x0, y1 - y0)
        along = np.clip(((u - x0) * (x1 - x0) + (v - y0) * (y1 - y0)) / length**2, 0, 1)
        near |= np.hypot(u - x0 - along * (x1 - x0), v - y0 - along * (y1 - y0)) < gap
    return inside, near


def make_plan(seed: int) -> Plan:
    """Make an office or a flat; a third of them is at an angle to the lattice."""
    rng = np.random.default_rng(seed)
    plan = Plan(rng, float(rng.uniform(2.4, 3.0)))
    size = (_make_office if seed % 2 else _make_flat)(plan)
    plan.box("slab", (-0.4, -0.4, size[0] + 0.4, size[1] + 0.4), -0.2, 0.0)
    if rng.random() < 0.4:
        top = plan.height
        plan.box("ceiling", (-0.4, -0.4, size[0] + 0.4, size[1] + 0.4), top, top + 0.2)
    if rng.random() < 1 / 3:
        plan.turn = float(rng.uniform(0.1, 1.4))
    return plan


def make_flat(seed: int) -> Plan:
    """Make a flat with doorways of 0.7 to 1.4 m and openings of up to 2.4 m; half are turned.

    No floor is left round it, and chases are no deeper than a fifth of their room.
    """
    rng = np.random.default_rng(seed)
    plan = Plan(rng, float(rng.uniform(2.4, 3.0)), widths=(0.7, 1.4, 2.4))
    size = _make_flat(plan)
    plan.box("slab", (0.0, 0.0, *size), -0.2, 0.0)
    if seed % 2:
        plan.turn = float(rng.uniform(0.1, 1.4))
    return plan


def _make_office(plan: Plan) -> tuple[float, float]:
    """Rooms on both sides of a corridor, and a hall with pillars at its end."""
    rng = plan.rng
    thick = float(rng.uniform(0.08, 0.3))
    corridor, depth = float(rng.uniform(1.5, 3.0)), rng.uniform(3.0, 5.5, 2)
    length, hall = float(rng.uniform(9.0, 20.0)), float(rng.uniform(6.0, 11.0))
    y1 = float(depth[0]) + thick
    y2, top = y1 + corridor + thick, y1 + corridor + 2 * thick + float(depth[1])
    right = length + thick + hall
    half = thick / 2
    has_hall = bool(rng.random() < 0.8)
    mouth = rng.random() < 0.4  # the corridor opens into the hall as wide as it is

    def outside(start: tuple[float, float], end: tuple[float, float]) -> None:
        span = float(np.hypot(end[0] - start[0], end[1] - start[1]))
        holes = [plan.window(at, at + 2.5) for at in np.arange(1.0, span - 3.5, 4.0)]
        plan.wall(start, end, thick, holes)

    end = right if has_hall else length
    outside((-thick, -half), (end + thick, -half))
    outside((-thick, top + half), (end + thick, top + half))
    outside((-half, 0.0), (-half, top))
    outside((end + half, 0.0), (end + half, top))
    for low, high, wall_y in ((0.0, y1 - thick, y1 - half), (y2 + 0.0, top, y2 - half)):
        cuts = [0.0]
        while length - cuts[-1] > 5.6:
            most = min(5.0, length - cuts[-1] - thick - 2.4)
            cuts.append(cuts[-1] + float(rng.uniform(2.4, most)) + thick)
        cuts.append(length + thick)
        doors = []
        for number, (a, b) in enumerate(pairwise(cuts)):
            b -= thick
            rect = (a, low, b, high)
            doors.append(plan.door(a + 0.15, b - 0.15, widest=0.72 * (b - a)))
            if number + 2 < len(cuts):  # the partition to the next room
                holes = []
                if rng.random() < 0.3:
                    holes.append(plan.door(low + 0.3, high - 0.3, widest=0.65 * (high - low)))
                elif rng.random() < 0.4:
                    holes.append(plan.window(0.4, high - low - 0.4))
                if holes and holes[0].sill == 0.0:
                    holes = [
                        Opening(holes[0].at - low, holes[0].width, 0.0, holes[0].head),
                    ]
                plan.wall((b + half, low), (b + half, high), thick, holes)
            _fill_room(plan, rect)
        start = (-half, wall_y)
        shifted = [Opening(d.at + half, d.width, d.sill, d.head) for d in doors]
        plan.wall(start, (length, wall_y), thick, shifted)
    plan.rect_room((0.0, y1, length, y2 - thick))
    if has_hall:
        holes = []
        for low, high in ((0.0, y1 - thick), (y2, top)):
            if rng.random() < 0.4:
                holes.append(plan.door(low + 0.3, high - 0.3, widest=0.6 * (high - low)))
            elif rng.random() < 0.5:
                holes.append(plan.window(low + 0.3, high - 0.3))
        if mouth:
            holes.append(Opening((y1 + y2 - thick) / 2, corridor, 0.0, plan.height))
        else:
            holes.append(plan.door(y1 + 0.05, y2 - thick - 0.05, widest=0.7 * corridor))
        plan.wall((length + half, 0.0), (length + half, top), thick, holes)
        rect = (length + thick, 0.0, right, top)
        plan.rect_room(rect)
        for x in np.arange(rect[0] + rng.uniform(1.0, 3.5), right - 0.8, rng.uniform(2.4, 5.0)):
            for y in np.arange(rng.uniform(1.0, 3.5), top - 0.8, rng.uniform(2.4, 5.0)):
                plan.pier("pillar", (x - 0.2, y - 0.2, x + 0.2, y + 0.2))
    return end, top


def _fill_room(plan: Plan, rect: Rect) -> None:
    """Make a room of a rectangle: as it is, or with a chase that leaves a niche."""
    rng = plan.rng
    x0, y0, x1, y1 = rect
    if rng.random() < 0.25 and x1 - x0 > 2.8 and y1 - y0 > 2.8:
        wide, deep = float(rng.uniform(0.4, 0.9)), float(rng.uniform(0.4, 0.9))
        if plan.widths is not None:
            wide = min(wide, 0.2 * (x1 - x0))
        at = y0 + (y1 - y0) * 0.5
        chase = (x0, at - deep / 2, x0 + wide, at + deep / 2)
        if not plan.has_door_near(chase, 0.4):
            plan.pier("wall_chase", chase)
    plan.rect_room(rect)
    plan.furnish((x0 + 1.0, y0 + 0.8, x1, y1 - 0.8))


def _make_flat(plan: Plan) -> tuple[float, float]:
    """A rectangle divided again and again; some rooms are L-shaped or divided at an angle."""
    rng = plan.rng
    thick = float(rng.uniform(0.08, 0.3))
    half = thick / 2
    width, height = (float(v) for v in rng.uniform(8.0, 13.0, 2))
    for start, end in (
        ((-thick, -half), (width + thick, -half)),
        ((-thick, height + half), (width + thick, height + half)),
        ((-half, 0.0), (-half, height)),
        ((width + half, 0.0), (width + half, height)),
    ):
        span = float(np.hypot(end[0] - start[0], end[1] - start[1]))
        plan.wall(start, end, thick, [plan.window(a, a + 2.4) for a in np.arange(1, span - 3, 4)])
    _divide(plan, (0.0, 0.0, width, height), thick, 0)
    return width, height


def _divide(plan: Plan, rect: Rect, thick: float, depth: int) -> None:
    """Divide a rectangle across its longer side by a wall with a door; or make it a room."""
    rng = plan.rng
    x0, y0, x1, y1 = rect
    wide, tall = x1 - x0, y1 - y0
    if max(wide, tall) < 5.4 or (depth > 1 and rng.random() < 0.2):
        _make_flat_room(plan, rect, thick)
        return
    along_x = wide > tall
    low, high = (x0, x1) if along_x else (y0, y1)
    cut = float(rng.uniform(low + 2.4, high - 2.4 - thick))
    first = (x0, y0, cut, y1) if along_x else (x0, y0, x1, cut)
    second = (cut + thick, y0, x1, y1) if along_x else (x0, cut + thick, x1, y1)
    # the door keeps clear of walls that end at this one: those are made afterwards, in between
    span = (y0, y1) if along_x else (x0, x1)
    start = (cut + thick / 2, span[0]) if along_x else (span[0], cut + thick / 2)
    end = (cut + thick / 2, span[1]) if along_x else (span[1], cut + thick / 2)
    length = span[1] - span[0]
    at_start = bool(rng.random() < 0.5)
    near, far = (0.1, 2.2) if at_start else (length - 2.2, length - 0.1)
    holes = [plan.door(near, far, widest=1.65)]
    if rng.random() < 0.3:
        free = (2.6, length - 0.3) if at_start else (0.3, length - 2.6)
        if free[1] - free[0] > 0.8:
            holes.append(plan.window(*free))
    plan.wall(start, end, thick, holes)
    _divide(plan, first, thick, depth + 1)
    _divide(plan, second, thick, depth + 1)


def _make_flat_room(plan: Plan, rect: Rect, thick: float) -> None:
    """Make a room of a rectangle; a large one may have a closet in a corner, or a slanting wall."""
    rng = plan.rng
    x0, y0, x1, y1 = rect
    wide, tall = x1 - x0, y1 - y0
    kind = rng.random()
    if kind < 0.5 and min(wide, tall) > 3.8:
        a, b = (float(v) for v in rng.uniform(1.4, 1.9, 2))
        left = bool(rng.random() < 0.5)
        inner = (x0, y0, x0 + a, y0 + b) if left else (x1 - a, y0, x1, y0 + b)
        if not plan.has_door_near(inner, thick + 0.3):
            _add_closet(plan, rect, inner, thick, left)
            return
    if kind >= 0.75 and wide > 4.6:
        bottom, top = (float(v) for v in rng.uniform(x0 + 2.1, x1 - 2.1, 2))
        ends = [(bottom, y0, bottom, y0), (top, y1, top, y1)]
        if not any(plan.has_door_near(end, thick + 0.4) for end in ends):
            length = float(np.hypot(top - bottom, tall))
            hole = plan.door(0.6, length - 0.6, widest=1.5)
            plan.wall((bottom, y0), (top, y1), thick, [hole])
            shift = thick / 2 * length / tall
            plan.room((x0, y0), (bottom - shift, y0), (top - shift, y1), (x0, y1))
            plan.room((bottom + shift, y0), (x1, y0), (x1, y1), (top + shift, y1))
            return
    _fill_room(plan, rect)


def _add_closet(plan: Plan, rect: Rect, inner: Rect, thick: float, left: bool) -> None:
    """Make a closet in a lower corner of a room, which becomes L-shaped."""
    x0, y0, x1, y1 = rect
    a0, _, a1, b = inner
    a, half = a1 - a0, thick / 2
    start, end = (a0, a1 + thick) if left else (a0 - thick, a1)
    shift = 0.0 if left else thick
    door = plan.door(shift + 0.1, shift + a - 0.1, widest=0.72 * a)
    plan.wall((start, b + half), (end, b + half), thick, [door])
    side = a1 + half if left else a0 - half
    plan.wall((side, y0), (side, b), thick)
    plan.rect_room(inner)
    if left:
        corners = [(end, y0), (x1, y0), (x1, y1), (x0, y1), (x0, b + thick), (end, b + thick)]
    else:
        corners = [(x0, y0), (start, y0), (start, b + thick), (x1, b + thick), (x1, y1), (x0, y1)]
    plan.room(*corners)
