"""Batches: what is baked, what is skipped, what becomes of scenes that fail."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import shutil
import sys
from functools import partial
from pathlib import Path
from unittest.mock import Mock

import pytest

import navbake
from batch_in_process import run_sources, stay_in_process
from batch_scenes import CHEST, draw_room, write_scenes, wrong_rows
from navbake import bake, files, samples
from navbake.baker.pipeline import run_bake
from navbake.batch import index as index_module
from navbake.batch import products, work
from navbake.batch.batch import Means
from navbake.batch.crew import JobLimits
from navbake.batch.index import NAME, only_batch, read_index
from navbake.batch.manifest import list_jobs
from navbake.batch.products import NOTE
from navbake.config.settings import load_config
from navbake.errors import ConfigError, MissingDependencyError, NavbakeError, SceneError
from project_paths import ROOT

SETTINGS = {"grid": {"cell_size": 0.2}}
run = partial(run_sources, settings=SETTINGS)
MESHED = """<mujoco>
<asset>
  <mesh name="chest" file="chest.obj"/>
  <texture name="wood" type="2d" file="wood.png"/><material name="wood" texture="wood"/>
</asset>
<worldbody>
  <include file="floor.xml"/><geom type="mesh" mesh="chest" material="wood"/>
</worldbody></mujoco>"""
FLOOR = '<mujoco><geom type="box" size="{half} 2 .1" pos="0 0 -.1"/></mujoco>'


@pytest.fixture
def here(monkeypatch):
    """Jobs are done in this process, one after another."""
    stay_in_process(monkeypatch)


@pytest.fixture
def scenes(tmp_path, monkeypatch):
    """The current folder, with three scenes in `scenes`; `meshed` has files of its own."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "scenes"
    folder.mkdir()
    for number, name in enumerate(("first", "second")):
        (folder / f"{name}.xml").write_text(draw_room(number))
    (folder / "meshed.mjcf.xml").write_text(MESHED)
    (folder / "chest.obj").write_text(CHEST.format(height=1))
    (folder / "floor.xml").write_text(FLOOR.format(half=2))
    write_texture(folder, 0)
    return folder


def write_texture(folder, shade):
    from PIL import Image

    Image.new("RGB", (2, 2), (shade,) * 3).save(folder / "wood.png")


def digests(folder):
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in Path(folder).rglob("*")
        if path.is_file() and path.name != NAME
    }


ALL = ("scenes/first.xml", "scenes/second.xml", "scenes/meshed.mjcf.xml")


@pytest.mark.skipif(sys.platform != "linux", reason="pipes, and limits of memory")
def test_scenes_that_fail_hang_or_crash_cost_themselves_alone(tmp_path):
    expected = write_scenes(tmp_path / "scenes", 6, broken=10, endings=True)
    source, hanging = tmp_path / "scenes" / "list.jsonl", tmp_path / "scenes" / "hangs.xml"
    lines = source.read_text().splitlines(keepends=True)
    source.write_text("".join(line for line in lines if hanging.name not in line))
    # no scene but the one that hangs is near a limit of time, however busy the machine is
    means = Means(workers=2, limits=JobLimits(seconds=300.0, memory=0.7))
    _, result = run(str(source), out=tmp_path / "out", means=means)
    assert [row["id"] for row in result.rows] == [job.id for job in list_jobs([str(source)])]
    assert list(read_index(tmp_path / "out").values()) == result.rows
    assert (result.count("ok"), result.count("failed"), result.count("left")) == (6, 12, 0)
    good = sorted(name for name, how in expected.items() if how.how == "ok")
    sources = [str(hanging), *(str(tmp_path / "scenes" / f"{name}.xml") for name in good)]
    means = Means(workers=2, limits=JobLimits(seconds=1.0))
    names, result = run(*sources, out=tmp_path / "out", means=means)
    assert names == ["hangs"] and result.skipped == 6
    assert wrong_rows([*read_index(tmp_path / "out").values()], expected) == []
    assert sorted(path.parent.name for path in (tmp_path / "out").glob("*/*")) == good
    grid = navbake.bake(tmp_path / "scenes" / "good-0003.xml", grid=SETTINGS["grid"])
    grid.timings = {}
    grid.save(tmp_path / "one.json.gz")
    made = tmp_path / "out" / "good-0003" / "grid.json.gz"
    assert made.read_bytes() == (tmp_path / "one.json.gz").read_bytes()


