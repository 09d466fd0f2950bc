"""Bakes a batch of scenes, each once, and notes what became of each."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from navbake.batch.crew import DONE, Ended, Event, JobLimits, do_jobs
from navbake.batch.done import find_done
from navbake.batch.full import FullError
from navbake.batch.index import WAS, Index, made_row, only_batch
from navbake.batch.job import Job
from navbake.batch.journal import stamp
from navbake.batch.products import parse_products
from navbake.batch.remote import is_remote, refuse_unshared
from navbake.batch.settings import check_overrides, check_settings
from navbake.batch.stores.index import RemoteIndex
from navbake.batch.stores.urls import Folder
from navbake.batch.table import NAME as TABLE
from navbake.batch.table import check_pyarrow, encode_rows
from navbake.batch.work import DIGITS, FAILED, LEFT, OK, Order, do_order, fail, prepare, row_of
from navbake.files import remove_abandoned, remove_leftovers
from navbake.types import Json

UNSHARED = ("memory",)  # schemes of URLs whose files no other process has


class Batch(NamedTuple):
    """What to bake, and into what.

    Attributes:
        jobs: the scenes, see `manifest.list_jobs`.
        folder: where the scenes' folders and the index are written, a Path or a URL; made if it
            isn't there.
        settings: what all scenes share, see `settings.read_shared`.
        overrides: ``a.b=value``, for all scenes.
        products: what to make of each besides its grid, see `products.KINDS`.
        has_table: whether the index is written as Parquet as well.
        thumbnails: whether to make small pictures for the batch's page, of scenes that are baked.
    """

    jobs: Sequence[Job]
    folder: Folder
    settings: Json
    overrides: Sequence[str] = ()
    products: Sequence[str] = ()
    has_table: bool = False
    thumbnails: bool = False


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
        on_event: Callable[[Event], None],
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

    def hear(self, event: Event, scene: str | None) -> None:
        """Of workers, and of scenes that begin or are tried again; `scene` is the id of one."""

    def end_scene(self, row: Json) -> None:
        """After each scene, with its row."""


@dataclass
class BatchResult:
    """What a batch came to.

    Attributes:
        rows: of each scene, in the batch's order, as in the index.
        skipped: how many were done already.
        stopped: why the batch ended early, None if it didn't.
        has_table: whether the index was written as Parquet as well.
    """

    rows: list[Json] = field(default_factory=list)
    skipped: int = 0
    stopped: str | None = None
    has_table: bool = False

    def count(self, status: str) -> int:
        """How many scenes have a status: ``ok``, ``failed`` or ``left``."""
        return sum(row["status"] == status for row in self.rows)


def run_batch(batch: Batch, means: Means, watch: Watch) -> BatchResult:
    """Bake scenes in worker processes, each into a folder of its own.

    A scene is done already if the index says that this version of navbake made it, of the same
    files, settings and products, and what it made is still there. One that fails, hangs or
    crashes its worker costs itself alone. Where the folder has no room for one, the batch stops.
    However the batch ends, short of being killed, the index has a row for each scene, in order, as
    far as there is room for it; ``left`` is one that the batch did not come to. Its row keeps the
    one of when it was made last: what that says may still hold.

    Raises:
        ConfigError: a product, an override or a shared setting is wrong, or a file is in a
            process's own memory.
        NavbakeError: the folder can't be written, another batch writes into it, or no worker
            process starts.
    """
    products = parse_products(batch.products)
    check_overrides(batch.overrides)
    if batch.has_table:
        check_pyarrow()
    check_settings(batch.jobs, batch.settings, batch.overrides)
    orders = [
        Order(
            job,
            batch.settings,
            tuple(batch.overrides),
            products,
            batch.folder,
            batch.thumbnails,
        )
        for job in batch.jobs
    ]
    refuse_unshared(orders, UNSHARED)
    with _index_of(batch.folder) as index:
        remove_abandoned()  # what batches that were killed left
        if not batch.has_table:
            index.remove(TABLE)  # nobody writes it anew
        try:
            return _run(orders, index, means, watch, batch.has_table)
        finally:
            if any(map(is_remote, orders)):
                remove_abandoned()  # of workers that were killed


@contextmanager
def _index_of(folder: Folder) -> Iterator[Index | RemoteIndex]:
    """The index of an output folder, which no other batch may write into."""
    if isinstance(folder, Path):
        with only_batch(folder), closing(Index(folder)) as index:
            yield index
    else:
        with closing(RemoteIndex(folder)) as remote_index:
            yield remote_index


def _run(
    orders: Sequence[Order],
    index: Index | RemoteIndex,
    means: Means,
    watch: Watch,
    has_table: bool,
) -> BatchResult:
    skipped = find_done(orders, {id: made_row(row) for id, row in index.known.items()})
    left = {o.job.id: o for o in orders if o.job.id not in skipped}
    result = BatchResult(skipped=len(skipped))
    waiting, num_failed = [*left.values()], 0
    get_ready = partial(prepare, orders[0].products, orders[0].thumbnail) if orders else None
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
            prepare=get_ready,
            on_event=lambda event: watch.hear(event, _id_of(event, waiting)),
        )
        with closing(ended):
            for number, end in enumerate(ended):
                row = _row(waiting[end.number], end)
                if row["status"] == LEFT:  # there is no room for it, nor for the others
                    result.stopped = row["error"]
                    break
                if number == 0:
                    index.remove(TABLE)  # it would say less than the index
                index.add(row)
                watch.end_scene(row)
                num_failed += row["status"] == FAILED
                if means.max_failures is not None and num_failed > means.max_failures:
                    result.stopped = f"{num_failed} scenes failed, more than {means.max_failures}"
                    break
        if waiting:
            index.wait_for_disk()
    except FullError as error:
        result.stopped = str(error)
    finally:
        try:
            index.finish(
                [order.job.id for order in orders],
                skipped,
                lambda id: _left_row(left[id], index.known),
            )
            if index.rows != [*index.known.values()]:
                index.remove(TABLE)  # it says other than the index
            if has_table and index.rows:
                index.write(TABLE, encode_rows(index.rows))
                result.has_table = True
        except FullError as error:
            result.stopped = result.stopped or str(error)
        result.rows = index.rows[: len(orders)]
        for row in result.rows:
            # its worker may have been killed as it wrote; on a store, the next one removes that
            if row["status"] == LEFT and isinstance(left[row["id"]].folder, Path):
                remove_leftovers(left[row["id"]].place)
    return result


def _left_row(order: Order, known: Mapping[str, Json]) -> Json:
    """The row of a scene that the batch did not come to.

    What was made of it before is still there, unless a worker had begun to write it anew: then its
    files tell so. So the same command as before finds it done.
    """
    was = made_row(known.get(order.job.id, {}))
    return row_of(order, LEFT) | ({WAS: was} if was.get("status") == OK else {})


def _id_of(event: Event, orders: Sequence[Order]) -> str | None:
    return None if event.number is None else orders[event.number].job.id


def _row(order: Order, end: Ended) -> Json:
    """The row of a scene that ended."""
    if end.how == DONE:
        return {**end.value, "ended": stamp()}
    seconds = round(end.seconds, DIGITS)
    return {**fail(order, end.how, end.value), "seconds": seconds, "ended": stamp()}
