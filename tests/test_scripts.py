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
from benchmarks.measure import Job, Result, Row, Sample, SkipRow, here, measure_row
from benchmarks.peers import time_plain_loop
from benchmarks.scenes import Scenes, sections
from benchmarks.table import (
    FIGURES_BEGIN,
    FIGURES_END,
    Outcome,
    exit_status,
    format_outcome,
    format_row,
    summarize,
    write_figures,
)
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


@pytest.mark.parametrize(
    "names", [("house", "share"), ("load", "navigable"), ("robot",), ("flight-octree",)]
)
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
    row = Row(slow, [fast], ratio=1.0, excess=0.01)
    printed = format_row("sleep", row, measure_row(row, 3))
    assert "1 ×: NOT MET, 10.0 ms more: NOT MET" in printed
    row = Row(fast, [slow], ratio=1.0, excess=0.01)
    assert "1 ×: met, 10.0 ms more: met" in format_row("none", row, measure_row(row, 3))


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


def outcome_of(name, seconds, *peer_seconds, **row_fields):
    """A row with one sample of each job."""
    jobs = [Job(f"job {number}", lambda: None) for number in range(1 + len(peer_seconds))]
    results = [Result("ours", [Sample(seconds)])]
    results += [Result("theirs", [Sample(value)]) for value in peer_seconds]
    return Outcome(name, Row(jobs[0], jobs[1:], **row_fields), results)


@pytest.mark.parametrize(
    ("outcome", "verdict"),
    [
        (outcome_of("a", 1.0, 1.0, ratio=1.0), "met"),
        (outcome_of("a", 1.1, 1.0, ratio=1.0), "missed"),
        (outcome_of("a", 1.5, 1.0, excess=0.5), "met"),
        (outcome_of("a", 1.6, 1.0, excess=0.5), "missed"),
        (outcome_of("a", 1.0, 1.0, ratio=1.0, peak=200.0), "skipped"),
        (outcome_of("a", 1.0, ratio=1.0, missing="no peer: pip install peer"), "skipped"),
        (outcome_of("a", 1.0, 1.0), "no limit"),
        (Outcome("a", skipped="no scene"), "skipped"),
        (Outcome("a", error="ValueError: no"), "failed"),
    ],
)
def test_rows_get_their_verdicts(outcome, verdict):
    assert outcome.verdict == verdict
    assert exit_status([outcome]) == (verdict in ("missed", "failed"))
    assert exit_status([outcome_of("b", 1.0, 1.0, ratio=2.0), outcome]) == exit_status([outcome])


def test_summary_names_the_rows_that_are_not_met():
    outcomes = [
        outcome_of("fast", 1.0, 2.0, ratio=1.0),
        outcome_of("slow", 3.0, 2.0, ratio=1.0),
        outcome_of("alone", 1.0, ratio=1.0, missing="no peer: pip install peer"),
        Outcome("broken", error="ValueError: no"),
        Outcome("far", skipped="no scene: fetch it"),
    ]
    assert summarize(outcomes).splitlines() == [
        "5 rows: 1 met, 1 missed, 1 failed, 2 skipped",
        "missed: slow (1 ×: NOT MET)",
        "failed: broken (ValueError: no)",
        "skipped: alone (no peer: pip install peer)",
        "skipped: far (no scene: fetch it)",
    ]
    assert format_outcome(outcomes[3]).split() == ["broken", "failed:", "ValueError:", "no"]


def test_other_rows_are_measured_after_one_fails(capsys):
    def fail():
        raise ValueError("no such thing")

    def skip():
        raise SkipRow("no scene: fetch it")

    def lack():
        raise ModuleNotFoundError("no", name="peer")

    assert bench.measure("broken", fail, 1).error == "ValueError: no such thing"
    assert "no such thing" in capsys.readouterr().err
    assert bench.measure("far", skip, 1).skipped == "no scene: fetch it"
    assert "pip install" in bench.measure("alone", lack, 1).skipped
    assert bench.measure("good", lambda: Row(here("ours", list)), 1).verdict == "no limit"


def test_figures_of_the_page_are_replaced():
    page = f"# Title\n{FIGURES_BEGIN}old\n{FIGURES_END}rest\n"
    outcomes = [outcome_of("house", 1.0, 2.0, 100.0), Outcome("path", skipped="no peer")]
    written = write_figures(page, outcomes, "Medians of 3.")
    assert written.startswith("# Title\n")
    assert written.endswith("rest\n")
    assert "old" not in written
    assert "| 1.00 s | Recast, rasterize to regions | 2.00 s | 0.5 × |" in written
    assert "| 1.00 s | Python, extrapolated | 100.00 s | 0.01 × |" in written
    assert "8 paths" not in written
    assert write_figures(written, outcomes, "Medians of 3.") == written
    real_page = (ROOT / "docs" / "compare.md").read_text(encoding="utf-8")
    assert real_page.count(FIGURES_BEGIN) == real_page.count(FIGURES_END) == 1
