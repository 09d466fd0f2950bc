"""Files of graphs of routes: round trips, and what the programs that read them take."""

from __future__ import annotations

import contextlib
import json
import math
from dataclasses import replace

import networkx
import pytest
import shapely.geometry
import yaml

import navbake
from navbake.errors import FormatError
from navbake.formats.format_table import ROUTE_FORMATS
from navbake.formats.route_files import read_routes, write_routes
from navbake.routes.build import make_routes
from navbake.routes.graph import Doorway, Lane, LiftCar, Node, RouteGraph
from open_rmf import check_lifts, load_as_adapter, load_yaml
from project_paths import GOLDEN, ROOT

SMALL = RouteGraph(
    nodes=(
        Node("hall", (0.0, 0.0, 0.0), 0, "room", "0:1"),
        Node("upstairs", (0.5, -2.0, 3.0), 1, "stop", None, None, "A"),
        Node("gate", (1.5, 0.25, 0.0), 0, "door", None, "door_1"),
        Node("A <0> & \"x\"", (0.5, -2.0, 0.0), 0, "stop", None, None, "A"),
    ),
    lanes=(
        Lane(0, 2, "a", 1.52069, 3.0, speed=0.25, door="door_1"),
        Lane(3, 0, "b", 2.061553, 2.061553, two_way=False),
        Lane(3, 1, "c", 3.0, 4.0, kind="lift", seconds=12.0, link="A"),
        Lane(1, 0, "d", 3.6, 1.0, two_way=False, kind="drop", link="d", seconds=1.0),
        Lane(0, 1, "e", 3.6, 1.0, two_way=False, kind="jump", link="d", seconds=1.0),
    ),
    scene_id="s", level_names=("ground", "first"), agent="robot", radius=0.3, speed=0.5,
)  # fmt: skip
EMPTY = RouteGraph((Node("one", (0.0, 0.0, 0.0)),), ())


@pytest.fixture(scope="module")
def house():
    return make_routes(navbake.load(GOLDEN / "house.grid.json.gz"))


@pytest.mark.parametrize("form", ROUTE_FORMATS, ids=lambda form: form.name)
def test_what_is_written_is_read(tmp_path, house, form):
    for graph in (SMALL, EMPTY, house, house.on_level(1)):
        for ending in form.endings:
            assert write_routes(graph, tmp_path / f"a{ending}") == [tmp_path / f"a{ending}"]
            assert read_routes(tmp_path / f"a{ending}") == graph
        write_routes(graph, tmp_path / "b.dat", form.name)
        assert (tmp_path / "b.dat").read_bytes() == (tmp_path / f"a{ending}").read_bytes()
        assert read_routes(tmp_path / "b.dat", form.name) == graph


def load_as_nav2(path):
    """A graph by the rules of nav2's loader: nodes and directed edges by id."""
    nodes, edges = {}, {}

    def check_metadata(value):  # numbers, booleans, text, lists of these, and objects
        for each in value.values():
            if isinstance(each, dict):
                check_metadata(each)
            else:
                for one in each if isinstance(each, list) else [each]:
                    assert isinstance(one, int | float | str | bool)

    for feature in json.loads(path.read_text())["features"]:
        kind, own = feature["geometry"]["type"], feature["properties"]
        check_metadata(own.get("metadata", {}))
        assert isinstance(own["id"], int) and own["id"] >= 0
        if kind == "Point":
            assert own["id"] not in nodes and isinstance(own["frame"], str)
            nodes[own["id"]] = feature["geometry"]["coordinates"][:2]
        elif kind in ("MultiLineString", "LineString"):
            assert own["id"] not in edges and isinstance(own["overridable"], bool)
            edges[own["id"]] = own["startid"], own["endid"], float(own["cost"])
    assert nodes and edges
    assert {end for edge in edges.values() for end in edge[:2]} <= nodes.keys()
    return nodes, edges


