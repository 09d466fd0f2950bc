"""Makes the sample scenes of configs/scenes: four in MJCF, one as a mesh in OBJ.

Lengths are in metres, angles in degrees, z is up. The same bytes come out on each run: every
random number has a fixed seed, every number is rounded when written. Faces of walls and
furniture keep off the multiples of 0.05 m, where cells meet and where rays go down, so that
no cell hangs on the last bit of a number.

Doors are bodies named ``door_…`` with a joint of the same name: 0 is closed, the upper end of
its range is open. The keyframes `doors_closed` and `doors_open` set all of a scene's doors.

    python scripts/make_scenes.py [NAME…] [-o DIRECTORY]
"""

from __future__ import annotations

import argparse
import math
import random
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

SCENES = Path(__file__).resolve().parents[1] / "configs" / "scenes"

DOOR_HEIGHT = 2.05  # of the gap; the lintel is above it
LEAF = 0.042  # thickness of a door's leaf
PLAY = 0.005  # between a door's leaf and its frame
RISE = 3.0 / 16  # of a step, 16 from storey to storey
COLORS = {
    "plaster": (0.92, 0.91, 0.87),
    "wood": (0.65, 0.47, 0.3),
    "parquet": (0.78, 0.64, 0.46),
    "tiles": (0.74, 0.8, 0.83),
    "concrete": (0.66, 0.66, 0.64),
    "fabric": (0.35, 0.45, 0.6),
    "rug": (0.6, 0.27, 0.25),
    "metal": (0.45, 0.47, 0.5),
    "white": (0.97, 0.97, 0.97),
    "plant": (0.32, 0.5, 0.28),
    "earth": (0.5, 0.55, 0.36),
    "rock": (0.52, 0.5, 0.48),
    "accent": (0.85, 0.5, 0.15),
}

Vector = Sequence[float]
Opening = tuple[float, float, float, float]  # along the wall from, to; above the floor from, to


# --- the document ------------------------------------------------------------------------


def text(value: float | str | Iterable[float], digits: int = 4) -> str:
    """Write a value as an MJCF attribute: numbers rounded, without trailing zeros."""
    if isinstance(value, str):
        return value
    if isinstance(value, (int, float)):
        number = f"{value:.{digits}f}".rstrip("0").rstrip(".") if digits else f"{value:.0f}"
        return "0" if number in ("-0", "") else number
    return " ".join(text(v, digits) for v in value)


class Scene:
    """An MJCF document in the making.

    Attributes:
        asset: its asset element.
        world: its worldbody element.
        poses: for each joint in the document's order, its qpos (closed, open).
    """

    def __init__(self, name: str, extent: float) -> None:
        self.root = ET.Element("mujoco", model=name)
        ET.SubElement(self.root, "compiler", angle="degree")
        ET.SubElement(self.root, "statistic", extent=text(extent), center="0 0 1")
        visual = ET.SubElement(self.root, "visual")
        ET.SubElement(visual, "headlight", ambient="0.35 0.35 0.35", diffuse="0.4 0.4 0.4")
        ET.SubElement(visual, "global", offwidth="1280", offheight="960")
        self.asset = ET.SubElement(self.root, "asset")
        for color, rgb in COLORS.items():
            ET.SubElement(self.asset, "material", name=color, rgba=text((*rgb, 1.0)))
        self.world = ET.SubElement(self.root, "worldbody")
        ET.SubElement(self.world, "light", pos="0 0 12", dir="0.2 0.3 -1", directional="true")
        self.poses: list[tuple[Vector, Vector]] = []

    def to_xml(self) -> str:
        """Write the document, with the doors' keyframes if it has joints."""
        root = ET.fromstring(ET.tostring(self.root))
        if self.poses:
            keyframe = ET.SubElement(root, "keyframe")
            for name, i in (("doors_closed", 0), ("doors_open", 1)):
                qpos = " ".join(text(pose[i], 6) for pose in self.poses)
                ET.SubElement(keyframe, "key", name=name, qpos=qpos)
        ET.indent(root)
        return ET.tostring(root, encoding="unicode") + "\n"


def add_body(parent: ET.Element, name: str, pos: Vector = (0, 0, 0), yaw: float = 0) -> ET.Element:
    body = ET.SubElement(parent, "body", name=name, pos=text(pos))
    if yaw:
        body.set("euler", text((0, 0, yaw)))
    return body


def add_geom(
    parent: ET.Element, name: str, kind: str, color: str, **attributes: float | str | Vector
) -> ET.Element:
    geom = ET.SubElement(parent, "geom", name=name, type=kind, material=color)
    for key, value in attributes.items():
        geom.set(key, text(value))
    return geom


def add_box(parent: ET.Element, name: str, low: Vector, high: Vector, color: str) -> None:
    """Add an upright box from its lower to its upper corner."""
    pos = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
    size = [(b - a) / 2 for a, b in zip(low, high, strict=True)]
    add_geom(parent, name, "box", color, pos=pos, size=size)


def add_post(
    parent: ET.Element, name: str, xy: Vector, z: Vector, radius: float, color: str
) -> None:
    """Add an upright cylinder from ``z[0]`` to ``z[1]``."""
    pos, size = (*xy, (z[0] + z[1]) / 2), (radius, (z[1] - z[0]) / 2)
    add_geom(parent, name, "cylinder", color, pos=pos, size=size)


def add_bar(
    parent: ET.Element, name: str, start: Vector, end: Vector, radius: float, color: str
) -> None:
    """Add a capsule between two points."""
    add_geom(parent, name, "capsule", color, fromto=(*start, *end), size=(radius,))


def add_ball(parent: ET.Element, name: str, pos: Vector, radius: float, color: str) -> None:
    add_geom(parent, name, "sphere", color, pos=pos, size=(radius,))


def add_mesh(scene: Scene, name: str, vertices: Iterable[Vector]) -> None:
    """Add a mesh asset, the convex hull of its vertices."""
    flat = " ".join(text(v) for v in vertices)
    ET.SubElement(scene.asset, "mesh", name=name, vertex=flat)


# --- what buildings are made of ----------------------------------------------------------


def add_wall(
    scene: Scene,
    name: str,
    x: Vector,
    y: Vector,
    z: Vector,
    openings: Sequence[Opening] = (),
    color: str = "plaster",
) -> None:
    """Add an upright wall as boxes, left open where doors and windows are.

    Args:
        scene: the document.
        name: prefix of the boxes' names.
        x: from, to.
        y: from, to; the wall runs along the longer of the two.
        z: from, to.
        openings: from low to high along the wall, heights above ``z[0]``.
        color: a key of COLORS.
    """
    along_x = x[1] - x[0] > y[1] - y[0]
    start, end = x if along_x else y

    def add_piece(piece: str, u0: float, u1: float, z0: float, z1: float) -> None:
        if along_x:
            add_box(scene.world, piece, (u0, y[0], z0), (u1, y[1], z1), color)
        else:
            add_box(scene.world, piece, (x[0], u0, z0), (x[1], u1, z1), color)

    for i, (u0, u1, above, below) in enumerate(openings, 1):
        add_piece(f"{name}_{i}", start, u0, *z)
        if above > 0:
            add_piece(f"{name}_parapet_{i}", u0, u1, z[0], z[0] + above)
        if z[0] + below < z[1]:
            add_piece(f"{name}_lintel_{i}", u0, u1, z[0] + below, z[1])
        start = u1
    add_piece(f"{name}_{len(openings) + 1}", start, end, *z)


def door_gap(start: float) -> Opening:
    """The opening of a door of 0.9 m, from `start` on along the wall."""
    return start, start + 0.9, 0.0, DOOR_HEIGHT


def window_gap(start: float, width: float = 1.4) -> Opening:
    return start, start + width, 0.92, 2.13


def cut_rectangle(rectangle: Vector, holes: Sequence[Vector]) -> list[tuple[float, ...]]:
    """Cut holes out of a rectangle, both as (x0, y0, x1, y1); return what is left as such."""
    x0, y0, x1, y1 = rectangle
    cuts = sorted({x0, x1, *(h[0] for h in holes), *(h[2] for h in holes)})
    pieces: list[tuple[float, ...]] = []
    for left, right in pairwise(cuts):
        bottom = y0
        for hole in sorted(holes, key=lambda h: h[1]):
            if hole[0] <= left and right <= hole[2]:
                if hole[1] > bottom:
                    pieces.append((left, bottom, right, hole[1]))
                bottom = hole[3]
        if bottom < y1:
            pieces.append((left, bottom, right, y1))
    return pieces


