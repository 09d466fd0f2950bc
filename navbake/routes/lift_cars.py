"""The places of routes in the cars of lifts: one in each car on each level that it serves.

In a graph of routes, the nodes at a lift are landings, beside the car. Open-RMF instead wants one
vertex inside of the car on each level, all at the same x, y, with lanes from the landings. It takes
every vertex over the car's floor for such a vertex.

Source: ``parse_graph.cpp`` of ``rmf_fleet_adapter`` (vertices of a lift lie within 0.1 m of each
other, and no lane joins vertices of two lifts); ``level.py`` and ``lift.py`` of
``rmf_building_map_tools`` (all vertices within 0.05 m of the car's outline belong to the lift).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

from navbake.routes.graph import LiftCar, RouteGraph
from navbake.types import Float

Coordinates = TypeVar("Coordinates", float, Float)

LIFT = "lift"  # kind of the lanes over lifts
# stops in a car that are nearer to their middle than this are the same place [m]
MAX_PLACE_DISTANCE = 0.05
DEFAULT_CAR_SIZE = 1.0  # width and depth of a car that neither the grid nor the link states [m]


class CarPlan(NamedTuple):
    """The car of a lift, and the place in it where agents ride.

    Attributes:
        car: the car.
        x: world x of the place [m].
        y: world y of the place [m].
        is_guess: whether the car is unknown; then a square between the landings stands for it.
    """

    car: LiftCar
    x: float
    y: float
    is_guess: bool


@dataclass
class CarStop:
    """The place in a lift's car on one of the levels that it serves.

    Attributes:
        name: a name that no node has, and no other place.
        lift: the lift's name.
        level: the level's number.
        x: world x [m], the same on all levels.
        y: world y [m].
        node: index of the node that stands there already; None for none.
        entries: indices of the landings from which agents get in.
        exits: indices of the landings to which agents get off.
    """

    name: str
    lift: str
    level: int
    x: float
    y: float
    node: int | None = None
    entries: list[int] = field(default_factory=list)
    exits: list[int] = field(default_factory=list)


def to_car_frame(car: LiftCar, x: Coordinates, y: Coordinates) -> tuple[Coordinates, Coordinates]:
    """Convert world x and y to the frame of a car.

    Args:
        car: the car.
        x: world x [m], a number or an array.
        y: world y [m], likewise.

    Returns:
        x along the car's width and y along its depth, from its middle [m].
    """
    cos = math.cos(car.yaw)
    sin = math.sin(car.yaw)
    dx = x - car.x
    dy = y - car.y
    return dx * cos + dy * sin, dy * cos - dx * sin


def is_in_car(car: LiftCar, x: float, y: float, margin: float = 0.0) -> bool:
    """Return whether a point lies over the floor of a car, seen from above.

    Args:
        car: the car.
        x: world x [m].
        y: world y [m].
        margin: how far beside the floor the point may lie [m].
    """
    car_x, car_y = to_car_frame(car, x, y)
    return abs(car_x) < car.width / 2 + margin and abs(car_y) < car.depth / 2 + margin


def list_landings(graph: RouteGraph) -> dict[str, list[int]]:
    """List the landings of each lift: the nodes that lanes over the lift join.

    Args:
        graph: the graph.

    Returns:
        Name of a lift -> indices of its landings, ascending.
    """
    landings: dict[str, set[int]] = {}
    for lane in graph.lanes:
        if lane.kind == LIFT and lane.link is not None:
            landings.setdefault(lane.link, set()).update((lane.start, lane.end))
    return {lift: sorted(nodes) for lift, nodes in landings.items()}


def plan_cars(graph: RouteGraph) -> dict[str, CarPlan]:
    """Find the car of each lift in a graph, and the place in the car where agents ride.

    The place is the middle of the car. If landings lie inside of the car, all at the same x, y, it
    is the place of these landings instead. If the graph lists no car for a lift, a square in the
    middle of the landings stands for the car.

    Args:
        graph: the graph.

    Returns:
        Name of a lift -> its plan, in the order of the graph's lanes.
    """
    car_of_lift = {car.name: car for car in graph.cars}
    plans = {}
    for lift, nodes in list_landings(graph).items():
        positions = [graph.nodes[node].position[:2] for node in nodes]
        car = car_of_lift.get(lift)
        if car is None:
            x, y = _mean(positions)
            car_size = DEFAULT_CAR_SIZE
            plans[lift] = CarPlan(LiftCar(lift, x, y, 0.0, car_size, car_size), x, y, is_guess=True)
            continue
        positions_in_car = [position for position in positions if is_in_car(car, *position)]
        ride_place = (car.x, car.y)
        if positions_in_car:
            mean_position = _mean(positions_in_car)
            if all(
                math.dist(position, mean_position) <= MAX_PLACE_DISTANCE
                for position in positions_in_car
            ):
                ride_place = mean_position
        plans[lift] = CarPlan(car, ride_place[0], ride_place[1], is_guess=False)
    return plans


def _mean(positions: Sequence[Sequence[float]]) -> tuple[float, float]:
    """Return the mean of points x, y, to a micrometre [m]."""
    x = sum(position[0] for position in positions) / len(positions)
    y = sum(position[1] for position in positions) / len(positions)
    return round(x, 6) + 0.0, round(y, 6) + 0.0


def make_car_stops(graph: RouteGraph, plans: Iterable[CarPlan]) -> list[CarStop]:
    """Make the places in the cars of lifts, one on each level that a lift serves.

    Args:
        graph: the graph.
        plans: the cars, as `plan_cars` returns them.
    """
    landings = list_landings(graph)
    used_names = {node.name for node in graph.nodes}
    stops = []
    for plan in plans:
        lift = plan.car.name
        stop_of_level: dict[int, CarStop] = {}
        for node_index in landings[lift]:
            node = graph.nodes[node_index]
            if node.level not in stop_of_level:
                name = f"{lift} car {node.level}"
                while name in used_names:
                    name += "'"
                used_names.add(name)
                stop_of_level[node.level] = CarStop(name, lift, node.level, plan.x, plan.y)
            is_node_at_place = math.dist(node.position[:2], (plan.x, plan.y)) <= MAX_PLACE_DISTANCE
            if is_node_at_place and not plan.is_guess and stop_of_level[node.level].node is None:
                stop_of_level[node.level].node = node_index
        for lane in graph.lanes:
            if lane.kind != LIFT or lane.link != lift:
                continue
            directions = [(lane.start, lane.end)]
            if lane.two_way:
                directions.append((lane.end, lane.start))
            for start, end in directions:
                entries = stop_of_level[graph.nodes[start].level].entries
                exits = stop_of_level[graph.nodes[end].level].exits
                if start not in entries:
                    entries.append(start)
                if end not in exits:
                    exits.append(end)
        stops += [stop_of_level[level] for level in sorted(stop_of_level)]
    return stops


def find_nodes_in_cars(
    graph: RouteGraph, plans: Iterable[CarPlan], margin: float = 0.0
) -> frozenset[int]:
    """Find the nodes over the floors of cars, on the levels that the lifts pass.

    Landings of lifts don't count, and cars that are guessed have no floor.

    Args:
        graph: the graph.
        plans: the cars, as `plan_cars` returns them.
        margin: how far beside a car a node counts as over its floor [m].

    Returns:
        The nodes' indices.
    """
    landings = list_landings(graph)
    all_landings = {
        node_index for landing_nodes in landings.values() for node_index in landing_nodes
    }
    node_indices = set()
    for plan in plans:
        lift = plan.car.name
        levels = [graph.nodes[node_index].level for node_index in landings[lift]]
        for node_index, node in enumerate(graph.nodes):
            if (
                not plan.is_guess
                and min(levels) <= node.level <= max(levels)
                and node_index not in all_landings
                and is_in_car(plan.car, node.position[0], node.position[1], margin)
            ):
                node_indices.add(node_index)
    return frozenset(node_indices)