def test_nav2_loads_it(tmp_path, house):
    write_routes(house, tmp_path / "a.geojson")
    nodes, edges = load_as_nav2(tmp_path / "a.geojson")
    assert [list(node.position[:2]) for node in house.nodes] == list(nodes.values())
    ways = sorted((lane.start, lane.end, lane.cost) for lane in house.lanes)
    back = sorted((lane.end, lane.start, lane.cost) for lane in house.lanes if lane.two_way)
    assert sorted(edges.values()) == sorted(ways + back)
    assert {*nodes} & {*edges} == set()
    for feature in json.loads((tmp_path / "a.geojson").read_text())["features"]:
        shape = shapely.geometry.shape(feature["geometry"])
        own = feature["properties"]
        assert shape.is_valid
        if "startid" in own:
            (line,) = shape.geoms
            assert [list(end[:2]) for end in line.coords] == [
                nodes[own["startid"]],
                nodes[own["endid"]],
            ]
    write_routes(SMALL, tmp_path / "b.geojson")
    features = json.loads((tmp_path / "b.geojson").read_text())["features"]
    slow = features[4]["properties"]
    assert slow["metadata"]["abs_speed_limit"] == 0.25 and slow["metadata"]["speed_limit"] == 50
    # the first is slow and has a price, the others are links, but for the third
    overridable = [feature["properties"]["overridable"] for feature in features[4:]]
    assert overridable == [False, False, True, False, False, False, False]


# a lane that is slow, one that has a price, both, and neither; links that are dear, cheap, free
PRICED = RouteGraph(
    nodes=tuple(Node(name, (x, y, 0.0)) for name, x, y in (
        ("a", 0.0, 0.0), ("b", 4.0, 0.0), ("c", 8.0, 0.0), ("d", 4.0, 5.0), ("e", 4.0, -2.0),
        ("f", 4.0, -2.0),
    )),
    lanes=(
        Lane(0, 1, "slow", 4.0, 4.0, speed=0.1),
        Lane(1, 2, "slow, by an integer", 4.0, 4.0, speed=1),
        Lane(0, 3, "plain", 6.403124, 6.403124),
        Lane(3, 2, "dear", 6.403124, 64.03124),
        Lane(0, 4, "dear and slow", 4.472136, 13.416408, speed=0.5, two_way=False),
        Lane(4, 5, "short", 0.0, 0.0),
        Lane(5, 2, "a free ride", 4.472136, 0.0, kind="ferry", link="ferry", two_way=False),
        Lane(3, 1, "cheap", 5.0, 1.25),
    ),
    speed=1.5,
)  # fmt: skip


def nav2_costs(path, start, speed_tag="speed_limit"):
    """Costs of routes from a node, by nav2's planner with its scorer of distances alone.

    In navigation2, nav2_route/src: route_planner.cpp, getTraversalCost: an edge that may not be
    overridden has its cost, which must be positive; distance_scorer.cpp, score: length / value of
    the tag, 1 without it; types.hpp, getValue: the value must be a float.
    """
    features = json.loads(path.read_text())["features"]
    points = {
        feature["properties"]["id"]: feature["geometry"]["coordinates"][:2]
        for feature in features if feature["geometry"]["type"] == "Point"
    }  # fmt: skip
    graph = networkx.MultiDiGraph()
    for properties in (feature["properties"] for feature in features):
        if "startid" not in properties:
            continue
        ends = (properties["startid"], properties["endid"])
        if properties["overridable"]:
            value = properties["metadata"].get(speed_tag, 1.0)
            assert isinstance(value, float)
            cost = math.dist(*(points[end] for end in ends)) / value
        else:
            cost = properties["cost"]
            assert cost > 0
        graph.add_edge(*ends, cost=cost)
    return networkx.single_source_dijkstra_path_length(graph, start, weight="cost")


@pytest.mark.parametrize("speed_tag", ["speed_limit", "none"])  # nav2's default, and the docs'
def test_nav2_finds_the_cheapest_routes_of_the_graph(tmp_path, house, speed_tag):
    for graph in (PRICED, house.on_level(0)):
        write_routes(graph, tmp_path / "a.geojson")
        assert read_routes(tmp_path / "a.geojson") == graph
        for start, row in enumerate(graph.distances()):
            costs = nav2_costs(tmp_path / "a.geojson", start, speed_tag)
            reached = [costs.get(end, math.inf) for end in range(len(graph.nodes))]
            assert reached == pytest.approx(row.tolist(), abs=1e-4)
    limits = [
        value
        for feature in json.loads((tmp_path / "a.geojson").read_text())["features"]
        for key, value in feature["properties"].get("metadata", {}).items()
        if key in ("speed_limit", "abs_speed_limit")
    ]
    assert all(isinstance(limit, float) for limit in limits)