def add_slab(
    scene: Scene, name: str, rectangle: Vector, z: Vector, holes: Sequence[Vector] = ()
) -> None:
    """Add a concrete slab over a rectangle (x0, y0, x1, y1), with rectangular holes."""
    for i, (x0, y0, x1, y1) in enumerate(cut_rectangle(rectangle, holes), 1):
        add_box(scene.world, f"{name}_{i}", (x0, y0, z[0]), (x1, y1, z[1]), "concrete")


def add_hinged_door(
    scene: Scene,
    name: str,
    axis: str,
    gap: Opening,
    face: float,
    into: int,
    hinge: str,
    ground: float = 0.0,
    modelled: float = 90.0,
) -> None:
    """Hang a door into its gap, its hinge at the face of the wall that it swings out of.

    Closed it fills the gap, open (90°) it stands square to the wall, and on its way it
    touches nothing.

    Args:
        scene: the document.
        name: of the body and of the joint.
        axis: "x" or "y", along which the wall runs.
        gap: the wall's opening.
        face: where the wall's face is, across the wall.
        into: +1 or -1, to which side of the wall it swings.
        hinge: "low" or "high", at which end of the gap it hangs.
        ground: height of the floor.
        modelled: angle of the joint in qpos0.
    """
    sign = 1 if hinge == "low" else -1
    u = gap[0] + PLAY if hinge == "low" else gap[1] - PLAY
    closed_yaw = {("x", 1): 0, ("x", -1): 180, ("y", 1): 90, ("y", -1): 270}[axis, sign]
    swing = sign * into if axis == "x" else -sign * into
    pos = (u, face, ground) if axis == "x" else (face, u, ground)
    body = add_body(scene.world, name, pos, yaw=(closed_yaw + swing * modelled) % 360)
    ET.SubElement(
        body,
        "joint",
        name=name,
        axis=text((0, 0, swing)),
        range="0 90",
        ref=text(modelled),
        damping="1",
    )
    width, top = gap[1] - gap[0] - 2 * PLAY, gap[3] - 2 * PLAY
    near, far = (-LEAF, 0.0) if swing > 0 else (0.0, LEAF)
    add_box(body, f"{name}_leaf", (0, near, 0.012), (width, far, top), "wood")
    for side, y in (("a", near - 0.03), ("b", far + 0.03)):
        add_ball(body, f"{name}_knob_{side}", (width - 0.073, y, 1.03), 0.028, "metal")
    scene.poses.append(((0.0,), (math.radians(90),)))


def add_sliding_door(
    scene: Scene, name: str, gap: Opening, face: float, into: int, travel: float
) -> None:
    """Hang a sliding door before its gap in a wall along x; closed at 0, open at `travel`.

    It slides along -x, before the wall's face, and is modelled open.
    """
    y = face + into * (PLAY + LEAF / 2)
    body = add_body(scene.world, name, ((gap[0] + gap[1]) / 2 - travel, y, 0))
    joint = ET.SubElement(body, "joint", name=name, type="slide", axis="-1 0 0", damping="5")
    joint.set("range", text((0, travel)))
    joint.set("ref", text(travel))
    half = (gap[1] - gap[0]) / 2 + 0.02
    add_box(
        body, f"{name}_leaf", (-half, -LEAF / 2, 0.012), (half, LEAF / 2, gap[3] + 0.03), "wood"
    )
    scene.poses.append(((0.0,), (travel,)))


def add_railing(scene: Scene, name: str, start: Vector, end: Vector, z: float) -> None:
    """Add a railing 0.95 m high along a line: posts, a bar half way up and a handrail."""
    body = add_body(scene.world, name, (0, 0, z))
    length = math.dist(start, end)
    count = max(2, math.ceil(length / 1.1) + 1)
    for i in range(count):
        t = i / (count - 1)
        xy = [a + (b - a) * t for a, b in zip(start, end, strict=True)]
        add_post(body, f"{name}_post_{i + 1}", xy, (0, 0.95), 0.022, "metal")
    for bar, height in (("middle", 0.52), ("handrail", 0.95)):
        add_bar(body, f"{name}_{bar}", (*start, height), (*end, height), 0.024, "metal")


def add_ramp(
    parent: ET.Element, name: str, foot: Vector, top: Vector, width: float, color: str
) -> None:
    """Add a tilted box whose upper face leads from `foot` up to `top`, at equal y.

    It starts 0.15 m before the foot, below ground, so that there is no kerb.
    """
    dx, dz = top[0] - foot[0], top[2] - foot[2]
    slope, length, thickness = math.atan2(dz, abs(dx)), math.hypot(dx, dz), 0.1
    along = (math.copysign(math.cos(slope), dx), math.sin(slope))
    down = (math.copysign(math.sin(slope), dx), -math.cos(slope))
    s = (length - 0.15) / 2
    add_geom(
        parent,
        name,
        "box",
        color,
        pos=(
            foot[0] + along[0] * s + down[0] * thickness / 2,
            foot[1],
            foot[2] + along[1] * s + down[1] * thickness / 2,
        ),
        size=((length + 0.15) / 2, width / 2, thickness / 2),
        euler=(0, -math.degrees(math.copysign(slope, dx)), 0),
    )


# --- furniture, standing at its body's origin ----------------------------------------------


def add_table(
    scene: Scene, name: str, pos: Vector, length: float, depth: float, height: float = 0.75
) -> None:
    body = add_body(scene.world, name, pos)
    x, y, leg = length / 2, depth / 2, 0.06
    add_box(body, f"{name}_top", (-x, -y, height - 0.04), (x, y, height), "wood")
    for i, (sx, sy) in enumerate(((-1, -1), (1, -1), (1, 1), (-1, 1)), 1):
        cx, cy = sx * (x - 0.07), sy * (y - 0.07)
        low, high = (cx - leg / 2, cy - leg / 2, 0), (cx + leg / 2, cy + leg / 2, height - 0.04)
        add_box(body, f"{name}_leg_{i}", low, high, "wood")


def add_round_table(scene: Scene, name: str, pos: Vector, radius: float, height: float) -> None:
    body = add_body(scene.world, name, pos)
    add_post(body, f"{name}_top", (0, 0), (height - 0.04, height), radius, "wood")
    add_post(body, f"{name}_column", (0, 0), (0.03, height - 0.04), 0.045, "metal")
    add_post(body, f"{name}_foot", (0, 0), (0, 0.03), radius * 0.55, "metal")


def add_chair(scene: Scene, name: str, pos: Vector, yaw: float) -> None:
    """Add a chair that looks along +x before it is turned."""
    body = add_body(scene.world, name, pos, yaw)
    add_box(body, f"{name}_seat", (-0.22, -0.22, 0.43), (0.22, 0.22, 0.47), "wood")
    add_box(body, f"{name}_back", (-0.22, -0.22, 0.47), (-0.185, 0.22, 0.92), "wood")
    for i, (sx, sy) in enumerate(((-1, -1), (1, -1), (1, 1), (-1, 1)), 1):
        add_post(body, f"{name}_leg_{i}", (sx * 0.19, sy * 0.19), (0, 0.43), 0.019, "wood")


def add_bed(
    scene: Scene, name: str, pos: Vector, length: float = 2.04, width: float = 1.64
) -> None:
    """Add a bed on legs, its head at +y."""
    body = add_body(scene.world, name, pos)
    x, y = width / 2, length / 2
    add_box(body, f"{name}_frame", (-x, -y, 0.2), (x, y, 0.32), "wood")
    add_box(
        body, f"{name}_mattress", (-x + 0.03, -y + 0.03, 0.32), (x - 0.03, y - 0.06, 0.53), "white"
    )
    add_box(body, f"{name}_headboard", (-x, y - 0.05, 0.32), (x, y, 0.97), "wood")
    for i, (sx, sy) in enumerate(((-1, -1), (1, -1), (1, 1), (-1, 1)), 1):
        xy = (sx * (x - 0.06), sy * (y - 0.06))
        add_post(body, f"{name}_leg_{i}", xy, (0, 0.2), 0.035, "wood")
    for i, sx in enumerate((-1, 1) if width > 1.2 else (0,), 1):
        pillow = (sx * x / 2, y - 0.33, 0.6)
        add_geom(
            body, f"{name}_pillow_{i}", "ellipsoid", "fabric", pos=pillow, size=(0.3, 0.2, 0.09)
        )


