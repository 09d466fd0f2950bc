"""Small random scenes in which things can be moved, and settings for them.

Two kinds: rooms with furniture, doors and platforms, on floors of all sorts; and slabs with cracks,
tiles that lie side by side, and rows of thin walls that cut the floor into pieces.
"""

from __future__ import annotations

import random
from typing import Any

WIDTH, DEPTH = (4, 5, 6), (4, 5)  # of rooms [m]
MESHES = (
    '<mesh name="tetra" vertex="0 0 0 .6 0 0 0 .5 0 0.2 0.2 .7"/>'
    '<mesh name="wedge" vertex="0 0 0 1 0 0 1 .8 0 0 .8 0 1 0 .4 1 .8 .4"/>'
)
ROWS = 8  # of a height field
SOLIDS = (  # a, b, c: small half sizes; d, e: half sizes of thin plates [m]
    'type="box" size="{a} {b} {c}"',
    'type="cylinder" size="{a} {c}"',
    'type="sphere" size="{a}"',
    'type="capsule" size="{a} {c}"',
    'type="ellipsoid" size="{a} {b} {c}"',
    'type="mesh" mesh="tetra"',
    'type="mesh" mesh="wedge"',
    'type="box" size="{d} {e} .01"',
    'type="box" size="{d} {d} .005"',
    'type="box" size="{e} .004 .5"',
)
HINGE = '<joint name="hinge" axis="0 0 1" range="0 1.6"/>'
SLIDE = '<joint name="slide" type="slide" axis="0 1 0" range="0 1"/>'
CART = (
    '<body name="cart" pos="2 2 .2"><freejoint/><geom type="box" size=".3 .2 .1"/>'
    '<body name="flap" pos=".3 0 .1"><joint name="flap" axis="0 1 0" range="-1.5 1.5"/>'
    '<geom type="box" pos=".2 0 0" size=".2 .2 .01"/></body></body>'
)
PERSON = '<body name="person" mocap="true" pos="1 1 .6"><geom type="capsule" size=".2 .4"/></body>'
STAIR_STEPS = 6


def make_scene(rng: random.Random) -> tuple[str, dict[str, Any]]:
    """A scene as MJCF, and settings; MuJoCo may refuse it, and it may hold nothing to bake."""
    return _make_tiles(rng) if rng.random() < 0.3 else _make_room(rng)


def _box(name: str, place: tuple[float, ...], half: tuple[float, ...]) -> str:
    place_text, size = (" ".join(f"{value:.4g}" for value in values) for values in (place, half))
    return f'<geom name="{name}" type="box" pos="{place_text}" size="{size}"/>'


def _make_room(rng: random.Random) -> tuple[str, dict[str, Any]]:
    """A room or two, furnished."""
    width, depth, height = rng.choice(WIDTH), rng.choice(DEPTH), rng.choice((2.5, 2.5, 1.4))
    geoms, is_endless = _floor(rng, width, depth)
    middle_x, middle_y = width / 2, depth / 2
    if rng.random() < 0.6:
        sides = {
            "south": ((middle_x, 0.05), (middle_x, 0.05)),
            "north": ((middle_x, depth - 0.05), (middle_x, 0.05)),
            "west": ((0.05, middle_y), (0.05, middle_y)),
            "east": ((width - 0.05, middle_y), (0.05, middle_y)),
        }
        for side, (place, half) in sides.items():
            if rng.random() < 0.85:
                geoms += _box(f"wall_{side}", (*place, height / 2), (*half, height / 2))
    if rng.random() < 0.6:
        geoms += _partition(rng, middle_x, depth, height)
    geoms += _fixtures(rng, width, depth)
    bodies = "".join(_thing(rng, number, width, depth) for number in range(rng.randint(2, 7)))
    bodies += PERSON if rng.random() < 0.4 else ""
    bodies += CART if rng.random() < 0.3 else ""
    elevation = " ".join(f"{rng.random():.2f}" for _ in range(ROWS * ROWS))
    field = f'nrow="{ROWS}" ncol="{ROWS}" size="{middle_x} {middle_y} 0.25 0.1"'
    assets = f'{MESHES}<hfield name="hills" {field} elevation="{elevation}"/>'
    document = f"<asset>{assets}</asset><worldbody>{geoms}{bodies}</worldbody>"
    return f"<mujoco>{document}</mujoco>", _settings(rng, width, depth, is_endless)


