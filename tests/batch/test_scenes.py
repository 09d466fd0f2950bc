"""Lists of scenes: patterns, files of rows, ids, settings."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from navbake.batch.scenes import (
    Job,
    list_jobs,
    make_id_settings,
    merge_settings,
    nest_settings,
    read_shared_settings,
)
from navbake.config.keywords import overlay_settings
from navbake.errors import ConfigError


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with scenes in `a` and `b`."""
    for name in ("a/kitchen.xml", "a/hall.xml", "b/kitchen.xml", "b/cellar[1].xml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("<mujoco/>")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def ids(*sources):
    return [job.id for job in list_jobs(sources)]


def test_patterns_come_sorted_and_names_are_as_long_as_needed(folder):
    assert ids("a/*.xml") == ["hall", "kitchen"]
    assert ids("*/*.xml") == ["hall", "a/kitchen", "cellar[1]", "b/kitchen"]
    assert ids("**/kitchen.xml", "a/../b/cellar[1].xml")[0] == "a/kitchen"
    (folder / "a" / "b").mkdir()
    (folder / "a" / "b" / "kitchen.xml").write_text("<mujoco/>")
    assert ids("a/b/kitchen.xml", "b/kitchen.xml") == ["a/b/kitchen", f"{folder.name}/b/kitchen"]


def test_a_pattern_leaves_out_what_is_no_file(folder):
    (folder / "a" / "meshes").mkdir()
    (folder / "a" / "gone.xml").symlink_to("no.xml")
    if hasattr(os, "mkfifo"):
        os.mkfifo(folder / "a" / "pipe.xml")
    assert ids("a/*") == ["gone", "hall", "kitchen"]  # a scene that is gone fails by itself
    with pytest.raises(ConfigError, match=r"files that match a/m\*, got none"):
        list_jobs(["a/m*"])


def test_names_that_some_file_system_takes_for_one_get_the_folders_above(folder):
    (folder / "list.txt").write_text("u/a/\u00e9.xml\nu/b/e\u0301.xml\nu/b/E.xml\n")
    assert ids("list.txt") == ["a/\u00e9", "b/e\u0301", "E"]


def test_lists_name_scenes_beside_themselves(folder):
    (folder / "a" / "list.txt").write_text("# mine\nhall.xml\n\n../b/kitchen.xml\n")
    assert [job.source for job in list_jobs(["a/list.txt"])] == ["a/hall.xml", "a/../b/kitchen.xml"]
    (folder / "list.csv").write_text(
        "id,scene,agent.radius,scene.geoms,rooms.polygons\n"
        '001,a/hall.xml,0.2,all,\n1e3,a/kitchen.xml,,,plan.geojson\n"K, 2",b/kitchen.xml,1,,\n'
    )
    jobs = list_jobs(["list.csv"])
    assert [job.id for job in jobs] == ["001", "1e3", "K, 2"]
    assert [job.settings for job in jobs] == [
        {"agent": {"radius": 0.2}, "scene": {"geoms": "all", "id": "001"}},
        {"rooms": {"polygons": str(folder / "plan.geojson")}, "scene": {"id": "1e3"}},
        {"agent": {"radius": 1}, "scene": {"id": "K, 2"}},
    ]
    (folder / "list.jsonl").write_text(
        '{"scene": "a/hall.xml", "id": "big\u2028"}\n'.replace("\u2028", "")
        + '\n{"config": "b/kitchen.yaml", "settings": {"agent": {"radius": 0.3}}, "id": 7,'
        ' "agent.height": 2, "grid": null}\r\n'
    )
    jobs = list_jobs(["list.jsonl"])
    assert [job.id for job in jobs] == ["big", "7"]
    assert jobs[1].settings == {"agent": {"radius": 0.3, "height": 2}, "scene": {"id": "7"}}
    assert jobs[1].place == "list.jsonl, line 3"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        *((f"a.{kind}", "", f"one scene in a.{kind}") for kind in ("txt", "csv", "jsonl")),
        *(("a.csv", text, "one scene in a.csv") for text in ("\r\n\r\n", "scene,id\r\n")),
        ("a.txt", "# none\n\n", "one scene in a.txt"),
        ("a.csv", "scene,id\na.xml\n,b\n", "expected a path as `scene` or as `config` at a.csv, l"),
        ("a.csv", "scene\na.xml,b\n", "as many values as columns at a.csv, line 2"),
        ("a.csv", "a.xml,a\n", "names of columns, .* got .a.xml,a. at a.csv, line 1"),
        ("a.csv", "# mine\nscene\na.xml\n", "names of columns, .* got .# mine. at a.csv, line 1"),
        ("a.csv", "scene;id\na.xml;a\n", "names of columns, .* got .scene;id. at a.csv, line 1"),
        ("a.csv", 'scene,id\na.xml,a\n"b\n.xml,b\n', "broken CSV at a.csv, line 3"),
        ("a.csv", 'scene,id\n"a\n.xml",b,\n', "columns at a.csv, line 2: 2, got 3"),
        ("a.csv", "scene,config\na.xml,b.yaml\n", "expected a path as `scene` or as `config`"),
        ("a.csv", "scene,split\na.xml,train\n", "got `split` at a.csv, line 2"),
        ("a.csv", "scene,scene.path\na.xml,b.xml\n", "expected no `scene.path` in a.csv, line 2"),
        ("a.jsonl", '{"scene": "a.xml"}\n{"scene"\n', "broken JSON at a.jsonl, line 2"),
        ("a.jsonl", '# b\n{"scene": "a.xml"}\n', "broken JSON at a.jsonl, line 1: .* column 1"),
        ("a.csv", "\xef\xbb\xbfscene\n\xff\n", "expected UTF-8 in a.csv, line 2"),
        ("a.txt", "a.xml\rb.xml\r\xff\r", "expected UTF-8 in a.txt, line 3"),
        ("a.jsonl", '{"scene": "a.xml"},\n', "broken JSON at a.jsonl, line 1: .*column 19"),
        ("a.jsonl", "[1]\n", "expected an object at a.jsonl, line 1"),
        ("a.jsonl", '{"scene": 3}\n', "expected a path"),
        ("a.jsonl", '{"scene": "a.xml", "settings": 3}', "expected an object as `settings`"),
        ("a.csv", "scene\n\xff\n", "expected UTF-8 in a.csv, line 2"),
        (
            "a.csv",
            "scene,rooms,rooms.min_area\na.xml,none,2\n",
            "`rooms` is .none., .* a.csv",
        ),
        *(
            ("a.csv", f"scene,{key}\na.xml,2\n", f"a setting such as .* got `{key}` at a.csv, li")
            for key in ("agent..radius", "agent.radius=3")
        ),
    ],
)
def test_broken_lists_name_the_line(folder, name, text, message):
    (folder / name).write_bytes(text.encode("latin-1"))
    with pytest.raises(ConfigError, match=message):
        list_jobs([name])


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_lists_of_any_system_are_read(folder, end, mark):
    lists = {
        "a.txt": ["# mine", "  # too", "a.xml", "", " b.xml "],
        "a.csv": ["scene, id,", "a.xml, a,", "", '"b.xml",b,'],
        "a.jsonl": ['{"scene": "a.xml", "agent.radius": NaN}', " ", '{"scene": "b.xml", "id": ""}'],
    }
    for name, lines in lists.items():
        (folder / name).write_bytes((mark + end.join([*lines, ""])).encode())
        jobs = list_jobs([name])
        assert [(job.id, job.source) for job in jobs] == [("a", "a.xml"), ("b", "b.xml")]
        assert all(not job.settings or job.settings == make_id_settings(job.id) for job in jobs)
        assert jobs[1].place == f"{name}, line {len(lines)}"


