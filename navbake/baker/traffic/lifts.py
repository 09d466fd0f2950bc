"""Links that are found by what carries agents from storey to storey: ladders and lifts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import numpy as np

from navbake.baker.columns import cast_columns, tile_shapes
from navbake.baker.kernels.constants import BOX, SLACK, SLIDE
from navbake.baker.lattice import Window
from navbake.baker.scene.extents import measure_geoms
from navbake.baker.scene.names import all_names, find_subtree_ends, geoms_of_bodies
from navbake.baker.scene.scene import Scene
from navbake.baker.scene.shapes import Shapes
from navbake.baker.traffic.ground import (
    WAYS,
    Ground,
    Leaps,
    MadeLink,
    Space,
    group_leaps,
    middle_of,
)
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
    model, patterns = ground.scene.model, tuple(rule.patterns) or LADDERS
    names = all_names(model)
    matches = [any(fnmatchcase(name, p) for p in patterns) for name in names.bodies]
    ends, whole = find_subtree_ends(model), list[tuple[str, Int]]()
    taken = np.zeros(model.ngeom, dtype=np.bool_)
    for body in range(1, model.nbody):
        own = geoms_of_bodies(model, body, int(ends[body])) if matches[body] else np.empty(0, int)
        if len(own) and not taken[own].any():
            whole.append((names.bodies[body], own))
            taken[own] = True
    for geom, named in enumerate(names.geoms):
        if not taken[geom] and any(fnmatchcase(named.geom, p) for p in patterns):
            whole.append((named.geom, np.array([geom])))
    gap, links = LADDER_GAP if rule.gap is None else rule.gap, []
    for name, geoms in whole:
        box = ground.scene.shapes.only(_mark(geoms, model.ngeom)).bounds
        stops = [] if box is None else list(_stops_beside(box, gap, ground))
        if box is not None and len(stops) > 1:
            width = round(float(np.diff(box[:, :2], axis=0).max()), 6)
            links.append(MadeLink(stops, {"name": name, "width": width}))
    return links


def _mark(geoms: Int, count: int) -> Bool:
    mask = np.zeros(count, dtype=np.bool_)
    mask[geoms] = True
    return mask


def _stops_beside(box: Float, gap: float, ground: Ground) -> Iterator[Stop]:
    """The nearest free cell to a box on each level whose floors it reaches."""
    window = ground.lattice.window(box, gap)
    if window is None:
        return
    x, y = ground.lattice.center_x()[window[1]], ground.lattice.center_y()[window[0]]
    off = np.hypot(
        np.maximum(0, np.maximum(box[0, 0] - x, x - box[1, 0]))[None, :],
        np.maximum(0, np.maximum(box[0, 1] - y, y - box[1, 1]))[:, None],
    )
    for level in range(len(ground.floors)):
        floor = ground.floors[level][window]
        low, high = box[0, 2] - ground.step, box[1, 2] + ground.step
        here = ground.free[level][window] & (floor >= low) & (floor <= high) & (off <= gap + SLACK)
        if here.any():
            row, col = np.unravel_index(int(np.argmin(np.where(here, off, np.inf))), off.shape)
            row, col = int(row) + window[0].start, int(col) + window[1].start
            yield ground.stop(level, row * ground.lattice.width + col)


class Car(NamedTuple):
    """The car of a lift, on a part of the lattice."""

    name: str
    shapes: Shapes  # where it is now
    others: Shapes  # the scene without it
    window: Window
    floor: Bool  # which cells of the window its floor covers
    outline: Bool  # which cells anything of it covers
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
    links = []
    gap = LIFT_GAP if rule.gap is None else rule.gap
    for car in _find_cars(ground, tuple(rule.patterns) or ("*",), gap):
        stops, widths = list[Stop](), [car.width]
        found = _find_ways_out(car, ground, gap)
        for group in group_leaps(found, ground):
            own = Leaps._make(array[group] for array in found)
            clear = own.only(_are_clear(own, car, ground))
            if len(clear.cell):
                k = middle_of(clear.other_cell, ground.lattice)
                width = min(car.width, ground.width_of(clear.cell))
                level, cell = int(clear.other_level[k]), int(clear.other_cell[k])
                cell = ground.stand_back(level, cell, int(clear.way[k]), width)
                stops.append(ground.stop(level, cell))
                widths.append(width)
        if len({stop.level for stop in stops}) > 1:
            stops.sort(key=lambda stop: (stop.level, stop.position[2], stop.cell))
            fields = {"name": car.name, "width": round(min(widths), 6), "car": car.place}
            links.append(MadeLink(stops, fields))
    return links


def _find_cars(ground: Ground, patterns: Sequence[str], gap: float) -> Iterator[Car]:
    scene, lattice = ground.scene, ground.lattice
    model: Any = scene.model
    names, ends = all_names(model).bodies, find_subtree_ends(model)
    joints = np.flatnonzero((model.jnt_type == SLIDE) & np.asarray(model.jnt_limited, np.bool_))
    for joint in joints.tolist():
        body, axis = int(model.jnt_bodyid[joint]), float(scene.data.xaxis[joint, 2])
        is_named = any(fnmatchcase(names[body], pattern) for pattern in patterns)
        if model.body_jntnum[body] != 1 or abs(axis) < UPRIGHT or not is_named:
            continue
        own = _mark(geoms_of_bodies(model, body, int(ends[body])), model.ngeom)
        shapes = scene.shapes.only(own)
        bounds = shapes.bounds
        window = None if bounds is None else lattice.window(bounds, gap + lattice.cell_size)
        if window is None:
            continue
        columns = cast_columns(tile_shapes(shapes, lattice.cut(*window), 0.0))
        start, z, geom = columns.start, columns.z, columns.geom
        cell = np.repeat(np.arange(len(start) - 1), np.diff(start))
        is_last = np.append(cell[1:] != cell[:-1], True)[: len(cell)]
        headroom = np.where(is_last, np.inf, np.append(z[1:], np.inf)[: len(z)] - z)
        up = np.cos(np.radians(ground.agent.max_slope)) - SLACK
        flat = np.flatnonzero(
            (columns.normal[:, 2] >= up) & (headroom >= ground.agent.height - SLACK)
        )
        if not len(flat):
            continue
        heights, count = np.unique(np.round(z[flat], 3), return_counts=True)
        level = float(heights[np.argmax(2 * count >= count.max())])  # not the roof of the car
        flat = flat[np.abs(z[flat] - level) <= FLAT]
        if len(flat) * lattice.cell_size**2 < LEAST_CAR:
            continue
        top = float(np.max(z[flat]))
        floor, outline = np.zeros((2, len(start) - 1), dtype=np.bool_)
        floor[cell[flat]], outline[cell] = True, True
        shape = ground.lattice.cut(*window).shape
        carrier = int(np.bincount(geom[flat]).argmax())
        width = float(measure_geoms(shapes, model.ngeom).thin[carrier])
        position = float(scene.data.qpos[model.jnt_qposadr[joint]])
        low, high = sorted(top + axis * (end - position) for end in model.jnt_range[joint])
        yield Car(
            names[body], shapes, scene.shapes.only(~own), window,
            floor.reshape(shape), outline.reshape(shape), top, low, high, width,
            _place_of(scene, carrier, shapes),
        )  # fmt: skip


def _place_of(scene: Scene, geom: int, shapes: Shapes) -> tuple[float, ...]:
    """Where a car stands: by its floor's frame if that is an upright box, else by its bounds."""
    model, data = scene.model, scene.data
    middle, turn = data.geom_xpos[geom], data.geom_xmat[geom]
    if model.geom_type[geom] == BOX and turn[8] >= UPRIGHT:
        yaw, size = float(np.arctan2(turn[3], turn[0])), 2.0 * model.geom_size[geom]
    else:
        assert shapes.bounds is not None
        middle, yaw, size = shapes.bounds.mean(axis=0), 0.0, np.diff(shapes.bounds, axis=0)[0]
    found = (middle[0], middle[1], yaw, size[0], size[1])
    return tuple(round(float(value), 6) + 0.0 for value in found)


