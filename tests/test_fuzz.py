"""A small sample of what `scripts/fuzz.py` does, and what it once found.

Run ``python scripts/fuzz.py --count 30000`` for more, or ``NAVBAKE_EXAMPLES=1000 pytest`` on this
file.
"""

import gzip
import io
import json
import os
import struct
import threading
import time
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import fuzz
from fuzzing import measure
from fuzzing.archives import claimed_array, pack, pickled_array, unpack
from fuzzing.images import grey_png, header, join_png, split_png
from fuzzing.kind import Input, Kind
from fuzzing.kinds import KINDS
from navbake.batch.table import read_table
from navbake.errors import ConfigError, FormatError, NavbakeError
from navbake.formats.binvox import encode_binvox
from navbake.formats.maps.grid_npz import encode_grid_npz, read_grid_npz
from navbake.formats.maps.images import encode_png
from navbake.formats.navgrid import read_navgrid
from navbake.formats.npz import encode_npz, read_npy, read_npz
from navbake.voxels.grid import VoxelGrid

EXAMPLES = int(os.environ.get("NAVBAKE_EXAMPLES", "30"))  # inputs of each kind
IN_PROCESS = [kind for kind in KINDS if KINDS[kind].native is None]  # MuJoCo may crash

VOXELS = VoxelGrid(
    values=np.ones((2, 2, 2), dtype=np.uint8), origin=(0.0, 0.0, 0.0), res=0.5, names={1: "a"}
)
GRID = read_navgrid(
    b'{"type":"SceneGrid2D","width":2,"height":1,"cellSize":1,"min":[0,0,0],"weights":[1,2]}'
)
MAP = (
    b"image: map.png\nresolution: %s\norigin: [0, 0, %s]\nnegate: 0\noccupied_thresh: %s\n"
    b"free_thresh: 0.2\nmode: %s\n"
)


def level(**more):
    """The JSON of a level of 1000 × 1000 cells, all alike."""
    runs = {"encoding": "rle", "data": [1, 10**6]}
    fields = {"type": "SceneGrid2D", "width": 1000, "height": 1000, "cellSize": 1, "min": [0, 0, 0]}
    return json.dumps({**fields, "weights": runs, **more}).encode()


def archive(**members):
    """The archive of a grid with other members."""
    packed = unpack(next(iter(encode_grid_npz(GRID, "a.npz").values())))
    return pack({**packed, **members})


def signalling():
    """An array of a NaN that makes the processor complain."""
    content = np.array([0x7FF0000000000001, 0], dtype="<u8").tobytes()
    return claimed_array("(1, 2)", "<f8", content)


def stl(corner):
    """A binary STL of one triangle, whose corners have this bit pattern thrice."""
    return bytes(80) + struct.pack("<I3f9IH", 1, 0, 0, 1, *[corner] * 9, 0)


