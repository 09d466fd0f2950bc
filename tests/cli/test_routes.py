"""The command `navbake routes`, and `audit` of graphs."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from navbake.formats.route_files import read_routes
from project_paths import GOLDEN


@pytest.fixture(autouse=True)
def house(tmp_path, monkeypatch):
    """The current folder, with a house in it."""
    shutil.copy(GOLDEN / "house.grid.json.gz", tmp_path / "house.json.gz")
    monkeypatch.chdir(tmp_path)


def test_makes_and_audits_a_graph(run):
    status, out, err = run("routes", "house.json.gz", "-o", "a.geojson", "--stairs", "free")
    graph = read_routes("a.geojson")
    counts = f"{len(graph.nodes)} nodes, {len(graph.lanes)} lanes"
    assert (status, out) == (0, f"a.geojson: {counts} for a radius of 0.2 m\n")
    assert err.startswith("navbake: nav2 knows no levels")
    status, out, _ = run("audit", "a.geojson", "--grid", "house.json.gz")
    assert status == 0 and out.endswith("5 checks: 0 errors, 1 remark\n")


def test_a_map_states_the_radius_that_its_cells_are_blocked_for(run):
    run("convert", "house.json.gz", "map.yaml", "--level", 1, "--radius", 0.3)
    run("routes", "house.json.gz", "-o", "b.json", "--radius", 0.3, "--level", 1)
    for radius in (("--radius", 0), ("--radius", 0.2), ()):
        assert run("audit", "b.json", "--grid", "map.yaml", *radius)[0] == 0
    run("routes", "house.json.gz", "-o", "c.json", "--level", 1)  # for 0.2 m
    assert run("audit", "c.json", "--grid", "map.yaml", "--radius", 0)[0] == 1
    # a map of another program states none
    content = Path("map.yaml").read_text()
    Path("map.yaml").write_text(content.replace(", radius: 0.3", ""))
    assert run("audit", "b.json", "--grid", "map.yaml", "--radius", 0)[0] == 0
    status, out, _ = run("audit", "b.json", "--grid", "map.yaml", "-o", "b.png")
    assert status == 1 and Path("b.png").exists()
    lines = out.splitlines()
    assert len(lines) == 24 and lines[-1] == "b.png"
    assert re.search(r"passes an obstacle at 0\.\d+ m, the agent needs 0\.3 m", lines[0])
    assert re.fullmatch(r"and \d+ more: --json lists them", lines[20])
    assert lines[21] == "map.yaml states no radius: --radius 0 if its cells are inflated already"
    status, out, _ = run("audit", "b.json", "--grid", "map.yaml", "--json")
    remarks = json.loads(out)["remarks"]
    assert len(remarks) > 20 and remarks[0]["check"] == "lanes"


def test_a_map_is_audited_as_it_is(run):
    run("convert", "house.json.gz", "map.yaml", "--level", 1)
    status, out, _ = run("audit", "map.yaml", "-o", "map.png")
    assert status == 0 and out.endswith(" checks: 0 errors, 0 remarks\nmap.png\n")
    assert Path("map.png").exists()


def test_lanes_for_nav2_leave_the_stairs_out_as_its_maps_do(run):
    for words, climbs in (
        (("-o", "a.geojson"), False),
        (("-o", "a.geojson", "--stairs", "free"), True),
        (("-o", "a.lif"), True),
        (("-o", "a.lif", "--stairs", "occupied"), False),
    ):
        status, _, err = run("routes", "house.json.gz", *words)
        kinds = {lane.kind for lane in read_routes(words[1]).lanes}
        assert status == 0 and ("stairs" in kinds) == climbs
        assert ("no lanes lead over stairs and floors beyond them (5." in err) != climbs


def test_graphs_are_converted_from_format_to_format(run):
    run("routes", "house.json.gz", "-o", "a.gml")
    graph = read_routes("a.gml")
    assert run("audit", "a.gml", "--grid", "house.json.gz")[0] == 0
    for step in (
        ("a.gml", "b.graphml"),
        ("b.graphml", "c.lif"),
        ("c.lif", "d.json"),
        ("d.json", "e.nav.yaml", "--from", "lif"),
        ("e.nav.yaml", "f.gml", "--from", "rmf"),
    ):
        assert run("convert", *step)[:2] == (0, f"{step[1]}\n")
        assert read_routes(step[1]) == graph
    for words, expected in (
        (("a.gml", "-"), "stdout has no ending"),
        (("a.gml", "x.npz"), "expected a name that ends as a format that is written does"),
        (("a.gml", "x.json", "--radius", 1), "--radius"),
        (("a.gml", "a.gml"), "a.gml"),
        (("d.json", "x.json"), "'SceneGrid2D'"),
    ):
        status, _, err = run("convert", *words)
        assert status != 0 and expected in err
    assert run("convert", "a.gml", "-", "--to", "lif")[1].startswith('{"metaInformation"')


def test_writes_any_format_to_stdout(run):
    status, out, _ = run("routes", "house.json.gz", "-o", "-", "--to", "rmf", "--level", 1)
    Path("a.yaml").write_text(out)
    assert status == 0 and len(read_routes("a.yaml").nodes) > 20


@pytest.mark.parametrize(
    ("arguments", "status", "culprit"),
    [
        (["routes", "house.json.gz", "-o", "a.txt"], 2, "written does, .geojson"),
        (["routes", "house.json.gz", "-o", "-"], 2, "stdout has no ending"),
        (["routes", "house.json.gz", "-o", "a.json", "--to", "dxf"], 2, "got dxf"),
        (["routes", "house.json.gz", "-o", "a.json", "--agent", "robot"], 1, "no agent 'robot'"),
        (["routes", "house.json.gz", "-o", "a.json", "--level", "2"], 1, "no level 2"),
        (["routes", "house.json.gz", "-o", "a.json", "--radius", "-1"], 1, "0 to 10,000 m"),
        (["audit", "house.json.gz", "--radius", "1"], 2, "--grid"),
    ],
)
def test_wrong_usage(run, arguments, status, culprit):
    code, _, err = run(*arguments)
    assert code == status and culprit in " ".join(err.split())
    assert not Path("a.json").exists()