def test_the_launch_file_of_the_docs_scores_by_no_percentage():
    text = (ROOT / "docs" / "routes.md").read_text(encoding="utf-8")
    assert '"plugin": "nav2_route::DistanceScorer", "speed_tag": "none"' in text


def test_lif_is_valid(tmp_path, house):
    lif = pytest.importorskip("vdma_lif.parser")
    for graph in (house, SMALL):
        write_routes(graph, tmp_path / "a.json")
        found = lif.LIFParser.from_file(str(tmp_path / "a.json"))
        assert [layout.layout_name for layout in found.layouts] == list(graph.level_names)
        nodes = [node for layout in found.layouts for node in layout.nodes]
        edges = [edge for layout in found.layouts for edge in layout.edges]
        assert {node.node_id for node in nodes} == {node.name for node in graph.nodes}
        assert len(edges) == sum(1 + lane.two_way for lane in graph.lanes)
        assert len({edge.edge_id for edge in edges}) == len(edges)
        assert {e.start_node_id for e in edges} | {e.end_node_id for e in edges} <= {
            node.node_id for node in nodes
        }
        # and nothing but navbake's own key is unknown to it
        (tmp_path / "b.json").write_text(lif.LIFParser.to_json(found))
        again = json.loads((tmp_path / "b.json").read_text())
        own = json.loads((tmp_path / "a.json").read_text(), object_hook=without_own)
        for content in (again, own):
            del content["metaInformation"]["exportTimestamp"]
        assert again == own
        assert len(read_routes(tmp_path / "b.json").nodes) == len(graph.nodes)


def lif_2(layouts_by_origin):
    """A LIF 2 whose layouts have nodes 11 m apart, by the draft of 2025-09."""
    origins = []
    for number, num_layouts in enumerate(layouts_by_origin):
        layouts = []
        for index in range(num_layouts):
            name = f"{number}.{index}"
            nodes = [
                {"nodeId": f"{name} a", "mapId": "m", "nodePosition": {"x": 0, "y": 0}},
                {"nodeId": f"{name} b", "mapId": "m", "nodePosition": {"x": 11, "y": 0}},
            ]
            robots = [{"mobileRobotTypes": [{"seriesName": "1"}], "maxSpeed": 0.4}]
            edge = {"edgeId": name, "startNodeId": f"{name} a", "endNodeId": f"{name} b"}
            edge["mobileRobotTypeEdgeProperties"] = robots
            layouts.append({"layoutId": name, "nodes": nodes, "edges": [edge]})
        origins.append({"originId": str(number), "layouts": layouts})
    return {"metaInformation": {"lifVersion": "2.0.0"}, "origins": origins}


@pytest.mark.parametrize("layouts_by_origin", [[1], [2], [1, 2], [0, 1]])
def test_lif_2_is_read_layout_by_layout(tmp_path, layouts_by_origin):
    (tmp_path / "a.lif").write_text(json.dumps(lif_2(layouts_by_origin)))
    graph = read_routes(tmp_path / "a.lif")
    count = sum(layouts_by_origin)
    assert [node.level for node in graph.nodes] == [k // 2 for k in range(2 * count)]
    assert [node.position[:2] for node in graph.nodes[:2]] == [(0, 0), (11, 0)]
    assert [(lane.length, lane.speed) for lane in graph.lanes] == [(11.0, 0.4)] * count


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"metaInformation": {"lifVersion": "3.0"}}, "got neither, with lifVersion '3.0'"),
        ({}, r"expected `layouts` \(LIF 1\) or `origins` \(LIF 2\), got neither, with no lif"),
        ({"origins": 1}, "origins"),
        ({"origins": [{"layouts": [{"nodes": [{}]}]}]}, r"origins\[0\].layouts\[0\].nodes\[0\]"),
    ],
)
def test_a_lif_of_no_known_version_is_refused(tmp_path, content, message):
    (tmp_path / "a.lif").write_text(json.dumps(content))
    with pytest.raises(FormatError, match=message):
        read_routes(tmp_path / "a.lif")


