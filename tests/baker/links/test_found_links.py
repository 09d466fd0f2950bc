"""Drops, jumps, ladders and lifts are found where they are, and nowhere else."""

from __future__ import annotations

import math
from itertools import product

import mujoco
import numpy as np
import pytest

import navbake
from box_worlds import body, box, world
from navbake.errors import BakeWarning

pytestmark = pytest.mark.filterwarnings("ignore::navbake.BakeWarning")
AGENT = {"height": 1.5, "radius": 0.05, "traversable_floor_height": 0.25}
YARD = box("yard", 0.02, 0.02, -0.2, 5.98, 3.98, 0)
DOCK = box("dock", 0.02, 0.02, 0, 2.47, 3.98, 0.8)
DROP = {"auto": "drop", "height": 1.0, "gap": 0.4}


def bake(content, *links, agent=None, **settings):
    model = mujoco.MjModel.from_xml_string(world(content))
    more = {"agent": {**AGENT, **(agent or {})}, "floors": {"tops": True}, **settings}
    return navbake.bake(model, links=list(links), **more)


def fences(y0, y1):
    """Fences beside the dock that are lower than it, with no room to stand between."""
    return "".join(box("", x, y0, 0, x + 0.02, y1, 0.6) for x in np.arange(2.57, 3.2, 0.1))


def all_free(grid, link):
    """Whether an agent can stand at all stops."""
    return all(grid.levels[stop.level].free.flat[stop.cell] for stop in link.stops)


def test_a_dock_is_one_drop_as_wide_as_its_edge():
    grid = bake(YARD + DOCK, DROP)
    (link,) = grid.links
    assert (link.name, link.kind, link.one_way, link.auto) == ("drop 1", "drop", True, True)
    (x, y, z), (to_x, to_y, to_z) = (stop.position for stop in link.stops)
    assert z == pytest.approx(0.8) and to_z == 0.0 and y == to_y == pytest.approx(2.0, abs=0.06)
    assert 1.9 < x < 2.47 < to_x < 3.1
    assert all_free(grid.inflate(0.45), link)
    assert link.width == pytest.approx(3.96, abs=0.11)


@pytest.mark.parametrize(
    ("content", "found"),
    [
        ("", 1),
        (box("railing", 2.41, 0.02, 0.8, 2.45, 3.98, 1.7), 0),
        (box("beam", 2.32, 0.02, 1.9, 2.72, 3.98, 2.1), 0),  # headroom over the edge
        (box("beam", 2.32, 0.02, 2.4, 2.72, 3.98, 2.6), 1),
        (fences(0.02, 3.98), 0),  # on the landing
        (box("shelf", 2.51, 0.02, 0.9, 2.92, 3.98, 0.94), 1),  # below a step over the dock
        (box("shelf", 2.51, 0.02, 1.1, 2.92, 3.98, 1.14), 0),
        (fences(1.63, 2.37), 2),  # two stretches of edge
    ],
)
def test_a_drop_needs_headroom_and_a_free_landing(content, found):
    grid = bake(YARD + DOCK + content, DROP)
    assert len(grid.links) == found


def test_a_drop_is_neither_higher_nor_farther_than_its_rule():
    assert bake(YARD + DOCK, {**DROP, "height": 0.79}).links == ()
    wide = {"radius": 0.25}
    assert bake(YARD + DOCK, {**DROP, "gap": 0.1}, agent=wide).links == ()
    (link,) = bake(YARD + DOCK, DROP, agent=wide).links
    assert link.stops[1].position[0] > 2.47 + 0.25


def test_a_gap_is_jumped_both_ways():
    far = box("far", 2.88, 0.02, 0, 5.98, 3.98, 0.9)
    (link,) = bake(YARD + DOCK + far, {"auto": "jump", "gap": 0.5}).links
    assert not link.one_way and link.kind == "jump"
    assert [round(stop.position[2], 3) for stop in link.stops] == [0.8, 0.9]
    assert bake(YARD + DOCK + far, {"auto": "jump", "gap": 0.3}).links == ()
    assert bake(YARD + DOCK + far, {"auto": "jump", "gap": 0.5, "height": 0.05}).links == ()


