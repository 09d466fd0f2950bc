"""Batches of scenes on stores, and batches that write into one, against those of this machine."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import sys
from functools import partial
from pathlib import Path

import pytest

from batch_in_process import run_sources, stay_in_process
from batch_scenes import CHEST, draw_room
from navbake.batch import store
from navbake.batch.index import INDEX_NAME
from navbake.batch.products import RECORD_NAME
from navbake.batch.scenes import list_jobs, read_shared_settings
from navbake.batch.store import (
    Mirror,
    as_folder,
    is_url,
    join,
    list_file_sizes,
    read_file,
    strip_file_scheme,
    without_secrets,
    write_file,
)
from navbake.cli.main import main
from navbake.errors import ConfigError, MissingDependencyError, NavbakeError

fsspec = pytest.importorskip("fsspec")
SETTINGS = {"grid": {"cell_size": 0.25}}
run = partial(run_sources, settings=SETTINGS)
FLOOR = '<mujoco><geom type="box" size="2 2 .1" pos="0 0 -.1"/></mujoco>'
MESHED = """<mujoco>
<compiler meshdir="../shared" texturedir="looks"/>
<asset>
  <mesh name="chest" file="chest.obj"/><mesh name="lid" file="sub\\lid.obj"/>
  <texture name="sky" type="skybox" {sides}/>
</asset>
<worldbody>
  <include file="floor.part"/>
  <geom type="mesh" mesh="chest"/><geom type="mesh" mesh="lid" pos="-1 -1 0"/>
