"""The scripts start, and what they call of the package is there."""

from __future__ import annotations

import math
import runpy
import subprocess
import sys
import time

import orjson
import pytest

import bench
from benchmarks.measure import Row, here, measure_row
from benchmarks.peers import time_plain_loop
from benchmarks.scenes import Scenes, sections
from make_house import make_house
from project_paths import ROOT

SCRIPTS = ROOT / "scripts"


@pytest.mark.parametrize("name", sorted(path.stem for path in SCRIPTS.glob("*.py")))
def test_script_starts(name, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [name, "--help"])
    with pytest.raises(SystemExit) as done:
        runpy.run_path(str(SCRIPTS / f"{name}.py"), run_name="__main__")
    assert done.value.code == 0
    assert "usage: " in capsys.readouterr().out


@pytest.mark.parametrize("path", sorted(SCRIPTS.glob("*.sh")), ids=lambda path: path.name)
def test_shell_script_parses(path):
    subprocess.run(["bash", "-n", str(path)], check=True)


@pytest.mark.parametrize("names", [("house", "share"), ("load", "navigable"), ("robot",)])
def test_rows_are_measured(names, tmp_path, monkeypatch, capsys):
    out = tmp_path / "figures.json"
    chosen = ["--rooms", "4", "--repeats", "1", "--json", str(out), "--keep", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["bench", *chosen, "--only", *names])
    bench.main()
    printed = capsys.readouterr().out
    found = orjson.loads(out.read_bytes())
    assert [row["row"] for row in found] == list(names)
    for row in found:
        assert f"\n{row['row']} " in printed
        assert all(job["median"] >= job["min"] > 0 for job in [row["job"], *row["peers"]])


def test_unknown_rows_are_named(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["bench", "--only", "hause"])
    with pytest.raises(SystemExit):
        bench.main()
    assert "--only: unknown row hause" in capsys.readouterr().err


def test_limits_are_held_against_medians():
    slow, fast = here("slow", lambda: time.sleep(0.02)), here("fast", lambda: None)
    row = Row(slow, [fast], limit=0.01, ratio=1.0)
    printed = bench.format_row("sleep", row, measure_row(row, 3))
    assert "1 ×: NOT MET, 10.0 ms: NOT MET" in printed
    row = Row(fast, [slow], limit=0.01, ratio=1.0)
    assert "1 ×: met, 10.0 ms: met" in bench.format_row("none", row, measure_row(row, 3))


def test_soups_have_the_house_s_shape(tmp_path):
    vertices, faces = Scenes(tmp_path).soup(1).read()
    assert faces.max() == len(vertices) - 1
    assert vertices.min(axis=0) == pytest.approx([0, 0, -0.2], abs=1e-6)
    assert vertices.max(axis=0) == pytest.approx([5, 5, 2.5], abs=1e-6)
    assert sections(0.4) % 2 == 0
    assert 0.4 * (1 - math.cos(math.pi / sections(0.4))) <= 0.0015


def test_plain_loop_is_measured(tmp_path):
    house = tmp_path / "house-4.xml"
    house.write_text(make_house(4))
    assert all(seconds > 0 for seconds in time_plain_loop(house, 4, 3))
