"""Prints what commands say: lines, or one JSON object; warnings, errors, progress on stderr.

A command says everything twice: as lines (`say`, `print_tables`), and as facts (`add_facts`). With
--json, only the facts are printed, as one object at the end of the command; without it, only the
lines are.
"""

from __future__ import annotations

import json
import logging
import shutil
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, TextIO

from navbake.errors import printable
from navbake.lazy import lazy
from navbake.views.tables import Table, list_cell_facts, make_table

if TYPE_CHECKING:
    from navbake.runtime.search import Search
    from navbake.types import Json

rich_console = lazy("rich.console")  # takes 0.1 s; for wide tables and progress
rich_progress = lazy("rich.progress")  # on a terminal only
rich_table = lazy("rich.table")

LOG = logging.getLogger("navbake")
VERBOSITY = SimpleNamespace(quiet=False, verbose=False, as_json=False)
"""Whether the running command was given --quiet, --verbose, --json; `use_verbosity` sets it."""


@dataclass
class CommandResult:
    """The result of the running command, which it prints at its end with --json.

    Attributes:
        facts: The facts of the command, such as ``scene_id``, by their keys.
        files: The paths of the files that it wrote, in their order.
        warnings: The warnings that it printed on stderr.
        stdout_is_taken: Whether it wrote a file to stdout, so that the object goes to stderr.
        is_printed: Whether the object is printed.
    """

    facts: dict[str, object] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    stdout_is_taken: bool = False
    is_printed: bool = False


_COMMAND = SimpleNamespace(result=CommandResult())


def add_facts(**facts: object) -> None:
    """Add facts to the object that --json prints.

    Args:
        facts: key -> a value of JSON, which may contain numpy arrays. Keys are words joined by
            underscores, and the same fact has the same key in all commands.
    """
    _COMMAND.result.facts.update(facts)


def add_files(*paths: Path) -> None:
    """Add files that the command wrote to the object that --json prints."""
    _COMMAND.result.files += map(str, paths)


def add_warning(warning: str) -> None:
    """Add a warning, which is printed on stderr elsewhere, to the object that --json prints."""
    _COMMAND.result.warnings.append(warning)


def take_stdout() -> None:
    """Note that a file is written to stdout, so that the object of --json goes to stderr."""
    _COMMAND.result.stdout_is_taken = True


def print_facts() -> None:
    """Print the facts of the command as one JSON object, once, if it has --json."""
    result: CommandResult = _COMMAND.result
    if not VERBOSITY.as_json or result.is_printed:
        return
    result.is_printed = True
    value = {**result.facts, "files": result.files, "warnings": result.warnings}
    print_json(value, sys.stderr if result.stdout_is_taken else sys.stdout)


@contextmanager
def use_verbosity(*, quiet: bool, verbose: bool, as_json: bool = False) -> Iterator[None]:
    """Set `VERBOSITY` for a command, within a with statement.

    With `verbose`, records of the logger ``navbake`` are printed on stderr, and at the end the
    duration. Records of warnings and errors aren't, because commands print these in any case.
    """
    VERBOSITY.quiet = quiet
    VERBOSITY.verbose = verbose
    VERBOSITY.as_json = as_json
    _COMMAND.result = CommandResult()
    if not verbose:
        yield
        return

    def is_for_the_terminal(record: logging.LogRecord) -> bool:
        record.msg = printable(record.getMessage())
        record.args = ()
        return record.levelno < logging.WARNING

    start_time = time.perf_counter()
    level_before = LOG.level
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("navbake: %(message)s"))
    handler.addFilter(is_for_the_terminal)
    LOG.addHandler(handler)
    LOG.setLevel(logging.DEBUG)
    try:
        yield
    finally:
        LOG.debug("%.2f s in all", time.perf_counter() - start_time)
        LOG.removeHandler(handler)
        LOG.setLevel(level_before)


def print_json_line(value: object) -> None:
    """Print a value as one line of JSON and flush it."""
    print(json.dumps(value, separators=(",", ":"), allow_nan=False), flush=True)


