"""The graph of rooms: that of the samples is the room table's, and openings have their widths."""

from __future__ import annotations

import math
import sys

import networkx
import numpy as np
import pytest

import navbake
from grid_maps import house_from, level_from
from navbake.errors import MissingDependencyError
from project_paths import GOLDEN


def rooms_of(rows):
    """A level from a map of rooms: a digit is a free cell of this room, ``#`` is occupied."""
    level = level_from("\n".join(rows).translate(str.maketrans("0123456789", "." * 10)))
    digits = [[int(c) if c.isdigit() else 0 for c in row] for row in rows]
    level.attributes["roomIndex"] = np.array(digits, dtype=np.uint16)
    return level


def door(number, closed, rooms, state="open", level=0, width=7):
    ids = sorted(row * width + col for row, col in closed)
    cells = {"closed": [[level, [v for cell in ids for v in (cell, 1)]]], "open": []}
    return {"id": f"door {number}", "joint": None, "rooms": rooms, "state": state, "cells": cells}


def ways_of(grid):
    return [(*w.rooms, w.kind, w.door, w.passable) for w in grid.to_graph("rooms").ways]


@pytest.mark.parametrize("name", ["apartment", "clutter", "house", "terrain", "warehouse"])
def test_samples_have_the_ways_of_their_tables(name):
    grid = navbake.load(GOLDEN / f"{name}.grid.json.gz")
    graph = grid.to_graph("rooms")
    table = {
        (frozenset((room.id, n.room)), n.kind, n.door)
        for room in grid.rooms
        for n in room.neighbours
    }
    out = {d.id for d in grid.doors if None in d.rooms}
    ways = {(frozenset(w.rooms), w.kind, w.door) for w in graph.ways if w.door not in out}
    assert ways == table
    leads_out = [w for w in graph.ways if w.door in out]
    assert len(leads_out) == len(out)
    assert all(w.rooms[0] == "(outside)" and not w.passable for w in leads_out)
    levels = {room.id: room.level for room in grid.rooms}
    for way in graph.ways:
        if way.kind == "link":
            assert levels[way.rooms[0]] != levels[way.rooms[1]]
        if way.kind == "door":
            assert 0.7 < way.width < 1.0 and way.state == "modelled"
        assert grid.cell_at(way.position) is not None
        assert way.length > 0


def test_openings_have_their_width_and_place():
    level = rooms_of(["111222", "11#222", "111222", "111222", "###222", "333333"])
    graph = level.to_graph("rooms")
    second, first, third = graph.ways
    # two openings, one on each side of the obstacle
    assert (first.rooms, first.kind, first.passable) == (("0:1", "0:2"), "open", True)
    assert first.width == pytest.approx(0.1) and second.width == pytest.approx(0.2)
    assert first.position == pytest.approx((0.3, -0.05, 0.0))
    assert second.position == pytest.approx((0.3, -0.3, 0.0))
    assert third.rooms == ("0:2", "0:3") and third.width == pytest.approx(0.3)
    centers = [np.array(room.centroid) for room in graph.rooms]
    assert third.length == pytest.approx(
        sum(math.dist(centers[k], third.position) for k in (1, 2)), abs=1e-5
    )
    # a step too high is no way
    level.attributes["floorHeight"][:4, :3] = 0.5
    assert [w.rooms for w in level.to_graph("rooms").ways] == [("0:2", "0:3")]


def test_a_slanting_opening_is_measured_straight():
    level = rooms_of(["1222", "1122", "1112", "1111"])
    (way,) = level.to_graph("rooms").ways
    assert way.width == pytest.approx(0.3 * math.sqrt(2))


def test_doors_name_their_openings_and_stay_when_closed():
    rows = ["1111111", "1111111", "###1###", "2222222", "2222222"]
    level = rooms_of(rows)
    closed = [(2, 3)]
    level.metadata["navbake"] = {"doors": [door(1, closed, ["0:1", "0:2"])]}
    assert ways_of(level) == [("0:1", "0:2", "door", "door 1", True)]
    assert ways_of(level.with_doors("closed")) == [("0:1", "0:2", "door", "door 1", False)]
    (way,) = level.with_doors("closed").to_graph("rooms").ways
    assert way.state == "closed" and way.width == pytest.approx(0.1)
    assert way.position == pytest.approx((0.35, -0.25, 0.0))
    # something in the way
    with level.block(cells=(0, 2, 3)):
        assert ways_of(level) == [("0:1", "0:2", "door", "door 1", False)]
    # a door elsewhere between these rooms doesn't name the opening, nor one between others
    far = rooms_of(["1" * 20, "1" * 20, "#1" + "#" * 18, "2" * 20, "2" * 20])
    far.metadata["navbake"] = {"doors": [door(1, [(2, 15)], ["0:1", "0:2"], width=20)]}
    assert ways_of(far) == [
        ("0:1", "0:2", "door", "door 1", False), ("0:1", "0:2", "open", None, True),
    ]  # fmt: skip
    level.metadata["navbake"] = {"doors": [door(1, closed, ["0:1", None])]}
    assert ways_of(level) == [
        ("(outside)", "0:1", "door", "door 1", False), ("0:1", "0:2", "open", None, True),
    ]  # fmt: skip
    level.metadata["navbake"] = {"doors": [door(1, closed, [])]}
    assert ways_of(level) == [("0:1", "0:2", "open", None, True)]