def test_the_disk_is_waited_for_once_before_the_index_is_put_in_order(scenes, here, monkeypatch):
    calls = []
    monkeypatch.setattr(os, "fsync", lambda number: calls.append("file"))
    monkeypatch.setattr(index_module, "wait_for_disk", lambda folder: calls.append(str(folder)))
    run(*ALL)
    assert calls == ["out", "file"]  # the grids, and the index itself
    calls.clear()
    run(*ALL)
    assert calls == ["file"]  # all is done


def test_no_row_follows_half_of_another_where_the_disk_gets_full(tmp_path, monkeypatch):
    index, real = index_module.Index(tmp_path), os.write
    index.add({"id": "a"})
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda file, data: real(file, data[:3]))
        index.add({"id": "b"})  # there is room again
        index.add({"id": "c"})
    index.close()
    assert [*read_index(tmp_path)] == ["a", "b", "c"]


def test_what_is_done_is_skipped_and_what_failed_is_tried_again(scenes, here):
    (scenes / "bad.xml").write_text("<mujoco>")
    names, first = run(*ALL, "scenes/bad.xml")
    assert names == ["first", "second", "meshed.mjcf", "bad"]
    before = digests("out")
    names, again = run(*ALL, "scenes/bad.xml")
    assert names == ["bad"] and again.skipped == 3
    assert digests("out") == before
    assert again.rows[:3] == first.rows[:3]
    row = again.rows[0]
    assert row["source"] == "../scenes/first.xml" and row["levels"] == 1
    assert row["cells"] == 400 and 12 < row["free_area"] < 16 and row["warnings"] == []
    assert set(again.rows[2]["inputs"]) == {
        f"../scenes/{name}" for name in ("meshed.mjcf.xml", "chest.obj", "floor.xml")
    }


def test_a_changed_file_of_a_scene_is_noticed_and_a_texture_is_not(scenes, here):
    run(*ALL)
    write_texture(scenes, 200)
    assert run(*ALL)[0] == []
    for name, content in (
        ("chest.obj", CHEST.format(height=2)),
        ("floor.xml", FLOOR.format(half=3)),
        ("first.xml", draw_room(7)),
    ):
        (scenes / name).write_text(content)  # of the same size, and within the same second
        assert run(*ALL)[0] == ["first" if name == "first.xml" else "meshed.mjcf"], name
    os.utime(scenes / "second.xml", (1, 1))  # the content is the same
    assert run(*ALL)[0] == []
    (scenes / "second.xml").unlink()
    Path("list.txt").write_text("\n".join(ALL))
    assert run("list.txt")[1].rows[1]["error"].startswith("no scene file")
    assert not Path("out/second/grid.json.gz").exists()


def test_changed_settings_and_another_file_of_the_same_name_are_noticed(scenes, here):
    run("scenes/first.xml")
    assert run("scenes/first.xml", overrides=["agent.radius=0.1"])[0] == ["first"]
    assert run("scenes/first.xml", settings={})[0] == ["first"]
    assert run("scenes/first.xml", settings={})[0] == []
    assert run("scenes/first.xml", settings={"verify": {"sample": 3}})[0] == ["first"]
    (scenes / "else").mkdir()
    (scenes / "else" / "first.xml").write_text(draw_room(9))
    assert run("scenes/else/first.xml", settings={})[0] == ["first"]


def test_an_id_may_have_folders(scenes, here):
    Path("list.txt").write_text("scenes/first.xml\nelse/first.xml\n")
    Path("else").mkdir()
    shutil.copy("scenes/first.xml", "else")
    assert run("list.txt")[1].count("ok") == 2
    assert navbake.load("out/else/first/grid.json.gz").metadata["sceneId"] == "else_first"
    assert run("list.txt")[0] == []


def test_a_resume_may_run_in_another_folder(scenes, here, monkeypatch):
    run(*ALL)
    index = Path("out", NAME).read_bytes()
    monkeypatch.chdir(scenes)
    assert run(*(Path(name).name for name in ALL), out="../out")[0] == []
    assert Path("../out", NAME).read_bytes() == index
    shutil.move(scenes.parent, scenes.parent.with_name("moved"))  # with their folder
    monkeypatch.chdir(scenes.parent.with_name("moved"))
    assert run(*ALL)[0] == []


