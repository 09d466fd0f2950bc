"""The wheel works in an empty folder, where nothing can be written.

The environment is that of a container: the package is read-only, there is no home and no cache.
The superuser runs it without the capability to write where modes forbid it. What compiles for
minutes where no compiled code is kept is run by `tests/test_docs.py` instead.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

import pytest

from project_paths import GOLDEN, ROOT

# what the superuser needs to obey modes
OBEY = ["setpriv", "--bounding-set=-all", "--inh-caps=-all"]
WHEEL = '[tool.hatch.build.targets.wheel.force-include]\n"configs" = "navbake/sample_files"\n'


def lay_out_wheel(site: Path) -> None:
    """What a wheel holds, as `pyproject.toml` has it."""
    assert WHEEL in (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "navbake", site / "navbake", ignore=ignored)
    shutil.copytree(ROOT / "configs", site / "navbake" / "sample_files", ignore=ignored)


@pytest.fixture(scope="module")
def container():
    """A folder with the read-only package in `site`, and the empty folder `work`."""
    place = Path(tempfile.mkdtemp(prefix="navbake-wheel-"))
    place.chmod(0o755)
    site, work = place / "site", place / "work"
    lay_out_wheel(site)
    for path in [site, *site.rglob("*")]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    work.mkdir()
    yield place
    for path in [site, *site.rglob("*")]:
        if path.is_dir():
            path.chmod(0o755)
    shutil.rmtree(place)


def run_in(container: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    kept = ("PATH", "LD_LIBRARY_PATH", "NUMBA_CPU_NAME", "VIRTUAL_ENV")
    env = {name: os.environ[name] for name in kept if name in os.environ}
    obey = OBEY if os.geteuid() == 0 else []
    return subprocess.run(
        [*obey, sys.executable, "-B", *arguments],
        cwd=container / "work",
        env={**env, "PYTHONPATH": str(container / "site"), "HOME": "/nonexistent"},
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )


posix = pytest.mark.skipif(
    os.name != "posix" or (os.geteuid() == 0 and shutil.which("setpriv") is None),
    reason="nothing here can be made read-only",
)


@posix
def test_what_reads_the_package_s_own_files_works_in_an_empty_folder(container):
    where = run_in(container, "-c", "import navbake; print(navbake.__file__)")
    assert where.stdout.startswith(str(container)), where.stderr
    writing = f"open({str(container / 'site' / 'navbake' / 'x')!r}, 'w')"
    assert "Permission denied" in run_in(container, "-c", writing).stderr
    grid = str(GOLDEN / "house.grid.json.gz")
    for command in (
        ("samples", "house"),
        ("geoms", "house.yaml"),
        ("info", grid),
        ("report", grid, "-o", "house.html"),
    ):
        done = run_in(container, "-m", "navbake", *command)
        assert done.returncode == 0, (command, done.stderr)
        assert "Traceback" not in done.stderr
    assert (container / "work" / "house.html").stat().st_size > 10_000


def build(kind: str, folder: Path) -> Path:
    if importlib.util.find_spec("hatchling") is None:
        pytest.skip("hatchling is not installed, so nothing can be built")
    command = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return next(folder.iterdir())


def test_the_wheel_holds_what_is_laid_out_here(tmp_path):
    with zipfile.ZipFile(build("wheel", tmp_path / "dist")) as wheel:
        built = {name for name in wheel.namelist() if name.startswith("navbake/")}
    lay_out_wheel(tmp_path / "site")
    files = [path for path in (tmp_path / "site").rglob("*") if path.is_file()]
    assert built == {path.relative_to(tmp_path / "site").as_posix() for path in files}


def test_the_source_distribution_has_the_picture_of_its_read_me(tmp_path):
    shutil.unpack_archive(build("sdist", tmp_path / "dist"), tmp_path / "source")
    source = next((tmp_path / "source").iterdir())
    text = (source / "README.md").read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#\s]+)", text):
        assert target.startswith("https://") or (source / target).exists(), target
