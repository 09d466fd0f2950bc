"""Slices of a batch and their merging, equal scenes, previews, costs, and shards."""

from __future__ import annotations

import gzip
import json
import os
import re
import shutil
import tarfile
from functools import partial
from itertools import chain
from pathlib import Path

import mujoco
import pytest
import trimesh

from batch_in_process import run_sources, stay_in_process
from batch_scenes import draw_room
from command_line import run_command
from navbake import samples
from navbake.batch import index as index_module
from navbake.batch import job as job_module
from navbake.batch.index import INDEX_NAME, Slice, lock_batch, read_index
from navbake.batch.job import MESH_CACHE_SIZE, prepare_worker
from navbake.batch.products import RECORD_NAME
from navbake.batch.run import measure_cost
from navbake.batch.scenes import list_jobs
from navbake.errors import ConfigError, NavbakeError
from project_paths import ROOT

SETTINGS = {"grid": {"cell_size": 0.2}}
TIMES = ("seconds", "stages", "ended")
run = partial(run_sources, "scenes/*.xml", settings=SETTINGS)
# how WebDataset parts a name into the sample's key and the member's ending
KEY = re.compile(r"^((?:.*/|)[^.]+)[.]([^/]*)$")


@pytest.fixture(autouse=True)
def scenes(tmp_path, monkeypatch):
    """Jobs are done in this process; the current folder has seven scenes, one of them broken."""
    stay_in_process(monkeypatch)
    monkeypatch.chdir(tmp_path)
    Path("scenes").mkdir()
    for number, name in enumerate(("a", "b.v2", "c", "d", "e", "f")):
        Path(f"scenes/{name}.xml").write_text(draw_room(number))
    Path("scenes/bad.xml").write_text("<mujoco>")
    return tmp_path / "scenes"


@pytest.fixture
def count_bakes(monkeypatch):
    """Returns the ids of the scenes that were baked, a list that grows."""
    baked, real = [], job_module.run_bake

    def counted(config, **options):
        baked.append(config.scene.id)
        return real(config, **options)

    monkeypatch.setattr(job_module, "run_bake", counted)
    return baked


def made(folder):
    """The content of all files of scenes and of shards and sets, by name."""
    kept = [path for path in Path(folder).rglob("*") if path.is_file() and path.name != RECORD_NAME]
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in kept
        if not path.name.startswith((".navbake-batch", "index"))
    }


def timeless(rows):
    return [{key: row[key] for key in row if key not in TIMES} for row in rows]


def test_slices_merge_into_the_bytes_of_one_run():
    make, slices = ["episodes:point:uniform:5"], [Slice(number, 3) for number in (1, 2, 3)]
    found = [
        run(out="parts", batch_slice=part, products=make)[0] for part in slices[1:] + slices[:1]
    ]
    assert sorted(chain.from_iterable(found)) == ["a", "b.v2", "bad", "c", "d", "e", "f"]
    assert {len(ids) for ids in found} == {2, 3}
    assert not Path("parts", INDEX_NAME).exists() and not [*Path("parts").glob("episodes*")]
    _, merged = run(out="parts", only_merge=True, products=make, shards=2)
    assert (merged.num_skipped, merged.count("failed"), merged.count("left")) == (6, 1, 0)
    assert {path.name for path in Path("parts").glob("*index-*")} == set()
    assert [path.name for path in Path("parts").glob(".*lock")] == [".navbake-batch.lock"]
    _, one = run(out="one", products=make, shards=2)
    assert made("parts") == made("one") and len(made("one")) == 6 * 2 + 1 + 2
    assert timeless(merged.rows) == timeless(one.rows)
    # a run of the whole writes the same index, and so does a run that merges what slices left
    before = Path("parts", INDEX_NAME).read_bytes()
    Path("scenes/bad.xml").unlink()
    run(out="parts", products=make)
    lines = before.splitlines(keepends=True)
    good = [line for line in lines if json.loads(line)["status"] == "ok"]
    bad = [line for line in lines if line not in good]
    assert Path("parts", INDEX_NAME).read_bytes() == b"".join(good + bad)  # of other batches follow