def print_json(value: object, stream: TextIO | None = None) -> None:
    """Print a value, which may contain numpy arrays, as JSON, and flush it.

    Args:
        value: the value.
        stream: where to print it; None for stdout.

    Raises:
        ValueError: a number is NaN or infinite, which JSON doesn't have.
    """
    stream = stream or sys.stdout
    # JSON is UTF-8; a pipe on Windows may have another encoding, in which escapes are safe
    is_utf8 = (getattr(stream, "encoding", None) or "utf-8").lower().replace("_", "-") == "utf-8"
    json_text = json.dumps(
        value,
        indent=2,
        ensure_ascii=not is_utf8,
        allow_nan=False,
        default=lambda numpy_array: numpy_array.tolist(),
    )
    # JSON escapes characters below a space, but not all control characters
    printable_text = "".join(
        character
        if character.isprintable() or character == "\n"
        else json.dumps(character)[1:-1]  # without the quotes
        for character in json_text
    )
    print(printable_text, file=stream, flush=True)


def say(text: object = "") -> None:
    """Print one line on stdout; with --json, print nothing.

    Control characters are escaped, as they may command terminals.
    """
    if not VERBOSITY.as_json:
        print(printable(str(text)))


def say_unless_quiet(text: object) -> None:
    """Print one line of information on stdout; with --quiet or --json, print nothing."""
    if not VERBOSITY.quiet:
        say(text)


def print_error(message: str) -> None:
    if sys.stderr is not None:  # None would be stdout
        print(f"navbake: {printable(message)}", file=sys.stderr)


def print_causes(error: BaseException) -> None:
    """Print the causes of an error on stderr, one line each, with --verbose only."""
    cause = error.__cause__ if VERBOSITY.verbose else None
    while cause is not None:
        print_error(f"because of {type(cause).__name__}: {cause}")
        cause = cause.__cause__


def print_warnings(texts: Iterable[str]) -> None:
    """Print warnings on stderr, one line each, and add them to the object of --json."""
    for text in texts:
        print_error(f"warning: {text}")
        add_warning(text)


