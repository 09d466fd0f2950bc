"""The commands that read scenes, but for `voxelize`: what is written, and what is not."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import pytest
import trimesh

import navbake
from command_line import run_command
from navbake.config.settings import load_config
from navbake.formats.navgrid import dumps_navgrid
from project_paths import GOLDEN, ROOT


def test_bakes_a_yaml(folder, run):
    status, out, err = run("bake", "room.yaml")
    assert (status, err) == (0, "")
    grid = navbake.load("room.grid.json")
    assert (grid.width, grid.height, grid.cell_size) == (12, 8, 0.5)
    lines = out.splitlines()
    assert lines[0] == "room.grid.json"
    assert "level 0" in lines[2]
    assert "12 x 8" in lines[2]
    assert all(stage in lines[-1] for stage in ("scene", "columns", "floors", "occupancy"))
    Path("room2.yaml").write_text(Path("room.yaml").read_text())
    _, out, _ = run("bake", "room2.yaml")
    assert out.splitlines()[0] == "room.grid.json (replaced)"


def test_a_warning_that_comes_before_the_work_comes_once(folder, run):
    box = trimesh.creation.box(extents=(300.0, 200.0, 250.0))
    box.export("box.stl")
    _, out, err = run("bake", "box.stl", "--set", "grid.cell_size=5", "--set", "floors.roofs=true")
    lines = (out + err).splitlines()
    assert sum("metre" in line for line in lines) == 1, lines


def test_bakes_a_scene_with_settings_on_the_command_line(folder, run):
    arguments = ("--set", "grid.cell_size=1", "--set", "scene.id=hall", "--threads", "1")
    status, _, _ = run("bake", "room.xml", *arguments)
    assert status == 0
    grid = navbake.load("hall.grid.json")
    assert (grid.scene_id, grid.cell_size) == ("hall", 1.0)


def test_output_of_the_settings_and_of_the_command_line(folder, run, names):
    (folder / "grids").mkdir()
    assert run("bake", "room.yaml", "--set", "output=grids/a.json")[0] == 0
    assert run("bake", "room.yaml", "--set", "output=grids/c.json", "-o", "grids/b.json")[0] == 0
    assert run("bake", "room.yaml", "-o", "grids")[0] == 0
    assert run("bake", "room.yaml", "-o", "new/deep/")[0] == 0
    assert names(folder) == [
        "grids/a.json",
        "grids/b.json",
        "grids/room.grid.json",
        "new/deep/room.grid.json",
        "room.xml",
        "room.yaml",
    ]


URDF = """<robot name="cell"><link name="base">
  <collision><geometry><mesh filename="package://parts/floor.obj"/></geometry></collision>