def test_what_slices_leave_is_done_by_the_next_run():
    run(out="out", batch_slice=Slice(1, 2))
    part = Path("out/index-1-of-2.jsonl")
    part.write_bytes(part.read_bytes() + b'{"id": "b.v')  # killed while it wrote
    _, merged = run(out="out", only_merge=True)
    status = ["ok", "left", "failed", "left", "ok", "left", "ok"]
    assert [row["status"] for row in merged.rows] == status
    names, result = run(out="out")
    assert names == [row["id"] for row in merged.rows if row["status"] != "ok"]
    assert (result.count("ok"), result.num_skipped) == (6, merged.count("ok"))


def test_slices_keep_the_rows_of_scenes_whose_folder_is_not_named_in_utf_8():
    folder = Path(os.fsdecode(b"d\xff"))
    try:
        folder.mkdir()
    except OSError:  # as on macOS
        pytest.skip("the file system takes names in UTF-8 alone")
    for name in ("a.xml", "b.xml"):
        (folder / name).write_text("<mujoco>")
    run_broken = partial(run_sources, "d*/*.xml", out="out", settings=SETTINGS)
    for number in (1, 2):
        run_broken(batch_slice=Slice(number, 2))
    _, merged = run_broken(only_merge=True)
    assert [Path(row["source"]).parts[-2:] for row in merged.rows] == [
        (folder.name, "a.xml"),
        (folder.name, "b.xml"),
    ]
    assert (merged.count("failed"), merged.count("left")) == (2, 0)


@pytest.mark.parametrize("totals", [(8, 4), (4, 8)])
def test_of_slices_of_other_numbers_the_row_that_ended_last_counts(totals, scenes):
    text = (scenes / "a.xml").read_text()
    (scenes / "a.xml").write_text("<mujoco>")
    run(out="out", batch_slice=Slice(1, totals[0]))
    assert read_index(Path("out"), Slice(1, totals[0]).index_name)["a"]["status"] == "failed"
    (scenes / "a.xml").write_text(text)
    run(out="out", batch_slice=Slice(1, totals[1]))
    shutil.copytree("out", "other")
    _, merged = run(out="out", only_merge=True)
    assert merged.rows[0]["status"] == read_index(Path("out"))["a"]["status"] == "ok"
    run_sources("scenes/f.xml", out="other", settings=SETTINGS)  # whose index takes in the parts
    assert read_index(Path("other"))["a"] == merged.rows[0]
    assert not [*Path("other").glob("index-*")]


def test_slices_write_into_a_store():
    fsspec = pytest.importorskip("fsspec")
    store = fsspec.filesystem("memory")
    for number in (1, 2):
        run(out="memory://sliced", batch_slice=Slice(number, 2))
    assert store.exists("/sliced/index-2-of-2.jsonl") and not store.exists("/sliced/index.jsonl")
    _, merged = run(out="memory://sliced", only_merge=True, shards=1)
    assert (merged.count("ok"), merged.count("failed"), merged.count("left")) == (6, 1, 0)
    names = {Path(name).name for name in store.ls("/sliced", detail=False)}
    own = {"a", "b.v2", "c", "d", "e", "f", "index.jsonl", "shard-000000.tar"}
    assert names == own | {RECORD_NAME}
    _, one = run(out="one", shards=1)
    for row in one.rows:
        if row["status"] == "ok":
            grid = Path("one", row["id"], "grid.json.gz").read_bytes()
            assert store.cat(f"/sliced/{row['id']}/grid.json.gz") == grid


def test_slices_run_beside_each_other_and_not_beside_the_whole(monkeypatch):
    monkeypatch.setattr(index_module, "LOCK_TIMEOUT", 0.1)
    with (
        lock_batch(Path("out")),
        pytest.raises(NavbakeError, match="another batch writes into out"),
    ):
        run(out="out", batch_slice=Slice(1, 2))
    with lock_batch(Path("out"), Slice(1, 2)):
        run(out="out", batch_slice=Slice(2, 2))
        with pytest.raises(NavbakeError, match="another batch writes into out"):
            run(out="out")
        with pytest.raises(NavbakeError, match="another batch writes into out"):
            run(out="out", only_merge=True)
    run(out="out", only_merge=True)