def add_cupboard(scene: Scene, name: str, low: Vector, high: Vector, color: str = "wood") -> None:
    """Add a closed box of a piece of furniture between two corners, as a body of its own."""
    pos = ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2])
    body = add_body(scene.world, name, pos)
    x, y = (high[0] - low[0]) / 2, (high[1] - low[1]) / 2
    add_box(body, f"{name}_body", (-x, -y, 0), (x, y, high[2] - low[2]), color)


def add_shelf(scene: Scene, name: str, low: Vector, high: Vector) -> None:
    """Add an open shelf along y: two sides and five boards."""
    body = add_body(scene.world, name, low)
    dx, dy, dz = (b - a for a, b in zip(low, high, strict=True))
    for i, y in enumerate((0.0, dy - 0.03), 1):
        add_box(body, f"{name}_side_{i}", (0, y, 0), (dx, y + 0.03, dz), "wood")
    for i in range(5):
        z = 0.08 + i * (dz - 0.11) / 4
        add_box(body, f"{name}_board_{i + 1}", (0, 0.03, z), (dx, dy - 0.03, z + 0.03), "wood")


def add_hanging_lamp(scene: Scene, name: str, xy: Vector, z: float, ceiling: float) -> None:
    """Add a lamp on a cord, its lowest point at `z`."""
    body = add_body(scene.world, name, (*xy, z))
    add_ball(body, f"{name}_shade", (0, 0, 0.14), 0.14, "white")
    add_bar(body, f"{name}_cord", (0, 0, 0.3), (0, 0, ceiling - z - 0.006), 0.006, "metal")


def add_free_body(scene: Scene, name: str, pos: Vector, mass: float) -> ET.Element:
    body = add_body(scene.world, name, pos)
    ET.SubElement(body, "freejoint", name=name)
    ET.SubElement(body, "inertial", pos="0 0 0", mass=text(mass), diaginertia="0.01 0.01 0.01")
    scene.poses.append(((*pos, 1, 0, 0, 0),) * 2)
    return body


# --- apartment ---------------------------------------------------------------------------


def make_apartment() -> dict[str, str]:
    """Five rooms on 10 × 8 m, one storey without a roof, furniture of all geom types.

    The living room takes the south; north of it are, from the west, the bedroom, the hall, and
    over the hall the bathroom and the kitchen. All floors end at z = 0.
    """
    scene = Scene("apartment", extent=9)
    outside = [(0, 0), (0.11, 0), (0.17, 0.3), (0.09, 0.58), (0.13, 0.72)]
    inside = [(0.11, 0.72), (0.06, 0.58), (0.13, 0.3), (0.08, 0.05), (0, 0.05)]
    vase = trimesh.creation.revolve([*outside, *inside], sections=20)
    ET.SubElement(scene.asset, "mesh", name="vase", file="assets/vase.obj")
    add_apartment_walls(scene)
    add_apartment_doors(scene)
    furnish_living_room(scene)
    furnish_bedroom(scene)
    furnish_bathroom(scene)
    furnish_kitchen(scene)
    furnish_hall(scene)
    obj = write_obj("vase, turned from its outline, open at the top", {"vase": vase})
    return {"apartment.xml": scene.to_xml(), "assets/vase.obj": obj}


def add_apartment_walls(scene: Scene) -> None:
    for room, (x0, y0, x1, y1), color in (
        ("living_room", (-5, -4, 5, -0.27), "parquet"),
        ("hall", (-1.37, -0.27, 5, 1.27), "parquet"),
        ("bedroom", (-5, -0.27, -1.37, 4), "parquet"),
        ("kitchen", (1.43, 1.27, 5, 4), "tiles"),
    ):
        add_box(scene.world, f"floor|{room}", (x0, y0, -0.1), (x1, y1, 0), color)
    pos, size = (0.03, 2.635, 0), (1.4, 1.365, 0.1)
    add_geom(scene.world, "floor|bathroom", "plane", "tiles", pos=pos, size=size)

    z = (0, 2.5)
    windows = [window_gap(-3.82), window_gap(1.63)]
    add_wall(scene, "wall_south", (-5, 5), (-4, -3.86), z, windows)
    add_wall(scene, "wall_north", (-5, 5), (3.86, 4), z, [window_gap(-3.87), window_gap(2.37)])
    add_wall(scene, "wall_west", (-5, -4.86), (-3.86, 3.86), z)
    add_wall(scene, "wall_east", (4.86, 5), (-3.86, 3.86), z, [door_gap(0.06)])
    living = [door_gap(-2.72), door_gap(0.62)]
    add_wall(scene, "wall_living_room", (-4.86, 4.86), (-0.33, -0.21), z, living)
    add_wall(scene, "wall_bedroom", (-1.43, -1.31), (-0.21, 3.86), z, [door_gap(0.12)])
    hall = [door_gap(-0.33), door_gap(2.12)]
    add_wall(scene, "wall_hall", (-1.31, 4.86), (1.21, 1.33), z, hall)
    add_wall(scene, "wall_bathroom", (1.37, 1.49), (1.33, 3.86), z)


def add_apartment_doors(scene: Scene) -> None:
    gap = door_gap
    add_hinged_door(scene, "door_entrance", "y", gap(0.06), 4.86, -1, "high", modelled=0)
    add_hinged_door(scene, "door_living_room", "x", gap(0.62), -0.33, -1, "high")
    add_hinged_door(scene, "door_bedroom", "y", gap(0.12), -1.43, -1, "high")
    add_hinged_door(scene, "door_bathroom", "x", gap(-0.33), 1.33, 1, "high")
    add_hinged_door(scene, "door_kitchen", "x", gap(2.12), 1.33, 1, "low", modelled=45)
    add_sliding_door(scene, "door_terrace_room", gap(-2.72), -0.33, -1, travel=0.94)


def furnish_living_room(scene: Scene) -> None:
    profile = ((0, 0), (0.87, 0), (0.87, 0.36), (0.78, 0.43), (0.27, 0.83), (0, 0.86))
    add_mesh(scene, "sofa", [(x, d, z) for x in (-1.01, 1.01) for d, z in profile])
    sofa = add_body(scene.world, "sofa", (-0.64, -3.83, 0))
    add_geom(sofa, "sofa_hull", "mesh", "fabric", mesh="sofa")
    rug = add_body(scene.world, "rug_round", (-0.63, -1.93, 0))
    add_post(rug, "rug_round_disc", (0, 0), (0, 0.01), 1.02, "rug")
    add_round_table(scene, "coffee_table", (-0.63, -1.93, 0.01), 0.42, 0.43)
    beanbag = add_body(scene.world, "beanbag", (-2.76, -2.33, 0))
    add_geom(
        beanbag, "beanbag_bag", "ellipsoid", "accent", pos=(0, 0, 0.36), size=(0.47, 0.43, 0.36)
    )
    pouf = add_body(scene.world, "pouf", (-1.63, -1.38, 0))
    add_ball(pouf, "pouf_ball", (0, 0, 0.27), 0.27, "rug")
    lamp = add_body(scene.world, "floor_lamp", (-1.93, -3.54, 0))
    add_post(lamp, "floor_lamp_foot", (0, 0), (0, 0.02), 0.14, "metal")
    add_post(lamp, "floor_lamp_pole", (0, 0), (0.02, 1.52), 0.013, "metal")
    add_post(lamp, "floor_lamp_shade", (0, 0), (1.52, 1.77), 0.19, "white")
    add_shelf(scene, "bookshelf", (-4.84, -3.22, 0), (-4.52, -1.18, 2.1))
    plant = add_body(scene.world, "plant", (-4.42, -3.53, 0))
    add_post(plant, "plant_pot", (0, 0), (0, 0.36), 0.17, "accent")
    pos, size = (0, 0, 0.83), (0.31, 0.28, 0.52)
    add_geom(plant, "plant_leaves", "ellipsoid", "plant", pos=pos, size=size)
    add_cupboard(scene, "tv_bench", (-1.53, -0.77, 0), (0.13, -0.36, 0.48))
    television = add_body(scene.world, "television", (-0.703, -0.513, 0.48))
    add_box(television, "television_screen", (-0.61, -0.022, 0.06), (0.61, 0.022, 0.76), "metal")
    add_box(television, "television_foot", (-0.21, -0.11, 0), (0.21, 0.11, 0.06), "metal")
    add_table(scene, "dining_table", (3.143, -2.143, 0), 1.66, 0.92)
    for i, (x, y, yaw) in enumerate(
        ((2.74, -2.66, 90), (3.59, -2.74, 90), (2.71, -1.56, 270), (3.54, -1.46, 249)), 1
    ):
        add_chair(scene, f"dining_chair_{i}", (x, y, 0), yaw)
    add_hanging_lamp(scene, "dining_lamp", (3.13, -2.13), 1.93, 2.5)
    add_cupboard(scene, "sideboard", (2.03, -3.84, 0), (4.33, -3.42, 0.82))
    bolster = add_body(scene.world, "bolster", (4.58, -1.54, 0))
    add_bar(bolster, "bolster_roll", (0, -0.5, 0.22), (0, 0.5, 0.22), 0.22, "fabric")
    ball = add_free_body(scene, "ball", (1.33, -1.68, 0.12), mass=0.4)
    add_ball(ball, "ball_ball", (0, 0, 0), 0.12, "accent")


