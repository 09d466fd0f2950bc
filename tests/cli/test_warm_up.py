"""Compiling everything beforehand."""

from __future__ import annotations

import ast
import logging
import subprocess
import sys
from pathlib import Path

import pytest

import navbake
from navbake.cli.commands import warm_up as command
from navbake.cli.commands.warm_up import cold_kernels, compile_all, pack_code, take_code
from navbake.cli.main import main


def test_warms_up_from_one_end_to_the_other():
    parts = []
    compile_all(lambda name, share: parts.append((name, share)))
    names = ["bake", "update", "run time", "voxels"]
    assert parts == [(name, share) for name in names for share in (0.0, 1.0)]
    assert cold_kernels() == []


# names the kernels that were neither compiled nor read from the disk
UNUSED = """
from navbake.cli.commands.warm_up import compile_all, load_kernels
load_kernels()
compile_all(lambda name, share: None)
from navbake.dispatch import KERNELS
print(*(f"{k.__module__}.{k.__name__}" for k in KERNELS if not k.overloads))
"""


def test_every_kernel_that_python_calls_is_used():
    """Where all are on disk already, as where tests ran before, nothing else would miss one."""
    run = [sys.executable, "-c", UNUSED]
    done = subprocess.run(run, capture_output=True, text=True, check=True)
    unused = set(done.stdout.split())
    assert any("._" in name for name in unused)  # those that only kernels call
    assert sorted(unused & _called_from_python()) == []


def _called_from_python() -> set[str]:
    """The kernels that modules other than those of kernels import."""
    home = Path(navbake.__file__).parent
    return {
        f"{node.module}.{alias.name}"
        for path in home.rglob("*.py")
        if "kernels" not in path.relative_to(home).parts
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and ".kernels." in str(node.module)
        for alias in node.names
    }


def test_the_command(capsys):
    with pytest.raises(SystemExit) as done:
        main(["warm-up"])
    assert done.value.code == 0
    assert capsys.readouterr().out.startswith("compiled")


def test_compiled_code_as_a_file(tmp_path, monkeypatch, capsys):
    archive = tmp_path / "kernels.tar.gz"
    monkeypatch.setattr("navbake.cli.commands.warm_up.compile_all", lambda progress: None)

    def run(*arguments):
        with pytest.raises(SystemExit) as done:
            main(["warm-up", *map(str, arguments)])
        return done.value.code, capsys.readouterr().err

    assert run("--archive", archive) == (0, "") and archive.stat().st_size > 1e6
    assert run("--unpack", archive) == (0, "")
    machine = {"numba": "0", "Python": "0", "processor": "x"}
    monkeypatch.setattr("navbake.compiler.archive.describe_machine", lambda: machine)
    status, err = run("--unpack", archive)
    assert status == 0 and err.startswith(
        f"navbake: warning: nothing of {archive} is of use here: "
    )
    (tmp_path / "text.tar.gz").write_text("text")
    status, err = run("--unpack", tmp_path / "text.tar.gz")
    assert status == 1 and "expected an archive of navbake warm-up" in err
    assert run("--archive", tmp_path / "kernels.zip")[0] == 2
    assert run("--archive", tmp_path / "no" / "kernels.tar.gz")[0] == 1


def test_a_node_takes_code_or_compiles_once(monkeypatch):
    code = pack_code()
    assert code is not None and take_code(code) is None and take_code(None) is None
    compiled = []
    monkeypatch.setattr(command, "bakes_compile", lambda: True)
    monkeypatch.setattr(command, "compile_all", lambda show: compiled.append(1))
    assert take_code(None) == "it has compiled code of its own, once"
    monkeypatch.setattr("navbake.compiler.archive._differs", lambda machine: "it is for x")
    assert take_code(code).endswith("once; of the batch's, it is for x") and len(compiled) == 2
    monkeypatch.setattr("navbake.dispatch.can_keep", lambda: False)
    assert "each worker compiles its own" in take_code(code) and len(compiled) == 2
    assert pack_code() is None


def test_commands_print_what_is_logged(monkeypatch, capsys):
    """A slow start is told on stderr, whether it is a terminal or a pipe."""
    monkeypatch.setattr(
        "navbake.cli.commands.warm_up.load_kernels",
        lambda: logging.getLogger("navbake.compiled").warning("compiling"),
    )
    monkeypatch.setattr("navbake.cli.commands.warm_up.compile_all", lambda progress: None)
    with pytest.raises(SystemExit):
        main(["warm-up"])
    assert "navbake: compiling\n" in capsys.readouterr().err
