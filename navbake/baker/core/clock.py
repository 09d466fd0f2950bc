"""Times and reports the stages of a bake."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

LOG = logging.getLogger("navbake")

Progress = Callable[[str, float], None]
"""Called with a stage's name and how much of it is done, 0 or 1."""


class StageClock:
    """Times the stages of a bake: `seconds` by name, in the order in which they ended.

    Runs of one stage are added up; a stage's time excludes that of stages inside of it.
    """

    def __init__(self, progress: Progress | None = None) -> None:
        self._progress = progress
        self._inside: list[float] = []  # what ran inside of each that runs now [s]
        self._ahead: dict[str, float] = {}  # of stages that did not end yet [s]
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage, and report its progress."""
        if self._progress is not None:
            self._progress(name, 0.0)
        with self.part(name):
            yield
        self.seconds[name] = self.seconds.get(name, 0.0) + self._ahead.pop(name, 0.0)
        LOG.debug("%s: %.2f s", name, self.seconds[name])
        if self._progress is not None:
            self._progress(name, 1.0)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Time a part of a stage, which may end later."""
        begin = time.perf_counter()
        self._inside.append(0.0)
        try:
            yield
        finally:
            taken = time.perf_counter() - begin
            inside = self._inside.pop()
        # what fails is no part of it
        counted = self.seconds if name in self.seconds else self._ahead
        counted[name] = counted.get(name, 0.0) + taken - inside
        if self._inside:
            self._inside[-1] += taken

    def to_json(self) -> dict[str, float]:
        """The timings as a grid file has them [ms]."""
        millis = {f"{name}Millis": round(1e3 * s, 3) for name, s in self.seconds.items()}
        return {"createMillis": round(1e3 * sum(self.seconds.values()), 3), **millis}