def without_own(entry):
    return {key: value for key, value in entry.items() if key != "navbake"}


def test_open_rmf_finds_names_lifts_and_doors(tmp_path, caplog):
    write_routes(SMALL, tmp_path / "a.yaml")
    content = load_yaml(tmp_path / "a.yaml")
    levels = content["levels"]
    assert [*levels] == ["ground", "first"]
    vertices, lanes = levels["ground"]["vertices"], levels["ground"]["lanes"]
    assert [vertex[2]["name"] for vertex in vertices] == ["hall", "gate", 'A <0> & "x"', "A car 0"]
    assert [vertex[2].get("lift") for vertex in vertices] == [None, None, None, "A"]
    assert [vertex[2].get("lift") for vertex in levels["first"]["vertices"]] == [None, "A"]
    assert [lane[:2] for lane in lanes] == [[0, 1], [1, 0], [2, 0], [2, 3], [3, 2]]
    assert [lane[:2] for lane in levels["first"]["lanes"]] == [[0, 1], [1, 0]]
    assert (lanes[0][2]["door_name"], lanes[0][2]["speed_limit"]) == ("door_1", 0.25)
    load_as_adapter(content)
    (record,) = caplog.records
    assert "the cars of 'A' are not known: they are taken to be between" in record.getMessage()


CARS = (LiftCar("A", 0.5, -3.0, 0.25, 1.5, 1.6), LiftCar("B", 2.4, -3.0, 0.0, 1.8, 1.6))
LIFTS = RouteGraph(  # two lifts side by side, whose landings are joined, and a node in a car
    nodes=(
        Node("A 0", (0.5, -2.0, 0.0), 0, "stop", link="A"),
        Node("B 0", (2.4, -2.0, 0.0), 0, "stop", link="B"),
        Node("in A", (0.6, -3.2, 0.0), 0),
        Node("A 1", (0.6, -1.9, 3.0), 1, "stop", link="A"),
        Node("A back", (0.5, -4.2, 3.0), 1, "stop", link="A"),
        Node("B 1", (2.3, -2.1, 3.0), 1, "stop", link="B"),
        Node("A car 0", (5.0, 5.0, 0.0), 0),
    ),
    lanes=(
        Lane(0, 1, "a", 1.9, 1.9, door="d_left"),
        Lane(0, 2, "b", 1.2, 1.2),
        Lane(0, 3, "c", 3.0, 4.0, kind="lift", link="A"),
        Lane(0, 4, "d", 3.0, 4.0, kind="lift", link="A"),
        Lane(3, 4, "e", 3.0, 4.0, kind="lift", link="A"),
        Lane(3, 5, "f", 1.8, 1.8),
        Lane(1, 5, "g", 3.0, 4.0, kind="lift", link="B", two_way=False),
        Lane(1, 6, "h", 7.5, 7.5),
    ),
    level_names=("0", "1"),
    cars=CARS,
    doorways=(
        Doorway("d_left", 0, (1.0, -2.5), (1.0, -2.0)),
        Doorway("d_right", 0, (1.0, -2.0), (1.0, -1.5)),
        Doorway("e", 1, (3.0, 0.0), (3.0, 1.0)),
    ),
)  # fmt: skip


def test_open_rmf_loads_lifts_that_stand_side_by_side(tmp_path, caplog):
    write_routes(LIFTS, tmp_path / "a.yaml")
    content = load_yaml(tmp_path / "a.yaml")
    waypoints, _, lifts = load_as_adapter(content)
    assert lifts == {"A": [0.5, -3.0, 0.25, 1.5, 1.6], "B": [2.4, -3.0, 0.0, 1.8, 1.6]}
    assert [w[1:] for w in waypoints if w[3]] == [
        (0.5, -3.0, "A"), (2.4, -3.0, "B"), (0.5, -3.0, "A"), (2.4, -3.0, "B"),
    ]  # fmt: skip
    assert (0.6, -3.2) not in [waypoint[1:3] for waypoint in waypoints]
    assert not caplog.records
    first, second = (content["levels"][name] for name in ("0", "1"))
    names = [[vertex[2]["name"] for vertex in level["vertices"]] for level in (first, second)]
    assert names == [["A 0", "B 0", "A car 0", "A car 0'", "B car 0"],
                     ["A 1", "A back", "B 1", "A car 1", "B car 1"]]  # fmt: skip
    # of a lift that leads up only, nobody gets off below or on above
    assert [lane[:2] for lane in first["lanes"]][-3:] == [[0, 3], [3, 0], [1, 4]]
    assert [lane[:2] for lane in second["lanes"]][-5:] == [[0, 3], [1, 3], [3, 0], [3, 1], [4, 2]]
    assert content["doors"] == {
        "d": {"endpoints": [[1.0, -2.5], [1.0, -1.5]], "map": "0"},
        "e": {"endpoints": [[3.0, 0.0], [3.0, 1.0]], "map": "1"},
    }
    assert first["lanes"][0][2]["door_name"] == "d"


