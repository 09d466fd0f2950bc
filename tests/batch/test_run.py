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
from batch_in_process import inspect_for_ever, run_sources, stay_in_process
from batch_scenes import CHEST, draw_room, write_scenes, wrong_rows
from navbake import bake, files, samples
from navbake.baker.bake.pipeline import run_bake
from navbake.batch import index as index_module
from navbake.batch import job as job_module
from navbake.batch import products, store
from navbake.batch import run as run_module
from navbake.batch.index import INDEX_NAME, lock_batch, read_index
from navbake.batch.products import RECORD_NAME
from navbake.batch.run import preview_batch
from navbake.batch.scenes import list_jobs
from navbake.batch.workers import JobLimits
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
        if path.is_file() and path.name not in (INDEX_NAME, RECORD_NAME)
    }


ALL = ("scenes/first.xml", "scenes/second.xml", "scenes/meshed.mjcf.xml")


@pytest.mark.skipif(sys.platform != "linux", reason="pipes, and limits of memory")
def test_scenes_that_fail_hang_or_crash_cost_themselves_alone(tmp_path, monkeypatch):
    expected = write_scenes(tmp_path / "scenes", 6, broken=10, endings=True)
    source, hanging = tmp_path / "scenes" / "list.jsonl", tmp_path / "scenes" / "hangs.xml"
    lines = source.read_text().splitlines(keepends=True)
    source.write_text("".join(line for line in lines if hanging.name not in line))
    # no scene but the one that hangs is near a limit of time, however busy the machine is
    limits = JobLimits(seconds=300.0, memory=0.7)
    make = ["episodes:point:uniform:5"]
    _, result = run(str(source), out=tmp_path / "out", workers=2, limits=limits, products=make)
    assert [row["id"] for row in result.rows] == [job.id for job in list_jobs([str(source)])]
    assert list(read_index(tmp_path / "out").values()) == result.rows
    assert (result.count("ok"), result.count("failed"), result.count("left")) == (6, 12, 0)
    good = sorted(name for name, how in expected.items() if how.how == "ok")
    sources = [str(hanging), *(str(tmp_path / "scenes" / f"{name}.xml") for name in good)]
    limits = JobLimits(seconds=1.0)
    names, result = run(*sources, out=tmp_path / "out", workers=2, limits=limits, products=make)
    assert names == ["hangs"] and result.num_skipped == 6
    assert wrong_rows([*read_index(tmp_path / "out").values()], expected) == []
    assert sorted(path.parent.name for path in (tmp_path / "out").glob("*/*.gz")) == good
    grid = navbake.bake(tmp_path / "scenes" / "good-0003.xml", grid=SETTINGS["grid"])
    grid.timings = {}
    grid.save(tmp_path / "one.json.gz")
    made = tmp_path / "out" / "good-0003" / "grid.json.gz"
    assert made.read_bytes() == (tmp_path / "one.json.gz").read_bytes()
    stay_in_process(monkeypatch)
    run(*sources[1:], out=tmp_path / "alone", products=make)
    (episodes,) = (tmp_path / "alone").glob("episodes-*")
    assert (tmp_path / "out" / episodes.name).read_bytes() == episodes.read_bytes()


def test_what_is_done_is_skipped_and_what_failed_is_tried_again(scenes, here):
    (scenes / "bad.xml").write_text("<mujoco>")
    names, first = run(*ALL, "scenes/bad.xml")
    assert names == ["first", "second", "meshed.mjcf", "bad"]
    before = digests("out")
    names, again = run(*ALL, "scenes/bad.xml")
    assert names == ["bad"] and again.num_skipped == 3
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
    index = Path("out", INDEX_NAME).read_bytes()
    monkeypatch.chdir(scenes)
    assert run(*(Path(name).name for name in ALL), out="../out")[0] == []
    assert Path("../out", INDEX_NAME).read_bytes() == index
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
        *("episodes:point", "stand:0.20"),
        *("voxels:0.5", "voxels:0.5:bt", "voxels:0.5:ot", "voxels:0.5:npz"),
    ]
    run("scenes/first.xml", products=make)
    assert {path.name for path in Path("out/first").iterdir()} == names_in_docs() | {RECORD_NAME}
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
    names, result = run("scenes/first.xml", products=["report", "report"])
    assert names == ["first"]
    assert set(result.rows[0]["removed"]) == names_in_docs() - {"grid.json.gz", "report.html"}
    _, result = run("scenes/first.xml", products=["report", "report"])
    assert "removed" not in result.rows[0]  # it was the run before
    left = {path.name for path in Path("out/first").iterdir()}
    assert left == {"grid.json.gz", "report.html", "notes.txt", RECORD_NAME}