def _find_ways_out(car: Car, ground: Ground, gap: float) -> Leaps:
    """The ways from the car's floor to the first free cells beside it, on levels that it reaches.

    Their starts are at the height of the landing, as far as the car goes.
    """
    (rows, cols), width = car.window, ground.lattice.width
    height, wide = car.floor.shape
    parts = list[Leaps]()
    for level in range(len(ground.floors)):
        floor, free = ground.floors[level][rows, cols], ground.free[level][rows, cols]
        reach = np.clip(floor, car.low, car.high)
        with np.errstate(invalid="ignore"):
            lands_on = free & ~car.outline & (np.abs(floor - reach) <= ground.step)
        for way, (down, right) in enumerate(WAYS):
            row, col = np.nonzero(car.floor)
            # the last cell of the car's floor on the way
            beyond = np.pad(car.floor, 1)[row + 1 + down, col + 1 + right]
            row, col = row[~beyond], col[~beyond]
            for num_between in range(ground.cells_in(gap) + 1):
                r, c = row + (num_between + 1) * down, col + (num_between + 1) * right
                inside = (r >= 0) & (r < height) & (c >= 0) & (c < wide)
                row, col, r, c = (array[inside] for array in (row, col, r, c))
                lands = lands_on[r, c]
                one = (row[lands] + rows.start) * width + col[lands] + cols.start
                other = (r[lands] + rows.start) * width + c[lands] + cols.start
                count, z = len(one), floor[r[lands], c[lands]]
                same = np.full(count, level)
                parts.append(
                    Leaps(
                        np.full(count, way), same, one, same, other,
                        np.full(count, num_between), np.clip(z, car.low, car.high), z,
                    )
                )  # fmt: skip
                row, col = row[~lands], col[~lands]
    return Leaps.join(parts)


