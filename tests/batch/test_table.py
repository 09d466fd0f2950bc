"""Parquet: lists of scenes, and the index as a table."""

from __future__ import annotations

import io
import json
from functools import partial

import pytest

from batch_in_process import stay_in_process
from batch_scenes import draw_room
from command_line import run_command
from navbake.batch import table
from navbake.batch.manifest import list_jobs
from navbake.batch.parquet_sizes import Page, list_pages, read_chunks
from navbake.batch.table import encode_rows, read_table
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


def test_a_column_that_stands_twice_is_refused():
    arrays = [pyarrow.array(["a.xml"]), pyarrow.array([0.2]), pyarrow.array([0.4])]
    names = ["scene", "agent.radius", "agent.radius"]
    parquet.write_table(pyarrow.Table.from_arrays(arrays, names), "l.parquet")
    with pytest.raises(ConfigError, match=r"once, got `agent\.radius` 2 times in l\.parquet"):
        list_jobs(["l.parquet"])


def test_broken_and_huge_files_are_refused(tmp_path, monkeypatch):
    write([{"scene": "a.xml"}])
    content = (tmp_path / "list.parquet").read_bytes()
    for broken in (b"", b"PAR1", content[:-5], content[:20] + bytes(20) + content[40:]):
        (tmp_path / "list.parquet").write_bytes(broken)
        with pytest.raises(ConfigError, match=r"list\.parquet"):
            list_jobs(["list.parquet"])
    monkeypatch.setattr(table, "FREE_UNPACKED", 10)
    monkeypatch.setattr(table, "UNPACKED_PER_BYTE", 0)
    (tmp_path / "list.parquet").write_bytes(content)
    with pytest.raises(
        ConfigError, match=r"list\.parquet is too large: expected at most 10 bytes unpacked"
    ):
        list_jobs(["list.parquet"])


@pytest.mark.parametrize(
    ("limit", "value", "message"),
    [
        ("FREE_VALUES", -(10**6), "values"),
        ("FREE_ROWS", -(10**6), "rows"),
        ("FREE_TEXT", 0, "bytes of text .* got 10 or"),
        ("FREE_PAGES", 1, "1 pages"),
        ("MAX_COLUMNS", 1, "1 columns"),
    ],
)
def test_what_a_list_stands_for_is_limited(monkeypatch, limit, value, message):
    write([{"scene": "a.xml", "id": "a.png"}, {"scene": None, "id": "b"}])
    monkeypatch.setattr(table, limit, value)
    monkeypatch.setattr(table, "BYTES_PER_PAGE", 10**6)
    monkeypatch.setattr(table, "TEXT_PER_BYTE", 0)
    monkeypatch.setattr(table, "TEXT_PER_ROW", 0)
    with pytest.raises(ConfigError, match=rf"list\.parquet is too large: .* {message}"):
        list_jobs(["list.parquet"])


def test_bytes_of_fixed_length_are_limited(monkeypatch):
    fixed = pyarrow.schema([("scene", pyarrow.string()), ("id", pyarrow.binary(100))])
    write([{"scene": "a.xml", "id": bytes(100)}] * 10, schema=fixed)
    monkeypatch.setattr(table, "FREE_TEXT", 0)
    monkeypatch.setattr(table, "TEXT_PER_BYTE", 1)
    message = r"list\.parquet is too large: .* bytes of fixed length for its size, got 1,000 or"
    with pytest.raises(ConfigError, match=message):
        list_jobs(["list.parquet"])


def test_rows_may_share_a_long_path():
    shared = f"/data/{'experiment/' * 18}home.yaml"
    rows = [{"config": shared, "id": k, "agent.radius": k % 100 / 100} for k in range(150_000)]
    file = io.BytesIO()
    parquet.write_table(pyarrow.Table.from_pylist(rows), file)
    assert sum(row["config"] == shared for _, row in read_table(file.getvalue(), "")) == len(rows)