def test_equal_scenes_are_baked_once_and_have_the_bytes_of_their_own_bake(count_bakes):
    house = samples.path("house")
    text = Path(house).read_text().replace("scenes/house.xml", "{}.xml")
    for name in ("x", "y", "z"):
        shutil.copy(Path(house).parent / "scenes" / "house.xml", f"scenes/{name}.xml")
        Path(f"scenes/{name}.yaml").write_text(text.replace("{}", name))
    sources = [f"scenes/{name}.yaml" for name in ("x", "y", "z")]
    make = ["nav2", "voxels:0.5", "episodes:point:uniform:3"]
    options = {"settings": {"grid": {"cell_size": 0.25}}, "products": make}
    run_sources(*sources, out="out", **options)
    assert len(count_bakes) == 1
    for name in ("x", "y", "z"):
        run_sources(f"scenes/{name}.yaml", out="own", **options)
    assert len(count_bakes) == 4
    own = {name: data for name, data in made("own").items() if "/" in name}
    assert {name: data for name, data in made("out").items() if "/" in name} == own
    # a scene that is done serves, and one that changed doesn't
    shutil.copy("scenes/x.xml", "scenes/w.xml")
    Path("scenes/w.yaml").write_text(text.replace("{}", "w"))
    Path("scenes/y.xml").write_text(draw_room(1))
    run_sources("scenes/w.yaml", *sources, out="out", **options)
    assert count_bakes[4:] == ["y"]


def test_copies_of_a_mesh_have_the_names_of_their_own_bake(count_bakes):
    floor = trimesh.creation.box((4, 4, 0.2))
    for name in ("aa", "bb"):
        floor.export(f"scenes/{name}.stl")
    run_sources("scenes/aa.stl", "scenes/bb.stl", out="out", settings=SETTINGS)
    run_sources("scenes/bb.stl", out="own", settings=SETTINGS)
    assert count_bakes == ["aa", "bb", "bb"]
    grid = gzip.decompress(Path("out/bb/grid.json.gz").read_bytes())
    assert grid == gzip.decompress(Path("own/bb/grid.json.gz").read_bytes())
    assert b'"bb"' in grid and b'"aa"' not in grid


def test_a_twin_whose_other_has_a_warning_of_a_file_is_baked_itself(count_bakes):
    texture = '<mujoco><asset><texture name="t" type="2d" file="no.png"/></asset>'
    for name in ("x", "y"):
        Path(f"scenes/{name}.xml").write_text(draw_room(9).replace("<mujoco>", texture))
    run_sources("scenes/x.xml", "scenes/y.xml", settings=SETTINGS)
    assert count_bakes == ["x", "y"]
    (warning,) = read_index(Path("out"))["y"]["warnings"]
    assert "scenes/y.xml" in warning


def plan_of(capsys, *words):
    command = ("batch", "scenes/*.xml", "-o", "out", "--plan", "--json", "--set", "grid.margin=0.1")
    status, out, err = run_command(capsys, *command, *words)
    assert (status, err) == (0, "")
    return {scene["id"]: scene["why"] for scene in map(json.loads, out.splitlines())}


def test_a_plan_says_what_would_be_baked_and_why_and_writes_nothing(capsys, scenes):
    shutil.copy("scenes/a.xml", "scenes/g.xml")
    why = plan_of(capsys)
    assert why == {
        **dict.fromkeys(("a", "b.v2", "bad", "c", "d", "e", "f"), "new"),
        "g": "equal to a",
    }
    assert not Path("out").exists()
    run_command(capsys, "batch", "scenes/*.xml", "-o", "out", "--set", "grid.margin=0.1")
    (scenes / "b.v2.xml").write_text(draw_room(7))
    (scenes / "c.xml").unlink()
    (scenes / "c.xml").symlink_to("no.xml")
    Path("out/d/grid.json.gz").write_bytes(b"")
    record = json.loads(Path("out/e", RECORD_NAME).read_bytes())
    record |= {"version": "0.0.1", "key": ""}
    Path("out/e", RECORD_NAME).write_text(json.dumps(record))
    before = {path: path.stat().st_mtime_ns for path in Path("out").rglob("*")}
    why = plan_of(capsys)
    assert why.pop("c").startswith("broken: no scene file")
    assert why == {
        **dict.fromkeys(("a", "f", "g"), "done"),
        **{"b.v2": "files: b.v2.xml", "bad": "failed before", "d": "made files", "e": "version"},
    }
    assert plan_of(capsys, "--set", "agent.radius=0.2")["a"] == "settings"
    assert plan_of(capsys, "--make", "nav2")["a"] == "products"
    assert set(plan_of(capsys, "--slice", "2/4")) == {"b.v2", "e"}
    command = ("batch", "scenes/*.xml", "-o", "out", "--plan", "--set", "grid.margin=0.1")
    status, out, err = run_command(capsys, *command)
    assert (status, err) == (0, "")
    assert re.search(r"^done: 3 scenes, 1\.1 kB$", out, re.MULTILINE)
    assert re.search(r"^files: 1 scene, .*: b\.v2 \(b\.v2\.xml\)$", out, re.MULTILINE)
    assert "4 of 8 scenes would be baked, by those done here in about" in out
    assert {path: path.stat().st_mtime_ns for path in Path("out").rglob("*")} == before


