"""Makes a large house for measuring: rooms of 5 × 5 m, doors between neighbours, furniture.

python scripts/make_house.py 100 -o house-100.xml
python scripts/make_house.py 100 --doors -o house-100-doors.xml
python scripts/make_house.py 100 --triangles 4000 -o house-100-round.xml
"""

from __future__ import annotations

import argparse
import math
import random
from functools import partial
from pathlib import Path

ROOM = 5.0  # edge of a room [m], between the middles of its walls
WALL = 0.12  # thickness [m]
HEIGHT = 2.5  # [m]
DOOR = 0.9  # width of a doorway [m]
LEAF = (0.84, 0.04, 2.1)  # width, thickness and height of the door in it [m]
AISLE = 0.35  # half the width of the way from a doorway to the room's middle [m]
PIECES = 30  # of furniture in a room
MESHES = 12  # assets that pieces of furniture share
KINDS = ("box", "cylinder", "sphere", "capsule", "mesh")
MESH_RADIUS = 0.45  # [m]
RADII = {  # of the circle round a piece, from, to [m]
    "box": (0.35, 0.8),
    "cylinder": (0.25, 0.6),
    "sphere": (0.2, 0.5),
    "capsule": (0.4, 0.8),
}

Point = tuple[float, float]


def make_house(rooms: int, seed: int = 0, *, with_doors: bool = False, triangles: int = 0) -> str:
    """Write a house of furnished rooms in a square as MJCF.

    The house lies in the plane's first quadrant, from the origin on. All neighbours are joined
    by a doorway, and from each doorway a clear way leads to the middle of the room.

    Args:
        rooms: how many, a square number >= 1.
        seed: of the furniture and of the doorways' places; the same bytes for the same seed.
        with_doors: hang a hinged door into each doorway, closed.
        triangles: of each mesh's hull, an even number >= 4: the meshes are round; 0 for meshes of
            a few corners.

    Returns:
        The document.

    Raises:
        ValueError: `rooms` is no square number, or `triangles` odd or too small.
    """
    side = math.isqrt(max(rooms, 0))
    if rooms < 1 or side * side != rooms:
        raise ValueError(f"expected a square number of rooms >= 1, got {rooms}")
    if triangles and (triangles < 4 or triangles % 2):
        raise ValueError(f"expected an even number of triangles >= 4, got {triangles}")
    rng = random.Random(seed)
    make = partial(_round_mesh, triangles=triangles) if triangles else _mesh
    assets = [make(f"mesh_{i}", rng) for i in range(MESHES)]
    edge = side * ROOM
    middle = (edge / 2, edge / 2, -0.1)
    geoms = [_geom("ground", "plane", (0, 0, -0.25), size=(0, 0, 1))]
    geoms.append(_geom("floor", "box", middle, size=(edge / 2, edge / 2, 0.1)))
    doors: dict[tuple[int, int], list[Point]] = {
        (i, j): [] for i in range(side) for j in range(side)
    }
    for i in range(side + 1):
        for j in range(side):
            geoms += _wall(f"wall_x_{i}_{j}", True, i, j, side, doors, rng)
            geoms += _wall(f"wall_y_{i}_{j}", False, i, j, side, doors, rng)
    bodies: list[str] = []
    for (i, j), gaps in doors.items():
        center = ((i + 0.5) * ROOM, (j + 0.5) * ROOM)
        circles: list[tuple[Point, float]] = []
        for k in range(PIECES):
            kind = KINDS[k % len(KINDS)]
            circles.append(_place(kind, center, gaps, circles, rng))
            geoms.append(_piece(f"piece_{i}_{j}_{kind}_{k}", kind, *circles[-1], rng))
        if with_doors:
            bodies += _doors(i, j, gaps)
    lines = [f'<mujoco model="house-{rooms}">', "  <asset>", *assets, "  </asset>"]
    lines += ["  <worldbody>", *geoms, *bodies, "  </worldbody>", "</mujoco>"]
    return "\n".join(lines) + "\n"