def names_in_docs():
    """The files that the docs list of a scene of one level."""
    text = (ROOT / "docs" / "batch.md").read_text("utf-8")
    table = text.split("\n## What is made\n\n")[1].split("\n\n")[0]
    cells = [line.split("|")[2] for line in table.splitlines()]
    files = [cell.split("; of several levels")[0] for cell in cells]
    return {name for cell in files for name in re.findall(r"`([\w.-]+\.\w+)`", cell)}


def test_products_are_made_missed_and_removed(scenes, here):
    make = [
        *("inflated:0.30", "inflated:0.3:0.1", "nav2", "nav2:0.3", "picture", "report"),
        *("voxels:0.5", "voxels:0.5:bt", "voxels:0.5:ot", "voxels:0.5:npz"),
    ]
    run("scenes/first.xml", products=make)
    assert {path.name for path in Path("out/first").iterdir()} == names_in_docs() | {NOTE}
    inflated = navbake.load("out/first/grid.json.gz").inflate(0.3)
    inflated.save("inflated.json.gz")
    assert (
        Path("inflated.json.gz").read_bytes() == Path("out/first/inflated-0.3.json.gz").read_bytes()
    )
    before = digests("out")
    assert run("scenes/first.xml", products=make)[0] == []
    Path("out/first/picture.png").unlink()
    assert run("scenes/first.xml", products=make)[0] == ["first"]
    Path("out/first/report.html").write_text("changed")
    assert run("scenes/first.xml", products=make)[0] == ["first"]
    assert digests("out") == before
    Path("out/first/notes.txt").write_text("mine")
    assert run("scenes/first.xml", products=["report", "report"])[0] == ["first"]
    left = {path.name for path in Path("out/first").iterdir()}
    assert left == {"grid.json.gz", "report.html", "notes.txt", NOTE}


def test_files_of_the_user_in_a_scene_s_folder_stay(tmp_path, monkeypatch, here):
    monkeypatch.chdir(tmp_path)
    place = Path("houses", "0001")
    place.mkdir(parents=True)
    (place / "scene.xml").write_text(draw_room(0))
    Path("list.csv").write_text("scene,id\nhouses/0001/scene.xml,houses/0001\n")
    names = ("thumbnail.png", "picture.png", "report.html", "nav2.pgm", "voxels-0.1.npz")
    for name in names:
        (place / name).write_text("mine")
    before = {path.name: path.read_bytes() for path in place.iterdir()}

    def made():
        """What is there besides the user's files, which are as they were."""
        now = {path.name: path.read_bytes() for path in place.iterdir()}
        assert before.items() <= now.items()
        return now.keys() - before.keys()

    grid = {"grid.json.gz"}
    again = ["agent.radius=0.1"]
    assert run("list.csv", out=".")[1].count("ok") == 1 and made() == grid
    assert run("list.csv", out=".", overrides=again)[1].count("ok") == 1 and made() == grid
    run("list.csv", out=".", products=["inflated:0.3"])
    assert made() == {*grid, "inflated-0.3.json.gz", NOTE}
    Path(NAME).unlink()
    assert run("list.csv", out=".")[0] == ["houses/0001"] and made() == grid
    for name in ("nav2.pgm", "thumbnail.png"):  # which are asked for now
        before.pop(name)
    run("list.csv", out=".", products=["nav2"], thumbnails=True)
    assert made() == {*grid, "nav2.pgm", "nav2.yaml", "thumbnail.png", NOTE}
    before.pop("scene.xml")
    (place / "scene.xml").write_text("<mujoco>")
    assert run("list.csv", out=".")[1].count("failed") == 1 and made() == {"scene.xml"}


def test_a_user_s_file_is_replaced_whole_or_stays(scenes, here, monkeypatch):
    Path("out/first").mkdir(parents=True)
    Path("out/first/report.html").write_text("mine")
    with monkeypatch.context() as patch:
        patch.setattr(products.Product, "make", Mock(side_effect=NavbakeError("broken")))
        assert run(ALL[0], products=["nav2", "report"])[1].count("failed") == 1
    assert os.listdir("out/first") == ["report.html"]
    assert Path("out/first/report.html").read_text() == "mine"


