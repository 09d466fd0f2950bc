"""What Open-RMF makes of files, and what it refuses, by the rules of its own programs."""

from __future__ import annotations

import itertools
import math

import yaml


def load_as_adapter(content):
    """Load a navigation graph as the fleet adapter does; return its waypoints and lanes.

    In rmf_ros2, rmf_fleet_adapter/src/rmf_fleet_adapter/agv/parse_graph.cpp: names are unique
    (lines 94 to 105), lifts of vertices have properties (155 to 176), lanes join no vertices of
    different lifts (230 to 248), the vertices of a lift lie within 0.1 m (365 to 394).

    Waypoints are (map, x, y, lift or None), lanes are pairs of indices.
    """
    lifts = {}
    for name, properties in content["lifts"].items():
        lifts[name] = [*map(float, properties["position"]), *map(float, properties["dims"])]
        assert len(lifts[name]) == 5
    waypoints, lanes, names = [], [], []
    of_lift = {}
    for level_name, level in content["levels"].items():
        offset = len(waypoints)
        for x, y, options in level["vertices"]:
            lift = options.get("lift") or None
            if lift:
                assert lift in lifts, f"no properties of {lift}"
                of_lift.setdefault(lift, []).append(len(waypoints))
            if options.get("name"):
                names.append(options["name"])
            waypoints.append((level_name, float(x), float(y), lift))
        for start, end, _ in level["lanes"]:
            ends = waypoints[start + offset][3], waypoints[end + offset][3]
            assert None in ends or ends[0] == ends[1], f"{ends} are different lifts"
            lanes.append((start + offset, end + offset))
    assert len({*names}) == len(names), "a name twice"
    for lift, members in of_lift.items():
        places = [waypoints[member][1:3] for member in members]
        spread = max(math.dist(one, other) for one in places for other in places)
        assert spread <= 0.1, f"{lift}: {spread} m"
        for one, other in itertools.pairwise(members):
            lanes += [(one, other), (other, one)]
    return waypoints, lanes, lifts


def in_shaft(lift, x, y):
    """Whether building_map takes x, y to be in a lift: lift.py, get_lift_vertices (gap 0.05 m)."""
    dx, dy = x - lift["x"], y - lift["y"]
    cos, sin = math.cos(lift["yaw"]), math.sin(lift["yaw"])
    along, across = dx * cos + dy * sin, dy * cos - dx * sin
    return abs(along) <= lift["width"] / 2 + 0.05 and abs(across) <= lift["depth"] / 2 + 0.05


def make_nav_graph(building):
    """The navigation graph of a building in metres, as rmf_building_map_tools makes it.

    In rmf_traffic_editor, rmf_building_map_tools/building_map: level.py, generate_nav_graph: only
    vertices of lanes; those in a shaft are the lift's, if the level is between the lift's lowest
    and highest floor; a lane that leads both ways is two. building.py, generate_nav_graphs: lifts.
    """
    elevation = {name: level["elevation"] for name, level in building["levels"].items()}
    levels = {}
    for level_name, level in building["levels"].items():
        numbers, lanes = {}, []
        for start, end, values in level["lanes"]:
            ends = [numbers.setdefault(vertex, len(numbers)) for vertex in (start, end)]
            lanes.append([*ends, {}])
            if values["bidirectional"][1]:
                lanes.append([*ends[::-1], {}])
        vertices = []
        for vertex in numbers:
            x, y, _, name, _ = level["vertices"][vertex]
            options = {"name": name}
            for lift_name, lift in building["lifts"].items():
                low, high = elevation[lift["lowest_floor"]], elevation[lift["highest_floor"]]
                if low <= elevation[level_name] <= high and in_shaft(lift, x, y):
                    options["lift"] = lift_name
                    break
            vertices.append([x, y, options])
        levels[level_name] = {"vertices": vertices, "lanes": lanes}
    lifts = {
        name: {
            "position": [lift["x"], lift["y"], lift["yaw"]],
            "dims": [lift["width"], lift["depth"]],
        }
        for name, lift in building["lifts"].items()
    }
    return {"building_name": building["building_name"], "levels": levels, "lifts": lifts}


def check_lifts(waypoints, lanes, lifts, served):
    """Check that each lift has one waypoint in its car on each of its levels, reached from there.

    `served` is lift -> set of names of levels.
    """
    used = {name: [w for w in waypoints if w[3] == name] for name in lifts}
    for name, members in used.items():
        assert sorted(member[0] for member in members) == sorted(served[name])
        x, y, yaw, width, depth = lifts[name]
        car = {"x": x, "y": y, "yaw": yaw, "width": width, "depth": depth}
        for _, member_x, member_y, _ in members:
            assert in_shaft(car, member_x, member_y)
        for level_name, other_x, other_y, lift in waypoints:
            if lift is None and level_name in served[name]:
                assert not in_shaft({**car, "width": width - 0.1, "depth": depth - 0.1},
                                    other_x, other_y)  # fmt: skip
        for member in members:
            number = waypoints.index(member)
            beside = [start for start, end in lanes
                      if end == number and waypoints[start][3] is None]  # fmt: skip
            assert beside, f"no lane into {name} on {member[0]}"
            assert all((number, start) in lanes for start in beside)


def load_yaml(path):
    return yaml.safe_load(path.read_text(encoding="utf-8"))