@pytest.mark.parametrize("none", ["null", '""', "NaN", "{}", '{"a": null}'])
def test_what_is_not_given_is_left_out_of_settings_too(folder, none):
    agent = f'"agent": {{"radius": {none}, "height": 2}}'
    row = f'"settings": {{{agent}, "grid": {{"margin": {none}}}}}'
    (folder / "a.jsonl").write_text(f'{{"scene": "a.xml", {row}}}')
    assert [job.settings for job in list_jobs(["a.jsonl"])] == [{"agent": {"height": 2}}]
    cell = row.partition(": ")[2].replace('"', '""')
    (folder / "a.csv").write_text(f'scene,settings\na.xml,"{cell}"\n')
    assert [job.settings for job in list_jobs(["a.csv"])] == [{"agent": {"height": 2}}]


def test_a_table_without_rows_is_named(folder):
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    empty = pyarrow.table({"scene": pyarrow.array([], pyarrow.string())})
    parquet.write_table(empty, folder / "a.parquet")
    with pytest.raises(ConfigError, match=r"one scene in a\.parquet, got none"):
        list_jobs(["a.parquet", "a/hall.xml"])


def test_sources_that_name_nothing_are_refused(folder):
    with pytest.raises(ConfigError, match=r"files that match c/\*.xml, got none"):
        list_jobs(["c/*.xml"])
    with pytest.raises(ConfigError, match="got the folder a: name its files"):
        list_jobs(["a"])
    with pytest.raises(ConfigError, match=r"no\.jsonl"):
        list_jobs(["no.jsonl"])