def furnish_bedroom(scene: Scene) -> None:
    add_bed(scene, "bed", (-3.223, 2.813, 0))
    for i, x in enumerate((-4.35, -2.12), 1):
        low, high = (x - 0.21, 3.43, 0), (x + 0.21, 3.84, 0.52)
        add_cupboard(scene, f"nightstand_{i}", low, high)
    add_cupboard(scene, "wardrobe", (-4.84, -0.18, 0), (-4.23, 1.57, 2.08))
    add_cupboard(scene, "dresser", (-1.88, 1.63, 0), (-1.46, 2.87, 0.93))
    waves = [[math.sin(0.9 * r) * math.sin(0.7 * c + 0.4) for c in range(16)] for r in range(12)]
    ET.SubElement(
        scene.asset,
        "hfield",
        name="rug_wavy",
        nrow="12",
        ncol="16",
        size=text((0.63, 0.44, 0.016, 0.003)),
        elevation=text([v for row in waves for v in row], 3),
    )
    rug = add_body(scene.world, "rug_wavy", (-3.37, 0.97, 0.004))
    add_geom(rug, "rug_wavy_field", "hfield", "rug", hfield="rug_wavy")
    add_hanging_lamp(scene, "bedroom_lamp", (-3.23, 1.93), 2.03, 2.5)
    box = add_body(scene.world, "toy_box", (-2.26, 1.43, 0.16))
    add_geom(box, "toy_box_box", "box", "accent", size=(0.17, 0.14, 0.16))


def furnish_bathroom(scene: Scene) -> None:
    tub = add_body(scene.world, "bath_tub", (-0.42, 3.46, 0))
    add_box(tub, "bath_tub_bottom", (-0.85, -0.38, 0), (0.85, 0.38, 0.13), "white")
    for name, low, high in (
        ("south", (-0.85, -0.38, 0.13), (0.85, -0.32, 0.57)),
        ("north", (-0.85, 0.32, 0.13), (0.85, 0.38, 0.57)),
        ("west", (-0.85, -0.32, 0.13), (-0.79, 0.32, 0.57)),
        ("east", (0.79, -0.32, 0.13), (0.85, 0.32, 0.57)),
    ):
        add_box(tub, f"bath_tub_{name}", low, high, "white")
    toilet = add_body(scene.world, "toilet", (0.94, 3.12, 0))
    add_geom(
        toilet, "toilet_bowl", "ellipsoid", "white", pos=(-0.06, 0, 0.24), size=(0.28, 0.19, 0.2)
    )
    add_post(toilet, "toilet_foot", (0.04, 0), (0, 0.24), 0.12, "white")
    add_box(toilet, "toilet_tank", (0.22, -0.19, 0.36), (0.42, 0.19, 0.83), "white")
    basin = add_body(scene.world, "washbasin", (-1.03, 2.13, 0))
    add_post(basin, "washbasin_pedestal", (0, 0), (0, 0.74), 0.09, "white")
    add_post(basin, "washbasin_bowl", (0, 0), (0.74, 0.87), 0.26, "white")
    rail = add_body(scene.world, "towel_rail", (1.3, 2.13, 1.32))
    add_bar(rail, "towel_rail_bar", (0, -0.3, 0), (0, 0.3, 0), 0.018, "metal")
    mat = add_body(scene.world, "bath_mat", (-0.41, 2.74, 0))
    add_box(mat, "bath_mat_mat", (-0.43, -0.28, 0), (0.43, 0.28, 0.014), "fabric")


def furnish_kitchen(scene: Scene) -> None:
    add_cupboard(scene, "counter", (1.52, 3.23, 0), (4.18, 3.84, 0.92), "white")
    add_cupboard(scene, "wall_cabinet", (1.52, 3.48, 1.46), (4.18, 3.84, 2.16))
    add_cupboard(scene, "fridge", (4.21, 3.22, 0), (4.82, 3.84, 1.83), "metal")
    add_round_table(scene, "kitchen_table", (4.02, 2.13, 0), 0.43, 0.74)
    for i, (x, y) in enumerate(((3.37, 2.26), (4.43, 1.63)), 1):
        stool = add_body(scene.world, f"stool_{i}", (x, y, 0))
        add_post(stool, f"stool_{i}_seat", (0, 0), (0.44, 0.48), 0.17, "wood")
        for k in range(3):
            c, s = math.cos(k * 2 * math.pi / 3), math.sin(k * 2 * math.pi / 3)
            foot, top = (0.15 * c, 0.15 * s, 0.014), (0.08 * c, 0.08 * s, 0.44)
            add_bar(stool, f"stool_{i}_leg_{k + 1}", foot, top, 0.014, "wood")
    add_hanging_lamp(scene, "kitchen_lamp", (3.13, 2.43), 2.03, 2.5)


def furnish_hall(scene: Scene) -> None:
    add_cupboard(scene, "shoe_cabinet", (2.23, -0.19, 0), (3.53, 0.13, 0.83))
    stand = add_body(scene.world, "coat_stand", (1.27, 0.97, 0))
    add_post(stand, "coat_stand_foot", (0, 0), (0, 0.03), 0.17, "metal")
    add_bar(stand, "coat_stand_pole", (0, 0, 0.04), (0, 0, 1.77), 0.018, "wood")
    for i, (x, y) in enumerate(((0.13, 0), (-0.13, 0), (0, 0.13), (0, -0.13)), 1):
        add_bar(stand, f"coat_stand_hook_{i}", (0, 0, 1.67), (x, y, 1.74), 0.01, "wood")
    runner = add_body(scene.world, "rug_hall", (1.38, 0.53, 0))
    add_box(runner, "rug_hall_mat", (-1.91, -0.26, 0), (1.91, 0.26, 0.008), "rug")
    vase = add_body(scene.world, "vase", (1.87, -0.02, 0))
    add_geom(vase, "vase_vase", "sdf", "tiles", mesh="vase")
    add_hanging_lamp(scene, "hall_lamp", (1.83, 0.53), 2.03, 2.5)


# --- house -------------------------------------------------------------------------------


