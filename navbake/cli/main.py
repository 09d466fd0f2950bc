"""The command line: its commands, its exit status, and error messages.

Only the modules of `navbake.cli` print, and only this one ends the process.
"""

import errno
import io
import logging
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from typer import Exit, Option, Typer
from typer.core import TyperGroup
from typer.main import get_command

from navbake._version import __version__
from navbake.cli.ask import info, path, rooms, sample, stand, why
from navbake.cli.bake import bake, geoms, init, samples, schema, voxelize
from navbake.cli.batch import batch, warm_up
from navbake.cli.check import audit, doctor, verify
from navbake.cli.episodes import episodes, score
from navbake.cli.exchange import convert, inflate, map_descriptor, routes
from navbake.cli.fly import fly
from navbake.cli.look import plot, report, view
from navbake.cli.options import NavbakeCommand, prepare_command
from navbake.cli.printing import add_warning, print_causes, print_error, print_package_warnings
from navbake.errors import NavbakeError

# No command draws with OpenGL. MuJoCo's import is faster without looking for it.
os.environ.setdefault("MUJOCO_GL", "disable")

DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF, errno.EPIPE)
"""Numbers of operating system errors when an output can't be written any further."""

COMMANDS: dict[str, tuple[Callable[..., None], ...]] = {
    "Bake": (samples, init, schema, geoms, bake, voxelize),
    "Ask": (info, rooms, why, path, sample, stand, fly),
    "Look": (plot, report, view),
    "Exchange": (convert, inflate, routes, map_descriptor),
    "Benchmark": (episodes, score),
    "Check": (verify, audit, doctor),
    "Many": (batch, warm_up),
}
"""Title of a group in --help -> its commands."""
ALIASES = {"mdf": "map-descriptor"}
GUESSED_COMMANDS = {  # name that a user may guess, or that a command had before -> hint
    "export": "write `navbake convert GRID FILE`: the ending of FILE says to what",
    "extrude": "write `navbake convert MAP scene.xml`",
}


class _CommandGroups(TyperGroup):
    """The command `navbake`: its help lists the commands in groups."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        name_width = max(map(len, self.commands))
        for title, group in COMMANDS.items():
            command_names = [function.__name__.replace("_", "-") for function in group]
            with formatter.section(title):
                help_texts = [self.commands[name].get_short_help_str(100) for name in command_names]
                padded_names = [name.ljust(name_width) for name in command_names]
                formatter.write_dl([*zip(padded_names, help_texts, strict=True)])

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find a command by its name or alias; for an unknown name, the error has a hint."""
        if args[0] in GUESSED_COMMANDS:
            ctx.fail(f"No such command '{args[0]}': {GUESSED_COMMANDS[args[0]]}")
        return super().resolve_command(ctx, [ALIASES.get(args[0], args[0]), *args[1:]])


app = Typer(
    name="navbake",
    cls=_CommandGroups,
    help="Bake MuJoCo scenes into navigation grids, and query and convert those grids.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for command in (command for group in COMMANDS.values() for command in group):
    # a place may start with a minus
    context_settings = {"ignore_unknown_options": command is why}
    app.command(cls=NavbakeCommand, context_settings=context_settings)(prepare_command(command))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line, and exit.

    The exit status is 0 for success, 1 for a NavbakeError, and 2 for wrong usage.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        # names may contain characters that the terminal's encoding lacks
        sys.stdout.reconfigure(errors="backslashreplace")
    for name in ("navbake.compiled", "navbake.formats"):
        logging.getLogger(name).handlers[:] = [_LogPrinter()]
    try:
        try:
            with print_package_warnings():
                COMMAND_LINE(None if arguments is None else list(arguments), prog_name="navbake")
        finally:  # flush, which may fail, too
            if sys.stdout is not None:
                sys.stdout.flush()
    except NavbakeError as error:
        print_error(str(error))
        print_causes(error)
        raise SystemExit(1) from None
    except OSError as error:
        if error.filename is not None or error.errno not in DISK_ERRORS:
            raise
        # at its end, Python would flush the buffer again and fail: let it write to nowhere
        with suppress(OSError, ValueError):  # ValueError: stdout has no file descriptor in tests
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if error.errno != errno.EPIPE:  # a closed pipe is no error
            print_error(f"cannot write to stdout: {error.strerror}")
        raise SystemExit(1) from None


class _LogPrinter(logging.Handler):
    """Prints each log record as a line on stderr."""

    def emit(self, record: logging.LogRecord) -> None:
        print_error(record.getMessage())
        if record.name.startswith("navbake.formats"):  # what a file has no place for
            add_warning(record.getMessage())


def _print_version(is_given: bool) -> None:
    if is_given:
        print(f"navbake {__version__}")
        raise Exit


@app.callback()
def _options(
    version: bool = Option(
        False, "--version", callback=_print_version, is_eager=True, help="Print the version."
    ),
) -> None: ...


COMMAND_LINE = get_command(app)
"""All commands with their options, as typer makes them of `app`."""
