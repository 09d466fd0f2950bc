"""Bakes a batch of scenes, each once, and writes the index, sets of episodes and shards.

Shards are tar files as WebDataset reads them. A sample is a scene. Its key is the scene's id, with
``%2E`` for a dot and ``%25`` for a percent sign, because a key ends at the first dot of a file's
name. Its members are the scene's files (``0001.grid.json.gz`` for the key ``0001``) and its row of
the index, without times (``0001.json``). Shards hold equally many scenes, in the batch's order, and
equal scenes give equal bytes: members have no time, no owner and one mode.
"""

from __future__ import annotations

import os
import re
import tarfile
from collections import defaultdict
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TypeAlias

import numpy as np

from navbake._version import __version__
from navbake.batch import index, store
from navbake.batch.job import (
    FAILED,
    LEFT_OUT,
    NOT_RECORDED,
    OK,
    Plan,
    bake_scene,
    begin_row,
    check_record,
    fail,
    open_scene,
    prepare,
    read_record,
    stamp,
    write_record,
)
from navbake.batch.products import RECORD_NAME, merge_sets
from navbake.batch.scenes import Job, check_settings
from navbake.batch.workers import DONE, RETRIED, Ended, JobLimits, do_jobs
from navbake.errors import NavbakeError, printable
from navbake.files import remove_leftovers
from navbake.formats.source import import_extra
from navbake.types import Json

MAX_RECORD_READS = 16  # scenes whose records are read at once
# keys of a record that are not in the index
RECORD_ONLY_KEYS = ("key", "inputs", "files", "ended")
SHARD_PATTERN = re.compile(r"shard-\d{6,}\.tar")
TIME_KEYS = ("seconds", "stages", "ended")  # keys of a row that differ each time
# why a scene isn't baked, or would be in vain
DONE_BEFORE = "done"
BROKEN_BEFORE = "broken"
PERCENTILES = (50, 90, 100)  # percentiles


Executor: TypeAlias = Callable[..., Generator[Ended, None, None]]
"""Does jobs as `workers.do_jobs` does, wherever its worker processes are."""


OnEvent: TypeAlias = Callable[[str, Json], None]
"""Is called with what happens: ``begin`` with how many scenes there are and are `skipped`, unless
there is none to bake; ``scene-begin`` with an `id`; ``retry`` with why; ``scene`` with its row."""


