"""Compiled code that is handed on to other installations, in a small package of its own."""

from __future__ import annotations

import gzip
import io
import json
import os
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

import navbake
from navbake.compiler import archive as module
from navbake.compiler.archive import HEADER, unpack_kernels
from navbake.errors import FormatError

MACHINERY = ("compiled", "digests", "dispatch", "errors", "folder_lock", "kernel_list", "loading")
KERNEL = """from numba import njit
{more}
@njit(cache=True)
def {name}():
    return {value}
"""
USES = "from navbake.kernels.inner import inner"
LOAD = "import sys; from pathlib import Path\nfrom navbake.kernels import inner, outer, other\n"
PACK = (
    "outer.outer(), other.other()\nfrom navbake.compiler.archive import pack_kernels\n"
    "packed = pack_kernels()\nassert packed == pack_kernels()\n"
    "Path('code.tar.gz').write_bytes(packed)\n"
)
UNPACK = (
    "from navbake.compiler.archive import unpack_kernels\n"
    "found = unpack_kernels(Path('code.tar.gz').read_bytes(), 'code')\n"
    "print(found.kernels, found.why_not)\n"
    "for kernel in (outer.outer, other.other):\n"
    "    print(kernel(), sum(kernel.stats.cache_hits.values()))"
)


def install(folder: Path, inner: int = 1) -> Path:
    """Install the package into a folder; where compiled code is kept."""
    package = folder / "navbake"
    kernels = package / "kernels"
    kernels.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    real = Path(navbake.__file__).parent
    for name in MACHINERY:
        shutil.copy(real / f"{name}.py", package)
    shutil.copytree(real / "compiler", package / "compiler")
    shutil.copy(real / "runtime" / "kernels" / "__init__.py", kernels)
    (kernels / "inner.py").write_text(KERNEL.format(more="", name="inner", value=inner))
    (kernels / "outer.py").write_text(KERNEL.format(more=USES, name="outer", value="inner()"))
    (kernels / "other.py").write_text(KERNEL.format(more="", name="other", value=3))
    return folder


def run(folder: Path, code: str, **env: str) -> list[str]:
    """The lines that code prints in a process that uses the package of a folder."""
    environment = {**os.environ, "PYTHONPATH": str(folder), **env}
    environment.pop("NUMBA_CACHE_DIR", None)
    environment.update(env)
    command = [sys.executable, "-c", LOAD + code]
    done = subprocess.run(
        command, cwd=folder.parent, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.fixture(scope="module")
def code(tmp_path_factory):
    """The code of one installation."""
    folder = tmp_path_factory.mktemp("first")
    run(install(folder / "one"), PACK)
    return (folder / "code.tar.gz").read_bytes()


@pytest.fixture
def packed(tmp_path, code):
    """A folder with the code of another installation in ``code.tar.gz``."""
    (tmp_path / "code.tar.gz").write_bytes(code)
    return tmp_path


def test_another_installation_compiles_nothing(packed):
    two = install(packed / "two")
    for path in two.rglob("*.py"):
        os.utime(path, (1e9, 1e9))
    cold = packed / "cold"
    assert run(two, UNPACK, NUMBA_CACHE_DIR=str(cold)) == ["3 None", "1 1", "3 1"]
    first = (packed / "code.tar.gz").read_bytes()
    run(two, PACK, NUMBA_CACHE_DIR=str(cold))
    assert (packed / "code.tar.gz").read_bytes() == first
    # what is there already stays
    assert run(two, UNPACK, NUMBA_CACHE_DIR=str(cold)) == ["0 None", "1 1", "3 1"]


def test_code_of_other_sources_is_left_where_it_is(packed):
    assert run(install(packed / "two", inner=2), UNPACK) == ["1 None", "2 0", "3 1"]


def test_code_for_another_processor_is_refused(packed):
    lines = run(install(packed / "two"), UNPACK, NUMBA_CPU_NAME="generic")
    assert lines[0].startswith("0 it is for processor ") and "generic" in lines[0]
    assert lines[1:] == ["1 0", "3 0"]


def test_a_file_that_is_no_archive_is_refused_and_writes_nothing(packed, monkeypatch):
    content = (packed / "code.tar.gz").read_bytes()
    assert unpack_kernels(content, "code").kernels == 0  # no kernel of this package is in it
    monkeypatch.setattr(module, "MOST_BYTES", 1 << 20)
    monkeypatch.setattr(module, "MOST_FILES", 3)
    link = tarfile.TarInfo("link")
    link.type, link.linkname = tarfile.SYMTYPE, "/etc/passwd"
    long_name = tarfile.TarInfo("a" * (1 << 20))  # which is in a header, and not in a file
    for broken in (
        b"",
        b"no archive",
        content[: len(content) // 2],
        gzip.compress(b"text" * 1000),
        make_archive(tarfile.TarInfo("../outside")),
        make_archive(link),
        make_archive(tarfile.TarInfo("large"), bytes(1 << 20)),
        make_archive(long_name),
        make_archive(tarfile.TarInfo("empty"), count=4),
        make_archive(tarfile.TarInfo(HEADER), b"[" * 100_000),
        make_archive(tarfile.TarInfo(HEADER), b"[]"),
        make_archive(tarfile.TarInfo(HEADER), json.dumps({"machine": 3}).encode()),
    ):
        with pytest.raises(FormatError, match="expected an archive of navbake warm-up"):
            unpack_kernels(broken, "code")
    assert not (packed / "outside").exists()


def make_archive(entry: tarfile.TarInfo, content: bytes = b"", count: int = 1) -> bytes:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as archive:
        entry.size = len(content)
        for _ in range(count):
            archive.addfile(entry, io.BytesIO(content))
    return packed.getvalue()
