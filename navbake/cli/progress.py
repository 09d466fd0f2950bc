"""Progress bars on the terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn


class StageProgress:
    """A bar for each stage on the terminal's stderr; nothing where stderr is no terminal."""

    def __init__(self, title: str, hidden: bool = False) -> None:
        console = Console(stderr=True, markup=False, highlight=False, emoji=False)
        self._progress = Progress(
            TextColumn(f"{title} {{task.description}}", markup=False),
            BarColumn(),
            TimeElapsedColumn(),
            console=console,
            transient=True,
        )
        self._is_shown = console.is_terminal and not hidden
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> StageProgress:
        if self._is_shown:
            self._progress.start()
        return self

    def __exit__(self, *_error: Any) -> None:
        if self._is_shown:
            self._progress.stop()

    def __call__(self, stage: str, fraction: float) -> None:
        if stage not in self._tasks:
            self._tasks[stage] = self._progress.add_task(stage, total=1.0)
        self._progress.update(self._tasks[stage], completed=fraction)
