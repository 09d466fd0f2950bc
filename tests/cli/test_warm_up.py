"""Compiling everything beforehand."""

from __future__ import annotations

import logging

import pytest

from navbake import compiled
from navbake.cli.main import main


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as done:
        main(["warm-up", *arguments])
    return int(done.value.code or 0)


def test_all_is_compiled_in_some_processes(monkeypatch, capsys):
    asked = []
    monkeypatch.setattr(compiled, "warm_up", lambda **options: asked.append(options) or [])
    assert run() == 0 and asked[0]["everything"]
    assert capsys.readouterr().out.startswith("compiled")
    monkeypatch.setattr(compiled, "warm_up", lambda **options: ["runtime.kernels.a.b"])
    assert (
        run() == 0 and "not compiled, or not kept: runtime.kernels.a.b" in capsys.readouterr().err
    )


def test_says_where_nothing_can_be_kept(monkeypatch, capsys):
    monkeypatch.setattr(compiled, "cache_folder", lambda: None)
    assert run() == 0
    out, err = capsys.readouterr()
    assert out == "" and "nothing can be kept: set NUMBA_CACHE_DIR" in err


def test_commands_print_what_is_logged(monkeypatch, capsys):
    """A slow start is announced on stderr, whether it is a terminal or a pipe."""

    def warm_up(**options: object) -> list[str]:
        logging.getLogger("navbake.compiled").warning("compiling")
        return []

    monkeypatch.setattr(compiled, "warm_up", warm_up)
    run()
    assert "navbake: compiling\n" in capsys.readouterr().err