@pytest.mark.parametrize(
    "name",
    [
        *("..", "../a", "/a", "a//b", "a/", ".a", "a.", " a", "a ", "a\\b", "C:a", "a\nb", "*"),
        *("NUL", "nul.txt", "index.jsonl", "a" * 201, "ä" * 101, "a\u202eb"),
        *("a/grid.json.gz", "a/Nav2-0.3_1.PGM/b", "a/thumbnail.png", "report.html"),
    ],
)
def test_ids_cannot_leave_the_folder(folder, name):
    (folder / "list.jsonl").write_text(json.dumps({"scene": "a/hall.xml", "id": name}))
    with pytest.raises(ConfigError, match=r"expected an id .* at list.jsonl, line 1"):
        list_jobs(["list.jsonl"])


@pytest.mark.parametrize("id", ["a/" * 5000 + "..", ["a" * 5000], {"a" * 5000: 1}])
def test_messages_of_ids_are_short(folder, id):
    (folder / "list.jsonl").write_text(json.dumps({"scene": "a/hall.xml", "id": id}))
    with pytest.raises(ConfigError, match=r"^.{,400}$"):
        list_jobs(["list.jsonl"])


@pytest.mark.parametrize(
    ("one", "other"),
    [("a", "A"), ("Stra\u00dfe", "STRASSE"), ("é", "e\u0301"), ("\u0390", "\u03aa\u0301")],
)
def test_ids_that_some_file_system_takes_for_one_are_refused(folder, one, other):
    rows = [{"scene": "a/hall.xml", "id": name} for name in ("Küche", "台所", "k/b, (2)", one)]
    text = "".join(json.dumps(row) + "\n" for row in rows)
    (folder / "list.jsonl").write_text(text)
    assert ids("list.jsonl") == ["Küche", "台所", "k/b, (2)", one]
    (folder / "list.jsonl").write_text(text + json.dumps({**rows[0], "id": other}))
    with pytest.raises(ConfigError, match=r"expected unique ids, got .* line 4 and .* line 5"):
        list_jobs(["list.jsonl"])


def test_one_file_twice_is_refused(folder):
    with pytest.raises(ConfigError, match=r"each scene once, got a/hall\.xml at .* and at"):
        list_jobs(["a/hall.xml", "a/h*.xml"])


