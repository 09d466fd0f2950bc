"""Bakes a batch of scenes, each once, and writes the index."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TypeAlias

from navbake._version import __version__
from navbake.batch.index import NAME, LineFile, only_batch, write_index
from navbake.batch.job import (
    FAILED,
    LEFT,
    Plan,
    bake_scene,
    begin_row,
    fail,
    find_record,
    prepare,
    stamp,
)
from navbake.batch.products import merge_sets
from navbake.batch.settings import Job, check_settings
from navbake.batch.store import (
    FullError,
    join,
    read_file,
    sizes_below,
    write_file,
)
from navbake.batch.workers import AGAIN, DONE, Ended, JobLimits, do_jobs
from navbake.errors import NavbakeError
from navbake.files import remove_leftovers
from navbake.formats.source import import_extra
from navbake.types import Json

AT_ONCE = 16  # scenes whose records are read at once
# keys of a record that are not in the index
BOOKKEEPING = ("key", "inputs", "files", "ended")


Executor: TypeAlias = Callable[..., Generator[Ended, None, None]]
"""Does jobs as `workers.do_jobs` does, wherever its worker processes are."""


OnEvent: TypeAlias = Callable[[str, Json], None]
"""Is called with what happens: ``begin`` with how many scenes there are and are `skipped`, unless
there is none to bake; ``scene-begin`` with an `id`; ``retry`` with why; ``scene`` with its row."""


@dataclass
class BatchResult:
    """The result of a batch."""

    #: Of each scene, in the batch's order, as in the index.
    rows: list[Json] = field(default_factory=list)
    skipped: int = 0  #: Number of scenes that were done already.
    stopped: str | None = None  #: Why the batch ended early, None if it didn't.

    def count(self, status: str) -> int:
        """Number of scenes with a status: ``ok``, ``failed`` or ``left``."""
        return sum(row["status"] == status for row in self.rows)


def run_batch(
    plan: Plan,
    jobs: Sequence[Job],
    on_event: OnEvent,
    *,
    workers: int | None = 1,
    limits: JobLimits = JobLimits(),  # noqa: B008 it is a tuple
    max_failures: int | None = None,
    executor: Executor | None = None,
) -> BatchResult:
    """Bake scenes in worker processes, each into a folder of its own.

    A scene is done already if its folder has the grid and a record with its key, see
    `job.open_scene`. One that fails, hangs or crashes its worker doesn't affect others. If the
    folder has no room, the batch stops. Unless the process is killed, the index has a row for each
    scene, in order; ``left`` if the batch ended before it. On this machine, each row is written at
    once.

    Args:
        plan: the batch's options.
        jobs: the scenes.
        on_event: is called with each event, see `line_of_event`.
        workers: number of processes, >= 1; None for each CPU of a cluster, else 1.
        limits: of each scene.
        max_failures: the batch ends when more scenes failed than this; None for never.
        executor: runs the worker processes; None for this machine.

    Raises:
        ConfigError: an override or a shared setting is wrong.
        NavbakeError: the folder can't be written, another batch writes into it, no worker process
            starts, or the scenes' episodes can't be merged.
    """
    check_settings([job.source for job in jobs], plan.settings, plan.overrides)
    if plan.has_table:
        import_extra("pyarrow", "batch", "Parquet")
    with ExitStack() as stack:
        lines: LineFile | None = None
        if isinstance(plan.folder, Path):
            stack.enter_context(only_batch(plan.folder))
            lines = LineFile(plan.folder / NAME, f"into {plan.folder}")
            stack.callback(lines.close)
        rows = find_done(plan, jobs)
        left = [job for job in jobs if job.id not in rows]
        result, num_failed = BatchResult(skipped=len(rows)), 0

        def note(event: str, ended: Ended) -> None:
            why: Json = {"worker": ended.worker, "seconds": round(ended.seconds, 3)}
            why |= {"how": ended.how, "error": ended.value}
            on_event(event, {"id": left[ended.number].id, **(why if event == AGAIN else {})})

        try:
            if left:
                on_event("begin", {"scenes": len(jobs), "skipped": len(rows)})
            execute: Executor = executor or do_jobs
            ended = execute(
                left,
                partial(bake_scene, plan),
                workers or (None if executor else 1),
                limits=limits,
                prepare=partial(prepare, plan.products, plan.thumbnail),
                on_event=note,
            )
            with closing(ended):
                for end in ended:
                    job, row = left[end.number], end.value
                    if end.how != DONE:
                        row = fail(plan, job, end.how, end.value, end.seconds)
                    if row["status"] == LEFT:  # no room for others, either
                        result.stopped = row["error"]
                        break
                    rows[job.id] = row
                    if lines is not None:
                        lines.add(row)
                    on_event("scene", {**row, "worker": end.worker})
                    num_failed += row["status"] == FAILED
                    if max_failures is not None and num_failed > max_failures:
                        result.stopped = f"{num_failed} scenes failed, more than {max_failures}"
                        break
        except FullError as error:
            result.stopped = str(error)
        finally:
            for job in left:
                # a killed worker may leave files; on a store, the next run removes them
                if job.id not in rows and isinstance(plan.folder, Path):
                    with suppress(NavbakeError):
                        remove_leftovers(Path(plan.place(job)), age=0)
            result.rows = [rows.get(job.id) or begin_row(plan, job, LEFT) for job in jobs]
            try:
                write_index(plan.folder, result.rows, plan.has_table)
            except FullError as error:
                result.stopped = result.stopped or str(error)
        if result.stopped is None:
            try:
                write_sets(plan, result.rows)
            except NavbakeError as error:
                result.stopped = str(error)
        return result


def write_sets(plan: Plan, rows: Sequence[Json]) -> None:
    """Merge the scenes' sets of episodes, of each product, into a file beside the index.

    Raises a NavbakeError if they can't be merged, see `products.merge_sets`, or written.
    """
    for product in plan.products:
        kind, *values = product.split(":")
        name = f"episodes-{'-'.join(values)}.jsonl"
        ids = [row["id"] for row in rows if name in row.get("files", ())]
        if kind == "episodes" and ids:
            sets = [(id, read_file(join(plan.folder, f"{id}/{name}"))) for id in ids]
            write_file(plan.folder, name, merge_sets(sets))


def find_done(plan: Plan, jobs: Sequence[Job]) -> dict[str, Json]:
    """The rows of scenes that are done already, by id."""
    sizes = sizes_below(plan.folder) if isinstance(plan.folder, str) else None
    with ThreadPoolExecutor(AT_ONCE) as pool:  # stores respond slowly
        found = [*pool.map(partial(find_record, plan, sizes=sizes), jobs)]
    return {row["id"]: row for row in found if row is not None}


def line_of_event(event: str, values: Json) -> Json:
    """An event as a line of JSON for log collectors.

    It has ``time``, ``level`` (``info``, ``warning`` or ``error``) and ``event``: ``begin``,
    ``scene-begin``, ``retry``, ``scene`` or ``end``. Its other keys are those of the index.
    """
    is_error = values.get("status") == FAILED or values.get("stopped") or values.get("failed")
    level = "error" if is_error else "info"
    if event == AGAIN or (values.get("warnings") and not is_error):
        level = "warning"
    values = {key: value for key, value in values.items() if key not in BOOKKEEPING}
    if event == "begin":
        values["version"] = __version__
    return {"time": stamp(), "level": level, "event": event, **values}