def make_house() -> dict[str, str]:
    """Two storeys on 10 × 8 m, at 0 and 3 m, two stairs, a roof, open ground around.

    The closed stair rises along +x at the north wall, the open-tread one along +y at the east
    wall, each through a stairwell of its own.
    """
    scene = Scene("house", extent=11)
    wells = [(-1.653, 2.74, 1.467, 3.78), (3.71, -1.273, 4.78, 1.867)]
    pos, size = (0, 0, -0.05), (0, 0, 0.1)
    add_geom(scene.world, "ground", "plane", "earth", pos=pos, size=size)
    add_slab(scene, "slab_ground", (-5, -4, 5, 4), (-0.25, 0))
    add_slab(scene, "slab_upper", (-5, -4, 5, 4), (2.75, 3.0), wells)
    add_slab(scene, "roof", (-5.3, -4.3, 5.3, 4.3), (5.75, 6.0))
    add_box(scene.world, "doorstep_south", (0.77, -4.83, -0.25), (2.17, -4, -0.02), "concrete")
    add_box(scene.world, "doorstep_north", (-4.43, 4, -0.25), (-3.03, 4.83, -0.02), "concrete")
    add_ground_floor(scene)
    add_upper_floor(scene)
    add_closed_stair(scene)
    add_open_stair(scene)
    furnish_house(scene)
    return {"house.xml": scene.to_xml()}


def add_outer_walls(scene: Scene, name: str, z: Vector, openings: dict[str, list[Opening]]) -> None:
    for side, x, y in (
        ("south", (-5, 5), (-4, -3.78)),
        ("north", (-5, 5), (3.78, 4)),
        ("west", (-5, -4.78), (-3.78, 3.78)),
        ("east", (4.78, 5), (-3.78, 3.78)),
    ):
        add_wall(scene, f"wall_{name}_{side}", x, y, z, openings.get(side, ()))


def add_ground_floor(scene: Scene) -> None:
    z = (0, 2.75)
    south = [window_gap(-3.63), door_gap(1.02), window_gap(2.63)]
    north = [door_gap(-4.18), window_gap(3.27)]
    add_outer_walls(
        scene, "ground", z, {"south": south, "north": north, "west": [window_gap(-1.93)]}
    )
    stair_hall = [door_gap(-3.58), door_gap(0.42)]
    add_wall(scene, "wall_stair_hall", (-4.78, 3.19), (1.06, 1.18), z, stair_hall)
    add_wall(scene, "wall_alcove", (3.07, 3.19), (1.18, 3.78), z, [door_gap(2.02)])
    add_wall(scene, "wall_kitchen", (-0.93, -0.81), (-3.78, 1.06), z, [door_gap(-1.93)])
    add_hinged_door(scene, "door_front", "x", door_gap(1.02), -3.78, 1, "low")
    add_hinged_door(scene, "door_back", "x", door_gap(-4.18), 3.78, -1, "low")
    add_hinged_door(scene, "door_stair_kitchen", "x", door_gap(-3.58), 1.06, -1, "low")
    add_hinged_door(scene, "door_stair_living", "x", door_gap(0.42), 1.06, -1, "low")
    add_hinged_door(scene, "door_kitchen", "y", door_gap(-1.93), -0.93, -1, "high", modelled=60)


def add_upper_floor(scene: Scene) -> None:
    z = (3.0, 5.75)
    windows = {
        "south": [window_gap(-3.63), window_gap(0.13), window_gap(2.87)],
        "north": [window_gap(-3.93), window_gap(2.63)],
        "west": [window_gap(-1.93)],
        "east": [window_gap(-0.43)],
    }
    add_outer_walls(scene, "upper", z, windows)
    bedrooms = [door_gap(-3.18), door_gap(0.42)]
    add_wall(scene, "wall_bedrooms", (-4.78, 2.49), (1.06, 1.18), z, bedrooms)
    add_wall(scene, "wall_between_bedrooms", (-0.93, -0.81), (-3.78, 1.06), z)
    add_wall(scene, "wall_gallery", (2.37, 2.49), (-3.78, 1.06), z, [door_gap(-2.93)])
    add_hinged_door(scene, "door_bedroom_1", "x", door_gap(-3.18), 1.06, -1, "low", 3.0)
    add_hinged_door(scene, "door_bedroom_2", "x", door_gap(0.42), 1.06, -1, "high", 3.0)
    add_hinged_door(scene, "door_gallery", "y", door_gap(-2.93), 2.37, -1, "low", 3.0)


def add_closed_stair(scene: Scene) -> None:
    """15 solid steps along +x, y 2.76 to 3.76, and the railing round their well above."""
    stair = add_body(scene.world, "stair_closed")
    for k in range(1, 16):
        x = -2.433 + (k - 1) * 0.26
        low, high = (x, 2.76, 0), (x + 0.26, 3.76, k * RISE)
        add_box(stair, f"stair_closed_step_{k}", low, high, "wood")
    add_railing(scene, "railing_closed_south", (-1.693, 2.698), (1.467, 2.698), 3.0)
    add_railing(scene, "railing_closed_west", (-1.693, 2.698), (-1.693, 3.757), 3.0)


def add_open_stair(scene: Scene) -> None:
    """15 thin treads along +y, x 3.73 to 4.73, on a beam, and the railing round their well."""
    stair = add_body(scene.world, "stair_open")
    start, going = -2.033, 0.26
    for k in range(1, 16):
        y, z = start + (k - 1) * going, k * RISE
        low, high = (3.73, y - 0.02, z - 0.04), (4.73, y + going, z)
        add_box(stair, f"stair_open_tread_{k}", low, high, "wood")
    # the beam's upper edge runs through the treads' lower rear edges
    pitch = math.atan2(RISE, going)
    length, depth = 15 * math.hypot(RISE, going) - 0.38, 0.2
    middle = (length / 2 + 0.36) * math.cos(pitch), (length / 2 + 0.36) * math.sin(pitch) - 0.04
    add_geom(
        stair,
        "stair_open_beam",
        "box",
        "metal",
        pos=(
            4.23,
            start + middle[0] + depth / 2 * math.sin(pitch),
            middle[1] - depth / 2 * math.cos(pitch),
        ),
        size=(0.06, length / 2, depth / 2),
        euler=(math.degrees(pitch), 0, 0),
    )
    add_railing(scene, "railing_open_west", (3.668, -1.313), (3.668, 1.867), 3.0)
    add_railing(scene, "railing_open_south", (3.668, -1.313), (4.757, -1.313), 3.0)


def furnish_house(scene: Scene) -> None:
    add_table(scene, "dining_table", (1.543, -0.933, 0), 1.46, 0.88)
    for i, (x, y, yaw) in enumerate(((1.24, -1.49, 90), (1.84, -0.36, 270)), 1):
        add_chair(scene, f"dining_chair_{i}", (x, y, 0), yaw)
    add_cupboard(scene, "sofa", (-0.78, -3.63, 0), (0.07, -2.13, 0.44), "fabric")
    add_cupboard(scene, "counter", (-4.73, -3.76, 0), (-1.27, -3.16, 0.92), "white")
    # nobody stands under the upper treads, so that all of them are floors of the lower storey
    add_cupboard(scene, "stair_cupboard", (3.74, 0.243, 0), (4.77, 1.837, 1.2))
    add_round_table(scene, "kitchen_table", (-2.93, -1.17, 0), 0.47, 0.74)
    add_hanging_lamp(scene, "living_lamp", (1.53, -0.93), 1.98, 2.75)
    add_bed(scene, "bed_1", (-3.843, -2.723, 3.0))
    add_cupboard(scene, "wardrobe_1", (-1.53, -3.43, 3.0), (-0.96, -1.63, 5.08))
    add_bed(scene, "bed_2", (-0.043, -2.723, 3.0), width=1.04)
    add_table(scene, "desk", (1.763, -0.833, 3.0), 1.14, 0.62)
    add_cupboard(scene, "gallery_chest", (-4.74, 2.03, 3.0), (-4.28, 3.27, 3.83))
    rug = add_body(scene.world, "gallery_rug", (3.07, 2.92, 3.0))
    add_post(rug, "gallery_rug_disc", (0, 0), (0, 0.01), 0.57, "rug")


# --- warehouse ---------------------------------------------------------------------------