@pytest.mark.parametrize("then", ["made anew", "fails", "is lost"])
def test_what_a_killed_worker_made_is_removed_whatever_the_index_says(
    scenes, here, monkeypatch, then
):
    Path("out/first").mkdir(parents=True)
    Path("out/first/picture.png").write_text("mine")
    with monkeypatch.context() as patch:
        patch.setattr(work, "write_navgrid", Mock(side_effect=KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            run(ALL[0], products=["nav2", "report"], thumbnails=True)
    made = {"nav2.pgm", "nav2.yaml", "report.html", "thumbnail.png", NOTE}
    assert {*os.listdir("out/first")} == made | {"picture.png"}
    Path("out", NAME).unlink()
    if then == "is lost":  # with its worker: the batch's own process clears up
        job = list_jobs([ALL[0]])[0]
        row = work.fail(work.Order(job, SETTINGS, (), (), Path("out")), "too long", "60 s")
        assert row["status"] == "failed"
    if then == "fails":
        Path(ALL[0]).write_text("<mujoco>")
    if then != "is lost":
        run(ALL[0])
    grid = {"grid.json.gz"} if then == "made anew" else set()
    assert {*os.listdir("out/first")} == {"picture.png"} | grid


def test_a_note_of_a_stranger_names_nothing_but_products(tmp_path):
    (tmp_path / "a").mkdir()
    for name in ("b.txt", "a/b.txt", "a/report.html", "a/nav2.yaml"):
        (tmp_path / name).write_text("mine")
    note = tmp_path / "a" / NOTE
    note.write_bytes(b"../b.txt\nb.txt\n\n.\nreport.html\n\xff\n")
    products.remove_products(tmp_path / "a")
    assert sorted(os.listdir(tmp_path / "a")) == ["b.txt", "nav2.yaml"]
    assert (tmp_path / "b.txt").exists()


@pytest.mark.parametrize("num_levels", [1, 2])
def test_the_names_of_products_are_known_before_they_are_made(tmp_path, num_levels):
    path = samples.path("apartment" if num_levels == 1 else "house")
    config = load_config(path, ["grid.cell_size=0.5"])
    grid = run_bake(config, threads=1).grid
    assert min(len(grid.levels), 2) == num_levels
    texts = ("inflated:0.3", "inflated:.3:0.1", "nav2", "nav2:0.3", "voxels:0.5:npz", "picture")
    for product in products.parse_products([*texts, "voxels:1", "report"]):
        assert {*product.names(grid)} == {*product.make(grid, config, tmp_path)}


def test_the_order_of_products_changes_nothing(scenes, here):
    make = ["picture", "nav2", "voxels:0.5:npz", "nav2:0.3", "inflated:0.3"]
    run("scenes/first.xml", products=make)
    before = Path("out/index.jsonl").read_bytes()
    assert run("scenes/first.xml", products=make[::-1])[0] == []
    assert Path("out/index.jsonl").read_bytes() == before
    _, result = run("scenes/first.xml", out="other", products=make[::-1])
    files, other = json.loads(before)["files"], result.rows[0]["files"]
    assert [*other] == [*files] and len(files) == 8
    assert digests("other") == digests("out")


def test_outlines_of_an_override_are_beside_each_scenes_settings(scenes, here):
    for name, half in (("a", 1), ("b", 0.5)):
        folder = scenes / name
        folder.mkdir()
        corners = [[-half, -half], [half, -half], [half, half], [-half, half], [-half, -half]]
        outline = {"type": "Polygon", "coordinates": [corners]}
        plan = {"type": "Feature", "properties": {"name": name}, "geometry": outline}
        (folder / "plan.geojson").write_text(json.dumps(plan))
        (folder / f"{name}.yaml").write_text("scene: {path: ../first.xml}\n")
    sources = ("scenes/a/a.yaml", "scenes/b/b.yaml")
    for override in ("rooms.polygons=plan.geojson", "rooms={polygons: plan.geojson}"):
        names, result = run(*sources, out=f"out{len(override)}", overrides=[override])
        assert names == ["a", "b"] and result.count("ok") == 2, result.rows
        for name in names:
            config = load_config(f"scenes/{name}/{name}.yaml", [override, "grid.cell_size=0.2"])
            found = navbake.load(f"out{len(override)}/{name}/grid.json.gz").rooms
            assert [room.name for room in found] == [room.name for room in bake(config).rooms]
            assert name in {room.name for room in found}
    message = r"no\.geojson.*, named at `rooms\.polygons`"
    for name in ("no.geojson", os.path.abspath("no.geojson")):
        sources = ALL if name == "no.geojson" else ("scenes/a/a.yaml",)
        with pytest.raises(ConfigError, match=message):
            run(*sources, out="no", overrides=[f"rooms.polygons={name}"])
    assert not Path("no").exists()


def test_an_index_with_names_that_no_file_can_have_is_no_row(scenes, here):
    known = run("scenes/first.xml")[1].rows[0]
    for name in ("a\0b", "\ud800"):
        sought = {"folders": [name], "names": known["sought"]["names"]}
        odd = [
            {**known, "inputs": {**known["inputs"], name: {"size": 1, "modified": 0}}},
            {**known, "files": {name: {"size": 1, "modified": 0}}},
            {**known, "sought": sought},
        ]
        for row in odd[:2]:
            Path("out/index.jsonl").write_text(json.dumps(row) + "\n")
            assert run("scenes/first.xml")[0] == ["first"]
        Path("out/index.jsonl").write_text(json.dumps(odd[2]) + "\n")
        assert run("scenes/first.xml")[1].count("ok") == 1


@pytest.mark.parametrize(
    ("product", "message"),
    [
        ("grids", "expected one of inflated:RADIUS"),
        ("inflated", "expected inflated:RADIUS"),
        ("inflated:wide", "expected numbers >= 0"),
        ("inflated:nan", "expected numbers >= 0"),
        ("voxels:0", "expected an edge of voxels > 0"),
        ("voxels:0.1:obj", "expected an ending of binvox, bt, ot, npz"),
        ("picture:colours", "expected layers of occupancy"),
        ("report:1", "expected report"),
    ],
)
def test_a_wrong_product_is_refused_before_anything_is_baked(scenes, product, message):
    with pytest.raises(ConfigError, match=message):
        run(*ALL, products=[product])
    assert not Path("out").exists()


def test_two_pictures_of_a_scene_would_be_one_file(scenes):
    assert run("scenes/first.xml", products=["picture:floor"] * 2)[0] == ["first"]
    with pytest.raises(ConfigError, match=r"expected one picture, .*got picture, picture:floor"):
        run(*ALL, products=["picture", "report", "picture:floor"])


def test_pictures_without_matplotlib_are_refused_before_anything_is_baked(scenes, monkeypatch):
    monkeypatch.setattr("navbake.batch.products.find_spec", lambda name: None)
    with pytest.raises(MissingDependencyError, match=r"navbake\[plot\]"):
        run(*ALL, products=["picture"])


@pytest.mark.parametrize(
    ("settings", "overrides", "message"),
    [
        ({"grid": {"cell_size": -1}}, [], "grid.cell_size"),
        ({}, ["agent.radios=1"], "agent.radius"),
        ({}, ["scene.path=a.xml"], "sources name the scenes"),
        ({}, ["scene.id=a"], "sources name the scenes"),
    ],
)
def test_wrong_settings_of_all_are_one_error(scenes, settings, overrides, message):
    with pytest.raises(ConfigError, match=message):
        run(*ALL, settings=settings, overrides=overrides)
    assert not Path("out").exists()


def test_a_fault_of_a_bake_is_a_row(scenes, here, monkeypatch):
    def bake(config, threads):
        raise ZeroDivisionError("by zero")

    monkeypatch.setattr("navbake.batch.work.run_bake", bake)
    rows = run(*ALL)[1].rows
    assert {row["how"] for row in rows} == {"error"}
    assert rows[0]["error"].startswith("ZeroDivisionError: by zero")


def test_memory_that_a_library_lacked_is_for_the_worker_to_tell(scenes, here, monkeypatch):
    def bake(config, threads):
        raise SceneError("MuJoCo cannot load it") from ValueError("Could not allocate memory")

    monkeypatch.setattr("navbake.batch.work.run_bake", bake)
    assert {row["how"] for row in run(*ALL)[1].rows} == {"error"}  # nothing limits this process
    monkeypatch.setattr("navbake.batch.work.lacked_memory", lambda error: True)
    with pytest.raises(MemoryError, match="MuJoCo cannot load it"):
        run(*ALL)


def test_a_batch_ends_after_too_many_failures(scenes, here):
    for name in ("bad-1", "bad-2"):
        (scenes / f"{name}.xml").write_text("<mujoco>")
    sources = ["scenes/bad-1.xml", ALL[0], "scenes/bad-2.xml", ALL[1]]
    names, result = run(*sources, means=Means(max_failures=1))
    assert names == ["bad-1", "first", "bad-2"]
    assert result.stopped == "2 scenes failed, more than 1"
    assert [row["status"] for row in result.rows] == ["failed", "ok", "failed", "left"]
    assert list(read_index(Path("out")).values()) == result.rows
    assert run(*sources)[0] == ["bad-1", "bad-2", "second"]


def test_an_index_that_was_cut_off_is_mended(scenes, here):
    run(*ALL)
    index = Path("out", NAME)
    lines = index.read_bytes().splitlines(keepends=True)
    index.write_bytes(lines[0] + lines[1][:100] + b"\n[1]\nnull\n" + lines[2][:50])
    assert run(*ALL)[0] == ["second", "meshed.mjcf"]
    assert [json.loads(line)["id"] for line in index.read_text().splitlines()] == [
        *("first", "second", "meshed.mjcf")
    ]
    row = json.loads(lines[0])
    index.write_text(json.dumps({**row, "inputs": 3}) + "\n")  # by whom ever
    assert run(ALL[0])[0] == ["first"]


def test_scenes_of_another_batch_stay_in_the_index(scenes, here):
    run(ALL[0])
    run(ALL[1])
    assert list(read_index(Path("out"))) == ["second", "first"]
    assert run(*ALL[:2])[0] == []
    assert list(read_index(Path("out"))) == ["first", "second"]


def test_an_interrupted_batch_leaves_a_true_index(scenes, monkeypatch):
    def interrupt():
        """End the batch while a worker writes the second scene."""
        Path("out/second").mkdir()
        Path("out/second/.navbake-0123456789abcdef.tmp").write_bytes(b"half")
        raise KeyboardInterrupt

    stay_in_process(monkeypatch, after=interrupt)
    with pytest.raises(KeyboardInterrupt):
        run(*ALL)
    status = {name: row["status"] for name, row in read_index(Path("out")).items()}
    assert status == {"first": "ok", "second": "left", "meshed.mjcf": "left"}
    assert list(Path("out/second").iterdir()) == []


def test_an_interrupted_run_forgets_nothing_that_still_holds(scenes, monkeypatch):
    stay_in_process(monkeypatch)
    run(*ALL, products=["nav2"])
    index, made = Path("out", NAME).read_bytes(), digests("out")
    bake = Mock(side_effect=KeyboardInterrupt)
    for radius in (0.1, 0.15):  # however often
        with monkeypatch.context() as patch:
            patch.setattr(work, "run_bake", bake)
            with pytest.raises(KeyboardInterrupt):
                run(*ALL, products=["nav2"], overrides=[f"agent.radius={radius}"])
        rows = [*read_index(Path("out")).values()]
        assert [row["status"] for row in rows] == ["left"] * 3
        assert all({*row} == {"id", "status", "source", "was"} for row in rows)
    run("scenes/meshed.mjcf.xml", products=["nav2"])  # the others' rows stay
    status = {name: row["status"] for name, row in read_index(Path("out")).items()}
    assert status == {"meshed.mjcf": "ok", "first": "left", "second": "left"}
    names, result = run(*ALL, products=["nav2"])
    assert names == [] and result.skipped == 3 and digests("out") == made
    assert Path("out", NAME).read_bytes() == index


def test_a_scene_that_an_interrupted_run_began_is_baked_again(scenes, monkeypatch):
    stay_in_process(monkeypatch)
    run(*ALL)
    made = digests("out")
    real = work.write_navgrid

    def write(grid, path):
        """Interrupt the second scene before its grid is there."""
        if path.parent.name == "second":
            raise KeyboardInterrupt
        real(grid, path)

    with monkeypatch.context() as patch:
        patch.setattr(work, "write_navgrid", write)
        with pytest.raises(KeyboardInterrupt):
            run(*ALL, overrides=["agent.radius=0.1"])
    assert run(*ALL)[0] == ["first", "second"]
    assert digests("out") == made


def test_a_scene_that_failed_since_is_not_done(scenes, here):
    run(*ALL)
    text = Path(ALL[0]).read_text()
    Path(ALL[0]).write_text("<mujoco>")
    means = Means(max_failures=0)
    names, result = run(*ALL, means=means, overrides=["agent.radius=0.1"])
    assert names == ["first"]
    assert [row["status"] for row in result.rows] == ["failed", "left", "left"]
    Path(ALL[0]).write_text(text)
    assert run(*ALL)[0] == ["first"]


def test_an_index_that_somebody_removes_is_written_whole_at_the_end(scenes, monkeypatch):
    stay_in_process(monkeypatch, after=lambda: Path("out", NAME).unlink(missing_ok=True))
    result = run(*ALL)[1]
    assert result.count("ok") == 3 and [*read_index(Path("out")).values()] == result.rows
    assert run(*ALL)[0] == []


@pytest.mark.parametrize(
    ("source", "out", "overrides"),
    [
        ("scenes/first.xml", "memory://a/b", []),
        ("MEMORY://a/first.xml", "out", []),
        ("scenes/first.xml", "out", ["rooms.polygons=memory://a/plan.geojson"]),
    ],
)
def test_files_in_a_process_s_own_memory_are_refused(scenes, source, out, overrides):
    with pytest.raises(ConfigError, match=r"that all processes share, got (?i:memory)://a/"):
        run(source, out=out, overrides=overrides)
    assert not Path("out").exists()


def test_two_batches_never_write_into_one_folder(scenes, here):
    Path("out").mkdir()
    with (
        only_batch(Path("out")),
        pytest.raises(NavbakeError, match="another batch writes into out"),
    ):
        run(*ALL)
    assert len(run(*ALL)[0]) == 3


def test_a_folder_that_cannot_be_written_is_one_error(scenes, here):
    Path("out").write_text("a file")
    with pytest.raises(NavbakeError, match="a folder to write into, got out, which is a file"):
        run(*ALL)


def test_the_warnings_of_a_bake_are_in_its_row(scenes, here):
    (scenes / "low.xml").write_text(draw_room(0))
    row = run("scenes/low.xml", settings={"scene": {"exclude": {"bodies": ["nobody"]}}})[1].rows[0]
    assert row["warnings"] == list(navbake.load("out/low/grid.json.gz").warnings) != []


@pytest.mark.parametrize(
    ("code", "remedy"), [(errno.ENOSPC, "free space"), (errno.EROFS, "make it writable")]
)
def test_a_folder_that_takes_no_more_files_stops_the_batch(scenes, here, monkeypatch, code, remedy):
    real = files.create_temporary

    def create(folder):
        if folder.name == "second":
            raise OSError(code, os.strerror(code))
        return real(folder)

    with monkeypatch.context() as patch:
        patch.setattr(files, "create_temporary", create)
        names, result = run(*ALL, products=["report"])
    assert names == ["first"]
    place, why = Path("out", "second"), os.strerror(code)
    assert result.stopped == (
        f"cannot write into {place}: {why}: {remedy} and run the same command again"
    )
    assert [row["status"] for row in result.rows] == ["ok", "left", "left"]
    assert list(read_index(Path("out")).values()) == result.rows
    assert os.listdir(place) == []
    assert run(*ALL, products=["report"])[0] == ["second", "meshed.mjcf"]


def test_a_product_without_room_in_the_temporary_folder_stops_no_batch(
    scenes, here, tmp_path, monkeypatch
):
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))

    def make(*arguments):
        try:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(tmp_path / "tmp" / "a"))
        except OSError as error:
            raise NavbakeError("no room in tmp") from error

    monkeypatch.setattr(products.Product, "make", make)
    result = run(*ALL[:2], products=["report"])[1]
    assert result.stopped is None
    assert [row["error"] for row in result.rows] == ["no room in tmp"] * 2


