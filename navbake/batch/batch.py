"""Bakes a batch of scenes, each once, and notes what became of each."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from navbake._version import __version__
from navbake.batch.crew import DONE, Ended, JobLimits, do_jobs
from navbake.batch.index import Index, read_index
from navbake.batch.inputs import are_unchanged
from navbake.batch.job import Job
from navbake.batch.products import GRID, Product
from navbake.batch.work import FAILED, OK, Order, do_order, settings_of
from navbake.config.settings import settings_digest
from navbake.errors import NavbakeError
from navbake.types import Json

Watch = Callable[[int, int, Json], None]


@dataclass
class BatchResult:
    """What a batch came to.

    Attributes:
        rows: the index, a row for each scene in the batch's order; of one that was not begun, its
            ``status`` is ``left``.
        skipped: how many were there already.
        stopped: why the batch ended early, None if it didn't.
    """

    rows: list[Json] = field(default_factory=list)
    skipped: int = 0
    stopped: str | None = None

    @property
    def failed(self) -> list[Json]:
        """The rows of the scenes that failed."""
        return [row for row in self.rows if row["status"] == FAILED]

    @property
    def counts(self) -> Counter[str]:
        """How many rows have each status."""
        return Counter(row["status"] for row in self.rows)


def run_batch(
    jobs: Sequence[Job],
    folder: str | Path,
    *,
    settings: Json | None = None,
    overrides: Sequence[str] = (),
    products: Sequence[str] = ("grid",),
    workers: int = 1,
    limits: JobLimits = JobLimits(),  # noqa: B008 it is a tuple
    retries: int = 0,
    max_failures: int | None = None,
    watch: Watch | None = None,
) -> BatchResult:
    """Bake scenes in worker processes, each into a folder of its own.

    A scene is done already if the index says that it was made by this version of navbake, of the
    same files, settings and products, and its grid is there. One that fails, hangs or crashes its
    worker costs itself alone.

    Args:
        jobs: see `manifest.list_jobs`.
        folder: where the scenes' folders and the index are written; made if it isn't there.
        settings: of all scenes, as a YAML file has them.
        overrides: ``a.b=value``, for all scenes.
        products: what to make of each, see `products.KINDS`.
        workers: how many processes, >= 1.
        limits: of each scene.
        retries: how often a scene that crashed its worker or exceeded a limit is tried again.
        max_failures: end the batch when more scenes failed than this; None for never.
        watch: called with how many scenes are done, how many there are, and the row of the last.

    Returns:
        What became of each scene. The index in the folder says the same.

    Raises:
        ConfigError: a product is none.
        NavbakeError: the folder can't be written, or no worker process starts.
    """
    folder = Path(folder)
    for product in products:
        Product.parse(product)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        index = Index(folder)
    except OSError as error:
        raise NavbakeError(f"cannot write into {folder}: {error.strerror}") from error
    orders = [
        Order(job, dict(settings or {}), tuple(overrides), tuple(products), str(folder))
        for job in jobs
    ]
    known = read_index(folder)
    result = BatchResult(skipped=0)
    rows: dict[int, Json] = {}
    left: list[tuple[int, Order]] = []
    for number, order in enumerate(orders):
        row = known.get(order.job.id)
        if row is not None and _is_done(order, row):
            rows[number] = row
        else:
            left.append((number, order))
    result.skipped = len(rows)
    failures = 0
    try:
        with closing(do_jobs(left, do_order, workers, limits, retries)) as ended:
            for row, number in _rows(ended, orders):
                index.add(row)
                rows[number] = row
                failures += row["status"] == FAILED
                if row["status"] == FAILED:
                    _remove_stale(folder / orders[number].job.id)
                if watch is not None:
                    watch(len(rows), len(orders), row)
                if max_failures is not None and failures > max_failures:
                    result.stopped = f"more than {max_failures} scenes failed"
                    break
    finally:
        result.rows = [
            rows.get(number, {"id": job.id, "source": job.source, "status": "left"})
            for number, job in enumerate(jobs)
        ]
        index.finish(row for number, row in sorted(rows.items()))
    return result


def _rows(ended: Iterator[Ended], orders: Sequence[Order]) -> Iterator[tuple[Json, int]]:
    for end in ended:
        job = orders[end.number].job
        if end.how == DONE:
            yield end.value, end.number
        else:
            row = {"id": job.id, "source": job.source, "status": FAILED, "how": end.how}
            yield {**row, "error": end.value, "seconds": round(end.seconds, 4)}, end.number


def _is_done(order: Order, row: Json) -> bool:
    """Whether a row of the index is of the same scene, settings, products and version."""
    if row.get("status") != OK or row.get("version") != __version__:
        return False
    if row.get("products") != list(order.products):
        return False
    try:
        key = settings_digest(settings_of(order))
    except NavbakeError:
        return False
    folder = Path(order.folder)
    return (
        row.get("key") == key
        and are_unchanged(row["inputs"], folder)
        and (folder / order.job.id / GRID).is_file()
    )


def _remove_stale(folder: Path) -> None:
    """Remove what an earlier run made of a scene that fails now."""
    shutil.rmtree(folder, ignore_errors=True)