def test_links_are_ways_and_far_ones_are_several():
    lower, upper = rooms_of(["1" * 12] * 2), rooms_of(["1" * 12] * 2)
    upper.min_yup = (0.0, 3.0, 0.0)
    upper.attributes["floorHeight"] += np.float32(3.0)
    links = [((0, 0, c), (1, 0, c)) for c in (1, 2, 3, 9)]
    graph = house_from([lower, upper], links=links).to_graph("rooms")
    assert [(w.rooms, w.kind) for w in graph.ways] == [(("0:1", "1:1"), "link")] * 2
    assert [w.width for w in graph.ways] == pytest.approx([0.3, 0.1])
    assert graph.ways[0].position == pytest.approx((0.25, -0.05, 1.5))


def test_cells_without_a_room_are_no_part():
    assert ways_of(rooms_of(["111000222"])) == []
    graph = level_from("..").to_graph("rooms")
    assert (graph.rooms, graph.ways) == ([], [])
    assert len(level_from("#").to_graph("rooms").to_networkx()) == 0


def test_networkx_finds_the_way_through_the_house():
    grid = navbake.load(GOLDEN / "house.grid.json.gz")
    graph = grid.to_graph("rooms").to_networkx()
    assert networkx.shortest_path(graph, "0:4", "1:2", weight="length")[-2:] == ["1:1", "1:2"]
    assert graph.nodes["0:1"]["outdoors"] and not graph.nodes["1:1"]["outdoors"]
    assert graph.nodes["1:1"]["level_name"] == "level 1"
    assert {e["door"] for *_, e in graph.edges("0:4", data=True)} == {
        "door_kitchen", "door_stair_kitchen",
    }  # fmt: skip


@pytest.mark.parametrize("name", ["apartment", "house", "terrain"])
def test_networkx_reads_graphml(tmp_path, name):
    grid = navbake.load(GOLDEN / f"{name}.grid.json.gz")
    (path,) = grid.convert(tmp_path / "rooms.graphml")
    read, graph = networkx.read_graphml(path), grid.to_graph("rooms").to_networkx()
    assert dict(read.nodes(data=True)) == dict(graph.nodes(data=True))

    def listed(found):
        return sorted(
            # of a multigraph, the file numbers the edges
            (sorted(ends), sorted(item for item in entry.items() if item[0] != "id"))
            for *ends, entry in found.edges(data=True)
        )

    assert listed(read) == listed(graph)
    grid.convert(tmp_path / "again.graphml")
    assert (tmp_path / "again.graphml").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("rows", [["11222"], ["111#222", "1111222", "111#222", "1111222"]])
def test_graphml_is_one_kind_of_graph_whether_or_not_two_rooms_have_several_ways(tmp_path, rows):
    level = rooms_of(rows)
    (path,) = level.convert(tmp_path / "rooms.graphml")
    read = networkx.read_graphml(path, force_multigraph=True)
    graph = level.to_graph("rooms").to_networkx()
    assert type(read) is type(graph) is networkx.MultiGraph
    assert len(read.edges) == len(graph.edges) >= 1
    keys = [key for *_, key in read.edges(keys=True)]
    assert len({*keys}) == len(keys)


def test_networkx_reads_gml(tmp_path):
    grid = navbake.load(GOLDEN / "house.grid.json.gz")
    (path,) = grid.convert(tmp_path / "rooms.gml")
    read, graph = networkx.read_gml(path), grid.to_graph("rooms").to_networkx()
    assert type(read) is networkx.MultiGraph
    assert dict(read.nodes(data="name")) == dict(graph.nodes(data="name"))
    doors = [sorted(door for *_, door in found.edges(data="door")) for found in (read, graph)]
    assert doors[0] == doors[1]


def test_graphml_holds_odd_names(tmp_path):
    level = rooms_of(["12"])
    names = ["<a & 'b' \"c\">", "客厅\x01\t\n"]
    level.metadata["navbake"] = {
        "rooms": [
            {"index": k, "id": name, "name": name, "level": 0, "area": 0.01,
             "centroid": [0, 0, 0], "neighbours": []}
            for k, name in enumerate(names, 1)
        ]
    }  # fmt: skip
    (path,) = level.convert(tmp_path / "rooms.graphml")
    read = networkx.read_graphml(path)
    assert list(read) == [names[0], "客厅\ufffd\t\n"]
    assert [entry["name"] for _, entry in read.nodes(data=True)] == list(read)
    assert len(read.edges) == 1
    level_from("#").convert(tmp_path / "none.graphml")
    assert len(networkx.read_graphml(tmp_path / "none.graphml")) == 0


def test_without_networkx_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "networkx", None)
    with pytest.raises(MissingDependencyError, match=r'pip install "navbake\[convert\]"'):
        level_from(".").convert(tmp_path / "rooms.graphml")
    assert not list(tmp_path.iterdir())