def _wall(
    name: str,
    across_x: bool,
    i: int,
    j: int,
    side: int,
    doors: dict[tuple[int, int], list[Point]],
    rng: random.Random,
) -> list[str]:
    """Build wall `i` of `side` + 1 across an axis, along the `j`-th room; note its doorway."""
    edge = side * ROOM
    at = min(max(i * ROOM, WALL / 2), edge - WALL / 2)  # outer walls end where the floor ends
    start, end = j * ROOM, (j + 1) * ROOM
    pieces = [(start, end)]
    if 0 < i < side:
        door = round(start + rng.uniform(1.2, ROOM - 1.2), 3)
        pieces = [(start, door - DOOR / 2), (door + DOOR / 2, end)]
        for room in (i - 1, i):
            cell = (room, j) if across_x else (j, room)
            doors[cell].append((at, door) if across_x else (door, at))
    geoms = []
    for k, (a, b) in enumerate(pieces):
        pos = (at, (a + b) / 2, HEIGHT / 2) if across_x else ((a + b) / 2, at, HEIGHT / 2)
        size = (WALL / 2, (b - a) / 2) if across_x else ((b - a) / 2, WALL / 2)
        geoms.append(_geom(f"{name}_{k}", "box", pos, size=(*size, HEIGHT / 2)))
    return geoms


def _doors(i: int, j: int, gaps: list[Point]) -> list[str]:
    """Hang the doors to the next room of each axis, a joint each, hinge at the gap's low end."""
    width, thickness, height = LEAF
    bodies = []
    for x, y in gaps:
        across_x, across_y = x == (i + 1) * ROOM, y == (j + 1) * ROOM
        if not across_x and not across_y:
            continue  # the room on the other side has it
        name = f"door_{'x' if across_x else 'y'}_{i}_{j}"
        hinge = (x, y - width / 2, 0) if across_x else (x - width / 2, y, 0)
        middle, size = (width / 2, 0, height / 2), (width / 2, thickness / 2, height / 2)
        yaw = 90 if across_x else 0
        bodies += [
            f'    <body name="{name}" pos="{_text(hinge)}" euler="0 0 {yaw}">',
            f'      <joint name="{name}" axis="0 0 1" range="0 90" limited="true"/>',
            _geom(f"{name}_leaf", "box", middle, size=size),
            "    </body>",
        ]
    return bodies


def _piece(name: str, kind: str, spot: Point, r: float, rng: random.Random) -> str:
    """Write a piece of furniture that stands on the floor within a circle of radius `r`."""
    yaw, height = rng.uniform(0, 360), rng.uniform(0.3, 2.0)
    if kind == "box":
        turn = math.radians(rng.uniform(20, 70))
        size = (r * math.cos(turn), r * math.sin(turn), height / 2)
        return _geom(name, kind, (*spot, height / 2), size=size, euler=(0, 0, yaw))
    if kind == "cylinder":
        return _geom(name, kind, (*spot, height / 2), size=(r, height / 2))
    if kind == "sphere":
        return _geom(name, kind, (*spot, r), size=(r,))
    if kind == "capsule":  # lying
        thick = r * rng.uniform(0.3, 0.5)
        return _geom(name, kind, (*spot, thick), size=(thick, r - thick), euler=(90, yaw, 0))
    return _geom(name, kind, (*spot, 0), mesh=f"mesh_{rng.randrange(MESHES)}", euler=(0, 0, yaw))