</worldbody></mujoco>"""
INFLATED = "inflated-0.3.json.gz"
SIDES = ("right", "left", "up", "down", "front", "back")
URDF = """<robot name="r"><link name="base">
<visual><geometry><mesh filename="package://rooms/shared/chest.obj"/></geometry></visual>
<collision><geometry><box size="4 4 .1"/></geometry></collision></link></robot>"""
PLAN = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"name": "hall"},
            "geometry": {
                "type": "Polygon",
                "coordinates": [[[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]],
            },
        }
    ],
}


@pytest.fixture(autouse=True)
def here(monkeypatch, tmp_path):
    """Jobs are done in this process, which alone has the store; temporary folders are in sight."""
    stay_in_process(monkeypatch)
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    monkeypatch.chdir(tmp_path)
    yield
    assert os.listdir(tmp_path / "tmp") == []


@pytest.fixture
def memory():
    """An empty store in memory."""
    system = fsspec.filesystem("memory")
    system.store.clear()
    system.pseudo_dirs[:] = [""]
    yield system
    system.store.clear()
    system.pseudo_dirs[:] = [""]


def write_rooms(folder):
    """A scene of each kind that names files, and settings; the names of their sources."""
    from PIL import Image

    (folder / "shared" / "sub").mkdir(parents=True)
    (folder / "mjcf" / "looks").mkdir(parents=True)
    (folder / "shared" / "chest.obj").write_text(CHEST.format(height=1))
    (folder / "shared" / "sub" / "lid.obj").write_text(CHEST.format(height=0.5))
    (folder / "mjcf" / "floor.part").write_text(FLOOR)
    sides = []
    for side in SIDES:
        Image.new("RGB", (2, 2)).save(folder / "mjcf" / "looks" / f"{side}.png")
        sides.append(f'file{side}="{side}.png"')
    (folder / "mjcf" / "room.xml").write_text(MESHED.format(sides=" ".join(sides)))
    (folder / "arm").mkdir()
    (folder / "arm" / "arm.urdf").write_text(URDF)
    (folder / "plain.xml").write_text(draw_room(3))
    (folder / "plan.geojson").write_text(json.dumps(PLAN))
    (folder / "set.yaml").write_text(
        "scene: {path: mjcf/room.xml, id: named}\nrooms: {polygons: plan.geojson}\n"
    )
    return ["mjcf/room.xml", "arm/arm.urdf", "plain.xml", "set.yaml"]


def upload(folder, system, to):
    for path in folder.rglob("*"):
        if path.is_file():
            system.pipe_file(f"{to}/{path.relative_to(folder).as_posix()}", path.read_bytes())


@pytest.fixture
def rooms(tmp_path, memory):
    """Scenes at `rooms` and at `memory://s/rooms`; the names of their sources."""
    names = write_rooms(tmp_path / "rooms")
    upload(tmp_path / "rooms", memory, "/s/rooms")
    return names


def grids(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in Path(folder).glob("*/*")
        if path.name != RECORD_NAME
    }


def grids_at(url):
    return {name: read_file(f"{url}/{name}") for name in list_file_sizes(url) if is_product(name)}


def is_product(name):
    return "/" in name and not name.endswith(RECORD_NAME)


# ---------------------------------------------------------------- the same bytes


def test_scenes_on_a_store_give_the_bytes_of_local_ones(rooms):
    make = ["inflated:0.3", "nav2", "voxels:0.5"]
    _, near = run(*(f"rooms/{name}" for name in rooms), products=make)
    assert [row["status"] for row in near.rows] == ["ok"] * 4, near.rows
    _, result = run(*(f"memory://s/rooms/{name}" for name in rooms), out="remote", products=make)
    assert grids("remote") == grids("out") and len(grids("remote")) == 20
    _, result = run(
        *(f"memory://s/rooms/{name}" for name in rooms), out="memory://b/c", products=make
    )
    assert grids_at("memory://b/c") == grids("out")
    _, result = run(*(f"rooms/{name}" for name in rooms), out="memory://d", products=make)
    assert grids_at("memory://d") == grids("out")
    measured = ("id", "levels", "cells", "free_area", "rooms", "scene_digest", "warnings", "audit")
    for row, other in zip(near.rows, result.rows, strict=True):
        assert {key: row[key] for key in measured} == {key: other[key] for key in measured}
    index = read_file("memory://b/c/index.jsonl")
    assert b"tmp" not in index and b"memory://s/rooms/shared/sub/lid.obj" in index
    row = json.loads(index.splitlines()[0])
    assert row["source"] == "memory://s/rooms/mjcf/room.xml"
    shared = {"shared/chest.obj", "shared/sub/lid.obj", "mjcf/floor.part", "mjcf/room.xml"}
    assert set(row["inputs"]) == {f"memory://s/rooms/{name}" for name in shared}
    assert {name for name in list_file_sizes("memory://b/c") if "/" not in name} == {INDEX_NAME}


def test_lists_patterns_and_settings_may_be_on_a_store(rooms, memory):
    (Path("rooms") / "all.yaml").write_text("rooms: {polygons: plan.geojson}\n")
    lines = [
        {"scene": "mjcf/room.xml", "id": "a"},
        {"config": "../rooms/set.yaml", "id": "b", "grid.cell_size": 0.5},
        {"scene": "memory://s/rooms/plain.xml", "rooms.polygons": "plan.geojson"},
    ]
    text = "".join(json.dumps(line) + "\n" for line in lines)
    Path("rooms/list.jsonl").write_text(text)
    upload(Path("rooms"), memory, "/s/rooms")
    names, near = run(
        "rooms/list.jsonl", settings={**read_shared_settings("rooms/all.yaml"), **SETTINGS}
    )
    assert names == ["a", "b", "plain"] and near.count("ok") == 3, near.rows
    shared = {**read_shared_settings("memory://s/rooms/all.yaml"), **SETTINGS}
    assert shared["rooms"] == {"polygons": "memory://s/rooms/plan.geojson"}
    names, _result = run("memory://s/rooms/list.jsonl", out="remote", settings=shared)
    assert names == ["a", "b", "plain"] and grids("remote") == grids("out")
    assert run("memory://s/rooms/list.jsonl", out="remote", settings=shared)[0] == []
    sources = [job.source for job in list_jobs(["memory://s/rooms/**/*.xml"])]
    assert sources == ["memory://s/rooms/mjcf/room.xml", "memory://s/rooms/plain.xml"]
    memory.pipe_file("/s/rooms/.hidden/a.xml", b"")
    for pattern in ("*.xml", "**/*.xml", "m*/*.xml", "mjcf/*.[xy]ml", "?????.xml", "**", "*/*.*"):
        local = [
            job.source for job in list_jobs([f"rooms/{pattern}"]) if Path(job.source).is_file()
        ]
        found = [job.source for job in list_jobs([f"memory://s/rooms/{pattern}"])]
        assert found == [f"memory://s/{path}" for path in local] != [], pattern
    with pytest.raises(ConfigError, match=r"files that match memory://s/rooms/no/\*.xml, got none"):
        list_jobs(["memory://s/rooms/no/*.xml"])
    with pytest.raises(ConfigError, match="got the folder memory://s/rooms: name its files"):
        list_jobs(["memory://s/rooms/"])
    with pytest.raises(
        NavbakeError, match=r"cannot read memory://s/rooms/no\.csv: there is no such"
    ):
        list_jobs(["memory://s/rooms/no.csv"])


def test_outlines_may_be_named_by_an_override(rooms):
    override = "rooms.polygons=memory://s/rooms/plan.geojson"
    _, _near = run("rooms/plain.xml", overrides=["rooms.polygons=rooms/plan.geojson"])
    _names, result = run("rooms/plain.xml", out="remote", overrides=[override])
    assert result.count("ok") == 1 and grids("remote") == grids("out"), result.rows
    assert run("rooms/plain.xml", out="remote", overrides=[override])[0] == []


def test_outlines_of_an_override_are_beside_settings_on_a_store(rooms, memory):
    for text in ("scene: {path: plain.xml}\n", "scene: {path: mjcf/room.xml}\n"):
        Path("rooms/own.yaml").write_text(text)
        memory.pipe_file("/s/rooms/own.yaml", text.encode())
        overrides = ["rooms.polygons=plan.geojson"]
        _, near = run("rooms/own.yaml", overrides=overrides)
        for again in (["own"], []):
            names, result = run("memory://s/rooms/own.yaml", out="remote", overrides=overrides)
            assert names == again and result.count("ok") == near.count("ok") == 1, result.rows
        assert grids("remote") == grids("out")
    inside = ["rooms.polygons=[{points: [[0, 0], [1, 0], [1, 1]]}]"]
    assert run("memory://s/rooms/own.yaml", overrides=inside)[1].count("ok") == 1
    away = ["rooms.polygons=../../../plan.geojson"]
    _, result = run("memory://s/rooms/own.yaml", overrides=away)
    assert "expected a path within memory://s/rooms, got ../../../plan" in result.rows[0]["error"]


def test_a_file_url_is_a_path_of_this_machine(rooms, tmp_path):
    names, result = run(f"file://{tmp_path}/rooms/plain.xml", out=f"file://{tmp_path}/out")
    assert names == ["plain"] and result.rows[0]["source"] == "../rooms/plain.xml"
    assert run("rooms/plain.xml")[0] == []
    Path("rooms/a.txt").write_text(f"file://{tmp_path}/rooms/plain.xml\n")
    assert run("rooms/a.txt")[0] == []


def test_the_command_names_the_index_on_a_store(rooms, capsys):
    sources = ("memory://s/rooms/plain.xml", "memory://s/rooms/no.xml")
    with pytest.raises(SystemExit):
        main(["batch", *sources, "-o", "memory://out/", "--set", "grid.cell_size=0.25"])
    out, err = capsys.readouterr()
    first = out.splitlines()[0]
    assert first.startswith("1 baked, 1 failed") and first.endswith(": memory://out/index.jsonl")
    assert err == "navbake: no: error: cannot read memory://s/rooms/no.xml: there is no such file\n"


# ---------------------------------------------------------------- what is done already


@pytest.mark.parametrize("out", ["memory://out", "out"])
def test_what_is_done_is_known_by_what_the_store_says(rooms, memory, monkeypatch, out):
    sources = [f"memory://s/rooms/{name}" for name in rooms]
    assert len(run(*sources, out=out, products=["nav2"])[0]) == 4
    with monkeypatch.context() as patch:
        read, real = [], store.read_file
        patch.setattr(store, "read_file", lambda path: (read.append(str(path)), real(path))[1])
        assert run(*sources, out=out, products=["nav2"])[0] == []
    assert not [name for name in read if name.endswith((".obj", ".png", ".gz"))]
    for name, expected in (
        ("shared/sub/lid.obj", ["room", "set"]),
        ("mjcf/floor.part", ["room", "set"]),
        ("plan.geojson", ["set"]),
        ("plain.xml", ["plain"]),
        ("mjcf/looks/up.png", []),  # no cell knows
    ):
        old = memory.cat_file(f"/s/rooms/{name}")
        new = old.replace(b"0.5", b"0.6").replace(b"2 2", b"2 3").replace(b"[1, 1]", b"[1, 2]")
        memory.pipe_file(f"/s/rooms/{name}", new if new != old else draw_room(4).encode())
        assert run(*sources, out=out, products=["nav2"])[0] == expected, name
        assert run(*sources, out=out, products=["nav2"])[0] == []
    assert run(*sources, out=out)[0] == ["room", "arm", "plain", "set"]
    names = list_file_sizes(out) if is_url(out) else map(str, Path(out).rglob("*"))
    assert not [name for name in names if "nav2" in name]


@pytest.mark.parametrize("key", ["ETag", "md5Hash", "mtime"])
def test_a_tag_of_a_store_tells_that_a_file_is_another(memory, key):
    """Of a store that says nothing of a file's content, the content is read."""
    memory.pipe_file("/a/b.obj", b"1")
    with Mirror() as mirror:
        path = mirror.local_path("memory://a/b.obj")
        assert mirror.has(path) and not mirror.has(path.with_name("c.obj"))
        mirror.entries[path] = {"size": 1}
        assert mirror.describe(path)["sha256"] == hashlib.sha256(b"1").hexdigest()
        mirror.entries[path] = {"size": 1, key: "x1"}
        assert mirror.describe(path) == {"size": 1, "tag": f"{key.lower()}:x1"}