@pytest.mark.parametrize("form", ROUTE_FORMATS, ids=lambda form: form.name)
def test_lifts_and_doors_come_back(tmp_path, form):
    for graph in (LIFTS, LIFTS.on_level(1)):
        write_routes(graph, tmp_path / "a", form.name)
        assert read_routes(tmp_path / "a", form.name) == graph


def test_open_rmf_loads_the_tower(tmp_path):
    tower = make_routes(navbake.load(GOLDEN / "tower.grid.json.gz"))
    write_routes(tower, tmp_path / "a.yaml")
    waypoints, lanes, lifts = load_as_adapter(load_yaml(tmp_path / "a.yaml"))
    names = tower.level_names
    check_lifts(waypoints, lanes, lifts, {"lift_a": {*names}, "lift_b": {*names[:2]}})
    assert read_routes(tmp_path / "a.yaml") == tower


def test_open_rmfs_own_graphs_come_back_as_it_loads_them(tmp_path):
    content = {
        "building_name": "b",
        "doors": {"d": {"endpoints": [[1, 2], [1, 3]], "map": "L2"}},
        "lifts": {"E": {"position": [4, 3, 1.5], "dims": [2.0, 1.5]},
                  "unused": {"position": [9, 9, 0], "dims": [1, 1]}},
        "levels": {
            "L1": {
                "vertices": [[0, 0, {"name": "a"}], [4.2, 3, {"name": "", "lift": "E"}]],
                "lanes": [[0, 1, {}], [1, 0, {}]],
            },
            "L2": {"vertices": [[4.2, 3, {"lift": "E", "name": "top"}], [0, 3, {"name": "c"}]],
                   "lanes": [[0, 1, {"door_name": "d"}], [1, 0, {}]]},
        },
    }  # fmt: skip
    (tmp_path / "a.yaml").write_text(yaml.safe_dump(content))
    graph = read_routes(tmp_path / "a.yaml")
    assert graph.cars == (LiftCar("E", 4, 3, 1.5, 2, 1.5), LiftCar("unused", 9, 9, 0, 1, 1))
    assert graph.doorways == (Doorway("d", 1, (1, 2), (1, 3)),)
    write_routes(graph, tmp_path / "b.yaml")
    assert load_as_adapter(load_yaml(tmp_path / "b.yaml")) == load_as_adapter(content)
    assert read_routes(tmp_path / "b.yaml") == graph


def test_graphml_is_networkxs(tmp_path, house):
    write_routes(house, tmp_path / "a.graphml")
    found = networkx.read_graphml(tmp_path / "a.graphml")
    assert found.is_directed() and len(found) == len(house.nodes)
    one, other = house.nodes[0].name, house.nodes[40].name
    length = networkx.dijkstra_path_length(found, one, other, weight="cost")
    assert length == pytest.approx(house.distances()[0, 40])


