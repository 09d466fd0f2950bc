"""Parquet: lists of scenes, and the index as a table."""

from __future__ import annotations

import io
import json
import sys
from functools import partial

import pytest

from batch_in_process import stay_in_process
from batch_scenes import draw_room
from command_line import run_command
from navbake.batch.index import encode_rows
from navbake.batch.scene_row import SceneRow
from navbake.batch.scenes import list_jobs
from navbake.errors import ConfigError, MissingDependencyError, NavbakeError

pyarrow = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")


@pytest.fixture(autouse=True)
def here(monkeypatch, tmp_path):
    """Jobs are done in this process; the current folder has scenes."""
    stay_in_process(monkeypatch)
    monkeypatch.chdir(tmp_path)
    for number, name in enumerate(("a", "b", "c")):
        (tmp_path / f"{name}.xml").write_text(draw_room(number))


@pytest.fixture
def run(capsys):
    """Returns a function that runs a command: its status, stdout and stderr."""
    return partial(run_command, capsys)


def write(rows, name="list.parquet", schema=None):
    parquet.write_table(pyarrow.Table.from_pylist(rows, schema=schema), name)


def test_a_table_is_a_list_as_a_csv_is():
    rows = [
        {"scene": "a.xml", "id": "001", "agent.radius": 0.2, "settings": {"grid": {"margin": 1.0}}},
        {"scene": "b.xml", "id": None, "agent.radius": float("nan"), "settings": {"grid": None}},
        {"scene": "c.xml", "id": "1e3", "__index_level_0__": 7, "agent.radius": None},
    ]
    write(rows)
    jobs = list_jobs(["list.parquet"])
    assert [(job.id, job.source) for job in jobs] == [
        *(("001", "a.xml"), ("b", "b.xml"), ("1e3", "c.xml"))
    ]
    assert [job.settings for job in jobs] == [
        {"agent": {"radius": 0.2}, "grid": {"margin": 1.0}, "scene": {"id": "001"}},
        *({}, {"scene": {"id": "1e3"}}),
    ]
    assert jobs[2].place == "list.parquet, row 3"
    (row,) = [json.loads('{"scene": "a.xml", "id": 7, "scene.exclude": {"bodies": ["x"]}}')]
    write([row])
    assert list_jobs(["list.parquet"])[0].settings == {
        "scene": {"exclude": {"bodies": ["x"]}, "id": "7"}
    }
    assert list_jobs(["list.parquet"])[0].id == "7"


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (
            {"scene": "a.xml", "id": 1.5},
            "expected text or a whole number as `id` at l.parquet, row",
        ),
        ({"scene": 3}, "expected a path as `scene` or as `config` at l.parquet, row 1"),
        ({"scene": "a.xml", "split": "train"}, "got `split` at l.parquet, row 1"),
    ],
)
def test_wrong_rows_are_named(row, message):
    write([row], "l.parquet")
    with pytest.raises(ConfigError, match=message):
        list_jobs(["l.parquet"])


def test_broken_tables_are_refused(tmp_path):
    arrays = [pyarrow.array(["a.xml"]), pyarrow.array([0.2]), pyarrow.array([0.4])]
    names = ["scene", "agent.radius", "agent.radius"]
    parquet.write_table(pyarrow.Table.from_arrays(arrays, names), "list.parquet")
    with pytest.raises(ConfigError, match=r"Parquet in list\.parquet: .*agent\.radius"):
        list_jobs(["list.parquet"])
    write([{"scene": "a.xml"}])
    content = (tmp_path / "list.parquet").read_bytes()
    for broken in (b"", b"PAR1", content[:-5], content[:20] + bytes(20) + content[40:]):
        (tmp_path / "list.parquet").write_bytes(broken)
        with pytest.raises(ConfigError, match=r"list\.parquet"):
            list_jobs(["list.parquet"])


def test_the_index_as_a_table_says_what_the_lines_say(tmp_path, run):
    (tmp_path / "bad.xml").write_text("<mujoco>")
    coarse = ("--set", "grid.cell_size=0.25")
    assert run("batch", "*.xml", "-o", "out", "--parquet", *coarse)[0] == 1
    lines = [json.loads(line) for line in (tmp_path / "out/index.jsonl").read_text().splitlines()]
    found = parquet.read_table("out/index.parquet")
    rows = found.to_pylist()
    assert [row["id"] for row in rows] == ["a", "b", "bad", "c"]
    for line, row in zip(lines, rows, strict=True):
        assert row["stages"] == ([*line["stages"].items()] if "stages" in line else None)
        for key in ("inputs", "files"):
            assert row[key] == (
                [
                    {"path": path, "size": state["size"], "sha256": state["sha256"]}
                    for path, state in line[key].items()
                ]
                if key in line
                else None
            )
        plain = row.keys() - {"stages", "inputs", "files"}
        assert {key: row[key] for key in plain} == {key: line.get(key) for key in plain}
        assert line.keys() <= row.keys()
    content = (tmp_path / "out/index.parquet").read_bytes()
    assert encode_rows(lines) == content == encode_rows(lines)
    assert run("batch", "a.xml", "-o", "out", "--parquet", *coarse)[0] == 0  # nothing to do
    assert parquet.read_table("out/index.parquet")["id"].to_pylist() == ["a", "b", "bad", "c"]
    assert run("batch", "a.xml", "-o", "out", *coarse)[0] == 0
    assert not (tmp_path / "out/index.parquet").exists()  # it would say less than the lines


def test_all_tables_have_the_same_columns():
    one = parquet.read_schema(io.BytesIO(encode_rows([])))
    # pyarrow would leave out a key that has no column
    assert set(one.names) == SceneRow.__annotations__.keys()
    other = parquet.read_schema(io.BytesIO(encode_rows([{"id": "a", "status": "left"}])))
    assert one == other
    for odd in ({"levels": "many"}, {"levels": 10**20}, {"stages": [None]}, {"stages": "none"}):
        with pytest.raises(NavbakeError, match=r"a row of the index doesn't fit into index\.par"):
            encode_rows([{"id": "a", **odd}])


def test_without_pyarrow_nothing_is_baked(tmp_path, monkeypatch, run):
    write([{"scene": "a.xml"}])
    for name in ("pyarrow", "pyarrow.parquet"):
        monkeypatch.setitem(sys.modules, name, None)
    message = r'Parquet needs pyarrow: pip install "navbake\[batch\]"'
    with pytest.raises(MissingDependencyError, match=message):
        list_jobs(["list.parquet"])
    status, _, err = run("batch", "a.xml", "-o", "out", "--parquet")
    assert status == 1 and "Parquet needs pyarrow" in err and err.count("\n") == 1
    assert not (tmp_path / "out").exists()