def test_files_of_the_user_in_a_scene_s_folder_on_a_store_stay(memory):
    Path("a.xml").write_text(draw_room(0))
    users = dict.fromkeys(("thumbnail.png", "picture.png", "nav2.yaml"), b"mine")
    for name, content in users.items():
        memory.pipe_file(f"/out/a/{name}", content)
    for options in ({}, {"overrides": ["agent.radius=0.1"]}, {"products": ["inflated:0.3"]}):
        assert run("a.xml", out="memory://out", **options)[1].count("ok") == 1
        files = grids_at("memory://out")
        assert users.items() <= {Path(name).name: data for name, data in files.items()}.items()
    assert {*files} == {f"a/{name}" for name in (*users, "grid.json.gz", INFLATED)}
    run("a.xml", out="memory://out", products=["nav2"])
    assert run("a.xml", out="memory://out")[0] == ["a"]
    assert {*grids_at("memory://out")} == {"a/thumbnail.png", "a/picture.png", "a/grid.json.gz"}
    Path("a.xml").write_text("<mujoco>")
    run("a.xml", out="memory://out")
    assert {*grids_at("memory://out")} == {"a/thumbnail.png", "a/picture.png"}


@pytest.mark.parametrize("last", ["nav2.yaml", "grid.json.gz"])
def test_what_a_killed_upload_left_on_a_store_is_removed(memory, monkeypatch, last):
    def write_until(folder, name, content):
        """Write a file on a store; as a process that is killed after the last one."""
        write_file(folder, name, content)
        if name == last:
            raise KeyboardInterrupt

    Path("a.xml").write_text(draw_room(0))
    with monkeypatch.context() as patch:
        patch.setattr(store, "write_file", write_until)
        with pytest.raises(KeyboardInterrupt):
            run("a.xml", out="memory://out", products=["nav2"])
    assert len([name for name in list_file_sizes("memory://out") if "nav2" in name]) == 2
    assert run("a.xml", out="memory://out")[0] == ["a"]
    assert {*list_file_sizes("memory://out")} == {INDEX_NAME, f"a/{RECORD_NAME}", "a/grid.json.gz"}