def test_scenes_of_other_programs_are_planned_baked_and_known_by_their_files(capsys, scenes):
    pytest.importorskip("pxr")
    head = '#usda 1.0\n(defaultPrim = "W"\nupAxis = "Z"\nmetersPerUnit = 1)\ndef Xform "W" '
    (scenes / "room.usda").write_text(head + "(references = @./floor.usda@)\n{\n}\n")
    (scenes / "floor.usda").write_text(head + '{\ndef Cube "floor"\n{\ndouble size = 4\n}\n}\n')
    world = '<world name="w"><include><uri>model://floor</uri></include></world>'
    (scenes / "world.sdf").write_text(f'<sdf version="1.9">{world}</sdf>')
    box = "<collision name='c'><geometry><box><size>4 4 1</size></box></geometry></collision>"
    model = f"<model name='floor'><static>1</static><link name='l'>{box}</link></model>"
    (scenes / "floor").mkdir()
    (scenes / "floor" / "model.sdf").write_text(f'<sdf version="1.9">{model}</sdf>')
    shutil.copy(ROOT / "tests" / "buildings" / "lab.building.yaml", scenes)
    names = {"room": "floor.usda", "world": "model.sdf", "lab.building": "lab.building.yaml"}
    sources = ("scenes/room.usda", "scenes/world.sdf", "scenes/*.building.yaml")
    words = ("batch", *sources, "-o", "out", "--set", "grid.cell_size=0.2")

    def plan():
        lines = run_command(capsys, *words, "--plan", "--json")[1].splitlines()
        return {scene["id"]: scene["why"] for scene in map(json.loads, lines)}

    assert plan() == dict.fromkeys(names, "new")
    assert run_command(capsys, *words)[0] == 0
    assert plan() == dict.fromkeys(names, "done")
    for name, file in names.items():
        (row,) = (row for row in read_index(Path("out")).values() if row["id"] == name)
        assert row["cells"] > 100 and file in {Path(path).name for path in row["inputs"]}
    for path in ("floor.usda", "floor/model.sdf", "lab.building.yaml"):
        with (scenes / path).open("a") as scene:
            scene.write("\n")
    assert plan() == {name: f"files: {file}" for name, file in names.items()}


def test_the_cost_of_scenes_by_hand():
    rows = [
        {"status": "ok", "seconds": float(n), "files": {"a": {"size": 10 * n}, "b": {"size": n}}}
        for n in range(1, 21)
    ]
    cost = measure_cost([*rows, {"status": "failed", "seconds": 1e9}])
    assert cost["scenes"] == 20
    assert cost["seconds"] == {"sum": 210, "median": 10, "p90": 18, "max": 20}
    assert cost["bytes"] == {"sum": 2310, "median": 110, "p90": 198, "max": 220}
    assert measure_cost([{"status": "left"}]) is None


def test_a_batch_ends_with_what_its_scenes_cost(capsys):
    _, out, _ = run_command(
        capsys, "batch", "scenes/a.xml", "-o", "out", "--set", "grid.margin=0.1"
    )
    assert re.search(r"^a scene: \S+ s \(90%: \S+, longest \S+\), .*; all: .*$", out, re.MULTILINE)


