"""The scripts start, and what they call of the package is there."""

from __future__ import annotations

import runpy
import subprocess
import sys

import pytest

import bench_bake
import bench_run
import bench_voxels
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


def test_run_time_is_measured(monkeypatch, capsys):
    monkeypatch.setattr(bench_run, "ROOMS", 4)
    monkeypatch.setattr(sys, "argv", ["bench_run", "--repeats", "1"])
    bench_run.main()
    printed = capsys.readouterr().out
    assert printed.startswith("house-4 at 0.05 m: 40,000 cells")
    for name in bench_run.ROWS:
        assert f"\n{name}  (asked for:" in printed


def test_bake_is_measured(tmp_path):
    house = tmp_path / "house-4.xml"
    house.write_text(make_house(4, with_doors=True))
    run = bench_bake.measure_here(house, house, None, False)
    assert run["doors"] == 4
    assert run["total"] == pytest.approx(sum(run["timings"].values()), rel=0.5)
    assert all(seconds > 0 for seconds in bench_bake.time_plain_loop(house, 3))


def test_voxels_round_a_robot_are_measured(capsys):
    bench_voxels.bench_robot(1)
    assert "another place and pose" in capsys.readouterr().out