def test_a_new_file_here_is_noticed_where_the_grids_are_on_a_store(rooms):
    Path("link").symlink_to("rooms")
    for folder in ("rooms", "link"):
        sources = [f"{folder}/{name}" for name in ("mjcf/room.xml", "arm/arm.urdf", "set.yaml")]
        assert len(run(*sources, out="memory://out")[0]) == 3
        assert run(*sources, out="memory://out")[0] == []
    Path("rooms/mjcf/chest.obj").write_text(CHEST.format(height=2))
    assert run(*sources, out="memory://out")[0] == ["room", "set"]
    Path("rooms/arm/rooms/shared").mkdir(parents=True)
    Path("rooms/arm/rooms/shared/other.obj").write_text(CHEST.format(height=2))
    assert run(*sources, out="memory://out")[0] == []
    Path("rooms/arm/rooms/shared/chest.obj").write_text(CHEST.format(height=2))
    assert run(*sources, out="memory://out")[0] == ["arm"]
    assert run(*sources, out="memory://out")[0] == []


# ---------------------------------------------------------------- what goes wrong


def test_a_scene_that_fails_leaves_nothing_and_is_told_by_its_url(rooms, memory, monkeypatch):
    sources = [
        "memory://s/rooms/mjcf/room.xml",
        "memory://s/rooms/bad.xml",
        "memory://s/rooms/no.xml",
    ]
    memory.pipe_file("/s/rooms/bad.xml", draw_room(5).encode())
    memory.pipe_file("/out/bad/mine.txt", b"mine")
    assert run(*sources[:2], out="memory://out")[1].count("ok") == 2
    memory.pipe_file("/s/rooms/bad.xml", b"<mujoco>")
    _, result = run(*sources, out="memory://out")
    assert [row["status"] for row in result.rows] == ["ok", "failed", "failed"]
    assert result.rows[1]["error"].startswith("broken XML in memory://s/rooms/bad.xml: ")
    assert result.rows[2]["error"] == "cannot read memory://s/rooms/no.xml: there is no such file"
    assert {n for n in list_file_sizes("memory://out") if n.startswith("bad/")} == {"bad/mine.txt"}

    written = []

    def refuse(folder, name, content):
        """A store that fails before the grid."""
        if name == "grid.json.gz":
            raise NavbakeError("the store is full")
        written.append(name)
        write_file(folder, name, content)

    memory.pipe_file("/s/rooms/bad.xml", draw_room(5).encode())
    monkeypatch.setattr(store, "write_file", refuse)
    _, result = run(*sources[:2], out="memory://out", products=["nav2"])
    assert written and result.count("failed") == 2
    assert {n for n in list_file_sizes("memory://out") if "/" in n} == {"bad/mine.txt"}