def test_graphs_of_other_programs(tmp_path):
    points = (({"id": 7, "frame": "map"}, [0, 1]), ({"id": 3}, [3, 5.0]))
    edges = (
        ({"id": 8, "startid": 7, "endid": 3, "metadata": {"speed_limit": 50}}, "LineString", []),
        ({"id": 9, "startid": 3, "endid": 7, "cost": 2.5}, "MultiLineString", [[]]),
    )
    features = [
        {"type": "Feature", "properties": own, "geometry": {"type": kind, "coordinates": at}}
        for own, kind, at in (*((own, "Point", at) for own, at in points), *edges)
    ]
    content = {"type": "FeatureCollection", "features": features}
    (tmp_path / "a.geojson").write_text(json.dumps(content))
    graph = read_routes(tmp_path / "a.geojson")
    assert graph.nodes == (Node("7", (0, 1, 0)), Node("3", (3, 5, 0)))
    assert graph.lanes == (
        Lane(0, 1, "8", 5.0, 5.0, False, speed=0.5),  # 50 % of 1 m/s
        Lane(1, 0, "9", 5.0, 2.5, False),
    )
    levels = {
        "L1": {
            "vertices": [[0, 0, {"name": "a"}], [4, 3, {"lift": "E"}]],
            "lanes": [[0, 1, {}], [1, 0]],
        },
        "L2": {"vertices": [[4, 3, {"lift": "E", "name": "top"}]], "lanes": []},
    }
    (tmp_path / "a.yaml").write_text(yaml.safe_dump({"building_name": "b", "levels": levels}))
    graph = read_routes(tmp_path / "a.yaml")
    assert [node.name for node in graph.nodes] == ["a", "L1 1", "top"]
    assert [(n.level, n.link) for n in graph.nodes] == [(0, None), (0, "E"), (1, "E")]
    ways = [(lane.start, lane.end, lane.kind, lane.two_way) for lane in graph.lanes]
    assert (1, 2, "lift", True) in ways and graph.level_names == ("L1", "L2")
    other = networkx.Graph()
    other.add_node("p", x=0.0, y=0.0)
    other.add_node("q", x=3.0, y=4.0)
    other.add_edge("p", "q")
    networkx.write_graphml(other, tmp_path / "a.graphml")
    graph = read_routes(tmp_path / "a.graphml")
    assert graph.lanes == (Lane(0, 1, "p - q", 5.0, 5.0),)


@pytest.mark.parametrize("directed", [True, False])
def test_gml_of_other_programs(tmp_path, directed):
    other = networkx.DiGraph() if directed else networkx.Graph()
    other.add_node('Küche "1"', x=0.0, y=0)
    other.add_node("q", graphics={"x": 3.0, "y": 4.0, "w": 30.0})
    other.add_edge('Küche "1"', "q", weight=2)
    networkx.write_gml(other, tmp_path / "a.gml")
    graph = read_routes(tmp_path / "a.gml")
    assert [node.name for node in graph.nodes] == ['Küche "1"', "q"]
    assert graph.nodes[1].position == (3.0, 4.0, 0.0)
    assert [(lane.length, lane.two_way) for lane in graph.lanes] == [(5.0, not directed)]
    (tmp_path / "b.gml").write_text(
        "graph [ directed 1 node [ id 7 x 1 y 2 ] node [ id 8 x 1 y 3 ] "
        "edge [ source 7 target 8 ] ]"
    )
    assert [node.name for node in read_routes(tmp_path / "b.gml").nodes] == ["7", "8"]


def test_gml_is_networkxs(tmp_path, house):
    write_routes(house, tmp_path / "a.gml")
    found = networkx.read_gml(tmp_path / "a.gml")
    assert found.is_directed() and len(found) == len(house.nodes)
    start, end = house.nodes[0].name, house.nodes[40].name
    length = networkx.dijkstra_path_length(found, start, end, weight="cost")
    assert length == pytest.approx(house.distances()[0, 40])


def test_nodes_of_one_name_have_their_ids(tmp_path):
    nodes = [
        {"nodeId": key, "nodeName": name, "nodePosition": {"x": x, "y": 0}}
        for x, (key, name) in enumerate([("a", "Dock"), ("b", "Dock"), ("c", "Hall")])
    ]
    for count, names in ((3, ["a", "b", "c"]), (-2, ["Dock", "Hall"])):
        content = {"layouts": [{"nodes": nodes[:count] if count > 0 else nodes[count:]}]}
        (tmp_path / "a.json").write_text(json.dumps(content))
        assert [node.name for node in read_routes(tmp_path / "a.json").nodes] == names


def test_nav2_is_warned_of_levels(tmp_path, caplog):
    write_routes(SMALL.on_level(0), tmp_path / "a.geojson")
    assert not caplog.records
    write_routes(SMALL, tmp_path / "a.geojson")
    (record,) = caplog.records
    assert "nav2 knows no levels: the nodes of all 2 are in one" in record.getMessage()
    assert "--level" in record.getMessage()


