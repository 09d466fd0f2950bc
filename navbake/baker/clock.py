"""The time that each stage of a bake takes, told to whoever watches."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

LOG = logging.getLogger("navbake")

Progress = Callable[[str, float], None]
"""Called with a stage's name and how much of it is done, 0 or 1."""


class StageClock:
    """Times the stages of a bake: `seconds` of each by its name, in the order in which they ended.

    Runs of one stage are added up.
    """

    def __init__(self, progress: Progress | None = None) -> None:
        self._progress = progress
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what runs inside as part of a stage."""
        begin = time.perf_counter()
        if self._progress is not None:
            self._progress(name, 0.0)
        yield
        taken = time.perf_counter() - begin
        self.seconds[name] = self.seconds.get(name, 0.0) + taken
        LOG.debug("%s: %.2f s", name, taken)
        if self._progress is not None:
            self._progress(name, 1.0)

    def to_json(self) -> dict[str, float]:
        """The timings as a grid file has them [ms]."""
        millis = {f"{name}Millis": round(1e3 * s, 3) for name, s in self.seconds.items()}
        return {"createMillis": round(1e3 * sum(self.seconds.values()), 3), **millis}