def test_the_grid_is_the_last_product_of_a_scene_and_the_record_after_it(memory, monkeypatch):
    written = []

    def write(folder, name, content):
        written.append(name)
        write_file(folder, name, content)

    monkeypatch.setattr(store, "write_file", write)
    memory.pipe_file("/a/b.xml", draw_room(1).encode())
    assert run("memory://a/b.xml", out="memory://out", products=["nav2"])[1].count("ok") == 1
    assert written == [
        RECORD_NAME,
        "nav2.pgm",
        "nav2.yaml",
        "grid.json.gz",
        RECORD_NAME,
        INDEX_NAME,
    ]


def test_what_is_missing_is_one_line(memory, monkeypatch):
    assert "memory" in fsspec.available_protocols()
    with pytest.raises(NavbakeError, match=r"cannot read nothing://a/b\.csv: Protocol not known"):
        list_jobs(["nothing://a/b.csv"])
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    message = r's3:// needs fsspec: pip install "navbake\[batch\]"'
    with pytest.raises(MissingDependencyError, match=message):
        list_jobs(["s3://a/b.csv"])


def test_urls_are_told_from_paths():
    assert is_url("s3://a/b") and is_url("memory://a") and is_url("hdfs:///a")
    for path in ("a/b.xml", "C://a", "/a", "file:///a", "local://a", "a:b", Path("s3://a")):
        assert not is_url(path)
    assert (
        strip_file_scheme("file:///a/b c.xml") == "/a/b c.xml"
        and strip_file_scheme("a//b") == "a//b"
    )
    assert as_folder("s3://a/b/") == "s3://a/b" and as_folder("a/") == Path("a")