# Inputs that were findings: (kind, input)
FOUND = [
    ("yaml", Input(b"scene: {path: a}\na: !!bool maybe", ".yaml")),
    ("yaml", Input(b"scene: {path: a}\na: !!timestamp x", ".yaml")),
    ("yaml", Input(b"scene: {path: a}\na: !!float ''", ".yaml")),
    ("yaml", Input(b"scene: {path: a}\na: !!set [1]", ".yaml")),
    ("yaml", Input(b"scene: {path: a}\na: " + b"[" * 1500, ".yaml")),  # took over a second
    ("yaml", Input(b'scene: {path: a}\nrooms: {polygons: "a\\nb"}', ".yaml")),  # two lines
    ("yaml", Input(b"scene: {path: a}\nscene: &a {path: *a}", ".yaml")),
    ("yaml", Input(b"scene: {path: a}\nrooms: {polygons: /dev/zero}", ".yaml")),  # 64 MiB
    ("yaml", Input(b"scene: {path: a}\na: !!" + b"x" * 5000, ".yaml")),  # a long line
    ("yaml", Input(b"scene: {path: a}\na: *" + b"x" * 5000, ".yaml")),
    ("yaml", Input(b"scene: {path: a}\nrooms: {polygons: %s}" % (b"x" * 5000), ".yaml")),
    ("geojson", Input(b'{"type": "Feature", "properties": [1]}', ".geojson")),
    ("geojson", Input(b'{"type": "\\n"}', ".geojson")),  # two lines
    ("names", Input(encode_binvox(VOXELS), ".binvox", {
        "input.binvox.names.json": b'{"ids": ' + b"[" * 100_000})),
    ("names", Input(encode_binvox(VOXELS), ".binvox", {
        "input.binvox.names.json": b'{"ids": {"1": "a\\u0000"}}'})),  # lost in an archive
    ("binvox", Input(b"#binvox 1\ndim 1 1 1\ntranslate 1e308 0 0\ndata\n\x01\x01", ".binvox")),
    ("binvox", Input(b"#binvox 1\ndim 1 1 1\nscale 1e308\ndata\n\x01\x01", ".binvox")),
    ("navgrid", Input(
        b'{"type":"SceneGrid2D","width":1,"height":1,"cellSize":1e308,"min":[0,0,0]}', ".json")),
    ("navgrid", Input(
        b'{"type":"SceneGrid2D","width":1,"height":1,"cellSize":1,"min":[0,0,0],'
        b'"tileAttributes":{"floorHeight":[1e300]}}', ".json")),  # a warning of numpy
    ("navgrid", Input(
        # an overflow when a path is planned, in one of eight files
        b'{"type":"SceneGrid2D","width":2,"height":1,"cellSize":1,"min":[0,0,0],"metadata":'
        b'{"agentRadius":1e308,"inflation":[{"radius":1e308,"mode":"exact"}],"n":%d}}' % 1,
        ".json")),
    ("navgrid", Input(
        b'{"type":"SceneGrid2D","width":1,"height":1,"cellSize":1,"min":[0,0,0],'
        b'"userData":{"0":{"doors":["d"],"objects":[1,{}],"walls":[[]]}},"metadata":{"navbake":'
        b'{"doors":[{"id":"d","state":"closed","cells":{"closed":[[0,[0,1]]]}}]}}}', ".json")),
    ("navgrid", Input(  # 32 arrays of a million values were made before one more was refused
        level(tileAttributes={f"a{k}": {"encoding": "rle", "data": [1, 10**6]} for k in range(40)}),
        ".json")),
    ("grid-npz", Input(archive(**{"0/weights.npy": signalling()}), ".npz")),  # a warning of numpy
    ("stl", Input(stl(0x7FA00000), ".stl")),  # a warning of numpy
    ("nav2", Input(MAP % (b"1" * 400, b"0", b"0.6", b"raw"), ".yaml", {"map.png": grey_png()})),
    ("nav2", Input(MAP % (b"0.1", b"3.14159", b"0.6", b"raw"), ".yaml", {  # 3 s
        "map.png": encode_png(np.zeros((700_000, 2), dtype=np.uint8))})),
    ("manifest", Input(b'{"scene": "/"}', ".jsonl")),
    *[("manifest", Input(json.dumps({"scene": "a", **row}).encode(), ".jsonl")) for row in (
        {"id": "/" * 9999}, {"id": ["a" * 9999]}, {"settings": "a" * 9999}, {"a" * 9999: 1},
        {"agent." + "a" * 9999: 1})],  # long lines
    ("index", Input(b'{"id": "a", "x": ' + b"[" * 100_000, ".jsonl")),
    ("index", Input(b'{"id": "a", "seconds": NaN}\n{"id": "b", "seconds": 1e999}', ".jsonl")),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "made"), FOUND)
def test_what_was_found(tmp_path, kind, made):
    what = fuzz.use_input(kind, made, tmp_path)
    if what.startswith("took"):  # kernels may have been compiled
        what = fuzz.use_input(kind, made, tmp_path)
    assert what in fuzz.FINE


