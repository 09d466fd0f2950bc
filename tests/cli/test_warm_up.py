"""Compiling everything beforehand."""

from __future__ import annotations

import logging

import pytest

from navbake.cli.commands.warm_up import cold_kernels, compile_all
from navbake.cli.main import main


def test_warms_up_from_one_end_to_the_other():
    parts = []
    compile_all(lambda name, share: parts.append((name, share)))
    names = ["bake", "update", "run time", "voxels"]
    assert parts == [(name, share) for name in names for share in (0.0, 1.0)]
    assert cold_kernels() == []


def test_the_command(capsys):
    with pytest.raises(SystemExit) as done:
        main(["warm-up"])
    assert done.value.code == 0
    assert capsys.readouterr().out.startswith("compiled")


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
