"""Links that are found by what carries agents from storey to storey: ladders and lifts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import numpy as np

from navbake.baker.columns import cast_columns, tile_shapes
from navbake.baker.kernels.constants import BOX, SLACK, SLIDE
from navbake.baker.lattice import Window
from navbake.baker.scene.collect import collect_shapes
from navbake.baker.scene.extents import measure_geoms
from navbake.baker.scene.names import all_names, find_subtree_ends, geoms_of_bodies
from navbake.baker.scene.pose import data_with_joints
from navbake.baker.traffic.ground import WAYS, Ground, Landing, MadeLink, Space
from navbake.config.traffic import LinkSettings
from navbake.navgrid.links import Stop
from navbake.types import Bool, Float, Int

LADDERS = ("*ladder*",)  # bodies and geoms that are ladders, if no patterns are given
LADDER_GAP = 0.6  # between a ladder and where one stands beside it [m]
LIFT_GAP = 0.5  # between the floor of a car and a landing [m]
UPRIGHT = 0.999  # cosine of a lift's joint with the vertical
LEAST_CAR = 0.25  # area of a car's floor [m²]
FLAT = 0.01  # of a car's floor, from its height [m]


def find_ladders(ground: Ground, rule: LinkSettings) -> list[MadeLink]:
    """Find the ladders: bodies or geoms whose names match, which reach from floor to floor.

    A ladder stops on each level that has a free cell within the gap [m] of its box, from above,
    whose floor lies between a step below its foot and a step above its top: at the nearest one. It
    is as wide as its box, seen from above.
    """
    model, names = ground.scene.model, all_names(ground.scene.model)
    patterns, gap = rule.patterns or LADDERS, LADDER_GAP if rule.gap is None else rule.gap
    things, ends, taken = list[tuple[str, Bool]](), find_subtree_ends(model), set[int]()
    bodies = [(name, _mark_body(model, k, int(ends[k]))) for k, name in enumerate(names.bodies)][1:]
    geoms = [(own.geom, np.arange(model.ngeom) == k) for k, own in enumerate(names.geoms)]
    for name, mask in bodies + geoms:
        own = set(np.flatnonzero(mask).tolist())
        if own and not own & taken and any(fnmatchcase(name, pattern) for pattern in patterns):
            things.append((name, mask))
            taken |= own
    links = []
    for name, mask in things:
        box = ground.scene.shapes.only(mask).bounds
        if box is None:
            continue
        if len(stops := list(_stops_beside(box, gap, ground))) > 1:
            width = round(float(np.diff(box[:, :2], axis=0).max()), 6)
            links.append(MadeLink(stops, {"name": name, "width": width}))
    return links


def _mark_body(model: Any, first: int, end: int) -> Bool:
    """The geoms of the bodies from `first` to before `end`, shape (ngeom,)."""
    mask = np.zeros(model.ngeom, dtype=np.bool_)
    mask[geoms_of_bodies(model, first, end)] = True
    return mask


def _stops_beside(box: Float, gap: float, ground: Ground) -> Iterator[Stop]:
    """The nearest free cell to a box on each level whose floors it reaches."""
    (x0, y0, low), (x1, y1, high) = box.tolist()
    x, y = ground.lattice.center_x(), ground.lattice.center_y()[:, None]
    off = np.hypot(np.clip(x, x0, x1) - x, np.clip(y, y0, y1) - y)
    for level, (floor, free) in enumerate(zip(ground.floors, ground.free, strict=True)):
        here = free & (off <= gap + SLACK)
        here &= (floor >= low - ground.step) & (floor <= high + ground.step)
        if here.any():
            yield ground.stop(level, int(np.argmin(np.where(here, np.round(off, 9), np.inf))))


class Car(NamedTuple):
    """The car of a lift."""

    name: str
    joint: int
    geoms: Bool  # which are its own, shape (ngeom,)
    window: Window  # of the lattice, round the car and its landings
    floor: Bool  # which cells of the lattice its floor covers
    outline: Bool  # and anything of it
    z: float  # height of its floor now [m]
    low: float  # lowest and highest height of its floor [m]
    high: float
    width: float  # of its floor [m]
    place: tuple[float, ...]  # x, y of its middle [m], yaw [rad], width along it and depth [m]


def find_lifts(ground: Ground, rule: LinkSettings) -> list[MadeLink]:
    """Find the lifts: bodies with one vertical slide joint whose floor meets two levels or more.

    The car stops where a straight way leads from its floor to a free cell beside it, over a gap up
    to the rule's [m] and up or down a step at most, with the car at that height and nothing in the
    way; on each level once at each of its sides, in the middle. A lift is as wide as its floor, or
    the narrowest way out of it.
    """
    links, gap = [], LIFT_GAP if rule.gap is None else rule.gap
    for car in _find_cars(ground, rule.patterns or ("*",), gap):
        stops, width = list[Stop](), car.width
        for level in range(len(ground.floors)):
            land = _landing(car, level, ground)
            found = ground.look_out((level, car.floor), range(len(WAYS)), gap, land)
            found["z"] = np.clip(found["other_z"], car.low, car.high)
            for group, *_ in ground.group(found):
                group["z"] = np.median(group["z"])
                clear = group[ground.are_clear(group, _space_at(car, group["z"][0], ground))]
                if len(clear):
                    _, middle, out = max(ground.group(clear), key=lambda part: len(part[0]))
                    width = min(width, out)
                    way, cell = int(middle["way"]), int(middle["other_cell"])
                    stops.append(ground.stand_back(level, cell, way, min(car.width, out)))
        if len({stop.level for stop in stops}) > 1:
            stops.sort(key=lambda stop: (stop.level, stop.position[2], stop.cell))
            fields = {"name": car.name, "width": round(width, 6), "car": car.place}
            links.append(MadeLink(stops, fields))
    return links


def _landing(car: Car, level: int, ground: Ground) -> Landing:
    """Whether one lands on a level, beside the car."""

    def land(rows: Int, cols: Int, _z: Float, _between: int) -> tuple[Int, Bool, Bool]:
        floor = ground.floors[level, rows, cols]
        lands = np.abs(floor - np.clip(floor, car.low, car.high)) <= ground.step
        lands &= ground.free[level, rows, cols] & ~car.outline[rows, cols]
        return np.full(len(rows), level), lands, ~car.floor[rows, cols]

    return land


def _find_cars(ground: Ground, patterns: Sequence[str], gap: float) -> Iterator[Car]:
    scene, lattice, model = ground.scene, ground.lattice, ground.scene.model
    names, ends = all_names(model).bodies, find_subtree_ends(model)
    slides = (model.jnt_type == SLIDE) & np.asarray(model.jnt_limited, np.bool_)
    slides &= model.body_jntnum[model.jnt_bodyid] == 1
    slides &= np.abs(scene.data.xaxis[:, 2]) > UPRIGHT
    for joint in np.flatnonzero(slides).tolist():
        body, axis = int(model.jnt_bodyid[joint]), float(scene.data.xaxis[joint, 2])
        if not any(fnmatchcase(names[body], pattern) for pattern in patterns):
            continue
        own = _mark_body(model, body, int(ends[body]))
        shapes = scene.shapes.only(own)
        bounds = shapes.bounds
        window = None if bounds is None else lattice.window(bounds, gap + lattice.cell_size)
        if bounds is None or window is None:
            continue
        part = lattice.cut(*window)
        columns = cast_columns(tile_shapes(shapes, part, 0.0))
        cell, z = np.repeat(np.arange(part.width * part.height), np.diff(columns.start)), columns.z
        # up to what is next above it in its column
        is_last = np.append(cell, -1)[1:] != cell
        headroom = np.where(is_last, np.inf, np.append(z, np.inf)[1:] - z)
        flat = columns.normal[:, 2] >= np.cos(np.radians(ground.agent.max_slope)) - SLACK
        flat &= headroom >= ground.agent.height - SLACK
        heights, count = np.unique(np.round(z[flat], 3), return_counts=True)
        # the lowest of those that are large: not the roof of the car
        height = heights[2 * count >= count.max(initial=0)].min(initial=np.inf)
        flat &= np.abs(z - height) <= FLAT
        if np.count_nonzero(flat) * lattice.cell_size**2 < LEAST_CAR:
            continue
        floor, outline = np.zeros((2, *lattice.shape), dtype=np.bool_)
        for mask, cells in ((floor, cell[flat]), (outline, cell)):
            mask[window][np.divmod(cells, part.width)] = True
        carrier = int(np.bincount(columns.geom[flat]).argmax())
        width = float(measure_geoms(shapes, model.ngeom).thin[carrier])
        now, top = float(scene.data.qpos[model.jnt_qposadr[joint]]), float(z[flat].max())
        low, high = sorted(top + axis * (end - now) for end in model.jnt_range[joint].tolist())
        # where it stands: by its floor's frame if that is an upright box, else by its bounds
        middle, yaw, size = bounds.mean(axis=0), 0.0, np.diff(bounds, axis=0)[0]
        turn = scene.data.geom_xmat[carrier]
        if model.geom_type[carrier] == BOX and turn[8] >= UPRIGHT:
            middle, size = scene.data.geom_xpos[carrier], 2.0 * model.geom_size[carrier]
            yaw = float(np.arctan2(turn[3], turn[0]))
        place = (round(float(v), 6) + 0.0 for v in (middle[0], middle[1], yaw, size[0], size[1]))
        cells = window, floor, outline
        yield Car(names[body], joint, own, *cells, top, low, high, width, tuple(place))


def _space_at(car: Car, height: float, ground: Ground) -> Space:
    """The geometry round a car when its floor is at a height."""
    scene, model = ground.scene, ground.scene.model
    axis = float(scene.data.xaxis[car.joint, 2])
    position = float(scene.data.qpos[model.jnt_qposadr[car.joint]]) + axis * (height - car.z)
    data = data_with_joints(model, scene.data, {car.joint: position})
    kinds = scene.shapes.solids, scene.shapes.planes, scene.shapes.meshes
    known = np.unique(np.concatenate([kind.geom for kind in kinds]))
    chosen = scene.choices, scene.parts, known[car.geoms[known]].tolist(), scene.meshes
    moved, *_ = collect_shapes(model, data, *chosen)
    lattice, footprint = ground.lattice.cut(*car.window), ground.space.footprint
    tiled = tile_shapes(scene.shapes.replaced(moved, car.geoms), lattice, footprint.reach)
    return Space(cast_columns(tiled), tiled, footprint, car.window)