@contextmanager
def print_package_warnings() -> Iterator[None]:
    """Within it, Python's warnings of navbake's own categories are printed by `print_warnings`.

    Those that a command causes are printed whatever filters Python was started with.
    """
    show_as_python = warnings.showwarning

    def show_warning(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if category.__module__.startswith("navbake."):
            print_warnings([str(message)])
        else:
            show_as_python(message, category, filename, lineno, file, line)

    with warnings.catch_warnings():
        warnings.showwarning = show_warning
        # by the module that causes a warning, as the categories are in modules that load numpy
        warnings.filterwarnings("always", category=UserWarning, module=r"navbake\.cli\.")
        yield


def warn_of_closed_connections(
    search_before: Search, search_after: Search, radius: float
) -> list[str]:
    """Print a warning that names the stairs, doors and links that a larger radius closes.

    Args:
        search_before: a search on the grid for the smaller radius.
        search_after: a search on the grid for the larger radius.
        radius: the larger radius, for the warning [m].

    Returns:
        The warnings: one, or none where nothing is closed.
    """
    from navbake.runtime.passage import find_lost_connections  # loads numpy

    lost_connections = find_lost_connections(search_before, search_after)
    if not lost_connections:
        return []
    names_text = ", ".join(name for name, _ in lost_connections)
    num_before = search_before.islands.count
    verb = "was" if num_before == 1 else "were"
    islands_text = f"{search_after.islands.count} islands where there {verb} {num_before}"
    texts = [f"a radius of {radius:g} m closes {names_text}: {islands_text}"]
    print_warnings(texts)
    return texts


def is_terminal(stream: TextIO | None) -> bool:
    """Return whether a stream is a terminal; False for None, which stands for a closed stream."""
    return stream is not None and stream.isatty()


def print_tables(*tables: Table) -> None:
    """Print tables on stdout, at most as wide as the terminal; with --json, print nothing."""
    if VERBOSITY.as_json:
        return
    width = shutil.get_terminal_size().columns if is_terminal(sys.stdout) else None
    for index, table in enumerate(tables):
        print("\n" * (index > 0) + "\n".join(lay_out_table(table, width)))


def make_cell_table(facts: Json) -> Table:
    """Return a table with a row for each fact of a cell.

    Args:
        facts: what `navbake.views.describe.describe_cell` returns.
    """
    blocked_text = "no floor here" if facts["floor"] is None else "blocked"
    verdict = "an agent can stand here" if facts["free"] else blocked_text
    if facts["lower_than_step"]:
        verdict += ", as what is lower than a step is no obstacle"
    value_by_fact = {"verdict": verdict, "blocked by": facts["blockers"], **list_cell_facts(facts)}
    rows = []
    for name, value in value_by_fact.items():
        rows.append((name, ", ".join(value) or "-" if isinstance(value, list) else value))
    return make_table(("", ""), rows)


def lay_out_table(table: Table, width: int | None = None) -> list[str]:
    """Lay out a table as lines of text.

    Args:
        table: the table.
        width: the largest width [characters]; in a wider table, cells are wrapped. None for any
            width.
    """
    text_rows = [table.headings, *table.rows] if any(table.headings) else table.rows
    column_widths = [
        max(map(measure_text_width, column)) for column in zip(*text_rows, strict=True)
    ]
    is_number = [heading in table.numbers for heading in table.headings]
    if width is not None and sum(column_widths) + table.gap * (len(column_widths) - 1) > width:
        column_options = {"pad_edge": False, "padding": (0, table.gap, 0, 0)}
        has_headings = text_rows is not table.rows
        wrapped_table = rich_table.Table(box=None, show_header=has_headings, **column_options)
        for heading, is_right_aligned in zip(table.headings, is_number, strict=True):
            alignment = "right" if is_right_aligned else "left"
            wrapped_table.add_column(
                heading, justify=alignment, overflow="fold", no_wrap=is_right_aligned
            )
        for row in table.rows:
            wrapped_table.add_row(*row)
        plain_options = {"color_system": None, "markup": False, "highlight": False, "emoji": False}
        console = rich_console.Console(width=width, **plain_options)
        with console.capture() as captured_text:
            console.print(wrapped_table)
        return [line.rstrip() for line in captured_text.get().splitlines()]
    lines = []
    for row in text_rows:
        padding_texts = [
            " " * (column_width - measure_text_width(cell))
            for cell, column_width in zip(row, column_widths, strict=True)
        ]
        cells = [
            padding_text + cell if is_right_aligned else cell + padding_text
            for cell, padding_text, is_right_aligned in zip(
                row, padding_texts, is_number, strict=True
            )
        ]
        lines.append((" " * table.gap).join(cells).rstrip())
    return lines


def measure_text_width(text: str) -> int:
    """Return how many columns of a terminal a text takes; a Chinese character takes two."""
    if text.isascii():
        return len(text)
    from rich.cells import cell_len  # rich slows --help by a fifth

    return cell_len(text)


@contextmanager
def show_progress_bars(title: str, hidden: bool = False) -> Iterator[Callable[..., None]]:
    """Show progress bars on stderr, if that is a terminal; other output appears above them.

    Args:
        title: the text before each bar's name.
        hidden: whether to show nothing.

    Yields:
        A function that adds or updates a bar. It takes the bar's name, the fraction that is done
        (0 to 1), and a note, a text beside the bar.
    """
    if hidden or not is_terminal(sys.stderr):
        yield lambda name, share, note="": None
        return
    console = rich_console.Console(stderr=True, markup=False, highlight=False, emoji=False)
    title_column = rich_progress.TextColumn(
        f"{printable(title)} {{task.description}}", markup=False
    )
    note_column = rich_progress.TextColumn("{task.fields[note]}", markup=False)
    task_by_name: dict[str, Any] = {}
    with rich_progress.Progress(
        title_column,
        rich_progress.BarColumn(),
        note_column,
        rich_progress.TimeElapsedColumn(),
        rich_progress.TimeRemainingColumn(),
        console=console,
        transient=True,
        redirect_stdout=False,  # stdout may be a pipe
    ) as progress:

        def show_fraction(name: str, fraction: float, note: str = "") -> None:
            if name not in task_by_name:
                task_by_name[name] = progress.add_task(name, total=1.0, note="")
            progress.update(task_by_name[name], completed=fraction, note=note)

        yield show_fraction