def test_the_index_has_what_was_made_where_it_can_not_be_put_in_order(scenes, here, monkeypatch):
    def refuse(folder):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(index_module, "write_whole", lambda content, path: refuse(path))
        result = run(*ALL[:2])[1]
        assert result.stopped == (
            "cannot write into out: No space left on device: free space and run the same command "
            "again"
        )
        assert result.count("ok") == 2 and [*read_index(Path("out"))] == ["first", "second"]
        patch.setattr(index_module, "write_all", lambda file, line: refuse(file))
        names, result = run(*ALL)
    assert names == [] and result.stopped.startswith("cannot write into out: No space")
    assert [row["status"] for row in result.rows] == ["ok", "ok", "left"]
    assert [*read_index(Path("out"))] == ["first", "second"]
    names, result = run(*ALL)
    assert names == ["meshed.mjcf"] and result.stopped is None


def test_a_scene_that_can_not_be_read_is_not_a_folder_without_room(scenes, here, monkeypatch):
    def bake(config, threads):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("navbake.batch.work.run_bake", bake)
    assert run(*ALL)[1].count("failed") == 3


def test_a_new_file_that_a_scene_may_mean_instead_is_noticed(scenes, here):
    text = MESHED.replace("<mujoco>", '<mujoco><compiler meshdir="meshes"/>')
    text = text.replace("floor.xml", str(scenes / "floor.xml"))
    (scenes / "meshed.mjcf.xml").write_text(text)
    (scenes / "meshes").mkdir()
    (scenes / "chest.obj").rename(scenes / "meshes" / "chest.obj")
    assert run(ALL[2])[1].count("ok") == 1
    (scenes / "other.obj").write_text(CHEST.format(height=2))
    (scenes / "meshes" / "wood.png").touch()  # a texture
    assert run(ALL[2])[0] == []
    for name in ("chest.obj", "meshes/floor.xml"):
        (scenes / name).write_text(CHEST.format(height=2))  # which one MuJoCo takes, who knows
        assert run(ALL[2])[0] == ["meshed.mjcf"]
        assert run(ALL[2])[0] == []


