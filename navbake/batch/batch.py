"""Bakes a batch of scenes, each once, and notes what became of each."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from navbake.batch.crew import DONE, Ended, JobLimits, do_jobs
from navbake.batch.file_states import are_unchanged, path_from
from navbake.batch.index import Index, only_batch
from navbake.batch.job import Job
from navbake.batch.products import parse_products
from navbake.batch.settings import check_overrides, settings_of
from navbake.batch.work import (
    DIGITS,
    FAILED,
    LEFT,
    OK,
    Order,
    do_order,
    fail,
    key_of,
    prepare,
    row_of,
)
from navbake.errors import NavbakeError
from navbake.files import remove_leftovers
from navbake.types import Json


class Batch(NamedTuple):
    """What to bake, and into what.

    Attributes:
        jobs: the scenes, see `manifest.list_jobs`.
        folder: where the scenes' folders and the index are written; made if it isn't there.
        settings: what all scenes share, see `settings.read_shared`.
        overrides: ``a.b=value``, for all scenes.
        products: what to make of each besides its grid, see `products.KINDS`.
    """

    jobs: Sequence[Job]
    folder: Path
    settings: Json
    overrides: Sequence[str] = ()
    products: Sequence[str] = ()


class Executor(Protocol):
    """Does jobs as `crew.do_jobs` does, wherever its worker processes are."""

    def __call__(
        self,
        jobs: Sequence[Any],
        work: Callable[[Any], Any],
        count: int,
        *,
        limits: JobLimits,
        retries: int,
        prepare: Callable[[], None] | None,
    ) -> Generator[Ended, None, None]:
        """Yields how each job ended; the workers are gone when it is closed, or at the end."""


class Means(NamedTuple):
    """What a batch may use.

    Attributes:
        workers: how many processes, >= 1; `cluster.executor.ALL` for each CPU of a cluster.
        limits: of each scene.
        retries: how often a scene that crashed its worker or exceeded a limit is tried again.
        max_failures: the batch ends when more scenes failed than this; None for never.
        executor: where the worker processes are; None for this machine.
    """

    workers: int = 1
    limits: JobLimits = JobLimits()
    retries: int = 0
    max_failures: int | None = None
    executor: Executor | None = None


class Watch(Protocol):
    """Is told how a batch goes on."""

    def begin(self, total: int, skipped: int) -> None:
        """Before the first scene is baked; not where there is none to bake."""

    def end_scene(self, row: Json) -> None:
        """After each scene, with its row."""


@dataclass
class BatchResult:
    """What a batch came to.

    Attributes:
        rows: of each scene, in the batch's order, as in the index.
        skipped: how many were done already.
        stopped: why the batch ended early, None if it didn't.
    """

    rows: list[Json] = field(default_factory=list)
    skipped: int = 0
    stopped: str | None = None

    def count(self, status: str) -> int:
        """How many scenes have a status: ``ok``, ``failed`` or ``left``."""
        return sum(row["status"] == status for row in self.rows)


def run_batch(batch: Batch, means: Means, watch: Watch) -> BatchResult:
    """Bake scenes in worker processes, each into a folder of its own.

    A scene is done already if the index says that this version of navbake made it, of the same
    files, settings and products, and what it made is still there. One that fails, hangs or
    crashes its worker costs itself alone. However the batch ends, short of being killed, the index
    has a row for each scene, in order; ``left`` is one that it did not come to.

    Raises:
        ConfigError: a product, an override or a shared setting is wrong.
        NavbakeError: the folder can't be written, another batch writes into it, or no worker
            process starts.
    """
    products = parse_products(batch.products)
    check_overrides(batch.overrides)
    _check_settings(batch)
    orders = [
        Order(job, batch.settings, tuple(batch.overrides), products, batch.folder)
        for job in batch.jobs
    ]
    with only_batch(batch.folder), closing(Index(batch.folder)) as index:
        return _run(orders, index, means, watch)


def _check_settings(batch: Batch) -> None:
    """Find out what is wrong with the settings that all scenes share before any scene fails."""
    nobody = Job("scene", "scene.xml", {}, "the batch")
    settings_of(nobody, batch.settings, batch.overrides)


def _run(orders: Sequence[Order], index: Index, means: Means, watch: Watch) -> BatchResult:
    skipped = {o.job.id for o in orders if _is_done(o, index.known.get(o.job.id))}
    left = {o.job.id: o for o in orders if o.job.id not in skipped}
    result = BatchResult(skipped=len(skipped))
    waiting, num_failed = [*left.values()], 0
    try:
        if waiting:
            watch.begin(len(orders), len(skipped))
        execute = means.executor or do_jobs
        ended = execute(
            waiting,
            do_order,
            means.workers,
            limits=means.limits,
            retries=means.retries,
            prepare=prepare,
        )
        with closing(ended):
            for end in ended:
                row = _row(waiting[end.number], end)
                index.add(row)
                watch.end_scene(row)
                num_failed += row["status"] == FAILED
                if means.max_failures is not None and num_failed > means.max_failures:
                    result.stopped = f"more than {means.max_failures} scenes failed"
                    break
    finally:
        result.rows = index.finish(
            [order.job.id for order in orders], skipped, lambda id: row_of(left[id], LEFT)
        )
        for row in result.rows:
            if row["status"] == LEFT:  # its worker may have been killed as it wrote
                remove_leftovers(left[row["id"]].place)
    return result


def _row(order: Order, end: Ended) -> Json:
    """The row of a scene that ended."""
    if end.how == DONE:
        row: Json = end.value
        return row
    return {**fail(order, end.how, end.value), "seconds": round(end.seconds, DIGITS)}


def _is_done(order: Order, row: Json | None) -> bool:
    """Whether a row of the index is of the same files, settings, products and version."""
    if row is None or row.get("status") != OK:
        return False
    try:
        if not os.path.isfile(order.job.source):  # who reads a pipe may wait for ever
            return False
        config = settings_of(order.job, order.settings, order.overrides)
        return bool(
            row["key"] == key_of(order, config)
            and row["named"] == [path_from(path, order.folder) for path in config.inputs]
            and are_unchanged(row["inputs"], order.folder)
            and are_unchanged(row["files"], order.place)
        )
    except (NavbakeError, KeyError, TypeError, AttributeError):  # or no row of a batch's
        return False