def table_of(*ids):
    """A list as Parquet."""
    from pyarrow import parquet, table

    file = io.BytesIO()
    parquet.write_table(table({"scene": ["a.xml"] * len(ids), "id": [*ids]}), file)
    return file.getvalue()


def required_column():
    """A list whose footer says that no value of a column is null, but counts nulls.

    pyarrow ends the process when it is asked what the footer says of the column.
    """
    content = table_of("a")
    assert b"\x25\x02\x18\x02id" in content
    return content.replace(b"\x25\x02\x18\x02id", b"\x25\x00\x18\x02id")


@pytest.mark.parametrize("number", range(13))
def test_what_was_found_in_parquet(tmp_path, number):
    pytest.importorskip("pyarrow")
    from fuzzing import tables

    content = {tables.BOMBS: required_column, tables.BOMBS + 1: lambda: table_of("/" * 9999)}.get(
        number, lambda: tables.make_bomb(number)
    )()
    fuzz.use_input("parquet", Input(table_of("a"), ".parquet"), tmp_path)  # loads pyarrow
    if number < tables.BOMBS:  # not by what reads the rows
        with pytest.raises(ConfigError, match="list is too large"):
            list(read_table(content, "list"))
    assert fuzz.use_input("parquet", Input(content, ".parquet"), tmp_path) == "refused"


@pytest.mark.parametrize("kind", IN_PROCESS)
def test_a_sample_of_each_kind(tmp_path, kind):
    fuzz.use_input(kind, fuzz.make_input(kind, -1, 0), tmp_path)  # loads what is loaded lazily
    outcomes = []
    for number in range(EXAMPLES):
        what = fuzz.use_input(kind, fuzz.make_input(kind, 0, number), tmp_path)
        # machines are busy, and kernels may be compiled
        outcomes.append(fuzz.REFUSED if what.startswith("took") else what)
        assert outcomes[-1] in fuzz.FINE, f"{kind} {number}: {outcomes[-1]}"
    assert "refused" in outcomes or kind == "index"  # the changes are felt
    assert fuzz.make_input(kind, 0, 7) == fuzz.make_input(kind, 0, 7)


def test_good_inputs_are_read(tmp_path, monkeypatch):
    for module in ("grids", "voxel_files", "settings"):
        monkeypatch.setattr(f"fuzzing.{module}.mutate_tree", lambda tree, rng: tree)
        monkeypatch.setattr(f"fuzzing.{module}.dump_tree", lambda tree, rng: json_bytes(tree))
        monkeypatch.setattr(f"fuzzing.{module}.cut", lambda data, rng: data)
    for kind in ("navgrid", "names", "geojson", "verification"):
        for number in range(10):
            made = fuzz.make_input(kind, 0, number)
            if made.suffix != ".json.gz":
                assert fuzz.use_input(kind, made, tmp_path) == "read"


def json_bytes(tree):
    return json.dumps(tree).encode()


@pytest.mark.parametrize(
    ("act", "finding"),
    [
        (lambda path: 1 / 0, "ZeroDivisionError"),
        (lambda path: fail("two\x07"), ""),
        (lambda path: fail("x" * 2000), ""),
        (lambda path: fail(""), "not one line"),
    ],
)
def test_findings_are_found(tmp_path, monkeypatch, act, finding):
    monkeypatch.setitem(KINDS, "odd", Kind(KINDS["yaml"].make, act))
    assert finding in fuzz.use_input("odd", Input(b"", ".txt"), tmp_path)
    # what was read is good for all that is done with it: any error is a finding
    monkeypatch.setitem(KINDS, "odd", Kind(KINDS["yaml"].make, str, act))
    what = fuzz.use_input("odd", Input(b"", ".txt"), tmp_path)
    assert what not in fuzz.FINE and "Error" in what


def fail(message):
    raise NavbakeError(message)