def test_names_are_found_from_the_folder_of_what_names_them():
    for folder, name, path in (
        ("s3://a/b", "c/d.xml", "s3://a/b/c/d.xml"),
        ("s3://a/b", "../c.xml", "s3://a/c.xml"),
        ("s3://a/b", "s3://e/f", "s3://e/f"),
        (Path("a"), "s3://e/f", "s3://e/f"),
        (Path(), "file:///b", "/b"),
    ):
        assert join(folder, name) == path
    with pytest.raises(ConfigError, match=r"expected a path within s3://a/b, got \.\./\.\./c"):
        join("s3://a/b", "../../c")


def test_passwords_and_queries_are_shown_nowhere(memory, monkeypatch):
    assert without_secrets("sftp://me:secret@host/a.xml") == "sftp://me@host/a.xml"
    assert without_secrets("https://token@host/a.xml?sig=secret") == "https://host/a.xml"
    assert without_secrets("abfs://box@account/a.xml") == "abfs://box@account/a.xml"
    assert without_secrets("s3://a/b@c?.xml") == "s3://a/b@c?.xml"

    def refuse(url):
        raise OSError(f"cannot connect to {url} with secret")

    monkeypatch.setattr("fsspec.core.url_to_fs", refuse)
    url = "sftp://me:secret@host/a.xml"
    with pytest.raises(NavbakeError) as caught:
        read_file(url)
    assert "secret" not in str(caught.value) and "sftp://me@host/a.xml" in str(caught.value)
    _, result = run(url)
    assert "secret" not in Path("out", INDEX_NAME).read_text() and result.count("failed") == 1
    assert caught.value.__cause__ is None  # which --verbose would print
    job = list_jobs(["https://host/a/b.xml?sig=secret"])[0]
    assert job.id == "b" and "secret" not in job.place


def test_elsewhere_a_file_is_written_beside_and_moved(memory, monkeypatch):
    moved = []

    def move(self, path1, path2, **kwargs):
        """As of a store that moves onto no file."""
        if path2 in self.store:
            raise FileExistsError(path2)
        moved.append((path1, path2))
        self.store[path2] = self.store.pop(path1)

    monkeypatch.setattr(store, "OBJECT_STORES", ())
    monkeypatch.setattr(type(memory), "mv", move)
    write_file("memory://a/b", "c.txt", b"1")
    write_file("memory://a/b", "c.txt", b"2")
    assert read_file("memory://a/b/c.txt") == b"2"
    assert [Path(one).parent.as_posix() for one, _ in moved] == ["/a/b", "/a/b"]
    assert list(list_file_sizes("memory://a")) == ["b/c.txt"]
    Path("one.xml").write_text(draw_room(1))
    assert run("one.xml", out="memory://out")[1].count("ok") == 1
    assert {*list_file_sizes("memory://out")} == {
        INDEX_NAME,
        f"one/{RECORD_NAME}",
        "one/grid.json.gz",
    }
    assert run("one.xml", out="memory://out")[0] == []


def test_a_store_without_room_stops_the_batch(tmp_path, memory, monkeypatch):
    (tmp_path / "a.xml").write_text(draw_room(0))
    (tmp_path / "b.xml").write_text(draw_room(1))
    real = type(memory).pipe_file

    def pipe_file(system, path, value, **options):
        if "/a/" in path:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(system, path, value, **options)

    why = "No space left on device: free space and run the same command again"
    with monkeypatch.context() as patch:
        patch.setattr(type(memory), "pipe_file", pipe_file)
        names, result = run("a.xml", "b.xml", out="memory://out")
    assert names == [] and result.count("left") == 2
    assert result.stop_reason == f"cannot write into memory://out/a: {why}"
    assert run("a.xml", "b.xml", out="memory://out")[1].count("ok") == 2
