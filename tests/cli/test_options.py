"""What commands share: options that belong together, and checks before any work."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, NamedTuple

import pytest
import typer

from navbake.cli.options import check_output, prepared
from navbake.errors import ConfigError


class Size(NamedTuple):
    width: Annotated[int, typer.Option(help="Columns.")]
    height: Annotated[int, typer.Option(help="Rows.")] = 3


def test_options_that_belong_together_are_one_value(capsys):
    app = typer.Typer(rich_markup_mode=None)
    got = []

    @app.command()
    @prepared
    def draw(
        size: Size,
        name: Annotated[str, typer.Argument(help="What.")],
        fast: Annotated[bool, typer.Option("--fast")] = False,
    ) -> None:
        """Draw."""
        got.append((size, name, fast))

    app(["box", "--width", "4", "--fast"], standalone_mode=False)
    app(["box", "--width", "4", "--height", "5"], standalone_mode=False)
    assert got == [(Size(4, 3), "box", True), (Size(4, 5), "box", False)]
    app(["--help"], standalone_mode=False)
    out = capsys.readouterr().out
    assert all(text in out for text in ("Draw.", "--width", "Rows.", "What."))
    assert "--size" not in out


@pytest.mark.parametrize(
    ("name", "culprit"), [("a.pdf", "ends in .png, .svg, got a.pdf"), ("a", "got a")]
)
def test_a_name_has_one_of_the_suffixes(name, culprit):
    with pytest.raises(typer.BadParameter, match=culprit):
        check_output(Path(name), ".png", ".svg")


def test_a_missing_folder_may_be_made_if_asked_for(tmp_path):
    path = tmp_path / "new" / "deep" / "a.png"
    with pytest.raises(ConfigError, match=r"cannot write .*a\.png"):
        check_output(path)
    check_output(path, ".png", may_make_folder=True)
    assert list(tmp_path.iterdir()) == []