def test_bases_stand_where_the_finder_has_them(scenes, here):
    run("scenes/first.xml", products=["stand:.2:0.1:0.6", "stand:0.2:0.3:.8", "stand:0.2"])
    names = {path.name for path in Path("out/first").glob("stand*")}
    assert names == {"stand-0.2-0.1-0.6.json", "stand-0.2-0.3-0.8.json"}
    finder = navbake.PathFinder(navbake.load("out/first/grid.json.gz").inflate(0.2))
    targets = [f"object:{name}" for name in finder.search.names.list_objects()]
    poses = finder.stand_poses(targets, reach=(0.1, 0.6))
    made = json.loads(Path("out/first/stand-0.2-0.1-0.6.json").read_text())
    assert made == {"scene_id": "first", "poses": poses.to_records(), "why_not": poses.why_not}
    assert len(targets) and len(poses)


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

    grid = {"grid.json.gz", RECORD_NAME}
    again = ["agent.radius=0.1"]
    assert run("list.csv", out=".")[1].count("ok") == 1 and made() == grid
    assert run("list.csv", out=".", overrides=again)[1].count("ok") == 1 and made() == grid
    run("list.csv", out=".", products=["inflated:0.3"])
    assert made() == {*grid, "inflated-0.3.json.gz"}
    Path(INDEX_NAME).unlink()
    assert run("list.csv", out=".")[0] == ["houses/0001"] and made() == grid
    for name in ("nav2.pgm", "thumbnail.png"):  # which are asked for now
        before.pop(name)
    run("list.csv", out=".", products=["nav2"], thumbnail=True)
    assert made() == {*grid, "nav2.pgm", "nav2.yaml", "thumbnail.png"}
    before.pop("scene.xml")
    (place / "scene.xml").write_text("<mujoco>")
    assert run("list.csv", out=".")[1].count("failed") == 1 and made() == {"scene.xml"}


def test_a_user_s_file_is_replaced_whole_or_stays(scenes, here, monkeypatch):
    Path("out/first").mkdir(parents=True)
    Path("out/first/report.html").write_text("mine")
    with monkeypatch.context() as patch:
        patch.setattr(job_module, "make_product", Mock(side_effect=NavbakeError("broken")))
        assert run(ALL[0], products=["nav2", "report"])[1].count("failed") == 1
    assert os.listdir("out/first") == ["report.html"]
    assert Path("out/first/report.html").read_text() == "mine"


@pytest.mark.parametrize("then", ["made anew", "fails", "is lost"])
def test_what_a_killed_worker_made_is_removed_whatever_the_index_says(
    scenes, here, monkeypatch, then
):
    Path("out/first").mkdir(parents=True)
    Path("out/first/picture.png").write_text("mine")
    real = store.write_file

    def write(place, name, content):
        if name == products.GRID_NAME:
            raise KeyboardInterrupt
        real(place, name, content)

    with monkeypatch.context() as patch:
        patch.setattr(store, "write_file", write)
        with pytest.raises(KeyboardInterrupt):
            run(ALL[0], products=["nav2", "report"], thumbnail=True)
    made = {"nav2.pgm", "nav2.yaml", "report.html", "thumbnail.png", RECORD_NAME}
    assert {*os.listdir("out/first")} == made | {"picture.png"}
    Path("out", INDEX_NAME).unlink()
    if then == "is lost":  # with its worker: the batch's own process clears up
        job = list_jobs([ALL[0]])[0]
        row = job_module.record_failure(
            job_module.Plan(Path("out"), SETTINGS), job, "too long", "60 s", 60
        )
        assert row["status"] == "failed"
    if then == "fails":
        Path(ALL[0]).write_text("<mujoco>")
    if then != "is lost":
        run(ALL[0])
    grid = {"grid.json.gz", RECORD_NAME} if then == "made anew" else set()
    assert {*os.listdir("out/first")} == {"picture.png"} | grid


@pytest.mark.parametrize("num_levels", [1, 2])
def test_names_of_products_are_known_as_ours(tmp_path, num_levels):
    path = samples.path("apartment" if num_levels == 1 else "house")
    config = load_config(path, ["grid.cell_size=0.5"])
    grid = run_bake(config, threads=1).grid
    assert min(len(grid.levels), 2) == num_levels
    texts = ("inflated:0.3", "inflated:.3:0.1", "nav2", "nav2:0.3", "voxels:0.5:npz", "picture")
    for product in products.parse_products([*texts, "voxels:1", "report", "episodes:point"]):
        folder = tmp_path / str(product).replace(":", "-")
        folder.mkdir()
        products.make_product(product, grid, config, folder)
        assert os.listdir(folder) and all(
            map(products.PRODUCT_FILE_PATTERN.fullmatch, os.listdir(folder))
        )


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
        ("stand", "expected stand:RADIUS"),
        ("stand:0.2:0.8:0.3", "expected a reach LEAST <= GREATEST"),
        ("stand:0.2:0.9", "expected a reach LEAST <= GREATEST"),
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

    monkeypatch.setattr("navbake.batch.job.run_bake", bake)
    rows = run(*ALL)[1].rows
    assert {row["how"] for row in rows} == {"error"}
    assert rows[0]["error"].startswith("ZeroDivisionError: by zero")