def test_shards_as_webdataset_reads_them(capsys):
    words = ("batch", "scenes/*.xml", "-o", "out", "--make", "inflated:0.3", "--shards", "4")
    assert run_command(capsys, *words)[0] == 1  # one is broken
    names = sorted(path.name for path in Path("out").glob("*.tar"))
    assert names == [f"shard-{number:06}.tar" for number in range(4)]
    samples_, members = {}, []
    for name in names:
        with tarfile.open(Path("out", name), "r|") as shard:
            for member in shard:
                key, ending = KEY.match(member.name).groups()
                samples_.setdefault(key, {})[ending] = shard.extractfile(member).read()
                members.append((key, name))
                assert (member.mtime, member.uid, member.mode) == (0, 0, 0o644)
    assert [*samples_] == ["a", "b%2Ev2", "c", "d", "e", "f"]
    assert members == sorted(members)  # a sample is in one shard, in one piece
    sample = samples_["b%2Ev2"]
    assert sorted(sample) == ["grid.json.gz", "inflated-0.3.json.gz", "json"]
    assert sample["grid.json.gz"] == Path("out/b.v2/grid.json.gz").read_bytes()
    row = json.loads(sample["json"])
    assert row["id"] == "b.v2" and not {*TIMES} & {*row}
    assert row == timeless([read_index(Path("out"))["b.v2"]])[0]
    Path("out/shard-000007.tar").write_bytes(b"a user's own")
    run_command(capsys, *words[:-1], "2")
    assert {path.name for path in Path("out").glob("*.tar")} == {*names[:2], "shard-000007.tar"}
    run_command(capsys, *words[:-2])  # not asked for any more
    assert [path.name for path in Path("out").glob("*.tar")] == ["shard-000007.tar"]
    assert not Path("out", RECORD_NAME).exists()


@pytest.mark.parametrize("text", ["0/4", "5/4", "1", "a/4", "1/0"])
def test_a_slice_is_one_of_its_number(capsys, text):
    status, _, err = run_command(capsys, "batch", "scenes/a.xml", "-o", "out", "--slice", text)
    assert status == 2 and "expected K/N with K from 1 to N, as 3/64" in err


@pytest.mark.parametrize("option", ["--page", "--parquet", "--shards=3", "--merge"])
def test_what_is_of_the_whole_batch_is_refused_of_a_slice(capsys, option):
    words = ("batch", "scenes/a.xml", "-o", "out", "--slice", "1/2", option)
    status, _, err = run_command(capsys, *words)
    assert status == 2 and option.partition("=")[0] in err and "does nothing here" in err


def test_lists_of_other_programs_are_read_by_their_columns():
    row = {"house": "h1", "files": {"mjcf": "scenes/a.xml"}, "split": "train", "r": 0.2}
    columns = {"scene": "files.mjcf", "id": "house", "agent.radius": "r"}
    text = (json.dumps(row) + "\n").encode()
    Path("houses.jsonl.gz").write_bytes(gzip.compress(text))
    (job,) = list_jobs(["houses.jsonl.gz"], columns)
    assert (job.id, job.source) == ("h1", "scenes/a.xml")
    assert job.settings == {"agent": {"radius": 0.2}, "scene": {"id": "h1"}}
    Path("houses.csv").write_text("house,path,split\nh2,scenes/b.v2.xml,val\n")
    (job,) = list_jobs(["houses.csv"], {"scene": "path", "id": "house"})
    assert (job.id, job.source, job.settings) == ("h2", "scenes/b.v2.xml", of("h2"))
    with pytest.raises(ConfigError, match=r"expected a column 'file' at houses.csv, line 2"):
        list_jobs(["houses.csv"], {"scene": "file", "id": "house"})
    with pytest.raises(ConfigError, match=r"--column scene=NAME names the column"):
        list_jobs(["houses.jsonl.gz"])
    with pytest.raises(ConfigError, match=r"at houses.csv, line 1$"):
        list_jobs(["houses.csv"], {"config": "yaml"})
    house = {"rooms": [], "walls": [], "doors": [], "objects": [{"assetId": "Bed_1"}]}
    Path("train.jsonl").write_text(json.dumps(house))
    with pytest.raises(ConfigError, match=r"train.jsonl, line 1; a house of ProcTHOR only names"):
        list_jobs(["train.jsonl"])
    Path("broken.jsonl.gz").write_bytes(gzip.compress(text)[:-9])
    with pytest.raises(NavbakeError, match=r"broken gzip data in broken.jsonl.gz"):
        list_jobs(["broken.jsonl.gz"])


def of(name):
    return {"scene": {"id": name}}


def test_a_worker_keeps_few_meshes():
    cache = mujoco.mj_getCache()
    before = mujoco.mj_getCacheCapacity(cache)
    try:
        prepare_worker((), thumbnail=False)
        assert mujoco.mj_getCacheCapacity(cache) == MESH_CACHE_SIZE
    finally:
        mujoco.mj_setCacheCapacity(cache, before)
