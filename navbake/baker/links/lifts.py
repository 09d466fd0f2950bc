"""Finds links along things that carry agents from level to level: ladders and lifts."""

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
    Landings,
    LandingTest,
    LatticeLink,
    LinkSearch,
)
from navbake.baker.scene.cars import MIN_VERTICAL_COSINE, CarFloor, find_lift_joints, measure_car
from navbake.baker.scene.collect import collect_shapes
from navbake.baker.scene.names import all_names, find_subtree_ends, mark_geoms_of_bodies
from navbake.baker.scene.pose import data_with_joints
from navbake.config.links import LinkSettings
from navbake.navgrid.lattice import Lattice
from navbake.navgrid.links import Stop
from navbake.types import Bool, Float, Int

LADDER_PATTERNS = ("*ladder*",)  # names of bodies and geoms that are ladders, if no others are set
DEFAULT_LADDER_GAP = 0.6  # the widest gap between a ladder and an agent that stands beside it [m]
DEFAULT_LIFT_GAP = 0.5  # the widest gap between the floor of a car and a landing [m]


# ---------------------------------------------------------------- ladders


def find_ladders(search: LinkSearch, rule: LinkSettings) -> list[LatticeLink]:
    """Find the ladders: bodies or geoms with matching names that reach from floor to floor.

    A free cell is a possible stop of a ladder if it lies, seen from above, within the rule's gap
    [m] of the ladder's box, and if its floor lies between a step below the ladder's foot and a
    step above its top. On each level with such cells, the stop is on the nearest of them. The link
    is as wide as the longer side of the ladder's box, seen from above.

    Args:
        search: floors, free cells and geometry.
        rule: a rule for ladders.

    Returns:
        A link for each ladder, with cell ids on the whole lattice.
    """
    max_gap = DEFAULT_LADDER_GAP if rule.gap is None else rule.gap
    links = []
    for name, is_ladder_geom in _find_ladder_geoms(search, rule.patterns or LADDER_PATTERNS):
        box = search.shapes.only(is_ladder_geom).bounds
        if box is None:
            continue
        stops = list(_find_stops_beside(box, max_gap, search))
        if len(stops) > 1:
            width = round(float(np.diff(box[:, :2], axis=0).max()), 6)
            links.append(LatticeLink(stops, {"name": name, "width": width}))
    return links


def _find_ladder_geoms(search: LinkSearch, patterns: Sequence[str]) -> list[tuple[str, Bool]]:
    """Find the bodies, and then the single geoms, whose names match a pattern of ladders.

    A body counts with the geoms of all bodies below it. A body or geom that is part of an earlier
    match is left out.

    Returns:
        For each match, its name and a mask by geom id of its geoms, shape (ngeom,), bool.
    """
    model = search.scene.model
    names = all_names(model)
    subtree_ends = find_subtree_ends(model)
    candidates: list[tuple[str, Bool]] = []
    for body, body_name in enumerate(names.bodies):
        if body > 0:  # the world is no ladder
            candidates.append(
                (body_name, mark_geoms_of_bodies(model, body, int(subtree_ends[body])))
            )
    for geom, geom_names in enumerate(names.geoms):
        candidates.append((geom_names.geom, np.arange(model.ngeom) == geom))

    ladders: list[tuple[str, Bool]] = []
    ladder_geom_ids = set[int]()
    for name, is_candidate_geom in candidates:
        geom_ids = set(np.flatnonzero(is_candidate_geom).tolist())
        if not geom_ids or geom_ids & ladder_geom_ids:
            continue
        if any(fnmatchcase(name, pattern) for pattern in patterns):
            ladders.append((name, is_candidate_geom))
            ladder_geom_ids |= geom_ids
    return ladders


def _find_stops_beside(box: Float, max_gap: float, search: LinkSearch) -> Iterator[Stop]:
    """Yield for each level that a ladder reaches a stop on the free cell nearest to the ladder.

    Args:
        box: the ladder's box, lower and upper corner, shape (2, 3) [m].
        max_gap: the largest distance of the cell's centre from the box, seen from above [m].
        search: floors and free cells.
    """
    (x_min, y_min, z_min), (x_max, y_max, z_max) = box.tolist()
    x = search.lattice.center_x()
    y = search.lattice.center_y()[:, None]
    distance = np.hypot(np.clip(x, x_min, x_max) - x, np.clip(y, y_min, y_max) - y)
    for level_number, (floor_heights, is_free) in enumerate(
        zip(search.floor_heights, search.is_free, strict=True)
    ):
        is_beside = is_free & (distance <= max_gap + LIMIT_SLACK)
        is_beside &= (floor_heights >= z_min - search.max_step) & (
            floor_heights <= z_max + search.max_step
        )
        if is_beside.any():
            # rounded, so that the first of equally near cells is taken
            nearest_cell = np.argmin(np.where(is_beside, np.round(distance, 9), np.inf))
            yield search.make_stop(level_number, int(nearest_cell))


