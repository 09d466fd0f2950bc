"""Scenes as lists of things: their MJCF, and what each is in exact geometry."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from oracles.prisms import FREE, OCCUPIED, UNKNOWN, Prisms, body_meets_prisms
from oracles.solids import Body, Capsule, Cylinder, Ellipsoid, Float, Polytope, rotation
from oracles.surfaces import Surface, surface_meets_prisms

BESIDE_BOX = 1e-4  # a line farther than this beside a box misses it, whatever is rounded [m]
NUDGE = 2e-6  # a line this near to a rim may be on either side of it [m]
NUDGES = [(NUDGE * np.cos(turn), NUDGE * np.sin(turn)) for turn in np.arange(8) * np.pi / 4 + 0.1]


@dataclass(frozen=True)
class Thing:
    """One geom.

    Attributes:
        kind: MuJoCo's name of its type; for meshes "hull", "closed" or "open".
        size: MuJoCo's sizes [m]; none for planes (which are infinite) and meshes.
        pos: [m].
        quat: w, x, y, z.
        vertices: of meshes, in the geom's frame [m].
        faces: of meshes, counter-clockwise from outside; a hull needs none.
    """

    kind: str
    size: tuple[float, ...]
    pos: tuple[float, float, float]
    quat: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    vertices: tuple[tuple[float, float, float], ...] = ()
    faces: tuple[tuple[int, int, int], ...] = ()

    @property
    def is_mesh(self) -> bool:
        return self.kind in ("hull", "closed", "open")


def scene_xml(things: list[Thing]) -> str:
    """The things as an MJCF scene."""
    assets, geoms = [], []
    for i, thing in enumerate(things):
        place = f'pos="{_text(thing.pos)}" quat="{_text(thing.quat)}"'
        if thing.is_mesh:
            vertices = _text(np.ravel(thing.vertices))
            faces = " ".join(str(v) for face in thing.faces for v in face)
            faces = f'face="{faces}"' if faces else ""
            assets.append(f'<mesh name="m{i}" inertia="shell" vertex="{vertices}" {faces}/>')
            contact = "" if thing.kind == "hull" else ' contype="0" conaffinity="0"'
            geoms.append(f'<geom type="mesh" mesh="m{i}" {place}{contact}/>')
        else:
            size = _text(thing.size if thing.kind != "plane" else (0, 0, 1))
            geoms.append(f'<geom type="{thing.kind}" size="{size}" {place}/>')
    body = "\n".join(geoms)
    return f"<mujoco><asset>{''.join(assets)}</asset><worldbody>\n{body}\n</worldbody></mujoco>"


def _text(numbers: object) -> str:
    return " ".join(repr(float(n)) for n in np.ravel(numbers))


@dataclass(frozen=True)
class HalfSpace:
    """What lies behind an infinite plane."""

    pos: Float
    normal: Float


Part = Body | HalfSpace | Surface


def part_of(thing: Thing) -> Part:
    """A thing's exact geometry in the world frame."""
    pos, rot = np.array(thing.pos), rotation(thing.quat)
    size = np.array(thing.size)
    if thing.kind == "plane":
        return HalfSpace(pos, rot[:, 2])
    if thing.kind == "box":
        return Polytope.box(pos, rot, size)
    if thing.kind == "sphere":
        return Ellipsoid(pos, rot, np.full(3, size[0]))
    if thing.kind == "ellipsoid":
        return Ellipsoid(pos, rot, size)
    if thing.kind == "cylinder":
        return Cylinder(pos, rot, float(size[0]), float(size[1]))
    if thing.kind == "capsule":
        return Capsule(pos, rot, float(size[0]), float(size[1]))
    world = np.array(thing.vertices) @ rot.T + pos
    if thing.kind == "hull":
        return Polytope.hull(world)
    return Surface(world[np.array(thing.faces)], closed=thing.kind == "closed")


def widen(thing: Thing, margin: float) -> Thing:
    """An upright box or cylinder, wider on all sides but not higher."""
    if thing.kind == "box":
        return replace(thing, size=(thing.size[0] + margin, thing.size[1] + margin, thing.size[2]))
    if thing.kind == "cylinder":
        return replace(thing, size=(thing.size[0] + margin, thing.size[1]))
    return thing


@dataclass(frozen=True)
class PartColumns:
    """One part's hits of n vertical lines.

    Attributes:
        z: heights, shape (m, n), NaN for none [m].
        up: z of the unit normals there, shape (m, n).
        low, high: the stretches inside of it, shape (k, n), NaN for none [m].
        is_solid: whether what stands on a surface exactly covers it.
    """

    z: Float
    up: Float
    low: Float
    high: Float
    is_solid: bool


def cross_part(part: Part, x: Float, y: Float) -> PartColumns:
    """Cross a part with the vertical lines at x, y."""
    if isinstance(part, HalfSpace):
        return _cross_half_space(part, x, y)
    near = np.flatnonzero(_is_near(part, x, y))
    columns = _cross_near(part, x[near], y[near])
    return PartColumns(
        z=_spread(columns.z, near, len(x)),
        up=_spread(columns.up, near, len(x)),
        low=_spread(columns.low, near, len(x)),
        high=_spread(columns.high, near, len(x)),
        is_solid=columns.is_solid,
    )


