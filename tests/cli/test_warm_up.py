"""Compiling everything beforehand."""

from __future__ import annotations

import pytest

from navbake.cli import warm_up as module
from navbake.cli.main import main
from navbake.cli.warm_up import compile_all, is_warm, tell_if_cold


def test_warms_up_from_one_end_to_the_other():
    parts = []
    compile_all(lambda name, share: parts.append((name, share)))
    names = ["bake", "run time", "voxels"]
    assert parts == [(name, share) for name in names for share in (0.0, 1.0)]
    assert is_warm()


def test_the_command(capsys):
    with pytest.raises(SystemExit) as done:
        main(["warm-up"])
    assert done.value.code == 0
    assert capsys.readouterr().out.startswith("compiled")


def test_a_first_bake_says_why_it_takes_long(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    monkeypatch.setattr(module, "is_warm", lambda: False)
    tell_if_cold()
    assert "compiling for this machine, once" in capsys.readouterr().err
    monkeypatch.setattr(module, "is_warm", lambda: True)
    tell_if_cold()
    assert capsys.readouterr().err == ""