def test_a_fence_in_the_gap_stops_the_jump():
    far = box("far", 2.88, 0.02, 0, 5.98, 3.98, 0.9) + box("net", 2.66, 0.02, 0, 2.69, 3.98, 2)
    assert bake(YARD + DOCK + far, {"auto": "jump", "gap": 0.5}).links == ()


# --- an oracle: boxes against boxes, cell by cell -------------------------------------------------


def plain_drops(grid, boxes, height, gap):
    """Number and widths of the stretches of edges with drops, in plain loops.

    The footprint of an agent of 0.05 m is its cell's square; boxes meet it or don't.
    """
    level, (size, step, tall) = grid.levels[0], (0.1, 0.25, 1.5)
    rows, cols = level.shape
    floor, free = level.floor, level.free

    def is_clear(row, col, low, high):
        x, y = level.lattice.positions(row, col)
        half = size / 2 - 1e-6
        return not any(
            x0 < x + half and x1 > x - half and y0 < y + half and y1 > y - half
            and z0 < high - 1e-6 and z1 > low + 1e-6
            for x0, y0, z0, x1, y1, z1 in boxes
        )  # fmt: skip

    found = {}
    ways = ((0, 1), (1, 0), (0, -1), (-1, 0))
    for (row, col), (way, (down, right)) in product(np.argwhere(free).tolist(), enumerate(ways)):
        z = floor[row, col]
        for n in range(round(gap / size) + 1):
            r, c = row + (n + 1) * down, col + (n + 1) * right
            if not (0 <= r < rows and 0 <= c < cols) or abs(floor[r, c] - z) <= step + 1e-6:
                break
            lower = z - floor[r, c]
            if step < lower <= height + 1e-6 and free[r, c]:
                between = [(row + k * down, col + k * right) for k in range(1, n + 1)]
                clear = all(is_clear(*at, z + step, z + tall) for at in between)
                clear &= is_clear(r, c, floor[r, c] + step, z + tall)
                if clear:
                    found[way, row, col] = floor[r, c]
                break
    widths = []
    while found:  # side by side, without a step
        start = next(iter(found))
        part, left = [start], {start: found.pop(start)}
        for way, row, col in part:
            for i, j in product((-1, 0, 1), repeat=2):
                beside = way, row + i, col + j
                if beside not in found:
                    continue
                rise = abs(floor[row, col] - floor[row + i, col + j])
                if max(rise, abs(left[way, row, col] - found[beside])) <= step + 1e-6:
                    left[beside] = found.pop(beside)
                    part.append(beside)
        at = np.array([place[1:] for place in part])
        widths.append(round(math.hypot(*np.ptp(at, axis=0)) * size + size, 6))
    return sorted(widths)


@pytest.mark.parametrize("seed", range(6))
def test_drops_are_those_of_plain_loops(seed):
    rng = np.random.default_rng(seed)
    boxes = [(0.02, 0.02, -0.2, 5.98, 4.98, 0.0)]
    for _ in range(6):
        low = rng.uniform([0, 0], [4, 3]).round(1) + 0.02
        high = low + rng.uniform(0.8, 2.5, 2).round(1)
        boxes.append((*low, 0, *np.minimum(high, [5.98, 4.98]), rng.choice([0.2, 0.5, 0.8, 1.2])))
    for _ in range(3):  # poles, and beams over heads
        low = rng.uniform([0, 0], [5, 4]).round(1) + 0.03
        z = rng.choice([0.0, 1.6, 2.2])
        boxes.append((*low, z, *(low + rng.choice([0.1, 0.9], 2)), z + 1.5))
    content = "".join(box(f"box {k}", *corners) for k, corners in enumerate(boxes))
    settings = {"levels": [{"ground": -0.1}], "names": False, "rooms": "none"}
    settings["floors"] = {"tops": True, "min_area": 0.2, "shrink": 0.1}
    grid = bake(content, {**DROP, "height": 0.9}, grid={"bounds": [0, 0, 6, 5]}, **settings)
    widths = sorted(link.width for link in grid.links)
    assert widths == plain_drops(grid, boxes, 0.9, 0.4)
    assert seed or len(widths) > 3


# --- ladders and lifts ----------------------------------------------------------------------------

