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
        """Time a stage: the code in the ``with`` block. Report when it begins and ends."""
        if self._progress is not None:
            self._progress(name, 0.0)
        with self.add_to_stage(name):
            yield
        unfinished_seconds = self._unfinished_seconds.pop(name, 0.0)
        self.seconds[name] = self.seconds.get(name, 0.0) + unfinished_seconds
        LOG.debug("%s: %.2f s", name, self.seconds[name])
        if self._progress is not None:
            self._progress(name, 1.0)

    @contextmanager
    def add_to_stage(self, name: str) -> Iterator[None]:
        """Add the time of the code in the ``with`` block to a stage.

        The block may come before, within or after the ``with`` block of `stage` for the same name.
        Its begin and end are not reported as progress.
        """
        start_time = time.perf_counter()
        self._nested_seconds.append(0.0)
        try:
            yield
        finally:
            elapsed_seconds = time.perf_counter() - start_time
            nested_seconds = self._nested_seconds.pop()
        # not in the `finally`: the time of a stage that fails is not counted
        seconds_by_stage = self.seconds if name in self.seconds else self._unfinished_seconds
        seconds_by_stage[name] = seconds_by_stage.get(name, 0.0) + elapsed_seconds - nested_seconds
        if self._nested_seconds:
            self._nested_seconds[-1] += elapsed_seconds

    def to_json(self) -> dict[str, float]:
        """Return the timings as a grid file holds them: ``createMillis`` and ``<stage>Millis``."""
        millis = {
            f"{name}Millis": round(1e3 * seconds, 3) for name, seconds in self.seconds.items()
        }
        return {"createMillis": round(1e3 * sum(self.seconds.values()), 3), **millis}