def test_a_scene_has_the_settings_of_the_batch_its_own_and_those_of_its_row(folder):
    (folder / "all.yaml").write_text(
        "agent: {height: 2.0, radius: 0.1}\ngrid: {cell_size: 0.3}\nnames: false\n"
    )
    (folder / "a" / "own.yaml").write_text(
        "scene: {path: hall.xml}\nagent: {radius: 0.2}\ngrid:\noutput: a.grid.json\n"
    )
    row = nest_settings([("agent.traversable_floor_height", 0.1)], Path(), "here")
    job = Job("own", "a/own.yaml", row, "here")
    config = merge_settings(job, read_shared_settings("all.yaml"), ["agent.max_slope=30"])
    assert str(config.scene.path) == "a/hall.xml" and config.scene.id == "own"
    assert config.agent.model_dump() == {
        **{"height": 2.0, "radius": 0.2, "traversable_floor_height": 0.1, "max_slope": 30.0}
    }
    assert config.grid.cell_size == 0.3 and not config.names.enabled
    (folder / "a" / "own.yaml").write_text("- 1\n")
    with pytest.raises(ConfigError, match=r"expected a mapping of settings in a/own.yaml"):
        merge_settings(job, {}, [])
    (folder / "all.yaml").write_text("scene: {id: a}\n")
    with pytest.raises(ConfigError, match=r"expected no `scene.id` in all.yaml"):
        read_shared_settings("all.yaml")


def test_settings_are_laid_over_each_other_section_by_section():
    below = {"a": {"b": 1, "c": 2}, "d": 3, "e": None}
    above = {"a": {"b": 5}, "d": 4, "e": {"f": 1}}
    assert overlay_settings(below, above, "here") == {"a": {"b": 5, "c": 2}, "d": 4, "e": {"f": 1}}
    assert overlay_settings(below, {"a": None, "d": None}, "here") == {**below, "d": None}
    assert overlay_settings(below, {"a": {}, "d": {}, "g": {}}, "here") == {**below, "g": {}}
    given = {"scene.joints.door.hinge": 1, "a": {"b": 2}, "a.c": 3, "d": None, "d.e": 1}
    assert nest_settings(given.items(), Path(), "here") == {
        "scene": {"joints": {"door.hinge": 1}},
        "a": {"b": 2, "c": 3},
        "d": {"e": 1},
    }


@pytest.mark.parametrize(
    ("shared", "own", "row", "message"),
    [
        ({"rooms": "none"}, "", {"rooms": {"min_area": 2}}, "`rooms` is .none., .* `rooms.min_a"),
        ({"rooms": "none"}, "rooms: {min_area: 2}", {}, "`rooms` is .none., .* `rooms.min_area`"),
        ({}, "names: false", {"names": {"walls": "w"}}, "`names` is false, .* `names.walls`"),
        ({}, "scene: {meshes: hull}", {"scene": {"meshes": {"a": "shell"}}}, "`scene.meshes` is"),
    ],
)
def test_keys_do_not_undo_a_short_form(folder, shared, own, row, message):
    (folder / "own.yaml").write_text(f"{own}\n")
    with pytest.raises(ConfigError, match=f"{message}.* in the settings of here: write"):
        merge_settings(Job("own", "own.yaml", row, "here"), shared, [])


def test_a_short_form_stays_until_another_value_replaces_it(folder):
    for own, sources in (("agent: {radius: 1}", []), ("rooms: {}", []), ("rooms: auto", ["auto"])):
        (folder / "own.yaml").write_text(f"scene: {{path: a/hall.xml}}\n{own}\n")
        config = merge_settings(Job("own", "own.yaml", {}, "here"), {"rooms": "none"}, [])
        assert config.rooms.sources == sources