def columns(kind, list_kind):
    """The columns of a list of scenes, by the type of its texts."""
    lists = pyarrow.struct([("bodies", list_kind(kind)), ("geoms", list_kind(kind))])
    settings = pyarrow.struct([("scene", pyarrow.struct([("exclude", lists)]))])
    return pyarrow.schema([("scene", kind), ("id", kind), ("settings", settings)])


SCHEMAS = [
    columns(pyarrow.string(), pyarrow.list_),
    columns(pyarrow.large_string(), pyarrow.large_list),  # of pandas and polars
    columns(pyarrow.string_view(), pyarrow.list_view),
    columns(pyarrow.dictionary("int32", pyarrow.large_string()), pyarrow.list_),
]
LAYOUTS = [
    {},
    {"row_group_size": 300},
    {"use_dictionary": False, "data_page_version": "2.0"},
    {"dictionary_pagesize_limit": 500, "data_page_size": 1000, "compression": "zstd"},
    {"use_dictionary": False, "column_encoding": {"scene": "DELTA_BYTE_ARRAY", "id": "PLAIN"}},
    {"use_dictionary": False, "row_group_size": 300, "column_encoding": {
        "scene": "DELTA_LENGTH_BYTE_ARRAY", "id": "DELTA_BYTE_ARRAY",
        "settings.scene.exclude.bodies.list.element": "DELTA_LENGTH_BYTE_ARRAY"}},
]  # fmt: skip


@pytest.mark.parametrize("schema", SCHEMAS)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_pages_are_found_and_all_rows_read_however_a_list_is_laid_out(layout, schema):
    rows = [
        {"scene": f"house_{k}.xml", "id": f"{k:04}", "settings": {"scene": {"exclude": {
            "bodies": [f"body_{k}", "lamp"], "geoms": []}}}} for k in range(1500)
    ]  # fmt: skip
    file = io.BytesIO()
    parquet.write_table(pyarrow.Table.from_pylist(rows, schema), file, **layout)
    content = file.getvalue()
    assert [row["id"] for _, row in read_table(content, "list")] == [row["id"] for row in rows]
    assert [
        row["settings"]["scene"]["exclude"]["bodies"] for _, row in read_table(content, "")
    ] == [row["settings"]["scene"]["exclude"]["bodies"] for row in rows]
    # the oracle: what the footer of a good file says
    metadata = parquet.ParquetFile(io.BytesIO(content)).metadata
    chunks = read_chunks(content)
    assert len(chunks) == metadata.num_row_groups
    for group, found in enumerate(chunks):
        for number, chunk in enumerate(found):
            pages, told = [*list_pages(content, chunk)], metadata.row_group(group).column(number)
            assert sum(page.values for page in pages) == told.num_values
            size = sum(page.unpacked for page in pages)
            assert size < told.total_uncompressed_size < size + 200 * len(pages)
            encodings = {one for page in pages for one in page.encodings}
            for name, encoding in (("DELTA_LENGTH_BYTE_ARRAY", 6), ("DELTA_BYTE_ARRAY", 7)):
                assert (encoding in encodings) == (name in told.encodings)


def claims(encodings, nested=False):
    """How a list is read whose column of texts has pages in these encodings, of 1 MB."""
    rows = [{"scene": ["a.xml"] if nested else "a.xml"}]
    file = io.BytesIO()
    parquet.write_table(pyarrow.Table.from_pylist(rows), file)
    with pytest.MonkeyPatch.context() as patch:
        pages = [Page(1 << 20, 0, ()), *(Page(100, 1, (one,)) for one in encodings)]
        patch.setattr(table, "list_pages", lambda content, chunk: pages)
        metadata = parquet.ParquetFile(file).metadata
        ((texts, rows_at_once),) = table.check_claims(metadata, file.getvalue(), "list")[1]
    return len(texts), rows_at_once


