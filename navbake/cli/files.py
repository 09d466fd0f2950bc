"""The files that commands read and write."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from navbake.errors import ConfigError

GridFile = Annotated[Path, typer.Argument(metavar="GRID", help="A NavGrid file.")]


def check_writable(path: Path, *, may_make_folder: bool = False) -> None:
    """Refuse a path that cannot be written, before any work is done for it.

    Args:
        path: the file to write.
        may_make_folder: its folder may be missing, as long as it can be made.

    Raises:
        ConfigError: its folder is missing or takes no files, or it is a folder itself.
    """
    from navbake.files import check_writable as check_file

    probe = path
    while may_make_folder and not probe.parent.exists():
        probe = probe.parent
    try:
        check_file(probe)
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}") from error