STOREYS = (
    box("ground floor", 0.02, 0.02, -0.2, 5.98, 3.98, 0)
    + box("mezzanine", 3.02, 0.02, 2.8, 5.98, 3.98, 3.0)
    + "".join(
        box(f"wall {k}", *sides)
        for k, sides in enumerate(
            [
                (0.02, -0.1, 0, 5.98, 0.02, 6),
                (0.02, 3.98, 0, 5.98, 4.1, 6),
                (5.98, -0.1, 0, 6.1, 4.1, 6),
                (-0.1, -0.1, 0, 0.02, 4.1, 6),
            ]
        )
    )
)


def test_a_ladder_joins_the_floors_that_it_reaches():
    rails = "".join(box("", 2.9, y, 0.01, 2.96, y + 0.04, 3.6) for y in (1.41, 1.87))
    rungs = "".join(box("", 2.91, 1.45, z, 2.95, 1.87, z + 0.03) for z in np.arange(0.3, 3.5, 0.3))
    ladder = body("ladder_1", rails + rungs)
    (link,) = bake(STOREYS + ladder, {"auto": "ladder", "seconds": 8}).links
    assert (link.name, link.kind, link.seconds, link.one_way) == ("ladder_1", "ladder", 8, False)
    assert [round(stop.position[2], 3) for stop in link.stops] == [0.0, 3.0]
    assert all(math.dist(stop.position[:2], (2.93, 1.66)) < 0.7 for stop in link.stops)
    assert link.width == pytest.approx(0.5)
    with pytest.warns(BakeWarning, match="asks for ladders, but the scene has none"):
        bake(STOREYS + ladder.replace("ladder_1", "tower"), {"auto": "ladder"})


def car(name="lift", z=0.0, reach=3.0, x=1.83, way="0 0 1"):
    """A car of 1.1 x 1.3 m, open to the mezzanine's side, beside it."""
    parts = box("", -0.55, -0.65, 0.002, 0.55, 0.65, 0.022)
    parts += box("", -0.55, -0.65, 0.022, -0.51, 0.65, 2.2)
    parts += box("", -0.51, 0.61, 0.022, 0.55, 0.65, 2.2)
    joint = f'<joint name="{name}" type="slide" axis="{way}" range="{-z} {reach - z}"/>'
    return body(name, joint + parts, f'pos="{x + 0.6} 2 {z}"')


def test_a_lift_stops_beside_the_floors_that_it_meets():
    grid = bake(STOREYS + car(), {"auto": "lift"})
    (link,) = grid.links
    assert (link.name, link.kind, link.auto) == ("lift", "lift", True)
    # to the east and the south on the ground floor, to the east on the mezzanine
    stops = [tuple(round(v, 2) for v in stop.position) for stop in link.stops]
    assert {stop[2] for stop in stops} == {0.0, 3.0}
    assert all(3.4 < x < 3.6 and 1.4 < y < 2.6 for x, y, z in stops if z == 3.0)
    assert 0.9 <= link.width <= 1.1
    assert all_free(grid.inflate(link.width / 2), link)


@pytest.mark.parametrize("z", [0.0, 1.3, 3.0])
def test_a_lift_is_the_same_wherever_its_car_is(z):
    assert bake(STOREYS + car(), {"auto": "lift"}).links[0].stops[-1].level == 1
    here = bake(STOREYS + car(z=z), {"auto": "lift"}).links
    assert [round(stop.position[2], 3) for stop in here[0].stops][-1] == 3.0


@pytest.mark.parametrize(
    "content",
    [
        car(reach=2.6),  # a step too low
        car(way="1 0 0"),
        car().replace('range="-0.0 3.0"', ""),  # without an end
        car() + box("gate", 3.03, 0.02, 3.0, 3.06, 3.98, 4.2),  # shut upstairs
        car().replace('type="slide"', 'type="hinge"'),
    ],
)
def test_what_meets_one_level_is_no_lift(content):
    with pytest.warns(BakeWarning, match="asks for lifts, but the scene has none"):
        assert bake(STOREYS + content, {"auto": "lift"}).links == ()


def test_names_of_found_links_differ_from_all_others():
    given = {"name": "lift", "kind": "ramp", "stops": [[1, 1, 0], [4, 1, 3]]}
    grid = bake(STOREYS + car(), given, {"auto": "lift", "patterns": ["lif*"]})
    assert [(link.name, link.auto) for link in grid.links] == [("lift", False), ("lift#2", True)]