@pytest.mark.parametrize("scene", ["other.xml", "[1]", "[]", "false", "''"])
def test_shared_settings_name_no_scene_in_any_form(folder, scene):
    (folder / "all.yaml").write_text(f"scene: {scene}\n")
    with pytest.raises(ConfigError, match=r"expected settings as `scene` in all\.yaml, got .*nam"):
        read_shared_settings("all.yaml")
    (folder / "all.yaml").write_text("scene:\n")
    assert read_shared_settings("all.yaml") == {"scene": None}


def test_an_id_of_a_row_is_that_of_the_grid(folder):
    (folder / "own.yaml").write_text("scene: {path: a/hall.xml, id: mine}\n")
    (folder / "list.csv").write_text(
        "config,scene,id\nown.yaml,,k/7\nown.yaml,,\n,a/hall.xml,b/8\n,b/kitchen.xml,\n"
    )
    jobs = list_jobs(["list.csv"])
    assert [job.id for job in jobs] == ["k/7", "own", "b/8", "kitchen"]
    found = [merge_settings(job, {"scene": {"geoms": "all"}}, []).scene for job in jobs]
    assert [scene.id for scene in found] == ["k_7", "mine", "b_8", "kitchen"]
    assert {scene.geoms for scene in found} == {"all"}


@pytest.mark.parametrize(
    ("name", "rows"),
    [
        ("typo.csv", "scene,agent.radus\na/one.xml,0.3\n"),
        ("typo.jsonl", '{"scene": "a/one.xml", "settings": {"agent": {"radus": 0.3}}}\n'),
    ],
)
def test_a_misspelt_setting_is_refused_before_any_scene_is_baked(folder, name, rows):
    Path(name).write_text(rows)
    expected = (
        rf"unknown key `agent\.radus`, the nearest known one is `agent\.radius`, at {name}, line"
    )
    with pytest.raises(ConfigError, match=expected):
        list_jobs([name])


def test_a_path_that_is_not_there_is_refused_unless_a_list_names_it(tmp_path):
    scene, source = tmp_path / "no.xml", tmp_path / "list.txt"
    with pytest.raises(ConfigError, match=r"pattern, got .*no\.xml: there is no such file"):
        list_jobs([str(scene)])
    source.write_text("no.xml\n")
    assert [job.source for job in list_jobs([str(source)])] == [str(scene)]


@pytest.mark.parametrize("path", ["a\0/b.xml", "\ud800/b.xml"])
@pytest.mark.parametrize("suffix", [".txt", ".csv", ".jsonl"])
def test_texts_that_no_file_can_be_named_are_refused(folder, suffix, path):
    row = json.dumps({"scene": path})
    text = {".txt": path, ".csv": f"scene\n{path}", ".jsonl": row}[suffix]
    try:
        (folder / f"list{suffix}").write_text(text)
    except UnicodeEncodeError:  # only JSON can write half of a pair
        return
    # Python 3.10 reads no CSV with a NUL in it
    refusal = r"expected a path, got '.*b\.xml' at .*list\..*, line|line contains NUL"
    with pytest.raises(ConfigError, match=refusal):
        list_jobs([str(folder / f"list{suffix}")])


def test_settings_are_named_only_for_a_scene_that_they_name(folder):
    (folder / "room.yaml").write_text("scene: {path: a/hall.xml}")

    def settings_file(row_settings, overrides=()):
        job = Job("room", "room.yaml", row_settings, "room.yaml")
        return merge_settings(job, {}, overrides, Path).settings_file

    assert settings_file({"agent": {"radius": 0.2}}) == "room.yaml"
    assert settings_file({"scene": {"path": "nix.xml"}}) == ""
    assert settings_file({}, ["scene.path=nix.xml"]) == ""


def test_a_near_file_is_offered_before_a_sample(folder):
    with pytest.raises(ConfigError, match=r"no such file: the settings of the sample are .*house"):
        list_jobs(["house"])
    (folder / "house.xml").write_text("<mujoco/>")
    with pytest.raises(ConfigError, match=r"there is no such file: did you mean house\.xml\?$"):
        list_jobs(["house"])
