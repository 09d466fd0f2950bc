"""`navbake doctor` on machines where something is missing."""

from __future__ import annotations

import subprocess
import sys

import pytest

from navbake import compiled
from navbake._version import __version__
from navbake.cli import check


@pytest.fixture
def lines(run):
    """Returns a function that runs `navbake doctor` without the bake: its lines by name."""

    def call(*options):
        status, out, _ = run("doctor", *(options or ["--no-bake"]))
        assert status == 0
        return {line[:12].strip(): line[13:] for line in out.splitlines()}

    return call


def test_versions_and_caches(lines):
    found = lines()
    assert found["navbake"].startswith(f"{__version__} in ")
    assert "numba " in found["packages"]
    assert "MISSING" not in found["packages"]
    assert str(compiled.cache_folder()) in found["compiled"]


def test_a_bake_has_a_time(lines):
    assert "apartment: " in lines("-q")["bake"]
    assert "free cells" in lines("-q")["bake"]


def test_a_slow_machine_is_named(lines, monkeypatch):
    monkeypatch.setattr(check, "USUAL_BAKE_SECONDS", 0.0)
    assert "SLOW: usually below 0.0 s" in lines("-q")["bake"]


def test_a_missing_extra_names_its_command(lines, monkeypatch):
    monkeypatch.setattr(
        check, "_installed_version", lambda name: None if name == "viser" else "1.0"
    )
    found = lines()
    assert found["[view]"] == 'missing viser: pip install "navbake[view]"'
    assert found["[plot]"] == "matplotlib 1.0"


def test_no_folder_that_can_be_written(lines, monkeypatch):
    monkeypatch.setattr(check.compiled, "cache_folder", lambda: None)
    assert lines()["compiled"].endswith(compiled.CACHE_REMEDY)
    assert "NO FOLDER CAN BE WRITTEN" in lines()["compiled"]


def test_code_of_other_sources_is_counted(tmp_path):
    stale = tmp_path / "navbake-kernels" / "baker.kernels.rays-0123456789abcdef" / "kernels_1"
    stale.mkdir(parents=True)
    (stale / "rays.cast-1.py311.1.nbc").write_bytes(bytes(2_000_000))
    done = subprocess.run(
        [sys.executable, "-m", "navbake", "doctor", "--no-bake"],
        env={"NUMBA_CACHE_DIR": str(tmp_path), "PATH": "", "HOME": "/nonexistent"},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "2.0 MB in 1 folders are of other sources" in done.stdout
    assert "display none" in done.stdout