# ---------------------------------------------------------------- lifts


class Car(NamedTuple):
    """The car of a lift.

    Attributes:
        name: name of the car's body.
        joint_id: id of the car's slide joint.
        is_car_geom: mask by geom id of the car's geoms, shape (ngeom,), bool.
        window: window of the lattice that contains the car and the cells where agents get off.
        floor_mask: mask of the lattice's cells that the car's floor covers, (height, width), bool.
        outline_mask: mask of the cells that any part of the car covers, (height, width), bool.
        floor_height: height of the car's floor in the scene's pose [m].
        min_height: lowest height that the floor can reach [m].
        max_height: highest height that the floor can reach [m].
        width: width of the floor [m].
        pose: x and y of the car's middle [m], its yaw [rad], its width in the direction of the yaw
            [m], and its depth [m].
    """

    name: str
    joint_id: int
    is_car_geom: Bool
    window: Window
    floor_mask: Bool
    outline_mask: Bool
    floor_height: float
    min_height: float
    max_height: float
    width: float
    pose: tuple[float, ...]


def find_lifts(search: LinkSearch, rule: LinkSettings) -> list[LatticeLink]:
    """Find the lifts: bodies with one vertical slide joint whose floor meets two levels or more.

    The car can stop at a height if a straight way leads from its floor to a free cell beside the
    car. The way crosses a gap no wider than the rule's [m], goes up or down by a step at most, and
    is free of obstacles while the car is at that height. On each level there is a stop for each
    side of the car with such ways, at the middle of the widest group of ways side by side. The link
    is as wide as the car's floor, or as the narrowest of these groups if that is narrower.

    Args:
        search: floors, free cells and geometry.
        rule: a rule for lifts.

    Returns:
        A link for each lift, with cell ids on the whole lattice.
    """
    links = []
    max_gap = DEFAULT_LIFT_GAP if rule.gap is None else rule.gap
    for car in _find_cars(search, rule.patterns or ("*",), max_gap):
        stops = list[Stop]()
        width = car.width
        for level_number in range(len(search.floor_heights)):
            crossings = search.find_crossings(
                level_number,
                is_start=car.floor_mask,
                directions=range(len(DIRECTIONS)),
                max_gap=max_gap,
                check_landing=_make_landing_test(car, level_number, search),
            )
            crossings["from_height"] = np.clip(
                crossings["to_height"], car.min_height, car.max_height
            )
            for landing_side in search.group_crossings(crossings):
                landing_crossings = landing_side.crossings
                # the car stops at one height
                landing_crossings["from_height"] = np.median(landing_crossings["from_height"])
                geometry = _pose_car_geometry(car, landing_crossings["from_height"][0], search)
                clear_crossings = landing_crossings[search.mark_clear(landing_crossings, geometry)]
                if not len(clear_crossings):
                    continue
                widest_group = max(
                    search.group_crossings(clear_crossings), key=lambda group: len(group.crossings)
                )
                width = min(width, widest_group.width)
                stop = search.make_stop_off_edge(
                    level_number,
                    int(widest_group.middle_crossing["to_cell"]),
                    direction=int(widest_group.middle_crossing["direction"]),
                    width=min(car.width, widest_group.width),
                )
                stops.append(stop)
        if len({stop.level for stop in stops}) > 1:
            stops.sort(key=lambda stop: (stop.level, stop.position[2], stop.cell))
            link_fields = {"name": car.name, "width": round(width, 6), "car": car.pose}
            links.append(LatticeLink(stops, link_fields))
    return links


def _make_landing_test(car: Car, level: int, search: LinkSearch) -> LandingTest:
    """Make the function that tests whether ways out of a car end on a level, beside the car.

    A way ends on a free cell whose floor is within a step of a height that the car's floor can
    reach. Ways start at the outer cells of the car's floor, and don't lead over this floor.
    """

    def check_landing(rows: Int, cols: Int, _from_height: Float, _num_between: int) -> Landings:
        floor_height = search.floor_heights[level, rows, cols]
        car_height = np.clip(floor_height, car.min_height, car.max_height)
        can_land = np.abs(floor_height - car_height) <= search.max_step
        can_land &= search.is_free[level, rows, cols] & ~car.outline_mask[rows, cols]
        return Landings(
            level=np.full(len(rows), level),
            has_landed=can_land,
            continues=~car.floor_mask[rows, cols],
        )

    return check_landing


