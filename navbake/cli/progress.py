"""Progress bars on the terminal."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from navbake.cli.printing import is_terminal
from navbake.errors import printable
from navbake.lazy import lazy

console = lazy("rich.console")  # nothing is drawn where there is no terminal
progress = lazy("rich.progress")


@contextmanager
def stage_progress(title: str, hidden: bool = False) -> Iterator[Callable[[str, float], None]]:
    """A bar for each stage on the terminal's stderr; nothing where stderr is no terminal."""
    if hidden or not is_terminal(sys.stderr):
        yield lambda stage, fraction: None
        return
    screen = console.Console(stderr=True, markup=False, highlight=False, emoji=False)
    text = progress.TextColumn(f"{printable(title)} {{task.description}}", markup=False)
    columns = text, progress.BarColumn(), progress.TimeElapsedColumn()
    bars = progress.Progress(*columns, console=screen, transient=True)
    tasks: dict[str, Any] = {}

    def show(stage: str, fraction: float) -> None:
        if stage not in tasks:
            tasks[stage] = bars.add_task(stage, total=1.0)
        bars.update(tasks[stage], completed=fraction)

    with bars:
        yield show


@contextmanager
def batch_progress(hidden: bool = False) -> Iterator[Callable[[int, int, int], None]]:
    """A bar for a batch on the terminal's stderr: rate, failures, time left; else nothing.

    It is told how many scenes ended, how many of these failed, and how many there are to do. What
    is printed on stderr meanwhile stands above it.
    """
    if hidden or not is_terminal(sys.stderr):
        yield lambda done, failed, total: None
        return
    screen = console.Console(stderr=True, markup=False, highlight=False, emoji=False)
    bars = progress.Progress(
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TextColumn("{task.description}", markup=False),
        progress.TimeRemainingColumn(),
        console=screen,
        transient=True,
        redirect_stdout=False,  # that may be a pipe
    )
    task: Any = bars.add_task("", total=None)
    begin = time.monotonic()

    def show(done: int, failed: int, total: int) -> None:
        rate = done / max(time.monotonic() - begin, 1e-3)
        said = f"{rate:.3g}/s, {failed} failed, time left"
        bars.update(task, completed=done, total=total, description=said)

    with bars:
        yield show