def _floor(rng: random.Random, width: float, depth: float) -> tuple[str, bool]:
    """A floor, and whether it is endless."""
    kind, x, y = rng.random(), width / 2, depth / 2
    if kind < 0.45:
        return _box("floor", (x, y, -0.1), (x, y, 0.1)), False
    if kind < 0.6:  # two slabs with a crack or a small step between them
        gap, rise = rng.choice((0, 0.003, 0.01, 0.03, 0.08)), rng.choice((0, 0, 0.005, 0.02, 0.1))
        seam = x + rng.uniform(-0.3, 0.3)
        far = width - seam - gap
        west = _box("floor_west", (seam / 2, y, -0.1), (seam / 2, y, 0.1))
        return west + _box("floor_east", (width - far / 2, y, rise - 0.1), (far / 2, y, 0.1)), False
    if kind < 0.75:
        return '<geom name="ground" type="plane" size="0 0 1"/>', True
    if kind < 0.85:
        return f'<geom name="hills" type="hfield" hfield="hills" pos="{x} {y} 0"/>', False
    return f'<geom name="floor" type="plane" pos="{x} {y} 0" size="{x} {y} 1"/>', True


def _partition(rng: random.Random, x: float, depth: float, height: float) -> str:
    """A wall with a gap, mostly with a door in it."""
    wide, low = rng.uniform(0.8, 1.1), rng.uniform(1, depth - 2)
    high = low + wide
    walls = _box("wall_low", (x, low / 2, height / 2), (0.05, low / 2, height / 2))
    rest = depth - high
    walls += _box("wall_high", (x, depth - rest / 2, height / 2), (0.05, rest / 2, height / 2))
    if rng.random() < 0.7:
        half = min(height, 2) / 2
        leaf = f'<geom type="box" pos="0 {wide / 2} 0" size=".02 {wide / 2 - 0.02} {half - 0.03}"/>'
        joint = rng.choice((HINGE, SLIDE))
        walls += f'<body name="door" pos="{x} {low} {half}">{joint}{leaf}</body>'
    return walls


def _fixtures(rng: random.Random, width: float, depth: float) -> str:
    """Things that stay where they are."""
    geoms = ""
    if rng.random() < 0.3:
        half = rng.choice((0.05, 0.15, 0.3))
        geoms += _box("platform", (width - 0.8, 0.9, 0.15), (0.7, 0.8, half))
    if rng.random() < 0.2:
        for step in range(STAIR_STEPS):
            half = 0.09 * (step + 1)
            place = (0.4 + 0.25 * step, depth - 0.7, half)
            geoms += _box(f"stair_{step}", place, (0.125, 0.45, half))
    if rng.random() < 0.9:  # what moves is neither the highest nor the outermost then
        geoms += _box("mast", (0.3, 0.3, 2), (0.1, 0.1, 2))
        geoms += _box("corner_low", (-0.8, -0.8, 0.1), (0.1, 0.1, 0.1))
        geoms += _box("corner_high", (width + 0.8, depth + 0.8, 0.1), (0.1, 0.1, 0.1))
    if rng.random() < 0.25:
        half = (width / 2 * rng.choice((0.5, 1)), depth / 2, 0.05)
        geoms += _box("roof", (width / 2, depth / 2, 2.6), half)
    if rng.random() < 0.25:
        geoms += '<site name="room_a" type="box" pos="1 1 1" size=".9 .9 1"/>'
    if rng.random() < 0.3:
        geoms += '<geom name="rock" type="mesh" mesh="tetra" pos="3 1 0"/>'
    return geoms


def _thing(rng: random.Random, number: int, width: float, depth: float) -> str:
    """A body with a free joint, of a few geoms."""
    geoms = ""
    for k in range(rng.choice((1, 1, 1, 2, 4))):
        halves = {name: round(rng.uniform(0.05, 0.35), 3) for name in "ab"}
        halves |= {name: round(rng.uniform(0.2, 0.9), 3) for name in "de"}
        solid = rng.choice(SOLIDS).format(**halves, c=round(rng.uniform(0.03, 0.6), 3))
        aside = [rng.uniform(-0.3, 0.3) if k else 0.0 for _ in range(2)]
        up = rng.uniform(0, 0.4) if k else 0.0
        geoms += f'<geom {solid} pos="{aside[0]:.3f} {aside[1]:.3f} {up:.3f}"/>'
    x, y = rng.uniform(0.5, width - 0.5), rng.uniform(0.5, depth - 0.5)
    place = f'pos="{x:.3f} {y:.3f} {rng.choice((0.01, 0.1, 0.3, 0.5))}"'
    return f'<body name="thing_{number}" {place}><freejoint/>{geoms}</body>'