def _place(
    kind: str,
    center: Point,
    gaps: list[Point],
    circles: list[tuple[Point, float]],
    rng: random.Random,
) -> tuple[Point, float]:
    """Find a circle for a piece, off the ways from the doorways, not deep in another's circle.

    After many attempts in vain, it may lie anywhere off the ways.
    """
    attempts = 0
    while True:
        r = MESH_RADIUS if kind == "mesh" else rng.uniform(*RADII[kind])
        reach = (ROOM - WALL) / 2 - r
        spot = (center[0] + rng.uniform(-reach, reach), center[1] + rng.uniform(-reach, reach))
        clear = all(_distance(spot, gap, center) > AISLE + r for gap in gaps)
        apart = all(math.dist(spot, other) > 0.6 * (r + r2) for other, r2 in circles)
        if clear and (apart or attempts > 200):
            return spot, r
        attempts += 1


def _mesh(name: str, rng: random.Random) -> str:
    """A convex mesh asset of about 0.7 m, its lowest points on the floor."""
    vertices = []
    for level in (0.0, 0.35, 0.8):
        r, sides = rng.uniform(0.6, 1.0) * MESH_RADIUS, rng.randint(4, 7)
        for i in range(sides):
            angle = 2 * math.pi * (i + rng.uniform(0, 0.5)) / sides
            vertices += [r * math.cos(angle), r * math.sin(angle), level]
    return f'    <mesh name="{name}" vertex="{_text(vertices)}"/>'


def _round_mesh(name: str, rng: random.Random, triangles: int) -> str:
    """A convex mesh asset of the size of `_mesh`'s: an ellipsoid, its lowest point on the floor.

    Its hull has so many triangles, as that of n corners, no four in a plane, has 2 n - 4.
    """
    x, y, z = (rng.uniform(0.7, 1.0) * size for size in (MESH_RADIUS, MESH_RADIUS, 0.4))
    count, golden = triangles // 2 + 2, math.pi * (3 - math.sqrt(5))
    vertices = []
    for i in range(count):  # a spiral of even steps (Fibonacci's lattice)
        up = 1 - (2 * i + 1) / count
        out, angle = math.sqrt(1 - up * up), golden * i
        vertices += [x * out * math.cos(angle), y * out * math.sin(angle), z * (1 + up)]
    text = " ".join(f"{value:.6f}" for value in vertices)
    return f'    <mesh name="{name}" vertex="{text}"/>'


def _distance(point: Point, a: Point, b: Point) -> float:
    """Distance of a point from the segment between two others [m]."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    t = ((point[0] - a[0]) * dx + (point[1] - a[1]) * dy) / (dx * dx + dy * dy)
    t = min(max(t, 0.0), 1.0)
    return math.dist(point, (a[0] + t * dx, a[1] + t * dy))


def _geom(
    name: str, kind: str, pos: tuple[float, ...], **attributes: tuple[float, ...] | str
) -> str:
    texts = {k: v if isinstance(v, str) else _text(v) for k, v in attributes.items()}
    rest = "".join(f' {key}="{value}"' for key, value in texts.items())
    return f'    <geom name="{name}" type="{kind}" pos="{_text(pos)}"{rest}/>'


def _text(values: tuple[float, ...] | list[float]) -> str:
    return " ".join(f"{value:.4f}" for value in values)


def main() -> None:
    parser = argparse.ArgumentParser(description="Make a large furnished house as MJCF.")
    parser.add_argument("rooms", type=int, help="how many, a square number")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--doors", action="store_true", help="hang a door into each doorway")
    parser.add_argument("--triangles", type=int, default=0, help="of each mesh; default: a few")
    parser.add_argument("-o", "--output", type=Path, help="default: house-ROOMS.xml")
    arguments = parser.parse_args()
    try:
        document = make_house(
            arguments.rooms,
            arguments.seed,
            with_doors=arguments.doors,
            triangles=arguments.triangles,
        )
    except ValueError as error:
        parser.error(str(error))
    output = arguments.output or Path(f"house-{arguments.rooms}.xml")
    output.write_text(document, encoding="utf-8", newline="\n")
    print(f"{output}  {len(document):,} bytes")


if __name__ == "__main__":
    main()