def test_memory_that_a_library_lacked_is_for_the_worker_to_tell(scenes, here, monkeypatch):
    def bake(config, threads):
        raise SceneError("MuJoCo cannot load it") from ValueError("Could not allocate memory")

    monkeypatch.setattr("navbake.batch.job.run_bake", bake)
    assert {row["how"] for row in run(*ALL)[1].rows} == {"error"}  # nothing limits this process
    monkeypatch.setattr("navbake.batch.job.is_lack_of_memory", lambda error: True)
    with pytest.raises(MemoryError, match="MuJoCo cannot load it"):
        run(*ALL)


def test_a_batch_ends_after_too_many_failures(scenes, here):
    for name in ("bad-1", "bad-2"):
        (scenes / f"{name}.xml").write_text(f"<mujoco><!-- {name}")
    sources = ["scenes/bad-1.xml", ALL[0], "scenes/bad-2.xml", ALL[1]]
    names, result = run(*sources, max_failures=1)
    assert names == ["bad-1", "first", "bad-2"]
    assert result.stop_reason == "2 scenes failed, more than 1"
    assert [row["status"] for row in result.rows] == ["failed", "ok", "failed", "left"]
    assert list(read_index(Path("out")).values()) == result.rows
    assert run(*sources)[0] == ["bad-1", "bad-2", "second"]


