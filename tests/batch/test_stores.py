"""Batches of scenes on stores, and batches that write into one, against those of this machine."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import platform
import sys
import time
from contextlib import suppress
from functools import partial
from pathlib import Path
from threading import Timer
from unittest.mock import Mock

import pytest
from hypothesis import given
from hypothesis import strategies as st

from batch_in_process import run_sources, stay_in_process
from batch_scenes import CHEST, draw_room
from navbake.batch import remote
from navbake.batch.index import LOCK, NAME
from navbake.batch.manifest import list_jobs
from navbake.batch.products import NOTE
from navbake.batch.settings import read_shared
from navbake.batch.stores import index as remote_index
from navbake.batch.stores import mirror, store
from navbake.batch.stores.index import PARTS, RemoteIndex
from navbake.batch.stores.mirror import Mirror
from navbake.batch.stores.store import (
    Entry,
    Listing,
    is_unchanged,
    list_tree,
    read_file,
    state_of,
    write_file,
    write_first,
)
from navbake.batch.stores.urls import as_folder, is_url, join, plain_path, shown, split_url
from navbake.cli.main import main
from navbake.errors import ConfigError, MissingDependencyError, NavbakeError, SceneError

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
        path.relative_to(folder).as_posix(): path.read_bytes() for path in Path(folder).glob("*/*")
    }


def grids_at(url):
    return {name: read_file(f"{url}/{name}", 1 << 30) for name in list_tree(url) if "/" in name}


# ---------------------------------------------------------------- the same bytes


def test_scenes_on_a_store_give_the_bytes_of_local_ones(rooms):
    make = ["inflated:0.3", "nav2", "voxels:0.5"]
    _, near = run(*(f"rooms/{name}" for name in rooms), products=make)
    assert [row["status"] for row in near.rows] == ["ok"] * 4, near.rows
    _, result = run(*(f"memory://s/rooms/{name}" for name in rooms), out="remote", products=make)
    assert grids("remote") == grids("out") and len(grids("remote")) == 24
    _, result = run(
        *(f"memory://s/rooms/{name}" for name in rooms), out="memory://b/c", products=make
    )
    assert grids_at("memory://b/c") == grids("out")
    _, result = run(*(f"rooms/{name}" for name in rooms), out="memory://d", products=make)
    assert grids_at("memory://d") == grids("out")
    measured = ("id", "levels", "cells", "free_area", "rooms", "scene_digest", "warnings", "audit")
    for row, other in zip(near.rows, result.rows, strict=True):
        assert {key: row[key] for key in measured} == {key: other[key] for key in measured}
    index = read_file("memory://b/c/index.jsonl", 1 << 20)
    assert b"tmp" not in index and b"memory://s/rooms/shared/sub/lid.obj" in index
    row = json.loads(index.splitlines()[0])
    assert row["source"] == "memory://s/rooms/mjcf/room.xml"
    shared = {"shared/chest.obj", "shared/sub/lid.obj", "mjcf/floor.part", "mjcf/room.xml"}
    assert set(row["inputs"]) == {f"memory://s/rooms/{name}" for name in shared}
    assert {name for name in list_tree("memory://b/c") if "/" not in name} == {NAME}


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
    names, near = run("rooms/list.jsonl", settings={**read_shared("rooms/all.yaml"), **SETTINGS})
    assert names == ["a", "b", "plain"] and near.count("ok") == 3, near.rows
    shared = {**read_shared("memory://s/rooms/all.yaml"), **SETTINGS}
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
    with pytest.raises(ConfigError, match="got the folder memory://s/rooms: name what is in it"):
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
    assert "what is on a store names no file elsewhere" in result.rows[0]["error"]


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
    assert out.startswith("1 baked, 1 failed") and out.endswith(": memory://out/index.jsonl\n")
    assert err == "navbake: no: error: cannot read memory://s/rooms/no.xml: there is no such file\n"


# ---------------------------------------------------------------- what is done already


def test_what_is_done_is_known_by_listings_alone(rooms, memory, monkeypatch):
    sources = [f"memory://s/rooms/{name}" for name in rooms]
    make = ["nav2"]
    real = type(memory).info

    def only_the_lock(self, path, **kwargs):
        assert path.endswith(LOCK), f"{path} was asked for"
        return real(self, path, **kwargs)

    monkeypatch.setattr(store, "RECENT", 0.0)  # or the times of these files prove nothing
    for out in ("memory://out", "out"):
        assert len(run(*sources, out=out, products=make)[0]) == 4
        with monkeypatch.context() as patch:
            patch.setattr(store, "digest_file", lambda url: pytest.fail(f"{url} was read"))
            patch.setattr(type(memory), "info", only_the_lock)
            assert run(*sources, out=out, products=make)[0] == []
        before = read_file("memory://out/index.jsonl", 1 << 20)
        for name in ("shared/sub/lid.obj", "mjcf/floor.part", "plan.geojson", "plain.xml"):
            old = memory.cat_file(f"/s/rooms/{name}")
            new = old.replace(b"0.5", b"0.6").replace(b"2 2", b"2 3").replace(b"[1, 1]", b"[1, 2]")
            new = new if new != old else draw_room(4).encode()
            memory.pipe_file(f"/s/rooms/{name}", new)
            expected = {
                "shared/sub/lid.obj": ["room", "set"],
                "mjcf/floor.part": ["room", "set"],
                "plan.geojson": ["set"],
                "plain.xml": ["plain"],
            }
            assert run(*sources, out=out, products=make)[0] == expected[name], name
            memory.pipe_file(f"/s/rooms/{name}", old)
            assert run(*sources, out=out, products=make)[0] == expected[name], name
        memory.pipe_file("/s/rooms/mjcf/looks/up.png", b"broken, and no cell knows")
        memory.pipe_file("/s/rooms/arm/arm.urdf", URDF.encode())  # the same, at another time
        assert run(*sources, out=out, products=make)[0] == []
        assert json.loads(before.splitlines()[0])["id"] == "room"
        write_rooms(Path("again") / out.replace("/", ""))
        upload(Path("again") / out.replace("/", ""), memory, "/s/rooms")
    assert run(*sources, out="out", products=make, overrides=["agent.radius=0.1"])[0] != []
    memory.pipe_file("/out/plain/nav2.pgm", b"changed")
    memory.rm_file("/out/room/nav2.yaml")
    assert run(*sources, out="memory://out", products=make)[0] == ["room", "plain"]
    assert run(*sources, out="memory://out")[0] == ["room", "arm", "plain", "set"]
    assert not [name for name in list_tree("memory://out") if "nav2" in name]


@pytest.mark.parametrize(
    "name", ["http://169.254.169.254/a", "memory://t/a", "zip://a::memory://s"]
)
def test_an_index_makes_nobody_ask_other_stores(rooms, memory, monkeypatch, name):
    source = "memory://s/rooms/plain.xml"
    assert run(source, out="memory://out")[0] == ["plain"]
    row = json.loads(read_file(f"memory://out/{NAME}", 1 << 20))
    row["inputs"][name] = {"size": 1, "tag": None, "sha256": ""}
    memory.pipe_file(f"/out/{NAME}", json.dumps(row).encode())
    asked, real = [], fsspec.core.url_to_fs
    monkeypatch.setattr("fsspec.core.url_to_fs", lambda url: (asked.append(url), real(url))[1])
    assert run(source, out="memory://out")[0] == ["plain"]
    assert asked and all(url.startswith(("memory://s/", "memory://out")) for url in asked)


@pytest.mark.parametrize(
    ("out", "outlines"), [("memory://out", "rooms"), ("out", "memory://s/rooms")]
)
def test_changed_settings_here_are_noticed_where_something_else_is_on_a_store(rooms, out, outlines):
    row = {"config": "own.yaml", "rooms.polygons": f"{outlines}/plan.geojson"}
    Path("list.jsonl").write_text(json.dumps(row))
    for cell, names in ((0.5, ["own"]), (0.25, ["own"]), (0.25, [])):
        text = f"scene: {{path: rooms/plain.xml}}\ngrid: {{cell_size: {cell}}}\n"
        Path("own.yaml").write_text(text)
        assert run("list.jsonl", out=out, settings={})[0] == names, cell
    os.utime("own.yaml", (1, 1))  # the content is the same
    assert run("list.jsonl", out=out, settings={})[0] == []


def test_ten_thousand_scenes_are_asked_for_in_few_calls(memory, monkeypatch):
    calls = []
    count = 200
    for number in range(count):
        for name in ("scene.xml", "mesh/a.obj"):
            memory.pipe_file(f"/many/{number:05}/{name}", b"1")
    for name in ("ls", "find", "info", "exists", "open"):
        real = getattr(type(memory), name)

        def counted(self, path, *args, _real=real, _name=name, **kwargs):
            calls.append(_name)
            return _real(self, path, *args, **kwargs)

        monkeypatch.setattr(type(memory), name, counted)
    listing = Listing()
    urls = [
        f"memory://many/{n:05}/{name}" for n in range(count) for name in ("scene.xml", "mesh/a.obj")
    ]
    listing.load({url.rpartition("/")[0] for url in urls})
    assert all(listing.entry(url).size == 1 for url in urls)
    assert listing.entry("memory://many/00000/no.xml") is None
    assert calls == ["find"]


def test_files_of_the_user_in_a_scene_s_folder_on_a_store_stay(memory):
    Path("a.xml").write_text(draw_room(0))
    users = dict.fromkeys(("thumbnail.png", "picture.png", "nav2.yaml"), b"mine")
    for name, content in users.items():
        memory.pipe_file(f"/out/a/{name}", content)
    for options in ({}, {"overrides": ["agent.radius=0.1"]}, {"products": ["inflated:0.3"]}):
        assert run("a.xml", out="memory://out", **options)[1].count("ok") == 1
        files = grids_at("memory://out")
        assert users.items() <= {Path(name).name: data for name, data in files.items()}.items()
    assert {*files} == {f"a/{name}" for name in (*users, "grid.json.gz", NOTE, INFLATED)}
    run("a.xml", out="memory://out", products=["nav2"])
    assert run("a.xml", out="memory://out")[0] == ["a"]
    assert {*grids_at("memory://out")} == {"a/thumbnail.png", "a/picture.png", "a/grid.json.gz"}
    Path("a.xml").write_text("<mujoco>")
    run("a.xml", out="memory://out")
    assert {*grids_at("memory://out")} == {"a/thumbnail.png", "a/picture.png"}


@pytest.mark.parametrize("last", ["nav2.yaml", "grid.json.gz"])
def test_what_a_killed_upload_left_on_a_store_is_removed(memory, monkeypatch, last):
    Path("a.xml").write_text(draw_room(0))
    with monkeypatch.context() as patch:
        patch.setattr(mirror, "write_file", partial(write_until, last))
        with pytest.raises(KeyboardInterrupt):
            run("a.xml", out="memory://out", products=["nav2"])
    assert len([name for name in list_tree("memory://out") if "nav2" in name]) == 2
    assert run("a.xml", out="memory://out")[0] == ["a"]
    assert {*list_tree("memory://out")} == {NAME, "a/grid.json.gz"}


def write_until(last, url, content):
    """Write a file on a store; as a process that is killed after the last one."""
    write_file(url, content)
    if url.endswith(last):
        raise KeyboardInterrupt


def test_an_interrupted_run_on_a_store_keeps_what_was_known(memory, monkeypatch):
    for name in ("a.xml", "b.xml"):
        Path(name).write_text(draw_room(0))
    sources, others = ("a.xml", "b.xml"), ["agent.radius=0.1"]
    run(*sources, out="memory://out")
    before = read_file(f"memory://out/{NAME}", 1 << 20)
    with monkeypatch.context() as patch:
        patch.setattr("navbake.batch.work.run_bake", Mock(side_effect=KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            run(*sources, out="memory://out", overrides=others)
    assert run(*sources, out="memory://out")[0] == []
    assert read_file(f"memory://out/{NAME}", 1 << 20) == before


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
    assert {n for n in list_tree("memory://out") if n.startswith("bad")} == {"bad/mine.txt"}

    written = []
    real = remote.upload

    def refuse(files, folder):
        """A store that fails before the grid."""
        written.extend(real(dict([*files.items()][:-1]), folder))
        raise NavbakeError("the store is full")

    memory.pipe_file("/s/rooms/bad.xml", draw_room(5).encode())
    monkeypatch.setattr(remote, "upload", refuse)
    _, result = run(*sources[:2], out="memory://out", products=["nav2"])
    assert written and result.count("failed") == 2
    assert {n for n in list_tree("memory://out") if "/" in n} == {"bad/mine.txt"}


@pytest.mark.parametrize(
    "text",
    [
        '<mesh name="m" file="{outside}/m.obj"/>',
        '<mesh name="m" file="../../../../../../../../../../../../../{outside}/m.obj"/>',
        '<texture name="t" type="2d" file="{outside}/t.png"/>',
        '<texture name="t" type="cube" fileup="{outside}/t.png"/>',
    ],
)
def test_a_scene_on_a_store_reads_no_file_of_this_machine(memory, tmp_path, text):
    from PIL import Image

    (tmp_path / "m.obj").write_text(CHEST.format(height=1))
    Image.new("RGB", (2, 2)).save(tmp_path / "t.png")
    asset = text.format(outside=tmp_path)
    memory.pipe_file("/a/b.xml", f"<mujoco><asset>{asset}</asset></mujoco>".encode())
    with pytest.raises(SceneError, match=r"memory://a/b.xml names the file .* of this machine"):
        Mirror(tmp_path / "tmp" / "in").fetch_scene("memory://a/b.xml")
    assert "of this machine" in run("memory://a/b.xml")[1].rows[0]["error"]
    fsspec.filesystem("local").rm(str(tmp_path / "tmp" / "in"), recursive=True)


def test_a_scene_on_a_store_whose_names_nobody_knows_is_refused(memory, tmp_path):
    (tmp_path / "m.obj").write_text(CHEST.format(height=1))
    asset = f'<asset><mesh file="{tmp_path}/m.obj"/></asset>'
    # MuJoCo's parser takes the comment, Python's doesn't
    memory.pipe_file("/a/b.xml", f"<mujoco><!-- a -- b -->{asset}</mujoco>".encode())
    error = run("memory://a/b.xml")[1].rows[0]["error"]
    assert error.startswith("broken XML in memory://a/b.xml: not well-formed")


def test_the_grid_is_the_last_file_of_a_scene(memory, monkeypatch):
    written = []
    real = remote.upload
    monkeypatch.setattr(
        remote, "upload", lambda files, to: written.extend(files) or real(files, to)
    )
    memory.pipe_file("/a/b.xml", draw_room(1).encode())
    assert run("memory://a/b.xml", out="memory://out", products=["nav2"])[1].count("ok") == 1
    assert written == ["nav2.pgm", "nav2.yaml", "grid.json.gz"]


@pytest.mark.parametrize("name", ["/etc/hosts", "file:///etc/hosts", "s3://a/b", "../../x", "C:/x"])
def test_settings_and_lists_on_a_store_name_nothing_elsewhere(memory, name):
    memory.pipe_file("/a/s.yaml", f"scene: {{path: '{name}'}}".encode())
    memory.pipe_file("/a/r.yaml", f"rooms: {{polygons: '{name}'}}".encode())
    memory.pipe_file("/a/l.txt", name.encode())
    for call in (list_jobs, lambda sources: read_shared("memory://a/r.yaml")):
        with pytest.raises(ConfigError, match="names no file elsewhere"):
            call(["memory://a/l.txt"])
    assert "names no file elsewhere" in run("memory://a/s.yaml")[1].rows[0]["error"]


@pytest.mark.parametrize("url", ["simplecache::s3://a/b.xml", "zip://a.xml::memory://b/c.zip"])
def test_chains_of_file_systems_are_refused(url):
    with pytest.raises(ConfigError, match="expected a URL of one file system"):
        list_jobs([url])


def test_what_is_missing_is_one_line(memory, monkeypatch):
    assert "memory" in fsspec.available_protocols()
    with pytest.raises(NavbakeError, match=r"cannot read nothing://a/b\.csv: Protocol not known"):
        list_jobs(["nothing://a/b.csv"])
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    message = r'paths such as s3:// need fsspec: pip install "navbake\[batch\]"'
    with pytest.raises(MissingDependencyError, match=message):
        list_jobs(["s3://a/b.csv"])


# ---------------------------------------------------------------- URLs


def test_urls_are_told_from_paths():
    assert is_url("s3://a/b") and is_url("memory://a") and is_url("hdfs:///a")
    for path in ("a/b.xml", "C://a", "/a", "file:///a", "local://a", "a:b", Path("s3://a")):
        assert not is_url(path)
    assert plain_path("file:///a/b c.xml") == "/a/b c.xml" and plain_path("a//b") == "a//b"
    assert as_folder("s3://a/b/") == "s3://a/b" and as_folder("a/") == Path("a")
    for url in ("s3://a//b.xml", "s3://a/../b.xml", "s3://a/./b.xml"):
        with pytest.raises(ConfigError, match="expected names between the slashes"):
            split_url(url)


def test_names_are_found_from_the_folder_of_what_names_them():
    assert join("s3://a/b", "c/d.xml", "") == "s3://a/b/c/d.xml"
    assert join("s3://a/b", "../c.xml", "") == "s3://a/c.xml"
    assert join("s3://a/b", "s3://e/f", "") == "s3://e/f"
    assert join(Path("a"), "s3://e/f", "") == "s3://e/f"
    assert join(Path(), "a/../b", "") == "a/../b"


@given(st.text(alphabet="ab./\\:@%~", max_size=12), st.sampled_from(["s3://b", "s3://b/c/d"]))
def test_no_name_leads_out_of_a_store(name, folder):
    try:
        url = join(folder, name, "here")
    except ConfigError:
        return
    assert url.startswith("s3://b") and url[6:7] in ("", "/")
    with suppress(ConfigError):  # a folder, or what is no name
        assert ".." not in split_url(url).path


def test_passwords_and_queries_are_shown_nowhere(memory, monkeypatch):
    assert shown("sftp://me:secret@host/a.xml") == "sftp://me@host/a.xml"
    assert shown("https://token@host/a.xml?sig=secret") == "https://host/a.xml"
    assert shown("abfs://box@account/a.xml") == "abfs://box@account/a.xml"
    assert shown("s3://a/b@c?.xml") == "s3://a/b@c?.xml"

    def refuse(url):
        raise OSError(f"cannot connect to {url} with secret")

    monkeypatch.setattr("fsspec.core.url_to_fs", refuse)
    url = "sftp://me:secret@host/a.xml"
    with pytest.raises(NavbakeError) as caught:
        read_file(url, 1)
    assert "secret" not in str(caught.value) and "sftp://me@host/a.xml" in str(caught.value)
    _, result = run(url)
    assert "secret" not in Path("out", NAME).read_text() and result.count("failed") == 1
    assert caught.value.__cause__ is None  # which --verbose would print
    told = store.hide_secrets("403, url='https://host/a.xml?b=1&sig=secret'", [])  # respelt
    assert told == "403, url='https://host/a.xml'"
    job = list_jobs(["https://host/a/b.xml?sig=secret"])[0]
    assert job.id == "b" and "secret" not in job.place


# ---------------------------------------------------------------- files of a store


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
    write_file("memory://a/b/c.txt", b"1")
    write_file("memory://a/b/c.txt", b"2")
    assert read_file("memory://a/b/c.txt", 10) == b"2"
    assert [Path(one).parent.as_posix() for one, _ in moved] == ["/a/b", "/a/b"]
    assert list(list_tree("memory://a")) == ["b/c.txt"]
    assert write_first("memory://a/lock", b"1") and not write_first("memory://a/lock", b"2")
    Path("one.xml").write_text(draw_room(1))
    memory.pipe_file("/out/one/.navbake-0123456789abcdef.tmp", b"half")
    assert run("one.xml", out="memory://out")[1].count("ok") == 1
    assert set(list_tree("memory://out")) == {NAME, "one/grid.json.gz"}
    assert run("one.xml", out="memory://out")[0] == []


def test_a_recent_time_proves_nothing_and_content_decides(memory, monkeypatch):
    memory.pipe_file("/b/a.xml", b"1")
    assert Listing().entry("memory://b/a.xml").tag is None
    assert list_tree("memory://b", is_own=True)["a.xml"].tag is not None
    known = state_of(Entry(1, None), {"size": 1, "sha256": hashlib.sha256(b"1").hexdigest()})
    assert is_unchanged(known, Entry(1, None), "memory://b/a.xml")
    memory.pipe_file("/b/a.xml", b"2")
    assert not is_unchanged(known, Entry(1, None), "memory://b/a.xml")
    later = time.time() + 100
    monkeypatch.setattr(time, "time", lambda: later)
    assert Listing().entry("memory://b/a.xml").tag is not None


# ---------------------------------------------------------------- the index


@pytest.fixture
def quick(monkeypatch):
    """A token is written every few milliseconds."""
    monkeypatch.setattr(remote_index, "INTERVAL", 0.02)


def wait_until(is_so):
    end = time.monotonic() + 60.0
    while not is_so():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_rows_are_in_parts_until_the_end(memory, quick):
    index = RemoteIndex("memory://out")
    index.add({"id": "a", "n": 1})
    wait_until(lambda: len(list_tree(f"memory://out/{PARTS}")) == 1)
    index.add({"id": "b", "n": 1})
    wait_until(lambda: len(list_tree(f"memory://out/{PARTS}")) == 2)
    index.close()  # before it is finished
    index = RemoteIndex("memory://out")
    assert [*index.known] == ["a", "b"] and not list_tree(f"memory://out/{PARTS}")
    assert read_file(f"memory://out/{NAME}", 99) == b'{"id":"a","n":1}\n{"id":"b","n":1}\n'
    index.add({"id": "b", "n": 2})
    index.finish(["b", "c"], [], lambda id: {"id": id})
    index.close()
    assert index.rows == [{"id": "b", "n": 2}, {"id": "c"}, {"id": "a", "n": 1}]
    assert list(list_tree("memory://out")) == [NAME]


def test_only_one_batch_writes_into_a_folder(memory, quick, monkeypatch):
    first = RemoteIndex("memory://out")
    with pytest.raises(NavbakeError, match="another batch writes into memory://out"):
        RemoteIndex("memory://out")
    memory.pipe_file(f"/out/{LOCK}", b'{"token": "other"}')
    refused = []

    def is_refused():
        try:
            first.add({"id": "a"})
        except NavbakeError as error:
            refused.append(str(error))
        return refused

    wait_until(is_refused)
    assert refused[0].startswith("another batch took memory://out over")
    with pytest.raises(NavbakeError, match="another batch took memory://out over"):
        first.finish([], [], lambda id: {})
    first.close()
    assert list(list_tree("memory://out")) == [LOCK]  # which is the other's
    monkeypatch.setattr(remote_index, "PATIENCE", 0.2)
    begin = time.monotonic()
    second = RemoteIndex("memory://out")  # of which nothing is heard
    assert time.monotonic() - begin >= 0.2
    second.close()
    assert list(list_tree("memory://out")) == []


@pytest.mark.parametrize("has_token", [True, False])
def test_a_batch_that_was_taken_over_leaves_the_rows_of_the_other(memory, has_token):
    slept = RemoteIndex("memory://out")  # it looks at its token every few seconds
    slept.add({"id": "a", "n": 1})
    memory.pipe_file(f"/out/{NAME}", b'{"id":"b","n":2}\n')
    if has_token:
        memory.pipe_file(f"/out/{LOCK}", b'{"token": "other"}')
    else:  # the other has ended
        memory.rm_file(f"/out/{LOCK}")
    with pytest.raises(NavbakeError, match="another batch took memory://out over"):
        slept.finish(["a"], [], lambda id: {})
    slept.close()
    assert read_file(f"memory://out/{NAME}", 99) == b'{"id":"b","n":2}\n'
    assert (LOCK in list_tree("memory://out")) == has_token


@pytest.mark.skipif(os.name != "posix", reason="how POSIX asks for a process")
def test_the_folder_of_a_batch_that_died_here_is_free_at_once(memory):
    token = {"token": "a", "beat": 3, "host": platform.node(), "ids": remote_index.owner_of_ids()}
    token["pid"] = 2**22 + 1  # no such process
    memory.pipe_file(f"/out/{LOCK}", json.dumps(token).encode())
    begin = time.monotonic()
    RemoteIndex("memory://out").close()
    assert time.monotonic() - begin < remote_index.PATIENCE / 2


def test_a_batch_in_another_container_of_the_same_name_is_not_taken_for_dead(
    memory, quick, monkeypatch
):
    monkeypatch.setattr(remote_index, "PATIENCE", 0.2)
    token = {"token": "a", "beat": 3, "host": platform.node(), "ids": "another", "pid": 2**22 + 1}
    memory.pipe_file(f"/out/{LOCK}", json.dumps(token).encode())
    begin = time.monotonic()
    RemoteIndex("memory://out").close()
    assert time.monotonic() - begin >= remote_index.PATIENCE


def test_what_a_store_refuses_once_is_written_later(memory, quick, monkeypatch):
    index = RemoteIndex("memory://out")
    refused = []

    def refuse(url, content):
        refused.append(url)
        raise NavbakeError("no network")

    with monkeypatch.context() as patch:
        patch.setattr(remote_index, "write_file", refuse)
        index.add({"id": "a"})
        wait_until(lambda: len(refused) > 2)
    wait_until(lambda: list_tree(f"memory://out/{PARTS}"))
    index.finish(["a"], [], lambda id: {})
    index.close()
    assert read_file(f"memory://out/{NAME}", 99) == b'{"id":"a"}\n'


def test_a_folder_that_is_given_back_is_not_waited_for(memory, quick):
    memory.pipe_file(f"/out/{LOCK}", b'{"token": "other"}')
    Timer(0.1, memory.rm_file, [f"/out/{LOCK}"]).start()
    begin = time.monotonic()
    RemoteIndex("memory://out").close()
    assert time.monotonic() - begin < remote_index.PATIENCE / 2
    assert list(list_tree("memory://out")) == []


def test_a_row_that_can_not_be_written_is_told_and_keeps_others_away(memory, quick):
    index = RemoteIndex("memory://out")
    index.add({"id": "a", "n": float("nan")})
    tokens = set()
    wait_until(lambda: tokens.add(memory.cat_file(f"/out/{LOCK}")) or len(tokens) > 3)
    with pytest.raises(ValueError, match="JSON"):
        index.finish(["a"], [], lambda id: {})
    index.close()


# ---------------------------------------------------------------- temporary folders


def test_a_store_without_room_stops_the_batch_and_a_full_temporary_folder_does_not(
    tmp_path, memory, monkeypatch
):
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
    assert result.stopped == f"cannot write memory://out/a/grid.json.gz: {why}"
    with monkeypatch.context() as patch:
        patch.setattr("navbake.batch.work.write_navgrid", lambda grid, path: pipe_file(0, "/a/", 0))
        names, result = run("a.xml", out="memory://out")
    assert result.stopped is None and result.rows[0]["error"].endswith(why)
    assert run("a.xml", "b.xml", out="memory://out")[1].count("ok") == 2