def test_costs_are_compared_with_the_honest_size():
    mib = 1 << 20
    plain, packed = Input(bytes(100), ".x"), Input(gzip.compress(bytes(4 * mib)), ".gz")
    zeros = np.zeros(4 * mib, dtype=np.uint8)
    files = io.BytesIO()
    with zipfile.ZipFile(files, "w", zipfile.ZIP_DEFLATED) as packing:
        packing.writestr("a", bytes(4 * mib))
    image = join_png([header(1, 1), split_png(grey_png())[1], (b"IEND", b"")])
    assert not measure.exceeds(measure.Cost(0.9, 30 * mib), plain, None)
    assert measure.exceeds(measure.Cost(1.1, 0), plain, None) == "took 1.1 s for 100 bytes"
    assert measure.exceeds(measure.Cost(0, 40 * mib), plain, None) == "took 40 MiB for 100 bytes"
    for made, value in (
        (packed, None), (Input(files.getvalue(), ".zip"), None), (plain, {"a": [zeros]}),
    ):  # fmt: skip
        assert not measure.exceeds(measure.Cost(1.1, 70 * mib), made, value)
        assert measure.exceeds(measure.Cost(1.2, 0), made, value).startswith("took 1.2 s")
        assert measure.exceeds(measure.Cost(0, 75 * mib), made, value).startswith("took 75 MiB")
    assert measure.honest_size(Input(image, ".png"), None) < 300


@pytest.mark.skipif(not measure.CLEAR.exists(), reason="only Linux tells of peaks")
def test_memory_is_that_of_one_input():
    meter = measure.Meter()
    _ = np.ones(10_000_000)
    assert 70 << 20 < meter.read().memory < 100 << 20
    assert measure.Meter().read().memory < 10 << 20  # not that of those before


@pytest.mark.parametrize(
    ("navbake_takes", "mujoco_takes", "what"),
    [(0.0, 0.0, "read"), (0.3, 0.0, "took 0.3 s"), (0.3, 0.2, "took 0.3 s"), (0.0, 0.3, "native")],
)
def test_what_mujoco_takes_is_not_ours(tmp_path, monkeypatch, navbake_takes, mujoco_takes, what):
    def be_busy(seconds):
        begin = time.process_time()
        while time.process_time() < begin + seconds:
            pass

    def read(path):
        be_busy(navbake_takes + mujoco_takes)

    monkeypatch.setattr(measure, "FREE_SECONDS", 0.1)
    slow = Kind(KINDS["yaml"].make, read, native=lambda path: be_busy(mujoco_takes))
    monkeypatch.setitem(KINDS, "odd", slow)
    assert fuzz.use_input("odd", Input(b"", ".txt"), tmp_path).startswith(what)


@pytest.mark.parametrize(
    ("kind", "alone", "what"),
    [("yaml", "it died", "it died"), ("mjb", "", "it died"), ("mjb", "not done", fuzz.NATIVE)],
)
def test_who_ended_a_process(monkeypatch, kind, alone, what):
    class Child:
        def __init__(self, patience):
            self.is_ended = False
            children.append(self)

        def use(self, chunk, counts, findings):
            assert chunk.is_alone
            return alone

        def end(self):
            self.is_ended = True

    children = []
    monkeypatch.setattr(fuzz, "Child", Child)
    assert fuzz.judge_ending(fuzz.Chunk(kind, 0, range(1)), "it died") == what
    assert all(child.is_ended for child in children)


def test_children_end_with_the_script(monkeypatch):
    called = []

    class Closed:
        def send(self, what):
            called.append(what)

        def recv(self):
            raise EOFError

    monkeypatch.setattr(fuzz, "end_with_parent", called.append)
    monkeypatch.setattr(fuzz, "limit_memory", called.append)
    fuzz.run_child(Closed(), 123)
    assert called == [123, fuzz.MOST_GIB, fuzz.READY]