def test_how_texts_are_read_follows_from_their_encodings():
    plain, dictionary, delta_length, delta = 0, 8, 6, 7
    assert claims([dictionary, plain]) == (1, 1024)  # what rows share stays shared
    assert claims([delta_length, plain]) == (0, 1024)  # nothing is shared
    assert claims([dictionary, delta_length]) == (0, 4)  # is shared, but pyarrow makes copies
    assert claims([delta]) == claims([delta, dictionary]) == (0, 4)
    assert claims([delta_length], nested=True) == (0, 1024)
    for copied in ([delta], [dictionary, delta_length]):
        with pytest.raises(ConfigError, match="list has lists of texts in an encoding"):
            claims(copied, nested=True)


def test_texts_that_rows_share_count_for_each(monkeypatch):
    long = "a" * 1000
    write([{"scene": f"a{k}.xml", "agent.radius": None, "id": f"{long}"} for k in range(100)])
    monkeypatch.setattr(table, "FREE_TEXT", 0)
    monkeypatch.setattr(table, "TEXT_PER_ROW", 800)
    with pytest.raises(ConfigError, match=r"list\.parquet is too large: .* bytes of text"):
        list_jobs(["list.parquet"])


def test_texts_of_all_types_that_parquet_has_are_counted_and_others_are_refused():
    shared = pyarrow.DictionaryArray.from_arrays(pyarrow.array([0, 1, None, 0]), ["four", "12"])
    lists = pyarrow.ListArray.from_arrays(pyarrow.array([0, 3, 4]), shared)
    maps = pyarrow.MapArray.from_arrays(pyarrow.array([0, 4]), shared.fill_null("12"), shared)
    nested = pyarrow.StructArray.from_arrays([lists, pyarrow.array([1.5, None])], ["a", "b"])
    assert [table.count_text_bytes(array) for array in (shared, lists, maps, nested)] == [
        *(10, 10, 22, 10)
    ]
    assert table.count_text_bytes(lists[1:]) == 4
    assert table.count_text_bytes(pyarrow.array(["four", "12"])) >= 6
    for free in (pyarrow.nulls(3), pyarrow.array([True]), pyarrow.array([b"a"], pyarrow.binary(1))):
        assert table.count_text_bytes(free) == 0
    for kind in (pyarrow.large_string(), pyarrow.string_view(), pyarrow.large_binary()):
        with pytest.raises(TypeError, match="values of the type"):
            table.count_text_bytes(pyarrow.array(["a"], kind))


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
        assert line.keys() - row.keys() <= {"named", "sought"}
    content = (tmp_path / "out/index.parquet").read_bytes()
    assert encode_rows(lines) == content == encode_rows(lines)
    assert run("batch", "a.xml", "-o", "out", "--parquet", *coarse)[0] == 0  # nothing to do
    assert parquet.read_table("out/index.parquet")["id"].to_pylist() == ["a", "b", "bad", "c"]
    assert run("batch", "a.xml", "-o", "out", *coarse)[0] == 0
    assert not (tmp_path / "out/index.parquet").exists()  # it would say less than the lines


def test_all_tables_have_the_same_columns():
    one = parquet.read_schema(io.BytesIO(encode_rows([])))
    other = parquet.read_schema(io.BytesIO(encode_rows([{"id": "a", "status": "left"}])))
    assert one == other
    for odd in ({"levels": "many"}, {"levels": 10**20}, {"stages": [None]}, {"stages": "none"}):
        with pytest.raises(NavbakeError, match=r"a row of the index doesn't fit into index\.par"):
            encode_rows([{"id": "a", **odd}])


def test_without_pyarrow_nothing_is_baked(tmp_path, monkeypatch, run):
    write([{"scene": "a.xml"}])
    monkeypatch.setattr(table, "find_spec", lambda name: None)
    message = r'Parquet needs pyarrow: pip install "navbake\[batch\]"'
    with pytest.raises(MissingDependencyError, match=message):
        list_jobs(["list.parquet"])
    status, _, err = run("batch", "a.xml", "-o", "out", "--parquet")
    assert status == 1 and "Parquet needs pyarrow" in err and err.count("\n") == 1
    assert not (tmp_path / "out").exists()
