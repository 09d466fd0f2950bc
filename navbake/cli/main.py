"""The command line: its commands, its exit status, and how errors are shown.

Only the modules of `navbake.cli` print, and only this one ends the process.
"""

import errno
import io
import logging
import os
import sys
from collections.abc import Sequence
from contextlib import suppress

from typer import Exit, Option, Typer

from navbake._version import __version__
from navbake.cli.commands.bake import bake
from navbake.cli.commands.batch import batch
from navbake.cli.commands.checks import audit, verify
from navbake.cli.commands.convert import convert, extrude
from navbake.cli.commands.grids import info, rooms, why
from navbake.cli.commands.inflate import inflate
from navbake.cli.commands.map_descriptor import mdf
from navbake.cli.commands.path import path
from navbake.cli.commands.plot import plot
from navbake.cli.commands.report import report
from navbake.cli.commands.scenes import geoms, init, samples
from navbake.cli.commands.view import view
from navbake.cli.commands.voxelize import voxelize
from navbake.cli.commands.warm_up import warm_up
from navbake.cli.options import Command, prepared
from navbake.cli.printing import print_causes, print_error
from navbake.errors import NavbakeError

# No command draws with OpenGL. MuJoCo's import is faster without looking for it.
os.environ.setdefault("MUJOCO_GL", "disable")

UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF, errno.EPIPE)
"""The system's numbers for an output that takes no more."""

app = Typer(
    name="navbake",
    help="Bake MuJoCo scenes into navigation grids, and query and convert those grids.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
COMMANDS = (
    *(samples, init, geoms, bake, batch),
    *(info, rooms, why, plot, inflate, path, voxelize, mdf, convert, extrude, warm_up),
    *(verify, audit, report, view),
)
for command in COMMANDS:
    app.command(cls=Command)(prepared(command))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit: 0 done, 1 a NavbakeError, 2 wrong usage."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        # names of geoms and files may hold what the terminal's encoding lacks
        sys.stdout.reconfigure(errors="backslashreplace")
    logging.getLogger("navbake.compiled").handlers[:] = [_LogPrinter()]
    try:
        try:
            app(None if arguments is None else list(arguments), prog_name="navbake")
        finally:  # what is buffered may not fit any more, either
            if sys.stdout is not None:
                sys.stdout.flush()
    except NavbakeError as error:
        print_error(str(error))
        print_causes(error)
        raise SystemExit(1) from None
    except OSError as error:
        if error.filename is not None or error.errno not in UNWRITABLE:
            raise
        _drop_stdout()
        if error.errno != errno.EPIPE:  # whoever closed a pipe wants no more
            print_error(f"cannot write to stdout: {error.strerror}")
        raise SystemExit(1) from None


class _LogPrinter(logging.Handler):
    """Prints what is told of compiling, one line on stderr each."""

    def emit(self, record: logging.LogRecord) -> None:
        print_error(record.getMessage())


def _drop_stdout() -> None:
    """Send what is still buffered nowhere: Python would try it again at its end, and complain."""
    with suppress(OSError, ValueError):  # ValueError: it has no number, as under tests
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _print_version(asked: bool) -> None:
    if asked:
        print(f"navbake {__version__}")
        raise Exit


@app.callback()
def _options(
    version: bool = Option(
        False, "--version", callback=_print_version, is_eager=True, help="Print the version."
    ),
) -> None: ...