def make_warehouse() -> dict[str, str]:
    """A hall of 20 × 12 m with racks, a dock at 1.2 m with ramp and steps, a mezzanine at 3 m."""
    scene = Scene("warehouse", extent=20)
    add_slab(scene, "slab", (-10, -6, 10, 6), (-0.3, 0))
    z = (0, 6)
    gate, docks = (2.03, 5.03, 0.0, 4.02), [(-4.03, -1.63, 1.2, 3.82), (1.63, 4.03, 1.2, 3.82)]
    add_wall(scene, "wall_south", (-10, 10), (-6, -5.76), z, [gate])
    add_wall(scene, "wall_north", (-10, 10), (5.76, 6), z)
    add_wall(scene, "wall_west", (-10, -9.76), (-5.76, 5.76), z, [door_gap(-4.53)])
    add_wall(scene, "wall_east", (9.76, 10), (-5.76, 5.76), z, docks)
    add_hinged_door(scene, "door_office", "y", door_gap(-4.53), -9.76, 1, "high")
    for i, (x, y) in enumerate(((0.97, -4.07), (0.97, 1.93), (5.03, -1.03)), 1):
        add_post(scene.world, f"column_{i}", (x, y), (0, 6), 0.18, "concrete")
    for i, y in enumerate((-5.69, -3.29, -0.89), 1):
        add_rack(scene, f"rack_{i}", -8.543, y, seed=i)
    add_dock(scene)
    add_mezzanine(scene)
    add_stock(scene)
    return {"warehouse.xml": scene.to_xml()}


def add_rack(scene: Scene, name: str, x: float, y: float, seed: int) -> None:
    """Add three bays of 2.7 m along +x, 0.83 m deep, with three boards each, partly loaded."""
    rng = random.Random(seed)
    body = add_body(scene.world, name)
    for i in range(4):
        for side, dy in (("front", 0.0), ("rear", 0.75)):
            u, v = x + i * 2.82, y + dy
            low, high = (u, v, 0), (u + 0.08, v + 0.08, 4.32)
            add_box(body, f"{name}_upright_{i + 1}_{side}", low, high, "accent")
    for bay in range(3):
        x0 = x + bay * 2.82 + 0.08
        for k, z in enumerate((1.22, 2.57, 3.92), 1):
            board = f"{name}_board_{bay + 1}_{k}"
            add_box(body, board, (x0 + 0.02, y, z), (x0 + 2.72, y + 0.83, z + 0.04), "metal")
        for k, z in enumerate((0.0, 1.26, 2.61)):
            for slot in range(2):
                if rng.random() < 0.3:
                    continue
                width, height = (round(least + 0.5 * rng.random(), 2) for least in (0.6, 0.5))
                low = (x0 + 0.14 + slot * 1.3, y + 0.06, z)
                load = f"{name}_load_{bay + 1}_{k}_{slot + 1}"
                add_cupboard(scene, load, low, (low[0] + width, y + 0.77, z + height))


def add_dock(scene: Scene) -> None:
    """The loading dock along the east wall, its ramp (15°) and its six steps."""
    top = 1.2
    dock = add_body(scene.world, "dock")
    add_box(dock, "dock_slab", (6.53, -5.76, 0), (9.76, 5.76, top), "concrete")
    foot = 6.53 - top / math.tan(math.radians(15))
    add_ramp(dock, "dock_ramp", (foot, 2.03, 0), (6.53, 2.03, top), 2.0, "concrete")
    for k in range(1, 6):
        x = 6.53 - (6 - k) * 0.3
        low, high = (x, -3.03, 0), (x + 0.3, -2.03, k * 0.2)
        add_box(dock, f"dock_step_{k}", low, high, "concrete")
    add_railing(scene, "dock_railing_north", (6.582, 3.08), (6.582, 5.73), top)
    add_railing(scene, "dock_railing_middle", (6.582, -1.97), (6.582, 0.98), top)
    add_railing(scene, "dock_railing_south", (6.582, -5.73), (6.582, -3.08), top)


def add_mezzanine(scene: Scene) -> None:
    """The mezzanine in the north-west on columns, with a long stair that rests half way up."""
    body = add_body(scene.world, "mezzanine")
    add_box(body, "mezzanine_slab", (-9.76, 1.47, 2.75), (-4.033, 5.76, 3.0), "metal")
    for i, x in enumerate((-9.573, -6.973, -4.213), 1):
        for side, y in (("south", 1.663), ("north", 5.573)):
            low, high = (x - 0.12, y - 0.12, 0), (x + 0.12, y + 0.12, 2.75)
            add_box(body, f"mezzanine_column_{i}_{side}", low, high, "concrete")
    stair = add_body(scene.world, "mezzanine_stair")
    x = -4.033
    for k in range(15, 0, -1):
        going = 1.1 if k == 8 else 0.28
        name = "mezzanine_stair_landing" if k == 8 else f"mezzanine_stair_step_{k}"
        add_box(stair, name, (x, 4.27, 0), (x + going, 5.47, k * RISE), "metal")
        x += going
    add_railing(scene, "mezzanine_railing_south", (-9.73, 1.523), (-4.083, 1.523), 3.0)
    add_railing(scene, "mezzanine_railing_east", (-4.083, 1.523), (-4.083, 4.217), 3.0)


def add_stock(scene: Scene) -> None:
    """Pallets, barrels, a cable reel, pipes, bollards, a forklift and a movable cart."""
    pallets = ((2.64, 4.13), (3.97, 4.13), (3.96, -0.02), (-6.37, 3.63), (8.14, -0.37))
    for i, (x, y) in enumerate(pallets, 1):
        z = 1.2 if x > 6.53 else 0.0
        pallet = add_body(scene.world, f"pallet_{i}", (x, y, z))
        add_box(pallet, f"pallet_{i}_deck", (-0.6, -0.41, 0), (0.6, 0.41, 0.144), "wood")
        if i % 2:
            low, high = (-0.53, -0.37, 0.144), (0.48, 0.36, 0.96 + 0.07 * i)
            add_box(pallet, f"pallet_{i}_load", low, high, "parquet")
    for i, (x, y) in enumerate(((1.93, -1.37), (2.56, -1.31), (2.27, -0.76)), 1):
        barrel = add_body(scene.world, f"barrel_{i}", (x, y, 0))
        add_post(barrel, f"barrel_{i}_drum", (0, 0), (0, 0.88), 0.29, "fabric")
    reel = add_body(scene.world, "cable_reel", (-1.97, 2.43, 0), yaw=25)
    add_geom(
        reel, "cable_reel_drum", "cylinder", "wood", fromto=(0, -0.3, 0.55, 0, 0.3, 0.55), size=0.31
    )
    for side, y in (("a", 0.32), ("b", -0.32)):
        flange = (0, y - 0.02, 0.55, 0, y + 0.02, 0.55)
        add_geom(reel, f"cable_reel_{side}", "cylinder", "wood", fromto=flange, size=0.55)
    pipes = add_body(scene.world, "pipes", (8.03, 4.87, 1.2))
    for i, (y, z) in enumerate(((-0.17, 0.16), (0.17, 0.16), (0, 0.437)), 1):
        add_bar(pipes, f"pipes_{i}", (-0.9, y, z), (1.2, y, z), 0.16, "metal")
    for i, x in enumerate((1.87, 5.19), 1):
        bollard = add_body(scene.world, f"bollard_{i}", (x, -5.43, 0))
        add_post(bollard, f"bollard_{i}_post", (0, 0), (0, 1.02), 0.06, "accent")
    add_forklift(scene, (3.27, -3.53, 0), yaw=115)
    cart = add_free_body(scene, "cart", (-1.44, -1.74, 0), mass=20)
    add_box(cart, "cart_deck", (-0.42, -0.27, 0.16), (0.42, 0.27, 0.2), "metal")
    add_box(cart, "cart_handle", (-0.42, -0.27, 0.2), (-0.38, 0.27, 0.97), "metal")
    for i, (sx, sy) in enumerate(((-1, -1), (1, -1), (1, 1), (-1, 1)), 1):
        add_ball(cart, f"cart_wheel_{i}", (sx * 0.34, sy * 0.2, 0.08), 0.08, "metal")