</link></robot>"""
FLOOR = (
    "v 0 0 0\nv 4 0 0\nv 4 4 0\nv 0 4 0\nv 2 2 -1\nf 1 2 3 4\nf 1 5 2\nf 2 5 3\nf 3 5 4\nf 4 5 1\n"
)


@pytest.mark.parametrize(
    "command",
    [
        ("bake", "cell.urdf"),
        ("geoms", "cell.urdf"),
        ("voxelize", "cell.urdf", "--res", "0.5", "-o", "cell.bt"),
        ("batch", "cell.urdf", "-o", "grids", "--jobs", "1"),
        ("fly", "cell.urdf", "--radius", "0.2", "--from", "1,1,0.5", "--to", "3,3,0.5"),
        ("verify", "cell.grid.json", "--scene", "cell.urdf"),
    ],
)
def test_packages_are_found_in_folders_of_the_command_line(folder, run, command):
    """Where a message says `--model-path`, the command has it."""
    (folder / "cell.urdf").write_text(URDF)
    (folder / "ros" / "parts").mkdir(parents=True)
    (folder / "ros" / "parts" / "floor.obj").write_text(FLOOR)
    if command[0] == "verify":
        assert run("bake", "cell.urdf", "--model-path", "ros", "-q")[0] == 0
    status, out, err = run(*command)
    assert status == 1 and "by `--model-path`" in out + err
    assert run(*command, "--model-path", "ros")[0] == 0
    status, _, err = run(*command, "--model-path", "rso")
    assert status == 2 and "--model-path: no folder rso" in err


@pytest.mark.parametrize(
    "command",
    [
        ("bake", "yard.world"),
        ("geoms", "yard.world"),
        ("voxelize", "yard.world", "-o", "yard.bt"),
        ("batch", "yard.world", "-o", "grids", "--jobs", "1"),
        ("fly", "yard.world", "--radius", "0.2", "--from", "1,1,0.5", "--to", "3,3,0.5"),
    ],
)
def test_models_that_are_missing_are_refused_where_asked(folder, run, command):
    """Where a message says `--strict`, the command has it."""
    (folder / "yard.world").write_text(
        """<sdf version="1.6"><world name="w"><include><uri>model://chair</uri></include>
        <model name="m"><static>1</static><link name="l"><collision name="c"><geometry><box>
        <size>3 3 0.1</size></box></geometry></collision></link></model></world></sdf>"""
    )
    status, out, err = run(*command, "--strict")
    assert status == 1 and "'model://chair', not found" in out + err


def test_a_scene_that_cannot_be_read_is_refused_before_kernels_are_compiled(
    folder, run, monkeypatch
):
    def refuse_to_compile(*_):
        raise AssertionError("kernels are compiled")

    monkeypatch.setattr("navbake.baker.bake.stages.ensure_compiled", refuse_to_compile)
    (folder / "cell.urdf").write_text(URDF)
    for scene, message in (("cell.urdf", "not found there"), ("gone.xml", "no scene file")):
        status, _, err = run("bake", scene)
        assert status == 1 and message in err


def test_quiet(folder, run):
    assert run("bake", "room.yaml", "--quiet") == (0, "", "")


def test_one_failure_does_not_stop_the_others(folder, run, names):
    (folder / "bad.yaml").write_text("scene: {path: room.xml}\ngrid: {cell_size: 0}")
    (folder / "last.yaml").write_text("scene: {path: room.xml, id: last}\ngrid: {cell_size: 0.5}")
    status, out, err = run("bake", "room.yaml", "bad.yaml", "last.yaml", "-o", "grids/")
    assert status == 1
    assert err.splitlines() == [
        "navbake: expected a number > 0, got 0 at `grid.cell_size` in bad.yaml",
        "navbake: 1 of 3 failed",
    ]
    assert "grids/room.grid.json" in out
    assert names(folder / "grids") == ["last.grid.json", "room.grid.json"]


def test_several_scenes_do_not_overwrite_each_other(folder, run):
    status, _, err = run("bake", "room.yaml", "room.xml")
    assert status == 1
    assert "room.xml: room.grid.json was written for another scene" in err


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_takes_no_files(folder, run):
    (folder / "locked").mkdir(mode=0o500)
    status, _, err = run("bake", "room.yaml", "-o", "locked/a.json")
    assert (status, "Permission denied" in err) == (1, True)


HOUSE = str(GOLDEN / "house.grid.json.gz")
COARSE = ("--set", "grid.cell_size=0.5")
ROOMS = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"name": "hall"},
            "geometry": {"type": "Polygon", "coordinates": [[[-3, -2], [3, -2], [3, 2], [-3, 2]]]},
        }
    ],
}


@pytest.fixture
def scenes(folder):
    """Three folders, each with a scene.xml."""
    paths = []
    for name in ("hall", "attic", "deep/cellar"):
        path = folder / "scenes" / name / "scene.xml"
        path.parent.mkdir(parents=True)
        path.write_text((folder / "room.xml").read_text())
        paths.append(path)
    return paths


def test_endings_may_be_in_capitals(folder, run):
    assert run("bake", "room.yaml", "-q", "-o", "a.JSON.GZ") == (0, "", "")
    assert Path("a.JSON.GZ").read_bytes().startswith(b"\x1f\x8b")


def test_no_input_is_overwritten(folder, run):
    rooms = json.dumps(ROOMS)
    (folder / "rooms.json").write_text(rooms)
    (folder / "room.yaml").write_text("scene: {path: room.xml}\nrooms: {polygons: rooms.json}\n")
    os.link(folder / "rooms.json", folder / "linked.json")
    os.symlink("rooms.json", folder / "soft.json")
    for name in ("rooms.json", "./rooms.json", "linked.json", "soft.json"):
        status, _, err = run("bake", "room.yaml", *COARSE, "-o", name)
        assert status == 1 and "expected an output apart from the inputs" in err
    status, _, err = run("bake", "room.yaml", *COARSE, "--set", "output=rooms.json")
    assert status == 1 and "apart from the inputs" in err
    assert (folder / "rooms.json").read_text() == rooms


def test_a_picture_does_not_overwrite_its_grid(folder, run):
    (folder / "a.png").write_bytes(Path(HOUSE).read_bytes())
    assert run("plot", "a.png", "-o", "a.png")[0] == 1
    assert run("path", "a.png", "--from", "0,0", "--to", "1,1", "-o", "a.png")[0] == 1
    assert (folder / "a.png").read_bytes() == Path(HOUSE).read_bytes()


def test_a_grid_on_stdout(folder, capfdbinary, names):
    status, out, err = run_command(capfdbinary, "bake", "room.yaml", "--no-timings", "-o", "-")
    assert status == 0
    grid = navbake.load(out)
    assert out == dumps_navgrid(grid)
    assert b"12 x 8" in err  # what is said goes beside it
    status, out, err = run_command(capfdbinary, "bake", "room.yaml", "-q", "-o", "-")
    assert (status, err) == (0, b"") and navbake.load(out).scene_id == "room"
    status, out, err = run_command(capfdbinary, "inflate", HOUSE, "--radius", 0.2, "-o", "-")
    assert status == 0 and navbake.load(out).scene_id == "house" and b"0.2 m" in err
    assert names(folder) == ["room.xml", "room.yaml"]


def test_a_closed_stdout_takes_no_grid(folder, capsys, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("sys.stdout", None)
        status, _, err = run_command(capsys, "inflate", HOUSE, "--radius", 0.2, "-o", "-", "-q")
    assert (status, err) == (1, "navbake: cannot write to stdout: it is closed\n")


def test_pictures_and_settings_on_stdout(folder, capfdbinary, names):
    status, out, _ = run_command(capfdbinary, "plot", HOUSE, "-o", "-")
    assert status == 0 and out.startswith(b"\x89PNG")
    ends = ("--from", "0,-4.8,L0", "--to", "1,-5,L0")
    status, out, err = run_command(capfdbinary, "path", HOUSE, *ends, "-o", "-")
    assert status == 0 and out.startswith(b"\x89PNG") and b"length" in err
    status, out, _ = run_command(capfdbinary, "init", "room.xml", "-o", "-")
    assert status == 0
    assert names(folder) == ["room.xml", "room.yaml"]
    (folder / "again.yaml").write_bytes(out)
    assert run_command(capfdbinary, "geoms", "again.yaml")[0] == 0


def test_names_of_several_scenes(folder, scenes, run, names):
    assert run("bake", *scenes, *COARSE, "-q", "-o", "a/", "--name", "{parent}") == (0, "", "")
    assert names(folder / "a") == ["attic.grid.json", "cellar.grid.json", "hall.grid.json"]
    name = "{parent}/{stem}-{id}"
    assert run("bake", *scenes[:2], *COARSE, "-q", "-o", "b/", "--name", name) == (0, "", "")
    assert names(folder / "b") == ["attic/scene-scene.grid.json", "hall/scene-scene.grid.json"]
    status, _, err = run("bake", *scenes[:2], *COARSE, "-q", "-o", "c/", "--name", "{id}")
    assert status == 1 and "--name '{parent}-{stem}'" in err
    assert run("bake", "room.xml", scenes[0], *COARSE, "-q", "-o", "flat/") == (0, "", "")
    assert names(folder / "flat") == ["room.grid.json", "scene.grid.json"]


def test_two_bakes_without_timings_are_the_same_bytes(folder, run):
    for name in ("a.json", "b.json"):
        assert run("bake", "room.yaml", "-q", "--no-timings", "-o", name) == (0, "", "")
    assert Path("a.json").read_bytes() == Path("b.json").read_bytes()
    assert navbake.load("a.json").timings == {}
    run("bake", "room.yaml", "-q", "-o", "c.json")
    timed = navbake.load("c.json")
    assert timed.timings
    timed.timings = {}
    assert dumps_navgrid(timed) == Path("a.json").read_bytes()


def test_init_writes_settings_that_bake_the_same(folder, run):
    status, out, _ = run("init", "room.xml", "-o", "made.yaml")
    assert (status, out.startswith("made.yaml")) == (0, True)
    made = load_config("made.yaml")
    assert made.scene.path.samefile("room.xml")
    assert run("init", "room.xml", "-o", "made.yaml")[0] == 1
    assert run("init", "room.xml", "-o", "made.yaml", "--force")[0] == 0
    assert run("init", "room.xml")[0] == 1  # room.yaml is there
    assert run("init", "none.xml")[2] == "navbake: no such file: none.xml\n"


@pytest.mark.parametrize("config", ["room.xml", "room.yaml"])
def test_geoms(folder, run, config):
    status, out, _ = run("geoms", config)
    assert status == 0
    lines = {line.split()[1]: line for line in out.splitlines()[1:-1]}
    assert "wall [b]" in lines["wall"]  # no markup
    assert " yes " in lines["floor"]
    assert " structure " in lines["floor"]
    assert " structure " not in lines["shade"]
    assert " no " in lines["shade"]
    assert out.splitlines()[-1] == "2 geoms counted, 1 left out"


def test_geoms_as_json(folder, run):
    status, out, _ = run("geoms", "room.yaml", "--json", "--set", "scene.geoms=all")
    assert status == 0
    facts = json.loads(out)
    assert facts["scene_id"] == "room"
    assert [geom["name"] for geom in facts["geoms"]] == ["floor", "wall [b]", "shade"]
    assert all(geom["counted"] for geom in facts["geoms"])
    keys = {"id", "name", "body", "type", "group", "counted", "shape", "role", "reason"}
    assert set(facts["geoms"][0]) == keys
    assert {geom["role"] for geom in facts["geoms"]} == {"structure"}


def test_geoms_say_their_group(folder, run):
    geoms = '<geom name="floor" size="1"/><geom name="hidden" size="1" group="3"/>'
    (folder / "groups.xml").write_text(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>")
    facts = json.loads(run("geoms", "groups.xml", "--json", "--set", "scene.geoms=visual")[1])
    assert [(geom["group"], geom["counted"]) for geom in facts["geoms"]] == [(0, True), (3, False)]
    header, _, row = run("geoms", "groups.xml")[1].splitlines()[:3]
    assert header.split()[:5] == ["id", "geom", "body", "type", "group"]
    assert row.split()[4] == "3"


def test_geoms_say_what_can_move(folder, run):
    bodies = (
        '<body name="ball"><freejoint/><geom name="ball" size="0.1"/></body>'
        '<body name="stage"><freejoint/><geom name="boards" size="0.1"/></body>'
    )
    floor = '<geom name="floor" type="box" size="2 2 0.1"/>'
    path = folder / "moving.xml"
    path.write_text(f"<mujoco><worldbody>{floor}{bodies}</worldbody></mujoco>")
    status, out, _ = run("geoms", "moving.xml", "--json", "--set", "floors.movable=[stage]")
    assert status == 0
    roles = {geom["name"]: geom["role"] for geom in json.loads(out)["geoms"]}
    assert roles == {"floor": "structure", "ball": "movable", "boards": "structure that moves"}


def test_bake_names_the_stairs_and_doors_that_its_radius_closes(run, tmp_path):
    output = tmp_path / "house.grid.json"
    status, _, err = run("bake", "house", "--radius", 0.45, "-o", output)
    assert status == 0
    assert "a radius of 0.45 m closes the stairs between level 0 and 1 near (1.50, 3.25)" in err
    assert "door 'door_front'" in err
    _, _, err = run("bake", "house", "--radius", 0.15, "-o", output)
    assert "closes" not in err


FORMS = """
<mujoco>
  <asset><mesh name="tent" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>
  <worldbody>
    <geom name="ground" type="plane" size="0 0 .1"/>
    <geom name="box" type="box" size=".1 .1 .1" pos="3 0 .1"/>
    <geom name="wall" type="plane" size="1 1 .1" euler="90 0 0"/>
    <geom name="fence" type="plane" size="0 1 .1" euler="90 0 0" pos="0 4 0"/>
    <geom name="hull" type="mesh" mesh="tent" pos="2 2 0"/>
    <geom name="closed" type="mesh" mesh="tent" pos="-2 2 0"/>
    <geom name="shell" type="mesh" mesh="tent" pos="-2 -2 0"/>
  </worldbody>
</mujoco>
"""


def test_the_page_has_the_form_of_each_geom(folder, run):
    (folder / "forms.xml").write_text(FORMS)
    meshes = "scene.meshes={hull: hull, closed: surface, shell: shell}"
    status, out, _ = run("geoms", "forms.xml", "--json", "--set", meshes)
    forms = {geom["name"]: geom["shape"] for geom in json.loads(out)["geoms"]}
    page = (ROOT / "docs" / "command_line.md").read_text(encoding="utf-8")
    table = page.partition("| `as` | what it is in the bake |")[2].partition("\n\n")[0]
    rows = re.findall(r"^\| ([^|]+) \|", table, flags=re.MULTILINE)
    listed = {form for row in rows for form in re.findall(r"`([^`]+)`", row)}
    assert status == 0
    assert forms["ground"] == "half-space" and forms["hull"] == "hull"
    assert {*forms.values()} == listed - {"surface", "partly closed surface"}
