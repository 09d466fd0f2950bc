"""Times and reports the stages of a bake."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

LOG = logging.getLogger("navbake")

Progress = Callable[[str, float], None]
"""Called with a stage's name and how much of the stage is done, 0 or 1."""


class StageClock:
    """Times the stages of a bake.

    The times of a stage that runs several times are added up. A stage's time excludes the time of
    stages nested in it.

    Attributes:
        seconds: time of each stage by its name, in the order in which they ended [s].
    """

    def __init__(self, progress: Progress | None = None) -> None:
        """Start with no stage.

        Args:
            progress: called when a stage begins and when it ends.
        """
        self._progress = progress
        # of each stage that runs now, from the outermost in: the time of stages inside of it [s]
        self._nested_seconds: list[float] = []
        # time of stages that have run in part, and have not ended yet [s]
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
        """Time a part of a stage that continues later; report no progress."""
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