def _is_near(part: Body | Surface, x: Float, y: Float) -> np.ndarray:
    """The lines through the box round a part, or close beside it: all others miss the part."""
    ways = np.array([[1.0, 0, 0], [0, 1.0, 0], [-1.0, 0, 0], [0, -1.0, 0]])
    if isinstance(part, Surface):
        reach = (part.corners.reshape(-1, 3) @ ways.T).max(axis=0, initial=-np.inf)
    else:
        reach = part.support(ways)
    east, north, west, south = reach + BESIDE_BOX  # to the west and south, -x and -y grow
    near: np.ndarray = (x <= east) & (y <= north) & (-x <= west) & (-y <= south)
    return near


def _spread(values: Float, lines: np.ndarray, num_lines: int) -> Float:
    """Values at some lines, shape (m, k), as values at all lines, NaN at the others."""
    spread = np.full((len(values), num_lines), np.nan)
    spread[:, lines] = values
    return spread


def _cross_near(part: Body | Surface, x: Float, y: Float) -> PartColumns:
    """Cross a part with lines, each of which may meet it."""
    if isinstance(part, Surface):
        return _cross_surface(part, x, y)
    line = part.cross(x, y)
    return PartColumns(
        np.stack([line.low, line.high]),
        np.stack([line.low_up, line.high_up]),
        line.low[None],
        line.high[None],
        True,
    )


def _cross_half_space(part: HalfSpace, x: Float, y: Float) -> PartColumns:
    nx, ny, nz = part.normal
    out = nx * (x - part.pos[0]) + ny * (y - part.pos[1])
    everywhere = np.full_like(x, np.inf)
    if abs(nz) < 1e-12:
        inside = np.where(out < 0, everywhere, np.nan)
        return PartColumns(
            np.zeros((0, len(x))), np.zeros((0, len(x))), -inside[None], inside[None], True
        )
    z = part.pos[2] - out / nz
    low, high = (-everywhere, z) if nz > 0 else (z, everywhere)
    return PartColumns(z[None], np.full((1, len(x)), nz), low[None], high[None], True)


def _cross_surface(part: Surface, x: Float, y: Float) -> PartColumns:
    z, up = part.cross(x, y)
    order = np.argsort(z, axis=0)  # NaN last
    z, up = np.take_along_axis(z, order, axis=0), np.take_along_axis(up, order, axis=0)
    most = int((~np.isnan(z)).sum(axis=0).max(initial=0))
    z, up = z[:most], up[:most]
    low, high = np.zeros((0, len(x))), np.zeros((0, len(x)))
    if part.closed:
        if (np.isnan(z).sum(axis=0) % 2 != most % 2).any():
            z = z.copy()
            z[0] = np.where(np.isnan(z).sum(axis=0) % 2 != most % 2, np.inf, z[0])  # unsure
        pairs = most // 2 * 2
        low, high = z[0:pairs:2], z[1:pairs:2]
    return PartColumns(z, up, low, high, False)


def cross_all(
    parts: list[Part], x: Float, y: Float, min_normal_z: float
) -> tuple[list[PartColumns], np.ndarray]:
    """Cross all parts, and mark the lines that are too near to a rim to tell, shape (n,), bool."""
    columns = [cross_part(part, x, y) for part in parts]
    unsure = np.zeros(len(x), dtype=bool)
    for part, column in zip(parts, columns, strict=True):
        is_steep = (column.up > min_normal_z - 2e-6) & (column.up < min_normal_z - 1e-7)
        unsure |= (np.isinf(column.z) | is_steep).any(axis=0)
        if isinstance(part, HalfSpace):
            continue
        # lines that are not near miss the part, and so do those beside them
        near = np.flatnonzero(_is_near(part, x, y))
        crosses = ~np.isnan(column.z[:, near])
        faces_up = crosses & (column.up[:, near] >= min_normal_z)
        for dx, dy in NUDGES:
            nearby = _cross_near(part, x[near] + dx, y[near] + dy)
            if nearby.z.shape != crosses.shape:
                return columns, np.ones(len(x), dtype=bool)
            crosses_nearby = ~np.isnan(nearby.z)
            differs = crosses != crosses_nearby
            differs |= faces_up != (crosses_nearby & (nearby.up >= min_normal_z))
            unsure[near] |= differs.any(axis=0)
    return columns, unsure


def part_meets_prisms(part: Part, column: PartColumns, prisms: Prisms) -> np.ndarray:
    """FREE, OCCUPIED or UNKNOWN for each prism; `column` is the part's along the prisms' axes."""
    if isinstance(part, HalfSpace):
        inward = np.tile(-part.normal, (len(prisms.x), 1))
        depth = prisms.support(inward) + part.pos @ part.normal
        # a shrunk prism's support is less by its margin times the normal's L1 or L2 norm
        state = np.where(depth > 2e-6, OCCUPIED, UNKNOWN)
        return np.where(depth < 2e-7, FREE, state)
    if isinstance(part, Surface):
        state = surface_meets_prisms(part, prisms)
        inside = ((column.low < prisms.low) & (column.high > prisms.high)).any(axis=0)
        return np.where(inside, OCCUPIED, state)
    return body_meets_prisms(part, prisms)
