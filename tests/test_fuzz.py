"""A small sample of what `scripts/fuzz.py` does, and what it once found.

Run ``python scripts/fuzz.py --count 30000`` for more.
"""

import json

import pytest

import fuzz
from fuzzing.kinds import KINDS, Kind
from navbake.errors import NavbakeError

SAMPLE = 60  # inputs of each kind

# Inputs that were findings: (kind, ending, content)
FOUND = [
    ("yaml", ".yaml", b"scene: {path: a}\na: !!bool maybe"),
    ("yaml", ".yaml", b"scene: {path: a}\na: !!timestamp x"),
    ("yaml", ".yaml", b"scene: {path: a}\na: !!float ''"),
    ("yaml", ".yaml", b"scene: {path: a}\na: !!set [1]"),
    ("yaml", ".yaml", b"scene: {path: a}\na: " + b"[" * 1500),  # took over a second
    ("yaml", ".yaml", b'scene: {path: a}\nrooms: {polygons: "a\\nb"}'),  # two lines
    ("yaml", ".yaml", b"scene: {path: a}\nscene: &a {path: *a}"),
    ("geojson", ".geojson", b'{"type": "Feature", "properties": [1]}'),
    ("geojson", ".geojson", b'{"type": "\\n"}'),  # two lines
    ("names", ".json", b'{"ids": ' + b"[" * 100_000),
    ("binvox", ".binvox", b"#binvox 1\ndim 1 1 1\ntranslate 1e308 0 0\ndata\n\x01\x01"),
    ("binvox", ".binvox", b"#binvox 1\ndim 1 1 1\nscale 1e308\ndata\n\x01\x01"),
    (
        "navgrid",
        ".json",
        b'{"type":"SceneGrid2D","width":1,"height":1,"cellSize":1e308,"min":[0,0,0]}',
    ),
    (
        "navgrid",
        ".json",
        b'{"type":"SceneGrid2D","width":1,"height":1,"cellSize":1,"min":[0,0,0],'
        b'"tileAttributes":{"floorHeight":[1e300]}}',  # a warning of numpy
    ),
    (
        "navgrid",
        ".json",
        # an overflow when a path is planned, in one of eight files
        b'{"type":"SceneGrid2D","width":2,"height":1,"cellSize":1,"min":[0,0,0],"metadata":'
        b'{"agentRadius":1e308,"inflation":[{"radius":1e308,"mode":"exact"}],"n":%d}}' % 1,
    ),
    (
        "navgrid",
        ".json",
        b'{"type":"SceneGrid2D","width":1,"height":1,"cellSize":1,"min":[0,0,0],'
        b'"userData":{"0":{"doors":["d"],"objects":[1,{}],"walls":[[]]}},"metadata":{"navbake":'
        b'{"doors":[{"id":"d","state":"closed","cells":{"closed":[[0,[0,1]]]}}]}}}',
    ),
]


@pytest.mark.parametrize(("kind", "suffix", "data"), FOUND)
def test_what_was_found(tmp_path, kind, suffix, data):
    assert fuzz.use_input(kind, data, suffix, tmp_path) in ("read", "refused")


@pytest.mark.parametrize("kind", KINDS)
def test_a_sample_of_each_kind(tmp_path, kind):
    outcomes = []
    for number in range(SAMPLE):
        data, suffix = fuzz.make_input(kind, 0, number)
        outcomes.append(fuzz.use_input(kind, data, suffix, tmp_path))
        assert outcomes[-1] in ("read", "refused"), f"{kind} {number}: {outcomes[-1]}"
    assert "refused" in outcomes  # the changes are felt
    assert fuzz.make_input(kind, 0, 7) == fuzz.make_input(kind, 0, 7)


def test_good_inputs_are_read(tmp_path, monkeypatch):
    monkeypatch.setattr("fuzzing.kinds.mutate_tree", lambda tree, rng: tree)
    monkeypatch.setattr("fuzzing.kinds.dump_tree", lambda tree, rng: json_bytes(tree))
    for kind in ("navgrid", "names", "geojson"):
        for number in range(10):
            data, suffix = fuzz.make_input(kind, 0, number)
            if suffix != ".json.gz":
                assert fuzz.use_input(kind, data, suffix, tmp_path) == "read"


def json_bytes(tree):
    return json.dumps(tree).encode()


@pytest.mark.parametrize(
    ("act", "finding"),
    [
        (lambda path: 1 / 0, "ZeroDivisionError"),
        (lambda path: fail("two\x07"), ""),
        (lambda path: fail("x" * 2000), "not one line"),
        (lambda path: fail(""), "not one line"),
    ],
)
def test_findings_are_found(tmp_path, monkeypatch, act, finding):
    monkeypatch.setitem(KINDS, "odd", Kind(KINDS["yaml"].make, act))
    assert finding in fuzz.use_input("odd", b"", ".txt", tmp_path)


def fail(message):
    raise NavbakeError(message)


def test_the_script_counts(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["fuzz", "--only", "descriptor", "--count", "20"])
    with pytest.raises(SystemExit) as done:
        fuzz.main()
    assert done.value.code == 0
    printed = capsys.readouterr().out
    assert printed.startswith("descriptor: 20 inputs (seed 0, from 0 on) in ")
    assert printed.endswith(" 0 findings\n")
