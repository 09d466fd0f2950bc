"""An audit of graphs of routes finds the faults that are planted in them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from grid_maps import level_from
from navbake.auditor.routes import audit_routes
from navbake.routes.graph import Lane, Node, RouteGraph

# a wall with a gap of 0.4 m, and a room apart
MAP = """
..............######
.......#......#....#
.......#......#....#
.......#......#....#
.......#......#....#
..............#....#
..............#....#
..............#....#
..............#....#
.......#......######
"""
AT = {
    "a": (0.35, -0.35),
    "b": (0.35, -0.75),
    "c": (1.05, -0.75),
    "d": (1.05, -0.25),
    "e": (1.65, -0.45),
}


def graph_of(ends, radius=0.1, **nodes):
    places = {**AT, **nodes}
    names = sorted({end for pair in ends for end in pair[:2]} | nodes.keys())
    lanes = [
        Lane(names.index(a), names.index(b), a + b, 1.0, 1.0, two_way=not one_way)
        for a, b, *one_way in ends
    ]
    made = tuple(Node(name, (*places[name], 0.0), nodes.get("levels", 0)) for name in names)
    return RouteGraph(made, tuple(lanes), radius=radius)


GOOD = ["ab", "bc", "cd"]


def said(graph, **options):
    level = level_from(MAP)
    return [str(remark) for remark in audit_routes(graph, level, **options).remarks]


def test_a_good_graph():
    assert said(graph_of(GOOD)) == ["remark: level 0 (0.35, -0.35, 0.00): 2 dead ends: 'a', 'd'"]
    assert said(graph_of([*GOOD, "da"]))[0].startswith("error")


@pytest.mark.parametrize(
    ("graph", "text"),
    [
        (graph_of([*GOOD, "ad"]), "(0.75, -0.25, 0.00): lane 'ad' crosses what is occupied"),
        (
            graph_of(GOOD, radius=0.3),
            "lane 'bc' passes an obstacle at 0.150 m, the agent needs 0.3",
        ),
        (graph_of([*GOOD, "cx"], x=(0.75, -0.35)), "node 'x' stands where no cell is free"),
        (graph_of([*GOOD, "cx"], x=(0.05, 0.15)), "node 'x' lies outside of the grid"),
        (graph_of([*GOOD, "cx"], x=(2.05, -0.75)), "node 'x' lies outside of the grid"),
        (graph_of([*GOOD, ("b", "a", True)]), "dead ends"),
        (graph_of([*GOOD[1:], ("b", "a", True)]), "no lanes lead back from 'a' to 'b'"),
        (graph_of(GOOD, e=AT["e"]), "no lane joins 1 node, 'e' first, with most others"),
        (RouteGraph((), ()), "the graph has no nodes"),
    ],
)
def test_faults_are_named(graph, text):
    assert any(text in line for line in said(graph))


def test_radius_levels_and_islands():
    assert any("the agent needs 0.25 m" in line for line in said(graph_of(GOOD), radius=0.25))
    assert not any("error" in line for line in said(graph_of(GOOD, radius=0.3), radius=0.0))
    graph = graph_of(GOOD)
    high = replace(graph, nodes=tuple(replace(node, level=1) for node in graph.nodes))
    assert any("is on level 1, which the grid hasn't" in line for line in said(high))
    rows = "\n".join(["." * 45 + "#" + "." * 45] * 50)
    level = level_from(rows)
    one = RouteGraph((Node("a", (0.35, -0.35, 0.0)),), ())
    text = [str(remark) for remark in audit_routes(one, level).remarks]
    assert text[-1] == "remark: level 0 (4.65, -0.05, 0.00): no node is on island 2 (22.50 m²)"
