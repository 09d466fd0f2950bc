"""Readers read broken files or refuse them in one line; what `scripts/fuzz.py` found stays mended.

Run ``python scripts/fuzz.py -n 30000`` for more.
"""

import json
import os
import time

import hypothesis
import numpy as np
import pytest

import fuzz
from navbake.errors import NavbakeError

EXAMPLES = int(os.environ.get("NAVBAKE_EXAMPLES", "20"))  # inputs of each reader


def signalling():
    """A grid's archive with a NaN that makes the processor complain."""
    content = fuzz.READERS["grid-npz"].seeds()[0]
    return content.replace(np.array(np.nan).tobytes(), np.uint64(0x7FF0000000000001).tobytes())


# Inputs that were findings
FOUND = [
    ("settings", b"scene: {path: a}\na: !!bool maybe"),
    ("settings", b"scene: {path: a}\na: !!timestamp x"),
    ("settings", b"scene: {path: a}\na: !!set [1]"),
    ("settings", b'scene: {path: a}\nrooms: {polygons: "a\\nb"}'),  # two lines
    ("settings", b"scene: {path: a}\nscene: &a {path: *a}"),
    ("settings", b"scene: {path: a}\na: !!" + b"x" * 5000),  # a long line
    ("settings", b"scene: {path: a}\na: *" + b"x" * 5000),
    ("settings", b"scene: {path: a}\nrooms: {polygons: %s}" % (b"x" * 5000)),
    ("geojson", b'{"type": "Feature", "properties": [1]}'),
    ("geojson", b'{"type": "\\n"}'),  # two lines
    ("names", b'{"ids": ' + b"[" * 100_000),
    ("names", b'{"ids": {"1": "a\\u0000"}}'),  # lost in an archive
    ("binvox", b"#binvox 1\ndim 1 1 1\ntranslate 1e308 0 0\ndata\n\x01\x01"),
    ("binvox", b"#binvox 1\ndim 1 1 1\nscale 1e308\ndata\n\x01\x01"),
    ("navgrid", b'{"type":"SceneGrid2D","width":1,"height":1,"cellSize":1e308,"min":[0,0,0]}'),
    ("navgrid", b'{"type":"SceneGrid2D","width":1,"height":1,"cellSize":1,"min":[0,0,0],'
                b'"tileAttributes":{"floorHeight":[1e300]}}'),  # a warning of numpy
    ("navgrid", b'{"type":"SceneGrid2D","width":1,"height":1,"cellSize":1,"min":[0,0,0],'
                b'"userData":{"0":{"doors":["d"],"objects":[1,{}],"walls":[[]]}},"metadata":{'
                b'"navbake":{"doors":[{"id":"d","state":"closed","cells":{"closed":[[0,[0,1]]]}}]}}}'),
    ("grid-npz", signalling()),  # a warning of numpy
    ("stl", bytes(80) + (1).to_bytes(4, "little") + b"\0\0\xa0\x7f" * 12 + b"\0\0"),
    ("nav2", b"image: a.pgm\nresolution: %s\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.6\n"
             b"free_thresh: 0.2\nmode: raw\n" % (b"1" * 400)),
    ("manifest", b'{"scene": "/"}'),
    *[("manifest", json.dumps({"scene": "a", **row}).encode()) for row in (
        {"id": "/" * 9999}, {"settings": "a" * 9999}, {"a" * 9999: 1})],  # long lines
]  # fmt: skip


@pytest.mark.parametrize(("name", "data"), FOUND)
def test_what_was_found(tmp_path, name, data):
    assert fuzz.use(fuzz.READERS[name], data, tmp_path) in (fuzz.READ, fuzz.REFUSED)


@pytest.mark.parametrize("name", fuzz.READERS)
def test_a_sample_of_each_reader(tmp_path, name):
    reader = fuzz.READERS[name]
    for seed in reader.seeds():
        data = seed if isinstance(seed, bytes) else json.dumps(seed).encode()
        assert fuzz.use(reader, data, tmp_path) == fuzz.READ

    @hypothesis.settings(
        max_examples=EXAMPLES, database=None, deadline=None, derandomize=True,
        suppress_health_check=list(hypothesis.HealthCheck),
    )  # fmt: skip
    @hypothesis.given(fuzz.inputs_of(reader))
    def use(data):
        assert fuzz.use(reader, data, tmp_path) in (fuzz.READ, fuzz.REFUSED)

    use()


def fail(message):
    raise NavbakeError(message)


@pytest.mark.parametrize(
    ("act", "what"),
    [
        (lambda path: 1 / 0, "ZeroDivisionError"),
        (lambda path: fail("x" * 9000), fuzz.REFUSED),  # the message is cut
        (lambda path: fail(""), "not one line"),
        (lambda path: time.sleep(9), "not done after"),
        (lambda path: None, fuzz.READ),
    ],
)
def test_findings_are_found(tmp_path, monkeypatch, act, what):
    monkeypatch.setattr(fuzz, "SECONDS", 0.25)
    odd = fuzz.Reader(act, list, ".txt")
    assert what in fuzz.use(odd, b"", tmp_path)


def test_a_process_that_dies_is_a_finding(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(fuzz, "PATIENCE", 0.01)  # it is ended before it has begun
    keeper = fuzz.Keeper("descriptor", tmp_path)
    keeper.use(b"00/")
    counts = fuzz.run("descriptor", 1, 0, tmp_path)
    del counts[fuzz.SLOWEST]
    assert counts == {fuzz.REFUSED: 1, fuzz.FINDING: 1}
    assert "not done in time" in capfd.readouterr().out
    assert (tmp_path / "descriptor-0.txt").exists()


def test_the_script_prints_a_table(tmp_path, monkeypatch, capfd):
    arguments = ["fuzz", "descriptor", "-n", "30", "--folder", str(tmp_path)]
    monkeypatch.setattr("sys.argv", arguments)
    fuzz.main()
    head, row = capfd.readouterr().out.splitlines()
    assert head.split() == ["reader", "read", "refused", "finding", "slowest", "s"]
    assert row.split()[0] == "descriptor" and row.split()[3] == "0"