def changed(graph, **changes):
    return replace(graph, nodes=(replace(graph.nodes[0], **changes), *graph.nodes[1:]))


@pytest.mark.parametrize(
    ("name", "text", "culprit"),
    [
        ("a.geojson", "[", "broken JSON"),
        ("a.geojson", "{}", "a list of features, got nothing|got null"),
        ("a.geojson", '{"features": [3]}', r"features\[0\]"),
        ("a.geojson", '{"features": [{"geometry": {"type": "Point", "coordinates": [1]}, '
         '"properties": {"id": 1}}]}', "a node's x and y"),
        ("a.geojson", '{"features": [{"geometry": {"type": "LineString"}, '
         '"properties": {"startid": 1, "endid": 2}}]}', "expected the id of a node, got 1"),
        ("a.json", '{"layouts": 3}', "layouts"),
        ("a.json", '{"layouts": [{"nodes": [{"nodeId": "a"}]}]}', "nodePosition"),
        ("a.yaml", "levels: {L1: {vertices: [3]}}", r"vertices\[0\]"),
        ("a.yaml", "levels: {L1: {lanes: [[0, 1]]}}", "expected the id of a node"),
        ("a.yaml", "levels: {L1: {lanes: [[0, {a: 1}]]}}", "expected the id of a node"),
        ("a.yaml", "levels: {L1: {lanes: [[[0], 1]]}}", "expected the id of a node"),
        ("a.yaml", "levels: {}\nnavbake: {lanes: [[99, 0]]}", "the number of a node, got 99 at"),
        ("a.yaml", "levels: {}\nnavbake: {lanes: [[[1], 0]]}", "the number of a node, got a list"),
        ("a.yaml", 'levels: {L1: {vertices: [[0, 0, {navbake: {number: 1}}]]}}\n'
         'navbake: {lanes: [["1", 1]]}', "the number of a node, got '1'"),
        ("a.yaml", "a: b: c", "expected a navigation graph"),
        ("a.yaml", "levels: {}\nlifts: {A: {position: [1, 2], dims: [1, 1]}}", "3 numbers, got"),
        ("a.yaml", "levels: {}\nlifts: {A: {position: [1, 2, x], dims: [1, 1]}}", "number"),
        ("a.yaml", "levels: {}\nlifts: {A: 3}", "lifts"),
        ("a.yaml", "levels: {}\ndoors: {A: {map: L9}}", "the name of a level, got 'L9'"),
        ("a.yaml", "levels: {L: {}}\ndoors: {A: {map: L, endpoints: [1]}}", "two points"),
        ("a.graphml", "<x", "expected GraphML"),
        ("a.graphml", "<graphml><graph edgedefault='directed'><node id='a'/></graph></graphml>",
         "a finite number"),
        ("a.gml", "graph [", "expected GML"),
        ("a.gml", "", "expected GML"),
        ("a.gml", "graph [ " * 3000, "expected GML"),
        ("a.gml", "graph [ node [ id 1 label 1 ] ]", "a finite number"),
        ("a.gml", "graph [ node [ id 1 label \"a\" graphics 3 ] ]", "a finite number"),
        ("a.txt", "", r"expected a name that ends as a format that is read does, \.geojson"),
        ("a.pgm", "", r"got \S+a\.pgm$"),
    ],
)  # fmt: skip
def test_broken_files_are_refused_in_a_line(tmp_path, name, text, culprit):
    (tmp_path / name).write_text(text)
    with pytest.raises(FormatError, match=culprit) as caught:
        read_routes(tmp_path / name)
    assert "\n" not in str(caught.value)


def write_graph_with_level(path, level, doorways=""):
    """Write a file of two nodes, one of them on a level, in the form that its name asks for."""
    if path.suffix == ".gml":
        table = f'doorways "{doorways.replace(chr(34), "&quot;")}"' if doorways else ""
        path.write_text(
            f'graph [ {table} node [ id 0 label "a" x 0 y 0 ] '
            f'node [ id 1 label "b" x 1 y 0 level {level} ] ]'
        )
    else:
        nodes = [{"nodeId": "a", "nodePosition": {"x": 0, "y": 0}}]
        nodes += [{"nodeId": "b", "nodePosition": {"x": 1, "y": 0}, "navbake": {"level": level}}]
        content = {"layouts": [{"nodes": nodes, "edges": []}], "navbake": {}}
        path.write_text(json.dumps(content))