def test_a_new_mesh_of_urdf_that_is_found_first_is_noticed(scenes, here):
    near, far = scenes / "cell" / "meshes" / "chest.obj", scenes / "meshes" / "chest.obj"
    for path in (near, far):
        path.parent.mkdir(parents=True)
    far.write_text(CHEST.format(height=1))
    mesh = '<geometry><mesh filename="package://cell/meshes/chest.obj"/></geometry>'
    (scenes / "cell" / "cell.urdf").write_text(
        f'<robot name="cell"><link name="base"><visual>{mesh}</visual>'
        '<collision><geometry><box size="4 4 .1"/></geometry></collision></link></robot>'
    )
    path = str(scenes / "cell" / "cell.urdf")
    assert run(path)[1].count("ok") == 1
    (scenes / "cell" / "chest.obj").write_text(CHEST.format(height=2))  # found after the other
    assert run(path)[0] == []
    near.write_text(CHEST.format(height=2))
    assert run(path)[0] == ["cell"]
    assert run(path)[0] == []


def test_the_output_folder_may_be_a_link_to_another_depth(scenes, here):
    target = scenes.parent / "scratch" / "of" / "mine"
    target.mkdir(parents=True)
    Path("out").symlink_to(target)
    rows = run(*ALL)[1].rows
    assert (target / "first" / "grid.json.gz").is_file()
    assert rows[0]["source"] == "../../../scenes/first.xml"
    for row in rows:
        assert all((target / name).is_file() for name in (row["source"], *row["inputs"]))
    assert run(*ALL)[0] == []
    assert run(*ALL, out=str(target))[0] == []
    (scenes / "chest.obj").write_text(CHEST.format(height=2))
    assert run(*ALL)[0] == ["meshed.mjcf"]


