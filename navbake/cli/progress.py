"""Progress bars on the terminal."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from navbake import dispatch
from navbake.errors import printable

COMPILING = "compiling for this machine, once"


@contextmanager
def stage_progress(title: str, hidden: bool = False) -> Iterator[Callable[[str, float], None]]:
    """A bar for each stage on the terminal's stderr; nothing where stderr is no terminal.

    One more tells how many kernels of how many are compiled, where some are not.
    """
    console = Console(stderr=True, markup=False, highlight=False, emoji=False)
    text = TextColumn(f"{printable(title)} {{task.description}}", markup=False)
    bars = Progress(text, BarColumn(), TimeElapsedColumn(), console=console, transient=True)
    tasks: dict[str, TaskID] = {}

    def show(stage: str, fraction: float) -> None:
        if stage not in tasks:
            tasks[stage] = bars.add_task(stage, total=1.0)
        bars.update(tasks[stage], completed=fraction)

    def show_compiled(done: int, total: int) -> None:
        if COMPILING not in tasks:
            tasks[COMPILING] = bars.add_task(COMPILING)
        description = f"{COMPILING}: {done} of {total}"
        bars.update(tasks[COMPILING], description=description, completed=done, total=total)

    with bars if console.is_terminal and not hidden else nullcontext():
        dispatch.watch = show_compiled
        try:
            yield show
        finally:
            dispatch.watch = None
