"""Times and reports the stages of a bake."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

LOG = logging.getLogger("navbake")

Progress = Callable[[str, float], None]
"""Called with a stage's name, and with 0 when the stage begins or 1 when it ends."""


class StageClock:
    """Times the stages of a bake.

    If a stage runs several times, its times are added up. A stage's time excludes the time of
    stages nested in it.

    Attributes:
        seconds: time of each stage by its name, in the order in which they ended [s].
    """

    def __init__(self, progress: Progress | None = None) -> None:
        """Make a clock that has timed no stage yet.

        Args:
            progress: called with a stage's name and 0 when the stage begins, 1 when it ends; None
                to report nothing.
        """
        self._progress = progress
        # for each stage that runs now, the outermost first: the time of stages nested in it [s]
        self._nested_seconds: list[float] = []
        # stage that hasn't ended yet -> time of its parts so far [s]
        self._unfinished_seconds: dict[str, float] = {}
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage, and report its progress."""
        if self._progress is not None:
            self._progress(name, 0.0)
        with self.part(name):
            yield
        unfinished = self._unfinished_seconds.pop(name, 0.0)
        self.seconds[name] = self.seconds.get(name, 0.0) + unfinished
        LOG.debug("%s: %.2f s", name, self.seconds[name])
        if self._progress is not None:
            self._progress(name, 1.0)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Add the time of a block of code to a stage, before, within or after `stage`.

        Progress is not reported.
        """
        begin = time.perf_counter()
        self._nested_seconds.append(0.0)
        try:
            yield
        finally:
            elapsed = time.perf_counter() - begin
            nested = self._nested_seconds.pop()
        # not in the `finally`: the time of a stage that fails is not counted
        totals = self.seconds if name in self.seconds else self._unfinished_seconds
        totals[name] = totals.get(name, 0.0) + elapsed - nested
        if self._nested_seconds:
            self._nested_seconds[-1] += elapsed

    def to_json(self) -> dict[str, float]:
        """Return the timings as a grid file holds them: ``createMillis`` and ``<stage>Millis``."""
        millis = {f"{name}Millis": round(1e3 * s, 3) for name, s in self.seconds.items()}
        return {"createMillis": round(1e3 * sum(self.seconds.values()), 3), **millis}
