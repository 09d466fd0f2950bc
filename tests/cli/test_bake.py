"""The command `navbake bake`: what is written, and what is not."""

import os

import pytest

import navbake


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


def test_several_scenes_need_a_folder(folder, run):
    status, _, err = run("bake", "room.yaml", "room.xml", "-o", "one.json")
    assert status == 2
    assert "expected a folder, got one.json" in err


@pytest.mark.parametrize(
    ("arguments", "culprit"),
    [
        (["none.yaml"], "none.yaml"),
        (["none.xml"], "none.xml"),
        (["room.yaml", "--set", "grid.cell_size=5cm"], "`grid.cell_size`"),
        (["room.yaml", "--set", "grid.cellsize=1"], "`grid.cell_size`"),
        (["room.yaml", "--set", "grid.max_cells=10"], "`grid.max_cells`"),
        (["room.yaml", "--set", "scene.geoms=visual", "-o", "none/a.json"], "none/a.json"),
        (["room.yaml", "-o", "room.yaml"], "got room.yaml"),
        (["room.yaml", "-o", "room.xml"], "got room.xml"),
        (["room.yaml", "-o", "room.xml/"], "room.xml/room.grid.json"),
        (["room.yaml", "--set", "output=."], "cannot write .: it is a folder"),
    ],
)
def test_errors_are_one_line_and_nothing_is_written(folder, run, names, arguments, culprit):
    before = (folder / "room.xml").read_text()
    status, out, err = run("bake", *arguments)
    assert (status, out) == (1, "")
    assert err.startswith("navbake: ")
    assert err.count("\n") == 1
    assert culprit in err
    assert names(folder) == ["room.xml", "room.yaml"]
    assert (folder / "room.xml").read_text() == before


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_takes_no_files(folder, run):
    (folder / "locked").mkdir(mode=0o500)
    status, _, err = run("bake", "room.yaml", "-o", "locked/a.json")
    assert (status, "Permission denied" in err) == (1, True)


def test_a_new_folder_without_a_slash_is_told_how_to_write_it(run, names, folder):
    before = names(folder)
    status, _, err = run("bake", "room.yaml", "-o", "grids")
    assert status == 2
    assert "got grids: a new folder is written grids/" in " ".join(err.split())
    assert names(folder) == before