def test_the_index_is_a_report_and_the_records_say_what_is_done(scenes, here):
    run(*ALL)
    index = Path("out", INDEX_NAME)
    whole = index.read_bytes()
    lines = whole.splitlines(keepends=True)
    index.write_bytes(lines[0] + lines[1][:100] + b"\n[1]\nnull\n" + lines[2][:50])
    assert run(*ALL)[0] == [] and index.read_bytes() == whole
    index.unlink()
    assert run(*ALL)[0] == [] and index.read_bytes() == whole
    record = Path("out/first", RECORD_NAME)
    row = json.loads(record.read_text())
    for text in ("", "[]", '{"files": {}}', json.dumps({**row, "key": 3}), json.dumps(row)[:-9]):
        record.write_text(text)
        assert run(*ALL)[0] == ["first"], text
    Path("out/second/grid.json.gz").write_bytes(b"")
    assert run(*ALL)[0] == ["second"]


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
    index, made = Path("out", INDEX_NAME).read_bytes(), digests("out")
    with monkeypatch.context() as patch:
        patch.setattr(job_module, "run_bake", Mock(side_effect=KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            run(*ALL, products=["nav2"], overrides=["agent.radius=0.1"])
    rows = [*read_index(Path("out")).values()]
    assert [row["status"] for row in rows] == ["left"] * 3
    names, result = run(*ALL, products=["nav2"])
    assert names == [] and result.num_skipped == 3 and digests("out") == made
    assert Path("out", INDEX_NAME).read_bytes() == index


def test_a_scene_that_an_interrupted_run_began_is_baked_again(scenes, monkeypatch):
    stay_in_process(monkeypatch)
    run(*ALL)
    made = digests("out")
    real = store.write_file

    def write(place, name, content):
        """Interrupt the second scene before its grid is there."""
        if (place.name, name) == ("second", products.GRID_NAME):
            raise KeyboardInterrupt
        real(place, name, content)

    with monkeypatch.context() as patch:
        patch.setattr(store, "write_file", write)
        with pytest.raises(KeyboardInterrupt):
            run(*ALL, overrides=["agent.radius=0.1"])
    assert run(*ALL)[0] == ["first", "second"]
    assert digests("out") == made


def test_a_scene_that_failed_since_is_not_done(scenes, here):
    run(*ALL)
    text = Path(ALL[0]).read_text()
    Path(ALL[0]).write_text("<mujoco>")
    names, result = run(*ALL, max_failures=0, overrides=["agent.radius=0.1"])
    assert names == ["first"]
    assert [row["status"] for row in result.rows] == ["failed", "left", "left"]
    Path(ALL[0]).write_text(text)
    assert run(*ALL)[0] == ["first"]


def test_an_index_that_somebody_removes_is_written_whole_at_the_end(scenes, monkeypatch):
    stay_in_process(monkeypatch, after=lambda: Path("out", INDEX_NAME).unlink(missing_ok=True))
    result = run(*ALL)[1]
    assert result.count("ok") == 3 and [*read_index(Path("out")).values()] == result.rows
    assert run(*ALL)[0] == []


def test_two_batches_never_write_into_one_folder(scenes, here):
    Path("out").mkdir()
    with (
        lock_batch(Path("out")),
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
    assert result.stop_reason == (
        f"cannot write into {place}: {why}: {remedy} and run the same command again"
    )
    assert [row["status"] for row in result.rows] == ["ok", "left", "left"]
    assert list(read_index(Path("out")).values()) == result.rows
    assert os.listdir(place) == []
    assert run(*ALL, products=["report"])[0] == ["second", "meshed.mjcf"]


def test_the_index_has_what_was_made_where_it_can_not_be_put_in_order(scenes, here, monkeypatch):
    def refuse(*arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    real = store.write_whole
    with monkeypatch.context() as patch:
        patch.setattr(
            store,
            "write_whole",
            lambda data, path: refuse() if Path(path).name == INDEX_NAME else real(data, path),
        )
        result = run(*ALL[:2])[1]
        assert result.stop_reason == (
            "cannot write into out: No space left on device: free space and run the same command "
            "again"
        )
        assert result.count("ok") == 2 and [*read_index(Path("out"))] == ["first", "second"]
        patch.setattr(index_module, "write_all", refuse)
        names, result = run(*ALL)
    assert names == [] and result.stop_reason.startswith("cannot write into out: No space")
    assert [row["status"] for row in result.rows] == ["ok", "ok", "ok"]
    assert [*read_index(Path("out"))] == ["first", "second"]
    names, result = run(*ALL)
    assert names == [] and result.stop_reason is None


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


@pytest.mark.parametrize("name", ["index.jsonl", "index.parquet", ".navbake-batch.lock"])
def test_an_index_that_is_a_link_out_of_the_output_folder_is_refused(here, scenes, name):
    Path("mine").write_text("mine\n")
    Path("out").mkdir()
    Path("out", name).symlink_to(Path("mine").absolute())
    with pytest.raises(NavbakeError, match=rf"expected out/{name} in .*, got a link to .*/mine"):
        run(ALL[0])
    assert Path("mine").read_text() == "mine\n"


def test_a_folder_that_is_a_link_out_of_the_output_folder_fails_its_scene_alone(here, scenes):
    for name in ("elsewhere", "out"):
        Path(name).mkdir()
    run(ALL[0], out="elsewhere")
    before = digests("elsewhere")
    Path("out/first").symlink_to(Path("elsewhere/first").absolute())
    for _ in range(2):
        rows = {row["id"]: row for row in run(*ALL[:2])[1].rows}
        assert (rows["first"]["status"], rows["second"]["status"]) == ("failed", "ok")
        assert "expected out/first in the output folder out, got a link" in rows["first"]["error"]
    Path("out/first").unlink()
    Path("out/first").mkdir()
    Path("out/first/grid.json.gz").symlink_to(Path("mine").absolute())
    Path("mine").write_text("mine\n")
    assert run(ALL[0])[1].count("ok") == 1  # the link goes, what it led to stays
    assert Path("mine").read_text() == "mine\n" and digests("elsewhere") == before


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

    def make(product, grid, config, folder):
        made.append(len(grid.rooms))
        folders.append(folder)
        raise ConfigError("it can't be made of the sample")

    monkeypatch.setattr(job_module, "make_product", make)
    monkeypatch.setattr(job_module, "write_bytes", lambda _, path: folders.append(path.parent))
    job_module.prepare_worker((), True)
    job_module.prepare_worker(("report",), True)
    assert len(folders) == 3 and len(made) == 1 and made[0] > 1
    assert not any(folder.exists() for folder in folders)


def test_scenes_are_read_by_workers_alone(scenes, monkeypatch):
    """The batch's own process has no limits, and reads no file of a stranger."""

    def open_nothing(*arguments, **options):
        raise AssertionError("a scene was opened in the batch's own process")

    monkeypatch.setattr(job_module, "open_scene", open_nothing)
    Path("again.xml").write_bytes((scenes / "first.xml").read_bytes())
    plan = job_module.Plan(Path("out").absolute(), SETTINGS)
    whys = [row["why"] for row in preview_batch(plan, list_jobs(["scenes/first.xml", "again.xml"]))]
    assert whys == ["new", "equal to first"]


def test_a_scene_that_is_endless_to_read_is_told(scenes, monkeypatch):
    """Its own bake, which has limits too, is for it to fail."""
    monkeypatch.setattr(run_module, "inspect_scenes", inspect_for_ever)
    monkeypatch.setattr(run_module, "MIN_INSPECTION_SECONDS", 10.0)
    (scenes / "endless.xml").write_text("<mujoco/>")
    jobs = list_jobs(["scenes/endless.xml", "scenes/first.xml"])
    plan = job_module.Plan(Path("out").absolute(), SETTINGS)
    rows = preview_batch(plan, jobs, limits=JobLimits(seconds=2.0))
    assert [row["why"] for row in rows] == ["broken: it took more than 10 s", "new"]
