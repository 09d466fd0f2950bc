"""Buildings of other kinds than houses, and how any of them lies in the world.

Each maker draws its measures from a generator of random numbers, and says what a person would:
how many storeys there are, what is floor, and between which places one can walk.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from random import Random

from buildings.make import make_building, round_off
from buildings.parts import Building, Opening, Patch, Placing, Rect, Stairway, frame, shifted
from buildings.stairs import make_stairs, place_stairs

DOOR, HEAD = 1.0, 2.1  # width and height of a door [m]
WALL, SLAB = 0.2, 0.2  # thickness [m]
POSES = ("plain", "round", "turned", "tilted", "far")


def make_any(seed: int, **wanted: str) -> Building:
    """A building of any kind, in any pose; both can be given, and the features of a house."""
    rng = Random(seed)
    kind, pose = rng.choice([*KINDS, *["house"] * len(KINDS)]), rng.choice(POSES)
    kind, pose = wanted.pop("kind", kind), wanted.pop("pose", pose)
    if kind == "house":
        made = make_building(seed, **wanted)
    else:
        made = KINDS[kind](rng)
        made.placing = Placing(rng.random() < 0.5, rng.randrange(4), rng.random(), rng.random())
    if pose == "round":
        round_off(made)
    elif pose == "turned":
        made.placing = made.placing._replace(turn=17.0)
    elif pose == "tilted":
        made.placing = made.placing._replace(tilt=1.0, turn=rng.choice([0.0, 17.0]))
    elif pose == "far":
        made.placing = made.placing._replace(x=1e4 + rng.random(), y=-1e4)
    made.features |= {"kind": kind, "pose": pose}
    return made


def _shell(made: Building, rect: Rect, z: float, top: float, *doors: list[Opening]) -> None:
    """Walls along the inside of a rectangle: at low y, high x, high y and low x."""
    for number, wall in enumerate(frame(rect, WALL)):
        made.wall(wall, z, top, doors[number] if number < len(doors) else [])


def _inner(rect: Rect) -> Rect:
    return rect[0] + WALL, rect[1] + WALL, rect[2] - WALL, rect[3] - WALL


def _floor(made: Building, place: str, rect: Rect, z: float, *holes: Rect) -> None:
    made.floors.append(Patch(place, rect, z, holes))


def split_level(rng: Random) -> Building:
    """Two halves, half a storey apart, with short flights between them."""
    made, number, rise = Building(), rng.randint(2, 3), rng.uniform(2.8, 3.2)
    half, depth, made.levels = rise / 2, rng.uniform(5, 7), number
    treads = math.ceil(half / 0.19) - 1
    left, right = rng.uniform(4.5, 6), rng.uniform(4.5, 6)
    width, tread = 1.1, 0.28
    for k in range(number):
        for name, x0, x1, z in (
            ("left", 0.0, left, k * rise),
            ("right", left, left + right, k * rise + half),
        ):
            rect = (x0, 0.0, x1, depth)
            made.slab(rect, z, SLAB)
            _, east, north, west = frame(rect, WALL)
            made.wall((x0, 0.0, x1, WALL), z, z + rise - SLAB)
            made.wall(north, z, z + rise - SLAB)
            made.wall(west if name == "left" else east, z, z + rise - SLAB)
            # where it leans, one half's edge lies over the other half
            x0, x1 = (x0 + WALL, x1 - 0.1) if name == "left" else (x0 + 0.1, x1 - WALL)
            _floor(made, f"{name} {k}", (x0, WALL, x1, depth - WALL), z)
            made.maybe.append(Patch("", rect, z))
        # up from the left half to the right one, and on from the right half to the left one
        flights = []
        for y, sign, z, top in ((WALL, -1, k * rise, half), (depth - WALL - width, 1, half, half)):
            z = z if sign < 0 else k * rise + half
            if sign > 0 and k == number - 1:
                continue
            for i in range(treads):
                # the highest tread is at the edge of the other half
                near, far = (treads - 1 - i) * tread, (treads - i) * tread
                x = sorted((left + sign * near, left + sign * far))
                height = z + (i + 1) * top / (treads + 1)
                made.add((x[0], y, x[1], y + width), max(z, height - 0.2), height)
            x = sorted((left, left + sign * treads * tread))
            flights.append((x[0], y, x[1], y + width))
            made.stairs.append(Stairway(flights[-1], z, z + top))
        # under a flight there is room for the agent's height, but no storey for two floors
        for half_number, flight in enumerate(flights):
            at = len(made.floors) - 2 + half_number
            made.floors[at] = made.floors[at]._replace(holes=(flight,))
        made.joined.append((f"left {k}", f"right {k}"))
        made.joined += [(f"right {k}", f"left {k + 1}")] if k < number - 1 else []
        if rng.random() < 0.5:  # a railing, or none, along the edge of the right half
            rail = (left, WALL + width, left + 0.05, depth - WALL - width - 0.1)
            made.add(rail, k * rise + half, k * rise + half + 1.0)
    made.slab((0.0, 0.0, left, depth), number * rise, SLAB)
    made.slab((left, 0.0, left + right, depth), number * rise + half, SLAB)
    return made


def garage(rng: Random) -> Building:
    """Decks of a parking garage, joined by a ramp that winds around a core, one turn a deck."""
    made, number, rise = Building(), rng.randint(2, 4), rng.uniform(2.6, 3.0)
    length, depth, made.levels = rng.uniform(12, 20), rng.uniform(13, 16), number
    inner, outer, gap = rng.uniform(2.4, 3.0), rng.uniform(5.5, 6.0), rng.uniform(0.15, 0.3)
    x, y, pieces = length + outer + 0.2, depth / 2, 24
    ring = (length, y - outer, x + outer, y + outer)
    columns = [
        (a, b, a + 0.4, b + 0.4) for a in (length / 3, length / 1.5) for b in (3.0, depth - 3)
    ]

    def corners(angle: float, z: float) -> list[tuple[float, float, float]]:
        at = [(x + r * math.cos(angle), y + r * math.sin(angle)) for r in (inner, outer)]
        return [(a, b, c) for a, b in at for c in (z - SLAB, z)]

    for k in range(number):
        z, rect = k * rise, (0.0, 0.0, length, depth)
        made.slab(rect, z, SLAB)
        south, east, north, west = frame(rect, 0.15)
        for side in (south, north, west):
            made.add(side, z, z + 1.0)
        for half in ((east[0], 0.15, east[2], y - 3.0), (east[0], y + 3.0, east[2], depth - 0.15)):
            made.add(half, z, z + 1.0)
        for column in columns if k < number - 1 else ():
            made.add(column, z, z + rise - SLAB)
        _floor(made, f"deck {k}", (0.15, 0.15, length - 0.15, depth - 0.15), z)
        made.maybe.append(Patch("", rect, z))
        edge = [(length, b, c) for b in (y - 2.5, y + 2.5) for c in (z - SLAB, z)]
        begin, end = math.pi + gap, 3 * math.pi - gap
        made.prisms.append([*corners(begin, z), *corners(math.pi - gap, z), *edge])
        if k < number - 1:
            made.joined.append((f"deck {k}", f"deck {k + 1}"))
            angles = [begin + (end - begin) * j / pieces for j in range(pieces + 1)]
            heights = [z + rise * j / pieces for j in range(pieces + 1)]
            for j in range(pieces):
                low, high = corners(angles[j], heights[j]), corners(angles[j + 1], heights[j + 1])
                made.prisms.append([*low, *high])
    made.stairs.append(Stairway(ring, 0.0, (number - 1) * rise))
    return made


def attic(rng: Random) -> Building:
    """A storey, and stairs to what a gable leaves to stand in above it."""
    made, rise = Building(levels=2), rng.uniform(2.7, 3.1)
    stairs = make_stairs("straight", rise, SLAB, 0.05, rng)
    length, depth = stairs.size[0] + 2.8 + rng.uniform(0, 2), rng.uniform(6.5, 9)
    rect, knee, ridge = (0.0, 0.0, length, depth), rng.uniform(0.2, 0.9), rng.uniform(2.6, 3.2)
    x, y = WALL + 1.2, depth / 2 - stairs.size[1] / 2
    hole = shifted(stairs.openings[0], x, y)
    made.slab(rect, 0.0, SLAB)
    _shell(made, rect, 0.0, rise - SLAB)
    made.slab(rect, rise, SLAB, [hole])
    place_stairs(made, stairs, x, y, 0.0, 0.2)
    south, east, north, west = frame(rect, WALL)
    middle = depth / 2
    for side in (south, north):
        made.add(side, rise, rise + knee)
    for side in (east, west):
        ends = [(side[0], side[2])[n] for n in range(2)]
        foot = [(a, b, c) for a in ends for b in (0.0, depth) for c in (rise, rise + knee)]
        made.prisms.append([*foot, *((a, middle, rise + ridge) for a in ends)])
    for b in (0.0, depth):
        line = [(b, rise + knee), (middle, rise + ridge)]
        made.prisms.append(
            [(a, v, c + t) for a in (0.0, length) for v, c in line for t in (0.0, 0.15)]
        )
    _floor(made, "storey", _inner(rect), 0.0)
    # where a person can stand upright; the agent can a little further out
    free = (1.4 - knee) / (ridge - knee) * middle
    free = max(free, WALL) + 0.1
    strip = (WALL + 0.15, free, length - WALL - 0.15, depth - free)
    _floor(made, "attic", strip, rise, hole)
    made.maybe += [Patch("", rect, rise, (hole,)), Patch("", rect, 0.0)]
    made.joined.append(("storey", "attic"))
    return made


def courtyard(rng: Random) -> Building:
    """Four wings of one or two storeys round a yard that lies open to the sky."""
    made, number, rise = Building(), rng.randint(1, 2), rng.uniform(2.7, 3.1)
    made.levels = number
    stairs = make_stairs("straight", rise, SLAB, 0.05, rng)
    wing = rng.uniform(2.8, 3.6)
    length, depth = stairs.size[0] + 2 * wing + 2.4, 2 * wing + rng.uniform(3, 7)
    rect, yard = (0.0, 0.0, length, depth), (wing, wing, length - wing, depth - wing)
    around = (yard[0] - WALL, yard[1] - WALL, yard[2] + WALL, yard[3] + WALL)
    x, y = wing + 1.2, WALL
    hole = shifted(stairs.openings[0], x, y)
    made.slab(rect, 0.0, SLAB)
    for k in range(number):
        z, holes = k * rise, (hole,) if k else ()
        if k:
            made.slab(rect, z, SLAB, [yard, hole])
        _shell(made, rect, z, z + rise - SLAB)
        door = Opening(yard[0] + 0.3, yard[0] + 0.3 + DOOR, z + HEAD)
        _shell(made, around, z, z + rise - SLAB, [door] if k == 0 else [])
        _floor(made, f"wings {k}", _inner(rect), z, around, *holes)
        made.maybe.append(Patch("", rect, z, holes))
    made.slab(rect, number * rise, SLAB, [yard])
    _floor(made, "yard", yard, 0.0)
    made.joined.append(("wings 0", "yard"))
    if number > 1:
        place_stairs(made, stairs, x, y, 0.0, 0.2)
        made.joined.append(("wings 0", "wings 1"))
    return made


def bridge(rng: Random) -> Building:
    """Two houses of two or three storeys with a bridge from one to the other; one has stairs."""
    made, number, rise = Building(), rng.randint(2, 3), rng.uniform(2.7, 3.1)
    made.levels = number
    stairs = make_stairs("half_landing", rise, SLAB, 0.05, rng)
    length, depth = stairs.size[0] + 2.8, stairs.size[1] + 3.2
    gap, width, at = rng.uniform(3, 6), rng.uniform(1.4, 2.0), rng.randint(1, number - 1)
    one: Rect = (0.0, 0.0, length, depth)
    two: Rect = (length + gap, 0.0, 2 * length + gap, depth)
    across = (length, depth - 0.4 - width, length + gap, depth - 0.4)
    x, y = 1.4, WALL
    land = (-2.0, -2.0, 2 * length + gap + 2.0, depth + 2.0)
    made.slab(land, 0.0, SLAB)
    _floor(made, "outdoors", land, 0.0, one, two)
    for name, rect in (("one", one), ("two", two)):
        storeys = number if name == "one" else at + 1
        for k in range(storeys):
            z, holes = k * rise, list[Rect]()
            if k and name == "one":
                holes = [shifted(hole, x, y) for hole in stairs.openings]
            if k:
                made.slab(rect, z, SLAB, holes)
            east = [Opening(across[1] + 0.2, across[3] - 0.2, z + HEAD)] if k == at else []
            south = [Opening(rect[2] - 1.4, rect[2] - 0.4, HEAD)] if k == 0 else []
            sides = [south, east] if name == "one" else [south, [], [], east]
            _shell(made, rect, z, z + rise - SLAB, *sides)
            _floor(made, f"{name} {k}", _inner(rect), z, *holes)
            made.maybe.append(Patch("", rect, z, tuple(holes)))
            if name == "one" and k < number - 1:
                place_stairs(made, stairs, x, y, z, 0.2)
                made.joined.append((f"one {k}", f"one {k + 1}"))
        made.slab(rect, storeys * rise, SLAB)
        made.joined.append(("outdoors", f"{name} 0"))
    made.slab(across, at * rise, SLAB)
    for side in frame(across, 0.05)[::2]:
        made.add(side, at * rise, at * rise + 1.0)
    _floor(made, "bridge", across, at * rise)
    made.joined += [(f"one {at}", "bridge"), ("bridge", f"two {at}")]
    return made


def stadium(rng: Random) -> Building:
    """Tiers to sit on, twice as high as a step, with an aisle of steps, beside a field."""
    made, number = Building(), rng.randint(4, 9)
    length, tread, rise = rng.uniform(7, 14), rng.uniform(0.8, 1.0), rng.uniform(0.36, 0.44)
    x = rng.choice([0.0, rng.uniform(1, length - 2.5)])
    end = 6.0 + number * tread
    made.slab((0.0, 0.0, length, end), 0.0, SLAB)
    _floor(made, "field", (0.0, 0.0, length, 6.0 - tread / 2), 0.0)
    made.maybe.append(Patch("", (0.0, 0.0, length, 6.0), 0.0))
    for k in range(number):
        y = 6.0 + k * tread
        top = (k + 1) * rise
        made.add((0.0, y, length, y + tread), 0.0, top)
        step = (x, y - tread / 2, x + 1.2, y)
        made.add(step, k * rise, top - rise / 2)
        made.floors.append(Patch(f"tier {k}", (0.0, y, length, y + tread), top))
        made.stairs.append(Stairway(step, k * rise, top))
        made.joined.append((f"tier {k - 1}" if k else "field", f"tier {k}"))
    return made


def sunken(rng: Random) -> Building:
    """Rooms in a row whose floors differ: by one step, or by some with steps at the doors."""
    made, x, z, before = Building(), 0.0, 0.0, 0.0
    depth, number, top = rng.uniform(4, 6), rng.randint(3, 4), 3.4
    for k in range(number):
        width = rng.uniform(3.5, 5)
        z = before + rng.choice([-0.6, -0.4, -0.15, 0.15, 0.4, 0.6]) if k else 0.0
        made.slab((x, 0.0, x + width, depth), z, 2.0 + z)
        room = (x + WALL, WALL, x + width, depth - WALL)
        _floor(made, f"room {k}", room, z)
        made.maybe.append(Patch("", (x, 0.0, x + width, depth), z))
        for side in (frame((x, 0.0, x + width, depth), WALL)[n] for n in (0, 2)):
            made.wall((x, side[1], x + width, side[3]), z, top)
        y = rng.uniform(0.5, depth - 2.0)
        door = [Opening(y, y + 1.2, max(z, before) + HEAD)] if k else []
        made.wall((x, WALL, x + WALL, depth - WALL), min(z, before), top, door)
        if k:
            made.add((x, y, x + WALL, y + 1.2), min(z, before), max(z, before))
            steps = round(abs(z - before) / 0.2) - 1
            for i in range(max(steps, 0)):
                # in the lower of the two rooms
                low, far = min(z, before), 0.35 * (i + 1)
                end = x + WALL + far if z < before else x - far
                begin = x + WALL if z < before else x
                rect = (min(begin, end), y, max(begin, end), y + 1.2)
                made.add(rect, low, low + (steps - i) * abs(z - before) / (steps + 1))
            around = (x - 1.5, y, x + WALL + 1.5, y + 1.2)
            made.stairs.append(Stairway(around, min(z, before), max(z, before)))
            made.joined.append((f"room {k - 1}", f"room {k}"))
        before, x = z, x + width
    made.wall((x, 0.0, x + WALL, depth), -2.0, top)
    made.slab((0.0, 0.0, x + WALL, depth), top + SLAB, SLAB)
    return made


KINDS: dict[str, Callable[[Random], Building]] = {
    "split_level": split_level,
    "garage": garage,
    "attic": attic,
    "courtyard": courtyard,
    "bridge": bridge,
    "stadium": stadium,
    "sunken": sunken,
}
