"""Progress bars on the terminal."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from navbake.cli.printing import is_terminal
from navbake.errors import printable
from navbake.lazy import lazy

console = lazy("rich.console")  # loaded on a terminal only
progress = lazy("rich.progress")


@contextmanager
def progress_bars(title: str, hidden: bool = False) -> Iterator[Callable[..., None]]:
    """Yields a function that shows progress: a name, the share done, and a note.

    Each name has a bar on stderr, if that is a terminal; other output appears above the bars.
    """
    if hidden or not is_terminal(sys.stderr):
        yield lambda name, share, note="": None
        return
    screen = console.Console(stderr=True, markup=False, highlight=False, emoji=False)
    text = progress.TextColumn(f"{printable(title)} {{task.description}}", markup=False)
    note_column = progress.TextColumn("{task.fields[note]}", markup=False)
    columns = text, progress.BarColumn(), note_column, progress.TimeElapsedColumn()
    # stdout may be a pipe
    options = {"console": screen, "transient": True, "redirect_stdout": False}
    tasks: dict[str, Any] = {}
    with progress.Progress(*columns, progress.TimeRemainingColumn(), **options) as bars:

        def show(name: str, share: float, note: str = "") -> None:
            if name not in tasks:
                tasks[name] = bars.add_task(name, total=1.0, note="")
            bars.update(tasks[name], completed=share, note=note)

        yield show