@dataclass
class BatchResult:
    """The outcome of a batch."""

    #: Of each scene, in the batch's order, as in the index.
    rows: list[Json] = field(default_factory=list)
    skipped: int = 0  #: Number of scenes that were done already.
    stopped: str | None = None  #: Why the batch ended early, None if it didn't.

    def count(self, status: str) -> int:
        """Return the number of scenes with a status: ``ok``, ``failed`` or ``left``."""
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
    part: index.Slice | None = None,
    only_merge: bool = False,
    shards: int | None = None,
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
        part: bake these of the scenes only, and write their part of the index.
        only_merge: bake nothing, and merge the parts of the index that slices wrote. Scenes without
            a row there are ``left`` unless they are done.
        shards: number of tar files to pack the scenes into at the end, None for none.

    Raises:
        ConfigError: an override or a shared setting is wrong.
        NavbakeError: the folder can't be written, another batch writes into it, no worker process
            starts, or the scenes' episodes can't be merged.
    """
    check_settings([job.source for job in jobs], plan.settings, plan.overrides)
    if plan.has_table:
        import_extra("pyarrow", "batch", "Parquet")
    if part is not None:
        jobs = jobs[part.number - 1 :: part.total]
    with ExitStack() as stack:
        lines: index.LineFile | None = None
        if isinstance(plan.folder, Path):
            stack.enter_context(index.only_batch(plan.folder, part))
            lines = index.LineFile(
                plan.folder / (part.file if part else index.INDEX_NAME), f"into {plan.folder}"
            )
            stack.callback(lines.close)
        rows: dict[str, Json] = {}
        if only_merge:  # scenes that slices baked, or that failed there
            batch_ids = {job.id for job in jobs}
            merged = index.merge_rows(plan.folder, index.find_parts(plan.folder)).items()
            baked = ((id, row) for id, row in merged if row.get("status") in (OK, FAILED))
            rows = {id: row for id, row in baked if id in batch_ids}
        checked = check_records(plan, [job for job in jobs if job.id not in rows])
        rows |= {row["id"]: row for row, _ in checked if row is not None}
        remaining = [] if only_merge else [job for job in jobs if job.id not in rows]
        result = BatchResult(skipped=len(rows))
        num_failed = 0
        if only_merge:
            result.skipped = sum(row["status"] == OK for row in rows.values())

        def note(jobs: Sequence[Job], event: str, ended: Ended) -> None:
            why: Json = {"worker": ended.worker, "seconds": round(ended.seconds, 3)}
            why |= {"how": ended.how, "error": ended.value}
            on_event(event, {"id": jobs[ended.number].id, **(why if event == RETRIED else {})})

        try:
            if remaining:
                on_event("begin", {"scenes": len(jobs), "skipped": len(rows)})
            twins = find_twins(plan, jobs, rows) if remaining else {}
            first = [job for job in remaining if job.id not in twins]
            then = [job._replace(twin=twins[job.id]) for job in remaining if job.id in twins]
            execute: Executor = executor or do_jobs
            for stage_jobs in filter(None, (first, then)):
                ended = execute(
                    stage_jobs,
                    partial(bake_scene, plan),
                    workers or (None if executor else 1),
                    limits=limits,
                    prepare=partial(prepare, plan.products, plan.thumbnail),
                    on_event=partial(note, stage_jobs),
                )
                with closing(ended):
                    for end in ended:
                        job = stage_jobs[end.number]
                        row = end.value
                        if end.how != DONE:
                            row = fail(plan, job, end.how, end.value, end.seconds)
                        if row["status"] == LEFT_OUT:  # no room for others, either
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
                if result.stopped is not None:
                    break
        except store.FullError as error:
            result.stopped = str(error)
        finally:
            for job in remaining:
                # a killed worker may leave files; on a store, the next run removes them
                if job.id not in rows and isinstance(plan.folder, Path):
                    with suppress(NavbakeError):
                        remove_leftovers(Path(plan.place(job)), age=0)
            result.rows = [rows.get(job.id) or begin_row(plan, job, LEFT_OUT) for job in jobs]
            try:
                index.write_index(plan.folder, result.rows, plan.has_table, part)
            except store.FullError as error:
                result.stopped = result.stopped or str(error)
        if result.stopped is None and part is None:
            try:
                write_sets(plan, result.rows)
                write_shards(plan.folder, result.rows, shards)
            except NavbakeError as error:
                result.stopped = str(error)
        return result


def write_sets(plan: Plan, rows: Sequence[Json]) -> None:
    """Merge the scenes' sets of episodes; write one file for each product beside the index.

    Raises a NavbakeError if they can't be merged, see `products.merge_sets`, or written.
    """
    for product in plan.products:
        kind, *values = product.split(":")
        name = f"episodes-{'-'.join(values)}.jsonl"
        ids = [row["id"] for row in rows if name in row.get("files", ())]
        if kind == "episodes" and ids:
            sets = [(id, store.read_file(store.join(plan.folder, f"{id}/{name}"))) for id in ids]
            store.write_file(plan.folder, name, merge_sets(sets))


def write_shards(folder: store.Folder, rows: Sequence[Json], count: int | None) -> None:
    """Pack the scenes into `count` tar files: ``shard-000000.tar`` and so on.

    If there are fewer scenes than `count`, each gets a shard. `rows` are the rows of the index;
    scenes that aren't ``ok`` are left out. Shards are recorded as a scene's files are. Recorded
    shards of earlier runs are removed, all of them if `count` is None; other files of such a name
    are left alone.
    """
    packed = [row for row in rows if row["status"] == OK] if count else []
    number = min(count or 0, len(packed))
    names = [f"shard-{k:06}.tar" for k in range(number)]
    before = {*filter(SHARD_PATTERN.fullmatch, read_record(folder).get("files", ()))}
    if names:
        write_record(folder, {"files": dict.fromkeys(sorted({*before, *names}))})
    for k, name in enumerate(names):
        shard_rows = packed[len(packed) * k // number : len(packed) * (k + 1) // number]
        store.write_file(folder, name, _encode_shard(folder, shard_rows))
    store.remove_files(folder, sorted(before - {*names}))
    if names:
        write_record(folder, {"files": dict.fromkeys(names)})
    elif before:
        store.remove_files(folder, [RECORD_NAME])


def _encode_shard(folder: store.Folder, rows: Sequence[Json]) -> Iterator[bytes]:
    """The pieces of a tar file."""
    for row in rows:
        key = row["id"].replace("%", "%25").replace(".", "%2E")
        for name in sorted(row["files"]):
            yield from _member(
                f"{key}.{name}", store.read_file(store.join(folder, f"{row['id']}/{name}"))
            )
        timeless_row = {name: value for name, value in row.items() if name not in TIME_KEYS}
        yield from _member(f"{key}.json", index.line_of(timeless_row))
    yield bytes(2 * tarfile.BLOCKSIZE)


def _member(name: str, content: bytes) -> Iterator[bytes]:
    info = tarfile.TarInfo(name)
    info.size = len(content)
    yield info.tobuf(tarfile.PAX_FORMAT)
    yield content
    yield bytes(-len(content) % tarfile.BLOCKSIZE)


def check_records(plan: Plan, jobs: Sequence[Job]) -> list[tuple[Json | None, str]]:
    """Return the result of `job.check_record` for each scene, in order."""
    sizes = store.sizes_below(plan.folder) if isinstance(plan.folder, str) else None
    with ThreadPoolExecutor(MAX_RECORD_READS) as pool:  # stores respond slowly
        return [*pool.map(partial(check_record, plan, sizes=sizes), jobs)]


def find_twins(plan: Plan, jobs: Sequence[Job], done: Mapping[str, Json]) -> dict[str, str]:
    """Find scenes that aren't done but have the same content as another scene.

    Returns the id of the twin by the scene's id. The twin is a scene that is done, or else the
    first of the equal scenes. Scenes on stores are compared only with those of the same URL, as
    their content isn't on this machine.
    """

    def content_of(job: Job) -> str:
        with suppress(NavbakeError, OSError), open_scene(plan, job, copy_all=False) as scene:
            return scene.content
        return ""  # it fails for a reason of its own

    alike = defaultdict[str | int, list[Job]](list)
    for job in sorted(jobs, key=lambda job: job.id not in done):
        with suppress(OSError):
            is_here = not store.is_url(job.source)
            alike[os.path.getsize(job.source) if is_here else job.source].append(job)
    groups = [group for group in alike.values() if group[1:] and group[-1].id not in done]
    candidates = [job for group in groups for job in group]
    with ThreadPoolExecutor(MAX_RECORD_READS) as pool:
        contents = [*pool.map(content_of, candidates)]
    first_of_content: dict[str, str] = {}
    twins: dict[str, str] = {}
    for job, content in zip(candidates, contents, strict=True):
        twin = first_of_content.setdefault(content or job.id, job.id)
        if twin != job.id and job.id not in done:
            twins[job.id] = twin
    return twins


def line_of_event(event: str, values: Json) -> Json:
    """Return an event of a batch as an object for one line of JSON, for log collectors.

    It has ``time``, ``level`` (``info``, ``warning`` or ``error``) and ``event``: ``begin``,
    ``scene-begin``, ``retry``, ``scene`` or ``end``. Its other keys are those of the index.
    """
    is_error = values.get("status") == FAILED or values.get("stopped") or values.get("failed")
    level = "error" if is_error else "info"
    if event == RETRIED or (values.get("warnings") and not is_error):
        level = "warning"
    values = {key: value for key, value in values.items() if key not in RECORD_ONLY_KEYS}
    if event == "begin":
        values["version"] = __version__
    return {"time": stamp(), "level": level, "event": event, **values}


# ---------------------------------------------------------------- before and after a run


def preview(plan: Plan, jobs: Sequence[Job]) -> list[Json]:
    """Find out what a batch would do, and write nothing.

    Returns an object for each scene, in order, with `id`, `source`, the `bytes` of its files, and
    `why`. `why` is the reason why it would be baked: ``new``, ``failed before``, ``equal to ID``
    (which is baked once for both), or a reason of `job.check_record`. For a scene that would not be
    baked it is ``done``, or ``broken: REASON`` if the scene can't be read. Raises a ConfigError if
    an override or a shared setting is wrong.
    """
    check_settings([job.source for job in jobs], plan.settings, plan.overrides)
    checked = check_records(plan, jobs)
    done = {row["id"]: row for row, _ in checked if row is not None}
    twins = find_twins(plan, jobs, done)
    failed = {
        id for id, row in index.read_index(plan.folder).items() if row.get("status") == FAILED
    }

    def measure(job: Job) -> tuple[int, str]:
        if job.id in done:
            return _sum_sizes(done[job.id].get("inputs")), ""
        try:
            with open_scene(plan, job, copy_all=False) as scene:
                lack = (
                    ""
                    if scene.inputs
                    else f"{BROKEN_BEFORE}: no scene file {store.shown(job.source)}"
                )
                return _sum_sizes(scene.inputs), lack
        except (NavbakeError, OSError) as error:
            return 0, f"{BROKEN_BEFORE}: {printable(str(error))}"

    with ThreadPoolExecutor(MAX_RECORD_READS) as pool:
        measured = [*pool.map(measure, jobs)]
    previews = []
    for job, (row, why), (num_bytes, broken) in zip(jobs, checked, measured, strict=True):
        if row is not None:
            why = DONE_BEFORE
        elif broken or job.id in twins:
            why = broken or f"equal to {twins[job.id]}"
        elif why == NOT_RECORDED and job.id in failed:
            why = "failed before"
        source = begin_row(plan, job, "")["source"]
        previews.append({"id": job.id, "source": source, "why": why, "bytes": num_bytes})
    return previews


def measure_cost(rows: Iterable[Json]) -> Json | None:
    """Return statistics of what the scenes that are ``ok`` cost; None without such a scene.

    The object has the number of `scenes`, and the sum, the median, the 90th percentile and the
    maximum of two quantities: the `seconds` of a scene, and the `bytes` of the files made of it.
    """
    done = [row for row in rows if row.get("status") == OK]
    if not done:
        return None
    values = {
        "seconds": [row.get("seconds", 0.0) for row in done],
        "bytes": [_sum_sizes(row.get("files")) for row in done],
    }
    cost: Json = {"scenes": len(done)}
    for name, each in values.items():
        shares = np.percentile(each, PERCENTILES, method="inverted_cdf").tolist()
        cost[name] = dict(zip(("sum", "median", "p90", "max"), (sum(each), *shares), strict=True))
    return cost


def _sum_sizes(files: Json | None) -> int:
    return sum(state["size"] for state in (files or {}).values())