def _settings(rng: random.Random, width: float, depth: float, is_endless: bool) -> dict[str, Any]:
    grid: dict[str, Any] = {"cell_size": rng.choice((0.1, 0.1, 0.15, 0.2, 0.07))}
    if is_endless or rng.random() < 0.85:
        grid["bounds"] = [-2.0, -2.0, width + 2.0, depth + rng.choice((2.03, 2.0))]
    elif rng.random() < 0.3:
        grid["margin"] = rng.choice((0.3, 1.0))
    step, radius = rng.choice((0.2, 0.2, 0.25, 0.3)), rng.choice((0.0, 0.05, 0.2, 0.3, 0.9))
    least, shrink = rng.choice((1.0, 1.0, 0.3, 0.15, 2.5)), rng.choice((0.3, 0.3, 0.2, 0.1))
    settings: dict[str, Any] = {
        "grid": grid,
        "agent": {"radius": radius, "traversable_floor_height": step},
        "floors": {"min_area": least, "shrink": shrink},
    }
    if rng.random() < 0.3:
        settings["floors"]["crack"] = rng.choice((0.0, 0.02, 0.1))
    settings["floors"] |= {"tops": rng.random() < 0.2, "roofs": rng.random() < 0.15}
    settings["names"] = {"enabled": rng.random() < 0.8}
    if rng.random() < 0.2:
        settings["rooms"] = {"door_width": 1.0}
    if rng.random() < 0.2:
        settings["scene"] = {"meshes": rng.choice(("surface", "shell"))}
    if rng.random() < 0.2:
        settings["attributes"] = ["island", "clearance"]
    if rng.random() < 0.3:
        settings["doors"] = {"state": rng.choice(("open", "closed", "removed"))}
    return settings


def _make_tiles(rng: random.Random) -> tuple[str, dict[str, Any]]:
    """A slab, or two with a crack between them, with tiles and thin walls on it."""
    edge = rng.choice((0.4, 0.5, 0.8))
    geoms = _box("mast", (-0.1, -0.1, 1.5), (0.1, 0.1, 1.5))
    if rng.random() < 0.4:
        geoms += _box("floor_west", (0.9, 2, -0.1), (1.1, 2.2, 0.1))
        x, z = 3.1 + rng.choice((0.005, 0.02, 0.04)), -0.1 + rng.choice((0, 0.01))
        geoms += _box("floor_east", (x, 2, z), (1.1, 2.2, 0.1))
    else:
        geoms += _box("floor", (2, 2, -0.1), (2.2, 2.2, 0.1))

    def add(name: str, half: tuple[float, ...]) -> str:
        x, y = (rng.uniform(0.3, 3.7) for _ in range(2))
        body = f'<body name="{name}" pos="{x:.3f} {y:.3f} {half[2]}"><freejoint/>'
        return f"{body}{_box(f'{name}_geom', (0, 0, 0), half)}</body>"

    for number in range(rng.choice((9, 16))):
        thick = rng.choice((0.01, 0.02, 0.05, 0.1, 0.3, 0.6))
        geoms += add(f"tile_{number}", (edge / 2, edge / 2, thick))
    for number in range(4):
        geoms += add(
            f"panel_{number}", (rng.choice((0.5, 1, 2)), rng.choice((0.002, 0.02, 0.1)), 0.5)
        )
    floors = {"min_area": rng.choice((0.2, 0.5, 1.0)), "shrink": rng.choice((0.1, 0.3))}
    step = rng.choice((0.15, 0.2, 0.3))
    settings: dict[str, Any] = {
        "grid": {
            "cell_size": rng.choice((0.1, 0.1, 0.05, 0.13)),
            "bounds": [-2.5, -2.5, 6.5, 6.5],
        },
        "agent": {"radius": rng.choice((0.0, 0.05, 0.2)), "traversable_floor_height": step},
        "floors": floors | {"tops": rng.random() < 0.3},
    }
    if rng.random() < 0.5:
        settings["floors"]["crack"] = rng.choice((0.02, 0.05, 0.1))
    if rng.random() < 0.3:
        settings["rooms"] = {"door_width": 0.9}
    return f"<mujoco><worldbody>{geoms}</worldbody></mujoco>", settings