@pytest.mark.parametrize("name", ["a.gml", "a.lif"])
@pytest.mark.parametrize("level", [3_000_000_000, 30_000_000, 1000, -1])
def test_level_that_no_building_has_is_refused_before_levels_are_named(tmp_path, name, level):
    write_graph_with_level(tmp_path / name, level)
    with pytest.raises(FormatError, match=f"level from 0 to 999 of node 'b', got {level}"):
        read_routes(tmp_path / name)
    write_graph_with_level(tmp_path / name, 5)
    assert read_routes(tmp_path / name).level_names[5] == "level 5"


def test_doorway_on_an_unknown_level_is_refused(tmp_path):
    doorways = '[{"door": "d", "level": 7, "start": [0, 0], "end": [1, 0]}]'
    write_graph_with_level(tmp_path / "a.gml", 1, doorways)
    with pytest.raises(FormatError, match="expected doorways on known levels, got Doorway"):
        read_routes(tmp_path / "a.gml")


def test_of_nodes_with_one_number_lanes_between_levels_lead_to_the_first(tmp_path):
    vertices = [[x, 0, {"name": name, "navbake": {"number": 1}}] for x, name in enumerate("ab")]
    top = [[0, 0, {"name": "c", "navbake": {"number": 2}}]]
    levels = {"L1": {"vertices": vertices}, "L2": {"vertices": top}}
    own = {"lanes": [[1, 2, {"name": "d"}]]}
    (tmp_path / "a.yaml").write_text(yaml.safe_dump({"levels": levels, "navbake": own}))
    graph = read_routes(tmp_path / "a.yaml")
    ends = [graph.nodes[end].name for end in (graph.lanes[0].start, graph.lanes[0].end)]
    assert ends == ["a", "c"]


def test_graphml_keeps_tabs_and_newlines(tmp_path):
    graph = changed(SMALL, name="hall\tof\nmirrors", room="0\t1")
    write_routes(graph, tmp_path / "a.graphml")
    assert read_routes(tmp_path / "a.graphml") == graph
    write_routes(changed(SMALL, name="a\x01\r"), tmp_path / "a.graphml")
    assert read_routes(tmp_path / "a.graphml").nodes[0].name == "a\ufffd\ufffd"


def test_wrong_nodes_are_refused(tmp_path):
    for graph in (changed(SMALL, name="gate"), changed(SMALL, level=7)):
        write_routes(replace(graph, level_names=tuple("abcdefgh")), tmp_path / "a.geojson")
        content = json.loads((tmp_path / "a.geojson").read_text())
        content["navbake"]["level_names"] = ["a", "b"]
        (tmp_path / "a.geojson").write_text(json.dumps(content))
        with pytest.raises(FormatError, match="unique names on known levels"):
            read_routes(tmp_path / "a.geojson")
    with pytest.raises(FormatError, match=r"a format that is written \(nav2-route, .*, got dxf"):
        SMALL.save(tmp_path / "a", "dxf")


def test_coordinates_and_stops_of_a_lift_are_bounded(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text("levels: {L: {vertices: [[1.0e30, 0, {}]], lanes: []}}")
    with pytest.raises(FormatError, match=r"coordinates within 1e\+10 m, got 1e\+30 at .*vertices"):
        read_routes(path)
    levels = "".join(
        f"  L{number}: {{vertices: [[0, 0, {{name: a{number}, lift: A}}]], lanes: []}}\n"
        for number in range(250)
    )
    path.write_text(f"levels:\n{levels}")
    with pytest.raises(FormatError, match="expected 200 nodes at most of lift 'A', got 250"):
        read_routes(path)


def test_types_of_graphml_that_are_not_told_are_no_warning(tmp_path, recwarn):
    path = tmp_path / "a.graphml"
    write_routes(EMPTY, path)
    told = path.read_text()
    for key in ("double", "long", "string"):
        path.write_text(told.replace(f'attr.type="{key}"', ""))
        with contextlib.suppress(FormatError):
            read_routes(path)
    assert not recwarn.list
