"""Links that are found by what carries agents from storey to storey: ladders and lifts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from typing import NamedTuple

import numpy as np

from navbake.baker.columns.columns import cast_columns, tile_shapes
from navbake.baker.core.constants import BOX
from navbake.baker.core.tolerances import LIMIT_SLACK
from navbake.baker.core.windows import Window
from navbake.baker.geometry.extents import measure_extents
from navbake.baker.links.search import (
    DIRECTIONS,
    CollisionGeometry,
    CollisionShapes,
    Landing,
    LatticeLink,
    LinkSearch,
)
from navbake.baker.scene.cars import VERTICAL, find_lift_joints, measure_car
from navbake.baker.scene.collect import collect_shapes
from navbake.baker.scene.names import all_names, find_subtree_ends, mark_body
from navbake.baker.scene.pose import data_with_joints
from navbake.config.links import LinkSettings
from navbake.navgrid.links import Stop
from navbake.types import Bool, Float, Int

LADDERS = ("*ladder*",)  # bodies and geoms that are ladders, if no patterns are given
LADDER_GAP = 0.6  # between a ladder and where one stands beside it [m]
LIFT_GAP = 0.5  # between the floor of a car and a landing [m]


def find_ladders(search: LinkSearch, rule: LinkSettings) -> list[LatticeLink]:
    """Find the ladders: bodies or geoms whose names match, which reach from floor to floor.

    A ladder stops on each level that has a free cell within the gap [m] of its box, from above,
    whose floor lies between a step below its foot and a step above its top: at the nearest one. It
    is as wide as its box, seen from above.
    """
    model = search.scene.model
    names = all_names(search.scene.model)
    patterns = rule.patterns or LADDERS
    gap = LADDER_GAP if rule.gap is None else rule.gap
    things = list[tuple[str, Bool]]()
    ends = find_subtree_ends(model)
    taken = set[int]()
    bodies = [(name, mark_body(model, k, int(ends[k]))) for k, name in enumerate(names.bodies)][1:]
    geoms = [(own.geom, np.arange(model.ngeom) == k) for k, own in enumerate(names.geoms)]
    for name, mask in bodies + geoms:
        own = set(np.flatnonzero(mask).tolist())
        if own and not own & taken and any(fnmatchcase(name, pattern) for pattern in patterns):
            things.append((name, mask))
            taken |= own
    links = []
    for name, mask in things:
        box = search.shapes.only(mask).bounds
        if box is None:
            continue
        if len(stops := list(_stops_beside(box, gap, search))) > 1:
            width = round(float(np.diff(box[:, :2], axis=0).max()), 6)
            links.append(LatticeLink(stops, {"name": name, "width": width}))
    return links


def _stops_beside(box: Float, gap: float, search: LinkSearch) -> Iterator[Stop]:
    """The nearest free cell to a box on each level whose floors it reaches."""
    (x0, y0, low), (x1, y1, high) = box.tolist()
    x = search.lattice.center_x()
    y = search.lattice.center_y()[:, None]
    off = np.hypot(np.clip(x, x0, x1) - x, np.clip(y, y0, y1) - y)
    for level, (floor, free) in enumerate(zip(search.floors, search.free, strict=True)):
        here = free & (off <= gap + LIMIT_SLACK)
        here &= (floor >= low - search.step) & (floor <= high + search.step)
        if here.any():
            yield search.stop(level, int(np.argmin(np.where(here, np.round(off, 9), np.inf))))


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


def find_lifts(search: LinkSearch, rule: LinkSettings) -> list[LatticeLink]:
    """Find the lifts: bodies with one vertical slide joint whose floor meets two levels or more.

    The car stops where a straight way leads from its floor to a free cell beside it, over a gap up
    to the rule's [m] and up or down a step at most, with the car at that height and nothing in the
    way; on each level once at each of its sides, in the middle. A lift is as wide as its floor, or
    the narrowest way out of it.
    """
    links = []
    gap = LIFT_GAP if rule.gap is None else rule.gap
    for car in _find_cars(search, rule.patterns or ("*",), gap):
        stops = list[Stop]()
        width = car.width
        for level in range(len(search.floors)):
            land = _landing(car, level, search)
            found = search.look_out((level, car.floor), range(len(DIRECTIONS)), gap, land)
            found["z"] = np.clip(found["other_z"], car.low, car.high)
            for group, *_ in search.group(found):
                group["z"] = np.median(group["z"])
                clear = group[search.are_clear(group, _space_at(car, group["z"][0], search))]
                if len(clear):
                    _, middle, out = max(search.group(clear), key=lambda part: len(part[0]))
                    width = min(width, out)
                    way = int(middle["way"])
                    cell = int(middle["other_cell"])
                    stops.append(search.stand_back(level, cell, way, min(car.width, out)))
        if len({stop.level for stop in stops}) > 1:
            stops.sort(key=lambda stop: (stop.level, stop.position[2], stop.cell))
            fields = {"name": car.name, "width": round(width, 6), "car": car.place}
            links.append(LatticeLink(stops, fields))
    return links


def _landing(car: Car, level: int, search: LinkSearch) -> Landing:
    """Whether one lands on a level, beside the car."""

    def land(rows: Int, cols: Int, _z: Float, _between: int) -> tuple[Int, Bool, Bool]:
        floor = search.floors[level, rows, cols]
        lands = np.abs(floor - np.clip(floor, car.low, car.high)) <= search.step
        lands &= search.free[level, rows, cols] & ~car.outline[rows, cols]
        return np.full(len(rows), level), lands, ~car.floor[rows, cols]

    return land


def _find_cars(search: LinkSearch, patterns: Sequence[str], gap: float) -> Iterator[Car]:
    scene = search.scene
    lattice = search.lattice
    model = scene.model
    names = all_names(model).bodies
    ends = find_subtree_ends(model)
    for joint in find_lift_joints(model, scene.data, patterns):
        body = int(model.jnt_bodyid[joint])
        own = mark_body(model, body, int(ends[body]))
        shapes = search.shapes.only(own)
        bounds = shapes.bounds
        window = None if bounds is None else lattice.window(bounds, gap + lattice.cell_size)
        if body not in scene.cars or bounds is None or window is None:
            continue
        part = lattice.cut(*window)
        car_floor = measure_car(shapes, part, search.agent)
        if car_floor is None:
            continue
        floor, outline = np.zeros((2, *lattice.shape), dtype=np.bool_)
        for mask, cells in ((floor, car_floor.cells), (outline, car_floor.outline)):
            mask[window][np.divmod(cells, part.width)] = True
        carrier = car_floor.carrier
        width = float(measure_extents(shapes, model.ngeom).thin[carrier])
        axis = float(scene.data.xaxis[joint, 2])
        now = float(scene.data.qpos[model.jnt_qposadr[joint]])
        reach = model.jnt_range[joint].tolist()
        low, high = sorted(car_floor.height + axis * (end - now) for end in reach)
        # where it stands: by its floor's frame if that is an upright box, else by its bounds
        middle = bounds.mean(axis=0)
        yaw = 0.0
        size = np.diff(bounds, axis=0)[0]
        turn = scene.data.geom_xmat[carrier]
        if model.geom_type[carrier] == BOX and turn[8] >= VERTICAL:
            middle = scene.data.geom_xpos[carrier]
            size = 2.0 * model.geom_size[carrier]
            yaw = float(np.arctan2(turn[3], turn[0]))
        place = (round(float(v), 6) + 0.0 for v in (middle[0], middle[1], yaw, size[0], size[1]))
        yield Car(
            name=names[body],
            joint=joint,
            geoms=own,
            window=window,
            floor=floor,
            outline=outline,
            z=car_floor.height,
            low=low,
            high=high,
            width=width,
            place=tuple(place),
        )


def _space_at(car: Car, height: float, search: LinkSearch) -> CollisionGeometry:
    """The geometry round a car when its floor is at a height."""
    scene = search.scene
    model = scene.model
    axis = float(scene.data.xaxis[car.joint, 2])
    position = float(scene.data.qpos[model.jnt_qposadr[car.joint]]) + axis * (height - car.z)
    data = data_with_joints(model, scene.data, {car.joint: position})
    kinds = search.shapes.solids, search.shapes.planes, search.shapes.meshes
    known = np.unique(np.concatenate([kind.geom for kind in kinds]))
    moved, *_ = collect_shapes(
        model,
        data,
        selections=scene.selections,
        exact_meshes=scene.exact_meshes,
        only=known[car.geoms[known]].tolist(),
        meshes=scene.meshes,
    )
    footprint = search.geometry.footprint
    tiled = tile_shapes(
        search.shapes.replaced(moved, car.geoms),
        search.lattice.cut(*car.window),
        footprint.reach,
    )
    return CollisionGeometry([CollisionShapes(cast_columns(tiled), tiled)], footprint, car.window)