def _find_cars(search: LinkSearch, patterns: Sequence[str], max_gap: float) -> Iterator[Car]:
    """Yield the cars of lifts whose names match a pattern, and whose floor is over the lattice.

    Args:
        search: the scene and its geometry.
        patterns: patterns of the names of cars' bodies.
        max_gap: the widest gap between the car's floor and a landing [m].
    """
    scene = search.scene
    lattice = search.lattice
    model = scene.model
    body_names = all_names(model).bodies
    subtree_ends = find_subtree_ends(model)
    for joint in find_lift_joints(model, scene.data, patterns):
        body = int(model.jnt_bodyid[joint])
        is_car_geom = mark_geoms_of_bodies(model, body, int(subtree_ends[body]))
        shapes = search.shapes.only(is_car_geom)
        bounds = shapes.bounds
        window = None if bounds is None else lattice.window(bounds, max_gap + lattice.cell_size)
        if body not in scene.car_bodies or bounds is None or window is None:
            continue
        window_lattice = lattice.cut(*window)
        car_floor = measure_car(shapes, window_lattice, search.agent)
        if car_floor is None:
            continue
        joint_axis = float(scene.data.xaxis[joint, 2])
        joint_position = float(scene.data.qpos[model.jnt_qposadr[joint]])
        end_heights = [
            car_floor.height + joint_axis * (joint_end - joint_position)
            for joint_end in model.jnt_range[joint].tolist()
        ]
        yield Car(
            name=body_names[body],
            joint_id=joint,
            is_car_geom=is_car_geom,
            window=window,
            floor_mask=_mark_cells(car_floor.cells, window, window_lattice, lattice),
            outline_mask=_mark_cells(car_floor.footprint_cells, window, window_lattice, lattice),
            floor_height=car_floor.height,
            min_height=min(end_heights),
            max_height=max(end_heights),
            width=float(measure_extents(shapes, model.ngeom).short_side[car_floor.geom]),
            pose=_measure_car_pose(search, car_floor, bounds),
        )


def _mark_cells(cells: Int, window: Window, window_lattice: Lattice, lattice: Lattice) -> Bool:
    """Mark cells of a window on the whole lattice, shape (height, width).

    Args:
        cells: ids of the cells on the window's lattice.
        window: the rows and columns of the window.
        window_lattice: the window's lattice.
        lattice: the whole lattice.
    """
    is_marked = np.zeros(lattice.shape, dtype=np.bool_)
    is_marked[window][np.divmod(cells, window_lattice.width)] = True
    return is_marked


def _measure_car_pose(search: LinkSearch, car_floor: CarFloor, bounds: Float) -> tuple[float, ...]:
    """Return where a car is, and its size: x and y of its middle, its yaw, its width and its depth.

    The yaw is in radians, all else in metres; the width is measured in the direction of the yaw.
    They are those of the geom of the car's floor if that is an upright box, else those of the car's
    bounding box, with a yaw of 0.
    """
    model = search.scene.model
    data = search.scene.data
    geom = car_floor.geom
    middle = bounds.mean(axis=0)
    size = np.diff(bounds, axis=0)[0]
    yaw = 0.0
    rotation = data.geom_xmat[geom]  # row by row
    if model.geom_type[geom] == BOX and rotation[8] >= MIN_VERTICAL_COSINE:
        middle = data.geom_xpos[geom]
        size = 2.0 * model.geom_size[geom]
        yaw = float(np.arctan2(rotation[3], rotation[0]))
    pose_numbers = (middle[0], middle[1], yaw, size[0], size[1])
    # adding 0 turns -0.0 into 0.0
    return tuple(round(float(pose_number), 6) + 0.0 for pose_number in pose_numbers)


def _pose_car_geometry(car: Car, height: float, search: LinkSearch) -> CollisionGeometry:
    """Return the geometry that agents may collide with while a car's floor is at a height [m]."""
    scene = search.scene
    model = scene.model
    joint_axis = float(scene.data.xaxis[car.joint_id, 2])
    joint_position = float(scene.data.qpos[model.jnt_qposadr[car.joint_id]])
    new_joint_position = joint_position + joint_axis * (height - car.floor_height)
    data = data_with_joints(model, scene.data, {car.joint_id: new_joint_position})
    shapes = search.shapes
    counted_geoms = np.unique(
        np.concatenate([shapes.solids.geom, shapes.planes.geom, shapes.meshes.geom])
    )
    car_shapes, *_ = collect_shapes(
        model,
        data,
        selections=scene.selections,
        exact_meshes=scene.exact_meshes,
        geom_ids=counted_geoms[car.is_car_geom[counted_geoms]].tolist(),
        meshes=scene.meshes,
    )
    footprint = search.geometry.footprint
    tiled_shapes = tile_shapes(
        shapes.with_replaced(car_shapes, car.is_car_geom),
        search.lattice.cut(*car.window),
        footprint.half_width,
    )
    return CollisionGeometry(
        sources=[CollisionShapes(cast_columns(tiled_shapes), tiled_shapes)],
        footprint=footprint,
        window=car.window,
    )