def test_the_script_says_that_memory_is_not_checked(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(measure, "CLEAR", tmp_path / "none" / "clear_refs")
    _, printed = run_script(monkeypatch, capsys, "--only", "descriptor", "--count", "1")
    assert printed.startswith("memory is not checked: ") and printed.count("\n") == 2


def run_script(monkeypatch, capsys, *arguments):
    monkeypatch.setattr("sys.argv", ["fuzz", *arguments])
    with pytest.raises(SystemExit) as done:
        fuzz.main()
    return done.value.code, capsys.readouterr().out


def test_the_script_counts_and_goes_on(tmp_path, monkeypatch, capsys):
    state = str(tmp_path / "state.json")
    native = ["--only", "mjcf", "--only", "urdf", "--only", "mjb"]
    options = ["--only", "descriptor", *native, "--state", state]
    code, printed = run_script(monkeypatch, capsys, *options, "--inputs", "40")
    assert code == 0, printed
    assert printed.startswith("descriptor: 10 inputs (seed 0, from 0 on) in ")
    assert "\nin all: 40 inputs: " in printed and printed.endswith(" 0 findings\n")
    told = json.loads((tmp_path / "state.json").read_text())
    assert [one["next"] for one in told["kinds"].values()] == [10] * 4
    code, again = run_script(monkeypatch, capsys, *options, "--inputs", "40")
    assert (code, again) == (0, printed)  # nothing is left to do


def test_no_chunk_is_lost_among_processes(monkeypatch):
    """Also where all kinds that are left are others' at the moment."""
    begun, first = [], threading.Event()

    class Fake:
        num_done, is_spent = fuzz.CHUNK, False

        def __init__(self, patience):
            pass

        def use(self, chunk, counts, findings):
            begun.append(chunk)
            # the first process is at its chunk until the second has had its turn
            first.wait(0.3) if len(begun) == 1 else first.set()
            counts["read"] += len(chunk.numbers)
            return ""

        def end(self):
            pass

    monkeypatch.setattr(fuzz, "Child", Fake)
    tallies = {kind: fuzz.Tally() for kind in ("yaml", "ply")}
    fuzz.Run(0, None, tallies, 5 * fuzz.CHUNK, None).all(["yaml"], 2)
    assert tallies["yaml"].counts["read"] == 5 * fuzz.CHUNK
    fuzz.Run(0, None, tallies, 5 * fuzz.CHUNK, None).all(["yaml", "ply"], 3)
    assert [tally.counts["read"] for tally in tallies.values()] == [5 * fuzz.CHUNK] * 2
    kinds = [chunk.kind for chunk in begun]
    assert kinds.count("yaml") == kinds.count("ply") == 5


# npz never unpickles


@pytest.mark.parametrize("name", ["values.npy", "ids.npy", "names.npy", "known.npy", "res.npy"])
def test_voxels_are_never_unpickled(name):
    members = unpack(encode_npz(VOXELS)) | {name: pickled_array()}
    with pytest.raises(FormatError, match=r"does not hold \(1,\) values of object"):
        read_npz(pack(members))


@pytest.mark.parametrize("name", ["grid.npy", "0/weights.npy", "0/userData.npy"])
def test_grids_are_never_unpickled(name):
    with pytest.raises(FormatError, match="object"):
        read_grid_npz(archive(**{name: pickled_array()}))


def test_arrays_are_never_unpickled():
    with pytest.raises(FormatError, match="can't be read"):
        read_npy(pickled_array())


# Hypothesis: bytes that no kind above makes


@settings(max_examples=max(EXAMPLES, 30) * 4, deadline=None)
@given(st.sampled_from(IN_PROCESS), st.integers(0, 50), st.data())
def test_any_bytes_in_place_of_others(tmp_path_factory, kind, number, data):
    made = fuzz.make_input(kind, 1, number)
    content = bytearray(made.data)
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(content)))
        length = data.draw(st.integers(0, 8))
        content[at : at + length] = data.draw(st.binary(max_size=8))
    place = tmp_path_factory.mktemp("any")
    what = fuzz.use_input(kind, Input(bytes(content), made.suffix, made.beside), place)
    assert what in fuzz.FINE or what.startswith("took"), what