def add_forklift(scene: Scene, pos: Vector, yaw: float) -> None:
    body = add_body(scene.world, "forklift", pos, yaw)
    add_box(body, "forklift_chassis", (-1.02, -0.53, 0.13), (0.83, 0.53, 0.94), "accent")
    add_box(body, "forklift_roof", (-0.73, -0.5, 2.02), (0.56, 0.5, 2.08), "metal")
    for i, (x, y) in enumerate(((-0.68, -0.45), (0.5, -0.45), (0.5, 0.45), (-0.68, 0.45)), 1):
        add_bar(body, f"forklift_pillar_{i}", (x, y, 0.94), (x, y, 2.0), 0.03, "metal")
    for i, (x, y) in enumerate(((-0.7, -0.48), (0.5, -0.48), (0.5, 0.48), (-0.7, 0.48)), 1):
        axle = (x, y - 0.09, 0.27, x, y + 0.09, 0.27)
        add_geom(body, f"forklift_wheel_{i}", "cylinder", "metal", fromto=axle, size=0.27)
    for side, y in (("right", -0.31), ("left", 0.23)):
        low, high = (0.83, y, 0.06), (0.91, y + 0.08, 2.13)
        add_box(body, f"forklift_mast_{side}", low, high, "metal")
        low, high = (0.91, y, 0.07), (1.93, y + 0.08, 0.12)
        add_box(body, f"forklift_fork_{side}", low, high, "metal")


# --- terrain -----------------------------------------------------------------------------

HUT, HUT_GROUND = (-5.03, 4.02), 1.43
BRIDGE, BRIDGE_GROUND = (4.04, -2.01), 1.62


def terrain_height(x: Any, y: Any) -> Any:
    """Height of the terrain: waves and a hill, flat round hut and bridge, cut by a ditch.

    The ditch runs along y through the whole field and has a flat bottom at z = 0.
    """

    def fade(distance: Any, width: float) -> Any:
        t = np.clip(1 - distance / width, 0, 1)
        return t * t * (3 - 2 * t)

    z = 1.25 + 0.27 * np.sin(0.45 * x + 0.6) * np.cos(0.38 * y - 0.4)
    z += 0.17 * np.sin(0.9 * x - 0.5 * y + 1.1) + 0.09 * np.cos(1.2 * y + 0.7 * x)
    z += 0.6 * np.exp(-((x + 5.6) ** 2 + (y + 5.4) ** 2) / 9)
    pad = fade(np.hypot(x - HUT[0], y - HUT[1]) - 2.5, 2.2)
    banks = fade(np.maximum(abs(x - BRIDGE[0]) - 4.3, abs(y - BRIDGE[1]) - 1.2), 1.6)
    z = z * (1 - pad) + HUT_GROUND * pad
    z = z * (1 - banks) + BRIDGE_GROUND * banks
    ditch = 3.2 * np.exp(-(((x - BRIDGE[0]) / 0.75) ** 2))
    return np.clip(z - ditch, 0, 2)


def make_terrain() -> dict[str, str]:
    """Hills of 0 to 2 m on 20 × 20 m, with a hut, a ditch, a footbridge, boulders and trees."""
    scene = Scene("terrain", extent=20)
    axis = np.linspace(-10, 10, 101)
    height = np.round(terrain_height(*np.meshgrid(axis, axis)), 3)
    ET.SubElement(
        scene.asset,
        "hfield",
        name="hills",
        nrow="101",
        ncol="101",
        size=text((10, 10, float(height.max()), 0.5)),
        elevation=text(height[::-1].ravel().tolist(), 3),  # MJCF lists the rows from +y down
    )
    add_geom(scene.world, "hills", "hfield", "earth", hfield="hills")
    add_hut(scene)
    add_footbridge(scene)
    rng = random.Random(4)
    spots = scatter(rng, 26)
    for i, (x, y) in enumerate(spots[:18], 1):
        add_boulder(scene, f"boulder_{i}", x, y, rng)
    for i, (x, y) in enumerate(spots[18:], 1):
        z = float(terrain_height(x, y))
        tree = add_body(scene.world, f"tree_{i}", (x, y, round(z, 3)))
        add_post(tree, f"tree_{i}_trunk", (0, 0), (-0.2, 1.9), 0.11, "wood")
        add_ball(tree, f"tree_{i}_crown", (0, 0, 2.6), 0.9, "plant")
    return {"terrain.xml": scene.to_xml()}


def scatter(rng: random.Random, count: int) -> list[tuple[float, float]]:
    """Draw spots at least 1.9 m apart, off hut, bridge and ditch."""
    spots: list[tuple[float, float]] = []
    while len(spots) < count:
        x, y = (round(rng.uniform(-8.9, 8.9), 3) for _ in range(2))
        near_hut = math.dist((x, y), HUT) < 3.4
        near_bridge = abs(x - BRIDGE[0]) < 5.2 and abs(y - BRIDGE[1]) < 1.6
        in_ditch = abs(x - BRIDGE[0]) < 2.1
        apart = all(math.dist((x, y), spot) > 1.9 for spot in spots)
        if apart and not (near_hut or near_bridge or in_ditch):
            spots.append((x, y))
    return spots


def add_boulder(scene: Scene, name: str, x: float, y: float, rng: random.Random) -> None:
    """Add a rock that is sunk into the ground by about a third of its height."""
    z = float(terrain_height(x, y))
    a, b, c = (round(rng.uniform(0.25, 0.75), 3) for _ in range(3))
    yaw, roll = round(rng.uniform(0, 180)), round(rng.uniform(-15, 15))
    body = add_body(scene.world, name, (x, y, round(z + 0.3 * c, 3)))
    if rng.random() < 0.4:
        add_ball(body, f"{name}_rock", (0, 0, 0), c, "rock")
    else:
        size, turn = (a, b, c), (roll, 0, yaw)
        add_geom(body, f"{name}_rock", "ellipsoid", "rock", size=size, euler=turn)


def add_hut(scene: Scene) -> None:
    """A hut of 3.2 × 2.8 m on its pad, door to the south, under a gabled roof."""
    (x, y), ground = HUT, HUT_GROUND
    floor = ground + 0.12
    x0, x1, y0, y1, t = x - 1.6, x + 1.6, y - 1.4, y + 1.4, 0.14
    add_box(scene.world, "floor|hut", (x0, y0, ground - 0.3), (x1, y1, floor), "parquet")
    z: Vector = (floor, floor + 2.22)
    gap = door_gap(x - 0.44)
    add_wall(scene, "wall_hut_south", (x0, x1), (y0, y0 + t), z, [gap], "wood")
    add_wall(scene, "wall_hut_north", (x0, x1), (y1 - t, y1), z, [window_gap(x - 0.7)], "wood")
    add_wall(scene, "wall_hut_west", (x0, x0 + t), (y0 + t, y1 - t), z, color="wood")
    add_wall(scene, "wall_hut_east", (x1 - t, x1), (y0 + t, y1 - t), z, color="wood")
    add_hinged_door(scene, "door_hut", "x", gap, y0, -1, "low", ground=floor)
    gable = ((-1.73, 0.0), (1.73, 0.0), (0.0, 0.95))
    add_mesh(scene, "gable", [(u, v, w) for u in (-1.9, 1.9) for v, w in gable])
    roof = add_body(scene.world, "roof_hut", (x, y, z[1]))
    add_geom(roof, "roof_hut_gable", "mesh", "rug", mesh="gable")
    bunk = (x0 + t + 0.03, y0 + t + 0.28, floor)
    add_cupboard(scene, "bunk", bunk, (bunk[0] + 0.73, bunk[1] + 1.92, floor + 0.46))
    stool = add_body(scene.world, "stool", (x + 0.93, y + 0.67, floor))
    add_post(stool, "stool_block", (0, 0), (0, 0.44), 0.19, "wood")


def add_footbridge(scene: Scene) -> None:
    """A deck over the ditch, 1.91 m above its bottom, with a ramp at each end and handrails."""
    (x, y), ground = BRIDGE, BRIDGE_GROUND
    top, half, run, width = 2.01, 1.87, 1.9, 1.26
    bridge = add_body(scene.world, "bridge")
    low, high = (x - half, y - width / 2, top - 0.1), (x + half, y + width / 2, top)
    add_box(bridge, "bridge_deck", low, high, "wood")
    for side, sign in (("west", -1), ("east", 1)):
        foot, edge = (x + sign * (half + run), y, ground), (x + sign * half, y, top)
        add_ramp(bridge, f"bridge_ramp_{side}", foot, edge, width, "wood")
    for side, sign in (("south", -1), ("north", 1)):
        v = y + sign * (width / 2 - 0.03)
        add_railing(scene, f"bridge_railing_{side}", (x - half, v), (x + half, v), top)