def test_scenes_may_be_reached_through_links(scenes, here):
    text = MESHED.replace("chest.obj", "../chest.obj")
    for name in ("deep/one", "deep/two"):
        (scenes / name).mkdir(parents=True)
        (scenes / name / "meshed.xml").write_text(text)
        (scenes / name / "floor.xml").write_text(FLOOR.format(half=2))
        shutil.copy(scenes / "wood.png", scenes / name)
    shutil.copy(scenes / "chest.obj", scenes / "deep")  # where the system takes `..` to be
    shutil.move(scenes / "chest.obj", ".")  # where MuJoCo does
    Path("link").symlink_to(scenes / "deep" / "one")
    row = run("link/meshed.xml")[1].rows[0]
    assert row.get("error") is None
    assert row["source"] == "../link/meshed.xml" and len(row["inputs"]) == 4
    assert all(Path("out", name).is_file() for name in row["inputs"])
    assert run("link/meshed.xml")[0] == []
    for folder in (scenes / "deep", Path()):
        (folder / "chest.obj").write_text(CHEST.format(height=2))
        assert run("link/meshed.xml")[0] == ["meshed"]
    Path("link").unlink()
    Path("link").symlink_to(scenes / "deep" / "two")
    (scenes / "deep" / "two" / "floor.xml").write_text(FLOOR.format(half=3))
    assert run("link/meshed.xml")[0] == ["meshed"]
    assert run("link/meshed.xml")[0] == []


def test_workers_make_all_that_is_asked_for_before_their_first_scene(monkeypatch):
    """Else the first scene pays for loading it."""
    made, folders = [], []

    class Fake:
        def make(self, grid, config, folder):
            made.append(len(grid.rooms))
            folders.append(folder)
            raise ConfigError("it can't be made of the sample")

    monkeypatch.setattr(work, "write_thumbnail", lambda grid, folder: folders.append(folder))
    work.prepare((), True)
    work.prepare((Fake(),), True)
    assert len(folders) == 3 and len(made) == 1 and made[0] > 1
    assert not any(folder.exists() for folder in folders)