def _are_clear(group: Leaps, car: Car, ground: Ground) -> Bool:
    """Whether nothing stands in the ways out of a car, which stops at their middle height."""
    (rows, cols), width = car.window, ground.lattice.width
    stop = float(np.median(group.z))
    moved = _lifted(car.shapes, stop - car.z)
    shapes = _together(car.others, moved)
    cut = ground.lattice.cut(*car.window)
    space = Space.of(shapes, cut, ground.space.footprint)
    cells, owner = group.cells_passed(width)
    cells, owner = np.append(cells, group.cell), np.append(owner, np.arange(len(group.cell)))
    row, col = np.divmod(cells, width)
    local = (row - rows.start) * cut.width + col - cols.start
    top = np.maximum(group.other_z, stop)
    clear = np.ones(len(top), dtype=np.bool_)
    clear[owner[~space.is_free(local, top[owner])]] = False
    return clear


def _lifted(shapes: Shapes, by: float) -> Shapes:
    """Shapes moved up."""
    solids, triangles = shapes.solids, shapes.triangles
    up = np.array([0.0, 0.0, by])
    return replace(
        shapes,
        solids=solids._replace(pos=solids.pos + up, bounds=solids.bounds + np.tile(up, 2)),
        triangles=triangles._replace(corners=triangles.corners + up),
    )


def _together(one: Shapes, other: Shapes) -> Shapes:
    """The shapes of both, by geom."""

    def join(a: Any, b: Any) -> Any:
        order = np.argsort(np.concatenate([a.geom, b.geom]), kind="stable")
        pairs = zip(a, b, strict=True)
        return type(a)._make(np.concatenate(pair)[order] for pair in pairs)

    return Shapes(
        join(one.solids, other.solids),
        join(one.planes, other.planes),
        join(one.triangles, other.triangles),
        one.endless | other.endless,
    )