# --- clutter -----------------------------------------------------------------------------


def make_clutter() -> dict[str, str]:
    """A mesh of a room of 9.93 × 7.87 m: an open shell, and things that lie about in it."""
    rng = random.Random(5)
    parts = {"shell": make_shell(), "arch": make_arch(), "platform": make_platform()}
    for i, (x, y, yaw) in enumerate(
        ((-3.13, 1.87, 0.0), (-1.37, -2.43, 0.6), (3.33, 2.17, 1.1)), 1
    ):
        parts[f"table_{i}"] = place(make_table(), x, y, yaw)
    for i, (x, y) in enumerate(((-3.67, -0.63), (2.63, -2.87), (0.53, 2.93)), 1):
        ring = trimesh.creation.torus(0.42, 0.11, major_sections=28, minor_sections=14)
        parts[f"torus_{i}"] = drop(ring, x, y, rng)
    for i, (x, y) in enumerate(((-4.17, 3.03), (0.47, -3.03), (4.33, 1.13), (2.13, -1.73)), 1):
        ball = trimesh.creation.icosphere(subdivisions=2, radius=rng.uniform(0.2, 0.45))
        parts[f"ball_{i}"] = drop(ball, x, y, rng)
    for i, (x, y) in enumerate(
        ((-0.83, 3.17), (0.33, 0.63), (2.27, 1.53), (4.43, -3.43), (-1.93, -0.57), (1.93, 3.23)), 1
    ):
        size = [rng.uniform(0.25, 0.75) for _ in range(3)]
        parts[f"box_{i}"] = drop(trimesh.creation.box(size), x, y, rng)
    note = "a cluttered room, z up, metres; the shell is open, single sheets without thickness"
    return {"clutter.obj": write_obj(note, parts)}


def make_shell() -> trimesh.Trimesh:
    """The room's floor, its four walls and a partition with a doorway, as sheets."""
    x, y, h = 4.965, 3.935, 2.8
    a, b, top, at = -0.37, 0.58, 2.07, 1.47  # doorway from a to b in the partition at x = at
    quads = [
        [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)],
        [(-x, -y, 0), (-x, -y, h), (x, -y, h), (x, -y, 0)],
        [(x, y, 0), (x, y, h), (-x, y, h), (-x, y, 0)],
        [(-x, y, 0), (-x, y, h), (-x, -y, h), (-x, -y, 0)],
        [(x, -y, 0), (x, -y, h), (x, y, h), (x, y, 0)],
        [(at, -y, 0), (at, a, 0), (at, a, h), (at, -y, h)],
        [(at, b, 0), (at, y, 0), (at, y, h), (at, b, h)],
        [(at, a, top), (at, b, top), (at, b, h), (at, a, h)],
    ]
    vertices = [vertex for quad in quads for vertex in quad]
    faces = [f for i in range(len(quads)) for f in quad_faces(range(4 * i, 4 * i + 4))]
    return trimesh.Trimesh(vertices, faces, process=False)


def quad_faces(quad: Sequence[int]) -> list[tuple[int, int, int]]:
    a, b, c, d = quad
    return [(a, b, c), (a, c, d)]


def make_arch() -> trimesh.Trimesh:
    """A closed, concave arch over y, 0.6 m deep, 1.84 m wide and 1.95 m high inside."""
    angles = np.linspace(0, math.pi, 17)
    outline = []  # from the foot at +y over the top to the foot at -y, inside and outside
    for radius in (0.92, 1.17):
        curve = [(radius * math.cos(t), 1.03 + radius * math.sin(t)) for t in angles]
        outline.append([(radius, 0.0), *curve, (-radius, 0.0)])
    n = len(outline[0])
    rings = [[(x, u, w) for u, w in curve] for x in (-0.3, 0.3) for curve in outline]
    vertices = np.add([vertex for ring in rings for vertex in ring], (-2.73, -0.04, 0))
    inner, outer, inner_far, outer_far = (range(k * n, k * n + n) for k in range(4))
    faces: list[tuple[int, int, int]] = []
    for a, b in ((inner, outer), (outer, outer_far), (outer_far, inner_far), (inner_far, inner)):
        for i in range(n - 1):
            faces += quad_faces((a[i], b[i], b[i + 1], a[i + 1]))
    for i, flip in ((0, 1), (n - 1, -1)):
        faces += quad_faces((inner[i], inner_far[i], outer_far[i], outer[i])[::flip])
    arch = trimesh.Trimesh(vertices, faces, process=False)
    arch.fix_normals()
    return arch


def make_platform() -> trimesh.Trimesh:
    """A deck at 1.6 m on four legs that one can walk below, and seven steps up to it."""
    parts = [box_mesh((2.63, -1.21, 1.48), (4.57, 0.53, 1.6))]
    for x in (2.66, 4.42):
        parts += [box_mesh((x, y, 0), (x + 0.12, y + 0.12, 1.48)) for y in (-1.18, 0.38)]
    for k in range(1, 8):
        y = -1.21 - (8 - k) * 0.24
        parts.append(box_mesh((3.63, y, 0), (4.53, y + 0.24, 0.2 * k)))
    return join(parts)


def make_table() -> trimesh.Trimesh:
    parts = [box_mesh((-0.7, -0.41, 0.7), (0.7, 0.41, 0.74))]
    for x in (-0.66, 0.6):
        parts += [box_mesh((x, y, 0), (x + 0.06, y + 0.06, 0.7)) for y in (-0.37, 0.31)]
    return join(parts)


def join(parts: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    whole = trimesh.util.concatenate(parts)
    assert isinstance(whole, trimesh.Trimesh)
    return whole


def box_mesh(low: Vector, high: Vector) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=[low, high])


def place(mesh: trimesh.Trimesh, x: float, y: float, yaw: float) -> trimesh.Trimesh:
    mesh.apply_transform(trimesh.transformations.rotation_matrix(yaw, (0, 0, 1)))
    mesh.apply_translation((x, y, 0))
    return mesh


def drop(mesh: trimesh.Trimesh, x: float, y: float, rng: random.Random) -> trimesh.Trimesh:
    """Turn a mesh at random and let its lowest point touch the floor at (x, y)."""
    axis = [rng.uniform(-1, 1) for _ in range(3)]
    turn = trimesh.transformations.rotation_matrix(rng.uniform(0, math.pi), axis)
    mesh.apply_transform(turn)
    mesh.apply_translation((x, y, -mesh.bounds[0][2]))
    return mesh


def write_obj(note: str, parts: dict[str, trimesh.Trimesh]) -> str:
    """Write meshes as one OBJ text, one object each, to a tenth of a millimetre."""
    lines, first = [f"# {note}"], 1
    for name, mesh in parts.items():
        lines.append(f"o {name}")
        lines += [f"v {text(vertex)}" for vertex in mesh.vertices.tolist()]
        lines += ["f {} {} {}".format(*(i + first for i in face)) for face in mesh.faces.tolist()]
        first += len(mesh.vertices)
    return "\n".join(lines) + "\n"


# --- all of them -------------------------------------------------------------------------

MAKERS: dict[str, Callable[[], dict[str, str]]] = {
    "apartment": make_apartment,
    "house": make_house,
    "warehouse": make_warehouse,
    "terrain": make_terrain,
    "clutter": make_clutter,
}


def write_scenes(directory: Path, names: Iterable[str] = MAKERS) -> list[Path]:
    """Make scenes and write their files; return the paths."""
    paths = []
    for name in names:
        for file, content in MAKERS[name]().items():
            path = directory / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content, encoding="utf-8", newline="\n")
            paths.append(path)
    return paths


def main() -> None:
    parser = argparse.ArgumentParser(description="Make the sample scenes.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(MAKERS)}")
    parser.add_argument("-o", "--output", type=Path, default=SCENES, help="directory to write to")
    arguments = parser.parse_args()
    for name in arguments.names:
        if name not in MAKERS:
            parser.error(f"expected a name of {', '.join(MAKERS)}, got {name!r}")
    for path in write_scenes(arguments.output, arguments.names or MAKERS):
        print(f"{path}  {path.stat().st_size:,} bytes")


if __name__ == "__main__":
    main()
